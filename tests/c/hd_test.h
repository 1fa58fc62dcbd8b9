/* What every C test shares: a check that names itself, repeatable random numbers, and a sum that finds torn records. */
#ifndef HD_TEST_H
#define HD_TEST_H

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#define CHECK(condition)                                                              \
    do {                                                                              \
        if (!(condition)) {                                                           \
            fprintf(stderr, "%s:%d: not true: %s\n", __FILE__, __LINE__, #condition); \
            exit(1);                                                                  \
        }                                                                             \
    } while (0)

/* splitmix64: one word of state, and every seed is a good one. */
static inline uint64_t test_random(uint64_t *state) {
    uint64_t z = *state += 0x9e3779b97f4a7c15u;

    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
}

/* From 0 to `limit` - 1; the bias does not matter here. */
static inline size_t test_below(uint64_t *state, size_t limit) {
    return (size_t)(test_random(state) % limit);
}

/* Which of several runs this is, from 0: C_RUNS of the Makefile sets it. */
static inline uint64_t test_run(void) {
    const char *run = getenv("HD_RUN");

    return run == NULL ? 0 : strtoull(run, NULL, 10);
}

/* How many of the `whole` random cases this run has, from case test_run() * whole on. The same cases again would show
 * nothing new: each run after the first has a tenth as many, which are its own. */
static inline uint64_t test_share(uint64_t whole) {
    return test_run() == 0 ? whole : whole / 10;
}

#define TEST_WORDS 7

/* A record that cannot be torn unnoticed: every word follows from the first. */
struct test_record {
    uint64_t sequence;
    uint64_t words[TEST_WORDS];
};

static inline void test_record_fill(struct test_record *record, uint64_t sequence) {
    uint64_t state = sequence;

    record->sequence = sequence;
    for (size_t i = 0; i < TEST_WORDS; i++)
        record->words[i] = test_random(&state);
}

static inline int test_record_whole(const struct test_record *record) {
    uint64_t state = record->sequence;
    int whole = 1;

    for (size_t i = 0; i < TEST_WORDS; i++)
        whole &= record->words[i] == test_random(&state);
    return whole;
}

#endif
