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

#include "api/hd_core.h"
#include "base/hd_rt.h"

#define HD_PASSIVITY_PERIODS 1024u /* a power of two, more than HD_PASSIVITY_AGE_MAX and a report's interval need */

struct hd_state;
struct hd_input;

struct hd_push {
    double force_n[2];
    double size_n;
};

struct hd_passivity {
    uint64_t next;       /* the tick that goes on from here; any other begins anew */
    uint64_t acted;      /* ticks in which the controller changed the force */
    uint64_t contacts;   /* so far */
    uint64_t restrained; /* of them, those in which it did */
    double energy_j;     /* given to the hand in this contact, or in the last one */
    double largest_j;    /* of all contacts */
    double taken_j;      /* by the handle itself, in this contact */
    double brake; /* how much of its brake the controller has, 0 to 1: over the ramp it goes with what is touched */
    uint32_t interval;   /* the longest between two samples of this contact, in periods */
    uint32_t hold;       /* the longest between two ticks of it */
    uint32_t pushed;     /* periods in pushes[] */
    uint32_t newest;     /* place in pushes[] */
    uint32_t waited;     /* periods since the last sample */
    uint8_t running;     /* in contact, or a part of its work is not known yet */
    uint8_t acting;      /* in this contact */
    struct hd_push held; /* commanded since the last tick */
    struct hd_push pushes[HD_PASSIVITY_PERIODS];
};

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
