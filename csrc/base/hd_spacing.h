/* The usual time between arrivals: a mean over the last few spacings, which one late or early arrival hardly changes.
 * Used by one thread. Seconds. */
#ifndef HD_SPACING_H
#define HD_SPACING_H

#include <stdint.h>

#include "base/hd_rt.h"

#define HD_SPACINGS 8u /* spacings in the mean */

/* All zero: no arrival yet. */
struct hd_spacing {
    double spacing_s[HD_SPACINGS]; /* ring of the newest spacings */
    uint32_t count;
    uint32_t next;
};

HD_RT static inline void hd_spacing_forget(struct hd_spacing *spacing) {
    spacing->count = spacing->next = 0;
}

HD_RT void hd_spacing_add(struct hd_spacing *spacing, double spacing_s);
/* Returns the mean, without the shortest and the longest if there are more than two; `otherwise` if there are no
 * spacings. */
HD_RT double hd_spacing_usual(const struct hd_spacing *spacing, double otherwise);

#endif
