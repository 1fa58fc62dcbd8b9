/* Membranes rupture past a depth, and may heal. Servo thread. */
#ifndef HD_RUPTURE_H
#define HD_RUPTURE_H

#include "tick/hd_context.h"

/* Whether an object ruptures before it is as deep as that. */
HD_RT int hd_rupture_is_beyond(const struct hd_context *context, const struct hd_object *object, double depth_m);
/* A membrane that is touched, its contact from `fraction` of the tick's path on: past the rupture depth, or over the
 * end before that? 1: it is punctured, and the contact is over. */
HD_RT int hd_rupture_happens(struct hd_context *context, uint32_t index, const struct hd_object *object,
                             const struct hd_contact_point *point, double fraction);
/* A punctured membrane: closes when the probe is back on the side that it came from. */
HD_RT void hd_rupture_heal(struct hd_context *context, uint32_t index, const struct hd_object *object);

#endif
