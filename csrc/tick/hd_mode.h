/* Ringing modes: one complex rotor per mode, in two directions at once. The equation is at the top of hd_mode.c. */
#ifndef HD_MODE_H
#define HD_MODE_H

#include "base/hd_rt.h"
#include "tick/hd_state.h"

/* All modes go on by `periods` ticks; those that have ended are exactly zero from now on. What they add up to is in
 * state->ringing_n from here to the end of the tick, strikes and scaling included. */
HD_RT void hd_modes_advance(struct hd_state *state, uint32_t periods);
/* An upper bound of what the ringing modes can add up to from now on. */
HD_RT double hd_modes_bound(const struct hd_state *state);
/* Adds a strike with the coefficient `force_n` (a vector) to its mode, and to the tail of that. */
HD_RT void hd_modes_strike(struct hd_state *state, const struct hd_strike *strike, const double force_n[2],
                           double period_s);
/* What is ringing goes on at `factor` of its amplitude. */
HD_RT void hd_modes_scale(struct hd_state *state, double factor);
HD_RT void hd_modes_silence(struct hd_state *state);

#endif
