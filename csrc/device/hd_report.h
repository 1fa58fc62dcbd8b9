/* HID reports, from the inside of the core: whether a plan holds, what an input report says, what an output report
 * becomes with a force. Pure functions; nothing is remembered here. */
#ifndef HD_REPORT_H
#define HD_REPORT_H

#include "api/hd_core.h"
#include "base/hd_rt.h"

/* What hd_hid_check does, of one output report; `name` and `index` are for the reason. */
int hd_report_check_message(const struct hd_hid_message *message, const char *name, uint32_t index);

/* Reports of a checked plan begin with an id. */
HD_RT int hd_report_numbered(const struct hd_hid_plan *plan);

/* What one input report says. */
struct hd_report_news {
    double position_m[2];
    uint32_t axes;        /* bit 0: x, bit 1: y: the report has it */
    uint32_t states;      /* bit (meaning - 1): the number is not 0 */
    uint32_t said;        /* bit (meaning - 1): the report has it */
    uint32_t effects;     /* bit i: it speaks of plan.effects.indices[i] */
    uint32_t playing;     /* 1: which plays */
    uint32_t short_of_it; /* 1: it ends before something that the plan reads of it; nothing above is set */
};

/* `report` holds `length` bytes, its id first (0 where reports are not numbered). Any bytes at all are taken. */
HD_RT void hd_report_take(const struct hd_hid_plan *plan, const uint8_t *report, size_t length,
                          struct hd_report_news *news);

/* Where a force comes from, as HD_HID_DIRECTION says it; 0 for no force. */
double hd_report_direction(const double force_n[2]);
/* hd_hid_compose with a direction of the caller's: that of a force of zero is a matter of taste. */
void hd_report_compose(const struct hd_hid_message *message, const double force_n[2], double direction_rad,
                       uint8_t *bytes);

#endif
