/* The coloured noise of a touched surface: started, added to the sums of the tick, and ended. */
#include "tick/hd_surface_noise.h"

/* The noise of the table that is to sound in a tick, with its gain, force and speed. */
struct target {
    const struct hd_noise *noise;
    const double *numbers;
    double scale_n;
    double normal_n;
    double speed_m_per_s;
};

HD_RT static double next_sample_n(struct hd_active_noise *active, const struct target *target, int changed,
                                  double ramp_step) {
    const double scale_n = hd_ease(&active->scale_n, target->scale_n, changed, ramp_step);
    const double normal_n = hd_ease(&active->normal_n, target->normal_n, changed, ramp_step);
    return scale_n * hd_noise_next(active, target->noise, target->numbers, target->speed_m_per_s, normal_n, ramp_step);
}

/* Returns the active noise of a slot, started if the slot has none; NULL if too many noises sound. */
HD_RT static struct hd_active_noise *find_or_start(struct hd_context *context, uint32_t index,
                                                   const struct hd_noise *noise) {
    struct hd_state *state = context->state;
    struct hd_slot *slot = &state->slots[index];
    if (slot->noise == 0) {
        if (state->free_noise_count == 0) {
            return NULL;
        }
        slot->noise = state->free_noises[--state->free_noise_count] + 1u;
        struct hd_active_noise *fresh = &state->noises[slot->noise - 1u];
        /* A noise that starts again within a contact, for example on another patch, gets another salt. */
        hd_noise_start(fresh, noise, context->table->numbers, slot->contacts++ + index * 2654435761u);
        fresh->version = noise->version;
    }
    return &state->noises[slot->noise - 1u];
}

HD_RT void hd_surface_noise_sound(struct hd_context *context, uint32_t index,
                                  const struct hd_dominant_material *dominant, const double normal[2],
                                  const double tangent[2], int changed) {
    struct hd_state *state = context->state;
    const struct hd_table *table = context->table;
    const struct hd_noise *noise = &table->noises[dominant->material->noise];
    struct hd_active_noise *active = find_or_start(context, index, noise);
    if (active == NULL) {
        return;
    }
    struct hd_active_noise still;
    if (changed) {
        still = *active;
    }
    if (active->version != noise->version) {
        hd_noise_turn(active);
        active->version = noise->version;
    }
    const double *direction = noise->along_normal ? normal : tangent;
    const struct target target = {
        .noise = noise,
        .numbers = table->numbers,
        .scale_n = dominant->noise_weight * noise->force_per_unit,
        .normal_n = state->slots[index].normal_n,
        .speed_m_per_s = hd_dot(context->input->velocity_m_per_s, tangent),
    };
    double as_it_was = 0.0;
    const double *along = direction;
    const int eases = changed || active->blend < 1.0 || active->scale_n.off != 0.0 || active->normal_n.off != 0.0;
    if (changed) {
        as_it_was = hd_noise_last(&still);
        along = still.direction;
    } else if (eases) {
        still = *active;
        as_it_was = next_sample_n(&still, &target, 0, 0.0);
    }
    const double sample = next_sample_n(active, &target, changed, context->ramp_step);
    context->noise_rms_n += hd_noise_rms(active);
    if (eases) {
        state->change.noise_rms_n += hd_noise_rms(&still) - hd_noise_rms(active);
    }
    for (int axis = 0; axis < 2; axis++) {
        context->noise_n[axis] += sample * direction[axis];
        if (eases) {
            state->change.eased_n[axis] += sample * direction[axis] - as_it_was * along[axis];
        }
        active->direction[axis] = direction[axis];
    }
    state->change.eases |= eases != 0;
}

HD_RT void hd_surface_noise_change(struct hd_state *state, struct hd_slot *slot) {
    if (slot->noise != 0) {
        struct hd_active_noise *active = &state->noises[slot->noise - 1u];
        const double last_n = hd_noise_last(active);
        state->change.noise_rms_n += hd_noise_rms(active);
        state->change.noise_n[0] += last_n * active->direction[0];
        state->change.noise_n[1] += last_n * active->direction[1];
        state->change.any = 1;
    }
}

HD_RT void hd_surface_noise_end(struct hd_state *state, struct hd_slot *slot) {
    if (slot->noise != 0) {
        state->free_noises[state->free_noise_count++] = slot->noise - 1u;
        slot->noise = 0;
    }
}
