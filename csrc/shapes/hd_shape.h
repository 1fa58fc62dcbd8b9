/* Shapes: pure geometry. Where the probe's path meets one, where the probe is on it, when it has left it.
 *
 * To add a shape, write a file beside hd_wall.c that fills a struct hd_shape_operations, and name it in hd_shape.c and
 * in enum hd_shape (csrc/api/hd_api.h). The tick, the checks of a table and the other shapes ask the table of
 * operations. The spatial index alone has arithmetic of its own for each shape (csrc/scene/hd_index.c: extent_m and
 * visit). In Python a shape is a kind of object in hapticd/config/scene.py, a number in hapticd/base/core.py and a
 * record in hapticd/rendering/compiler.py. */
#ifndef HD_SHAPE_H
#define HD_SHAPE_H

#include "api/hd_core.h"
#include "base/hd_rt.h"
#include "base/hd_vector.h"
#include "shapes/hd_proxy.h"

/* A point so near to the end or the surface of a shape is on it: where two shapes meet, neither rounding nor an update
 * opens a crack between them. Far below what an encoder resolves, above rounding anywhere within reach. */
#define HD_RIM_M 1e-12

/* Where the probe is on a surface. */
struct hd_contact_point {
    double depth_m; /* below it */
    double arc_m;   /* the arc length s along it, from where the shape says */
    double normal[2];
};

/* The feature of a shape that is in contact. It is remembered, and depth is counted from it. */
struct hd_feature {
    int8_t side;  /* membrane: of its normal that the probe came from, +1 or -1; others: +1 */
    uint8_t face; /* box: that was entered; others: 0 */
};

/* How a contact begins. */
struct hd_onset {
    int silent;                    /* no onset was seen: no tap, and the force comes in over the ramp */
    int slid;                      /* reached along another surface, already pressed: no tap */
    int stood;                     /* slid, but not by the probe's motion: it already lay between proxy and probe */
    double fraction;               /* of the way from the last sample to this one */
    struct hd_contact_point point; /* where the surface was met; where the probe is, if silent */
    struct hd_feature feature;
};

/* On a surface that is curved, what the motion along it is to that of the probe. */
struct hd_lever {
    double slide;      /* of s, over the probe's along the tangent */
    double fade;       /* what there is of friction's spring and of geometry, 0 to 1, */
    double fade_per_m; /* and by how much more it is farther out */
};

struct hd_shape_operations {
    /* Whether the path of this tick meets the shape, and how. `fresh`: the object has just appeared, or contacts were
     * cleared; a probe inside is met silently then, and nothing is crossed. */
    HD_RT int (*meets)(struct hd_proxy *proxy, const struct hd_object *object, int fresh, struct hd_onset *onset);
    /* Where `position_m` is on the feature that is in contact. `bearing` is the normal at `from_m`, where the probe was
     * then; NULL: the object is met, or was moved itself. Neither is read where the feature says it all. */
    HD_RT void (*contact_point)(const struct hd_object *object, struct hd_feature feature, const double bearing[2],
                                const double from_m[2], const double position_m[2], struct hd_contact_point *point);
    /* Whether a probe at `position_m`, whose contact point is `point`, has left the shape. `slot`: the object's own, so
     * that it does not count among the surfaces that are pressed. */
    HD_RT int (*left)(const struct hd_proxy *proxy, const struct hd_object *object, uint32_t slot,
                      struct hd_feature feature, const double position_m[2], const struct hd_contact_point *point);
    /* Whether a solid holds a point, its rim included. */
    HD_RT int (*holds)(const struct hd_object *object, const double point_m[2]);
    /* How far a point is outside of the shape, at least. */
    HD_RT double (*distance)(const struct hd_object *object, const double point_m[2]);
    /* Half the length of a surface that has two ends; NULL: it has none. */
    HD_RT double (*half_length)(const struct hd_object *object, struct hd_feature feature);
    /* Round shapes alone, others NULL. s of a normal, which contact_point leaves at 0 there; the lever at a depth. */
    HD_RT double (*arc_length)(const struct hd_object *object, const double normal[2]);
    HD_RT void (*lever)(const struct hd_object *object, double depth_m, struct hd_lever *lever);
    /* Whether the members of half_m that the shape has lie between the two, and the others are 0. Control side. */
    int (*is_sized)(const double half_m[2], double least_m, double most_m);
    int membrane; /* it has two sides and no inside: it can rupture, and heal */
};

extern const struct hd_shape_operations hd_wall, hd_membrane, hd_box, hd_disc;

/* By enum hd_shape; NULL for HD_SHAPE_NONE. */
#define HD_SHAPES 5u
extern const struct hd_shape_operations *const hd_shapes[HD_SHAPES];

/* The operations of an object that is there. */
HD_RT static inline const struct hd_shape_operations *hd_shape_of(const struct hd_object *object) {
    return hd_shapes[object->shape];
}

#endif
