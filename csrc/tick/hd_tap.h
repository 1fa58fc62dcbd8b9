/* Taps: the strikes at the onset of a contact.
 *
 * hd_contact_begin (hd_contact.c) strikes a tap at an onset, unless the probe came along another surface or has not
 * been rearm_m away from this one since the last contact. Servo thread. */
#ifndef HD_TAP_H
#define HD_TAP_H

#include "tick/hd_context.h"

/* Strikes the tap of the material at `point`. `approach`: approach speed along the normal, m/s; `before_s`: time from
 * the onset to the tick. Writes the amplitude into `event`. */
HD_RT void hd_tap_strike(struct hd_context *context, uint32_t index, const struct hd_object *object,
                         const struct hd_contact_point *point, double before_s, double approach,
                         struct hd_event *event);

#endif
