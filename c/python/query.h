/* Queries of a field, and what they need: cells, placed objects and blends (_native.pyi). */
#ifndef TOUCHFIELD_QUERY_H
#define TOUCHFIELD_QUERY_H

#include "../touch_batch.h"
#include "../touch_placed.h"
#include "../touch_segment_blend.h"
#include "arguments.h"

/* -- arguments -------------------------------------------------------------------------------------------------------- */

static inline int is_aligned(const void *address, size_t bytes) { return (uintptr_t)address % bytes == 0; }

/* As add_array, of a writable array. */
static inline void *add_output(buffer_list *list, PyObject *object, uint64_t item_bytes, int64_t *count) {
    const void *items = add_array(list, object, item_bytes, count);
    if (!items || !list->view[list->count - 1].readonly) return (void *)(uintptr_t)items;
    return fail(TOUCH_ARGUMENT, "an array that is not writable");
}

/* As add_array, of numbers of eight bytes. */
static inline const void *add_numbers(buffer_list *list, PyObject *object, int64_t columns, int64_t *count) {
    const void *items = add_array(list, object, (uint64_t)(8 * columns), count);
    if (!items || !*count || is_aligned(items, 8)) return items;
    return fail(TOUCH_ARGUMENT, "numbers that are not aligned");
}

static inline int check_range(int64_t start, int64_t stop, int64_t count) {
    return (0 <= start && start <= stop && stop <= count) || refuse(TOUCH_ARGUMENT, "a range outside of an array");
}

/* Whether something of so many bytes may lie at an offset of the memory. */
static inline int check_offset(const Py_buffer *memory, int64_t offset, size_t bytes) {
    if (is_aligned(memory->buf, 8) && offset >= 0 && offset % 8 == 0 && offset <= memory->len - (Py_ssize_t)bytes) return 1;
    return refuse(TOUCH_ARGUMENT, "an offset outside of the memory");
}

/* None for a function that is done, with its arrays released; NULL if an error was raised. */
static inline PyObject *done(buffer_list *arrays, int is_done) {
    release_arrays(arrays);
    return is_done ? none() : NULL;
}

/* -- one point -------------------------------------------------------------------------------------------------------- */

typedef struct { /* (memory, before, after, blend, x, y, z) */
    Py_buffer memory;
    touch_instant instant;
    touch_vector point_m;
} point_query;

/* 0: an error is raised; else the caller releases `memory`. */
static inline int read_point_query(PyObject *const *arguments, Py_ssize_t count, point_query *q) {
    int64_t frame[2];
    double numbers[4];
    if (!expect_arguments(count, 7) || !read_integers(arguments + 1, 2, frame) || !read_doubles(arguments + 3, 4, numbers) ||
        PyObject_GetBuffer(arguments[0], &q->memory, PyBUF_SIMPLE))
        return 0;
    if (check_offset(&q->memory, frame[0], sizeof(touch_frame_header)) &&
        check_offset(&q->memory, frame[1], sizeof(touch_frame_header))) {
        q->instant = touch_instant_of(q->memory.buf, frame[0], frame[1], numbers[0]);
        q->point_m = touch_vector_of(numbers[1], numbers[2], numbers[3]);
        return 1;
    }
    PyBuffer_Release(&q->memory);
    return 0;
}

static PyObject *native_force_at(PyObject *module, PyObject *const *arguments, Py_ssize_t count) {
    point_query q;
    (void)module;
    if (!read_point_query(arguments, count, &q)) return NULL;
    touch_vector force = touch_force_at(&q.instant, q.point_m);
    PyBuffer_Release(&q.memory);
    return tuple_of(&force.x, 3);
}

static PyObject *native_vibration_at(PyObject *module, PyObject *const *arguments, Py_ssize_t count) {
    point_query q;
    double both[2];
    (void)module;
    if (!read_point_query(arguments, count, &q)) return NULL;
    touch_vibration_at(&q.instant, q.point_m, both, both + 1);
    PyBuffer_Release(&q.memory);
    return tuple_of(both, 2);
}

static PyObject *native_strongest_body(PyObject *module, PyObject *const *arguments, Py_ssize_t count) {
    point_query q;
    (void)module;
    if (!read_point_query(arguments, count, &q)) return NULL;
    int64_t body = touch_strongest_body(&q.instant, q.point_m);
    PyBuffer_Release(&q.memory);
    return PyLong_FromLongLong(body);
}

static PyObject *native_tool_force(PyObject *module, PyObject *const *arguments, Py_ssize_t count) {
    point_query q;
    touch_vector both[2];
    PyObject *result = NULL;
    (void)module;
    if (!read_point_query(arguments, count, &q)) return NULL;
    if (check_offset(&q.memory, 0, sizeof(touch_receiver))) {
        both[0] = touch_tool_force((const touch_receiver *)q.memory.buf, &q.instant, q.point_m, both + 1);
        result = tuple_of(&both[0].x, 6);
    }
    PyBuffer_Release(&q.memory);
    return result;
}

/* -- many points ------------------------------------------------------------------------------------------------------ */

typedef struct { /* (start, stop, memory, before, after, points, blends, out) */
    touch_batch batch;
    int64_t start, stop;
    void *out;
    buffer_list arrays;
} batch_call;

/* 0: an error is raised. */
static inline int read_batch(PyObject *arguments, int64_t out_bytes, batch_call *call) {
    PyObject *memory, *points, *blends, *out;
    long long start, stop, before, after;
    int64_t size = -1, count = -1, outs;
    touch_batch *b = &call->batch;
    memset(call, 0, sizeof *call);
    if (!PyArg_ParseTuple(arguments, "LLOLLOOO", &start, &stop, &memory, &before, &after, &points, &blends, &out)) return 0;
    call->start = start, call->stop = stop, b->before_offset = before, b->after_offset = after, b->blends = -1;
    if (!(b->memory = add_array(&call->arrays, memory, 1, &size))) return 0;
    const Py_buffer *view = call->arrays.view;
    if (!check_offset(view, before, sizeof(touch_frame_header)) || !check_offset(view, after, sizeof(touch_frame_header)) ||
        !(b->point_m = (const double *)add_numbers(&call->arrays, points, 3, &count)) ||
        !(b->blend = (const double *)add_numbers(&call->arrays, blends, 1, &b->blends)))
        return 0;
    outs = count;
    if (b->blends != 1 && b->blends != count) return refuse(TOUCH_ARGUMENT, "blends of another number of points");
    return (call->out = add_output(&call->arrays, out, (uint64_t)out_bytes, &outs)) && check_range(start, stop, count);
}

static PyObject *native_forces_at(PyObject *module, PyObject *arguments) {
    batch_call call;
    (void)module;
    int is_read = read_batch(arguments, 3 * sizeof(float), &call);
    if (is_read) {
        PyThreadState *state = PyEval_SaveThread();
        touch_forces_at(&call.batch, call.start, call.stop, (float *)call.out);
        PyEval_RestoreThread(state);
    }
    return done(&call.arrays, is_read);
}

static PyObject *native_gradients_at(PyObject *module, PyObject *arguments) {
    batch_call call;
    (void)module;
    int is_read = read_batch(arguments, 9 * sizeof(double), &call);
    if (is_read) {
        PyThreadState *state = PyEval_SaveThread();
        touch_gradients_at(&call.batch, call.start, call.stop, (double *)call.out);
        PyEval_RestoreThread(state);
    }
    return done(&call.arrays, is_read);
}

static PyObject *native_vibrations_at(PyObject *module, PyObject *arguments) {
    batch_call call;
    (void)module;
    int is_read = read_batch(arguments, 2 * sizeof(float), &call);
    if (is_read) {
        PyThreadState *state = PyEval_SaveThread();
        touch_vibrations_at(&call.batch, call.start, call.stop, (float *)call.out);
        PyEval_RestoreThread(state);
    }
    return done(&call.arrays, is_read);
}

static PyObject *native_cell_forces(PyObject *module, PyObject *arguments) {
    PyObject *memory, *points, *out;
    long long start, stop, offset;
    int is_first, is_done = 0;
    double weight;
    int64_t size = -1, count = -1, floats = -1;
    buffer_list arrays;
    (void)module;
    memset(&arrays, 0, sizeof arrays);
    if (!PyArg_ParseTuple(arguments, "LLOLdpOO", &start, &stop, &memory, &offset, &weight, &is_first, &points, &out))
        return NULL;
    const char *base = (const char *)add_array(&arrays, memory, 1, &size);
    const void *point_m = base ? add_array(&arrays, points, 3 * sizeof(float), &floats) : NULL;
    float *force_n = point_m ? (float *)add_output(&arrays, out, 3 * sizeof(float), &count) : NULL;
    int is_double = floats == 2 * count;
    if (force_n && !is_double && floats != count) refuse(TOUCH_ARGUMENT, "points that are neither float32 nor float64");
    else if (force_n && is_double && count && !is_aligned(point_m, 8)) refuse(TOUCH_ARGUMENT, "points that are not aligned");
    else if (force_n && check_range(start, stop, count) && check_offset(arrays.view, offset, sizeof(touch_cells))) {
        const touch_cells *cells = (const touch_cells *)(const void *)(base + offset);
        PyThreadState *state = PyEval_SaveThread();
        if (is_double) touch_cell_forces(cells, weight, is_first, start, stop, point_m, 1, force_n);
        else touch_cell_forces(cells, weight, is_first, start, stop, point_m, 0, force_n);
        PyEval_RestoreThread(state);
        is_done = 1;
    }
    return done(&arrays, is_done);
}

/* -- cells ------------------------------------------------------------------------------------------------------------ */

/* Bricks int32 [n][3] and forces float [n][8][8][8][3]; 0: an error is raised. */
static inline int add_field(buffer_list *arrays, PyObject *bricks, PyObject *forces, touch_field_bricks *field) {
    int64_t count = -1;
    if (!(field->brick = (const int32_t *)add_array(arrays, bricks, 3 * sizeof(int32_t), &count))) return 0;
    field->bricks = (uint64_t)count;
    return (field->forces_n = (const float *)add_array(arrays, forces, TOUCH_BRICK_FLOATS * sizeof(float), &count)) != NULL;
}

static PyObject *native_find_cells(PyObject *module, PyObject *arguments) {
    PyObject *bricks, *forces, *paired_bricks, *paired_forces, *result = NULL;
    touch_field_bricks field, paired;
    touch_cell_box box;
    buffer_list arrays;
    void *out;
    (void)module;
    memset(&arrays, 0, sizeof arrays);
    if (!PyArg_ParseTuple(arguments, "OOOO", &bricks, &forces, &paired_bricks, &paired_forces)) return NULL;
    int is_paired = !is_none(paired_bricks);
    if (add_field(&arrays, bricks, forces, &field) &&
        (!is_paired || add_field(&arrays, paired_bricks, paired_forces, &paired))) {
        PyThreadState *state = PyEval_SaveThread();
        uint64_t count = touch_find_cells(&field, is_paired ? &paired : NULL, &box, NULL);
        PyEval_RestoreThread(state);
        PyObject *found = new_bytes(12 * count, &out);
        if (found) {
            state = PyEval_SaveThread();
            touch_find_cells(&field, is_paired ? &paired : NULL, &box, (int32_t *)out);
            PyEval_RestoreThread(state);
            result = Py_BuildValue("N(iii)(LLL)L", found, box.corner[0], box.corner[1], box.corner[2], (long long)box.count[0],
                                   (long long)box.count[1], (long long)box.count[2], (long long)touch_cells_room(count));
        }
    }
    release_arrays(&arrays);
    return result;
}

/* The box (corner, count) of cells; 0: an error is raised. */
static inline int read_box(PyObject *corner, PyObject *count, touch_cell_box *box) {
    long long n[3];
    if (!PyArg_ParseTuple(corner, "iii", box->corner, box->corner + 1, box->corner + 2) ||
        !PyArg_ParseTuple(count, "LLL", n, n + 1, n + 2))
        return 0;
    for (int a = 0; a < 3; a++) box->count[a] = n[a];
    return 1;
}

/* Writable memory that is large enough for the cells of so many bricks; NULL: an error is raised. */
static inline touch_cells *add_cells(buffer_list *arrays, PyObject *memory, int64_t bricks) {
    int64_t size = (int64_t)touch_cells_room((uint64_t)bricks);
    void *cells = add_output(arrays, memory, 1, &size);
    if (!cells || is_aligned(cells, 8)) return (touch_cells *)cells;
    return (touch_cells *)(void *)fail(TOUCH_ARGUMENT, "memory that is not aligned");
}

static PyObject *native_start_cells(PyObject *module, PyObject *arguments) {
    PyObject *memory, *corner, *box_count, *cell_bricks;
    double spacing_m[3], origin_m[3];
    int64_t count = -1;
    touch_cell_box box;
    buffer_list arrays;
    touch_cells *cells = NULL;
    (void)module;
    memset(&arrays, 0, sizeof arrays);
    if (!PyArg_ParseTuple(arguments, "OOOO(ddd)(ddd)", &memory, &corner, &box_count, &cell_bricks, spacing_m, spacing_m + 1,
                          spacing_m + 2, origin_m, origin_m + 1, origin_m + 2) ||
        !read_box(corner, box_count, &box))
        return NULL;
    const int32_t *brick = (const int32_t *)add_array(&arrays, cell_bricks, 12, &count);
    if (brick && (cells = add_cells(&arrays, memory, count)))
        touch_start_cells(cells, &box, brick, (uint64_t)count, spacing_m, origin_m);
    PyObject *result = cells ? Py_BuildValue("(ddd)LLLL", cells->corner_m.x, cells->corner_m.y, cells->corner_m.z,
                                             (long long)cells->table_shift, (long long)cells->table_offset,
                                             (long long)cells->supported_offset, (long long)cells->samples_offset)
                             : NULL;
    release_arrays(&arrays);
    return result;
}

static PyObject *native_fill_cells(PyObject *module, PyObject *arguments) {
    PyObject *memory, *cell_bricks, *bricks, *forces;
    long long start, stop;
    int64_t count = -1;
    touch_cell_box box;
    touch_field_bricks field;
    buffer_list arrays;
    touch_cells *cells;
    int is_done = 0;
    (void)module;
    memset(&arrays, 0, sizeof arrays), memset(&box, 0, sizeof box);
    if (!PyArg_ParseTuple(arguments, "LLO(iii)OOO", &start, &stop, &memory, box.corner, box.corner + 1, box.corner + 2,
                          &cell_bricks, &bricks, &forces))
        return NULL;
    const int32_t *brick = (const int32_t *)add_array(&arrays, cell_bricks, 12, &count);
    if (brick && check_range(start, stop, count) && (cells = add_cells(&arrays, memory, count)) &&
        add_field(&arrays, bricks, forces, &field)) {
        PyThreadState *state = PyEval_SaveThread();
        touch_fill_cells(cells, &box, brick, (uint64_t)start, (uint64_t)stop, &field);
        PyEval_RestoreThread(state);
        is_done = 1;
    }
    return done(&arrays, is_done);
}

/* -- placed objects --------------------------------------------------------------------------------------------------- */

static PyObject *native_place_objects(PyObject *module, PyObject *arguments) {
    PyObject *poses, *lattices, *motions, *out;
    int64_t count = -1;
    buffer_list arrays;
    touch_placement *placement = NULL;
    (void)module;
    memset(&arrays, 0, sizeof arrays);
    if (!PyArg_ParseTuple(arguments, "OOOO", &poses, &lattices, &motions, &out)) return NULL;
    const double *pose = (const double *)add_numbers(&arrays, poses, 7, &count);
    const double *lattice = pose ? (const double *)add_numbers(&arrays, lattices, 6, &count) : NULL;
    const double *motion = lattice ? (const double *)add_numbers(&arrays, motions, 6, &count) : NULL;
    if (motion && (placement = (touch_placement *)add_output(&arrays, out, sizeof *placement, &count)))
        for (int64_t n = 0; n < count; n++) touch_place_object(pose + 7 * n, lattice + 6 * n, motion + 6 * n, placement + n);
    return done(&arrays, placement != NULL);
}

/* (boxes, placements, tables, samples, supported, floor, limit); 0: an error is raised. */
static inline int add_objects(buffer_list *arrays, PyObject *objects, touch_placed_objects *all) {
    PyObject *boxes, *placements, *tables, *samples, *supported;
    int64_t entries = -1, bricks = -1;
    all->count = -1;
    if (!PyArg_ParseTuple(objects, "OOOOOdd", &boxes, &placements, &tables, &samples, &supported, &all->floor_n, &all->limit_n))
        return 0;
    return (all->box = (const touch_placed_box *)add_numbers(arrays, boxes, 5, &all->count)) &&
           (all->placement = (const touch_placement *)add_numbers(arrays, placements, 33, &all->count)) &&
           (all->table = (const int64_t *)add_numbers(arrays, tables, 2, &entries)) &&
           (all->supported = (const uint64_t *)add_numbers(arrays, supported, 8, &bricks)) &&
           (all->samples = (const float *)add_array(arrays, samples, 4 * (uint64_t)TOUCH_NEXT_BRICK, &bricks));
}

static PyObject *native_placed_at_points(PyObject *module, PyObject *arguments) {
    PyObject *points, *objects, *out;
    long long start, stop;
    int64_t count = -1;
    touch_placed_objects all;
    buffer_list arrays;
    float *force_n = NULL;
    int is_done = 0;
    (void)module;
    memset(&arrays, 0, sizeof arrays);
    if (!PyArg_ParseTuple(arguments, "LLOOO", &start, &stop, &points, &objects, &out)) return NULL;
    const double *point_m = (const double *)add_numbers(&arrays, points, 3, &count);
    if (point_m && add_objects(&arrays, objects, &all) &&
        (force_n = (float *)add_output(&arrays, out, 3 * sizeof(float), &count)) && check_range(start, stop, count)) {
        PyThreadState *state = PyEval_SaveThread();
        touch_placed_at_points(&all, start, stop, point_m, force_n);
        PyEval_RestoreThread(state);
        is_done = 1;
    }
    return done(&arrays, is_done);
}

/* (origin, spacing, shape); 0: an error is raised. */
static inline int read_lattice(PyObject *lattice, touch_lattice *out) {
    double *o = out->origin_m, *h = out->spacing_m;
    long long shape[3];
    if (!PyArg_ParseTuple(lattice, "(ddd)(ddd)(LLL)", o, o + 1, o + 2, h, h + 1, h + 2, shape, shape + 1, shape + 2)) return 0;
    for (int a = 0; a < 3; a++) out->shape[a] = shape[a];
    return 1;
}

static PyObject *native_find_reached(PyObject *module, PyObject *arguments) {
    PyObject *lattice, *objects, *starts, *bricks, *stamps, *pairs;
    long long max_pairs;
    int64_t start_count, brick_count = -1, stamp_count, code = -1;
    touch_lattice world;
    touch_placed_objects all;
    touch_reached_bricks reached;
    buffer_list arrays;
    (void)module;
    memset(&arrays, 0, sizeof arrays), memset(&reached, 0, sizeof reached);
    if (!PyArg_ParseTuple(arguments, "OOOOOLO", &lattice, &objects, &starts, &bricks, &stamps, &max_pairs, &pairs)) return NULL;
    reached.max_pairs = max_pairs, reached.capacity = -1;
    if (read_lattice(lattice, &world) && add_objects(&arrays, objects, &all)) {
        start_count = all.count + 1;
        stamp_count = ((world.shape[0] + 7) / 8) * ((world.shape[1] + 7) / 8) * ((world.shape[2] + 7) / 8);
        const int64_t *start = (const int64_t *)add_numbers(&arrays, starts, 1, &start_count);
        const int32_t *brick = start ? (const int32_t *)add_array(&arrays, bricks, 12, &brick_count) : NULL;
        int32_t *stamp = brick ? (int32_t *)add_output(&arrays, stamps, 4, &stamp_count) : NULL;
        if (stamp) reached.pair = (int64_t *)add_output(&arrays, pairs, 16, &reached.capacity);
        if (reached.pair) {
            PyThreadState *state = PyEval_SaveThread();
            code = touch_find_reached(&world, &all, start, brick, stamp, &reached);
            PyEval_RestoreThread(state);
        }
    }
    release_arrays(&arrays);
    if (code < 0) return NULL;
    return PyLong_FromLongLong(code == TOUCH_REACHED_TOO_MANY ? -1 : code == TOUCH_REACHED_NO_ROOM ? -2 : reached.count);
}

static PyObject *native_fill_lattice(PyObject *module, PyObject *arguments) {
    PyObject *bricks, *firsts, *object_indices, *lattice, *objects, *forces, *has_force;
    long long start, stop;
    int64_t count = -1, first_count, index_count = -1;
    touch_lattice world;
    touch_placed_objects all;
    buffer_list arrays;
    float *forces_n;
    uint8_t *is_set;
    int is_done = 0;
    (void)module;
    memset(&arrays, 0, sizeof arrays);
    if (!PyArg_ParseTuple(arguments, "LLOOOOOOO", &start, &stop, &bricks, &firsts, &object_indices, &lattice, &objects, &forces,
                          &has_force))
        return NULL;
    const int32_t *brick = (const int32_t *)add_array(&arrays, bricks, 12, &count);
    first_count = count + 1;
    const int64_t *first = brick ? (const int64_t *)add_numbers(&arrays, firsts, 1, &first_count) : NULL;
    const int64_t *object = first ? (const int64_t *)add_numbers(&arrays, object_indices, 1, &index_count) : NULL;
    if (object && read_lattice(lattice, &world) && add_objects(&arrays, objects, &all) &&
        (forces_n = (float *)add_output(&arrays, forces, TOUCH_BRICK_FLOATS * sizeof(float), &count)) &&
        (is_set = (uint8_t *)add_output(&arrays, has_force, 1, &count)) && check_range(start, stop, count)) {
        PyThreadState *state = PyEval_SaveThread();
        touch_fill_lattice(&all, &world, start, stop, brick, first, object, forces_n, is_set);
        PyEval_RestoreThread(state);
        is_done = 1;
    }
    return done(&arrays, is_done);
}

/* -- blends ----------------------------------------------------------------------------------------------------------- */

static PyObject *native_blend_weight(PyObject *module, PyObject *arguments) {
    double rate_hz;
    long long index, length;
    int is_last;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "dLLi", &rate_hz, &index, &length, &is_last)) return NULL;
    return PyFloat_FromDouble(touch_blend_weight(rate_hz, index, length, is_last));
}

/* The brick indices of both frames are checked, as they are followed. */
static inline int check_slots(const int64_t *slot, int64_t bricks, int64_t before, int64_t after) {
    for (int64_t n = 0; n < 2 * bricks; n++)
        if (slot[n] < -1 || slot[n] >= (n < bricks ? before : after))
            return refuse(TOUCH_ARGUMENT, "a brick that is not there");
    return 1;
}

static PyObject *native_blend_bricks(PyObject *module, PyObject *arguments) {
    PyObject *slots, *before, *after, *out, *has_force;
    long long start, stop;
    int64_t bricks = -1, slot_count, before_count = -1, after_count = -1;
    const uint64_t brick_bytes = TOUCH_BRICK_FLOATS * sizeof(float);
    touch_blend_rule rule;
    buffer_list arrays;
    int is_done = 0;
    (void)module;
    memset(&arrays, 0, sizeof arrays);
    if (!PyArg_ParseTuple(arguments, "LLOOOdddOO", &start, &stop, &slots, &before, &after, &rule.weight, &rule.k, &rule.f0_n,
                          &out, &has_force))
        return NULL;
    uint8_t *is_set = (uint8_t *)add_output(&arrays, has_force, 1, &bricks);
    float *to = is_set ? (float *)add_output(&arrays, out, brick_bytes, &bricks) : NULL;
    slot_count = 2 * bricks;
    const int64_t *slot = to ? (const int64_t *)add_numbers(&arrays, slots, 1, &slot_count) : NULL;
    const float *former = slot ? (const float *)add_array(&arrays, before, brick_bytes, &before_count) : NULL;
    const float *latest = former ? (const float *)add_array(&arrays, after, brick_bytes, &after_count) : NULL;
    if (latest && check_range(start, stop, bricks) && check_slots(slot, bricks, before_count, after_count)) {
        PyThreadState *state = PyEval_SaveThread();
        touch_blend_bricks(&rule, bricks, start, stop, slot, former, latest, to, is_set);
        PyEval_RestoreThread(state);
        is_done = 1;
    }
    return done(&arrays, is_done);
}

/* clang-format off */
#define QUERY_METHODS \
    {"force_at", FAST_FUNCTION(native_force_at), METH_FASTCALL, "Force at a point."}, \
    {"vibration_at", FAST_FUNCTION(native_vibration_at), METH_FASTCALL, "Amplitude and frequency at a point."}, \
    {"strongest_body", FAST_FUNCTION(native_strongest_body), METH_FASTCALL, "The body that pushes most at a point."}, \
    {"tool_force", FAST_FUNCTION(native_tool_force), METH_FASTCALL, "Force and torque on a tool."}, \
    {"forces_at", native_forces_at, METH_VARARGS, "Forces at points."}, \
    {"gradients_at", native_gradients_at, METH_VARARGS, "Gradients of the force at points."}, \
    {"vibrations_at", native_vibrations_at, METH_VARARGS, "Amplitudes and frequencies at points."}, \
    {"cell_forces", native_cell_forces, METH_VARARGS, "Forces of one field at points."}, \
    {"find_cells", native_find_cells, METH_VARARGS, "The bricks of cells that a field needs."}, \
    {"start_cells", native_start_cells, METH_VARARGS, "Write the header and the hash table of cells."}, \
    {"fill_cells", native_fill_cells, METH_VARARGS, "Write the samples of bricks of cells."}, \
    {"place_objects", native_place_objects, METH_VARARGS, "The placements of objects."}, \
    {"placed_at_points", native_placed_at_points, METH_VARARGS, "Forces of placed objects at points."}, \
    {"find_reached", native_find_reached, METH_VARARGS, "The bricks of a lattice that objects may reach."}, \
    {"fill_lattice", native_fill_lattice, METH_VARARGS, "Forces of placed objects on a lattice."}, \
    {"blend_weight", native_blend_weight, METH_VARARGS, "The weight of a frame."}, \
    {"blend_bricks", native_blend_bricks, METH_VARARGS, "Bricks between two segments."}
/* clang-format on */

#endif
