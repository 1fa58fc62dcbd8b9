/* Contacts: one life cycle for every shape.
 *
 *   free --onset--> touched            the tap is struck, force at once
 *   free --met inside--> touched       silent, force over a ramp (jump, stall; where two solids overlap)
 *   free --appeared--> touched         silent (new or moved there, reset)
 *   touched --changed--> touched       it is the new one at once, the state stays (hd_contact_force.c)
 *   touched --let go--> free           the probe left
 *   touched --dropped--> free          the object went away under the hand
 *
 * What commands make of the force is noted (struct hd_change) and comes in over the ramp
 * (hd_ramp.h). But a surface that is moved far along itself takes the hand along, with mu F_n at most. */
#include "tick/hd_contact.h"

#include "tick/hd_aim.h"
#include "tick/hd_mode.h"
#include "tick/hd_offload.h"
#include "tick/hd_press.h"
#include "tick/hd_seam.h"
#include "tick/hd_surface.h"
#include "tick/hd_tune.h"
#include "tick/hd_waveform.h"

HD_RT static double at_least_0(double value) {
    return value > 0.0 ? value : 0.0;
}

HD_RT void hd_contact_silence(struct hd_state *state, struct hd_slot *slot) {
    if (slot->noise != 0) {
        state->free_noises[state->free_noise_count++] = slot->noise - 1u;
        slot->noise = 0;
    }
}

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

HD_RT void hd_contact_take(struct hd_context *context, uint32_t index, uint32_t generation) {
    struct hd_slot *slot = &context->state->slots[index];
    if (slot->touched) {
        hd_contact_force_drop(context, index);
    }
    hd_contact_close(context->state, index);
    /* A mode of the former owner goes on ringing on its own. */
    *slot = (struct hd_slot){.generation = generation, .visited = slot->visited};
}

HD_RT static const struct hd_material *material_at(const struct hd_context *context, const struct hd_object *object,
                                                   double arc_m) {
    const struct hd_table *table = context->table;
    const uint32_t material =
        object->piece_count == 0 ? object->material
                                 : table->pieces[object->piece_first + hd_surface_piece(table, object, arc_m)].material;
    return &table->materials[material];
}

/* What strikes the tap of a material, in the unit of its mode. */
HD_RT static double tap_units(const struct hd_table *table, const struct hd_material *material, double approach) {
    const uint32_t count = material->tap_count;
    if (count == 0) {
        return approach;
    }
    const double *speeds = table->numbers + material->tap_first;
    const double *amplitudes = speeds + count;
    /* The first point that is not slower, or the last one. */
    uint32_t end = 0;
    for (uint32_t last = count - 1u; end < last;) {
        const uint32_t middle = end + (last - end) / 2u;
        if (speeds[middle] < approach) {
            end = middle + 1u;
        } else {
            last = middle;
        }
    }
    const double from = end > 0 ? speeds[end - 1u] : 0.0;
    const double low = end > 0 ? amplitudes[end - 1u] : 0.0;
    return at_least_0(low + (amplitudes[end] - low) * ((approach - from) / (speeds[end] - from)));
}

HD_RT void hd_contact_begin(struct hd_context *context, uint32_t index, const struct hd_object *object,
                            const struct hd_onset *onset) {
    struct hd_state *state = context->state;
    struct hd_slot *slot = &state->slots[index];
    slot->touched = 1;
    state->touches++;
    slot->active_index = state->active_count;
    state->active[state->active_count++] = index;
    slot->side = onset->side;
    slot->face = onset->face;
    slot->last = onset->point;
    slot->pose_version = object->pose_version;
    slot->surface_version = object->surface_version;
    slot->changed = onset->silent && !context->resync && hd_walk_is_unsettled(context);
    state->change.whole |= slot->changed;
    /* While the whole command is off, the contact needs no ramp of its own: the command's covers it. */
    slot->ramp = onset->silent && !slot->changed && state->gain > 0.0 ? 0.0 : 1.0;
    /* Reached along a surface whose force is still coming in, it goes on from there. */
    for (uint32_t i = 0; onset->slid && !onset->silent && i < context->path.plane_count; i++) {
        const double pressed = state->slots[context->path.plane[i].slot].ramp;
        slot->ramp = pressed < slot->ramp ? pressed : slot->ramp;
    }
    slot->anchor_m = onset->point.arc_m;
    slot->seam = 0;
    if (onset->slid && !onset->silent) {
        hd_seam_cross(context, slot, object);
    }
    slot->normal_n = 0.0;
    slot->grooves = 0;
    slot->contacts++;
    const double *normal = onset->point.normal;
    const double before = onset->silent ? 0.0 : hd_before_tick(context, onset->fraction);
    const double approach = -hd_dot(context->input->velocity_m_per_s, normal);
    struct hd_event *event = hd_event_add_at(state, HD_EVENT_CONTACT, context->input->time_ns, index);
    event->code = onset->silent ? HD_CONTACT_SILENT : 0;
    event->before_tick_s = before;
    event->speed_m_per_s = approach;
    event->true_speed_m_per_s = -hd_dot(context->input->true_velocity_m_per_s, normal);
    if (onset->silent || onset->slid || !(approach > 0.0) || (slot->disarmed && context->table->rearm_m > 0.0)) {
        return;
    }
    const struct hd_material *material = material_at(context, object, onset->point.arc_m);
    double units = tap_units(context->table, material, approach);
    event->amplitude_m_per_s2 = material->tap.amplitude_per_unit * units;
    if (!(units > 0.0)) {
        return; /* nothing; not even an effect of the device, which would end the one that plays */
    }
    double peak_time_s = material->tap.peak_time_s;
    const uint32_t struck = state->strike_count;
    struct hd_strike strike = {
        .mode = &material->tap,
        .slot = index,
        .generation = slot->generation,
        .use = HD_MODE_TAP,
        .event = hd_event_index(state, event),
        .units = units,
        .before_s = before,
        .wave = material->wave_count > 0 ? material : NULL,
    };
    const int heard =
        material->mode_count == 0 || hd_tune_tap(context->table, material, approach, &strike, &units, &peak_time_s);
    const double peak_s = at_least_0(peak_time_s - before);
    strike.growth_n = material->stiffness_n_per_m * approach * peak_s;
    if (heard) {
        hd_aim_strike(state, slot, material->tap_aim, normal, &strike);
    }
    if (material->second.force_per_unit > 0.0) {
        /* The force grows once, to the later of the peaks. Of a first mode that is silent it was not counted. */
        const double counted_s = state->strike_count > struck ? peak_s : 0.0;
        const double longer_s = at_least_0(material->second.peak_time_s - before) - counted_s;
        strike.mode = &material->second;
        strike.units = units;
        strike.tuned = NULL;
        strike.use = HD_MODE_SECOND;
        strike.wave = NULL;
        strike.growth_n = material->stiffness_n_per_m * approach * at_least_0(longer_s);
        hd_aim_strike(state, slot, material->tap_aim, normal, &strike);
    }
}

HD_RT void hd_contact_end(struct hd_state *state, uint32_t index, int64_t time_ns) {
    struct hd_slot *slot = &state->slots[index];
    const uint32_t last = state->active[--state->active_count];
    state->active[slot->active_index] = last;
    state->slots[last].active_index = slot->active_index;
    slot->touched = 0;
    slot->disarmed = 1;
    state->touches++;
    slot->force_n[0] = 0.0;
    slot->force_n[1] = 0.0;
    hd_contact_silence(state, slot);
    hd_event_add_at(state, HD_EVENT_RELEASE, time_ns, index);
}

HD_RT void hd_contact_change(struct hd_state *state, const double force_n[2]) {
    state->change.object_n[0] += force_n[0];
    state->change.object_n[1] += force_n[1];
    state->change.any = 1;
}

HD_RT void hd_contact_hush(struct hd_state *state, struct hd_slot *slot) {
    if (slot->noise != 0) {
        struct hd_active_noise *active = &state->noises[slot->noise - 1u];
        const double last_n = hd_noise_last(active);
        state->change.noise_rms_n += hd_noise_rms(active);
        state->change.noise_n[0] += last_n * active->direction[0];
        state->change.noise_n[1] += last_n * active->direction[1];
        state->change.any = 1;
    }
}

HD_RT void hd_contact_clear(struct hd_state *state, uint32_t index, int64_t time_ns) {
    struct hd_slot *slot = &state->slots[index];
    hd_contact_change(state, slot->force_n);
    state->change.whole = 1;
    hd_contact_hush(state, slot);
    hd_contact_end(state, index, time_ns);
    if (!slot->resume) {
        slot->resume = 1;
        state->resumed[state->resumed_count++] = index;
    }
}

HD_RT void hd_strike_add(struct hd_state *state, const struct hd_strike *strike) {
    const int heard = state->gain > 0.0 && state->show_vibration > 0.0;
    const int sounds = strike->mode->force_per_unit > 0.0 || (strike->mode->effect != 0 && state->offload_open);
    if (heard && sounds && state->strike_count < HD_STRIKE_CAPACITY) {
        state->strikes[state->strike_count++] = *strike;
    }
}

HD_RT double hd_strikes_apply(struct hd_state *state, const struct hd_table *table, double felt_n) {
    double wanted = 0.0;
    double growth = 0.0;
    for (uint32_t i = 0; i < state->strike_count; i++) {
        struct hd_strike *strike = &state->strikes[i];
        if (strike->tuned != NULL) {
            hd_tune_mode(table, strike, &state->tuned);
            strike->mode = &state->tuned;
        }
        const struct hd_mode *mode = strike->mode;
        strike->offload = mode->effect != 0 ? hd_offload_reserve(state, mode->effect) : 0;
        wanted += strike->units * (strike->offload != 0 ? mode->effect_force_per_unit * mode->effect_peak
                                                        : mode->force_per_unit * hd_press_peak(state, table, strike));
        growth += state->show_force * strike->growth_n;
    }
    const double room = table->max_force_n - felt_n - growth - hd_modes_bound(state) - state->reserved_n;
    const double scale = wanted <= room ? 1.0 : room > 0.0 ? room / wanted : 0.0;
    for (uint32_t i = 0; i < state->strike_count; i++) {
        const struct hd_strike *strike = &state->strikes[i];
        if (strike->tuned != NULL && state->strike_count > 1) {
            hd_tune_mode(table, strike, &state->tuned);
        }
        if (strike->offload != 0) {
            hd_offload_strike(state, strike, scale, table->period_s);
        } else {
            const double force = strike->units * strike->mode->force_per_unit * scale;
            const double vector[2] = {force * strike->direction[0], force * strike->direction[1]};
            if (strike->wave != NULL) {
                hd_waves_strike(state, table, strike, vector);
            } else {
                hd_modes_strike(state, strike, vector, table->period_s);
            }
        }
        if (strike->event < state->event_count) {
            state->events[strike->event].scale = scale;
        }
        state->strikes_total++;
    }
    state->strike_count = 0;
    return scale;
}
