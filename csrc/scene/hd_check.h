/* Whether what a table holds can make no tick read out of bounds, divide by zero or run for ever. Control side.
 *
 * Each returns HD_OK or HD_ERR_INVALID with its reason (hd_invalid_reason). */
#ifndef HD_CHECK_H
#define HD_CHECK_H

#include "api/hd_core.h"

/* Far beyond anything felt; what keeps products and quotients of a few of them finite. */
#define HD_LARGEST 1e9
/* Metres, metres a second and others that are divided by. */
#define HD_SMALLEST 1e-9

/* One mode, as a table's or a command's. */
int hd_mode_check(const struct hd_mode *mode, const char *what);
/* What is played by hand: a mode, a unit vector, an amplitude in units of the mode. */
int hd_play_check(const struct hd_mode *mode, const double direction[2], double amplitude);
/* One noise against the numbers it refers to. */
int hd_noise_check(const struct hd_noise *noise, const double *numbers, uint32_t number_count, const char *what);
int hd_material_check(const struct hd_material *material, const struct hd_table *table, uint32_t index);
/* What there is one of. */
int hd_scalars_check(const struct hd_table *table);
/* Materials, noises and numbers; pieces are checked with the walls that refer to them. */
int hd_parts_check(const struct hd_table *table);
/* `parts`: the table whose materials and pieces it will be rendered with. */
int hd_object_check(const struct hd_object *object, const struct hd_table *parts, uint32_t slot);
/* Of that only what it refers to. */
int hd_references_check(const struct hd_table *parts, const struct hd_object *object, uint32_t slot);

static inline int hd_check_between(double value, double low, double high) {
    return value >= low && value <= high; /* false for NaN */
}

static inline int hd_check_bounded(double value) {
    return hd_check_between(value, -HD_LARGEST, HD_LARGEST);
}

#endif
