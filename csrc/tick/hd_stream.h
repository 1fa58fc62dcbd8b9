/* The streamed force: a client sends where it is to be, now and then, and it goes there in a straight line, one value
 * after the other. It is a part of the contact force, as a constant field is. Its magnitude is at most the force limit,
 * and it moves by at most max_force_n / ramp_s: what the line wants faster comes later. A jump, a stall longer than the
 * ramp and a number that is none drop it, as they drop fields; it comes back at that pace. Servo thread. SI units. */
#ifndef HD_STREAM_H
#define HD_STREAM_H

#include "tick/hd_context.h"

/* It goes to `force_n`, finite, in `duration_s`. */
HD_RT void hd_stream_aim(struct hd_state *state, const struct hd_table *table, const double force_n[2],
                         double duration_s);
/* It goes to zero over the ramp, and is over there. */
HD_RT void hd_stream_end(struct hd_state *state, const struct hd_table *table);
/* Nothing of it is felt any more; the newest value is where it goes from there. */
HD_RT void hd_stream_drop(struct hd_state *state);
/* While there is one: it goes on in this tick, and its force is added. */
HD_RT void hd_stream_add(struct hd_context *context);

#endif
