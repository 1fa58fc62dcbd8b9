/* Random delays before everything that threads meet at: each access to an atomic, each system call of a connection. A
 * starved machine stops a thread at any of these places; here that happens often enough to be met in a few runs. `make
 * jitter` includes this file before every source of the core and of the tests.
 *
 * Another HD_JITTER_SEED (a number) gives other delays. It does not repeat a schedule: the kernel has a part in that.
 */
#ifndef HD_JITTER_H
#define HD_JITTER_H

#include <errno.h>
#include <poll.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "base/hd_atomic.h"

#define HD_JITTER_ATOMICS 512u /* one access in so many waits */
#define HD_JITTER_CALLS 8u     /* one call in so many waits */
#define HD_JITTER_SHORT_NS 500000u
#define HD_JITTER_LONG 64u /* one wait in so many is a long one */
#define HD_JITTER_LONG_NS 30000000u

static inline void hd_jitter(unsigned odds) {
    static _Thread_local uint64_t random; /* xorshift64 */
    if (random == 0) {
        const char *seed = getenv("HD_JITTER_SEED");
        random = (uint64_t)(uintptr_t)&random + (seed != NULL ? strtoull(seed, NULL, 10) * 0x9e3779b97f4a7c15u : 0);
    }
    random ^= random << 13;
    random ^= random >> 7;
    random ^= random << 17;
    if ((random >> 20) % odds == 0) {
        const int error = errno;
        const unsigned most_ns = (random >> 40) % HD_JITTER_LONG == 0 ? HD_JITTER_LONG_NS : HD_JITTER_SHORT_NS;
        nanosleep(&(struct timespec){.tv_nsec = (long)((random >> 8) % most_ns)}, NULL);
        errno = error;
    }
}

/* A macro is not expanded within itself: what stands after the comma is the function. */
#define HD_JITTER_BEFORE(odds, call) (hd_jitter(odds), call)

#define hd_atomic_u32_load_relaxed(a) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_u32_load_relaxed(a))
#define hd_atomic_u32_load_acquire(a) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_u32_load_acquire(a))
#define hd_atomic_u32_store_relaxed(a, v) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_u32_store_relaxed(a, v))
#define hd_atomic_u32_store_release(a, v) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_u32_store_release(a, v))
#define hd_atomic_u32_exchange_acq_rel(a, v) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_u32_exchange_acq_rel(a, v))
#define hd_atomic_u32_replace(a, f, t) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_u32_replace(a, f, t))
#define hd_atomic_u32_add_relaxed(a, v) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_u32_add_relaxed(a, v))
#define hd_atomic_u64_load_relaxed(a) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_u64_load_relaxed(a))
#define hd_atomic_u64_load_acquire(a) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_u64_load_acquire(a))
#define hd_atomic_u64_store_relaxed(a, v) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_u64_store_relaxed(a, v))
#define hd_atomic_u64_store_release(a, v) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_u64_store_release(a, v))
#define hd_atomic_u64_exchange_acq_rel(a, v) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_u64_exchange_acq_rel(a, v))
#define hd_atomic_u64_replace(a, f, t) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_u64_replace(a, f, t))
#define hd_atomic_u64_add_relaxed(a, v) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_u64_add_relaxed(a, v))
#define hd_atomic_i64_load_relaxed(a) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_i64_load_relaxed(a))
#define hd_atomic_i64_load_acquire(a) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_i64_load_acquire(a))
#define hd_atomic_i64_store_relaxed(a, v) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_i64_store_relaxed(a, v))
#define hd_atomic_i64_store_release(a, v) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_i64_store_release(a, v))
#define hd_atomic_i64_exchange_acq_rel(a, v) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_i64_exchange_acq_rel(a, v))
#define hd_atomic_i64_replace(a, f, t) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_i64_replace(a, f, t))
#define hd_atomic_i64_add_relaxed(a, v) HD_JITTER_BEFORE(HD_JITTER_ATOMICS, hd_atomic_i64_add_relaxed(a, v))
#define poll(...) HD_JITTER_BEFORE(HD_JITTER_CALLS, poll(__VA_ARGS__))
#define read(...) HD_JITTER_BEFORE(HD_JITTER_CALLS, read(__VA_ARGS__))
#define write(...) HD_JITTER_BEFORE(HD_JITTER_CALLS, write(__VA_ARGS__))
#define send(...) HD_JITTER_BEFORE(HD_JITTER_CALLS, send(__VA_ARGS__))
#define recv(...) HD_JITTER_BEFORE(HD_JITTER_CALLS, recv(__VA_ARGS__))

#endif
