/* Ways to make coloured noise, for bench/noise.py. All take the same white numbers as csrc/tick/hd_noise.c: Gaussian,
 * of unit power, from splitmix64. */
#include <string.h>

#include "base/hd_gaussian.h"
#include "peers.h"
#include "tick/hd_noise.h"

static inline double white(uint64_t *random) {
    *random += 0x9e3779b97f4a7c15u;
    uint64_t z = *random;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    z ^= z >> 31;
    return hd_gaussian(z);
}

static void direct(size_t order, const double *coefficients, const double *gains, size_t count, const uint8_t *which,
                   uint64_t seed, double *out) {
    double past[PEER_NOISE_ORDER] = {0.0}; /* the newest first */
    for (size_t k = 0; k < count; k++) {
        const double *a = coefficients + order * which[k];
        double x = gains[which[k]] * white(&seed);
        for (size_t i = 0; i < order; i++) {
            x -= a[i] * past[i];
        }
        memmove(past + 1, past, (PEER_NOISE_ORDER - 1) * sizeof *past);
        past[0] = x;
        out[k] = x;
    }
}

/* f_(m-1) = f_m - k_m b_(m-1)[n-1], b_m = k_m f_(m-1) + b_(m-1)[n-1]: what a frozen filter makes is the same. */
static void ladder(size_t order, const double *coefficients, const double *gains, size_t count, const uint8_t *which,
                   uint64_t seed, double *out) {
    double delay[PEER_NOISE_ORDER + 1] = {0.0};
    for (size_t k = 0; k < count; k++) {
        const double *reflection = coefficients + order * which[k];
        double f = gains[which[k]] * white(&seed);
        for (size_t m = order; m > 0; m--) {
            const double b = delay[m - 1];
            f -= reflection[m - 1] * b;
            delay[m] = reflection[m - 1] * f + b;
        }
        delay[0] = f;
        out[k] = f;
    }
}

double peer_noise(int kind, size_t order, const double *coefficients, const double *gains, size_t count,
                  const uint8_t *which, uint64_t seed, double *out) {
    const double start_ns = peer_clock_ns();
    if (kind == PEER_NOISE_DIRECT) {
        direct(order, coefficients, gains, count, which, seed, out);
    } else if (kind == PEER_NOISE_LADDER) {
        ladder(order, coefficients, gains, count, which, seed, out);
    } else if (kind == PEER_NOISE_TABLE) {
        size_t at = 0;
        for (size_t k = 0; k < count; k++) {
            out[k] = coefficients[at];
            at = at + 1 == order ? 0 : at + 1;
        }
    } else {
        for (size_t k = 0; k < count; k++) {
            out[k] = white(&seed);
        }
    }
    return peer_clock_ns() - start_ns;
}

double peer_noise_lattice(const void *noise, const double *numbers, size_t count, const double *speed,
                          const double *force, double *out) {
    static struct hd_active_noise active;
    hd_noise_start(&active, noise, numbers, 0);
    const double start_ns = peer_clock_ns();
    for (size_t k = 0; k < count; k++) {
        out[k] = hd_noise_next(&active, noise, numbers, speed[k], force[k], 1.0);
    }
    return peer_clock_ns() - start_ns;
}
