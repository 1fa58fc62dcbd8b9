/* What is in reach, found in constant time.
 *
 * Around one point, near[] holds all that lies within a radius, each with its distance; while the probe stays within
 * that radius of the point nothing else can be met, and of near[] only what is no farther than the probe went. So a
 * tick at rest looks at what it touches, and the index (hd_index.h) is asked again when the probe has left the circle
 * or the table has changed. The fewer lie around, the larger the circle. */
#include "tick/hd_broad_phase.h"

#include "base/hd_vector.h"

#define HD_NEAR_MANY 16u   /* more than so many in the circle, and it is made smaller */
#define HD_NEAR_SORTED 64u /* up to so many are looked at in the order of their slots, however the index was filled */
#define HD_NEAR_MARGIN 1e-9

HD_RT static void sort_near(struct hd_near *near, uint32_t count) {
    for (uint32_t i = 1; i < count; i++) {
        const struct hd_near item = near[i];
        uint32_t at = i;
        while (at > 0 && near[at - 1].slot > item.slot) {
            near[at] = near[at - 1];
            at--;
        }
        near[at] = item;
    }
}

HD_RT static void find_near(struct hd_walk *walk, double needed_m) {
    struct hd_state *state = walk->state;
    const double *center = walk->input->position_m;
    /* Where it is crowded the last circle was small: most of what a large one holds would be left out again. */
    double radius = hd_index_radius(&walk->world->index);
    const double wider = 2.0 * state->near_radius_m;
    radius = wider > 0.0 && wider < radius ? wider : radius;
    /* A little more than is needed, or a probe that presses asks in every tick. */
    const double least = state->near_count > HD_NEAR_MANY ? needed_m : 2.0 * needed_m;
    radius = radius > least ? radius : least;
    uint32_t count = hd_index_query(&walk->world->index, walk->table->objects, center, radius, state->near);
    while (count > HD_NEAR_MANY && radius > needed_m) {
        radius = 0.5 * radius > needed_m ? 0.5 * radius : needed_m;
        uint32_t kept = 0;
        for (uint32_t i = 0; i < count; i++) {
            if (state->near[i].distance_m <= radius) {
                state->near[kept++] = state->near[i];
            }
        }
        count = kept;
    }
    if (count <= HD_NEAR_SORTED) {
        sort_near(state->near, count);
    }
    state->near_count = count;
    state->near_radius_m = radius;
    state->near_center_m[0] = center[0];
    state->near_center_m[1] = center[1];
    state->near_known = 1;
}

HD_RT static double distance(const double a[2], const double b[2]) {
    double way[2];
    hd_difference(a, b, way);
    return hd_root(hd_dot(way, way));
}

HD_RT void hd_walk_objects(struct hd_walk *walk) {
    struct hd_state *state = walk->state;
    const double *to = walk->input->position_m;
    walk->met_count = 0;
    if (walk->new_table) {
        hd_look_changed(walk);
    }
    hd_path_begin(walk);
    /* The surface point lies as far from the probe as the probe is deep; twice that where two surfaces meet. */
    double deepest = 0.0;
    for (uint32_t i = 0; i < walk->path.plane_count; i++) {
        deepest = walk->path.plane[i].depth_m > deepest ? walk->path.plane[i].depth_m : deepest;
    }
    const double step = distance(walk->from_m, to);
    /* A surface is looked at on the way into the depth from which it is tapped again. */
    double margin = HD_NEAR_MARGIN + walk->table->rearm_m;
    if (deepest > 0.0) {
        margin += 2.0 * (deepest + step);
    }
    double reach = distance(to, state->near_center_m) + step + margin;
    if (walk->new_table || !state->near_known || reach > state->near_radius_m) {
        find_near(walk, step + margin);
        reach = step + margin;
    }
    for (uint32_t i = 0; i < state->near_count; i++) {
        if (state->near[i].distance_m <= reach) {
            hd_look(walk, state->near[i].slot);
        }
    }
    const uint64_t now = state->tick + 1u;
    for (uint32_t i = state->active_count; i-- > 0;) {
        if (state->slots[state->active[i]].looked != now) {
            hd_look(walk, state->active[i]);
        }
    }
    for (uint32_t i = state->healing_count; i-- > 0;) {
        if (state->slots[state->healing[i]].looked != now) {
            hd_look(walk, state->healing[i]);
        }
    }
    for (uint32_t i = 0; i < state->resumed_count; i++) {
        if (state->slots[state->resumed[i]].looked != now) {
            hd_look(walk, state->resumed[i]);
        }
    }
    state->resumed_count = 0;
    if (walk->met_count > 0) {
        hd_look_begin(walk);
    }
}
