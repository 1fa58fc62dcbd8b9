/* The coloured noise of a touched surface. Servo thread; all of it runs inside a tick. */
#ifndef HD_SURFACE_NOISE_H
#define HD_SURFACE_NOISE_H

#include "tick/hd_context.h"
#include "tick/hd_surface.h"

/* Adds the next sample of the noise to the sums of the context. `changed`: a command changed the noise or the contact
 * in this tick, so that the difference comes in over the ramp. */
HD_RT void hd_surface_noise_sound(struct hd_context *context, uint32_t index,
                                  const struct hd_dominant_material *dominant, const double normal[2],
                                  const double tangent[2], int changed);
/* Records the removal of a noise by a command: the sample that it would have had counts as a change. */
HD_RT void hd_surface_noise_change(struct hd_state *state, struct hd_slot *slot);
/* Ends the noise of a slot, if it has one. */
HD_RT void hd_surface_noise_end(struct hd_state *state, struct hd_slot *slot);

#endif
