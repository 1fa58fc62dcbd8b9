/* The floor that a daemon is measured against: reads a position from hidraw, writes a force, and does nothing else.
 *
 * floor NODE SECONDS: the virtual joystick's reports (usb_pid_joystick.py). One effect along x is set up and pulls as
 * the spring of job_latency.py does, half the full scale at the end of the way; it is started again every 40 ms, as the
 * daemon does. One thread; its writes block. */
#include <fcntl.h>
#include <linux/hidraw.h>
#include <poll.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

static int64_t now_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

static void say(int fd, const uint8_t *report, size_t length) {
    if (write(fd, report, length) != (ssize_t)length) {
        perror("write");
        exit(1);
    }
}

int main(int argc, char **argv) {
    if (argc != 3) {
        fprintf(stderr, "floor NODE SECONDS\n");
        return 2;
    }
    const struct sched_param priority = {.sched_priority = 80};
    int fd = open(argv[1], O_RDWR | O_CLOEXEC | O_NONBLOCK);
    if (fd < 0 || mlockall(MCL_CURRENT | MCL_FUTURE) != 0 || sched_setscheduler(0, SCHED_FIFO, &priority) != 0) {
        perror(argv[1]);
        return 1;
    }
    say(fd, (const uint8_t[]){12, 4}, 2);
    say(fd, (const uint8_t[]){12, 1}, 2);
    say(fd, (const uint8_t[]){13, 255}, 2);
    uint8_t feature[16] = {5, 1, 0, 0};
    if (ioctl(fd, HIDIOCSFEATURE(4), feature) < 0) {
        perror("Create New Effect");
        return 1;
    }
    memset(feature, 0, sizeof feature);
    feature[0] = 6;
    if (ioctl(fd, HIDIOCGFEATURE(5), feature) < 0 || feature[2] != 1) {
        perror("Block Load");
        return 1;
    }
    const uint8_t effect = feature[1];
    say(fd, (const uint8_t[]){1, effect, 1, 100, 0, 0, 0, 0, 0, 0, 0, 255, 255, 1, 0, 0}, 16);
    const uint8_t start[] = {10, effect, 1, 1};
    say(fd, start, sizeof start);

    const int64_t end_ns = now_ns() + atoll(argv[2]) * 1000000000;
    int64_t renew_ns = 0;
    for (int64_t now = now_ns(); now < end_ns; now = now_ns()) {
        /* hidraw keeps what was not read while a write blocked: only the newest counts. */
        struct pollfd reports = {.fd = fd, .events = POLLIN};
        uint8_t report[64];
        int16_t x = 0;
        int moved = 0;
        ssize_t length;
        if (poll(&reports, 1, 1000) != 1) {
            fprintf(stderr, "no reports\n");
            return 1;
        }
        while ((length = read(fd, report, sizeof report)) > 0) {
            if (length == 5 && report[0] == 1) {
                memcpy(&x, report + 1, sizeof x);
                moved = 1;
            }
        }
        if (!moved) {
            continue;
        }
        int16_t magnitude = (int16_t)(-x * 5000 / 32767);
        uint8_t force[] = {5, effect, (uint8_t)magnitude, (uint8_t)((uint16_t)magnitude >> 8)};
        say(fd, force, sizeof force);
        if (now >= renew_ns) {
            say(fd, start, sizeof start);
            renew_ns = now + 40000000;
        }
    }
    close(fd);
    return 0;
}
