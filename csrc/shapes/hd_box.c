/* Boxes: solids with four faces, entered through one of them.
 *
 * The face through which the path enters exerts the force until the probe has come out through it or has left it
 * sideways. So a probe that is pressed through a thin box is held on the side from which it came. Faces: 0 along the
 * box's normal n, 1 along its tangent t, 2 along -n, 3 along -t. On each, s is 0 in the middle and grows along the
 * tangent of the face. */
#include "shapes/hd_shape.h"

/* Converts a position to the axes of the box: along t, along n. */
HD_RT static void to_box_axes(const struct hd_object *object, const double position_m[2], double local[2]) {
    double offset[2];
    double tangent[2];
    hd_difference(position_m, object->point_m, offset);
    hd_tangent(object->normal, tangent);
    local[0] = hd_dot(offset, tangent);
    local[1] = hd_dot(offset, object->normal);
}

/* Whether a point is inside, more than `rim_m` below every face. */
HD_RT static int inside(const struct hd_object *object, const double local[2], double rim_m) {
    return hd_magnitude(local[0]) < object->half_m[0] - rim_m && hd_magnitude(local[1]) < object->half_m[1] - rim_m;
}

HD_RT static uint8_t face_of(int axis, int positive) {
    return (uint8_t)(axis == 1 ? (positive ? 0 : 2) : (positive ? 1 : 3));
}

HD_RT static void point_on_face(const struct hd_object *object, uint8_t face, const double position_m[2],
                                struct hd_contact_point *point) {
    double tangent[2];
    double offset[2];
    hd_tangent(object->normal, tangent);
    const double sign = face < 2 ? 1.0 : -1.0;
    const double *axis = face % 2 == 0 ? object->normal : tangent;
    point->normal[0] = sign * axis[0];
    point->normal[1] = sign * axis[1];
    hd_tangent(point->normal, tangent);
    hd_difference(position_m, object->point_m, offset);
    point->depth_m = object->half_m[face % 2 == 0 ? 1 : 0] - hd_dot(offset, point->normal);
    point->arc_m = hd_dot(offset, tangent);
}

HD_RT static void contact_point(const struct hd_object *object, struct hd_feature feature, const double bearing[2],
                                const double from_m[2], const double position_m[2], struct hd_contact_point *point) {
    (void)bearing;
    (void)from_m;
    point_on_face(object, feature.face, position_m, point);
}

HD_RT static double half_length(const struct hd_object *object, struct hd_feature feature) {
    return object->half_m[feature.face % 2 == 0 ? 0 : 1];
}

HD_RT static int has_left(const struct hd_proxy *proxy, const struct hd_object *object, uint32_t slot,
                          struct hd_feature feature, const double position_m[2], const struct hd_contact_point *point) {
    if (!(point->depth_m > 0.0)) {
        return 1;
    }
    const double along = point->arc_m + hd_proxy_offset(proxy, slot, point->normal, position_m);
    return hd_proxy_is_past_end(proxy, slot, point->normal, along, hd_magnitude(along) - half_length(object, feature));
}

/* How precisely a segment must enter. */
struct rim {
    double behind_m; /* distance behind a face at which a segment still begins in front of it */
    double beyond_m; /* distance past the end of a face at which the face is still met */
};

/* Segments of the proxy: along pressed surfaces it passes above the sides of solids that are flush with them. From
 * there down to the probe it meets the surface below, and so does a probe that presses nothing, between the ends of
 * both. */
static const struct rim ALONG_SURFACE = {HD_RIM_M, -HD_RIM_M};
static const struct rim DOWN_TO_PROBE = {HD_RIM_M, HD_FLUSH_M};
static const struct rim OF_PROBE = {HD_SEAM_M, HD_FLUSH_M};

/* Whether the segment from a to b enters the box; finds the fraction of the segment and the face. Two faces are
 * possible only within HD_SEAM_M of a corner; then the one along whose normal the segment is longer is selected. */
HD_RT static int enters(const struct hd_object *object, const double a[2], const double b[2], const struct rim *rim,
                        double *fraction, uint8_t *face) {
    double most = 0.0;
    for (int axis = 0; axis < 2; axis++) {
        const double step = b[axis] - a[axis];
        const double length = hd_magnitude(step);
        const double gap = (step < 0.0 ? a[axis] : -a[axis]) - object->half_m[axis];
        if (!(gap < length) || gap < -rim->behind_m || length <= most) {
            continue; /* the segment ends before the face, begins behind it, or is longer along the other axis */
        }
        const double cut = gap > 0.0 ? gap / length : 0.0;
        const double other = a[1 - axis] + cut * (b[1 - axis] - a[1 - axis]);
        if (hd_magnitude(other) <= object->half_m[1 - axis] + rim->beyond_m) {
            *fraction = cut;
            *face = face_of(axis, step < 0.0);
            most = length;
        }
    }
    return most > 0.0;
}

/* Returns the face nearest to a point inside. */
HD_RT static uint8_t nearest_face(const struct hd_object *object, const double local[2]) {
    const double to_side = object->half_m[0] - hd_magnitude(local[0]);
    const double to_top = object->half_m[1] - hd_magnitude(local[1]);
    return to_top <= to_side ? face_of(1, local[1] >= 0.0) : face_of(0, local[0] >= 0.0);
}

/* Whether the segment from the proxy to the last position `was` of the probe, in the axes of the box, enters through
 * the same face: the box already lay between them. */
HD_RT static int stood_between(const struct hd_object *object, const double proxy_m[2], const double was[2],
                               uint8_t face) {
    double local[2];
    double cut;
    uint8_t entered;
    to_box_axes(object, proxy_m, local);
    return enters(object, local, was, &OF_PROBE, &cut, &entered) && entered == face;
}

/* Fills in the onset at the point `hit` of the face, met at `onset->fraction` of the path. Returns 0 if the face was
 * reached along another surface and the proxy is not on it, so that it lies below that surface. */
HD_RT static int begin_at(const struct hd_proxy *proxy, const struct hd_object *object, const double hit[2],
                          struct hd_onset *onset) {
    if (onset->slid) {
        point_on_face(object, onset->feature.face, proxy->to_m, &onset->point);
        if (has_left(proxy, object, HD_NO_SLOT, onset->feature, proxy->to_m, &onset->point)) {
            return 0;
        }
    }
    double probe_m[2];
    hd_between(proxy->from_m, proxy->to_m, onset->fraction, probe_m);
    point_on_face(object, onset->feature.face, probe_m, &onset->point);
    onset->below_m = hd_shape_below(onset->point.depth_m);
    point_on_face(object, onset->feature.face, hit, &onset->point);
    onset->point.depth_m = 0.0;
    return 1;
}

/* Whether the probe follows a proxy that was already in the box, which is possible where solids overlap. The force then
 * acts at once, from the face through which the probe enters. */
HD_RT static int follows_proxy(const struct hd_proxy *proxy, const struct hd_object *object, const double from[2],
                               const double to[2], struct hd_onset *onset) {
    if (!enters(object, from, to, &OF_PROBE, &onset->fraction, &onset->feature.face)) {
        return 0;
    }
    double hit[2];
    onset->silent = 0;
    onset->slid = 1;
    hd_between(proxy->from_m, proxy->to_m, onset->fraction, hit);
    return begin_at(proxy, object, hit, onset);
}

/* Whether a box that is not touched contains the probe, because it appeared or overlaps another solid; the nearest face
 * is then in contact. */
HD_RT static int contains_probe(const struct hd_proxy *proxy, const struct hd_object *object, const double to[2],
                                int fresh, struct hd_onset *onset) {
    if (!inside(object, to, HD_RIM_M)) {
        return 0;
    }
    onset->silent = 1;
    onset->feature.face = nearest_face(object, to);
    point_on_face(object, onset->feature.face, proxy->to_m, &onset->point);
    onset->below_m = fresh ? 0.0 : hd_shape_below(onset->point.depth_m);
    /* A face below a pressed surface is not touched. */
    return !has_left(proxy, object, HD_NO_SLOT, onset->feature, proxy->to_m, &onset->point);
}

HD_RT static int meets(struct hd_proxy *proxy, const struct hd_object *object, int fresh, struct hd_onset *onset) {
    double from[2];
    double to[2];
    to_box_axes(object, proxy->from_m, from);
    to_box_axes(object, proxy->to_m, to);
    onset->feature = (struct hd_feature){.side = 1};
    onset->slid = 0;
    onset->stood = 0;
    if (fresh || inside(object, from, HD_SEAM_M)) {
        return contains_probe(proxy, object, to, fresh, onset);
    }
    hd_proxy_sweep(proxy);
    double above[2][2]; /* the proxy before and after the tick */
    const double *local[3] = {from, to, to};
    if (proxy->segments > 1) {
        to_box_axes(object, proxy->point[0], above[0]);
        to_box_axes(object, proxy->point[1], above[1]);
        local[0] = above[0];
        local[1] = above[1];
    }
    for (uint32_t segment = 0; segment < proxy->segments; segment++) {
        const double *begin = proxy->point[segment];
        const double *end = proxy->point[segment + 1];
        const struct rim *rim = proxy->segments == 1 ? &OF_PROBE : segment == 0 ? &ALONG_SURFACE : &DOWN_TO_PROBE;
        double cut;
        if (enters(object, local[segment], local[segment + 1], rim, &cut, &onset->feature.face)) {
            uint8_t face;
            double straight;
            onset->silent = 0;
            if (segment > 0 && enters(object, from, to, &OF_PROBE, &straight, &face) && face == onset->feature.face) {
                cut = straight; /* the face lies below the pressed surface */
                begin = proxy->from_m;
            } else {
                onset->slid = segment > 0;
                onset->stood = segment > 0 && stood_between(object, proxy->point[0], from, onset->feature.face);
            }
            double hit[2];
            hd_between(begin, end, cut, hit);
            onset->fraction = onset->slid ? 1.0 : cut;
            return begin_at(proxy, object, hit, onset);
        }
    }
    return proxy->segments > 1 && follows_proxy(proxy, object, from, to, onset);
}

HD_RT static int holds(const struct hd_object *object, const double point_m[2]) {
    double local[2];
    to_box_axes(object, point_m, local);
    return hd_magnitude(local[0]) <= object->half_m[0] + HD_FLUSH_M &&
           hd_magnitude(local[1]) <= object->half_m[1] + HD_FLUSH_M;
}

HD_RT static double distance(const struct hd_object *object, const double point_m[2]) {
    double local[2];
    to_box_axes(object, point_m, local);
    const double beside = hd_magnitude(local[0]) - object->half_m[0];
    const double above = hd_magnitude(local[1]) - object->half_m[1];
    return above > beside ? above : beside;
}

static int is_sized(const double half_m[2], double least_m, double most_m) {
    return half_m[0] >= least_m && half_m[0] <= most_m && half_m[1] >= least_m && half_m[1] <= most_m;
}

const struct hd_shape_operations hd_box = {
    .meets = meets,
    .contact_point = contact_point,
    .has_left = has_left,
    .holds = holds,
    .distance = distance,
    .half_length = half_length,
    .is_sized = is_sized,
};
