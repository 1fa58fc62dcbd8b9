/* Strikes wait for the end of the tick, when the contact force is known. Servo thread; all of it runs inside a tick. */
#ifndef HD_STRIKE_H
#define HD_STRIKE_H

#include "base/hd_rt.h"
#include "tick/hd_state.h"

/* Adds a strike to those that start at the end of the tick; its event reports the scale. */
HD_RT void hd_strike_add(struct hd_state *state, const struct hd_strike *strike);
/* Starts the collected strikes, all scaled by one factor so that they fit within the force limit above the contact
 * force `felt_n`. Returns the factor. */
HD_RT double hd_strikes_apply(struct hd_state *state, const struct hd_table *table, double felt_n);

#endif
