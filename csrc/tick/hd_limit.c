/* The force limit. Noise is reduced first, then ringing modes, contact forces last; no waveform is clipped.
 *
 * Noise has a separate gain (hd_limit_noise), equal for samples of either sign. A strike is scaled as one before it
 * sounds (hd_strikes_apply). An effect of the device cannot be scaled once it plays: the limit is reduced by its force
 * meanwhile. The command can still exceed the limit if a contact force grows while modes ring: then all ringing modes
 * continue with the largest factor g for which both signs of the vibration fit, |contact + g vibration| <= max and
 * |contact - g vibration| <= max. So vibration against the contact force ends as that force reaches the limit, and does
 * not take its place. While the contact force alone exceeds the limit, it is cut in its direction and vibration is not
 * displayed; ringing modes fade out over HD_LIMIT_RAMP_S. */
#include "tick/hd_limit.h"

#include <math.h>

#include "base/hd_vector.h"
#include "tick/hd_mode.h"

HD_RT double hd_limit_noise(const struct hd_state *state, const struct hd_table *table, const double contact_n[2],
                            const struct hd_noisy *noisy, double shown, double *most_n) {
    const double size = hd_root(hd_dot(noisy->noise_n, noisy->noise_n));
    const double crest = HD_NOISE_CREST * noisy->rms_n;
    const double most = shown * (size > crest ? size : crest);
    const double other = hd_root(hd_dot(contact_n, contact_n)) + shown * hd_modes_bound(state);
    const double room = HD_JUST_BELOW * hd_limit_of(state, table) - other;
    const double risen = state->noise_gain + table->period_s / HD_LIMIT_RAMP_S;
    const double free = risen < 1.0 ? risen : 1.0;
    *most_n = other + most;
    if (free * most <= room) {
        return free;
    }
    return room > 0.0 ? room / most : 0.0;
}

HD_RT double hd_limit_within(double limit_n, double keep, const double contact_n[2], const double vibration_n[2],
                             double force_n[2]) {
    if (hd_limit_widest_square(contact_n, vibration_n) <= HD_JUST_BELOW * limit_n * limit_n) {
        force_n[0] = contact_n[0] + vibration_n[0];
        force_n[1] = contact_n[1] + vibration_n[1];
        return 1.0;
    }
    if (!hd_limit_is_beyond(contact_n, limit_n)) {
        /* The larger root of |contact + g vibration|^2 = limit^2, for the sign of the vibration with the larger sum. */
        const double a = hd_dot(vibration_n, vibration_n);
        const double b = hd_magnitude(hd_dot(contact_n, vibration_n));
        const double c = hd_dot(contact_n, contact_n) - limit_n * limit_n;
        const double root = hd_root(b * b - a * c);
        const double factor = b > 0.0 ? -c / (b + root) : (root - b) / a;
        force_n[0] = HD_JUST_BELOW * (contact_n[0] + factor * vibration_n[0]);
        force_n[1] = HD_JUST_BELOW * (contact_n[1] + factor * vibration_n[1]);
        return factor;
    }
    const double size = hd_root(hd_dot(contact_n, contact_n));
    const double cut = size > limit_n ? limit_n / size : 1.0;
    force_n[0] = HD_JUST_BELOW * (cut * contact_n[0]);
    force_n[1] = HD_JUST_BELOW * (cut * contact_n[1]);
    return keep;
}

HD_RT double hd_limit_within_whole(double limit_n, double keep, const double contact_n[2], const double whole_n[2],
                                   const double vibration_n[2], double force_n[2]) {
    const double factor = hd_limit_within(limit_n, keep, whole_n, vibration_n, force_n);
    /* If contact_n is whole_n cut to the limit, the result is final, to the last bit. */
    const double cut = hd_limit_cut(whole_n, limit_n);
    if (contact_n[0] == cut * whole_n[0] && contact_n[1] == cut * whole_n[1]) {
        return factor;
    }
    const double shown = hd_limit_is_beyond(whole_n, limit_n) ? 0.0 : factor;
    const double vibration[2] = {shown * vibration_n[0], shown * vibration_n[1]};
    return factor * hd_limit_within(limit_n, 1.0, contact_n, vibration, force_n);
}

/* Scales the ringing modes by `factor`. */
HD_RT static void scale_ringing(struct hd_state *state, double limit_n, const double contact_n[2], double factor) {
    state->ringing_gain = hd_limit_is_beyond(contact_n, limit_n) ? state->ringing_gain * factor : 1.0;
    if (factor < 1.0) {
        hd_modes_scale(state, factor);
    }
}

HD_RT void hd_limit_report(struct hd_state *state, double wanted_n, int64_t time_ns, uint32_t *flags) {
    *flags |= HD_FLAG_SATURATED;
    if (!state->saturated) {
        state->saturated = 1;
        state->saturations_total++;
        hd_event_add(state, HD_EVENT_SATURATION, time_ns, 0, wanted_n);
    }
}

HD_RT void hd_limit_exceeded(struct hd_state *state, const struct hd_table *table, const double contact_n[2],
                             const double vibration_n[2], int64_t time_ns, double force_n[2], uint32_t *flags) {
    const double limit = hd_limit_of(state, table);
    hd_limit_report(state, hd_root(hd_limit_widest_square(contact_n, vibration_n)), time_ns, flags);
    scale_ringing(state, limit, contact_n,
                  hd_limit_within(limit, hd_limit_keep(state, table), contact_n, vibration_n, force_n));
}

HD_RT void hd_limit_ramped(struct hd_state *state, const struct hd_table *table, const double contact_n[2],
                           const double whole_n[2], const double vibration_n[2], int64_t time_ns, double force_n[2],
                           uint32_t *flags) {
    const double limit = hd_limit_of(state, table);
    const double widest = hd_limit_widest_square(whole_n, vibration_n);
    const double keep = hd_limit_keep(state, table);
    const double factor = hd_limit_within_whole(limit, keep, contact_n, whole_n, vibration_n, force_n);
    if (factor < 1.0 || !(widest <= HD_JUST_BELOW * limit * limit)) {
        hd_limit_report(state, hd_root(widest), time_ns, flags);
    } else {
        state->saturated = state->yields;
    }
    scale_ringing(state, limit, whole_n, factor);
}
