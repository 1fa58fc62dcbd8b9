/* The inside of a HID device: two mailboxes that the servo uses without a system call and, while connected, one thread
 * at the far end of each.
 *
 *   hd_hid_control.c     control: connects, disconnects, reports the state of the device
 *   hd_hid_mailboxes.c   the functions that the servo calls
 *   hd_hid_reader.c      polls, drains to the newest report, publishes its position with the time of arrival
 *   hd_hid_writer.c      takes the newest force, writes the reports that changed, renews effects in time
 *   hd_hid_connection.c  shared by these threads and control: ends and frees a connection, notifies control
 *
 *                +---------- servo ----------+
 *     positions  |                           |  forces
 *     (triple)   |                           v  (triple)
 *             reader                      writer
 *                ^                           |
 *     read()     +---- fd, a hidraw node ----+  write(), which blocks until the transfer is done
 *
 * Only strikes of device effects are queued (hd_effects.h); in the mailboxes the newest value replaces older ones. The
 * servo makes no system call that could wake the writer, so the writer polls for a new force: every 50 us from the time
 * at which the next tick is due.
 *
 * A connection owns a copy of the plan and a duplicate of the descriptor. A thread that meets an error ends it for
 * both. Control joins both threads within a time limit: a writer that does not return from write() is abandoned. It is
 * detached and becomes the owner of the connection; when it returns it touches nothing else, and frees it. The atomic
 * `phase` decides: control may only change WRITING to GIVEN_UP, and the writer only WRITING to IDLE.
 *
 * A device that still takes reports is never left with a force. If control ends the connection in an orderly way or an
 * error ends it, the writer's last reports are a force of zero and the stop script. An abandoned writer sends only a
 * force of zero, because the device may have a new connection already. Only an end that is not orderly (HD_END_NOW)
 * sends nothing.
 *
 * Who writes and reads what:
 *   positions, arrivals, the reader's counters     the reader writes; control before the reader starts
 *   forces, effect_queue                            the servo writes, the writer reads while its phase is IDLE
 *   seen_* and what follows in struct hd_hid       the servo alone
 *   the writer's counters                          the writer, while its phase is IDLE
 *   `playing`, `ended`, `told` of hd_connection    the reader writes, the writer reads
 *   connection, parting_ns                         control alone: one thread at a time connects and disconnects
 *   connected, error, reset, returns_ns, event_fd  any thread
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
    int64_t time_ns;     /* time of arrival */
    uint64_t number;     /* number of positions of this connection, including this one */
    uint32_t connection; /* number of the connection, from 1 */
    uint32_t on_change;
    struct hd_hid_signs signs;
};

struct hd_force {
    double force_n[2];
    int64_t time_ns;
};

struct hd_connection {
    struct hd_hid *hid; /* must not be used once the phase is GIVEN_UP */
    struct hd_hid_plan plan;
    int fd;
    int end_fd;  /* readable once the connection has ended; never read */
    int left_fd; /* readable once the writer has ended */
    int64_t start_ns;
    struct hd_atomic_u32 phase; /* enum hd_phase of the writer */
    struct hd_atomic_u32 end;   /* enum hd_end; the thread that ends the connection writes, the writer reads */
    int64_t parting_ns;         /* time limit for the writes at the end */
    int64_t parting_until_ns;   /* deadline of these writes; control sets it before an orderly end */
    int parting_error;          /* error of these writes; the writer sets it, control reads it after the join */
    pthread_t reader;
    pthread_t writer;

    struct hd_position known; /* used by the reader alone */
    uint32_t axes_known;

    struct hd_atomic_u32 playing; /* bit i: the device reports that effect i plays */
    struct hd_atomic_u32 ended;   /* bit i: effect i played and has stopped */
    struct hd_atomic_u32 told;    /* 1: the device has reported that an effect plays */

    uint8_t sent[HD_HID_MESSAGES][HD_HID_REPORT_BYTES]; /* from here on used by the writer alone */
    uint32_t sent_once;                                 /* bit i: message i was sent */
    double direction_rad;                               /* direction of the last force that was not zero */
    int begun;                                          /* 1: the first pass, which sends a force of zero, is over */
    int leaving;                                        /* 1: the writes at the end have begun */
    int64_t leaving_until_ns;                           /* deadline of the writes at the end */
    int64_t next_write_ns;
    int64_t written_ns;     /* time at which the last write returned */
    int64_t fresh_until_ns; /* time until which the writer waits for a force newer than written_ns */
    int64_t last_pass_ns;
    int64_t idle_ns;    /* time slept since the last pass */
    int64_t restore_ns; /* time at which the next message of the restore script is due */
    uint32_t restored;  /* index of that message, modulo the script's length */
    struct hd_renewals renewals;
    struct hd_effect_sender effect_sender;
};

struct hd_hid {
    struct hd_triple position_triple;
    struct hd_position positions[3];
    struct hd_triple force_triple;
    struct hd_force forces[3];
    struct hd_effect_queue effect_queue;
    struct hd_atomic_u32 has_effects; /* 1: the device plays effects; control writes, the servo reads */

    alignas(HD_CACHE_LINE) struct hd_atomic_u32 arrivals; /* number of positions of all connections; a futex */
    struct hd_atomic_u32 awaited;                         /* 1: the servo sleeps on `arrivals` */
    struct hd_atomic_i64 tick_ns;                         /* shortest time between two forces of the servo */
    struct hd_atomic_i64 arrived_ns;                      /* arrival of the newest position */
    struct hd_atomic_u32 states;
    struct hd_atomic_u32 states_known;
    struct hd_atomic_u32 states_seen; /* states that were not 0 at some time */
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
    struct hd_atomic_u32 paused;     /* 1: the device is paused */
    struct hd_atomic_i64 returns_ns; /* time at which the last reset was cleared or the last pause ended */
    int event_fd;
    int64_t parting_ns; /* used by control alone, as `connection` */
    struct hd_connection *connection;
    struct hd_holders holders;

    alignas(HD_CACHE_LINE) struct hd_reading seen; /* from here on used by the servo alone */
    struct hd_hid_interval seen_interval;
    uint32_t seen_connection;
    uint32_t seen_arrivals;
    struct hd_hid_signs seen_signs;
};

/* hd_hid_reader.c and hd_hid_writer.c: the main functions of the threads, for pthread_create. */
void *hd_hid_reader_main(void *connection);
void *hd_hid_writer_main(void *connection);
/* The reader, and control before the reader starts: reads all waiting reports and publishes the newest position. A
 * report is counted last, so a thread that has read the count finds the contents of the report. `watching`: 1 once
 * control has set the device up, so that changes are not caused by the set-up. Returns 0, or the errno of an error that
 * ends the connection. */
int hd_hid_drain(struct hd_connection *connection, int64_t now_ns, int watching);

/* hd_hid_connection.c: makes an eventfd readable. */
void hd_hid_signal(int fd);
/* Ends the connection because of an error, an errno; the first error counts. */
void hd_connection_fail(struct hd_connection *connection, int error);
void hd_connection_free(struct hd_connection *connection);

#endif
