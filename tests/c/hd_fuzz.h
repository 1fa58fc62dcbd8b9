/* What fuzz targets share: values out of bytes. Where the bytes end, zeros follow. */
#ifndef HD_FUZZ_H
#define HD_FUZZ_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

struct source {
    const uint8_t *data;
    size_t left;
};

static inline uint64_t take_bytes(struct source *source, size_t count) {
    uint64_t value = 0;

    for (size_t i = 0; i < count && source->left > 0; i++, source->left--)
        value |= (uint64_t)*source->data++ << (8 * i);
    return value;
}

/* Mostly between `low` and `high`; some are numbers that tend to break things, some any bits. */
static inline double take_number(struct source *source, double low, double high) {
    static const double hostile[] = {
        0.0,     -0.0,     1.0,   -1.0,   5e-324,           -2e-308,           1e-30,      1e9, -1e9, 1e154,
        1.7e308, -1.7e308, 1e300, 1e-300, (double)INFINITY, -(double)INFINITY, (double)NAN};
    uint64_t choice = take_bytes(source, 2);
    uint64_t bits;
    double number;

    if (choice < 64) {
        bits = take_bytes(source, 8);
        memcpy(&number, &bits, sizeof number);
        return number;
    }
    if (choice < 320)
        return hostile[take_bytes(source, 1) % (sizeof hostile / sizeof hostile[0])];
    return low + (high - low) * (double)choice / 65535.0;
}

#endif
