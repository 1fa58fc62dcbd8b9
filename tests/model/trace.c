/* What the triple buffer and the ring do to shared memory, step by step: for tests/model/verify.py, which compares it
 * with the steps of the models.
 *
 * hd_triple.c, hd_ring.c and this file are compiled with -fsanitize=thread, which puts a call before each access to
 * memory; tests/model/hooks.c takes the calls. One thread does everything, in an order that a seed decides. What it
 * prints are lines as the models print them: BEGIN, the name of a call, its steps, END. */
#include <string.h>

#include "../c/hd_test.h"
#include "hooks.h"

#include "base/hd_ring.h"
#include "base/hd_triple.h"

#define WORDS 3

static struct hd_triple triple;
static struct hd_ring ring;
static uint64_t records[4][WORDS];
static uint64_t sink;

static void publish(void) {
    trace_begin("publish", TRACE_WRITER);
    memset(records[hd_triple_back(&triple)], 1, sizeof records[0]);
    hd_triple_publish(&triple);
    trace_end();
}

static void acquire(void) {
    trace_begin("acquire", TRACE_READER);
    hd_triple_acquire(&triple);
    sink += records[hd_triple_front(&triple)][0];
    trace_end();
}

static void push(const uint64_t *record) {
    trace_begin("push", TRACE_WRITER);
    if (hd_ring_push(&ring, record) != HD_OK)
        hd_ring_drop(&ring);
    trace_end();
}

static void take(void) {
    const uint64_t *record;

    trace_begin("take", TRACE_READER);
    if ((record = hd_ring_peek(&ring)) != NULL) {
        sink += record[0];
        hd_ring_release(&ring);
    }
    trace_end();
}

int main(void) {
    uint64_t out[4][WORDS];
    uint64_t seed = 1;

    hd_triple_init(&triple);
    CHECK(hd_ring_init(&ring, sizeof records[0], 2) == HD_OK);
    trace_name(&triple.middle, sizeof triple.middle, "middle", TRACE_BOTH);
    trace_name(records, sizeof records, "slot", TRACE_NOBODY);
    trace_name(&ring.write, sizeof ring.write, "write", TRACE_WRITER);
    trace_name(&ring.read, sizeof ring.read, "read", TRACE_READER);
    trace_name(&ring.dropped, sizeof ring.dropped, "dropped", TRACE_WRITER);
    for (int step = 0; step < 4000; step++) {
        if (test_below(&seed, 2) == 0)
            publish();
        else
            acquire();
    }
    trace_unname(records);
    trace_name(ring.slots, 2 * sizeof records[0], "slot", TRACE_NOBODY);
    for (int step = 0; step < 4000; step++) {
        size_t count = 1 + test_below(&seed, 3);

        switch (test_below(&seed, 4)) {
        case 0:
            push(records[0]);
            break;
        case 1:
            take();
            break;
        case 2:
            trace_begin("push_many", TRACE_WRITER);
            hd_ring_push_many(&ring, records, count);
            trace_end();
            break;
        default:
            trace_begin("pop_many", TRACE_READER);
            hd_ring_pop_many(&ring, out, count);
            trace_end();
        }
    }
    hd_ring_destroy(&ring);
    return sink == 0;
}
