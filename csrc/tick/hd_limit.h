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

/* Returns the square of |contact| plus vibration of the sign that makes the sum larger, N^2. */
HD_RT static inline double hd_limit_widest_square(const double contact_n[2], const double vibration_n[2]) {
    const double sign = hd_dot(contact_n, vibration_n) < 0.0 ? -1.0 : 1.0;
    const double x = contact_n[0] + sign * vibration_n[0];
    const double y = contact_n[1] + sign * vibration_n[1];
    return x * x + y * y;
}

/* Whether a contact force leaves no room for vibration; also for NaN. */
HD_RT static inline int hd_limit_is_beyond(const double contact_n[2], double limit_n) {
    return !(hd_dot(contact_n, contact_n) <= HD_JUST_BELOW * limit_n * limit_n);
}

/* Computes contact plus vibration within `limit_n`. Returns the factor of the vibration for which there is room with
 * either sign; if the contact force alone exceeds the limit the factor is `keep`, and the force is the contact force,
 * cut to the limit. */
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
 * of it that is felt. Vibration leaves room for `whole_n` with either sign. */
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
    if (hd_limit_widest_square(contact_n, vibration_n) <= HD_JUST_BELOW * limit * limit) {
        force_n[0] = contact_n[0] + vibration_n[0];
        force_n[1] = contact_n[1] + vibration_n[1];
        state->saturated = state->yields;
        state->ringing_gain = 1.0;
    } else { /* also for NaN, which hd_tick finds afterwards */
        hd_limit_exceeded(state, table, contact_n, vibration_n, time_ns, force_n, flags);
    }
}

#endif
