/* Bit fields of HID: numbers of 1 to 32 bits anywhere in a report (struct hd_hid_field). Counts are signed 64-bit
 * integers, which hold every field of 32 bits. Any thread. No byte outside of the report is read or written. */
#ifndef HD_BITS_H
#define HD_BITS_H

#include "api/hd_core.h"
#include "base/hd_rt.h"

/* hd_bits_get and hd_bits_put for the servo: HD_OK or HD_ERR_INVALID, without hd_invalid_reason. */
HD_RT int hd_bits_try_get(const struct hd_hid_field *field, const uint8_t *report, size_t length, int64_t *counts);
HD_RT int hd_bits_try_put(const struct hd_hid_field *field, uint8_t *report, size_t length, int64_t counts);

/* Returns whether the field lies inside of a report of `length` bytes. */
HD_RT int hd_bits_fit(const struct hd_hid_field *field, size_t length);
/* The smallest and the largest number that a field holds. */
HD_RT int64_t hd_bits_least(const struct hd_hid_field *field);
HD_RT int64_t hd_bits_most(const struct hd_hid_field *field);

#endif
