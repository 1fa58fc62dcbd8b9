/* Gaussian numbers from 64 random bits, without libm, hence identical on every machine.
 *
 * The bits give the probability U/2 of the upper tail: U in (0, 1), its binary digits in order. z = -Phi^-1(U/2) is
 * approximated by a cubic on each quarter of each octave of U, through the four Chebyshev nodes of the quarter
 * (hd_gaussian.c). The error is at most 2.2e-6 in z and 3e-8 in the variance. Numbers beyond 5.973, one in 4e8, become
 * 6. The last bit is the sign. */
#ifndef HD_GAUSSIAN_H
#define HD_GAUSSIAN_H

#include <stdint.h>

#include "base/hd_rt.h"

#define HD_GAUSSIAN_MOST 6.0 /* largest magnitude of a number */
#define HD_GAUSSIAN_OCTAVES 30
#define HD_GAUSSIAN_PARTS 4 /* of each octave */

extern const double hd_gaussian_cubics[HD_GAUSSIAN_OCTAVES * HD_GAUSSIAN_PARTS][4];

HD_RT static inline double hd_gaussian(uint64_t bits) {
    const uint64_t tail = bits & ~(uint64_t)1;
    const unsigned zeros = (unsigned)__builtin_clzll(tail | 1u);
    const unsigned octave = zeros < HD_GAUSSIAN_OCTAVES - 1 ? zeros : HD_GAUSSIAN_OCTAVES - 1;
    const uint64_t digits = tail << octave << 1; /* digits after the first 1 */
    const double *c = hd_gaussian_cubics[octave * HD_GAUSSIAN_PARTS + (digits >> 62)];
    const double t = (double)(int64_t)(digits << 2 >> 12) * 0x1p-52;
    const double z = (c[0] + c[1] * t) + t * t * (c[2] + c[3] * t);
    return (double)(1 - 2 * (int)(bits & 1u)) * z; /* no branch, which would be mispredicted half of the time */
}

#endif
