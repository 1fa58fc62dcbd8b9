/* Walls: half planes. d = -(p - p0).n, s = (p - p0).t; met when d goes from <= 0 to > 0. */
#include "shapes/hd_shape.h"

HD_RT void hd_wall_place(const struct hd_object *object, const double position_m[2], struct hd_contact_point *point) {
    double offset[2];
    double tangent[2];
    hd_difference(position_m, object->point_m, offset);
    hd_tangent(object->normal, tangent);
    point->depth_m = -hd_dot(offset, object->normal);
    point->arc_m = hd_dot(offset, tangent);
    point->normal[0] = object->normal[0];
    point->normal[1] = object->normal[1];
}

HD_RT int hd_wall_meets(struct hd_context *context, const struct hd_object *object, int fresh, struct hd_onset *onset) {
    hd_wall_place(object, context->input->position_m, &onset->point);
    const double depth = onset->point.depth_m;
    if (!(depth > 0.0)) {
        return 0;
    }
    onset->side = 1;
    onset->silent = 1;
    onset->slid = 0;
    onset->stood = 0;
    if (!fresh) {
        struct hd_contact_point from;
        hd_wall_place(object, context->from_m, &from);
        if (from.depth_m <= 0.0) {
            onset->silent = 0;
            onset->fraction = from.depth_m / (from.depth_m - depth);
            onset->point.depth_m = 0.0;
            onset->point.arc_m = from.arc_m + onset->fraction * (onset->point.arc_m - from.arc_m);
        }
    }
    return 1;
}
