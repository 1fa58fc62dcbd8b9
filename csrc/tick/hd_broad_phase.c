/* The candidate list, kept from tick to tick.
 *
 * Around one point, candidates[] holds all that lies within a radius, each with its distance; while the probe stays
 * within that radius of the point nothing else can be met, and of candidates[] only what is no farther than the probe
 * went. So a tick at rest visits what it touches, and the index (hd_index.h) is asked again when the probe has left the
 * circle or the table has changed. The fewer objects are near, the larger the circle. */
#include "tick/hd_broad_phase.h"

#include "base/hd_vector.h"

#define HD_CANDIDATES_MANY 16u /* more than so many in the circle, and it is made smaller */
#define HD_CANDIDATES_SORTED \
    64u /* up to so many are visited in the order of their slots, however the index was filled */
#define HD_CANDIDATES_MARGIN 1e-9

HD_RT static void sort_candidates(struct hd_candidate *candidates, uint32_t count) {
    for (uint32_t i = 1; i < count; i++) {
        const struct hd_candidate item = candidates[i];
        uint32_t at = i;
        while (at > 0 && candidates[at - 1].slot > item.slot) {
            candidates[at] = candidates[at - 1];
            at--;
        }
        candidates[at] = item;
    }
}

HD_RT static void find_candidates(struct hd_context *context, double needed_m) {
    struct hd_state *state = context->state;
    const double *center = context->input->position_m;
    /* Where it is crowded the last circle was small: most of what a large one holds would be left out again. */
    double radius = hd_index_radius(&context->world->index);
    const double wider = 2.0 * state->candidates_radius_m;
    radius = wider > 0.0 && wider < radius ? wider : radius;
    /* A little more than is needed, or a probe that presses asks in every tick. */
    const double least = state->candidate_count > HD_CANDIDATES_MANY ? needed_m : 2.0 * needed_m;
    radius = radius > least ? radius : least;
    uint32_t count = hd_index_query(&context->world->index, context->table->objects, center, radius, state->candidates);
    while (count > HD_CANDIDATES_MANY && radius > needed_m) {
        radius = 0.5 * radius > needed_m ? 0.5 * radius : needed_m;
        uint32_t kept = 0;
        for (uint32_t i = 0; i < count; i++) {
            if (state->candidates[i].distance_m <= radius) {
                state->candidates[kept++] = state->candidates[i];
            }
        }
        count = kept;
    }
    if (count <= HD_CANDIDATES_SORTED) {
        sort_candidates(state->candidates, count);
    }
    state->candidate_count = count;
    state->candidates_radius_m = radius;
    state->candidates_center_m[0] = center[0];
    state->candidates_center_m[1] = center[1];
    state->candidates_known = 1;
}

HD_RT static double distance(const double a[2], const double b[2]) {
    double step[2];
    hd_difference(a, b, step);
    return hd_root(hd_dot(step, step));
}

HD_RT double hd_broad_phase(struct hd_context *context) {
    struct hd_state *state = context->state;
    const struct hd_proxy *proxy = &context->proxy;
    /* The proxy lies as far from the probe as the probe is deep; twice that where two surfaces meet. */
    double deepest = 0.0;
    for (uint32_t i = 0; i < proxy->plane_count; i++) {
        deepest = proxy->plane[i].depth_m > deepest ? proxy->plane[i].depth_m : deepest;
    }
    const double step = distance(proxy->from_m, proxy->to_m);
    /* A surface is visited on the path into the depth from which it is tapped again. */
    double margin = HD_CANDIDATES_MARGIN + context->table->rearm_m;
    if (deepest > 0.0) {
        margin += 2.0 * (deepest + step);
    }
    const double reach = distance(proxy->to_m, state->candidates_center_m) + step + margin;
    if (context->new_table || !state->candidates_known || reach > state->candidates_radius_m) {
        find_candidates(context, step + margin);
        return step + margin;
    }
    return reach;
}
