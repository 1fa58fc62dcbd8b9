/* Waypoints of the simulated hand: checked and copied on the control side, split into segments on the thread that runs
 * the simulation. SI units. */
#include "device/hd_operator.h"

#include "device/hd_sim.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Bounds that keep all products of the simulation finite and limit the number of segments in a period; far beyond any
 * real motion. */
#define HD_WAYPOINT_MAX_M 1000.0
#define HD_WAYPOINT_MAX_S 1e7
#define HD_WAYPOINT_MIN_STEP_S 1e-5

static int check_waypoints(const double *waypoints, size_t count, enum hd_interpolation interpolation) {
    if (interpolation != HD_LINEAR && interpolation != HD_MINIMUM_JERK) {
        return hd_invalid("interpolation %d is neither linear nor minimum_jerk", (int)interpolation);
    }
    if (waypoints == NULL || count == 0) {
        return hd_invalid("waypoints: at least one is needed");
    }
    for (size_t i = 0; i < count; i++) {
        const double *point = &waypoints[3 * i];
        if (!(point[0] >= 0.0 && point[0] <= HD_WAYPOINT_MAX_S)) {
            return hd_invalid("waypoints[%zu]: t_s %g is not between 0 and %g", i, point[0], HD_WAYPOINT_MAX_S);
        }
        if (i > 0 && !(point[0] - point[-3] >= HD_WAYPOINT_MIN_STEP_S * (1.0 - 1e-6))) {
            return hd_invalid("waypoints[%zu]: t_s %.9g is not at least %g later than the %.9g before it", i, point[0],
                              HD_WAYPOINT_MIN_STEP_S, point[-3]);
        }
        for (int axis = 0; axis < 2; axis++) {
            if (!(fabs(point[1 + axis]) <= HD_WAYPOINT_MAX_M)) {
                return hd_invalid("waypoints[%zu]: %s %g is not within +-%g", i, axis == 0 ? "x_m" : "y_m",
                                  point[1 + axis], HD_WAYPOINT_MAX_M);
            }
        }
    }
    return HD_OK;
}

struct hd_operator *hd_operator_new(const double *waypoints, size_t count, enum hd_interpolation interpolation) {
    if (check_waypoints(waypoints, count, interpolation) != HD_OK) {
        return NULL;
    }
    struct hd_operator *path = NULL;
    if (count <= (SIZE_MAX - sizeof *path) / sizeof path->waypoints[0]) {
        path = malloc(sizeof *path + count * sizeof path->waypoints[0]);
    }
    if (path == NULL) {
        hd_invalid("no memory for %zu waypoints", count);
        return NULL;
    }
    path->holders = (struct hd_holders){0};
    path->count = count;
    path->profile = interpolation == HD_LINEAR ? HD_PROFILE_LINEAR : HD_PROFILE_MINIMUM_JERK;
    memcpy(path->waypoints, waypoints, count * sizeof path->waypoints[0]);
    return path;
}

void hd_operator_hold(struct hd_operator *path) {
    hd_holders_join(&path->holders);
}

void hd_operator_free(struct hd_operator *path) {
    if (path != NULL && hd_holders_leave(&path->holders)) {
        free(path);
    }
}

HD_RT size_t hd_operator_first(const struct hd_operator *path) {
    return path->waypoints[0][0] < HD_WAYPOINT_MIN_STEP_S ? 1 : 0;
}

HD_RT void hd_operator_rest(const double at_m[2], double start_s, struct hd_segment *segment) {
    *segment = (struct hd_segment){
        .profile = HD_PROFILE_HOLD,
        .start_s = start_s,
        .end_s = (double)INFINITY,
        .duration_s = (double)INFINITY,
        .from_m = {at_m[0], at_m[1]},
    };
}

/* Makes a segment of a motion from `from_m` to `to_m` between `start_s` and `end_s`. */
HD_RT static void make_motion(enum hd_profile profile, const double from_m[2], const double to_m[2], double start_s,
                              double end_s, struct hd_segment *segment) {
    const double rate_per_s = 1.0 / (end_s - start_s);
    const double travel_m[2] = {to_m[0] - from_m[0], to_m[1] - from_m[1]};
    *segment = (struct hd_segment){
        .profile = profile,
        .start_s = start_s,
        .end_s = end_s,
        .duration_s = end_s - start_s,
        .rate_per_s = rate_per_s,
        .from_m = {from_m[0], from_m[1]},
        .travel_m = {travel_m[0], travel_m[1]},
        .speed_m_per_s = {travel_m[0] * rate_per_s, travel_m[1] * rate_per_s},
    };
}

HD_RT void hd_operator_line(const double from_m[2], const double to_m[2], double duration_s,
                            struct hd_segment *segment) {
    make_motion(HD_PROFILE_LINEAR, from_m, to_m, 0.0, duration_s, segment);
}

HD_RT void hd_operator_segment(const struct hd_operator *path, size_t index, const double reference_m[2],
                               struct hd_segment *segment) {
    if (index >= path->count) {
        const double *last = path->waypoints[path->count - 1];
        hd_operator_rest(&last[1], last[0], segment);
        return;
    }
    const double *to = path->waypoints[index];
    const double start_s = index > 0 ? path->waypoints[index - 1][0] : 0.0;
    const double *from_m = index > 0 ? &path->waypoints[index - 1][1] : reference_m;
    make_motion(path->profile, from_m, &to[1], start_s, to[0], segment);
}
