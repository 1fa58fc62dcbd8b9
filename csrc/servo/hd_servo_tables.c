/* Tables: control checks and copies them into the back one of three worlds, the servo takes the newest at the beginning
 * of a tick. A world is updated with the changes since it was last filled. If only regions of memory are locked, the
 * memory that a table adds is locked before the servo uses it. */
#include "servo/hd_servo.h"

#include <math.h>
#include <string.h>

#include "base/hd_clock.h"

#define HD_WRITTEN_REGIONS 4u /* the servo itself and its rings */
#define HD_SERVO_REGIONS (HD_STATE_REGIONS + 3u * HD_WORLD_REGIONS + 1u + HD_WRITTEN_REGIONS)

/* ---- The servo thread -------------------------------------------------------------------------------------------- */

HD_RT void hd_servo_take_table(struct hd_servo *servo, int64_t time_ns) {
    if (!hd_triple_acquire(&servo->table_triple)) {
        return;
    }
    servo->world = &servo->worlds[hd_triple_front(&servo->table_triple)];
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

/* ---- Memory ------------------------------------------------------------------------------------------------------ */

/* Lists all memory that the servo uses, without unused capacity. hd_servo_new has written the last HD_WRITTEN_REGIONS
 * entirely; before them comes the device. */
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

int hd_servo_lock_memory(struct hd_servo *servo, struct hd_grant *grant) {
    struct hd_region regions[HD_SERVO_REGIONS];
    const size_t count = regions_of(servo, regions);
    /* Without memory that other threads use already: telemetry reads the servo's counters and rings, and the threads of
     * a connected device write to the device, all of which hd_hid_new has written. */
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
    return HD_OK;
}

/* Handles a refused lock: refuses the table if real time is required; otherwise it is rendered from unlocked memory,
 * which is reported. */
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

/* Locks those slots of a table that are not locked yet. */
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

/* Locks the regions of a world that have changed since it was last locked. */
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

/* ---- Control side ------------------------------------------------------------------------------------------------ */

/* Adds the changes of a table to those that the three worlds have not received, even if the table is refused later. */
static void note_changes(struct hd_servo *servo, const struct hd_table *table) {
    /* A slot that was removed and added again is a different one, but a world that misses both changes would not
     * notice. */
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
        return hd_invalid("table: compiled for a period of %.17g s, but the servo has %.17g s", table->period_s,
                          servo->period_s);
    }
    if (servo->max_force_n > 0.0 &&
        (table->max_force_n < servo->max_force_n || table->max_force_n > servo->max_force_n)) {
        return hd_invalid("table: a force limit of %g N, but the servo started with %g N", table->max_force_n,
                          servo->max_force_n);
    }
    if (table->changed_count > 0 && table->changed == NULL) {
        return hd_invalid("table: %u changed slots, but no list of them", table->changed_count);
    }
    const uint32_t back = hd_triple_back(&servo->table_triple);
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
        /* Without the release, the arrays of the world would stay too large for later tables. */
        hd_world_release(world);
        memset(servo->locked[back], 0, sizeof servo->locked[back]);
        return status;
    }
    changes->all = 0;
    changes->count = 0;
    servo->max_force_n = table->max_force_n;
    hd_triple_publish(&servo->table_triple);
    return HD_OK;
}

/* Finds, among the kept first ticks of revisions, that of `revision` or of a later one. Returns 0 if none is kept. */
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
        hd_servo_pause(servo);
    }
    return HD_OK;
}
