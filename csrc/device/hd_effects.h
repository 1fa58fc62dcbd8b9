/* Device effects, which a device plays by itself: the way of a strike from the servo to the reports that start one.
 *
 *     servo --- strikes (queue) ---> writer: hd_effect_sender_next --- reports ---> device
 *     control --- effects (latest wins) --^
 *
 * A mode has become an effect with an id (struct hd_device_effect); a strike of it has its coefficient as a vector and
 * its time. The sender turns strikes into reports, one at a call: first what changed of the effect's numbers, then its
 * start. It writes nothing itself.
 *
 * A strike ends unsent where it is older than HD_EFFECT_AGE_NS, of an effect that is gone, or overtaken by a silence:
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

#define HD_EFFECT_QUEUE_CAPACITY 64u
#define HD_EFFECT_AGE_NS 50000000 /* a tap that comes later is none */

static_assert(HD_EFFECT_AGE_NS < HD_OFFLOAD_LATE_S * 1e9,
              "the tick counts an effect for as long as it may play: that age, and the last write, late");

struct hd_effect_strike {
    double force_n[2];
    int64_t time_ns;
    uint32_t effect;
    uint32_t silence; /* how many there had been */
};

/* From the servo to whichever writer there is. Its memory is part of it, so that it is locked with it. */
struct hd_effect_queue {
    struct hd_ring ring;
    struct hd_effect_strike slots[HD_EFFECT_QUEUE_CAPACITY];
    alignas(HD_CACHE_LINE) struct hd_atomic_u32 silence; /* the servo raises it, the writer reads */
    alignas(HD_CACHE_LINE) struct hd_atomic_u64 played;  /* the writer's counters */
    struct hd_atomic_u64 lost;
};

/* Control side, before anybody uses it. */
void hd_effect_queue_init(struct hd_effect_queue *queue);
/* Servo: HD_ERR_FULL (counted) or HD_OK; a force that is not finite is none. */
HD_RT int hd_effect_queue_put(struct hd_effect_queue *queue, int64_t now_ns, uint32_t effect, const double force_n[2]);
HD_RT void hd_effect_queue_silence(struct hd_effect_queue *queue);
/* Any thread: strikes that ended unsent. */
uint64_t hd_effect_queue_lost(const struct hd_effect_queue *queue);

/* One of the device's effects. */
struct hd_effect_state {
    uint8_t sent[HD_DEVICE_EFFECT_MESSAGES][HD_HID_REPORT_BYTES];
    uint32_t known;       /* bit: that message was sent */
    uint32_t aimed;       /* it has a direction */
    double direction_rad; /* that was sent last */
    int64_t until_ns;     /* it may play until then; INT64_MAX: its start is perhaps still being written */
    int64_t duration_ns;
    uint32_t stop_length;
    uint8_t stop[HD_HID_REPORT_BYTES];
};

struct hd_effect_sender {
    struct hd_triple triple; /* control publishes effects, the writer reads them */
    struct hd_device_effects effects[3];

    struct hd_effect_state states[HD_DEVICE_EFFECTS]; /* the writer's own, from here on */
    struct hd_effect_strike strike;                   /* that is under way, */
    const struct hd_device_effect *effect;            /* of this effect; NULL: none is */
    uint32_t next;                                    /* message of it */
    uint32_t silence;                                 /* how many were answered */
    uint32_t stopping;                                /* bit: place that is to be stopped */
    uint32_t started;                                 /* bit: place whose start came last */
    uint32_t unsure; /* the writer sets it: what was sent may be gone, each order is sent whole */
    int64_t since_ns;
};

/* Control side, before the writer starts: strikes from before now are none. */
void hd_effect_sender_init(struct hd_effect_sender *sender, const struct hd_effect_queue *queue);
/* Control side: HD_OK, or HD_ERR_INVALID with hd_invalid_reason. */
int hd_effect_sender_set(struct hd_effect_sender *sender, const struct hd_device_effects *effects);
/* The writer: the next report, into `bytes` [HD_HID_REPORT_BYTES]; its length, 0: there is none. It counts as written.
 * `since_ns`: the device's effects are as they were made then, and older strikes are of no connection. `open`: 0 while
 * the device is not whole, so that what plays is stopped and strikes end unsent. */
uint32_t hd_effect_sender_next(struct hd_effect_sender *sender, struct hd_effect_queue *queue, int64_t now_ns,
                               int64_t since_ns, int open, uint8_t *bytes);

#endif
