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

/* The surface of an object at s. `half_length_m` bounds the grooves (discs: pi R). */
HD_RT struct hd_dominant_material hd_surface_at(const struct hd_table *table, const struct hd_object *object,
                                                double arc_m, double half_length_m, struct hd_surface *surface);
/* Mixes: 0 is `from`, 1 is `surface`, which takes the result. */
HD_RT void hd_surface_blend(const struct hd_surface *from, double blend, struct hd_surface *surface);
/* The index, among the wall's pieces, of the one that holds s; the object has pieces. */
HD_RT uint32_t hd_surface_piece(const struct hd_table *table, const struct hd_object *object, double arc_m);

#endif
