/* Corrections of the first samples after a strike: added, advanced, scaled and bounded. */
#include "tick/hd_strike_correction.h"

#include "base/hd_vector.h"

HD_RT void hd_strike_correction_add(struct hd_state *state, const struct hd_mode *mode, double before,
                                    const double force_n[2]) {
    for (uint32_t i = state->kick_count; i < HD_KICKS; i++) {
        state->kicks_n[i][0] = state->kicks_n[i][1] = 0.0;
    }
    state->kick_count = HD_KICKS;
    for (uint32_t i = 0; i < HD_KICKS; i++) {
        const double kick = mode->kicks[2u * i] + before * mode->kicks[2u * i + 1u];
        for (int axis = 0; axis < 2; axis++) {
            const double more_n = kick * force_n[axis];
            state->kicks_n[i][axis] += more_n;
            state->ringing_n[axis] += i == 0 ? more_n : 0.0;
        }
    }
}

HD_RT void hd_strike_correction_advance(struct hd_state *state, uint32_t periods) {
    if (periods >= state->kick_count || state->active_mode_count == 0) {
        state->kick_count = 0;
        return;
    }
    state->kick_count -= periods;
    for (uint32_t i = 0; i < state->kick_count; i++) {
        state->kicks_n[i][0] = state->kicks_n[i + periods][0];
        state->kicks_n[i][1] = state->kicks_n[i + periods][1];
    }
    state->ringing_n[0] += state->kicks_n[0][0];
    state->ringing_n[1] += state->kicks_n[0][1];
}

HD_RT void hd_strike_correction_scale(struct hd_state *state, double factor) {
    for (uint32_t i = 0; i < state->kick_count; i++) {
        state->kicks_n[i][0] *= factor;
        state->kicks_n[i][1] *= factor;
    }
}

HD_RT double hd_strike_correction_bound(const struct hd_state *state) {
    double square = 0.0;
    for (uint32_t i = 0; i < state->kick_count; i++) {
        const double here = hd_dot(state->kicks_n[i], state->kicks_n[i]);
        square = here > square ? here : square;
    }
    return hd_root(square);
}
