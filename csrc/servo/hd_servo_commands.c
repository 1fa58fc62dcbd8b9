/* Commands: control checks and sends them, the servo applies them at the beginning of a tick, and control can wait for
 * the tick that took one. A command is taken once its revision of the table or a later one is in force. */
#include "servo/hd_servo.h"

#include <stdlib.h>
#include <string.h>

#include "base/hd_clock.h"
#include "device/hd_device.h"
#include "tick/hd_tick.h"

#define HD_COMMANDS_PER_TICK 64u /* largest number of commands in a tick, which bounds its duration */

/* ---- The servo thread -------------------------------------------------------------------------------------------- */

/* Applies a command. HD_ERR_FULL: try again in the next tick. */
HD_RT static int apply_command(struct hd_servo *servo, const struct hd_command *command, int64_t time_ns) {
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

/* See hd_servo.h. */
HD_RT void hd_servo_take_commands(struct hd_servo *servo, int64_t time_ns) {
    for (uint32_t i = 0; i < HD_COMMANDS_PER_TICK; i++) {
        const struct hd_command *command = hd_ring_peek(&servo->commands);
        if (command == NULL || (int32_t)(command->revision - servo->world->table.revision) > 0) {
            return;
        }
        if (apply_command(servo, command, time_ns) == HD_ERR_FULL) {
            return;
        }
        hd_ring_release(&servo->commands);
        const uint64_t taken = hd_atomic_u64_load_relaxed(&servo->taken);
        hd_atomic_u64_store_relaxed(&servo->taken_tick[taken % HD_COMMAND_CAPACITY], servo->state->tick);
        hd_atomic_u64_store_release(&servo->taken, taken + 1);
    }
}

/* ---- Control side ------------------------------------------------------------------------------------------------ */

static int command_check(const struct hd_servo *servo, const struct hd_command *command) {
    switch (command->kind) {
    case HD_COMMAND_PLAY:
        return hd_play_check(&command->mode, command->direction, command->amplitude);
    case HD_COMMAND_OPERATOR:
        return command->path != NULL && servo->device.sim != NULL
                   ? HD_OK
                   : hd_invalid("operator: no path, or not a simulated joystick");
    case HD_COMMAND_RESET:
    case HD_COMMAND_FORCES:
    case HD_COMMAND_MARK:
        return HD_OK;
    default:
        return hd_invalid("command: unknown kind %u", command->kind);
    }
}

void hd_servo_free_paths(struct hd_servo *servo, uint32_t count) {
    for (uint32_t i = 0; i < count; i++) {
        hd_operator_free(servo->paths[i].path);
    }
    servo->path_count -= count;
    memmove(servo->paths, servo->paths + count, servo->path_count * sizeof servo->paths[0]);
}

/* Holds the paths of `count` commands that were just put into the ring, and frees taken paths except the newest, which
 * the servo uses. */
static void hold_paths(struct hd_servo *servo, const struct hd_command *commands, size_t count) {
    const uint64_t taken = hd_atomic_u64_load_acquire(&servo->taken);
    uint32_t old = 0;
    while (old + 1 < servo->path_count && servo->paths[old + 1].sequence <= taken) {
        old++;
    }
    hd_servo_free_paths(servo, old);
    for (size_t i = 0; i < count; i++) {
        if (commands[i].kind == HD_COMMAND_OPERATOR) {
            hd_operator_hold(commands[i].path);
            servo->paths[servo->path_count++] = (struct hd_held_path){servo->sent + i + 1, commands[i].path};
        }
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
        hold_paths(servo, commands, count);
        servo->sent += count;
        *sequence = servo->sent;
    }
    return status;
}

int hd_servo_retune(struct hd_servo *servo, uint64_t sequence, const struct hd_mode *mode) {
    if (servo->started) {
        return hd_invalid("servo: the mode of a play cannot change while the thread runs");
    }
    if (sequence > servo->sent) {
        return hd_invalid("servo: no command has the number %llu yet", (unsigned long long)sequence);
    }
    if (hd_atomic_u64_load_acquire(&servo->taken) >= sequence) {
        return HD_OK;
    }
    /* No thread takes commands now. The ring counts from 0, sequence numbers from 1. */
    struct hd_command *command = hd_ring_slot(&servo->commands, sequence - 1);
    if (command->kind != HD_COMMAND_PLAY) {
        return hd_invalid("servo: command %llu is not a play", (unsigned long long)sequence);
    }
    const int status = hd_play_check(mode, command->direction, command->amplitude);
    if (status == HD_OK) {
        command->mode = *mode;
    }
    return status;
}

/* The servo makes no system call that could wake a waiter, so waiters poll at a fraction of a period. */
void hd_servo_pause(const struct hd_servo *servo) {
    const int64_t moment = (int64_t)(servo->period_ns / 4.0);
    hd_clock_sleep_until(hd_clock_now_ns() + (moment > 20000 ? moment : 20000));
}

int hd_servo_wait_command(struct hd_servo *servo, uint64_t sequence, int64_t timeout_ns, uint64_t *tick) {
    const int64_t until_ns = hd_clock_now_ns() + timeout_ns;
    while (hd_atomic_u64_load_acquire(&servo->taken) < sequence) {
        if (hd_clock_now_ns() > until_ns) {
            return HD_ERR_TIMEOUT;
        }
        hd_servo_pause(servo);
    }
    *tick = hd_atomic_u64_load_relaxed(&servo->taken_tick[(sequence - 1) % HD_COMMAND_CAPACITY]);
    /* The tick that took it has ended, so its consequences (faults cleared, forces on) are in the counters. */
    while (hd_atomic_u64_load_acquire(&servo->ticks) <= *tick) {
        if (hd_clock_now_ns() > until_ns) {
            return HD_ERR_TIMEOUT;
        }
        hd_servo_pause(servo);
    }
    return HD_OK;
}
