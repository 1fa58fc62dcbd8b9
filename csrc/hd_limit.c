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

HD_RT void hd_limit_exceeded(struct hd_state *state, const struct hd_table *table, const double contact_n[2],
                             const double vibration_n[2], int64_t time_ns, double force_n[2], uint32_t *flags) {
    const double limit = hd_limit_of(state, table);
    const double wanted = force_n[0] * force_n[0] + force_n[1] * force_n[1];
    *flags |= HD_FLAG_SATURATED;
    if (!state->saturated) {
        state->saturated = 1;
        state->saturations_total++;
        const uint32_t event = hd_state_event(state, HD_EVENT_SATURATION, time_ns);
        if (event < HD_EVENT_CAPACITY) {
            HD_RT_FOREIGN_BEGIN
            state->events[event].value = sqrt(wanted);
            HD_RT_FOREIGN_END
        }
    }
    const double contact = contact_n[0] * contact_n[0] + contact_n[1] * contact_n[1];
    double factor = 0.0;
    double cut = 1.0;
    if (contact <= HD_JUST_BELOW * limit * limit) {
        /* The larger root of |contact + g vibration|^2 = limit^2. */
        const double a = vibration_n[0] * vibration_n[0] + vibration_n[1] * vibration_n[1];
        const double b = contact_n[0] * vibration_n[0] + contact_n[1] * vibration_n[1];
        const double c = contact - limit * limit;
        HD_RT_FOREIGN_BEGIN
        const double root = sqrt(b * b - a * c);
        HD_RT_FOREIGN_END
        factor = b > 0.0 ? -c / (b + root) : (root - b) / a;
    } else {
        HD_RT_FOREIGN_BEGIN
        cut = limit / sqrt(contact);
        HD_RT_FOREIGN_END
    }
    hd_voices_scale(state, factor);
    force_n[0] = HD_JUST_BELOW * (cut * contact_n[0] + factor * vibration_n[0]);
    force_n[1] = HD_JUST_BELOW * (cut * contact_n[1] + factor * vibration_n[1]);
}
