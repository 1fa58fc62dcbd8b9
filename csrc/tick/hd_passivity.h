/* The time-domain passivity observer and controller of contact forces (Hannaford and Ryu, 2002).
 *
 * The observed port lies between servo and hand: the commanded force of the touched objects, including friction and
 * residual, and the positions that the device reports. Vibration is active by design and fields store energy; both are
 * neither counted nor changed.
 *
 * A force f that is held while the position goes from x to x' does the work f.(x' - x) on the hand, for any path in
 * between. The observer sums this over one contact, from the first onset to the last release. The touched objects are
 * passive while the sum is not above zero. If positions are old when they arrive, each displacement is multiplied with
 * the force at the time of the displacement.
 *
 * The controller reduces the force along the motion before the sum becomes positive, brakes where it is positive, and
 * bounds the work of displacements that are not known yet. For any motion below v_max the sum never exceeds F_max v_max
 * (T + a + m): T is the longest interval between two samples of the contact, a the age of a sample, m the longest time
 * for which ticks were missed. See docs/passivity.md.
 *
 *   pushes[]  ring: the force commanded in each of the last HD_PASSIVITY_PERIODS periods of the contact
 *
 * Part of the state, and owned by its thread. SI units. */
#ifndef HD_PASSIVITY_H
#define HD_PASSIVITY_H

#include "base/hd_rt.h"
#include "tick/hd_state.h"

/* A contact force and the part of it that objects exert. */
struct hd_pushed {
    double *object_n;
    double *contact_n;
    double weight; /* part of the controller's change that is applied, 0 to 1 */
};

/* Adds the work that is known by now, then applies the controller to `is`, the force of this tick, if the weight is
 * above 0. A changed force is counted and sets HD_FLAG_RESTRAINED. The controller is also applied to `still`, the force
 * with every ramp stopped, without counting. `restart`: the sum starts again. */
HD_RT void hd_passivity_tick(struct hd_state *state, const struct hd_table *table, const struct hd_input *input,
                             int restart, const struct hd_pushed *is, const struct hd_pushed *still, uint32_t *flags);
/* Records, at the end of the tick, the force that is commanded until the next one. `gain`: gain of the command. */
HD_RT void hd_passivity_hold(struct hd_passivity *passivity, const struct hd_table *table, uint64_t tick, double gain,
                             const double object_n[2], const double contact_n[2]);

#endif
