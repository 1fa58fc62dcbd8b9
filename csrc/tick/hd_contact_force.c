/* A contact in one tick: contact point, surface properties and force.
 *
 * F = F_n n + F_t t, with e = d - H(s) the depth below the surface that geometry lowers by H,
 *     F_n = max(0, K e + D v_n) while e > 0, else 0
 *     F_t = K e H' - K'/2 e^2 (while e > 0) + friction - drag v_t,
 * v_n = -v.n, v_t = v.t; see hd_surface.h for K, H and their slopes, hd_friction.h for friction. Vibration (grooves,
 * noise) is added to this force and does not depend on whether it is displayed.
 *
 * A contact may begin with the probe at a depth d0 below the surface: the proxy reached it along another surface, or a
 * solid that overlaps was left. Then d above is the depth less an offset. The offset begins at d0 and falls with the
 * depth when the probe withdraws, so that the contact never gives energy that it did not take. A spring that the probe
 * leaves sideways gives its energy to such contacts in the same tick (hd_contact_force_take_over), and along their
 * normals at most its force.
 *
 * On a disc of radius R a probe at radius r moves by r/R of the change of s, so there the first two terms of F_t are
 * multiplied by R/r. Deep in the disc geometry fades with g(r), from 1 to 0 (hd_shape.h: lever). Its energy is
 *     U = K/2 (d - g H)^2
 * and the force is the gradient of U, so that g' K e H along n is added to F_n.
 *
 * Friction acts where the probe is: the stretch z of its spring changes by the probe's own motion along the tangent,
 * not by the change of s. So on a disc, too, k is the stiffness along the surface and mu F_n the largest friction, and
 * the power -F_t v_t is that of the stored energy k/2 z^2. On a round surface z = s - anchor holds as well: the anchor
 * takes up the difference between the two motions. */
#include "tick/hd_contact_force.h"

#include <math.h>

#include "tick/hd_aim.h"
#include "tick/hd_contact.h"
#include "tick/hd_friction.h"
#include "tick/hd_groove.h"
#include "tick/hd_preload.h"
#include "tick/hd_rupture.h"
#include "tick/hd_seam.h"
#include "tick/hd_surface.h"
#include "tick/hd_surface_noise.h"

#define HD_PI 3.14159265358979323846

/* Whether the force on a round object depends on s. */
HD_RT static int needs_arc_length(const struct hd_table *table, const struct hd_object *object) {
    return table->materials[object->material].texture != HD_TEXTURE_NONE;
}

/* Finds the contact point of the probe. `met`: the contact began in this tick. */
HD_RT static inline void find_point(const struct hd_context *context, const struct hd_slot *slot,
                                    const struct hd_object *object, int met, struct hd_contact_point *point) {
    const struct hd_shape_operations *shape = hd_shape_of(object);
    shape->contact_point(object, slot->feature, slot->last.normal, met ? NULL : context->proxy.from_m,
                         context->proxy.to_m, point);
    if (shape->arc_length && needs_arc_length(context->table, object)) {
        point->arc_m = shape->arc_length(object, point->normal);
    }
}

/* Finds the contact point of the last sample on the object as it is now. `moved`: its pose changed. */
HD_RT static void find_last_point(const struct hd_context *context, const struct hd_slot *slot,
                                  const struct hd_object *object, int moved, struct hd_contact_point *point) {
    const struct hd_shape_operations *shape = hd_shape_of(object);
    const double *was_m = context->proxy.from_m;
    shape->contact_point(object, slot->feature, slot->last.normal, moved ? NULL : was_m, was_m, point);
    if (shape->arc_length) {
        point->arc_m = shape->arc_length(object, point->normal);
    }
}

/* Computes the force of a surface at a contact point, along the normal and along the tangent, and moves the anchor of
 * friction. `lever`: NULL on a flat surface. Returns F_n. */
HD_RT static inline double compute_force(const struct hd_surface *surface, const struct hd_contact_point *point,
                                         const double velocity[2], const double tangent[2],
                                         const struct hd_lever *lever, double *anchor_m, double force_n[2]) {
    const double depth = point->depth_m - surface->lowering_m;
    double normal_n = 0.0;
    double elastic = 0.0;
    double slope_n = 0.0;
    if (depth > 0.0) {
        elastic = surface->stiffness_n_per_m * depth;
        const double whole = elastic - surface->damping_n_s_per_m * hd_dot(velocity, point->normal);
        normal_n = whole > 0.0 ? whole : 0.0;
        slope_n = elastic * surface->lowering_slope - 0.5 * surface->stiffness_slope * depth * depth;
    }
    const double drag_n = -surface->drag_n_s_per_m * hd_dot(velocity, tangent);
    const double spring_n = hd_friction(surface, normal_n, point->arc_m, anchor_m);
    force_n[0] = normal_n;
    if (lever != NULL) {
        if (lever->fade_per_m > 0.0) {
            force_n[0] += lever->fade_per_m * (elastic * surface->lowering_m / lever->fade);
        }
        slope_n *= lever->slide;
    }
    force_n[1] = drag_n + slope_n + spring_n;
    return normal_n;
}

/* Computes the force that the surface before its change would exert at the present position of the probe: the force of
 * the last tick, extrapolated by the displacement since then along the tangent plane of that tick. */
HD_RT static void compute_unchanged_force(const struct hd_context *context, const struct hd_slot *slot,
                                          double force_n[2]) {
    force_n[0] = slot->force_n[0];
    force_n[1] = slot->force_n[1];
    double step[2];
    hd_difference(context->proxy.to_m, context->proxy.from_m, step);
    if (step[0] == 0.0 && step[1] == 0.0) {
        return;
    }
    struct hd_contact_point point = slot->last;
    struct hd_surface surface = slot->surface;
    point.depth_m -= slot->offset_m;
    double tangent[2];
    double before[2];
    double after[2];
    double anchor_m = slot->anchor_m;
    hd_tangent_of(slot, point.normal, tangent);
    compute_force(&surface, &point, context->input->velocity_m_per_s, tangent, NULL, &anchor_m, before);
    const double slid_m = hd_dot(step, tangent);
    point.depth_m -= hd_dot(step, point.normal);
    point.arc_m += slid_m;
    surface.stiffness_n_per_m += slid_m * surface.stiffness_slope;
    surface.lowering_m += slid_m * surface.lowering_slope;
    compute_force(&surface, &point, context->input->velocity_m_per_s, tangent, NULL, &anchor_m, after);
    for (int axis = 0; axis < 2; axis++) {
        const double more = (after[0] - before[0]) * point.normal[axis] + (after[1] - before[1]) * tangent[axis];
        force_n[axis] += slot->ramp * more;
    }
}

HD_RT void hd_contact_force_drop(struct hd_context *context, uint32_t index) {
    double was[2];
    compute_unchanged_force(context, &context->state->slots[index], was);
    hd_contact_change(context->state, was);
    context->state->change.whole = 1;
    hd_surface_noise_change(context->state, &context->state->slots[index]);
    hd_contact_end(context->state, index, context->input->time_ns);
}

/* Returns the distance, along the last tangent, of a point from the line through the centre and the last contact point
 * on the rim: how far a probe from that line went along the surface. */
HD_RT static double offset_along(const struct hd_slot *slot, const struct hd_object *object, const double point_m[2]) {
    double offset[2];
    double tangent[2];
    hd_difference(point_m, object->point_m, offset);
    hd_tangent_of(slot, slot->last.normal, tangent);
    return hd_dot(offset, tangent);
}

/* Moves the anchor on a round surface whose contact point goes to `arc_m`, so that the spring's stretch changes by
 * `slid_m`, the motion of the probe along the surface. */
HD_RT static void move_anchor(struct hd_slot *slot, double arc_m, double slid_m) {
    slot->anchor_m += arc_m - slot->last.arc_m - slid_m;
}

HD_RT void hd_contact_force_change(struct hd_context *context, uint32_t index, const struct hd_object *object) {
    struct hd_state *state = context->state;
    struct hd_slot *slot = &state->slots[index];
    struct hd_contact_point point = slot->last;
    const int round = hd_shape_of(object)->arc_length ? 1 : 0;
    const int moved = slot->pose_version != object->pose_version;
    if (moved || round) { /* s of a round surface was computed only if its material used it */
        find_last_point(context, slot, object, moved, &point);
    }
    if (moved && hd_dot(slot->last.normal, point.normal) <= 0.0) {
        hd_contact_force_drop(context, index); /* the normal turned away: treated as removal of the object */
        return;
    }
    double was[2];
    compute_unchanged_force(context, slot, was);
    hd_contact_change(state, was);
    slot->changed = 1;
    slot->pose_version = object->pose_version;
    slot->surface_version = object->surface_version;
    if (round) {
        move_anchor(slot, point.arc_m, moved ? offset_along(slot, object, context->proxy.from_m) : 0.0);
    }
    slot->last = point;
    if (!(slot->surface.friction_coefficient > 0.0)) {
        slot->anchor_m = point.arc_m;
    }
}

HD_RT static inline int has_left(const struct hd_context *context, uint32_t index, const struct hd_object *object,
                                 const double position_m[2], const struct hd_contact_point *point) {
    const struct hd_feature feature = context->state->slots[index].feature;
    return hd_shape_is_left(&context->proxy, object, index, feature, position_m, point);
}

/* Returns the part of the path since the last tick, 0 to 1, on which a probe that has now left was still in contact. */
HD_RT static double contact_part(const struct hd_slot *slot, const struct hd_object *object,
                                 const struct hd_contact_point *point) {
    const struct hd_shape_operations *shape = hd_shape_of(object);
    double part = 1.0;
    if (!(point->depth_m > 0.0)) {
        const double rise = slot->last.depth_m - point->depth_m;
        /* 0 for a surface that was moved away: it was not pressed in this tick. */
        part = slot->last.depth_m > 0.0 && rise > 0.0 ? slot->last.depth_m / rise : 0.0;
    }
    if (shape->half_length) {
        const double end = hd_contact_until_end(slot, point, shape->half_length(object, slot->feature));
        part = end < part ? end : part;
    }
    return part;
}

HD_RT static int has_grooves(const struct hd_table *table, const struct hd_object *object) {
    return object->piece_count > 0 || table->materials[object->material].texture == HD_TEXTURE_STRIKES;
}

/* Notes the energy and the force that a spring had whose surface the probe left sideways. */
HD_RT static void free_spring(struct hd_context *context, const struct hd_slot *slot,
                              const struct hd_contact_point *point) {
    const double pressed_m = point->depth_m - slot->offset_m - slot->surface.lowering_m;
    if (pressed_m > 0.0) {
        const double force_n = slot->ramp * slot->surface.stiffness_n_per_m * pressed_m;
        context->freed_j += 0.5 * force_n * pressed_m;
        context->freed_n[0] += force_n * point->normal[0];
        context->freed_n[1] += force_n * point->normal[1];
    }
}

/* Ends a contact that the probe has left. Soon after a command the command may be the cause: it changed this surface,
 * or another one that the proxy moves along, so that the probe had left already at its last position. Then the force of
 * the contact counts as removed by the command. */
HD_RT static void release(struct hd_context *context, uint32_t index, const struct hd_object *object,
                          const struct hd_contact_point *point) {
    struct hd_slot *slot = &context->state->slots[index];
    if (slot->changed) {
        hd_surface_noise_change(context->state, slot);
        slot->changed = 0;
    } else if (hd_command_is_recent(context) && has_left(context, index, object, context->proxy.from_m, &slot->last)) {
        hd_contact_force_drop(context, index);
        return;
    } else {
        free_spring(context, slot, point);
    }
    hd_contact_end(context->state, index, context->input->time_ns);
}

/* Returns the contact that takes over next: the one with an offset along whose normal most of the freed force acts.
 * NULL: there is none. The result does not depend on the order of the contacts. */
HD_RT static struct hd_slot *next_heir(const struct hd_context *context) {
    const struct hd_state *state = context->state;
    struct hd_slot *heir = NULL;
    uint32_t index_of_heir = 0;
    double most_n = 0.0;
    for (uint32_t i = 0; i < state->active_count; i++) {
        const uint32_t index = state->active[i];
        struct hd_slot *slot = &state->slots[index];
        const double freed_n = hd_dot(context->freed_n, slot->last.normal);
        if (slot->offset_m > 0.0 && slot->ramp == 1.0 &&
            (freed_n > most_n || (heir != NULL && freed_n == most_n && index < index_of_heir))) {
            heir = slot;
            index_of_heir = index;
            most_n = freed_n;
        }
    }
    return heir;
}

HD_RT void hd_contact_force_take_over(struct hd_context *context) {
    for (uint32_t i = 0; i < context->state->active_count && context->freed_j > 0.0; i++) {
        struct hd_slot *slot = next_heir(context);
        if (slot == NULL) {
            return;
        }
        const double stiffness = slot->surface.stiffness_n_per_m;
        const double *normal = slot->last.normal;
        const double from_m = slot->last.depth_m - slot->offset_m - slot->surface.lowering_m;
        const double pressed_m = from_m > 0.0 ? from_m : 0.0;
        const double by_energy_m = hd_root(pressed_m * pressed_m + 2.0 * context->freed_j / stiffness);
        const double by_force_m = pressed_m + hd_dot(context->freed_n, normal) / stiffness;
        const double most_m = (by_energy_m < by_force_m ? by_energy_m : by_force_m) - from_m;
        const double part_m = most_m < slot->offset_m ? most_m : slot->offset_m;
        const double more_m = from_m + part_m > pressed_m ? from_m + part_m - pressed_m : 0.0;
        slot->offset_m -= part_m;
        slot->normal_n += stiffness * more_m;
        context->freed_j -= 0.5 * stiffness * more_m * (2.0 * pressed_m + more_m);
        for (int axis = 0; axis < 2; axis++) {
            const double more_n = stiffness * more_m * normal[axis];
            slot->force_n[axis] += more_n;
            context->force_n[axis] += more_n;
            context->freed_n[axis] -= more_n;
        }
    }
}

/* Fills in the travel along a round surface. At the bottom s jumps by the circumference. */
HD_RT static void find_travel_around(const struct hd_slot *slot, const struct hd_object *object,
                                     struct hd_travel *travel) {
    const double half_length_m = HD_PI * object->half_m[0];
    const double step = travel->point.arc_m - slot->last.arc_m;
    travel->half_length_m = half_length_m;
    travel->jump_m = step > half_length_m ? -2.0 * half_length_m : step < -half_length_m ? 2.0 * half_length_m : 0.0;
}

/* Returns the motion of the probe along a round surface in this tick. Along the mean of the last tangent and this one a
 * path to and fro sums up to 0. In the middle, where the bearing turns faster than the probe goes round, the last
 * tangent alone counts: the turn itself must not stretch the spring. */
HD_RT static double slid_around(const struct hd_context *context, const struct hd_slot *slot,
                                const struct hd_travel *travel, const struct hd_lever *lever) {
    double step[2];
    double tangent[2];
    hd_difference(context->proxy.to_m, context->proxy.from_m, step);
    hd_tangent_of(slot, slot->last.normal, tangent);
    const double along = hd_dot(step, tangent);
    return lever->fade > 0.0 ? 0.5 * (along + hd_dot(step, travel->tangent)) : along;
}

/* Scales the geometry by `part`, 0 to 1. */
HD_RT static void fade_geometry(struct hd_slot *slot, double part) {
    slot->surface.lowering_m *= part;
    slot->surface.lowering_slope *= part;
}

/* Adds the force of this contact, given along normal and tangent, to the sum. */
HD_RT static inline void add_force(struct hd_context *context, struct hd_slot *slot, const struct hd_travel *travel,
                                   double pressed_n[2]) {
    if (slot->ramp < 1.0) {
        pressed_n[0] *= slot->ramp;
        pressed_n[1] *= slot->ramp;
        slot->ramp += context->ramp_step;
        slot->ramp = slot->ramp < 1.0 ? slot->ramp : 1.0;
    }
    for (int axis = 0; axis < 2; axis++) {
        slot->force_n[axis] = pressed_n[0] * travel->point.normal[axis] + pressed_n[1] * travel->tangent[axis];
        context->force_n[axis] += slot->force_n[axis];
    }
}

/* Adds the noise of the dominant material, or ends the noise if that material has none. */
HD_RT static inline void add_noise(struct hd_context *context, uint32_t index,
                                   const struct hd_dominant_material *dominant, const struct hd_travel *travel,
                                   int changed) {
    struct hd_state *state = context->state;
    struct hd_slot *slot = &state->slots[index];
    if (dominant->material->texture == HD_TEXTURE_NOISE) {
        if (state->show_vibration > 0.0) {
            hd_surface_noise_sound(context, index, dominant, travel->point.normal, travel->tangent, changed);
        }
    } else if (slot->noise != 0) {
        if (changed) {
            hd_surface_noise_change(state, slot);
        }
        hd_surface_noise_end(state, slot);
    }
}

HD_RT void hd_contact_force_update(struct hd_context *context, uint32_t index, const struct hd_object *object,
                                   double fraction) {
    struct hd_slot *slot = &context->state->slots[index];
    const struct hd_shape_operations *shape = hd_shape_of(object);
    struct hd_travel travel;
    find_point(context, slot, object, fraction > 0.0, &travel.point);
    if (hd_rupture_depth_m(context, object) > 0.0 &&
        hd_rupture_happens(context, index, object, &travel.point, fraction)) {
        return;
    }
    hd_tangent_of(slot, travel.point.normal, travel.tangent);
    travel.half_length_m = HD_UNBOUNDED_M;
    travel.jump_m = 0.0;
    travel.fraction = fraction;
    travel.part = 1.0;
    struct hd_lever round;
    const struct hd_lever *lever = NULL;
    if (shape->lever) {
        find_travel_around(slot, object, &travel);
        shape->lever(object, travel.point.depth_m, &round);
        lever = &round;
        if (context->table->materials[object->material].friction_coefficient > 0.0) {
            const int met = fraction > 0.0;
            move_anchor(slot, travel.point.arc_m,
                        met ? offset_along(slot, object, context->proxy.to_m)
                            : slid_around(context, slot, &travel, lever));
        }
    }
    /* The surface properties are computed directly in the slot: copying a struct that was just written costs a third of
     * the time of a contact. */
    struct hd_dominant_material dominant;
    if (slot->seam == 0) {
        dominant = hd_surface_at(context->table, object, travel.point.arc_m, travel.half_length_m, &slot->surface);
    }
    if (lever != NULL && lever->fade < 1.0) {
        fade_geometry(slot, lever->fade);
    }
    const int grooves = has_grooves(context->table, object);
    if (has_left(context, index, object, context->proxy.to_m, &travel.point)) {
        if (grooves) {
            travel.part = contact_part(slot, object, &travel.point);
            hd_grooves_pass(context, index, object, &travel);
        }
        release(context, index, object, &travel.point);
        return;
    }
    if (slot->seam > 0) { /* not before: the next surface continues the ramp from the properties of the last tick */
        dominant = hd_seam_ease(context->table, object, travel.point.arc_m, slot);
    }

    if (slot->preloaded != 0) {
        hd_preload_follow(context, index, dominant.material, &travel.point);
    }
    if (slot->offset_m > 0.0) {
        slot->offset_m = travel.point.depth_m < slot->offset_m ? travel.point.depth_m : slot->offset_m;
        travel.point.depth_m -= slot->offset_m;
    }
    double pressed_n[2];
    const double normal_n = compute_force(&slot->surface, &travel.point, context->input->velocity_m_per_s,
                                          travel.tangent, lever, &slot->anchor_m, pressed_n);
    if (grooves) {
        hd_grooves_pass(context, index, object, &travel);
    } else if (slot->held) {
        hd_grooves_arm(slot, travel.point.arc_m, travel.half_length_m);
    }
    slot->normal_n = normal_n; /* amplitudes follow the force without its ramp */
    add_force(context, slot, &travel, pressed_n);
    const int changed = slot->changed;
    if (changed) {
        const double none[2] = {-slot->force_n[0], -slot->force_n[1]};
        hd_contact_change(context->state, none);
        slot->changed = 0;
    }
    add_noise(context, index, &dominant, &travel, changed);
    slot->last = travel.point;
    if (slot->offset_m > 0.0) {
        slot->last.depth_m += slot->offset_m;
    }
}
