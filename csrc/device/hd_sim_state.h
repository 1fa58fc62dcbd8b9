/* The state of the simulated joystick, shared by its files:
 *
 *   hd_sim_time.c    time: which events fall into a period; force, reference and encoder samples
 *   hd_sim_solver.c  the exact motion of handle and hand in one step, and the events within it
 *   hd_sim_setup.c   control: makes a simulation from a configuration, places the handle, frees
 *
 * Times are counted in servo periods; those of encoder samples and frames of the link in 2^-24 of a period, so that no
 * rounding errors accumulate. SI units. Control makes and frees a simulation; one thread at a time runs it. */
#ifndef HD_SIM_STATE_H
#define HD_SIM_STATE_H

#include <stdbool.h>

#include "base/hd_holders.h"
#include "device/hd_actuator.h"
#include "device/hd_operator.h"
#include "device/hd_sim.h"

/* The longest step h, as max(B/M, sqrt(k/M)) h, and the number of terms of the series for an error of 1e-17 at it. */
#define HD_STEP_MAX 0.5
#define HD_SERIES_TERMS 14
/* Times that differ by less than this fraction of a period are equal. */
#define HD_SAME_TIME 1e-9
/* Largest number of encoder samples under way, a power of two. */
#define HD_SAMPLES 2048u
/* Times in 2^-24 of a period: the shift, and the unit in periods. */
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

/* The error e of a lagging actuator's force and its derivative, see hd_actuator.h. */
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
    uint64_t at; /* time at which it takes effect, in 2^-24 of a period since origin_tick */
};

/* The members that a period of free motion uses come first, so that they share cache lines. */
struct hd_sim {
    /* The device and the hand: constant. */
    double period_s;
    double mass_kg;
    double damping; /* b, of the handle */
    double hand_damping;
    double stiffness; /* k */
    double coulomb_n;
    double workspace_m;
    double encoder_step_m;
    double encoder_per_m;
    double force_step_n;
    double force_per_n;
    double force_top;             /* largest force, in N, or in steps if the force has a resolution */
    uint64_t force_whole_periods; /* complete periods from a put to the expiry of the force */
    uint64_t force_interval;      /* frame interval of the link; 0: no link */
    struct hd_kernel period;      /* of one period, or of the equal parts of a period */

    /* The motion. */
    struct hd_axis axes[2];
    struct hd_off off[2];
    double force_n[2];
    uint64_t tick;     /* periods since the start */
    uint64_t put_tick; /* the present force took effect at put_late_s after this tick */
    double put_late_s;

    /* The reference. */
    uint64_t path_tick;
    uint64_t calm_tick; /* periods that begin before this tick are inside of the segment and need a single step */
    struct hd_segment segment;
    bool path_announced; /* true: the end of the path needs no event any more */

    /* Encoder samples, which the servo reads as reports; times in 2^-24 of a period since origin_tick. */
    bool read_before;
    double sample_interval_s;
    uint64_t sample_interval;
    uint64_t sample_delay;
    uint64_t origin_tick;
    uint64_t sample_count; /* number of samples taken, and index of the next */
    uint64_t sample_at;    /* time of the next sample */
    uint64_t sample_mask;  /* index mask of the used part of samples[], which holds all samples under way; its size is a
                              power of two */
    uint64_t read_number;  /* newest sample that could be read */
    uint64_t read_next_at; /* time at which the sample after it can be read */
    uint64_t arrive_at;    /* time at which the next force takes effect; UINT64_MAX: no force is under way */

    /* The members that are used only by a period with events. */
    const struct hd_operator *path; /* NULL: the hand rests, or moves to target_m */
    double target_m[2];
    size_t path_index;
    double path_end_s;      /* time of the last waypoint */
    double segment_limit_s; /* longest step in this segment: limit_s, or less if the reference is curved */
    double limit_s;         /* the longest step of this device */
    double lag_limit_s;     /* longest step while the actuator lags; 0: it has no lag */
    double force_timeout_s;
    uint32_t stretch_periods; /* largest number of periods in one step */
    struct hd_kernel stretch;
    struct hd_kernel lagging;          /* of the equal parts of a period while the actuator lags */
    double series[2][HD_SERIES_TERMS]; /* power series of J_4 and J_5 */
    struct hd_actuator actuator;

    /* The link that forces pass; times as of encoder samples. */
    uint64_t force_intervals;
    uint32_t sent_first;
    uint32_t sent_count;
    struct hd_sent sent[HD_SIM_FORCES]; /* ring, in order of time */

    struct hd_encoder_sample samples[HD_SAMPLES];

    struct hd_holders holders; /* used by control */
};

/* ---- hd_sim_solver.c --------------------------------------------------------------------------------------------- */

/* Computes the coefficients of the solution after `span_s`. */
HD_RT void hd_sim_kernel_at(const struct hd_sim *sim, double span_s, struct hd_kernel *kernel);
/* Advances both axes by one step, including the events within it. The step begins `local_s` after the segment's
 * start. */
HD_RT void hd_sim_solve(struct hd_sim *sim, double local_s, const struct hd_kernel *kernel);
/* Sets the force that the actuator is commanded; if it lags, its actual force stays continuous. */
HD_RT void hd_sim_set_force(struct hd_sim *sim, double x_n, double y_n);

HD_RT static inline bool hd_sim_is_under_way(const struct hd_off *off) {
    return off->off_n != 0.0 || off->off_n_per_s != 0.0;
}

HD_RT static inline bool hd_sim_lags(const struct hd_sim *sim) {
    return sim->actuator.order > 0 && (hd_sim_is_under_way(&sim->off[0]) || hd_sim_is_under_way(&sim->off[1]));
}

/* ---- hd_sim_time.c ---------------------------------------------------------------------------------------------- */

HD_RT double hd_sim_path_time_s(const struct hd_sim *sim);
/* Computes the present reference of the hand. */
HD_RT void hd_sim_reference(struct hd_sim *sim, double reference_m[2]);
/* Takes an encoder sample. */
HD_RT void hd_sim_sample(struct hd_sim *sim);

#endif
