/* The processor's cache: what is about to be used is asked for at once, so that what was evicted while the servo slept
 * comes in side by side and not one miss after the other. A hint: nothing waits for it, and any address will do. */
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
