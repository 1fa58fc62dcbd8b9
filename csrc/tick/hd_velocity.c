/* The velocity estimator: set membership of a straight line, with a correction for acceleration.
 *
 * At a sample p the true position lies in [p - step/2, p + step/2]. Over a window of samples the lines that pass
 * through every interval have slopes from a slowest to a fastest. Their middle is the estimate, half their difference
 * its error bound. The window is the longest that one line fits. Each of the two extreme lines touches the intervals of
 * one older and one newer sample. A new sample leaves a line unchanged, or turns it about a tangent point of the convex
 * hull of the older samples (O'Rourke, "An on-line algorithm for fitting straight lines between data ranges", CACM
 * 24(9), 1981), or no line fits any more. Then, and when the window is full, a new window is grown backwards from the
 * newest sample; a point reflection makes this the same problem.
 *
 * While the speed changes, the slope of a line lags by half its window. So the line of the window is compared with the
 * line that ended where the window starts. If their slopes differ by more than their error bounds, the acceleration
 * between them extrapolates the estimate from the middle of the window to its end. An acceleration larger than lines of
 * this length allow is an impact, and is not corrected for.
 *
 * Invariants: the window [start, newest] lies within the ring; slowest <= fastest; the pivot is hull[head], and the
 * hull from there to `end` is that of the samples from the pivot to next - 1. Of a run of equal positions only the two
 * ends are kept. The work is bounded: an update visits at most HD_VELOCITY_SAMPLES samples, and each enters and leaves
 * each hull at most twice. Times are kept below CLOCK_LIMIT_S, so rounding does not grow with the age of the run. One
 * thread. SI units. */
#include "tick/hd_velocity.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

#define RING_INDEX(number) ((number) & (HD_VELOCITY_SAMPLES - 1u))

static_assert((HD_VELOCITY_SAMPLES & (HD_VELOCITY_SAMPLES - 1)) == 0, "indices in the ring are masked sample numbers");

/* Largest number of samples of a window: its first sample and the record there must still be in the ring after the next
 * sample. */
#define MAX_WINDOW_SAMPLES (HD_VELOCITY_SAMPLES - 2)
/* Samples closer than the resolution of time stamps count as one sample. */
#define MIN_INTERVAL_S 1e-9
/* After a longer pause the estimate is the mean velocity of the pause. The clock is set back to 0 when it exceeds this.
 */
#define CLOCK_LIMIT_S 1.0
/* Relative tolerance of intervals: covers the rounding of positions (1e-12 of a step) and of slopes, so that a line
 * that just fits is kept. */
#define WIDTH_TOLERANCE 1e-9
/* The longest window is the time in which a path of this acceleration deviates from a line by three steps. */
#define WINDOW_ACCELERATION_M_PER_S2 1.0
/* Shares of the window that are kept when no line fits any more and when the window is full, chosen from measurements
 * of cost and error. */
#define KEPT_SHARE_IF_BENT (2.0 / 3.0)
#define KEPT_SHARE_IF_FULL 0.5
/* A path of constant acceleration a stays within the intervals of a line for about T = sqrt(MAX_BEND_STEPS step / a).
 * With 16 instead of 8, T is an upper bound. */
#define MAX_BEND_STEPS 8.0
/* Weight of the bend correction by the length of the previous line, as a share of the window: 0 below the first share,
 * 1 above the second. */
#define MIN_BEFORE_SHARE (1.0 / 3.0)
#define FULL_BEFORE_SHARE 0.5

/* Reflects at the origin, which keeps every slope and exchanges older and newer. */
static inline HD_RT struct hd_velocity_point reflected(struct hd_velocity_point point) {
    return (struct hd_velocity_point){-point.time_s, -point.position_m};
}

/* Returns twice the signed area of a, b, c, which is positive if the path turns left at b. */
static inline HD_RT double turn_direction(struct hd_velocity_point a, struct hd_velocity_point b,
                                          struct hd_velocity_point c) {
    return (b.time_s - a.time_s) * (c.position_m - b.position_m) -
           (b.position_m - a.position_m) * (c.time_s - b.time_s);
}

static inline HD_RT void edge_begin(struct hd_velocity_edge *edge, struct hd_velocity_point pivot, double slope_m_per_s,
                                    uint32_t next) {
    edge->slope_m_per_s = slope_m_per_s;
    edge->pivot = pivot;
    edge->next = next;
    edge->head = 0;
    edge->end = 0;
    edge->hull[0] = pivot;
}

/* Adds a point to the hull. Side 1: the fastest line, which touches the upper hull; -1: the slowest, the lower hull. */
static inline HD_RT void edge_push(struct hd_velocity_edge *edge, struct hd_velocity_point point, double side) {
    int32_t end = edge->end;
    while (end > edge->head && side * turn_direction(edge->hull[end - 1], edge->hull[end], point) >= 0.0) {
        end--;
    }
    edge->hull[++end] = point;
    edge->end = end;
}

/* Turns the edge to the limit of the newest point's interval, about the tangent point of the hull seen from there. */
static inline HD_RT void edge_turn(struct hd_velocity_edge *edge, struct hd_velocity_point newest, double width_m,
                                   double side) {
    int32_t k = edge->head;
    double run = newest.time_s - edge->hull[k].time_s;
    double rise = newest.position_m - edge->hull[k].position_m + side * width_m;
    while (k < edge->end) {
        const double next_run = newest.time_s - edge->hull[k + 1].time_s;
        const double next_rise = newest.position_m - edge->hull[k + 1].position_m + side * width_m;
        if (side * (next_rise * run - rise * next_run) >= 0.0) {
            break;
        }
        run = next_run;
        rise = next_rise;
        k++;
    }
    edge->head = k;
    edge->pivot = edge->hull[k];
    edge->slope_m_per_s = rise / run;
}

/* Adds the samples before `number` that are not in the hull yet. */
static inline HD_RT void edge_follow(struct hd_velocity_edge *edge, const struct hd_velocity_point *sample,
                                     uint32_t number, double side) {
    for (; edge->next != number; edge->next++) {
        edge_push(edge, sample[RING_INDEX(edge->next)], side);
    }
}

/* Adds samples backwards in time: the reflected ones fewer than `back` before the newest; `next` counts back as well.
 */
static inline HD_RT void edge_follow_back(struct hd_velocity_edge *edge, const struct hd_velocity_point *sample,
                                          uint32_t newest, uint32_t back, double side) {
    for (; edge->next < back; edge->next++) {
        edge_push(edge, reflected(sample[RING_INDEX(newest - edge->next)]), side);
    }
}

/* Converts the hull of a backward edge to that of a forward edge: in reverse order, from `pivot` to the sample before
 * the newest. */
static inline HD_RT void edge_reverse(struct hd_velocity_edge *edge, const struct hd_velocity_edge *backward,
                                      struct hd_velocity_point pivot, double slope_m_per_s, uint32_t newest) {
    int32_t end = 0;
    edge_begin(edge, pivot, slope_m_per_s, newest);
    for (int32_t k = backward->end; k > 0; k--) {
        const struct hd_velocity_point point = reflected(backward->hull[k]);
        if (point.time_s > pivot.time_s) {
            edge->hull[++end] = point;
        }
    }
    edge->end = end;
}

/* Grows the window backwards from the newest sample as long as one line fits: at least to the previous sample, at most
 * over `most` samples and `longest_s`. A run of equal positions may be cut at `longest_s`, since a line that fits its
 * ends fits in between. */
static HD_RT void grow_backwards(const struct hd_velocity *v, struct hd_velocity_axis *axis, uint32_t most,
                                 double longest_s) {
    struct hd_velocity_point *sample = axis->sample;
    const double width_m = v->width_m;
    const uint32_t newest = axis->newest;
    struct hd_velocity_edge fast;
    struct hd_velocity_edge slow;
    uint32_t reach = 0;
    uint32_t fast_pivot = 0; /* pivots of the forward edges, in samples before the newest */
    uint32_t slow_pivot = 0;
    edge_begin(&fast, reflected(sample[RING_INDEX(newest)]), HUGE_VAL, 1);
    edge_begin(&slow, fast.pivot, -HUGE_VAL, 1);
    for (bool more = true; more && reach < most;) {
        const uint32_t back = reach + 1;
        struct hd_velocity_point *older = &sample[RING_INDEX(newest - back)];
        if (v->now_s - older->time_s > longest_s) {
            const struct hd_velocity_point *younger = &sample[RING_INDEX(newest - reach)];
            const double cut_s = v->now_s - longest_s;
            more = false;
            if (older->position_m == younger->position_m && cut_s < younger->time_s) {
                older->time_s = cut_s;
                axis->past[RING_INDEX(newest - back)].span_s = 0.0f; /* no line ended there */
            } else if (reach > 0) {
                break;
            }
        }
        const struct hd_velocity_point point = reflected(*older);
        const double fast_limit = fast.slope_m_per_s * (point.time_s - fast.pivot.time_s);
        const double slow_limit = slow.slope_m_per_s * (point.time_s - slow.pivot.time_s);
        const double fast_rise = point.position_m - fast.pivot.position_m;
        const double slow_rise = point.position_m - slow.pivot.position_m;
        if (fast_rise > fast_limit || slow_rise < slow_limit) {
            break;
        }
        if (fast_rise + width_m < fast_limit) {
            edge_follow_back(&fast, sample, newest, back, 1.0);
            edge_turn(&fast, point, width_m, 1.0);
            fast_pivot = back;
        }
        if (slow_rise - width_m > slow_limit) {
            edge_follow_back(&slow, sample, newest, back, -1.0);
            edge_turn(&slow, point, width_m, -1.0);
            slow_pivot = back;
        }
        reach = back;
    }
    /* Forward, the fastest line touches the upper hull, which after the reflection is the hull that the slowest line
     * has built. The pivot must be added to it, which removes the points inside. */
    edge_follow_back(&slow, sample, newest, fast_pivot + 1, -1.0);
    edge_follow_back(&fast, sample, newest, slow_pivot + 1, 1.0);
    edge_reverse(&axis->fastest, &slow, sample[RING_INDEX(newest - fast_pivot)], fast.slope_m_per_s, newest);
    edge_reverse(&axis->slowest, &fast, sample[RING_INDEX(newest - slow_pivot)], slow.slope_m_per_s, newest);
    axis->start = newest - reach;
    axis->before = axis->past[RING_INDEX(axis->start)];
}

/* Extrapolates the line's slope from the middle of its window to the end, with the acceleration since the previous
 * line. */
static HD_RT void correct_for_bend(struct hd_velocity *v, int a, double span_s) {
    const struct hd_velocity_axis *axis = &v->axis[a];
    const double before_span_s = (double)axis->before.span_s;
    const double change = axis->line_m_per_s - (double)axis->before.speed_m_per_s;
    const double allowed = axis->line_half_width_m_per_s + (double)axis->before.half_width_m_per_s;
    const double excess = fabs(change) - allowed;
    const double acceleration = 2.0 * change / (before_span_s + span_s);
    const double longer_s = before_span_s > span_s ? before_span_s : span_s;
    const double bent = fabs(acceleration) * longer_s * longer_s / (MAX_BEND_STEPS * v->step_m);
    double weight = excess < allowed ? excess / allowed : 1.0;
    if (bent > 1.0) {
        weight *= bent < 2.0 ? 2.0 - bent : 0.0;
    }
    if (before_span_s < FULL_BEFORE_SHARE * span_s) {
        const double share = (before_span_s / span_s - MIN_BEFORE_SHARE) / (FULL_BEFORE_SHARE - MIN_BEFORE_SHARE);
        weight *= share > 0.0 ? share : 0.0;
    }
    const double correction = 0.5 * weight * acceleration * span_s;
    v->velocity_m_per_s[a] = axis->line_m_per_s + correction;
    v->half_width_m_per_s[a] = axis->line_half_width_m_per_s + fabs(correction);
}

static inline HD_RT void axis_update(struct hd_velocity *v, int a, double position_m) {
    struct hd_velocity_axis *axis = &v->axis[a];
    const double width_m = v->width_m;
    const double now_s = v->now_s;
    struct hd_velocity_point *sample = axis->sample;
    struct hd_velocity_edge *fast = &axis->fastest;
    struct hd_velocity_edge *slow = &axis->slowest;
    const struct hd_velocity_point point = {now_s, position_m};
    uint32_t newest = axis->newest;
    bool changed = true;
    /* The middle one of three equal positions adds no information: the newest replaces it. */
    if (newest == axis->start || position_m != sample[RING_INDEX(newest)].position_m ||
        position_m != sample[RING_INDEX(newest - 1)].position_m) {
        axis->newest = ++newest;
    }
    const uint32_t length = newest - axis->start;
    double span_s = now_s - sample[RING_INDEX(axis->start)].time_s;
    sample[RING_INDEX(newest)] = point;
    const double fast_limit = fast->slope_m_per_s * (point.time_s - fast->pivot.time_s);
    const double slow_limit = slow->slope_m_per_s * (point.time_s - slow->pivot.time_s);
    const double fast_rise = point.position_m - fast->pivot.position_m;
    const double slow_rise = point.position_m - slow->pivot.position_m;
    if (fast_rise > fast_limit || slow_rise < slow_limit) {
        grow_backwards(v, axis, 1 + (uint32_t)(KEPT_SHARE_IF_BENT * (double)(length - 1)), v->span_s);
    } else if (span_s > v->span_s) {
        grow_backwards(v, axis, length, KEPT_SHARE_IF_FULL * v->span_s);
    } else if (length > MAX_WINDOW_SAMPLES) {
        grow_backwards(v, axis, (uint32_t)(KEPT_SHARE_IF_FULL * MAX_WINDOW_SAMPLES), v->span_s);
    } else {
        const bool slower = fast_rise + width_m < fast_limit;
        const bool faster = slow_rise - width_m > slow_limit;
        if (slower) {
            edge_follow(fast, sample, newest, 1.0);
            edge_turn(fast, point, width_m, 1.0);
        }
        if (faster) {
            edge_follow(slow, sample, newest, -1.0);
            edge_turn(slow, point, width_m, -1.0);
        }
        changed = slower || faster;
    }
    if (changed) {
        span_s = now_s - sample[RING_INDEX(axis->start)].time_s;
        axis->line_m_per_s = 0.5 * (fast->slope_m_per_s + slow->slope_m_per_s);
        axis->line_half_width_m_per_s = 0.5 * (fast->slope_m_per_s - slow->slope_m_per_s);
        v->velocity_m_per_s[a] = axis->line_m_per_s;
        v->half_width_m_per_s[a] = axis->line_half_width_m_per_s;
        axis->bent =
            axis->before.span_s > 0.0f && fabs(axis->line_m_per_s - (double)axis->before.speed_m_per_s) >
                                              axis->line_half_width_m_per_s + (double)axis->before.half_width_m_per_s;
    }
    if (axis->bent) {
        correct_for_bend(v, a, span_s);
    }
    axis->past[RING_INDEX(newest)] =
        (struct hd_velocity_record){(float)axis->line_m_per_s, (float)axis->line_half_width_m_per_s, (float)span_s};
}

static inline HD_RT void edge_rebase(struct hd_velocity_edge *edge, double now_s) {
    edge->pivot.time_s -= now_s;
    for (int32_t k = edge->head; k <= edge->end; k++) {
        edge->hull[k].time_s -= now_s;
    }
}

/* Sets the clock back to 0 at the newest sample. */
static HD_RT void rebase(struct hd_velocity *v) {
    for (int a = 0; a < 2; a++) {
        struct hd_velocity_axis *axis = &v->axis[a];
        for (uint32_t k = axis->start; k != axis->newest + 1; k++) {
            axis->sample[RING_INDEX(k)].time_s -= v->now_s;
        }
        edge_rebase(&axis->fastest, v->now_s);
        edge_rebase(&axis->slowest, v->now_s);
    }
    v->now_s = 0.0;
}

/* Starts with a first sample, at which no velocity is known. */
static HD_RT void begin_window(struct hd_velocity *v, const double position_m[2]) {
    v->now_s = 0.0;
    for (int a = 0; a < 2; a++) {
        struct hd_velocity_axis *axis = &v->axis[a];
        axis->start = 0;
        axis->newest = 0;
        axis->bent = 0;
        axis->sample[0] = (struct hd_velocity_point){0.0, position_m[a]};
        v->last_m[a] = position_m[a];
        axis->past[0] = (struct hd_velocity_record){0.0f, 0.0f, 0.0f};
        axis->before = axis->past[0];
        edge_begin(&axis->fastest, axis->sample[0], HUGE_VAL, 1);
        edge_begin(&axis->slowest, axis->sample[0], -HUGE_VAL, 1);
    }
}

void hd_velocity_reset(struct hd_velocity *v) {
    v->started = 0;
    v->elapsed_s = 0.0;
    for (int a = 0; a < 2; a++) {
        v->velocity_m_per_s[a] = 0.0;
        v->half_width_m_per_s[a] = HUGE_VAL;
    }
}

void hd_velocity_init(struct hd_velocity *v, double step_m) {
    memset(v, 0, sizeof *v);
    v->step_m = step_m;
    v->width_m = step_m * (1.0 + WIDTH_TOLERANCE);
    v->span_s = sqrt(6.0 * step_m / WINDOW_ACCELERATION_M_PER_S2);
    hd_velocity_reset(v);
}

void hd_velocity_update(struct hd_velocity *v, double interval_s, const double position_m[2],
                        double velocity_m_per_s[2]) {
    const double elapsed_s = v->elapsed_s + interval_s;
    if (!v->started) {
        v->started = 1;
        begin_window(v, position_m);
    } else if (elapsed_s < MIN_INTERVAL_S) {
        v->elapsed_s = elapsed_s;
    } else {
        v->elapsed_s = 0.0;
        if (v->step_m > 0.0 && elapsed_s <= CLOCK_LIMIT_S) {
            v->now_s += elapsed_s;
            axis_update(v, 0, position_m[0]);
            axis_update(v, 1, position_m[1]);
            if (v->now_s > CLOCK_LIMIT_S) {
                rebase(v);
            }
        } else {
            for (int a = 0; a < 2; a++) {
                v->velocity_m_per_s[a] = (position_m[a] - v->last_m[a]) / elapsed_s;
                v->half_width_m_per_s[a] = 0.0;
            }
            if (v->step_m > 0.0) {
                v->half_width_m_per_s[0] = v->half_width_m_per_s[1] = v->width_m / elapsed_s;
                begin_window(v, position_m);
            }
        }
        v->last_m[0] = position_m[0];
        v->last_m[1] = position_m[1];
    }
    velocity_m_per_s[0] = v->velocity_m_per_s[0];
    velocity_m_per_s[1] = v->velocity_m_per_s[1];
}

double hd_velocity_half_width(const struct hd_velocity *v, int axis) {
    return v->half_width_m_per_s[axis];
}

int hd_velocity_run(double step_m, size_t count, const double *interval_s, const double *position, double *velocity,
                    double *half_width) {
    struct hd_velocity v;
    if (!(step_m >= 0.0 && isfinite(step_m))) {
        return hd_invalid("step_m: %g is not a finite number >= 0", step_m);
    }
    for (size_t k = 0; k < count; k++) {
        if (!(interval_s[k] >= 0.0 && isfinite(interval_s[k]))) {
            return hd_invalid("interval_s[%zu]: %g is not a finite number >= 0", k, interval_s[k]);
        }
        if (!(isfinite(position[2 * k]) && isfinite(position[2 * k + 1]))) {
            return hd_invalid("position[%zu]: (%g, %g) is not finite", k, position[2 * k], position[2 * k + 1]);
        }
    }
    hd_velocity_init(&v, step_m);
    for (size_t k = 0; k < count; k++) {
        hd_velocity_update(&v, interval_s[k], position + 2 * k, velocity + 2 * k);
        if (half_width != NULL) {
            half_width[2 * k] = hd_velocity_half_width(&v, 0);
            half_width[2 * k + 1] = hd_velocity_half_width(&v, 1);
        }
    }
    return HD_OK;
}
