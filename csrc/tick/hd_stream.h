/* The streamed force: a client sends target values from time to time, and the force moves to each of them in a straight
 * line. It is part of the contact force, as a constant field is. Its magnitude is at most the force limit and its slope
 * at most max_force_n / ramp_s; a steeper line is followed with delay. A jump, a stall longer than the ramp and NaN or
 * infinity set it to zero, as they do with fields; it then returns at the largest slope. Servo thread. SI units. */
#ifndef HD_STREAM_H
#define HD_STREAM_H

#include "tick/hd_context.h"

/* Starts the line to `force_n`, which must be finite, within `duration_s`. */
HD_RT void hd_stream_aim(struct hd_state *state, const struct hd_table *table, const double force_n[2],
                         double duration_s);
/* Starts a line to zero over the ramp, at whose end the stream ends. */
HD_RT void hd_stream_end(struct hd_state *state, const struct hd_table *table);
/* Sets the force to zero at once; from there it moves to the newest value. */
HD_RT void hd_stream_drop(struct hd_state *state);
/* Advances the streamed force by this tick and adds it to the context. Called while state->streams is set. */
HD_RT void hd_stream_add(struct hd_context *context);

#endif
