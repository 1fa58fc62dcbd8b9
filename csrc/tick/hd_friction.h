/* Coulomb friction with a pre-sliding spring, in the drift-free discrete form of Hayward and Armstrong (2000).
 *
 * The probe sticks to an anchor on the surface by a spring of stiffness k. While k |s - anchor| <= mu F_n the anchor
 * does not move at all: nothing drifts under load, nothing chatters at rest. Beyond it the anchor follows, so that the
 * spring never holds more than mu F_n. */
#ifndef HD_FRICTION_H
#define HD_FRICTION_H

#include "base/hd_rt.h"
#include "tick/hd_state.h"

/* The force along the tangent; moves the anchor. */
HD_RT static inline double hd_friction(const struct hd_surface *surface, double normal_n, double arc_m,
                                       double *anchor_m) {
    if (!(surface->friction_coefficient > 0.0)) {
        *anchor_m = arc_m;
        return 0.0;
    }
    const double longest = surface->friction_coefficient * normal_n / surface->friction_stiffness_n_per_m;
    const double stretch = arc_m - *anchor_m;
    if (stretch > longest) {
        *anchor_m = arc_m - longest;
    } else if (stretch < -longest) {
        *anchor_m = arc_m + longest;
    }
    return -surface->friction_stiffness_n_per_m * (arc_m - *anchor_m);
}

#endif
