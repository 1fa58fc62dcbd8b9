/* Device effects: the queue of strikes from the servo, and the sender that turns them into reports. The servo's side
 * makes no system call and never waits; the writer's side may block. */
#include "device/hd_effects.h"

#include <math.h>
#include <string.h>

#include "device/hd_report.h"

#define HD_DURATION_MAX_NS 200000000 /* longest duration of an effect */
#define HD_STOP_MARGIN_NS 100000000  /* effects count as playing until this time after their end: writes may be slow */
/* A smaller change of direction is not sent: the error is 0.06 % of the force, whereas a report costs a frame. */
#define HD_SAME_DIRECTION_RAD 0.035
#define HD_HALF_TURN_RAD 3.14159265358979323846

/* ---- Servo ------------------------------------------------------------------------------------------------------- */

HD_RT int hd_effect_queue_put(struct hd_effect_queue *queue, int64_t now_ns, uint32_t effect, const double force_n[2]) {
    if (!((force_n[0] + force_n[1]) * 0.0 == 0.0)) {
        return HD_OK;
    }
    const struct hd_effect_strike strike = {
        .force_n = {force_n[0], force_n[1]},
        .time_ns = now_ns,
        .effect = effect,
        .silence = hd_atomic_u32_load_relaxed(&queue->silence),
    };
    const int status = hd_ring_push(&queue->ring, &strike);
    if (status != HD_OK) {
        hd_ring_drop(&queue->ring);
    }
    return status;
}

HD_RT void hd_effect_queue_silence(struct hd_effect_queue *queue) {
    hd_atomic_u32_store_release(&queue->silence, hd_atomic_u32_load_relaxed(&queue->silence) + 1u);
}

/* ---- Control side ------------------------------------------------------------------------------------------------ */

void hd_effect_queue_init(struct hd_effect_queue *queue) {
    queue->ring.slots = (unsigned char *)queue->slots;
    queue->ring.record_size = sizeof queue->slots[0];
    queue->ring.capacity = HD_EFFECT_QUEUE_CAPACITY;
}

uint64_t hd_effect_queue_lost(const struct hd_effect_queue *queue) {
    return hd_atomic_u64_load_relaxed(&queue->lost) + hd_ring_dropped(&queue->ring);
}

void hd_effect_sender_init(struct hd_effect_sender *sender, const struct hd_effect_queue *queue) {
    hd_triple_init(&sender->triple);
    sender->silence = hd_atomic_u32_load_acquire(&queue->silence);
}

static int effect_check(const struct hd_device_effect *effect, uint32_t index) {
    if (effect->id == 0 || effect->place >= HD_DEVICE_EFFECTS) {
        return hd_invalid("effect %u: id %u must not be 0, place %u must be below %d", index, effect->id, effect->place,
                          HD_DEVICE_EFFECTS);
    }
    if (effect->duration_ns <= 0 || effect->duration_ns > HD_DURATION_MAX_NS) {
        return hd_invalid("effect %u: duration of %lld ns is not between 1 and %d", index,
                          (long long)effect->duration_ns, HD_DURATION_MAX_NS);
    }
    if (!(effect->least_n >= 0.0 && effect->least_n <= effect->most_n && effect->most_n <= 1e9)) {
        return hd_invalid("effect %u: coefficients from %g to %g N do not rise within 0 and 1e+09", index,
                          effect->least_n, effect->most_n);
    }
    if (effect->message_count < 1 || effect->message_count > HD_DEVICE_EFFECT_MESSAGES) {
        return hd_invalid("effect %u: %u messages, must be 1 to %d", index, effect->message_count,
                          HD_DEVICE_EFFECT_MESSAGES);
    }
    for (uint32_t i = 0; i < effect->message_count; i++) {
        if (hd_report_check_message(&effect->messages[i], "effect", i) != HD_OK) {
            return HD_ERR_INVALID;
        }
    }
    if (effect->stop.value_count != 0) {
        return hd_invalid("effect %u: the stop message contains numbers", index);
    }
    return hd_report_check_message(&effect->stop, "effect stop", index);
}

int hd_effect_sender_set(struct hd_effect_sender *sender, const struct hd_device_effects *effects) {
    if (effects->count > HD_DEVICE_EFFECTS) {
        return hd_invalid("%u effects, at most %d", effects->count, HD_DEVICE_EFFECTS);
    }
    for (uint32_t i = 0; i < effects->count; i++) {
        if (effect_check(&effects->effects[i], i) != HD_OK) {
            return HD_ERR_INVALID;
        }
    }
    sender->effects[hd_triple_back(&sender->triple)] = *effects;
    hd_triple_publish(&sender->triple);
    return HD_OK;
}

/* ---- The writer -------------------------------------------------------------------------------------------------- */

static void end_strike(struct hd_effect_sender *sender, struct hd_effect_queue *queue) {
    if (sender->effect != NULL) {
        sender->effect = NULL;
        hd_atomic_u64_add_relaxed(&queue->lost, 1);
    }
}

/* Returns the current effect with this id; NULL if it was removed. */
static const struct hd_device_effect *effect_of(struct hd_effect_sender *sender, uint32_t id) {
    hd_triple_acquire(&sender->triple);
    const struct hd_device_effects *effects = &sender->effects[hd_triple_front(&sender->triple)];
    for (uint32_t i = 0; i < effects->count; i++) {
        if (effects->effects[i].id == id) {
            return &effects->effects[i];
        }
    }
    return NULL;
}

/* Takes the oldest strike that is large enough to send as the current one. Returns 0 if the queue has no such
 * strike. */
static int take_strike(struct hd_effect_sender *sender, struct hd_effect_queue *queue) {
    const struct hd_effect_strike *strike;
    while ((strike = hd_ring_peek(&queue->ring)) != NULL) {
        sender->strike = *strike;
        hd_ring_release(&queue->ring);
        const struct hd_device_effect *effect = effect_of(sender, sender->strike.effect);
        if (effect == NULL) {
            hd_atomic_u64_add_relaxed(&queue->lost, 1);
            continue;
        }
        double *force_n = sender->strike.force_n;
        const double size_n = hypot(force_n[0], force_n[1]);
        if (!(size_n > 0.0 && size_n >= effect->least_n)) {
            continue;
        }
        if (size_n > effect->most_n) {
            force_n[0] *= effect->most_n / size_n;
            force_n[1] *= effect->most_n / size_n;
        }
        struct hd_effect_state *state = &sender->states[effect->place];
        const double direction_rad = hd_report_direction(force_n);
        double off_rad = fabs(direction_rad - state->direction_rad);
        off_rad = off_rad > HD_HALF_TURN_RAD ? 2.0 * HD_HALF_TURN_RAD - off_rad : off_rad;
        if (!state->aimed || off_rad > HD_SAME_DIRECTION_RAD) {
            state->aimed = 1;
            state->direction_rad = direction_rad;
        }
        state->known = sender->unsure ? 0 : state->known;
        sender->effect = effect;
        sender->next = 0;
        return 1;
    }
    return 0;
}

/* Writes the next message of the current strike; the start message is its last. */
static uint32_t compose_next(struct hd_effect_sender *sender, struct hd_effect_queue *queue, uint8_t *bytes) {
    const struct hd_device_effect *effect = sender->effect;
    struct hd_effect_state *state = &sender->states[effect->place];
    for (;;) {
        const uint32_t i = sender->next++;
        const struct hd_hid_message *message = &effect->messages[i];
        hd_report_compose(message, sender->strike.force_n, state->direction_rad, bytes);
        if (i + 1 == effect->message_count) {
            state->until_ns = INT64_MAX;
            state->duration_ns = effect->duration_ns;
            sender->started = 1u << effect->place;
            state->stop_length = effect->stop.length;
            memcpy(state->stop, effect->stop.bytes, effect->stop.length);
            sender->effect = NULL;
            hd_atomic_u64_add_relaxed(&queue->played, 1);
            return message->length;
        }
        if ((state->known & 1u << i) == 0 || memcmp(bytes, state->sent[i], message->length) != 0) {
            memcpy(state->sent[i], bytes, message->length);
            state->known |= 1u << i;
            return message->length;
        }
    }
}

uint32_t hd_effect_sender_next(struct hd_effect_sender *sender, struct hd_effect_queue *queue, int64_t now_ns,
                               int64_t since_ns, int open, uint8_t *bytes) {
    const uint32_t silence = hd_atomic_u32_load_acquire(&queue->silence);
    const int reconnected = since_ns != sender->since_ns;
    const int quiet = reconnected || !open || silence != sender->silence;
    sender->since_ns = since_ns;
    sender->silence = silence;
    if (quiet) {
        end_strike(sender, queue);
    }
    for (uint32_t i = 0; i < HD_DEVICE_EFFECTS; i++) {
        struct hd_effect_state *state = &sender->states[i];
        if ((sender->started & 1u << i) != 0) {
            state->until_ns = now_ns + state->duration_ns + HD_STOP_MARGIN_NS;
        }
        if (quiet && state->until_ns > now_ns) {
            sender->stopping |= 1u << i;
        }
        if (reconnected) {
            state->known = 0;
            state->aimed = 0;
        }
    }
    sender->started = 0;
    for (uint32_t i = 0; sender->stopping != 0 && i < HD_DEVICE_EFFECTS; i++) {
        if ((sender->stopping & 1u << i) != 0) {
            sender->stopping &= ~(1u << i);
            sender->states[i].until_ns = 0;
            memcpy(bytes, sender->states[i].stop, sender->states[i].stop_length);
            return sender->states[i].stop_length;
        }
    }
    while (sender->effect != NULL || take_strike(sender, queue)) {
        const struct hd_effect_strike *strike = &sender->strike;
        if (open && strike->silence == silence && strike->time_ns >= since_ns &&
            now_ns - strike->time_ns <= HD_EFFECT_AGE_NS) {
            return compose_next(sender, queue, bytes);
        }
        end_strike(sender, queue);
    }
    return 0;
}
