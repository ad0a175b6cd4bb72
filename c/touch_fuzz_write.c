/* Fuzzes the writer with random fields: touch_fuzz_write SEED ROUNDS [FOLDER]. Each round writes a small file of random
   forces in a random mode, reads it back, and compares every voxel with the error bound, or every bit in mode lossless.
   The first 256 files go to FOLDER, as inputs for touch_fuzz. Compile it with -fsanitize=address,undefined. */
#include "watched_arena.h"

#define TOUCH_ENCODE_IMPLEMENTATION
#include "touch_write.h"

#include <stdio.h>
#include <stdlib.h>

enum { MAX_FRAMES = 3, MAX_BRICKS = 8, KEPT_FILES = 256 };

typedef struct { /* a frame of a round, and the memory of its source */
    int32_t brick[MAX_BRICKS][3];
    float forces_n[MAX_BRICKS][512][3], hidden_n[MAX_BRICKS][512];
    touch_source source;
} random_frame;

static uint64_t state;
static random_frame frames[MAX_FRAMES];

static uint32_t any(uint32_t below) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)((state >> 33) % below);
}

static double uniform(void) { return any(1u << 30) / (double)(1u << 30); }

static double either_sign(void) { return 2 * uniform() - 1; }

/* -- what is written ------------------------------------------------------------------------------------------------- */

static touch_grid random_grid(void) {
    static const uint32_t longest[5] = {1, 3, 8, 9, 17};
    touch_grid grid;
    uint32_t most = longest[any(5)];
    for (int n = 0; n < 3; n++) {
        grid.shape[n] = 1 + any(most);
        grid.spacing_m[n] = 0.001 * (1 + any(3)), grid.origin_m[n] = either_sign();
    }
    return grid;
}

static touch_options random_options(void) {
    static const double k[6] = {0.001, 0.01, 0.1, 0.3, 0.7, 0.999}, f0_n[6] = {0, 0, 1e-9, 0.05, 1, 1e5};
    touch_options o = {0, 0, 0, 0, 1, 0.1, 0, 20, 0.05};
    o.mode = (int32_t)any(4), o.is_support_exact = any(4) == 0, o.interframe = (int32_t)any(3), o.has_base_layers = any(2) == 0;
    o.k = k[any(6)], o.f0_n = f0_n[any(6)], o.direction_jnd_deg = 1 + any(60), o.step_n = any(2) ? 0.05 : 1e-3;
    return o;
}

/* One force; `kind` is the same for a whole field. */
static void random_force(int kind, const int place[3], double f0_n, float out[3]) {
    double size = 1;
    for (int n = 0; n < 3; n++) out[n] = 0;
    switch (kind) {
    case 0: /* nothing */ return;
    case 1: /* noise */ break;
    case 2: /* sparse */ if (any(12)) return; break;
    case 3: /* decades */ if (any(3)) return; size = pow(10, 35 * either_sign()); break;
    case 4: /* subnormal */ size = 1e-40; break;
    case 5: /* about the threshold */ size = f0_n > 0 ? f0_n * (1 + 1e-7 * either_sign()) : 1e-30; break;
    case 6: /* a wall */ out[2] = place[2] < 5 ? (float)(0.3 * (5 - place[2])) : 0; return;
    case 7: /* smooth */
        out[0] = (float)sin(place[0] / 5.0), out[1] = (float)cos(place[1] / 4.0), out[2] = 1 + (float)place[2] / 9;
        return;
    case 8: /* negative zeros */ if (any(2)) { out[any(3)] = -0.0f; return; } break;
    case 9: /* checkerboard */ out[0] = (place[0] + place[1] + place[2]) % 2 ? 0 : 0.5f; return;
    default: /* few values */ out[any(3)] = 0.25f * (float)(1 + any(3)); return;
    }
    for (int n = 0; n < 3; n++) out[n] = (float)(size * either_sign());
}

static void random_field(random_frame *frame, const touch_grid *grid, double f0_n) {
    int kind = (int)any(11);
    uint64_t bricks = 0;
    int32_t b[3];
    for (b[0] = 0; 8 * (uint32_t)b[0] < grid->shape[0]; b[0]++)
        for (b[1] = 0; 8 * (uint32_t)b[1] < grid->shape[1]; b[1]++)
            for (b[2] = 0; 8 * (uint32_t)b[2] < grid->shape[2]; b[2]++) {
                if (bricks == MAX_BRICKS || any(4) == 0) continue; /* also bricks that follow each other with a gap */
                memcpy(frame->brick[bricks], b, sizeof b);
                for (int s = 0; s < 512; s++) {
                    int p[3] = {8 * b[0] + (s >> 6), 8 * b[1] + (s >> 3 & 7), 8 * b[2] + (s & 7)}, n, is_inside = 1;
                    for (n = 0; n < 3; n++) is_inside = is_inside && (uint32_t)p[n] < grid->shape[n];
                    memset(frame->forces_n[bricks][s], 0, 12);
                    if (is_inside) random_force(kind, p, f0_n, frame->forces_n[bricks][s]);
                    frame->hidden_n[bricks][s] = any(3) ? 0 : (float)uniform();
                }
                bricks++;
            }
    frame->source.bricks = bricks, frame->source.brick = frame->brick[0], frame->source.forces_n = frame->forces_n[0][0];
    frame->source.hidden_n = 0;
}

/* Copies of the frame before with few forces changed are what inter-frame coding is for. */
static void random_frames(uint32_t count, const touch_grid *grid, const touch_options *options) {
    int hides = options->mode == TOUCH_MASK && any(8) == 0;
    for (uint32_t i = 0; i < count; i++) {
        random_frame *own = frames + i;
        if (i == 0 || any(3) == 0) random_field(own, grid, options->f0_n);
        else {
            memcpy(own, own - 1, sizeof *own);
            own->source.brick = own->brick[0], own->source.forces_n = own->forces_n[0][0], own->source.hidden_n = 0;
            for (uint64_t edits = any(6); edits && own->source.bricks; edits--) {
                float *force = own->forces_n[any((uint32_t)own->source.bricks)][any(512)];
                for (int n = 0; n < 3; n++) force[n] = force[n] != 0 ? force[n] * (float)either_sign() : 0;
            }
        }
        if (hides) own->source.hidden_n = own->hidden_n[0];
    }
}

static int write_file(const touch_grid *grid, const touch_options *options, uint32_t count, touch_arena out, touch_arena work,
                      touch_bytes *file) {
    touch_file_writer writer;
    touch_head head;
    memset(&head, 0, sizeof head);
    head.grid = *grid, head.rate_hz = 30, head.frame_count = count, head.device_type = 1, head.force_max_n = 1e30;
    head.axes = touch_text_of("x right"), head.device_name = touch_text_of("none"), head.mapping_scale = 1;
    touch_source sources[MAX_FRAMES];
    for (uint32_t i = 0; i < count; i++) sources[i] = frames[i].source;
    uint32_t first = count > 1 && any(3) == 0 ? 1 : count; /* one segment, or two */
    int code = touch_write_start(&writer, &head, options, out);
    if (!code) code = touch_write_segment(&writer, sources, 0, first, work);
    if (!code && first < count) code = touch_write_segment(&writer, sources + first, 0, count - first, work);
    if (!code) code = touch_write_finish(&writer, file);
    if (code) fprintf(stderr, "%d %s\n", code, writer.error);
    return code;
}

/* -- what is read ---------------------------------------------------------------------------------------------------- */

static double length_of(const float f[3]) {
    double x = f[0], y = f[1], z = f[2];
    return sqrt(x * x + y * y + z * z);
}

/* The angle between two forces, degrees. */
static double angle_deg(const float a[3], const float b[3]) {
    double c[3], dot = 0;
    for (int n = 0; n < 3; n++) {
        int m = (n + 1) % 3, o = (n + 2) % 3;
        c[n] = (double)a[m] * b[o] - (double)a[o] * b[m], dot += (double)a[n] * b[n];
    }
    return atan2(sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]), dot) * 57.29577951308232;
}

/* Whether a decoded force may stand for an original: by the definition in docs/format/touch.md, without the writer's code. */
static int is_allowed(const touch_options *o, const float f[3], const float d[3], double hidden_n) {
    const double rounding = 1 + 1e-9;
    double error = 0, size = length_of(f), allowed = o->k * size + hidden_n;
    if (o->mode == TOUCH_LOSSLESS) return memcmp(f, d, 12) == 0;
    if (o->is_support_exact && (size > 0) != (length_of(d) > 0)) return 0;
    if (o->mode == TOUCH_NMSE) return isfinite(length_of(d));
    for (int n = 0; n < 3; n++) error += ((double)d[n] - f[n]) * ((double)d[n] - f[n]);
    error = sqrt(error);
    if (o->mode == TOUCH_MASK_DIRECTION) {
        if (size * sin(o->direction_jnd_deg / 57.29577951308232) <= o->f0_n) return error <= o->f0_n * rounding;
        if (allowed < o->f0_n) allowed = o->f0_n;
        if (error == 0) return 1;
        return fabs(length_of(d) - size) <= allowed * rounding && angle_deg(f, d) <= o->direction_jnd_deg * rounding;
    }
    return error <= (allowed > o->f0_n ? allowed : o->f0_n) * rounding;
}

/* Compare a decoded field with a frame, at all samples of the lattice. */
static int is_frame_allowed(const touch_options *o, const touch_field *field, const random_frame *frame) {
    static const float nothing[512][3];
    int32_t b[3];
    for (b[0] = 0; 8 * (uint32_t)b[0] < field->grid.shape[0]; b[0]++)
        for (b[1] = 0; 8 * (uint32_t)b[1] < field->grid.shape[1]; b[1]++)
            for (b[2] = 0; 8 * (uint32_t)b[2] < field->grid.shape[2]; b[2]++) {
                int64_t slot = touch_field_slot(field, b[0], b[1], b[2]), own = -1;
                const float(*decoded)[3] = nothing, (*original)[3] = nothing;
                for (uint64_t n = 0; n < frame->source.bricks; n++)
                    if (!memcmp(frame->brick[n], b, sizeof b)) own = (int64_t)n, original = frame->forces_n[n];
                if (slot >= 0) decoded = (const float(*)[3])(field->forces_n + 1536 * slot);
                for (int s = 0; s < 512; s++) {
                    double hidden_n = own >= 0 && frame->source.hidden_n ? frame->hidden_n[own][s] : 0;
                    if (!is_allowed(o, original[s], decoded[s], hidden_n)) {
                        fprintf(stderr, "brick %d %d %d, sample %d: %g %g %g, decoded %g %g %g, hidden %g\n", b[0], b[1], b[2],
                                s, original[s][0], original[s][1], original[s][2], decoded[s][0], decoded[s][1],
                                decoded[s][2], hidden_n);
                        return 0;
                    }
                }
            }
    return 1;
}

static int is_read_back(const touch_bytes *bytes, const touch_options *options, uint32_t count, uint8_t *memory, uint64_t room) {
    uint8_t *exact = (uint8_t *)malloc((size_t)bytes->size); /* so that a read beyond its end is seen */
    touch_file file;
    touch_decoder decoder = {0};
    touch_frame frame;
    touch_arena arena = touch_arena_of(memory + room, room);
    uint32_t i = 0;
    if (!exact) abort();
    memcpy(exact, bytes->bytes, (size_t)bytes->size);
    int code = touch_open(&file, exact, bytes->size);
    if (!code) code = touch_start(&decoder, &file, touch_arena_of(memory, room));
    for (uint32_t n = 0; n < file.segment_count && !code; n++) {
        code = touch_seek(&decoder, n);
        while (!code && (arena.used = 0, code = touch_next(&decoder, &arena, &frame)) == TOUCH_OK)
            if (!is_frame_allowed(options, frame.part[0].field, frames + i++)) code = TOUCH_CORRUPT;
        if (code == TOUCH_END) code = TOUCH_OK;
    }
    free(exact);
    if (code || i != count) fprintf(stderr, "code %d after %u of %u frames\n", code, i, count);
    return !code && i == count;
}

static void save(const char *folder, uint64_t round, const touch_bytes *bytes) {
    char path[4096];
    snprintf(path, sizeof path, "%s/%llu.touch", folder, (unsigned long long)round);
    FILE *to = fopen(path, "wb");
    if (!to || fwrite(bytes->bytes, 1, (size_t)bytes->size, to) != bytes->size || fclose(to)) exit(64);
}

int main(int count, char **words) {
    uint64_t room = (uint64_t)48 << 20, round, rounds = count > 2 ? strtoull(words[2], 0, 10) : 0, written = 0;
    uint8_t *out = (uint8_t *)malloc((size_t)room), *work = (uint8_t *)malloc((size_t)(2 * room));
    if (count < 3 || !out || !work) return fprintf(stderr, "touch_fuzz_write SEED ROUNDS [FOLDER]\n"), 64;
    uint64_t seed = strtoull(words[1], 0, 10);
    for (round = 0; round < rounds; round++) {
        state = seed * 0x9e3779b97f4a7c15u + round, any(2); /* a round is found again by its seed and number */
        touch_grid grid = random_grid();
        touch_options options = random_options();
        uint32_t frame_count = 1 + any(MAX_FRAMES);
        touch_bytes file;
        random_frames(frame_count, &grid, &options);
        int code = write_file(&grid, &options, frame_count, touch_arena_of(out, room), touch_arena_of(work, room), &file);
        if (code || !is_read_back(&file, &options, frame_count, work, room)) {
            fprintf(stderr, "seed %s, round %llu, mode %d, k %g, F_0 %g\n", words[1], (unsigned long long)round, options.mode,
                    options.k, options.f0_n);
            return 1;
        }
        if (count > 3 && round < KEPT_FILES) save(words[3], round, &file);
        written += file.size;
    }
    free(out), free(work);
    printf("%llu files, %llu bytes\n", (unsigned long long)rounds, (unsigned long long)written);
    return 0;
}
