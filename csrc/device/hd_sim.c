/* The simulated joystick: a handle on an actuator and an encoder, held by a hand that follows an operator's wish.
 *
 * The two axes are alike and independent. Handle and hand move as one mass M = m + m_h:
 *
 *     M x'' = F - b x' - b_h (x' - w') - k (x - w) - c sign(x')          w(t): the wish, a polynomial in each segment
 *
 * Nothing is approximated in time. Let J_j(h) be the position that the force s^j/j! has caused after h seconds from
 * rest (J_-1: an impulse). Then J_j' = J_{j-1}, M J_{j-2} + B J_{j-1} + k J_j = h^j/j! with B = b + b_h, and
 *
 *     x(h) = x + h v + J_0 r_0 + J_1 r_1 + J_2 g_2 + ... + J_5 g_5          r_0 = F -+ c + k (w - x) + b_h (w' - v) - b
 * v v(h) =     v + J_-1 r_0 + J_0 r_1 + J_1 g_2 + ... + J_4 g_5           r_1 = k (w' - v) + b_h w'' g_j = k w^(j) +
 * b_h w^(j+1)
 *
 * is the solution, whatever the damping, k = 0 or B = 0 among it: there are no cases. Written as increments it keeps an
 * equilibrium to the last bit, where exp(A T) itself would lose eps/(w T)^2 of it. J_5 and J_4 are summed as power
 * series and the others follow downwards; both are exact to rounding while max(B/M, sqrt(k/M)) h <= 1/2, so longer
 * steps are taken in parts. The J of one servo period are made once; a part of a period gets its own.
 *
 * Such a step holds while nothing happens. What can happen is found on the solution itself and splits the step there:
 * the velocity passes zero (then friction holds, or the motion turns), the handle meets a stop (and rests there:
 * inelastic), the force on a resting handle exceeds the friction, the wish enters another segment, the force expires,
 * another arrives, a report is due. Within one part the net force changes its sign at most once (hd_segment courses are
 * cut further for that), so that an event cannot hide between two looks. A jump of the wish moves the spring only; its
 * damper is not struck.
 *
 * Where the actuator lags (hd_actuator.h) its force is not constant within a part, but goes to a constant; parts are at
 * most half a time constant of it, and what it does in one is exact. Two turns of the handle within one such part may
 * then go unseen, which takes a force that passes zero twice in half a time constant.
 *
 * Behind a link a force acts at a later frame. That frame is known when the force is put, so that what is under way is
 * a short row of forces and their times, each another event; a put that comes before the frame of the last one leaves
 * takes its place.
 *
 * Times are counted in servo periods, and for reports and frames in 2^-24 of a period, so nothing accumulates. SI
 * units. Control makes and frees a simulation; one thread at a time runs it. */
#include "device/hd_sim.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "device/hd_actuator.h"
#include "device/hd_operator.h"

/* The longest step, as max(B/M, sqrt(k/M)) h, and the terms of the series that give 1e-17 there. */
#define HD_STEP_MAX 0.5
#define HD_SERIES_TERMS 14
/* A step is cut into this many parts at most; a device that needs more at its rate is refused. */
#define HD_PARTS_MAX 2000
/* Events of one axis in one part. More than a few need forces that balance to the last bit; it then rests to the part's
 * end. */
#define HD_AXIS_EVENTS_MAX 16
#define HD_LOCATE_MAX 100
#define HD_STRETCH_MAX 1048576u
/* Times closer than this part of a period are the same. */
#define HD_SAME_TIME 1e-9
/* Below this a motion is over: nothing may decay into subnormal numbers. */
#define HD_NOTHING 1e-30
/* Reports under way, a power of two. */
#define HD_REPORTS 2048u
#define HD_REPORT_SHIFT 24
#define HD_REPORT_UNIT (1.0 / 16777216.0)
#define HD_REPORTS_A_PERIOD_MAX 64.0
/* Adding and subtracting it rounds to the nearest integer, up to 2^51. */
#define HD_ROUND_MAGIC 6755399441055744.0
#define HD_STEPS_MAX 1125899906842624.0
/* The fastest that a handle is placed; beyond, products overflow. */
#define HD_PLACED_MAX_M_PER_S 1e6

struct hd_kernel {
    double span_s;
    double j[7]; /* J_-1 to J_5 */
    struct hd_actuator_step lag;
};

struct hd_axis {
    double x;
    double v;
};

/* What a lagging actuator exerts more than it was told, and its derivative: see hd_actuator.h. */
struct hd_off {
    double off_n;
    double off_n_per_s;
};

struct hd_report {
    double position_m[2];
    double velocity_m_per_s[2];
};

/* A force on its way to the actuator. */
struct hd_sent {
    double force_n[2];
    uint64_t at; /* when it acts, in 2^-24 of a period since report_tick */
};

struct hd_sim {
    /* The device and the hand: constant. */
    double period_s;
    double mass_kg;
    double damping; /* of the handle, b */
    double hand_damping;
    double stiffness; /* k */
    double coulomb_n;
    double workspace_m;
    double encoder_step_m;
    double encoder_per_m;
    double force_step_n;
    double force_per_n;
    double force_top; /* in N, or in steps where the force has a resolution */
    double force_timeout_s;
    uint64_t force_whole_periods; /* after a put, before it expires */
    double limit_s;               /* the longest step of this device */
    struct hd_kernel period;      /* one period, or its equal parts */
    struct hd_kernel lagging;     /* the same while the actuator is under way */
    uint32_t stretch_periods;     /* several periods in one step */
    struct hd_kernel stretch;
    double series[2][HD_SERIES_TERMS]; /* of J_4 and J_5 */
    struct hd_actuator actuator;
    double lag_limit_s; /* the longest step while it is under way; 0: it never is */

    /* The motion. */
    struct hd_axis axes[2];
    struct hd_off off[2];
    double force_n[2];
    uint64_t tick;     /* periods since the start */
    uint64_t put_tick; /* the force has acted since then, and as much later in that period: */
    double put_late_s;

    /* The link of forces; times as those of reports. */
    uint64_t force_interval; /* 0: there is none */
    uint64_t force_intervals;
    uint64_t arrive_at; /* when the next one arrives; UINT64_MAX: none is under way */
    uint32_t sent_first;
    uint32_t sent_count;
    struct hd_sent sent[HD_SIM_FORCES]; /* a ring, in order of time */

    /* The wish. */
    const struct hd_operator *path; /* NULL: it rests */
    size_t path_index;
    uint64_t path_tick;
    double path_end_s; /* of the last waypoint */
    bool path_told;    /* nobody waits to be told of the path's end */
    struct hd_segment segment;
    double segment_limit_s; /* limit_s, or less where the wish is curved */
    uint64_t calm_tick;     /* periods that begin before it lie in this segment and need one step */

    /* Reports; times in 2^-24 of a period since report_tick. */
    double report_interval_s;
    uint64_t report_interval;
    uint64_t report_delay;
    uint64_t report_tick;
    uint64_t report_count; /* reports made: the number of the next */
    uint64_t report_at;    /* when the next is made */
    uint64_t read_number;  /* the newest that could be read */
    uint64_t read_next_at; /* when the one after it can be read */
    bool read_before;
    struct hd_report reports[HD_REPORTS];
};

/* ---- One step -------------------------------------------------------------------------------------------------- */

HD_RT static void kernel_at(const struct hd_sim *sim, double span_s, struct hd_kernel *kernel) {
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

/* The force on the handle where it stands still, friction aside. */
HD_RT static inline double still_force(const struct hd_sim *sim, double force_n, const double wish[HD_WISH_ORDERS],
                                       double x) {
    return force_n + sim->stiffness * (wish[0] - x) + sim->hand_damping * wish[1];
}

/* The actuator is told another force: its own goes on without a step, where it lags. */
HD_RT static inline void tell(struct hd_sim *sim, double x_n, double y_n) {
    const double told_n[2] = {x_n, y_n};
    for (int which = 0; which < 2; which++) {
        if (sim->actuator.order > 0) {
            sim->off[which].off_n += sim->force_n[which] - told_n[which];
        }
        sim->force_n[which] = told_n[which];
    }
}

HD_RT static inline bool is_under_way(const struct hd_off *off) {
    return off->off_n != 0.0 || off->off_n_per_s != 0.0;
}

HD_RT static inline bool lags(const struct hd_sim *sim) {
    return sim->actuator.order > 0 && (is_under_way(&sim->off[0]) || is_under_way(&sim->off[1]));
}

/* What the actuator is off by, a step later. */
HD_RT static struct hd_off off_after(const struct hd_actuator_step *step, const struct hd_off *off) {
    const struct hd_off after = {
        step->off_n[0] * off->off_n + step->off_n[1] * off->off_n_per_s,
        step->off_n_per_s[0] * off->off_n + step->off_n_per_s[1] * off->off_n_per_s,
    };
    const bool over = fabs(after.off_n) + fabs(after.off_n_per_s) < HD_NOTHING;
    return over ? (struct hd_off){0.0, 0.0} : after;
}

/* The same of a handle that rests or is on its way, `after_s` later. */
HD_RT static struct hd_off off_at(const struct hd_sim *sim, const struct hd_off *off, double after_s) {
    if (!is_under_way(off)) {
        return *off;
    }
    struct hd_actuator_step step;
    hd_actuator_step_at(&sim->actuator, after_s, &step);
    return off_after(&step, off);
}

HD_RT static inline double net_force(const struct hd_sim *sim, double push_n, const double wish[HD_WISH_ORDERS],
                                     const struct hd_axis *axis) {
    return push_n + sim->stiffness * (wish[0] - axis->x) + sim->hand_damping * (wish[1] - axis->v) -
           sim->damping * axis->v;
}

/* The solution after kernel->span_s; push_n is the actuator's force and the friction's, both constant. */
HD_RT static inline struct hd_axis carried(const struct hd_sim *sim, const struct hd_kernel *kernel, double push_n,
                                           const double wish[HD_WISH_ORDERS], struct hd_axis axis) {
    const double *const j = &kernel->j[1];
    const double net = net_force(sim, push_n, wish, &axis);
    const double rise = sim->stiffness * (wish[1] - axis.v) + sim->hand_damping * wish[2];
    double dx = axis.v * kernel->span_s + j[0] * net + j[1] * rise;
    double dv = j[-1] * net + j[0] * rise;
    if (sim->segment.course == HD_COURSE_MINIMUM_JERK) {
        for (int order = 2; order <= 5; order++) {
            const double drive = sim->stiffness * wish[order] + sim->hand_damping * wish[order + 1];
            dx += j[order] * drive;
            dv += j[order - 1] * drive;
        }
    }
    return (struct hd_axis){axis.x + dx, axis.v + dv};
}

/* What the actuator's lag adds to that. */
HD_RT static void add_off(const struct hd_kernel *kernel, const struct hd_off *off, struct hd_axis *axis) {
    const struct hd_actuator_step *lag = &kernel->lag;
    axis->x += lag->x_m[0] * off->off_n + lag->x_m[1] * off->off_n_per_s;
    axis->v += lag->v_m_per_s[0] * off->off_n + lag->v_m_per_s[1] * off->off_n_per_s;
}

/* Whether an axis that began a step in one direction, with the force `net_before_n`, has surely gone on in it. */
HD_RT static inline bool keeps_going(const struct hd_sim *sim, int which, double local_s, double direction,
                                     double push_n, double net_before_n, const struct hd_axis *after) {
    if (!(after->v * direction > 0.0 && fabs(after->x) <= sim->workspace_m)) {
        return false;
    }
    if (net_before_n * direction >= 0.0) {
        return true;
    }
    /* It slowed down at first: it may have turned twice if it speeds up in the end. */
    double wish[HD_WISH_ORDERS];
    hd_segment_wish(&sim->segment, which, local_s, wish);
    return net_force(sim, push_n, wish, after) * direction <= 0.0;
}

/* axis_glide of an actuator that lags: only what moves. */
HD_RT static bool lagging_glide(struct hd_sim *sim, int which, double local_s, const struct hd_kernel *kernel) {
    struct hd_axis *const axis = &sim->axes[which];
    const struct hd_off *off = &sim->off[which];
    const struct hd_off off_end = off_after(&kernel->lag, off);
    double wish[HD_WISH_ORDERS];
    hd_segment_wish(&sim->segment, which, local_s, wish);
    const double direction = axis->v > 0.0 ? 1.0 : -1.0;
    const double push_n = sim->force_n[which] - direction * sim->coulomb_n;
    struct hd_axis after = carried(sim, kernel, push_n, wish, *axis);
    add_off(kernel, off, &after);
    if (axis->v == 0.0 || !keeps_going(sim, which, local_s + kernel->span_s, direction, push_n + off_end.off_n,
                                       net_force(sim, push_n + off->off_n, wish, axis), &after)) {
        return false;
    }
    after.v = fabs(after.v) < HD_NOTHING ? 0.0 : after.v;
    after.x = fabs(after.x) < HD_NOTHING ? 0.0 : after.x;
    *axis = after;
    sim->off[which] = off_end;
    return true;
}

/* One step in which nothing happens. False, and nothing changed: something may. */
HD_RT static inline bool axis_glide(struct hd_sim *sim, int which, double local_s, const struct hd_kernel *kernel) {
    if (is_under_way(&sim->off[which])) {
        return lagging_glide(sim, which, local_s, kernel);
    }
    struct hd_axis *const axis = &sim->axes[which];
    const double force_n = sim->force_n[which];
    const double friction_n = sim->coulomb_n;
    double wish[HD_WISH_ORDERS];
    double wish_after[HD_WISH_ORDERS];
    hd_segment_wish(&sim->segment, which, local_s, wish);
    if (axis->v == 0.0) {
        /* The force on a resting handle is monotonic along a straight wish; a curved one is left to axis_walk. */
        if (sim->segment.course == HD_COURSE_MINIMUM_JERK || fabs(axis->x) >= sim->workspace_m ||
            fabs(still_force(sim, force_n, wish, axis->x)) > friction_n) {
            return false;
        }
        if (sim->segment.course == HD_COURSE_HOLD) {
            return true;
        }
        hd_segment_wish(&sim->segment, which, local_s + kernel->span_s, wish_after);
        return fabs(still_force(sim, force_n, wish_after, axis->x)) <= friction_n;
    }
    const double direction = axis->v > 0.0 ? 1.0 : -1.0;
    const double push_n = force_n - direction * friction_n;
    struct hd_axis after = carried(sim, kernel, push_n, wish, *axis);
    /* Far from the stops and without friction a turn is no event. */
    const double reach_m = 2.0 * kernel->span_s * (fabs(axis->v) + fabs(after.v));
    if (!(friction_n == 0.0 && fabs(after.x) + reach_m < sim->workspace_m) &&
        !keeps_going(sim, which, local_s + kernel->span_s, direction, push_n, net_force(sim, push_n, wish, axis),
                     &after)) {
        return false;
    }
    after.v = fabs(after.v) < HD_NOTHING ? 0.0 : after.v;
    after.x = fabs(after.x) < HD_NOTHING ? 0.0 : after.x;
    *axis = after;
    return true;
}

/* ---- Events within a step -------------------------------------------------------------------------------------- */

/* A motion in one direction, or rest, from one event on. */
struct hd_flight {
    int which;
    double direction; /* 1 or -1 */
    double local_s;   /* when it began, since the segment's start */
    double push_n;
    struct hd_axis axis;
    struct hd_off off;
};

/* What is located: a value that is positive at first, then negative. */
enum hd_crossing {
    HD_CROSSING_TURN,    /* the speed */
    HD_CROSSING_SLOWEST, /* the deceleration */
    HD_CROSSING_STOP,    /* the way to the stop */
    HD_CROSSING_RELEASE  /* what friction can still hold of a rest */
};

HD_RT static struct hd_axis flight_at(const struct hd_sim *sim, const struct hd_flight *flight, double after_s) {
    struct hd_kernel kernel;
    double wish[HD_WISH_ORDERS];
    kernel_at(sim, after_s, &kernel);
    hd_segment_wish(&sim->segment, flight->which, flight->local_s, wish);
    struct hd_axis axis = carried(sim, &kernel, flight->push_n, wish, flight->axis);
    if (is_under_way(&flight->off)) {
        add_off(&kernel, &flight->off, &axis);
    }
    return axis;
}

HD_RT static void crossing_at(const struct hd_sim *sim, const struct hd_flight *flight, enum hd_crossing crossing,
                              double after_s, double *value, double *slope) {
    double wish[HD_WISH_ORDERS];
    hd_segment_wish(&sim->segment, flight->which, flight->local_s + after_s, wish);
    const struct hd_off off = off_at(sim, &flight->off, after_s);
    if (crossing == HD_CROSSING_RELEASE) {
        *value =
            sim->coulomb_n - flight->direction * still_force(sim, flight->push_n + off.off_n, wish, flight->axis.x);
        *slope = -flight->direction * (sim->stiffness * wish[1] + sim->hand_damping * wish[2] + off.off_n_per_s);
        return;
    }
    const struct hd_axis axis = flight_at(sim, flight, after_s);
    const double net = net_force(sim, flight->push_n + off.off_n, wish, &axis);
    if (crossing == HD_CROSSING_TURN) {
        *value = flight->direction * axis.v;
        *slope = flight->direction * net / sim->mass_kg;
    } else if (crossing == HD_CROSSING_SLOWEST) {
        const double acceleration = net / sim->mass_kg;
        *value = -flight->direction * net;
        *slope = -flight->direction * (sim->stiffness * (wish[1] - axis.v) + sim->hand_damping * wish[2] -
                                       (sim->hand_damping + sim->damping) * acceleration + off.off_n_per_s);
    } else {
        *value = sim->workspace_m - flight->direction * axis.x;
        *slope = -flight->direction * axis.v;
    }
}

/* When the value passes zero between low_s and high_s: Newton's method, bisection where it would leave the bracket. */
HD_RT static double locate(const struct hd_sim *sim, const struct hd_flight *flight, enum hd_crossing crossing,
                           double low_s, double high_s) {
    const double tolerance_s = 2e-16 * high_s;
    double guess_s = 0.5 * (low_s + high_s);
    for (int i = 0; i < HD_LOCATE_MAX && high_s - low_s > tolerance_s; i++) {
        double value;
        double slope;
        crossing_at(sim, flight, crossing, guess_s, &value, &slope);
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

/* Whether a flight ends by a turn before *span_s has passed; *span_s is then when. */
HD_RT static bool turns_within(const struct hd_sim *sim, const struct hd_flight *flight, double *span_s) {
    double last_s = *span_s;
    double value;
    double slope;
    crossing_at(sim, flight, HD_CROSSING_TURN, last_s, &value, &slope);
    if (value >= 0.0) {
        /* It may have turned twice: if it slowed down at first and speeds up in the end. */
        if (flight->axis.v == 0.0 || slope <= 0.0) {
            return false;
        }
        crossing_at(sim, flight, HD_CROSSING_SLOWEST, 0.0, &value, &slope);
        if (value <= 0.0) {
            return false;
        }
        last_s = locate(sim, flight, HD_CROSSING_SLOWEST, 0.0, last_s);
        crossing_at(sim, flight, HD_CROSSING_TURN, last_s, &value, &slope);
        if (value >= 0.0) {
            return false;
        }
    }
    *span_s = locate(sim, flight, HD_CROSSING_TURN, 0.0, last_s);
    return true;
}

/* When along a curved segment the force on a resting handle is extreme: k w' + b_h w'' = 0, which has one root inside
 * (s (1 - s) is positive there and 1 - 2 s falls). Without a hand there is none; the end is returned. */
HD_RT static double extreme_force_s(const struct hd_sim *sim) {
    const double elastic = 0.5 * sim->stiffness * sim->segment.duration_s;
    const double viscous = sim->hand_damping;
    if (!(elastic + viscous > 0.0)) {
        return sim->segment.duration_s;
    }
    HD_RT_FOREIGN_BEGIN
    const double root = sqrt(elastic * elastic + 4.0 * viscous * viscous);
    HD_RT_FOREIGN_END
    /* elastic s (1 - s) + viscous (1 - 2 s) = 0, its root between 0 and 1 in the form that does not cancel. */
    const double more = elastic - 2.0 * viscous;
    return sim->segment.duration_s * (more > 0.0 ? 0.5 * (more + root) / elastic : 2.0 * viscous / (root - more));
}

/* Which way a resting handle is pushed beyond what friction and stops hold: 1, -1, or 0 for not at all. */
HD_RT static double release_direction(const struct hd_sim *sim, int which, double local_s, double after_s) {
    const struct hd_axis *axis = &sim->axes[which];
    const double off_n = off_at(sim, &sim->off[which], after_s).off_n;
    double wish[HD_WISH_ORDERS];
    hd_segment_wish(&sim->segment, which, local_s + after_s, wish);
    const double force_n = still_force(sim, sim->force_n[which] + off_n, wish, axis->x);
    if (force_n > sim->coulomb_n && axis->x < sim->workspace_m) {
        return 1.0;
    }
    if (force_n < -sim->coulomb_n && axis->x > -sim->workspace_m) {
        return -1.0;
    }
    return 0.0;
}

/* The rest that begins at local_s: true if it ends within left_s, *rest_s later, with a motion in *direction. */
HD_RT static bool rest_ends(const struct hd_sim *sim, int which, double local_s, double left_s, double *rest_s,
                            double *direction) {
    *rest_s = 0.0;
    *direction = release_direction(sim, which, local_s, 0.0);
    if (*direction != 0.0) {
        return true;
    }
    if (sim->segment.course == HD_COURSE_HOLD && !is_under_way(&sim->off[which])) {
        return false;
    }
    double looks_s[2] = {left_s, left_s};
    if (sim->segment.course == HD_COURSE_MINIMUM_JERK) {
        const double extreme_s = extreme_force_s(sim) - local_s;
        if (extreme_s > 0.0 && extreme_s < left_s) {
            looks_s[0] = extreme_s;
        }
    }
    double quiet_s = 0.0;
    for (int look = 0; look < 2; look++) {
        *direction = release_direction(sim, which, local_s, looks_s[look]);
        if (*direction != 0.0) {
            const struct hd_flight rest = {which,          *direction, local_s, sim->force_n[which], sim->axes[which],
                                           sim->off[which]};
            *rest_s = locate(sim, &rest, HD_CROSSING_RELEASE, quiet_s, looks_s[look]);
            return true;
        }
        quiet_s = looks_s[look];
    }
    return false;
}

/* One step in which something may happen. */
HD_RT static void axis_walk(struct hd_sim *sim, int which, double local_s, double span_s) {
    struct hd_axis *const axis = &sim->axes[which];
    struct hd_off *const off = &sim->off[which];
    double left_s = span_s;
    for (int events = 0; events < HD_AXIS_EVENTS_MAX && left_s > 0.0; events++) {
        struct hd_flight flight = {.which = which, .direction = axis->v > 0.0 ? 1.0 : -1.0};
        if (axis->v == 0.0) {
            double rest_s;
            if (!rest_ends(sim, which, local_s, left_s, &rest_s, &flight.direction)) {
                *off = off_at(sim, off, left_s);
                return;
            }
            *off = off_at(sim, off, rest_s);
            local_s += rest_s;
            left_s -= rest_s;
        }
        flight.local_s = local_s;
        flight.push_n = sim->force_n[which] - flight.direction * sim->coulomb_n;
        flight.axis = *axis;
        flight.off = *off;

        double end_s = left_s;
        const bool turns = turns_within(sim, &flight, &end_s);
        struct hd_axis end = flight_at(sim, &flight, end_s);
        if (turns) {
            end.v = 0.0;
        }
        /* Up to here the motion was in one direction. */
        if (end.x * flight.direction > sim->workspace_m) {
            end_s = locate(sim, &flight, HD_CROSSING_STOP, 0.0, end_s);
            end = (struct hd_axis){flight.direction * sim->workspace_m, 0.0};
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

/* ---- Time ------------------------------------------------------------------------------------------------------ */

HD_RT static double path_time_s(const struct hd_sim *sim) {
    return (double)(int64_t)(sim->tick - sim->path_tick) * sim->period_s;
}

/* Both axes go on within the segment, under a constant force. */
HD_RT static void span(struct hd_sim *sim, double local_s, double span_s) {
    double limit_s = sim->segment_limit_s;
    if (lags(sim) && sim->lag_limit_s < limit_s) {
        limit_s = sim->lag_limit_s;
    }
    const double wanted = span_s / limit_s;
    uint32_t parts = (uint32_t)wanted;
    parts += (double)parts < wanted;
    const double part_s = span_s / (double)parts;
    struct hd_kernel made;
    const struct hd_kernel *kernel = &made;
    if (part_s == sim->period.span_s) {
        kernel = &sim->period;
    } else if (part_s == sim->stretch.span_s) {
        kernel = &sim->stretch;
    } else if (part_s == sim->lagging.span_s) {
        kernel = &sim->lagging;
    } else {
        kernel_at(sim, part_s, &made);
    }
    for (uint32_t part = 0; part < parts; part++) {
        const double part_local_s = local_s + (double)part * part_s;
        for (int which = 0; which < 2; which++) {
            if (!axis_glide(sim, which, part_local_s, kernel)) {
                axis_walk(sim, which, part_local_s, part_s);
            }
        }
    }
}

HD_RT static void enter_segment(struct hd_sim *sim, const double wish_m[2]) {
    hd_operator_segment(sim->path, sim->path_index, wish_m, &sim->segment);
    sim->segment_limit_s = sim->limit_s;
    if (sim->segment.course == HD_COURSE_MINIMUM_JERK && sim->segment.duration_s < 8.0 * sim->limit_s) {
        sim->segment_limit_s = sim->segment.duration_s / 8.0;
    }
    sim->calm_tick = UINT64_MAX;
    if (sim->segment.course == HD_COURSE_HOLD) {
        sim->path = NULL;
    } else {
        sim->calm_tick = sim->path_tick + (uint64_t)(sim->segment.end_s / sim->period_s + HD_SAME_TIME);
    }
    if (sim->period_s > sim->segment_limit_s) {
        sim->calm_tick = 0;
    }
}

/* The segment that holds the time `path_s`, or begins there. */
HD_RT static void find_segment(struct hd_sim *sim, double path_s) {
    while (path_s >= sim->segment.end_s - HD_SAME_TIME * sim->period_s) {
        sim->path_index++;
        enter_segment(sim, sim->segment.from_m);
    }
}

/* How long after the present tick the force will expire; infinite where there is none. */
HD_RT static double force_left_s(const struct hd_sim *sim) {
    if (sim->force_n[0] == 0.0 && sim->force_n[1] == 0.0) {
        return (double)INFINITY;
    }
    const double held_s = (double)(int64_t)(sim->tick - sim->put_tick) * sim->period_s - sim->put_late_s;
    const double left_s = sim->force_timeout_s - held_s;
    return left_s > HD_SAME_TIME * sim->period_s ? left_s : 0.0;
}

HD_RT static bool force_lasts(const struct hd_sim *sim) {
    return sim->tick - sim->put_tick < sim->force_whole_periods || (sim->force_n[0] == 0.0 && sim->force_n[1] == 0.0);
}

HD_RT static double encoded(const struct hd_sim *sim, double x) {
    if (sim->encoder_step_m == 0.0) {
        return x;
    }
    return ((x * sim->encoder_per_m + HD_ROUND_MAGIC) - HD_ROUND_MAGIC) * sim->encoder_step_m;
}

HD_RT static void report(struct hd_sim *sim) {
    struct hd_report *to = &sim->reports[sim->report_count & (HD_REPORTS - 1u)];
    for (int which = 0; which < 2; which++) {
        to->position_m[which] = encoded(sim, sim->axes[which].x);
        to->velocity_m_per_s[which] = sim->axes[which].v;
    }
    sim->report_count++;
    sim->report_at += sim->report_interval;
}

/* The first of the forces under way begins to act, `late_s` after the present tick. */
HD_RT static void arrive(struct hd_sim *sim, double late_s) {
    const struct hd_sent *const first = &sim->sent[sim->sent_first];
    tell(sim, first->force_n[0], first->force_n[1]);
    sim->put_tick = sim->tick;
    sim->put_late_s = late_s;
    sim->sent_first = (sim->sent_first + 1u) % HD_SIM_FORCES;
    sim->sent_count--;
    sim->arrive_at = sim->sent_count > 0 ? sim->sent[sim->sent_first].at : UINT64_MAX;
}

/* What is due at a tick. */
HD_RT static inline void due_at(struct hd_sim *sim, uint64_t now) {
    if (sim->report_at == now) {
        report(sim);
    }
    if (sim->arrive_at == now) {
        arrive(sim, 0.0);
    }
}

/* A time within the present period, which began at `begin`. */
HD_RT static inline double within_s(const struct hd_sim *sim, uint64_t at, uint64_t begin) {
    return (double)(int64_t)(at - begin) * HD_REPORT_UNIT * sim->period_s;
}

/* One period with whatever falls into it. */
HD_RT static void busy_period(struct hd_sim *sim) {
    const uint64_t begin = (sim->tick - sim->report_tick) << HD_REPORT_SHIFT;
    const uint64_t end = begin + ((uint64_t)1 << HD_REPORT_SHIFT);
    const double path_s = path_time_s(sim);
    double done_s = 0.0;
    while (done_s < sim->period_s) {
        double next_s = sim->period_s;
        bool reports = false;
        bool arrives = false;
        find_segment(sim, path_s + done_s);
        if (sim->segment.end_s - path_s < next_s - HD_SAME_TIME * sim->period_s) {
            next_s = sim->segment.end_s - path_s;
        }
        const double expiry_s = force_left_s(sim);
        if (expiry_s <= done_s) {
            tell(sim, 0.0, 0.0);
        } else if (expiry_s < next_s - HD_SAME_TIME * sim->period_s) {
            next_s = expiry_s;
        }
        if (sim->report_at < end) {
            const double report_s = within_s(sim, sim->report_at, begin);
            if (report_s <= next_s) {
                next_s = report_s;
                reports = true;
            }
        }
        if (sim->arrive_at < end) {
            const double arrive_s = within_s(sim, sim->arrive_at, begin);
            if (arrive_s <= next_s) {
                reports = reports && arrive_s == next_s;
                next_s = arrive_s;
                arrives = true;
            }
        }
        if (next_s > done_s) {
            span(sim, path_s + done_s - sim->segment.start_s, next_s - done_s);
            done_s = next_s;
        }
        if (reports) {
            report(sim);
        }
        if (arrives) {
            arrive(sim, next_s);
        }
    }
    sim->tick++;
    due_at(sim, end);
}

HD_RT static inline void one_period(struct hd_sim *sim) {
    const uint64_t end = (sim->tick + 1u - sim->report_tick) << HD_REPORT_SHIFT;
    if (sim->tick >= sim->calm_tick || !force_lasts(sim) || sim->report_at < end || sim->arrive_at < end || lags(sim)) {
        busy_period(sim);
        return;
    }
    const double local_s = path_time_s(sim) - sim->segment.start_s;
    for (int which = 0; which < 2; which++) {
        if (!axis_glide(sim, which, local_s, &sim->period)) {
            axis_walk(sim, which, local_s, sim->period_s);
        }
    }
    sim->tick++;
    due_at(sim, end);
}

/* How many periods from now on can be one step: nothing falls into them, and at most a report and a force at
 * their end. */
HD_RT static uint64_t free_periods(const struct hd_sim *sim, uint64_t end_tick) {
    if (sim->tick >= sim->calm_tick || !force_lasts(sim) || lags(sim)) {
        return 0;
    }
    uint64_t count = end_tick - sim->tick;
    if (sim->calm_tick - sim->tick < count) {
        count = sim->calm_tick - sim->tick;
    }
    if (sim->force_n[0] != 0.0 || sim->force_n[1] != 0.0) {
        const uint64_t lasting = sim->force_whole_periods - (sim->tick - sim->put_tick);
        count = lasting < count ? lasting : count;
    }
    const uint64_t next_at = sim->report_at < sim->arrive_at ? sim->report_at : sim->arrive_at;
    const uint64_t silent = (next_at - ((sim->tick - sim->report_tick) << HD_REPORT_SHIFT)) >> HD_REPORT_SHIFT;
    return silent < count ? silent : count;
}

/* Many periods in as few steps as the device allows, and in none once it rests. */
HD_RT static void many_periods(struct hd_sim *sim, uint32_t periods) {
    const uint64_t end_tick = sim->tick + periods;
    const uint64_t end = (end_tick - sim->report_tick) << HD_REPORT_SHIFT;
    if (end >= sim->report_delay) {
        /* Reports that are older than the newest readable one at the end will never be seen. */
        const uint64_t newest = (end - sim->report_delay) / sim->report_interval;
        if (newest > sim->report_count) {
            sim->report_count = newest;
            sim->report_at = newest * sim->report_interval;
        }
    }
    while (sim->tick < end_tick) {
        find_segment(sim, path_time_s(sim));
        uint64_t count = free_periods(sim, end_tick);
        if (count < 2) {
            one_period(sim);
            continue;
        }
        const struct hd_axis before[2] = {sim->axes[0], sim->axes[1]};
        const uint64_t step = count < sim->stretch_periods ? count : sim->stretch_periods;
        span(sim, path_time_s(sim) - sim->segment.start_s, (double)(int64_t)step * sim->period_s);
        const bool rests = sim->segment.course == HD_COURSE_HOLD && before[0].x == sim->axes[0].x &&
                           before[0].v == sim->axes[0].v && before[1].x == sim->axes[1].x &&
                           before[1].v == sim->axes[1].v;
        sim->tick += rests ? count : step;
        due_at(sim, (sim->tick - sim->report_tick) << HD_REPORT_SHIFT);
    }
}

HD_RT void hd_sim_step_advance(struct hd_sim *sim, uint32_t periods) {
    if (periods == 1) {
        one_period(sim);
    } else {
        many_periods(sim, periods);
    }
}

/* ---- Force, wish and reports ----------------------------------------------------------------------------------- */

/* Sends a force with the next frame; one that waited for it is overtaken. */
HD_RT static void send_force(struct hd_sim *sim, const double force_n[2]) {
    const uint64_t now = (sim->tick - sim->report_tick) << HD_REPORT_SHIFT;
    const uint64_t at = (now / sim->force_interval + sim->force_intervals) * sim->force_interval;
    uint32_t last = (sim->sent_first + sim->sent_count + HD_SIM_FORCES - 1u) % HD_SIM_FORCES;
    if (sim->sent_count == 0 || sim->sent[last].at != at) {
        last = (last + 1u) % HD_SIM_FORCES;
        sim->sent_count++;
    }
    sim->sent[last] = (struct hd_sent){{force_n[0], force_n[1]}, at};
    sim->arrive_at = sim->sent[sim->sent_first].at;
}

HD_RT void hd_sim_step_put(struct hd_sim *sim, const double force_n[2]) {
    double shown_n[2];
    const bool finite = isfinite(force_n[0]) && isfinite(force_n[1]);
    for (int which = 0; which < 2; which++) {
        double level = finite ? force_n[which] : 0.0;
        if (sim->force_step_n > 0.0) {
            /* Bounded before it is rounded: the rounding needs less than 2^51 steps. */
            level *= sim->force_per_n;
            level = level > sim->force_top ? sim->force_top : level;
            level = level < -sim->force_top ? -sim->force_top : level;
            shown_n[which] = ((level + HD_ROUND_MAGIC) - HD_ROUND_MAGIC) * sim->force_step_n;
        } else {
            level = level > sim->force_top ? sim->force_top : level;
            shown_n[which] = level < -sim->force_top ? -sim->force_top : level;
        }
    }
    if (sim->force_interval > 0) {
        send_force(sim, shown_n);
        return;
    }
    tell(sim, shown_n[0], shown_n[1]);
    sim->put_tick = sim->tick;
}

HD_RT static void present_wish(struct hd_sim *sim, double wish_m[2]) {
    const double path_s = path_time_s(sim);
    find_segment(sim, path_s);
    for (int which = 0; which < 2; which++) {
        double wish[HD_WISH_ORDERS];
        hd_segment_wish(&sim->segment, which, path_s - sim->segment.start_s, wish);
        wish_m[which] = wish[0];
    }
}

HD_RT void hd_sim_step_operate(struct hd_sim *sim, const struct hd_operator *path) {
    double wish_m[2];
    present_wish(sim, wish_m);
    sim->path = path;
    sim->path_index = hd_operator_first(path);
    sim->path_tick = sim->tick;
    sim->path_end_s = path->waypoints[path->count - 1][0];
    sim->path_told = false;
    enter_segment(sim, wish_m);
    find_segment(sim, 0.0);
}

HD_RT enum hd_progress hd_sim_step_progress(const struct hd_sim *sim) {
    if (sim->path_told) {
        return HD_PROGRESS_NONE;
    }
    return path_time_s(sim) < sim->path_end_s - HD_SAME_TIME * sim->period_s ? HD_PROGRESS_UNDER_WAY
                                                                             : HD_PROGRESS_THROUGH;
}

HD_RT void hd_sim_step_told(struct hd_sim *sim) {
    sim->path_told = true;
}

HD_RT void hd_sim_step_read(struct hd_sim *sim, struct hd_reading *reading) {
    const uint64_t now = (sim->tick - sim->report_tick) << HD_REPORT_SHIFT;
    reading->interval_s = 0.0;
    if (now >= sim->read_next_at) {
        const uint64_t late = now - sim->read_next_at;
        const uint64_t ahead = late < sim->report_interval ? 1u : 1u + late / sim->report_interval;
        sim->read_number += ahead;
        sim->read_next_at += ahead * sim->report_interval;
        if (sim->read_before) {
            reading->interval_s = (double)(int64_t)ahead * sim->report_interval_s;
        }
    }
    sim->read_before = true;
    const struct hd_report *from = &sim->reports[sim->read_number & (HD_REPORTS - 1u)];
    for (int which = 0; which < 2; which++) {
        reading->position_m[which] = from->position_m[which];
        reading->true_velocity_m_per_s[which] = from->velocity_m_per_s[which];
    }
}

HD_RT void hd_sim_step_truth(const struct hd_sim *sim, double position[2], double velocity[2], double force[2]) {
    /* A lagging one begins to fall then. */
    const bool expired = force_left_s(sim) == 0.0 && sim->actuator.order == 0;
    for (int which = 0; which < 2; which++) {
        position[which] = sim->axes[which].x;
        velocity[which] = sim->axes[which].v;
        force[which] = (expired ? 0.0 : sim->force_n[which]) + sim->off[which].off_n;
    }
}

/* ---- The control side ------------------------------------------------------------------------------------------ */

static int check_between(const char *name, double value, double low, double high) {
    if (!(value >= low && value <= high)) {
        return hd_invalid("%s: %g is not between %g and %g", name, value, low, high);
    }
    return HD_OK;
}

/* A resolution: exact, or coarse enough to be counted. */
static int check_step(const char *name, double step, double range) {
    if (step != 0.0 && !(step >= range / HD_STEPS_MAX && step <= 1e6)) {
        return hd_invalid("%s: %g is neither 0 nor between %g and 1e+06", name, step, range / HD_STEPS_MAX);
    }
    return HD_OK;
}

static double fastest_rate_per_s(const struct hd_sim_config *config) {
    const double mass_kg = config->handle_mass_kg + config->hand_mass_kg;
    const double damped = (config->handle_damping_n_s_per_m + config->hand_damping_n_s_per_m) / mass_kg;
    return fmax(damped, sqrt(config->hand_stiffness_n_per_m / mass_kg));
}

/* The bounds keep every product of the simulation finite and every loop short; no device comes near them. */
static int check_config(const struct hd_sim_config *config, double period_s) {
    const struct {
        const char *name;
        double value;
        double low;
        double high;
    } ranges[] = {
        {"period_s", period_s, 1e-6, 10.0},
        {"handle_mass_kg", config->handle_mass_kg, 1e-6, 1e6},
        {"handle_damping_n_s_per_m", config->handle_damping_n_s_per_m, 0.0, 1e9},
        {"coulomb_friction_n", config->coulomb_friction_n, 0.0, 1e6},
        {"max_force_n", config->max_force_n, 0.0, 1e6},
        {"report_interval_s", config->report_interval_s, 0.0, 1000.0},
        {"report_delay_s", config->report_delay_s, 0.0, 1000.0},
        {"force_interval_s", config->force_interval_s, 0.0, 1000.0},
        {"workspace_m", config->workspace_m, 1e-6, 1000.0},
        {"force_timeout_s", config->force_timeout_s, 1e-6, 1e6},
        {"hand_mass_kg", config->hand_mass_kg, 0.0, 1e6},
        {"hand_stiffness_n_per_m", config->hand_stiffness_n_per_m, 0.0, 1e9},
        {"hand_damping_n_s_per_m", config->hand_damping_n_s_per_m, 0.0, 1e9},
        {"actuator_rate_per_s", config->actuator_rate_per_s, 0.0, 1e7},
        {"actuator_damping_ratio", config->actuator_damping_ratio, 0.0, 10.0},
        {"start_m[0]", config->start_m[0], -config->workspace_m, config->workspace_m},
        {"start_m[1]", config->start_m[1], -config->workspace_m, config->workspace_m},
    };
    for (size_t i = 0; i < sizeof ranges / sizeof ranges[0]; i++) {
        const int status = check_between(ranges[i].name, ranges[i].value, ranges[i].low, ranges[i].high);
        if (status != HD_OK) {
            return status;
        }
    }
    if (check_step("encoder_step_m", config->encoder_step_m, config->workspace_m) != HD_OK ||
        check_step("force_step_n", config->force_step_n, config->max_force_n) != HD_OK) {
        return HD_ERR_INVALID;
    }
    const double interval_s = config->report_interval_s == 0.0 ? period_s : config->report_interval_s;
    if (interval_s * HD_REPORTS_A_PERIOD_MAX < period_s) {
        return hd_invalid("report_interval_s: %g is less than 1/%g of the period", interval_s, HD_REPORTS_A_PERIOD_MAX);
    }
    if (config->report_delay_s / interval_s > (double)HD_REPORTS - 4.0) {
        return hd_invalid("report_delay_s: %g is more than %g reports of %g s", config->report_delay_s,
                          (double)HD_REPORTS - 4.0, interval_s);
    }
    if (config->force_interval_s > 0.0) {
        if (config->force_interval_s * HD_REPORTS_A_PERIOD_MAX < period_s) {
            return hd_invalid("force_interval_s: %g is less than 1/%g of the period", config->force_interval_s,
                              HD_REPORTS_A_PERIOD_MAX);
        }
        if (config->force_intervals < 1 || config->force_intervals > HD_SIM_FORCES) {
            return hd_invalid("force_intervals: %u is not between 1 and %d", config->force_intervals, HD_SIM_FORCES);
        }
    }
    if (config->actuator_order > 2 || (config->actuator_order > 0 && config->actuator_rate_per_s == 0.0)) {
        return hd_invalid("actuator_order: %u with a rate of %g 1/s is none of 0, 1 and 2 with a rate",
                          config->actuator_order, config->actuator_rate_per_s);
    }
    if (hd_actuator_fastest(config) * period_s > HD_STEP_MAX * HD_PARTS_MAX) {
        return hd_invalid("actuator_rate_per_s: %g is too fast for a period of %g s", config->actuator_rate_per_s,
                          period_s);
    }
    if (fastest_rate_per_s(config) * period_s > HD_STEP_MAX * HD_PARTS_MAX) {
        return hd_invalid("handle_mass_kg: %g is too light for its damping, the hand and a period of %g s",
                          config->handle_mass_kg, period_s);
    }
    return HD_OK;
}

/* The power series of J_4 and J_5, but for the factor h^(j+2)/5!. */
static void make_series(struct hd_sim *sim) {
    const double damped = (sim->damping + sim->hand_damping) / sim->mass_kg;
    const double elastic = sim->stiffness / sim->mass_kg;
    double before = 0.0;
    double coefficient = 1.0;
    double factorial = 6.0; /* (n + 6)!/5! */
    for (int n = 0; n < HD_SERIES_TERMS; n++) {
        sim->series[0][n] = coefficient / sim->mass_kg / factorial;
        factorial *= n + 7;
        sim->series[1][n] = coefficient / sim->mass_kg / factorial;
        const double next = -damped * coefficient - elastic * before;
        before = coefficient;
        coefficient = next;
    }
}

/* Reports begin anew with the present position as number 0; forces under way are gone. */
static void restart_reports(struct hd_sim *sim) {
    sim->report_tick = sim->tick;
    sim->report_count = 0;
    sim->report_at = 0;
    sim->read_number = 0;
    sim->read_next_at = sim->report_interval + sim->report_delay;
    sim->read_before = false;
    sim->sent_count = 0;
    sim->arrive_at = UINT64_MAX;
    report(sim);
}

/* Everything that is counted in periods. */
static void count_in(struct hd_sim *sim, const struct hd_sim_config *config, double period_s) {
    sim->period_s = period_s;
    sim->force_whole_periods = (uint64_t)(config->force_timeout_s / period_s + HD_SAME_TIME);
    const double longest_s = HD_STRETCH_MAX * period_s;
    sim->limit_s = HD_STEP_MAX / fmax(fastest_rate_per_s(config), HD_STEP_MAX / longest_s);
    sim->lag_limit_s = 0.0;
    if (sim->actuator.order > 0) {
        sim->lag_limit_s = fmin(sim->limit_s, HD_STEP_MAX / sim->actuator.fastest_per_s);
        kernel_at(sim, period_s / fmax(1.0, ceil(period_s / sim->lag_limit_s)), &sim->lagging);
    }
    kernel_at(sim, period_s / fmax(1.0, ceil(period_s / sim->limit_s)), &sim->period);
    sim->stretch_periods = (uint32_t)fmax(1.0, floor(sim->limit_s / period_s));
    kernel_at(sim, sim->stretch_periods * period_s, &sim->stretch);
    /* Rounded down, so that a report that falls on a period's end is not one period late. */
    const double interval_s = config->report_interval_s == 0.0 ? period_s : config->report_interval_s;
    const double unit_s = period_s * HD_REPORT_UNIT;
    sim->report_interval_s = interval_s;
    sim->report_interval = (uint64_t)(interval_s / unit_s * (1.0 + 1e-15) + 1e-3);
    sim->report_delay = (uint64_t)(config->report_delay_s / unit_s * (1.0 + 1e-15) + 1e-3);
    sim->force_interval = (uint64_t)(config->force_interval_s / unit_s * (1.0 + 1e-15) + 1e-3);
}

struct hd_sim *hd_sim_new(const struct hd_sim_config *config, double period_s) {
    if (check_config(config, period_s) != HD_OK) {
        return NULL;
    }
    struct hd_sim *sim = malloc(sizeof *sim);
    if (sim == NULL) {
        hd_invalid("no memory for a simulated joystick");
        return NULL;
    }
    memset(sim, 0, sizeof *sim);
    sim->mass_kg = config->handle_mass_kg + config->hand_mass_kg;
    sim->damping = config->handle_damping_n_s_per_m;
    sim->hand_damping = config->hand_damping_n_s_per_m;
    sim->stiffness = config->hand_stiffness_n_per_m;
    sim->coulomb_n = config->coulomb_friction_n;
    sim->workspace_m = config->workspace_m;
    sim->encoder_step_m = config->encoder_step_m;
    sim->encoder_per_m = config->encoder_step_m > 0.0 ? 1.0 / config->encoder_step_m : 0.0;
    sim->force_step_n = config->force_step_n;
    sim->force_per_n = config->force_step_n > 0.0 ? 1.0 / config->force_step_n : 0.0;
    sim->force_top = config->force_step_n > 0.0 ? floor(config->max_force_n / config->force_step_n + HD_SAME_TIME)
                                                : config->max_force_n;
    sim->force_timeout_s = config->force_timeout_s;
    make_series(sim);
    hd_actuator_make(&sim->actuator, config, sim->mass_kg, (sim->damping + sim->hand_damping) / sim->mass_kg,
                     sim->stiffness / sim->mass_kg);
    count_in(sim, config, period_s);

    sim->axes[0].x = config->start_m[0];
    sim->axes[1].x = config->start_m[1];
    sim->segment = (struct hd_segment){
        .course = HD_COURSE_HOLD,
        .end_s = (double)INFINITY,
        .duration_s = (double)INFINITY,
        .from_m = {config->start_m[0], config->start_m[1]},
    };
    sim->path_told = true;
    sim->segment_limit_s = sim->limit_s;
    sim->calm_tick = period_s > sim->limit_s ? 0 : UINT64_MAX;
    sim->force_intervals = config->force_intervals;
    restart_reports(sim);
    return sim;
}

int hd_sim_set_period(struct hd_sim *sim, const struct hd_sim_config *config, double period_s) {
    if (check_config(config, period_s) != HD_OK) {
        return HD_ERR_INVALID;
    }
    const double path_s = path_time_s(sim);
    tell(sim, 0.0, 0.0);
    count_in(sim, config, period_s);
    sim->put_tick = sim->tick;
    sim->put_late_s = 0.0;
    /* The hand's time goes on to within half a period. A path that began before the first tick has a time below 0. */
    sim->path_tick = sim->tick - (uint64_t)(int64_t)(path_s / period_s + 0.5);
    sim->segment_limit_s = fmin(sim->segment_limit_s, sim->limit_s);
    /* What lies ahead in this segment is looked at period by period; the next one knows better. */
    sim->calm_tick = sim->segment.course == HD_COURSE_HOLD && period_s <= sim->segment_limit_s ? UINT64_MAX : 0;
    restart_reports(sim);
    return HD_OK;
}

void hd_sim_free(struct hd_sim *sim) {
    free(sim);
}

void hd_sim_operate(struct hd_sim *sim, const struct hd_operator *path) {
    hd_sim_step_operate(sim, path);
}

void hd_sim_settle(struct hd_sim *sim) {
    double wish_m[2];
    present_wish(sim, wish_m);
    for (int which = 0; which < 2; which++) {
        sim->axes[which].x = fmax(-sim->workspace_m, fmin(sim->workspace_m, wish_m[which]));
        sim->axes[which].v = 0.0;
        sim->off[which] = (struct hd_off){0.0, 0.0};
    }
    restart_reports(sim);
}

void hd_sim_put(struct hd_sim *sim, const double force_n[2]) {
    hd_sim_step_put(sim, force_n);
}

void hd_sim_advance(struct hd_sim *sim, uint32_t periods) {
    hd_sim_step_advance(sim, periods);
}

void hd_sim_read(struct hd_sim *sim, struct hd_reading *reading) {
    hd_sim_step_read(sim, reading);
}

void hd_sim_truth(const struct hd_sim *sim, double position[2], double velocity[2], double force[2]) {
    hd_sim_step_truth(sim, position, velocity, force);
}

int hd_sim_place(struct hd_sim *sim, const double position[2], const double velocity[2]) {
    for (int which = 0; which < 2; which++) {
        if (!(fabs(position[which]) <= sim->workspace_m) || !(fabs(velocity[which]) <= HD_PLACED_MAX_M_PER_S)) {
            return hd_invalid("position[%d]: %g with a velocity of %g is not within %g m and %g m/s either way", which,
                              position[which], velocity[which], sim->workspace_m, HD_PLACED_MAX_M_PER_S);
        }
    }
    for (int which = 0; which < 2; which++) {
        sim->axes[which] = (struct hd_axis){position[which], velocity[which]};
    }
    return HD_OK;
}

void hd_sim_drive(struct hd_sim *sim, const double *force, size_t count, double *motion) {
    for (size_t i = 0; i < count; i++) {
        for (int which = 0; which < 2; which++) {
            motion[4 * i + (size_t)which] = sim->axes[which].x;
            motion[4 * i + 2u + (size_t)which] = sim->axes[which].v;
        }
        hd_sim_step_put(sim, &force[2 * i]);
        hd_sim_step_advance(sim, 1);
    }
}

size_t hd_sim_size(void) {
    return sizeof(struct hd_sim);
}
