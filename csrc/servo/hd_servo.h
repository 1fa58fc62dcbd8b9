/* The inside of the servo, shared by its files. hd_servo.c describes its life, hd_servo_thread.c one period of it.
 *
 *   hd_servo.c             control: makes, starts and stops the servo, restarts it at another rate
 *   hd_servo_thread.c      the thread: deadlines, and one tick from wake-up to the force that is put
 *   hd_servo_watch.c       causes of zero force: a lost or frozen device, control, lease, load, suspends
 *   hd_servo_commands.c    commands, from control to the tick that takes them
 *   hd_servo_streams.c     streamed targets and forces, from control to the tick that uses the newest
 *   hd_servo_tables.c      tables, from control to the tick that takes them, in locked memory
 *   hd_servo_telemetry.c   samples, events, touched objects and counters, from the tick to control
 *
 * Which thread uses what:
 *   config, device, rings' memory     made by hd_servo_new, constant while the thread runs
 *   table_triple + worlds             the publisher fills the back one, the servo reads the front one
 *   changes, locked                   the publisher alone
 *   paths                             the sender alone
 *   commands                          the sender produces, the servo consumes
 *   streams                           see struct hd_stream
 *   samples, events                   the servo produces, one reader consumes
 *   touching_triple + touching        the servo fills the back one, that reader reads the front one
 *   beat, lease_ns, streamed,
 *   stopping, memory_refused          control writes, the servo reads
 *   counters, taken_*, adopted_*      the servo writes, control reads
 *   the other members                 see struct hd_servo
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

#define HD_COMMAND_CAPACITY 1024u    /* commands that wait */
#define HD_EVENT_RING_CAPACITY 8192u /* events that wait for the reader */
/* Largest number of paths held: those of waiting commands, of one being taken and of the newest one taken. */
#define HD_PATH_CAPACITY (HD_COMMAND_CAPACITY + 2u)
#define HD_ADOPTED_CAPACITY 256u  /* revisions whose first tick is kept */
#define HD_CHANGE_CAPACITY 4096u  /* changed slots that are kept for a world; with more it is reloaded */
#define HD_STREAM_REMEMBERED 256u /* values of a stream whose ticks are kept, a power of two */
#define HD_SUSPEND_NS 50000000    /* shorter suspends of the machine are ignored */

/* The changes since a world was last filled. Slots that did not change may be included. */
struct hd_changes {
    uint32_t all; /* 0 or 1 */
    uint32_t count;
    uint32_t slots[HD_CHANGE_CAPACITY];
};

/* All touched objects. */
struct hd_touching {
    uint32_t count;
    struct hd_touched touched[HD_TOUCHED_MAX];
};

/* A path that the thread may use, to which the servo holds a reference. */
struct hd_held_path {
    uint64_t sequence; /* number of its command */
    struct hd_operator *path;
};

struct hd_streamed_value {
    uint64_t number; /* number among the values of this kind, from 1 on */
    uint64_t seq;    /* chosen by the sender */
    double value[2];
};

/* The values of one kind of stream. */
struct hd_stream {
    /* Control fills the back buffer and counts; the servo reads the front one. */
    struct hd_triple triple;
    struct hd_streamed_value values[3];
    uint64_t sent;
    /* Used by the servo alone. */
    alignas(HD_CACHE_LINE) uint64_t taken; /* number of the last value taken */
    int64_t taken_ns;                      /* time of the tick that took it */
    struct hd_spacing spacing;
    /* The servo writes, control reads. `used` is written last, after the members that it counts. */
    struct hd_atomic_u64 used;
    struct hd_atomic_u64 superseded;
    struct hd_atomic_u64 limited;
    struct hd_atomic_u64 timeouts;
    struct hd_atomic_u32 active;
    struct hd_atomic_u64 used_seq[HD_STREAM_REMEMBERED];
    struct hd_atomic_u64 used_tick[HD_STREAM_REMEMBERED];
};

/* Grouped by thread and by frequency of use. The members that a tick uses between its wake-up and the force that is put
 * come first, so that a servo that slept needs few cache lines. Members that another thread writes are on separate
 * lines. */
struct hd_servo {
    /* Each tick. Constant while the thread runs. */
    double period_ns;
    double period_s;
    struct hd_device device;
    struct hd_state *state;
    struct hd_servo_config config;

    /* Each tick. Used by the servo alone. */
    alignas(HD_CACHE_LINE) const struct hd_world *world;
    uint64_t last_beat;
    uint64_t ticks_since_beat;
    double since_report_s;
    uint64_t load_periods; /* periods since load was last evaluated */
    uint64_t load_missed;
    int64_t last_work_ns;
    uint32_t missed;     /* periods missed just before this tick */
    uint32_t until_look; /* ticks until the next check whether the machine was suspended */
    uint32_t connection; /* number of the device's connection to which positions belong */
    uint8_t device_lost;
    uint8_t offloading;     /* 1: the device may be playing effects */
    uint8_t ending;         /* 1: the force fades out, whatever commands arrive */
    uint8_t stepping;       /* 1: `ending` is for a restart at another rate */
    uint8_t wanted;         /* stepping: 1 if forces are on after the restart */
    uint8_t streaming;      /* 1: a stream is active */
    uint64_t streams_taken; /* value of `streamed` up to which streams were taken */
    double last_force_n;
    int64_t late_ns;            /* lateness of this tick after its deadline, or the first deadline that it missed */
    uint64_t touches_published; /* number of the state's touches that were published */

    /* Each tick. Control writes, the servo reads. */
    alignas(HD_CACHE_LINE) struct hd_atomic_u64 beat;
    struct hd_atomic_i64 lease_ns;
    struct hd_atomic_u64 streamed; /* values sent, of all streams */
    struct hd_atomic_u32 stopping;
    struct hd_atomic_u32 memory_refused;

    /* Each tick. Used by both sides, on separate lines. */
    struct hd_triple table_triple;
    struct hd_ring commands;
    struct hd_ring samples;
    struct hd_ring events;

    /* Each tick, after the force was put. The servo writes, control reads. */
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

    /* Not in each tick. The servo writes, control reads. */
    struct hd_atomic_u64 skipped;
    struct hd_atomic_u64 overruns;
    struct hd_atomic_u64 overloads;
    struct hd_atomic_u64 suspends;
    struct hd_atomic_f64 missed_share;
    struct hd_atomic_u32 running;
    struct hd_atomic_u32 overloaded;
    struct hd_atomic_u64 taken; /* number of commands taken; taken_tick has the tick that took each */
    struct hd_atomic_u64 taken_tick[HD_COMMAND_CAPACITY];
    struct hd_atomic_u64 adopted; /* number of revisions taken; each with its first tick below */
    struct hd_atomic_u32 adopted_revision[HD_ADOPTED_CAPACITY];
    struct hd_atomic_u64 adopted_tick[HD_ADOPTED_CAPACITY];
    struct hd_triple touching_triple;
    struct hd_touching touching[3];

    /* Each tick while a stream is active. */
    struct hd_stream streams[HD_STREAMS];

    /* Not in each tick. Used by the servo alone, or by control while no thread runs. */
    alignas(HD_CACHE_LINE) uint32_t refused; /* memory_refused as last reported by an event */
    int64_t suspended_ns;                    /* upper bound of CLOCK_BOOTTIME minus CLOCK_MONOTONIC */
    double still_s;                          /* time for which the position has not changed under force */
    double still_m[2];
    struct hd_signs signs_check;
    uint64_t pause_periods; /* periods that are added to those of a thread's first tick */
    int64_t ended_ns;
    double new_rate_hz; /* rate of a restarted thread if it changed, which its first tick reports; 0: unchanged */

    /* Used by control alone, except the world that the servo reads. */
    alignas(HD_CACHE_LINE) struct hd_world worlds[3];
    struct hd_changes changes[3]; /* changes that each world has not received yet */
    uint32_t object_count;        /* objects of the table published last */
    double max_force_n;           /* force limit of all tables; 0: no table was published yet */
    struct hd_region locked[3][HD_WORLD_REGIONS];
    int32_t memory_kind; /* kind in the grant: memory is locked once, at the start */
    int32_t memory_error;
    uint32_t locked_slots;
    uint8_t locking; /* 1: only regions are locked, so later regions must be locked, too */
    uint8_t started;
    uint64_t sent; /* number of commands sent */
    uint32_t path_count;
    struct hd_held_path paths[HD_PATH_CAPACITY]; /* in the order of their commands */
    pthread_t thread;
};

/* hd_servo_thread.c: the main function of the thread, for pthread_create. */
void *hd_servo_main(void *servo);

/* hd_servo_watch.c. Computes the share of missed periods for each second. `missed`: those of the `periods` since the
 * tick before that the servo missed; with HD_CLOCK_DEVICE a slow device also causes periods without a tick, which are
 * not missed. */
HD_RT void hd_servo_watch_load(struct hd_servo *servo, uint32_t periods, uint32_t missed, int64_t time_ns);
HD_RT void hd_servo_watch_suspends(struct hd_servo *servo, int64_t time_ns);
/* Checks all other causes of zero force, except those that the tick itself detects. */
HD_RT void hd_servo_watch(struct hd_servo *servo, const struct hd_look *look, int64_t now_ns, int64_t time_ns);

/* hd_servo_streams.c: takes the newest value of each stream, and ends streams whose last value is too old. */
HD_RT void hd_servo_follow_streams(struct hd_servo *servo, int64_t time_ns);
HD_RT static inline void hd_servo_take_streams(struct hd_servo *servo, int64_t time_ns) {
    if (servo->streaming || hd_atomic_u64_load_relaxed(&servo->streamed) != servo->streams_taken) {
        hd_servo_follow_streams(servo, time_ns);
    }
}

/* hd_servo_commands.c: takes commands of the table's revision or older, in order; a later one waits for its table. */
HD_RT void hd_servo_take_commands(struct hd_servo *servo, int64_t time_ns);
/* Control: sleeps for a fraction of a period. The servo makes no system call that could wake a waiter. */
void hd_servo_pause(const struct hd_servo *servo);

/* Control: frees the first paths. */
void hd_servo_free_paths(struct hd_servo *servo, uint32_t count);

/* hd_servo_tables.c: takes the newest table if one was published since the last call. */
HD_RT void hd_servo_take_table(struct hd_servo *servo, int64_t time_ns);
/* Control: touches and locks all memory that the servo uses. HD_ERR_DENIED. */
int hd_servo_lock_memory(struct hd_servo *servo, struct hd_grant *grant);

/* hd_servo_telemetry.c: writes the results of a tick to rings and counters. */
HD_RT void hd_servo_leave(struct hd_servo *servo, const struct hd_sample *sample);

#endif
