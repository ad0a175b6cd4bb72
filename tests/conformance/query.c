/* Queries of every frame at points, for tests: query FILE.touch POINTS OUT. POINTS: f64 [n][3], metres; OUT: f64
   [frames][n][14], force, gradient and vibration. Prints what touch.h refuses. */
#define TOUCH_IMPLEMENTATION
#include "touch.h"

#include <stdio.h>
#include <stdlib.h>

static void *contents(const char *name, size_t *size) {
    FILE *in = fopen(name, "rb");
    if (!in || fseek(in, 0, SEEK_END)) exit(64);
    *size = (size_t)ftell(in);
    void *bytes = malloc(*size + 1);
    rewind(in);
    if (!bytes || fread(bytes, 1, *size, in) != *size) exit(64);
    fclose(in);
    return bytes;
}

static int refused(const char *what) {
    puts(what);
    return 65;
}

int main(int count, char **words) {
    if (count != 4) return 64;
    size_t size, points;
    const uint8_t *bytes = contents(words[1], &size);
    const double *at = contents(words[2], &points);
    FILE *out = fopen(words[3], "wb");
    touch_file file;
    touch_decoder decoder;
    uint64_t room, each;
    if (!out) return 64;
    if (touch_open(&file, bytes, size)) return refused(file.error);
    touch_room(&file, &room, &each);
    touch_arena arena = touch_arena_of(malloc(each), each);
    if (touch_start(&decoder, &file, touch_arena_of(malloc(room), room))) return refused(decoder.error);
    for (uint32_t i = 0, segment = 0; i < file.frame_count; i++) {
        touch_frame frame;
        arena.used = 0;
        if ((i == 0 || touch_segment_of(&file, i) != segment) &&
            touch_seek(&decoder, segment = touch_segment_of(&file, i)))
            return refused(decoder.error);
        if (touch_next(&decoder, &arena, &frame)) return refused(decoder.error);
        for (size_t n = 0; n < points / 24; n++) {
            const double *p = at + 3 * n;
            double row[14];
            touch_force(&frame, p[0], p[1], p[2], row);
            touch_gradient(&frame, p[0], p[1], p[2], row + 3);
            touch_vibration(&frame, p[0], p[1], p[2], row + 12);
            if (fwrite(row, sizeof row, 1, out) != 1) return 64;
        }
    }
    return fclose(out) ? 64 : 0;
}
