/* Streamed targets and forces: the line between two values in closed form, its limits, its end; the hand led like an
 * operator; and a servo that is sent more than it can take. That streams keep the rule of ramps beside all else that
 * changes is for test_ramp. */
#include <math.h>
#include <pthread.h>
#include <sched.h>
#include <string.h>
#include <time.h>

#include "api/hd_core.h"
#include "base/hd_atomic.h"
#include "base/hd_clock.h"
#include "base/hd_spacing.h"
#include "device/hd_device.h"
#include "device/hd_sim_state.h"
#include "hd_test.h"
#include "scene/hd_world.h"
#include "tick/hd_tick.h"

#define PERIOD_S 1e-4
#define LIMIT_N 8.0
#define RAMP_S 0.02
#define PACE_N (LIMIT_N * PERIOD_S / RAMP_S)
#define RAMP_TICKS 200u
#define TIMEOUT_S 0.02
#define SENT 40000u
#define EVERY_NS 5000 /* of a flood: 200 kHz */
#define PATIENCE_S 60 /* a defect, not a slow machine */

static int near(double value, double wanted) {
    return fabs(value - wanted) <= 1e-12;
}

/* ---- The usual time between two ------------------------------------------------------------------------------ */

static void spacing(void) {
    struct hd_spacing usual = {.count = 0};

    CHECK(hd_spacing_usual(&usual, 0.5) == 0.5);
    hd_spacing_add(&usual, 0.002);
    CHECK(hd_spacing_usual(&usual, 0.5) == 0.002);
    hd_spacing_add(&usual, 0.001);
    CHECK(near(hd_spacing_usual(&usual, 0.5), 0.0015));
    /* One late and one early arrival change nothing. */
    for (int i = 0; i < 6; i++)
        hd_spacing_add(&usual, 0.001 + 0.001 * (i % 2));
    hd_spacing_forget(&usual);
    for (uint32_t i = 0; i < HD_SPACINGS; i++)
        hd_spacing_add(&usual, i == 3 ? 0.019 : i == 5 ? 0.0001 : 0.001);
    CHECK(near(hd_spacing_usual(&usual, 0.5), 0.001));
    /* A stream that comes in steps of whole ticks: the mean, which a median would miss. */
    for (uint32_t i = 0; i < 2 * HD_SPACINGS; i++)
        hd_spacing_add(&usual, i % 2 == 0 ? 0.001 : 0.002);
    CHECK(near(hd_spacing_usual(&usual, 0.5), 0.0015));
    for (uint32_t i = 0; i < HD_SPACINGS; i++)
        hd_spacing_add(&usual, 0.016);
    CHECK(near(hd_spacing_usual(&usual, 0.5), 0.016));
}

/* ---- The force, tick by tick --------------------------------------------------------------------------------- */

struct bench {
    struct hd_table table;
    struct hd_world *world;
    struct hd_state *state;
    struct hd_input input;
    struct hd_sample sample;
};

static void load(struct bench *bench) {
    bench->table.revision++;
    bench->table.all_changed = 1;
    CHECK(hd_world_load(bench->world, &bench->table) == HD_OK);
}

static void open_bench(struct bench *bench) {
    *bench = (struct bench){
        .table = {.display_force = 1,
                  .display_vibration = 1,
                  .period_s = PERIOD_S,
                  .max_force_n = LIMIT_N,
                  .max_speed_m_per_s = 5.0,
                  .ramp_s = RAMP_S,
                  .ramp_step = PERIOD_S / RAMP_S},
        .world = hd_world_new(),
        .state = hd_state_new(1),
        .input = {.periods = 1},
    };
    CHECK(bench->world != NULL && bench->state != NULL);
    load(bench);
}

static void close_bench(struct bench *bench) {
    hd_world_free(bench->world);
    hd_state_free(bench->state);
}

static void tick(struct bench *bench, uint32_t periods) {
    bench->input.periods = periods;
    bench->input.interval_s = bench->state->located ? (double)periods * bench->table.period_s : 0.0;
    bench->input.time_ns += (int64_t)(1e9 * bench->table.period_s * (double)periods);
    bench->state->event_count = 0;
    hd_tick(bench->world, bench->state, &bench->input, &bench->sample);
}

static void aim(struct bench *bench, double x_n, double y_n, double ticks) {
    const double force_n[2] = {x_n, y_n};

    hd_tick_stream(bench->state, &bench->table, force_n, ticks * bench->table.period_s);
}

static int is(const struct bench *bench, double x_n, double y_n) {
    return near(bench->sample.force_n[0], x_n) && near(bench->sample.force_n[1], y_n) &&
           near(bench->sample.contact_force_n[0], x_n) && near(bench->sample.contact_force_n[1], y_n);
}

static int streamed(const struct bench *bench) {
    return (bench->sample.flags & HD_FLAG_STREAMED) != 0;
}

/* A regular stream is a polygon through all of its values, one interval late, without a step and without a rest. */
static void polygon(void) {
    struct bench bench;
    double before[2] = {0.0, 0.0};
    const int every = 16;

    open_bench(&bench);
    tick(&bench, 1);
    CHECK(is(&bench, 0.0, 0.0) && !streamed(&bench));
    for (int i = 1; i <= 50; i++) {
        const double to[2] = {0.3 * sin(0.4 * i), 0.1 * (i % 3)};

        aim(&bench, to[0], to[1], every);
        for (int k = 1; k <= every; k++) {
            const double part = (double)k / every;

            tick(&bench, 1);
            CHECK(is(&bench, before[0] + part * (to[0] - before[0]), before[1] + part * (to[1] - before[1])));
            CHECK(streamed(&bench));
        }
        before[0] = to[0];
        before[1] = to[1];
    }
    CHECK(bench.state->streamed.limited == 0);
    /* The next one is late: it stays. Periods that were missed have passed. */
    tick(&bench, 1);
    CHECK(is(&bench, before[0], before[1]));
    aim(&bench, before[0] + 0.16, before[1], 16);
    tick(&bench, 1);
    tick(&bench, 4);
    CHECK(is(&bench, before[0] + 0.05, before[1]));
    /* The next one is early: from where it is. */
    aim(&bench, before[0], before[1], 5);
    tick(&bench, 1);
    CHECK(is(&bench, before[0] + 0.04, before[1]));
    close_bench(&bench);
}

/* What is larger than the limit is the limit, the same way; what is steeper than the pace comes at the pace. */
static void limits(void) {
    struct bench bench;

    open_bench(&bench);
    tick(&bench, 1);
    aim(&bench, 3.0, 4.0, 1);
    for (int k = 1; k <= 125; k++) {
        tick(&bench, 1);
        CHECK(is(&bench, 0.6 * PACE_N * k, 0.8 * PACE_N * k));
        CHECK(bench.state->streamed.limited == 1);
    }
    tick(&bench, 1);
    CHECK(is(&bench, 3.0, 4.0));
    aim(&bench, -1e308, 1e308, 1);
    for (uint32_t k = 0; k < 3 * RAMP_TICKS; k++)
        tick(&bench, 1);
    CHECK(is(&bench, -LIMIT_N / sqrt(2.0), LIMIT_N / sqrt(2.0)) && bench.state->streamed.limited == 2);
    CHECK(hypot(bench.sample.force_n[0], bench.sample.force_n[1]) <= LIMIT_N);
    /* From limit to limit as slowly as that. */
    aim(&bench, LIMIT_N, 0.0, 2.0 * RAMP_TICKS);
    tick(&bench, 1);
    CHECK(bench.state->streamed.limited == 2);
    aim(&bench, (double)INFINITY, 0.0, 1);
    tick(&bench, 1);
    CHECK((bench.sample.flags & HD_FLAG_FAULT) != 0 && is(&bench, 0.0, 0.0));
    close_bench(&bench);
}

/* None came any more: in a straight line over the ramp to exactly nothing, and then it is as if it had never been. */
static void ends(void) {
    struct bench bench;

    open_bench(&bench);
    tick(&bench, 1);
    aim(&bench, 1.0, -2.0, RAMP_TICKS);
    for (uint32_t k = 0; k < RAMP_TICKS; k++)
        tick(&bench, 1);
    CHECK(is(&bench, 1.0, -2.0));
    hd_tick_stream_end(bench.state, &bench.table);
    for (uint32_t k = 1; k <= RAMP_TICKS; k++) {
        const double rest = 1.0 - (double)k / RAMP_TICKS;

        tick(&bench, 1);
        CHECK(is(&bench, rest, -2.0 * rest) && streamed(&bench));
    }
    CHECK(bench.sample.force_n[0] == 0.0 && bench.sample.force_n[1] == 0.0);
    tick(&bench, 1);
    CHECK(!streamed(&bench) && bench.state->steady && bench.state->streamed.limited == 0);
    /* A new one goes on from what is left. */
    aim(&bench, 1.0, 0.0, RAMP_TICKS);
    for (uint32_t k = 0; k < RAMP_TICKS; k++)
        tick(&bench, 1);
    hd_tick_stream_end(bench.state, &bench.table);
    for (uint32_t k = 0; k < RAMP_TICKS / 2; k++)
        tick(&bench, 1);
    aim(&bench, 0.7, 0.0, 20);
    tick(&bench, 1);
    CHECK(is(&bench, 0.51, 0.0) && streamed(&bench));
    close_bench(&bench);
}

/* A jump, a stall longer than the ramp and a fault drop it at once; it comes back at its pace, or not at all. */
static void drops(void) {
    struct bench bench;

    for (int why = 0; why < 2; why++) {
        open_bench(&bench);
        tick(&bench, 1);
        aim(&bench, 2.0, 0.0, 1);
        for (uint32_t k = 0; k < RAMP_TICKS; k++)
            tick(&bench, 1);
        CHECK(is(&bench, 2.0, 0.0));
        bench.input.glitch_m_per_s = why == 0 ? 10.0 : 0.0;
        tick(&bench, why == 0 ? 1 : RAMP_TICKS + 1);
        bench.input.glitch_m_per_s = 0.0;
        CHECK(is(&bench, PACE_N, 0.0));
        tick(&bench, 1);
        CHECK(is(&bench, 2.0 * PACE_N, 0.0));
        /* A stall that is shorter is no reason. */
        tick(&bench, RAMP_TICKS - 1);
        CHECK(is(&bench, 3.0 * PACE_N, 0.0));
        close_bench(&bench);
    }
    open_bench(&bench);
    tick(&bench, 1);
    aim(&bench, 2.0, 0.0, 1);
    tick(&bench, 1);
    bench.input.position_m[0] = (double)NAN;
    tick(&bench, 1);
    CHECK((bench.sample.flags & HD_FLAG_FAULT) != 0 && is(&bench, 0.0, 0.0));
    bench.input.position_m[0] = 0.0;
    for (uint32_t k = 0; k < RAMP_TICKS; k++) {
        tick(&bench, 1);
        CHECK(bench.sample.force_n[0] == 0.0);
    }
    hd_state_clear_faults(bench.state, 0, 0);
    for (uint32_t k = 1; k <= RAMP_TICKS; k++) {
        tick(&bench, 1);
        CHECK(near(bench.sample.force_n[0], 2.0 * k / RAMP_TICKS));
    }
    close_bench(&bench);
}

/* Switches stand over it: forces off, the display of forces, the passivity controller, the limit beside a field. */
static void switches(void) {
    struct bench bench;

    open_bench(&bench);
    tick(&bench, 1);
    hd_state_want_forces(bench.state, 0);
    aim(&bench, 4.0, 0.0, 1);
    for (uint32_t k = 0; k <= RAMP_TICKS; k++)
        tick(&bench, 1);
    CHECK(bench.sample.force_n[0] == 0.0 && near(bench.sample.contact_force_n[0], 4.0) && streamed(&bench));
    hd_state_want_forces(bench.state, 1);
    for (uint32_t k = 1; k <= RAMP_TICKS; k++) {
        tick(&bench, 1);
        CHECK(near(bench.sample.force_n[0], 4.0 * k / RAMP_TICKS));
    }
    bench.table.display_force = 0;
    load(&bench);
    for (uint32_t k = 1; k <= RAMP_TICKS; k++) {
        tick(&bench, 1);
        CHECK(near(bench.sample.force_n[0], 4.0 - 4.0 * k / RAMP_TICKS));
    }
    aim(&bench, 1.0, 0.0, RAMP_TICKS);
    for (uint32_t k = 0; k < RAMP_TICKS; k++) {
        tick(&bench, 1);
        CHECK(bench.sample.force_n[0] == 0.0 && bench.sample.contact_force_n[0] == 0.0);
    }
    bench.table.display_force = 1;
    bench.table.passivity = HD_PASSIVITY_CONTROL;
    bench.table.field = (struct hd_field){.force_n = {LIMIT_N, 0.0}};
    bench.table.field_version++;
    load(&bench);
    for (uint32_t k = 0; k < 4 * RAMP_TICKS; k++) {
        const double before_n = bench.sample.force_n[0];

        tick(&bench, 1);
        CHECK(bench.sample.force_n[0] <= LIMIT_N && fabs(bench.sample.force_n[0] - before_n) <= PACE_N + 1e-12);
    }
    CHECK(near(bench.sample.contact_force_n[0], LIMIT_N + 1.0) && near(bench.sample.force_n[0], LIMIT_N));
    CHECK((bench.sample.flags & HD_FLAG_SATURATED) != 0 && (bench.sample.flags & HD_FLAG_RESTRAINED) == 0);
    aim(&bench, -1.0, 0.0, RAMP_TICKS);
    for (uint32_t k = 0; k < RAMP_TICKS; k++)
        tick(&bench, 1);
    CHECK(near(bench.sample.force_n[0], LIMIT_N - 1.0));
    close_bench(&bench);
}

/* A servo that ended and went on at half its rate: the first tick is told of the pause, and the line is over. */
static void other_rate(void) {
    struct bench bench;

    open_bench(&bench);
    tick(&bench, 1);
    aim(&bench, 1.0, 0.0, 10.0 * RAMP_TICKS);
    for (uint32_t k = 0; k < RAMP_TICKS; k++)
        tick(&bench, 1);
    CHECK(is(&bench, 0.1, 0.0));
    bench.table.period_s *= 2.0;
    bench.table.ramp_step *= 2.0;
    load(&bench);
    tick(&bench, RAMP_TICKS);
    CHECK(is(&bench, 2.0 * PACE_N, 0.0));
    for (uint32_t k = 0; k < RAMP_TICKS; k++)
        tick(&bench, 1);
    CHECK(is(&bench, 1.0, 0.0));
    aim(&bench, 2.0, 0.0, 50);
    for (uint32_t k = 1; k <= 50; k++) {
        tick(&bench, 1);
        CHECK(is(&bench, 1.0 + k / 50.0, 0.0));
    }
    close_bench(&bench);
}

/* ---- The hand ------------------------------------------------------------------------------------------------ */

static const struct hd_sim_config joystick = {
    .handle_mass_kg = 0.05,
    .handle_damping_n_s_per_m = 0.2,
    .coulomb_friction_n = 0.02,
    .max_force_n = LIMIT_N,
    .workspace_m = 0.075,
    .force_timeout_s = 0.1,
    .hand_mass_kg = 0.1,
    .hand_stiffness_n_per_m = 500.0,
    .hand_damping_n_s_per_m = 2.0,
};

static struct hd_sim *new_joystick(void) {
    struct hd_sim *sim = hd_sim_new(&joystick, PERIOD_S);

    CHECK(sim != NULL);
    return sim;
}

static void same_motion(const struct hd_sim *a, const struct hd_sim *b) {
    double motion[2][6];

    hd_sim_truth(a, motion[0], motion[0] + 2, motion[0] + 4);
    hd_sim_truth(b, motion[1], motion[1] + 2, motion[1] + 4);
    CHECK(memcmp(motion[0], motion[1], sizeof motion[0]) == 0);
}

/* Each target is what an operator with this one waypoint would be, to the last bit; whose motion is known in closed
 * form (tests of the operator). One period at a time or many at once. */
static void as_an_operator(uint32_t at_once) {
    struct hd_sim *led = new_joystick();
    struct hd_sim *operated = new_joystick();
    struct hd_operator *paths[40];
    uint64_t random = 5 + at_once;

    for (size_t i = 0; i < 40; i++) {
        const double to[2] = {1e-5 * (double)test_below(&random, 100), 1e-5 * (double)test_below(&random, 100)};
        const double in_s = PERIOD_S * (i % 3 == 0 ? 10.0 + (double)test_below(&random, 160) : 166.6);
        const double waypoint[3] = {in_s, to[0], to[1]};

        paths[i] = hd_operator_new(waypoint, 1, HD_LINEAR);
        CHECK(paths[i] != NULL);
        hd_sim_operate(operated, paths[i]);
        CHECK(hd_sim_step_lead(led, to, in_s) == 0);
        /* The next one comes early, as it ends, or late. */
        for (size_t k = 0; k < 100 + test_below(&random, 140); k += at_once) {
            hd_sim_advance(led, at_once);
            hd_sim_advance(operated, at_once);
            same_motion(led, operated);
        }
    }
    for (size_t i = 0; i < 40; i++)
        hd_operator_free(paths[i]);
    hd_sim_free(led);
    hd_sim_free(operated);
}

/* No faster than its speed, in a straight line; then it stays. At another rate it goes on. */
static void speed(void) {
    struct hd_sim *sim = new_joystick();
    const double far[2] = {0.03, -0.04};
    const double near_by[2] = {0.03, -0.039};
    double reference[2];

    CHECK(hd_sim_step_lead(sim, far, PERIOD_S) == 1);
    for (int k = 0; k <= 250; k++) {
        const double way_m = (double)HD_STREAM_MAX_M_PER_S * PERIOD_S * k;

        hd_sim_reference(sim, reference);
        CHECK(near(reference[0], 0.6 * way_m) && near(reference[1], -0.8 * way_m));
        hd_sim_advance(sim, 1);
    }
    hd_sim_advance(sim, 1000);
    hd_sim_reference(sim, reference);
    CHECK(reference[0] == far[0] && reference[1] == far[1]);
    CHECK(hd_sim_step_lead(sim, near_by, 0.01) == 0);
    hd_sim_advance(sim, 50);
    CHECK(hd_sim_set_period(sim, &joystick, 2.0 * PERIOD_S) == HD_OK);
    hd_sim_reference(sim, reference);
    CHECK(near(reference[0], 0.03) && near(reference[1], -0.0395));
    hd_sim_advance(sim, 10);
    hd_sim_reference(sim, reference);
    CHECK(near(reference[1], -0.0393));
    hd_sim_advance(sim, 100000);
    hd_sim_reference(sim, reference);
    CHECK(reference[1] == near_by[1]);
    hd_sim_free(sim);
}

/* What was under way ends for it, not complete; and nobody is told of an end of its own. */
static void gestures(void) {
    const double waypoint[3] = {1.0, 0.01, 0.0};
    const double target[2] = {0.02, 0.0};
    struct hd_operator *path = hd_operator_new(waypoint, 1, HD_MINIMUM_JERK);
    struct hd_state *state = hd_state_new(1);
    struct hd_sim *sim = new_joystick();

    CHECK(path != NULL && state != NULL);
    hd_gesture_begin(state, sim, path, 0);
    hd_sim_advance(sim, 10);
    hd_gesture_watch(state, sim, 0);
    CHECK(state->event_count == 0);
    CHECK(hd_gesture_lead(state, sim, target, 0.1, 5) == 0);
    CHECK(state->event_count == 1 && state->events[0].kind == HD_EVENT_GESTURE_END && state->events[0].code == 0);
    hd_operator_free(path);
    hd_sim_advance(sim, 20000);
    hd_gesture_watch(state, sim, 0);
    CHECK(hd_gesture_lead(state, sim, target, 0.1, 5) == 0 && state->event_count == 1);
    hd_state_free(state);
    hd_sim_free(sim);
}

/* ---- A servo ------------------------------------------------------------------------------------------------- */

struct whole {
    struct hd_sim *sim;
    struct hd_servo *servo;
    struct hd_atomic_u32 done; /* nothing is sent any more */
    double before_n[2];
    uint64_t ticks;
    uint64_t streamed;
    int64_t times_ns[2]; /* of the samples before, the newest first */
    double largest_n;
    double worst;     /* step from one command to the next, of what is allowed */
    uint64_t ends[2]; /* of gestures: not complete, complete */
};

static void open_whole(struct whole *whole) {
    const struct hd_servo_config config = {
        .rate_hz = 1.0 / PERIOD_S,
        .cpu = -1,
        .slot_capacity = 1,
        .sample_capacity = 65536,
        .device_timeout_s = PATIENCE_S,
        .forces_on = 1,
        .stream_timeout_s = TIMEOUT_S,
        .overrun_threshold = 1.0,
    };
    struct hd_grant grant;
    struct bench bench;

    open_bench(&bench);
    *whole = (struct whole){.sim = new_joystick()};
    CHECK((whole->servo = hd_servo_new(&config, whole->sim, NULL)) != NULL);
    CHECK(hd_servo_publish(whole->servo, &bench.table) == HD_OK);
    CHECK(hd_servo_start(whole->servo, &grant) == HD_OK);
    close_bench(&bench);
}

static void close_whole(struct whole *whole) {
    CHECK(hd_servo_stop(whole->servo) == HD_OK);
    hd_servo_free(whole->servo);
    hd_sim_free(whole->sim);
}

/* No command is beyond the limit, and none far from the one before it: no more than the rule allows. */
static void drain(struct whole *whole) {
    struct hd_sample samples[256];
    struct hd_event events[64];
    uint64_t dropped;
    size_t count;

    while ((count = hd_servo_read_samples(whole->servo, samples, 256, &dropped)) > 0) {
        for (size_t i = 0; i < count; i++) {
            const double *force_n = samples[i].force_n;
            const double step_n = hypot(force_n[0] - whole->before_n[0], force_n[1] - whole->before_n[1]);
            const int follows = samples[i].tick == whole->ticks;

            CHECK((samples[i].flags & HD_FLAG_FAULT) == 0);
            whole->largest_n = fmax(whole->largest_n, hypot(force_n[0], force_n[1]));
            /* A stall longer than the ramp drops what is streamed: it comes back from zero at the same pace. Periods
             * are counted from when the tick before was due, which was no earlier than the tick before that. */
            const int stalled = (double)(samples[i].time_ns - whole->times_ns[1]) * 1e-9 > RAMP_S - 2.0 * PERIOD_S;
            const double from_zero_n = hypot(force_n[0], force_n[1]);
            const double moved_n = stalled ? fmin(step_n, from_zero_n) : step_n;

            whole->worst = fmax(whole->worst, follows ? moved_n / PACE_N : 0.0);
            whole->times_ns[1] = whole->times_ns[0];
            whole->times_ns[0] = samples[i].time_ns;
            whole->before_n[0] = force_n[0];
            whole->before_n[1] = force_n[1];
            whole->ticks = samples[i].tick + 1;
            whole->streamed += (samples[i].flags & HD_FLAG_STREAMED) != 0;
        }
    }
    while ((count = hd_servo_read_events(whole->servo, events, 64, &dropped)) > 0)
        for (size_t i = 0; i < count; i++)
            if (events[i].kind == HD_EVENT_GESTURE_END)
                whole->ends[events[i].code]++;
    hd_servo_beat(whole->servo);
}

static void counted(const struct whole *whole, uint32_t kind, struct hd_stream_counters *counters) {
    hd_servo_stream_counters(whole->servo, kind, counters);
}

/* Until it is so. */
#define AWAIT(whole, condition)                 \
    do {                                        \
        time_t until = time(NULL) + PATIENCE_S; \
        while (!(condition)) {                  \
            drain(whole);                       \
            sched_yield();                      \
            CHECK(time(NULL) < until);          \
        }                                       \
    } while (0)

/* As fast as it goes: jumps from limit to limit, and the hand all over the plane. */
static void *flood(void *argument) {
    struct whole *whole = argument;
    uint64_t random = 3;
    int64_t due_ns = hd_clock_now_ns();

    for (uint64_t i = 1; i <= SENT; i++) {
        const double force_n[2] = {(double)test_below(&random, 40) - 20.0, (double)test_below(&random, 40) - 20.0};
        const double at_m[2] = {0.001 * (double)test_below(&random, 90) - 0.045,
                                0.001 * (double)test_below(&random, 90) - 0.045};

        CHECK(hd_servo_stream(whole->servo, HD_STREAM_FORCE, 2 * i, force_n) == HD_OK);
        CHECK(hd_servo_stream(whole->servo, HD_STREAM_TARGET, 3 * i, at_m) == HD_OK);
        due_ns += test_below(&random, 1000) == 0 ? 50 * EVERY_NS : EVERY_NS;
        while (hd_clock_now_ns() < due_ns)
            sched_yield();
    }
    hd_atomic_u32_store_release(&whole->done, 1);
    return NULL;
}

/* Whatever is sent, and however fast: all of it is used or superseded, and the rule holds; then it ends by itself. */
static void flooded(void) {
    struct whole whole;
    struct hd_stream_counters force;
    struct hd_stream_counters target;
    pthread_t sender;

    open_whole(&whole);
    AWAIT(&whole, whole.ticks > 2 * RAMP_TICKS);
    CHECK(pthread_create(&sender, NULL, flood, &whole) == 0);
    while (!hd_atomic_u32_load_acquire(&whole.done)) {
        drain(&whole);
        counted(&whole, HD_STREAM_FORCE, &force);
        CHECK(force.seq % 2 == 0 && force.seq >= 2 * force.used && force.used + force.superseded <= SENT);
        sched_yield();
    }
    CHECK(pthread_join(sender, NULL) == 0);
    AWAIT(&whole, (counted(&whole, HD_STREAM_FORCE, &force), counted(&whole, HD_STREAM_TARGET, &target),
                   force.used + force.superseded == SENT && target.used + target.superseded == SENT));
    CHECK(force.seq == 2 * (uint64_t)SENT && target.seq == 3 * (uint64_t)SENT);
    CHECK(force.limited > 0 && force.limited <= force.used && target.limited > 0 && target.limited <= target.used);
    CHECK(target.tick > 0 && force.tick > 0);
    AWAIT(&whole, (counted(&whole, HD_STREAM_FORCE, &force), counted(&whole, HD_STREAM_TARGET, &target),
                   !force.active && !target.active));
    CHECK(force.timeouts >= 1 && target.timeouts >= 1);
    /* Nothing is left of it a ramp later, two from the limit. */
    const uint64_t ended = whole.ticks;
    AWAIT(&whole, whole.ticks > ended + 3 * RAMP_TICKS);
    CHECK(whole.before_n[0] == 0.0 && whole.before_n[1] == 0.0 && whole.streamed > 0);
    const uint64_t count = whole.streamed;
    AWAIT(&whole, whole.ticks > ended + 4 * RAMP_TICKS);
    CHECK(whole.streamed == count);
    CHECK(whole.worst <= 1.0 + 1e-9 && whole.largest_n <= LIMIT_N && whole.largest_n > 0.0);
    printf(
        "test_stream: ok, of %u values %llu forces and %llu targets used; steps of at most %.9f of what is allowed\n",
        SENT, (unsigned long long)force.used, (unsigned long long)target.used, whole.worst);
    close_whole(&whole);
}

/* A path and a stream of targets take each other's place, the later one the place of the earlier. */
static void turns(void) {
    const double waypoints[2][3] = {{0.0, 0.0, 0.0}, {1000.0, 0.001, 0.0}};
    struct hd_command command = {.kind = HD_COMMAND_OPERATOR};
    const double target_m[2] = {0.02, 0.01};
    struct hd_stream_counters counters;
    struct whole whole;
    uint64_t sequence;
    uint64_t tick;

    open_whole(&whole);
    CHECK((command.path = hd_operator_new(waypoints[0], 2, HD_LINEAR)) != NULL);
    CHECK(hd_servo_send(whole.servo, &command, 1, &sequence) == HD_OK);
    CHECK(hd_servo_wait_command(whole.servo, sequence, (int64_t)PATIENCE_S * 1000000000, &tick) == HD_OK);
    CHECK(hd_servo_stream(whole.servo, HD_STREAM_TARGET, 7, target_m) == HD_OK);
    AWAIT(&whole, whole.ends[0] == 1);
    counted(&whole, HD_STREAM_TARGET, &counters);
    CHECK(counters.used == 1 && counters.seq == 7 && counters.tick > tick && counters.superseded == 0);
    CHECK(hd_servo_send(whole.servo, &command, 1, &sequence) == HD_OK);
    CHECK(hd_servo_wait_command(whole.servo, sequence, (int64_t)PATIENCE_S * 1000000000, &tick) == HD_OK);
    drain(&whole);
    CHECK(whole.ends[0] == 1 && whole.ends[1] == 0);
    hd_operator_free(command.path);
    close_whole(&whole);
}

static void refuses(void) {
    static const double wrong[][2] = {
        {(double)NAN, 0.0}, {0.0, (double)NAN}, {(double)INFINITY, 0.0}, {0.0, -(double)INFINITY}};
    const double far_m[2] = {0.0, 1000.1};
    struct hd_stream_counters counters;
    struct whole whole;

    open_whole(&whole);
    for (uint32_t kind = 0; kind < HD_STREAMS; kind++)
        for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++)
            CHECK(hd_servo_stream(whole.servo, kind, 1, wrong[i]) == HD_ERR_INVALID);
    CHECK(hd_servo_stream(whole.servo, HD_STREAM_TARGET, 1, far_m) == HD_ERR_INVALID);
    CHECK(strstr(hd_invalid_reason(), "position_m[1]: 1000.1") != NULL);
    CHECK(hd_servo_stream(whole.servo, HD_STREAMS, 1, far_m) == HD_ERR_INVALID);
    CHECK(hd_servo_stream(whole.servo, HD_STREAM_FORCE, 1, far_m) == HD_OK);
    AWAIT(&whole, (counted(&whole, HD_STREAM_FORCE, &counters), counters.used == 1));
    counted(&whole, HD_STREAM_TARGET, &counters);
    CHECK(counters.used == 0 && counters.seq == 0 && counters.tick == 0 && !counters.active);
    close_whole(&whole);
}

int main(void) {
    spacing();
    polygon();
    limits();
    ends();
    drops();
    switches();
    other_rate();
    as_an_operator(1);
    as_an_operator(7);
    speed();
    gestures();
    refuses();
    turns();
    flooded();
    return 0;
}
