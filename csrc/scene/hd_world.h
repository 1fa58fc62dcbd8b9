/* A world: a table that C has checked, copied and indexed. The servo has three worlds (hd_triple.h), an offline run
 * one.
 *
 * Invariant: with a loaded world no tick reads out of bounds, divides by zero or loops endlessly. If finite numbers
 * overflow in a tick, hd_tick detects that. Memory grows on the control side only. */
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
    uint32_t loaded; /* 0: no table was loaded yet */
};

/* As hd_world_load (hd_api.h), but checks and copies only the objects of `slots`: the others must be unchanged since
 * this world was last loaded or updated. Slots that are new to this world are always included; entries of `slots`
 * beyond the table's objects are ignored. Materials, pieces, noises and numbers are taken if parts_version changed. */
int hd_world_update(struct hd_world *world, const struct hd_table *table, const uint32_t *slots, size_t count);
/* Frees what the world owns, not the world itself. */
void hd_world_release(struct hd_world *world);
/* Lists the memory that a tick reads, each array at a fixed index, even if it is empty. Returns HD_WORLD_REGIONS. */
size_t hd_world_regions(const struct hd_world *world, struct hd_region regions[HD_WORLD_REGIONS]);

#endif
