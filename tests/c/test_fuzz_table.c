/* Any bytes as tables and motion: a table is either refused with a reason, or every force that it renders is finite
 * and within its limit; a position that is no number leaves the force at zero for good. A world takes one table after
 * the other, whole or by lists of slots that need not be right.
 *
 * With HD_LIBFUZZER this is a libFuzzer target (`make fuzz`). Without, main runs seeded random cases of the same kind
 * and takes a first seed and a count, so that a failure can be repeated. Bytes choose values mostly from sensible
 * ranges, because uniformly random bits would all be refused at the first field. */
#include <math.h>
#include <string.h>

#include "api/hd_core.h"
#include "hd_test.h"
#include "scene/hd_world.h"

#define OBJECTS 6u
#define MATERIALS 4u
#define PIECES 8u
#define NOISES 2u
#define NUMBERS 96u
#define POINTS 3u
#define TUNED (2u + 2u + 4u + 2u * HD_TUNE_NODE)
#define WAVED 6u /* samples */
#define WAVE_FIRST (NUMBERS + 2u * POINTS + TUNED)
/* of the noises, then of a tap, then of a groove's frequencies, then of a waveform */
#define ALL_NUMBERS (WAVE_FIRST + WAVED + HD_WAVE_PARTS)
#define TICKS 48
#define EVENTS 64

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

struct source {
    const uint8_t *data;
    size_t left;
};

struct outcome {
    uint64_t refused;
    uint64_t rendered;
    uint64_t forceful; /* ticks with a force */
    uint64_t events;
};

static struct outcome outcome;

/* Nothing is left: zeros. */
static void take(struct source *source, void *to, size_t size) {
    size_t count = size < source->left ? size : source->left;

    memset(to, 0, size);
    if (count > 0)
        memcpy(to, source->data, count);
    source->data += count;
    source->left -= count;
}

static uint8_t take_byte(struct source *source) {
    uint8_t byte;

    take(source, &byte, 1);
    return byte;
}

/* Mostly between `low` and `high`; one in 1024 is a number that tends to break things, one in 4096 any bits. */
static double take_number(struct source *source, double low, double high) {
    static const double hostile[] = {
        0.0,     -0.0,     1.0,   -1.0,   5e-324,           -2e-308,           1e-30,      1e9, -1e9, 1e154,
        1.7e308, -1.7e308, 1e300, 1e-300, (double)INFINITY, -(double)INFINITY, (double)NAN};
    uint16_t choice;
    uint32_t fraction;
    double number;

    take(source, &choice, sizeof choice);
    if (choice < 16) {
        take(source, &number, sizeof number);
        return number;
    }
    if (choice < 80)
        return hostile[take_byte(source) % (sizeof hostile / sizeof hostile[0])];
    take(source, &fraction, sizeof fraction);
    return low + (high - low) * (double)fraction / 4294967295.0;
}

static uint32_t take_count(struct source *source, uint32_t limit) {
    uint8_t choice = take_byte(source);
    uint32_t count;

    if (choice > 0)
        return choice % limit;
    take(source, &count, sizeof count);
    return count;
}

/* Consistent with itself unless one of its numbers is hostile. */
static void take_mode(struct source *source, double period_s, struct hd_mode *mode) {
    double b = take_number(source, 0.0, 2000.0);
    double w = take_number(source, 0.0, 4.0 / period_s);
    double scale = take_number(source, 0.0, 20.0);

    *mode = (struct hd_mode){
        .rotor_re = exp(-b * period_s) * cos(w * period_s),
        .rotor_im = exp(-b * period_s) * sin(w * period_s),
        .decay_rate_per_s = b,
        .angular_frequency_rad_per_s = w,
        .end_s = take_number(source, 0.0, 0.02),
        .peak = take_number(source, 0.0, 1.0),
        .peak_time_s = take_number(source, 0.0, 0.01),
        .amplitude_per_unit = scale * 20.0,
        .force_per_unit = scale,
        .gain_re = 1.0,
    };
    switch (take_byte(source)) {
    case 0:
        mode->rotor_re = take_number(source, -1.0, 1.0);
        break;
    case 1:
        mode->rotor_im = take_number(source, -1.0, 1.0);
        break;
    case 2:
        mode->force_per_unit = take_number(source, -1.0, 1e9);
        break;
    case 3:
        *mode = (struct hd_mode){0};
        break;
    case 4:
        mode->gain_re = take_number(source, -2.0, 2.0);
        mode->gain_im = take_number(source, -2.0, 2.0);
        mode->tail_rotor_re = mode->rotor_re;
        mode->tail_rotor_im = take_number(source, -1.0, 1.0);
        mode->tail_decay_rate_per_s = b;
        mode->tail_angular_frequency_rad_per_s = take_number(source, 0.0, 1000.0);
        mode->tail_end_s = take_number(source, 0.0, 0.05);
        mode->tail_re = take_number(source, -2.0, 2.0);
        mode->tail_im = take_number(source, -2.0, 2.0);
        break;
    default:
        break;
    }
}

struct scene {
    struct hd_table table;
    struct hd_object objects[OBJECTS];
    struct hd_material materials[MATERIALS];
    struct hd_piece pieces[PIECES];
    struct hd_noise noises[NOISES];
    double numbers[ALL_NUMBERS];
    uint32_t changed[OBJECTS];
};

static void take_material(struct source *source, double period_s, struct hd_material *material) {
    static const double aims[4][2] = {{0.0, 0.0}, {0.0, 1.0}, {0.6, -0.8}, {1.0, 0.0}};
    uint8_t choice = take_byte(source);
    uint8_t aim = take_byte(source);

    *material = (struct hd_material){
        .tap_aim = {aims[aim % 4][0], aims[aim % 4][1]},
        .rupture_aim = {aims[aim / 4 % 4][0], aim == 255 ? 2.0 : aims[aim / 4 % 4][1]},
        .texture = choice % 64 < 63 ? choice % 5 : take_count(source, 6),
        .noise = take_count(source, NOISES),
        .heals = choice >> 7,
        .tap_count = choice % 8 < 3 ? take_count(source, POINTS + 1) : 0,
        .tap_first = choice % 16 != 2 ? NUMBERS : take_count(source, ALL_NUMBERS),
        .stiffness_n_per_m = take_number(source, 0.0, 3000.0),
        .damping_n_s_per_m = take_number(source, 0.0, 20.0),
        .rupture_depth_m = take_number(source, 0.0, 0.01),
        .friction_coefficient = (choice & 64) != 0 ? take_number(source, 0.0, 2.0) : 0.0,
        .friction_stiffness_n_per_m = take_number(source, 1.0, 2000.0),
        .spacing_m = take_number(source, 0.0005, 0.006),
        .depth_m = take_number(source, 0.0, 0.002),
        .drag_n_s_per_m = take_number(source, 0.0, 20.0),
        .velocity_gain_per_s = take_number(source, 0.0, 2000.0),
        .force_gain_m_per_s2_per_n = take_number(source, 0.0, 100.0),
    };
    material->width_m = take_number(source, 0.0, 1.0) * material->spacing_m;
    if (choice % 16 == 1) {
        material->tune_speeds = material->tune_forces = 2;
        material->tune_nodes = take_count(source, 3);
        material->tune_first = NUMBERS + 2u * POINTS;
        material->tune_mutes = take_count(source, 2);
        material->tune_highest_rad_per_s = take_number(source, 1.0, 200.0);
    }
    if (choice % 16 == 3) {
        material->mode_count = 2;
        material->mode_nodes = take_count(source, 3);
        material->mode_first = NUMBERS + 2u * POINTS;
        material->mode_by_peak = take_count(source, 2);
        material->tune_mutes = take_count(source, 2);
        material->tune_highest_rad_per_s = take_number(source, 1.0, 200.0);
    }
    if (choice % 16 >= 13) {
        material->wave_count = choice % 16 == 13 ? take_count(source, WAVED + 2u) : WAVED;
        material->wave_first = choice % 16 == 14 ? take_count(source, ALL_NUMBERS) : WAVE_FIRST;
        material->wave_rate_hz = take_number(source, 100.0, 20000.0);
    }
    take_mode(source, period_s, &material->tap);
    take_mode(source, period_s, &material->rupture);
    take_mode(source, period_s, &material->groove);
    if ((choice & 32) != 0)
        take_mode(source, period_s, &material->second);
}

/* Rising, with ramps that fit, unless a number is hostile. */
static void take_pieces(struct source *source, struct hd_piece pieces[PIECES]) {
    double from = -0.02;

    for (uint32_t i = 0; i < PIECES; i++) {
        double half = take_number(source, 1e-5, 0.002);

        from += half * 2.0 + take_number(source, 0.0, 0.01);
        pieces[i] = (struct hd_piece){.from_m = from - half, .half_ramp_m = half, .material = take_count(source, 4)};
    }
}

/* Axes from 0 up, then nodes whose reflection coefficients and taps are right, unless a number is hostile. */
static void take_noise(struct source *source, uint32_t first, double *numbers, struct hd_noise *noise) {
    uint8_t choice = take_byte(source);
    uint32_t at = first;

    *noise = (struct hd_noise){
        .order = choice % 8 == 7 ? take_count(source, HD_NOISE_ORDER + 2) : choice % 4,
        .taps = (choice >> 3) & 1u,
        .along_normal = (choice >> 4) & 1u,
        .speed_count = 1 + ((choice >> 5) & 1u),
        .force_count = 1 + ((choice >> 6) & 1u),
        .first = choice == 0xff ? take_count(source, NUMBERS) : first,
        .seed = choice,
        .threshold_m_per_s = take_number(source, 0.0, 0.01),
        .velocity_gain_per_s = take_number(source, -10.0, 100.0),
        .force_gain_m_per_s2_per_n = take_number(source, -10.0, 20.0),
        .force_per_unit = take_number(source, 0.0, 0.2),
    };
    for (uint32_t i = 0; i < noise->speed_count; i++)
        numbers[at++] = i == 0 ? 0.0 : take_number(source, 0.01, 1.0);
    for (uint32_t i = 0; i < noise->force_count; i++)
        numbers[at++] = i == 0 ? 0.0 : take_number(source, 0.01, 5.0);
    for (uint32_t node = 0; node < noise->speed_count * noise->force_count && noise->order < 4; node++) {
        double squares = 0.0;
        uint32_t taps;

        numbers[at++] = take_number(source, 0.0, 20.0);
        for (uint32_t i = 0; i < noise->order; i++)
            numbers[at++] = take_number(source, -0.999, 0.999);
        taps = at;
        for (uint32_t i = 0; noise->taps && i <= noise->order; i++) {
            numbers[at] = take_number(source, -1.0, 1.0);
            squares += numbers[at] * numbers[at];
            at++;
        }
        for (; taps < at; taps++)
            numbers[taps] /= sqrt(squares);
    }
}

static void take_object(struct source *source, struct hd_object *object) {
    double angle = take_number(source, 0.0, 6.3);
    uint8_t choice = take_byte(source);
    uint8_t versions = take_byte(source);

    *object = (struct hd_object){
        .generation = versions & 1u,
        .pose_version = (versions >> 1) & 3u,
        .surface_version = (versions >> 3) & 3u,
        .shape = choice < 250 ? choice % 5u : take_count(source, 6),
        .material = take_count(source, MATERIALS),
        .point_m = {take_number(source, -0.02, 0.02), take_number(source, -0.02, 0.02)},
        .normal = {cos(angle), sin(angle)},
    };
    if (object->shape == HD_SHAPE_WALL && (versions & 0x80u) != 0) {
        object->piece_first = take_count(source, 4);
        object->piece_count = take_count(source, 5);
    }
    if (object->shape >= HD_SHAPE_MEMBRANE || choice == 249)
        object->half_m[0] = take_number(source, 1e-4, 0.02);
    if (object->shape == HD_SHAPE_BOX || choice == 248)
        object->half_m[1] = take_number(source, 1e-4, 0.02);
    if (object->shape == HD_SHAPE_DISC && choice != 247)
        object->half_m[1] = object->half_m[0];
}

static void take_scene(struct source *source, double period_s, uint32_t run, struct scene *scene) {
    struct hd_table *table = &scene->table;
    uint8_t choice = take_byte(source);

    memset(scene, 0, sizeof *scene);
    *table = (struct hd_table){
        .revision = choice,
        .object_count = take_byte(source) % (OBJECTS + 1),
        .material_count = MATERIALS,
        .piece_count = PIECES,
        .noise_count = NOISES,
        .number_count = ALL_NUMBERS,
        .display_force = (choice & 16) == 0,
        .display_vibration = (choice & 32) == 0,
        .passivity = choice % 3,
        .report_age = choice % 7,
        .field_version = choice >> 6,
        .parts_version = (choice & 1) != 0 ? run : 0,
        .period_s = take_number(source, period_s, period_s),
        .max_force_n = take_number(source, 0.0, 20.0),
        .max_speed_m_per_s = take_number(source, 1.0, 1000.0),
        .ramp_s = take_number(source, 1e-4, 0.05),
        .objects = scene->objects,
        .materials = scene->materials,
        .pieces = scene->pieces,
        .noises = scene->noises,
        .numbers = scene->numbers,
    };
    table->ramp_step = take_byte(source) != 0 ? table->period_s / table->ramp_s : take_number(source, 0.0, 1.0);
    table->brake_n_s_per_m = take_number(source, 0.0, 100.0);
    table->handle_damping_n_s_per_m = take_number(source, 0.0, 1.0);
    table->handle_friction_n = take_number(source, 0.0, 0.1);
    table->field.force_n[0] = take_number(source, -1.0, 1.0);
    table->field.force_n[1] = take_number(source, -1.0, 1.0);
    table->field.stiffness_n_per_m = take_number(source, 0.0, 100.0);
    table->field.damping_n_s_per_m = take_number(source, 0.0, 5.0);
    for (uint32_t i = 0; i < OBJECTS; i++)
        take_object(source, &scene->objects[i]);
    for (uint32_t i = 0; i < MATERIALS; i++)
        take_material(source, period_s, &scene->materials[i]);
    take_pieces(source, scene->pieces);
    for (uint32_t i = 0; i < NOISES; i++)
        take_noise(source, i * (NUMBERS / NOISES), scene->numbers, &scene->noises[i]);
    for (uint32_t i = 0; i < 2u * POINTS + TUNED; i++)
        scene->numbers[NUMBERS + i] = take_number(source, 0.0, 0.5) + i;
    for (uint32_t i = 1; i < WAVED + HD_WAVE_PARTS; i++) /* the first and the last sample are 0 */
        scene->numbers[WAVE_FIRST + i] = i == WAVED - 1u ? 0.0 : take_number(source, i < WAVED ? -2.0 : 0.0, 2.0);
    for (uint32_t i = 0; i < OBJECTS; i++)
        scene->changed[i] = take_count(source, OBJECTS + 1);
    switch (take_byte(source)) {
    case 1:
        table->objects = NULL;
        break;
    case 2:
        table->materials = NULL;
        break;
    case 3:
        table->pieces = NULL;
        break;
    case 4:
        table->noises = NULL;
        break;
    case 5:
        table->numbers = NULL;
        break;
    case 6:
        table->display_force = take_byte(source);
        break;
    case 7:
        table->material_count = take_byte(source) % MATERIALS;
        break;
    case 8:
        table->piece_count = take_byte(source) % PIECES;
        break;
    case 9:
        table->noise_count = take_byte(source) % NOISES;
        break;
    case 10:
        table->number_count = take_byte(source) % NUMBERS;
        break;
    case 11:
        table->passivity = take_byte(source);
        break;
    case 12:
        table->report_age = take_count(source, UINT32_MAX);
        break;
    default:
        break;
    }
}

struct motion {
    double position[TICKS][2];
    double velocity[TICKS][2];
    uint32_t periods[TICKS];
};

static void take_motion(struct source *source, double period_s, struct motion *motion) {
    double at[2] = {take_number(source, -0.02, 0.02), take_number(source, -0.02, 0.02)};

    for (size_t i = 0; i < TICKS; i++) {
        for (size_t axis = 0; axis < 2; axis++) {
            double step = take_number(source, -0.002, 0.002);

            motion->position[i][axis] = at[axis] + step;
            motion->velocity[i][axis] = take_number(source, -step / period_s, step / period_s);
            /* What is no number passes by, so that the ticks after it are tested too. */
            if (isfinite(motion->position[i][axis]))
                at[axis] = motion->position[i][axis];
        }
        motion->periods[i] = take_count(source, 2) + (take_byte(source) != 0);
    }
}

static void check_samples(double max_force_n, const struct motion *motion, const struct hd_sample *samples,
                          int *faulty) {
    for (size_t i = 0; i < TICKS; i++) {
        const double *force = samples[i].force_n;

        CHECK(isfinite(force[0]) && isfinite(force[1]));
        CHECK(hypot(force[0], force[1]) <= max_force_n);
        *faulty |= !isfinite(motion->position[i][0]) || !isfinite(motion->position[i][1]);
        CHECK(!*faulty || (force[0] == 0.0 && force[1] == 0.0 && (samples[i].flags & HD_FLAG_FAULT) != 0));
        outcome.forceful += force[0] != 0.0 || force[1] != 0.0;
    }
}

static void check_events(const struct hd_event *events, size_t count) {
    for (size_t i = 0; i < count; i++) {
        CHECK(events[i].kind >= HD_EVENT_CONTACT && events[i].kind <= HD_EVENT_MEMORY_REFUSED);
        CHECK(events[i].scale >= 0.0 && events[i].scale <= 1.0);
        CHECK(events[i].before_tick_s >= 0.0 && isfinite(events[i].before_tick_s));
    }
}

/* Several tables over one state, as a daemon's hot updates are. */
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static const double rates_hz[] = {1000.0, 4000.0, 10000.0, 20000.0, 50.0};
    struct source source = {.data = data, .left = size};
    uint8_t choice = take_byte(&source);
    double period_s = 1.0 / rates_hz[choice % 5];
    struct hd_state *state = hd_state_new(OBJECTS);
    struct hd_world *world = hd_world_new();
    int faulty = 0;
    int loaded = 0;

    CHECK(state != NULL && world != NULL);
    hd_state_set_resolution(state, (choice & 64) != 0 ? 20e-6 : 0.0);
    for (uint32_t run = 0; run < 4; run++) {
        struct scene scene;
        struct motion motion;
        struct hd_sample samples[TICKS];
        struct hd_event events[EVENTS];
        size_t event_count = 0;
        int status;

        take_scene(&source, period_s, run, &scene);
        take_motion(&source, period_s, &motion);
        memset(samples, 0, sizeof samples);
        status = (choice & 16) != 0 ? hd_world_update(world, &scene.table, scene.changed, run + 1)
                                    : hd_world_load(world, &scene.table);
        if (status != HD_OK) {
            CHECK(status == HD_ERR_INVALID && hd_invalid_reason()[0] != '\0');
            outcome.refused++;
        }
        /* Where a table was refused, the world goes on with the one before. */
        loaded |= status == HD_OK;
        status = hd_render(world, state, motion.position[0], (choice & 128) != 0 ? motion.velocity[0] : NULL,
                           (choice & 32) != 0 ? motion.periods : NULL, TICKS, samples, events, EVENTS, &event_count);
        if (status == HD_OK) {
            CHECK(loaded);
            outcome.rendered++;
            outcome.events += event_count;
            check_samples(world->table.max_force_n, &motion, samples, &faulty);
            check_events(events, event_count < EVENTS ? event_count : EVENTS);
        } else {
            /* No table yet, or a period count of 0 in the middle. */
            CHECK(!loaded || (choice & 32) != 0);
            if (loaded)
                break;
        }
    }
    hd_world_free(world);
    hd_state_free(state);
    return 0;
}

#ifndef HD_LIBFUZZER
int main(int argc, char **argv) {
    static uint8_t bytes[8192];
    uint64_t first = argc > 1 ? strtoull(argv[1], NULL, 10) : test_run() * 10000;
    uint64_t count = argc > 2 ? strtoull(argv[2], NULL, 10) : test_share(10000);

    for (uint64_t i = first; i < first + count; i++) {
        uint64_t seed = i;
        size_t size = test_below(&seed, 4) == 0 ? test_below(&seed, sizeof bytes) : sizeof bytes;

        for (size_t at = 0; at < size; at++)
            bytes[at] = (uint8_t)test_random(&seed);
        /* Said before each case, so that the last line before an abort names the seed. */
        if (argc > 2) {
            fprintf(stderr, "seed %llu\n", (unsigned long long)i);
        }
        LLVMFuzzerTestOneInput(bytes, size);
    }
    printf("test_fuzz_table: ok, %llu tables refused, %llu runs, %llu ticks with a force, %llu events\n",
           (unsigned long long)outcome.refused, (unsigned long long)outcome.rendered,
           (unsigned long long)outcome.forceful, (unsigned long long)outcome.events);
    CHECK(argc > 2 || test_run() > 0 ||
          (outcome.refused > count / 10 && outcome.rendered > count / 10 && outcome.events > count));
    return 0;
}
#endif
