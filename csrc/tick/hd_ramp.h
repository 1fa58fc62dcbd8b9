/* What a command may do to the force.
 *
 * A command is whatever changes the scene or what is shown of it: objects, materials, fields, display, ramp_s,
 * passivity, reset, set_forces. It takes effect at once, where the hand is: the tick that first sees it works out the
 * limited contact force there both as it was and as it is now. What lies between the two is the residual. It is added
 * to the force and goes to zero in a straight line over the ramp, or over more of them where it is larger than the
 * limit, so that
 *
 *     no command moves the force faster than max_force_n / ramp_s,
 *
 * however many there are and however they overtake each other; and what the hand does meanwhile is answered by the
 * scene as it is now, at once. What no command is the reason of is no part of it: a contact that is met inside after a
 * jump has a ramp of its own.
 *
 * Where the hand lets go of what the residual holds down, the residual gives way as the force does, so that nothing
 * ever sticks to the hand. Vibration comes and goes by gains of its own; where they and the residual together would be
 * too fast, the residual waits.
 *
 * While something ramps, hd_tick.c calls hd_ramp_contact once fields are added, and hd_ramp_command in place of
 * hd_limit_apply. Servo thread. SI units. */
#ifndef HD_RAMP_H
#define HD_RAMP_H

#include "base/hd_rt.h"
#include "tick/hd_context.h"

/* What a tick knows of its ramps. */
struct hd_ramped {
    int any;                  /* hd_ramp_contact had something to do; otherwise the next four are the contact force */
    int changed;              /* by a command of this tick */
    int cuts;                 /* in: the contact force is cut to the limit in any case, for the passivity controller */
    double still_n[2];        /* the contact force that would be felt if every ramp stood still, */
    double still_object_n[2]; /* the part of it that objects make, */
    double still_whole_n[2];  /* and that without the limit */
    double whole_n[2];        /* the contact force that is felt, without the limit */
    double held_n[2];         /* out of hd_ramp_command: what it took back, */
    int held_of_objects;      /* and that it is theirs */
};

/* Where there is a change, a residual, or another display: brings the contact force, as it is displayed, to what is
 * felt, within the limit and with the residual; `object_n`, out, is the part of it that objects make. 0: nothing is
 * felt, since the whole command is off. */
HD_RT int hd_ramp_contact(struct hd_context *context, double object_n[2], double contact_n[2],
                          struct hd_ramped *ramped);

/* The command of this tick before its gain, as hd_limit_apply. `ramped`: of the contact force. What of it ramps do
 * beside that, and too fast together, is left for the ticks after it. `still_n`: the vibration if every ramp stood
 * still; `gain_step`: what the gain moves by. */
HD_RT void hd_ramp_command(struct hd_context *context, struct hd_ramped *ramped, const double contact_n[2],
                           const double vibration_n[2], const double still_n[2], double gain_step, double force_n[2],
                           uint32_t *flags);
/* The slope that no command exceeds, in newtons a tick. */
HD_RT static inline double hd_ramp_pace(const struct hd_table *table) {
    return table->max_force_n * table->ramp_step;
}

/* What was noted of changes is taken in. */
HD_RT void hd_ramp_forget(struct hd_state *state);
/* Nothing of the force before counts. */
HD_RT void hd_ramp_clear(struct hd_state *state);

#endif
