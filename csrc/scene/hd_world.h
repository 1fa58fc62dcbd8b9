/* A table as C owns it: checked, copied, indexed. The servo has three of them (hd_triple.h), an offline run has one.
 *
 * Invariant: no world that was loaded can make a tick read out of bounds, divide by zero or run for ever. What finite
 * numbers can still overflow to in a tick, the tick itself catches. Memory grows on the control side only. */
#ifndef HD_WORLD_H
#define HD_WORLD_H

#include "api/hd_core.h"
#include "base/hd_memory.h"
#include "scene/hd_check.h"
#include "scene/hd_index.h"
#include "scene/hd_table_numbers.h"

#define HD_WORLD_REGIONS (8u + HD_INDEX_SECTORS)

struct hd_world {
    struct hd_table table; /* its arrays belong to the world; `changed` is not kept */
    struct hd_index index;
    uint32_t object_capacity;
    uint32_t material_capacity;
    uint32_t piece_capacity;
    uint32_t noise_capacity;
    uint32_t number_capacity;
    uint32_t loaded; /* 0: holds nothing yet */
};

/* As hd_world_load (hd_api.h), but looks at the objects of `slots` alone: the others must be as they were when this
 * world was last loaded or updated. Slots that this world has not had yet are looked at in any case; of `slots`, those
 * beyond the table's objects are passed over. Materials, pieces, noises and numbers are compared by parts_version. */
int hd_world_update(struct hd_world *world, const struct hd_table *table, const uint32_t *slots, size_t count);
/* Frees what the world owns, not the world itself. */
void hd_world_release(struct hd_world *world);
/* The memory that a tick reads, each array at its own place in the list, empty or not; HD_WORLD_REGIONS is returned. */
size_t hd_world_regions(const struct hd_world *world, struct hd_region regions[HD_WORLD_REGIONS]);

#endif
