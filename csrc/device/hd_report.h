/* HID reports: checks a plan, reads input reports, composes output reports with a force. Functions without state. */
#ifndef HD_REPORT_H
#define HD_REPORT_H

#include "api/hd_core.h"
#include "base/hd_rt.h"

/* Checks one output report for hd_hid_check; `name` and `index` are part of the reason. */
int hd_report_check_message(const struct hd_hid_message *message, const char *name, uint32_t index);

/* Returns whether the reports of a checked plan begin with an id. */
HD_RT int hd_report_numbered(const struct hd_hid_plan *plan);

/* The contents of one input report. */
struct hd_report_news {
    double position_m[2];
    uint32_t axes;        /* axes in the report: bit 0 x, bit 1 y */
    uint32_t states;      /* bit (meaning - 1): the number is not 0 */
    uint32_t said;        /* bit (meaning - 1): the report has this number */
    uint32_t effects;     /* bit i: the report is about plan.effects.indices[i] */
    uint32_t playing;     /* 1: that effect plays */
    uint32_t short_of_it; /* 1: the report is shorter than the plan requires; the other members are 0 */
};

/* Reads an input report of `length` bytes, its id first (0 if reports have no id). Any bytes are allowed. */
HD_RT void hd_report_take(const struct hd_hid_plan *plan, const uint8_t *report, size_t length,
                          struct hd_report_news *news);

/* Returns the direction that a force comes from, as defined by HD_HID_DIRECTION; 0 for a force of zero. */
double hd_report_direction(const double force_n[2]);
/* As hd_hid_compose, with a direction that the caller chooses, because a force of zero has no direction. */
void hd_report_compose(const struct hd_hid_message *message, const double force_n[2], double direction_rad,
                       uint8_t *bytes);

#endif
