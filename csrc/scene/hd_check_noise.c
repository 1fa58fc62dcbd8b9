/* The check of a noise and of its numbers. */
#include <math.h>

#include "scene/hd_check.h"
#include "scene/hd_table_numbers.h"

#define HD_LARGEST_RMS 1e9     /* m/s^2 */
#define HD_TAPS_TOLERANCE 1e-9 /* of the sum of squares */

static int at_least_zero(double value) {
    return isfinite(value) && value >= 0.0;
}

/* Whether the values are finite, at least 0 and strictly rising. */
static int is_rising(const double *axis, uint32_t count) {
    int ok = at_least_zero(axis[0]) && at_least_zero(axis[count - 1]);
    for (uint32_t i = 1; i < count; i++) {
        ok = ok && axis[i] > axis[i - 1];
    }
    return ok;
}

static int check_node(const struct hd_noise *noise, const double *node, const char *what, uint64_t index) {
    const unsigned long long which = (unsigned long long)index;
    if (!(node[0] >= 0.0 && node[0] <= HD_LARGEST_RMS)) {
        return hd_invalid("%s: RMS %g m/s^2 of node %llu must be between 0 and %g", what, node[0], which,
                          HD_LARGEST_RMS);
    }
    const double *sine = node + 1;
    for (uint32_t m = 0; m < noise->order; m++) {
        if (!(sine[m] > -1.0 && sine[m] < 1.0)) {
            return hd_invalid("%s: unstable: reflection coefficient %u of node %llu must be between -1 and 1, is %.17g",
                              what, m + 1, which, sine[m]);
        }
    }
    if (noise->taps) {
        const double *tap = sine + noise->order;
        double squares = 0.0;
        for (uint32_t m = 0; m <= noise->order; m++) {
            squares += tap[m] * tap[m];
        }
        if (!(squares >= 1.0 - HD_TAPS_TOLERANCE && squares <= 1.0 + HD_TAPS_TOLERANCE)) {
            return hd_invalid("%s: the squares of the taps of node %llu must add up to 1, are %.12g", what, which,
                              squares);
        }
    }
    return HD_OK;
}

int hd_noise_check(const struct hd_noise *noise, const double *numbers, uint32_t number_count, const char *what) {
    if (noise->order > HD_NOISE_ORDER) {
        return hd_invalid("%s: order %u must be at most %d", what, noise->order, HD_NOISE_ORDER);
    }
    if (noise->taps > 1 || noise->along_normal > 1) {
        return hd_invalid("%s: taps %u and along_normal %u must be 0 or 1", what, noise->taps, noise->along_normal);
    }
    if (!at_least_zero(noise->threshold_m_per_s) || !at_least_zero(noise->force_per_unit)) {
        return hd_invalid("%s: threshold %g m/s and force per unit %g must be finite and at least 0", what,
                          noise->threshold_m_per_s, noise->force_per_unit);
    }
    if (!isfinite(noise->velocity_gain_per_s) || !isfinite(noise->force_gain_m_per_s2_per_n)) {
        return hd_invalid("%s: velocity gain %g and force gain %g must be finite", what, noise->velocity_gain_per_s,
                          noise->force_gain_m_per_s2_per_n);
    }
    if (noise->speed_count == 0 || noise->force_count == 0) {
        return hd_invalid("%s: the grid has %u speeds and %u forces; it needs at least one of each", what,
                          noise->speed_count, noise->force_count);
    }
    /* In this order nothing overflows: the product of two 32-bit counts fits, and so does a node's size times
     * number_count. */
    const uint64_t size = hd_noise_node_size(noise);
    const uint64_t nodes = (uint64_t)noise->speed_count * noise->force_count;
    const uint64_t axes = (uint64_t)noise->speed_count + noise->force_count;
    if (nodes > number_count || (uint64_t)noise->first + axes + nodes * size > number_count) {
        return hd_invalid(
            "%s: %u speeds, %u forces and their nodes of %llu numbers from number %u on do not fit into %u", what,
            noise->speed_count, noise->force_count, (unsigned long long)size, noise->first, number_count);
    }
    const double *speeds = numbers + noise->first;
    const double *forces = speeds + noise->speed_count;
    if (!is_rising(speeds, noise->speed_count)) {
        return hd_invalid("%s: the speeds must be finite, at least 0 and rising", what);
    }
    if (!is_rising(forces, noise->force_count)) {
        return hd_invalid("%s: the forces must be finite, at least 0 and rising", what);
    }
    const double *node = forces + noise->force_count;
    for (uint64_t i = 0; i < nodes; i++, node += size) {
        const int status = check_node(noise, node, what, i);
        if (status != HD_OK) {
            return status;
        }
    }
    return HD_OK;
}
