/* Membranes that rupture: the time of the rupture, its strike, and healing. */
#include "tick/hd_rupture.h"

#include "tick/hd_aim.h"
#include "tick/hd_contact.h"
#include "tick/hd_surface_noise.h"

/* Reports the puncture and strikes the mode of the rupture. */
HD_RT static void strike_rupture(struct hd_context *context, uint32_t index, const struct hd_material *material,
                                 const double normal[2], double fraction) {
    struct hd_state *state = context->state;
    const struct hd_slot *slot = &state->slots[index];
    const struct hd_input *input = context->input;
    struct hd_event *event = hd_event_add_at(state, HD_EVENT_PUNCTURE, input->time_ns, index);
    struct hd_strike strike = {
        .mode = &material->rupture,
        .slot = index,
        .generation = slot->generation,
        .use = HD_MODE_RUPTURE,
        .event = hd_event_index(state, event),
        .units = 1.0,
        .before_s = hd_before_tick(context, fraction),
        .bare = slot->changed,
    };
    event->before_tick_s = strike.before_s;
    event->speed_m_per_s = -hd_dot(input->velocity_m_per_s, normal);
    event->true_speed_m_per_s = -hd_dot(input->true_velocity_m_per_s, normal);
    event->amplitude_m_per_s2 = material->rupture.amplitude_per_unit;
    event->value = material->rupture_depth_m;
    hd_aim_strike(state, slot, material->rupture_aim, normal, &strike);
}

HD_RT int hd_rupture_happens(struct hd_context *context, uint32_t index, const struct hd_object *object,
                             const struct hd_contact_point *point, double fraction) {
    struct hd_state *state = context->state;
    struct hd_slot *slot = &state->slots[index];
    const struct hd_material *material = &context->table->materials[object->material];
    const double limit_m = material->rupture_depth_m;
    const double half_length_m = hd_shape_of(object)->half_length(object, slot->feature);
    const double leaves = hd_contact_until_end(slot, point, half_length_m);
    const double from_m = slot->last.depth_m;
    const double deepest_m = from_m + leaves * (point->depth_m - from_m);
    if (!(deepest_m > limit_m)) {
        return 0;
    }
    /* If a command put the probe beyond the rupture depth, the rupture is at the end of the tick: its mode starts at 0.
     */
    const double part = from_m < limit_m ? (limit_m - from_m) / (point->depth_m - from_m) : slot->changed ? 1.0 : 0.0;
    strike_rupture(context, index, material, point->normal, fraction + (1.0 - fraction) * part);
    if (slot->changed) {
        hd_surface_noise_change(state, slot);
        slot->changed = 0;
    }
    slot->last = *point; /* hd_rupture_heal takes the side of the probe from its normal */
    slot->open = state->epoch;
    if (material->heals) {
        state->healing[state->healing_count++] = index;
        slot->healing_index = state->healing_count;
    }
    hd_contact_end(state, index, context->input->time_ns);
    return 1;
}

HD_RT void hd_rupture_heal(struct hd_context *context, uint32_t index, const struct hd_object *object) {
    const struct hd_slot *slot = &context->state->slots[index];
    if (context->table->materials[object->material].heals) {
        double offset[2];
        hd_difference(context->input->position_m, object->point_m, offset);
        const double height = hd_dot(offset, object->normal);
        /* The object's normal may have been reversed since; the normal of the contact defines the side. */
        if (height * hd_dot(object->normal, slot->last.normal) > 0.0) {
            hd_contact_close(context->state, index);
        }
    }
}
