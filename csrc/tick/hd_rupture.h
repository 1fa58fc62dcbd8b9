/* Membranes that rupture beyond a depth and can heal. Servo thread. */
#ifndef HD_RUPTURE_H
#define HD_RUPTURE_H

#include "tick/hd_context.h"

/* Returns the depth at which an object ruptures; 0: it never ruptures. */
HD_RT static inline double hd_rupture_depth_m(const struct hd_context *context, const struct hd_object *object) {
    return hd_shape_of(object)->membrane ? context->table->materials[object->material].rupture_depth_m : 0.0;
}

/* Checks whether a touched membrane ruptures in this tick: whether the probe passes the rupture depth before it leaves
 * over the end. The contact began at `fraction` of the tick's path. Returns 1 if the membrane was punctured, which ends
 * the contact. */
HD_RT int hd_rupture_happens(struct hd_context *context, uint32_t index, const struct hd_object *object,
                             const struct hd_contact_point *point, double fraction);
/* Closes a punctured membrane that heals once the probe is back on the side from which it was entered. */
HD_RT void hd_rupture_heal(struct hd_context *context, uint32_t index, const struct hd_object *object);

#endif
