/* The settings of a receiver: choose_settings, choose_stability, stiffest_slope, find_wall and specified_wall (_native.pyi). */
#ifndef TOUCHFIELD_SETTINGS_H
#define TOUCHFIELD_SETTINGS_H

#include "../touch_provenance.h"
#include "query.h"
#include "receiver.h"

/* Options and device; 0: an error is raised. */
static inline int add_options(buffer_list *arrays, PyObject *options, PyObject *device, const touch_render_options **wanted,
                              const touch_device **stated) {
    int64_t count = 1;
    *wanted = (const touch_render_options *)add_array(arrays, options, sizeof **wanted, &count);
    *stated = *wanted ? (const touch_device *)add_array(arrays, device, sizeof **stated, &count) : NULL;
    if (!*stated || (is_aligned(*wanted, 8) && is_aligned(*stated, 8))) return *stated != NULL;
    return refuse(TOUCH_ARGUMENT, "options that are not aligned");
}

static PyObject *native_choose_settings(PyObject *module, PyObject *arguments) {
    PyObject *memory, *options, *device;
    const touch_render_options *wanted;
    const touch_device *stated;
    double friction, damping_n_s_per_m;
    touch_receiver *receiver;
    Py_buffer view;
    buffer_list arrays;
    int is_done = 0;
    (void)module;
    memset(&arrays, 0, sizeof arrays);
    if (!PyArg_ParseTuple(arguments, "OOOdd", &memory, &options, &device, &friction, &damping_n_s_per_m)) return NULL;
    if (add_options(&arrays, options, device, &wanted, &stated) && read_receiver(memory, &view, &receiver)) {
        touch_choose_settings(receiver, wanted, stated, friction, damping_n_s_per_m);
        PyBuffer_Release(&view);
        is_done = 1;
    }
    return done(&arrays, is_done);
}

static PyObject *native_choose_stability(PyObject *module, PyObject *arguments) {
    PyObject *options, *device, *result = NULL;
    const touch_render_options *wanted;
    const touch_device *stated;
    double damping_n_s_per_m, stiffest_n_per_m;
    buffer_list arrays;
    (void)module;
    memset(&arrays, 0, sizeof arrays);
    if (!PyArg_ParseTuple(arguments, "OOdd", &options, &device, &damping_n_s_per_m, &stiffest_n_per_m)) return NULL;
    if (add_options(&arrays, options, device, &wanted, &stated)) {
        touch_stability s = touch_stability_of(wanted, stated, damping_n_s_per_m, stiffest_n_per_m);
        const double numbers[4] = {s.brake_n_s_per_m, s.coupling_n_per_m, s.rendered_n_per_m, s.bare_n_per_m};
        result = tuple_of(numbers, 4);
    }
    release_arrays(&arrays);
    return result;
}

/* The cells of a field; NULL: an error is raised. What lies in them is not checked but for their number. */
static inline const touch_cells *add_cells_to_read(buffer_list *arrays, PyObject *object, long long bricks) {
    int64_t size = -1;
    const touch_cells *cells = (const touch_cells *)add_array(arrays, object, 1, &size);
    if (!cells) return NULL;
    if (bricks >= 0 && bricks < 1 << 27 && is_aligned(cells, 8) && size == (int64_t)touch_cells_room((uint64_t)bricks))
        return cells;
    return (const touch_cells *)fail(TOUCH_ARGUMENT, "cells of another size, or not aligned");
}

static PyObject *native_stiffest_slope(PyObject *module, PyObject *arguments) {
    PyObject *object;
    long long bricks;
    double slope_n_per_m = 0.0;
    buffer_list arrays;
    (void)module;
    memset(&arrays, 0, sizeof arrays);
    if (!PyArg_ParseTuple(arguments, "OL", &object, &bricks)) return NULL;
    const touch_cells *cells = add_cells_to_read(&arrays, object, bricks);
    if (cells) {
        PyThreadState *state = PyEval_SaveThread();
        slope_n_per_m = touch_stiffest_n_per_m(cells, bricks);
        PyEval_RestoreThread(state);
    }
    release_arrays(&arrays);
    return cells ? PyFloat_FromDouble(slope_n_per_m) : NULL;
}

/* 0: an error is raised. */
static inline int find_wall_in(const touch_wall_field *source, double found[3]) {
    touch_field_wall wall = {0.0, 0.0, 0.0};
    PyThreadState *state = PyEval_SaveThread();
    int64_t count = touch_force_sizes(source->field, NULL);
    double *work = (double *)malloc((size_t)(count ? count : 1) * sizeof *work);
    if (work) wall = touch_find_wall(source, work);
    free(work);
    PyEval_RestoreThread(state);
    found[0] = wall.stiffness_n_per_m, found[1] = wall.level_n, found[2] = wall.large_n;
    return work ? 1 : (fail_for_memory(), 0);
}

static PyObject *native_find_wall(PyObject *module, PyObject *arguments) {
    PyObject *bricks, *forces, *object, *result = NULL;
    double spacing_m[3], origin_m[3], found[3];
    double *h = spacing_m, *o = origin_m;
    long long count;
    touch_field_bricks field;
    buffer_list arrays;
    (void)module;
    memset(&arrays, 0, sizeof arrays);
    if (!PyArg_ParseTuple(arguments, "OO(ddd)(ddd)OL", &bricks, &forces, h, h + 1, h + 2, o, o + 1, o + 2, &object, &count))
        return NULL;
    const touch_cells *cells = add_cells_to_read(&arrays, object, count);
    if (cells && add_field(&arrays, bricks, forces, &field)) {
        touch_wall_field source = {&field, cells, spacing_m, origin_m};
        if (find_wall_in(&source, found)) result = tuple_of(found, 3);
    }
    release_arrays(&arrays);
    return result;
}

static PyObject *native_specified_wall(PyObject *module, PyObject *arguments) {
    PyObject *object;
    int64_t size = -1;
    touch_stated_text spec = {NULL, 0};
    buffer_list arrays;
    double stated_n_per_m = 0.0;
    (void)module;
    memset(&arrays, 0, sizeof arrays);
    if (!PyArg_ParseTuple(arguments, "O", &object)) return NULL;
    if ((spec.at = (const char *)add_array(&arrays, object, 1, &size))) {
        spec.size = (uint64_t)size;
        stated_n_per_m = touch_specified_wall(spec);
    }
    release_arrays(&arrays);
    return spec.at ? PyFloat_FromDouble(stated_n_per_m) : NULL;
}

#define SETTINGS_METHODS                                               \
    {"choose_settings", native_choose_settings, METH_VARARGS, NULL},   \
    {"choose_stability", native_choose_stability, METH_VARARGS, NULL}, \
    {"stiffest_slope", native_stiffest_slope, METH_VARARGS, NULL},     \
    {"find_wall", native_find_wall, METH_VARARGS, NULL},               \
    {"specified_wall", native_specified_wall, METH_VARARGS, NULL}

#endif
