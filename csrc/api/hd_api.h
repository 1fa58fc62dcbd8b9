/* The boundary between the C core and Python: everything that crosses it, and nothing else.
 *
 * This file is read twice, verbatim: by the C compiler (through hd_core.h, which adds guards and asserts) and by
 * cffi. It therefore holds declarations and `#define NAME number` only.
 *
 * The model, in five sentences. A *table* is an immutable snapshot of the scene, compiled by Python into flat
 * arrays that are already in the units a tick needs. A *state* is what the tick remembers: contacts, ringing modes,
 * punctures, friction anchors, noise, ramps; it lives in slots that belong to an object as long as it keeps id and
 * kind. A *tick* is a function of table, state and one input, and gives one sample. The *servo* calls the tick on time,
 * with a device on one side and rings on the other. Python compiles tables, sends commands and drains samples and
 * events; it never runs inside a tick.
 *
 * Units are SI and stand in the names. Vectors are [x, y]. Times are CLOCK_MONOTONIC nanoseconds, or seconds where
 * the name says so. Functions that can fail return HD_OK or a negative enum hd_status. Functions here are for the
 * control side: none of them is called from the servo thread.
 */

enum hd_status {
    HD_OK = 0,
    HD_ERR_INVALID = -1, /* an argument or a table breaks its contract; hd_invalid_reason says which */
    HD_ERR_FULL = -2,    /* a ring has no room; nothing was taken */
    HD_ERR_MEMORY = -3,  /* no memory */
    HD_ERR_SYSTEM = -4,  /* a system call failed; errno says why */
    HD_ERR_TIMEOUT = -5, /* the servo did not take it in time */
    HD_ERR_DENIED = -6   /* real-time rights were required and refused */
};

/* ---- What a table holds ------------------------------------------------------------------------------------ */

#define HD_KICKS 8

/* A decaying sinusoid A exp(-B t) sin(w t), t >= 0, prepared for one tick period T. What is played of it is the
 * coefficient (force per unit) times
 *
 *     Im(gain exp((-B + i w) t)) up to end_s  +  Im(tail exp((-B' + i w') t)) up to tail_end_s,
 *
 * with a gain of 1 and no tail where the device is not compensated for (docs/adr/0016 and 0030). */
struct hd_mode {
    double rotor_re; /* exp((-B + i w) T) */
    double rotor_im;
    double decay_rate_per_s;            /* B */
    double angular_frequency_rad_per_s; /* w */
    double end_s;                       /* 5/B: sounds while t_k - t_last <= end_s */
    double peak;                        /* largest magnitude of all that, or more; of the bare mode its first maximum */
    double peak_time_s;                 /* where it is */
    double amplitude_per_unit;          /* m/s^2 of A per unit of what excites it (m/s for a tap, 1 for a rupture) */
    double force_per_unit;              /* N of coefficient per the same unit; 0: nothing is struck */
    double gain_re;
    double gain_im;
    double tail_rotor_re; /* exp((-B' + i w') T) */
    double tail_rotor_im;
    double tail_decay_rate_per_s;            /* B' */
    double tail_angular_frequency_rad_per_s; /* w' */
    double tail_end_s;                       /* 5/B'; 0: there is no tail */
    double tail_re;
    double tail_im;
    double touched_n_per_m; /* gain, tail and peak are for a surface of this stiffness; 0: for any */
    double free_peak;       /* where nothing is touched: straight lines between, by what is touched in fact */
    double free_gain_re;
    double free_gain_im;
    double free_tail_re;
    double free_tail_im;
    double kicks[2 * HD_KICKS]; /* c, d of each of the first samples: plus c + d x, the onset x T before the first */
    uint32_t kick_count;        /* 0 or HD_KICKS */
    uint32_t reserved;
    uint32_t effect; /* id of the hd_device_effect that a device may play instead; 0: none */
    uint32_t unused;
    double effect_force_per_unit; /* N of coefficient per the same unit, where the effect is played */
    double effect_peak;           /* the largest level of the effect over the coefficient */
    double effect_s;              /* so long it plays */
};

/* How a texture is displayed. */
enum hd_texture {
    HD_TEXTURE_NONE = 0,
    HD_TEXTURE_STRIKES = 1,  /* grooves, each passage strikes the groove mode along the motion */
    HD_TEXTURE_GEOMETRY = 2, /* grooves, the surface is lowered by a raised cosine */
    HD_TEXTURE_DRAG = 3,     /* grooves, a viscous force against tangential motion */
    HD_TEXTURE_NOISE = 4     /* coloured noise */
};

#define HD_TAP_POINTS 256
#define HD_TUNE_POINTS 16 /* of a groove's frequency over the speed, and over the force; of a tap's mode */
#define HD_TUNE_NODES 64  /* of its compensation over the frequency, */
#define HD_TUNE_NODE 11   /* each of so many numbers */
#define HD_WAVE_SAMPLES 512
#define HD_WAVE_PARTS 8

/* What a surface is made of. Between the points of a tap's amplitude lie straight lines, from rest, where it is 0, to
 * the first point, and beyond the last one as the line before it, never below 0. */
struct hd_material {
    uint32_t texture;      /* enum hd_texture */
    uint32_t noise;        /* index in the table's noises, for HD_TEXTURE_NOISE; else 0 */
    uint32_t heals;        /* membranes: closes again when the probe withdraws */
    uint32_t tap_count;    /* points of the tap's amplitude over the approach speed, up to HD_TAP_POINTS; 0: a slope */
    uint32_t tap_first;    /* index in the table's numbers: speeds [tap_count], m/s, rising; amplitudes [tap_count] */
    uint32_t tune_speeds;  /* points of the groove's frequency over the speed, see hd_numbers.h; 0: it is the mode's */
    uint32_t tune_forces;  /* the same over the force */
    uint32_t tune_nodes;   /* of its compensation; 0: there is none */
    uint32_t tune_first;   /* index in the table's numbers */
    uint32_t tune_mutes;   /* a strike above tune_highest_rad_per_s is 0: lowered to that, 1: silent */
    uint32_t mode_count;   /* points of the tap's mode over the approach speed, see hd_numbers.h; 0: it is one */
    uint32_t mode_nodes;   /* of its compensation; 0: there is none */
    uint32_t mode_first;   /* index in the table's numbers */
    uint32_t mode_by_peak; /* 1: what the tap is struck with is the first peak, 0: the coefficient */
    uint32_t wave_count;   /* samples of the tap's waveform, 3 to HD_WAVE_SAMPLES, see hd_waveform.h; 0: it rings */
    uint32_t wave_first;   /* index in the table's numbers */
    double stiffness_n_per_m;
    double damping_n_s_per_m;
    double rupture_depth_m;            /* membranes; 0: never ruptures */
    double friction_coefficient;       /* 0: no friction */
    double friction_stiffness_n_per_m; /* more than 0 where there is friction */
    double spacing_m;                  /* grooves; more than 0 where there are any */
    double width_m;
    double depth_m;                   /* HD_TEXTURE_GEOMETRY */
    double drag_n_s_per_m;            /* HD_TEXTURE_DRAG */
    double velocity_gain_per_s;       /* HD_TEXTURE_STRIKES: A = velocity gain |v_t| + force gain F_n */
    double force_gain_m_per_s2_per_n; /* the same */
    double tune_highest_rad_per_s;
    double wave_rate_hz;    /* samples a second */
    double tap_aim[2];      /* where a tap pushes first: along n and along t, of length 1; 0, 0: along n */
    double rupture_aim[2];  /* the same of a rupture, n on the side entered */
    struct hd_mode tap;     /* per m/s of approach; per m/s^2 of A where tap_count is not 0. Of a waveform only its end,
                               its peak and the units count */
    struct hd_mode second;  /* struck together with the tap, in its unit; none with a force per unit of 0 */
    struct hd_mode rupture; /* per rupture */
    struct hd_mode groove;  /* per m/s^2 of A */
};

#define HD_NOISE_ORDER 32 /* the highest of a filter */

/* Coloured noise of unit power out of a normalised lattice, times an RMS acceleration that follows tangential speed and
 * normal force:
 *
 *     rms(v, F) = max(0, velocity gain |v| + force gain F + grid(v, F)) min(1, |v| / threshold)
 *
 * `numbers[first]` and on: speeds [speed_count], forces [force_count], both strictly rising, then the nodes of the grid
 * [speed_count][force_count], each of them
 *     rms (m/s^2), reflection coefficients k_1 .. k_order [order], ladder taps v_0 .. v_order [taps ? order + 1 : 0].
 * Between nodes everything is interpolated (bilinear), beyond the outermost it stays. |k| < 1; the squares of the taps
 * of a node add up to one. Without taps the output is that of the all-pole lattice. */
struct hd_noise {
    uint32_t order;        /* 0 (white) to HD_NOISE_ORDER */
    uint32_t taps;         /* 0 or 1 */
    uint32_t along_normal; /* 0: acts along the tangent, 1: along the normal */
    uint32_t speed_count;  /* at least 1 */
    uint32_t force_count;  /* at least 1 */
    uint32_t first;        /* index in the table's numbers */
    uint32_t version;      /* raised whenever anything of it changes but `first`. Numbers are never reused. */
    uint32_t unused;
    uint64_t seed;
    double threshold_m_per_s; /* at least 0 */
    double velocity_gain_per_s;
    double force_gain_m_per_s2_per_n;
    double force_per_unit; /* N per m/s^2; 0: silent */
};

/* Where one material of a wall ends and the next begins, along the wall's tangential coordinate s. The first piece of a
 * wall has no beginning (from_m is 0 and unused); the others are in rising order. Around from_m, from half_ramp_m
 * before it to half_ramp_m after it, one material goes over into the other. Ramps of a wall do not overlap. */
struct hd_piece {
    double from_m;
    double half_ramp_m; /* more than 0, except for the first */
    uint32_t material;
    uint32_t unused;
};

enum hd_shape {
    HD_SHAPE_NONE = 0, /* the slot is free */
    HD_SHAPE_WALL = 1,
    HD_SHAPE_MEMBRANE = 2,
    HD_SHAPE_BOX = 3,
    HD_SHAPE_DISC = 4
};

/* An object, at the place in the table's array that is its slot. `generation` is raised whenever the slot gets another
 * object or another kind, `pose_version` whenever point, normal or half change, `surface_version` whenever its
 * materials change, in themselves or for others. Numbers are never reused. */
struct hd_object {
    uint32_t generation;
    uint32_t pose_version;
    uint32_t surface_version;
    uint32_t shape;       /* enum hd_shape */
    uint32_t material;    /* index in the table's materials */
    uint32_t piece_first; /* walls with patches: in the table's pieces */
    uint32_t piece_count; /* 0: all of one material; else at least 2 */
    uint32_t unused;
    double point_m[2]; /* wall: a point of the surface, where s is 0; others: the centre */
    double normal[2];  /* unit. wall: out of the solid; membrane: across; box: out of its upper face; disc: (0, 1) */
    double half_m[2];  /* membrane: half its width, 0; box: half its extent along (n_y, -n_x) and along n; disc: radius,
                          radius; wall: 0, 0 */
};

#define HD_PASSIVITY_AGE_MAX 512 /* the oldest reports that the passivity observer understands, in periods */

/* Whether the energy that the objects give to the hand is watched: see hd_passivity.h. */
enum hd_passivity_mode { HD_PASSIVITY_OFF = 0, HD_PASSIVITY_OBSERVE = 1, HD_PASSIVITY_CONTROL = 2 };

/* All fields of a scene are one affine law: F = force - stiffness p - damping v. */
struct hd_field {
    double force_n[2];
    double stiffness_n_per_m;
    double damping_n_s_per_m;
};

struct hd_table {
    uint32_t revision;
    uint32_t object_count; /* slots in the array, free ones too */
    uint32_t material_count;
    uint32_t piece_count;
    uint32_t noise_count;
    uint32_t number_count;
    uint32_t display_force;     /* 0 or 1 */
    uint32_t display_vibration; /* 0 or 1 */
    uint32_t field_version;     /* raised whenever the field changes */
    uint32_t parts_version;     /* raised whenever materials, pieces, noises or numbers change */
    uint32_t changed_count;     /* slots whose record changed since the table that was published before this one, */
    uint32_t all_changed;       /* or 1: take them all as changed */
    uint32_t passivity;         /* enum hd_passivity_mode */
    uint32_t report_age;        /* of a position against the force that acts, in periods, where it is known */
    double period_s;
    double max_force_n;       /* magnitude of the whole command */
    double max_speed_m_per_s; /* a step between two samples that implies more is a glitch */
    double rearm_m;           /* a surface is tapped again when the probe was so far from it; 0: always */
    double ramp_s;
    double ramp_step;                /* period_s / ramp_s: what a ramp moves on in a tick */
    double brake_n_s_per_m;          /* the passivity controller brakes by no more */
    double handle_damping_n_s_per_m; /* of the handle itself, as far as it is known */
    double handle_friction_n;        /* the same, per axis */
    struct hd_field field;
    struct hd_object *objects;
    struct hd_material *materials;
    struct hd_piece *pieces;
    struct hd_noise *noises;
    double *numbers;
    uint32_t *changed;
};

/* ---- What a tick gives --------------------------------------------------------------------------------------- */

enum hd_flag {
    HD_FLAG_SKIPPED = 1,      /* periods were missed before this tick */
    HD_FLAG_CONTACT = 2,      /* something is touched */
    HD_FLAG_RINGING = 4,      /* a mode sounds */
    HD_FLAG_SATURATED = 8,    /* the force limit changed the command or scaled a strike */
    HD_FLAG_RAMPING = 16,     /* a ramp is under way */
    HD_FLAG_FORCES_ON = 32,   /* forces are enabled */
    HD_FLAG_FAULT = 64,       /* a fault is latched */
    HD_FLAG_GLITCH = 128,     /* the position jumped; contacts were resynchronised */
    HD_FLAG_REPEATED = 256,   /* no new sample came from the device */
    HD_FLAG_RESTRAINED = 512, /* the passivity controller changed the contact force */
    HD_FLAG_CHECKING = 1024   /* the signs of the device are checked: the force is the check's, none the scene's */
};

/* One tick as telemetry carries it.
 *
 * contact_force_n: what touched objects push with (stiffness, damping, friction, and grooves that are displayed as
 * geometry or damping), what is left of objects that went away while touched, and the fields. vibration_force_n:
 * ringing modes (taps, grooves displayed as vibration, ruptures, play) and the noise of textures; not what the device
 * plays by itself. Both are weighed by the ramps of the display flags, and the contact force is as the passivity
 * controller left it; neither is cut by the force limit yet, nor weighed by the gain that set_forces and faults fade. A
 * strike was scaled when it was struck, noise by what the limit leaves it, and modes that the limit lowered go on
 * lowered in the next tick. */
struct hd_sample {
    uint64_t tick;
    int64_t time_ns; /* the deadline of this tick */
    double position_m[2];
    double velocity_m_per_s[2];
    double contact_force_n[2];   /* objects and fields, after the passivity controller, before the limit */
    double vibration_force_n[2]; /* modes and noise, before the limit */
    double force_n[2];           /* the command, after every limit */
    uint32_t revision;
    uint32_t flags;
    int32_t lateness_ns; /* wake-up after the deadline, saturating */
    int32_t work_ns;     /* from wake-up to the force handed over, saturating */
};

enum hd_event_kind {
    HD_EVENT_CONTACT = 1,
    HD_EVENT_RELEASE = 2,
    HD_EVENT_PUNCTURE = 3,
    HD_EVENT_SATURATION = 4, /* value: the command that was wanted, N; once a contiguous stretch */
    HD_EVENT_OVERRUN = 5,    /* value: periods missed */
    HD_EVENT_FAULT = 6,      /* code: the faults latched now (0: cleared) */
    HD_EVENT_REVISION = 7,   /* code: the revision in force from this tick on */
    HD_EVENT_GLITCH = 8,     /* value: the speed that the jump implied, m/s */
    HD_EVENT_DEVICE_LOST = 9,
    HD_EVENT_DEVICE_FOUND = 10,
    HD_EVENT_GROOVE = 11,         /* speed: tangential, signed along t; value: grooves struck in this contact so far */
    HD_EVENT_OVERLOAD = 12,       /* value: part of the last second's periods that were missed, above the threshold */
    HD_EVENT_RATE = 13,           /* value: the servo's rate from this tick on, Hz */
    HD_EVENT_RESUMED = 14,        /* value: how long the machine was suspended, s */
    HD_EVENT_MEMORY_REFUSED = 15, /* code: errno; from this table on not all memory is locked */
    HD_EVENT_MARK = 16,           /* code: the command's value */
    HD_EVENT_GESTURE_END = 17 /* value: the tick that took the path; code: 1 through, 0 another one took its place */
};

struct hd_event {
    uint64_t tick;
    double before_tick_s; /* how long before the tick's time it happened */
    int64_t time_ns;      /* the tick's time */
    uint32_t kind;
    uint32_t code;
    uint32_t slot; /* HD_NO_SLOT where no object is meant */
    uint32_t generation;
    double speed_m_per_s;      /* along the normal, as estimated at the onset */
    double true_speed_m_per_s; /* the simulated handle's own; NaN on a real device */
    double amplitude_m_per_s2; /* of the strike, before scaling; 0: none */
    double scale;              /* what the limit left of the strike, 0 to 1 */
    double value;
};

/* The code of a contact event without an onset: the object appeared, or was met anew. */
#define HD_CONTACT_SILENT 1

#define HD_NO_SLOT 4294967295
#define HD_PLAY_SLOT 4294967294

enum hd_fault {
    HD_FAULT_NONFINITE = 1, /* NaN or infinity in a sample or in a force */
    HD_FAULT_CONTROL = 2,   /* the thread that serves commands did not beat for a second */
    HD_FAULT_LEASE = 4,     /* a lease was not renewed in time */
    HD_FAULT_DEVICE = 8,    /* the device does not report */
    HD_FAULT_OVERRUN = 16,  /* too many periods were missed */
    HD_FAULT_FROZEN = 32,   /* the device reports the same position all the time, under force */
    HD_FAULT_SIGNS = 64     /* the check of the device's signs found them wrong, or nothing */
};

/* ---- Memory -------------------------------------------------------------------------------------------------- */

/* From now on a block of `bytes` or more has pages of its own, from all threads, and gives them back when it is freed.
 * A C library without such a limit is left as it is. HD_ERR_INVALID: more than malloc takes. */
int hd_memory_large_from(size_t bytes);

/* ---- Sockets ------------------------------------------------------------------------------------------------- */

/* Sends `head` and `data` behind it to each of `count` connected stream sockets, without waiting. taken[i]: how many
 * bytes socket i took, or a negative errno. */
void hd_send_each(const int32_t *sockets, size_t count, const void *head, size_t head_size, const void *data,
                  size_t data_size, int64_t *taken);

/* ---- The end by a fault -------------------------------------------------------------------------------------- */

/* From now on SIGABRT, SIGSEGV, SIGBUS, SIGILL and SIGFPE first have what hd_last_report_keep was told written to the
 * device, then do what they did before. The reports come one after the other in `reports`, zero first; the device is
 * known by a descriptor of the core's own until hd_last_report_drop, or another hd_last_report_keep. HD_ERR_INVALID:
 * too much, or no descriptor is left; what was kept stays. Control. */
void hd_last_report_arm(void);
int hd_last_report_keep(int fd, const uint8_t *reports, const uint32_t *lengths, uint32_t count, double pause_s);
void hd_last_report_drop(void);

/* ---- State and offline rendering ----------------------------------------------------------------------------- */

struct hd_state; /* opaque */

/* Zeroed state with room for `slot_capacity` objects, forces on; NULL without memory. */
struct hd_state *hd_state_new(uint32_t slot_capacity);
void hd_state_free(struct hd_state *state);
/* Encoder step that the velocity estimator assumes; 0: positions are exact. */
void hd_state_set_resolution(struct hd_state *state, double step_m);
/* Forces on or off: the command comes in or fades out over the table's ramp. */
void hd_state_enable(struct hd_state *state, int enabled);
/* The whole command is zero from here on; it comes in over the table's ramp, as when a servo starts. */
void hd_state_mute(struct hd_state *state);
/* All that the next tick reads, into a state of the same capacity; HD_ERR_INVALID otherwise. To try a tick. */
int hd_state_copy(struct hd_state *to, const struct hd_state *from);
/* Clears the contact state of a slot, if it has this generation, or of all (HD_NO_SLOT), at the next tick's time. */
void hd_state_reset(struct hd_state *state, uint32_t slot, uint32_t generation, int64_t time_ns);
uint32_t hd_state_faults(const struct hd_state *state);
/* The latest contact state of a slot: bit 0 touched, bit 1 punctured. */
uint32_t hd_state_slot(const struct hd_state *state, uint32_t slot);

/* What the objects gave to the hand, as far as the passivity observer saw it. */
struct hd_energy {
    double energy_j;     /* in this contact, or in the last one; below zero: the hand gave more than it got */
    double largest_j;    /* that it ever was in a contact */
    uint64_t contacts;   /* from the first touch to the last release */
    uint64_t restrained; /* of them, those in which the controller acted */
    uint64_t acted;      /* ticks in which it did */
};

void hd_state_energy(const struct hd_state *state, struct hd_energy *energy);

/* A world is a table as C owns it: checked, copied, and with an index that finds what is near. */
struct hd_world; /* opaque */

struct hd_world *hd_world_new(void); /* NULL without memory */
void hd_world_free(struct hd_world *world);
/* Takes a table whole. HD_ERR_INVALID (hd_invalid_reason) and HD_ERR_MEMORY leave the world as it was. */
int hd_world_load(struct hd_world *world, const struct hd_table *table);
/* Until the next load, ramps stand still in it: what a tick would do if none were under way. */
void hd_world_still(struct hd_world *world);
/* The slots of what lies within `radius_m` of a point, or may: nothing nearer is missing. Up to `capacity` of them; how
 * many there were, or SIZE_MAX without memory. For tests and benchmarks of the index. */
size_t hd_world_candidates(const struct hd_world *world, const double point_m[2], double radius_m, uint32_t *slots,
                           size_t capacity);

/* Why the last check on this thread failed, as one line. */
const char *hd_invalid_reason(void);

/* Renders `count` positions, one a tick, [count][2]. `velocity` is [count][2], or NULL to estimate it. `periods` is
 * [count], periods since the tick before, or NULL for 1 each. Up to `event_capacity` events are kept; *event_count
 * says how many there were. Ticks go on counting from the state's last. */
int hd_render(const struct hd_world *world, struct hd_state *state, const double *position, const double *velocity,
              const uint32_t *periods, size_t count, struct hd_sample *samples, struct hd_event *events,
              size_t event_capacity, size_t *event_count);

/* Renders ticks of a servo again, from what its samples say that each was told: tick, time, position, velocity, whether
 * forces were on, whether the position jumped. `interval_s` is [count], between the report of this tick and the one
 * before (0: no new report), `periods` [count], since the tick before. Ticks only grow. Events as in hd_render. */
int hd_replay(const struct hd_world *world, struct hd_state *state, const struct hd_sample *recorded,
              const double *interval_s, const uint32_t *periods, size_t count, struct hd_sample *samples,
              struct hd_event *events, size_t event_capacity, size_t *event_count);

/* The estimator alone: `interval_s` [count] since the sample before, `position` [count][2]; out [count][2], and
 * half the width of the set of speeds consistent with the samples, [count][2], where `half_width` is not NULL. */
int hd_velocity_run(double step_m, size_t count, const double *interval_s, const double *position, double *velocity,
                    double *half_width);

/* One noise alone, as a touched surface makes it: `speed` [count] (tangential, m/s) and `force` [count] (normal, N)
 * give `out` [count], the acceleration in m/s^2 before force_per_unit. HD_ERR_INVALID as for a table. */
int hd_noise_run(const struct hd_noise *noise, const double *numbers, uint32_t number_count, size_t count,
                 const double *speed, const double *force, double *out);

/* ---- The simulated joystick ------------------------------------------------------------------------------------ */

#define HD_SIM_FORCES 16 /* under way to the actuator */

struct hd_sim_config {
    double handle_mass_kg;
    double handle_damping_n_s_per_m;
    double coulomb_friction_n; /* per axis */
    double encoder_step_m;     /* 0: exact */
    double max_force_n;        /* per axis: what the actuator gives at most */
    double force_step_n;       /* its resolution; 0: exact */
    double report_interval_s;  /* 0: a report at every servo period */
    double report_delay_s;
    double force_interval_s;  /* 0: a put acts at once; else forces act at multiples of this time, as by a link */
    uint32_t force_intervals; /* at which of them after the put: 1 to HD_SIM_FORCES; the newest put wins */
    uint32_t unused;
    double workspace_m;     /* half the travel, per axis; inelastic stops */
    double force_timeout_s; /* the force expires by itself this long after the last put has come to act */
    double hand_mass_kg;
    double hand_stiffness_n_per_m;
    double hand_damping_n_s_per_m;
    double start_m[2];
    double actuator_rate_per_s;    /* of its lag, 2 pi times its natural frequency */
    double actuator_damping_ratio; /* of second order */
    uint32_t actuator_order;       /* 0: the force acts at once; 1 or 2: it lags */
    uint32_t reserved;
};

enum hd_interpolation { HD_LINEAR = 0, HD_MINIMUM_JERK = 1 };

/* What one look at a device gives. */
struct hd_reading {
    double position_m[2];
    double interval_s;               /* between this report and the one before; 0: no new report */
    double true_velocity_m_per_s[2]; /* NaN where nobody knows */
};

struct hd_sim;      /* opaque */
struct hd_operator; /* opaque: where the hand wants to be, over time; immutable */

/* `waypoints` [count][3]: t_s, x_m, y_m, strictly rising times, copied. NULL: invalid (hd_invalid_reason) or no memory.
 */
struct hd_operator *hd_operator_new(const double *waypoints, size_t count, enum hd_interpolation interpolation);
void hd_operator_free(struct hd_operator *path);
/* NULL: invalid (hd_invalid_reason) or no memory. */
struct hd_sim *hd_sim_new(const struct hd_sim_config *config, double period_s);
void hd_sim_free(struct hd_sim *sim);
/* The hand follows `path` from now on; before its first waypoint it goes there in a straight line from where it wants
 * to be now (at t_s = 0 it is there at once). The caller keeps `path` alive as long as the simulation uses it. */
void hd_sim_operate(struct hd_sim *sim, const struct hd_operator *path);
/* The handle jumps, at rest, to the hand's first reference: for a run that starts with an operator. */
void hd_sim_settle(struct hd_sim *sim);
/* The actuator holds this force (limited, rounded), at once or when the link has carried it, until the next one or
 * until it expires. */
void hd_sim_put(struct hd_sim *sim, const double force_n[2]);
/* Time goes on by `periods` servo periods. */
void hd_sim_advance(struct hd_sim *sim, uint32_t periods);
void hd_sim_read(struct hd_sim *sim, struct hd_reading *reading);
/* The handle itself: position [2], velocity [2], force of the actuator [2]. */
void hd_sim_truth(const struct hd_sim *sim, double position[2], double velocity[2], double force[2]);
/* The handle is there now and moves so; hand, force and reports stay as they are. HD_ERR_INVALID: not finite, beyond
 * the stops, or faster than 1e6 m/s. */
int hd_sim_place(struct hd_sim *sim, const double position[2], const double velocity[2]);
/* Time goes on in periods of this length; nothing is under way to the actuator, reports begin anew. The hand goes on
 * where it is. HD_ERR_INVALID. */
int hd_sim_set_period(struct hd_sim *sim, const struct hd_sim_config *config, double period_s);
/* `count` periods, each under its force of `force` [count][2]; `motion` [count][4] is position and velocity at the
 * beginning of each, before its force is put. */
void hd_sim_drive(struct hd_sim *sim, const double *force, size_t count, double *motion);

/* Closed loop without clock: `count` ticks of table, state and sim. `truth` [count][4] (true position, velocity) or
 * NULL. */
int hd_simulate(const struct hd_world *world, struct hd_state *state, struct hd_sim *sim, size_t count,
                struct hd_sample *samples, double *truth, struct hd_event *events, size_t event_capacity,
                size_t *event_count);
/* Strikes a mode at the next tick of a run, as the command `play` does. HD_ERR_INVALID (hd_invalid_reason);
 * HD_ERR_FULL: enough for this tick. */
int hd_play(struct hd_state *state, const struct hd_mode *mode, const double direction[2], double amplitude);

/* ---- HID devices ------------------------------------------------------------------------------------------------ */

#define HD_HID_REPORT_BYTES 256 /* the longest report, with its id */
#define HD_HID_MESSAGES 24      /* of one script */
#define HD_DEVICE_EFFECTS 8     /* effects that a device plays by itself */
#define HD_DEVICE_EFFECT_MESSAGES 4
#define HD_HID_VALUES 4 /* numbers written into one message */
#define HD_HID_STATES 8
#define HD_HID_EFFECTS 4 /* whose playing is watched */

/* Where a number lies in a report. Bits are counted as HID counts them: from the lowest bit of the first byte after the
 * report id; `big_endian` numbers are whole bytes, the first one the highest. */
struct hd_hid_field {
    uint32_t bit_offset;
    uint32_t bit_size; /* 1 to 32 */
    uint32_t is_signed;
    uint32_t big_endian;
};

/* One axis: position = (counts - zero_counts) * m_per_count. */
struct hd_hid_axis {
    struct hd_hid_field field;
    uint32_t report_id; /* 0: reports are not numbered */
    uint32_t unused;
    double zero_counts;
    double m_per_count; /* its sign is the axis's */
};

/* What a number in an output report says of the force F (newton, x to the right, y up). */
enum hd_hid_quantity {
    HD_HID_X = 1,         /* F_x */
    HD_HID_Y = 2,         /* F_y */
    HD_HID_MAGNITUDE = 3, /* |F| */
    HD_HID_DIRECTION = 4  /* where F comes from, radians clockwise from +y, 0 to 2 pi: HID's north is up */
};

/* counts = quantity * counts_per_unit + zero_counts, rounded to nearest, limited to least .. most, which hold
 * zero_counts; HD_HID_DIRECTION is taken modulo a full turn instead where that lies within them. HD_HID_X and HD_HID_Y
 * take the other axis's force times counts_per_other_n, too: what two effects push whose directions, whole counts, are
 * not quite along the axes. */
struct hd_hid_value {
    struct hd_hid_field field;
    uint32_t quantity; /* enum hd_hid_quantity */
    uint32_t unused;
    double counts_per_unit;
    double zero_counts;
    double least;
    double most;
    double counts_per_other_n;
};

/* An output report: bytes as they are, report id first (0 where reports are not numbered), with numbers written into
 * it. */
struct hd_hid_message {
    uint32_t length; /* with the id */
    uint32_t value_count;
    struct hd_hid_value values[HD_HID_VALUES];
    uint8_t bytes[HD_HID_REPORT_BYTES];
};

struct hd_hid_script {
    uint32_t count;
    uint32_t unused;
    struct hd_hid_message messages[HD_HID_MESSAGES];
};

/* A number in an input report that says how the device is. */
enum hd_hid_meaning {
    HD_HID_RESET = 1,     /* the device was reset: its effects are gone */
    HD_HID_ACTUATORS = 2, /* actuators enabled; 0: they are off, by the device or by another driver */
    HD_HID_PAUSED = 3,    /* once it was not paused, no force is sent while it is */
    HD_HID_SAFETY = 4,    /* safety switch closed; 0: the device keeps its actuators off until it is */
    HD_HID_POWER = 5      /* actuator power */
};

struct hd_hid_state {
    struct hd_hid_field field;
    uint32_t report_id;
    uint32_t meaning; /* enum hd_hid_meaning */
};

/* Where an input report says which effect it speaks of, and whether that plays. An effect of ours that played, then did
 * not, and does not play again although it was renewed, is one that the device has forgotten: it was reset. Some
 * devices do not heed renewals in what they report, so that is believed of a device once; and always where effects were
 * seen to play on over `proof` renewals, which takes longer than their duration. */
struct hd_hid_effects {
    struct hd_hid_field index;
    struct hd_hid_field playing;
    uint32_t report_id;
    uint32_t count; /* of indices; 0: nothing is watched */
    uint32_t indices[HD_HID_EFFECTS];
    uint32_t proof; /* at least 1 */
    uint32_t unused;
};

/* The check of a device's signs before the first force of the scene: see hd_signs.h. */
struct hd_hid_signs {
    uint32_t number; /* of this device and its configuration, checked once; 0: they are trusted */
    uint32_t axes;   /* that are checked: bit 0 x, bit 1 y */
    double force_n;  /* of a pulse */
    double least_m;  /* a handle that moved by less, on average over a pulse, was not moved by it */
    double enough_m; /* a pulse ends early once the handle is so far away */
};

/* What a connection does, compiled once. Checked by hd_hid_connect; the caller may forget it then. */
struct hd_hid_plan {
    struct hd_hid_axis axes[2]; /* x, y */
    struct hd_hid_script begin; /* sent once, before the first force; no force */
    struct hd_hid_script force; /* sent for each new force, in this order; a message that did not change is left out */
    struct hd_hid_script renew; /* sent every renew_ns while connected: restarts effects of finite duration, keeps
                                   watchdogs quiet; force values may stand in it */
    struct hd_hid_script restore; /* what another program may have changed of the effects: one message every restore_ns,
                                     in turn, after the forces; not to a device that says that they play */
    struct hd_hid_script stop;    /* sent when the connection is closed in an orderly way, after a force of zero */
    struct hd_hid_effects effects;
    struct hd_hid_state states[HD_HID_STATES];
    struct hd_hid_signs signs;
    uint32_t state_count;
    uint32_t on_change;        /* the device reports only what changes: silence says nothing */
    int64_t renew_ns;          /* the force messages are sent again, too; 0: never */
    int64_t restore_ns;        /* 0: never */
    int64_t write_interval_ns; /* between two writes at least, up to 0.1 s, shorter at the end: the endpoint's interval;
                                  0: as fast as they are taken */
};

/* A mode as the device plays it by itself: a periodic effect of finite length, which nothing renews. */
struct hd_device_effect {
    uint32_t id;            /* not 0; of this mode on this device, never reused for another one */
    uint32_t place;         /* of the device's effect, below HD_DEVICE_EFFECTS: each is one mode at a time */
    uint32_t message_count; /* 1 to HD_DEVICE_EFFECT_MESSAGES */
    uint32_t unused;
    int64_t duration_ns;                                       /* up to 0.2 s */
    double least_n;                                            /* a coefficient below this is nothing to the device */
    double most_n;                                             /* one beyond it is played as this */
    struct hd_hid_message messages[HD_DEVICE_EFFECT_MESSAGES]; /* their force is the coefficient, as a vector. The last
                                                               one starts it; the others are left out where they did not
                                                               change */
    struct hd_hid_message stop;                                /* without numbers */
};

struct hd_device_effects {
    uint32_t count;
    uint32_t unused;
    struct hd_device_effect effects[HD_DEVICE_EFFECTS];
};

/* What is known of a connection; each number is read on its own. */
struct hd_hid_status {
    uint32_t connected;    /* both threads run */
    int32_t error;         /* errno of what ended it; 0: none */
    uint32_t reset;        /* the device has said, since hd_hid_connect, that it was reset, or that its actuators went
                              off, or it has forgotten an effect: set it up again */
    uint32_t states;       /* bit (meaning - 1): the number is not 0 */
    uint32_t states_known; /* bit (meaning - 1): a report has said it */
    uint32_t effects_told; /* the device has said, since hd_hid_connect, that an effect of ours plays: it would say that
                              one is gone */
    uint64_t reports;      /* input reports read, of any id; what they said is in the other numbers, and published */
    uint64_t positions;    /* of them, positions */
    uint64_t short_reports; /* too short for what the plan reads of them: ignored */
    uint64_t writes;
    uint64_t forces;           /* forces that were sent; those that were overtaken are not */
    int64_t write_ns;          /* how long writes take: running mean; 0: not known yet */
    int64_t write_interval_ns; /* between forces sent, where they follow one another: running mean; 0: not known yet */
    int64_t last_report_ns;
    uint64_t strikes;      /* that the device was told to play by itself */
    uint64_t strikes_lost; /* too late, overtaken by a silence, of an effect that is gone, or without room */
};

/* What hd_hid_connect checks of a plan: HD_OK, or HD_ERR_INVALID (hd_invalid_reason). */
int hd_hid_check(const struct hd_hid_plan *plan);

struct hd_hid; /* opaque: two mailboxes and, while connected, two threads */

struct hd_hid *hd_hid_new(void); /* NULL without memory */
/* Ends the connection as hd_hid_disconnect does, then frees. */
void hd_hid_free(struct hd_hid *hid);
/* Starts a connection over `fd`, a hidraw node (or anything that keeps message bounds, as SOCK_SEQPACKET does), open
 * for reading and writing. Reports that wait there already tell where the handle is and how the device is; nothing in
 * them counts as a reset. The first force is zero. The descriptor stays the caller's. `priority`: of both threads, 0
 * none. HD_ERR_INVALID (hd_invalid_reason; also while there is a connection), HD_ERR_MEMORY, HD_ERR_SYSTEM (errno);
 * HD_ERR_DENIED: threads of this priority are refused. One thread at a time connects, disconnects and frees. */
int hd_hid_connect(struct hd_hid *hid, const struct hd_hid_plan *plan, int fd, int priority);
/* Ends both threads. `orderly`: a force of zero and the stop script are written first, within 0.5 s; an error that ends
 * a connection has the same written, as far as the device takes it. A device that does not take what is being written
 * in that time is given up, ETIMEDOUT; the descriptor may be closed all the same. Returns 0 or the errno that writing
 * them met, or that had ended the connection before. */
int hd_hid_disconnect(struct hd_hid *hid, int orderly);
/* What the device plays by itself from now on, in this connection; each one begins without any. Strikes of modes that
 * name one of these effects are no voices of the tick then, but are sent to the device while forces and vibration are
 * fully on; what plays is stopped when they no longer are. Copied. HD_ERR_INVALID (hd_invalid_reason); without a
 * connection it does nothing. Not at the same time as hd_hid_connect or hd_hid_disconnect. */
int hd_hid_set_effects(struct hd_hid *hid, const struct hd_device_effects *effects);
void hd_hid_status(const struct hd_hid *hid, struct hd_hid_status *status);
/* Blocks until the connection ends by itself, a reset is seen, hd_hid_wake is called or the time is over; 1: something
 * happened, perhaps before this call, but after the last one that said so. */
int hd_hid_wait(struct hd_hid *hid, int64_t timeout_ns);
void hd_hid_wake(struct hd_hid *hid);
/* As if the device had said that it was reset: it gets no force until it is set up again. */
void hd_hid_suspect(struct hd_hid *hid);
/* The last set-up answered what was reset: looks at it as normal from now on. While `reset` stands the device gets no
 * force; afterwards the force comes back over 20 ms. */
void hd_hid_clear_reset(struct hd_hid *hid);

/* Pack and unpack, for tests and for set-up. `report` holds `length` bytes, its id first. HD_ERR_INVALID: the field
 * does not lie within it, or a count does not fit. */
int hd_bits_get(const struct hd_hid_field *field, const uint8_t *report, size_t length, int64_t *counts);
int hd_bits_put(const struct hd_hid_field *field, uint8_t *report, size_t length, int64_t counts);
/* What `message` becomes with this force, for tests. */
void hd_hid_compose(const struct hd_hid_message *message, const double force_n[2], uint8_t *bytes);

/* ---- The check of signs ------------------------------------------------------------------------------------------ */

enum hd_signs_state {
    HD_SIGNS_UNCHECKED = 0, /* forces have not been on */
    HD_SIGNS_TRUSTED = 1,   /* by the configuration */
    HD_SIGNS_CHECKING = 2,
    HD_SIGNS_WAITING = 3, /* for what `problem` says to end */
    HD_SIGNS_RIGHT = 4,
    HD_SIGNS_WRONG = 5,  /* no force until the device is another one */
    HD_SIGNS_UNCLEAR = 6 /* no force until somebody turns forces on again, which begins the check again */
};

enum hd_signs_problem {
    HD_SIGNS_FINE = 0,
    HD_SIGNS_REVERSED = 1,  /* the handle moves the other way */
    HD_SIGNS_SWAPPED = 2,   /* it moves along the other axis */
    HD_SIGNS_STILL = 3,     /* it does not move */
    HD_SIGNS_UNCERTAIN = 4, /* the pulses do not agree */
    HD_SIGNS_MOVING = 5,    /* it does not rest, so that nothing is pushed */
    HD_SIGNS_CONTACT = 6    /* something of the scene is touched, so that nothing is pushed */
};

/* State, problem and axis in one number. */
#define HD_SIGNS_PROBLEM_SHIFT 8
#define HD_SIGNS_AXIS_SHIFT 16

/* What a tick of the check is told. */
struct hd_signs_input {
    double position_m[2];
    double elapsed_s; /* since the tick before */
    double gain;      /* of the scene's force, which fades out first */
    double max_force_n;
    double ramp_s;
    uint32_t enabled; /* forces are wanted */
    uint32_t contact; /* something is touched */
    uint32_t jumped;  /* where the handle was says nothing about where it is */
    uint32_t unused;
};

/* The check without a servo, for tests: one tick, its force, and what hd_counters.signs says after it. */
struct hd_signs; /* opaque */
struct hd_signs *hd_signs_new(void);
void hd_signs_free(struct hd_signs *signs);
uint32_t hd_signs_try(struct hd_signs *signs, const struct hd_hid_signs *of, const struct hd_signs_input *input,
                      double force_n[2]);

/* ---- The servo --------------------------------------------------------------------------------------------------- */

enum hd_realtime { HD_REALTIME_OFF = 0, HD_REALTIME_PREFERRED = 1, HD_REALTIME_REQUIRED = 2 };

/* What says that a tick is due. HD_CLOCK_DEVICE: each position of a HID device, at most one tick a period; the timer
 * goes on where none comes for two and a half periods. */
enum hd_clock_source { HD_CLOCK_TIMER = 0, HD_CLOCK_DEVICE = 1 };

struct hd_servo_config {
    double rate_hz;
    int32_t cpu; /* -1: any */
    int32_t priority;
    int32_t realtime; /* enum hd_realtime */
    uint32_t slot_capacity;
    uint32_t sample_capacity; /* of the telemetry ring, a power of two */
    int64_t spin_ns;          /* busy-wait this long before each deadline */
    double resolution_m;      /* encoder step for the velocity estimator */
    double device_timeout_s;  /* without a report for this long, the device is lost */
    uint32_t forces_on;       /* 0 or 1, at the start */
    uint32_t clock;           /* enum hd_clock_source */
    double overrun_threshold; /* of the periods of a second, may be missed; more is an overload */
    uint32_t overrun_action;  /* enum hd_overrun_action */
    uint32_t unused;
    double frozen_s; /* reports that say the same position for this long under force are a fault; 0: never */
    double frozen_force_n;
};

/* What becomes of an overload, beside its event. HD_OVERRUN_STEP_DOWN: the force fades out and the thread ends, so that
 * hd_servo_restart can go on at a lower rate. */
enum hd_overrun_action { HD_OVERRUN_WARN = 0, HD_OVERRUN_FAULT = 1, HD_OVERRUN_STEP_DOWN = 2 };

/* What was granted of what was asked for; errno values, 0 where it was granted or not asked for. */
struct hd_grant {
    int32_t scheduler; /* errno of the request, 0: granted */
    int32_t affinity;
    int32_t memory;
    int32_t priority;    /* in force; 0: not real-time */
    int32_t memory_kind; /* 0 nothing locked, 1 the servo's regions, 2 the whole process (on fault) */
};

enum hd_command_kind {
    HD_COMMAND_PLAY = 1,     /* mode, direction, amplitude (in the mode's unit) */
    HD_COMMAND_RESET = 2,    /* slot and generation, or HD_NO_SLOT for all */
    HD_COMMAND_FORCES = 3,   /* value 0 or 1; 1 clears latched faults whose cause is gone */
    HD_COMMAND_OPERATOR = 4, /* path; simulated device only */
    HD_COMMAND_MARK = 5      /* value: given back by an event at the tick that takes it */
};

/* Of so many marks at a time, from the command to the reading of its event, no event is lost: it has room in the ring
 * that others leave free. Whoever sends keeps to it. */
#define HD_MARKS 64

struct hd_command {
    uint32_t kind;
    uint32_t revision; /* taken once this revision or a later one is in force */
    uint32_t slot;
    uint32_t generation;
    uint32_t value;
    double direction[2];
    double amplitude;
    struct hd_mode mode;
    const struct hd_operator *path;
};

/* A snapshot of the counters that the servo keeps; each is read on its own. */
struct hd_counters {
    uint64_t ticks;
    uint64_t skipped;         /* periods missed */
    uint64_t overruns;        /* times that periods were missed */
    uint64_t samples_dropped; /* telemetry ring full */
    uint64_t events_dropped;
    uint64_t strikes;
    uint64_t glitches;
    uint64_t saturations;
    uint32_t revision; /* in force */
    uint32_t faults;
    uint32_t forces_on;
    uint32_t running;
    uint32_t memory_refused; /* errno: tables have grown beyond what may be locked; 0: all is as granted */
    uint32_t overloaded;     /* the thread ended, or is about to, for hd_servo_restart */
    uint64_t overloads;      /* seconds in which more than the threshold was missed */
    uint64_t suspends;       /* of the machine */
    double missed_share;     /* of the last whole second's periods */
    uint32_t signs;          /* of a HID device: enum hd_signs_state, problem and axis above it */
    uint32_t unused;
    struct hd_energy energy; /* as of the last tick that was watched */
};

#define HD_HISTOGRAM_BINS 82

/* How often a time was how long, since the start. counts[0] is below hd_histogram_edge_ns(0), counts[i] from edge i - 1
 * on and below edge i, the last one from the last edge on. */
struct hd_histogram {
    uint64_t counts[HD_HISTOGRAM_BINS];
    uint64_t sum_ns;
    int64_t max_ns;
};

struct hd_histograms {
    struct hd_histogram lateness; /* of a tick that missed periods: against the first deadline that was missed */
    struct hd_histogram work;
};

struct hd_servo; /* opaque */

/* Allocates everything that the servo will ever use. Its device is `sim` or `hid`, the other one is NULL. Both are
 * borrowed; `sim` is used by the servo thread alone once started. NULL: hd_invalid_reason. */
struct hd_servo *hd_servo_new(const struct hd_servo_config *config, struct hd_sim *sim, struct hd_hid *hid);
/* Locks memory, starts the thread, reports what was granted. HD_ERR_DENIED: `required` and refused. */
int hd_servo_start(struct hd_servo *servo, struct hd_grant *grant);
/* Fades the force out, puts zero, ends the thread and joins it. */
int hd_servo_stop(struct hd_servo *servo);
/* Joins a thread that ended by overload, and takes another rate: the next table is compiled for it. HD_ERR_INVALID: no
 * overload, or a rate that servo or simulated joystick refuse; all stays as it is. */
int hd_servo_set_rate(struct hd_servo *servo, double rate_hz, enum hd_overrun_action action);
/* After hd_servo_set_rate: a play that was sent under this number and was not taken yet strikes `mode`, which is
 * compiled for the new rate. Nothing happens to one that was taken. */
int hd_servo_retune(struct hd_servo *servo, uint64_t sequence, const struct hd_mode *mode);
/* After hd_servo_set_rate and, where the rate changed, hd_servo_publish: the thread goes on where it ended, as after a
 * stall; what was touched is met anew and the force comes in over the ramp. `faults` are latched. As hd_servo_start;
 * memory was locked then, and is told as it was. */
int hd_servo_restart(struct hd_servo *servo, uint32_t faults, struct hd_grant *grant);
void hd_servo_free(struct hd_servo *servo);

/* Checks and copies a table; it is in force at the next tick. One caller at a time. */
int hd_servo_publish(struct hd_servo *servo, const struct hd_table *table);
/* Sends `count` commands, all or none. *sequence is the number of the last. One caller at a time. */
int hd_servo_send(struct hd_servo *servo, const struct hd_command *commands, size_t count, uint64_t *sequence);
/* Wait until the servo has taken that command or revision; *tick is the tick that took it (for a revision: the first
 * tick rendered with it or a later one). */
int hd_servo_wait_command(struct hd_servo *servo, uint64_t sequence, int64_t timeout_ns, uint64_t *tick);
int hd_servo_wait_revision(struct hd_servo *servo, uint32_t revision, int64_t timeout_ns, uint64_t *tick);
/* The thread that serves commands lives. */
void hd_servo_beat(struct hd_servo *servo);
/* Forces fade out when this time passes; 0: no lease. */
void hd_servo_set_lease(struct hd_servo *servo, int64_t deadline_ns);
void hd_servo_counters(const struct hd_servo *servo, struct hd_counters *counters);
void hd_servo_histograms(const struct hd_servo *servo, struct hd_histograms *histograms);
/* Four to a factor of two, from 128 ns on; `index` is below HD_HISTOGRAM_BINS - 1. */
int64_t hd_histogram_edge_ns(uint32_t index);
/* Move up to `capacity` records out of the rings; the number is returned. *dropped is the running total. One reader. */
size_t hd_servo_read_samples(struct hd_servo *servo, struct hd_sample *samples, size_t capacity, uint64_t *dropped);
size_t hd_servo_read_events(struct hd_servo *servo, struct hd_event *events, size_t capacity, uint64_t *dropped);

#define HD_TOUCHED_MAX 1024

struct hd_touched {
    uint32_t slot;
    uint32_t generation;
};

/* What is touched now, or was at a tick that is not older than any sample or event that was read: up to HD_TOUCHED_MAX
 * records into `touched`; how many. Nothing of it is lost with events. One reader. */
size_t hd_servo_read_touched(struct hd_servo *servo, struct hd_touched *touched);
