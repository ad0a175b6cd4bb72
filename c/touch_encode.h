/* touch_encode.h: an encoder of coder `touch` (docs/format/touch.md), in C99 beside touch.h.

   In one source file, in place of touch.h:   #define TOUCH_ENCODE_IMPLEMENTATION
                                              #include "touch_encode.h"

   It writes bodies of segments, and the parts of other records that need the arithmetic code. Nothing is allocated but
   from memory that the caller gives; any number of threads may each have an encoder. The coding of bits is in
   touch_model.h, shared with the reader. Here are: the quantisation steps of a segment (touch_choose_steps), the fit of
   columns, mode decisions (touch_code_best and the functions touch_choose_...), outliers, and the check of the finished
   body. These use floating point; a reader gets their results as bits and numbers of the body.

       touch_encoder encoder = {0};  touch_segment segment;
       touch_encode_start(&encoder, &grid, &options, longest_n, touch_arena_of(work, size), touch_arena_of(out, size));
       for each frame:  touch_encode_next(&encoder, &frame, 0, 0);
       touch_encode_finish(&encoder, frames, &segment);       // segment.body, segment.size

   The voxel pass calls touch_choose_...: a brick is COPY if the reference is within the bound everywhere, a residual is
   skipped if the prediction is within it, and of 27 residuals around the force the one with the least estimated cost is
   coded of those within it. If there is none, the nearest is coded, and the voxel becomes an outlier. */
#ifndef TOUCH_ENCODE_H
#define TOUCH_ENCODE_H

#ifdef TOUCH_ENCODE_IMPLEMENTATION
#ifdef TOUCH_IMPLEMENTED
#error "include touch_encode.h, which has the implementation of touch.h, before that"
#endif
#ifndef TOUCH_IMPLEMENTATION
#define TOUCH_IMPLEMENTATION
#endif
#define TOUCH_WRITES
#endif
#include "touch.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TOUCH_MASK = 0, TOUCH_MASK_DIRECTION = 1, TOUCH_NMSE = 2, TOUCH_LOSSLESS = 3 };
enum { TOUCH_INTER_AUTO = 0, TOUCH_INTER_OFF = 1, TOUCH_INTER_ON = 2 };

typedef struct {
    int32_t mode;
    int32_t is_support_exact; /* a force may neither vanish nor appear, however small */
    int32_t interframe;
    int32_t has_base_layers; /* they are tried */
    int32_t is_checked;      /* the finished body is decoded and compared */
    double k, f0_n;          /* |error| <= max(F_0, k |F|) */
    double direction_jnd_deg, step_n;
} touch_options;

typedef struct { /* a frame, sparse in bricks of 8 x 8 x 8 samples; forces beyond the grid are 0 */
    uint64_t bricks;
    const int32_t *brick;  /* [bricks][3], ascending, x slowest */
    const float *forces_n; /* [bricks][8][8][8][3] */
    const float *hidden_n; /* [bricks][8][8][8]: error that forces around hide (spatial masking), or NULL */
} touch_source;

typedef struct { /* a spline that is fitted elsewhere: coefficients of the nodes of a frame's bricks, in raster order */
    int32_t shift[3];
    int64_t step, scale[3];
    const double *coefficient; /* units */
    uint64_t nodes;
} touch_spline;

typedef struct { /* fits the next finer spline, level 4 and then 3, to a frame; 0: it is not smooth */
    /* `unit_n` is a unit in newtons; the error that is allowed is max(f0, k |F|), units */
    int (*fit)(void *self, const touch_source *frame, int level, double unit_n, double k, double f0, touch_spline *out);
    void *self;
} touch_spline_fit;

typedef struct {
    const uint8_t *body;
    uint64_t size;
    double max_error_ratio; /* largest error as a fraction of the bound, with its frame and voxel */
    uint32_t max_error_frame, max_error_voxel[3];
} touch_segment;

typedef struct { /* samples of a frame that are sent as outliers: 512 times the number of a brick plus the sample, ascending */
    uint64_t samples;
    const uint64_t *sample;
} touch_outlier_samples;

struct touch_writer;
typedef struct {
    struct touch_writer *writer;
    const char *error;
    /* These are set by the caller before touch_encode_start, or NULL. `grow` is called when `out` is full: as realloc, with
       the base of `out`, which it must have from malloc then. `decoded` takes the number of decoded voxels with a force of
       each frame; there must be room for one more at each touch_encode_next. */
    void *(*grow)(void *self, void *out, uint64_t size);
    void *self;
    uint64_t *decoded;
} touch_encoder;

/* Bytes of `work` that are enough for frames, and the key frame, of at most so many bricks each; bricks that only have
   outliers count, too. Some 50 to 80 KB a brick. */
uint64_t touch_encode_room(const touch_grid *grid, const touch_options *options, uint64_t bricks);
/* Bytes of `out` that are enough for `count` frames of so many bricks each. */
uint64_t touch_segment_room(uint64_t bricks, uint32_t count);
/* The length of the longest force of a frame; not a number, or infinite, if one is not finite. */
double touch_longest_n(const touch_source *frame);
/* `longest_n` is an upper limit of the length of all forces; `out` takes the bytes of the segment. */
int touch_encode_start(touch_encoder *encoder, const touch_grid *grid, const touch_options *options, double longest_n,
                       touch_arena work, touch_arena out);
/* Go on in another `work`, for frames of more bricks; the one before is free then. */
int touch_encode_move(touch_encoder *encoder, touch_arena work);
/* The next frame; `coded`, if given, is coded in its place, and the bound applies to `frame` nevertheless. */
int touch_encode_next(touch_encoder *encoder, const touch_source *frame, const touch_source *coded,
                      const touch_spline_fit *splines);
/* The body; `frames` are those that were given. */
int touch_encode_finish(touch_encoder *encoder, const touch_source *frames, touch_segment *out);
/* Whether a frame differs from an earlier one by so little of the mask that segments of a static scene may share that one
   as their first frame: 1 or 0; -1: `work` is too small. */
int touch_is_static(const touch_grid *grid, const touch_options *options, const touch_source *frame,
                    const touch_source *earlier, touch_arena work);
/* A body, coded from `frames`, with the forces of some samples sent as they are; not of mode LOSSLESS. They predict
   nothing, so everything else decodes as before. */
int touch_encode_with_outliers(touch_encoder *encoder, const touch_grid *grid, const touch_options *options, touch_bytes body,
                            const touch_source *frames, const touch_outlier_samples *added, uint32_t count,
                            touch_arena work, touch_arena out, touch_segment *segment);

/* Other parts of a file. Their bytes lie in the arena; `text` says in words what is wrong, or is empty. */

/* Bytes of an arena that are enough: by the bricks of all supports, a support and the one before or those of all frames,
   and by all numbers, two for each sample that vibrates and seven for each pose. Bodies take 64 bytes more than they have,
   and 16 more each. */
uint64_t touch_part_room(uint64_t bricks, uint64_t numbers, uint64_t frames);

typedef struct { /* samples that vibrate in a frame, in raster order */
    uint64_t samples;
    const int32_t *position; /* [samples][3] */
    const float *amplitude_n, *frequency_hz;
} touch_vibration_samples;

typedef struct { /* a body in a segment: its poses, and its fields if it deforms */
    touch_bytes poses, fields;
    int32_t is_deforming;
} touch_body_part;

/* A support by itself, given another one of the same grid, or NULL (docs/format/bits.md). */
int touch_encode_support(const touch_grid *grid, const touch_samples *samples, const touch_samples *before,
                         touch_arena *arena, touch_bytes *out, const char **text);
/* Whole numbers by themselves, each below 2^30. */
int touch_encode_numbers(const int64_t *numbers, uint64_t count, touch_arena *arena, touch_bytes *out, const char **text);
/* The body of VIBR of a segment (docs/format/vibration.md). */
int touch_encode_vibration(const touch_grid *grid, const touch_vibration_samples *frames, uint32_t count,
                           touch_arena *arena, touch_bytes *out, const char **text);
/* Poses of a body in a segment, [count][7]: positions and quaternions in steps (docs/format/objects.md). */
int touch_encode_poses(const int64_t *numbers, uint32_t count, touch_arena *arena, touch_bytes *out, const char **text);
/* The body of a segment of coder objects; `max_error` is that of the composed field, or NULL if it has no bound. */
int touch_encode_bodies(const touch_body_part *parts, uint32_t count, const touch_segment *max_error, touch_arena *arena,
                        touch_bytes *out, const char **text);

#ifdef __cplusplus
}
#endif
#endif

#if defined TOUCH_ENCODE_IMPLEMENTATION && !defined TOUCH_ENCODE_IMPLEMENTED
#define TOUCH_ENCODE_IMPLEMENTED

#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif

/* -- bytes ----------------------------------------------------------------------------------------------------------- */

typedef struct { /* bytes that are written, or only counted if NULL; above `capacity` there was no room */
    uint8_t *bytes;
    uint64_t size, capacity;
} touch_sink;

static void touch_put(touch_sink *s, const void *bytes, uint64_t count) {
    if (s->size <= s->capacity && count <= s->capacity - s->size) {
        if (count && s->bytes) memcpy(s->bytes + s->size, bytes, (size_t)count);
        s->size += count;
    } else s->size = s->capacity + 1;
}

static void touch_put_u(touch_sink *s, uint64_t value, int bytes) {
    uint8_t out[8];
    for (int n = 0; n < bytes; n++) out[n] = (uint8_t)(value >> (8 * n));
    touch_put(s, out, (uint64_t)bytes);
}

static void touch_put_varint(touch_sink *s, uint64_t value) {
    for (; value > 127; value >>= 7) touch_put_u(s, (value & 127) | 128, 1);
    touch_put_u(s, value, 1);
}

static void touch_put_chunk(touch_sink *s, const touch_sink *chunk) {
    touch_put_varint(s, chunk->size), touch_put(s, chunk->bytes, chunk->size);
}

static int touch_sink_make(touch_sink *s, uint64_t capacity, touch_arena *arena) {
    s->bytes = (uint8_t *)touch_take(arena, capacity, 1), s->size = 0, s->capacity = capacity;
    return s->bytes != 0;
}

enum { TOUCH_END_ROOM = 48 }; /* of a sink at the end of an arena: its alignment, and a guard */

/* A sink at the end of an arena, so that pieces which are taken meanwhile can be given back while its bytes stay. */
static int touch_sink_open(touch_sink *s, uint64_t capacity, touch_arena *arena) {
    touch_arena end = *arena;
    if (arena->used + capacity + TOUCH_END_ROOM > arena->size) return 0;
    arena->size -= capacity + TOUCH_END_ROOM, end.used = arena->size;
    return touch_sink_make(s, capacity, &end);
}

/* Move its bytes down, behind what the arena has. */
static void touch_sink_close(touch_sink *s, touch_arena *arena) {
    arena->size += s->capacity + TOUCH_END_ROOM;
    s->bytes = (uint8_t *)touch_keep(arena, s->bytes, s->size), s->capacity = s->size;
}

/* -- the arithmetic code, written ------------------------------------------------------------------------------------ */

/* A coder that writes behind what a sink has. */
static touch_coder touch_writing(const touch_sink *s, const touch_tables *tables, touch_spent *spent) {
    touch_coder b;
    memset(&b, 0, sizeof b), memset(spent, 0, sizeof *spent);
    b.out = s->bytes + s->size, b.size = s->size < s->capacity ? s->capacity - s->size : 0, b.range = (uint64_t)1 << 48;
    b.tables = tables, b.spent = spent;
    return b;
}

/* Add 1 to the bytes that are written: the low end has passed them. */
static void touch_carry(touch_coder *b) {
    uint64_t n = b->position;
    while (n && b->out[--n] == 255) b->out[n] = 0;
    b->out[n]++;
}

static void touch_shift_out(touch_coder *b) {
    if (b->position + 2 <= b->size) {
        if (b->low >> 48) touch_carry(b);
        b->out[b->position] = (uint8_t)(b->low >> 40), b->out[b->position + 1] = (uint8_t)(b->low >> 32);
    } else b->size = 0; /* full, from now on */
    b->low = (b->low & 0xffffffffu) << 16, b->range <<= 16, b->position += 2;
}

/* The fewest bytes that end a code, without zeros at their end; the sink then has it. 0: there was no room. */
static int touch_finish(touch_coder *b, touch_sink *s) {
    uint64_t end = b->low, spare;
    int count = 6;
    for (int n = 0; n <= 6; n += 2) {
        spare = ((uint64_t)1 << (48 - 8 * n)) - 1, end = (b->low + spare) & ~spare;
        if (end < b->low + b->range) break;
    }
    if (b->position + 6 > b->size) return 0;
    if (end >> 48) touch_carry(b);
    for (int n = 0; n < 6; n++) b->out[b->position + (uint64_t)n] = (uint8_t)(end >> (40 - 8 * n));
    while (count && !b->out[b->position + (uint64_t)count - 1]) count--;
    s->size += b->position + (uint64_t)count;
    return 1;
}

/* Zeros until what was written from `start` on has so many bytes. */
static void touch_pad(touch_sink *s, uint64_t start, uint64_t bytes) {
    while (s->size < start + bytes && s->size <= s->capacity) touch_put_u(s, 0, 1);
}

/* The bits since the last account are of a kind (TOUCH_BITS_...). */
static void touch_account(touch_coder *b, int kind) {
    double total = 8.0 * (double)b->position + 48.0 - log2((double)b->range);
    b->spent->bits[kind] += total - b->spent->total;
    b->spent->total = total;
}

/* -- the error bound ------------------------------------------------------------------------------------------------- */

typedef struct { /* newtons, or units of a pass, less what rounding costs */
    double k, f0, sine; /* the last of the direction JND; 0 where only the mask counts */
    int is_exact;       /* a force may neither vanish nor appear */
} touch_bound;

static double touch_size(const double f[3]) { return sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]); }

/* The square of |error| / allowed of a decoded force d in place of f; `hidden` is what forces around hide. */
static double touch_error_ratio2(const double f[3], const double d[3], double hidden, const touch_bound *bound) {
    double x = d[0] - f[0], y = d[1] - f[1], z = d[2] - f[2], error2 = x * x + y * y + z * z, size, allowed;
    if (error2 == 0.0) return 0.0;
    size = touch_size(f), allowed = bound->k * size + hidden;
    if (!(allowed > bound->f0)) allowed = bound->f0;
    if (bound->sine > 0.0) {
        if (size * bound->sine > bound->f0) {
            double radial = fabs(touch_size(d) - size) / allowed, c[3], angle;
            c[0] = f[1] * d[2] - f[2] * d[1], c[1] = f[2] * d[0] - f[0] * d[2], c[2] = f[0] * d[1] - f[1] * d[0];
            angle = atan2(touch_size(c), f[0] * d[0] + f[1] * d[1] + f[2] * d[2]) / asin(bound->sine);
            if (angle > radial) radial = angle;
            return radial * radial;
        }
        allowed = bound->f0;
    }
    return allowed > 0.0 ? error2 / (allowed * allowed) : HUGE_VAL;
}

/* Whether |error| / allowed of a decoded force is surely at most a ratio, whose square is `ratio2`: a test that spares most
   voxels a root and a division, and leaves the doubtful ones to touch_error_ratio2. */
static int touch_is_surely_within(const double f[3], const double d[3], const touch_bound *bound, double ratio2) {
    const double rounding = 1e-12; /* far more than what the products lose */
    double x = d[0] - f[0], y = d[1] - f[1], z = d[2] - f[2], error2 = x * x + y * y + z * z;
    double allowed2 = bound->k * bound->k * (f[0] * f[0] + f[1] * f[1] + f[2] * f[2]), floor2 = bound->f0 * bound->f0;
    if (!(allowed2 > floor2)) allowed2 = floor2;
    return !bound->is_exact && !(bound->sine > 0.0) && error2 <= (1 - rounding) * ratio2 * allowed2;
}

/* Whether a vector in units may stand for a force; (0, 0, 0) is none. `f` is followed by what forces around hide. */
static int touch_is_within(const int32_t v[3], const double f[4], const touch_bound *bound) {
    double d[3];
    if (bound->is_exact && (v[0] || v[1] || v[2]) != (f[0] != 0.0 || f[1] != 0.0 || f[2] != 0.0)) return 0;
    for (int n = 0; n < 3; n++) d[n] = v[n];
    return touch_error_ratio2(f, d, f[3], bound) <= 1.0;
}

enum { TOUCH_COUNT_OUTLIERS, TOUCH_SEND_OUTLIERS }; /* sent as they are, they are no error */

typedef struct { /* a decoded frame compared with its original */
    uint64_t *outlier, outliers; /* 512 times the number of a brick plus the sample, ascending */
    double max_ratio;
    uint32_t voxel[3];
    uint64_t within, decoded; /* voxels with a force that are within the bound; decoded ones with a force */
    int are_sent;             /* outliers */
} touch_comparison;

typedef struct { /* decoded forces, by keys of bricks */
    uint64_t count;
    const uint64_t *key;
    const uint32_t *slot; /* of each key, in `forces_n`; NULL: in order */
    const float *forces_n;
} touch_brick_forces;

/* The keys of a source; they ascend. */
static uint64_t *touch_source_keys(const touch_source *s, touch_arena *arena) {
    uint64_t *key = (uint64_t *)touch_take(arena, s->bricks, 8);
    for (uint64_t i = 0; key && i < s->bricks; i++)
        key[i] = touch_key(s->brick[3 * i], s->brick[3 * i + 1], s->brick[3 * i + 2]);
    return key;
}

/* One brick of both, either of them may be missing; counts, and writes outliers from `c->outlier` on where given. */
static void touch_compare_brick(const float *original, const float *hidden, const float *decoded, const touch_bound *bound,
                                const touch_grid *grid, uint64_t key, touch_comparison *c) {
    static const float none[1536];
    int32_t at[3];
    touch_position(key, at);
    uint64_t number = 512 * (uint64_t)touch_brick_number(grid, at[0], at[1], at[2]);
    if (!original) original = none;
    if (!decoded) decoded = none;
    for (int n = 0; n < 512; n++) {
        double f[3], d[3];
        for (int i = 0; i < 3; i++) f[i] = original[3 * n + i], d[i] = decoded[3 * n + i];
        int is_supported = f[0] != 0.0 || f[1] != 0.0 || f[2] != 0.0, is_sent = d[0] != 0.0 || d[1] != 0.0 || d[2] != 0.0;
        if (!is_supported && !is_sent) continue;
        if (!hidden && touch_is_surely_within(f, d, bound, c->max_ratio < 1.0 ? c->max_ratio : 1.0)) {
            c->decoded += (uint64_t)is_sent, c->within += (uint64_t)is_supported;
            continue;
        }
        double ratio2 = touch_error_ratio2(f, d, hidden ? hidden[n] : 0.0, bound);
        if (bound->is_exact && is_supported != is_sent) ratio2 = HUGE_VAL;
        int is_outlier = ratio2 > 1.0, is_exact = is_outlier && c->are_sent;
        c->decoded += (uint64_t)(is_exact ? is_supported : is_sent), c->within += (uint64_t)(is_supported && !is_outlier);
        if (is_outlier) {
            if (c->outlier) c->outlier[c->outliers] = number + (uint64_t)n;
            c->outliers++;
        }
        if (is_exact || !(ratio2 > c->max_ratio)) continue;
        c->max_ratio = ratio2;
        for (int i = 0; i < 3; i++) c->voxel[i] = (uint32_t)(8 * at[i] + (n >> (6 - 3 * i) & 7));
    }
}

/* Compare frames in all bricks of both. The outliers are counted, or listed in `arena` to be sent. */
static int touch_compare(const touch_source *original, const touch_brick_forces *decoded, const touch_bound *bound,
                         const touch_grid *grid, int outliers, touch_comparison *c, touch_arena *arena) {
    memset(c, 0, sizeof *c);
    for (int pass = 0; pass < 2; pass++) {
        uint64_t i = 0, j = 0, mark = arena->used, *key = touch_source_keys(original, arena), *list = c->outlier;
        if (!key) return 0;
        memset(c, 0, sizeof *c), c->are_sent = outliers == TOUCH_SEND_OUTLIERS, c->outlier = list;
        while (i < original->bricks || j < decoded->count) {
            int has_first = j == decoded->count || (i < original->bricks && key[i] <= decoded->key[j]);
            int has_second = i == original->bricks || (j < decoded->count && decoded->key[j] <= key[i]);
            touch_compare_brick(has_first ? original->forces_n + 1536 * i : 0,
                                has_first && original->hidden_n ? original->hidden_n + 512 * i : 0,
                                has_second ? decoded->forces_n + 1536 * (decoded->slot ? decoded->slot[j] : j) : 0, bound, grid,
                                has_first ? key[i] : decoded->key[j], c);
            i += (uint64_t)has_first, j += (uint64_t)has_second;
        }
        arena->used = mark;
        if (pass || outliers == TOUCH_COUNT_OUTLIERS || !c->outliers) break;
        c->outlier = (uint64_t *)touch_take(arena, c->outliers, 8);
        if (!c->outlier) return 0;
    }
    c->max_ratio = sqrt(c->max_ratio);
    return 1;
}

/* Forces in newtons of vectors in units: one product each, as a reader makes it. */
static int touch_newtons_of(touch_brick_forces *forces, const touch_units *units, float unit_n, touch_arena *arena) {
    float *out = (float *)touch_take(arena, 1536 * units->list.count, 4);
    forces->count = units->list.count, forces->key = units->list.key, forces->slot = 0, forces->forces_n = out;
    for (uint64_t i = 0; out && i < 512 * units->list.count; i++)
        for (int n = 0; n < 3; n++) out[3 * i + (uint64_t)n] = unit_n * (float)units->v[i].v[n];
    return out != 0;
}

/* -- the choices of a writer in the voxel pass ----------------------------------------------------------------------- */

struct touch_target {
    const touch_source *source;
    double units_per_n;
    touch_bound bound;
    double force[512][4]; /* of the brick, in the order of the scan, units; and what forces around hide */
};

/* The forces of a brick of the source, permuted to the scan. */
static void touch_load_target(touch_pass *p, uint64_t brick) {
    struct touch_target *t = p->target;
    for (int n = 0; n < 512; n++) {
        uint64_t at = 512 * brick + (uint64_t)touch_grid_sample(&p->scan, n >> 6, n >> 3 & 7, n & 7);
        for (int k = 0; k < 3; k++) {
            double f = t->source->forces_n[3 * at + (uint64_t)p->scan.axis[k]] * t->units_per_n;
            t->force[n][k] = p->scan.sign[k] < 0 ? -f : f;
        }
        t->force[n][3] = t->source->hidden_n ? fabs(t->source->hidden_n[at] * t->units_per_n) : 0.0;
    }
}

static const double *touch_target_at(const touch_pass *p, int here) {
    return p->target->force[64 * (here / TOUCH_DEEP - 2) + 8 * (here / TOUCH_UP % 12 - 2) + here % 12 - 2];
}

/* COPY if the reference is within the bound everywhere, else FOLLOW. */
static int touch_choose_state(const touch_pass *p, uint64_t brick, uint64_t reference) {
    const struct touch_target *t = p->target;
    const float *forces = t->source->forces_n + 1536 * brick, *hidden = t->source->hidden_n;
    const touch_int_vector *v = p->reference->v + 512 * reference;
    for (int n = 0; n < 512; n++) {
        double f[4], d[3];
        int32_t permuted[3];
        for (int k = 0; k < 3; k++) f[k] = forces[3 * n + k] * t->units_per_n, d[k] = v[n].v[k];
        if (touch_is_surely_within(f, d, &t->bound, 1.0)) continue;
        for (int k = 0; k < 3; k++) { /* in the order of the scan, as the voxels are compared */
            permuted[k] = p->scan.sign[k] * v[n].v[p->scan.axis[k]];
            f[k] = p->scan.sign[k] * (forces[3 * n + p->scan.axis[k]] * t->units_per_n);
        }
        f[3] = hidden ? fabs(hidden[512 * brick + (uint64_t)n] * t->units_per_n) : 0.0;
        if (!touch_is_within(permuted, f, &t->bound)) return TOUCH_FOLLOW;
    }
    return TOUCH_COPY;
}

/* A force is coded if it may not vanish. */
static int touch_is_coded(const struct touch_target *t, const double f[3]) {
    return touch_size(f) > (t->bound.is_exact ? 0.0 : t->bound.f0);
}

static int touch_choose_blocks(const touch_pass *p) {
    int blocks = 0;
    for (int n = 0; n < 512; n++)
        if (touch_is_coded(p->target, p->target->force[n])) blocks |= 1 << ((n >> 8) * 4 + (n >> 5 & 1) * 2 + (n >> 2 & 1));
    return blocks;
}

static int touch_choose_support(const touch_pass *p, int here) { return touch_is_coded(p->target, touch_target_at(p, here)); }

static int touch_choose_skip(const touch_pass *p, const touch_voxel *v) {
    return touch_is_within(v->prediction, touch_target_at(p, v->here), &p->target->bound);
}

/* The nearest whole number, within 2^40. */
static int64_t touch_round(double x) {
    const double max = 1099511627776.0;
    return (int64_t)rint(x < -max ? -max : x < max ? x : max);
}

/* The residual that probably costs the fewest bits, of the points around the force that keep the bound: zeros are cheap,
   then small numbers. The nearest point if none keeps it. */
static void touch_choose_residual(const touch_pass *p, touch_voxel *v) {
    static const int around[3] = {0, -1, 1};
    const double *f = touch_target_at(p, v->here);
    const double bits_a_step = 0.3; /* estimated cost of a component: 1 if it is not zero, and so much for each step */
    double target[3], best = HUGE_VAL; /* the force along the axes of the residual */
    for (int k = 0; k < 3; k++)
        target[k] = (f[0] * (double)v->basis[k][0] + f[1] * (double)v->basis[k][1] + f[2] * (double)v->basis[k][2]) /
                    (double)TOUCH_ONE;
    int64_t position = touch_step_position(p->steps, touch_round(fabs(target[0])));
    int64_t nearest = (int64_t)rint((double)((target[0] >= 0 ? position : -position) - v->centre_position) / 256.0);
    v->residual[0] = v->residual[1] = v->residual[2] = 0;
    for (int i = 0; i < 3; i++) {
        int64_t r[3], low[2], step, length;
        r[0] = nearest + around[i], length = touch_radial_length(p, v, r[0], &step);
        low[0] = touch_round(target[1] / (double)step), low[1] = touch_round(target[2] / (double)step);
        for (int j = 0; j < 9; j++) {
            int32_t vector[3];
            r[1] = low[0] + around[j / 3], r[2] = low[1] + around[j % 3];
            int64_t sum = touch_abs(r[0]) + touch_abs(r[1]) + touch_abs(r[2]);
            int64_t max = touch_max(touch_max(touch_abs(r[0]), touch_abs(r[1])), touch_abs(r[2]));
            double cost = (double)((r[0] != 0) + (r[1] != 0) + (r[2] != 0)) + bits_a_step * (double)sum;
            if (!(cost < best) || max > TOUCH_MAX_MAGNITUDE || !(max > 0 || v->predictor)) continue;
            touch_residual_vector(v, length, r[1] * step, r[2] * step, vector);
            int is_within = touch_is_within(vector, f, &p->target->bound);
            if (is_within) best = cost;
            if (is_within || i + j == 0) memcpy(v->residual, r, sizeof v->residual);
        }
    }
}

/* -- a frame --------------------------------------------------------------------------------------------------------- */

/* Bytes of a code for each brick at most: noise takes 8000, and a code that takes more is refused. */
enum { TOUCH_BRICK_BYTES = 12288 };

typedef struct { /* a coded frame */
    touch_sink payload;
    touch_units units; /* what a reader has */
    touch_models *models;
    touch_spent spent;
    double squared_error; /* units */
} touch_coded;

/* The order of the scan: along the force on every axis. The slowest axis is that of the largest total force; of two
   similar ones, that of the coarser spacing. */
static int touch_choose_scan(const touch_grid *grid, const touch_source *frame) {
    double sum[3] = {0, 0, 0}, size[3] = {0, 0, 0}, best = -1, finest = grid->spacing_m[0], coarsest = finest;
    int order = 0, axis, flag = 8;
    for (uint64_t i = 0; i < 512 * frame->bricks; i++)
        for (int n = 0; n < 3; n++) {
            double f = frame->forces_n[3 * i + (uint64_t)n];
            sum[n] += f, size[n] += fabs(f);
        }
    for (int n = 1; n < 3; n++) {
        finest = grid->spacing_m[n] < finest ? grid->spacing_m[n] : finest;
        coarsest = grid->spacing_m[n] > coarsest ? grid->spacing_m[n] : coarsest;
    }
    for (int n = 0; n < 3; n++) {
        int is_fine = grid->spacing_m[n] < (1.01 * finest < 0.99 * coarsest ? 1.01 * finest : 0.99 * coarsest);
        double total = (fabs(sum[n]) + 0.01 * size[n]) * (is_fine ? 0.85 : 1.0);
        if (total > best) best = total, order = n;
    }
    axis = order, order |= sum[axis] < 0 ? 4 : 0;
    for (int n = 0; n < 3; n++)
        if (n != axis) order |= sum[n] < 0 ? flag : 0, flag = 16;
    return order;
}

/* Voxels of an original minus their vectors, squared and summed, units. */
static double touch_squared_error(const touch_source *frame, const touch_units *units, double units_per_n) {
    double sum = 0;
    for (uint64_t i = 0; i < 512 * frame->bricks; i++)
        for (int n = 0; n < 3; n++) {
            double error = units->v[i].v[n] - frame->forces_n[3 * i + (uint64_t)n] * units_per_n;
            sum += error * error;
        }
    return sum;
}

/* Code a frame, given what a reader has: the reference and the models, which are copied. */
static int touch_code_frame(const touch_grid *grid, const touch_steps *steps, const touch_tables *tables,
                            const touch_bound *bound, const touch_source *frame, const touch_units *reference,
                            const touch_models *models, touch_coded *out, touch_arena *arena, touch_cursor *error) {
    int order = touch_choose_scan(grid, frame);
    struct touch_target *target = (struct touch_target *)touch_take(arena, 1, sizeof *target);
    touch_pass *p = (touch_pass *)touch_take(arena, 1, sizeof *p);
    touch_coder coder;
    memset(out, 0, sizeof *out);
    out->models = (touch_models *)touch_take(arena, 1, sizeof *out->models);
    out->units.v = (touch_int_vector *)touch_take(arena, 512 * frame->bricks, sizeof *out->units.v);
    out->units.list.key = touch_source_keys(frame, arena), out->units.list.count = frame->bricks;
    if (!target || !p || !out->models || !out->units.v || !out->units.list.key ||
        !touch_sink_open(&out->payload, (frame->bricks + 1) * TOUCH_BRICK_BYTES, arena))
        return touch_fail(error, TOUCH_MEMORY, "no room for a frame");
    uint64_t mark = arena->used;
    memcpy(out->models, models, sizeof *models);
    touch_put_u(&out->payload, (uint64_t)order, 4); /* slopes of 0: no loss of force is expected along an axis */
    target->source = frame, target->units_per_n = 1.0 / (double)steps->unit_n, target->bound = *bound;
    coder = touch_writing(&out->payload, tables, &out->spent);
    p->coder = &coder, p->models = out->models, p->steps = steps, p->reference = reference, p->target = target;
    p->scan = touch_scan_of(order, grid), p->slope[0] = p->slope[1] = p->slope[2] = 0;
    if (!touch_code_list(&coder, &out->models->list, grid->shape, reference->list, &out->units.list, arena, error)) return 0;
    if (!touch_code_bricks(p, grid, &out->units, arena, error)) return 0;
    touch_account(&coder, TOUCH_BITS_SUPPORT);
    arena->used = mark;
    if (!touch_finish(&coder, &out->payload)) return touch_fail(error, TOUCH_MEMORY, "no room for a payload");
    touch_pad(&out->payload, 4, touch_min_bytes(frame->bricks));
    touch_sink_close(&out->payload, arena);
    if (!(bound->k > 0)) out->squared_error = touch_squared_error(frame, &out->units, target->units_per_n);
    return 1;
}

/* -- base layers: columns, fitted ------------------------------------------------------------------------------------ */

struct touch_column_fit { /* the samples of a column, from outside to inside, and the surfaces that they speak for */
    const touch_source *source;
    touch_map map; /* indices of its bricks */
    float units_per_n;
    double k, f0;       /* the mask, units */
    double top, ramp;   /* the force deep inside, units; the growth of its fraction from sample to sample */
    float (*force)[4];  /* [depth]: along a, along b, outward, and the length; units */
    double *weight;     /* [depth]: 1 over the square of what is allowed */
    double (*rest)[3];  /* [depth]: what the first of two surfaces leaves */
    int64_t first, flat; /* first sample with a force; that from which on it is constant */
    double surface[3][4]; /* numbers of the one surface, and of two; an amplitude of 0 is not known */
};

enum {
    TOUCH_AXIS_BRICKS = 64,       /* so many bricks are enough to find the axis of a frame */
    TOUCH_BRICK_PAIRS = 7 * 8 * 8 /* samples of a brick that have a next one along an axis within it */
};

/* The axis of the columns: the main axis of the force, if there is one. */
static int touch_find_axis(const touch_source *frame, int *axis, int *is_inverted) {
    uint64_t step = (frame->bricks + TOUCH_AXIS_BRICKS - 1) / TOUCH_AXIS_BRICKS;
    double total[3] = {0, 0, 0}, size = 0;
    for (uint64_t i = 0; i < frame->bricks; i += step)
        for (int n = 0; n < 512; n++) {
            const float *f = frame->forces_n + 1536 * i + 3 * n;
            for (int k = 0; k < 3; k++) total[k] += f[k];
            size += sqrtf(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]);
        }
    *axis = fabs(total[1]) > fabs(total[0]) ? 1 : 0;
    if (fabs(total[2]) > fabs(total[*axis])) *axis = 2;
    *is_inverted = total[*axis] > 0;
    return !(fabs(total[*axis]) < 0.4 * size); /* else forces point in all directions */
}

/* The box of columns of a frame: 1; 0 if it has no main axis, few of its tiles reach the inner border of the grid (what
   the force of a solid does), or the box is too large; -1 if there is no memory. */
static int touch_find_column_box(touch_column_box *v, const touch_grid *grid, const touch_source *frame, touch_arena *arena) {
    uint64_t mark = arena->used, *key = (uint64_t *)touch_take(arena, frame->bricks, 8), tiles = 0, border = 0;
    uint32_t *tag = (uint32_t *)touch_take_zero(arena, frame->bricks, 4);
    int axis, is_inverted;
    int64_t last[2] = {0, 0};
    if (!key || !tag) return -1;
    if (!frame->bricks || !touch_find_axis(frame, &axis, &is_inverted)) return 0;
    *v = touch_column_box_of(grid, axis, is_inverted);
    int32_t inner = is_inverted ? 0 : (int32_t)((grid->shape[axis] + 7) >> 3) - 1;
    for (uint64_t i = 0; i < frame->bricks; i++) {
        const int32_t *b = frame->brick + 3 * i;
        for (int n = 0; n < 2; n++) {
            int64_t tile = b[v->across[n]];
            if (!i || tile < v->tile[n]) v->tile[n] = tile;
            if (!i || tile > last[n]) last[n] = tile;
        }
        key[i] = touch_key(b[v->across[0]], b[v->across[1]], 0), border += b[axis] == inner;
    }
    touch_sort(key, tag, frame->bricks);
    for (uint64_t i = 0; i < frame->bricks; i++) tiles += !i || key[i] != key[i - 1];
    arena->used = mark;
    for (int n = 0; n < 2; n++) v->tiles[n] = last[n] - v->tile[n] + 1;
    return !((double)border < 0.2 * (double)tiles) && v->depth <= 1 << 14 &&
           v->tiles[0] * v->tiles[1] <= 64 + 4 * (int64_t)tiles && v->tiles[1] * 64 * v->depth <= 1 << 24;
}

/* The number of rank `rank`, from 0, of positive floats given as bits; `count` is room for 65536 numbers. */
static uint32_t touch_ranked(const uint32_t *bits, uint64_t n, uint64_t rank, uint32_t *count) {
    uint32_t found = 0;
    for (int shift = 16; shift >= 0; shift -= 16) {
        uint32_t digit = 0;
        memset(count, 0, 65536 * sizeof *count);
        for (uint64_t i = 0; i < n; i++)
            if (shift || bits[i] >> 16 == found >> 16) count[bits[i] >> shift & 65535]++;
        while (rank >= count[digit]) rank -= count[digit++];
        found |= digit << shift;
    }
    return found;
}

/* How much the force grows from sample to sample behind a surface, relative to the top: the 80th percentile, as larger
   growths are of mixed surfaces. 0: it does not grow, or the top is not above the mask; -1: no memory. */
static double touch_find_ramp(const touch_column_box *v, const touch_source *frame, float unit_n, double f0, double *top,
                              touch_arena *arena) {
    uint64_t mark = arena->used, count = 0, rank;
    uint32_t *ratio = (uint32_t *)touch_take(arena, TOUCH_BRICK_PAIRS * frame->bricks, 4);
    uint32_t *room = (uint32_t *)touch_take(arena, 65536, 4);
    int step = 64 >> 3 * v->axis;
    float longest = 0;
    if (!ratio || !room) return -1;
    for (uint64_t i = 0; i < 512 * frame->bricks; i++) {
        const float *f = frame->forces_n + 3 * i;
        float length = sqrtf(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]) / unit_n;
        if (length > longest) longest = length;
    }
    *top = longest;
    const float low_limit = (float)(0.2 * *top), high_limit = (float)(0.9 * *top), growth_limit = (float)(0.002 * *top);
    for (uint64_t i = 0; i < 512 * frame->bricks; i++) {
        if ((i & 511) / (uint64_t)step % 8 == 7) continue; /* both samples lie in one brick */
        const float *at = frame->forces_n + 3 * i, *next = at + 3 * step, *f = v->is_inverted ? next : at;
        const float *inner = v->is_inverted ? at : next;
        float low = sqrtf(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]) / unit_n, outward = fabsf(f[v->axis]) / unit_n;
        float growth = sqrtf(inner[0] * inner[0] + inner[1] * inner[1] + inner[2] * inner[2]) / unit_n - low;
        if (low > low_limit && low + growth < high_limit && growth > growth_limit && outward > 0.3f * low)
            ratio[count++] = touch_f32_bits(growth * low / outward);
    }
    if (count < 8 || *top <= f0) return 0;
    double index = (double)(count - 1) * 0.8;
    rank = (uint64_t)floor(index), index -= (double)rank;
    float low = touch_f32_of(touch_ranked(ratio, count, rank, room));
    float high = rank + 1 < count ? touch_f32_of(touch_ranked(ratio, count, rank + 1, room)) : low;
    arena->used = mark;
    float between = index >= 0.5 ? high - (high - low) * (float)(1 - index) : low + (high - low) * (float)index;
    return (double)between / *top;
}

/* The numbers that all columns have in common; 0: there is no solid behind a surface, -1: no memory. */
static int touch_find_heads(touch_columns *columns, const touch_source *frame, float unit_n, double k, double f0,
                            touch_arena *arena) {
    static const int64_t low[7] = {1, 1, 0, 0, 16, 4, 16};
    static const int64_t limit[7] = {1 << 17, 1 << 20, 1 << 20, 1 << 20, 1 << 14, 1 << 12, 1 << 16};
    const touch_column_box *v = &columns->box;
    const double *spacing = v->grid->spacing_m;
    double top, ramp = touch_find_ramp(v, frame, unit_n, f0, &top, arena), number[7], ratio;
    int64_t head[7];
    if (!(ramp > 0)) return (int)ramp;
    ratio = f0 / top < 0.5 ? f0 / top : 0.5, ratio = ratio > k ? ratio : k, ratio = ratio > 1e-3 ? ratio : 1e-3;
    number[0] = top, number[1] = 65536 * ramp;
    for (int n = 0; n < 2; n++) number[2 + n] = 256 * spacing[v->across[n]] / spacing[v->axis];
    number[4] = 16384 * ratio * 0.35, number[6] = 65536 * ratio * 0.9;
    number[5] = 256 * (f0 / top > 0.1 * k ? f0 / top : 0.1 * k) / ramp * 1.4; /* steps should not exceed the mask by much */
    for (int n = 0; n < 7; n++) {
        double clipped = number[n] > (double)low[n] ? number[n] : (double)low[n];
        head[n] = (int64_t)rint(clipped < (double)(limit[n] - 1) ? clipped : (double)(limit[n] - 1));
    }
    columns->top = head[0], columns->ramp = head[1], columns->ratio[0] = head[2], columns->ratio[1] = head[3];
    for (int n = 0; n < 3; n++) columns->step[n] = head[4 + n];
    return 1;
}

/* The samples of the column at (a, b) of the box; 0: there is no force at its inner end. */
static int touch_load_column(const touch_columns *columns, int64_t a, int64_t b) {
    struct touch_column_fit *f = columns->fit;
    const touch_column_box *v = &columns->box;
    int64_t at[3], brick = -1, last = v->is_inverted ? 0 : v->depth - 1;
    at[v->across[0]] = 8 * v->tile[0] + a, at[v->across[1]] = 8 * v->tile[1] + b, at[v->axis] = last;
    if (touch_map_get(&f->map, touch_key(at[0] >> 3, at[1] >> 3, at[2] >> 3)) < 0) return 0;
    for (int64_t i = 0; i < v->depth; i++) {
        float *to = f->force[v->is_inverted ? v->depth - 1 - i : i];
        at[v->axis] = i;
        if (!(i & 7)) brick = touch_map_get(&f->map, touch_key(at[0] >> 3, at[1] >> 3, at[2] >> 3));
        to[0] = to[1] = to[2] = to[3] = 0;
        if (brick < 0) continue;
        const float *from = f->source->forces_n + 3 * (512 * brick + 64 * (at[0] & 7) + 8 * (at[1] & 7) + (at[2] & 7));
        to[0] = from[v->across[0]] * f->units_per_n, to[1] = from[v->across[1]] * f->units_per_n;
        to[2] = from[v->axis] * f->units_per_n, to[2] = v->is_inverted ? to[2] : -to[2];
        to[3] = sqrtf(to[0] * to[0] + to[1] * to[1] + to[2] * to[2]);
    }
    return f->force[v->depth - 1][3] > 0;
}

/* The mean direction of weighted sums, and their length. */
static double touch_unit_of(double u[3]) {
    double length = touch_size(u);
    for (int n = 0; n < 3; n++) u[n] /= length > 1e-9 ? length : 1e-9;
    return length;
}

static double touch_inner_product(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

/* A sample of the column, or of what the first surface leaves. */
static void touch_column_sample(const struct touch_column_fit *f, int is_rest, int64_t t, double out[3]) {
    for (int n = 0; n < 3; n++) out[n] = is_rest ? f->rest[t][n] : (double)f->force[t][n];
}

/* The direction of samples start to stop - 1; returns the length of their weighted sum. */
static double touch_direction(const struct touch_column_fit *f, int is_rest, int64_t start, int64_t stop, double u[3]) {
    double d[3];
    u[0] = u[1] = u[2] = 0;
    for (int64_t t = start; t < stop; t++) {
        touch_column_sample(f, is_rest, t, d);
        for (int n = 0; n < 3; n++) u[n] += f->weight[t] * d[n];
    }
    return touch_unit_of(u);
}

/* Where the ramp of samples start to stop - 1 begins, samples. */
static double touch_ramp_start(const struct touch_column_fit *f, int is_rest, const double u[3], double amplitude,
                               double slope, int64_t start, int64_t stop) {
    double total = 0, weight = 0, d[3];
    for (int64_t t = start; t < stop; t++) {
        touch_column_sample(f, is_rest, t, d);
        double fraction = touch_inner_product(d, u) / amplitude;
        if (0.0 < fraction && fraction < 0.97) total += f->weight[t] * ((double)t - fraction / slope), weight += f->weight[t];
    }
    return weight > 0 ? total / weight : (double)start - 0.5;
}

static void touch_set_fit(double out[4], const double u[3], double start, double amplitude) {
    out[0] = 16384.0 * u[0] / (1.0 + u[2]), out[1] = 16384.0 * u[1] / (1.0 + u[2]), out[2] = 256.0 * start;
    out[3] = amplitude;
}

/* The span of a column, the weights of its samples, and the one surface. */
static void touch_fit_one(struct touch_column_fit *f, int64_t depth) {
    int64_t first = depth, flat = depth - 1;
    double u[3], deepest = f->force[depth - 1][3];
    while (first > 0 && f->force[first - 1][3] > 0) {
        double allowed = f->k * (double)f->force[--first][3];
        if (!(allowed > f->f0)) allowed = f->f0;
        f->weight[first] = 1.0 / (allowed * allowed);
    }
    while (flat > first && (double)fabsf(f->force[flat - 1][3] - f->force[depth - 1][3]) <= 0.01 * deepest) flat--;
    if (flat == depth - 1) flat = depth;
    f->first = first, f->flat = flat;
    touch_direction(f, 0, first, depth, u);
    if (u[2] < 0.05) u[2] = 0.05; /* no direction is less outward */
    double amplitude = flat < depth ? deepest : f->top;
    double start = touch_ramp_start(f, 0, u, amplitude, f->ramp * u[2], first, flat);
    touch_set_fit(f->surface[0], u, start, flat < depth ? amplitude : 0.0);
}

/* Two surfaces that part at `cut`; the error, or -1 if there are none. */
static double touch_fit_cut(struct touch_column_fit *f, int64_t depth, int64_t cut, double one[4], double two[4]) {
    double u[3], v[3], growth, amplitude = 0, cost = 0, before[3], after[3];
    touch_direction(f, 0, f->first, cut, u);
    touch_column_sample(f, 0, f->first + 1, before), touch_column_sample(f, 0, cut - 1, after);
    growth = (touch_inner_product(after, u) - touch_inner_product(before, u)) / (double)(cut - f->first - 2);
    if (u[2] > 0.05) amplitude = growth / (f->ramp * u[2]);
    if (amplitude < 0.01 * f->top || amplitude > 1.5 * f->top) return -1;
    double start = touch_ramp_start(f, 0, u, amplitude, f->ramp * u[2], f->first, cut);
    for (int64_t t = f->first; t < depth; t++) {
        double fraction = ((double)t - start) * f->ramp * u[2];
        double size = amplitude * (fraction < 0 ? 0.0 : fraction > 1 ? 1.0 : fraction);
        for (int n = 0; n < 3; n++) f->rest[t][n] = (double)f->force[t][n] - size * u[n];
    }
    double behind = touch_direction(f, 1, f->flat < depth ? depth - 1 : cut, depth, v);
    behind = f->flat < depth ? behind / f->weight[depth - 1] : f->top - amplitude;
    if (v[2] <= 0.05 || behind < 0.01 * f->top) return -1;
    double start_behind = touch_ramp_start(f, 1, v, behind, f->ramp * v[2], cut, f->flat);
    for (int64_t t = f->first; t < f->flat; t++) {
        double fraction = ((double)t - start_behind) * f->ramp * v[2], e[3];
        double size = behind * (fraction < 0 ? 0.0 : fraction > 1 ? 1.0 : fraction);
        for (int n = 0; n < 3; n++) e[n] = f->rest[t][n] - size * v[n];
        double error = touch_inner_product(e, e) * f->weight[t];
        cost += error < 4.0 ? error : 4.0;
    }
    touch_set_fit(one, u, start, amplitude), touch_set_fit(two, v, start_behind, behind);
    return cost;
}

/* Two surfaces one behind the other, where they miss least; 0: there are none. */
static int touch_fit_two(struct touch_column_fit *f, int64_t depth) {
    double best = 1e18;
    int64_t step = touch_max((f->flat - f->first) / 24, 1);
    for (int64_t cut = f->first + 3; cut < f->flat; cut += step) {
        double one[4], two[4], cost = touch_fit_cut(f, depth, cut, one, two);
        if (cost < 0 || !(cost < best)) continue;
        best = cost, memcpy(f->surface[1], one, sizeof one), memcpy(f->surface[2], two, sizeof two);
    }
    return best < 1e18;
}

/* Bits of a residual, about. */
static double touch_residual_bits(int64_t r) { return r ? 2.5 + 2.0 * log2((double)touch_abs(r)) : 0.1; }

/* Bits that the voxels of a column would still take, about; whatever is above `enough` counts as that. */
static double touch_column_cost(const touch_columns *columns, const touch_column *own, double enough) {
    const struct touch_column_fit *f = columns->fit;
    const double miss = 6.5; /* bits, about, of a voxel that the base layer misses */
    double cost = 0.0;
    int64_t start = touch_max(0, touch_min(f->first, own->surface[0].number[TOUCH_START] >> 8));
    for (int64_t t = start; t < columns->box.depth; t++) {
        double deep[2] = {0, 0}, square = 0.0;
        for (int n = 0; n < own->count; n++)
            deep[n] = (double)(touch_ramp(columns, own->surface + n, t) * own->surface[n].number[TOUCH_AMPLITUDE]);
        for (int n = 0; n < 3; n++) {
            double sum = deep[0] * own->surface[0].normal[n];
            if (own->count > 1) sum += deep[1] * own->surface[1].normal[n];
            double x = sum / 1073741824.0 - (double)f->force[t][n];
            square += x * x;
        }
        double allowed = f->k * (double)f->force[t][3];
        if (!(allowed > f->f0)) allowed = f->f0;
        if (square > allowed * allowed) cost += miss;
        if (cost > enough) break;
    }
    return cost;
}

/* Set the surfaces of a column by a choice, with its residuals, and return the bits that this takes, about. Bits 0, 1, 2
   of `fitted`: whether direction, start and amplitude of the last surface are as fitted, else as expected. */
static double touch_try_column(touch_columns *columns, const touch_column *const around[4], touch_column *own,
                               touch_column_choice *choice, int fitted, double best) {
    const int count = choice->count;
    double bits = 0.2 + 2.0 * (choice->mode > 0) + 3.0 * (count > 1);
    own->count = 0;
    for (int slot = 0; slot < count; slot++) {
        const double *fit = columns->fit->surface[slot + count - 1];
        const touch_surface *continued[2];
        int64_t expected[4], *r = choice->residual[slot];
        int continues = touch_expect_surface(columns, around, own, slot, choice->mode, count, expected, continued);
        for (int q = 0; q < 4; q++) {
            int is_fitted = slot + 1 < count || (fitted >> (q > 1 ? q - 1 : 0) & 1);
            int64_t step = q == TOUCH_AMPLITUDE ? touch_amplitude_step(columns, expected[q]) : columns->step[q == TOUCH_START];
            r[q] = 0;
            if (is_fitted && fit[TOUCH_AMPLITUDE] + (q != TOUCH_AMPLITUDE) > 0.0) {
                double steps = (fit[q] - (double)expected[q]) / (double)step;
                r[q] = (int64_t)rint(steps < -1e6 ? -1e6 : steps > 1e6 ? 1e6 : steps);
            }
            bits += touch_residual_bits(r[q]);
            if (q == TOUCH_DIRECTION_B) touch_turn_surface(columns, own->surface + slot, expected, r, continued, continues);
        }
        touch_set_surface(columns, own->surface + slot, expected, r);
        own->count = slot + 1;
    }
    return bits < best ? bits + touch_column_cost(columns, own, best - bits) : best;
}

/* One surface or two, which neighbours they continue, and what of them is sent: the fewest bits, about. Columns without
   a force at their inner end have no surface. */
static void touch_choose_column(touch_columns *columns, int64_t a, int64_t b, const touch_column *const around[4],
                                touch_column *own, touch_column_choice *choice) {
    double best = 1e18;
    int modes = touch_is_torn(around) ? 4 : 1, chosen[3] = {1, 0, 0};
    if (!touch_load_column(columns, a, b)) return;
    touch_fit_one(columns->fit, columns->box.depth);
    for (int count = 1; count <= 2; count++) {
        if (count == 2 && !touch_fit_two(columns->fit, columns->box.depth)) break;
        for (int n = 0; n < 8 * modes; n++) {
            choice->count = count, choice->mode = n >> 3;
            double bits = touch_try_column(columns, around, own, choice, n & 7, best);
            if (bits < best) best = bits, chosen[0] = count, chosen[1] = n >> 3, chosen[2] = n & 7;
        }
    }
    choice->count = chosen[0], choice->mode = chosen[1];
    touch_try_column(columns, around, own, choice, chosen[2], 1e18);
}

/* Bricks of a base layer at most, by those of its frame: columns that reach farther are no use. */
static uint64_t touch_max_layer(uint64_t bricks) { return 2 * bricks + 64; }

/* Bytes of columns at most: nine numbers of some 70 bits where a tile has a surface, and next to nothing elsewhere. */
static uint64_t touch_columns_bytes(uint64_t tiles, uint64_t bricks) {
    return 8192 * (tiles < bricks ? tiles : bricks) + 16 * tiles + touch_min_bytes(touch_max_layer(bricks)) + 128;
}

/* Columns of a frame within a mask, and their bytes: 1; 0: there are none. */
static int touch_fit_columns(const touch_grid *grid, const touch_tables *tables, const touch_source *frame, float unit_n,
                             double k, double f0, touch_sink *s, touch_units *out, touch_arena *arena,
                             touch_cursor *error) {
    struct touch_column_fit fit;
    touch_columns columns;
    touch_spent spent;
    touch_cursor filled = touch_cursor_of(0, 0);
    uint64_t *key = touch_source_keys(frame, arena), start;
    int found;
    memset(&fit, 0, sizeof fit), memset(&columns, 0, sizeof columns);
    if (f0 < 1) f0 = 1;
    found = touch_find_column_box(&columns.box, grid, frame, arena);
    if (found > 0) found = touch_find_heads(&columns, frame, unit_n, k, f0, arena);
    if (!found) return 0;
    fit.source = frame, fit.units_per_n = (float)(1 / (double)unit_n), fit.k = k, fit.f0 = f0, fit.top = (double)columns.top;
    fit.ramp = (double)columns.ramp / 65536, columns.fit = &fit;
    fit.force = (float(*)[4])touch_take(arena, (uint64_t)columns.box.depth, sizeof *fit.force);
    fit.weight = (double *)touch_take(arena, (uint64_t)columns.box.depth, sizeof *fit.weight);
    fit.rest = (double(*)[3])touch_take(arena, (uint64_t)columns.box.depth, sizeof *fit.rest);
    uint64_t tiles = (uint64_t)(columns.box.tiles[0] * columns.box.tiles[1]), max_bricks = touch_max_layer(frame->bricks);
    if (found < 0 || !key || !fit.force || !fit.weight || !fit.rest || !touch_map_make(&fit.map, frame->bricks, arena) ||
        !touch_columns_make(&columns, arena) || !touch_sink_open(s, touch_columns_bytes(tiles, frame->bricks), arena))
        return touch_fail(error, TOUCH_MEMORY, "no room for a base layer");
    for (uint64_t i = 0; i < frame->bricks; i++) touch_map_put(&fit.map, key[i], (uint32_t)i);
    touch_put_u(s, 1, 1), touch_put_varint(s, (uint64_t)(2 * columns.box.axis + columns.box.is_inverted));
    for (int n = 0; n < 2; n++) touch_put_varint(s, (uint64_t)columns.box.tile[n]);
    for (int n = 0; n < 2; n++) touch_put_varint(s, (uint64_t)columns.box.tiles[n] - 1);
    touch_put_varint(s, (uint64_t)columns.top), touch_put_varint(s, (uint64_t)columns.ramp);
    for (int n = 0; n < 2; n++) touch_put_varint(s, (uint64_t)columns.ratio[n]);
    for (int n = 0; n < 3; n++) touch_put_varint(s, (uint64_t)columns.step[n]);
    start = s->size, columns.coder = touch_writing(s, tables, &spent);
    if (!touch_code_columns(&columns, error)) return 0;
    if (!touch_finish(&columns.coder, s)) return touch_fail(error, TOUCH_MEMORY, "no room for a base layer");
    if (!touch_fill_columns(&columns, max_bricks, out, arena, &filled)) /* TOUCH_CUT: more bricks than it may have */
        return filled.code == TOUCH_CUT ? 0 : touch_fail(error, filled.code, filled.what);
    touch_pad(s, start, touch_min_column_bytes(tiles, out->list.count));
    touch_sink_close(s, arena);
    return 1;
}

/* -- base layers: splines, whose coefficients are fitted elsewhere --------------------------------------------------- */

/* Bytes of a spline at most: some 50 bits a node, and the list of bricks. */
static uint64_t touch_spline_bytes(uint64_t bricks, uint64_t nodes) { return 64 * bricks + 16 * nodes + 256; }

/* The bytes of a spline of a frame's bricks. */
static int touch_put_spline(const touch_grid *grid, const touch_tables *tables, const touch_source *frame,
                            const touch_spline *spline, touch_sink *s, touch_units *out, touch_arena *arena,
                            touch_cursor *error) {
    touch_spline_models *models = (touch_spline_models *)touch_take(arena, 1, sizeof *models);
    touch_spline_head head;
    touch_nodes nodes;
    touch_list none;
    touch_spent spent;
    uint64_t start;
    none.key = 0, none.count = 0, head.step = spline->step;
    for (int n = 0; n < 3; n++) head.shift[n] = spline->shift[n], head.scale[n] = spline->scale[n];
    out->list.key = touch_source_keys(frame, arena), out->list.count = frame->bricks;
    out->v = (touch_int_vector *)touch_take_zero(arena, 512 * frame->bricks, sizeof *out->v);
    if (!models || !out->list.key || !out->v || !touch_nodes_of(&nodes, head.shift, out->list, arena) ||
        !touch_sink_open(s, touch_spline_bytes(frame->bricks, nodes.count), arena))
        return touch_fail(error, TOUCH_MEMORY, "no room for a base layer");
    if (nodes.count != spline->nodes) return touch_fail(error, TOUCH_ARGUMENT, "coefficients of other nodes");
    for (uint64_t i = 0; i < nodes.count; i++) {
        double c = spline->coefficient[i];
        nodes.value[i] = (int32_t)rint(c < -8388608 ? -8388608 : c > 8388608 ? 8388608 : c);
    }
    TOUCH_FRESH(models->list.context, models->list.weight);
    touch_fresh(models->node.length[0], sizeof models->node / sizeof(touch_context), 0, 0);
    touch_put_u(s, 0, 1);
    for (int n = 0; n < 3; n++) touch_put_varint(s, (uint64_t)head.shift[n]);
    touch_put_varint(s, (uint64_t)head.step);
    for (int n = 0; n < 3; n++) touch_put_varint(s, (uint64_t)head.scale[n]);
    start = s->size;
    touch_coder coder = touch_writing(s, tables, &spent);
    if (!touch_code_list(&coder, &models->list, grid->shape, none, &out->list, arena, error)) return 0;
    touch_code_nodes(&coder, models, &nodes, head.step);
    if (!touch_finish(&coder, s)) return touch_fail(error, TOUCH_MEMORY, "no room for a base layer");
    touch_pad(s, start, touch_min_bytes(frame->bricks));
    touch_fill_spline(&head, &nodes, grid, out);
    touch_sink_close(s, arena);
    return 1;
}

/* -- segments -------------------------------------------------------------------------------------------------------- */

typedef struct touch_writer {
    touch_grid grid;
    touch_options options;
    touch_steps steps;
    touch_bound bound; /* of passes, units */
    touch_tables tables;
    touch_arena work;
    touch_models *models, *fresh; /* after the frame before; of a frame by itself */
    touch_units previous;         /* the frame before, without its outliers */
    uint64_t mark;                /* of `work`, behind what stays */
    uint32_t frames;
    int tries_base_layers;
    double max_ratio; /* of the frames so far */
    uint32_t max_frame, max_voxel[3];
    touch_sink body; /* the records of the frames, behind room for what is before them */
    void *(*grow)(void *self, void *out, uint64_t size); /* of the encoder, as are the next two */
    void *self;
    uint64_t *decoded;
} touch_writer;

enum { TOUCH_HEAD_ROOM = 64 };

#define TOUCH_MAX_NEWTONS 1329227995784915872903807060280344576.0 /* 2^120 */

static int64_t touch_below(int64_t limit, double number) {
    if (!(number > 1)) number = 1;
    return (int64_t)(number < (double)(limit - 1) ? number : (double)(limit - 1));
}

static double touch_radians(double degrees) { return degrees * (3.14159265358979323846 / 180.0); }

/* Steps of a segment whose longest force is `longest_n`, which has 65536 units. The points that residuals can reach form a
   lattice around the centre. In mode MASK its cubes are 1.17 bounds wide: their corners lie within the ball of the bound,
   but for a small rest of forces (half a diagonal is 1.01 bounds), for which another point is taken. In mode
   MASK_DIRECTION the bound is a disc of directions and an interval of lengths; the steps fill each a little less. */
static void touch_choose_steps(const touch_options *o, double longest_n, touch_steps *s) {
    const double cube = 1.17, interval = 1.8, interval_floor = 1.25, disc = 0.97 * sqrt(2.0);
    double unit_n = longest_n / 65536;
    s->unit_n = (float)(unit_n > 1.1754943508222875e-38 ? unit_n : 1.1754943508222875e-38), unit_n = s->unit_n;
    if (o->mode == TOUCH_NMSE) {
        s->floor = s->cross_floor = touch_max(touch_below(1 << 16, o->step_n / unit_n), 21), s->rate = s->cross_rate = 0;
        return;
    }
    s->floor = s->cross_floor = touch_below(1 << 16, cube * o->f0_n / unit_n);
    s->rate = s->cross_rate = touch_below(1 << 17, 65536 * cube * o->k);
    if (o->mode != TOUCH_MASK_DIRECTION) return;
    s->cross_rate = touch_below(1 << 17, 65536 * disc * sin(touch_radians(o->direction_jnd_deg)));
    s->floor = touch_below(1 << 16, interval_floor * o->f0_n / unit_n);
    s->rate = touch_below(1 << 17, 65536 * interval * o->k);
}

/* The bound of the passes, units, less the rounding of whole units to float32 newtons. */
static touch_bound touch_pass_bound(const touch_options *o, const touch_steps *s) {
    const double rounding = 2e-6;
    double margin = 1 - rounding / o->k;
    double sine = o->mode == TOUCH_MASK_DIRECTION ? sin(touch_radians(o->direction_jnd_deg)) : 0.0;
    touch_bound b;
    b.k = o->k * margin, b.f0 = o->f0_n / (double)s->unit_n * margin, b.is_exact = o->is_support_exact;
    b.sine = sine - rounding > sine / 2 ? sine - rounding : sine / 2;
    if (o->mode == TOUCH_NMSE) b.k = 0, b.f0 = 0.75 * (double)s->floor, b.sine = 0;
    return b;
}

/* The bound of a decoded frame, newtons; mode NMSE has none, but half a step as a measure of a prediction. */
static touch_bound touch_frame_bound(const touch_options *o, int is_prediction) {
    touch_bound b;
    b.k = o->k, b.f0 = o->f0_n, b.is_exact = o->is_support_exact && !(is_prediction && o->mode == TOUCH_NMSE);
    b.sine = o->mode == TOUCH_MASK_DIRECTION ? sin(touch_radians(o->direction_jnd_deg)) : 0.0;
    if (o->mode == TOUCH_NMSE) b.k = 0, b.f0 = is_prediction ? o->step_n / 2 : HUGE_VAL;
    return b;
}

/* The fraction of the voxels with a force in either field at which a prediction is within the bound; -1: no memory. */
static double touch_fraction_within(const touch_writer *w, const touch_source *frame, const touch_units *prediction,
                                    touch_arena *arena) {
    touch_bound bound = touch_frame_bound(&w->options, 1);
    touch_source original = *frame;
    uint64_t mark = arena->used;
    touch_comparison c;
    touch_brick_forces decoded;
    original.hidden_n = 0;
    if (!touch_newtons_of(&decoded, prediction, w->steps.unit_n, arena) ||
        !touch_compare(&original, &decoded, &bound, &w->grid, TOUCH_COUNT_OUTLIERS, &c, arena))
        return -1;
    arena->used = mark;
    return c.outliers ? (double)c.within / (double)(c.within + c.outliers) : 1.0;
}

double touch_longest_n(const touch_source *frame) {
    double longest = 0;
    for (uint64_t i = 0; i < 512 * frame->bricks; i++) {
        const float *f = frame->forces_n + 3 * i;
        double x = f[0], y = f[1], z = f[2], square = x * x + z * z + y * y; /* in the order of numpy: the unit follows */
        if (!(square <= longest)) longest = square;
        if (longest != longest) break;
    }
    return sqrt(longest);
}

/* Whether a brick at the border has a force beyond the grid: also -0.0, which mode lossless would have to code. */
static int touch_has_force_beyond(const touch_grid *grid, const int32_t brick[3], const float *forces_n) {
    static const float none[3];
    uint32_t inside[3]; /* samples within the grid */
    for (int n = 0; n < 3; n++) inside[n] = grid->shape[n] - 8 * (uint32_t)brick[n];
    if (inside[0] >= 8 && inside[1] >= 8 && inside[2] >= 8) return 0;
    for (uint32_t i = 0; i < 512; i++) {
        int is_inside = i >> 6 < inside[0] && (i >> 3 & 7) < inside[1] && (i & 7) < inside[2];
        if (!is_inside && memcmp(forces_n + 3 * i, none, sizeof none) != 0) return 1;
    }
    return 0;
}

/* Bricks ascend and lie within the grid; forces lie within it, are finite, and three times as much is still a float32. */
static int touch_check_source(const touch_grid *grid, const touch_source *frame, touch_cursor *error) {
    uint64_t last = 0;
    for (uint64_t i = 0; i < frame->bricks; i++) {
        const int32_t *b = frame->brick + 3 * i;
        for (int n = 0; n < 3; n++)
            if (b[n] < 0 || 8 * (int64_t)b[n] >= grid->shape[n])
                return touch_fail(error, TOUCH_ARGUMENT, "a brick beyond the grid");
        uint64_t key = touch_key(b[0], b[1], b[2]);
        if (i && key <= last) return touch_fail(error, TOUCH_ARGUMENT, "bricks that do not ascend");
        last = key;
    }
    if (!(touch_longest_n(frame) <= TOUCH_MAX_NEWTONS))
        return touch_fail(error, TOUCH_ARGUMENT, "a force that is not finite, or above 2^120 N");
    for (uint64_t i = 0; i < frame->bricks; i++)
        if (touch_has_force_beyond(grid, frame->brick + 3 * i, frame->forces_n + 1536 * i))
            return touch_fail(error, TOUCH_ARGUMENT, "a force beyond the grid");
    return 1;
}

int touch_encode_start(touch_encoder *encoder, const touch_grid *grid, const touch_options *options, double longest_n,
                       touch_arena work, touch_arena out) {
    touch_writer *w = (touch_writer *)touch_take_zero(&work, 1, sizeof *w);
    encoder->writer = w, encoder->error = "no room for a segment";
    if (!w) return TOUCH_MEMORY;
    encoder->error = "a force that is not finite, or above 2^120 N";
    if (!(longest_n <= TOUCH_MAX_NEWTONS)) return TOUCH_ARGUMENT;
    encoder->error = "no room for a segment";
    w->grid = *grid, w->options = *options, w->tries_base_layers = options->has_base_layers;
    touch_fill_tables(&w->tables);
    if (out.size < out.used + 2 * TOUCH_HEAD_ROOM || !touch_sink_make(&w->body, out.size - out.used - TOUCH_HEAD_ROOM, &out))
        return TOUCH_MEMORY;
    w->body.size = TOUCH_HEAD_ROOM;
    if (options->mode != TOUCH_LOSSLESS) {
        touch_choose_steps(options, longest_n, &w->steps);
        w->bound = touch_pass_bound(options, &w->steps);
        w->models = (touch_models *)touch_take(&work, 1, sizeof *w->models);
        w->fresh = (touch_models *)touch_take(&work, 1, sizeof *w->fresh);
        if (!w->models || !w->fresh || !touch_step_table(&w->steps, &work)) return TOUCH_MEMORY;
        touch_models_fresh(w->fresh);
    }
    w->work = work, w->mark = work.used, encoder->error = "";
    return TOUCH_OK;
}

static void *touch_moved(const void *piece, const uint8_t *from, uint8_t *to) {
    return piece ? to + ((const uint8_t *)piece - from) : 0;
}

int touch_encode_move(touch_encoder *encoder, touch_arena work) {
    touch_writer *w = encoder->writer;
    uint8_t *base = w->work.base, *from = base + (16 - (uintptr_t)base % 16) % 16; /* where the first piece lies */
    uint64_t size = w->work.used - (uint64_t)(from - base), behind = w->work.used - w->mark;
    uint8_t *to = (uint8_t *)touch_piece(&work, size, 1, 0);
    encoder->error = "no room for a segment";
    if (!to) return TOUCH_MEMORY;
    memcpy(to, from, (size_t)size);
    w = encoder->writer = (touch_writer *)touch_moved(w, from, to);
    w->models = (touch_models *)touch_moved(w->models, from, to);
    w->fresh = (touch_models *)touch_moved(w->fresh, from, to);
    w->steps.border = (int32_t *)touch_moved(w->steps.border, from, to);
    w->previous.list.key = (uint64_t *)touch_moved(w->previous.list.key, from, to);
    w->previous.v = (touch_int_vector *)touch_moved(w->previous.v, from, to);
    w->work = work, w->mark = work.used - behind, encoder->error = "";
    return TOUCH_OK;
}

/* The writer, with what the caller has set. */
static touch_writer *touch_writer_of(const touch_encoder *encoder) {
    touch_writer *w = encoder->writer;
    w->grow = encoder->grow, w->self = encoder->self, w->decoded = encoder->decoded;
    return w;
}

/* So many more bytes of the body, if the caller can give them. */
static int touch_reserve(touch_writer *w, uint64_t bytes, touch_cursor *error) {
    touch_sink *s = &w->body;
    if (s->size > s->capacity) return touch_fail(error, TOUCH_MEMORY, "no room for a segment");
    if (bytes <= s->capacity - s->size || !w->grow) return 1; /* without `grow` the sink tells when it is full */
    uint64_t capacity = 2 * s->capacity + bytes;
    uint8_t *grown = (uint8_t *)w->grow(w->self, s->bytes, capacity);
    if (!grown) return touch_fail(error, TOUCH_MEMORY, "no room for a segment");
    s->bytes = grown, s->capacity = capacity;
    return 1;
}

/* Bytes of a record's flags and lengths, and of an outlier, at most. */
enum { TOUCH_RECORD_BYTES = 64, TOUCH_OUTLIER_BYTES = 32 };

/* The force of an outlier, NULL if its brick has none; `i` is the brick of the outlier before, and becomes its own. */
static const float *touch_outlier_force(const touch_grid *grid, const touch_source *frame, const uint64_t *key,
                                        uint64_t outlier, uint64_t *i) {
    uint64_t number = outlier >> 9, by = (grid->shape[1] + 7) >> 3, bz = (grid->shape[2] + 7) >> 3;
    uint64_t own = touch_key((int64_t)(number / (by * bz)), (int64_t)(number / bz % by), (int64_t)(number % bz));
    while (*i < frame->bricks && key[*i] < own) ++*i;
    return *i < frame->bricks && key[*i] == own ? frame->forces_n + 1536 * *i + 3 * (outlier & 511) : 0;
}

/* The forces of some voxels, as they are; into a sink, or only counted. */
static void touch_put_forces(touch_sink *s, const touch_grid *grid, const touch_source *frame, const touch_comparison *c,
                             const uint64_t *key) {
    uint64_t previous = 0, i = 0;
    for (uint64_t n = 0; n < c->outliers; n++) {
        uint64_t number = c->outlier[n] >> 9, sample = c->outlier[n] & 511, bits = 0;
        const float *force = touch_outlier_force(grid, frame, key, c->outlier[n], &i);
        for (int k = 0; k < 3 && force; k++) bits |= touch_f32_bits(force[k]);
        touch_put_varint(s, number - previous), touch_put_varint(s, 2 * sample + !bits);
        for (int k = 0; k < 3 && bits; k++) touch_put_u(s, touch_f32_bits(force[k]), 4);
        previous = number;
    }
}

/* The chunk of the voxels that the bound does not allow: their forces are sent as they are. */
static void touch_put_outliers(touch_writer *w, const touch_source *frame, const touch_comparison *c, const uint64_t *key) {
    touch_sink counted;
    counted.bytes = 0, counted.size = 0, counted.capacity = ~(uint64_t)0 - 1;
    touch_put_forces(&counted, &w->grid, frame, c, key);
    touch_put_varint(&w->body, counted.size), touch_put_forces(&w->body, &w->grid, frame, c, key);
}

/* Read the chunk of outliers that ends the body, as a receiver does: they have no other error. */
static int touch_check_outliers(const touch_writer *w, uint64_t start, const touch_source *frame, const touch_comparison *c,
                                const uint64_t *key, touch_cursor *error) {
    static const float none[3];
    touch_cursor at = touch_cursor_of(w->body.bytes + start, w->body.size - start), chunk = touch_chunk(&at, 1);
    uint64_t brick = 0, i = 0;
    int64_t last = -1;
    for (uint64_t n = 0; n < c->outliers; n++) {
        int32_t place[3];
        float force[3];
        int is_read = touch_read_outlier(&chunk, &w->grid, &brick, &last, place, force);
        const float *own = touch_outlier_force(&w->grid, frame, key, c->outlier[n], &i);
        int is_same = is_read && 512 * brick + (uint64_t)last == c->outlier[n];
        for (int k = 0; k < 3 && is_same; k++) is_same = force[k] == (own ? own : none)[k];
        if (!is_same) return touch_fail(error, TOUCH_CORRUPT, "an outlier is not read as it was written");
    }
    return touch_need(error, chunk.at == chunk.end && at.at == at.end, "bytes behind the outliers");
}

/* Fractions of the bits, in 1/255, for people: of support and of amplitude. */
static void touch_put_fractions(touch_sink *s, const double bits[3]) {
    double total = bits[0] + bits[1] + bits[2], support = 255, amplitude = 0;
    if (total > 0 && total < HUGE_VAL) {
        support = rint(255 * bits[0] / total), support = support < 0 ? 0 : support > 255 ? 255 : support;
        amplitude = rint(255 * bits[1] / total);
        amplitude = amplitude < 0 ? 0 : amplitude > 255 - support ? 255 - support : amplitude;
    }
    touch_put_u(s, (uint64_t)support, 1), touch_put_u(s, (uint64_t)amplitude, 1);
}

/* The record of a frame, and how well it is within the bound. */
static int touch_put_frame(touch_writer *w, const touch_source *frame, int is_inter, const touch_sink *base_layer,
                           const touch_coded *coded, touch_cursor *error) {
    touch_bound bound = touch_frame_bound(&w->options, 0);
    uint64_t *key = touch_source_keys(frame, &w->work);
    double bits[3];
    touch_comparison c;
    touch_brick_forces decoded;
    if (!key || !touch_newtons_of(&decoded, &coded->units, w->steps.unit_n, &w->work) ||
        !touch_compare(frame, &decoded, &bound, &w->grid, TOUCH_SEND_OUTLIERS, &c, &w->work))
        return touch_fail(error, TOUCH_MEMORY, "no room for a frame");
    int has_layer = base_layer->size > 0, has_outliers = c.outliers > 0;
    uint64_t size = base_layer->size + coded->payload.size + TOUCH_OUTLIER_BYTES * c.outliers;
    if (w->decoded) w->decoded[w->frames] = c.decoded;
    if (!touch_reserve(w, TOUCH_RECORD_BYTES + size, error)) return 0;
    touch_put_u(&w->body, (uint64_t)(is_inter | has_layer << 1 | has_outliers << 2), 1);
    bits[0] = 32.0 + coded->spent.bits[0], bits[1] = coded->spent.bits[1], bits[2] = coded->spent.bits[2];
    touch_put_fractions(&w->body, bits);
    if (has_layer) touch_put_chunk(&w->body, base_layer);
    touch_put_chunk(&w->body, &coded->payload);
    uint64_t start = w->body.size;
    if (has_outliers) touch_put_outliers(w, frame, &c, key);
    if (w->body.size > w->body.capacity) return touch_fail(error, TOUCH_MEMORY, "no room for a segment");
    if (has_outliers && !touch_check_outliers(w, start, frame, &c, key, error)) return 0;
    if (c.max_ratio > w->max_ratio) {
        w->max_ratio = c.max_ratio, w->max_frame = w->frames;
        memcpy(w->max_voxel, c.voxel, sizeof c.voxel);
    }
    return 1;
}

typedef struct { /* a base layer that was fitted to a frame; `bytes` are empty if there is none */
    touch_sink bytes;
    touch_units units;
    double fraction; /* of the voxels at which it is within the bound */
} touch_layer;

/* Move a base layer down, piece by piece in the order in which they lie. */
static void touch_keep_layer(touch_layer *layer, touch_arena *arena) {
    touch_units *u = &layer->units;
    uint64_t count = u->list.count;
    u->list.key = (uint64_t *)touch_keep(arena, u->list.key, 8 * count);
    u->v = (touch_int_vector *)touch_keep(arena, u->v, 512 * count * sizeof *u->v);
    layer->bytes.bytes = (uint8_t *)touch_keep(arena, layer->bytes.bytes, layer->bytes.size);
}

/* The best base layer of a frame, of a coarse spline, a fine one, and columns; each is tried only if those before are
   not good enough. It must be within the bound at half of the voxels; in mode NMSE any may be tried. */
static int touch_fit_base_layer(touch_writer *w, const touch_source *frame, const touch_spline_fit *splines,
                                touch_layer *best, touch_cursor *error) {
    static const double enough[3] = {1.0, 0.97, 0.75};
    double k = w->bound.k, f0 = w->bound.f0;
    uint64_t mark = w->work.used, size = w->work.size;
    best->fraction = 0.5;
    if (w->options.mode == TOUCH_NMSE) f0 = 0.35 * (double)w->steps.floor, best->fraction = 0;
    for (int kind = 0; kind < 3; kind++) {
        touch_layer layer;
        touch_spline spline;
        uint64_t used = w->work.used;
        int found = 0;
        memset(&layer, 0, sizeof layer), memset(&spline, 0, sizeof spline);
        if (!(best->fraction < enough[kind])) continue;
        if (kind < 2 && (!splines || !frame->bricks)) continue;
        if (kind < 2 && !splines->fit(splines->self, frame, 4 - kind, (double)w->steps.unit_n, k, f0, &spline)) continue;
        if (kind < 2)
            found = touch_put_spline(&w->grid, &w->tables, frame, &spline, &layer.bytes, &layer.units, &w->work, error);
        else
            found = touch_fit_columns(&w->grid, &w->tables, frame, w->steps.unit_n, k, f0, &layer.bytes, &layer.units,
                                      &w->work, error);
        if (error->code) return 0;
        if (found) layer.fraction = touch_fraction_within(w, frame, &layer.units, &w->work);
        if (layer.fraction < 0) return touch_fail(error, TOUCH_MEMORY, "no room for a base layer");
        if (found && layer.fraction >= best->fraction) w->work.used = mark, *best = layer, touch_keep_layer(best, &w->work);
        else w->work.used = used;
        w->work.size = size;
    }
    if (!best->bytes.size) best->fraction = 0;
    return 1;
}

/* Mode decision: a frame is coded with the reference of a base layer, or with that of the frame before or none; the
   fewest bytes win, in mode NMSE the least cost of bytes and errors. */
static int touch_code_best(touch_writer *w, const touch_source *frame, int is_inter, double inter_fraction,
                           const touch_spline_fit *splines, touch_layer *layer, touch_coded *best, touch_cursor *error) {
    const double bit_price = 0.1, min_gain = 0.03; /* of a bit, in squared steps; of a base layer in a frame's bytes */
    const double good_inter = 0.8, good_layer = 0.85; /* fractions of voxels within the bound: nothing else is tried */
    const touch_models *models = is_inter ? w->models : w->fresh;
    touch_units none, *references[2];
    touch_coded coded[2];
    double cost[2];
    int count = 0, index;
    memset(&none, 0, sizeof none), memset(layer, 0, sizeof *layer);
    if (w->tries_base_layers && inter_fraction < good_inter) {
        if (!touch_fit_base_layer(w, frame, splines, layer, error)) return 0;
        /* noise has no layer: effort "fast" looks for none in the rest of the segment */
        if (!layer->bytes.size && !w->options.is_checked) w->tries_base_layers = 0;
        if (!(layer->fraction > inter_fraction)) layer->bytes.size = 0;
    }
    if (layer->bytes.size) references[count++] = &layer->units;
    if (!layer->bytes.size || layer->fraction < good_layer || w->options.mode == TOUCH_NMSE)
        references[count++] = is_inter ? &w->previous : &none;
    for (int n = 0; n < count; n++) {
        if (!touch_code_frame(&w->grid, &w->steps, &w->tables, &w->bound, frame, references[n], models, coded + n,
                              &w->work, error))
            return 0;
        double price = coded[n].squared_error / (double)(w->steps.floor * w->steps.floor) / (8 * bit_price);
        cost[n] = price + (double)coded[n].payload.size + (references[n] == &layer->units ? (double)layer->bytes.size : 0);
    }
    if (count > 1) w->tries_base_layers = cost[0] < (1 - min_gain) * cost[1];
    index = count > 1 && cost[1] < cost[0];
    *best = coded[index];
    if (references[index] != &layer->units) layer->bytes.size = 0;
    return 1;
}

static int touch_report(touch_encoder *e, const touch_cursor *error) {
    e->error = error->code ? error->what : "";
    return error->code;
}

int touch_encode_next(touch_encoder *encoder, const touch_source *frame, const touch_source *coded,
                      const touch_spline_fit *splines) {
    touch_writer *w = touch_writer_of(encoder);
    touch_cursor error = touch_cursor_of(0, 0);
    touch_layer layer;
    touch_coded best;
    const double min_inter = 0.1; /* fraction of voxels that the frame before predicts within the bound */
    double inter_fraction = 0.0;
    int is_inter = 0;
    const touch_source *source = coded ? coded : frame;
    if (!touch_check_source(&w->grid, frame, &error) || (coded && !touch_check_source(&w->grid, coded, &error)))
        return touch_report(encoder, &error);
    if (w->options.mode == TOUCH_LOSSLESS) return w->frames++, touch_report(encoder, &error); /* coded in the end */
    if (w->frames && w->options.interframe == TOUCH_INTER_AUTO)
        inter_fraction = touch_fraction_within(w, source, &w->previous, &w->work);
    if (inter_fraction < 0) touch_fail(&error, TOUCH_MEMORY, "no room for a frame");
    if (w->frames) is_inter = w->options.interframe == TOUCH_INTER_ON || inter_fraction >= min_inter;
    if (!error.code && touch_code_best(w, source, is_inter, inter_fraction, splines, &layer, &best, &error) &&
        touch_put_frame(w, frame, is_inter, &layer.bytes, &best, &error)) {
        uint64_t count = best.units.list.count;
        memcpy(w->models, best.models, sizeof *w->models);
        w->work.used = w->mark; /* the frame moves down, over what is no longer needed */
        w->previous.v = (touch_int_vector *)touch_keep(&w->work, best.units.v, 512 * count * sizeof *best.units.v);
        w->previous.list.key = (uint64_t *)touch_keep(&w->work, best.units.list.key, 8 * count);
        w->previous.list.count = count, w->frames++;
    }
    return touch_report(encoder, &error);
}

/* -- the exact mode -------------------------------------------------------------------------------------------------- */

enum { TOUCH_MAX_LEVELS = 65535, TOUCH_MAX_RANGES = 1 << 17 }; /* in the end; while they are looked for */

typedef struct { /* levels and a codebook of which all forces are products */
    int book; /* 0: none, forces are components */
    uint32_t level_count, vertex_count;
    double *level;       /* ascending */
    uint8_t *level_bytes; /* as float32 */
    const float *vertices;
    const touch_point *points;
} touch_palette;

typedef struct { /* ranges that levels may have, ascending */
    double *low, *high;
    uint64_t count;
} touch_ranges;

/* The vertex of largest dot product, the first of several. Vertices ascend by x; one as near as the best so far differs
   from the direction by no more than its chord along x. */
static uint32_t touch_nearest(const touch_palette *p, const float v[3]) {
    const double grain = 1 / 1099511627776.0;
    double x = v[0], y = v[1], z = v[2], size = sqrt(x * x + y * y + z * z), best = -HUGE_VAL, chord = 3;
    uint32_t low = 0, high = p->vertex_count, winner = 0;
    if (!(size > 0)) return 0;
    while (low < high) {
        uint32_t middle = low + (high - low) / 2;
        if ((double)p->points[middle].p[0] * grain < x / size) low = middle + 1;
        else high = middle;
    }
    for (int is_above = 0; is_above < 2; is_above++)
        for (int64_t j = (int64_t)low - !is_above; j >= 0 && j < (int64_t)p->vertex_count; j += is_above ? 1 : -1) {
            const int64_t *g = p->points[j].p;
            double a = (double)g[0] * grain, b = (double)g[1] * grain, c = (double)g[2] * grain;
            if (fabs(a - x / size) > chord) break;
            double dot = a * x + b * y + c * z;
            if (dot < best || (dot == best && (uint32_t)j > winner)) continue;
            best = dot, winner = (uint32_t)j;
            chord = sqrt(dot < size ? 2 - 2 * dot / size : 0) + 1e-6;
        }
    return winner;
}

/* The range of levels whose rounded products with the nearest vertex are a force; 0: none are, or it is not finite. */
static int touch_level_range(const float v[3], const float vertex[3], double *low, double *high) {
    *low = -HUGE_VAL, *high = HUGE_VAL;
    for (int n = 0; n < 3; n++) {
        double size = fabs((double)v[n]), d = fabs((double)vertex[n]), half;
        uint32_t exponent = touch_f32_bits(v[n]) >> 23 & 255;
        if ((touch_f32_bits(v[n]) & 0x7fffffffu) == 0x7f7fffffu) return 0; /* the step from the largest is infinite */
        half = ldexp(1, (exponent ? (int)exponent - 150 : -149) - 1);
        if ((d > 0 ? (size - half) / d : 0) > *low) *low = d > 0 ? (size - half) / d : 0;
        if (!(d > 0)) continue;
        if ((size + half) / d < *high) *high = (size + half) / d;
    }
    return *low <= *high && *high < HUGE_VAL;
}

/* Merge ranges: those that overlap are of one level. */
static int touch_merge_ranges(touch_ranges *r, touch_arena *arena) {
    uint64_t mark = arena->used, *key = (uint64_t *)touch_take(arena, r->count, 8), count = 0;
    uint32_t *tag = (uint32_t *)touch_take(arena, r->count, 4);
    double *copy = (double *)touch_take(arena, 2 * r->count, 8), previous = -1;
    if (!key || !tag || !copy) return 0;
    for (uint64_t i = 0; i < r->count; i++) {
        double sum = r->low[i] + r->high[i];
        memcpy(key + i, &sum, 8), tag[i] = (uint32_t)i;
        key[i] = key[i] >> 63 ? ~key[i] : key[i] | (uint64_t)1 << 63; /* ascends as the sum does */
        copy[2 * i] = r->low[i], copy[2 * i + 1] = r->high[i];
    }
    touch_sort(key, tag, r->count);
    for (uint64_t i = 0; i < r->count; i++) {
        double low = copy[2 * (uint64_t)tag[i]], high = copy[2 * (uint64_t)tag[i] + 1], sum = low + high;
        if (!i || sum - previous > sum / 1048576) r->low[count] = low, r->high[count] = high, count++;
        else {
            if (low > r->low[count - 1]) r->low[count - 1] = low;
            if (high < r->high[count - 1]) r->high[count - 1] = high;
        }
        previous = sum;
    }
    r->count = count, arena->used = mark;
    return 1;
}

static int touch_has_bits(const float v[3]) {
    return (touch_f32_bits(v[0]) | touch_f32_bits(v[1]) | touch_f32_bits(v[2])) != 0;
}

/* Add the ranges of the first `max` forces of a frame; 0: one has none. -1: no memory. */
static int touch_add_ranges(const touch_palette *p, const touch_source *frame, uint64_t max, touch_ranges *r,
                            touch_arena *arena) {
    for (uint64_t i = 0; i < 512 * frame->bricks && max; i++) {
        const float *v = frame->forces_n + 3 * i;
        double low, high;
        if (!touch_has_bits(v)) continue;
        if (!touch_level_range(v, p->vertices + 3 * (uint64_t)touch_nearest(p, v), &low, &high)) return 0;
        r->low[r->count] = low, r->high[r->count++] = high, max--;
    }
    return touch_merge_ranges(r, arena) ? 1 : -1;
}

/* The level and the vertex of a force that a palette has. */
static touch_symbols touch_palette_symbols(const touch_palette *p, const float v[3]) {
    touch_symbols s = {{0, 0, 0}, 1};
    double low, high;
    uint32_t first = 0, count = p->level_count - 1;
    s.symbol[1] = touch_nearest(p, v);
    touch_level_range(v, p->vertices + 3 * (uint64_t)s.symbol[1], &low, &high);
    while (count) { /* levels whose mean with the next one is below */
        uint32_t half = count / 2, middle = first + half;
        if (p->level[middle] + p->level[middle + 1] < low + high) first = middle + 1, count -= half + 1;
        else count = half;
    }
    s.symbol[0] = first;
    return s;
}

/* Whether the products of a palette are all forces of a frame, to the bit. */
static int touch_is_product(const touch_palette *p, const touch_source *frame) {
    for (uint64_t i = 0; i < 512 * frame->bricks; i++) {
        const float *v = frame->forces_n + 3 * i;
        if (!touch_has_bits(v)) continue;
        touch_symbols s = touch_palette_symbols(p, v);
        for (int n = 0; n < 3; n++) {
            float product = (float)p->level[s.symbol[0]] * p->vertices[3 * (uint64_t)s.symbol[1] + (uint64_t)n];
            if (touch_f32_bits(product) != touch_f32_bits(v[n])) return 0;
        }
    }
    return 1;
}

/* Levels for a codebook; 0: it has none, or too many, -1: no memory. */
static int touch_find_levels(touch_palette *p, const touch_source *frames, uint32_t count, touch_arena *arena) {
    uint64_t samples = 0, room = TOUCH_MAX_RANGES + 64, mark = arena->used;
    touch_ranges r;
    for (uint32_t i = 0; i < count; i++)
        if (512 * frames[i].bricks + TOUCH_MAX_RANGES + 64 > room) room = 512 * frames[i].bricks + TOUCH_MAX_RANGES + 64;
    r.count = 0, r.low = (double *)touch_take(arena, room, 8), r.high = (double *)touch_take(arena, room, 8);
    if (!r.low || !r.high) return -1;
    for (uint32_t i = 0; i <= count; i++) {
        const touch_source *frame = frames + (i ? i - 1 : 0);
        int found = touch_add_ranges(p, frame, i ? ~(uint64_t)0 : 64, &r, arena);
        if (found < 1 || r.count > TOUCH_MAX_RANGES) return found < 0 ? found : 0;
        for (uint64_t n = 0; i && n < 512 * frame->bricks; n++) samples += (uint64_t)touch_has_bits(frame->forces_n + 3 * n);
    }
    if (!r.count || r.count >= samples || r.count >= TOUCH_MAX_LEVELS) return 0;
    for (uint64_t i = 0; i < r.count; i++) r.low[i] = (r.low[i] + r.high[i]) / 2;
    arena->used = mark, p->level_count = (uint32_t)r.count; /* the levels stay where the lower ends are, at the mark */
    p->level = (double *)touch_keep(arena, r.low, 8 * r.count);
    p->level_bytes = (uint8_t *)touch_take(arena, 4 * r.count, 1);
    if (!p->level_bytes) return -1;
    for (uint32_t i = 0; i < p->level_count; i++) {
        float level = (float)(p->level[i] < 3.4028234663852886e38 ? p->level[i] : 3.4028234663852886e38);
        uint32_t bits = touch_f32_bits(level);
        p->level[i] = level;
        for (int n = 0; n < 4; n++) p->level_bytes[4 * i + (uint32_t)n] = (uint8_t)(bits >> 8 * n);
    }
    for (uint32_t i = 0; i < count; i++)
        if (!touch_is_product(p, frames + i)) return 0;
    return 1;
}

/* A palette of all forces of some frames; `book` is 0 if there is none. */
static int touch_find_palette(touch_palette *p, const touch_source *frames, uint32_t count, touch_arena *arena) {
    static const int books[10] = {5, 23, 3, 1, 2, 4, 21, 22, 8, 10}; /* ico5, octa3, ico3, ico1, ... the likely first */
    for (int n = 0; n < 10; n++) {
        uint64_t mark = arena->used;
        memset(p, 0, sizeof *p), p->book = books[n];
        p->vertices = touch_codebook(p->book, &p->vertex_count, &p->points, arena);
        int found = p->vertices ? touch_find_levels(p, frames, count, arena) : -1;
        if (found) return found > 0;
        arena->used = mark;
    }
    memset(p, 0, sizeof *p);
    return 1;
}

/* The symbols of a frame, in the bricks that have a force. */
static int touch_exact_of(touch_exact *f, const touch_palette *p, const touch_source *frame, touch_arena *arena) {
    uint64_t *key = touch_source_keys(frame, arena), count = 0;
    memset(f, 0, sizeof *f), f->book = p->book, f->levels = p->level_bytes, f->level_count = p->level_count;
    f->vertices = p->vertices, f->vertex_count = p->vertex_count, f->list.key = key;
    f->own = (touch_symbols *)touch_take_zero(arena, 512 * frame->bricks, sizeof *f->own);
    f->force = (float *)touch_take(arena, 3 * 512 * frame->bricks, 4);
    if (!key || !f->own || !f->force) return 0;
    for (uint64_t i = 0; i < frame->bricks; i++) {
        const float *v = frame->forces_n + 1536 * i;
        touch_symbols *own = f->own + 512 * count;
        int any = 0;
        for (int n = 0; n < 512; n++) {
            memset(own + n, 0, sizeof *own);
            if (!touch_has_bits(v + 3 * n)) continue;
            any = own[n].is_supported = 1;
            if (p->book) own[n] = touch_palette_symbols(p, v + 3 * n);
            else
                for (int k = 0; k < 3; k++) own[n].symbol[k] = touch_ordered(v[3 * n + k]);
        }
        memcpy(f->force + 1536 * count, v, 6144);
        if (any) key[count++] = key[i];
    }
    f->list.count = count;
    return 1;
}

/* The record of an exact frame, given the one before. */
static int touch_put_exact(touch_writer *w, touch_exact_models *models, const touch_exact *before, touch_exact *f,
                           touch_arena *arena, touch_cursor *error) {
    touch_exact_pass pass;
    touch_list none;
    touch_sink payload;
    touch_spent spent;
    double bits[3];
    uint64_t head;
    none.key = 0, none.count = 0;
    if (!touch_sink_make(&payload, (f->list.count + 1) * TOUCH_BRICK_BYTES + 4 * (uint64_t)f->level_count, arena))
        return touch_fail(error, TOUCH_MEMORY, "no room for a payload");
    touch_put_u(&payload, (uint64_t)f->book, 1);
    if (f->book && !before) {
        touch_put_u(&payload, f->level_count, 2);
        touch_put(&payload, f->levels, 4 * (uint64_t)f->level_count);
    }
    head = payload.size;
    touch_coder coder = touch_writing(&payload, &w->tables, &spent);
    pass.coder = &coder, pass.models = models, pass.grid = &w->grid, pass.before = before;
    if (!touch_code_list(&coder, &models->list, w->grid.shape, before ? before->list : none, &f->list, arena, error)) return 0;
    touch_account(&coder, TOUCH_BITS_SUPPORT);
    if (!touch_code_samples(&pass, f, arena, error)) return 0;
    if (!touch_finish(&coder, &payload)) return touch_fail(error, TOUCH_MEMORY, "no room for a payload");
    touch_pad(&payload, head, touch_min_bytes(4 * f->list.count));
    bits[1] = 8.0 * (double)head + spent.bits[1], bits[2] = spent.bits[2];
    bits[0] = 8.0 * (double)payload.size - bits[1] - bits[2];
    if (!touch_reserve(w, TOUCH_RECORD_BYTES + payload.size, error)) return 0;
    touch_put_u(&w->body, before != 0, 1), touch_put_fractions(&w->body, bits), touch_put_chunk(&w->body, &payload);
    if (w->body.size > w->body.capacity) return touch_fail(error, TOUCH_MEMORY, "no room for a segment");
    return 1;
}

/* All frames of a segment, losslessly: each given the one before, unless inter frames are off. */
static int touch_put_exact_frames(touch_writer *w, const touch_source *frames, touch_cursor *error) {
    int is_alone = w->options.interframe == TOUCH_INTER_OFF;
    touch_exact_models *models = (touch_exact_models *)touch_take(&w->work, 1, sizeof *models);
    touch_palette common, palette;
    touch_exact before, f;
    uint64_t mark;
    if (!models || !touch_find_palette(&common, frames, is_alone ? 1 : w->frames, &w->work))
        return touch_fail(error, TOUCH_MEMORY, "no room for a palette");
    mark = w->work.used;
    for (uint32_t n = 0; n < w->frames; n++) {
        if (n && is_alone) w->work.used = mark;
        palette = common;
        if (is_alone ? n > 0 : !n && !common.book) {
            if (!touch_find_palette(&palette, frames + n, 1, &w->work))
                return touch_fail(error, TOUCH_MEMORY, "no room for a palette");
            if (!is_alone) mark = w->work.used;
        }
        if (!n || is_alone) touch_exact_fresh(models);
        if (!touch_exact_of(&f, &palette, frames + n, &w->work)) return touch_fail(error, TOUCH_MEMORY, "no room for a frame");
        if (!touch_put_exact(w, models, n && !is_alone ? &before : 0, &f, &w->work, error)) return 0;
        w->work.used = mark; /* the frame moves down, over what is no longer needed */
        before = f;
        before.list.key = (uint64_t *)touch_keep(&w->work, f.list.key, 8 * f.list.count);
        before.own = (touch_symbols *)touch_keep(&w->work, f.own, 512 * f.list.count * sizeof *f.own);
        before.force = (float *)touch_keep(&w->work, f.force, 6144 * f.list.count);
    }
    return 1;
}

/* -- the finished segment -------------------------------------------------------------------------------------------- */

/* The forces of a decoded field, by the keys of its bricks. */
static int touch_field_forces(touch_brick_forces *forces, const touch_field *field, touch_arena *arena) {
    uint64_t *key = (uint64_t *)touch_take(arena, field->bricks, 8), count = 0;
    uint32_t *slot = (uint32_t *)touch_take(arena, field->bricks, 4);
    uint64_t by = (field->grid.shape[1] + 7) >> 3, bz = (field->grid.shape[2] + 7) >> 3;
    if (!key || !slot) return 0;
    for (uint64_t i = 0; i <= field->mask; i++) {
        uint64_t number = field->table[2 * i];
        if (!number--) continue;
        key[count] = touch_key((int64_t)(number / (by * bz)), (int64_t)(number / bz % by), (int64_t)(number % bz));
        slot[count++] = field->table[2 * i + 1];
    }
    touch_sort(key, slot, count);
    forces->count = count, forces->key = key, forces->slot = slot, forces->forces_n = field->forces_n;
    return 1;
}

/* Whether a decoded field is an original, bit for bit; `decoded` is the number of its voxels with a force. */
static int touch_is_identical(const touch_source *frame, const touch_brick_forces *decoded_forces, uint64_t *decoded,
                              touch_arena *arena) {
    uint64_t *key = touch_source_keys(frame, arena), i = 0, j = 0;
    static const float zero[1536] = {0};
    if (!key) return 0;
    while (i < frame->bricks || j < decoded_forces->count) {
        int has_first = j == decoded_forces->count || (i < frame->bricks && key[i] <= decoded_forces->key[j]);
        int has_second = i == frame->bricks || (j < decoded_forces->count && decoded_forces->key[j] <= key[i]);
        const float *original = has_first ? frame->forces_n + 1536 * i : zero;
        const float *sent = has_second ? decoded_forces->forces_n + 1536 * decoded_forces->slot[j] : zero;
        if (memcmp(original, sent, sizeof zero)) return 0;
        for (int n = 0; n < 1536; n += 3) *decoded += sent[n] != 0 || sent[n + 1] != 0 || sent[n + 2] != 0;
        i += (uint64_t)has_first, j += (uint64_t)has_second;
    }
    return 1;
}

/* Decode the finished records as a receiver does, and compare every frame with its original. */
static int touch_check_body(touch_writer *w, const touch_source *frames, touch_cursor *error) {
    touch_cursor c = touch_cursor_of(w->body.bytes + TOUCH_HEAD_ROOM, w->body.size - TOUCH_HEAD_ROOM);
    touch_bound bound = touch_frame_bound(&w->options, 0);
    uint64_t size = w->work.size, mark;
    touch_fields f;
    memset(&f, 0, sizeof f), f.grid = w->grid, f.is_exact = w->options.mode == TOUCH_LOSSLESS, f.steps = w->steps;
    w->work.used = w->mark, w->max_ratio = 0, w->max_frame = 0, memset(w->max_voxel, 0, sizeof w->max_voxel);
    if (f.is_exact) f.exact_models = (touch_exact_models *)touch_take(&w->work, 1, sizeof *f.exact_models);
    else f.models = (touch_models *)touch_take(&w->work, 1, sizeof *f.models);
    if (!f.models && !f.exact_models) return touch_fail(error, TOUCH_MEMORY, "no room for a decoder");
    mark = w->work.used;
    for (uint32_t n = 0; n < w->frames; n++) {
        touch_comparison result;
        touch_brick_forces decoded;
        const touch_field *field = touch_next_field(&f, &c, &w->tables, !n, mark, &w->work, &w->work, error);
        uint64_t used = w->work.used;
        if (!field) return 0;
        if (!touch_field_forces(&decoded, field, &w->work)) return touch_fail(error, TOUCH_MEMORY, "no room for a decoder");
        memset(&result, 0, sizeof result);
        if (f.is_exact)
            touch_need(error, touch_is_identical(frames + n, &decoded, &result.decoded, &w->work),
                       "a frame is not decoded as it was");
        else if (!touch_compare(frames + n, &decoded, &bound, &w->grid, TOUCH_COUNT_OUTLIERS, &result, &w->work))
            return touch_fail(error, TOUCH_MEMORY, "no room for a decoder");
        else {
            touch_need(error, !result.outliers, "the decoded body violates the error bound");
            if (result.max_ratio > w->max_ratio) {
                w->max_ratio = result.max_ratio, w->max_frame = n;
                memcpy(w->max_voxel, result.voxel, sizeof result.voxel);
            }
        }
        if (w->decoded) w->decoded[n] = result.decoded;
        w->work.used = used, w->work.size = size; /* the field is no longer needed */
        if (error->code) return 0;
    }
    return touch_need(error, c.at == c.end, "bytes behind the last frame of a segment");
}

int touch_encode_finish(touch_encoder *encoder, const touch_source *frames, touch_segment *out) {
    touch_writer *w = touch_writer_of(encoder);
    touch_cursor error = touch_cursor_of(0, 0);
    uint8_t head[TOUCH_HEAD_ROOM];
    touch_sink s;
    int is_stated = w->options.mode != TOUCH_NMSE;
    memset(out, 0, sizeof *out);
    s.bytes = head, s.size = 0, s.capacity = sizeof head;
    int is_exact = w->options.mode == TOUCH_LOSSLESS, is_checked = is_exact || w->options.is_checked;
    if (is_exact && !touch_put_exact_frames(w, frames, &error)) return touch_report(encoder, &error);
    if (is_checked && !touch_check_body(w, frames, &error)) return touch_report(encoder, &error);
    touch_put_u(&s, (uint64_t)is_stated, 1);
    if (w->options.mode != TOUCH_LOSSLESS) {
        touch_put_u(&s, touch_f32_bits(w->steps.unit_n), 4);
        touch_put_varint(&s, (uint64_t)w->steps.floor), touch_put_varint(&s, (uint64_t)w->steps.rate);
        touch_put_varint(&s, (uint64_t)w->steps.cross_floor), touch_put_varint(&s, (uint64_t)w->steps.cross_rate);
    }
    out->max_error_ratio = w->max_ratio < 1 ? w->max_ratio : 1, out->max_error_frame = w->max_frame;
    memcpy(out->max_error_voxel, w->max_voxel, sizeof w->max_voxel);
    if (is_stated) {
        touch_put_u(&s, (uint64_t)ceil(out->max_error_ratio * 65535), 2), touch_put_varint(&s, w->max_frame);
        for (int n = 0; n < 3; n++) touch_put_varint(&s, w->max_voxel[n]);
    }
    out->body = w->body.bytes + TOUCH_HEAD_ROOM - s.size, out->size = w->body.size - TOUCH_HEAD_ROOM + s.size;
    memcpy(w->body.bytes + TOUCH_HEAD_ROOM - s.size, head, (size_t)s.size);
    return touch_report(encoder, &error);
}

/* -- key frames, and segments with more outliers ---------------------------------------------------------------------- */

int touch_is_static(const touch_grid *grid, const touch_options *options, const touch_source *frame,
                    const touch_source *earlier, touch_arena work) {
    const double margin = 0.02; /* of the mask */
    touch_source original = *frame;
    touch_bound bound = {0, 0, 0, 0};
    touch_comparison c;
    touch_brick_forces decoded;
    if (options->mode > TOUCH_MASK_DIRECTION) return 0;
    bound.k = margin * options->k > 0.001 ? margin * options->k : 0.001, bound.f0 = margin * options->f0_n;
    original.hidden_n = 0, decoded.count = earlier->bricks, decoded.slot = 0, decoded.forces_n = earlier->forces_n;
    decoded.key = touch_source_keys(earlier, &work);
    if (!decoded.key || !touch_compare(&original, &decoded, &bound, grid, TOUCH_COUNT_OUTLIERS, &c, &work)) return -1;
    return !c.outliers;
}

/* The outliers of a chunk and further samples, ascending, each once. */
static int touch_merge_outliers(touch_comparison *c, touch_cursor chunk, const touch_outlier_samples *added,
                                const touch_grid *grid, touch_arena *arena, touch_cursor *error) {
    memset(c, 0, sizeof *c);
    for (int is_written = 0; is_written < 2; is_written++) { /* counted, then written */
        touch_cursor at = chunk;
        uint64_t brick = 0, next = 0, count = 0;
        int64_t last = -1;
        while (at.at < at.end || next < added->samples) {
            uint64_t number = ~(uint64_t)0, own;
            int32_t position[3];
            float force[3];
            if (at.at < at.end) {
                if (!touch_read_outlier(&at, grid, &brick, &last, position, force))
                    return touch_fail(error, at.code, at.what);
                number = 512 * brick + (uint64_t)last;
            }
            for (; next < added->samples && added->sample[next] <= number; next++) {
                own = added->sample[next];
                if (own == number) continue;
                if (is_written) c->outlier[count] = own;
                count++;
            }
            if (is_written && number != ~(uint64_t)0) c->outlier[count] = number;
            count += number != ~(uint64_t)0;
        }
        if (!is_written) c->outlier = (uint64_t *)touch_take(arena, count, 8);
        if (!c->outlier) return touch_fail(error, TOUCH_MEMORY, "no room for outliers");
        c->outliers = count;
    }
    return 1;
}

/* Samples ascend, and lie within the grid. */
static int touch_check_samples(const touch_grid *grid, const touch_outlier_samples *added, touch_cursor *error) {
    uint64_t by = (grid->shape[1] + 7) >> 3, bz = (grid->shape[2] + 7) >> 3;
    for (uint64_t i = 0; i < added->samples; i++) {
        uint64_t brick = added->sample[i] >> 9, sample = added->sample[i] & 511;
        int is_inside = 8 * (brick / (by * bz)) + (sample >> 6) < grid->shape[0] &&
                        8 * (brick / bz % by) + (sample >> 3 & 7) < grid->shape[1] &&
                        8 * (brick % bz) + (sample & 7) < grid->shape[2];
        if (!is_inside) return touch_fail(error, TOUCH_ARGUMENT, "a sample beyond the grid");
        if (i && added->sample[i] <= added->sample[i - 1])
            return touch_fail(error, TOUCH_ARGUMENT, "samples that do not ascend");
    }
    return 1;
}

/* The record of a frame with more outliers. */
static int touch_put_record(touch_writer *w, touch_cursor *c, const touch_source *frame, const touch_outlier_samples *added,
                            touch_cursor *error) {
    uint64_t flags = touch_u(c, 1), fractions = touch_u(c, 2), mark = w->work.used;
    touch_cursor layer = flags & 2 ? touch_chunk(c, 1) : touch_cursor_of(c->at, 0), payload = touch_chunk(c, 0);
    touch_cursor chunk = flags & 4 ? touch_chunk(c, 1) : touch_cursor_of(c->at, 0);
    uint64_t *key = touch_source_keys(frame, &w->work);
    touch_comparison merged;
    if (c->code) return touch_fail(error, c->code, c->what);
    if (!touch_merge_outliers(&merged, chunk, added, &w->grid, &w->work, error)) return 0;
    if (!key) return touch_fail(error, TOUCH_MEMORY, "no room for outliers");
    uint64_t size = touch_left(&layer) + touch_left(&payload) + TOUCH_OUTLIER_BYTES * merged.outliers;
    if (!touch_reserve(w, TOUCH_RECORD_BYTES + size, error)) return 0;
    touch_put_u(&w->body, (flags & 3) | (merged.outliers ? 4 : 0), 1), touch_put_u(&w->body, fractions, 2);
    if (flags & 2) touch_put_varint(&w->body, touch_left(&layer)), touch_put(&w->body, layer.at, touch_left(&layer));
    touch_put_varint(&w->body, touch_left(&payload)), touch_put(&w->body, payload.at, touch_left(&payload));
    if (merged.outliers) touch_put_outliers(w, frame, &merged, key);
    if (w->body.size > w->body.capacity) return touch_fail(error, TOUCH_MEMORY, "no room for a segment");
    w->work.used = mark, w->frames++;
    return 1;
}

int touch_encode_with_outliers(touch_encoder *encoder, const touch_grid *grid, const touch_options *options, touch_bytes body,
                            const touch_source *frames, const touch_outlier_samples *added, uint32_t count,
                            touch_arena work, touch_arena out, touch_segment *segment) {
    touch_options checked = *options;
    touch_cursor error = touch_cursor_of(0, 0), c = touch_cursor_of(body.bytes, body.size);
    touch_fields f;
    checked.is_checked = 1;
    int code = options->mode == TOUCH_LOSSLESS ? TOUCH_ARGUMENT : touch_encode_start(encoder, grid, &checked, 1, work, out);
    if (code) {
        if (code == TOUCH_ARGUMENT) encoder->error = "every sample of mode lossless is added";
        return code;
    }
    touch_writer *w = touch_writer_of(encoder);
    memset(&f, 0, sizeof f), f.grid = *grid;
    if (!touch_begin_fields(&f, &c, count, &w->work, &error)) return touch_report(encoder, &error);
    w->steps = f.steps, w->mark = w->work.used;
    for (uint32_t i = 0; i < count; i++)
        if (!touch_check_samples(grid, added + i, &error) || !touch_put_record(w, &c, frames + i, added + i, &error))
            return touch_report(encoder, &error);
    touch_need(&error, c.at == c.end, "bytes behind the last frame of a segment");
    return error.code ? touch_report(encoder, &error) : touch_encode_finish(encoder, frames, segment);
}

/* -- how much memory an encoder needs: the sum of what each step below takes ------------------------------------------- */

enum {
    TOUCH_MAX_BORDERS = 199730, /* of a table of steps: that of a floor of 21 and a rate below 64 */
    TOUCH_SLACK = 1 << 16       /* alignment of all pieces, small structures, and heads */
};

static uint64_t touch_map_room(uint64_t count) {
    uint64_t size = 16;
    while (size < 2 * count + 2) size *= 2;
    return 12 * size;
}

/* A frame in units. */
static uint64_t touch_units_room(uint64_t bricks) { return (512 * sizeof(touch_int_vector) + 8) * bricks; }

/* A list of bricks while it is coded: boxes of a level, and maps of them and of both lists; a reader's keys. */
static uint64_t touch_list_room(const touch_grid *grid, uint64_t bricks, uint64_t before, uint64_t bytes) {
    uint64_t keys = touch_smaller(touch_brick_count(grid), touch_larger(bricks, touch_max_bricks(bytes))) + 1;
    return 8 * keys + 106 * (bricks + 1) + touch_map_room(8 * bricks) + touch_map_room(bricks) + touch_map_room(before);
}

/* A pass over a frame, without its result. */
static uint64_t touch_pass_room(const touch_grid *grid, uint64_t bricks, uint64_t reference, uint64_t bytes) {
    uint64_t cells = 512 * sizeof(touch_decoded) * bricks + 12 * bricks + 64 * reference;
    return sizeof(touch_pass) + touch_list_room(grid, bricks, reference, bytes) + cells + touch_map_room(bricks) +
           touch_map_room(reference);
}

/* A base layer of columns: along any axis; `layer` is the number of its bricks. */
static uint64_t touch_columns_room(const touch_grid *grid, uint64_t bricks, uint64_t layer) {
    uint64_t ramp = 4 * (TOUCH_BRICK_PAIRS * bricks + 65536), max = 0;
    for (int n = 0; n < 3; n++) {
        uint64_t a = (grid->shape[n == 0] + 7) >> 3, b = (grid->shape[n == 2 ? 1 : 2] + 7) >> 3;
        uint64_t tiles = touch_smaller(a * b, 64 + 4 * bricks), depth = touch_smaller(grid->shape[n], 1 << 14);
        max = touch_larger(max, tiles * (64 * sizeof(touch_column) + 8) + 48 * depth + touch_columns_bytes(tiles, bricks));
    }
    max += TOUCH_COLUMN_NODES * (sizeof(touch_column_contexts) + 16) + touch_map_room(bricks) + 8 * bricks;
    return touch_larger(ramp, max + touch_units_room(layer) + 4 * layer + touch_map_room(layer));
}

/* A base layer of a spline, of any lattice. */
static uint64_t touch_spline_room(const touch_grid *grid, uint64_t bricks) {
    uint64_t nodes = 1, each = 125 * bricks;
    for (int n = 0; n < 3; n++) nodes *= 2 * (((uint64_t)grid->shape[n] + 7) >> 3) + 3; /* two a brick along each axis */
    nodes = touch_smaller(nodes, each);
    uint64_t bytes = touch_spline_bytes(bricks, nodes), own = 12 * each + 8 * nodes + touch_map_room(nodes);
    return sizeof(touch_spline_models) + touch_units_room(bricks) + own + bytes + touch_list_room(grid, bricks, 0, bytes);
}

/* Frames, each coded with up to two references and in the end decoded again; a writer, and models to decode them. */
static uint64_t touch_lossy_room(const touch_grid *grid, int has_layers, uint64_t bricks) {
    uint64_t layer = has_layers ? touch_smaller(touch_brick_count(grid), touch_max_layer(bricks)) : 0, longest;
    uint64_t payload = (bricks + 1) * TOUCH_BRICK_BYTES, units = touch_units_room(bricks), fit = 0, best = 0, fits = 0;
    if (has_layers) {
        fit = touch_larger(touch_columns_room(grid, bricks, layer), touch_spline_room(grid, bricks));
        best = touch_units_room(layer) + touch_columns_bytes(64 + 4 * bricks, bricks);
        fits = best + fit + 512 * 12 * layer + 8 * bricks;
    }
    longest = touch_larger(layer, bricks);
    uint64_t compared = 512 * (12 + 8) * bricks + 16 * bricks; /* newtons, outliers, keys */
    uint64_t coded = sizeof(struct touch_target) + sizeof(touch_models) + units + payload;
    uint64_t codes = best + (has_layers ? 2 : 1) * coded + touch_larger(touch_pass_room(grid, bricks, longest, 0), compared);
    uint64_t checks = sizeof(touch_models) + fit + units + touch_pass_room(grid, bricks, longest, payload);
    uint64_t fixed = 3 * sizeof(touch_models) + 8 * TOUCH_MAX_BORDERS; /* one of each for a body with more outliers */
    return fixed + units + touch_larger(touch_larger(fits, codes), checks);
}

/* Lossless frames: the search for a palette, then frames, each with the one before; in the end they are decoded again. */
static uint64_t touch_lossless_room(const touch_grid *grid, uint64_t bricks) {
    uint64_t payload = (bricks + 1) * TOUCH_BRICK_BYTES, frame = (512 * (sizeof(touch_symbols) + 12) + 8) * bricks;
    uint64_t book = 24576 * sizeof(touch_point) + 12 * 4098, levels = 12 * TOUCH_MAX_LEVELS;
    uint64_t search = 44 * (512 * bricks + TOUCH_MAX_RANGES + 64), maps = 2 * touch_map_room(bricks);
    uint64_t codes = 2 * frame + payload + 4 * TOUCH_MAX_LEVELS + touch_list_room(grid, bricks, bricks, 0) + maps;
    uint64_t checks = 2 * frame + touch_list_room(grid, bricks, bricks, payload) + maps;
    uint64_t field = (512 * 12 + 48 + 20) * bricks + touch_map_room(2 * bricks + 1);
    return sizeof(touch_exact_models) + 2 * (book + levels) + touch_larger(touch_larger(search, codes), checks + field);
}

uint64_t touch_encode_room(const touch_grid *grid, const touch_options *options, uint64_t bricks) {
    bricks = touch_smaller(bricks, touch_brick_count(grid));
    uint64_t frames = options->mode == TOUCH_LOSSLESS ? touch_lossless_room(grid, bricks)
                                                      : touch_lossy_room(grid, options->has_base_layers, bricks);
    return TOUCH_SLACK + sizeof(struct touch_writer) + frames;
}

uint64_t touch_segment_room(uint64_t bricks, uint32_t count) {
    uint64_t outliers = 512 * 24 * bricks, payload = (bricks + 1) * TOUCH_BRICK_BYTES + 4 * TOUCH_MAX_LEVELS;
    return 256 + count * (64 + touch_columns_bytes(64 + 4 * bricks, bricks) + payload + outliers);
}

/* -- supports, whole numbers, vibration, poses ------------------------------------------------------------------------ */

/* Bytes of a code at most, as a bit that is coded takes at most 14 bits: of a brick of a support, 512 samples and its boxes;
   of a number, up to 65 bits. */
enum { TOUCH_SET_BYTES = 1216, TOUCH_NUMBER_BYTES = 128 };

uint64_t touch_part_room(uint64_t bricks, uint64_t numbers, uint64_t frames) {
    return TOUCH_FIXED_ROOM + (1536 + TOUCH_SET_BYTES) * bricks + (64 + TOUCH_NUMBER_BYTES) * numbers + 2048 * frames;
}

static int touch_result(const touch_sink *s, touch_bytes *out, const char **text, const touch_cursor *error) {
    out->bytes = s->bytes, out->size = error->code ? 0 : s->size, *text = error->code ? error->what : "";
    return error->code;
}

/* Whether each brick of a support has a sample, and no sample lies beyond the grid. */
static int touch_check_set(const touch_grid *grid, const touch_set *set, touch_cursor *error) {
    for (uint64_t i = 0; i < set->list.count; i++) {
        const uint8_t *is_set = set->is_set + 512 * i;
        int32_t at[3];
        int high[3], any = 0, beyond = 0;
        touch_position(set->list.key[i], at), touch_brick_samples(grid, at, high);
        for (int k = 0; k < 512; k++) {
            int is_inside = k >> 6 < high[0] && (k >> 3 & 7) < high[1] && (k & 7) < high[2];
            any |= is_set[k], beyond |= is_set[k] && !is_inside;
        }
        if (!any || beyond) return touch_fail(error, TOUCH_ARGUMENT, "a brick without samples, or samples beyond the grid");
    }
    return 1;
}

int touch_encode_support(const touch_grid *grid, const touch_samples *samples, const touch_samples *before,
                         touch_arena *arena, touch_bytes *out, const char **text) {
    touch_cursor error = touch_cursor_of(0, 0);
    touch_tables *tables = (touch_tables *)touch_take(arena, 1, sizeof *tables);
    touch_set_models *models = (touch_set_models *)touch_take(arena, 1, sizeof *models);
    touch_set set, other;
    touch_spent spent;
    touch_sink s;
    memset(&s, 0, sizeof s), memset(&set, 0, sizeof set), memset(&other, 0, sizeof other);
    if (!tables || !models) touch_fail(&error, TOUCH_MEMORY, "no room for a support");
    if (!error.code && touch_set_of(grid, samples, &set, arena, &error)) touch_check_set(grid, &set, &error);
    if (!error.code && before) touch_set_of(grid, before, &other, arena, &error);
    if (!error.code && !touch_sink_make(&s, TOUCH_SET_BYTES * samples->bricks + 64, arena))
        touch_fail(&error, TOUCH_MEMORY, "no room for a support");
    if (error.code) return touch_result(&s, out, text, &error);
    touch_fill_tables(tables), touch_set_fresh(models);
    touch_coder coder = touch_writing(&s, tables, &spent);
    if (touch_code_set(&coder, models, grid, &other, &set, arena, &error) && !touch_finish(&coder, &s))
        touch_fail(&error, TOUCH_MEMORY, "no room for a support");
    touch_pad(&s, 0, touch_min_bytes(samples->bricks));
    return touch_result(&s, out, text, &error);
}

int touch_encode_numbers(const int64_t *numbers, uint64_t count, touch_arena *arena, touch_bytes *out, const char **text) {
    touch_cursor error = touch_cursor_of(0, 0);
    touch_tables *tables = (touch_tables *)touch_take(arena, 1, sizeof *tables);
    touch_numbers *models = (touch_numbers *)touch_take(arena, 1, sizeof *models);
    touch_spent spent;
    touch_sink s;
    memset(&s, 0, sizeof s);
    for (uint64_t i = 0; i < count; i++)
        if (numbers[i] <= -((int64_t)1 << 30) || numbers[i] >= (int64_t)1 << 30)
            touch_fail(&error, TOUCH_ARGUMENT, "a number beyond 2^30 - 1");
    if (!tables || !models || !touch_sink_make(&s, TOUCH_NUMBER_BYTES * count + 64, arena))
        touch_fail(&error, TOUCH_MEMORY, "no room for numbers");
    else {
        touch_fill_tables(tables), touch_numbers_fresh(models);
        touch_coder coder = touch_writing(&s, tables, &spent);
        for (uint64_t i = 0; i < count; i++) touch_code_number(&coder, models, numbers[i]);
        if (!touch_finish(&coder, &s)) touch_fail(&error, TOUCH_MEMORY, "no room for numbers");
    }
    return touch_result(&s, out, text, &error);
}

typedef struct { /* a frame of a vibration in whole numbers */
    touch_set set;
    uint64_t samples, *key; /* of each sample, ascending */
    int64_t *value[2];      /* steps of amplitude; hertz */
} touch_vibrating_source;

/* The nearest step of an amplitude; below 0: it is less than the lowest. */
static int64_t touch_amplitude_of(double amplitude_n) {
    int exponent;
    double mantissa = frexp(amplitude_n, &exponent);
    return 4 * ((int64_t)exponent - 3 + 22) + (int64_t)rint(8 * mantissa) - 4;
}

/* Round the samples of a frame; those below the lowest step, 1 micronewton, go. */
static int touch_round_vibration(touch_vibrating_source *v, const touch_grid *grid, const touch_vibration_samples *frame,
                                 touch_arena *arena, touch_cursor *error) {
    uint64_t last = 0;
    memset(v, 0, sizeof *v);
    v->key = (uint64_t *)touch_take(arena, frame->samples, 8);
    for (int n = 0; n < 2; n++) v->value[n] = (int64_t *)touch_take(arena, frame->samples, 8);
    if (!v->key || !v->value[0] || !v->value[1]) return touch_fail(error, TOUCH_MEMORY, "no room for a vibration");
    for (uint64_t i = 0; i < frame->samples; i++) {
        const int32_t *at = frame->position + 3 * i;
        double amplitude = frame->amplitude_n[i], hertz = rint((double)frame->frequency_hz[i]);
        uint64_t key = touch_key(at[0], at[1], at[2]);
        if (at[0] < 0 || at[1] < 0 || at[2] < 0 || at[0] >= (int64_t)grid->shape[0] || at[1] >= (int64_t)grid->shape[1] ||
            at[2] >= (int64_t)grid->shape[2] || (i && key <= last))
            return touch_fail(error, TOUCH_ARGUMENT, "samples beyond the grid, or that do not ascend");
        if (!(amplitude > 0 && amplitude <= TOUCH_MAX_NEWTONS && hertz >= 0 && hertz <= 10000))
            return touch_fail(error, TOUCH_ARGUMENT, "an amplitude that is not positive, or a frequency above 10 kHz");
        int64_t step = touch_amplitude_of(amplitude);
        last = key;
        if (step > 159) return touch_fail(error, TOUCH_ARGUMENT, "an amplitude above 0.9 meganewton");
        if (step < 0) continue;
        v->key[v->samples] = key;
        v->value[0][v->samples] = step, v->value[1][v->samples++] = hertz > 1 ? (int64_t)hertz : 1;
    }
    return 1;
}

/* The support of a frame. */
static int touch_vibration_set(touch_vibrating_source *v, touch_arena *arena) {
    uint64_t *key = (uint64_t *)touch_take(arena, v->samples, 8), count = 0;
    uint32_t *tag = (uint32_t *)touch_take_zero(arena, v->samples, 4);
    touch_map map;
    int32_t at[3];
    if (!key || !tag) return 0;
    for (uint64_t i = 0; i < v->samples; i++)
        touch_position(v->key[i], at), key[i] = touch_key(at[0] >> 3, at[1] >> 3, at[2] >> 3);
    touch_sort(key, tag, v->samples);
    for (uint64_t i = 0; i < v->samples; i++)
        if (!i || key[i] != key[i - 1]) key[count++] = key[i];
    v->set.list.key = key, v->set.list.count = count;
    v->set.is_set = (uint8_t *)touch_take_zero(arena, 512 * count, 1);
    if (!v->set.is_set || !touch_map_make(&map, count, arena)) return 0;
    for (uint64_t i = 0; i < count; i++) touch_map_put(&map, key[i], (uint32_t)i);
    for (uint64_t i = 0; i < v->samples; i++) {
        touch_position(v->key[i], at);
        int64_t slot = touch_map_get(&map, touch_key(at[0] >> 3, at[1] >> 3, at[2] >> 3));
        v->set.is_set[512 * slot + 64 * (at[0] & 7) + 8 * (at[1] & 7) + (at[2] & 7)] = 1;
    }
    return 1;
}

/* The values of a frame minus those of the same samples in the frame before, or of the sample before. */
static void touch_put_vibration(touch_coder *b, touch_numbers *models, const touch_vibrating_source *v,
                                const touch_vibrating_source *before, int n) {
    uint64_t at = 0;
    for (uint64_t i = 0; i < v->samples; i++) {
        int64_t from = i ? v->value[n][i - 1] : 0;
        while (before && at < before->samples && before->key[at] < v->key[i]) at++;
        if (before && at < before->samples && before->key[at] == v->key[i]) from = before->value[n][at];
        touch_code_number(b, models, v->value[n][i] - from);
    }
}

int touch_encode_vibration(const touch_grid *grid, const touch_vibration_samples *frames, uint32_t count,
                           touch_arena *arena, touch_bytes *out, const char **text) {
    touch_cursor error = touch_cursor_of(0, 0);
    touch_tables *tables = (touch_tables *)touch_take(arena, 1, sizeof *tables);
    touch_set_models *models = (touch_set_models *)touch_take(arena, 1, sizeof *models);
    touch_numbers *numbers = (touch_numbers *)touch_take(arena, 1, sizeof *numbers);
    touch_vibrating_source *v = (touch_vibrating_source *)touch_take(arena, count, sizeof *v);
    uint64_t bricks = 0, samples = 0;
    touch_spent spent;
    touch_sink s;
    touch_set none;
    memset(&s, 0, sizeof s), memset(&none, 0, sizeof none);
    if (!tables || !models || !numbers || !v) touch_fail(&error, TOUCH_MEMORY, "no room for a vibration");
    for (uint32_t i = 0; i < count && !error.code; i++) {
        if (!touch_round_vibration(v + i, grid, frames + i, arena, &error)) break;
        if (!touch_vibration_set(v + i, arena)) touch_fail(&error, TOUCH_MEMORY, "no room for a vibration");
        bricks += v[i].set.list.count, samples += v[i].samples;
    }
    uint64_t bytes = TOUCH_SET_BYTES * bricks + 2 * TOUCH_NUMBER_BYTES * samples + 16 * (uint64_t)count + 64;
    if (!error.code && !touch_sink_make(&s, bytes, arena))
        touch_fail(&error, TOUCH_MEMORY, "no room for a vibration");
    if (error.code) return touch_result(&s, out, text, &error);
    touch_fill_tables(tables), touch_set_fresh(models);
    touch_coder coder = touch_writing(&s, tables, &spent);
    for (uint32_t i = 0; i < count && !error.code; i++)
        touch_code_set(&coder, models, grid, i ? &v[i - 1].set : &none, &v[i].set, arena, &error);
    for (int n = 0; n < 2 && !error.code; n++) {
        touch_numbers_fresh(numbers);
        for (uint32_t i = 0; i < count; i++) touch_put_vibration(&coder, numbers, v + i, i ? v + i - 1 : 0, n);
    }
    if (!touch_finish(&coder, &s)) touch_fail(&error, TOUCH_MEMORY, "no room for a vibration");
    touch_pad(&s, 0, touch_min_bytes(bricks + 16 * (uint64_t)count));
    return touch_result(&s, out, text, &error);
}

/* Differences of an order of component c of poses, coded; those of the first pose are 0. */
static void touch_put_moves(touch_coder *b, touch_numbers *models, const int64_t *numbers, uint32_t count, int c, int order) {
    touch_numbers_fresh(models);
    for (uint32_t i = 1; i < count; i++) {
        static const int binomial[4][4] = {{1}, {1, -1}, {1, -2, 1}, {1, -3, 3, -1}};
        uint64_t sum = 0; /* overflow is that of the reader */
        for (uint32_t k = 0; k <= (uint32_t)order && k <= i; k++)
            sum += (uint64_t)(int64_t)binomial[order][k] * (uint64_t)(numbers[7 * (i - k) + (uint32_t)c] - numbers[c]);
        touch_code_number(b, models, (int64_t)sum);
    }
}

/* The order of differences with the shortest code; 0 where nothing moves. */
static int touch_choose_order(const touch_sink *s, const touch_tables *tables, touch_numbers *models,
                              const int64_t *numbers, uint32_t count, int c) {
    double best = HUGE_VAL;
    int order = 0, is_still = 1;
    for (uint32_t i = 1; i < count; i++) is_still &= numbers[7 * i + (uint32_t)c] == numbers[c];
    for (int n = 1; n <= 3 && !is_still; n++) {
        touch_spent spent;
        touch_coder coder = touch_writing(s, tables, &spent);
        touch_put_moves(&coder, models, numbers, count, c, n);
        touch_account(&coder, TOUCH_BITS_SUPPORT);
        if (spent.total < best) best = spent.total, order = n;
    }
    return order;
}

int touch_encode_poses(const int64_t *numbers, uint32_t count, touch_arena *arena, touch_bytes *out, const char **text) {
    touch_cursor error = touch_cursor_of(0, 0);
    touch_tables *tables = (touch_tables *)touch_take(arena, 1, sizeof *tables);
    touch_numbers *models = (touch_numbers *)touch_take(arena, 1, sizeof *models);
    int order[7];
    touch_spent spent;
    touch_sink s;
    memset(&s, 0, sizeof s);
    if (!count) touch_fail(&error, TOUCH_ARGUMENT, "no poses");
    for (uint64_t i = 0; i < 7 * (uint64_t)count; i++)
        if (numbers[i] < -((int64_t)1 << 50) || numbers[i] > (int64_t)1 << 50)
            touch_fail(&error, TOUCH_ARGUMENT, "a pose beyond 2^50 steps");
    if (!tables || !models || !touch_sink_make(&s, TOUCH_NUMBER_BYTES * (7 * (uint64_t)count + 14) + 64, arena))
        touch_fail(&error, TOUCH_MEMORY, "no room for poses");
    if (error.code) return touch_result(&s, out, text, &error);
    touch_fill_tables(tables);
    for (int c = 0; c < 7; c++) order[c] = touch_choose_order(&s, tables, models, numbers, count, c);
    touch_coder coder = touch_writing(&s, tables, &spent);
    touch_numbers_fresh(models);
    for (int c = 0; c < 7; c++) touch_code_number(&coder, models, order[c]);
    for (int c = 0; c < 7; c++) touch_code_number(&coder, models, numbers[c]);
    for (int c = 0; c < 7; c++)
        if (order[c]) touch_put_moves(&coder, models, numbers, count, c, order[c]);
    if (!touch_finish(&coder, &s)) touch_fail(&error, TOUCH_MEMORY, "no room for poses");
    return touch_result(&s, out, text, &error);
}

int touch_encode_bodies(const touch_body_part *parts, uint32_t count, const touch_segment *max_error, touch_arena *arena,
                        touch_bytes *out, const char **text) {
    touch_cursor error = touch_cursor_of(0, 0);
    uint64_t size = 64;
    touch_sink s;
    for (uint32_t i = 0; i < count; i++) size += 16 + parts[i].poses.size + parts[i].fields.size;
    memset(&s, 0, sizeof s);
    if (!touch_sink_make(&s, size, arena)) {
        touch_fail(&error, TOUCH_MEMORY, "no room for a segment");
        return touch_result(&s, out, text, &error);
    }
    touch_put_varint(&s, max_error ? 1 + (uint64_t)ceil(max_error->max_error_ratio * 65535) : 0);
    if (max_error) touch_put_varint(&s, max_error->max_error_frame);
    for (int n = 0; n < 3 && max_error; n++) touch_put_varint(&s, max_error->max_error_voxel[n]);
    for (uint32_t i = 0; i < count; i++) {
        touch_put_varint(&s, parts[i].poses.size), touch_put(&s, parts[i].poses.bytes, parts[i].poses.size);
        if (!parts[i].is_deforming) continue;
        touch_put_varint(&s, parts[i].fields.size), touch_put(&s, parts[i].fields.bytes, parts[i].fields.size);
    }
    return touch_result(&s, out, text, &error);
}

#endif
