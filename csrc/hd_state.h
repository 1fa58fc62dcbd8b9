/* What the tick remembers from one call to the next.
 *
 *   slots[]   one per object, by the slot number in its table record; belongs to the object while the generation agrees
 *   active[]  the slots that are touched now, dense, in no order
 *   voices[]  the modes that ring now, dense, in no order; a slot knows its own
 *   strikes[] filled while a tick walks the objects, emptied at its end, when the contact force (and so what the limit
 *             leaves for vibration) is known
 *   events[]  filled by a tick, taken by whoever called it
 *
 * Owned by one thread: the servo's, or the caller's of an offline run. Everything is allocated by hd_state_new. */
#ifndef HD_STATE_H
#define HD_STATE_H

#include "hd_core.h"
#include "hd_velocity.h"

#define HD_VOICE_CAPACITY 4096u  /* ringing at once; beyond that, one that is near its end is given up */
#define HD_STRIKE_CAPACITY 4096u /* struck within one tick */
#define HD_EVENT_CAPACITY 256u   /* reported by one tick */
#define HD_PLAYED_CAPACITY 64u   /* modes played by hand within one tick */

enum hd_mode_use { HD_MODE_TAP = 0, HD_MODE_RUPTURE = 1, HD_MODE_USES = 2 };

struct hd_slot {
    uint32_t generation;
    uint32_t version; /* of the surface that `now` is, or is on its way to */
    uint64_t seen_tick;
    uint32_t active_index;        /* place in active[] while touched */
    uint32_t voice[HD_MODE_USES]; /* place in voices[] plus one; 0: silent */
    uint8_t touched;
    uint8_t open;     /* membrane: punctured */
    uint8_t known;    /* seen by an earlier tick: a crossing can be told from an appearance */
    int8_t side;      /* membrane: of the normal that the contact came from, +1 or -1 */
    int8_t last_side; /* membrane: where the probe last was off the surface */
    int8_t resume;    /* membrane: was pressed from this side when its contact was cleared; 0: was not */
    double ramp;      /* of the contact force, 0 to 1, for a contact without an onset */
    double blend;     /* from `from` to the table's surface, 0 to 1 */
    double force_n[2];
    struct hd_surface now;
    struct hd_surface from;
};

struct hd_voice {
    double re[2]; /* z along x and y */
    double im[2];
    double rotor_re;
    double rotor_im;
    double decay_rate_per_s;
    double angular_frequency_rad_per_s;
    uint32_t left; /* ticks that it still sounds after this one */
    uint32_t slot;
    uint32_t generation;
    uint32_t use; /* enum hd_mode_use */
};

struct hd_strike {
    const struct hd_mode *mode;
    uint32_t slot;
    uint32_t generation;
    uint32_t use;
    uint32_t event;  /* index of the event that reports it */
    double units;    /* of what excites the mode */
    double before_s; /* began this long before the tick, 0 to T */
    double growth_n; /* the surface's own force by the time of the first peak */
    double direction[2];
};

struct hd_state {
    uint64_t tick;   /* the one that is being rendered, or comes next; the first is 0 */
    uint64_t period; /* periods that have begun, missed ones too: the clock of offline runs */
    uint32_t voice_count;
    uint32_t active_count;
    uint32_t strike_count;
    uint32_t event_count;
    uint32_t played_count;
    uint32_t revision;
    uint32_t faults;
    uint8_t started;      /* a tick was rendered */
    uint8_t located;      /* position_m is a sample */
    uint8_t enabled;      /* forces are wanted */
    uint8_t resync;       /* objects are met as if they had just appeared */
    uint8_t saturated;    /* the last tick was */
    uint8_t field_active; /* the field exerts a force, or is on its way to none */
    double gain;          /* of the whole command: enabling and fading */
    double show_force;    /* of contacts and fields: the display flag, ramped */
    double show_vibration;
    double position_m[2]; /* the last sample */
    double residual_n[2]; /* what is left of the force of objects that went away under the hand */
    double residual_step_n[2];
    uint32_t residual_left; /* ticks */
    uint32_t field_version;
    double field_blend;
    struct hd_field field;
    struct hd_field field_from;
    uint64_t strikes_total;
    uint64_t glitches_total;
    uint64_t saturations_total;
    uint64_t events_dropped;
    uint32_t slot_capacity;
    struct hd_slot *slots;
    uint32_t *active;
    struct hd_voice *voices;
    struct hd_strike *strikes;
    struct hd_event *events;
    struct hd_mode played[HD_PLAYED_CAPACITY]; /* copies: strikes[] points to them until the tick is over */
    struct hd_velocity velocity;
};

/* What one tick is told. */
struct hd_input {
    int64_t time_ns;
    double position_m[2];
    double velocity_m_per_s[2];
    double true_velocity_m_per_s[2]; /* for the events; NaN where nobody knows */
    double interval_s;               /* between this sample and the one before; 0: no new sample */
    double glitch_m_per_s;           /* the speed that a jump implied; 0: no jump */
    uint32_t periods;                /* since the tick before: 1, and what was missed */
};

/* Latches faults. `at_once`: the force is zero from this tick on; otherwise it fades out over the ramp. */
HD_RT void hd_state_latch(struct hd_state *state, uint32_t faults, int at_once, int64_t time_ns);
/* Clears every latched fault but `remaining`, and enables the forces if none is left. */
HD_RT void hd_state_clear_faults(struct hd_state *state, uint32_t remaining, int64_t time_ns);
HD_RT void hd_state_want_forces(struct hd_state *state, int enabled);
/* A place for one more event of this tick, filled with the tick, its time and defaults; its index, or
 * HD_EVENT_CAPACITY when there is no more room (counted). */
HD_RT uint32_t hd_state_event(struct hd_state *state, uint32_t kind, int64_t time_ns);

#endif
