/* The tick, top to bottom: sense, ring, touch, strike, limit, fade.
 *
 * Bounded work: it looks at the objects in reach and at the ringing modes once. Whatever it is given, the force it
 * returns is finite and within the table's limit; a NaN or an infinity anywhere latches HD_FAULT_NONFINITE and the
 * force is zero from that tick on. Called by the servo thread and by the offline runs alike. */
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
    hd_stream_drop(state);
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
HD_RT static void stop(struct hd_state *state, const struct hd_input *input, uint32_t flags, struct hd_sample *sample) {
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

HD_RT static uint32_t ramping(const struct hd_state *state, const struct hd_table *table, double felt) {
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

/* What the stages of a tick hand on to each other. */
struct tick {
    uint32_t flags;
    int steady;              /* nothing of a command or of the passivity controller is under way */
    int watches;             /* the passivity observer does */
    int restrained;          /* the controller changed what would be felt if every ramp stood still */
    int eases;               /* vibration is on a ramp */
    double elapsed;          /* since the last tick, in ramps */
    double shown;            /* of vibration, at the last tick */
    double contact_n[2];     /* as it is displayed: its weights, ramps and the controller are in it */
    double object_n[2];      /* the objects' part of it, where a ramp or the observer needs it */
    double vibration_n[2];   /* the same of noise and modes */
    double noise_still_n[2]; /* noise, if every ramp stood still, without the gains of `display` */
    double force_n[2];       /* the command, before its gain */
    struct hd_ramped ramped;
    struct hd_context context; /* last, because it is large: the others are near the top of the stack */
};

/* What this tick is of, and since when. */
HD_RT static inline void begin(struct tick *tick, const struct hd_world *world, struct hd_state *state,
                               const struct hd_input *input) {
    struct hd_context *context = &tick->context;
    const struct hd_table *table = &world->table;
    context->world = world;
    context->table = table;
    context->state = state;
    context->input = input;
    context->new_table = state->revision != table->revision || !state->started;
    /* A ramp counts ticks, not the periods that were missed before it began. */
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

/* A jump, or a stall longer than the ramp: what was felt before says nothing about now. */
HD_RT static inline void locate(struct tick *tick) {
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

/* Time goes on for what rings. */
HD_RT static inline void advance(struct hd_state *state, uint32_t periods) {
    if (is_ringing(state)) {
        hd_modes_advance(state, periods);
    }
    if (state->reserve_count > 0) {
        hd_offload_advance(state, periods);
    }
}

/* The force of objects, fields and stream, into the context. */
HD_RT static inline void touch(struct tick *tick) {
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

/* The passivity controller's part: of what is felt, and of what would be felt if every ramp stood still. `controlled`:
 * how much of it was done at the last tick. */
HD_RT static void watch_energy(struct tick *tick, double controlled) {
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

HD_RT static void nothing_ramped(struct tick *tick) {
    struct hd_ramped *ramped = &tick->ramped;
    const double shows = (double)tick->context.table->display_force;
    ramped->changed = 0;
    for (int axis = 0; axis < 2; axis++) {
        tick->object_n[axis] = shows * tick->context.object_n[axis];
        ramped->still_n[axis] = ramped->still_whole_n[axis] = ramped->whole_n[axis] = tick->contact_n[axis];
        ramped->still_object_n[axis] = tick->object_n[axis];
    }
}

/* What commands and the passivity controller make of the contact force. */
HD_RT static void ramp_contact(struct tick *tick) {
    struct hd_context *context = &tick->context;
    const struct hd_table *table = context->table;
    struct hd_state *state = context->state;
    struct hd_ramped *ramped = &tick->ramped;
    state->show_vibration = toward(tick->shown, (double)table->display_vibration, context->ramp_step);
    const double controlled = state->controls;
    const int controls = table->passivity == HD_PASSIVITY_CONTROL;
    ramped->cuts = controls || controlled > 0.0;
    if (ramped->cuts) {
        const double wanted = controls ? 1.0 : 0.0;
        state->controls = state->started ? toward(controlled, wanted, context->ramp_step) : wanted;
    }
    const int due = state->change.any || state->change.streams || state->residual.remaining > 0 ||
                    state->show_force != (double)table->display_force || ramped->cuts;
    ramped->any = due && hd_ramp_contact(context, tick->object_n, tick->contact_n, ramped);
    tick->watches = table->passivity != HD_PASSIVITY_OFF || ramped->cuts;
    tick->eases = tick->shown != state->show_vibration || state->change.eases;
    if (!ramped->any && (tick->watches || tick->eases)) {
        nothing_ramped(tick);
    }
    if (tick->watches) {
        watch_energy(tick, controlled);
    }
}

/* The contact force as it is displayed. */
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

/* A strike does not hear of ramps: what it leaves room for is what would be felt if they stood still. What the
 * controller left is within the limit, which is not the scene's doing. Noise leaves room for it. */
HD_RT static void strike(struct tick *tick) {
    struct hd_state *state = tick->context.state;
    const struct hd_ramped *ramped = &tick->ramped;
    const int alone = ramped->any && ramped->cuts && state->residual.remaining == 0;
    const double *still_n = alone ? ramped->still_whole_n : ramped->any ? ramped->still_n : tick->contact_n;
    if (hd_strikes_apply(state, tick->context.table, hd_root(hd_dot(still_n, still_n))) < 1.0) {
        tick->flags |= HD_FLAG_SATURATED;
    }
}

/* What is heard of the noise of this tick, and what would be if every ramp stood still. */
HD_RT static void hear_noise(struct tick *tick) {
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

/* Noise and modes, as they are displayed. */
HD_RT static inline void vibrate(struct tick *tick) {
    struct hd_state *state = tick->context.state;
    for (int axis = 0; axis < 2; axis++) {
        tick->vibration_n[axis] = 0.0;
        tick->noise_still_n[axis] = 0.0;
    }
    if (tick->context.noise_rms_n > 0.0 || state->change.eases || state->change.any) {
        hear_noise(tick);
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

/* The command within the limit, while a ramp is under way. `gain_step`: what the gain moves by. */
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
        tick->flags |= HD_FLAG_RESTRAINED; /* the command is held at what the controller left */
    }
}

/* The passivity observer is told what is commanded from now on. */
HD_RT static void tell_observer(struct tick *tick) {
    struct hd_state *state = tick->context.state;
    const struct hd_ramped *ramped = &tick->ramped;
    double contact_n[2] = {tick->contact_n[0], tick->contact_n[1]};
    for (int axis = 0; axis < 2 && (ramped->any || tick->eases); axis++) { /* what was held is commanded, too */
        contact_n[axis] += ramped->held_n[axis];
        tick->object_n[axis] += ramped->held_of_objects ? ramped->held_n[axis] : 0.0;
    }
    hd_passivity_hold(&state->passivity, tick->context.table, state->tick, state->gain, tick->object_n, contact_n);
}

/* The state goes on, and the sample tells of it. `felt`: the gain on its way to which the command is. */
HD_RT static inline void finish(struct tick *tick, double felt, double gain, struct hd_sample *sample) {
    const struct hd_table *table = tick->context.table;
    const struct hd_input *input = tick->context.input;
    struct hd_state *state = tick->context.state;
    if (tick->watches) {
        tell_observer(tick);
    }
    if (!tick->steady) {
        state->steady = !tick->watches && state->residual.remaining == 0 && !state->change.any &&
                        !state->change.eases && state->show_force == (double)table->display_force &&
                        state->show_vibration == (double)table->display_vibration;
    }
    sample->flags = tick->flags | (state->active_count > 0 ? HD_FLAG_CONTACT : 0u) |
                    (state->enabled ? HD_FLAG_FORCES_ON : 0u) | (state->faults != 0 ? HD_FLAG_FAULT : 0u) |
                    ramping(state, table, felt);
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
    if (!finite4(input->position_m, input->velocity_m_per_s)) {
        stop(state, input, tick.flags, sample);
        return;
    }
    begin(&tick, world, state, input);
    locate(&tick);
    advance(state, input->periods);
    touch(&tick);
    display_contact(&tick);
    if (state->strike_count > 0) {
        strike(&tick);
    }
    vibrate(&tick);

    const int checking = input->checking && state->enabled;
    const double felt = state->enabled && !checking ? 1.0 : 0.0;
    /* Only on its way out does the command hurry: zero is due by the clock. */
    const double gain = toward(state->gain, felt, felt > 0.0 ? tick.context.ramp_step : tick.elapsed);
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
    if (!finite4(tick.force_n, tick.contact_n)) {
        stop(state, input, tick.flags, sample);
        return;
    }
    state->gain = gain;
    tick.flags |= checking ? HD_FLAG_CHECKING : 0u;
    finish(&tick, felt, checked ? 1.0 : gain, sample);
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
