/* Velocity estimators to compare with csrc/hd_velocity.c; for bench/velocity.py alone. Both axes, SI units.
 *
 * First-order adaptive windowing (Janabi-Sharifi, Hayward, Chen, "Discrete-time adaptive windowing for velocity
 * estimation", IEEE Trans. Control Systems Technology 8(6), 2000): the longest window, up to a limit, whose line stays
 * within d of every sample in it. end: the line through the newest and the oldest sample; best: the least-squares line.
 * d is one encoder step, for both: half a step is too strict for a line through two quantised samples, and is worse.
 * The end fit keeps the cone of admissible slopes, so that it looks at every sample once. */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <time.h>

#include "hd_velocity.h"

#define RING 128u

void peer_backward(size_t count, const double *interval_s, const double *position, double *velocity);
void peer_foaw(int best, size_t window, double step_m, size_t count, const double *interval_s, const double *position,
               double *velocity);
void peer_update_ns(double step_m, size_t count, const double *interval_s, const double *position, double *ns);

void peer_backward(size_t count, const double *interval_s, const double *position, double *velocity) {
    for (size_t a = 0; a < 2; a++) {
        velocity[a] = 0.0;
    }
    for (size_t k = 1; k < count; k++) {
        for (size_t a = 0; a < 2; a++) {
            velocity[2 * k + a] = (position[2 * k + a] - position[2 * k + a - 2]) / interval_s[k];
        }
    }
}

static double foaw_end(const double *time_s, const double *position_m, size_t newest, size_t window, double d) {
    const double t = time_s[newest % RING];
    const double p = position_m[newest % RING];
    double low = -HUGE_VAL;
    double high = HUGE_VAL;
    double velocity = 0.0;
    for (size_t back = 1; back < window && back <= newest; back++) {
        const double run = 1.0 / (t - time_s[(newest - back) % RING]);
        const double slope = (p - position_m[(newest - back) % RING]) * run;
        if (slope < low || slope > high) {
            break;
        }
        velocity = slope;
        low = fmax(low, slope - d * run);
        high = fmin(high, slope + d * run);
    }
    return velocity;
}

static double foaw_best(const double *time_s, const double *position_m, size_t newest, size_t window, double d) {
    const double t = time_s[newest % RING];
    const double p = position_m[newest % RING];
    double n = 1.0, st = 0.0, sp = 0.0, stt = 0.0, stp = 0.0;
    double velocity = 0.0;
    for (size_t back = 1; back < window && back <= newest; back++) {
        const double x = time_s[(newest - back) % RING] - t;
        const double y = position_m[(newest - back) % RING] - p;
        n += 1.0;
        st += x;
        sp += y;
        stt += x * x;
        stp += x * y;
        const double slope = (n * stp - st * sp) / (n * stt - st * st);
        const double offset = (sp - slope * st) / n;
        for (size_t k = 0; k <= back; k++) {
            const double line = offset + slope * (time_s[(newest - k) % RING] - t);
            if (fabs(line - (position_m[(newest - k) % RING] - p)) > d) {
                return velocity;
            }
        }
        velocity = slope;
    }
    return velocity;
}

void peer_foaw(int best, size_t window, double step_m, size_t count, const double *interval_s, const double *position,
               double *velocity) {
    double time_s[RING];
    double position_m[2][RING];
    double now_s = 0.0;
    for (size_t k = 0; k < count; k++) {
        now_s += interval_s[k];
        time_s[k % RING] = now_s;
        for (size_t a = 0; a < 2; a++) {
            position_m[a][k % RING] = position[2 * k + a];
            velocity[2 * k + a] = best ? foaw_best(time_s, position_m[a], k, window, step_m)
                                       : foaw_end(time_s, position_m[a], k, window, step_m);
        }
    }
}

static double clock_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec * 1e9 + (double)now.tv_nsec;
}

/* Each update of csrc/hd_velocity.c on its own, with the clock's two readings still in it. step_m < 0: only those. */
void peer_update_ns(double step_m, size_t count, const double *interval_s, const double *position, double *ns) {
    struct hd_velocity v;
    double velocity[2];
    hd_velocity_init(&v, fabs(step_m));
    for (size_t k = 0; k < count; k++) {
        const double start_ns = clock_ns();
        if (step_m >= 0.0) {
            hd_velocity_update(&v, interval_s[k], position + 2 * k, velocity);
        }
        ns[k] = clock_ns() - start_ns;
    }
}
