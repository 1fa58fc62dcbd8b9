/* The time between two positions of a HID device: what was measured, corrected by what is usual for it. */
#ifndef HD_HID_INTERVAL_H
#define HD_HID_INTERVAL_H

#include <stdint.h>

#include "base/hd_rt.h"

/* Of one connection. */
struct hd_hid_interval {
    int64_t time_ns;         /* of the last position, as the intervals add up */
    int64_t arrival_ns;      /* of the last position, as it was measured */
    uint64_t number;         /* of the last position */
    uint32_t on_change;      /* 1: the device reports only what changes */
    double usual_s;          /* between two reports; 0: not known yet */
    int64_t learned_ns;      /* of a device that reports what changes: usual_s is learned up to this arrival, */
    uint64_t learned_number; /* the one of this position */
};

/* The first position of a connection. */
HD_RT void hd_hid_interval_begin(struct hd_hid_interval *interval, int64_t arrival_ns, uint64_t number,
                                 uint32_t on_change);
/* A later position, the newest of those since the last call: the seconds since the one before, at least 1e-6. */
HD_RT double hd_hid_interval_next(struct hd_hid_interval *interval, int64_t arrival_ns, uint64_t number);
/* There is no new position. 0, or the seconds since the last one after which a device that reports only what changes is
 * taken to have said the same again. */
HD_RT double hd_hid_interval_silent(struct hd_hid_interval *interval, int64_t now_ns);

#endif
