/* Surface properties of an object at one arc length: stiffness, damping, friction and geometry.
 *
 * A wall can have several materials, in pieces along s. At the edge of two pieces every parameter x is blended,
 *     x(s) = x_a + w(s) (x_b - x_a),  w a smooth step from 0 to 1 over the ramp of the edge,
 * and the force is the gradient of the energy U(s, d) = K(s)/2 max(0, d - H(s))^2, where geometry lowers the surface by
 * H(s):
 *     normal part K (d - H), tangential part K (d - H) H' - K'/2 (d - H)^2.
 * So neither a groove nor an edge creates energy. The slopes of w and of the raised cosines of geometry are continuous,
 * so the force has no steps. */
#ifndef HD_SURFACE_H
#define HD_SURFACE_H

#include "base/hd_rt.h"
#include "tick/hd_state.h"

/* Half-length, in m, of a flat surface: its grooves exist at every s. */
#define HD_UNBOUNDED_M 1e300

struct hd_dominant_material {
    const struct hd_material *material; /* the one with the largest weight: its modes and texture are displayed */
    double noise_weight;                /* gain of its noise: 1, less near an edge to a material without noise */
};

/* Adds the effect of grooves that are displayed as geometry or drag at s. */
HD_RT void hd_surface_lower(const struct hd_material *material, double arc_m, double half_length_m,
                            struct hd_surface *surface);

/* Computes the surface properties of one material. */
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

/* Computes the surface properties of a wall with several materials. */
HD_RT struct hd_dominant_material hd_surface_of_pieces(const struct hd_table *table, const struct hd_object *object,
                                                       double arc_m, double half_length_m, struct hd_surface *surface);

/* Computes the surface properties of an object at s. `half_length_m`: |s| up to which grooves exist (discs: pi R). */
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
/* Returns the index, among the pieces of the object, of the piece that contains s. The object must have pieces. */
HD_RT uint32_t hd_surface_piece(const struct hd_table *table, const struct hd_object *object, double arc_m);

#endif
