/* Seams: hands surface properties and friction from one surface to the next, and blends them over the ramp. */
#include "tick/hd_seam.h"

#define HD_SEAM_TICKS UINT16_MAX /* the longest ramp */

/* Finds the contact point of the last sample on a surface that has ends. Returns half the length of the surface; 0: the
 * shape has no ends. */
HD_RT static double find_last_point(const struct hd_context *context, const struct hd_slot *slot,
                                    const struct hd_object *object, struct hd_contact_point *point) {
    const struct hd_shape_operations *shape = hd_shape_of(object);
    if (!shape->half_length) {
        return 0.0;
    }
    shape->contact_point(object, slot->feature, slot->last.normal, NULL, context->proxy.from_m, point);
    return shape->half_length(object, slot->feature);
}

HD_RT static int is_equal(const struct hd_surface *a, const struct hd_surface *b) {
    return a->stiffness_n_per_m == b->stiffness_n_per_m && a->damping_n_s_per_m == b->damping_n_s_per_m &&
           a->drag_n_s_per_m == b->drag_n_s_per_m && a->friction_coefficient == b->friction_coefficient &&
           a->friction_stiffness_n_per_m == b->friction_stiffness_n_per_m &&
           hd_magnitude(a->lowering_m - b->lowering_m) <= HD_FLUSH_M;
}

/* Begins the ramp from the properties `was` of the other surface at the last sample, which is at `from_m` on this one.
 */
HD_RT static void begin_ramp(const struct hd_table *table, const struct hd_object *object, double from_m,
                             const struct hd_surface *was, struct hd_slot *slot) {
    struct hd_surface from;
    struct hd_surface here;
    hd_surface_at(table, object, from_m, HD_UNBOUNDED_M, &from);
    if (is_equal(&from, was)) {
        return;
    }
    hd_surface_at(table, object, slot->last.arc_m, HD_UNBOUNDED_M, &here);
    slot->surface = *was;
    slot->surface.lowering_m += here.lowering_m - from.lowering_m;
    slot->surface.drag_n_s_per_m += here.drag_n_s_per_m - from.drag_n_s_per_m;
    const double ticks = 1.0 / table->ramp_step;
    slot->seam = ticks < (double)HD_SEAM_TICKS ? (uint16_t)ticks : (uint16_t)HD_SEAM_TICKS;
}

HD_RT void hd_seam_cross(struct hd_context *context, struct hd_slot *slot, const struct hd_object *object) {
    const struct hd_table *table = context->table;
    struct hd_contact_point here;
    const double half = find_last_point(context, slot, object, &here);
    for (uint32_t i = 0; half > 0.0 && i < context->proxy.plane_count; i++) {
        const uint32_t index = context->proxy.plane[i].slot;
        const struct hd_slot *other = &context->state->slots[index];
        struct hd_contact_point there;
        if (other == slot || other->touched || index >= table->object_count ||
            table->objects[index].shape == HD_SHAPE_NONE) {
            continue; /* the other object is still touched, or was removed */
        }
        const double reach = half + find_last_point(context, other, &table->objects[index], &there);
        const double along =
            (double)(slot->feature.side *
                     other->feature.side); /* sign of s on the other surface relative to s on this one */
        if (reach == half || other->generation != table->objects[index].generation ||
            !hd_seam_is_flush(&here, &there, reach) ||
            hd_magnitude(here.arc_m - along * there.arc_m) > reach + HD_FLUSH_M) {
            continue;
        }
        struct hd_surface was = other->surface;
        if (other->seam == 0) {
            hd_surface_at(table, &table->objects[index], there.arc_m, HD_UNBOUNDED_M, &was);
        }
        slot->anchor_m = here.arc_m - along * (there.arc_m - other->anchor_m);
        slot->offset_m = other->offset_m;
        context->freed_j = 0.0;
        begin_ramp(table, object, here.arc_m, &was, slot);
        return;
    }
}

/* Adds the remaining part of the difference between a property at the last tick, `was`, and the one of the object. */
HD_RT static inline void ease(double remaining, double was, double own, double *property) {
    *property += remaining * (was - own);
}

HD_RT struct hd_dominant_material hd_seam_ease(const struct hd_table *table, const struct hd_object *object,
                                               double arc_m, struct hd_slot *slot) {
    struct hd_surface *surface = &slot->surface;
    const struct hd_surface was = *surface;
    struct hd_surface own; /* of the object at the last tick */
    hd_surface_at(table, object, slot->last.arc_m, HD_UNBOUNDED_M, &own);
    const struct hd_dominant_material dominant = hd_surface_at(table, object, arc_m, HD_UNBOUNDED_M, surface);
    const double remaining = (double)(slot->seam - 1u) / (double)slot->seam; /* part of the difference, 0 to 1 */
    slot->seam--;
    ease(remaining, was.stiffness_n_per_m, own.stiffness_n_per_m, &surface->stiffness_n_per_m);
    ease(remaining, was.damping_n_s_per_m, own.damping_n_s_per_m, &surface->damping_n_s_per_m);
    ease(remaining, was.lowering_m, own.lowering_m, &surface->lowering_m);
    ease(remaining, was.drag_n_s_per_m, own.drag_n_s_per_m, &surface->drag_n_s_per_m);
    ease(remaining, was.friction_coefficient, own.friction_coefficient, &surface->friction_coefficient);
    /* A material without friction has no spring stiffness; the spring keeps that of the other surface. */
    if (surface->friction_stiffness_n_per_m == 0.0) {
        surface->friction_stiffness_n_per_m = was.friction_stiffness_n_per_m;
    } else if (was.friction_stiffness_n_per_m > 0.0) {
        ease(remaining, was.friction_stiffness_n_per_m, own.friction_stiffness_n_per_m,
             &surface->friction_stiffness_n_per_m);
        if (surface->friction_stiffness_n_per_m > was.friction_stiffness_n_per_m) {
            const double part = was.friction_stiffness_n_per_m / surface->friction_stiffness_n_per_m;
            slot->anchor_m = arc_m - part * (arc_m - slot->anchor_m);
        }
    }
    return dominant;
}
