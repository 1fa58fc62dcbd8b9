/* A HID device, from the inside: two mailboxes that the servo uses without a system call, and while connected a thread
 * at the far end of each.
 *
 *   hd_hid_control.c     control: connects, disconnects, tells how the device is
 *   hd_hid_mailboxes.c   what the servo calls
 *   hd_hid_reader.c      poll, drain to the newest report, publish its position with the time at which poll returned
 *   hd_hid_writer.c      take the newest force, compose, write what has changed; renew in time
 *   hd_hid_connection.c  what those threads and control do alike: end a connection, free it, tell control
 *
 *                +---------- servo ----------+
 *     positions  |                           |  forces
 *     (triple)   |                           v  (triple)
 *             reader                      writer
 *                ^                           |
 *     read()     +---- fd, a hidraw node ----+  write(), which blocks until the transfer is done
 *
 * Nothing queues but what the device is to play by itself (hd_effects.h): what was overtaken in a mailbox is never
 * seen. The servo makes no system call that could wake the writer, so the writer looks for a new force: every 50 us
 * from when the next tick may be on.
 *
 * A connection owns a copy of the plan and a duplicate of the descriptor. Whichever thread meets an error ends it for
 * both. Control joins both, within a bound: a writer that does not come back from write() is given up. It is detached,
 * the connection becomes its own, it touches nothing else when it comes back, and frees it. What decides is one atomic,
 * `phase`: control may only take WRITING to GIVEN_UP, and the writer only WRITING to IDLE.
 *
 * No end leaves a force on a device that still takes reports: where control ends it in an orderly way or an error does,
 * the writer's last reports are a force of zero and the stop script; one that was given up sends a force of zero, and
 * no more: the device may have a connection anew. Only control's other end sends nothing.
 *
 * Who touches what:
 *   positions, arrivals, the reader's counters     the reader writes; control before the reader starts
 *   forces, effect_queue                            the servo writes, the writer reads while its phase is IDLE
 *   seen_* and what follows in struct hd_hid       the servo's own
 *   the writer's counters                          the writer, while its phase is IDLE
 *   playing, ended, told in struct hd_connection   the reader writes, the writer reads
 *   connection, parting_ns                         control's own: one thread at a time connects and disconnects
 *   connected, error, reset, returns_ns, event_fd  anybody
 *
 * Times are CLOCK_MONOTONIC nanoseconds. */
#ifndef HD_HID_CONNECTION_H
#define HD_HID_CONNECTION_H

#include <pthread.h>

#include "base/hd_atomic.h"
#include "base/hd_holders.h"
#include "base/hd_triple.h"
#include "device/hd_effects.h"
#include "device/hd_hid.h"
#include "device/hd_hid_interval.h"

enum hd_phase { HD_PHASE_IDLE = 0, HD_PHASE_WRITING = 1, HD_PHASE_GIVEN_UP = 2 };
enum hd_end { HD_END_NOT = 0, HD_END_NOW = 1, HD_END_ORDERLY = 2, HD_END_FAILED = 3 };

struct hd_position {
    double position_m[2];
    int64_t time_ns;     /* of arrival */
    uint64_t number;     /* positions of this connection so far */
    uint32_t connection; /* its number, from 1 */
    uint32_t on_change;
    struct hd_hid_signs signs;
};

struct hd_force {
    double force_n[2];
    int64_t time_ns;
};

struct hd_connection {
    struct hd_hid *hid; /* not to be followed once the phase is GIVEN_UP */
    struct hd_hid_plan plan;
    int fd;
    int end_fd;  /* readable from the end on: nobody reads it */
    int left_fd; /* readable once the writer has left */
    int64_t start_ns;
    struct hd_atomic_u32 phase; /* enum hd_phase, of the writer */
    struct hd_atomic_u32 end;   /* enum hd_end; whoever ends it writes, the writer reads */
    int64_t parting_ns;         /* for what is written at the end */
    int64_t parting_until_ns;   /* control writes it before an orderly end */
    int parting_error;          /* the writer writes it, control reads it after the join */
    pthread_t reader;
    pthread_t writer;

    struct hd_position known; /* the reader's own */
    uint32_t axes_known;

    struct hd_atomic_u32 playing; /* bit i: the device says that effect i plays */
    struct hd_atomic_u32 ended;   /* bit i: it played, and does not */
    struct hd_atomic_u32 told;    /* it has said that one plays */

    uint8_t sent[HD_HID_MESSAGES][HD_HID_REPORT_BYTES]; /* the writer's own, from here on */
    uint32_t sent_once;                                 /* bit: that message was sent */
    double direction_rad;                               /* of the last force that had one */
    int begun;                                          /* the first pass is over: it is of no force */
    int leaving;                                        /* the last one is, */
    int64_t leaving_until_ns;                           /* until then at most */
    int64_t next_write_ns;
    int64_t written_ns;     /* when the last write was done */
    int64_t fresh_until_ns; /* until then a force newer than that is waited for */
    int64_t last_pass_ns;
    int64_t idle_ns;    /* since the last pass */
    int64_t restore_ns; /* when the next message of that script is due, */
    uint32_t restored;  /* and which */
    struct hd_renewals renewals;
    struct hd_effect_sender effect_sender;
};

struct hd_hid {
    struct hd_triple position_triple;
    struct hd_position positions[3];
    struct hd_triple force_triple;
    struct hd_force forces[3];
    struct hd_effect_queue effect_queue;
    struct hd_atomic_u32 has_effects; /* control writes, the servo reads: the device plays effects */

    alignas(HD_CACHE_LINE) struct hd_atomic_u32 arrivals; /* positions so far, of all connections: a futex */
    struct hd_atomic_u32 awaited;                         /* somebody sleeps on it */
    struct hd_atomic_i64 tick_ns;                         /* a force comes that long after another, not sooner */
    struct hd_atomic_i64 arrived_ns;                      /* of the newest */
    struct hd_atomic_u32 states;
    struct hd_atomic_u32 states_known;
    struct hd_atomic_u32 states_seen; /* were not 0 once */
    struct hd_atomic_u32 effects_told;
    struct hd_atomic_u64 reports;
    struct hd_atomic_u64 read_positions;
    struct hd_atomic_u64 short_reports;
    struct hd_atomic_i64 last_report_ns;

    alignas(HD_CACHE_LINE) struct hd_atomic_u64 writes;
    struct hd_atomic_u64 sent_forces;
    struct hd_atomic_i64 write_ns;
    struct hd_atomic_i64 write_interval_ns;

    alignas(HD_CACHE_LINE) struct hd_atomic_u32 connected;
    struct hd_atomic_u32 connection_number; /* control writes, the servo reads */
    struct hd_atomic_u32 error;
    struct hd_atomic_u32 reset;
    struct hd_atomic_u32 paused;     /* somebody has paused the device */
    struct hd_atomic_i64 returns_ns; /* when the last reset was answered, or a pause was over */
    int event_fd;
    int64_t parting_ns; /* control's own, as connection */
    struct hd_connection *connection;
    struct hd_holders holders;

    alignas(HD_CACHE_LINE) struct hd_reading seen; /* the servo's own, from here on */
    struct hd_hid_interval seen_interval;
    uint32_t seen_connection;
    uint32_t seen_arrivals;
    struct hd_hid_signs seen_signs;
};

/* hd_hid_reader.c and hd_hid_writer.c: the threads, as pthread_create takes them. */
void *hd_hid_reader_main(void *connection);
void *hd_hid_writer_main(void *connection);
/* The reader, and control before there is one: reads what is there, as far as the newest, and publishes that. A report
 * is counted last: whoever has read the count finds what the report said. `watching`: control has set the device up, so
 * that what changes is not its doing. 0, or the errno of what ends the connection. */
int hd_hid_drain(struct hd_connection *connection, int64_t now_ns, int watching);

/* hd_hid_connection.c. Makes an eventfd readable. */
void hd_hid_signal(int fd);
/* The connection is over, by the errno of what a thread met; the first one counts. */
void hd_connection_fail(struct hd_connection *connection, int error);
void hd_connection_free(struct hd_connection *connection);

#endif
