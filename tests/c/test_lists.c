/* The lists of a state over random scenes that change under the hand: every slot, noise and mode is where its list
 * says, once; what is freed is free. Besides: forces are finite and within the limit, and none is left once all is
 * gone.
 *
 * test_lists FIRST COUNT runs other seeds. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/hd_vector.h"
#include "hd_test.h"
#include "tick/hd_tick.h"

#define OBJECTS 24u
#define MATERIALS 6u
#define NOISES 2u
#define NUMBERS 16u
#define PIECES 6u
#define UPDATES 60
#define PERIOD_S 1e-4

static uint64_t seed;
static unsigned long long ticks, contacts, punctures, grooves, sounding;

static double uniform(double low, double high) {
    return low + (high - low) * (double)(test_random(&seed) >> 11) * 0x1p-53;
}

static uint32_t below(uint32_t limit) {
    return (uint32_t)test_below(&seed, limit);
}

struct scene {
    struct hd_table table;
    struct hd_object objects[OBJECTS];
    struct hd_material materials[MATERIALS];
    struct hd_piece pieces[PIECES];
    struct hd_noise noises[NOISES];
    double numbers[NUMBERS];
};

static struct hd_mode make_mode(void) {
    double b = uniform(100.0, 2000.0);
    double w = uniform(200.0, 6000.0);

    return (struct hd_mode){.rotor_re = exp(-b * PERIOD_S) * cos(w * PERIOD_S),
                            .rotor_im = exp(-b * PERIOD_S) * sin(w * PERIOD_S),
                            .decay_rate_per_s = b,
                            .angular_frequency_rad_per_s = w,
                            .end_s = 5.0 / b,
                            .peak = 0.5,
                            .peak_time_s = 1e-4,
                            .amplitude_per_unit = 300.0,
                            .force_per_unit = uniform(0.0, 3.0),
                            .gain_re = 1.0};
}

static void make_material(struct hd_material *material) {
    *material = (struct hd_material){
        .texture = below(5),
        .noise = below(NOISES),
        .heals = below(2),
        .stiffness_n_per_m = uniform(50.0, 2000.0),
        .damping_n_s_per_m = below(3) == 0 ? uniform(0.0, 3.0) : 0.0,
        .rupture_depth_m = below(2) ? uniform(1e-4, 2e-3) : 0.0,
        .friction_coefficient = below(2) ? uniform(0.0, 1.0) : 0.0,
        .friction_stiffness_n_per_m = uniform(50.0, 1000.0),
        .spacing_m = uniform(1e-4, 2e-3),
        .depth_m = uniform(0.0, 2e-4),
        .drag_n_s_per_m = uniform(0.0, 2.0),
        .velocity_gain_per_s = uniform(0.0, 1000.0),
        .force_gain_m_per_s2_per_n = uniform(0.0, 60.0),
        .tap = make_mode(),
        .rupture = make_mode(),
        .groove = make_mode(),
    };
    material->width_m = 0.5 * material->spacing_m;
}

static void make_place(struct hd_object *object) {
    double turn = below(2) ? uniform(0.0, 6.3) : 1.5707963267948966 * below(4);

    object->point_m[0] = uniform(-0.01, 0.01);
    object->point_m[1] = uniform(-0.01, 0.01);
    object->normal[0] = cos(turn);
    object->normal[1] = sin(turn);
    object->half_m[0] = object->half_m[1] = 0.0;
    if (object->shape != HD_SHAPE_WALL)
        object->half_m[0] = below(8) == 0 ? 1e-9 : uniform(1e-4, 8e-3);
    if (object->shape == HD_SHAPE_BOX)
        object->half_m[1] = below(8) == 0 ? 1e-9 : uniform(1e-4, 8e-3);
    if (object->shape == HD_SHAPE_DISC)
        object->half_m[0] = object->half_m[1] = uniform(1e-4, 8e-3);
}

/* What an update does to one slot; `stamp` was never used before. */
static void change(struct hd_object *object, uint32_t stamp) {
    switch (object->shape == HD_SHAPE_NONE ? 0 : below(4)) {
    case 0: /* another object, or none */
        *object = (struct hd_object){.generation = stamp, .pose_version = stamp, .surface_version = stamp};
        object->shape = below(6) == 0 ? HD_SHAPE_NONE : 1 + below(4);
        object->material = below(MATERIALS);
        if (object->shape == HD_SHAPE_WALL && below(2))
            object->piece_count = 2 + below(PIECES - 1);
        make_place(object);
        break;
    case 1:
        object->pose_version = stamp;
        object->point_m[0] += uniform(-1e-3, 1e-3);
        object->point_m[1] += uniform(-1e-3, 1e-3);
        break;
    case 2:
        object->pose_version = stamp;
        make_place(object);
        break;
    default:
        object->surface_version = stamp;
        object->material = below(MATERIALS);
        break;
    }
}

static void make_parts(struct scene *scene, uint32_t stamp) {
    double from = -0.01;

    for (uint32_t i = 0; i < MATERIALS; i++)
        make_material(&scene->materials[i]);
    for (uint32_t i = 0; i < PIECES; i++) {
        from += uniform(1e-3, 5e-3);
        scene->pieces[i] = (struct hd_piece){.from_m = from, .half_ramp_m = 2e-4, .material = below(MATERIALS)};
    }
    for (uint32_t i = 0; i < NOISES; i++) {
        double *numbers = &scene->numbers[i * (NUMBERS / NOISES)];

        scene->noises[i] = (struct hd_noise){.order = below(3),
                                             .along_normal = below(2),
                                             .speed_count = 1,
                                             .force_count = 1,
                                             .first = i * (NUMBERS / NOISES),
                                             .version = stamp,
                                             .seed = stamp,
                                             .threshold_m_per_s = 0.001,
                                             .velocity_gain_per_s = uniform(0.0, 50.0),
                                             .force_per_unit = 0.05};
        numbers[0] = numbers[1] = 0.0;
        for (uint32_t k = 2; k < NUMBERS / NOISES; k++)
            numbers[k] = uniform(-0.9, 0.9) * (k > 2);
    }
    for (uint32_t i = 0; i < OBJECTS; i++)
        scene->objects[i].surface_version = stamp;
}

static void check_state(const struct hd_state *state, const struct hd_sample *sample, double max_force_n) {
    uint8_t taken[HD_NOISE_CAPACITY] = {0};
    uint32_t touched = 0, healing = 0, noises = 0;

    for (uint32_t i = 0; i < OBJECTS; i++) {
        const struct hd_slot *slot = &state->slots[i];

        touched += slot->touched;
        healing += slot->healing_index != 0;
        CHECK(!slot->touched || (slot->active_index < state->active_count && state->active[slot->active_index] == i));
        CHECK(slot->healing_index == 0 ||
              (slot->healing_index <= state->healing_count && state->healing[slot->healing_index - 1] == i));
        CHECK(!slot->resume);
        if (slot->noise != 0) {
            CHECK(slot->touched && slot->noise <= HD_NOISE_CAPACITY && !taken[slot->noise - 1]);
            taken[slot->noise - 1] = 1;
            noises++;
        }
        for (uint32_t use = 0; use < HD_MODE_USES; use++) {
            uint32_t at = slot->mode[use];

            CHECK(at <= state->active_mode_count);
            CHECK(at == 0 || (state->active_modes[at - 1].slot == i && state->active_modes[at - 1].use == use &&
                              state->active_modes[at - 1].generation == slot->generation));
        }
        if (slot->touched) {
            double square = hd_dot(slot->last.normal, slot->last.normal);

            CHECK(square > 0.999 && square < 1.001);
            CHECK(slot->changed == 0 && slot->ramp >= 0.0 && slot->ramp <= 1.0);
        }
    }
    CHECK(touched == state->active_count && healing == state->healing_count && state->resumed_count == 0);
    CHECK(noises + state->free_noise_count == HD_NOISE_CAPACITY);
    for (uint32_t i = 0; i < state->free_noise_count; i++) {
        CHECK(state->free_noises[i] < HD_NOISE_CAPACITY && !taken[state->free_noises[i]]);
        taken[state->free_noises[i]] = 1;
    }
    CHECK(state->strike_count == 0);
    CHECK(isfinite(sample->force_n[0]) && isfinite(sample->force_n[1]));
    CHECK(hypot(sample->force_n[0], sample->force_n[1]) <= max_force_n);
    CHECK((sample->flags & HD_FLAG_FAULT) != 0 || ((sample->flags & HD_FLAG_CONTACT) != 0) == (touched > 0));
    sounding += noises > 0;
}

static struct hd_sample tick(const struct hd_world *world, struct hd_state *state, const double position[2],
                             uint32_t periods) {
    struct hd_sample sample;
    struct hd_input input = {.periods = periods, .time_ns = (int64_t)state->tick * 100000};
    struct hd_reading reading = {.position_m = {position[0], position[1]},
                                 .interval_s = state->located ? periods * PERIOD_S : 0.0,
                                 .true_velocity_m_per_s = {(double)NAN, (double)NAN}};

    hd_sense(state, &world->table, &reading, NULL, &input);
    hd_tick(world, state, &input, &sample);
    for (uint32_t i = 0; i < state->event_count; i++) {
        contacts += state->events[i].kind == HD_EVENT_CONTACT;
        punctures += state->events[i].kind == HD_EVENT_PUNCTURE;
        grooves += state->events[i].kind == HD_EVENT_GROOVE;
    }
    state->event_count = 0;
    ticks++;
    check_state(state, &sample, world->table.max_force_n);
    return sample;
}

/* What a person, a device or a scheduler may do between two ticks. */
static void disturb(struct hd_state *state, double position[2], uint32_t *periods) {
    struct hd_mode mode;
    double direction[2] = {1.0, 0.0};
    uint32_t slot;

    *periods = 1;
    switch (below(400)) {
    case 0:
        hd_tick_reset(state, HD_NO_SLOT, 0, 0);
        break;
    case 1:
    case 2:
        slot = below(OBJECTS);
        hd_tick_reset(state, slot, state->slots[slot].generation, 0);
        break;
    case 3:
        *periods = 201 + below(100);
        break;
    case 4:
    case 5:
        *periods = 2 + below(100);
        break;
    case 6:
        position[0] = uniform(-0.01, 0.01);
        position[1] = uniform(-0.01, 0.01);
        break;
    case 7:
        hd_state_enable(state, (int)below(2));
        break;
    case 8:
        mode = make_mode();
        hd_tick_play(state, &mode, direction, 0.1);
        break;
    default:
        break;
    }
}

static void run(void) {
    static struct scene scene;
    struct hd_state *state = hd_state_new(OBJECTS);
    struct hd_world *world = hd_world_new();
    double position[2] = {0.0, 0.0}, velocity[2] = {0.0, 0.0};
    uint32_t stamp = 1;

    CHECK(state != NULL && world != NULL && hd_state_reserve(state, OBJECTS) == HD_OK);
    memset(&scene, 0, sizeof scene);
    scene.table = (struct hd_table){.object_count = OBJECTS,
                                    .material_count = MATERIALS,
                                    .piece_count = PIECES,
                                    .noise_count = NOISES,
                                    .number_count = NUMBERS,
                                    .display_force = 1,
                                    .display_vibration = 1,
                                    .period_s = PERIOD_S,
                                    .max_force_n = 8.9,
                                    .max_speed_m_per_s = 5.0,
                                    .ramp_s = 0.02,
                                    .ramp_step = PERIOD_S / 0.02,
                                    .objects = scene.objects,
                                    .materials = scene.materials,
                                    .pieces = scene.pieces,
                                    .noises = scene.noises,
                                    .numbers = scene.numbers};
    for (int update = 0; update < UPDATES; update++) {
        double speed = below(4) == 0 ? 3.0 : 0.2;
        uint32_t many = update == 0 ? OBJECTS : below(8) == 0 ? OBJECTS : below(3);

        if (update == 0 || below(8) == 0) {
            make_parts(&scene, stamp);
            scene.table.parts_version = stamp++;
        }
        for (uint32_t i = 0; i < many; i++) {
            struct hd_object *object = &scene.objects[many == OBJECTS ? i : below(OBJECTS)];

            if (many < OBJECTS || update == 0 || below(2))
                change(object, stamp++);
        }
        scene.table.display_vibration = below(10) != 0;
        scene.table.display_force = below(10) != 0;
        scene.table.passivity = below(3);
        scene.table.report_age = below(4);
        scene.table.revision++;
        CHECK(hd_world_load(world, &scene.table) == HD_OK);
        for (uint32_t left = 1 + below(200), first = 1; left > 0; left--, first = 0) {
            uint32_t periods;
            struct hd_sample sample;

            for (size_t axis = 0; axis < 2; axis++) {
                velocity[axis] = 0.99 * velocity[axis] + uniform(-0.1, 0.1) * speed - 0.5 * position[axis];
                position[axis] += velocity[axis] * PERIOD_S;
            }
            disturb(state, position, &periods);
            if (first && below(2))
                periods = 300; /* a stall, and another table with it */
            sample = tick(world, state, position, periods);
            if (below(2000) == 0) {
                double nowhere[2] = {(double)NAN, position[1]};

                sample = tick(world, state, nowhere, 1);
                CHECK(sample.force_n[0] == 0.0 && sample.force_n[1] == 0.0);
            }
            if ((sample.flags & HD_FLAG_FAULT) != 0 && below(20) == 0)
                hd_state_clear_faults(state, 0, 0);
        }
    }
    for (uint32_t i = 0; i < OBJECTS; i++)
        scene.objects[i] = (struct hd_object){.generation = stamp};
    scene.table.revision++;
    CHECK(hd_world_load(world, &scene.table) == HD_OK);
    /* With the passivity controller two forces fade, each perhaps many times the limit: that takes longer, and ends. */
    for (int i = 0; i < 1000 || state->residual.remaining > 0; i++) {
        CHECK(i < 10000);
        tick(world, state, position, 1);
    }
    CHECK(state->active_count == 0 && state->healing_count == 0 && state->active_mode_count == 0);
    CHECK(state->free_noise_count == HD_NOISE_CAPACITY);
    hd_world_free(world);
    hd_state_free(state);
}

int main(int argc, char **argv) {
    uint64_t first = argc > 1 ? strtoull(argv[1], NULL, 10) : test_run() * 60;
    uint64_t count = argc > 2 ? strtoull(argv[2], NULL, 10) : test_share(60);

    for (uint64_t i = first; i < first + count; i++) {
        seed = i;
        if (argc > 2)
            fprintf(stderr, "seed %llu\n", (unsigned long long)i);
        run();
    }
    printf("test_lists: ok, %llu ticks, %llu contacts, %llu punctures, %llu grooves\n", ticks, contacts, punctures,
           grooves);
    CHECK(contacts < ticks / 5); /* nothing is met and let go again and again */
    CHECK(argc > 2 || test_run() > 0 || (contacts > 1000 && punctures > 10 && grooves > 1000 && sounding > 1000));
    return 0;
}
