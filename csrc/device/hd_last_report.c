/* The signal handler that sets the device's force to zero when the process crashes. It uses only static memory and
 * async-signal-safe calls. The reports to send are in one of two buffers; control fills the other one, then switches to
 * it. */
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

#define HD_LAST_REPORT_PAUSE_MS 100 /* longest pause between two reports, and longest wait for a busy device */
#define HD_LAST_REPORT_SETTLE_MS 5  /* wait before the second pass, by which time the writer's last write has ended */
#define HD_LAST_REPORT_LIMIT_S 2u   /* time limit, because a device may accept nothing */

struct hd_last_reports {
    uint8_t bytes[2 * HD_HID_MESSAGES][HD_HID_REPORT_BYTES];
    uint32_t lengths[2 * HD_HID_MESSAGES];
    uint32_t count;
    int pause_ms;
    int fd; /* duplicated descriptor; used only while `count` is not 0 */
};

static const int fault_signals[] = {SIGABRT, SIGSEGV, SIGBUS, SIGILL, SIGFPE};
#define HD_LAST_REPORT_SIGNALS (sizeof fault_signals / sizeof fault_signals[0])

static struct sigaction previous_actions[HD_LAST_REPORT_SIGNALS];
static struct hd_last_reports buffers[2];
static struct hd_atomic_u32 current_buffer; /* index of the buffer in use; control writes, the handler reads */
static struct hd_atomic_u32 is_crashing;    /* 1: the process is crashing; the handler writes, any thread reads */

int hd_last_report_is_over(void) {
    return hd_atomic_u32_load_relaxed(&is_crashing) != 0;
}

void hd_last_report_let_through(sigset_t *blocked) {
    for (size_t i = 0; i < HD_LAST_REPORT_SIGNALS; i++) {
        sigdelset(blocked, fault_signals[i]);
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
    if (hd_atomic_u32_exchange_acq_rel(&is_crashing, 1) == 0) {
        sigset_t alarms;
        sigemptyset(&alarms);
        sigaddset(&alarms, SIGALRM);
        signal(SIGALRM, SIG_DFL);
        pthread_sigmask(SIG_UNBLOCK, &alarms, NULL);
        alarm(HD_LAST_REPORT_LIMIT_S);
        const struct hd_last_reports *last = &buffers[hd_atomic_u32_load_acquire(&current_buffer)];
        if (last->count > 0) {
            send_all(last);
            poll(NULL, 0, HD_LAST_REPORT_SETTLE_MS);
            send_all(last);
        }
        alarm(0);
    } else {
        poll(NULL, 0, HD_LAST_REPORT_PAUSE_MS); /* another thread is sending the reports */
    }
    for (size_t i = 0; i < HD_LAST_REPORT_SIGNALS; i++) {
        if (fault_signals[i] == number) {
            sigaction(number, &previous_actions[i], NULL);
        }
    }
    raise(number); /* delivered to the previous handler when this one returns */
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
        if (sigaction(fault_signals[i], NULL, &now) == 0 && now.sa_handler != on_fault) {
            previous_actions[i] = now;
            sigaction(fault_signals[i], &action, NULL);
        }
    }
}

static void switch_to(uint32_t buffer) {
    const uint32_t other = 1u - buffer;
    hd_atomic_u32_store_release(&current_buffer, buffer);
    if (buffers[other].count > 0) {
        buffers[other].count = 0;
        close(buffers[other].fd);
    }
}

int hd_last_report_keep(int fd, const uint8_t *reports, const uint32_t *lengths, uint32_t count, double pause_s) {
    const uint32_t buffer = 1u - hd_atomic_u32_load_relaxed(&current_buffer);
    struct hd_last_reports *last = &buffers[buffer];
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
    switch_to(buffer);
    return HD_OK;
}

void hd_last_report_drop(void) {
    buffers[1u - hd_atomic_u32_load_relaxed(&current_buffer)].count = 0;
    switch_to(1u - hd_atomic_u32_load_relaxed(&current_buffer));
}
