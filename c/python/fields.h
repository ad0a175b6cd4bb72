/* Fields in bricks: sample_field, raster_slots (_native.pyi). */
#ifndef TOUCHFIELD_FIELDS_H
#define TOUCHFIELD_FIELDS_H

#include "arguments.h"

#include <math.h>

/* -- trilinear interpolation ------------------------------------------------------------------------------------------ */

typedef struct { /* keys of the bricks, ascending, and the forces [count][8][8][8][3] in them */
    const int64_t *keys;
    const float *forces;
    int64_t count, shape[3], brick_shape[3];
} brick_field;

/* The forces of a brick, or NULL where it has none. */
static inline const float *find_brick(const brick_field *field, int64_t key) {
    int64_t low = 0, high = field->count;
    while (low < high) {
        int64_t middle = (low + high) >> 1;
        if (field->keys[middle] < key)
            low = middle + 1;
        else
            high = middle;
    }
    return low < field->count && field->keys[low] == key ? field->forces + low * 1536 : NULL;
}

/* total += weight * the force of a sample */
static inline void add_sample(const brick_field *field, const int64_t at[3], double weight, double total[3]) {
    int64_t key = ((at[0] >> 3) * field->brick_shape[1] + (at[1] >> 3)) * field->brick_shape[2] + (at[2] >> 3);
    const float *brick = find_brick(field, key);
    if (!brick) return;
    const float *force = brick + 3 * (((at[0] & 7) * 8 + (at[1] & 7)) * 8 + (at[2] & 7));
    for (int n = 0; n < 3; n++) total[n] += weight * (double)force[n];
}

/* The force at a point, in samples; it falls to zero over one spacing beyond the outermost ones. */
static inline void sample_point(const brick_field *field, const double *point, float *out) {
    double total[3] = {0.0, 0.0, 0.0}, fraction[3];
    int64_t first[3], at[3];
    int is_inside = 1;
    for (int n = 0; n < 3; n++) {
        is_inside = is_inside && point[n] > -1.0 && point[n] < (double)field->shape[n];
        double whole = is_inside ? floor(point[n]) : 0.0;
        first[n] = (int64_t)whole, fraction[n] = point[n] - whole;
    }
    for (int corner = 0; is_inside && corner < 8; corner++) {
        double weight = 1.0;
        int is_sample = 1;
        for (int n = 0; n < 3; n++) {
            int is_next = (corner >> (2 - n)) & 1;
            at[n] = first[n] + is_next;
            weight *= is_next ? fraction[n] : 1.0 - fraction[n];
            is_sample = is_sample && at[n] >= 0 && at[n] < field->shape[n];
        }
        if (is_sample && weight != 0.0) add_sample(field, at, weight, total);
    }
    for (int n = 0; n < 3; n++) out[n] = (float)total[n];
}

/* (index, shape, keys, forces, out) */
static PyObject *py_sample_field(PyObject *self, PyObject *arguments) {
    PyObject *index, *shape, *keys, *forces, *out;
    buffer_list arrays = {NULL, 0, 0};
    brick_field field;
    touch_grid grid;
    int64_t points = -1;
    (void)self;
    if (!PyArg_ParseTuple(arguments, "OOOOO", &index, &shape, &keys, &forces, &out) || !read_wide_shape(shape, &grid))
        return NULL;
    for (int n = 0; n < 3; n++) field.shape[n] = grid.shape[n], field.brick_shape[n] = (field.shape[n] + 7) / 8;
    field.count = -1;
    const double *at = (const double *)add_array(&arrays, index, 3 * sizeof(double), &points);
    field.keys = at ? (const int64_t *)add_array(&arrays, keys, sizeof(int64_t), &field.count) : NULL;
    field.forces = field.keys ? (const float *)add_array(&arrays, forces, 1536 * sizeof(float), &field.count) : NULL;
    float *to = field.forces ? (float *)(uintptr_t)add_array(&arrays, out, 3 * sizeof(float), &points) : NULL;
    int is_done = to && (!arrays.view[3].readonly || refuse(TOUCH_ARGUMENT, "an array that is not writable"));
    if (is_done) {
        PyThreadState *state = PyEval_SaveThread();
        for (int64_t n = 0; n < points; n++) sample_point(&field, at + 3 * n, to + 3 * n);
        PyEval_RestoreThread(state);
    }
    release_arrays(&arrays);
    return is_done ? none() : NULL;
}

/* -- order of the samples --------------------------------------------------------------------------------------------- */

typedef struct {
    const int32_t *bricks; /* [count][3], ascending */
    const uint8_t *mask;   /* [count][512] */
    int64_t *out;          /* [size] */
    int64_t count, size, written;
} raster_order;

/* Samples of the bricks start to stop - 1, which have the same x and y, in planes i of x and rows j of y. */
static inline void add_row(raster_order *order, int64_t start, int64_t stop, int64_t i, int64_t j) {
    for (int64_t slot = start; slot < stop; slot++)
        for (int64_t k = 0; k < 8; k++) {
            int64_t index = slot * 512 + i * 64 + j * 8 + k;
            if (order->mask[index] && order->written < order->size) order->out[order->written++] = index;
        }
}

/* The first brick behind `start` and before `stop` that differs from it in x (axis 0) or y (axis 1). */
static inline int64_t end_of_run(const raster_order *order, int64_t start, int64_t stop, int axis) {
    int64_t end = start;
    while (end < stop && order->bricks[3 * end + axis] == order->bricks[3 * start + axis]) end++;
    return end;
}

static inline void write_raster_order(raster_order *order) {
    for (int64_t slab = 0, next; slab < order->count; slab = next) {
        next = end_of_run(order, slab, order->count, 0);
        for (int64_t i = 0; i < 8; i++)
            for (int64_t row = slab, end; row < next; row = end) {
                end = end_of_run(order, row, next, 1);
                for (int64_t j = 0; j < 8; j++) add_row(order, row, end, i, j);
            }
    }
}

/* (bricks, mask, out) */
static PyObject *py_raster_slots(PyObject *self, PyObject *arguments) {
    PyObject *bricks, *mask, *out;
    buffer_list arrays = {NULL, 0, 0};
    raster_order order = {NULL, NULL, NULL, -1, -1, 0};
    (void)self;
    if (!PyArg_ParseTuple(arguments, "OOO", &bricks, &mask, &out)) return NULL;
    order.bricks = (const int32_t *)add_array(&arrays, bricks, 3 * sizeof(int32_t), &order.count);
    order.mask = order.bricks ? (const uint8_t *)add_array(&arrays, mask, 512, &order.count) : NULL;
    order.out = order.mask ? (int64_t *)(uintptr_t)add_array(&arrays, out, sizeof(int64_t), &order.size) : NULL;
    int is_done = order.out && (!arrays.view[2].readonly || refuse(TOUCH_ARGUMENT, "an array that is not writable"));
    if (is_done) {
        PyThreadState *state = PyEval_SaveThread();
        write_raster_order(&order);
        PyEval_RestoreThread(state);
    }
    release_arrays(&arrays);
    return is_done ? none() : NULL;
}

#define FIELDS_METHODS                                     \
    {"sample_field", py_sample_field, METH_VARARGS, NULL}, \
    {"raster_slots", py_raster_slots, METH_VARARGS, NULL}

#endif
