/* The shapes: where a way meets them, where the probe is on them, when it has left them. One file each. */
#ifndef HD_SHAPE_H
#define HD_SHAPE_H

#include "base/hd_vector.h"
#include "tick/hd_broad_phase.h"

/* How a contact begins. */
struct hd_onset {
    int silent;                    /* no onset was seen: no tap, and the force comes in over the ramp */
    int slid;                      /* reached along another surface, already pressed: no tap */
    int stood;                     /* slid, and yet not by the probe's way: it lay between proxy and probe already */
    double fraction;               /* of the way from the last sample to this one */
    struct hd_contact_point point; /* where the surface was met; where the probe is, if silent */
    int8_t side;                   /* membrane; 1 for others */
    uint8_t face;                  /* box */
};

/* So near to the end or the surface of a shape a point is on it: where two shapes meet, neither rounding nor an update
 * opens a crack between them. Far below what an encoder resolves, above rounding anywhere within reach. */
#define HD_RIM_M 1e-12

/* Whether the probe meets the shape in this tick. `fresh`: the object has just appeared, or contacts were cleared; a
 * probe inside is met silently then, and nothing is crossed. */
HD_RT int hd_wall_meets(struct hd_context *context, const struct hd_object *object, int fresh, struct hd_onset *onset);
HD_RT int hd_membrane_meets(struct hd_context *context, const struct hd_object *object, int fresh,
                            struct hd_onset *onset);
HD_RT int hd_box_meets(struct hd_context *context, const struct hd_object *object, int fresh, struct hd_onset *onset);
HD_RT int hd_disc_meets(struct hd_context *context, const struct hd_object *object, int fresh, struct hd_onset *onset);

/* Where the probe is on a shape that it touches on the side, face or bearing that the slot remembers. */
HD_RT void hd_wall_place(const struct hd_object *object, const double position_m[2], struct hd_contact_point *point);
HD_RT void hd_membrane_place(const struct hd_object *object, int8_t side, const double position_m[2],
                             struct hd_contact_point *point);
HD_RT void hd_box_place(const struct hd_object *object, uint8_t face, const double position_m[2],
                        struct hd_contact_point *point);
/* `bearing` is the normal at the last tick, `travel_m` the way since then; `along`: whether arc_m is asked for.
 * HD_DISC_MOVED: the disc is met, or was moved itself. The bearing follows at once, but not round the centre. */
#define HD_DISC_MOVED 1e300
HD_RT void hd_disc_place(const struct hd_object *object, const double bearing[2], double travel_m, int along,
                         const double position_m[2], struct hd_contact_point *point);

/* What the way along a surface is to the way of the probe. */
struct hd_lever {
    double slide;      /* of s, over the probe's way along the tangent */
    double fade;       /* what there is of friction's spring and of geometry, 0 to 1, */
    double fade_per_m; /* and by how much more it is farther out */
};
/* That of a disc, for a probe that is `depth_m` below its surface. */
HD_RT void hd_disc_lever(double radius_m, double depth_m, struct hd_lever *lever);

/* Whether a probe at `position_m`, which is `place`, has left the shape. */
HD_RT int hd_membrane_left(const struct hd_context *context, const struct hd_object *object, uint32_t slot,
                           const double position_m[2], const struct hd_contact_point *point);
HD_RT int hd_box_left(const struct hd_context *context, const struct hd_object *object, uint32_t slot, uint8_t face,
                      const double position_m[2], const struct hd_contact_point *point);
HD_RT int hd_disc_left(const struct hd_context *context, const struct hd_object *object, uint32_t slot,
                       const double position_m[2], const struct hd_contact_point *point);

#endif
