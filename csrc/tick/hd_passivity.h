/* The time-domain passivity observer and controller of what is touched (Hannaford and Ryu, 2002).
 *
 * What is watched is the port between the servo and the hand: the force of the touched objects, friction and residual
 * among it, as it is commanded, and the positions that the device reports. Vibrations are active on purpose and fields
 * hold energy of their own; neither is counted, and neither is changed.
 *
 * A force f that is held while the position goes from x to x' gives the hand f.(x' - x), whatever happened in between.
 * The observer adds that up over one contact, from the first touch to the last release. What was touched has been
 * passive while the sum is not above zero. Where positions are known to be old when they come, each way is multiplied
 * with the force that acted then.
 *
 * The controller lets go before the sum becomes positive, brakes where it is, and bounds what the ways that are not
 * known yet can add. No sum is ever above F_max v_max (T + a + m), whatever the motion below v_max: T is the longest
 * interval between two samples of the contact, a the age of a sample, m the longest time for which ticks were missed.
 * See docs/passivity.md.
 *
 *   pushes[]  ring: what was commanded in each period since the contact began, as far back as there is room
 *
 * Part of the state; whoever ticks owns it. SI units. */
#ifndef HD_PASSIVITY_H
#define HD_PASSIVITY_H

#include "base/hd_rt.h"
#include "tick/hd_state.h"

/* A contact force and the part of it that objects make. */
struct hd_pushed {
    double *object_n;
    double *contact_n;
    double weight; /* the controller does so much of what it asks for, 0 to 1 */
};

/* Settles what is known by now. Where `is->weight` is above 0, the controller then changes `is`, and counts that; it
 * changes `still` by the same demands, and counts nothing. `anew`: nothing before this tick counts. Sets
 * HD_FLAG_RESTRAINED. */
HD_RT void hd_passivity_tick(struct hd_state *state, const struct hd_table *table, const struct hd_input *input,
                             int anew, const struct hd_pushed *is, const struct hd_pushed *still, uint32_t *flags);
/* At the end of the tick: what of it is commanded from now on. `gain` is that of the whole command. */
HD_RT void hd_passivity_hold(struct hd_passivity *passivity, const struct hd_table *table, uint64_t tick, double gain,
                             const double object_n[2], const double contact_n[2]);

#endif
