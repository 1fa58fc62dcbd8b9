/* Any bytes as a simulated joystick, an operator and what is done with them: each is refused with a reason, or handle
 * and force stay finite, inside the stops and below what the actuator gives.
 *
 * With HD_LIBFUZZER this is a libFuzzer target (`make fuzz`). Without, main runs seeded random cases of the same kind
 * and takes a first seed and a count, so that a failure can be repeated. */
#include "api/hd_core.h"
#include "device/hd_sim.h"
#include "hd_fuzz.h"
#include "hd_test.h"

#define POINTS 12
#define STEPS 64

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static struct {
    uint64_t refused, simulated, paths, bad_paths, led, moved;
} outcome;

static double take_choice(struct source *source, double low, double high, double otherwise) {
    return take_bytes(source, 1) % 2 != 0 ? take_number(source, low, high) : otherwise;
}

static void take_config(struct source *source, struct hd_sim_config *config) {
    *config = (struct hd_sim_config){
        .handle_mass_kg = take_number(source, 0.001, 0.2),
        .handle_damping_n_s_per_m = take_number(source, 0.0, 5.0),
        .coulomb_friction_n = take_number(source, 0.0, 0.5),
        .encoder_step_m = take_choice(source, 1e-6, 1e-3, 0.0),
        .max_force_n = take_number(source, 0.0, 20.0),
        .force_step_n = take_choice(source, 1e-3, 0.1, 0.0),
        .report_interval_s = take_choice(source, 1e-4, 0.01, 0.0),
        .report_delay_s = take_choice(source, 0.0, 0.01, 0.0),
        .force_interval_s = take_choice(source, 1e-4, 0.01, 0.0),
        .force_intervals = (uint32_t)take_bytes(source, 1) % 18,
        .workspace_m = take_number(source, 0.001, 0.2),
        .force_timeout_s = take_number(source, 0.001, 0.2),
        .hand_mass_kg = take_number(source, 0.0, 0.2),
        .hand_stiffness_n_per_m = take_number(source, 0.0, 2000.0),
        .hand_damping_n_s_per_m = take_number(source, 0.0, 20.0),
        .actuator_rate_per_s = take_number(source, 0.0, 20000.0),
        .actuator_damping_ratio = take_number(source, 0.1, 3.0),
    };
    /* Few of them lag: a step is then cut into many. */
    const uint32_t order = (uint32_t)take_bytes(source, 1) % 16;
    config->actuator_order = order > 3 ? 0 : order;
    config->start_m[0] = take_choice(source, -config->workspace_m, config->workspace_m, 0.0);
    config->start_m[1] = take_choice(source, -config->workspace_m, config->workspace_m, 0.0);
}

static struct hd_operator *take_path(struct source *source) {
    double points[POINTS][3];
    size_t count = take_bytes(source, 1) % (POINTS + 1);
    double time_s = 0.0;

    for (size_t i = 0; i < count; i++) {
        time_s += take_number(source, 1e-5, 0.02);
        points[i][0] = time_s;
        points[i][1] = take_number(source, -0.05, 0.05);
        points[i][2] = take_number(source, -0.05, 0.05);
        if (!isfinite(time_s))
            time_s = 0.0;
    }
    struct hd_operator *path = hd_operator_new(points[0], count, (enum hd_interpolation)(take_bytes(source, 1) % 3));

    CHECK(path != NULL || hd_invalid_reason()[0] != '\0');
    outcome.paths += path != NULL;
    outcome.bad_paths += path == NULL;
    return path;
}

static void check(const struct hd_sim_config *config, struct hd_sim *sim) {
    struct hd_reading reading;
    double position[2], velocity[2], force[2];

    hd_sim_read(sim, &reading);
    hd_sim_truth(sim, position, velocity, force);
    for (int axis = 0; axis < 2; axis++) {
        CHECK(isfinite(position[axis]) && isfinite(velocity[axis]) && isfinite(force[axis]));
        CHECK(fabs(position[axis]) <= config->workspace_m * (1.0 + 1e-9));
        /* One of second order may overshoot. */
        CHECK(config->actuator_order == 2 || fabs(force[axis]) <= config->max_force_n * (1.0 + 1e-9));
        CHECK(isfinite(reading.position_m[axis]));
        outcome.moved += velocity[axis] != 0.0;
    }
    CHECK(reading.interval_s >= 0.0 && isfinite(reading.interval_s));
}

static void act(struct source *source, struct hd_sim *sim, struct hd_operator **path) {
    double force[2] = {take_number(source, -10.0, 10.0), take_number(source, -10.0, 10.0)};
    double other[2];

    switch (take_bytes(source, 1) % 8) {
    case 0:
        /* The one before is not used any more once the new one has been given. */
        if (*path == NULL) {
            *path = take_path(source);
            if (*path != NULL)
                hd_sim_operate(sim, *path);
        }
        break;
    case 1:
        hd_sim_settle(sim);
        break;
    case 2:
        other[0] = take_number(source, -1.0, 1.0);
        other[1] = take_number(source, -1.0, 1.0);
        force[0] *= 0.01;
        force[1] *= 0.01;
        if (hd_sim_place(sim, force, other) != HD_OK)
            CHECK(hd_invalid_reason()[0] != '\0');
        break;
    case 3: /* what hd_servo_stream lets through */
        other[0] = take_number(source, -0.1, 0.1);
        other[1] = take_number(source, -0.1, 0.1);
        if (fabs(other[0]) <= 1000.0 && fabs(other[1]) <= 1000.0) {
            hd_sim_step_lead(sim, other, 1e-5 * (double)(1 + take_bytes(source, 2)));
            outcome.led++;
        }
        break;
    default:
        hd_sim_put(sim, force);
        break;
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static const double periods_s[] = {1e-4, 1e-3, 2e-4, 1.0 / 3000.0};
    struct source source = {.data = data, .left = size};
    double period_s = periods_s[take_bytes(&source, 1) % 4];
    struct hd_operator *path = NULL;
    struct hd_sim_config config;
    struct hd_sim *sim;

    take_config(&source, &config);
    sim = hd_sim_new(&config, period_s);
    if (sim == NULL) {
        CHECK(hd_invalid_reason()[0] != '\0');
        outcome.refused++;
        return 0;
    }
    outcome.simulated++;
    check(&config, sim);
    for (int step = 0; step < STEPS && source.left > 0; step++) {
        uint32_t choice = (uint32_t)take_bytes(&source, 1);

        act(&source, sim, &path);
        hd_sim_advance(sim, choice < 250 ? 1 + choice % 4 : 1u << (choice % 16));
        check(&config, sim);
        if (choice == 255 && hd_sim_set_period(sim, &config, take_number(&source, 1e-4, 1e-3)) != HD_OK)
            CHECK(hd_invalid_reason()[0] != '\0');
    }
    hd_sim_free(sim);
    hd_operator_free(path);
    return 0;
}

#ifndef HD_LIBFUZZER
int main(int argc, char **argv) {
    static uint8_t bytes[1024];
    uint64_t first = argc > 1 ? strtoull(argv[1], NULL, 10) : test_run() * 20000;
    uint64_t count = argc > 2 ? strtoull(argv[2], NULL, 10) : test_share(20000);

    for (uint64_t i = first; i < first + count; i++) {
        uint64_t seed = i;

        for (size_t at = 0; at < sizeof bytes; at++)
            bytes[at] = (uint8_t)test_random(&seed);
        if (argc > 2)
            fprintf(stderr, "seed %llu\n", (unsigned long long)i);
        LLVMFuzzerTestOneInput(bytes, sizeof bytes);
    }
    printf("test_fuzz_sim: ok, %llu joysticks refused, %llu simulated, %llu operators taken, %llu refused\n",
           (unsigned long long)outcome.refused, (unsigned long long)outcome.simulated,
           (unsigned long long)outcome.paths, (unsigned long long)outcome.bad_paths);
    CHECK(argc > 2 || test_run() > 0 ||
          (outcome.refused > count / 20 && outcome.simulated > count / 10 && outcome.paths > count / 100 &&
           outcome.bad_paths > count / 100 && outcome.led > count && outcome.moved > count));
    return 0;
}
#endif
