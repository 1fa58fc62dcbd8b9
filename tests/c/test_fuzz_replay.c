/* Any bytes as a recording and as what was played and reset while it was made, over a scene that is sound: a run is
 * refused with a reason, or every force is finite and within the limit, and a position that is no number leaves the
 * force at zero for good.
 *
 * With HD_LIBFUZZER this is a libFuzzer target (`make fuzz`). Without, main runs seeded random cases of the same kind
 * and takes a first seed and a count, so that a failure can be repeated. */
#include "api/hd_core.h"
#include "hd_fuzz.h"
#include "hd_test.h"

#define TICKS 16
#define PARTS 8
#define EVENTS 64
#define PERIOD_S 1e-4
#define MAX_FORCE_N 8.9

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static struct {
    uint64_t refused, rendered, forceful, played, unplayed;
} outcome;

static void take_mode(struct source *source, struct hd_mode *mode) {
    double b = take_number(source, 0.0, 2000.0);
    double w = take_number(source, 0.0, 20000.0);

    *mode = (struct hd_mode){
        .rotor_re = exp(-b * PERIOD_S) * cos(w * PERIOD_S),
        .rotor_im = exp(-b * PERIOD_S) * sin(w * PERIOD_S),
        .decay_rate_per_s = b,
        .angular_frequency_rad_per_s = w,
        .end_s = take_number(source, 0.0, 0.02),
        .peak = take_number(source, 0.0, 1.0),
        .peak_time_s = take_number(source, 0.0, 0.01),
        .amplitude_per_unit = 1.0,
        .force_per_unit = take_number(source, 0.0, 1.0),
        .gain_re = 1.0,
    };
    if (take_bytes(source, 1) % 8 == 0)
        mode->rotor_im = take_number(source, -1.0, 1.0);
    if (take_bytes(source, 1) % 8 == 0) {
        mode->tail_rotor_re = take_number(source, -1.0, 1.0);
        mode->tail_rotor_im = take_number(source, -1.0, 1.0);
        mode->tail_end_s = take_number(source, 0.0, 0.05);
        mode->tail_re = take_number(source, -2.0, 2.0);
    }
}

/* A floor that rings and rubs, a membrane that breaks, a disc and a box with grooves. */
static struct hd_world *sound_world(void) {
    struct source none = {NULL, 0};
    struct hd_world *world = hd_world_new();
    struct hd_mode mode;
    struct hd_material materials[2];
    struct hd_object objects[4];
    struct hd_table table = {.revision = 1,
                             .object_count = 4,
                             .material_count = 2,
                             .display_force = 1,
                             .display_vibration = 1,
                             .passivity = HD_PASSIVITY_CONTROL,
                             .report_age = 1,
                             .period_s = PERIOD_S,
                             .max_force_n = MAX_FORCE_N,
                             .max_speed_m_per_s = 5.0,
                             .ramp_s = 0.02,
                             .ramp_step = PERIOD_S / 0.02,
                             .brake_n_s_per_m = 10.0,
                             .field = {{0.0, -0.2}, 50.0, 1.0},
                             .objects = objects,
                             .materials = materials};

    CHECK(world != NULL);
    take_mode(&none, &mode);
    mode.decay_rate_per_s = 150.0;
    mode.angular_frequency_rad_per_s = 420.0;
    mode.rotor_re = exp(-150.0 * PERIOD_S) * cos(420.0 * PERIOD_S);
    mode.rotor_im = exp(-150.0 * PERIOD_S) * sin(420.0 * PERIOD_S);
    mode.end_s = 5.0 / 150.0;
    mode.peak = 1.0;
    mode.peak_time_s = 0.003;
    mode.force_per_unit = 0.05;
    mode.tail_rotor_re = mode.tail_rotor_im = mode.tail_re = 0.0;
    for (size_t i = 0; i < 2; i++)
        materials[i] = (struct hd_material){.stiffness_n_per_m = 800.0,
                                            .damping_n_s_per_m = 1.0,
                                            .rupture_depth_m = 0.002,
                                            .friction_coefficient = 0.3,
                                            .friction_stiffness_n_per_m = 500.0,
                                            .tap = mode,
                                            .rupture = mode,
                                            .groove = mode};
    materials[1].texture = HD_TEXTURE_STRIKES;
    materials[1].spacing_m = 0.002;
    materials[1].width_m = 0.0005;
    materials[1].velocity_gain_per_s = 1000.0;
    for (uint32_t i = 0; i < 4; i++)
        objects[i] = (struct hd_object){.shape = HD_SHAPE_WALL + i, .material = i % 2, .normal = {0.0, 1.0}};
    objects[1].point_m[1] = 0.004;
    objects[1].half_m[0] = 0.01;
    objects[2].point_m[0] = 0.01;
    objects[2].half_m[0] = objects[2].half_m[1] = 0.005;
    objects[3].point_m[0] = -0.01;
    objects[3].half_m[0] = objects[3].half_m[1] = 0.005;
    if (hd_world_load(world, &table) != HD_OK) {
        fprintf(stderr, "%s\n", hd_invalid_reason());
        CHECK(0);
    }
    return world;
}

struct recording {
    struct hd_sample samples[TICKS];
    double interval_s[TICKS];
    uint32_t periods[TICKS];
    double at_m[2];
    uint64_t tick;
};

static void take_recording(struct source *source, struct recording *recording) {
    for (size_t i = 0; i < TICKS; i++) {
        struct hd_sample *sample = &recording->samples[i];
        uint64_t choice = take_bytes(source, 1);

        recording->periods[i] = choice < 252 ? 1 : (uint32_t)take_bytes(source, 4);
        recording->interval_s[i] = (choice & 1) != 0 ? PERIOD_S : take_number(source, 0.0, 0.01);
        recording->tick += choice != 1 ? 1 : take_bytes(source, 8);
        *sample = (struct hd_sample){
            .tick = choice != 2 ? recording->tick : take_bytes(source, 8),
            .time_ns = choice != 3 ? (int64_t)(recording->tick * 100000u) : (int64_t)take_bytes(source, 8),
            .revision = (uint32_t)choice,
            .flags = choice % 16 != 4 ? HD_FLAG_FORCES_ON : (uint32_t)take_bytes(source, 4),
            .lateness_ns = (int32_t)choice,
            .work_ns = (int32_t)choice,
        };
        for (size_t axis = 0; axis < 2; axis++) {
            double step = take_number(source, -0.002, 0.002);

            sample->position_m[axis] = recording->at_m[axis] + step;
            sample->velocity_m_per_s[axis] = take_number(source, -step / PERIOD_S, step / PERIOD_S);
            if (isfinite(sample->position_m[axis]) && fabs(sample->position_m[axis]) < 0.03)
                recording->at_m[axis] = sample->position_m[axis];
        }
    }
}

static void command(struct source *source, struct hd_state *state, int64_t time_ns) {
    struct hd_mode mode;
    double direction[2];
    int status;

    switch (take_bytes(source, 1) % 8) {
    case 0:
    case 1:
        take_mode(source, &mode);
        direction[0] = take_number(source, -1.0, 1.0);
        direction[1] = sqrt(1.0 - direction[0] * direction[0]);
        if (take_bytes(source, 1) % 8 == 0)
            direction[1] = take_number(source, -1.0, 1.0);
        status = hd_play(state, &mode, direction, take_number(source, 0.0, 100.0));
        CHECK(status == HD_OK || status == HD_ERR_FULL || (status == HD_ERR_INVALID && hd_invalid_reason()[0] != '\0'));
        outcome.played += status == HD_OK;
        outcome.unplayed += status != HD_OK;
        break;
    case 2:
        hd_state_reset(state, HD_NO_SLOT, 0, time_ns);
        break;
    case 3:
        hd_state_reset(state, (uint32_t)take_bytes(source, 1) % 8, (uint32_t)take_bytes(source, 1) % 2, time_ns);
        break;
    case 4:
        hd_state_reset(state, (uint32_t)take_bytes(source, 4), (uint32_t)take_bytes(source, 4),
                       (int64_t)take_bytes(source, 8));
        break;
    case 5:
        hd_state_mute(state);
        break;
    case 6:
        hd_state_enable(state, (int)take_bytes(source, 1) % 2);
        break;
    default:
        break;
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static struct hd_world *world;
    struct source source = {.data = data, .left = size};
    struct hd_state *state = hd_state_new(4);
    struct recording recording = {.at_m = {0.0, 0.002}};
    int faulty = 0;

    if (world == NULL)
        world = sound_world();
    CHECK(state != NULL);
    for (int part = 0; part < PARTS && source.left > 0; part++) {
        struct hd_sample samples[TICKS];
        struct hd_event events[EVENTS];
        size_t event_count = 0;
        int status;

        memset(samples, 0, sizeof samples);
        command(&source, state, (int64_t)(recording.tick * 100000u));
        take_recording(&source, &recording);
        status = hd_replay(world, state, recording.samples, recording.interval_s, recording.periods, TICKS, samples,
                           events, EVENTS, &event_count);
        if (status != HD_OK) {
            CHECK(status == HD_ERR_INVALID && hd_invalid_reason()[0] != '\0');
            outcome.refused++;
            break;
        }
        outcome.rendered++;
        for (size_t i = 0; i < TICKS; i++) {
            const double *force = samples[i].force_n;
            const double *position = recording.samples[i].position_m;

            CHECK(isfinite(force[0]) && isfinite(force[1]));
            CHECK(hypot(force[0], force[1]) <= MAX_FORCE_N);
            faulty |= !isfinite(position[0]) || !isfinite(position[1]);
            CHECK(!faulty || (force[0] == 0.0 && force[1] == 0.0 && (samples[i].flags & HD_FLAG_FAULT) != 0));
            outcome.forceful += force[0] != 0.0 || force[1] != 0.0;
        }
        for (size_t i = 0; i < event_count && i < EVENTS; i++) {
            CHECK(events[i].kind >= HD_EVENT_CONTACT && events[i].kind <= HD_EVENT_MEMORY_REFUSED);
            CHECK(events[i].scale >= 0.0 && events[i].scale <= 1.0);
        }
    }
    hd_state_free(state);
    return 0;
}

#ifndef HD_LIBFUZZER
int main(int argc, char **argv) {
    static uint8_t bytes[4096];
    uint64_t first = argc > 1 ? strtoull(argv[1], NULL, 10) : test_run() * 5000;
    uint64_t count = argc > 2 ? strtoull(argv[2], NULL, 10) : test_share(5000);

    for (uint64_t i = first; i < first + count; i++) {
        uint64_t seed = i;

        for (size_t at = 0; at < sizeof bytes; at++)
            bytes[at] = (uint8_t)test_random(&seed);
        if (argc > 2)
            fprintf(stderr, "seed %llu\n", (unsigned long long)i);
        LLVMFuzzerTestOneInput(bytes, sizeof bytes);
    }
    printf("test_fuzz_replay: ok, %llu parts refused, %llu rendered, %llu ticks with a force, %llu of %llu played\n",
           (unsigned long long)outcome.refused, (unsigned long long)outcome.rendered,
           (unsigned long long)outcome.forceful, (unsigned long long)outcome.played,
           (unsigned long long)(outcome.played + outcome.unplayed));
    CHECK(argc > 2 || test_run() > 0 ||
          (outcome.refused > count / 100 && outcome.rendered > count && outcome.forceful > count &&
           outcome.played > count / 100 && outcome.unplayed > count / 100));
    return 0;
}
#endif
