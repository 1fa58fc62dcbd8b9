/* Checks of a table: with a table that passes, no tick reads out of bounds, divides by zero or loops endlessly. Control
 * side.
 *
 * Each check returns HD_OK, or HD_ERR_INVALID with a reason (hd_invalid_reason). */
#ifndef HD_CHECK_H
#define HD_CHECK_H

#include "api/hd_core.h"

/* Upper limit of values: far beyond anything that can be felt, and low enough that products of several stay finite. */
#define HD_LARGEST 1e9
/* Lower limit of values that are divisors, such as lengths and speeds. */
#define HD_SMALLEST 1e-9

/* Checks a mode of a table or a command; `what` names it in the reason. */
int hd_mode_check(const struct hd_mode *mode, const char *what);
/* Checks the arguments of `play`: a mode, a unit vector, an amplitude in units of the mode. */
int hd_play_check(const struct hd_mode *mode, const double direction[2], double amplitude);
/* Checks a noise and the numbers that it refers to; `what` names it in the reason. */
int hd_noise_check(const struct hd_noise *noise, const double *numbers, uint32_t number_count, const char *what);
int hd_material_check(const struct hd_material *material, const struct hd_table *table, uint32_t index);
/* Checks the scalars and the field of a table, and that its arrays exist. */
int hd_scalars_check(const struct hd_table *table);
/* Checks materials, noises and numbers. Pieces are checked with the walls that refer to them. */
int hd_parts_check(const struct hd_table *table);
/* Checks an object. `parts`: the table with the materials and pieces that it will be rendered with. */
int hd_object_check(const struct hd_object *object, const struct hd_table *parts, uint32_t slot);
/* Checks only the material and the pieces that an object refers to. */
int hd_references_check(const struct hd_table *parts, const struct hd_object *object, uint32_t slot);

static inline int hd_check_between(double value, double low, double high) {
    return value >= low && value <= high; /* false for NaN */
}

static inline int hd_check_bounded(double value) {
    return hd_check_between(value, -HD_LARGEST, HD_LARGEST);
}

#endif
