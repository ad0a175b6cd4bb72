/* Prints for each file what touch_room asks for, and what decoding it takes: bytes of the decoder, bytes of a frame. */
#define TOUCH_IMPLEMENTATION
#include "touch.h"

#include <stdio.h>
#include <stdlib.h>

static int measure(const uint8_t *bytes, size_t size) {
    touch_file file;
    touch_decoder decoder;
    touch_frame frame;
    uint64_t room = 0, each = 0;
    int code = touch_open(&file, bytes, size);
    if (code) return code;
    touch_room(&file, &room, &each);
    uint8_t *memory = (uint8_t *)malloc(room + each);
    if (!memory) return TOUCH_MEMORY;
    touch_arena arena = touch_arena_of(memory + room, each);
    code = touch_start(&decoder, &file, touch_arena_of(memory, room));
    for (uint32_t n = 0; n < file.segment_count && !code; n++) {
        code = touch_seek(&decoder, n);
        while (!code && (arena.used = 0, code = touch_next(&decoder, &arena, &frame)) == TOUCH_OK) {}
        if (code == TOUCH_END) code = TOUCH_OK;
    }
    printf("%llu %llu %llu %llu\n", (unsigned long long)room, (unsigned long long)each,
           (unsigned long long)(decoder.arena.peak + (room - decoder.arena.size)), (unsigned long long)arena.peak);
    free(memory);
    return code;
}

int main(int count, char **paths) {
    int code = 0;
    for (int n = 1; n < count && !code; n++) {
        FILE *in = fopen(paths[n], "rb");
        uint8_t *bytes = (uint8_t *)malloc(1 << 20);
        if (!in || !bytes) return 64;
        code = measure(bytes, fread(bytes, 1, 1 << 20, in));
        fclose(in), free(bytes);
    }
    return code;
}
