/* Discs: round solids, touched at a bearing that turns with the probe.
 *
 * The bearing is the direction from the centre to the proxy. F = K (R - q) along it, where q is the probe's distance
 * from the centre along the bearing. In each tick the proxy moves along the rim, the shorter way round, towards the
 * point nearest to the probe, by at most HD_DISC_TRAVEL_FACTOR times the probe's travel. It reaches that point in every
 * tick unless the probe passes the centre within R / HD_DISC_TRAVEL_FACTOR: then it follows over several ticks, so that
 * the force has no step. It only moves to where K/2 (R - q)^2 is smaller, so no closed path gives energy.
 *
 * s is the arc length from the top, clockwise, in (-pi R, pi R]. It changes R/r times as fast as the position of a
 * probe at radius r, without bound near the centre. Geometry, which depends on s, fades there: see `lever`. Friction
 * does not depend on s. */
#include "shapes/hd_shape.h"

#define HD_DISC_TRAVEL_FACTOR 24.0
/* Distances from the centre, in radii, above which geometry acts in full, and below which it is zero.
 * A proxy that lags behind the probe has caught up before the probe is R HD_DISC_ZERO_RADII away from the centre, on
 * any path; the condition is sqrt(u^2 - 1) - arcsec u >= pi for u = HD_DISC_TRAVEL_FACTOR HD_DISC_ZERO_RADII. */
#define HD_DISC_FULL_RADII 0.5
#define HD_DISC_ZERO_RADII 0.2
/* A point nearer to the centre than this, m, counts as the centre, which has no bearing: the squares of its coordinates
 * could be subnormal. */
#define HD_DISC_CENTRE_M 1e-140
/* Value of the travel if a contact begins or the disc was moved: the bearing turns to the probe at once, but not to the
 * far side of the centre. */
#define UNLIMITED_TRAVEL_M 1e300

/* Returns the distance of an offset from the centre, m; 0: it counts as the centre. */
HD_RT static double distance_of(const double offset[2]) {
    const double distance = hd_root(hd_dot(offset, offset));
    return distance >= HD_DISC_CENTRE_M ? distance : 0.0;
}

/* Turns the bearing towards the offset, by an angle of at most `turn`. A probe outside on the far side did not move
 * there along the rim: it passed through the disc fast, or is held by other pressed surfaces too. The bearing then
 * stays at the side that was touched. */
HD_RT static void turn_bearing(const double offset[2], double radius_m, double turn, struct hd_contact_point *point) {
    const double bearing[2] = {point->normal[0], point->normal[1]};
    const double distance = distance_of(offset);
    const double across = bearing[0] * offset[1] - bearing[1] * offset[0];
    const int ahead = distance > 0.0 && hd_dot(offset, bearing) > 0.0;
    if (ahead && hd_magnitude(across) <= turn * distance) {
        point->normal[0] = offset[0] / distance;
        point->normal[1] = offset[1] / distance;
    } else if (turn > 0.0 && turn < UNLIMITED_TRAVEL_M && distance > 0.0 && (ahead || distance < radius_m)) {
        /* Turns by the arc tangent of `turn`, which is never too far. For a path through the centre both directions are
         * equally long. */
        const double most = turn < 1.0 ? turn : 1.0;
        const double step = across > 0.0 ? most : -most;
        const double length = hd_root(1.0 + step * step);
        point->normal[0] = (bearing[0] - step * bearing[1]) / length;
        point->normal[1] = (bearing[1] + step * bearing[0]) / length;
    }
}

HD_RT static void point_at(const struct hd_object *object, const double bearing[2], double travel_m,
                           const double position_m[2], struct hd_contact_point *point) {
    const double radius = object->half_m[0];
    double offset[2];
    hd_difference(position_m, object->point_m, offset);
    point->normal[0] = bearing[0];
    point->normal[1] = bearing[1];
    turn_bearing(offset, radius,
                 travel_m < UNLIMITED_TRAVEL_M ? HD_DISC_TRAVEL_FACTOR * travel_m / radius : UNLIMITED_TRAVEL_M, point);
    point->depth_m = radius - hd_dot(offset, point->normal);
    point->arc_m = 0.0;
}

HD_RT static double arc_length(const struct hd_object *object, const double normal[2]) {
    HD_RT_FOREIGN_BEGIN
    return object->half_m[0] * atan2(normal[0], normal[1]);
    HD_RT_FOREIGN_END
}

HD_RT static void contact_point(const struct hd_object *object, struct hd_feature feature, const double bearing[2],
                                const double from_m[2], const double position_m[2], struct hd_contact_point *point) {
    (void)feature;
    point_at(object, bearing, from_m != NULL ? hd_distance(position_m, from_m) : UNLIMITED_TRAVEL_M, position_m, point);
}

HD_RT static void lever(const struct hd_object *object, double depth_m, struct hd_lever *lever) {
    const double radius_m = object->half_m[0];
    const double part = (radius_m - depth_m) / radius_m;
    if (part <= HD_DISC_ZERO_RADII) {
        *lever = (struct hd_lever){.slide = 0.0};
        return;
    }
    *lever = (struct hd_lever){.slide = 1.0 / part, .fade = 1.0};
    if (part < HD_DISC_FULL_RADII) {
        const double width = HD_DISC_FULL_RADII - HD_DISC_ZERO_RADII;
        const double x = (part - HD_DISC_ZERO_RADII) / width;
        lever->fade = x * x * (3.0 - 2.0 * x);
        lever->fade_per_m = 6.0 * x * (1.0 - x) / (width * radius_m);
    }
}

HD_RT static int has_left(const struct hd_proxy *proxy, const struct hd_object *object, uint32_t slot,
                          struct hd_feature feature, const double position_m[2], const struct hd_contact_point *point) {
    (void)feature;
    if (!(point->depth_m > 0.0)) {
        return 1;
    }
    const double radius = object->half_m[0];
    double offset[2];
    double tangent[2];
    double projected_m[2];
    hd_difference(position_m, object->point_m, offset);
    if (hd_dot(offset, point->normal) > 0.0) {
        return hd_dot(offset, offset) >= radius * radius; /* on the near side: the distance decides */
    }
    hd_proxy_project(proxy, position_m, slot, projected_m);
    hd_difference(projected_m, object->point_m, offset);
    hd_tangent(point->normal, tangent);
    return hd_magnitude(hd_dot(offset, tangent)) > radius;
}

/* Whether the segment from a to b enters the disc; finds the fraction of the segment. */
HD_RT static int enters(const struct hd_object *object, const double a[2], const double b[2], double *fraction) {
    double offset[2];
    double step[2];
    hd_difference(a, object->point_m, offset);
    hd_difference(b, a, step);
    const double linear = hd_dot(offset, step);
    const double constant = hd_dot(offset, offset) - object->half_m[0] * object->half_m[0];
    const double root = linear * linear - hd_dot(step, step) * constant;
    if (constant < -2.0 * HD_RIM_M * object->half_m[0] || !(linear < 0.0) || !(root > 0.0)) {
        return 0; /* the segment starts inside, leads away or misses the disc */
    }
    *fraction = constant > 0.0 ? constant / (hd_root(root) - linear) : 0.0;
    return *fraction < 1.0;
}

/* Fills in the onset at the point `hit` of the rim, met at `onset->fraction` of the path. Returns 0 if the disc was
 * reached along another surface and the proxy is not on it, so that it lies below that surface. */
HD_RT static int begin_at(const struct hd_proxy *proxy, const struct hd_object *object, const double hit[2],
                          struct hd_onset *onset) {
    double offset[2];
    hd_difference(hit, object->point_m, offset);
    const double distance = hd_root(hd_dot(offset, offset));
    const double bearing[2] = {offset[0] / distance, offset[1] / distance};
    if (onset->slid) {
        point_at(object, bearing, UNLIMITED_TRAVEL_M, proxy->to_m, &onset->point);
        if (has_left(proxy, object, HD_NO_SLOT, onset->feature, proxy->to_m, &onset->point)) {
            return 0;
        }
    }
    double probe_m[2];
    hd_between(proxy->from_m, proxy->to_m, onset->fraction, probe_m);
    point_at(object, bearing, UNLIMITED_TRAVEL_M, probe_m, &onset->point);
    onset->below_m = hd_shape_below(onset->point.depth_m);
    point_at(object, bearing, 0.0, hit, &onset->point);
    onset->point.arc_m = arc_length(object, onset->point.normal);
    onset->point.depth_m = 0.0;
    return 1;
}

/* Whether the probe follows a proxy that was already in the disc, which is possible where solids overlap. The force
 * then acts at once. */
HD_RT static int follows_proxy(const struct hd_proxy *proxy, const struct hd_object *object, struct hd_onset *onset) {
    if (!enters(object, proxy->from_m, proxy->to_m, &onset->fraction)) {
        return 0;
    }
    double hit[2];
    onset->silent = 0;
    onset->slid = 1;
    hd_between(proxy->from_m, proxy->to_m, onset->fraction, hit);
    return begin_at(proxy, object, hit, onset);
}

/* Whether a disc that is not touched contains the probe, because it appeared or overlaps another solid. */
HD_RT static int contains_probe(const struct hd_proxy *proxy, const struct hd_object *object, int fresh,
                                struct hd_onset *onset) {
    double to[2];
    hd_difference(proxy->to_m, object->point_m, to);
    const double distance = distance_of(to);
    if (!(distance < object->half_m[0])) {
        return 0;
    }
    onset->silent = 1;
    const double radial[2] = {distance > 0.0 ? to[0] / distance : 0.0, distance > 0.0 ? to[1] / distance : 0.0};
    point_at(object, distance > 0.0 ? radial : object->normal, 0.0, proxy->to_m, &onset->point);
    onset->point.arc_m = arc_length(object, onset->point.normal);
    onset->below_m = fresh ? 0.0 : hd_shape_below(onset->point.depth_m);
    return 1;
}

HD_RT static int meets(struct hd_proxy *proxy, const struct hd_object *object, int fresh, struct hd_onset *onset) {
    double from[2];
    hd_difference(proxy->from_m, object->point_m, from);
    const double inner = object->half_m[0] - HD_RIM_M;
    onset->feature = (struct hd_feature){.side = 1};
    onset->slid = 0;
    onset->stood = 0;
    if (fresh || hd_dot(from, from) < inner * inner) {
        return contains_probe(proxy, object, fresh, onset);
    }
    hd_proxy_sweep(proxy);
    for (uint32_t segment = 0; segment < proxy->segments; segment++) {
        const double *begin = proxy->point[segment];
        const double *end = proxy->point[segment + 1];
        double cut;
        if (!enters(object, begin, end, &cut)) {
            continue;
        }
        double straight;
        onset->silent = 0;
        if (segment > 0 && enters(object, proxy->from_m, proxy->to_m, &straight)) {
            cut = straight; /* the disc lies below the pressed surface */
            begin = proxy->from_m;
        } else {
            onset->slid = segment > 0;
            onset->stood = segment > 0 && enters(object, proxy->point[0], proxy->from_m, &straight);
        }
        double hit[2];
        hd_between(begin, end, cut, hit);
        onset->fraction = onset->slid ? 1.0 : cut;
        return begin_at(proxy, object, hit, onset);
    }
    return proxy->segments > 1 && follows_proxy(proxy, object, onset);
}

HD_RT static int holds(const struct hd_object *object, const double point_m[2]) {
    return hd_distance(point_m, object->point_m) <= object->half_m[0] + HD_RIM_M;
}

HD_RT static double distance(const struct hd_object *object, const double point_m[2]) {
    return hd_distance(point_m, object->point_m) - object->half_m[0];
}

static int is_sized(const double half_m[2], double least_m, double most_m) {
    return half_m[0] >= least_m && half_m[0] <= most_m && half_m[0] == half_m[1];
}

const struct hd_shape_operations hd_disc = {
    .meets = meets,
    .contact_point = contact_point,
    .has_left = has_left,
    .holds = holds,
    .distance = distance,
    .arc_length = arc_length,
    .lever = lever,
    .is_sized = is_sized,
};
