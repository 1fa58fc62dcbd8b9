/* Triple buffer: passes the newest value that one writer thread publishes to one reader thread. Neither waits for the
 * other; older values are skipped. The three buffers belong to the caller; this file handles only their indices 0, 1,
 * 2, each of which has exactly one owner at any time:
 *
 *        writer                     shared                      reader
 *      +--------+    publish     +-----------+    acquire     +---------+
 *      |  back  | <------------> |  middle   | <------------> |  front  |
 *      +--------+   exchange,    | and `new` |   exchange,    +---------+
 *       may write    sets new    +-----------+   clears new    may read
 *       buffer[back]              nobody's                    buffer[front]
 *
 * Both exchanges are acquire and release: the reader sees the complete buffer that it acquires, and the writer may
 * overwrite the buffer that it gets back, because the reader has finished with it. */
#ifndef HD_TRIPLE_H
#define HD_TRIPLE_H

#include <stdalign.h>
#include <stdint.h>

#include "base/hd_atomic.h"
#include "base/hd_rt.h"

#define HD_TRIPLE_NEW 4u   /* set in `middle`: published and not yet acquired */
#define HD_TRIPLE_INDEX 3u /* the bits of `middle` that are an index */

struct hd_triple {
    alignas(HD_CACHE_LINE) struct hd_atomic_u32 middle; /* written and read by both */
    alignas(HD_CACHE_LINE) uint32_t back;               /* the writer's alone */
    alignas(HD_CACHE_LINE) uint32_t front;              /* the reader's alone */
};

/* Control side, before either thread uses it: the reader starts with index 0, and no value is new. */
void hd_triple_init(struct hd_triple *triple);

/* Writer: returns the index of the buffer that it may fill now. */
HD_RT static inline uint32_t hd_triple_back(const struct hd_triple *triple) {
    return triple->back;
}

/* Writer: hands the back buffer over as the newest; `back` is another buffer afterwards, with old contents. */
HD_RT void hd_triple_publish(struct hd_triple *triple);

/* Reader: takes the newest buffer if one was published since the last call; returns 1 if `front` changed, else 0. */
HD_RT static inline int hd_triple_acquire(struct hd_triple *triple) {
    if ((hd_atomic_u32_load_relaxed(&triple->middle) & HD_TRIPLE_NEW) == 0)
        return 0;
    triple->front = hd_atomic_u32_exchange_acq_rel(&triple->middle, triple->front) & HD_TRIPLE_INDEX;
    return 1;
}

/* Reader: returns the index of the buffer that it may read now. */
HD_RT static inline uint32_t hd_triple_front(const struct hd_triple *triple) {
    return triple->front;
}

#endif
