/* Prefetch into the processor's cache. A tick prefetches all memory that it is about to use, so that lines evicted
 * while the servo slept load in parallel instead of one miss after the other. Prefetching is a hint: it does not wait,
 * and any address is allowed. */
#ifndef HD_CACHE_H
#define HD_CACHE_H

#include <stddef.h>

#include "base/hd_atomic.h"
#include "base/hd_rt.h"

HD_RT static inline void hd_cache_fetch(const void *start, size_t size) {
    for (size_t at = 0; at < size; at += HD_CACHE_LINE) {
        __builtin_prefetch((const char *)start + at);
    }
}

#endif
