/* The event at the end of a path of the simulated hand, once per path: at the first tick at or after the time of its
 * last waypoint, or earlier at the tick that takes another path or a streamed target. Used by the thread that runs the
 * simulation. */
#ifndef HD_GESTURE_END_H
#define HD_GESTURE_END_H

#include "base/hd_rt.h"
#include "device/hd_sim.h"
#include "tick/hd_tick.h"

/* Makes the hand follow `path` from this tick on; an unfinished path before it ends here. */
HD_RT void hd_gesture_begin(struct hd_state *state, struct hd_sim *sim, const struct hd_operator *path,
                            int64_t time_ns);
/* Moves the hand to a streamed target in a straight line within `duration_s`; an unfinished path ends here. Returns 1
 * if the speed limit makes the motion take longer. */
HD_RT int hd_gesture_lead(struct hd_state *state, struct hd_sim *sim, const double target_m[2], double duration_s,
                          int64_t time_ns);
/* Call once per tick, when the simulation has reached the tick's time. */
HD_RT void hd_gesture_watch(struct hd_state *state, struct hd_sim *sim, int64_t time_ns);

#endif
