/* The simulated joystick, from the inside: what its files share.
 *
 *   hd_sim_time.c    time: which events fall into a period; force, reference and encoder samples
 *   hd_sim_solver.c  the motion of handle and hand in one step, exact, and what can happen within it
 *   hd_sim_setup.c   control: made from a configuration, placed, freed
 *
 * Times are counted in servo periods, and for encoder samples and frames of the link in 2^-24 of a period, so nothing
 * accumulates. SI units. Control makes and frees a simulation; one thread at a time runs it. */
#ifndef HD_SIM_STATE_H
#define HD_SIM_STATE_H

#include <stdbool.h>

#include "base/hd_holders.h"
#include "device/hd_actuator.h"
#include "device/hd_operator.h"
#include "device/hd_sim.h"

/* The longest step, as max(B/M, sqrt(k/M)) h, and the terms of the series that give 1e-17 there. */
#define HD_STEP_MAX 0.5
#define HD_SERIES_TERMS 14
/* Times closer than this part of a period are the same. */
#define HD_SAME_TIME 1e-9
/* Encoder samples under way at most, a power of two. */
#define HD_SAMPLES 2048u
#define HD_FRACTION_SHIFT 24
#define HD_FRACTION_UNIT (1.0 / 16777216.0)

struct hd_kernel {
    double span_s;
    double j[7]; /* J_-1 to J_5 */
    struct hd_actuator_step lag;
};

struct hd_axis {
    double x;
    double v;
};

/* What a lagging actuator exerts more than it was told, and its derivative: see hd_actuator.h. */
struct hd_off {
    double off_n;
    double off_n_per_s;
};

struct hd_encoder_sample {
    double position_m[2];
    double velocity_m_per_s[2];
};

/* A force on its way to the actuator. */
struct hd_sent {
    double force_n[2];
    uint64_t at; /* when it acts, in 2^-24 of a period since origin_tick */
};

/* What a period of free motion touches comes first and stands together. */
struct hd_sim {
    /* The device and the hand: constant. */
    double period_s;
    double mass_kg;
    double damping; /* of the handle, b */
    double hand_damping;
    double stiffness; /* k */
    double coulomb_n;
    double workspace_m;
    double encoder_step_m;
    double encoder_per_m;
    double force_step_n;
    double force_per_n;
    double force_top;             /* in N, or in steps where the force has a resolution */
    uint64_t force_whole_periods; /* after a put, before it expires */
    uint64_t force_interval;      /* of the link; 0: there is none */
    struct hd_kernel period;      /* one period, or its equal parts */

    /* The motion. */
    struct hd_axis axes[2];
    struct hd_off off[2];
    double force_n[2];
    uint64_t tick;     /* periods since the start */
    uint64_t put_tick; /* the force has acted since then, and as much later in that period: */
    double put_late_s;

    /* The reference. */
    uint64_t path_tick;
    uint64_t calm_tick; /* periods that begin before it lie in this segment and need one step */
    struct hd_segment segment;
    bool path_announced; /* nobody waits to be told of the path's end */

    /* Encoder samples, which the servo reads as reports; times in 2^-24 of a period since origin_tick. */
    bool read_before;
    double sample_interval_s;
    uint64_t sample_interval;
    uint64_t sample_delay;
    uint64_t origin_tick;
    uint64_t sample_count; /* samples taken: the number of the next */
    uint64_t sample_at;    /* when the next is made */
    uint64_t sample_mask;  /* of the places in samples[] that are used: as many as can be under way, a power of two */
    uint64_t read_number;  /* the newest that could be read */
    uint64_t read_next_at; /* when the one after it can be read */
    uint64_t arrive_at;    /* when the next force of the link arrives; UINT64_MAX: none is under way */

    /* What a period with events touches, too. */
    const struct hd_operator *path; /* NULL: it rests, or is on its way to target_m */
    double target_m[2];
    size_t path_index;
    double path_end_s;      /* of the last waypoint */
    double segment_limit_s; /* limit_s, or less where the reference is curved */
    double limit_s;         /* the longest step of this device */
    double lag_limit_s;     /* the same while the actuator is under way; 0: it never is */
    double force_timeout_s;
    uint32_t stretch_periods; /* several periods in one step */
    struct hd_kernel stretch;
    struct hd_kernel lagging;          /* of a period while the actuator is under way */
    double series[2][HD_SERIES_TERMS]; /* of J_4 and J_5 */
    struct hd_actuator actuator;

    /* The link of forces; times as those of encoder samples. */
    uint64_t force_intervals;
    uint32_t sent_first;
    uint32_t sent_count;
    struct hd_sent sent[HD_SIM_FORCES]; /* a ring, in order of time */

    struct hd_encoder_sample samples[HD_SAMPLES];

    struct hd_holders holders; /* control's */
};

/* ---- hd_sim_solver.c --------------------------------------------------------------------------------------------- */

/* What makes the solution after `span_s`. */
HD_RT void hd_sim_kernel_at(const struct hd_sim *sim, double span_s, struct hd_kernel *kernel);
/* Both axes go on by one step, with whatever happens within it. It begins `local_s` after the segment's start. */
HD_RT void hd_sim_solve(struct hd_sim *sim, double local_s, const struct hd_kernel *kernel);
/* The actuator is told another force: its own goes on without a step, where it lags. */
HD_RT void hd_sim_set_force(struct hd_sim *sim, double x_n, double y_n);

HD_RT static inline bool hd_sim_is_under_way(const struct hd_off *off) {
    return off->off_n != 0.0 || off->off_n_per_s != 0.0;
}

HD_RT static inline bool hd_sim_lags(const struct hd_sim *sim) {
    return sim->actuator.order > 0 && (hd_sim_is_under_way(&sim->off[0]) || hd_sim_is_under_way(&sim->off[1]));
}

/* ---- hd_sim_time.c ---------------------------------------------------------------------------------------------- */

HD_RT double hd_sim_path_time_s(const struct hd_sim *sim);
/* Where the hand wants to be now. */
HD_RT void hd_sim_reference(struct hd_sim *sim, double reference_m[2]);
/* The encoder takes a sample. */
HD_RT void hd_sim_sample(struct hd_sim *sim);

#endif
