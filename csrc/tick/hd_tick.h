/* The tick: a function of table, state and input. No clock, no I/O, no allocation, no lock. */
#ifndef HD_TICK_H
#define HD_TICK_H

#include "base/hd_rt.h"
#include "scene/hd_world.h"
#include "tick/hd_state.h"

/* Turns what the device reported into the input of a tick: finite, no jump, and a velocity. `velocity` is the speed
 * where the caller knows it, or NULL to estimate it. */
HD_RT void hd_sense(struct hd_state *state, const struct hd_table *table, const struct hd_reading *reading,
                    const double *velocity, struct hd_input *input);

/* One tick. Fills every field of `sample` but lateness_ns and work_ns, and state->events[0 .. event_count). */
HD_RT void hd_tick(const struct hd_world *world, struct hd_state *state, const struct hd_input *input,
                   struct hd_sample *sample);

/* Strikes a mode by hand (`play`) at the next tick; direction is a unit vector, amplitude in units of the mode.
 * HD_ERR_FULL: enough for this tick, try at the next. */
HD_RT int hd_tick_play(struct hd_state *state, const struct hd_mode *mode, const double direction[2], double amplitude);

/* Nothing rings any more. */
HD_RT void hd_tick_silence(struct hd_state *state);

/* Clears the contact state of a slot (HD_NO_SLOT: of all): heals it, forgets the contact, which is met anew at the next
 * tick, silently and over the ramp. Slots of another generation are left alone. */
HD_RT void hd_tick_reset(struct hd_state *state, uint32_t slot, uint32_t generation, int64_t time_ns);

#endif
