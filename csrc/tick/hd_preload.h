/* Taps that stay in contact: how much of the compensation the push of the hand allows.
 *
 * A surface pushes and never pulls. A fully compensated tap can lift the probe off a surface that a tap without
 * compensation does not leave. Such a tap has two sets of gains (hd_table_numbers.h). With the first one it never lifts
 * the probe higher than a tap without compensation does. The second one, of full compensation, needs a larger push. The
 * difference rings as separate modes of the slot, `preloaded`, times a share that starts at 1. At every tick of the
 * contact the share is limited to
 *
 *     (d / v - low(t)) / (high(t) - low(t)),
 *
 * with the depth d, the approach speed v, and the depths per approach speed of the first set with a hand that stops at
 * the onset, low, and of the second with the weakest hand that gets all of it, high. The share never grows again; when
 * the contact ends it is 0. Servo thread. */
#ifndef HD_PRELOAD_H
#define HD_PRELOAD_H

#include "tick/hd_context.h"

/* Begins to judge the depth of a tap. Returns the numbers of the compensated tap, which begin with its second
 * tail; NULL if it has none. */
HD_RT const double *hd_preload_begin(struct hd_context *context, uint32_t index, const struct hd_material *material,
                                     double before_s, double approach, uint32_t *bounced);
/* Judges the depth of the slot's tap, whose preloaded modes ring, on `material`. */
HD_RT void hd_preload_follow(struct hd_context *context, uint32_t index, const struct hd_material *material,
                             const struct hd_contact_point *point);
/* Silences the preloaded modes of a slot. */
HD_RT void hd_preload_end(struct hd_state *state, uint32_t index);

#endif
