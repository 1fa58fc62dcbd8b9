/* Fields: constant, spring and viscous objects. Each is affine in position and velocity, so all of them together are
 * one law, F = f - K p - D v, that costs the same however many there are. */
#include "hd_vector.h"
#include "hd_walk.h"

HD_RT static void force_of(const struct hd_field *field, const struct hd_input *input, double force_n[2]) {
    for (int axis = 0; axis < 2; axis++) {
        force_n[axis] = field->force_n[axis] - field->stiffness_n_per_m * input->position_m[axis] -
                        field->damping_n_s_per_m * input->velocity_m_per_s[axis];
    }
}

HD_RT void hd_field_follow(struct hd_walk *walk) {
    struct hd_state *state = walk->state;
    const struct hd_field *field = &walk->table->field;
    if (state->started) {
        double was[2];
        double is[2];
        force_of(&state->field, walk->input, was);
        force_of(field, walk->input, is);
        hd_difference(was, is, state->change.field_n);
        state->change.any = 1;
    }
    state->field = *field;
    state->field_version = walk->table->field_version;
    state->field_known = 1;
    state->field_active = field->force_n[0] != 0.0 || field->force_n[1] != 0.0 || field->stiffness_n_per_m != 0.0 ||
                          field->damping_n_s_per_m != 0.0;
}
