/* Contact response: the force of a touched object. Servo thread; all of it runs inside a tick. */
#ifndef HD_CONTACT_FORCE_H
#define HD_CONTACT_FORCE_H

#include "tick/hd_context.h"

/* Updates a contact, which began at `fraction` of the path of this tick (0: earlier): adds its force to the context, or
 * ends the contact if the probe has left. */
HD_RT void hd_contact_force_update(struct hd_context *context, uint32_t index, const struct hd_object *object,
                                   double fraction);
/* Applies a changed pose or surface of a touched object. If the normal turned away from the probe, the contact ends. */
HD_RT void hd_contact_force_change(struct hd_context *context, uint32_t index, const struct hd_object *object);
/* Gives the energy of springs that the probe left sideways in this tick to contacts that began below their surface. */
HD_RT void hd_contact_force_take_over(struct hd_context *context);
/* Ends the contact with an object that was removed. */
HD_RT void hd_contact_force_drop(struct hd_context *context, uint32_t index);

#endif
