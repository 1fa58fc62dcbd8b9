/* The context of a tick: the data that its stages share, from the first to the last. Servo thread. */
#ifndef HD_CONTEXT_H
#define HD_CONTEXT_H

#include "base/hd_rt.h"
#include "scene/hd_world.h"
#include "shapes/hd_shape.h"
#include "tick/hd_state.h"

#define HD_ONSETS_MAX 16u /* onsets that one tick sorts by time; further ones begin as they are found */

struct hd_context {
    const struct hd_world *world;
    const struct hd_table *table; /* the world's */
    struct hd_state *state;
    const struct hd_input *input;
    double ramp_step;   /* part of a ramp that passes in this tick, 0 to 1 */
    int resync;         /* contacts begin without an onset */
    int new_table;      /* the first tick of a table */
    double force_n[2];  /* of contacts, fields and stream, summed up in the course of the tick */
    double object_n[2]; /* the part of it that objects exert */
    double noise_n[2];  /* of coloured noise, summed up in the course of the tick */
    double noise_rms_n; /* sum of the RMS of the noises */
    double freed_j;    /* energy of the springs that the probe left sideways in this tick and that no other took over */
    double freed_n[2]; /* force of these springs */
    struct hd_proxy proxy;
    uint32_t onset_count; /* contacts of this tick that have not begun yet */
    uint32_t onset_slots[HD_ONSETS_MAX];
    struct hd_onset onsets[HD_ONSETS_MAX];
};

/* Returns how long before the tick, in s, the probe was at `fraction` of the path between two samples. The value is at
 * most one period, since a strike begins within the tick in which it first sounds. */
HD_RT static inline double hd_before_tick(const struct hd_context *context, double fraction) {
    const double before = (1.0 - fraction) * context->input->interval_s;
    const double period = context->table->period_s;
    return before < 0.0 ? 0.0 : before > period ? period : before;
}

/* Whether the last command is less than a ramp ago: it may be the reason why a contact begins or ends now. */
HD_RT static inline int hd_command_is_recent(const struct hd_context *context) {
    const struct hd_state *state = context->state;
    return state->commanded &&
           (double)(state->tick - state->commanded_tick) * context->table->period_s < context->table->ramp_s;
}

#endif
