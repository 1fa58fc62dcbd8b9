/* Modes of strikes whose frequency follows speed and force, interpolated from the numbers of the table. */
#include "tick/hd_strike_mode.h"

#include <math.h>

#include "base/hd_vector.h"

/* The two of several rising points between which a value lies, and its position between them, 0 to 1. */
struct interval {
    uint32_t from;
    uint32_t to;
    double share;
};

HD_RT static struct interval find_interval(const double *points, uint32_t count, uint32_t stride, double value) {
    uint32_t to = 0;
    while (to < count && points[to * stride] <= value) {
        to++;
    }
    if (to == 0 || to == count) {
        const uint32_t end = to == 0 ? 0 : count - 1u;
        return (struct interval){end, end, 0.0};
    }
    const double from = points[(to - 1u) * stride];
    return (struct interval){to - 1u, to, (value - from) / (points[to * stride] - from)};
}

HD_RT static double interpolate(double from, double to, double share) {
    return from + share * (to - from);
}

HD_RT static double groove_frequency(const struct hd_table *table, const struct hd_material *material,
                                     double speed_m_per_s, double force_n) {
    const uint32_t forces = material->tune_forces;
    const double *numbers = table->numbers + material->tune_first;
    const struct interval speed = find_interval(numbers, material->tune_speeds, 1, speed_m_per_s);
    const struct interval force = find_interval(numbers + material->tune_speeds, forces, 1, force_n);
    const double *grid = numbers + material->tune_speeds + forces;
    const double *slow = grid + (size_t)speed.from * forces;
    const double *fast = grid + (size_t)speed.to * forces;
    return interpolate(interpolate(slow[force.from], slow[force.to], force.share),
                       interpolate(fast[force.from], fast[force.to], force.share), speed.share);
}

/* Returns the first maximum of exp(-B t) sin(w t) and its time, t = atan(w/B)/w. */
HD_RT static double first_peak(double decay_rate_per_s, double angular_frequency, double *time_s) {
    HD_RT_FOREIGN_BEGIN
    *time_s = atan2(angular_frequency, decay_rate_per_s) / angular_frequency;
    return exp(-decay_rate_per_s * *time_s) * angular_frequency /
           sqrt(angular_frequency * angular_frequency + decay_rate_per_s * decay_rate_per_s);
    HD_RT_FOREIGN_END
}

/* Sets the frequency of a strike. A frequency that is too high is lowered with the same first peak, whose time is then
 * written to `peak_s`; returns 0 if the material mutes such strikes instead. */
HD_RT static int set_frequency(const struct hd_material *material, double decay_rate_per_s, double wanted_rad_per_s,
                               struct hd_strike *strike, double *peak_s) {
    const double highest = material->tune_highest_rad_per_s;
    strike->tuned = material;
    strike->tuned_rad_per_s = wanted_rad_per_s;
    if (wanted_rad_per_s > highest) {
        if (material->tune_mutes) {
            return 0;
        }
        const double peak = first_peak(decay_rate_per_s, wanted_rad_per_s, peak_s);
        strike->units *= peak / first_peak(decay_rate_per_s, highest, peak_s);
        strike->tuned_rad_per_s = highest;
    }
    return 1;
}

HD_RT int hd_strike_mode_groove(const struct hd_table *table, const struct hd_material *material, double speed_m_per_s,
                                double force_n, struct hd_strike *strike) {
    const double wanted = groove_frequency(table, material, hd_magnitude(speed_m_per_s), force_n);
    double peak_s;
    return set_frequency(material, material->groove.decay_rate_per_s, wanted, strike, &peak_s);
}

HD_RT int hd_strike_mode_tap(const struct hd_table *table, const struct hd_material *material, double speed_m_per_s,
                             struct hd_strike *strike, double *units, double *peak_s) {
    const uint32_t count = material->mode_count;
    const double *speeds = table->numbers + material->mode_first;
    const double *frequencies = speeds + count;
    const double *times = frequencies + count;
    const struct interval place = find_interval(speeds, count, 1, speed_m_per_s);
    const double wanted = interpolate(frequencies[place.from], frequencies[place.to], place.share);
    const double decay = 1.0 / interpolate(times[place.from], times[place.to], place.share);
    const double peak = first_peak(decay, wanted, peak_s);
    if (material->mode_by_peak != 0) {
        *units /= peak;
    }
    strike->units = *units;
    strike->tuned_decay_rate_per_s = decay;
    strike->tuned_m_per_s = speed_m_per_s;
    return set_frequency(material, decay, wanted, strike, peak_s);
}

HD_RT static void set_compensation(const double *nodes, uint32_t count, double at, struct hd_mode *mode) {
    const struct interval place = find_interval(nodes, count, HD_TUNE_NODE, at);
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
        *numbers[i] = interpolate(from[i], to[i], place.share);
    }
}

HD_RT void hd_strike_mode_make(const struct hd_table *table, const struct hd_strike *strike, struct hd_mode *mode) {
    const struct hd_material *material = strike->tuned;
    const int taps = strike->use == HD_MODE_TAP;
    *mode = taps ? material->tap : material->groove;
    if (taps) {
        mode->decay_rate_per_s = strike->tuned_decay_rate_per_s;
        mode->end_s = 5.0 / strike->tuned_decay_rate_per_s;
    }
    mode->angular_frequency_rad_per_s = strike->tuned_rad_per_s;
    mode->peak = first_peak(mode->decay_rate_per_s, strike->tuned_rad_per_s, &mode->peak_time_s);
    HD_RT_FOREIGN_BEGIN
    const double magnitude = exp(-mode->decay_rate_per_s * table->period_s);
    mode->rotor_re = magnitude * cos(strike->tuned_rad_per_s * table->period_s);
    mode->rotor_im = magnitude * sin(strike->tuned_rad_per_s * table->period_s);
    HD_RT_FOREIGN_END
    if (taps && material->mode_nodes > 0) {
        set_compensation(table->numbers + material->mode_first + 3 * (size_t)material->mode_count, material->mode_nodes,
                         strike->tuned_m_per_s, mode);
    } else if (!taps && material->tune_nodes > 0) {
        const size_t nodes = material->tune_speeds + material->tune_forces +
                             (size_t)material->tune_speeds * material->tune_forces + material->tune_first;
        set_compensation(table->numbers + nodes, material->tune_nodes, strike->tuned_rad_per_s, mode);
    }
}
