/* Streams: control publishes the newest target of the hand and the newest force. The servo takes them at the beginning
 * of a tick and interpolates to them over the usual time between two values. Replaced values and time-outs are counted.
 * Neither side waits, and there is always room. */
#include "servo/hd_servo.h"

#include <math.h>

#include "device/hd_device.h"
#include "tick/hd_tick.h"

#define HD_STREAM_MOST_M 1000.0 /* largest coordinate of a target, as of a waypoint */

/* ---- The servo thread -------------------------------------------------------------------------------------------- */

HD_RT static int is_live(const struct hd_stream *stream) {
    return hd_atomic_u32_load_relaxed(&stream->active) != 0;
}

/* Returns the time over which to interpolate to a value: the usual time until the next one. */
HD_RT static double interval_s(const struct hd_servo *servo, struct hd_stream *stream, int64_t time_ns) {
    const double longest_s = servo->config.stream_timeout_s;
    if (is_live(stream)) {
        hd_spacing_add(&stream->spacing, (double)(time_ns - stream->taken_ns) * 1e-9);
    } else {
        hd_spacing_forget(&stream->spacing);
    }
    const double usual_s = hd_spacing_usual(&stream->spacing, longest_s);
    return usual_s < servo->period_s ? servo->period_s : usual_s > longest_s ? longest_s : usual_s;
}

HD_RT static void record_used(struct hd_stream *stream, const struct hd_streamed_value *value, uint64_t tick) {
    const uint64_t used = hd_atomic_u64_load_relaxed(&stream->used);
    const size_t at = (size_t)(used % HD_STREAM_REMEMBERED);
    hd_atomic_u64_store_relaxed(&stream->used_seq[at], value->seq);
    hd_atomic_u64_store_relaxed(&stream->used_tick[at], tick);
    hd_atomic_u64_add_relaxed(&stream->superseded, value->number - stream->taken - 1u);
    hd_atomic_u64_store_release(&stream->used, used + 1u);
    stream->taken = value->number;
}

HD_RT static void take_value(struct hd_servo *servo, uint32_t kind, int64_t time_ns) {
    struct hd_stream *stream = &servo->streams[kind];
    if (!hd_triple_acquire(&stream->triple)) {
        return;
    }
    const struct hd_streamed_value *value = &stream->values[hd_triple_front(&stream->triple)];
    const double interval = interval_s(servo, stream, time_ns);
    if (kind == HD_STREAM_FORCE) {
        hd_tick_stream(servo->state, &servo->world->table, value->value, interval);
    } else if (hd_gesture_lead(servo->state, servo->device.sim, value->value, interval, time_ns)) {
        hd_atomic_u64_add_relaxed(&stream->limited, 1);
    }
    stream->taken_ns = time_ns;
    hd_atomic_u32_store_relaxed(&stream->active, 1);
    record_used(stream, value, servo->state->tick);
}

HD_RT void hd_servo_follow_streams(struct hd_servo *servo, int64_t time_ns) {
    /* Read first: values sent after this are taken in the next tick, or were taken already. */
    servo->streams_taken = hd_atomic_u64_load_acquire(&servo->streamed);
    servo->streaming = 0;
    for (uint32_t kind = 0; kind < HD_STREAMS; kind++) {
        struct hd_stream *stream = &servo->streams[kind];
        take_value(servo, kind, time_ns);
        if (is_live(stream) && (double)(time_ns - stream->taken_ns) * 1e-9 > servo->config.stream_timeout_s) {
            /* Counted first, so that a reader that sees the end of the stream also sees its time-out. */
            hd_atomic_u64_add_relaxed(&stream->timeouts, 1);
            hd_atomic_u32_store_release(&stream->active, 0);
            if (kind == HD_STREAM_FORCE) {
                hd_tick_stream_end(servo->state, &servo->world->table);
            }
        }
        servo->streaming |= (uint8_t)is_live(stream);
    }
    /* As of the previous tick: a value that is being approached may still turn out to be too fast. */
    servo->streaming |= servo->state->streams;
    hd_atomic_u64_store_relaxed(&servo->streams[HD_STREAM_FORCE].limited, servo->state->streamed.limited);
}

/* ---- Control side ------------------------------------------------------------------------------------------------ */

static int value_check(const struct hd_servo *servo, uint32_t kind, const double value[2]) {
    if (kind >= HD_STREAMS) {
        return hd_invalid("stream: unknown kind %u", kind);
    }
    if (kind == HD_STREAM_TARGET && servo->device.sim == NULL) {
        return hd_invalid("stream: a target needs a simulated joystick");
    }
    for (int axis = 0; axis < 2; axis++) {
        const double most = kind == HD_STREAM_TARGET ? HD_STREAM_MOST_M : (double)INFINITY;
        if (!isfinite(value[axis]) || !(fabs(value[axis]) <= most)) {
            return kind == HD_STREAM_TARGET
                       ? hd_invalid("position_m[%d]: %g is not within +-%g", axis, value[axis], HD_STREAM_MOST_M)
                       : hd_invalid("force_n[%d]: %g is not a finite number", axis, value[axis]);
        }
    }
    return HD_OK;
}

int hd_servo_stream(struct hd_servo *servo, uint32_t kind, uint64_t seq, const double value[2]) {
    const int status = value_check(servo, kind, value);
    if (status != HD_OK) {
        return status;
    }
    struct hd_stream *stream = &servo->streams[kind];
    stream->values[hd_triple_back(&stream->triple)] =
        (struct hd_streamed_value){.number = ++stream->sent, .seq = seq, .value = {value[0], value[1]}};
    hd_triple_publish(&stream->triple);
    /* Only control writes `streamed`. */
    hd_atomic_u64_store_release(&servo->streamed, hd_atomic_u64_load_relaxed(&servo->streamed) + 1u);
    return HD_OK;
}

void hd_servo_stream_counters(const struct hd_servo *servo, uint32_t kind, struct hd_stream_counters *counters) {
    const struct hd_stream *stream = &servo->streams[kind];
    *counters = (struct hd_stream_counters){
        .active = hd_atomic_u32_load_acquire(&stream->active),
        .timeouts = hd_atomic_u64_load_relaxed(&stream->timeouts),
        .limited = hd_atomic_u64_load_relaxed(&stream->limited),
    };
    uint64_t used = hd_atomic_u64_load_acquire(&stream->used);
    uint64_t before;
    do { /* repeats only if the reader was delayed while more values arrived than are kept */
        before = used;
        const size_t at = (size_t)((used - 1u) % HD_STREAM_REMEMBERED);
        counters->seq = hd_atomic_u64_load_acquire(&stream->used_seq[at]);
        counters->tick = hd_atomic_u64_load_acquire(&stream->used_tick[at]);
        used = hd_atomic_u64_load_acquire(&stream->used);
    } while (used - before >= HD_STREAM_REMEMBERED - 1u);
    counters->used = before;
    counters->superseded = hd_atomic_u64_load_relaxed(&stream->superseded);
}
