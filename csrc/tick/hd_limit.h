/* The force limit: what the actuator may be asked for, and what gives way first. */
#ifndef HD_LIMIT_H
#define HD_LIMIT_H

#include "base/hd_rt.h"
#include "base/hd_vector.h"
#include "tick/hd_state.h"

/* Below one by a few rounding errors, so that a command at the limit never rounds above it. */
#define HD_JUST_BELOW 0.9999999999999990

/* Noise is scaled to so many of its RMS: a Gaussian's sample in 16,000 is larger, and scales it further. */
#define HD_NOISE_CREST 4.0
/* What the limit does is no command, and comes and goes in this time whatever the scene's ramp. */
#define HD_LIMIT_RAMP_S 0.02

/* A noise in a tick. */
struct hd_noisy {
    double noise_n[2];
    double rms_n;
};

/* Noise gives way first. The gain at which it is heard beside `contact_n` and what rings: it leaves room for the whole
 * of both, whichever way the noise's sample points, so that the mean force stays the contact's. It falls with what the
 * limit leaves and rises over HD_LIMIT_RAMP_S. `shown`: of vibration. `*most_n`, out: what would be wanted. */
HD_RT double hd_limit_noise(const struct hd_state *state, const struct hd_table *table, const double contact_n[2],
                            const struct hd_noisy *noisy, double shown, double *most_n);

/* Sets the flag, and reports the first tick of a stretch. */
HD_RT void hd_limit_report(struct hd_state *state, double wanted_n, int64_t time_ns, uint32_t *flags);

/* What the limit leaves of a force, 0 to 1. */
HD_RT static inline double hd_limit_cut(const double force_n[2], double limit_n) {
    const double square = hd_dot(force_n, force_n);
    return square > limit_n * limit_n ? limit_n / hd_root(square) : 1.0;
}

/* Contact and vibration within `limit_n`: the force, and the part of the vibration that there is room for; beside a
 * contact force beyond the limit it is `keep`, and the sum is cut along its own direction. */
HD_RT double hd_limit_within(double limit_n, double keep, const double contact_n[2], const double vibration_n[2],
                             double force_n[2]);

/* What modes keep of their amplitude in this tick beside a contact force beyond the limit. */
HD_RT static inline double hd_limit_keep(const struct hd_state *state, const struct hd_table *table) {
    const double remaining = state->ringing_gain - table->period_s / HD_LIMIT_RAMP_S;
    return remaining > 0.0 ? remaining / state->ringing_gain : 0.0;
}

/* A command beyond the limit, brought back to it. Sets the flag and reports the first tick of a stretch. */
HD_RT void hd_limit_exceeded(struct hd_state *state, const struct hd_table *table, const double contact_n[2],
                             const double vibration_n[2], int64_t time_ns, double force_n[2], uint32_t *flags);

/* What the command may be: the table's max_force_n without what the device may add by itself. */
HD_RT static inline double hd_limit_of(const struct hd_state *state, const struct hd_table *table) {
    const double limit = table->max_force_n - state->reserved_n;
    return limit > 0.0 ? limit : 0.0;
}

/* The command of a tick in which a ramp is under way: contact_n is what of `whole_n` is felt so far. Vibration gives
 * way to the whole of it. */
HD_RT void hd_limit_ramped(struct hd_state *state, const struct hd_table *table, const double contact_n[2],
                           const double whole_n[2], const double vibration_n[2], int64_t time_ns, double force_n[2],
                           uint32_t *flags);
/* The same without consequences. */
HD_RT double hd_limit_within_whole(double limit_n, double keep, const double contact_n[2], const double whole_n[2],
                                   const double vibration_n[2], double force_n[2]);

/* The command of this tick: contact and vibration within the limit. */
HD_RT static inline void hd_limit_apply(struct hd_state *state, const struct hd_table *table, const double contact_n[2],
                                        const double vibration_n[2], int64_t time_ns, double force_n[2],
                                        uint32_t *flags) {
    const double limit = hd_limit_of(state, table);
    force_n[0] = contact_n[0] + vibration_n[0];
    force_n[1] = contact_n[1] + vibration_n[1];
    if (force_n[0] * force_n[0] + force_n[1] * force_n[1] <= HD_JUST_BELOW * limit * limit) {
        state->saturated = state->yields;
        state->ringing_gain = 1.0;
    } else { /* or not a number, which the tick finds after this */
        hd_limit_exceeded(state, table, contact_n, vibration_n, time_ns, force_n, flags);
    }
}

#endif
