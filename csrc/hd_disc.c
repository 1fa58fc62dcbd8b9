/* Discs: round solids, touched at a bearing that turns with the probe.
 *
 * The bearing is the direction from the centre to the point of the surface that the probe pushes against. In ordinary
 * contact it points to the probe, so that F = K (R - r) along the radius. Nearer to the centre than half the radius,
 * where the direction to the probe turns by any angle within any distance, the bearing stays as it is; and where the
 * probe has come too far round from it meanwhile, it goes on to stay: a probe that is pressed through a disc is held on
 * the side that it came from. s is the arc length from the top, clockwise, in (-pi R, pi R]. */
#include "hd_shape.h"

/* Where the bearing follows, in radii. */
#define HD_DISC_SHALLOW 0.5
/* How far behind the probe it may be to follow, as a sine; and how fast it makes up for that, per way in radii. */
#define HD_DISC_BEHIND (1.0 / 3.0)
#define HD_DISC_PACE 4.0

HD_RT static void turn_to(const double offset[2], double distance, double turn, struct hd_place *place) {
    const double bearing[2] = {place->normal[0], place->normal[1]};
    const double across = (bearing[0] * offset[1] - bearing[1] * offset[0]) / distance; /* sine of the angle */
    if (hd_magnitude(across) <= turn) {
        place->normal[0] = offset[0] / distance;
        place->normal[1] = offset[1] / distance;
    } else if (hd_magnitude(across) <= HD_DISC_BEHIND) {
        const double step = across > 0.0 ? turn : -turn;
        const double length = hd_root(1.0 + step * step);
        place->normal[0] = (bearing[0] - step * bearing[1]) / length;
        place->normal[1] = (bearing[1] + step * bearing[0]) / length;
    }
}

HD_RT void hd_disc_place(const struct hd_object *object, const double bearing[2], double travel_m, int along,
                         const double position_m[2], struct hd_place *place) {
    const double radius = object->half_m[0];
    double offset[2];
    hd_difference(position_m, object->point_m, offset);
    const double distance = hd_root(hd_dot(offset, offset));
    place->normal[0] = bearing[0];
    place->normal[1] = bearing[1];
    if (hd_dot(offset, bearing) > 0.0) {
        const double pace = HD_DISC_PACE * travel_m / radius;
        if (travel_m >= HD_DISC_MOVED) {
            turn_to(offset, distance, 1.0, place);
        } else if (distance >= HD_DISC_SHALLOW * radius) {
            turn_to(offset, distance, pace < HD_DISC_BEHIND ? pace : HD_DISC_BEHIND, place);
        }
    }
    place->depth_m = radius - hd_dot(offset, place->normal);
    place->along_m = 0.0;
    if (along) {
        HD_RT_FOREIGN_BEGIN
        place->along_m = radius * atan2(place->normal[0], place->normal[1]);
        HD_RT_FOREIGN_END
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

HD_RT int hd_disc_meets(struct hd_walk *walk, const struct hd_object *object, int fresh, struct hd_onset *onset) {
    const double radius = object->half_m[0];
    double from[2];
    double to[2];
    hd_difference(walk->from_m, object->point_m, from);
    hd_difference(walk->input->position_m, object->point_m, to);
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
        hd_disc_place(object, distance > 0.0 ? radial : bearing, 0.0, 1, walk->input->position_m, &onset->place);
        return 1;
    }
    const struct hd_path *path = hd_path_legs(walk);
    for (uint32_t leg = 0; leg < path->legs; leg++) {
        double cut;
        if (!enters(object, path->point[leg], path->point[leg + 1], &cut)) {
            continue;
        }
        const double *begin = path->point[leg];
        double straight;
        onset->silent = 0;
        if (leg > 0 && enters(object, walk->from_m, walk->input->position_m, &straight)) {
            cut = straight; /* it lies behind what is pressed */
            begin = walk->from_m;
        } else {
            onset->slid = leg > 0;
            onset->stood = leg > 0 && enters(object, path->point[0], walk->from_m, &straight);
        }
        double hit[2];
        double offset[2];
        hd_between(begin, path->point[leg + 1], cut, hit);
        onset->fraction = onset->slid ? 1.0 : cut;
        hd_difference(hit, object->point_m, offset);
        const double distance = hd_root(hd_dot(offset, offset));
        const double bearing[2] = {offset[0] / distance, offset[1] / distance};
        if (onset->slid) {
            double way[2];
            hd_difference(walk->input->position_m, walk->from_m, way);
            hd_disc_place(object, bearing, hd_root(hd_dot(way, way)), 0, walk->input->position_m, &onset->place);
            if (hd_disc_left(walk, object, HD_NO_SLOT, walk->input->position_m, &onset->place)) {
                return 0; /* it lies behind, and the surface point is not on it */
            }
        }
        hd_disc_place(object, bearing, 0.0, 1, hit, &onset->place);
        onset->place.depth_m = 0.0;
        return 1;
    }
    return 0;
}

HD_RT int hd_disc_left(const struct hd_walk *walk, const struct hd_object *object, uint32_t slot,
                       const double position_m[2], const struct hd_place *place) {
    if (!(place->depth_m > 0.0)) {
        return 1;
    }
    const double radius = object->half_m[0];
    double offset[2];
    double tangent[2];
    double lifted[2];
    hd_difference(position_m, object->point_m, offset);
    if (hd_dot(offset, place->normal) > 0.0) {
        return hd_dot(offset, offset) >= radius * radius; /* in front of the centre: out is out */
    }
    hd_path_lift(walk, position_m, slot, lifted);
    hd_difference(lifted, object->point_m, offset);
    hd_tangent(place->normal, tangent);
    return hd_magnitude(hd_dot(offset, tangent)) > radius;
}
