/* The skin: what the materials of a surface give at one place of it.
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

struct hd_under {
    const struct hd_material *material; /* that weighs most: whose modes and texture are displayed */
    double noise;                       /* weight of its noise, 1 but near an edge to a material without */
};

/* The skin of an object at s. `half_length_m` bounds the grooves (discs: pi R). */
HD_RT struct hd_under hd_skin_at(const struct hd_table *table, const struct hd_object *object, double along_m,
                                 double half_length_m, struct hd_skin *skin);
/* from, on its way to `skin`: the result is in `skin`. */
HD_RT void hd_skin_blend(const struct hd_skin *from, double blend, struct hd_skin *skin);
/* The index, among the wall's pieces, of the one that holds s; the object has pieces. */
HD_RT uint32_t hd_skin_piece(const struct hd_table *table, const struct hd_object *object, double along_m);

#endif
