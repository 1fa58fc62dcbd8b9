/* Limits the compensation of a tap to what the depth of the probe shows of the push of the hand. */
#include "tick/hd_preload.h"

#include "base/hd_vector.h"
#include "tick/hd_mode.h"

#define HD_LEAD_STEPS 2.0 /* the depth is judged this number of steps ahead, at the present speed */

HD_RT const double *hd_preload_begin(struct hd_context *context, uint32_t index, const struct hd_material *material,
                                     double before_s, double approach, uint32_t *bounced) {
    struct hd_slot *slot = &context->state->slots[index];
    if (material->kept_count == 0) {
        return NULL;
    }
    const uint64_t tick = context->state->tick + 1u;
    const double since_s = (double)(tick - slot->tap_tick) * context->table->period_s;
    *bounced = slot->tap_tick != 0 && since_s < (double)material->kept_count * material->kept_step_s;
    slot->tap_tick = tick;
    slot->tap_m_per_s = approach;
    slot->tap_s = before_s;
    slot->preload_share = 1.0;
    slot->kept = 1;
    return context->table->numbers + material->kept_first;
}

/* Lowers the share of the preloaded modes. */
HD_RT static void lower(struct hd_state *state, uint32_t index, double share) {
    struct hd_slot *slot = &state->slots[index];
    if (share < slot->preload_share) {
        hd_modes_scale_preloaded(state, index, share / slot->preload_share);
        slot->preload_share = share;
    }
}

HD_RT void hd_preload_follow(struct hd_context *context, uint32_t index, const struct hd_material *material,
                             const struct hd_contact_point *point) {
    struct hd_slot *slot = &context->state->slots[index];
    slot->tap_s += (double)context->input->periods * context->table->period_s;
    if (material->kept_count == 0) {
        return; /* the material was changed while the tap rings */
    }
    const double place = slot->tap_s / material->kept_step_s - 1.0 + HD_LEAD_STEPS;
    if (!(place >= 0.0 && place < (double)(material->kept_count - 1u))) {
        return;
    }
    const uint32_t before = (uint32_t)place;
    const double part = place - (double)before;
    const double *low = context->table->numbers + material->kept_first + hd_kept_depths() + before;
    const double *high = low + material->kept_count;
    if (!(high[0] > low[0] && high[1] > low[1])) {
        return;
    }
    const double least_m = slot->tap_m_per_s * (low[0] + part * (low[1] - low[0]));
    const double full_m = slot->tap_m_per_s * (high[0] + part * (high[1] - high[0]));
    const double lead_s = HD_LEAD_STEPS * material->kept_step_s;
    const double speed_m_per_s = -hd_dot(context->input->velocity_m_per_s, point->normal);
    const double above_m = point->depth_m + lead_s * speed_m_per_s - least_m;
    lower(context->state, index, above_m > 0.0 ? above_m / (full_m - least_m) : 0.0);
}

HD_RT void hd_preload_end(struct hd_state *state, uint32_t index) {
    hd_modes_silence_tails(state, index);
    state->slots[index].preload_share = 0.0;
    state->slots[index].kept = 0;
}
