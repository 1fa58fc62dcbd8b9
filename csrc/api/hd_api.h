/* The boundary between the C core and Python: all declarations that Python uses, and no others. This file declares
 * tables, the output of a tick and offline rendering; hd_api_device.h declares devices, hd_api_servo.h the servo.
 *
 * The three files are read verbatim by the C compiler (through hd_core.h, which adds guards and asserts) and by cffi.
 * They therefore hold declarations and `#define NAME number` only.
 *
 * The model in five terms. A *table* is an immutable snapshot of the scene: flat arrays, compiled by Python, in the
 * units that a tick needs. A *state* is the memory of the tick: contacts, ringing modes, punctures, friction anchors,
 * noise, ramps. Its slots belong to an object as long as the object keeps id and kind. A *tick* is a function of table,
 * state and one input, and returns one sample. The *servo* calls the tick on time, with a device on one side and rings
 * on the other. *Python* compiles tables, sends commands and drains samples and events; it never runs inside a tick.
 *
 * Units are SI and part of the names. Vectors are [x, y]. Times are CLOCK_MONOTONIC nanoseconds, or seconds if the name
 * ends in _s. Functions that can fail return HD_OK or a negative enum hd_status. All functions here are for the control
 * side: none is called from the servo thread. */

enum hd_status {
    HD_OK = 0,
    HD_ERR_INVALID = -1, /* an argument or a table is invalid; hd_invalid_reason returns the reason */
    HD_ERR_FULL = -2,    /* a ring has no room; no record was stored */
    HD_ERR_MEMORY = -3,  /* memory could not be allocated */
    HD_ERR_SYSTEM = -4,  /* a system call failed; errno has the cause */
    HD_ERR_TIMEOUT = -5, /* the servo did not take the command or table in time */
    HD_ERR_DENIED = -6   /* real-time rights were required and refused */
};

/* ---- Tables ------------------------------------------------------------------------------------------------ */

#define HD_KICKS 8 /* first samples of a strike that can be corrected */

/* A decaying sinusoid A exp(-B t) sin(w t), t >= 0, prepared for one tick period T. Its displayed force is the
 * coefficient (force per unit) times
 *
 *     Im(gain exp((-B + i w) t)) up to end_s  +  Im(tail exp((-B' + i w') t)) up to tail_end_s,
 *
 * with a gain of 1 and no tail if the device is not compensated for (docs/adr/0016 and 0030). */
struct hd_mode {
    double rotor_re; /* exp((-B + i w) T) */
    double rotor_im;
    double decay_rate_per_s;            /* B */
    double angular_frequency_rad_per_s; /* w */
    double end_s; /* 5/B; the mode rings while t_k - t_last <= end_s, t_last the onset of its last strike */
    double peak;  /* upper bound of the displayed magnitude per coefficient; without compensation the first maximum of
                     the mode */
    double peak_time_s;        /* time of that maximum after the onset */
    double amplitude_per_unit; /* A in m/s^2 per unit of the excitation (m/s of a tap, 1 for a rupture) */
    double force_per_unit;     /* coefficient in N per unit of the excitation; 0: strikes are silent */
    double gain_re;
    double gain_im;
    double tail_rotor_re; /* exp((-B' + i w') T) */
    double tail_rotor_im;
    double tail_decay_rate_per_s;            /* B' */
    double tail_angular_frequency_rad_per_s; /* w' */
    double tail_end_s;                       /* 5/B'; 0: no tail */
    double tail_re;
    double tail_im;
    double touched_n_per_m; /* surface stiffness for which gain, tail and peak hold; 0: for any */
    double free_peak; /* the peak without a surface. A strike interpolates linearly between the free values and those
                         above, by the stiffness that is touched */
    double free_gain_re;
    double free_gain_im;
    double free_tail_re;
    double free_tail_im;
    double kicks[2 * HD_KICKS]; /* c, d of each of the first samples: c + d x is added if the onset lies x T
                                   before the first */
    uint32_t kick_count;        /* 0 or HD_KICKS */
    uint32_t reserved;
    uint32_t effect; /* id of the hd_device_effect that a device may play instead; 0: no effect */
    uint32_t unused;
    double effect_force_per_unit; /* coefficient in N per unit of the excitation, if the effect is played */
    double effect_peak;           /* largest level of the effect divided by the coefficient */
    double effect_s;              /* duration of the effect */
};

/* How a texture is displayed. */
enum hd_texture {
    HD_TEXTURE_NONE = 0,
    HD_TEXTURE_STRIKES = 1,  /* grooves; each passage strikes the groove mode along the motion */
    HD_TEXTURE_GEOMETRY = 2, /* grooves; the surface is lowered by a raised cosine */
    HD_TEXTURE_DRAG = 3,     /* grooves; a viscous force against tangential motion */
    HD_TEXTURE_NOISE = 4     /* coloured noise */
};

#define HD_TAP_POINTS 256   /* largest number of points of a tap's amplitude */
#define HD_TUNE_POINTS 16   /* largest number of points of a frequency over speed or over force */
#define HD_TUNE_NODES 64    /* largest number of nodes of a compensation */
#define HD_TUNE_NODE 11     /* length of a node, in numbers */
#define HD_KEPT_TAIL 5      /* numbers of the second tail of compensated taps */
#define HD_KEPT_GAINS 8     /* numbers of the gains of one of their modes */
#define HD_KEPT_POINTS 256  /* largest number of times at which the depth of a tap is judged */
#define HD_WAVE_SAMPLES 512 /* largest number of samples of a waveform */
#define HD_WAVE_PARTS 8     /* parts of a waveform, see hd_waveform.h */

/* A material. The amplitude of a tap is piecewise linear over the approach speed: from 0 at rest to the first point,
 * then from point to point; beyond the last point the last segment is extended, but not below 0. */
struct hd_material {
    uint32_t texture;     /* enum hd_texture */
    uint32_t noise;       /* index in the table's noises if the texture is HD_TEXTURE_NOISE; else 0 */
    uint32_t heals;       /* membranes: 1 if a rupture closes again when the probe withdraws */
    uint32_t tap_count;   /* points of the tap's amplitude over the approach speed, up to HD_TAP_POINTS; 0: amplitude is
                             proportional to speed */
    uint32_t tap_first;   /* index in the table's numbers: speeds [tap_count], m/s, rising; amplitudes [tap_count] */
    uint32_t tune_speeds; /* points of the groove's frequency over the speed, see hd_table_numbers.h; 0: the frequency
                             of `groove` */
    uint32_t tune_forces; /* points of the groove's frequency over the force */
    uint32_t tune_nodes;  /* nodes of its compensation; 0: not compensated */
    uint32_t tune_first;  /* index in the table's numbers */
    uint32_t tune_mutes;  /* 0: a strike above tune_highest_rad_per_s is lowered to it; 1: it is silent */
    uint32_t mode_count; /* points of the tap's mode over the approach speed, see hd_table_numbers.h; 0: always `tap` */
    uint32_t mode_nodes; /* nodes of its compensation; 0: not compensated */
    uint32_t mode_first; /* index in the table's numbers */
    uint32_t mode_by_peak; /* 1: the amplitude of a tap is its first peak; 0: the coefficient A */
    uint32_t wave_count;   /* samples of the tap's waveform, 3 to HD_WAVE_SAMPLES, see hd_waveform.h; 0: it is a mode */
    uint32_t wave_first;   /* index in the table's numbers */
    uint32_t kept_count;   /* times at which the depth of a compensated tap is judged, 2 to HD_KEPT_POINTS, see
                              hd_table_numbers.h; 0: the tap has no second tail, and its compensation is never reduced */
    uint32_t kept_first;   /* index in the table's numbers */
    double kept_step_s;    /* distance between these times, above 0; the first is at the onset plus this */
    double stiffness_n_per_m;
    double damping_n_s_per_m;
    double rupture_depth_m;            /* membranes; 0: never ruptures */
    double friction_coefficient;       /* 0: no friction */
    double friction_stiffness_n_per_m; /* above 0 if the coefficient is */
    double spacing_m;                  /* of grooves; above 0 if the texture is grooves */
    double width_m;
    double depth_m;                   /* HD_TEXTURE_GEOMETRY */
    double drag_n_s_per_m;            /* HD_TEXTURE_DRAG */
    double velocity_gain_per_s;       /* HD_TEXTURE_STRIKES: A = velocity_gain |v_t| + force_gain F_n */
    double force_gain_m_per_s2_per_n; /* HD_TEXTURE_STRIKES, see velocity_gain_per_s */
    double tune_highest_rad_per_s;
    double wave_rate_hz;   /* sampling rate of the waveform */
    double tap_aim[2];     /* direction of a tap's first push: unit vector (n, t); 0, 0: along the normal n */
    double rupture_aim[2]; /* direction of a rupture's first push; n is the normal of the side entered */
    struct hd_mode tap; /* unit of the excitation: m/s of approach, or m/s^2 of A if tap_count is not 0. If the tap is a
                           waveform, only end, peak and units are used */
    struct hd_mode second;  /* second mode of a tap, struck with it and in its unit; force_per_unit 0: no second mode */
    struct hd_mode rupture; /* the excitation is 1 */
    struct hd_mode groove;  /* unit of the excitation: m/s^2 of A */
};

#define HD_NOISE_ORDER 32 /* largest order of a noise filter */

/* Coloured noise: a normalised lattice filter of unit power, times an RMS acceleration that follows tangential speed
 * and normal force:
 *
 *     rms(v, F) = max(0, velocity gain |v| + force gain F + grid(v, F)) min(1, |v| / threshold)
 *
 * From numbers[first] on: speeds [speed_count], forces [force_count], both strictly rising, then the nodes of the grid
 * [speed_count][force_count]. A node is
 *     rms (m/s^2), reflection coefficients k_1 .. k_order [order], ladder taps v_0 .. v_order [taps ? order + 1 : 0].
 * Between nodes all values are interpolated bilinearly; outside of the grid the outermost values hold. |k| < 1; the
 * squares of a node's taps sum to one. Without taps the filter is the all-pole lattice. */
struct hd_noise {
    uint32_t order;        /* 0 (white) to HD_NOISE_ORDER */
    uint32_t taps;         /* 0 or 1 */
    uint32_t along_normal; /* 0: acts along the tangent, 1: along the normal */
    uint32_t speed_count;  /* at least 1 */
    uint32_t force_count;  /* at least 1 */
    uint32_t first;        /* index in the table's numbers */
    uint32_t version; /* incremented whenever a member or number of the noise changes, except `first`; never reused */
    uint32_t unused;
    uint64_t seed;
    double threshold_m_per_s; /* at least 0 */
    double velocity_gain_per_s;
    double force_gain_m_per_s2_per_n;
    double force_per_unit; /* N per m/s^2; 0: silent */
};

/* A stretch of a wall with one material, along the wall's tangential coordinate s. The first piece of a wall has no
 * beginning (from_m is 0 and unused); the others are in rising order. Two neighbouring materials are blended from
 * half_ramp_m before from_m to half_ramp_m after it. The blends of a wall do not overlap. */
struct hd_piece {
    double from_m;
    double half_ramp_m; /* above 0, except for the first */
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

/* An object; its index in the table's array is its slot. The slot's `generation` is incremented whenever it gets
 * another object or another kind, `pose_version` whenever point_m, normal or half_m change, `surface_version` whenever
 * its materials are replaced or changed. Versions are never reused. */
struct hd_object {
    uint32_t generation;
    uint32_t pose_version;
    uint32_t surface_version;
    uint32_t shape;       /* enum hd_shape */
    uint32_t material;    /* index in the table's materials */
    uint32_t piece_first; /* walls with patches: index in the table's pieces */
    uint32_t piece_count; /* 0: one material everywhere; else at least 2 */
    uint32_t unused;
    double point_m[2]; /* wall: a point of the surface, where s is 0; others: the centre */
    double normal[2];  /* unit vector. wall: out of the solid; membrane: across; box: out of its top; disc: (0, 1) */
    double half_m[2];  /* membrane: half its width, 0; box: half its extents along (n_y, -n_x) and along n; disc: radius
                          twice; wall: 0, 0 */
};

#define HD_PASSIVITY_AGE_MAX 512 /* largest report_age, in periods, that the passivity observer accepts */

/* What the passivity observer and controller do, see hd_passivity.h. */
enum hd_passivity_mode { HD_PASSIVITY_OFF = 0, HD_PASSIVITY_OBSERVE = 1, HD_PASSIVITY_CONTROL = 2 };

/* All fields of a scene, summed to one affine law: F = force - stiffness p - damping v. */
struct hd_field {
    double force_n[2];
    double stiffness_n_per_m;
    double damping_n_s_per_m;
};

struct hd_table {
    uint32_t revision;
    uint32_t object_count; /* slots in the array, including free ones */
    uint32_t material_count;
    uint32_t piece_count;
    uint32_t noise_count;
    uint32_t number_count;
    uint32_t display_force;     /* 0 or 1 */
    uint32_t display_vibration; /* 0 or 1 */
    uint32_t field_version;     /* incremented whenever the field changes */
    uint32_t parts_version;     /* incremented whenever materials, pieces, noises or numbers change */
    uint32_t changed_count;     /* length of `changed`: slots changed since the table published before */
    uint32_t all_changed;       /* 1: all slots count as changed */
    uint32_t passivity;         /* enum hd_passivity_mode */
    uint32_t report_age;        /* delay of a position behind the acting force, in periods; 0 if unknown */
    double period_s;
    double max_force_n;       /* largest magnitude of the command */
    double max_speed_m_per_s; /* a step between two samples that implies a higher speed is a glitch */
    double rearm_m;           /* a surface is tapped again only after the probe has withdrawn this far; 0: always */
    double ramp_s;
    double ramp_step;                /* period_s / ramp_s: progress of a ramp in a tick */
    double brake_n_s_per_m;          /* largest damping of the passivity controller's brake */
    double handle_damping_n_s_per_m; /* damping of the handle itself; 0 if unknown */
    double handle_friction_n;        /* friction of the handle itself per axis; 0 if unknown */
    struct hd_field field;
    struct hd_object *objects;
    struct hd_material *materials;
    struct hd_piece *pieces;
    struct hd_noise *noises;
    double *numbers;
    uint32_t *changed;
};

/* ---- The output of a tick ------------------------------------------------------------------------------------ */

enum hd_flag {
    HD_FLAG_SKIPPED = 1,      /* periods were missed before this tick */
    HD_FLAG_CONTACT = 2,      /* something is touched */
    HD_FLAG_RINGING = 4,      /* a mode rings */
    HD_FLAG_SATURATED = 8,    /* the force limit changed the command or scaled a strike */
    HD_FLAG_RAMPING = 16,     /* a ramp is under way */
    HD_FLAG_FORCES_ON = 32,   /* forces are enabled */
    HD_FLAG_FAULT = 64,       /* a fault is latched */
    HD_FLAG_GLITCH = 128,     /* the position jumped; contacts were synchronised with it again */
    HD_FLAG_REPEATED = 256,   /* no new sample came from the device */
    HD_FLAG_RESTRAINED = 512, /* the passivity controller changed the contact force */
    HD_FLAG_CHECKING = 1024,  /* the signs are checked, or the device exerts no force; the force is that of the check */
    HD_FLAG_STREAMED = 2048   /* a streamed force is part of the contact force, or fading to zero */
};

/* The telemetry record of one tick.
 *
 * contact_force_n: the force of touched objects (stiffness, damping, friction, and grooves displayed as geometry or
 * damping), the residual of objects that were removed while touched, the fields, and the streamed force.
 *
 * vibration_force_n: ringing modes (taps, grooves displayed as vibration, ruptures, play) and the noise of textures,
 * without the modes that the device plays as effects.
 *
 * Both are scaled by the ramps of the display flags, and the contact force is changed by the passivity controller.
 * Neither is limited yet, nor scaled by the gain that set_forces and faults fade. The limit already acts on vibration
 * in three ways: strikes are scaled at their onset, noise is scaled to the room that the limit leaves, and modes that
 * the limit lowered stay lowered in the next tick. */
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
    HD_EVENT_SATURATION = 4, /* value: the command before the limit, N; one event per contiguous saturation */
    HD_EVENT_OVERRUN = 5,    /* value: periods missed */
    HD_EVENT_FAULT = 6,      /* code: bits of the faults latched now; 0: cleared */
    HD_EVENT_REVISION = 7,   /* code: the revision in force from this tick on */
    HD_EVENT_GLITCH = 8,     /* value: the speed that the jump implied, m/s */
    HD_EVENT_DEVICE_LOST = 9,
    HD_EVENT_DEVICE_FOUND = 10,
    HD_EVENT_GROOVE = 11,   /* speed: tangential, signed along t; value: number of grooves struck in this contact */
    HD_EVENT_OVERLOAD = 12, /* value: missed fraction of the periods of the last second, above the threshold */
    HD_EVENT_RATE = 13,     /* value: the servo's rate from this tick on, Hz */
    HD_EVENT_RESUMED = 14,  /* value: duration of the machine's suspend, s */
    HD_EVENT_MEMORY_REFUSED = 15, /* code: errno; from this table on not all memory is locked */
    HD_EVENT_MARK = 16,           /* code: value of the command */
    HD_EVENT_GESTURE_END = 17     /* value: the tick that took the path; code: 1 completed, 0 replaced */
};

struct hd_event {
    uint64_t tick;
    double before_tick_s; /* time from the event to the tick's time */
    int64_t time_ns;      /* the tick's time */
    uint32_t kind;
    uint32_t code;
    uint32_t slot; /* HD_NO_SLOT: not about an object */
    uint32_t generation;
    double speed_m_per_s;      /* estimated approach speed at the onset, along the normal */
    double true_speed_m_per_s; /* exact speed of the simulated handle; NaN on a real device */
    double amplitude_m_per_s2; /* amplitude of the strike before scaling; 0: no strike */
    double scale;              /* factor, 0 to 1, by which the limit scaled the strike */
    double value;
};

/* The code of a contact event without an onset: the object appeared around the probe, or the contact was synchronised
 * again. */
#define HD_CONTACT_SILENT 1

#define HD_NO_SLOT 4294967295
#define HD_PLAY_SLOT 4294967294

enum hd_fault {
    HD_FAULT_NONFINITE = 1, /* NaN or infinity in a sample or in a force */
    HD_FAULT_CONTROL = 2,   /* the thread that serves commands had no heartbeat for a second */
    HD_FAULT_LEASE = 4,     /* a lease was not renewed in time */
    HD_FAULT_DEVICE = 8,    /* the device does not report */
    HD_FAULT_OVERRUN = 16,  /* the servo missed too many periods */
    HD_FAULT_FROZEN = 32,   /* the device keeps reporting the same position under force */
    HD_FAULT_SIGNS = 64     /* the check of the device's signs found them wrong or unclear */
};

/* ---- Memory -------------------------------------------------------------------------------------------------- */

/* Makes malloc map blocks of `bytes` or more separately, in all threads, so that free returns their pages to the
 * system. Does nothing if the C library has no such limit. HD_ERR_INVALID: more than malloc accepts. */
int hd_memory_large_from(size_t bytes);

/* ---- Sockets ------------------------------------------------------------------------------------------------- */

/* Sends `head` followed by `data` to each of `count` connected stream sockets, without blocking. taken[i]: bytes that
 * socket i accepted, or a negative errno. */
void hd_send_each(const int32_t *sockets, size_t count, const void *head, size_t head_size, const void *data,
                  size_t data_size, int64_t *taken);

/* ---- Crash of the process ------------------------------------------------------------------------------------ */

/* Reports that are written to the device when the process crashes. Control side.
 *
 * hd_last_report_arm installs handlers of SIGABRT, SIGSEGV, SIGBUS, SIGILL and SIGFPE, which write the kept reports,
 * then call the previous handler.
 *
 * hd_last_report_keep keeps `count` reports, concatenated in `reports`, zero force first, with a pause of `pause_s`
 * between two. It duplicates `fd` until hd_last_report_drop or the next hd_last_report_keep. HD_ERR_INVALID: too many
 * or too long reports, or no descriptor is free; the reports kept before stay. */
void hd_last_report_arm(void);
int hd_last_report_keep(int fd, const uint8_t *reports, const uint32_t *lengths, uint32_t count, double pause_s);
void hd_last_report_drop(void);

/* ---- State and offline rendering ----------------------------------------------------------------------------- */

struct hd_state; /* opaque */

/* Zeroed state with room for `slot_capacity` objects, forces on; NULL without memory. */
struct hd_state *hd_state_new(uint32_t slot_capacity);
void hd_state_free(struct hd_state *state);
/* Sets the encoder step that the velocity estimator assumes; 0: positions are exact. */
void hd_state_set_resolution(struct hd_state *state, double step_m);
/* Turns forces on or off: the command fades in or out over the table's ramp. */
void hd_state_enable(struct hd_state *state, int enabled);
/* Sets the command to zero; it then fades in over the table's ramp, as when a servo starts. */
void hd_state_mute(struct hd_state *state);
/* Copies all that the next tick reads, in order to try a tick. HD_ERR_INVALID: the capacities differ. */
int hd_state_copy(struct hd_state *to, const struct hd_state *from);
/* Clears the contact state of a slot, if it has this generation, or of all slots (HD_NO_SLOT). `time_ns`: time of the
 * next tick. */
void hd_state_reset(struct hd_state *state, uint32_t slot, uint32_t generation, int64_t time_ns);
uint32_t hd_state_faults(const struct hd_state *state);
/* Returns the latest contact state of a slot: bit 0 touched, bit 1 punctured. */
uint32_t hd_state_slot(const struct hd_state *state, uint32_t slot);

/* Energy that the objects gave to the hand, according to the passivity observer. */
struct hd_energy {
    double energy_j;   /* of the current, else the last contact; below 0: the hand gave more energy than it received */
    double largest_j;  /* largest energy_j of all contacts */
    uint64_t contacts; /* number of contacts, each from the first touch to the last release */
    uint64_t restrained; /* contacts in which the controller acted */
    uint64_t acted;      /* ticks in which the controller acted */
};

void hd_state_energy(const struct hd_state *state, struct hd_energy *energy);

/* A world is a table owned by C: checked, copied, and with a spatial index for the broad phase. */
struct hd_world; /* opaque */

struct hd_world *hd_world_new(void); /* NULL without memory */
void hd_world_free(struct hd_world *world);
/* Replaces the table of a world by a copy. After HD_ERR_INVALID (hd_invalid_reason) or HD_ERR_MEMORY the world is
 * unchanged. */
int hd_world_load(struct hd_world *world, const struct hd_table *table);
/* Stops all ramps until the next load, in order to compute a tick as if no ramp were under way. */
void hd_world_still(struct hd_world *world);
/* Writes up to `capacity` slots of objects that may lie within `radius_m` of a point, among them all objects that do.
 * Returns the number written, or SIZE_MAX without memory. For tests and benchmarks of the index. */
size_t hd_world_candidates(const struct hd_world *world, const double point_m[2], double radius_m, uint32_t *slots,
                           size_t capacity);

/* Returns why the last check on this thread failed, as one line. */
const char *hd_invalid_reason(void);

/* Renders `count` positions, one per tick, [count][2]. `velocity` is [count][2], or NULL to estimate it. `periods` is
 * [count], periods since the previous tick, or NULL for 1 each. Up to `event_capacity` events are kept; *event_count is
 * the number that occurred. Tick numbers continue from the state's last. */
int hd_render(const struct hd_world *world, struct hd_state *state, const double *position, const double *velocity,
              const uint32_t *periods, size_t count, struct hd_sample *samples, struct hd_event *events,
              size_t event_capacity, size_t *event_count);

/* Renders the ticks of a servo again from the inputs in its samples: tick, time, position, velocity, forces on, glitch.
 * `interval_s` is [count], s from the previous report to that of this tick (0: no new report); `periods` is [count],
 * periods since the previous tick. Tick numbers must rise. Events as in hd_render. */
int hd_replay(const struct hd_world *world, struct hd_state *state, const struct hd_sample *recorded,
              const double *interval_s, const uint32_t *periods, size_t count, struct hd_sample *samples,
              struct hd_event *events, size_t event_capacity, size_t *event_count);

/* Runs the velocity estimator alone: `interval_s` [count] since the previous sample, `position` [count][2]. Writes
 * `velocity` [count][2] and, unless `half_width` is NULL, half the width of the set of velocities that are consistent
 * with the samples, [count][2]. */
int hd_velocity_run(double step_m, size_t count, const double *interval_s, const double *position, double *velocity,
                    double *half_width);

/* Runs one noise alone, as on a touched surface: from `speed` [count] (tangential, m/s) and `force` [count] (normal, N)
 * computes `out` [count], the acceleration in m/s^2 before force_per_unit. HD_ERR_INVALID as for a table. */
int hd_noise_run(const struct hd_noise *noise, const double *numbers, uint32_t number_count, size_t count,
                 const double *speed, const double *force, double *out);
