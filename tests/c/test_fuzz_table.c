/* Any bytes as tables and motion: a table is either refused with a reason, or every force that it renders is finite
 * and within its limit; a position that is no number leaves the force at zero for good.
 *
 * With HD_LIBFUZZER this is a libFuzzer target (`make fuzz`). Without, main runs seeded random cases of the same kind
 * and takes a first seed and a count, so that a failure can be repeated. Bytes choose values mostly from sensible
 * ranges, because uniformly random bits would all be refused at the first field. */
#include <math.h>
#include <string.h>

#include "hd_core.h"
#include "hd_test.h"

#define LARGEST_COUNT 3
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

/* Mostly between `low` and `high`; one in 128 is a number that tends to break things, one in 256 any bits. */
static double take_number(struct source *source, double low, double high) {
    static const double hostile[] = {
        0.0,     -0.0,     1.0,   -1.0,   5e-324,           -2e-308,           1e-30,      1e9, -1e9, 1e154,
        1.7e308, -1.7e308, 1e300, 1e-300, (double)INFINITY, -(double)INFINITY, (double)NAN};
    uint16_t choice;
    uint32_t fraction;
    double number;

    take(source, &choice, sizeof choice);
    if (choice < 256) {
        take(source, &number, sizeof number);
        return number;
    }
    if (choice < 768)
        return hostile[take_byte(source) % (sizeof hostile / sizeof hostile[0])];
    take(source, &fraction, sizeof fraction);
    return low + (high - low) * (double)fraction / 4294967295.0;
}

static uint32_t take_count(struct source *source, uint32_t limit) {
    uint8_t choice = take_byte(source);
    uint32_t count;

    if (choice > 2)
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
    default:
        break;
    }
}

static void take_surface(struct source *source, struct hd_surface *surface) {
    double angle = take_number(source, 0.0, 6.3);

    surface->point_m[0] = take_number(source, -0.02, 0.02);
    surface->point_m[1] = take_number(source, -0.02, 0.02);
    surface->normal[0] = cos(angle);
    surface->normal[1] = sin(angle);
    surface->stiffness_n_per_m = take_number(source, 0.0, 3000.0);
    surface->damping_n_s_per_m = take_number(source, 0.0, 20.0);
    surface->half_width_m = take_number(source, 0.0, 0.05);
    surface->rupture_depth_m = take_number(source, 0.0, 0.01);
}

static void take_key(struct source *source, uint32_t slot, struct hd_key *key) {
    uint8_t choice = take_byte(source);

    *key =
        (struct hd_key){.slot = slot, .generation = choice & 1u, .version = (choice >> 1) & 3u, .heals = choice >> 7};
    if ((choice & 0x78u) == 0x78u)
        take(source, &key->slot, sizeof key->slot);
}

struct scene {
    struct hd_table table;
    struct hd_wall walls[LARGEST_COUNT];
    struct hd_membrane membranes[LARGEST_COUNT];
};

static void take_scene(struct source *source, double period_s, struct scene *scene) {
    struct hd_table *table = &scene->table;
    uint8_t choice = take_byte(source);

    memset(scene, 0, sizeof *scene);
    table->revision = choice;
    table->wall_count = choice % (LARGEST_COUNT + 1);
    table->membrane_count = choice / 4 % (LARGEST_COUNT + 1);
    table->display_force = (choice & 16) == 0;
    table->display_vibration = (choice & 32) == 0;
    table->field_version = choice >> 6;
    table->period_s = take_number(source, period_s, period_s);
    table->max_force_n = take_number(source, 0.0, 20.0);
    table->max_speed_m_per_s = take_number(source, 1.0, 1000.0);
    table->ramp_s = take_number(source, 1e-4, 0.05);
    table->ramp_step = take_byte(source) != 0 ? table->period_s / table->ramp_s : take_number(source, 0.0, 1.0);
    table->field.force_n[0] = take_number(source, -1.0, 1.0);
    table->field.force_n[1] = take_number(source, -1.0, 1.0);
    table->field.stiffness_n_per_m = take_number(source, 0.0, 100.0);
    table->field.damping_n_s_per_m = take_number(source, 0.0, 5.0);
    for (uint32_t i = 0; i < LARGEST_COUNT; i++) {
        take_key(source, i, &scene->walls[i].key);
        take_surface(source, &scene->walls[i].surface);
        take_mode(source, period_s, &scene->walls[i].tap);
        take_key(source, LARGEST_COUNT + i, &scene->membranes[i].key);
        take_surface(source, &scene->membranes[i].surface);
        take_mode(source, period_s, &scene->membranes[i].tap);
        take_mode(source, period_s, &scene->membranes[i].rupture);
    }
    table->walls = scene->walls;
    table->membranes = scene->membranes;
    choice = take_byte(source);
    if (choice == 1)
        table->walls = NULL;
    if (choice == 2)
        table->membranes = NULL;
    if (choice == 3)
        table->display_force = take_byte(source);
    /* More objects than the state has room for must be refused before any of them is read. */
    if (choice == 4)
        table->wall_count = UINT32_MAX - take_byte(source);
    if (choice == 5)
        table->membrane_count = UINT32_MAX;
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

static void check_samples(const struct hd_table *table, const struct motion *motion, size_t count,
                          const struct hd_sample *samples, int *faulty) {
    for (size_t i = 0; i < count; i++) {
        const double *force = samples[i].force_n;

        CHECK(isfinite(force[0]) && isfinite(force[1]));
        CHECK(hypot(force[0], force[1]) <= table->max_force_n);
        *faulty |= !isfinite(motion->position[i][0]) || !isfinite(motion->position[i][1]);
        CHECK(!*faulty || (force[0] == 0.0 && force[1] == 0.0 && (samples[i].flags & HD_FLAG_FAULT) != 0));
        outcome.forceful += force[0] != 0.0 || force[1] != 0.0;
    }
}

static void check_events(const struct hd_event *events, size_t count) {
    for (size_t i = 0; i < count; i++) {
        CHECK(events[i].kind >= HD_EVENT_CONTACT && events[i].kind <= HD_EVENT_DEVICE_FOUND);
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
    struct hd_state *state = hd_state_new(2 * LARGEST_COUNT);
    int faulty = 0;

    CHECK(state != NULL);
    hd_state_set_resolution(state, (choice & 64) != 0 ? 20e-6 : 0.0);
    for (int run = 0; run < 3; run++) {
        struct scene scene;
        struct motion motion;
        struct hd_sample samples[TICKS];
        struct hd_event events[EVENTS];
        size_t event_count = 0;
        int status;

        take_scene(&source, period_s, &scene);
        take_motion(&source, period_s, &motion);
        memset(samples, 0, sizeof samples);
        status = hd_table_check(&scene.table, 2 * LARGEST_COUNT);
        if (status != HD_OK) {
            CHECK(status == HD_ERR_INVALID && hd_invalid_reason()[0] != '\0');
            outcome.refused++;
        }
        if (hd_render(&scene.table, state, motion.position[0], (choice & 128) != 0 ? motion.velocity[0] : NULL,
                      (choice & 32) != 0 ? motion.periods : NULL, TICKS, samples, events, EVENTS,
                      &event_count) == HD_OK) {
            CHECK(status == HD_OK);
            outcome.rendered++;
            outcome.events += event_count;
            check_samples(&scene.table, &motion, TICKS, samples, &faulty);
            check_events(events, event_count < EVENTS ? event_count : EVENTS);
        } else {
            /* A table that was refused, or a period count of 0 in the middle. */
            CHECK(status != HD_OK || (choice & 32) != 0);
            if (status == HD_OK)
                break;
        }
    }
    hd_state_free(state);
    return 0;
}

#ifndef HD_LIBFUZZER
int main(int argc, char **argv) {
    static uint8_t bytes[8192];
    uint64_t first = argc > 1 ? strtoull(argv[1], NULL, 10) : 0;
    uint64_t count = argc > 2 ? strtoull(argv[2], NULL, 10) : 10000;

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
    printf("test_fuzz_table: ok, %llu tables refused, %llu rendered, %llu ticks with a force, %llu events\n",
           (unsigned long long)outcome.refused, (unsigned long long)outcome.rendered,
           (unsigned long long)outcome.forceful, (unsigned long long)outcome.events);
    CHECK(argc > 2 || (outcome.refused > count / 10 && outcome.rendered > count / 10 && outcome.events > count));
    return 0;
}
#endif
