/* Broad phase: the candidate list, the objects that the probe can meet in a tick. Servo thread. */
#ifndef HD_BROAD_PHASE_H
#define HD_BROAD_PHASE_H

#include "tick/hd_context.h"

/* Brings state->candidates up to date. The distance, from candidates_center_m, up to which they can be met in this
 * tick. */
HD_RT double hd_broad_phase(struct hd_context *context);

#endif
