/* The velocity estimator: set membership of a straight line, with a correction for its bend.
 *
 * A sample p says that the truth lies in [p - step/2, p + step/2]. Over a window of samples the lines that pass through
 * every interval have slopes from a slowest to a fastest; their middle is the estimate, half their distance its error
 * bound. The window is as long as one line still explains it. Each of the two extreme lines leans on one older and one
 * newer sample; a new sample either leaves it alone, or turns it about a tangent point of the convex hull of the older
 * samples (O'Rourke, "An on-line algorithm for fitting straight lines between data ranges", CACM 24(9), 1981), or no
 * line is left. Then, and when the window is full, a new window is grown backwards from the newest sample; a point
 * reflection turns that into the same problem.
 *
 * A line is late by half its window where the speed changes. So the line of the window is compared with the line that
 * ended where the window starts. Where their slopes cannot be one, the acceleration between them carries the estimate
 * from the middle of the window to its end, unless it is larger than lines so long allow: that was a jump, an impact,
 * and not a bend.
 *
 * Invariants: the window [start, newest] lies within the ring; slowest <= fastest; the pivot is hull[head], and the
 * hull from there to `end` is that of the samples from the pivot to next - 1. Of a run of equal positions only the two
 * ends are kept. Work is bounded: an update looks at no more than HD_VELOCITY_SAMPLES samples, and each enters and
 * leaves each hull at most twice. Times are kept below CLOCK_LIMIT_S, so rounding does not grow with the age of the
 * run. One thread. SI units. */
#include "tick/hd_velocity.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

#define SLOT(number) ((number) & (HD_VELOCITY_SAMPLES - 1u))

static_assert((HD_VELOCITY_SAMPLES & (HD_VELOCITY_SAMPLES - 1)) == 0, "slots are masked numbers");

/* The window's first sample, and the record at it, must still be in the ring when the next one has come. */
#define LONGEST (HD_VELOCITY_SAMPLES - 2)
/* Samples closer than a time stamp's resolution are one sample. */
#define MIN_INTERVAL_S 1e-9
/* Over a longer pause nothing but the mean speed is known. The clock starts again at 0 where it passes this. */
#define CLOCK_LIMIT_S 1.0
/* Covers the rounding of positions (1e-12 of a step) and of slopes, so that a line that just fits is kept. */
#define WIDEN 1e-9
/* The longest window is the time in which this acceleration bends a path by three steps. */
#define SPAN_ACCELERATION_M_PER_S2 1.0
/* The share of the window that is kept where no line is left, and where it is full: cost against error, measured. */
#define KEEP_BROKEN (2.0 / 3.0)
#define KEEP_FULL 0.5
/* A path of constant acceleration a stays within a line's intervals for about T = sqrt(BEND step / a); 16 is certain.
 */
#define BEND 8.0
/* The line before says nothing of a bend where it is shorter than this share of the window's, all from SHARE_ALL on. */
#define SHARE_NONE (1.0 / 3.0)
#define SHARE_ALL 0.5

/* A point reflection keeps every slope and swaps older and newer. */
static inline HD_RT struct hd_velocity_point reflected(struct hd_velocity_point point) {
    return (struct hd_velocity_point){-point.time_s, -point.position_m};
}

/* Twice the signed area of a, b, c: positive where the path turns left at b. */
static inline HD_RT double turn(struct hd_velocity_point a, struct hd_velocity_point b, struct hd_velocity_point c) {
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

/* side 1: the fastest line, which leans on the upper hull; -1: the slowest, on the lower one. */
static inline HD_RT void edge_push(struct hd_velocity_edge *edge, struct hd_velocity_point point, double side) {
    int32_t end = edge->end;
    while (end > edge->head && side * turn(edge->hull[end - 1], edge->hull[end], point) >= 0.0) {
        end--;
    }
    edge->hull[++end] = point;
    edge->end = end;
}

/* Turns the edge so that it ends at the newest point's limit: about the hull's tangent point as seen from there. */
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

/* Adds the samples before `number` that the hull has not seen yet. */
static inline HD_RT void edge_follow(struct hd_velocity_edge *edge, const struct hd_velocity_point *sample,
                                     uint32_t number, double side) {
    for (; edge->next != number; edge->next++) {
        edge_push(edge, sample[SLOT(edge->next)], side);
    }
}

/* The same backwards in time: adds the reflected samples less than `back` before the newest; `next` counts back too. */
static inline HD_RT void edge_follow_back(struct hd_velocity_edge *edge, const struct hd_velocity_point *sample,
                                          uint32_t newest, uint32_t back, double side) {
    for (; edge->next < back; edge->next++) {
        edge_push(edge, reflected(sample[SLOT(newest - edge->next)]), side);
    }
}

/* Makes the hull that a backward edge has built a forward one: the other way round, from `pivot` to before the newest.
 */
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

/* Grows the window backwards from the newest sample, as far as one line explains, at least to the sample before, at
 * most over `most` samples and `longest_s`. A run of equal positions is cut there: what holds at its ends holds
 * between. */
static HD_RT void grow(const struct hd_velocity *v, struct hd_velocity_axis *axis, uint32_t most, double longest_s) {
    struct hd_velocity_point *sample = axis->sample;
    const double width_m = v->width_m;
    const uint32_t newest = axis->newest;
    struct hd_velocity_edge fast;
    struct hd_velocity_edge slow;
    uint32_t reach = 0;
    uint32_t fast_pivot = 0; /* where the edges lean going forward */
    uint32_t slow_pivot = 0;
    edge_begin(&fast, reflected(sample[SLOT(newest)]), HUGE_VAL, 1);
    edge_begin(&slow, fast.pivot, -HUGE_VAL, 1);
    for (bool more = true; more && reach < most;) {
        const uint32_t back = reach + 1;
        struct hd_velocity_point *older = &sample[SLOT(newest - back)];
        if (v->now_s - older->time_s > longest_s) {
            const struct hd_velocity_point *younger = &sample[SLOT(newest - reach)];
            const double cut_s = v->now_s - longest_s;
            more = false;
            if (older->position_m == younger->position_m && cut_s < younger->time_s) {
                older->time_s = cut_s;
                axis->past[SLOT(newest - back)].span_s = 0.0f; /* no line is known that ended there */
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
    /* Forward, the fastest line leans on the upper hull; reflected, that is the one the slowest has built.
     * It has to hold the pivot, which takes out what lies inside. */
    edge_follow_back(&slow, sample, newest, fast_pivot + 1, -1.0);
    edge_follow_back(&fast, sample, newest, slow_pivot + 1, 1.0);
    edge_reverse(&axis->fastest, &slow, sample[SLOT(newest - fast_pivot)], fast.slope_m_per_s, newest);
    edge_reverse(&axis->slowest, &fast, sample[SLOT(newest - slow_pivot)], slow.slope_m_per_s, newest);
    axis->start = newest - reach;
    axis->before = axis->past[SLOT(axis->start)];
}

/* Carries the line's speed from the middle of its window to the end, by the acceleration since the line before. */
static HD_RT void bend(struct hd_velocity *v, int a, double span_s) {
    const struct hd_velocity_axis *axis = &v->axis[a];
    const double before_span_s = (double)axis->before.span_s;
    const double change = axis->line_m_per_s - (double)axis->before.speed_m_per_s;
    const double allowed = axis->line_half_width_m_per_s + (double)axis->before.half_width_m_per_s;
    const double excess = fabs(change) - allowed;
    const double acceleration = 2.0 * change / (before_span_s + span_s);
    const double longer_s = before_span_s > span_s ? before_span_s : span_s;
    const double bent = fabs(acceleration) * longer_s * longer_s / (BEND * v->step_m);
    double weight = excess < allowed ? excess / allowed : 1.0;
    if (bent > 1.0) {
        weight *= bent < 2.0 ? 2.0 - bent : 0.0;
    }
    if (before_span_s < SHARE_ALL * span_s) {
        const double share = (before_span_s / span_s - SHARE_NONE) / (SHARE_ALL - SHARE_NONE);
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
    /* Of three equal positions the middle one says nothing: the newest takes its place. */
    if (newest == axis->start || position_m != sample[SLOT(newest)].position_m ||
        position_m != sample[SLOT(newest - 1)].position_m) {
        axis->newest = ++newest;
    }
    const uint32_t length = newest - axis->start;
    double span_s = now_s - sample[SLOT(axis->start)].time_s;
    sample[SLOT(newest)] = point;
    const double fast_limit = fast->slope_m_per_s * (point.time_s - fast->pivot.time_s);
    const double slow_limit = slow->slope_m_per_s * (point.time_s - slow->pivot.time_s);
    const double fast_rise = point.position_m - fast->pivot.position_m;
    const double slow_rise = point.position_m - slow->pivot.position_m;
    if (fast_rise > fast_limit || slow_rise < slow_limit) {
        grow(v, axis, 1 + (uint32_t)(KEEP_BROKEN * (double)(length - 1)), v->span_s);
    } else if (span_s > v->span_s) {
        grow(v, axis, length, KEEP_FULL * v->span_s);
    } else if (length > LONGEST) {
        grow(v, axis, (uint32_t)(KEEP_FULL * LONGEST), v->span_s);
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
        span_s = now_s - sample[SLOT(axis->start)].time_s;
        axis->line_m_per_s = 0.5 * (fast->slope_m_per_s + slow->slope_m_per_s);
        axis->line_half_width_m_per_s = 0.5 * (fast->slope_m_per_s - slow->slope_m_per_s);
        v->velocity_m_per_s[a] = axis->line_m_per_s;
        v->half_width_m_per_s[a] = axis->line_half_width_m_per_s;
        axis->bent =
            axis->before.span_s > 0.0f && fabs(axis->line_m_per_s - (double)axis->before.speed_m_per_s) >
                                              axis->line_half_width_m_per_s + (double)axis->before.half_width_m_per_s;
    }
    if (axis->bent) {
        bend(v, a, span_s);
    }
    axis->past[SLOT(newest)] =
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
            axis->sample[SLOT(k)].time_s -= v->now_s;
        }
        edge_rebase(&axis->fastest, v->now_s);
        edge_rebase(&axis->slowest, v->now_s);
    }
    v->now_s = 0.0;
}

/* The newest sample becomes the first: of it nothing is known but where it is. */
static HD_RT void begin(struct hd_velocity *v, const double position_m[2]) {
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
    v->width_m = step_m * (1.0 + WIDEN);
    v->span_s = sqrt(6.0 * step_m / SPAN_ACCELERATION_M_PER_S2);
    hd_velocity_reset(v);
}

void hd_velocity_update(struct hd_velocity *v, double interval_s, const double position_m[2],
                        double velocity_m_per_s[2]) {
    const double elapsed_s = v->elapsed_s + interval_s;
    if (!v->started) {
        v->started = 1;
        begin(v, position_m);
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
                begin(v, position_m);
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
