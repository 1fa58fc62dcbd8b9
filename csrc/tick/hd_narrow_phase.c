/* One object in one tick: met, pressed, let go, healed. */
#include "tick/hd_contact.h"
#include "tick/hd_seam.h"

/* Of a step of the encoder, as far as its positions are rounded. */
#define HD_REARM_ROUNDING 1e-6

HD_RT void hd_look_changed(struct hd_context *context) {
    const struct hd_table *table = context->table;
    const struct hd_state *state = context->state;
    for (uint32_t i = state->active_count; i-- > 0;) {
        const uint32_t index = state->active[i];
        const struct hd_slot *slot = &state->slots[index];
        const struct hd_object *object = index < table->object_count ? &table->objects[index] : NULL;
        if (object == NULL || object->shape == HD_SHAPE_NONE || object->generation != slot->generation) {
            hd_contact_force_drop(context, index);
        } else if (object->pose_version != slot->pose_version || object->surface_version != slot->surface_version) {
            hd_contact_force_change(context, index, object);
        }
    }
}

HD_RT static int meets(struct hd_context *context, const struct hd_object *object, int fresh, struct hd_onset *onset) {
    switch (object->shape) {
    case HD_SHAPE_WALL:
        return hd_wall_meets(context, object, fresh, onset);
    case HD_SHAPE_MEMBRANE:
        return hd_membrane_meets(context, object, fresh, onset);
    case HD_SHAPE_BOX:
        return hd_box_meets(context, object, fresh, onset);
    default:
        return hd_disc_meets(context, object, fresh, onset);
    }
}

/* A punctured membrane: closes when the probe is back on the side that it came from. */
HD_RT static void heal(struct hd_context *context, uint32_t index, const struct hd_object *object) {
    const struct hd_slot *slot = &context->state->slots[index];
    if (context->table->materials[object->material].heals) {
        double offset[2];
        hd_difference(context->input->position_m, object->point_m, offset);
        const double height = hd_dot(offset, object->normal);
        /* The normal may have been turned over since: the side is that of the contact's own. */
        if (height * hd_dot(object->normal, slot->last.normal) > 0.0) {
            hd_contact_close(context->state, index);
        }
    }
}

/* What was cleared under the hand and is still pressed from the same side. Walls, boxes and discs that the probe is in
 * are met without this; a membrane, or a thin box with the probe beyond it, is not. */
HD_RT static int still_pressed(struct hd_context *context, uint32_t index, const struct hd_object *object,
                               struct hd_onset *onset) {
    const struct hd_slot *slot = &context->state->slots[index];
    const double *position = context->input->position_m;
    *onset = (struct hd_onset){.silent = 1, .side = 1, .face = slot->face};
    switch (object->shape) {
    case HD_SHAPE_WALL:
        hd_wall_place(object, position, &onset->point);
        return onset->point.depth_m > 0.0;
    case HD_SHAPE_MEMBRANE: {
        onset->side = hd_dot(object->normal, slot->last.normal) < 0.0 ? -1 : 1;
        hd_membrane_place(object, onset->side, position, &onset->point);
        const double limit = context->table->materials[object->material].rupture_depth_m;
        return onset->point.depth_m > 0.0 && (limit == 0.0 || onset->point.depth_m <= limit) &&
               !hd_membrane_left(context, object, index, position, &onset->point);
    }
    case HD_SHAPE_BOX:
        hd_box_place(object, slot->face, position, &onset->point);
        return !hd_box_left(context, object, index, slot->face, position, &onset->point);
    default:
        hd_disc_place(object, slot->last.normal, 0.0, 1, position, &onset->point);
        return !hd_disc_left(context, object, index, position, &onset->point);
    }
}

/* What lay between proxy and probe already, soon after a command: that put it there, or brought the surface
 * point beyond it. It is met as what the probe is in. */
HD_RT static void meet_standing(const struct hd_context *context, const struct hd_object *object,
                                struct hd_onset *onset) {
    const double *position = context->input->position_m;
    const double bearing[2] = {onset->point.normal[0], onset->point.normal[1]};
    onset->silent = 1;
    switch (object->shape) {
    case HD_SHAPE_MEMBRANE:
        hd_membrane_place(object, onset->side, position, &onset->point);
        break;
    case HD_SHAPE_BOX:
        hd_box_place(object, onset->face, position, &onset->point);
        break;
    default:
        hd_disc_place(object, bearing, 0.0, 1, position, &onset->point);
        break;
    }
}

/* How far a point is outside of a surface, at least. */
HD_RT static double distance_from(const struct hd_object *object, const double point_m[2]) {
    double offset[2];
    double tangent[2];
    hd_difference(point_m, object->point_m, offset);
    hd_tangent(object->normal, tangent);
    const double height = hd_dot(offset, object->normal);
    const double beside = hd_magnitude(hd_dot(offset, tangent)) - object->half_m[0];
    switch (object->shape) {
    case HD_SHAPE_WALL:
        return height;
    case HD_SHAPE_MEMBRANE:
        return hd_magnitude(height) > beside ? hd_magnitude(height) : beside;
    case HD_SHAPE_BOX: {
        const double above = hd_magnitude(height) - object->half_m[1];
        return above > beside ? above : beside;
    }
    default:
        return hd_root(hd_dot(offset, offset)) - object->half_m[0];
    }
}

HD_RT static void begin(struct hd_context *context, uint32_t index, const struct hd_object *object,
                        const struct hd_onset *onset) {
    hd_contact_begin(context, index, object, onset);
    hd_contact_force_update(context, index, object, onset->silent ? 1.0 : onset->fraction);
}

HD_RT void hd_look(struct hd_context *context, uint32_t index) {
    struct hd_state *state = context->state;
    struct hd_slot *slot = &state->slots[index];
    int resumes = slot->resume;
    slot->visited = state->tick + 1u;
    slot->resume = 0;
    if (index >= context->table->object_count || context->table->objects[index].shape == HD_SHAPE_NONE) {
        if (slot->touched) {
            hd_contact_force_drop(context, index);
        }
        hd_contact_close(state, index);
        return;
    }
    const struct hd_object *object = &context->table->objects[index];
    int fresh = context->resync;
    if (slot->generation != object->generation) {
        fresh |= context->new_table;
        hd_contact_take(context, index, object->generation);
        resumes = 0; /* that was another object */
    }
    if (slot->touched &&
        (slot->pose_version != object->pose_version || slot->surface_version != object->surface_version)) {
        hd_contact_force_change(context, index, object);
    }
    if (slot->touched) {
        hd_contact_force_update(context, index, object, 0.0);
        return;
    }
    if (object->shape == HD_SHAPE_MEMBRANE && slot->open == state->epoch) {
        heal(context, index, object);
        return;
    }
    const double rearm_m = context->table->rearm_m;
    if (slot->disarmed && rearm_m > 0.0 &&
        distance_from(object, context->from_m) >= rearm_m * (1.0 - HD_REARM_ROUNDING)) {
        slot->disarmed = 0;
    }
    struct hd_onset onset = {.silent = 0};
    if ((resumes && still_pressed(context, index, object, &onset)) || meets(context, object, fresh, &onset)) {
        if (onset.stood && hd_walk_is_unsettled(context)) {
            meet_standing(context, object, &onset);
        }
        if (!onset.silent && context->met_count < HD_WALK_MET) {
            context->met[context->met_count++] = index;
        } else {
            begin(context, index, object, &onset);
        }
    }
}

/* Whether a solid holds a point, its rim included. */
HD_RT static int holds(const struct hd_object *object, const double point_m[2]) {
    double offset[2];
    double tangent[2];
    hd_difference(point_m, object->point_m, offset);
    hd_tangent(object->normal, tangent);
    const double *half = object->half_m;
    switch (object->shape) {
    case HD_SHAPE_WALL:
        return hd_dot(offset, object->normal) <= HD_RIM_M;
    case HD_SHAPE_MEMBRANE:
        return 0;
    case HD_SHAPE_BOX:
        return hd_magnitude(hd_dot(offset, tangent)) <= half[0] + HD_RIM_M &&
               hd_magnitude(hd_dot(offset, object->normal)) <= half[1] + HD_RIM_M;
    default:
        return hd_root(hd_dot(offset, offset)) <= half[0] + HD_RIM_M;
    }
}

/* A way of one leg that met `first` at `place`, and later the face of another solid within it: two boxes side by side,
 * and the probe landed on their seam. From where it landed it goes along the surface. */
HD_RT static void meet_anew(struct hd_context *context, uint32_t index, const struct hd_contact_point *point,
                            double fraction, const struct hd_object *object, struct hd_onset *onset) {
    struct hd_proxy *path = &context->path;
    const struct hd_proxy before = *path;
    double way[2];
    hd_difference(context->input->position_m, context->from_m, way);
    path->known = 0;
    path->plane[0].slot = index;
    path->plane[0].depth_m = fraction * hd_dot(way, point->normal);
    path->plane[0].normal[0] = point->normal[0];
    path->plane[0].normal[1] = point->normal[1];
    path->plane_count = 1;
    struct hd_onset again = *onset;
    if (meets(context, object, 0, &again)) {
        *onset = again;
    }
    *path = before;
}

/* Whether a surface that is met at its very end is the continuation of one that is pressed: then that one goes on to
 * hold, and the two do not push at once. */
HD_RT static int continues(const struct hd_context *context, const struct hd_object *object,
                           const struct hd_onset *onset) {
    const struct hd_state *state = context->state;
    if (object->shape != HD_SHAPE_BOX && object->shape != HD_SHAPE_MEMBRANE) {
        return 0;
    }
    const double half = object->half_m[object->shape == HD_SHAPE_BOX && onset->face % 2 != 0 ? 1 : 0];
    if (hd_magnitude(onset->point.arc_m) < half - HD_RIM_M) {
        return 0;
    }
    struct hd_contact_point point;
    if (object->shape == HD_SHAPE_BOX) {
        hd_box_place(object, onset->face, context->input->position_m, &point);
    } else {
        hd_membrane_place(object, onset->side, context->input->position_m, &point);
    }
    for (uint32_t i = 0; i < state->active_count; i++) {
        if (hd_flush(&point, &state->slots[state->active[i]].last)) {
            return 1;
        }
    }
    return 0;
}

HD_RT void hd_look_begin(struct hd_context *context) {
    const struct hd_object *objects = context->table->objects;
    const uint32_t count = context->met_count;
    struct hd_onset onsets[HD_WALK_MET];
    double hits[HD_WALK_MET][2];
    for (uint32_t i = 0; i < count; i++) {
        onsets[i] = (struct hd_onset){.silent = 0}; /* no shape sets all of it */
        meets(context, &objects[context->met[i]], 0, &onsets[i]);
        hd_between(context->from_m, context->input->position_m, onsets[i].fraction, hits[i]);
    }
    for (uint32_t done = 0; done < count; done++) {
        uint32_t first = count;
        for (uint32_t i = 0; i < count; i++) {
            if (context->met[i] != HD_NO_SLOT && (first == count || onsets[i].fraction < onsets[first].fraction)) {
                first = i;
            }
        }
        const uint32_t index = context->met[first];
        context->met[first] = HD_NO_SLOT;
        if (continues(context, &objects[index], &onsets[first])) {
            continue;
        }
        begin(context, index, &objects[index], &onsets[first]);
        for (uint32_t i = 0; context->path.plane_count == 0 && i < count; i++) {
            if (context->met[i] != HD_NO_SLOT && holds(&objects[index], hits[i])) {
                meet_anew(context, index, &onsets[first].point, onsets[first].fraction, &objects[context->met[i]],
                          &onsets[i]);
            }
        }
    }
}
