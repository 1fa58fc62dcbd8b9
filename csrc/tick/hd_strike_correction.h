/* The first samples of strikes, corrected one by one.
 *
 * A tap begins between two ticks and is answered at the second of them. What is missing until then is known when it is
 * struck, and so is what held samples make of a high mode: kicks are added to the first HD_KICKS samples, each a
 * straight line over the time of the onset between the ticks. Strikes add up, as their modes do. */
#ifndef HD_STRIKE_CORRECTION_H
#define HD_STRIKE_CORRECTION_H

#include "tick/hd_state.h"

/* `before`: of a period, 0 to 1. What is added to this tick is in state->ringing_n as well. */
HD_RT void hd_strike_correction_add(struct hd_state *state, const struct hd_mode *mode, double before,
                                    const double force_n[2]);
/* So many ticks later; adds what is due to state->ringing_n. Without an active mode that rings there is none. */
HD_RT void hd_strike_correction_advance(struct hd_state *state, uint32_t periods);
HD_RT void hd_strike_correction_scale(struct hd_state *state, double factor);
/* The largest that is still to come. */
HD_RT double hd_strike_correction_bound(const struct hd_state *state);

#endif
