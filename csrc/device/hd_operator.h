/* Where the hand wants to be over time, one segment between two waypoints at a time. SI units; times in seconds since
 * the path began. A path is immutable: control makes it, the thread that runs the simulation reads it. */
#ifndef HD_OPERATOR_H
#define HD_OPERATOR_H

#include "api/hd_core.h"
#include "base/hd_rt.h"

/* The wish and its time derivatives, 0 to 5, and a 0 behind them: no course is of a higher degree than 5. */
#define HD_WISH_ORDERS 7

enum hd_course { HD_COURSE_HOLD = 0, HD_COURSE_LINEAR = 1, HD_COURSE_MINIMUM_JERK = 2 };

struct hd_segment {
    enum hd_course course;
    double start_s; /* since the path began */
    double end_s;   /* infinite for HOLD */
    double duration_s;
    double rate_per_s; /* 1/duration_s */
    double from_m[2];
    double travel_m[2];
    double speed_m_per_s[2]; /* on average */
};

struct hd_operator {
    size_t count;
    enum hd_course course;
    double waypoints[][3]; /* t_s, x_m, y_m */
};

/* The waypoint that a path leads to first: the second, if the first is there at once. */
HD_RT size_t hd_operator_first(const struct hd_operator *path);
/* The segment that leads to waypoint `index` from the one before it, or from `wish_m` at time 0 to the first. With
 * `index` beyond the last: rest at the last. */
HD_RT void hd_operator_segment(const struct hd_operator *path, size_t index, const double wish_m[2],
                               struct hd_segment *segment);

/* The wish of one axis and its derivatives, `local_s` after the segment's start. */
HD_RT static inline void hd_segment_wish(const struct hd_segment *segment, int axis, double local_s,
                                         double wish[HD_WISH_ORDERS]) {
    const double from = segment->from_m[axis];
    for (int order = 0; order < HD_WISH_ORDERS; order++) {
        wish[order] = 0.0;
    }
    if (segment->course == HD_COURSE_HOLD) {
        wish[0] = from;
    } else if (segment->course == HD_COURSE_LINEAR) {
        wish[1] = segment->speed_m_per_s[axis];
        wish[0] = from + wish[1] * local_s;
    } else {
        /* 10 s^3 - 15 s^4 + 6 s^5 (Flash and Hogan 1985), s from 0 to 1, and what follows from it. */
        const double rate = segment->rate_per_s;
        const double s = local_s * rate;
        const double rest = 1.0 - s;
        double scale = segment->travel_m[axis];
        wish[0] = from + scale * s * s * s * (10.0 + s * (6.0 * s - 15.0));
        scale *= rate;
        wish[1] = scale * 30.0 * s * s * rest * rest;
        scale *= rate;
        wish[2] = scale * 60.0 * s * rest * (rest - s);
        scale *= rate;
        wish[3] = scale * 60.0 * (1.0 - 6.0 * s * rest);
        scale *= rate;
        wish[4] = scale * 360.0 * (s - rest);
        scale *= rate;
        wish[5] = scale * 720.0;
    }
}

#endif
