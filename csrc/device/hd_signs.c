/* The check of a device's signs, one step per tick of the servo: pushes the handle, observes it, and decides.
 * hd_signs.h describes the method. */
#include "device/hd_signs.h"

#include <stdlib.h>
#include <string.h>

#include "base/hd_vector.h"

#define HD_PULSE_S 0.05       /* longest pulse */
#define HD_AFTER_S 0.02       /* time for which the handle is observed after a pulse */
#define HD_SETTLE_S 0.03      /* time after a pulse and its opposite during which positions are ignored */
#define HD_LINE_S 0.05        /* the handle rests if it moved by less than `least_m` in this time */
#define HD_MAX_WAIT_S 1.0     /* time without rest after which the problem is reported */
#define HD_LONGEST_GAP_S 0.02 /* longest time between two ticks; a longer gap restarts the round */
#define HD_MAX_ROUNDS 5u      /* rounds of an axis without a decision, after which the check gives up */
#define HD_MIN_AXIS_RATIO 2.0 /* smallest ratio of the larger displacement to that of the other axis */

static const double pulse_signs[4] = {1.0, -1.0, -1.0, 1.0};

HD_RT static void begin_rest(struct hd_signs *signs) {
    signs->phase = HD_SIGNS_REST;
    signs->phase_s = 0.0;
    signs->waited_s = 0.0;
    signs->force_n = 0.0;
    memset(&signs->line, 0, sizeof signs->line);
}

/* Restarts the round. */
HD_RT static void restart_round(struct hd_signs *signs) {
    signs->pulse = 0;
    begin_rest(signs);
}

HD_RT static void wait_for(struct hd_signs *signs, uint32_t problem) {
    signs->state = HD_SIGNS_WAITING;
    signs->problem = problem;
}

HD_RT static void begin_axis(struct hd_signs *signs, uint32_t axis) {
    signs->axis = axis;
    signs->round = 0;
    signs->previous = HD_SIGNS_STILL;
    signs->state = HD_SIGNS_CHECKING;
    signs->problem = HD_SIGNS_FINE;
    restart_round(signs);
}

/* Evaluates a round: compares the displacements along both axes for a push along `axis`, and checks that the four
 * pulses agree. Returns an enum hd_signs_problem. */
HD_RT static uint32_t round_problem(const struct hd_signs *signs) {
    const uint32_t own = signs->axis;
    const uint32_t other = 1u - own;
    double mean[2];
    for (uint32_t i = 0; i < 2; i++) {
        mean[i] = 0.0;
        for (uint32_t k = 0; k < 4; k++) {
            mean[i] += 0.25 * pulse_signs[k] * signs->moved_m[k][i];
        }
    }
    const uint32_t main = hd_magnitude(mean[own]) >= hd_magnitude(mean[other]) ? own : other;
    const double most = hd_magnitude(mean[main]);
    if (most < signs->of.least_m) {
        return HD_SIGNS_STILL;
    }
    if (most < HD_MIN_AXIS_RATIO * hd_magnitude(mean[1u - main])) {
        return HD_SIGNS_UNCERTAIN;
    }
    const double way = mean[main] > 0.0 ? 1.0 : -1.0;
    double pair[2] = {0.0, 0.0};
    for (uint32_t k = 0; k < 4; k++) {
        const double went = way * pulse_signs[k] * signs->moved_m[k][main];
        if (went < -0.5 * most) { /* the hand moved the handle */
            return HD_SIGNS_UNCERTAIN;
        }
        pair[k / 2] += 0.5 * went;
    }
    if (hd_magnitude(pair[0] - pair[1]) > most) {
        return HD_SIGNS_UNCERTAIN;
    }
    return main == other ? HD_SIGNS_SWAPPED : way > 0.0 ? HD_SIGNS_FINE : HD_SIGNS_REVERSED;
}

HD_RT static void evaluate_round(struct hd_signs *signs) {
    const uint32_t problem = round_problem(signs);
    const uint32_t previous = signs->previous;
    const int is_clear = problem != HD_SIGNS_STILL && problem != HD_SIGNS_UNCERTAIN;
    signs->previous = problem;
    if (signs->idle != 0) {
        if (!is_clear || problem != previous) {
            restart_round(signs);
            return;
        }
        signs->ignored |= signs->idle;
        signs->idle = 0;
        signs->state = HD_SIGNS_CHECKING;
    }
    if (problem == HD_SIGNS_FINE) {
        if (signs->axis == 0 && (signs->of.axes & 2u) != 0) {
            begin_axis(signs, 1);
            return;
        }
        signs->state = HD_SIGNS_RIGHT;
        signs->problem = HD_SIGNS_FINE;
        signs->passed = 1;
        return;
    }
    signs->problem = problem;
    /* Requires the same result twice, because the check is not repeated afterwards. */
    if (is_clear && problem == previous) {
        signs->state = HD_SIGNS_WRONG;
        return;
    }
    if (++signs->round >= HD_MAX_ROUNDS) {
        signs->state = HD_SIGNS_UNCLEAR;
        signs->ignored = 0; /* a hand may have moved the handle, not the pulses */
        return;
    }
    restart_round(signs);
}

/* Fits a line to the positions, into base and slope, and returns whether the handle rested. */
HD_RT static int handle_rested(struct hd_signs *signs, double now_s) {
    const struct hd_signs_line *line = &signs->line;
    const double spread = line->square - line->time * line->time / line->count;
    const double least_m = signs->of.least_m;
    int still = 1;
    for (int i = 0; i < 2; i++) {
        const double mean = line->position[i] / line->count;
        const double slope = (line->product[i] - line->time * mean) / spread;
        /* Squared distances from the line: large if the handle swings. */
        const double off = line->power[i] - line->position[i] * mean - slope * slope * spread;
        still &= hd_magnitude(slope) * HD_LINE_S < least_m && off < line->count * least_m * least_m;
        signs->slope_m_per_s[i] = slope;
        signs->base_m[i] = mean + slope * (now_s - line->time / line->count);
    }
    return still;
}

HD_RT static void step_rest(struct hd_signs *signs, const double position_m[2]) {
    struct hd_signs_line *line = &signs->line;
    const double at_s = signs->phase_s - HD_SETTLE_S;
    if (at_s < 0.0) {
        return;
    }
    line->count += 1.0;
    line->time += at_s;
    line->square += at_s * at_s;
    for (int i = 0; i < 2; i++) {
        line->position[i] += position_m[i];
        line->product[i] += at_s * position_m[i];
        line->power[i] += position_m[i] * position_m[i];
    }
    if (at_s < HD_LINE_S || line->count < 3.0) {
        return;
    }
    if (handle_rested(signs, at_s)) {
        if (signs->state == HD_SIGNS_WAITING && signs->idle == 0) {
            signs->state = HD_SIGNS_CHECKING;
            signs->problem = HD_SIGNS_FINE;
        }
        signs->sum_m[0] = signs->sum_m[1] = signs->count = 0.0;
        signs->phase = HD_SIGNS_PULSE;
        signs->phase_s = signs->driven_s = signs->end_s = 0.0;
        return;
    }
    const double waited_s = signs->waited_s;
    begin_rest(signs);
    signs->phase_s = HD_SETTLE_S;
    signs->waited_s = waited_s;
    if (waited_s > HD_MAX_WAIT_S) {
        if (signs->idle == 0) {
            wait_for(signs, HD_SIGNS_MOVING);
        }
        signs->pulse = 0; /* earlier pulses belong to another position */
    }
}

/* Moves the force towards `target_n` by at most `step_n`, the slope limit of commands. */
HD_RT static void approach_force(struct hd_signs *signs, double target_n, double step_n) {
    const double remaining_n = target_n - signs->force_n;
    signs->force_n = remaining_n > step_n    ? signs->force_n + step_n
                     : remaining_n < -step_n ? signs->force_n - step_n
                                             : target_n;
}

HD_RT static void step_pulse(struct hd_signs *signs, const double position_m[2], double elapsed_s, double most_n,
                             double step_n) {
    double went = 0.0;
    for (int i = 0; i < 2; i++) {
        const double away = position_m[i] - signs->base_m[i] - signs->slope_m_per_s[i] * signs->phase_s;
        signs->sum_m[i] += away;
        went = hd_magnitude(away) > went ? hd_magnitude(away) : went;
    }
    signs->count += 1.0;
    if (signs->end_s <= 0.0) {
        if (signs->phase_s < HD_PULSE_S && went < signs->of.enough_m) {
            approach_force(signs, pulse_signs[signs->pulse] * most_n, step_n);
            signs->driven_s += elapsed_s;
            return;
        }
        signs->end_s = signs->phase_s + HD_AFTER_S;
    }
    approach_force(signs, 0.0, step_n);
    if (signs->phase_s >= signs->end_s && hd_magnitude(signs->force_n) <= 0.0) {
        for (int i = 0; i < 2; i++) {
            signs->moved_m[signs->pulse][i] = signs->sum_m[i] / signs->count;
        }
        signs->phase = HD_SIGNS_BRAKE;
        signs->phase_s = 0.0;
    }
}

HD_RT static void step_brake(struct hd_signs *signs, double elapsed_s, double most_n, double step_n) {
    if (signs->driven_s > 0.5 * elapsed_s) {
        signs->driven_s -= elapsed_s;
        approach_force(signs, -pulse_signs[signs->pulse] * most_n, step_n);
        return;
    }
    approach_force(signs, 0.0, step_n);
    if (hd_magnitude(signs->force_n) > 0.0) {
        return;
    }
    begin_rest(signs);
    if (++signs->pulse == 4) {
        evaluate_round(signs);
    }
}

HD_RT static void advance_phase(struct hd_signs *signs, const struct hd_signs_input *input) {
    const double most_n = signs->of.force_n < input->max_force_n ? signs->of.force_n : input->max_force_n;
    const double step_n = input->max_force_n * input->elapsed_s / input->ramp_s;
    if (input->elapsed_s > HD_LONGEST_GAP_S && signs->phase != HD_SIGNS_REST) {
        restart_round(signs);
        return;
    }
    /* An axis without a force, such as a pedal, moves independently and is ignored. */
    const double position_m[2] = {(signs->of.axes & 1u) != 0 ? input->position_m[0] : 0.0,
                                  (signs->of.axes & 2u) != 0 ? input->position_m[1] : 0.0};
    signs->phase_s += input->elapsed_s;
    switch (signs->phase) {
    case HD_SIGNS_REST:
        signs->waited_s += input->elapsed_s;
        step_rest(signs, position_m);
        return;
    case HD_SIGNS_PULSE:
        step_pulse(signs, position_m, input->elapsed_s, most_n, step_n);
        return;
    default:
        step_brake(signs, input->elapsed_s, most_n, step_n);
        return;
    }
}

HD_RT int hd_signs_step(struct hd_signs *signs, const struct hd_hid_signs *of, const struct hd_signs_input *input,
                        double force_n[2]) {
    force_n[0] = force_n[1] = 0.0;
    if (of->number != signs->of.number || (of->number == 0 && signs->state != HD_SIGNS_TRUSTED)) {
        *signs = (struct hd_signs){.of = *of, .state = of->number == 0 ? HD_SIGNS_TRUSTED : HD_SIGNS_UNCHECKED};
    }
    if (signs->state == HD_SIGNS_TRUSTED) {
        return 0;
    }
    const uint32_t idle = input->idle & ~signs->ignored;
    if (signs->passed) {
        signs->idle = input->enabled ? idle : 0u;
        signs->state = signs->idle != 0 ? HD_SIGNS_WAITING : HD_SIGNS_RIGHT;
        signs->problem = signs->idle != 0 ? HD_SIGNS_IDLE : HD_SIGNS_FINE;
        return signs->idle != 0;
    }
    if (!input->enabled) {
        if (signs->state == HD_SIGNS_CHECKING || signs->state == HD_SIGNS_WAITING) {
            signs->state = HD_SIGNS_UNCHECKED;
            signs->problem = HD_SIGNS_FINE;
        }
        return 0;
    }
    if (signs->state == HD_SIGNS_WRONG) {
        return 1;
    }
    const int begins = signs->state == HD_SIGNS_UNCHECKED || signs->state == HD_SIGNS_UNCLEAR;
    if (begins || idle != signs->idle) {
        signs->idle = idle;
        begin_axis(signs, !begins ? signs->axis : (signs->of.axes & 1u) != 0 ? 0u : 1u);
    }
    if (idle != 0) {
        wait_for(signs, HD_SIGNS_IDLE);
    }
    if (input->gain > 0.0) {
        return 1;
    }
    if (input->contact) {
        restart_round(signs);
        wait_for(signs, HD_SIGNS_CONTACT);
        return 1;
    }
    if (input->jumped) {
        restart_round(signs);
        return 1;
    }
    const uint32_t axis = signs->axis;
    advance_phase(signs, input);
    force_n[axis] = signs->force_n;
    return 1;
}

HD_RT void hd_signs_watch(struct hd_signs *signs, const struct hd_look *look, struct hd_state *state,
                          const struct hd_table *table, struct hd_input *input) {
    if (look->connection == 0) { /* the device is not known yet */
        input->checking = state->enabled;
        return;
    }
    const struct hd_signs_input signs_input = {
        .position_m = {input->position_m[0], input->position_m[1]},
        .elapsed_s = (double)input->periods * table->period_s,
        .gain = state->gain,
        .max_force_n = table->max_force_n,
        .ramp_s = table->ramp_s,
        .enabled = state->enabled,
        .contact = state->active_count > 0,
        .jumped = !state->located || input->glitch_m_per_s > 0.0,
        .idle = look->idle,
    };
    input->checking = (uint32_t)hd_signs_step(signs, look->signs, &signs_input, input->check_n);
    if (state->enabled && (signs->state == HD_SIGNS_WRONG || signs->state == HD_SIGNS_UNCLEAR)) {
        hd_state_latch(state, HD_FAULT_SIGNS, 1, input->time_ns);
    }
}

HD_RT uint32_t hd_signs_told(const struct hd_signs *signs) {
    return signs->state | signs->problem << HD_SIGNS_PROBLEM_SHIFT | signs->axis << HD_SIGNS_AXIS_SHIFT |
           signs->idle << HD_SIGNS_IDLE_SHIFT;
}

struct hd_signs *hd_signs_new(void) {
    return calloc(1, sizeof(struct hd_signs));
}

void hd_signs_free(struct hd_signs *signs) {
    free(signs);
}

uint32_t hd_signs_try(struct hd_signs *signs, const struct hd_hid_signs *of, const struct hd_signs_input *input,
                      double force_n[2]) {
    hd_signs_step(signs, of, input, force_n);
    return hd_signs_told(signs);
}
