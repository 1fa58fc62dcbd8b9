/* The time between two positions of a HID device, as the servo uses it: learns the usual interval and corrects
 * outliers. */
#include "device/hd_hid_interval.h"

#define HD_UNUSUAL_S 0.05 /* longer intervals between reports count as pauses */
/* Reports from which the usual interval of a device that reports changes only is learned together. */
#define HD_USUAL_REPORTS 4
#define HD_FRAME_S 1e-3          /* the shortest time between two reports of a full-speed device */
#define HD_USUAL_FIRST_S 0.01    /* usual interval assumed before the second report; that of low-speed devices */
#define HD_LEAST_INTERVAL_S 1e-6 /* smallest interval returned */

/* Updates the usual interval between two reports after `count` reports within `elapsed_s`. A device that reports
 * changes only is silent at times, so its shorter intervals have more weight. Intervals are means over several
 * reports, because the report after a delayed one arrives too soon. */
HD_RT static void learn_usual(struct hd_hid_interval *interval, double elapsed_s, uint64_t count) {
    const double mean_s = elapsed_s / (double)count;
    if (!(mean_s < HD_UNUSUAL_S)) {
        return;
    }
    if (interval->usual_s == 0.0) {
        interval->usual_s = mean_s;
    } else if (!interval->on_change) {
        interval->usual_s += (mean_s - interval->usual_s) / 16.0;
    } else if (mean_s < interval->usual_s) {
        interval->usual_s += (mean_s - interval->usual_s) / 4.0;
    } else {
        /* A long interval may be a pause and has little weight, but not zero, or the interval of a burst would stay for
         * ever. */
        const double most_s = 3.0 * interval->usual_s;
        interval->usual_s += ((mean_s < most_s ? mean_s : most_s) - interval->usual_s) / 64.0;
    }
}

HD_RT static void learn_interval(struct hd_hid_interval *interval, int64_t arrival_ns, uint64_t number) {
    if (!interval->on_change) {
        learn_usual(interval, (double)(arrival_ns - interval->arrival_ns) * 1e-9, number - interval->number);
        return;
    }
    const uint64_t together = number - interval->learned_number;
    if (together >= HD_USUAL_REPORTS) {
        learn_usual(interval, (double)(arrival_ns - interval->learned_ns) * 1e-9, together);
        interval->learned_ns = arrival_ns;
        interval->learned_number = number;
    }
}

HD_RT void hd_hid_interval_begin(struct hd_hid_interval *interval, int64_t arrival_ns, uint64_t number,
                                 uint32_t on_change) {
    interval->time_ns = interval->arrival_ns = interval->learned_ns = arrival_ns;
    interval->number = interval->learned_number = number;
    interval->on_change = on_change;
    interval->usual_s = 0.0;
}

HD_RT double hd_hid_interval_next(struct hd_hid_interval *interval, int64_t arrival_ns, uint64_t number) {
    const uint64_t count = number - interval->number;
    learn_interval(interval, arrival_ns, number);
    /* After a delayed report the next one arrives on time, and the step between them would seem much too fast. So each
     * interval is at least half of the usual one; the following intervals are shortened by the added time. */
    const int pauses =
        interval->on_change && interval->usual_s > HD_FRAME_S; /* the usual interval may include pauses */
    const double least_s = 0.5 * (pauses ? HD_FRAME_S : interval->usual_s) * (double)count;
    const double since_s = (double)(arrival_ns - interval->time_ns) * 1e-9;
    const double longer_s = since_s > least_s ? since_s : least_s;
    const double interval_s = longer_s > HD_LEAST_INTERVAL_S ? longer_s : HD_LEAST_INTERVAL_S;
    interval->time_ns += (int64_t)(interval_s * 1e9);
    interval->arrival_ns = arrival_ns;
    interval->number = number;
    return interval_s;
}

HD_RT double hd_hid_interval_silent(struct hd_hid_interval *interval, int64_t now_ns) {
    const double usual_s = interval->usual_s > 0.0 ? interval->usual_s : HD_USUAL_FIRST_S;
    const double since_s = (double)(now_ns - interval->time_ns) * 1e-9;
    if (!interval->on_change || !(since_s > 1.5 * usual_s)) {
        return 0.0;
    }
    /* Half an interval before now, because a report may be on its way and must get a later time. */
    const double interval_s = since_s - 0.5 * usual_s;
    interval->time_ns += (int64_t)(interval_s * 1e9);
    return interval_s;
}
