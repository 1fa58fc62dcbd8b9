/* Coloured noise from a normalised lattice.
 *
 * The all-pole filter with A(z) = 1 + sum a_i z^-i, that is x[n] = e[n] - sum a_i x[n - i], has the reflection
 * coefficients k_m = a_m of order m (step-down recursion: a_i of order m - 1 is (a_i - k_m a_(m-i)) / (1 - k_m^2)); a
 * first-order low-pass has k_1 < 0. With s = k_m and c = sqrt(1 - k_m^2), from the top stage down,
 *
 *     f_(m-1)[n] = c f_m[n] - s b_(m-1)[n-1]
 *     b_m[n]     = s f_m[n] + c b_(m-1)[n-1],      f_order = e, b_0 = f_0.
 *
 * The output is f_0 = prod c_m / A(z) e without taps, and sum v_m b_m with taps. A stage rotates (f_m, b_(m-1)) to
 * (f_(m-1), b_m), so each sample rotates the vector of white sample and delays. Delays that are uncorrelated and of
 * unit power therefore stay so for any k and any change of k, and f_0 and every unit combination of the b_m have unit
 * power. This is also the stationary state for every set of k: a start draws all HD_NOISE_ORDER delays from the
 * distribution of white samples. Stages beyond the order do not run. A stage with k = 0 only delays b, so stages that
 * join in a ramp start at k = 0 with the delays that they hold, which are still uncorrelated.
 *
 * White samples are Gaussian, so the output is Gaussian for every filter and rate; the magnitude of each is at most 6.
 *
 * Interpolated coefficients stay within [-1, 1]: see `lerp`. A k of exactly 1 is still a rotation. */
#include "tick/hd_noise.h"

#include <math.h>

#include "base/hd_gaussian.h"
#include "scene/hd_world.h"

/* Smallest sum of squares by which taps are normalised. Taps that change sign in a ramp pass near zero; below this the
 * noise becomes quieter instead of changing sign within a tick. */
#define HD_TAP_SQUARES_MIN 0.01

/* splitmix64 (Steele, Lea and Flood), a generator without bad seeds. */
HD_RT static inline uint64_t mix_bits(uint64_t z) {
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
}

HD_RT static inline double white_sample(uint64_t *random) {
    *random += 0x9e3779b97f4a7c15u;
    return hd_gaussian(mix_bits(*random));
}

/* Interpolates linearly. For two numbers within [-1, 1] the result is within [-1, 1] in spite of rounding: the error of
 * the difference is at most 2^-53, and 1 + 2^-53 rounds to 1. Equal numbers are returned exactly. */
HD_RT static inline double lerp(double from, double to, double part) {
    return from + part * (to - from);
}

HD_RT void hd_noise_turn(struct hd_active_noise *active) {
    for (uint32_t m = 0; m < HD_NOISE_ORDER; m++) {
        active->sine_from[m] = m < active->order ? active->sine[m] : 0.0;
    }
    for (uint32_t m = 0; m <= HD_NOISE_ORDER; m++) {
        active->tap_from[m] = active->taps && m <= active->order ? active->tap[m] : 0.0;
    }
    if (!active->taps) {
        active->tap_from[0] = 1.0;
    }
    active->order_from = active->order;
    active->taps_from = active->taps;
    active->level_from = active->level;
    active->blend = 0.0;
}

/* Returns the position of x in its cell of a rising axis, 0 to 1. `*cell`: a guess in, the cell out. A value beyond the
 * ends counts as the end, NaN as the lower end. */
HD_RT static double find_cell(const double *axis, uint32_t count, double x, uint32_t *cell) {
    if (count == 1 || !(x > axis[0])) {
        *cell = 0;
        return 0.0;
    }
    if (x >= axis[count - 1]) {
        *cell = count - 2;
        return 1.0;
    }
    uint32_t low = *cell;
    if (low >= count - 1 || x < axis[low] || x >= axis[low + 1]) {
        uint32_t high = count - 1;
        low = 0;
        while (high - low > 1) {
            const uint32_t middle = low + (high - low) / 2;
            if (x < axis[middle]) {
                high = middle;
            } else {
                low = middle;
            }
        }
        *cell = low;
    }
    return (x - axis[low]) / (axis[low + 1] - axis[low]);
}

/* A place between four nodes of the grid. Along an axis of one node both nodes are the same. */
struct grid_place {
    const double *node;
    size_t along_speed; /* distance in numbers to the next node along the axis */
    size_t along_force;
    uint32_t cell[2];
    double part[2];
};

/* Interpolates `count` numbers of the grid; `number` points to the first one in the first node. */
HD_RT static inline void interpolate(const struct grid_place *place, const double *number, uint32_t count,
                                     double *restrict out) {
    const double *slow_light = number;
    const double *slow_firm = slow_light + place->along_force;
    const double *fast_light = number + place->along_speed;
    const double *fast_firm = fast_light + place->along_force;
    const double part[2] = {place->part[0], place->part[1]};
    for (uint32_t i = 0; i < count; i++) {
        const double slow = lerp(slow_light[i], slow_firm[i], part[1]);
        const double fast = lerp(fast_light[i], fast_firm[i], part[1]);
        out[i] = lerp(slow, fast, part[0]);
    }
}

/* Finds the place of speed and force in the grid. `cell`: a guess of the cell. */
HD_RT static inline struct grid_place find_place(const struct hd_noise *noise, const double *numbers, double speed,
                                                 double force, const uint32_t cell[2]) {
    const double *speeds = numbers + noise->first;
    const double *forces = speeds + noise->speed_count;
    const size_t size = hd_noise_node_size(noise);
    const size_t row = size * noise->force_count;
    struct grid_place place = {.cell = {cell[0], cell[1]}};
    place.part[0] = find_cell(speeds, noise->speed_count, speed, &place.cell[0]);
    place.part[1] = find_cell(forces, noise->force_count, force, &place.cell[1]);
    place.node = forces + noise->force_count + row * place.cell[0] + size * place.cell[1];
    place.along_speed = noise->speed_count > 1 ? row : 0;
    place.along_force = noise->force_count > 1 ? size : 0;
    return place;
}

/* Computes the coefficients for a place in the grid and the present blend of the ramp. */
HD_RT static void update_coefficients(struct hd_active_noise *active, const struct hd_noise *noise,
                                      const struct grid_place *place) {
    const int ramping = active->blend < 1.0;
    const double blend = active->blend;
    const double *number = place->node + 1;
    for (int axis = 0; axis < 2; axis++) {
        active->cell[axis] = place->cell[axis];
        active->part[axis] = place->part[axis];
    }
    uint32_t order = noise->order;
    interpolate(place, number, order, active->sine);
    active->taps = noise->taps;
    if (noise->taps) {
        interpolate(place, number + order, order + 1, active->tap);
    }
    if (ramping) {
        for (; order < active->order_from; order++) {
            active->sine[order] = 0.0;
        }
        for (uint32_t m = 0; m < order; m++) {
            active->sine[m] = lerp(active->sine_from[m], active->sine[m], blend);
        }
        if (noise->taps || active->taps_from) {
            for (uint32_t m = 0; m <= order; m++) {
                const double to = noise->taps ? (m <= noise->order ? active->tap[m] : 0.0) : (m == 0 ? 1.0 : 0.0);
                active->tap[m] = lerp(active->tap_from[m], to, blend);
            }
            active->taps = 1;
        }
    }
    active->order = order;
    HD_RT_FOREIGN_BEGIN
    for (uint32_t m = 0; m < order; m++) {
        /* Computing 1 - k^2 would cancel near |k| = 1; the product does not. */
        active->cosine[m] = sqrt((1.0 - active->sine[m]) * (1.0 + active->sine[m]));
    }
    if (active->taps) {
        double squares = 0.0;
        for (uint32_t m = 0; m <= order; m++) {
            squares += active->tap[m] * active->tap[m];
        }
        const double scale = 1.0 / sqrt(squares > HD_TAP_SQUARES_MIN ? squares : HD_TAP_SQUARES_MIN);
        for (uint32_t m = 0; m <= order; m++) {
            active->tap[m] *= scale;
        }
    }
    HD_RT_FOREIGN_END
}

HD_RT void hd_noise_start(struct hd_active_noise *active, const struct hd_noise *noise, const double *numbers,
                          uint32_t salt) {
    const uint32_t corner[2] = {0, 0};
    const struct grid_place place = find_place(noise, numbers, 0.0, 0.0, corner);
    active->random = mix_bits(mix_bits(noise->seed) + salt);
    for (uint32_t m = 0; m <= HD_NOISE_ORDER; m++) {
        active->delay[m] = white_sample(&active->random);
    }
    active->level = 0.0;
    active->rms = 0.0;
    active->scale_n = (struct hd_eased){.now = 0.0};
    active->normal_n = (struct hd_eased){.now = 0.0};
    active->direction[0] = 0.0;
    active->direction[1] = 0.0;
    active->blend = 1.0;
    update_coefficients(active, noise, &place);
}

HD_RT static inline double all_pole_sample(struct hd_active_noise *active) {
    double f = white_sample(&active->random);
    for (uint32_t m = active->order; m > 0; m--) {
        const double s = active->sine[m - 1];
        const double c = active->cosine[m - 1];
        const double b = active->delay[m - 1];
        active->delay[m] = s * f + c * b;
        f = c * f - s * b;
    }
    active->delay[0] = f;
    return f;
}

HD_RT static inline double tapped_sample(struct hd_active_noise *active) {
    double f = white_sample(&active->random);
    double sum = 0.0;
    for (uint32_t m = active->order; m > 0; m--) {
        const double s = active->sine[m - 1];
        const double c = active->cosine[m - 1];
        const double b = active->delay[m - 1];
        const double up = s * f + c * b;
        active->delay[m] = up;
        sum += active->tap[m] * up;
        f = c * f - s * b;
    }
    active->delay[0] = f;
    return sum + active->tap[0] * f;
}

HD_RT static inline double next_sample(struct hd_active_noise *active) {
    return active->taps ? tapped_sample(active) : all_pole_sample(active);
}

/* Returns the RMS `level` faded below the threshold speed. At a speed of 0 it is 0, even with a threshold of 0. */
HD_RT static inline double faded_rms(const struct hd_noise *noise, double speed, double level) {
    if (speed < noise->threshold_m_per_s) {
        return level * (speed / noise->threshold_m_per_s);
    }
    return speed > 0.0 ? level : 0.0;
}

/* Returns the next sample of a noise with a grid, or during a ramp. */
HD_RT static double next_of_grid(struct hd_active_noise *active, const struct hd_noise *noise, const double *numbers,
                                 double speed, double force, double gains, double ramp_step) {
    const struct grid_place place = find_place(noise, numbers, speed, force, active->cell);
    const int ramping = active->blend < 1.0;
    double blend = 1.0;
    double level;
    interpolate(&place, place.node, 1, &level);
    level += gains;
    level = level > 0.0 ? level : 0.0;
    if (ramping) {
        blend = active->blend + ramp_step < 1.0 ? active->blend + ramp_step : 1.0;
        level = lerp(active->level_from, level, blend);
    }
    active->level = level;
    const double rms = faded_rms(noise, speed, level);
    active->rms = rms;
    if (!(rms > 0.0)) {
        return 0.0;
    }
    if (ramping || place.cell[0] != active->cell[0] || place.cell[1] != active->cell[1] ||
        place.part[0] != active->part[0] || place.part[1] != active->part[1]) {
        active->blend = blend;
        update_coefficients(active, noise, &place);
    }
    return rms * next_sample(active);
}

HD_RT double hd_noise_next(struct hd_active_noise *active, const struct hd_noise *noise, const double *numbers,
                           double speed_m_per_s, double force_n, double ramp_step) {
    const double speed = speed_m_per_s < 0.0 ? -speed_m_per_s : speed_m_per_s;
    const double gains = noise->velocity_gain_per_s * speed + noise->force_gain_m_per_s2_per_n * force_n;
    if (noise->speed_count > 1 || noise->force_count > 1 || active->blend < 1.0) {
        return next_of_grid(active, noise, numbers, speed, force_n, gains, ramp_step);
    }
    const double level = gains + numbers[noise->first + 2];
    active->level = level > 0.0 ? level : 0.0;
    const double rms = faded_rms(noise, speed, active->level);
    active->rms = rms;
    return rms > 0.0 ? rms * next_sample(active) : 0.0;
}

HD_RT double hd_noise_last(struct hd_active_noise *active) {
    return active->rms > 0.0 ? active->scale_n.now * (active->rms * next_sample(active)) : 0.0;
}

int hd_noise_run(const struct hd_noise *noise, const double *numbers, uint32_t number_count, size_t count,
                 const double *speed, const double *force, double *out) {
    const int status = hd_noise_check(noise, numbers, number_count, "noise");
    if (status != HD_OK) {
        return status;
    }
    for (size_t i = 0; i < count; i++) {
        if (!isfinite(speed[i]) || !isfinite(force[i])) {
            return hd_invalid("noise: speed %g m/s and force %g N of entry %zu must be finite", speed[i], force[i], i);
        }
    }
    struct hd_active_noise active;
    hd_noise_start(&active, noise, numbers, 0);
    for (size_t i = 0; i < count; i++) {
        out[i] = hd_noise_next(&active, noise, numbers, speed[i], force[i], 1.0);
    }
    return HD_OK;
}
