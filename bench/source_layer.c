/* Codes the corrections of a base layer that touch.h does not have: the voxel pass of coder `touch` with given vectors as
   the reference. It is compiled by source_layer_pass.py, for bench_source_layer.py. */
#define TOUCH_ENCODE_IMPLEMENTATION
#include "touch_encode.h"

#include <stdlib.h>

typedef struct {
    uint64_t payload_bytes, outliers, outlier_bytes; /* of the frame */
    uint64_t within, violations;                     /* voxels at which the base layer is within the bound, or not */
    double max_error_ratio;                          /* of the decoded frame, of the bound */
    int32_t is_decoded;                              /* the reader makes the vectors of the writer of the payload */
} layer_cost;

/* Read the payload with the same reference, and compare. */
static int is_read_alike(touch_writer *w, const touch_coded *coded, const touch_units *reference, touch_arena *arena) {
    touch_cursor error = touch_cursor_of(0, 0);
    touch_models *models = (touch_models *)touch_take(arena, 1, sizeof *models);
    touch_units read;
    memset(&read, 0, sizeof read);
    if (!models) return 0;
    memcpy(models, w->fresh, sizeof *models);
    if (!touch_read_frame(touch_cursor_of(coded->payload.bytes, coded->payload.size), &w->grid, &w->steps, &w->tables, models,
                          reference, &read, arena, &error))
        return 0;
    return read.list.count == coded->units.list.count &&
           !memcmp(read.list.key, coded->units.list.key, 8 * read.list.count) &&
           !memcmp(read.v, coded->units.v, 512 * read.list.count * sizeof *read.v);
}

static void add_costs(layer_cost *cost, touch_writer *w, const touch_source *frame, const touch_coded *coded,
                      touch_arena *arena) {
    touch_bound bound = touch_frame_bound(&w->options, 0);
    touch_brick_forces decoded;
    touch_comparison c;
    if (!touch_newtons_of(&decoded, &coded->units, w->steps.unit_n, arena) ||
        !touch_compare(frame, &decoded, &bound, &w->grid, 0, &c, arena))
        return;
    cost->payload_bytes = coded->payload.size, cost->outliers = c.outliers, cost->max_error_ratio = c.max_ratio;
    cost->outlier_bytes = TOUCH_OUTLIER_BYTES * c.outliers;
}

static void add_bound(layer_cost *cost, touch_writer *w, const touch_source *frame, const touch_units *reference,
                      touch_arena *arena) {
    touch_bound bound = touch_frame_bound(&w->options, 1);
    touch_brick_forces forces;
    touch_comparison c;
    if (!touch_newtons_of(&forces, reference, w->steps.unit_n, arena) ||
        !touch_compare(frame, &forces, &bound, &w->grid, 0, &c, arena))
        return;
    cost->within = c.within, cost->violations = c.outliers;
}

static int cost_of(touch_writer *w, const touch_source *frame, const touch_units *reference, layer_cost *cost) {
    touch_cursor error = touch_cursor_of(0, 0);
    touch_coded coded;
    if (!touch_code_frame(&w->grid, &w->steps, &w->tables, &w->bound, frame, reference, w->fresh, &coded, &w->work, &error))
        return error.code;
    add_costs(cost, w, frame, &coded, &w->work);
    add_bound(cost, w, frame, reference, &w->work);
    cost->is_decoded = is_read_alike(w, &coded, reference, &w->work);
    return TOUCH_OK;
}

/* The cost of a frame, a segment by itself, with a base layer of `layer_bricks` bricks, ascending: vectors
   [layer_bricks][512][3], units. A code of touch.h. */
#ifdef _WIN32
__declspec(dllexport)
#else
__attribute__((visibility("default")))
#endif
int layer_cost_of(const uint32_t *shape, const double *spacing_m, double k, double f0_n, uint64_t bricks,
                  const int32_t *brick, const float *forces_n, uint64_t layer_bricks, const int32_t *layer_brick,
                  const int32_t *vectors, layer_cost *cost) {
    touch_grid grid;
    touch_options options;
    touch_encoder encoder;
    touch_source frame = {bricks, brick, forces_n, 0};
    touch_units reference;
    uint64_t all = bricks + layer_bricks + 64, size, out_size;
    memset(&grid, 0, sizeof grid), memset(&options, 0, sizeof options), memset(&encoder, 0, sizeof encoder);
    memset(cost, 0, sizeof *cost);
    for (int n = 0; n < 3; n++) grid.shape[n] = shape[n], grid.spacing_m[n] = spacing_m[n];
    options.mode = TOUCH_MASK, options.has_base_layers = 1, options.k = k, options.f0_n = f0_n;
    size = touch_encode_room(&grid, &options, all), out_size = touch_segment_room(all, 1);
    uint8_t *work = (uint8_t *)malloc(size), *out = (uint8_t *)malloc(out_size);
    reference.list.count = layer_bricks, reference.list.key = (uint64_t *)malloc(8 * (layer_bricks + 1));
    reference.v = (touch_int_vector *)(uintptr_t)vectors;
    int code = TOUCH_MEMORY;
    if (work && out && reference.list.key) {
        for (uint64_t i = 0; i < layer_bricks; i++)
            reference.list.key[i] = touch_key(layer_brick[3 * i], layer_brick[3 * i + 1], layer_brick[3 * i + 2]);
        code = touch_encode_start(&encoder, &grid, &options, touch_longest_n(&frame), touch_arena_of(work, size),
                                  touch_arena_of(out, out_size));
        if (!code) code = cost_of(encoder.writer, &frame, &reference, cost);
    }
    free(work), free(out), free(reference.list.key);
    return code;
}
