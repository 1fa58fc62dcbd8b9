/* What the tick remembers from one call to the next.
 *
 *   slots[]         one per object, at the object's index in the table; it belongs to the object while the generation
 *                   agrees
 *   active[]        slots that are in contact now, dense, in no order
 *   candidates[]    the candidate list of the broad phase (hd_broad_phase.c): what the probe can meet before it has
 *                   moved by candidates_radius_m
 *   resumed[]       slots whose contact was cleared under the hand, visited once by the next tick
 *   healing[]       punctured membranes that close again
 *   active_modes[]  modes that ring now, dense, in no order; behind them, to the end of a tick, those that ended since
 *                   the last one; a slot knows the first of its own
 *   mode_ends[]     what of an active mode only strikes and ends need; chains the active modes of a slot
 *   waves[]         waveforms that play now, dense, in no order, and behind them the free ones; each has a block of
 *                   wave_blocks[] for its samples
 *   noises[]        noises that sound now; a slot knows its own, free ones are stacked in free_noises[]
 *   offloads[]      strikes of this tick that the device plays itself; taken by the caller of the tick
 *   reserves[]      what those that were struck may still add to the command
 *   strikes[]       filled during the contact update, emptied at the end of the tick, when the contact force (and so
 *                   what the limit leaves for vibration) is known
 *   events[]        filled by a tick, taken by its caller; the last record takes what has no room
 *
 * Owned by one thread: the servo's, or the caller's of an offline run. hd_state_new reserves address space for every
 * slot there can be; hd_state_reserve touches the pages of those that a table is about to use, so that the servo never
 * does. */
#ifndef HD_STATE_H
#define HD_STATE_H

#include "api/hd_core.h"
#include "base/hd_memory.h"
#include "scene/hd_world.h"
#include "shapes/hd_shape.h"
#include "tick/hd_noise.h"
#include "tick/hd_velocity.h"

#define HD_ACTIVE_MODE_CAPACITY 4096u /* ringing at once; beyond that, one that is near its end is given up */
#define HD_STRIKE_CAPACITY 4096u      /* struck within one tick */
#define HD_EVENT_CAPACITY 256u        /* reported by one tick */
#define HD_PLAYED_CAPACITY 64u        /* modes played by hand within one tick */
#define HD_NOISE_CAPACITY 256u        /* surfaces with noise that are touched at once; further ones are silent */
#define HD_OFFLOAD_CAPACITY 8u        /* strikes of one tick that the device plays by itself */
#define HD_OFFLOAD_LATE_S 0.07        /* so late an effect may begin after its strike: hd_effects.h */
#define HD_RESERVE_CAPACITY 16u       /* effects that may play at once */
#define HD_WAVE_CAPACITY 32u /* waveforms that play at once; beyond that, the one nearest its end is given up */
#define HD_STATE_REGIONS 16u
#define HD_PASSIVITY_PERIODS 1024u /* a power of two, more than HD_PASSIVITY_AGE_MAX and a report's interval need */

enum hd_mode_use { HD_MODE_TAP = 0, HD_MODE_RUPTURE = 1, HD_MODE_GROOVE = 2, HD_MODE_SECOND = 3, HD_MODE_USES = 4 };

/* What the material gives where the probe is: see hd_surface.h. */
struct hd_surface {
    double stiffness_n_per_m;
    double stiffness_slope; /* dK/ds, N/m^2 */
    double damping_n_s_per_m;
    double lowering_m; /* of the surface, by geometry */
    double lowering_slope;
    double drag_n_s_per_m; /* against tangential motion */
    double friction_coefficient;
    double friction_stiffness_n_per_m;
};

/* What commands take from the force. */
struct hd_change {
    uint8_t any;     /* object_n, field_n and noise_n are not all zero */
    uint8_t eases;   /* eased_n is not zero */
    uint8_t streams; /* the streamed force went by streamed.step_n in this tick */
    uint8_t whole;   /* something came or went: what that makes is whole in this tick, and fades from the next one on */
    double object_n[2]; /* of what is touched */
    double field_n[2];
    double noise_n[2];  /* of noises that are no more: what they would be in this tick */
    double eased_n[2];  /* what noises that are on a ramp are more than they would be if it stood still */
    double noise_rms_n; /* what the RMS of noises would be more in this tick without changes and ramps */
};

/* The streamed force: see hd_stream.h. */
struct hd_streamed {
    double value_n[2]; /* at the last tick */
    double step_n[2];  /* to it from the one before */
    double from_n[2];  /* the line that it follows, */
    double to_n[2];
    double length_s;  /* in so much time, */
    uint64_t periods; /* so many of which have passed */
    uint64_t limited; /* values that could not be followed as they were meant */
    uint8_t fresh;    /* the line begins in this tick */
    uint8_t behind;   /* that is known of this value */
    uint8_t ends;     /* the line leads to nothing, because no value came */
};

/* What was felt before a change and is not the scene's any more, on its way to zero: see hd_ramp.h. */
struct hd_residual {
    uint32_t remaining; /* ticks; 0: there is none */
    double force_n[2];
    double object_n[2];  /* the part of it that is of objects */
    double beyond_n[2];  /* as it would be without the limit, above that */
    double pressed_n[2]; /* the limited contact force without it, */
    double was_n[2];     /* and that of the tick before */
};

struct hd_slot {
    uint32_t generation;
    uint32_t pose_version; /* of the place and the surface that the contact follows */
    uint32_t surface_version;
    uint32_t active_index;       /* place in active[] while touched */
    uint32_t healing_index;      /* place in healing[] plus one; 0: not in it */
    uint32_t open;               /* membrane: punctured, while this is the state's epoch */
    uint32_t mode[HD_MODE_USES]; /* place in active_modes[] plus one, of the first of a chain; 0: silent */
    uint32_t noise;              /* place in noises[] plus one; 0: silent */
    uint32_t contacts;           /* so far: the salt of their noise */
    uint32_t grooves;            /* struck in this contact */
    uint64_t visited;            /* the tick that looked at it last, plus one */
    double groove_m;             /* s of the groove that was struck last, and how far from it it may strike again */
    double groove_free_m;
    uint8_t touched;
    struct hd_feature feature; /* that is in contact */
    uint8_t disarmed;          /* let go, and the probe has not been far enough from it since to tap it */
    uint8_t resume;            /* its contact was cleared while it was pressed */
    uint8_t changed;           /* what it presses with at the end of this tick is a command's doing */
    uint8_t held;              /* the groove at `groove_m` was struck and the probe has not been away from it since */
    uint16_t seam;             /* ticks in which friction goes over from what was left to this material */
    double ramp;               /* of the contact force, 0 to 1, for a contact without an onset that is no command's */
    double anchor_m;           /* friction: where the probe sticks, along the surface */
    double normal_n;           /* the normal force at the last tick, without ramp */
    double force_n[2];         /* at the last tick, with it */
    struct hd_contact_point last; /* at the last tick; its normal outlives the contact */
    struct hd_surface surface;    /* at the last tick */
    uint32_t tail[HD_MODE_USES];  /* as `mode`, of the tails; last, because few ever ring */
};

/* Two numbers, of x and of y, that are computed with as one. */
typedef double hd_pair __attribute__((vector_size(16)));

struct hd_active_mode {
    hd_pair re; /* z along x and y */
    hd_pair im;
    double rotor_re;
    double rotor_im;
    uint32_t remaining; /* ticks that it still sounds after this one */
    uint32_t slot;
    uint32_t generation;
    uint32_t use; /* enum hd_mode_use; of a tail HD_MODE_USES more */
};

/* What of an active mode only strikes and ends need. */
struct hd_mode_end {
    double over_s; /* from its end to the first tick after that */
    uint32_t next; /* of the same slot and use, another mode: place in active_modes[] plus one, or 0 */
};

/* A waveform that plays: see hd_waveform.h. */
struct hd_wave {
    double force_n[2]; /* per unit of the curve */
    double step;       /* samples a tick */
    double begin;      /* samples that had passed at the tick that struck it */
    double end;        /* the last sample */
    uint64_t ticks;    /* since that tick */
    uint32_t block;    /* place in wave_blocks[] */
    uint32_t unused;
};

struct hd_wave_block {
    double samples[HD_WAVE_SAMPLES + 2]; /* with the 0 before the first and the one after the last */
    double peaks[HD_WAVE_PARTS];
};

struct hd_strike {
    const struct hd_mode *mode;
    uint32_t slot;
    uint32_t generation;
    uint32_t use;
    uint32_t event;   /* index of the event that reports it */
    uint32_t offload; /* place in offloads[] plus one; 0: it is an active mode */
    double units;     /* of what excites the mode */
    double before_s;  /* began this long before the tick, 0 to T */
    double growth_n;  /* the surface's own force by the time of the first peak */
    uint32_t bare;    /* a command's doing: the mode alone, which begins at 0, so that nothing of it comes at once */
    double touched;   /* stiffness that it meets over the mode's, of one that is compensated for it */
    double direction[2];
    const struct hd_material *tuned; /* whose groove or tap it is, where that has a mode of its own; NULL: the mode's */
    double tuned_rad_per_s;
    double tuned_decay_rate_per_s;  /* of a tap */
    double tuned_m_per_s;           /* of a tap: its approach speed */
    const struct hd_material *wave; /* whose waveform it is; NULL: a mode */
};

/* A strike that the device plays by itself. */
struct hd_offload {
    uint32_t effect; /* id of a hd_device_effect */
    double force_n[2];
};

/* An effect that may be playing. */
struct hd_reserve {
    uint32_t effect;
    uint32_t remaining; /* ticks */
    double most_n;
};

/* What was commanded in a period. */
struct hd_push {
    double force_n[2];
    double size_n;
};

/* The passivity observer and controller: see hd_passivity.h. */
struct hd_passivity {
    uint64_t next;       /* the tick that goes on from here; any other begins anew */
    uint64_t acted;      /* ticks in which the controller changed the force */
    uint64_t contacts;   /* so far */
    uint64_t restrained; /* of them, those in which it did */
    double energy_j;     /* given to the hand in this contact, or in the last one */
    double largest_j;    /* of all contacts */
    double taken_j;      /* by the handle itself, in this contact */
    double brake; /* how much of its brake the controller has, 0 to 1: over the ramp it goes with what is touched */
    uint32_t interval;   /* the longest between two samples of this contact, in periods */
    uint32_t hold;       /* the longest between two ticks of it */
    uint32_t pushed;     /* periods in pushes[] */
    uint32_t newest;     /* place in pushes[] */
    uint32_t waited;     /* periods since the last sample */
    uint8_t running;     /* in contact, or a part of its work is not known yet */
    uint8_t acting;      /* in this contact */
    struct hd_push held; /* commanded since the last tick */
    struct hd_push pushes[HD_PASSIVITY_PERIODS];
};

struct hd_state {
    /* Every tick, from here: side by side, so that a tick that comes cold waits for few lines of the cache. */
    uint64_t tick; /* the one that is being rendered, or comes next; the first is 0 */
    uint32_t active_mode_count;
    uint32_t wave_count;
    uint32_t active_count;
    uint32_t candidate_count;
    uint32_t healing_count;
    uint32_t resumed_count;
    uint32_t strike_count;
    uint32_t reserve_count;
    uint32_t event_count;
    uint32_t played_count;
    uint32_t revision;
    uint32_t ended_count; /* of active modes, behind those that ring */
    uint32_t field_version;
    uint32_t faults;
    uint8_t started;      /* a tick was rendered */
    uint8_t steady;       /* nothing of a command or of the passivity controller is under way: only a command ends it */
    uint8_t located;      /* position_m is a sample */
    uint8_t enabled;      /* forces are wanted */
    uint8_t resync;       /* objects are met as if they had just appeared, after contacts were cleared */
    uint8_t saturated;    /* the last tick was */
    uint8_t yields;       /* noise gives way to the limit in this tick */
    uint8_t field_active; /* the field exerts a force */
    uint8_t field_known;  /* it is the table's, but for a change of its version */
    uint8_t candidates_known; /* candidates[] holds for candidates_center_m */
    uint8_t streams;          /* there is a streamed force */
    uint8_t commanded;        /* there was a command */
    uint8_t offload_open;     /* the device plays effects by itself: whoever calls the tick says so */
    double gain;              /* of the whole command: enabling and fading */
    double show_force;        /* of contacts and fields: the display flag */
    double show_vibration;    /* the same of vibration, ramped */
    double noise_gain;        /* what the limit left of noises, 0 to 1: hd_limit_noise */
    double ringing_gain;      /* what is left of modes that ring while contact is beyond the limit, 0 to 1 */
    double reserved_n;        /* of the limit, for reserves[] */
    double field_ramp;        /* of its force, as of a contact */
    double position_m[2];     /* the last sample */
    double candidates_center_m[2];
    double candidates_radius_m;
    struct hd_slot *slots;
    uint32_t *active;
    struct hd_candidate *candidates;
    double ringing_n[2]; /* the sum of Im z over active_modes[], of kicks_n[0], and of waves[] */
    struct hd_active_mode *active_modes;
    struct hd_change change;     /* that commands made since the last tick, and in this one */
    struct hd_residual residual; /* what is left of that */
    /* Some ticks, from here. */
    uint64_t gesture_tick; /* that took the path which the simulated hand follows */
    uint64_t period;       /* periods that have begun, missed ones too: the clock of offline runs */
    uint32_t free_noise_count;
    uint32_t offload_count;
    uint32_t epoch;              /* raised when every membrane heals at once; never 0 */
    uint8_t gesture;             /* gesture_tick is known */
    double controls;             /* how much of what the passivity controller asks for is done, 0 to 1, ramped */
    uint64_t commanded_tick;     /* the last one that took in a command */
    uint32_t kick_count;         /* of kicks_n[] that are not zero, from the first on */
    double kicks_n[HD_KICKS][2]; /* what strikes add to this tick and the next ones */
    struct hd_field field;
    struct hd_streamed streamed;
    uint64_t strikes_total;
    uint64_t glitches_total;
    uint64_t saturations_total;
    uint64_t touches; /* contacts that began or ended so far */
    uint64_t events_dropped;
    uint32_t slot_capacity; /* address space for so many */
    uint32_t slot_count;    /* so many are in memory */
    uint32_t *resumed;
    uint32_t *healing;
    struct hd_mode_end *mode_ends;
    struct hd_wave *waves;
    struct hd_wave_block *wave_blocks;
    struct hd_active_noise *noises;
    uint32_t *free_noises;
    struct hd_strike *strikes;
    struct hd_event *events;
    struct hd_velocity velocity;
    struct hd_offload offloads[HD_OFFLOAD_CAPACITY];
    struct hd_reserve reserves[HD_RESERVE_CAPACITY];
    struct hd_mode tuned; /* of the strike that is dealt with, where that has a frequency of its own */
    struct hd_mode played[HD_PLAYED_CAPACITY]; /* copies: strikes[] points to them until the tick is over */
    struct hd_passivity passivity;
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
    uint32_t checking;               /* the scene is not felt, but, once it has faded out, */
    double check_n[2];               /* this, while the signs of the device are checked */
};

/* Control side: the pages of every slot below `slot_count` are there, before a table uses them. HD_ERR_INVALID beyond
 * the capacity. */
int hd_state_reserve(struct hd_state *state, uint32_t slot_count);
uint32_t hd_state_slot_count(const struct hd_state *state);
/* The memory of the slots from `from_slot` to `to_slot`, and with it, where from_slot is 0, of everything else; the
 * number of regions, at most HD_STATE_REGIONS. */
size_t hd_state_regions(const struct hd_state *state, uint32_t from_slot, uint32_t to_slot, struct hd_region *regions);

/* Latches faults. `at_once`: the force is zero from this tick on; otherwise it fades out over the ramp. */
HD_RT void hd_state_latch(struct hd_state *state, uint32_t faults, int at_once, int64_t time_ns);
/* Clears every latched fault but `remaining`, and enables the forces if none is left. */
HD_RT void hd_state_clear_faults(struct hd_state *state, uint32_t remaining, int64_t time_ns);
HD_RT void hd_state_want_forces(struct hd_state *state, int enabled);
/* One more event of this tick, of no object, for the caller to fill in what else it tells. Never NULL: when there is no
 * more room (counted) it is a record behind the last one, which nobody reads. */
HD_RT struct hd_event *hd_event_add(struct hd_state *state, uint32_t kind, int64_t time_ns, uint32_t code,
                                    double value);
/* The same of an object, at a strike or without one. */
HD_RT struct hd_event *hd_event_add_at(struct hd_state *state, uint32_t kind, int64_t time_ns, uint32_t slot);
/* Which event it is, for struct hd_strike. */
HD_RT static inline uint32_t hd_event_index(const struct hd_state *state, const struct hd_event *event) {
    return (uint32_t)(event - state->events);
}

#endif
