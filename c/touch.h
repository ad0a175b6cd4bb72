/* touch.h: a decoder of .touch files (format 1) in one file of C99; docs/format tells every byte.

   In one source file:   #define TOUCH_IMPLEMENTATION
                         #include "touch.h"

   A file lies in memory, whole; nothing is copied out of it, and nothing is allocated but from memory that the caller
   gives (touch_arena). Any number of threads may each have a decoder. Whole numbers decode, with the same result
   everywhere; floating point enters in the last product, and in queries.

       touch_file file;  touch_decoder decoder;  touch_frame frame;  double newtons[3];
       touch_open(&file, bytes, size);                        // TOUCH_OK, or why not: file.error
       touch_start(&decoder, &file, touch_arena_of(memory, memory_size));
       touch_seek(&decoder, segment);                         // to its first frame
       touch_next(&decoder, &arena, &frame);                  // one frame after another, into an arena of its own
       touch_force(&frame, x, y, z, newtons);                 // metres, at any point: zero outside

   It decodes the coder `touch` (exact mode too), `objects` of such fields, and vibration; the coder `paper` it refuses.
   Shifts of negative numbers are to be arithmetic, as with every compiler there is. */
#ifndef TOUCH_H
#define TOUCH_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum {
    TOUCH_OK = 0,
    TOUCH_FOREIGN = 1,  /* it is something else */
    TOUCH_CUT = 2,      /* it ends too early */
    TOUCH_CORRUPT = 3,  /* its bytes contradict themselves */
    TOUCH_VERSION = 4,  /* of another version, or with a part that is not known here */
    TOUCH_MEMORY = 5,   /* the arena is too small */
    TOUCH_ARGUMENT = 6, /* the caller asks for what there is not */
    TOUCH_END = 7       /* no frame is left in the segment */
};

typedef struct {
    uint8_t *base;
    uint64_t size, used, peak;
} touch_arena;

typedef struct {
    uint32_t shape[3];
    double spacing_m[3], origin_m[3];
} touch_grid;

typedef struct {
    const uint8_t *bytes;
    uint64_t size;
} touch_bytes;

typedef struct { /* the records of a file, held against each other */
    const uint8_t *data;
    uint64_t size;
    touch_grid grid;
    double rate_hz, force_max_n, mapping_scale, mapping_offset_m[3], weber_fraction, force_threshold_n, friction,
        damping_n_s_per_m;
    uint32_t frame_count, segment_count, object_count;
    int device_type;                            /* 1 a point, 2 an array */
    touch_bytes axes, device_name, coder, parameters, index;
    const char *error;                          /* what is wrong, in words */
} touch_file;

typedef struct { /* forces of one lattice, sparse in bricks of 8 x 8 x 8 samples */
    touch_grid grid;
    uint32_t bricks, mask;
    const uint32_t *table; /* pairs: number of a brick + 1, place */
    const float *forces_n; /* [bricks][8][8][8][3] */
} touch_field;

typedef struct { /* a field, and how it lies in the scene */
    const touch_field *field;
    double rotation[9], position_m[3], velocity_m_s[3], spin_rad_s[3];
} touch_part;

typedef struct {
    uint32_t number, parts;
    int is_placed; /* parts have poses; else one part lies as its lattice says */
    const touch_part *part;
    double surface_damping_n_s_per_m, force_max_n;
    const touch_field *vibration; /* amplitude, N, frequency, Hz, and 0 at each sample; or NULL */
} touch_frame;

struct touch_state;
typedef struct {
    const touch_file *file;
    touch_arena arena;
    uint64_t kept; /* of the arena, that segments do not overwrite */
    struct touch_state *state;
    const char *error;
} touch_decoder;

touch_arena touch_arena_of(void *memory, uint64_t size);
int touch_open(touch_file *file, const void *bytes, uint64_t size);
/* Bytes that never are too few: for the arena of a decoder, and for that of a frame. They follow what the bytes of the
   file may tell at most. What one file takes in truth is `peak` of an arena it was decoded with, and for a decoder also
   what bodies keep at the end of its arena, by which touch_start makes `size` smaller. */
void touch_room(const touch_file *file, uint64_t *decoder, uint64_t *frame);
int touch_start(touch_decoder *decoder, const touch_file *file, touch_arena arena);
/* The segment that has a frame. */
uint32_t touch_segment_of(const touch_file *file, uint32_t frame);
int touch_seek(touch_decoder *decoder, uint32_t segment);
/* The next frame, which lives in `arena` until the caller empties it (arena.used = 0). Fields of bodies live in the arena
   of the decoder: those of rigid ones stay, those of bodies that deform die at the next touch_seek. */
int touch_next(touch_decoder *decoder, touch_arena *arena, touch_frame *frame);
void touch_force(const touch_frame *frame, double x, double y, double z, double newtons[3]);
/* dF_i/dx_j, N/m, row by row. */
void touch_gradient(const touch_frame *frame, double x, double y, double z, double n_per_m[9]);
/* Amplitude, N, and frequency, Hz, as docs/format/vibration.md has them at a point. */
void touch_vibration(const touch_frame *frame, double x, double y, double z, double both[2]);

#ifdef __cplusplus
}
#endif
#endif

#ifdef TOUCH_IMPLEMENTATION

#include <math.h>
#include <string.h>

typedef struct { /* bytes read from the first to the last; `code` is the first error, and all reads after it are 0 */
    const uint8_t *at, *end;
    int code;
    const char *what;
} touch_cursor;

#ifndef TOUCH_GUARD /* bytes behind a piece of an arena that nobody may touch: a fuzzer watches them */
#define TOUCH_GUARD(at, bytes, guard) ((void)(guard), 0)
#endif

/* -- small things ---------------------------------------------------------------------------------------------------- */

touch_arena touch_arena_of(void *memory, uint64_t size) {
    touch_arena arena;
    arena.base = (uint8_t *)memory, arena.size = size, arena.used = arena.peak = 0;
    return arena;
}

/* A piece of an arena for `count` things, or NULL; behind it may be a guard. */
static void *touch_piece(touch_arena *arena, uint64_t count, uint64_t each, uint64_t guard) {
    uint64_t base = (uint64_t)(uintptr_t)arena->base, begin = ((base + arena->used + 15) & ~(uint64_t)15) - base;
    if (begin > arena->size || (each && count > (arena->size - begin) / each)) return 0;
    arena->used = begin + count * each;
    arena->used += TOUCH_GUARD(arena->base + begin, count * each, guard);
    if (arena->used > arena->peak) arena->peak = arena->used;
    return arena->base + begin;
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

static touch_cursor touch_cursor_of(const uint8_t *bytes, uint64_t size) {
    touch_cursor c;
    c.at = bytes, c.end = bytes + size, c.code = TOUCH_OK, c.what = 0;
    return c;
}

static uint64_t touch_left(const touch_cursor *c) { return (uint64_t)(c->end - c->at); }

static const uint8_t *touch_skip(touch_cursor *c, uint64_t n) {
    const uint8_t *at = c->at;
    if (c->code || n > touch_left(c)) {
        touch_fail(c, TOUCH_CUT, "bytes that end too early");
        return at;
    }
    c->at += n;
    return at;
}

static uint64_t touch_u(touch_cursor *c, int bytes) {
    const uint8_t *at = touch_skip(c, (uint64_t)bytes);
    uint64_t out = 0;
    if (c->code) return 0;
    while (bytes--) out = out << 8 | at[bytes];
    return out;
}

static double touch_f64(touch_cursor *c) {
    uint64_t bits = touch_u(c, 8);
    double out;
    memcpy(&out, &bits, 8);
    return out;
}

static float touch_f32_of(uint32_t bits) {
    float out;
    memcpy(&out, &bits, 4);
    return out;
}

static uint64_t touch_varint(touch_cursor *c, uint64_t least, uint64_t limit) {
    uint64_t value = 0;
    for (int place = 0; place < 8; place++) {
        uint64_t byte = touch_u(c, 1);
        value |= (byte & 127) << (7 * place);
        if (byte < 128) {
            touch_need(c, byte || !place, "a varint that is not in its shortest form");
            touch_need(c, least <= value && value < limit, "a number out of its bounds");
            return c->code ? 0 : value;
        }
    }
    touch_fail(c, TOUCH_CORRUPT, "a varint of more than 8 bytes");
    return 0;
}

static touch_cursor touch_chunk(touch_cursor *c) {
    uint64_t n = touch_varint(c, 0, (uint64_t)1 << 56);
    const uint8_t *at = touch_skip(c, n);
    return c->code ? touch_cursor_of(at, 0) : touch_cursor_of(at, n);
}

static int64_t touch_clip(int64_t n, int64_t least, int64_t most) { return n < least ? least : n > most ? most : n; }

/* n / d rounded down; d is above 0. */
static int64_t touch_div(int64_t n, int64_t d) { return n / d - (n % d < 0); }

static int touch_bits_of(uint64_t n) {
    int bits = 0;
    while (n) n >>= 1, bits++;
    return bits;
}

/* The largest number whose square is at most n, below 2^52: the root in floating point is put right. */
static int64_t touch_root(int64_t n) {
    int64_t r = (int64_t)sqrt((double)n);
    while (r * r > n) r--;
    while ((r + 1) * (r + 1) <= n) r++;
    return r;
}

static uint32_t touch_crc(uint32_t crc, const uint8_t *at, uint64_t n) { /* zlib's; a table of 16 fits on the stack */
    uint32_t table[16];
    for (uint32_t i = 0; i < 16; i++) {
        uint32_t v = i;
        for (int k = 0; k < 4; k++) v = v & 1 ? 0xEDB88320u ^ v >> 1 : v >> 1;
        table[i] = v;
    }
    crc = ~crc;
    while (n--) {
        crc ^= *at++;
        crc = crc >> 4 ^ table[crc & 15];
        crc = crc >> 4 ^ table[crc & 15];
    }
    return ~crc;
}

static uint64_t touch_brick_count(const touch_grid *g) {
    return (uint64_t)((g->shape[0] + 7) >> 3) * ((g->shape[1] + 7) >> 3) * ((g->shape[2] + 7) >> 3);
}

/* -- the container --------------------------------------------------------------------------------------------------- */

enum { TOUCH_MAGIC_BYTES = 10, TOUCH_OPENING = 14, TOUCH_TEND_BYTES = 40 };

typedef struct {
    uint32_t tag, flags, crc;
    uint64_t offset, length; /* of the payload */
    touch_cursor payload;
} touch_record;

#define TOUCH_TAG(a, b, c, d) ((uint32_t)(a) | (uint32_t)(b) << 8 | (uint32_t)(c) << 16 | (uint32_t)(d) << 24)
#define TOUCH_HEAD TOUCH_TAG('H', 'E', 'A', 'D')
#define TOUCH_PROV TOUCH_TAG('P', 'R', 'O', 'V')
#define TOUCH_OBJT TOUCH_TAG('O', 'B', 'J', 'T')
#define TOUCH_VIBR TOUCH_TAG('V', 'I', 'B', 'R')
#define TOUCH_SEGM TOUCH_TAG('S', 'E', 'G', 'M')
#define TOUCH_INDX TOUCH_TAG('I', 'N', 'D', 'X')
#define TOUCH_TEND TOUCH_TAG('T', 'E', 'N', 'D')

static int touch_is_known(uint32_t tag) {
    return tag == TOUCH_HEAD || tag == TOUCH_PROV || tag == TOUCH_OBJT || tag == TOUCH_VIBR || tag == TOUCH_SEGM ||
           tag == TOUCH_INDX || tag == TOUCH_TEND;
}

/* The record at the cursor; its CRC-32 is checked where asked. */
static touch_record touch_read_record(touch_cursor *c, const uint8_t *data, int is_checked) {
    touch_record r;
    r.offset = (uint64_t)(c->at - data);
    r.tag = (uint32_t)touch_u(c, 4), r.flags = (uint32_t)touch_u(c, 4), r.length = touch_u(c, 8);
    for (int i = 0; i < 4 && !c->code; i++) {
        uint32_t letter = r.tag >> (8 * i) & 255;
        touch_need(c, (letter >= 'A' && letter <= 'Z') || (letter >= '0' && letter <= '9'), "no record where one is due");
    }
    touch_need(c, r.flags <= 1, "flags of a record that there are not");
    r.payload = touch_cursor_of(touch_skip(c, r.length), 0);
    if (!c->code) r.payload.end = r.payload.at + r.length;
    r.crc = (uint32_t)touch_u(c, 4);
    if (is_checked && !c->code) {
        uint32_t crc = touch_crc(0, data + r.offset, 16 + r.length);
#ifndef FUZZING_BUILD_MODE_UNSAFE_FOR_PRODUCTION
        touch_need(c, crc == r.crc, "a CRC-32 that does not hold");
#else
        (void)crc;
#endif
    }
    if (!c->code && touch_is_known(r.tag))
        touch_need(c, r.flags == (r.tag == TOUCH_PROV || r.tag == TOUCH_VIBR ? 0u : 1u), "the flags of a record");
    if (!c->code && r.flags && !touch_is_known(r.tag)) touch_fail(c, TOUCH_VERSION, "a required record that is not known");
    return r;
}

/* Within a payload, to end early is to contradict oneself: its length was checked. */
static void touch_settle(touch_cursor *c) {
    if (c->code == TOUCH_CUT) c->code = TOUCH_CORRUPT;
}

static double touch_bounded(touch_cursor *c, double least, double most) {
    double value = touch_f64(c);
    touch_need(c, least <= value && value <= most, "a number out of its bounds");
    return value;
}

static int touch_is_utf8(const uint8_t *s, uint64_t n, int allows_lines) {
    uint64_t i = 0;
    while (i < n) {
        uint32_t a = s[i++];
        if (a < 0x80) {
            if ((a < 0x20 && !(allows_lines && (a == 9 || a == 10))) || a == 0x7f) return 0;
            continue;
        }
        uint32_t more = a >= 0xf0 ? 3u : a >= 0xe0 ? 2u : 1u;
        if (a < 0xc2 || a > 0xf4 || n - i < more) return 0;
        uint32_t code = a & (0x3fu >> more);
        for (uint32_t k = 0; k < more; k++, i++) {
            if ((s[i] & 0xc0) != 0x80) return 0;
            code = code << 6 | (s[i] & 0x3fu);
        }
        if ((more == 2 && code < 0x800) || (more == 3 && (code < 0x10000 || code > 0x10ffff))) return 0;
        if ((code >= 0xd800 && code < 0xe000) || (code >= 0x80 && code < 0xa0)) return 0;
    }
    return 1;
}

static touch_bytes touch_text(touch_cursor *c, uint64_t least, uint64_t most, int allows_lines) {
    touch_bytes out;
    out.size = touch_u(c, 2);
    touch_need(c, c->code || (least <= out.size && out.size <= most), "a text that is too long, or empty");
    out.bytes = touch_skip(c, out.size);
    if (c->code) out.size = 0;
    touch_need(c, touch_is_utf8(out.bytes, out.size, allows_lines), "a text that is not UTF-8, or a control character");
    return out;
}

static touch_bytes touch_name(touch_cursor *c) {
    touch_bytes out = touch_text(c, 1, 32, 0);
    for (uint64_t i = 0; i < out.size; i++) {
        uint8_t a = out.bytes[i];
        int is_small = a >= 'a' && a <= 'z', is_other = (a >= '0' && a <= '9') || a == '.' || a == '_' || a == '-';
        touch_need(c, is_small || (i && is_other), "the name of a coder");
    }
    return out;
}

static touch_bytes touch_field_bytes(touch_cursor *c, uint64_t most) {
    touch_bytes out;
    out.size = touch_u(c, 4);
    touch_need(c, out.size <= most, "too many bytes in a field");
    out.bytes = touch_skip(c, out.size);
    if (c->code) out.size = 0;
    return out;
}

static touch_grid touch_read_grid(touch_cursor *c) {
    touch_grid g;
    for (int i = 0; i < 3; i++) {
        g.shape[i] = (uint32_t)touch_u(c, 4);
        touch_need(c, g.shape[i] >= 1 && g.shape[i] <= 1u << 20, "the samples of a lattice");
    }
    for (int i = 0; i < 3; i++) g.spacing_m[i] = touch_bounded(c, 1e-9, 1e6);
    for (int i = 0; i < 3; i++) g.origin_m[i] = touch_bounded(c, -1e9, 1e9);
    touch_need(c, touch_brick_count(&g) <= (uint64_t)1 << 27, "a lattice of too many samples");
    return g;
}

static void touch_read_head(touch_file *f, touch_cursor *c) {
    f->grid = touch_read_grid(c);
    f->rate_hz = touch_bounded(c, 1e-6, 1e6);
    f->frame_count = (uint32_t)touch_u(c, 4);
    touch_need(c, f->frame_count >= 1 && f->frame_count <= 0x7fffffff, "the number of frames");
    f->axes = touch_text(c, 0, 256, 0), f->device_name = touch_text(c, 0, 256, 0);
    f->device_type = (int)touch_u(c, 1);
    touch_need(c, f->device_type == 1 || f->device_type == 2, "the type of the device");
    f->force_max_n = touch_bounded(c, 1e-30, 1e30), f->mapping_scale = touch_bounded(c, 1e-30, 1e30);
    for (uint64_t i = 0; i < 3; i++) f->mapping_offset_m[i] = touch_bounded(c, -1e9, 1e9);
    f->weber_fraction = touch_bounded(c, 0, 1), f->force_threshold_n = touch_bounded(c, 0, 1e30);
    f->friction = touch_bounded(c, 0, 1e30), f->damping_n_s_per_m = touch_bounded(c, 0, 1e30);
    uint64_t tags = touch_u(c, 2);
    touch_need(c, tags <= 16, "too many tags");
    for (uint64_t i = 0; i < tags && !c->code; i++) touch_text(c, 0, 64, 0);
    f->coder = touch_name(c), f->parameters = touch_field_bytes(c, 1u << 16);
    touch_need(c, c->at == c->end, "bytes behind the last field of HEAD");
    touch_settle(c);
}

static void touch_read_story(touch_cursor *c) { /* PROV */
    touch_bytes keys[64];
    uint64_t count = touch_u(c, 2);
    touch_need(c, count <= 64, "too many pairs in PROV");
    for (uint64_t i = 0; i < count && !c->code; i++) {
        keys[i] = touch_text(c, 1, 64, 0);
        touch_text(c, 0, 4096, 1);
        for (uint64_t j = 0; j < i && !c->code; j++)
            touch_need(c, keys[i].size != keys[j].size || memcmp(keys[i].bytes, keys[j].bytes, (size_t)keys[i].size),
                       "a key twice");
    }
    touch_need(c, c->at == c->end, "bytes behind the last pair of PROV");
    touch_settle(c);
}

typedef struct {
    touch_bytes field_coder, parameters, steps;
    touch_grid grid;
    int is_deforming;
    touch_cursor field;
} touch_object;

static touch_object touch_read_object(touch_cursor *c) {
    touch_object o;
    touch_text(c, 0, 256, 0);
    o.grid = touch_read_grid(c);
    o.is_deforming = (int)touch_u(c, 1);
    touch_need(c, o.is_deforming <= 1, "whether a body deforms");
    o.field_coder = touch_name(c), o.parameters = touch_field_bytes(c, 1u << 16), o.steps = touch_field_bytes(c, 64);
    touch_settle(c);
    o.field = *c;
    return o;
}

static int touch_is(touch_bytes name, const char *word) {
    return name.size == strlen(word) && !memcmp(name.bytes, word, (size_t)name.size);
}

typedef struct {
    uint32_t first, count, crc;
    uint64_t offset, length;
} touch_entry;

static touch_entry touch_entry_at(const touch_file *f, uint32_t n) {
    touch_cursor c = touch_cursor_of(f->index.bytes + 26 * (uint64_t)n, 26);
    touch_entry e;
    e.first = (uint32_t)touch_u(&c, 4), e.count = (uint32_t)touch_u(&c, 2);
    e.offset = touch_u(&c, 8), e.length = touch_u(&c, 8), e.crc = (uint32_t)touch_u(&c, 4);
    return e;
}

uint32_t touch_segment_of(const touch_file *file, uint32_t frame) {
    uint32_t low = 0, high = file->segment_count;
    while (high - low > 1) {
        uint32_t middle = low + (high - low) / 2;
        if (touch_entry_at(file, middle).first <= frame) low = middle;
        else high = middle;
    }
    return low;
}

static int touch_check_opening(touch_cursor *c, const uint8_t *data, uint64_t size) {
    static const uint8_t magic[10] = {0x89, 'T', 'O', 'U', 'C', 'H', '\r', '\n', 0x1a, '\n'};
    uint64_t n = size < 10 ? size : 10;
    int is_magic = !memcmp(data, magic, (size_t)n);
    for (uint64_t i = 1; i <= 3 && !is_magic; i++)
        if (i + 5 <= n && !memcmp(data + i, "TOUCH", 5))
            return touch_fail(c, TOUCH_CORRUPT, "a file that was transferred as text");
    if (!size || !is_magic) return touch_fail(c, TOUCH_FOREIGN, "no .touch file");
    if (size < TOUCH_OPENING) return touch_fail(c, TOUCH_CUT, "a file that ends in its opening");
    uint64_t major = (uint64_t)(data[10] | data[11] << 8);
    if (!major) return touch_fail(c, TOUCH_VERSION, "made by a version before 1.0: encode it again");
    if (major != 1) return touch_fail(c, TOUCH_VERSION, "a version that is not known");
    return 1;
}

/* All records in their order; what each tells is held against the others. */
static void touch_walk(touch_file *f, touch_cursor *c) {
    uint32_t previous = 0, stories = 0, segments = 0, first = 0, vibration[2] = {0, 0}, chain;
    int is_behind_segment = 0, has_vibration = 0, is_chained = 0;
    uint64_t index_offset = 0;
    chain = touch_crc(0, f->data, TOUCH_OPENING);
    for (;;) {
        touch_record r = touch_read_record(c, f->data, 1);
        uint8_t crc[4];
        if (c->code) return;
        if (!touch_is_known(r.tag)) continue;
        crc[0] = (uint8_t)r.crc, crc[1] = (uint8_t)(r.crc >> 8), crc[2] = (uint8_t)(r.crc >> 16);
        crc[3] = (uint8_t)(r.crc >> 24);
        if (!touch_need(c, (r.tag == TOUCH_HEAD) == !previous && (previous != TOUCH_INDX || r.tag == TOUCH_TEND),
                        "records in another order"))
            return;
        if (r.tag == TOUCH_HEAD) {
            touch_need(c, r.offset == TOUCH_OPENING, "a record before HEAD");
            touch_read_head(f, &r.payload);
        } else if (r.tag == TOUCH_PROV) {
            touch_need(c, !stories++ && !is_behind_segment, "PROV twice, or behind a segment");
            touch_read_story(&r.payload);
        } else if (r.tag == TOUCH_OBJT) {
            touch_need(c, !is_behind_segment && f->object_count++ < 4096, "OBJT behind a segment, or too many");
            touch_read_object(&r.payload);
        } else if (r.tag == TOUCH_VIBR || r.tag == TOUCH_SEGM) {
            uint32_t own[2];
            own[0] = (uint32_t)touch_u(&r.payload, 4), own[1] = (uint32_t)touch_u(&r.payload, 2);
            touch_settle(&r.payload);
            touch_need(c, r.payload.code || (own[0] == first && own[1] && own[1] <= f->frame_count - first),
                       "the frames of a segment");
            if (r.tag == TOUCH_VIBR) {
                touch_need(c, !has_vibration, "VIBR twice");
                has_vibration = 1, vibration[0] = own[0], vibration[1] = own[1];
            } else {
                touch_need(c, !has_vibration || (vibration[0] == own[0] && vibration[1] == own[1]),
                           "a VIBR of other frames than its segment");
                has_vibration = 0, is_behind_segment = 1, first += own[1], segments++;
            }
        } else if (r.tag == TOUCH_INDX) {
            uint64_t count = touch_u(&r.payload, 4);
            touch_settle(&r.payload);
            touch_need(c, previous == TOUCH_SEGM && count == segments && touch_left(&r.payload) == 26 * count &&
                              first == f->frame_count, "INDX that does not fit to the segments");
            f->index.bytes = r.payload.at, f->index.size = touch_left(&r.payload), f->segment_count = segments;
            index_offset = r.offset;
        } else {
            uint64_t told[3];
            touch_need(c, previous == TOUCH_INDX && r.length == 20, "TEND in another place");
            told[0] = touch_u(&r.payload, 8), told[1] = touch_u(&r.payload, 8), told[2] = touch_u(&r.payload, 4);
#ifdef FUZZING_BUILD_MODE_UNSAFE_FOR_PRODUCTION
            chain = (uint32_t)told[2];
#endif
            touch_need(c, told[0] == index_offset && told[1] == f->size && told[2] == chain && c->at == c->end,
                       "HEAD, INDX or TEND of another file");
            return;
        }
        if (r.payload.code) touch_fail(c, r.payload.code, r.payload.what);
        is_chained = r.tag == TOUCH_HEAD || r.tag == TOUCH_OBJT || r.tag == TOUCH_INDX;
        if (is_chained) chain = touch_crc(chain, crc, 4);
        previous = r.tag;
        if (c->code) return;
    }
}

/* Entries of INDX are those of the records, in their order. */
static void touch_check_index(const touch_file *f, touch_cursor *c) {
    touch_cursor at = touch_cursor_of(f->data + TOUCH_OPENING, f->size - TOUCH_OPENING);
    uint32_t n = 0;
    while (n < f->segment_count && !c->code) {
        touch_record r = touch_read_record(&at, f->data, 0);
        if (r.tag == TOUCH_SEGM) {
            touch_entry e = touch_entry_at(f, n++);
            touch_need(c, e.offset == r.offset && e.length == r.length + 20 && e.crc == r.crc &&
                              e.first == touch_u(&r.payload, 4) && e.count == touch_u(&r.payload, 2), "an entry of INDX");
        }
    }
}

int touch_open(touch_file *file, const void *bytes, uint64_t size) {
    memset(file, 0, sizeof *file);
    file->data = (const uint8_t *)bytes, file->size = size;
    touch_cursor c = touch_cursor_of(file->data, size);
    if (touch_check_opening(&c, file->data, size)) {
        touch_skip(&c, TOUCH_OPENING);
        touch_walk(file, &c);
        if (!c.code) touch_check_index(file, &c);
        if (!c.code)
            touch_need(&c, touch_is(file->coder, "objects") == (file->object_count > 0), "objects, or none where there are");
        if (!c.code && !touch_is(file->coder, "objects") && !touch_is(file->coder, "touch"))
            touch_fail(&c, TOUCH_VERSION, "a coder that is not known here");
    }
    file->error = c.code ? c.what : "";
    return c.code;
}

/* -- bits: the arithmetic code (docs/format/bits.md) ----------------------------------------------------------------- */

enum { TOUCH_REACH = 3071, TOUCH_FRESH = 1 << 21, TOUCH_WEIGHT = 14000 };

typedef struct {
    int32_t chance, seen;
} touch_context;

typedef struct { /* the logistic function, its inverse, and how fast a context learns */
    uint16_t squash[2 * TOUCH_REACH + 1];
    int16_t stretch[4096];
    int32_t rate[256];
} touch_tables;

typedef struct {
    const uint8_t *data;
    uint64_t size, place, x, range;
    const touch_tables *tables;
} touch_code;

static void touch_fill(touch_tables *t) {
    uint64_t q = (uint64_t)1 << 31;
    int n = 0;
    for (int64_t i = 0; i <= TOUCH_REACH; i++) {
        uint64_t whole = ((uint64_t)1 << 31) + q, s = (((uint64_t)1 << 47) + (whole >> 1)) / whole;
        t->squash[TOUCH_REACH + i] = (uint16_t)(s > 65535 ? 65535 : s);
        t->squash[TOUCH_REACH - i] = (uint16_t)(65536 - s);
        q = q * 2139111403u >> 31;
    }
    for (int64_t i = 0; i < 4096; i++) {
        while (t->squash[n] < 16 * i + 8) n++;
        t->stretch[i] = (int16_t)(n - TOUCH_REACH);
    }
    for (int64_t i = 0; i <= 2 * TOUCH_REACH; i++) t->squash[i] = (uint16_t)touch_clip(t->squash[i], 4, 65532);
    for (int64_t i = 0; i < 256; i++) t->rate[i] = (int32_t)((1 << 20) / (2 * i + 3));
}

static touch_code touch_code_of(const touch_cursor *c, const touch_tables *tables) {
    touch_code b;
    b.data = c->at, b.size = touch_left(c), b.place = 6, b.range = (uint64_t)1 << 48, b.x = 0, b.tables = tables;
    for (int i = 0; i < 6; i++) b.x = b.x << 8 | ((uint64_t)i < b.size ? b.data[i] : 0);
    return b;
}

static int touch_narrow(touch_code *b, uint32_t p) {
    uint64_t bound = (b->range >> 16) * p;
    int bit = b->x < bound;
    if (bit) b->range = bound;
    else b->x -= bound, b->range -= bound;
    if (b->range < (uint64_t)1 << 32) {
        uint32_t high = b->place < b->size ? b->data[b->place] : 0;
        uint32_t low = b->place + 1 < b->size ? b->data[b->place + 1] : 0;
        b->x = b->x << 16 | high << 8 | low, b->range <<= 16, b->place += 2;
    }
    return bit;
}

static void touch_learn(touch_context *c, int bit, const touch_tables *t) {
    c->chance += (int32_t)(((int64_t)(bit ? 4194303 - c->chance : -c->chance) * t->rate[c->seen]) >> 19);
    c->seen += c->seen < 255;
}

static int touch_bit(touch_code *b, touch_context *c) {
    int bit = touch_narrow(b, (uint32_t)touch_clip(c->chance >> 6, 4, 65532));
    touch_learn(c, bit, b->tables);
    return bit;
}

static int touch_mix(touch_code *b, touch_context *const *c, int64_t *weights, int count) {
    const touch_tables *t = b->tables;
    int64_t sum = 0;
    int32_t logit[4];
    for (int n = 0; n < count; n++) logit[n] = t->stretch[c[n]->chance >> 10], sum += logit[n] * weights[n];
    int32_t p = t->squash[touch_clip(sum >> 16, -TOUCH_REACH, TOUCH_REACH) + TOUCH_REACH];
    int bit = touch_narrow(b, (uint32_t)p);
    int64_t miss = (bit ? 65536 : 0) - p;
    for (int n = 0; n < count; n++) weights[n] += (logit[n] * miss + 8192) >> 14, touch_learn(c[n], bit, t);
    return bit;
}

static int touch_mix2(touch_code *b, touch_context *c0, touch_context *c1, int64_t *w) {
    touch_context *c[2];
    c[0] = c0, c[1] = c1;
    return touch_mix(b, c, w, 2);
}

static int touch_mix3(touch_code *b, touch_context *c0, touch_context *c1, touch_context *c2, int64_t *w) {
    touch_context *c[3];
    c[0] = c0, c[1] = c1, c[2] = c2;
    return touch_mix(b, c, w, 3);
}

static int64_t touch_even(touch_code *b, int count) {
    int64_t out = 0;
    while (count-- > 0) out = out << 1 | touch_narrow(b, 32768);
    return out;
}

static int64_t touch_gamma(touch_code *b, int most) { /* above 0 */
    int digits = 0;
    while (digits < most && touch_narrow(b, 32768)) digits++;
    return (int64_t)1 << digits | touch_even(b, digits);
}

static void touch_check(const touch_code *b, touch_cursor *c) {
    if (b->place > b->size + 6) touch_fail(c, TOUCH_CUT, "a code that ends too early");
}

/* A code of `bricks` bricks ends where its bytes do; so many zeros may follow as those are worth. */
static void touch_close(const touch_code *b, uint64_t bricks, touch_cursor *c) {
    uint64_t most = b->place;
    touch_check(b, c);
    if (bricks > 64 && (bricks - 64 + 15) / 16 > most) most = (bricks - 64 + 15) / 16;
    touch_need(c, b->size <= most, "bytes behind a code");
    for (uint64_t i = b->place; i < b->size && !c->code; i++) touch_need(c, !b->data[i], "bytes behind a code");
}

static void touch_fresh(touch_context *c, uint64_t contexts, int64_t *w, uint64_t weights) {
    for (uint64_t i = 0; i < contexts; i++) c[i].chance = TOUCH_FRESH, c[i].seen = 0;
    for (uint64_t i = 0; i < weights; i++) w[i] = TOUCH_WEIGHT;
}

/* -- maps from keys to places, and order ----------------------------------------------------------------------------- */

typedef struct { /* open addressing; key 0 is none */
    uint64_t *key;
    uint32_t *place, mask;
} touch_map;

static int touch_map_make(touch_map *m, uint64_t count, touch_arena *arena) {
    uint64_t size = 16;
    while (size < 2 * count + 2) size *= 2;
    m->key = (uint64_t *)touch_take_zero(arena, size, 8), m->place = (uint32_t *)touch_take(arena, size, 4);
    m->mask = (uint32_t)(size - 1);
    return m->key && m->place;
}

static uint32_t touch_hash(uint64_t key, uint32_t mask) {
    return (uint32_t)((key * 0x9E3779B97F4A7C15u) >> 32) & mask;
}

static void touch_map_put(touch_map *m, uint64_t key, uint32_t place) {
    uint32_t at = touch_hash(++key, m->mask);
    while (m->key[at] && m->key[at] != key) at = (at + 1) & m->mask;
    m->key[at] = key, m->place[at] = place;
}

static int64_t touch_map_get(const touch_map *m, uint64_t key) { /* -1: none */
    uint32_t at = touch_hash(++key, m->mask);
    while (m->key[at] && m->key[at] != key) at = (at + 1) & m->mask;
    return m->key[at] ? (int64_t)m->place[at] : -1;
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

/* Places of bricks, nodes or boxes as keys, in raster order; 21 bits an axis, shifted so that -1 and -2 are there. */
static uint64_t touch_key(int64_t x, int64_t y, int64_t z) {
    return (uint64_t)(x + 8) << 42 | (uint64_t)(y + 8) << 21 | (uint64_t)(z + 8);
}

static void touch_place(uint64_t key, int32_t out[3]) {
    out[0] = (int32_t)(key >> 42) - 8, out[1] = (int32_t)(key >> 21 & 0x1fffff) - 8;
    out[2] = (int32_t)(key & 0x1fffff) - 8;
}

/* -- lists of bricks ------------------------------------------------------------------------------------------------- */

enum { TOUCH_LIST_CONTEXTS = 1262, TOUCH_LIST_WEIGHTS = 8 };

typedef struct {
    uint64_t *key; /* ascending */
    uint64_t count;
} touch_list;

/* One level of the boxes: the states of all children, told in raster order (S of bits.md). */
static int touch_level(touch_code *b, touch_context *c, int64_t *w, const touch_map *known, const touch_map *children,
                       const uint64_t *key, const uint32_t *parent, uint8_t *state, uint8_t *left, uint8_t *found,
                       uint64_t count) {
    static const int8_t step[12][3] = {{-1, 0, 0}, {0, -1, 0}, {0, 0, -1}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1},
                                       {-1, -1, 0}, {-1, 1, 0}, {-1, 0, -1}, {-1, 0, 1}, {0, -1, -1}, {0, -1, 1}};
    for (uint64_t i = 0; i < count; i++) {
        int32_t at[3];
        int old = touch_map_get(known, key[i]) >= 0;
        uint32_t faces = 0, edges = 0, changed = 0;
        touch_place(key[i], at);
        for (int n = 0; n < 12; n++) {
            uint64_t beside = touch_key(at[0] + step[n][0], at[1] + step[n][1], at[2] + step[n][2]);
            int64_t there = touch_map_get(children, beside);
            uint32_t s = there < 0 ? 0 : state[there];
            if (n < 6) faces = 3 * faces + (old ? 0 : s);
            if (n < 3) changed = 2 * changed + (s ^ (there >= 0 && touch_map_get(known, beside) >= 0 ? 1u : 0u));
            if (n < 3 || n > 5) edges = 2 * edges + s;
        }
        left[parent[i]]--;
        int bit = 1;
        if (found[parent[i]] || left[parent[i]]) {
            touch_context *chosen[4];
            chosen[0] = c + 1 + faces, chosen[1] = c + 730 + edges, chosen[2] = c + 1242 + 8 * old + changed;
            chosen[3] = c + 1258 + 2 * old + (found[parent[i]] > 0);
            bit = touch_mix(b, chosen, w + 4 * old, 4);
        }
        state[i] = (uint8_t)bit, found[parent[i]] = (uint8_t)(found[parent[i]] + bit);
    }
    return 1;
}

/* The bricks that a code lists, into `arena`; `before` is a list that is known, or empty. */
static int touch_read_list(touch_code *b, touch_context *c, int64_t *w, const uint32_t shape[3], touch_list before,
                           touch_list *out, touch_arena *arena, touch_cursor *error) {
    uint64_t most = 64 + 16 * b->size, count = 0, i, mark;
    uint32_t longest = 0;
    for (int n = 0; n < 3; n++) longest = shape[n] > longest ? shape[n] : longest;
    uint64_t total = (uint64_t)((shape[0] + 7) >> 3) * ((shape[1] + 7) >> 3) * ((shape[2] + 7) >> 3);
    uint64_t capacity = total < most ? total : most;
    out->key = (uint64_t *)touch_take(arena, capacity + 1, 8), out->count = 0;
    if (!out->key) return touch_fail(error, TOUCH_MEMORY, "no room for a list of bricks");
    if (touch_bit(b, c)) out->key[count++] = touch_key(0, 0, 0);
    for (int level = touch_bits_of((longest - 1) >> 3) - 1; level >= 0; level--) {
        uint64_t family = 0, kept = 0, bound = 8 * count;
        uint64_t *key;
        uint32_t *parent;
        uint8_t *state, *left;
        touch_map known, children;
        mark = arena->used;
        key = (uint64_t *)touch_take(arena, bound, 8), parent = (uint32_t *)touch_take(arena, bound, 4);
        state = (uint8_t *)touch_take(arena, bound, 1), left = (uint8_t *)touch_take_zero(arena, count, 1);
        uint8_t *found = (uint8_t *)touch_take_zero(arena, count, 1);
        if (!key || !parent || !state || !left || !found || !touch_map_make(&known, before.count, arena))
            return touch_fail(error, TOUCH_MEMORY, "no room for a list of bricks");
        for (i = 0; i < before.count; i++) {
            int32_t at[3];
            touch_place(before.key[i], at);
            touch_map_put(&known, touch_key(at[0] >> level, at[1] >> level, at[2] >> level), 1);
        }
        for (i = 0; i < count; i++) {
            int32_t at[3];
            touch_place(out->key[i], at);
            for (int32_t d = 0; d < 8; d++) {
                int64_t x = 2 * at[0] + (d >> 2), y = 2 * at[1] + (d >> 1 & 1), z = 2 * at[2] + (d & 1);
                if (x > (int64_t)(shape[0] - 1) >> (level + 3) || y > (int64_t)(shape[1] - 1) >> (level + 3) ||
                    z > (int64_t)(shape[2] - 1) >> (level + 3))
                    continue;
                key[family] = touch_key(x, y, z), parent[family++] = (uint32_t)i, left[i]++;
            }
        }
        touch_sort(key, parent, family);
        if (!touch_map_make(&children, family, arena)) return touch_fail(error, TOUCH_MEMORY, "no room for boxes");
        for (i = 0; i < family; i++) state[i] = 2, touch_map_put(&children, key[i], (uint32_t)i);
        touch_level(b, c, w, &known, &children, key, parent, state, left, found, family);
        for (i = 0; i < family; i++) kept += state[i] == 1;
        if (kept > most) return touch_fail(error, TOUCH_CORRUPT, "more bricks than the bytes may list");
        for (i = count = 0; i < family; i++)
            if (state[i] == 1) out->key[count++] = key[i];
        arena->used = mark;
    }
    out->count = count;
    return 1;
}

/* -- coder touch: a frame (docs/format/touch.md) --------------------------------------------------------------------- */

typedef struct {
    int32_t v[3];
} touch_vector;

typedef struct { /* vectors in units, 512 a brick; (0, 0, 0): none there */
    touch_list list;
    touch_vector *v;
} touch_units;

typedef struct { /* a voxel that is decoded, in the scan */
    int32_t v[3], length, ahead[3];
    uint8_t along, across;
} touch_cell;

enum {
    TOUCH_BRICK = 0, TOUCH_BLOCK = 7, TOUCH_HELD = 31, TOUCH_STILL = TOUCH_HELD + 2 * 16384 + 4096,
    TOUCH_ZERO = TOUCH_STILL + 512 + 512 + 4096, TOUCH_SIGN = TOUCH_ZERO + 3 * 1088, TOUCH_SIZE = TOUCH_SIGN + 3 * 576,
    TOUCH_PASS_LIST = TOUCH_SIZE + 3 * 1152, TOUCH_PASS_CONTEXTS = TOUCH_PASS_LIST + TOUCH_LIST_CONTEXTS,
    TOUCH_W_STILL = 3 * 32, TOUCH_W_ZERO = TOUCH_W_STILL + 3 * 16, TOUCH_W_SIGN = TOUCH_W_ZERO + 9 * 24,
    TOUCH_W_SIZE = TOUCH_W_SIGN + 9 * 3, TOUCH_W_LIST = TOUCH_W_SIZE + 6 * 48,
    TOUCH_PASS_WEIGHTS = TOUCH_W_LIST + TOUCH_LIST_WEIGHTS,
    TOUCH_FEATURES = 13, TOUCH_TOP = (1 << 17) - 1
};

typedef struct { /* what a frame teaches the next one */
    touch_context c[TOUCH_PASS_CONTEXTS];
    int64_t w[TOUCH_PASS_WEIGHTS], blend[16][TOUCH_FEATURES];
} touch_models;

typedef struct { /* steps of a segment */
    float unit_n;
    int64_t floor, rate, cross_floor, cross_rate;
    int32_t *border; /* 1/256 units, at each sixteenth of a step */
    int64_t borders;
} touch_steps;

/* The window of a brick: its voxels and those about them, from -2 to 9 along each axis; cells by their number, or -1. */
enum { TOUCH_SIDE = 12, TOUCH_WINDOW = 12 * 12 * 12, TOUCH_DX = 144, TOUCH_DY = 12, TOUCH_DZ = 1 };

typedef struct {
    touch_code b;
    touch_models *m;
    const touch_steps *s;
    touch_cell *cell;
    const touch_units *reference;
    uint64_t *is_old; /* bits of its voxels that hold a force, 8 words a brick: its vectors lie far apart */
    int64_t slope[3];
    int axis[3], sign[3], stride[3], corner; /* of the scan in the grid; in a brick */
    int64_t end[3]; /* last sample of the bricks along each axis of the scan */
    int32_t at[TOUCH_WINDOW], old[TOUCH_WINDOW];
    int32_t last[3];
    int is_known, state;
} touch_pass;

typedef struct { /* what is known of a voxel before its force is told */
    int here, then, held, kind; /* place in the window; of the reference; of X, Y, Z; which weights blend */
    const touch_cell *face[3];
    int32_t old[3], chain[3][3];
    int has_old, has_chain[3];
} touch_voxel;

static int64_t touch_step(const touch_steps *s, int64_t length) {
    int64_t step = (length * s->rate) >> 16;
    return step > s->floor ? step : s->floor;
}

static int64_t touch_length(const int32_t v[3]) {
    int64_t n = touch_root((int64_t)v[0] * v[0] + (int64_t)v[1] * v[1] + (int64_t)v[2] * v[2]);
    return n ? n : 1;
}

static int32_t touch_lim(int64_t n) { return (int32_t)touch_clip(n, -TOUCH_TOP, TOUCH_TOP); }

/* The reference's vector, turned into the scan. */
static void touch_old(const touch_pass *p, int32_t place, int32_t out[3]) {
    const int32_t *v = p->reference->v[place].v;
    for (int n = 0; n < 3; n++) out[n] = p->sign[n] * v[p->axis[n]];
}

static void touch_store(touch_pass *p, int here, int32_t place, const int32_t v[3], int64_t along, int64_t across) {
    touch_cell *cell = p->cell + place;
    int64_t a = touch_length(v), inverse = ((int64_t)1 << 28) / a;
    for (int n = 0; n < 3; n++) {
        cell->v[n] = v[n];
        cell->ahead[n] = (int32_t)(a - ((((v[n] * inverse) >> 14) * p->slope[n]) >> 14));
    }
    cell->length = (int32_t)a, cell->along = (uint8_t)along, cell->across = (uint8_t)across;
    p->at[here] = place;
}

/* Follow the law from a neighbour along an axis. */
static void touch_chain(const touch_pass *p, const touch_cell *cell, int axis, int32_t out[3]) {
    int64_t l = cell->ahead[axis], a = cell->length;
    if (l < a >> 3) l = a >> 3;
    if (l < p->s->floor >> 1) l = p->s->floor >> 1;
    if (l < 1) l = 1;
    int64_t r = (l << 14) / a;
    if (r > 1 << 17) r = 1 << 17;
    for (int n = 0; n < 3; n++) out[n] = touch_lim((cell->v[n] * r + 8192) >> 14);
}

static const int touch_before[3] = {-TOUCH_DX, -TOUCH_DY, -TOUCH_DZ};
static const int touch_diagonal[3] = {-TOUCH_DX + TOUCH_DY, -TOUCH_DX + TOUCH_DZ, -TOUCH_DY + TOUCH_DZ};
static const int touch_wide[5] = {-TOUCH_DX - TOUCH_DY, -TOUCH_DX - TOUCH_DZ, -TOUCH_DY - TOUCH_DZ, -2 * TOUCH_DX,
                                  -2 * TOUCH_DZ};

/* Whether a voxel holds a force; what is known of it is left in `v`. */
static int touch_support(touch_pass *p, touch_voxel *v, int here) {
    touch_context *c = p->m->c + TOUCH_HELD;
    int64_t sum = 0;
    uint32_t mask = 0, wide = 0, every = 0;
    int around = 0;
    v->here = here, v->held = 0, v->then = 0, v->has_old = p->old[here] >= 0;
    for (int n = 0; n < 3; n++) {
        int32_t at = p->at[here + touch_before[n]];
        v->face[n] = at >= 0 ? p->cell + at : 0;
        if (at >= 0) mask |= 1u << n, v->held++, sum += v->face[n]->ahead[n];
        if (p->at[here + touch_diagonal[n]] >= 0) mask |= 8u << n;
    }
    for (int n = 0; n < 5; n++) wide |= (p->at[here + touch_wide[n]] >= 0 ? 1u : 0u) << n;
    if (p->is_known) {
        for (int n = 0; n < 3; n++) {
            int low = p->old[here + touch_before[n]] >= 0, high = p->old[here - touch_before[n]] >= 0;
            around += low + high, every |= (uint32_t)low << (2 * n) | (uint32_t)high << (2 * n + 1);
        }
        v->then = v->has_old ? 4 + (around >= 5) + (around == 6) : 1 + (around >= 1) + (around >= 3);
        every |= (uint32_t)v->has_old << 6;
    }
    int64_t likely = v->held ? touch_clip(((touch_div(sum, v->held) * 28) >> 16) + 3, 0, 31) : wide;
    uint32_t then = (uint32_t)v->then;
    return touch_mix3(&p->b, c + ((uint32_t)likely << 9 | mask << 3 | then), c + 16384 + (wide << 9 | mask << 3 | then),
                      c + 32768 + (every << 5 | (mask & 7) << 2 | (uint32_t)likely >> 3),
                      p->m->w + 3 * (8 * v->held + v->then));
}

/* What the blend may be made of, [13][3], in 1/256 steps: i = 2^32 // step. */
static void touch_features(const touch_pass *p, const touch_voxel *v, const int64_t base[3], int64_t inverse,
                           int64_t f[TOUCH_FEATURES][3]) {
    static const int pair[5][2] = {{-TOUCH_DX, -2 * TOUCH_DX},
                                   {-TOUCH_DY, -TOUCH_DX - TOUCH_DY},
                                   {-TOUCH_DZ, -TOUCH_DX - TOUCH_DZ},
                                   {-TOUCH_DZ, -TOUCH_DY - TOUCH_DZ},
                                   {-TOUCH_DY, -TOUCH_DY - TOUCH_DZ}};
    int shared = 0;
    memset(f, 0, sizeof(int64_t) * 3 * TOUCH_FEATURES);
    for (int n = 0; n < 6; n++) {
        int32_t at = p->at[v->here + (n < 3 ? touch_before[n] : touch_diagonal[n - 3])];
        if (at >= 0)
            for (int k = 0; k < 3; k++) f[n][k] = p->cell[at].v[k] - base[k];
    }
    for (int n = 0; n < 5; n++) {
        int32_t one = p->at[v->here + pair[n][0]], two = p->at[v->here + pair[n][1]];
        if (one >= 0 && two >= 0)
            for (int k = 0; k < 3; k++) f[6 + n][k] = (int64_t)p->cell[one].v[k] - p->cell[two].v[k];
    }
    if (v->has_old) {
        for (int n = 0; n < 3; n++) {
            int32_t at = p->old[v->here + touch_before[n]], was[3];
            if (!v->face[n] || at < 0) continue;
            touch_old(p, at, was), shared++;
            for (int k = 0; k < 3; k++) f[12][k] += v->face[n]->v[k] - was[k];
        }
        for (int k = 0; k < 3; k++) f[11][k] = v->old[k] - base[k], f[12][k] = touch_div(f[12][k], shared ? shared : 1);
    }
    for (int n = 0; n < TOUCH_FEATURES; n++)
        for (int k = 0; k < 3; k++) f[n][k] = touch_clip((f[n][k] * inverse) >> 24, -4095, 4095);
}

static int touch_class(int64_t n, const int *list) {
    int c = 0;
    while (c < 7 && list[c] <= n) c++;
    return c;
}

static int touch_distance(int64_t q, int64_t step) {
    int bits = touch_bits_of((uint64_t)((q << 3) / step));
    return bits < 7 ? bits : 7;
}

/* Unit vectors along a vector of that length, and across it, 1/16384. */
static void touch_axes(const int32_t c[3], int64_t length, int64_t e[3][3]) {
    int64_t inverse = ((int64_t)1 << 44) / length, size;
    int32_t h[3];
    for (int n = 0; n < 3; n++) e[0][n] = (c[n] * inverse + (1 << 29)) >> 30;
    h[0] = h[1] = h[2] = 0;
    if ((e[0][2] < 0 ? -e[0][2] : e[0][2]) < 14746) h[0] = (int32_t)-e[0][1], h[1] = (int32_t)e[0][0];
    else h[1] = (int32_t)-e[0][2], h[2] = (int32_t)e[0][1];
    size = touch_length(h), inverse = ((int64_t)1 << 44) / size;
    for (int n = 0; n < 3; n++) e[1][n] = (h[n] * inverse + (1 << 29)) >> 30;
    for (int n = 0; n < 3; n++) {
        int i = (n + 1) % 3, j = (n + 2) % 3;
        e[2][n] = (e[0][i] * e[1][j] - e[0][j] * e[1][i]) >> 14;
    }
}

/* The length of a force whose residual along it is r, by the warped lattice. */
static int64_t touch_warped(const touch_steps *s, int64_t length, int64_t r) {
    int64_t b = (length < (1 << 18) - 1 ? length : (1 << 18) - 1) << 8, low = 0, high = s->borders, size, top;
    while (high - low > 1) {
        int64_t middle = (low + high) / 2;
        if (s->border[middle] <= b) low = middle;
        else high = middle;
    }
    int64_t level = 16 * low + ((b - s->border[low]) << 4) / (s->border[low + 1] - s->border[low]) + 256 * r;
    size = level < 0 ? -level : level, top = 16 * (s->borders - 1) - 1;
    if (size > top) size = top;
    int64_t n = size >> 4;
    size = (s->border[n] + (((s->border[n + 1] - s->border[n]) * (size & 15)) >> 4) + 128) >> 8;
    return level < 0 ? -size : size;
}

typedef struct { /* what the components of a residual know */
    int group[3], apart, held, followed;
    int64_t step;
    uint32_t side[2];
} touch_about;

/* Component k of a residual: whether it is 0, its sign, its size. y: how far what is expected lies from the blend. */
static int64_t touch_component(touch_pass *p, int k, const touch_about *a, int64_t y, int is_certain) {
    touch_context *c = p->m->c;
    int64_t *w = p->m->w, size = 1;
    uint32_t g = (uint32_t)a->group[k], t = (uint32_t)touch_distance(y < 0 ? -y : y, a->step), q = (uint32_t)a->apart;
    if (!is_certain) {
        touch_context *zero = c + TOUCH_ZERO + 1088 * k;
        if (!touch_mix3(&p->b, zero + ((g > 3 ? 256u : 0u) | a->side[0]), zero + 512 + ((g > 3 ? 256u : 0u) | a->side[1]),
                        zero + 1024 + (t << 3 | q), w + TOUCH_W_ZERO + 3 * (8 * k + a->group[k])))
            return 0;
    }
    c += TOUCH_SIGN + 576 * k;
    int negative = touch_mix3(&p->b, c + a->side[0], c + 256 + a->side[1],
                          c + 512 + (t << 3 | (y < 0 ? 4u : 0u) | (uint32_t)a->held), w + TOUCH_W_SIGN + 9 * k);
    c = p->m->c + TOUCH_SIZE + 1152 * k;
    while (size <= 14) {
        uint32_t n = (uint32_t)size - 1;
        if (!touch_mix2(&p->b, c + (g << 4 | n), c + 128 + (t << 7 | q << 4 | n), w + TOUCH_W_SIZE + 2 * (16 * k + (int)n)))
            break;
        size++;
    }
    if (size > 14) size = 14 + touch_gamma(&p->b, 17);
    return negative ? -size : size;
}

/* The force of a voxel, by what is expected and the blend; the sizes of its residual. */
static void touch_residual(touch_pass *p, const touch_voxel *v, const int32_t expected[3], const int32_t blend[3],
                           int followed, int32_t out[3], int64_t size[2]) {
    static const int groups[7] = {1, 2, 4, 7, 11, 16, 24}, sides[7] = {1, 2, 3, 5, 8, 12, 20};
    int64_t along = 0, across = 0, length = touch_length(expected), e[3][3], r[3];
    int32_t other[3], centre[3], way[3];
    uint32_t quiet = 0;
    touch_about a;
    int far = 7, m = v->held;
    for (int n = 0; n < 3; n++) {
        uint32_t own = 0;
        if (v->face[n]) {
            along += v->face[n]->along, across += v->face[n]->across;
            own = 1u + v->face[n]->along + v->face[n]->across;
        }
        quiet = quiet << 2 | (own < 3 ? own : 3);
        other[n] = expected[n] - blend[n];
    }
    a.group[0] = m ? touch_class(4 * along / m, groups) : 7;
    a.group[1] = a.group[2] = m ? touch_class(2 * across / m, groups) : 7;
    uint32_t both = m ? (uint32_t)touch_class(3 * (along + across) / m, groups) : 7;
    a.step = touch_step(p->s, length), a.held = m, a.followed = followed;
    a.apart = touch_distance(touch_length(other), a.step);
    if (v->has_old && followed != 2) {
        for (int n = 0; n < 3; n++) way[n] = v->old[n] - expected[n];
        far = touch_distance(touch_length(way), a.step);
    }
    uint32_t loud = (uint32_t)(length >> 12 < 15 ? length >> 12 : 15);
    {
        touch_context *c = p->m->c + TOUCH_STILL;
        uint32_t q = (uint32_t)a.apart;
        if (touch_mix3(&p->b, c + (quiet << 3 | q), c + 512 + (q << 6 | loud << 2 | (uint32_t)m),
                       c + 1024 + ((uint32_t)far << 9 | (uint32_t)v->then << 6 | q << 3 | both),
                       p->m->w + TOUCH_W_STILL + 3 * (2 * (int)both + (far < 7)))) {
            memcpy(out, expected, 12), size[0] = size[1] = 0;
            return;
        }
    }
    memcpy(centre, blend, 12);
    if (!centre[0] && !centre[1] && !centre[2]) centre[2] = 1;
    length = touch_length(centre), a.step = touch_step(p->s, length);
    touch_axes(centre, length, e);
    for (int k = 0; k < 3; k++) {
        int64_t y = (other[0] * e[k][0] + other[1] * e[k][1] + other[2] * e[k][2]) >> 14;
        uint32_t told[4];
        for (int n = 0; n < 4; n++) {
            const int32_t *o = n < 3 ? v->chain[n] : v->old;
            told[n] = 15;
            if (n < 3 ? v->has_chain[n] : v->has_old) {
                int64_t off = 0;
                for (int i = 0; i < 3; i++) off += (int64_t)(o[i] - centre[i]) * e[k][i];
                off = touch_div(off >> 12, a.step);
                told[n] = (uint32_t)(off < 0 ? 7 - touch_class(-off, sides) : 7 + touch_class(off, sides));
            }
        }
        a.side[0] = told[0] << 4 | told[1], a.side[1] = told[2] << 4 | told[3];
        r[k] = touch_component(p, k, &a, y, k == 2 && !followed && !r[0] && !r[1]);
    }
    int64_t warped = touch_warped(p->s, length, r[0]);
    int64_t d = ((warped < 0 ? -warped : warped) * p->s->cross_rate) >> 16;
    if (d < p->s->cross_floor) d = p->s->cross_floor;
    for (int n = 0; n < 3; n++)
        out[n] = touch_lim((warped * e[0][n] + r[1] * d * e[1][n] + r[2] * d * e[2][n] + 8192) >> 14);
    size[0] = r[0] < 0 ? -r[0] : r[0], size[1] = (r[1] < 0 ? -r[1] : r[1]) + (r[2] < 0 ? -r[2] : r[2]);
    if (size[0] > 15) size[0] = 15;
    if (size[1] > 31) size[1] = 31;
}

/* A voxel that holds a force: expect, read, store, learn. */
static void touch_voxel_force(touch_pass *p, touch_voxel *v, int32_t place, int is_trusted) {
    int64_t base[3], f[TOUCH_FEATURES][3], step = 1, sum[3], size[2];
    int32_t blend[3], expected[3], out[3];
    int followed = 0;
    if (v->has_old) touch_old(p, p->old[v->here], v->old);
    for (int n = 0; n < 3; n++) {
        v->has_chain[n] = v->face[n] != 0;
        if (v->face[n]) touch_chain(p, v->face[n], n, v->chain[n]);
    }
    if (!v->held) {
        for (int k = 0; k < 3; k++) base[k] = v->has_old ? v->old[k] : p->last[k];
    } else {
        int64_t total = 0, likely = 0;
        base[0] = base[1] = base[2] = 0;
        for (int n = 0; n < 3; n++) {
            const touch_cell *cell = v->face[n];
            if (!cell) continue;
            total += cell->length, likely += cell->ahead[n] > cell->length >> 3 ? cell->ahead[n] : cell->length >> 3;
            for (int k = 0; k < 3; k++) base[k] += cell->v[k];
        }
        int64_t scale = (likely << 16) / (total * v->held);
        if (scale > 1 << 17) scale = 1 << 17;
        for (int k = 0; k < 3; k++) base[k] = (base[k] * scale + 32768) >> 16;
        step = touch_step(p->s, likely / v->held);
    }
    int64_t inverse = ((int64_t)1 << 32) / step;
    int64_t *w = p->m->blend[(v->face[0] ? 1 : 0) | (v->face[1] ? 2 : 0) | (v->face[2] ? 4 : 0) | (v->has_old ? 8 : 0)];
    sum[0] = sum[1] = sum[2] = 0;
    if (v->held) {
        touch_features(p, v, base, inverse, f);
        for (int n = 0; n < TOUCH_FEATURES; n++)
            for (int k = 0; k < 3; k++) sum[k] += w[n] * f[n][k];
    }
    for (int k = 0; k < 3; k++) blend[k] = touch_lim(base[k] + (((sum[k] >> 16) * step) >> 8));
    memcpy(expected, blend, 12);
    if (is_trusted && v->has_old) {
        int32_t was = p->old[v->here - TOUCH_DX];
        followed = 2;
        if (v->face[0] && was >= 0) { /* more than a step off beside it: it is not followed */
            int64_t off = 0, own = touch_step(p->s, v->face[0]->length);
            int32_t old[3];
            touch_old(p, was, old);
            for (int k = 0; k < 3; k++) off += (int64_t)(v->face[0]->v[k] - old[k]) * (v->face[0]->v[k] - old[k]);
            if (off > own * own) followed = 0;
        }
        if (followed) memcpy(expected, v->old, 12);
    }
    for (int n = 0; n < 3 && !followed; n++)
        if (v->has_chain[n]) memcpy(expected, v->chain[n], 12), followed = 1;
    touch_residual(p, v, expected, blend, followed, out, size);
    touch_store(p, v->here, place, out, size[0], size[1]);
    memcpy(p->last, out, 12);
    if (v->held) {
        int64_t energy = 32768, gain[3];
        for (int n = 0; n < TOUCH_FEATURES; n++)
            for (int k = 0; k < 3; k++) energy += f[n][k] * f[n][k];
        for (int k = 0; k < 3; k++)
            gain[k] = touch_div(touch_clip(((out[k] - blend[k]) * inverse) >> 24, -1023, 1023) * (1 << 27), energy);
        for (int k = 0; k < 3; k++)
            for (int n = 0; n < TOUCH_FEATURES; n++)
                w[n] = touch_clip(w[n] + ((f[n][k] * gain[k]) >> 14), -(1 << 20), 1 << 20);
    }
}

/* The place in a brick, in the grid's order, of a sample of the scan. */
static int touch_of_grid(const touch_pass *p, int x, int y, int z) {
    return p->corner + p->stride[0] * x + p->stride[1] * y + p->stride[2] * z;
}

/* Fill the window of a brick of the scan: cells by their numbers, and the reference's by theirs. */
static void touch_look(touch_pass *p, const int32_t brick[3], const touch_map *cells, const touch_map *olds) {
    for (int n = 0; n < TOUCH_WINDOW; n++) p->at[n] = p->old[n] = -1;
    for (int dx = -1; dx <= 1; dx++)
        for (int dy = -1; dy <= 1; dy++)
            for (int dz = -1; dz <= 1; dz++) {
                uint64_t key = touch_key(brick[0] + dx, brick[1] + dy, brick[2] + dz);
                int is_past = dx < 0 || (!dx && (dy < 0 || (!dy && dz < 0)));
                int64_t cell = is_past ? touch_map_get(cells, key) : -1, old = olds ? touch_map_get(olds, key) : -1;
                int low[3], high[3], d[3];
                if (cell < 0 && old < 0) continue;
                d[0] = dx, d[1] = dy, d[2] = dz;
                for (int n = 0; n < 3; n++) low[n] = d[n] < 0 ? 6 : 0, high[n] = d[n] > 0 ? 2 : 8;
                for (int x = low[0]; x < high[0]; x++)
                    for (int y = low[1]; y < high[1]; y++)
                        for (int z = low[2]; z < high[2]; z++) {
                            int here = (8 * dx + x + 2) * 144 + (8 * dy + y + 2) * 12 + 8 * dz + z + 2;
                            int32_t own = (int32_t)(512 * cell + 64 * x + 8 * y + z);
                            if (cell >= 0 && p->cell[own].length) p->at[here] = own;
                            if (old < 0) continue;
                            int of_grid = touch_of_grid(p, x, y, z);
                            if (p->is_old[8 * old + (of_grid >> 6)] >> (of_grid & 63) & 1)
                                p->old[here] = (int32_t)(512 * old + of_grid);
                        }
            }
}

static int touch_here(int x, int y, int z) { return (x + 2) * 144 + (y + 2) * 12 + z + 2; }

/* A brick: whether it is as the reference has it; its blocks; its voxels. `size`: samples within the grid. */
static void touch_brick(touch_pass *p, int64_t slot, const int low[3], const int high[3]) {
    touch_context *c = p->m->c;
    int state = 0, block[8];
    int32_t first = (int32_t)(512 * slot);
    if (p->is_known) {
        state = touch_bit(&p->b, c + TOUCH_BRICK + p->state) ? 2 : touch_bit(&p->b, c + TOUCH_BRICK + 4 + p->state);
        p->state = state;
    }
    if (state == 2) {
        for (int x = low[0]; x < high[0]; x++)
            for (int y = low[1]; y < high[1]; y++)
                for (int z = low[2]; z < high[2]; z++) {
                    int here = touch_here(x, y, z);
                    int32_t v[3];
                    if (p->old[here] < 0) continue;
                    touch_old(p, p->old[here], v);
                    touch_store(p, here, first + 64 * x + 8 * y + z, v, 0, 0);
                }
        return;
    }
    for (int n = 0; n < 8; n++) {
        int side = 0, base[3], was = 0, then = 0;
        base[0] = n >> 2 ? 4 : 0, base[1] = n & 2 ? 4 : 0, base[2] = n & 1 ? 4 : 0;
        for (int axis = 0; axis < 3; axis++) {
            int any = 0, bit = 4 >> axis;
            if (n & bit) any = block[n - bit];
            else
                for (int i = 0; i < 16 && !any; i++) {
                    int at[3], u = (axis + 1) % 3, w = (axis + 2) % 3;
                    at[axis] = -1, at[u] = base[u] + (i >> 2), at[w] = base[w] + (i & 3);
                    any = p->at[touch_here(at[0], at[1], at[2])] >= 0;
                }
            side = side << 1 | any;
        }
        if (p->is_known) {
            for (int i = 0; i < 16 && !was; i++)
                for (int j = 0; j < 4 && !was; j++)
                    was = p->old[touch_here(base[0] + (i >> 2), base[1] + (i & 3), base[2] + j)] >= 0;
            then = 1 + was;
        }
        block[n] = touch_bit(&p->b, c + TOUCH_BLOCK + 8 * then + side);
    }
    for (int x = low[0]; x < high[0]; x++)
        for (int y = low[1]; y < high[1]; y++)
            for (int z = low[2]; z < high[2]; z++) {
                touch_voxel v;
                int here = touch_here(x, y, z);
                if (!block[(x >> 2) * 4 + (y >> 2) * 2 + (z >> 2)]) continue;
                if (touch_support(p, &v, here)) touch_voxel_force(p, &v, first + 64 * x + 8 * y + z, state == 1);
            }
}

/* A frame by what both sides know before it: `reference` in, `out` in units; the cells are taken from the arena. */
static int touch_read_frame(touch_cursor c, const touch_grid *grid, const touch_steps *steps, const touch_tables *tables,
                            touch_models *models, const touch_units *reference, touch_units *out, touch_arena *arena,
                            touch_cursor *error) {
    uint64_t course = touch_u(&c, 1), *key;
    uint32_t *tag;
    touch_map cells, olds;
    touch_pass *p;
    int k = 1;
    touch_need(&c, course < 32 && (course & 3) < 3, "a course that there is not");
    p = (touch_pass *)touch_take(arena, 1, sizeof *p);
    if (!p) return touch_fail(error, TOUCH_MEMORY, "no room for a frame");
    for (int n = 0; n < 3; n++) p->slope[n] = (int64_t)touch_varint(&c, 0, 1u << 17);
    if (c.code) return touch_fail(error, c.code, c.what);
    p->axis[0] = (int)(course & 3), p->corner = 0;
    for (int n = 0; n < 3; n++)
        if (n != p->axis[0]) p->axis[k++] = n;
    for (int n = 0; n < 3; n++) {
        p->sign[n] = course >> (2 + n) & 1 ? -1 : 1;
        p->end[n] = (int64_t)((grid->shape[p->axis[n]] + 7) >> 3) - 1;
        p->stride[n] = p->sign[n] * (64 >> 3 * p->axis[n]), p->corner += p->sign[n] < 0 ? 7 * (64 >> 3 * p->axis[n]) : 0;
    }
    p->b = touch_code_of(&c, tables), p->m = models, p->s = steps, p->reference = reference, p->state = 0;
    p->last[0] = p->last[1] = p->last[2] = 0;
    if (!touch_read_list(&p->b, models->c + TOUCH_PASS_LIST, models->w + TOUCH_W_LIST, grid->shape, reference->list,
                         &out->list, arena, error))
        return 0;
    touch_check(&p->b, error);
    if (error->code) return 0;
    out->v = (touch_vector *)touch_take_zero(arena, 512 * out->list.count, sizeof *out->v);
    uint64_t mark = arena->used;
    p->cell = (touch_cell *)touch_take_zero(arena, 512 * out->list.count, sizeof *p->cell);
    key = (uint64_t *)touch_take(arena, out->list.count, 8), tag = (uint32_t *)touch_take(arena, out->list.count, 4);
    p->is_old = (uint64_t *)touch_take_zero(arena, 8 * reference->list.count, 8);
    if (!out->v || !p->cell || !key || !tag || !p->is_old || !touch_map_make(&cells, out->list.count, arena) ||
        !touch_map_make(&olds, reference->list.count, arena))
        return touch_fail(error, TOUCH_MEMORY, "no room for a frame");
    for (uint64_t i = 0; i < out->list.count; i++) { /* the scan's order */
        int32_t at[3], to[3];
        touch_place(out->list.key[i], at);
        for (int n = 0; n < 3; n++) to[n] = p->sign[n] < 0 ? (int32_t)p->end[n] - at[p->axis[n]] : at[p->axis[n]];
        key[i] = touch_key(to[0], to[1], to[2]), tag[i] = (uint32_t)i, touch_map_put(&cells, key[i], (uint32_t)i);
    }
    for (uint64_t i = 0; i < 512 * reference->list.count; i++) {
        const int32_t *v = reference->v[i].v;
        p->is_old[i >> 6] |= (uint64_t)(v[0] || v[1] || v[2]) << (i & 63);
    }
    for (uint64_t i = 0; i < reference->list.count; i++) {
        int32_t at[3], to[3];
        touch_place(reference->list.key[i], at);
        for (int n = 0; n < 3; n++) to[n] = p->sign[n] < 0 ? (int32_t)p->end[n] - at[p->axis[n]] : at[p->axis[n]];
        touch_map_put(&olds, touch_key(to[0], to[1], to[2]), (uint32_t)i);
    }
    touch_sort(key, tag, out->list.count);
    for (uint64_t i = 0; i < out->list.count; i++) {
        int32_t at[3];
        int low[3], high[3];
        touch_place(key[i], at);
        for (int n = 0; n < 3; n++) { /* within the grid, in the scan */
            int64_t samples = grid->shape[p->axis[n]], all = 8 * (p->end[n] + 1);
            int64_t first = p->sign[n] < 0 ? all - samples : 0, last = p->sign[n] < 0 ? all : samples;
            low[n] = (int)touch_clip(first - 8 * at[n], 0, 8), high[n] = (int)touch_clip(last - 8 * at[n], 0, 8);
        }
        p->is_known = touch_map_get(&olds, key[i]) >= 0;
        touch_look(p, at, &cells, &olds);
        touch_brick(p, tag[i], low, high);
        for (int x = low[0]; x < high[0]; x++)
            for (int y = low[1]; y < high[1]; y++)
                for (int z = low[2]; z < high[2]; z++) {
                    const touch_cell *cell = p->cell + 512 * (uint64_t)tag[i] + (uint64_t)(64 * x + 8 * y + z);
                    if (!cell->length) continue;
                    touch_vector *v = out->v + 512 * (uint64_t)tag[i] + touch_of_grid(p, x, y, z);
                    for (int n = 0; n < 3; n++) v->v[p->axis[n]] = p->sign[n] * cell->v[n];
                }
        touch_check(&p->b, error);
        if (error->code) return 0;
    }
    touch_close(&p->b, out->list.count, error);
    arena->used = mark;
    return !error->code;
}

/* -- guesses of coder touch (docs/format/touch-guess.md) ------------------------------------------------------------- */

static void touch_brick_samples(const touch_grid *g, const int32_t brick[3], int high[3]) {
    for (int n = 0; n < 3; n++) high[n] = (int)touch_clip((int64_t)g->shape[n] - 8 * (int64_t)brick[n], 0, 8);
}

static int64_t touch_node_residual(touch_code *b, touch_context *c) {
    int length = 0, negative;
    int64_t size;
    while (length < 24 && touch_bit(b, c + length)) length++;
    if (!length) return 0;
    negative = touch_narrow(b, 32768), size = (int64_t)1 << (length - 1) | touch_even(b, length - 1);
    return negative ? -size : size;
}

/* Values of all nodes, in raster order. */
static void touch_tell_nodes(touch_code *b, touch_context *c, const uint64_t *key, int32_t *value, int32_t *size,
                             uint64_t count, int64_t step, touch_map *map) {
    for (uint64_t i = 0; i < count; i++) {
        int32_t at[3];
        int64_t one[3], two[3], sum = 0, g = 0;
        int said = 0;
        touch_place(key[i], at);
        for (int n = 0; n < 3; n++) { /* before it along an axis, and along the two others together */
            one[n] = touch_map_get(map, touch_key(at[0] - (n == 0), at[1] - (n == 1), at[2] - (n == 2)));
            two[n] = touch_map_get(map, touch_key(at[0] - (n != 0), at[1] - (n != 1), at[2] - (n != 2)));
            if (one[n] >= 0) g += size[one[n]];
        }
        for (int n = 0; n < 3; n++) {
            int64_t p = one[(n + 1) % 3], q = one[(n + 2) % 3];
            if (p >= 0 && q >= 0 && two[n] >= 0) sum += (int64_t)value[p] + value[q] - value[two[n]], said++;
        }
        if (!said)
            for (int n = 0; n < 3; n++)
                if (one[n] >= 0) sum += value[one[n]], said++;
        if (said) sum = touch_div(2 * sum + said, 2 * said);
        g = touch_bits_of((uint64_t)g);
        int64_t r = touch_node_residual(b, c + 24 * (g < 9 ? g : 9));
        size[i] = (int32_t)(r < 0 ? -r : r);
        value[i] = (int32_t)touch_clip(sum + r * step, -(1 << 23), 1 << 23);
        touch_map_put(map, key[i], (uint32_t)i); /* only nodes that are told are there */
    }
}

/* The potential at the corners about the samples of a brick: sums of weighted nodes along x, then y, then z. */
static void touch_corners(const touch_map *map, const int32_t *value, const int32_t brick[3], const int e[3],
                          int64_t v[9][9][9]) {
    int64_t node[5][5][5], weight[3][9][4];
    int count[3], first[3];
    for (int n = 0; n < 3; n++) {
        int64_t h = (int64_t)1 << e[n];
        first[n] = (8 * brick[n] >> e[n]) - 1, count[n] = ((8 * brick[n] + 7) >> e[n]) + 3 - first[n];
        for (int k = 0; k < 9; k++) {
            int64_t cell = (k < 7 ? k : 7) >> e[n], p = ((8 * brick[n]) & (h - 1)) + k - cell * h, q = h - p;
            weight[n][k][0] = q * q * q, weight[n][k][3] = p * p * p;
            weight[n][k][1] = 4 * h * h * h - 6 * h * p * p + 3 * p * p * p;
            weight[n][k][2] = 4 * h * h * h - 6 * h * q * q + 3 * q * q * q;
        }
    }
    for (int i = 0; i < count[0]; i++)
        for (int j = 0; j < count[1]; j++)
            for (int m = 0; m < count[2]; m++)
                node[i][j][m] = value[touch_map_get(map, touch_key(first[0] + i, first[1] + j, first[2] + m))];
    for (int n = 0; n < 9; n++) {
        int64_t x[5][5], y[5];
        int cell = (n < 7 ? n : 7) >> e[0], half = 3 * e[0];
        for (int j = 0; j < count[1]; j++)
            for (int m = 0; m < count[2]; m++) {
                x[j][m] = ((int64_t)1 << half) >> 1;
                for (int a = 0; a < 4; a++) x[j][m] += weight[0][n][a] * node[cell + a][j][m];
                x[j][m] >>= half;
            }
        for (int i = 0; i < 9; i++) {
            int along = (i < 7 ? i : 7) >> e[1];
            for (int m = 0; m < count[2]; m++) {
                y[m] = ((int64_t)1 << (3 * e[1])) >> 1;
                for (int a = 0; a < 4; a++) y[m] += weight[1][i][a] * x[along + a][m];
                y[m] >>= 3 * e[1];
            }
            for (int k = 0; k < 9; k++) {
                int64_t sum = ((int64_t)1 << (3 * e[2])) >> 1;
                for (int a = 0; a < 4; a++) sum += weight[2][k][a] * y[((k < 7 ? k : 7) >> e[2]) + a];
                v[n][i][k] = sum >> (3 * e[2]);
            }
        }
    }
}

static void touch_spline_brick(int64_t v[9][9][9], const int64_t scale[3], const int high[3], touch_vector *out) {
    for (int x = 0; x < high[0]; x++)
        for (int y = 0; y < high[1]; y++)
            for (int z = 0; z < high[2]; z++) {
                int64_t g[3], f = 0, m = 0;
                g[0] = g[1] = g[2] = 0;
                for (int n = 0; n < 8; n++) {
                    int64_t one = v[x + (n >> 2)][y + (n >> 1 & 1)][z + (n & 1)];
                    f += one, g[0] += n & 4 ? one : -one, g[1] += n & 2 ? one : -one, g[2] += n & 1 ? one : -one;
                }
                f = touch_clip(touch_div(f + 864, 1728), 0, 65536);
                for (int n = 0; n < 3; n++) {
                    g[n] = touch_clip((g[n] * scale[n]) >> 20, -(1 << 20), 1 << 20);
                    m += g[n] * g[n];
                }
                m = touch_root(m);
                if (m < 16384) m = 16384;
                for (int n = 0; n < 3; n++)
                    out[64 * x + 8 * y + z].v[n] = (int32_t)touch_div(m - 2 * f * g[n], 2 * m);
            }
}

static int touch_spline(touch_cursor c, const touch_grid *grid, const touch_tables *tables, touch_units *out,
                        touch_arena *arena, touch_cursor *error) {
    int e[3];
    int64_t scale[3], v[9][9][9];
    uint64_t count = 0, kept = 0;
    int32_t *value, *size;
    touch_context *contexts;
    int64_t weights[TOUCH_LIST_WEIGHTS];
    touch_code b;
    touch_map map;
    touch_list none;
    for (int n = 0; n < 3; n++) e[n] = (int)touch_varint(&c, 2, 6);
    int64_t step = (int64_t)touch_varint(&c, 1, 1u << 20);
    for (int n = 0; n < 3; n++) scale[n] = (int64_t)touch_varint(&c, 1, 1u << 20);
    if (c.code) return touch_fail(error, c.code, c.what);
    none.key = 0, none.count = 0, b = touch_code_of(&c, tables);
    contexts = (touch_context *)touch_take(arena, TOUCH_LIST_CONTEXTS + 240, sizeof *contexts);
    if (!contexts) return touch_fail(error, TOUCH_MEMORY, "no room for a guess");
    touch_fresh(contexts, TOUCH_LIST_CONTEXTS + 240, weights, TOUCH_LIST_WEIGHTS);
    if (!touch_read_list(&b, contexts, weights, grid->shape, none, &out->list, arena, error)) return 0;
    touch_check(&b, error);
    if (!touch_need(error, out->list.count > 0, "a guess without bricks")) return 0;
    out->v = (touch_vector *)touch_take_zero(arena, 512 * out->list.count, sizeof *out->v);
    uint64_t mark = arena->used;
    uint64_t *key = (uint64_t *)touch_take(arena, 125 * out->list.count, 8);
    uint32_t *tag = (uint32_t *)touch_take_zero(arena, 125 * out->list.count, 4);
    if (!out->v || !key || !tag) return touch_fail(error, TOUCH_MEMORY, "no room for a guess");
    for (uint64_t i = 0; i < out->list.count; i++) {
        int32_t at[3], low[3], high[3];
        touch_place(out->list.key[i], at);
        for (int n = 0; n < 3; n++) low[n] = (8 * at[n] >> e[n]) - 1, high[n] = ((8 * at[n] + 7) >> e[n]) + 2;
        for (int32_t x = low[0]; x <= high[0]; x++)
            for (int32_t y = low[1]; y <= high[1]; y++)
                for (int32_t z = low[2]; z <= high[2]; z++) key[count++] = touch_key(x, y, z);
    }
    touch_sort(key, tag, count);
    for (uint64_t i = 0; i < count; i++)
        if (!i || key[i] != key[i - 1]) key[kept++] = key[i];
    value = (int32_t *)touch_take(arena, kept, 4), size = (int32_t *)touch_take(arena, kept, 4);
    if (!value || !size || !touch_map_make(&map, kept, arena))
        return touch_fail(error, TOUCH_MEMORY, "no room for a guess");
    touch_tell_nodes(&b, contexts + TOUCH_LIST_CONTEXTS, key, value, size, kept, step, &map);
    touch_check(&b, error);
    if (error->code) return 0;
    for (uint64_t i = 0; i < out->list.count; i++) {
        int32_t at[3];
        int high[3];
        touch_place(out->list.key[i], at), touch_brick_samples(grid, at, high);
        touch_corners(&map, value, at, e, v);
        touch_spline_brick(v, scale, high, out->v + 512 * i);
    }
    arena->used = mark;
    return 1;
}

typedef struct {
    int32_t told[4], u[3], residual[4]; /* X, Y, Z, A; the direction of X, Y; what was told of each */
} touch_surface;

typedef struct {
    int count;
    touch_surface s[2];
} touch_column;

typedef struct {
    touch_code b;
    touch_context *c;
    int64_t *w, top, ramp, ratio[2], xy_step, z_step, a_step;
} touch_columns_head;

enum { TOUCH_COLUMN_NODES = 22 * 14 };

static int touch_column_bit(touch_columns_head *h, int v, int f, int s) {
    return touch_mix2(&h->b, h->c + 52 * v + f, h->c + 52 * v + 36 + s, h->w + 2 * v);
}

static int64_t touch_column_number(touch_columns_head *h, int v, int f, int s) {
    int64_t n = 1;
    if (!touch_column_bit(h, v, f, s)) return 0;
    int negative = touch_column_bit(h, v + 1, f, s);
    while (n <= 20 && touch_column_bit(h, v + 1 + (int)n, f, s)) n++;
    if (n > 20) n = 20 + touch_gamma(&h->b, 24);
    return negative ? -n : n;
}

static int64_t touch_rise(const touch_columns_head *h, const int32_t u[3], int axis) {
    return touch_clip(touch_div(u[axis] * h->ratio[axis], u[2]), -4096, 4096);
}

static int64_t touch_middle(int64_t a, int64_t b, int64_t c) {
    int64_t low = a < b ? a : b, high = a < b ? b : a;
    return c < low ? low : c > high ? high : c;
}

/* X, Y, Z, A of surface S that its sides make likely; how many sides there are. */
static int touch_surface_expected(const touch_columns_head *h, const touch_column *const near[4], const touch_column *own,
                                  int slot, int mode, int count, int64_t e[4], const touch_surface *side[2]) {
    int k = slot || mode == 3, sides = 0, has_w, has_n;
    const touch_surface *w = near[0] && near[0]->count > k ? near[0]->s + k : 0;
    const touch_surface *no = near[1] && near[1]->count > k ? near[1]->s + k : 0;
    const touch_surface *co = near[2] && near[2]->count > k ? near[2]->s + k : 0;
    if (!slot && mode) {
        if (mode == 1 || (mode == 3 && w)) no = 0;
        else w = 0;
    }
    side[0] = w, side[1] = no, has_w = w != 0, has_n = no != 0, sides = has_w + has_n;
    if (sides) {
        for (int n = 0; n < 4; n++) e[n] = touch_div((has_w ? w->told[n] : 0) + (int64_t)(has_n ? no->told[n] : 0), sides);
        if (has_w && has_n && co)
            for (int n = 0; n < 2; n++)
                e[n] = (e[n] + touch_middle(w->told[n], no->told[n], (int64_t)w->told[n] + no->told[n] - co->told[n])) >> 1;
    } else if (slot) {
        e[0] = own->s[0].told[0], e[1] = own->s[0].told[1], e[2] = own->s[0].told[2] + 1536, e[3] = 0;
    } else if (near[3] && near[3]->count) {
        for (int n = 0; n < 4; n++) e[n] = near[3]->s[0].told[n];
    } else e[0] = e[1] = e[2] = 0, e[3] = h->top;
    if (slot) e[3] = h->top - own->s[0].told[3] > h->top >> 4 ? h->top - own->s[0].told[3] : h->top >> 4;
    else if (count == 2) e[3] = h->top >> 1;
    return sides;
}

static void touch_read_column(touch_columns_head *h, const touch_column *const near[4], touch_column *own) {
    int here = 0, twos = 0, mode = 0, some = 0;
    for (int n = 0; n < 4; n++) {
        int c = near[n] ? near[n]->count : 0;
        here |= c > 0 ? 8 >> n : 0, twos |= c > 1 ? 8 >> n : 0, some += c > 0;
    }
    own->count = 0;
    if (!touch_column_bit(h, 0, here, twos)) return;
    int torn = twos >> 2 > 0;
    if (here >> 2 == 3) {
        int64_t d = (int64_t)near[0]->s[0].told[2] - near[1]->s[0].told[2];
        torn |= d > 768 || d < -768;
    }
    int count = 1 + touch_column_bit(h, 1, 2 * twos + torn, here);
    if (torn) {
        mode = touch_column_bit(h, 22, twos >> 2, count);
        mode = 2 * mode + touch_column_bit(h, 23 + mode, twos >> 2, count);
    }
    for (int slot = 0; slot < count; slot++) {
        touch_surface *s = own->s + slot;
        const touch_surface *side[2];
        int64_t e[4], r[4];
        int sides = touch_surface_expected(h, near, own, slot, mode, count, e, side);
        for (int q = 0; q < 4; q++) {
            int64_t last = q ? (r[q - 1] < 0 ? -r[q - 1] : r[q - 1]) : 0, beside[2];
            if (q == 2 && (r[0] < 0 ? -r[0] : r[0]) > last) last = r[0] < 0 ? -r[0] : r[0];
            for (int n = 0; n < 2; n++) {
                beside[n] = 5;
                if (near[n] && near[n]->count > slot) {
                    int64_t size = near[n]->s[slot].residual[q];
                    beside[n] = size < 0 ? -size : size;
                    if (beside[n] > 4) beside[n] = 4;
                }
            }
            r[q] = touch_column_number(h, 22 * (2 + 4 * (count - 1 + slot) + q), (int)(6 * beside[0] + beside[1]),
                                       (int)(4 * (last < 3 ? last : 3)) + (some < 3 ? some : 3));
            s->residual[q] = (int32_t)r[q];
        }
        for (int n = 0; n < 2; n++) s->told[n] = (int32_t)touch_clip(e[n] + r[n] * h->xy_step, -16384, 16384);
        int64_t m = ((int64_t)1 << 43) / ((1 << 28) + (int64_t)s->told[0] * s->told[0] + (int64_t)s->told[1] * s->told[1]);
        s->u[0] = (int32_t)((s->told[0] * m) >> 14), s->u[1] = (int32_t)((s->told[1] * m) >> 14);
        s->u[2] = (int32_t)(m - 16384 > 820 ? m - 16384 : 820);
        if (sides) {
            int64_t sum = 0;
            for (int n = 0; n < 2; n++) /* W is beside along b, N along a */
                if (side[n])
                    sum += side[n]->told[2] + ((touch_rise(h, side[n]->u, 1 - n) + touch_rise(h, s->u, 1 - n)) >> 1);
            e[2] = touch_div(sum, sides);
        }
        s->told[2] = (int32_t)touch_clip(e[2] + r[2] * h->z_step, -(1 << 24), 1 << 24);
        int64_t a = ((e[3] > h->top >> 4 ? e[3] : h->top >> 4) * h->a_step) >> 16;
        s->told[3] = (int32_t)touch_clip(e[3] + r[3] * (a > 1 ? a : 1), 1, TOUCH_TOP);
        own->count = slot + 1;
    }
}

/* The forces of a column, laid into the bricks that the guess has. */
static void touch_lay_column(const touch_columns_head *h, const touch_column *own, const int32_t place[3], int axis,
                             int inverted, int64_t depth, const touch_map *map, touch_units *out) {
    int across[2], k = 0;
    for (int n = 0; n < 3; n++)
        if (n != axis) across[k++] = n;
    for (int64_t t = 0; t < depth; t++) {
        int64_t sum[3], at[3];
        at[0] = place[0], at[1] = place[1], at[2] = place[2], at[axis] = inverted ? depth - 1 - t : t;
        int64_t slot = touch_map_get(map, touch_key(at[0] >> 3, at[1] >> 3, at[2] >> 3));
        if (slot < 0) continue;
        sum[0] = sum[1] = sum[2] = 0;
        for (int s = 0; s < own->count; s++) {
            const touch_surface *f = own->s + s;
            int64_t steep = (h->ramp * f->u[2]) >> 14;
            int64_t share = touch_clip(((256 * t - f->told[2]) * (steep > 16 ? steep : 16)) >> 8, 0, 65536);
            for (int n = 0; n < 3; n++) sum[n] += share * (((int64_t)f->told[3] * f->u[n] + 8192) >> 14);
        }
        touch_vector *v = out->v + 512 * slot + 64 * (at[0] & 7) + 8 * (at[1] & 7) + (at[2] & 7);
        for (int n = 0; n < 3; n++) sum[n] = touch_lim((sum[n] + 32768) >> 16);
        v->v[across[0]] = (int32_t)sum[0], v->v[across[1]] = (int32_t)sum[1];
        v->v[axis] = (int32_t)(inverted ? sum[2] : -sum[2]);
    }
}

static int touch_columns(touch_cursor c, const touch_grid *grid, const touch_tables *tables, touch_units *out,
                         touch_arena *arena, touch_cursor *error) {
    static const int limit[7] = {17, 20, 20, 20, 14, 12, 16};
    uint64_t first = touch_varint(&c, 0, 6), count = 0, box[2][2], tiles[2], number[7];
    int axis = (int)(first >> 1), inverted = (int)(first & 1), across[2], k = 0;
    int64_t depth = grid->shape[axis];
    touch_columns_head h;
    touch_column *column;
    touch_map map;
    for (int n = 0; n < 3; n++)
        if (n != axis) across[k++] = n;
    for (int n = 0; n < 2; n++) tiles[n] = (grid->shape[across[n]] + 7) >> 3;
    for (int n = 0; n < 2; n++) box[n][0] = touch_varint(&c, 0, tiles[n]);
    for (int n = 0; n < 2; n++) box[n][1] = touch_varint(&c, 0, tiles[n]) + 1;
    for (int n = 0; n < 7; n++) number[n] = touch_varint(&c, 0, (uint64_t)1 << limit[n]);
    for (int n = 0; n < 2; n++) touch_need(&c, c.code || box[n][0] + box[n][1] <= tiles[n], "a box beyond the grid");
    touch_need(&c, depth <= 1 << 14, "columns of too many samples");
    if (c.code) return touch_fail(error, c.code, c.what);
    h.top = (int64_t)number[0], h.ramp = (int64_t)number[1], h.ratio[0] = (int64_t)number[2];
    h.ratio[1] = (int64_t)number[3], h.xy_step = (int64_t)number[4], h.z_step = (int64_t)number[5];
    h.a_step = (int64_t)number[6], h.b = touch_code_of(&c, tables);
    if (box[0][1] * box[1][1] > 64 + h.b.size) return touch_fail(error, TOUCH_CUT, "a box of many tiles");
    /* the list is as long as the bytes may tell; what is found beyond it is cut short */
    uint64_t wide = 64 + 16 * h.b.size;
    if (wide > touch_brick_count(grid)) wide = touch_brick_count(grid);
    out->list.key = (uint64_t *)touch_take(arena, wide + 1, 8), out->list.count = 0;
    uint64_t columns = 8 * box[1][1];
    column = (touch_column *)touch_take_zero(arena, 8 * box[0][1] * columns, sizeof *column);
    h.c = (touch_context *)touch_take(arena, 52 * TOUCH_COLUMN_NODES, sizeof *h.c);
    h.w = (int64_t *)touch_take(arena, 2 * TOUCH_COLUMN_NODES, 8);
    int64_t *start = (int64_t *)touch_take(arena, box[0][1] * box[1][1], 8);
    if (!out->list.key || !column || !h.c || !h.w || !start) return touch_fail(error, TOUCH_MEMORY, "no room for a guess");
    touch_fresh(h.c, 52 * TOUCH_COLUMN_NODES, h.w, 2 * TOUCH_COLUMN_NODES);
    for (uint64_t i = 0; i < box[0][1] * box[1][1]; i++) start[i] = depth;
    for (int64_t a = 0; a < (int64_t)(8 * box[0][1]); a++) {
        for (int64_t b = 0; b < (int64_t)columns; b++) {
            const touch_column *near[4];
            touch_column *own = column + a * (int64_t)columns + b;
            int64_t *least = start + (a >> 3) * (int64_t)box[1][1] + (b >> 3);
            if ((int64_t)(8 * box[0][0]) + a >= grid->shape[across[0]]) continue;
            if ((int64_t)(8 * box[1][0]) + b >= grid->shape[across[1]]) continue;
            near[0] = b ? own - 1 : 0, near[1] = a ? own - columns : 0, near[2] = a && b ? own - columns - 1 : 0;
            near[3] = a && b + 1 < (int64_t)columns ? own - columns + 1 : 0;
            touch_read_column(&h, near, own);
            for (int n = 0; n < own->count; n++)
                if ((own->s[n].told[2] >> 8) + 1 < *least) *least = (own->s[n].told[2] >> 8) + 1;
        }
        touch_check(&h.b, error);
        if (error->code) return 0;
    }
    for (uint64_t i = 0; i < box[0][1] * box[1][1]; i++)
        for (int64_t a = 0; start[i] < depth && a < (depth + 7) >> 3; a++)
            if (inverted ? 8 * a < depth - start[i] : 8 * a + 8 > start[i]) {
                int64_t at[3];
                at[axis] = a, at[across[0]] = (int64_t)(box[0][0] + i / box[1][1]);
                at[across[1]] = (int64_t)(box[1][0] + i % box[1][1]);
                if (count == wide) return touch_fail(error, TOUCH_CUT, "bricks of a guess");
                out->list.key[count++] = touch_key(at[0], at[1], at[2]);
            }
    out->list.count = count;
    uint32_t *tag = (uint32_t *)touch_take_zero(arena, count, 4);
    if (!tag || !touch_map_make(&map, count, arena)) return touch_fail(error, TOUCH_MEMORY, "no room for a guess");
    touch_sort(out->list.key, tag, count);
    for (uint64_t i = 0; i < count; i++) touch_map_put(&map, out->list.key[i], (uint32_t)i);
    out->v = (touch_vector *)touch_take_zero(arena, 512 * count, sizeof *out->v);
    if (!out->v) return touch_fail(error, TOUCH_MEMORY, "no room for a guess");
    for (int64_t a = 0; a < (int64_t)(8 * box[0][1]); a++)
        for (int64_t b = 0; b < (int64_t)columns; b++) {
            int32_t place[3];
            const touch_column *own = column + a * (int64_t)columns + b;
            place[axis] = 0, place[across[0]] = (int32_t)(8 * box[0][0]) + (int32_t)a;
            place[across[1]] = (int32_t)(8 * box[1][0]) + (int32_t)b;
            if (own->count) touch_lay_column(&h, own, place, axis, inverted, depth, &map, out);
        }
    return 1; /* what was taken behind the list goes with the frame */
}

/* -- the exact mode of coder touch (docs/format/touch-exact.md) ------------------------------------------------------ */

enum { TOUCH_EXACT_TABLE = 1 << 18, TOUCH_EXACT_SETS = 111 };

typedef struct {
    uint32_t s[3]; /* level and vertex, or components in the order of floats */
    uint8_t is_held;
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
    touch_context list[TOUCH_LIST_CONTEXTS], c[TOUCH_EXACT_TABLE];
    int64_t list_w[TOUCH_LIST_WEIGHTS], w[TOUCH_EXACT_SETS][4];
} touch_exact_models;

typedef struct {
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
    for (int n = 0; n < 3; n++) p[*count].p[n] = (int64_t)floor(v[n] * 1099511627776.0 + 0.5);
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

/* The vertices of codebook B (docs/format/paper.md): 1 to 20 ico1 to ico20, 21 to 25 octa1 to octa5. */
static const float *touch_codebook(int book, uint32_t *vertices, touch_arena *arena) {
    uint64_t count = 0, kept = 0;
    touch_point *p = (touch_point *)touch_take(arena, 24576, sizeof *p);
    float *out = (float *)touch_take(arena, 3 * 4098, 4);
    if (!p || !out) return 0;
    if (book > 20) {
        for (int n = 0; n < 8; n++) {
            double t[3][3] = {{0}};
            t[0][0] = n & 4 ? -1 : 1, t[1][1] = n & 2 ? -1 : 1, t[2][2] = n & 1 ? -1 : 1;
            touch_split(p, &count, (const double(*)[3])t, book - 20);
        }
    } else {
        double corner[12][3], weight[21], golden = (1 + sqrt(5.0)) / 2;
        for (int n = 0; n < 12; n++) {
            int turn = n / 4;
            corner[n][turn] = 0, corner[n][(turn + 1) % 3] = n & 2 ? -1 : 1;
            corner[n][(turn + 2) % 3] = n & 1 ? -golden : golden;
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
        if (!i || touch_point_less(p + kept - 1, p + i)) {
            p[kept] = p[i];
            for (int n = 0; n < 3; n++) out[3 * kept + (uint64_t)n] = (float)((double)p[i].p[n] / 1099511627776.0);
            kept++;
        }
    *vertices = (uint32_t)kept;
    return out;
}

static uint32_t touch_mixed(uint32_t h, int64_t value) {
    int64_t t = (int64_t)(((int64_t)h ^ value) & 4194303) * 0x2f0b4c47 + value;
    return (uint32_t)((t ^ (t >> 19)) & 4194303);
}

static touch_context *touch_exact_at(touch_exact_models *m, uint32_t h, int64_t a, int64_t b, int64_t c, int count) {
    h = touch_mixed(h, a);
    if (count > 1) h = touch_mixed(h, b);
    if (count > 2) h = touch_mixed(h, c);
    return m->c + (h & (TOUCH_EXACT_TABLE - 1));
}

static touch_context *touch_exact_about(touch_exact_models *m, uint32_t kind, int64_t guess, int64_t node, int left) {
    int64_t ahead = touch_clip(node - (guess >> (left + 1)), -2, 2);
    return touch_exact_at(m, kind, ((ahead + 2) * 8 + (((guess * 4) >> left) & 7)) * 32 + left, 0, 0, 1);
}

/* The symbol of plane p: t, z, y, x, zy are those of rows 1 to 5, -1 where there is none. */
static int64_t touch_exact_symbol(touch_code *b, touch_exact_models *m, int p, uint64_t size, const int64_t row[5],
                                  int64_t last) {
    int64_t t = row[0], z = row[1], y = row[2], x = row[3], zy = row[4], node = 0;
    int width = touch_bits_of(size - 1);
    int64_t guess = z >= 0 ? z : y >= 0 ? y : x >= 0 ? x : t >= 0 ? t : 0;
    if (z >= 0 && y >= 0 && zy >= 0) guess = touch_clip(z + y - zy, 0, (int64_t)size - 1);
    int64_t late = t >= 0 ? t : guess;
    for (int left = width - 1; left >= 0; left--) {
        touch_context *c[4];
        int64_t n = 32 * node + left;
        c[0] = touch_exact_about(m, 32u + (uint32_t)p, guess, node, left);
        c[1] = touch_exact_about(m, 36u + (uint32_t)p, late, node, left);
        c[2] = touch_exact_at(m, 40u + (uint32_t)p, z, n, 0, 2);
        c[3] = touch_exact_at(m, 44u + (uint32_t)p, last, x, n, 3);
        node = 2 * node + touch_mix(b, c, m->w[32 * p + width - 1 - left], 4);
    }
    return node;
}

static int touch_is_same(const touch_symbols *a, const touch_symbols *b, int planes) {
    if (a->is_held != b->is_held) return 0;
    for (int n = 0; n < planes && a->is_held; n++)
        if (a->s[n] != b->s[n]) return 0;
    return 1;
}

/* A sample by the rows 1 to 14 (here from 0). */
static touch_symbols touch_exact_sample(touch_code *b, touch_exact_models *m, const touch_symbols row[14], int planes,
                                        const uint64_t size[3], touch_cursor *error) {
    static const int order[5] = {14, 1, 2, 3, 4};
    touch_symbols out = row[13];
    uint32_t same[15], c;
    for (int n = 0; n < 5; n++) {
        c = (uint32_t)order[n], same[c] = 0;
        for (int k = 0; k < 14; k++) same[c] |= (uint32_t)touch_is_same(row + k, row + c - 1, planes) << k;
    }
    for (int n = 0; n < 5; n++) {
        touch_context *first, *second;
        c = (uint32_t)order[n];
        if (c != 14 && (!row[c - 1].is_held || same[c] & ((1u << (c - 1)) - 1))) continue;
        first = touch_exact_at(m, c, same[c], 0, 0, 1), second = touch_exact_at(m, 16 + c, same[c] & 31, same[2], 0, 2);
        if (touch_mix2(b, first, second, m->w[96 + c])) return row[c - 1];
    }
    out.is_held = 1;
    for (int p = 0; p < planes; p++) {
        int64_t about[5];
        for (int k = 0; k < 5; k++) about[k] = row[k].is_held ? (int64_t)row[k].s[p] : -1;
        int64_t symbol = touch_exact_symbol(b, m, p, size[p], about, p ? (int64_t)out.s[p - 1] : 0);
        touch_need(error, symbol < (int64_t)size[p], "a symbol that there is not");
        out.s[p] = (uint32_t)symbol;
        if (error->code) return out;
    }
    return out;
}

static uint32_t touch_f32_bits(float f) {
    uint32_t bits;
    memcpy(&bits, &f, 4);
    return bits;
}

static const int8_t touch_beside[12][3] = {{0, 0, -1}, {0, -1, 0}, {-1, 0, 0}, {0, -1, -1}, {-1, 0, -1}, {-1, -1, 0},
                                           {0, -1, 1}, {-1, 1, 0}, {-1, 0, 1}, {0, 0, -2}, {0, -2, 0}, {-2, 0, 0}};

/* The samples of a brick; whether there is any. */
static int touch_exact_brick(touch_code *b, touch_exact_models *m, const touch_grid *grid, const touch_exact *before,
                             const touch_map *known, const touch_map *map, touch_exact *out, uint64_t slot,
                             const uint64_t size[3], touch_cursor *error) {
    int planes = out->book ? 2 : 3, high[3], k, any = 0;
    int32_t at[3];
    touch_place(out->list.key[slot], at), touch_brick_samples(grid, at, high);
    int64_t late = before ? touch_map_get(known, out->list.key[slot]) : -1;
    for (int x = 0; x < high[0]; x++)
        for (int y = 0; y < high[1]; y++)
            for (int z = 0; z < high[2]; z++) {
                touch_symbols row[14], *own = out->own + 512 * slot + (uint64_t)(64 * x + 8 * y + z);
                float *force = out->force + 3 * (own - out->own);
                memset(row, 0, sizeof row);
                if (late >= 0) {
                    uint64_t place = 512 * (uint64_t)late + (uint64_t)(64 * x + 8 * y + z);
                    row[0] = before->own[place];
                    if (before->book != out->book && row[0].is_held)
                        for (int n = 0; n < 3; n++) {
                            uint32_t bits = touch_f32_bits(before->force[3 * place + (uint64_t)n]);
                            row[0].s[n] = bits >> 31 ? 0xffffffffu - bits : bits + 0x80000000u;
                        }
                }
                for (int n = 0; n < 12; n++) {
                    int64_t to[3];
                    to[0] = 8 * at[0] + x + touch_beside[n][0], to[1] = 8 * at[1] + y + touch_beside[n][1];
                    to[2] = 8 * at[2] + z + touch_beside[n][2];
                    int64_t there = (to[0] >> 3) == at[0] && (to[1] >> 3) == at[1] && (to[2] >> 3) == at[2]
                                ? (int64_t)slot
                                : touch_map_get(map, touch_key(to[0] >> 3, to[1] >> 3, to[2] >> 3));
                    if (there >= 0)
                        row[1 + n] = out->own[512 * there + 64 * (to[0] & 7) + 8 * (to[1] & 7) + (to[2] & 7)];
                }
                *own = touch_exact_sample(b, m, row, planes, size, error);
                if (error->code) return 0;
                if (!own->is_held) continue;
                any = 1, k = 0;
                for (int n = 0; n < 3; n++) {
                    uint32_t bits;
                    if (out->book) {
                        const uint8_t *l = out->levels + 4 * (uint64_t)own->s[0];
                        float level = touch_f32_of((uint32_t)l[0] | (uint32_t)l[1] << 8 | (uint32_t)l[2] << 16 |
                                                   (uint32_t)l[3] << 24);
                        force[n] = level * out->vertices[3 * (uint64_t)own->s[1] + (uint64_t)n];
                    } else {
                        bits = own->s[n] >> 31 ? own->s[n] - 0x80000000u : 0xffffffffu - own->s[n];
                        force[n] = touch_f32_of(bits);
                    }
                    bits = touch_f32_bits(force[n]);
                    k |= bits != 0;
                    touch_need(error, (bits >> 23 & 255) != 255, "a force that is not finite");
                }
                touch_need(error, k, "a force of zero");
            }
    return any;
}

static int touch_read_exact(touch_cursor c, const touch_grid *grid, const touch_tables *tables, touch_exact_models *m,
                            const touch_exact *before, touch_exact *out, touch_arena *arena, touch_cursor *error) {
    uint64_t size[3];
    touch_map known, map;
    touch_list none;
    none.key = 0, none.count = 0;
    if (before) *out = *before;
    else memset(out, 0, sizeof *out);
    out->book = (int)touch_u(&c, 1);
    if (before) touch_need(&c, !out->book || out->book == before->book, "another codebook than that of the frame before");
    else if (out->book) {
        touch_need(&c, out->book <= 25, "a codebook that there is not");
        out->level_count = (uint32_t)touch_u(&c, 2);
        touch_need(&c, out->level_count > 0, "a palette without levels");
        out->levels = touch_skip(&c, 4 * (uint64_t)out->level_count);
        for (uint64_t i = 0; i < out->level_count && !c.code; i++)
            touch_need(&c, (out->levels[4 * i + 3] & 0x7f) != 0x7f || !(out->levels[4 * i + 2] & 0x80),
                       "a level that is not finite");
        if (!c.code) {
            out->vertices = touch_codebook(out->book, &out->vertex_count, arena);
            if (!out->vertices) return touch_fail(error, TOUCH_MEMORY, "no room for a codebook");
        }
    }
    if (c.code) return touch_fail(error, c.code, c.what);
    size[0] = out->book ? out->level_count : (uint64_t)1 << 32, size[2] = (uint64_t)1 << 32;
    size[1] = out->book ? out->vertex_count : (uint64_t)1 << 32;
    touch_code b = touch_code_of(&c, tables);
    if (!touch_read_list(&b, m->list, m->list_w, grid->shape, before ? before->list : none, &out->list, arena, error))
        return 0;
    if (4 * out->list.count > 64 + 16 * b.size) return touch_fail(error, TOUCH_CUT, "bricks without bytes");
    out->own = (touch_symbols *)touch_take_zero(arena, 512 * out->list.count, sizeof *out->own);
    out->force = (float *)touch_take_zero(arena, 3 * 512 * out->list.count, 4);
    if (!out->own || !out->force || !touch_map_make(&map, out->list.count, arena) ||
        !touch_map_make(&known, before ? before->list.count : 0, arena))
        return touch_fail(error, TOUCH_MEMORY, "no room for a frame");
    for (uint64_t i = 0; before && i < before->list.count; i++) touch_map_put(&known, before->list.key[i], (uint32_t)i);
    for (uint64_t i = 0; i < out->list.count; i++) {
        touch_map_put(&map, out->list.key[i], (uint32_t)i);
        if (!touch_exact_brick(&b, m, grid, before, &known, &map, out, i, size, error) && !error->code)
            touch_fail(error, TOUCH_CORRUPT, "a brick without a force");
        if (error->code) return 0;
    }
    touch_close(&b, 4 * out->list.count, error);
    return !error->code;
}

/* -- supports, whole numbers (docs/format/bits.md), vibration (vibration.md) ----------------------------------------- */

enum { TOUCH_SUPPORT_CONTEXTS = TOUCH_LIST_CONTEXTS + 5120, TOUCH_NUMBER_CONTEXTS = 8736, TOUCH_NUMBER_WEIGHTS = 96 };

typedef struct { /* samples of bricks that are set, a byte each */
    touch_list list;
    uint8_t *is_set;
} touch_set;

typedef struct {
    touch_context c[TOUCH_SUPPORT_CONTEXTS];
    int64_t w[TOUCH_LIST_WEIGHTS + 16];
} touch_set_models;

static int touch_is_set(const touch_set *s, const touch_map *map, int64_t x, int64_t y, int64_t z) {
    int64_t slot = touch_map_get(map, touch_key(x >> 3, y >> 3, z >> 3));
    return slot >= 0 && s->is_set[512 * slot + 64 * (x & 7) + 8 * (y & 7) + (z & 7)];
}

static int touch_read_set(touch_code *b, touch_set_models *m, const touch_grid *grid, const touch_set *before,
                          touch_set *out, touch_arena *arena, touch_cursor *error) {
    static const int8_t near[12][3] = {{-1, 0, 0}, {0, -1, 0}, {0, 0, -1}, {-1, 0, 1}, {0, -1, -1}, {0, -1, 1},
                                       {-1, -1, 0}, {-2, 0, 0}, {0, -2, 0}, {-1, 1, 0}, {-1, 1, 1}, {0, 0, -2}};
    static const int8_t late[7][3] = {{0, 0, 0}, {0, 0, -1}, {0, 0, 1}, {0, -1, 0}, {0, 1, 0}, {-1, 0, 0}, {1, 0, 0}};
    touch_map map, old;
    if (!touch_read_list(b, m->c, m->w, grid->shape, before->list, &out->list, arena, error)) return 0;
    out->is_set = (uint8_t *)touch_take_zero(arena, 512 * out->list.count, 1);
    if (!out->is_set || !touch_map_make(&map, out->list.count, arena) || !touch_map_make(&old, before->list.count, arena))
        return touch_fail(error, TOUCH_MEMORY, "no room for a support");
    for (uint64_t i = 0; i < before->list.count; i++) touch_map_put(&old, before->list.key[i], (uint32_t)i);
    for (uint64_t i = 0; i < out->list.count; i++) {
        int32_t at[3];
        int high[3], n, any = 0;
        touch_place(out->list.key[i], at), touch_brick_samples(grid, at, high);
        touch_map_put(&map, out->list.key[i], (uint32_t)i);
        for (int x = 0; x < high[0]; x++)
            for (int y = 0; y < high[1]; y++)
                for (int z = 0; z < high[2]; z++) {
                    int64_t X = 8 * (int64_t)at[0] + x, Y = 8 * (int64_t)at[1] + y, Z = 8 * (int64_t)at[2] + z;
                    uint32_t beside = 0, was = 0;
                    touch_context *c = m->c + TOUCH_LIST_CONTEXTS;
                    for (n = 0; n < 12; n++)
                        beside |= (uint32_t)touch_is_set(out, &map, X + near[n][0], Y + near[n][1], Z + near[n][2]) << n;
                    for (n = 0; n < 7 && before->list.count; n++)
                        was |= (uint32_t)touch_is_set(before, &old, X + late[n][0], Y + late[n][1], Z + late[n][2]) << n;
                    n = touch_mix2(b, c + beside, c + 4096 + (8 * was + (beside & 7)),
                                   m->w + TOUCH_LIST_WEIGHTS + 2 * (beside & 7));
                    out->is_set[512 * i + (uint64_t)(64 * x + 8 * y + z)] = (uint8_t)n, any |= n;
                }
        touch_check(b, error);
        if (!touch_need(error, any, "a brick without samples")) return 0;
    }
    return 1;
}

typedef struct { /* a list of whole numbers while it is told */
    touch_context c[TOUCH_NUMBER_CONTEXTS];
    int64_t w[TOUCH_NUMBER_WEIGHTS], r[3];
} touch_numbers;

static void touch_numbers_fresh(touch_numbers *t) {
    touch_fresh(t->c, TOUCH_NUMBER_CONTEXTS, t->w, TOUCH_NUMBER_WEIGHTS);
    t->r[0] = t->r[1] = t->r[2] = 0;
}

static int64_t touch_digits(int64_t r, int most) { /* with the sign, about `most` */
    int d = touch_bits_of((uint64_t)(r < 0 ? -r : r));
    d = d < most ? d : most;
    return r < 0 ? most - d : most + d;
}

static int64_t touch_number(touch_code *b, touch_numbers *t) {
    int64_t near = 0, size = 7 * touch_digits(t->r[0], 10) + touch_digits(t->r[1], 3), v = 0;
    for (int n = 0; n < 3; n++) near = 5 * near + touch_clip(t->r[n], -2, 2) + 2;
#define TOUCH_BIT(j) touch_mix3(b, t->c + (j), t->c + 32 + 32 * near + (j), t->c + 4032 + 32 * size + (j), t->w + 3 * (j))
    if (TOUCH_BIT(0)) {
        int negative = TOUCH_BIT(1), l = 1;
        while (TOUCH_BIT(1 + (l < 14 ? l : 14)) && l < 62) l++;
        v = 1;
        if (l > 1) {
            int low = 16 + (l < 15 ? l : 15);
            v = (int64_t)(2 | TOUCH_BIT(low)) << (l - 2);
            v += touch_even(b, l - 2);
        }
        v = negative ? -v : v;
    }
#undef TOUCH_BIT
    t->r[2] = t->r[1], t->r[1] = t->r[0], t->r[0] = v;
    return v;
}

/* -- fields that are asked at points --------------------------------------------------------------------------------- */

static uint32_t touch_brick_number(const touch_grid *g, int64_t x, int64_t y, int64_t z) {
    return (uint32_t)((x * ((g->shape[1] + 7) >> 3) + y) * ((g->shape[2] + 7) >> 3) + z);
}

static int64_t touch_field_slot(const touch_field *f, int64_t x, int64_t y, int64_t z) {
    uint32_t number = touch_brick_number(&f->grid, x, y, z) + 1, at = touch_hash(number, f->mask);
    while (f->table[2 * at] && f->table[2 * at] != number) at = (at + 1) & f->mask;
    return f->table[2 * at] ? (int64_t)f->table[2 * at + 1] : -1;
}

/* An empty field with a table for so many bricks, and its numbers, to be written. */
static touch_field *touch_field_make(const touch_grid *grid, uint64_t bricks, uint32_t **table, float **forces,
                                     touch_arena *arena) {
    touch_field *f = (touch_field *)touch_take(arena, 1, sizeof *f);
    uint64_t size = 4;
    while (size < 2 * bricks + 2) size *= 2;
    *table = (uint32_t *)touch_take_zero(arena, 2 * size, 4);
    *forces = (float *)touch_take_zero(arena, 1536 * bricks, 4);
    if (!f || !*table || !*forces) return 0;
    f->grid = *grid, f->bricks = (uint32_t)bricks, f->mask = (uint32_t)(size - 1), f->table = *table;
    f->forces_n = *forces;
    return f;
}

static void touch_field_put(const touch_field *f, uint32_t *table, uint64_t key, uint32_t slot) {
    int32_t p[3];
    uint32_t number, at;
    touch_place(key, p);
    number = touch_brick_number(&f->grid, p[0], p[1], p[2]) + 1, at = touch_hash(number, f->mask);
    while (table[2 * at]) at = (at + 1) & f->mask;
    table[2 * at] = number, table[2 * at + 1] = slot;
}

/* Samples: a point so near to a plane of the lattice lies on it, in the cell towards greater indices, whatever the
   rounding of its metres says. */
#define TOUCH_ON_PLANE 1e-9

/* The eight samples about a point, and where it lies between them; 0: nothing is there. */
static int touch_corners_at(const touch_field *f, const double p[3], float c[8][3], double part[3]) {
    int64_t low[3], brick[3], last = -2;
    uint64_t asked = ~(uint64_t)0;
    int any = 0;
    for (int n = 0; n < 3; n++) {
        double at = (p[n] - f->grid.origin_m[n]) / f->grid.spacing_m[n];
        if (!(at > -1 - TOUCH_ON_PLANE && at < f->grid.shape[n])) return 0;
        low[n] = (int64_t)floor(at + TOUCH_ON_PLANE), part[n] = at - (double)low[n];
        if (!(part[n] > TOUCH_ON_PLANE)) part[n] = 0;
    }
    for (int n = 0; n < 8; n++) {
        int64_t at[3];
        at[0] = low[0] + (n >> 2), at[1] = low[1] + (n >> 1 & 1), at[2] = low[2] + (n & 1);
        c[n][0] = c[n][1] = c[n][2] = 0;
        if (at[0] < 0 || at[1] < 0 || at[2] < 0 || at[0] >= f->grid.shape[0] || at[1] >= f->grid.shape[1] ||
            at[2] >= f->grid.shape[2])
            continue;
        for (int k = 0; k < 3; k++) brick[k] = at[k] >> 3;
        uint64_t key = touch_key(brick[0], brick[1], brick[2]);
        if (key != asked) last = touch_field_slot(f, brick[0], brick[1], brick[2]), asked = key;
        if (last < 0) continue;
        memcpy(c[n], f->forces_n + 3 * (512 * last + 64 * (at[0] & 7) + 8 * (at[1] & 7) + (at[2] & 7)), 12), any = 1;
    }
    return any;
}

static void touch_sample(const touch_field *f, const double p[3], double out[3]) {
    float c[8][3];
    double t[3];
    out[0] = out[1] = out[2] = 0;
    if (!touch_corners_at(f, p, c, t)) return;
    for (int n = 0; n < 8; n++) {
        double w = (n & 4 ? t[0] : 1 - t[0]) * (n & 2 ? t[1] : 1 - t[1]) * (n & 1 ? t[2] : 1 - t[2]);
        for (int k = 0; k < 3; k++) out[k] += w * c[n][k];
    }
}

static void touch_slopes(const touch_field *f, const double p[3], double out[9]) {
    float c[8][3];
    double t[3];
    for (int n = 0; n < 9; n++) out[n] = 0;
    if (!touch_corners_at(f, p, c, t)) return;
    for (int n = 0; n < 8; n++)
        for (int axis = 0; axis < 3; axis++) {
            double w = (n & (4 >> axis) ? 1 : -1) / f->grid.spacing_m[axis];
            for (int k = 0; k < 3; k++)
                if (k != axis) w *= n & (4 >> k) ? t[k] : 1 - t[k];
            for (int k = 0; k < 3; k++) out[3 * k + axis] += w * c[n][k];
        }
}

/* The force of a part, and, where asked, its slopes. */
static void touch_part_force(const touch_frame *frame, const touch_part *part, const double p[3], double out[3],
                             double *slopes) {
    double d[3], own[3], there[3];
    const double *r = part->rotation;
    for (int n = 0; n < 3; n++) d[n] = p[n] - part->position_m[n];
    for (int n = 0; n < 3; n++) there[n] = frame->is_placed ? r[n] * d[0] + r[3 + n] * d[1] + r[6 + n] * d[2] : p[n];
    touch_sample(part->field, there, own);
    double size = sqrt(own[0] * own[0] + own[1] * own[1] + own[2] * own[2]);
    for (int n = 0; n < 3; n++)
        out[n] = frame->is_placed ? r[3 * n] * own[0] + r[3 * n + 1] * own[1] + r[3 * n + 2] * own[2] : own[n];
    if (slopes) {
        double j[9], half[9];
        touch_slopes(part->field, there, j);
        for (int n = 0; n < 3; n++)
            for (int k = 0; k < 3; k++)
                half[3 * n + k] = frame->is_placed ? r[3 * n] * j[k] + r[3 * n + 1] * j[3 + k] + r[3 * n + 2] * j[6 + k]
                                                   : j[3 * n + k];
        for (int n = 0; n < 3; n++)
            for (int k = 0; k < 3; k++)
                slopes[3 * n + k] = frame->is_placed ? half[3 * n] * r[3 * k] + half[3 * n + 1] * r[3 * k + 1] +
                                                           half[3 * n + 2] * r[3 * k + 2]
                                                     : half[3 * n + k];
    }
    if (frame->surface_damping_n_s_per_m > 0 && size > 1e-9 * frame->force_max_n) {
        const double *v = part->velocity_m_s, *w = part->spin_rad_s;
        double b = frame->surface_damping_n_s_per_m;
        out[0] += b * (v[0] + w[1] * d[2] - w[2] * d[1]);
        out[1] += b * (v[1] + w[2] * d[0] - w[0] * d[2]);
        out[2] += b * (v[2] + w[0] * d[1] - w[1] * d[0]);
        if (slopes) {
            slopes[1] -= b * w[2], slopes[2] += b * w[1], slopes[3] += b * w[2];
            slopes[5] -= b * w[0], slopes[6] -= b * w[1], slopes[7] += b * w[0];
        }
    }
}

void touch_force(const touch_frame *frame, double x, double y, double z, double newtons[3]) {
    double p[3], one[3];
    p[0] = x, p[1] = y, p[2] = z, newtons[0] = newtons[1] = newtons[2] = 0;
    for (uint32_t i = 0; i < frame->parts; i++) {
        touch_part_force(frame, frame->part + i, p, one, 0);
        for (int n = 0; n < 3; n++) newtons[n] += one[n];
    }
    double size = sqrt(newtons[0] * newtons[0] + newtons[1] * newtons[1] + newtons[2] * newtons[2]);
    for (int n = 0; n < 3 && frame->is_placed && size > frame->force_max_n; n++) newtons[n] *= frame->force_max_n / size;
}

void touch_gradient(const touch_frame *frame, double x, double y, double z, double n_per_m[9]) {
    double p[3], one[3], sum[3], slopes[9];
    p[0] = x, p[1] = y, p[2] = z, sum[0] = sum[1] = sum[2] = 0;
    for (int n = 0; n < 9; n++) n_per_m[n] = 0;
    for (uint32_t i = 0; i < frame->parts; i++) {
        touch_part_force(frame, frame->part + i, p, one, slopes);
        for (int n = 0; n < 3; n++) sum[n] += one[n];
        for (int n = 0; n < 9; n++) n_per_m[n] += slopes[n];
    }
    double size = sqrt(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]);
    if (!frame->is_placed || !(size > frame->force_max_n)) return;
    for (int k = 0; k < 3; k++) { /* cut to a length: its share across the force, nothing along it */
        double along = (sum[0] * n_per_m[k] + sum[1] * n_per_m[3 + k] + sum[2] * n_per_m[6 + k]) / (size * size);
        for (int n = 0; n < 3; n++) n_per_m[3 * n + k] = frame->force_max_n / size * (n_per_m[3 * n + k] - along * sum[n]);
    }
}

/* An amplitude exceeds the largest before it by a millionth: rounding never decides between equals. */
static int touch_adds_more(double amplitude, double largest) { return amplitude > largest * (1 + 1e-6); }

void touch_vibration(const touch_frame *frame, double x, double y, double z, double both[2]) {
    float c[8][3];
    double p[3], t[3], largest = 0;
    both[0] = both[1] = 0, p[0] = x, p[1] = y, p[2] = z;
    if (!frame->vibration || !touch_corners_at(frame->vibration, p, c, t)) return;
    for (int n = 0; n < 8; n++) { /* amplitudes between samples; the frequency of the sample that adds most to them */
        double w = (n & 4 ? t[0] : 1 - t[0]) * (n & 2 ? t[1] : 1 - t[1]) * (n & 1 ? t[2] : 1 - t[2]) * c[n][0];
        both[0] += w;
        if (touch_adds_more(w, largest)) largest = w, both[1] = c[n][1];
    }
}

/* -- segments -------------------------------------------------------------------------------------------------------- */

typedef struct { /* who decodes fields on one lattice: of the file, or of a body */
    touch_grid grid;
    int is_exact;
    touch_steps steps;
    touch_models *models;
    touch_exact_models *exact_models;
    touch_units units; /* of the frame before */
    touch_exact exact;
    int has_exact;
} touch_fields;

typedef struct {
    touch_object told;
    const touch_field *rigid;
    const touch_field **deforming; /* of each frame of the segment */
    double position_step_m;
    int64_t one;   /* steps of a quaternion that make 1 */
    int64_t *pose; /* [frames + 2][7], from the frame before the segment to the one behind it */
} touch_body;

typedef struct { /* what vibrates in the frames of a segment */
    touch_set set;
    int64_t *value[2];
    uint64_t samples;
} touch_vibrating;

typedef struct touch_state {
    touch_tables tables;
    touch_fields fields; /* of the file, unless it has bodies */
    touch_body *body;
    double surface_damping;
    touch_entry segment;
    uint32_t next, segment_number; /* in the segment */
    touch_cursor at;               /* in its body */
    uint64_t mark;                 /* of the arena, behind what the segment keeps */
    touch_vibrating *vibrating;
    uint64_t full; /* bytes of the arena, without what bodies keep at its end */
} touch_state;

static int touch_check_parameters(touch_bytes b, int *is_exact, touch_cursor *error) {
    /* modes 0 to 3, and mode 0 with masking */
    static const double least[5][4] = {{0.001, 0}, {0.001, 0, 5e-324}, {5e-324}, {0}, {0.001, 0, 5e-324, 1e-6}};
    static const double most[5][4] = {{1, 1e308}, {1, 1e308, 90}, {1e308}, {0}, {1, 1e308, 1.0000000000000002, 1.0000000000000002}};
    static const int count[5] = {2, 3, 1, 0, 4};
    touch_cursor c = touch_cursor_of(b.bytes, b.size);
    int version, mode, rule;
    if (b.size < 2) return touch_fail(error, TOUCH_CORRUPT, "the parameters of coder touch");
    version = (int)touch_u(&c, 1), mode = (int)touch_u(&c, 1);
    if (version != 1) return touch_fail(error, TOUCH_VERSION, "a version of coder touch that is not known");
    touch_need(error, (mode >> 3 & 3) <= 2 && mode >> 5 <= !(mode & 3), "the parameters of coder touch");
    rule = mode >> 5 ? 4 : mode & 3;
    touch_need(error, touch_left(&c) == (uint64_t)(8 * count[rule]), "the parameters of coder touch");
    for (int n = 0; n < count[rule] && !error->code; n++) {
        double value = touch_f64(&c);
        int is_open = most[rule][n] < 1e300 ? value < most[rule][n] : value <= 1.7976931348623157e308;
        touch_need(error, value >= least[rule][n] && is_open, "the parameters of coder touch");
    }
    *is_exact = rule == 3;
    return !error->code;
}

static void touch_models_fresh(touch_models *m) {
    touch_fresh(m->c, TOUCH_PASS_CONTEXTS, m->w, TOUCH_PASS_WEIGHTS);
    memset(m->blend, 0, sizeof m->blend);
}

static void touch_exact_fresh(touch_exact_models *m) {
    touch_fresh(m->list, TOUCH_LIST_CONTEXTS, m->list_w, TOUCH_LIST_WEIGHTS);
    touch_fresh(m->c, TOUCH_EXACT_TABLE, &m->w[0][0], 4 * TOUCH_EXACT_SETS);
}

/* The head of a segment's body; models and borders are taken from the arena. */
static int touch_begin_fields(touch_fields *f, touch_cursor *c, uint32_t frames, touch_arena *arena, touch_cursor *error) {
    uint64_t flags = touch_u(c, 1);
    touch_steps *s = &f->steps;
    touch_need(c, flags <= 1, "flags that there are not");
    memset(&f->units, 0, sizeof f->units), f->has_exact = 0;
    if (!f->is_exact) {
        int64_t border = 0;
        s->unit_n = touch_f32_of((uint32_t)touch_u(c, 4));
        touch_need(c, s->unit_n >= 1.17549435e-38f && s->unit_n <= 2.02824096e31f, "the unit");
        s->floor = (int64_t)touch_varint(c, 1, 1u << 16), s->rate = (int64_t)touch_varint(c, 0, 1u << 17);
        s->cross_floor = (int64_t)touch_varint(c, 1, 1u << 16), s->cross_rate = (int64_t)touch_varint(c, 0, 1u << 17);
        touch_need(c, s->floor >= 21 || s->rate >= 64, "a floor and a rate that are too fine");
        if (c->code) return touch_fail(error, c->code, c->what);
        for (int n = 0; n < 2; n++) { /* counted, then written */
            int64_t i = 1;
            if (n) s->border = (int32_t *)touch_take(arena, (uint64_t)s->borders, 4);
            if (n && !s->border) return touch_fail(error, TOUCH_MEMORY, "no room for a lattice of lengths");
            if (n) s->border[0] = 0;
            for (border = 0; border <= 1 << 26; i++) {
                int64_t step = (border * s->rate) >> 16;
                step = (step > 256 * s->floor ? step : 256 * s->floor) >> 4;
                border += step > 1 ? step : 1;
                if (n) s->border[i] = (int32_t)border;
            }
            s->borders = i;
        }
        f->models = (touch_models *)touch_take(arena, 1, sizeof *f->models);
        if (!f->models) return touch_fail(error, TOUCH_MEMORY, "no room for models");
        touch_models_fresh(f->models);
    } else {
        f->exact_models = (touch_exact_models *)touch_take(arena, 1, sizeof *f->exact_models);
        if (!f->exact_models) return touch_fail(error, TOUCH_MEMORY, "no room for models");
        touch_exact_fresh(f->exact_models);
    }
    if (flags) {
        touch_u(c, 2), touch_varint(c, 0, frames);
        for (int n = 0; n < 3; n++) touch_varint(c, 0, f->grid.shape[n]);
    }
    return c->code ? touch_fail(error, c->code, c->what) : 1;
}

/* A force that was sent as it is: from one to the next of a chunk. */
static int touch_read_exception(touch_cursor *c, const touch_grid *grid, uint64_t *brick, int64_t *last, int32_t place[3],
                                float force[3]) {
    uint64_t gap = touch_varint(c, 0, touch_brick_count(grid) - *brick), coded = touch_varint(c, 0, 1024);
    uint64_t by = (grid->shape[1] + 7) >> 3, bz = (grid->shape[2] + 7) >> 3;
    int64_t sample = (int64_t)(coded >> 1);
    if (gap) *last = -1;
    touch_need(c, sample > *last, "samples that do not ascend");
    *brick += gap, *last = sample;
    for (int n = 0; n < 3; n++) {
        uint32_t bits = coded & 1 ? 0 : (uint32_t)touch_u(c, 4);
        touch_need(c, (bits >> 23 & 255) != 255, "a force that is not finite");
        force[n] = touch_f32_of(bits);
    }
    place[0] = (int32_t)(8 * (*brick / (by * bz)) + (uint64_t)(sample >> 6));
    place[1] = (int32_t)(8 * (*brick / bz % by) + (uint64_t)(sample >> 3 & 7));
    place[2] = (int32_t)(8 * (*brick % bz) + (uint64_t)(sample & 7));
    for (int n = 0; n < 3; n++) touch_need(c, place[n] < (int64_t)grid->shape[n], "a sample beyond the grid");
    return !c->code;
}

/* The field of a decoded frame in `out`, with its exceptions; `scratch` is emptied again. */
static const touch_field *touch_make_field(const touch_fields *f, touch_cursor apart, touch_arena *out, touch_arena *scratch,
                                           touch_cursor *error) {
    const touch_list *list = f->is_exact ? &f->exact.list : &f->units.list;
    uint64_t mark = scratch->used, count = list->count, brick = 0;
    touch_cursor c = apart;
    touch_arena end;
    touch_map map;
    touch_field *field;
    uint32_t *table;
    float *forces, force[3];
    int64_t last = -1;
    int32_t place[3];
    if (!touch_map_make(&map, list->count + touch_left(&apart) / 2, scratch)) {
        touch_fail(error, TOUCH_MEMORY, "no room for a field");
        return 0;
    }
    for (uint64_t i = 0; i < list->count; i++) touch_map_put(&map, list->key[i], (uint32_t)i);
    while (c.at < c.end && touch_read_exception(&c, &f->grid, &brick, &last, place, force)) {
        uint64_t key = touch_key(place[0] >> 3, place[1] >> 3, place[2] >> 3);
        if (touch_map_get(&map, key) < 0) touch_map_put(&map, key, (uint32_t)count++);
    }
    if (c.code) {
        touch_fail(error, c.code, c.what);
        return 0;
    }
    if (out == scratch) { /* at its end, which is cut off */
        uint64_t bytes = 64 + sizeof *field + 48 * (count + 2) + 6144 * count;
        if (bytes <= scratch->size - scratch->used) scratch->size -= bytes;
        end = *scratch, end.size += bytes, end.used = scratch->size, out = &end;
    }
    field = touch_field_make(&f->grid, count, &table, &forces, out);
    if (!field) {
        touch_fail(error, TOUCH_MEMORY, "no room for a field");
        return 0;
    }
    for (uint64_t i = 0; i <= map.mask; i++)
        if (map.key[i]) touch_field_put(field, table, map.key[i] - 1, map.place[i]);
    for (uint64_t i = 0; i < 512 * list->count; i++)
        for (int n = 0; n < 3; n++)
            forces[3 * i + (uint64_t)n] = f->is_exact ? f->exact.force[3 * i + (uint64_t)n]
                                                      : f->steps.unit_n * (float)f->units.v[i].v[n];
    c = apart, brick = 0, last = -1;
    while (c.at < c.end && touch_read_exception(&c, &f->grid, &brick, &last, place, force)) {
        int64_t slot = touch_map_get(&map, touch_key(place[0] >> 3, place[1] >> 3, place[2] >> 3));
        memcpy(forces + 3 * (512 * slot + 64 * (place[0] & 7) + 8 * (place[1] & 7) + (place[2] & 7)), force, 12);
    }
    scratch->used = mark;
    return field;
}

/* Move what the next frame needs down to where the one before lay. */
static void *touch_keep(touch_arena *arena, const void *from, uint64_t bytes) {
    void *to = touch_piece(arena, bytes, 1, 0); /* no guard: it may overlap what it comes from */
    if (to && from) memmove(to, from, (size_t)bytes);
    return to;
}

/* The next frame of fields, into `out`; `mark` is where what the frame before left begins. */
static const touch_field *touch_next_field(touch_fields *f, touch_cursor *c, const touch_tables *tables, int is_first,
                                           uint64_t mark, touch_arena *arena, touch_arena *out, touch_cursor *error) {
    uint64_t how = touch_u(c, 1), support = touch_u(c, 1), amplitude = touch_u(c, 1);
    const touch_field *field;
    touch_need(c, how <= (f->is_exact ? 1u : 7u) && support + amplitude <= 255, "the first bytes of a frame");
    touch_need(c, !is_first || !(how & 1), "a first frame that needs the one before");
    touch_cursor guess = how & 2 ? touch_chunk(c) : touch_cursor_of(c->at, 0);
    touch_cursor payload = touch_chunk(c);
    touch_cursor apart = how & 4 ? touch_chunk(c) : touch_cursor_of(c->at, 0);
    touch_need(c, c->code || ((!(how & 2) || touch_left(&guess)) && (!(how & 4) || touch_left(&apart))), "an empty chunk");
    if (c->code) {
        touch_fail(error, c->code, c->what);
        return 0;
    }
    if (f->is_exact) {
        touch_exact next;
        if (!(how & 1)) touch_exact_fresh(f->exact_models);
        if (!touch_read_exact(payload, &f->grid, tables, f->exact_models, how & 1 && f->has_exact ? &f->exact : 0, &next,
                              arena, error))
            return 0;
        f->exact = next, f->has_exact = 1;
        field = touch_make_field(f, apart, out, arena, error);
        arena->used = mark; /* each piece moves down, over what is no longer needed, in the order of places */
        if (field) {
            const void *vertices = next.vertices, *own = next.own, *force = next.force, *key = next.list.key;
            uint64_t n = 512 * next.list.count;
            int is_low = next.vertices && (const uint8_t *)next.vertices < (const uint8_t *)next.list.key;
            if (is_low) f->exact.vertices = (const float *)touch_keep(arena, vertices, 12 * (uint64_t)next.vertex_count);
            f->exact.list.key = (uint64_t *)touch_keep(arena, key, 8 * next.list.count);
            f->exact.own = (touch_symbols *)touch_keep(arena, own, n * sizeof *next.own);
            f->exact.force = (float *)touch_keep(arena, force, 12 * n);
        }
        return field;
    }
    {
        touch_units reference = f->units, next;
        if (!(how & 1)) touch_models_fresh(f->models), memset(&reference, 0, sizeof reference);
        if (how & 2) {
            uint64_t kind = touch_u(&guess, 1);
            if (!touch_need(error, kind <= 1, "a guess of a kind that there is not")) return 0;
            if (!(kind ? touch_columns : touch_spline)(guess, &f->grid, tables, &reference, arena, error)) return 0;
        }
        if (!touch_read_frame(payload, &f->grid, &f->steps, tables, f->models, &reference, &next, arena, error)) return 0;
        f->units = next;
        field = touch_make_field(f, apart, out, arena, error);
        arena->used = mark;
        f->units.list.key = (uint64_t *)touch_keep(arena, next.list.key, 8 * next.list.count);
        f->units.v = (touch_vector *)touch_keep(arena, next.v, 512 * next.list.count * sizeof *next.v);
    }
    return field;
}

/* Poses of a body in a segment: seven whole numbers a frame. */
static int touch_read_poses(touch_cursor c, const touch_tables *tables, const touch_body *body, uint32_t frames,
                            int64_t *out, touch_numbers *told, touch_cursor *error) {
    touch_code b = touch_code_of(&c, tables);
    int64_t head[14];
    touch_numbers_fresh(told);
    for (int n = 0; n < 14; n++) head[n] = touch_number(&b, told);
    for (int n = 0; n < 7; n++)
        if (!touch_need(error, head[n] >= 0 && head[n] <= 3, "a predictor that there is not")) return 0;
    for (int n = 0; n < 7; n++) {
        for (uint32_t i = 0; i < frames; i++) out[7 * i + (uint32_t)n] = 0;
        if (head[n]) touch_numbers_fresh(told);
        for (uint32_t i = 1; i < frames && head[n]; i++) {
            out[7 * i + (uint32_t)n] = touch_number(&b, told);
            if (b.place > b.size + 6) return touch_fail(error, TOUCH_CUT, "poses that end too early");
        }
        for (int k = 0; k < head[n]; k++)
            for (uint32_t i = 1; i < frames; i++)
                out[7 * i + (uint32_t)n] =
                    (int64_t)((uint64_t)out[7 * i + (uint32_t)n] + (uint64_t)out[7 * (i - 1) + (uint32_t)n]);
        for (uint32_t i = 0; i < frames; i++)
            out[7 * i + (uint32_t)n] = (int64_t)((uint64_t)out[7 * i + (uint32_t)n] + (uint64_t)head[7 + n]);
    }
    touch_close(&b, 0, error);
    for (uint32_t i = 0; i < frames && !error->code; i++) {
        int64_t most = (int64_t)1 << 50, squares = 0;
        for (int n = 0; n < 7; n++) {
            int64_t v = out[7 * i + (uint32_t)n];
            int holds = v <= (n < 3 ? most : body->one) && -v <= (n < 3 ? most : body->one) && v != INT64_MIN;
            if (!touch_need(error, holds, "a pose beyond its limit")) return 0;
            if (n > 2) squares += v * v;
        }
        touch_need(error, squares >= (body->one - 1) * (body->one - 1) && squares <= (body->one + 1) * (body->one + 1),
                   "a quaternion that is not unit");
    }
    return !error->code;
}

static touch_cursor touch_segment_body(const touch_file *file, uint32_t n, touch_entry *entry) {
    touch_entry e = touch_entry_at(file, n);
    if (entry) *entry = e;
    return touch_cursor_of(file->data + e.offset + 16 + 6, e.length - 20 - 6);
}

/* The fields of a body that deforms, of all frames of a segment: they stay at the end of the decoder's arena. */
static int touch_read_deforming(touch_decoder *d, touch_body *body, touch_cursor c, uint32_t frames, touch_cursor *error) {
    uint64_t begin = d->arena.used;
    touch_fields own;
    memset(&own, 0, sizeof own), own.grid = body->told.grid;
    if (!touch_check_parameters(body->told.parameters, &own.is_exact, error)) return 0;
    if (!touch_begin_fields(&own, &c, frames, &d->arena, error)) return 0;
    uint64_t mark = d->arena.used;
    for (uint32_t i = 0; i < frames; i++) {
        body->deforming[i] = touch_next_field(&own, &c, &d->state->tables, !i, mark, &d->arena, &d->arena, error);
        if (!body->deforming[i]) return 0;
    }
    d->arena.used = begin;
    return touch_need(error, c.at == c.end, "bytes behind the fields of a body");
}

/* The bodies' part of a segment: poses into row `first` on, and fields of those that deform where `fields` is asked. */
static int touch_read_bodies(touch_decoder *d, uint32_t segment, int64_t row, int has_fields, touch_cursor *error) {
    touch_state *s = d->state;
    touch_entry e;
    touch_cursor c = touch_segment_body(d->file, segment, &e);
    uint64_t worst = touch_varint(&c, 0, 65537), mark;
    if (worst) {
        touch_varint(&c, 0, e.count);
        for (uint32_t n = 0; n < 3; n++) touch_varint(&c, 0, 1u << 20);
    }
    for (uint32_t n = 0; n < d->file->object_count; n++) {
        touch_body *body = s->body + n;
        touch_cursor poses = touch_chunk(&c), fields = touch_cursor_of(c.at, 0);
        touch_numbers *told;
        if (body->told.is_deforming) fields = touch_chunk(&c);
        if (c.code) return touch_fail(error, c.code, c.what);
        mark = d->arena.used;
        told = (touch_numbers *)touch_take(&d->arena, 1, sizeof *told);
        int64_t *all = (int64_t *)touch_take(&d->arena, 7 * (uint64_t)e.count, 8);
        if (!told || !all) return touch_fail(error, TOUCH_MEMORY, "no room for poses");
        if (!touch_read_poses(poses, &s->tables, body, e.count, all, told, error)) return 0;
        if (row == 1) memcpy(body->pose + 7, all, (size_t)(56 * (uint64_t)e.count));
        else memcpy(body->pose + 7 * row, all + (row ? 0 : 7 * ((uint64_t)e.count - 1)), 56);
        d->arena.used = mark;
        if (!body->told.is_deforming || !has_fields) continue;
        if (!touch_read_deforming(d, body, fields, e.count, error)) return 0;
    }
    return touch_need(error, c.at == c.end, "bytes behind the bodies of a segment");
}

static int touch_read_vibration(touch_decoder *d, touch_cursor c, touch_cursor *error) {
    touch_state *s = d->state;
    uint32_t count = s->segment.count;
    uint64_t told = 0;
    touch_code b = touch_code_of(&c, &s->tables);
    touch_set_models *m;
    touch_numbers *numbers;
    touch_set none;
    memset(&none, 0, sizeof none);
    s->vibrating = (touch_vibrating *)touch_take_zero(&d->arena, count, sizeof *s->vibrating);
    m = (touch_set_models *)touch_take(&d->arena, 1, sizeof *m);
    numbers = (touch_numbers *)touch_take(&d->arena, 1, sizeof *numbers);
    if (!s->vibrating || !m || !numbers) return touch_fail(error, TOUCH_MEMORY, "no room for a vibration");
    touch_fresh(m->c, TOUCH_SUPPORT_CONTEXTS, m->w, TOUCH_LIST_WEIGHTS + 16);
    for (uint32_t i = 0; i < count; i++) {
        touch_vibrating *v = s->vibrating + i;
        if (!touch_read_set(&b, m, &d->file->grid, i ? &v[-1].set : &none, &v->set, &d->arena, error)) return 0;
        told += 16 + v->set.list.count;
        if (told > 64 + 16 * b.size) return touch_fail(error, TOUCH_CUT, "more frames or bricks than the bytes may tell");
        for (uint64_t k = 0; k < 512 * v->set.list.count; k++) v->samples += v->set.is_set[k];
    }
    for (uint32_t n = 0; n < 2; n++) {
        touch_numbers_fresh(numbers);
        for (uint32_t i = 0; i < count; i++) {
            touch_vibrating *v = s->vibrating + i;
            v->value[n] = (int64_t *)touch_take(&d->arena, v->samples, 8);
            if (!v->value[n]) return touch_fail(error, TOUCH_MEMORY, "no room for a vibration");
            for (uint64_t k = 0; k < v->samples; k++) {
                v->value[n][k] = touch_number(&b, numbers);
                if (b.place > b.size + 6) return touch_fail(error, TOUCH_CUT, "a vibration that ends too early");
            }
        }
    }
    touch_close(&b, told, error);
    return !error->code;
}

/* Samples of a set in the order of the grid: their bricks' columns do not follow each other. */
static uint64_t touch_raster(const touch_set *set, uint64_t *key, uint32_t *tag) {
    uint64_t count = 0;
    for (uint64_t i = 0; i < set->list.count; i++) {
        int32_t at[3];
        touch_place(set->list.key[i], at);
        for (uint64_t k = 0; k < 512; k++)
            if (set->is_set[512 * i + k]) {
                key[count] = touch_key(8 * at[0] + (int64_t)(k >> 6), 8 * at[1] + (int64_t)(k >> 3 & 7),
                                       8 * at[2] + (int64_t)(k & 7));
                tag[count++] = (uint32_t)(512 * i + k);
            }
    }
    touch_sort(key, tag, count);
    return count;
}

/* Values in place of differences, in place, and the field of each frame: called frame by frame, from the first. */
static int touch_settle_vibration(touch_decoder *d, touch_cursor *error) {
    touch_state *s = d->state;
    uint64_t mark = d->arena.used, count = 0;
    uint64_t *key[2];
    for (uint32_t frame = 0; frame < s->segment.count; frame++)
        if (s->vibrating[frame].samples > count) count = s->vibrating[frame].samples;
    key[0] = (uint64_t *)touch_take(&d->arena, count, 8), key[1] = (uint64_t *)touch_take(&d->arena, count, 8);
    uint32_t *tag = (uint32_t *)touch_take(&d->arena, count, 4);
    if (!key[0] || !key[1] || !tag) return touch_fail(error, TOUCH_MEMORY, "no room for a vibration");
    for (uint32_t frame = 0; frame < s->segment.count; frame++) {
        touch_vibrating *v = s->vibrating + frame;
        touch_raster(&v->set, key[frame & 1], tag);
        for (uint32_t n = 0; n < 2; n++) {
            const uint64_t *own = key[frame & 1], *old = key[!(frame & 1)];
            uint64_t at = 0;
            for (uint64_t i = 0; i < v->samples; i++) {
                int64_t from = i ? v->value[n][i - 1] : 0;
                if (frame) {
                    while (at < v[-1].samples && old[at] < own[i]) at++;
                    if (at < v[-1].samples && old[at] == own[i]) from = v[-1].value[n][at];
                }
                v->value[n][i] = (int64_t)((uint64_t)v->value[n][i] + (uint64_t)from);
                if (!touch_need(error, v->value[n][i] >= (int64_t)n && v->value[n][i] <= (n ? 10000 : 159),
                                "a vibration beyond its limit"))
                    return 0;
            }
        }
    }
    d->arena.used = mark;
    return 1;
}

static const touch_field *touch_vibration_field(touch_decoder *d, const touch_vibrating *v, touch_arena *out) {
    uint64_t mark = d->arena.used, *key = (uint64_t *)touch_take(&d->arena, v->samples, 8);
    uint32_t *tag = (uint32_t *)touch_take(&d->arena, v->samples, 4), *table;
    float *both;
    touch_field *f = touch_field_make(&d->file->grid, v->set.list.count, &table, &both, out);
    if (!key || !tag || !f) return 0;
    for (uint64_t i = 0; i < v->set.list.count; i++) touch_field_put(f, table, v->set.list.key[i], (uint32_t)i);
    touch_raster(&v->set, key, tag);
    for (uint64_t i = 0; i < v->samples; i++) {
        both[3 * (uint64_t)tag[i]] = (float)ldexp((double)(4 + v->value[0][i] % 4), (int)(v->value[0][i] / 4) - 22);
        both[3 * (uint64_t)tag[i] + 1] = (float)v->value[1][i];
    }
    d->arena.used = mark;
    return f;
}

/* -- the decoder ----------------------------------------------------------------------------------------------------- */

/* Bricks that the fields of some frames may list at most, exceptions included. */
static uint64_t touch_most_bricks(uint64_t lattice, uint64_t bytes, uint64_t frames) {
    uint64_t most = 64 * frames + 17 * bytes;
    return lattice < most / frames ? lattice * frames : most;
}

void touch_room(const touch_file *file, uint64_t *decoder, uint64_t *frame) {
    enum { FIXED = 6 << 20, KEPT = 6400, WORK = 49152, VIBRATING = 20480 }; /* of models; of each brick */
    touch_cursor at = touch_cursor_of(file->data + TOUCH_OPENING, file->size - TOUCH_OPENING);
    uint64_t bricks = touch_brick_count(&file->grid), rigid = 0, deforming = 0, bodies = 1, work = 0, segment = 0;
    uint64_t vibrating = 0, frames = 0;
    int has_bodies = file->object_count > 0;
    while (at.at < at.end && !at.code) {
        touch_record r = touch_read_record(&at, file->data, 0);
        if (r.tag == TOUCH_OBJT && !at.code) {
            touch_object o = touch_read_object(&r.payload);
            uint64_t lattice = touch_brick_count(&o.grid), most = touch_most_bricks(lattice, r.length, 1);
            if (o.is_deforming) deforming += lattice, bodies++;
            else rigid += most, work = work > most ? work : most;
        } else if ((r.tag == TOUCH_SEGM || r.tag == TOUCH_VIBR) && !at.code) {
            touch_u(&r.payload, 4);
            uint64_t count = touch_u(&r.payload, 2), kept = 0, most = touch_most_bricks(bricks, r.length, 1);
            frames = frames > count ? frames : count;
            if (r.tag == TOUCH_VIBR) {
                most = touch_most_bricks(bricks, r.length, count), vibrating = vibrating > most ? vibrating : most;
                continue;
            }
            if (has_bodies && bodies > 1) {
                most = touch_most_bricks(deforming, bodies * 64 + r.length, 1);
                kept = touch_most_bricks(deforming, r.length, (bodies - 1) * count);
            }
            if (!has_bodies || bodies > 1) work = work > most ? work : most;
            segment = segment > kept ? segment : kept;
        }
    }
    *decoder = bodies * FIXED + KEPT * (rigid + segment) + WORK * work + VIBRATING * vibrating +
               512 * (frames + 4) * (file->object_count + 1);
    *frame = 4096 + 512 * ((uint64_t)file->object_count + 1) + KEPT * ((has_bodies ? 0 : work) + vibrating);
}

static int touch_start_bodies(touch_decoder *d, touch_cursor *error) {
    const touch_file *file = d->file;
    touch_state *s = d->state;
    touch_cursor c = touch_cursor_of(file->parameters.bytes, file->parameters.size);
    touch_cursor at = touch_cursor_of(file->data + TOUCH_OPENING, file->size - TOUCH_OPENING);
    uint64_t count = touch_u(&c, 4);
    double place;
    uint32_t n = 0;
    s->surface_damping = touch_f64(&c), place = touch_f64(&c);
    touch_need(error, !c.code && c.at == c.end && count == file->object_count && s->surface_damping >= 0 &&
                          s->surface_damping <= 1.7976931348623157e308 && place >= 0 && place <= 1.7976931348623157e308,
               "the parameters of coder objects");
    touch_need(error, count * file->frame_count <= 1u << 24, "too many poses");
    s->body = (touch_body *)touch_take_zero(&d->arena, file->object_count, sizeof *s->body);
    if (!s->body) return touch_fail(error, TOUCH_MEMORY, "no room for bodies");
    while (n < file->object_count && !error->code) {
        touch_record r = touch_read_record(&at, file->data, 0);
        touch_body *body = s->body + n;
        touch_fields own;
        int is_exact;
        uint64_t end;
        if (r.tag != TOUCH_OBJT) continue;
        n++, body->told = touch_read_object(&r.payload);
        int position = body->told.steps.size == 2 ? (int8_t)body->told.steps.bytes[0] : 1;
        int turn = body->told.steps.size == 2 ? (int8_t)body->told.steps.bytes[1] : 1;
        touch_need(error, position >= -40 && position <= 0 && turn >= -30 && turn <= -2, "the steps of the poses");
        if (error->code) return 0;
        body->position_step_m = ldexp(1.0, position), body->one = (int64_t)1 << -turn;
        if (!touch_is(body->told.field_coder, "touch"))
            return touch_fail(error, TOUCH_VERSION, "a coder of fields that is not known here");
        if (!touch_check_parameters(body->told.parameters, &is_exact, error)) return 0;
        c = body->told.field;
        if (!touch_need(error, !body->told.is_deforming || c.at == c.end, "a field of a body that deforms")) return 0;
        if (body->told.is_deforming) continue;
        memset(&own, 0, sizeof own), own.grid = body->told.grid, own.is_exact = is_exact, end = d->arena.used;
        if (!touch_begin_fields(&own, &c, 1, &d->arena, error)) return 0;
        body->rigid = touch_next_field(&own, &c, &s->tables, 1, d->arena.used, &d->arena, &d->arena, error);
        if (!body->rigid || !touch_need(error, c.at == c.end, "bytes behind the field of a body")) return 0;
        d->arena.used = end;
    }
    return !error->code;
}

static int touch_told(touch_decoder *d, const touch_cursor *error) {
    d->error = error->code ? error->what : "";
    return error->code;
}

int touch_start(touch_decoder *decoder, const touch_file *file, touch_arena arena) {
    touch_cursor error = touch_cursor_of(0, 0);
    touch_state *s;
    memset(decoder, 0, sizeof *decoder);
    decoder->file = file, decoder->arena = arena;
    s = decoder->state = (touch_state *)touch_take_zero(&decoder->arena, 1, sizeof *s);
    if (!s) {
        touch_fail(&error, TOUCH_MEMORY, "no room for a decoder");
        return touch_told(decoder, &error);
    }
    touch_fill(&s->tables);
    s->fields.grid = file->grid;
    if (touch_is(file->coder, "objects")) touch_start_bodies(decoder, &error);
    else touch_check_parameters(file->parameters, &s->fields.is_exact, &error);
    decoder->kept = decoder->arena.used, s->full = decoder->arena.size, s->segment_number = file->segment_count;
    return touch_told(decoder, &error);
}

static int touch_seek_bodies(touch_decoder *d, uint32_t segment, touch_cursor *error) {
    touch_state *s = d->state;
    for (uint32_t n = 0; n < d->file->object_count; n++) {
        touch_body *body = s->body + n;
        body->pose = (int64_t *)touch_take_zero(&d->arena, 7 * ((uint64_t)s->segment.count + 2), 8);
        body->deforming = (const touch_field **)touch_take_zero(&d->arena, s->segment.count, sizeof *body->deforming);
        if (!body->pose || !body->deforming) return touch_fail(error, TOUCH_MEMORY, "no room for poses");
    }
    if (!touch_read_bodies(d, segment, 1, 1, error)) return 0;
    if (!(s->surface_damping > 0)) return 1;
    if (segment && !touch_read_bodies(d, segment - 1, 0, 0, error)) return 0;
    return segment + 1 == d->file->segment_count ||
           touch_read_bodies(d, segment + 1, (int64_t)s->segment.count + 1, 0, error);
}

/* The VIBR before a segment, if there is one. */
static touch_cursor touch_find_vibration(const touch_file *file, uint32_t segment, int *is_there) {
    uint64_t begin = TOUCH_OPENING;
    touch_cursor at;
    touch_entry e = touch_entry_at(file, segment);
    if (segment) {
        touch_entry before = touch_entry_at(file, segment - 1);
        begin = before.offset + before.length;
    }
    at = touch_cursor_of(file->data + begin, e.offset - begin), *is_there = 0;
    while (at.at < at.end && !at.code) {
        touch_record r = touch_read_record(&at, file->data, 0);
        if (r.tag == TOUCH_VIBR && !at.code) {
            *is_there = 1, r.payload.at += 6;
            return r.payload;
        }
    }
    return at;
}

int touch_seek(touch_decoder *decoder, uint32_t segment) {
    touch_cursor error = touch_cursor_of(0, 0);
    touch_state *s = decoder->state;
    int vibrates;
    if (segment >= decoder->file->segment_count) {
        touch_fail(&error, TOUCH_ARGUMENT, "a segment that there is not");
        return touch_told(decoder, &error);
    }
    decoder->arena.used = decoder->kept, decoder->arena.size = s->full;
    s->at = touch_segment_body(decoder->file, segment, &s->segment), s->next = 0, s->segment_number = segment;
    s->vibrating = 0;
    touch_cursor vibration = touch_find_vibration(decoder->file, segment, &vibrates);
    if (vibrates && touch_read_vibration(decoder, vibration, &error)) touch_settle_vibration(decoder, &error);
    if (!error.code && s->body) touch_seek_bodies(decoder, segment, &error);
    else if (!error.code) touch_begin_fields(&s->fields, &s->at, s->segment.count, &decoder->arena, &error);
    s->mark = decoder->arena.used;
    if (error.code) s->next = s->segment.count;
    return touch_told(decoder, &error);
}

static void touch_quaternion(const touch_body *body, int64_t row, double q[4]) {
    const int64_t *n = body->pose + 7 * row + 3;
    double size = sqrt((double)n[0] * (double)n[0] + (double)n[1] * (double)n[1] + (double)n[2] * (double)n[2] +
                       (double)n[3] * (double)n[3]);
    for (int k = 0; k < 4; k++) q[k] = (double)n[k] / size;
}

/* How a body moves in a frame; rows of poses are counted from the frame before the segment. */
static void touch_move(const touch_decoder *d, const touch_body *body, uint32_t frame, touch_part *part) {
    const touch_state *s = d->state;
    uint32_t last = d->file->frame_count - 1, i1 = frame < last ? frame + 1 : last, i0 = frame ? frame - 1 : 0;
    int64_t r1 = (int64_t)i1 - s->segment.first + 1, r0 = (int64_t)i0 - s->segment.first + 1;
    double a[4], b[4], q[4], sine, turn, seconds = (i1 - i0) / d->file->rate_hz;
    if (i1 == i0) return;
    touch_quaternion(body, r1, a), touch_quaternion(body, r0, b);
    for (int n = 0; n < 3; n++)
        part->velocity_m_s[n] =
            (double)(body->pose[7 * r1 + n] - body->pose[7 * r0 + n]) * body->position_step_m / seconds;
    q[0] = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
    for (int n = 1; n < 4; n++) {
        int i = n % 3 + 1, j = (n + 1) % 3 + 1;
        q[n] = b[0] * a[n] - a[0] * b[n] - (a[i] * b[j] - a[j] * b[i]);
    }
    for (int n = 1; n < 4 && q[0] < 0; n++) q[n] = -q[n];
    sine = sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3]), turn = 2 * atan2(sine, fabs(q[0])) / seconds;
    for (int n = 0; n < 3 && sine > 0; n++) part->spin_rad_s[n] = q[n + 1] / sine * turn;
}

static void touch_lay(const touch_decoder *d, const touch_body *body, uint32_t own, touch_part *part) {
    const int64_t *n = body->pose + 7 * ((int64_t)own + 1);
    double q[4], *r = part->rotation;
    part->field = body->rigid ? body->rigid : body->deforming[own];
    for (int k = 0; k < 3; k++) part->position_m[k] = (double)n[k] * body->position_step_m;
    touch_quaternion(body, (int64_t)own + 1, q);
    r[0] = 1 - 2 * (q[2] * q[2] + q[3] * q[3]), r[1] = 2 * (q[1] * q[2] - q[0] * q[3]);
    r[2] = 2 * (q[1] * q[3] + q[0] * q[2]), r[3] = 2 * (q[1] * q[2] + q[0] * q[3]);
    r[4] = 1 - 2 * (q[1] * q[1] + q[3] * q[3]), r[5] = 2 * (q[2] * q[3] - q[0] * q[1]);
    r[6] = 2 * (q[1] * q[3] - q[0] * q[2]), r[7] = 2 * (q[2] * q[3] + q[0] * q[1]);
    r[8] = 1 - 2 * (q[1] * q[1] + q[2] * q[2]);
    if (d->state->surface_damping > 0) touch_move(d, body, d->state->segment.first + own, part);
}

int touch_next(touch_decoder *decoder, touch_arena *arena, touch_frame *frame) {
    touch_cursor error = touch_cursor_of(0, 0);
    touch_state *s = decoder->state;
    const touch_file *file = decoder->file;
    uint32_t count = s->body ? file->object_count : 1, own = s->next;
    touch_part *part;
    if (own >= s->segment.count) return TOUCH_END;
    memset(frame, 0, sizeof *frame);
    part = (touch_part *)touch_take_zero(arena, count, sizeof *part);
    if (!part) touch_fail(&error, TOUCH_MEMORY, "no room for a frame");
    else if (s->body) {
        for (uint32_t n = 0; n < count; n++) touch_lay(decoder, s->body + n, own, part + n);
    } else {
        part->field = touch_next_field(&s->fields, &s->at, &s->tables, !own, s->mark, &decoder->arena, arena, &error);
        if (part->field && own + 1 == s->segment.count)
            touch_need(&error, s->at.at == s->at.end, "bytes behind the last frame of a segment");
    }
    if (!error.code && s->vibrating) {
        uint64_t begin = decoder->arena.used;
        frame->vibration = touch_vibration_field(decoder, s->vibrating + own, arena);
        if (!frame->vibration) touch_fail(&error, TOUCH_MEMORY, "no room for a vibration");
        decoder->arena.used = begin;
    }
    frame->number = s->segment.first + own, frame->parts = count, frame->part = part, frame->is_placed = s->body != 0;
    frame->surface_damping_n_s_per_m = s->surface_damping, frame->force_max_n = file->force_max_n;
    s->next = error.code ? s->segment.count : own + 1;
    return touch_told(decoder, &error);
}

#endif
