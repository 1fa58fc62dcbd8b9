/* Friction across a seam: from a surface to one that touches it and lies in line with it.
 *
 * What holds the probe goes on there: the spring keeps its stretch, and over the ramp its stiffness and coefficient go
 * over to those of the other material. No energy is made meanwhile: a spring that becomes stiffer keeps its force, one
 * that becomes softer its stretch.
 *
 * hd_contact.c calls hd_seam_cross when a contact begins that was reached along another surface, hd_contact_force.c
 * calls hd_seam_ease in each tick of the ramp after it. Servo thread. */
#ifndef HD_SEAM_H
#define HD_SEAM_H

#include "tick/hd_context.h"

/* Whether two contact points lie in one surface: as deep, and facing the same way. */
HD_RT static inline int hd_seam_is_flush(const struct hd_contact_point *a, const struct hd_contact_point *b) {
    const double turn = a->normal[0] * b->normal[1] - a->normal[1] * b->normal[0];
    return hd_magnitude(a->depth_m - b->depth_m) <= HD_RIM_M && hd_magnitude(turn) <= HD_RIM_M &&
           hd_dot(a->normal, b->normal) > 0.0;
}

/* The slot was reached along a surface that was left in this tick, or not; `slot->feature` is set. */
HD_RT void hd_seam_cross(const struct hd_context *context, struct hd_slot *slot, const struct hd_object *object);
/* A tick of the ramp: the slot's surface is the material's, what is given that of the last tick. */
HD_RT void hd_seam_ease(struct hd_slot *slot, double arc_m, double coefficient, double stiffness_n_per_m);

#endif
