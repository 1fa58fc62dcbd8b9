/* Reads histograms of durations for the control side, and computes the edges of their bins. */
#include "base/hd_histogram.h"

int64_t hd_histogram_edge_ns(uint32_t index) {
    const int64_t octave = (int64_t)1 << (HD_HISTOGRAM_LEAST_BIT + index / 4u);
    return octave + octave / 4 * (int64_t)(index % 4u);
}

void hd_histogram_read(const struct hd_histogram_counts *counts, struct hd_histogram *histogram) {
    for (uint32_t i = 0; i < HD_HISTOGRAM_BINS; i++) {
        histogram->counts[i] = hd_atomic_u64_load_relaxed(&counts->bins[i]);
    }
    histogram->sum_ns = hd_atomic_u64_load_relaxed(&counts->sum_ns);
    histogram->max_ns = hd_atomic_i64_load_relaxed(&counts->max_ns);
}
