/* The servo's side of a HID device: takes the newest position and puts the newest force, without waiting and without
 * system calls, except hd_hid_step_await, which sleeps until a position arrives. Servo thread. */
#include "device/hd_hid_connection.h"

#include <linux/futex.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "base/hd_cache.h"
#include "base/hd_clock.h"

HD_RT static void take_position(struct hd_hid *hid, const struct hd_position *position) {
    if (position->connection != hid->seen_connection) {
        hid->seen_connection = position->connection;
        hid->seen_signs = position->signs;
        hd_hid_interval_begin(&hid->seen_interval, position->time_ns, position->number, position->on_change);
        hid->seen.interval_s = 0.0;
    } else {
        hid->seen.interval_s = hd_hid_interval_next(&hid->seen_interval, position->time_ns, position->number);
    }
    hid->seen.position_m[0] = position->position_m[0];
    hid->seen.position_m[1] = position->position_m[1];
}

/* Returns the reasons why the device exerts no force, as it reports them, or because the writer sends none. */
HD_RT static uint32_t idle_reasons(const struct hd_hid *hid) {
    const uint32_t needed = 1u << (HD_HID_ACTUATORS - 1) | 1u << (HD_HID_SAFETY - 1) | 1u << (HD_HID_POWER - 1);
    const uint32_t states = hd_atomic_u32_load_relaxed(&hid->states);
    return (hd_atomic_u32_load_relaxed(&hid->states_known) & needed & ~states) | (states & 1u << (HD_HID_PAUSED - 1)) |
           hd_atomic_u32_load_relaxed(&hid->reset) << (HD_HID_RESET - 1);
}

HD_RT void hd_hid_step_look(struct hd_hid *hid, int64_t now_ns, struct hd_look *look) {
    look->gone = !hd_atomic_u32_load_acquire(&hid->connected);
    look->fresh = 0;
    hid->seen.interval_s = 0.0;
    /* Positions of a connection that has ended are ignored. */
    if (!look->gone && hd_triple_acquire(&hid->position_triple)) {
        const struct hd_position *position = &hid->positions[hd_triple_front(&hid->position_triple)];
        if (position->connection == hd_atomic_u32_load_relaxed(&hid->connection_number)) {
            take_position(hid, position);
            look->fresh = 1;
        }
    }
    /* The handle's position in another connection must not cause a force in this one. */
    const int known = hid->seen_connection == hd_atomic_u32_load_relaxed(&hid->connection_number);
    look->gone |= hid->seen_connection != 0 && !known;
    if (!look->gone && !look->fresh && known) {
        hid->seen.interval_s = hd_hid_interval_silent(&hid->seen_interval, now_ns);
        look->fresh = hid->seen.interval_s > 0.0;
    }
    look->reading = hid->seen;
    look->connection = hid->seen_connection;
    look->idle = hid->seen_signs.number != 0 ? idle_reasons(hid) : 0u;
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
