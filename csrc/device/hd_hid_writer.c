/* The writer of a HID connection: takes the newest force, composes reports, writes those that changed, renews effects
 * in time. A separate thread while connected. */
#include "device/hd_hid_connection.h"

#include <errno.h>
#include <math.h>
#include <poll.h>
#include <string.h>
#include <sys/prctl.h>
#include <unistd.h>

#include "base/hd_clock.h"
#include "device/hd_last_report.h"
#include "device/hd_report.h"

#define HD_FRESH_WAIT_NS 4000000       /* longest wait for a newer force */
#define HD_RETURN_NS 20000000          /* time over which the force returns after a reset */
#define HD_POLL_NS 50000               /* polling interval while a force is due */
#define HD_POLL_MAX_NS 1000000         /* longest sleep, because the writer also renews effects and ends */
#define HD_FORCE_AGE_NS 100000000      /* an older force counts as zero */
#define HD_IDLE_NS 1000000             /* intervals with more idle time are not part of the running mean */
#define HD_MEAN_SHIFT 5                /* running means are over 2^5 = 32 values */
#define HD_EFFECTS_REPORT_NS 100000000 /* time within which a device must report that its effects play */

/* ---- One report -------------------------------------------------------------------------------------------------- */

static void running_mean(struct hd_atomic_i64 *mean, int64_t value) {
    const int64_t before = hd_atomic_i64_load_relaxed(mean);
    hd_atomic_i64_store_relaxed(mean, before == 0 ? value : before + (value - before) / (1 << HD_MEAN_SHIFT));
}

/* Waits until a non-blocking descriptor accepts more. Returns 0, ECANCELED if the connection ends meanwhile, or an
 * errno. */
static int wait_writable(struct hd_connection *connection) {
    struct pollfd polled[2] = {{.fd = connection->fd, .events = POLLOUT}, {.fd = connection->end_fd, .events = POLLIN}};
    int ready;
    if (connection->leaving) {
        const int64_t left_ns = connection->leaving_until_ns - hd_clock_now_ns();
        ready = poll(polled, 1, left_ns > 0 ? (int)(left_ns / 1000000) : 0);
    } else {
        ready = poll(polled, 2, -1);
    }
    if (ready < 0) {
        return errno == EINTR ? 0 : errno;
    }
    return ready == 0 ? ETIMEDOUT : !connection->leaving && polled[1].revents != 0 ? ECANCELED : 0;
}

/* Writes one report. Returns 0, the errno of an error that ends the connection, ECANCELED if it has ended, or -1 if
 * control abandoned the writer, which then may use only `connection` itself. */
static int write_report(struct hd_connection *connection, const uint8_t *bytes, uint32_t length) {
    struct hd_hid *hid = connection->hid;
    for (;;) {
        const int64_t start_ns = hd_clock_now_ns();
        if (hd_last_report_is_over()) {
            return ECANCELED;
        }
        if (connection->leaving ? start_ns > connection->leaving_until_ns
                                : hd_atomic_u32_load_acquire(&connection->end) != HD_END_NOT) {
            return connection->leaving ? ETIMEDOUT : ECANCELED;
        }
        hd_atomic_u32_store_release(&connection->phase, HD_PHASE_WRITING);
        const ssize_t written = write(connection->fd, bytes, length);
        const int error = written < 0 ? errno : 0;
        if (!hd_atomic_u32_replace(&connection->phase, HD_PHASE_WRITING, HD_PHASE_IDLE)) {
            return -1;
        }
        if (written == (ssize_t)length) {
            const int64_t end_ns = hd_clock_now_ns();
            const int64_t half_ns = (end_ns - start_ns) / 2;
            connection->next_write_ns = start_ns + connection->plan.write_interval_ns;
            connection->written_ns = end_ns;
            connection->fresh_until_ns = end_ns + (half_ns < HD_FRESH_WAIT_NS ? half_ns : HD_FRESH_WAIT_NS);
            hd_atomic_u64_add_relaxed(&hid->writes, 1);
            running_mean(&hid->write_ns, end_ns - start_ns);
            return 0;
        }
        if (written >= 0) {
            return EIO;
        }
        if (error != EINTR && error != EAGAIN) {
            return error;
        }
        const int refused = error == EAGAIN ? wait_writable(connection) : 0;
        if (refused != 0) {
            return refused;
        }
    }
}

/* ---- The current force ------------------------------------------------------------------------------------------- */

/* Returns the gain of the force, 0 to 1, for a device that was reset or paused: 0 until it is set up again or the pause
 * ends, then rising over HD_RETURN_NS. */
static double return_gain(struct hd_hid *hid, int64_t now_ns) {
    if (hd_atomic_u32_load_acquire(&hid->reset) || hd_atomic_u32_load_acquire(&hid->paused)) {
        return 0.0;
    }
    const double since = (double)(now_ns - hd_atomic_i64_load_relaxed(&hid->returns_ns)) / (double)HD_RETURN_NS;
    return since < 1.0 ? since > 0.0 ? since : 0.0 : 1.0;
}

/* Takes the newest force, or zero if it is too old, from an earlier connection, or not finite. */
static void take_force(struct hd_connection *connection, int64_t now_ns, double force_n[2]) {
    struct hd_hid *hid = connection->hid;
    hd_triple_acquire(&hid->force_triple);
    const struct hd_force *force = &hid->forces[hd_triple_front(&hid->force_triple)];
    const int good = force->time_ns >= connection->start_ns && now_ns - force->time_ns <= HD_FORCE_AGE_NS &&
                     isfinite(force->force_n[0]) && isfinite(force->force_n[1]);
    const double share = good ? return_gain(hid, now_ns) : 0.0;
    force_n[0] = good ? share * force->force_n[0] : 0.0;
    force_n[1] = good ? share * force->force_n[1] : 0.0;
    if (force_n[0] != 0.0 || force_n[1] != 0.0) {
        connection->direction_rad = hd_report_direction(force_n);
    }
}

/* Returns whether the newest force is older than the end of the last write. */
static int is_stale(const struct hd_connection *connection) {
    const struct hd_hid *hid = connection->hid;
    return hid->forces[hd_triple_front(&hid->force_triple)].time_ns <= connection->written_ns;
}

/* Returns when to poll for a newer force: 50 us before the next one may be there, then every 50 us. */
static int64_t next_poll_ns(const struct hd_connection *connection) {
    const struct hd_hid *hid = connection->hid;
    const int64_t now_ns = hd_clock_now_ns();
    const int64_t due_ns = hid->forces[hd_triple_front(&hid->force_triple)].time_ns +
                           hd_atomic_i64_load_relaxed(&hid->tick_ns) - HD_POLL_NS;
    const int64_t soonest_ns = now_ns + HD_POLL_NS;
    const int64_t latest_ns = now_ns + HD_POLL_MAX_NS;
    return due_ns < soonest_ns ? soonest_ns : due_ns > latest_ns ? latest_ns : due_ns;
}

/* Composes a message with the current force. A write that blocked ends with a frame of the link, and the next frame
 * brings a position; the force in the mailbox is then a frame old. So the writer waits for a newer force, for up to
 * half the duration of the write (docs/adr/0014). */
static void compose_now(struct hd_connection *connection, const struct hd_hid_message *message, uint8_t *bytes) {
    double force_n[2] = {0.0, 0.0};
    if (hd_clock_now_ns() < connection->next_write_ns) {
        hd_clock_sleep_until(connection->next_write_ns);
    }
    if (connection->begun && !connection->leaving) {
        take_force(connection, hd_clock_now_ns(), force_n);
        while (is_stale(connection) && hd_clock_now_ns() < connection->fresh_until_ns) {
            const int64_t poll_ns = next_poll_ns(connection);
            hd_clock_sleep_until(poll_ns < connection->fresh_until_ns ? poll_ns : connection->fresh_until_ns);
            take_force(connection, hd_clock_now_ns(), force_n);
        }
    }
    hd_report_compose(message, force_n, connection->direction_rad, bytes);
}

/* ---- Scripts ----------------------------------------------------------------------------------------------------- */

/* Sends the force messages once, each with the force that is newest at its turn. `all`: also those that did not change.
 * *changed: number of messages that changed. */
static int write_forces(struct hd_connection *connection, int all, uint32_t *changed) {
    const struct hd_hid_script *script = &connection->plan.force;
    *changed = 0;
    for (uint32_t i = 0; i < script->count; i++) {
        const struct hd_hid_message *message = &script->messages[i];
        uint8_t bytes[HD_HID_REPORT_BYTES];
        compose_now(connection, message, bytes);
        const int same =
            (connection->sent_once & 1u << i) != 0 && memcmp(bytes, connection->sent[i], message->length) == 0;
        if (same && !all) {
            continue;
        }
        const int error = write_report(connection, bytes, message->length);
        if (error != 0) {
            return error;
        }
        memcpy(connection->sent[i], bytes, message->length);
        connection->sent_once |= 1u << i;
        *changed += !same;
    }
    return 0;
}

static int write_message(struct hd_connection *connection, const struct hd_hid_message *message) {
    uint8_t bytes[HD_HID_REPORT_BYTES];
    compose_now(connection, message, bytes);
    return write_report(connection, bytes, message->length);
}

static int write_script(struct hd_connection *connection, const struct hd_hid_script *script) {
    for (uint32_t i = 0; i < script->count; i++) {
        const int error = write_message(connection, &script->messages[i]);
        if (error != 0) {
            return error;
        }
    }
    return 0;
}

/* Returns whether a reset, or another program's effect in place of ours, would go unnoticed. */
static int is_unreported(const struct hd_connection *connection, int64_t now_ns) {
    const int watched = connection->plan.effects.count > 0;
    return !hd_atomic_u32_load_relaxed(&connection->told) &&
           (!watched || now_ns - connection->start_ns > HD_EFFECTS_REPORT_NS);
}

/* Sends at most one message of the restore script, so that forces are sent in between. */
static int write_restore(struct hd_connection *connection) {
    const struct hd_hid_plan *plan = &connection->plan;
    const int64_t now_ns = hd_clock_now_ns();
    if (plan->restore.count == 0 || now_ns < connection->restore_ns || !is_unreported(connection, now_ns)) {
        return 0;
    }
    const int64_t next_ns = connection->restore_ns + plan->restore_ns;
    connection->restore_ns = next_ns > now_ns ? next_ns : now_ns;
    const uint32_t which = connection->restored % plan->restore.count;
    connection->restored = which + 1;
    return write_message(connection, &plan->restore.messages[which]);
}

/* Sends the messages of at most one strike of a device effect, so that the next force is sent in between. */
static int write_effects(struct hd_connection *connection) {
    struct hd_hid *hid = connection->hid;
    for (uint32_t i = 0; i < HD_DEVICE_EFFECT_MESSAGES; i++) {
        uint8_t bytes[HD_HID_REPORT_BYTES];
        if (hd_clock_now_ns() < connection->next_write_ns) {
            hd_clock_sleep_until(connection->next_write_ns);
        }
        const int64_t now_ns = hd_clock_now_ns();
        const int64_t returns_ns = hd_atomic_i64_load_relaxed(&hid->returns_ns);
        const int64_t since_ns = returns_ns > connection->start_ns ? returns_ns : connection->start_ns;
        connection->effect_sender.unsure = connection->plan.restore.count > 0 && is_unreported(connection, now_ns);
        const uint32_t length = hd_effect_sender_next(&connection->effect_sender, &hid->effect_queue, now_ns, since_ns,
                                                      return_gain(hid, now_ns) == 1.0, bytes);
        const int error = length > 0 ? write_report(connection, bytes, length) : 0;
        if (length == 0 || error != 0) {
            return error;
        }
    }
    return 0;
}

/* ---- Renewals ---------------------------------------------------------------------------------------------------- */

int hd_hid_forgotten(struct hd_renewals *renewals, const struct hd_hid_effects *effects, uint32_t playing,
                     uint32_t ended, int excused) {
    int found = 0;
    for (uint32_t i = 0; i < effects->count; i++) {
        uint32_t *played = &renewals->played[i];
        uint32_t *waited = &renewals->waited[i];
        *played = (playing >> i & 1u) == 0 ? 0 : *played < effects->proof ? *played + 1 : *played;
        renewals->proven |= *played >= effects->proof;
        if ((ended >> i & 1u) == 0) {
            *waited = 0;
        } else if (*waited <= HD_FORGET_RENEWALS) {
            *waited = excused ? 0 : *waited + 1;
            found |= *waited > HD_FORGET_RENEWALS;
        }
    }
    found = found && (renewals->proven || !renewals->guessed);
    renewals->guessed |= found;
    return found;
}

/* Returns whether the device has lost an effect; called before each renewal. */
static int has_lost_effect(struct hd_connection *connection) {
    const struct hd_hid *hid = connection->hid;
    const uint32_t safety = 1u << (HD_HID_SAFETY - 1);
    /* On a device without a safety switch the bit of the switch was never set. */
    const uint32_t off = hd_atomic_u32_load_relaxed(&hid->states_seen) & ~hd_atomic_u32_load_relaxed(&hid->states);
    const int excused =
        hd_atomic_u32_load_acquire(&hid->reset) || hd_atomic_u32_load_acquire(&hid->paused) || (off & safety) != 0;
    return hd_hid_forgotten(&connection->renewals, &connection->plan.effects,
                            hd_atomic_u32_load_relaxed(&connection->playing),
                            hd_atomic_u32_load_relaxed(&connection->ended), excused);
}

/* ---- The thread -------------------------------------------------------------------------------------------------- */

static void count_pass(struct hd_connection *connection) {
    struct hd_hid *hid = connection->hid;
    const int64_t now_ns = hd_clock_now_ns();
    hd_atomic_u64_add_relaxed(&hid->sent_forces, 1);
    if (connection->last_pass_ns != 0 && connection->idle_ns < HD_IDLE_NS) {
        running_mean(&hid->write_interval_ns, now_ns - connection->last_pass_ns);
    }
    connection->last_pass_ns = now_ns;
    connection->idle_ns = 0;
}

/* Writes until the connection ends. Returns as write_report. */
static int write_until_end(struct hd_connection *connection) {
    const struct hd_hid_plan *plan = &connection->plan;
    int64_t renew_ns =
        connection->start_ns; /* time of the next renewal: immediately, because the set-up was some time ago */
    int error = write_script(connection, &plan->begin);
    if (error != 0) {
        return error;
    }
    for (;;) {
        const int renews = plan->renew_ns > 0 && hd_clock_now_ns() >= renew_ns;
        uint32_t changed = 0;
        if (renews && has_lost_effect(connection)) {
            hd_hid_suspect(connection->hid);
        }
        error = write_forces(connection, renews, &changed);
        connection->begun = 1;
        if (error == 0 && renews) {
            renew_ns = hd_clock_now_ns() + plan->renew_ns;
            error = write_script(connection, &plan->renew);
        }
        error = error == 0 ? write_restore(connection) : error;
        error = error == 0 ? write_effects(connection) : error;
        if (error == 0 && hd_atomic_u32_load_acquire(&connection->end) != HD_END_NOT) {
            error = ECANCELED;
        }
        if (error != 0) {
            return error;
        }
        if (changed > 0) {
            count_pass(connection);
        } else {
            const int64_t begin_ns = hd_clock_now_ns();
            hd_clock_sleep_until(next_poll_ns(connection));
            connection->idle_ns += hd_clock_now_ns() - begin_ns;
        }
    }
}

/* Shortens the pauses between the last writes to at most half of their time limit, whatever interval the plan asks
 * for. */
static void shorten_pauses(struct hd_connection *connection) {
    struct hd_hid_plan *plan = &connection->plan;
    const int64_t pause_ns = connection->parting_ns / 2 / (1 + plan->force.count + plan->stop.count);
    const int64_t latest_ns = hd_clock_now_ns() + pause_ns;
    plan->write_interval_ns = plan->write_interval_ns < pause_ns ? plan->write_interval_ns : pause_ns;
    connection->next_write_ns = connection->next_write_ns < latest_ns ? connection->next_write_ns : latest_ns;
}

/* Sends a force of zero after an abandoned write() has returned, because that write may have been a force. */
static void write_zero(const struct hd_connection *connection) {
    const struct hd_hid_script *script = &connection->plan.force;
    const double none[2] = {0.0, 0.0};
    int taken = 1;
    for (uint32_t i = 0; i < script->count && taken; i++) {
        const uint32_t length = script->messages[i].length;
        uint8_t bytes[HD_HID_REPORT_BYTES];
        hd_report_compose(&script->messages[i], none, connection->direction_rad, bytes);
        taken = write(connection->fd, bytes, length) == (ssize_t)length;
    }
}

void *hd_hid_writer_main(void *argument) {
    struct hd_connection *connection = argument;
    prctl(PR_SET_NAME, "hid writer", 0ul, 0ul, 0ul);
    /* Without real-time priority the kernel may round sleeps by 50 us. */
    prctl(PR_SET_TIMERSLACK, 1ul, 0ul, 0ul, 0ul);
    int error = write_until_end(connection);
    if (error > 0 && error != ECANCELED) {
        hd_connection_fail(connection, error);
    }
    const uint32_t end = hd_atomic_u32_load_acquire(&connection->end);
    if (error > 0 && end != HD_END_NOW) {
        uint32_t changed;
        connection->leaving = 1;
        connection->leaving_until_ns =
            end == HD_END_ORDERLY ? connection->parting_until_ns : hd_clock_now_ns() + connection->parting_ns;
        shorten_pauses(connection);
        error = write_forces(connection, 1, &changed);
        if (error >= 0) { /* also if the force of zero was refused */
            const int stopped = write_script(connection, &connection->plan.stop);
            error = error == 0 || stopped < 0 ? stopped : error;
        }
        if (error >= 0) {
            connection->parting_error = error;
        }
    }
    if (error < 0) {
        write_zero(connection);
        hd_connection_free(connection);
    } else {
        hd_hid_signal(connection->left_fd);
    }
    return NULL;
}
