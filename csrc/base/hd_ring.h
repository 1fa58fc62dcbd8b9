/* A ring of fixed-size records from one producer thread to one consumer thread; it loses and reorders nothing.
 *
 *          read                     write
 *            |                        |
 *      +---+-v-+---+---+---+---+---+--v+---+
 *      |   | r | r | r | r | r | r |   |   |
 *      +---+---+---+---+---+---+---+---+---+
 *
 * Both indices only grow (64 bits last 58,000 years at 10 MHz) and are masked when a slot is addressed, so that write -
 * read is the number of records held, from 0 (empty) to capacity (full), and no slot is wasted to distinguish the two.
 *
 * Invariants: capacity is a power of two; the producer alone stores `write`, with release after the record is complete;
 * the consumer alone stores `read`, with release after it has finished with the record; each loads the other's index
 * with acquire, and only if its copy of that index says that the ring is full (or empty). Each side writes to a
 * separate cache line.
 *
 * Threads: `init` and `destroy` are called by the control side while no other thread uses the ring. The comment of each
 * other function names its thread. HD_RT functions are real-time safe. */
#ifndef HD_RING_H
#define HD_RING_H

#include <stdalign.h>
#include <stddef.h>
#include <stdint.h>

#include "api/hd_core.h"
#include "base/hd_atomic.h"
#include "base/hd_rt.h"

struct hd_ring {
    /* Constant after init. */
    unsigned char *slots;
    size_t record_size;
    uint64_t capacity;
    /* Written by the producer; `read_seen` is never ahead of `read`, which errs towards full. */
    alignas(HD_CACHE_LINE) struct hd_atomic_u64 write; /* read by the consumer */
    struct hd_atomic_u64 dropped;                      /* read by anyone */
    uint64_t read_seen;
    /* Written by the consumer; `write_seen` is never ahead of `write`, which errs towards empty. */
    alignas(HD_CACHE_LINE) struct hd_atomic_u64 read; /* read by the producer */
    uint64_t write_seen;
};

/* Allocates zeroed memory for `capacity` records, a power of two. After HD_ERR_INVALID or HD_ERR_MEMORY nothing is
 * allocated. */
int hd_ring_init(struct hd_ring *ring, size_t record_size, size_t capacity);
void hd_ring_destroy(struct hd_ring *ring);

HD_RT static inline void *hd_ring_slot(const struct hd_ring *ring, uint64_t index) {
    return ring->slots + (size_t)(index & (ring->capacity - 1)) * ring->record_size;
}

/* Producer: returns a lower bound of the number of records that can be pushed now. */
HD_RT static inline size_t hd_ring_free_space(struct hd_ring *ring) {
    ring->read_seen = hd_atomic_u64_load_acquire(&ring->read);
    return (size_t)(ring->capacity - (hd_atomic_u64_load_relaxed(&ring->write) - ring->read_seen));
}

/* Producer: returns the next slot, to be filled in place and then committed; NULL if the ring is full. Until the commit
 * the consumer does not see it, and reserving again returns the same slot. */
HD_RT static inline void *hd_ring_reserve(struct hd_ring *ring) {
    uint64_t write = hd_atomic_u64_load_relaxed(&ring->write);

    if (write - ring->read_seen == ring->capacity && hd_ring_free_space(ring) == 0)
        return NULL;
    return hd_ring_slot(ring, write);
}

/* Producer: hands the reserved slot over to the consumer. */
HD_RT static inline void hd_ring_commit(struct hd_ring *ring) {
    hd_atomic_u64_store_release(&ring->write, hd_atomic_u64_load_relaxed(&ring->write) + 1);
}

/* Producer: copies one record in. HD_OK or HD_ERR_FULL. */
HD_RT int hd_ring_push(struct hd_ring *ring, const void *record);
/* Producer: copies `count` records in, all or none; the consumer sees them at once. HD_OK or HD_ERR_FULL. */
HD_RT int hd_ring_push_many(struct hd_ring *ring, const void *records, size_t count);

/* Producer: counts a record that was lost because the ring was full. */
HD_RT static inline void hd_ring_drop(struct hd_ring *ring) {
    hd_atomic_u64_add_relaxed(&ring->dropped, 1);
}

/* Any thread: returns the total number of lost records. */
HD_RT static inline uint64_t hd_ring_dropped(const struct hd_ring *ring) {
    return hd_atomic_u64_load_relaxed(&ring->dropped);
}

/* Consumer: returns the oldest record, valid until it is released; NULL if the ring is empty. */
HD_RT static inline const void *hd_ring_peek(struct hd_ring *ring) {
    uint64_t read = hd_atomic_u64_load_relaxed(&ring->read);

    if (read == ring->write_seen) {
        ring->write_seen = hd_atomic_u64_load_acquire(&ring->write);
        if (read == ring->write_seen)
            return NULL;
    }
    return hd_ring_slot(ring, read);
}

/* Consumer: returns the slot of the peeked record to the producer. */
HD_RT static inline void hd_ring_release(struct hd_ring *ring) {
    hd_atomic_u64_store_release(&ring->read, hd_atomic_u64_load_relaxed(&ring->read) + 1);
}

/* Consumer: moves up to `capacity` records out, oldest first; returns how many. */
HD_RT size_t hd_ring_pop_many(struct hd_ring *ring, void *out, size_t capacity);

#endif
