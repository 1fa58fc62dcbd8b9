/* Narrow phase: every object that this tick can concern is met, pressed, let go or healed. Servo thread. */
#ifndef HD_NARROW_PHASE_H
#define HD_NARROW_PHASE_H

#include "tick/hd_context.h"

/* Updates the contacts with the candidates, with what is touched, with what was cleared under the hand and with what
 * heals. Their forces and noises are in the context's sums. */
HD_RT void hd_narrow_phase(struct hd_context *context);

#endif
