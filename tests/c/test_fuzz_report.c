/* Any plan and any input reports, from bytes: what is read lies within the report, what is written within the limits.
 *
 * With -DHD_LIBFUZZER this is an entry for libFuzzer (`make fuzz`); without, main feeds it random bytes:
 *     test_fuzz_report [FIRST_SEED [COUNT]] */
#include <math.h>
#include <string.h>

#include "base/hd_bits.h"
#include "device/hd_report.h"
#include "hd_test.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

struct source {
    const uint8_t *data;
    size_t left;
};

static struct {
    uint64_t refused, positions, shorts, written;
} outcome;

static uint64_t take_bytes(struct source *source, size_t count) {
    uint64_t value = 0;

    for (size_t i = 0; i < count && source->left > 0; i++, source->left--)
        value |= (uint64_t)*source->data++ << (8 * i);
    return value;
}

/* Mostly what passes the check, now and then anything. */
static double take_number(struct source *source) {
    uint8_t choice = (uint8_t)take_bytes(source, 1);
    double number;
    uint64_t bits;

    if (choice < 250)
        return (double)(int16_t)take_bytes(source, 2) * (choice % 2 ? 1.0 : 0.01);
    bits = take_bytes(source, 8);
    memcpy(&number, &bits, sizeof number);
    return number;
}

static struct hd_hid_field take_field(struct source *source, size_t bytes) {
    struct hd_hid_field field = {.bit_offset = (uint32_t)take_bytes(source, 2) % (uint32_t)(8 * bytes),
                                 .bit_size = (uint32_t)take_bytes(source, 1) % 34,
                                 .is_signed = (uint32_t)take_bytes(source, 1) % 2};

    if (take_bytes(source, 1) > 250) {
        field.bit_offset = (uint32_t)take_bytes(source, 4);
        field.big_endian = 1;
    }
    return field;
}

static void take_message(struct source *source, struct hd_hid_message *message) {
    message->length = 2 + (uint32_t)take_bytes(source, 1);
    message->value_count = (uint32_t)take_bytes(source, 1) % (HD_HID_VALUES + 1);
    for (uint32_t k = 0; k < message->value_count; k++) {
        struct hd_hid_value *value = &message->values[k];

        value->field = take_field(source, message->length);
        value->quantity = 1 + (uint32_t)take_bytes(source, 1) % HD_HID_DIRECTION;
        value->counts_per_unit = take_number(source);
        value->counts_per_other_n = value->quantity <= HD_HID_Y ? -0.5 * value->counts_per_unit : 0.0;
        value->least = take_number(source);
        value->most = take_number(source);
        value->zero_counts = take_bytes(source, 1) % 8 != 0 ? value->least : take_number(source);
    }
}

static void check_message(const struct hd_hid_message *message, const double force[2]) {
    uint8_t bytes[HD_HID_REPORT_BYTES];
    int64_t counts;

    memset(bytes, 0x55, sizeof bytes);
    hd_hid_compose(message, force, bytes);
    for (uint32_t i = message->length; i < HD_HID_REPORT_BYTES; i++)
        CHECK(bytes[i] == 0x55);
    if (message->value_count == 0)
        return;
    /* Those before it may lie in the same bits. */
    const struct hd_hid_value *last = &message->values[message->value_count - 1];
    CHECK(hd_bits_get(&last->field, bytes, message->length, &counts) == HD_OK);
    CHECK((double)counts >= rint(last->least) && (double)counts <= rint(last->most));
    outcome.written++;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    struct source source = {.data = data, .left = size};
    struct hd_hid_plan plan = {.state_count = (uint32_t)take_bytes(&source, 1) % (HD_HID_STATES + 2)};
    uint32_t numbered = (uint32_t)take_bytes(&source, 1) % 4;
    double known[2] = {0.0, 0.0};

    for (int axis = 0; axis < 2; axis++) {
        plan.axes[axis].field = take_field(&source, 16);
        plan.axes[axis].report_id = numbered ? 1 + (uint32_t)take_bytes(&source, 1) % 3 : 0;
        plan.axes[axis].zero_counts = take_number(&source);
        plan.axes[axis].m_per_count[0] = take_number(&source);
        plan.axes[axis].m_per_count[1] =
            source.left % 128 == 0 ? take_number(&source) : 0.5 * plan.axes[axis].m_per_count[0];
    }
    for (uint32_t i = 0; i < plan.state_count && i < HD_HID_STATES; i++) {
        plan.states[i].field = take_field(&source, 16);
        plan.states[i].report_id = numbered ? 1 + (uint32_t)take_bytes(&source, 1) % 3 : 0;
        plan.states[i].meaning = 1 + (uint32_t)take_bytes(&source, 1) % HD_HID_POWER;
    }
    plan.effects = (struct hd_hid_effects){.count = (uint32_t)take_bytes(&source, 1) % (HD_HID_EFFECTS + 2),
                                           .index = take_field(&source, 16),
                                           .playing = take_field(&source, 16),
                                           .report_id = numbered ? 1 + (uint32_t)take_bytes(&source, 1) % 3 : 0,
                                           .indices = {1, 2, 3, 4},
                                           .proof = (uint32_t)take_bytes(&source, 1) % 8};
    plan.force.count = (uint32_t)take_bytes(&source, 1) % 3;
    for (uint32_t i = 0; i < plan.force.count; i++)
        take_message(&source, &plan.force.messages[i]);
    if (hd_hid_check(&plan) != HD_OK) {
        CHECK(hd_invalid_reason()[0] != '\0');
        outcome.refused++;
        return 0;
    }
    while (source.left > 0) {
        /* Of exactly its size, so that AddressSanitizer sees what is read behind it. */
        size_t length = (size_t)take_bytes(&source, 1) % 24;
        uint8_t *report = malloc(length > 0 ? length : 1);
        struct hd_report_news news;

        CHECK(report != NULL);
        for (size_t i = 0; i < length; i++)
            report[i] = (uint8_t)take_bytes(&source, 1);
        if (length > 0)
            report[0] = numbered ? 1 + report[0] % 4 : 0;
        hd_report_take(&plan, report, length, &news);
        free(report);
        for (int axis = 0; axis < 2; axis++)
            if ((news.axes & 1u << axis) != 0) {
                CHECK(isfinite(news.position_m[axis]) && !news.short_of_it);
                known[axis] = news.position_m[axis];
            }
        CHECK((news.states & ~news.said) == 0 && news.said < 1u << HD_HID_POWER);
        CHECK(news.effects >> plan.effects.count == 0 && news.playing <= 1);
        outcome.positions += news.axes != 0;
        outcome.shorts += news.short_of_it;
        for (uint32_t i = 0; i < plan.force.count; i++)
            check_message(&plan.force.messages[i], known);
    }
    for (uint32_t i = 0; i < plan.force.count; i++) {
        double force[2] = {take_number(&source), (double)NAN};

        check_message(&plan.force.messages[i], force);
    }
    return 0;
}

#ifndef HD_LIBFUZZER
int main(int argc, char **argv) {
    static uint8_t bytes[512];
    uint64_t first = argc > 1 ? strtoull(argv[1], NULL, 10) : test_run() * 200000;
    uint64_t count = argc > 2 ? strtoull(argv[2], NULL, 10) : test_share(200000);

    for (uint64_t i = first; i < first + count; i++) {
        uint64_t seed = i;
        size_t size = test_below(&seed, sizeof bytes);

        for (size_t at = 0; at < size; at++)
            bytes[at] = (uint8_t)test_random(&seed);
        if (argc > 2)
            fprintf(stderr, "seed %llu\n", (unsigned long long)i);
        LLVMFuzzerTestOneInput(bytes, size);
    }
    printf("test_fuzz_report: ok, %llu plans refused, %llu positions, %llu short reports, %llu messages\n",
           (unsigned long long)outcome.refused, (unsigned long long)outcome.positions,
           (unsigned long long)outcome.shorts, (unsigned long long)outcome.written);
    CHECK(argc > 2 || test_run() > 0 ||
          (outcome.refused > count / 10 && outcome.positions > count / 10 && outcome.shorts > count / 10 &&
           outcome.written > count / 10));
    return 0;
}
#endif
