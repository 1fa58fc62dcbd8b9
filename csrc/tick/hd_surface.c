#include "tick/hd_surface.h"

#include "tick/hd_groove.h"

HD_RT static double mixed(double from, double to, double weight) {
    return from + weight * (to - from);
}

/* One material alone. */
HD_RT static void plain(const struct hd_material *material, double along_m, double half_length_m,
                        struct hd_skin *skin) {
    *skin = (struct hd_skin){
        .stiffness_n_per_m = material->stiffness_n_per_m,
        .damping_n_s_per_m = material->damping_n_s_per_m,
        .friction_coefficient = material->friction_coefficient,
        .friction_stiffness_n_per_m = material->friction_stiffness_n_per_m,
    };
    if (material->texture == HD_TEXTURE_GEOMETRY || material->texture == HD_TEXTURE_DRAG) {
        double slope;
        const double height = hd_groove_profile(material, along_m, half_length_m, &slope);
        if (material->texture == HD_TEXTURE_GEOMETRY) {
            skin->lowering_m = material->depth_m * height;
            skin->lowering_slope = material->depth_m * slope;
        } else {
            skin->drag_n_s_per_m = material->drag_n_s_per_m * height;
        }
    }
}

HD_RT void hd_skin_blend(const struct hd_skin *from, double blend, struct hd_skin *skin) {
    skin->stiffness_n_per_m = mixed(from->stiffness_n_per_m, skin->stiffness_n_per_m, blend);
    skin->stiffness_slope = mixed(from->stiffness_slope, skin->stiffness_slope, blend);
    skin->damping_n_s_per_m = mixed(from->damping_n_s_per_m, skin->damping_n_s_per_m, blend);
    skin->lowering_m = mixed(from->lowering_m, skin->lowering_m, blend);
    skin->lowering_slope = mixed(from->lowering_slope, skin->lowering_slope, blend);
    skin->drag_n_s_per_m = mixed(from->drag_n_s_per_m, skin->drag_n_s_per_m, blend);
    /* What has no friction has no spring of its own either. */
    if (skin->friction_stiffness_n_per_m == 0.0) {
        skin->friction_stiffness_n_per_m = from->friction_stiffness_n_per_m;
    } else if (from->friction_stiffness_n_per_m != 0.0) {
        skin->friction_stiffness_n_per_m =
            mixed(from->friction_stiffness_n_per_m, skin->friction_stiffness_n_per_m, blend);
    }
    skin->friction_coefficient = mixed(from->friction_coefficient, skin->friction_coefficient, blend);
}

HD_RT uint32_t hd_skin_piece(const struct hd_table *table, const struct hd_object *object, double along_m) {
    const struct hd_piece *pieces = &table->pieces[object->piece_first];
    uint32_t low = 0;
    uint32_t high = object->piece_count;
    while (high - low > 1) {
        const uint32_t middle = low + (high - low) / 2u;
        if (pieces[middle].from_m <= along_m) {
            low = middle;
        } else {
            high = middle;
        }
    }
    return low;
}

HD_RT struct hd_under hd_skin_at(const struct hd_table *table, const struct hd_object *object, double along_m,
                                 double half_length_m, struct hd_skin *skin) {
    if (object->piece_count == 0) {
        const struct hd_material *material = &table->materials[object->material];
        plain(material, along_m, half_length_m, skin);
        return (struct hd_under){material, 1.0};
    }
    const struct hd_piece *pieces = &table->pieces[object->piece_first];
    const uint32_t here = hd_skin_piece(table, object, along_m);
    /* The edge whose ramp holds s: that before this piece, or that after it. */
    uint32_t edge = 0;
    if (here > 0 && along_m < pieces[here].from_m + pieces[here].half_ramp_m) {
        edge = here;
    } else if (here + 1 < object->piece_count && along_m > pieces[here + 1].from_m - pieces[here + 1].half_ramp_m) {
        edge = here + 1;
    }
    const struct hd_material *material = &table->materials[pieces[here].material];
    plain(material, along_m, half_length_m, skin);
    if (edge == 0) {
        return (struct hd_under){material, 1.0};
    }
    const double half = pieces[edge].half_ramp_m;
    const double x = (along_m - (pieces[edge].from_m - half)) / (2.0 * half);
    const double weight = x * x * (3.0 - 2.0 * x);
    const double slope = 6.0 * x * (1.0 - x) / (2.0 * half);
    const struct hd_material *other = &table->materials[pieces[edge == here ? here - 1 : edge].material];
    struct hd_skin second;
    plain(other, along_m, half_length_m, &second);
    const struct hd_skin before = edge == here ? second : *skin;
    struct hd_skin mix = edge == here ? *skin : second;
    const double stiffness_step = mix.stiffness_n_per_m - before.stiffness_n_per_m;
    const double lowering_step = mix.lowering_m - before.lowering_m;
    hd_skin_blend(&before, weight, &mix);
    mix.stiffness_slope += slope * stiffness_step;
    mix.lowering_slope += slope * lowering_step;
    *skin = mix;
    const double own = edge == here ? weight : 1.0 - weight;
    const int both = other->texture == HD_TEXTURE_NOISE;
    return (struct hd_under){material, both ? 1.0 : own > 0.5 ? 2.0 * own - 1.0 : 0.0};
}
