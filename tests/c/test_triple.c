/* The triple buffer alone: ownership of the three indices in one thread, then a writer and a reader on two. */
#include <pthread.h>
#include <sched.h>

#include "base/hd_triple.h"
#include "hd_test.h"

static void starts_with_nothing_new(void) {
    struct hd_triple triple;

    hd_triple_init(&triple);
    CHECK(hd_triple_front(&triple) == 0);
    CHECK(hd_triple_acquire(&triple) == 0);
    CHECK(hd_triple_back(&triple) != 0);
}

/* Against a model: which buffer holds which publication, and which of them was the last. */
static void gives_the_latest_once(void) {
    struct hd_triple triple;
    uint64_t buffer[3] = {0, 0, 0};
    uint64_t published = 0;
    uint64_t acquired = 0;
    uint64_t seed = 4;

    hd_triple_init(&triple);
    for (int step = 0; step < 10000; step++) {
        if (test_below(&seed, 2) == 0) {
            CHECK(hd_triple_back(&triple) < 3 && hd_triple_back(&triple) != hd_triple_front(&triple));
            buffer[hd_triple_back(&triple)] = ++published;
            hd_triple_publish(&triple);
        } else {
            CHECK(hd_triple_acquire(&triple) == (acquired != published));
            acquired = published;
        }
        CHECK(buffer[hd_triple_front(&triple)] == acquired);
    }
    CHECK(published > 4000);
}

struct exchange {
    struct hd_triple triple;
    struct test_record buffer[3];
    uint64_t count;
};

static void *publish(void *argument) {
    struct exchange *exchange = argument;

    for (uint64_t sequence = 1; sequence <= exchange->count; sequence++) {
        test_record_fill(&exchange->buffer[hd_triple_back(&exchange->triple)], sequence);
        hd_triple_publish(&exchange->triple);
        /* Now and then in step with the reader, so that both the overtaken and the taken case occur. */
        if (sequence % 64 == 0)
            sched_yield();
    }
    return NULL;
}

static uint64_t crosses_threads(uint64_t count) {
    struct exchange exchange = {.count = count};
    const struct test_record *front;
    pthread_t writer;
    uint64_t last = 0;
    uint64_t changes = 0;

    hd_triple_init(&exchange.triple);
    test_record_fill(&exchange.buffer[0], 0);
    CHECK(pthread_create(&writer, NULL, publish, &exchange) == 0);
    do {
        int changed = hd_triple_acquire(&exchange.triple);

        front = &exchange.buffer[hd_triple_front(&exchange.triple)];
        CHECK(changed ? front->sequence > last : front->sequence == last);
        CHECK(test_record_whole(front));
        last = front->sequence;
        changes += (uint64_t)changed;
        if (!changed)
            sched_yield();
    } while (last < count);
    CHECK(pthread_join(writer, NULL) == 0);
    CHECK(hd_triple_acquire(&exchange.triple) == 0);
    CHECK(changes >= 1 && changes <= count);
    return changes;
}

int main(void) {
    starts_with_nothing_new();
    gives_the_latest_once();
    printf("test_triple: ok, %llu of 500000 were taken\n", (unsigned long long)crosses_threads(500000));
    return 0;
}
