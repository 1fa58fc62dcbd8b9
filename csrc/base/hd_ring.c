/* Allocates the ring's memory and copies several records at once. hd_ring.h explains the model. */
#include <stdlib.h>
#include <string.h>

#include "base/hd_ring.h"

int hd_ring_init(struct hd_ring *ring, size_t record_size, size_t capacity) {
    void *slots = NULL;

    if (record_size == 0 || capacity == 0 || (capacity & (capacity - 1)) != 0)
        return hd_invalid("a ring needs a record size above 0 and a capacity that is a power of two, not %zu and %zu",
                          record_size, capacity);
    if (capacity > SIZE_MAX / record_size || posix_memalign(&slots, HD_CACHE_LINE, record_size * capacity) != 0)
        return HD_ERR_MEMORY;
    /* Also touches every page, so that the servo causes no page fault. */
    memset(slots, 0, record_size * capacity);
    memset(ring, 0, sizeof *ring);
    ring->slots = slots;
    ring->record_size = record_size;
    ring->capacity = capacity;
    return HD_OK;
}

void hd_ring_destroy(struct hd_ring *ring) {
    free(ring->slots);
    ring->slots = NULL;
}

HD_RT int hd_ring_push(struct hd_ring *ring, const void *record) {
    void *slot = hd_ring_reserve(ring);

    if (slot == NULL)
        return HD_ERR_FULL;
    memcpy(slot, record, ring->record_size);
    hd_ring_commit(ring);
    return HD_OK;
}

/* Returns how many of `count` records starting at `index` fit before the end of the memory. */
HD_RT static size_t before_end(const struct hd_ring *ring, uint64_t index, size_t count) {
    size_t room = (size_t)(ring->capacity - (index & (ring->capacity - 1)));

    return count < room ? count : room;
}

HD_RT int hd_ring_push_many(struct hd_ring *ring, const void *records, size_t count) {
    uint64_t write = hd_atomic_u64_load_relaxed(&ring->write);
    size_t first = before_end(ring, write, count);
    const unsigned char *from = records;

    if (count == 0)
        return HD_OK;
    if (count > hd_ring_free_space(ring))
        return HD_ERR_FULL;
    memcpy(hd_ring_slot(ring, write), from, first * ring->record_size);
    if (count > first)
        memcpy(ring->slots, from + first * ring->record_size, (count - first) * ring->record_size);
    hd_atomic_u64_store_release(&ring->write, write + count);
    return HD_OK;
}

HD_RT size_t hd_ring_pop_many(struct hd_ring *ring, void *out, size_t capacity) {
    uint64_t read = hd_atomic_u64_load_relaxed(&ring->read);
    unsigned char *to = out;
    size_t count;
    size_t first;

    ring->write_seen = hd_atomic_u64_load_acquire(&ring->write);
    count = (size_t)(ring->write_seen - read);
    if (count > capacity)
        count = capacity;
    if (count == 0)
        return 0;
    first = before_end(ring, read, count);
    memcpy(to, hd_ring_slot(ring, read), first * ring->record_size);
    if (count > first)
        memcpy(to + first * ring->record_size, ring->slots, (count - first) * ring->record_size);
    hd_atomic_u64_store_release(&ring->read, read + count);
    return count;
}
