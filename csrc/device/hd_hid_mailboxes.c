/* What the servo calls of a HID device: it takes the newest position and puts the newest force, and neither waits nor
 * makes a system call, but where it sleeps until a position arrives. Servo thread. */
#include "device/hd_hid_connection.h"

#include <linux/futex.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "base/hd_cache.h"
#include "base/hd_clock.h"

#define HD_UNUSUAL_S 0.05     /* longer intervals between reports are pauses */
#define HD_USUAL_REPORTS 4    /* of a device that reports what changes: as many together say what is usual */
#define HD_FRAME_S 1e-3       /* the shortest time between two reports of a full-speed device */
#define HD_USUAL_FIRST_S 0.01 /* before there were two reports; low-speed devices have it */

/* What is usual between two reports, when `count` of them took `elapsed_s`. A device that reports only what changes is
 * silent now and then, so its shorter intervals say more; of several reports together, since the one after a report
 * that was held up comes too soon. */
HD_RT static void learn_usual(struct hd_hid *hid, double elapsed_s, uint64_t count) {
    const double interval_s = elapsed_s / (double)count;
    if (!(interval_s < HD_UNUSUAL_S)) {
        return;
    }
    if (hid->usual_s == 0.0) {
        hid->usual_s = interval_s;
    } else if (!hid->seen_on_change) {
        hid->usual_s += (interval_s - hid->usual_s) / 16.0;
    } else if (interval_s < hid->usual_s) {
        hid->usual_s += (interval_s - hid->usual_s) / 4.0;
    } else {
        /* A long one may be a pause and counts for little; not for nothing, or a burst would be usual for good. */
        const double most_s = 3.0 * hid->usual_s;
        hid->usual_s += ((interval_s < most_s ? interval_s : most_s) - hid->usual_s) / 64.0;
    }
}

HD_RT static void learn(struct hd_hid *hid, const struct hd_position *position, uint64_t count) {
    if (!hid->seen_on_change) {
        learn_usual(hid, (double)(position->time_ns - hid->seen_arrival_ns) * 1e-9, count);
        return;
    }
    const uint64_t together = position->number - hid->usual_number;
    if (together >= HD_USUAL_REPORTS) {
        learn_usual(hid, (double)(position->time_ns - hid->usual_ns) * 1e-9, together);
        hid->usual_ns = position->time_ns;
        hid->usual_number = position->number;
    }
}

HD_RT static void see(struct hd_hid *hid, const struct hd_position *position) {
    const int first = position->connection != hid->seen_connection;
    hid->seen.interval_s = 0.0;
    if (first) {
        hid->seen_connection = position->connection;
        hid->seen_on_change = position->on_change;
        hid->seen_signs = position->signs;
        hid->usual_s = 0.0;
        hid->usual_ns = position->time_ns;
        hid->usual_number = position->number;
        hid->seen_ns = position->time_ns;
    } else {
        const uint64_t count = position->number - hid->seen_number;
        learn(hid, position, count);
        /* A report that was held up on its way is followed by one on time, which would make the step between them look
         * too fast by far. So reports are half of what is usual apart at least; what that adds is taken back by those
         * that follow. */
        const int pauses = hid->seen_on_change && hid->usual_s > HD_FRAME_S; /* may be in what is usual */
        const double least_s = 0.5 * (pauses ? HD_FRAME_S : hid->usual_s) * (double)count;
        const double since_s = (double)(position->time_ns - hid->seen_ns) * 1e-9;
        const double interval_s = since_s > least_s ? since_s : least_s;
        hid->seen.interval_s = interval_s > 1e-6 ? interval_s : 1e-6;
        hid->seen_ns += (int64_t)(hid->seen.interval_s * 1e9);
    }
    hid->seen_arrival_ns = position->time_ns;
    hid->seen_number = position->number;
    hid->seen.position_m[0] = position->position_m[0];
    hid->seen.position_m[1] = position->position_m[1];
}

HD_RT void hd_hid_step_look(struct hd_hid *hid, int64_t now_ns, struct hd_look *look) {
    look->gone = !hd_atomic_u32_load_acquire(&hid->connected);
    look->fresh = 0;
    hid->seen.interval_s = 0.0;
    /* A position of a connection that has ended is none. */
    if (!look->gone && hd_triple_acquire(&hid->position_triple)) {
        const struct hd_position *position = &hid->positions[hd_triple_front(&hid->position_triple)];
        if (position->connection == hd_atomic_u32_load_relaxed(&hid->connection_number)) {
            see(hid, position);
            look->fresh = 1;
        }
    }
    /* No force that is of where another connection's handle was. */
    const int known = hid->seen_connection == hd_atomic_u32_load_relaxed(&hid->connection_number);
    look->gone |= hid->seen_connection != 0 && !known;
    const int silent = !look->gone && !look->fresh && hid->seen_on_change && known;
    if (silent) {
        const double usual_s = hid->usual_s > 0.0 ? hid->usual_s : HD_USUAL_FIRST_S;
        const double since_s = (double)(now_ns - hid->seen_ns) * 1e-9;
        if (since_s > 1.5 * usual_s) {
            /* Not as of now: a report may be on its way here, and must come later. */
            hid->seen.interval_s = since_s - 0.5 * usual_s;
            hid->seen_ns += (int64_t)(hid->seen.interval_s * 1e9);
            look->fresh = 1;
        }
    }
    look->reading = hid->seen;
    look->connection = hid->seen_connection;
    look->signs = &hid->seen_signs;
}

HD_RT void hd_hid_step_put(struct hd_hid *hid, int64_t now_ns, const double force_n[2]) {
    struct hd_force *force = &hid->forces[hd_triple_back(&hid->force_triple)];
    force->force_n[0] = force_n[0];
    force->force_n[1] = force_n[1];
    force->time_ns = now_ns;
    hd_triple_publish(&hid->force_triple);
}

HD_RT int hd_hid_step_has_effects(const struct hd_hid *hid) {
    return hd_atomic_u32_load_relaxed(&hid->has_effects) != 0;
}

HD_RT void hd_hid_step_strike(struct hd_hid *hid, int64_t now_ns, uint32_t effect, const double force_n[2]) {
    hd_effect_queue_put(&hid->effect_queue, now_ns, effect, force_n);
}

HD_RT void hd_hid_step_silence(struct hd_hid *hid) {
    hd_effect_queue_silence(&hid->effect_queue);
}

HD_RT void hd_hid_step_fetch(const struct hd_hid *hid) {
    hd_cache_fetch(&hid->seen, sizeof *hid - offsetof(struct hd_hid, seen));
    hd_cache_fetch(&hid->position_triple, sizeof hid->position_triple);
    hd_cache_fetch(&hid->force_triple, sizeof hid->force_triple);
}

HD_RT static void futex_wait(const struct hd_atomic_u32 *word, uint32_t seen, int64_t until_ns) {
    const struct timespec until = {.tv_sec = (time_t)(until_ns / 1000000000), .tv_nsec = (long)(until_ns % 1000000000)};
    HD_RT_SLEEP_BEGIN
    syscall(SYS_futex, &word->value, FUTEX_WAIT_BITSET_PRIVATE, seen, &until, NULL, FUTEX_BITSET_MATCH_ANY);
    HD_RT_SLEEP_END
}

HD_RT int hd_hid_step_await(struct hd_hid *hid, int64_t until_ns, int64_t *arrival_ns) {
    for (;;) {
        const uint32_t arrivals = hd_atomic_u32_load_acquire(&hid->arrivals);
        if (arrivals != hid->seen_arrivals) {
            hid->seen_arrivals = arrivals;
            *arrival_ns = hd_atomic_i64_load_relaxed(&hid->arrived_ns);
            return 1;
        }
        if (hd_clock_now_ns() >= until_ns) {
            return 0;
        }
        futex_wait(&hid->arrivals, arrivals, until_ns);
    }
}

size_t hd_hid_size(void) {
    return sizeof(struct hd_hid);
}
