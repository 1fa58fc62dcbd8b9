/* Ramps of commands: the residual of the contact force, and the largest change of the command per tick. */
#include "tick/hd_ramp.h"

#include "base/hd_vector.h"
#include "tick/hd_limit.h"

#define HD_RAMP_TICKS_MAX 4e9 /* ticks */
/* Relative tolerance of ramp lengths and slopes: without it rounding could make a ramp one tick too long. */
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

HD_RT static double residual_size(const struct hd_residual *residual) {
    return hd_root(hd_dot(residual->force_n, residual->force_n));
}

/* Returns the size of the residual for its fading, N. The passivity controller changes only the force of objects: where
 * it can act, the magnitudes of that part and of the rest are added, since the two can fade separately. */
HD_RT static double residual_extent(const struct hd_residual *residual, const struct hd_table *table) {
    if (table->passivity != HD_PASSIVITY_CONTROL) {
        return residual_size(residual);
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

/* Sets the number of ticks in which the residual fades. */
HD_RT static void begin_fade(struct hd_residual *residual, const struct hd_table *table) {
    const double size = residual_extent(residual, table);
    const double limits = size > table->max_force_n ? size / table->max_force_n : 1.0;
    const double ticks = limits * table->ramp_s / table->period_s;
    const double most = ticks < HD_RAMP_TICKS_MAX ? ticks : HD_RAMP_TICKS_MAX;
    residual->remaining = (uint32_t)most;
    if ((double)residual->remaining < most * (1.0 - HD_RAMP_ROUNDING)) {
        residual->remaining++;
    }
}

/* Shrinks the residual when the hand withdraws from a force that the residual cancels: it never cancels more than there
 * is of that force. */
HD_RT static void shrink_with_release(struct hd_residual *residual) {
    const double size = residual_size(residual);
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
    const double size = residual_extent(residual, table);
    const double most = hd_ramp_pace(table);
    /* The ramp or the limit has changed since the fading began. */
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
    if (state->gain == 0.0) { /* no force was felt before; the ramp of the gain covers the change */
        hd_ramp_clear(state);
        return 0;
    }
    ramped->changed = change->any || shown != state->show_force;
    double was[2];    /* force without the changes of this tick */
    double before[2]; /* the same, also without the change of the stream in this tick */
    double was_object[2];
    for (int axis = 0; axis < 2; axis++) {
        was[axis] = shown * (context->force_n[axis] + change->field_n[axis] + change->object_n[axis]);
        before[axis] = was[axis] - (change->streams ? shown * state->streamed.step_n[axis] : 0.0);
        was_object[axis] = shown * (context->object_n[axis] + change->object_n[axis]);
    }
    const double limit = hd_limit_of(state, table);
    const double was_cut = hd_limit_cut(was, limit);
    const double cut = hd_limit_cut(contact_n, limit);
    /* Without a residual hd_limit.c applies the limit, to contact and vibration together. */
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
        residual->pressed_n[axis] = before_cut * before[axis]; /* a falling stream is not a withdrawing hand */
    }
    if (residual->remaining > 0) {
        shrink_with_release(residual);
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
        begin_fade(residual, table);
    }
    if (!change->whole && residual->remaining > 0) {
        fade(residual, table);
    }
    const int within = residual->remaining > 0 || ramped->cuts;
    /* The part above the limit is not felt, so it moves from force_n to beyond_n. */
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

/* Limits the distance between the command and the command with every ramp stopped to hd_ramp_pace. */
HD_RT static void limit_pace(struct hd_state *state, const struct hd_table *table, struct hd_ramped *ramped,
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
    /* Counted as force of objects while the passivity observer runs, unless the stream is what moves too fast. */
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
        begin_fade(residual, table);
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
    limit_pace(state, table, ramped, still, gain_step, force_n);
    hd_ramp_forget(state);
}
