/* The force limit: keeps the command within it, and defines which part of the force is reduced first. */
#ifndef HD_LIMIT_H
#define HD_LIMIT_H

#include "base/hd_rt.h"
#include "base/hd_vector.h"
#include "tick/hd_state.h"

/* 1 minus a few rounding errors, so that a command at the limit never rounds above it. */
#define HD_JUST_BELOW 0.9999999999999990

/* Room for noise, as a multiple of its RMS. One Gaussian sample in 16,000 is larger and scales the noise further
 * down. */
#define HD_NOISE_CREST 4.0
/* Time in which gains of the limit rise or fall. It does not follow the scene's ramp_s, which is for commands. */
#define HD_LIMIT_RAMP_S 0.02

/* The sum of the noises in a tick. */
struct hd_noisy {
    double noise_n[2];
    double rms_n;
};

/* Returns the gain of noise, which is reduced first. It leaves room for `contact_n` and the ringing modes in full, for
 * any direction of the noise's sample, so that noise does not change the mean force. It falls at once and rises over
 * HD_LIMIT_RAMP_S. `shown`: gain of vibration. `*most_n`, out: the force that would be wanted with gain 1. */
HD_RT double hd_limit_noise(const struct hd_state *state, const struct hd_table *table, const double contact_n[2],
                            const struct hd_noisy *noisy, double shown, double *most_n);

/* Sets the saturation flag; adds an event if the previous tick was not saturated. */
HD_RT void hd_limit_report(struct hd_state *state, double wanted_n, int64_t time_ns, uint32_t *flags);

/* Returns the factor, 0 to 1, that brings a force within the limit. */
HD_RT static inline double hd_limit_cut(const double force_n[2], double limit_n) {
    const double square = hd_dot(force_n, force_n);
    return square > limit_n * limit_n ? limit_n / hd_root(square) : 1.0;
}

/* Computes contact plus vibration within `limit_n`. Returns the factor of the vibration for which there is room; if the
 * contact force alone exceeds the limit the factor is `keep`, and the sum is cut to the limit in its direction. */
HD_RT double hd_limit_within(double limit_n, double keep, const double contact_n[2], const double vibration_n[2],
                             double force_n[2]);

/* Returns the factor of the ringing modes for a tick in which the contact force alone exceeds the limit. */
HD_RT static inline double hd_limit_keep(const struct hd_state *state, const struct hd_table *table) {
    const double remaining = state->ringing_gain - table->period_s / HD_LIMIT_RAMP_S;
    return remaining > 0.0 ? remaining / state->ringing_gain : 0.0;
}

/* Brings a command that exceeds the limit back to it, and reports that (hd_limit_report). */
HD_RT void hd_limit_exceeded(struct hd_state *state, const struct hd_table *table, const double contact_n[2],
                             const double vibration_n[2], int64_t time_ns, double force_n[2], uint32_t *flags);

/* Returns the limit of the command: the table's max_force_n minus the force reserved for effects of the device. */
HD_RT static inline double hd_limit_of(const struct hd_state *state, const struct hd_table *table) {
    const double limit = table->max_force_n - state->reserved_n;
    return limit > 0.0 ? limit : 0.0;
}

/* Computes the command of a tick with an active ramp. `whole_n`: contact force before the limit; `contact_n`: the part
 * of it that is felt. Vibration leaves room for `whole_n`. */
HD_RT void hd_limit_ramped(struct hd_state *state, const struct hd_table *table, const double contact_n[2],
                           const double whole_n[2], const double vibration_n[2], int64_t time_ns, double force_n[2],
                           uint32_t *flags);
/* Computes the force of hd_limit_ramped without reporting and without scaling modes. Returns the factor of vibration.
 */
HD_RT double hd_limit_within_whole(double limit_n, double keep, const double contact_n[2], const double whole_n[2],
                                   const double vibration_n[2], double force_n[2]);

/* Computes the command of this tick: contact and vibration within the limit. */
HD_RT static inline void hd_limit_apply(struct hd_state *state, const struct hd_table *table, const double contact_n[2],
                                        const double vibration_n[2], int64_t time_ns, double force_n[2],
                                        uint32_t *flags) {
    const double limit = hd_limit_of(state, table);
    force_n[0] = contact_n[0] + vibration_n[0];
    force_n[1] = contact_n[1] + vibration_n[1];
    if (force_n[0] * force_n[0] + force_n[1] * force_n[1] <= HD_JUST_BELOW * limit * limit) {
        state->saturated = state->yields;
        state->ringing_gain = 1.0;
    } else { /* also for NaN, which hd_tick finds afterwards */
        hd_limit_exceeded(state, table, contact_n, vibration_n, time_ns, force_n, flags);
    }
}

#endif
