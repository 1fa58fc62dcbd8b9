/* Stands for the run-time library of ThreadSanitizer: carries out the atomic accesses, and prints those that are named.
 * See tests/model/trace.c. Compiled without -fsanitize=thread. One thread. */
#include "hooks.h"

#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define PLACES 16

static struct place {
    const unsigned char *start;
    size_t size;
    const char *name;
    enum trace_side owner;
} places[PLACES];
static enum trace_side side; /* TRACE_NOBODY: between calls */

void trace_name(const void *start, size_t size, const char *name, enum trace_side owner) {
    for (struct place *place = places; place < places + PLACES; place++) {
        if (place->start == NULL) {
            *place = (struct place){start, size, name, owner};
            return;
        }
    }
    abort();
}

void trace_unname(const void *start) {
    for (struct place *place = places; place < places + PLACES; place++) {
        if (place->start == start)
            *place = (struct place){.start = NULL};
    }
}

void trace_begin(const char *call, enum trace_side of) {
    printf("BEGIN %s\n", call);
    side = of;
}

void trace_end(void) {
    side = TRACE_NOBODY;
    printf("END\n");
}

static const char *order_of(int order) {
    static const char *const names[] = {"relaxed", "consume", "acquire", "release", "acq_rel", "seq_cst"};

    return names[order];
}

/* `order` below 0: plain. */
static void step(const volatile void *at, const char *what, int order) {
    const unsigned char *byte = (const unsigned char *)(uintptr_t)at;

    for (const struct place *place = places; place < places + PLACES && side != TRACE_NOBODY; place++) {
        if (place->start == NULL || byte < place->start || byte >= place->start + place->size)
            continue;
        if (order == memory_order_relaxed && place->owner == side && strcmp(what, "load") == 0)
            continue;
        printf("STEP %s %s%s%s\n", what, place->name, order < 0 ? "" : " ", order < 0 ? "" : order_of(order));
    }
}

void *traced_memcpy(void *to, const void *from, size_t size) {
    step(from, "read", -1);
    step(to, "write", -1);
    return memmove(to, from, size);
}

void *traced_memset(void *to, int value, size_t size) {
    step(to, "write", -1);
    return memset(to, value, size);
}

/* ---- What the compiler calls ------------------------------------------------------------------------------------ */

void __tsan_init(void);
void __tsan_init(void) {
}
void __tsan_func_entry(void *caller);
void __tsan_func_entry(void *caller) {
    (void)caller;
}
void __tsan_func_exit(void);
void __tsan_func_exit(void) {
}

#define PLAIN(NAME, WHAT)          \
    void __tsan_##NAME(void *at);  \
    void __tsan_##NAME(void *at) { \
        step(at, WHAT, -1);        \
    }

PLAIN(read1, "read")
PLAIN(read2, "read")
PLAIN(read4, "read")
PLAIN(read8, "read")
PLAIN(read16, "read")
PLAIN(write1, "write")
PLAIN(write2, "write")
PLAIN(write4, "write")
PLAIN(write8, "write")
PLAIN(write16, "write")

void __tsan_read_range(void *at, long size);
void __tsan_read_range(void *at, long size) {
    (void)size;
    step(at, "read", -1);
}
void __tsan_write_range(void *at, long size);
void __tsan_write_range(void *at, long size) {
    (void)size;
    step(at, "write", -1);
}

#define ATOMIC(BITS)                                                                                             \
    uint##BITS##_t __tsan_atomic##BITS##_load(const _Atomic uint##BITS##_t *at, int order);                      \
    uint##BITS##_t __tsan_atomic##BITS##_load(const _Atomic uint##BITS##_t *at, int order) {                     \
        step(at, "load", order);                                                                                 \
        return atomic_load(at);                                                                                  \
    }                                                                                                            \
    void __tsan_atomic##BITS##_store(_Atomic uint##BITS##_t *at, uint##BITS##_t value, int order);               \
    void __tsan_atomic##BITS##_store(_Atomic uint##BITS##_t *at, uint##BITS##_t value, int order) {              \
        step(at, "store", order);                                                                                \
        atomic_store(at, value);                                                                                 \
    }                                                                                                            \
    uint##BITS##_t __tsan_atomic##BITS##_exchange(_Atomic uint##BITS##_t *at, uint##BITS##_t value, int order);  \
    uint##BITS##_t __tsan_atomic##BITS##_exchange(_Atomic uint##BITS##_t *at, uint##BITS##_t value, int order) { \
        step(at, "exchange", order);                                                                             \
        return atomic_exchange(at, value);                                                                       \
    }

ATOMIC(32)
ATOMIC(64)
