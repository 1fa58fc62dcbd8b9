/* What one tick knows while it visits the objects in reach, and how they are found. Servo thread. */
#ifndef HD_BROAD_PHASE_H
#define HD_BROAD_PHASE_H

#include "base/hd_rt.h"
#include "scene/hd_world.h"
#include "tick/hd_proxy.h"
#include "tick/hd_state.h"

#define HD_WALK_MET 16u /* beyond so many, contacts begin in the order of looking */

struct hd_context {
    const struct hd_world *world;
    const struct hd_table *table; /* the world's */
    struct hd_state *state;
    const struct hd_input *input;
    double from_m[2];   /* the last sample; this one where the last says nothing */
    double ramp_step;   /* what a ramp moves on in this tick */
    int resync;         /* contacts are met without an onset */
    int new_table;      /* the first tick of a table */
    double force_n[2];  /* of contacts and fields, the sum so far */
    double object_n[2]; /* of that, the objects' */
    double noise_n[2];  /* of coloured noise, the sum so far */
    double noise_rms_n; /* and that of its RMS */
    uint32_t met_count; /* met in this tick, and not begun yet */
    uint32_t met[HD_WALK_MET];
    struct hd_proxy path;
};

/* How long before the tick a point of the way between two samples lies, `fraction` of the way along it. Beyond one
 * period it is cut: a strike begins within the tick that first hears it. */
HD_RT static inline double hd_before_tick(const struct hd_context *context, double fraction) {
    const double before = (1.0 - fraction) * context->input->interval_s;
    const double period = context->table->period_s;
    return before < 0.0 ? 0.0 : before > period ? period : before;
}

/* A command is less than a ramp ago: what is met or left may be its doing. */
HD_RT static inline int hd_walk_is_unsettled(const struct hd_context *context) {
    const struct hd_state *state = context->state;
    return state->commanded &&
           (double)(state->tick - state->commanded_tick) * context->table->period_s < context->table->ramp_s;
}

/* Looks at everything that this tick can concern: what is near, what is touched, what was cleared under the hand, what
 * heals. */
HD_RT void hd_walk_objects(struct hd_context *context);
/* What is touched, as a new table has it, before anything is met: the way for the rest goes along that. */
HD_RT void hd_look_changed(struct hd_context *context);
/* One object: met, pressed, let go, healed. */
HD_RT void hd_look(struct hd_context *context, uint32_t index);
/* Begins the contacts with all that was met, first met, first begun. */
HD_RT void hd_look_begin(struct hd_context *context);
HD_RT void hd_field_follow(struct hd_context *context);

HD_RT static inline void hd_field_walk(struct hd_context *context) {
    struct hd_state *state = context->state;
    if (!state->field_known || state->field_version != context->table->field_version || state->field_ramp < 1.0) {
        hd_field_follow(context);
    }
    if (state->field_active) {
        for (int axis = 0; axis < 2; axis++) {
            context->force_n[axis] += state->field.force_n[axis] -
                                      state->field.stiffness_n_per_m * context->input->position_m[axis] -
                                      state->field.damping_n_s_per_m * context->input->velocity_m_per_s[axis];
        }
    }
}

#endif
