/* touchfield._native: c/touch.h as a module of Python.

   open(bytes) -> file                     None if touch.h does not decode the file
   frames(file, segment) -> frames         positioned before the first frame of a segment
   next(frames) -> (bricks, forces)        None after the last frame

   Bricks are uint32 [n], their positions in the raster of bricks; forces are float32 [n, 8, 8, 8, 3] in newtons. Both
   are returned as bytes. Errors are a ValueError whose text names the cause. Other Python threads run while C decodes.
   The module uses CPython's stable ABI only, so that one binary serves every version from 3.11 on. */
#include "arguments.h"

#define FORCES_OF_BRICK ((uint64_t)6144) /* bytes: 8^3 samples of three float32 */

static const char file_name[] = "touchfield._native.file", frames_name[] = "touchfield._native.frames";

typedef struct {
    touch_file file;
    PyObject *bytes; /* what `file` points into */
} open_file;

typedef struct {
    touch_decoder decoder;
    touch_arena memory;      /* of the decoder */
    touch_arena frame_arena; /* memory of the latest frame */
    PyObject *file;          /* the capsule of the open_file, which must outlive the decoder */
} open_frames;

static void free_file(PyObject *capsule) {
    open_file *self = (open_file *)PyCapsule_GetPointer(capsule, file_name);
    Py_DecRef(self->bytes);
    free(self);
}

static void free_frames(PyObject *capsule) {
    open_frames *self = (open_frames *)PyCapsule_GetPointer(capsule, frames_name);
    Py_DecRef(self->file);
    free_arena(&self->memory);
    free_arena(&self->frame_arena);
    free(self);
}

static PyObject *native_open(PyObject *module, PyObject *bytes) {
    char *data;
    Py_ssize_t size;
    (void)module;
    if (PyBytes_AsStringAndSize(bytes, &data, &size)) return NULL;
    open_file *self = (open_file *)malloc(sizeof *self);
    if (!self) return PyErr_NoMemory();
    PyThreadState *state = PyEval_SaveThread();
    int code = touch_open(&self->file, data, (uint64_t)size);
    PyEval_RestoreThread(state);
    if (code) {
        free(self);
        return none();
    }
    Py_IncRef(bytes);
    self->bytes = bytes;
    return PyCapsule_New(self, file_name, free_file);
}

static PyObject *native_frames(PyObject *module, PyObject *arguments) {
    PyObject *capsule;
    unsigned int segment;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OI", &capsule, &segment)) return NULL;
    open_file *file = (open_file *)PyCapsule_GetPointer(capsule, file_name);
    if (!file) return NULL;
    open_frames *self = (open_frames *)calloc(1, sizeof *self);
    if (!self) return PyErr_NoMemory();

    uint64_t decoder_size, frame_size;
    touch_room(&file->file, &decoder_size, &frame_size);
    Py_IncRef(capsule);
    self->file = capsule;
    self->memory = take_arena(decoder_size), self->frame_arena = take_arena(frame_size);
    int code = TOUCH_MEMORY;
    if (self->memory.base && self->frame_arena.base) {
        PyThreadState *state = PyEval_SaveThread();
        code = touch_start(&self->decoder, &file->file, self->memory);
        if (!code) code = touch_seek(&self->decoder, segment);
        PyEval_RestoreThread(state);
    }
    PyObject *frames = PyCapsule_New(self, frames_name, free_frames);
    if (!code || !frames) return frames;
    PyErr_SetString(PyExc_ValueError, self->decoder.error ? self->decoder.error : "not enough memory");
    Py_DecRef(frames);
    return NULL;
}

/* Position of each brick in the raster, in the order of its forces. */
static void write_positions(const touch_field *field, uint8_t *out) {
    for (uint32_t i = 0; i <= field->mask; i++) {
        uint32_t key = field->table[2 * i], slot = field->table[2 * i + 1];
        if (!key) continue;
        uint32_t position = key - 1;
        memcpy(out + 4 * (size_t)slot, &position, 4);
    }
}

static PyObject *native_next(PyObject *module, PyObject *capsule) {
    touch_frame frame;
    (void)module;
    open_frames *self = (open_frames *)PyCapsule_GetPointer(capsule, frames_name);
    if (!self) return NULL;
    self->frame_arena.used = 0;
    PyThreadState *state = PyEval_SaveThread();
    int code = touch_next(&self->decoder, &self->frame_arena, &frame);
    PyEval_RestoreThread(state);
    if (code == TOUCH_END) return none();
    if (code || frame.is_placed) {
        PyErr_SetString(PyExc_ValueError, code ? self->decoder.error : "bodies, which have no list of bricks");
        return NULL;
    }
    const touch_field *field = frame.part[0].field;
    PyObject *bricks = PyBytes_FromStringAndSize(NULL, (Py_ssize_t)(4 * (uint64_t)field->bricks));
    PyObject *forces = PyBytes_FromStringAndSize(NULL, (Py_ssize_t)(FORCES_OF_BRICK * field->bricks));
    if (!bricks || !forces) {
        if (bricks) Py_DecRef(bricks);
        if (forces) Py_DecRef(forces);
        return NULL;
    }
    write_positions(field, (uint8_t *)PyBytes_AsString(bricks));
    memcpy(PyBytes_AsString(forces), field->forces_n, (size_t)(FORCES_OF_BRICK * field->bricks));
    return Py_BuildValue("NN", bricks, forces);
}

static PyMethodDef methods[] = {
    {"open", native_open, METH_O, "Open the bytes of a .touch file; None if they cannot be decoded here."},
    {"frames", native_frames, METH_VARARGS, "Frames of a segment, before the first one."},
    {"next", native_next, METH_O, "Bricks and forces of the next frame; None after the last one."},
    {NULL, NULL, 0, NULL},
};

static PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_native", ".touch files decoded by touch.h.", -1, methods, NULL, NULL, NULL, NULL,
};

PYTHON_EXPORT PyObject *PyInit__native(void);
PYTHON_EXPORT PyObject *PyInit__native(void) { return PyModule_Create2(&definition, 1013); }
