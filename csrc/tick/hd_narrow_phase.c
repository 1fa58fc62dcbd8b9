/* The contact update of each object, and the order in which contacts begin. */
#include "tick/hd_narrow_phase.h"

#include "tick/hd_broad_phase.h"
#include "tick/hd_contact.h"
#include "tick/hd_contact_force.h"
#include "tick/hd_rupture.h"
#include "tick/hd_seam.h"

/* Of a step of the encoder, as far as its positions are rounded. */
#define HD_REARM_ROUNDING 1e-6

/* What is touched, as a new table has it, before anything is met: the proxy goes along that. */
HD_RT static void update_changed(struct hd_context *context) {
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

/* The surfaces that are pressed as the tick begins. */
HD_RT static void begin_proxy(struct hd_context *context) {
    const struct hd_state *state = context->state;
    context->proxy.known = 0;
    context->proxy.plane_count = 0;
    for (uint32_t i = 0; i < state->active_count; i++) {
        const struct hd_contact_point *last = &state->slots[state->active[i]].last;
        hd_proxy_press(&context->proxy, state->active[i], last->depth_m, last->normal);
    }
}

/* The contact point of an object that appears, or is met anew, where the probe is: it did not move along the surface.
 */
HD_RT static void point_at_rest(const struct hd_context *context, const struct hd_object *object,
                                struct hd_feature feature, const double bearing[2], struct hd_contact_point *point) {
    const struct hd_shape_operations *shape = hd_shape_of(object);
    const double *position_m = context->input->position_m;
    shape->contact_point(object, feature, bearing, position_m, position_m, point);
    if (shape->arc_length) {
        point->arc_m = shape->arc_length(object, point->normal);
    }
}

/* What was cleared under the hand and is still pressed from the same side. Walls, boxes and discs that the probe is in
 * are met without this; a membrane, or a thin box with the probe beyond it, is not. */
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

HD_RT static int meets(struct hd_context *context, const struct hd_object *object, int fresh, struct hd_onset *onset) {
    return hd_shape_of(object)->meets(&context->proxy, object, fresh, onset);
}

HD_RT static void begin(struct hd_context *context, uint32_t index, const struct hd_object *object,
                        const struct hd_onset *onset) {
    hd_contact_begin(context, index, object, onset);
    hd_contact_force_update(context, index, object, onset->silent ? 1.0 : onset->fraction);
}

/* One that is not touched: begins its contact, or notes its onset, where it is met. */
HD_RT static void update_free(struct hd_context *context, uint32_t index, const struct hd_object *object, int fresh,
                              int resumes) {
    struct hd_slot *slot = &context->state->slots[index];
    const double rearm_m = context->table->rearm_m;
    if (slot->disarmed && rearm_m > 0.0 &&
        hd_shape_of(object)->distance(object, context->proxy.from_m) >= rearm_m * (1.0 - HD_REARM_ROUNDING)) {
        slot->disarmed = 0;
    }
    struct hd_onset onset;
    if (!(resumes && still_pressed(context, index, object, &onset)) && !meets(context, object, fresh, &onset)) {
        return;
    }
    if (onset.stood && hd_command_is_recent(context)) {
        /* A command put it between proxy and probe, or brought the proxy beyond it: it is met as what the probe is in.
         */
        onset.silent = 1;
        point_at_rest(context, object, onset.feature, onset.point.normal, &onset.point);
    }
    if (!onset.silent && context->onset_count < HD_ONSETS_MAX) {
        context->onset_slots[context->onset_count] = index;
        context->onsets[context->onset_count++] = onset;
    } else {
        begin(context, index, object, &onset);
    }
}

/* The contact update of one object. */
HD_RT static void update(struct hd_context *context, uint32_t index) {
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
        resumes = 0; /* that was another object */
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
        update_free(context, index, object, fresh, resumes);
    }
}

/* A path of one segment that met `first` at `point`, and later the face of another solid within it: two boxes side by
 * side, and the probe landed on their seam. From where it landed it goes along the surface. */
HD_RT static void meet_again(struct hd_context *context, uint32_t index, const struct hd_onset *first,
                             const struct hd_object *object, struct hd_onset *onset) {
    struct hd_proxy *proxy = &context->proxy;
    const struct hd_proxy before = *proxy;
    double step[2];
    hd_difference(proxy->to_m, proxy->from_m, step);
    proxy->known = 0;
    proxy->plane_count = 0;
    hd_proxy_press(proxy, index, first->fraction * hd_dot(step, first->point.normal), first->point.normal);
    struct hd_onset again = *onset;
    if (meets(context, object, 0, &again)) {
        *onset = again;
    }
    *proxy = before;
}

/* Whether a surface that is met at its very end is the continuation of one that is pressed: then that one goes on to
 * hold, and the two do not push at once. */
HD_RT static int continues(const struct hd_context *context, const struct hd_object *object,
                           const struct hd_onset *onset) {
    const struct hd_state *state = context->state;
    const struct hd_shape_operations *shape = hd_shape_of(object);
    if (!shape->half_length ||
        hd_magnitude(onset->point.arc_m) < shape->half_length(object, onset->feature) - HD_RIM_M) {
        return 0;
    }
    struct hd_contact_point point;
    shape->contact_point(object, onset->feature, onset->point.normal, NULL, context->input->position_m, &point);
    for (uint32_t i = 0; i < state->active_count; i++) {
        if (hd_seam_is_flush(&point, &state->slots[state->active[i]].last)) {
            return 1;
        }
    }
    return 0;
}

/* Begins the contacts with all that was met, first met, first begun. */
HD_RT static void begin_in_order(struct hd_context *context) {
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
        if (continues(context, &objects[index], &onsets[first])) {
            continue;
        }
        begin(context, index, &objects[index], &onsets[first]);
        for (uint32_t i = 0; context->proxy.plane_count == 0 && i < count; i++) {
            if (slots[i] != HD_NO_SLOT && hd_shape_of(&objects[index])->holds(&objects[index], hits[i])) {
                meet_again(context, index, &onsets[first], &objects[slots[i]], &onsets[i]);
            }
        }
    }
}

/* Those of a list that were not candidates. From the last to the first: an update may take its own out of the list. */
HD_RT static void update_others(struct hd_context *context, const uint32_t *slots, uint32_t count) {
    const struct hd_state *state = context->state;
    const uint64_t now = state->tick + 1u;
    for (uint32_t i = count; i-- > 0;) {
        if (state->slots[slots[i]].visited != now) {
            update(context, slots[i]);
        }
    }
}

HD_RT void hd_narrow_phase(struct hd_context *context) {
    struct hd_state *state = context->state;
    context->onset_count = 0;
    if (context->new_table) {
        update_changed(context);
    }
    begin_proxy(context);
    const double reach_m = hd_broad_phase(context);
    for (uint32_t i = 0; i < state->candidate_count; i++) {
        if (state->candidates[i].distance_m <= reach_m) {
            update(context, state->candidates[i].slot);
        }
    }
    update_others(context, state->active, state->active_count);
    update_others(context, state->healing, state->healing_count);
    for (uint32_t i = 0; i < state->resumed_count; i++) {
        if (state->slots[state->resumed[i]].visited != state->tick + 1u) {
            update(context, state->resumed[i]);
        }
    }
    state->resumed_count = 0;
    if (context->onset_count > 0) {
        begin_in_order(context);
    }
}
