/* Writes a file from raw numbers, as an example of touch_write.h:
   touch_write RAW OUT.touch NX NY NZ SPACING_M K F0_N
   RAW contains frames of NX x NY x NZ forces, three floats each, in newtons, x slowest; OUT.touch has 30 frames a
   second. */
#define TOUCH_ENCODE_IMPLEMENTATION
#include "touch_write.h"

#include <stdio.h>
#include <stdlib.h>

/* The forces of a dense frame as bricks: all bricks of the grid, zero beyond it. */
static void fill(const touch_grid *g, const float *dense, int32_t *brick, float *forces) {
    uint32_t number = 0, p[3], i[3];
    for (p[0] = 0; 8 * p[0] < g->shape[0]; p[0]++)
        for (p[1] = 0; 8 * p[1] < g->shape[1]; p[1]++)
            for (p[2] = 0; 8 * p[2] < g->shape[2]; p[2]++, number++) {
                for (int n = 0; n < 3; n++) brick[3 * number + (uint32_t)n] = (int32_t)p[n];
                for (uint32_t k = 0; k < 512; k++) {
                    float *to = forces + 1536 * (size_t)number + 3 * k;
                    i[0] = 8 * p[0] + (k >> 6), i[1] = 8 * p[1] + (k >> 3 & 7), i[2] = 8 * p[2] + (k & 7);
                    to[0] = to[1] = to[2] = 0;
                    if (i[0] < g->shape[0] && i[1] < g->shape[1] && i[2] < g->shape[2])
                        memcpy(to, dense + 3 * (((size_t)i[0] * g->shape[1] + i[1]) * g->shape[2] + i[2]), 12);
                }
            }
}

/* What the file states: a field of a point device, in the middle of the workspace. */
static touch_head head_of(char **words, uint32_t frames) {
    touch_head head;
    memset(&head, 0, sizeof head);
    for (int n = 0; n < 3; n++) {
        head.grid.shape[n] = (uint32_t)strtoul(words[3 + n], 0, 10), head.grid.spacing_m[n] = strtod(words[6], 0);
        head.grid.origin_m[n] = -0.5 * (head.grid.shape[n] - 1.0) * head.grid.spacing_m[n];
    }
    head.rate_hz = 30, head.frame_count = frames, head.axes = touch_text_of("x right, y up, z towards the viewer");
    head.device_name = touch_text_of("phantom-omni"), head.device_type = 1, head.force_max_n = 3.3, head.mapping_scale = 1;
    return head;
}

/* All frames, segment by segment; `bricks` is the number in the grid. */
static int write_frames(touch_file_writer *w, const float *dense, uint32_t bricks, touch_arena work) {
    const touch_grid *g = &w->head.grid;
    size_t samples = (size_t)g->shape[0] * g->shape[1] * g->shape[2];
    uint32_t length = touch_segment_frames(w->head.rate_hz);
    int32_t *brick = (int32_t *)malloc(12 * (size_t)bricks);
    float *forces = (float *)malloc(6144 * (size_t)bricks * length);
    touch_source frames[64];
    int code = brick && forces ? TOUCH_OK : TOUCH_MEMORY;
    while (w->frames < w->head.frame_count && !code) {
        uint32_t left = w->head.frame_count - w->frames, count = left < length ? left : length;
        for (uint32_t i = 0; i < count; i++) {
            float *own = forces + 1536 * (size_t)bricks * i;
            fill(g, dense + 3 * samples * (w->frames + i), brick, own);
            frames[i].bricks = bricks, frames[i].brick = brick, frames[i].forces_n = own, frames[i].hidden_n = 0;
        }
        code = touch_write_segment(w, frames, 0, count, work);
    }
    free(brick), free(forces);
    return code;
}

int main(int count, char **words) {
    FILE *in = count == 9 ? fopen(words[1], "rb") : 0, *to;
    touch_options options = {TOUCH_MASK, 0, TOUCH_INTER_AUTO, 1, 1, 0, 0, 0, 0};
    touch_file_writer writer;
    touch_bytes file;
    touch_head head;
    size_t size, room, each;
    if (!in) return fprintf(stderr, "touch_write RAW OUT.touch NX NY NZ SPACING_M K F0_N\n"), 64;
    fseek(in, 0, SEEK_END), size = (size_t)ftell(in), rewind(in);
    head = head_of(words, 1), options.k = strtod(words[7], 0), options.f0_n = strtod(words[8], 0);
    each = 12 * (size_t)head.grid.shape[0] * head.grid.shape[1] * head.grid.shape[2];
    if (!each || size < each || size % each) return fprintf(stderr, "RAW is not a number of whole frames\n"), 64;
    head = head_of(words, (uint32_t)(size / each));
    uint64_t bricks = touch_brick_count(&head.grid);
    room = (size_t)touch_encode_room(&head.grid, &options, bricks);
    size_t out_room = (size_t)touch_segment_room(bricks, head.frame_count) + 65536 + 64 * (size_t)head.frame_count;
    float *dense = (float *)malloc(size);
    void *work = malloc(room), *out = malloc(out_room);
    if (!dense || !work || !out || fread(dense, 1, size, in) != size) return fprintf(stderr, "no memory\n"), 64;
    int code = touch_write_start(&writer, &head, &options, touch_arena_of(out, out_room));
    if (!code) code = write_frames(&writer, dense, (uint32_t)bricks, touch_arena_of(work, room));
    if (!code) code = touch_write_finish(&writer, &file);
    if (!code && (!(to = fopen(words[2], "wb")) || fwrite(file.bytes, 1, file.size, to) != file.size || fclose(to))) code = 64;
    printf("%d %s\n", code, code ? writer.error : "");
    fclose(in), free(dense), free(work), free(out);
    return code;
}
