/* Grooves: groove k lies at s = k spacing.
 *
 * Each passage of a probe in contact strikes the groove mode once, along the motion, at the time interpolated on the
 * straight line between two samples, with A = velocity_gain |v_t| + force_gain F_n (Okamura, Dennerlein and Howe 1998,
 * eq. 2). A does not vanish at low speed and acts along the motion, so a lightly held handle on a groove would be moved
 * by the strikes. Therefore a groove is struck again only after the probe was half a spacing away from it, or struck
 * another groove. (Of a path through the air only the end counts.) A point exactly on a groove counts as beyond it. A
 * groove exactly on the boundary of two materials belongs to the one at larger s. On a disc grooves lie up to the
 * bottom, where s starts again: there the first and the last groove can coincide, and a groove that the bottom cuts is
 * struck but has no shape. */
#ifndef HD_GROOVE_H
#define HD_GROOVE_H

#include "tick/hd_context.h"

/* The motion of the probe along a surface since the last tick, or since the onset. */
struct hd_travel {
    struct hd_contact_point point; /* at the end of the motion */
    double tangent[2];
    double half_length_m; /* of a round surface: from top to bottom; of others: unbounded */
    double jump_m;        /* jump of s at the bottom of a round surface, to add to point.arc_m */
    double fraction;      /* of the path since the last sample at which the contact began; 0: earlier */
    double part;          /* part of the remaining path in which the contact lasted */
};

/* Strikes the grooves that are passed, and updates which groove can be struck again. The path is one stretch, or two on
 * a disc if it crosses the bottom. The normal force is interpolated from its last value to that of stiffness and
 * damping at the end. */
HD_RT void hd_grooves_pass(struct hd_context *context, uint32_t index, const struct hd_object *object,
                           const struct hd_travel *travel);
/* Allows the groove that was struck last to be struck again if the probe at `arc_m` is far enough from it. */
HD_RT void hd_grooves_arm(struct hd_slot *slot, double arc_m, double half_length_m);

#endif
