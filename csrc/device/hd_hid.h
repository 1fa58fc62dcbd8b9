/* A HID device, from the inside of the core: what the servo thread calls. None of that makes a system call but
 * hd_hid_step_await, which sleeps. One thread at a time is the servo of a device. */
#ifndef HD_HID_H
#define HD_HID_H

#include "api/hd_core.h"
#include "base/hd_rt.h"

/* What the servo sees of a device in one look. */
struct hd_look {
    struct hd_reading reading;
    uint32_t connection; /* number of the connection that the position is of; 0: none yet */
    uint32_t fresh;      /* 1: the device has said where it is since the last look */
    uint32_t gone;       /* 1: there is no connection, or it has not yet said where it is and an earlier one had */
    const struct hd_hid_signs *signs; /* of that connection */
};

/* The newest position. The first of a connection has interval 0: nothing is known of what was before it. A device that
 * reports only what changes is taken to have said the same again, while it is silent. */
HD_RT void hd_hid_step_look(struct hd_hid *hid, int64_t now_ns, struct hd_look *look);
/* The writer sends this force as soon as it can, unless another one overtakes it. `now_ns`: a force older than 0.1 s is
 * none. */
HD_RT void hd_hid_step_put(struct hd_hid *hid, int64_t now_ns, const double force_n[2]);
/* 1: the device plays effects by itself (hd_hid_set_effects), so that strikes may be put. */
HD_RT int hd_hid_step_has_effects(const struct hd_hid *hid);
/* The device plays an effect with this coefficient, as soon as the writer comes to it; counted where there is no room.
 */
HD_RT void hd_hid_step_strike(struct hd_hid *hid, int64_t now_ns, uint32_t effect, const double force_n[2]);
/* The forces are no longer fully on: what plays is stopped, what was put and not sent is forgotten. */
HD_RT void hd_hid_step_silence(struct hd_hid *hid);
/* Sleeps until there is a position that no earlier call has told of, or `until_ns`. 1: there is, and when it came. */
HD_RT int hd_hid_step_await(struct hd_hid *hid, int64_t until_ns, int64_t *arrival_ns);
/* Asks for the memory that a look and a put touch. */
HD_RT void hd_hid_step_fetch(const struct hd_hid *hid);
/* Control, before the servo starts: somebody awaits positions, so the reader has to wake. */
void hd_hid_await_enable(struct hd_hid *hid);
/* Control, before the servo starts: the writer need not look for a force sooner than that after another. 0 at first. */
void hd_hid_expect_ticks(struct hd_hid *hid, int64_t tick_ns);
/* Control, before a connection: how long what is written at its end may take. 0.5 s at first. */
void hd_hid_set_parting(struct hd_hid *hid, int64_t parting_ns);

#define HD_FORGET_RENEWALS 2 /* an effect that ended plays again after so many, or is forgotten */

/* What the effects of a connection did over their renewals; zero at its beginning. The writer's. */
struct hd_renewals {
    uint32_t played[HD_HID_EFFECTS]; /* it played at so many in a row, up to `proof` */
    uint32_t waited[HD_HID_EFFECTS]; /* since it ended; one more than HD_FORGET_RENEWALS: that was told */
    int proven;                      /* effects play on when they are renewed, by what the device says */
    int guessed;                     /* it was told without that */
};

/* Whether the device has forgotten an effect; asked once whenever effects are about to be renewed. Bit i of `playing`:
 * effect i plays; of `ended`: it did, and does not. `excused`: the device has said otherwise why it shows none.
 * Renewals are counted and not time: an effect that ran out because the writer was held up plays again after the next
 * one. */
int hd_hid_forgotten(struct hd_renewals *renewals, const struct hd_hid_effects *effects, uint32_t playing,
                     uint32_t ended, int excused);

/* Control: one more holds it, and calls hd_hid_free. */
void hd_hid_hold(struct hd_hid *hid);
/* How much memory *hid is: the servo locks it. */
size_t hd_hid_size(void);

#endif
