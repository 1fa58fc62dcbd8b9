/* A HID device: the functions that the servo thread calls. Only hd_hid_step_await, which sleeps, makes a system call.
 * One thread at a time is the servo of a device. */
#ifndef HD_HID_H
#define HD_HID_H

#include "api/hd_core.h"
#include "base/hd_rt.h"

/* What the servo reads from a device in a tick. */
struct hd_look {
    struct hd_reading reading;
    uint32_t connection;              /* number of the connection that the position belongs to; 0: no position yet */
    uint32_t fresh;                   /* 1: the device reported a position since the last call */
    uint32_t gone;                    /* 1: not connected, or no position yet although an earlier connection had one */
    uint32_t idle;                    /* as in struct hd_signs_input */
    const struct hd_hid_signs *signs; /* signs of that connection */
};

/* Reads the newest position. The first one of a connection has interval 0, because the time before it is unknown. The
 * silence of a device that reports changes only counts as repeated reports of the same position. */
HD_RT void hd_hid_step_look(struct hd_hid *hid, int64_t now_ns, struct hd_look *look);
/* Puts a force, which the writer sends as soon as it can, unless a newer one replaces it. `now_ns`: time of the force;
 * it expires after 0.1 s. */
HD_RT void hd_hid_step_put(struct hd_hid *hid, int64_t now_ns, const double force_n[2]);
/* Returns 1 if the device plays effects (hd_hid_set_effects), so that strikes can be sent to it. */
HD_RT int hd_hid_step_has_effects(const struct hd_hid *hid);
/* Queues a strike of an effect with this coefficient for the writer; counted as lost if the queue is full. */
HD_RT void hd_hid_step_strike(struct hd_hid *hid, int64_t now_ns, uint32_t effect, const double force_n[2]);
/* Stops playing effects and drops queued strikes, because the forces are no longer fully on. */
HD_RT void hd_hid_step_silence(struct hd_hid *hid);
/* Sleeps until a position arrives that no earlier call has returned, or until `until_ns`. Returns 1 and the arrival
 * time if a position arrived. */
HD_RT int hd_hid_step_await(struct hd_hid *hid, int64_t until_ns, int64_t *arrival_ns);
/* Prefetches the memory that hd_hid_step_look and hd_hid_step_put use. */
HD_RT void hd_hid_step_fetch(const struct hd_hid *hid);
/* Control, before the servo starts: makes the reader wake the servo, which awaits positions. */
void hd_hid_await_enable(struct hd_hid *hid);
/* Control, before the servo starts: sets the time between two ticks, before which the writer need not poll for a new
 * force. Initially 0. */
void hd_hid_expect_ticks(struct hd_hid *hid, int64_t tick_ns);
/* Control, before a connection: sets the time limit for the writes at its end. Initially 0.5 s. */
void hd_hid_set_parting(struct hd_hid *hid, int64_t parting_ns);

/* An effect that ended and does not play again after this number of renewals counts as lost by the device. */
#define HD_FORGET_RENEWALS 2

/* Play state of a connection's effects over their renewals; initially zero. Used by the writer. */
struct hd_renewals {
    uint32_t played[HD_HID_EFFECTS]; /* consecutive renewals at which effect i played, up to `proof` */
    uint32_t waited[HD_HID_EFFECTS]; /* renewals since effect i ended; HD_FORGET_RENEWALS + 1: its loss was returned */
    int proven;                      /* 1: the device reports that renewed effects continue to play */
    int guessed;                     /* 1: a loss was returned without such a proof */
};

/* Returns whether the device has lost an effect; called once before each renewal. Bit i of `playing`: effect i plays;
 * of `ended`: it played and has stopped. `excused`: the device reported another reason for not playing. Renewals are
 * counted instead of time, because an effect that ran out while the writer was delayed plays again after the next
 * renewal. */
int hd_hid_forgotten(struct hd_renewals *renewals, const struct hd_hid_effects *effects, uint32_t playing,
                     uint32_t ended, int excused);

/* Control: takes a reference, which hd_hid_free drops. */
void hd_hid_hold(struct hd_hid *hid);
/* Returns the size of *hid, which the servo locks. */
size_t hd_hid_size(void);

#endif
