/* The usual time between things that arrive one after the other: a mean over the last few that one late or early
 * arrival does not move. Owned by one thread. Seconds. */
#ifndef HD_SPACING_H
#define HD_SPACING_H

#include <stdint.h>

#include "base/hd_rt.h"

#define HD_SPACINGS 8u

/* All zero: nothing is known. */
struct hd_spacing {
    double spacing_s[HD_SPACINGS]; /* the newest, a ring */
    uint32_t count;
    uint32_t next;
};

HD_RT static inline void hd_spacing_forget(struct hd_spacing *spacing) {
    spacing->count = spacing->next = 0;
}

HD_RT void hd_spacing_add(struct hd_spacing *spacing, double spacing_s);
/* The mean without the shortest and the longest where there are more than two; `otherwise` where there is none. */
HD_RT double hd_spacing_usual(const struct hd_spacing *spacing, double otherwise);

#endif
