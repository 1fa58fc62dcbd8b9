/* The control side of a HID device: makes it, connects it over a hidraw node with two threads, disconnects it, and
 * reads its counters. hd_hid_connection.h gives the overview. */
#include "device/hd_hid_connection.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <sched.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "base/hd_clock.h"
#include "device/hd_last_report.h"

#define HD_PARTING_NS 500000000 /* default time limit for the writes at the end, see hd_hid_set_parting */

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
    hd_effect_queue_init(&hid->effect_queue);
    hid->parting_ns = HD_PARTING_NS;
    hid->seen.true_velocity_m_per_s[0] = hid->seen.true_velocity_m_per_s[1] = (double)NAN;
    return hid;
}

void hd_hid_hold(struct hd_hid *hid) {
    hd_holders_join(&hid->holders);
}

void hd_hid_free(struct hd_hid *hid) {
    if (hid == NULL || !hd_holders_leave(&hid->holders)) {
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
    hd_effect_sender_init(&connection->effect_sender, &hid->effect_queue);
    if (connection->fd < 0 || connection->end_fd < 0 || connection->left_fd < 0) {
        const int error = errno;
        hd_connection_free(connection);
        errno = error;
        return NULL;
    }
    return connection;
}

/* Resets the state and the counters for a new connection. */
static void reset_counters(struct hd_hid *hid) {
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

/* Starts both threads with all signals blocked except those of crashes, so that signals go to the process's other
 * threads and an unplugged device cannot send SIGPIPE to the writer. Returns 0, or an errno with no thread running. */
static int create_threads(struct hd_connection *connection, int priority) {
    sigset_t all;
    sigset_t before;
    sigfillset(&all);
    hd_last_report_let_through(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    int error = create_thread(&connection->reader, hd_hid_reader_main, connection, priority);
    if (error == 0) {
        error = create_thread(&connection->writer, hd_hid_writer_main, connection, priority);
        if (error != 0) {
            hd_atomic_u32_replace(&connection->end, HD_END_NOT, HD_END_NOW);
            hd_hid_signal(connection->end_fd);
            pthread_join(connection->reader, NULL);
        }
    }
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    return error;
}

int hd_hid_connect(struct hd_hid *hid, const struct hd_hid_plan *plan, int fd, int priority) {
    if (hid->connection != NULL) {
        if (hd_atomic_u32_load_acquire(&hid->connected)) {
            return hd_invalid("hid: already connected");
        }
        hd_hid_disconnect(hid, 0);
    }
    if (hd_hid_check(plan) != HD_OK) {
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
    reset_counters(hid);
    const uint32_t number = hd_atomic_u32_load_relaxed(&hid->connection_number) + 1;
    hd_atomic_u32_store_relaxed(&hid->connection_number, number);
    connection->known.connection = number;
    /* Waiting reports are older than the connection: they give position and state of the device, but do not show events
     * after its set-up. An error is ignored here, because the reader meets it again. */
    struct pollfd waiting = {.fd = connection->fd, .events = POLLIN};
    if (poll(&waiting, 1, 0) > 0 && (waiting.revents & POLLIN) != 0) {
        hd_hid_drain(connection, connection->start_ns, 0);
    }
    hd_atomic_u32_store_release(&hid->connected, 1);
    const int error = create_threads(connection, priority);
    if (error != 0) {
        hd_atomic_u32_store_release(&hid->connected, 0);
        hd_connection_free(connection);
        errno = error;
        return error == EPERM ? HD_ERR_DENIED : HD_ERR_SYSTEM;
    }
    hid->connection = connection;
    return HD_OK;
}

/* Joins the writer, or abandons it if it is in write() at the deadline: a write to a device may block for seconds and
 * cannot be interrupted. Returns 0 or an errno. */
static int join_writer(struct hd_connection *connection) {
    const pthread_t writer = connection->writer;
    struct pollfd has_left = {.fd = connection->left_fd, .events = POLLIN};
    for (;;) {
        const int64_t rest_ns = connection->parting_until_ns - hd_clock_now_ns();
        if (poll(&has_left, 1, rest_ns > 0 ? (int)(rest_ns / 1000000) + 1 : 1) > 0) {
            pthread_join(writer, NULL);
            const int error = connection->parting_error;
            hd_connection_free(connection);
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
    hd_atomic_u32_store_relaxed(&hid->has_effects, 0);
    hd_hid_signal(connection->end_fd);
    pthread_join(connection->reader, NULL);
    hid->connection = NULL;
    const int error = join_writer(connection);
    return lost ? (int)hd_atomic_u32_load_relaxed(&hid->error) : error;
}

int hd_hid_set_effects(struct hd_hid *hid, const struct hd_device_effects *effects) {
    if (hid->connection == NULL) {
        return HD_OK;
    }
    const int status = hd_effect_sender_set(&hid->connection->effect_sender, effects);
    if (status == HD_OK) {
        hd_atomic_u32_store_relaxed(&hid->has_effects, effects->count > 0);
    }
    return status;
}

void hd_hid_status(const struct hd_hid *hid, struct hd_hid_status *status) {
    /* The number of reports is read first, so that the other members are at least as new. */
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
        .strikes = hd_atomic_u64_load_relaxed(&hid->effect_queue.played),
        .strikes_lost = hd_effect_queue_lost(&hid->effect_queue),
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
    hd_hid_signal(hid->event_fd);
}

void hd_hid_clear_reset(struct hd_hid *hid) {
    hd_atomic_i64_store_relaxed(&hid->returns_ns, hd_clock_now_ns());
    hd_atomic_u32_store_release(&hid->reset, 0);
}
