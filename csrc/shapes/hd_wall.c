/* Walls: half planes. d = -(p - p0).n, s = (p - p0).t; a contact begins when d goes from <= 0 to > 0. */
#include "shapes/hd_shape.h"

HD_RT static double height_of(const struct hd_object *object, const double point_m[2]) {
    double offset[2];
    hd_difference(point_m, object->point_m, offset);
    return hd_dot(offset, object->normal);
}

HD_RT static void wall_point(const struct hd_object *object, const double position_m[2],
                             struct hd_contact_point *point) {
    double offset[2];
    double tangent[2];
    hd_difference(position_m, object->point_m, offset);
    hd_tangent(object->normal, tangent);
    point->depth_m = -hd_dot(offset, object->normal);
    point->arc_m = hd_dot(offset, tangent);
    point->normal[0] = object->normal[0];
    point->normal[1] = object->normal[1];
}

HD_RT static void contact_point(const struct hd_object *object, struct hd_feature feature, const double bearing[2],
                                const double from_m[2], const double position_m[2], struct hd_contact_point *point) {
    (void)feature;
    (void)bearing;
    (void)from_m;
    wall_point(object, position_m, point);
}

HD_RT static int meets(struct hd_proxy *proxy, const struct hd_object *object, int fresh, struct hd_onset *onset) {
    wall_point(object, proxy->to_m, &onset->point);
    const double depth = onset->point.depth_m;
    if (!(depth > 0.0)) {
        return 0;
    }
    onset->feature = (struct hd_feature){.side = 1};
    onset->silent = 1;
    onset->slid = 0;
    onset->stood = 0;
    onset->below_m = 0.0;
    if (!fresh) {
        struct hd_contact_point from;
        wall_point(object, proxy->from_m, &from);
        if (from.depth_m <= 0.0) {
            onset->silent = 0;
            onset->fraction = from.depth_m / (from.depth_m - depth);
            onset->point.depth_m = 0.0;
            onset->point.arc_m = from.arc_m + onset->fraction * (onset->point.arc_m - from.arc_m);
        }
    }
    return 1;
}

HD_RT static int holds(const struct hd_object *object, const double point_m[2]) {
    return height_of(object, point_m) <= HD_RIM_M;
}

static int is_sized(const double half_m[2], double least_m, double most_m) {
    (void)least_m;
    (void)most_m;
    return half_m[0] == 0.0 && half_m[1] == 0.0;
}

const struct hd_shape_operations hd_wall = {
    .meets = meets,
    .contact_point = contact_point,
    .holds = holds,
    .distance = height_of,
    .is_sized = is_sized,
};
