/* Velocity estimators to compare with csrc/tick/hd_velocity.c; for bench/velocity.py. Each takes time-stamped positions
 * of both axes, in order.
 *
 * FOAW: first-order adaptive windowing (Janabi-Sharifi, Hayward, Chen, "Discrete-time adaptive windowing for velocity
 * estimation", IEEE Trans. Control Systems Technology 8(6), 2000): the longest window, up to a limit, whose line stays
 * within d of every sample in it. end: the line through the newest and the oldest sample; best: the least-squares line.
 * d is one encoder step, for both: half a step is too strict for a line through two quantised samples, and is worse.
 * The end fit keeps the cone of admissible slopes, so that it looks at every sample once.
 *
 * Kalman: position, velocity and acceleration, driven by white jerk; a sample's noise is that of rounding, step^2/12,
 * as if it were white (Belanger, "Estimation of angular velocity and acceleration from shaft encoder measurements",
 * ICRA 1992). */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "peers.h"
#include "tick/hd_velocity.h"

#define RING 128u
#define PI 3.14159265358979323846

/* One axis' last samples, and what a filter remembers. */
struct axis {
    double position_m[RING];
    double velocity;
    double state[3];
    double cover[3][3];
};

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

/* The slope of the least-squares line through the newest samples. */
static double least_squares(const double *time_s, const double *position_m, size_t newest, size_t window) {
    const double t = time_s[newest % RING];
    const double p = position_m[newest % RING];
    const size_t count = newest + 1 < window ? newest + 1 : window;
    const double n = (double)count;
    double st = 0.0, sp = 0.0, stt = 0.0, stp = 0.0;
    for (size_t back = 1; back < count; back++) {
        const double x = time_s[(newest - back) % RING] - t;
        const double y = position_m[(newest - back) % RING] - p;
        st += x;
        sp += y;
        stt += x * x;
        stp += x * y;
    }
    return count < 2 ? 0.0 : (n * stp - st * sp) / (n * stt - st * st);
}

static void kalman_begin(struct axis *axis, double position_m, double noise) {
    axis->state[0] = position_m;
    axis->state[1] = 0.0;
    axis->state[2] = 0.0;
    memset(axis->cover, 0, sizeof axis->cover);
    axis->cover[0][0] = noise;
    axis->cover[1][1] = 1.0;
    axis->cover[2][2] = 100.0;
}

static double kalman(struct axis *axis, double h, double position_m, double noise, double jerk) {
    double *const x = axis->state;
    double (*const p)[3] = axis->cover;
    const double q = jerk * jerk;
    /* F = [1 h h^2/2; 0 1 h; 0 0 1]: first F P, then (F P) F'. */
    x[0] += h * (x[1] + 0.5 * h * x[2]);
    x[1] += h * x[2];
    for (int j = 0; j < 3; j++) {
        p[0][j] += h * (p[1][j] + 0.5 * h * p[2][j]);
        p[1][j] += h * p[2][j];
    }
    for (int i = 0; i < 3; i++) {
        p[i][0] += h * (p[i][1] + 0.5 * h * p[i][2]);
        p[i][1] += h * p[i][2];
    }
    const double h2 = h * h;
    p[0][0] += q * h2 * h2 * h / 20.0;
    p[0][1] += q * h2 * h2 / 8.0;
    p[0][2] += q * h2 * h / 6.0;
    p[1][1] += q * h2 * h / 3.0;
    p[1][2] += q * h2 / 2.0;
    p[2][2] += q * h;
    const double total = p[0][0] + noise;
    const double gain[3] = {p[0][0] / total, p[0][1] / total, p[0][2] / total};
    const double off = position_m - x[0];
    const double row[3] = {p[0][0], p[0][1], p[0][2]};
    for (int i = 0; i < 3; i++) {
        x[i] += gain[i] * off;
        for (int j = i; j < 3; j++) {
            p[i][j] -= gain[i] * row[j];
        }
    }
    p[1][0] = p[0][1];
    p[2][0] = p[0][2];
    p[2][1] = p[1][2];
    return x[1];
}

static void ours(double step_m, size_t count, const double *interval_s, const double *position, double *velocity) {
    struct hd_velocity v;
    hd_velocity_init(&v, step_m);
    for (size_t k = 0; k < count; k++) {
        hd_velocity_update(&v, interval_s[k], position + 2 * k, velocity + 2 * k);
    }
}

static void peer(int kind, double parameter, double step_m, size_t count, const double *interval_s,
                 const double *position, double *velocity) {
    static struct axis axes[2];
    double time_s[RING];
    double now_s = 0.0;
    const size_t window = (size_t)parameter;
    const double noise = step_m * step_m / 12.0;
    for (size_t k = 0; k < count; k++) {
        const double h = interval_s[k];
        now_s += h;
        time_s[k % RING] = now_s;
        for (size_t a = 0; a < 2; a++) {
            struct axis *axis = &axes[a];
            const double p = position[2 * k + a];
            double *const out = &velocity[2 * k + a];
            axis->position_m[k % RING] = p;
            if (k == 0) {
                kalman_begin(axis, p, noise);
                axis->velocity = 0.0;
                *out = 0.0;
                continue;
            }
            const double difference = (p - axis->position_m[(k - 1) % RING]) / h;
            switch (kind) {
            case PEER_VELOCITY_LOW_PASS: {
                const double x = 2.0 * PI * parameter * h;
                axis->velocity += x / (1.0 + x) * (difference - axis->velocity);
                *out = axis->velocity;
                break;
            }
            case PEER_VELOCITY_LEAST_SQUARES:
                *out = least_squares(time_s, axis->position_m, k, window);
                break;
            case PEER_VELOCITY_FOAW_END:
                *out = foaw_end(time_s, axis->position_m, k, window, step_m);
                break;
            case PEER_VELOCITY_FOAW_BEST:
                *out = foaw_best(time_s, axis->position_m, k, window, step_m);
                break;
            case PEER_VELOCITY_KALMAN:
                *out = kalman(axis, h, p, noise, parameter);
                break;
            default:
                *out = difference;
            }
        }
    }
}

double peer_velocity(int kind, double parameter, double step_m, size_t count, const double *interval_s,
                     const double *position, double *velocity) {
    const double start_ns = peer_clock_ns();
    if (kind == PEER_VELOCITY_OURS) {
        ours(step_m, count, interval_s, position, velocity);
    } else {
        peer(kind, parameter, step_m, count, interval_s, position, velocity);
    }
    return peer_clock_ns() - start_ns;
}

void peer_velocity_each_ns(double step_m, size_t count, const double *interval_s, const double *position, double *ns) {
    struct hd_velocity v;
    double velocity[2];
    hd_velocity_init(&v, fabs(step_m));
    for (size_t k = 0; k < count; k++) {
        const double start_ns = peer_clock_ns();
        if (step_m >= 0.0) {
            hd_velocity_update(&v, interval_s[k], position + 2 * k, velocity);
        }
        ns[k] = peer_clock_ns() - start_ns;
    }
}
