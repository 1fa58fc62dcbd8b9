/* The velocity estimator: velocity of the probe from time-stamped positions of finite resolution.
 *
 * Fixed size, embedded by value in the tick's state. One thread at a time. SI units.
 * docs/adr/0003-velocity-estimator.md compares it with other estimators and gives the reasons for the choice. */
#ifndef HD_VELOCITY_H
#define HD_VELOCITY_H

#include "api/hd_core.h"
#include "base/hd_rt.h"

#define HD_VELOCITY_SAMPLES 64 /* samples that are stored; a power of two */

struct hd_velocity_point {
    double time_s;
    double position_m;
};

/* The fastest or the slowest line that passes through every sample's interval. It touches the intervals of an older
 * sample, `pivot`, and of a newer one. Its next pivot is a point of the convex hull of the samples from the pivot on.
 */
struct hd_velocity_edge {
    double slope_m_per_s;
    struct hd_velocity_point pivot; /* hull[head] */
    uint32_t next;                  /* the first sample that is not in the hull yet */
    int32_t head;
    int32_t end;
    struct hd_velocity_point hull[HD_VELOCITY_SAMPLES];
};

/* The line of the window at one earlier sample. */
struct hd_velocity_record {
    float speed_m_per_s;
    float half_width_m_per_s;
    float span_s; /* length of the window; 0: no line is known */
};

struct hd_velocity_axis {
    double line_m_per_s;              /* middle of the range of slopes of the lines that fit */
    double line_half_width_m_per_s;   /* half the width of that range */
    uint32_t start;                   /* number of the first sample of the window */
    uint32_t newest;                  /* number of the last sample; wraps */
    uint32_t bent;                    /* the slope differs significantly from that of the previous line */
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
    double elapsed_s;           /* time since the newest sample that calls without a sample added up */
    double now_s;               /* time of the newest sample on the estimator's clock */
    uint32_t started;           /* there is a first sample */
    double last_m[2];           /* the newest sample */
    double velocity_m_per_s[2]; /* the estimate */
    double half_width_m_per_s[2];
    struct hd_velocity_axis axis[2];
};

static_assert(sizeof(struct hd_velocity) <= 8192, "the estimator is part of every state");

/* Initialises the estimator. `step_m`: resolution of the encoder; at a position p the true position lies within p +-
 * step_m/2. */
void hd_velocity_init(struct hd_velocity *v, double step_m);

/* Discards all samples: the next sample is the first, with velocity 0. */
HD_RT void hd_velocity_reset(struct hd_velocity *v);

/* Adds a sample and writes the estimate to `velocity_m_per_s`. `interval_s`: time since the previous sample; 0 without
 * a new sample: the estimate stays. */
HD_RT void hd_velocity_update(struct hd_velocity *v, double interval_s, const double position_m[2],
                              double velocity_m_per_s[2]);

/* Returns half the width of the range of velocities that the samples of the window allow; 0 for exact positions,
 * infinite before there are two samples. */
HD_RT double hd_velocity_half_width(const struct hd_velocity *v, int axis);

#endif
