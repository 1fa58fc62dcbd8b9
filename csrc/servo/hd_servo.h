/* The servo, from the inside: what its files share. hd_servo.c draws its life, hd_servo_thread.c one period of it.
 *
 *   hd_servo.c             control: made, started, stopped, restarted at another rate
 *   hd_servo_thread.c      the thread: deadlines, and one tick from wake-up to the force that is put
 *   hd_servo_watch.c       what calls for zero force: a lost or frozen device, control, lease, load, suspends
 *   hd_servo_commands.c    commands, from control to the tick that takes them
 *   hd_servo_streams.c     streamed targets and forces, from control to the tick that uses the newest
 *   hd_servo_tables.c      tables, from control to the tick that takes them, in memory that is locked
 *   hd_servo_telemetry.c   samples, events, what is touched and counters, from the tick to control
 *
 * Who touches what:
 *   config, device, rings' memory     made by hd_servo_new, constant while the thread runs
 *   table_triple + worlds             the publisher fills the back one, the servo reads the front one
 *   changes, locked                   the publisher's own
 *   paths                             the sender's own
 *   commands                          the sender produces, the servo consumes
 *   streams                           as struct hd_stream says
 *   samples, events                   the servo produces, one reader consumes
 *   touching_triple + touching        the servo fills the back one, that reader reads the front one
 *   beat, lease_ns, streamed,
 *   stopping, memory_refused          control writes, the servo reads
 *   counters, taken_*, adopted_*      the servo writes, control reads
 *   the rest                          as struct hd_servo says
 *
 * Times are CLOCK_MONOTONIC nanoseconds. */
#ifndef HD_SERVO_H
#define HD_SERVO_H

#include <pthread.h>
#include <stdalign.h>

#include "base/hd_atomic.h"
#include "base/hd_histogram.h"
#include "base/hd_memory.h"
#include "base/hd_ring.h"
#include "base/hd_spacing.h"
#include "base/hd_triple.h"
#include "device/hd_device.h"
#include "scene/hd_world.h"
#include "tick/hd_tick.h"

#define HD_COMMAND_CAPACITY 1024u
#define HD_EVENT_RING_CAPACITY 8192u
/* Paths of commands under way, of one that is being taken and of the newest one taken. */
#define HD_PATH_CAPACITY (HD_COMMAND_CAPACITY + 2u)
#define HD_ADOPTED_CAPACITY 256u /* revisions whose first tick is remembered */
#define HD_CHANGE_CAPACITY 4096u
#define HD_STREAM_REMEMBERED 256u /* values of a stream whose ticks are remembered, a power of two */
#define HD_SUSPEND_NS 50000000    /* a suspend of the machine that is shorter is none */

/* What a world has missed since it was filled last. More slots than are changed do no harm. */
struct hd_changes {
    uint32_t all; /* 0 or 1 */
    uint32_t count;
    uint32_t slots[HD_CHANGE_CAPACITY];
};

/* What is touched, whole. */
struct hd_touching {
    uint32_t count;
    struct hd_touched touched[HD_TOUCHED_MAX];
};

/* A path that the thread may use: the servo holds it. */
struct hd_held_path {
    uint64_t sequence; /* of its command */
    struct hd_operator *path;
};

struct hd_streamed_value {
    uint64_t number; /* of this kind, from 1 on */
    uint64_t seq;    /* the sender's */
    double value[2];
};

/* Values of one kind. */
struct hd_stream {
    /* Control fills the back one and counts; the servo reads the front one. */
    struct hd_triple triple;
    struct hd_streamed_value values[3];
    uint64_t sent;
    /* The servo's own. */
    alignas(HD_CACHE_LINE) uint64_t taken; /* the number of the last one */
    int64_t taken_ns;                      /* the time of its tick */
    struct hd_spacing spacing;
    /* The servo writes, control reads. `used` comes after what it tells of. */
    struct hd_atomic_u64 used;
    struct hd_atomic_u64 superseded;
    struct hd_atomic_u64 limited;
    struct hd_atomic_u64 timeouts;
    struct hd_atomic_u32 active;
    struct hd_atomic_u64 used_seq[HD_STREAM_REMEMBERED];
    struct hd_atomic_u64 used_tick[HD_STREAM_REMEMBERED];
};

/* Grouped by who touches it and how often. What a tick touches between its wake-up and the force that is put comes
 * first and stands together, so that a servo that slept finds it in few cache lines; what another thread writes has
 * lines of its own. */
struct hd_servo {
    /* Each tick. Constant while the thread runs. */
    double period_ns;
    double period_s;
    struct hd_device device;
    struct hd_state *state;
    struct hd_servo_config config;

    /* Each tick. The servo's own. */
    alignas(HD_CACHE_LINE) const struct hd_world *world;
    uint64_t last_beat;
    uint64_t ticks_since_beat;
    double since_report_s;
    uint64_t load_periods; /* since load was judged last */
    uint64_t load_missed;
    int64_t last_work_ns;
    uint32_t missed;     /* periods, just before this tick */
    uint32_t until_look; /* ticks, to the next look whether the machine was suspended */
    uint32_t connection; /* of the device, that positions are of */
    uint8_t device_lost;
    uint8_t offloading;     /* the device may be playing something by itself */
    uint8_t ending;         /* the force fades out, whatever is still commanded */
    uint8_t stepping;       /* that is for another rate */
    uint8_t wanted;         /* stepping: whether forces are wanted then */
    uint8_t streaming;      /* a stream is followed */
    uint64_t streams_taken; /* as much of `streamed` was looked at */
    double last_force_n;
    int64_t late_ns;            /* of this tick, against the first deadline that it missed */
    uint64_t touches_published; /* of the state's */

    /* Each tick. Control writes, the servo reads. */
    alignas(HD_CACHE_LINE) struct hd_atomic_u64 beat;
    struct hd_atomic_i64 lease_ns;
    struct hd_atomic_u64 streamed; /* values sent, of all streams */
    struct hd_atomic_u32 stopping;
    struct hd_atomic_u32 memory_refused;

    /* Each tick. Both sides, each on lines of its own. */
    struct hd_triple table_triple;
    struct hd_ring commands;
    struct hd_ring samples;
    struct hd_ring events;

    /* Each tick, when the force has been put. The servo writes, control reads. */
    alignas(HD_CACHE_LINE) struct hd_atomic_u64 ticks;
    struct hd_atomic_u64 strikes;
    struct hd_atomic_u64 glitches;
    struct hd_atomic_u64 saturations;
    struct hd_atomic_u32 faults;
    struct hd_atomic_u32 forces_on;
    struct hd_atomic_u32 signs;
    struct hd_atomic_u32 revision;
    struct hd_atomic_f64 energy_j;
    struct hd_atomic_f64 largest_energy_j;
    struct hd_atomic_u64 contacts;
    struct hd_atomic_u64 restrained;
    struct hd_atomic_u64 acted;
    struct hd_histogram_counts lateness;
    struct hd_histogram_counts work;

    /* Now and then. The servo writes, control reads. */
    struct hd_atomic_u64 skipped;
    struct hd_atomic_u64 overruns;
    struct hd_atomic_u64 overloads;
    struct hd_atomic_u64 suspends;
    struct hd_atomic_f64 missed_share;
    struct hd_atomic_u32 running;
    struct hd_atomic_u32 overloaded;
    struct hd_atomic_u64 taken; /* commands taken; the tick that took each is in taken_tick */
    struct hd_atomic_u64 taken_tick[HD_COMMAND_CAPACITY];
    struct hd_atomic_u64 adopted; /* revisions taken; each with its first tick below */
    struct hd_atomic_u32 adopted_revision[HD_ADOPTED_CAPACITY];
    struct hd_atomic_u64 adopted_tick[HD_ADOPTED_CAPACITY];
    struct hd_triple touching_triple;
    struct hd_touching touching[3];

    /* While something is streamed. */
    struct hd_stream streams[HD_STREAMS];

    /* Now and then. The servo's own; control's while no thread runs. */
    alignas(HD_CACHE_LINE) uint32_t refused; /* memory_refused, as it was told */
    int64_t suspended_ns;                    /* by how much CLOCK_BOOTTIME is ahead, at most */
    double still_s;                          /* that the reported position has not changed, under force */
    double still_m[2];
    struct hd_signs signs_check;
    uint64_t pause_periods; /* that the first tick of a thread is told of, beside its own */
    int64_t ended_ns;
    double new_rate_hz; /* a restarted thread has another rate than the one before: its first tick says so; 0: no */

    /* Control's own, but for the world that the servo reads. */
    alignas(HD_CACHE_LINE) struct hd_world worlds[3];
    struct hd_changes changes[3]; /* of each world */
    uint32_t object_count;        /* of the table that was published last */
    double max_force_n;           /* of every table; 0: none was published yet */
    struct hd_region locked[3][HD_WORLD_REGIONS];
    int32_t memory_kind; /* of the grant: locked once, at the start */
    int32_t memory_error;
    uint32_t locked_slots;
    uint8_t locking; /* only regions are locked, so that those that come later must be, too */
    uint8_t started;
    uint64_t sent; /* commands sent so far */
    uint32_t path_count;
    struct hd_held_path paths[HD_PATH_CAPACITY]; /* in order */
    pthread_t thread;
};

/* hd_servo_thread.c: the thread, as pthread_create takes it. */
void *hd_servo_main(void *servo);

/* hd_servo_watch.c. Which part of the periods is missed, second after second. `missed`: of the `periods` since the tick
 * before, those that the clock went past; a device that leads and is slow makes periods, too. */
HD_RT void hd_servo_watch_load(struct hd_servo *servo, uint32_t periods, uint32_t missed, int64_t time_ns);
HD_RT void hd_servo_watch_suspends(struct hd_servo *servo, int64_t time_ns);
/* Everything else but the tick itself that can call for zero force. */
HD_RT void hd_servo_watch(struct hd_servo *servo, const struct hd_look *look, int64_t now_ns, int64_t time_ns);

/* hd_servo_streams.c: the newest value of each stream; what became too old ends its stream. */
HD_RT void hd_servo_follow_streams(struct hd_servo *servo, int64_t time_ns);
HD_RT static inline void hd_servo_take_streams(struct hd_servo *servo, int64_t time_ns) {
    if (servo->streaming || hd_atomic_u64_load_relaxed(&servo->streamed) != servo->streams_taken) {
        hd_servo_follow_streams(servo, time_ns);
    }
}

/* hd_servo_commands.c: commands of the table's revision or older, in order; a later one waits for its table. */
HD_RT void hd_servo_take_commands(struct hd_servo *servo, int64_t time_ns);
/* Control: sleeps for a fraction of a period. The servo makes no system call that could wake a waiter. */
void hd_servo_pause(const struct hd_servo *servo);

/* Control: frees the first paths. */
void hd_servo_free_paths(struct hd_servo *servo, uint32_t count);

/* hd_servo_tables.c: the newest table, if there is one that the servo has not seen. */
HD_RT void hd_servo_take_table(struct hd_servo *servo, int64_t time_ns);
/* Control: touches and locks everything that the servo uses. HD_ERR_DENIED. */
int hd_servo_lock_memory(struct hd_servo *servo, struct hd_grant *grant);

/* hd_servo_telemetry.c: leaves what the tick gave in the rings and counters. */
HD_RT void hd_servo_leave(struct hd_servo *servo, const struct hd_sample *sample);

#endif
