/* Discs: round solids, touched at a bearing that turns with the probe.
 *
 * The bearing is the direction from the centre to the proxy that the probe is held by, F = K (R - q) along it,
 * q the probe's way from the centre along the bearing. The proxy goes along the rim to the point of it that is
 * nearest to the probe, the shorter way round, by at most HD_DISC_PACE of the way that the probe goes. So it is there
 * in every tick unless the probe passes the centre within R / HD_DISC_PACE: then it comes round after it, and the force
 * has no step. Wherever it goes, it goes to where K/2 (R - q)^2 is less, so that no closed way gives energy.
 *
 * s is the arc length from the top, clockwise, in (-pi R, pi R]. It goes by R/r of the probe's own way at r, without
 * bound towards the centre; what depends on s (friction, geometry) fades there: see hd_disc_lever. */
#include "shapes/hd_shape.h"

#define HD_DISC_PACE 24.0
/* Where what depends on s is whole, and where there is nothing of it, in radii. A proxy that comes round after
 * the probe is with it again before that is R HD_DISC_BARE away from the centre, whatever its way: that takes
 * sqrt(u^2 - 1) - arcsec u >= pi for u = HD_DISC_PACE HD_DISC_BARE. */
#define HD_DISC_WHOLE 0.5
#define HD_DISC_BARE 0.2

/* Turns the bearing towards the offset, by an angle of `turn` at most. A probe that is out on the far side did not come
 * there along the rim: it went through faster than that, or by the way along what is pressed as well. It is held by the
 * side that was met. */
HD_RT static void follow(const double offset[2], double radius_m, double turn, struct hd_contact_point *point) {
    const double bearing[2] = {point->normal[0], point->normal[1]};
    const double distance = hd_root(hd_dot(offset, offset));
    const double across = bearing[0] * offset[1] - bearing[1] * offset[0];
    const int ahead = hd_dot(offset, bearing) > 0.0;
    if (ahead && hd_magnitude(across) <= turn * distance) {
        point->normal[0] = offset[0] / distance;
        point->normal[1] = offset[1] / distance;
    } else if (turn > 0.0 && turn < HD_DISC_MOVED && distance > 0.0 && (ahead || distance < radius_m)) {
        /* By the arc tangent of it, so that it never goes too far. Straight through the centre both ways are as long.
         */
        const double most = turn < 1.0 ? turn : 1.0;
        const double step = across > 0.0 ? most : -most;
        const double length = hd_root(1.0 + step * step);
        point->normal[0] = (bearing[0] - step * bearing[1]) / length;
        point->normal[1] = (bearing[1] + step * bearing[0]) / length;
    }
}

HD_RT void hd_disc_place(const struct hd_object *object, const double bearing[2], double travel_m, int along,
                         const double position_m[2], struct hd_contact_point *point) {
    const double radius = object->half_m[0];
    double offset[2];
    hd_difference(position_m, object->point_m, offset);
    point->normal[0] = bearing[0];
    point->normal[1] = bearing[1];
    follow(offset, radius, travel_m < HD_DISC_MOVED ? HD_DISC_PACE * travel_m / radius : HD_DISC_MOVED, point);
    point->depth_m = radius - hd_dot(offset, point->normal);
    point->arc_m = 0.0;
    if (along) {
        HD_RT_FOREIGN_BEGIN
        point->arc_m = radius * atan2(point->normal[0], point->normal[1]);
        HD_RT_FOREIGN_END
    }
}

HD_RT void hd_disc_lever(double radius_m, double depth_m, struct hd_lever *lever) {
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

/* Where the way from a to b enters; 0: it does not. */
HD_RT static int enters(const struct hd_object *object, const double a[2], const double b[2], double *fraction) {
    double offset[2];
    double way[2];
    hd_difference(a, object->point_m, offset);
    hd_difference(b, a, way);
    const double linear = hd_dot(offset, way);
    const double constant = hd_dot(offset, offset) - object->half_m[0] * object->half_m[0];
    const double root = linear * linear - hd_dot(way, way) * constant;
    if (constant < -2.0 * HD_RIM_M * object->half_m[0] || !(linear < 0.0) || !(root > 0.0)) {
        return 0; /* from inside, away from it, or past it */
    }
    *fraction = constant > 0.0 ? constant / (hd_root(root) - linear) : 0.0;
    return *fraction < 1.0;
}

/* The onset where the rim was hit. 0: it slid there, and lies behind, where the proxy is not on it. */
HD_RT static int begins(const struct hd_context *context, const struct hd_object *object, const double hit[2],
                        struct hd_onset *onset) {
    double offset[2];
    hd_difference(hit, object->point_m, offset);
    const double distance = hd_root(hd_dot(offset, offset));
    const double bearing[2] = {offset[0] / distance, offset[1] / distance};
    if (onset->slid) {
        hd_disc_place(object, bearing, HD_DISC_MOVED, 0, context->input->position_m, &onset->point);
        if (hd_disc_left(context, object, HD_NO_SLOT, context->input->position_m, &onset->point)) {
            return 0;
        }
    }
    hd_disc_place(object, bearing, 0.0, 1, hit, &onset->point);
    onset->point.depth_m = 0.0;
    return 1;
}

/* Where solids overlap, the proxy may be in the disc before the probe is. The probe that comes after it is held
 * at once. */
HD_RT static int follows(const struct hd_context *context, const struct hd_object *object, struct hd_onset *onset) {
    if (!enters(object, context->from_m, context->input->position_m, &onset->fraction)) {
        return 0;
    }
    double hit[2];
    onset->silent = 0;
    onset->slid = 1;
    hd_between(context->from_m, context->input->position_m, onset->fraction, hit);
    return begins(context, object, hit, onset);
}

HD_RT int hd_disc_meets(struct hd_context *context, const struct hd_object *object, int fresh, struct hd_onset *onset) {
    const double radius = object->half_m[0];
    double from[2];
    double to[2];
    hd_difference(context->from_m, object->point_m, from);
    hd_difference(context->input->position_m, object->point_m, to);
    const double inner = radius - HD_RIM_M;
    onset->side = 1;
    onset->slid = 0;
    onset->stood = 0;
    if (fresh || hd_dot(from, from) < inner * inner) {
        const double distance = hd_root(hd_dot(to, to));
        if (!(distance < radius)) {
            return 0;
        }
        onset->silent = 1;
        const double *bearing = object->normal;
        const double radial[2] = {distance > 0.0 ? to[0] / distance : 0.0, distance > 0.0 ? to[1] / distance : 0.0};
        hd_disc_place(object, distance > 0.0 ? radial : bearing, 0.0, 1, context->input->position_m, &onset->point);
        return 1;
    }
    const struct hd_proxy *path = hd_proxy_sweep(context);
    for (uint32_t leg = 0; leg < path->legs; leg++) {
        double cut;
        if (!enters(object, path->point[leg], path->point[leg + 1], &cut)) {
            continue;
        }
        const double *begin = path->point[leg];
        double straight;
        onset->silent = 0;
        if (leg > 0 && enters(object, context->from_m, context->input->position_m, &straight)) {
            cut = straight; /* it lies behind what is pressed */
            begin = context->from_m;
        } else {
            onset->slid = leg > 0;
            onset->stood = leg > 0 && enters(object, path->point[0], context->from_m, &straight);
        }
        double hit[2];
        hd_between(begin, path->point[leg + 1], cut, hit);
        onset->fraction = onset->slid ? 1.0 : cut;
        return begins(context, object, hit, onset);
    }
    return path->legs > 1 && follows(context, object, onset);
}

HD_RT int hd_disc_left(const struct hd_context *context, const struct hd_object *object, uint32_t slot,
                       const double position_m[2], const struct hd_contact_point *point) {
    if (!(point->depth_m > 0.0)) {
        return 1;
    }
    const double radius = object->half_m[0];
    double offset[2];
    double tangent[2];
    double lifted[2];
    hd_difference(position_m, object->point_m, offset);
    if (hd_dot(offset, point->normal) > 0.0) {
        return hd_dot(offset, offset) >= radius * radius; /* in front of the centre: out is out */
    }
    hd_proxy_project(context, position_m, slot, lifted);
    hd_difference(lifted, object->point_m, offset);
    hd_tangent(point->normal, tangent);
    return hd_magnitude(hd_dot(offset, tangent)) > radius;
}
