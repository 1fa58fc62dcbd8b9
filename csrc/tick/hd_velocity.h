/* The velocity estimator: how fast the probe moves, from time-stamped positions of finite resolution.
 *
 * Fixed size, embedded by value in the tick's state. One thread at a time. SI units.
 * docs/adr/0003-velocity-estimator.md says why it is what it is, and what it measured against others. */
#ifndef HD_VELOCITY_H
#define HD_VELOCITY_H

#include "api/hd_core.h"
#include "base/hd_rt.h"

#define HD_VELOCITY_SAMPLES 64 /* remembered; a power of two */

struct hd_velocity_point {
    double time_s;
    double position_m;
};

/* The fastest or the slowest line that passes through every sample's interval. It leans on an older sample, `pivot`,
 * and on a newer one; only the convex hull of the samples from the pivot on can become its next pivot. */
struct hd_velocity_edge {
    double slope_m_per_s;
    struct hd_velocity_point pivot; /* hull[head] */
    uint32_t next;                  /* the first sample that is not in the hull yet */
    int32_t head;
    int32_t end;
    struct hd_velocity_point hull[HD_VELOCITY_SAMPLES];
};

/* What the line said as of one sample. */
struct hd_velocity_record {
    float speed_m_per_s;
    float half_width_m_per_s;
    float span_s; /* 0: says nothing */
};

struct hd_velocity_axis {
    double line_m_per_s; /* middle and half width of the slopes of the lines that fit */
    double line_half_width_m_per_s;
    uint32_t start;                   /* number of the first sample of the window */
    uint32_t newest;                  /* of the last one; wraps */
    uint32_t bent;                    /* the line disagrees with the one before it */
    struct hd_velocity_record before; /* the line that ended where this window starts */
    struct hd_velocity_edge fastest;
    struct hd_velocity_edge slowest;
    struct hd_velocity_point sample[HD_VELOCITY_SAMPLES];
    struct hd_velocity_record past[HD_VELOCITY_SAMPLES];
};

struct hd_velocity {
    double step_m;              /* 0: positions are exact */
    double width_m;             /* of a sample's interval */
    double span_s;              /* longest window */
    double elapsed_s;           /* since the newest sample, from calls that brought none */
    double now_s;               /* of the newest sample, on the estimator's own clock */
    uint32_t started;           /* there is a first sample */
    double last_m[2];           /* the newest sample */
    double velocity_m_per_s[2]; /* the estimate */
    double half_width_m_per_s[2];
    struct hd_velocity_axis axis[2];
};

static_assert(sizeof(struct hd_velocity) <= 8192, "the estimator is part of every state");

/* `step_m` is the encoder's resolution: a position p says that the truth lies within p +- step_m/2. */
void hd_velocity_init(struct hd_velocity *v, double step_m);

/* Forgets the past: the next sample is the first, and has velocity 0. */
HD_RT void hd_velocity_reset(struct hd_velocity *v);

/* `interval_s` since the sample before, 0 where there is no new sample: the estimate stays. */
HD_RT void hd_velocity_update(struct hd_velocity *v, double interval_s, const double position_m[2],
                              double velocity_m_per_s[2]);

/* Half the width of the set of speeds that the samples of the window allow; 0 where positions are exact, infinite
 * before there are two samples. */
HD_RT double hd_velocity_half_width(const struct hd_velocity *v, int axis);

#endif
