/* What one tick knows, from its first stage to its last. Servo thread. */
#ifndef HD_CONTEXT_H
#define HD_CONTEXT_H

#include "base/hd_rt.h"
#include "scene/hd_world.h"
#include "shapes/hd_shape.h"
#include "tick/hd_state.h"

#define HD_ONSETS_MAX 16u /* of one tick in their order in time; beyond that, in the order in which they are found */

struct hd_context {
    const struct hd_world *world;
    const struct hd_table *table; /* the world's */
    struct hd_state *state;
    const struct hd_input *input;
    double ramp_step;   /* what a ramp moves on in this tick */
    int resync;         /* contacts are met without an onset */
    int new_table;      /* the first tick of a table */
    double force_n[2];  /* of contacts and fields, the sum so far */
    double object_n[2]; /* of that, the objects' */
    double noise_n[2];  /* of coloured noise, the sum so far */
    double noise_rms_n; /* and that of its RMS */
    struct hd_proxy proxy;
    uint32_t onset_count; /* contacts of this tick that have not begun yet */
    uint32_t onset_slots[HD_ONSETS_MAX];
    struct hd_onset onsets[HD_ONSETS_MAX];
};

/* How long before the tick a point of the path between two samples lies, `fraction` of it along. Beyond one period it
 * is cut: a strike begins within the tick that first hears it. */
HD_RT static inline double hd_before_tick(const struct hd_context *context, double fraction) {
    const double before = (1.0 - fraction) * context->input->interval_s;
    const double period = context->table->period_s;
    return before < 0.0 ? 0.0 : before > period ? period : before;
}

/* A command is less than a ramp ago: what is met or left may be its doing. */
HD_RT static inline int hd_command_is_recent(const struct hd_context *context) {
    const struct hd_state *state = context->state;
    return state->commanded &&
           (double)(state->tick - state->commanded_tick) * context->table->period_s < context->table->ramp_s;
}

#endif
