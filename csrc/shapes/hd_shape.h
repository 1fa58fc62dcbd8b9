/* Shapes: pure geometry. Where the probe's path meets one, where the probe is on it, when it has left it.
 *
 * To add a shape, change these files. C, in csrc/:
 *
 *   api/hd_api.h          enum hd_shape; what point_m, normal and half_m of struct hd_object mean for it
 *   shapes/, a new file    fills a struct hd_shape_operations, as hd_wall.c does
 *   shapes/hd_shape.h     its operations declared extern; HD_SHAPES
 *   shapes/hd_shape.c     its row of the table
 *   scene/hd_index.c      bounded_reach_m, is_round and visit: its bounds, and its distance. Compilers warn of a shape
 *                         that is missing in a switch there, and the check of a table refuses it
 *
 * Python, in hapticd/; mypy names each place that ends in assert_never:
 *
 *   __init__.py                        the model's public name, in three places
 *   config/scene.py                    the model, Surface and SURFACES
 *   config/document_kinds.py           OBJECT_KINDS
 *   config/operator.py                 the texts that list the shapes which a gesture can touch
 *   rendering/compiler/table.py        its number beside _WALL, and _place_of (assert_never)
 *   rendering/joystick.py              target_of (assert_never): where a gesture touches it
 *   rendering/contact_sets.py          _regions: where it can be touched; _contributions, if it pushes along one normal
 *   rendering/stability_remedy.py      `deepens`, if a softer one is touched deeper; round_rubs, if it is round
 *   rendering/surface_properties.py    _put_discs, if it is round
 *   client/watch.py                    draw_scene: how `hapticd watch` draws it
 *   analysis/check.py                  a limit of its own, as _gone_through of a disc
 *   sweeps/measures/onset.py           _height_of: from where the handle is let fall on it
 *   experiment/trial_scenes.py         the text that lists the shapes
 *
 * The page, in hapticd/web/static/, where nothing warns of one that is missing:
 *
 *   scene_view/geometry.js                     its case in each switch
 *   scene_view/surface_point.js, contacts.js   contact point and feature
 *   scene_view/shapes.js, picture.js           how it is drawn and named
 *   scene_view/arrange.js, grips.js            what it is called, how it is moved
 *   editor/placement.js, words.js, try_it.js   how it is made and tried
 *
 * Documents: docs/materials.md, protocol.md, stability.md and glossary.md list the shapes, and `make docs-tables`
 * writes their tables of keys. Tests: tests/c/test_index.c has its distance from the definition. */
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
    double fraction;               /* of the path from the last sample to this one */
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
     * cleared; a probe inside is met silently then, and nothing is crossed. Where it does, all of the onset is set, but
     * for the fraction of a silent one. */
    HD_RT int (*meets)(struct hd_proxy *proxy, const struct hd_object *object, int fresh, struct hd_onset *onset);
    /* Where `position_m` is on the feature that is in contact. `bearing` is the normal at `from_m`, where the probe was
     * then; NULL: the object is met, or was moved itself. Neither is read where the feature says it all. */
    HD_RT void (*contact_point)(const struct hd_object *object, struct hd_feature feature, const double bearing[2],
                                const double from_m[2], const double position_m[2], struct hd_contact_point *point);
    /* Whether a probe at `position_m`, whose contact point is `point`, has left the shape. `slot`: the object's own, so
     * that it does not count among the surfaces that are pressed. NULL: once it is not below the surface. */
    HD_RT int (*has_left)(const struct hd_proxy *proxy, const struct hd_object *object, uint32_t slot,
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

/* Whether a contact is over: see the operation `has_left`. */
HD_RT static inline int hd_shape_is_left(const struct hd_proxy *proxy, const struct hd_object *object, uint32_t slot,
                                         struct hd_feature feature, const double position_m[2],
                                         const struct hd_contact_point *point) {
    const struct hd_shape_operations *shape = hd_shape_of(object);
    return shape->has_left ? shape->has_left(proxy, object, slot, feature, position_m, point) : !(point->depth_m > 0.0);
}

#endif
