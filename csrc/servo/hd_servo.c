/* The servo: a thread that calls the tick on time.
 *
 * One period, top to bottom: sleep until the deadline (the last part of it spinning, if asked for) or until the device
 * reports; count and skip the periods that were missed; take the newest table, then the commands of its revision or
 * older; read the device, check its signs, tick, put the force; leave the sample and the events in their rings. The
 * thread never allocates, locks, logs or blocks, and its only system calls are the clock and the sleep.
 *
 * Who touches what:
 *   config, device, rings' memory     made by hd_servo_new, constant while the thread runs
 *   triple + worlds                   the publisher fills the back one, the servo reads the front one
 *   changes, locked                   the publisher's own
 *   commands                          the sender produces, the servo consumes
 *   samples, events                   the servo produces, one reader consumes
 *   told + touching                   the servo fills the back one, that reader reads the front one
 *   beat, lease_ns, stopping,
 *   memory_refused                    control writes, the servo reads
 *   counters, taken_*, adopted_*      the servo writes, control reads
 *   state and the fields under it     the servo's own
 *
 * A thread that was overloaded and is to step down fades the force out and ends by itself: only so does the rest of the
 * machine surely get a processor. hd_servo_set_rate and hd_servo_restart, on the control side, go on from there.
 *
 * Times are CLOCK_MONOTONIC nanoseconds. Deadlines are start + k/rate, never accumulated. Where the device leads, a
 * tick has the time of its report, and the period whose deadline is nearest to it. */
#include <errno.h>
#include <math.h>
#include <pthread.h>
#include <sched.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>

#include "base/hd_atomic.h"
#include "base/hd_clock.h"
#include "base/hd_histogram.h"
#include "base/hd_memory.h"
#include "base/hd_ring.h"
#include "base/hd_triple.h"
#include "base/hd_vector.h"
#include "device/hd_device.h"
#include "device/hd_gesture.h"
#include "device/hd_signs.h"
#include "scene/hd_world.h"
#include "tick/hd_mode.h"
#include "tick/hd_tick.h"

#define HD_COMMAND_CAPACITY 1024u
#define HD_EVENT_RING_CAPACITY 8192u
#define HD_GESTURE_ENDS 64u      /* room in the ring of events for these, beside that for marks */
#define HD_ADOPTED_CAPACITY 256u /* revisions whose first tick is remembered */
#define HD_COMMANDS_PER_TICK 64u
#define HD_CONTROL_TIMEOUT_S 1.0 /* of ticks rendered, so that a stopped process does not count against control */
#define HD_CHANGE_CAPACITY 4096u
#define HD_LOAD_S 1.0 /* overloads are judged by so much at a time */
/* A stall longer than this, by no tick of ours, says that the process was stopped, and nothing about its load. */
#define HD_PAUSE_NS 100000000.0
#define HD_SUSPEND_LOOK_S 0.001 /* so often it is asked whether the machine was suspended */
#define HD_SUSPEND_NS 50000000  /* less is none */
/* How far a tick moves the deadlines towards the reports, in periods: reports drift against our clock, and a tick on
 * the border between two periods would now fall into one, now into the other. */
#define HD_LOCK_SHARE 0.0625
#define HD_LOCK_MAX 0.001
#define HD_WRITTEN_REGIONS 4u /* the servo itself and its rings */
#define HD_SERVO_REGIONS (HD_STATE_REGIONS + 3u * HD_WORLD_REGIONS + 1u + HD_WRITTEN_REGIONS)

/* What a world has missed since it was filled last. More slots than are changed do no harm. */
struct hd_changes {
    uint32_t all; /* 0 or 1 */
    uint32_t count;
    uint32_t slots[HD_CHANGE_CAPACITY];
};

/* What is touched, whole. */
struct hd_touching {
    uint32_t count;
    struct hd_touched touched[HD_TOUCHED_MAX];
};

struct hd_servo {
    struct hd_servo_config config;
    struct hd_device device;
    double period_ns;
    double period_s;

    struct hd_triple triple;
    struct hd_world worlds[3];
    struct hd_changes changes[3]; /* of each world */
    uint32_t object_count;        /* of the table that was published last */
    double max_force_n;           /* of every table; 0: none was published yet */
    struct hd_region locked[3][HD_WORLD_REGIONS];
    int32_t memory_kind; /* of the grant: locked once, at the start */
    int32_t memory_error;
    uint32_t locked_slots;
    uint8_t locking; /* only regions are locked, so that those that come later must be, too */
    struct hd_ring commands;
    struct hd_ring samples;
    struct hd_ring events;
    uint64_t sent; /* the sender's own: commands sent so far */
    struct hd_triple told;
    struct hd_touching touching[3];

    struct hd_atomic_u64 beat;
    struct hd_atomic_i64 lease_ns;
    struct hd_atomic_u32 stopping;

    struct hd_atomic_u64 ticks;
    struct hd_atomic_u64 skipped;
    struct hd_atomic_u64 overruns;
    struct hd_atomic_u64 strikes;
    struct hd_atomic_u64 glitches;
    struct hd_atomic_u64 saturations;
    struct hd_atomic_u64 energy; /* the bits of a double, as is the next */
    struct hd_atomic_u64 largest_energy;
    struct hd_atomic_u64 contacts;
    struct hd_atomic_u64 restrained;
    struct hd_atomic_u64 acted;
    struct hd_atomic_u32 revision;
    struct hd_atomic_u32 faults;
    struct hd_atomic_u32 forces_on;
    struct hd_atomic_u32 running;
    struct hd_atomic_u32 memory_refused;
    struct hd_atomic_u32 overloaded;
    struct hd_atomic_u64 overloads;
    struct hd_atomic_u64 suspends;
    struct hd_atomic_u64 missed_share; /* the bits of a double */
    struct hd_atomic_u32 signs;
    struct hd_histogram_counts lateness;
    struct hd_histogram_counts work;
    struct hd_atomic_u64 taken; /* commands taken; the tick that took each is in taken_tick */
    struct hd_atomic_u64 taken_tick[HD_COMMAND_CAPACITY];
    struct hd_atomic_u64 adopted; /* revisions taken; each with its first tick below */
    struct hd_atomic_u32 adopted_revision[HD_ADOPTED_CAPACITY];
    struct hd_atomic_u64 adopted_tick[HD_ADOPTED_CAPACITY];

    struct hd_state *state;
    const struct hd_world *world;
    uint64_t touches_told; /* of the state's */
    uint64_t last_beat;
    uint64_t ticks_since_beat;
    double since_report_s;
    uint32_t connection; /* of the device, that positions are of */
    uint8_t device_lost;
    uint8_t offloading;    /* the device may be playing something by itself */
    uint8_t ending;        /* the force fades out, whatever is still commanded */
    uint8_t stepping;      /* that is for another rate */
    uint8_t wanted;        /* stepping: whether forces are wanted then */
    uint32_t refused;      /* memory_refused, as it was told */
    uint64_t load_periods; /* since load was judged last */
    uint64_t load_missed;
    uint32_t missed; /* periods, just before this tick */
    int64_t last_work_ns;
    int64_t late_ns;      /* of this tick, against the first deadline that it missed */
    uint32_t until_look;  /* ticks, to the next look whether the machine was suspended */
    int64_t suspended_ns; /* by how much CLOCK_BOOTTIME is ahead, at most */
    double still_s;       /* that the reported position has not changed, under force */
    double still_m[2];
    double last_force_n;
    struct hd_signs signs_check;
    uint64_t pause_periods; /* that the first tick of a thread is told of, beside its own */
    int64_t ended_ns;
    double rate_told_hz; /* a restarted thread has another rate than the one before: told by its first tick; 0: no */
    pthread_t thread;
    uint8_t started;
};

/* ---- The servo thread --------------------------------------------------------------------------------------- */

HD_RT static int32_t saturate(int64_t value) {
    return value > INT32_MAX ? INT32_MAX : value < INT32_MIN ? INT32_MIN : (int32_t)value;
}

/* Waits for the deadline; returns the time that it is then. */
HD_RT static int64_t wait_until(int64_t deadline_ns, int64_t spin_ns) {
    if (spin_ns > 0) {
        if (hd_clock_now_ns() < deadline_ns - spin_ns) {
            hd_clock_sleep_until(deadline_ns - spin_ns);
        }
        int64_t now = hd_clock_now_ns();
        while (now < deadline_ns) {
            now = hd_clock_now_ns();
        }
        return now;
    }
    hd_clock_sleep_until(deadline_ns);
    return hd_clock_now_ns();
}

HD_RT static int64_t deadline_of(const struct hd_servo *servo, int64_t start_ns, uint64_t period) {
    return start_ns + (int64_t)((double)period * servo->period_ns + 0.5);
}

HD_RT static void take_table(struct hd_servo *servo, int64_t time_ns) {
    if (!hd_triple_acquire(&servo->triple)) {
        return;
    }
    servo->world = &servo->worlds[hd_triple_front(&servo->triple)];
    const uint32_t revision = servo->world->table.revision;
    const uint64_t count = hd_atomic_u64_load_relaxed(&servo->adopted);
    const size_t at = (size_t)(count % HD_ADOPTED_CAPACITY);
    hd_atomic_u32_store_relaxed(&servo->adopted_revision[at], revision);
    hd_atomic_u64_store_relaxed(&servo->adopted_tick[at], servo->state->tick);
    hd_atomic_u64_store_release(&servo->adopted, count + 1);
    hd_atomic_u32_store_relaxed(&servo->revision, revision);
    hd_event_add(servo->state, HD_EVENT_REVISION, time_ns, revision, 0.0);
    const uint32_t refused = hd_atomic_u32_load_relaxed(&servo->memory_refused);
    if (refused != servo->refused) {
        servo->refused = refused;
        hd_event_add(servo->state, HD_EVENT_MEMORY_REFUSED, time_ns, refused, 0.0);
    }
}

/* HD_ERR_FULL: not in this tick. */
HD_RT static int apply(struct hd_servo *servo, const struct hd_command *command, int64_t time_ns) {
    struct hd_state *state = servo->state;
    switch (command->kind) {
    case HD_COMMAND_PLAY:
        return hd_tick_play(state, &command->mode, command->direction, command->amplitude);
    case HD_COMMAND_RESET:
        hd_tick_reset(state, command->slot, command->generation, time_ns);
        return HD_OK;
    case HD_COMMAND_FORCES:
        if (command->value != 0) {
            const int64_t lease_ns = hd_atomic_i64_load_relaxed(&servo->lease_ns);
            const uint32_t remaining = (servo->device_lost ? (uint32_t)HD_FAULT_DEVICE : 0u) |
                                       (lease_ns != 0 && time_ns > lease_ns ? (uint32_t)HD_FAULT_LEASE : 0u) |
                                       (servo->signs_check.state == HD_SIGNS_WRONG ? (uint32_t)HD_FAULT_SIGNS : 0u);
            servo->still_s = 0.0;
            hd_state_clear_faults(state, remaining, time_ns);
        } else {
            hd_state_want_forces(state, 0);
        }
        return HD_OK;
    case HD_COMMAND_OPERATOR:
        hd_gesture_begin(state, servo->device.sim, command->path, time_ns);
        return HD_OK;
    case HD_COMMAND_MARK:
        hd_event_add(servo->state, HD_EVENT_MARK, time_ns, command->value, 0.0);
        return HD_OK;
    default:
        return HD_OK; /* refused by hd_servo_send */
    }
}

/* Commands of the table's revision or older, in order; a later one waits for its table. */
HD_RT static void take_commands(struct hd_servo *servo, int64_t time_ns) {
    for (uint32_t i = 0; i < HD_COMMANDS_PER_TICK; i++) {
        const struct hd_command *command = hd_ring_peek(&servo->commands);
        if (command == NULL || (int32_t)(command->revision - servo->world->table.revision) > 0) {
            return;
        }
        if (apply(servo, command, time_ns) == HD_ERR_FULL) {
            return;
        }
        hd_ring_release(&servo->commands);
        const uint64_t taken = hd_atomic_u64_load_relaxed(&servo->taken);
        hd_atomic_u64_store_relaxed(&servo->taken_tick[taken % HD_COMMAND_CAPACITY], servo->state->tick);
        hd_atomic_u64_store_release(&servo->taken, taken + 1);
    }
}

HD_RT static void lose_device(struct hd_servo *servo, int64_t time_ns) {
    if (!servo->device_lost) {
        servo->device_lost = 1;
        hd_event_add(servo->state, HD_EVENT_DEVICE_LOST, time_ns, 0, servo->since_report_s);
        hd_state_latch(servo->state, HD_FAULT_DEVICE, 1, time_ns);
    }
}

/* A handle that is pushed and does not move by a single count: whoever asked for it is sure that it then cannot be one.
 */
HD_RT static void watch_frozen(struct hd_servo *servo, const struct hd_look *look, int64_t time_ns) {
    const double *position = look->reading.position_m;
    /* Bit for bit: the very same counts. */
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
            lose_device(servo, time_ns); /* it may have been away between two ticks */
        }
        servo->connection = look->connection;
        /* How it came to be where it is, nobody knows. */
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
    /* A period for each tick: those that the servo itself missed say nothing about the device. */
    servo->since_report_s += servo->period_s;
    const int nowhere = look->connection == 0 && servo->state->enabled; /* a force without a position */
    if (look->gone || nowhere || servo->since_report_s > servo->config.device_timeout_s) {
        lose_device(servo, time_ns);
    }
}

HD_RT static uint64_t bits_of(double value) {
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

HD_RT static void overload(struct hd_servo *servo, double share, int64_t time_ns) {
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

/* Which part of the periods is missed, second after second. `missed`: of the `periods` since the tick before, those
 * that the clock went past; a device that leads and is slow makes periods, too. */
HD_RT static void watch_load(struct hd_servo *servo, uint32_t periods, uint32_t missed, int64_t time_ns) {
    const double stall_ns = (double)missed * servo->period_ns;
    if (stall_ns > HD_PAUSE_NS && stall_ns > 2.0 * (double)servo->last_work_ns) {
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
    hd_atomic_u64_store_relaxed(&servo->missed_share, bits_of(share));
    if (share > servo->config.overrun_threshold) {
        overload(servo, share, time_ns);
    }
}

/* A machine that was suspended: CLOCK_MONOTONIC stood still meanwhile, so that nothing was missed, and yet nobody knows
 * what became of handle and device. The force comes in over the ramp. */
HD_RT static void watch_suspends(struct hd_servo *servo, int64_t time_ns) {
    if (servo->until_look > 0) {
        servo->until_look--;
        return;
    }
    servo->until_look = (uint32_t)(HD_SUSPEND_LOOK_S / servo->period_s);
    /* The truth lies between the two: this thread may be held up between any two of these lines. */
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

/* Everything but the tick itself that can call for zero force. */
HD_RT static void watch(struct hd_servo *servo, const struct hd_look *look, int64_t now_ns, int64_t time_ns) {
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

/* Room in the ring that an event of this kind leaves to others: somebody waits for marks and for gestures to end. */
HD_RT static size_t kept_free(uint32_t kind) {
    return kind == HD_EVENT_MARK ? 0u : kind == HD_EVENT_GESTURE_END ? HD_MARKS : HD_MARKS + HD_GESTURE_ENDS;
}

HD_RT static void leave_events(struct hd_servo *servo) {
    struct hd_state *state = servo->state;
    size_t room = hd_ring_free_space(&servo->events);
    for (uint32_t i = 0; i < state->event_count; i++) {
        const struct hd_event *event = &state->events[i];
        if (room > kept_free(event->kind) && hd_ring_push(&servo->events, event) == HD_OK) {
            room--;
        } else {
            hd_ring_drop(&servo->events);
        }
    }
    state->event_count = 0;
    while (state->events_dropped > 0) {
        hd_ring_drop(&servo->events);
        state->events_dropped--;
    }
}

HD_RT static void tell_touched(struct hd_servo *servo) {
    const struct hd_state *state = servo->state;
    struct hd_touching *touching = &servo->touching[hd_triple_back(&servo->told)];
    touching->count = state->active_count < HD_TOUCHED_MAX ? state->active_count : HD_TOUCHED_MAX;
    for (uint32_t i = 0; i < touching->count; i++) {
        const uint32_t slot = state->active[i];
        touching->touched[i] = (struct hd_touched){slot, state->slots[slot].generation};
    }
    hd_triple_publish(&servo->told);
    servo->touches_told = state->touches;
}

HD_RT static void leave_sample(struct hd_servo *servo, const struct hd_sample *sample) {
    struct hd_sample *slot = hd_ring_reserve(&servo->samples);
    if (slot == NULL) {
        hd_ring_drop(&servo->samples);
        return;
    }
    *slot = *sample;
    hd_ring_commit(&servo->samples);
}

/* What the device plays by itself; none of it once the forces or the vibration are no longer fully on. */
HD_RT static void offload(struct hd_servo *servo, int64_t now_ns) {
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

static double number_of(uint64_t bits) {
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

HD_RT static void publish_energy(struct hd_servo *servo) {
    const struct hd_passivity *passivity = &servo->state->passivity;
    hd_atomic_u64_store_relaxed(&servo->energy, bits_of(passivity->energy_j));
    hd_atomic_u64_store_relaxed(&servo->largest_energy, bits_of(passivity->largest_j));
    hd_atomic_u64_store_relaxed(&servo->contacts, passivity->contacts);
    hd_atomic_u64_store_relaxed(&servo->restrained, passivity->restrained);
    hd_atomic_u64_store_relaxed(&servo->acted, passivity->acted);
}

HD_RT static double hypot_of(const double vector[2]) {
    return hd_root(hd_dot(vector, vector));
}

HD_RT static void one_tick(struct hd_servo *servo, int64_t deadline_ns, int64_t now_ns, uint32_t periods) {
    struct hd_state *state = servo->state;
    struct hd_sample sample;
    struct hd_look look;
    struct hd_input input = {.time_ns = deadline_ns, .periods = periods};
    take_table(servo, deadline_ns);
    if (servo->stepping) {
        hd_state_want_forces(state, servo->wanted);
    }
    take_commands(servo, deadline_ns);
    watch_load(servo, periods, servo->missed, deadline_ns);
    watch_suspends(servo, deadline_ns);
    if (servo->ending) {
        servo->wanted = state->enabled;
        hd_state_want_forces(state, 0);
    }
    hd_device_advance(&servo->device, periods);
    if (servo->device.sim != NULL) {
        hd_gesture_watch(state, servo->device.sim, deadline_ns);
    }
    hd_device_look(&servo->device, now_ns, &look);
    watch(servo, &look, now_ns, deadline_ns);
    hd_sense(state, &servo->world->table, &look.reading, NULL, &input);
    if (servo->device.hid != NULL) {
        hd_signs_watch(&servo->signs_check, &look, state, &servo->world->table, &input);
        hd_atomic_u32_store_relaxed(&servo->signs, hd_signs_told(&servo->signs_check));
    }
    state->offload_open = (uint8_t)hd_device_offers(&servo->device);
    hd_tick(servo->world, state, &input, &sample);
    if (state->offload_open || servo->offloading) {
        offload(servo, now_ns);
    }
    hd_device_put(&servo->device, now_ns, sample.force_n);
    const int64_t work_ns = hd_clock_now_ns() - now_ns;
    sample.lateness_ns = saturate(now_ns - deadline_ns);
    sample.work_ns = saturate(work_ns);
    servo->last_work_ns = work_ns;
    servo->last_force_n = hypot_of(sample.force_n);
    hd_histogram_count(&servo->lateness, servo->late_ns);
    hd_histogram_count(&servo->work, work_ns);
    hd_atomic_u64_store_relaxed(&servo->strikes, state->strikes_total);
    hd_atomic_u64_store_relaxed(&servo->glitches, state->glitches_total);
    hd_atomic_u64_store_relaxed(&servo->saturations, state->saturations_total);
    if (servo->world->table.passivity != HD_PASSIVITY_OFF) {
        publish_energy(servo);
    }
    hd_atomic_u32_store_relaxed(&servo->faults, state->faults);
    hd_atomic_u32_store_relaxed(&servo->forces_on, state->enabled);
    /* In this order: who has read a tick's sample finds its events, and who has read an event finds what it tells of in
     * the counters and in what is touched; the rings release what was stored before. */
    if (servo->touches_told != state->touches) {
        tell_touched(servo);
    }
    if (state->event_count > 0) {
        leave_events(servo);
    }
    leave_sample(servo, &sample);
    hd_atomic_u64_store_release(&servo->ticks, state->tick);
}

/* Where the servo is in time. */
struct hd_pace {
    int64_t start_ns; /* deadline of period 0 */
    uint64_t period;  /* the next one */
    int64_t last_ns;  /* time of the last tick */
    int led;          /* the last tick was a report's */
};

struct hd_due {
    int64_t time_ns; /* of the tick */
    int64_t now_ns;
    uint32_t periods; /* since the last one */
};

/* Counts and skips the periods that were missed: the tick that was due at `due->time_ns` is due now. */
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

HD_RT static void wait_timer(struct hd_servo *servo, struct hd_pace *pace, struct hd_due *due) {
    due->time_ns = deadline_of(servo, pace->start_ns, pace->period);
    due->now_ns = wait_until(due->time_ns, servo->config.spin_ns);
    due->periods = 1;
}

/* Moves the deadlines towards a report of this period. */
HD_RT static void lock_pace(struct hd_servo *servo, struct hd_pace *pace, int64_t arrival_ns, uint64_t period) {
    double error_ns = (double)(arrival_ns - deadline_of(servo, pace->start_ns, period));
    if (pace->led) {
        const double most_ns = HD_LOCK_MAX * servo->period_ns;
        error_ns *= HD_LOCK_SHARE;
        error_ns = error_ns > most_ns ? most_ns : error_ns < -most_ns ? -most_ns : error_ns;
    }
    pace->start_ns += (int64_t)error_ns;
    pace->led = 1;
}

/* The next report that is not sooner than a period after the one before; without one for two and a half periods (a
 * device of half the rate is in time then), the timer, until there is one. */
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
            lock_pace(servo, pace, arrival_ns, period);
            return;
        }
        if (!pace->led && arrival_ns > pace->last_ns) {
            /* Too soon after a tick of the timer, as all that follow would be: the next one is waited for. */
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

HD_RT static void loop(struct hd_servo *servo) {
    struct hd_state *state = servo->state;
    struct hd_pace pace = {.start_ns = hd_clock_now_ns() + (int64_t)servo->period_ns};
    /* By as much as a thread before this one ended earlier, and by more than the ramp. */
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
        if (servo->rate_told_hz > 0.0) {
            hd_event_add(servo->state, HD_EVENT_RATE, due.time_ns, 0, servo->rate_told_hz);
            servo->rate_told_hz = 0.0;
        }
        one_tick(servo, due.time_ns, due.now_ns, due.periods + (uint32_t)pause);
        if (pause > 0) {
            pause = 0;
            servo->load_periods = 0; /* nobody was to render them */
            servo->load_missed = 0;
        }
        pace.last_ns = due.time_ns;
        pace.period++;
    }
    const double zero[2] = {0.0, 0.0};
    servo->ended_ns = hd_clock_now_ns();
    hd_device_put(&servo->device, servo->ended_ns, zero);
}

static void *servo_main(void *argument) {
    struct hd_servo *servo = argument;
    /* Without real-time priority the kernel may round sleeps by 50 us; with it this changes nothing. */
    prctl(PR_SET_TIMERSLACK, 1ul, 0ul, 0ul, 0ul);
    loop(servo);
    hd_atomic_u32_store_release(&servo->running, 0);
    return NULL;
}

/* ---- Control side ----------------------------------------------------------------------------------------------- */

static int config_check(const struct hd_servo_config *config) {
    if (!(config->rate_hz >= 1.0 && config->rate_hz <= 100000.0)) {
        return hd_invalid("servo: rate %g Hz is not between 1 and 100000", config->rate_hz);
    }
    if (config->spin_ns < 0 || (double)config->spin_ns > 1e9 / config->rate_hz) {
        return hd_invalid("servo: spinning for %lld ns does not fit into a period", (long long)config->spin_ns);
    }
    if (config->sample_capacity == 0 || (config->sample_capacity & (config->sample_capacity - 1)) != 0) {
        return hd_invalid("servo: %u samples is no power of two", config->sample_capacity);
    }
    if (!(config->device_timeout_s > 0.0)) {
        return hd_invalid("servo: a device time-out of %g s", config->device_timeout_s);
    }
    if (!(config->resolution_m >= 0.0 && config->resolution_m < 1.0)) {
        return hd_invalid("servo: an encoder step of %g m", config->resolution_m);
    }
    if (!(config->overrun_threshold >= 0.0 && config->overrun_threshold <= 1.0) ||
        config->overrun_action > HD_OVERRUN_STEP_DOWN) {
        return hd_invalid("servo: overruns above %g, action %u", config->overrun_threshold, config->overrun_action);
    }
    if (!(config->frozen_s >= 0.0 && config->frozen_force_n >= 0.0)) {
        return hd_invalid("servo: frozen after %g s under %g N", config->frozen_s, config->frozen_force_n);
    }
    if (config->clock != HD_CLOCK_TIMER && config->clock != HD_CLOCK_DEVICE) {
        return hd_invalid("servo: clock %u", config->clock);
    }
    return HD_OK;
}

static void take_rate(struct hd_servo *servo, double rate_hz) {
    servo->config.rate_hz = rate_hz;
    servo->period_ns = 1e9 / rate_hz;
    servo->period_s = 1.0 / rate_hz;
    if (servo->device.hid != NULL) {
        /* A tick that a report leads may be half a period early. */
        const double early = servo->config.clock == HD_CLOCK_DEVICE ? 0.5 : 1.0;
        hd_hid_expect_ticks(servo->device.hid, (int64_t)(early * servo->period_ns));
    }
}

struct hd_servo *hd_servo_new(const struct hd_servo_config *config, struct hd_sim *sim, struct hd_hid *hid) {
    if (config_check(config) != HD_OK) {
        return NULL;
    }
    if ((sim == NULL) == (hid == NULL)) {
        hd_invalid("servo: one device, a simulated one or a real one");
        return NULL;
    }
    if (config->clock == HD_CLOCK_DEVICE && hid == NULL) {
        hd_invalid("servo: the simulated joystick has no clock of its own");
        return NULL;
    }
    struct hd_servo *servo = NULL;
    if (posix_memalign((void **)&servo, HD_CACHE_LINE, sizeof *servo) != 0) {
        hd_invalid("no memory for the servo");
        return NULL;
    }
    memset(servo, 0, sizeof *servo);
    servo->config = *config;
    servo->device = (struct hd_device){.sim = sim, .hid = hid};
    if (config->clock == HD_CLOCK_DEVICE) {
        hd_hid_await_enable(hid);
    }
    take_rate(servo, config->rate_hz);
    servo->suspended_ns = INT64_MAX - HD_SUSPEND_NS;
    hd_triple_init(&servo->triple);
    hd_triple_init(&servo->told);
    servo->state = hd_state_new(config->slot_capacity);
    if (servo->state == NULL ||
        hd_ring_init(&servo->commands, sizeof(struct hd_command), HD_COMMAND_CAPACITY) != HD_OK ||
        hd_ring_init(&servo->samples, sizeof(struct hd_sample), config->sample_capacity) != HD_OK ||
        hd_ring_init(&servo->events, sizeof(struct hd_event), HD_EVENT_RING_CAPACITY) != HD_OK) {
        hd_invalid("no memory for the servo");
        hd_servo_free(servo);
        return NULL;
    }
    hd_state_set_resolution(servo->state, config->resolution_m);
    servo->state->gain = 0.0;
    servo->state->enabled = config->forces_on != 0;
    return servo;
}

void hd_servo_free(struct hd_servo *servo) {
    if (servo == NULL) {
        return;
    }
    if (servo->started) {
        hd_servo_stop(servo);
    }
    for (int i = 0; i < 3; i++) {
        hd_world_release(&servo->worlds[i]);
    }
    hd_ring_destroy(&servo->commands);
    hd_ring_destroy(&servo->samples);
    hd_ring_destroy(&servo->events);
    hd_state_free(servo->state);
    free(servo);
}

/* Everything that the servo touches: of what has room for more, no more than is in use. The last HD_WRITTEN_REGIONS
 * were written, all of them, by hd_servo_new, and before them comes the device. */
static size_t regions_of(struct hd_servo *servo, struct hd_region regions[HD_SERVO_REGIONS]) {
    size_t count = hd_state_regions(servo->state, 0, hd_state_slot_count(servo->state), regions);
    for (int i = 0; i < 3; i++) {
        count += hd_world_regions(&servo->worlds[i], &regions[count]);
    }
    regions[count++] = hd_device_region(&servo->device);
    regions[count++] = (struct hd_region){servo, sizeof *servo};
    regions[count++] = (struct hd_region){servo->commands.slots, HD_COMMAND_CAPACITY * sizeof(struct hd_command)};
    regions[count++] =
        (struct hd_region){servo->samples.slots, servo->config.sample_capacity * sizeof(struct hd_sample)};
    regions[count++] = (struct hd_region){servo->events.slots, HD_EVENT_RING_CAPACITY * sizeof(struct hd_event)};
    return count;
}

/* Where real time is required, the table is refused; else it is rendered from memory that is not locked, and that is
 * told. */
static int lock_refused(struct hd_servo *servo, uint32_t object_count, int error) {
    if (servo->config.realtime != HD_REALTIME_REQUIRED) {
        servo->locking = 0;
        hd_atomic_u32_store_relaxed(&servo->memory_refused, (uint32_t)error);
        return HD_OK;
    }
    return hd_invalid("table: %u objects need more locked memory than is allowed (%s): raise the limit (ulimit -l) or "
                      "run without real time",
                      object_count, strerror(error));
}

/* Locks the slots of a table that were not locked yet. */
static int lock_slots(struct hd_servo *servo, uint32_t slot_count) {
    if (!servo->locking || slot_count <= servo->locked_slots) {
        return HD_OK;
    }
    struct hd_region regions[HD_STATE_REGIONS];
    const size_t count = hd_state_regions(servo->state, servo->locked_slots, slot_count, regions);
    const int error = hd_memory_lock_regions(regions, count);
    if (error != 0) {
        return lock_refused(servo, slot_count, error);
    }
    servo->locked_slots = slot_count;
    return HD_OK;
}

/* Locks what a world has that it had not when it was locked last. */
static int lock_world(struct hd_servo *servo, uint32_t index) {
    if (!servo->locking) {
        return HD_OK;
    }
    struct hd_region regions[HD_WORLD_REGIONS];
    struct hd_region *locked = servo->locked[index];
    const size_t count = hd_world_regions(&servo->worlds[index], regions);
    for (size_t i = 0; i < count; i++) {
        if (regions[i].start == locked[i].start && regions[i].size == locked[i].size) {
            continue;
        }
        const int error = hd_memory_lock_regions(&regions[i], 1);
        if (error != 0) {
            return lock_refused(servo, servo->worlds[index].table.object_count, error);
        }
        locked[i] = regions[i];
    }
    return HD_OK;
}

/* Tries the thread with real-time priority, the highest that the limit allows, then without. 0 or an errno. */
static int create_thread(struct hd_servo *servo, struct hd_grant *grant) {
    pthread_attr_t attributes;
    int error = pthread_attr_init(&attributes);
    if (error != 0) {
        return error;
    }
    if (servo->config.realtime != HD_REALTIME_OFF) {
        const struct sched_param parameter = {.sched_priority = servo->config.priority};
        pthread_attr_setinheritsched(&attributes, PTHREAD_EXPLICIT_SCHED);
        pthread_attr_setschedpolicy(&attributes, SCHED_FIFO);
        error = pthread_attr_setschedparam(&attributes, &parameter);
        if (error == 0) {
            error = pthread_create(&servo->thread, &attributes, servo_main, servo);
        }
        if (error == 0) {
            grant->priority = servo->config.priority;
            pthread_attr_destroy(&attributes);
            return 0;
        }
        grant->scheduler = error;
        if (servo->config.realtime == HD_REALTIME_REQUIRED) {
            pthread_attr_destroy(&attributes);
            return error;
        }
    }
    pthread_attr_destroy(&attributes);
    return pthread_create(&servo->thread, NULL, servo_main, servo);
}

static int launch(struct hd_servo *servo, struct hd_grant *grant) {
    hd_atomic_u32_store_relaxed(&servo->running, 1);
    const int error = create_thread(servo, grant);
    if (error != 0) {
        hd_atomic_u32_store_relaxed(&servo->running, 0);
        errno = error;
        return servo->config.realtime == HD_REALTIME_REQUIRED ? HD_ERR_DENIED : HD_ERR_SYSTEM;
    }
    servo->started = 1;
    if (servo->config.cpu >= 0) {
        cpu_set_t set;
        CPU_ZERO(&set);
        CPU_SET((size_t)servo->config.cpu, &set);
        grant->affinity = pthread_setaffinity_np(servo->thread, sizeof set, &set);
    }
    return HD_OK;
}

int hd_servo_start(struct hd_servo *servo, struct hd_grant *grant) {
    *grant = (struct hd_grant){.memory_kind = HD_MEMORY_NONE};
    if (servo->started || !hd_triple_acquire(&servo->triple)) {
        return hd_invalid("servo: start it once, with a table published");
    }
    servo->world = &servo->worlds[hd_triple_front(&servo->triple)];
    hd_atomic_u32_store_relaxed(&servo->adopted_revision[0], servo->world->table.revision);
    hd_atomic_u64_store_relaxed(&servo->adopted, 1);
    hd_atomic_u32_store_relaxed(&servo->revision, servo->world->table.revision);
    struct hd_region regions[HD_SERVO_REGIONS];
    const size_t count = regions_of(servo, regions);
    /* Not what others use already: telemetry reads the servo's counters and rings, and the threads of a connected
     * device write to it, of which hd_hid_new has written all. */
    hd_memory_touch(regions, count - HD_WRITTEN_REGIONS - (servo->device.hid != NULL ? 1u : 0u));
    if (servo->config.realtime != HD_REALTIME_OFF) {
        grant->memory_kind = (int32_t)hd_memory_lock(regions, count, &grant->memory);
        if (grant->memory_kind == HD_MEMORY_NONE && servo->config.realtime == HD_REALTIME_REQUIRED) {
            return HD_ERR_DENIED;
        }
    }
    servo->memory_kind = grant->memory_kind;
    servo->memory_error = grant->memory;
    if (grant->memory_kind == HD_MEMORY_REGIONS) {
        servo->locking = 1;
        servo->locked_slots = hd_state_slot_count(servo->state);
        for (int i = 0; i < 3; i++) {
            hd_world_regions(&servo->worlds[i], servo->locked[i]);
        }
    }
    return launch(servo, grant);
}

int hd_servo_stop(struct hd_servo *servo) {
    if (!servo->started) {
        return HD_OK;
    }
    hd_atomic_u32_store_release(&servo->stopping, 1);
    const int error = pthread_join(servo->thread, NULL);
    if (error != 0) {
        errno = error;
        return HD_ERR_SYSTEM;
    }
    servo->started = 0;
    return HD_OK;
}

int hd_servo_set_rate(struct hd_servo *servo, double rate_hz, enum hd_overrun_action action) {
    if (!hd_atomic_u32_load_relaxed(&servo->overloaded)) {
        return hd_invalid("servo: another rate without an overload");
    }
    struct hd_servo_config config = servo->config;
    config.rate_hz = rate_hz;
    config.overrun_action = action;
    config.spin_ns = (double)config.spin_ns > 1e9 / rate_hz ? 0 : config.spin_ns;
    if (config_check(&config) != HD_OK) {
        return HD_ERR_INVALID;
    }
    const int status = hd_servo_stop(servo); /* it fades already, or has ended */
    if (status != HD_OK) {
        return status;
    }
    servo->config.overrun_action = config.overrun_action;
    servo->config.spin_ns = config.spin_ns;
    if (rate_hz != servo->config.rate_hz) {
        take_rate(servo, rate_hz);
        servo->rate_told_hz = rate_hz;
    }
    return HD_OK;
}

int hd_servo_retune(struct hd_servo *servo, uint64_t sequence, const struct hd_mode *mode) {
    if (servo->started) {
        return hd_invalid("servo: a play keeps its mode while the thread runs");
    }
    if (sequence > servo->sent) {
        return hd_invalid("servo: no command has the number %llu yet", (unsigned long long)sequence);
    }
    if (hd_atomic_u64_load_acquire(&servo->taken) >= sequence) {
        return HD_OK;
    }
    /* Nobody takes commands now, and the ring gives numbers from 0. */
    struct hd_command *command = hd_ring_slot(&servo->commands, sequence - 1);
    if (command->kind != HD_COMMAND_PLAY) {
        return hd_invalid("servo: command %llu is no play", (unsigned long long)sequence);
    }
    const int status = hd_play_check(mode, command->direction, command->amplitude);
    if (status == HD_OK) {
        command->mode = *mode;
    }
    return status;
}

int hd_servo_restart(struct hd_servo *servo, uint32_t faults, struct hd_grant *grant) {
    *grant = (struct hd_grant){.memory = servo->memory_error, .memory_kind = servo->memory_kind};
    if (servo->started || !hd_atomic_u32_load_relaxed(&servo->overloaded)) {
        return hd_invalid("servo: restart it after an overload");
    }
    struct hd_state *state = servo->state;
    hd_voices_silence(state); /* they turn by the old period */
    hd_state_want_forces(state, servo->wanted);
    if (faults != 0) {
        hd_state_latch(state, faults, 0, hd_clock_now_ns());
    }
    servo->stepping = 0;
    servo->ending = 0;
    servo->load_periods = 0;
    servo->load_missed = 0;
    servo->until_look = 0;
    servo->ticks_since_beat = 0;
    servo->pause_periods = 1u + (uint64_t)(servo->world->table.ramp_s / servo->period_s);
    hd_atomic_u32_store_relaxed(&servo->stopping, 0);
    hd_atomic_u32_store_relaxed(&servo->overloaded, 0);
    return launch(servo, grant);
}

/* What the table changes is missing in all three worlds, whether or not it will be accepted. */
static void note_changes(struct hd_servo *servo, const struct hd_table *table) {
    /* A slot that was given up and comes back is another one, but a world that misses both times could not tell. */
    const int all = table->all_changed || table->object_count < servo->object_count;
    for (int i = 0; i < 3; i++) {
        struct hd_changes *changes = &servo->changes[i];
        if (all || table->changed_count > HD_CHANGE_CAPACITY - changes->count) {
            changes->all = 1;
        }
        if (!changes->all && table->changed_count > 0) {
            memcpy(&changes->slots[changes->count], table->changed, table->changed_count * sizeof *table->changed);
            changes->count += table->changed_count;
        }
    }
    servo->object_count = table->object_count;
}

int hd_servo_publish(struct hd_servo *servo, const struct hd_table *table) {
    if (fabs(table->period_s - servo->period_s) > 1e-12) {
        return hd_invalid("table: compiled for a period of %.17g s, the servo has %.17g s", table->period_s,
                          servo->period_s);
    }
    if (servo->max_force_n > 0.0 &&
        (table->max_force_n < servo->max_force_n || table->max_force_n > servo->max_force_n)) {
        return hd_invalid("table: a force limit of %g N, the servo began with %g N", table->max_force_n,
                          servo->max_force_n);
    }
    if (table->changed_count > 0 && table->changed == NULL) {
        return hd_invalid("table: %u changes without slots", table->changed_count);
    }
    const uint32_t back = hd_triple_back(&servo->triple);
    struct hd_world *world = &servo->worlds[back];
    struct hd_changes *changes = &servo->changes[back];
    int status = hd_state_reserve(servo->state, table->object_count);
    if (status == HD_OK) {
        status = lock_slots(servo, table->object_count);
    }
    if (status != HD_OK) {
        return status;
    }
    note_changes(servo, table);
    status = changes->all ? hd_world_load(world, table) : hd_world_update(world, table, changes->slots, changes->count);
    if (status != HD_OK) {
        return status;
    }
    status = lock_world(servo, back);
    if (status != HD_OK) {
        /* Its arrays would stay too large for whatever comes next. */
        hd_world_release(world);
        memset(servo->locked[back], 0, sizeof servo->locked[back]);
        return status;
    }
    changes->all = 0;
    changes->count = 0;
    servo->max_force_n = table->max_force_n;
    hd_triple_publish(&servo->triple);
    return HD_OK;
}

static int command_check(const struct hd_servo *servo, const struct hd_command *command) {
    switch (command->kind) {
    case HD_COMMAND_PLAY:
        return hd_play_check(&command->mode, command->direction, command->amplitude);
    case HD_COMMAND_OPERATOR:
        return command->path != NULL && servo->device.sim != NULL ? HD_OK
                                                                  : hd_invalid("operator: no path or no simulation");
    case HD_COMMAND_RESET:
    case HD_COMMAND_FORCES:
    case HD_COMMAND_MARK:
        return HD_OK;
    default:
        return hd_invalid("command: kind %u", command->kind);
    }
}

int hd_servo_send(struct hd_servo *servo, const struct hd_command *commands, size_t count, uint64_t *sequence) {
    for (size_t i = 0; i < count; i++) {
        const int status = command_check(servo, &commands[i]);
        if (status != HD_OK) {
            return status;
        }
    }
    const int status = hd_ring_push_many(&servo->commands, commands, count);
    if (status == HD_OK) {
        servo->sent += count;
        *sequence = servo->sent;
    }
    return status;
}

/* The servo makes no system call that could wake a waiter, so waiters look again, a fraction of a period later. */
static void pause_a_moment(const struct hd_servo *servo) {
    const int64_t moment = (int64_t)(servo->period_ns / 4.0);
    hd_clock_sleep_until(hd_clock_now_ns() + (moment > 20000 ? moment : 20000));
}

int hd_servo_wait_command(struct hd_servo *servo, uint64_t sequence, int64_t timeout_ns, uint64_t *tick) {
    const int64_t until_ns = hd_clock_now_ns() + timeout_ns;
    while (hd_atomic_u64_load_acquire(&servo->taken) < sequence) {
        if (hd_clock_now_ns() > until_ns) {
            return HD_ERR_TIMEOUT;
        }
        pause_a_moment(servo);
    }
    *tick = hd_atomic_u64_load_relaxed(&servo->taken_tick[(sequence - 1) % HD_COMMAND_CAPACITY]);
    /* The tick that took it has ended, so its consequences (faults cleared, forces on) are in the counters. */
    while (hd_atomic_u64_load_acquire(&servo->ticks) <= *tick) {
        if (hd_clock_now_ns() > until_ns) {
            return HD_ERR_TIMEOUT;
        }
        pause_a_moment(servo);
    }
    return HD_OK;
}

/* The first adoption of `revision` or a later one that is still remembered; 0 if there is none. */
static int find_adopted(const struct hd_servo *servo, uint32_t revision, uint64_t *tick) {
    const uint64_t count = hd_atomic_u64_load_acquire(&servo->adopted);
    const uint64_t oldest = count > HD_ADOPTED_CAPACITY / 2 ? count - HD_ADOPTED_CAPACITY / 2 : 0;
    for (uint64_t i = oldest; i < count; i++) {
        const size_t at = (size_t)(i % HD_ADOPTED_CAPACITY);
        if ((int32_t)(hd_atomic_u32_load_relaxed(&servo->adopted_revision[at]) - revision) >= 0) {
            *tick = hd_atomic_u64_load_relaxed(&servo->adopted_tick[at]);
            return 1;
        }
    }
    return 0;
}

int hd_servo_wait_revision(struct hd_servo *servo, uint32_t revision, int64_t timeout_ns, uint64_t *tick) {
    const int64_t until_ns = hd_clock_now_ns() + timeout_ns;
    while (!find_adopted(servo, revision, tick)) {
        if (hd_clock_now_ns() > until_ns) {
            return HD_ERR_TIMEOUT;
        }
        pause_a_moment(servo);
    }
    return HD_OK;
}

void hd_servo_beat(struct hd_servo *servo) {
    hd_atomic_u64_add_relaxed(&servo->beat, 1);
}

void hd_servo_set_lease(struct hd_servo *servo, int64_t deadline_ns) {
    hd_atomic_i64_store_relaxed(&servo->lease_ns, deadline_ns);
}

void hd_servo_counters(const struct hd_servo *servo, struct hd_counters *counters) {
    /* In this order: of a servo that has ended, these are the last ticks; and the rest is as new as the ticks are. */
    const uint32_t running = hd_atomic_u32_load_acquire(&servo->running);
    const uint64_t ticks = hd_atomic_u64_load_acquire(&servo->ticks);
    *counters = (struct hd_counters){
        .ticks = ticks,
        .skipped = hd_atomic_u64_load_relaxed(&servo->skipped),
        .overruns = hd_atomic_u64_load_relaxed(&servo->overruns),
        .samples_dropped = hd_ring_dropped(&servo->samples),
        .events_dropped = hd_ring_dropped(&servo->events),
        .strikes = hd_atomic_u64_load_relaxed(&servo->strikes),
        .glitches = hd_atomic_u64_load_relaxed(&servo->glitches),
        .saturations = hd_atomic_u64_load_relaxed(&servo->saturations),
        .revision = hd_atomic_u32_load_relaxed(&servo->revision),
        .faults = hd_atomic_u32_load_relaxed(&servo->faults),
        .forces_on = hd_atomic_u32_load_relaxed(&servo->forces_on),
        .running = running,
        .memory_refused = hd_atomic_u32_load_relaxed(&servo->memory_refused),
        .overloaded = hd_atomic_u32_load_relaxed(&servo->overloaded),
        .overloads = hd_atomic_u64_load_relaxed(&servo->overloads),
        .suspends = hd_atomic_u64_load_relaxed(&servo->suspends),
        .missed_share = number_of(hd_atomic_u64_load_relaxed(&servo->missed_share)),
        .signs = hd_atomic_u32_load_relaxed(&servo->signs),
        .energy =
            {
                .energy_j = number_of(hd_atomic_u64_load_relaxed(&servo->energy)),
                .largest_j = number_of(hd_atomic_u64_load_relaxed(&servo->largest_energy)),
                .contacts = hd_atomic_u64_load_relaxed(&servo->contacts),
                .restrained = hd_atomic_u64_load_relaxed(&servo->restrained),
                .acted = hd_atomic_u64_load_relaxed(&servo->acted),
            },
    };
}

void hd_servo_histograms(const struct hd_servo *servo, struct hd_histograms *histograms) {
    hd_histogram_read(&servo->lateness, &histograms->lateness);
    hd_histogram_read(&servo->work, &histograms->work);
}

size_t hd_servo_read_samples(struct hd_servo *servo, struct hd_sample *samples, size_t capacity, uint64_t *dropped) {
    const size_t count = hd_ring_pop_many(&servo->samples, samples, capacity);
    *dropped = hd_ring_dropped(&servo->samples);
    return count;
}

size_t hd_servo_read_events(struct hd_servo *servo, struct hd_event *events, size_t capacity, uint64_t *dropped) {
    const size_t count = hd_ring_pop_many(&servo->events, events, capacity);
    *dropped = hd_ring_dropped(&servo->events);
    return count;
}

size_t hd_servo_read_touched(struct hd_servo *servo, struct hd_touched *touched) {
    hd_triple_acquire(&servo->told);
    const struct hd_touching *touching = &servo->touching[hd_triple_front(&servo->told)];
    memcpy(touched, touching->touched, touching->count * sizeof *touched);
    return touching->count;
}
