/* Who holds a thing that several use: it is freed by the last of them, in whichever order they come to free it. A
 * collector of garbage that frees a simulation before the servo whose thread runs it must not take it from under that
 * thread. Zeroed: its maker alone. Control side, any thread. */
#ifndef HD_HOLDERS_H
#define HD_HOLDERS_H

#include <stdatomic.h>
#include <stdint.h>

struct hd_holders {
    _Atomic uint32_t others; /* beside one */
};

static inline void hd_holders_join(struct hd_holders *holders) {
    atomic_fetch_add_explicit(&holders->others, 1, memory_order_relaxed);
}

/* 1: that was the last one. */
static inline int hd_holders_leave(struct hd_holders *holders) {
    return atomic_fetch_sub_explicit(&holders->others, 1, memory_order_acq_rel) == 0;
}

#endif
