/* The time between two positions of a HID device: the measured time, corrected by the usual one. */
#ifndef HD_HID_INTERVAL_H
#define HD_HID_INTERVAL_H

#include <stdint.h>

#include "base/hd_rt.h"

/* The intervals of one connection. */
struct hd_hid_interval {
    int64_t time_ns;         /* time of the last position: the sum of the corrected intervals */
    int64_t arrival_ns;      /* measured arrival of the last position */
    uint64_t number;         /* number of the last position */
    uint32_t on_change;      /* 1: the device reports changes only */
    double usual_s;          /* usual time between two reports; 0: not known yet */
    int64_t learned_ns;      /* usual_s is learned up to this arrival, if on_change is 1 */
    uint64_t learned_number; /* number of the position that arrived then */
};

/* Starts with the first position of a connection. */
HD_RT void hd_hid_interval_begin(struct hd_hid_interval *interval, int64_t arrival_ns, uint64_t number,
                                 uint32_t on_change);
/* Takes a later position, the newest since the last call, and returns the seconds since the previous one, at least
 * 1e-6. */
HD_RT double hd_hid_interval_next(struct hd_hid_interval *interval, int64_t arrival_ns, uint64_t number);
/* Called without a new position. Returns 0, or for a device that reports changes only the seconds since the last
 * position, after which its silence counts as a report of the same position. */
HD_RT double hd_hid_interval_silent(struct hd_hid_interval *interval, int64_t now_ns);

#endif
