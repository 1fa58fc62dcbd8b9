/* Results of a tick for control: its sample and its events in rings that count lost records, touched objects in a
 * triple buffer, and counters. The servo writes; one reader takes samples, events and touched objects; any thread reads
 * the counters. */
#include "servo/hd_servo.h"

#include <string.h>

/* Room in the event ring that is reserved for ends of gestures, in addition to HD_MARKS for marks. */
#define HD_GESTURE_ENDS 64u

/* ---- The servo thread -------------------------------------------------------------------------------------------- */

/* Returns the room that an event of this kind must leave free: marks and ends of gestures have reserved room, because
 * clients wait for them. */
HD_RT static size_t reserved_room(uint32_t kind) {
    return kind == HD_EVENT_MARK ? 0u : kind == HD_EVENT_GESTURE_END ? HD_MARKS : HD_MARKS + HD_GESTURE_ENDS;
}

HD_RT static void write_events(struct hd_servo *servo) {
    struct hd_state *state = servo->state;
    size_t room = hd_ring_free_space(&servo->events);
    for (uint32_t i = 0; i < state->event_count; i++) {
        const struct hd_event *event = &state->events[i];
        if (room > reserved_room(event->kind) && hd_ring_push(&servo->events, event) == HD_OK) {
            room--;
        } else {
            hd_ring_drop(&servo->events);
        }
    }
    state->event_count = 0;
    while (state->events_dropped > 0) {
        hd_ring_drop(&servo->events);
        state->events_dropped--;
    }
}

HD_RT static void publish_touched(struct hd_servo *servo) {
    const struct hd_state *state = servo->state;
    struct hd_touching *touching = &servo->touching[hd_triple_back(&servo->touching_triple)];
    touching->count = state->active_count < HD_TOUCHED_MAX ? state->active_count : HD_TOUCHED_MAX;
    for (uint32_t i = 0; i < touching->count; i++) {
        const uint32_t slot = state->active[i];
        touching->touched[i] = (struct hd_touched){slot, state->slots[slot].generation};
    }
    hd_triple_publish(&servo->touching_triple);
    servo->touches_published = state->touches;
}

HD_RT static void write_sample(struct hd_servo *servo, const struct hd_sample *sample) {
    struct hd_sample *slot = hd_ring_reserve(&servo->samples);
    if (slot == NULL) {
        hd_ring_drop(&servo->samples);
        return;
    }
    *slot = *sample;
    hd_ring_commit(&servo->samples);
}

HD_RT static void publish_energy(struct hd_servo *servo) {
    const struct hd_passivity *passivity = &servo->state->passivity;
    hd_atomic_f64_store_relaxed(&servo->energy_j, passivity->energy_j);
    hd_atomic_f64_store_relaxed(&servo->largest_energy_j, passivity->largest_j);
    hd_atomic_u64_store_relaxed(&servo->contacts, passivity->contacts);
    hd_atomic_u64_store_relaxed(&servo->restrained, passivity->restrained);
    hd_atomic_u64_store_relaxed(&servo->acted, passivity->acted);
}

HD_RT void hd_servo_leave(struct hd_servo *servo, const struct hd_sample *sample) {
    const struct hd_state *state = servo->state;
    hd_histogram_count(&servo->lateness, servo->late_ns);
    hd_histogram_count(&servo->work, servo->last_work_ns);
    hd_atomic_u64_store_relaxed(&servo->strikes, state->strikes_total);
    hd_atomic_u64_store_relaxed(&servo->glitches, state->glitches_total);
    hd_atomic_u64_store_relaxed(&servo->saturations, state->saturations_total);
    if (servo->world->table.passivity != HD_PASSIVITY_OFF) {
        publish_energy(servo);
    }
    hd_atomic_u32_store_relaxed(&servo->faults, state->faults);
    hd_atomic_u32_store_relaxed(&servo->forces_on, state->enabled);
    /* The order matters: a reader that has a tick's sample also gets its events, and a reader that has an event sees
     * its effect in the counters and the touched objects. The rings store with release order. */
    if (servo->touches_published != state->touches) {
        publish_touched(servo);
    }
    if (state->event_count > 0) {
        write_events(servo);
    }
    write_sample(servo, sample);
    hd_atomic_u64_store_release(&servo->ticks, state->tick);
}

/* ---- Control side ------------------------------------------------------------------------------------------------ */

void hd_servo_counters(const struct hd_servo *servo, struct hd_counters *counters) {
    /* The order matters: after `running` is 0, `ticks` is final, and the other counters are at least as new as
     * `ticks`. */
    const uint32_t running = hd_atomic_u32_load_acquire(&servo->running);
    const uint64_t ticks = hd_atomic_u64_load_acquire(&servo->ticks);
    *counters = (struct hd_counters){
        .ticks = ticks,
        .skipped = hd_atomic_u64_load_relaxed(&servo->skipped),
        .overruns = hd_atomic_u64_load_relaxed(&servo->overruns),
        .samples_dropped = hd_ring_dropped(&servo->samples),
        .events_dropped = hd_ring_dropped(&servo->events),
        .strikes = hd_atomic_u64_load_relaxed(&servo->strikes),
        .glitches = hd_atomic_u64_load_relaxed(&servo->glitches),
        .saturations = hd_atomic_u64_load_relaxed(&servo->saturations),
        .revision = hd_atomic_u32_load_relaxed(&servo->revision),
        .faults = hd_atomic_u32_load_relaxed(&servo->faults),
        .forces_on = hd_atomic_u32_load_relaxed(&servo->forces_on),
        .running = running,
        .memory_refused = hd_atomic_u32_load_relaxed(&servo->memory_refused),
        .overloaded = hd_atomic_u32_load_relaxed(&servo->overloaded),
        .overloads = hd_atomic_u64_load_relaxed(&servo->overloads),
        .suspends = hd_atomic_u64_load_relaxed(&servo->suspends),
        .missed_share = hd_atomic_f64_load_relaxed(&servo->missed_share),
        .signs = hd_atomic_u32_load_relaxed(&servo->signs),
        .energy =
            {
                .energy_j = hd_atomic_f64_load_relaxed(&servo->energy_j),
                .largest_j = hd_atomic_f64_load_relaxed(&servo->largest_energy_j),
                .contacts = hd_atomic_u64_load_relaxed(&servo->contacts),
                .restrained = hd_atomic_u64_load_relaxed(&servo->restrained),
                .acted = hd_atomic_u64_load_relaxed(&servo->acted),
            },
    };
}

void hd_servo_histograms(const struct hd_servo *servo, struct hd_histograms *histograms) {
    hd_histogram_read(&servo->lateness, &histograms->lateness);
    hd_histogram_read(&servo->work, &histograms->work);
}

size_t hd_servo_read_samples(struct hd_servo *servo, struct hd_sample *samples, size_t capacity, uint64_t *dropped) {
    const size_t count = hd_ring_pop_many(&servo->samples, samples, capacity);
    *dropped = hd_ring_dropped(&servo->samples);
    return count;
}

size_t hd_servo_read_events(struct hd_servo *servo, struct hd_event *events, size_t capacity, uint64_t *dropped) {
    const size_t count = hd_ring_pop_many(&servo->events, events, capacity);
    *dropped = hd_ring_dropped(&servo->events);
    return count;
}

size_t hd_servo_read_touched(struct hd_servo *servo, struct hd_touched *touched) {
    hd_triple_acquire(&servo->touching_triple);
    const struct hd_touching *touching = &servo->touching[hd_triple_front(&servo->touching_triple)];
    memcpy(touched, touching->touched, touching->count * sizeof *touched);
    return touching->count;
}
