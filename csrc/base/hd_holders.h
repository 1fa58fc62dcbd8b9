/* Reference counts: an object with several holders is freed by the last of them, in whichever order they release it. If
 * Python's garbage collector frees a simulation before the servo, the servo's thread can still use it. Zeroed, the
 * count means one holder, its maker. Control side, any thread. */
#ifndef HD_HOLDERS_H
#define HD_HOLDERS_H

#include <stdatomic.h>
#include <stdint.h>

struct hd_holders {
    _Atomic uint32_t others; /* holders in addition to the first */
};

static inline void hd_holders_join(struct hd_holders *holders) {
    atomic_fetch_add_explicit(&holders->others, 1, memory_order_relaxed);
}

/* Returns 1 if this was the last holder, who then frees the object. */
static inline int hd_holders_leave(struct hd_holders *holders) {
    return atomic_fetch_sub_explicit(&holders->others, 1, memory_order_acq_rel) == 0;
}

#endif
