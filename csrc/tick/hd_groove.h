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

#include "tick/hd_context.h"

/* How the probe went along a surface since the last tick, or since the onset. */
struct hd_travel {
    struct hd_contact_point point; /* where it is */
    double tangent[2];
    double half_length_m; /* of a round surface, from the top to the bottom; of others unbounded */
    double jump_m;        /* of s, over the bottom, where it starts again */
    double fraction;      /* of the path since the last sample, at which the contact began; 0: before */
    double part;          /* of the rest, in which it lasted */
};

/* Strikes the grooves that are passed, and arms. The path is one stretch, or on a disc, over its bottom where s jumps,
 * two. The normal force goes in a straight line from what it was to what stiffness and damping give at the end. */
HD_RT void hd_grooves_pass(struct hd_context *context, uint32_t index, const struct hd_object *object,
                           const struct hd_travel *travel);
/* The probe is at s: whether the groove that was struck last may strike again. */
HD_RT void hd_grooves_arm(struct hd_slot *slot, double arc_m, double half_length_m);

#endif
