/* Filters of fields in bricks: limit_bricks, resample_bricks (_native.pyi). All sums are in a fixed order, so that the result
   has the same bits on every machine and for any number of threads. */
#ifndef TOUCHFIELD_FILTERS_H
#define TOUCHFIELD_FILTERS_H

#include "fields.h"
#include "query.h"

/* -- clipping --------------------------------------------------------------------------------------------------------- */

/* So that rounding to float never lifts a clipped force above the limit: 1 - 2^-22. */
#define INSIDE_LIMIT (1.0 - 1.0 / 4194304.0)

/* Clip the forces of a brick to a length, and drop those below `floor_n`; whether one is left. */
static inline int limit_brick(const float *force, double max_n, double floor_n, float *out) {
    int has_force = 0;
    for (int n = 0; n < 512; n++, force += 3, out += 3) {
        double x = (double)force[0], y = (double)force[1], z = (double)force[2], square = x * x + y * y + z * z;
        if (square > max_n * max_n) {
            double factor = max_n * INSIDE_LIMIT / sqrt(square);
            x *= factor, y *= factor, z *= factor;
        } else if (square < floor_n * floor_n)
            x = y = z = 0.0;
        out[0] = (float)x, out[1] = (float)y, out[2] = (float)z;
        has_force |= x != 0.0 || y != 0.0 || z != 0.0;
    }
    return has_force;
}

/* (start, stop, forces, force_max_n, floor_n, out, has_force) */
static PyObject *native_limit_bricks(PyObject *module, PyObject *arguments) {
    PyObject *forces, *out, *has_force;
    long long start, stop;
    double max_n, floor_n;
    int64_t count = -1;
    const uint64_t brick_bytes = TOUCH_BRICK_FLOATS * sizeof(float);
    buffer_list arrays = {NULL, 0, 0};
    float *to = NULL;
    uint8_t *is_set = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "LLOddOO", &start, &stop, &forces, &max_n, &floor_n, &out, &has_force)) return NULL;
    const float *from = (const float *)add_array(&arrays, forces, brick_bytes, &count);
    int is_done = from && (to = (float *)add_output(&arrays, out, brick_bytes, &count)) &&
                  (is_set = (uint8_t *)add_output(&arrays, has_force, 1, &count)) && check_range(start, stop, count);
    if (is_done) {
        PyThreadState *state = PyEval_SaveThread();
        for (int64_t n = start; n < stop; n++)
            is_set[n] = (uint8_t)limit_brick(from + n * TOUCH_BRICK_FLOATS, max_n, floor_n, to + n * TOUCH_BRICK_FLOATS);
        PyEval_RestoreThread(state);
    }
    return done(&arrays, is_done);
}

/* -- resampling: three passes over each output brick ------------------------------------------------------------------ */

typedef struct { /* weights of an axis (AxisWeights): of samples first[i] on, for target sample i */
    const int64_t *first;
    const float *weight; /* [count][taps] */
    int64_t count, taps, source_count;
} axis_weights;

typedef struct { /* target samples of an output brick along an axis, and the source samples that they need */
    int64_t start, stop, low, high;
} footprint;

typedef struct {
    brick_field source;
    axis_weights axis[3];
    const int32_t *brick;
    int64_t across, deep; /* most source samples of an output brick along y and z */
    float *after_x;       /* [8][across][3 deep] */
    float *after_y;       /* [8][8][3 deep] */
} resampling;

static inline int64_t min_of(int64_t a, int64_t b) { return a < b ? a : b; }
static inline int64_t max_of(int64_t a, int64_t b) { return a > b ? a : b; }

static inline footprint footprint_of(const axis_weights *axis, int64_t brick) {
    footprint f = {8 * brick, min_of(8 * brick + 8, axis->count), 0, 0};
    f.low = max_of(0, axis->first[f.start]);
    f.high = min_of(axis->source_count, axis->first[f.stop - 1] + axis->taps);
    return f;
}

/* out += weight * from */
static inline void add_weighted(float *out, const float *from, float weight, int64_t count) {
    for (int64_t n = 0; n < count; n++) out[n] += weight * from[n];
}

/* Add what one source brick contributes to the first pass. */
static inline void resample_x(resampling *r, const footprint f[3], const float *source, const int64_t brick[3]) {
    int64_t low[3], high[3];
    for (int a = 0; a < 3; a++) low[a] = max_of(f[a].low, 8 * brick[a]), high[a] = min_of(f[a].high, 8 * brick[a] + 8);
    const axis_weights *axis = r->axis;
    for (int64_t i = f[0].start; i < f[0].stop; i++) {
        int64_t first = axis->first[i], last = min_of(axis->taps, high[0] - first);
        for (int64_t t = max_of(0, low[0] - first); t < last; t++) {
            float weight = axis->weight[i * axis->taps + t];
            if (weight == 0.0f) continue;
            for (int64_t y = low[1]; y < high[1]; y++)
                add_weighted(r->after_x + (((i - f[0].start) * r->across + y - f[1].low) * r->deep + low[2] - f[2].low) * 3,
                             source + ((((first + t) & 7) * 8 + (y & 7)) * 8 + (low[2] & 7)) * 3, weight, (high[2] - low[2]) * 3);
        }
    }
}

static inline void resample_y(resampling *r, const footprint *f, int64_t run) {
    const axis_weights *axis = r->axis + 1;
    for (int64_t i = 0; i < 8; i++)
        for (int64_t j = f->start; j < f->stop; j++) {
            float *out = r->after_y + (i * 8 + j - f->start) * r->deep * 3;
            int64_t first = axis->first[j], last = min_of(axis->taps, f->high - first);
            memset(out, 0, (size_t)run * sizeof *out);
            for (int64_t t = max_of(0, f->low - first); t < last; t++) {
                float weight = axis->weight[j * axis->taps + t];
                if (weight != 0.0f) add_weighted(out, r->after_x + (i * r->across + first + t - f->low) * r->deep * 3, weight, run);
            }
        }
}

/* The forces of one line of samples; whether one is not zero. */
static inline int resample_line(const axis_weights *axis, const footprint *f, const float *line, float *out) {
    int has_force = 0;
    for (int64_t k = f->start; k < f->stop; k++, out += 3) {
        float x = 0.0f, y = 0.0f, z = 0.0f;
        int64_t first = axis->first[k], last = min_of(axis->taps, f->high - first);
        for (int64_t t = max_of(0, f->low - first); t < last; t++) {
            const float *force = line + (first + t - f->low) * 3;
            float weight = axis->weight[k * axis->taps + t];
            x += weight * force[0], y += weight * force[1], z += weight * force[2];
        }
        out[0] = x, out[1] = y, out[2] = z;
        has_force |= x != 0.0f || y != 0.0f || z != 0.0f;
    }
    return has_force;
}

/* Write one output brick, initially zero; whether it has a force. */
static inline int resample_brick(resampling *r, const int32_t *brick, float *out) {
    footprint f[3];
    int64_t at[3];
    int has_source = 0, has_force = 0;
    for (int a = 0; a < 3; a++) {
        f[a] = footprint_of(r->axis + a, brick[a]);
        if (f[a].low >= f[a].high) return 0;
    }
    memset(r->after_x, 0, (size_t)(8 * r->across * r->deep * 3) * sizeof(float));
    for (at[0] = f[0].low >> 3; at[0] < (f[0].high + 7) >> 3; at[0]++)
        for (at[1] = f[1].low >> 3; at[1] < (f[1].high + 7) >> 3; at[1]++) {
            int64_t row = (at[0] * r->source.brick_shape[1] + at[1]) * r->source.brick_shape[2];
            int64_t slot = first_slot(&r->source, row + (f[2].low >> 3)), last = row + ((f[2].high - 1) >> 3);
            for (; slot < r->source.count && r->source.keys[slot] <= last; slot++, has_source = 1) {
                at[2] = r->source.keys[slot] - row;
                resample_x(r, f, r->source.forces + slot * TOUCH_BRICK_FLOATS, at);
            }
        }
    if (!has_source) return 0;
    resample_y(r, f + 1, (f[2].high - f[2].low) * 3);
    for (int64_t i = 0; i < f[0].stop - f[0].start; i++)
        for (int64_t j = 0; j < f[1].stop - f[1].start; j++)
            has_force |= resample_line(r->axis + 2, f + 2, r->after_y + (i * 8 + j) * r->deep * 3, out + (i * 8 + j) * 24);
    return has_force;
}

#define MAX_FIRST ((int64_t)1 << 40) /* so that no index overflows */

/* Most source samples that an output brick needs along an axis; 0: an error is raised. */
static inline int64_t widest_footprint(const axis_weights *axis) {
    int64_t widest = 1;
    for (int64_t n = 0; n < axis->count; n++)
        if (axis->first[n] < -MAX_FIRST || axis->first[n] > MAX_FIRST) return refuse(TOUCH_ARGUMENT, "weights too far away");
    for (int64_t brick = 0; 8 * brick < axis->count; brick++) {
        footprint f = footprint_of(axis, brick);
        widest = max_of(widest, f.high - f.low);
    }
    return widest;
}

/* (first, weights) of an axis; 0: an error is raised. */
static inline int add_axis(buffer_list *arrays, PyObject *object, int64_t source_count, axis_weights *axis) {
    PyObject *first, *weights;
    int64_t values = -1;
    axis->count = -1, axis->source_count = source_count;
    if (!PyArg_ParseTuple(object, "OO", &first, &weights)) return 0;
    if (!(axis->first = (const int64_t *)add_numbers(arrays, first, 1, &axis->count))) return 0;
    if (!(axis->weight = (const float *)add_array(arrays, weights, sizeof(float), &values))) return 0;
    if (axis->count < 1 || values % axis->count) return refuse(TOUCH_ARGUMENT, "weights of another number of samples");
    axis->taps = values / axis->count;
    return 1;
}

/* Source field and weights of the three axes; 0: an error is raised. */
static inline int read_resampling(buffer_list *arrays, PyObject *source, PyObject *weights, resampling *r) {
    PyObject *shape, *keys, *forces, *axes[3];
    touch_grid grid;
    if (!PyArg_ParseTuple(source, "OOO", &shape, &keys, &forces) || !read_wide_shape(shape, &grid)) return 0;
    if (!PyArg_ParseTuple(weights, "OOO", axes, axes + 1, axes + 2) || !add_brick_field(arrays, &grid, keys, forces, &r->source))
        return 0;
    for (int a = 0; a < 3; a++)
        if (!add_axis(arrays, axes[a], grid.shape[a], r->axis + a)) return 0;
    return widest_footprint(r->axis) && (r->across = widest_footprint(r->axis + 1)) &&
           (r->deep = widest_footprint(r->axis + 2));
}

/* Whether all bricks have samples. */
static inline int check_targets(const resampling *r, int64_t count) {
    for (int64_t n = 0; n < 3 * count; n++)
        if (r->brick[n] < 0 || 8 * (int64_t)r->brick[n] >= r->axis[n % 3].count)
            return refuse(TOUCH_ARGUMENT, "a brick that is not there");
    return 1;
}

/* (start, stop, bricks, (shape, keys, forces), ((first, weights),) * 3, out, has_force) */
static PyObject *native_resample_bricks(PyObject *module, PyObject *arguments) {
    PyObject *bricks, *source, *weights, *out, *has_force;
    long long start, stop;
    int64_t count = -1;
    buffer_list arrays = {NULL, 0, 0};
    float *to = NULL;
    uint8_t *is_set = NULL;
    resampling r;
    (void)module;
    memset(&r, 0, sizeof r);
    if (!PyArg_ParseTuple(arguments, "LLOOOOO", &start, &stop, &bricks, &source, &weights, &out, &has_force)) return NULL;
    int is_done = (r.brick = (const int32_t *)add_array(&arrays, bricks, 12, &count)) &&
                  (to = (float *)add_output(&arrays, out, TOUCH_BRICK_FLOATS * sizeof(float), &count)) &&
                  (is_set = (uint8_t *)add_output(&arrays, has_force, 1, &count)) && check_range(start, stop, count) &&
                  read_resampling(&arrays, source, weights, &r) && check_targets(&r, count);
    if (is_done) {
        r.after_x = (float *)malloc((size_t)(24 * (r.across + 8) * r.deep) * sizeof(float));
        r.after_y = r.after_x ? r.after_x + 24 * r.across * r.deep : NULL;
        is_done = r.after_x || fail_for_memory();
    }
    if (is_done) {
        PyThreadState *state = PyEval_SaveThread();
        for (int64_t n = start; n < stop; n++)
            is_set[n] = (uint8_t)resample_brick(&r, r.brick + 3 * n, to + n * TOUCH_BRICK_FLOATS);
        PyEval_RestoreThread(state);
    }
    free(r.after_x);
    return done(&arrays, is_done);
}

/* clang-format off */
#define FILTERS_METHODS \
    {"limit_bricks", native_limit_bricks, METH_VARARGS, "Clip forces, and drop small ones."}, \
    {"resample_bricks", native_resample_bricks, METH_VARARGS, "Bricks of a field through a low-pass."}
/* clang-format on */

#endif
