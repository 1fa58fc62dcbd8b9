/* Reads and writes numbers at any bit of a HID report. A number of up to 32 bits spans at most five bytes; they are
 * gathered into one word, lowest byte first. */
#include "base/hd_bits.h"

HD_RT int hd_bits_fit(const struct hd_hid_field *field, size_t length) {
    if (field->bit_size < 1 || field->bit_size > 32 ||
        (field->big_endian && (field->bit_offset % 8 != 0 || field->bit_size % 8 != 0))) {
        return 0;
    }
    const uint64_t end = 8u + (uint64_t)field->bit_offset + field->bit_size;
    return (end + 7) / 8 <= length;
}

HD_RT int64_t hd_bits_least(const struct hd_hid_field *field) {
    return field->is_signed ? -((int64_t)1 << (field->bit_size - 1)) : 0;
}

HD_RT int64_t hd_bits_most(const struct hd_hid_field *field) {
    return ((int64_t)1 << (field->bit_size - (field->is_signed ? 1 : 0))) - 1;
}

HD_RT int hd_bits_try_get(const struct hd_hid_field *field, const uint8_t *report, size_t length, int64_t *counts) {
    if (!hd_bits_fit(field, length)) {
        return HD_ERR_INVALID;
    }
    const size_t first = 1u + field->bit_offset / 8u;
    const uint32_t shift = field->bit_offset % 8u;
    const size_t bytes = (shift + field->bit_size + 7u) / 8u;
    uint64_t word = 0;
    for (size_t i = 0; i < bytes; i++) {
        const size_t at = field->big_endian ? bytes - 1 - i : i;
        word |= (uint64_t)report[first + at] << (8 * i);
    }
    int64_t value = (int64_t)(word >> shift & (((uint64_t)1 << field->bit_size) - 1));
    if (value > hd_bits_most(field)) {
        value -= (int64_t)1 << field->bit_size;
    }
    *counts = value;
    return HD_OK;
}

HD_RT int hd_bits_try_put(const struct hd_hid_field *field, uint8_t *report, size_t length, int64_t counts) {
    if (!hd_bits_fit(field, length) || counts < hd_bits_least(field) || counts > hd_bits_most(field)) {
        return HD_ERR_INVALID;
    }
    const size_t first = 1u + field->bit_offset / 8u;
    const uint32_t shift = field->bit_offset % 8u;
    const size_t bytes = (shift + field->bit_size + 7u) / 8u;
    const uint64_t mask = (((uint64_t)1 << field->bit_size) - 1) << shift;
    const uint64_t word = (uint64_t)counts << shift & mask;
    for (size_t i = 0; i < bytes; i++) {
        uint8_t *byte = &report[first + (field->big_endian ? bytes - 1 - i : i)];
        *byte = (uint8_t)((*byte & ~(mask >> (8 * i))) | word >> (8 * i));
    }
    return HD_OK;
}

static int refuse_field(const struct hd_hid_field *field, size_t length) {
    return hd_invalid("field: %u bits at bit %u%s do not lie in a report of %zu bytes", field->bit_size,
                      field->bit_offset, field->big_endian ? ", big-endian," : "", length);
}

int hd_bits_get(const struct hd_hid_field *field, const uint8_t *report, size_t length, int64_t *counts) {
    return hd_bits_try_get(field, report, length, counts) == HD_OK ? HD_OK : refuse_field(field, length);
}

int hd_bits_put(const struct hd_hid_field *field, uint8_t *report, size_t length, int64_t counts) {
    if (!hd_bits_fit(field, length)) {
        return refuse_field(field, length);
    }
    if (hd_bits_try_put(field, report, length, counts) != HD_OK) {
        return hd_invalid("field: %lld does not fit into %u bits, %s", (long long)counts, field->bit_size,
                          field->is_signed ? "signed" : "unsigned");
    }
    return HD_OK;
}
