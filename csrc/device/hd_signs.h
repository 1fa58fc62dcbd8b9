/* The check of a device's signs: whether a force to the right moves the handle to the right.
 *
 * A device that was never calibrated may push in the opposite direction, so that a wall pulls the hand in. Before the
 * first force of the scene, each axis is pushed four times, in the directions + - - +, by a short, small pulse; each
 * pulse is followed by its opposite, which brings the handle to rest again. The displacement of a pulse is the mean
 * distance of the handle from its earlier line of motion, from the start of the pulse to shortly after it. The signs
 * are right if the displacements of the two directions differ clearly, along the pushed axis and in the pushed
 * direction; the hand's own motion cancels as far as it is steady. No pulse begins while an object is touched or the
 * handle moves.
 *
 * While the device reports that it exerts no force (PID State: safety switch open, no power, ...), the check waits: a
 * round of pulses that move nothing does not count, and a change of the report restarts the axis. If two successive
 * rounds move the handle nevertheless, with the same result, the report is wrong; it is ignored until a check ends
 * without a result, because some firmware never sets these bits. After the check, the scene is held back while the
 * device reports that it exerts no force, and fades in again.
 *
 * The check is part of the servo, before the tick: its output in struct hd_input holds the scene back and sets the
 * force instead. Servo thread. SI units. */
#ifndef HD_SIGNS_H
#define HD_SIGNS_H

#include "device/hd_hid.h"
#include "tick/hd_tick.h"

enum hd_signs_phase { HD_SIGNS_REST = 0, HD_SIGNS_PULSE = 1, HD_SIGNS_BRAKE = 2 };

/* Sums for the regression line of positions over time. */
struct hd_signs_line {
    double count;
    double time;
    double square;
    double position[2];
    double product[2];
    double power[2]; /* sum of squared positions */
};

struct hd_signs {
    struct hd_hid_signs of; /* parameters of the current or last check; number 0: no check */
    uint32_t state;         /* enum hd_signs_state */
    uint32_t problem;       /* enum hd_signs_problem */
    uint32_t axis;          /* axis that is pushed, 0 or 1 */
    uint32_t phase;         /* enum hd_signs_phase */
    uint32_t round;         /* rounds of this axis without a decision */
    uint32_t pulse;         /* 0 to 3 */
    uint32_t previous;      /* result of the previous round of this axis, enum hd_signs_problem */
    uint32_t passed;        /* 1: the signs were found right */
    uint32_t idle;          /* reasons why the device exerts no force, as in struct hd_signs_input, without `ignored` */
    uint32_t ignored;       /* reported reasons that a motion of the handle proved wrong */
    double phase_s;         /* time since the phase began */
    double waited_s;        /* time waited for the handle to rest */
    double driven_s;        /* duration of the pulse's drive */
    double end_s;           /* end of the observation, in time of the phase; 0: not known yet */
    double force_n;
    struct hd_signs_line line;
    double base_m[2]; /* position on the regression line at the start of the pulse */
    double slope_m_per_s[2];
    double sum_m[2]; /* sum of the distances from that line */
    double count;    /* number of these distances */
    double moved_m[4][2];
};

/* Runs one tick of the check. Returns whether the scene is held back; `force_n` is then the force of the check, else
 * zero. */
HD_RT int hd_signs_step(struct hd_signs *signs, const struct hd_hid_signs *of, const struct hd_signs_input *input,
                        double force_n[2]);
/* Runs the check in a servo and sets in `input` whether the scene is held back in this tick, and the force instead.
 * Latches the fault of signs that are wrong or stay unclear. */
HD_RT void hd_signs_watch(struct hd_signs *signs, const struct hd_look *look, struct hd_state *state,
                          const struct hd_table *table, struct hd_input *input);
/* State, problem and axis in one number, so that they are read as one: see HD_SIGNS_PROBLEM_SHIFT. */
HD_RT uint32_t hd_signs_told(const struct hd_signs *signs);

#endif
