/* The contact update of each object, and the order in which contacts begin. */
#include "tick/hd_narrow_phase.h"

#include "tick/hd_broad_phase.h"
#include "tick/hd_contact.h"
#include "tick/hd_contact_force.h"
#include "tick/hd_rupture.h"
#include "tick/hd_seam.h"

/* Relative tolerance of rearm_m: covers the rounding of positions that are multiples of the encoder's step. */
#define HD_REARM_ROUNDING 1e-6

/* Applies a new table to the touched objects. This precedes every new contact, because the proxy moves along them. */
HD_RT static void update_changed_contacts(struct hd_context *context) {
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

/* Gives the proxy the surfaces that are pressed at the start of the tick. */
HD_RT static void begin_proxy(struct hd_context *context) {
    const struct hd_state *state = context->state;
    context->proxy.known = 0;
    context->proxy.plane_count = 0;
    context->proxy.narrow = 0;
    for (uint32_t i = 0; i < state->active_count; i++) {
        const struct hd_contact_point *last = &state->slots[state->active[i]].last;
        hd_proxy_press(&context->proxy, state->active[i], last->depth_m, last->normal);
    }
}

/* Finds the contact point of an object that appears, or is touched again, at the position of the probe: the probe did
 * not move along its surface. */
HD_RT static void point_at_rest(const struct hd_context *context, const struct hd_object *object,
                                struct hd_feature feature, const double bearing[2], struct hd_contact_point *point) {
    const struct hd_shape_operations *shape = hd_shape_of(object);
    const double *position_m = context->input->position_m;
    shape->contact_point(object, feature, bearing, position_m, position_m, point);
    if (shape->arc_length) {
        point->arc_m = shape->arc_length(object, point->normal);
    }
}

/* Whether an object whose contact was cleared is still pressed from the same side; fills in its onset. Walls, boxes and
 * discs that contain the probe are touched without this; a membrane, or a thin box that the probe is beyond, is not. */
HD_RT static int still_pressed(struct hd_context *context, uint32_t index, const struct hd_object *object,
                               struct hd_onset *onset) {
    const struct hd_slot *slot = &context->state->slots[index];
    const struct hd_shape_operations *shape = hd_shape_of(object);
    *onset = (struct hd_onset){.silent = 1, .feature = {.side = 1, .face = slot->feature.face}};
    if (shape->membrane && hd_dot(object->normal, slot->last.normal) < 0.0) {
        onset->feature.side = -1;
    }
    point_at_rest(context, object, onset->feature, slot->last.normal, &onset->point);
    const double rupture_m = hd_rupture_depth_m(context, object);
    return onset->point.depth_m > 0.0 && !(rupture_m > 0.0 && onset->point.depth_m > rupture_m) &&
           !hd_shape_is_left(&context->proxy, object, index, onset->feature, context->proxy.to_m, &onset->point);
}

HD_RT static int is_met(struct hd_context *context, const struct hd_object *object, int fresh, struct hd_onset *onset) {
    return hd_shape_of(object)->meets(&context->proxy, object, fresh, onset);
}

/* Returns half the length of a surface; 0: it has no ends. */
HD_RT static double half_length_of(const struct hd_object *object, struct hd_feature feature) {
    const struct hd_shape_operations *shape = hd_shape_of(object);
    return shape->half_length ? shape->half_length(object, feature) : 0.0;
}

/* Whether another solid lies in front of a face next to the end at which a probe that presses nothing meets it: the
 * face is hidden, and the path passes over the seam of two flush solids. `past_end`, out: direction from the face past
 * that end. */
HD_RT static int is_hidden(const struct hd_context *context, uint32_t index, const struct hd_object *object,
                           const struct hd_onset *onset, double past_end[2]) {
    const struct hd_state *state = context->state;
    const double half_m = half_length_of(object, onset->feature);
    if (half_m == 0.0 || hd_shape_of(object)->membrane || hd_magnitude(onset->point.arc_m) < half_m - HD_SEAM_M) {
        return 0;
    }
    double front_m[2];
    hd_tangent(onset->point.normal, past_end);
    hd_between(context->proxy.from_m, context->proxy.to_m, onset->fraction, front_m);
    for (int axis = 0; axis < 2; axis++) {
        past_end[axis] *= onset->point.arc_m < 0.0 ? -1.0 : 1.0;
        front_m[axis] += HD_SEAM_M * (onset->point.normal[axis] - past_end[axis]);
    }
    for (uint32_t i = 0; i < state->candidate_count; i++) {
        const uint32_t slot = state->candidates[i].slot;
        if (slot == index || slot >= context->table->object_count) {
            continue;
        }
        const struct hd_object *other = &context->table->objects[slot];
        if (other->shape != HD_SHAPE_NONE && hd_shape_of(other)->holds(other, front_m)) {
            return 1;
        }
    }
    return 0;
}

/* Tests the path again, shifted by 2 HD_SEAM_M past the end of a hidden face: there it meets the adjacent face or none.
 */
HD_RT static int is_met_beside(struct hd_context *context, const struct hd_object *object, const double past_end[2],
                               struct hd_onset *onset) {
    struct hd_proxy *proxy = &context->proxy;
    const struct hd_proxy before = *proxy;
    for (int axis = 0; axis < 2; axis++) {
        proxy->from_m[axis] += 2.0 * HD_SEAM_M * past_end[axis];
        proxy->to_m[axis] += 2.0 * HD_SEAM_M * past_end[axis];
    }
    proxy->known = 0;
    proxy->plane_count = 0;
    const int met = is_met(context, object, 0, onset);
    *proxy = before;
    return met;
}

HD_RT static void begin_contact(struct hd_context *context, uint32_t index, const struct hd_object *object,
                                const struct hd_onset *onset) {
    hd_contact_begin(context, index, object, onset);
    hd_contact_force_update(context, index, object, onset->silent ? 1.0 : onset->fraction);
}

/* Updates an object that is not touched: if the probe meets it, its contact begins or its onset is noted. */
HD_RT static void update_untouched(struct hd_context *context, uint32_t index, const struct hd_object *object,
                                   int fresh, int resumes) {
    struct hd_slot *slot = &context->state->slots[index];
    const double rearm_m = context->table->rearm_m;
    if (slot->disarmed && rearm_m > 0.0 &&
        hd_shape_of(object)->distance(object, context->proxy.from_m) >= rearm_m * (1.0 - HD_REARM_ROUNDING)) {
        slot->disarmed = 0;
    }
    struct hd_onset onset;
    if (!(resumes && still_pressed(context, index, object, &onset)) && !is_met(context, object, fresh, &onset)) {
        return;
    }
    double past_end[2];
    if (!onset.silent && context->proxy.plane_count == 0 && is_hidden(context, index, object, &onset, past_end) &&
        !is_met_beside(context, object, past_end, &onset)) {
        return;
    }
    if (onset.stood && hd_command_is_recent(context)) {
        /* A command put the object between proxy and probe, or the proxy beyond it: the contact begins without a tap,
         * as with an object that contains the probe. */
        onset.silent = 1;
        point_at_rest(context, object, onset.feature, onset.point.normal, &onset.point);
    }
    if (!onset.silent && context->onset_count < HD_ONSETS_MAX) {
        context->onset_slots[context->onset_count] = index;
        context->onsets[context->onset_count++] = onset;
    } else {
        begin_contact(context, index, object, &onset);
    }
}

/* Updates the contact of one object. */
HD_RT static void update_object(struct hd_context *context, uint32_t index) {
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
        if (slot->touched) {
            hd_contact_force_drop(context, index);
        }
        hd_contact_take(state, index, object->generation);
        resumes = 0; /* the cleared contact was with another object */
    }
    if (slot->touched &&
        (slot->pose_version != object->pose_version || slot->surface_version != object->surface_version)) {
        hd_contact_force_change(context, index, object);
    }
    if (slot->touched) {
        hd_contact_force_update(context, index, object, 0.0);
    } else if (slot->open == state->epoch && hd_shape_of(object)->membrane) {
        hd_rupture_heal(context, index, object);
    } else {
        update_untouched(context, index, object, fresh, resumes);
    }
}

/* Corrects the onset of an object whose surface the path meets inside the solid of the onset `first`: two boxes lie
 * side by side, and the probe landed near their seam. From its landing point the proxy moves along the first surface.
 */
HD_RT static void meet_along_surface(struct hd_context *context, uint32_t index, const struct hd_onset *first,
                                     const struct hd_object *object, struct hd_onset *onset) {
    struct hd_proxy *proxy = &context->proxy;
    const struct hd_proxy before = *proxy;
    double step[2];
    hd_difference(proxy->to_m, proxy->from_m, step);
    proxy->known = 0;
    proxy->plane_count = 0;
    proxy->narrow = 0;
    hd_proxy_press(proxy, index, first->fraction * hd_dot(step, first->point.normal), first->point.normal);
    struct hd_onset again = *onset;
    if (is_met(context, object, 0, &again)) {
        double landed_m[2];
        struct hd_contact_point point;
        hd_between(proxy->from_m, proxy->to_m, first->fraction, landed_m);
        hd_shape_of(object)->contact_point(object, again.feature, again.point.normal, NULL, landed_m, &point);
        again.below_m = hd_shape_below(point.depth_m);
        *onset = again;
    }
    *proxy = before;
}

/* Whether a surface that is met at its very end continues a pressed one. Then only the pressed one exerts a force, so
 * that the two do not push at the same time. */
HD_RT static int is_continuation(const struct hd_context *context, const struct hd_object *object,
                                 const struct hd_onset *onset) {
    const struct hd_state *state = context->state;
    const struct hd_shape_operations *shape = hd_shape_of(object);
    const double half_m = half_length_of(object, onset->feature);
    if (half_m == 0.0 || hd_magnitude(onset->point.arc_m) < half_m - HD_SEAM_M) {
        return 0;
    }
    struct hd_contact_point point;
    shape->contact_point(object, onset->feature, onset->point.normal, NULL, context->input->position_m, &point);
    for (uint32_t i = 0; i < state->active_count; i++) {
        const struct hd_slot *slot = &state->slots[state->active[i]];
        const struct hd_object *other = &context->table->objects[state->active[i]];
        const double reach_m = half_m + half_length_of(other, slot->feature);
        if (hd_seam_is_flush(&point, &slot->last, reach_m)) {
            return 1;
        }
    }
    return 0;
}

/* Begins the noted contacts in the order of their onsets. */
HD_RT static void begin_contacts_in_order(struct hd_context *context) {
    const struct hd_object *objects = context->table->objects;
    const uint32_t count = context->onset_count;
    uint32_t *slots = context->onset_slots;
    struct hd_onset *onsets = context->onsets;
    double hits[HD_ONSETS_MAX][2];
    for (uint32_t i = 0; i < count; i++) {
        hd_between(context->proxy.from_m, context->proxy.to_m, onsets[i].fraction, hits[i]);
    }
    for (uint32_t done = 0; done < count; done++) {
        uint32_t first = count;
        for (uint32_t i = 0; i < count; i++) {
            if (slots[i] != HD_NO_SLOT && (first == count || onsets[i].fraction < onsets[first].fraction)) {
                first = i;
            }
        }
        const uint32_t index = slots[first];
        slots[first] = HD_NO_SLOT;
        if (is_continuation(context, &objects[index], &onsets[first])) {
            continue;
        }
        begin_contact(context, index, &objects[index], &onsets[first]);
        for (uint32_t i = 0; context->proxy.plane_count == 0 && i < count; i++) {
            if (slots[i] != HD_NO_SLOT && hd_shape_of(&objects[index])->holds(&objects[index], hits[i])) {
                meet_along_surface(context, index, &onsets[first], &objects[slots[i]], &onsets[i]);
            }
        }
    }
}

/* Updates the objects of a list that were not candidates, from the last to the first, because an update may remove its
 * object from the list. */
HD_RT static void update_unvisited(struct hd_context *context, const uint32_t *slots, uint32_t count) {
    const struct hd_state *state = context->state;
    const uint64_t now = state->tick + 1u;
    for (uint32_t i = count; i-- > 0;) {
        if (state->slots[slots[i]].visited != now) {
            update_object(context, slots[i]);
        }
    }
}

HD_RT void hd_narrow_phase(struct hd_context *context) {
    struct hd_state *state = context->state;
    context->onset_count = 0;
    context->freed_j = 0.0;
    context->freed_n[0] = 0.0;
    context->freed_n[1] = 0.0;
    if (context->new_table) {
        update_changed_contacts(context);
    }
    begin_proxy(context);
    const double reach_m = hd_broad_phase(context);
    if (state->candidate_count > HD_CANDIDATES_SORTED_MAX) {
        hd_broad_phase_gather(state, reach_m);
    }
    for (uint32_t i = 0; i < state->candidate_count; i++) {
        if (state->candidates[i].distance_m <= reach_m) {
            update_object(context, state->candidates[i].slot);
        }
    }
    update_unvisited(context, state->active, state->active_count);
    update_unvisited(context, state->healing, state->healing_count);
    for (uint32_t i = 0; i < state->resumed_count; i++) {
        if (state->slots[state->resumed[i]].visited != state->tick + 1u) {
            update_object(context, state->resumed[i]);
        }
    }
    state->resumed_count = 0;
    if (context->onset_count > 0) {
        begin_contacts_in_order(context);
    }
    if (context->freed_j > 0.0) {
        hd_contact_force_take_over(context);
    }
}
