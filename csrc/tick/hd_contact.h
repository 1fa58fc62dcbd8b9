/* The life cycle of a contact, for every shape: a slot is assigned, the contact begins and ends. Servo thread; all of
 * it runs inside a tick. */
#ifndef HD_CONTACT_H
#define HD_CONTACT_H

#include "tick/hd_context.h"

/* Assigns a slot that is not touched to another object. */
HD_RT void hd_contact_take(struct hd_state *state, uint32_t index, uint32_t generation);
/* Begins a contact: reports it and strikes the tap. */
HD_RT void hd_contact_begin(struct hd_context *context, uint32_t index, const struct hd_object *object,
                            const struct hd_onset *onset);
HD_RT void hd_contact_end(struct hd_state *state, uint32_t index, int64_t time_ns);
/* Records a force that a command took away from the contact force. */
HD_RT void hd_contact_change(struct hd_state *state, const double force_n[2]);
/* Ends a contact; if the object is still pressed at the next tick, the contact begins again there, without a tap and
 * from the same side. */
HD_RT void hd_contact_clear(struct hd_state *state, uint32_t index, int64_t time_ns);
/* Closes a punctured membrane and takes it out of healing[]. */
HD_RT void hd_contact_close(struct hd_state *state, uint32_t index);

/* Returns the part of the path since the last tick, 0 to 1, after which the probe leaves over the end of a surface of
 * half-length `half_length_m`; 1: it does not leave. */
HD_RT static inline double hd_contact_until_end(const struct hd_slot *slot, const struct hd_contact_point *point,
                                                double half_length_m) {
    if (hd_magnitude(point->arc_m) <= half_length_m) {
        return 1.0;
    }
    const double end_m = point->arc_m > 0.0 ? half_length_m : -half_length_m;
    const double travel_m = point->arc_m - slot->last.arc_m;
    const double part = travel_m != 0.0 ? (end_m - slot->last.arc_m) / travel_m : 0.0;
    return part < 0.0 ? 0.0 : part > 1.0 ? 1.0 : part;
}

#endif
