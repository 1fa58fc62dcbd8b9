/* When an onset was, and when grooves were passed: what bench/timing.py compares. The crossings are those of
 * csrc/shapes/hd_wall.c and csrc/tick/hd_groove.c, without what a contact does with them. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>

#include "peers.h"

double peer_onset(int kind, size_t count, double period_s, const double *depth, const double *speed, double *before_s) {
    const double start_ns = peer_clock_ns();
    for (size_t k = 0; k < count; k++) {
        const double from = depth[2 * k];
        const double to = depth[2 * k + 1];
        double before = 0.0;
        if (kind == PEER_ONSET_LINEAR) {
            before = (1.0 - from / (from - to)) * period_s;
        } else if (kind == PEER_ONSET_SPEED) {
            before = speed[k] > 0.0 ? to / speed[k] : 0.0;
            before = before > period_s ? period_s : before;
        }
        before_s[k] = before;
    }
    return peer_clock_ns() - start_ns;
}

double peer_grooves(int kind, size_t count, double period_s, double spacing_m, const double *along, size_t capacity,
                    double *time_s, int64_t *which, size_t *found) {
    const double start_ns = peer_clock_ns();
    size_t strikes = 0;
    int64_t last = (int64_t)floor(along[0] / spacing_m);
    for (size_t k = 1; k < count; k++) {
        const int64_t now = (int64_t)floor(along[k] / spacing_m);
        if (now == last) {
            continue;
        }
        const int64_t step = now > last ? 1 : -1;
        /* Groove g lies between floor g - 1 and floor g. */
        int64_t groove = now > last ? last + 1 : last;
        int64_t left = now > last ? now - last : last - now;
        if (kind == PEER_GROOVE_TICK_ONE) {
            groove += step * (left - 1);
            left = 1;
        }
        for (; left > 0; left--, groove += step, strikes++) {
            double part = 1.0;
            if (kind == PEER_GROOVE_CROSSING) {
                part = ((double)groove * spacing_m - along[k - 1]) / (along[k] - along[k - 1]);
            }
            if (strikes < capacity) {
                time_s[strikes] = ((double)(k - 1) + part) * period_s;
                which[strikes] = groove;
            }
        }
        last = now;
    }
    *found = strikes;
    return peer_clock_ns() - start_ns;
}
