/* Friction across a seam: hands the spring from one surface to the next and blends its parameters over the ramp. */
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
            !hd_seam_is_flush(&here, &there) || hd_magnitude(here.arc_m - along * there.arc_m) > reach + HD_RIM_M) {
            continue;
        }
        const struct hd_material *material = &table->materials[object->material];
        const double ticks = 1.0 / table->ramp_step;
        slot->anchor_m = here.arc_m - along * (there.arc_m - other->anchor_m);
        slot->offset_m = other->offset_m;
        context->freed_j = 0.0;
        slot->surface.friction_coefficient = other->surface.friction_coefficient;
        slot->surface.friction_stiffness_n_per_m = other->surface.friction_stiffness_n_per_m;
        if (material->friction_coefficient != other->surface.friction_coefficient ||
            material->friction_stiffness_n_per_m != other->surface.friction_stiffness_n_per_m) {
            slot->seam = ticks < (double)HD_SEAM_TICKS ? (uint16_t)ticks : (uint16_t)HD_SEAM_TICKS;
        }
        return;
    }
}

HD_RT void hd_seam_ease(struct hd_slot *slot, double arc_m, double coefficient, double stiffness_n_per_m) {
    struct hd_surface *surface = &slot->surface;
    const double remaining = (double)(slot->seam - 1u) / (double)slot->seam; /* part of the difference, 0 to 1 */
    slot->seam--;
    surface->friction_coefficient += remaining * (coefficient - surface->friction_coefficient);
    /* A material without friction has no spring stiffness; the spring keeps that of the other surface. */
    if (surface->friction_stiffness_n_per_m == 0.0) {
        surface->friction_stiffness_n_per_m = stiffness_n_per_m;
    } else if (stiffness_n_per_m > 0.0) {
        surface->friction_stiffness_n_per_m += remaining * (stiffness_n_per_m - surface->friction_stiffness_n_per_m);
        if (surface->friction_stiffness_n_per_m > stiffness_n_per_m) {
            const double part = stiffness_n_per_m / surface->friction_stiffness_n_per_m;
            slot->anchor_m = arc_m - part * (arc_m - slot->anchor_m);
        }
    }
}
