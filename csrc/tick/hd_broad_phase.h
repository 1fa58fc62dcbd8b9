/* Broad phase: the candidate list, the objects that the probe can meet in a tick. Servo thread. */
#ifndef HD_BROAD_PHASE_H
#define HD_BROAD_PHASE_H

#include "base/hd_vector.h"
#include "tick/hd_context.h"

#define HD_CANDIDATES_MARGIN_M 1e-9

/* Asks the index for what lies within `needed_m` of the probe, or farther. */
HD_RT void hd_broad_phase_query(struct hd_context *context, double needed_m);

/* Brings state->candidates up to date, which most ticks find as they are. The distance from candidates_center_m up to
 * which they can be met in this tick. */
HD_RT static inline double hd_broad_phase(struct hd_context *context) {
    const struct hd_state *state = context->state;
    const struct hd_proxy *proxy = &context->proxy;
    /* The proxy lies as far from the probe as the probe is deep; twice that where two surfaces meet. */
    double deepest_m = 0.0;
    for (uint32_t i = 0; i < proxy->plane_count; i++) {
        deepest_m = proxy->plane[i].depth_m > deepest_m ? proxy->plane[i].depth_m : deepest_m;
    }
    const double step_m = hd_distance(proxy->from_m, proxy->to_m);
    /* A surface is visited on the path into the depth from which it is tapped again. */
    double margin_m = HD_CANDIDATES_MARGIN_M + context->table->rearm_m;
    if (deepest_m > 0.0) {
        margin_m += 2.0 * (deepest_m + step_m);
    }
    const double reach_m = hd_distance(proxy->to_m, state->candidates_center_m) + step_m + margin_m;
    if (context->new_table || !state->candidates_known || reach_m > state->candidates_radius_m) {
        hd_broad_phase_query(context, step_m + margin_m);
        return step_m + margin_m;
    }
    return reach_m;
}

#endif
