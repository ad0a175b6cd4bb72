/* Fields in bricks: sample_field, move_to_level, raster_slots, brick_keys (_native.pyi). */
#ifndef TOUCHFIELD_FIELDS_H
#define TOUCHFIELD_FIELDS_H

#include "query.h"

#include <math.h>

/* -- trilinear interpolation ------------------------------------------------------------------------------------------ */

typedef struct { /* keys of the bricks, ascending, and the forces [count][8][8][8][3] in them */
    const int64_t *keys;
    const float *forces;
    int64_t count, shape[3], brick_shape[3];
} brick_field;

/* The first brick whose key is not below `key`. */
static inline int64_t first_slot(const brick_field *field, int64_t key) {
    int64_t low = 0, high = field->count;
    while (low < high) {
        int64_t middle = (low + high) >> 1;
        if (field->keys[middle] < key)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

/* The forces of a brick, or NULL where it has none. */
static inline const float *find_brick(const brick_field *field, int64_t key) {
    int64_t slot = first_slot(field, key);
    return slot < field->count && field->keys[slot] == key ? field->forces + slot * 1536 : NULL;
}

typedef struct { /* the brick that was found last, as neighbouring samples mostly share theirs */
    int64_t key;
    const float *forces;
} found_brick;

/* total += weight * the force of a sample */
static inline void add_sample(const brick_field *field, const int64_t at[3], double weight, found_brick *brick,
                              double total[3]) {
    int64_t key = ((at[0] >> 3) * field->brick_shape[1] + (at[1] >> 3)) * field->brick_shape[2] + (at[2] >> 3);
    if (key != brick->key) brick->key = key, brick->forces = find_brick(field, key);
    if (!brick->forces) return;
    const float *force = brick->forces + 3 * (((at[0] & 7) * 8 + (at[1] & 7)) * 8 + (at[2] & 7));
    for (int n = 0; n < 3; n++) total[n] += weight * (double)force[n];
}

/* The force at a point, in samples; it falls to zero over one spacing beyond the outermost ones. */
static inline void sample_point(const brick_field *field, const double *point, float *out) {
    double total[3] = {0.0, 0.0, 0.0}, weight[3][2];
    found_brick brick = {-1, NULL};
    int64_t first[3], at[3];
    int is_inside = 1, is_sample[3][2];
    for (int n = 0; n < 3; n++) {
        is_inside = is_inside && point[n] > -1.0 && point[n] < (double)field->shape[n];
        first[n] = !is_inside || point[n] < 0.0 ? -1 : (int64_t)point[n]; /* floor, which x86-64 must call */
        weight[n][1] = point[n] - (double)first[n], weight[n][0] = 1.0 - weight[n][1];
        is_sample[n][0] = first[n] >= 0, is_sample[n][1] = first[n] + 1 < field->shape[n];
    }
    for (int corner = 0; is_inside && corner < 8; corner++) {
        int i = corner >> 2, j = corner >> 1 & 1, k = corner & 1;
        double product = weight[0][i] * weight[1][j] * weight[2][k];
        at[0] = first[0] + i, at[1] = first[1] + j, at[2] = first[2] + k;
        if (is_sample[0][i] && is_sample[1][j] && is_sample[2][k] && product != 0.0)
            add_sample(field, at, product, &brick, total);
    }
    for (int n = 0; n < 3; n++) out[n] = (float)total[n];
}

/* Keys and forces of a field on a grid; 0: an error is raised. */
static inline int add_brick_field(buffer_list *arrays, const touch_grid *grid, PyObject *keys, PyObject *forces,
                                  brick_field *field) {
    for (int n = 0; n < 3; n++) field->shape[n] = grid->shape[n], field->brick_shape[n] = (field->shape[n] + 7) / 8;
    field->count = -1;
    if (!(field->keys = (const int64_t *)add_numbers(arrays, keys, 1, &field->count))) return 0;
    return (field->forces = (const float *)add_array(arrays, forces, 1536 * sizeof(float), &field->count)) != NULL;
}

/* (index, shape, keys, forces, out) */
static PyObject *py_sample_field(PyObject *self, PyObject *arguments) {
    PyObject *index, *shape, *keys, *forces, *out;
    buffer_list arrays = {NULL, 0, 0};
    brick_field field;
    touch_grid grid;
    int64_t points = -1;
    float *to = NULL;
    (void)self;
    if (!PyArg_ParseTuple(arguments, "OOOOO", &index, &shape, &keys, &forces, &out) || !read_wide_shape(shape, &grid))
        return NULL;
    const double *at = (const double *)add_array(&arrays, index, 3 * sizeof(double), &points);
    int is_done = at && add_brick_field(&arrays, &grid, keys, forces, &field) &&
                  (to = (float *)add_output(&arrays, out, 3 * sizeof(float), &points));
    if (is_done) {
        PyThreadState *state = PyEval_SaveThread();
        for (int64_t n = 0; n < points; n++) sample_point(&field, at + 3 * n, to + 3 * n);
        PyEval_RestoreThread(state);
    }
    return done(&arrays, is_done);
}

/* -- points at a level of the force ----------------------------------------------------------------------------------- */

typedef struct {
    brick_field field;
    double spacing_m[3], origin_m[3], level_n, max_move_m;
} level_search;

static inline void force_at_m(const level_search *search, const double *point_m, float *force) {
    double index[3];
    for (int n = 0; n < 3; n++) index[n] = (point_m[n] - search->origin_m[n]) / search->spacing_m[n];
    sample_point(&search->field, index, force);
}

/* Move a point along the force to the level, by the secant method; whether it comes within 2 % of it. */
static inline int move_point(const level_search *search, double *point_m, int64_t rounds) {
    double size = 0.0;
    for (int64_t n = 0; n <= rounds; n++) {
        float force[3], next[3];
        double direction[3], ahead_m[3];
        force_at_m(search, point_m, force);
        for (int a = 0; a < 3; a++) direction[a] = (double)force[a];
        size = sqrt(direction[0] * direction[0] + direction[1] * direction[1] + direction[2] * direction[2]);
        if (n == rounds || size == 0.0) break;
        for (int a = 0; a < 3; a++) {
            direction[a] /= size;
            ahead_m[a] = point_m[a] - search->max_move_m * direction[a];
        }
        force_at_m(search, ahead_m, next);
        double next_size = (double)sqrtf(next[0] * next[0] + next[1] * next[1] + next[2] * next[2]);
        /* at least 1e-9: where the force saturates, only the way outwards is left */
        double per_m = fmax((next_size - size) / search->max_move_m, 1e-9);
        double move_m = fmin(fmax((search->level_n - size) / per_m, -search->max_move_m), search->max_move_m);
        for (int a = 0; a < 3; a++) point_m[a] -= direction[a] * move_m;
    }
    return fabs(size - search->level_n) <= 0.02 * search->level_n;
}

/* (points, shape, spacing_m, origin_m, keys, forces, level_n, max_move_m, rounds, is_met) */
static PyObject *native_move_to_level(PyObject *module, PyObject *arguments) {
    PyObject *points, *shape, *keys, *forces, *is_met;
    long long rounds;
    int64_t count = -1;
    level_search s;
    touch_grid grid;
    uint8_t *met = NULL;
    buffer_list arrays = {NULL, 0, 0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OO(ddd)(ddd)OOddLO", &points, &shape, s.spacing_m, s.spacing_m + 1, s.spacing_m + 2,
                          s.origin_m, s.origin_m + 1, s.origin_m + 2, &keys, &forces, &s.level_n, &s.max_move_m, &rounds,
                          &is_met) ||
        !read_wide_shape(shape, &grid))
        return NULL;
    double *point_m = (double *)add_output(&arrays, points, 3 * sizeof(double), &count);
    int is_done = point_m && add_brick_field(&arrays, &grid, keys, forces, &s.field) &&
                  (met = (uint8_t *)add_output(&arrays, is_met, 1, &count));
    if (is_done) {
        PyThreadState *state = PyEval_SaveThread();
        for (int64_t n = 0; n < count; n++) met[n] = (uint8_t)move_point(&s, point_m + 3 * n, rounds);
        PyEval_RestoreThread(state);
    }
    return done(&arrays, is_done);
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

/* -- bricks within boxes ---------------------------------------------------------------------------------------------- */

/* (spans, brick_shape, out) */
static PyObject *native_brick_keys(PyObject *module, PyObject *arguments) {
    PyObject *spans, *out;
    long long shape[3];
    int64_t boxes = -1, size = -1, written = 0;
    buffer_list arrays = {NULL, 0, 0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "O(LLL)O", &spans, shape, shape + 1, shape + 2, &out)) return NULL;
    const int64_t *span = (const int64_t *)add_numbers(&arrays, spans, 6, &boxes);
    int64_t *key = span ? (int64_t *)add_output(&arrays, out, 8, &size) : NULL;
    if (key) {
        PyThreadState *state = PyEval_SaveThread();
        for (int64_t n = 0; n < boxes; n++, span += 6)
            for (int64_t i = span[0]; i < span[1]; i++)
                for (int64_t j = span[2]; j < span[3]; j++)
                    for (int64_t k = span[4]; k < span[5] && written < size; k++)
                        key[written++] = (i * shape[1] + j) * shape[2] + k;
        PyEval_RestoreThread(state);
    }
    return done(&arrays, key != NULL);
}

/* clang-format off */
#define FIELDS_METHODS \
    {"sample_field", py_sample_field, METH_VARARGS, NULL}, \
    {"move_to_level", native_move_to_level, METH_VARARGS, "Move points along the force to a level."}, \
    {"raster_slots", py_raster_slots, METH_VARARGS, NULL}, \
    {"brick_keys", native_brick_keys, METH_VARARGS, "Keys of the bricks within boxes."}
/* clang-format on */

#endif
