/* The boundary (hd_api.h), second part: the simulated joystick, HID devices, the check of signs. */

/* ---- The simulated joystick ------------------------------------------------------------------------------------ */

#define HD_SIM_FORCES 16 /* largest number of forces under way to the actuator */

struct hd_sim_config {
    double handle_mass_kg;
    double handle_damping_n_s_per_m;
    double coulomb_friction_n; /* per axis */
    double encoder_step_m;     /* 0: exact */
    double max_force_n;        /* largest force of the actuator, per axis */
    double force_step_n;       /* resolution of the actuator; 0: exact */
    double report_interval_s;  /* 0: a report at every servo period */
    double report_delay_s;
    double force_interval_s;  /* frame interval of the link; 0: no link, a put acts at once */
    uint32_t force_intervals; /* frames from a put to its effect, 1 to HD_SIM_FORCES */
    uint32_t unused;
    double workspace_m;     /* half the travel per axis, between inelastic stops */
    double force_timeout_s; /* a force becomes zero this long after the last put took effect */
    double hand_mass_kg;
    double hand_stiffness_n_per_m;
    double hand_damping_n_s_per_m;
    double start_m[2];
    double actuator_rate_per_s;    /* 2 pi times the natural frequency of the actuator's lag */
    double actuator_damping_ratio; /* damping ratio of a second-order lag */
    uint32_t actuator_order;       /* order of the lag: 0 (none), 1 or 2 */
    uint32_t reserved;
};

enum hd_interpolation { HD_LINEAR = 0, HD_MINIMUM_JERK = 1 };

/* What one read of a device returns. */
struct hd_reading {
    double position_m[2];
    double interval_s;               /* time from the previous report to this one; 0: no new report */
    double true_velocity_m_per_s[2]; /* NaN on a real device */
};

struct hd_sim;      /* opaque */
struct hd_operator; /* opaque: the hand's reference position over time; immutable */

/* Makes an operator of `waypoints` [count][3]: t_s, x_m, y_m, with strictly rising times; copied. NULL: invalid
 * (hd_invalid_reason) or no memory. */
struct hd_operator *hd_operator_new(const double *waypoints, size_t count, enum hd_interpolation interpolation);
/* Drops the caller's reference. The memory is freed once no servo holds the operator; the same holds for hd_sim_free
 * and hd_hid_free. */
void hd_operator_free(struct hd_operator *path);
/* Returns NULL if the configuration is invalid (hd_invalid_reason) or memory is missing. */
struct hd_sim *hd_sim_new(const struct hd_sim_config *config, double period_s);
void hd_sim_free(struct hd_sim *sim);
/* Makes the hand follow `path`. Until the first waypoint its reference moves there in a straight line from the present
 * reference; if that waypoint is at t_s = 0, it jumps there. The caller keeps `path` alive as long as the simulation
 * uses it. */
void hd_sim_operate(struct hd_sim *sim, const struct hd_operator *path);
/* Puts the handle at rest at the hand's present reference, for a run that starts with an operator. */
void hd_sim_settle(struct hd_sim *sim);
/* Puts a force, limited and rounded. The actuator holds it, at once or after the link's delay, until the next put or
 * until it expires. */
void hd_sim_put(struct hd_sim *sim, const double force_n[2]);
/* Advances time by `periods` servo periods. */
void hd_sim_advance(struct hd_sim *sim, uint32_t periods);
/* Reads the newest encoder sample that has arrived as a report. */
void hd_sim_read(struct hd_sim *sim, struct hd_reading *reading);
/* Returns the exact motion of the handle: position [2], velocity [2], force of the actuator [2]. */
void hd_sim_truth(const struct hd_sim *sim, double position[2], double velocity[2], double force[2]);
/* Sets position and velocity of the handle; hand, force and reports are unchanged. HD_ERR_INVALID: not finite, beyond
 * the stops, or faster than 1e6 m/s. */
int hd_sim_place(struct hd_sim *sim, const double position[2], const double velocity[2]);
/* Sets the length of a period. Forces under way to the actuator are dropped and the sequence of reports begins again;
 * the hand continues its path. HD_ERR_INVALID: invalid configuration or period, nothing has changed. */
int hd_sim_set_period(struct hd_sim *sim, const struct hd_sim_config *config, double period_s);
/* Runs `count` periods, each under its force of `force` [count][2]. `motion` [count][4] receives position and velocity
 * at the beginning of each period, before its force is put. */
void hd_sim_drive(struct hd_sim *sim, const double *force, size_t count, double *motion);

/* Runs `count` ticks of table, state and sim in closed loop, without a clock. `truth` [count][4] receives exact
 * position and velocity, or is NULL. */
int hd_simulate(const struct hd_world *world, struct hd_state *state, struct hd_sim *sim, size_t count,
                struct hd_sample *samples, double *truth, struct hd_event *events, size_t event_capacity,
                size_t *event_count);
/* Strikes a mode at the next tick of a run, as the command `play` does. HD_ERR_INVALID (hd_invalid_reason);
 * HD_ERR_FULL: too many strikes for one tick. */
int hd_play(struct hd_state *state, const struct hd_mode *mode, const double direction[2], double amplitude);

/* ---- HID devices ------------------------------------------------------------------------------------------------ */

#define HD_HID_REPORT_BYTES 256 /* length of the longest report, including its id */
#define HD_HID_MESSAGES 24      /* messages of one script */
#define HD_DEVICE_EFFECTS 8     /* effects that a device plays */
#define HD_DEVICE_EFFECT_MESSAGES 4
#define HD_HID_VALUES 4 /* largest number of values in one message */
#define HD_HID_STATES 8
#define HD_HID_EFFECTS 4 /* effects whose play state is watched */

/* Position of a number in a report. Bits are counted as in HID: from the lowest bit of the first byte after the report
 * id. A `big_endian` number consists of complete bytes, the most significant first. */
struct hd_hid_field {
    uint32_t bit_offset;
    uint32_t bit_size; /* 1 to 32 */
    uint32_t is_signed;
    uint32_t big_endian;
};

/* One axis: position = (counts - zero_counts) * m_per_count; the halves of the travel may have different steps. */
struct hd_hid_axis {
    struct hd_hid_field field;
    uint32_t report_id; /* 0: reports have no id */
    uint32_t unused;
    double zero_counts;
    double m_per_count[2]; /* below and above zero_counts; their common sign gives the direction of the axis */
};

/* The quantity of the force F (N, x to the right, y up) that a number in an output report carries. */
enum hd_hid_quantity {
    HD_HID_X = 1,         /* F_x */
    HD_HID_Y = 2,         /* F_y */
    HD_HID_MAGNITUDE = 3, /* |F| */
    HD_HID_DIRECTION = 4  /* direction that F comes from, rad, clockwise from +y (HID's north), 0 to 2 pi */
};

/* A number in an output report: counts = quantity * counts_per_unit + zero_counts, rounded to nearest and limited to
 * least .. most, which include zero_counts. HD_HID_DIRECTION is reduced modulo a full turn instead if a full turn lies
 * within the limits. HD_HID_X and HD_HID_Y add the other axis's force times counts_per_other_n: this corrects two
 * effects whose directions, as integers, are not exactly along the axes. */
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

/* An output report: constant bytes, report id first (0 if reports have no id), into which numbers are written. */
struct hd_hid_message {
    uint32_t length; /* including the id */
    uint32_t value_count;
    struct hd_hid_value values[HD_HID_VALUES];
    uint8_t bytes[HD_HID_REPORT_BYTES];
};

struct hd_hid_script {
    uint32_t count;
    uint32_t unused;
    struct hd_hid_message messages[HD_HID_MESSAGES];
};

/* The meaning of a number in an input report that describes the state of the device. */
enum hd_hid_meaning {
    HD_HID_RESET = 1,     /* the device was reset and has lost its effects */
    HD_HID_ACTUATORS = 2, /* actuators are enabled; 0: switched off, by the device or by another driver */
    HD_HID_PAUSED = 3,    /* paused; no force is sent during a pause that began while connected */
    HD_HID_SAFETY = 4,    /* safety switch is closed; 0: the device keeps its actuators off until it is closed */
    HD_HID_POWER = 5      /* the actuators have power */
};

struct hd_hid_state {
    struct hd_hid_field field;
    uint32_t report_id;
    uint32_t meaning; /* enum hd_hid_meaning */
};

/* The numbers of an input report that name an effect and say whether it plays. An effect of ours that played, stopped,
 * and does not play again after a renewal is lost: the device was reset. Some devices do not report that a renewal
 * restarts an effect, so a loss is accepted only once per connection. It is accepted each time after the device has
 * reported effects as playing over `proof` renewals, which take longer than the duration of an effect. */
struct hd_hid_effects {
    struct hd_hid_field index;
    struct hd_hid_field playing;
    uint32_t report_id;
    uint32_t count; /* number of indices; 0: effects are not watched */
    uint32_t indices[HD_HID_EFFECTS];
    uint32_t proof; /* renewals, at least 1 */
    uint32_t unused;
};

/* The check of a device's signs before the first force of the scene: see hd_signs.h. */
struct hd_hid_signs {
    uint32_t number; /* identifies the device and its configuration, which are checked once; 0: the signs are trusted */
    uint32_t axes;   /* axes that are checked: bit 0 x, bit 1 y */
    double force_n;  /* force of a pulse */
    double least_m;  /* smallest mean displacement over a pulse that counts as a motion */
    double enough_m; /* a pulse ends early at this displacement */
};

/* All reports of a connection, compiled by Python. hd_hid_connect checks and copies it. */
struct hd_hid_plan {
    struct hd_hid_axis axes[2]; /* x, y */
    struct hd_hid_script begin; /* sent once, before the first force; must not exert a force */
    struct hd_hid_script force; /* sent for each new force, in this order, except messages that did not change */
    struct hd_hid_script renew; /* sent every renew_ns while connected, to restart effects of finite duration and reset
                                   watchdogs; may contain force values */
    /* Restores effect settings that another program may have changed: one message every restore_ns, in turn, after the
     * forces. Not sent to a device that reports that its effects play. */
    struct hd_hid_script restore;
    struct hd_hid_script stop; /* sent after a force of zero when the connection is closed in an orderly way */
    struct hd_hid_effects effects;
    struct hd_hid_state states[HD_HID_STATES];
    struct hd_hid_signs signs;
    uint32_t state_count;
    uint32_t on_change;        /* 1: the device reports changes only, so silence is not a failure */
    int64_t renew_ns;          /* interval of `renew`, with which the force messages are sent again, too; 0: never */
    int64_t restore_ns;        /* interval of `restore`; 0: never */
    int64_t write_interval_ns; /* smallest time between two writes, the endpoint's interval, up to 0.1 s; shorter while
                                  disconnecting; 0: as fast as the device takes them */
};

/* A mode that the device plays: a periodic effect of finite duration, which is not renewed. */
struct hd_device_effect {
    uint32_t id;            /* identifies this mode on this device; not 0, never reused */
    uint32_t place;         /* index of the device's effect, below HD_DEVICE_EFFECTS; an effect is one mode at a time */
    uint32_t message_count; /* 1 to HD_DEVICE_EFFECT_MESSAGES */
    uint32_t unused;
    int64_t duration_ns; /* up to 0.2 s */
    double least_n;      /* a strike with a smaller coefficient is not sent */
    double most_n;       /* a larger coefficient is reduced to this one */
    /* The force of these messages is the coefficient as a vector. The last one starts the effect; the others are
     * skipped if unchanged. */
    struct hd_hid_message messages[HD_DEVICE_EFFECT_MESSAGES];
    struct hd_hid_message stop; /* stops the effect; contains no numbers */
};

struct hd_device_effects {
    uint32_t count;
    uint32_t unused;
    struct hd_device_effect effects[HD_DEVICE_EFFECTS];
};

/* The state of a connection; the members are read one by one, not atomically together. */
struct hd_hid_status {
    uint32_t connected;    /* 1: both threads run */
    int32_t error;         /* errno of the error that ended the connection; 0: no error */
    uint32_t reset;        /* since hd_hid_connect the device reported a reset, switched its actuators off or lost an
                              effect; the device must be set up again */
    uint32_t states;       /* bit (meaning - 1): the number of that meaning is not 0 */
    uint32_t states_known; /* bit (meaning - 1): a report contained the number of that meaning */
    uint32_t effects_told; /* since hd_hid_connect the device reported that an effect of ours plays, so the loss of an
                              effect can be noticed */
    uint64_t reports; /* input reports read, of any id, whose contents are already published and in the other members */
    uint64_t positions;     /* reports with a position */
    uint64_t short_reports; /* reports shorter than the plan requires; ignored */
    uint64_t writes;
    uint64_t forces;           /* forces sent, without those that a newer one replaced */
    int64_t write_ns;          /* duration of a write, running mean; 0: not known yet */
    int64_t write_interval_ns; /* time between consecutive forces, running mean without idle times; 0: not known yet */
    int64_t last_report_ns;
    uint64_t strikes;      /* device effects started */
    uint64_t strikes_lost; /* strikes not sent: too late, cancelled, of an effect that was removed, or no room in the
                              queue */
};

/* Checks a plan as hd_hid_connect does. HD_ERR_INVALID (hd_invalid_reason). */
int hd_hid_check(const struct hd_hid_plan *plan);

struct hd_hid; /* opaque: two mailboxes and, while connected, a reader and a writer thread */

struct hd_hid *hd_hid_new(void); /* NULL without memory */
/* Drops the caller's reference. Once no servo holds the device, disconnects in an orderly way and frees it. */
void hd_hid_free(struct hd_hid *hid);
/* Starts a connection over `fd`, a hidraw node (or another descriptor that keeps message bounds, such as
 * SOCK_SEQPACKET), open for reading and writing; the caller keeps the descriptor. Reports that are already waiting set
 * position and device state, but do not count as a reset. The first force is zero. `priority`: real-time priority of
 * both threads, 0 for normal threads. HD_ERR_INVALID (hd_invalid_reason; also if already connected), HD_ERR_MEMORY,
 * HD_ERR_SYSTEM (errno); HD_ERR_DENIED: threads of this priority are refused. One thread at a time connects,
 * disconnects and frees. */
int hd_hid_connect(struct hd_hid *hid, const struct hd_hid_plan *plan, int fd, int priority);
/* Ends both threads. `orderly`: a force of zero and the stop script are written first, within 0.5 s; after an error
 * they are written as far as the device accepts them. A device that does not accept a write within that time is
 * abandoned with ETIMEDOUT; the descriptor may be closed nevertheless. Returns 0, or the errno of these writes or of
 * the error that had ended the connection before. */
int hd_hid_disconnect(struct hd_hid *hid, int orderly);
/* Sets the effects that the device plays in this connection; a connection begins without effects. Strikes of modes with
 * one of these effects are then sent to the device instead of rendered, while forces and vibration are fully on;
 * otherwise playing effects are stopped. The effects are copied. HD_ERR_INVALID (hd_invalid_reason). Does nothing
 * without a connection. Must not run at the same time as hd_hid_connect or hd_hid_disconnect. */
int hd_hid_set_effects(struct hd_hid *hid, const struct hd_device_effects *effects);
void hd_hid_status(const struct hd_hid *hid, struct hd_hid_status *status);
/* Blocks until the connection fails, a reset is seen, hd_hid_wake is called or `timeout_ns` has passed. Returns 1 if
 * one of the first three happened since the last call that returned 1, else 0. */
int hd_hid_wait(struct hd_hid *hid, int64_t timeout_ns);
/* Makes hd_hid_wait return 1. Any thread. */
void hd_hid_wake(struct hd_hid *hid);
/* Marks the device as reset: it gets no force until it is set up again. */
void hd_hid_suspect(struct hd_hid *hid);
/* Clears `reset` after the device was set up again. While `reset` is set the device gets no force; afterwards the force
 * returns over 20 ms. */
void hd_hid_clear_reset(struct hd_hid *hid);

/* Read and write a number of a report, for tests and set-up. `report` has `length` bytes, its id first. HD_ERR_INVALID:
 * the field is not inside of the report, or the number does not fit. */
int hd_bits_get(const struct hd_hid_field *field, const uint8_t *report, size_t length, int64_t *counts);
int hd_bits_put(const struct hd_hid_field *field, uint8_t *report, size_t length, int64_t counts);
/* Writes the bytes of `message` with this force, for tests. */
void hd_hid_compose(const struct hd_hid_message *message, const double force_n[2], uint8_t *bytes);

/* ---- The check of signs ------------------------------------------------------------------------------------------ */

enum hd_signs_state {
    HD_SIGNS_UNCHECKED = 0, /* forces have not been on yet */
    HD_SIGNS_TRUSTED = 1,   /* trusted by the configuration, not checked */
    HD_SIGNS_CHECKING = 2,
    HD_SIGNS_WAITING = 3, /* waiting until `problem` ends */
    HD_SIGNS_RIGHT = 4,
    HD_SIGNS_WRONG = 5,  /* no force until another device or configuration is connected */
    HD_SIGNS_UNCLEAR = 6 /* no force until forces are turned on again, which restarts the check */
};

enum hd_signs_problem {
    HD_SIGNS_FINE = 0,
    HD_SIGNS_REVERSED = 1,  /* the handle moves in the opposite direction */
    HD_SIGNS_SWAPPED = 2,   /* the handle moves along the other axis */
    HD_SIGNS_STILL = 3,     /* the handle does not move */
    HD_SIGNS_UNCERTAIN = 4, /* the pulses give different results */
    HD_SIGNS_MOVING = 5,    /* the handle does not rest, so no pulse begins */
    HD_SIGNS_CONTACT = 6,   /* an object is touched, so no pulse begins */
    HD_SIGNS_IDLE = 7       /* the device reports that it exerts no force, for the reasons from HD_SIGNS_IDLE_SHIFT */
};

/* Bits of hd_counters.signs: enum hd_signs_state in the lowest 8, above them problem, axis, and the reasons of
 * HD_SIGNS_IDLE: bit (enum hd_hid_meaning - 1) of a state in which the device exerts no force. */
#define HD_SIGNS_PROBLEM_SHIFT 8
#define HD_SIGNS_AXIS_SHIFT 16
#define HD_SIGNS_IDLE_SHIFT 24

/* The input of the check in a tick. */
struct hd_signs_input {
    double position_m[2];
    double elapsed_s; /* time since the previous tick */
    double gain;      /* gain of the scene's force, which fades out before the check begins */
    double max_force_n;
    double ramp_s;
    uint32_t enabled; /* 1: forces are requested */
    uint32_t contact; /* 1: an object is touched */
    uint32_t jumped;  /* 1: the position is not comparable with the previous one */
    uint32_t idle;    /* bit (enum hd_hid_meaning - 1): the device reports that it exerts no force for this reason */
};

/* The check without a servo, for tests: hd_signs_try runs one tick, writes its force and returns hd_counters.signs. */
struct hd_signs; /* opaque */
struct hd_signs *hd_signs_new(void);
void hd_signs_free(struct hd_signs *signs);
uint32_t hd_signs_try(struct hd_signs *signs, const struct hd_hid_signs *of, const struct hd_signs_input *input,
                      double force_n[2]);
