/* What every touched surface shares: taking a slot, touching and letting go, surfaces that change under the hand,
 * strikes. Servo thread; all of it runs inside a tick. */
#ifndef HD_CONTACT_H
#define HD_CONTACT_H

#include "hd_rt.h"
#include "hd_state.h"

/* What one tick knows while it walks the objects. */
struct hd_walk {
    const struct hd_table *table;
    struct hd_state *state;
    const struct hd_input *input;
    double from_m[2];  /* the last sample */
    double ramp_step;  /* what a ramp moves on in this tick */
    int resync;        /* contacts are met without an onset */
    double force_n[2]; /* the sum so far */
};

HD_RT static inline double hd_dot(const double a[2], const double b[2]) {
    return a[0] * b[0] + a[1] * b[1];
}

/* How long before the tick a point of the segment between two samples lies, `fraction` of the way along it. Beyond one
 * period it is cut: a strike begins within the tick that first hears it. */
HD_RT static inline double hd_before_tick(const struct hd_walk *walk, double fraction) {
    const double before = (1.0 - fraction) * walk->input->interval_s;
    const double period = walk->table->period_s;
    return before < 0.0 ? 0.0 : before > period ? period : before;
}

/* The slot of an object; taken over, with the contact of its former owner let go, if that was another. */
HD_RT struct hd_slot *hd_contact_take(struct hd_walk *walk, const struct hd_key *key);

HD_RT static inline struct hd_slot *hd_contact_slot(struct hd_walk *walk, const struct hd_key *key) {
    struct hd_slot *slot = &walk->state->slots[key->slot];
    return slot->generation == key->generation ? slot : hd_contact_take(walk, key);
}

/* How a contact begins. */
struct hd_onset {
    int silent;          /* no onset was seen: no tap, and the force comes in over the ramp */
    double before_s;     /* before the tick */
    double direction[2]; /* into which a tap pushes: the normal on the side entered */
};

/* Touches: reports it and strikes `tap`. */
HD_RT void hd_contact_begin(struct hd_walk *walk, struct hd_slot *slot, const struct hd_key *key,
                            const struct hd_surface *surface, const struct hd_mode *tap, const struct hd_onset *onset);
HD_RT void hd_contact_end(struct hd_state *state, uint32_t slot_index, int64_t time_ns);
/* The same, and the force that the hand felt fades out over the ramp instead of ending in a step. */
HD_RT void hd_contact_drop(struct hd_walk *walk, uint32_t slot_index);

/* A touched surface follows the table's over the ramp when that changed under the hand; one that turned by more than a
 * right angle is let go instead. */
HD_RT void hd_contact_follow(struct hd_walk *walk, struct hd_slot *slot, const struct hd_key *key,
                             const struct hd_surface *surface);
/* The force of a touched surface at depth `depth_m`, along `direction`; added to the walk. */
HD_RT void hd_contact_push(struct hd_walk *walk, struct hd_slot *slot, double depth_m, const double direction[2]);

/* Notes a strike for the end of the tick; `event` reports its scale. */
HD_RT void hd_strike_add(struct hd_state *state, const struct hd_strike *strike);
/* Strikes all that was noted, scaled as a whole to what the limit leaves. Returns the scale. */
HD_RT double hd_strikes_apply(struct hd_state *state, const struct hd_table *table, double contact_force_n);

/* The object walks, one file each. */
HD_RT void hd_walls_walk(struct hd_walk *walk);
HD_RT void hd_membranes_walk(struct hd_walk *walk);
HD_RT void hd_field_follow(struct hd_walk *walk);

HD_RT static inline void hd_field_walk(struct hd_walk *walk) {
    struct hd_state *state = walk->state;
    if (!state->started || state->field_version != walk->table->field_version || state->field_blend < 1.0) {
        hd_field_follow(walk);
    }
    if (state->field_active) {
        for (int axis = 0; axis < 2; axis++) {
            walk->force_n[axis] += state->field.force_n[axis] -
                                   state->field.stiffness_n_per_m * walk->input->position_m[axis] -
                                   state->field.damping_n_s_per_m * walk->input->velocity_m_per_s[axis];
        }
    }
}

#endif
