/* Random scenes, random changes of every kind, random streams of forces, and a hand that presses, strokes and lets
 * ring: what tests of the rule of hd_ramp.h are made of. */
#ifndef HD_TORTURE_H
#define HD_TORTURE_H

#include <math.h>

#include "api/hd_core.h"
#include "hd_test.h"
#include "scene/hd_world.h"
#include "tick/hd_state.h"
#include "tick/hd_tick.h"

#define OBJECTS 8u
#define MATERIALS 6u
#define PIECES 24u
#define NOISES 2u
#define NUMBERS 32u
#define WAVED 12u /* samples of a waveform, behind the numbers of the noises */
#define ALL_NUMBERS (NUMBERS + WAVED + HD_WAVE_PARTS)
#define LIMIT_N 8.9

enum change {
    MOVE,
    NUDGE,
    SLIDE,
    TURN,
    COME,
    GO,
    SWAP,
    STIFFEN,
    RESURFACE,
    PATCH,
    FIELD,
    SHOW_FORCE,
    SHOW_VIBRATION,
    RAMP,
    RESET_ONE,
    RESET_ALL,
    FORCES,
    WATCH,
    CHANGES
};

static const char *const names[CHANGES + 1] = {"move",      "nudge",      "slide",          "turn",      "come",
                                               "go",        "swap",       "stiffen",        "resurface", "patch",
                                               "field",     "show force", "show vibration", "ramp",      "reset one",
                                               "reset all", "forces",     "watch",          "no change"};

struct scene {
    struct hd_table table;
    struct hd_object objects[OBJECTS];
    struct hd_material materials[MATERIALS];
    struct hd_piece pieces[PIECES];
    struct hd_noise noises[NOISES];
    double numbers[ALL_NUMBERS];
};

struct torture {
    uint64_t random;
    uint32_t stamp;
    double period_s;
    struct scene scene;
    struct hd_world *worlds[2];
    uint32_t front;
    struct hd_state *state;
    struct hd_state *still;
    double time_s;
    double phase[4];
    int quiet;             /* nothing vibrates */
    uint64_t stream_every; /* ticks between two values of a stream; 0: there is none */
    uint64_t stream_last;  /* the tick of the last one */
};

static inline double between(uint64_t *random, double low, double high) {
    return low + (high - low) * (double)(test_random(random) >> 11) * 0x1p-53;
}

static inline int one_in(uint64_t *random, size_t count) {
    return test_below(random, count) == 0;
}

/* ---- Scenes -------------------------------------------------------------------------------------------------- */

static inline void make_mode(struct torture *torture, double force, struct hd_mode *mode) {
    const double b = between(&torture->random, 50.0, 600.0);
    const double w = 6.283185307179586 * between(&torture->random, 20.0, 400.0);

    *mode = (struct hd_mode){
        .rotor_re = exp(-b * torture->period_s) * cos(w * torture->period_s),
        .rotor_im = exp(-b * torture->period_s) * sin(w * torture->period_s),
        .decay_rate_per_s = b,
        .angular_frequency_rad_per_s = w,
        .end_s = 5.0 / b,
        .peak = exp(-b / w * atan2(w, b)) * sin(atan2(w, b)),
        .peak_time_s = atan2(w, b) / w,
        .amplitude_per_unit = 1.0,
        .force_per_unit = force * between(&torture->random, 0.1, 1.0),
        .gain_re = 1.0,
    };
    if (one_in(&torture->random, 3)) { /* as one that is compensated for what it meets */
        mode->free_gain_re = between(&torture->random, 0.5, 1.5);
        mode->free_peak = mode->free_gain_re * mode->peak;
        mode->touched_n_per_m = between(&torture->random, 50.0, 2000.0);
        mode->kick_count = HD_KICKS;
        for (uint32_t i = 0; i < 2 * HD_KICKS; i++) {
            mode->kicks[i] = between(&torture->random, -0.2, 0.2);
        }
        mode->peak += 0.4;
        mode->free_peak += 0.4;
    }
}

static inline void make_material(struct torture *torture, struct hd_material *material) {
    uint64_t *random = &torture->random;

    *material = (struct hd_material){
        .texture = (uint32_t)test_below(random, 5),
        .noise = (uint32_t)test_below(random, NOISES),
        .heals = (uint32_t)test_below(random, 2),
        .stiffness_n_per_m = one_in(random, 4) ? between(random, 1000.0, 8000.0) : between(random, 50.0, 1000.0),
        .damping_n_s_per_m = one_in(random, 2) ? 0.0 : between(random, 0.0, 5.0),
        .rupture_depth_m = one_in(random, 2) ? between(random, 0.001, 0.008) : 0.0,
        .friction_coefficient = one_in(random, 2) ? between(random, 0.05, 1.5) : 0.0,
        .friction_stiffness_n_per_m = between(random, 100.0, 2000.0),
        .spacing_m = between(random, 0.001, 0.004),
        .depth_m = between(random, 0.0, 0.0005),
        .drag_n_s_per_m = between(random, 0.0, 5.0),
        .velocity_gain_per_s = between(random, 0.0, 20.0),
        .force_gain_m_per_s2_per_n = between(random, 0.0, 5.0),
    };
    material->width_m = between(random, 0.3, 1.0) * material->spacing_m;
    if (torture->quiet) {
        material->texture = material->texture == HD_TEXTURE_NOISE ? HD_TEXTURE_NONE : material->texture;
        return;
    }
    make_mode(torture, 20.0, &material->tap);
    if (one_in(random, 3)) {
        material->wave_count = WAVED;
        material->wave_first = NUMBERS;
        material->wave_rate_hz = between(random, 300.0, 3000.0);
        material->tap = (struct hd_mode){
            .end_s = (double)(WAVED - 1u) / material->wave_rate_hz,
            .peak = 1.25,
            .peak_time_s = 0.001,
            .amplitude_per_unit = 1.0,
            .force_per_unit = 20.0 * between(random, 0.1, 1.0),
            .gain_re = 1.0,
        };
    }
    make_mode(torture, 2.0, &material->rupture);
    make_mode(torture, 0.05, &material->groove);
}

static inline void make_noise(struct torture *torture, uint32_t index) {
    double *numbers = torture->scene.numbers + index * (NUMBERS / NOISES);

    torture->scene.noises[index] = (struct hd_noise){
        .order = 2,
        .along_normal = (uint32_t)test_below(&torture->random, 2),
        .speed_count = 1,
        .force_count = 1,
        .first = index * (NUMBERS / NOISES),
        .version = ++torture->stamp,
        .seed = test_random(&torture->random),
        .threshold_m_per_s = between(&torture->random, 0.0, 0.01),
        .velocity_gain_per_s = between(&torture->random, 0.0, 40.0),
        .force_gain_m_per_s2_per_n = between(&torture->random, 0.0, 4.0),
        .force_per_unit = between(&torture->random, 0.0, 0.1),
    };
    numbers[0] = numbers[1] = 0.0;
    numbers[2] = between(&torture->random, 0.0, 2.0);
    numbers[3] = between(&torture->random, -0.9, 0.9);
    numbers[4] = between(&torture->random, -0.9, 0.9);
}

static inline void make_pieces(struct torture *torture, struct hd_object *object, uint32_t slot) {
    struct hd_piece *pieces = torture->scene.pieces + 3u * slot;
    double from = between(&torture->random, -0.015, 0.0);

    object->piece_count = 0;
    object->piece_first = 0;
    if (object->shape != HD_SHAPE_WALL || one_in(&torture->random, 2))
        return;
    object->piece_first = 3u * slot;
    object->piece_count = 3;
    for (uint32_t i = 0; i < 3; i++) {
        pieces[i] = (struct hd_piece){
            .from_m = i > 0 ? from : 0.0,
            .half_ramp_m = i > 0 ? 0.0005 : 0.0,
            .material = (uint32_t)test_below(&torture->random, MATERIALS),
        };
        from += between(&torture->random, 0.002, 0.01);
    }
}

/* Somewhere about the hand's way, or as far off as it goes. */
static inline void make_place(struct torture *torture, struct hd_object *object) {
    uint64_t *random = &torture->random;
    const double angle = one_in(random, 2) ? 0.0 : between(random, -1.0, 1.0);

    object->pose_version = ++torture->stamp;
    object->normal[0] = object->shape == HD_SHAPE_DISC ? 0.0 : sin(angle);
    object->normal[1] = object->shape == HD_SHAPE_DISC ? 1.0 : cos(angle);
    object->point_m[0] = between(random, -0.02, 0.02);
    object->point_m[1] = between(random, -0.008, 0.004);
    if (one_in(random, 20))
        object->point_m[1] = between(random, -1.0, 1.0);
    object->half_m[0] = object->half_m[1] = 0.0;
    if (object->shape != HD_SHAPE_WALL)
        object->half_m[0] = between(random, 0.001, 0.02);
    if (object->shape == HD_SHAPE_BOX)
        object->half_m[1] = between(random, 0.0002, 0.005);
    if (object->shape == HD_SHAPE_DISC)
        object->half_m[1] = object->half_m[0];
}

static inline void make_object(struct torture *torture, uint32_t slot, uint32_t shape) {
    struct hd_object *object = &torture->scene.objects[slot];

    *object = (struct hd_object){
        .generation = ++torture->stamp,
        .shape = shape,
        .material = (uint32_t)test_below(&torture->random, MATERIALS),
    };
    object->surface_version = torture->stamp;
    if (shape == HD_SHAPE_NONE)
        return;
    make_place(torture, object);
    make_pieces(torture, object, slot);
}

/* Materials are in use everywhere: everything made of it has another surface. */
static inline void resurface(struct torture *torture) {
    torture->stamp++;
    for (uint32_t i = 0; i < OBJECTS; i++)
        torture->scene.objects[i].surface_version = torture->stamp;
}

static inline void make_field(struct torture *torture) {
    uint64_t *random = &torture->random;
    struct hd_field *field = &torture->scene.table.field;

    *field = (struct hd_field){.force_n = {0.0, 0.0}};
    if (!one_in(random, 3)) {
        const double most = one_in(random, 4) ? 1000.0 : 2.0;

        field->force_n[0] = between(random, -most, most);
        field->force_n[1] = between(random, -most, most);
        field->stiffness_n_per_m = one_in(random, 2) ? between(random, 0.0, 200.0) : 0.0;
        field->damping_n_s_per_m = one_in(random, 2) ? between(random, 0.0, 5.0) : 0.0;
    }
    torture->scene.table.field_version = ++torture->stamp;
}

static inline void publish(struct torture *torture) {
    struct hd_table *table = &torture->scene.table;

    table->revision++;
    table->parts_version = ++torture->stamp;
    table->all_changed = 1;
    torture->front ^= 1u;
    if (hd_world_load(torture->worlds[torture->front], table) != HD_OK) {
        fprintf(stderr, "%s\n", hd_invalid_reason());
        exit(1);
    }
}

static inline void begin(struct torture *torture) {
    struct scene *scene = &torture->scene;

    scene->table = (struct hd_table){
        .revision = 0,
        .object_count = OBJECTS,
        .material_count = MATERIALS,
        .piece_count = PIECES,
        .noise_count = NOISES,
        .number_count = ALL_NUMBERS,
        .display_force = 1,
        .display_vibration = 1,
        .period_s = torture->period_s,
        .max_force_n = LIMIT_N,
        .max_speed_m_per_s = 5.0,
        .ramp_s = 0.02,
        .ramp_step = torture->period_s / 0.02,
        .objects = scene->objects,
        .materials = scene->materials,
        .pieces = scene->pieces,
        .noises = scene->noises,
        .numbers = scene->numbers,
    };
    for (uint32_t i = 0; i < NOISES; i++)
        make_noise(torture, i);
    for (uint32_t i = 1; i < WAVED + HD_WAVE_PARTS; i++) /* peaks: no cubic is larger than 1.25 of its samples */
        scene->numbers[NUMBERS + i] = i < WAVED - 1u ? between(&torture->random, -1.0, 1.0) : i < WAVED ? 0.0 : 1.25;
    for (uint32_t i = 0; i < MATERIALS; i++)
        make_material(torture, &scene->materials[i]);
    for (uint32_t i = 0; i < OBJECTS; i++)
        make_object(torture, i, i == 0 ? HD_SHAPE_WALL : i < 4 ? HD_SHAPE_NONE : (uint32_t)(1u + i % 4u));
    publish(torture);
}

static inline uint32_t any_object(struct torture *torture) {
    for (;;) {
        const uint32_t slot = (uint32_t)test_below(&torture->random, OBJECTS);

        if (torture->scene.objects[slot].shape != HD_SHAPE_NONE)
            return slot;
        if (one_in(&torture->random, 64))
            make_object(torture, slot, HD_SHAPE_WALL);
    }
}

/* What is touched, mostly. */
static inline uint32_t some_object(struct torture *torture) {
    if (torture->state->active_count > 0 && !one_in(&torture->random, 4))
        return torture->state->active[test_below(&torture->random, torture->state->active_count)];
    return any_object(torture);
}

/* Of the scene; what changes the state alone is for change_state. */
static inline void change_scene(struct torture *torture, enum change kind) {
    uint64_t *random = &torture->random;
    struct scene *scene = &torture->scene;
    const uint32_t slot = some_object(torture);
    struct hd_object *object = &scene->objects[slot];
    const double angle = between(random, -3.2, 3.2);

    switch (kind) {
    case MOVE:
        make_place(torture, object);
        break;
    case NUDGE:
        object->pose_version = ++torture->stamp;
        object->point_m[0] += between(random, -0.002, 0.002);
        object->point_m[1] += between(random, -0.002, 0.002);
        break;
    case SLIDE: {
        const double way = between(random, -0.01, 0.01);

        object->pose_version = ++torture->stamp;
        object->point_m[0] += way * object->normal[1];
        object->point_m[1] -= way * object->normal[0];
        break;
    }
    case TURN:
        if (object->shape != HD_SHAPE_DISC) {
            object->pose_version = ++torture->stamp;
            object->normal[0] = sin(angle);
            object->normal[1] = cos(angle);
        }
        break;
    case COME:
        make_object(torture, (uint32_t)test_below(random, OBJECTS), 1u + (uint32_t)test_below(random, 4));
        break;
    case GO:
        make_object(torture, slot, HD_SHAPE_NONE);
        break;
    case SWAP:
        object->surface_version = ++torture->stamp;
        object->material = (uint32_t)test_below(random, MATERIALS);
        break;
    case STIFFEN:
        scene->materials[test_below(random, MATERIALS)].stiffness_n_per_m = between(random, 50.0, 4000.0);
        resurface(torture);
        break;
    case RESURFACE:
        if (one_in(random, 3))
            make_noise(torture, (uint32_t)test_below(random, NOISES));
        make_material(torture, &scene->materials[test_below(random, MATERIALS)]);
        resurface(torture);
        break;
    case PATCH:
        make_pieces(torture, object, slot);
        object->surface_version = ++torture->stamp;
        break;
    case FIELD:
        make_field(torture);
        break;
    case SHOW_FORCE:
        scene->table.display_force ^= 1u;
        break;
    case SHOW_VIBRATION:
        scene->table.display_vibration ^= 1u;
        break;
    case RAMP:
        scene->table.ramp_s = between(random, 2.0 * torture->period_s, 0.05);
        scene->table.ramp_step = scene->table.period_s / scene->table.ramp_s;
        break;
    case WATCH:
        scene->table.passivity = (uint32_t)test_below(random, 3);
        break;
    default:
        break;
    }
    publish(torture);
}

static inline void change_state(struct torture *torture, enum change kind) {
    const uint32_t slot = some_object(torture);

    if (kind == RESET_ALL)
        hd_tick_reset(torture->state, HD_NO_SLOT, 0, 0);
    else if (kind == RESET_ONE)
        hd_tick_reset(torture->state, slot, torture->scene.objects[slot].generation, 0);
    else
        hd_state_want_forces(torture->state, one_in(&torture->random, 4) ? 0 : 1);
}

static inline void change(struct torture *torture, enum change kind) {
    if (kind < RESET_ONE || kind == WATCH)
        change_scene(torture, kind);
    else
        change_state(torture, kind);
}

static inline void open_torture(struct torture *torture) {
    for (int i = 0; i < 2; i++)
        CHECK((torture->worlds[i] = hd_world_new()) != NULL);
    CHECK((torture->state = hd_state_new(OBJECTS)) != NULL && (torture->still = hd_state_new(OBJECTS)) != NULL);
    for (int i = 0; i < 4; i++)
        torture->phase[i] = between(&torture->random, 0.0, 6.0);
    begin(torture);
    CHECK(hd_state_reserve(torture->state, OBJECTS) == HD_OK && hd_state_reserve(torture->still, OBJECTS) == HD_OK);
}

static inline void close_torture(struct torture *torture) {
    hd_state_free(torture->state);
    hd_state_free(torture->still);
    hd_world_free(torture->worlds[0]);
    hd_world_free(torture->worlds[1]);
}

/* ---- The hand, and what is streamed ---------------------------------------------------------------------------- */

static inline void move(struct torture *torture, struct hd_input *input) {
    const double t = torture->time_s;
    const double *phase = torture->phase;
    const double rates[4] = {2.0, 0.9, 4.1, 160.0};

    input->position_m[0] = 0.015 * sin(rates[0] * t + phase[0]);
    input->position_m[1] =
        -0.002 + 0.004 * sin(rates[2] * t + phase[2]) + 0.003 * sin(rates[1] * t + phase[1]) + 1e-4 * sin(rates[3] * t);
    input->velocity_m_per_s[0] = 0.015 * rates[0] * cos(rates[0] * t + phase[0]);
    input->velocity_m_per_s[1] = 0.004 * rates[2] * cos(rates[2] * t + phase[2]) +
                                 0.003 * rates[1] * cos(rates[1] * t + phase[1]) + 1e-4 * rates[3] * cos(rates[3] * t);
}

/* Somewhere between rest and far beyond the limit. */
static inline void stream_value(struct torture *torture) {
    uint64_t *random = &torture->random;
    const double most = one_in(random, 10) ? 1000.0 : one_in(random, 3) ? 2.0 * LIMIT_N : 1.0;
    const double force_n[2] = {between(random, -most, most), between(random, -most, most)};

    hd_tick_stream(torture->state, &torture->worlds[torture->front]->table, force_n,
                   (double)torture->stream_every * torture->period_s * between(random, 0.5, 1.5));
    torture->stream_last = torture->state->tick;
}

/* Streams that begin, come regularly, late or in every tick, and end. */
static inline void stream(struct torture *torture) {
    uint64_t *random = &torture->random;
    const uint64_t since = torture->state->tick - torture->stream_last;

    if (one_in(random, 1000)) {
        if (torture->stream_every > 0)
            hd_tick_stream_end(torture->state, &torture->worlds[torture->front]->table);
        torture->stream_every = one_in(random, 3) ? 0 : one_in(random, 3) ? 1 : 1 + test_below(random, 200);
    } else if (torture->stream_every > 0 && since >= torture->stream_every && !one_in(random, 20)) {
        stream_value(torture);
    }
}

#endif
