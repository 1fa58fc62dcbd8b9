/* The boundary (hd_api.h), third part: the servo. */

/* ---- The servo --------------------------------------------------------------------------------------------------- */

enum hd_realtime { HD_REALTIME_OFF = 0, HD_REALTIME_PREFERRED = 1, HD_REALTIME_REQUIRED = 2 };

/* What triggers a tick. HD_CLOCK_TIMER: a timer. HD_CLOCK_DEVICE: each position of a HID device, with at most one tick
 * a period; the timer takes over after two and a half periods without a position. */
enum hd_clock_source { HD_CLOCK_TIMER = 0, HD_CLOCK_DEVICE = 1 };

struct hd_servo_config {
    double rate_hz;
    int32_t cpu; /* processor that the thread is bound to; -1: any */
    int32_t priority;
    int32_t realtime; /* enum hd_realtime */
    uint32_t slot_capacity;
    uint32_t sample_capacity; /* samples in the telemetry ring, a power of two */
    int64_t spin_ns;          /* duration of the busy-wait before each deadline */
    double resolution_m;      /* encoder step that the velocity estimator assumes; 0: exact */
    double device_timeout_s;  /* the device is lost after this time without a report */
    uint32_t forces_on;       /* 1: forces are on at the start */
    uint32_t clock;           /* enum hd_clock_source */
    double overrun_threshold; /* fraction of a second's periods that may be missed; more is an overload */
    uint32_t overrun_action;  /* enum hd_overrun_action */
    uint32_t unused;
    double frozen_s; /* reports with an unchanged position for this long under a force are a fault; 0: never */
    double frozen_force_n;
    double stream_timeout_s; /* a stream ends after this time without a value, 0.002 to 1 s */
};

/* What an overload causes in addition to its event. HD_OVERRUN_WARN: nothing. HD_OVERRUN_FAULT: a fault.
 * HD_OVERRUN_STEP_DOWN: the force fades out and the thread ends, so that hd_servo_restart can continue at a lower
 * rate. */
enum hd_overrun_action { HD_OVERRUN_WARN = 0, HD_OVERRUN_FAULT = 1, HD_OVERRUN_STEP_DOWN = 2 };

/* Results of the requests to the system: an errno, 0 if the request was granted or not made. */
struct hd_grant {
    int32_t scheduler; /* real-time scheduling */
    int32_t affinity;
    int32_t memory;
    int32_t priority;    /* actual priority; 0: not real-time */
    int32_t memory_kind; /* locked memory: 0 none, 1 the servo's regions, 2 all pages of the process (each when it is
                            first touched) */
};

enum hd_command_kind {
    HD_COMMAND_PLAY = 1,     /* strike a mode: mode, direction, amplitude (in the mode's unit) */
    HD_COMMAND_RESET = 2,    /* clear contact state: slot and generation, or HD_NO_SLOT for all */
    HD_COMMAND_FORCES = 3,   /* forces off or on: value 0 or 1; 1 clears latched faults whose cause has ended */
    HD_COMMAND_OPERATOR = 4, /* motion of the hand: path; simulated device only */
    HD_COMMAND_MARK = 5      /* emit HD_EVENT_MARK with `value` at the tick that takes the command */
};

/* The largest number of marks between sending the command and reading its event. The event ring reserves room for
 * these, so their events are not lost; the sender must not exceed the number. */
#define HD_MARKS 64

struct hd_command {
    uint32_t kind;
    uint32_t revision; /* the command waits until this revision or a later one is in force */
    uint32_t slot;
    uint32_t generation;
    uint32_t value;
    double direction[2];
    double amplitude;
    struct hd_mode mode;
    struct hd_operator *path; /* the servo holds a reference while it uses it */
};

/* Streams: the newest value counts, and no reply is sent. The servo interpolates linearly to each value over the usual
 * time between two values, at least one period and at most the time-out.
 *
 * HD_STREAM_TARGET: target position of the simulated hand, m. Its reference moves there with at most
 * HD_STREAM_MAX_M_PER_S and stays. A target replaces a path, and a path replaces a target. HD_STREAM_FORCE: force in N,
 * added to the contact force like a constant field. It is limited to the force limit and changes no faster than
 * max_force_n / ramp_s. After the time-out without a value it fades to zero over the ramp. */
enum hd_stream_kind { HD_STREAM_TARGET = 0, HD_STREAM_FORCE = 1 };

#define HD_STREAMS 2
#define HD_STREAM_MAX_M_PER_S 2

/* Counters of one kind of stream. Each value is used or superseded at the latest a tick after it was sent. */
struct hd_stream_counters {
    uint64_t used;       /* values that the servo took */
    uint64_t superseded; /* values that a newer one replaced before a tick took them */
    uint64_t limited;    /* used values that were too large or too fast and were limited */
    uint64_t timeouts;   /* number of time-outs */
    uint64_t seq;        /* number of the last value used */
    uint64_t tick;       /* tick that took that value */
    uint32_t active;     /* 1: a value came within the time-out */
    uint32_t unused;
};

/* A snapshot of the servo's counters, read one by one, not atomically together. */
struct hd_counters {
    uint64_t ticks;
    uint64_t skipped;         /* periods missed */
    uint64_t overruns;        /* number of ticks before which periods were missed */
    uint64_t samples_dropped; /* samples lost because the telemetry ring was full */
    uint64_t events_dropped;
    uint64_t strikes;
    uint64_t glitches;
    uint64_t saturations;
    uint64_t overloads; /* seconds in which more periods than the threshold were missed */
    uint64_t suspends;  /* suspends of the machine */
    uint32_t revision;  /* revision in force */
    uint32_t faults;
    uint32_t forces_on;
    uint32_t running;
    uint32_t memory_refused; /* errno if tables have grown beyond the memory that may be locked; 0: as granted */
    uint32_t overloaded;     /* 1: the thread ended, or is about to, because of an overload; see hd_servo_restart */
    double missed_share;     /* missed fraction of the periods of the last complete second */
    uint32_t signs;          /* signs of a HID device: enum hd_signs_state, HD_SIGNS_PROBLEM_SHIFT, ... */
    uint32_t unused;
    struct hd_energy energy; /* energy after the last tick that the passivity observer saw */
};

#define HD_HISTOGRAM_BINS 82

/* A histogram of durations since the start. counts[0] counts those below hd_histogram_edge_ns(0), counts[i] those from
 * edge i - 1 to below edge i, the last bin those from the last edge on. */
struct hd_histogram {
    uint64_t counts[HD_HISTOGRAM_BINS];
    uint64_t sum_ns;
    int64_t max_ns;
};

struct hd_histograms {
    struct hd_histogram lateness; /* wake-up after the deadline, or after the first missed deadline */
    struct hd_histogram work;
};

struct hd_servo; /* opaque */

/* Allocates all memory that the servo uses. Its device is `sim` or `hid`, the other one is NULL. The servo holds it
 * until hd_servo_free; once started, only the servo thread uses `sim`. NULL: hd_invalid_reason. */
struct hd_servo *hd_servo_new(const struct hd_servo_config *config, struct hd_sim *sim, struct hd_hid *hid);
/* Locks memory, starts the thread and reports in `grant` what the system granted. HD_ERR_DENIED: HD_REALTIME_REQUIRED,
 * and refused. */
int hd_servo_start(struct hd_servo *servo, struct hd_grant *grant);
/* Fades the force out, puts a force of zero, ends the thread and joins it. */
int hd_servo_stop(struct hd_servo *servo);
/* Joins a thread that ended by overload, and sets the rate, for which the next table must be compiled. HD_ERR_INVALID:
 * no overload, or a rate that servo or simulated joystick refuse; nothing has changed. */
int hd_servo_set_rate(struct hd_servo *servo, double rate_hz, enum hd_overrun_action action);
/* Replaces the mode of a pending HD_COMMAND_PLAY by one that is compiled for the new rate, after hd_servo_set_rate.
 * `sequence`: number of the command. Does nothing if the command was already taken. */
int hd_servo_retune(struct hd_servo *servo, uint64_t sequence, const struct hd_mode *mode);
/* Starts the thread again after hd_servo_set_rate and, if the rate changed, hd_servo_publish. It continues as after a
 * stall: contacts are synchronised again without an onset, and the force fades in over the ramp. `faults` are latched.
 * Otherwise as hd_servo_start; memory stays locked, and `grant` repeats that result. */
int hd_servo_restart(struct hd_servo *servo, uint32_t faults, struct hd_grant *grant);
/* Stops the servo if it runs, and frees it. */
void hd_servo_free(struct hd_servo *servo);

/* Checks and copies a table, which is in force from the next tick on. One caller at a time. */
int hd_servo_publish(struct hd_servo *servo, const struct hd_table *table);
/* Sends `count` commands, all of them or, on an error, no command. *sequence is the number of the last. One caller at a
 * time. */
int hd_servo_send(struct hd_servo *servo, const struct hd_command *commands, size_t count, uint64_t *sequence);
/* Sends a value of a stream (enum hd_stream_kind); `seq` is chosen by the caller. There is always room. HD_ERR_INVALID:
 * not a finite number, a target beyond 1000 m, or a target without a simulated joystick. One caller at a time. */
int hd_servo_stream(struct hd_servo *servo, uint32_t kind, uint64_t seq, const double value[2]);
/* Reads the counters of a stream. `seq` and `tick` belong together; the other members are read one by one. `kind` is
 * below HD_STREAMS. Any thread. */
void hd_servo_stream_counters(const struct hd_servo *servo, uint32_t kind, struct hd_stream_counters *counters);
/* Wait until the servo has taken a command or revision. *tick is the tick that took it; for a revision, the first tick
 * rendered with it or a later one. HD_ERR_TIMEOUT. */
int hd_servo_wait_command(struct hd_servo *servo, uint64_t sequence, int64_t timeout_ns, uint64_t *tick);
int hd_servo_wait_revision(struct hd_servo *servo, uint32_t revision, int64_t timeout_ns, uint64_t *tick);
/* Heartbeat of the thread that serves commands. */
void hd_servo_beat(struct hd_servo *servo);
/* Sets the time at which forces fade out unless it is set again; 0: no lease. */
void hd_servo_set_lease(struct hd_servo *servo, int64_t deadline_ns);
void hd_servo_counters(const struct hd_servo *servo, struct hd_counters *counters);
void hd_servo_histograms(const struct hd_servo *servo, struct hd_histograms *histograms);
/* Returns an edge between bins: four edges per factor of two, from 128 ns on. `index` is below HD_HISTOGRAM_BINS -
 * 1. */
int64_t hd_histogram_edge_ns(uint32_t index);
/* Move up to `capacity` records out of the rings and return their number. *dropped is the total of lost records. One
 * reader. */
size_t hd_servo_read_samples(struct hd_servo *servo, struct hd_sample *samples, size_t capacity, uint64_t *dropped);
size_t hd_servo_read_events(struct hd_servo *servo, struct hd_event *events, size_t capacity, uint64_t *dropped);

#define HD_TOUCHED_MAX 1024

struct hd_touched {
    uint32_t slot;
    uint32_t generation;
};

/* Writes up to HD_TOUCHED_MAX records of the objects touched now into `touched` and returns their number. They are at
 * least as new as all samples and events read before, and complete even if events were dropped. One reader. */
size_t hd_servo_read_touched(struct hd_servo *servo, struct hd_touched *touched);
