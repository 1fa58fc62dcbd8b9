/* The path of the proxy in a tick: projected out of the pressed surfaces, and split into swept segments. */
#include "shapes/hd_proxy.h"

#include "base/hd_vector.h"

/* Height of the proxy above its surface: it passes above the side of a flush solid. Too small to be felt. */
#define HD_PROXY_LIFT_M HD_FLUSH_M
#define HD_PROXY_ITERATIONS 3
#define HD_FLUSH_SLOPE 1e-3 /* flush faces are turned by far less, the faces of a corner by more */

/* Whether plane `i` forms a narrow corner with one of a set of planes. */
HD_RT static int is_in_narrow_corner(const struct hd_proxy *proxy, uint32_t i, uint32_t planes) {
    for (uint32_t other = 0; other < proxy->plane_count; other++) {
        if ((planes & 1u << other) && hd_proxy_is_narrow(&proxy->plane[other], &proxy->plane[i])) {
            return 1;
        }
    }
    return 0;
}

HD_RT static int is_deeper(const struct hd_proxy_plane *plane, const struct hd_proxy_plane *other) {
    return plane->depth_m > other->depth_m || (plane->depth_m == other->depth_m && plane->slot < other->slot);
}

/* Returns the planes out of which the proxy is projected, as a set of bits: all but that of `slot`, and of a corner
 * narrower than 60 degrees only the plane that is pressed deeper. The edge of such a corner may be far from the probe;
 * the proxy stays on the deeper plane and does not leap to the edge. Then its distance from the probe is at most twice
 * the largest depth. */
HD_RT static uint32_t projected_planes(const struct hd_proxy *proxy, uint32_t slot) {
    uint32_t planes = 0;
    uint32_t left = (1u << proxy->plane_count) - 1u;
    while (left != 0) {
        uint32_t deepest = HD_PROXY_PLANES;
        for (uint32_t i = 0; i < proxy->plane_count; i++) {
            if ((left & 1u << i) &&
                (deepest == HD_PROXY_PLANES || is_deeper(&proxy->plane[i], &proxy->plane[deepest]))) {
                deepest = i;
            }
        }
        left &= ~(1u << deepest);
        if (proxy->plane[deepest].slot != slot && !is_in_narrow_corner(proxy, deepest, planes)) {
            planes |= 1u << deepest;
        }
    }
    return planes;
}

HD_RT int hd_proxy_project(const struct hd_proxy *proxy, const double position_m[2], uint32_t slot,
                           double projected_m[2]) {
    const uint32_t planes = proxy->narrow ? projected_planes(proxy, slot) : UINT32_MAX;
    int moved = 0;
    projected_m[0] = position_m[0];
    projected_m[1] = position_m[1];
    /* One iteration is exact for surfaces at right angles; for others the iterations converge. */
    for (int iteration = 0; iteration < HD_PROXY_ITERATIONS; iteration++) {
        int any = 0;
        for (uint32_t i = 0; i < proxy->plane_count; i++) {
            const struct hd_proxy_plane *plane = &proxy->plane[i];
            if (plane->slot == slot || !(planes & 1u << i)) {
                continue;
            }
            double step[2];
            hd_difference(projected_m, proxy->from_m, step);
            const double depth = plane->depth_m - hd_dot(step, plane->normal);
            if (depth > 0.0) {
                projected_m[0] += (depth + HD_PROXY_LIFT_M) * plane->normal[0];
                projected_m[1] += (depth + HD_PROXY_LIFT_M) * plane->normal[1];
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

HD_RT double hd_proxy_offset(const struct hd_proxy *proxy, uint32_t slot, const double normal[2],
                             const double position_m[2]) {
    double projected_m[2];
    if (!hd_proxy_project(proxy, position_m, slot, projected_m)) {
        return 0.0;
    }
    double shift[2];
    double tangent[2];
    hd_tangent(normal, tangent);
    hd_difference(projected_m, position_m, shift);
    return hd_dot(shift, tangent);
}

HD_RT int hd_proxy_is_above_end(const struct hd_proxy *proxy, uint32_t slot, const double normal[2], double along_m) {
    double past_end[2];
    hd_tangent(normal, past_end);
    for (uint32_t i = 0; i < proxy->plane_count; i++) {
        const double rise = hd_dot(past_end, proxy->plane[i].normal);
        if (proxy->plane[i].slot != slot && (along_m < 0.0 ? -rise : rise) > HD_FLUSH_SLOPE) {
            return 1;
        }
    }
    return 0;
}

HD_RT const struct hd_proxy *hd_proxy_sweep(struct hd_proxy *proxy) {
    if (proxy->known) {
        return proxy;
    }
    proxy->known = 1;
    const int lifted = hd_proxy_project(proxy, proxy->from_m, HD_NO_SLOT, proxy->point[0]) |
                       hd_proxy_project(proxy, proxy->to_m, HD_NO_SLOT, proxy->point[1]);
    proxy->segments = lifted ? 2u : 1u;
    proxy->point[proxy->segments][0] = proxy->to_m[0];
    proxy->point[proxy->segments][1] = proxy->to_m[1];
    return proxy;
}
