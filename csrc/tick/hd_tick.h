/* The tick: a function of table, state and input. No clock, no I/O, no allocation, no lock.
 *
 * The files of this room, in the order in which a tick comes to them:
 *
 *   hd_tick                the stages of a tick, top to bottom
 *   hd_state               what is remembered from tick to tick
 *   hd_context             what one tick knows, from stage to stage
 *   hd_velocity            the velocity, estimated from positions
 *   hd_mode                ringing modes: struck, turned, ended
 *   hd_waveform            taps that are waveforms: begun, played, ended
 *   hd_strike_correction   corrections of the first samples after a strike
 *   hd_broad_phase         the candidate list: which objects can be met
 *   hd_narrow_phase        which of them are met, and in which order contacts begin
 *   hd_contact             the life of a contact: begun, ended, cleared
 *   hd_seam                friction that goes on from one surface to the next
 *   hd_tap                 the tap of an onset
 *   hd_contact_force       the force of an object that is touched
 *   hd_surface             stiffness, damping, friction and geometry at an arc length
 *   hd_groove_profile      where grooves are, and their shape
 *   hd_friction            Coulomb friction with a spring before it slides
 *   hd_groove              grooves that are passed, each of them a strike
 *   hd_surface_noise       the noise of a surface that is touched
 *   hd_noise               coloured noise, sample by sample
 *   hd_rupture             membranes that rupture and heal
 *   hd_aim                 the direction in which a tap and a rupture push first
 *   hd_field               springs, viscous and constant fields
 *   hd_stream              the force that a client streams
 *   hd_ramp                what commands may do to the force
 *   hd_passivity           the passivity observer and controller
 *   hd_strike              strikes: noted, scaled to what the limit leaves, started
 *   hd_strike_mode         the mode of a strike that follows speed and force
 *   hd_strike_peak         the largest force of a strike
 *   hd_offload             strikes that the device plays by itself
 *   hd_limit               the force limit
 */
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

/* A newer value of the streamed force, finite: it goes there in `duration_s` from the next tick on. See hd_stream.h. */
HD_RT void hd_tick_stream(struct hd_state *state, const struct hd_table *table, const double force_n[2],
                          double duration_s);
/* None came any more: it goes to zero over the ramp. */
HD_RT void hd_tick_stream_end(struct hd_state *state, const struct hd_table *table);

/* Nothing rings any more. */
HD_RT void hd_tick_silence(struct hd_state *state);

/* Clears the contact state of a slot (HD_NO_SLOT: of all): heals it, forgets the contact, which is met anew at the next
 * tick, silently and over the ramp. Slots of another generation are left alone. */
HD_RT void hd_tick_reset(struct hd_state *state, uint32_t slot, uint32_t generation, int64_t time_ns);

#endif
