/* The reference of the simulated hand over time, one segment between two waypoints at a time. SI units; times in
 * seconds since the path began. A path is immutable: control makes it, the thread that runs the simulation reads it. */
#ifndef HD_OPERATOR_H
#define HD_OPERATOR_H

#include "api/hd_core.h"
#include "base/hd_holders.h"
#include "base/hd_rt.h"

/* The reference and its time derivatives of order 0 to 5, followed by a 0: no profile has a degree above 5. */
#define HD_REFERENCE_ORDERS 7

enum hd_profile { HD_PROFILE_HOLD = 0, HD_PROFILE_LINEAR = 1, HD_PROFILE_MINIMUM_JERK = 2 };

struct hd_segment {
    enum hd_profile profile;
    double start_s; /* time since the path began */
    double end_s;   /* infinite for HOLD */
    double duration_s;
    double rate_per_s; /* 1/duration_s */
    double from_m[2];
    double travel_m[2];
    double speed_m_per_s[2]; /* mean velocity */
};

struct hd_operator {
    struct hd_holders holders;
    size_t count;
    enum hd_profile profile;
    double waypoints[][3]; /* t_s, x_m, y_m */
};

/* Returns the waypoint that a path leads to first: the second one if the first is at time 0. */
HD_RT size_t hd_operator_first(const struct hd_operator *path);
/* Computes the segment that leads to waypoint `index` from the one before it, or from `reference_m` at time 0 to the
 * first. If `index` is beyond the last waypoint, the segment rests there. */
HD_RT void hd_operator_segment(const struct hd_operator *path, size_t index, const double reference_m[2],
                               struct hd_segment *segment);

/* Make a straight line that starts at time 0, and a rest that starts at `start_s`, both without waypoints. */
HD_RT void hd_operator_line(const double from_m[2], const double to_m[2], double duration_s,
                            struct hd_segment *segment);
HD_RT void hd_operator_rest(const double at_m[2], double start_s, struct hd_segment *segment);

/* Computes the reference of one axis and its derivatives at `local_s` after the segment's start. */
HD_RT static inline void hd_segment_reference(const struct hd_segment *segment, int axis, double local_s,
                                              double reference[HD_REFERENCE_ORDERS]) {
    const double from = segment->from_m[axis];
    for (int order = 0; order < HD_REFERENCE_ORDERS; order++) {
        reference[order] = 0.0;
    }
    if (segment->profile == HD_PROFILE_HOLD) {
        reference[0] = from;
    } else if (segment->profile == HD_PROFILE_LINEAR) {
        reference[1] = segment->speed_m_per_s[axis];
        reference[0] = from + reference[1] * local_s;
    } else {
        /* 10 s^3 - 15 s^4 + 6 s^5 (Flash and Hogan 1985), s from 0 to 1, and its derivatives. */
        const double rate = segment->rate_per_s;
        const double s = local_s * rate;
        const double rest = 1.0 - s;
        double scale = segment->travel_m[axis];
        reference[0] = from + scale * s * s * s * (10.0 + s * (6.0 * s - 15.0));
        scale *= rate;
        reference[1] = scale * 30.0 * s * s * rest * rest;
        scale *= rate;
        reference[2] = scale * 60.0 * s * rest * (rest - s);
        scale *= rate;
        reference[3] = scale * 60.0 * (1.0 - 6.0 * s * rest);
        scale *= rate;
        reference[4] = scale * 360.0 * (s - rest);
        scale *= rate;
        reference[5] = scale * 720.0;
    }
}

#endif
