/* The largest force of a strike, which depends on the stiffness of touched surfaces and fields along its direction. */
#ifndef HD_STRIKE_PEAK_H
#define HD_STRIKE_PEAK_H

#include "tick/hd_state.h"

/* Returns the largest force of a strike divided by its coefficient. For a mode that is compensated for stiffness, sets
 * strike->touched. */
HD_RT double hd_strike_peak(const struct hd_state *state, const struct hd_table *table, struct hd_strike *strike);

#endif
