/* Fuzzes the decoder with mutated files: touch_fuzz SEED MILLIONS_OF_BYTES FILE.touch... Compile it with
   -fsanitize=address,undefined and -DFUZZING_BUILD_MODE_UNSAFE_FOR_PRODUCTION, which skips the check of CRC-32s, so
   that the code behind them runs. Prints how many inputs were refused, and with what error code. */
#include "watched_arena.h"

#define TOUCH_IMPLEMENTATION
#include "touch.h"

#include <stdio.h>
#include <stdlib.h>

static uint64_t state;

static uint32_t any(uint32_t below) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)((state >> 33) % below);
}

static size_t mutate(uint8_t *to, const uint8_t *from, size_t size) {
    uint32_t edits = 1 + any(4), i;
    memcpy(to, from, size);
    for (i = 0; i < edits && size > 1; i++) {
        uint32_t at = any((uint32_t)size), kind = any(8), n = 1 + any(16);
        if (n > size - at) n = (uint32_t)size - at;
        if (kind < 3) to[at] = (uint8_t)(to[at] ^ (1u << any(8)));
        else if (kind < 5) to[at] = (uint8_t)any(256);
        else if (kind == 5) memset(to + at, any(2) ? 255 : 0, n);
        else if (kind == 6) memcpy(to + at, from + any((uint32_t)size - n + 1), n);
        else if (!any(20)) size = at + 1;
    }
    return size;
}

static int run(const uint8_t *bytes, size_t size, uint8_t *memory, uint64_t room) {
    touch_file file;
    touch_decoder decoder = {0};
    touch_frame frame;
    touch_arena arena = touch_arena_of(memory + room, room);
    uint32_t n;
    int code = touch_open(&file, bytes, size), i;
    uint64_t own = 0, each = 0, peak = 0;
    if (!code) touch_room(&file, &own, &each);
    if (!code) code = touch_start(&decoder, &file, touch_arena_of(memory, room));
    for (n = 0; n < file.segment_count && n < 4 && !code; n++) {
        code = touch_seek(&decoder, n);
        while (!code && (arena.used = 0, code = touch_next(&decoder, &arena, &frame)) == TOUCH_OK) {
            for (i = 0; i < 20; i++) {
                double p[3], f[9];
                int k;
                for (k = 0; k < 3; k++)
                    p[k] = file.grid.origin_m[k] + (any(1200) / 1000.0 - 0.1) * file.grid.spacing_m[k] * file.grid.shape[k];
                touch_force(&frame, p[0], p[1], p[2], f), touch_gradient(&frame, p[0], p[1], p[2], f);
                touch_vibration(&frame, p[0], p[1], p[2], f);
            }
            peak = peak > arena.peak ? peak : arena.peak;
        }
        if (code == TOUCH_END) code = TOUCH_OK;
    }
    /* touch_room never asks for too little */
    if (code && own <= room && each <= room && code == TOUCH_MEMORY) abort();
    if (decoder.arena.peak > own || peak > each) abort();
    return code;
}

int main(int count, char **words) {
    uint64_t most = count > 3 ? (uint64_t)atoi(words[2]) * 1000000 : 0, bytes = 0, room = (uint64_t)96 << 20;
    uint64_t inputs_of_code[8] = {0};
    uint8_t *memory = (uint8_t *)malloc(2 * room), **data = (uint8_t **)calloc((size_t)count, sizeof *data);
    size_t *size = (size_t *)calloc((size_t)count, sizeof *size), largest = 1;
    uint8_t *own;
    int n;
    state = count > 3 ? (uint64_t)atoi(words[1]) : 0;
    for (n = 3; n < count && data && size; n++) {
        FILE *in = fopen(words[n], "rb");
        if (!in || fseek(in, 0, SEEK_END)) return 64;
        size[n] = (size_t)ftell(in), rewind(in), data[n] = (uint8_t *)malloc(size[n] + 1);
        if (!data[n] || fread(data[n], 1, size[n], in) != size[n]) return 64;
        largest = size[n] > largest ? size[n] : largest, fclose(in);
    }
    own = (uint8_t *)malloc(largest);
    if (count < 4 || !memory || !own) return fprintf(stderr, "touch_fuzz SEED MILLIONS_OF_BYTES FILE.touch...\n"), 64;
    while (bytes < most) {
        size_t length;
        uint8_t *exact;
        n = 3 + (int)any((uint32_t)count - 3), length = mutate(own, data[n], size[n]);
        exact = (uint8_t *)malloc(length); /* so that a read beyond its end is seen */
        if (!exact) return 64;
        memcpy(exact, own, length), inputs_of_code[run(exact, length, memory, room)]++, bytes += length;
        free(exact);
    }
    free(memory), free(own);
    for (n = 3; n < count; n++) free(data[n]);
    free(data), free(size);
    for (n = 0; n < 8; n++) printf("code %d: %llu inputs\n", n, (unsigned long long)inputs_of_code[n]);
    return 0;
}
