/* Corrections of the first samples after a strike ("kicks").
 *
 * A tap begins between two ticks, but its force starts at the second of them, and samples that are held distort a mode
 * of high frequency. Both errors are known at the strike, so corrections are added to the first HD_KICKS samples. Each
 * correction is a linear function of the onset's time between the ticks. Corrections of several strikes add up, as
 * their modes do. */
#ifndef HD_STRIKE_CORRECTION_H
#define HD_STRIKE_CORRECTION_H

#include "tick/hd_state.h"

/* Adds the corrections of a strike. `before`: time from the onset to the tick, in periods, 0 to 1. The correction of
 * this tick is added to state->ringing_n. */
HD_RT void hd_strike_correction_add(struct hd_state *state, const struct hd_mode *mode, double before,
                                    const double force_n[2]);
/* Advances by `periods` ticks and adds the correction that is due to state->ringing_n. Without an active mode all
 * corrections end. */
HD_RT void hd_strike_correction_advance(struct hd_state *state, uint32_t periods);
HD_RT void hd_strike_correction_scale(struct hd_state *state, double factor);
/* Returns the magnitude of the largest correction that is still to come, N. */
HD_RT double hd_strike_correction_bound(const struct hd_state *state);

#endif
