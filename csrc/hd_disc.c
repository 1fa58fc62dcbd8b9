/* Discs: round solids, touched at a bearing that turns with the probe.
 *
 * The bearing is the direction from the centre to the point of the surface that the probe pushes against. In ordinary
 * contact it points to the probe, so that F = K (R - r) along the radius. Deep inside, where the direction to the probe
 * turns by any angle within any distance, the bearing turns no faster than the probe travels on half the radius, and
 * not at all once the probe is behind the centre: a probe that is pressed through a disc is held on the side that it
 * came from. s is the arc length from the top, clockwise, in (-pi R, pi R]. */
#include "hd_shape.h"

/* Where the bearing follows without bound. */
#define HD_DISC_SHALLOW 0.5

HD_RT void hd_disc_place(const struct hd_object *object, const double bearing[2], double travel_m, int along,
                         const double position_m[2], struct hd_place *place) {
    const double radius = object->half_m[0];
    double offset[2];
    hd_difference(position_m, object->point_m, offset);
    const double distance = hd_root(hd_dot(offset, offset));
    const double ahead = hd_dot(offset, bearing);
    place->normal[0] = bearing[0];
    place->normal[1] = bearing[1];
    if (ahead > 0.0) {
        /* The turn, in radians, that the probe's way allows. */
        const double turn = travel_m / radius * (distance >= HD_DISC_SHALLOW * radius ? 4.0 : 1.0);
        const double across = (bearing[0] * offset[1] - bearing[1] * offset[0]) / distance; /* sine of the angle */
        const double sine = turn < 1.0 ? turn * (1.0 - turn * turn / 6.0) : 1.0;
        if (hd_magnitude(across) <= sine) {
            place->normal[0] = offset[0] / distance;
            place->normal[1] = offset[1] / distance;
        } else {
            const double step = across > 0.0 ? turn : -turn;
            const double length = hd_root(1.0 + step * step);
            place->normal[0] = (bearing[0] - step * bearing[1]) / length;
            place->normal[1] = (bearing[1] + step * bearing[0]) / length;
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

HD_RT int hd_disc_meets(struct hd_walk *walk, const struct hd_object *object, int fresh, struct hd_onset *onset) {
    const double radius = object->half_m[0];
    double from[2];
    double to[2];
    hd_difference(walk->from_m, object->point_m, from);
    hd_difference(walk->input->position_m, object->point_m, to);
    const double square = radius * radius;
    onset->side = 1;
    if (fresh || hd_dot(from, from) < square) {
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
        double a[2];
        double way[2];
        hd_difference(path->point[leg], object->point_m, a);
        hd_difference(path->point[leg + 1], path->point[leg], way);
        const double quadratic = hd_dot(way, way);
        const double linear = hd_dot(a, way);
        const double constant = hd_dot(a, a) - square;
        const double root = linear * linear - quadratic * constant;
        if (constant < 0.0 || !(linear < 0.0) || !(root > 0.0)) {
            continue; /* from inside, away from it, or past it */
        }
        const double cut = constant / (hd_root(root) - linear);
        if (cut < 1.0) {
            double hit[2];
            hd_between(a, &(const double[2]){a[0] + way[0], a[1] + way[1]}[0], cut, hit);
            const double distance = hd_root(hd_dot(hit, hit));
            const double bearing[2] = {hit[0] / distance, hit[1] / distance};
            onset->silent = 0;
            onset->fraction = leg == 0 ? cut : 1.0;
            hd_disc_place(object, bearing, 0.0, 1,
                          &(const double[2]){object->point_m[0] + hit[0], object->point_m[1] + hit[1]}[0],
                          &onset->place);
            onset->place.depth_m = 0.0;
            return 1;
        }
    }
    return 0;
}

HD_RT int hd_disc_left(const struct hd_walk *walk, const struct hd_object *object, uint32_t slot,
                       const struct hd_place *place) {
    if (!(place->depth_m > 0.0)) {
        return 1;
    }
    const double radius = object->half_m[0];
    double offset[2];
    double tangent[2];
    double lifted[2];
    hd_difference(walk->input->position_m, object->point_m, offset);
    if (hd_dot(offset, place->normal) > 0.0) {
        return hd_dot(offset, offset) >= radius * radius; /* in front of the centre: out is out */
    }
    hd_path_lift(walk, walk->input->position_m, slot, lifted);
    hd_difference(lifted, object->point_m, offset);
    hd_tangent(place->normal, tangent);
    return hd_magnitude(hd_dot(offset, tangent)) > radius;
}
