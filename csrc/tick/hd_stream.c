/* The streamed force, tick by tick: along its line, within the force limit and the largest slope. */
#include "tick/hd_stream.h"

#include "base/hd_vector.h"
#include "tick/hd_limit.h"
#include "tick/hd_ramp.h"

/* Relative tolerance: rounding can make a line of the largest slope appear steeper. */
#define HD_PACE_ROUNDING 1e-9

HD_RT static void begin_line(struct hd_streamed *streamed, const double to_n[2], double length_s) {
    for (int axis = 0; axis < 2; axis++) {
        streamed->from_n[axis] = streamed->value_n[axis];
        streamed->to_n[axis] = to_n[axis];
    }
    streamed->length_s = length_s;
    streamed->periods = 0;
    streamed->fresh = 1;
}

HD_RT static void count_limited(struct hd_streamed *streamed) {
    if (!streamed->behind) {
        streamed->behind = 1;
        streamed->limited++;
    }
}

HD_RT void hd_stream_aim(struct hd_state *state, const struct hd_table *table, const double force_n[2],
                         double duration_s) {
    struct hd_streamed *streamed = &state->streamed;
    /* Scaled by the larger component first, since the square of a large double overflows. */
    const double larger_n =
        hd_magnitude(force_n[0]) > hd_magnitude(force_n[1]) ? hd_magnitude(force_n[0]) : hd_magnitude(force_n[1]);
    const double scale = larger_n > table->max_force_n ? table->max_force_n / larger_n : 1.0;
    double to_n[2] = {scale * force_n[0], scale * force_n[1]};
    const double cut = hd_limit_cut(to_n, table->max_force_n);
    streamed->behind = 0;
    streamed->ends = 0;
    if (scale < 1.0 || cut < 1.0) {
        count_limited(streamed);
        to_n[0] *= cut;
        to_n[1] *= cut;
    }
    begin_line(streamed, to_n, duration_s);
    state->streams = 1;
}

HD_RT void hd_stream_end(struct hd_state *state, const struct hd_table *table) {
    const double nothing_n[2] = {0.0, 0.0};
    begin_line(&state->streamed, nothing_n, table->ramp_s);
    state->streamed.behind = 1;
    state->streamed.ends = 1;
}

HD_RT void hd_stream_drop(struct hd_state *state) {
    struct hd_streamed *streamed = &state->streamed;
    for (int axis = 0; axis < 2; axis++) {
        streamed->value_n[axis] = 0.0;
        streamed->from_n[axis] = streamed->to_n[axis];
    }
}

/* Finds the value of the line in this tick. */
HD_RT static void line_at(struct hd_streamed *streamed, const struct hd_context *context, double line_n[2]) {
    /* A line begins one period before the first tick that uses it; periods missed before that do not count. */
    streamed->periods += streamed->fresh ? 1u : context->input->periods;
    streamed->fresh = 0;
    const double passed_s = (double)streamed->periods * context->table->period_s;
    if (passed_s < streamed->length_s * (1.0 - HD_PACE_ROUNDING)) {
        hd_between(streamed->from_n, streamed->to_n, passed_s / streamed->length_s, line_n);
    } else {
        line_n[0] = streamed->to_n[0];
        line_n[1] = streamed->to_n[1];
    }
}

HD_RT void hd_stream_add(struct hd_context *context) {
    struct hd_state *state = context->state;
    struct hd_streamed *streamed = &state->streamed;
    double line_n[2];
    double step_n[2];
    line_at(streamed, context, line_n);
    hd_difference(line_n, streamed->value_n, step_n);
    const double size_n = hd_root(hd_dot(step_n, step_n));
    const double most_n = hd_ramp_pace(context->table);
    const int late = size_n > most_n * (1.0 + HD_PACE_ROUNDING);
    const double was_n[2] = {streamed->value_n[0], streamed->value_n[1]};
    for (int axis = 0; axis < 2; axis++) {
        streamed->value_n[axis] = late ? was_n[axis] + most_n / size_n * step_n[axis] : line_n[axis];
        streamed->step_n[axis] = streamed->value_n[axis] - was_n[axis];
        context->force_n[axis] += streamed->value_n[axis];
    }
    if (late) {
        count_limited(streamed);
    }
    if (size_n > 0.0) {
        state->steady = 0; /* a moving stream counts as a command in every tick */
        state->change.streams = 1;
    }
    if (streamed->ends && streamed->value_n[0] == 0.0 && streamed->value_n[1] == 0.0) {
        state->streams = 0;
    }
}
