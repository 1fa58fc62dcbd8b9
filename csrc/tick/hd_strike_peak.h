/* The largest force of a strike, from what presses along its direction then: the surfaces that are touched, and the
 * fields. */
#ifndef HD_STRIKE_PEAK_H
#define HD_STRIKE_PEAK_H

#include "tick/hd_state.h"

/* The largest force of a strike over its coefficient. Of a mode that is compensated for what it meets, notes in the
 * strike how much of that there is. */
HD_RT double hd_strike_peak(const struct hd_state *state, const struct hd_table *table, struct hd_strike *strike);

#endif
