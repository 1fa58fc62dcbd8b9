/* The passivity observer against a sum over everything that happened, and the controller against an adversary: a hand
 * that goes along whatever force acts, as fast as it can, while positions come late, old, or not at all. */
#include <math.h>
#include <string.h>

#include "hd_test.h"
#include "scene/hd_world.h"
#include "tick/hd_passivity.h"
#include "tick/hd_state.h"
#include "tick/hd_tick.h"

#define PERIOD_S 1e-3
#define MAX_FORCE_N 8.9
#define MAX_SPEED_M_PER_S 5.0
#define PERIODS 4000u
#define AGES 6u

static uint64_t seed;

static double uniform(double low, double high) {
    return low + (high - low) * (double)(test_random(&seed) >> 11) * 0x1p-53;
}

/* Everything that was commanded and reported, one entry a period since the contact began. */
struct history {
    double force_n[PERIODS][2];
    uint32_t count;
    uint32_t settled; /* periods whose way is known */
    uint32_t longest;
    uint32_t missed; /* at a time */
    double energy_j;
    double largest_j;
    int running;
};

struct rig {
    struct hd_world *world;
    struct hd_state *state;
    struct hd_object objects[2];
    struct hd_material material;
    struct hd_table table;
    struct history history;
    double position_m[2];
    uint32_t waited;
    double largest_share; /* of the bound */
    uint64_t contacts;
};

static void load(struct rig *rig, uint32_t mode, uint32_t age) {
    const double angle = uniform(0.2, 1.4);

    rig->material = (struct hd_material){
        .stiffness_n_per_m = pow(10.0, uniform(2.0, 5.0)),
        .damping_n_s_per_m = test_below(&seed, 2) ? uniform(0.0, 100.0) : 0.0,
        .friction_coefficient = test_below(&seed, 2) ? uniform(0.0, 1.0) : 0.0,
        .friction_stiffness_n_per_m = 2000.0,
    };
    for (uint32_t i = 0; i < 2; i++)
        rig->objects[i] = (struct hd_object){
            .generation = 1,
            .pose_version = 1,
            .surface_version = 1,
            .shape = HD_SHAPE_WALL,
            .normal = {i == 0 ? sin(angle) : -sin(angle), cos(angle)},
        };
    rig->table = (struct hd_table){
        .revision = 1,
        .object_count = 1 + (uint32_t)test_below(&seed, 2),
        .material_count = 1,
        .display_force = 1,
        .display_vibration = 1,
        .all_changed = 1,
        .passivity = mode,
        .report_age = age,
        .period_s = PERIOD_S,
        .max_force_n = MAX_FORCE_N,
        .max_speed_m_per_s = MAX_SPEED_M_PER_S,
        .ramp_s = 0.05,
        .ramp_step = PERIOD_S / 0.05,
        .brake_n_s_per_m = test_below(&seed, 2) ? uniform(0.0, 100.0) : 0.0,
        .handle_damping_n_s_per_m = test_below(&seed, 2) ? uniform(0.0, 1.0) : 0.0,
        .handle_friction_n = test_below(&seed, 2) ? uniform(0.0, 0.1) : 0.0,
        .objects = rig->objects,
        .materials = &rig->material,
    };
    CHECK(hd_world_load(rig->world, &rig->table) == HD_OK);
}

static struct hd_sample tick(struct rig *rig, int fresh, uint32_t periods) {
    struct hd_sample sample;
    const double velocity[2] = {uniform(-1.0, 1.0), uniform(-1.0, 1.0)}; /* as wrong as an estimate can be */
    struct hd_input input = {.periods = periods, .time_ns = (int64_t)rig->state->tick * 1000000};
    struct hd_reading reading = {.position_m = {rig->position_m[0], rig->position_m[1]}};

    rig->waited += periods;
    if (fresh) {
        reading.interval_s = rig->state->located ? rig->waited * PERIOD_S : 0.0;
        rig->waited = 0;
    }
    hd_sense(rig->state, &rig->table, &reading, velocity, &input);
    hd_tick(rig->world, rig->state, &input, &sample);
    rig->state->event_count = 0;
    return sample;
}

/* The observer once more: from the first touch to the last, when the force of every period is followed by its way. */
static void follow(struct history *history, const struct rig *rig, const double way[2], int fresh, uint32_t periods,
                   const struct hd_sample *before, const struct hd_sample *now) {
    const uint32_t age = rig->table.report_age;

    if (history->running) {
        CHECK(history->count + periods <= PERIODS);
        history->missed = periods - 1 > history->missed ? periods - 1 : history->missed;
        for (uint32_t i = 0; i < periods; i++)
            memcpy(history->force_n[history->count++], before->force_n, sizeof before->force_n);
        if (fresh) {
            uint32_t since = history->count - history->settled;
            double sum[2] = {0.0, 0.0};

            /* The way of the periods from `settled` on, each `age` periods earlier. */
            for (uint32_t i = history->settled; i < history->count; i++)
                for (size_t axis = 0; i >= age && axis < 2; axis++)
                    sum[axis] += history->force_n[i - age][axis];
            history->energy_j += (sum[0] * way[0] + sum[1] * way[1]) / since;
            history->largest_j = fmax(history->largest_j, history->energy_j);
            history->longest = since > history->longest ? since : history->longest;
            history->settled = history->count;
        }
    }
    int touched = (now->flags & HD_FLAG_CONTACT) != 0 || now->force_n[0] != 0.0 || now->force_n[1] != 0.0;
    for (uint32_t i = history->settled > age ? history->settled - age : 0; i < history->count; i++)
        touched |= history->force_n[i][0] != 0.0 || history->force_n[i][1] != 0.0;
    if (touched && !history->running)
        *history = (struct history){.running = 1, .largest_j = history->largest_j};
    else if (!touched)
        history->running = 0;
}

/* One hand: wherever the force that acts now pushes, it goes; else it dips in and out. */
static void run(struct rig *rig, uint32_t mode, uint32_t age) {
    struct hd_sample before;
    double acting[2] = {0.0, 0.0};
    double goal = -0.002;

    rig->world = hd_world_new();
    rig->state = hd_state_new(2);
    CHECK(rig->world != NULL && rig->state != NULL);
    load(rig, mode, age);
    memset(&rig->history, 0, sizeof rig->history);
    rig->position_m[0] = 0.0;
    rig->position_m[1] = 0.02;
    rig->waited = 0;
    before = tick(rig, 1, 1);
    for (int i = 0; i < 600; i++) {
        const int fresh = test_below(&seed, 4) != 0;
        const uint32_t periods = test_below(&seed, 20) == 0 ? 1 + (uint32_t)test_below(&seed, 5) : 1;
        double way[2] = {0.0, 0.0};
        struct history *history = &rig->history;

        if (fresh) {
            const double most = (rig->waited + periods) * PERIOD_S * MAX_SPEED_M_PER_S;
            const uint32_t then = history->count > age ? history->count - 1 - age : 0;
            double size = 0.0;

            if (history->running && history->count > age)
                memcpy(acting, history->force_n[then], sizeof acting);
            else if (age == 0)
                memcpy(acting, before.force_n, sizeof acting);
            size = hypot(acting[0], acting[1]);
            if (history->running && size > 0.0 && test_below(&seed, 3) != 0) {
                for (size_t axis = 0; axis < 2; axis++)
                    way[axis] = most * acting[axis] / size;
            } else {
                way[0] = uniform(-0.2, 0.2) * most;
                way[1] = fmax(-0.7 * most, fmin(0.7 * most, goal - rig->position_m[1]));
                goal = uniform(-0.004, 0.002);
            }
            rig->position_m[0] += way[0];
            rig->position_m[1] += way[1];
        }
        struct hd_sample now = tick(rig, fresh, periods);
        CHECK((now.flags & (HD_FLAG_GLITCH | HD_FLAG_FAULT)) == 0);
        follow(history, rig, way, fresh, periods, &before, &now);
        CHECK(hypot(now.force_n[0], now.force_n[1]) <= MAX_FORCE_N);
        if (history->running) {
            const struct hd_passivity *passivity = &rig->state->passivity;
            const double bound =
                MAX_FORCE_N * MAX_SPEED_M_PER_S * PERIOD_S * (fmax(history->longest, 1) + age + history->missed);

            CHECK(fabs(passivity->energy_j - history->energy_j) <= 1e-12);
            CHECK(fabs(passivity->largest_j - history->largest_j) <= 1e-12);
            rig->largest_share = fmax(rig->largest_share, history->energy_j / bound);
            if (mode == HD_PASSIVITY_CONTROL)
                CHECK(history->energy_j <= bound * (1.0 + 1e-12));
            else
                CHECK((now.flags & HD_FLAG_RESTRAINED) == 0);
        }
        before = now;
    }
    rig->contacts += rig->state->passivity.contacts;
    hd_world_free(rig->world);
    hd_state_free(rig->state);
}

/* Without the controller the same hands are given many times the bound. */
static void bounds(void) {
    static struct rig rig;

    for (uint32_t mode = HD_PASSIVITY_OBSERVE; mode <= HD_PASSIVITY_CONTROL; mode++) {
        rig.largest_share = 0.0;
        rig.contacts = 0;
        for (uint32_t i = 0; i < 300; i++) {
            seed = i;
            run(&rig, mode, i % AGES);
        }
        CHECK(rig.contacts > 3000);
        CHECK(mode == HD_PASSIVITY_CONTROL ? rig.largest_share > 0.5 : rig.largest_share > 5.0);
    }
}

/* A contact that is longer than the ring: the sum goes on, of what the ring still holds. */
static void goes_on_without_samples(void) {
    static struct rig rig;

    seed = 1;
    rig.world = hd_world_new();
    rig.state = hd_state_new(2);
    CHECK(rig.world != NULL && rig.state != NULL);
    load(&rig, HD_PASSIVITY_CONTROL, HD_PASSIVITY_AGE_MAX);
    rig.position_m[1] = 0.001;
    rig.waited = 0;
    tick(&rig, 1, 1);
    rig.position_m[1] = -0.001;
    tick(&rig, 1, 1);
    for (int i = 0; i < 3000; i++) {
        struct hd_sample sample = tick(&rig, 0, 1 + (uint32_t)(i % 49));
        CHECK(isfinite(sample.force_n[0]) && isfinite(sample.force_n[1]));
    }
    rig.position_m[1] = 0.001;
    tick(&rig, 1, 1);
    CHECK(isfinite(rig.state->passivity.energy_j));
    hd_world_free(rig.world);
    hd_state_free(rig.state);
}

int main(void) {
    bounds();
    goes_on_without_samples();
    puts("test_passivity: ok");
    return 0;
}
