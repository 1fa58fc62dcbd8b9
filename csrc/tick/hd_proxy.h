/* The way that the probe's proxy goes in a tick.
 *
 * A probe that presses lies inside what it presses; what it touches next is met where the surface is, not where the
 * probe is. So, for what is not touched yet, a probe that presses goes in two legs: along the surfaces that it presses,
 * and from there straight to where it is. Then a floor of two boxes side by side has no seam, and a step on a floor is
 * met, however deep the probe is in the floor. A probe that presses nothing goes in one leg, from sample to sample. */
#ifndef HD_PROXY_H
#define HD_PROXY_H

#include "base/hd_rt.h"
#include "tick/hd_state.h"

#define HD_PROXY_PLANES 16u /* surfaces that are looked at; a hand presses two or three */

struct hd_context;

struct hd_proxy {
    int known;
    uint32_t legs;      /* 1 or 2 */
    double point[3][2]; /* legs + 1 of them; the last is the sample */
    uint32_t plane_count;
    struct {
        uint32_t slot;
        double depth_m; /* at the last sample */
        double normal[2];
    } plane[HD_PROXY_PLANES];
};

/* The surfaces that are pressed as the tick begins. */
HD_RT void hd_proxy_begin(struct hd_context *context);
/* The legs; worked out at the first call in a tick. */
HD_RT const struct hd_proxy *hd_proxy_sweep(struct hd_context *context);
/* `position_m`, lifted out of every surface that is pressed but that of `slot`. 0: it lies in none. */
HD_RT int hd_proxy_project(const struct hd_context *context, const double position_m[2], uint32_t slot,
                           double lifted[2]);
/* How far along a surface of this normal the proxy of `position_m` lies from it: 0 where nothing but `slot` is
 * pressed. */
HD_RT double hd_proxy_offset(const struct hd_context *context, uint32_t slot, const double normal[2],
                             const double position_m[2]);

#endif
