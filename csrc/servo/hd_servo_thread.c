/* The servo's thread, which calls the tick on time.
 *
 * One period, top to bottom: sleep until the deadline (with a busy-wait at the end, if configured) or until the device
 * reports; count and skip missed periods; take the newest table, then the commands of its revision or older; read the
 * device, check its signs, tick, put the force; write the sample and the events to their rings. The thread never
 * allocates, locks, logs or blocks, and its only system calls are the clock and the sleep.
 *
 * After an overload with HD_OVERRUN_STEP_DOWN the thread fades the force out and ends, which is the only way to give
 * the rest of the machine a processor for certain. hd_servo_set_rate and hd_servo_restart, on the control side,
 * continue from there.
 *
 * Times are CLOCK_MONOTONIC nanoseconds. Deadlines are start + k/rate, without accumulated rounding errors. With
 * HD_CLOCK_DEVICE a tick has the time of its report, and the period whose deadline is nearest to it. */
#include "servo/hd_servo.h"

#include <sys/prctl.h>

#include "base/hd_cache.h"
#include "base/hd_clock.h"
#include "base/hd_vector.h"
#include "tick/hd_tick.h"

/* Share of the error, and largest part of a period, by which a tick moves the deadlines towards the reports. Reports
 * drift against our clock, and a tick on the border between two periods would alternate between them. */
#define HD_LOCK_SHARE 0.0625
#define HD_LOCK_MAX 0.001

/* ---- One tick ---------------------------------------------------------------------------------------------------- */

HD_RT static int32_t saturate_i32(int64_t value) {
    return value > INT32_MAX ? INT32_MAX : value < INT32_MIN ? INT32_MIN : (int32_t)value;
}

/* Sends strikes of device effects, or a silence once the forces or the vibration are no longer fully on. */
HD_RT static void send_strikes(struct hd_servo *servo, int64_t now_ns) {
    struct hd_state *state = servo->state;
    const int fully = state->enabled && state->gain == 1.0 && state->show_vibration == 1.0;
    if (!fully && servo->offloading) {
        hd_hid_step_silence(servo->device.hid);
    }
    servo->offloading = (uint8_t)fully;
    for (uint32_t i = 0; i < state->offload_count && fully; i++) {
        hd_hid_step_strike(servo->device.hid, now_ns, state->offloads[i].effect, state->offloads[i].force_n);
    }
    state->offload_count = 0;
}

HD_RT static void one_tick(struct hd_servo *servo, int64_t deadline_ns, int64_t now_ns, uint32_t periods) {
    struct hd_state *state = servo->state;
    struct hd_sample sample;
    struct hd_look look;
    struct hd_input input = {.time_ns = deadline_ns, .periods = periods};
    hd_servo_take_table(servo, deadline_ns);
    if (servo->stepping) {
        hd_state_want_forces(state, servo->wanted);
    }
    hd_servo_take_streams(servo, deadline_ns); /* before commands, so that a path replaces a streamed target */
    hd_servo_take_commands(servo, deadline_ns);
    hd_servo_watch_load(servo, periods, servo->missed, deadline_ns);
    hd_servo_watch_suspends(servo, deadline_ns);
    if (servo->ending) {
        servo->wanted = state->enabled;
        hd_state_want_forces(state, 0);
    }
    hd_device_advance(&servo->device, periods);
    if (servo->device.sim != NULL) {
        hd_gesture_watch(state, servo->device.sim, deadline_ns);
    }
    hd_device_look(&servo->device, now_ns, &look);
    hd_servo_watch(servo, &look, now_ns, deadline_ns);
    hd_sense(state, &servo->world->table, &look.reading, NULL, &input);
    if (servo->device.hid != NULL) {
        hd_signs_watch(&servo->signs_check, &look, state, &servo->world->table, &input);
        hd_atomic_u32_store_relaxed(&servo->signs, hd_signs_told(&servo->signs_check));
    }
    state->offload_open = (uint8_t)hd_device_has_effects(&servo->device);
    hd_tick(servo->world, state, &input, &sample);
    if (state->offload_open || servo->offloading) {
        send_strikes(servo, now_ns);
    }
    hd_device_put(&servo->device, now_ns, sample.force_n);
    const int64_t work_ns = hd_clock_now_ns() - now_ns;
    sample.lateness_ns = saturate_i32(now_ns - deadline_ns);
    sample.work_ns = saturate_i32(work_ns);
    servo->last_work_ns = work_ns;
    servo->last_force_n = hd_root(hd_dot(sample.force_n, sample.force_n));
    hd_servo_leave(servo, &sample);
}

/* ---- Deadlines --------------------------------------------------------------------------------------------------- */

/* The servo's position in time. */
struct hd_pace {
    int64_t start_ns; /* deadline of period 0 */
    uint64_t period;  /* the next period */
    int64_t last_ns;  /* time of the last tick */
    int led;          /* 1: a report triggered the last tick */
};

struct hd_due {
    int64_t time_ns; /* time of the tick */
    int64_t now_ns;
    uint32_t periods; /* periods since the last tick */
};

HD_RT static int64_t deadline_of(const struct hd_servo *servo, int64_t start_ns, uint64_t period) {
    return start_ns + (int64_t)((double)period * servo->period_ns + 0.5);
}

/* Prefetches the memory of servo, device, state and table that every tick uses. */
HD_RT static void prefetch(const struct hd_servo *servo) {
    hd_cache_fetch(servo, offsetof(struct hd_servo, samples));
    hd_device_fetch(&servo->device);
    hd_cache_fetch(servo->state, offsetof(struct hd_state, velocity) + sizeof(struct hd_velocity) / 64);
    hd_cache_fetch(&servo->world->table, sizeof servo->world->table);
}

/* Waits for the deadline and returns the time after the wait. */
HD_RT static int64_t wait_until(const struct hd_servo *servo, int64_t deadline_ns) {
    const int64_t spin_ns = servo->config.spin_ns;
    if (spin_ns > 0) {
        if (hd_clock_now_ns() < deadline_ns - spin_ns) {
            hd_clock_sleep_until(deadline_ns - spin_ns);
        }
        prefetch(servo);
        int64_t now = hd_clock_now_ns();
        while (now < deadline_ns) {
            now = hd_clock_now_ns();
        }
        return now;
    }
    hd_clock_sleep_until(deadline_ns);
    prefetch(servo);
    return hd_clock_now_ns();
}

HD_RT static void wait_timer(struct hd_servo *servo, struct hd_pace *pace, struct hd_due *due) {
    due->time_ns = deadline_of(servo, pace->start_ns, pace->period);
    due->now_ns = wait_until(servo, due->time_ns);
    due->periods = 1;
}

/* Moves the deadlines towards a report of this period. */
HD_RT static void lock_to_report(struct hd_servo *servo, struct hd_pace *pace, int64_t arrival_ns, uint64_t period) {
    double error_ns = (double)(arrival_ns - deadline_of(servo, pace->start_ns, period));
    if (pace->led) {
        const double most_ns = HD_LOCK_MAX * servo->period_ns;
        error_ns *= HD_LOCK_SHARE;
        error_ns = error_ns > most_ns ? most_ns : error_ns < -most_ns ? -most_ns : error_ns;
    }
    pace->start_ns += (int64_t)error_ns;
    pace->led = 1;
}

/* Waits for the next report that is at least a period after the one before. Without a report for two and a half periods
 * (enough for a device of half the rate) the timer takes over until the next report. */
HD_RT static void wait_device(struct hd_servo *servo, struct hd_pace *pace, struct hd_due *due) {
    const int64_t half_ns = (int64_t)(0.5 * servo->period_ns);
    int64_t limit_ns = pace->led ? deadline_of(servo, pace->start_ns, pace->period + 1) + half_ns
                                 : deadline_of(servo, pace->start_ns, pace->period);
    int64_t arrival_ns;
    while (hd_hid_step_await(servo->device.hid, limit_ns, &arrival_ns)) {
        const int64_t since_ns = arrival_ns + half_ns - pace->start_ns;
        const uint64_t period = since_ns > 0 ? (uint64_t)((double)since_ns / servo->period_ns) : 0;
        if (period >= pace->period && arrival_ns > pace->last_ns) {
            due->time_ns = arrival_ns;
            due->now_ns = hd_clock_now_ns();
            due->periods = (uint32_t)(period - pace->period) + 1;
            pace->period = period;
            lock_to_report(servo, pace, arrival_ns, period);
            return;
        }
        if (!pace->led && arrival_ns > pace->last_ns) {
            /* Too soon after a tick of the timer, as would be all following reports: moves the deadlines and waits for
             * the next report. */
            pace->start_ns += arrival_ns + 2 * half_ns - deadline_of(servo, pace->start_ns, pace->period);
            pace->led = 1;
            limit_ns = deadline_of(servo, pace->start_ns, pace->period + 1) + half_ns;
        }
    }
    due->time_ns = limit_ns;
    due->now_ns = hd_clock_now_ns();
    due->periods = pace->led ? 2 : 1;
    pace->period += pace->led ? 1 : 0;
    pace->led = 0;
}

/* Counts and skips missed periods, and moves the tick from `due->time_ns` to the present period. */
HD_RT static void skip_missed(struct hd_servo *servo, struct hd_pace *pace, struct hd_due *due) {
    const double late = (double)(due->now_ns - due->time_ns);
    if (late >= servo->period_ns) {
        const double missed = late / servo->period_ns;
        const uint32_t skip = missed < 4e9 ? (uint32_t)missed : 4000000000u;
        due->periods += skip;
        pace->period += skip;
        due->time_ns = due->time_ns - deadline_of(servo, pace->start_ns, pace->period - skip) +
                       deadline_of(servo, pace->start_ns, pace->period);
        servo->missed = skip;
        hd_atomic_u64_add_relaxed(&servo->skipped, skip);
        hd_atomic_u64_add_relaxed(&servo->overruns, 1);
        hd_event_add(servo->state, HD_EVENT_OVERRUN, due->time_ns, 0, (double)skip);
    }
}

/* ---- The thread -------------------------------------------------------------------------------------------------- */

HD_RT static void run_ticks(struct hd_servo *servo) {
    struct hd_state *state = servo->state;
    struct hd_pace pace = {.start_ns = hd_clock_now_ns() + (int64_t)servo->period_ns};
    /* The periods since an earlier thread ended, and more than the ramp. */
    uint64_t pause = servo->pause_periods;
    if (pause > 0) {
        const double gone = (double)(pace.start_ns - servo->ended_ns) / servo->period_ns;
        pause = gone < 4e9 ? pause + (uint64_t)gone : 4000000000u;
    }
    while (!servo->ending || state->gain > 0.0) {
        struct hd_due due;
        if (servo->config.clock == HD_CLOCK_DEVICE) {
            wait_device(servo, &pace, &due);
        } else {
            wait_timer(servo, &pace, &due);
        }
        servo->late_ns = due.now_ns - due.time_ns;
        servo->missed = 0;
        skip_missed(servo, &pace, &due);
        if (hd_atomic_u32_load_acquire(&servo->stopping)) {
            servo->ending = 1;
        }
        if (servo->new_rate_hz > 0.0) {
            hd_event_add(servo->state, HD_EVENT_RATE, due.time_ns, 0, servo->new_rate_hz);
            servo->new_rate_hz = 0.0;
        }
        one_tick(servo, due.time_ns, due.now_ns, due.periods + (uint32_t)pause);
        if (pause > 0) {
            pause = 0;
            servo->load_periods = 0; /* these periods were not missed */
            servo->load_missed = 0;
        }
        pace.last_ns = due.time_ns;
        pace.period++;
    }
    const double zero[2] = {0.0, 0.0};
    servo->ended_ns = hd_clock_now_ns();
    hd_device_put(&servo->device, servo->ended_ns, zero);
}

void *hd_servo_main(void *argument) {
    struct hd_servo *servo = argument;
    /* Without real-time priority the kernel may round sleeps by 50 us; with it this changes nothing. */
    prctl(PR_SET_TIMERSLACK, 1ul, 0ul, 0ul, 0ul);
    run_ticks(servo);
    hd_atomic_u32_store_release(&servo->running, 0);
    return NULL;
}
