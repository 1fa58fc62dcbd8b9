/* The force limit. Vibration gives way first, the wall last, and neither is clipped into another waveform.
 *
 * A strike is scaled as a whole before it sounds (hd_strikes_apply). What the device plays by itself cannot be scaled
 * any more: the limit is lower by it while it plays. What can still go wrong is a contact force that
 * grows into a mode that rings already: then everything that rings goes on at the factor g for which the command just
 * reaches the limit, |contact + g vibration| = max. Only a contact force beyond the limit is itself cut, along its own
 * direction; nothing rings then. */
#include "hd_limit.h"

#include <math.h>

#include "hd_voice.h"

HD_RT double hd_limit_within(double limit_n, const double contact_n[2], const double vibration_n[2],
                             double force_n[2]) {
    force_n[0] = contact_n[0] + vibration_n[0];
    force_n[1] = contact_n[1] + vibration_n[1];
    if (force_n[0] * force_n[0] + force_n[1] * force_n[1] <= HD_JUST_BELOW * limit_n * limit_n) {
        return 1.0;
    }
    const double contact = contact_n[0] * contact_n[0] + contact_n[1] * contact_n[1];
    double factor = 0.0;
    double cut = 1.0;
    if (contact <= HD_JUST_BELOW * limit_n * limit_n) {
        /* The larger root of |contact + g vibration|^2 = limit^2. */
        const double a = vibration_n[0] * vibration_n[0] + vibration_n[1] * vibration_n[1];
        const double b = contact_n[0] * vibration_n[0] + contact_n[1] * vibration_n[1];
        const double c = contact - limit_n * limit_n;
        HD_RT_FOREIGN_BEGIN
        const double root = sqrt(b * b - a * c);
        HD_RT_FOREIGN_END
        factor = b > 0.0 ? -c / (b + root) : (root - b) / a;
    } else {
        HD_RT_FOREIGN_BEGIN
        cut = limit_n / sqrt(contact);
        HD_RT_FOREIGN_END
    }
    force_n[0] = HD_JUST_BELOW * (cut * contact_n[0] + factor * vibration_n[0]);
    force_n[1] = HD_JUST_BELOW * (cut * contact_n[1] + factor * vibration_n[1]);
    return factor;
}

HD_RT double hd_limit_within_whole(double limit_n, const double contact_n[2], const double whole_n[2],
                                   const double vibration_n[2], double force_n[2]) {
    const double factor = hd_limit_within(limit_n, whole_n, vibration_n, force_n);
    const double vibration[2] = {factor * vibration_n[0], factor * vibration_n[1]};
    return factor * hd_limit_within(limit_n, contact_n, vibration, force_n);
}

HD_RT static void report(struct hd_state *state, const double wanted_n[2], int64_t time_ns, uint32_t *flags) {
    *flags |= HD_FLAG_SATURATED;
    if (!state->saturated) {
        state->saturated = 1;
        state->saturations_total++;
        const uint32_t event = hd_state_event(state, HD_EVENT_SATURATION, time_ns);
        if (event < HD_EVENT_CAPACITY) {
            HD_RT_FOREIGN_BEGIN
            state->events[event].value = sqrt(wanted_n[0] * wanted_n[0] + wanted_n[1] * wanted_n[1]);
            HD_RT_FOREIGN_END
        }
    }
}

HD_RT void hd_limit_exceeded(struct hd_state *state, const struct hd_table *table, const double contact_n[2],
                             const double vibration_n[2], int64_t time_ns, double force_n[2], uint32_t *flags) {
    report(state, force_n, time_ns, flags);
    hd_voices_scale(state, hd_limit_within(hd_limit_of(state, table), contact_n, vibration_n, force_n));
}

HD_RT void hd_limit_ramped(struct hd_state *state, const struct hd_table *table, const double contact_n[2],
                           const double whole_n[2], const double vibration_n[2], int64_t time_ns, double force_n[2],
                           uint32_t *flags) {
    const double limit = hd_limit_of(state, table);
    const double wanted[2] = {whole_n[0] + vibration_n[0], whole_n[1] + vibration_n[1]};
    const double factor = hd_limit_within_whole(limit, contact_n, whole_n, vibration_n, force_n);
    if (factor < 1.0 || !(wanted[0] * wanted[0] + wanted[1] * wanted[1] <= HD_JUST_BELOW * limit * limit)) {
        report(state, wanted, time_ns, flags);
        hd_voices_scale(state, factor);
    } else {
        state->saturated = 0;
    }
}
