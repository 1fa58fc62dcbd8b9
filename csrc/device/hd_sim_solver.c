/* The exact motion of the simulated handle: a handle on an actuator, held by a hand that follows a reference. */
// clang-format off
/* The two axes are alike and independent. Handle and hand move as one mass M = m + m_h:
 *
 *     M x'' = F - b x' - b_h (x' - w') - k (x - w) - c sign(x')
 *
 * where w(t) is the reference, a polynomial in each segment. The solution is exact in time. Let J_j(h) be the position
 * that the force s^j/j! has caused h seconds after rest (J_-1: an impulse). Then, with B = b + b_h,
 *
 *     J_j' = J_{j-1},    M J_{j-2} + B J_{j-1} + k J_j = h^j/j!
 *
 *     x(h) = x + h v + J_0  r_0 + J_1 r_1 + J_2 g_2 + ... + J_5 g_5
 *     v(h) =       v + J_-1 r_0 + J_0 r_1 + J_1 g_2 + ... + J_4 g_5
 *
 *     r_0 = F -+ c + k (w - x) + b_h (w' - v) - b v
 *     r_1 =          k (w' - v) + b_h w''
 *     g_j =          k w^(j)    + b_h w^(j+1)
 *
 * is the solution for any damping, including k = 0 or B = 0, without a distinction of cases. Written as increments it
 * keeps an equilibrium to the last bit, whereas exp(A T) loses eps/(w T)^2 of it. J_5 and J_4 are summed as power
 * series, and the others follow by downward recursion. Both are exact to rounding while max(B/M, sqrt(k/M)) h <= 1/2,
 * so longer steps are split. The J of one servo period are computed once; those of a part of a period are computed for
 * it.
 *
 * Such a step is valid if it contains no event. Events within a step are located on the solution itself and split the
 * step there: the velocity crosses zero (then friction holds the handle, or the motion turns), the handle meets a stop
 * (and rests there: inelastic), or the force on a resting handle exceeds the friction. Within one step the net force
 * changes its sign at most once (curved segments are split further to ensure this), so no event can be missed between
 * two checks. A jump of the reference acts through the spring only, not through the damper.
 *
 * The force of a lagging actuator (hd_actuator.h) is not constant within a step, but approaches a constant. Steps are
 * then at most half of the actuator's time constant, and the effect of the lag in a step is exact. Two turns of the
 * handle within one such step may be missed; they need a force that crosses zero twice within half a time constant. */
// clang-format on
#include "device/hd_sim_state.h"

#include <math.h>

/* Largest number of events of one axis in one step. More than a few need forces that balance to the last bit; the axis
 * then rests until the end of the step. */
#define HD_AXIS_EVENTS_MAX 16
#define HD_MAX_LOCATE_ITERATIONS 100
/* Values below this, in m, m/s or N, become zero, so that they do not decay into subnormal numbers. */
#define HD_NEGLIGIBLE 1e-30

/* ---- One step -------------------------------------------------------------------------------------------------- */

HD_RT void hd_sim_kernel_at(const struct hd_sim *sim, double span_s, struct hd_kernel *kernel) {
    const double h = span_s;
    const double per_mass = 1.0 / sim->mass_kg;
    const double damping = sim->damping + sim->hand_damping;
    double sum[2] = {0.0, 0.0};
    for (int n = HD_SERIES_TERMS - 1; n >= 0; n--) {
        sum[0] = sum[0] * h + sim->series[0][n];
        sum[1] = sum[1] * h + sim->series[1][n];
    }
    double power[6]; /* h^j/j! */
    power[0] = 1.0;
    power[1] = h;
    power[2] = h * h / 2.0;
    power[3] = power[2] * h / 3.0;
    power[4] = power[3] * h / 4.0;
    power[5] = power[4] * h / 5.0;
    double *const j = &kernel->j[1];
    kernel->span_s = h;
    j[4] = sum[0] * power[5] * h;
    j[5] = sum[1] * power[5] * h * h;
    for (int order = 5; order >= 1; order--) {
        j[order - 2] = (power[order] - damping * j[order - 1] - sim->stiffness * j[order]) * per_mass;
    }
    if (h <= sim->lag_limit_s * (1.0 + HD_SAME_TIME)) {
        hd_actuator_step_at(&sim->actuator, h, &kernel->lag);
    }
}

/* Returns the force on the handle at rest, without friction. */
HD_RT static inline double still_force(const struct hd_sim *sim, double force_n,
                                       const double reference[HD_REFERENCE_ORDERS], double x) {
    return force_n + sim->stiffness * (reference[0] - x) + sim->hand_damping * reference[1];
}

/* Sets the commanded force; if the actuator lags, its actual force stays continuous. */
HD_RT void hd_sim_set_force(struct hd_sim *sim, double x_n, double y_n) {
    const double wanted_n[2] = {x_n, y_n};
    for (int which = 0; which < 2; which++) {
        if (sim->actuator.order > 0) {
            sim->off[which].off_n += sim->force_n[which] - wanted_n[which];
        }
        sim->force_n[which] = wanted_n[which];
    }
}

/* Returns the actuator's error after a step. */
HD_RT static struct hd_off off_after(const struct hd_actuator_step *step, const struct hd_off *off) {
    const struct hd_off after = {
        step->off_n[0] * off->off_n + step->off_n[1] * off->off_n_per_s,
        step->off_n_per_s[0] * off->off_n + step->off_n_per_s[1] * off->off_n_per_s,
    };
    const bool over = fabs(after.off_n) + fabs(after.off_n_per_s) < HD_NEGLIGIBLE;
    return over ? (struct hd_off){0.0, 0.0} : after;
}

/* Returns the actuator's error `after_s` later. */
HD_RT static struct hd_off off_at(const struct hd_sim *sim, const struct hd_off *off, double after_s) {
    if (!hd_sim_is_under_way(off)) {
        return *off;
    }
    struct hd_actuator_step step;
    hd_actuator_step_at(&sim->actuator, after_s, &step);
    return off_after(&step, off);
}

HD_RT static inline double net_force(const struct hd_sim *sim, double push_n,
                                     const double reference[HD_REFERENCE_ORDERS], const struct hd_axis *axis) {
    return push_n + sim->stiffness * (reference[0] - axis->x) + sim->hand_damping * (reference[1] - axis->v) -
           sim->damping * axis->v;
}

/* Returns the solution after kernel->span_s; push_n is the sum of the actuator's force and friction, both constant. */
HD_RT static inline struct hd_axis propagated(const struct hd_sim *sim, const struct hd_kernel *kernel, double push_n,
                                              const double reference[HD_REFERENCE_ORDERS], struct hd_axis axis) {
    const double *const j = &kernel->j[1];
    const double net = net_force(sim, push_n, reference, &axis);
    const double rise = sim->stiffness * (reference[1] - axis.v) + sim->hand_damping * reference[2];
    double dx = axis.v * kernel->span_s + j[0] * net + j[1] * rise;
    double dv = j[-1] * net + j[0] * rise;
    if (sim->segment.profile == HD_PROFILE_MINIMUM_JERK) {
        for (int order = 2; order <= 5; order++) {
            const double drive = sim->stiffness * reference[order] + sim->hand_damping * reference[order + 1];
            dx += j[order] * drive;
            dv += j[order - 1] * drive;
        }
    }
    return (struct hd_axis){axis.x + dx, axis.v + dv};
}

/* Adds the contribution of the actuator's lag. */
HD_RT static void add_off(const struct hd_kernel *kernel, const struct hd_off *off, struct hd_axis *axis) {
    const struct hd_actuator_step *lag = &kernel->lag;
    axis->x += lag->x_m[0] * off->off_n + lag->x_m[1] * off->off_n_per_s;
    axis->v += lag->v_m_per_s[0] * off->off_n + lag->v_m_per_s[1] * off->off_n_per_s;
}

/* Returns whether an axis that began a step in one direction, with the force `net_before_n`, certainly kept the
 * direction. */
HD_RT static inline bool keeps_going(const struct hd_sim *sim, int which, double local_s, double direction,
                                     double push_n, double net_before_n, const struct hd_axis *after) {
    if (!(after->v * direction > 0.0 && fabs(after->x) <= sim->workspace_m)) {
        return false;
    }
    if (net_before_n * direction >= 0.0) {
        return true;
    }
    /* The motion slowed down first: if it speeds up at the end, it may have turned twice. */
    double reference[HD_REFERENCE_ORDERS];
    hd_segment_reference(&sim->segment, which, local_s, reference);
    return net_force(sim, push_n, reference, after) * direction <= 0.0;
}

/* step_without_events for a lagging actuator, for moving handles only. */
HD_RT static bool lagging_step_without_events(struct hd_sim *sim, int which, double local_s,
                                              const struct hd_kernel *kernel) {
    struct hd_axis *const axis = &sim->axes[which];
    const struct hd_off *off = &sim->off[which];
    const struct hd_off off_end = off_after(&kernel->lag, off);
    double reference[HD_REFERENCE_ORDERS];
    hd_segment_reference(&sim->segment, which, local_s, reference);
    const double direction = axis->v > 0.0 ? 1.0 : -1.0;
    const double push_n = sim->force_n[which] - direction * sim->coulomb_n;
    struct hd_axis after = propagated(sim, kernel, push_n, reference, *axis);
    add_off(kernel, off, &after);
    if (axis->v == 0.0 || !keeps_going(sim, which, local_s + kernel->span_s, direction, push_n + off_end.off_n,
                                       net_force(sim, push_n + off->off_n, reference, axis), &after)) {
        return false;
    }
    after.v = fabs(after.v) < HD_NEGLIGIBLE ? 0.0 : after.v;
    after.x = fabs(after.x) < HD_NEGLIGIBLE ? 0.0 : after.x;
    *axis = after;
    sim->off[which] = off_end;
    return true;
}

/* Makes a step without events. Returns false, without a change, if an event is possible. */
HD_RT static inline bool step_without_events(struct hd_sim *sim, int which, double local_s,
                                             const struct hd_kernel *kernel) {
    if (hd_sim_is_under_way(&sim->off[which])) {
        return lagging_step_without_events(sim, which, local_s, kernel);
    }
    struct hd_axis *const axis = &sim->axes[which];
    const double force_n = sim->force_n[which];
    const double friction_n = sim->coulomb_n;
    double reference[HD_REFERENCE_ORDERS];
    double reference_after[HD_REFERENCE_ORDERS];
    hd_segment_reference(&sim->segment, which, local_s, reference);
    if (axis->v == 0.0) {
        /* The force on a resting handle is monotonic along a straight reference; a curved one is left to
         * step_with_events. */
        if (sim->segment.profile == HD_PROFILE_MINIMUM_JERK || fabs(axis->x) >= sim->workspace_m ||
            fabs(still_force(sim, force_n, reference, axis->x)) > friction_n) {
            return false;
        }
        if (sim->segment.profile == HD_PROFILE_HOLD) {
            return true;
        }
        hd_segment_reference(&sim->segment, which, local_s + kernel->span_s, reference_after);
        return fabs(still_force(sim, force_n, reference_after, axis->x)) <= friction_n;
    }
    const double direction = axis->v > 0.0 ? 1.0 : -1.0;
    const double push_n = force_n - direction * friction_n;
    struct hd_axis after = propagated(sim, kernel, push_n, reference, *axis);
    /* Far from the stops and without friction a turn is not an event. */
    const double reach_m = 2.0 * kernel->span_s * (fabs(axis->v) + fabs(after.v));
    if (!(friction_n == 0.0 && fabs(after.x) + reach_m < sim->workspace_m) &&
        !keeps_going(sim, which, local_s + kernel->span_s, direction, push_n, net_force(sim, push_n, reference, axis),
                     &after)) {
        return false;
    }
    after.v = fabs(after.v) < HD_NEGLIGIBLE ? 0.0 : after.v;
    after.x = fabs(after.x) < HD_NEGLIGIBLE ? 0.0 : after.x;
    *axis = after;
    return true;
}

/* ---- Events within a step -------------------------------------------------------------------------------------- */

/* A motion in one direction, or a rest, that begins at an event. */
struct hd_motion {
    int which;
    double direction; /* 1 or -1 */
    double local_s;   /* time of its beginning after the segment's start */
    double push_n;
    struct hd_axis axis;
    struct hd_off off;
};

/* The zero crossing that is located: of a value that is positive first, then negative. */
enum hd_crossing {
    HD_CROSSING_TURN,    /* speed */
    HD_CROSSING_SLOWEST, /* deceleration */
    HD_CROSSING_STOP,    /* distance to the stop */
    HD_CROSSING_RELEASE  /* friction that remains to hold the handle at rest */
};

HD_RT static struct hd_axis motion_at(const struct hd_sim *sim, const struct hd_motion *motion, double after_s) {
    struct hd_kernel kernel;
    double reference[HD_REFERENCE_ORDERS];
    hd_sim_kernel_at(sim, after_s, &kernel);
    hd_segment_reference(&sim->segment, motion->which, motion->local_s, reference);
    struct hd_axis axis = propagated(sim, &kernel, motion->push_n, reference, motion->axis);
    if (hd_sim_is_under_way(&motion->off)) {
        add_off(&kernel, &motion->off, &axis);
    }
    return axis;
}

HD_RT static void crossing_at(const struct hd_sim *sim, const struct hd_motion *motion, enum hd_crossing crossing,
                              double after_s, double *value, double *slope) {
    double reference[HD_REFERENCE_ORDERS];
    hd_segment_reference(&sim->segment, motion->which, motion->local_s + after_s, reference);
    const struct hd_off off = off_at(sim, &motion->off, after_s);
    if (crossing == HD_CROSSING_RELEASE) {
        *value = sim->coulomb_n -
                 motion->direction * still_force(sim, motion->push_n + off.off_n, reference, motion->axis.x);
        *slope =
            -motion->direction * (sim->stiffness * reference[1] + sim->hand_damping * reference[2] + off.off_n_per_s);
        return;
    }
    const struct hd_axis axis = motion_at(sim, motion, after_s);
    const double net = net_force(sim, motion->push_n + off.off_n, reference, &axis);
    if (crossing == HD_CROSSING_TURN) {
        *value = motion->direction * axis.v;
        *slope = motion->direction * net / sim->mass_kg;
    } else if (crossing == HD_CROSSING_SLOWEST) {
        const double acceleration = net / sim->mass_kg;
        *value = -motion->direction * net;
        *slope = -motion->direction * (sim->stiffness * (reference[1] - axis.v) + sim->hand_damping * reference[2] -
                                       (sim->hand_damping + sim->damping) * acceleration + off.off_n_per_s);
    } else {
        *value = sim->workspace_m - motion->direction * axis.x;
        *slope = -motion->direction * axis.v;
    }
}

/* Returns when the value crosses zero between low_s and high_s, by Newton's method, with bisection if it leaves the
 * bracket. */
HD_RT static double locate_crossing(const struct hd_sim *sim, const struct hd_motion *motion, enum hd_crossing crossing,
                                    double low_s, double high_s) {
    const double tolerance_s = 2e-16 * high_s;
    double guess_s = 0.5 * (low_s + high_s);
    for (int i = 0; i < HD_MAX_LOCATE_ITERATIONS && high_s - low_s > tolerance_s; i++) {
        double value;
        double slope;
        crossing_at(sim, motion, crossing, guess_s, &value, &slope);
        if (fabs(value) <= fabs(slope) * tolerance_s) {
            break;
        }
        if (value > 0.0) {
            low_s = guess_s;
        } else {
            high_s = guess_s;
        }
        const double next_s = guess_s - value / slope;
        guess_s = next_s > low_s && next_s < high_s ? next_s : 0.5 * (low_s + high_s);
    }
    return guess_s;
}

/* Returns whether a motion ends by a turn within *span_s; if so, sets *span_s to the time of the turn. */
HD_RT static bool turns_within(const struct hd_sim *sim, const struct hd_motion *motion, double *span_s) {
    double last_s = *span_s;
    double value;
    double slope;
    crossing_at(sim, motion, HD_CROSSING_TURN, last_s, &value, &slope);
    if (value >= 0.0) {
        /* The motion may have turned twice, if it slowed down first and speeds up at the end. */
        if (motion->axis.v == 0.0 || slope <= 0.0) {
            return false;
        }
        crossing_at(sim, motion, HD_CROSSING_SLOWEST, 0.0, &value, &slope);
        if (value <= 0.0) {
            return false;
        }
        last_s = locate_crossing(sim, motion, HD_CROSSING_SLOWEST, 0.0, last_s);
        crossing_at(sim, motion, HD_CROSSING_TURN, last_s, &value, &slope);
        if (value >= 0.0) {
            return false;
        }
    }
    *span_s = locate_crossing(sim, motion, HD_CROSSING_TURN, 0.0, last_s);
    return true;
}

/* Returns when the force on a resting handle is extreme along a curved segment: k w' + b_h w'' = 0, which has one root
 * inside of the segment (s (1 - s) is positive there and 1 - 2 s falls). Without a hand there is no root, and the end
 * is returned. */
HD_RT static double extreme_force_s(const struct hd_sim *sim) {
    const double elastic = 0.5 * sim->stiffness * sim->segment.duration_s;
    const double viscous = sim->hand_damping;
    if (!(elastic + viscous > 0.0)) {
        return sim->segment.duration_s;
    }
    HD_RT_FOREIGN_BEGIN
    const double root = sqrt(elastic * elastic + 4.0 * viscous * viscous);
    HD_RT_FOREIGN_END
    /* elastic s (1 - s) + viscous (1 - 2 s) = 0: its root between 0 and 1, in the form without cancellation. */
    const double more = elastic - 2.0 * viscous;
    return sim->segment.duration_s * (more > 0.0 ? 0.5 * (more + root) / elastic : 2.0 * viscous / (root - more));
}

/* Returns the direction, 1 or -1, in which a resting handle is pushed more than friction and stops can hold, or 0. */
HD_RT static double release_direction(const struct hd_sim *sim, int which, double local_s, double after_s) {
    const struct hd_axis *axis = &sim->axes[which];
    const double off_n = off_at(sim, &sim->off[which], after_s).off_n;
    double reference[HD_REFERENCE_ORDERS];
    hd_segment_reference(&sim->segment, which, local_s + after_s, reference);
    const double force_n = still_force(sim, sim->force_n[which] + off_n, reference, axis->x);
    if (force_n > sim->coulomb_n && axis->x < sim->workspace_m) {
        return 1.0;
    }
    if (force_n < -sim->coulomb_n && axis->x > -sim->workspace_m) {
        return -1.0;
    }
    return 0.0;
}

/* Returns whether the rest that begins at local_s ends within left_s; if so, after *rest_s, with a motion in
 * *direction. */
HD_RT static bool rest_ends(const struct hd_sim *sim, int which, double local_s, double left_s, double *rest_s,
                            double *direction) {
    *rest_s = 0.0;
    *direction = release_direction(sim, which, local_s, 0.0);
    if (*direction != 0.0) {
        return true;
    }
    if (sim->segment.profile == HD_PROFILE_HOLD && !hd_sim_is_under_way(&sim->off[which])) {
        return false;
    }
    double check_s[2] = {left_s, left_s};
    if (sim->segment.profile == HD_PROFILE_MINIMUM_JERK) {
        const double extreme_s = extreme_force_s(sim) - local_s;
        if (extreme_s > 0.0 && extreme_s < left_s) {
            check_s[0] = extreme_s;
        }
    }
    double quiet_s = 0.0;
    for (int i_check = 0; i_check < 2; i_check++) {
        *direction = release_direction(sim, which, local_s, check_s[i_check]);
        if (*direction != 0.0) {
            const struct hd_motion rest = {which,          *direction, local_s, sim->force_n[which], sim->axes[which],
                                           sim->off[which]};
            *rest_s = locate_crossing(sim, &rest, HD_CROSSING_RELEASE, quiet_s, check_s[i_check]);
            return true;
        }
        quiet_s = check_s[i_check];
    }
    return false;
}

/* Makes a step with all its events. */
HD_RT static void step_with_events(struct hd_sim *sim, int which, double local_s, double span_s) {
    struct hd_axis *const axis = &sim->axes[which];
    struct hd_off *const off = &sim->off[which];
    double left_s = span_s;
    for (int events = 0; events < HD_AXIS_EVENTS_MAX && left_s > 0.0; events++) {
        struct hd_motion motion = {.which = which, .direction = axis->v > 0.0 ? 1.0 : -1.0};
        if (axis->v == 0.0) {
            double rest_s;
            if (!rest_ends(sim, which, local_s, left_s, &rest_s, &motion.direction)) {
                *off = off_at(sim, off, left_s);
                return;
            }
            *off = off_at(sim, off, rest_s);
            local_s += rest_s;
            left_s -= rest_s;
        }
        motion.local_s = local_s;
        motion.push_n = sim->force_n[which] - motion.direction * sim->coulomb_n;
        motion.axis = *axis;
        motion.off = *off;

        double end_s = left_s;
        const bool turns = turns_within(sim, &motion, &end_s);
        struct hd_axis end = motion_at(sim, &motion, end_s);
        if (turns) {
            end.v = 0.0;
        }
        /* Until end_s the motion has one direction. */
        if (end.x * motion.direction > sim->workspace_m) {
            end_s = locate_crossing(sim, &motion, HD_CROSSING_STOP, 0.0, end_s);
            end = (struct hd_axis){motion.direction * sim->workspace_m, 0.0};
        }
        *axis = end;
        *off = off_at(sim, off, end_s);
        local_s += end_s;
        left_s -= end_s;
        if (end.v != 0.0) {
            return;
        }
    }
    axis->v = 0.0;
    *off = off_at(sim, off, left_s);
}

HD_RT void hd_sim_solve(struct hd_sim *sim, double local_s, const struct hd_kernel *kernel) {
    for (int which = 0; which < 2; which++) {
        if (!step_without_events(sim, which, local_s, kernel)) {
            step_with_events(sim, which, local_s, kernel->span_s);
        }
    }
}
