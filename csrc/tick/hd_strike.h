/* Strikes wait for the end of the tick, when the contact force is known. Servo thread; all of it runs inside a tick. */
#ifndef HD_STRIKE_H
#define HD_STRIKE_H

#include "base/hd_rt.h"
#include "tick/hd_state.h"

/* Notes a strike for the end of the tick; its event reports its scale. */
HD_RT void hd_strike_add(struct hd_state *state, const struct hd_strike *strike);
/* Strikes all that was noted, scaled as a whole to what the limit leaves of `felt_n`. Returns the scale. */
HD_RT double hd_strikes_apply(struct hd_state *state, const struct hd_table *table, double felt_n);

#endif
