/* Membranes rupture past a depth, and may heal. Servo thread. */
#ifndef HD_RUPTURE_H
#define HD_RUPTURE_H

#include "tick/hd_context.h"

/* The depth at which an object ruptures; 0: it never does. */
HD_RT static inline double hd_rupture_depth_m(const struct hd_context *context, const struct hd_object *object) {
    return hd_shape_of(object)->membrane ? context->table->materials[object->material].rupture_depth_m : 0.0;
}

/* A membrane that can rupture is touched, its contact from `fraction` of the tick's path on: past the rupture depth, or
 * over the end before that? 1: it is punctured, and the contact is over. */
HD_RT int hd_rupture_happens(struct hd_context *context, uint32_t index, const struct hd_object *object,
                             const struct hd_contact_point *point, double fraction);
/* A punctured membrane: closes when the probe is back on the side that it came from. */
HD_RT void hd_rupture_heal(struct hd_context *context, uint32_t index, const struct hd_object *object);

#endif
