/* Seams: from a surface to an adjacent one that is flush with it (HD_FLUSH_M).
 *
 * The second surface takes over the surface properties of the first, and over the ramp they change to its own:
 * stiffness, damping, geometry, drag and friction. So the force has no step. The friction spring keeps its stretch.
 * Friction creates no energy: a spring that becomes stiffer keeps its force, one that becomes softer keeps its stretch.
 * A surface whose stiffness grows by K gives at most K d^2/2 at the largest depth d during the ramp.
 *
 * hd_contact.c calls hd_seam_cross when a contact begins that was reached along another surface, hd_contact_force.c
 * calls hd_seam_ease in each tick of the ramp after it. Servo thread. */
#ifndef HD_SEAM_H
#define HD_SEAM_H

#include "tick/hd_context.h"
#include "tick/hd_surface.h"

/* Whether two contact points of one position lie on flush surfaces. `reach_m`: distance between the middles of the
 * surfaces. */
HD_RT static inline int hd_seam_is_flush(const struct hd_contact_point *a, const struct hd_contact_point *b,
                                         double reach_m) {
    const double turn = a->normal[0] * b->normal[1] - a->normal[1] * b->normal[0];
    return hd_magnitude(a->depth_m - b->depth_m) <= HD_FLUSH_M && hd_magnitude(turn) * reach_m <= HD_FLUSH_M &&
           hd_dot(a->normal, b->normal) > 0.0;
}

/* Takes over the surface properties and the friction of a flush surface that the probe left in this tick, if there is
 * one. `slot->feature` and `slot->last` are set. */
HD_RT void hd_seam_cross(struct hd_context *context, struct hd_slot *slot, const struct hd_object *object);
/* Computes the surface properties in one tick of the ramp: those of the object at s, plus the remaining part of the
 * difference that was left at the last tick. */
HD_RT struct hd_dominant_material hd_seam_ease(const struct hd_table *table, const struct hd_object *object,
                                               double arc_m, struct hd_slot *slot);

#endif
