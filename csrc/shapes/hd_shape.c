/* The table of shapes: from enum hd_shape to the operations of that shape. */
#include "shapes/hd_shape.h"

const struct hd_shape_operations *const hd_shapes[HD_SHAPES] = {
    [HD_SHAPE_WALL] = &hd_wall,
    [HD_SHAPE_MEMBRANE] = &hd_membrane,
    [HD_SHAPE_BOX] = &hd_box,
    [HD_SHAPE_DISC] = &hd_disc,
};
