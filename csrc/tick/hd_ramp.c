/* What commands change of the force is spread over the ramp: the residual, and the pace of the command. */
#include "tick/hd_ramp.h"

#include "base/hd_vector.h"
#include "tick/hd_limit.h"

#define HD_RAMP_LONGEST 4e9 /* ticks */
/* Below that a ramp is over a tick later than its length says, because it is rounded. */
#define HD_RAMP_ROUNDING 1e-9

HD_RT static void scale(double factor, double vector[2]) {
    vector[0] *= factor;
    vector[1] *= factor;
}

HD_RT void hd_ramp_forget(struct hd_state *state) {
    state->change = (struct hd_change){.any = 0};
}

HD_RT void hd_ramp_clear(struct hd_state *state) {
    state->residual = (struct hd_residual){.remaining = 0};
    hd_ramp_forget(state);
}

HD_RT static double size_of(const struct hd_residual *residual) {
    return hd_root(hd_dot(residual->force_n, residual->force_n));
}

/* What of it there is to fade. The passivity controller changes what objects make alone: where it may act, that and
 * the rest are two forces, which need not fade as one. */
HD_RT static double extent_of(const struct hd_residual *residual, const struct hd_table *table) {
    if (table->passivity != HD_PASSIVITY_CONTROL) {
        return size_of(residual);
    }
    double rest[2];
    hd_difference(residual->force_n, residual->object_n, rest);
    return hd_root(hd_dot(residual->object_n, residual->object_n)) + hd_root(hd_dot(rest, rest));
}

HD_RT static void shrink(struct hd_residual *residual, double factor) {
    scale(factor, residual->force_n);
    scale(factor, residual->object_n);
    scale(factor, residual->beyond_n);
}

/* Its ramp begins, in whole ticks. */
HD_RT static void begin(struct hd_residual *residual, const struct hd_table *table) {
    const double size = extent_of(residual, table);
    const double limits = size > table->max_force_n ? size / table->max_force_n : 1.0;
    const double ticks = limits * table->ramp_s / table->period_s;
    const double most = ticks < HD_RAMP_LONGEST ? ticks : HD_RAMP_LONGEST;
    residual->remaining = (uint32_t)most;
    if ((double)residual->remaining < most * (1.0 - HD_RAMP_ROUNDING)) {
        residual->remaining++;
    }
}

/* The hand lets go of a force that the residual holds down: the residual never holds more than there is. */
HD_RT static void yield(struct hd_residual *residual) {
    const double size = size_of(residual);
    if (!(size > 0.0)) {
        return;
    }
    const double before = -hd_dot(residual->was_n, residual->force_n) / size;
    const double now = -hd_dot(residual->pressed_n, residual->force_n) / size;
    const double held = now > 0.0 ? now : 0.0;
    if (now < before && size > held) {
        const double remaining = size - (before - now);
        shrink(residual, (remaining > held ? remaining : held) / size);
    }
}

HD_RT static void fade(struct hd_residual *residual, const struct hd_table *table) {
    const double size = extent_of(residual, table);
    const double most = hd_ramp_pace(table);
    /* Then the ramp or the limit is another now. */
    if (size > most * (double)residual->remaining * (1.0 + HD_RAMP_ROUNDING)) {
        shrink(residual, (size - most) / size);
        return;
    }
    shrink(residual, (double)(residual->remaining - 1u) / (double)residual->remaining);
    residual->remaining--;
}

HD_RT int hd_ramp_contact(struct hd_context *context, double object_n[2], double contact_n[2],
                          struct hd_ramped *ramped) {
    struct hd_state *state = context->state;
    const struct hd_table *table = context->table;
    struct hd_residual *residual = &state->residual;
    const struct hd_change *change = &state->change;
    const double shown = state->show_force;
    state->show_force = (double)table->display_force;
    if (state->gain == 0.0) { /* nothing of it was felt; the command's own ramp covers it */
        hd_ramp_clear(state);
        return 0;
    }
    ramped->changed = change->any || shown != state->show_force;
    double was[2];    /* without the changes of this tick, */
    double before[2]; /* and without the way that the stream went in it */
    double was_object[2];
    for (int axis = 0; axis < 2; axis++) {
        was[axis] = shown * (context->force_n[axis] + change->field_n[axis] + change->object_n[axis]);
        before[axis] = was[axis] - (change->streams ? shown * state->streamed.step_n[axis] : 0.0);
        was_object[axis] = shown * (context->object_n[axis] + change->object_n[axis]);
    }
    const double limit = hd_limit_of(state, table);
    const double was_cut = hd_limit_cut(was, limit);
    const double cut = hd_limit_cut(contact_n, limit);
    /* Without a residual the limit is left to hd_limit.c, which looks at contact and vibration together. */
    const int cuts = residual->remaining > 0 || ramped->cuts;
    const double was_part = cuts ? was_cut : 1.0;
    const double before_cut = hd_limit_cut(before, limit);
    const double before_part = cuts ? before_cut : 1.0;
    double is[2];
    double is_object[2];
    for (int axis = 0; axis < 2; axis++) {
        is[axis] = cut * contact_n[axis];
        object_n[axis] = state->show_force * context->object_n[axis];
        is_object[axis] = cut * object_n[axis];
        residual->was_n[axis] = residual->pressed_n[axis];
        residual->pressed_n[axis] = before_cut * before[axis]; /* a stream that goes is no hand that lets go */
    }
    if (residual->remaining > 0) {
        yield(residual);
    }
    for (int axis = 0; axis < 2; axis++) {
        residual->pressed_n[axis] = was_cut * was[axis];
        ramped->still_n[axis] = before_part * before[axis] + residual->force_n[axis];
        ramped->still_object_n[axis] = before_part * was_object[axis] + residual->object_n[axis];
        ramped->still_whole_n[axis] = before[axis] + residual->force_n[axis] + residual->beyond_n[axis];
    }
    if (change->whole && residual->remaining > 0) {
        fade(residual, table);
    }
    if (ramped->changed) {
        double felt[2] = {was_part * was[0] + residual->force_n[0], was_part * was[1] + residual->force_n[1]};
        const double felt_cut = hd_limit_cut(felt, limit);
        for (int axis = 0; axis < 2; axis++) {
            const double felt_object = was_part * was_object[axis] + residual->object_n[axis];
            const double whole = was[axis] + residual->force_n[axis] + residual->beyond_n[axis];
            residual->force_n[axis] = felt_cut * felt[axis] - is[axis];
            residual->object_n[axis] = felt_cut * felt_object - is_object[axis];
            residual->beyond_n[axis] = whole - contact_n[axis] - residual->force_n[axis];
            residual->pressed_n[axis] = is[axis];
        }
        begin(residual, table);
    }
    if (!change->whole && residual->remaining > 0) {
        fade(residual, table);
    }
    const int within = residual->remaining > 0 || ramped->cuts;
    /* What the limit keeps from being felt is no part of it. */
    const double sum[2] = {is[0] + residual->force_n[0], is[1] + residual->force_n[1]};
    const double over = residual->remaining > 0 ? 1.0 - hd_limit_cut(sum, limit) : 0.0;
    for (int axis = 0; axis < 2; axis++) {
        residual->force_n[axis] -= over * sum[axis];
        residual->beyond_n[axis] += over * sum[axis];
        ramped->whole_n[axis] = contact_n[axis] + residual->force_n[axis] + residual->beyond_n[axis];
        contact_n[axis] = within ? is[axis] + residual->force_n[axis] : contact_n[axis];
        object_n[axis] = within ? is_object[axis] + residual->object_n[axis] : object_n[axis];
    }
    return 1;
}

/* Brings the command within its pace of what it would be if every ramp stood still. */
HD_RT static void hold(struct hd_state *state, const struct hd_table *table, struct hd_ramped *ramped,
                       const double still_n[2], double gain_step, double force_n[2]) {
    struct hd_residual *residual = &state->residual;
    double step[2];
    hd_difference(force_n, still_n, step);
    const double taken = hd_magnitude(gain_step) * hd_root(hd_dot(still_n, still_n));
    const double room = hd_ramp_pace(table) > taken ? hd_ramp_pace(table) - taken : 0.0;
    const double size = hd_root(hd_dot(step, step));
    if (!(size * (1.0 - HD_RAMP_ROUNDING) > room)) {
        return;
    }
    const double part = room / size;
    /* As far as the controller knows; but a stream that waits is none of theirs. */
    ramped->held_of_objects = state->passivity.running && !state->change.streams;
    for (int axis = 0; axis < 2; axis++) {
        const double held = still_n[axis] + part * step[axis];
        ramped->held_n[axis] = held - force_n[axis];
        residual->force_n[axis] += ramped->held_n[axis];
        if (ramped->held_of_objects) {
            residual->object_n[axis] += ramped->held_n[axis];
        }
        force_n[axis] = held;
    }
    if (ramped->changed) {
        begin(residual, table);
    } else if (residual->remaining == 0) {
        residual->remaining = 1;
    }
}

HD_RT void hd_ramp_command(struct hd_context *context, struct hd_ramped *ramped, const double contact_n[2],
                           const double vibration_n[2], const double still_n[2], double gain_step, double force_n[2],
                           uint32_t *flags) {
    struct hd_state *state = context->state;
    const struct hd_table *table = context->table;
    const int64_t time_ns = context->input->time_ns;
    const double limit = hd_limit_of(state, table);
    double still[2];
    if (ramped->any) {
        hd_limit_within_whole(limit, hd_limit_keep(state, table), ramped->still_n, ramped->still_whole_n, still_n,
                              still);
        hd_limit_ramped(state, table, contact_n, ramped->whole_n, vibration_n, time_ns, force_n, flags);
    } else {
        hd_limit_within(limit, hd_limit_keep(state, table), ramped->still_n, still_n, still);
        hd_limit_apply(state, table, contact_n, vibration_n, time_ns, force_n, flags);
    }
    hold(state, table, ramped, still, gain_step, force_n);
    hd_ramp_forget(state);
}
