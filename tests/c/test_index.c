/* The index alone: random scenes against distances from corners, edges and long double, far points, huge radii, and
 * slots that change hands many times. */
#include <math.h>
#include <string.h>

#include "hd_test.h"
#include "scene/hd_index.h"
#include "shapes/hd_shape.h"

enum { SLOTS = 10000 };

static const double pi = 3.14159265358979323846;

struct scene {
    struct hd_index index;
    struct hd_object objects[SLOTS];
    struct hd_candidate candidates[SLOTS];
    double found[SLOTS]; /* the distance that a query gave, or less than 0 */
    uint32_t count;
};

static double between(uint64_t *seed, double low, double high) {
    return low + (high - low) * (double)(test_random(seed) >> 11) * 0x1p-53;
}

/* From low to high, every decade as often as any other. */
static double across_decades(uint64_t *seed, double low, double high) {
    return low * pow(high / low, between(seed, 0.0, 1.0));
}

/* ---- Distances, from the definitions ----------------------------------------------------------------------------- */

static long double to_segment(const long double a[2], const long double b[2], const double point[2]) {
    const long double way[2] = {b[0] - a[0], b[1] - a[1]};
    const long double from[2] = {(long double)point[0] - a[0], (long double)point[1] - a[1]};
    const long double square = way[0] * way[0] + way[1] * way[1];
    long double part = square > 0.0L ? (from[0] * way[0] + from[1] * way[1]) / square : 0.0L;

    part = part < 0.0L ? 0.0L : part > 1.0L ? 1.0L : part;
    return hypotl(from[0] - part * way[0], from[1] - part * way[1]);
}

/* A corner of a box, counted around it, or (up = 0) an end of a membrane. */
static void corner_of(const struct hd_object *object, int right, int up, long double corner[2]) {
    const long double n[2] = {(long double)object->normal[0], (long double)object->normal[1]};
    const long double along = right * (long double)object->half_m[0];
    const long double above = up * (long double)object->half_m[1];

    corner[0] = (long double)object->point_m[0] + along * n[1] + above * n[0];
    corner[1] = (long double)object->point_m[1] - along * n[0] + above * n[1];
}

static long double to_box(const struct hd_object *object, const double point[2]) {
    static const int around[5][2] = {{1, 1}, {-1, 1}, {-1, -1}, {1, -1}, {1, 1}};
    long double least = HUGE_VALL;
    int inside = 1;

    for (int i = 0; i < 4; i++) {
        long double a[2];
        long double b[2];
        long double distance;

        corner_of(object, around[i][0], around[i][1], a);
        corner_of(object, around[i + 1][0], around[i + 1][1], b);
        distance = to_segment(a, b, point);
        least = distance < least ? distance : least;
        inside &=
            (b[0] - a[0]) * ((long double)point[1] - a[1]) - (b[1] - a[1]) * ((long double)point[0] - a[0]) >= 0.0L;
    }
    return inside ? 0.0L : least;
}

static long double distance_to(const struct hd_object *object, const double point[2]) {
    const long double from[2] = {(long double)point[0] - (long double)object->point_m[0],
                                 (long double)point[1] - (long double)object->point_m[1]};
    long double a[2];
    long double b[2];
    long double distance;

    switch (object->shape) {
    case HD_SHAPE_WALL:
        distance = from[0] * (long double)object->normal[0] + from[1] * (long double)object->normal[1];
        break;
    case HD_SHAPE_DISC:
        distance = hypotl(from[0], from[1]) - (long double)object->half_m[0];
        break;
    case HD_SHAPE_MEMBRANE:
        corner_of(object, -1, 0, a);
        corner_of(object, 1, 0, b);
        distance = to_segment(a, b, point);
        break;
    case HD_SHAPE_BOX:
        distance = to_box(object, point);
        break;
    default:
        distance = HUGE_VALL;
    }
    return distance > 0.0L ? distance : 0.0L;
}

/* The reference itself, where the answer is plain. The box stands on its corner: its upper face looks up and to the
 * right.
 */
static void knows_distances(void) {
    const struct hd_object box = {.shape = HD_SHAPE_BOX, .normal = {0.6, 0.8}, .half_m = {2.0, 1.0}};
    const struct hd_object membrane = {.shape = HD_SHAPE_MEMBRANE, .normal = {0.0, 1.0}, .half_m = {2.0, 0.0}};

    CHECK(fabsl(distance_to(&box, (double[2]){1.8, 2.4}) - 2.0L) < 1e-15L);  /* over the upper face */
    CHECK(fabsl(distance_to(&box, (double[2]){4.0, -3.0}) - 3.0L) < 1e-15L); /* beside it, along (0.8, -0.6) */
    CHECK(fabsl(distance_to(&box, (double[2]){0.0, 0.0})) == 0.0L);
    CHECK(fabsl(distance_to(&membrane, (double[2]){5.0, 4.0}) - 5.0L) < 1e-15L);
    CHECK(fabsl(distance_to(&membrane, (double[2]){1.0, -3.0}) - 3.0L) < 1e-15L);
}

/* Whatever shape has operations has bounds and a distance in the index, and nothing else is taken into it. */
static void holds_every_shape(void) {
    for (uint32_t shape = 0; shape < HD_SHAPES; shape++)
        CHECK(hd_index_holds(shape) == (hd_shapes[shape] != NULL));
    CHECK(!hd_index_holds(HD_SHAPES));
}

/* ---- Scenes ------------------------------------------------------------------------------------------------------ */

static void put(struct scene *scene, uint32_t slot, const struct hd_object *object) {
    scene->objects[slot] = *object;
    CHECK(hd_index_put(&scene->index, slot, object) == HD_OK);
}

static void empty(struct scene *scene, uint32_t count) {
    hd_index_release(&scene->index);
    CHECK(hd_index_reserve(&scene->index, count) == HD_OK);
    memset(scene->objects, 0, sizeof scene->objects);
    scene->count = count;
}

static struct hd_object shape_at(uint32_t shape, double x, double y, double angle_rad, double half, double other_half) {
    struct hd_object object = {
        .shape = shape, .point_m = {x, y}, .normal = {cos(angle_rad), sin(angle_rad)}, .half_m = {half, other_half}};

    if (shape == HD_SHAPE_DISC) {
        object.normal[0] = 0.0;
        object.normal[1] = 1.0;
        object.half_m[1] = half;
    } else if (shape == HD_SHAPE_MEMBRANE) {
        object.half_m[1] = 0.0;
    } else if (shape == HD_SHAPE_WALL) {
        object.half_m[0] = object.half_m[1] = 0.0;
    }
    return object;
}

/* Any shape of 0.1 mm to `largest_m`, within `spread_m` of the middle; now and then exactly there, or turned by a
 * multiple of the angle at which sectors begin. */
static struct hd_object any_object(uint64_t *seed, const double middle[2], double spread_m, double largest_m) {
    const double spread = test_below(seed, 10) == 0 ? 0.0 : spread_m;
    const double angle = test_below(seed, 4) == 0
                             ? 2.0 * pi * (double)test_below(seed, HD_INDEX_SECTORS) / HD_INDEX_SECTORS
                             : between(seed, -pi, pi);
    const uint32_t shape = (uint32_t)test_below(seed, 5);
    const double x = middle[0] + between(seed, -spread, spread);
    const double y = middle[1] + between(seed, -spread, spread);
    const double half = across_decades(seed, 0.5e-4, 0.5 * largest_m);

    return shape_at(shape, x, y, angle, half, across_decades(seed, 0.5e-4, 0.5 * largest_m));
}

/* ---- What a query must give ----------------------------------------------------------------------------------------
 */

/* Rounding moves a distance by so much at most. */
static long double rounding_at(const double point[2]) {
    return 1e-14L * (100.0L + fabsl((long double)point[0]) + fabsl((long double)point[1]));
}

static uint32_t check_query(struct scene *scene, double x, double y, double radius) {
    const double point[2] = {x, y};
    const long double rounding = rounding_at(point);
    const uint32_t count = hd_index_query(&scene->index, scene->objects, point, radius, scene->candidates);

    CHECK(count <= scene->count);
    for (uint32_t slot = 0; slot < scene->count; slot++)
        scene->found[slot] = -1.0;
    for (uint32_t i = 0; i < count; i++) {
        CHECK(scene->candidates[i].slot < scene->count);
        CHECK(scene->found[scene->candidates[i].slot] < 0.0); /* not yet */
        CHECK(scene->candidates[i].distance_m >= 0.0 && scene->candidates[i].distance_m <= radius);
        scene->found[scene->candidates[i].slot] = scene->candidates[i].distance_m;
    }
    for (uint32_t slot = 0; slot < scene->count; slot++) {
        const long double found = (long double)scene->found[slot];
        const long double distance = distance_to(&scene->objects[slot], point);

        if (found < 0.0L)
            CHECK(distance > (long double)radius);
        else
            CHECK(found <= distance && distance <= found + rounding);
    }
    return count;
}

static void check_far_queries(struct scene *scene) {
    static const double far[] = {1e3, -1e5, 3e5, 1e9, -1e18, 1e154, -1e300, 1.7e308, -1.7e308, 5e-324, -0.0};
    enum { FAR = sizeof far / sizeof far[0] };

    for (size_t i = 0; i < FAR; i++)
        for (size_t j = 0; j < FAR; j++)
            check_query(scene, far[i], far[j], i % 2 ? 0.01 : 1.0);
}

static void queries_what_is_random(struct scene *scene, uint64_t seed, uint32_t count, double spread_m,
                                   double largest_m, int rounds) {
    double middle[2] = {0.0, 0.0};
    uint32_t reserved = count / 7 + 1;

    empty(scene, reserved);
    for (int round = 0; round < rounds; round++) {
        const uint32_t puts = round == 0 ? count : (uint32_t)test_below(&seed, count / 10 + 2);

        /* The scene grows a few times, with what it holds. */
        if (round > 0 && scene->count < count) {
            reserved = scene->count * 2 + 1 < count ? scene->count * 2 + 1 : count;
            CHECK(hd_index_reserve(&scene->index, reserved) == HD_OK);
            CHECK(hd_index_reserve(&scene->index, 1) == HD_OK);
            CHECK(scene->index.slot_count == reserved);
            scene->count = reserved;
        }
        for (uint32_t i = 0; i < puts; i++) {
            const struct hd_object object = any_object(&seed, middle, spread_m, largest_m);

            if (test_below(&seed, 20) == 0) {
                middle[0] = between(&seed, spread_m - 10.0, 10.0 - spread_m);
                middle[1] = between(&seed, spread_m - 10.0, 10.0 - spread_m);
            }
            put(scene, (uint32_t)test_below(&seed, scene->count), &object);
        }
        for (int i = 0; i < 4; i++) {
            const struct hd_object *object = &scene->objects[test_below(&seed, scene->count)];
            const double aside = across_decades(&seed, 1e-5, 3.0);
            const double radius = i == 0 ? 0.0 : across_decades(&seed, 1e-6, 1.0);

            check_query(scene, object->point_m[0] + between(&seed, -aside, aside),
                        object->point_m[1] + between(&seed, -aside, aside), radius);
            check_query(scene, object->point_m[0], object->point_m[1], radius);
        }
        check_query(scene, between(&seed, -12.0, 12.0), between(&seed, -12.0, 12.0), hd_index_radius(&scene->index));
    }
    check_query(scene, 1.0, -2.0, 1e9); /* more cells than anybody could visit */
    check_far_queries(scene);
    for (uint32_t slot = 0; slot < scene->count; slot++)
        put(scene, slot, &(struct hd_object){0});
    CHECK(check_query(scene, 0.0, 0.0, 1e100) == 0);
}

/* One on another, so that they share a cell, a chain or an offset. */
static void holds_equals(struct scene *scene) {
    for (uint32_t shape = HD_SHAPE_WALL; shape <= HD_SHAPE_DISC; shape++) {
        const struct hd_object object = shape_at(shape, 0.02, -0.03, 1.0, 0.0005, 0.0007);
        uint64_t seed = shape;

        empty(scene, 300);
        for (uint32_t slot = 0; slot < scene->count; slot++)
            put(scene, slot, &object);
        CHECK(check_query(scene, 0.02, -0.03, 0.0) == 300);
        for (uint32_t left = 300; left > 0; left--) {
            uint32_t slot = (uint32_t)test_below(&seed, 300);

            while (scene->objects[slot].shape == HD_SHAPE_NONE)
                slot = (slot + 1) % 300;
            put(scene, slot, &(struct hd_object){0});
            CHECK(check_query(scene, 0.0201, -0.03, 0.001) == left - 1);
        }
    }
}

/* Discs so that there is one in each cell, or one at each edge between cells, also far out. */
static void meets_edges_of_cells(struct scene *scene) {
    static const double starts[] = {-0.05, -10.0, 9.9, 3e5, -3e5, 1e9};

    for (size_t start = 0; start < sizeof starts / sizeof starts[0]; start++) {
        empty(scene, 50 * 50);
        for (uint32_t slot = 0; slot < scene->count; slot++) {
            const struct hd_object object = shape_at(HD_SHAPE_DISC, starts[start] + 0.002 * (slot % 50),
                                                     0.002 * (slot / 50) - 0.05, 0.0, 0.001, 0.001);
            put(scene, slot, &object);
        }
        for (int i = -4; i < 8; i++)
            for (int j = -4; j < 8; j++)
                check_query(scene, starts[start] + 0.05 + 0.0005 * i, 0.0005 * j, 0.0005 * (i + j > 0 ? i + j : 0));
    }
}

/* The nth of the stacked walls is at height n mm; over 9.9965 m there are three. */
static void stacks_walls(struct scene *scene) {
    for (int turn = 0; turn < 16; turn++) {
        const double angle = turn * pi / 8.0 + (turn % 2 ? 0.01 : 0.0);
        const double n[2] = {cos(angle), sin(angle)};
        const double height = 9.9965;

        empty(scene, SLOTS);
        for (uint32_t slot = 0; slot < SLOTS; slot++) {
            /* Not in the order of their heights, and each meant by a point of its own. */
            const double h = 0.001 * (double)((slot * 7919u) % SLOTS);
            const double s = 0.001 * (double)slot - 5.0;
            const struct hd_object object =
                shape_at(HD_SHAPE_WALL, h * n[0] + s * n[1], h * n[1] - s * n[0], angle, 0.0, 0.0);

            put(scene, slot, &object);
        }
        for (int s = -2; s <= 2; s++) {
            const double x = height * n[0] + s * n[1];
            const double y = height * n[1] - s * n[0];

            CHECK(check_query(scene, x, y, 0.0) == 3);
            CHECK(check_query(scene, x, y, 0.01) == 13);
            CHECK(check_query(scene, x + n[0], y + n[1], 0.01) == 0);
        }
    }
}

/* A polygon of many sides, seen from within and from without. */
static void surrounds_with_walls(struct scene *scene) {
    uint64_t seed = 5;

    empty(scene, 6400); /* 100 in a sector, the first of them exactly on its edge */
    for (uint32_t slot = 0; slot < scene->count; slot++) {
        const double angle = 2.0 * pi * slot / scene->count;
        const struct hd_object object =
            shape_at(HD_SHAPE_WALL, 1.0 - 0.15 * cos(angle), 2.0 - 0.15 * sin(angle), angle, 0.0, 0.0);

        put(scene, slot, &object);
    }
    CHECK(check_query(scene, 1.0, 2.0, 0.149) == 0);
    CHECK(check_query(scene, 1.0, 2.0, 0.151) == scene->count);
    for (int i = 0; i < 50; i++) {
        const double angle = between(&seed, -pi, pi);
        const double out = between(&seed, 0.14, 0.16);

        check_query(scene, 1.0 + out * cos(angle), 2.0 + out * sin(angle), across_decades(&seed, 1e-4, 0.02));
    }
    check_far_queries(scene);
}

static void suggests_a_radius(struct scene *scene) {
    const struct hd_object wall = shape_at(HD_SHAPE_WALL, 0.0, 0.0, 0.0, 0.0, 0.0);
    const struct hd_object large = shape_at(HD_SHAPE_BOX, 0.0, 0.0, 0.0, 1.0, 1.0);
    const struct hd_object small = shape_at(HD_SHAPE_DISC, 0.0, 0.0, 0.0, 0.001, 0.0);
    double alone;

    empty(scene, 3);
    put(scene, 0, &wall);
    alone = hd_index_radius(&scene->index);
    CHECK(alone > 0.0);
    put(scene, 1, &large);
    CHECK(hd_index_radius(&scene->index) > 0.0 && hd_index_radius(&scene->index) <= alone);
    put(scene, 2, &small);
    CHECK(hd_index_radius(&scene->index) > 0.0 && hd_index_radius(&scene->index) <= 0.001);
    put(scene, 2, &large);
    put(scene, 1, &wall);
    put(scene, 2, &wall);
    CHECK(!(hd_index_radius(&scene->index) < alone));
}

static void takes_nothing(struct scene *scene) {
    const double point[2] = {0.0, 0.0};

    hd_index_release(&scene->index);
    CHECK(hd_index_reserve(&scene->index, 0) == HD_OK);
    CHECK(hd_index_radius(&scene->index) > 0.0);
    CHECK(hd_index_query(&scene->index, scene->objects, point, 1.0, scene->candidates) == 0);
    hd_index_release(&scene->index);
}

int main(void) {
    static struct scene scene;

    knows_distances();
    holds_every_shape();
    takes_nothing(&scene);
    suggests_a_radius(&scene);
    holds_equals(&scene);
    meets_edges_of_cells(&scene);
    stacks_walls(&scene);
    surrounds_with_walls(&scene);
    queries_what_is_random(&scene, 1, 3, 0.01, 0.01, 200);
    queries_what_is_random(&scene, 2, 40, 0.05, 0.1, 200);
    queries_what_is_random(&scene, 3, 500, 0.2, 20.0, 60);
    queries_what_is_random(&scene, 4, 500, 10.0, 20.0, 60);
    queries_what_is_random(&scene, 5, SLOTS, 0.1, 0.005, 12);
    queries_what_is_random(&scene, 6, SLOTS, 10.0, 1.0, 12);
    hd_index_release(&scene.index);
    printf("test_index: ok\n");
    return 0;
}
