/* Numbers in reports, against a reference that looks at one bit at a time: every offset and size within a small report,
 * signed and not, both byte orders; what lies around them is left alone. Then what a force becomes, and what an input
 * report says. */
#include <math.h>
#include <string.h>

#include "base/hd_bits.h"
#include "device/hd_report.h"
#include "hd_test.h"

#define BYTES 9u
#define PI 3.14159265358979323846

static int bit_of(const uint8_t *report, uint32_t bit) {
    return report[1 + bit / 8] >> (bit % 8) & 1;
}

/* Where bit `i` of a number, counted from its lowest, lies. */
static uint32_t place_of(const struct hd_hid_field *field, uint32_t i) {
    if (!field->big_endian)
        return field->bit_offset + i;
    return field->bit_offset + 8 * (field->bit_size / 8 - 1 - i / 8) + i % 8;
}

static int64_t reference_read(const struct hd_hid_field *field, const uint8_t *report) {
    int64_t value = 0;

    for (uint32_t i = 0; i < field->bit_size; i++) {
        int64_t weight = (int64_t)1 << i;

        if (field->is_signed && i == field->bit_size - 1)
            weight = -weight;
        value += bit_of(report, place_of(field, i)) * weight;
    }
    return value;
}

static void check_field(const struct hd_hid_field *field, uint64_t *seed) {
    uint8_t report[BYTES];
    uint8_t changed[BYTES];
    int64_t counts;
    int64_t again;
    size_t needed = 1 + (field->bit_offset + field->bit_size + 7) / 8;

    for (size_t i = 0; i < BYTES; i++)
        report[i] = (uint8_t)test_random(seed);
    CHECK(hd_bits_get(field, report, needed, &counts) == HD_OK);
    CHECK(counts == reference_read(field, report));
    CHECK(hd_bits_get(field, report, needed - 1, &again) == HD_ERR_INVALID);
    CHECK(hd_bits_put(field, report, needed - 1, 0) == HD_ERR_INVALID);

    for (size_t i = 0; i < BYTES; i++)
        changed[i] = (uint8_t)test_random(seed);
    memcpy(report, changed, BYTES);
    CHECK(hd_bits_put(field, changed, BYTES, counts) == HD_OK);
    CHECK(reference_read(field, changed) == counts);
    for (uint32_t bit = 0; bit < 8 * (BYTES - 1); bit++) {
        int within = 0;

        for (uint32_t i = 0; i < field->bit_size; i++)
            within |= place_of(field, i) == bit;
        CHECK(within || bit_of(changed, bit) == bit_of(report, bit));
    }
    CHECK(changed[0] == report[0]);
}

static void check_limits(const struct hd_hid_field *field) {
    int64_t span = (int64_t)1 << field->bit_size;
    int64_t least = field->is_signed ? -span / 2 : 0;
    uint8_t report[BYTES] = {0};

    CHECK(hd_bits_put(field, report, BYTES, least) == HD_OK && reference_read(field, report) == least);
    CHECK(hd_bits_put(field, report, BYTES, least + span - 1) == HD_OK);
    CHECK(reference_read(field, report) == least + span - 1);
    CHECK(hd_bits_put(field, report, BYTES, least - 1) == HD_ERR_INVALID);
    CHECK(hd_bits_put(field, report, BYTES, least + span) == HD_ERR_INVALID);
}

static size_t every_field(void) {
    uint64_t seed = 1;
    size_t count = 0;

    for (uint32_t size = 1; size <= 32; size++)
        for (uint32_t offset = 0; offset + size <= 8 * (BYTES - 1); offset++)
            for (uint32_t kind = 0; kind < 4; kind++) {
                struct hd_hid_field field = {offset, size, kind & 1, kind >> 1};

                if (field.big_endian && (offset % 8 != 0 || size % 8 != 0)) {
                    uint8_t report[BYTES] = {0};
                    int64_t counts;

                    CHECK(hd_bits_get(&field, report, BYTES, &counts) == HD_ERR_INVALID);
                    continue;
                }
                check_field(&field, &seed);
                check_limits(&field);
                count++;
            }
    return count;
}

static void no_field(void) {
    uint8_t report[BYTES] = {0};
    int64_t counts;
    const struct hd_hid_field none[] = {{.bit_size = 0}, {.bit_size = 33}, {.bit_offset = UINT32_MAX, .bit_size = 32}};

    for (size_t i = 0; i < sizeof none / sizeof none[0]; i++) {
        CHECK(hd_bits_get(&none[i], report, BYTES, &counts) == HD_ERR_INVALID);
        CHECK(hd_bits_put(&none[i], report, BYTES, 0) == HD_ERR_INVALID);
        CHECK(strstr(hd_invalid_reason(), "do not lie") != NULL);
    }
    CHECK(hd_bits_get(&(struct hd_hid_field){.bit_size = 1}, report, 0, &counts) == HD_ERR_INVALID);
}

static int64_t composed(const struct hd_hid_value *value, double x, double y) {
    struct hd_hid_message message = {.length = 5, .value_count = 1, .bytes = {7}};
    double force[2] = {x, y};
    uint8_t bytes[HD_HID_REPORT_BYTES];
    int64_t counts;

    message.values[0] = *value;
    hd_hid_compose(&message, force, bytes);
    CHECK(bytes[0] == 7 && hd_bits_get(&value->field, bytes, 5, &counts) == HD_OK);
    return counts;
}

static void forces(void) {
    struct hd_hid_value value = {.field = {.bit_size = 16, .is_signed = 1}, .quantity = HD_HID_X};

    value.counts_per_unit = -100.0;
    value.least = -255.0;
    value.most = 200.0;
    CHECK(composed(&value, 1.234, 9.0) == -123 && composed(&value, -1.236, 0.0) == 124);
    CHECK(composed(&value, 100.0, 0.0) == -255 && composed(&value, -1e300, 0.0) == 200);
    CHECK(composed(&value, (double)NAN, 0.0) == 0 && composed(&value, 1.0, (double)INFINITY) == 0);
    value.quantity = HD_HID_Y;
    value.zero_counts = 10.0;
    CHECK(composed(&value, 9.0, -0.5) == 60 && composed(&value, 1.0, (double)NAN) == 10);
    value.quantity = HD_HID_MAGNITUDE;
    value.counts_per_unit = 10.0;
    value.zero_counts = 0.0;
    CHECK(composed(&value, 3.0, -4.0) == 50 && composed(&value, 1e308, 1e308) == 200);
    value.counts_per_unit = 0.0;
    CHECK(composed(&value, 1e308, 1e308) == 0);
}

/* Of the other axis's force, up to the full one, a part comes to it. */
static void two_axes_in_one_number(void) {
    struct hd_hid_value value = {.field = {.bit_size = 16, .is_signed = 1}, .quantity = HD_HID_Y};

    value.counts_per_unit = 100.0;
    value.counts_per_other_n = -10.0;
    value.least = -1000.0;
    value.most = 1000.0;
    CHECK(composed(&value, 2.0, 5.0) == 480 && composed(&value, -2.0, 5.0) == 520);
    CHECK(composed(&value, 1e9, 0.0) == -100 && composed(&value, -1e308, 0.0) == 100);
    CHECK(composed(&value, -1e308, 1e308) == 1000 && composed(&value, (double)NAN, 5.0) == 0);
    value.quantity = HD_HID_X;
    CHECK(composed(&value, 5.0, 2.0) == 480);
}

/* Whatever the steps of a turn and where they begin, the nearest of them is written, also across north. */
static void directions(void) {
    const struct {
        double steps, zero, least, most;
    } turns[] = {{360.0, 0.0, 0.0, 359.0},    {256.0, 0.0, 0.0, 255.0},    {36000.0, 0.0, 0.0, 35999.0},
                 {360.0, 0.0, -180.0, 179.0}, {-360.0, 360.0, 1.0, 360.0}, {255.0, 0.0, 0.0, 255.0}};

    for (size_t k = 0; k < sizeof turns / sizeof turns[0]; k++) {
        struct hd_hid_value value = {.field = {.bit_size = 17, .is_signed = 1}, .quantity = HD_HID_DIRECTION};

        value.counts_per_unit = turns[k].steps / (2.0 * PI);
        value.zero_counts = turns[k].zero;
        value.least = turns[k].least;
        value.most = turns[k].most;
        for (int i = 0; i < 1000; i++) {
            double from = 2.0 * PI * (i + 0.37) / 1000.0;
            double counts = (double)composed(&value, -3.0 * sin(from), -3.0 * cos(from));
            double error = (counts - turns[k].zero) / value.counts_per_unit - from;

            CHECK(counts >= turns[k].least && counts <= turns[k].most);
            error -= 2.0 * PI * rint(error / (2.0 * PI));
            CHECK(fabs(error * value.counts_per_unit) <= 0.5 + 1e-9);
        }
        CHECK(composed(&value, 0.0, 0.0) == (int64_t)turns[k].zero);
    }
}

static struct hd_hid_plan plan_of(uint32_t x_id, uint32_t y_id) {
    struct hd_hid_plan plan = {.state_count = 2, .renew_ns = 1000000, .write_interval_ns = 1000};

    plan.axes[0] = (struct hd_hid_axis){{0, 10, 1, 0}, x_id, 0, 0.0, {1e-4, 1e-4}};
    plan.axes[1] = (struct hd_hid_axis){{10, 10, 0, 0}, y_id, 0, 512.0, {-1e-4, -1e-4}};
    plan.states[0] = (struct hd_hid_state){{20, 1, 0, 0}, y_id, HD_HID_RESET};
    plan.states[1] = (struct hd_hid_state){{21, 1, 0, 0}, y_id, HD_HID_POWER};
    plan.force.count = 1;
    plan.force.messages[0].length = 3;
    plan.force.messages[0].value_count = 1;
    plan.force.messages[0].values[0] =
        (struct hd_hid_value){{0, 16, 1, 0}, HD_HID_X, 0, 100.0, 0.0, -32768.0, 32767.0, 0.0};
    return plan;
}

static struct hd_hid_effects watched_effects(uint32_t report_id) {
    return (struct hd_hid_effects){.index = {0, 7, 0, 0},
                                   .playing = {7, 1, 0, 0},
                                   .report_id = report_id,
                                   .count = 2,
                                   .indices = {5, 9},
                                   .proof = 1};
}

static void input(void) {
    struct hd_hid_plan plan = plan_of(1, 1);
    uint8_t report[4] = {1};
    struct hd_report_news news;

    CHECK(hd_hid_check(&plan) == HD_OK && hd_report_numbered(&plan));
    CHECK(hd_bits_put(&plan.axes[0].field, report, 4, -300) == HD_OK);
    CHECK(hd_bits_put(&plan.axes[1].field, report, 4, 500) == HD_OK);
    CHECK(hd_bits_put(&plan.states[1].field, report, 4, 1) == HD_OK);
    hd_report_take(&plan, report, 4, &news);
    CHECK(news.axes == 3 && !news.short_of_it);
    CHECK(fabs(news.position_m[0] + 0.03) < 1e-15 && fabs(news.position_m[1] - 0.0012) < 1e-15);
    CHECK(news.said == (1u | 1u << (HD_HID_POWER - 1)) && news.states == 1u << (HD_HID_POWER - 1));
    plan.axes[0].m_per_count[0] = 2e-4; /* below zero_counts alone */
    plan.axes[1].m_per_count[0] = -3e-4;
    hd_report_take(&plan, report, 4, &news);
    CHECK(fabs(news.position_m[0] + 0.06) < 1e-15 && fabs(news.position_m[1] - 0.0036) < 1e-15);
    CHECK(hd_bits_put(&plan.axes[0].field, report, 4, 300) == HD_OK);
    CHECK(hd_bits_put(&plan.axes[1].field, report, 4, 512) == HD_OK);
    hd_report_take(&plan, report, 4, &news);
    CHECK(fabs(news.position_m[0] - 0.03) < 1e-15 && fabs(news.position_m[1]) <= 0.0);
    for (size_t length = 0; length < 4; length++) {
        hd_report_take(&plan, report, length, &news);
        CHECK(news.short_of_it && news.axes == 0 && news.said == 0);
    }
    report[0] = 2;
    hd_report_take(&plan, report, 4, &news);
    CHECK(!news.short_of_it && news.axes == 0 && news.said == 0);
    plan = plan_of(2, 3);
    hd_report_take(&plan, report, 4, &news);
    CHECK(news.axes == 1 && news.said == 0);
    plan = plan_of(0, 0);
    CHECK(hd_hid_check(&plan) == HD_OK && !hd_report_numbered(&plan));

    /* Effects: 5 and 9 of ours, in a report of their own or in that of the axes. */
    plan = plan_of(1, 1);
    plan.effects = watched_effects(6);
    CHECK(hd_hid_check(&plan) == HD_OK);
    hd_report_take(&plan, (const uint8_t[]){6, 0x80 | 9}, 2, &news);
    CHECK(news.effects == 2 && news.playing == 1 && news.axes == 0 && !news.short_of_it);
    hd_report_take(&plan, (const uint8_t[]){6, 5}, 2, &news);
    CHECK(news.effects == 1 && news.playing == 0);
    hd_report_take(&plan, (const uint8_t[]){6, 0x80 | 6}, 2, &news);
    CHECK(news.effects == 0 && !news.short_of_it);
    hd_report_take(&plan, (const uint8_t[]){6}, 1, &news);
    CHECK(news.effects == 0 && news.short_of_it);
    plan.effects.report_id = 1;
    hd_report_take(&plan, (const uint8_t[]){1, 0x80 | 5, 0, 0}, 4, &news);
    CHECK(news.effects == 1 && news.playing == 1 && news.axes == 3);
}

#define REFUSES(CHANGE)                               \
    do {                                              \
        struct hd_hid_plan plan = plan_of(1, 1);      \
        CHANGE;                                       \
        CHECK(hd_hid_check(&plan) == HD_ERR_INVALID); \
        CHECK(hd_invalid_reason()[0] != '\0');        \
    } while (0)

static void refusals(void) {
    REFUSES(plan.axes[1].report_id = 0);
    REFUSES(plan.axes[1].report_id = 256);
    REFUSES(plan.axes[0].field.bit_offset = 8 * 255);
    REFUSES(plan.axes[0].m_per_count[0] = 0.0);
    REFUSES(plan.axes[0].m_per_count[1] = 0.0);
    REFUSES(plan.axes[0].m_per_count[1] = (double)NAN);
    REFUSES(plan.axes[0].m_per_count[1] = -1e-4);
    REFUSES(plan.axes[0].zero_counts = (double)INFINITY);
    REFUSES(plan.state_count = HD_HID_STATES + 1);
    REFUSES(plan.states[0].meaning = 6);
    REFUSES(plan.states[0].field.bit_size = 0);
    REFUSES(plan.effects = watched_effects(0));
    REFUSES(plan.effects = watched_effects(1); plan.effects.count = HD_HID_EFFECTS + 1);
    REFUSES(plan.effects = watched_effects(1); plan.effects.proof = 0);
    REFUSES(plan.effects = watched_effects(1); plan.effects.index.bit_size = 33);
    REFUSES(plan.effects = watched_effects(1); plan.effects.playing.bit_offset = 8 * 255);
    REFUSES(plan.begin.count = HD_HID_MESSAGES + 1);
    REFUSES(plan.force.count = HD_HID_MESSAGES + 1);
    REFUSES(plan.force.messages[0].length = 2);
    REFUSES(plan.force.messages[0].length = HD_HID_REPORT_BYTES + 1);
    REFUSES(plan.force.messages[0].value_count = HD_HID_VALUES + 1);
    REFUSES(plan.force.messages[0].values[0].quantity = 0);
    REFUSES(plan.force.messages[0].values[0].most = 32768.0);
    REFUSES(plan.force.messages[0].values[0].least = 40000.0);
    REFUSES(plan.force.messages[0].values[0].least = (double)NAN);
    REFUSES(plan.force.messages[0].values[0].least = 1.0);
    REFUSES(plan.force.messages[0].values[0].counts_per_unit = (double)NAN);
    REFUSES(plan.force.messages[0].values[0].counts_per_other_n = (double)INFINITY);
    REFUSES(plan.force.messages[0].values[0].quantity = HD_HID_MAGNITUDE;
            plan.force.messages[0].values[0].counts_per_other_n = 1.0);
    REFUSES(plan.stop.count = 1);
    REFUSES(plan.renew = plan.force; plan.renew_ns = 0);
    REFUSES(plan.renew_ns = -1);
    REFUSES(plan.restore = plan.force; plan.restore_ns = 0);
    REFUSES(plan.restore_ns = -1);
    REFUSES(plan.restore.count = HD_HID_MESSAGES + 1);
    REFUSES(plan.write_interval_ns = 100000001);
}

int main(void) {
    size_t count = every_field();

    no_field();
    forces();
    two_axes_in_one_number();
    directions();
    input();
    refusals();
    printf("test_report: ok, %zu fields\n", count);
    return 0;
}
