#include "tick/hd_proxy.h"

#include "base/hd_vector.h"
#include "tick/hd_broad_phase.h"

/* How far above a surface its proxy lies: enough to be told from on it, too little to be felt. */
#define HD_PROXY_LIFT_M 1e-9
#define HD_PROXY_ITERATIONS 3

HD_RT void hd_proxy_begin(struct hd_context *context) {
    const struct hd_state *state = context->state;
    struct hd_proxy *path = &context->path;
    path->known = 0;
    path->plane_count = 0;
    for (uint32_t i = 0; i < state->active_count && path->plane_count < HD_PROXY_PLANES; i++) {
        const struct hd_slot *slot = &state->slots[state->active[i]];
        const uint32_t at = path->plane_count++;
        path->plane[at].slot = state->active[i];
        path->plane[at].depth_m = slot->last.depth_m;
        path->plane[at].normal[0] = slot->last.normal[0];
        path->plane[at].normal[1] = slot->last.normal[1];
    }
}

HD_RT int hd_proxy_project(const struct hd_context *context, const double position_m[2], uint32_t slot,
                           double lifted[2]) {
    const struct hd_proxy *path = &context->path;
    int moved = 0;
    lifted[0] = position_m[0];
    lifted[1] = position_m[1];
    /* One sweep does it for surfaces at right angles; the others approach it. */
    for (int sweep = 0; sweep < HD_PROXY_ITERATIONS; sweep++) {
        int any = 0;
        for (uint32_t i = 0; i < path->plane_count; i++) {
            if (path->plane[i].slot == slot) {
                continue;
            }
            double way[2];
            hd_difference(lifted, context->from_m, way);
            const double depth = path->plane[i].depth_m - hd_dot(way, path->plane[i].normal);
            if (depth > 0.0) {
                lifted[0] += (depth + HD_PROXY_LIFT_M) * path->plane[i].normal[0];
                lifted[1] += (depth + HD_PROXY_LIFT_M) * path->plane[i].normal[1];
                any = 1;
            }
        }
        moved |= any;
        if (!any) {
            break;
        }
    }
    return moved;
}

HD_RT double hd_proxy_offset(const struct hd_context *context, uint32_t slot, const double normal[2],
                             const double position_m[2]) {
    double lifted[2];
    if (!hd_proxy_project(context, position_m, slot, lifted)) {
        return 0.0;
    }
    double shift[2];
    double tangent[2];
    hd_tangent(normal, tangent);
    hd_difference(lifted, position_m, shift);
    return hd_dot(shift, tangent);
}

HD_RT const struct hd_proxy *hd_proxy_sweep(struct hd_context *context) {
    struct hd_proxy *path = &context->path;
    if (path->known) {
        return path;
    }
    path->known = 1;
    const double *to = context->input->position_m;
    const int lifted = hd_proxy_project(context, context->from_m, HD_NO_SLOT, path->point[0]) |
                       hd_proxy_project(context, to, HD_NO_SLOT, path->point[1]);
    path->legs = lifted ? 2u : 1u;
    path->point[path->legs][0] = to[0];
    path->point[path->legs][1] = to[1];
    return path;
}
