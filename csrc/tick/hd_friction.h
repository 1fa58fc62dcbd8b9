/* Coulomb friction with a pre-sliding spring, in the drift-free discrete form of Hayward and Armstrong (2000).
 *
 * A spring of stiffness k ties the probe to an anchor on the surface. While k |s - anchor| <= mu F_n the anchor does
 * not move, so the probe neither drifts under load nor chatters at rest. Beyond that the anchor follows the probe, so
 * that the force of the spring is at most mu F_n. On a round surface the anchor also moves with s, so that s - anchor
 * is the motion of the probe itself (hd_contact_force.c). */
#ifndef HD_FRICTION_H
#define HD_FRICTION_H

#include "base/hd_rt.h"
#include "tick/hd_state.h"

/* Returns the friction force along the tangent and moves the anchor. */
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
