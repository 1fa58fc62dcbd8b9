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
#include "hd_torture.h"
#include "scene/hd_world.h"
#include "tick/hd_state.h"
#include "tick/hd_tick.h"

#define ROUNDING_N 1e-9
#define MOVING 4.0 /* the first order of a step of the hand, on flanks and edges */
#define BEGIN 500  /* ticks: the hand begins inside of things */

/* ---- The two ticks ------------------------------------------------------------------------------------------- */

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
    uint64_t streamed;
    uint64_t met; /* ticks in which the old scene meets or leaves something by itself, or ramps */
};

/* STREAMED: and a force is streamed meanwhile; it stands still with the ramps. MOVING_ON: nothing vibrates, and the
 * hand does not rest in the tick of a change. Then only this is sure: the command is near what the old scene would do,
 * or near what it was. */
enum manner { CHANGED, STREAMED, MOVING_ON };

static void run(uint64_t seed, double rate_hz, uint64_t ticks, uint64_t changes, enum manner manner,
                struct outcome *outcome) {
    const int moving = manner == MOVING_ON;
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
        if (manner == STREAMED)
            stream(&torture);
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
        outcome->streamed += (sample.flags & HD_FLAG_STREAMED) != 0;
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

    run(seed, 10000.0, ticks - ticks / 5, changes - changes / 5, CHANGED, &outcome);
    run(seed + 1, 1000.0, ticks / 5, changes / 5, CHANGED, &outcome);
    run(seed + 5, 10000.0, ticks / 2, changes / 2, STREAMED, &outcome);
    run(seed + 6, 1000.0, ticks / 8, changes / 8, STREAMED, &outcome);
    run(seed + 4, 10000.0, ticks / 4, changes, MOVING_ON, &outcome);
    rest(seed + 2, 10000.0, ticks / 2, &outcome);
    rest(seed + 3, 1000.0, ticks / 8, &outcome);
    for (uint64_t i = 0; i < 12; i++)
        still_ringing += unfelt(seed + 10 + i, 20000);
    CHECK(still_ringing > 0 && outcome.streamed > ticks / 10);
    printf(
        "test_ramp: %llu ticks, %llu at rest, %llu changes, %llu strikes; %llu with a force, %llu at the limit, %llu "
        "ringing, %llu ramping, %llu streamed, %llu left out; at most %.6f of what is allowed, at rest %.6f, moving "
        "%.6f\n",
        (unsigned long long)ticks, (unsigned long long)outcome.resting, (unsigned long long)outcome.changes,
        (unsigned long long)outcome.strikes, (unsigned long long)outcome.forceful,
        (unsigned long long)outcome.saturated, (unsigned long long)outcome.ringing, (unsigned long long)outcome.ramping,
        (unsigned long long)outcome.streamed, (unsigned long long)outcome.met, outcome.worst, outcome.worst_resting,
        outcome.worst_moving);
    if (argc > 1)
        for (int i = 0; i <= CHANGES; i++)
            printf("  %-16s %.6f\n", names[i], outcome.worst_of[i]);
    CHECK(outcome.worst <= 1.0 && outcome.worst_resting <= 1.0 && outcome.worst_moving <= MOVING);
    return 0;
}
