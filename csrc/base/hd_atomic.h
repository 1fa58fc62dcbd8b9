/* Typed wrappers around C11 atomics. The value sits inside a struct, so that a plain `=` or `++` does not compile and
 * every access names its memory order. Each declaration says which thread writes it and which reads it.
 *
 * Any thread. All operations are lock-free and may be called from the servo. */
#ifndef HD_ATOMIC_H
#define HD_ATOMIC_H

#include <assert.h>
#include <stdatomic.h>
#include <stdint.h>

#include "base/hd_rt.h"

static_assert(ATOMIC_INT_LOCK_FREE == 2 && ATOMIC_LLONG_LOCK_FREE == 2, "the servo must never meet a lock");

/* Bytes of a cache line. Values that two threads write must be at least this distance from each other, or each write
 * stalls the other thread. */
#define HD_CACHE_LINE 64

/* replace sets the value to `to` if it is `from`, and returns 1 if it did. add_relaxed is a load and a store: exact
 * only if a single thread writes, and then cheaper than a locked add. */
#define HD_ATOMIC_DEFINE(NAME, TYPE)                                                                            \
    struct hd_atomic_##NAME {                                                                                   \
        _Atomic TYPE value;                                                                                     \
    };                                                                                                          \
    HD_RT static inline TYPE hd_atomic_##NAME##_load_relaxed(const struct hd_atomic_##NAME *atomic) {           \
        return atomic_load_explicit(&atomic->value, memory_order_relaxed);                                      \
    }                                                                                                           \
    HD_RT static inline TYPE hd_atomic_##NAME##_load_acquire(const struct hd_atomic_##NAME *atomic) {           \
        return atomic_load_explicit(&atomic->value, memory_order_acquire);                                      \
    }                                                                                                           \
    HD_RT static inline void hd_atomic_##NAME##_store_relaxed(struct hd_atomic_##NAME *atomic, TYPE value) {    \
        atomic_store_explicit(&atomic->value, value, memory_order_relaxed);                                     \
    }                                                                                                           \
    HD_RT static inline void hd_atomic_##NAME##_store_release(struct hd_atomic_##NAME *atomic, TYPE value) {    \
        atomic_store_explicit(&atomic->value, value, memory_order_release);                                     \
    }                                                                                                           \
    HD_RT static inline TYPE hd_atomic_##NAME##_exchange_acq_rel(struct hd_atomic_##NAME *atomic, TYPE value) { \
        return atomic_exchange_explicit(&atomic->value, value, memory_order_acq_rel);                           \
    }                                                                                                           \
    HD_RT static inline int hd_atomic_##NAME##_replace(struct hd_atomic_##NAME *atomic, TYPE from, TYPE to) {   \
        return atomic_compare_exchange_strong(&atomic->value, &from, to);                                       \
    }                                                                                                           \
    HD_RT static inline void hd_atomic_##NAME##_add_relaxed(struct hd_atomic_##NAME *atomic, TYPE value) {      \
        hd_atomic_##NAME##_store_relaxed(atomic, hd_atomic_##NAME##_load_relaxed(atomic) + value);              \
    }                                                                                                           \
    static_assert(sizeof(struct hd_atomic_##NAME) == sizeof(TYPE), "an atomic is as large as its value")

HD_ATOMIC_DEFINE(u32, uint32_t);
HD_ATOMIC_DEFINE(u64, uint64_t);
HD_ATOMIC_DEFINE(i64, int64_t);
HD_ATOMIC_DEFINE(f64, double);

#undef HD_ATOMIC_DEFINE

#endif
