/* Fields: constant, spring and viscous objects. Each is affine in position and velocity, so their sum is one law, F = f
 * - K p - D v, whose cost does not depend on their number. */
#include "tick/hd_field.h"

HD_RT static void field_force(const struct hd_field *field, const struct hd_input *input, double force_n[2]) {
    for (int axis = 0; axis < 2; axis++) {
        force_n[axis] = field->force_n[axis] - field->stiffness_n_per_m * input->position_m[axis] -
                        field->damping_n_s_per_m * input->velocity_m_per_s[axis];
    }
}

/* Copies the table's fields into the state, scaled by the ramp: after a jump the force of fields ramps up, as that of
 * contacts does. */
HD_RT static void ramp_field(struct hd_context *context) {
    struct hd_state *state = context->state;
    const struct hd_field *field = &context->table->field;
    const double ramp = state->field_ramp + context->ramp_step;
    state->field_ramp = ramp < 1.0 ? ramp : 1.0;
    state->field = *field;
    if (ramp < 1.0) {
        state->field.force_n[0] *= ramp;
        state->field.force_n[1] *= ramp;
        state->field.stiffness_n_per_m *= ramp;
        state->field.damping_n_s_per_m *= ramp;
    }
}

HD_RT void hd_field_follow(struct hd_context *context) {
    struct hd_state *state = context->state;
    const struct hd_field *field = &context->table->field;
    const int changed = state->field_known && state->field_version != context->table->field_version;
    double was[2];
    double is[2];
    field_force(&state->field, context->input, was);
    if (!state->field_known) {
        state->field_ramp = state->started ? 0.0 : 1.0;
    }
    ramp_field(context);
    if (changed) {
        field_force(&state->field, context->input, is);
        hd_difference(was, is, state->change.field_n);
        state->change.any = 1;
    }
    state->field_version = context->table->field_version;
    state->field_known = 1;
    state->field_active = field->force_n[0] != 0.0 || field->force_n[1] != 0.0 || field->stiffness_n_per_m != 0.0 ||
                          field->damping_n_s_per_m != 0.0;
}
