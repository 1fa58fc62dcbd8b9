/* Strikes that the device plays by itself. First what a sender makes of them, report by report; then the whole way in
 * three threads, a servo's strikes and silences, a writer and a control that changes the effects; then a connection; at
 * last the tick, which counts what may be playing against the force limit: random strikes against a hand that presses,
 * with effects that begin as late as they may. */
#include <math.h>
#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "base/hd_clock.h"
#include "device/hd_effects.h"
#include "device/hd_hid.h"
#include "hd_test.h"
#include "tick/hd_limit.h"
#include "tick/hd_tick.h"

#define PATIENCE_S 300
#define MS 1000000ll
#define DURATION_NS (20 * MS)

static uint64_t seed = 7;

static double uniform(double low, double high) {
    return low + (high - low) * (double)(test_random(&seed) >> 11) * 0x1p-53;
}

/* Effect `id` at `place`: reports 20 (direction, 0 to 255), 21 (a level, 10 counts a newton), 22 (another one, from -50
 * to 50 at 7), 23 (start), and 24 to stop it; all of them carry the place. */
static struct hd_device_effect effect(uint32_t id, uint32_t place) {
    struct hd_device_effect made = {.id = id,
                                    .place = place,
                                    .message_count = 4,
                                    .duration_ns = DURATION_NS,
                                    .least_n = 0.05,
                                    .most_n = 8.0,
                                    .stop = {.length = 2}};

    for (uint8_t i = 0; i < 4; i++) {
        made.messages[i] = (struct hd_hid_message){.length = i < 3 ? 3 : 2, .value_count = i < 3};
        made.messages[i].bytes[0] = (uint8_t)(20 + i);
        made.messages[i].bytes[1] = (uint8_t)place;
    }
    made.messages[0].values[0] =
        (struct hd_hid_value){{8, 8, 0, 0}, HD_HID_DIRECTION, 0, 256.0 / 6.283185307179586, 0.0, 0.0, 255.0, 0.0};
    made.messages[1].values[0] = (struct hd_hid_value){{8, 8, 0, 0}, HD_HID_MAGNITUDE, 0, 10.0, 0.0, 0.0, 100.0, 0.0};
    made.messages[2].values[0] = (struct hd_hid_value){{8, 8, 1, 0}, HD_HID_MAGNITUDE, 0, 5.0, 7.0, -50.0, 50.0, 0.0};
    made.stop.bytes[0] = 24;
    made.stop.bytes[1] = (uint8_t)place;
    return made;
}

struct bench {
    struct hd_effect_queue queue;
    struct hd_effect_sender sender;
    int64_t now_ns;
    int64_t since_ns;
    int open;
};

static struct bench *bench_new(uint32_t count) {
    struct bench *bench = aligned_alloc(HD_CACHE_LINE, sizeof *bench);
    struct hd_device_effects effects = {.count = count};

    CHECK(bench != NULL);
    memset(bench, 0, sizeof *bench);
    for (uint32_t i = 0; i < count; i++)
        effects.effects[i] = effect(101 + i, i);
    hd_effect_queue_init(&bench->queue);
    hd_effect_sender_init(&bench->sender, &bench->queue);
    CHECK(hd_effect_sender_set(&bench->sender, &effects) == HD_OK);
    bench->now_ns = 1000 * MS;
    bench->since_ns = 1;
    bench->open = 1;
    return bench;
}

static void strike(struct bench *bench, uint32_t id, double x, double y) {
    CHECK(hd_effect_queue_put(&bench->queue, bench->now_ns, id, (double[2]){x, y}) == HD_OK);
}

static void expect(struct bench *bench, int report, int place, int value) {
    uint8_t bytes[HD_HID_REPORT_BYTES];
    const uint32_t length =
        hd_effect_sender_next(&bench->sender, &bench->queue, bench->now_ns, bench->since_ns, bench->open, bytes);

    if (report == 0) {
        CHECK(length == 0);
        return;
    }
    CHECK(length == (value < 0 ? 2 : 3) && bytes[0] == report && bytes[1] == place);
    CHECK(value < 0 || bytes[2] == value);
}

static uint64_t lost(const struct bench *bench) {
    return hd_effect_queue_lost(&bench->queue);
}

/* Where nobody would tell that the effect is gone, all of it is sent with each strike. */
static void what_is_sent_whole(void) {
    struct bench *bench = bench_new(2);

    for (int i = 0; i < 4; i++) {
        bench->sender.unsure = i != 2;
        strike(bench, 102, 0.0, -4.0);
        if (i != 2) {
            expect(bench, 20, 1, 0);
            expect(bench, 21, 1, 40);
            expect(bench, 22, 1, 27);
        }
        expect(bench, 23, 1, -1);
        expect(bench, 0, 0, 0);
    }
    free(bench);
}

static void what_is_sent(void) {
    struct bench *bench = bench_new(2);

    expect(bench, 0, 0, 0);
    strike(bench, 102, 0.0, -4.0); /* a force downwards comes from above: 0 */
    expect(bench, 20, 1, 0);
    expect(bench, 21, 1, 40);
    expect(bench, 22, 1, 27);
    expect(bench, 23, 1, -1);
    expect(bench, 0, 0, 0);
    strike(bench, 102, 0.0, -4.0); /* the same again */
    expect(bench, 23, 1, -1);
    strike(bench, 102, 0.12, -4.0); /* two degrees are none */
    expect(bench, 23, 1, -1);
    strike(bench, 102, 0.0, 3.0);
    expect(bench, 20, 1, 128);
    expect(bench, 21, 1, 30);
    expect(bench, 22, 1, 22);
    expect(bench, 23, 1, -1);
    strike(bench, 101, 0.0, 3.0); /* the other one knows nothing yet */
    strike(bench, 102, -0.02, 3.0);
    expect(bench, 20, 0, 128);
    expect(bench, 21, 0, 30);
    expect(bench, 22, 0, 22);
    expect(bench, 23, 0, -1);
    expect(bench, 23, 1, -1);
    strike(bench, 101, 0.0, 0.04); /* nothing to the device, and no reason to cut short what it plays */
    strike(bench, 101, 0.0, 0.0);
    strike(bench, 101, (double)NAN, 1.0);
    strike(bench, 101, 1.0, (double)INFINITY);
    expect(bench, 0, 0, 0);
    CHECK(lost(bench) == 0);
    strike(bench, 101, 0.0, 8e6); /* stronger than it can be played, all of it in one proportion */
    expect(bench, 21, 0, 80);
    expect(bench, 22, 0, 47);
    expect(bench, 23, 0, -1);
    CHECK(hd_atomic_u64_load_relaxed(&bench->queue.played) == 7);
    free(bench);
}

static void what_is_not(void) {
    struct bench *bench = bench_new(1);
    struct hd_device_effects none = {.count = 0};

    strike(bench, 77, 1.0, 0.0);
    expect(bench, 0, 0, 0);
    CHECK(lost(bench) == 1);
    bench->open = 0;
    strike(bench, 101, 0.0, -1.0);
    expect(bench, 0, 0, 0);
    bench->open = 1;
    expect(bench, 0, 0, 0);
    CHECK(lost(bench) == 2);
    strike(bench, 101, 0.0, -1.0); /* grows old on its way */
    expect(bench, 20, 0, 0);
    bench->now_ns += HD_EFFECT_AGE_NS + 1;
    expect(bench, 0, 0, 0);
    CHECK(lost(bench) == 3);
    strike(bench, 101, 0.0, -1.0); /* the forces fade before it is started: nothing to be stopped */
    expect(bench, 21, 0, 10);
    hd_effect_queue_silence(&bench->queue);
    strike(bench, 101, 0.0, -1.0); /* of after that */
    expect(bench, 22, 0, 12);
    expect(bench, 23, 0, -1);
    CHECK(lost(bench) == 4);
    strike(bench, 101, 0.0, -1.0);
    hd_effect_queue_silence(&bench->queue);
    hd_effect_queue_silence(&bench->queue);
    expect(bench, 24, 0, -1); /* what plays is stopped, once */
    expect(bench, 0, 0, 0);
    CHECK(lost(bench) == 5);
    hd_effect_queue_silence(&bench->queue);
    expect(bench, 0, 0, 0);
    strike(bench, 101, 0.0, -1.0); /* has long ended by itself */
    expect(bench, 23, 0, -1);
    expect(bench, 0, 0, 0);
    bench->now_ns += 1000 * MS;
    hd_effect_queue_silence(&bench->queue);
    expect(bench, 0, 0, 0);
    strike(bench, 101, 0.0, -1.0); /* from before the effects were made anew */
    bench->now_ns += MS;
    bench->since_ns = bench->now_ns;
    expect(bench, 0, 0, 0);
    CHECK(lost(bench) == 6);
    strike(bench, 101, 0.0, -1.0); /* and they know nothing any more */
    expect(bench, 20, 0, 0);
    expect(bench, 21, 0, 10);
    CHECK(hd_effect_sender_set(&bench->sender, &none) == HD_OK); /* one that is under way is not torn */
    expect(bench, 22, 0, 12);
    expect(bench, 23, 0, -1);
    strike(bench, 101, 0.0, -1.0);
    expect(bench, 0, 0, 0);
    CHECK(lost(bench) == 7);
    hd_effect_queue_silence(&bench->queue);
    expect(bench, 24, 0, -1);
    for (uint32_t i = 0; i < HD_EFFECT_QUEUE_CAPACITY; i++)
        strike(bench, 101, 0.0, -1.0);
    CHECK(hd_effect_queue_put(&bench->queue, bench->now_ns, 101, (double[2]){0.0, 1.0}) == HD_ERR_FULL);
    CHECK(lost(bench) == 8);
    free(bench);
}

/* What plays is stopped wherever it could go on unseen. */
static void what_is_stopped(void) {
    struct bench *bench = bench_new(2);

    for (int i = 0; i < 3; i++) {
        strike(bench, 102, 0.0, -1.0);
        expect(bench, 20, 1, 0);
        expect(bench, 21, 1, 10);
        expect(bench, 22, 1, 12);
        expect(bench, 23, 1, -1);
        switch (i) {
        case 0: /* its start took a second to write, so that it has only just begun */
            bench->now_ns += 1000 * MS;
            hd_effect_queue_silence(&bench->queue);
            break;
        case 1: /* a pause, which would hold it */
            bench->open = 0;
            break;
        default: /* one that was over before the writer saw it */
            bench->now_ns += MS;
            bench->since_ns = bench->now_ns;
            break;
        }
        expect(bench, 24, 1, -1);
        expect(bench, 0, 0, 0);
        bench->open = 1;
        bench->now_ns += MS;
        bench->since_ns = bench->now_ns;
        expect(bench, 0, 0, 0);
    }
    free(bench);
}

/* Whatever is put, the counts lie within the limits of the plan. */
static void range(void) {
    struct bench *bench = bench_new(HD_DEVICE_EFFECTS);

    for (int i = 0; i < 300000; i++) {
        const double size = exp(uniform(-60.0, 60.0));
        uint8_t bytes[HD_HID_REPORT_BYTES];
        uint32_t length;

        strike(bench, 101 + (uint32_t)test_below(&seed, HD_DEVICE_EFFECTS), size * uniform(-1.0, 1.0),
               size * uniform(-1.0, 1.0));
        while ((length = hd_effect_sender_next(&bench->sender, &bench->queue, bench->now_ns, bench->since_ns, 1,
                                               bytes)) > 0) {
            CHECK(bytes[1] < HD_DEVICE_EFFECTS);
            CHECK(bytes[0] != 21 || bytes[2] <= 80);
            CHECK(bytes[0] != 22 || ((int8_t)bytes[2] >= 7 && (int8_t)bytes[2] <= 47));
        }
    }
    CHECK(lost(bench) == 0);
    free(bench);
}

static void refusals(void) {
    struct bench *bench = bench_new(1);
    struct hd_device_effects good = {.count = 1};

    good.effects[0] = effect(1, 0);
#define REFUSES(change)                                                          \
    do {                                                                         \
        struct hd_device_effects effects = good;                                 \
        change;                                                                  \
        CHECK(hd_effect_sender_set(&bench->sender, &effects) == HD_ERR_INVALID); \
    } while (0)
    REFUSES(effects.count = HD_DEVICE_EFFECTS + 1);
    REFUSES(effects.effects[0].id = 0);
    REFUSES(effects.effects[0].place = HD_DEVICE_EFFECTS);
    REFUSES(effects.effects[0].duration_ns = 0);
    REFUSES(effects.effects[0].duration_ns = 300 * MS);
    REFUSES(effects.effects[0].most_n = (double)NAN);
    REFUSES(effects.effects[0].least_n = 9.0);
    REFUSES(effects.effects[0].message_count = 0);
    REFUSES(effects.effects[0].message_count = HD_DEVICE_EFFECT_MESSAGES + 1);
    REFUSES(effects.effects[0].messages[1].length = 2);
    REFUSES(effects.effects[0].messages[2].values[0].counts_per_unit = (double)NAN);
    REFUSES(effects.effects[0].stop.length = 0);
    REFUSES(effects.effects[0].stop.value_count = 1);
#undef REFUSES
    CHECK(hd_effect_sender_set(&bench->sender, &good) == HD_OK);
    free(bench);
}

/* ---- Threads ----------------------------------------------------------------------------------------------------- */

#define ROUNDS 200000u /* at the least */

static struct hd_atomic_u32 over;
static struct hd_atomic_u32 begun; /* the device has started a strike */
static uint32_t rounds;            /* written by the servo, read after the join */

/* A strike of effect 1 + k carries k in its strength, until the next silence, whose parity its direction carries. */
static void *servo_main(void *argument) {
    struct bench *bench = argument;
    uint32_t silences = 0;

    for (uint32_t i = 0; i < ROUNDS || !hd_atomic_u32_load_relaxed(&begun); i++) {
        const uint32_t k = i % HD_DEVICE_EFFECTS;

        if (i % 64 == 63) {
            hd_effect_queue_silence(&bench->queue);
            silences++;
        }
        hd_effect_queue_put(&bench->queue, bench->now_ns, 1 + k,
                            (double[2]){0.0, (double)(k + 1) * (silences % 2 ? 0.9 : -0.9)});
        rounds++;
        if (i % 16 == 0)
            sched_yield();
    }
    hd_atomic_u32_store_release(&over, 1);
    return NULL;
}

static void *control_main(void *argument) {
    struct bench *bench = argument;
    uint64_t random = 3;

    while (!hd_atomic_u32_load_acquire(&over)) {
        struct hd_device_effects effects = {.count = HD_DEVICE_EFFECTS};
        const uint32_t turn = (uint32_t)test_below(&random, HD_DEVICE_EFFECTS);

        for (uint32_t k = 0; k < HD_DEVICE_EFFECTS; k++)
            effects.effects[k] = effect(1 + k, (k + turn) % HD_DEVICE_EFFECTS);
        CHECK(hd_effect_sender_set(&bench->sender, &effects) == HD_OK);
        sched_yield();
    }
    return NULL;
}

static void threads(void) {
    struct bench *bench = bench_new(0);
    uint8_t sent[HD_DEVICE_EFFECTS][5] = {{0}}; /* what the device knows of each place, by report */
    uint64_t starts = 0;
    uint32_t length;
    pthread_t servo;
    pthread_t control;
    int ends = 0;

    CHECK(pthread_create(&servo, NULL, servo_main, bench) == 0);
    CHECK(pthread_create(&control, NULL, control_main, bench) == 0);
    do {
        uint8_t bytes[HD_HID_REPORT_BYTES];

        ends = hd_atomic_u32_load_acquire(&over) != 0;
        while ((length = hd_effect_sender_next(&bench->sender, &bench->queue, bench->now_ns, 1, 1, bytes)) > 0) {
            uint8_t *known = sent[bytes[1]];

            CHECK(bytes[0] >= 20 && bytes[0] <= 24 && bytes[1] < HD_DEVICE_EFFECTS);
            if (length == 3)
                known[bytes[0] - 20] = bytes[2];
            if (bytes[0] == 23) {
                /* Both levels are of one strike, and it came from where the device thinks. */
                const int k = known[1] / 9 - 1;

                CHECK(known[1] == 9 * (k + 1) && k >= 0 && k < HD_DEVICE_EFFECTS);
                CHECK(known[2] == (uint8_t)rint(4.5 * (k + 1) + 7.0));
                CHECK(known[0] == 0 || known[0] == 128);
                CHECK(known[0] == (bench->sender.strike.silence % 2 ? 128 : 0));
                starts++;
                hd_atomic_u32_store_relaxed(&begun, 1);
            }
        }
    } while (!ends);
    pthread_join(servo, NULL);
    pthread_join(control, NULL);
    CHECK(starts > 0 && starts == hd_atomic_u64_load_relaxed(&bench->queue.played));
    CHECK(starts + lost(bench) == rounds);
    free(bench);
}

/* ---- A connection ------------------------------------------------------------------------------------------------ */

static void hear(int fd, const uint8_t *wanted, ssize_t length) {
    uint8_t bytes[HD_HID_REPORT_BYTES];

    CHECK(recv(fd, bytes, sizeof bytes, 0) == length);
    CHECK(memcmp(bytes, wanted, (size_t)length) == 0);
}

#define HEAR(fd, ...) hear(fd, (const uint8_t[]){__VA_ARGS__}, (ssize_t)sizeof((const uint8_t[]){__VA_ARGS__}))

/* Whether the effect is stopped. 0: the machine was so slow that it had ended by itself; what follows is not known
 * then.
 */
static int stopped(int fd) {
    struct pollfd polled = {.fd = fd, .events = POLLIN};

    if (poll(&polled, 1, 1000) == 0)
        return 0;
    HEAR(fd, 24, 3);
    return 1;
}

/* 0: not known. */
static int play_over(struct hd_hid *hid, int fd) {
    const int64_t later_ns = hd_clock_now_ns() + PATIENCE_S * 1000 * MS; /* so that no strike grows old */
    const double up[2] = {0.0, 2.0};
    struct hd_device_effects effects = {.count = 1, .effects = {effect(9, 3)}};
    struct hd_hid_status status;

    HEAR(fd, 5, 0);
    CHECK(!hd_hid_step_has_effects(hid));
    effects.effects[0].id = 0;
    CHECK(hd_hid_set_effects(hid, &effects) == HD_ERR_INVALID && !hd_hid_step_has_effects(hid));
    effects.effects[0].id = 9;
    CHECK(hd_hid_set_effects(hid, &effects) == HD_OK && hd_hid_step_has_effects(hid));
    hd_hid_step_strike(hid, later_ns, 9, up);
    HEAR(fd, 20, 3, 128);
    HEAR(fd, 21, 3, 20);
    HEAR(fd, 22, 3, 17);
    HEAR(fd, 23, 3);
    hd_hid_step_silence(hid);
    if (!stopped(fd))
        return 0;
    hd_hid_step_strike(hid, later_ns, 9, up);
    HEAR(fd, 23, 3);
    CHECK(send(fd, (const uint8_t[]){2, 1}, 2, 0) == 2); /* reset: its effects are gone, or they were paused */
    if (!stopped(fd))
        return 0;
    CHECK(hd_hid_wait(hid, PATIENCE_S * 1000 * MS) == 1);
    hd_hid_step_strike(hid, later_ns, 9, up);
    do {
        sched_yield();
        hd_hid_status(hid, &status);
    } while (status.strikes_lost == 0);
    CHECK(status.reset && status.strikes == 2 && status.strikes_lost == 1);
    hd_hid_clear_reset(hid);
    do { /* the force comes back over 20 ms, and so long strikes are lost */
        hd_hid_step_strike(hid, later_ns, 9, up);
        sched_yield();
        hd_hid_status(hid, &status);
    } while (status.strikes == 2);
    HEAR(fd, 20, 3, 128);
    HEAR(fd, 21, 3, 20);
    HEAR(fd, 22, 3, 17);
    HEAR(fd, 23, 3);
    return 1;
}

static int connection(void) {
    const struct hd_hid_plan plan = {
        .axes = {{.field = {0, 16, 1, 0}, .report_id = 1, .m_per_count = {1e-5, 1e-5}},
                 {.field = {16, 16, 1, 0}, .report_id = 1, .m_per_count = {-1e-5, -1e-5}}},
        .states = {{{0, 1, 0, 0}, 2, HD_HID_RESET}},
        .state_count = 1,
        .force = {.count = 1, .messages = {{.length = 2, .bytes = {5, 0}}}},
        .stop = {.count = 1, .messages = {{.length = 2, .bytes = {8, 1}}}},
    };
    const struct hd_device_effects effects = {.count = 1, .effects = {effect(9, 3)}};
    struct hd_hid *hid = hd_hid_new();
    int fds[2];
    int known;

    CHECK(hid != NULL && hd_hid_set_effects(hid, &effects) == HD_OK && !hd_hid_step_has_effects(hid));
    hd_hid_set_parting(hid, PATIENCE_S * 1000 * MS);
    CHECK(socketpair(AF_UNIX, SOCK_SEQPACKET, 0, fds) == 0);
    CHECK(hd_hid_connect(hid, &plan, fds[0], 0) == HD_OK);
    known = play_over(hid, fds[1]);
    CHECK(hd_hid_disconnect(hid, 1) == 0 && !hd_hid_step_has_effects(hid));
    CHECK(hd_hid_set_effects(hid, &effects) == HD_OK && !hd_hid_step_has_effects(hid));
    hd_hid_free(hid);
    close(fds[0]);
    close(fds[1]);
    return known;
}

#define PERIOD_S 1e-3
#define MAX_N 6.0

static struct hd_table empty_table(void) {
    return (struct hd_table){.revision = 1,
                             .display_force = 1,
                             .display_vibration = 1,
                             .all_changed = 1,
                             .period_s = PERIOD_S,
                             .max_force_n = MAX_N,
                             .max_speed_m_per_s = 1000.0,
                             .ramp_s = 0.005,
                             .ramp_step = PERIOD_S / 0.005};
}

/* What plays is stopped when the vibration is switched off, as when the forces are. */
static void without_vibration(void) {
    const struct hd_hid_plan plan = {
        .axes = {{.field = {0, 16, 1, 0}, .report_id = 1, .m_per_count = {1e-5, 1e-5}},
                 {.field = {16, 16, 1, 0}, .report_id = 1, .m_per_count = {-1e-5, -1e-5}}},
        .on_change = 1,
    };
    const struct hd_servo_config config = {.stream_timeout_s = 0.02,
                                           .device_timeout_s = PATIENCE_S,
                                           .rate_hz = 1.0 / PERIOD_S,
                                           .cpu = -1,
                                           .slot_capacity = 1,
                                           .sample_capacity = 64,
                                           .resolution_m = 1e-5,
                                           .forces_on = 1};
    struct hd_table table = empty_table();
    const struct hd_command play = {.kind = HD_COMMAND_PLAY,
                                    .revision = 1,
                                    .direction = {0.0, 1.0},
                                    .amplitude = 1.0,
                                    .mode = {.rotor_re = 0.5,
                                             .decay_rate_per_s = 700.0,
                                             .angular_frequency_rad_per_s = 400.0,
                                             .end_s = 0.007,
                                             .peak = 0.2,
                                             .peak_time_s = 1e-3,
                                             .effect = 9,
                                             .effect_force_per_unit = 2.0,
                                             .effect_peak = 1.0,
                                             .effect_s = 0.02}};
    const struct hd_command on = {.kind = HD_COMMAND_FORCES, .revision = 1, .value = 1};
    struct hd_device_effects effects = {.count = 1, .effects = {effect(9, 3)}};
    struct hd_counters counters;
    struct hd_hid *hid = hd_hid_new();
    struct hd_servo *servo = hd_servo_new(&config, NULL, hid);
    struct hd_hid_status status = {.strikes = 0};
    uint8_t bytes[HD_HID_REPORT_BYTES];
    struct hd_grant grant;
    uint64_t sequence;
    uint64_t tick;
    int stopped = 0;
    int fds[2];

    effects.effects[0].duration_ns = 200 * MS;
    CHECK(servo != NULL && hd_servo_publish(servo, &table) == HD_OK);
    CHECK(socketpair(AF_UNIX, SOCK_SEQPACKET, 0, fds) == 0);
    CHECK(send(fds[1], (const uint8_t[]){1, 0, 0, 0, 0}, 5, 0) == 5);
    CHECK(hd_hid_connect(hid, &plan, fds[0], 0) == HD_OK && hd_hid_set_effects(hid, &effects) == HD_OK);
    CHECK(hd_servo_start(servo, &grant) == HD_OK);
    while (!stopped) { /* again, where all of this was so slow that the effect had ended */
        struct pollfd polled = {.fd = fds[1], .events = POLLIN};
        const uint64_t before = status.strikes;

        do { /* until the forces are on and one is in time */
            CHECK(hd_servo_send(servo, &play, 1, &sequence) == HD_OK);
            CHECK(hd_servo_wait_command(servo, sequence, PATIENCE_S * 1000 * MS, &tick) == HD_OK);
            hd_servo_beat(servo);
            hd_servo_counters(servo, &counters);
            if (counters.faults != 0) /* the machine kept this thread from its beats */
                CHECK(hd_servo_send(servo, &on, 1, &sequence) == HD_OK);
            hd_hid_status(hid, &status);
        } while (status.strikes == before);
        for (uint32_t shown = 0; shown < 2; shown++) {
            table.revision++;
            table.display_vibration = shown;
            CHECK(hd_servo_publish(servo, &table) == HD_OK);
            CHECK(hd_servo_wait_revision(servo, table.revision, PATIENCE_S * 1000 * MS, &tick) == HD_OK);
        }
        while (!stopped && poll(&polled, 1, 100) > 0) {
            CHECK(recv(fds[1], bytes, sizeof bytes, 0) >= 2);
            stopped = bytes[0] == 24 && bytes[1] == 3;
        }
    }
    CHECK(hd_servo_stop(servo) == HD_OK);
    hd_servo_free(servo);
    hd_hid_free(hid);
    close(fds[0]);
    close(fds[1]);
}

/* ---- The tick ---------------------------------------------------------------------------------------------------- */

#define TICKS 200000
#define MODES 3u

static struct hd_mode mode(uint32_t id) {
    return (struct hd_mode){.rotor_re = 0.5,
                            .decay_rate_per_s = 700.0,
                            .angular_frequency_rad_per_s = 400.0,
                            .end_s = 0.007,
                            .peak = 0.2,
                            .peak_time_s = 1e-3,
                            .amplitude_per_unit = 300.0,
                            .gain_re = 1.0,
                            .effect = id,
                            .effect_force_per_unit = 1.0,
                            .effect_peak = 1.0 + 0.25 * id,
                            .effect_s = 0.01 * id};
}

/* One tick with the probe `depth_m` below the floor. */
static void tick(const struct hd_world *world, struct hd_state *state, double depth_m, struct hd_sample *sample) {
    const struct hd_reading reading = {.position_m = {0.0, -depth_m}, .interval_s = PERIOD_S};
    const double still[2] = {0.0, 0.0};
    struct hd_input input = {.periods = 1};

    hd_sense(state, &world->table, &reading, still, &input);
    hd_tick(world, state, &input, sample);
}

struct playing {
    double most_n;
    int from;
    int until;
};

/* The device begins a strike as late as it may, and plays the one before until then. */
static void within_the_limit(void) {
    struct hd_material material = {.stiffness_n_per_m = 1000.0};
    struct hd_object wall = {.shape = HD_SHAPE_WALL, .normal = {0.0, 1.0}};
    struct hd_table table = empty_table();
    static struct playing playing[MODES + 1][256]; /* strikes of each effect, the newest last */
    int counts[MODES + 1] = {0};
    struct hd_world *world = hd_world_new();
    struct hd_state *state = hd_state_new(1);
    double depth_m = 0.0;
    uint64_t offloaded = 0;
    uint64_t full = 0;
    uint64_t quiet = 0;

    table.objects = &wall;
    table.materials = &material;
    table.object_count = table.material_count = 1;
    CHECK(world != NULL && state != NULL && hd_world_load(world, &table) == HD_OK);
    CHECK(hd_state_reserve(state, 1) == HD_OK);
    for (int i = 0; i < TICKS; i++) {
        const double direction[2] = {0.6, 0.8};
        const int open = i / 500 % 4 != 3;
        struct hd_sample sample;
        double sum = 0.0;

        state->offload_open = (uint8_t)open;
        if (i % 1700 == 1600)
            hd_state_enable(state, 0);
        if (i % 1700 == 1650)
            hd_state_enable(state, 1);
        depth_m = fmax(-0.001, fmin(0.008, depth_m + uniform(-4e-4, 4e-4)));
        for (uint32_t k = 1; k <= MODES; k++) {
            const struct hd_mode played = mode(k);

            if (test_below(&seed, 40) == 0)
                CHECK(hd_tick_play(state, &played, direction, uniform(0.0, 2.5)) == HD_OK);
        }
        const int fully = state->enabled && state->gain == 1.0;
        tick(world, state, depth_m, &sample);
        CHECK(open || state->offload_count == 0);
        CHECK(fully || state->offload_count == 0);
        CHECK(state->active_mode_count == 0); /* these modes are muted: they ring on the device or not at all */
        for (uint32_t n = 0; n < state->offload_count; n++) {
            const struct hd_offload *struck = &state->offloads[n];
            const struct hd_mode played = mode(struck->effect);
            const double size = hypot(struck->force_n[0], struck->force_n[1]);
            struct playing *before = playing[struck->effect];
            int *count = &counts[struck->effect];
            const int from = i + (int)(0.06 / PERIOD_S);

            CHECK(size == 0.0 || fabs(struck->force_n[0] / size - 0.6) < 1e-12);
            if (*count == 256) {
                memmove(before, before + 1, 255 * sizeof *before);
                --*count;
            }
            if (*count > 0 && before[*count - 1].until >= from)
                before[*count - 1].until = from - 1;
            before[(*count)++] = (struct playing){
                .most_n = size * played.effect_peak, .from = from, .until = from + (int)(played.effect_s / PERIOD_S)};
            offloaded++;
        }
        state->offload_count = 0;
        for (uint32_t k = 1; k <= MODES; k++)
            for (int n = 0; n < counts[k]; n++)
                if (playing[k][n].from <= i && i <= playing[k][n].until)
                    sum = sum + playing[k][n].most_n;
        CHECK(hypot(sample.force_n[0], sample.force_n[1]) + sum <= MAX_N * (1.0 + 1e-12));
        full += sum > 0.0 && hypot(sample.force_n[0], sample.force_n[1]) + sum > 0.9 * MAX_N;
        quiet += state->reserve_count == 0;
        CHECK(state->reserve_count > 0 || state->reserved_n == 0.0);
        state->event_count = 0;
    }
    CHECK(offloaded > 5000 && full > 100 && quiet > 100);
    hd_world_free(world);
    hd_state_free(state);
}

/* A mode that is carried, too, is an active mode wherever the device does not play it. */
static void carried_modes(void) {
    const struct hd_table table = empty_table();
    struct hd_world *world = hd_world_new();
    struct hd_state *state = hd_state_new(1);
    struct hd_mode both = mode(1);
    struct hd_sample sample;

    both.force_per_unit = 0.5;
    CHECK(world != NULL && state != NULL && hd_world_load(world, &table) == HD_OK);
    tick(world, state, 0.0, &sample);
    CHECK(hd_tick_play(state, &both, (const double[2]){1.0, 0.0}, 1.0) == HD_OK);
    tick(world, state, 0.0, &sample);
    CHECK(state->active_mode_count == 1 && state->offload_count == 0 && state->reserved_n == 0.0);
    state->offload_open = 1;
    CHECK(hd_tick_play(state, &both, (const double[2]){1.0, 0.0}, 1.0) == HD_OK);
    tick(world, state, 0.0, &sample);
    CHECK(state->active_mode_count == 1 && state->offload_count == 1 && state->offloads[0].effect == 1);
    CHECK(state->offloads[0].force_n[0] == 1.0 && state->reserved_n == 1.25);
    /* More in one tick than there is room for: the rest rings. */
    state->offload_count = 0;
    for (uint32_t i = 0; i < HD_OFFLOAD_CAPACITY + 3; i++) {
        both.effect = 1 + i % 4;
        CHECK(hd_tick_play(state, &both, (const double[2]){1.0, 0.0}, 0.01) == HD_OK);
    }
    tick(world, state, 0.0, &sample);
    CHECK(state->offload_count == HD_OFFLOAD_CAPACITY && state->reserve_count == 4);
    hd_world_free(world);
    hd_state_free(state);
}

int main(void) {
    alarm(PATIENCE_S);
    what_is_sent();
    what_is_sent_whole();
    what_is_not();
    what_is_stopped();
    range();
    refusals();
    threads();
    while (!connection()) {
    }
    without_vibration();
    within_the_limit();
    carried_modes();
    printf("test_offload: ok\n");
    return 0;
}
