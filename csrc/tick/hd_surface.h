/* Surface properties: what the materials of an object give at one arc length of it.
 *
 * A wall may be of several materials, in pieces along s. Where one goes over into the next, every parameter x does, by
 *     x(s) = x_a + w(s) (x_b - x_a),  w a smooth step from 0 to 1 over the ramp of the edge,
 * and the force is that of the energy U(s, d) = K(s)/2 max(0, d - H(s))^2, H what geometry lowers the surface by:
 *     normal part K (d - H), tangential part K (d - H) H' - K'/2 (d - H)^2.
 * So neither a groove nor an edge creates energy. w has a continuous slope, and so have the raised cosines of geometry:
 * the force has no step. */
#ifndef HD_SURFACE_H
#define HD_SURFACE_H

#include "base/hd_rt.h"
#include "tick/hd_state.h"

struct hd_dominant_material {
    const struct hd_material *material; /* that weighs most: whose modes and texture are displayed */
    double noise_weight;                /* weight of its noise, 1 but near an edge to a material without */
};

/* What grooves that are displayed as geometry or drag make of it at s. */
HD_RT void hd_surface_lower(const struct hd_material *material, double arc_m, double half_length_m,
                            struct hd_surface *surface);

/* One material alone. */
HD_RT static inline void hd_surface_of(const struct hd_material *material, double arc_m, double half_length_m,
                                       struct hd_surface *surface) {
    *surface = (struct hd_surface){
        .stiffness_n_per_m = material->stiffness_n_per_m,
        .damping_n_s_per_m = material->damping_n_s_per_m,
        .friction_coefficient = material->friction_coefficient,
        .friction_stiffness_n_per_m = material->friction_stiffness_n_per_m,
    };
    if (material->texture == HD_TEXTURE_GEOMETRY || material->texture == HD_TEXTURE_DRAG) {
        hd_surface_lower(material, arc_m, half_length_m, surface);
    }
}

/* A wall of several materials. */
HD_RT struct hd_dominant_material hd_surface_of_pieces(const struct hd_table *table, const struct hd_object *object,
                                                       double arc_m, double half_length_m, struct hd_surface *surface);

/* The surface of an object at s. `half_length_m` bounds the grooves (discs: pi R). */
HD_RT static inline struct hd_dominant_material hd_surface_at(const struct hd_table *table,
                                                              const struct hd_object *object, double arc_m,
                                                              double half_length_m, struct hd_surface *surface) {
    if (object->piece_count > 0) {
        return hd_surface_of_pieces(table, object, arc_m, half_length_m, surface);
    }
    const struct hd_material *material = &table->materials[object->material];
    hd_surface_of(material, arc_m, half_length_m, surface);
    return (struct hd_dominant_material){material, 1.0};
}
/* The index, among the wall's pieces, of the one that holds s; the object has pieces. */
HD_RT uint32_t hd_surface_piece(const struct hd_table *table, const struct hd_object *object, double arc_m);

#endif
