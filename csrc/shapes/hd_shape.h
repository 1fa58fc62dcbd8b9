/* Shapes: pure geometry. Whether the path of the probe meets a shape, the contact point, and whether the probe has
 * left.
 *
 * To add a shape, change these files. C, in csrc/:
 *
 *   api/hd_api.h          enum hd_shape; what point_m, normal and half_m of struct hd_object mean for it
 *   shapes/, a new file   defines a struct hd_shape_operations, as hd_wall.c does
 *   shapes/hd_shape.h     its operations declared extern; HD_SHAPES
 *   shapes/hd_shape.c     its row of the table
 *   scene/hd_index.c      bounded_reach_m, is_round and visit: its bounds and its distance. Compilers warn if a switch
 *                         there lacks a shape, and the check of a table refuses that shape
 *
 * Python, in hapticd/; mypy names each place that ends in assert_never:
 *
 *   __init__.py                        the model's public name, in three places
 *   config/scene.py                    the model, Surface and SURFACE_MODELS
 *   config/document_kinds.py           OBJECT_KINDS
 *   config/operator.py                 the texts that list the shapes which a gesture can touch
 *   rendering/compiler/table.py        its number next to _WALL, and _place_of (assert_never)
 *   rendering/joystick.py              target_of (assert_never): where a gesture touches it
 *   rendering/contact_sets.py          _regions: where it can be touched; _contributions, if it has one normal only
 *   rendering/stability_remedy.py      `deepens`, if a softer one is pressed deeper; round_rubs, if it is round
 *   rendering/surface_properties.py    _put_discs, if it is round
 *   client/watch.py                    draw_scene: how `hapticd watch` draws it
 *   analysis/check.py                  a separate limit, if it has one, as _weak_discs for a disc
 *   sweeps/measures/onset.py           _height_of: height from which the handle is dropped on it
 *   experiment/trial_scenes.py         the text that lists the shapes
 *
 * The page, in hapticd/web/static/, where no check finds a missing shape:
 *
 *   scene_view/geometry.js                     its case in each switch
 *   scene_view/surface_point.js, contacts.js   contact point and feature
 *   scene_view/shapes.js, picture.js           how it is drawn and named
 *   scene_view/arrange.js, grips.js            its name, and how it is moved
 *   editor/placement.js, words.js, try_it.js   how it is created and tried out
 *
 * Documents: docs/materials.md, protocol.md, reference/gestures.md, stability.md and glossary.md list the shapes, and
 * `make docs-tables` writes their tables of keys. Tests: tests/c/test_index.c has its distance from the definition. */
#ifndef HD_SHAPE_H
#define HD_SHAPE_H

#include "api/hd_core.h"
#include "base/hd_rt.h"
#include "base/hd_vector.h"
#include "shapes/hd_proxy.h"

/* The position of the probe relative to a surface. */
struct hd_contact_point {
    double depth_m; /* below the surface */
    double arc_m;   /* arc length s along the surface; each shape defines its origin */
    double normal[2];
};

/* The feature of a shape that is in contact. It stays the same during a contact; depth is measured from it. */
struct hd_feature {
    int8_t side;  /* membrane: the side of the normal from which the probe came, +1 or -1; others: +1 */
    uint8_t face; /* box: the face through which the probe entered; others: 0 */
};

/* How a contact begins. */
struct hd_onset {
    int silent;                    /* the probe was already inside: no tap, and the force ramps up */
    int slid;                      /* reached along another, pressed surface: no tap */
    int stood;                     /* slid without motion of the probe: the shape already lay between proxy and probe */
    double fraction;               /* of the path from the last sample to this one, at which the surface was met */
    double below_m;                /* depth of the probe when the surface was met; 0 if its own path met the surface */
    struct hd_contact_point point; /* where the surface was met; if silent, at the probe */
    struct hd_feature feature;
};

/* On a curved surface: ratio of the motion along the surface to that of the probe, and gain of geometry. */
struct hd_lever {
    double slide;      /* change of s over motion of the probe along the tangent */
    double fade;       /* gain of geometry, 0 to 1; 0: the normal may lag behind the probe */
    double fade_per_m; /* derivative of `fade` by the distance from the centre */
};

struct hd_shape_operations {
    /* Whether the path of this tick meets the shape; fills in the onset, except the fraction of a silent one. `fresh`:
     * the object has just appeared, or contacts were cleared; then a probe inside gives a silent onset, and the path is
     * not tested. */
    HD_RT int (*meets)(struct hd_proxy *proxy, const struct hd_object *object, int fresh, struct hd_onset *onset);
    /* Finds the contact point of `position_m` on the feature in contact. `bearing`: normal at the earlier position
     * `from_m` of the probe; `from_m` is NULL if the contact begins or the object was moved. Both are used by round
     * shapes only. */
    HD_RT void (*contact_point)(const struct hd_object *object, struct hd_feature feature, const double bearing[2],
                                const double from_m[2], const double position_m[2], struct hd_contact_point *point);
    /* Whether a probe at `position_m`, whose contact point is `point`, has left the shape. `slot`: slot of the object,
     * which does not count among the pressed surfaces. NULL: it has left if it is not below the surface. */
    HD_RT int (*has_left)(const struct hd_proxy *proxy, const struct hd_object *object, uint32_t slot,
                          struct hd_feature feature, const double position_m[2], const struct hd_contact_point *point);
    /* Whether a solid contains a point, including its rim (boxes: HD_FLUSH_M, others: HD_RIM_M). */
    HD_RT int (*holds)(const struct hd_object *object, const double point_m[2]);
    /* Returns a lower bound of the distance of a point outside to the shape, m. */
    HD_RT double (*distance)(const struct hd_object *object, const double point_m[2]);
    /* Returns half the length of a surface with two ends, m; NULL: the surface has no ends. */
    HD_RT double (*half_length)(const struct hd_object *object, struct hd_feature feature);
    /* Round shapes only, others NULL: s at a normal, since contact_point sets it to 0; and the lever at a depth. */
    HD_RT double (*arc_length)(const struct hd_object *object, const double normal[2]);
    HD_RT void (*lever)(const struct hd_object *object, double depth_m, struct hd_lever *lever);
    /* Whether the members of half_m that the shape uses lie between the two limits, and the others are 0. Control side.
     */
    int (*is_sized)(const double half_m[2], double least_m, double most_m);
    int membrane; /* 1: the shape has two sides and no inside; it can rupture and heal */
};

extern const struct hd_shape_operations hd_wall, hd_membrane, hd_box, hd_disc;

/* By enum hd_shape; NULL for HD_SHAPE_NONE. */
#define HD_SHAPES 5u
extern const struct hd_shape_operations *const hd_shapes[HD_SHAPES];

/* Returns the depth of a probe that is below a surface, m; 0 above it and within HD_RIM_M of it. */
HD_RT static inline double hd_shape_below(double depth_m) {
    return depth_m > HD_RIM_M ? depth_m : 0.0;
}

/* Returns the operations of an object whose shape is not HD_SHAPE_NONE. */
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
