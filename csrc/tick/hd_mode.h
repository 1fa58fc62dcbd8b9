/* Ringing modes: one complex rotor per mode, for x and y together. The equation is at the top of hd_mode.c. */
#ifndef HD_MODE_H
#define HD_MODE_H

#include "base/hd_rt.h"
#include "tick/hd_state.h"

/* Advances all modes by `periods` ticks and ends those that are over, which are exactly zero from then on. From here to
 * the end of the tick state->ringing_n holds the sum of the modes, including later strikes and scaling. */
HD_RT void hd_modes_advance(struct hd_state *state, uint32_t periods);
/* Returns an upper bound of the sum of all ringing modes from now on, N. */
HD_RT double hd_modes_bound(const struct hd_state *state);
/* Adds a strike with the coefficient `force_n`, a vector, to its mode and to the tail of the mode. */
HD_RT void hd_modes_strike(struct hd_state *state, const struct hd_strike *strike, const double force_n[2],
                           double period_s);
/* Multiplies the amplitude of everything that rings by `factor`. */
HD_RT void hd_modes_scale(struct hd_state *state, double factor);
/* Multiplies the amplitude of the parts of a slot's taps that need a preload by `factor`. */
HD_RT void hd_modes_scale_preloaded(struct hd_state *state, uint32_t slot, double factor);
/* Silences the tails of a slot's taps, and the parts that need a preload. */
HD_RT void hd_modes_silence_tails(struct hd_state *state, uint32_t slot);
HD_RT void hd_modes_silence(struct hd_state *state);

#endif
