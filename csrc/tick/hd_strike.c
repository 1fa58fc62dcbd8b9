/* Strikes of a tick: collected, scaled together to the room within the force limit, started as modes or waveforms. */
#include "tick/hd_strike.h"

#include "tick/hd_mode.h"
#include "tick/hd_offload.h"
#include "tick/hd_strike_mode.h"
#include "tick/hd_strike_peak.h"
#include "tick/hd_waveform.h"

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
            hd_strike_mode_make(table, strike, &state->tuned);
            strike->mode = &state->tuned;
        }
        const struct hd_mode *mode = strike->mode;
        strike->offload = mode->effect != 0 ? hd_offload_reserve(state, mode->effect) : 0;
        wanted += strike->units * (strike->offload != 0 ? mode->effect_force_per_unit * mode->effect_peak
                                                        : mode->force_per_unit * hd_strike_peak(state, table, strike));
        growth += state->show_force * strike->growth_n;
    }
    const double room = table->max_force_n - felt_n - growth - hd_modes_bound(state) - state->reserved_n;
    const double scale = wanted <= room ? 1.0 : room > 0.0 ? room / wanted : 0.0;
    for (uint32_t i = 0; i < state->strike_count; i++) {
        const struct hd_strike *strike = &state->strikes[i];
        if (strike->tuned != NULL && state->strike_count > 1) {
            hd_strike_mode_make(table, strike, &state->tuned);
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
