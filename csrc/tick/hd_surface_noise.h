/* The coloured noise of a surface that is touched. Servo thread; all of it runs inside a tick. */
#ifndef HD_SURFACE_NOISE_H
#define HD_SURFACE_NOISE_H

#include "tick/hd_context.h"
#include "tick/hd_surface.h"

/* Adds a tick of it to the context's sums. `changed`: by a command, so that what is not as it was comes over the ramp.
 */
HD_RT void hd_surface_noise_sound(struct hd_context *context, uint32_t index,
                                  const struct hd_dominant_material *dominant, const double normal[2],
                                  const double tangent[2], int changed);
/* A command takes it away: what it would have been in this tick counts as a change. */
HD_RT void hd_surface_noise_change(struct hd_state *state, struct hd_slot *slot);
/* Gives up the noise of a slot, if it has one. */
HD_RT void hd_surface_noise_end(struct hd_state *state, struct hd_slot *slot);

#endif
