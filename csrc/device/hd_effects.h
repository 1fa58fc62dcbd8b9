/* Device effects: the path of a strike from the servo to the reports that start an effect on the device.
 *
 *     servo --- strikes (queue) ---> writer: hd_effect_sender_next --- reports ---> device
 *     control --- effects (newest) ---^
 *
 * A mode corresponds to an effect with an id (struct hd_device_effect); a strike consists of that id, its coefficient
 * as a vector and its time. The sender turns strikes into reports, one per call: first the numbers of the effect that
 * changed, then its start. It does not write to the device itself.
 *
 * A strike is dropped if it is older than HD_EFFECT_AGE_NS, if its effect was removed, or if a silence followed it. The
 * servo requests a silence as soon as the forces are no longer fully on. Effects that may be playing are then stopped
 * before anything else is sent; the same happens while the device is reset or paused, because a pause would only
 * suspend an effect and play its rest afterwards. Effects are finite and not renewed, so they end in any case. */
#ifndef HD_EFFECTS_H
#define HD_EFFECTS_H

#include "api/hd_core.h"
#include "base/hd_ring.h"
#include "base/hd_rt.h"
#include "base/hd_triple.h"
#include "tick/hd_tick.h"

#define HD_EFFECT_QUEUE_CAPACITY 64u /* strikes */
#define HD_EFFECT_AGE_NS 50000000    /* strikes older than this are dropped */

static_assert(HD_EFFECT_AGE_NS < HD_OFFLOAD_LATE_S * 1e9,
              "the tick must count an effect for as long as it may play, including a late start");

struct hd_effect_strike {
    double force_n[2];
    int64_t time_ns;
    uint32_t effect;
    uint32_t silence; /* number of silences before this strike */
};

/* The queue from the servo to the current writer. The slots are a member, so that they are locked together with it. */
struct hd_effect_queue {
    struct hd_ring ring;
    struct hd_effect_strike slots[HD_EFFECT_QUEUE_CAPACITY];
    alignas(HD_CACHE_LINE) struct hd_atomic_u32 silence; /* number of silences, incremented by the servo */
    alignas(HD_CACHE_LINE) struct hd_atomic_u64 played;  /* the writer's counters */
    struct hd_atomic_u64 lost;
};

/* Control side, before any other thread uses the queue. */
void hd_effect_queue_init(struct hd_effect_queue *queue);
/* Servo: adds a strike. HD_ERR_FULL (counted) or HD_OK; a force that is not finite is ignored. */
HD_RT int hd_effect_queue_put(struct hd_effect_queue *queue, int64_t now_ns, uint32_t effect, const double force_n[2]);
HD_RT void hd_effect_queue_silence(struct hd_effect_queue *queue);
/* Any thread: returns the number of dropped strikes. */
uint64_t hd_effect_queue_lost(const struct hd_effect_queue *queue);

/* The writer's state of one of the device's effects. */
struct hd_effect_state {
    uint8_t sent[HD_DEVICE_EFFECT_MESSAGES][HD_HID_REPORT_BYTES];
    uint32_t known;       /* bit i: message i was sent and is valid */
    uint32_t aimed;       /* 1: direction_rad is set */
    double direction_rad; /* direction sent last */
    int64_t until_ns;     /* time until which it may play; INT64_MAX: its start may still be in a write */
    int64_t duration_ns;
    uint32_t stop_length;
    uint8_t stop[HD_HID_REPORT_BYTES];
};

struct hd_effect_sender {
    struct hd_triple triple; /* control publishes effects, the writer reads them */
    struct hd_device_effects effects[3];

    struct hd_effect_state states[HD_DEVICE_EFFECTS]; /* the writer's own, from here on */
    struct hd_effect_strike strike;                   /* the current strike */
    const struct hd_device_effect *effect;            /* effect of the current strike; NULL: no current strike */
    uint32_t next;                                    /* index of its next message */
    uint32_t silence;                                 /* number of silences handled */
    uint32_t stopping;                                /* bit i: place i is to be stopped */
    uint32_t started;                                 /* bit i: the start of place i was returned last */
    uint32_t unsure; /* the writer sets it: the device may have lost what was sent, so all messages are sent */
    int64_t since_ns;
};

/* Control side, before the writer starts: earlier strikes are dropped. */
void hd_effect_sender_init(struct hd_effect_sender *sender, const struct hd_effect_queue *queue);
/* Control side: sets the effects. HD_OK, or HD_ERR_INVALID with hd_invalid_reason. */
int hd_effect_sender_set(struct hd_effect_sender *sender, const struct hd_device_effects *effects);
/* Writer: puts the next report into `bytes` [HD_HID_REPORT_BYTES] and returns its length, 0 if there is no report. The
 * report counts as written. `since_ns`: time of the last set-up of the device's effects; older strikes are dropped.
 * `open`: 0 while the device is reset or paused; effects are then stopped and strikes dropped. */
uint32_t hd_effect_sender_next(struct hd_effect_sender *sender, struct hd_effect_queue *queue, int64_t now_ns,
                               int64_t since_ns, int open, uint8_t *bytes);

#endif
