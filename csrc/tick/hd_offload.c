/* Strikes that the device plays as effects, and the part of the force limit that they reserve. The reserve lasts from
 * the tick of the strike to the latest possible end of the effect, which includes the largest delay until it starts
 * (hd_effects.h). If the effect is struck again while it plays, the larger of the two forces is reserved, since the
 * tick does not know when the second one starts. Several strikes of one effect in one tick share one reserve. */
#include "tick/hd_offload.h"

/* Returns the index of an effect in reserves[], or reserve_count if it is not there. */
HD_RT static uint32_t find_reserve(const struct hd_state *state, uint32_t effect) {
    uint32_t place = 0;
    while (place < state->reserve_count && state->reserves[place].effect != effect) {
        place++;
    }
    return place;
}

HD_RT static void sum_reserves(struct hd_state *state) {
    state->reserved_n = 0.0;
    for (uint32_t i = 0; i < state->reserve_count; i++) {
        state->reserved_n += state->reserves[i].most_n;
    }
}

HD_RT uint32_t hd_offload_reserve(struct hd_state *state, uint32_t effect) {
    const int fully = state->offload_open && state->enabled && state->gain == 1.0 && state->show_vibration == 1.0;
    if (!fully || state->offload_count == HD_OFFLOAD_CAPACITY) {
        return 0;
    }
    const uint32_t place = find_reserve(state, effect);
    if (place == HD_RESERVE_CAPACITY) {
        return 0;
    }
    if (place == state->reserve_count) {
        state->reserves[state->reserve_count++] = (struct hd_reserve){.effect = effect, .remaining = 1};
    }
    state->offloads[state->offload_count] = (struct hd_offload){.effect = effect};
    return ++state->offload_count;
}

HD_RT void hd_offload_strike(struct hd_state *state, const struct hd_strike *strike, double scale, double period_s) {
    const struct hd_mode *mode = strike->mode;
    const double force = strike->units * mode->effect_force_per_unit * scale;
    struct hd_offload *offload = &state->offloads[strike->offload - 1u];
    offload->force_n[0] = force * strike->direction[0];
    offload->force_n[1] = force * strike->direction[1];
    struct hd_reserve *reserve = &state->reserves[find_reserve(state, mode->effect)];
    const double most_n = force * mode->effect_peak;
    const uint32_t ticks = (uint32_t)((mode->effect_s + HD_OFFLOAD_LATE_S) / period_s) + 2u;
    reserve->most_n = most_n > reserve->most_n ? most_n : reserve->most_n;
    reserve->remaining = ticks > reserve->remaining ? ticks : reserve->remaining;
    sum_reserves(state);
}

HD_RT void hd_offload_advance(struct hd_state *state, uint32_t periods) {
    uint32_t i = 0;
    while (i < state->reserve_count) {
        struct hd_reserve *reserve = &state->reserves[i];
        if (reserve->remaining > periods) {
            reserve->remaining -= periods;
            i++;
        } else {
            *reserve = state->reserves[--state->reserve_count];
        }
    }
    sum_reserves(state);
}
