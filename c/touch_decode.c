/* Decodes a file to raw numbers, for tests: touch_decode FILE.touch OUT
   Writes for each frame the force field (the count of its bricks as u32, then each brick's number and 1536 floats), and
   the vibration in the same way; for objects, the forces at the points of the grid, as floats. OUT ends with the error
   code of touch.h and its text. A grid of more than MAX_POINTS samples, at which a file of objects would be laid out, is
   refused with exit code 64. */
#define TOUCH_IMPLEMENTATION
#include "touch.h"

#include <stdio.h>
#include <stdlib.h>

static const uint64_t MAX_POINTS = (uint64_t)1 << 24;

static uint64_t points_of(const touch_grid *g) { return (uint64_t)g->shape[0] * g->shape[1] * g->shape[2]; }

static void put_field(FILE *out, const touch_field *f) {
    uint32_t none = 0, i;
    if (!f) {
        fwrite(&none, 4, 1, out);
        return;
    }
    fwrite(&f->bricks, 4, 1, out);
    for (i = 0; i <= f->mask; i++)
        if (f->table[2 * i]) {
            uint32_t number = f->table[2 * i] - 1;
            fwrite(&number, 4, 1, out);
            fwrite(f->forces_n + 1536 * (size_t)f->table[2 * i + 1], 4, 1536, out);
        }
}

static void put_points(FILE *out, const touch_file *file, const touch_frame *frame) {
    const touch_grid *g = &file->grid;
    uint32_t i, j, k;
    for (i = 0; i < g->shape[0]; i++)
        for (j = 0; j < g->shape[1]; j++)
            for (k = 0; k < g->shape[2]; k++) {
                double f[3];
                float single[3];
                touch_force(frame, g->origin_m[0] + i * g->spacing_m[0], g->origin_m[1] + j * g->spacing_m[1],
                            g->origin_m[2] + k * g->spacing_m[2], f);
                single[0] = (float)f[0], single[1] = (float)f[1], single[2] = (float)f[2];
                fwrite(single, 4, 3, out);
            }
}

int main(int count, char **words) {
    FILE *in = count == 3 ? fopen(words[1], "rb") : 0, *out = in ? fopen(words[2], "wb") : 0;
    touch_file file;
    touch_decoder decoder;
    touch_frame frame;
    touch_arena arena;
    uint64_t room = 0, each = 0;
    uint8_t *bytes, *memory = 0;
    size_t size = 0, read = 0;
    uint32_t n;
    int code;
    if (!in || !out) return fprintf(stderr, "touch_decode FILE.touch OUT\n"), 64;
    fseek(in, 0, SEEK_END), size = (size_t)ftell(in), rewind(in);
    bytes = (uint8_t *)malloc(size + 1);
    if (bytes) read = fread(bytes, 1, size, in);
    if (!bytes || read != size) return fprintf(stderr, "cannot read\n"), 64;
    decoder.error = "";
    code = touch_open(&file, bytes, size);
    if (!code && file.object_count && points_of(&file.grid) > MAX_POINTS)
        return fprintf(stderr, "a grid of %llu points, more than 2^24, cannot be laid out\n",
                       (unsigned long long)points_of(&file.grid)), 64;
    if (!code) {
        touch_room(&file, &room, &each);
        memory = (uint8_t *)malloc(room + each);
        if (!memory) return fprintf(stderr, "there is not memory for all that the file may tell\n"), 64;
        code = touch_start(&decoder, &file, touch_arena_of(memory, room));
    }
    arena = touch_arena_of(memory + room, each);
    for (n = 0; n < file.segment_count && !code; n++) {
        code = touch_seek(&decoder, n);
        while (!code && (arena.used = 0, code = touch_next(&decoder, &arena, &frame)) == TOUCH_OK) {
            if (frame.is_placed) put_points(out, &file, &frame);
            else put_field(out, frame.part[0].field);
            put_field(out, frame.vibration);
        }
        if (code == TOUCH_END) code = TOUCH_OK;
    }
    printf("%d %s\n", code, code ? (*file.error ? file.error : decoder.error) : "");
    fclose(out), fclose(in), free(bytes), free(memory);
    return code;
}
