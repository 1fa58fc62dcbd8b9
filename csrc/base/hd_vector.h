/* Vectors of the plane: products, lengths, differences and turns of pairs of doubles. */
#ifndef HD_VECTOR_H
#define HD_VECTOR_H

#include <math.h>

#include "base/hd_rt.h"

HD_RT static inline double hd_dot(const double a[2], const double b[2]) {
    return a[0] * b[0] + a[1] * b[1];
}

HD_RT static inline void hd_difference(const double a[2], const double b[2], double out[2]) {
    out[0] = a[0] - b[0];
    out[1] = a[1] - b[1];
}

/* The point `fraction` of the way from a to b. */
HD_RT static inline void hd_between(const double a[2], const double b[2], double fraction, double out[2]) {
    out[0] = a[0] + fraction * (b[0] - a[0]);
    out[1] = a[1] + fraction * (b[1] - a[1]);
}

/* The tangent of a surface with this normal: (1, 0) for a floor with the normal (0, 1). */
HD_RT static inline void hd_tangent(const double normal[2], double out[2]) {
    out[0] = normal[1];
    out[1] = -normal[0];
}

HD_RT static inline double hd_root(double square) {
    HD_RT_FOREIGN_BEGIN
    return sqrt(square);
    HD_RT_FOREIGN_END
}

HD_RT static inline double hd_distance(const double a[2], const double b[2]) {
    double step[2];
    hd_difference(a, b, step);
    return hd_root(hd_dot(step, step));
}

HD_RT static inline double hd_magnitude(double value) {
    return value < 0.0 ? -value : value;
}

#endif
