/* The receiver: tick, release, cycle, give_order, publish, unrolled_frame, limited, contact_force,
   receiver_layout and openhaptics_callback (_native.pyi). */
#ifndef TOUCHFIELD_RECEIVER_H
#define TOUCHFIELD_RECEIVER_H

#include "../touch_openhaptics.h"
#include "../touch_settings.h"
#include "arguments.h"
#include "receiver_layout.h"

/* The writable memory of a receiver. 0: an error is raised; else the caller releases `view`. */
static inline int read_receiver(PyObject *object, Py_buffer *view, touch_receiver **receiver) {
    if (PyObject_GetBuffer(object, view, PyBUF_WRITABLE)) return 0;
    *receiver = (touch_receiver *)view->buf;
    if ((uint64_t)view->len >= sizeof **receiver && (uintptr_t)view->buf % sizeof(int64_t) == 0) return 1;
    PyBuffer_Release(view);
    return refuse(TOUCH_ARGUMENT, "memory that is too small for a receiver, or not aligned");
}

/* Whether a frame may lie at these offsets. */
static inline int check_frames(const Py_buffer *view, const int64_t *offsets, int count) {
    for (int n = 0; n < count; n++)
        if (offsets[n] < 0 || offsets[n] % 8 || offsets[n] > view->len - (int64_t)sizeof(touch_frame_header))
            return refuse(TOUCH_ARGUMENT, "an offset outside of the memory");
    return 1;
}

static inline PyObject *tuple_of_vector(touch_vector v) { return tuple_of(&v.x, 3); }

static inline touch_vector vector_of(const double *numbers) { return touch_vector_of(numbers[0], numbers[1], numbers[2]); }

/* -- ticks ------------------------------------------------------------------------------------------------------------ */

static PyObject *py_tick(PyObject *self, PyObject *const *arguments, Py_ssize_t count) {
    Py_buffer view;
    touch_receiver *receiver;
    int64_t offsets[2];
    double numbers[5]; /* blend, x, y, z, dt */
    PyObject *result = NULL;
    (void)self;
    if (!expect_arguments(count, 8) || !read_integers(arguments + 1, 2, offsets) || !read_doubles(arguments + 3, 5, numbers) ||
        !read_receiver(arguments[0], &view, &receiver))
        return NULL;
    if (check_frames(&view, offsets, 2)) {
        touch_vector position = vector_of(numbers + 1);
        result = tuple_of_vector(touch_tick(receiver, offsets[0], offsets[1], numbers[0], position, numbers[4]));
    }
    PyBuffer_Release(&view);
    return result;
}

static PyObject *py_release(PyObject *self, PyObject *const *arguments, Py_ssize_t count) {
    Py_buffer view;
    touch_receiver *receiver;
    double dt_s;
    (void)self;
    if (!expect_arguments(count, 2) || !read_doubles(arguments + 1, 1, &dt_s) ||
        !read_receiver(arguments[0], &view, &receiver))
        return NULL;
    touch_vector force = touch_release(receiver, dt_s);
    PyBuffer_Release(&view);
    return tuple_of_vector(force);
}

static PyObject *py_cycle(PyObject *self, PyObject *const *arguments, Py_ssize_t count) {
    Py_buffer view;
    touch_receiver *receiver;
    double position[3];
    int64_t now_ns;
    (void)self;
    if (!expect_arguments(count, 5) || !read_doubles(arguments + 1, 3, position) ||
        !read_integers(arguments + 4, 1, &now_ns) || !read_receiver(arguments[0], &view, &receiver))
        return NULL;
    touch_vector force = touch_receiver_tick(receiver, vector_of(position), now_ns);
    PyBuffer_Release(&view);
    return tuple_of_vector(force);
}

static PyObject *py_limited(PyObject *self, PyObject *const *arguments, Py_ssize_t count) {
    Py_buffer view;
    touch_receiver *receiver;
    double numbers[4]; /* x, y, z, dt */
    (void)self;
    if (!expect_arguments(count, 5) || !read_doubles(arguments + 1, 4, numbers) ||
        !read_receiver(arguments[0], &view, &receiver))
        return NULL;
    const touch_settings *settings = &receiver->settings;
    touch_vector desired = vector_of(numbers);
    touch_vector force = touch_limit_output(settings, &settings->force_limits, &receiver->state.force, desired, numbers[3]);
    PyBuffer_Release(&view);
    return tuple_of_vector(force);
}

static PyObject *py_contact_force(PyObject *self, PyObject *const *arguments, Py_ssize_t count) {
    Py_buffer view;
    touch_receiver *receiver;
    int64_t offsets[2];
    double numbers[4]; /* blend, x, y, z */
    PyObject *result = NULL;
    (void)self;
    if (!expect_arguments(count, 7) || !read_integers(arguments + 1, 2, offsets) || !read_doubles(arguments + 3, 4, numbers) ||
        !read_receiver(arguments[0], &view, &receiver))
        return NULL;
    if (check_frames(&view, offsets, 2)) {
        touch_instant t = touch_instant_of(receiver, offsets[0], offsets[1], numbers[0]);
        result = tuple_of_vector(touch_contact_force(receiver, &t, vector_of(numbers + 1), 1.0 / receiver->settings.rate_hz));
    }
    PyBuffer_Release(&view);
    return result;
}

/* -- the player's side ------------------------------------------------------------------------------------------------ */

static PyObject *py_give_order(PyObject *self, PyObject *const *arguments, Py_ssize_t count) {
    Py_buffer view;
    touch_receiver *receiver;
    int64_t generation, mode[2]; /* and is_stopping */
    double numbers[2];           /* start, speed */
    (void)self;
    if (!expect_arguments(count, 6) || !read_integers(arguments + 1, 1, &generation) ||
        !read_doubles(arguments + 2, 2, numbers) || !read_integers(arguments + 4, 2, mode) ||
        !read_receiver(arguments[0], &view, &receiver))
        return NULL;
    touch_give_order(receiver, generation, numbers[0], numbers[1], mode[0], mode[1]);
    PyBuffer_Release(&view);
    return none();
}

static PyObject *py_publish(PyObject *self, PyObject *const *arguments, Py_ssize_t count) {
    Py_buffer view;
    touch_receiver *receiver;
    int64_t numbers[3]; /* generation, unrolled frame, offset */
    (void)self;
    if (!expect_arguments(count, 4) || !read_integers(arguments + 1, 3, numbers) ||
        !read_receiver(arguments[0], &view, &receiver))
        return NULL;
    int is_inside = check_frames(&view, numbers + 2, 1);
    if (is_inside) touch_publish(receiver, numbers[0], numbers[1], numbers[2]);
    PyBuffer_Release(&view);
    return is_inside ? none() : NULL;
}

static PyObject *py_unrolled_frame(PyObject *self, PyObject *const *arguments, Py_ssize_t count) {
    double numbers[2]; /* media time, rate */
    (void)self;
    if (!expect_arguments(count, 2) || !read_doubles(arguments, 2, numbers)) return NULL;
    return PyLong_FromLongLong(touch_unrolled_frame(numbers[0], numbers[1]));
}

/* -- addresses and layout --------------------------------------------------------------------------------------------- */

static PyObject *py_receiver_layout(PyObject *self, PyObject *unused) {
    Py_ssize_t count = sizeof receiver_layout_table / sizeof receiver_layout_table[0];
    PyObject *table = PyList_New(count);
    (void)self, (void)unused;
    for (Py_ssize_t n = 0; table && n < count; n++) {
        Py_ssize_t bytes = (Py_ssize_t)receiver_layout_table[n].bytes;
        PyObject *row = Py_BuildValue("sn", receiver_layout_table[n].name, bytes);
        if (row && !PyList_SetItem(table, n, row)) continue;
        Py_DecRef(table);
        return NULL;
    }
    return table;
}

static unsigned openhaptics_callback(void *user) { return touch_openhaptics_callback(user); }

static touch_vector receiver_tick(touch_receiver *receiver, touch_vector device_m, int64_t now_ns) {
    return touch_receiver_tick(receiver, device_m, now_ns);
}

static PyObject *py_openhaptics_callback(PyObject *self, PyObject *unused) {
    (void)self, (void)unused;
    return Py_BuildValue("KKn", (unsigned long long)(uintptr_t)openhaptics_callback,
                         (unsigned long long)(uintptr_t)receiver_tick, (Py_ssize_t)sizeof(touch_driver));
}

#define RECEIVER_METHODS                                                            \
    {"tick", FAST_FUNCTION(py_tick), METH_FASTCALL, NULL},                          \
    {"release", FAST_FUNCTION(py_release), METH_FASTCALL, NULL},                    \
    {"cycle", FAST_FUNCTION(py_cycle), METH_FASTCALL, NULL},                        \
    {"limited", FAST_FUNCTION(py_limited), METH_FASTCALL, NULL},                    \
    {"contact_force", FAST_FUNCTION(py_contact_force), METH_FASTCALL, NULL},        \
    {"give_order", FAST_FUNCTION(py_give_order), METH_FASTCALL, NULL},              \
    {"publish", FAST_FUNCTION(py_publish), METH_FASTCALL, NULL},                    \
    {"unrolled_frame", FAST_FUNCTION(py_unrolled_frame), METH_FASTCALL, NULL},      \
    {"receiver_layout", py_receiver_layout, METH_NOARGS, NULL},                     \
    {"openhaptics_callback", py_openhaptics_callback, METH_NOARGS, NULL}

#endif
