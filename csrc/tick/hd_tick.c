/* The tick, in the order of its stages: position, ringing modes, contacts, strikes, force limit, gain of the command.
 *
 * The work is bounded: a tick visits the objects in reach and the ringing modes once. For any input the force is finite
 * and within the table's limit: NaN or infinity at any stage latches HD_FAULT_NONFINITE, and the force is zero from
 * that tick on. Called by the servo thread and by offline runs. */
#include "tick/hd_tick.h"

#include "tick/hd_contact.h"
#include "tick/hd_context.h"
#include "tick/hd_field.h"
#include "tick/hd_limit.h"
#include "tick/hd_mode.h"
#include "tick/hd_narrow_phase.h"
#include "tick/hd_offload.h"
#include "tick/hd_passivity.h"
#include "tick/hd_ramp.h"
#include "tick/hd_stream.h"
#include "tick/hd_strike.h"

/* Relative tolerance of the speed limit: rounded positions can make a motion at the limit appear faster. */
#define HD_SPEED_ROUNDING 1e-9

HD_RT static inline int are_finite(const double a[2], const double b[2]) {
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
    if (!are_finite(position, position)) {
        hd_velocity_reset(&state->velocity);
        input->velocity_m_per_s[0] = 0.0;
        input->velocity_m_per_s[1] = 0.0;
        return; /* the tick finds the position and latches the fault */
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

/* Ends all contacts, so that objects are touched as if they had just appeared. With `resume` an object that was pressed
 * is touched again from the same side. */
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
    hd_stream_drop(state);
}

HD_RT static inline double move_toward(double value, double target, double step) {
    if (value == target) {
        return target;
    }
    if (value < target) {
        return value + step < target ? value + step : target;
    }
    return value - step > target ? value - step : target;
}

/* Ends a tick in which NaN or infinity was found: the force is zero, the fault is latched, the state is cleared. */
HD_RT static void stop_at_nonfinite(struct hd_state *state, const struct hd_input *input, uint32_t flags,
                                    struct hd_sample *sample) {
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
    sample->flags = flags | HD_FLAG_FAULT;
    state->tick++;
}

HD_RT static uint32_t ramping_flag(const struct hd_state *state, const struct hd_table *table, double felt) {
    int any = state->field_ramp < 1.0 || state->gain != felt ||
              (!state->steady &&
               (state->residual.remaining > 0 || state->show_vibration != (double)table->display_vibration));
    for (uint32_t i = 0; i < state->active_count && !any; i++) {
        any = state->slots[state->active[i]].ramp < 1.0;
    }
    return any ? (uint32_t)HD_FLAG_RAMPING : 0u;
}

HD_RT static inline int is_ringing(const struct hd_state *state) {
    return (state->active_mode_count | state->wave_count) != 0;
}

/* The data that the stages of a tick share. */
struct tick {
    uint32_t flags;
    int steady;              /* no ramp, residual or passivity control is active */
    int watches;             /* the passivity observer is active */
    int restrained;          /* the controller changed the force that would be felt with every ramp stopped */
    int eases;               /* vibration is on a ramp */
    double elapsed;          /* time since the last tick, in ramp durations */
    double shown;            /* gain of vibration at the last tick */
    double contact_n[2];     /* contact force as it is displayed: with its weights, its ramps and the controller */
    double object_n[2];      /* the part of it that objects exert; set where a ramp or the observer uses it */
    double vibration_n[2];   /* noise and modes as they are displayed */
    double noise_still_n[2]; /* noise with every ramp stopped, without the gains of `display` */
    double force_n[2];       /* the command, before its gain */
    struct hd_ramped ramped;
    struct hd_context context; /* at the end, because it is large: keeps the other members near the top of the stack */
};

/* Fills in the context and finds whether the table is new. */
HD_RT static inline void begin_tick(struct tick *tick, const struct hd_world *world, struct hd_state *state,
                                    const struct hd_input *input) {
    struct hd_context *context = &tick->context;
    const struct hd_table *table = &world->table;
    context->world = world;
    context->table = table;
    context->state = state;
    context->input = input;
    context->new_table = state->revision != table->revision || !state->started;
    /* A ramp counts ticks: periods that were missed before it began do not shorten it. */
    context->ramp_step = table->ramp_step;
    context->force_n[0] = context->force_n[1] = 0.0;
    context->noise_n[0] = context->noise_n[1] = context->noise_rms_n = 0.0;
    if ((context->new_table || state->change.any) && state->started) {
        state->commanded_tick = state->tick;
        state->commanded = 1;
    }
    state->revision = table->revision;
    if (!state->started) {
        state->show_force = (double)table->display_force;
        state->show_vibration = (double)table->display_vibration;
    }
    state->ended_count = 0;
    state->yields = 0;
    tick->elapsed = (double)input->periods * table->ramp_step;
}

/* Sets the path of the probe. After a jump, or a stall longer than the ramp, contacts are cleared, since the earlier
 * force does not apply to the new position. */
HD_RT static inline void locate_probe(struct tick *tick) {
    struct hd_context *context = &tick->context;
    struct hd_state *state = context->state;
    const struct hd_input *input = context->input;
    const int jumped = input->glitch_m_per_s > 0.0;
    const int stalled = state->started && tick->elapsed > 1.0;
    context->resync = state->resync || !state->located || jumped || stalled;
    if (context->resync) {
        resynchronise(state, input, stalled && !jumped);
        state->resync = 0;
    }
    const double *from = context->resync ? input->position_m : state->position_m;
    for (int axis = 0; axis < 2; axis++) {
        context->proxy.from_m[axis] = from[axis];
        context->proxy.to_m[axis] = input->position_m[axis];
    }
    if (jumped) {
        tick->flags |= HD_FLAG_GLITCH;
        state->glitches_total++;
        hd_event_add(state, HD_EVENT_GLITCH, input->time_ns, 0, input->glitch_m_per_s);
    }
}

/* Advances the modes, the waveforms and the effects of the device. */
HD_RT static inline void advance_vibration(struct hd_state *state, uint32_t periods) {
    if (is_ringing(state)) {
        hd_modes_advance(state, periods);
    }
    if (state->reserve_count > 0) {
        hd_offload_advance(state, periods);
    }
}

/* Adds the forces of objects, fields and stream to the context. */
HD_RT static inline void add_contact_forces(struct tick *tick) {
    struct hd_context *context = &tick->context;
    hd_narrow_phase(context);
    context->object_n[0] = context->force_n[0];
    context->object_n[1] = context->force_n[1];
    hd_field_add(context);
    if (context->state->streams) {
        hd_stream_add(context);
        tick->flags |= HD_FLAG_STREAMED;
    }
}

/* Runs the passivity observer and controller, on the contact force that is felt and on the one that would be felt with
 * every ramp stopped. `controlled`: weight of the controller at the last tick. */
HD_RT static void control_passivity(struct tick *tick, double controlled) {
    struct hd_context *context = &tick->context;
    struct hd_ramped *ramped = &tick->ramped;
    struct hd_state *state = context->state;
    const double before[2] = {tick->contact_n[0], tick->contact_n[1]};
    const double still[2] = {ramped->still_n[0], ramped->still_n[1]};
    const struct hd_pushed is = {tick->object_n, tick->contact_n, state->controls};
    const struct hd_pushed was = {ramped->still_object_n, ramped->still_n, controlled};
    hd_passivity_tick(state, context->table, context->input, context->resync, &is, &was, &tick->flags);
    for (int axis = 0; axis < 2; axis++) {
        ramped->whole_n[axis] += tick->contact_n[axis] - before[axis];
        ramped->still_whole_n[axis] += ramped->still_n[axis] - still[axis];
    }
    tick->restrained = ramped->still_n[0] != still[0] || ramped->still_n[1] != still[1];
}

/* Fills in `ramped` where no ramp of the contact force is active: all of its forces are the contact force. */
HD_RT static void copy_unramped(struct tick *tick) {
    struct hd_ramped *ramped = &tick->ramped;
    const double shows = (double)tick->context.table->display_force;
    ramped->changed = 0;
    for (int axis = 0; axis < 2; axis++) {
        tick->object_n[axis] = shows * tick->context.object_n[axis];
        ramped->still_n[axis] = ramped->still_whole_n[axis] = ramped->whole_n[axis] = tick->contact_n[axis];
        ramped->still_object_n[axis] = tick->object_n[axis];
    }
}

/* Applies the ramps of commands and the passivity controller to the contact force. */
HD_RT static void ramp_contact(struct tick *tick) {
    struct hd_context *context = &tick->context;
    const struct hd_table *table = context->table;
    struct hd_state *state = context->state;
    struct hd_ramped *ramped = &tick->ramped;
    state->show_vibration = move_toward(tick->shown, (double)table->display_vibration, context->ramp_step);
    const double controlled = state->controls;
    const int controls = table->passivity == HD_PASSIVITY_CONTROL;
    ramped->cuts = controls || controlled > 0.0;
    if (ramped->cuts) {
        const double wanted = controls ? 1.0 : 0.0;
        state->controls = state->started ? move_toward(controlled, wanted, context->ramp_step) : wanted;
    }
    const int due = state->change.any || state->change.streams || state->residual.remaining > 0 ||
                    state->show_force != (double)table->display_force || ramped->cuts;
    ramped->any = due && hd_ramp_contact(context, tick->object_n, tick->contact_n, ramped);
    tick->watches = table->passivity != HD_PASSIVITY_OFF || ramped->cuts;
    tick->eases = tick->shown != state->show_vibration || state->change.eases;
    if (!ramped->any && (tick->watches || tick->eases)) {
        copy_unramped(tick);
    }
    if (tick->watches) {
        control_passivity(tick, controlled);
    }
}

/* Computes the contact force as it is displayed. */
HD_RT static inline void display_contact(struct tick *tick) {
    const struct hd_context *context = &tick->context;
    const struct hd_state *state = context->state;
    const double shows = (double)context->table->display_force;
    tick->shown = state->show_vibration;
    tick->contact_n[0] = shows * context->force_n[0];
    tick->contact_n[1] = shows * context->force_n[1];
    tick->ramped.any = 0;
    tick->watches = 0;
    tick->restrained = 0;
    tick->eases = 0;
    tick->steady = state->steady && !context->new_table && !state->change.any && !state->change.eases;
    if (!tick->steady) {
        ramp_contact(tick);
    }
}

/* Starts the strikes of this tick, scaled to the room within the force limit. Room is left for the contact force that
 * would be felt with every ramp stopped, so that ramps do not change strikes; where that force was cut to the limit
 * only for the passivity controller, the uncut force counts. Noise is scaled later and leaves room for strikes. */
HD_RT static void start_strikes(struct tick *tick) {
    struct hd_state *state = tick->context.state;
    const struct hd_ramped *ramped = &tick->ramped;
    const int alone = ramped->any && ramped->cuts && state->residual.remaining == 0;
    const double *still_n = alone ? ramped->still_whole_n : ramped->any ? ramped->still_n : tick->contact_n;
    if (hd_strikes_apply(state, tick->context.table, hd_root(hd_dot(still_n, still_n))) < 1.0) {
        tick->flags |= HD_FLAG_SATURATED;
    }
}

/* Computes the noise of this tick within the limit, and the noise with every ramp stopped. */
HD_RT static void add_noise(struct tick *tick) {
    const struct hd_context *context = &tick->context;
    const struct hd_ramped *ramped = &tick->ramped;
    const struct hd_table *table = context->table;
    struct hd_state *state = context->state;
    const struct hd_change *change = &state->change;
    const struct hd_noisy is = {{context->noise_n[0], context->noise_n[1]}, context->noise_rms_n};
    double most_n;
    if (ramped->any || change->eases || tick->shown != state->show_vibration) {
        struct hd_noisy was = {{0.0, 0.0}, context->noise_rms_n + change->noise_rms_n};
        for (int axis = 0; axis < 2; axis++) {
            was.noise_n[axis] = context->noise_n[axis] + change->noise_n[axis] - change->eased_n[axis];
        }
        const double still = hd_limit_noise(state, table, ramped->still_whole_n, &was, tick->shown, &most_n);
        tick->noise_still_n[0] = still * was.noise_n[0];
        tick->noise_still_n[1] = still * was.noise_n[1];
    }
    const double *whole_n = ramped->any ? ramped->whole_n : tick->contact_n;
    const double gain = hd_limit_noise(state, table, whole_n, &is, state->show_vibration, &most_n);
    tick->vibration_n[0] = gain * is.noise_n[0];
    tick->vibration_n[1] = gain * is.noise_n[1];
    if (gain < 1.0) {
        state->yields = 1;
        hd_limit_report(state, most_n, context->input->time_ns, &tick->flags);
    }
    state->noise_gain = gain;
}

/* Computes the vibration, which is noise, modes and waveforms, as it is displayed. */
HD_RT static inline void add_vibration(struct tick *tick) {
    struct hd_state *state = tick->context.state;
    for (int axis = 0; axis < 2; axis++) {
        tick->vibration_n[axis] = 0.0;
        tick->noise_still_n[axis] = 0.0;
    }
    if (tick->context.noise_rms_n > 0.0 || state->change.eases || state->change.any) {
        add_noise(tick);
    } else {
        state->noise_gain = 1.0;
    }
    if (is_ringing(state)) {
        tick->vibration_n[0] += state->ringing_n[0];
        tick->vibration_n[1] += state->ringing_n[1];
        tick->flags |= HD_FLAG_RINGING;
    }
    tick->vibration_n[0] *= state->show_vibration;
    tick->vibration_n[1] *= state->show_vibration;
}

/* Computes the command within the limit while a ramp is active. `gain_step`: change of the gain in this tick. */
HD_RT static void ramp_command(struct tick *tick, double gain_step) {
    struct hd_ramped *ramped = &tick->ramped;
    const struct hd_state *state = tick->context.state;
    double still_n[2];
    for (int axis = 0; axis < 2; axis++) {
        const double noise_n = tick->noise_still_n[axis];
        still_n[axis] = tick->shown * (is_ringing(state) ? noise_n + state->ringing_n[axis] : noise_n);
        ramped->held_n[axis] = 0.0;
    }
    ramped->held_of_objects = 0;
    hd_ramp_command(&tick->context, ramped, tick->contact_n, tick->vibration_n, still_n, gain_step, tick->force_n,
                    &tick->flags);
    if (tick->restrained && (ramped->held_n[0] != 0.0 || ramped->held_n[1] != 0.0)) {
        tick->flags |= HD_FLAG_RESTRAINED; /* the command stays at the force that the controller allowed */
    }
}

/* Reports the new command to the passivity observer. */
HD_RT static void record_command(struct tick *tick) {
    struct hd_state *state = tick->context.state;
    const struct hd_ramped *ramped = &tick->ramped;
    double contact_n[2] = {tick->contact_n[0], tick->contact_n[1]};
    /* The force that hd_ramp_command held back is commanded as well. */
    for (int axis = 0; axis < 2 && (ramped->any || tick->eases); axis++) {
        contact_n[axis] += ramped->held_n[axis];
        tick->object_n[axis] += ramped->held_of_objects ? ramped->held_n[axis] : 0.0;
    }
    hd_passivity_hold(&state->passivity, tick->context.table, state->tick, state->gain, tick->object_n, contact_n);
}

/* Updates the state for the next tick and fills the sample. `felt`: the gain that the command moves to. */
HD_RT static inline void finish_tick(struct tick *tick, double felt, double gain, struct hd_sample *sample) {
    const struct hd_table *table = tick->context.table;
    const struct hd_input *input = tick->context.input;
    struct hd_state *state = tick->context.state;
    if (tick->watches) {
        record_command(tick);
    }
    if (!tick->steady) {
        state->steady = !tick->watches && state->residual.remaining == 0 && !state->change.any &&
                        !state->change.eases && state->show_force == (double)table->display_force &&
                        state->show_vibration == (double)table->display_vibration;
    }
    sample->flags = tick->flags | (state->active_count > 0 ? HD_FLAG_CONTACT : 0u) |
                    (state->enabled ? HD_FLAG_FORCES_ON : 0u) | (state->faults != 0 ? HD_FLAG_FAULT : 0u) |
                    ramping_flag(state, table, felt);
    const double *whole_n = tick->ramped.any ? tick->ramped.whole_n : tick->contact_n;
    for (int axis = 0; axis < 2; axis++) {
        sample->position_m[axis] = input->position_m[axis];
        sample->velocity_m_per_s[axis] = input->velocity_m_per_s[axis];
        sample->contact_force_n[axis] = whole_n[axis];
        sample->vibration_force_n[axis] = tick->vibration_n[axis];
        sample->force_n[axis] = gain * tick->force_n[axis];
        state->position_m[axis] = input->position_m[axis];
    }
    state->located = 1;
    state->started = 1;
    state->played_count = 0;
    state->tick++;
}

HD_RT void hd_tick(const struct hd_world *world, struct hd_state *state, const struct hd_input *input,
                   struct hd_sample *sample) {
    const struct hd_table *table = &world->table;
    struct tick tick;
    sample->tick = state->tick;
    sample->time_ns = input->time_ns;
    sample->revision = table->revision;
    tick.flags = (input->periods != 1 && state->started ? HD_FLAG_SKIPPED : 0u) |
                 (input->interval_s > 0.0 || !state->located ? 0u : HD_FLAG_REPEATED);
    if (!are_finite(input->position_m, input->velocity_m_per_s)) {
        stop_at_nonfinite(state, input, tick.flags, sample);
        return;
    }
    begin_tick(&tick, world, state, input);
    locate_probe(&tick);
    advance_vibration(state, input->periods);
    add_contact_forces(&tick);
    display_contact(&tick);
    if (state->strike_count > 0) {
        start_strikes(&tick);
    }
    add_vibration(&tick);

    const int checking = input->checking && state->enabled;
    const double felt = state->enabled && !checking ? 1.0 : 0.0;
    /* Fading out counts missed periods, so that the force reaches zero in time; fading in counts ticks. */
    const double gain = move_toward(state->gain, felt, felt > 0.0 ? tick.context.ramp_step : tick.elapsed);
    if (tick.ramped.any || tick.eases) {
        ramp_command(&tick, gain - state->gain);
    } else {
        hd_limit_apply(state, table, tick.contact_n, tick.vibration_n, input->time_ns, tick.force_n, &tick.flags);
    }
    const int checked = checking && gain == 0.0 && state->gain == 0.0;
    if (checked) {
        const double cut = hd_limit_cut(input->check_n, table->max_force_n);
        tick.force_n[0] = cut * input->check_n[0];
        tick.force_n[1] = cut * input->check_n[1];
    }
    if (!are_finite(tick.force_n, tick.contact_n) || !are_finite(tick.vibration_n, tick.vibration_n)) {
        stop_at_nonfinite(state, input, tick.flags, sample);
        return;
    }
    state->gain = gain;
    tick.flags |= checking ? HD_FLAG_CHECKING : 0u;
    finish_tick(&tick, felt, checked ? 1.0 : gain, sample);
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

HD_RT void hd_tick_stream(struct hd_state *state, const struct hd_table *table, const double force_n[2],
                          double duration_s) {
    hd_stream_aim(state, table, force_n, duration_s);
}

HD_RT void hd_tick_stream_end(struct hd_state *state, const struct hd_table *table) {
    hd_stream_end(state, table);
}

HD_RT void hd_tick_silence(struct hd_state *state) {
    hd_modes_silence(state);
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
