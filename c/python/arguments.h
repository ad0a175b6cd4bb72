/* Converts the arguments and results of the functions of `touchfield._native`, which are coder `touch` in C as a
   module of Python: buffers, grids, memory, and errors.

   Other files of the module include this one; it includes touch_encode.h, and the declarations of CPython. */
#ifndef TOUCHFIELD_ARGUMENTS_H
#define TOUCHFIELD_ARGUMENTS_H

#define _DEFAULT_SOURCE
#ifdef TOUCHFIELD_PYTHON_H /* only to check the declarations of stable_abi.h */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#define PYTHON_EXPORT
#else
#include "stable_abi.h"
#endif
#define TOUCH_ENCODE_IMPLEMENTATION
#include "../touch_encode.h"

#include <stdlib.h>
#ifdef __linux__
#include <sys/mman.h>
#endif

/* -- errors ---------------------------------------------------------------------------------------------------------- */

/* Raise ValueError(code, text), with a code of touch.h; returns NULL. */
static inline PyObject *fail(int code, const char *text) {
    PyObject *arguments = Py_BuildValue("is", code, text);
    if (!arguments) return NULL;
    PyErr_SetObject(PyExc_ValueError, arguments);
    Py_DecRef(arguments);
    return NULL;
}

/* The same, of a function that returns 0 if it fails. */
static inline int refuse(int code, const char *text) {
    fail(code, text);
    return 0;
}

static inline PyObject *fail_for_memory(void) { return fail(TOUCH_MEMORY, "not enough memory"); }

static inline PyObject *none(void) {
    PyObject *result = &_Py_NoneStruct;
    Py_IncRef(result);
    return result;
}

static inline int is_none(const PyObject *object) { return object == &_Py_NoneStruct; }

/* -- memory ---------------------------------------------------------------------------------------------------------- */

/* Memory of an arena, NULL if there is none. Only what is touched costs anything, so it may be as large as the worst case
   needs. The coder touches tens of megabytes once; with pages of 4 kB a third of its time would be page faults. */
static inline touch_arena take_arena(uint64_t size) {
    void *memory = NULL;
    if (!size || size > SIZE_MAX / 2) return touch_arena_of(NULL, 0);
#ifdef __linux__
    memory = mmap(NULL, (size_t)size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (memory == MAP_FAILED) memory = NULL;
#ifdef MADV_HUGEPAGE
    if (memory) (void)madvise(memory, (size_t)size, MADV_HUGEPAGE); /* a hint: it may be refused */
#endif
#else
    memory = malloc((size_t)size);
#endif
    return touch_arena_of(memory, memory ? size : 0);
}

static inline void free_arena(touch_arena *arena) {
#ifdef __linux__
    if (arena->base) (void)munmap(arena->base, (size_t)arena->size);
#else
    free(arena->base);
#endif
    *arena = touch_arena_of(NULL, 0);
}

/* -- arguments ------------------------------------------------------------------------------------------------------- */

/* The grid of a shape (int, int, int), of any number of bricks: codes on their own need not be those of a file. Spacings and
   origin are set where a function needs them. 0: an error is raised. */
static inline int read_wide_shape(PyObject *shape, touch_grid *grid) {
    Py_ssize_t size[3];
    memset(grid, 0, sizeof *grid);
    if (!PyArg_ParseTuple(shape, "nnn", size, size + 1, size + 2)) return 0;
    for (int n = 0; n < 3; n++) {
        if (size[n] < 1 || size[n] > (Py_ssize_t)1 << 20) return refuse(TOUCH_ARGUMENT, "a grid of too many samples");
        grid->shape[n] = (uint32_t)size[n], grid->spacing_m[n] = 1;
    }
    return 1;
}

/* The same, of no more bricks than a file may have. */
static inline int read_shape(PyObject *shape, touch_grid *grid) {
    if (!read_wide_shape(shape, grid)) return 0;
    if (touch_brick_count(grid) > (uint64_t)1 << 27) return refuse(TOUCH_ARGUMENT, "a grid of too many samples");
    return 1;
}

/* The C-contiguous buffer of an array of `count` items of `item_bytes` bytes; a `count` below 0 is set to the number of
   items that it has. 0: an error is raised. On success the caller releases `view`. */
static inline int read_array(PyObject *object, uint64_t item_bytes, int64_t *count, Py_buffer *view) {
    if (PyObject_GetBuffer(object, view, PyBUF_SIMPLE)) return 0;
    uint64_t bytes = (uint64_t)view->len;
    int64_t items = (int64_t)(bytes / item_bytes);
    if (*count < 0) *count = items;
    if (bytes % item_bytes == 0 && items == *count && (!items || (uintptr_t)view->buf % 4 == 0)) return 1;
    PyBuffer_Release(view);
    return refuse(TOUCH_ARGUMENT, "an array of another size");
}

typedef struct { /* buffers that are read until a function returns */
    Py_buffer *view;
    uint64_t count, capacity;
} buffer_list;

/* As `read_array`, released with the list; returns where its items are. NULL: an error is raised. */
static inline const void *add_array(buffer_list *list, PyObject *object, uint64_t item_bytes, int64_t *count) {
    if (list->count == list->capacity) {
        uint64_t capacity = list->capacity ? 2 * list->capacity : 16;
        Py_buffer *view = (Py_buffer *)realloc(list->view, (size_t)capacity * sizeof *view);
        if (!view) return fail_for_memory();
        list->view = view, list->capacity = capacity;
    }
    if (!read_array(object, item_bytes, count, list->view + list->count)) return NULL;
    const void *items = list->view[list->count++].buf;
    return items ? items : ""; /* an empty array may have no address */
}

static inline void release_arrays(buffer_list *list) {
    while (list->count) PyBuffer_Release(list->view + --list->count);
    free(list->view);
    memset(list, 0, sizeof *list);
}

/* -- arguments of functions that are called for each point or tick (METH_FASTCALL) ------------------------------------- */

/* A function of such arguments, as a table of methods has it. */
#define FAST_FUNCTION(function) ((PyCFunction)(void (*)(void))(function))

/* 0: an error is raised. */
static inline int expect_arguments(Py_ssize_t count, Py_ssize_t expected) {
    return count == expected || refuse(TOUCH_ARGUMENT, "another number of arguments");
}

/* `count` numbers; 0: an error is raised. */
static inline int read_doubles(PyObject *const *arguments, int count, double *to) {
    for (int n = 0; n < count; n++) {
        to[n] = PyFloat_AsDouble(arguments[n]);
        if (to[n] == -1.0 && PyErr_Occurred()) return 0;
    }
    return 1;
}

static inline int read_integers(PyObject *const *arguments, int count, int64_t *to) {
    for (int n = 0; n < count; n++) {
        to[n] = PyLong_AsLongLong(arguments[n]);
        if (to[n] == -1 && PyErr_Occurred()) return 0;
    }
    return 1;
}

/* A tuple of numbers; NULL: an error is raised. */
static inline PyObject *tuple_of(const double *numbers, Py_ssize_t count) {
    PyObject *tuple = PyTuple_New(count);
    for (Py_ssize_t n = 0; tuple && n < count; n++) {
        PyObject *number = PyFloat_FromDouble(numbers[n]);
        if (number && !PyTuple_SetItem(tuple, n, number)) continue;
        Py_DecRef(tuple);
        return NULL;
    }
    return tuple;
}

/* -- results --------------------------------------------------------------------------------------------------------- */

/* A bytes object to be written, and where; NULL: an error is raised. */
static inline PyObject *new_bytes(uint64_t size, void **to) {
    PyObject *bytes = size <= (uint64_t)PTRDIFF_MAX / 2 ? PyBytes_FromStringAndSize(NULL, (Py_ssize_t)size) : PyErr_NoMemory();
    if (bytes) *to = PyBytes_AsString(bytes);
    return bytes;
}

static inline PyObject *bytes_of(const void *from, uint64_t size) {
    void *to;
    PyObject *bytes = new_bytes(size, &to);
    if (bytes && size) memcpy(to, from, (size_t)size);
    return bytes;
}

#endif
