/* touch_batch.h: forces, gradients and vibrations at many points of an instant, in ranges that threads may work on at once. */
#ifndef TOUCH_BATCH_H
#define TOUCH_BATCH_H

#include "touch_tool.h"

typedef struct {
    const void *memory;
    int64_t before_offset, after_offset; /* frames */
    const double *point_m;               /* [points][3] */
    const double *blend;                 /* of each point, or one of all */
    int64_t blends;
} touch_batch;

TOUCH_INLINE touch_instant touch_batch_instant(const touch_batch *b, int64_t point) {
    double blend = b->blend[point < b->blends ? point : b->blends - 1];
    return touch_instant_of(b->memory, b->before_offset, b->after_offset, blend);
}

TOUCH_INLINE touch_vector touch_batch_point(const touch_batch *b, int64_t point) {
    const double *p = b->point_m + 3 * point;
    return touch_vector_of(p[0], p[1], p[2]);
}

/* touch_force_at, into float [points][3]. */
static inline void touch_forces_at(const touch_batch *b, int64_t start, int64_t stop, float *__restrict out) {
    if (start == stop) return;
    touch_instant t = touch_batch_instant(b, start);
    for (int64_t p = start; p < stop; p++) {
        if (b->blends > 1) t = touch_batch_instant(b, p);
        touch_vector force = touch_inlined_force(&t, touch_batch_point(b, p));
        out[3 * p] = (float)force.x;
        out[3 * p + 1] = (float)force.y;
        out[3 * p + 2] = (float)force.z;
    }
}

/* touch_gradient_at, into double [points][3][3]; zero where a point is not finite. */
static inline void touch_gradients_at(const touch_batch *b, int64_t start, int64_t stop, double *__restrict out) {
    if (start == stop) return;
    touch_instant t = touch_batch_instant(b, start);
    for (int64_t p = start; p < stop; p++) {
        if (b->blends > 1) t = touch_batch_instant(b, p);
        touch_vector point_m = touch_batch_point(b, p);
        touch_matrix gradient = {{{0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}}};
        if (isfinite(point_m.x + point_m.y + point_m.z))
            gradient = touch_inlined_gradient(&t, point_m, touch_inlined_force(&t, point_m));
        for (int row = 0; row < 3; row++) { /* a copy of the matrix as a whole would wait for its numbers to be stored */
            double *to = out + 9 * p + 3 * row;
            to[0] = gradient.row[row].x;
            to[1] = gradient.row[row].y;
            to[2] = gradient.row[row].z;
        }
    }
}

/* touch_vibration_at, into float [points][2]: amplitude and frequency. */
static inline void touch_vibrations_at(const touch_batch *b, int64_t start, int64_t stop, float *__restrict out) {
    for (int64_t p = start; p < stop; p++) {
        touch_instant t = touch_batch_instant(b, p);
        double amplitude_n, frequency_hz;
        touch_vibration_at(&t, touch_batch_point(b, p), &amplitude_n, &frequency_hz);
        out[2 * p] = (float)amplitude_n;
        out[2 * p + 1] = (float)frequency_hz;
    }
}

/* `weight` times the forces of one field that is not rotated, at points [points][3], float [points][3] or, with
   `is_double`, double; written to `out`, float [points][3], or, unless `is_first`, added. The fraction of a cell and what
   follows are in float, in half the time of touch_force_at; the brick of the point before is looked up once. */
TOUCH_INLINE void touch_cell_forces(const touch_cells *cells, double weight, int is_first, int64_t start, int64_t stop,
                                    const void *point_m, int is_double, float *__restrict out) {
    const int64_t *table = touch_table_of(cells);
    const uint64_t *supported = touch_supported_of(cells);
    const float *samples = touch_samples_of(cells);
    touch_vector corner_m = cells->corner_m, per_m = cells->samples_per_m;
    int64_t ny = cells->brick_count[1], nz = cells->brick_count[2], shift = cells->table_shift, brick = -1, index = -1;
    double margin = 2 * TOUCH_ON_PLANE, high_x = 8.0 * (double)cells->brick_count[0] - margin;
    double high_y = 8.0 * (double)ny - margin, high_z = 8.0 * (double)nz - margin, fx, fy, fz;
    for (int64_t p = start; p < stop; p++) {
        const float *f = (const float *)point_m + 3 * p;
        const double *d = (const double *)point_m + 3 * p;
        double x = ((is_double ? d[0] : (double)f[0]) - corner_m.x) * per_m.x;
        double y = ((is_double ? d[1] : (double)f[1]) - corner_m.y) * per_m.y;
        double z = ((is_double ? d[2] : (double)f[2]) - corner_m.z) * per_m.z;
        float force[3] = {0.0f, 0.0f, 0.0f};
        if (0.0 <= x && x < high_x && 0.0 <= y && y < high_y && 0.0 <= z && z < high_z) {
            int64_t i = touch_cell_of(x, &fx), j = touch_cell_of(y, &fy), k = touch_cell_of(z, &fz);
            int64_t own = ((i >> 3) * ny + (j >> 3)) * nz + (k >> 3);
            if (own != brick) {
                brick = own;
                index = touch_find_brick(table, shift, own);
            }
            if (index >= 0 && touch_is_supported(supported, index, i, j, k)) {
                const float *corner = samples + touch_corner_of(index, i, j, k);
                touch_interpolate_float(corner, (float)fx, (float)fy, (float)fz, force);
                for (int c = 0; c < 3; c++) force[c] *= (float)weight;
            }
        }
        for (int c = 0; c < 3; c++) out[3 * p + c] = is_first ? force[c] : out[3 * p + c] + force[c];
    }
}

#endif
