/* The boundary (hd_api.h), second part: the simulated joystick, HID devices, the check of signs. */

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
/* Freed as soon as no servo holds it; so are a simulation and a connection. */
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
/* As soon as no servo holds it, ends the connection as hd_hid_disconnect does and frees. */
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
