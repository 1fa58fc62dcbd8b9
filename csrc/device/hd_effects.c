/* See hd_effects.h. The servo's side makes no system call and waits for nothing; the writer's side may take its time.
 */
#include "device/hd_effects.h"

#include <math.h>
#include <string.h>

#include "base/hd_bits.h"

#define HD_DURATION_MAX_NS 200000000
#define HD_STOPPED_FOR_NS 100000000 /* after its end an effect still counts as playing: writes may have been slow */
/* A direction that differs by less is the same one: that costs 0.06 % of the force, a report costs a frame. */
#define HD_SAME_DIRECTION_RAD 0.035
#define HD_HALF_TURN_RAD 3.14159265358979323846

/* ---- Servo ------------------------------------------------------------------------------------------------------- */

HD_RT int hd_orders_put(struct hd_orders *orders, int64_t now_ns, uint32_t effect, const double force_n[2]) {
    if (!((force_n[0] + force_n[1]) * 0.0 == 0.0)) {
        return HD_OK;
    }
    const struct hd_order order = {
        .force_n = {force_n[0], force_n[1]},
        .time_ns = now_ns,
        .effect = effect,
        .silence = hd_atomic_u32_load_relaxed(&orders->silence),
    };
    const int status = hd_ring_push(&orders->ring, &order);
    if (status != HD_OK) {
        hd_ring_drop(&orders->ring);
    }
    return status;
}

HD_RT void hd_orders_silence(struct hd_orders *orders) {
    hd_atomic_u32_store_release(&orders->silence, hd_atomic_u32_load_relaxed(&orders->silence) + 1u);
}

/* ---- Control side ------------------------------------------------------------------------------------------------ */

void hd_orders_init(struct hd_orders *orders) {
    orders->ring.slots = (unsigned char *)orders->slots;
    orders->ring.record_size = sizeof orders->slots[0];
    orders->ring.capacity = HD_ORDER_CAPACITY;
}

uint64_t hd_orders_lost(const struct hd_orders *orders) {
    return hd_atomic_u64_load_relaxed(&orders->lost) + hd_ring_dropped(&orders->ring);
}

void hd_player_init(struct hd_player *player, const struct hd_orders *orders) {
    hd_triple_init(&player->triple);
    player->silence = hd_atomic_u32_load_acquire(&orders->silence);
}

static int effect_check(const struct hd_hid_offer *effect, uint32_t index) {
    if (effect->id == 0 || effect->place >= HD_HID_OFFERS) {
        return hd_invalid("effect %u: id %u at place %u", index, effect->id, effect->place);
    }
    if (effect->duration_ns <= 0 || effect->duration_ns > HD_DURATION_MAX_NS) {
        return hd_invalid("effect %u: plays for %lld ns", index, (long long)effect->duration_ns);
    }
    if (!(effect->least_n >= 0.0 && effect->least_n <= effect->most_n && effect->most_n <= 1e9)) {
        return hd_invalid("effect %u: coefficients from %g to %g N", index, effect->least_n, effect->most_n);
    }
    if (effect->message_count < 1 || effect->message_count > HD_HID_OFFER_MESSAGES) {
        return hd_invalid("effect %u: %u messages", index, effect->message_count);
    }
    for (uint32_t i = 0; i < effect->message_count; i++) {
        if (hd_report_check_message(&effect->messages[i], "effect", i) != HD_OK) {
            return HD_ERR_INVALID;
        }
    }
    if (effect->stop.value_count != 0) {
        return hd_invalid("effect %u: its stop carries numbers", index);
    }
    return hd_report_check_message(&effect->stop, "effect stop", index);
}

int hd_player_offer(struct hd_player *player, const struct hd_hid_offers *effects) {
    if (effects->count > HD_HID_OFFERS) {
        return hd_invalid("%u effects, at most %d", effects->count, HD_HID_OFFERS);
    }
    for (uint32_t i = 0; i < effects->count; i++) {
        if (effect_check(&effects->effects[i], i) != HD_OK) {
            return HD_ERR_INVALID;
        }
    }
    player->effects[hd_triple_back(&player->triple)] = *effects;
    hd_triple_publish(&player->triple);
    return HD_OK;
}

/* ---- The writer -------------------------------------------------------------------------------------------------- */

static void end_order(struct hd_player *player, struct hd_orders *orders) {
    if (player->effect != NULL) {
        player->effect = NULL;
        hd_atomic_u64_add_relaxed(&orders->lost, 1);
    }
}

/* The effect of an id, among those of now; NULL: it is gone. */
static const struct hd_hid_offer *effect_of(struct hd_player *player, uint32_t id) {
    hd_triple_acquire(&player->triple);
    const struct hd_hid_offers *effects = &player->effects[hd_triple_front(&player->triple)];
    for (uint32_t i = 0; i < effects->count; i++) {
        if (effects->effects[i].id == id) {
            return &effects->effects[i];
        }
    }
    return NULL;
}

/* The oldest order that the device would feel becomes the one under way. 0: there is none. */
static int take_order(struct hd_player *player, struct hd_orders *orders) {
    const struct hd_order *order;
    while ((order = hd_ring_peek(&orders->ring)) != NULL) {
        player->order = *order;
        hd_ring_release(&orders->ring);
        const struct hd_hid_offer *effect = effect_of(player, player->order.effect);
        if (effect == NULL) {
            hd_atomic_u64_add_relaxed(&orders->lost, 1);
            continue;
        }
        double *force_n = player->order.force_n;
        const double size_n = hypot(force_n[0], force_n[1]);
        if (!(size_n > 0.0 && size_n >= effect->least_n)) {
            continue;
        }
        if (size_n > effect->most_n) {
            force_n[0] *= effect->most_n / size_n;
            force_n[1] *= effect->most_n / size_n;
        }
        struct hd_played *played = &player->played[effect->place];
        const double direction_rad = hd_report_direction(force_n);
        double off_rad = fabs(direction_rad - played->direction_rad);
        off_rad = off_rad > HD_HALF_TURN_RAD ? 2.0 * HD_HALF_TURN_RAD - off_rad : off_rad;
        if (!played->aimed || off_rad > HD_SAME_DIRECTION_RAD) {
            played->aimed = 1;
            played->direction_rad = direction_rad;
        }
        played->known = player->unsure ? 0 : played->known;
        player->effect = effect;
        player->next = 0;
        return 1;
    }
    return 0;
}

/* The next message of the order under way, which its start ends. */
static uint32_t compose(struct hd_player *player, struct hd_orders *orders, uint8_t *bytes) {
    const struct hd_hid_offer *effect = player->effect;
    struct hd_played *played = &player->played[effect->place];
    for (;;) {
        const uint32_t i = player->next++;
        const struct hd_hid_message *message = &effect->messages[i];
        hd_report_compose(message, player->order.force_n, played->direction_rad, bytes);
        if (i + 1 == effect->message_count) {
            played->until_ns = INT64_MAX;
            played->duration_ns = effect->duration_ns;
            player->started = 1u << effect->place;
            played->stop_length = effect->stop.length;
            memcpy(played->stop, effect->stop.bytes, effect->stop.length);
            player->effect = NULL;
            hd_atomic_u64_add_relaxed(&orders->played, 1);
            return message->length;
        }
        if ((played->known & 1u << i) == 0 || memcmp(bytes, played->sent[i], message->length) != 0) {
            memcpy(played->sent[i], bytes, message->length);
            played->known |= 1u << i;
            return message->length;
        }
    }
}

uint32_t hd_player_next(struct hd_player *player, struct hd_orders *orders, int64_t now_ns, int64_t since_ns, int open,
                        uint8_t *bytes) {
    const uint32_t silence = hd_atomic_u32_load_acquire(&orders->silence);
    const int anew = since_ns != player->since_ns;
    const int quiet = anew || !open || silence != player->silence;
    player->since_ns = since_ns;
    player->silence = silence;
    if (quiet) {
        end_order(player, orders);
    }
    for (uint32_t i = 0; i < HD_HID_OFFERS; i++) {
        struct hd_played *played = &player->played[i];
        if ((player->started & 1u << i) != 0) {
            played->until_ns = now_ns + played->duration_ns + HD_STOPPED_FOR_NS;
        }
        if (quiet && played->until_ns > now_ns) {
            player->stopping |= 1u << i;
        }
        if (anew) {
            played->known = 0;
            played->aimed = 0;
        }
    }
    player->started = 0;
    for (uint32_t i = 0; player->stopping != 0 && i < HD_HID_OFFERS; i++) {
        if ((player->stopping & 1u << i) != 0) {
            player->stopping &= ~(1u << i);
            player->played[i].until_ns = 0;
            memcpy(bytes, player->played[i].stop, player->played[i].stop_length);
            return player->played[i].stop_length;
        }
    }
    while (player->effect != NULL || take_order(player, orders)) {
        const struct hd_order *order = &player->order;
        if (open && order->silence == silence && order->time_ns >= since_ns &&
            now_ns - order->time_ns <= HD_ORDER_AGE_NS) {
            return compose(player, orders, bytes);
        }
        end_order(player, orders);
    }
    return 0;
}
