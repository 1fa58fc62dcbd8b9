/* A connection, over a socket pair that keeps message bounds as hidraw does: the other end is the device. First the
 * mailboxes alone, with this thread in the servo's place; then a whole servo, led by its timer and by the device's
 * reports, that loses its device in the middle of a contact and gets another. What is asserted is what is sent and in
 * which order, never when; a defect hangs until the alarm. */
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "base/hd_atomic.h"
#include "base/hd_clock.h"
#include "device/hd_hid.h"
#include "hd_test.h"

#define PATIENCE_S 300
#define PATIENCE_NS (PATIENCE_S * 1000000000ll)
#define OURS 0
#define DEVICE 1

/* Report 1: x and y, 16 bits, 10 um a count; y grows downwards. Report 2: five states, one bit each. Force: one message
 * an axis, 5 and 6, 100 counts a newton. */
static const struct hd_hid_plan plan = {
    .axes = {{.field = {0, 16, 1, 0}, .report_id = 1, .m_per_count = {1e-5, 1e-5}},
             {.field = {16, 16, 1, 0}, .report_id = 1, .m_per_count = {-1e-5, -1e-5}}},
    .states = {{{0, 1, 0, 0}, 2, HD_HID_RESET}, {{1, 1, 0, 0}, 2, HD_HID_ACTUATORS}, {{2, 1, 0, 0}, 2, HD_HID_PAUSED}},
    .state_count = 3,
    .force = {.count = 2,
              .messages = {{.length = 3,
                            .value_count = 1,
                            .values = {{{0, 16, 1, 0}, HD_HID_X, 0, 100.0, 0.0, -900.0, 900.0, 0.0}},
                            .bytes = {5}},
                           {.length = 3,
                            .value_count = 1,
                            .values = {{{0, 16, 1, 0}, HD_HID_Y, 0, 100.0, 0.0, -900.0, 900.0, 0.0}},
                            .bytes = {6}}}},
    .stop = {.count = 2, .messages = {{.length = 2, .bytes = {8, 1}}, {.length = 2, .bytes = {9, 2}}}},
};

static void open_pair(int fds[2]) {
    const int bytes = 32768; /* what is sent and not heard yet: fewer messages than MANY, however they are counted */

    CHECK(socketpair(AF_UNIX, SOCK_SEQPACKET, 0, fds) == 0);
    CHECK(setsockopt(fds[OURS], SOL_SOCKET, SO_SNDBUF, &bytes, sizeof bytes) == 0);
}

static void close_pair(int fds[2]) {
    close(fds[OURS]);
    close(fds[DEVICE]);
}

static void *listener_main(void *argument) {
    const int *fd = argument;
    uint8_t bytes[HD_HID_REPORT_BYTES];

    while (recv(*fd, bytes, sizeof bytes, 0) > 0) {
    }
    return NULL;
}

/* The end of a connection that renews what it sent: somebody has to listen meanwhile, or its write() would wait for
 * ever once the socket is full. */
static void end_listening(struct hd_hid *hid, int fds[2]) {
    pthread_t listener;

    CHECK(pthread_create(&listener, NULL, listener_main, &fds[DEVICE]) == 0);
    CHECK(hd_hid_disconnect(hid, 1) == 0);
    hd_hid_free(hid);
    close(fds[OURS]);
    CHECK(pthread_join(listener, NULL) == 0);
    close(fds[DEVICE]);
}

static int try_tell(int fd, int x, int y) {
    const uint8_t report[5] = {1, (uint8_t)x, (uint8_t)(x >> 8), (uint8_t)y, (uint8_t)(y >> 8)};

    return send(fd, report, sizeof report, MSG_NOSIGNAL) == sizeof report;
}

static void tell(int fd, int x, int y) {
    CHECK(try_tell(fd, x, y));
}

static void tell_states(int fd, uint8_t states) {
    const uint8_t report[2] = {2, states};

    CHECK(send(fd, report, sizeof report, MSG_NOSIGNAL) == sizeof report);
}

struct message {
    uint8_t id;
    int value; /* of 2 or 1 bytes */
    ssize_t length;
};

static struct message try_hear(int fd) {
    uint8_t bytes[HD_HID_REPORT_BYTES];
    struct message message = {.length = recv(fd, bytes, sizeof bytes, 0)};

    CHECK(message.length <= 3 && message.length != 1);
    if (message.length > 0) {
        message.id = bytes[0];
        message.value = message.length == 3 ? (int16_t)(bytes[1] | bytes[2] << 8) : bytes[1];
    }
    return message;
}

static struct message hear(int fd) {
    struct message message = try_hear(fd);

    CHECK(message.length > 0);
    return message;
}

static void expect_at(int line, int fd, uint8_t id, int value) {
    const struct message message = hear(fd);

    if (message.id != id || message.value != value)
        fprintf(stderr, "line %d: heard report %d with %d, not report %d with %d\n", line, message.id, message.value,
                id, value);
    CHECK(message.id == id && message.value == value);
}

#define expect(fd, id, value) expect_at(__LINE__, fd, id, value)

/* A force of zero, both messages, in their order. */
static void expect_rest(int fd) {
    expect(fd, 5, 0);
    expect(fd, 6, 0);
}

/* The same where the force changes while the writer is at work: the writer may come to the second message first. */
static void expect_rest_in_any_order(int fd) {
    const struct message first = hear(fd);

    CHECK((first.id == 5 || first.id == 6) && first.value == 0);
    expect(fd, first.id == 5 ? 6 : 5, 0);
}

static void expect_end(int fd) {
    expect_rest(fd);
    expect(fd, 8, 1);
    expect(fd, 9, 2);
}

static void expect_silence(int fd) {
    uint8_t byte;

    CHECK(recv(fd, &byte, 1, MSG_DONTWAIT) < 0 && errno == EAGAIN);
}

static struct hd_hid_status status_of(const struct hd_hid *hid) {
    struct hd_hid_status status;

    hd_hid_status(hid, &status);
    return status;
}

/* A force that does not grow old while the test is at work. */
static void put(struct hd_hid *hid, double x, double y) {
    const double force[2] = {x, y};

    hd_hid_step_put(hid, hd_clock_now_ns() + PATIENCE_NS, force);
}

static struct hd_look look_at(struct hd_hid *hid) {
    struct hd_look look;

    hd_hid_step_look(hid, hd_clock_now_ns(), &look);
    return look;
}

static void await_reports(struct hd_hid *hid, uint64_t count) {
    while (status_of(hid).reports < count)
        sched_yield();
}

/* The next look that has something new. */
static struct hd_look await_fresh(struct hd_hid *hid) {
    struct hd_look look;

    while (!(look = look_at(hid)).fresh)
        sched_yield();
    return look;
}

/* Its end waits for a writer that the machine keeps from running. */
static struct hd_hid *patient(void) {
    struct hd_hid *hid = hd_hid_new();

    CHECK(hid != NULL);
    hd_hid_set_parting(hid, PATIENCE_NS);
    return hid;
}

static struct hd_hid *connected(int fd, const struct hd_hid_plan *with) {
    struct hd_hid *hid = patient();

    CHECK(hd_hid_connect(hid, with, fd, 0) == HD_OK);
    return hid;
}

static int near(double a, double b) {
    return fabs(a - b) < 1e-12;
}

/* ---- In ---------------------------------------------------------------------------------------------------------- */

static void positions(void) {
    struct hd_hid *hid = patient();
    struct hd_look look;
    int64_t arrival_ns;
    int64_t before_ns;
    int fds[2];

    hd_hid_await_enable(hid);
    look = look_at(hid);
    CHECK(look.gone && !look.fresh && look.connection == 0);
    open_pair(fds);
    for (int i = 0; i < 5; i++)
        tell(fds[DEVICE], i, -i);
    CHECK(hd_hid_connect(hid, &plan, fds[OURS], 0) == HD_OK);
    CHECK(hd_hid_connect(hid, &plan, fds[OURS], 0) == HD_ERR_INVALID);
    /* What waited was drained to the newest. */
    look = look_at(hid);
    CHECK(status_of(hid).positions == 5 && look.fresh && !look.gone && look.connection == 1);
    CHECK(look.reading.interval_s == 0.0 && isnan(look.reading.true_velocity_m_per_s[0]));
    CHECK(near(look.reading.position_m[0], 4e-5) && near(look.reading.position_m[1], 4e-5));
    look = look_at(hid);
    CHECK(!look.fresh && look.reading.interval_s == 0.0 && near(look.reading.position_m[0], 4e-5));
    CHECK(hd_hid_step_await(hid, hd_clock_now_ns(), &arrival_ns) == 1);
    CHECK(hd_hid_step_await(hid, hd_clock_now_ns() + 1000, &arrival_ns) == 0);
    before_ns = hd_clock_now_ns();
    for (int i = 1; i <= 1000; i++) {
        tell(fds[DEVICE], 7 * i, i);
        if (i % 10 == 0) {
            await_reports(hid, 5 + (uint64_t)i);
            CHECK(hd_hid_step_await(hid, hd_clock_now_ns() + PATIENCE_NS, &arrival_ns) == 1);
            CHECK(arrival_ns >= before_ns && arrival_ns <= hd_clock_now_ns());
            do {
                look = await_fresh(hid);
                CHECK(look.reading.interval_s > 0.0);
            } while (!near(look.reading.position_m[0], 7e-5 * i));
            CHECK(near(look.reading.position_m[1], -1e-5 * i));
        }
    }
    CHECK(hd_hid_disconnect(hid, 0) == 0 && look_at(hid).gone);
    hd_hid_free(hid);
    close_pair(fds);
}

/* Axes in reports of their own, ids that the plan does not know, reports that end too soon, and none with an id. */
static void kinds_of_reports(void) {
    struct hd_hid_plan apart = plan;
    const uint8_t bytes[4] = {0x10, 0x00, 0xf0, 0xff};
    struct hd_hid *hid;
    struct hd_look look;
    int fds[2];

    apart.axes[1].report_id = 3;
    open_pair(fds);
    hid = connected(fds[OURS], &apart);
    tell(fds[DEVICE], 100, 0);
    await_reports(hid, 1);
    look = look_at(hid);
    CHECK(!look.fresh && look.connection == 0);
    CHECK(send(fds[DEVICE], (uint8_t[]){3, 0, 0, 50, 0}, 5, 0) == 5);
    look = await_fresh(hid);
    CHECK(near(look.reading.position_m[0], 1e-3) && near(look.reading.position_m[1], -5e-4));
    CHECK(send(fds[DEVICE], (uint8_t[]){1, 9}, 2, 0) == 2);
    CHECK(send(fds[DEVICE], (uint8_t[]){77, 9}, 2, 0) == 2);
    await_reports(hid, 4);
    CHECK(status_of(hid).short_reports == 1 && status_of(hid).positions == 2 && !look_at(hid).fresh);
    hd_hid_free(hid);
    close_pair(fds);

    apart.axes[0].report_id = apart.axes[1].report_id = 0;
    apart.state_count = 0;
    open_pair(fds);
    hid = connected(fds[OURS], &apart);
    CHECK(send(fds[DEVICE], bytes, 4, 0) == 4);
    look = await_fresh(hid);
    CHECK(near(look.reading.position_m[0], 16e-5) && near(look.reading.position_m[1], 16e-5));
    hd_hid_free(hid);
    close_pair(fds);
}

/* A device that reports only what changes: silence is the same position again, but never before there was one. */
static void on_change(void) {
    struct hd_hid_plan changes = plan;
    struct hd_look look;
    struct hd_hid *hid;
    int64_t now_ns;
    int fds[2];

    changes.on_change = 1;
    open_pair(fds);
    hid = connected(fds[OURS], &changes);
    now_ns = hd_clock_now_ns();
    hd_hid_step_look(hid, now_ns + 1000000000, &look);
    CHECK(!look.fresh && look.connection == 0);
    tell(fds[DEVICE], 100, 0);
    CHECK(await_fresh(hid).reading.interval_s == 0.0);
    now_ns = hd_clock_now_ns();
    for (int i = 1; i <= 100; i++) {
        hd_hid_step_look(hid, now_ns + i * 20000000ll, &look);
        CHECK(look.fresh && !look.gone && look.reading.interval_s > 0.0 && near(look.reading.position_m[0], 1e-3));
    }
    hd_hid_step_look(hid, now_ns + 100 * 20000000ll, &look);
    CHECK(!look.fresh && look.reading.interval_s == 0.0);
    CHECK(hd_hid_disconnect(hid, 0) == 0);
    hd_hid_step_look(hid, now_ns + 300 * 20000000ll, &look);
    CHECK(look.gone && !look.fresh);
    hd_hid_free(hid);
    close_pair(fds);
}

/* A report right behind another that was held up: a device of full speed reports no faster than its frames, also one
 * that reports only what changes. Else every jitter of the reader would make the handle jump. 0: the machine was so
 * slow that nothing is known of what is usual. */
static int held_up(void) {
    struct hd_hid_plan changes = plan;
    const int64_t begin_ns = hd_clock_now_ns();
    struct hd_look look;
    struct hd_hid *hid;
    int known = 1;
    int fds[2];

    changes.on_change = 1;
    open_pair(fds);
    hid = connected(fds[OURS], &changes);
    for (int i = 1; i <= 24 && known; i++) {
        /* The device's own time: 2 ms, and now and then none. */
        const int64_t until_ns = hd_clock_now_ns() + (i > 8 && i % 4 == 0 ? 0 : 2000000);
        while (hd_clock_now_ns() < until_ns) {
        }
        tell(fds[DEVICE], i, 0);
        do {
            look = await_fresh(hid);
        } while (!near(look.reading.position_m[0], 1e-5 * i));
        if (i > 8 && i % 4 == 0) {
            CHECK(look.reading.interval_s > 0.4e-3);
        }
        known = i != 8 || hd_clock_now_ns() - begin_ns < 4 * 50000000; /* four reports, less than 50 ms apart */
    }
    hd_hid_free(hid);
    close_pair(fds);
    return known;
}

static void on_change_held_up(void) {
    while (!held_up()) {
    }
}

static void states(void) {
    const uint32_t actuators = 1u << (HD_HID_ACTUATORS - 1);
    struct hd_hid_status status;
    struct hd_hid *hid;
    int fds[2];

    open_pair(fds);
    tell_states(fds[DEVICE], 2);
    tell_states(fds[DEVICE], 1); /* before the set-up was over: of no interest */
    hid = connected(fds[OURS], &plan);
    status = status_of(hid);
    CHECK(!status.reset && status.states == 1 && status.states_known == 7 && hd_hid_wait(hid, 0) == 0);
    tell_states(fds[DEVICE], 1 | 2);
    await_reports(hid, 3);
    status = status_of(hid);
    CHECK(!status.reset && (status.states & actuators) != 0);
    tell_states(fds[DEVICE], 0);
    CHECK(hd_hid_wait(hid, PATIENCE_NS) == 1 && status_of(hid).reset && status_of(hid).connected);
    hd_hid_clear_reset(hid);
    CHECK(!status_of(hid).reset);
    tell_states(fds[DEVICE], 2);
    tell_states(fds[DEVICE], 2 | 4);
    await_reports(hid, 6);
    CHECK(!status_of(hid).reset && hd_hid_wait(hid, 0) == 0);
    tell_states(fds[DEVICE], 1 | 2);
    CHECK(hd_hid_wait(hid, PATIENCE_NS) == 1 && status_of(hid).reset);
    hd_hid_clear_reset(hid);
    tell_states(fds[DEVICE], 1 | 2); /* still says so: it was answered */
    await_reports(hid, 8);
    CHECK(!status_of(hid).reset);
    hd_hid_free(hid);
    close_pair(fds);
}

/* ---- Out --------------------------------------------------------------------------------------------------------- */

static void forces(void) {
    const double none[2] = {(double)NAN, 1.0};
    const double old[2] = {1.0, 1.0};
    const double up[2] = {0.0, 3.0};
    struct hd_hid *hid = patient();
    int fds[2];

    hd_hid_step_put(hid, hd_clock_now_ns(), old); /* before the connection: not of it */
    open_pair(fds);
    CHECK(hd_hid_connect(hid, &plan, fds[OURS], 0) == HD_OK);
    expect_rest(fds[DEVICE]);
    put(hid, 1.5, 0.0); /* what does not change is left out */
    expect(fds[DEVICE], 5, 150);
    put(hid, 1.5, -100.0);
    expect(fds[DEVICE], 6, -900);
    for (int i = 0; i < 1000; i++)
        put(hid, 1.5001, -100.0);
    hd_hid_step_put(hid, hd_clock_now_ns() + PATIENCE_NS, none);
    expect_rest_in_any_order(fds[DEVICE]);
    put(hid, -2.0, 0.0);
    expect(fds[DEVICE], 5, -200);
    hd_hid_expect_ticks(hid, (int64_t)PATIENCE_NS * 1000); /* it is looked for a newer one all the same */
    put(hid, -2.5, 0.0);
    expect(fds[DEVICE], 5, -250);
    put(hid, -2.0, 0.0);
    expect(fds[DEVICE], 5, -200);
    hd_hid_expect_ticks(hid, 0);
    hd_hid_step_put(hid, hd_clock_now_ns() - 1000000000, old);
    expect(fds[DEVICE], 5, 0);
    put(hid, 0.0, 3.0);
    expect(fds[DEVICE], 6, 300);
    hd_hid_step_put(hid, hd_clock_now_ns(), up);
    expect(fds[DEVICE], 6, 0); /* nobody puts any more, and so it grows old */
    expect_silence(fds[DEVICE]);
    while (status_of(hid).writes < 12)
        sched_yield();
    CHECK(status_of(hid).writes == 12 && status_of(hid).forces >= 5 && status_of(hid).write_ns > 0);
    CHECK(hd_hid_disconnect(hid, 1) == 0);
    expect_end(fds[DEVICE]);
    expect_silence(fds[DEVICE]);
    CHECK(hd_hid_disconnect(hid, 1) == 0);
    hd_hid_free(hid);
    close_pair(fds);
}

/* A device that is written to as rarely as may be has all of the end within its bound, too. 0: not this time. */
static int slow_one_ends(void) {
    struct hd_hid_plan slow = plan;
    struct hd_hid *hid = hd_hid_new();
    int fds[2];
    int error;

    slow.write_interval_ns = 100000000;
    open_pair(fds);
    CHECK(hid != NULL && hd_hid_connect(hid, &slow, fds[OURS], 0) == HD_OK);
    expect_rest(fds[DEVICE]);
    put(hid, 1.0, 0.0);
    expect(fds[DEVICE], 5, 100);
    error = hd_hid_disconnect(hid, 1);
    CHECK(error == 0 || error == ETIMEDOUT);
    if (error == 0) {
        expect_end(fds[DEVICE]);
        expect_silence(fds[DEVICE]);
    }
    hd_hid_free(hid);
    close_pair(fds);
    return error == 0;
}

/* It leaves a quarter of a second to the machine, which may take more than that. */
static void end_of_a_slow_one(void) {
    int tries = 1;

    while (!slow_one_ends())
        CHECK(++tries < 20);
}

/* A device that was reset gets no force until it is set up again, and then all of it bit by bit. */
static void force_after_a_reset(void) {
    struct hd_hid *hid;
    int fds[2];
    int value = 0;

    open_pair(fds);
    hid = connected(fds[OURS], &plan);
    expect_rest(fds[DEVICE]);
    put(hid, 9.0, 0.0);
    expect(fds[DEVICE], 5, 900);
    tell_states(fds[DEVICE], 1);
    CHECK(hd_hid_wait(hid, PATIENCE_NS) == 1 && status_of(hid).reset);
    expect(fds[DEVICE], 5, 0);
    put(hid, 8.0, 0.0);
    expect_silence(fds[DEVICE]);
    hd_hid_clear_reset(hid);
    while (value < 800) {
        const struct message message = hear(fds[DEVICE]);
        CHECK(message.id == 5 && message.value > value && message.value <= 800);
        value = message.value;
    }
    hd_hid_free(hid);
    close_pair(fds);
}

/* What effects do over their renewals, as `plays` says it from renewal to renewal: + plays, - played and has ended, 0
 * neither, and of the second one the same. Returns at which one the device is said to have forgotten one, from 1; 0:
 * never. */
static int forgotten_at(struct hd_renewals *renewals, const char *first, const char *second, int excused) {
    const struct hd_hid_effects effects = {.count = 2, .indices = {1, 2}, .proof = 4};
    int found = 0;

    for (int i = 0; first[i] != 0; i++) {
        const uint32_t playing = (first[i] == '+' ? 1u : 0u) | (second[i] == '+' ? 2u : 0u);
        const uint32_t ended = (first[i] == '-' ? 1u : 0u) | (second[i] == '-' ? 2u : 0u);

        if (hd_hid_forgotten(renewals, &effects, playing, ended, excused)) {
            CHECK(found == 0);
            found = i + 1;
        }
    }
    return found;
}

static int forgotten_once(const char *first, const char *second) {
    struct hd_renewals renewals = {.proven = 0};

    return forgotten_at(&renewals, first, second, 0);
}

/* Renewals that pass while an effect is not said to play: two may, the third says that it is forgotten, once. */
static void forgotten_effects(void) {
    struct hd_renewals renewals = {.proven = 0};

    CHECK(forgotten_once("++++++", "++++++") == 0);
    CHECK(forgotten_once("000000", "000000") == 0);
    CHECK(forgotten_once("++++---", "+++++++") == 7);
    CHECK(forgotten_once("+++++++", "++++---") == 7);
    CHECK(forgotten_once("++++---------", "++++--------") == 7);
    /* The writer was held up, and the effect ran out; or it blinks when it is renewed. */
    CHECK(forgotten_once("++++--++++--++++", "++++-+-+-+-+-+-+") == 0);
    /* A device that does not say that renewed effects play on is believed once, the other always. */
    CHECK(forgotten_at(&renewals, "+++---++---++---", "000000000000000", 0) == 6);
    CHECK(!renewals.proven && renewals.guessed);
    CHECK(forgotten_at(&renewals, "+++---", "++++++", 0) == 6);
    CHECK(renewals.proven);
    CHECK(forgotten_at(&renewals, "+---", "0000", 0) == 4 && forgotten_at(&renewals, "+---", "0000", 0) == 4);
    /* What the device says otherwise explains it; afterwards they have to play. */
    CHECK(forgotten_at(&renewals, "++------", "++------", 1) == 0);
    CHECK(forgotten_at(&renewals, "---", "---", 0) == 3);
}

/* Report 4: an index and whether that plays. Effects 3 and 7 are ours, renewed by message 10. */
/* Renewals: more than the socket holds (open_pair), so that the last of them is from after the first was heard. */
#define MANY 300

static struct hd_hid_plan watched_plan(void) {
    struct hd_hid_plan watched = plan;

    watched.effects = (struct hd_hid_effects){
        .index = {0, 8, 0, 0}, .playing = {8, 1, 0, 0}, .report_id = 4, .count = 2, .indices = {3, 7}, .proof = 4};
    watched.states[3] = (struct hd_hid_state){{3, 1, 0, 0}, 2, HD_HID_SAFETY};
    watched.state_count = 4;
    watched.begin.count = 1;
    watched.begin.messages[0] = (struct hd_hid_message){.length = 2, .bytes = {7, 1}};
    watched.renew_ns = 200000;
    watched.renew.count = 1;
    watched.renew.messages[0] = (struct hd_hid_message){.length = 2, .bytes = {10, 1}};
    return watched;
}

static void tell_effect(int fd, uint8_t index, uint8_t playing) {
    const uint8_t report[3] = {4, index, playing};

    CHECK(send(fd, report, sizeof report, MSG_NOSIGNAL) == sizeof report);
}

/* Hears so many renewals; the force along x that came last. */
static int hear_renewals(int fd, int count) {
    static int value;

    while (count > 0) {
        const struct message message = hear(fd);

        CHECK(message.id == 5 || message.id == 6 || message.id == 10);
        value = message.id == 5 ? message.value : value;
        count -= message.id == 10;
    }
    return value;
}

static void hear_force(int fd, int wanted) {
    while (hear_renewals(fd, 1) != wanted) {
    }
}

/* A device that forgets its effects and says no more of that than that one does not play. */
static void effects_that_end(void) {
    const struct hd_hid_plan watched = watched_plan();
    struct hd_hid *hid;
    int fds[2];

    open_pair(fds);
    tell_effect(fds[DEVICE], 3, 1); /* before the set-up was over */
    tell_effect(fds[DEVICE], 3, 0);
    hid = connected(fds[OURS], &watched);
    expect(fds[DEVICE], 7, 1);
    put(hid, 5.0, 0.0);
    hear_force(fds[DEVICE], 500);
    hear_renewals(fds[DEVICE], MANY);
    CHECK(!status_of(hid).reset);
    /* Effects of others, and one of ours that was never said to play. */
    tell_effect(fds[DEVICE], 4, 1);
    tell_effect(fds[DEVICE], 4, 0);
    tell_effect(fds[DEVICE], 7, 0);
    CHECK(send(fds[DEVICE], (uint8_t[]){4, 3}, 2, 0) == 2); /* too short */
    await_reports(hid, 6);
    hear_renewals(fds[DEVICE], MANY);
    CHECK(!status_of(hid).reset && status_of(hid).short_reports == 1 && hd_hid_wait(hid, 0) == 0);
    for (int i = 0; i < 3; i++) {
        tell_effect(fds[DEVICE], 3, 1);
        tell_effect(fds[DEVICE], 7, 1);
        await_reports(hid, 6 + 3 * (uint64_t)i + 2);
        hear_renewals(fds[DEVICE], MANY);
        hear_force(fds[DEVICE], 500);
        CHECK(!status_of(hid).reset);
        tell_effect(fds[DEVICE], i == 1 ? 7 : 3, 0);
        hear_force(fds[DEVICE], 0);
        CHECK(hd_hid_wait(hid, PATIENCE_NS) == 1 && status_of(hid).reset && status_of(hid).connected);
        hd_hid_clear_reset(hid);
        hear_renewals(fds[DEVICE], MANY);
        CHECK(!status_of(hid).reset); /* it was answered, whatever the device says since */
    }
    end_listening(hid, fds);
}

/* A pause that begins while the device is watched holds the force back; one that was there says nothing. */
static void paused(void) {
    const struct hd_hid_plan watched = watched_plan();
    struct hd_hid *hid;
    int fds[2];

    open_pair(fds);
    tell_states(fds[DEVICE], 2 | 4);
    hid = connected(fds[OURS], &watched);
    expect(fds[DEVICE], 7, 1);
    put(hid, 5.0, 0.0);
    hear_force(fds[DEVICE], 500);
    tell_effect(fds[DEVICE], 3, 1);
    await_reports(hid, 2);
    hear_renewals(fds[DEVICE], MANY);
    for (int i = 0; i < 3; i++) {
        tell_states(fds[DEVICE], 2);
        hear_force(fds[DEVICE], 500);
        tell_states(fds[DEVICE], 2 | 4);
        tell_effect(fds[DEVICE], 3, 0); /* that is why */
        hear_force(fds[DEVICE], 0);
        await_reports(hid, 2 + 4 * (uint64_t)i + 3);
        CHECK(hear_renewals(fds[DEVICE], MANY) == 0 && !status_of(hid).reset);
        tell_effect(fds[DEVICE], 3, 1);
    }
    end_listening(hid, fds);
}

/* A hand that lets go opens the safety switch, and no effect plays until it closes; then they have to. */
static void safety_switch(void) {
    const struct hd_hid_plan watched = watched_plan();
    struct hd_hid *hid;
    int fds[2];

    open_pair(fds);
    hid = connected(fds[OURS], &watched);
    expect(fds[DEVICE], 7, 1);
    tell_states(fds[DEVICE], 2 | 8);
    tell_effect(fds[DEVICE], 3, 1);
    await_reports(hid, 2);
    hear_renewals(fds[DEVICE], MANY);
    tell_states(fds[DEVICE], 2);
    tell_effect(fds[DEVICE], 3, 0);
    await_reports(hid, 4);
    hear_renewals(fds[DEVICE], MANY);
    CHECK(!status_of(hid).reset && hd_hid_wait(hid, 0) == 0);
    tell_states(fds[DEVICE], 2 | 8);
    while (hd_hid_wait(hid, 0) == 0)
        hear_renewals(fds[DEVICE], 1);
    CHECK(status_of(hid).reset);
    end_listening(hid, fds);
}

static void renewal(void) {
    struct hd_hid_plan renewed = plan;
    struct hd_hid *hid;
    int fds[2];
    int value = 0;

    renewed.renew_ns = 1000000;
    renewed.write_interval_ns = 10000;
    renewed.renew.count = 2;
    renewed.renew.messages[0] = (struct hd_hid_message){.length = 2, .bytes = {10, 1}};
    renewed.renew.messages[1] = plan.force.messages[1];
    renewed.renew.messages[1].bytes[0] = 11;
    open_pair(fds);
    hid = connected(fds[OURS], &renewed);
    for (int i = 0; i < 200; i++) {
        /* All of the force, then what restarts it, whether or not it changed. */
        struct message message;

        put(hid, 0.0, i < 100 ? 0.0 : 2.0);
        while ((message = hear(fds[DEVICE])).id != 10) {
            CHECK(message.id == 5 || message.id == 6);
            value = message.id == 6 ? message.value : value;
        }
        message = hear(fds[DEVICE]);
        CHECK(message.id == 11 && message.value >= value);
    }
    CHECK(value == 200);
    end_listening(hid, fds);
}

/* What another program may have changed: reports 12 to 14 in turn, with the force as it is, and a pass of the forces
 * between two of them. */
static struct hd_hid_plan restored_plan(struct hd_hid_plan from) {
    from.renew_ns = 200000;
    from.restore_ns = 1; /* always due */
    from.restore.count = 3;
    for (uint8_t i = 0; i < 3; i++) {
        from.restore.messages[i] = plan.force.messages[0];
        from.restore.messages[i].bytes[0] = (uint8_t)(12 + i);
    }
    return from;
}

static void restoring(void) {
    const struct hd_hid_plan restored = restored_plan(plan);
    struct hd_hid *hid;
    int fds[2];
    int next = 12;

    open_pair(fds);
    hid = connected(fds[OURS], &restored);
    expect_rest(fds[DEVICE]); /* forces first */
    for (int i = 0; i < 600; i++) {
        const struct message message = hear(fds[DEVICE]);

        if (message.id == 5 || message.id == 6)
            continue;
        CHECK(message.id == next);
        next = next == 14 ? 12 : next + 1;
    }
    put(hid, 5.0, 0.0);
    for (int value = 0, last = 0; value != 500; last = value) {
        const struct message message = hear(fds[DEVICE]);

        value = message.id >= 12 ? message.value : last;
        CHECK(value == 0 || value == 500);
    }
    CHECK(!status_of(hid).effects_told);
    end_listening(hid, fds);
}

/* A device that says that an effect of ours plays would say that it is gone: nothing is restored, from then on. */
static void restoring_is_not_for_those_that_tell(void) {
    const struct hd_hid_plan restored = restored_plan(watched_plan());
    struct hd_hid *hid;
    int fds[2];
    int heard = 0;

    open_pair(fds);
    hid = connected(fds[OURS], &restored);
    while (hear(fds[DEVICE]).id < 12) { /* it has not said so in 0.1 s */
    }
    CHECK(!status_of(hid).effects_told);
    tell_effect(fds[DEVICE], 4, 1); /* not ours */
    await_reports(hid, 1);
    CHECK(!status_of(hid).effects_told);
    tell_effect(fds[DEVICE], 7, 1);
    await_reports(hid, 2);
    CHECK(status_of(hid).effects_told);
    for (int i = 0; i < MANY; i++) /* what was on its way */
        hear(fds[DEVICE]);
    for (int i = 0; i < MANY; i++)
        heard += hear(fds[DEVICE]).id >= 12;
    CHECK(heard == 0);
    end_listening(hid, fds);
}

/* ---- Ends -------------------------------------------------------------------------------------------------------- */

static void unplugged(void) {
    struct hd_hid *hid = patient();

    for (int i = 0; i < 20; i++) {
        struct hd_look look;
        int fds[2];
        int error;

        open_pair(fds);
        CHECK(hd_hid_connect(hid, &plan, fds[OURS], 0) == HD_OK);
        tell(fds[DEVICE], i, i);
        look = await_fresh(hid);
        CHECK(look.connection == (uint32_t)i + 1 && look.reading.interval_s == 0.0);
        CHECK(near(look.reading.position_m[0], 1e-5 * i));
        put(hid, 0.01 * i, 1.0);
        if (i % 2 == 0)
            expect(fds[DEVICE], 5, 0);
        if (i % 3 == 0)
            CHECK(shutdown(fds[DEVICE], SHUT_RDWR) == 0);
        else
            close(fds[DEVICE]);
        CHECK(hd_hid_wait(hid, PATIENCE_NS) == 1 && !status_of(hid).connected && look_at(hid).gone);
        error = status_of(hid).error;
        CHECK(error == ENODEV || error == ECONNRESET || error == EPIPE);
        if (i % 4 == 0) /* else the next connection sees to it */
            CHECK(hd_hid_disconnect(hid, 1) == error);
        close(fds[OURS]);
        if (i % 3 == 0)
            close(fds[DEVICE]);
    }
    hd_hid_free(hid);
}

/* An error that leaves the device there: it is left without a force. */
static void failed(void) {
    struct hd_hid *hid;
    int fds[2];

    open_pair(fds);
    hid = connected(fds[OURS], &plan);
    expect_rest(fds[DEVICE]);
    put(hid, 5.0, 0.0);
    expect(fds[DEVICE], 5, 500);
    CHECK(send(fds[DEVICE], "", 0, MSG_NOSIGNAL) == 0); /* read() says that there is nothing more to come */
    expect_end(fds[DEVICE]);
    CHECK(hd_hid_disconnect(hid, 0) == ENODEV && status_of(hid).error == ENODEV);
    expect_silence(fds[DEVICE]);
    hd_hid_free(hid);
    close_pair(fds);
}

/* A connection that has not said where its handle is, after one that had. */
static void replaced(void) {
    struct hd_hid *hid;
    int fds[2];

    open_pair(fds);
    hid = connected(fds[OURS], &plan);
    CHECK(!look_at(hid).gone); /* the servo counts the time until there is a position */
    tell(fds[DEVICE], 1, 0);
    CHECK(!await_fresh(hid).gone);
    CHECK(hd_hid_disconnect(hid, 0) == 0 && hd_hid_connect(hid, &plan, fds[OURS], 0) == HD_OK);
    CHECK(look_at(hid).gone && !look_at(hid).fresh && look_at(hid).connection == 1);
    tell(fds[DEVICE], 1, 0);
    CHECK(!await_fresh(hid).gone && look_at(hid).connection == 2);
    hd_hid_free(hid);
    close_pair(fds);
}

static void fill(int fd) {
    uint8_t bytes[64] = {99};

    while (send(fd, bytes, sizeof bytes, MSG_DONTWAIT) > 0) {
    }
    CHECK(errno == EAGAIN);
}

/* A device that takes nothing: the servo's side goes on, the end is bounded, and what hangs in write() touches nothing
 * when it comes back; but what it then leaves the device with is no force. */
static void stuck(int flags) {
    struct hd_hid *hid = hd_hid_new();
    uint8_t bytes[64];
    int held[2] = {0, 0}; /* counts of x and y that came last */
    ssize_t length;
    int first[2];
    int second[2];

    CHECK(hid != NULL);
    open_pair(first);
    open_pair(second);
    CHECK(fcntl(first[OURS], F_SETFL, flags) == 0);
    CHECK(hd_hid_connect(hid, &plan, first[OURS], 0) == HD_OK);
    expect(first[DEVICE], 5, 0);
    expect(first[DEVICE], 6, 0);
    while (status_of(hid).writes < 2)
        sched_yield();
    fill(first[OURS]);
    for (int i = 1; i <= 1000; i++) {
        put(hid, 0.001 * i, 1.0);
        tell(first[DEVICE], i, 0);
        while (!near(await_fresh(hid).reading.position_m[0], 1e-5 * i)) {
        }
    }
    CHECK(status_of(hid).writes == 2 && status_of(hid).connected);
    CHECK(hd_hid_disconnect(hid, 1) == ETIMEDOUT);
    close(first[OURS]);
    CHECK(hd_hid_connect(hid, &plan, second[OURS], 0) == HD_OK);
    expect(second[DEVICE], 5, 0);
    expect(second[DEVICE], 6, 0);
    put(hid, 1.0, 0.0);
    expect(second[DEVICE], 5, 100);
    hd_hid_free(hid);
    /* The thread that was given up has the last descriptor of this end: it ends after it has left write(). */
    while ((length = recv(first[DEVICE], bytes, sizeof bytes, 0)) > 0) {
        CHECK(bytes[0] == 99 || bytes[0] == 5 || bytes[0] == 6);
        if (bytes[0] != 99)
            held[bytes[0] - 5] = (int16_t)(bytes[1] | bytes[2] << 8);
    }
    CHECK(held[0] == 0 && held[1] == 0);
    CHECK(length == 0 || errno == ECONNRESET);
    close(first[DEVICE]);
    close_pair(second);
}

/* ---- With a servo ------------------------------------------------------------------------------------------------ */

#define RATE_HZ 2000.0

/* The device's own side: it answers each force with a report of where its handle is, and without forces it reports once
 * a millisecond. */
struct joystick {
    int fd;
    struct hd_atomic_i64 y;     /* counts; the test writes */
    struct hd_atomic_i64 force; /* counts along y, as received last; the test reads */
    struct hd_atomic_u32 ends;
    pthread_t thread;
};

static void *joystick_main(void *argument) {
    struct joystick *joystick = argument;
    struct message message = {.length = 1};

    while (message.length > 0 && !hd_atomic_u32_load_acquire(&joystick->ends)) {
        struct pollfd polled = {.fd = joystick->fd, .events = POLLIN};

        if (!try_tell(joystick->fd, 0, (int)hd_atomic_i64_load_relaxed(&joystick->y)))
            break;
        if (poll(&polled, 1, 1) > 0) {
            message = try_hear(joystick->fd);
            if (message.id == 6)
                hd_atomic_i64_store_relaxed(&joystick->force, message.value);
        }
    }
    return NULL;
}

static void plug(struct joystick *joystick, struct hd_hid *hid) {
    int fds[2];

    open_pair(fds);
    *joystick = (struct joystick){.fd = fds[DEVICE]};
    hd_atomic_i64_store_relaxed(&joystick->y, -100);
    CHECK(hd_hid_connect(hid, &plan, fds[OURS], 0) == HD_OK);
    close(fds[OURS]); /* the connection has its own */
    CHECK(pthread_create(&joystick->thread, NULL, joystick_main, joystick) == 0);
}

static void unplug(struct joystick *joystick) {
    hd_atomic_u32_store_release(&joystick->ends, 1);
    CHECK(pthread_join(joystick->thread, NULL) == 0);
    close(joystick->fd);
}

/* Control, of which this test is not: the one that tests waits at times for as long as it takes. */
struct beater {
    struct hd_servo *servo;
    struct hd_atomic_u32 ends;
    pthread_t thread;
};

static void *beater_main(void *argument) {
    struct beater *beater = argument;

    while (!hd_atomic_u32_load_acquire(&beater->ends)) {
        hd_servo_beat(beater->servo);
        hd_clock_sleep_until(hd_clock_now_ns() + 1000000);
    }
    return NULL;
}

/* Everything up to the first event of a kind; samples are checked on the way. */
static struct hd_event await_event(struct hd_servo *servo, uint32_t kind) {
    static int64_t last_ns; /* of any servo: they run one after the other */
    struct hd_event event;
    struct hd_sample sample;
    uint64_t dropped;

    for (;;) {
        while (hd_servo_read_samples(servo, &sample, 1, &dropped) == 1) {
            CHECK(sample.time_ns > last_ns);
            last_ns = sample.time_ns;
            CHECK((sample.flags & HD_FLAG_GLITCH) == 0);
            CHECK((sample.flags & HD_FLAG_FAULT) == 0 || (sample.force_n[0] == 0.0 && sample.force_n[1] == 0.0));
        }
        while (hd_servo_read_events(servo, &event, 1, &dropped) == 1)
            if (event.kind == kind)
                return event;
        sched_yield();
    }
}

static void switch_forces(struct hd_servo *servo) {
    const struct hd_command on = {.kind = HD_COMMAND_FORCES, .revision = 1, .value = 1};
    uint64_t sequence;
    uint64_t tick;

    CHECK(hd_servo_send(servo, &on, 1, &sequence) == HD_OK);
    CHECK(hd_servo_wait_command(servo, sequence, PATIENCE_NS, &tick) == HD_OK);
}

static void await_force(struct joystick *joystick, int wanted) {
    while (hd_atomic_i64_load_relaxed(&joystick->force) != wanted)
        sched_yield();
}

static void with_servo(uint32_t clock) {
    struct hd_servo_config config = {.stream_timeout_s = 0.02,
                                     .device_timeout_s = 60.0, /* nothing that this test is about */
                                     .rate_hz = RATE_HZ,
                                     .cpu = -1,
                                     .slot_capacity = 1,
                                     .sample_capacity = 4096,
                                     .resolution_m = 1e-5,
                                     .clock = clock};
    struct hd_material material = {.stiffness_n_per_m = 1000.0};
    struct hd_object wall = {.shape = HD_SHAPE_WALL, .normal = {0.0, 1.0}};
    struct hd_table table = {.revision = 1,
                             .object_count = 1,
                             .material_count = 1,
                             .display_force = 1,
                             .display_vibration = 1,
                             .all_changed = 1,
                             .period_s = 1.0 / RATE_HZ,
                             .max_force_n = 8.0,
                             .max_speed_m_per_s = 1000.0,
                             .ramp_s = 0.005,
                             .ramp_step = 1.0 / RATE_HZ / 0.005,
                             .objects = &wall,
                             .materials = &material};
    const double still[1][3] = {{0.0, 0.0, 0.0}};
    struct hd_operator *path = hd_operator_new(still[0], 1, HD_LINEAR);
    struct hd_command command = {.kind = HD_COMMAND_OPERATOR, .revision = 1, .path = path};
    struct hd_hid *hid = patient();
    struct beater beater = {.servo = NULL};
    struct joystick joystick;
    struct hd_counters counters;
    struct hd_servo *servo;
    struct hd_grant grant;
    uint64_t sequence;

    CHECK(path != NULL);
    CHECK(hd_servo_new(&config, NULL, NULL) == NULL);
    servo = hd_servo_new(&config, NULL, hid);
    CHECK(servo != NULL && hd_servo_publish(servo, &table) == HD_OK);
    CHECK(hd_servo_send(servo, &command, 1, &sequence) == HD_ERR_INVALID);
    CHECK(hd_servo_start(servo, &grant) == HD_OK);
    beater.servo = servo;
    CHECK(pthread_create(&beater.thread, NULL, beater_main, &beater) == 0);
    await_event(servo, HD_EVENT_DEVICE_LOST); /* there is none yet */
    for (int i = 0; i < 3; i++) {
        plug(&joystick, hid);
        await_event(servo, HD_EVENT_DEVICE_FOUND);
        switch_forces(servo);
        hd_atomic_i64_store_relaxed(&joystick.y, 200); /* 2 mm below the wall: 2 N upwards */
        await_event(servo, HD_EVENT_CONTACT);
        await_force(&joystick, 200);
        if (i == 1) { /* taken away and put back between two looks, perhaps */
            hd_hid_disconnect(hid, 1);
            unplug(&joystick);
            plug(&joystick, hid);
            CHECK(await_event(servo, HD_EVENT_FAULT).code == HD_FAULT_DEVICE);
            await_event(servo, HD_EVENT_DEVICE_FOUND);
            await_force(&joystick, 0);
        }
        unplug(&joystick);
        CHECK(hd_hid_wait(hid, PATIENCE_NS) == 1);
        await_event(servo, HD_EVENT_DEVICE_LOST);
        hd_servo_counters(servo, &counters);
        CHECK(counters.faults == HD_FAULT_DEVICE);
    }
    CHECK(hd_servo_stop(servo) == HD_OK);
    hd_atomic_u32_store_release(&beater.ends, 1);
    CHECK(pthread_join(beater.thread, NULL) == 0);
    hd_servo_counters(servo, &counters);
    CHECK(counters.ticks > 0 && counters.glitches == 0);
    hd_servo_free(servo);
    hd_hid_free(hid);
    hd_operator_free(path);
}

/* Reports that come soon after each of the timer's ticks lead the ticks all the same. */
static void led_out_of_phase(void) {
    const double rate_hz = 20.0;
    const int64_t period_ns = 50000000;
    const struct hd_servo_config config = {.stream_timeout_s = 0.02,
                                           .device_timeout_s = 60.0,
                                           .rate_hz = rate_hz,
                                           .cpu = -1,
                                           .slot_capacity = 1,
                                           .sample_capacity = 64,
                                           .resolution_m = 1e-5,
                                           .clock = HD_CLOCK_DEVICE};
    const struct hd_table table = {.revision = 1,
                                   .all_changed = 1,
                                   .period_s = 1.0 / rate_hz,
                                   .max_force_n = 8.0,
                                   .max_speed_m_per_s = 1000.0,
                                   .ramp_s = 0.1,
                                   .ramp_step = 0.5};
    struct hd_hid *hid = patient();
    struct hd_servo *servo = hd_servo_new(&config, NULL, hid);
    struct hd_sample sample;
    struct hd_sample later;
    struct hd_grant grant;
    int64_t arrivals_ns[16] = {0};
    uint64_t dropped;
    int led = 0;
    int fds[2];

    open_pair(fds);
    CHECK(servo != NULL && hd_servo_publish(servo, &table) == HD_OK);
    CHECK(hd_hid_connect(hid, &plan, fds[OURS], 0) == HD_OK);
    CHECK(hd_servo_start(servo, &grant) == HD_OK);
    while (hd_servo_read_samples(servo, &sample, 1, &dropped) == 0)
        sched_yield();
    for (uint64_t reports = 0; !led; reports++) {
        hd_clock_sleep_until(sample.time_ns + period_ns / 5 + (int64_t)reports * period_ns);
        tell(fds[DEVICE], 0, 0);
        await_reports(hid, reports + 1);
        arrivals_ns[reports % 16] = status_of(hid).last_report_ns;
        while (hd_servo_read_samples(servo, &later, 1, &dropped) == 1)
            for (int i = 0; i < 16; i++)
                led = led || later.time_ns == arrivals_ns[i];
    }
    CHECK(hd_servo_stop(servo) == HD_OK);
    hd_servo_free(servo);
    hd_hid_free(hid);
    close_pair(fds);
}

int main(void) {
    alarm(PATIENCE_S);
    positions();
    kinds_of_reports();
    on_change();
    on_change_held_up();
    states();
    forces();
    end_of_a_slow_one();
    force_after_a_reset();
    renewal();
    restoring();
    restoring_is_not_for_those_that_tell();
    forgotten_effects();
    effects_that_end();
    paused();
    safety_switch();
    unplugged();
    failed();
    replaced();
    stuck(0);
    stuck(O_NONBLOCK);
    with_servo(HD_CLOCK_TIMER);
    with_servo(HD_CLOCK_DEVICE);
    led_out_of_phase();
    printf("test_hid: ok\n");
    return 0;
}
