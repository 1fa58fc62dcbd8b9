/* What a device plays by itself: the way of a strike from the servo to the reports that start an effect.
 *
 *     servo --- orders (ring) ---> writer: hd_player_next --- reports ---> device
 *     control --- effects (latest wins) --^
 *
 * A mode has become an effect with an id (struct hd_hid_offer); an order is one strike of it, with its coefficient as
 * a vector and its time. A player turns orders into reports, one at a call: first what changed of the effect's numbers,
 * then its start. It writes nothing itself.
 *
 * An order ends unsent where it is older than HD_ORDER_AGE_NS, of an effect that is gone, or overtaken by a silence:
 * the servo calls for one as soon as the forces are no longer fully on. What may be playing then is stopped first of
 * all, and so it is where the device is not whole: a pause would hold it, and play the rest of it afterwards. What
 * plays ends by itself in any case: effects are finite, and nothing renews them. */
#ifndef HD_EFFECTS_H
#define HD_EFFECTS_H

#include "api/hd_core.h"
#include "base/hd_ring.h"
#include "base/hd_rt.h"
#include "base/hd_triple.h"
#include "tick/hd_tick.h"

#define HD_ORDER_CAPACITY 64u
#define HD_ORDER_AGE_NS 50000000 /* a tap that comes later is none */

static_assert(HD_ORDER_AGE_NS < HD_OFFLOAD_LATE_S * 1e9,
              "the tick counts an effect for as long as it may play: that age, and the last write, late");

struct hd_order {
    double force_n[2];
    int64_t time_ns;
    uint32_t effect;
    uint32_t silence; /* how many there had been */
};

/* From the servo to whichever writer there is. Its memory is part of it, so that it is locked with it. */
struct hd_orders {
    struct hd_ring ring;
    struct hd_order slots[HD_ORDER_CAPACITY];
    alignas(HD_CACHE_LINE) struct hd_atomic_u32 silence; /* the servo raises it, the writer reads */
    alignas(HD_CACHE_LINE) struct hd_atomic_u64 played;  /* the writer's counters */
    struct hd_atomic_u64 lost;
};

/* Control side, before anybody uses it. */
void hd_orders_init(struct hd_orders *orders);
/* Servo: HD_ERR_FULL (counted) or HD_OK; a force that is not finite is none. */
HD_RT int hd_orders_put(struct hd_orders *orders, int64_t now_ns, uint32_t effect, const double force_n[2]);
HD_RT void hd_orders_silence(struct hd_orders *orders);
/* Any thread: orders that ended unsent. */
uint64_t hd_orders_lost(const struct hd_orders *orders);

/* One of the device's effects. */
struct hd_played {
    uint8_t sent[HD_HID_OFFER_MESSAGES][HD_HID_REPORT_BYTES];
    uint32_t known;       /* bit: that message was sent */
    uint32_t aimed;       /* it has a direction */
    double direction_rad; /* that was sent last */
    int64_t until_ns;     /* it may play until then; INT64_MAX: its start is perhaps still being written */
    int64_t duration_ns;
    uint32_t stop_length;
    uint8_t stop[HD_HID_REPORT_BYTES];
};

struct hd_player {
    struct hd_triple triple; /* control publishes effects, the writer reads them */
    struct hd_hid_offers effects[3];

    struct hd_played played[HD_HID_OFFERS]; /* the writer's own, from here on */
    struct hd_order order;                  /* that is under way, */
    const struct hd_hid_offer *effect;      /* of this effect; NULL: none is */
    uint32_t next;                          /* message of it */
    uint32_t silence;                       /* how many were answered */
    uint32_t stopping;                      /* bit: place that is to be stopped */
    uint32_t started;                       /* bit: place whose start came last */
    uint32_t unsure; /* the writer sets it: what was sent may be gone, each order is sent whole */
    int64_t since_ns;
};

/* Control side, before the writer starts: orders from before now are none. */
void hd_player_init(struct hd_player *player, const struct hd_orders *orders);
/* Control side: HD_OK, or HD_ERR_INVALID with hd_invalid_reason. */
int hd_player_offer(struct hd_player *player, const struct hd_hid_offers *effects);
/* The writer: the next report, into `bytes` [HD_HID_REPORT_BYTES]; its length, 0: there is none. It counts as written.
 * `since_ns`: the device's effects are as they were made then, and older orders are of no connection. `open`: 0 while
 * the device is not whole, so that what plays is stopped and orders end unsent. */
uint32_t hd_player_next(struct hd_player *player, struct hd_orders *orders, int64_t now_ns, int64_t since_ns, int open,
                        uint8_t *bytes);

#endif
