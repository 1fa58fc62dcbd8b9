/* Runs without clock, thread or I/O: hd_render (from positions), hd_replay (from samples of a servo) and hd_simulate
 * (closed loop with the simulated joystick). They use the same tick as the servo; results are bit-identical from run to
 * run. The caller's thread. */
#include <math.h>
#include <string.h>

#include "device/hd_device.h"
#include "scene/hd_world.h"
#include "tick/hd_tick.h"

/* Longest run, because times are nanoseconds in 63 bits. */
#define HD_LONGEST_RUN_S 9e9

/* The events of a run: `count` is the number that occurred, of which up to `capacity` are kept. */
struct event_sink {
    struct hd_event *events;
    size_t capacity;
    size_t count;
};

static void take_events(struct hd_state *state, struct event_sink *sink) {
    for (uint32_t i = 0; i < state->event_count; i++) {
        if (sink->count < sink->capacity) {
            sink->events[sink->count] = state->events[i];
        }
        sink->count++;
    }
    state->event_count = 0;
}

static int64_t period_time_ns(const struct hd_table *table, uint64_t period) {
    return (int64_t)((double)period * table->period_s * 1e9 + 0.5);
}

/* Ensures what the tick requires: a loaded world, and slots for all its objects. */
static int check_and_reserve(const struct hd_world *world, struct hd_state *state) {
    return world->loaded ? hd_state_reserve(state, world->table.object_count) : hd_invalid("world: no table is loaded");
}

int hd_render(const struct hd_world *world, struct hd_state *state, const double *position, const double *velocity,
              const uint32_t *periods, size_t count, struct hd_sample *samples, struct hd_event *events,
              size_t event_capacity, size_t *event_count) {
    const struct hd_table *table = &world->table;
    const int status = check_and_reserve(world, state);
    if (status != HD_OK) {
        return status;
    }
    struct event_sink sink = {.events = events, .capacity = event_capacity};
    for (size_t i = 0; i < count; i++) {
        struct hd_input input = {.periods = periods != NULL ? periods[i] : 1u};
        if (input.periods == 0) {
            return hd_invalid("periods[%zu]: at least 1 period lies between two ticks", i);
        }
        state->period += input.periods;
        if ((double)state->period * table->period_s > HD_LONGEST_RUN_S) {
            return hd_invalid("periods[%zu]: the run is longer than %g s", i, HD_LONGEST_RUN_S);
        }
        input.time_ns = period_time_ns(table, state->period - 1u);
        struct hd_reading reading = {
            .position_m = {position[2 * i], position[2 * i + 1]},
            .interval_s = state->located ? (double)input.periods * table->period_s : 0.0,
            .true_velocity_m_per_s = {(double)NAN, (double)NAN},
        };
        hd_sense(state, table, &reading, velocity != NULL ? &velocity[2 * i] : NULL, &input);
        samples[i].lateness_ns = 0;
        samples[i].work_ns = 0;
        hd_tick(world, state, &input, &samples[i]);
        if (state->event_count > 0) {
            take_events(state, &sink);
        }
    }
    *event_count = sink.count;
    return HD_OK;
}

int hd_replay(const struct hd_world *world, struct hd_state *state, const struct hd_sample *recorded,
              const double *interval_s, const uint32_t *periods, size_t count, struct hd_sample *samples,
              struct hd_event *events, size_t event_capacity, size_t *event_count) {
    const int status = check_and_reserve(world, state);
    if (status != HD_OK) {
        return status;
    }
    struct event_sink sink = {.events = events, .capacity = event_capacity};
    for (size_t i = 0; i < count; i++) {
        const struct hd_sample *was = &recorded[i];
        struct hd_input input = {
            .time_ns = was->time_ns,
            .position_m = {was->position_m[0], was->position_m[1]},
            .velocity_m_per_s = {was->velocity_m_per_s[0], was->velocity_m_per_s[1]},
            .true_velocity_m_per_s = {(double)NAN, (double)NAN},
            .interval_s = interval_s[i],
            .periods = periods[i],
            .checking = (was->flags & HD_FLAG_CHECKING) != 0,
            .check_n = {was->force_n[0], was->force_n[1]},
        };
        if (input.periods == 0) {
            return hd_invalid("periods[%zu]: at least 1 period lies between two ticks", i);
        }
        if (!(input.interval_s >= 0.0 && isfinite(input.interval_s))) {
            return hd_invalid("interval_s[%zu]: %g is not a finite number >= 0", i, input.interval_s);
        }
        if (was->tick < state->tick) {
            return hd_invalid("recorded[%zu]: tick %llu comes after tick %llu", i, (unsigned long long)was->tick,
                              (unsigned long long)state->tick);
        }
        if ((was->flags & HD_FLAG_GLITCH) != 0) {
            const double step_m =
                hypot(was->position_m[0] - state->position_m[0], was->position_m[1] - state->position_m[1]);
            /* The position jumped, even if the recorded samples imply a lower speed. */
            const double speed = input.interval_s > 0.0 ? step_m / input.interval_s : 0.0;
            const double least = world->table.max_speed_m_per_s;
            input.glitch_m_per_s = speed > least && isfinite(speed) ? speed : least;
        }
        state->tick = was->tick;
        hd_state_want_forces(state, (was->flags & HD_FLAG_FORCES_ON) != 0);
        samples[i].lateness_ns = was->lateness_ns;
        samples[i].work_ns = was->work_ns;
        hd_tick(world, state, &input, &samples[i]);
        if (state->event_count > 0) {
            take_events(state, &sink);
        }
    }
    *event_count = sink.count;
    return HD_OK;
}

int hd_simulate(const struct hd_world *world, struct hd_state *state, struct hd_sim *sim, size_t count,
                struct hd_sample *samples, double *truth, struct hd_event *events, size_t event_capacity,
                size_t *event_count) {
    const struct hd_table *table = &world->table;
    const int status = check_and_reserve(world, state);
    if (status != HD_OK) {
        return status;
    }
    struct event_sink sink = {.events = events, .capacity = event_capacity};
    for (size_t i = 0; i < count; i++) {
        struct hd_reading reading;
        struct hd_input input = {.periods = 1, .time_ns = period_time_ns(table, state->period++)};
        if (state->tick > 0) {
            hd_sim_advance(sim, 1);
        }
        hd_gesture_watch(state, sim, input.time_ns);
        if (truth != NULL) {
            double actuator[2];
            hd_sim_truth(sim, &truth[4 * i], &truth[4 * i + 2], actuator);
        }
        hd_sim_read(sim, &reading);
        hd_sense(state, table, &reading, NULL, &input);
        samples[i].lateness_ns = 0;
        samples[i].work_ns = 0;
        hd_tick(world, state, &input, &samples[i]);
        hd_sim_put(sim, samples[i].force_n);
        if (state->event_count > 0) {
            take_events(state, &sink);
        }
    }
    *event_count = sink.count;
    return HD_OK;
}

void hd_state_reset(struct hd_state *state, uint32_t slot, uint32_t generation, int64_t time_ns) {
    hd_tick_reset(state, slot, generation, time_ns);
}

int hd_play(struct hd_state *state, const struct hd_mode *mode, const double direction[2], double amplitude) {
    const int status = hd_play_check(mode, direction, amplitude);
    return status != HD_OK ? status : hd_tick_play(state, mode, direction, amplitude);
}
