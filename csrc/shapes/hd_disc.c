/* Discs: round solids, touched at a bearing that turns with the probe.
 *
 * The bearing is the direction from the centre to the proxy, F = K (R - q) along it, q the probe's distance from the
 * centre along the bearing. The proxy goes along the rim to the point of it that is nearest to the probe, the shorter
 * way round, by at most HD_DISC_PACE times the probe's travel. So it is there in every tick unless the probe passes the
 * centre within R / HD_DISC_PACE: then it comes round after the probe, and the force has no step. Wherever it goes, it
 * goes to where K/2 (R - q)^2 is less, so that no closed path gives energy.
 *
 * s is the arc length from the top, clockwise, in (-pi R, pi R]. It goes R/r times as far as the probe at r, without
 * bound towards the centre; what depends on s (friction, geometry) fades there: see lever below. */
#include "shapes/hd_shape.h"

#define HD_DISC_PACE 24.0
/* Where what depends on s is whole, and where there is nothing of it, in radii. A proxy that comes round after the
 * probe is with it again before the probe is R HD_DISC_BARE away from the centre, whatever its path: that takes
 * sqrt(u^2 - 1) - arcsec u >= pi for u = HD_DISC_PACE HD_DISC_BARE. */
#define HD_DISC_WHOLE 0.5
#define HD_DISC_BARE 0.2
/* Instead of a travel: the disc is met, or was moved itself. The bearing follows at once, but not round the centre. */
#define MOVED 1e300

/* Turns the bearing towards the offset, by an angle of `turn` at most. A probe that is out on the far side did not come
 * there along the rim: it went through faster than that, or by the path along what is pressed as well. It is held by
 * the side that was met. */
HD_RT static void follow(const double offset[2], double radius_m, double turn, struct hd_contact_point *point) {
    const double bearing[2] = {point->normal[0], point->normal[1]};
    const double distance = hd_root(hd_dot(offset, offset));
    const double across = bearing[0] * offset[1] - bearing[1] * offset[0];
    const int ahead = hd_dot(offset, bearing) > 0.0;
    if (ahead && hd_magnitude(across) <= turn * distance) {
        point->normal[0] = offset[0] / distance;
        point->normal[1] = offset[1] / distance;
    } else if (turn > 0.0 && turn < MOVED && distance > 0.0 && (ahead || distance < radius_m)) {
        /* By the arc tangent of it, so that it never goes too far. Straight through the centre both ways are as long.
         */
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
    follow(offset, radius, travel_m < MOVED ? HD_DISC_PACE * travel_m / radius : MOVED, point);
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
    point_at(object, bearing, from_m != NULL ? hd_distance(position_m, from_m) : MOVED, position_m, point);
}

HD_RT static void lever(const struct hd_object *object, double depth_m, struct hd_lever *lever) {
    const double radius_m = object->half_m[0];
    const double part = (radius_m - depth_m) / radius_m;
    if (part <= HD_DISC_BARE) {
        *lever = (struct hd_lever){.slide = 0.0};
        return;
    }
    *lever = (struct hd_lever){.slide = 1.0 / part, .fade = 1.0};
    if (part < HD_DISC_WHOLE) {
        const double width = HD_DISC_WHOLE - HD_DISC_BARE;
        const double x = (part - HD_DISC_BARE) / width;
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
        return hd_dot(offset, offset) >= radius * radius; /* in front of the centre: out is out */
    }
    hd_proxy_project(proxy, position_m, slot, projected_m);
    hd_difference(projected_m, object->point_m, offset);
    hd_tangent(point->normal, tangent);
    return hd_magnitude(hd_dot(offset, tangent)) > radius;
}

/* Where the segment from a to b enters; 0: it does not. */
HD_RT static int enters(const struct hd_object *object, const double a[2], const double b[2], double *fraction) {
    double offset[2];
    double step[2];
    hd_difference(a, object->point_m, offset);
    hd_difference(b, a, step);
    const double linear = hd_dot(offset, step);
    const double constant = hd_dot(offset, offset) - object->half_m[0] * object->half_m[0];
    const double root = linear * linear - hd_dot(step, step) * constant;
    if (constant < -2.0 * HD_RIM_M * object->half_m[0] || !(linear < 0.0) || !(root > 0.0)) {
        return 0; /* from inside, away from it, or past it */
    }
    *fraction = constant > 0.0 ? constant / (hd_root(root) - linear) : 0.0;
    return *fraction < 1.0;
}

/* The onset where the rim was hit. 0: it slid there, and lies behind, where the proxy is not on it. */
HD_RT static int begins(const struct hd_proxy *proxy, const struct hd_object *object, const double hit[2],
                        struct hd_onset *onset) {
    double offset[2];
    hd_difference(hit, object->point_m, offset);
    const double distance = hd_root(hd_dot(offset, offset));
    const double bearing[2] = {offset[0] / distance, offset[1] / distance};
    if (onset->slid) {
        point_at(object, bearing, MOVED, proxy->to_m, &onset->point);
        if (has_left(proxy, object, HD_NO_SLOT, onset->feature, proxy->to_m, &onset->point)) {
            return 0;
        }
    }
    point_at(object, bearing, 0.0, hit, &onset->point);
    onset->point.arc_m = arc_length(object, onset->point.normal);
    onset->point.depth_m = 0.0;
    return 1;
}

/* Where solids overlap, the proxy may be in the disc before the probe is. The probe that comes after it is held at
 * once. */
HD_RT static int follows(const struct hd_proxy *proxy, const struct hd_object *object, struct hd_onset *onset) {
    if (!enters(object, proxy->from_m, proxy->to_m, &onset->fraction)) {
        return 0;
    }
    double hit[2];
    onset->silent = 0;
    onset->slid = 1;
    hd_between(proxy->from_m, proxy->to_m, onset->fraction, hit);
    return begins(proxy, object, hit, onset);
}

/* A disc that appeared around the probe. */
HD_RT static int appears(const struct hd_proxy *proxy, const struct hd_object *object, struct hd_onset *onset) {
    double to[2];
    hd_difference(proxy->to_m, object->point_m, to);
    const double distance = hd_root(hd_dot(to, to));
    if (!(distance < object->half_m[0])) {
        return 0;
    }
    onset->silent = 1;
    const double radial[2] = {distance > 0.0 ? to[0] / distance : 0.0, distance > 0.0 ? to[1] / distance : 0.0};
    point_at(object, distance > 0.0 ? radial : object->normal, 0.0, proxy->to_m, &onset->point);
    onset->point.arc_m = arc_length(object, onset->point.normal);
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
        return appears(proxy, object, onset);
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
            cut = straight; /* it lies behind what is pressed */
            begin = proxy->from_m;
        } else {
            onset->slid = segment > 0;
            onset->stood = segment > 0 && enters(object, proxy->point[0], proxy->from_m, &straight);
        }
        double hit[2];
        hd_between(begin, end, cut, hit);
        onset->fraction = onset->slid ? 1.0 : cut;
        return begins(proxy, object, hit, onset);
    }
    return proxy->segments > 1 && follows(proxy, object, onset);
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
