/* Supports, whole numbers, vibration and poses: encode_support, decode_support, encode_numbers, decode_numbers,
   encode_vibration, decode_vibration, encode_poses, decode_poses (_native.pyi). */
#ifndef TOUCHFIELD_PARTS_H
#define TOUCHFIELD_PARTS_H

#include "arguments.h"

/* -- memory ---------------------------------------------------------------------------------------------------------- */

/* Below this size memory comes from malloc: most codes are short, and mapping pages would take longer than coding them. */
#define SMALL_ARENA ((uint64_t)4 << 20)

static inline touch_arena take_part_arena(uint64_t size) {
    if (size >= SMALL_ARENA) return take_arena(size);
    void *memory = malloc((size_t)size);
    return touch_arena_of(memory, memory ? size : 0);
}

static inline void free_part_arena(touch_arena *arena) {
    if (arena->size >= SMALL_ARENA) {
        free_arena(arena);
        return;
    }
    free(arena->base);
    *arena = touch_arena_of(NULL, 0);
}

/* Codes something in an arena; the code of touch.h. */
typedef int (*part_work)(void *self, touch_arena *arena, const char **text);

/* Do `work` in memory of `first` bytes, and again in more while that is too small, up to `max`. 0: an error is raised; else
   the caller frees the arena. Few codes need the worst case that their bytes allow, which may be more than there is. */
static inline int run_part(part_work work, void *self, uint64_t first, uint64_t max, touch_arena *arena) {
    const char *text = "not enough memory";
    PyThreadState *state = PyEval_SaveThread();
    int code;
    for (uint64_t size = first < max ? first : max;; size = size < max / 4 ? 4 * size : max) {
        *arena = take_part_arena(size);
        int is_last = size == max || !arena->base;
        code = arena->base ? work(self, arena, &text) : TOUCH_MEMORY;
        if (!code) break;
        free_part_arena(arena);
        if (code != TOUCH_MEMORY || is_last) break;
    }
    PyEval_RestoreThread(state);
    if (code) fail(code, text);
    return !code;
}

/* -- supports -------------------------------------------------------------------------------------------------------- */

typedef struct {
    touch_grid grid;
    touch_samples support, previous;
    int has_previous;
    touch_bytes code;
    buffer_list arrays; /* what these point into */
} support_call;

/* A support: (bricks, samples). 0: an error is raised. */
static inline int read_support(buffer_list *arrays, PyObject *support, touch_samples *out) {
    PyObject *bricks, *is_set;
    int64_t count = -1;
    if (!PyArg_ParseTuple(support, "OO", &bricks, &is_set)) return 0;
    if (!(out->brick = (const int32_t *)add_array(arrays, bricks, 12, &count))) return 0;
    if (!(out->is_set = (const uint8_t *)add_array(arrays, is_set, 512, &count))) return 0;
    out->bricks = (uint64_t)count;
    return 1;
}

/* The previous support, if it is not None. 0: an error is raised. */
static inline int read_previous(support_call *self, PyObject *previous) {
    self->has_previous = !is_none(previous);
    return !self->has_previous || read_support(&self->arrays, previous, &self->previous);
}

static inline int encode_support_in(void *call, touch_arena *arena, const char **text) {
    support_call *self = (support_call *)call;
    return touch_encode_support(&self->grid, &self->support, self->has_previous ? &self->previous : NULL, arena, &self->code,
                                text);
}

static inline PyObject *native_encode_support(PyObject *module, PyObject *arguments) {
    PyObject *shape, *support, *previous, *result = NULL;
    touch_arena arena;
    support_call self;
    (void)module;
    memset(&self, 0, sizeof self);
    if (!PyArg_ParseTuple(arguments, "OOO", &shape, &support, &previous)) return NULL;
    if (read_wide_shape(shape, &self.grid) && read_support(&self.arrays, support, &self.support) &&
        read_previous(&self, previous)) {
        uint64_t room = touch_part_room(self.support.bricks + self.previous.bricks, 0, 2);
        if (run_part(encode_support_in, &self, room, room, &arena)) {
            result = bytes_of(self.code.bytes, self.code.size);
            free_part_arena(&arena);
        }
    }
    release_arrays(&self.arrays);
    return result;
}

static inline int decode_support_in(void *call, touch_arena *arena, const char **text) {
    support_call *self = (support_call *)call;
    return touch_decode_support(&self->grid, self->code, self->has_previous ? &self->previous : NULL, arena, &self->support,
                                text);
}

static inline PyObject *native_decode_support(PyObject *module, PyObject *arguments) {
    PyObject *shape, *data, *previous, *result = NULL;
    int64_t size = -1;
    touch_arena arena;
    support_call self;
    (void)module;
    memset(&self, 0, sizeof self);
    if (!PyArg_ParseTuple(arguments, "OOO", &shape, &data, &previous)) return NULL;
    if (read_wide_shape(shape, &self.grid) && (self.code.bytes = (const uint8_t *)add_array(&self.arrays, data, 1, &size)) &&
        read_previous(&self, previous)) {
        self.code.size = (uint64_t)size;
        uint64_t first = ((uint64_t)1 << 20) + 256 * self.code.size + 768 * self.previous.bricks;
        if (run_part(decode_support_in, &self, first, touch_support_room(&self.grid, self.code.size, self.previous.bricks),
                     &arena)) {
            PyObject *bricks = bytes_of(self.support.brick, 12 * self.support.bricks);
            PyObject *is_set = bricks ? bytes_of(self.support.is_set, 512 * self.support.bricks) : NULL;
            if (is_set) result = Py_BuildValue("NN", bricks, is_set);
            else if (bricks) Py_DecRef(bricks);
            free_part_arena(&arena);
        }
    }
    release_arrays(&self.arrays);
    return result;
}

/* -- whole numbers and poses ----------------------------------------------------------------------------------------- */

typedef struct {
    const int64_t *numbers; /* that are encoded */
    int64_t *decoded;
    uint64_t count;
    int64_t one; /* of poses */
    touch_bytes code;
} numbers_call;

static inline int encode_numbers_in(void *call, touch_arena *arena, const char **text) {
    numbers_call *self = (numbers_call *)call;
    return touch_encode_numbers(self->numbers, self->count, arena, &self->code, text);
}

static inline int encode_poses_in(void *call, touch_arena *arena, const char **text) {
    numbers_call *self = (numbers_call *)call;
    return touch_encode_poses(self->numbers, (uint32_t)self->count, arena, &self->code, text);
}

static inline int decode_numbers_in(void *call, touch_arena *arena, const char **text) {
    numbers_call *self = (numbers_call *)call;
    return touch_decode_numbers(self->code, self->count, arena, self->decoded, text);
}

static inline int decode_poses_in(void *call, touch_arena *arena, const char **text) {
    numbers_call *self = (numbers_call *)call;
    return touch_decode_poses(self->code, (uint32_t)self->count, self->one, arena, self->decoded, text);
}

/* The code of rows of so many int64. */
static inline PyObject *encode_rows(PyObject *numbers, uint64_t columns, part_work work) {
    numbers_call self;
    int64_t count = -1;
    touch_arena arena;
    Py_buffer view;
    PyObject *result = NULL;
    memset(&self, 0, sizeof self);
    if (!read_array(numbers, 8 * columns, &count, &view)) return NULL;
    self.numbers = (const int64_t *)view.buf, self.count = (uint64_t)count;
    uint64_t room = touch_part_room(0, columns * self.count + 14, 0);
    if (self.count && (uintptr_t)view.buf % 8) refuse(TOUCH_ARGUMENT, "numbers that are not aligned");
    else if (columns > 1 && self.count > UINT32_MAX) refuse(TOUCH_ARGUMENT, "too many poses");
    else if (run_part(work, &self, room, room, &arena)) {
        result = bytes_of(self.code.bytes, self.code.size);
        free_part_arena(&arena);
    }
    PyBuffer_Release(&view);
    return result;
}

/* Rows of so many int64 from a code; `one` is that of poses. */
static inline PyObject *decode_rows(PyObject *data, Py_ssize_t count, uint64_t columns, int64_t one, part_work work) {
    numbers_call self;
    int64_t size = -1;
    touch_arena arena;
    Py_buffer view;
    void *decoded;
    if (count < 0 || (uint64_t)count > UINT32_MAX) return fail(TOUCH_ARGUMENT, "a number of numbers that there is not");
    if (!read_array(data, 1, &size, &view)) return NULL;
    PyObject *result = new_bytes(8 * columns * (uint64_t)count, &decoded);
    if (result) {
        memset(&self, 0, sizeof self);
        self.code.bytes = (const uint8_t *)view.buf, self.code.size = (uint64_t)size;
        self.decoded = (int64_t *)decoded, self.count = (uint64_t)count, self.one = one;
        if (run_part(work, &self, TOUCH_FIXED_ROOM, TOUCH_FIXED_ROOM, &arena)) free_part_arena(&arena);
        else {
            Py_DecRef(result);
            result = NULL;
        }
    }
    PyBuffer_Release(&view);
    return result;
}

static inline PyObject *native_encode_numbers(PyObject *module, PyObject *numbers) {
    (void)module;
    return encode_rows(numbers, 1, encode_numbers_in);
}

static inline PyObject *native_encode_poses(PyObject *module, PyObject *numbers) {
    (void)module;
    return encode_rows(numbers, 7, encode_poses_in);
}

static inline PyObject *native_decode_numbers(PyObject *module, PyObject *arguments) {
    PyObject *data;
    Py_ssize_t count;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "On", &data, &count)) return NULL;
    return decode_rows(data, count, 1, 0, decode_numbers_in);
}

static inline PyObject *native_decode_poses(PyObject *module, PyObject *arguments) {
    PyObject *data;
    Py_ssize_t count;
    long long one;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OnL", &data, &count, &one)) return NULL;
    return decode_rows(data, count, 7, one, decode_poses_in);
}

/* -- vibration ------------------------------------------------------------------------------------------------------- */

typedef struct {
    touch_grid grid;
    touch_vibration_samples *frames; /* that are encoded */
    touch_vibration_steps *decoded;
    uint32_t count;
    uint64_t samples, max_samples; /* of all frames */
    touch_bytes body;
    buffer_list arrays; /* what these point into */
} vibration_call;

static inline void release_vibration(vibration_call *self) {
    free(self->frames), free(self->decoded);
    release_arrays(&self->arrays);
}

/* A frame: (positions, amplitudes, frequencies). 0: an error is raised. */
static inline int read_vibration(vibration_call *self, PyObject *frame, touch_vibration_samples *out) {
    PyObject *position, *amplitude_n, *frequency_hz;
    int64_t count = -1;
    if (!PyArg_ParseTuple(frame, "OOO", &position, &amplitude_n, &frequency_hz)) return 0;
    if (!(out->position = (const int32_t *)add_array(&self->arrays, position, 12, &count))) return 0;
    if (!(out->amplitude_n = (const float *)add_array(&self->arrays, amplitude_n, 4, &count))) return 0;
    if (!(out->frequency_hz = (const float *)add_array(&self->arrays, frequency_hz, 4, &count))) return 0;
    out->samples = (uint64_t)count, self->samples += out->samples;
    return 1;
}

static inline int read_vibrations(vibration_call *self, PyObject *frames) {
    Py_ssize_t count = PySequence_Size(frames);
    if (count < 0) return 0;
    if ((uint64_t)count > INT32_MAX) return refuse(TOUCH_ARGUMENT, "too many frames");
    self->frames = (touch_vibration_samples *)calloc((size_t)count + 1, sizeof *self->frames);
    if (!self->frames) return refuse(TOUCH_MEMORY, "not enough memory");
    for (self->count = 0; self->count < (uint32_t)count; self->count++) {
        PyObject *frame = PySequence_GetItem(frames, (Py_ssize_t)self->count);
        if (!frame) return 0;
        int is_read = read_vibration(self, frame, self->frames + self->count);
        Py_DecRef(frame); /* its buffers hold what is read */
        if (!is_read) return 0;
    }
    return 1;
}

static inline int encode_vibration_in(void *call, touch_arena *arena, const char **text) {
    vibration_call *self = (vibration_call *)call;
    return touch_encode_vibration(&self->grid, self->frames, self->count, arena, &self->body, text);
}

static inline PyObject *native_encode_vibration(PyObject *module, PyObject *arguments) {
    PyObject *shape, *frames, *result = NULL;
    touch_arena arena;
    vibration_call self;
    (void)module;
    memset(&self, 0, sizeof self);
    if (!PyArg_ParseTuple(arguments, "OO", &shape, &frames)) return NULL;
    if (read_wide_shape(shape, &self.grid) && read_vibrations(&self, frames)) {
        uint64_t first = ((uint64_t)1 << 20) + 4096 * (uint64_t)self.count + 640 * self.samples;
        uint64_t max = touch_part_room(self.samples, 2 * self.samples, self.count); /* a brick has a sample at least */
        if (run_part(encode_vibration_in, &self, first, max, &arena)) {
            result = bytes_of(self.body.bytes, self.body.size);
            free_part_arena(&arena);
        }
    }
    release_vibration(&self);
    return result;
}

static inline int decode_vibration_in(void *call, touch_arena *arena, const char **text) {
    vibration_call *self = (vibration_call *)call;
    return touch_decode_vibration(&self->grid, self->body, self->count, self->max_samples, arena, self->decoded, text);
}

/* (positions, steps of amplitude, hertz) of a frame; NULL: an error is raised. */
static inline PyObject *vibration_result(const touch_vibration_steps *frame) {
    PyObject *position = bytes_of(frame->position, 12 * frame->samples), *step = NULL, *hertz = NULL;
    if (position) step = bytes_of(frame->step, 4 * frame->samples);
    if (step) hertz = bytes_of(frame->hertz, 4 * frame->samples);
    if (hertz) return Py_BuildValue("NNN", position, step, hertz);
    if (step) Py_DecRef(step);
    if (position) Py_DecRef(position);
    return NULL;
}

static inline PyObject *vibration_results(const vibration_call *self) {
    PyObject *list = PyList_New((Py_ssize_t)self->count);
    for (uint32_t i = 0; list && i < self->count; i++) {
        PyObject *frame = vibration_result(self->decoded + i);
        if (frame && !PyList_SetItem(list, (Py_ssize_t)i, frame)) continue; /* the list owns the frame, in any case */
        Py_DecRef(list);
        list = NULL;
    }
    return list;
}

static inline PyObject *native_decode_vibration(PyObject *module, PyObject *arguments) {
    PyObject *shape, *body, *result = NULL;
    Py_ssize_t count, max_samples;
    int64_t size = -1;
    touch_arena arena;
    vibration_call self;
    (void)module;
    memset(&self, 0, sizeof self);
    if (!PyArg_ParseTuple(arguments, "OOnn", &shape, &body, &count, &max_samples)) return NULL;
    if (count < 0 || count > INT32_MAX || max_samples < 0) return fail(TOUCH_ARGUMENT, "a number of frames or of samples");
    if (read_wide_shape(shape, &self.grid) && (self.body.bytes = (const uint8_t *)add_array(&self.arrays, body, 1, &size))) {
        self.body.size = (uint64_t)size, self.count = (uint32_t)count, self.max_samples = (uint64_t)max_samples;
        uint32_t frames = touch_vibration_frames(self.body.size, self.count);
        uint64_t first = ((uint64_t)2 << 20) + 512 * (frames + self.body.size);
        self.decoded = (touch_vibration_steps *)calloc((size_t)frames + 1, sizeof *self.decoded);
        if (!self.decoded) fail_for_memory();
        else if (run_part(decode_vibration_in, &self, first, touch_vibration_room(&self.grid, self.body.size, self.count),
                          &arena)) {
            result = vibration_results(&self);
            free_part_arena(&arena);
        }
    }
    release_vibration(&self);
    return result;
}

/* clang-format off */
#define PARTS_METHODS \
    {"encode_support", native_encode_support, METH_VARARGS, "The code of a support."}, \
    {"decode_support", native_decode_support, METH_VARARGS, "Bricks and samples of a support."}, \
    {"encode_numbers", native_encode_numbers, METH_O, "The code of whole numbers."}, \
    {"decode_numbers", native_decode_numbers, METH_VARARGS, "Whole numbers of a code."}, \
    {"encode_vibration", native_encode_vibration, METH_VARARGS, "The body of VIBR."}, \
    {"decode_vibration", native_decode_vibration, METH_VARARGS, "Positions, amplitudes and frequencies of each frame."}, \
    {"encode_poses", native_encode_poses, METH_O, "The code of poses in steps."}, \
    {"decode_poses", native_decode_poses, METH_VARARGS, "Poses of a code, in steps."}
/* clang-format on */

#endif
