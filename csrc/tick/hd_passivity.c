/* The passivity observer and controller: sums the work of a contact and limits the force so that the sum does not
 * become positive. Two estimates of the work of a tick's force are available to the controller: the work at the
 * estimated velocity, which limits the force along the motion, and the largest work of any motion below v_max, which
 * limits the magnitude of the force. */
#include "tick/hd_passivity.h"

#include "base/hd_vector.h"
#include "tick/hd_limit.h"
#include "tick/hd_state.h"

#define HD_WAITED_MAX 0x7fffffffu
/* Factor on positive work in the magnitude bound: with rounded positions a force that alternates between two encoder
 * steps can have done more work than the sum shows. */
#define HD_ROUNDED_WORK_FACTOR 1.25

/* Sums the force commanded in `count` periods, the last of them `ago` periods ago. Before the contact it was 0. */
HD_RT static void sum_pushes(const struct hd_passivity *passivity, uint32_t ago, uint32_t count, struct hd_push *sum) {
    *sum = (struct hd_push){.force_n = {0.0, 0.0}};
    for (uint32_t i = 0; i < count && ago + i < passivity->pushed; i++) {
        const struct hd_push *push = &passivity->pushes[(passivity->newest - ago - i) % HD_PASSIVITY_PERIODS];
        sum->force_n[0] += push->force_n[0];
        sum->force_n[1] += push->force_n[1];
        sum->size_n += push->size_n;
    }
}

/* Returns the energy that damping and dry friction of the handle dissipate on the path to a new sample, J. */
HD_RT static double handle_dissipation_j(const struct hd_table *table, const struct hd_input *input,
                                         const double displacement_m[2]) {
    const double viscous_j = table->handle_damping_n_s_per_m * hd_dot(input->velocity_m_per_s, displacement_m);
    return (viscous_j > 0.0 ? viscous_j : 0.0) +
           table->handle_friction_n * (hd_magnitude(displacement_m[0]) + hd_magnitude(displacement_m[1]));
}

/* Records the periods since the last tick, and if there is a new sample, adds the work of the displacement to it. */
HD_RT static void add_work(struct hd_passivity *passivity, const struct hd_state *state, const struct hd_table *table,
                           const struct hd_input *input) {
    const uint32_t passed = input->periods < HD_PASSIVITY_PERIODS ? input->periods : HD_PASSIVITY_PERIODS;
    for (uint32_t i = 0; i < passed; i++) {
        passivity->newest = (passivity->newest + 1u) % HD_PASSIVITY_PERIODS;
        passivity->pushes[passivity->newest] = passivity->held;
    }
    passivity->pushed =
        passivity->pushed < HD_PASSIVITY_PERIODS - passed ? passivity->pushed + passed : HD_PASSIVITY_PERIODS;
    passivity->waited = passivity->waited < HD_WAITED_MAX ? passivity->waited + passed : HD_WAITED_MAX;
    const int fresh = input->interval_s > 0.0;
    const uint32_t interval = fresh ? passivity->waited : passivity->waited + 1u;
    passivity->interval = interval > passivity->interval ? interval : passivity->interval;
    passivity->hold = passed > passivity->hold ? passed : passivity->hold;
    if (fresh) {
        struct hd_push sum;
        double displacement_m[2];
        sum_pushes(passivity, table->report_age, passivity->waited, &sum);
        hd_difference(input->position_m, state->position_m, displacement_m);
        passivity->energy_j += hd_dot(sum.force_n, displacement_m) / (double)passivity->waited;
        passivity->taken_j += handle_dissipation_j(table, input, displacement_m);
        passivity->largest_j = passivity->energy_j > passivity->largest_j ? passivity->energy_j : passivity->largest_j;
        passivity->waited = 0;
    }
}

/* Limits the force along the motion so that the next period gives back at most the energy that was taken. If more was
 * given than taken, the force brakes with up to `brake_n_s_per_m`. A force that already resists more stays unchanged.
 * Returns 1 if it changed the force. */
HD_RT static int restrain_along_motion(const struct hd_passivity *passivity, const struct hd_table *table,
                                       double brake_n_s_per_m, const struct hd_push *pending, const double velocity[2],
                                       double force_n[2]) {
    const double square = hd_dot(velocity, velocity);
    if (!(square > 0.0)) {
        return 0;
    }
    const double speed = hd_root(square);
    const double along_n = hd_dot(force_n, velocity) / speed;
    const double given_j =
        passivity->energy_j - passivity->taken_j + table->period_s * hd_dot(pending->force_n, velocity);
    const double brake_n = -brake_n_s_per_m * speed;
    double allowed_n = -given_j / (speed * table->period_s);
    allowed_n = allowed_n > brake_n ? allowed_n : brake_n;
    if (!(along_n > allowed_n)) {
        return 0;
    }
    const double change = (allowed_n - along_n) / speed;
    force_n[0] += change * velocity[0];
    force_n[1] += change * velocity[1];
    return 1;
}

/* Limits the magnitude of the force by the bound of the work, for displacements of at most v_max times the period. The
 * forces whose displacements are not known yet use part of the bound; the rest is for this force, which may be held for
 * as long as ticks were missed before. Returns 1 if it changed the force. */
HD_RT static int bound_magnitude(const struct hd_passivity *passivity, const struct hd_table *table,
                                 const struct hd_push *pending, double force_n[2]) {
    const double reach_m = table->max_speed_m_per_s * table->period_s;
    const double hold = (double)passivity->hold;
    const double periods = (double)passivity->interval + (double)table->report_age + (hold - 1.0);
    const double given_j =
        passivity->energy_j > 0.0 ? HD_ROUNDED_WORK_FACTOR * passivity->energy_j : passivity->energy_j;
    const double left_n = (table->max_force_n * periods - given_j / reach_m - pending->size_n) / hold;
    const double limit_n = left_n > 0.0 ? left_n : 0.0;
    const double square = hd_dot(force_n, force_n);
    if (square <= limit_n * limit_n) {
        return 0;
    }
    const double factor = HD_JUST_BELOW * limit_n / hd_root(square);
    force_n[0] *= factor;
    force_n[1] *= factor;
    return 1;
}

/* Applies the controller to a force: projects the force of objects onto a half-plane and then onto a disc, neither of
 * which depends on the force, so that the distance between two forces never grows. Returns 1 if it changed the force.
 */
HD_RT static int apply_controller(const struct hd_passivity *passivity, const struct hd_table *table,
                                  double brake_n_s_per_m, const struct hd_push *pending, const double velocity[2],
                                  const struct hd_pushed *pushed) {
    double force_n[2] = {pushed->object_n[0], pushed->object_n[1]};
    const int restrained = restrain_along_motion(passivity, table, brake_n_s_per_m, pending, velocity, force_n);
    if (!bound_magnitude(passivity, table, pending, force_n) && !restrained) {
        return 0;
    }
    for (int axis = 0; axis < 2; axis++) {
        const double object_n = pushed->object_n[axis];
        const double given_n =
            pushed->weight < 1.0 ? object_n + pushed->weight * (force_n[axis] - object_n) : force_n[axis];
        pushed->contact_n[axis] = (pushed->contact_n[axis] - object_n) + given_n;
        pushed->object_n[axis] = given_n;
    }
    return 1;
}

HD_RT void hd_passivity_tick(struct hd_state *state, const struct hd_table *table, const struct hd_input *input,
                             int restart, const struct hd_pushed *is, const struct hd_pushed *still, uint32_t *flags) {
    struct hd_passivity *passivity = &state->passivity;
    if (restart || passivity->next != state->tick) {
        passivity->running = 0;
        passivity->energy_j = 0.0;
    }
    const int touched = state->active_count > 0 || is->object_n[0] != 0.0 || is->object_n[1] != 0.0;
    struct hd_push pending = {.size_n = 0.0};
    const int ran = passivity->running;
    if (ran) {
        add_work(passivity, state, table, input);
        sum_pushes(passivity, 0, table->report_age + passivity->waited, &pending);
        passivity->running = touched || pending.size_n > 0.0;
    }
    if (!touched) {
        /* A residual that ends in this tick would still act with every ramp stopped. */
        if (ran && still->weight > 0.0 && (still->object_n[0] != 0.0 || still->object_n[1] != 0.0)) {
            apply_controller(passivity, table, passivity->brake * table->brake_n_s_per_m, &pending,
                             input->velocity_m_per_s, still);
        }
        return;
    }
    if (!passivity->running) {
        passivity->running = 1;
        passivity->acting = 0;
        passivity->brake = 1.0;
        passivity->contacts++;
        passivity->energy_j = 0.0;
        passivity->taken_j = 0.0;
        if (state->located && !restart && input->interval_s > 0.0) {
            /* The path into the surface was covered before the first force, so the spring holds energy that no motion
             * did work for. The dissipation of the handle on that path counts against it. */
            double displacement_m[2];
            hd_difference(input->position_m, state->position_m, displacement_m);
            passivity->taken_j = handle_dissipation_j(table, input, displacement_m);
        }
        passivity->interval = 1;
        passivity->hold = 1;
        passivity->pushed = 0;
        passivity->waited = 0;
    }
    /* While only a residual is left, the brake is ramped down, since it would otherwise end in a step with it. */
    const double braked = passivity->brake;
    const double more = braked + table->ramp_step;
    const double less = braked - table->ramp_step;
    passivity->brake = state->active_count > 0 ? (more < 1.0 ? more : 1.0) : (less > 0.0 ? less : 0.0);
    if (still->weight > 0.0) {
        apply_controller(passivity, table, braked * table->brake_n_s_per_m, &pending, input->velocity_m_per_s, still);
    }
    if (is->weight > 0.0 && apply_controller(passivity, table, passivity->brake * table->brake_n_s_per_m, &pending,
                                             input->velocity_m_per_s, is)) {
        passivity->acted++;
        passivity->restrained += passivity->acting ? 0u : 1u;
        passivity->acting = 1;
        *flags |= HD_FLAG_RESTRAINED;
    }
}

HD_RT void hd_passivity_hold(struct hd_passivity *passivity, const struct hd_table *table, uint64_t tick, double gain,
                             const double object_n[2], const double contact_n[2]) {
    passivity->next = tick + 1u;
    if (!passivity->running) {
        return;
    }
    const double limit = table->max_force_n;
    const double square = hd_dot(contact_n, contact_n);
    /* A contact force above the limit is cut in its direction. */
    const double part = square <= limit * limit ? gain : gain * limit / hd_root(square);
    struct hd_push *held = &passivity->held;
    held->force_n[0] = part * object_n[0];
    held->force_n[1] = part * object_n[1];
    held->size_n = hd_root(hd_dot(held->force_n, held->force_n));
}
