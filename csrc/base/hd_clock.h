/* The servo's clock: CLOCK_MONOTONIC and sleeping until an absolute time, the only system calls of the servo's loop.
 * CLOCK_BOOTTIME also counts time during which the machine is suspended, which CLOCK_MONOTONIC does not. */
#ifndef HD_CLOCK_H
#define HD_CLOCK_H

#include <errno.h>
#include <stdint.h>
#include <time.h>

#include "base/hd_rt.h"

HD_RT static inline int64_t hd_clock_read_ns(clockid_t clock) {
    struct timespec now;
    HD_RT_FOREIGN_BEGIN
    clock_gettime(clock, &now);
    HD_RT_FOREIGN_END
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

HD_RT static inline int64_t hd_clock_now_ns(void) {
    return hd_clock_read_ns(CLOCK_MONOTONIC);
}

/* Returns CLOCK_BOOTTIME, which continues while the machine is suspended. */
HD_RT static inline int64_t hd_clock_boot_ns(void) {
    return hd_clock_read_ns(CLOCK_BOOTTIME);
}

HD_RT static inline void hd_clock_sleep_until(int64_t time_ns) {
    const struct timespec until = {.tv_sec = (time_t)(time_ns / 1000000000), .tv_nsec = (long)(time_ns % 1000000000)};
    HD_RT_FOREIGN_BEGIN
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL) == EINTR) {
    }
    HD_RT_FOREIGN_END
}

#endif
