/* What is near a point, at a cost that follows what is near.
 *
 * Bounded shapes (membrane, box, disc) lie in a hierarchical hash grid. Its levels have cells of 2 mm, 8 mm and so on
 * up to 33 m; a shape lies in the one cell that holds its centre, on the finest level whose cells are as wide or wider
 * (or the last). A query visits the occupied levels only, and on each the cells that its disc can concern, or the
 * shapes of the level one by one where they are not more than the cells. Cells are chains of slots that share one hash
 * table.
 *
 * Walls have no bounds. They lie in sectors of the direction of their normal, in each as a heap by their offset from
 * the origin along it. Of two walls of one direction, the one of larger offset is the nearer (or the deeper) one, so
 * that a query goes down from the top of each occupied sector and turns back at walls out of reach.
 *
 * Distances are rounded down by more than the arithmetic can err: none is larger than the true one.
 *
 * Filled on the control side, one slot at a time; read by the servo. Memory grows with the slots. */
#ifndef HD_INDEX_H
#define HD_INDEX_H

#include "api/hd_core.h"
#include "base/hd_rt.h"

#define HD_INDEX_LEVELS 8
#define HD_INDEX_SECTORS 64

struct hd_candidate {
    double distance_m; /* from the point to the shape, or less; 0: in it, or behind the wall */
    uint32_t slot;
};

struct hd_index_node {
    uint64_t cell;  /* bounded shapes: level and coordinates of the cell, packed */
    uint32_t next;  /* bounded shapes: the next slot in the chain, or HD_NO_SLOT */
    uint32_t shape; /* enum hd_shape */
};

/* How a slot is found again when it is put anew: where a bounded shape stands in `members` and which slot is before it
 * in the chain (or HD_NO_SLOT), or where a wall stands in the heap of which sector. */
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

/* No wall has a larger offset than the one at half its place, (i - 1) / 2. */
struct hd_index_heap {
    struct hd_index_wall *walls;
    uint32_t count;
    uint32_t capacity;
};

/* An occupied sector, with what decides whether any wall of it can be near. */
struct hd_index_sector {
    double middle[2]; /* direction */
    double top_m;     /* the largest offset */
    uint32_t sector;
    uint32_t unused;
};

struct hd_index {
    uint32_t slot_count;                       /* room for so many */
    uint32_t chain_mask;                       /* number of chains, a power of two, less one */
    uint32_t *chains;                          /* first slot of each, or HD_NO_SLOT */
    uint32_t *members;                         /* slots of bounded shapes, level after level */
    struct hd_index_node *nodes;               /* by slot */
    struct hd_index_place *places;             /* by slot; control side only */
    uint32_t level_first[HD_INDEX_LEVELS + 1]; /* where each level begins in `members`, and where the last ends */
    uint32_t sector_count;                     /* occupied ones */
    double level_reach_m[HD_INDEX_LEVELS];     /* no shape of the level goes farther from its centre */
    double span_m; /* what bounds the coordinates of all shapes that were ever put; sets the rounding */
    struct hd_index_sector sectors[HD_INDEX_SECTORS]; /* the occupied ones, in no order */
    uint32_t sector_places[HD_INDEX_SECTORS];         /* by sector: where in `sectors` */
    struct hd_index_heap heaps[HD_INDEX_SECTORS];     /* by sector */
};

/* Control side. An index of all zeros is empty. HD_ERR_MEMORY leaves it as it was. */
int hd_index_reserve(struct hd_index *index, uint32_t slot_count);
/* Whether the index has bounds and a distance for this shape; the check of a table refuses every other one. */
int hd_index_holds(uint32_t shape);
/* The slot now holds `object` (HD_SHAPE_NONE: nothing), whatever it held before; slot < the count reserved.
 * HD_ERR_MEMORY leaves the index as it was; it can come of a wall only, and not of one for which there was room before:
 * a sector keeps its room when walls leave it. */
int hd_index_put(struct hd_index *index, uint32_t slot, const struct hd_object *object);
void hd_index_release(struct hd_index *index);

/* A radius at which a query costs little: half the finest cell that is occupied, 0.01 m at most. */
HD_RT double hd_index_radius(const struct hd_index *index);
/* All that lies within `radius_m` (0 to 1e100) of `point_m` (anything finite), each once, in an order that depends on
 * how the index was filled. `near` has room for slot_count of them; `objects` are the records that were put. The number
 * is returned. What lies beyond the radius by no more than rounding may be among them. */
HD_RT uint32_t hd_index_query(const struct hd_index *index, const struct hd_object *objects, const double point_m[2],
                              double radius_m, struct hd_candidate *candidates);

#endif
