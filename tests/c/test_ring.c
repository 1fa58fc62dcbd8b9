/* The ring alone: its corners in one thread, then two threads that check every record for loss, order and tearing. */
#include <pthread.h>
#include <sched.h>
#include <string.h>

#include "base/hd_ring.h"
#include "hd_test.h"

static void refuses_bad_sizes(void) {
    struct hd_ring ring;

    CHECK(hd_ring_init(&ring, 8, 0) == HD_ERR_INVALID);
    CHECK(hd_ring_init(&ring, 0, 8) == HD_ERR_INVALID);
    CHECK(hd_ring_init(&ring, 8, 12) == HD_ERR_INVALID);
    CHECK(strstr(hd_invalid_reason(), "12") != NULL);
    CHECK(hd_ring_init(&ring, 4096, (size_t)1 << 62) == HD_ERR_MEMORY);
}

static void fills_and_empties(size_t capacity) {
    struct hd_ring ring;
    struct test_record out;
    struct test_record record = {0};

    CHECK(hd_ring_init(&ring, sizeof record, capacity) == HD_OK);
    CHECK((uintptr_t)ring.slots % HD_CACHE_LINE == 0);
    for (uint64_t lap = 0; lap < 5; lap++) {
        CHECK(hd_ring_peek(&ring) == NULL);
        CHECK(hd_ring_pop_many(&ring, &out, 1) == 0);
        for (size_t i = 0; i < capacity; i++) {
            CHECK(hd_ring_free_space(&ring) == capacity - i);
            test_record_fill(&record, lap * capacity + i);
            CHECK(hd_ring_push(&ring, &record) == HD_OK);
        }
        CHECK(hd_ring_free_space(&ring) == 0);
        CHECK(hd_ring_reserve(&ring) == NULL);
        CHECK(hd_ring_push(&ring, &record) == HD_ERR_FULL);
        CHECK(hd_ring_push_many(&ring, &record, 1) == HD_ERR_FULL);
        CHECK(hd_ring_push_many(&ring, &record, 0) == HD_OK);
        for (size_t i = 0; i < capacity; i++) {
            const struct test_record *seen = hd_ring_peek(&ring);

            CHECK(seen != NULL && seen->sequence == lap * capacity + i && test_record_whole(seen));
            CHECK(hd_ring_peek(&ring) == seen);
            hd_ring_release(&ring);
        }
    }
    hd_ring_destroy(&ring);
}

static void shows_nothing_before_the_commit(void) {
    struct hd_ring ring;
    uint64_t *slot;

    CHECK(hd_ring_init(&ring, sizeof *slot, 4) == HD_OK);
    slot = hd_ring_reserve(&ring);
    CHECK(slot != NULL && hd_ring_reserve(&ring) == slot);
    *slot = 7;
    CHECK(hd_ring_peek(&ring) == NULL);
    hd_ring_commit(&ring);
    CHECK(hd_ring_peek(&ring) == slot && *slot == 7);
    CHECK(hd_ring_dropped(&ring) == 0);
    hd_ring_drop(&ring);
    hd_ring_drop(&ring);
    CHECK(hd_ring_dropped(&ring) == 2);
    hd_ring_destroy(&ring);
}

/* Every mixture of one and many, against a count of what must be inside; `start` puts the indices anywhere. */
static void keeps_order_around_the_end(uint64_t start) {
    enum { CAPACITY = 8, LARGEST = CAPACITY + 3 };
    struct hd_ring ring;
    uint64_t in[LARGEST];
    uint64_t out[LARGEST];
    uint64_t pushed = 0;
    uint64_t popped = 0;
    uint64_t seed = 1;

    CHECK(hd_ring_init(&ring, sizeof in[0], CAPACITY) == HD_OK);
    hd_atomic_u64_store_relaxed(&ring.write, start);
    hd_atomic_u64_store_relaxed(&ring.read, start);
    ring.read_seen = ring.write_seen = start;
    for (int step = 0; step < 20000; step++) {
        size_t count = test_below(&seed, LARGEST + 1);
        size_t held = (size_t)(pushed - popped);

        for (size_t i = 0; i < count; i++)
            in[i] = pushed + i;
        if (hd_ring_push_many(&ring, in, count) == HD_OK) {
            CHECK(count <= CAPACITY - held);
            pushed += count;
        } else {
            CHECK(count > CAPACITY - held);
        }
        held = (size_t)(pushed - popped);
        count = test_below(&seed, LARGEST + 1);
        CHECK(hd_ring_pop_many(&ring, out, count) == (count < held ? count : held));
        for (size_t i = 0; i < count && i < held; i++)
            CHECK(out[i] == popped + i);
        popped += count < held ? count : held;
    }
    CHECK(pushed > 20000);
    hd_ring_destroy(&ring);
}

struct traffic {
    struct hd_ring ring;
    uint64_t count;
    int lossy;
};

static void *produce(void *argument) {
    struct traffic *traffic = argument;
    struct test_record batch[5];
    struct test_record *slot;
    uint64_t sequence = 0;
    uint64_t seed = 2;

    while (sequence < traffic->count) {
        size_t many = test_below(&seed, 5) + 1;
        int status = HD_OK;

        if (many > traffic->count - sequence)
            many = 1;
        if (many > 1) {
            for (size_t i = 0; i < many; i++)
                test_record_fill(&batch[i], sequence + i);
            status = hd_ring_push_many(&traffic->ring, batch, many);
        } else if ((slot = hd_ring_reserve(&traffic->ring)) != NULL) {
            test_record_fill(slot, sequence);
            hd_ring_commit(&traffic->ring);
        } else {
            status = HD_ERR_FULL;
        }
        if (status == HD_OK) {
            sequence += many;
        } else if (traffic->lossy) {
            for (size_t i = 0; i < many; i++)
                hd_ring_drop(&traffic->ring);
            sequence += many;
            /* Now and then a full ring is given a chance to empty, so that both cases occur. */
            if (sequence % 16 == 0)
                sched_yield();
        } else {
            sched_yield();
        }
    }
    return NULL;
}

/* The consumer runs until it has seen everything that was not dropped. */
static uint64_t crosses_threads(uint64_t count, int lossy) {
    struct traffic traffic = {.count = count, .lossy = lossy};
    struct test_record out[7];
    pthread_t producer;
    uint64_t received = 0;
    uint64_t next = 0;
    uint64_t seed = 3;

    CHECK(hd_ring_init(&traffic.ring, sizeof(struct test_record), 64) == HD_OK);
    CHECK(pthread_create(&producer, NULL, produce, &traffic) == 0);
    while (received + hd_ring_dropped(&traffic.ring) < count) {
        const struct test_record *seen;
        size_t got = 0;

        if (test_below(&seed, 2) == 0) {
            got = hd_ring_pop_many(&traffic.ring, out, 1 + test_below(&seed, 7));
            for (size_t i = 0; i < got; i++) {
                CHECK(test_record_whole(&out[i]));
                CHECK(lossy ? out[i].sequence >= next : out[i].sequence == next);
                next = out[i].sequence + 1;
            }
        } else if ((seen = hd_ring_peek(&traffic.ring)) != NULL) {
            CHECK(test_record_whole(seen));
            CHECK(lossy ? seen->sequence >= next : seen->sequence == next);
            next = seen->sequence + 1;
            hd_ring_release(&traffic.ring);
            got = 1;
        }
        received += got;
        if (got == 0)
            sched_yield();
    }
    CHECK(pthread_join(producer, NULL) == 0);
    CHECK(received + hd_ring_dropped(&traffic.ring) == count);
    CHECK(lossy || received == count);
    CHECK(hd_ring_peek(&traffic.ring) == NULL);
    hd_ring_destroy(&traffic.ring);
    return received;
}

int main(void) {
    refuses_bad_sizes();
    fills_and_empties(1);
    fills_and_empties(8);
    shows_nothing_before_the_commit();
    keeps_order_around_the_end(0);
    keeps_order_around_the_end(UINT64_MAX - 100);
    crosses_threads(500000, 0);
    printf("test_ring: ok, %llu of 500000 found room when nobody waited\n",
           (unsigned long long)crosses_threads(500000, 1));
    return 0;
}
