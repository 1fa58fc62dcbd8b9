/* The candidate list, kept from tick to tick.
 *
 * candidates[] holds every object within a radius around a centre, with its distance from the centre. While the probe
 * stays within that radius, it can touch only candidates that are no farther from the centre than the probe. So a tick
 * at rest visits only the touched objects, and the index (hd_index.h) is queried again when the probe has left the
 * circle or the table has changed. The fewer objects are near, the larger the circle. */
#include "tick/hd_broad_phase.h"

#include "base/hd_vector.h"

/* With more candidates the circle is made smaller, down to the needed radius. */
#define HD_CANDIDATES_TARGET 16u

/* Gaps of the Shell sort, each a little less than half of the one before. */
static const uint32_t gaps[] = {4193, 1861, 827, 367, 163, 72, 32, 14, 6, 1};

HD_RT static void sort_candidates(struct hd_candidate *candidates, uint32_t count) {
    for (uint32_t i = 0; i < sizeof gaps / sizeof gaps[0]; i++) {
        const uint32_t gap = gaps[i];
        for (uint32_t k = gap; k < count; k++) {
            const struct hd_candidate item = candidates[k];
            uint32_t at = k;
            while (at >= gap && candidates[at - gap].slot > item.slot) {
                candidates[at] = candidates[at - gap];
                at -= gap;
            }
            candidates[at] = item;
        }
    }
}

HD_RT void hd_broad_phase_gather(struct hd_state *state, double reach_m) {
    struct hd_candidate *candidates = state->candidates;
    uint32_t near = 0;
    int sorted = 1;
    for (uint32_t i = 0; i < state->candidate_count; i++) {
        if (candidates[i].distance_m <= reach_m) {
            const struct hd_candidate item = candidates[i];
            sorted &= near == 0 || candidates[near - 1].slot < item.slot;
            candidates[i] = candidates[near];
            candidates[near++] = item;
        }
    }
    if (!sorted) {
        sort_candidates(candidates, near);
    }
}

HD_RT void hd_broad_phase_query(struct hd_context *context, double needed_m) {
    struct hd_state *state = context->state;
    const double *center = context->input->position_m;
    /* In a dense region the last circle was small; a much larger one would return mostly objects that are dropped
     * again.
     */
    double radius = hd_index_radius(&context->world->index);
    const double wider = 2.0 * state->candidates_radius_m;
    radius = wider > 0.0 && wider < radius ? wider : radius;
    /* Twice the needed radius, since otherwise a pressing probe would query the index in every tick. */
    const double least = state->candidate_count > HD_CANDIDATES_TARGET ? needed_m : 2.0 * needed_m;
    radius = radius > least ? radius : least;
    uint32_t count = hd_index_query(&context->world->index, context->table->objects, center, radius, state->candidates);
    while (count > HD_CANDIDATES_TARGET && radius > needed_m) {
        radius = 0.5 * radius > needed_m ? 0.5 * radius : needed_m;
        uint32_t kept = 0;
        for (uint32_t i = 0; i < count; i++) {
            if (state->candidates[i].distance_m <= radius) {
                state->candidates[kept++] = state->candidates[i];
            }
        }
        count = kept;
    }
    if (count <= HD_CANDIDATES_SORTED_MAX) {
        sort_candidates(state->candidates, count);
    }
    state->candidate_count = count;
    state->candidates_radius_m = radius;
    state->candidates_center_m[0] = center[0];
    state->candidates_center_m[1] = center[1];
    state->candidates_known = 1;
}
