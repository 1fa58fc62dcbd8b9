/* Surface properties at an arc length: of one material, or blended at the edge of two pieces. */
#include "tick/hd_surface.h"

#include "tick/hd_groove_profile.h"

HD_RT static double interpolate(double from, double to, double weight) {
    return from + weight * (to - from);
}

HD_RT void hd_surface_lower(const struct hd_material *material, double arc_m, double half_length_m,
                            struct hd_surface *surface) {
    double slope;
    const double height = hd_groove_profile(material, arc_m, half_length_m, &slope);
    if (material->texture == HD_TEXTURE_GEOMETRY) {
        surface->lowering_m = material->depth_m * height;
        surface->lowering_slope = material->depth_m * slope;
    } else {
        surface->drag_n_s_per_m = material->drag_n_s_per_m * height;
    }
}

/* Writes the blend of two surfaces (0: `from`, 1: `to`) into `surface`, which may be one of the two. */
HD_RT static void blend_into(const struct hd_surface *from, const struct hd_surface *to, double blend,
                             struct hd_surface *surface) {
    surface->stiffness_n_per_m = interpolate(from->stiffness_n_per_m, to->stiffness_n_per_m, blend);
    surface->stiffness_slope = interpolate(from->stiffness_slope, to->stiffness_slope, blend);
    surface->damping_n_s_per_m = interpolate(from->damping_n_s_per_m, to->damping_n_s_per_m, blend);
    surface->lowering_m = interpolate(from->lowering_m, to->lowering_m, blend);
    surface->lowering_slope = interpolate(from->lowering_slope, to->lowering_slope, blend);
    surface->drag_n_s_per_m = interpolate(from->drag_n_s_per_m, to->drag_n_s_per_m, blend);
    /* A material without friction has no spring stiffness; the blend takes that of the other one. */
    const double first = from->friction_stiffness_n_per_m;
    const double last = to->friction_stiffness_n_per_m;
    surface->friction_stiffness_n_per_m = last == 0.0 ? first : first == 0.0 ? last : interpolate(first, last, blend);
    surface->friction_coefficient = interpolate(from->friction_coefficient, to->friction_coefficient, blend);
}

HD_RT uint32_t hd_surface_piece(const struct hd_table *table, const struct hd_object *object, double arc_m) {
    const struct hd_piece *pieces = &table->pieces[object->piece_first];
    uint32_t low = 0;
    uint32_t high = object->piece_count;
    while (high - low > 1) {
        const uint32_t middle = low + (high - low) / 2u;
        if (pieces[middle].from_m <= arc_m) {
            low = middle;
        } else {
            high = middle;
        }
    }
    return low;
}

HD_RT struct hd_dominant_material hd_surface_of_pieces(const struct hd_table *table, const struct hd_object *object,
                                                       double arc_m, double half_length_m, struct hd_surface *surface) {
    const struct hd_piece *pieces = &table->pieces[object->piece_first];
    const uint32_t here = hd_surface_piece(table, object, arc_m);
    /* Index of the edge whose ramp contains s: the edge before this piece or after it; 0: neither. */
    uint32_t edge = 0;
    if (here > 0 && arc_m < pieces[here].from_m + pieces[here].half_ramp_m) {
        edge = here;
    } else if (here + 1 < object->piece_count && arc_m > pieces[here + 1].from_m - pieces[here + 1].half_ramp_m) {
        edge = here + 1;
    }
    const struct hd_material *material = &table->materials[pieces[here].material];
    hd_surface_of(material, arc_m, half_length_m, surface);
    if (edge == 0) {
        return (struct hd_dominant_material){material, 1.0};
    }
    const double half = pieces[edge].half_ramp_m;
    const double x = (arc_m - (pieces[edge].from_m - half)) / (2.0 * half);
    const double weight = x * x * (3.0 - 2.0 * x);
    const double slope = 6.0 * x * (1.0 - x) / (2.0 * half);
    const struct hd_material *other = &table->materials[pieces[edge == here ? here - 1 : edge].material];
    struct hd_surface second;
    hd_surface_of(other, arc_m, half_length_m, &second);
    const struct hd_surface *const before = edge == here ? &second : surface;
    const struct hd_surface *const after = edge == here ? surface : &second;
    const double stiffness_step = after->stiffness_n_per_m - before->stiffness_n_per_m;
    const double lowering_step = after->lowering_m - before->lowering_m;
    /* Blended in place: reading a struct that was just written would stall on its stores. */
    blend_into(before, after, weight, surface);
    surface->stiffness_slope += slope * stiffness_step;
    surface->lowering_slope += slope * lowering_step;
    const double own = edge == here ? weight : 1.0 - weight;
    const int both = other->texture == HD_TEXTURE_NOISE;
    return (struct hd_dominant_material){material, both ? 1.0 : own > 0.5 ? 2.0 * own - 1.0 : 0.0};
}
