/* Worlds: a table is checked (hd_check.h), copied and indexed.
 *
 * All checks come first, then all allocations, then all writes, so that a table that is refused or does not fit into
 * memory leaves the world unchanged. Records that are not checked again were checked when they were taken, and are
 * copies that belong to the world. Control side. */
#include "scene/hd_world.h"

#include <stdlib.h>
#include <string.h>

/* ---- Taking a table ----------------------------------------------------------------------------------------- */

/* The extent of an update: the objects of `slots` below `from`, all objects from `from` on, and if `parts` is not 0,
 * materials, pieces, noises and numbers. */
struct extent {
    const uint32_t *slots;
    size_t count;
    uint32_t from;
    int parts;
};

static int is_listed(const struct extent *part, uint32_t slot) {
    for (size_t i = 0; i < part->count; i++) {
        if (part->slots[i] == slot) {
            return 1;
        }
    }
    return 0;
}

static int check_extent(const struct hd_world *world, const struct hd_table *table, const struct extent *part) {
    const struct hd_table *parts = part->parts ? table : &world->table;
    if (part->parts && hd_parts_check(table) < 0) {
        return HD_ERR_INVALID;
    }
    for (size_t i = 0; i < part->count; i++) {
        const uint32_t slot = part->slots[i];
        if (slot < part->from && hd_object_check(&table->objects[slot], parts, slot) < 0) {
            return HD_ERR_INVALID;
        }
    }
    for (uint32_t slot = part->from; slot < table->object_count; slot++) {
        if (hd_object_check(&table->objects[slot], parts, slot) < 0) {
            return HD_ERR_INVALID;
        }
    }
    /* Objects that stay can refer to parts that do not exist any more. */
    for (uint32_t slot = 0; part->parts && slot < part->from; slot++) {
        if (hd_references_check(parts, &world->table.objects[slot], slot) < 0 && !is_listed(part, slot)) {
            return HD_ERR_INVALID;
        }
    }
    return HD_OK;
}

/* Enlarges an array and keeps its records. `array`: address of a pointer to records of any type. */
static int grow_array(void *array, uint32_t *capacity, uint32_t count, size_t size) {
    if (count <= *capacity) {
        return HD_OK;
    }
    /* The first allocation is exact; later ones add a quarter, for scenes that grow object by object. */
    const uint64_t ahead = (uint64_t)count + (*capacity > 0 ? count / 4u : 0u);
    const uint32_t larger = ahead < UINT32_MAX ? (uint32_t)ahead : UINT32_MAX;
    void *records;
    memcpy(&records, array, sizeof records);
    records = realloc(records, larger * size);
    if (records == NULL) {
        return HD_ERR_MEMORY;
    }
    memcpy(array, &records, sizeof records);
    *capacity = larger;
    return HD_OK;
}

static int reserve_table(struct hd_world *world, const struct hd_table *table, int parts) {
    struct hd_table *own = &world->table;
    int status = grow_array(&own->objects, &world->object_capacity, table->object_count, sizeof *own->objects);
    if (status == HD_OK && parts) {
        status = grow_array(&own->materials, &world->material_capacity, table->material_count, sizeof *own->materials);
        if (status == HD_OK) {
            status = grow_array(&own->pieces, &world->piece_capacity, table->piece_count, sizeof *own->pieces);
        }
        if (status == HD_OK) {
            status = grow_array(&own->noises, &world->noise_capacity, table->noise_count, sizeof *own->noises);
        }
        if (status == HD_OK) {
            status = grow_array(&own->numbers, &world->number_capacity, table->number_count, sizeof *own->numbers);
        }
    }
    return status == HD_OK ? hd_index_reserve(&world->index, world->object_capacity) : status;
}

static void copy_records(void *to, const void *from, uint32_t count, size_t size) {
    if (count > 0) {
        memcpy(to, from, count * size);
    }
}

/* Copies everything except the objects. */
static void write_rest(struct hd_table *own, const struct hd_table *table, int parts) {
    const struct hd_table before = *own;
    if (parts) {
        copy_records(own->materials, table->materials, table->material_count, sizeof *own->materials);
        copy_records(own->pieces, table->pieces, table->piece_count, sizeof *own->pieces);
        copy_records(own->noises, table->noises, table->noise_count, sizeof *own->noises);
        copy_records(own->numbers, table->numbers, table->number_count, sizeof *own->numbers);
    }
    *own = *table;
    own->objects = before.objects;
    own->materials = before.materials;
    own->pieces = before.pieces;
    own->noises = before.noises;
    own->numbers = before.numbers;
    own->changed = NULL;
    own->changed_count = 0;
}

/* Puts the objects of the extent into the index; slots from `count` to `end` are cleared. */
static int put_in_index(struct hd_index *index, const struct hd_object *objects, uint32_t count,
                        const struct extent *part, uint32_t end) {
    static const struct hd_object nothing = {.shape = HD_SHAPE_NONE};
    for (size_t i = 0; i < part->count; i++) {
        const uint32_t slot = part->slots[i];
        if (slot < part->from && hd_index_put(index, slot, slot < count ? &objects[slot] : &nothing) < 0) {
            return HD_ERR_MEMORY;
        }
    }
    for (uint32_t slot = part->from; slot < end; slot++) {
        if (hd_index_put(index, slot, slot < count ? &objects[slot] : &nothing) < 0) {
            return HD_ERR_MEMORY;
        }
    }
    return HD_OK;
}

static int update_index(struct hd_world *world, const struct hd_table *table, const struct extent *part) {
    const struct hd_table *own = &world->table;
    const uint32_t end = own->object_count > table->object_count ? own->object_count : table->object_count;
    if (put_in_index(&world->index, table->objects, table->object_count, part, end) < 0) {
        /* After all slots are cleared, the earlier objects have the room that they had before, so no put can fail. */
        put_in_index(&world->index, NULL, 0, part, end);
        put_in_index(&world->index, own->objects, own->object_count, part, end);
        return HD_ERR_MEMORY;
    }
    return HD_OK;
}

static int take_table(struct hd_world *world, const struct hd_table *table, const struct extent *part) {
    struct hd_table *own = &world->table;
    int status = check_extent(world, table, part);
    if (status == HD_OK) {
        status = reserve_table(world, table, part->parts);
    }
    if (status == HD_OK) {
        status = update_index(world, table, part);
    }
    if (status != HD_OK) {
        return status;
    }
    for (size_t i = 0; i < part->count; i++) {
        if (part->slots[i] < part->from) {
            own->objects[part->slots[i]] = table->objects[part->slots[i]];
        }
    }
    if (table->object_count > part->from) {
        copy_records(own->objects + part->from, table->objects + part->from, table->object_count - part->from,
                     sizeof *own->objects);
    }
    write_rest(own, table, part->parts);
    world->loaded = 1;
    return HD_OK;
}

int hd_world_load(struct hd_world *world, const struct hd_table *table) {
    const struct extent all = {.parts = 1};
    const int status = hd_scalars_check(table);
    return status == HD_OK ? take_table(world, table, &all) : status;
}

void hd_world_still(struct hd_world *world) {
    world->table.ramp_step = 0.0;
}

int hd_world_update(struct hd_world *world, const struct hd_table *table, const uint32_t *slots, size_t count) {
    if (!world->loaded || table->all_changed) {
        return hd_world_load(world, table);
    }
    const struct hd_table *own = &world->table;
    const struct extent part = {
        .slots = slots,
        .count = count,
        .from = own->object_count < table->object_count ? own->object_count : table->object_count,
        .parts = table->parts_version != own->parts_version || table->material_count != own->material_count ||
                 table->piece_count != own->piece_count || table->noise_count != own->noise_count ||
                 table->number_count != own->number_count,
    };
    const int status = hd_scalars_check(table);
    return status == HD_OK ? take_table(world, table, &part) : status;
}

/* ---- Making, reading and freeing ---------------------------------------------------------------------------- */

struct hd_world *hd_world_new(void) {
    return calloc(1, sizeof(struct hd_world));
}

void hd_world_release(struct hd_world *world) {
    free(world->table.objects);
    free(world->table.materials);
    free(world->table.pieces);
    free(world->table.noises);
    free(world->table.numbers);
    hd_index_release(&world->index);
    *world = (struct hd_world){.loaded = 0};
}

void hd_world_free(struct hd_world *world) {
    if (world != NULL) {
        hd_world_release(world);
        free(world);
    }
}

size_t hd_world_candidates(const struct hd_world *world, const double point_m[2], double radius_m, uint32_t *slots,
                           size_t capacity) {
    const uint32_t room = world->index.slot_count;
    struct hd_candidate *candidates = malloc((room > 0 ? room : 1u) * sizeof *candidates);
    if (candidates == NULL) {
        return SIZE_MAX; /* out of memory */
    }
    const uint32_t count = hd_index_query(&world->index, world->table.objects, point_m, radius_m, candidates);
    for (uint32_t i = 0; i < count && i < capacity; i++) {
        slots[i] = candidates[i].slot;
    }
    free(candidates);
    return count;
}

size_t hd_world_regions(const struct hd_world *world, struct hd_region regions[HD_WORLD_REGIONS]) {
    const struct hd_table *table = &world->table;
    const struct hd_index *index = &world->index;
    const size_t chains = index->chains != NULL ? (size_t)index->chain_mask + 1u : 0u;
    size_t count = 0;
    regions[count++] = (struct hd_region){table->objects, world->object_capacity * sizeof *table->objects};
    regions[count++] = (struct hd_region){table->materials, world->material_capacity * sizeof *table->materials};
    regions[count++] = (struct hd_region){table->pieces, world->piece_capacity * sizeof *table->pieces};
    regions[count++] = (struct hd_region){table->noises, world->noise_capacity * sizeof *table->noises};
    regions[count++] = (struct hd_region){table->numbers, world->number_capacity * sizeof *table->numbers};
    regions[count++] = (struct hd_region){index->chains, chains * sizeof *index->chains};
    regions[count++] = (struct hd_region){index->members, index->slot_count * sizeof *index->members};
    regions[count++] = (struct hd_region){index->nodes, index->slot_count * sizeof *index->nodes};
    for (size_t i = 0; i < HD_INDEX_SECTORS; i++) {
        const struct hd_index_heap *heap = &index->heaps[i];
        regions[count++] = (struct hd_region){heap->walls, heap->capacity * sizeof *heap->walls};
    }
    return count;
}
