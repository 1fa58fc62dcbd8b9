/* Broad phase: keeps the candidate list, the objects that the probe can reach in a tick. Servo thread. */
#ifndef HD_BROAD_PHASE_H
#define HD_BROAD_PHASE_H

#include "base/hd_vector.h"
#include "tick/hd_context.h"

#define HD_CANDIDATES_MARGIN_M 1e-9 /* covers the rounding of distances */
/* Up to this number candidates are sorted by slot, so that the result does not depend on the order of the index. Of
 * more, only those in reach are sorted (hd_broad_phase_gather). */
#define HD_CANDIDATES_SORTED_MAX 64u

/* Queries the index for the objects within a radius of at least `needed_m` around the probe. */
HD_RT void hd_broad_phase_query(struct hd_context *context, double needed_m);

/* Moves the candidates up to `reach_m` from the centre to the front and sorts them by slot. */
HD_RT void hd_broad_phase_gather(struct hd_state *state, double reach_m);

/* Updates state->candidates, which stays unchanged in most ticks. Returns the distance from candidates_center_m up to
 * which an object can be touched in this tick. */
HD_RT static inline double hd_broad_phase(struct hd_context *context) {
    const struct hd_state *state = context->state;
    const struct hd_proxy *proxy = &context->proxy;
    /* The distance from proxy to probe is the depth of the probe; twice that where two surfaces meet. */
    double deepest_m = 0.0;
    for (uint32_t i = 0; i < proxy->plane_count; i++) {
        deepest_m = proxy->plane[i].depth_m > deepest_m ? proxy->plane[i].depth_m : deepest_m;
    }
    const double step_m = hd_distance(proxy->from_m, proxy->to_m);
    /* A surface is visited within rearm_m as well, since there a withdrawing probe rearms its tap. */
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
