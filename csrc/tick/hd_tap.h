/* Taps: what the onset of a contact strikes.
 *
 * hd_contact_begin (hd_contact.c) calls it where an onset was seen and the probe came neither along another surface nor
 * from a tap before which it has not yet risen far enough (rearm_m). Servo thread. */
#ifndef HD_TAP_H
#define HD_TAP_H

#include "tick/hd_context.h"

/* Strikes the tap of the material at `point`, met at the speed `approach` along its normal, `before_s` before the tick.
 * `event` reports its amplitude. */
HD_RT void hd_tap_strike(struct hd_context *context, uint32_t index, const struct hd_object *object,
                         const struct hd_contact_point *point, double before_s, double approach,
                         struct hd_event *event);

#endif
