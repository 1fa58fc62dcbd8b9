/* The largest force of a strike, computed from the stiffness along its direction. */
#include "tick/hd_strike_peak.h"

#include "base/hd_vector.h"

/* Largest stiffness ratio: beyond it the linear interpolation of gains is not valid. */
#define HD_STIFFNESS_RATIO_MAX 2.0

/* The probe sticks while the friction spring is below this part of the friction limit; at the limit it slides, and the
 * stiffness along the surface is 0. */
#define HD_STICK_FACTOR (1.0 - 1e-9)

/* Returns the stiffness of friction along the surface, N/m. */
HD_RT static double stick_stiffness(const struct hd_slot *slot) {
    const struct hd_surface *surface = &slot->surface;
    const double spring_n = surface->friction_stiffness_n_per_m * hd_magnitude(slot->last.arc_m - slot->anchor_m);
    const int stuck = spring_n < HD_STICK_FACTOR * surface->friction_coefficient * slot->normal_n;
    return stuck ? surface->friction_stiffness_n_per_m : 0.0;
}

/* Returns the stiffness of all displayed forces along a unit vector d, N/m: the sum of K_i (n_i . d)^2 over the touched
 * surfaces, of friction along those where the probe sticks, and of the fields, which is equal in every direction. */
HD_RT static double stiffness_along(const struct hd_state *state, const struct hd_table *table,
                                    const double direction[2]) {
    if (table->display_force == 0) {
        return 0.0;
    }
    double slope = state->field_active ? state->field.stiffness_n_per_m : 0.0;
    for (uint32_t i = 0; i < state->active_count; i++) {
        const struct hd_slot *slot = &state->slots[state->active[i]];
        const double part = hd_dot(slot->last.normal, direction);
        slope += slot->surface.stiffness_n_per_m * part * part + stick_stiffness(slot) * (1.0 - part * part);
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
    const double share = stiffness_along(state, table, strike->direction) / mode->touched_n_per_m;
    strike->touched = share < HD_STIFFNESS_RATIO_MAX ? share : HD_STIFFNESS_RATIO_MAX;
    /* Upper bound of |s p + (1 - s) f|, for s within and beyond 0 to 1. */
    const double rest = 1.0 - strike->touched;
    return strike->touched * mode->peak + (rest < 0.0 ? -rest : rest) * mode->free_peak;
}
