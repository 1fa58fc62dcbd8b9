/* Checks of a table's scalars, pieces and objects. */
#include "scene/hd_check.h"

#include <stdio.h>

#include "scene/hd_index.h"
#include "shapes/hd_shape.h"

/* Slot numbers have 32 bits, and the highest ones have special meanings (HD_NO_SLOT). */
#define HD_MOST_OBJECTS 0x7fffffffu
/* Relative tolerance for ramps that meet: both ends are sums of separately rounded numbers. */
#define HD_MEET_TOLERANCE 1e-12

int hd_scalars_check(const struct hd_table *table) {
    if (!hd_check_between(table->period_s, 1e-6, 1.0)) {
        return hd_invalid("table: period %g s must be between 1e-6 and 1", table->period_s);
    }
    if (!hd_check_between(table->max_force_n, 1e-6, 1e6) || !hd_check_between(table->max_speed_m_per_s, 1e-6, 1e6) ||
        !hd_check_between(table->ramp_s, 1e-6, 1e3)) {
        return hd_invalid("table: force limit %g N, speed limit %g m/s or ramp %g s is out of range",
                          table->max_force_n, table->max_speed_m_per_s, table->ramp_s);
    }
    if (!hd_check_between(table->rearm_m, 0.0, 1.0)) {
        return hd_invalid("table: rearm distance %g m must be between 0 and 1", table->rearm_m);
    }
    if (!hd_check_between(table->ramp_step * table->ramp_s, table->period_s * (1.0 - 1e-12),
                          table->period_s * (1.0 + 1e-12))) {
        return hd_invalid("table: ramp step %g must be the period divided by the ramp", table->ramp_step);
    }
    if (table->ramp_step > 1.0) {
        return hd_invalid("table: a ramp of %g s is shorter than a period", table->ramp_s);
    }
    if (table->display_force > 1 || table->display_vibration > 1) {
        return hd_invalid("table: display flags must be 0 or 1");
    }
    if (table->passivity > HD_PASSIVITY_CONTROL || table->report_age > HD_PASSIVITY_AGE_MAX) {
        return hd_invalid("table: passivity %u must be at most %u, the age of reports, %u periods, at most %u",
                          table->passivity, HD_PASSIVITY_CONTROL, table->report_age, HD_PASSIVITY_AGE_MAX);
    }
    if (!hd_check_between(table->brake_n_s_per_m, 0.0, HD_LARGEST) ||
        !hd_check_between(table->handle_damping_n_s_per_m, 0.0, HD_LARGEST) ||
        !hd_check_between(table->handle_friction_n, 0.0, HD_LARGEST)) {
        return hd_invalid("table: brake %g N s/m, handle's damping %g N s/m or friction %g N is out of range",
                          table->brake_n_s_per_m, table->handle_damping_n_s_per_m, table->handle_friction_n);
    }
    const struct hd_field *field = &table->field;
    if (!hd_check_bounded(field->force_n[0]) || !hd_check_bounded(field->force_n[1]) ||
        !hd_check_bounded(field->stiffness_n_per_m) || !hd_check_bounded(field->damping_n_s_per_m)) {
        return hd_invalid("table: a value of the field is out of range");
    }
    if (table->object_count > HD_MOST_OBJECTS) {
        return hd_invalid("table: %u objects; there must be at most %u", table->object_count, HD_MOST_OBJECTS);
    }
    if ((table->object_count > 0 && table->objects == NULL) ||
        (table->material_count > 0 && table->materials == NULL) || (table->piece_count > 0 && table->pieces == NULL) ||
        (table->noise_count > 0 && table->noises == NULL) || (table->number_count > 0 && table->numbers == NULL)) {
        return hd_invalid("table: an array is NULL, but its count is not 0");
    }
    return HD_OK;
}

int hd_parts_check(const struct hd_table *table) {
    for (uint32_t i = 0; i < table->material_count; i++) {
        if (hd_material_check(&table->materials[i], table, i) < 0) {
            return HD_ERR_INVALID;
        }
    }
    for (uint32_t i = 0; i < table->noise_count; i++) {
        char what[24];
        snprintf(what, sizeof what, "noise %u", i);
        if (hd_noise_check(&table->noises[i], table->numbers, table->number_count, what) < 0) {
            return HD_ERR_INVALID;
        }
    }
    return HD_OK;
}

static int pieces_check(const struct hd_piece *pieces, uint32_t count, uint32_t material_count, uint32_t slot) {
    for (uint32_t i = 0; i < count; i++) {
        const struct hd_piece *piece = &pieces[i];
        if (piece->material >= material_count) {
            return hd_invalid("object %u, piece %u: material %u does not exist; there are %u", slot, i, piece->material,
                              material_count);
        }
        if (i == 0) {
            continue;
        }
        if (!hd_check_bounded(piece->from_m) || !hd_check_between(piece->half_ramp_m, HD_SMALLEST, HD_LARGEST)) {
            return hd_invalid(
                "object %u, piece %u: start %g m or half ramp %g m is out of range; a half ramp is at least %g m", slot,
                i, piece->from_m, piece->half_ramp_m, HD_SMALLEST);
        }
        if (i == 1) {
            continue;
        }
        const double gap = (piece->from_m - piece->half_ramp_m) - (piece[-1].from_m + piece[-1].half_ramp_m);
        const double size = (piece->from_m < 0.0 ? -piece->from_m : piece->from_m) +
                            (piece[-1].from_m < 0.0 ? -piece[-1].from_m : piece[-1].from_m);
        if (!(piece->from_m > piece[-1].from_m) || gap < -HD_MEET_TOLERANCE * size) {
            return hd_invalid("object %u, piece %u: ramp %g m +- %g m must follow the one before, %g m +- %g m", slot,
                              i, piece->from_m, piece->half_ramp_m, piece[-1].from_m, piece[-1].half_ramp_m);
        }
    }
    return HD_OK;
}

int hd_references_check(const struct hd_table *parts, const struct hd_object *object, uint32_t slot) {
    if (object->shape == HD_SHAPE_NONE) {
        return HD_OK;
    }
    if (object->material >= parts->material_count) {
        return hd_invalid("object %u: material %u does not exist; there are %u", slot, object->material,
                          parts->material_count);
    }
    if (object->piece_count == 0) {
        return HD_OK;
    }
    if (object->shape != HD_SHAPE_WALL || object->piece_count < 2) {
        return hd_invalid("object %u: %u pieces; a wall has 0 or at least 2, another shape 0", slot,
                          object->piece_count);
    }
    if (object->piece_first > parts->piece_count || object->piece_count > parts->piece_count - object->piece_first) {
        return hd_invalid("object %u: %u pieces from piece %u on do not exist; there are %u", slot, object->piece_count,
                          object->piece_first, parts->piece_count);
    }
    return pieces_check(parts->pieces + object->piece_first, object->piece_count, parts->material_count, slot);
}

/* A free slot passes: ticks use only its generation. */
int hd_object_check(const struct hd_object *object, const struct hd_table *parts, uint32_t slot) {
    if (object->shape == HD_SHAPE_NONE) {
        return HD_OK;
    }
    if (object->shape >= HD_SHAPES || !hd_index_holds(object->shape)) {
        return hd_invalid("object %u: unknown shape %u", slot, object->shape);
    }
    if (!hd_check_bounded(object->point_m[0]) || !hd_check_bounded(object->point_m[1])) {
        return hd_invalid("object %u: point (%g, %g) is out of range", slot, object->point_m[0], object->point_m[1]);
    }
    const double square = object->normal[0] * object->normal[0] + object->normal[1] * object->normal[1];
    if (!hd_check_between(square, 1.0 - 1e-9, 1.0 + 1e-9)) {
        return hd_invalid("object %u: normal (%g, %g) is not a unit vector", slot, object->normal[0],
                          object->normal[1]);
    }
    if (!hd_shape_of(object)->is_sized(object->half_m, HD_SMALLEST, HD_LARGEST)) {
        return hd_invalid("object %u: half sizes (%g, %g) m are not valid for shape %u; at least %g m", slot,
                          object->half_m[0], object->half_m[1], object->shape, HD_SMALLEST);
    }
    return hd_references_check(parts, object, slot);
}
