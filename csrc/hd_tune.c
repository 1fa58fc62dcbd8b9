#include "hd_tune.h"

#include <math.h>

#include "hd_vector.h"

#define HD_TUNE_LARGEST 1e9
#define HD_TUNE_SMALLEST 1e-9

/* Between which of the rising points a value lies, and how far from the one to the other. */
struct between {
    uint32_t from;
    uint32_t to;
    double share;
};

HD_RT static struct between find(const double *points, uint32_t count, uint32_t stride, double value) {
    uint32_t to = 0;
    while (to < count && points[to * stride] <= value) {
        to++;
    }
    if (to == 0 || to == count) {
        const uint32_t end = to == 0 ? 0 : count - 1u;
        return (struct between){end, end, 0.0};
    }
    const double from = points[(to - 1u) * stride];
    return (struct between){to - 1u, to, (value - from) / (points[to * stride] - from)};
}

HD_RT static double along(double from, double to, double share) {
    return from + share * (to - from);
}

HD_RT static double frequency(const struct hd_table *table, const struct hd_material *material, double speed_m_per_s,
                              double force_n) {
    const uint32_t forces = material->tune_forces;
    const double *numbers = table->numbers + material->tune_first;
    const struct between speed = find(numbers, material->tune_speeds, 1, speed_m_per_s);
    const struct between force = find(numbers + material->tune_speeds, forces, 1, force_n);
    const double *grid = numbers + material->tune_speeds + forces;
    const double *slow = grid + (size_t)speed.from * forces;
    const double *fast = grid + (size_t)speed.to * forces;
    return along(along(slow[force.from], slow[force.to], force.share),
                 along(fast[force.from], fast[force.to], force.share), speed.share);
}

/* The first maximum of exp(-B t) sin(w t): at t = atan(w/B)/w. */
HD_RT static double first_peak(double decay_rate_per_s, double angular_frequency, double *time_s) {
    HD_RT_FOREIGN_BEGIN
    *time_s = atan2(angular_frequency, decay_rate_per_s) / angular_frequency;
    return exp(-decay_rate_per_s * *time_s) * angular_frequency /
           sqrt(angular_frequency * angular_frequency + decay_rate_per_s * decay_rate_per_s);
    HD_RT_FOREIGN_END
}

HD_RT int hd_tune_strike(const struct hd_table *table, const struct hd_material *material, double speed_m_per_s,
                         double force_n, struct hd_strike *strike) {
    double wanted = frequency(table, material, hd_magnitude(speed_m_per_s), force_n);
    const double highest = material->tune_highest_rad_per_s;
    if (wanted > highest) {
        if (material->tune_mutes) {
            return 0;
        }
        const double decay = material->groove.decay_rate_per_s;
        double time_s;
        strike->units *= first_peak(decay, wanted, &time_s) / first_peak(decay, highest, &time_s);
        wanted = highest;
    }
    strike->tuned = material;
    strike->tuned_rad_per_s = wanted;
    return 1;
}

HD_RT static void compensate(const double *nodes, uint32_t count, struct hd_mode *mode) {
    const struct between place = find(nodes, count, HD_TUNE_NODE, mode->angular_frequency_rad_per_s);
    const double *from = nodes + (size_t)place.from * HD_TUNE_NODE;
    const double *to = nodes + (size_t)place.to * HD_TUNE_NODE;
    double *const numbers[HD_TUNE_NODE] = {
        [HD_TUNE_GAIN] = &mode->gain_re,
        [HD_TUNE_GAIN + 1] = &mode->gain_im,
        [HD_TUNE_TAIL] = &mode->tail_re,
        [HD_TUNE_TAIL + 1] = &mode->tail_im,
        [HD_TUNE_FREE_GAIN] = &mode->free_gain_re,
        [HD_TUNE_FREE_GAIN + 1] = &mode->free_gain_im,
        [HD_TUNE_FREE_TAIL] = &mode->free_tail_re,
        [HD_TUNE_FREE_TAIL + 1] = &mode->free_tail_im,
        [HD_TUNE_PEAK] = &mode->peak,
        [HD_TUNE_FREE_PEAK] = &mode->free_peak,
    };
    for (uint32_t i = HD_TUNE_GAIN; i < HD_TUNE_NODE; i++) {
        *numbers[i] = along(from[i], to[i], place.share);
    }
}

HD_RT void hd_tune_mode(const struct hd_table *table, const struct hd_strike *strike, struct hd_mode *mode) {
    const struct hd_material *material = strike->tuned;
    *mode = material->groove;
    mode->angular_frequency_rad_per_s = strike->tuned_rad_per_s;
    mode->peak = first_peak(mode->decay_rate_per_s, strike->tuned_rad_per_s, &mode->peak_time_s);
    HD_RT_FOREIGN_BEGIN
    const double magnitude = exp(-mode->decay_rate_per_s * table->period_s);
    mode->rotor_re = magnitude * cos(strike->tuned_rad_per_s * table->period_s);
    mode->rotor_im = magnitude * sin(strike->tuned_rad_per_s * table->period_s);
    HD_RT_FOREIGN_END
    if (material->tune_nodes > 0) {
        const size_t nodes = material->tune_speeds + material->tune_forces +
                             (size_t)material->tune_speeds * material->tune_forces + material->tune_first;
        compensate(table->numbers + nodes, material->tune_nodes, mode);
    }
}

/* ---- Checks ------------------------------------------------------------------------------------------------- */

static int rises(const double *points, uint32_t count, uint32_t stride, double least) {
    for (uint32_t i = 0; i < count; i++) {
        const double before = i > 0 ? points[(i - 1u) * stride] + HD_TUNE_SMALLEST : least;
        if (!(points[i * stride] >= before && points[i * stride] <= HD_TUNE_LARGEST)) {
            return 0;
        }
    }
    return 1;
}

static int lies(const double *numbers, size_t count, double least) {
    for (size_t i = 0; i < count; i++) {
        if (!(numbers[i] >= least && numbers[i] <= HD_TUNE_LARGEST)) {
            return 0;
        }
    }
    return 1;
}

int hd_tune_check(const struct hd_material *material, const struct hd_table *table, uint32_t index) {
    const uint32_t speeds = material->tune_speeds;
    const uint32_t forces = material->tune_forces;
    const uint32_t nodes = material->tune_nodes;
    if (speeds == 0) {
        return HD_OK;
    }
    if (speeds > HD_TUNE_POINTS || forces == 0 || forces > HD_TUNE_POINTS || nodes > HD_TUNE_NODES) {
        return hd_invalid(
            "material %u: groove frequencies at %u speeds and %u forces with %u nodes; 1 to %u, at most %u", index,
            speeds, forces, nodes, HD_TUNE_POINTS, HD_TUNE_NODES);
    }
    const uint32_t grid = speeds * forces;
    const uint32_t count = speeds + forces + grid + nodes * HD_TUNE_NODE;
    if (material->tune_first > table->number_count || count > table->number_count - material->tune_first) {
        return hd_invalid("material %u: %u numbers of groove frequencies, from number %u on, do not fit into %u", index,
                          count, material->tune_first, table->number_count);
    }
    const double *numbers = table->numbers + material->tune_first;
    const double *node = numbers + speeds + forces + grid;
    if (!rises(numbers, speeds, 1, 0.0) || !rises(numbers + speeds, forces, 1, 0.0) ||
        !lies(numbers + speeds + forces, grid, HD_TUNE_SMALLEST) ||
        !rises(node, nodes, HD_TUNE_NODE, HD_TUNE_SMALLEST) ||
        !lies(node, (size_t)nodes * HD_TUNE_NODE, -HD_TUNE_LARGEST)) {
        return hd_invalid(
            "material %u: speeds, forces or nodes of its groove frequencies do not rise, or are out of range", index);
    }
    for (uint32_t i = 0; i < nodes; i++) {
        if (!lies(node + (size_t)i * HD_TUNE_NODE + HD_TUNE_PEAK, 2, 0.0)) {
            return hd_invalid("material %u: node %u of its groove frequencies has a peak below 0", index, i);
        }
    }
    if (!(material->tune_highest_rad_per_s >= HD_TUNE_SMALLEST &&
          material->tune_highest_rad_per_s <= HD_TUNE_LARGEST) ||
        material->tune_mutes > 1 || !(material->groove.decay_rate_per_s > 0.0)) {
        return hd_invalid("material %u: groove frequencies up to %g rad/s, muted above (%u), decay rate %g 1/s", index,
                          material->tune_highest_rad_per_s, material->tune_mutes, material->groove.decay_rate_per_s);
    }
    return HD_OK;
}
