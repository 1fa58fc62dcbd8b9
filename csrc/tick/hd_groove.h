/* Grooves: groove k lies at s = k spacing.
 *
 * Each passage of a probe in contact is one strike of the groove mode along the motion, at the time that follows from
 * the straight line between two samples, with A = velocity_gain |v_t| + force_gain F_n (Okamura, Dennerlein and Howe
 * 1998, eq. 2). A does not vanish with the speed and acts along the motion, so that a light hand on a groove would be
 * driven by its own strikes: a groove strikes again only after the probe was half a spacing away from it, or struck
 * another. (Of the way through the air only its end counts.) A point exactly on a groove counts as beyond it; a groove
 * exactly where two materials meet is one of the latter's. On a disc grooves lie up to its bottom, where s starts
 * again, and there the first and the last may be one; one that the bottom cuts is struck, but has no shape. */
#ifndef HD_GROOVE_H
#define HD_GROOVE_H

#include "tick/hd_broad_phase.h"

/* Strikes on one stretch of a tick's way along one object; what is beyond is a texture that nobody feels as grooves any
 * more. */
#define HD_GROOVES_PER_TICK 1024
/* So near to the bottom of a disc, in half its circumference, a groove lies on it: rounding does not lose it. */
#define HD_GROOVE_SEAM 1e-12

/* The raised cosine over the nearest groove, 0 to 1, and its slope over s. */
HD_RT double hd_groove_profile(const struct hd_material *material, double arc_m, double half_length_m, double *slope);

/* One straight stretch of a tick's way along a surface. */
struct hd_stretch {
    double from_m; /* s */
    double to_m;
    double from_fraction; /* of the tick's way */
    double to_fraction;
    double from_n; /* the model's normal force; below 0 there is none */
    double to_n;
    double half_length_m;
    double tangent[2];
    double speed_m_per_s; /* along the tangent */
    double true_speed_m_per_s;
};

/* Strikes what the stretch passes, and arms. */
HD_RT void hd_grooves_pass(struct hd_context *context, uint32_t index, const struct hd_object *object,
                           const struct hd_stretch *stretch);
/* The probe is at s: whether the groove that was struck last may strike again. */
HD_RT void hd_grooves_arm(struct hd_slot *slot, double arc_m, double half_length_m);

#endif
