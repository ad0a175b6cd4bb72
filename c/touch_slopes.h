/* touch_slopes.h: how steep a field is: a histogram of the slopes of a force against its own direction. */
#ifndef TOUCH_SLOPES_H
#define TOUCH_SLOPES_H

#include "touch_cells.h"

/* Bin n has the slopes up to 2^((n + 1) / 20) N/m, from 1 to a million; the last one all above. */
enum { TOUCH_SLOPE_BINS = 400, TOUCH_SLOPE_BINS_PER_DOUBLING = 20 };

/* The mean of the eight corners of a cell, and by how much it grows along x, y and z, a sample each. */
TOUCH_INLINE double touch_cell_slope(const float *corner, touch_vector *slope) {
    double total = 0.0;
    *slope = touch_zero();
    for (int c = 0; c < 8; c++) {
        double value = corner[TOUCH_NEXT_X * (c >> 2) + TOUCH_NEXT_Y * (c >> 1 & 1) + TOUCH_NEXT_Z * (c & 1)];
        total += value;
        slope->x += c & 4 ? value : -value, slope->y += c & 2 ? value : -value, slope->z += c & 1 ? value : -value;
    }
    *slope = touch_vector_of(slope->x / 4.0, slope->y / 4.0, slope->z / 4.0);
    return total / 8.0;
}

/* Add to `counts` the cells whose force grows against its own direction, N/m, in the middle of each cell. */
static inline void touch_count_slopes(const float *samples, const uint64_t *supported, int64_t bricks,
                                      touch_vector samples_per_m, int64_t counts[TOUCH_SLOPE_BINS]) {
    for (int64_t n = 0; n < 512 * bricks; n++) {
        int64_t index = n >> 9, i = n >> 6 & 7, j = n >> 3 & 7, k = n & 7;
        if (!touch_is_supported(supported, index, i, j, k)) continue;
        const float *corner = samples + touch_corner_of(index, i, j, k);
        touch_vector slope[3], force;
        force.x = touch_cell_slope(corner, slope), force.y = touch_cell_slope(corner + 1, slope + 1);
        force.z = touch_cell_slope(corner + 2, slope + 2);
        double square = touch_dot(force, force);
        if (!(0.0 < square && square < (double)INFINITY)) continue;
        touch_vector step = {force.x * samples_per_m.x, force.y * samples_per_m.y, force.z * samples_per_m.z};
        double growth = force.x * touch_dot(slope[0], step) + force.y * touch_dot(slope[1], step) +
                        force.z * touch_dot(slope[2], step);
        if (!(growth < -square)) continue; /* less than 1 N/m */
        double bin = (double)TOUCH_SLOPE_BINS_PER_DOUBLING * log2(-growth / square);
        counts[bin < TOUCH_SLOPE_BINS - 1 ? (int64_t)bin : TOUCH_SLOPE_BINS - 1]++;
    }
}

#endif
