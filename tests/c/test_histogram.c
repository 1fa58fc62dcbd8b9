/* Histograms: every time falls between the edges of its bin, counts, sum and maximum add up. */
#include <stdio.h>

#include "base/hd_histogram.h"
#include "hd_test.h"

static uint32_t searched(int64_t time_ns) {
    uint32_t bin = 0;

    while (bin < HD_HISTOGRAM_BINS - 1 && time_ns >= hd_histogram_edge_ns(bin)) {
        bin++;
    }
    return bin;
}

static void times_lie_between_their_edges(void) {
    for (uint32_t i = 0; i < HD_HISTOGRAM_BINS - 1; i++) {
        const int64_t edge = hd_histogram_edge_ns(i);

        CHECK(i == 0 || edge > hd_histogram_edge_ns(i - 1));
        for (int64_t near = -2; near <= 2; near++) {
            CHECK(hd_histogram_bin(edge + near) == searched(edge + near));
        }
    }
    for (int64_t time_ns = -5; time_ns < 3000; time_ns++) {
        CHECK(hd_histogram_bin(time_ns) == searched(time_ns));
    }
    CHECK(hd_histogram_bin(INT64_MIN) == 0 && hd_histogram_bin(INT64_MAX) == HD_HISTOGRAM_BINS - 1);
}

static void counts_add_up(void) {
    static struct hd_histogram_counts counts;
    struct hd_histogram histogram;
    uint64_t total = 0;

    hd_histogram_count(&counts, -100);
    hd_histogram_count(&counts, 200);
    hd_histogram_count(&counts, 200);
    hd_histogram_count(&counts, 5000000000);
    hd_histogram_read(&counts, &histogram);
    for (uint32_t i = 0; i < HD_HISTOGRAM_BINS; i++) {
        total += histogram.counts[i];
    }
    CHECK(total == 4 && histogram.counts[0] == 1 && histogram.counts[searched(200)] == 2);
    CHECK(histogram.sum_ns == 5000000400 && histogram.max_ns == 5000000000);
}

int main(void) {
    times_lie_between_their_edges();
    counts_add_up();
    puts("test_histogram: ok");
    return 0;
}
