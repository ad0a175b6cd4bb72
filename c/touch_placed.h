/* touch_placed.h: the sum of the forces of objects at their poses in one frame, at points and on a lattice. This is what a
   scene of bodies decodes to, voxel by voxel, so that its arithmetic is part of the format; touch_query.h has the receiver's,
   between frames. */
#ifndef TOUCH_PLACED_H
#define TOUCH_PLACED_H

#include "touch_query.h"

/* A point x of the scene has the coordinates A (x - position) - corner in an object: samples from the corner of its box. */
typedef struct {
    double to_samples[9]; /* A, row by row: rotates and scales */
    double corner[3];     /* samples */
    double position_m[3];
    double rotation[9];   /* scene from body, row by row */
    double damping_n[3], damping_n_per_m[3]; /* velocity and angular velocity of its surface times surface damping */
    double spacing_m[3];
} touch_placement;

typedef struct { /* the box of an object: its bricks, and its hash table within the table of all */
    int64_t brick_count[3], table_start, table_shift;
} touch_placed_box;

typedef struct { /* the cells of all objects, joined */
    int64_t count;
    const touch_placed_box *box;
    const touch_placement *placement;
    const int64_t *table; /* [entries][2], as in touch_cells */
    const float *samples;
    const uint64_t *supported;
    double floor_n, limit_n; /* forces of an object of at most floor_n are none; the sum is clipped to limit_n */
} touch_placed_objects;

/* The placement of an object: its pose is a unit quaternion, w first, and a position; its lattice spacing and corner,
   metres; its motion velocity and angular velocity times surface damping. */
static inline void touch_place_object(const double pose[7], const double lattice[6], const double motion[6],
                                      touch_placement *out) {
    double w = pose[0], x = pose[1], y = pose[2], z = pose[3], *r = out->rotation;
    r[0] = 1.0 - 2.0 * (y * y + z * z);
    r[1] = 2.0 * (x * y - w * z);
    r[2] = 2.0 * (x * z + w * y);
    r[3] = 2.0 * (x * y + w * z);
    r[4] = 1.0 - 2.0 * (x * x + z * z);
    r[5] = 2.0 * (y * z - w * x);
    r[6] = 2.0 * (x * z - w * y);
    r[7] = 2.0 * (y * z + w * x);
    r[8] = 1.0 - 2.0 * (x * x + y * y);
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) out->to_samples[3 * i + j] = r[3 * j + i] / lattice[i];
        out->corner[i] = lattice[3 + i] / lattice[i];
        out->position_m[i] = pose[4 + i];
        out->spacing_m[i] = lattice[i];
        out->damping_n[i] = motion[i];
        out->damping_n_per_m[i] = motion[3 + i];
    }
}

/* -- at points -------------------------------------------------------------------------------------------------------- */

/* Samples from the corner of an object's box; `d` is the point less the object's position. */
TOUCH_INLINE touch_vector touch_placed_samples(const touch_placement *o, touch_vector d) {
    const double *a = o->to_samples;
    return touch_vector_of(a[0] * d.x + a[1] * d.y + a[2] * d.z - o->corner[0],
                           a[3] * d.x + a[4] * d.y + a[5] * d.z - o->corner[1],
                           a[6] * d.x + a[7] * d.y + a[8] * d.z - o->corner[2]);
}

TOUCH_INLINE int touch_is_in_placed_box(const touch_placed_box *box, touch_vector p) {
    const int64_t *count = box->brick_count;
    return 0.0 <= p.x && p.x < 8.0 * (double)count[0] && 0.0 <= p.y && p.y < 8.0 * (double)count[1] && 0.0 <= p.z &&
           p.z < 8.0 * (double)count[2];
}

/* The number of the brick of cells that has a sample (i, j, k) of an object. */
TOUCH_INLINE int64_t touch_box_brick(const touch_placed_box *box, int64_t i, int64_t j, int64_t k) {
    return ((i >> 3) * box->brick_count[1] + (j >> 3)) * box->brick_count[2] + (k >> 3);
}

/* A force in an object's axes at a point of a brick of cells, rotated into the scene, with the damping of its motion. */
TOUCH_INLINE touch_vector touch_placed_force(const touch_placement *o, touch_vector force, touch_vector d) {
    const double *r = o->rotation, *v = o->damping_n, *w = o->damping_n_per_m;
    return touch_vector_of(
        r[0] * force.x + r[1] * force.y + r[2] * force.z + v[0] + w[1] * d.z - w[2] * d.y,
        r[3] * force.x + r[4] * force.y + r[5] * force.z + v[1] + w[2] * d.x - w[0] * d.z,
        r[6] * force.x + r[7] * force.y + r[8] * force.z + v[2] + w[0] * d.y - w[1] * d.x);
}

typedef struct { /* a brick of an object's cells, as the last one looked up */
    int64_t brick, index;
} touch_found_brick;

/* The point p, samples, of an object in its cells; the last brick is looked up once. */
TOUCH_INLINE touch_cell_point touch_placed_point(const touch_placed_objects *all, const touch_placed_box *box, touch_vector p,
                                                 touch_found_brick *last) {
    touch_cell_point found = {NULL, {0.0, 0.0, 0.0}};
    if (!touch_is_in_placed_box(box, p)) return found;
    int64_t i = (int64_t)p.x, j = (int64_t)p.y, k = (int64_t)p.z, brick = touch_box_brick(box, i, j, k);
    if (brick != last->brick) {
        last->brick = brick;
        last->index = touch_find_brick(all->table + 2 * box->table_start, box->table_shift, brick);
    }
    if (last->index < 0 || !touch_is_supported(all->supported, last->index, i, j, k)) return found;
    found.corner = all->samples + touch_corner_of(last->index, i, j, k);
    found.fraction = touch_vector_of(p.x - (double)i, p.y - (double)j, p.z - (double)k);
    return found;
}

/* The square of the distance from an object's position within which its box lies, m^2; a little more, for rounding. */
static inline double touch_placed_reach2(const touch_placement *o, const touch_placed_box *box) {
    double reach2_m2 = 0.0;
    for (int a = 0; a < 3; a++) {
        double corner = o->corner[a], end = corner + 8.0 * (double)box->brick_count[a];
        double reach_m = o->spacing_m[a] * touch_fmax(fabs(corner), fabs(end));
        reach2_m2 += reach_m * reach_m;
    }
    return 1.0001 * reach2_m2;
}

enum { TOUCH_PLACED_REACHES = 64 }; /* objects whose reach is tested before a point is transformed into their axes */

/* The forces at points [start..stop), double [n][3], metres, into float [n][3], newtons. */
static inline void touch_placed_at_points(const touch_placed_objects *all, int64_t start, int64_t stop,
                                          const double *__restrict point_m, float *__restrict out) {
    double floor2_n2 = all->floor_n * all->floor_n, reach2_m2[TOUCH_PLACED_REACHES];
    int64_t reaches = all->count < TOUCH_PLACED_REACHES ? all->count : (int64_t)TOUCH_PLACED_REACHES;
    if (reaches == 1) reaches = 0; /* of one object nothing is saved */
    for (int64_t n = 0; n < reaches; n++) reach2_m2[n] = touch_placed_reach2(all->placement + n, all->box + n);
    for (int64_t p = start; p < stop; p++) {
        touch_vector sum = touch_zero();
        for (int64_t n = 0; n < all->count; n++) {
            const touch_placement *o = all->placement + n;
            const double *x = point_m + 3 * p, *t = o->position_m;
            touch_vector d = touch_vector_of(x[0] - t[0], x[1] - t[1], x[2] - t[2]);
            if (n < reaches && !(touch_dot(d, d) <= reach2_m2[n])) continue;
            touch_found_brick last = {-1, -1};
            touch_cell_point found = touch_placed_point(all, all->box + n, touch_placed_samples(o, d), &last);
            if (!found.corner) continue;
            touch_vector force = touch_cell_force(found);
            if (touch_dot(force, force) > floor2_n2) sum = touch_add(sum, touch_placed_force(o, force, d));
        }
        sum = touch_clipped(sum, all->limit_n);
        out[3 * p] = (float)sum.x;
        out[3 * p + 1] = (float)sum.y;
        out[3 * p + 2] = (float)sum.z;
    }
}

/* -- on a lattice ----------------------------------------------------------------------------------------------------- */

typedef struct { /* the lattice of voxels */
    double origin_m[3], spacing_m[3];
    int64_t shape[3];
} touch_lattice;

typedef struct { /* pairs of a brick of the lattice and an object that may reach it, objects ascending */
    int64_t *pair; /* [capacity][2] */
    int64_t count, capacity, max_pairs;
    int64_t tested; /* bricks so far that were tested */
} touch_reached_bricks;

enum { TOUCH_REACHED, TOUCH_REACHED_TOO_MANY, TOUCH_REACHED_NO_ROOM };

/* How far a brick of cells and a brick of the lattice reach along the axes of the other, samples of the other. */
static inline void touch_brick_reach(const touch_lattice *lattice, const touch_placement *o, double reach[3],
                                     double body_reach[3]) {
    const double rounding = 1e-6;
    for (int a = 0; a < 3; a++) {
        reach[a] = rounding;
        body_reach[a] = 4.0 + rounding;
        for (int b = 0; b < 3; b++) {
            reach[a] += 4.0 * fabs(o->rotation[3 * a + b]) * o->spacing_m[b] / lattice->spacing_m[a];
            body_reach[a] += 3.5 * fabs(o->to_samples[3 * a + b]) * lattice->spacing_m[b];
        }
    }
}

/* The bricks of the lattice around a brick of cells, low to high along each axis; 0: none. */
static inline int touch_bricks_around(const touch_lattice *lattice, const touch_placement *o, const int32_t brick[3],
                                      const double reach[3], int64_t low[3], int64_t high[3]) {
    for (int a = 0; a < 3; a++) {
        double centre = o->position_m[a] - lattice->origin_m[a];
        for (int b = 0; b < 3; b++)
            centre += o->rotation[3 * a + b] * o->spacing_m[b] * (8.0 * brick[b] + 4.0 + o->corner[b]);
        centre /= lattice->spacing_m[a];
        double first = touch_fmax(centre - reach[a], 0.0);
        double last = touch_fmin(centre + reach[a], (double)lattice->shape[a] - 1.0);
        if (!(first <= last)) return 0;
        low[a] = (int64_t)ceil(first) >> 3;
        high[a] = (int64_t)last >> 3;
    }
    return 1;
}

/* Whether a brick of the lattice overlaps a brick of cells along the axes of the object. */
static inline int touch_bricks_meet(const touch_lattice *lattice, const touch_placement *o, const int32_t brick[3],
                                    const double body_reach[3], const int64_t at[3]) {
    double d[3];
    for (int a = 0; a < 3; a++)
        d[a] = lattice->origin_m[a] + (8.0 * (double)at[a] + 3.5) * lattice->spacing_m[a] - o->position_m[a];
    touch_vector p = touch_placed_samples(o, touch_vector_of(d[0], d[1], d[2]));
    return fabs(p.x - 8.0 * brick[0] - 4.0) <= body_reach[0] && fabs(p.y - 8.0 * brick[1] - 4.0) <= body_reach[1] &&
           fabs(p.z - 8.0 * brick[2] - 4.0) <= body_reach[2];
}

/* Add the bricks of the lattice that a brick of cells of object n may reach, each once for an object (`stamp`). */
static inline int touch_add_reached(const touch_lattice *lattice, const touch_placement *o, int64_t n, const int32_t brick[3],
                                    const double reach[3], const double body_reach[3], int32_t *stamp,
                                    touch_reached_bricks *out) {
    int64_t low[3], high[3], at[3], by = (lattice->shape[1] + 7) / 8, bz = (lattice->shape[2] + 7) / 8;
    if (!touch_bricks_around(lattice, o, brick, reach, low, high)) return TOUCH_REACHED;
    out->tested += (high[0] - low[0] + 1) * (high[1] - low[1] + 1) * (high[2] - low[2] + 1);
    if (out->tested > 16 * out->max_pairs || out->count > out->max_pairs) return TOUCH_REACHED_TOO_MANY;
    for (at[0] = low[0]; at[0] <= high[0]; at[0]++)
        for (at[1] = low[1]; at[1] <= high[1]; at[1]++)
            for (at[2] = low[2]; at[2] <= high[2]; at[2]++) {
                int64_t number = (at[0] * by + at[1]) * bz + at[2];
                if (stamp[number] == n + 1 || !touch_bricks_meet(lattice, o, brick, body_reach, at)) continue;
                if (out->count == out->capacity) return TOUCH_REACHED_NO_ROOM;
                stamp[number] = (int32_t)(n + 1);
                out->pair[2 * out->count] = number;
                out->pair[2 * out->count + 1] = n;
                out->count++;
            }
    return TOUCH_REACHED;
}

/* Find the bricks of a lattice that each object may reach. `brick` [n][3] are the bricks of cells, those of object n from
   start[n] on. `stamp` has a zero for each brick of the lattice, and gets the number of the last object there, plus one.
   TOUCH_REACHED_TOO_MANY: more pairs than max_pairs, or more than sixteen times as many tests; a file of few bytes must
   not cost much. TOUCH_REACHED_NO_ROOM: more than the capacity. */
static inline int touch_find_reached(const touch_lattice *lattice, const touch_placed_objects *all, const int64_t *start,
                                     const int32_t *brick, int32_t *stamp, touch_reached_bricks *out) {
    double reach[3], body_reach[3];
    out->count = out->tested = 0;
    for (int64_t n = 0; n < all->count; n++) {
        touch_brick_reach(lattice, all->placement + n, reach, body_reach);
        for (int64_t s = start[n]; s < start[n + 1]; s++) {
            int code = touch_add_reached(lattice, all->placement + n, n, brick + 3 * s, reach, body_reach, stamp, out);
            if (code) return code;
        }
    }
    return out->count > out->max_pairs ? TOUCH_REACHED_TOO_MANY : TOUCH_REACHED;
}

/* Add the forces of object n at the samples of a brick of the lattice to `total`; 1 if there is any. */
static inline int touch_add_to_brick(const touch_placed_objects *all, int64_t n, const touch_lattice *lattice,
                                     const int32_t brick[3], double floor2_n2, double *total) {
    const touch_placement *o = all->placement + n;
    const double *origin = lattice->origin_m, *h = lattice->spacing_m, *a = o->to_samples, *t = o->position_m;
    int64_t first[3] = {8 * (int64_t)brick[0], 8 * (int64_t)brick[1], 8 * (int64_t)brick[2]}, count[3];
    touch_vector step = touch_vector_of(a[2] * h[2], a[5] * h[2], a[8] * h[2]);
    touch_found_brick last = {-1, -1};
    int has_force = 0;
    for (int c = 0; c < 3; c++) count[c] = lattice->shape[c] - first[c] < 8 ? lattice->shape[c] - first[c] : 8;
    double dz = origin[2] + (double)first[2] * h[2] - t[2];
    for (int64_t i = 0; i < count[0]; i++) {
        double dx = origin[0] + (double)(first[0] + i) * h[0] - t[0];
        for (int64_t j = 0; j < count[1]; j++) {
            double dy = origin[1] + (double)(first[1] + j) * h[1] - t[1];
            touch_vector start = touch_placed_samples(o, touch_vector_of(dx, dy, dz));
            for (int64_t k = 0; k < count[2]; k++) {
                touch_cell_point found = touch_placed_point(all, all->box + n, touch_add_scaled(start, (double)k, step), &last);
                if (!found.corner) continue;
                touch_vector force = touch_cell_force(found);
                if (!(touch_dot(force, force) > floor2_n2)) continue;
                force = touch_placed_force(o, force, touch_vector_of(dx, dy, dz + (double)k * h[2]));
                double *sum = total + 3 * (64 * i + 8 * j + k);
                sum[0] += force.x;
                sum[1] += force.y;
                sum[2] += force.z;
                has_force = 1;
            }
        }
    }
    return has_force;
}

/* Write the sum of forces of objects to bricks of the lattice, [n][3], from `start` on, before `stop`: forces
   float [n][8][8][8][3], initially zero, and whether one of a brick is not zero. Brick s gets the forces of
   object[first[s]] to object[first[s + 1] - 1]. */
static inline void touch_fill_lattice(const touch_placed_objects *all, const touch_lattice *lattice, int64_t start,
                                      int64_t stop, const int32_t *brick, const int64_t *first, const int64_t *object,
                                      float *__restrict forces_n, uint8_t *__restrict has_force) {
    double total[TOUCH_BRICK_FLOATS], floor2_n2 = all->floor_n * all->floor_n;
    memset(total, 0, sizeof total);
    for (int64_t s = start; s < stop; s++) {
        int is_reached = 0;
        for (int64_t m = first[s]; m < first[s + 1]; m++)
            is_reached |= touch_add_to_brick(all, object[m], lattice, brick + 3 * s, floor2_n2, total);
        has_force[s] = 0;
        if (!is_reached) continue;
        float *out = forces_n + TOUCH_BRICK_FLOATS * s;
        for (int n = 0; n < TOUCH_BRICK_FLOATS; n += 3) {
            touch_vector sum = touch_vector_of(total[n], total[n + 1], total[n + 2]);
            if (!(sum.x != 0.0 || sum.y != 0.0 || sum.z != 0.0)) continue;
            sum = touch_clipped(sum, all->limit_n);
            out[n] = (float)sum.x;
            out[n + 1] = (float)sum.y;
            out[n + 2] = (float)sum.z;
            has_force[s] |= (uint8_t)touch_has_force(out + n);
        }
        memset(total, 0, sizeof total);
    }
}

#endif
