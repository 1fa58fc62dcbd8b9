/* The signal handler that takes the device's force to zero when the process ends by a fault. It uses nothing but static
 * memory and calls that are safe in a signal handler. What it sends lies ready in one of two places; control fills the
 * other one and then points to it. */
#include "device/hd_last_report.h"

#include "api/hd_core.h"
#include "base/hd_atomic.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pthread.h>
#include <signal.h>
#include <stddef.h>
#include <string.h>
#include <unistd.h>

#define HD_LAST_REPORT_PAUSE_MS 100 /* the longest between two reports, and for a device that is busy */
#define HD_LAST_REPORT_SETTLE_MS 5  /* a write of the writer's that is under way is done by then */
#define HD_LAST_REPORT_LIMIT_S 2u   /* a device that takes nothing keeps nobody from ending */

struct hd_last_reports {
    uint8_t bytes[2 * HD_HID_MESSAGES][HD_HID_REPORT_BYTES];
    uint32_t lengths[2 * HD_HID_MESSAGES];
    uint32_t count;
    int pause_ms;
    int fd; /* of our own; used only while `count` is not 0 */
};

static const int signals[] = {SIGABRT, SIGSEGV, SIGBUS, SIGILL, SIGFPE};
#define HD_LAST_REPORT_SIGNALS (sizeof signals / sizeof signals[0])

static struct sigaction before[HD_LAST_REPORT_SIGNALS];
static struct hd_last_reports places[2];
static struct hd_atomic_u32 current; /* control writes, the handler reads: which place */
static struct hd_atomic_u32 over;    /* the handler writes, everybody reads */

int hd_last_report_is_over(void) {
    return hd_atomic_u32_load_relaxed(&over) != 0;
}

void hd_last_report_let_through(sigset_t *blocked) {
    for (size_t i = 0; i < HD_LAST_REPORT_SIGNALS; i++) {
        sigdelset(blocked, signals[i]);
    }
}

static void send_all(const struct hd_last_reports *last) {
    for (uint32_t i = 0; i < last->count; i++) {
        if (i > 0 && last->pause_ms > 0) {
            poll(NULL, 0, last->pause_ms);
        }
        while (write(last->fd, last->bytes[i], last->lengths[i]) < 0 && (errno == EAGAIN || errno == EINTR)) {
            struct pollfd writable = {.fd = last->fd, .events = POLLOUT, .revents = 0};
            if (poll(&writable, 1, HD_LAST_REPORT_PAUSE_MS) == 0) {
                break;
            }
        }
    }
}

static void on_fault(int number) {
    const int saved = errno;
    if (hd_atomic_u32_exchange_acq_rel(&over, 1) == 0) {
        sigset_t alarms;
        sigemptyset(&alarms);
        sigaddset(&alarms, SIGALRM);
        signal(SIGALRM, SIG_DFL);
        pthread_sigmask(SIG_UNBLOCK, &alarms, NULL);
        alarm(HD_LAST_REPORT_LIMIT_S);
        const struct hd_last_reports *last = &places[hd_atomic_u32_load_acquire(&current)];
        if (last->count > 0) {
            send_all(last);
            poll(NULL, 0, HD_LAST_REPORT_SETTLE_MS);
            send_all(last);
        }
        alarm(0);
    } else {
        poll(NULL, 0, HD_LAST_REPORT_PAUSE_MS); /* another thread is at it */
    }
    for (size_t i = 0; i < HD_LAST_REPORT_SIGNALS; i++) {
        if (signals[i] == number) {
            sigaction(number, &before[i], NULL);
        }
    }
    raise(number); /* comes when this handler returns, to whoever had the signal before */
    errno = saved;
}

void hd_last_report_arm(void) {
    struct sigaction action;
    memset(&action, 0, sizeof action);
    sigemptyset(&action.sa_mask);
    action.sa_handler = on_fault;
    action.sa_flags = SA_ONSTACK;
    for (size_t i = 0; i < HD_LAST_REPORT_SIGNALS; i++) {
        struct sigaction now;
        if (sigaction(signals[i], NULL, &now) == 0 && now.sa_handler != on_fault) {
            before[i] = now;
            sigaction(signals[i], &action, NULL);
        }
    }
}

static void point_to(uint32_t place) {
    const uint32_t other = 1u - place;
    hd_atomic_u32_store_release(&current, place);
    if (places[other].count > 0) {
        places[other].count = 0;
        close(places[other].fd);
    }
}

int hd_last_report_keep(int fd, const uint8_t *reports, const uint32_t *lengths, uint32_t count, double pause_s) {
    const uint32_t place = 1u - hd_atomic_u32_load_relaxed(&current);
    struct hd_last_reports *last = &places[place];
    if (count > 2 * HD_HID_MESSAGES) {
        return HD_ERR_INVALID;
    }
    const uint8_t *next = reports;
    for (uint32_t i = 0; i < count; i++) {
        if (lengths[i] > HD_HID_REPORT_BYTES) {
            return HD_ERR_INVALID;
        }
        memcpy(last->bytes[i], next, lengths[i]);
        last->lengths[i] = lengths[i];
        next += lengths[i];
    }
    const double pause_ms = 1e3 * pause_s;
    last->pause_ms =
        pause_ms > 0.0 ? (pause_ms < HD_LAST_REPORT_PAUSE_MS ? (int)pause_ms + 1 : HD_LAST_REPORT_PAUSE_MS) : 0;
    if (count > 0) {
        last->fd = fcntl(fd, F_DUPFD_CLOEXEC, 0);
        if (last->fd < 0) {
            return HD_ERR_INVALID;
        }
    }
    last->count = count;
    point_to(place);
    return HD_OK;
}

void hd_last_report_drop(void) {
    places[1u - hd_atomic_u32_load_relaxed(&current)].count = 0;
    point_to(1u - hd_atomic_u32_load_relaxed(&current));
}
