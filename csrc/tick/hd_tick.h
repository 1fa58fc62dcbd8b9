/* The tick: computes the command from table, state and input. It reads no clock, does no I/O, allocates no memory and
 * takes no lock.
 *
 * The files of this room, in the order in which a tick uses them:
 *
 *   hd_tick                the stages of a tick, top to bottom
 *   hd_state               the state that is kept from tick to tick
 *   hd_context             the data that the stages of one tick share
 *   hd_velocity            the velocity, estimated from positions
 *   hd_mode                ringing modes: started, advanced, ended
 *   hd_waveform            taps that are waveforms: started, played, ended
 *   hd_strike_correction   corrections of the first samples after a strike
 *   hd_broad_phase         the candidate list: objects that the probe can reach
 *   hd_narrow_phase        which candidates are touched, and in which order contacts begin
 *   hd_contact             contacts: begun, ended, cleared
 *   hd_seam                friction that continues across the seam of two surfaces
 *   hd_tap                 the tap of an onset
 *   hd_contact_force       the contact force of one object
 *   hd_preload             compensated taps, limited so that they stay in contact
 *   hd_surface             stiffness, damping, friction and geometry at an arc length
 *   hd_groove_profile      where grooves are, and their shape
 *   hd_friction            Coulomb friction with a pre-sliding spring
 *   hd_groove              strikes of the grooves that the probe passes
 *   hd_surface_noise       the noise of one touched surface
 *   hd_noise               coloured noise, sample by sample
 *   hd_rupture             membranes that rupture and heal
 *   hd_aim                 the direction in which a tap and a rupture vibrate
 *   hd_field               springs, viscous and constant fields
 *   hd_stream              the force that a client streams
 *   hd_ramp                changes of the force by commands, spread over a ramp
 *   hd_passivity           the passivity observer and controller
 *   hd_strike              strikes: collected, scaled to the force limit, started
 *   hd_strike_mode         modes whose frequency follows speed and force
 *   hd_strike_peak         the largest force of a strike
 *   hd_offload             strikes that the device plays as effects
 *   hd_limit               the force limit
 */
#ifndef HD_TICK_H
#define HD_TICK_H

#include "base/hd_rt.h"
#include "scene/hd_world.h"
#include "tick/hd_state.h"

/* Makes the input of a tick from a reading of the device: checks it for glitches and adds the velocity. `velocity` is
 * the velocity if the caller knows it; NULL: it is estimated. */
HD_RT void hd_sense(struct hd_state *state, const struct hd_table *table, const struct hd_reading *reading,
                    const double *velocity, struct hd_input *input);

/* Renders one tick. Fills every field of `sample` except lateness_ns and work_ns, and state->events[0 .. event_count).
 */
HD_RT void hd_tick(const struct hd_world *world, struct hd_state *state, const struct hd_input *input,
                   struct hd_sample *sample);

/* Strikes a mode at the next tick, for the command `play`; direction is a unit vector, amplitude is in units of the
 * mode. Returns HD_ERR_FULL if the next tick has no more room; the caller tries again after it. */
HD_RT int hd_tick_play(struct hd_state *state, const struct hd_mode *mode, const double direction[2], double amplitude);

/* Takes a new value of the streamed force, which must be finite: from the next tick on the force moves to it within
 * `duration_s`. See hd_stream.h. */
HD_RT void hd_tick_stream(struct hd_state *state, const struct hd_table *table, const double force_n[2],
                          double duration_s);
/* Ends the streamed force, since no value came any more: it falls to zero over the ramp. */
HD_RT void hd_tick_stream_end(struct hd_state *state, const struct hd_table *table);

/* Ends every mode and waveform at once. */
HD_RT void hd_tick_silence(struct hd_state *state);

/* Clears the contact state of a slot (HD_NO_SLOT: of all slots): a membrane heals, a contact ends. If the object is
 * still pressed at the next tick, the contact begins again without a tap and over the ramp. A slot of another
 * generation stays unchanged. */
HD_RT void hd_tick_reset(struct hd_state *state, uint32_t slot, uint32_t generation, int64_t time_ns);

#endif
