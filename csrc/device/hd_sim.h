/* The simulated joystick: the functions that the servo thread calls. Each does what the function of hd_api_device.h
 * without `step` does; those are for the control side. One thread at a time uses a simulation. */
#ifndef HD_SIM_H
#define HD_SIM_H

#include "api/hd_core.h"
#include "base/hd_rt.h"

HD_RT void hd_sim_step_operate(struct hd_sim *sim, const struct hd_operator *path);
/* Moves the hand's reference in a straight line to `target_m` within `duration_s`, where it stays. If that would be
 * faster than HD_STREAM_MAX_M_PER_S, moves at that speed and returns 1. */
HD_RT int hd_sim_step_lead(struct hd_sim *sim, const double target_m[2], double duration_s);
HD_RT void hd_sim_step_put(struct hd_sim *sim, const double force_n[2]);
HD_RT void hd_sim_step_advance(struct hd_sim *sim, uint32_t periods);
HD_RT void hd_sim_step_read(struct hd_sim *sim, struct hd_reading *reading);
/* Progress of the path that hd_sim_step_operate began. */
enum hd_progress { HD_PROGRESS_NONE = 0, HD_PROGRESS_UNDER_WAY = 1, HD_PROGRESS_THROUGH = 2 };

HD_RT enum hd_progress hd_sim_step_progress(const struct hd_sim *sim);
/* Notes that the end of the path was reported: progress is HD_PROGRESS_NONE until the next path. */
HD_RT void hd_sim_step_announced(struct hd_sim *sim);
/* Prefetches the memory that a period of free motion uses. */
HD_RT void hd_sim_step_fetch(const struct hd_sim *sim);
HD_RT void hd_sim_step_truth(const struct hd_sim *sim, double position[2], double velocity[2], double force[2]);

/* Control: take a reference, which hd_sim_free and hd_operator_free drop. */
void hd_sim_hold(struct hd_sim *sim);
void hd_operator_hold(struct hd_operator *path);
/* Returns the size of *sim, which the servo locks. */
size_t hd_sim_size(void);

#endif
