/* Worlds: what is refused, and that it leaves the world as it was; memory that runs out at every place where it can;
 * updates of a few objects against taking the table whole.
 *
 * The source under test is compiled in here a second time, under other names, so that its memory can be made scarce. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "hd_test.h"
#include "scene/hd_index.h"

static size_t allowance = SIZE_MAX; /* so many more calls find memory */

static int afford(void) {
    if (allowance == 0)
        return 0;
    if (allowance != SIZE_MAX)
        allowance--;
    return 1;
}

static void *scarce_realloc(void *memory, size_t size) {
    return afford() ? realloc(memory, size) : NULL;
}

static int scarce_index_reserve(struct hd_index *index, uint32_t slot_count) {
    return afford() ? hd_index_reserve(index, slot_count) : HD_ERR_MEMORY;
}

static int wanting; /* a put failed: what is put back after it must not want more memory */

static size_t heap_room(const struct hd_index *index) {
    size_t room = 0;

    for (size_t i = 0; i < HD_INDEX_SECTORS; i++)
        room += index->heaps[i].capacity;
    return room;
}

static int scarce_index_put(struct hd_index *index, uint32_t slot, const struct hd_object *object) {
    size_t room = wanting ? heap_room(index) : 0;
    int status;

    if (!wanting && !afford()) {
        wanting = 1;
        return HD_ERR_MEMORY;
    }
    status = hd_index_put(index, slot, object);
    CHECK(!wanting || heap_room(index) == room);
    return status;
}

#define realloc scarce_realloc
#define hd_index_reserve scarce_index_reserve
#define hd_index_put scarce_index_put
#define hd_world_free scarce_world_free
#define hd_world_load scarce_world_load
#define hd_world_candidates scarce_world_candidates
#define hd_world_new scarce_world_new
#define hd_world_regions scarce_world_regions
#define hd_world_release scarce_world_release
#define hd_world_still scarce_world_still
#define hd_world_update scarce_world_update
/* Their declarations under the new names. */
struct hd_world *hd_world_new(void);
void hd_world_free(struct hd_world *world);
void hd_world_still(struct hd_world *world);
int hd_world_load(struct hd_world *world, const struct hd_table *table);
size_t hd_world_candidates(const struct hd_world *world, const double point_m[2], double radius_m, uint32_t *slots,
                           size_t capacity);
#include "scene/hd_world.c"
#undef realloc

#define OBJECTS 40u
#define MATERIALS 8u
#define PIECES 12u
#define NOISES 2u
#define NUMBERS 16u
#define TAP_FIRST 10u /* of three points */
#define WITH_TAP (bad.table.number_count = NUMBERS, material->tap_count = 3, material->tap_first = TAP_FIRST)
#define TUNE_FIRST NUMBERS /* of one speed, two forces and one node */
#define TUNE_NUMBERS (1u + 2u + 2u + HD_TUNE_NODE)
#define WAVE_FIRST (NUMBERS + TUNE_NUMBERS) /* of four samples */
#define ALL_NUMBERS (WAVE_FIRST + 4u + HD_WAVE_PARTS)
#define WAVE(i) bad.numbers[WAVE_FIRST + (i)]
#define WITH_WAVE                                                                                       \
    (bad.table.number_count = ALL_NUMBERS, material->wave_count = 4, material->wave_first = WAVE_FIRST, \
     material->wave_rate_hz = 2000.0)
#define TUNE(i) bad.numbers[TUNE_FIRST + (i)]
#define WITH_TUNE                                                                                       \
    (bad.table.number_count = WAVE_FIRST, material->tune_first = TUNE_FIRST, material->tune_speeds = 1, \
     material->tune_forces = 2, material->tune_nodes = 1, material->tune_highest_rad_per_s = 4000.0)
#define WITH_MODES                                                                                          \
    (bad.table.number_count = WAVE_FIRST, material->mode_first = TUNE_FIRST + 2u, material->mode_count = 1, \
     material->mode_nodes = 1, material->tune_highest_rad_per_s = 4000.0)
#define SEQUENCES 40
#define STEPS 60
#define LOOKS 12

struct scene {
    struct hd_table table;
    struct hd_object objects[OBJECTS];
    struct hd_material materials[MATERIALS];
    struct hd_piece pieces[PIECES];
    struct hd_noise noises[NOISES];
    double numbers[ALL_NUMBERS];
};

static double uniform(uint64_t *seed, double low, double high) {
    return low + (high - low) * (double)(test_random(seed) >> 11) * 0x1p-53;
}

static struct hd_mode ringing(void) {
    return (struct hd_mode){
        .rotor_re = 0.9,
        .rotor_im = 0.3,
        .decay_rate_per_s = 300.0,
        .angular_frequency_rad_per_s = 1000.0,
        .end_s = 0.01,
        .peak = 0.6,
        .peak_time_s = 0.001,
        .amplitude_per_unit = 300.0,
        .force_per_unit = 15.0,
        .gain_re = 0.9,
        .gain_im = -0.2,
        .tail_rotor_re = 0.99,
        .tail_rotor_im = 0.01,
        .tail_decay_rate_per_s = 100.0,
        .tail_angular_frequency_rad_per_s = 50.0,
        .tail_end_s = 0.05,
        .tail_re = 0.1,
        .tail_im = -0.1,
    };
}

/* One object of every shape, one material of every texture, a wall of three materials. */
static void make_scene(struct scene *scene) {
    memset(scene, 0, sizeof *scene);
    scene->table = (struct hd_table){
        .revision = 1,
        .object_count = 6,
        .material_count = 5,
        .piece_count = 4,
        .noise_count = 1,
        .number_count = 6,
        .display_force = 1,
        .display_vibration = 1,
        .period_s = 1e-3,
        .max_force_n = 8.9,
        .max_speed_m_per_s = 5.0,
        .ramp_s = 0.02,
        .ramp_step = 1e-3 / 0.02,
        .objects = scene->objects,
        .materials = scene->materials,
        .pieces = scene->pieces,
        .noises = scene->noises,
        .numbers = scene->numbers,
    };
    for (uint32_t i = 0; i < MATERIALS; i++) {
        scene->materials[i] = (struct hd_material){
            .texture = i % 5,
            .stiffness_n_per_m = 500.0 + i,
            .damping_n_s_per_m = 0.1,
            .friction_coefficient = 0.3,
            .friction_stiffness_n_per_m = 200.0,
            .spacing_m = 0.002,
            .width_m = 0.0005,
            .depth_m = 0.0001,
            .drag_n_s_per_m = 2.0,
            .velocity_gain_per_s = 1200.0,
            .force_gain_m_per_s2_per_n = 63.0,
            .tap = ringing(),
            .second = ringing(),
            .rupture = ringing(),
            .groove = ringing(),
        };
    }
    /* One speed, one force; RMS, k_1, v_0, v_1. */
    scene->noises[0] =
        (struct hd_noise){.order = 1, .taps = 1, .speed_count = 1, .force_count = 1, .force_per_unit = 0.05};
    memcpy(scene->numbers, (const double[]){0.0, 0.0, 3.0, -0.5, 0.6, 0.8}, 6 * sizeof(double));
    memcpy(scene->numbers + TAP_FIRST, (const double[]){0.1, 0.2, 0.4, 30.0, 0.0, 90.0}, 6 * sizeof(double));
    memcpy(scene->numbers + WAVE_FIRST, (const double[]){0.0, 1.0, -0.5, 0.0, 1.0}, 5 * sizeof(double));
    memcpy(scene->numbers + TUNE_FIRST,
           (const double[]){0.1, 0.5, 1.0, 900.0, 1200.0, 1000.0, 1.0, 0.5, -0.3, 0.2, 1.0, 0.4, -0.2, 0.1, 0.8, 0.7},
           TUNE_NUMBERS * sizeof(double));
    scene->pieces[0] = (struct hd_piece){.material = 4, .half_ramp_m = (double)NAN, .from_m = (double)NAN};
    scene->pieces[1] = (struct hd_piece){.material = 0};
    scene->pieces[2] = (struct hd_piece){.from_m = 0.01, .half_ramp_m = 0.002, .material = 1};
    scene->pieces[3] = (struct hd_piece){.from_m = 0.015, .half_ramp_m = 0.003, .material = 4};
    scene->objects[0] = (struct hd_object){
        .shape = HD_SHAPE_WALL, .point_m = {0.0, -0.01}, .normal = {0.0, 1.0}, .piece_first = 1, .piece_count = 3};
    scene->objects[1] =
        (struct hd_object){.shape = HD_SHAPE_NONE, .generation = 7, .material = 99, .half_m = {(double)NAN, 0.0}};
    scene->objects[2] = (struct hd_object){
        .shape = HD_SHAPE_MEMBRANE, .point_m = {0.0, 0.01}, .normal = {0.6, 0.8}, .half_m = {0.02, 0.0}};
    scene->objects[3] = (struct hd_object){
        .shape = HD_SHAPE_BOX, .material = 1, .point_m = {0.02, 0.0}, .normal = {0.8, -0.6}, .half_m = {0.003, 0.001}};
    scene->objects[4] = (struct hd_object){
        .shape = HD_SHAPE_DISC, .material = 3, .point_m = {-0.02, 0.0}, .normal = {0.0, 1.0}, .half_m = {0.005, 0.005}};
    scene->objects[5] =
        (struct hd_object){.shape = HD_SHAPE_WALL, .material = 2, .point_m = {-0.03, 0.0}, .normal = {1.0, 0.0}};
}

/* ---- Comparing worlds ------------------------------------------------------------------------------------------- */

static int by_number(const void *a, const void *b) {
    uint32_t x = *(const uint32_t *)a;
    uint32_t y = *(const uint32_t *)b;

    return (x > y) - (x < y);
}

static int same_records(const void *a, const void *b, uint32_t count, size_t size) {
    return count == 0 || memcmp(a, b, count * size) == 0;
}

static void check_same(const struct hd_world *world, const struct hd_world *other, uint64_t *seed) {
    const struct hd_table *a = &world->table;
    const struct hd_table *b = &other->table;

    CHECK(a->revision == b->revision && a->field_version == b->field_version && a->parts_version == b->parts_version);
    CHECK(a->object_count == b->object_count && a->material_count == b->material_count &&
          a->piece_count == b->piece_count && a->noise_count == b->noise_count && a->number_count == b->number_count);
    CHECK(a->period_s == b->period_s && a->ramp_s == b->ramp_s && a->ramp_step == b->ramp_step &&
          a->max_force_n == b->max_force_n && a->max_speed_m_per_s == b->max_speed_m_per_s &&
          a->rearm_m == b->rearm_m && a->display_force == b->display_force &&
          a->display_vibration == b->display_vibration);
    CHECK(memcmp(&a->field, &b->field, sizeof a->field) == 0);
    CHECK(same_records(a->objects, b->objects, a->object_count, sizeof *a->objects));
    CHECK(same_records(a->materials, b->materials, a->material_count, sizeof *a->materials));
    CHECK(same_records(a->pieces, b->pieces, a->piece_count, sizeof *a->pieces));
    CHECK(same_records(a->noises, b->noises, a->noise_count, sizeof *a->noises));
    CHECK(same_records(a->numbers, b->numbers, a->number_count, sizeof *a->numbers));
    for (int i = 0; i < LOOKS; i++) {
        double point_m[2] = {uniform(seed, -0.05, 0.05), uniform(seed, -0.05, 0.05)};
        double radius_m = uniform(seed, 0.0, i % 2 == 0 ? 0.01 : 0.1);
        uint32_t candidates[2][OBJECTS];
        size_t count = hd_world_candidates(world, point_m, radius_m, candidates[0], OBJECTS);

        CHECK(count <= a->object_count);
        CHECK(hd_world_candidates(other, point_m, radius_m, candidates[1], OBJECTS) == count);
        qsort(candidates[0], count, sizeof candidates[0][0], by_number);
        qsort(candidates[1], count, sizeof candidates[1][0], by_number);
        CHECK(same_records(candidates[0], candidates[1], (uint32_t)count, sizeof candidates[0][0]));
        for (size_t at = 0; at < count; at++)
            CHECK(a->objects[candidates[0][at]].shape != HD_SHAPE_NONE &&
                  (at == 0 || candidates[0][at] != candidates[0][at - 1]));
    }
}

/* The same as a world that never held anything else. */
static void check_holds(const struct hd_world *world, const struct hd_table *table, uint64_t *seed) {
    struct hd_world *fresh = hd_world_new();

    CHECK(fresh != NULL && hd_world_load(fresh, table) == HD_OK);
    check_same(world, fresh, seed);
    hd_world_free(fresh);
}

/* ---- Refusals --------------------------------------------------------------------------------------------------- */

static uint64_t refusals;

/* Whole, and by a list that names every object; both leave the world as it was, and say why. */
static void check_refused(struct hd_world *world, const struct scene *good, const struct scene *bad, const char *why,
                          int line) {
    static const uint32_t slots[] = {0, 1, 2, 3, 4, 5};
    struct hd_table table = bad->table;
    uint64_t seed = (uint64_t)line;

    for (int update = 0; update < 2; update++) {
        int status = update ? hd_world_update(world, &table, slots, 6) : hd_world_load(world, &table);

        if (status != HD_ERR_INVALID || strstr(hd_invalid_reason(), why) == NULL) {
            fprintf(stderr, "%s:%d: %s gives %d: %s\n", __FILE__, line, update ? "update" : "load", status,
                    status == HD_OK ? "taken" : hd_invalid_reason());
            exit(1);
        }
        check_holds(world, &good->table, &seed);
        table.parts_version++; /* so that an update looks at the parts */
    }
    refusals++;
}

/* What `fault` does to a sound scene is refused, with `why` in the reason. */
#define REFUSED(fault, why)                                 \
    do {                                                    \
        make_scene(&bad);                                   \
        fault;                                              \
        bad.table.parts_version = 1;                        \
        check_refused(world, &good, &bad, (why), __LINE__); \
    } while (0)

/* What `change` does to it is no fault. */
#define TAKEN(change)                                     \
    do {                                                  \
        struct hd_world *other = hd_world_new();          \
        make_scene(&bad);                                 \
        change;                                           \
        CHECK(other != NULL);                             \
        CHECK(hd_world_load(other, &bad.table) == HD_OK); \
        hd_world_free(other);                             \
    } while (0)

/* Not within its bounds: a number beyond each, and what is no number. */
#define NOT_WITHIN(place, low, high, why)    \
    do {                                     \
        REFUSED((place) = (low), why);       \
        REFUSED((place) = (high), why);      \
        REFUSED((place) = (double)NAN, why); \
    } while (0)

static void refuses_scalars(struct hd_world *world) {
    struct scene good;
    struct scene bad;

    make_scene(&good);
    NOT_WITHIN(bad.table.period_s, 0.9e-6, 1.1, "period");
    NOT_WITHIN(bad.table.max_force_n, 0.0, 2e6, "force limit");
    NOT_WITHIN(bad.table.max_speed_m_per_s, -1.0, (double)INFINITY, "speed limit");
    NOT_WITHIN(bad.table.rearm_m, -1e-9, 1.1, "rearm distance");
    NOT_WITHIN(bad.table.ramp_s, 0.0, 1e4, "ramp");
    NOT_WITHIN(bad.table.ramp_step, 0.04, 0.06, "ramp step");
    REFUSED((bad.table.ramp_s = 5e-4, bad.table.ramp_step = 2.0), "shorter than a period");
    REFUSED(bad.table.display_force = 2, "display");
    REFUSED(bad.table.display_vibration = 2, "display");
    REFUSED(bad.table.passivity = 3, "passivity");
    REFUSED(bad.table.report_age = HD_PASSIVITY_AGE_MAX + 1, "age of reports");
    NOT_WITHIN(bad.table.brake_n_s_per_m, -1.0, 2e9, "brake");
    NOT_WITHIN(bad.table.handle_damping_n_s_per_m, -1.0, 2e9, "handle's damping");
    NOT_WITHIN(bad.table.handle_friction_n, -1.0, 2e9, "friction");
    NOT_WITHIN(bad.table.field.force_n[0], -2e9, 2e9, "field");
    NOT_WITHIN(bad.table.field.force_n[1], -2e9, 2e9, "field");
    NOT_WITHIN(bad.table.field.stiffness_n_per_m, -2e9, 2e9, "field");
    NOT_WITHIN(bad.table.field.damping_n_s_per_m, -2e9, 2e9, "field");
    REFUSED(bad.table.objects = NULL, "NULL");
    REFUSED(bad.table.materials = NULL, "NULL");
    REFUSED(bad.table.pieces = NULL, "NULL");
    REFUSED(bad.table.noises = NULL, "NULL");
    REFUSED(bad.table.numbers = NULL, "NULL");
    REFUSED(bad.table.object_count = 0x80000000u, "at most");
}

static void refuses_objects(struct hd_world *world) {
    struct scene good;
    struct scene bad;

    make_scene(&good);
    REFUSED(bad.objects[1].shape = HD_SHAPE_DISC + 1, "object 1: unknown shape 5");
    for (uint32_t i = 0; i < 6; i++) {
        if (i == 1)
            continue;
        NOT_WITHIN(bad.objects[i].point_m[0], -2e9, 2e9, "point");
        NOT_WITHIN(bad.objects[i].point_m[1], -2e9, (double)INFINITY, "point");
        NOT_WITHIN(bad.objects[i].normal[0], -1.001, 1.001, "unit vector");
        NOT_WITHIN(bad.objects[i].normal[1], -1.001, 1.001, "unit vector");
        NOT_WITHIN(bad.objects[i].half_m[0], -0.001, 2e9, "half");
        NOT_WITHIN(bad.objects[i].half_m[1], -0.001, 2e9, "half");
        REFUSED(bad.objects[i].material = 5, "material 5 does not exist; there are 5");
        REFUSED(bad.objects[i].piece_count = 1, "pieces");
    }
    REFUSED(bad.objects[0].half_m[0] = 1e-3, "half");
    REFUSED(bad.objects[2].half_m[0] = 0.0, "half");
    REFUSED(bad.objects[2].half_m[1] = 1e-3, "half");
    REFUSED(bad.objects[3].half_m[0] = 0.0, "half");
    REFUSED(bad.objects[3].half_m[1] = 1e-300, "half");
    REFUSED(bad.objects[4].half_m[0] = bad.objects[4].half_m[1] = 0.0, "half");
    REFUSED(bad.objects[4].half_m[0] = 0.006, "half");
    REFUSED((bad.objects[3].piece_first = 1, bad.objects[3].piece_count = 3), "a wall has 0 or at least 2");
    REFUSED(bad.table.material_count = 0, "material");
    TAKEN(bad.objects[3].half_m[1] = 1e-9);
    TAKEN(bad.objects[1].half_m[0] = 2e9);
    TAKEN(bad.objects[0].normal[1] = 1.0 - 4e-10);
    TAKEN((bad.table.object_count = bad.table.material_count = 0, bad.table.objects = NULL));
    TAKEN(bad.table.material_count = 8);
}

static void refuses_pieces(struct hd_world *world) {
    struct scene good;
    struct scene bad;

    make_scene(&good);
    REFUSED(bad.objects[0].piece_count = 4, "there are 4");
    REFUSED(bad.objects[0].piece_first = 5, "there are 4");
    REFUSED(bad.objects[0].piece_first = UINT32_MAX, "there are 4");
    REFUSED(bad.objects[0].piece_count = UINT32_MAX, "there are 4");
    REFUSED(bad.table.piece_count = 3, "there are 3");
    REFUSED(bad.pieces[1].material = 5, "piece 0: material 5 does not exist");
    REFUSED(bad.pieces[3].material = UINT32_MAX, "piece 2: material");
    NOT_WITHIN(bad.pieces[2].from_m, -2e9, 2e9, "piece 1: start");
    NOT_WITHIN(bad.pieces[2].half_ramp_m, 0.0, 2e9, "piece 1: start");
    NOT_WITHIN(bad.pieces[3].from_m, 0.0149, -(double)INFINITY, "piece 2");
    NOT_WITHIN(bad.pieces[3].half_ramp_m, -0.001, 0.00301, "piece 2");
    REFUSED((bad.pieces[2].from_m = bad.pieces[3].from_m = 0.0,
             bad.pieces[2].half_ramp_m = bad.pieces[3].half_ramp_m = 1e-9),
            "must follow the one before");
    /* Ramps that meet exactly, but not in binary; a first piece whose numbers mean nothing. */
    TAKEN(bad.pieces[3].from_m = nextafter(0.015, 0.0));
    TAKEN(bad.pieces[1].from_m = (double)INFINITY);
    TAKEN(bad.objects[0].piece_count = 2);
    /* Pieces that no wall refers to are nobody's. */
    TAKEN((bad.objects[0].piece_count = 0, bad.pieces[2].half_ramp_m = -1.0));
}

static void refuses_materials(struct hd_world *world) {
    struct scene good;
    struct scene bad;
    struct hd_material *material = &bad.materials[1];

    make_scene(&good);
    REFUSED(material->texture = HD_TEXTURE_NOISE + 1, "material 1: unknown texture 5");
    REFUSED(material->heals = 2, "heals");
    NOT_WITHIN(material->tap_aim[0], -2.0, 0.5, "aim");
    NOT_WITHIN(material->rupture_aim[1], -0.9, 1.1, "aim");
    NOT_WITHIN(material->stiffness_n_per_m, -1e-9, 2e9, "material 1: stiffness");
    NOT_WITHIN(material->damping_n_s_per_m, -1e-9, 2e9, "material 1: damping");
    NOT_WITHIN(material->rupture_depth_m, -1e-9, 2e9, "rupture depth");
    NOT_WITHIN(material->friction_coefficient, -1e-9, 2e9, "friction coefficient");
    NOT_WITHIN(material->friction_stiffness_n_per_m, -1e-9, 2e9, "friction stiffness");
    REFUSED(material->friction_stiffness_n_per_m = 0.0, "friction needs a stiffness");
    NOT_WITHIN(material->spacing_m, -1e-9, 2e9, "groove spacing");
    NOT_WITHIN(material->width_m, -1e-9, 2e9, "groove width");
    NOT_WITHIN(material->depth_m, -1e-9, 2e9, "groove depth");
    NOT_WITHIN(material->drag_n_s_per_m, -1e-9, 2e9, "drag");
    NOT_WITHIN(material->velocity_gain_per_s, -1e-9, 2e9, "velocity gain");
    NOT_WITHIN(material->force_gain_m_per_s2_per_n, -1e-9, 2e9, "force gain");
    for (uint32_t i = 1; i < 4; i++) {
        REFUSED(bad.materials[i].spacing_m = 0.0, "grooves");
        REFUSED(bad.materials[i].width_m = 0.0, "grooves");
        REFUSED(bad.materials[i].width_m = 0.0021, "grooves");
    }
    REFUSED(bad.materials[4].noise = 1, "material 4: noise 1 does not exist");
    REFUSED(bad.table.noise_count = 0, "material 4: noise 0 does not exist");
    REFUSED((material->tap_count = HD_TAP_POINTS + 1), "points; there must be at most");
    REFUSED((WITH_TAP, material->tap_first++), "do not fit");
    REFUSED((WITH_TAP, material->tap_first = UINT32_MAX), "do not fit");
    REFUSED((WITH_TAP, bad.numbers[TAP_FIRST] = 0.0), "point 0");
    REFUSED((WITH_TAP, bad.numbers[TAP_FIRST + 2] = 0.2), "point 2");
    REFUSED((WITH_TAP, bad.numbers[TAP_FIRST + 1] = (double)NAN), "point 1");
    REFUSED((WITH_TAP, bad.numbers[TAP_FIRST + 4] = -1.0), "point 1");
    REFUSED((WITH_TAP, bad.numbers[TAP_FIRST + 5] = (double)INFINITY), "point 2");
    TAKEN(WITH_TAP);
    TAKEN((material->tap_count = 0, material->tap_first = UINT32_MAX));
    TAKEN(WITH_WAVE);
    TAKEN((material->wave_count = 0, material->wave_first = UINT32_MAX));
    REFUSED((WITH_WAVE, material->wave_count = 2), "waveform has 2 samples");
    REFUSED((WITH_WAVE, material->wave_count = HD_WAVE_SAMPLES + 1), "3 to 512");
    REFUSED((WITH_WAVE, material->wave_first++), "do not fit");
    REFUSED((WITH_WAVE, material->wave_first = UINT32_MAX), "do not fit");
    REFUSED((WITH_WAVE, material->wave_rate_hz = 0.0), "Hz of its waveform");
    REFUSED((WITH_WAVE, material->wave_rate_hz = (double)NAN), "Hz of its waveform");
    REFUSED((WITH_WAVE, WAVE(1) = (double)NAN), "number 1 of its waveform");
    REFUSED((WITH_WAVE, WAVE(2) = 2e9), "number 2 of its waveform");
    REFUSED((WITH_WAVE, WAVE(4) = -1.0), "number 4 of its waveform");
    REFUSED((WITH_WAVE, WAVE(0) = 0.1), "must begin and end with 0");
    REFUSED((WITH_WAVE, WAVE(3) = 0.1), "must begin and end with 0");
    TAKEN(WITH_TUNE);
    TAKEN((WITH_TUNE, material->tune_mutes = 1, material->tune_nodes = 0));
    REFUSED((WITH_TUNE, material->tune_speeds = HD_TUNE_POINTS + 1), "1 to 16");
    REFUSED((WITH_TUNE, material->tune_forces = 0), "1 to 16");
    REFUSED((WITH_TUNE, material->tune_forces = HD_TUNE_POINTS + 1), "1 to 16");
    REFUSED((WITH_TUNE, material->tune_nodes = HD_TUNE_NODES + 1), "at most 64");
    REFUSED((WITH_TUNE, material->tune_first++), "do not fit");
    REFUSED((WITH_TUNE, material->tune_first = UINT32_MAX), "do not fit");
    REFUSED((WITH_TUNE, TUNE(0) = -1e-3), "do not rise");
    REFUSED((WITH_TUNE, TUNE(2) = TUNE(1)), "do not rise");
    REFUSED((WITH_TUNE, TUNE(3) = 0.0), "out of range");
    REFUSED((WITH_TUNE, TUNE(4) = (double)NAN), "out of range");
    REFUSED((WITH_TUNE, TUNE(5) = 0.0), "do not rise");
    REFUSED((WITH_TUNE, TUNE(6) = (double)INFINITY), "out of range");
    REFUSED((WITH_TUNE, TUNE(15) = -1e-9), "peak below 0");
    REFUSED((WITH_TUNE, material->tune_highest_rad_per_s = 0.0), "highest groove frequency");
    REFUSED((WITH_TUNE, material->tune_mutes = 2), "highest groove frequency");
    REFUSED((WITH_TUNE, material->groove = (struct hd_mode){0}), "highest groove frequency");
    TAKEN(WITH_MODES);
    TAKEN((WITH_MODES, material->mode_by_peak = 1, material->mode_nodes = 0));
    REFUSED((WITH_MODES, material->mode_count = HD_TUNE_POINTS + 1), "1 to 16");
    REFUSED((WITH_MODES, material->mode_nodes = HD_TUNE_NODES + 1), "at most 64");
    REFUSED((WITH_MODES, material->mode_by_peak = 2), "mode_by_peak");
    REFUSED((WITH_MODES, WITH_WAVE), "no waveform");
    REFUSED((WITH_MODES, material->mode_first++), "do not fit");
    REFUSED((WITH_MODES, material->mode_first = UINT32_MAX), "do not fit");
    REFUSED((WITH_MODES, TUNE(2) = -1e-3), "out of range");
    REFUSED((WITH_MODES, TUNE(3) = 0.0), "out of range");
    REFUSED((WITH_MODES, TUNE(4) = (double)NAN), "out of range");
    REFUSED((WITH_MODES, TUNE(6) = (double)INFINITY), "out of range");
    REFUSED((WITH_MODES, TUNE(14) = -1e-9), "out of range");
    REFUSED((WITH_MODES, material->tune_highest_rad_per_s = 0.0), "out of range");
    TAKEN((material->friction_coefficient = 0.0, material->friction_stiffness_n_per_m = 0.0));
    TAKEN(bad.materials[0].spacing_m = bad.materials[4].width_m = 0.0);
    TAKEN(material->width_m = material->spacing_m);
    TAKEN(material->noise = 99);
}

static void refuses_modes(struct hd_world *world) {
    struct scene good;
    struct scene bad;
    struct hd_mode *const modes[] = {&bad.materials[2].tap, &bad.materials[2].rupture, &bad.materials[2].groove,
                                     &bad.materials[2].second};
    const char *const names[] = {"material 2: tap", "material 2: rupture", "material 2: groove",
                                 "material 2: second mode"};

    make_scene(&good);
    for (size_t i = 0; i < 4; i++) {
        NOT_WITHIN(modes[i]->rotor_re, -1.001, 1.001, names[i]);
        NOT_WITHIN(modes[i]->rotor_im, -1.001, 0.5, names[i]);
        NOT_WITHIN(modes[i]->decay_rate_per_s, -1.0, 2e9, names[i]);
        NOT_WITHIN(modes[i]->angular_frequency_rad_per_s, -1.0, 2e9, names[i]);
        NOT_WITHIN(modes[i]->end_s, -1.0, 2e9, names[i]);
        NOT_WITHIN(modes[i]->peak, -0.1, 2e9, names[i]);
        NOT_WITHIN(modes[i]->peak_time_s, -1.0, 2e9, names[i]);
        NOT_WITHIN(modes[i]->amplitude_per_unit, -1.0, 2e9, names[i]);
        NOT_WITHIN(modes[i]->force_per_unit, -1.0, 2e9, names[i]);
        NOT_WITHIN(modes[i]->effect_force_per_unit, -1.0, 2e9, names[i]);
        NOT_WITHIN(modes[i]->effect_peak, -0.1, 2e9, names[i]);
        NOT_WITHIN(modes[i]->effect_s, -0.1, 1.1, names[i]);
        NOT_WITHIN(modes[i]->gain_re, -2e9, 2e9, names[i]);
        NOT_WITHIN(modes[i]->gain_im, -2e9, 2e9, names[i]);
        NOT_WITHIN(modes[i]->tail_rotor_re, -1.001, 1.001, names[i]);
        NOT_WITHIN(modes[i]->tail_rotor_im, -1.001, 0.5, names[i]);
        NOT_WITHIN(modes[i]->tail_decay_rate_per_s, -1.0, 2e9, names[i]);
        NOT_WITHIN(modes[i]->tail_angular_frequency_rad_per_s, -1.0, 2e9, names[i]);
        NOT_WITHIN(modes[i]->tail_end_s, -1.0, 2e9, names[i]);
        NOT_WITHIN(modes[i]->tail_re, -2e9, 2e9, names[i]);
        NOT_WITHIN(modes[i]->tail_im, -2e9, 2e9, names[i]);
        TAKEN(*modes[i] = (struct hd_mode){0});
    }
}

static void refuses_noises(struct hd_world *world) {
    struct scene good;
    struct scene bad;
    struct hd_noise *noise = &bad.noises[0];

    make_scene(&good);
    REFUSED(noise->order = HD_NOISE_ORDER + 1, "noise 0");
    REFUSED(noise->order = 2, "noise 0");
    REFUSED(noise->taps = 2, "noise 0");
    REFUSED(noise->along_normal = 2, "noise 0");
    REFUSED(noise->speed_count = 0, "noise 0");
    REFUSED(noise->force_count = 0, "noise 0");
    REFUSED(noise->speed_count = UINT32_MAX, "noise 0");
    REFUSED(noise->first = 1, "noise 0");
    REFUSED(noise->first = UINT32_MAX, "noise 0");
    REFUSED(noise->threshold_m_per_s = -1.0, "noise 0");
    REFUSED(noise->velocity_gain_per_s = (double)NAN, "noise 0");
    REFUSED(noise->force_gain_m_per_s2_per_n = (double)INFINITY, "noise 0");
    REFUSED(noise->force_per_unit = -1.0, "noise 0");
    REFUSED(bad.table.number_count = 5, "noise 0");
    REFUSED(bad.numbers[0] = (double)NAN, "noise 0");
    REFUSED(bad.numbers[2] = -1.0, "noise 0");
    REFUSED(bad.numbers[3] = 1.0, "noise 0");
    REFUSED(bad.numbers[4] = 0.7, "noise 0");
    TAKEN((noise->taps = 0, noise->force_gain_m_per_s2_per_n = -5.0));
}

/* A wall that is not looked at again may not lose what it refers to. */
static void refuses_what_others_refer_to(struct hd_world *world) {
    struct scene good;
    struct scene bad;
    uint64_t seed = 1;

    make_scene(&good);
    for (int fault = 0; fault < 4; fault++) {
        make_scene(&bad);
        /* Fewer of them are noticed without a version. */
        bad.table.parts_version = fault < 2 ? 0 : 1;
        if (fault == 0)
            bad.table.material_count = 4;
        else if (fault == 1)
            bad.table.piece_count = 3;
        else if (fault == 2)
            bad.pieces[2].half_ramp_m = 0.004;
        else
            bad.pieces[1].material = 5;
        CHECK(hd_world_update(world, &bad.table, NULL, 0) == HD_ERR_INVALID);
        check_holds(world, &good.table, &seed);
        /* It is no fault where the wall itself goes away, listed anywhere. */
        bad.objects[0].piece_count = 0;
        CHECK(hd_world_update(world, &bad.table, (const uint32_t[]){77, 4, 0, UINT32_MAX}, 4) == HD_OK);
        check_holds(world, &bad.table, &seed);
        CHECK(hd_world_load(world, &good.table) == HD_OK);
    }
    make_scene(&bad);
    bad.table.noise_count = 0;
    CHECK(hd_world_update(world, &bad.table, NULL, 0) == HD_ERR_INVALID);
    make_scene(&bad);
    bad.table.number_count = 5;
    CHECK(hd_world_update(world, &bad.table, NULL, 0) == HD_ERR_INVALID);
    check_holds(world, &good.table, &seed);
}

/* ---- Memory that runs out ---------------------------------------------------------------------------------------- */

/* Every second one is a wall, in few directions, so that walls crowd in the index. */
static void scatter(uint64_t *seed, struct hd_object *object) {
    double angle = (double)test_below(seed, 3) + uniform(seed, 0.0, 0.02);
    double half_m = uniform(seed, 1e-4, 0.01);
    uint32_t shape = (uint32_t)test_below(seed, 2 * HD_SHAPE_DISC + 1);

    *object = (struct hd_object){
        .generation = (uint32_t)test_random(seed),
        .pose_version = (uint32_t)test_random(seed),
        .shape = shape <= HD_SHAPE_DISC ? shape : HD_SHAPE_WALL,
        .material = (uint32_t)test_below(seed, 4),
        .point_m = {uniform(seed, -0.04, 0.04), uniform(seed, -0.04, 0.04)},
        .normal = {cos(angle), sin(angle)},
    };
    if (object->shape == HD_SHAPE_MEMBRANE || object->shape == HD_SHAPE_BOX)
        object->half_m[0] = half_m;
    if (object->shape == HD_SHAPE_BOX)
        object->half_m[1] = half_m * uniform(seed, 0.1, 2.0);
    if (object->shape == HD_SHAPE_DISC)
        object->half_m[0] = object->half_m[1] = half_m;
    if (object->shape == HD_SHAPE_WALL && test_below(seed, 2) == 0) {
        object->piece_first = 1 + 3 * (uint32_t)test_below(seed, 3);
        object->piece_count = 2 + (uint32_t)test_below(seed, 2);
    }
}

/* Everything is larger and nothing stays as it was. */
static void make_other_scene(uint64_t *seed, struct scene *scene) {
    make_scene(scene);
    scene->table.revision = 2;
    scene->table.field_version = 1;
    scene->table.field.force_n[0] = 0.5;
    scene->table.parts_version = 1;
    scene->table.object_count = OBJECTS;
    scene->table.material_count = MATERIALS;
    scene->table.noise_count = NOISES;
    scene->table.number_count = 12;
    scene->table.piece_count = 10;
    memcpy(&scene->pieces[4], &scene->pieces[1], 3 * sizeof scene->pieces[0]);
    memcpy(&scene->pieces[7], &scene->pieces[1], 3 * sizeof scene->pieces[0]);
    memcpy(&scene->numbers[6], scene->numbers, 6 * sizeof(double));
    scene->noises[1] = scene->noises[0];
    scene->noises[1].first = 6;
    for (uint32_t i = 0; i < OBJECTS; i++)
        scatter(seed, &scene->objects[i]);
}

/* Every call that can fail does, once each, until the table is taken: from a world that is smaller, as large, and
 * larger. */
static uint64_t runs_out(void) {
    uint64_t seed = 11;
    uint64_t failures = 0;

    for (int kind = 0; kind < 24; kind++) {
        struct scene before;
        struct scene after;
        uint32_t slots[OBJECTS];
        int status = HD_ERR_MEMORY;

        for (uint32_t i = 0; i < OBJECTS; i++)
            slots[i] = (uint32_t)test_below(&seed, OBJECTS);
        if (kind % 4 < 2) {
            make_scene(&before);
            make_other_scene(&seed, &after);
        } else {
            make_other_scene(&seed, &before);
            make_other_scene(&seed, &after);
            after.table.parts_version = 2;
            if (kind % 2 == 0)
                after.table.object_count = 7;
        }
        for (size_t at = 0; status == HD_ERR_MEMORY; at++) {
            struct hd_world *world = hd_world_new();
            uint64_t look = at;

            CHECK(world != NULL && hd_world_load(world, &before.table) == HD_OK);
            allowance = at;
            wanting = 0;
            status = kind % 2 == 0 ? hd_world_load(world, &after.table)
                                   : hd_world_update(world, &after.table, slots, OBJECTS / 2);
            allowance = SIZE_MAX;
            wanting = 0;
            if (status != HD_OK) {
                CHECK(status == HD_ERR_MEMORY);
                failures++;
                check_holds(world, &before.table, &look);
                /* And it can be taken after all. */
                CHECK(hd_world_load(world, &after.table) == HD_OK);
                check_holds(world, &after.table, &look);
            }
            hd_world_free(world);
        }
        CHECK(status == HD_OK);
    }
    return failures;
}

/* ---- Updates ----------------------------------------------------------------------------------------------------- */

/* One hot update; fills `slots` with what changed and returns how many. */
static size_t change(uint64_t *seed, struct scene *scene, uint32_t *slots) {
    struct hd_table *table = &scene->table;
    size_t count = test_below(seed, 6);
    uint32_t objects = table->object_count;

    table->revision++;
    table->display_force = (uint32_t)test_below(seed, 2);
    table->field.force_n[1] = uniform(seed, -1.0, 1.0);
    table->field_version++;
    if (test_below(seed, 4) == 0) {
        table->object_count = (uint32_t)test_below(seed, OBJECTS + 1);
        for (uint32_t i = objects; i < table->object_count; i++)
            scatter(seed, &scene->objects[i]);
    }
    for (size_t i = 0; i < count; i++) {
        slots[i] = (uint32_t)test_below(seed, OBJECTS);
        scatter(seed, &scene->objects[slots[i]]);
    }
    if (test_below(seed, 4) == 0) {
        table->parts_version++;
        table->material_count = 5 + (uint32_t)test_below(seed, 4);
        table->piece_count = 10 + (uint32_t)test_below(seed, 3);
        scene->materials[test_below(seed, MATERIALS)].stiffness_n_per_m = uniform(seed, 0.0, 1000.0);
        scene->pieces[1 + 3 * test_below(seed, 3)].material = (uint32_t)test_below(seed, 5);
        scene->pieces[2 + 3 * test_below(seed, 3)].half_ramp_m = uniform(seed, 1e-6, 0.002);
        scene->numbers[2] = uniform(seed, 0.0, 5.0);
    }
    return count;
}

static uint64_t updates(void) {
    uint64_t seed = 5;
    uint64_t count = 0;

    for (int sequence = 0; sequence < SEQUENCES; sequence++) {
        struct hd_world *world = hd_world_new();
        struct scene scene;

        CHECK(world != NULL);
        make_other_scene(&seed, &scene);
        for (int step = 0; step < STEPS; step++) {
            uint32_t slots[3 * OBJECTS];
            size_t listed = 0;
            uint32_t least = scene.table.object_count;

            /* Up to three tables in one update. A slot that was given up between them may have come back as another. */
            for (size_t tables = 1 + test_below(&seed, 3); tables > 0; tables--) {
                listed += change(&seed, &scene, &slots[listed]);
                least = scene.table.object_count < least ? scene.table.object_count : least;
            }
            for (uint32_t slot = least; slot < OBJECTS; slot++)
                slots[listed++] = slot;
            CHECK(hd_world_update(world, &scene.table, slots, listed) == HD_OK);
            check_holds(world, &scene.table, &seed);
            count++;
        }
        hd_world_free(world);
    }
    return count;
}

/* What is not listed is not looked at, unless everything is said to have changed. */
static void looks_at_what_is_listed(struct hd_world *world) {
    struct scene good;
    struct scene other;
    uint64_t seed = 3;

    make_scene(&good);
    make_scene(&other);
    other.objects[3].point_m[0] = (double)NAN;
    other.materials[0].stiffness_n_per_m = (double)NAN;
    CHECK(hd_world_update(world, &other.table, (const uint32_t[]){4}, 1) == HD_OK);
    check_holds(world, &good.table, &seed);
    other.table.all_changed = 1;
    CHECK(hd_world_update(world, &other.table, (const uint32_t[]){4}, 1) == HD_ERR_INVALID);
    check_holds(world, &good.table, &seed);
    /* Nor are parts of the same version: what an object refers to must be sound in those that the world has. */
    good.pieces[0].material = 99;
    good.pieces[1].half_ramp_m = 0.001;
    CHECK(hd_world_load(world, &good.table) == HD_OK);
    make_scene(&other);
    other.objects[0].piece_first = 0;
    other.objects[0].piece_count = 2;
    other.pieces[1].half_ramp_m = 0.001;
    CHECK(hd_world_update(world, &other.table, (const uint32_t[]){0}, 1) == HD_ERR_INVALID);
    check_holds(world, &good.table, &seed);
    other.table.parts_version = 1;
    CHECK(hd_world_update(world, &other.table, (const uint32_t[]){0}, 1) == HD_OK);
    check_holds(world, &other.table, &seed);
    make_scene(&good);
    CHECK(hd_world_load(world, &good.table) == HD_OK);
}

/* What is rendered after refusals is what is rendered without. */
static void renders_as_before(const struct hd_world *world) {
    struct scene good;
    struct hd_world *fresh = hd_world_new();
    struct hd_state *states[2] = {hd_state_new(6), hd_state_new(6)};
    struct hd_state *small = hd_state_new(5);
    double position[200][2];
    struct hd_sample samples[2][200];
    size_t events;

    make_scene(&good);
    CHECK(fresh != NULL && states[0] != NULL && states[1] != NULL && small != NULL);
    CHECK(hd_render(fresh, states[0], position[0], NULL, NULL, 200, samples[0], NULL, 0, &events) == HD_ERR_INVALID);
    CHECK(hd_world_load(fresh, &good.table) == HD_OK);
    for (int i = 0; i < 200; i++) {
        position[i][0] = -0.025 + 0.0003 * i;
        position[i][1] = 0.001 * sin(0.2 * i) - 0.0095;
    }
    CHECK(hd_render(fresh, small, position[0], NULL, NULL, 200, samples[0], NULL, 0, &events) == HD_ERR_INVALID);
    memset(samples, 0, sizeof samples);
    CHECK(hd_render(world, states[0], position[0], NULL, NULL, 200, samples[0], NULL, 0, &events) == HD_OK);
    CHECK(hd_render(fresh, states[1], position[0], NULL, NULL, 200, samples[1], NULL, 0, &events) == HD_OK);
    CHECK(memcmp(samples[0], samples[1], sizeof samples[0]) == 0 && events > 0);
    hd_state_free(states[0]);
    hd_state_free(states[1]);
    hd_state_free(small);
    hd_world_free(fresh);
}

int main(void) {
    struct hd_world *world = hd_world_new();
    struct scene good;
    uint64_t failures;
    uint64_t updated;

    make_scene(&good);
    CHECK(world != NULL && hd_world_candidates(world, (const double[]){0.0, 0.0}, 1.0, NULL, 0) == 0);
    CHECK(hd_world_load(world, &good.table) == HD_OK);
    refuses_scalars(world);
    refuses_objects(world);
    refuses_pieces(world);
    refuses_materials(world);
    refuses_modes(world);
    refuses_noises(world);
    refuses_what_others_refer_to(world);
    looks_at_what_is_listed(world);
    renders_as_before(world);
    hd_world_free(world);
    failures = runs_out();
    updated = updates();
    printf("test_world: ok, %llu faults refused, %llu times out of memory, %llu updates\n",
           (unsigned long long)refusals, (unsigned long long)failures, (unsigned long long)updated);
    return 0;
}
