/* The tick, top to bottom: sense, ring, touch, strike, limit, fade.
 *
 * Bounded work: it looks at the objects in reach and at the ringing modes once. Whatever it is given, the force it
 * returns is finite and within the table's limit; a NaN or an infinity anywhere latches HD_FAULT_NONFINITE and the
 * force is zero from that tick on. Called by the servo thread and by the offline runs alike. */
#include "tick/hd_tick.h"

#include "tick/hd_contact.h"
#include "tick/hd_limit.h"
#include "tick/hd_mode.h"
#include "tick/hd_offload.h"
#include "tick/hd_ramp.h"

/* Positions are rounded, so that motion at the very limit may seem to exceed it. */
#define HD_SPEED_ROUNDING 1e-9

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
        const double bound = table->max_speed_m_per_s * reading->interval_s * (1.0 + HD_SPEED_ROUNDING);
        if (hd_dot(step, step) > bound * bound) {
            input->glitch_m_per_s = hd_root(hd_dot(step, step)) / reading->interval_s;
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

/* Everything is met as if it had just appeared; but with `resume`, what was pressed is met from the side that it was
 * pressed from. */
HD_RT static void resynchronise(struct hd_state *state, const struct hd_input *input, int resume) {
    while (state->active_count > 0) {
        const uint32_t index = state->active[state->active_count - 1];
        if (resume) {
            hd_contact_clear(state, index, input->time_ns);
        } else {
            hd_contact_end(state, index, input->time_ns);
        }
    }
    hd_ramp_clear(state);
    state->field = (struct hd_field){.force_n = {0.0, 0.0}};
    state->field_known = 0;
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

/* The tick that met something that is not a number: zero, latched, and nothing of it is remembered. */
HD_RT static void stop(struct hd_state *state, const struct hd_input *input, struct hd_sample *sample) {
    hd_modes_silence(state);
    state->strike_count = 0;
    state->played_count = 0;
    state->offload_count = 0;
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

HD_RT static uint32_t ramping(const struct hd_state *state, const struct hd_table *table, double felt) {
    int any =
        state->field_ramp < 1.0 || state->gain != felt ||
        (!state->steady && (state->residual.left > 0 || state->show_vibration != (double)table->display_vibration));
    for (uint32_t i = 0; i < state->active_count && !any; i++) {
        any = state->slots[state->active[i]].ramp < 1.0;
    }
    return any ? (uint32_t)HD_FLAG_RAMPING : 0u;
}

/* The passivity controller's part: of what is felt, and of what would be felt if every ramp stood still. Returns
 * whether it changed the latter. */
HD_RT static int watch_energy(struct hd_context *context, double controlled, double object_n[2], double contact_n[2],
                              struct hd_ramped *ramped, uint32_t *flags) {
    struct hd_state *state = context->state;
    const double before[2] = {contact_n[0], contact_n[1]};
    const double still[2] = {ramped->still_n[0], ramped->still_n[1]};
    const struct hd_pushed is = {object_n, contact_n, state->controls};
    const struct hd_pushed was = {ramped->still_object_n, ramped->still_n, controlled};
    hd_passivity_tick(state, context->table, context->input, context->resync, &is, &was, flags);
    for (int axis = 0; axis < 2; axis++) {
        ramped->whole_n[axis] += contact_n[axis] - before[axis];
        ramped->still_whole_n[axis] += ramped->still_n[axis] - still[axis];
    }
    return ramped->still_n[0] != still[0] || ramped->still_n[1] != still[1];
}

HD_RT static void nothing_ramped(const double object_n[2], const double contact_n[2], struct hd_ramped *ramped) {
    ramped->changed = 0;
    for (int axis = 0; axis < 2; axis++) {
        ramped->still_n[axis] = ramped->still_whole_n[axis] = ramped->whole_n[axis] = contact_n[axis];
        ramped->still_object_n[axis] = object_n[axis];
    }
}

/* What is heard of the noise of this tick, and what would be if every ramp stood still, without the gains of `display`.
 */
HD_RT static void hear_noise(const struct hd_context *context, const struct hd_ramped *ramped,
                             const double contact_n[2], double shown, double noise_n[2], double still_n[2],
                             uint32_t *flags) {
    struct hd_state *state = context->state;
    const struct hd_table *table = context->table;
    const struct hd_change *change = &state->change;
    const struct hd_noisy is = {{context->noise_n[0], context->noise_n[1]}, context->noise_rms_n};
    double most_n;
    if (ramped->any || change->eases || shown != state->show_vibration) {
        struct hd_noisy was = {{0.0, 0.0}, context->noise_rms_n + change->noise_rms_n};
        for (int axis = 0; axis < 2; axis++) {
            was.noise_n[axis] = context->noise_n[axis] + change->noise_n[axis] - change->eased_n[axis];
        }
        const double still = hd_limit_noise(state, table, ramped->still_whole_n, &was, shown, &most_n);
        still_n[0] = still * was.noise_n[0];
        still_n[1] = still * was.noise_n[1];
    }
    const double *whole = ramped->any ? ramped->whole_n : contact_n;
    const double gain = hd_limit_noise(state, table, whole, &is, state->show_vibration, &most_n);
    noise_n[0] = gain * is.noise_n[0];
    noise_n[1] = gain * is.noise_n[1];
    if (gain < 1.0) {
        state->yields = 1;
        hd_limit_report(state, most_n, context->input->time_ns, flags);
    }
    state->noise_gain = gain;
}

HD_RT static inline int is_ringing(const struct hd_state *state) {
    return (state->active_mode_count | state->wave_count) != 0;
}

HD_RT void hd_tick(const struct hd_world *world, struct hd_state *state, const struct hd_input *input,
                   struct hd_sample *sample) {
    const struct hd_table *table = &world->table;
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

    struct hd_context context;
    context.world = world;
    context.table = table;
    context.state = state;
    context.input = input;
    context.new_table = state->revision != table->revision || !state->started;
    /* A ramp counts ticks, not the periods that were missed before it began. */
    context.ramp_step = table->ramp_step;
    context.force_n[0] = context.force_n[1] = 0.0;
    context.noise_n[0] = context.noise_n[1] = context.noise_rms_n = 0.0;
    if ((context.new_table || state->change.any) && state->started) {
        state->commanded_tick = state->tick;
        state->commanded = 1;
    }
    state->revision = table->revision;
    if (!state->started) {
        state->show_force = (double)table->display_force;
        state->show_vibration = (double)table->display_vibration;
    }
    /* A jump, or a stall longer than the ramp: what was felt before says nothing about now. */
    const int jumped = input->glitch_m_per_s > 0.0;
    const double elapsed = (double)input->periods * table->ramp_step; /* in ramps */
    const int stalled = state->started && elapsed > 1.0;
    context.resync = state->resync || !state->located || jumped || stalled;
    if (context.resync) {
        resynchronise(state, input, stalled && !jumped);
        state->resync = 0;
    }
    const double *from = context.resync ? input->position_m : state->position_m;
    context.from_m[0] = from[0];
    context.from_m[1] = from[1];
    if (jumped) {
        flags |= HD_FLAG_GLITCH;
        state->glitches_total++;
        hd_event_add(state, HD_EVENT_GLITCH, input->time_ns, 0, input->glitch_m_per_s);
    }

    state->ended_count = 0;
    if (is_ringing(state)) {
        hd_modes_advance(state, input->periods);
    }
    if (state->reserve_count > 0) {
        hd_offload_advance(state, input->periods);
    }
    hd_walk_objects(&context);
    context.object_n[0] = context.force_n[0];
    context.object_n[1] = context.force_n[1];
    hd_field_walk(&context);

    const double shows = (double)table->display_force;
    const double shown = state->show_vibration;
    double controlled = 0.0;
    double contact[2] = {shows * context.force_n[0], shows * context.force_n[1]};
    double object[2];
    struct hd_ramped ramped;
    ramped.any = 0;
    int watches = 0;
    int restrained = 0;
    int eases = 0;
    const int steady = state->steady && !context.new_table && !state->change.any && !state->change.eases;
    if (!steady) {
        state->show_vibration = toward(shown, (double)table->display_vibration, context.ramp_step);
        controlled = state->controls;
        const int controls = table->passivity == HD_PASSIVITY_CONTROL;
        ramped.cuts = controls || controlled > 0.0;
        if (ramped.cuts) {
            const double wanted = controls ? 1.0 : 0.0;
            state->controls = state->started ? toward(controlled, wanted, context.ramp_step) : wanted;
        }
        const int due = state->change.any || state->residual.left > 0 || state->show_force != shows || ramped.cuts;
        ramped.any = due && hd_ramp_contact(&context, object, contact, &ramped);
        watches = table->passivity != HD_PASSIVITY_OFF || ramped.cuts;
        eases = shown != state->show_vibration || state->change.eases;
        if (!ramped.any && (watches || eases)) {
            object[0] = shows * context.object_n[0];
            object[1] = shows * context.object_n[1];
            nothing_ramped(object, contact, &ramped);
        }
        if (watches) {
            restrained = watch_energy(&context, controlled, object, contact, &ramped, &flags);
        }
    }
    if (state->strike_count > 0) {
        /* A strike does not hear of ramps: what it leaves room for is what would be felt if they stood still. Noise
         * leaves room for it. */
        /* What the controller left is within the limit, which is not the scene's doing. */
        const int alone = ramped.any && ramped.cuts && state->residual.left == 0;
        const double *still = alone ? ramped.still_whole_n : ramped.any ? ramped.still_n : contact;
        if (hd_strikes_apply(state, table, hd_root(hd_dot(still, still))) < 1.0) {
            flags |= HD_FLAG_SATURATED;
        }
    }
    double vibration[2] = {0.0, 0.0};
    double noise_still[2] = {0.0, 0.0};
    state->yields = 0;
    if (context.noise_rms_n > 0.0 || state->change.eases || state->change.any) {
        hear_noise(&context, &ramped, contact, shown, vibration, noise_still, &flags);
    } else {
        state->noise_gain = 1.0;
    }
    if (is_ringing(state)) {
        vibration[0] += state->ringing_n[0];
        vibration[1] += state->ringing_n[1];
        flags |= HD_FLAG_RINGING;
    }
    vibration[0] *= state->show_vibration;
    vibration[1] *= state->show_vibration;

    double force[2];
    const int checking = input->checking && state->enabled;
    const double felt = state->enabled && !checking ? 1.0 : 0.0;
    /* Only on its way out does the command hurry: zero is due by the clock. */
    const double gain = toward(state->gain, felt, felt > 0.0 ? context.ramp_step : elapsed);
    if (ramped.any || eases) {
        double still[2];
        for (int axis = 0; axis < 2; axis++) {
            const double noise = noise_still[axis];
            still[axis] = shown * (is_ringing(state) ? noise + state->ringing_n[axis] : noise);
            ramped.held_n[axis] = 0.0;
        }
        hd_ramp_command(&context, &ramped, contact, vibration, still, gain - state->gain, force, &flags);
        if (restrained && (ramped.held_n[0] != 0.0 || ramped.held_n[1] != 0.0)) {
            flags |= HD_FLAG_RESTRAINED; /* the command is held at what the controller left */
        }
    } else {
        hd_limit_apply(state, table, contact, vibration, input->time_ns, force, &flags);
    }
    const int checked = checking && gain == 0.0 && state->gain == 0.0;
    if (checked) {
        const double cut = hd_limit_cut(input->check_n, table->max_force_n);
        force[0] = cut * input->check_n[0];
        force[1] = cut * input->check_n[1];
    }
    if (!finite4(force, contact)) {
        stop(state, input, sample);
        sample->flags = flags | HD_FLAG_FAULT;
        state->tick++;
        return;
    }
    state->gain = gain;
    if (watches) {
        double held[2] = {contact[0], contact[1]};
        for (int axis = 0; axis < 2 && (ramped.any || eases); axis++) { /* what was held is commanded, too */
            held[axis] += ramped.held_n[axis];
            object[axis] += ramped.held_n[axis];
        }
        hd_passivity_hold(&state->passivity, table, state->tick, state->gain, object, held);
    }
    if (!steady) {
        state->steady = !watches && state->residual.left == 0 && !state->change.any && !state->change.eases &&
                        state->show_force == shows && state->show_vibration == (double)table->display_vibration;
    }
    flags |= (state->active_count > 0 ? HD_FLAG_CONTACT : 0u) | (state->enabled ? HD_FLAG_FORCES_ON : 0u) |
             (state->faults != 0 ? HD_FLAG_FAULT : 0u) | (checking ? HD_FLAG_CHECKING : 0u) |
             ramping(state, table, felt);
    const double *whole = ramped.any ? ramped.whole_n : contact;
    for (int axis = 0; axis < 2; axis++) {
        sample->position_m[axis] = input->position_m[axis];
        sample->velocity_m_per_s[axis] = input->velocity_m_per_s[axis];
        sample->contact_force_n[axis] = whole[axis];
        sample->vibration_force_n[axis] = vibration[axis];
        sample->force_n[axis] = checked ? force[axis] : state->gain * force[axis];
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

HD_RT void hd_tick_reset(struct hd_state *state, uint32_t slot, uint32_t generation, int64_t time_ns) {
    if (slot == HD_NO_SLOT) {
        while (state->active_count > 0) {
            hd_contact_clear(state, state->active[state->active_count - 1], time_ns);
        }
        while (state->healing_count > 0) {
            hd_contact_close(state, state->healing[state->healing_count - 1]);
        }
        state->epoch = state->epoch == UINT32_MAX ? 1u : state->epoch + 1u;
    } else if (slot < state->slot_capacity && state->slots[slot].generation == generation) {
        if (state->slots[slot].touched) {
            hd_contact_clear(state, slot, time_ns);
        }
        hd_contact_close(state, slot);
    }
}
