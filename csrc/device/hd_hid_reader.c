/* The reader of a HID connection: polls, drains to the newest report, publishes its position with the time at which
 * poll returned, and notes the state of the device. A separate thread while connected. */
#include "device/hd_hid_connection.h"

#include <errno.h>
#include <linux/futex.h>
#include <poll.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "base/hd_clock.h"
#include "device/hd_report.h"

#define HD_DRAIN_MAX 256 /* reports read before the newest is published; hidraw keeps 64 */

/* Takes the states of the device from a report. `watching`: control has set the device up, so it did not cause the
 * change. */
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
        hd_hid_suspect(hid);
    }
    if ((rose & known & paused) != 0) {
        hd_atomic_u32_store_release(&hid->paused, 1);
    } else if ((fell & paused) != 0) {
        hd_atomic_i64_store_relaxed(&hid->returns_ns, hd_clock_now_ns());
        hd_atomic_u32_store_release(&hid->paused, 0);
    }
}

/* Takes the play state of one of our effects from a report. `watching` as above: the end of an effect before the set-up
 * is ignored. */
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

/* Calls read() once. Returns 1 if a report was read, 0 if interrupted or nothing was waiting, else -errno. */
static int read_report(struct hd_connection *connection, int64_t now_ns, int watching, int *moved) {
    struct hd_hid *hid = connection->hid;
    uint8_t report[HD_HID_REPORT_BYTES];
    const size_t id =
        hd_report_numbered(&connection->plan) ? 0 : 1; /* 1: reports have no id, and an id of 0 is put in front */
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

int hd_hid_drain(struct hd_connection *connection, int64_t now_ns, int watching) {
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

void *hd_hid_reader_main(void *argument) {
    struct hd_connection *connection = argument;
    prctl(PR_SET_NAME, "hid reader", 0ul, 0ul, 0ul);
    for (;;) {
        struct pollfd polled[2] = {{.fd = connection->fd, .events = POLLIN},
                                   {.fd = connection->end_fd, .events = POLLIN}};
        const int ready = poll(polled, 2, -1);
        const int64_t now_ns = hd_clock_now_ns();
        if (ready < 0 && errno != EINTR) {
            hd_connection_fail(connection, errno);
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
            error = hd_hid_drain(connection, now_ns, 1);
        } else if (polled[0].revents != 0) {
            error = ENODEV; /* unplugged, and no report is waiting */
        }
        if (error != 0) {
            hd_connection_fail(connection, error);
            return NULL;
        }
    }
}
