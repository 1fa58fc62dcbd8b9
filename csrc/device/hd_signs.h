/* The check of a device's signs: whether a force to the right moves the handle to the right.
 *
 * A device that was never calibrated may push the other way, so that a wall pulls the hand in. Before the first force
 * of the scene, each axis is pushed four times, + - - +, by a short and small pulse; each pulse is followed by its
 * opposite, which brings the handle to rest again. How far the handle went is its mean distance, from the beginning of
 * the pulse to a little after it, from the line on which it was before. A device has the right signs if the difference
 * of the two directions is clear, along the right axis and the right way; a hand's own motion, as far as it is steady,
 * cancels. No pulse begins while something of the scene is touched or the handle moves.
 *
 * Part of the servo, in front of the tick: the tick is told that the scene is not felt and which force is (struct
 * hd_input). Servo thread. SI units. */
#ifndef HD_SIGNS_H
#define HD_SIGNS_H

#include "device/hd_hid.h"
#include "tick/hd_tick.h"

enum hd_signs_phase { HD_SIGNS_REST = 0, HD_SIGNS_PULSE = 1, HD_SIGNS_BRAKE = 2 };

/* A straight line through positions over time, as sums. */
struct hd_signs_line {
    double count;
    double time;
    double square;
    double position[2];
    double product[2];
    double power[2]; /* of positions, squared */
};

struct hd_signs {
    struct hd_hid_signs of; /* the check that is carried out, or was; number 0: none */
    uint32_t state;         /* enum hd_signs_state */
    uint32_t problem;       /* enum hd_signs_problem */
    uint32_t axis;          /* that is pushed, 0 or 1 */
    uint32_t phase;         /* enum hd_signs_phase */
    uint32_t round;         /* of this axis: rounds that told nothing so far */
    uint32_t pulse;         /* 0 to 3 */
    uint32_t wrong;         /* what the round before found wrong of this axis; 0: nothing */
    double phase_s;         /* since the phase began */
    double waited_s;        /* for the handle to rest */
    double driven_s;        /* so long the pulse was driven, */
    double end_s;           /* and, in its phase, this is its end; 0: not known yet */
    double force_n;
    struct hd_signs_line line;
    double base_m[2]; /* of the line, at the beginning of the pulse */
    double slope_m_per_s[2];
    double sum_m[2]; /* of distances from that line, and */
    double count;    /* how many */
    double moved_m[4][2];
};

/* One tick. Returns whether the scene is held back; the force of the check then, else zero. */
HD_RT int hd_signs_step(struct hd_signs *signs, const struct hd_hid_signs *of, const struct hd_signs_input *input,
                        double force_n[2]);
/* The same in a servo: whether the scene is held back in this tick, and the force instead, into `input`. Latches the
 * fault of signs that are wrong or stay unclear. */
HD_RT void hd_signs_watch(struct hd_signs *signs, const struct hd_look *look, struct hd_state *state,
                          const struct hd_table *table, struct hd_input *input);
/* State, problem and axis in one number, so that they are read as one: see HD_SIGNS_PROBLEM_SHIFT. */
HD_RT uint32_t hd_signs_told(const struct hd_signs *signs);

#endif
