/* The spatial index: finds the objects near a point. The cost of a query depends on the number of near objects.
 *
 * Bounded shapes (membrane, box, disc) lie in a hierarchical hash grid. Its levels have cells of 2 mm, 8 mm and so on
 * up to 33 m. A shape lies in the cell that contains its centre, on the finest level whose cells are at least as wide
 * as the shape, or on the coarsest. A query visits the occupied levels: on each the cells that its circle can touch, or
 * all shapes of the level if those are not more than the cells. Cells are chains of slots in one hash table.
 *
 * Walls are unbounded. They are grouped in sectors by the direction of their normal; each sector is a heap ordered by
 * the offset from the origin along the normal. Of two walls of one direction, the one with the larger offset is nearer,
 * or the point is deeper in it. So a query descends from the top of each occupied sector and stops at walls out of
 * reach.
 *
 * Distances are rounded down by more than the rounding error of the arithmetic: none exceeds the true distance.
 *
 * Filled on the control side, one slot at a time; read by the servo. Memory is proportional to the slots. */
#ifndef HD_INDEX_H
#define HD_INDEX_H

#include "api/hd_core.h"
#include "base/hd_rt.h"

#define HD_INDEX_LEVELS 8
#define HD_INDEX_SECTORS 64

struct hd_candidate {
    double distance_m; /* lower bound of the distance from point to shape; 0: the point is inside */
    uint32_t slot;
};

struct hd_index_node {
    uint64_t cell;  /* bounded shapes: level and coordinates of the cell, packed */
    uint32_t next;  /* bounded shapes: the next slot in the chain, or HD_NO_SLOT */
    uint32_t shape; /* enum hd_shape */
};

/* The place of a slot, used when the slot is put again. Of a bounded shape: index in `members`, and the slot before it
 * in the chain or HD_NO_SLOT. Of a wall: index in its heap, and the sector of the heap. */
struct hd_index_place {
    uint32_t at;
    uint32_t before_or_sector;
};

struct hd_index_wall {
    double offset_m;
    double normal[2];
    uint32_t slot;
    uint32_t unused;
};

/* A binary heap: the offset of wall i is at most that of wall (i - 1) / 2. */
struct hd_index_heap {
    struct hd_index_wall *walls;
    uint32_t count;
    uint32_t capacity;
};

/* An occupied sector, with the data that decide whether any of its walls can be near. */
struct hd_index_sector {
    double middle[2]; /* unit vector in the middle of the sector */
    double top_m;     /* largest offset of its walls */
    uint32_t sector;
    uint32_t unused;
};

struct hd_index {
    uint32_t slot_count;                       /* slots for which there is room */
    uint32_t chain_mask;                       /* number of chains, a power of two, minus one */
    uint32_t *chains;                          /* first slot of each chain, or HD_NO_SLOT */
    uint32_t *members;                         /* slots of bounded shapes, level after level */
    struct hd_index_node *nodes;               /* by slot */
    struct hd_index_place *places;             /* by slot; control side only */
    uint32_t level_first[HD_INDEX_LEVELS + 1]; /* index in `members` at which each level begins, and the last ends */
    uint32_t sector_count;                     /* number of occupied sectors */
    double level_reach_m[HD_INDEX_LEVELS];     /* largest distance of a shape's edge from its centre, by level */
    double span_m; /* bound on the coordinates of all shapes that were ever put; defines the rounding error */
    struct hd_index_sector sectors[HD_INDEX_SECTORS]; /* the occupied sectors, unordered */
    uint32_t sector_places[HD_INDEX_SECTORS];         /* by sector: index in `sectors` */
    struct hd_index_heap heaps[HD_INDEX_SECTORS];     /* by sector */
};

/* Makes room for `slot_count` slots. An index of all zeros is empty. HD_ERR_MEMORY leaves the index unchanged. Control
 * side. */
int hd_index_reserve(struct hd_index *index, uint32_t slot_count);
/* Whether the index supports this shape; the check of a table refuses other shapes. */
int hd_index_holds(uint32_t shape);
/* Puts `object` into a slot (HD_SHAPE_NONE: clears the slot), in place of its earlier object. The slot must be below
 * the reserved count. HD_ERR_MEMORY leaves the index unchanged. Only a wall can cause it, and not one for which its
 * sector had room before, since a sector keeps its room when walls leave it. */
int hd_index_put(struct hd_index *index, uint32_t slot, const struct hd_object *object);
void hd_index_release(struct hd_index *index);

/* Returns a radius at which a query is cheap: half the finest occupied cell, at most 0.01 m. */
HD_RT double hd_index_radius(const struct hd_index *index);
/* Finds all objects within `radius_m` (0 to 1e100) of the finite point `point_m`, each once, in an order that depends
 * on how the index was filled. `objects`: the records that were put; `candidates`: room for slot_count entries. Returns
 * their number. Objects just beyond the radius, by less than the rounding error, may be among them. */
HD_RT uint32_t hd_index_query(const struct hd_index *index, const struct hd_object *objects, const double point_m[2],
                              double radius_m, struct hd_candidate *candidates);

#endif
