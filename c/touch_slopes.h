/* touch_slopes.h: how steep a field is: a histogram of the slopes of a force against its own direction. */
#ifndef TOUCH_SLOPES_H
#define TOUCH_SLOPES_H

#include "touch_cells.h"

/* Bin n has the slopes up to 2^((n + 1) / 20) N/m, from 1 to a million; the last one all above. */
enum { TOUCH_SLOPE_BINS = 400, TOUCH_SLOPE_BINS_PER_DOUBLING = 20 };

/* The mean of the eight corners of a cell, and by how much it grows along x, y and z, a sample each. */
TOUCH_INLINE double touch_cell_slope(const float *corner, touch_vector *slope) {
    double sum[4], along_z[4]; /* of the two corners along z; of x and y: lower lower, lower upper, upper lower, upper upper */
    for (int c = 0; c < 4; c++) {
        const float *lower = corner + TOUCH_NEXT_X * (c >> 1) + TOUCH_NEXT_Y * (c & 1), *upper = lower + TOUCH_NEXT_Z;
        sum[c] = (double)*upper + (double)*lower;
        along_z[c] = (double)*upper - (double)*lower;
    }
    double lower = sum[0] + sum[1], upper = sum[2] + sum[3];
    slope->x = (upper - lower) / 4.0;
    slope->y = ((sum[1] - sum[0]) + (sum[3] - sum[2])) / 4.0;
    slope->z = ((along_z[0] + along_z[1]) + (along_z[2] + along_z[3])) / 4.0;
    return (lower + upper) / 8.0;
}

/* Add to `counts` the cells whose force grows against its own direction, N/m, in the middle of each cell. */
static inline void touch_count_slopes(const float *samples, const uint64_t *supported, int64_t bricks,
                                      touch_vector samples_per_m, int64_t counts[TOUCH_SLOPE_BINS]) {
    for (int64_t n = 0; n < 512 * bricks; n++) {
        if (!(supported[n >> 6] >> (n & 63) & 1)) continue;
        const float *corner = samples + touch_corner_of(n >> 9, n >> 6, n >> 3, n);
        touch_vector slope[3], force;
        force.x = touch_cell_slope(corner, slope);
        force.y = touch_cell_slope(corner + 1, slope + 1);
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
