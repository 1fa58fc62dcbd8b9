/* The life of a contact, whatever the shape: taking a slot, touching, letting go. Servo thread; all of it runs inside a
 * tick. */
#ifndef HD_CONTACT_H
#define HD_CONTACT_H

#include "tick/hd_context.h"

/* The slot, which is not touched, becomes that of another object. */
HD_RT void hd_contact_take(struct hd_state *state, uint32_t index, uint32_t generation);
/* Touches: reports it and strikes the tap. */
HD_RT void hd_contact_begin(struct hd_context *context, uint32_t index, const struct hd_object *object,
                            const struct hd_onset *onset);
HD_RT void hd_contact_end(struct hd_state *state, uint32_t index, int64_t time_ns);
/* A command took this from the force of the objects. */
HD_RT void hd_contact_change(struct hd_state *state, const double force_n[2]);
/* Lets go of a contact that is to be met anew by the next tick, silently and from the same side, if it is still pressed
 * then. */
HD_RT void hd_contact_clear(struct hd_state *state, uint32_t index, int64_t time_ns);
/* The membrane is no longer punctured, or about to heal. */
HD_RT void hd_contact_close(struct hd_state *state, uint32_t index);

/* How much of the path since the last tick the probe goes before it leaves over the end of a surface, half of whose
 * length is given; 1: all of it. */
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
