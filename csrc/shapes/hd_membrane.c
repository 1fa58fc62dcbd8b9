/* Membranes: a spring along the normal, on the side from which the probe came, until it ruptures (hd_rupture.c).
 *
 * A membrane is a segment of half width w about its centre c. A contact begins when the path crosses it, so no probe
 * tunnels through at any speed. h = (p - c).n is the height above it; a point exactly on it counts as above. If the
 * probe comes from side s (+1 or -1), the deflection is d = -s h. The contact lasts while d >= 0 and the probe is not
 * past an edge. */
#include "shapes/hd_shape.h"

HD_RT static int8_t side_of(double height) {
    return height >= 0.0 ? 1 : -1;
}

/* Converts a position to the axes of the membrane: position along it, height above it. */
HD_RT static void to_membrane_axes(const struct hd_object *object, const double position_m[2], double local[2]) {
    double offset[2];
    double tangent[2];
    hd_difference(position_m, object->point_m, offset);
    hd_tangent(object->normal, tangent);
    local[0] = hd_dot(offset, tangent);
    local[1] = hd_dot(offset, object->normal);
}

HD_RT static void point_on_side(const struct hd_object *object, int8_t side, const double position_m[2],
                                struct hd_contact_point *point) {
    double local[2];
    to_membrane_axes(object, position_m, local);
    const double sign = (double)side;
    point->depth_m = -sign * local[1];
    point->arc_m = local[0];
    point->normal[0] = sign * object->normal[0];
    point->normal[1] = sign * object->normal[1];
}

HD_RT static void contact_point(const struct hd_object *object, struct hd_feature feature, const double bearing[2],
                                const double from_m[2], const double position_m[2], struct hd_contact_point *point) {
    (void)bearing;
    (void)from_m;
    point_on_side(object, feature.side, position_m, point);
}

/* Whether the segment from a to b crosses the membrane, or its line up to `beyond_m` past an end; finds the fraction of
 * the segment and the side it comes from. */
HD_RT static int crosses(const struct hd_object *object, const double a[2], const double b[2], double beyond_m,
                         double *fraction, int8_t *side) {
    double begin[2];
    double end[2];
    to_membrane_axes(object, a, begin);
    to_membrane_axes(object, b, end);
    *side = side_of(begin[1]);
    if (*side == side_of(end[1])) {
        return 0;
    }
    *fraction = begin[1] / (begin[1] - end[1]);
    return hd_magnitude(begin[0] + *fraction * (end[0] - begin[0])) <= object->half_m[0] + beyond_m;
}

HD_RT static double half_length(const struct hd_object *object, struct hd_feature feature) {
    (void)feature;
    return object->half_m[0];
}

HD_RT static int has_left(const struct hd_proxy *proxy, const struct hd_object *object, uint32_t slot,
                          struct hd_feature feature, const double position_m[2], const struct hd_contact_point *point) {
    (void)feature;
    if (!(point->depth_m >= 0.0)) {
        return 1;
    }
    const double along = point->arc_m + hd_proxy_offset(proxy, slot, object->normal, position_m);
    return hd_proxy_is_past_end(proxy, slot, object->normal, along, hd_magnitude(along) - object->half_m[0]);
}

HD_RT static int meets(struct hd_proxy *proxy, const struct hd_object *object, int fresh, struct hd_onset *onset) {
    if (fresh) {
        return 0; /* a membrane has no inside that could contain the probe */
    }
    hd_proxy_sweep(proxy);
    for (uint32_t segment = 0; segment < proxy->segments; segment++) {
        const double *begin = proxy->point[segment];
        const double *end = proxy->point[segment + 1];
        double cut;
        /* Along pressed surfaces the proxy passes above an end that is flush with them. */
        const double beyond_m = segment + 1 < proxy->segments ? -HD_RIM_M : HD_FLUSH_M;
        if (!crosses(object, begin, end, beyond_m, &cut, &onset->feature.side)) {
            continue;
        }
        int8_t side;
        double straight;
        onset->feature.face = 0;
        onset->silent = 0;
        onset->slid = 0;
        onset->stood = 0;
        if (segment > 0 && crosses(object, proxy->from_m, proxy->to_m, HD_FLUSH_M, &straight, &side) &&
            side == onset->feature.side) {
            cut = straight; /* the membrane lies below the pressed surface */
            begin = proxy->from_m;
        } else {
            onset->slid = segment > 0;
            onset->stood = segment > 0 &&
                           crosses(object, proxy->point[0], proxy->from_m, HD_FLUSH_M, &straight, &side) &&
                           side == onset->feature.side;
            point_on_side(object, onset->feature.side, proxy->to_m, &onset->point);
            if (onset->slid && has_left(proxy, object, HD_NO_SLOT, onset->feature, proxy->to_m, &onset->point)) {
                return 0; /* the membrane lies below the pressed surface, and the proxy is past its edge */
            }
        }
        double hit[2];
        hd_between(begin, end, cut, hit);
        onset->fraction = onset->slid ? 1.0 : cut;
        double probe_m[2];
        hd_between(proxy->from_m, proxy->to_m, onset->fraction, probe_m);
        point_on_side(object, onset->feature.side, probe_m, &onset->point);
        onset->below_m = hd_shape_below(onset->point.depth_m);
        point_on_side(object, onset->feature.side, hit, &onset->point);
        onset->point.depth_m = 0.0;
        return 1;
    }
    return 0;
}

HD_RT static int holds(const struct hd_object *object, const double point_m[2]) {
    (void)object;
    (void)point_m;
    return 0;
}

HD_RT static double distance(const struct hd_object *object, const double point_m[2]) {
    double local[2];
    to_membrane_axes(object, point_m, local);
    const double beside = hd_magnitude(local[0]) - object->half_m[0];
    return hd_magnitude(local[1]) > beside ? hd_magnitude(local[1]) : beside;
}

static int is_sized(const double half_m[2], double least_m, double most_m) {
    return half_m[0] >= least_m && half_m[0] <= most_m && half_m[1] == 0.0;
}

const struct hd_shape_operations hd_membrane = {
    .meets = meets,
    .contact_point = contact_point,
    .has_left = has_left,
    .holds = holds,
    .distance = distance,
    .half_length = half_length,
    .is_sized = is_sized,
    .membrane = 1,
};
