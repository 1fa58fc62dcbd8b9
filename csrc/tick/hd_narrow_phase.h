/* Narrow phase: updates the contact of every object that this tick can affect. Servo thread. */
#ifndef HD_NARROW_PHASE_H
#define HD_NARROW_PHASE_H

#include "tick/hd_context.h"

/* Updates the contacts with candidates, touched objects, objects whose contact was cleared while it was pressed, and
 * healing membranes. Adds their forces and noises to the sums of the context. */
HD_RT void hd_narrow_phase(struct hd_context *context);

#endif
