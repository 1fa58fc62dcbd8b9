/* Checking a table, copying it, keeping its index.
 *
 * Everything is checked, then everything grows, and only then is anything written, so that what is refused or finds no
 * memory leaves the world as it was. Records that are not looked at again were checked when they were taken, and are
 * the world's own copies: nobody else can have changed them. Control side. */
#include "scene/hd_world.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tick/hd_tune.h"
#include "tick/hd_waveform.h"

/* Far beyond anything felt; what keeps products and quotients of a few of them finite. */
#define HD_LARGEST 1e9
#define HD_SMALLEST_M 1e-9
#define HD_SMALLEST_M_PER_S 1e-9
/* Slots are counted in 32 bits, and the highest numbers are names (HD_NO_SLOT). */
#define HD_MOST_OBJECTS 0x7fffffffu
/* Ends of ramps that meet are sums of what was rounded on its own. */
#define HD_MEET_TOLERANCE 1e-12

static int bounded(double value) {
    return value >= -HD_LARGEST && value <= HD_LARGEST; /* false for NaN */
}

static int between(double value, double low, double high) {
    return value >= low && value <= high;
}

/* ---- Checks ------------------------------------------------------------------------------------------------- */

/* What turns and decays, of a mode or of its tail. */
static int ringing_check(double rotor_re, double rotor_im, double decay_rate_per_s, double angular_frequency_rad_per_s,
                         const char *what, const char *tail) {
    if (!between(rotor_re, -1.0, 1.0) || !between(rotor_im, -1.0, 1.0) ||
        rotor_re * rotor_re + rotor_im * rotor_im > 1.0 + 1e-12) {
        return hd_invalid("%s: %srotor (%g, %g) is not within the unit circle", what, tail, rotor_re, rotor_im);
    }
    if (!between(decay_rate_per_s, 0.0, HD_LARGEST) || !between(angular_frequency_rad_per_s, 0.0, HD_LARGEST)) {
        return hd_invalid("%s: %sdecay rate %g and angular frequency %g must lie between 0 and %g", what, tail,
                          decay_rate_per_s, angular_frequency_rad_per_s, HD_LARGEST);
    }
    return HD_OK;
}

int hd_mode_check(const struct hd_mode *mode, const char *what) {
    if (mode->force_per_unit == 0.0 && mode->end_s == 0.0 && mode->effect == 0) {
        return HD_OK; /* none */
    }
    if (ringing_check(mode->rotor_re, mode->rotor_im, mode->decay_rate_per_s, mode->angular_frequency_rad_per_s, what,
                      "") < 0 ||
        ringing_check(mode->tail_rotor_re, mode->tail_rotor_im, mode->tail_decay_rate_per_s,
                      mode->tail_angular_frequency_rad_per_s, what, "tail's ") < 0) {
        return HD_ERR_INVALID;
    }
    if (!bounded(mode->gain_re) || !bounded(mode->gain_im) || !bounded(mode->tail_re) || !bounded(mode->tail_im) ||
        !between(mode->tail_end_s, 0.0, HD_LARGEST)) {
        return hd_invalid("%s: gain (%g, %g) or tail (%g, %g), which ends at %g s, is out of range", what,
                          mode->gain_re, mode->gain_im, mode->tail_re, mode->tail_im, mode->tail_end_s);
    }
    if (!between(mode->end_s, 0.0, HD_LARGEST) || !between(mode->peak_time_s, 0.0, HD_LARGEST) ||
        !between(mode->peak, 0.0, HD_LARGEST)) {
        return hd_invalid("%s: end %g s, peak %g at %g s are out of range", what, mode->end_s, mode->peak,
                          mode->peak_time_s);
    }
    if (!between(mode->force_per_unit, 0.0, HD_LARGEST) || !between(mode->amplitude_per_unit, 0.0, HD_LARGEST)) {
        return hd_invalid("%s: force per unit %g and amplitude per unit %g must lie between 0 and %g", what,
                          mode->force_per_unit, mode->amplitude_per_unit, HD_LARGEST);
    }
    if (!between(mode->effect_force_per_unit, 0.0, HD_LARGEST) || !between(mode->effect_peak, 0.0, HD_LARGEST) ||
        !between(mode->effect_s, 0.0, 1.0)) {
        return hd_invalid("%s: effect with %g N per unit, peak %g, %g s is out of range", what,
                          mode->effect_force_per_unit, mode->effect_peak, mode->effect_s);
    }
    return HD_OK;
}

int hd_play_check(const struct hd_mode *mode, const double direction[2], double amplitude) {
    const double square = direction[0] * direction[0] + direction[1] * direction[1];
    if (!(square > 1.0 - 1e-9 && square < 1.0 + 1e-9) || !(amplitude >= 0.0 && amplitude <= 1e9)) {
        return hd_invalid("play: direction (%g, %g) or amplitude %g", direction[0], direction[1], amplitude);
    }
    return hd_mode_check(mode, "play");
}

static int scalars_check(const struct hd_table *table) {
    if (!between(table->period_s, 1e-6, 1.0)) {
        return hd_invalid("table: period %g s is not between 1e-6 and 1", table->period_s);
    }
    if (!between(table->max_force_n, 1e-6, 1e6) || !between(table->max_speed_m_per_s, 1e-6, 1e6) ||
        !between(table->ramp_s, 1e-6, 1e3)) {
        return hd_invalid("table: force limit %g N, speed limit %g m/s or ramp %g s is out of range",
                          table->max_force_n, table->max_speed_m_per_s, table->ramp_s);
    }
    if (!between(table->rearm_m, 0.0, 1.0)) {
        return hd_invalid("table: a tap after %g m away is not between 0 and 1", table->rearm_m);
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
    if (table->passivity > HD_PASSIVITY_CONTROL || table->report_age > HD_PASSIVITY_AGE_MAX) {
        return hd_invalid("table: passivity %u, with reports %u periods old", table->passivity, table->report_age);
    }
    if (!between(table->brake_n_s_per_m, 0.0, HD_LARGEST) ||
        !between(table->handle_damping_n_s_per_m, 0.0, HD_LARGEST) ||
        !between(table->handle_friction_n, 0.0, HD_LARGEST)) {
        return hd_invalid("table: brake %g N s/m or the handle's damping %g N s/m and friction %g N are out of range",
                          table->brake_n_s_per_m, table->handle_damping_n_s_per_m, table->handle_friction_n);
    }
    const struct hd_field *field = &table->field;
    if (!bounded(field->force_n[0]) || !bounded(field->force_n[1]) || !bounded(field->stiffness_n_per_m) ||
        !bounded(field->damping_n_s_per_m)) {
        return hd_invalid("table: the field is out of range");
    }
    if (table->object_count > HD_MOST_OBJECTS) {
        return hd_invalid("table: %u objects, at most %u have a slot", table->object_count, HD_MOST_OBJECTS);
    }
    if ((table->object_count > 0 && table->objects == NULL) ||
        (table->material_count > 0 && table->materials == NULL) || (table->piece_count > 0 && table->pieces == NULL) ||
        (table->noise_count > 0 && table->noises == NULL) || (table->number_count > 0 && table->numbers == NULL)) {
        return hd_invalid("table: a count without records");
    }
    return HD_OK;
}

/* The name is put together only for a mode that is wrong. */
static int material_mode_check(const struct hd_mode *mode, const char *use, uint32_t index) {
    if (hd_mode_check(mode, use) == HD_OK) {
        return HD_OK;
    }
    char what[48];
    snprintf(what, sizeof what, "material %u: %s", index, use);
    return hd_mode_check(mode, what);
}

static int texture_check(const struct hd_material *material, uint32_t noise_count, uint32_t index) {
    switch (material->texture) {
    case HD_TEXTURE_NONE:
        return HD_OK;
    case HD_TEXTURE_STRIKES:
    case HD_TEXTURE_GEOMETRY:
    case HD_TEXTURE_DRAG:
        if (!between(material->width_m, HD_SMALLEST_M, material->spacing_m)) {
            return hd_invalid("material %u: grooves %g m wide, %g m apart; at least %g, and not wider than apart",
                              index, material->width_m, material->spacing_m, HD_SMALLEST_M);
        }
        return HD_OK;
    case HD_TEXTURE_NOISE:
        return material->noise < noise_count
                   ? HD_OK
                   : hd_invalid("material %u: noise %u of %u", index, material->noise, noise_count);
    default:
        return hd_invalid("material %u: texture %u", index, material->texture);
    }
}

static int tap_check(const struct hd_material *material, const struct hd_table *table, uint32_t index) {
    const uint32_t count = material->tap_count;
    if (count == 0) {
        return HD_OK;
    }
    if (count > HD_TAP_POINTS) {
        return hd_invalid("material %u: a tap of %u points, at most %u", index, count, HD_TAP_POINTS);
    }
    if (material->tap_first > table->number_count || 2u * count > table->number_count - material->tap_first) {
        return hd_invalid("material %u: %u points of a tap, from number %u on, do not fit into %u", index, count,
                          material->tap_first, table->number_count);
    }
    const double *speeds = table->numbers + material->tap_first;
    for (uint32_t i = 0; i < count; i++) {
        const double before = i > 0 ? speeds[i - 1u] : 0.0;
        if (!between(speeds[i], before + HD_SMALLEST_M_PER_S, HD_LARGEST) ||
            !between(speeds[count + i], 0.0, HD_LARGEST)) {
            return hd_invalid(
                "material %u: point %u of its tap, %g m/s^2 at %g m/s, is out of range or not above %g m/s", index, i,
                speeds[count + i], speeds[i], before);
        }
    }
    return HD_OK;
}

static int aim_is_sound(const double aim[2]) {
    const double square = aim[0] * aim[0] + aim[1] * aim[1];
    return (aim[0] == 0.0 && aim[1] == 0.0) || between(square, 1.0 - 1e-6, 1.0 + 1e-6);
}

static int material_check(const struct hd_material *material, uint32_t noise_count, uint32_t index) {
    const struct {
        const char *name;
        double value;
    } amounts[] = {
        {"stiffness", material->stiffness_n_per_m},
        {"damping", material->damping_n_s_per_m},
        {"rupture depth", material->rupture_depth_m},
        {"friction coefficient", material->friction_coefficient},
        {"friction stiffness", material->friction_stiffness_n_per_m},
        {"groove spacing", material->spacing_m},
        {"groove width", material->width_m},
        {"groove depth", material->depth_m},
        {"drag", material->drag_n_s_per_m},
        {"velocity gain", material->velocity_gain_per_s},
        {"force gain", material->force_gain_m_per_s2_per_n},
    };
    for (size_t i = 0; i < sizeof amounts / sizeof amounts[0]; i++) {
        if (!between(amounts[i].value, 0.0, HD_LARGEST)) {
            return hd_invalid("material %u: %s %g must lie between 0 and %g", index, amounts[i].name, amounts[i].value,
                              HD_LARGEST);
        }
    }
    if (material->heals > 1) {
        return hd_invalid("material %u: heals is 0 or 1", index);
    }
    if (!aim_is_sound(material->tap_aim) || !aim_is_sound(material->rupture_aim)) {
        return hd_invalid("material %u: the aim of a tap or a rupture has length 1, or is 0, 0", index);
    }
    if (material->friction_coefficient > 0.0 && !(material->friction_stiffness_n_per_m > 0.0)) {
        return hd_invalid("material %u: friction needs a stiffness of more than 0", index);
    }
    if (texture_check(material, noise_count, index) < 0 || material_mode_check(&material->tap, "tap", index) < 0 ||
        material_mode_check(&material->second, "second mode", index) < 0 ||
        material_mode_check(&material->rupture, "rupture", index) < 0 ||
        material_mode_check(&material->groove, "groove", index) < 0) {
        return HD_ERR_INVALID;
    }
    return HD_OK;
}

/* Materials, noises and numbers; pieces are checked with the walls that refer to them. */
static int parts_check(const struct hd_table *table) {
    for (uint32_t i = 0; i < table->material_count; i++) {
        if (material_check(&table->materials[i], table->noise_count, i) < 0 ||
            tap_check(&table->materials[i], table, i) < 0 || hd_tune_check(&table->materials[i], table, i) < 0 ||
            hd_wave_check(&table->materials[i], table, i) < 0) {
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
            return hd_invalid("object %u, piece %u: material %u of %u", slot, i, piece->material, material_count);
        }
        if (i == 0) {
            continue;
        }
        if (!bounded(piece->from_m) || !between(piece->half_ramp_m, HD_SMALLEST_M, HD_LARGEST)) {
            return hd_invalid("object %u, piece %u: begins at %g m, half a ramp %g m; at least %g", slot, i,
                              piece->from_m, piece->half_ramp_m, HD_SMALLEST_M);
        }
        if (i == 1) {
            continue;
        }
        const double gap = (piece->from_m - piece->half_ramp_m) - (piece[-1].from_m + piece[-1].half_ramp_m);
        const double size = (piece->from_m < 0.0 ? -piece->from_m : piece->from_m) +
                            (piece[-1].from_m < 0.0 ? -piece[-1].from_m : piece[-1].from_m);
        if (!(piece->from_m > piece[-1].from_m) || gap < -HD_MEET_TOLERANCE * size) {
            return hd_invalid("object %u, piece %u: its ramp, %g m +- %g m, is not beyond the one before, %g m +- %g m",
                              slot, i, piece->from_m, piece->half_ramp_m, piece[-1].from_m, piece[-1].half_ramp_m);
        }
    }
    return HD_OK;
}

/* What an object refers to is in `parts`: the table whose materials and pieces it will be rendered with. */
static int references_check(const struct hd_table *parts, const struct hd_object *object, uint32_t slot) {
    if (object->shape == HD_SHAPE_NONE) {
        return HD_OK;
    }
    if (object->material >= parts->material_count) {
        return hd_invalid("object %u: material %u of %u", slot, object->material, parts->material_count);
    }
    if (object->piece_count == 0) {
        return HD_OK;
    }
    if (object->shape != HD_SHAPE_WALL || object->piece_count < 2) {
        return hd_invalid("object %u: %u pieces; a wall has none or at least 2, others have none", slot,
                          object->piece_count);
    }
    if (object->piece_first > parts->piece_count || object->piece_count > parts->piece_count - object->piece_first) {
        return hd_invalid("object %u: pieces %u and on, %u of them, of %u", slot, object->piece_first,
                          object->piece_count, parts->piece_count);
    }
    return pieces_check(parts->pieces + object->piece_first, object->piece_count, parts->material_count, slot);
}

static int half_fits(const struct hd_object *object) {
    const double *half = object->half_m;
    switch (object->shape) {
    case HD_SHAPE_WALL:
        return half[0] == 0.0 && half[1] == 0.0;
    case HD_SHAPE_MEMBRANE:
        return between(half[0], HD_SMALLEST_M, HD_LARGEST) && half[1] == 0.0;
    case HD_SHAPE_BOX:
        return between(half[0], HD_SMALLEST_M, HD_LARGEST) && between(half[1], HD_SMALLEST_M, HD_LARGEST);
    default:
        return between(half[0], HD_SMALLEST_M, HD_LARGEST) && half[0] == half[1];
    }
}

/* Nothing but the generation of a free slot is ever looked at. */
static int object_check(const struct hd_object *object, const struct hd_table *parts, uint32_t slot) {
    if (object->shape == HD_SHAPE_NONE) {
        return HD_OK;
    }
    if (object->shape > HD_SHAPE_DISC) {
        return hd_invalid("object %u: shape %u", slot, object->shape);
    }
    if (!bounded(object->point_m[0]) || !bounded(object->point_m[1])) {
        return hd_invalid("object %u: point (%g, %g) is out of range", slot, object->point_m[0], object->point_m[1]);
    }
    const double square = object->normal[0] * object->normal[0] + object->normal[1] * object->normal[1];
    if (!between(square, 1.0 - 1e-9, 1.0 + 1e-9)) {
        return hd_invalid("object %u: normal (%g, %g) is not a unit vector", slot, object->normal[0],
                          object->normal[1]);
    }
    if (!half_fits(object)) {
        return hd_invalid("object %u: half (%g, %g) m is none of shape %u; at least %g", slot, object->half_m[0],
                          object->half_m[1], object->shape, HD_SMALLEST_M);
    }
    return references_check(parts, object, slot);
}

/* ---- Taking a table ----------------------------------------------------------------------------------------- */

/* What of a table is taken: the objects of `slots` below `from`, all objects from `from` on, and, where `parts` is not
 * 0, materials, pieces, noises and numbers. */
struct part {
    const uint32_t *slots;
    size_t count;
    uint32_t from;
    int parts;
};

static int is_listed(const struct part *part, uint32_t slot) {
    for (size_t i = 0; i < part->count; i++) {
        if (part->slots[i] == slot) {
            return 1;
        }
    }
    return 0;
}

static int check(const struct hd_world *world, const struct hd_table *table, const struct part *part) {
    const struct hd_table *parts = part->parts ? table : &world->table;
    if (part->parts && parts_check(table) < 0) {
        return HD_ERR_INVALID;
    }
    for (size_t i = 0; i < part->count; i++) {
        const uint32_t slot = part->slots[i];
        if (slot < part->from && object_check(&table->objects[slot], parts, slot) < 0) {
            return HD_ERR_INVALID;
        }
    }
    for (uint32_t slot = part->from; slot < table->object_count; slot++) {
        if (object_check(&table->objects[slot], parts, slot) < 0) {
            return HD_ERR_INVALID;
        }
    }
    /* Objects that stay may refer to parts that do not. */
    for (uint32_t slot = 0; part->parts && slot < part->from; slot++) {
        if (references_check(parts, &world->table.objects[slot], slot) < 0 && !is_listed(part, slot)) {
            return HD_ERR_INVALID;
        }
    }
    return HD_OK;
}

/* `array` is the address of a pointer to records of any type. What it held stays. */
static int grow(void *array, uint32_t *capacity, uint32_t count, size_t size) {
    if (count <= *capacity) {
        return HD_OK;
    }
    /* A scene that is loaded once takes what it needs; one that grows object by object gets room ahead. */
    const uint64_t ahead = (uint64_t)count + (*capacity > 0 ? count / 4u : 0u);
    const uint32_t larger = ahead < UINT32_MAX ? (uint32_t)ahead : UINT32_MAX;
    void *records;
    memcpy(&records, array, sizeof records);
    records = realloc(records, larger * size);
    if (records == NULL) {
        return HD_ERR_MEMORY;
    }
    memcpy(array, &records, sizeof records);
    *capacity = larger;
    return HD_OK;
}

static int make_room(struct hd_world *world, const struct hd_table *table, int parts) {
    struct hd_table *own = &world->table;
    int status = grow(&own->objects, &world->object_capacity, table->object_count, sizeof *own->objects);
    if (status == HD_OK && parts) {
        status = grow(&own->materials, &world->material_capacity, table->material_count, sizeof *own->materials);
        if (status == HD_OK) {
            status = grow(&own->pieces, &world->piece_capacity, table->piece_count, sizeof *own->pieces);
        }
        if (status == HD_OK) {
            status = grow(&own->noises, &world->noise_capacity, table->noise_count, sizeof *own->noises);
        }
        if (status == HD_OK) {
            status = grow(&own->numbers, &world->number_capacity, table->number_count, sizeof *own->numbers);
        }
    }
    return status == HD_OK ? hd_index_reserve(&world->index, world->object_capacity) : status;
}

static void copy(void *to, const void *from, uint32_t count, size_t size) {
    if (count > 0) {
        memcpy(to, from, count * size);
    }
}

/* Everything but the objects. */
static void write_rest(struct hd_table *own, const struct hd_table *table, int parts) {
    const struct hd_table before = *own;
    if (parts) {
        copy(own->materials, table->materials, table->material_count, sizeof *own->materials);
        copy(own->pieces, table->pieces, table->piece_count, sizeof *own->pieces);
        copy(own->noises, table->noises, table->noise_count, sizeof *own->noises);
        copy(own->numbers, table->numbers, table->number_count, sizeof *own->numbers);
    }
    *own = *table;
    own->objects = before.objects;
    own->materials = before.materials;
    own->pieces = before.pieces;
    own->noises = before.noises;
    own->numbers = before.numbers;
    own->changed = NULL;
    own->changed_count = 0;
}

/* Puts into the index what `objects` hold at the slots of the part; slots from `count` to `end` hold nothing. */
static int put_part(struct hd_index *index, const struct hd_object *objects, uint32_t count, const struct part *part,
                    uint32_t end) {
    static const struct hd_object nothing = {.shape = HD_SHAPE_NONE};
    for (size_t i = 0; i < part->count; i++) {
        const uint32_t slot = part->slots[i];
        if (slot < part->from && hd_index_put(index, slot, slot < count ? &objects[slot] : &nothing) < 0) {
            return HD_ERR_MEMORY;
        }
    }
    for (uint32_t slot = part->from; slot < end; slot++) {
        if (hd_index_put(index, slot, slot < count ? &objects[slot] : &nothing) < 0) {
            return HD_ERR_MEMORY;
        }
    }
    return HD_OK;
}

static int put_all_or_nothing(struct hd_world *world, const struct hd_table *table, const struct part *part) {
    const struct hd_table *own = &world->table;
    const uint32_t end = own->object_count > table->object_count ? own->object_count : table->object_count;
    if (put_part(&world->index, table->objects, table->object_count, part, end) < 0) {
        /* Once all of them are out, what was there before has the room that it had; no put fails for want of more. */
        put_part(&world->index, NULL, 0, part, end);
        put_part(&world->index, own->objects, own->object_count, part, end);
        return HD_ERR_MEMORY;
    }
    return HD_OK;
}

static int take(struct hd_world *world, const struct hd_table *table, const struct part *part) {
    struct hd_table *own = &world->table;
    int status = check(world, table, part);
    if (status == HD_OK) {
        status = make_room(world, table, part->parts);
    }
    if (status == HD_OK) {
        status = put_all_or_nothing(world, table, part);
    }
    if (status != HD_OK) {
        return status;
    }
    for (size_t i = 0; i < part->count; i++) {
        if (part->slots[i] < part->from) {
            own->objects[part->slots[i]] = table->objects[part->slots[i]];
        }
    }
    if (table->object_count > part->from) {
        copy(own->objects + part->from, table->objects + part->from, table->object_count - part->from,
             sizeof *own->objects);
    }
    write_rest(own, table, part->parts);
    world->loaded = 1;
    return HD_OK;
}

int hd_world_load(struct hd_world *world, const struct hd_table *table) {
    const struct part all = {.parts = 1};
    const int status = scalars_check(table);
    return status == HD_OK ? take(world, table, &all) : status;
}

void hd_world_still(struct hd_world *world) {
    world->table.ramp_step = 0.0;
}

int hd_world_update(struct hd_world *world, const struct hd_table *table, const uint32_t *slots, size_t count) {
    if (!world->loaded || table->all_changed) {
        return hd_world_load(world, table);
    }
    const struct hd_table *own = &world->table;
    const struct part part = {
        .slots = slots,
        .count = count,
        .from = own->object_count < table->object_count ? own->object_count : table->object_count,
        .parts = table->parts_version != own->parts_version || table->material_count != own->material_count ||
                 table->piece_count != own->piece_count || table->noise_count != own->noise_count ||
                 table->number_count != own->number_count,
    };
    const int status = scalars_check(table);
    return status == HD_OK ? take(world, table, &part) : status;
}

/* ---- Making, reading and freeing ---------------------------------------------------------------------------- */

struct hd_world *hd_world_new(void) {
    return calloc(1, sizeof(struct hd_world));
}

void hd_world_release(struct hd_world *world) {
    free(world->table.objects);
    free(world->table.materials);
    free(world->table.pieces);
    free(world->table.noises);
    free(world->table.numbers);
    hd_index_release(&world->index);
    *world = (struct hd_world){.loaded = 0};
}

void hd_world_free(struct hd_world *world) {
    if (world != NULL) {
        hd_world_release(world);
        free(world);
    }
}

size_t hd_world_candidates(const struct hd_world *world, const double point_m[2], double radius_m, uint32_t *slots,
                           size_t capacity) {
    const uint32_t room = world->index.slot_count;
    struct hd_candidate *candidates = malloc((room > 0 ? room : 1u) * sizeof *candidates);
    if (candidates == NULL) {
        return SIZE_MAX; /* more than there can be */
    }
    const uint32_t count = hd_index_query(&world->index, world->table.objects, point_m, radius_m, candidates);
    for (uint32_t i = 0; i < count && i < capacity; i++) {
        slots[i] = candidates[i].slot;
    }
    free(candidates);
    return count;
}

size_t hd_world_regions(const struct hd_world *world, struct hd_region regions[HD_WORLD_REGIONS]) {
    const struct hd_table *table = &world->table;
    const struct hd_index *index = &world->index;
    const size_t chains = index->chains != NULL ? (size_t)index->chain_mask + 1u : 0u;
    size_t count = 0;
    regions[count++] = (struct hd_region){table->objects, world->object_capacity * sizeof *table->objects};
    regions[count++] = (struct hd_region){table->materials, world->material_capacity * sizeof *table->materials};
    regions[count++] = (struct hd_region){table->pieces, world->piece_capacity * sizeof *table->pieces};
    regions[count++] = (struct hd_region){table->noises, world->noise_capacity * sizeof *table->noises};
    regions[count++] = (struct hd_region){table->numbers, world->number_capacity * sizeof *table->numbers};
    regions[count++] = (struct hd_region){index->chains, chains * sizeof *index->chains};
    regions[count++] = (struct hd_region){index->members, index->slot_count * sizeof *index->members};
    regions[count++] = (struct hd_region){index->nodes, index->slot_count * sizeof *index->nodes};
    for (size_t i = 0; i < HD_INDEX_SECTORS; i++) {
        const struct hd_index_heap *heap = &index->heaps[i];
        regions[count++] = (struct hd_region){heap->walls, heap->capacity * sizeof *heap->walls};
    }
    return count;
}
