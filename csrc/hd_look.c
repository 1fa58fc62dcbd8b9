/* One object in one tick: met, pressed, let go, healed. */
#include "hd_contact.h"

HD_RT static int meets(struct hd_walk *walk, const struct hd_object *object, int fresh, struct hd_onset *onset) {
    switch (object->shape) {
    case HD_SHAPE_WALL:
        return hd_wall_meets(walk, object, fresh, onset);
    case HD_SHAPE_MEMBRANE:
        return hd_membrane_meets(walk, object, fresh, onset);
    case HD_SHAPE_BOX:
        return hd_box_meets(walk, object, fresh, onset);
    default:
        return hd_disc_meets(walk, object, fresh, onset);
    }
}

/* A punctured membrane: closes when the probe is back on the side that it came from. */
HD_RT static void heal(struct hd_walk *walk, uint32_t index, const struct hd_object *object) {
    const struct hd_slot *slot = &walk->state->slots[index];
    if (walk->table->materials[object->material].heals) {
        double offset[2];
        hd_difference(walk->input->position_m, object->point_m, offset);
        const double height = hd_dot(offset, object->normal);
        /* The normal may have been turned over since: the side is that of the contact's own. */
        if (height * hd_dot(object->normal, slot->last.normal) > 0.0) {
            hd_contact_close(walk->state, index);
        }
    }
}

/* What was cleared under the hand and is still pressed from the same side. Walls, boxes and discs that the probe is in
 * are met without this; a membrane, or a thin box with the probe beyond it, is not. */
HD_RT static int still_pressed(struct hd_walk *walk, uint32_t index, const struct hd_object *object,
                               struct hd_onset *onset) {
    const struct hd_slot *slot = &walk->state->slots[index];
    const double *position = walk->input->position_m;
    *onset = (struct hd_onset){.silent = 1, .side = 1, .face = slot->face};
    switch (object->shape) {
    case HD_SHAPE_WALL:
        hd_wall_place(object, position, &onset->place);
        return onset->place.depth_m > 0.0;
    case HD_SHAPE_MEMBRANE: {
        onset->side = hd_dot(object->normal, slot->last.normal) < 0.0 ? -1 : 1;
        hd_membrane_place(object, onset->side, position, &onset->place);
        const double limit = walk->table->materials[object->material].rupture_depth_m;
        return onset->place.depth_m > 0.0 && (limit == 0.0 || onset->place.depth_m <= limit) &&
               !hd_membrane_left(walk, object, index, &onset->place);
    }
    case HD_SHAPE_BOX:
        hd_box_place(object, slot->face, position, &onset->place);
        return !hd_box_left(walk, object, index, slot->face, &onset->place);
    default:
        hd_disc_place(object, slot->last.normal, 0.0, 1, position, &onset->place);
        return !hd_disc_left(walk, object, index, &onset->place);
    }
}

HD_RT void hd_look(struct hd_walk *walk, uint32_t index) {
    struct hd_state *state = walk->state;
    struct hd_slot *slot = &state->slots[index];
    const int64_t time_ns = walk->input->time_ns;
    const int resumes = slot->resume;
    slot->looked = state->tick + 1u;
    slot->resume = 0;
    if (index >= walk->table->object_count || walk->table->objects[index].shape == HD_SHAPE_NONE) {
        if (slot->touched) {
            hd_contact_drop(state, index, time_ns);
        }
        hd_contact_close(state, index);
        return;
    }
    const struct hd_object *object = &walk->table->objects[index];
    int fresh = walk->resync;
    if (slot->generation != object->generation) {
        fresh |= walk->new_table;
        hd_contact_take(state, index, object->generation, time_ns);
    }
    if (slot->touched) {
        if (hd_touch(walk, index, object, 0.0)) {
            return;
        }
        fresh = 1; /* it turned its back: it went, and another came */
    }
    if (object->shape == HD_SHAPE_MEMBRANE && slot->open == state->epoch) {
        heal(walk, index, object);
        return;
    }
    struct hd_onset onset = {.silent = 0};
    if ((resumes && still_pressed(walk, index, object, &onset)) || meets(walk, object, fresh, &onset)) {
        hd_contact_begin(walk, index, object, &onset);
        hd_touch(walk, index, object, onset.silent ? 1.0 : onset.fraction);
    }
}
