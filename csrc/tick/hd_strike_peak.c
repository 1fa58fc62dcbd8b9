/* The largest force of a strike, from the stiffness of all that is felt along its direction. */
#include "tick/hd_strike_peak.h"

#include "base/hd_vector.h"

/* Beyond that, straight lines are none any more. */
#define HD_STRIKE_PEAK_MOST 2.0

/* A spring of friction below this part of its longest holds: at its longest it slides, and has no slope. */
#define HD_STRIKE_PEAK_STUCK (1.0 - 1e-9)

/* Along the surface, N/m. */
HD_RT static double holds_with(const struct hd_slot *slot) {
    const struct hd_surface *surface = &slot->surface;
    const double spring_n = surface->friction_stiffness_n_per_m * hd_magnitude(slot->last.arc_m - slot->anchor_m);
    const int stuck = spring_n < HD_STRIKE_PEAK_STUCK * surface->friction_coefficient * slot->normal_n;
    return stuck ? surface->friction_stiffness_n_per_m : 0.0;
}

/* The slope of all forces that are displayed, along a unit vector, N/m: sum K_i (n_i . d)^2, along the surface that of
 * friction where the probe sticks, and that of the fields, which is the same in every direction. */
HD_RT static double slope_along(const struct hd_state *state, const struct hd_table *table, const double direction[2]) {
    if (table->display_force == 0) {
        return 0.0;
    }
    double slope = state->field_active ? state->field.stiffness_n_per_m : 0.0;
    for (uint32_t i = 0; i < state->active_count; i++) {
        const struct hd_slot *slot = &state->slots[state->active[i]];
        const double part = hd_dot(slot->last.normal, direction);
        slope += slot->surface.stiffness_n_per_m * part * part + holds_with(slot) * (1.0 - part * part);
    }
    return slope;
}

HD_RT double hd_strike_peak(const struct hd_state *state, const struct hd_table *table, struct hd_strike *strike) {
    const struct hd_mode *mode = strike->mode;
    if (!(mode->touched_n_per_m > 0.0)) {
        return mode->peak;
    }
    if (strike->bare) {
        return 1.0;
    }
    const double share = slope_along(state, table, strike->direction) / mode->touched_n_per_m;
    strike->touched = share < HD_STRIKE_PEAK_MOST ? share : HD_STRIKE_PEAK_MOST;
    /* |s p + (1 - s) f| at most, in between and beyond. */
    const double rest = 1.0 - strike->touched;
    return strike->touched * mode->peak + (rest < 0.0 ? -rest : rest) * mode->free_peak;
}
