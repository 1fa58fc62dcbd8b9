/* The life of a contact, whatever the shape: taking a slot, touching, letting go; and strikes, which wait for the end
 * of the tick. Servo thread; all of it runs inside a tick. */
#ifndef HD_CONTACT_H
#define HD_CONTACT_H

#include "shapes/hd_shape.h"

/* The slot becomes that of another object; the contact of its former owner is let go. */
HD_RT void hd_contact_take(struct hd_context *context, uint32_t index, uint32_t generation);
/* Touches: reports it and strikes the tap. */
HD_RT void hd_contact_begin(struct hd_context *context, uint32_t index, const struct hd_object *object,
                            const struct hd_onset *onset);
HD_RT void hd_contact_end(struct hd_state *state, uint32_t index, int64_t time_ns);
/* A command took this from the force of the objects. */
HD_RT void hd_contact_change(struct hd_state *state, const double force_n[2]);
/* Lets go of a contact that is to be met anew by the next tick, silently and from the same side, if it is still pressed
 * then. */
HD_RT void hd_contact_clear(struct hd_state *state, uint32_t index, int64_t time_ns);

/* The tick of a surface that is touched, from `fraction` of the tick's way on. */
HD_RT void hd_contact_force_update(struct hd_context *context, uint32_t index, const struct hd_object *object,
                                   double fraction);
/* A touched surface became another one where the probe was: it is followed, or, where it turned its back, let go. */
HD_RT void hd_contact_force_change(struct hd_context *context, uint32_t index, const struct hd_object *object);
/* A touched surface is no more. */
HD_RT void hd_contact_force_drop(struct hd_context *context, uint32_t index);

/* Its noise is no more: what it would have been in this tick counts as taken away. */
HD_RT void hd_contact_hush(struct hd_state *state, struct hd_slot *slot);
/* Gives up the noise of a slot, if it has one. */
HD_RT void hd_contact_silence(struct hd_state *state, struct hd_slot *slot);
/* The membrane is no longer punctured, or about to heal. */
HD_RT void hd_contact_close(struct hd_state *state, uint32_t index);

/* Notes a strike for the end of the tick; `event` reports its scale. */
HD_RT void hd_strike_add(struct hd_state *state, const struct hd_strike *strike);
/* Strikes all that was noted, scaled as a whole to what the limit leaves of `felt_n`. Returns the scale. */
HD_RT double hd_strikes_apply(struct hd_state *state, const struct hd_table *table, double felt_n);

#endif
