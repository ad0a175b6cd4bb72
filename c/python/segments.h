/* The functions of `touchfield._native` that encode and decode segments of coder `touch`: open_fields, next_field,
   encode_segment, is_static, add_exact_samples. src/touchfield/_native.pyi describes them. */
#ifndef TOUCHFIELD_SEGMENTS_H
#define TOUCHFIELD_SEGMENTS_H

#include "arguments.h"

#define BRICK_ITEMS ((uint64_t)512)
#define BRICK_FORCES ((uint64_t)6144) /* bytes: 512 samples of three float32 */

/* -- decoding -------------------------------------------------------------------------------------------------------- */

static const char fields_name[] = "touchfield._native.fields";

/* Bytes for a decoder and for a frame to begin with, and how much more there is after each start from the beginning. Few
   segments need more; the worst case that their bytes allow may be more than a machine can give. */
enum { FIRST_DECODER_BYTES = 256 << 20, FIRST_FRAME_BYTES = 48 << 20, MORE = 4 };

typedef struct {
    touch_decoder decoder;
    touch_arena memory, frame_memory;
    uint64_t max_memory, max_frame_memory;
    touch_grid grid;
    touch_bytes parameters, body;
    uint32_t frame_count, delivered;
    buffer_list arrays; /* what `parameters` and `body` point into */
} open_fields;

static inline void close_fields(open_fields *self) {
    free_arena(&self->memory), free_arena(&self->frame_memory);
    release_arrays(&self->arrays);
    free(self);
}

static inline void free_fields(PyObject *capsule) {
    close_fields((open_fields *)PyCapsule_GetPointer(capsule, fields_name));
}

static inline uint64_t smaller(uint64_t a, uint64_t b) { return a < b ? a : b; }

/* Decode from the beginning, with memory of so many bytes; the code of touch.h. */
static inline int start_fields(open_fields *self, uint64_t memory, uint64_t frame_memory) {
    free_arena(&self->memory), free_arena(&self->frame_memory);
    self->memory = take_arena(smaller(memory, self->max_memory));
    self->frame_memory = take_arena(smaller(frame_memory, self->max_frame_memory));
    self->decoder.error = "not enough memory";
    if (!self->memory.base || !self->frame_memory.base) return TOUCH_MEMORY;
    return touch_start_body(&self->decoder, &self->grid, self->parameters, self->body, self->frame_count, self->memory);
}

/* The next frame; where the memory is too small, all frames so far are decoded again with more. */
static inline int next_frame(open_fields *self, touch_frame *frame) {
    self->frame_memory.used = 0;
    int code = touch_next(&self->decoder, &self->frame_memory, frame);
    while (code == TOUCH_MEMORY) {
        uint64_t memory = self->memory.size, frame_memory = self->frame_memory.size;
        if (memory >= self->max_memory && frame_memory >= self->max_frame_memory) break;
        code = start_fields(self, MORE * memory, MORE * frame_memory);
        for (uint32_t n = 0; n <= self->delivered && !code; n++) {
            self->frame_memory.used = 0;
            code = touch_next(&self->decoder, &self->frame_memory, frame);
        }
    }
    self->delivered += !code;
    return code;
}

static inline PyObject *native_open_fields(PyObject *module, PyObject *arguments) {
    PyObject *shape, *parameters, *body;
    Py_ssize_t frame_count;
    int64_t size[2] = {-1, -1};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOn", &shape, &parameters, &body, &frame_count)) return NULL;
    open_fields *self = (open_fields *)calloc(1, sizeof *self);
    if (!self) return fail_for_memory();
    if (!read_shape(shape, &self->grid) || !(self->parameters.bytes = add_array(&self->arrays, parameters, 1, size)) ||
        !(self->body.bytes = add_array(&self->arrays, body, 1, size + 1))) {
        close_fields(self);
        return NULL;
    }
    self->parameters.size = (uint64_t)size[0], self->body.size = (uint64_t)size[1];
    if (frame_count < 0 || frame_count > INT32_MAX) {
        close_fields(self);
        return fail(TOUCH_ARGUMENT, "a number of frames that there is not");
    }
    self->frame_count = (uint32_t)frame_count;
    touch_body_room(&self->grid, self->body, &self->max_memory, &self->max_frame_memory);
    PyThreadState *state = PyEval_SaveThread();
    int code = start_fields(self, FIRST_DECODER_BYTES, FIRST_FRAME_BYTES);
    PyEval_RestoreThread(state);
    if (code) {
        fail(code, self->decoder.error);
        close_fields(self);
        return NULL;
    }
    PyObject *capsule = PyCapsule_New(self, fields_name, free_fields);
    if (!capsule) close_fields(self);
    return capsule;
}

/* The bricks of a field that have a force, in the order of their raster: their numbers in `key`, their places in the field
   in `slot`; returns how many there are. */
static inline uint64_t order_bricks(const touch_field *field, uint64_t *key, uint32_t *slot) {
    uint64_t count = 0;
    for (uint64_t i = 0; i <= field->mask; i++) {
        uint32_t number = field->table[2 * i], at = field->table[2 * i + 1], any = 0, bits[3];
        const float *forces = field->forces_n + 1536 * (uint64_t)at;
        for (uint64_t n = 0; n < 1536 && number && !any; n += 3) {
            memcpy(bits, forces + n, sizeof bits);
            any = bits[0] | bits[1] | bits[2];
        }
        if (any) key[count] = number - 1, slot[count++] = at;
    }
    touch_sort(key, slot, count);
    return count;
}

/* Write bricks int32 [n, 3] and forces float32 [n, 8, 8, 8, 3]. */
static inline void write_bricks(const touch_field *field, const uint64_t *key, const uint32_t *slot, uint64_t count,
                                int32_t *bricks, uint8_t *forces) {
    uint64_t by = (field->grid.shape[1] + 7) >> 3, bz = (field->grid.shape[2] + 7) >> 3;
    for (uint64_t i = 0; i < count; i++) {
        bricks[3 * i] = (int32_t)(key[i] / (by * bz)), bricks[3 * i + 1] = (int32_t)(key[i] / bz % by);
        bricks[3 * i + 2] = (int32_t)(key[i] % bz);
        memcpy(forces + BRICK_FORCES * i, field->forces_n + 1536 * (uint64_t)slot[i], (size_t)BRICK_FORCES);
    }
}

/* Bricks and forces of a field; NULL: an error is raised. */
static inline PyObject *field_result(const touch_field *field) {
    uint64_t *key = (uint64_t *)malloc((size_t)(12 * ((uint64_t)field->bricks + 1))), count;
    void *bricks_at, *forces_at;
    if (!key) return fail_for_memory();
    uint32_t *slot = (uint32_t *)(void *)(key + field->bricks + 1);
    PyThreadState *state = PyEval_SaveThread();
    count = order_bricks(field, key, slot);
    PyEval_RestoreThread(state);
    PyObject *bricks = new_bytes(12 * count, &bricks_at), *forces = bricks ? new_bytes(BRICK_FORCES * count, &forces_at) : NULL;
    if (forces) {
        state = PyEval_SaveThread();
        write_bricks(field, key, slot, count, (int32_t *)bricks_at, (uint8_t *)forces_at);
        PyEval_RestoreThread(state);
    }
    free(key);
    if (forces) return Py_BuildValue("NN", bricks, forces);
    if (bricks) Py_DecRef(bricks);
    return NULL;
}

static inline PyObject *native_next_field(PyObject *module, PyObject *capsule) {
    touch_frame frame;
    (void)module;
    open_fields *self = (open_fields *)PyCapsule_GetPointer(capsule, fields_name);
    if (!self) return NULL;
    PyThreadState *state = PyEval_SaveThread();
    int code = next_frame(self, &frame);
    PyEval_RestoreThread(state);
    if (code == TOUCH_END) return none();
    return code ? fail(code, self->decoder.error) : field_result(frame.part[0].field);
}

/* -- arguments of encoders ------------------------------------------------------------------------------------------- */

/* Spacings and options; 0: an error is raised. */
static inline int read_options(PyObject *spacing_m, PyObject *options, touch_grid *grid, touch_options *o) {
    double *h = grid->spacing_m;
    memset(o, 0, sizeof *o);
    if (!PyArg_ParseTuple(spacing_m, "ddd", h, h + 1, h + 2)) return 0;
    if (!PyArg_ParseTuple(options, "iiiiidddd", &o->mode, &o->is_support_exact, &o->interframe, &o->has_base_layers,
                          &o->is_checked, &o->k, &o->f0_n, &o->direction_jnd_deg, &o->step_n))
        return 0;
    if (o->mode >= TOUCH_MASK && o->mode <= TOUCH_LOSSLESS && o->interframe >= 0 && o->interframe <= TOUCH_INTER_ON) return 1;
    return refuse(TOUCH_ARGUMENT, "a mode that there is not");
}

/* A frame: (bricks, forces, hidden or None). 0: an error is raised. */
static inline int read_frame(buffer_list *arrays, PyObject *frame, touch_source *source) {
    PyObject *bricks, *forces, *hidden;
    int64_t count = -1;
    memset(source, 0, sizeof *source);
    if (!PyArg_ParseTuple(frame, "OOO", &bricks, &forces, &hidden)) return 0;
    if (!(source->brick = (const int32_t *)add_array(arrays, bricks, 12, &count))) return 0;
    if (!(source->forces_n = (const float *)add_array(arrays, forces, BRICK_FORCES, &count))) return 0;
    source->bricks = (uint64_t)count;
    if (is_none(hidden)) return 1;
    return (source->hidden_n = (const float *)add_array(arrays, hidden, 4 * BRICK_ITEMS, &count)) != NULL;
}

typedef struct { /* frames, with what they point into, and a number of each */
    touch_source *source;
    uint64_t *decoded, count, capacity, bricks; /* the most bricks of a frame */
    buffer_list arrays;
} frame_list;

static inline void release_frames(frame_list *list) {
    free(list->source), free(list->decoded);
    release_arrays(&list->arrays);
}

/* Add a frame; 0: an error is raised. */
static inline int add_frame(frame_list *list, PyObject *frame) {
    if (list->count == list->capacity) {
        uint64_t capacity = 2 * list->capacity + 16;
        touch_source *source = (touch_source *)realloc(list->source, (size_t)capacity * sizeof *source);
        if (source) list->source = source;
        uint64_t *decoded = (uint64_t *)realloc(list->decoded, (size_t)capacity * sizeof *decoded);
        if (decoded) list->decoded = decoded;
        if (!source || !decoded) return refuse(TOUCH_MEMORY, "not enough memory");
        list->capacity = capacity;
    }
    touch_source *own = list->source + list->count;
    if (!read_frame(&list->arrays, frame, own)) return 0;
    list->decoded[list->count++] = 0;
    if (own->bricks > list->bricks) list->bricks = own->bricks;
    return 1;
}

/* Add the next frame of an iterator: 1, 0 if there is none, or -1 if an error is raised. */
static inline int add_next_frame(frame_list *list, PyObject *iterator) {
    PyObject *frame = PyIter_Next(iterator);
    if (!frame) return PyErr_Occurred() ? -1 : 0;
    int is_added = add_frame(list, frame);
    Py_DecRef(frame); /* its buffers hold what is read */
    return is_added ? 1 : -1;
}

/* Add all frames of an iterable; 0: an error is raised. */
static inline int add_frames(frame_list *list, PyObject *frames) {
    PyObject *iterator = PyObject_GetIter(frames);
    int added = iterator ? 1 : -1;
    while (added > 0) added = add_next_frame(list, iterator);
    if (iterator) Py_DecRef(iterator);
    return added == 0;
}

/* The body of a segment, the decoded voxels of each frame, and the largest error. NULL: an error is raised. */
static inline PyObject *segment_result(const touch_segment *segment, const frame_list *frames) {
    PyObject *counts = PyList_New((Py_ssize_t)frames->count), *body;
    for (uint64_t i = 0; i < frames->count && counts; i++) {
        PyObject *number = PyLong_FromUnsignedLongLong((unsigned long long)frames->decoded[i]);
        if (number && !PyList_SetItem(counts, (Py_ssize_t)i, number)) continue; /* the list owns the number, in any case */
        Py_DecRef(counts);
        return NULL;
    }
    if (!counts) return NULL;
    body = bytes_of(segment->body, segment->size);
    if (!body) {
        Py_DecRef(counts);
        return NULL;
    }
    const uint32_t *voxel = segment->max_error_voxel;
    return Py_BuildValue("NN(dI(III))", body, counts, segment->max_error_ratio, segment->max_error_frame, voxel[0], voxel[1],
                         voxel[2]);
}

/* -- encoding -------------------------------------------------------------------------------------------------------- */

typedef struct { /* a Python function that fits splines, called from C with the GIL */
    PyObject *function;
    PyThreadState *state; /* while C works without the GIL */
    int frame, has_failed;
    Py_buffer coefficients; /* of the latest spline */
    int has_coefficients;
} spline_caller;

static inline void release_coefficients(spline_caller *self) {
    if (self->has_coefficients) PyBuffer_Release(&self->coefficients);
    self->has_coefficients = 0;
}

/* Read (shifts, step, scales, coefficients); 0: an error is raised. */
static inline int read_spline(spline_caller *self, PyObject *result, touch_spline *out) {
    PyObject *coefficients;
    int shift[3];
    long long step, scale[3];
    int64_t nodes = -1;
    if (!PyArg_ParseTuple(result, "(iii)L(LLL)O", shift, shift + 1, shift + 2, &step, scale, scale + 1, scale + 2,
                          &coefficients))
        return 0;
    for (int n = 0; n < 3; n++) {
        if (shift[n] < 2 || shift[n] > 5 || scale[n] < 1 || scale[n] >= 1 << 20 || step < 1 || step >= 1 << 20)
            return refuse(TOUCH_ARGUMENT, "a spline that cannot be coded");
        out->shift[n] = shift[n], out->scale[n] = scale[n];
    }
    if (!read_array(coefficients, 8, &nodes, &self->coefficients)) return 0;
    self->has_coefficients = 1;
    out->step = step, out->coefficient = (const double *)self->coefficients.buf, out->nodes = (uint64_t)nodes;
    return 1;
}

/* `touch_spline_fit`: 1 if there is a spline. After an exception of Python no further spline is fitted. */
static inline int call_fit(void *caller, const touch_source *frame, int level, double unit_n, double k, double f0,
                           touch_spline *out) {
    spline_caller *self = (spline_caller *)caller;
    int is_fitted = 0;
    (void)frame;
    if (self->has_failed) return 0;
    PyEval_RestoreThread(self->state);
    release_coefficients(self);
    PyObject *result = PyObject_CallFunction(self->function, "iiddd", self->frame, level, unit_n, k, f0);
    if (!result) self->has_failed = 1;
    else if (!is_none(result)) is_fitted = read_spline(self, result, out), self->has_failed = !is_fitted;
    if (result) Py_DecRef(result);
    self->state = PyEval_SaveThread();
    return is_fitted;
}

typedef struct { /* an encoder of one segment, with its memory */
    touch_encoder encoder;
    touch_grid grid;
    touch_options options;
    touch_arena work;
    uint64_t work_bricks; /* that `work` is enough for */
    void *out;
    frame_list frames, key;
    spline_caller splines;
    int has_splines, is_started;
} segment_encoder;

static inline void release_encoder(segment_encoder *self) {
    free_arena(&self->work);
    free(self->out);
    release_frames(&self->frames), release_frames(&self->key);
    release_coefficients(&self->splines);
}

/* `touch_encoder.grow` */
static inline void *grow_out(void *owner, void *out, uint64_t size) {
    segment_encoder *self = (segment_encoder *)owner;
    void *grown = size <= SIZE_MAX / 2 ? realloc(out, (size_t)size) : NULL;
    if (grown) self->out = grown;
    return grown;
}

/* Memory for frames of so many bricks: at first as given, later for half as many more. The code of touch.h. */
static inline int need_work(segment_encoder *self, uint64_t bricks) {
    if (self->work.base && bricks <= self->work_bricks) return TOUCH_OK;
    if (self->is_started) bricks += bricks / 2;
    touch_arena work = take_arena(touch_encode_room(&self->grid, &self->options, bricks));
    self->encoder.error = "not enough memory";
    if (!work.base) return TOUCH_MEMORY;
    int code = self->is_started ? touch_encode_move(&self->encoder, work) : TOUCH_OK;
    free_arena(&self->work);
    self->work = work, self->work_bricks = bricks;
    return code;
}

/* Start a segment, with memory for the frames that are known. The code of touch.h. */
static inline int start_segment(segment_encoder *self, double longest_n) {
    enum { FIRST_OUT_BYTES = 1 << 20 };
    uint64_t bricks = self->key.bricks > self->frames.bricks ? self->key.bricks : self->frames.bricks;
    if (self->key.count) { /* its unit is kept if possible, so that segments with one key frame share it */
        double key_longest_n = touch_longest_n(self->key.source);
        longest_n = longest_n > 1.01 * key_longest_n ? longest_n : key_longest_n;
    }
    int code = need_work(self, bricks);
    if (code) return code;
    self->encoder.error = "not enough memory";
    self->out = malloc(FIRST_OUT_BYTES);
    if (!self->out) return TOUCH_MEMORY;
    self->encoder.grow = grow_out, self->encoder.self = self;
    code = touch_encode_start(&self->encoder, &self->grid, &self->options, longest_n, self->work,
                              touch_arena_of(self->out, FIRST_OUT_BYTES));
    self->is_started = 1;
    return code;
}

/* Code frame `n`, the first one as the key frame if there is one. The code of touch.h, without the GIL. */
static inline int encode_frame(segment_encoder *self, uint64_t n) {
    const touch_source *coded = !n && self->key.count ? self->key.source : NULL;
    touch_spline_fit splines = {call_fit, &self->splines};
    int code = need_work(self, self->frames.source[n].bricks);
    if (code) return code;
    self->splines.frame = coded ? -1 : (int)n, self->encoder.decoded = self->frames.decoded;
    return touch_encode_next(&self->encoder, self->frames.source + n, coded, self->has_splines ? &splines : NULL);
}

/* Code a frame with the GIL released; 0: an error is raised. */
static inline int add_to_segment(segment_encoder *self, uint64_t n) {
    self->splines.state = PyEval_SaveThread();
    int code = encode_frame(self, n);
    PyEval_RestoreThread(self->splines.state);
    if (self->splines.has_failed) return 0;
    return code ? refuse(code, self->encoder.error) : 1;
}

/* Start and code all frames: those that are known, then those of an iterator, as they come. 0: an error is raised. */
static inline int encode_frames(segment_encoder *self, PyObject *iterator, double longest_n) {
    int added = 1;
    PyThreadState *state = PyEval_SaveThread();
    for (uint64_t i = 0; i < self->frames.count && !iterator; i++) {
        double own_n = touch_longest_n(self->frames.source + i);
        if (own_n > longest_n) longest_n = own_n;
    }
    int code = iterator ? TOUCH_OK : start_segment(self, longest_n);
    PyEval_RestoreThread(state);
    for (uint64_t n = 0; !code; n++) {
        if (iterator) added = add_next_frame(&self->frames, iterator);
        if (added < 0) return 0;
        if (n == self->frames.count) break;
        if (iterator && !n) code = start_segment(self, longest_n);
        if (!code && !add_to_segment(self, n)) return 0;
    }
    if (!code && !self->frames.count) return refuse(TOUCH_ARGUMENT, "no frames");
    return code ? refuse(code, self->encoder.error) : 1;
}

/* The finished segment of an encoder that has all frames; NULL: an error is raised. */
static inline PyObject *finish_segment(segment_encoder *self) {
    touch_segment segment;
    self->encoder.decoded = self->frames.decoded;
    PyThreadState *state = PyEval_SaveThread();
    int code = touch_encode_finish(&self->encoder, self->frames.source, &segment);
    PyEval_RestoreThread(state);
    return code ? fail(code, self->encoder.error) : segment_result(&segment, &self->frames);
}

static inline PyObject *native_encode_segment(PyObject *module, PyObject *arguments) {
    PyObject *shape, *spacing_m, *options, *frames, *key_frame, *longest, *fit_spline, *iterator = NULL, *result = NULL;
    segment_encoder self;
    (void)module;
    memset(&self, 0, sizeof self);
    if (!PyArg_ParseTuple(arguments, "OOOOOOO", &shape, &spacing_m, &options, &frames, &key_frame, &longest, &fit_spline))
        return NULL;
    double longest_n = is_none(longest) ? 0 : PyFloat_AsDouble(longest);
    if (PyErr_Occurred()) return NULL;
    self.splines.function = fit_spline, self.has_splines = !is_none(fit_spline);
    if (!read_shape(shape, &self.grid) || !read_options(spacing_m, options, &self.grid, &self.options)) return NULL;
    int is_read = is_none(key_frame) || add_frame(&self.key, key_frame);
    if (is_read && is_none(longest)) is_read = add_frames(&self.frames, frames);
    else if (is_read) is_read = (iterator = PyObject_GetIter(frames)) != NULL;
    if (is_read && encode_frames(&self, iterator, longest_n)) result = finish_segment(&self);
    if (iterator) Py_DecRef(iterator);
    release_encoder(&self);
    return result;
}

static inline PyObject *native_is_static(PyObject *module, PyObject *arguments) {
    PyObject *shape, *spacing_m, *options, *frame, *earlier;
    touch_grid grid;
    touch_options o;
    frame_list frames;
    int result = -1;
    (void)module;
    memset(&frames, 0, sizeof frames);
    if (!PyArg_ParseTuple(arguments, "OOOOO", &shape, &spacing_m, &options, &frame, &earlier)) return NULL;
    if (!read_shape(shape, &grid) || !read_options(spacing_m, options, &grid, &o)) return NULL;
    if (add_frame(&frames, frame) && add_frame(&frames, earlier)) {
        PyThreadState *state = PyEval_SaveThread();
        touch_arena work = take_arena(4096 + 32 * frames.bricks);
        result = touch_is_static(&grid, &o, frames.source, frames.source + 1, work);
        free_arena(&work);
        PyEval_RestoreThread(state);
        if (result < 0) fail_for_memory();
    }
    release_frames(&frames);
    return result < 0 ? NULL : PyBool_FromLong(result);
}

/* Samples of each frame, uint64 [m]; `total` is the number of all. 0: an error is raised. */
static inline int read_samples(PyObject *samples, uint64_t count, touch_outlier_samples *exact, buffer_list *arrays,
                               uint64_t *total) {
    if (PySequence_Size(samples) != (Py_ssize_t)count)
        return PyErr_Occurred() ? 0 : refuse(TOUCH_ARGUMENT, "samples of another number of frames");
    for (uint64_t i = 0; i < count; i++) {
        PyObject *own = PySequence_GetItem(samples, (Py_ssize_t)i);
        int64_t items = -1;
        exact[i].sample = own ? (const uint64_t *)add_array(arrays, own, 8, &items) : NULL;
        if (own) Py_DecRef(own);
        if (!exact[i].sample) return 0;
        exact[i].samples = (uint64_t)items, *total += (uint64_t)items;
    }
    return 1;
}

/* The body with more outliers, of an encoder that has the frames and memory; NULL: an error is raised. */
static inline PyObject *encode_exact(segment_encoder *self, touch_bytes body, const touch_outlier_samples *exact,
                                     uint64_t total) {
    touch_segment segment;
    uint64_t size = 4096 + body.size + TOUCH_OUTLIER_BYTES * total + TOUCH_RECORD_BYTES * self->frames.count;
    PyThreadState *state = PyEval_SaveThread();
    int code = need_work(self, self->frames.bricks);
    self->out = malloc((size_t)size);
    self->encoder.decoded = self->frames.decoded, self->encoder.grow = grow_out, self->encoder.self = self;
    if (!code && self->out)
        code = touch_encode_with_outliers(&self->encoder, &self->grid, &self->options, body, self->frames.source, exact,
                                       (uint32_t)self->frames.count, self->work, touch_arena_of(self->out, size), &segment);
    PyEval_RestoreThread(state);
    if (!self->out) return fail_for_memory();
    return code ? fail(code, self->encoder.error) : segment_result(&segment, &self->frames);
}

static inline PyObject *native_add_exact_samples(PyObject *module, PyObject *arguments) {
    PyObject *shape, *spacing_m, *options, *body, *frames, *samples, *result = NULL;
    segment_encoder self;
    touch_outlier_samples *exact = NULL;
    touch_bytes bytes;
    uint64_t total = 0;
    int64_t size = -1;
    (void)module;
    memset(&self, 0, sizeof self);
    if (!PyArg_ParseTuple(arguments, "OOOOOO", &shape, &spacing_m, &options, &body, &frames, &samples)) return NULL;
    if (!read_shape(shape, &self.grid) || !read_options(spacing_m, options, &self.grid, &self.options)) return NULL;
    bytes.bytes = (const uint8_t *)add_array(&self.frames.arrays, body, 1, &size), bytes.size = (uint64_t)size;
    if (bytes.bytes && add_frames(&self.frames, frames)) {
        exact = (touch_outlier_samples *)calloc((size_t)self.frames.count + 1, sizeof *exact);
        if (!exact) fail_for_memory();
        else if (read_samples(samples, self.frames.count, exact, &self.frames.arrays, &total))
            result = encode_exact(&self, bytes, exact, total);
    }
    free(exact);
    release_encoder(&self);
    return result;
}

#define SEGMENTS_METHODS \
    {"open_fields", native_open_fields, METH_VARARGS, "Open the body of a segment of coder touch."}, \
    {"next_field", native_next_field, METH_O, "Bricks and forces of the next frame; None after the last one."}, \
    {"encode_segment", native_encode_segment, METH_VARARGS, "The body of a segment of coder touch."}, \
    {"is_static", native_is_static, METH_VARARGS, "Whether an earlier frame may stand for a frame."}, \
    {"add_exact_samples", native_add_exact_samples, METH_VARARGS, "A body with some samples exact."}

#endif
