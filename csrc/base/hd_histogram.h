/* Histograms of durations, with four bins per factor of two.
 *
 *     below 128 ns | 128 .. 160 | 160 .. 192 | 192 .. 224 | 224 .. 256 | 256 .. 320 | ... | from 2^27 ns on
 *
 * Counting needs no search: the bin follows from the position of the highest bit and the two bits below it. The servo
 * writes, any thread reads; the numbers are read one by one, not atomically together. Nanoseconds. */
#ifndef HD_HISTOGRAM_H
#define HD_HISTOGRAM_H

#include "api/hd_core.h"
#include "base/hd_atomic.h"
#include "base/hd_rt.h"

/* The first edge is 2^7 ns, the last one 2^27 ns. */
#define HD_HISTOGRAM_LEAST_BIT 7
#define HD_HISTOGRAM_MOST_BIT 27

static_assert(HD_HISTOGRAM_BINS == 2 + 4 * (HD_HISTOGRAM_MOST_BIT - HD_HISTOGRAM_LEAST_BIT), "two bins are open ends");

struct hd_histogram_counts {
    struct hd_atomic_u64 bins[HD_HISTOGRAM_BINS];
    struct hd_atomic_u64 sum_ns;
    struct hd_atomic_i64 max_ns;
};

HD_RT static inline uint32_t hd_histogram_bin(int64_t time_ns) {
    if (time_ns < (int64_t)1 << HD_HISTOGRAM_LEAST_BIT) {
        return 0;
    }
    if (time_ns >= (int64_t)1 << HD_HISTOGRAM_MOST_BIT) {
        return HD_HISTOGRAM_BINS - 1;
    }
    const uint32_t bit = 31u - (uint32_t)__builtin_clz((uint32_t)time_ns);
    return 1u + 4u * (bit - HD_HISTOGRAM_LEAST_BIT) + (((uint32_t)time_ns >> (bit - 2u)) & 3u);
}

/* Servo thread. A negative time counts as 0. */
HD_RT static inline void hd_histogram_count(struct hd_histogram_counts *counts, int64_t time_ns) {
    hd_atomic_u64_add_relaxed(&counts->bins[hd_histogram_bin(time_ns)], 1);
    if (time_ns > 0) {
        hd_atomic_u64_add_relaxed(&counts->sum_ns, (uint64_t)time_ns);
    }
    if (time_ns > hd_atomic_i64_load_relaxed(&counts->max_ns)) {
        hd_atomic_i64_store_relaxed(&counts->max_ns, time_ns);
    }
}

/* Any thread. */
void hd_histogram_read(const struct hd_histogram_counts *counts, struct hd_histogram *histogram);

#endif
