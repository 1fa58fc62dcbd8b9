/* Contacts: one life cycle for every kind of surface.
 *
 *   free --onset--> touched            the tap is struck, force at once
 *   free --met inside--> touched       silent, force over the ramp (appeared, forces came on, jump, stall)
 *   touched --surface changed--> touched   the parameters move to the new ones over the ramp, the state stays
 *   touched --let go--> free           the probe left
 *   touched --dropped--> free          the object went away under the hand: its last force fades out over the ramp
 *
 * So no message, however timed, steps the force by more than the ramp allows. */
#include "hd_contact.h"

#include <math.h>

#include "hd_voice.h"

HD_RT static double later(double time_s) {
    return time_s > 0.0 ? time_s : 0.0;
}

HD_RT struct hd_slot *hd_contact_take(struct hd_walk *walk, const struct hd_key *key) {
    struct hd_state *state = walk->state;
    struct hd_slot *slot = &state->slots[key->slot];
    if (slot->touched) {
        hd_contact_drop(walk, key->slot);
    }
    /* A mode of the former owner goes on ringing on its own. */
    *slot = (struct hd_slot){.generation = key->generation, .version = key->version - 1u}; /* no surface seen yet */
    return slot;
}

HD_RT void hd_contact_begin(struct hd_walk *walk, struct hd_slot *slot, const struct hd_key *key,
                            const struct hd_surface *surface, const struct hd_mode *tap, const struct hd_onset *onset) {
    struct hd_state *state = walk->state;
    slot->touched = 1;
    slot->active_index = state->active_count;
    state->active[state->active_count++] = key->slot;
    slot->now = *surface;
    slot->version = key->version;
    slot->blend = 1.0;
    /* While the whole command is off, the contact needs no ramp of its own: the command's covers it. */
    slot->ramp = onset->silent && state->gain > 0.0 ? 0.0 : 1.0;
    const double approach = -hd_dot(walk->input->velocity_m_per_s, onset->direction);
    const uint32_t event = hd_state_event(state, HD_EVENT_CONTACT, walk->input->time_ns);
    struct hd_event *report = event < HD_EVENT_CAPACITY ? &state->events[event] : NULL;
    if (report != NULL) {
        report->slot = key->slot;
        report->generation = key->generation;
        report->code = onset->silent ? HD_CONTACT_SILENT : 0;
        report->before_tick_s = onset->before_s;
        report->speed_m_per_s = approach;
        report->true_speed_m_per_s = -hd_dot(walk->input->true_velocity_m_per_s, onset->direction);
    }
    if (onset->silent || !(approach > 0.0)) {
        return;
    }
    if (report != NULL) {
        report->amplitude_m_per_s2 = tap->amplitude_per_unit * approach;
    }
    const struct hd_strike strike = {
        .mode = tap,
        .slot = key->slot,
        .generation = key->generation,
        .use = HD_MODE_TAP,
        .event = event,
        .units = approach,
        .before_s = onset->before_s,
        .growth_n = surface->stiffness_n_per_m * approach * later(tap->peak_time_s - onset->before_s),
        .direction = {onset->direction[0], onset->direction[1]},
    };
    hd_strike_add(state, &strike);
}

HD_RT void hd_contact_end(struct hd_state *state, uint32_t slot_index, int64_t time_ns) {
    struct hd_slot *slot = &state->slots[slot_index];
    const uint32_t last = state->active[--state->active_count];
    state->active[slot->active_index] = last;
    state->slots[last].active_index = slot->active_index;
    slot->touched = 0;
    slot->force_n[0] = 0.0;
    slot->force_n[1] = 0.0;
    const uint32_t event = hd_state_event(state, HD_EVENT_RELEASE, time_ns);
    if (event < HD_EVENT_CAPACITY) {
        state->events[event].slot = slot_index;
        state->events[event].generation = slot->generation;
    }
}

HD_RT void hd_contact_drop(struct hd_walk *walk, uint32_t slot_index) {
    struct hd_state *state = walk->state;
    const struct hd_slot *slot = &state->slots[slot_index];
    const double ticks = walk->table->ramp_s / walk->table->period_s;
    state->residual_left = ticks < 1.0 ? 1u : ticks > 1e6 ? 1000000u : (uint32_t)ticks;
    for (int axis = 0; axis < 2; axis++) {
        state->residual_n[axis] += state->show_force * slot->force_n[axis];
        state->residual_step_n[axis] = state->residual_n[axis] / (double)state->residual_left;
    }
    hd_contact_end(state, slot_index, walk->input->time_ns);
}

HD_RT void hd_contact_follow(struct hd_walk *walk, struct hd_slot *slot, const struct hd_key *key,
                             const struct hd_surface *surface) {
    if (slot->version != key->version) {
        if (hd_dot(slot->now.normal, surface->normal) <= 0.0) {
            /* It turned its back on the probe: there is no way in between, so it went and another came. */
            hd_contact_drop(walk, key->slot);
            slot->known = 0;
            slot->last_side = 0;
            return;
        }
        slot->version = key->version;
        slot->from = slot->now;
        slot->blend = 0.0;
    }
    if (slot->blend >= 1.0) {
        return;
    }
    slot->blend += walk->ramp_step;
    if (slot->blend >= 1.0) {
        slot->now = *surface;
        return;
    }
    const double b = slot->blend;
    const double a = 1.0 - b;
    const struct hd_surface *from = &slot->from;
    for (int axis = 0; axis < 2; axis++) {
        slot->now.normal[axis] = a * from->normal[axis] + b * surface->normal[axis];
    }
    HD_RT_FOREIGN_BEGIN
    const double length = sqrt(hd_dot(slot->now.normal, slot->now.normal));
    HD_RT_FOREIGN_END
    for (int axis = 0; axis < 2; axis++) {
        slot->now.normal[axis] /= length; /* at least sqrt(1/2): the two are at most a right angle apart */
    }
    /* Height and place along it are blended where the probe is: the points themselves may lie anywhere. */
    const double *p = walk->input->position_m;
    const double off[2] = {p[0] - from->point_m[0], p[1] - from->point_m[1]};
    const double on[2] = {p[0] - surface->point_m[0], p[1] - surface->point_m[1]};
    const double height = a * hd_dot(off, from->normal) + b * hd_dot(on, surface->normal);
    const double along = a * (off[0] * from->normal[1] - off[1] * from->normal[0]) +
                         b * (on[0] * surface->normal[1] - on[1] * surface->normal[0]);
    slot->now.point_m[0] = p[0] - height * slot->now.normal[0] - along * slot->now.normal[1];
    slot->now.point_m[1] = p[1] - height * slot->now.normal[1] + along * slot->now.normal[0];
    slot->now.stiffness_n_per_m = a * from->stiffness_n_per_m + b * surface->stiffness_n_per_m;
    slot->now.damping_n_s_per_m = a * from->damping_n_s_per_m + b * surface->damping_n_s_per_m;
    slot->now.half_width_m = a * from->half_width_m + b * surface->half_width_m;
    slot->now.rupture_depth_m = surface->rupture_depth_m;
}

HD_RT void hd_contact_push(struct hd_walk *walk, struct hd_slot *slot, double depth_m, const double direction[2]) {
    const double approach = -hd_dot(walk->input->velocity_m_per_s, direction);
    double force = slot->now.stiffness_n_per_m * depth_m + slot->now.damping_n_s_per_m * approach;
    force = force > 0.0 ? force : 0.0;
    if (slot->ramp < 1.0) {
        force *= slot->ramp;
        slot->ramp += walk->ramp_step;
        slot->ramp = slot->ramp < 1.0 ? slot->ramp : 1.0;
    }
    slot->force_n[0] = force * direction[0];
    slot->force_n[1] = force * direction[1];
    walk->force_n[0] += slot->force_n[0];
    walk->force_n[1] += slot->force_n[1];
    slot->seen_tick = walk->state->tick;
}

HD_RT void hd_strike_add(struct hd_state *state, const struct hd_strike *strike) {
    const int heard = state->gain > 0.0 && state->show_vibration > 0.0;
    if (heard && strike->mode->force_per_unit > 0.0 && state->strike_count < HD_STRIKE_CAPACITY) {
        state->strikes[state->strike_count++] = *strike;
    }
}

HD_RT double hd_strikes_apply(struct hd_state *state, const struct hd_table *table, double contact_force_n) {
    double wanted = 0.0;
    double growth = 0.0;
    for (uint32_t i = 0; i < state->strike_count; i++) {
        const struct hd_strike *strike = &state->strikes[i];
        wanted += strike->units * strike->mode->force_per_unit * strike->mode->peak;
        growth += state->show_force * strike->growth_n;
    }
    const double room = table->max_force_n - contact_force_n - growth - hd_voices_bound(state);
    const double scale = wanted <= room ? 1.0 : room > 0.0 ? room / wanted : 0.0;
    for (uint32_t i = 0; i < state->strike_count; i++) {
        const struct hd_strike *strike = &state->strikes[i];
        const double force = strike->units * strike->mode->force_per_unit * scale;
        const double vector[2] = {force * strike->direction[0], force * strike->direction[1]};
        hd_voices_strike(state, strike, vector, table->period_s);
        if (strike->event < state->event_count) {
            state->events[strike->event].scale = scale;
        }
        state->strikes_total++;
    }
    state->strike_count = 0;
    return scale;
}
