/* Membranes: a spring along the normal on the side entered, until it ruptures (hd_narrow_phase.c).
 *
 * A membrane is a segment of half width w about its centre. It is entered when the way crosses it, so nothing tunnels
 * through at any speed. h = (p - c).n is the height over it; a point exactly on it counts as above. Entered from side s
 * (+1 or -1), the deflection is d = -s h, and the contact lasts while d >= 0 and the probe is not past an edge. */
#include "shapes/hd_shape.h"

HD_RT static int8_t side_of(double height) {
    return height >= 0.0 ? 1 : -1;
}

/* Along the membrane, and height over it. */
HD_RT static void on_membrane(const struct hd_object *object, const double position_m[2], double local[2]) {
    double offset[2];
    double tangent[2];
    hd_difference(position_m, object->point_m, offset);
    hd_tangent(object->normal, tangent);
    local[0] = hd_dot(offset, tangent);
    local[1] = hd_dot(offset, object->normal);
}

HD_RT void hd_membrane_place(const struct hd_object *object, int8_t side, const double position_m[2],
                             struct hd_contact_point *point) {
    double local[2];
    on_membrane(object, position_m, local);
    const double sign = (double)side;
    point->depth_m = -sign * local[1];
    point->arc_m = local[0];
    point->normal[0] = sign * object->normal[0];
    point->normal[1] = sign * object->normal[1];
}

/* Where the way from a to b crosses, and from which side; 0: it does not. */
HD_RT static int crosses(const struct hd_object *object, const double a[2], const double b[2], double *fraction,
                         int8_t *side) {
    double begin[2];
    double end[2];
    on_membrane(object, a, begin);
    on_membrane(object, b, end);
    *side = side_of(begin[1]);
    if (*side == side_of(end[1])) {
        return 0;
    }
    *fraction = begin[1] / (begin[1] - end[1]);
    return hd_magnitude(begin[0] + *fraction * (end[0] - begin[0])) <= object->half_m[0] + HD_RIM_M;
}

HD_RT int hd_membrane_meets(struct hd_context *context, const struct hd_object *object, int fresh,
                            struct hd_onset *onset) {
    if (fresh) {
        return 0; /* it has no inside */
    }
    const struct hd_proxy *path = hd_proxy_sweep(context);
    for (uint32_t leg = 0; leg < path->legs; leg++) {
        double cut;
        if (!crosses(object, path->point[leg], path->point[leg + 1], &cut, &onset->side)) {
            continue;
        }
        const double *begin = path->point[leg];
        int8_t side;
        double straight;
        onset->silent = 0;
        onset->slid = 0;
        onset->stood = 0;
        if (leg > 0 && crosses(object, context->from_m, context->input->position_m, &straight, &side) &&
            side == onset->side) {
            cut = straight; /* it lies behind what is pressed */
            begin = context->from_m;
        } else {
            onset->slid = leg > 0;
            onset->stood =
                leg > 0 && crosses(object, path->point[0], context->from_m, &straight, &side) && side == onset->side;
            hd_membrane_place(object, onset->side, context->input->position_m, &onset->point);
            if (onset->slid &&
                hd_membrane_left(context, object, HD_NO_SLOT, context->input->position_m, &onset->point)) {
                return 0; /* it lies behind, and the proxy is not on it */
            }
        }
        double hit[2];
        hd_between(begin, path->point[leg + 1], cut, hit);
        onset->fraction = onset->slid ? 1.0 : cut;
        hd_membrane_place(object, onset->side, hit, &onset->point);
        onset->point.depth_m = 0.0;
        return 1;
    }
    return 0;
}

HD_RT int hd_membrane_left(const struct hd_context *context, const struct hd_object *object, uint32_t slot,
                           const double position_m[2], const struct hd_contact_point *point) {
    if (!(point->depth_m >= 0.0)) {
        return 1;
    }
    const double along = point->arc_m + hd_proxy_offset(context, slot, object->normal, position_m);
    return hd_magnitude(along) > object->half_m[0] + HD_RIM_M;
}
