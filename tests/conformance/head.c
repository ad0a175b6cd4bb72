/* What touch.h tells of a file, for tests: head FILE.touch. A line for each field of touch_file; then the segments,
   the last one first and each of them twice: of each frame its number, what it states, and the force at the middle of
   each sample of the diagonal. Ends with the codes of what there is not. */
#define TOUCH_IMPLEMENTATION
#include "touch.h"

#include <stdio.h>
#include <stdlib.h>

static void number(const char *name, double value) { printf("%s %.17g\n", name, value); }

static void three(const char *name, const double value[3]) {
    printf("%s %.17g %.17g %.17g\n", name, value[0], value[1], value[2]);
}

static void text(const char *name, touch_bytes value) {
    printf("%s ", name);
    for (uint64_t i = 0; i < value.size; i++) printf("%02x", value.bytes[i]);
    puts("");
}

int main(int count, char **words) {
    FILE *in = count == 2 ? fopen(words[1], "rb") : 0;
    touch_file f;
    touch_decoder decoder;
    touch_frame frame;
    touch_arena arena;
    uint64_t room, each, peak = 0;
    size_t size;
    uint8_t *bytes;
    if (!in || fseek(in, 0, SEEK_END)) return 64;
    size = (size_t)ftell(in), rewind(in);
    bytes = (uint8_t *)malloc(size + 1);
    if (!bytes || fread(bytes, 1, size, in) != size || touch_open(&f, bytes, size)) return 65;
    printf("shape %u %u %u\n", f.grid.shape[0], f.grid.shape[1], f.grid.shape[2]);
    three("spacing_m", f.grid.spacing_m), three("origin_m", f.grid.origin_m);
    number("rate_hz", f.rate_hz), number("force_max_n", f.force_max_n), number("mapping_scale", f.mapping_scale);
    three("mapping_offset_m", f.mapping_offset_m);
    number("weber_fraction", f.weber_fraction), number("force_threshold_n", f.force_threshold_n);
    number("friction", f.friction), number("damping_n_s_per_m", f.damping_n_s_per_m);
    printf("counts %u %u %u %d\n", f.frame_count, f.segment_count, f.object_count, f.device_type);
    text("axes", f.axes), text("device_name", f.device_name), text("coder", f.coder);
    text("parameters", f.parameters);
    printf("size %d\nsegment_of", f.size == size && f.data == bytes);
    for (uint32_t i = 0; i < f.frame_count; i++) printf(" %u", touch_segment_of(&f, i));
    puts("");
    touch_room(&f, &room, &each);
    arena = touch_arena_of(malloc(each), each);
    if (!arena.base || touch_start(&decoder, &f, touch_arena_of(malloc(room), room))) return 66;
    for (uint32_t n = 2 * f.segment_count; n--;) {
        int code = touch_seek(&decoder, n / 2);
        while (!code && (arena.used = 0, code = touch_next(&decoder, &arena, &frame)) == TOUCH_OK) {
            printf("frame %u %u %d %d %.17g %.17g", frame.number, frame.parts, frame.is_placed,
                   frame.vibration != 0, frame.surface_damping_n_s_per_m, frame.force_max_n);
            for (uint32_t i = 0; i < f.grid.shape[0] && i < f.grid.shape[1] && i < f.grid.shape[2]; i++) {
                double p[3], newtons[3];
                for (int k = 0; k < 3; k++) p[k] = f.grid.origin_m[k] + i * f.grid.spacing_m[k];
                touch_force(&frame, p[0], p[1], p[2], newtons);
                printf(" %.9g %.9g %.9g", newtons[0], newtons[1], newtons[2]);
            }
            puts("");
            if (arena.peak > peak) peak = arena.peak;
        }
        if (code != TOUCH_END || touch_next(&decoder, &arena, &frame) != TOUCH_END) return 67;
    }
    printf("room %d %d\n", peak && peak <= each, decoder.arena.peak && decoder.arena.peak <= room);
    printf("codes %d", touch_seek(&decoder, f.segment_count));
    printf(" %d", touch_seek(&decoder, f.segment_count - 1));
    printf(" %s\n", decoder.error && *decoder.error ? "still an error" : "none");
    return 0;
}
