/* The shape of a groove: its height, from 0 to 1, and its slope at an arc length. */
#include "tick/hd_groove_profile.h"

#include "base/hd_vector.h"

#define HD_PI 3.14159265358979323846

/* Whether groove k has a shape: it lies completely on the disc, or its two halves meet at the bottom. */
HD_RT static int has_shape(const struct hd_material *material, int64_t k, double half_length_m) {
    const double middle_m = hd_magnitude((double)k * material->spacing_m);
    return middle_m + 0.5 * material->width_m <= half_length_m ||
           hd_magnitude(middle_m - half_length_m) <= HD_GROOVE_SEAM * half_length_m;
}

HD_RT double hd_groove_profile(const struct hd_material *material, double arc_m, double half_length_m, double *slope) {
    *slope = 0.0;
    const int64_t k = hd_groove_below(material->spacing_m, arc_m + 0.5 * material->spacing_m);
    const double offset = arc_m - (double)k * material->spacing_m;
    if (2.0 * hd_magnitude(offset) >= material->width_m || !has_shape(material, k, half_length_m)) {
        return 0.0;
    }
    const double turn = 2.0 * HD_PI / material->width_m;
    HD_RT_FOREIGN_BEGIN
    *slope = -0.5 * turn * sin(turn * offset);
    return 0.5 + 0.5 * cos(turn * offset);
    HD_RT_FOREIGN_END
}
