/* The simulated joystick, from the inside of the core: what the servo thread calls. Each does what the function of
 * hd_api.h without `step` does; those are for the control side. One thread at a time uses a simulation. */
#ifndef HD_SIM_H
#define HD_SIM_H

#include "api/hd_core.h"
#include "base/hd_rt.h"

HD_RT void hd_sim_step_operate(struct hd_sim *sim, const struct hd_operator *path);
/* The hand goes from where it wants to be now to `target_m` in a straight line, in `duration_s` or, where that would be
 * faster than HD_STREAM_MAX_M_PER_S, as fast as that; 1: so it was. There it stays. */
HD_RT int hd_sim_step_lead(struct hd_sim *sim, const double target_m[2], double duration_s);
HD_RT void hd_sim_step_put(struct hd_sim *sim, const double force_n[2]);
HD_RT void hd_sim_step_advance(struct hd_sim *sim, uint32_t periods);
HD_RT void hd_sim_step_read(struct hd_sim *sim, struct hd_reading *reading);
/* What became of the path that hd_sim_step_operate began. */
enum hd_progress { HD_PROGRESS_NONE = 0, HD_PROGRESS_UNDER_WAY = 1, HD_PROGRESS_THROUGH = 2 };

HD_RT enum hd_progress hd_sim_step_progress(const struct hd_sim *sim);
/* A path that the hand is through is nothing to tell any more: HD_PROGRESS_NONE until the next one. */
HD_RT void hd_sim_step_announced(struct hd_sim *sim);
/* Asks for the memory that a period of free motion touches. */
HD_RT void hd_sim_step_fetch(const struct hd_sim *sim);
HD_RT void hd_sim_step_truth(const struct hd_sim *sim, double position[2], double velocity[2], double force[2]);

/* Control: one more holds it, and calls hd_sim_free, hd_operator_free. */
void hd_sim_hold(struct hd_sim *sim);
void hd_operator_hold(struct hd_operator *path);
/* How much memory *sim is: the servo locks it. */
size_t hd_sim_size(void);

#endif
