/* Strikes that the device plays by itself, as the tick sees them: noted instead of becoming an active mode, and counted
 * against the force limit for as long as the effect may play. What is played in place of a mode, hapticd/hid/offload.py
 * says.
 *
 * A strike is left to the device only while the forces and the vibration are fully on: nothing can fade an effect.
 * Servo thread; all of it runs inside a tick. */
#ifndef HD_OFFLOAD_H
#define HD_OFFLOAD_H

#include "base/hd_rt.h"
#include "tick/hd_state.h"

/* Whether a strike of this effect is left to the device in this tick: its place in offloads[] plus one, which
 * hd_offload_strike fills; 0: it is an active mode. */
HD_RT uint32_t hd_offload_reserve(struct hd_state *state, uint32_t effect);
/* Notes a strike that has a place, at `scale` of its strength. */
HD_RT void hd_offload_strike(struct hd_state *state, const struct hd_strike *strike, double scale, double period_s);
/* Time went on: effects that are over for certain no longer count. */
HD_RT void hd_offload_advance(struct hd_state *state, uint32_t periods);

#endif
