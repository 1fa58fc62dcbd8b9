/* Includes the boundary (the three headers hd_api*.h) with an include guard, and asserts the layout of its records. The
 * boundary itself must not contain these, because cffi reads it verbatim. Every C file of the core includes this
 * header. */
#ifndef HD_CORE_H
#define HD_CORE_H

#include <assert.h>
#include <stddef.h>
#include <stdint.h>

/* In this order: each needs the declarations of the previous one. */
#include "api/hd_api.h"

#include "api/hd_api_device.h"

#include "api/hd_api_servo.h"

static_assert(sizeof(struct hd_sample) == 112, "the telemetry record is 112 bytes without padding");
static_assert(sizeof(struct hd_object) == 80 && sizeof(struct hd_mode) == 360 && sizeof(struct hd_piece) == 24 &&
                  sizeof(struct hd_material) == 72 + 18 * 8 + 4 * sizeof(struct hd_mode) &&
                  sizeof(struct hd_noise) == 32 + 8 + 4 * 8,
              "table records have no padding");

/* Stores why a check failed, as one printf-like line for hd_invalid_reason, and returns HD_ERR_INVALID. Control side
 * only. */
#if defined(__GNUC__)
__attribute__((format(printf, 1, 2)))
#endif
int hd_invalid(const char *format, ...);

#endif
