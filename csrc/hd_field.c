/* Fields: constant, spring and viscous objects. Each is affine in position and velocity, so all of them together are
 * one law, F = f - K p - D v, that costs the same however many there are. A change comes in over the ramp. */
#include "hd_walk.h"

HD_RT static double between(double from, double to, double blend) {
    return from + blend * (to - from);
}

HD_RT void hd_field_follow(struct hd_walk *walk) {
    struct hd_state *state = walk->state;
    const struct hd_field *to = &walk->table->field;
    if (!state->started) {
        state->field = *to;
        state->field_blend = 1.0;
    } else if (state->field_version != walk->table->field_version) {
        state->field_from = state->field;
        state->field_blend = 0.0;
    }
    state->field_version = walk->table->field_version;
    if (state->field_blend < 1.0) {
        state->field_blend += walk->ramp_step;
        if (state->field_blend >= 1.0) {
            state->field = *to;
        } else {
            const struct hd_field *from = &state->field_from;
            const double b = state->field_blend;
            state->field.force_n[0] = between(from->force_n[0], to->force_n[0], b);
            state->field.force_n[1] = between(from->force_n[1], to->force_n[1], b);
            state->field.stiffness_n_per_m = between(from->stiffness_n_per_m, to->stiffness_n_per_m, b);
            state->field.damping_n_s_per_m = between(from->damping_n_s_per_m, to->damping_n_s_per_m, b);
        }
    }
    const struct hd_field *field = &state->field;
    state->field_active = state->field_blend < 1.0 || field->force_n[0] != 0.0 || field->force_n[1] != 0.0 ||
                          field->stiffness_n_per_m != 0.0 || field->damping_n_s_per_m != 0.0;
}
