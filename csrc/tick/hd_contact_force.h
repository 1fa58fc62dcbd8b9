/* Contact response: the force of an object that is touched. Servo thread; all of it runs inside a tick. */
#ifndef HD_CONTACT_FORCE_H
#define HD_CONTACT_FORCE_H

#include "tick/hd_context.h"

/* The tick of a contact, from `fraction` of the tick's path on. It may end. */
HD_RT void hd_contact_force_update(struct hd_context *context, uint32_t index, const struct hd_object *object,
                                   double fraction);
/* A touched surface became another one where the probe was: it is followed, or, where it turned its back, let go. */
HD_RT void hd_contact_force_change(struct hd_context *context, uint32_t index, const struct hd_object *object);
/* A touched surface is no more. */
HD_RT void hd_contact_force_drop(struct hd_context *context, uint32_t index);

#endif
