/* The force of the fields: one affine law for any number of fields. Servo thread. */
#ifndef HD_FIELD_H
#define HD_FIELD_H

#include "tick/hd_context.h"

/* Takes over the table's fields into the state. */
HD_RT void hd_field_follow(struct hd_context *context);

/* Adds the force of the fields to the context. */
HD_RT static inline void hd_field_add(struct hd_context *context) {
    struct hd_state *state = context->state;
    if (!state->field_known || state->field_version != context->table->field_version || state->field_ramp < 1.0) {
        hd_field_follow(context);
    }
    if (state->field_active) {
        for (int axis = 0; axis < 2; axis++) {
            context->force_n[axis] += state->field.force_n[axis] -
                                      state->field.stiffness_n_per_m * context->input->position_m[axis] -
                                      state->field.damping_n_s_per_m * context->input->velocity_m_per_s[axis];
        }
    }
}

#endif
