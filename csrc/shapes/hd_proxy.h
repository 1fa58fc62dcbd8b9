/* The path of the proxy in a tick. The proxy is the point on the surface that represents the probe (Zilles and
 * Salisbury 1995: god-object; Ruspini, Kolarov and Khatib 1997: virtual proxy).
 *
 * A pressing probe lies inside the objects that it presses, but must meet the next object at the surface. So objects
 * that are not touched yet are tested against two swept segments: one along the pressed surfaces, and one from its end
 * straight to the probe. Then a floor of two adjacent boxes has no seam, and the probe meets a step on the floor at any
 * depth in the floor. A probe that presses nothing moves along one segment, from sample to sample.
 *
 * The proxy is at most twice the largest depth away from the probe. When a second surface begins to be pressed, it
 * steps by at most 0.58 times the largest depth, through the solid of that surface (tests/c/test_proxy.c). */
#ifndef HD_PROXY_H
#define HD_PROXY_H

#include "api/hd_core.h"
#include "base/hd_rt.h"
#include "base/hd_vector.h"

/* A point at most this far, in m, from the surface of a solid counts as on it. It is above the rounding of any
 * reachable coordinate. */
#define HD_RIM_M 1e-12
/* Adjacent faces that differ by at most this, in m, are one surface: in height, in the gap or the overlap of their
 * ends, and by their angle over the distance between their middles. A point at most this far past the end of a face
 * counts as on it. It is far below the step of an encoder. */
#define HD_FLUSH_M 1e-9
/* A face can be met at most this far, in m, from its end while a flush one still holds the probe: the flush one reaches
 * HD_FLUSH_M past its end, and the two can overlap by HD_FLUSH_M. */
#define HD_SEAM_M (2.0 * HD_FLUSH_M)

/* Scalar product of the normals of two surfaces that form a corner of 60 degrees. */
#define HD_PROXY_NARROW_CORNER (-0.5)
#define HD_PROXY_PLANES 16u /* largest number of surfaces that count as pressed; typically there are two or three */

struct hd_proxy {
    double from_m[2];   /* the last sample; after contacts were cleared, this sample */
    double to_m[2];     /* this sample */
    int known;          /* `segments` and `point` are computed */
    uint32_t segments;  /* 1 or 2 */
    double point[3][2]; /* segments + 1 points; the last is this sample */
    uint32_t plane_count;
    int narrow; /* two of the planes form a corner narrower than 60 degrees */
    struct hd_proxy_plane {
        uint32_t slot;
        double depth_m; /* at the last sample */
        double normal[2];
    } plane[HD_PROXY_PLANES];
};

/* Whether two surfaces form a corner narrower than 60 degrees. */
HD_RT static inline int hd_proxy_is_narrow(const struct hd_proxy_plane *plane, const struct hd_proxy_plane *other) {
    return hd_dot(plane->normal, other->normal) < HD_PROXY_NARROW_CORNER;
}

/* Adds a surface that is pressed at the start of the tick. More than HD_PROXY_PLANES surfaces are ignored. */
HD_RT static inline void hd_proxy_press(struct hd_proxy *proxy, uint32_t slot, double depth_m, const double normal[2]) {
    if (proxy->plane_count < HD_PROXY_PLANES) {
        struct hd_proxy_plane *plane = &proxy->plane[proxy->plane_count++];
        plane->slot = slot;
        plane->depth_m = depth_m;
        plane->normal[0] = normal[0];
        plane->normal[1] = normal[1];
        for (const struct hd_proxy_plane *other = proxy->plane; other < plane; other++) {
            proxy->narrow |= hd_proxy_is_narrow(plane, other);
        }
    }
}

/* Computes the swept segments at the first call in a tick, and returns the proxy. */
HD_RT const struct hd_proxy *hd_proxy_sweep(struct hd_proxy *proxy);
/* Projects `position_m` out of every pressed surface except that of `slot`. Returns 0 if it lies below none of them. */
HD_RT int hd_proxy_project(const struct hd_proxy *proxy, const double position_m[2], uint32_t slot,
                           double projected_m[2]);
/* Returns the distance from `position_m` to its projection (hd_proxy_project) along the tangent of a surface with this
 * normal, m; 0 if no other surface than that of `slot` is pressed. */
HD_RT double hd_proxy_offset(const struct hd_proxy *proxy, uint32_t slot, const double normal[2],
                             const double position_m[2]);
/* Whether the end of a face lies above a pressed surface other than that of `slot`. `along_m`: s of the proxy on the
 * face, of the sign of that end. */
HD_RT int hd_proxy_is_above_end(const struct hd_proxy *proxy, uint32_t slot, const double normal[2], double along_m);

/* Whether the proxy is past an end of a face, by `past_m`. A face holds it up to HD_FLUSH_M past its end, except at an
 * end above a pressed surface: there the proxy moves at HD_FLUSH_M, and passes above the side of a flush solid. */
HD_RT static inline int hd_proxy_is_past_end(const struct hd_proxy *proxy, uint32_t slot, const double normal[2],
                                             double along_m, double past_m) {
    return past_m > HD_FLUSH_M || (past_m > -HD_RIM_M && hd_proxy_is_above_end(proxy, slot, normal, along_m));
}

#endif
