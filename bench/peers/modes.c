/* Ways to make a ringing mode A exp(-B t) sin(w t), each in two directions, with strikes that add. What bench/modes.py
 * compares; csrc/tick/hd_mode.c is called as the tick calls it.
 *
 * Every way counts down the ticks that a mode still sounds, as the core must. Where a mode is not a linear recursion
 * (libm, tables), a strike turns what rings into one new coefficient and starts its time anew, so that a tick costs the
 * same however often it was struck; that turn is made with libm. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "peers.h"
#include "tick/hd_mode.h"

#define PI 3.14159265358979323846
#define TURN 18446744073709551616.0 /* 2^64: a phase is a whole number of this part of a turn, so it never drifts */

struct two {
    double x;
    double y;
};

/* One mode of every way; each uses its own part. */
struct mode {
    uint32_t left;
    uint32_t ticks; /* since its time began */
    uint64_t phase;
    uint64_t phase_step;
    double decay;
    double omega;
    double shrink; /* exp(-B T) */
    double envelope;
    double rotor[2];
    double one; /* of the recurrence: 2 exp(-B T) cos(w T) */
    double two; /* exp(-2 B T) */
    double re[2];
    double im[2];
    float rotor_single[2];
    float re_single[2];
    float im_single[2];
};

struct peer_modes {
    int kind;
    size_t count;
    double period_s;
    size_t size;
    unsigned shift;
    double *table; /* sines of one turn, and one more */
    struct mode *mode;
    struct hd_state *state;
    struct hd_mode *played;
};

void peer_modes_free(struct peer_modes *modes) {
    if (modes == NULL) {
        return;
    }
    if (modes->state != NULL) {
        free(modes->state->active_modes);
        free(modes->state->mode_ends);
    }
    free(modes->state);
    free(modes->played);
    free(modes->table);
    free(modes->mode);
    free(modes);
}

struct peer_modes *peer_modes_new(int kind, size_t count, double period_s, const double *decay_per_s,
                                  const double *omega_rad_per_s, size_t size) {
    struct peer_modes *modes = calloc(1, sizeof *modes);
    if (modes == NULL) {
        return NULL;
    }
    modes->kind = kind;
    modes->count = count;
    modes->period_s = period_s;
    modes->size = size;
    modes->mode = calloc(count, sizeof *modes->mode);
    modes->played = calloc(count, sizeof *modes->played);
    modes->table = calloc(size + 1, sizeof *modes->table);
    modes->state = calloc(1, sizeof *modes->state);
    if (modes->mode == NULL || modes->played == NULL || modes->table == NULL || modes->state == NULL) {
        peer_modes_free(modes);
        return NULL;
    }
    modes->state->active_modes = aligned_alloc(64, HD_ACTIVE_MODE_CAPACITY * sizeof(struct hd_active_mode));
    modes->state->mode_ends = calloc(HD_ACTIVE_MODE_CAPACITY, sizeof(struct hd_mode_end));
    if (modes->state->active_modes == NULL || modes->state->mode_ends == NULL) {
        peer_modes_free(modes);
        return NULL;
    }
    for (modes->shift = 64; (1u << (64 - modes->shift)) < size; modes->shift--) {
    }
    for (size_t i = 0; i <= size; i++) {
        modes->table[i] = sin(2.0 * PI * (double)i / (double)size);
    }
    for (size_t i = 0; i < count; i++) {
        const double decay = decay_per_s[i];
        const double omega = omega_rad_per_s[i];
        struct mode *mode = &modes->mode[i];
        mode->decay = decay;
        mode->omega = omega;
        mode->phase_step = (uint64_t)(omega * period_s / (2.0 * PI) * TURN);
        mode->shrink = exp(-decay * period_s);
        mode->rotor[0] = mode->shrink * cos(omega * period_s);
        mode->rotor[1] = mode->shrink * sin(omega * period_s);
        mode->rotor_single[0] = (float)mode->rotor[0];
        mode->rotor_single[1] = (float)mode->rotor[1];
        mode->one = 2.0 * mode->rotor[0];
        mode->two = exp(-2.0 * decay * period_s);
        modes->played[i] = (struct hd_mode){
            .rotor_re = mode->rotor[0],
            .rotor_im = mode->rotor[1],
            .decay_rate_per_s = decay,
            .angular_frequency_rad_per_s = omega,
            .end_s = 5.0 / decay,
            .gain_re = 1.0,
        };
    }
    return modes;
}

/* What a mode of a way that keeps a coefficient and a time has become. */
static void gather(const struct peer_modes *modes, struct mode *mode) {
    double magnitude = mode->envelope;
    double angle = 2.0 * PI * ((double)mode->phase / TURN);
    if (modes->kind == PEER_MODE_LIBM) {
        const double since_s = (double)mode->ticks * modes->period_s;
        magnitude = exp(-mode->decay * since_s);
        angle = mode->omega * since_s;
    }
    const double c = magnitude * cos(angle);
    const double s = magnitude * sin(angle);
    for (int axis = 0; axis < 2; axis++) {
        const double re = mode->re[axis];
        mode->re[axis] = re * c - mode->im[axis] * s;
        mode->im[axis] = re * s + mode->im[axis] * c;
    }
    mode->ticks = 0;
    mode->phase = 0;
    mode->envelope = 1.0;
}

void peer_modes_strike(struct peer_modes *modes, size_t index, const double *force, double before_s) {
    struct mode *mode = &modes->mode[index];
    if (modes->kind == PEER_MODE_ROTOR) {
        const struct hd_strike strike = {.mode = &modes->played[index], .slot = HD_PLAY_SLOT, .before_s = before_s};
        hd_modes_strike(modes->state, &strike, force, modes->period_s);
        return;
    }
    const double re = exp(-mode->decay * before_s) * cos(mode->omega * before_s);
    const double im = exp(-mode->decay * before_s) * sin(mode->omega * before_s);
    /* One tick earlier, as the recurrence wants it. */
    const double early_s = before_s - modes->period_s;
    const double early = exp(-mode->decay * early_s) * sin(mode->omega * early_s);
    const int recurrence = modes->kind == PEER_MODE_RECURRENCE || modes->kind == PEER_MODE_RECURRENCE_SINGLE;
    if (!recurrence && modes->kind != PEER_MODE_ROTOR_SINGLE) {
        if (mode->left == 0) {
            memset(mode->re, 0, sizeof mode->re);
            memset(mode->im, 0, sizeof mode->im);
        }
        gather(modes, mode);
    }
    for (int axis = 0; axis < 2; axis++) {
        /* re is the sample before where there is a recurrence. */
        mode->re[axis] += force[axis] * (recurrence ? early : re);
        mode->im[axis] += force[axis] * im;
        mode->re_single[axis] += (float)(force[axis] * (recurrence ? early : re));
        mode->im_single[axis] += (float)(force[axis] * im);
    }
    mode->left = (uint32_t)((5.0 / mode->decay - before_s) / modes->period_s);
}

static struct two tick_floor(struct peer_modes *modes) {
    struct two sum = {0.0, 0.0};
    for (size_t i = 0; i < modes->count; i++) {
        sum.x += modes->mode[i].im[0];
        sum.y += modes->mode[i].im[1];
    }
    return sum;
}

static struct two tick_rotor(struct peer_modes *modes) {
    hd_modes_advance(modes->state, 1);
    return (struct two){modes->state->ringing_n[0], modes->state->ringing_n[1]};
}

static struct two tick_rotor_single(struct peer_modes *modes) {
    float x = 0.0f;
    float y = 0.0f;
    for (size_t i = 0; i < modes->count; i++) {
        struct mode *mode = &modes->mode[i];
        if (mode->left == 0) {
            memset(mode->re_single, 0, sizeof mode->re_single);
            memset(mode->im_single, 0, sizeof mode->im_single);
            continue;
        }
        mode->left--;
        const float c = mode->rotor_single[0];
        const float s = mode->rotor_single[1];
        const float re[2] = {mode->re_single[0], mode->re_single[1]};
        const float im[2] = {mode->im_single[0], mode->im_single[1]};
        mode->re_single[0] = re[0] * c - im[0] * s;
        mode->re_single[1] = re[1] * c - im[1] * s;
        mode->im_single[0] = re[0] * s + im[0] * c;
        mode->im_single[1] = re[1] * s + im[1] * c;
        x += mode->im_single[0];
        y += mode->im_single[1];
    }
    return (struct two){(double)x, (double)y};
}

static struct two tick_libm(struct peer_modes *modes) {
    struct two sum = {0.0, 0.0};
    for (size_t i = 0; i < modes->count; i++) {
        struct mode *mode = &modes->mode[i];
        if (mode->left == 0) {
            continue;
        }
        mode->left--;
        const double since_s = (double)++mode->ticks * modes->period_s;
        const double magnitude = exp(-mode->decay * since_s);
        const double c = magnitude * cos(mode->omega * since_s);
        const double s = magnitude * sin(mode->omega * since_s);
        sum.x += mode->re[0] * s + mode->im[0] * c;
        sum.y += mode->re[1] * s + mode->im[1] * c;
    }
    return sum;
}

static struct two tick_recurrence(struct peer_modes *modes) {
    struct two sum = {0.0, 0.0};
    for (size_t i = 0; i < modes->count; i++) {
        struct mode *mode = &modes->mode[i];
        if (mode->left == 0) {
            memset(mode->re, 0, sizeof mode->re);
            memset(mode->im, 0, sizeof mode->im);
            continue;
        }
        mode->left--;
        const double x = mode->one * mode->im[0] - mode->two * mode->re[0];
        const double y = mode->one * mode->im[1] - mode->two * mode->re[1];
        mode->re[0] = mode->im[0];
        mode->re[1] = mode->im[1];
        mode->im[0] = x;
        mode->im[1] = y;
        sum.x += x;
        sum.y += y;
    }
    return sum;
}

static struct two tick_recurrence_single(struct peer_modes *modes) {
    float sum[2] = {0.0f, 0.0f};
    for (size_t i = 0; i < modes->count; i++) {
        struct mode *mode = &modes->mode[i];
        if (mode->left == 0) {
            memset(mode->re_single, 0, sizeof mode->re_single);
            memset(mode->im_single, 0, sizeof mode->im_single);
            continue;
        }
        mode->left--;
        const float one = (float)mode->one;
        const float two = (float)mode->two;
        const float x = one * mode->im_single[0] - two * mode->re_single[0];
        const float y = one * mode->im_single[1] - two * mode->re_single[1];
        mode->re_single[0] = mode->im_single[0];
        mode->re_single[1] = mode->im_single[1];
        mode->im_single[0] = x;
        mode->im_single[1] = y;
        sum[0] += x;
        sum[1] += y;
    }
    return (struct two){(double)sum[0], (double)sum[1]};
}

static inline double nearest(const struct peer_modes *modes, uint64_t phase) {
    return modes->table[(phase + (UINT64_C(1) << (modes->shift - 1))) >> modes->shift];
}

static inline double interpolated(const struct peer_modes *modes, uint64_t phase) {
    const size_t index = phase >> modes->shift;
    const double part =
        (double)(int64_t)(phase & ((UINT64_C(1) << modes->shift) - 1)) / (double)(int64_t)(UINT64_C(1) << modes->shift);
    return modes->table[index] + part * (modes->table[index + 1] - modes->table[index]);
}

static inline struct two tick_table(struct peer_modes *modes, double (*look)(const struct peer_modes *, uint64_t)) {
    struct two sum = {0.0, 0.0};
    for (size_t i = 0; i < modes->count; i++) {
        struct mode *mode = &modes->mode[i];
        if (mode->left == 0) {
            continue;
        }
        mode->left--;
        mode->phase += mode->phase_step;
        mode->envelope *= mode->shrink;
        const double s = mode->envelope * look(modes, mode->phase);
        const double c = mode->envelope * look(modes, mode->phase + (UINT64_C(1) << 62));
        sum.x += mode->re[0] * s + mode->im[0] * c;
        sum.y += mode->re[1] * s + mode->im[1] * c;
    }
    return sum;
}

static inline struct two tick(struct peer_modes *modes, int kind) {
    switch (kind) {
    case PEER_MODE_ROTOR:
        return tick_rotor(modes);
    case PEER_MODE_ROTOR_SINGLE:
        return tick_rotor_single(modes);
    case PEER_MODE_LIBM:
        return tick_libm(modes);
    case PEER_MODE_RECURRENCE:
        return tick_recurrence(modes);
    case PEER_MODE_RECURRENCE_SINGLE:
        return tick_recurrence_single(modes);
    case PEER_MODE_TABLE:
        return tick_table(modes, nearest);
    case PEER_MODE_TABLE_LINEAR:
        return tick_table(modes, interpolated);
    default:
        return tick_floor(modes);
    }
}

double peer_modes_run(struct peer_modes *modes, size_t ticks, double *out) {
    const double start_ns = peer_clock_ns();
    for (size_t k = 0; k < ticks; k++) {
        const struct two sum = tick(modes, modes->kind);
        out[2 * k] = sum.x;
        out[2 * k + 1] = sum.y;
    }
    return peer_clock_ns() - start_ns;
}

void peer_modes_play(struct peer_modes *modes, size_t ticks, size_t strikes, const uint64_t *at, const double *before_s,
                     const double *force, size_t kept, double *out) {
    size_t next = 0;
    for (size_t k = 0; k < ticks; k++) {
        struct two sum = tick(modes, modes->kind);
        for (; next < strikes && at[next] == k; next++) {
            const double omega = modes->mode[0].omega;
            const double heard = exp(-modes->mode[0].decay * before_s[next]) * sin(omega * before_s[next]);
            peer_modes_strike(modes, 0, force + 2 * next, before_s[next]);
            sum.x += force[2 * next] * heard;
            sum.y += force[2 * next + 1] * heard;
        }
        if (k + kept >= ticks) {
            out[2 * (k + kept - ticks)] = sum.x;
            out[2 * (k + kept - ticks) + 1] = sum.y;
        }
    }
}
