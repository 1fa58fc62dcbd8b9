/* Causes of zero force outside of the tick: a device that is lost or frozen, control that has stopped, an expired
 * lease, missed periods, a suspended machine. Servo thread. */
#include "servo/hd_servo.h"

#include <string.h>

#include "base/hd_clock.h"

/* Time without a heartbeat of control, counted in rendered ticks, so that a stopped process causes no fault. */
#define HD_CONTROL_TIMEOUT_S 1.0
#define HD_LOAD_S 1.0 /* time over which an overload is evaluated */
/* A longer stall that a slow tick did not cause means that the process was stopped; it is not counted as load. */
#define HD_STALL_NS 100000000.0
#define HD_SUSPEND_LOOK_S 0.001 /* interval of the checks whether the machine was suspended */

HD_RT static void lose_device(struct hd_servo *servo, int64_t time_ns) {
    if (!servo->device_lost) {
        servo->device_lost = 1;
        hd_event_add(servo->state, HD_EVENT_DEVICE_LOST, time_ns, 0, servo->since_report_s);
        hd_state_latch(servo->state, HD_FAULT_DEVICE, 1, time_ns);
    }
}

/* Latches a fault if the handle is pushed and does not move by a single count. The configuration enables this only for
 * devices on which it cannot happen in normal use. */
HD_RT static void watch_frozen(struct hd_servo *servo, const struct hd_look *look, int64_t time_ns) {
    const double *position = look->reading.position_m;
    /* Compared bit for bit: identical counts. */
    if (memcmp(position, servo->still_m, sizeof servo->still_m) != 0 ||
        servo->last_force_n < servo->config.frozen_force_n) {
        servo->still_s = 0.0;
        servo->still_m[0] = position[0];
        servo->still_m[1] = position[1];
        return;
    }
    servo->still_s += look->reading.interval_s;
    if (servo->still_s > servo->config.frozen_s) {
        hd_state_latch(servo->state, HD_FAULT_FROZEN, 1, time_ns);
    }
}

HD_RT static void watch_device(struct hd_servo *servo, const struct hd_look *look, int64_t time_ns) {
    if (look->connection != servo->connection) {
        if (servo->connection != 0) {
            lose_device(servo, time_ns); /* it may have been disconnected between two ticks */
        }
        servo->connection = look->connection;
        /* The motion to the present position is unknown. */
        hd_velocity_reset(&servo->state->velocity);
        servo->state->located = 0;
    }
    if (look->fresh) {
        servo->since_report_s = 0.0;
        if (servo->device_lost) {
            servo->device_lost = 0;
            hd_event_add(servo->state, HD_EVENT_DEVICE_FOUND, time_ns, 0, 0.0);
        }
        if (servo->config.frozen_s > 0.0) {
            watch_frozen(servo, look, time_ns);
        }
        return;
    }
    /* One period per tick: periods that the servo itself missed are not the device's fault. */
    servo->since_report_s += servo->period_s;
    const int nowhere = look->connection == 0 && servo->state->enabled; /* a force without a position */
    if (look->gone || nowhere || servo->since_report_s > servo->config.device_timeout_s) {
        lose_device(servo, time_ns);
    }
}

HD_RT static void report_overload(struct hd_servo *servo, double share, int64_t time_ns) {
    hd_atomic_u64_add_relaxed(&servo->overloads, 1);
    hd_event_add(servo->state, HD_EVENT_OVERLOAD, time_ns, 0, share);
    if (servo->config.overrun_action == HD_OVERRUN_FAULT) {
        hd_state_latch(servo->state, HD_FAULT_OVERRUN, 0, time_ns);
    } else if (servo->config.overrun_action == HD_OVERRUN_STEP_DOWN && !servo->ending) {
        servo->stepping = 1;
        servo->ending = 1;
        servo->wanted = servo->state->enabled;
        hd_atomic_u32_store_relaxed(&servo->overloaded, 1);
    }
}

/* See hd_servo.h. */
HD_RT void hd_servo_watch_load(struct hd_servo *servo, uint32_t periods, uint32_t missed, int64_t time_ns) {
    const double stall_ns = (double)missed * servo->period_ns;
    if (stall_ns > HD_STALL_NS && stall_ns > 2.0 * (double)servo->last_work_ns) {
        servo->load_periods = 0;
        servo->load_missed = 0;
        return;
    }
    servo->load_periods += periods;
    servo->load_missed += missed;
    if ((double)servo->load_periods * servo->period_s < HD_LOAD_S) {
        return;
    }
    const double share = (double)servo->load_missed / (double)servo->load_periods;
    servo->load_periods = 0;
    servo->load_missed = 0;
    hd_atomic_f64_store_relaxed(&servo->missed_share, share);
    if (share > servo->config.overrun_threshold) {
        report_overload(servo, share, time_ns);
    }
}

/* Detects a suspend of the machine. CLOCK_MONOTONIC stops during a suspend, so no periods are missed, but handle and
 * device may have moved: the force fades in over the ramp. */
HD_RT void hd_servo_watch_suspends(struct hd_servo *servo, int64_t time_ns) {
    if (servo->until_look > 0) {
        servo->until_look--;
        return;
    }
    servo->until_look = (uint32_t)(HD_SUSPEND_LOOK_S / servo->period_s);
    /* The difference of the clocks is between least_ns and most_ns, because this thread may be delayed between two of
     * these lines. */
    const int64_t before_ns = hd_clock_now_ns();
    const int64_t boot_ns = hd_clock_boot_ns();
    const int64_t least_ns = boot_ns - hd_clock_now_ns();
    const int64_t most_ns = boot_ns - before_ns;
    if (least_ns > servo->suspended_ns + HD_SUSPEND_NS) {
        struct hd_state *state = servo->state;
        hd_atomic_u64_add_relaxed(&servo->suspends, 1);
        hd_event_add(servo->state, HD_EVENT_RESUMED, time_ns, 0, (double)(least_ns - servo->suspended_ns) * 1e-9);
        hd_velocity_reset(&state->velocity);
        state->located = 0;
        state->gain = 0.0;
        servo->suspended_ns = most_ns;
    } else if (most_ns < servo->suspended_ns) {
        servo->suspended_ns = most_ns;
    }
}

/* See hd_servo.h. */
HD_RT void hd_servo_watch(struct hd_servo *servo, const struct hd_look *look, int64_t now_ns, int64_t time_ns) {
    const uint64_t beat = hd_atomic_u64_load_relaxed(&servo->beat);
    if (beat != servo->last_beat) {
        servo->last_beat = beat;
        servo->ticks_since_beat = 0;
    } else if ((double)++servo->ticks_since_beat * servo->period_s > HD_CONTROL_TIMEOUT_S) {
        hd_state_latch(servo->state, HD_FAULT_CONTROL, 0, time_ns);
    }
    const int64_t lease_ns = hd_atomic_i64_load_relaxed(&servo->lease_ns);
    if (lease_ns != 0 && now_ns > lease_ns) {
        hd_state_latch(servo->state, HD_FAULT_LEASE, 0, time_ns);
    }
    watch_device(servo, look, time_ns);
}
