/* Friction across a seam: from a surface to an adjacent one that is flush with it.
 *
 * The friction spring continues on the second surface: it keeps its stretch, and over the ramp its stiffness and
 * coefficient change to those of the second material. This creates no energy: a spring that becomes stiffer keeps its
 * force, one that becomes softer keeps its stretch.
 *
 * hd_contact.c calls hd_seam_cross when a contact begins that was reached along another surface, hd_contact_force.c
 * calls hd_seam_ease in each tick of the ramp after it. Servo thread. */
#ifndef HD_SEAM_H
#define HD_SEAM_H

#include "tick/hd_context.h"

/* Whether two contact points lie on flush surfaces: depth and normal are equal within HD_RIM_M. */
HD_RT static inline int hd_seam_is_flush(const struct hd_contact_point *a, const struct hd_contact_point *b) {
    const double turn = a->normal[0] * b->normal[1] - a->normal[1] * b->normal[0];
    return hd_magnitude(a->depth_m - b->depth_m) <= HD_RIM_M && hd_magnitude(turn) <= HD_RIM_M &&
           hd_dot(a->normal, b->normal) > 0.0;
}

/* Takes over the friction of a flush surface that the probe left in this tick, if there is one. `slot->feature` is set.
 */
HD_RT void hd_seam_cross(struct hd_context *context, struct hd_slot *slot, const struct hd_object *object);
/* Blends friction in one tick of the ramp: `slot->surface` holds the material's values, the arguments those of the last
 * tick. */
HD_RT void hd_seam_ease(struct hd_slot *slot, double arc_m, double coefficient, double stiffness_n_per_m);

#endif
