/* A HID device: two mailboxes that the servo uses without a system call, and while connected a thread at the far end of
 * each.
 *
 *   reader   poll, drain to the newest report, publish its position with the time at which poll returned
 *   writer   take the newest force, compose, write what has changed; renew in time
 *
 *                +---------- servo ----------+
 *     positions  |                           |  forces
 *     (triple)   |                           v  (triple)
 *             reader                      writer
 *                ^                           |
 *     read()     +---- fd, a hidraw node ----+  write(), which blocks until the transfer is done
 *
 * Nothing queues but what the device is to play by itself (hd_effects.h): what was overtaken in a mailbox is never
 * seen. The servo makes no system call that could wake the writer, so the writer looks for a new force: every 50 us
 * from when the next tick may be on.
 *
 * A connection owns a copy of the plan and a duplicate of the descriptor. Whichever thread meets an error ends it for
 * both. Control joins both, within a bound: a writer that does not come back from write() is given up. It is detached,
 * the connection becomes its own, it touches nothing else when it comes back, and frees it. What decides is one atomic,
 * `phase`: control may only take WRITING to GIVEN_UP, and the writer only WRITING to IDLE.
 *
 * No end leaves a force on a device that still takes reports: where control ends it in an orderly way or an error does,
 * the writer's last reports are a force of zero and the stop script; one that was given up sends a force of zero, and
 * no more: the device may have a connection anew. Only control's other end sends nothing.
 *
 * Who touches what:
 *   positions, arrivals, the reader's counters     the reader writes; control before the reader starts
 *   forces, orders                                 the servo writes, the writer reads while its phase is IDLE
 *   seen_* and what follows in struct hd_hid       the servo's own
 *   the writer's counters                          the writer, while its phase is IDLE
 *   playing, ended, told in struct hd_connection   the reader writes, the writer reads
 *   connection, parting_ns                         control's own: one thread at a time connects and disconnects
 *   connected, error, reset, returns_ns, event_fd  anybody
 *
 * Times are CLOCK_MONOTONIC nanoseconds. */
#include "device/hd_hid.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/futex.h>
#include <math.h>
#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "base/hd_atomic.h"
#include "base/hd_bits.h"
#include "base/hd_clock.h"
#include "base/hd_triple.h"
#include "device/hd_effects.h"
#include "device/hd_last_report.h"

#define HD_DRAIN_MAX 256          /* reports read before the newest is published; hidraw keeps 64 */
#define HD_FRESH_NS 4000000       /* so long at most a newer force is waited for */
#define HD_RETURN_NS 20000000     /* over which the force comes back after a reset */
#define HD_LOOK_NS 50000          /* how often the writer looks for a force that is due */
#define HD_LOOK_MOST_NS 1000000   /* and for one that is not: it renews and ends, too */
#define HD_FORCE_AGE_NS 100000000 /* an older force is none */
#define HD_PARTING_NS 500000000   /* for what is written at the end, unless hd_hid_set_parting says otherwise */
#define HD_IDLE_NS 1000000        /* passes further apart say nothing about how fast the device takes them */
#define HD_MEAN_SHIFT 5           /* running means are over 32 */
#define HD_UNUSUAL_S 0.05         /* longer intervals between reports are pauses */
#define HD_USUAL_REPORTS 4        /* of a device that reports what changes: as many together say what is usual */
#define HD_UNTOLD_NS 100000000    /* so long a device has to say that its effects play */
#define HD_FRAME_S 1e-3           /* the shortest time between two reports of a full-speed device */
#define HD_USUAL_FIRST_S 0.01     /* before there were two reports; low-speed devices have it */

enum hd_phase { HD_PHASE_IDLE = 0, HD_PHASE_WRITING = 1, HD_PHASE_GIVEN_UP = 2 };
enum hd_end { HD_END_NOT = 0, HD_END_NOW = 1, HD_END_ORDERLY = 2, HD_END_FAILED = 3 };

struct hd_position {
    double position_m[2];
    int64_t time_ns;     /* of arrival */
    uint64_t number;     /* positions of this connection so far */
    uint32_t connection; /* its number, from 1 */
    uint32_t on_change;
    struct hd_hid_signs signs;
};

struct hd_force {
    double force_n[2];
    int64_t time_ns;
};

struct hd_connection {
    struct hd_hid *hid; /* not to be followed once the phase is GIVEN_UP */
    struct hd_hid_plan plan;
    int fd;
    int end_fd;  /* readable from the end on: nobody reads it */
    int left_fd; /* readable once the writer has left */
    int64_t start_ns;
    struct hd_atomic_u32 phase; /* enum hd_phase, of the writer */
    struct hd_atomic_u32 end;   /* enum hd_end; whoever ends it writes, the writer reads */
    int64_t parting_ns;         /* for what is written at the end */
    int64_t parting_until_ns;   /* control writes it before an orderly end */
    int parting_error;          /* the writer writes it, control reads it after the join */
    pthread_t reader;
    pthread_t writer;

    struct hd_position known; /* the reader's own */
    uint32_t axes_known;

    struct hd_atomic_u32 playing; /* bit i: the device says that effect i plays */
    struct hd_atomic_u32 ended;   /* bit i: it played, and does not */
    struct hd_atomic_u32 told;    /* it has said that one plays */

    uint8_t sent[HD_HID_MESSAGES][HD_HID_REPORT_BYTES]; /* the writer's own, from here on */
    uint32_t sent_once;                                 /* bit: that message was sent */
    double direction_rad;                               /* of the last force that had one */
    int begun;                                          /* the first pass is over: it is of no force */
    int leaving;                                        /* the last one is, */
    int64_t leaving_until_ns;                           /* until then at most */
    int64_t next_write_ns;
    int64_t written_ns;     /* when the last write was done */
    int64_t fresh_until_ns; /* until then a force newer than that is waited for */
    int64_t last_pass_ns;
    int64_t idle_ns;    /* since the last pass */
    int64_t restore_ns; /* when the next message of that script is due, */
    uint32_t restored;  /* and which */
    struct hd_renewals renewals;
    struct hd_player player;
};

struct hd_hid {
    struct hd_triple position_triple;
    struct hd_position positions[3];
    struct hd_triple force_triple;
    struct hd_force forces[3];
    struct hd_orders orders;
    struct hd_atomic_u32 offers; /* control writes, the servo reads: there are effects for orders */

    alignas(HD_CACHE_LINE) struct hd_atomic_u32 arrivals; /* positions so far, of all connections: a futex */
    struct hd_atomic_u32 awaited;                         /* somebody sleeps on it */
    struct hd_atomic_i64 tick_ns;                         /* a force comes that long after another, not sooner */
    struct hd_atomic_i64 arrived_ns;                      /* of the newest */
    struct hd_atomic_u32 states;
    struct hd_atomic_u32 states_known;
    struct hd_atomic_u32 states_seen; /* were not 0 once */
    struct hd_atomic_u32 effects_told;
    struct hd_atomic_u64 reports;
    struct hd_atomic_u64 read_positions;
    struct hd_atomic_u64 short_reports;
    struct hd_atomic_i64 last_report_ns;

    alignas(HD_CACHE_LINE) struct hd_atomic_u64 writes;
    struct hd_atomic_u64 sent_forces;
    struct hd_atomic_i64 write_ns;
    struct hd_atomic_i64 write_interval_ns;

    alignas(HD_CACHE_LINE) struct hd_atomic_u32 connected;
    struct hd_atomic_u32 connection_number; /* control writes, the servo reads */
    struct hd_atomic_u32 error;
    struct hd_atomic_u32 reset;
    struct hd_atomic_u32 paused;     /* somebody has paused the device */
    struct hd_atomic_i64 returns_ns; /* when the last reset was answered, or a pause was over */
    int event_fd;
    int64_t parting_ns; /* control's own, as connection */
    struct hd_connection *connection;

    alignas(HD_CACHE_LINE) struct hd_reading seen; /* the servo's own, from here on */
    int64_t seen_ns;                               /* of the last report, as the estimator was told */
    int64_t seen_arrival_ns;
    uint64_t seen_number;
    uint32_t seen_connection;
    uint32_t seen_arrivals;
    uint32_t seen_on_change;
    struct hd_hid_signs seen_signs;
    double usual_s;   /* between two reports */
    int64_t usual_ns; /* with usual_number, of a device that reports what changes: learned from up to here */
    uint64_t usual_number;
};

/* ---- Servo ------------------------------------------------------------------------------------------------------- */

/* What is usual between two reports, when `count` of them took `elapsed_s`. A device that reports only what changes is
 * silent now and then, so its shorter intervals say more; of several reports together, since the one after a report
 * that was held up comes too soon. */
HD_RT static void learn_usual(struct hd_hid *hid, double elapsed_s, uint64_t count) {
    const double interval_s = elapsed_s / (double)count;
    if (!(interval_s < HD_UNUSUAL_S)) {
        return;
    }
    if (hid->usual_s == 0.0) {
        hid->usual_s = interval_s;
    } else if (!hid->seen_on_change) {
        hid->usual_s += (interval_s - hid->usual_s) / 16.0;
    } else if (interval_s < hid->usual_s) {
        hid->usual_s += (interval_s - hid->usual_s) / 4.0;
    } else {
        /* A long one may be a pause and counts for little; not for nothing, or a burst would be usual for good. */
        const double most_s = 3.0 * hid->usual_s;
        hid->usual_s += ((interval_s < most_s ? interval_s : most_s) - hid->usual_s) / 64.0;
    }
}

HD_RT static void learn(struct hd_hid *hid, const struct hd_position *position, uint64_t count) {
    if (!hid->seen_on_change) {
        learn_usual(hid, (double)(position->time_ns - hid->seen_arrival_ns) * 1e-9, count);
        return;
    }
    const uint64_t together = position->number - hid->usual_number;
    if (together >= HD_USUAL_REPORTS) {
        learn_usual(hid, (double)(position->time_ns - hid->usual_ns) * 1e-9, together);
        hid->usual_ns = position->time_ns;
        hid->usual_number = position->number;
    }
}

HD_RT static void see(struct hd_hid *hid, const struct hd_position *position) {
    const int first = position->connection != hid->seen_connection;
    hid->seen.interval_s = 0.0;
    if (first) {
        hid->seen_connection = position->connection;
        hid->seen_on_change = position->on_change;
        hid->seen_signs = position->signs;
        hid->usual_s = 0.0;
        hid->usual_ns = position->time_ns;
        hid->usual_number = position->number;
        hid->seen_ns = position->time_ns;
    } else {
        const uint64_t count = position->number - hid->seen_number;
        learn(hid, position, count);
        /* A report that was held up on its way is followed by one on time, which would make the step between them look
         * too fast by far. So reports are half of what is usual apart at least; what that adds is taken back by those
         * that follow. */
        const int pauses = hid->seen_on_change && hid->usual_s > HD_FRAME_S; /* may be in what is usual */
        const double least_s = 0.5 * (pauses ? HD_FRAME_S : hid->usual_s) * (double)count;
        const double since_s = (double)(position->time_ns - hid->seen_ns) * 1e-9;
        const double interval_s = since_s > least_s ? since_s : least_s;
        hid->seen.interval_s = interval_s > 1e-6 ? interval_s : 1e-6;
        hid->seen_ns += (int64_t)(hid->seen.interval_s * 1e9);
    }
    hid->seen_arrival_ns = position->time_ns;
    hid->seen_number = position->number;
    hid->seen.position_m[0] = position->position_m[0];
    hid->seen.position_m[1] = position->position_m[1];
}

HD_RT void hd_hid_step_look(struct hd_hid *hid, int64_t now_ns, struct hd_look *look) {
    look->gone = !hd_atomic_u32_load_acquire(&hid->connected);
    look->fresh = 0;
    hid->seen.interval_s = 0.0;
    /* A position of a connection that has ended is none. */
    if (!look->gone && hd_triple_acquire(&hid->position_triple)) {
        const struct hd_position *position = &hid->positions[hd_triple_front(&hid->position_triple)];
        if (position->connection == hd_atomic_u32_load_relaxed(&hid->connection_number)) {
            see(hid, position);
            look->fresh = 1;
        }
    }
    /* No force that is of where another connection's handle was. */
    const int known = hid->seen_connection == hd_atomic_u32_load_relaxed(&hid->connection_number);
    look->gone |= hid->seen_connection != 0 && !known;
    const int silent = !look->gone && !look->fresh && hid->seen_on_change && known;
    if (silent) {
        const double usual_s = hid->usual_s > 0.0 ? hid->usual_s : HD_USUAL_FIRST_S;
        const double since_s = (double)(now_ns - hid->seen_ns) * 1e-9;
        if (since_s > 1.5 * usual_s) {
            /* Not as of now: a report may be on its way here, and must come later. */
            hid->seen.interval_s = since_s - 0.5 * usual_s;
            hid->seen_ns += (int64_t)(hid->seen.interval_s * 1e9);
            look->fresh = 1;
        }
    }
    look->reading = hid->seen;
    look->connection = hid->seen_connection;
    look->signs = &hid->seen_signs;
}

HD_RT void hd_hid_step_put(struct hd_hid *hid, int64_t now_ns, const double force_n[2]) {
    struct hd_force *force = &hid->forces[hd_triple_back(&hid->force_triple)];
    force->force_n[0] = force_n[0];
    force->force_n[1] = force_n[1];
    force->time_ns = now_ns;
    hd_triple_publish(&hid->force_triple);
}

HD_RT int hd_hid_step_offers(const struct hd_hid *hid) {
    return hd_atomic_u32_load_relaxed(&hid->offers) != 0;
}

HD_RT void hd_hid_step_strike(struct hd_hid *hid, int64_t now_ns, uint32_t effect, const double force_n[2]) {
    hd_orders_put(&hid->orders, now_ns, effect, force_n);
}

HD_RT void hd_hid_step_silence(struct hd_hid *hid) {
    hd_orders_silence(&hid->orders);
}

HD_RT static void futex_wait(const struct hd_atomic_u32 *word, uint32_t seen, int64_t until_ns) {
    const struct timespec until = {.tv_sec = (time_t)(until_ns / 1000000000), .tv_nsec = (long)(until_ns % 1000000000)};
    HD_RT_SLEEP_BEGIN
    syscall(SYS_futex, &word->value, FUTEX_WAIT_BITSET_PRIVATE, seen, &until, NULL, FUTEX_BITSET_MATCH_ANY);
    HD_RT_SLEEP_END
}

HD_RT int hd_hid_step_await(struct hd_hid *hid, int64_t until_ns, int64_t *arrival_ns) {
    for (;;) {
        const uint32_t arrivals = hd_atomic_u32_load_acquire(&hid->arrivals);
        if (arrivals != hid->seen_arrivals) {
            hid->seen_arrivals = arrivals;
            *arrival_ns = hd_atomic_i64_load_relaxed(&hid->arrived_ns);
            return 1;
        }
        if (hd_clock_now_ns() >= until_ns) {
            return 0;
        }
        futex_wait(&hid->arrivals, arrivals, until_ns);
    }
}

size_t hd_hid_size(void) {
    return sizeof(struct hd_hid);
}

/* ---- What both threads do ---------------------------------------------------------------------------------------- */

static void signal_fd(int fd) {
    const uint64_t one = 1;
    /* Refused only where the count is at its end: then it is readable anyway. */
    while (write(fd, &one, sizeof one) < 0 && errno == EINTR) {
    }
}

/* The connection is over, by the errno of what a thread met; the first one counts. */
static void fail(struct hd_connection *connection, int error) {
    struct hd_hid *hid = connection->hid;
    if (hd_atomic_u32_replace(&connection->end, HD_END_NOT, HD_END_FAILED)) {
        hd_atomic_u32_store_relaxed(&hid->error, (uint32_t)error);
        hd_atomic_u32_store_release(&hid->connected, 0);
        signal_fd(connection->end_fd);
        signal_fd(hid->event_fd);
    }
}

/* The device was reset: control has to set it up again. */
static void tell_reset(struct hd_hid *hid) {
    hd_atomic_u32_store_release(&hid->reset, 1);
    signal_fd(hid->event_fd);
}

/* ---- The reader -------------------------------------------------------------------------------------------------- */

/* What a report says of the device itself. `watching`: control has set the device up, so a change is not its doing. */
static void take_states(struct hd_hid *hid, const struct hd_report_news *news, int watching) {
    const uint32_t before = hd_atomic_u32_load_relaxed(&hid->states);
    const uint32_t known = hd_atomic_u32_load_relaxed(&hid->states_known);
    const uint32_t reset = 1u << (HD_HID_RESET - 1);
    const uint32_t actuators = 1u << (HD_HID_ACTUATORS - 1);
    const uint32_t paused = 1u << (HD_HID_PAUSED - 1);
    const uint32_t rose = news->said & news->states & ~before;
    const uint32_t fell = news->said & known & before & ~news->states;
    hd_atomic_u32_store_relaxed(&hid->states, (before & ~news->said) | news->states);
    hd_atomic_u32_store_relaxed(&hid->states_known, known | news->said);
    hd_atomic_u32_store_relaxed(&hid->states_seen, hd_atomic_u32_load_relaxed(&hid->states_seen) | news->states);
    if (watching && ((rose & reset) != 0 || (fell & actuators) != 0)) {
        tell_reset(hid);
    }
    if ((rose & known & paused) != 0) {
        hd_atomic_u32_store_release(&hid->paused, 1);
    } else if ((fell & paused) != 0) {
        hd_atomic_i64_store_relaxed(&hid->returns_ns, hd_clock_now_ns());
        hd_atomic_u32_store_release(&hid->paused, 0);
    }
}

/* What a report says of an effect of ours. `watching` as above: of an effect that ended before, nothing follows. */
static void take_effects(struct hd_connection *connection, const struct hd_report_news *news, int watching) {
    const uint32_t playing = hd_atomic_u32_load_relaxed(&connection->playing);
    const uint32_t ended = hd_atomic_u32_load_relaxed(&connection->ended);
    if (news->playing) {
        hd_atomic_u32_store_relaxed(&connection->ended, ended & ~news->effects);
        hd_atomic_u32_store_relaxed(&connection->playing, playing | news->effects);
        hd_atomic_u32_store_relaxed(&connection->told, 1);
        hd_atomic_u32_store_relaxed(&connection->hid->effects_told, 1);
    } else {
        hd_atomic_u32_store_relaxed(&connection->ended, ended | (watching ? playing & news->effects : 0u));
        hd_atomic_u32_store_relaxed(&connection->playing, playing & ~news->effects);
    }
}

/* One read(). 1: a report was read; 0: interrupted, or nothing there; else -errno. */
static int read_report(struct hd_connection *connection, int64_t now_ns, int watching, int *moved) {
    struct hd_hid *hid = connection->hid;
    uint8_t report[HD_HID_REPORT_BYTES];
    const size_t id = hd_report_numbered(&connection->plan) ? 0 : 1; /* one that the device does not send */
    report[0] = 0;
    const ssize_t length = read(connection->fd, &report[id], sizeof report - id);
    if (length < 0) {
        return errno == EINTR || errno == EAGAIN ? 0 : -errno;
    }
    if (length == 0) {
        return -ENODEV;
    }
    struct hd_report_news news;
    hd_report_take(&connection->plan, report, (size_t)length + id, &news);
    hd_atomic_i64_store_relaxed(&hid->last_report_ns, now_ns);
    if (news.short_of_it) {
        hd_atomic_u64_add_relaxed(&hid->short_reports, 1);
    }
    if (news.said != 0) {
        take_states(hid, &news, watching);
    }
    if (news.effects != 0) {
        take_effects(connection, &news, watching);
    }
    if (news.axes != 0) {
        for (int axis = 0; axis < 2; axis++) {
            if ((news.axes & 1u << axis) != 0) {
                connection->known.position_m[axis] = news.position_m[axis];
            }
        }
        connection->known.time_ns = now_ns;
        connection->known.number++;
        connection->axes_known |= news.axes;
        hd_atomic_u64_add_relaxed(&hid->read_positions, 1);
        *moved = connection->axes_known == 3;
    }
    return 1;
}

static void publish_position(struct hd_connection *connection) {
    struct hd_hid *hid = connection->hid;
    hid->positions[hd_triple_back(&hid->position_triple)] = connection->known;
    hd_triple_publish(&hid->position_triple);
    hd_atomic_i64_store_relaxed(&hid->arrived_ns, connection->known.time_ns);
    hd_atomic_u32_store_release(&hid->arrivals, hd_atomic_u32_load_relaxed(&hid->arrivals) + 1);
    if (hd_atomic_u32_load_relaxed(&hid->awaited)) {
        syscall(SYS_futex, &hid->arrivals.value, FUTEX_WAKE_PRIVATE, 1, NULL, NULL, 0);
    }
}

/* Reads what is there, as far as the newest, and publishes that. A report is counted last: whoever has read the count
 * finds what the report said. 0, or the errno of what ends the connection. */
static int drain(struct hd_connection *connection, int64_t now_ns, int watching) {
    struct hd_hid *hid = connection->hid;
    uint64_t reports = hd_atomic_u64_load_relaxed(&hid->reports);
    int moved = 0;
    int status = 1;
    for (int i = 0; i < HD_DRAIN_MAX && status >= 0; i++) {
        struct pollfd more = {.fd = connection->fd, .events = POLLIN};
        if (i > 0 && (poll(&more, 1, 0) <= 0 || (more.revents & POLLIN) == 0)) {
            break;
        }
        status = read_report(connection, now_ns, watching, &moved);
        reports += status > 0;
    }
    if (moved) {
        publish_position(connection);
    }
    hd_atomic_u64_store_release(&hid->reports, reports);
    return status < 0 ? -status : 0;
}

static void *reader_main(void *argument) {
    struct hd_connection *connection = argument;
    prctl(PR_SET_NAME, "hid reader", 0ul, 0ul, 0ul);
    for (;;) {
        struct pollfd polled[2] = {{.fd = connection->fd, .events = POLLIN},
                                   {.fd = connection->end_fd, .events = POLLIN}};
        const int ready = poll(polled, 2, -1);
        const int64_t now_ns = hd_clock_now_ns();
        if (ready < 0 && errno != EINTR) {
            fail(connection, errno);
            return NULL;
        }
        if (ready <= 0) {
            continue;
        }
        if (polled[1].revents != 0) {
            return NULL;
        }
        int error = 0;
        if ((polled[0].revents & POLLIN) != 0) {
            error = drain(connection, now_ns, 1);
        } else if (polled[0].revents != 0) {
            error = ENODEV; /* unplugged, and nothing left to read */
        }
        if (error != 0) {
            fail(connection, error);
            return NULL;
        }
    }
}

/* ---- The writer -------------------------------------------------------------------------------------------------- */

static void running_mean(struct hd_atomic_i64 *mean, int64_t value) {
    const int64_t before = hd_atomic_i64_load_relaxed(mean);
    hd_atomic_i64_store_relaxed(mean, before == 0 ? value : before + (value - before) / (1 << HD_MEAN_SHIFT));
}

/* Waits until a descriptor that does not block takes more. 0, ECANCELED where the connection ends meanwhile, or an
 * errno. */
static int wait_writable(struct hd_connection *connection) {
    struct pollfd polled[2] = {{.fd = connection->fd, .events = POLLOUT}, {.fd = connection->end_fd, .events = POLLIN}};
    int ready;
    if (connection->leaving) {
        const int64_t left_ns = connection->leaving_until_ns - hd_clock_now_ns();
        ready = poll(polled, 1, left_ns > 0 ? (int)(left_ns / 1000000) : 0);
    } else {
        ready = poll(polled, 2, -1);
    }
    if (ready < 0) {
        return errno == EINTR ? 0 : errno;
    }
    return ready == 0 ? ETIMEDOUT : !connection->leaving && polled[1].revents != 0 ? ECANCELED : 0;
}

/* Writes one report. 0, the errno of what ends the connection, ECANCELED where it has ended, or -1: given up by
 * control, which leaves nothing but `connection` itself to touch. */
static int write_report(struct hd_connection *connection, const uint8_t *bytes, uint32_t length) {
    struct hd_hid *hid = connection->hid;
    for (;;) {
        const int64_t start_ns = hd_clock_now_ns();
        if (hd_last_is_over()) {
            return ECANCELED;
        }
        if (connection->leaving ? start_ns > connection->leaving_until_ns
                                : hd_atomic_u32_load_acquire(&connection->end) != HD_END_NOT) {
            return connection->leaving ? ETIMEDOUT : ECANCELED;
        }
        hd_atomic_u32_store_release(&connection->phase, HD_PHASE_WRITING);
        const ssize_t written = write(connection->fd, bytes, length);
        const int error = written < 0 ? errno : 0;
        if (!hd_atomic_u32_replace(&connection->phase, HD_PHASE_WRITING, HD_PHASE_IDLE)) {
            return -1;
        }
        if (written == (ssize_t)length) {
            const int64_t end_ns = hd_clock_now_ns();
            const int64_t half_ns = (end_ns - start_ns) / 2;
            connection->next_write_ns = start_ns + connection->plan.write_interval_ns;
            connection->written_ns = end_ns;
            connection->fresh_until_ns = end_ns + (half_ns < HD_FRESH_NS ? half_ns : HD_FRESH_NS);
            hd_atomic_u64_add_relaxed(&hid->writes, 1);
            running_mean(&hid->write_ns, end_ns - start_ns);
            return 0;
        }
        if (written >= 0) {
            return EIO;
        }
        if (error != EINTR && error != EAGAIN) {
            return error;
        }
        const int refused = error == EAGAIN ? wait_writable(connection) : 0;
        if (refused != 0) {
            return refused;
        }
    }
}

/* How much of the force a device that was reset or paused gets: nothing until it is set up again or goes on, then more
 * and more. */
static double returned(struct hd_hid *hid, int64_t now_ns) {
    if (hd_atomic_u32_load_acquire(&hid->reset) || hd_atomic_u32_load_acquire(&hid->paused)) {
        return 0.0;
    }
    const double since = (double)(now_ns - hd_atomic_i64_load_relaxed(&hid->returns_ns)) / (double)HD_RETURN_NS;
    return since < 1.0 ? since > 0.0 ? since : 0.0 : 1.0;
}

/* The force as of now: the newest, unless it is too old, of an earlier connection, or not finite. */
static void take_force(struct hd_connection *connection, int64_t now_ns, double force_n[2]) {
    struct hd_hid *hid = connection->hid;
    hd_triple_acquire(&hid->force_triple);
    const struct hd_force *force = &hid->forces[hd_triple_front(&hid->force_triple)];
    const int good = force->time_ns >= connection->start_ns && now_ns - force->time_ns <= HD_FORCE_AGE_NS &&
                     isfinite(force->force_n[0]) && isfinite(force->force_n[1]);
    const double share = good ? returned(hid, now_ns) : 0.0;
    force_n[0] = good ? share * force->force_n[0] : 0.0;
    force_n[1] = good ? share * force->force_n[1] : 0.0;
    if (force_n[0] != 0.0 || force_n[1] != 0.0) {
        connection->direction_rad = hd_report_direction(force_n);
    }
}

/* Whether the force at hand is from before the last write was done. */
static int is_stale(const struct hd_connection *connection) {
    const struct hd_hid *hid = connection->hid;
    return hid->forces[hd_triple_front(&hid->force_triple)].time_ns <= connection->written_ns;
}

/* When to look for a newer force than the one at hand: a look before it may be there, then every 50 us. */
static int64_t next_look_ns(const struct hd_connection *connection) {
    const struct hd_hid *hid = connection->hid;
    const int64_t now_ns = hd_clock_now_ns();
    const int64_t due_ns = hid->forces[hd_triple_front(&hid->force_triple)].time_ns +
                           hd_atomic_i64_load_relaxed(&hid->tick_ns) - HD_LOOK_NS;
    const int64_t soonest_ns = now_ns + HD_LOOK_NS;
    const int64_t latest_ns = now_ns + HD_LOOK_MOST_NS;
    return due_ns < soonest_ns ? soonest_ns : due_ns > latest_ns ? latest_ns : due_ns;
}

/* A message as of now. A write that blocked ends with a frame, and the next one brings a position: what is in the
 * mailbox then is a frame old, so that half as long as the write took a newer force is waited for (docs/adr/0014). */
static void compose_now(struct hd_connection *connection, const struct hd_hid_message *message, uint8_t *bytes) {
    double force_n[2] = {0.0, 0.0};
    if (hd_clock_now_ns() < connection->next_write_ns) {
        hd_clock_sleep_until(connection->next_write_ns);
    }
    if (connection->begun && !connection->leaving) {
        take_force(connection, hd_clock_now_ns(), force_n);
        while (is_stale(connection) && hd_clock_now_ns() < connection->fresh_until_ns) {
            const int64_t look_ns = next_look_ns(connection);
            hd_clock_sleep_until(look_ns < connection->fresh_until_ns ? look_ns : connection->fresh_until_ns);
            take_force(connection, hd_clock_now_ns(), force_n);
        }
    }
    hd_report_compose(message, force_n, connection->direction_rad, bytes);
}

/* Goes once through the force messages, each with the force as it is when its turn comes: the second may be newer than
 * the first. `all`: also those that did not change. *changed: how many did. */
static int write_forces(struct hd_connection *connection, int all, uint32_t *changed) {
    const struct hd_hid_script *script = &connection->plan.force;
    *changed = 0;
    for (uint32_t i = 0; i < script->count; i++) {
        const struct hd_hid_message *message = &script->messages[i];
        uint8_t bytes[HD_HID_REPORT_BYTES];
        compose_now(connection, message, bytes);
        const int same =
            (connection->sent_once & 1u << i) != 0 && memcmp(bytes, connection->sent[i], message->length) == 0;
        if (same && !all) {
            continue;
        }
        const int error = write_report(connection, bytes, message->length);
        if (error != 0) {
            return error;
        }
        memcpy(connection->sent[i], bytes, message->length);
        connection->sent_once |= 1u << i;
        *changed += !same;
    }
    return 0;
}

static int write_message(struct hd_connection *connection, const struct hd_hid_message *message) {
    uint8_t bytes[HD_HID_REPORT_BYTES];
    compose_now(connection, message, bytes);
    return write_report(connection, bytes, message->length);
}

static int write_script(struct hd_connection *connection, const struct hd_hid_script *script) {
    for (uint32_t i = 0; i < script->count; i++) {
        const int error = write_message(connection, &script->messages[i]);
        if (error != 0) {
            return error;
        }
    }
    return 0;
}

/* Whether a reset, or an effect of another program's in the place of ours, would not be seen. */
static int is_untold(const struct hd_connection *connection, int64_t now_ns) {
    const int watched = connection->plan.effects.count > 0;
    return !hd_atomic_u32_load_relaxed(&connection->told) && (!watched || now_ns - connection->start_ns > HD_UNTOLD_NS);
}

/* One message at most: forces come in between. */
static int write_restore(struct hd_connection *connection) {
    const struct hd_hid_plan *plan = &connection->plan;
    const int64_t now_ns = hd_clock_now_ns();
    if (plan->restore.count == 0 || now_ns < connection->restore_ns || !is_untold(connection, now_ns)) {
        return 0;
    }
    const int64_t next_ns = connection->restore_ns + plan->restore_ns;
    connection->restore_ns = next_ns > now_ns ? next_ns : now_ns;
    const uint32_t which = connection->restored % plan->restore.count;
    connection->restored = which + 1;
    return write_message(connection, &plan->restore.messages[which]);
}

/* What the device is to play by itself: all of one strike at most, so that the next force comes in between. */
static int write_orders(struct hd_connection *connection) {
    struct hd_hid *hid = connection->hid;
    for (uint32_t i = 0; i < HD_HID_OFFER_MESSAGES; i++) {
        uint8_t bytes[HD_HID_REPORT_BYTES];
        if (hd_clock_now_ns() < connection->next_write_ns) {
            hd_clock_sleep_until(connection->next_write_ns);
        }
        const int64_t now_ns = hd_clock_now_ns();
        const int64_t returns_ns = hd_atomic_i64_load_relaxed(&hid->returns_ns);
        const int64_t since_ns = returns_ns > connection->start_ns ? returns_ns : connection->start_ns;
        connection->player.unsure = connection->plan.restore.count > 0 && is_untold(connection, now_ns);
        const uint32_t length =
            hd_player_next(&connection->player, &hid->orders, now_ns, since_ns, returned(hid, now_ns) == 1.0, bytes);
        const int error = length > 0 ? write_report(connection, bytes, length) : 0;
        if (length == 0 || error != 0) {
            return error;
        }
    }
    return 0;
}

static void count_pass(struct hd_connection *connection) {
    struct hd_hid *hid = connection->hid;
    const int64_t now_ns = hd_clock_now_ns();
    hd_atomic_u64_add_relaxed(&hid->sent_forces, 1);
    if (connection->last_pass_ns != 0 && connection->idle_ns < HD_IDLE_NS) {
        running_mean(&hid->write_interval_ns, now_ns - connection->last_pass_ns);
    }
    connection->last_pass_ns = now_ns;
    connection->idle_ns = 0;
}

int hd_hid_forgotten(struct hd_renewals *renewals, const struct hd_hid_effects *effects, uint32_t playing,
                     uint32_t ended, int excused) {
    int found = 0;
    for (uint32_t i = 0; i < effects->count; i++) {
        uint32_t *played = &renewals->played[i];
        uint32_t *waited = &renewals->waited[i];
        *played = (playing >> i & 1u) == 0 ? 0 : *played < effects->proof ? *played + 1 : *played;
        renewals->proven |= *played >= effects->proof;
        if ((ended >> i & 1u) == 0) {
            *waited = 0;
        } else if (*waited <= HD_FORGET_RENEWALS) {
            *waited = excused ? 0 : *waited + 1;
            found |= *waited > HD_FORGET_RENEWALS;
        }
    }
    found = found && (renewals->proven || !renewals->guessed);
    renewals->guessed |= found;
    return found;
}

/* Asked when effects are about to be renewed. */
static int has_forgotten(struct hd_connection *connection) {
    const struct hd_hid *hid = connection->hid;
    const uint32_t safety = 1u << (HD_HID_SAFETY - 1);
    /* On a device that has no such switch it was never closed. */
    const uint32_t off = hd_atomic_u32_load_relaxed(&hid->states_seen) & ~hd_atomic_u32_load_relaxed(&hid->states);
    const int excused =
        hd_atomic_u32_load_acquire(&hid->reset) || hd_atomic_u32_load_acquire(&hid->paused) || (off & safety) != 0;
    return hd_hid_forgotten(&connection->renewals, &connection->plan.effects,
                            hd_atomic_u32_load_relaxed(&connection->playing),
                            hd_atomic_u32_load_relaxed(&connection->ended), excused);
}

/* Until the connection ends. As write_report. */
static int write_on(struct hd_connection *connection) {
    const struct hd_hid_plan *plan = &connection->plan;
    int64_t renew_ns = connection->start_ns; /* when it is due: at once, the set-up was a while ago */
    int error = write_script(connection, &plan->begin);
    if (error != 0) {
        return error;
    }
    for (;;) {
        const int renews = plan->renew_ns > 0 && hd_clock_now_ns() >= renew_ns;
        uint32_t changed = 0;
        if (renews && has_forgotten(connection)) {
            tell_reset(connection->hid);
        }
        error = write_forces(connection, renews, &changed);
        connection->begun = 1;
        if (error == 0 && renews) {
            renew_ns = hd_clock_now_ns() + plan->renew_ns;
            error = write_script(connection, &plan->renew);
        }
        error = error == 0 ? write_restore(connection) : error;
        error = error == 0 ? write_orders(connection) : error;
        if (error == 0 && hd_atomic_u32_load_acquire(&connection->end) != HD_END_NOT) {
            error = ECANCELED;
        }
        if (error != 0) {
            return error;
        }
        if (changed > 0) {
            count_pass(connection);
        } else {
            const int64_t begin_ns = hd_clock_now_ns();
            hd_clock_sleep_until(next_look_ns(connection));
            connection->idle_ns += hd_clock_now_ns() - begin_ns;
        }
    }
}

static void connection_free(struct hd_connection *connection) {
    const int fds[3] = {connection->fd, connection->end_fd, connection->left_fd};
    for (int i = 0; i < 3; i++) {
        if (fds[i] >= 0) {
            close(fds[i]);
        }
    }
    free(connection);
}

/* The pauses between the last writes take half of the time for them at most, however slow the device wants them. */
static void hurry(struct hd_connection *connection) {
    struct hd_hid_plan *plan = &connection->plan;
    const int64_t pause_ns = connection->parting_ns / 2 / (1 + plan->force.count + plan->stop.count);
    const int64_t latest_ns = hd_clock_now_ns() + pause_ns;
    plan->write_interval_ns = plan->write_interval_ns < pause_ns ? plan->write_interval_ns : pause_ns;
    connection->next_write_ns = connection->next_write_ns < latest_ns ? connection->next_write_ns : latest_ns;
}

/* Given up, and back: what the device has taken in the end was perhaps a force. */
static void write_zero(const struct hd_connection *connection) {
    const struct hd_hid_script *script = &connection->plan.force;
    const double none[2] = {0.0, 0.0};
    int taken = 1;
    for (uint32_t i = 0; i < script->count && taken; i++) {
        const uint32_t length = script->messages[i].length;
        uint8_t bytes[HD_HID_REPORT_BYTES];
        hd_report_compose(&script->messages[i], none, connection->direction_rad, bytes);
        taken = write(connection->fd, bytes, length) == (ssize_t)length;
    }
}

static void *writer_main(void *argument) {
    struct hd_connection *connection = argument;
    prctl(PR_SET_NAME, "hid writer", 0ul, 0ul, 0ul);
    /* Without real-time priority the kernel may round sleeps by 50 us. */
    prctl(PR_SET_TIMERSLACK, 1ul, 0ul, 0ul, 0ul);
    int error = write_on(connection);
    if (error > 0 && error != ECANCELED) {
        fail(connection, error);
    }
    const uint32_t end = hd_atomic_u32_load_acquire(&connection->end);
    if (error > 0 && end != HD_END_NOW) {
        uint32_t changed;
        connection->leaving = 1;
        connection->leaving_until_ns =
            end == HD_END_ORDERLY ? connection->parting_until_ns : hd_clock_now_ns() + connection->parting_ns;
        hurry(connection);
        error = write_forces(connection, 1, &changed);
        if (error >= 0) { /* also where the force is refused */
            const int stopped = write_script(connection, &connection->plan.stop);
            error = error == 0 || stopped < 0 ? stopped : error;
        }
        if (error >= 0) {
            connection->parting_error = error;
        }
    }
    if (error < 0) {
        write_zero(connection);
        connection_free(connection);
    } else {
        signal_fd(connection->left_fd);
    }
    return NULL;
}

/* ---- Control side ------------------------------------------------------------------------------------------------ */

struct hd_hid *hd_hid_new(void) {
    struct hd_hid *hid = NULL;
    if (posix_memalign((void **)&hid, HD_CACHE_LINE, sizeof *hid) != 0) {
        return NULL;
    }
    memset(hid, 0, sizeof *hid);
    hid->event_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    if (hid->event_fd < 0) {
        free(hid);
        return NULL;
    }
    hd_triple_init(&hid->position_triple);
    hd_triple_init(&hid->force_triple);
    hd_orders_init(&hid->orders);
    hid->parting_ns = HD_PARTING_NS;
    hid->seen.true_velocity_m_per_s[0] = hid->seen.true_velocity_m_per_s[1] = (double)NAN;
    return hid;
}

void hd_hid_free(struct hd_hid *hid) {
    if (hid == NULL) {
        return;
    }
    hd_hid_disconnect(hid, 1);
    close(hid->event_fd);
    free(hid);
}

void hd_hid_await_enable(struct hd_hid *hid) {
    hd_atomic_u32_store_relaxed(&hid->awaited, 1);
}

void hd_hid_expect_ticks(struct hd_hid *hid, int64_t tick_ns) {
    hd_atomic_i64_store_relaxed(&hid->tick_ns, tick_ns);
}

void hd_hid_set_parting(struct hd_hid *hid, int64_t parting_ns) {
    hid->parting_ns = parting_ns;
}

static struct hd_connection *connection_new(struct hd_hid *hid, const struct hd_hid_plan *plan, int fd) {
    struct hd_connection *connection = NULL;
    if (posix_memalign((void **)&connection, HD_CACHE_LINE, sizeof *connection) != 0) {
        return NULL;
    }
    memset(connection, 0, sizeof *connection);
    connection->hid = hid;
    connection->plan = *plan;
    connection->fd = fcntl(fd, F_DUPFD_CLOEXEC, 0);
    connection->end_fd = eventfd(0, EFD_CLOEXEC);
    connection->left_fd = eventfd(0, EFD_CLOEXEC);
    connection->start_ns = connection->restore_ns = hd_clock_now_ns();
    connection->parting_ns = hid->parting_ns;
    connection->known.on_change = plan->on_change;
    connection->known.signs = plan->signs;
    hd_player_init(&connection->player, &hid->orders);
    if (connection->fd < 0 || connection->end_fd < 0 || connection->left_fd < 0) {
        const int error = errno;
        connection_free(connection);
        errno = error;
        return NULL;
    }
    return connection;
}

/* What a new connection knows nothing of. */
static void forget(struct hd_hid *hid) {
    hd_atomic_u32_store_relaxed(&hid->error, 0);
    hd_atomic_u32_store_relaxed(&hid->reset, 0);
    hd_atomic_u32_store_relaxed(&hid->paused, 0);
    hd_atomic_i64_store_relaxed(&hid->returns_ns, INT64_MIN / 2);
    hd_atomic_u32_store_relaxed(&hid->states, 0);
    hd_atomic_u32_store_relaxed(&hid->states_known, 0);
    hd_atomic_u32_store_relaxed(&hid->states_seen, 0);
    hd_atomic_u32_store_relaxed(&hid->effects_told, 0);
    hd_atomic_u64_store_relaxed(&hid->reports, 0);
    hd_atomic_u64_store_relaxed(&hid->read_positions, 0);
    hd_atomic_u64_store_relaxed(&hid->short_reports, 0);
    hd_atomic_i64_store_relaxed(&hid->last_report_ns, 0);
    hd_atomic_u64_store_relaxed(&hid->writes, 0);
    hd_atomic_u64_store_relaxed(&hid->sent_forces, 0);
    hd_atomic_i64_store_relaxed(&hid->write_ns, 0);
    hd_atomic_i64_store_relaxed(&hid->write_interval_ns, 0);
}

static int create_thread(pthread_t *thread, void *(*run)(void *), struct hd_connection *connection, int priority) {
    pthread_attr_t attributes;
    int error = pthread_attr_init(&attributes);
    if (error != 0) {
        return error;
    }
    if (priority > 0) {
        const struct sched_param parameter = {.sched_priority = priority};
        pthread_attr_setinheritsched(&attributes, PTHREAD_EXPLICIT_SCHED);
        pthread_attr_setschedpolicy(&attributes, SCHED_FIFO);
        error = pthread_attr_setschedparam(&attributes, &parameter);
    }
    if (error == 0) {
        error = pthread_create(thread, &attributes, run, connection);
    }
    pthread_attr_destroy(&attributes);
    return error;
}

/* Signals are for the process's own threads; SIGPIPE is what a device that left would send to the writer. 0, or an
 * errno and no thread. */
static int create_threads(struct hd_connection *connection, int priority) {
    sigset_t all;
    sigset_t before;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    int error = create_thread(&connection->reader, reader_main, connection, priority);
    if (error == 0) {
        error = create_thread(&connection->writer, writer_main, connection, priority);
        if (error != 0) {
            hd_atomic_u32_replace(&connection->end, HD_END_NOT, HD_END_NOW);
            signal_fd(connection->end_fd);
            pthread_join(connection->reader, NULL);
        }
    }
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    return error;
}

int hd_hid_connect(struct hd_hid *hid, const struct hd_hid_plan *plan, int fd, int priority) {
    if (hid->connection != NULL) {
        if (hd_atomic_u32_load_acquire(&hid->connected)) {
            return hd_invalid("hid: there is a connection already");
        }
        hd_hid_disconnect(hid, 0);
    }
    if (hd_report_check(plan) != HD_OK) {
        return HD_ERR_INVALID;
    }
    if (priority < 0 || priority > 99) {
        return hd_invalid("hid: priority %d is not between 0 and 99", priority);
    }
    errno = 0;
    struct hd_connection *connection = connection_new(hid, plan, fd);
    if (connection == NULL) {
        return errno == ENOMEM || errno == 0 ? HD_ERR_MEMORY : HD_ERR_SYSTEM;
    }
    forget(hid);
    const uint32_t number = hd_atomic_u32_load_relaxed(&hid->connection_number) + 1;
    hd_atomic_u32_store_relaxed(&hid->connection_number, number);
    connection->known.connection = number;
    /* What waits to be read is from before: it tells where the handle is and how the device is, but nothing that has
     * happened to it since it was set up. What ends the connection, the reader meets again. */
    struct pollfd waiting = {.fd = connection->fd, .events = POLLIN};
    if (poll(&waiting, 1, 0) > 0 && (waiting.revents & POLLIN) != 0) {
        drain(connection, connection->start_ns, 0);
    }
    hd_atomic_u32_store_release(&hid->connected, 1);
    const int error = create_threads(connection, priority);
    if (error != 0) {
        hd_atomic_u32_store_release(&hid->connected, 0);
        connection_free(connection);
        errno = error;
        return error == EPERM ? HD_ERR_DENIED : HD_ERR_SYSTEM;
    }
    hid->connection = connection;
    return HD_OK;
}

/* Joins the writer, or gives it up if it is in write() when the time is over: a write to a device may block for
 * seconds, and nothing can interrupt it. 0 or an errno. */
static int join_writer(struct hd_connection *connection) {
    const pthread_t writer = connection->writer;
    struct pollfd left = {.fd = connection->left_fd, .events = POLLIN};
    for (;;) {
        const int64_t rest_ns = connection->parting_until_ns - hd_clock_now_ns();
        if (poll(&left, 1, rest_ns > 0 ? (int)(rest_ns / 1000000) + 1 : 1) > 0) {
            pthread_join(writer, NULL);
            const int error = connection->parting_error;
            connection_free(connection);
            return error;
        }
        if (hd_clock_now_ns() >= connection->parting_until_ns &&
            hd_atomic_u32_replace(&connection->phase, HD_PHASE_WRITING, HD_PHASE_GIVEN_UP)) {
            pthread_detach(writer);
            return ETIMEDOUT;
        }
    }
}

int hd_hid_disconnect(struct hd_hid *hid, int orderly) {
    struct hd_connection *connection = hid->connection;
    if (connection == NULL) {
        return 0;
    }
    connection->parting_until_ns = hd_clock_now_ns() + connection->parting_ns;
    const int lost = !hd_atomic_u32_replace(&connection->end, HD_END_NOT, orderly ? HD_END_ORDERLY : HD_END_NOW);
    hd_atomic_u32_store_release(&hid->connected, 0);
    hd_atomic_u32_store_relaxed(&hid->offers, 0);
    signal_fd(connection->end_fd);
    pthread_join(connection->reader, NULL);
    hid->connection = NULL;
    const int error = join_writer(connection);
    return lost ? (int)hd_atomic_u32_load_relaxed(&hid->error) : error;
}

int hd_hid_offer(struct hd_hid *hid, const struct hd_hid_offers *effects) {
    if (hid->connection == NULL) {
        return HD_OK;
    }
    const int status = hd_player_offer(&hid->connection->player, effects);
    if (status == HD_OK) {
        hd_atomic_u32_store_relaxed(&hid->offers, effects->count > 0);
    }
    return status;
}

void hd_hid_status(const struct hd_hid *hid, struct hd_hid_status *status) {
    /* These first: the rest is as new as they are. */
    const uint64_t reports = hd_atomic_u64_load_acquire(&hid->reports);
    const uint32_t connected = hd_atomic_u32_load_acquire(&hid->connected);
    *status = (struct hd_hid_status){
        .connected = connected,
        .error = (int32_t)hd_atomic_u32_load_relaxed(&hid->error),
        .reset = hd_atomic_u32_load_acquire(&hid->reset),
        .states = hd_atomic_u32_load_relaxed(&hid->states),
        .states_known = hd_atomic_u32_load_relaxed(&hid->states_known),
        .effects_told = hd_atomic_u32_load_relaxed(&hid->effects_told),
        .reports = reports,
        .positions = hd_atomic_u64_load_relaxed(&hid->read_positions),
        .short_reports = hd_atomic_u64_load_relaxed(&hid->short_reports),
        .writes = hd_atomic_u64_load_relaxed(&hid->writes),
        .forces = hd_atomic_u64_load_relaxed(&hid->sent_forces),
        .write_ns = hd_atomic_i64_load_relaxed(&hid->write_ns),
        .write_interval_ns = hd_atomic_i64_load_relaxed(&hid->write_interval_ns),
        .last_report_ns = hd_atomic_i64_load_relaxed(&hid->last_report_ns),
        .strikes = hd_atomic_u64_load_relaxed(&hid->orders.played),
        .strikes_lost = hd_orders_lost(&hid->orders),
    };
}

int hd_hid_wait(struct hd_hid *hid, int64_t timeout_ns) {
    const int64_t until_ns = hd_clock_now_ns() + (timeout_ns > 0 ? timeout_ns : 0);
    for (;;) {
        const int64_t rest_ns = until_ns - hd_clock_now_ns();
        const struct timespec rest = {.tv_sec = rest_ns > 0 ? (time_t)(rest_ns / 1000000000) : 0,
                                      .tv_nsec = rest_ns > 0 ? (long)(rest_ns % 1000000000) : 0};
        struct pollfd event = {.fd = hid->event_fd, .events = POLLIN};
        const int ready = ppoll(&event, 1, &rest, NULL);
        uint64_t count;
        if (ready > 0 && read(hid->event_fd, &count, sizeof count) == (ssize_t)sizeof count) {
            return 1;
        }
        if (ready == 0) {
            return 0;
        }
    }
}

void hd_hid_wake(struct hd_hid *hid) {
    signal_fd(hid->event_fd);
}

void hd_hid_suspect(struct hd_hid *hid) {
    tell_reset(hid);
}

void hd_hid_clear_reset(struct hd_hid *hid) {
    hd_atomic_i64_store_relaxed(&hid->returns_ns, hd_clock_now_ns());
    hd_atomic_u32_store_release(&hid->reset, 0);
}
