/* Strikes that the device plays by itself: noted for it, and counted against the force limit while they may play. An
 * effect counts from the tick of its strike until it has ended even where the strike reached the device as late as it
 * may (hd_effects.h). Struck anew while it plays, it counts with the stronger of the two: the tick does not know when
 * the one becomes the other. Several strikes of one effect in one tick count together. */
#include "tick/hd_offload.h"

/* The place of an effect in reserves[], or where it would come. */
HD_RT static uint32_t find(const struct hd_state *state, uint32_t effect) {
    uint32_t place = 0;
    while (place < state->reserve_count && state->reserves[place].effect != effect) {
        place++;
    }
    return place;
}

HD_RT static void sum_up(struct hd_state *state) {
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
    const uint32_t place = find(state, effect);
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
    struct hd_reserve *reserve = &state->reserves[find(state, mode->effect)];
    const double most_n = force * mode->effect_peak;
    const uint32_t ticks = (uint32_t)((mode->effect_s + HD_OFFLOAD_LATE_S) / period_s) + 2u;
    reserve->most_n = most_n > reserve->most_n ? most_n : reserve->most_n;
    reserve->remaining = ticks > reserve->remaining ? ticks : reserve->remaining;
    sum_up(state);
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
    sum_up(state);
}
