/* The event at the end of what the simulated hand was told to do, once for each path: at the first tick at or after its
 * last waypoint's time, or at the tick that took another path, or a streamed target, before that. The thread that runs
 * the simulation. */
#ifndef HD_GESTURE_END_H
#define HD_GESTURE_END_H

#include "base/hd_rt.h"
#include "device/hd_sim.h"
#include "tick/hd_tick.h"

/* The hand follows `path` from this tick on; the path before it ends here if it had not ended. */
HD_RT void hd_gesture_begin(struct hd_state *state, struct hd_sim *sim, const struct hd_operator *path,
                            int64_t time_ns);
/* The hand goes to a streamed target, in a straight line, in `duration_s`; a path that had not ended ends here. 1: the
 * line is longer than its speed allows, and takes longer. */
HD_RT int hd_gesture_lead(struct hd_state *state, struct hd_sim *sim, const double target_m[2], double duration_s,
                          int64_t time_ns);
/* Once for each tick, when the simulation has reached its time. */
HD_RT void hd_gesture_watch(struct hd_state *state, struct hd_sim *sim, int64_t time_ns);

#endif
