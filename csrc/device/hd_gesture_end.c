/* Adds the event at the end of a path of the simulated hand. This file finds the ticks at which a path begins and ends;
 * hd_sim has its times. */
#include "device/hd_gesture_end.h"

HD_RT static void add_end_event(struct hd_state *state, int completed, int64_t time_ns) {
    /* Exact: tick numbers stay below 2^53. */
    const double began = (double)(state->gesture ? state->gesture_tick : state->tick);
    hd_event_add(state, HD_EVENT_GESTURE_END, time_ns, (uint32_t)completed, began);
    state->gesture = 0;
}

HD_RT void hd_gesture_begin(struct hd_state *state, struct hd_sim *sim, const struct hd_operator *path,
                            int64_t time_ns) {
    if (hd_sim_step_progress(sim) != HD_PROGRESS_NONE) {
        add_end_event(state, 0, time_ns);
    }
    hd_sim_step_operate(sim, path);
}

HD_RT int hd_gesture_lead(struct hd_state *state, struct hd_sim *sim, const double target_m[2], double duration_s,
                          int64_t time_ns) {
    if (hd_sim_step_progress(sim) != HD_PROGRESS_NONE) {
        add_end_event(state, 0, time_ns);
    }
    return hd_sim_step_lead(sim, target_m, duration_s);
}

HD_RT void hd_gesture_watch(struct hd_state *state, struct hd_sim *sim, int64_t time_ns) {
    const enum hd_progress progress = hd_sim_step_progress(sim);
    if (progress == HD_PROGRESS_NONE) {
        return;
    }
    if (!state->gesture) {
        state->gesture = 1;
        state->gesture_tick = state->tick;
    }
    if (progress == HD_PROGRESS_THROUGH) {
        hd_sim_step_announced(sim);
        add_end_event(state, 1, time_ns);
    }
}
