/* Arenas that are too small, for tests: arena FILE... Decodes each file with what it takes in truth; then once for each
   piece of memory that it takes, behind which there is no more. Prints the tries, and those that failed for want of
   memory; any other outcome ends the program. */
#include "touch.h"

#include <stdio.h>
#include <stdlib.h>

static long pieces, last; /* taken so far, and the last one that is given */

static uint64_t count_piece(touch_arena *arena) {
    if (++pieces == last) arena->size = arena->used;
    return 0;
}

#define TOUCH_GUARD(at, bytes, guard) ((void)(at), (void)(guard), count_piece(arena))
#define TOUCH_IMPLEMENTATION
#include "touch.h"

/* The code with which all frames are decoded, where no piece is given behind number `most`; -1: all are. */
static int decode(const touch_file *file, long most) {
    uint64_t own, each;
    touch_decoder decoder;
    touch_frame frame;
    touch_room(file, &own, &each);
    void *memory[2] = {malloc(own), malloc(each)};
    if (!memory[0] || !memory[1]) exit(64);
    pieces = 0, last = most;
    touch_arena arena = touch_arena_of(memory[1], most ? each : 0);
    int code = touch_start(&decoder, file, touch_arena_of(memory[0], most ? own : 0));
    for (uint32_t n = 0; n < file->segment_count && !code; n++) {
        code = touch_seek(&decoder, n);
        while (!code && (arena.used = 0, code = touch_next(&decoder, &arena, &frame)) == TOUCH_OK) {
            double newtons[3];
            touch_force(&frame, file->grid.origin_m[0], file->grid.origin_m[1], file->grid.origin_m[2], newtons);
        }
        if (code == TOUCH_END) code = TOUCH_OK;
    }
    if (code && !(decoder.error && *decoder.error)) exit(66); /* an error without words */
    free(memory[0]), free(memory[1]);
    return code;
}

int main(int count, char **words) {
    for (int n = 1; n < count; n++) {
        FILE *in = fopen(words[n], "rb");
        if (!in || fseek(in, 0, SEEK_END)) return 64;
        size_t size = (size_t)ftell(in);
        uint8_t *bytes = malloc(size + 1);
        rewind(in);
        if (!bytes || fread(bytes, 1, size, in) != size) return 64;
        touch_file file;
        if (touch_open(&file, bytes, size)) return 65;
        if (decode(&file, -1)) return 67;
        long failed = 0, all = pieces;
        for (long i = 0; i < all; i++) {
            int code = decode(&file, i);
            if (code && code != TOUCH_MEMORY) return 69;
            failed += code == TOUCH_MEMORY;
        }
        printf("%ld %ld\n", all, failed);
        free(bytes), fclose(in);
    }
    return 0;
}
