/* What a process that ends by a fault still sends to its device: a force of zero, then its stop reports, twice, and
 * then it ends by the very signal. */
#include "api/hd_core.h"
#include "device/hd_last_report.h"
#include "hd_test.h"

#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

static const uint8_t reports[] = {1, 0, 0, 2, 9, 9, 9};
static const uint32_t lengths[] = {3, 4};

static void *fault(void *number) {
    raise(*(int *)number);
    return NULL;
}

/* Ends a child by `number`, in a thread if `beside`, after `set_up`; what its device got goes to `got`. */
static size_t end(int number, int beside, void (*set_up)(int fd), uint8_t *got, size_t room) {
    int pair[2];
    CHECK(socketpair(AF_UNIX, SOCK_SEQPACKET, 0, pair) == 0);
    const pid_t child = fork();
    CHECK(child >= 0);
    if (child == 0) {
        close(pair[0]);
        for (int each = 1; each < 32; each++) {
            if (each != SIGKILL && each != SIGSTOP) {
                signal(each, SIG_DFL); /* a sanitizer's own */
            }
        }
        hd_last_report_arm();
        hd_last_report_arm(); /* again makes no difference */
        set_up(pair[1]);
        pthread_t thread;
        if (beside && pthread_create(&thread, NULL, fault, &number) == 0) {
            pthread_join(thread, NULL);
        }
        if (number == SIGABRT) {
            abort();
        }
        raise(number);
        _exit(0);
    }
    close(pair[1]);
    size_t filled = 0;
    for (;;) {
        const ssize_t came = read(pair[0], got + filled, room - filled);
        if (came <= 0) {
            break;
        }
        filled += (size_t)came;
    }
    close(pair[0]);
    int status;
    CHECK(waitpid(child, &status, 0) == child);
    CHECK(WIFSIGNALED(status) && WTERMSIG(status) == number);
    return filled;
}

static void keep(int fd) {
    CHECK(hd_last_report_keep(fd, reports, lengths, 2, 0.0) == HD_OK);
    CHECK(!hd_last_report_is_over());
    close(fd);
}

static void keep_another(int fd) {
    const uint8_t other[] = {7};
    const uint32_t one = 1;
    CHECK(hd_last_report_keep(fd, other, &one, 1, 0.0) == HD_OK);
    keep(fd);
}

static void drop(int fd) {
    keep(fd);
    hd_last_report_drop();
}

static void keep_on(int fd) {
    drop(fcntl(fd, F_DUPFD, 0));
    keep(fd);
}

static void refuse(int fd) {
    const uint32_t long_one = HD_HID_REPORT_BYTES + 1;
    uint8_t bytes[HD_HID_REPORT_BYTES + 1] = {0};
    CHECK(hd_last_report_keep(fd, reports, lengths, 2, 0.0) == HD_OK);
    CHECK(hd_last_report_keep(fd, bytes, &long_one, 1, 0.0) == HD_ERR_INVALID);
    CHECK(hd_last_report_keep(fd, reports, lengths, 2 * HD_HID_MESSAGES + 1, 0.0) == HD_ERR_INVALID);
    CHECK(hd_last_report_keep(-1, reports, lengths, 1, 0.0) == HD_ERR_INVALID);
    close(fd);
}

static void nothing(int fd) {
    close(fd);
}

static void check_twice(const uint8_t *got, size_t size) {
    CHECK(size == 2 * sizeof reports);
    CHECK(memcmp(got, reports, sizeof reports) == 0 && memcmp(got + sizeof reports, reports, sizeof reports) == 0);
}

int main(void) {
    static const int numbers[] = {SIGABRT, SIGSEGV, SIGBUS, SIGILL, SIGFPE};
    uint8_t got[256];
    for (size_t i = 0; i < sizeof numbers / sizeof numbers[0]; i++) {
        check_twice(got, end(numbers[i], 0, keep, got, sizeof got));
        check_twice(got, end(numbers[i], 1, keep, got, sizeof got));
    }
    check_twice(got, end(SIGSEGV, 0, keep_another, got, sizeof got));
    check_twice(got, end(SIGSEGV, 0, keep_on, got, sizeof got));
    check_twice(got, end(SIGSEGV, 0, refuse, got, sizeof got));
    CHECK(end(SIGSEGV, 0, drop, got, sizeof got) == 0);
    CHECK(end(SIGABRT, 0, nothing, got, sizeof got) == 0);
    printf("test_last_report: ok\n");
    return 0;
}
