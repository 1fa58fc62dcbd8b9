/* The boundary (hd_api.h), third part: the servo. */

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
    double stream_timeout_s; /* a stream ends when nothing came for this long: 0.002 to 1 */
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
    struct hd_operator *path; /* the servo holds it as long as it uses it */
};

/* What is streamed: the newest value counts, and there is no answer. The servo goes to it in a straight line over the
 * time that usually lies between two of them, one period at least and the time-out at most.
 *
 * HD_STREAM_TARGET: where the simulated hand wants to be, m; its reference goes there with at most
 * HD_STREAM_MAX_M_PER_S and stays. It takes the place of a path, and a path takes its place.
 * HD_STREAM_FORCE: N, part of the contact force like that of a constant field; at most the force limit, and never
 * faster than max_force_n / ramp_s. When none came for the time-out it goes to zero over the ramp. */
enum hd_stream_kind { HD_STREAM_TARGET = 0, HD_STREAM_FORCE = 1 };

#define HD_STREAMS 2
#define HD_STREAM_MAX_M_PER_S 2

/* Of one kind. All that were sent are used or superseded, at the latest a tick after they were sent. */
struct hd_stream_counters {
    uint64_t used;       /* those that the servo took */
    uint64_t superseded; /* those that a newer one took the place of before a tick could take them */
    uint64_t limited;    /* of those used, those that could not be followed as they were meant: too large, too fast */
    uint64_t timeouts;   /* times that none came for the time-out */
    uint64_t seq;        /* of the last one used */
    uint64_t tick;       /* that took it */
    uint32_t active;     /* one came within the time-out */
    uint32_t unused;
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
    uint64_t overloads; /* seconds in which more than the threshold was missed */
    uint64_t suspends;  /* of the machine */
    uint32_t revision;  /* in force */
    uint32_t faults;
    uint32_t forces_on;
    uint32_t running;
    uint32_t memory_refused; /* errno: tables have grown beyond what may be locked; 0: all is as granted */
    uint32_t overloaded;     /* the thread ended, or is about to, for hd_servo_restart */
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

/* Allocates everything that the servo will ever use. Its device is `sim` or `hid`, the other one is NULL. It is
 * held until hd_servo_free; `sim` is used by the servo thread alone once started. NULL: hd_invalid_reason. */
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
/* Sends a value of a stream (enum hd_stream_kind) under a number of the caller's. There is always room. HD_ERR_INVALID:
 * not a finite number, a target beyond 1000 m, or one without a simulated joystick. One caller at a time. */
int hd_servo_stream(struct hd_servo *servo, uint32_t kind, uint64_t seq, const double value[2]);
/* `seq` and `tick` belong together; the others are read each on its own. `kind` is below HD_STREAMS. Any thread. */
void hd_servo_stream_counters(const struct hd_servo *servo, uint32_t kind, struct hd_stream_counters *counters);
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
