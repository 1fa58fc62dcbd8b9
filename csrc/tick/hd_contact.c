/* Contacts: one life cycle for every shape.
 *
 *   free --onset--> touched            the tap is struck, the force acts at once
 *   free --inside--> touched           no tap; after a jump or a stall the force ramps up, where solids overlap it
 *                                      rises with further depth (hd_contact_force.c)
 *   free --appeared--> touched         no tap (the object is new, was moved or reset)
 *   touched --changed--> touched       the new parameters apply at once, the state stays (hd_contact_force.c)
 *   touched --released--> free         the probe left
 *   touched --dropped--> free          the object was removed while it was touched
 *
 * Changes of the force by commands are recorded (struct hd_change) and come in over the ramp (hd_ramp.h). A surface
 * that is moved far along itself still pulls the hand along, with at most mu F_n. */
#include "tick/hd_contact.h"

#include "tick/hd_preload.h"
#include "tick/hd_seam.h"
#include "tick/hd_surface_noise.h"
#include "tick/hd_tap.h"

HD_RT void hd_contact_close(struct hd_state *state, uint32_t index) {
    struct hd_slot *slot = &state->slots[index];
    slot->open = 0;
    if (slot->healing_index != 0) {
        const uint32_t last = state->healing[--state->healing_count];
        state->healing[slot->healing_index - 1u] = last;
        state->slots[last].healing_index = slot->healing_index;
        slot->healing_index = 0;
    }
}

HD_RT void hd_contact_take(struct hd_state *state, uint32_t index, uint32_t generation) {
    struct hd_slot *slot = &state->slots[index];
    hd_contact_close(state, index);
    /* A mode of the former owner continues to ring, no longer linked to the slot. */
    *slot = (struct hd_slot){.generation = generation, .visited = slot->visited};
}

/* Continues the ramp of the surface along which the probe came. */
HD_RT static void continue_ramp(const struct hd_context *context, struct hd_slot *slot) {
    for (uint32_t i = 0; i < context->proxy.plane_count; i++) {
        const double pressed = context->state->slots[context->proxy.plane[i].slot].ramp;
        slot->ramp = pressed < slot->ramp ? pressed : slot->ramp;
    }
}

HD_RT static void begin_touch(struct hd_context *context, uint32_t index, const struct hd_object *object,
                              const struct hd_onset *onset) {
    struct hd_state *state = context->state;
    struct hd_slot *slot = &state->slots[index];
    slot->touched = 1;
    state->touches++;
    slot->active_index = state->active_count;
    state->active[state->active_count++] = index;
    slot->feature = onset->feature;
    slot->last = onset->point;
    slot->pose_version = object->pose_version;
    slot->surface_version = object->surface_version;
    slot->changed = onset->silent && !context->resync && hd_command_is_recent(context);
    state->change.whole |= slot->changed;
    slot->offset_m = slot->changed || context->resync ? 0.0 : onset->below_m;
    /* While the command is off, the contact needs no separate ramp: the ramp of the command covers it. */
    slot->ramp = onset->silent && !slot->changed && state->gain > 0.0 && slot->offset_m == 0.0 ? 0.0 : 1.0;
    slot->anchor_m = onset->point.arc_m;
    slot->seam = 0;
    if (onset->slid && !onset->silent) {
        continue_ramp(context, slot);
        hd_seam_cross(context, slot, object);
    }
    slot->normal_n = 0.0;
    slot->grooves = 0;
    slot->contacts++;
}

HD_RT void hd_contact_begin(struct hd_context *context, uint32_t index, const struct hd_object *object,
                            const struct hd_onset *onset) {
    const struct hd_input *input = context->input;
    begin_touch(context, index, object, onset);
    const double before_s = onset->silent ? 0.0 : hd_before_tick(context, onset->fraction);
    const double approach = -hd_dot(input->velocity_m_per_s, onset->point.normal);
    struct hd_event *event = hd_event_add_at(context->state, HD_EVENT_CONTACT, input->time_ns, index);
    event->code = onset->silent ? HD_CONTACT_SILENT : 0;
    event->before_tick_s = before_s;
    event->speed_m_per_s = approach;
    event->true_speed_m_per_s = -hd_dot(input->true_velocity_m_per_s, onset->point.normal);
    const int disarmed = context->state->slots[index].disarmed && context->table->rearm_m > 0.0;
    if (!onset->silent && !onset->slid && approach > 0.0 && !disarmed) {
        hd_tap_strike(context, index, object, &onset->point, before_s, approach, event);
    }
}

HD_RT void hd_contact_end(struct hd_state *state, uint32_t index, int64_t time_ns) {
    struct hd_slot *slot = &state->slots[index];
    const uint32_t last = state->active[--state->active_count];
    state->active[slot->active_index] = last;
    state->slots[last].active_index = slot->active_index;
    slot->touched = 0;
    slot->disarmed = 1;
    if (slot->kept) {
        hd_preload_end(state, index);
    }
    state->touches++;
    slot->force_n[0] = 0.0;
    slot->force_n[1] = 0.0;
    hd_surface_noise_end(state, slot);
    hd_event_add_at(state, HD_EVENT_RELEASE, time_ns, index);
}

HD_RT void hd_contact_change(struct hd_state *state, const double force_n[2]) {
    state->change.object_n[0] += force_n[0];
    state->change.object_n[1] += force_n[1];
    state->change.any = 1;
}

HD_RT void hd_contact_clear(struct hd_state *state, uint32_t index, int64_t time_ns) {
    struct hd_slot *slot = &state->slots[index];
    hd_contact_change(state, slot->force_n);
    state->change.whole = 1;
    hd_surface_noise_change(state, slot);
    hd_contact_end(state, index, time_ns);
    if (!slot->resume) {
        slot->resume = 1;
        state->resumed[state->resumed_count++] = index;
    }
}
