/* What presses along a direction when a strike is made: the surfaces that are touched then, and the fields. */
#ifndef HD_PRESS_H
#define HD_PRESS_H

#include "tick/hd_state.h"

/* The largest force of a strike over its coefficient. Of a mode that is compensated for what it meets, notes in the
 * strike how much of that there is. */
HD_RT double hd_press_peak(const struct hd_state *state, const struct hd_table *table, struct hd_strike *strike);

#endif
