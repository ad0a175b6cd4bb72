/* touch_model.h: what a reader and a writer of coder `touch` have in common. touch.h and touch_encode.h include it.

   Shared, each part as one function for both directions: the arithmetic code, lists of bricks, the voxel pass (prediction,
   contexts, the order of all bits), base layers, the lossless mode, supports and whole numbers. Such a function takes the
   bit or number that a writer has decided on, which a reader's call ignores, and returns the one that was coded; both
   sides go on with that. So both have the same models, and give each bit the same probability.

   Not shared: a few varints in front of each code (touch_read_frame, touch_read_spline, touch_read_columns and
   touch_read_exact in touch.h; touch_code_frame, touch_put_spline, touch_fit_columns and touch_put_exact in
   touch_encode.h), and the choices of a writer (touch_choose_..., in touch_encode.h). Functions here call the latter by
   TOUCH_CHOOSE, which is 0 where touch_encode.h is not compiled.

   The sections follow docs/format: bits.md (arithmetic code, list of bricks, supports, whole numbers), touch.md (voxel
   pass), touch-base-layer.md and touch-exact.md. Everything that both sides must agree on is computed in whole numbers; the
   exceptions are the vertices of codebooks, rounded to 2^-40. Shifts of negative numbers must be arithmetic. */
#ifndef TOUCH_MODEL_H
#define TOUCH_MODEL_H

#include "touch.h"

#include <math.h>
#include <string.h>

#ifdef TOUCH_WRITES /* set by touch_encode.h: coders of both directions */
#define TOUCH_IS_WRITING(coder) ((coder)->out != 0)
#define TOUCH_CHOOSE(coder, choice) (TOUCH_IS_WRITING(coder) ? (choice) : 0)
#define TOUCH_ACCOUNT(coder, kind) \
    do { \
        if (TOUCH_IS_WRITING(coder)) touch_account(coder, kind); \
    } while (0)
#else
#define TOUCH_IS_WRITING(coder) ((void)(coder), 0)
#define TOUCH_CHOOSE(coder, choice) 0
#define TOUCH_ACCOUNT(coder, kind) ((void)(coder))
#endif

#ifndef TOUCH_GUARD /* bytes behind a piece of an arena that nobody may touch: a fuzzer watches them */
#define TOUCH_GUARD(at, bytes, guard) ((void)(guard), 0)
#endif

/* -- memory, errors, whole numbers ----------------------------------------------------------------------------------- */

typedef struct { /* bytes read from the first to the last; `code` is the first error, and all reads after it are 0 */
    const uint8_t *at, *end;
    int code;
    const char *what;
} touch_cursor;

/* A piece of an arena for `count` things of `each` bytes, or NULL; behind it may be a guard. */
static void *touch_piece(touch_arena *arena, uint64_t count, uint64_t each, uint64_t guard) {
    uint64_t base = (uint64_t)(uintptr_t)arena->base, start = ((base + arena->used + 15) & ~(uint64_t)15) - base;
    if (start > arena->size || (each && count > (arena->size - start) / each)) return 0;
    arena->used = start + count * each;
    arena->used += TOUCH_GUARD(arena->base + start, count * each, guard);
    if (arena->used > arena->peak) arena->peak = arena->used;
    return arena->base + start;
}

static void *touch_take(touch_arena *arena, uint64_t count, uint64_t each) { return touch_piece(arena, count, each, 32); }

static void *touch_take_zero(touch_arena *arena, uint64_t count, uint64_t each) {
    void *out = touch_take(arena, count, each);
    if (out) memset(out, 0, (size_t)(count * each));
    return out;
}

static int touch_fail(touch_cursor *c, int code, const char *what) {
    if (!c->code) c->code = code, c->what = what;
    c->at = c->end;
    return 0;
}

static int touch_need(touch_cursor *c, int holds, const char *what) {
    return holds ? !c->code : touch_fail(c, TOUCH_CORRUPT, what);
}

static int64_t touch_clip(int64_t n, int64_t min, int64_t max) { return n < min ? min : n > max ? max : n; }

/* Within -max to max. */
static int64_t touch_clip_to(int64_t n, int64_t max) { return touch_clip(n, -max, max); }

static int64_t touch_max(int64_t a, int64_t b) { return a > b ? a : b; }

static int64_t touch_min(int64_t a, int64_t b) { return a < b ? a : b; }

static uint64_t touch_larger(uint64_t a, uint64_t b) { return a > b ? a : b; }

static uint64_t touch_smaller(uint64_t a, uint64_t b) { return a < b ? a : b; }

static int64_t touch_abs(int64_t n) { return n < 0 ? -n : n; }

/* n / d rounded down; d is above 0. */
static int64_t touch_div(int64_t n, int64_t d) { return n / d - (n % d < 0); }

static int touch_bit_length(uint64_t n) {
    int bits = 0;
    while (n) n >>= 1, bits++;
    return bits;
}

/* A sum over 1 to 3 neighbours / their number: divisions by constants are fast. */
static int64_t touch_mean_of(int64_t sum, int count) { return count == 1 ? sum : count == 2 ? sum / 2 : sum / 3; }

/* The same, rounded down. */
static int64_t touch_floor_mean(int64_t sum, int count) {
    int64_t mean = touch_mean_of(sum, count);
    return mean - (sum < mean * count);
}

/* The largest number whose square is at most n, below 2^52: the root in floating point is put right. */
static int64_t touch_isqrt(int64_t n) {
    int64_t r = (int64_t)sqrt((double)n);
    while (r * r > n) r--;
    while ((r + 1) * (r + 1) <= n) r++;
    return r;
}

static uint32_t touch_f32_bits(float f) {
    uint32_t bits;
    memcpy(&bits, &f, 4);
    return bits;
}

static float touch_f32_of(uint32_t bits) {
    float out;
    memcpy(&out, &bits, 4);
    return out;
}

static uint64_t touch_brick_count(const touch_grid *g) {
    return (uint64_t)((g->shape[0] + 7) >> 3) * ((g->shape[1] + 7) >> 3) * ((g->shape[2] + 7) >> 3);
}

/* Samples of a brick that lie within the grid, along each axis. */
static void touch_brick_samples(const touch_grid *g, const int32_t brick[3], int high[3]) {
    for (int n = 0; n < 3; n++) high[n] = (int)touch_clip((int64_t)g->shape[n] - 8 * (int64_t)brick[n], 0, 8);
}

/* -- bits: the arithmetic code (docs/format/bits.md) ----------------------------------------------------------------- */

enum {
    TOUCH_AHEAD_BYTES = 6,             /* that a reader reads before the first bit: `low` has 48 bits */
    TOUCH_MAX_LOGIT = 3071,            /* logistic scale: 1/256 from -12 to 12 */
    TOUCH_ONE_PROBABILITY = 1 << 22,   /* probabilities of contexts are in 1/2^22, */
    TOUCH_INITIAL_PROBABILITY = TOUCH_ONE_PROBABILITY / 2,
    TOUCH_EVEN = 1 << 15,              /* those of the range coder in 1/2^16, */
    TOUCH_MIN_PROBABILITY = 4,         /* and at least this far from 0 and 1, so that both bits can be coded */
    TOUCH_INITIAL_WEIGHT = 14000,      /* 0.21: of each context's logit; the mixture of a few is cautious at first */
    TOUCH_MAX_COUNT = 255              /* bits that a context counts: then it learns at a constant rate */
};

typedef struct { /* of a 1, in 1/2^22, and how many bits it has learnt from, up to 255 */
    int32_t probability, count;
} touch_context;

typedef struct { /* the logistic function, its inverse, and how fast a context learns by its count */
    uint16_t squash[2 * TOUCH_MAX_LOGIT + 1];
    int16_t stretch[4096];
    int32_t rate[TOUCH_MAX_COUNT + 1];
} touch_tables;

enum { TOUCH_BITS_SUPPORT = 0, TOUCH_BITS_AMPLITUDE = 1, TOUCH_BITS_DIRECTION = 2 };

typedef struct { /* bits that a writer has spent, by purpose; an estimate for people */
    double bits[3], total;
} touch_spent;

typedef struct { /* a range coder of 48 bits, in either direction */
    const uint8_t *data; /* that is read */
    uint8_t *out;        /* that is written; NULL: this coder reads */
    uint64_t size;       /* bytes of either */
    uint64_t position;   /* bytes read (touch_is_cut: too many) or written (above `size` `out` is full) */
    uint64_t low, range; /* the interval; a reader's `low` is how far the code lies above its low end */
    const touch_tables *tables;
    touch_spent *spent;
} touch_coder;

static void touch_fill_tables(touch_tables *t) {
    uint64_t power = (uint64_t)1 << 31; /* 2^31 e^-x */
    int n = 0;
    for (int64_t i = 0; i <= TOUCH_MAX_LOGIT; i++) {
        uint64_t whole = ((uint64_t)1 << 31) + power, s = (((uint64_t)1 << 47) + (whole >> 1)) / whole;
        t->squash[TOUCH_MAX_LOGIT + i] = (uint16_t)(s > 65535 ? 65535 : s);
        t->squash[TOUCH_MAX_LOGIT - i] = (uint16_t)(65536 - s);
        power = power * 2139111403u >> 31; /* times 2^31 e^(-1/256) */
    }
    for (int64_t i = 0; i < 4096; i++) {
        while (t->squash[n] < 16 * i + 8) n++;
        t->stretch[i] = (int16_t)(n - TOUCH_MAX_LOGIT);
    }
    for (int64_t i = 0; i <= 2 * TOUCH_MAX_LOGIT; i++)
        t->squash[i] = (uint16_t)touch_clip(t->squash[i], TOUCH_MIN_PROBABILITY, (1 << 16) - TOUCH_MIN_PROBABILITY);
    for (int64_t i = 0; i <= TOUCH_MAX_COUNT; i++) t->rate[i] = (int32_t)((1 << 20) / (2 * i + 3));
}

static touch_coder touch_reading(const touch_cursor *c, const touch_tables *tables) {
    touch_coder b;
    memset(&b, 0, sizeof b);
    b.data = c->at, b.size = (uint64_t)(c->end - c->at), b.position = TOUCH_AHEAD_BYTES;
    b.range = (uint64_t)1 << 8 * TOUCH_AHEAD_BYTES, b.tables = tables;
    for (int i = 0; i < TOUCH_AHEAD_BYTES; i++) b.low = b.low << 8 | ((uint64_t)i < b.size ? b.data[i] : 0);
    return b;
}

#ifdef TOUCH_WRITES
static void touch_account(touch_coder *b, int kind);
static void touch_shift_out(touch_coder *b);
#endif

/* Move one word of 16 bits into the interval (reading) or out of it (writing). */
static void touch_shift(touch_coder *b) {
#ifdef TOUCH_WRITES
    if (TOUCH_IS_WRITING(b)) {
        touch_shift_out(b);
        return;
    }
#endif
    uint32_t high = b->position < b->size ? b->data[b->position] : 0;
    uint32_t low = b->position + 1 < b->size ? b->data[b->position + 1] : 0;
    b->low = b->low << 16 | high << 8 | low, b->range <<= 16, b->position += 2;
}

/* Code one bit that is 1 with probability p, in 1/65536. */
static int touch_narrow(touch_coder *b, uint32_t p, int bit) {
    uint64_t bound = (b->range >> 16) * p;
    if (!TOUCH_IS_WRITING(b)) bit = b->low < bound;
    uint64_t rest = bit ? 0 : ~(uint64_t)0; /* masks: a branch on a bit that is coded would be foreseen badly */
    b->range = bound + (rest & (b->range - 2 * bound));
    b->low = TOUCH_IS_WRITING(b) ? b->low + (rest & bound) : b->low - (rest & bound);
    if (b->range < (uint64_t)1 << 32) touch_shift(b);
    return bit;
}

/* A context moves towards the bit: fast while it is new, then slowly. */
static void touch_learn(touch_context *c, int bit, const touch_tables *t) {
    int64_t distance = (bit ? TOUCH_ONE_PROBABILITY - 1 : 0) - c->probability;
    c->probability += (int32_t)((distance * t->rate[c->count]) >> 19);
    c->count += c->count < TOUCH_MAX_COUNT;
}

/* The probability of a context in 1/2^16. */
static uint32_t touch_probability(const touch_context *c) {
    return (uint32_t)touch_clip(c->probability >> 6, TOUCH_MIN_PROBABILITY, (1 << 16) - TOUCH_MIN_PROBABILITY);
}

/* A bit by one context. */
static int touch_code(touch_coder *b, touch_context *c, int bit) {
    bit = touch_narrow(b, touch_probability(c), bit);
    touch_learn(c, bit, b->tables);
    return bit;
}

/* A bit by several contexts: their opinions are added on the logistic scale, each with a weight that learns which of
   them is right more often. */
static int touch_mix(touch_coder *b, touch_context *const *c, int64_t *weights, int count, int bit) {
    const touch_tables *t = b->tables;
    int64_t sum = 0;
    int32_t logit[4];
    for (int n = 0; n < count; n++) logit[n] = t->stretch[c[n]->probability >> 10], sum += logit[n] * weights[n];
    int32_t p = t->squash[touch_clip_to(sum >> 16, TOUCH_MAX_LOGIT) + TOUCH_MAX_LOGIT];
    bit = touch_narrow(b, (uint32_t)p, bit);
    int64_t error = (bit ? 65536 : 0) - p;
    for (int n = 0; n < count; n++) weights[n] += (logit[n] * error + 8192) >> 14, touch_learn(c[n], bit, t);
    return bit;
}

static int touch_mix2(touch_coder *b, touch_context *c0, touch_context *c1, int64_t *w, int bit) {
    touch_context *c[2];
    c[0] = c0, c[1] = c1;
    return touch_mix(b, c, w, 2, bit);
}

static int touch_mix3(touch_coder *b, touch_context *c0, touch_context *c1, touch_context *c2, int64_t *w, int bit) {
    touch_context *c[3];
    c[0] = c0, c[1] = c1, c[2] = c2;
    return touch_mix(b, c, w, 3, bit);
}

/* The lowest `count` bits of a number, equally probable, the highest first. */
static int64_t touch_even(touch_coder *b, int count, int64_t value) {
    int64_t out = 0;
    while (count-- > 0) out = out << 1 | touch_narrow(b, TOUCH_EVEN, (int)(value >> count & 1));
    return out;
}

/* A number from 1 to below 2^(max_digits + 1) in Elias' gamma code: its digits, then those after the first. */
static int64_t touch_gamma(touch_coder *b, int max_digits, int64_t value) {
    int digits = 0;
    while (digits < max_digits && touch_narrow(b, TOUCH_EVEN, value >> (digits + 1) > 0)) digits++;
    return (int64_t)1 << digits | touch_even(b, digits, value);
}

/* Reading: whether the bytes ended before the code. */
static int touch_is_cut(const touch_coder *b) {
    return !TOUCH_IS_WRITING(b) && b->position > b->size + TOUCH_AHEAD_BYTES;
}

static void touch_check(const touch_coder *b, touch_cursor *c) {
    if (touch_is_cut(b)) touch_fail(c, TOUCH_CUT, "a code that ends too early");
}

/* As touch_need for what a code contains: behind the end of the bytes any contradiction means that the code is cut. */
static int touch_need_coded(const touch_coder *b, touch_cursor *c, int holds, const char *what) {
    if (holds) return !c->code;
    touch_check(b, c);
    return touch_fail(c, TOUCH_CORRUPT, what);
}

enum { TOUCH_FREE_BRICKS = 64, TOUCH_BRICKS_PER_BYTE = 16 }; /* a code of n bytes lists at most 64 + 16 n bricks, */
enum { TOUCH_FREE_TILES = 64 };                              /* and columns of it have at most 64 + n tiles */

/* Bricks that a code of so many bytes may list: a short code cannot ask for much memory. */
static uint64_t touch_max_bricks(uint64_t bytes) { return TOUCH_FREE_BRICKS + TOUCH_BRICKS_PER_BYTE * bytes; }

/* Bytes that a code of so many bricks has at least. */
static uint64_t touch_min_bytes(uint64_t bricks) {
    uint64_t rounding = TOUCH_BRICKS_PER_BYTE - 1;
    return bricks > TOUCH_FREE_BRICKS ? (bricks - TOUCH_FREE_BRICKS + rounding) / TOUCH_BRICKS_PER_BYTE : 0;
}

/* As touch_min_bytes, of columns: also by the tiles of their box. */
static uint64_t touch_min_column_bytes(uint64_t tiles, uint64_t bricks) {
    return touch_larger(tiles > TOUCH_FREE_TILES ? tiles - TOUCH_FREE_TILES : 0, touch_min_bytes(bricks));
}

/* Reading: a code ends where its bytes do; zeros may follow until it has `min_bytes`. */
static void touch_close(const touch_coder *b, uint64_t min_bytes, touch_cursor *c) {
    uint64_t max = min_bytes > b->position ? min_bytes : b->position;
    touch_check(b, c);
    touch_need(c, b->size <= max, "bytes behind a code");
    for (uint64_t i = b->position; i < b->size && !c->code; i++) touch_need(c, !b->data[i], "bytes behind a code");
}

static void touch_fresh(touch_context *c, uint64_t contexts, int64_t *w, uint64_t weights) {
    for (uint64_t i = 0; i < contexts; i++) c[i].probability = TOUCH_INITIAL_PROBABILITY, c[i].count = 0;
    for (uint64_t i = 0; i < weights; i++) w[i] = TOUCH_INITIAL_WEIGHT;
}

/* A structure whose members are all contexts (or all weights), as one array. */
#define TOUCH_FRESH(contexts, weights) \
    touch_fresh((touch_context *)(void *)&(contexts), sizeof(contexts) / sizeof(touch_context), \
                (int64_t *)(void *)&(weights), sizeof(weights) / sizeof(int64_t))

/* -- maps from keys to indices, and order ---------------------------------------------------------------------------- */

typedef struct { /* open addressing; key 0 is none */
    uint64_t *key;
    uint32_t *index, mask;
} touch_map;

static int touch_map_make(touch_map *m, uint64_t count, touch_arena *arena) {
    uint64_t size = 16;
    while (size < 2 * count + 2) size *= 2;
    m->key = (uint64_t *)touch_take_zero(arena, size, 8), m->index = (uint32_t *)touch_take(arena, size, 4);
    m->mask = (uint32_t)(size - 1);
    return m->key && m->index;
}

static uint32_t touch_hash(uint64_t key, uint32_t mask) {
    return (uint32_t)((key * 0x9E3779B97F4A7C15u) >> 32) & mask;
}

static void touch_map_put(touch_map *m, uint64_t key, uint32_t index) {
    uint32_t at = touch_hash(++key, m->mask);
    while (m->key[at] && m->key[at] != key) at = (at + 1) & m->mask;
    m->key[at] = key, m->index[at] = index;
}

static int64_t touch_map_get(const touch_map *m, uint64_t key) { /* -1: none */
    uint32_t at = touch_hash(++key, m->mask);
    while (m->key[at] && m->key[at] != key) at = (at + 1) & m->mask;
    return m->key[at] ? (int64_t)m->index[at] : -1;
}

static void touch_sift(uint64_t *key, uint32_t *tag, uint64_t at, uint64_t n) {
    for (;;) {
        uint64_t child = 2 * at + 1, k;
        uint32_t t;
        if (child >= n) return;
        if (child + 1 < n && key[child + 1] > key[child]) child++;
        if (key[at] >= key[child]) return;
        k = key[at], key[at] = key[child], key[child] = k;
        t = tag[at], tag[at] = tag[child], tag[child] = t;
        at = child;
    }
}

static void touch_sort(uint64_t *key, uint32_t *tag, uint64_t n) { /* ascending, tags with their keys */
    uint64_t i;
    for (i = 1; i < n && key[i] >= key[i - 1]; i++) {}
    if (i >= n) return;
    for (i = n / 2; i-- > 0;) touch_sift(key, tag, i, n);
    for (i = n; i-- > 1;) {
        uint64_t k = key[0];
        uint32_t t = tag[0];
        key[0] = key[i], key[i] = k, tag[0] = tag[i], tag[i] = t;
        touch_sift(key, tag, 0, i);
    }
}

/* Positions of bricks, nodes or boxes as keys, in raster order; 21 bits an axis, shifted so that -1 and -2 are there. */
enum { TOUCH_KEY_BITS = 21, TOUCH_KEY_SHIFT = 8 };

static uint64_t touch_key(int64_t x, int64_t y, int64_t z) {
    return (uint64_t)(x + TOUCH_KEY_SHIFT) << 2 * TOUCH_KEY_BITS | (uint64_t)(y + TOUCH_KEY_SHIFT) << TOUCH_KEY_BITS |
           (uint64_t)(z + TOUCH_KEY_SHIFT);
}

static void touch_position(uint64_t key, int32_t out[3]) {
    const uint64_t mask = ((uint64_t)1 << TOUCH_KEY_BITS) - 1;
    out[0] = (int32_t)(key >> 2 * TOUCH_KEY_BITS) - TOUCH_KEY_SHIFT;
    out[1] = (int32_t)(key >> TOUCH_KEY_BITS & mask) - TOUCH_KEY_SHIFT, out[2] = (int32_t)(key & mask) - TOUCH_KEY_SHIFT;
}

/* -- lists of bricks: an octree, coded level by level ---------------------------------------------------------------- */

typedef struct {
    uint64_t *key; /* ascending */
    uint64_t count;
} touch_list;

typedef struct {
    struct {
        touch_context any;          /* whether the list has a brick at all */
        touch_context faces[729];   /* a surface goes on: states of the boxes across the six faces, 0, 1, or 2 not coded */
        touch_context edges[512];   /* the same of the boxes coded before, across faces and edges */
        touch_context changed[16];  /* motion: where boxes before differ from the list known before */
        touch_context found[4];     /* a parent has a child with bricks: the last chances are more likely */
    } context;
    struct {
        int64_t known[2][4]; /* by whether the list known before has bricks here */
    } weight;
} touch_list_models;

typedef struct { /* boxes of one size whose parents contain bricks */
    uint64_t *key, count;
    uint32_t *parent;
    uint8_t *state;             /* of each box: 2 not coded yet, then whether it contains bricks */
    uint8_t *remaining, *found; /* of each parent: children that are not coded yet, and those with bricks */
    touch_map index, known, target;
} touch_octree_level;

/* Which boxes of a level contain bricks, in raster order. The last child of a parent without any other is not coded. */
static void touch_code_octree_level(touch_coder *b, touch_list_models *m, const touch_octree_level *l) {
    static const int8_t step[12][3] = {{-1, 0, 0}, {0, -1, 0}, {0, 0, -1}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1},
                                       {-1, -1, 0}, {-1, 1, 0}, {-1, 0, -1}, {-1, 0, 1}, {0, -1, -1}, {0, -1, 1}};
    for (uint64_t i = 0; i < l->count; i++) {
        int32_t at[3];
        int known = touch_map_get(&l->known, l->key[i]) >= 0, bit = 1;
        uint32_t faces = 0, edges = 0, changed = 0, parent = l->parent[i];
        touch_position(l->key[i], at);
        for (int n = 0; n < 12; n++) {
            uint64_t key = touch_key(at[0] + step[n][0], at[1] + step[n][1], at[2] + step[n][2]);
            int64_t box = touch_map_get(&l->index, key);
            uint32_t state = box < 0 ? 0 : l->state[box];
            if (n < 6) faces = 3 * faces + (known ? 0 : state);
            if (n < 3) changed = 2 * changed + (state ^ (box >= 0 && touch_map_get(&l->known, key) >= 0 ? 1u : 0u));
            if (n < 3 || n > 5) edges = 2 * edges + state;
        }
        l->remaining[parent]--;
        if (l->found[parent] || l->remaining[parent]) {
            touch_context *c[4];
            c[0] = m->context.faces + faces, c[1] = m->context.edges + edges;
            c[2] = m->context.changed + 8 * known + changed, c[3] = m->context.found + 2 * known + (l->found[parent] > 0);
            bit = touch_mix(b, c, m->weight.known[known], 4, TOUCH_CHOOSE(b, touch_map_get(&l->target, l->key[i]) >= 0));
        }
        l->state[i] = (uint8_t)bit, l->found[parent] = (uint8_t)(l->found[parent] + bit);
    }
}

/* Boxes of 2^level bricks on a step that contain a brick of a list. */
static int touch_boxes_of(touch_map *boxes, touch_list list, int level, touch_arena *arena) {
    if (!touch_map_make(boxes, list.count, arena)) return 0;
    for (uint64_t i = 0; i < list.count; i++) {
        int32_t at[3];
        touch_position(list.key[i], at);
        touch_map_put(boxes, touch_key(at[0] >> level, at[1] >> level, at[2] >> level), 1);
    }
    return 1;
}

/* The children within the grid of `count` boxes, ascending; of a writer also which of them its list needs. */
static int touch_octree_level_make(touch_octree_level *l, const uint64_t *box, uint64_t count, const uint32_t shape[3],
                                   int level, touch_list before, touch_list target, touch_arena *arena) {
    memset(l, 0, sizeof *l);
    l->key = (uint64_t *)touch_take(arena, 8 * count, 8), l->parent = (uint32_t *)touch_take(arena, 8 * count, 4);
    l->state = (uint8_t *)touch_take(arena, 8 * count, 1), l->remaining = (uint8_t *)touch_take_zero(arena, count, 1);
    l->found = (uint8_t *)touch_take_zero(arena, count, 1);
    if (!l->key || !l->parent || !l->state || !l->remaining || !l->found) return 0;
    if (!touch_boxes_of(&l->known, before, level, arena)) return 0;
    if (target.count && !touch_boxes_of(&l->target, target, level, arena)) return 0;
    for (uint64_t i = 0; i < count; i++) {
        int32_t at[3];
        touch_position(box[i], at);
        for (int32_t d = 0; d < 8; d++) {
            int64_t x = 2 * at[0] + (d >> 2), y = 2 * at[1] + (d >> 1 & 1), z = 2 * at[2] + (d & 1);
            if (x > (int64_t)(shape[0] - 1) >> (level + 3) || y > (int64_t)(shape[1] - 1) >> (level + 3) ||
                z > (int64_t)(shape[2] - 1) >> (level + 3))
                continue;
            l->key[l->count] = touch_key(x, y, z), l->parent[l->count++] = (uint32_t)i, l->remaining[i]++;
        }
    }
    touch_sort(l->key, l->parent, l->count);
    if (!touch_map_make(&l->index, l->count, arena)) return 0;
    for (uint64_t i = 0; i < l->count; i++) l->state[i] = 2, touch_map_put(&l->index, l->key[i], (uint32_t)i);
    return 1;
}

/* A list of bricks, into `arena` if it is read; `before` is a list that is known, or empty. */
static int touch_code_list(touch_coder *b, touch_list_models *m, const uint32_t shape[3], touch_list before,
                           touch_list *list, touch_arena *arena, touch_cursor *error) {
    uint64_t total = (uint64_t)((shape[0] + 7) >> 3) * ((shape[1] + 7) >> 3) * ((shape[2] + 7) >> 3), count = 0;
    uint64_t max = TOUCH_IS_WRITING(b) ? list->count : touch_max_bricks(b->size), *key;
    uint32_t longest = 0;
    touch_list target;
    target.key = 0, target.count = 0;
    if (TOUCH_IS_WRITING(b)) target = *list;
    for (int n = 0; n < 3; n++) longest = shape[n] > longest ? shape[n] : longest;
    key = (uint64_t *)touch_take(arena, (total < max ? total : max) + 1, 8);
    if (!key) return touch_fail(error, TOUCH_MEMORY, "no room for a list of bricks");
    if (touch_code(b, &m->context.any, target.count > 0)) key[count++] = touch_key(0, 0, 0);
    for (int level = touch_bit_length((longest - 1) >> 3) - 1; level >= 0; level--) {
        uint64_t mark = arena->used, occupied = 0;
        touch_octree_level l;
        if (!touch_octree_level_make(&l, key, count, shape, level, before, target, arena))
            return touch_fail(error, TOUCH_MEMORY, "no room for a list of bricks");
        touch_code_octree_level(b, m, &l);
        for (uint64_t i = 0; i < l.count; i++) occupied += l.state[i] == 1;
        if (!touch_need_coded(b, error, occupied <= max, "more bricks than the bytes may list")) return 0;
        count = 0;
        for (uint64_t i = 0; i < l.count; i++)
            if (l.state[i] == 1) key[count++] = l.key[i];
        arena->used = mark;
    }
    if (!TOUCH_IS_WRITING(b)) {
        list->key = key, list->count = count;
        arena->used = (uint64_t)((uint8_t *)(key + count) - arena->base); /* most codes list fewer bricks than they may */
    }
    return 1;
}

/* -- the voxel pass (docs/format/touch.md) ---------------------------------------------------------------------------

   A brick: touch_code_state, then touch_copy_reference or touch_code_brick. A voxel: touch_code_voxel, which calls in this
   order touch_look_around, touch_code_support, touch_predict, touch_classify, touch_code_skip, touch_set_centre,
   touch_code_component (three times). */

typedef struct {
    int32_t v[3];
} touch_int_vector;

typedef struct { /* vectors in units, 512 a brick, in the order of the grid; (0, 0, 0): none there */
    touch_list list;
    touch_int_vector *v;
} touch_units;

typedef struct { /* a decoded voxel that is supported, in the order of the scan */
    int32_t vector[3], length;
    int32_t next_length[3];          /* length that the force law predicts one sample further along each axis */
    uint8_t along_size, across_size; /* of its residual, in steps: how well it was predicted */
} touch_decoded;

enum { TOUCH_CODE = 0, TOUCH_FOLLOW = 1, TOUCH_COPY = 2 };         /* state of a brick that the reference lists */
enum { TOUCH_NONE = 0, TOUCH_NEIGHBOUR = 1, TOUCH_REFERENCE = 2 }; /* predictor of a voxel */

enum {
    TOUCH_MAX_COMPONENT = (1 << 17) - 1, /* of a vector, units; the longest force of a segment has about 2^16 */
    TOUCH_ONE_BITS = 14,                 /* unit vectors and ratios are in 1/2^14 */
    TOUCH_ONE = 1 << TOUCH_ONE_BITS,
    TOUCH_SLOPE_STOP = 1 << 17,        /* a slope is below: length that a force loses from sample to sample, units */
    TOUCH_MAX_EXTRAPOLATION = 8 << 14, /* a neighbour grows by this ratio at most, in 1/2^14 */
    TOUCH_MAX_MEAN_SCALE = 2 << 16,    /* and the mean of neighbours by this one, in 1/2^16 */
    TOUCH_MIN_LENGTH_BITS = 3,         /* a force is predicted to keep 2^-3 of its length from sample to sample, or more */
    TOUCH_LENGTH_CLASSES = 32,         /* of the predicted length, for supports; */
    TOUCH_CLASSES_BELOW_2_16 = 28,     /* so many of them below 2^16 units, */
    TOUCH_FIRST_LENGTH_CLASS = 3,      /* from this one on; below it are predictions below 0 */
    TOUCH_AMPLITUDE_BITS = 12,         /* classes of the prediction's length for a skip are 2^12 units wide, */
    TOUCH_MAX_AMPLITUDE_CLASS = 15,
    TOUCH_NOT_LOADED = -1,     /* length of the first voxel of a brick that is only in `out` yet */
    TOUCH_NO_ALTERNATIVE = 15, /* class of an alternative prediction that is not there; */
    TOUCH_AT_CENTRE = 7,       /* 0 to 14: along an axis of the residual; this one is at the centre */
    TOUCH_MAX_CLASS = 7,       /* of sizes and distances in steps */
    TOUCH_MAX_UNARY = 14,      /* a magnitude up to here is coded in unary with contexts, then an escape in gamma code */
    TOUCH_ESCAPE_DIGITS = 17,  /* at most, */
    TOUCH_MAX_MAGNITUDE = (1 << 18) - 1, /* which a writer keeps to */
    TOUCH_MAX_ALONG_SIZE = 15, /* sizes of residuals, as far as they matter for contexts */
    TOUCH_MAX_ACROSS_SIZE = 31
};

/* The adaptive prediction (LMS). Features are in 1/256 of the step, weights in 1/2^16. Products take two parts of weights
   and gains of 16 bits each, which a processor multiplies eight at a time. */
enum {
    TOUCH_FEATURES = 13,
    TOUCH_LANES = 16, /* whole vectors: zeros follow the features */
    TOUCH_WEIGHT_PART = 10, TOUCH_GAIN_PART = 11, /* bits of the lower part */
    TOUCH_FEATURE_SLOPE = 6,      /* the first of five */
    TOUCH_FEATURE_REFERENCE = 11, /* the reference minus the mean */
    TOUCH_FEATURE_CHANGE = 12,    /* what the neighbours have changed by since the reference */
    TOUCH_MAX_FEATURE = 16 * 256 - 1,  /* limits keep one outlier from spoiling the weights, and products in 63 bits */
    TOUCH_MAX_LMS_ERROR = 4 * 256 - 1, /* 1/256 steps */
    TOUCH_LMS_REGULARISATION = 32768,  /* added to the energy of the features: small features teach little */
    TOUCH_LMS_RATE = 1 << 27,          /* times 2^-14 2^-16: half of what would remove the error at once */
    TOUCH_MAX_WEIGHT = 16 << 16
};

typedef struct { /* of one component of a residual. Significance: is it zero? Then the sign, and the magnitude */
    touch_context zero_alternatives_01[2][256]; /* large residuals around?; where the extrapolations along axes 0, 1 lie */
    touch_context zero_alternatives_23[2][256]; /* the same of the extrapolation along axis 2 and of the reference */
    touch_context zero_disagreement[64]; /* how far the skipped prediction lies: it was refused, so the force is elsewhere */
    touch_context sign_alternatives_01[256], sign_alternatives_23[256]; /* on which side the alternatives lie */
    touch_context sign_disagreement[64];                                /* on which side the skipped prediction lies */
    touch_context size_residuals[8][16];     /* magnitudes of the residuals around, by the steps so far */
    touch_context size_disagreement[64][16]; /* how far the skipped prediction lies, by the steps so far */
} touch_component_contexts;

typedef struct { /* what a frame teaches the next one */
    struct {
        touch_context copy[4];   /* is a brick COPY? by the state of the listed brick before: bricks at rest form groups */
        touch_context follow[3]; /* if not, is it FOLLOW or CODE? by the same; its state 2 is COPY */
        touch_context block[3][8]; /* is a block of 4 x 4 x 4 voxels set? by its reference, and by the three blocks before */
        touch_context support_near[32][64][8]; /* predicted length: a force that fades out ends; neighbours; reference */
        touch_context support_wide[32][64][8]; /* the shape of the support two samples around */
        touch_context support_reference[128][8][4]; /* the shape of the reference's support around */
        touch_context skip_activity[64][8]; /* where neighbours needed no residual, this one does not, either */
        touch_context skip_disagreement[8][16][4]; /* whether both predictions agree; long forces are smoother */
        touch_context skip_reference[8][8][8][8]; /* how well a reference agrees that is not the predictor */
        touch_component_contexts component[3];
    } context;
    struct {
        int64_t support[4][8][3]; /* by the number of neighbours, and the class of the reference */
        int64_t skip[8][2][3];    /* by the residuals around, and whether there is another reference */
        int64_t zero[3][8][3], sign[3][3], size[3][16][2];
    } weight;
    touch_list_models list;
    int32_t adaptive[16][TOUCH_LANES]; /* weights of the adaptive prediction, 1/65536; they start from 0 */
} touch_models;

static void touch_models_fresh(touch_models *m) {
    TOUCH_FRESH(m->context, m->weight);
    TOUCH_FRESH(m->list.context, m->list.weight);
    memset(m->adaptive, 0, sizeof m->adaptive);
}

typedef struct { /* quantisation steps by amplitude, the same in a segment (Weber: larger forces hide larger errors) */
    float unit_n;
    int64_t floor, rate;             /* the step along the centre: max(floor, rate / 2^16 times the length), units */
    int64_t cross_floor, cross_rate; /* the step across it, likewise */
    int32_t *border;                 /* lengths in 1/256 units at every sixteenth of a step from 0 on */
    int64_t borders;
} touch_steps;

enum {
    TOUCH_MAX_BORDER = 1 << 26,            /* 2^18 units in 1/256 units: the last border lies above it */
    TOUCH_MAX_SCALED_LENGTH = (1 << 18) - 1 /* no length in units is beyond it: sqrt(3) 2^17 */
};

/* Set the table of borders. */
static int touch_step_table(touch_steps *s, touch_arena *arena) {
    for (int written = 0; written < 2; written++) { /* counted, then written */
        int64_t count = 1;
        if (written) s->border = (int32_t *)touch_take(arena, (uint64_t)s->borders, 4);
        if (written && !s->border) return 0;
        if (written) s->border[0] = 0;
        for (int64_t border = 0; border <= TOUCH_MAX_BORDER; count++) {
            int64_t sixteenth = touch_max((border * s->rate) >> 16, 256 * s->floor) >> 4;
            border += sixteenth > 1 ? sixteenth : 1;
            if (written) s->border[count] = (int32_t)border;
        }
        s->borders = count;
    }
    return 1;
}

static int64_t touch_step(const touch_steps *s, int64_t length) { return touch_max((length * s->rate) >> 16, s->floor); }

/* The position of a length on the scale of steps, 1/256 steps: sixteenths by the table, linear between them. Steps grow
   with the length, so this is the compander of a non-uniform quantiser, and touch_length_at the expander. */
static int64_t touch_step_position(const touch_steps *s, int64_t length) {
    int64_t scaled = touch_min(length, TOUCH_MAX_SCALED_LENGTH) << 8, low = 0, count = s->borders - 1;
    while (count > 1) { /* the border is one of `count` from `low` on */
        int64_t half = count / 2;
        low += s->border[low + half] <= scaled ? half : 0, count -= half;
    }
    return 16 * low + ((scaled - s->border[low]) << 4) / (s->border[low + 1] - s->border[low]);
}

/* The inverse; a position below 0 is a force the other way. */
static int64_t touch_length_at(const touch_steps *s, int64_t position) {
    int64_t size = touch_min(touch_abs(position), 16 * (s->borders - 1) - 1), n = size >> 4;
    size = (s->border[n] + (((s->border[n + 1] - s->border[n]) * (size & 15)) >> 4) + 128) >> 8;
    return position < 0 ? -size : size;
}

typedef struct { /* order of a pass: which axis of the grid each axis of the scan is, the slowest first, and which way */
    int axis[3], sign[3];
    int stride[3], corner; /* from a sample of the scan to the index of that sample in a brick of the grid */
    int64_t last[3];       /* last brick along each axis of the scan */
} touch_scan;

static touch_scan touch_scan_of(int order, const touch_grid *grid) {
    touch_scan s;
    int k = 1;
    s.axis[0] = order & 3, s.corner = 0;
    for (int n = 0; n < 3; n++)
        if (n != s.axis[0]) s.axis[k++] = n;
    for (int n = 0; n < 3; n++) {
        int stride = 64 >> 3 * s.axis[n];
        s.sign[n] = order >> (2 + n) & 1 ? -1 : 1, s.last[n] = (int64_t)((grid->shape[s.axis[n]] + 7) >> 3) - 1;
        s.stride[n] = s.sign[n] * stride, s.corner += s.sign[n] < 0 ? 7 * stride : 0;
    }
    return s;
}

/* The key in the scan of a brick of the grid. */
static uint64_t touch_scan_key(const touch_scan *s, uint64_t key) {
    int32_t at[3], to[3];
    touch_position(key, at);
    for (int n = 0; n < 3; n++) to[n] = s->sign[n] < 0 ? (int32_t)s->last[n] - at[s->axis[n]] : at[s->axis[n]];
    return touch_key(to[0], to[1], to[2]);
}

/* The index in a brick of the grid of a sample of the scan. */
static int touch_grid_sample(const touch_scan *s, int x, int y, int z) {
    return s->corner + s->stride[0] * x + s->stride[1] * y + s->stride[2] * z;
}

/* The samples of a brick of the scan that lie within the grid: from low to below high along each axis. */
static void touch_scan_inside(const touch_scan *s, const touch_grid *grid, const int32_t brick[3], int low[3], int high[3]) {
    for (int n = 0; n < 3; n++) {
        int64_t samples = grid->shape[s->axis[n]], all = 8 * (s->last[n] + 1);
        int64_t first = s->sign[n] < 0 ? all - samples : 0, stop = s->sign[n] < 0 ? all : samples;
        low[n] = (int)touch_clip(first - 8 * brick[n], 0, 8), high[n] = (int)touch_clip(stop - 8 * brick[n], 0, 8);
    }
}

/* The window of a brick: its voxels and those around it, from -2 to 9 along each axis, so that all that predicts a voxel
   lies at fixed distances, also across the brick's faces. */
enum { TOUCH_WINDOW = 12 * 12 * 12, TOUCH_DEEP = 12 * 12, TOUCH_UP = 12, TOUCH_LEFT = 1 };

struct touch_target; /* the forces that a writer codes, and its error bound (touch_encode.h) */

typedef struct { /* a pass over a frame */
    touch_coder *coder;
    touch_models *models;
    const touch_steps *steps;
    touch_scan scan;
    int64_t slope[3]; /* loss of force along each axis from sample to sample, for `next_length` */
    const touch_units *reference;
    uint64_t *has_reference; /* bits of its voxels with a force, 8 words a brick: its vectors lie far from each other */
    touch_units *out;              /* what is decoded, in the order of the grid */
    touch_decoded *decoded;        /* 512 of each brick; of length 0: not supported */
    int32_t decoded_at[TOUCH_WINDOW], reference_at[TOUCH_WINDOW]; /* indices into `decoded` and `reference`; -1: none */
    int32_t last_vector[3];
    int is_listed, last_state; /* whether the reference lists the brick; the state of the last brick that it lists */
    struct touch_target *target;
} touch_pass;

static const int touch_before[3] = {-TOUCH_DEEP, -TOUCH_UP, -TOUCH_LEFT};
static const int touch_diagonal[3] = {-TOUCH_DEEP + TOUCH_UP, -TOUCH_DEEP + TOUCH_LEFT, -TOUCH_UP + TOUCH_LEFT};
static const int touch_wide[5] = {-TOUCH_DEEP - TOUCH_UP, -TOUCH_DEEP - TOUCH_LEFT, -TOUCH_UP - TOUCH_LEFT,
                                  -2 * TOUCH_DEEP, -2 * TOUCH_LEFT};

typedef struct { /* a voxel: what is known of it before its force, its predictions, and its residual */
    int here; /* its index in the window */
    /* touch_look_around */
    const touch_decoded *neighbour[3]; /* deep, up, left; NULL: not supported */
    int neighbour_count, has_reference, reference_class;
    uint32_t neighbour_mask, wide_mask, reference_mask; /* which places around are supported; have a reference */
    int64_t length_class;                               /* class of the length that the force law predicts */
    /* touch_predict */
    int32_t reference[3];
    int32_t extrapolation[3][3]; /* one neighbour continued by the force law, along axes 0, 1, 2 */
    int32_t adaptive[3];         /* mean of the neighbours with a learnt correction */
    int32_t prediction[3];       /* the force if the residual is skipped */
    int predictor;               /* where the prediction is from */
    int16_t feature[3][TOUCH_LANES]; /* of the adaptive prediction, for each component */
    int32_t *weight;
    int64_t inverse_step;
    /* touch_classify */
    int32_t disagreement[3]; /* prediction minus adaptive prediction */
    int disagreement_class, reference_distance; /* classes: of its length; of the reference minus the prediction */
    int residual_class[3], total_residual_class; /* classes of the residuals around: for each component; of all */
    uint32_t activity, amplitude_class;          /* residuals of each neighbour, 2 bits; length of the prediction */
    /* touch_set_centre */
    int32_t centre[3];                    /* what the residual is relative to, */
    int64_t basis[3][3];                  /* its axes along and across the centre, 1/2^14, */
    int64_t centre_step, centre_position; /* the step there, and where the centre lies on the scale of steps */
    uint32_t alternatives_01[3], alternatives_23[3]; /* on which side of the centre other predictions lie, for each axis */
    int64_t residual[3];                             /* in steps: along the centre, and two across it */
    int32_t vector[3];
} touch_voxel;

static int64_t touch_length(const int32_t v[3]) {
    int64_t n = touch_isqrt((int64_t)v[0] * v[0] + (int64_t)v[1] * v[1] + (int64_t)v[2] * v[2]);
    return n ? n : 1;
}

static int32_t touch_clip_component(int64_t n) { return (int32_t)touch_clip_to(n, TOUCH_MAX_COMPONENT); }

/* A number in 1/2^14, rounded to the nearest whole number. */
static int64_t touch_round_one(int64_t n) { return (n + TOUCH_ONE / 2) >> TOUCH_ONE_BITS; }

/* A vector of the reference, permuted to the scan. */
static void touch_reference_at(const touch_pass *p, int32_t index, int32_t out[3]) {
    const int32_t *v = p->reference->v[index].v;
    for (int n = 0; n < 3; n++) out[n] = p->scan.sign[n] * v[p->scan.axis[n]];
}

/* Store a decoded voxel. Along the force a penalty field loses `slope` of its length from sample to sample. */
static void touch_store_decoded(const touch_pass *p, touch_decoded *decoded, const int32_t v[3], int64_t along_size,
                                int64_t across_size) {
    int64_t length = touch_length(v);
    for (int n = 0; n < 3; n++) decoded->vector[n] = v[n], decoded->next_length[n] = (int32_t)length;
    decoded->length = (int32_t)length;
    decoded->along_size = (uint8_t)along_size, decoded->across_size = (uint8_t)across_size;
    if (!(p->slope[0] | p->slope[1] | p->slope[2])) return; /* spares a division */
    int64_t inverse = ((int64_t)1 << 2 * TOUCH_ONE_BITS) / length;
    for (int n = 0; n < 3; n++) {
        int64_t direction = (v[n] * inverse) >> TOUCH_ONE_BITS;
        decoded->next_length[n] = (int32_t)(length - ((direction * p->slope[n]) >> TOUCH_ONE_BITS));
    }
}

/* What lies around a voxel: neighbours, the shapes of the support and of the reference's, and the predicted length. */
static void touch_look_around(const touch_pass *p, touch_voxel *v, int here) {
    int64_t next_sum = 0;
    uint32_t neighbours = 0, wide = 0, reference = 0;
    int faces = 0;
    v->here = here, v->neighbour_count = 0, v->reference_class = 0, v->has_reference = p->reference_at[here] >= 0;
    for (int n = 0; n < 3; n++) {
        int32_t at = p->decoded_at[here + touch_before[n]];
        v->neighbour[n] = at >= 0 ? p->decoded + at : 0;
        if (at >= 0) neighbours |= 1u << n, v->neighbour_count++, next_sum += v->neighbour[n]->next_length[n];
        if (p->decoded_at[here + touch_diagonal[n]] >= 0) neighbours |= 8u << n;
    }
    for (int n = 0; n < 5; n++) wide |= (p->decoded_at[here + touch_wide[n]] >= 0 ? 1u : 0u) << n;
    if (p->is_listed) {
        for (int n = 0; n < 3; n++) {
            int before = p->reference_at[here + touch_before[n]] >= 0, after = p->reference_at[here - touch_before[n]] >= 0;
            faces += before + after, reference |= (uint32_t)before << (2 * n) | (uint32_t)after << (2 * n + 1);
        }
        v->reference_class = v->has_reference ? 4 + (faces >= 5) + (faces == 6) : 1 + (faces >= 1) + (faces >= 3);
        reference |= (uint32_t)v->has_reference << 6;
    }
    v->neighbour_mask = neighbours, v->wide_mask = wide, v->reference_mask = reference, v->length_class = wide;
    if (v->neighbour_count) {
        int64_t length_class = (touch_floor_mean(next_sum, v->neighbour_count) * TOUCH_CLASSES_BELOW_2_16) >> 16;
        v->length_class = touch_clip(length_class + TOUCH_FIRST_LENGTH_CLASS, 0, TOUCH_LENGTH_CLASSES - 1);
    }
}

/* Support: does the voxel have a force? Three contexts are mixed: the force law (a force that fades out towards here ends
   here), the shape of the support around, and the reference. */
static int touch_code_support(touch_pass *p, const touch_voxel *v, int bit) {
    touch_models *m = p->models;
    return touch_mix3(p->coder, &m->context.support_near[v->length_class][v->neighbour_mask][v->reference_class],
                      &m->context.support_wide[v->wide_mask][v->neighbour_mask][v->reference_class],
                      &m->context.support_reference[v->reference_mask][v->neighbour_mask & 7][v->length_class >> 3],
                      m->weight.support[v->neighbour_count][v->reference_class], bit);
}

/* The length of a neighbour's force one sample on, as the force law predicts it. */
static int64_t touch_next_length(const touch_decoded *neighbour, int axis) {
    return touch_max(neighbour->next_length[axis], neighbour->length >> TOUCH_MIN_LENGTH_BITS);
}

/* Extrapolation: along the force a penalty field changes its length by the law, but not its direction. A neighbour's
   error is inherited, so that a relative error stays within a relative bound for long. */
static void touch_extrapolate(const touch_pass *p, const touch_decoded *neighbour, int axis, int32_t out[3]) {
    int64_t length = touch_max(touch_next_length(neighbour, axis), touch_max(p->steps->floor >> 1, 1));
    if (length == neighbour->length) { /* a ratio of 1 */
        for (int n = 0; n < 3; n++) out[n] = touch_clip_component(neighbour->vector[n]);
        return;
    }
    int64_t ratio = touch_min((length << TOUCH_ONE_BITS) / neighbour->length, TOUCH_MAX_EXTRAPOLATION);
    for (int n = 0; n < 3; n++) out[n] = touch_clip_component(touch_round_one(neighbour->vector[n] * ratio));
}

/* The mean of the neighbours, as long as the force law predicts; returns the step there. */
static int64_t touch_mean(const touch_pass *p, const touch_voxel *v, int64_t mean[3]) {
    int64_t length_sum = 0, next_sum = 0;
    mean[0] = mean[1] = mean[2] = 0;
    for (int n = 0; n < 3; n++) {
        const touch_decoded *neighbour = v->neighbour[n];
        if (!neighbour) continue;
        length_sum += neighbour->length, next_sum += touch_next_length(neighbour, n);
        for (int k = 0; k < 3; k++) mean[k] += neighbour->vector[k];
    }
    int64_t scale = touch_mean_of(1 << 16, v->neighbour_count); /* where nothing is lost */
    if (next_sum != length_sum)
        scale = touch_min((next_sum << 16) / (length_sum * v->neighbour_count), TOUCH_MAX_MEAN_SCALE);
    for (int k = 0; k < 3; k++) mean[k] = (mean[k] * scale + (1 << 15)) >> 16;
    return touch_step(p->steps, touch_mean_of(next_sum, v->neighbour_count));
}

/* Features: what the mean may have to be corrected by, in 1/256 steps. 0 to 5: neighbours minus the mean, so that a
   weight prefers one of them; 6 to 10: slopes between voxels before, which continue to here; 11: the reference minus the
   mean; 12: how the neighbours differ from their references, which this voxel is likely to do, too. */
static void touch_features(const touch_pass *p, touch_voxel *v, const int64_t mean[3]) {
    static const int pair[5][2] = {{-TOUCH_DEEP, -2 * TOUCH_DEEP},
                                   {-TOUCH_UP, -TOUCH_DEEP - TOUCH_UP},
                                   {-TOUCH_LEFT, -TOUCH_DEEP - TOUCH_LEFT},
                                   {-TOUCH_LEFT, -TOUCH_UP - TOUCH_LEFT},
                                   {-TOUCH_UP, -TOUCH_UP - TOUCH_LEFT}};
    int32_t f[TOUCH_FEATURES][3]; /* units */
    int64_t change[3] = {0, 0, 0};
    int shared = 0;
    memset(f, 0, sizeof f), memset(v->feature, 0, sizeof v->feature);
    for (int n = 0; n < 6; n++) {
        int32_t at = p->decoded_at[v->here + (n < 3 ? touch_before[n] : touch_diagonal[n - 3])];
        if (at >= 0)
            for (int k = 0; k < 3; k++) f[n][k] = p->decoded[at].vector[k] - (int32_t)mean[k];
    }
    for (int n = 0; n < 5; n++) {
        int32_t to = p->decoded_at[v->here + pair[n][0]], from = p->decoded_at[v->here + pair[n][1]];
        int32_t *slope = f[TOUCH_FEATURE_SLOPE + n];
        if (to >= 0 && from >= 0)
            for (int k = 0; k < 3; k++) slope[k] = p->decoded[to].vector[k] - p->decoded[from].vector[k];
    }
    if (v->has_reference) {
        for (int n = 0; n < 3; n++) {
            int32_t at = p->reference_at[v->here + touch_before[n]], own[3];
            if (!v->neighbour[n] || at < 0) continue;
            touch_reference_at(p, at, own), shared++;
            for (int k = 0; k < 3; k++) change[k] += v->neighbour[n]->vector[k] - own[k];
        }
        for (int k = 0; k < 3; k++) {
            f[TOUCH_FEATURE_REFERENCE][k] = v->reference[k] - (int32_t)mean[k];
            f[TOUCH_FEATURE_CHANGE][k] = (int32_t)touch_floor_mean(change[k], shared ? shared : 1);
        }
    }
    for (int n = 0; n < TOUCH_FEATURES; n++)
        for (int k = 0; k < 3; k++)
            v->feature[k][n] = (int16_t)touch_clip_to((f[n][k] * v->inverse_step) >> 24, TOUCH_MAX_FEATURE);
}

static int32_t touch_sum_products(const int16_t a[TOUCH_LANES], const int16_t b[TOUCH_LANES]) {
    int32_t sum = 0;
    for (int n = 0; n < TOUCH_LANES; n++) sum += a[n] * b[n];
    return sum;
}

/* Adaptive prediction: the mean of the neighbours and a sum of features, with weights that learn (LMS) and differ by
   which neighbours there are. It averages noise away; where nothing is near it is the reference, or the last vector. */
static void touch_predict_adaptive(touch_pass *p, touch_voxel *v) {
    int64_t mean[3], step = 1;
    int16_t high[TOUCH_LANES], low[TOUCH_LANES];
    if (!v->neighbour_count) {
        const int32_t *nearest = v->has_reference ? v->reference : p->last_vector;
        for (int k = 0; k < 3; k++) v->adaptive[k] = touch_clip_component(nearest[k]);
        return;
    }
    step = touch_mean(p, v, mean), v->inverse_step = ((int64_t)1 << 32) / step;
    v->weight = p->models->adaptive[(v->neighbour_mask & 7) | (v->has_reference ? 8u : 0u)];
    touch_features(p, v, mean);
    for (int n = 0; n < TOUCH_LANES; n++) {
        high[n] = (int16_t)(v->weight[n] >> TOUCH_WEIGHT_PART);
        low[n] = (int16_t)(v->weight[n] & ((1 << TOUCH_WEIGHT_PART) - 1));
    }
    for (int k = 0; k < 3; k++) {
        int64_t sum = (int64_t)touch_sum_products(high, v->feature[k]) * (1 << TOUCH_WEIGHT_PART);
        sum += touch_sum_products(low, v->feature[k]);
        v->adaptive[k] = touch_clip_component(mean[k] + (((sum >> 16) * step) >> 8));
    }
}

/* Whether the reference is more than a step off at the deep neighbour: then it is off here, too. One neighbour is enough:
   deep is along the slowest axis, which the scan aligns with the largest force. */
static int touch_is_reference_off(const touch_pass *p, const touch_voxel *v) {
    int32_t at = p->reference_at[v->here - TOUCH_DEEP], own[3];
    int64_t square = 0, step;
    if (!v->neighbour[0] || at < 0) return 0;
    step = touch_step(p->steps, v->neighbour[0]->length), touch_reference_at(p, at, own);
    for (int k = 0; k < 3; k++)
        square += (int64_t)(v->neighbour[0]->vector[k] - own[k]) * (v->neighbour[0]->vector[k] - own[k]);
    return square > step * step;
}

/* All predictions of a voxel. The one that a skip selects is the reference in a brick of state FOLLOW; else the
   first extrapolation; else the adaptive one. */
static void touch_predict(touch_pass *p, touch_voxel *v, int state) {
    if (v->has_reference) touch_reference_at(p, p->reference_at[v->here], v->reference);
    for (int n = 0; n < 3; n++)
        if (v->neighbour[n]) touch_extrapolate(p, v->neighbour[n], n, v->extrapolation[n]);
    touch_predict_adaptive(p, v);
    v->predictor = TOUCH_NONE;
    memcpy(v->prediction, v->adaptive, sizeof v->prediction);
    if (state == TOUCH_FOLLOW && v->has_reference && !touch_is_reference_off(p, v)) {
        v->predictor = TOUCH_REFERENCE;
        memcpy(v->prediction, v->reference, sizeof v->prediction);
        return;
    }
    for (int n = 0; n < 3 && !v->predictor; n++)
        if (v->neighbour[n]) {
            v->predictor = TOUCH_NEIGHBOUR;
            memcpy(v->prediction, v->extrapolation[n], sizeof v->prediction);
        }
}

/* The weights of the adaptive prediction move towards what would have predicted the vector (normalised LMS). */
static void touch_learn_weights(touch_voxel *v) {
    int64_t energy = TOUCH_LMS_REGULARISATION;
    if (!v->neighbour_count) return;
    for (int k = 0; k < 3; k++) energy += touch_sum_products(v->feature[k], v->feature[k]);
    for (int k = 0; k < 3; k++) {
        const int16_t *f = v->feature[k];
        int64_t error = ((v->vector[k] - v->adaptive[k]) * v->inverse_step) >> 24;
        int64_t gain = touch_div(touch_clip_to(error, TOUCH_MAX_LMS_ERROR) * TOUCH_LMS_RATE, energy); /* below 2^22 */
        int16_t high = (int16_t)(gain >> TOUCH_GAIN_PART), low = (int16_t)(gain & ((1 << TOUCH_GAIN_PART) - 1));
        for (int n = 0; n < TOUCH_LANES; n++) { /* plus the feature times the gain / 2^14, rounded down */
            int32_t w = v->weight[n] + ((f[n] * high + ((f[n] * low) >> TOUCH_GAIN_PART)) >> (14 - TOUCH_GAIN_PART));
            w = w < TOUCH_MAX_WEIGHT ? w : TOUCH_MAX_WEIGHT;
            v->weight[n] = w > -TOUCH_MAX_WEIGHT ? w : -TOUCH_MAX_WEIGHT;
        }
    }
}

/* The number of ascending thresholds, of seven, that a number reaches: counted without branches, as the classes of noise
   cannot be foreseen. */
static int touch_class(int64_t n, const int thresholds[TOUCH_MAX_CLASS]) {
    int32_t size = (int32_t)touch_min(n, thresholds[TOUCH_MAX_CLASS - 1]), c = 0;
    for (int i = 0; i < TOUCH_MAX_CLASS; i++) c += thresholds[i] <= size;
    return c;
}

/* Class of a distance in steps: 0 below an eighth, then twice as far each, 7 from 8 steps on. */
static int touch_distance_class(int64_t distance, int64_t step) {
    int c = 0;
    for (int i = 0; i < TOUCH_MAX_CLASS; i++) c += distance << 3 >= step << i;
    return c;
}

/* Classes for the contexts of the skip and of the residual: how large the residuals around are, whether both predictions
   agree, and how well a reference agrees that is not the predictor. Without a neighbour, residuals count as large. */
static void touch_classify(const touch_pass *p, touch_voxel *v) {
    static const int thresholds[TOUCH_MAX_CLASS] = {1, 2, 4, 7, 11, 16, 24}; /* of sums of sizes, steps times 2 to 4 */
    int64_t along = 0, across = 0, length = touch_length(v->prediction), step = touch_step(p->steps, length);
    int count = v->neighbour_count;
    v->activity = 0, v->amplitude_class = (uint32_t)touch_min(length >> TOUCH_AMPLITUDE_BITS, TOUCH_MAX_AMPLITUDE_CLASS);
    v->reference_distance = TOUCH_MAX_CLASS;
    for (int n = 0; n < 3; n++) {
        uint32_t own = 0;
        if (v->neighbour[n]) {
            along += v->neighbour[n]->along_size, across += v->neighbour[n]->across_size;
            own = 1u + v->neighbour[n]->along_size + v->neighbour[n]->across_size;
        }
        v->activity = v->activity << 2 | (own < 3 ? own : 3);
        v->disagreement[n] = v->prediction[n] - v->adaptive[n];
    }
    v->residual_class[0] = v->residual_class[1] = v->residual_class[2] = v->total_residual_class = TOUCH_MAX_CLASS;
    if (count) {
        v->residual_class[0] = touch_class(touch_mean_of(4 * along, count), thresholds);
        v->residual_class[1] = v->residual_class[2] = touch_class(touch_mean_of(2 * across, count), thresholds);
        v->total_residual_class = touch_class(touch_mean_of(3 * (along + across), count), thresholds);
    }
    v->disagreement_class = touch_distance_class(touch_length(v->disagreement), step);
    if (v->has_reference && v->predictor != TOUCH_REFERENCE) {
        int32_t difference[3];
        for (int n = 0; n < 3; n++) difference[n] = v->reference[n] - v->prediction[n];
        v->reference_distance = touch_distance_class(touch_length(difference), step);
    }
}

/* Skip: is the prediction good enough, so that the residual is zero? */
static int touch_code_skip(touch_pass *p, const touch_voxel *v, int bit) {
    touch_models *m = p->models;
    int disagreement = v->disagreement_class, distance = v->reference_distance, residuals = v->total_residual_class;
    return touch_mix3(p->coder, &m->context.skip_activity[v->activity][disagreement],
                      &m->context.skip_disagreement[disagreement][v->amplitude_class][v->neighbour_count],
                      &m->context.skip_reference[distance][v->reference_class][disagreement][residuals],
                      m->weight.skip[residuals][distance < TOUCH_MAX_CLASS], bit);
}

/* Unit vectors along a vector of that length, and across it, 1/2^14. The second one is normal to the third axis, or, where
   the vector is within 26 degrees of that axis, to the first one: neither cross product is short. */
static void touch_basis(const int32_t centre[3], int64_t length, int64_t basis[3][3]) {
    enum { NEAR_THIRD_AXIS = 14746 }; /* 0.9, in 1/2^14 */
    int64_t inverse = ((int64_t)1 << 44) / length;
    int32_t normal[3] = {0, 0, 0};
    for (int n = 0; n < 3; n++) basis[0][n] = (centre[n] * inverse + (1 << 29)) >> 30;
    if (touch_abs(basis[0][2]) < NEAR_THIRD_AXIS) normal[0] = (int32_t)-basis[0][1], normal[1] = (int32_t)basis[0][0];
    else normal[1] = (int32_t)-basis[0][2], normal[2] = (int32_t)basis[0][1];
    inverse = ((int64_t)1 << 44) / touch_length(normal);
    for (int n = 0; n < 3; n++) basis[1][n] = (normal[n] * inverse + (1 << 29)) >> 30;
    for (int n = 0; n < 3; n++) {
        int i = (n + 1) % 3, j = (n + 2) % 3;
        basis[2][n] = (basis[0][i] * basis[1][j] - basis[0][j] * basis[1][i]) >> TOUCH_ONE_BITS;
    }
}

/* Class of where an alternative prediction lies along an axis of the residual: 0 to 14, 7 at the centre. `thresholds` are
   in quarters of a unit: a distance of n quarters of a step, rounded down, is one of at least n steps in quarters of a
   unit, or behind the centre of more than n - 1. */
static uint32_t touch_alternative_class(const touch_voxel *v, const int32_t alternative[3], const int64_t axis[3],
                                        const int thresholds[TOUCH_MAX_CLASS]) {
    int64_t quarters = 0;
    for (int n = 0; n < 3; n++) quarters += (int64_t)(alternative[n] - v->centre[n]) * axis[n];
    quarters >>= TOUCH_ONE_BITS - 2;
    int is_behind = quarters < 0, size = touch_class(is_behind ? v->centre_step - 1 - quarters : quarters, thresholds);
    return (uint32_t)(is_behind ? TOUCH_AT_CENTRE - size : TOUCH_AT_CENTRE + size);
}

/* Centre and axes of the residual. It is relative to the adaptive prediction, in steps along and across it: errors of
   both kinds have different bounds. Where other predictions lie indicates where the force may be. */
static void touch_set_centre(const touch_pass *p, touch_voxel *v) {
    static const int quarters[TOUCH_MAX_CLASS] = {1, 2, 3, 5, 8, 12, 20}; /* of a step */
    int thresholds[TOUCH_MAX_CLASS];
    memcpy(v->centre, v->adaptive, sizeof v->centre);
    if (!v->centre[0] && !v->centre[1] && !v->centre[2]) v->centre[2] = 1;
    int64_t length = touch_length(v->centre);
    v->centre_step = touch_step(p->steps, length), v->centre_position = touch_step_position(p->steps, length);
    touch_basis(v->centre, length, v->basis);
    for (int n = 0; n < TOUCH_MAX_CLASS; n++) thresholds[n] = quarters[n] * (int)v->centre_step; /* a step is below 2^19 */
    for (int k = 0; k < 3; k++) {
        uint32_t class_of[4];
        for (int n = 0; n < 4; n++) {
            int has_alternative = n < 3 ? v->neighbour[n] != 0 : v->has_reference;
            const int32_t *alternative = n < 3 ? v->extrapolation[n] : v->reference;
            uint32_t none = TOUCH_NO_ALTERNATIVE;
            class_of[n] = has_alternative ? touch_alternative_class(v, alternative, v->basis[k], thresholds) : none;
        }
        v->alternatives_01[k] = class_of[0] << 4 | class_of[1], v->alternatives_23[k] = class_of[2] << 4 | class_of[3];
    }
}

/* Component k of the residual: significance, sign, magnitude in steps. */
static int64_t touch_code_component(touch_pass *p, const touch_voxel *v, int k, int64_t residual) {
    touch_component_contexts *c = p->models->context.component + k;
    const int64_t *axis = v->basis[k];
    const int32_t *d = v->disagreement;
    int64_t target = touch_abs(residual), size = 1;
    int64_t distance = (d[0] * axis[0] + d[1] * axis[1] + d[2] * axis[2]) >> TOUCH_ONE_BITS;
    int toward = touch_distance_class(touch_abs(distance), v->centre_step), residuals = v->residual_class[k];
    int disagreement = toward << 3 | v->disagreement_class, is_large = residuals > 3;
    /* a residual of zero would have been a skip, if both predictions are the same */
    int is_certain = k == 2 && v->predictor == TOUCH_NONE && !v->residual[0] && !v->residual[1];
    if (!is_certain && !touch_mix3(p->coder, &c->zero_alternatives_01[is_large][v->alternatives_01[k]],
                                   &c->zero_alternatives_23[is_large][v->alternatives_23[k]],
                                   &c->zero_disagreement[disagreement], p->models->weight.zero[k][residuals], residual != 0))
        return 0;
    int is_negative = touch_mix3(p->coder, &c->sign_alternatives_01[v->alternatives_01[k]],
                                 &c->sign_alternatives_23[v->alternatives_23[k]],
                                 &c->sign_disagreement[toward << 3 | (distance < 0) << 2 | v->neighbour_count],
                                 p->models->weight.sign[k], residual < 0);
    while (size <= TOUCH_MAX_UNARY &&
           touch_mix2(p->coder, &c->size_residuals[residuals][size - 1], &c->size_disagreement[disagreement][size - 1],
                      p->models->weight.size[k][size - 1], target > size))
        size++;
    if (size > TOUCH_MAX_UNARY)
        size = TOUCH_MAX_UNARY + touch_gamma(p->coder, TOUCH_ESCAPE_DIGITS, target - TOUCH_MAX_UNARY);
    return is_negative ? -size : size;
}

/* The length along the centre by the first component of a residual, and the steps across it there. */
static int64_t touch_radial_length(const touch_pass *p, const touch_voxel *v, int64_t residual, int64_t *cross_step) {
    int64_t length = touch_length_at(p->steps, v->centre_position + 256 * residual);
    *cross_step = touch_max((touch_abs(length) * p->steps->cross_rate) >> 16, p->steps->cross_floor);
    return length;
}

/* The vector of a residual: a length along the centre, and two components across it, units. */
static void touch_residual_vector(const touch_voxel *v, int64_t length, int64_t b, int64_t c, int32_t out[3]) {
    for (int n = 0; n < 3; n++)
        out[n] = touch_clip_component(touch_round_one(length * v->basis[0][n] + b * v->basis[1][n] + c * v->basis[2][n]));
}

#ifdef TOUCH_WRITES /* the choices of a writer, and its input (touch_encode.h) */
static void touch_load_target(touch_pass *p, uint64_t brick);
static int touch_choose_state(const touch_pass *p, uint64_t brick, uint64_t reference);
static int touch_choose_blocks(const touch_pass *p);
static int touch_choose_support(const touch_pass *p, int here);
static int touch_choose_skip(const touch_pass *p, const touch_voxel *v);
static void touch_choose_residual(const touch_pass *p, touch_voxel *v);
#endif

/* The residual of a voxel that is not skipped, and the vector. */
static void touch_code_residual(touch_pass *p, touch_voxel *v) {
    int64_t residual[3] = {0, 0, 0}, step; /* what a writer has chosen */
    touch_set_centre(p, v);
#ifdef TOUCH_WRITES
    if (TOUCH_IS_WRITING(p->coder)) touch_choose_residual(p, v), memcpy(residual, v->residual, sizeof residual);
#endif
    for (int k = 0; k < 3; k++) {
        v->residual[k] = touch_code_component(p, v, k, residual[k]);
        if (!k) TOUCH_ACCOUNT(p->coder, TOUCH_BITS_AMPLITUDE);
    }
    TOUCH_ACCOUNT(p->coder, TOUCH_BITS_DIRECTION);
    int64_t length = touch_radial_length(p, v, v->residual[0], &step);
    touch_residual_vector(v, length, v->residual[1] * step, v->residual[2] * step, v->vector);
}

/* A voxel: support, prediction, skip or residual; it is stored at `index` of the decoded voxels. */
static void touch_code_voxel(touch_pass *p, int here, int32_t index, int state) {
    touch_coder *b = p->coder;
    touch_voxel v;
    touch_look_around(p, &v, here);
    if (!touch_code_support(p, &v, TOUCH_CHOOSE(b, touch_choose_support(p, here)))) return;
    TOUCH_ACCOUNT(b, TOUCH_BITS_SUPPORT);
    touch_predict(p, &v, state);
    touch_classify(p, &v);
    v.residual[0] = v.residual[1] = v.residual[2] = 0;
    if (touch_code_skip(p, &v, TOUCH_CHOOSE(b, touch_choose_skip(p, &v)))) {
        memcpy(v.vector, v.prediction, sizeof v.vector);
        TOUCH_ACCOUNT(b, TOUCH_BITS_AMPLITUDE);
    } else touch_code_residual(p, &v);
    touch_store_decoded(p, p->decoded + index, v.vector, touch_min(touch_abs(v.residual[0]), TOUCH_MAX_ALONG_SIZE),
                        touch_min(touch_abs(v.residual[1]) + touch_abs(v.residual[2]), TOUCH_MAX_ACROSS_SIZE));
    p->decoded_at[here] = index;
    memcpy(p->last_vector, v.vector, sizeof p->last_vector);
    touch_learn_weights(&v);
}

static int touch_window_index(int x, int y, int z) { return (x + 2) * TOUCH_DEEP + (y + 2) * TOUCH_UP + z + 2; }

/* Decode a brick that was copied from the reference: only once a brick beside it needs it, which is rare in a world that
   stands still. */
static void touch_load_copy(const touch_pass *p, uint64_t slot) {
    touch_decoded *decoded = p->decoded + 512 * slot;
    memset(decoded, 0, 512 * sizeof *decoded);
    for (int n = 0; n < 512; n++) {
        const int32_t *from = p->out->v[512 * slot + (uint64_t)touch_grid_sample(&p->scan, n >> 6, n >> 3 & 7, n & 7)].v;
        int32_t v[3];
        if (!(from[0] | from[1] | from[2])) continue;
        for (int k = 0; k < 3; k++) v[k] = p->scan.sign[k] * from[p->scan.axis[k]];
        touch_store_decoded(p, decoded + n, v, 0, 0);
    }
}

/* Fill the window of a brick of the scan. */
static void touch_fill_pass_window(touch_pass *p, const int32_t brick[3], const touch_map *slots,
                                   const touch_map *references) {
    for (int n = 0; n < TOUCH_WINDOW; n++) p->decoded_at[n] = p->reference_at[n] = -1;
    for (int dx = -1; dx <= 1; dx++)
        for (int dy = -1; dy <= 1; dy++)
            for (int dz = -1; dz <= 1; dz++) {
                uint64_t key = touch_key(brick[0] + dx, brick[1] + dy, brick[2] + dz);
                int is_past = dx < 0 || (!dx && (dy < 0 || (!dy && dz < 0)));
                int64_t decoded = is_past ? touch_map_get(slots, key) : -1, reference = touch_map_get(references, key);
                int low[3], high[3], d[3];
                if (decoded < 0 && reference < 0) continue;
                if (decoded >= 0 && p->decoded[512 * decoded].length == TOUCH_NOT_LOADED)
                    touch_load_copy(p, (uint64_t)decoded);
                d[0] = dx, d[1] = dy, d[2] = dz;
                for (int n = 0; n < 3; n++) low[n] = d[n] < 0 ? 6 : 0, high[n] = d[n] > 0 ? 2 : 8;
                for (int x = low[0]; x < high[0]; x++)
                    for (int y = low[1]; y < high[1]; y++)
                        for (int z = low[2]; z < high[2]; z++) {
                            int here = touch_window_index(8 * dx + x, 8 * dy + y, 8 * dz + z);
                            int32_t index = (int32_t)(512 * decoded + 64 * x + 8 * y + z);
                            if (decoded >= 0 && p->decoded[index].length) p->decoded_at[here] = index;
                            if (reference < 0) continue;
                            int sample = touch_grid_sample(&p->scan, x, y, z);
                            if (p->has_reference[8 * reference + (sample >> 6)] >> (sample & 63) & 1)
                                p->reference_at[here] = (int32_t)(512 * reference + sample);
                        }
            }
}

/* Whether any of the 16 voxels before a block along an axis, in the brick before, is supported. */
static int touch_is_side_set(const touch_pass *p, const int base[3], int axis) {
    for (int i = 0; i < 16; i++) {
        int at[3], u = (axis + 1) % 3, w = (axis + 2) % 3;
        at[axis] = -1, at[u] = base[u] + (i >> 2), at[w] = base[w] + (i & 3);
        if (p->decoded_at[touch_window_index(at[0], at[1], at[2])] >= 0) return 1;
    }
    return 0;
}

/* Whether the reference has a force in a block. */
static int touch_has_block_reference(const touch_pass *p, const int base[3]) {
    for (int i = 0; i < 64; i++)
        if (p->reference_at[touch_window_index(base[0] + (i >> 4), base[1] + (i >> 2 & 3), base[2] + (i & 3))] >= 0) return 1;
    return 0;
}

/* Blocks: which of the eight blocks of 4 x 4 x 4 voxels of a brick have a force, as bits. Supports are connected, so a
   block is likely to be set where the block or the voxels before it along an axis are: those are its `sides`, 3 bits. */
static int touch_code_blocks(touch_pass *p, int target) {
    int blocks = 0;
    for (int n = 0; n < 8; n++) {
        int sides = 0, base[3], reference = 0;
        base[0] = n >> 2 ? 4 : 0, base[1] = n & 2 ? 4 : 0, base[2] = n & 1 ? 4 : 0;
        for (int axis = 0; axis < 3; axis++) {
            int bit = 4 >> axis;
            sides = sides << 1 | (n & bit ? blocks >> (n - bit) & 1 : touch_is_side_set(p, base, axis));
        }
        if (p->is_listed) reference = 1 + touch_has_block_reference(p, base);
        blocks |= touch_code(p->coder, &p->models->context.block[reference][sides], target >> n & 1) << n;
    }
    return blocks;
}

/* A brick of state COPY: every voxel within the grid has the vector of the reference. The bricks after it predict from
   them (touch_load_copy). */
static void touch_copy_reference(touch_pass *p, uint64_t slot, uint64_t reference, const int low[3], const int high[3]) {
    touch_int_vector *to = p->out->v + 512 * slot;
    const touch_int_vector *from = p->reference->v + 512 * reference;
    int is_whole = 1;
    for (int n = 0; n < 3; n++) is_whole &= !low[n] && high[n] == 8;
    p->decoded[512 * slot].length = TOUCH_NOT_LOADED;
    if (is_whole) memcpy(to, from, 512 * sizeof *to);
    else memset(to, 0, 512 * sizeof *to);
    for (int x = low[0]; x < high[0] && !is_whole; x++)
        for (int y = low[1]; y < high[1]; y++)
            for (int z = low[2]; z < high[2]; z++) {
                int sample = touch_grid_sample(&p->scan, x, y, z);
                to[sample] = from[sample];
            }
}

/* The state of a brick that the reference lists. */
static int touch_code_state(touch_pass *p, int target) {
    int state = TOUCH_COPY;
    if (!touch_code(p->coder, p->models->context.copy + p->last_state, target == TOUCH_COPY))
        state = touch_code(p->coder, p->models->context.follow + p->last_state, target);
    return p->last_state = state;
}

/* A brick that is not COPY: its blocks; its voxels. */
static void touch_code_brick(touch_pass *p, uint64_t slot, int state, const int low[3], const int high[3]) {
    int32_t first = (int32_t)(512 * slot);
    memset(p->decoded + first, 0, 512 * sizeof *p->decoded);
    int blocks = touch_code_blocks(p, TOUCH_CHOOSE(p->coder, touch_choose_blocks(p)));
    for (int x = low[0]; x < high[0]; x++)
        for (int y = low[1]; y < high[1]; y++)
            for (int z = low[2]; z < high[2]; z++)
                if (blocks >> ((x >> 2) * 4 + (y >> 2) * 2 + (z >> 2)) & 1)
                    touch_code_voxel(p, touch_window_index(x, y, z), first + 64 * x + 8 * y + z, state);
}

/* Cells of a brick as vectors of the grid. */
static void touch_unscan(const touch_scan *s, const touch_decoded *decoded, touch_int_vector *out) {
    memset(out, 0, 512 * sizeof *out);
    for (int n = 0; n < 512; n++) {
        if (!decoded[n].length) continue;
        touch_int_vector *v = out + touch_grid_sample(s, n >> 6, n >> 3 & 7, n & 7);
        for (int k = 0; k < 3; k++) v->v[s->axis[k]] = s->sign[k] * decoded[n].vector[k];
    }
}

/* The bricks of `out->list`, in the order of the scan; their vectors go to `out->v`, all of which is written. */
static int touch_code_bricks(touch_pass *p, const touch_grid *grid, touch_units *out, touch_arena *arena,
                             touch_cursor *error) {
    const touch_list *before = &p->reference->list;
    uint64_t count = out->list.count, *key = (uint64_t *)touch_take(arena, count, 8);
    uint32_t *slot = (uint32_t *)touch_take(arena, count, 4);
    touch_map slots, references;
    p->decoded = (touch_decoded *)touch_take(arena, 512 * count, sizeof *p->decoded), p->out = out;
    p->has_reference = (uint64_t *)touch_take_zero(arena, 8 * before->count, 8);
    if (!key || !slot || !p->decoded || !p->has_reference || !touch_map_make(&slots, count, arena) ||
        !touch_map_make(&references, before->count, arena))
        return touch_fail(error, TOUCH_MEMORY, "no room for a frame");
    for (uint64_t i = 0; i < count; i++)
        key[i] = touch_scan_key(&p->scan, out->list.key[i]), slot[i] = (uint32_t)i, touch_map_put(&slots, key[i], slot[i]);
    for (uint64_t i = 0; i < 512 * before->count; i++) {
        const int32_t *v = p->reference->v[i].v;
        p->has_reference[i >> 6] |= (uint64_t)(v[0] || v[1] || v[2]) << (i & 63);
    }
    for (uint64_t i = 0; i < before->count; i++)
        touch_map_put(&references, touch_scan_key(&p->scan, before->key[i]), (uint32_t)i);
    touch_sort(key, slot, count);
    p->last_state = TOUCH_CODE, p->last_vector[0] = p->last_vector[1] = p->last_vector[2] = 0;
    for (uint64_t i = 0; i < count; i++) {
        int32_t at[3];
        int low[3], high[3], state = TOUCH_CODE, target = TOUCH_CODE;
        int64_t reference = touch_map_get(&references, key[i]);
        touch_position(key[i], at);
        touch_scan_inside(&p->scan, grid, at, low, high);
        p->is_listed = reference >= 0;
        if (p->is_listed) target = TOUCH_CHOOSE(p->coder, touch_choose_state(p, slot[i], (uint64_t)reference));
        if (p->is_listed) state = touch_code_state(p, target);
        if (state == TOUCH_COPY) touch_copy_reference(p, slot[i], (uint64_t)reference, low, high);
        else {
            touch_fill_pass_window(p, at, &slots, &references);
#ifdef TOUCH_WRITES
            if (TOUCH_IS_WRITING(p->coder)) touch_load_target(p, slot[i]);
#endif
            touch_code_brick(p, slot[i], state, low, high);
            touch_unscan(&p->scan, p->decoded + 512 * (uint64_t)slot[i], out->v + 512 * (uint64_t)slot[i]);
        }
        touch_check(p->coder, error);
        if (error->code) return 0;
    }
    return 1;
}

/* -- base layers: splines (docs/format/touch-base-layer.md, kind 0) -------------------------------------------------- */

enum {
    TOUCH_NODE_DIGITS = 24,            /* of a residual at most */
    TOUCH_NODE_CLASSES = 10,           /* of the sizes of the residuals before */
    TOUCH_MAX_NODE = 1 << 23,          /* of a coefficient, units */
    TOUCH_MAX_BRICK_NODES = 125,       /* that a brick needs: 5 along each axis at a spacing of 4 samples */
    TOUCH_POTENTIAL_PER_DEPTH = 8 * 216, /* a sum over 8 corners, of B-splines whose weights have the sum 6 along an axis */
    TOUCH_MAX_DEPTH = 1 << 16,         /* units */
    TOUCH_MAX_GRADIENT = 1 << 20,      /* of a component of the scaled gradient */
    TOUCH_MIN_STEEPNESS = 1 << 14      /* a smaller gradient shortens the force: there the potential has a fold */
};

typedef struct {
    touch_list_models list;
    struct {
        touch_context length[TOUCH_NODE_CLASSES][TOUCH_NODE_DIGITS]; /* binary digits of a residual, by those before */
    } node;
} touch_spline_models;

typedef struct { /* what all nodes have in common */
    int shift[3]; /* the spacing of nodes is 2^shift samples */
    int64_t step, scale[3];
} touch_spline_head;

typedef struct { /* the nodes that any brick needs, in raster order */
    uint64_t *key, count;
    int32_t *value, *size; /* coefficients in units; sizes of their residuals */
    touch_map map;         /* of the nodes that are coded */
} touch_nodes;

static int64_t touch_code_node_residual(touch_coder *b, touch_context *c, int64_t residual) {
    int64_t size = touch_abs(residual);
    int length = 0, is_negative;
    while (length < TOUCH_NODE_DIGITS && touch_code(b, c + length, size >> length > 0)) length++;
    if (!length) return 0;
    is_negative = touch_narrow(b, TOUCH_EVEN, residual < 0);
    size = (int64_t)1 << (length - 1) | touch_even(b, length - 1, size);
    return is_negative ? -size : size;
}

/* The mean of the planes through the nodes before a node, two axes each; else of the nodes themselves; also the sum of
   the sizes of their residuals: where the last ones were large, this one is, too. */
static int64_t touch_expected_node(const touch_nodes *nodes, uint64_t key, int64_t *sizes) {
    const int32_t *value = nodes->value;
    int32_t at[3];
    int64_t before[3], across[3], sum = 0;
    int count = 0;
    *sizes = 0;
    touch_position(key, at);
    for (int n = 0; n < 3; n++) { /* before it along an axis, and along the two others together */
        before[n] = touch_map_get(&nodes->map, touch_key(at[0] - (n == 0), at[1] - (n == 1), at[2] - (n == 2)));
        across[n] = touch_map_get(&nodes->map, touch_key(at[0] - (n != 0), at[1] - (n != 1), at[2] - (n != 2)));
        if (before[n] >= 0) *sizes += nodes->size[before[n]];
    }
    for (int n = 0; n < 3; n++) {
        int64_t p = before[(n + 1) % 3], q = before[(n + 2) % 3];
        if (p >= 0 && q >= 0 && across[n] >= 0) sum += (int64_t)value[p] + value[q] - value[across[n]], count++;
    }
    for (int n = 0, has_planes = count > 0; n < 3 && !has_planes; n++)
        if (before[n] >= 0) sum += value[before[n]], count++;
    return count ? touch_div(2 * sum + count, 2 * count) : 0;
}

/* Values of all nodes: a writer's are replaced by what a reader will have. */
static void touch_code_nodes(touch_coder *b, touch_spline_models *m, touch_nodes *nodes, int64_t step) {
    for (uint64_t i = 0; i < nodes->count; i++) {
        int64_t sizes, expected = touch_expected_node(nodes, nodes->key[i], &sizes), residual = 0;
        int size_class = (int)touch_min(touch_bit_length((uint64_t)sizes), TOUCH_NODE_CLASSES - 1);
        if (TOUCH_IS_WRITING(b)) residual = touch_div(2 * (nodes->value[i] - expected) + step, 2 * step);
        residual = touch_code_node_residual(b, m->node.length[size_class], residual);
        nodes->size[i] = (int32_t)touch_abs(residual);
        nodes->value[i] = (int32_t)touch_clip_to(expected + residual * step, TOUCH_MAX_NODE);
        touch_map_put(&nodes->map, nodes->key[i], (uint32_t)i);
    }
}

/* The nodes of some bricks. */
static int touch_nodes_of(touch_nodes *nodes, const int shift[3], touch_list list, touch_arena *arena) {
    uint64_t count = 0, *key = (uint64_t *)touch_take(arena, TOUCH_MAX_BRICK_NODES * list.count, 8);
    uint32_t *tag = (uint32_t *)touch_take_zero(arena, TOUCH_MAX_BRICK_NODES * list.count, 4);
    if (!key || !tag) return 0;
    for (uint64_t i = 0; i < list.count; i++) {
        int32_t at[3], low[3], high[3];
        touch_position(list.key[i], at);
        for (int n = 0; n < 3; n++) low[n] = (8 * at[n] >> shift[n]) - 1, high[n] = ((8 * at[n] + 7) >> shift[n]) + 2;
        for (int32_t x = low[0]; x <= high[0]; x++)
            for (int32_t y = low[1]; y <= high[1]; y++)
                for (int32_t z = low[2]; z <= high[2]; z++) key[count++] = touch_key(x, y, z);
    }
    touch_sort(key, tag, count);
    nodes->key = key, nodes->count = 0;
    for (uint64_t i = 0; i < count; i++)
        if (!i || key[i] != key[i - 1]) key[nodes->count++] = key[i];
    nodes->value = (int32_t *)touch_take_zero(arena, nodes->count, 4);
    nodes->size = (int32_t *)touch_take_zero(arena, nodes->count, 4);
    return nodes->value && nodes->size && touch_map_make(&nodes->map, nodes->count, arena);
}

/* Weights of four nodes of a cubic B-spline at the nine corners of a brick along an axis; `span`: the first of them. */
static void touch_corner_weights(int shift, int32_t brick, int64_t weight[9][4], int span[9]) {
    int64_t spacing = (int64_t)1 << shift, cube = spacing * spacing * spacing;
    for (int k = 0; k < 9; k++) {
        span[k] = (k < 7 ? k : 7) >> shift; /* the last corner belongs to the span of the last sample */
        int64_t p = ((8 * brick) & (spacing - 1)) + k - span[k] * spacing, q = spacing - p;
        weight[k][0] = q * q * q, weight[k][3] = p * p * p;
        weight[k][1] = 4 * cube - 6 * spacing * p * p + 3 * p * p * p;
        weight[k][2] = 4 * cube - 6 * spacing * q * q + 3 * q * q * q;
    }
}

/* The potential at the corners around the samples of a brick: sums of weighted nodes along x, then y, then z. */
static void touch_corners(const touch_nodes *nodes, const int32_t brick[3], const int shift[3], int64_t v[9][9][9]) {
    int64_t node[5][5][5], weight[3][9][4];
    int count[3], first[3], span[3][9];
    for (int n = 0; n < 3; n++) {
        first[n] = (8 * brick[n] >> shift[n]) - 1, count[n] = ((8 * brick[n] + 7) >> shift[n]) + 3 - first[n];
        touch_corner_weights(shift[n], brick[n], weight[n], span[n]);
    }
    for (int i = 0; i < count[0]; i++)
        for (int j = 0; j < count[1]; j++)
            for (int m = 0; m < count[2]; m++)
                node[i][j][m] =
                    nodes->value[touch_map_get(&nodes->map, touch_key(first[0] + i, first[1] + j, first[2] + m))];
    for (int n = 0; n < 9; n++) {
        int64_t x[5][5], y[5];
        for (int j = 0; j < count[1]; j++)
            for (int m = 0; m < count[2]; m++) {
                x[j][m] = ((int64_t)1 << 3 * shift[0]) >> 1;
                for (int a = 0; a < 4; a++) x[j][m] += weight[0][n][a] * node[span[0][n] + a][j][m];
                x[j][m] >>= 3 * shift[0];
            }
        for (int i = 0; i < 9; i++) {
            for (int m = 0; m < count[2]; m++) {
                y[m] = ((int64_t)1 << (3 * shift[1])) >> 1;
                for (int a = 0; a < 4; a++) y[m] += weight[1][i][a] * x[span[1][i] + a][m];
                y[m] >>= 3 * shift[1];
            }
            for (int k = 0; k < 9; k++) {
                int64_t sum = ((int64_t)1 << (3 * shift[2])) >> 1;
                for (int a = 0; a < 4; a++) sum += weight[2][k][a] * y[span[2][k] + a];
                v[n][i][k] = sum >> (3 * shift[2]);
            }
        }
    }
}

/* Forces of a brick: the depth against its gradient, but shorter where the potential has a fold. */
static void touch_spline_brick(int64_t v[9][9][9], const int64_t scale[3], const int high[3], touch_int_vector *out) {
    for (int x = 0; x < high[0]; x++)
        for (int y = 0; y < high[1]; y++)
            for (int z = 0; z < high[2]; z++) {
                int64_t gradient[3] = {0, 0, 0}, depth = 0, steepness = 0;
                for (int n = 0; n < 8; n++) {
                    int64_t potential = v[x + (n >> 2)][y + (n >> 1 & 1)][z + (n & 1)];
                    depth += potential;
                    for (int k = 0; k < 3; k++) gradient[k] += n & (4 >> k) ? potential : -potential;
                }
                depth = touch_div(depth + TOUCH_POTENTIAL_PER_DEPTH / 2, TOUCH_POTENTIAL_PER_DEPTH);
                depth = touch_clip(depth, 0, TOUCH_MAX_DEPTH);
                for (int n = 0; n < 3; n++) {
                    gradient[n] = touch_clip_to((gradient[n] * scale[n]) >> 20, TOUCH_MAX_GRADIENT);
                    steepness += gradient[n] * gradient[n];
                }
                steepness = touch_max(touch_isqrt(steepness), TOUCH_MIN_STEEPNESS);
                for (int n = 0; n < 3; n++)
                    out[64 * x + 8 * y + z].v[n] = (int32_t)touch_div(steepness - 2 * depth * gradient[n], 2 * steepness);
            }
}

/* The forces of a spline in the bricks of `out->list`, which are zero before. */
static void touch_fill_spline(const touch_spline_head *head, const touch_nodes *nodes, const touch_grid *grid,
                              touch_units *out) {
    int64_t v[9][9][9];
    for (uint64_t i = 0; i < out->list.count; i++) {
        int32_t at[3];
        int high[3];
        touch_position(out->list.key[i], at), touch_brick_samples(grid, at, high);
        touch_corners(nodes, at, head->shift, v);
        touch_spline_brick(v, head->scale, high, out->v + 512 * i);
    }
}

/* -- base layers: columns (docs/format/touch-base-layer.md, kind 1) --------------------------------------------------

   A column runs from outside to inside through up to two surfaces. Behind a surface the force grows along a ramp up to
   its amplitude. Each surface has four numbers, which are coded as residuals to those of the columns around. */

enum { TOUCH_DIRECTION_A = 0, TOUCH_DIRECTION_B = 1, TOUCH_START = 2, TOUCH_AMPLITUDE = 3 }; /* numbers of a surface */
enum { TOUCH_WEST = 0, TOUCH_NORTH = 1, TOUCH_CORNER = 2, TOUCH_EAST = 3 }; /* columns before: along b, along a, both; a, -b */

enum {
    TOUCH_SAMPLE = 256,                     /* starts are in 1/256 samples */
    TOUCH_MAX_START = 1 << 24,              /* 65536 samples */
    TOUCH_SECOND_START = 6 * TOUCH_SAMPLE,  /* a second surface is expected so far behind the first, unless one continues */
    TOUCH_TEAR = 3 * TOUCH_SAMPLE,          /* starts that differ by more are of surfaces that do not continue each other */
    TOUCH_MAX_RISE = 16 * TOUCH_SAMPLE,     /* from column to column */
    TOUCH_MIN_OUTWARD = 820,                /* 0.05, in 1/2^14: a normal points outward, so that a rise stays finite */
    TOUCH_MIN_RAMP = 16,                    /* growth of the fraction from sample to sample, in 1/2^16 */
    TOUCH_FULL_RAMP = 1 << 16,              /* the fraction deep inside */
    TOUCH_MIN_TOP_BITS = 4,                 /* an amplitude is expected, and its step is chosen, at 2^-4 of the top or more */
    TOUCH_MAX_COLUMN_RESIDUAL = 1 << 30,    /* as far as it is stored */
    TOUCH_COLUMN_UNARY = 20,                /* a magnitude up to here is coded in unary with contexts, then in gamma code, */
    TOUCH_COLUMN_ESCAPE_DIGITS = 24         /* of so many digits at most */
};

/* Nodes: pairs of context tables with a set of weights. Each kind of number has 22 of them: significance, sign, 20 of the
   magnitude. Kind 0 is whether a column has a surface, and two; kind 1 the mode, two bits; kinds 2 to 5 the four numbers
   of the one surface of a column, 6 to 9 of the first of two, 10 to 13 of the second. */
enum {
    TOUCH_NUMBER_NODES = 2 + TOUCH_COLUMN_UNARY,
    TOUCH_NODE_HAS_SURFACE = 0,
    TOUCH_NODE_HAS_TWO = 1,
    TOUCH_NODE_MODE = TOUCH_NUMBER_NODES, /* and two more for its second bit */
    TOUCH_KIND_NUMBERS = 2,
    TOUCH_COLUMN_NODES = 14 * TOUCH_NUMBER_NODES
};

typedef struct {
    int32_t number[4], normal[3], residual[4]; /* the normal: along a, along b, outward, 1/2^14 */
} touch_surface;

typedef struct {
    int count;
    touch_surface surface[2];
} touch_column;

typedef struct { /* what a writer has decided of a column */
    int count, mode; /* mode: which neighbours the first surface continues, where they are torn */
    int64_t residual[2][4];
} touch_column_choice;

typedef struct { /* a box of columns along one axis, from outside to inside */
    const touch_grid *grid;
    int axis, across[2], is_inverted; /* whether the outside is at the end of the axis */
    int64_t depth;                    /* samples of a column */
    int64_t tile[2], tiles[2];        /* the first tile of 8 x 8 columns along a and b, and how many */
} touch_column_box;

typedef struct {
    touch_context first[36], second[16];
} touch_column_contexts;

typedef struct { /* the code of columns */
    touch_coder coder;
    struct {
        touch_column_contexts node[TOUCH_COLUMN_NODES];
    } *context;
    int64_t (*weight)[2];
    int64_t top, ramp, ratio[2]; /* longest force; growth of the ramp; sample spacings along a and b by that of the axis */
    int64_t step[3];             /* of a direction, a start and an amplitude */
    touch_column_box box;
    touch_column *column; /* row by row */
    struct touch_column_fit *fit; /* of a writer */
} touch_columns;

static int touch_column_bit(touch_columns *columns, int node, int first, int second, int bit) {
    touch_column_contexts *c = columns->context->node + node;
    return touch_mix2(&columns->coder, c->first + first, c->second + second, columns->weight[node], bit);
}

static int64_t touch_column_number(touch_columns *columns, int kind, int first, int second, int64_t number) {
    int64_t size = 1, target = touch_abs(number);
    int node = TOUCH_NUMBER_NODES * kind;
    if (!touch_column_bit(columns, node, first, second, number != 0)) return 0;
    int is_negative = touch_column_bit(columns, node + 1, first, second, number < 0);
    while (size <= TOUCH_COLUMN_UNARY && touch_column_bit(columns, node + 1 + (int)size, first, second, target > size)) size++;
    if (size > TOUCH_COLUMN_UNARY)
        size = TOUCH_COLUMN_UNARY +
               touch_gamma(&columns->coder, TOUCH_COLUMN_ESCAPE_DIGITS, target - TOUCH_COLUMN_UNARY);
    return is_negative ? -size : size;
}

/* How much farther inside a surface starts one column on. */
static int64_t touch_rise(const touch_columns *columns, const int32_t normal[3], int axis) {
    return touch_clip_to(touch_div(normal[axis] * columns->ratio[axis], normal[2]), TOUCH_MAX_RISE);
}

static int64_t touch_median(int64_t a, int64_t b, int64_t c) {
    int64_t low = a < b ? a : b, high = a < b ? b : a;
    return c < low ? low : c > high ? high : c;
}

/* A surface of a column, NULL if it has none. */
static const touch_surface *touch_surface_of(const touch_column *column, int slot) {
    return column && column->count > slot ? column->surface + slot : 0;
}

/* The four numbers that a surface is expected to have by the surfaces of west and north that it continues; returns how
   many it continues. */
static int touch_expect_surface(const touch_columns *columns, const touch_column *const around[4], const touch_column *own,
                                int slot, int mode, int count, int64_t expected[4], const touch_surface *continued[2]) {
    const touch_surface *west = touch_surface_of(around[TOUCH_WEST], slot || mode == 3), *first = own->surface;
    const touch_surface *north = touch_surface_of(around[TOUCH_NORTH], slot || mode == 3);
    const touch_surface *corner = touch_surface_of(around[TOUCH_CORNER], slot);
    if (!slot && mode) { /* 1: west, 2: north, 3: the second surface of west, else that of north */
        if (mode == 1 || (mode == 3 && west)) north = 0;
        else west = 0;
    }
    int continues = (west != 0) + (north != 0);
    continued[0] = west, continued[1] = north;
    if (continues) {
        for (int n = 0; n < 4; n++)
            expected[n] = touch_div((west ? west->number[n] : 0) + (int64_t)(north ? north->number[n] : 0), continues);
        for (int n = 0; n < 2 && continues == 2 && corner; n++) { /* between their mean and the plane through all three */
            int64_t w = west->number[n], o = north->number[n];
            expected[n] = (expected[n] + touch_median(w, o, w + o - corner->number[n])) >> 1;
        }
    } else if (slot) {
        for (int n = 0; n < 4; n++) expected[n] = first->number[n];
        expected[TOUCH_START] += TOUCH_SECOND_START;
    } else if (around[TOUCH_EAST] && around[TOUCH_EAST]->count) {
        for (int n = 0; n < 4; n++) expected[n] = around[TOUCH_EAST]->surface[0].number[n];
    } else expected[0] = expected[1] = expected[2] = 0, expected[TOUCH_AMPLITUDE] = columns->top;
    int64_t left = columns->top - first->number[TOUCH_AMPLITUDE]; /* of the force, for the second surface */
    if (slot) expected[TOUCH_AMPLITUDE] = touch_max(left, columns->top >> TOUCH_MIN_TOP_BITS);
    else if (count == 2) expected[TOUCH_AMPLITUDE] = columns->top >> 1;
    return continues;
}

/* The direction of a surface; then the start that is expected, as the surfaces that it continues rise up to it. */
static void touch_turn_surface(const touch_columns *columns, touch_surface *s, int64_t expected[4], const int64_t residual[4],
                               const touch_surface *const continued[2], int continues) {
    int64_t sum = 0;
    for (int n = 0; n < 2; n++)
        s->number[n] = (int32_t)touch_clip(expected[n] + residual[n] * columns->step[0], -TOUCH_ONE, TOUCH_ONE);
    int64_t x = s->number[0], y = s->number[1], inverse = ((int64_t)1 << 43) / ((1 << 28) + x * x + y * y);
    s->normal[0] = (int32_t)((x * inverse) >> TOUCH_ONE_BITS), s->normal[1] = (int32_t)((y * inverse) >> TOUCH_ONE_BITS);
    s->normal[2] = (int32_t)touch_max(inverse - TOUCH_ONE, TOUCH_MIN_OUTWARD);
    if (!continues) return;
    for (int n = 0; n < 2; n++) /* west is the neighbour along b, north along a */
        if (continued[n])
            sum += continued[n]->number[TOUCH_START] +
                   ((touch_rise(columns, continued[n]->normal, 1 - n) + touch_rise(columns, s->normal, 1 - n)) >> 1);
    expected[TOUCH_START] = touch_div(sum, continues);
}

static int64_t touch_amplitude_step(const touch_columns *columns, int64_t expected) {
    return touch_max((touch_max(expected, columns->top >> TOUCH_MIN_TOP_BITS) * columns->step[2]) >> 16, 1);
}

static void touch_set_surface(const touch_columns *columns, touch_surface *s, const int64_t expected[4],
                              const int64_t residual[4]) {
    int64_t start = expected[TOUCH_START] + residual[TOUCH_START] * columns->step[1];
    int64_t step = touch_amplitude_step(columns, expected[TOUCH_AMPLITUDE]);
    int64_t amplitude = expected[TOUCH_AMPLITUDE] + residual[TOUCH_AMPLITUDE] * step;
    s->number[TOUCH_START] = (int32_t)touch_clip_to(start, TOUCH_MAX_START);
    s->number[TOUCH_AMPLITUDE] = (int32_t)touch_clip(amplitude, 1, TOUCH_MAX_COMPONENT);
    for (int q = 0; q < 4; q++) s->residual[q] = (int32_t)touch_clip_to(residual[q], TOUCH_MAX_COLUMN_RESIDUAL);
}

/* Whether west and north may not continue one surface: their starts differ much, or one has two surfaces. */
static int touch_is_torn(const touch_column *const around[4]) {
    const touch_column *west = around[TOUCH_WEST], *north = around[TOUCH_NORTH];
    if ((west && west->count > 1) || (north && north->count > 1)) return 1;
    if (!west || !north || !west->count || !north->count) return 0;
    return touch_abs((int64_t)west->surface[0].number[TOUCH_START] - north->surface[0].number[TOUCH_START]) > TOUCH_TEAR;
}

/* The four residuals of a surface, by the sizes of those of west and north (5: no such surface), and of the last one. */
static void touch_code_surface(touch_columns *columns, const touch_column *const around[4], touch_column *own, int slot,
                               int count, int mode, int some, const int64_t chosen[4]) {
    touch_surface *s = own->surface + slot;
    const touch_surface *continued[2];
    int64_t expected[4], residual[4], last = 0;
    int continues = touch_expect_surface(columns, around, own, slot, mode, count, expected, continued);
    for (int q = 0; q < 4; q++) {
        int64_t sizes[2];
        for (int n = 0; n < 2; n++) {
            const touch_surface *beside = touch_surface_of(around[n], slot);
            sizes[n] = beside ? touch_min(touch_abs(beside->residual[q]), 4) : 5;
        }
        residual[q] = touch_column_number(columns, TOUCH_KIND_NUMBERS + 4 * (count - 1 + slot) + q,
                                          (int)(6 * sizes[0] + sizes[1]), (int)(4 * last) + (some < 3 ? some : 3), chosen[q]);
        last = touch_max(q == TOUCH_DIRECTION_B ? last : 0, touch_min(touch_abs(residual[q]), 3));
        if (q == TOUCH_DIRECTION_B) touch_turn_surface(columns, s, expected, residual, continued, continues);
    }
    touch_set_surface(columns, s, expected, residual);
    own->count = slot + 1;
}

/* A column by those around it: west, north, corner and east, NULL beyond the box. */
static void touch_code_column(touch_columns *columns, const touch_column *const around[4], touch_column *own,
                              const touch_column_choice *choice) {
    int here = 0, twos = 0, mode = 0, some = 0, torn = touch_is_torn(around), count;
    for (int n = 0; n < 4; n++) {
        int surfaces = around[n] ? around[n]->count : 0;
        here |= surfaces > 0 ? 8 >> n : 0, twos |= surfaces > 1 ? 8 >> n : 0, some += surfaces > 0;
    }
    own->count = 0;
    if (!touch_column_bit(columns, TOUCH_NODE_HAS_SURFACE, here, twos, choice->count > 0)) return;
    count = 1 + touch_column_bit(columns, TOUCH_NODE_HAS_TWO, 2 * twos + torn, here, choice->count > 1);
    if (torn) {
        mode = touch_column_bit(columns, TOUCH_NODE_MODE, twos >> 2, count, choice->mode >> 1);
        mode = 2 * mode + touch_column_bit(columns, TOUCH_NODE_MODE + 1 + mode, twos >> 2, count, choice->mode & 1);
    }
    for (int slot = 0; slot < count; slot++)
        touch_code_surface(columns, around, own, slot, count, mode, some, choice->residual[slot]);
}

static touch_column_box touch_column_box_of(const touch_grid *grid, int axis, int is_inverted) {
    touch_column_box box;
    int k = 0;
    memset(&box, 0, sizeof box);
    box.grid = grid, box.axis = axis, box.is_inverted = is_inverted, box.depth = grid->shape[axis];
    for (int n = 0; n < 3; n++)
        if (n != axis) box.across[k++] = n;
    return box;
}

/* Fresh models, and columns without surfaces. */
static int touch_columns_make(touch_columns *columns, touch_arena *arena) {
    uint64_t count = (uint64_t)(64 * columns->box.tiles[0] * columns->box.tiles[1]);
    columns->column = (touch_column *)touch_take_zero(arena, count, sizeof *columns->column);
    *(void **)&columns->context = touch_take(arena, 1, sizeof *columns->context);
    columns->weight = (int64_t(*)[2])touch_take(arena, TOUCH_COLUMN_NODES, sizeof *columns->weight);
    if (!columns->column || !columns->context || !columns->weight) return 0;
    touch_fresh((touch_context *)(void *)columns->context, sizeof *columns->context / sizeof(touch_context),
                columns->weight[0], 2 * TOUCH_COLUMN_NODES);
    return 1;
}

#ifdef TOUCH_WRITES
static void touch_choose_column(touch_columns *columns, int64_t a, int64_t b, const touch_column *const around[4],
                                touch_column *own, touch_column_choice *choice);
#endif

/* All columns of the box that lie within the grid, in raster order. */
static int touch_code_columns(touch_columns *columns, touch_cursor *error) {
    const touch_column_box *v = &columns->box;
    int64_t rows = touch_min(8 * v->tiles[0], v->grid->shape[v->across[0]] - 8 * v->tile[0]), row = 8 * v->tiles[1];
    int64_t in_row = touch_min(row, v->grid->shape[v->across[1]] - 8 * v->tile[1]);
    for (int64_t a = 0; a < rows; a++) {
        for (int64_t b = 0; b < in_row; b++) {
            touch_column *own = columns->column + a * row + b;
            touch_column_choice choice;
            const touch_column *around[4];
            around[TOUCH_WEST] = b ? own - 1 : 0, around[TOUCH_NORTH] = a ? own - row : 0;
            around[TOUCH_CORNER] = a && b ? own - row - 1 : 0;
            around[TOUCH_EAST] = a && b + 1 < row ? own - row + 1 : 0;
            memset(&choice, 0, sizeof choice);
#ifdef TOUCH_WRITES
            if (TOUCH_IS_WRITING(&columns->coder)) touch_choose_column(columns, a, b, around, own, &choice);
#endif
            touch_code_column(columns, around, own, &choice);
        }
        touch_check(&columns->coder, error);
        if (error->code) return 0;
    }
    return 1;
}

/* How much of the force deep inside a surface there is at sample t, 0 to 65536. */
static int64_t touch_ramp(const touch_columns *columns, const touch_surface *s, int64_t t) {
    int64_t slope = touch_max((columns->ramp * s->normal[2]) >> TOUCH_ONE_BITS, TOUCH_MIN_RAMP);
    return touch_clip(((TOUCH_SAMPLE * t - s->number[TOUCH_START]) * slope) >> 8, 0, TOUCH_FULL_RAMP);
}

/* The forces of a column, laid into the bricks of the base layer. */
static void touch_fill_column(const touch_columns *columns, const touch_column *own, int64_t a, int64_t b,
                              const touch_map *map, touch_units *out) {
    const touch_column_box *box = &columns->box;
    int64_t at[3], deep[2][3], slot = -1;
    at[box->axis] = 0, at[box->across[0]] = 8 * box->tile[0] + a, at[box->across[1]] = 8 * box->tile[1] + b;
    for (int s = 0; s < own->count; s++)
        for (int n = 0; n < 3; n++)
            deep[s][n] = touch_round_one((int64_t)own->surface[s].number[TOUCH_AMPLITUDE] * own->surface[s].normal[n]);
    for (int64_t i = 0; i < box->depth; i++) {
        int64_t half = TOUCH_FULL_RAMP / 2, sum[3] = {half, half, half}, t = box->is_inverted ? box->depth - 1 - i : i;
        at[box->axis] = i;
        if (!(i & 7)) slot = touch_map_get(map, touch_key(at[0] >> 3, at[1] >> 3, at[2] >> 3));
        if (slot < 0) continue;
        for (int s = 0; s < own->count; s++) {
            int64_t fraction = touch_ramp(columns, own->surface + s, t);
            for (int n = 0; n < 3; n++) sum[n] += fraction * deep[s][n];
        }
        touch_int_vector *v = out->v + 512 * slot + 64 * (at[0] & 7) + 8 * (at[1] & 7) + (at[2] & 7);
        for (int n = 0; n < 3; n++) sum[n] = touch_clip_component(sum[n] >> 16);
        v->v[box->across[0]] = (int32_t)sum[0], v->v[box->across[1]] = (int32_t)sum[1];
        v->v[box->axis] = (int32_t)(box->is_inverted ? sum[2] : -sum[2]);
    }
}

/* For each tile, the first sample of a column with a force. */
static int64_t *touch_tile_starts(const touch_columns *columns, touch_arena *arena) {
    const touch_column_box *v = &columns->box;
    int64_t row = 8 * v->tiles[1], *start = (int64_t *)touch_take(arena, (uint64_t)(v->tiles[0] * v->tiles[1]), 8);
    if (!start) return 0;
    for (int64_t i = 0; i < v->tiles[0] * v->tiles[1]; i++) start[i] = v->depth;
    for (int64_t i = 0; i < 8 * v->tiles[0] * row; i++) {
        int64_t *first = start + (i / row >> 3) * v->tiles[1] + (i % row >> 3);
        for (int n = 0; n < columns->column[i].count; n++)
            *first = touch_min(*first, (columns->column[i].surface[n].number[TOUCH_START] >> 8) + 1);
    }
    return start;
}

/* The bricks and forces of columns; more than `max` bricks are an error. */
static int touch_fill_columns(const touch_columns *columns, uint64_t max, touch_units *out, touch_arena *arena,
                              touch_cursor *error) {
    const touch_column_box *v = &columns->box;
    int64_t *start = touch_tile_starts(columns, arena), row = 8 * v->tiles[1];
    touch_map map;
    out->list.key = 0, out->list.count = 0;
    for (int is_written = 0; start && is_written < 2; is_written++) { /* counted, then written */
        uint64_t count = 0;
        for (int64_t i = 0; i < v->tiles[0] * v->tiles[1]; i++)
            for (int64_t k = 0; start[i] < v->depth && k < (v->depth + 7) >> 3; k++) {
                int64_t at[3];
                if (v->is_inverted ? 8 * k >= v->depth - start[i] : 8 * k + 8 <= start[i]) continue;
                at[v->axis] = k, at[v->across[0]] = v->tile[0] + i / v->tiles[1];
                at[v->across[1]] = v->tile[1] + i % v->tiles[1];
                if (is_written) out->list.key[count] = touch_key(at[0], at[1], at[2]);
                if (++count > max) return touch_fail(error, TOUCH_CUT, "bricks of a base layer");
            }
        if (!is_written) out->list.key = (uint64_t *)touch_take(arena, count, 8), out->list.count = count;
        if (!out->list.key) return touch_fail(error, TOUCH_MEMORY, "no room for a base layer");
    }
    uint32_t *tag = (uint32_t *)touch_take_zero(arena, out->list.count, 4);
    out->v = (touch_int_vector *)touch_take_zero(arena, 512 * out->list.count, sizeof *out->v);
    if (!start || !tag || !out->v || !touch_map_make(&map, out->list.count, arena))
        return touch_fail(error, TOUCH_MEMORY, "no room for a base layer");
    touch_sort(out->list.key, tag, out->list.count);
    for (uint64_t i = 0; i < out->list.count; i++) touch_map_put(&map, out->list.key[i], (uint32_t)i);
    for (int64_t i = 0; i < 8 * v->tiles[0] * row; i++)
        if (columns->column[i].count) touch_fill_column(columns, columns->column + i, i / row, i % row, &map, out);
    return 1;
}

/* -- the exact mode (docs/format/touch-exact.md) --------------------------------------------------------------------- */

enum {
    TOUCH_EXACT_TABLE = 1 << 18,     /* contexts, found by a hash of the numbers that a symbol depends on */
    TOUCH_HASH_MASK = (1 << 22) - 1, /* of a hash while it takes numbers */
    TOUCH_ROWS = 14,                 /* samples around that a sample may be equal to; the last one is "not supported" */
    TOUCH_LAST_ICO = 20,             /* codebooks: 1 to 20 are ico1 to ico20, */
    TOUCH_LAST_OCTA = 25,            /* 21 to 25 octa1 to octa5 */
    TOUCH_MAX_VERTICES = 4098,
    TOUCH_MAX_POINTS = 24576 /* of a codebook, with those that are found several times */
};

/* What a context is of: first numbers of its hash. `_PLANE` is followed by the number of the plane. */
enum {
    TOUCH_HASH_EQUAL = 0,           /* 1 to 14: is the sample equal to that row? by which rows are equal to it */
    TOUCH_HASH_EQUAL_NEAR = 16,     /* the same, by the first five rows, and those equal to row 2 */
    TOUCH_HASH_SPATIAL_PLANE = 32,  /* a bit of a symbol, by the distance from an estimate in space, */
    TOUCH_HASH_TEMPORAL_PLANE = 36, /* in time, */
    TOUCH_HASH_LEFT_PLANE = 40,     /* by the symbol to the left, */
    TOUCH_HASH_LAST_PLANE = 44      /* by the symbol of the plane before, and the deep one */
};

typedef struct { /* a sample: its level and vertex, or its components in the order of floats */
    uint32_t symbol[3];
    uint8_t is_supported;
} touch_symbols;

typedef struct { /* a frame, to the bit */
    touch_list list;
    touch_symbols *own;
    float *force;
    int book;
    const uint8_t *levels;
    uint32_t level_count, vertex_count;
    const float *vertices;
} touch_exact;

typedef struct {
    touch_list_models list;
    struct {
        touch_context hashed[TOUCH_EXACT_TABLE];
    } context;
    struct {
        int64_t plane[3][32][4];            /* of each bit of a symbol */
        int64_t equal[TOUCH_ROWS + 1][4]; /* of whether a sample is equal to a row */
    } weight;
} touch_exact_models;

static void touch_exact_fresh(touch_exact_models *m) {
    TOUCH_FRESH(m->list.context, m->list.weight);
    TOUCH_FRESH(m->context, m->weight);
}

#define TOUCH_POINT_SCALE 1099511627776.0 /* 2^40: points nearer to each other than 2^-40 are the same */

typedef struct { /* a unit vector in 2^-40 */
    int64_t p[3];
} touch_point;

static int touch_point_less(const touch_point *a, const touch_point *b) {
    for (int n = 0; n < 3; n++)
        if (a->p[n] != b->p[n]) return a->p[n] < b->p[n];
    return 0;
}

static void touch_point_sift(touch_point *p, uint64_t at, uint64_t n) {
    for (;;) {
        uint64_t child = 2 * at + 1;
        touch_point other;
        if (child >= n) return;
        if (child + 1 < n && touch_point_less(p + child, p + child + 1)) child++;
        if (!touch_point_less(p + at, p + child)) return;
        other = p[at], p[at] = p[child], p[child] = other;
        at = child;
    }
}

static void touch_unit(double v[3]) {
    double size = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    v[0] /= size, v[1] /= size, v[2] /= size;
}

static void touch_add_point(touch_point *p, uint64_t *count, const double v[3]) {
    for (int n = 0; n < 3; n++) p[*count].p[n] = (int64_t)floor(v[n] * TOUCH_POINT_SCALE + 0.5);
    (*count)++;
}

static void touch_split(touch_point *p, uint64_t *count, const double t[3][3], int times) {
    double middle[3][3], part[3][3];
    if (!times) {
        for (int n = 0; n < 3; n++) touch_add_point(p, count, t[n]);
        return;
    }
    for (int n = 0; n < 3; n++) {
        for (int k = 0; k < 3; k++) middle[n][k] = t[n][k] + t[(n + 1) % 3][k];
        touch_unit(middle[n]);
    }
    for (int n = 0; n < 3; n++) {
        memcpy(part[0], t[n], 24), memcpy(part[1], middle[n], 24), memcpy(part[2], middle[(n + 2) % 3], 24);
        touch_split(p, count, (const double(*)[3])part, times - 1);
    }
    touch_split(p, count, (const double(*)[3])middle, times - 1);
}

/* The vertices of codebook B (docs/format/paper.md): 1 to 20 ico1 to ico20, 21 to 25 octa1 to octa5. `*points`: the same
   in 2^-40. */
static const float *touch_codebook(int book, uint32_t *vertices, const touch_point **points, touch_arena *arena) {
    uint64_t count = 0, unique = 0;
    touch_point *p = (touch_point *)touch_take(arena, TOUCH_MAX_POINTS, sizeof *p);
    float *out = (float *)touch_take(arena, 3 * TOUCH_MAX_VERTICES, 4);
    if (!p || !out) return 0;
    if (book > TOUCH_LAST_ICO) {
        for (int n = 0; n < 8; n++) {
            double t[3][3] = {{0}};
            t[0][0] = n & 4 ? -1 : 1, t[1][1] = n & 2 ? -1 : 1, t[2][2] = n & 1 ? -1 : 1;
            touch_split(p, &count, (const double(*)[3])t, book - TOUCH_LAST_ICO);
        }
    } else {
        double corner[12][3], weight[TOUCH_LAST_ICO + 1], golden = (1 + sqrt(5.0)) / 2;
        for (int n = 0; n < 12; n++) {
            int axis = n / 4;
            corner[n][axis] = 0, corner[n][(axis + 1) % 3] = n & 2 ? -1 : 1;
            corner[n][(axis + 2) % 3] = n & 1 ? -golden : golden;
            touch_unit(corner[n]);
        }
        for (int n = 0; n <= book; n++) weight[n] = sin(atan(2.0) * n / book);
        for (int i0 = 0; i0 < 12; i0++)
            for (int i1 = i0 + 1; i1 < 12; i1++)
                for (int i2 = i1 + 1; i2 < 12; i2++) {
                    const double *A = corner[i0], *B = corner[i1], *C = corner[i2];
                    if (A[0] * B[0] + A[1] * B[1] + A[2] * B[2] < 0.4 || A[0] * C[0] + A[1] * C[1] + A[2] * C[2] < 0.4 ||
                        B[0] * C[0] + B[1] * C[1] + B[2] * C[2] < 0.4)
                        continue;
                    for (int a = 0; a <= book; a++)
                        for (int b = 0; a + b <= book; b++) {
                            double v[3];
                            for (int n = 0; n < 3; n++)
                                v[n] = weight[a] * A[n] + weight[b] * B[n] + weight[book - a - b] * C[n];
                            touch_unit(v);
                            touch_add_point(p, &count, v);
                        }
                }
    }
    for (uint64_t i = count / 2; i-- > 0;) touch_point_sift(p, i, count);
    for (uint64_t i = count; i-- > 1;) {
        touch_point other = p[0];
        p[0] = p[i], p[i] = other;
        touch_point_sift(p, 0, i);
    }
    for (uint64_t i = 0; i < count; i++)
        if (!i || touch_point_less(p + unique - 1, p + i)) {
            p[unique] = p[i];
            for (int n = 0; n < 3; n++) out[3 * unique + (uint64_t)n] = (float)((double)p[i].p[n] / TOUCH_POINT_SCALE);
            unique++;
        }
    *vertices = (uint32_t)unique, *points = p;
    return out;
}

/* The number of a component: floats in ascending order, -0.0 before 0.0. */
static uint32_t touch_ordered(float f) {
    uint32_t bits = touch_f32_bits(f);
    return bits >> 31 ? 0xffffffffu - bits : bits + 0x80000000u;
}

static float touch_unordered(uint32_t symbol) {
    return touch_f32_of(symbol >> 31 ? symbol - 0x80000000u : 0xffffffffu - symbol);
}

static float touch_level_at(const touch_exact *f, uint32_t n) {
    const uint8_t *l = f->levels + 4 * (uint64_t)n;
    return touch_f32_of((uint32_t)l[0] | (uint32_t)l[1] << 8 | (uint32_t)l[2] << 16 | (uint32_t)l[3] << 24);
}

static uint32_t touch_hash_value(uint32_t h, int64_t value) {
    int64_t t = (int64_t)(((int64_t)h ^ value) & TOUCH_HASH_MASK) * 0x2f0b4c47 + value;
    return (uint32_t)((t ^ (t >> 19)) & TOUCH_HASH_MASK);
}

/* The context of a hash of up to four numbers. */
static touch_context *touch_hashed(touch_exact_models *m, uint32_t h, int64_t a, int64_t b, int64_t c, int count) {
    h = touch_hash_value(h, a);
    if (count > 1) h = touch_hash_value(h, b);
    if (count > 2) h = touch_hash_value(h, c);
    return m->context.hashed + (h & (TOUCH_EXACT_TABLE - 1));
}

/* The context of a bit of a symbol by an estimate: how far the bits so far (`prefix`) lie from those of the estimate, the
   next three bits of the estimate, and how many bits remain after this one. */
static touch_context *touch_hashed_near(touch_exact_models *m, uint32_t kind, int64_t estimate, int64_t prefix,
                                        int remaining) {
    int64_t distance = touch_clip(prefix - (estimate >> (remaining + 1)), -2, 2);
    return touch_hashed(m, kind, ((distance + 2) * 8 + (((estimate * 4) >> remaining) & 7)) * 32 + remaining, 0, 0, 1);
}

/* The symbol of plane p by those of rows 1 to 5, -1 where there is none; bit by bit from the highest. Mixed from an
   estimate in space (the plane through three neighbours), one in time, and what followed the same symbols before. */
static int64_t touch_code_symbol(touch_coder *b, touch_exact_models *m, int p, uint64_t size, const int64_t row[5],
                                 int64_t last, int64_t target) {
    int64_t previous = row[0], left = row[1], up = row[2], deep = row[3], diagonal = row[4], prefix = 0;
    int width = touch_bit_length(size - 1);
    int64_t spatial = left >= 0 ? left : up >= 0 ? up : deep >= 0 ? deep : previous >= 0 ? previous : 0;
    if (left >= 0 && up >= 0 && diagonal >= 0) spatial = touch_clip(left + up - diagonal, 0, (int64_t)size - 1);
    int64_t temporal = previous >= 0 ? previous : spatial;
    for (int remaining = width - 1; remaining >= 0; remaining--) {
        touch_context *c[4];
        int64_t n = 32 * prefix + remaining;
        c[0] = touch_hashed_near(m, TOUCH_HASH_SPATIAL_PLANE + (uint32_t)p, spatial, prefix, remaining);
        c[1] = touch_hashed_near(m, TOUCH_HASH_TEMPORAL_PLANE + (uint32_t)p, temporal, prefix, remaining);
        c[2] = touch_hashed(m, TOUCH_HASH_LEFT_PLANE + (uint32_t)p, left, n, 0, 2);
        c[3] = touch_hashed(m, TOUCH_HASH_LAST_PLANE + (uint32_t)p, last, deep, n, 3);
        prefix = 2 * prefix + touch_mix(b, c, m->weight.plane[p][width - 1 - remaining], 4, (int)(target >> remaining & 1));
    }
    return prefix;
}

static int touch_is_same(const touch_symbols *a, const touch_symbols *b, int planes) {
    if (a->is_supported != b->is_supported) return 0;
    for (int n = 0; n < planes && a->is_supported; n++)
        if (a->symbol[n] != b->symbol[n]) return 0;
    return 1;
}

/* A sample by the rows 1 to 14 (here from 0): is it equal to row 14 (not supported), 1, 2, 3 or 4, else its symbols. A writer
   passes it, a reader gets it. */
static touch_symbols touch_code_sample(touch_coder *b, touch_exact_models *m, const touch_symbols row[TOUCH_ROWS], int planes,
                                       const uint64_t size[3], touch_symbols own, touch_cursor *error) {
    static const int order[5] = {TOUCH_ROWS, 1, 2, 3, 4};
    uint32_t same[TOUCH_ROWS + 1], c;
    for (int n = 0; n < 5; n++) {
        c = (uint32_t)order[n], same[c] = 0;
        for (int k = 0; k < TOUCH_ROWS; k++) same[c] |= (uint32_t)touch_is_same(row + k, row + c - 1, planes) << k;
    }
    for (int n = 0; n < 5; n++) {
        c = (uint32_t)order[n];
        if (c != TOUCH_ROWS && (!row[c - 1].is_supported || same[c] & ((1u << (c - 1)) - 1))) continue;
        int is_equal = touch_mix2(b, touch_hashed(m, TOUCH_HASH_EQUAL + c, same[c], 0, 0, 1),
                                  touch_hashed(m, TOUCH_HASH_EQUAL_NEAR + c, same[c] & 31, same[2], 0, 2),
                                  m->weight.equal[c], TOUCH_CHOOSE(b, touch_is_same(&own, row + c - 1, planes)));
        TOUCH_ACCOUNT(b, c == TOUCH_ROWS ? TOUCH_BITS_SUPPORT : TOUCH_BITS_AMPLITUDE);
        if (is_equal) return row[c - 1];
    }
    own.is_supported = 1;
    for (int p = 0; p < planes; p++) {
        int64_t around[5];
        for (int k = 0; k < 5; k++) around[k] = row[k].is_supported ? (int64_t)row[k].symbol[p] : -1;
        int64_t symbol = touch_code_symbol(b, m, p, size[p], around, p ? (int64_t)own.symbol[p - 1] : 0,
                                           TOUCH_CHOOSE(b, (int64_t)own.symbol[p]));
        touch_need_coded(b, error, symbol < (int64_t)size[p], "a symbol that there is not");
        own.symbol[p] = (uint32_t)symbol;
        TOUCH_ACCOUNT(b, p ? TOUCH_BITS_DIRECTION : TOUCH_BITS_AMPLITUDE);
        if (error->code) return own;
    }
    return own;
}

typedef struct { /* a pass over an exact frame */
    touch_coder *coder;
    touch_exact_models *models;
    const touch_grid *grid;
    const touch_exact *before; /* the frame before, or NULL */
    touch_map map, map_before; /* slots of the bricks so far; of the frame before */
    uint64_t size[3];          /* of the planes */
} touch_exact_pass;

/* The rows of a sample: itself in the frame before, then those coded before it around it. */
static void touch_exact_rows(const touch_exact_pass *p, const touch_exact *f, const int32_t brick[3], uint64_t slot,
                             int64_t slot_before, int sample, touch_symbols row[TOUCH_ROWS]) {
    static const int8_t step[12][3] = {{0, 0, -1}, {0, -1, 0}, {-1, 0, 0}, {0, -1, -1}, {-1, 0, -1}, {-1, -1, 0},
                                       {0, -1, 1}, {-1, 1, 0}, {-1, 0, 1}, {0, 0, -2}, {0, -2, 0}, {-2, 0, 0}};
    const int x = sample >> 6, y = sample >> 3 & 7, z = sample & 7;
    memset(row, 0, TOUCH_ROWS * sizeof *row);
    if (slot_before >= 0) {
        uint64_t at = 512 * (uint64_t)slot_before + (uint64_t)sample;
        row[0] = p->before->own[at];
        if (p->before->book != f->book && row[0].is_supported)
            for (int n = 0; n < 3; n++) row[0].symbol[n] = touch_ordered(p->before->force[3 * at + (uint64_t)n]);
    }
    for (int n = 0; n < 12; n++) {
        int i = x + step[n][0], j = y + step[n][1], k = z + step[n][2];
        int64_t there = (int64_t)slot;
        if (i & ~7 || j & ~7 || k & ~7)
            there = touch_map_get(&p->map, touch_key(brick[0] + (i >> 3), brick[1] + (j >> 3), brick[2] + (k >> 3)));
        if (there >= 0) row[1 + n] = f->own[512 * there + 64 * (i & 7) + 8 * (j & 7) + (k & 7)];
    }
}

/* The force of a sample that is read. */
static void touch_exact_force(const touch_coder *b, const touch_exact *f, const touch_symbols *own, float force[3],
                              touch_cursor *error) {
    int has_bits = 0;
    for (int n = 0; n < 3; n++) {
        if (f->book) force[n] = touch_level_at(f, own->symbol[0]) * f->vertices[3 * (uint64_t)own->symbol[1] + (uint64_t)n];
        else force[n] = touch_unordered(own->symbol[n]);
        has_bits |= touch_f32_bits(force[n]) != 0;
        touch_need_coded(b, error, (touch_f32_bits(force[n]) >> 23 & 255) != 255, "a force that is not finite");
    }
    touch_need_coded(b, error, has_bits, "a force of zero");
}

/* The samples of a brick, of which one is supported. */
static void touch_code_exact_brick(touch_exact_pass *p, touch_exact *f, uint64_t slot, touch_cursor *error) {
    int32_t at[3];
    int high[3], any = 0;
    touch_position(f->list.key[slot], at), touch_brick_samples(p->grid, at, high);
    int64_t slot_before = p->before ? touch_map_get(&p->map_before, f->list.key[slot]) : -1;
    for (int n = 0; n < 512; n++) {
        touch_symbols row[TOUCH_ROWS], *own = f->own + 512 * slot + (uint64_t)n;
        if (n >> 6 >= high[0] || (n >> 3 & 7) >= high[1] || (n & 7) >= high[2]) continue;
        touch_exact_rows(p, f, at, slot, slot_before, n, row);
        *own = touch_code_sample(p->coder, p->models, row, f->book ? 2 : 3, p->size,
                                 TOUCH_IS_WRITING(p->coder) ? *own : row[TOUCH_ROWS - 1], error);
        if (error->code) return;
        if (!own->is_supported) continue;
        any = 1;
        if (!TOUCH_IS_WRITING(p->coder)) touch_exact_force(p->coder, f, own, f->force + 3 * (own - f->own), error);
    }
    touch_need_coded(p->coder, error, any, "a brick without a force");
    touch_check(p->coder, error);
}

/* The samples of all bricks of `f->list`. */
static int touch_code_samples(touch_exact_pass *p, touch_exact *f, touch_arena *arena, touch_cursor *error) {
    if (!touch_map_make(&p->map, f->list.count, arena) ||
        !touch_map_make(&p->map_before, p->before ? p->before->list.count : 0, arena))
        return touch_fail(error, TOUCH_MEMORY, "no room for a frame");
    for (uint64_t i = 0; p->before && i < p->before->list.count; i++)
        touch_map_put(&p->map_before, p->before->list.key[i], (uint32_t)i);
    p->size[0] = f->book ? f->level_count : (uint64_t)1 << 32, p->size[2] = (uint64_t)1 << 32;
    p->size[1] = f->book ? f->vertex_count : (uint64_t)1 << 32;
    for (uint64_t i = 0; i < f->list.count; i++) {
        touch_map_put(&p->map, f->list.key[i], (uint32_t)i);
        touch_code_exact_brick(p, f, i, error);
        if (error->code) return 0;
    }
    return 1;
}

/* -- supports and whole numbers (docs/format/bits.md) ---------------------------------------------------------------- */

enum { TOUCH_SET_WINDOW = 12, TOUCH_SET_WINDOW_SAMPLES = 12 * 12 * 12 }; /* a brick, and two samples around it */

typedef struct { /* samples of bricks that are set, a byte each */
    touch_list list;
    uint8_t *is_set;
} touch_set;

typedef struct {
    touch_list_models list;
    struct {
        touch_context neighbours[4096]; /* the samples around that are coded already */
        touch_context before[128][8];   /* the same of the support before, all around */
    } context;
    struct {
        int64_t neighbours[8][2];
    } weight;
} touch_set_models;

static void touch_set_fresh(touch_set_models *m) {
    TOUCH_FRESH(m->list.context, m->list.weight);
    TOUCH_FRESH(m->context, m->weight);
}

/* Samples that a caller gives: bricks that ascend within the grid. */
static int touch_set_of(const touch_grid *grid, const touch_samples *samples, touch_set *set, touch_arena *arena,
                        touch_cursor *error) {
    uint64_t *key = (uint64_t *)touch_take(arena, samples->bricks, 8);
    set->is_set = (uint8_t *)touch_take(arena, 512 * samples->bricks, 1);
    if (!key || !set->is_set) return touch_fail(error, TOUCH_MEMORY, "no room for a support");
    for (uint64_t i = 0; i < samples->bricks; i++) {
        const int32_t *at = samples->brick + 3 * i;
        for (int n = 0; n < 3; n++)
            if (at[n] < 0 || at[n] > (int64_t)(grid->shape[n] - 1) >> 3)
                return touch_fail(error, TOUCH_ARGUMENT, "a brick beyond the grid");
        key[i] = touch_key(at[0], at[1], at[2]);
        if (i && key[i] <= key[i - 1]) return touch_fail(error, TOUCH_ARGUMENT, "bricks that do not ascend");
    }
    for (uint64_t i = 0; i < 512 * samples->bricks; i++) set->is_set[i] = samples->is_set[i] != 0;
    set->list.key = key, set->list.count = samples->bricks;
    return 1;
}

static int touch_set_index(int x, int y, int z) { return (x * TOUCH_SET_WINDOW + y) * TOUCH_SET_WINDOW + z; }

/* Samples of a support in and around a brick: 12 x 12 x 12, the first of the brick at (2, 2, 2). */
static void touch_fill_window(uint8_t window[TOUCH_SET_WINDOW_SAMPLES], const touch_set *set, const touch_map *map,
                              const int32_t at[3]) {
    static const int first[3] = {6, 0, 0}, begin[3] = {0, 2, 10}, length[3] = {2, 8, 2};
    for (int n = 0; n < 27; n++) {
        int part[3];
        part[0] = n / 9, part[1] = n / 3 % 3, part[2] = n % 3;
        uint64_t key = touch_key(at[0] + part[0] - 1, at[1] + part[1] - 1, at[2] + part[2] - 1);
        int64_t slot = set->list.count ? touch_map_get(map, key) : -1;
        const uint8_t *from = slot < 0 ? 0 : set->is_set + 512 * slot;
        for (int x = 0; x < length[part[0]]; x++)
            for (int y = 0; y < length[part[1]]; y++) {
                uint8_t *to = window + touch_set_index(begin[part[0]] + x, begin[part[1]] + y, begin[part[2]]);
                int row = (first[part[0]] + x) * 64 + (first[part[1]] + y) * 8 + first[part[2]];
                if (from) memcpy(to, from + row, (size_t)length[part[2]]);
                else memset(to, 0, (size_t)length[part[2]]);
            }
    }
}

typedef struct { /* what a brick of a support is coded by: samples around it, of the support so far and the one before */
    touch_map map, map_before;
    uint8_t window[TOUCH_SET_WINDOW_SAMPLES], before[TOUCH_SET_WINDOW_SAMPLES];
} touch_set_pass;

/* The samples of a brick of a support. Whether any is set. */
static int touch_code_set_brick(touch_coder *b, touch_set_models *m, touch_set_pass *p, uint8_t is_set[512],
                                const int high[3]) {
    enum { X = TOUCH_SET_WINDOW * TOUCH_SET_WINDOW, Y = TOUCH_SET_WINDOW, Z = 1 }; /* from sample to sample of the window */
    static const int near_steps[12] = {-X, -Y, -Z, -X + Z, -Y - Z, -Y + Z, -X - Y, -2 * X, -2 * Y, -X + Y, -X + Y + Z, -2 * Z};
    static const int before_steps[7] = {0, -Z, Z, -Y, Y, -X, X};
    int any = 0;
    for (int x = 0; x < high[0]; x++)
        for (int y = 0; y < high[1]; y++)
            for (int z = 0; z < high[2]; z++) {
                uint8_t *window = p->window + touch_set_index(x + 2, y + 2, z + 2), *own = is_set + 64 * x + 8 * y + z;
                const uint8_t *before = p->before + (window - p->window);
                uint32_t around = 0, was = 0;
                for (int n = 0; n < 12; n++) around |= (uint32_t)window[near_steps[n]] << n;
                for (int n = 0; n < 7; n++) was |= (uint32_t)before[before_steps[n]] << n;
                *own = (uint8_t)touch_mix2(b, m->context.neighbours + around, &m->context.before[was][around & 7],
                                           m->weight.neighbours[around & 7], TOUCH_CHOOSE(b, *own));
                *window = *own, any |= *own;
            }
    return any;
}

/* A support, given another one of the same grid; a writer passes it, a reader gets it. */
static int touch_code_set(touch_coder *b, touch_set_models *m, const touch_grid *grid, const touch_set *before,
                          touch_set *set, touch_arena *arena, touch_cursor *error) {
    if (!touch_code_list(b, &m->list, grid->shape, before->list, &set->list, arena, error)) return 0;
    if (!TOUCH_IS_WRITING(b)) set->is_set = (uint8_t *)touch_take_zero(arena, 512 * set->list.count, 1);
    uint64_t mark = arena->used;
    touch_set_pass *p = (touch_set_pass *)touch_take_zero(arena, 1, sizeof *p);
    if (!set->is_set || !p || !touch_map_make(&p->map, set->list.count, arena) ||
        !touch_map_make(&p->map_before, before->list.count, arena))
        return touch_fail(error, TOUCH_MEMORY, "no room for a support");
    for (uint64_t i = 0; i < before->list.count; i++) touch_map_put(&p->map_before, before->list.key[i], (uint32_t)i);
    for (uint64_t i = 0; i < set->list.count; i++) { /* `map` has the bricks so far */
        int32_t at[3];
        int high[3];
        touch_position(set->list.key[i], at), touch_brick_samples(grid, at, high);
        touch_fill_window(p->window, set, &p->map, at);
        if (before->list.count) touch_fill_window(p->before, before, &p->map_before, at);
        int is_any = touch_code_set_brick(b, m, p, set->is_set + 512 * i, high);
        touch_map_put(&p->map, set->list.key[i], (uint32_t)i);
        touch_need_coded(b, error, is_any, "a brick without samples");
        touch_check(b, error);
        if (error->code) return 0;
    }
    touch_check(b, error);
    arena->used = mark;
    return !error->code;
}

enum {
    TOUCH_NUMBER_BITS = 32,       /* bits of a number with contexts: significance, sign, 14 of the length, 16 second digits */
    TOUCH_SECOND_DIGITS = 16,     /* the first of the latter */
    TOUCH_MAX_LENGTH_BIT = 14,    /* longer numbers share the last of the length's contexts, */
    TOUCH_MAX_SECOND_DIGIT = 15,  /* and of the second digit's */
    TOUCH_MAX_NUMBER_LENGTH = 62, /* binary digits */
    TOUCH_SMALL = 2,              /* numbers before count up to here, */
    TOUCH_LAST_DIGITS = 10,       /* or by their binary digits: the last one up to 10, */
    TOUCH_BEFORE_DIGITS = 3       /* the one before up to 3 */
};

typedef struct { /* a list of whole numbers */
    struct {
        touch_context plain[TOUCH_NUMBER_BITS];
        touch_context recent[5 * 5 * 5][TOUCH_NUMBER_BITS]; /* the three numbers before, each limited to -2 to 2 */
        touch_context sizes[21 * 7][TOUCH_NUMBER_BITS];     /* signs and binary digits of the last two */
    } context;
    struct {
        int64_t bit[TOUCH_NUMBER_BITS][3];
    } weight;
    int64_t last[3];
} touch_numbers;

static void touch_numbers_fresh(touch_numbers *t) {
    TOUCH_FRESH(t->context, t->weight);
    t->last[0] = t->last[1] = t->last[2] = 0;
}

static int64_t touch_signed_digits(int64_t r, int max) { /* binary digits with the sign, around `max` */
    int64_t d = touch_min(touch_bit_length((uint64_t)touch_abs(r)), max);
    return r < 0 ? max - d : max + d;
}

static int touch_number_bit(touch_coder *b, touch_numbers *t, int64_t recent, int64_t sizes, int index, int bit) {
    return touch_mix3(b, t->context.plain + index, t->context.recent[recent] + index, t->context.sizes[sizes] + index,
                      t->weight.bit[index], bit);
}

/* A number: is it zero, its sign, its binary digits one by one, the second digit, the others as they are. */
static int64_t touch_code_number(touch_coder *b, touch_numbers *t, int64_t number) {
    int64_t last_digits = touch_signed_digits(t->last[0], TOUCH_LAST_DIGITS), recent = 0;
    int64_t sizes = 7 * last_digits + touch_signed_digits(t->last[1], TOUCH_BEFORE_DIGITS);
    int64_t target = touch_abs(number), size = 0;
    for (int n = 0; n < 3; n++) recent = 5 * recent + touch_clip_to(t->last[n], TOUCH_SMALL) + TOUCH_SMALL;
    if (touch_number_bit(b, t, recent, sizes, 0, number != 0)) {
        int is_negative = touch_number_bit(b, t, recent, sizes, 1, number < 0), length = 1;
        while (touch_number_bit(b, t, recent, sizes, 1 + (int)touch_min(length, TOUCH_MAX_LENGTH_BIT), target >> length > 0) &&
               length < TOUCH_MAX_NUMBER_LENGTH)
            length++;
        size = 1;
        if (length > 1) {
            int index = TOUCH_SECOND_DIGITS + (int)touch_min(length, TOUCH_MAX_SECOND_DIGIT);
            int second = touch_number_bit(b, t, recent, sizes, index, (int)(target >> (length - 2) & 1));
            size = (int64_t)(2 | second) << (length - 2);
            size += touch_even(b, length - 2, target);
        }
        size = is_negative ? -size : size;
    }
    t->last[2] = t->last[1], t->last[1] = t->last[0], t->last[0] = size;
    return size;
}

#endif
