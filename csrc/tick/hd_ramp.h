/* Changes of the force by commands, spread over a ramp.
 *
 * A command here is anything that changes the scene or how it is displayed: objects, materials, fields, display,
 * ramp_s, passivity, reset, set_forces. The scene changes at once. The first tick of the changed scene computes the
 * limited contact force at the position of the hand before and after the change. Their difference is the residual. It
 * is added to the force and falls linearly to zero over the ramp, or over several ramps if it is larger than the force
 * limit, so that
 *
 *     no command moves the force faster than max_force_n / ramp_s,
 *
 * for any number of overlapping commands. Motion of the hand meanwhile acts on the changed scene without delay. The
 * residual contains only effects of commands: a contact that begins inside an object after a jump has a separate ramp.
 *
 * When the hand withdraws from a surface whose force the residual cancels, the residual shrinks with that force, so
 * that it never pulls the hand toward the surface. Vibration is ramped by separate gains; where gains and residual
 * together would move the force too fast, the residual waits.
 *
 * While a ramp is active, hd_tick.c calls hd_ramp_contact after fields are added, and hd_ramp_command instead of
 * hd_limit_apply. Servo thread. SI units. */
#ifndef HD_RAMP_H
#define HD_RAMP_H

#include "base/hd_rt.h"
#include "tick/hd_context.h"

/* The contact force of a tick with and without its ramps. */
struct hd_ramped {
    int any;                  /* hd_ramp_contact applied a ramp; otherwise the next four are the contact force */
    int changed;              /* a command changed the force in this tick */
    int cuts;                 /* in: always cut the contact force to the limit, for the passivity controller */
    double still_n[2];        /* contact force that would be felt with every ramp stopped */
    double still_object_n[2]; /* the part of it that objects exert */
    double still_whole_n[2];  /* still_n before the force limit */
    double whole_n[2];        /* the contact force that is felt, before the force limit */
    double held_n[2];         /* out of hd_ramp_command: force added because the command moved too fast */
    int held_of_objects;      /* held_n is counted as force of objects */
};

/* Applies the ramps after a change, during a residual or after a change of `display`: turns `contact_n`, the displayed
 * contact force, into the force that is felt, within the limit and with the residual. `object_n`, out: the part of it
 * that objects exert. Returns 0 if nothing is felt because the gain of the command is 0. */
HD_RT int hd_ramp_contact(struct hd_context *context, double object_n[2], double contact_n[2],
                          struct hd_ramped *ramped);

/* Computes the command of this tick before its gain, as hd_limit_apply does. Where all ramps together would move the
 * command too fast, the rest of the change is left to the following ticks. `ramped`: result of hd_ramp_contact;
 * `still_n`: vibration with every ramp stopped; `gain_step`: change of the gain in this tick. */
HD_RT void hd_ramp_command(struct hd_context *context, struct hd_ramped *ramped, const double contact_n[2],
                           const double vibration_n[2], const double still_n[2], double gain_step, double force_n[2],
                           uint32_t *flags);
/* Returns the largest change of the force by commands, in N per tick. */
HD_RT static inline double hd_ramp_pace(const struct hd_table *table) {
    return table->max_force_n * table->ramp_step;
}

/* Clears the recorded changes, which are part of the residual now. */
HD_RT void hd_ramp_forget(struct hd_state *state);
/* Clears the residual and the recorded changes. */
HD_RT void hd_ramp_clear(struct hd_state *state);

#endif
