/* Checking and copying tables.
 *
 * Invariant: no table that passes hd_table_check can make a tick read out of bounds, divide by zero or run for ever,
 * and no two records share a slot's generation by accident of the check: slots are within the state's capacity and used
 * once. What finite numbers can still overflow to in a tick, the tick itself catches. Control side. */
#include "hd_table.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Far beyond anything felt; what keeps products of a few of them finite. */
#define HD_LARGEST 1e9

static int bounded(double value) {
    return value >= -HD_LARGEST && value <= HD_LARGEST; /* false for NaN */
}

static int between(double value, double low, double high) {
    return value >= low && value <= high;
}

int hd_mode_check(const struct hd_mode *mode, const char *what) {
    if (mode->force_per_unit == 0.0 && mode->end_s == 0.0) {
        return HD_OK; /* none */
    }
    if (!between(mode->rotor_re, -1.0, 1.0) || !between(mode->rotor_im, -1.0, 1.0) ||
        mode->rotor_re * mode->rotor_re + mode->rotor_im * mode->rotor_im > 1.0 + 1e-12) {
        return hd_invalid("%s: rotor (%g, %g) is not within the unit circle", what, mode->rotor_re, mode->rotor_im);
    }
    if (!between(mode->decay_rate_per_s, 0.0, HD_LARGEST) ||
        !between(mode->angular_frequency_rad_per_s, 0.0, HD_LARGEST)) {
        return hd_invalid("%s: decay rate %g and angular frequency %g must lie between 0 and %g", what,
                          mode->decay_rate_per_s, mode->angular_frequency_rad_per_s, HD_LARGEST);
    }
    if (!between(mode->end_s, 0.0, HD_LARGEST) || !between(mode->peak_time_s, 0.0, HD_LARGEST) ||
        !between(mode->peak, 0.0, 1.0)) {
        return hd_invalid("%s: end %g s, peak %g at %g s are out of range", what, mode->end_s, mode->peak,
                          mode->peak_time_s);
    }
    if (!between(mode->force_per_unit, 0.0, HD_LARGEST) || !between(mode->amplitude_per_unit, 0.0, HD_LARGEST)) {
        return hd_invalid("%s: force per unit %g and amplitude per unit %g must lie between 0 and %g", what,
                          mode->force_per_unit, mode->amplitude_per_unit, HD_LARGEST);
    }
    return HD_OK;
}

static int surface_check(const struct hd_surface *surface, const char *kind, uint32_t index) {
    if (!bounded(surface->point_m[0]) || !bounded(surface->point_m[1])) {
        return hd_invalid("%s %u: point (%g, %g) is out of range", kind, index, surface->point_m[0],
                          surface->point_m[1]);
    }
    const double square = surface->normal[0] * surface->normal[0] + surface->normal[1] * surface->normal[1];
    if (!between(square, 1.0 - 1e-9, 1.0 + 1e-9)) {
        return hd_invalid("%s %u: normal (%g, %g) is not a unit vector", kind, index, surface->normal[0],
                          surface->normal[1]);
    }
    if (!between(surface->stiffness_n_per_m, 0.0, HD_LARGEST) ||
        !between(surface->damping_n_s_per_m, 0.0, HD_LARGEST)) {
        return hd_invalid("%s %u: stiffness %g and damping %g must lie between 0 and %g", kind, index,
                          surface->stiffness_n_per_m, surface->damping_n_s_per_m, HD_LARGEST);
    }
    if (!between(surface->half_width_m, 0.0, HD_LARGEST) || !between(surface->rupture_depth_m, 0.0, HD_LARGEST)) {
        return hd_invalid("%s %u: half width %g and rupture depth %g must lie between 0 and %g", kind, index,
                          surface->half_width_m, surface->rupture_depth_m, HD_LARGEST);
    }
    return HD_OK;
}

/* Marks a slot as used; `used` has one bit a slot. */
static int slot_check(const struct hd_key *key, uint32_t capacity, uint8_t *used, const char *kind, uint32_t index) {
    if (key->slot >= capacity) {
        return hd_invalid("%s %u: slot %u of %u", kind, index, key->slot, capacity);
    }
    const uint8_t bit = (uint8_t)(1u << (key->slot % 8u));
    if (used[key->slot / 8u] & bit) {
        return hd_invalid("%s %u: slot %u is used twice", kind, index, key->slot);
    }
    used[key->slot / 8u] |= bit;
    return HD_OK;
}

static int objects_check(const struct hd_table *table, uint32_t capacity, uint8_t *used) {
    for (uint32_t i = 0; i < table->wall_count; i++) {
        const struct hd_wall *wall = &table->walls[i];
        if (slot_check(&wall->key, capacity, used, "wall", i) < 0 || surface_check(&wall->surface, "wall", i) < 0 ||
            hd_mode_check(&wall->tap, "tap of a wall") < 0) {
            return HD_ERR_INVALID;
        }
    }
    for (uint32_t i = 0; i < table->membrane_count; i++) {
        const struct hd_membrane *membrane = &table->membranes[i];
        if (slot_check(&membrane->key, capacity, used, "membrane", i) < 0 ||
            surface_check(&membrane->surface, "membrane", i) < 0 ||
            hd_mode_check(&membrane->tap, "tap of a membrane") < 0 ||
            hd_mode_check(&membrane->rupture, "rupture of a membrane") < 0) {
            return HD_ERR_INVALID;
        }
    }
    return HD_OK;
}

int hd_table_check(const struct hd_table *table, uint32_t slot_capacity) {
    if (!between(table->period_s, 1e-6, 1.0)) {
        return hd_invalid("table: period %g s is not between 1e-6 and 1", table->period_s);
    }
    if (!between(table->max_force_n, 1e-6, 1e6) || !between(table->max_speed_m_per_s, 1e-6, 1e6) ||
        !between(table->ramp_s, 1e-6, 1e3)) {
        return hd_invalid("table: force limit %g N, speed limit %g m/s or ramp %g s is out of range",
                          table->max_force_n, table->max_speed_m_per_s, table->ramp_s);
    }
    if (!between(table->ramp_step * table->ramp_s, table->period_s * (1.0 - 1e-12), table->period_s * (1.0 + 1e-12))) {
        return hd_invalid("table: ramp step %g is not period over ramp", table->ramp_step);
    }
    if (table->ramp_step > 1.0) {
        return hd_invalid("table: a ramp of %g s is shorter than a period", table->ramp_s);
    }
    if (table->display_force > 1 || table->display_vibration > 1) {
        return hd_invalid("table: display flags are 0 or 1");
    }
    const struct hd_field *field = &table->field;
    if (!bounded(field->force_n[0]) || !bounded(field->force_n[1]) || !bounded(field->stiffness_n_per_m) ||
        !bounded(field->damping_n_s_per_m)) {
        return hd_invalid("table: the field is out of range");
    }
    const uint64_t count = (uint64_t)table->wall_count + table->membrane_count;
    if (count > slot_capacity) {
        return hd_invalid("table: %llu objects, room for %u", (unsigned long long)count, slot_capacity);
    }
    if ((table->wall_count > 0 && table->walls == NULL) || (table->membrane_count > 0 && table->membranes == NULL)) {
        return hd_invalid("table: objects without records");
    }
    uint8_t *used = calloc((size_t)slot_capacity / 8u + 1u, 1);
    if (used == NULL) {
        return HD_ERR_MEMORY;
    }
    const int status = objects_check(table, slot_capacity, used);
    free(used);
    return status;
}

static int grow(void **records, uint32_t *capacity, uint32_t count, size_t size) {
    if (count <= *capacity) {
        return HD_OK;
    }
    void *larger = realloc(*records, (size_t)count * 2u * size);
    if (larger == NULL) {
        return HD_ERR_MEMORY;
    }
    *records = larger;
    *capacity = count * 2u;
    return HD_OK;
}

int hd_table_copy(struct hd_table_buffer *buffer, const struct hd_table *source) {
    void *walls = buffer->table.walls;
    void *membranes = buffer->table.membranes;
    int status = grow(&walls, &buffer->wall_capacity, source->wall_count, sizeof *source->walls);
    buffer->table.walls = walls;
    if (status == HD_OK) {
        status = grow(&membranes, &buffer->membrane_capacity, source->membrane_count, sizeof *source->membranes);
        buffer->table.membranes = membranes;
    }
    if (status != HD_OK) {
        return status;
    }
    buffer->table = *source;
    buffer->table.walls = walls;
    buffer->table.membranes = membranes;
    if (source->wall_count > 0) {
        memcpy(walls, source->walls, source->wall_count * sizeof *source->walls);
    }
    if (source->membrane_count > 0) {
        memcpy(membranes, source->membranes, source->membrane_count * sizeof *source->membranes);
    }
    return HD_OK;
}

void hd_table_release(struct hd_table_buffer *buffer) {
    free(buffer->table.walls);
    free(buffer->table.membranes);
    *buffer = (struct hd_table_buffer){.wall_capacity = 0};
}
