/* HD_RT marks functions that the servo thread may call: no allocation, no lock, no log, no system call but clock and
 * sleep. If clang knows the attribute, -Wfunction-effects proves it at compile time and RealtimeSanitizer at run time.
 *
 * The files of this room, tools for every other room:
 *
 *   hd_rt         the marks of functions that the servo may call
 *   hd_atomic     atomics whose every access names its memory order
 *   hd_ring       queue of records from one thread to another, without loss
 *   hd_triple     newest value from one thread to another
 *   hd_spacing    usual time between arrivals
 *   hd_clock      the servo's clock and its sleep
 *   hd_memory     memory touched and locked before the servo starts
 *   hd_cache      memory prefetched before a tick uses it
 *   hd_histogram  histograms of durations
 *   hd_vector     vectors of the plane
 *   hd_gaussian   Gaussian numbers from random bits
 *   hd_holders    reference counts: the last holder frees an object
 *   hd_bits       numbers at any bit of a HID report
 *   hd_send       one message to many sockets in one call */
#ifndef HD_RT_H
#define HD_RT_H

#if defined(__clang__) && defined(__has_attribute)
#if __has_attribute(nonblocking)
#define HD_RT __attribute__((nonblocking))
#endif
#endif
#ifndef HD_RT
#define HD_RT
#endif

/* Put around calls of libm, the clock and the sleep, the only foreign functions that the servo may call: their headers
 * do not declare them nonblocking. */
#if defined(__clang__) && defined(__has_warning)
#if __has_warning("-Wfunction-effects")
#define HD_RT_FOREIGN_BEGIN _Pragma("clang diagnostic push") _Pragma("clang diagnostic ignored \"-Wfunction-effects\"")
#define HD_RT_FOREIGN_END _Pragma("clang diagnostic pop")
#endif
#endif
#ifndef HD_RT_FOREIGN_BEGIN
#define HD_RT_FOREIGN_BEGIN
#define HD_RT_FOREIGN_END
#endif

/* Put around the one system call by which the servo sleeps on something other than the clock, so that RealtimeSanitizer
 * accepts it. */
#if defined(__has_feature)
#if __has_feature(realtime_sanitizer)
#include <sanitizer/rtsan_interface.h>
#define HD_RT_SLEEP_BEGIN HD_RT_FOREIGN_BEGIN __rtsan_disable();
#define HD_RT_SLEEP_END \
    __rtsan_enable();   \
    HD_RT_FOREIGN_END
#endif
#endif
#ifndef HD_RT_SLEEP_BEGIN
#define HD_RT_SLEEP_BEGIN HD_RT_FOREIGN_BEGIN
#define HD_RT_SLEEP_END HD_RT_FOREIGN_END
#endif

#endif
