/* The rule of hd_ramp.h, tortured: random changes of every kind under a hand that presses, strokes and lets ring.
 *
 * Every tick is rendered twice, from one state: as it is, and from a copy of the state with the table from before the
 * change and every ramp standing still. What lies between the two commands is what commands do in this tick, and it is
 * never more than max_force_n / ramp_s. A change takes place where the hand is: in the tick of a change it rests.
 *
 * main takes the number of ticks, the number of changes and a seed: `test_ramp 10000000 50000 1`. */
#include <math.h>
#include <string.h>

#include "api/hd_core.h"
#include "base/hd_vector.h"
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
#define ROUNDING_N 1e-9
#define MOVING 4.0 /* the first order of a step of the hand, on flanks and edges */
#define BEGIN 500  /* ticks: the hand begins inside of things */

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
    int quiet; /* nothing vibrates */
};

static double between(uint64_t *random, double low, double high) {
    return low + (high - low) * (double)(test_random(random) >> 11) * 0x1p-53;
}

static int one_in(uint64_t *random, size_t count) {
    return test_below(random, count) == 0;
}

/* ---- Scenes -------------------------------------------------------------------------------------------------- */

static void make_mode(struct torture *torture, double force, struct hd_mode *mode) {
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

static void make_material(struct torture *torture, struct hd_material *material) {
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

static void make_noise(struct torture *torture, uint32_t index) {
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

static void make_pieces(struct torture *torture, struct hd_object *object, uint32_t slot) {
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
static void make_place(struct torture *torture, struct hd_object *object) {
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

static void make_object(struct torture *torture, uint32_t slot, uint32_t shape) {
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
static void resurface(struct torture *torture) {
    torture->stamp++;
    for (uint32_t i = 0; i < OBJECTS; i++)
        torture->scene.objects[i].surface_version = torture->stamp;
}

static void make_field(struct torture *torture) {
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

static void publish(struct torture *torture) {
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

static void begin(struct torture *torture) {
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

static uint32_t any_object(struct torture *torture) {
    for (;;) {
        const uint32_t slot = (uint32_t)test_below(&torture->random, OBJECTS);

        if (torture->scene.objects[slot].shape != HD_SHAPE_NONE)
            return slot;
        if (one_in(&torture->random, 64))
            make_object(torture, slot, HD_SHAPE_WALL);
    }
}

/* What is touched, mostly. */
static uint32_t some_object(struct torture *torture) {
    if (torture->state->active_count > 0 && !one_in(&torture->random, 4))
        return torture->state->active[test_below(&torture->random, torture->state->active_count)];
    return any_object(torture);
}

/* Of the scene; what changes the state alone is for change_state. */
static void change_scene(struct torture *torture, enum change kind) {
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

static void change_state(struct torture *torture, enum change kind) {
    const uint32_t slot = some_object(torture);

    if (kind == RESET_ALL)
        hd_tick_reset(torture->state, HD_NO_SLOT, 0, 0);
    else if (kind == RESET_ONE)
        hd_tick_reset(torture->state, slot, torture->scene.objects[slot].generation, 0);
    else
        hd_state_want_forces(torture->state, one_in(&torture->random, 4) ? 0 : 1);
}

static void change(struct torture *torture, enum change kind) {
    if (kind < RESET_ONE || kind == WATCH)
        change_scene(torture, kind);
    else
        change_state(torture, kind);
}

static void open_torture(struct torture *torture) {
    for (int i = 0; i < 2; i++)
        CHECK((torture->worlds[i] = hd_world_new()) != NULL);
    CHECK((torture->state = hd_state_new(OBJECTS)) != NULL && (torture->still = hd_state_new(OBJECTS)) != NULL);
    for (int i = 0; i < 4; i++)
        torture->phase[i] = between(&torture->random, 0.0, 6.0);
    begin(torture);
    CHECK(hd_state_reserve(torture->state, OBJECTS) == HD_OK && hd_state_reserve(torture->still, OBJECTS) == HD_OK);
}

static void close_torture(struct torture *torture) {
    hd_state_free(torture->state);
    hd_state_free(torture->still);
    hd_world_free(torture->worlds[0]);
    hd_world_free(torture->worlds[1]);
}

/* ---- The two ticks ------------------------------------------------------------------------------------------- */

static void move(struct torture *torture, struct hd_input *input) {
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

/* Resting, in the old scene: what another way along pressed surfaces, since the tick before, leads to. */
static int met_something(const struct hd_state *state) {
    for (uint32_t i = 0; i < state->event_count; i++)
        if (state->events[i].kind == HD_EVENT_CONTACT || state->events[i].kind == HD_EVENT_RELEASE)
            return 1;
    return 0;
}

/* A contact that the hand itself met without an onset, where solids overlap: its ramp is no command's. */
static int has_own_ramp(const struct hd_state *state) {
    for (uint32_t i = 0; i < state->active_count; i++)
        if (state->slots[state->active[i]].ramp < 1.0)
            return 1;
    return 0;
}

struct outcome {
    double worst; /* of what is allowed */
    double worst_of[CHANGES + 1];
    double worst_resting;
    double worst_moving;
    uint64_t resting;
    uint64_t changes;
    uint64_t forceful;
    uint64_t saturated;
    uint64_t ringing;
    uint64_t ramping;
    uint64_t strikes;
    uint64_t met; /* ticks in which the old scene meets or leaves something by itself, or ramps */
};

/* `moving`: nothing vibrates, and the hand does not rest in the tick of a change. Then only this is sure: the command
 * is near what the old scene would do, or near what it was. */
static void run(uint64_t seed, double rate_hz, uint64_t ticks, uint64_t changes, int moving, struct outcome *outcome) {
    struct torture torture = {.random = seed, .period_s = 1.0 / rate_hz, .quiet = moving};
    struct hd_sample before = {.tick = 0};
    struct hd_input input = {.periods = 1};
    uint64_t burst = 0;

    open_torture(&torture);
    for (uint64_t i = 0; i < ticks; i++) {
        const struct hd_world *was = torture.worlds[torture.front];
        struct hd_world still_world = *was;
        struct hd_sample sample;
        struct hd_sample still;
        enum change kind = CHANGES;
        double step[2];
        double part;

        /* One by one, and now and then 2,000 a second at 10 kHz. */
        if (burst > 0 ? --burst % 5 == 0 : test_below(&torture.random, ticks) < changes && i > BEGIN)
            kind = (enum change)test_below(&torture.random, CHANGES);
        if (kind != CHANGES && burst == 0 && one_in(&torture.random, 200))
            burst = 500;
        input.time_ns = (int64_t)(1e9 * torture.period_s * (double)i);
        input.interval_s = (moving || kind == CHANGES) && i > 0 ? torture.period_s : 0.0;
        outcome->changes += kind != CHANGES;
        if (moving || kind == CHANGES) {
            torture.time_s += torture.period_s;
            move(&torture, &input);
        }
        if (one_in(&torture.random, 2000)) {
            const double along[2] = {0.6, 0.8};
            const struct hd_mode *mode = &torture.scene.materials[test_below(&torture.random, MATERIALS)].tap;

            CHECK(hd_tick_play(torture.state, mode, along, between(&torture.random, 0.0, 1.0)) == HD_OK);
        }
        CHECK(hd_state_copy(torture.still, torture.state) == HD_OK);
        if (kind != CHANGES)
            change(&torture, kind);
        still_world.table.ramp_step = 0.0;
        torture.state->event_count = torture.still->event_count = 0;
        hd_tick(&still_world, torture.still, &input, &still);
        hd_tick(torture.worlds[torture.front], torture.state, &input, &sample);
        hd_difference(sample.force_n, still.force_n, step);
        part = hypot(step[0], step[1]) / (LIMIT_N * torture.scene.table.ramp_step + ROUNDING_N);
        if (moving) {
            hd_difference(sample.force_n, before.force_n, step);
            part = fmin(part, hypot(step[0], step[1]) / (LIMIT_N * torture.scene.table.ramp_step + ROUNDING_N));
            if (kind != CHANGES && i > BEGIN && !has_own_ramp(torture.still))
                outcome->worst_moving = fmax(outcome->worst_moving, part);
        } else if (has_own_ramp(torture.still) || (kind != CHANGES && met_something(torture.still))) {
            outcome->met++;
        } else if (i > BEGIN) {
            if (part > 1.0 && part > outcome->worst)
                fprintf(stderr, "test_ramp: seed %llu, tick %llu, %s: %g of what is allowed\n",
                        (unsigned long long)seed, (unsigned long long)i, names[kind], part);
            outcome->worst = part > outcome->worst ? part : outcome->worst;
            outcome->worst_of[kind] = part > outcome->worst_of[kind] ? part : outcome->worst_of[kind];
        }
        before = sample;
        CHECK(isfinite(sample.force_n[0]) && hypot(sample.force_n[0], sample.force_n[1]) <= LIMIT_N);
        CHECK((sample.flags & HD_FLAG_FAULT) == 0);
        outcome->forceful += hypot(sample.force_n[0], sample.force_n[1]) > 0.1;
        outcome->saturated += (sample.flags & HD_FLAG_SATURATED) != 0;
        outcome->ringing += (sample.flags & HD_FLAG_RINGING) != 0;
        outcome->ramping += (sample.flags & HD_FLAG_RAMPING) != 0;
    }
    outcome->strikes += torture.state->strikes_total;
    close_torture(&torture);
}

/* The same without a reference: nothing vibrates, and the hand rests at the change and for some ticks after it. No two
 * commands in a row are farther apart than is allowed. */
static void rest(uint64_t seed, double rate_hz, uint64_t ticks, struct outcome *outcome) {
    struct torture torture = {.random = seed, .period_s = 1.0 / rate_hz, .quiet = 1};
    struct hd_input input = {.periods = 1};
    struct hd_sample before = {.tick = 0};
    uint64_t resting = 0;
    int acts[2] = {0, 0};

    open_torture(&torture);
    for (uint64_t i = 0; i < ticks; i++) {
        struct hd_sample sample;
        double step[2];
        double since_s;
        int cycles;

        if (resting > 0) {
            resting--;
        } else if (one_in(&torture.random, 100) && i > BEGIN) {
            const enum change kind = (enum change)test_below(&torture.random, CHANGES);

            resting = 1 + test_below(&torture.random, 300);
            outcome->changes++;
            change(&torture, kind);
        }
        if (resting == 0) {
            torture.time_s += torture.period_s;
            move(&torture, &input);
        }
        if (resting > 0 && one_in(&torture.random, 20))
            change(&torture, (enum change)test_below(&torture.random, CHANGES));
        input.interval_s = resting == 0 && i > 0 ? torture.period_s : 0.0;
        torture.state->event_count = 0;
        hd_tick(torture.worlds[torture.front], torture.state, &input, &sample);
        hd_difference(sample.force_n, before.force_n, step);
        since_s = (double)(torture.state->tick - torture.state->commanded_tick) * torture.period_s;
        /* Three solids that overlap may push the proxy from one to the other for ever. */
        cycles = since_s > torture.scene.table.ramp_s && met_something(torture.state);
        /* Nor is it a command's doing what the passivity controller does by itself. */
        acts[1] = acts[0];
        acts[0] = (sample.flags & HD_FLAG_RESTRAINED) != 0;
        cycles |= acts[0] || acts[1];
        outcome->met += resting > 0 && (cycles || has_own_ramp(torture.state));
        if (resting > 0 && !cycles && !has_own_ramp(torture.state)) {
            const double part = hypot(step[0], step[1]) / (LIMIT_N * torture.scene.table.ramp_step + ROUNDING_N);

            outcome->resting++;
            if (part > 1.0 && part > outcome->worst_resting)
                fprintf(stderr, "test_ramp: seed %llu, tick %llu, at rest: %g of what is allowed\n",
                        (unsigned long long)seed, (unsigned long long)i, part);
            outcome->worst_resting = part > outcome->worst_resting ? part : outcome->worst_resting;
        }
        before = sample;
    }
    close_torture(&torture);
}

/* What changes nothing that is felt is not felt: a scene that is sent again in every tick, and an object that comes,
 * moves and goes out of reach, leave every bit of the samples as it is; taps, ringing, ruptures and friction, too. */
static uint64_t unfelt(uint64_t seed, uint64_t ticks) {
    struct torture torture = {.random = seed, .period_s = 1e-4};
    struct hd_input input = {.periods = 1};
    struct hd_state *plain = hd_state_new(OBJECTS);
    const struct hd_world *first;
    uint64_t ringing = 0;

    open_torture(&torture);
    CHECK(plain != NULL && hd_state_reserve(plain, OBJECTS) == HD_OK);
    /* One surface: where solids overlap, which is met first may follow from the way that a command has the servo look.
     */
    for (uint32_t i = 0; i < OBJECTS; i++)
        make_object(&torture, i, i == 0 ? 1u + (uint32_t)(seed % 4) : HD_SHAPE_NONE);
    make_field(&torture);
    torture.scene.table.passivity = (uint32_t)(seed % 3);
    publish(&torture);
    first = torture.worlds[torture.front];
    struct hd_world *worlds[2] = {hd_world_new(), hd_world_new()};
    CHECK(worlds[0] != NULL && worlds[1] != NULL);
    for (uint64_t i = 0; i < ticks; i++) {
        struct hd_object *far = &torture.scene.objects[OBJECTS - 1];
        struct hd_sample sample;
        struct hd_sample other;
        double force[2][6];

        torture.scene.table.revision++;
        torture.scene.table.all_changed = 1;
        if (one_in(&torture.random, 3)) {
            *far = (struct hd_object){
                .generation = ++torture.stamp,
                .shape = i % 6 == 0 ? HD_SHAPE_NONE : HD_SHAPE_DISC,
                .normal = {0.0, 1.0},
                .point_m = {between(&torture.random, 2.0, 3.0), 0.0},
                .half_m = {0.01, 0.01},
            };
        }
        CHECK(hd_world_load(worlds[i % 2], &torture.scene.table) == HD_OK);
        torture.time_s += torture.period_s;
        move(&torture, &input);
        input.time_ns = (int64_t)(1e5 * (double)i);
        input.interval_s = i > 0 ? torture.period_s : 0.0;
        plain->event_count = torture.state->event_count = 0;
        hd_tick(first, plain, &input, &other);
        hd_tick(worlds[i % 2], torture.state, &input, &sample);
        const struct hd_sample *both[2] = {&sample, &other};
        for (size_t j = 0; j < 2; j++) {
            memcpy(force[j], both[j]->force_n, sizeof both[j]->force_n);
            memcpy(force[j] + 2, both[j]->contact_force_n, sizeof both[j]->contact_force_n);
            memcpy(force[j] + 4, both[j]->vibration_force_n, sizeof both[j]->vibration_force_n);
        }
        CHECK(memcmp(force[0], force[1], sizeof force[0]) == 0);
        ringing += (sample.flags & HD_FLAG_RINGING) != 0;
    }
    hd_state_free(plain);
    hd_world_free(worlds[0]);
    hd_world_free(worlds[1]);
    close_torture(&torture);
    return ringing;
}

int main(int argc, char **argv) {
    const uint64_t ticks = argc > 1 ? strtoull(argv[1], NULL, 10) : test_share(400000);
    const uint64_t changes = argc > 2 ? strtoull(argv[2], NULL, 10) : ticks / 100;
    const uint64_t seed = argc > 3 ? strtoull(argv[3], NULL, 10) : 1 + 1000 * test_run();
    struct outcome outcome = {.worst = 0.0};
    uint64_t still_ringing = 0;

    run(seed, 10000.0, ticks - ticks / 5, changes - changes / 5, 0, &outcome);
    run(seed + 1, 1000.0, ticks / 5, changes / 5, 0, &outcome);
    run(seed + 4, 10000.0, ticks / 4, changes, 1, &outcome);
    rest(seed + 2, 10000.0, ticks / 2, &outcome);
    rest(seed + 3, 1000.0, ticks / 8, &outcome);
    for (uint64_t i = 0; i < 12; i++)
        still_ringing += unfelt(seed + 10 + i, 20000);
    CHECK(still_ringing > 0);
    printf(
        "test_ramp: %llu ticks, %llu at rest, %llu changes, %llu strikes; %llu with a force, %llu at the limit, %llu "
        "ringing, %llu ramping, %llu left out; at most %.6f of what is allowed, at rest %.6f, moving %.6f\n",
        (unsigned long long)ticks, (unsigned long long)outcome.resting, (unsigned long long)outcome.changes,
        (unsigned long long)outcome.strikes, (unsigned long long)outcome.forceful,
        (unsigned long long)outcome.saturated, (unsigned long long)outcome.ringing, (unsigned long long)outcome.ramping,
        (unsigned long long)outcome.met, outcome.worst, outcome.worst_resting, outcome.worst_moving);
    if (argc > 1)
        for (int i = 0; i <= CHANGES; i++)
            printf("  %-16s %.6f\n", names[i], outcome.worst_of[i]);
    CHECK(outcome.worst <= 1.0 && outcome.worst_resting <= 1.0 && outcome.worst_moving <= MOVING);
    return 0;
}
