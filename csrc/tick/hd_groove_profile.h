/* Positions and profile of grooves: groove k lies at s = k spacing. */
#ifndef HD_GROOVE_PROFILE_H
#define HD_GROOVE_PROFILE_H

#include <math.h>

#include "api/hd_core.h"
#include "base/hd_rt.h"

/* A groove at most this far beyond the bottom of a disc, in half circumferences, lies on the bottom: covers rounding.
 */
#define HD_GROOVE_SEAM 1e-12

/* Returns the number of the groove at or below s. Coordinates are bounded and spacings are at least 1e-9 m, so it fits.
 */
HD_RT static inline int64_t hd_groove_below(double spacing_m, double arc_m) {
    HD_RT_FOREIGN_BEGIN
    const double quotient = floor(arc_m / spacing_m);
    HD_RT_FOREIGN_END
    const double bounded = quotient < -9e15 ? -9e15 : quotient > 9e15 ? 9e15 : quotient;
    int64_t k = (int64_t)bounded;
    /* Corrects the rounded quotient: a groove lies at the rounded product k * spacing. */
    if ((double)k * spacing_m > arc_m) {
        k--;
    } else if ((double)(k + 1) * spacing_m <= arc_m) {
        k++;
    }
    return k;
}

/* Returns the profile at s, 0 to 1, a raised cosine at each groove, and its derivative by s in `slope`. */
HD_RT double hd_groove_profile(const struct hd_material *material, double arc_m, double half_length_m, double *slope);

#endif
