/* The spatial index: puts objects into its grid and its heaps of walls, and finds those within a radius of a point.
 * hd_index.h describes the two structures. */
#include "scene/hd_index.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { CELL_BITS = 28, CELL_MASK = (1 << CELL_BITS) - 1, MIN_CHAINS = 16, MIN_WALL_CAPACITY = 4 };

#define FINEST_CELL_M 0.002
#define CELL_RATIO 4.0

/* Largest cell coordinate: points farther out belong to the outermost cell. */
#define MAX_CELL 134217727.0

/* Rounding error of a distance per metre of its coordinates: a distance is the result of fewer than 20 roundings of at
 * most 1.1e-16 each. */
#define ROUNDING_PER_M 4e-15

/* Tolerance of the length of unit vectors: normals and the middle directions of sectors. */
#define UNIT_TOLERANCE 1e-8

/* Larger circles would contain many objects that the next ticks do not reach. */
#define MAX_QUERY_RADIUS_M 0.01

#define HALF_SECTOR_RAD (3.14159265358979323846 / HD_INDEX_SECTORS)

HD_RT static double level_cell_m(uint32_t level) {
    double cell_m = FINEST_CELL_M;
    for (uint32_t i = 0; i < level; i++) {
        cell_m *= CELL_RATIO;
    }
    return cell_m;
}

/* Returns the cell that contains a coordinate: a nondecreasing function, defined for every finite coordinate. */
HD_RT static int32_t cell_coordinate(double coordinate_m, double per_m) {
    double cells = coordinate_m * per_m;
    cells = cells < MAX_CELL ? cells : MAX_CELL;
    cells = cells > -MAX_CELL ? cells : -MAX_CELL;
    const int32_t whole = (int32_t)cells;
    return whole - (cells < (double)whole);
}

HD_RT static uint64_t cell_row(uint32_t level, int32_t y) {
    return ((uint64_t)level << (2 * CELL_BITS)) | (((uint64_t)(uint32_t)y & CELL_MASK) << CELL_BITS);
}

HD_RT static uint64_t cell_key(uint64_t row, int32_t x) {
    return row | ((uint64_t)(uint32_t)x & CELL_MASK);
}

/* Cells of one row are adjacent in `chains`, so that a query loads about one cache line per row; rows are scattered. */
HD_RT static uint32_t row_chain(uint64_t row) {
    return (uint32_t)(((row >> CELL_BITS) * 0x9e3779b97f4a7c15u) >> 32);
}

static uint32_t key_chain(const struct hd_index *index, uint64_t key) {
    return (row_chain(key & ~(uint64_t)CELL_MASK) + (uint32_t)(key & CELL_MASK)) & index->chain_mask;
}

static uint32_t key_level(uint64_t key) {
    return (uint32_t)(key >> (2 * CELL_BITS));
}

static double larger(double a, double b) {
    return a > b ? a : b;
}

/* ---- Bounded shapes, control side ------------------------------------------------------------------------------ */

static void chain_add(struct hd_index *index, uint32_t slot) {
    uint32_t *first = &index->chains[key_chain(index, index->nodes[slot].cell)];
    index->nodes[slot].next = *first;
    index->places[slot].before_or_sector = HD_NO_SLOT;
    if (*first != HD_NO_SLOT) {
        index->places[*first].before_or_sector = slot;
    }
    *first = slot;
}

static void chain_remove(struct hd_index *index, uint32_t slot) {
    const uint32_t next = index->nodes[slot].next;
    const uint32_t before = index->places[slot].before_or_sector;
    if (before != HD_NO_SLOT) {
        index->nodes[before].next = next;
    } else {
        index->chains[key_chain(index, index->nodes[slot].cell)] = next;
    }
    if (next != HD_NO_SLOT) {
        index->places[next].before_or_sector = before;
    }
}

static void member_move(struct hd_index *index, uint32_t from, uint32_t to) {
    const uint32_t slot = index->members[from];
    index->members[to] = slot;
    index->places[slot].at = to;
}

/* Adds a slot to a level. The levels are consecutive in `members`: to make room, every later level moves its first slot
 * to its end. Removing a slot moves the last slot of every later level to its beginning. */
static void member_add(struct hd_index *index, uint32_t level, uint32_t slot) {
    uint32_t *first = index->level_first;
    for (uint32_t later = HD_INDEX_LEVELS - 1; later > level; later--) {
        if (first[later] != first[later + 1]) {
            member_move(index, first[later], first[later + 1]);
        }
        first[later + 1]++;
    }
    index->members[first[level + 1]] = slot;
    index->places[slot].at = first[level + 1]++;
}

static void member_remove(struct hd_index *index, uint32_t level, uint32_t slot) {
    uint32_t *first = index->level_first;
    uint32_t hole = index->places[slot].at;
    for (uint32_t later = level; later < HD_INDEX_LEVELS; later++) {
        const uint32_t last = --first[later + 1];
        if (last != hole) {
            member_move(index, last, hole);
        }
        hole = last;
    }
}

/* Returns the largest distance of a bounded shape's edge from its centre; a value below 0: the shape is not bounded. */
static double bounded_reach_m(const struct hd_object *object) {
    switch ((enum hd_shape)object->shape) {
    case HD_SHAPE_MEMBRANE:
    case HD_SHAPE_DISC:
        return object->half_m[0];
    case HD_SHAPE_BOX:
        return hypot(object->half_m[0], object->half_m[1]);
    case HD_SHAPE_NONE:
    case HD_SHAPE_WALL:
        break;
    }
    return -1.0;
}

int hd_index_holds(uint32_t shape) {
    const struct hd_object object = {.shape = shape};
    return shape == HD_SHAPE_WALL || bounded_reach_m(&object) >= 0.0;
}

static void bounded_put(struct hd_index *index, uint32_t slot, const struct hd_object *object) {
    const double reach_m = bounded_reach_m(object);
    uint32_t level = 0;
    while (level < HD_INDEX_LEVELS - 1 && level_cell_m(level) < 2.0 * reach_m) {
        level++;
    }
    const double per_m = 1.0 / level_cell_m(level);
    struct hd_index_node *node = &index->nodes[slot];
    node->cell = cell_key(cell_row(level, cell_coordinate(object->point_m[1], per_m)),
                          cell_coordinate(object->point_m[0], per_m));
    index->level_reach_m[level] = larger(index->level_reach_m[level], reach_m);
    chain_add(index, slot);
    member_add(index, level, slot);
}

static void bounded_remove(struct hd_index *index, uint32_t slot) {
    const uint32_t level = key_level(index->nodes[slot].cell);
    chain_remove(index, slot);
    member_remove(index, level, slot);
    if (index->level_first[level] == index->level_first[level + 1]) {
        index->level_reach_m[level] = 0.0;
    }
}

/* ---- Walls, control side --------------------------------------------------------------------------------------- */

static uint32_t sector_of(const double normal[2]) {
    const double turns = atan2(normal[1], normal[0]) / (2.0 * HALF_SECTOR_RAD);
    const double sector = floor(turns < 0.0 ? turns + HD_INDEX_SECTORS : turns);
    return sector < HD_INDEX_SECTORS ? (uint32_t)sector : HD_INDEX_SECTORS - 1;
}

static void heap_set(struct hd_index *index, struct hd_index_heap *heap, uint32_t at, struct hd_index_wall wall) {
    heap->walls[at] = wall;
    index->places[wall.slot].at = at;
}

/* Puts a wall at a free place of the heap and moves it up or down to restore the order. The heap has room. */
static void heap_settle(struct hd_index *index, struct hd_index_heap *heap, uint32_t at, struct hd_index_wall wall) {
    while (at > 0 && heap->walls[(at - 1) / 2].offset_m < wall.offset_m) {
        heap_set(index, heap, at, heap->walls[(at - 1) / 2]);
        at = (at - 1) / 2;
    }
    for (uint32_t below = 2 * at + 1; below < heap->count; below = 2 * at + 1) {
        if (below + 1 < heap->count && heap->walls[below].offset_m < heap->walls[below + 1].offset_m) {
            below++;
        }
        if (!(heap->walls[below].offset_m > wall.offset_m)) {
            break;
        }
        heap_set(index, heap, at, heap->walls[below]);
        at = below;
    }
    heap_set(index, heap, at, wall);
}

static int heap_grow(struct hd_index_heap *heap) {
    if (heap->count < heap->capacity) {
        return HD_OK;
    }
    const uint32_t capacity = heap->capacity > 0 ? 2 * heap->capacity : MIN_WALL_CAPACITY;
    struct hd_index_wall *walls = realloc(heap->walls, capacity * sizeof *walls);
    if (walls == NULL) {
        return HD_ERR_MEMORY;
    }
    heap->walls = walls;
    heap->capacity = capacity;
    return HD_OK;
}

static void wall_put(struct hd_index *index, uint32_t slot, const struct hd_object *object) {
    const uint32_t sector = sector_of(object->normal);
    struct hd_index_heap *heap = &index->heaps[sector];
    const struct hd_index_wall wall = {
        .offset_m = object->normal[0] * object->point_m[0] + object->normal[1] * object->point_m[1],
        .normal = {object->normal[0], object->normal[1]},
        .slot = slot,
    };
    if (heap->count == 0) {
        const double middle_rad = (2.0 * sector + 1.0) * HALF_SECTOR_RAD;
        index->sector_places[sector] = index->sector_count;
        index->sectors[index->sector_count++] =
            (struct hd_index_sector){.middle = {cos(middle_rad), sin(middle_rad)}, .sector = sector};
    }
    index->places[slot].before_or_sector = sector;
    heap->count++;
    heap_settle(index, heap, heap->count - 1, wall);
    index->sectors[index->sector_places[sector]].top_m = heap->walls[0].offset_m;
}

static void wall_remove(struct hd_index *index, uint32_t slot) {
    const uint32_t sector = index->places[slot].before_or_sector;
    const uint32_t at = index->places[slot].at;
    struct hd_index_heap *heap = &index->heaps[sector];
    struct hd_index_sector *place = &index->sectors[index->sector_places[sector]];
    heap->count--;
    if (at < heap->count) {
        heap_settle(index, heap, at, heap->walls[heap->count]);
    }
    if (heap->count > 0) {
        place->top_m = heap->walls[0].offset_m;
    } else {
        *place = index->sectors[--index->sector_count];
        index->sector_places[place->sector] = (uint32_t)(place - index->sectors);
    }
}

/* ---- Control side ---------------------------------------------------------------------------------------------- */

int hd_index_reserve(struct hd_index *index, uint32_t slot_count) {
    const uint32_t count = index->slot_count;
    if (slot_count <= count) {
        return HD_OK;
    }
    size_t chain_count = MIN_CHAINS;
    while (chain_count < 2 * (size_t)slot_count) {
        chain_count *= 2;
    }
    uint32_t *chains = malloc(chain_count * sizeof *chains);
    uint32_t *members = malloc(slot_count * sizeof *members);
    struct hd_index_node *nodes = malloc(slot_count * sizeof *nodes);
    struct hd_index_place *places = malloc(slot_count * sizeof *places);
    if (chains == NULL || members == NULL || nodes == NULL || places == NULL) {
        free(chains);
        free(members);
        free(nodes);
        free(places);
        return HD_ERR_MEMORY;
    }
    if (count > 0) {
        memcpy(members, index->members, count * sizeof *members);
        memcpy(nodes, index->nodes, count * sizeof *nodes);
        memcpy(places, index->places, count * sizeof *places);
    }
    memset(nodes + count, 0, (slot_count - count) * sizeof *nodes);
    free(index->chains);
    free(index->members);
    free(index->nodes);
    free(index->places);
    index->chains = chains;
    index->members = members;
    index->nodes = nodes;
    index->places = places;
    index->slot_count = slot_count;
    index->chain_mask = (uint32_t)(chain_count - 1);
    for (size_t i = 0; i < chain_count; i++) {
        chains[i] = HD_NO_SLOT;
    }
    for (uint32_t i = 0; i < index->level_first[HD_INDEX_LEVELS]; i++) {
        chain_add(index, members[i]);
    }
    return HD_OK;
}

int hd_index_put(struct hd_index *index, uint32_t slot, const struct hd_object *object) {
    struct hd_index_node *node = &index->nodes[slot];
    const int was_wall = node->shape == HD_SHAPE_WALL;
    if (object->shape == HD_SHAPE_WALL) {
        const uint32_t sector = sector_of(object->normal);
        const int stays = was_wall && index->places[slot].before_or_sector == sector;
        if (!stays && heap_grow(&index->heaps[sector]) < 0) {
            return HD_ERR_MEMORY;
        }
    }
    if (was_wall) {
        wall_remove(index, slot);
    } else if (node->shape != HD_SHAPE_NONE) {
        bounded_remove(index, slot);
    }
    node->shape = object->shape;
    if (object->shape == HD_SHAPE_NONE) {
        return HD_OK;
    }
    if (object->shape == HD_SHAPE_WALL) {
        wall_put(index, slot, object);
    } else {
        bounded_put(index, slot, object);
    }
    index->span_m = larger(index->span_m,
                           fabs(object->point_m[0]) + fabs(object->point_m[1]) + object->half_m[0] + object->half_m[1]);
    return HD_OK;
}

void hd_index_release(struct hd_index *index) {
    free(index->chains);
    free(index->members);
    free(index->nodes);
    free(index->places);
    for (uint32_t sector = 0; sector < HD_INDEX_SECTORS; sector++) {
        free(index->heaps[sector].walls);
    }
    *index = (struct hd_index){0};
}

/* ---- Query ----------------------------------------------------------------------------------------------------- */

struct query {
    const struct hd_index *index;
    const struct hd_object *objects;
    double point_m[2];
    double radius_m;
    double slack_m; /* rounding error of a distance */
    struct hd_candidate *candidates;
    uint32_t count;
};

HD_RT static double root(double square) {
    HD_RT_FOREIGN_BEGIN
    return sqrt(square);
    HD_RT_FOREIGN_END
}

HD_RT static void add(struct query *query, uint32_t slot, double distance_m) {
    query->candidates[query->count++] =
        (struct hd_candidate){.distance_m = distance_m > 0.0 ? distance_m : 0.0, .slot = slot};
}

/* Whether a bounded shape is a disc. Other bounded shapes are boxes; a membrane is a box of thickness 0. */
HD_RT static inline int is_round(const struct hd_object *object) {
    switch ((enum hd_shape)object->shape) {
    case HD_SHAPE_DISC:
        return 1;
    case HD_SHAPE_NONE:
    case HD_SHAPE_WALL:
    case HD_SHAPE_MEMBRANE:
    case HD_SHAPE_BOX:
        break;
    }
    return 0;
}

HD_RT static void visit(struct query *query, uint32_t slot) {
    const struct hd_object *object = &query->objects[slot];
    const double from[2] = {query->point_m[0] - object->point_m[0], query->point_m[1] - object->point_m[1]};
    double square;
    double nearer_m;
    if (is_round(object)) {
        square = from[0] * from[0] + from[1] * from[1];
        nearer_m = object->half_m[0] + query->slack_m;
    } else {
        const double along = fabs(from[0] * object->normal[1] - from[1] * object->normal[0]) - object->half_m[0];
        const double above = fabs(from[0] * object->normal[0] + from[1] * object->normal[1]) - object->half_m[1];
        /* Twice the positive parts. Written without a comparison, which compilers turn into an unpredictable branch. */
        const double out[2] = {along + fabs(along), above + fabs(above)};
        square = 0.25 * (out[0] * out[0] + out[1] * out[1]);
        nearer_m = query->slack_m;
    }
    const double distance_m = root(square) - nearer_m;
    if (distance_m <= query->radius_m) {
        add(query, slot, distance_m);
    }
}

HD_RT static void visit_level(struct query *query, uint32_t level) {
    const struct hd_index *index = query->index;
    const uint32_t first = index->level_first[level];
    const uint32_t end = index->level_first[level + 1];
    const double per_m = 1.0 / level_cell_m(level);
    /* Rounded up, since cells are computed from rounded coordinates. */
    const double reach_m = (query->radius_m + index->level_reach_m[level]) * (1.0 + UNIT_TOLERANCE) + query->slack_m;
    const int32_t left = cell_coordinate(query->point_m[0] - reach_m, per_m);
    const int32_t right = cell_coordinate(query->point_m[0] + reach_m, per_m);
    const int32_t low = cell_coordinate(query->point_m[1] - reach_m, per_m);
    const int32_t high = cell_coordinate(query->point_m[1] + reach_m, per_m);
    if ((uint64_t)(right - left + 1) * (uint64_t)(high - low + 1) >= end - first) {
        for (uint32_t i = first; i < end; i++) {
            visit(query, index->members[i]);
        }
        return;
    }
    for (int32_t y = low; y <= high; y++) {
        const uint64_t row = cell_row(level, y);
        const uint32_t row_first = row_chain(row);
        for (int32_t x = left; x <= right; x++) {
            const uint64_t key = cell_key(row, x);
            uint32_t slot = index->chains[(row_first + (uint32_t)(key - row)) & index->chain_mask];
            while (slot != HD_NO_SLOT) {
                if (index->nodes[slot].cell == key) {
                    visit(query, slot);
                }
                slot = index->nodes[slot].next;
            }
        }
    }
}

/* Visits the walls of a heap with an offset of at least `least_m`, from the top down. Walls below a wall with a smaller
 * offset are skipped. */
HD_RT static void visit_heap(struct query *query, const struct hd_index_heap *heap, double least_m) {
    uint32_t at = 0;
    for (;;) {
        if (at < heap->count && !(heap->walls[at].offset_m < least_m)) {
            const struct hd_index_wall *wall = &heap->walls[at];
            const double height_m = wall->normal[0] * query->point_m[0] + wall->normal[1] * query->point_m[1] -
                                    wall->offset_m - query->slack_m;
            if (height_m <= query->radius_m) {
                add(query, wall->slot, height_m);
            }
            at = 2 * at + 1;
            continue;
        }
        while (at > 0 && at % 2 == 0) {
            at = (at - 1) / 2;
        }
        if (at == 0) {
            return;
        }
        at++;
    }
}

HD_RT static void visit_walls(struct query *query) {
    const double cos_half = 1.0 - HALF_SECTOR_RAD * HALF_SECTOR_RAD / 2.0; /* slightly below the cosine */
    const double sin_half = HALF_SECTOR_RAD;                               /* slightly above the sine */
    const double *point_m = query->point_m;
    const double slack_m =
        query->radius_m + query->slack_m + UNIT_TOLERANCE * fabs(point_m[0]) + UNIT_TOLERANCE * fabs(point_m[1]);
    for (uint32_t i = 0; i < query->index->sector_count; i++) {
        const struct hd_index_sector *sector = &query->index->sectors[i];
        const double along = sector->middle[0] * point_m[0] + sector->middle[1] * point_m[1];
        const double across = fabs(sector->middle[1] * point_m[0] - sector->middle[0] * point_m[1]);
        /* Lower bound of n.p over the normals n of the sector, minus the radius: a wall with a smaller offset is out of
         * reach. */
        const double least_m = (along > 0.0 ? along * cos_half : along) - across * sin_half - slack_m;
        if (!(sector->top_m < least_m)) {
            visit_heap(query, &query->index->heaps[sector->sector], least_m);
        }
    }
}

HD_RT double hd_index_radius(const struct hd_index *index) {
    for (uint32_t level = 0; level < HD_INDEX_LEVELS && level_cell_m(level) < 2.0 * MAX_QUERY_RADIUS_M; level++) {
        if (index->level_first[level] != index->level_first[level + 1]) {
            return level_cell_m(level) / 2.0;
        }
    }
    return MAX_QUERY_RADIUS_M;
}

HD_RT uint32_t hd_index_query(const struct hd_index *index, const struct hd_object *objects, const double point_m[2],
                              double radius_m, struct hd_candidate *candidates) {
    struct query query = {
        .index = index,
        .objects = objects,
        .point_m = {point_m[0], point_m[1]},
        .radius_m = radius_m,
        .slack_m =
            ROUNDING_PER_M * index->span_m + ROUNDING_PER_M * fabs(point_m[0]) + ROUNDING_PER_M * fabs(point_m[1]),
        .candidates = candidates,
    };
    for (uint32_t level = 0; level < HD_INDEX_LEVELS; level++) {
        if (index->level_first[level] != index->level_first[level + 1]) {
            visit_level(&query, level);
        }
    }
    visit_walls(&query);
    return query.count;
}
