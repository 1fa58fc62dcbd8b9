/* Reads and composes HID reports. No byte outside of a report is read; the numbers written are always inside the plan's
 * limits; a force that is not finite counts as zero. Any thread. */
#include "device/hd_report.h"

#include <math.h>
#include <string.h>

#include "base/hd_bits.h"

#define HD_WRITE_INTERVAL_MAX_NS 100000000 /* the end of a connection takes a few intervals */
#define HD_FULL_TURN_RAD 6.283185307179586476925

/* ---- Plans ----------------------------------------------------------------------------------------------------- */

static int check_value(const struct hd_hid_value *value, uint32_t length, const char *script, uint32_t index) {
    if (!hd_bits_fit(&value->field, length)) {
        return hd_invalid("plan: %s[%u]: a number of %u bits at bit %u does not lie in its %u bytes", script, index,
                          value->field.bit_size, value->field.bit_offset, length);
    }
    if (value->quantity < HD_HID_X || value->quantity > HD_HID_DIRECTION) {
        return hd_invalid("plan: %s[%u]: quantity %u", script, index, value->quantity);
    }
    const int is_axis = value->quantity == HD_HID_X || value->quantity == HD_HID_Y;
    if (!isfinite(value->counts_per_other_n) || (!is_axis && value->counts_per_other_n != 0.0)) {
        return hd_invalid("plan: %s[%u]: %g counts per newton of the other axis, of quantity %u", script, index,
                          value->counts_per_other_n, value->quantity);
    }
    if (!isfinite(value->counts_per_unit) || !isfinite(value->zero_counts)) {
        return hd_invalid("plan: %s[%u]: %g counts per unit, zero at %g", script, index, value->counts_per_unit,
                          value->zero_counts);
    }
    /* Every number between the limits, rounded, must fit into the field. */
    if (!(value->least <= value->most && value->least >= (double)hd_bits_least(&value->field) &&
          value->most <= (double)hd_bits_most(&value->field))) {
        return hd_invalid("plan: %s[%u]: limits %g to %g do not lie in a field of %u bits, %s", script, index,
                          value->least, value->most, value->field.bit_size,
                          value->field.is_signed ? "signed" : "unsigned");
    }
    if (value->quantity != HD_HID_DIRECTION &&
        !(value->zero_counts >= value->least && value->zero_counts <= value->most)) {
        return hd_invalid("plan: %s[%u]: no force at %g counts, outside of its limits %g to %g", script, index,
                          value->zero_counts, value->least, value->most);
    }
    return HD_OK;
}

int hd_report_check_message(const struct hd_hid_message *message, const char *name, uint32_t index) {
    if (message->length < 1 || message->length > HD_HID_REPORT_BYTES) {
        return hd_invalid("plan: %s[%u]: %u bytes", name, index, message->length);
    }
    if (message->value_count > HD_HID_VALUES) {
        return hd_invalid("plan: %s[%u]: %u numbers, at most %d", name, index, message->value_count, HD_HID_VALUES);
    }
    for (uint32_t k = 0; k < message->value_count; k++) {
        if (check_value(&message->values[k], message->length, name, index) != HD_OK) {
            return HD_ERR_INVALID;
        }
    }
    return HD_OK;
}

static int check_script(const struct hd_hid_script *script, const char *name) {
    if (script->count > HD_HID_MESSAGES) {
        return hd_invalid("plan: %s: %u messages, at most %d", name, script->count, HD_HID_MESSAGES);
    }
    for (uint32_t i = 0; i < script->count; i++) {
        if (hd_report_check_message(&script->messages[i], name, i) != HD_OK) {
            return HD_ERR_INVALID;
        }
    }
    return HD_OK;
}

static int check_input(const struct hd_hid_field *field, uint32_t report_id, int numbered, const char *what) {
    if (!hd_bits_fit(field, HD_HID_REPORT_BYTES)) {
        return hd_invalid("plan: %s: %u bits at bit %u do not lie in a report of %d bytes", what, field->bit_size,
                          field->bit_offset, HD_HID_REPORT_BYTES);
    }
    if (report_id > 255 || (report_id != 0) != (numbered != 0)) {
        return hd_invalid("plan: %s: report id %u; ids are 1 to 255, or 0 for all where reports are not numbered", what,
                          report_id);
    }
    return HD_OK;
}

int hd_hid_check(const struct hd_hid_plan *plan) {
    const int numbered = hd_report_numbered(plan);
    for (int axis = 0; axis < 2; axis++) {
        const struct hd_hid_axis *from = &plan->axes[axis];
        const char *name = axis == 0 ? "axis x" : "axis y";
        if (check_input(&from->field, from->report_id, numbered, name) != HD_OK) {
            return HD_ERR_INVALID;
        }
        /* Bounds that keep every reported position finite. */
        const double below = from->m_per_count[0];
        const double above = from->m_per_count[1];
        if (!(fabs(from->zero_counts) <= 1e12) || !(fabs(below) <= 1e12) || !(fabs(above) <= 1e12) ||
            !(below > 0.0 ? above > 0.0 : below < 0.0 && above < 0.0)) {
            return hd_invalid("plan: %s: zero at %g counts, %g and %g m per count below and above it", name,
                              from->zero_counts, below, above);
        }
    }
    if (plan->state_count > HD_HID_STATES) {
        return hd_invalid("plan: %u states, at most %d", plan->state_count, HD_HID_STATES);
    }
    for (uint32_t i = 0; i < plan->state_count; i++) {
        const struct hd_hid_state *state = &plan->states[i];
        if (check_input(&state->field, state->report_id, numbered, "state") != HD_OK) {
            return HD_ERR_INVALID;
        }
        if (state->meaning < HD_HID_RESET || state->meaning > HD_HID_POWER) {
            return hd_invalid("plan: state %u: meaning %u", i, state->meaning);
        }
    }
    const struct hd_hid_signs *signs = &plan->signs;
    if (signs->number != 0 && !(signs->axes >= 1 && signs->axes <= 3 && signs->force_n > 0.0 && signs->force_n <= 1e6 &&
                                signs->least_m > 0.0 && signs->least_m <= signs->enough_m && signs->enough_m <= 1e6)) {
        return hd_invalid("plan: signs of axes %u: %g N, %g to %g m", signs->axes, signs->force_n, signs->least_m,
                          signs->enough_m);
    }
    const struct hd_hid_effects *effects = &plan->effects;
    if (effects->count > HD_HID_EFFECTS || (effects->count > 0 && effects->proof < 1)) {
        return hd_invalid("plan: %u effects, at most %d; proven by %u renewals", effects->count, HD_HID_EFFECTS,
                          effects->proof);
    }
    if (effects->count > 0 &&
        (check_input(&effects->index, effects->report_id, numbered, "effect index") != HD_OK ||
         check_input(&effects->playing, effects->report_id, numbered, "effect playing") != HD_OK)) {
        return HD_ERR_INVALID;
    }
    if (check_script(&plan->begin, "begin") != HD_OK || check_script(&plan->force, "force") != HD_OK ||
        check_script(&plan->renew, "renew") != HD_OK || check_script(&plan->restore, "restore") != HD_OK ||
        check_script(&plan->stop, "stop") != HD_OK) {
        return HD_ERR_INVALID;
    }
    if (plan->renew_ns < 0 || (plan->renew.count > 0 && plan->renew_ns == 0)) {
        return hd_invalid("plan: renewed every %lld ns", (long long)plan->renew_ns);
    }
    if (plan->restore_ns < 0 || (plan->restore.count > 0 && plan->restore_ns == 0)) {
        return hd_invalid("plan: restored every %lld ns", (long long)plan->restore_ns);
    }
    if (plan->write_interval_ns < 0 || plan->write_interval_ns > HD_WRITE_INTERVAL_MAX_NS) {
        return hd_invalid("plan: %lld ns between writes", (long long)plan->write_interval_ns);
    }
    return HD_OK;
}

HD_RT int hd_report_numbered(const struct hd_hid_plan *plan) {
    return plan->axes[0].report_id != 0;
}

/* ---- Input reports --------------------------------------------------------------------------------------------- */

HD_RT void hd_report_take(const struct hd_hid_plan *plan, const uint8_t *report, size_t length,
                          struct hd_report_news *news) {
    struct hd_report_news found = {.axes = 0};
    int cut = length == 0;
    int64_t counts = 0;
    *news = found;
    for (uint32_t axis = 0; axis < 2 && !cut; axis++) {
        const struct hd_hid_axis *from = &plan->axes[axis];
        if (from->report_id == report[0]) {
            cut = hd_bits_try_get(&from->field, report, length, &counts) != HD_OK;
            const double off = (double)counts - from->zero_counts;
            found.position_m[axis] = off * from->m_per_count[off > 0.0];
            found.axes |= 1u << axis;
        }
    }
    for (uint32_t i = 0; i < plan->state_count && !cut; i++) {
        const struct hd_hid_state *state = &plan->states[i];
        if (state->report_id == report[0]) {
            const uint32_t bit = 1u << (state->meaning - 1);
            cut = hd_bits_try_get(&state->field, report, length, &counts) != HD_OK;
            found.said |= bit;
            found.states |= counts != 0 ? bit : 0u;
        }
    }
    const struct hd_hid_effects *effects = &plan->effects;
    if (effects->count > 0 && effects->report_id == report[0] && !cut) {
        int64_t playing = 0;
        cut = hd_bits_try_get(&effects->index, report, length, &counts) != HD_OK ||
              hd_bits_try_get(&effects->playing, report, length, &playing) != HD_OK;
        for (uint32_t i = 0; i < effects->count; i++) {
            found.effects |= counts == (int64_t)effects->indices[i] ? 1u << i : 0u;
        }
        found.playing = playing != 0;
    }
    if (cut) {
        news->short_of_it = 1;
    } else {
        *news = found;
    }
}

/* ---- Output reports -------------------------------------------------------------------------------------------- */

double hd_report_direction(const double force_n[2]) {
    if (!(isfinite(force_n[0]) && isfinite(force_n[1])) || (force_n[0] == 0.0 && force_n[1] == 0.0)) {
        return 0.0;
    }
    const double angle = atan2(-force_n[0], -force_n[1]);
    return angle < 0.0 ? angle + HD_FULL_TURN_RAD : angle;
}

static double counts_of(const struct hd_hid_value *value, const double force_n[2], double direction_rad) {
    double quantity = 0.0;
    double other_n = 0.0;
    switch (value->quantity) {
    case HD_HID_X:
        quantity = force_n[0];
        other_n = force_n[1];
        break;
    case HD_HID_Y:
        quantity = force_n[1];
        other_n = force_n[0];
        break;
    case HD_HID_MAGNITUDE:
        quantity = hypot(force_n[0], force_n[1]);
        break;
    default:
        quantity = direction_rad;
        break;
    }
    double counts = quantity * value->counts_per_unit + value->zero_counts;
    if (value->counts_per_other_n != 0.0) {
        /* The other effect also exerts at most the full force. */
        const double full_n = (value->most - value->zero_counts) / fabs(value->counts_per_unit);
        counts += fmin(fmax(other_n, -full_n), full_n) * value->counts_per_other_n;
    }
    if (value->quantity == HD_HID_DIRECTION) {
        /* An angle that rounds to a full turn becomes 0. */
        const double turn = fabs(value->counts_per_unit) * HD_FULL_TURN_RAD;
        if (rint(counts) > value->most && rint(counts - turn) >= value->least) {
            counts -= turn;
        } else if (rint(counts) < value->least && rint(counts + turn) <= value->most) {
            counts += turn;
        }
    }
    if (isnan(counts)) { /* an infinite magnitude times 0 counts per newton */
        counts = value->zero_counts;
    }
    return rint(fmin(fmax(counts, value->least), value->most));
}

void hd_report_compose(const struct hd_hid_message *message, const double force_n[2], double direction_rad,
                       uint8_t *bytes) {
    const int finite = isfinite(force_n[0]) && isfinite(force_n[1]);
    const double force[2] = {finite ? force_n[0] : 0.0, finite ? force_n[1] : 0.0};
    memcpy(bytes, message->bytes, message->length);
    for (uint32_t i = 0; i < message->value_count; i++) {
        const struct hd_hid_value *value = &message->values[i];
        hd_bits_try_put(&value->field, bytes, message->length, (int64_t)counts_of(value, force, direction_rad));
    }
}

void hd_hid_compose(const struct hd_hid_message *message, const double force_n[2], uint8_t *bytes) {
    hd_report_compose(message, force_n, hd_report_direction(force_n), bytes);
}
