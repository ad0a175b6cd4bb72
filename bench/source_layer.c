/* Codes frames with base layers that touch.h does not have: the voxel pass of coder `touch` with given vectors as the
   reference. It is compiled by source_layer_pass.py, for bench_source_layer.py. */
#define TOUCH_ENCODE_IMPLEMENTATION
#include "touch_encode.h"

#include <stdlib.h>

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

typedef struct {
    touch_source source;
    uint64_t layer_bytes; /* of the coded base layer */
    touch_units layer;    /* its vectors */
} layered_frame;

typedef struct {
    uint64_t payload_bytes[2], outlier_bytes[2]; /* with the base layer, and with the frame before or nothing */
    uint64_t within, violations;                 /* voxels at which the base layer is within the bound, or not */
    double max_error_ratio;                      /* of the better one, before outliers, of the bound */
    int32_t is_decoded;                          /* a reader makes the vectors of the writer */
    int32_t has_layer;                           /* the base layer is better */
} frame_cost;

static int compare_units(touch_writer *w, const layered_frame *frame, const touch_units *units, int is_prediction,
                         touch_comparison *c) {
    touch_bound bound = touch_frame_bound(&w->options, is_prediction);
    touch_brick_forces forces;
    uint64_t mark = w->work.used;
    int is_done = touch_newtons_of(&forces, units, w->steps.unit_n, &w->work) &&
                  touch_compare(&frame->source, &forces, &bound, &w->grid, TOUCH_COUNT_OUTLIERS, c, &w->work);
    w->work.used = mark;
    return is_done;
}

/* Read the payload with the same reference and models, and compare. */
static int is_read_alike(touch_writer *w, const touch_models *models, const touch_coded *coded, const touch_units *reference) {
    touch_cursor error = touch_cursor_of(0, 0);
    uint64_t mark = w->work.used;
    touch_models *own = (touch_models *)touch_take(&w->work, 1, sizeof *own);
    touch_units read;
    memset(&read, 0, sizeof read);
    if (!own) return 0;
    memcpy(own, models, sizeof *own);
    int is_alike = touch_read_frame(touch_cursor_of(coded->payload.bytes, coded->payload.size), &w->grid, &w->steps, &w->tables,
                                    own, reference, &read, &w->work, &error) &&
                   read.list.count == coded->units.list.count &&
                   !memcmp(read.list.key, coded->units.list.key, 8 * read.list.count) &&
                   !memcmp(read.v, coded->units.v, 512 * read.list.count * sizeof *read.v);
    w->work.used = mark;
    return is_alike;
}

/* Code a frame with its base layer and without one; the better of both is the frame before of the next one. */
static int code_layered(touch_writer *w, const layered_frame *frame, touch_units *previous, touch_models *models,
                        frame_cost *cost) {
    const touch_units *references[2] = {&frame->layer, previous};
    touch_cursor error = touch_cursor_of(0, 0);
    touch_coded coded[2];
    touch_comparison c;
    uint64_t bytes[2];
    if (!compare_units(w, frame, &frame->layer, 1, &c)) return TOUCH_MEMORY;
    cost->within = c.within, cost->violations = c.outliers;
    for (int n = 0; n < 2; n++) {
        if (!touch_code_frame(&w->grid, &w->steps, &w->tables, &w->bound, &frame->source, references[n], models, coded + n,
                              &w->work, &error))
            return error.code;
        if (!compare_units(w, frame, &coded[n].units, 0, &c)) return TOUCH_MEMORY;
        cost->payload_bytes[n] = coded[n].payload.size, cost->outlier_bytes[n] = TOUCH_OUTLIER_BYTES * c.outliers;
        bytes[n] = coded[n].payload.size + cost->outlier_bytes[n] + (n ? 0 : frame->layer_bytes);
        cost->has_layer = n == 0 || bytes[0] < bytes[1];
        if (n == 0 || !cost->has_layer) cost->max_error_ratio = c.max_ratio;
    }
    int best = !cost->has_layer;
    cost->is_decoded = is_read_alike(w, models, coded + best, references[best]);
    memcpy(models, coded[best].models, sizeof *models);
    *previous = coded[best].units;
    return TOUCH_OK;
}

static int code_all(touch_encoder *encoder, uint32_t count, const layered_frame *frames, frame_cost *costs) {
    touch_writer *w = encoder->writer;
    touch_units previous;
    touch_models *models = (touch_models *)touch_take(&w->work, 1, sizeof *models);
    int code = models ? TOUCH_OK : TOUCH_MEMORY;
    memset(&previous, 0, sizeof previous);
    if (models) memcpy(models, w->fresh, sizeof *models);
    for (uint32_t n = 0; n < count && !code; n++) code = code_layered(w, frames + n, &previous, models, costs + n);
    return code;
}

/* The costs of frames in one segment. `bricks` [count][2] are the bricks of each frame and of its base layer; `arrays`
   [count][4] are its bricks, ascending, and forces, newtons, and bricks and vectors, units, of its base layer of
   `layer_bytes` [count]. A code of touch.h. */
EXPORT int layer_costs(const uint32_t *shape, const double *spacing_m, double k, double f0_n, uint32_t count,
                       const uint64_t *bricks, const void *const *arrays, const uint64_t *layer_bytes, frame_cost *costs) {
    touch_grid grid;
    touch_options options;
    touch_encoder encoder;
    uint64_t all = 64, size, out_size;
    double longest_n = 0;
    layered_frame *frames = (layered_frame *)calloc(count, sizeof *frames);
    int code = frames ? TOUCH_OK : TOUCH_MEMORY;
    memset(&grid, 0, sizeof grid), memset(&options, 0, sizeof options), memset(&encoder, 0, sizeof encoder);
    memset(costs, 0, count * sizeof *costs);
    for (int n = 0; n < 3; n++) grid.shape[n] = shape[n], grid.spacing_m[n] = spacing_m[n];
    for (uint32_t n = 0; n < count && !code; n++) {
        layered_frame *f = frames + n;
        touch_source source = {bricks[2 * n], (const int32_t *)arrays[4 * n], (const float *)arrays[4 * n + 1], 0};
        const int32_t *brick = (const int32_t *)arrays[4 * n + 2];
        f->source = source, f->layer_bytes = layer_bytes[n], f->layer.list.count = bricks[2 * n + 1];
        f->layer.v = (touch_int_vector *)(uintptr_t)arrays[4 * n + 3];
        f->layer.list.key = (uint64_t *)malloc(8 * (f->layer.list.count + 1));
        if (!f->layer.list.key) code = TOUCH_MEMORY;
        for (uint64_t i = 0; !code && i < f->layer.list.count; i++)
            f->layer.list.key[i] = touch_key(brick[3 * i], brick[3 * i + 1], brick[3 * i + 2]);
        longest_n = touch_longest_n(&source) > longest_n ? touch_longest_n(&source) : longest_n;
        all += bricks[2 * n] + bricks[2 * n + 1];
    }
    options.mode = TOUCH_MASK, options.has_base_layers = 1, options.k = k, options.f0_n = f0_n;
    size = touch_encode_room(&grid, &options, all), out_size = touch_segment_room(all, 1);
    uint8_t *work = (uint8_t *)malloc(size), *out = (uint8_t *)malloc(out_size);
    if (!work || !out) code = TOUCH_MEMORY;
    if (!code)
        code = touch_encode_start(&encoder, &grid, &options, longest_n, touch_arena_of(work, size),
                                  touch_arena_of(out, out_size));
    if (!code) code = code_all(&encoder, count, frames, costs);
    for (uint32_t n = 0; frames && n < count; n++) free(frames[n].layer.list.key);
    free(frames), free(work), free(out);
    return code;
}
