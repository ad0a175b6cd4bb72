/* touch_cells.h: a lattice of forces in cells, so that a query reads one brick only (touch_cells in touch_receiver.h):
   building it from the bricks of a field, and looking forces up. Nothing is allocated.

       uint64_t bricks = touch_find_cells(&field, NULL, &box, NULL);
       touch_cells *cells = malloc(touch_cells_room(bricks)); // and int32_t brick[bricks][3]
       touch_find_cells(&field, NULL, &box, brick);
       touch_start_cells(cells, &box, brick, bricks, spacing_m, origin_m);
       touch_fill_cells(cells, &box, brick, 0, bricks, &field); // ranges of bricks, in any number of threads */
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

#if defined(__GNUC__)
/* Several components at once, with the same results: a third of the time of a query is interpolation. */
typedef float touch_float_pair __attribute__((vector_size(8)));
typedef double touch_double2 __attribute__((vector_size(16)));

TOUCH_INLINE touch_double2 touch_pair_at(const float *sample) {
    touch_float_pair pair;
    memcpy(&pair, sample, sizeof pair);
    return __builtin_convertvector(pair, touch_double2);
}

typedef float touch_floats __attribute__((vector_size(16)));

TOUCH_INLINE touch_floats touch_floats_at(const float *sample) {
    touch_floats four;
    memcpy(&four, sample, sizeof four);
    return four;
}
#endif

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

/* The same of all three components, in float: in half the time. A fourth number is read behind each sample. */
TOUCH_INLINE void touch_interpolate_float(const float *corner, float x, float y, float z, float out[3]) {
#if defined(__GNUC__)
    touch_floats a = touch_floats_at(corner), b = touch_floats_at(corner + TOUCH_NEXT_Y);
    touch_floats c = touch_floats_at(corner + TOUCH_NEXT_X), d = touch_floats_at(corner + TOUCH_NEXT_X + TOUCH_NEXT_Y);
    a += z * (touch_floats_at(corner + TOUCH_NEXT_Z) - a);
    b += z * (touch_floats_at(corner + TOUCH_NEXT_Y + TOUCH_NEXT_Z) - b);
    c += z * (touch_floats_at(corner + TOUCH_NEXT_X + TOUCH_NEXT_Z) - c);
    d += z * (touch_floats_at(corner + TOUCH_NEXT_X + TOUCH_NEXT_Y + TOUCH_NEXT_Z) - d);
    a += y * (b - a);
    c += y * (d - c);
    a += x * (c - a);
    out[0] = a[0];
    out[1] = a[1];
    out[2] = a[2];
#else
    for (int n = 0; n < 3; n++, corner++) {
        float a = corner[0], b = corner[TOUCH_NEXT_Y], c = corner[TOUCH_NEXT_X], d = corner[TOUCH_NEXT_X + TOUCH_NEXT_Y];
        a += z * (corner[TOUCH_NEXT_Z] - a);
        b += z * (corner[TOUCH_NEXT_Y + TOUCH_NEXT_Z] - b);
        c += z * (corner[TOUCH_NEXT_X + TOUCH_NEXT_Z] - c);
        d += z * (corner[TOUCH_NEXT_X + TOUCH_NEXT_Y + TOUCH_NEXT_Z] - d);
        a += y * (b - a);
        c += y * (d - c);
        out[n] = a + x * (c - a);
    }
#endif
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
    double margin = 2 * TOUCH_ON_PLANE; /* the outermost planes of a box have no force */
    int64_t nx = cells->brick_count[0], ny = cells->brick_count[1], nz = cells->brick_count[2];
    if (!(0.0 <= x && x < 8.0 * (double)nx - margin && 0.0 <= y && y < 8.0 * (double)ny - margin && 0.0 <= z &&
          z < 8.0 * (double)nz - margin))
        return found;
    int64_t i = touch_cell_of(x, &found.fraction.x), j = touch_cell_of(y, &found.fraction.y);
    int64_t k = touch_cell_of(z, &found.fraction.z);
    int64_t index = touch_find_brick(touch_table_of(cells), cells->table_shift, ((i >> 3) * ny + (j >> 3)) * nz + (k >> 3));
    if (index >= 0 && touch_is_supported(touch_supported_of(cells), index, i, j, k))
        found.corner = touch_samples_of(cells) + touch_corner_of(index, i, j, k);
    return found;
}

#if defined(__GNUC__)
TOUCH_INLINE touch_double2 touch_interpolate_pair(const float *corner, double x, double y, double z) {
    touch_double2 a = touch_pair_at(corner), b = touch_pair_at(corner + TOUCH_NEXT_Y), c = touch_pair_at(corner + TOUCH_NEXT_X);
    touch_double2 d = touch_pair_at(corner + TOUCH_NEXT_X + TOUCH_NEXT_Y);
    a += z * (touch_pair_at(corner + TOUCH_NEXT_Z) - a);
    b += z * (touch_pair_at(corner + TOUCH_NEXT_Y + TOUCH_NEXT_Z) - b);
    c += z * (touch_pair_at(corner + TOUCH_NEXT_X + TOUCH_NEXT_Z) - c);
    d += z * (touch_pair_at(corner + TOUCH_NEXT_X + TOUCH_NEXT_Y + TOUCH_NEXT_Z) - d);
    a += y * (b - a);
    c += y * (d - c);
    return a + x * (c - a);
}
#endif

/* The force at a point in cells, newtons, in the frame of the body. */
TOUCH_INLINE touch_vector touch_cell_force(touch_cell_point p) {
    touch_vector f = p.fraction;
    double z = touch_interpolate(p.corner + 2, f.x, f.y, f.z);
#if defined(__GNUC__)
    touch_double2 xy = touch_interpolate_pair(p.corner, f.x, f.y, f.z);
    return touch_vector_of(xy[0], xy[1], z);
#else
    double x = touch_interpolate(p.corner, f.x, f.y, f.z);
    return touch_vector_of(x, touch_interpolate(p.corner + 1, f.x, f.y, f.z), z);
#endif
}

/* -- building --------------------------------------------------------------------------------------------------------- */

typedef struct { /* the bricks of a field, ascending along x, then y, then z; as a decoder has them */
    const int32_t *brick;  /* [bricks][3] */
    const float *forces_n; /* [bricks][8][8][8][3] */
    uint64_t bricks;
} touch_field_bricks;

typedef struct { /* the box around all bricks of cells: their bricks are counted from its corner */
    int32_t corner[3]; /* a brick of the field's lattice; -1 where cells begin before its first sample */
    int64_t count[3];
} touch_cell_box;

enum { TOUCH_BRICK_FLOATS = TOUCH_SIDE * TOUCH_SIDE * TOUCH_SIDE * 3, TOUCH_CELLS_ALIGNMENT = 64 };

/* A number that ascends as bricks do. Each coordinate takes 21 bits, which are enough for 2^24 samples along an axis. */
TOUCH_INLINE int64_t touch_brick_order(int64_t x, int64_t y, int64_t z) {
    return ((x + 1) * ((int64_t)1 << 42)) + ((y + 1) * ((int64_t)1 << 21)) + z + 1;
}

TOUCH_INLINE int touch_has_force(const float *force_n) { return force_n[0] != 0 || force_n[1] != 0 || force_n[2] != 0; }

/* Whether one of the first samples of a brick has a force, along each axis that is set in `corner` (4: x, 2: y, 1: z). */
static inline int touch_has_first_force(const float *brick, int corner) {
    int stop_x = corner & 4 ? 1 : TOUCH_SIDE, stop_y = corner & 2 ? 1 : TOUCH_SIDE, stop_z = corner & 1 ? 1 : TOUCH_SIDE;
    for (int i = 0; i < stop_x; i++)
        for (int j = 0; j < stop_y; j++)
            for (int k = 0; k < stop_z; k++)
                if (touch_has_force(brick + 3 * (64 * i + 8 * j + k))) return 1;
    return 0;
}

typedef struct { /* walks through the bricks of cells that have the bricks of a field as their `corner` (4: x, 2: y, 1: z) */
    const touch_field_bricks *field;
    uint64_t index;
    int corner;
    int64_t order; /* of the brick of cells at hand; INT64_MAX: none is left */
} touch_cell_cursor;

TOUCH_INLINE void touch_cursor_read(touch_cell_cursor *c) {
    const int32_t *brick = c->field->brick + 3 * c->index;
    int dx = c->corner >> 2, dy = c->corner >> 1 & 1, dz = c->corner & 1;
    c->order = c->index == c->field->bricks ? INT64_MAX : touch_brick_order(brick[0] - dx, brick[1] - dy, brick[2] - dz);
}

/* Go on to the next brick whose samples are in cells before it: the first samples along an axis are, too, where they have
   a force. */
static inline void touch_cursor_need(touch_cell_cursor *c) {
    while (c->index < c->field->bricks && c->corner &&
           !touch_has_first_force(c->field->forces_n + TOUCH_BRICK_FLOATS * c->index, c->corner))
        c->index++;
    touch_cursor_read(c);
}

/* The bricks of cells that a field needs: their number, the box around them, and, unless `out` is NULL, the bricks
   themselves, [n][3], ascending. With `paired`, those that either field needs, so that the cells of both have the same
   order. */
static inline uint64_t touch_find_cells(const touch_field_bricks *field, const touch_field_bricks *paired, touch_cell_box *box,
                                        int32_t *out) {
    touch_cell_cursor cursor[16];
    int cursors = paired ? 16 : 8;
    int64_t low[3] = {INT64_MAX, INT64_MAX, INT64_MAX}, high[3] = {INT64_MIN, INT64_MIN, INT64_MIN};
    uint64_t count = 0;
    for (int n = 0; n < cursors; n++) {
        cursor[n].field = n < 8 ? field : paired;
        cursor[n].index = 0;
        cursor[n].corner = n & 7;
        touch_cursor_need(cursor + n);
    }
    for (;; count++) {
        int64_t order = INT64_MAX, mask = ((int64_t)1 << 21) - 1;
        for (int n = 0; n < cursors; n++) order = cursor[n].order < order ? cursor[n].order : order;
        if (order == INT64_MAX) break;
        int64_t at[3] = {(order >> 42) - 1, (order >> 21 & mask) - 1, (order & mask) - 1};
        for (int a = 0; a < 3; a++) {
            low[a] = at[a] < low[a] ? at[a] : low[a];
            high[a] = at[a] > high[a] ? at[a] : high[a];
        }
        for (int a = 0; a < 3 && out; a++) out[3 * count + (uint64_t)a] = (int32_t)(at[a] - box->corner[a]);
        for (int n = 0; n < cursors; n++)
            if (cursor[n].order == order) {
                cursor[n].index++;
                touch_cursor_need(cursor + n);
            }
    }
    for (int a = 0; a < 3 && !out; a++) {
        box->corner[a] = count ? (int32_t)low[a] : 0;
        box->count[a] = count ? high[a] - low[a] + 1 : 0;
    }
    return count;
}

/* Bits of the index of a hash table: at most half of its entries are taken. */
TOUCH_INLINE int touch_table_bits(uint64_t bricks) {
    int bits = 2;
    while (bricks && (4 * bricks - 1) >> bits) bits++;
    return bits;
}

/* Bytes that the cells of so many bricks take. */
static inline uint64_t touch_cells_room(uint64_t bricks) {
    uint64_t table = (uint64_t)16 << touch_table_bits(bricks), samples = 4 * (uint64_t)TOUCH_NEXT_BRICK * bricks;
    uint64_t size = sizeof(touch_cells) + table + 8 * TOUCH_SIDE * bricks + samples + sizeof(float); /* read, not used */
    return (size + TOUCH_CELLS_ALIGNMENT - 1) / TOUCH_CELLS_ALIGNMENT * TOUCH_CELLS_ALIGNMENT;
}

/* Write the header and the hash table of cells, [bricks][3] as touch_find_cells has them, of a lattice with this spacing
   and this position of its first sample, metres. `cells` has touch_cells_room(bricks) bytes, aligned to 8. */
static inline void touch_start_cells(touch_cells *cells, const touch_cell_box *box, const int32_t *brick, uint64_t bricks,
                                     const double spacing_m[3], const double origin_m[3]) {
    int bits = touch_table_bits(bricks);
    uint64_t mask = ((uint64_t)1 << bits) - 1;
    int64_t *table = (int64_t *)(void *)(cells + 1);
    double corner_m[3], reach2_m2 = 0.0;
    memset(cells, 0, sizeof *cells);
    memset(table, 0xff, (size_t)16 << bits);
    for (uint64_t n = 0; n < bricks; n++) {
        const int32_t *b = brick + 3 * n;
        int64_t number = (b[0] * box->count[1] + b[1]) * box->count[2] + b[2];
        uint64_t slot = ((uint64_t)number * TOUCH_HASH_FACTOR) >> (64 - bits);
        while (table[2 * slot] >= 0) slot = (slot + 1) & mask;
        table[2 * slot] = number;
        table[2 * slot + 1] = (int64_t)n;
    }
    for (int a = 0; a < 3; a++) {
        corner_m[a] = spacing_m[a] * (double)(TOUCH_SIDE * (int64_t)box->corner[a]) + origin_m[a];
        double end_m = corner_m[a] + (double)(TOUCH_SIDE * box->count[a]) * spacing_m[a];
        double reach_m = fabs(corner_m[a]) > fabs(end_m) ? fabs(corner_m[a]) : fabs(end_m);
        cells->brick_count[a] = box->count[a];
        reach2_m2 += reach_m * reach_m;
    }
    cells->corner_m = touch_vector_of(corner_m[0], corner_m[1], corner_m[2]);
    cells->samples_per_m = touch_vector_of(1.0 / spacing_m[0], 1.0 / spacing_m[1], 1.0 / spacing_m[2]);
    cells->reach2_m2 = bricks ? 1.000001 * reach2_m2 : -1.0; /* a little more, for the rounding of poses */
    cells->table_shift = 64 - bits;
    cells->table_offset = (int64_t)sizeof *cells;
    cells->supported_offset = cells->table_offset + ((int64_t)16 << bits);
    cells->samples_offset = cells->supported_offset + (int64_t)(8 * TOUCH_SIDE * bricks);
    uint64_t end = (uint64_t)cells->samples_offset + sizeof(float) * TOUCH_NEXT_BRICK * bricks;
    memset((char *)cells + end, 0, (size_t)(touch_cells_room(bricks) - end));
}

/* The first brick of a field that is at or behind a brick of cells, as its `corner`. */
static inline uint64_t touch_lower_bound(const touch_field_bricks *field, int corner, int64_t order) {
    uint64_t low = 0, high = field->bricks;
    while (low < high) {
        touch_cell_cursor middle = {field, (low + high) / 2, corner, 0};
        touch_cursor_read(&middle);
        if (middle.order < order) low = middle.index + 1;
        else high = middle.index;
    }
    return low;
}

/* Bit k: sample k of a row has a force. The bits of three numbers together, without those of their signs. */
TOUCH_INLINE unsigned touch_row_support(const float *row, int samples) {
    unsigned support = 0;
    uint32_t bits[3 * TOUCH_SIDE];
    memcpy(bits, row, (size_t)samples * 3 * sizeof *row);
    for (int k = 0; k < samples; k++)
        support |= (unsigned)((uint32_t)((bits[3 * k] | bits[3 * k + 1] | bits[3 * k + 2]) << 1) != 0) << k;
    return support;
}

/* One brick of cells from the eight bricks of a field that it has samples of, NULL where there is none: its samples and
   those first ones of the next bricks; and which of its cells have a force. */
static inline void touch_fill_brick(const float *const source[8], float *samples, uint64_t supported[8]) {
    unsigned row[TOUCH_SIDE + 1][TOUCH_SIDE + 1];
    for (int i = 0; i <= TOUCH_SIDE; i++)
        for (int j = 0; j <= TOUCH_SIDE; j++) {
            int corner = (i >> 3) * 4 + (j >> 3) * 2, from = 3 * (64 * (i & 7) + 8 * (j & 7));
            const float *own = source[corner], *next = source[corner + 1];
            float *to = samples + i * TOUCH_NEXT_X + j * TOUCH_NEXT_Y;
            row[i][j] = 0;
            if (own) {
                memcpy(to, own + from, 24 * sizeof *to);
                row[i][j] = touch_row_support(own + from, TOUCH_SIDE);
            } else {
                memset(to, 0, 24 * sizeof *to);
            }
            if (next) {
                memcpy(to + 24, next + from, 3 * sizeof *to);
                row[i][j] |= touch_row_support(next + from, 1) << 8;
            } else {
                memset(to + 24, 0, 3 * sizeof *to);
            }
        }
    for (int i = 0; i < TOUCH_SIDE; i++) {
        supported[i] = 0;
        for (int j = 0; j < TOUCH_SIDE; j++) {
            unsigned corners = row[i][j] | row[i][j + 1] | row[i + 1][j] | row[i + 1][j + 1];
            supported[i] |= (uint64_t)((corners | corners >> 1) & 0xff) << (8 * j);
        }
    }
}

/* Write the samples of the bricks of cells from `start` on, before `stop`. Ranges may be written at once. */
static inline void touch_fill_cells(touch_cells *cells, const touch_cell_box *box, const int32_t *brick, uint64_t start,
                                    uint64_t stop, const touch_field_bricks *field) {
    touch_cell_cursor cursor[8];
    float *samples = (float *)(void *)((char *)cells + cells->samples_offset);
    uint64_t *supported = (uint64_t *)(void *)((char *)cells + cells->supported_offset);
    for (uint64_t n = start; n < stop; n++) {
        const float *source[8];
        const int32_t *b = brick + 3 * n, *corner = box->corner;
        int64_t order = touch_brick_order((int64_t)b[0] + corner[0], (int64_t)b[1] + corner[1], (int64_t)b[2] + corner[2]);
        for (int e = 0; e < 8; e++) {
            touch_cell_cursor *c = cursor + e;
            if (n == start) {
                c->field = field;
                c->corner = e;
                c->index = touch_lower_bound(field, e, order);
            }
            if (n == start) touch_cursor_read(c);
            while (c->order < order) {
                c->index++;
                touch_cursor_read(c);
            }
            source[e] = c->order == order ? field->forces_n + TOUCH_BRICK_FLOATS * c->index : NULL;
        }
        touch_fill_brick(source, samples + TOUCH_NEXT_BRICK * n, supported + 8 * n);
    }
}

#endif
