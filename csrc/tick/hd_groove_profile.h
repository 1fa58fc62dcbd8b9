/* The places of grooves, and their profile: groove k lies at s = k spacing. */
#ifndef HD_GROOVE_PROFILE_H
#define HD_GROOVE_PROFILE_H

#include <math.h>

#include "api/hd_core.h"
#include "base/hd_rt.h"

/* So near to the bottom of a disc, in half its circumference, a groove lies on it: rounding does not lose it. */
#define HD_GROOVE_SEAM 1e-12

/* The groove at or below s. Coordinates are bounded and spacings are not below 1e-9 m, so it fits. */
HD_RT static inline int64_t hd_groove_below(double spacing_m, double arc_m) {
    HD_RT_FOREIGN_BEGIN
    const double quotient = floor(arc_m / spacing_m);
    HD_RT_FOREIGN_END
    const double bounded = quotient < -9e15 ? -9e15 : quotient > 9e15 ? 9e15 : quotient;
    int64_t k = (int64_t)bounded;
    /* The quotient is rounded; the groove lies at the rounded product. */
    if ((double)k * spacing_m > arc_m) {
        k--;
    } else if ((double)(k + 1) * spacing_m <= arc_m) {
        k++;
    }
    return k;
}

/* The raised cosine over the nearest groove, 0 to 1, and its slope over s. */
HD_RT double hd_groove_profile(const struct hd_material *material, double arc_m, double half_length_m, double *slope);

#endif
