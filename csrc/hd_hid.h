/* A HID device, from the inside of the core: what the servo thread calls. None of it makes a system call but
 * hd_hid_step_await, which sleeps. One thread at a time is the servo of a device. */
#ifndef HD_HID_H
#define HD_HID_H

#include "hd_core.h"
#include "hd_rt.h"

/* What the servo sees of a device in one look. */
struct hd_look {
    struct hd_reading reading;
    uint32_t connection; /* number of the connection that the position is of; 0: none yet */
    uint32_t fresh;      /* 1: the device has said where it is since the last look */
    uint32_t gone;       /* 1: there is no connection */
};

/* The newest position. The first of a connection has interval 0: nothing is known of what was before it. A device that
 * reports only what changes is taken to have said the same again, while it is silent. */
HD_RT void hd_hid_step_look(struct hd_hid *hid, int64_t now_ns, struct hd_look *look);
/* The writer sends this force as soon as it can, unless another one overtakes it. `now_ns`: a force older than 0.1 s is
 * none. */
HD_RT void hd_hid_step_put(struct hd_hid *hid, int64_t now_ns, const double force_n[2]);
/* Sleeps until there is a position that no earlier call has told of, or `until_ns`. 1: there is, and when it came. */
HD_RT int hd_hid_step_await(struct hd_hid *hid, int64_t until_ns, int64_t *arrival_ns);
/* Control, before the servo starts: somebody awaits positions, so the reader has to wake. */
void hd_hid_await_enable(struct hd_hid *hid);

/* How much memory *hid is: the servo locks it. */
size_t hd_hid_size(void);

#endif
