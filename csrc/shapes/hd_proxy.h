/* The path of the proxy in a tick: the point of the surface that stands for the probe (Zilles and Salisbury 1995:
 * god-object; Ruspini, Kolarov and Khatib 1997: virtual proxy).
 *
 * A probe that presses lies inside what it presses; what it touches next is met where the surface is, not where the
 * probe is. So, for what is not touched yet, a probe that presses goes along two swept segments: along the surfaces
 * that it presses, and from there straight to where it is. Then a floor of two boxes side by side has no seam, and a
 * step on a floor is met, however deep the probe is in the floor. A probe that presses nothing goes along one segment,
 * from sample to sample. */
#ifndef HD_PROXY_H
#define HD_PROXY_H

#include "api/hd_core.h"
#include "base/hd_rt.h"

#define HD_PROXY_PLANES 16u /* surfaces that count as pressed; a hand presses two or three */

struct hd_proxy {
    double from_m[2];   /* the last sample; this one where the last says nothing */
    double to_m[2];     /* this sample */
    int known;          /* the next two are worked out */
    uint32_t segments;  /* 1 or 2 */
    double point[3][2]; /* segments + 1 of them; the last is the sample */
    uint32_t plane_count;
    struct hd_proxy_plane {
        uint32_t slot;
        double depth_m; /* at the last sample */
        double normal[2];
    } plane[HD_PROXY_PLANES];
};

/* One more surface that is pressed as the tick begins. Beyond HD_PROXY_PLANES none is taken. */
HD_RT static inline void hd_proxy_press(struct hd_proxy *proxy, uint32_t slot, double depth_m, const double normal[2]) {
    if (proxy->plane_count < HD_PROXY_PLANES) {
        struct hd_proxy_plane *plane = &proxy->plane[proxy->plane_count++];
        plane->slot = slot;
        plane->depth_m = depth_m;
        plane->normal[0] = normal[0];
        plane->normal[1] = normal[1];
    }
}

/* The swept segments; worked out at the first call in a tick. */
HD_RT const struct hd_proxy *hd_proxy_sweep(struct hd_proxy *proxy);
/* The proxy of `position_m`: that point, lifted out of every surface that is pressed but that of `slot`. 0: it lies in
 * none. */
HD_RT int hd_proxy_project(const struct hd_proxy *proxy, const double position_m[2], uint32_t slot,
                           double projected_m[2]);
/* How far along a surface of this normal the proxy of `position_m` lies from it: 0 where nothing but `slot` is pressed.
 */
HD_RT double hd_proxy_offset(const struct hd_proxy *proxy, uint32_t slot, const double normal[2],
                             const double position_m[2]);

#endif
