/* The state of the tick: what it keeps from one call to the next.
 *
 *   slots[]         one per object, at the object's index in the table; a slot belongs to the object while their
 *                   generations are equal
 *   active[]        slots that are in contact now, dense, unordered
 *   candidates[]    the candidate list of the broad phase (hd_broad_phase.c): objects that the probe can reach before
 *                   it has moved by candidates_radius_m
 *   resumed[]       slots whose contact was cleared while it was pressed; the next tick visits each once
 *   healing[]       punctured membranes that can heal
 *   active_modes[]  modes that ring now, dense, unordered; behind them, until the end of the tick, those that ended
 *                   since the last tick; a slot stores the index of its first one
 *   mode_ends[]     data of an active mode that only strikes and ends use; chains the active modes of a slot
 *   waves[]         waveforms that play now, dense, unordered, and behind them the free ones; each has a block of
 *                   wave_blocks[] for its samples
 *   noises[]        noises that sound now; a slot stores the index of its noise, free_noises[] is a stack of free ones
 *   offloads[]      strikes of this tick that the device plays as effects; taken by the caller of the tick
 *   reserves[]      largest force that each effect of the device may still add to the command
 *   strikes[]       filled during the contact update, emptied at the end of the tick, when the contact force is known,
 *                   and with it what the force limit leaves for vibration
 *   events[]        filled by a tick, taken by its caller; one more record at the end takes events that have no room
 *
 * Owned by one thread: the servo, or the caller of an offline run. hd_state_new reserves address space for every
 * possible slot; hd_state_reserve touches the pages of the slots that a table is about to use, so that the servo causes
 * no page faults. */
#ifndef HD_STATE_H
#define HD_STATE_H

#include "api/hd_core.h"
#include "base/hd_memory.h"
#include "scene/hd_world.h"
#include "shapes/hd_shape.h"
#include "tick/hd_noise.h"
#include "tick/hd_velocity.h"

#define HD_ACTIVE_MODE_CAPACITY 4096u /* ringing at once; beyond that, a mode near its end is dropped */
#define HD_STRIKE_CAPACITY 4096u      /* struck within one tick */
#define HD_EVENT_CAPACITY 256u        /* reported by one tick */
#define HD_PLAYED_CAPACITY 64u        /* modes that `play` strikes within one tick */
#define HD_NOISE_CAPACITY 256u        /* touched surfaces with noise; the noise of further ones is silent */
#define HD_OFFLOAD_CAPACITY 8u        /* strikes of one tick that the device plays as effects */
#define HD_OFFLOAD_LATE_S 0.07        /* largest delay of an effect after its strike: hd_effects.h */
#define HD_RESERVE_CAPACITY 16u       /* effects that may play at once */
#define HD_WAVE_CAPACITY 32u          /* waveforms that play at once; beyond that, the one nearest its end is dropped */
#define HD_STATE_REGIONS 16u
#define HD_PASSIVITY_PERIODS 1024u /* a power of two; more than HD_PASSIVITY_AGE_MAX plus the interval of reports */

enum hd_mode_use { HD_MODE_TAP = 0, HD_MODE_RUPTURE = 1, HD_MODE_GROOVE = 2, HD_MODE_SECOND = 3, HD_MODE_USES = 4 };

/* Surface properties at the contact point: see hd_surface.h. */
struct hd_surface {
    double stiffness_n_per_m;
    double stiffness_slope; /* dK/ds, N/m^2 */
    double damping_n_s_per_m;
    double lowering_m;     /* of the surface, by texture shown as geometry */
    double lowering_slope; /* its derivative by s */
    double drag_n_s_per_m; /* against tangential motion */
    double friction_coefficient;
    double friction_stiffness_n_per_m;
};

/* Force that commands took away in this tick: the force without the commands minus the force with them. */
struct hd_change {
    uint8_t any;     /* object_n, field_n or noise_n is not zero */
    uint8_t eases;   /* eased_n is not zero */
    uint8_t streams; /* the streamed force moved by streamed.step_n in this tick */
    uint8_t whole;   /* an object appeared or vanished: its residual is complete in this tick and fades from the next */
    double object_n[2]; /* of touched objects */
    double field_n[2];
    double noise_n[2];  /* of removed noises: the samples that they would have in this tick */
    double eased_n[2];  /* of noises on a ramp: their samples minus those with the ramp stopped */
    double noise_rms_n; /* RMS of the noises without changes and ramps, minus their RMS in this tick */
};

/* The streamed force: see hd_stream.h. */
struct hd_streamed {
    double value_n[2]; /* at the last tick */
    double step_n[2];  /* its change since the previous tick */
    double from_n[2];  /* start of the line that it follows */
    double to_n[2];    /* end of the line */
    double length_s;   /* duration of the line */
    uint64_t periods;  /* that have passed since the line began */
    uint64_t limited;  /* values that the force or slope limit kept from being reached in time */
    uint8_t fresh;     /* the line begins in this tick */
    uint8_t behind;    /* the newest value is counted in `limited` */
    uint8_t ends;      /* the line leads to zero, because no value came */
};

/* The residual: the force that a change took from the scene, on its way to zero. See hd_ramp.h. */
struct hd_residual {
    uint32_t remaining; /* ticks; 0: there is no residual */
    double force_n[2];
    double object_n[2];  /* the part of force_n that comes from objects */
    double beyond_n[2];  /* part of the residual that the force limit cuts off */
    double pressed_n[2]; /* the limited contact force without the residual */
    double was_n[2];     /* pressed_n of the previous tick */
};

struct hd_slot {
    uint32_t generation;
    uint32_t pose_version;       /* of the pose that the contact follows */
    uint32_t surface_version;    /* of the surface that the contact follows */
    uint32_t active_index;       /* index in active[] while touched */
    uint32_t healing_index;      /* index in healing[] plus one; 0: not in it */
    uint32_t open;               /* membrane: it is punctured while this equals the state's epoch */
    uint32_t mode[HD_MODE_USES]; /* index in active_modes[] plus one, of the first of a chain; 0: silent */
    uint32_t noise;              /* index in noises[] plus one; 0: silent */
    uint32_t contacts;           /* number of contacts of the slot: salt of their noise */
    uint32_t grooves;            /* grooves struck in this contact */
    uint64_t visited;            /* the tick that visited the slot last, plus one */
    double groove_m;             /* s of the groove that was struck last */
    double groove_free_m;        /* distance from groove_m beyond which that groove can be struck again */
    uint8_t touched;
    struct hd_feature feature; /* that is in contact */
    uint8_t disarmed;          /* released, and the probe has not yet been rearm_m away: no tap */
    uint8_t resume;            /* the contact was cleared while it was pressed */
    uint8_t changed;           /* a command changed this contact: the force at the end of this tick fades in */
    uint8_t held;              /* the groove at `groove_m` was struck, and the probe has not been away from it since */
    uint8_t kept;              /* its last tap is compensated and keeps the contact: hd_preload.h */
    uint16_t seam;             /* ticks in which the surface still blends from the earlier one to this one: hd_seam.h */
    double ramp;               /* of the contact force, 0 to 1: of a contact without onset that no command caused */
    double anchor_m;           /* s of the friction spring's anchor */
    double offset_m;           /* depth from which the force rises: hd_contact_force.c */
    double normal_n;           /* normal force at the last tick, without the ramp */
    double force_n[2];         /* force at the last tick, with the ramp */
    struct hd_contact_point last; /* contact point at the last tick; its normal stays valid after the contact */
    struct hd_surface surface;    /* at the last tick */
    uint32_t tail[HD_MODE_USES];  /* as `mode`, for tails; at the end of the record, because few ever ring */
    uint32_t preloaded;           /* as `mode`, for the part of a tap that needs a preload: hd_preload.h */
    double preload_share;         /* of that part, 0 to 1: what is left of it */
    double tap_m_per_s;           /* approach speed of the last tap */
    double tap_s;                 /* time since its onset, in contact */
    uint64_t tap_tick;            /* the tick that struck it, plus one; 0: none */
};

/* A vector of x and y for arithmetic on both at once. */
typedef double hd_pair __attribute__((vector_size(16)));

struct hd_active_mode {
    hd_pair re; /* real part of z, along x and y */
    hd_pair im; /* imaginary part: the force */
    double rotor_re;
    double rotor_im;
    uint32_t remaining; /* ticks after this one in which it still sounds */
    uint32_t slot;
    uint32_t generation;
    uint32_t use; /* enum hd_mode_use; for a tail HD_MODE_USES is added, for a part that needs a preload twice that */
};

/* Data of an active mode that only strikes and ends use. */
struct hd_mode_end {
    double over_s; /* time from its end to the first tick after that */
    uint32_t next; /* the next mode of the same slot and use: index in active_modes[] plus one, or 0 */
};

/* A waveform that plays: see hd_waveform.h. */
struct hd_wave {
    double force_n[2]; /* per unit of the curve */
    double step;       /* samples per tick */
    double begin;      /* position on the curve at the tick that struck it, in samples */
    double end;        /* position of the last sample */
    uint64_t ticks;    /* since the tick that struck it */
    uint32_t block;    /* index in wave_blocks[] */
    uint32_t unused;
};

struct hd_wave_block {
    double samples[HD_WAVE_SAMPLES + 2]; /* with a 0 before the first and a 0 after the last sample */
    double peaks[HD_WAVE_PARTS];
};

struct hd_strike {
    const struct hd_mode *mode;
    uint32_t slot;
    uint32_t generation;
    uint32_t use;
    uint32_t event;   /* index of the event that reports it */
    uint32_t offload; /* index in offloads[] plus one; 0: it becomes an active mode */
    double units;     /* strength in units of the mode: m/s of a tap, for example */
    double before_s;  /* time from the strike to the tick, 0 to one period */
    double growth_n;  /* increase of the surface's force until the first peak */
    uint32_t bare;    /* a command caused it: gain 1 and no corrections, so that the force starts at 0 without a step */
    double touched;   /* compensated mode: actual stiffness along the strike over the mode's touched_n_per_m */
    double direction[2];
    const struct hd_material *tuned; /* material whose groove or tap mode depends on the strike; NULL: a fixed mode */
    double tuned_rad_per_s;
    double tuned_decay_rate_per_s;  /* tap only */
    double tuned_m_per_s;           /* tap only: approach speed */
    const struct hd_material *wave; /* material whose waveform is played; NULL: a mode */
    const double *second_tail;      /* of a compensated tap: HD_KEPT_TAIL numbers; NULL: none */
    const double *kept;             /* its gains: HD_KEPT_GAINS numbers */
    uint32_t lifts; /* it acts along the normal: the kept gains sound, and the rest if the preload allows */
};

/* A strike that the device plays as an effect. */
struct hd_offload {
    uint32_t effect; /* id of a hd_device_effect */
    double force_n[2];
};

/* Force reserved for an effect that may be playing. */
struct hd_reserve {
    uint32_t effect;
    uint32_t remaining; /* ticks */
    double most_n;      /* largest force of the effect */
};

/* The force that was commanded in one period. */
struct hd_push {
    double force_n[2];
    double size_n;
};

/* The passivity observer and controller: see hd_passivity.h. */
struct hd_passivity {
    uint64_t next;       /* number of the tick that continues the sum; at any other tick it starts again */
    uint64_t acted;      /* ticks in which the controller changed the force */
    uint64_t contacts;   /* observed since the start */
    uint64_t restrained; /* contacts in which the controller changed the force */
    double energy_j;     /* given to the hand in this contact, or in the last one */
    double largest_j;    /* largest energy_j of all contacts */
    double taken_j;      /* dissipated by the handle in this contact */
    double brake;        /* part of the controller's brake that is on, 0 to 1: ramped up in contact, down after it */
    uint32_t interval;   /* longest interval between two samples of this contact, in periods */
    uint32_t hold;       /* longest interval between two ticks of this contact, in periods */
    uint32_t pushed;     /* periods in pushes[] */
    uint32_t newest;     /* index in pushes[] */
    uint32_t waited;     /* periods since the last sample */
    uint8_t running;     /* in contact, or part of the work is not known yet */
    uint8_t acting;      /* the controller changed the force in this contact */
    struct hd_push held; /* the force commanded since the last tick */
    struct hd_push pushes[HD_PASSIVITY_PERIODS];
};

struct hd_state {
    /* Used by every tick: adjacent, so that a tick with a cold cache loads few cache lines. */
    uint64_t tick; /* number of the tick that is being rendered, or comes next; the first is 0 */
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
    uint32_t ended_count; /* ended modes that lie in active_modes[] behind those that ring */
    uint32_t field_version;
    uint32_t faults;
    uint8_t started;          /* at least one tick was rendered */
    uint8_t steady;           /* no ramp, residual or passivity control is active; only a command ends this */
    uint8_t located;          /* position_m holds a sample */
    uint8_t enabled;          /* forces are enabled */
    uint8_t resync;           /* the next tick treats objects as if they had just appeared */
    uint8_t saturated;        /* the last tick reached the force limit */
    uint8_t yields;           /* the limit scales noise down in this tick */
    uint8_t field_active;     /* the field exerts a force */
    uint8_t field_known;      /* `field` was taken from a table; field_version says from which version */
    uint8_t candidates_known; /* candidates[] is valid around candidates_center_m */
    uint8_t streams;          /* there is a streamed force */
    uint8_t commanded;        /* there was a command */
    uint8_t offload_open;     /* the device can play effects; set by the caller of the tick */
    double gain;              /* of the complete command, 0 to 1: ramps when forces are enabled or fade out */
    double show_force;        /* gain of contacts and fields: the display flag of the last tick */
    double show_vibration;    /* gain of vibration: follows the display flag over the ramp */
    double noise_gain;        /* gain that the limit leaves for noises, 0 to 1: hd_limit_noise */
    double ringing_gain;      /* gain of ringing modes while the contact force exceeds the limit, 0 to 1 */
    double reserved_n;        /* part of the force limit that reserves[] take */
    double field_ramp;        /* gain of the field's force, 0 to 1 */
    double position_m[2];     /* the last sample */
    double candidates_center_m[2];
    double candidates_radius_m;
    struct hd_slot *slots;
    uint32_t *active;
    struct hd_candidate *candidates;
    double ringing_n[2]; /* sum of Im z over active_modes[], of kicks_n[0] and of waves[] */
    struct hd_active_mode *active_modes;
    struct hd_change change;     /* by the commands since the last tick and in this one */
    struct hd_residual residual; /* of these and earlier changes */
    /* Used by some ticks only. */
    uint64_t gesture_tick; /* the tick that took over the path which the simulated hand follows */
    uint64_t period;       /* periods that have begun, including missed ones: the clock of offline runs */
    uint32_t free_noise_count;
    uint32_t offload_count;
    uint32_t epoch;              /* raised when every membrane heals at once; never 0 */
    uint8_t gesture;             /* gesture_tick is valid */
    double controls;             /* weight of the passivity controller, 0 to 1, ramped */
    uint64_t commanded_tick;     /* the last tick that took over a command */
    uint32_t kick_count;         /* leading entries of kicks_n[] that may be nonzero */
    double kicks_n[HD_KICKS][2]; /* corrections that strikes add to this tick and the next ones */
    struct hd_field field;
    struct hd_streamed streamed;
    uint64_t strikes_total;
    uint64_t glitches_total;
    uint64_t saturations_total;
    uint64_t touches; /* number of onsets plus number of releases */
    uint64_t events_dropped;
    uint32_t slot_capacity; /* slots for which address space is reserved */
    uint32_t slot_count;    /* slots whose pages are in memory */
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
    struct hd_mode tuned; /* scratch: the mode of the current strike, if its frequency follows speed and force */
    struct hd_mode played[HD_PLAYED_CAPACITY]; /* copies: strikes[] points to them until the end of the tick */
    struct hd_passivity passivity;
};

/* The input of one tick. */
struct hd_input {
    int64_t time_ns;
    double position_m[2];
    double velocity_m_per_s[2];
    double true_velocity_m_per_s[2]; /* for the events; NaN if unknown */
    double interval_s;               /* between the previous sample and this one; 0: no new sample */
    double glitch_m_per_s;           /* speed that a jump of the position implies; 0: no jump */
    uint32_t periods;                /* since the previous tick: 1, plus the missed ones */
    uint32_t checking; /* the signs of the device are checked: the scene fades out, then check_n is felt */
    double check_n[2];
};

/* Control side: touches the pages of every slot below `slot_count`, before a table uses them. Returns HD_ERR_INVALID
 * beyond the capacity. */
int hd_state_reserve(struct hd_state *state, uint32_t slot_count);
uint32_t hd_state_slot_count(const struct hd_state *state);
/* Lists the memory of the slots from `from_slot` to `to_slot`, and if from_slot is 0, of the rest of the state. Returns
 * the number of regions, at most HD_STATE_REGIONS. */
size_t hd_state_regions(const struct hd_state *state, uint32_t from_slot, uint32_t to_slot, struct hd_region *regions);

/* Latches faults and disables the forces. `at_once`: the force is zero from this tick on; otherwise it fades out over
 * the ramp. */
HD_RT void hd_state_latch(struct hd_state *state, uint32_t faults, int at_once, int64_t time_ns);
/* Clears every latched fault except `remaining`, and enables the forces if no fault is left. */
HD_RT void hd_state_clear_faults(struct hd_state *state, uint32_t remaining, int64_t time_ns);
HD_RT void hd_state_want_forces(struct hd_state *state, int enabled);
/* Adds an event without an object to this tick; the caller may fill in more fields. Never returns NULL: without room
 * the event is counted as dropped, and the record returned is one behind the last, which is never read. */
HD_RT struct hd_event *hd_event_add(struct hd_state *state, uint32_t kind, int64_t time_ns, uint32_t code,
                                    double value);
/* Adds an event of the object in a slot. */
HD_RT struct hd_event *hd_event_add_at(struct hd_state *state, uint32_t kind, int64_t time_ns, uint32_t slot);
/* Returns the index of an event of this tick, for struct hd_strike. */
HD_RT static inline uint32_t hd_event_index(const struct hd_state *state, const struct hd_event *event) {
    return (uint32_t)(event - state->events);
}

#endif
