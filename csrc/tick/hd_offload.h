/* Strikes that the device plays as effects: the tick records them instead of starting an active mode, and reserves part
 * of the force limit for as long as the effect may play. hapticd/hid/offload.py defines the effects.
 *
 * A strike is offloaded only while the gains of force and vibration are 1, since a started effect cannot be scaled or
 * faded. Servo thread; all of it runs inside a tick. */
#ifndef HD_OFFLOAD_H
#define HD_OFFLOAD_H

#include "base/hd_rt.h"
#include "tick/hd_state.h"

/* Reserves an entry of offloads[] for a strike of this effect. Returns its index plus one, for hd_offload_strike; 0:
 * the strike cannot be offloaded and becomes an active mode. */
HD_RT uint32_t hd_offload_reserve(struct hd_state *state, uint32_t effect);
/* Fills the reserved entry of a strike, scaled by `scale`, and reserves its force. */
HD_RT void hd_offload_strike(struct hd_state *state, const struct hd_strike *strike, double scale, double period_s);
/* Advances by `periods`: releases the reserves of effects that have certainly ended. */
HD_RT void hd_offload_advance(struct hd_state *state, uint32_t periods);

#endif
