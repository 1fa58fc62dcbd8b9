/* The boundary between the C core and Python: everything that crosses it, and nothing else. This file has tables, what
 * a tick gives, and offline rendering; hd_api_device.h devices, hd_api_servo.h the servo.
 *
 * The three files are read twice, verbatim: by the C compiler (through hd_core.h, which adds guards and asserts) and by
 * cffi. They therefore hold declarations and `#define NAME number` only.
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
    uint32_t texture;   /* enum hd_texture */
    uint32_t noise;     /* index in the table's noises, for HD_TEXTURE_NOISE; else 0 */
    uint32_t heals;     /* membranes: closes again when the probe withdraws */
    uint32_t tap_count; /* points of the tap's amplitude over the approach speed, up to HD_TAP_POINTS; 0: a slope */
    uint32_t tap_first; /* index in the table's numbers: speeds [tap_count], m/s, rising; amplitudes [tap_count] */
    uint32_t
        tune_speeds; /* points of the groove's frequency over the speed, see hd_table_numbers.h; 0: it is the mode's */
    uint32_t tune_forces;  /* the same over the force */
    uint32_t tune_nodes;   /* of its compensation; 0: there is none */
    uint32_t tune_first;   /* index in the table's numbers */
    uint32_t tune_mutes;   /* a strike above tune_highest_rad_per_s is 0: lowered to that, 1: silent */
    uint32_t mode_count;   /* points of the tap's mode over the approach speed, see hd_table_numbers.h; 0: it is one */
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
    HD_FLAG_CHECKING = 1024,  /* the signs of the device are checked: the force is the check's, none the scene's */
    HD_FLAG_STREAMED = 2048   /* a streamed force is a part of the contact force, or on its way to zero */
};

/* One tick as telemetry carries it.
 *
 * contact_force_n: what touched objects push with (stiffness, damping, friction, and grooves that are displayed as
 * geometry or damping), what is left of objects that went away while touched, the fields, and the streamed force.
 * vibration_force_n:
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
    double contact_force_n[2];   /* objects, fields and stream, after the passivity controller, before the limit */
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
