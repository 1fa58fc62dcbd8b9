/* The tick, top to bottom: sense, ring, touch, strike, limit, fade.
 *
 * Bounded work: it walks the objects of the table once and the ringing modes twice. Whatever it is given, the force it
 * returns is finite and within the table's limit; a NaN or an infinity anywhere latches HD_FAULT_NONFINITE and the
 * force is zero from that tick on. Called by the servo thread and by the offline runs alike. */
#include "hd_tick.h"

#include <math.h>

#include "hd_contact.h"
#include "hd_limit.h"
#include "hd_voice.h"

HD_RT static inline int finite4(const double a[2], const double b[2]) {
    return (a[0] + a[1] + b[0] + b[1]) * 0.0 == 0.0;
}

HD_RT void hd_sense(struct hd_state *state, const struct hd_table *table, const struct hd_reading *reading,
                    const double *velocity, struct hd_input *input) {
    const double *position = reading->position_m;
    input->interval_s = reading->interval_s;
    input->glitch_m_per_s = 0.0;
    for (int axis = 0; axis < 2; axis++) {
        input->position_m[axis] = position[axis];
        input->true_velocity_m_per_s[axis] = reading->true_velocity_m_per_s[axis];
    }
    if (!finite4(position, position)) {
        hd_velocity_reset(&state->velocity);
        input->velocity_m_per_s[0] = 0.0;
        input->velocity_m_per_s[1] = 0.0;
        return; /* the tick sees it and latches the fault */
    }
    if (state->located && reading->interval_s > 0.0) {
        const double step[2] = {position[0] - state->position_m[0], position[1] - state->position_m[1]};
        const double bound = table->max_speed_m_per_s * reading->interval_s;
        if (hd_dot(step, step) > bound * bound) {
            HD_RT_FOREIGN_BEGIN
            input->glitch_m_per_s = sqrt(hd_dot(step, step)) / reading->interval_s;
            HD_RT_FOREIGN_END
            hd_velocity_reset(&state->velocity);
        }
    }
    if (velocity != NULL) {
        input->velocity_m_per_s[0] = velocity[0];
        input->velocity_m_per_s[1] = velocity[1];
    } else {
        hd_velocity_update(&state->velocity, reading->interval_s, position, input->velocity_m_per_s);
    }
}

/* Everything is met as if it had just appeared; but with `resume`, a membrane that was pressed is met from the side
 * that it was pressed from. */
HD_RT static void resynchronise(struct hd_state *state, const struct hd_input *input, int resume) {
    while (state->active_count > 0) {
        const uint32_t index = state->active[state->active_count - 1];
        state->slots[index].resume = resume ? state->slots[index].side : 0;
        hd_contact_end(state, index, input->time_ns);
    }
    state->residual_n[0] = 0.0;
    state->residual_n[1] = 0.0;
    state->residual_left = 0;
    if (state->started) {
        state->field = (struct hd_field){.force_n = {0.0, 0.0}};
        state->field_from = state->field;
        state->field_blend = 0.0;
    }
}

HD_RT static inline double toward(double value, double target, double step) {
    if (value == target) {
        return target;
    }
    if (value < target) {
        return value + step < target ? value + step : target;
    }
    return value - step > target ? value - step : target;
}

/* The table changed: objects that went away under the hand let go. */
HD_RT static void drop_unseen(struct hd_walk *walk) {
    struct hd_state *state = walk->state;
    uint32_t i = 0;
    while (i < state->active_count) {
        const uint32_t slot = state->active[i];
        if (state->slots[slot].seen_tick != state->tick) {
            hd_contact_drop(walk, slot);
        } else {
            i++;
        }
    }
}

HD_RT static void fade_residual(struct hd_state *state) {
    if (state->residual_left <= 1) {
        state->residual_left = 0;
        state->residual_n[0] = 0.0;
        state->residual_n[1] = 0.0;
    } else {
        state->residual_left--;
        state->residual_n[0] -= state->residual_step_n[0];
        state->residual_n[1] -= state->residual_step_n[1];
    }
}

/* The tick that met something that is not a number: zero, latched, and nothing of it is remembered. */
HD_RT static void stop(struct hd_state *state, const struct hd_input *input, struct hd_sample *sample) {
    hd_voices_silence(state);
    state->strike_count = 0;
    state->played_count = 0;
    resynchronise(state, input, 0);
    state->resync = 1;
    state->located = 0;
    hd_state_latch(state, HD_FAULT_NONFINITE, 1, input->time_ns);
    for (int axis = 0; axis < 2; axis++) {
        sample->position_m[axis] = state->position_m[axis];
        sample->velocity_m_per_s[axis] = 0.0;
        sample->contact_force_n[axis] = 0.0;
        sample->vibration_force_n[axis] = 0.0;
        sample->force_n[axis] = 0.0;
    }
}

HD_RT static uint32_t ramping(const struct hd_state *state, const struct hd_table *table) {
    int any = state->residual_left > 0 || state->field_blend < 1.0 || state->gain != (double)state->enabled ||
              state->show_force != (double)table->display_force ||
              state->show_vibration != (double)table->display_vibration;
    for (uint32_t i = 0; i < state->active_count && !any; i++) {
        const struct hd_slot *slot = &state->slots[state->active[i]];
        any = slot->ramp < 1.0 || slot->blend < 1.0;
    }
    return any ? (uint32_t)HD_FLAG_RAMPING : 0u;
}

HD_RT void hd_tick(const struct hd_table *table, struct hd_state *state, const struct hd_input *input,
                   struct hd_sample *sample) {
    sample->tick = state->tick;
    sample->time_ns = input->time_ns;
    sample->revision = table->revision;
    uint32_t flags = (input->periods != 1 && state->started ? HD_FLAG_SKIPPED : 0u) |
                     (input->interval_s > 0.0 || !state->located ? 0u : HD_FLAG_REPEATED);
    if (!finite4(input->position_m, input->velocity_m_per_s)) {
        stop(state, input, sample);
        sample->flags = flags | HD_FLAG_FAULT;
        state->tick++;
        return;
    }

    struct hd_walk walk = {
        .table = table,
        .state = state,
        .input = input,
        .from_m = {state->position_m[0], state->position_m[1]},
        /* A ramp counts ticks, not the periods that were missed before it began. */
        .ramp_step = table->ramp_step,
    };
    if (!state->started) {
        state->show_force = (double)table->display_force;
        state->show_vibration = (double)table->display_vibration;
    }
    /* A jump, or a stall longer than the ramp: what was felt before says nothing about now. */
    const int jumped = input->glitch_m_per_s > 0.0;
    const double elapsed = (double)input->periods * table->ramp_step; /* in ramps */
    const int stalled = state->started && elapsed > 1.0;
    walk.resync = state->resync || !state->located || jumped || stalled;
    if (walk.resync) {
        resynchronise(state, input, stalled && !jumped);
        state->resync = 0;
    }
    if (jumped) {
        flags |= HD_FLAG_GLITCH;
        state->glitches_total++;
        const uint32_t event = hd_state_event(state, HD_EVENT_GLITCH, input->time_ns);
        if (event < HD_EVENT_CAPACITY) {
            state->events[event].value = input->glitch_m_per_s;
        }
    }

    if (state->voice_count > 0) {
        hd_voices_advance(state, input->periods, table->period_s);
    }
    if (table->wall_count > 0) {
        hd_walls_walk(&walk);
    }
    if (table->membrane_count > 0) {
        hd_membranes_walk(&walk);
    }
    hd_field_walk(&walk);
    if (state->revision != table->revision) {
        drop_unseen(&walk);
        state->revision = table->revision;
    }

    state->show_force = toward(state->show_force, (double)table->display_force, walk.ramp_step);
    state->show_vibration = toward(state->show_vibration, (double)table->display_vibration, walk.ramp_step);
    double contact[2] = {state->show_force * walk.force_n[0], state->show_force * walk.force_n[1]};
    if (state->residual_left > 0) {
        contact[0] += state->residual_n[0];
        contact[1] += state->residual_n[1];
        fade_residual(state);
    }
    if (state->strike_count > 0) {
        HD_RT_FOREIGN_BEGIN
        const double felt = sqrt(hd_dot(contact, contact));
        HD_RT_FOREIGN_END
        if (hd_strikes_apply(state, table, felt) < 1.0) {
            flags |= HD_FLAG_SATURATED;
        }
    }
    double vibration[2] = {0.0, 0.0};
    if (state->voice_count > 0) {
        hd_voices_sum(state, vibration);
        vibration[0] *= state->show_vibration;
        vibration[1] *= state->show_vibration;
        flags |= HD_FLAG_RINGING;
    }

    double force[2];
    hd_limit_apply(state, table, contact, vibration, input->time_ns, force, &flags);
    if (!finite4(force, contact)) {
        stop(state, input, sample);
        sample->flags = flags | HD_FLAG_FAULT;
        state->tick++;
        return;
    }
    /* Only on its way out does the command hurry: zero is due by the clock. */
    state->gain = toward(state->gain, (double)state->enabled, state->enabled ? walk.ramp_step : elapsed);
    flags |= (state->active_count > 0 ? HD_FLAG_CONTACT : 0u) | (state->enabled ? HD_FLAG_FORCES_ON : 0u) |
             (state->faults != 0 ? HD_FLAG_FAULT : 0u) | ramping(state, table);
    for (int axis = 0; axis < 2; axis++) {
        sample->position_m[axis] = input->position_m[axis];
        sample->velocity_m_per_s[axis] = input->velocity_m_per_s[axis];
        sample->contact_force_n[axis] = contact[axis];
        sample->vibration_force_n[axis] = vibration[axis];
        sample->force_n[axis] = state->gain * force[axis];
        state->position_m[axis] = input->position_m[axis];
    }
    sample->flags = flags;
    state->located = 1;
    state->started = 1;
    state->played_count = 0;
    state->tick++;
}

HD_RT int hd_tick_play(struct hd_state *state, const struct hd_mode *mode, const double direction[2],
                       double amplitude) {
    if (state->played_count == HD_PLAYED_CAPACITY) {
        return HD_ERR_FULL;
    }
    struct hd_mode *played = &state->played[state->played_count++];
    *played = *mode;
    const struct hd_strike strike = {
        .mode = played,
        .slot = HD_PLAY_SLOT,
        .event = HD_EVENT_CAPACITY,
        .units = amplitude,
        .direction = {direction[0], direction[1]},
    };
    hd_strike_add(state, &strike);
    return HD_OK;
}

HD_RT static void reset_slot(struct hd_walk *walk, uint32_t index) {
    struct hd_slot *slot = &walk->state->slots[index];
    slot->resume = slot->touched ? slot->side : 0;
    if (slot->touched) {
        hd_contact_drop(walk, index);
    }
    slot->open = 0;
    slot->known = 0;
    slot->last_side = 0;
}

HD_RT void hd_tick_reset(const struct hd_table *table, struct hd_state *state, uint32_t slot, uint32_t generation,
                         int64_t time_ns) {
    const struct hd_input input = {.time_ns = time_ns, .periods = 1};
    struct hd_walk walk = {.table = table, .state = state, .input = &input};
    if (slot == HD_NO_SLOT) {
        for (uint32_t i = 0; i < table->wall_count; i++) {
            reset_slot(&walk, table->walls[i].key.slot);
        }
        for (uint32_t i = 0; i < table->membrane_count; i++) {
            reset_slot(&walk, table->membranes[i].key.slot);
        }
    } else if (slot < state->slot_capacity && state->slots[slot].generation == generation) {
        reset_slot(&walk, slot);
    }
}
