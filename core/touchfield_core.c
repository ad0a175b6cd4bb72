/* touchfield_core: touch.h as a module of Python, so that a file is decoded where no kernel has been compiled yet.

   open(bytes) -> file                          None where touch.h does not decode it
   frames(file, segment) -> frames              ready for the first frame of a segment
   next(frames) -> (numbers, forces) or None    u32 [n] in the raster of the bricks, f32 [n, 8, 8, 8, 3] newtons

   All take and give bytes; ValueError says in words what is wrong. The interpreter is free while C decodes. */
#define _DEFAULT_SOURCE
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#define TOUCH_IMPLEMENTATION
#include "touch.h"

#include <stdlib.h>
#ifdef __linux__
#include <sys/mman.h>
#endif

typedef struct {
    touch_file file;
    PyObject *bytes;
} core_file;

typedef struct {
    touch_decoder decoder;
    touch_arena arena; /* of one frame */
    PyObject *file;    /* the capsule, which must outlive it */
} core_frames;

/* Memory of an arena. A decoder touches tens of megabytes once: in pages of 4 kB that takes a third of its time. */
static uint8_t *arena_memory(uint64_t size) {
    void *memory = NULL;
#ifdef MADV_HUGEPAGE
    if (size >= 1 << 22) {
        if (posix_memalign(&memory, 1 << 21, (size_t)size)) return NULL;
        (void)madvise(memory, (size_t)size, MADV_HUGEPAGE); /* a wish: without it all is as before */
        return (uint8_t *)memory;
    }
#endif
    memory = malloc((size_t)size);
    return (uint8_t *)memory;
}

static void forget_file(PyObject *capsule) {
    core_file *own = (core_file *)PyCapsule_GetPointer(capsule, "touchfield_core.file");
    Py_DECREF(own->bytes), free(own);
}

static void forget_frames(PyObject *capsule) {
    core_frames *own = (core_frames *)PyCapsule_GetPointer(capsule, "touchfield_core.frames");
    Py_DECREF(own->file), free(own->decoder.arena.base), free(own->arena.base), free(own);
}

static PyObject *core_open(PyObject *module, PyObject *bytes) {
    char *data;
    Py_ssize_t size;
    int code;
    (void)module;
    if (PyBytes_AsStringAndSize(bytes, &data, &size)) return NULL;
    core_file *own = (core_file *)malloc(sizeof *own);
    if (!own) return PyErr_NoMemory();
    Py_BEGIN_ALLOW_THREADS code = touch_open(&own->file, data, (uint64_t)size);
    Py_END_ALLOW_THREADS
    if (code) {
        free(own);
        Py_RETURN_NONE;
    }
    own->bytes = Py_NewRef(bytes);
    return PyCapsule_New(own, "touchfield_core.file", forget_file);
}

static PyObject *core_start(PyObject *module, PyObject *arguments) {
    PyObject *capsule;
    unsigned int segment;
    uint64_t room, each;
    int code;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OI", &capsule, &segment)) return NULL;
    core_file *file = (core_file *)PyCapsule_GetPointer(capsule, "touchfield_core.file");
    if (!file) return NULL;
    core_frames *own = (core_frames *)calloc(1, sizeof *own);
    if (!own) return PyErr_NoMemory();
    touch_room(&file->file, &room, &each);
    uint8_t *first = arena_memory(room), *second = arena_memory(each);
    own->file = Py_NewRef(capsule), own->arena = touch_arena_of(second, each);
    if (!first || !second) code = TOUCH_MEMORY, own->decoder.arena.base = first;
    else {
        Py_BEGIN_ALLOW_THREADS code = touch_start(&own->decoder, &file->file, touch_arena_of(first, room));
        if (!code) code = touch_seek(&own->decoder, segment);
        Py_END_ALLOW_THREADS
    }
    PyObject *out = PyCapsule_New(own, "touchfield_core.frames", forget_frames);
    if (!code || !out) return out;
    PyErr_SetString(PyExc_ValueError, own->decoder.error ? own->decoder.error : "there is not memory enough");
    Py_DECREF(out);
    return NULL;
}

static PyObject *core_next(PyObject *module, PyObject *capsule) {
    touch_frame frame;
    int code;
    (void)module;
    core_frames *own = (core_frames *)PyCapsule_GetPointer(capsule, "touchfield_core.frames");
    if (!own) return NULL;
    own->arena.used = 0;
    Py_BEGIN_ALLOW_THREADS code = touch_next(&own->decoder, &own->arena, &frame);
    Py_END_ALLOW_THREADS
    if (code == TOUCH_END) Py_RETURN_NONE;
    if (code || frame.is_placed) {
        PyErr_SetString(PyExc_ValueError, code ? own->decoder.error : "bodies, which are sampled and not listed");
        return NULL;
    }
    const touch_field *field = frame.part[0].field;
    PyObject *numbers = PyBytes_FromStringAndSize(NULL, (Py_ssize_t)(4 * (uint64_t)field->bricks));
    PyObject *forces = PyBytes_FromStringAndSize(NULL, (Py_ssize_t)(6144 * (uint64_t)field->bricks));
    if (!numbers || !forces) {
        Py_XDECREF(numbers), Py_XDECREF(forces);
        return NULL;
    }
    uint8_t *to = (uint8_t *)PyBytes_AsString(numbers);
    for (uint32_t i = 0; i <= field->mask; i++)
        if (field->table[2 * i]) {
            uint32_t number = field->table[2 * i] - 1;
            memcpy(to + 4 * (size_t)field->table[2 * i + 1], &number, 4);
        }
    memcpy(PyBytes_AsString(forces), field->forces_n, 6144 * (size_t)field->bricks);
    return Py_BuildValue("NN", numbers, forces);
}

static PyMethodDef methods[] = {
    {"open", core_open, METH_O, "A .touch file of these bytes; None where it is not decoded here."},
    {"frames", core_start, METH_VARARGS, "The frames of a segment, before the first."},
    {"next", core_next, METH_O, "Numbers and forces of the bricks of the next frame; None behind the last."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "touchfield_core", "touch.h: .touch files decoded in C.", 0, methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit_touchfield_core(void) { return PyModule_Create(&definition); }
