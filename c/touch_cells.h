/* touch_cells.h: a lattice of forces in cells, so that a query reads one brick only (touch_cells in touch_receiver.h):
   building it from the bricks of a field, and looking forces up. Nothing is allocated.

       uint64_t bricks = touch_cells_bricks(&field, NULL, &box, NULL);
       void *memory = malloc(touch_cells_room(bricks));         // and int32_t brick[bricks][3]
       touch_cells_bricks(&field, NULL, &box, brick);
       touch_cells_start(memory, &field, &box, brick, bricks);
       touch_cells_fill(memory, &field, &box, brick, 0, bricks); // any ranges, in any number of threads */
#ifndef TOUCH_CELLS_H
#define TOUCH_CELLS_H

#include "touch_receiver.h"

#include <string.h>

enum {
    TOUCH_SIDE = 8,                                 /* samples of a brick along an axis */
    TOUCH_NEXT_Z = 3,                               /* floats from a sample of a brick of cells to the next along z, */
    TOUCH_NEXT_Y = (TOUCH_SIDE + 1) * TOUCH_NEXT_Z, /* y, */
    TOUCH_NEXT_X = (TOUCH_SIDE + 1) * TOUCH_NEXT_Y, /* and x, */
    TOUCH_NEXT_BRICK = (TOUCH_SIDE + 1) * TOUCH_NEXT_X
};

/* Samples: a point this near to a plane of the lattice lies on it, whatever the rounding of its metres. */
#define TOUCH_ON_PLANE 1e-9
/* Fibonacci hashing (Knuth, volume 3, section 6.4): 2^64 over the golden ratio. */
#define TOUCH_HASH_FACTOR UINT64_C(0x9E3779B97F4A7C15)

/* -- looking up ------------------------------------------------------------------------------------------------------- */

/* The index of a brick of cells in a hash table with open addressing; -1: there is none. */
TOUCH_INLINE int64_t touch_find_brick(const int64_t *table, int64_t shift, int64_t brick) {
    uint64_t mask = ((uint64_t)1 << (64 - shift)) - 1, slot = ((uint64_t)brick * TOUCH_HASH_FACTOR) >> shift;
    for (;; slot = (slot + 1) & mask) {
        int64_t found = table[2 * slot];
        if (found == brick) return table[2 * slot + 1];
        if (found < 0) return -1;
    }
}

/* Whether a cell has a force at any of its corners; (i, j, k) counts from the corner of the box. */
TOUCH_INLINE int touch_is_supported(const uint64_t *supported, int64_t index, int64_t i, int64_t j, int64_t k) {
    return supported[8 * index + (i & 7)] >> (8 * (j & 7) + (k & 7)) & 1;
}

/* Where in `samples` the corner of least indices of a cell is. */
TOUCH_INLINE int64_t touch_corner_of(int64_t index, int64_t i, int64_t j, int64_t k) {
    return index * TOUCH_NEXT_BRICK + (i & 7) * TOUCH_NEXT_X + (j & 7) * TOUCH_NEXT_Y + (k & 7) * TOUCH_NEXT_Z;
}

/* One component between the eight corners of a cell, trilinearly. */
TOUCH_INLINE double touch_interpolate(const float *corner, double x, double y, double z) {
    double a = corner[0], b = corner[TOUCH_NEXT_Y], c = corner[TOUCH_NEXT_X], d = corner[TOUCH_NEXT_X + TOUCH_NEXT_Y];
    a += z * (corner[TOUCH_NEXT_Z] - a);
    b += z * (corner[TOUCH_NEXT_Y + TOUCH_NEXT_Z] - b);
    c += z * (corner[TOUCH_NEXT_X + TOUCH_NEXT_Z] - c);
    d += z * (corner[TOUCH_NEXT_X + TOUCH_NEXT_Y + TOUCH_NEXT_Z] - d);
    a += y * (b - a);
    c += y * (d - c);
    return a + x * (c - a);
}

typedef struct { /* a point in cells */
    const float *corner;   /* the force at the corner of least indices of its cell; NULL: there is no force */
    touch_vector fraction; /* of the way through the cell along each axis, 0 to 1 */
} touch_cell_point;

TOUCH_INLINE const int64_t *touch_table_of(const touch_cells *cells) {
    return (const int64_t *)(const void *)((const char *)cells + cells->table_offset);
}

TOUCH_INLINE const uint64_t *touch_supported_of(const touch_cells *cells) {
    return (const uint64_t *)(const void *)((const char *)cells + cells->supported_offset);
}

TOUCH_INLINE const float *touch_samples_of(const touch_cells *cells) {
    return (const float *)(const void *)((const char *)cells + cells->samples_offset);
}

/* The cell along one axis, and the fraction of the way through it; x, samples, is not negative. */
TOUCH_INLINE int64_t touch_cell_of(double x, double *fraction) {
    int64_t i = (int64_t)(x + TOUCH_ON_PLANE);
    double f = x - (double)i;
    *fraction = f > TOUCH_ON_PLANE ? f : 0.0;
    return i;
}

/* A point, metres, in the frame of the field's body. A coordinate that is not finite fails the test of the box. */
TOUCH_INLINE touch_cell_point touch_locate(const touch_cells *cells, touch_vector point_m) {
    touch_cell_point found = {NULL, {0.0, 0.0, 0.0}};
    double x = (point_m.x - cells->corner_m.x) * cells->samples_per_m.x;
    double y = (point_m.y - cells->corner_m.y) * cells->samples_per_m.y;
    double z = (point_m.z - cells->corner_m.z) * cells->samples_per_m.z;
    double near = 2 * TOUCH_ON_PLANE; /* the outermost planes of a box have no force */
    int64_t nx = cells->brick_count[0], ny = cells->brick_count[1], nz = cells->brick_count[2];
    if (!(0.0 <= x && x < 8.0 * (double)nx - near && 0.0 <= y && y < 8.0 * (double)ny - near && 0.0 <= z &&
          z < 8.0 * (double)nz - near))
        return found;
    int64_t i = touch_cell_of(x, &found.fraction.x), j = touch_cell_of(y, &found.fraction.y);
    int64_t k = touch_cell_of(z, &found.fraction.z);
    int64_t index = touch_find_brick(touch_table_of(cells), cells->table_shift, ((i >> 3) * ny + (j >> 3)) * nz + (k >> 3));
    if (index >= 0 && touch_is_supported(touch_supported_of(cells), index, i, j, k))
        found.corner = touch_samples_of(cells) + touch_corner_of(index, i, j, k);
    return found;
}

/* The force at a point in cells, newtons, in the frame of the body. */
TOUCH_INLINE touch_vector touch_cell_force(touch_cell_point p) {
    return touch_vector_of(touch_interpolate(p.corner, p.fraction.x, p.fraction.y, p.fraction.z),
                           touch_interpolate(p.corner + 1, p.fraction.x, p.fraction.y, p.fraction.z),
                           touch_interpolate(p.corner + 2, p.fraction.x, p.fraction.y, p.fraction.z));
}

#endif
