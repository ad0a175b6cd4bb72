/* touch.h: a decoder of .touch files (format 1) in C99; docs/format defines every byte. touch_model.h lies beside it.

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

   A receiver of a stream has no file: it calls touch_start_body in place of touch_open, touch_start and touch_seek.

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
    TOUCH_END = 7,      /* no frame is left in the segment */
    TOUCH_TOO_MANY = 8  /* more than the caller allows */
};

enum { TOUCH_FIXED_ROOM = 1 << 18 }; /* bytes of an arena for tables and models (see below) */

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

typedef struct { /* the records of a file, compared with each other */
    const uint8_t *data;
    uint64_t size;
    touch_grid grid;
    double rate_hz, force_max_n, mapping_scale, mapping_offset_m[3], weber_fraction, force_threshold_n, friction,
        damping_n_s_per_m;
    uint32_t frame_count, segment_count, object_count;
    int device_type;                            /* 1 a point, 2 an array */
    touch_bytes axes, device_name, coder, parameters, index;
    touch_bytes provenance;                     /* the payload of PROV, checked; 0 bytes: there is none */
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
    const touch_file *file; /* or NULL: touch_start_body */
    touch_arena arena;
    uint64_t persistent; /* bytes of the arena that segments do not overwrite */
    struct touch_state *state;
    const char *error;
} touch_decoder;

touch_arena touch_arena_of(void *memory, uint64_t size);
int touch_open(touch_file *file, const void *bytes, uint64_t size);
/* Bytes that never are too few: for the arena of a decoder, and for that of a frame. They follow what the bytes of the
   file may code at most. What one file really takes is `peak` of an arena it was decoded with, and for a decoder also
   what bodies keep at the end of its arena, by which touch_start makes `size` smaller. */
void touch_room(const touch_file *file, uint64_t *decoder, uint64_t *frame);
int touch_start(touch_decoder *decoder, const touch_file *file, touch_arena arena);
/* The body of one segment of coder `touch` without a file, positioned before its first frame: by the grid, the parameters
   in HEAD, and the number of frames, all of which a receiver has from elsewhere. touch_seek is not for such a decoder. */
int touch_start_body(touch_decoder *decoder, const touch_grid *grid, touch_bytes parameters, touch_bytes body,
                     uint32_t frame_count, touch_arena arena);
/* As touch_room, for touch_start_body. */
void touch_body_room(const touch_grid *grid, touch_bytes body, uint64_t *decoder, uint64_t *frame);
/* The segment that has a frame. */
uint32_t touch_segment_of(const touch_file *file, uint32_t frame);
int touch_seek(touch_decoder *decoder, uint32_t segment);
/* The next frame, which lives in `arena` until the caller empties it (arena.used = 0). Fields of bodies live in the arena
   of the decoder: those of rigid ones stay, those of bodies that deform die at the next touch_seek. */
int touch_next(touch_decoder *decoder, touch_arena *arena, touch_frame *frame);
/* Whether a body of a file has one field for all frames. */
int touch_is_rigid(const touch_decoder *decoder, uint32_t body);
/* The name of a body of a file, UTF-8. */
touch_bytes touch_name_of(const touch_decoder *decoder, uint32_t body);
/* The mask max(f0_n, k |F|) within which a force of a body, or of voxels, is that of its source; 0: the file has no mask. */
int touch_mask_of(const touch_decoder *decoder, uint32_t body, double *k, double *f0_n);
void touch_force(const touch_frame *frame, double x, double y, double z, double newtons[3]);
/* dF_i/dx_j, N/m, row by row. */
void touch_gradient(const touch_frame *frame, double x, double y, double z, double n_per_m[9]);
/* Amplitude, N, and frequency, Hz, as docs/format/vibration.md has them at a point. */
void touch_vibration(const touch_frame *frame, double x, double y, double z, double both[2]);

/* Codes on their own, as other records and other coders contain them. Results lie in the arena; `text` says in words what
   is wrong, or is empty. An arena that is too small (TOUCH_MEMORY) may be emptied, and a larger one be tried. */

typedef struct { /* a support: bricks that ascend, and whether each of their samples is set */
    uint64_t bricks;
    const int32_t *brick;  /* [bricks][3] */
    const uint8_t *is_set; /* [bricks][8][8][8] */
} touch_samples;

typedef struct { /* samples that vibrate in a frame, in raster order */
    uint64_t samples;
    const int32_t *position; /* [samples][3] */
    const int32_t *step;     /* s stands for (4 + s mod 4) 2^(s / 4 - 22) newtons */
    const int32_t *hertz;
} touch_vibration_steps;

/* A support, given another one of the same grid, or NULL (docs/format/bits.md). */
int touch_decode_support(const touch_grid *grid, touch_bytes code, const touch_samples *before, touch_arena *arena,
                         touch_samples *out, const char **text);
/* So many whole numbers, each below 2^30. */
int touch_decode_numbers(touch_bytes code, uint64_t count, touch_arena *arena, int64_t *numbers, const char **text);
/* The body of VIBR of `count` frames (docs/format/vibration.md), into `out`, which takes touch_vibration_frames. More than
   `max_samples` in all frames together are TOUCH_TOO_MANY. */
int touch_decode_vibration(const touch_grid *grid, touch_bytes body, uint32_t count, uint64_t max_samples,
                           touch_arena *arena, touch_vibration_steps *out, const char **text);
/* So many poses of a body, 1 or more, [count][7] in steps (docs/format/objects.md). `one`: the steps of a quaternion that
   make 1. */
int touch_decode_poses(touch_bytes code, uint32_t count, int64_t one, touch_arena *arena, int64_t *numbers,
                       const char **text);
/* Bytes of an arena that are enough for a support or a vibration, whatever its code of `size` bytes may tell: 1 or more
   frames. Numbers and poses take TOUCH_FIXED_ROOM. */
uint64_t touch_support_room(const touch_grid *grid, uint64_t size, uint64_t bricks_before);
uint64_t touch_vibration_room(const touch_grid *grid, uint64_t size, uint32_t count);
/* As many of `count` frames as a body of `size` bytes may have, and one more where it has fewer. */
uint32_t touch_vibration_frames(uint64_t size, uint32_t count);

#ifdef __cplusplus
}
#endif
#endif

#if defined TOUCH_IMPLEMENTATION && !defined TOUCH_IMPLEMENTED
#define TOUCH_IMPLEMENTED

#include "touch_model.h"

/* -- bytes ----------------------------------------------------------------------------------------------------------- */

touch_arena touch_arena_of(void *memory, uint64_t size) {
    touch_arena arena;
    arena.base = (uint8_t *)memory, arena.size = size, arena.used = arena.peak = 0;
    return arena;
}

static touch_cursor touch_cursor_of(const uint8_t *bytes, uint64_t size) {
    touch_cursor c;
    c.at = bytes, c.end = size ? bytes + size : bytes, c.code = TOUCH_OK, c.what = 0; /* NULL has no end */
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

/* A whole number from `min` to below `stop`. */
static uint64_t touch_varint(touch_cursor *c, uint64_t min, uint64_t stop) {
    uint64_t value = 0;
    for (int place = 0; place < 8; place++) {
        uint64_t byte = touch_u(c, 1);
        value |= (byte & 127) << (7 * place);
        if (byte < 128) {
            touch_need(c, byte || !place, "a varint that is not in its shortest form");
            touch_need(c, min <= value && value < stop, "a number out of its bounds");
            return c->code ? 0 : value;
        }
    }
    touch_fail(c, TOUCH_CORRUPT, "a varint of more than 8 bytes");
    return 0;
}

static touch_cursor touch_chunk(touch_cursor *c, uint64_t min_size) {
    uint64_t n = touch_varint(c, min_size, (uint64_t)1 << 56);
    const uint8_t *at = touch_skip(c, n);
    return c->code ? touch_cursor_of(at, 0) : touch_cursor_of(at, n);
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

/* The record at the cursor; its CRC-32 is checked if `is_checked`. */
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

static double touch_bounded(touch_cursor *c, double min, double max) {
    double value = touch_f64(c);
    touch_need(c, min <= value && value <= max, "a number out of its bounds");
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

static void touch_read_provenance(touch_cursor *c) { /* PROV */
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
    touch_bytes name, field_coder, parameters, steps;
    touch_grid grid;
    int is_deforming;
    touch_cursor field;
} touch_object;

static touch_object touch_read_object(touch_cursor *c) {
    touch_object o;
    o.name = touch_text(c, 0, 256, 0);
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

/* All records in their order; what each states is compared with the others. */
static void touch_walk(touch_file *f, touch_cursor *c) {
    uint32_t previous = 0, provenance_count = 0, segments = 0, first = 0, vibration[2] = {0, 0}, chain;
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
            touch_need(c, !provenance_count++ && !is_behind_segment, "PROV twice, or behind a segment");
            f->provenance.bytes = r.payload.at, f->provenance.size = touch_left(&r.payload);
            touch_read_provenance(&r.payload);
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
            uint64_t index_at, size, chained;
            touch_need(c, previous == TOUCH_INDX && r.length == 20, "TEND in another place");
            index_at = touch_u(&r.payload, 8), size = touch_u(&r.payload, 8), chained = touch_u(&r.payload, 4);
#ifdef FUZZING_BUILD_MODE_UNSAFE_FOR_PRODUCTION
            chain = (uint32_t)chained;
#endif
            touch_need(c, index_at == index_offset && size == f->size && chained == chain && c->at == c->end,
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

/* -- frames of coder touch (docs/format/touch.md): what is before the code; touch_model.h reads the code ------------- */

/* A frame, given the reference: its list and vectors. */
static int touch_read_frame(touch_cursor c, const touch_grid *grid, const touch_steps *steps, const touch_tables *tables,
                            touch_models *models, const touch_units *reference, touch_units *out, touch_arena *arena,
                            touch_cursor *error) {
    uint64_t order = touch_u(&c, 1);
    touch_coder coder;
    touch_pass *p;
    touch_need(&c, order < 32 && (order & 3) < 3, "a scan order that there is not");
    p = (touch_pass *)touch_take(arena, 1, sizeof *p);
    if (!p) return touch_fail(error, TOUCH_MEMORY, "no room for a frame");
    for (int n = 0; n < 3; n++) p->slope[n] = (int64_t)touch_varint(&c, 0, TOUCH_SLOPE_STOP);
    if (c.code) return touch_fail(error, c.code, c.what);
    coder = touch_reading(&c, tables);
    p->coder = &coder, p->models = models, p->steps = steps, p->reference = reference, p->target = 0;
    p->scan = touch_scan_of((int)order, grid);
    if (!touch_code_list(&coder, &models->list, grid->shape, reference->list, &out->list, arena, error)) return 0;
    touch_check(&coder, error);
    if (error->code) return 0;
    out->v = (touch_int_vector *)touch_take(arena, 512 * out->list.count, sizeof *out->v);
    if (!out->v) return touch_fail(error, TOUCH_MEMORY, "no room for a frame");
    uint64_t mark = arena->used;
    if (!touch_code_bricks(p, grid, out, arena, error)) return 0;
    touch_close(&coder, touch_min_bytes(out->list.count), error);
    arena->used = mark;
    return !error->code;
}

static int touch_read_spline(touch_cursor c, const touch_grid *grid, const touch_tables *tables, touch_units *out,
                             touch_arena *arena, touch_cursor *error) {
    touch_spline_head head;
    touch_spline_models *models;
    touch_coder coder;
    touch_nodes nodes;
    touch_list none;
    for (int n = 0; n < 3; n++) head.shift[n] = (int)touch_varint(&c, 2, 6);
    head.step = (int64_t)touch_varint(&c, 1, 1u << 20);
    for (int n = 0; n < 3; n++) head.scale[n] = (int64_t)touch_varint(&c, 1, 1u << 20);
    if (c.code) return touch_fail(error, c.code, c.what);
    none.key = 0, none.count = 0, coder = touch_reading(&c, tables);
    models = (touch_spline_models *)touch_take(arena, 1, sizeof *models);
    if (!models) return touch_fail(error, TOUCH_MEMORY, "no room for a base layer");
    TOUCH_FRESH(models->list.context, models->list.weight);
    touch_fresh(models->node.length[0], sizeof models->node / sizeof(touch_context), 0, 0);
    if (!touch_code_list(&coder, &models->list, grid->shape, none, &out->list, arena, error)) return 0;
    touch_check(&coder, error);
    if (!touch_need(error, out->list.count > 0, "a base layer without bricks")) return 0;
    out->v = (touch_int_vector *)touch_take_zero(arena, 512 * out->list.count, sizeof *out->v);
    uint64_t mark = arena->used;
    if (!out->v || !touch_nodes_of(&nodes, head.shift, out->list, arena))
        return touch_fail(error, TOUCH_MEMORY, "no room for a base layer");
    touch_code_nodes(&coder, models, &nodes, head.step);
    touch_close(&coder, touch_min_bytes(out->list.count), error);
    if (error->code) return 0;
    touch_fill_spline(&head, &nodes, grid, out);
    arena->used = mark;
    return 1;
}

static int touch_read_columns(touch_cursor c, const touch_grid *grid, const touch_tables *tables, touch_units *out,
                              touch_arena *arena, touch_cursor *error) {
    static const int number_bits[7] = {17, 20, 20, 20, 14, 12, 16};
    uint64_t first = touch_varint(&c, 0, 6), range[2][2], tiles[2], number[7];
    touch_columns columns;
    memset(&columns, 0, sizeof columns), columns.box = touch_column_box_of(grid, (int)(first >> 1), (int)(first & 1));
    for (int n = 0; n < 2; n++) tiles[n] = (grid->shape[columns.box.across[n]] + 7) >> 3;
    for (int n = 0; n < 2; n++) range[n][0] = touch_varint(&c, 0, tiles[n]);
    for (int n = 0; n < 2; n++) range[n][1] = touch_varint(&c, 0, tiles[n]) + 1;
    for (int n = 0; n < 7; n++) number[n] = touch_varint(&c, 0, (uint64_t)1 << number_bits[n]);
    for (int n = 0; n < 2; n++) touch_need(&c, c.code || range[n][0] + range[n][1] <= tiles[n], "a box beyond the grid");
    touch_need(&c, columns.box.depth <= 1 << 14, "columns of too many samples");
    if (c.code) return touch_fail(error, c.code, c.what);
    columns.top = (int64_t)number[0], columns.ramp = (int64_t)number[1], columns.ratio[0] = (int64_t)number[2];
    columns.ratio[1] = (int64_t)number[3], columns.coder = touch_reading(&c, tables);
    for (int n = 0; n < 3; n++) columns.step[n] = (int64_t)number[4 + n];
    for (int n = 0; n < 2; n++) columns.box.tile[n] = (int64_t)range[n][0], columns.box.tiles[n] = (int64_t)range[n][1];
    if (columns.coder.size < touch_min_column_bytes(range[0][1] * range[1][1], 0))
        return touch_fail(error, TOUCH_CUT, "a box of many tiles");
    if (!touch_columns_make(&columns, arena)) return touch_fail(error, TOUCH_MEMORY, "no room for a base layer");
    if (!touch_code_columns(&columns, error)) return 0;
    /* what it takes of the arena is given back with that of the frame */
    if (!touch_fill_columns(&columns, touch_max_bricks(columns.coder.size), out, arena, error)) return 0;
    touch_close(&columns.coder, touch_min_column_bytes(range[0][1] * range[1][1], out->list.count), error);
    return !error->code;
}

/* An exact frame (docs/format/touch-exact.md), given the one before. */
static int touch_read_exact(touch_cursor c, const touch_grid *grid, const touch_tables *tables, touch_exact_models *m,
                            const touch_exact *before, touch_exact *out, touch_arena *arena, touch_cursor *error) {
    touch_exact_pass pass;
    const touch_point *points;
    touch_list none;
    none.key = 0, none.count = 0;
    if (before) *out = *before;
    else memset(out, 0, sizeof *out);
    out->book = (int)touch_u(&c, 1);
    if (before) touch_need(&c, !out->book || out->book == before->book, "another codebook than that of the frame before");
    else if (out->book) {
        touch_need(&c, out->book <= TOUCH_LAST_OCTA, "a codebook that there is not");
        out->level_count = (uint32_t)touch_u(&c, 2);
        touch_need(&c, out->level_count > 0, "a palette without levels");
        out->levels = touch_skip(&c, 4 * (uint64_t)out->level_count);
        for (uint64_t i = 0; i < out->level_count && !c.code; i++)
            touch_need(&c, (out->levels[4 * i + 3] & 0x7f) != 0x7f || !(out->levels[4 * i + 2] & 0x80),
                       "a level that is not finite");
        if (!c.code) {
            out->vertices = touch_codebook(out->book, &out->vertex_count, &points, arena);
            if (!out->vertices) return touch_fail(error, TOUCH_MEMORY, "no room for a codebook");
        }
    }
    if (c.code) return touch_fail(error, c.code, c.what);
    touch_coder coder = touch_reading(&c, tables);
    pass.coder = &coder, pass.models = m, pass.grid = grid, pass.before = before;
    if (!touch_code_list(&coder, &m->list, grid->shape, before ? before->list : none, &out->list, arena, error)) return 0;
    touch_check(&coder, error);
    if (4 * out->list.count > touch_max_bricks(coder.size)) touch_fail(error, TOUCH_CUT, "bricks without bytes");
    if (error->code) return 0;
    out->own = (touch_symbols *)touch_take_zero(arena, 512 * out->list.count, sizeof *out->own);
    out->force = (float *)touch_take_zero(arena, 3 * 512 * out->list.count, 4);
    if (!out->own || !out->force) return touch_fail(error, TOUCH_MEMORY, "no room for a frame");
    if (!touch_code_samples(&pass, out, arena, error)) return 0;
    touch_close(&coder, touch_min_bytes(4 * out->list.count), error);
    return !error->code;
}

/* -- queries: forces and gradients at points ------------------------------------------------------------------------- */

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
    *forces = (float *)touch_take(arena, 1536 * bricks, 4);
    if (!f || !*table || !*forces) return 0;
    f->grid = *grid, f->bricks = (uint32_t)bricks, f->mask = (uint32_t)(size - 1), f->table = *table;
    f->forces_n = *forces;
    return f;
}

static void touch_field_put(const touch_field *f, uint32_t *table, uint64_t key, uint32_t slot) {
    int32_t p[3];
    uint32_t number, at;
    touch_position(key, p);
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
    uint64_t last_key = ~(uint64_t)0;
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
        if (key != last_key) last = touch_field_slot(f, brick[0], brick[1], brick[2]), last_key = key;
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

/* The force of a part, and its slopes unless `slopes` is NULL. */
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
    touch_object object; /* as OBJT states it */
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
    static const double most[5][4] = {
        {1, 1e308}, {1, 1e308, 90}, {1e308}, {0}, {1, 1e308, 1.0000000000000002, 1.0000000000000002}};
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

/* The parts of a frame, not decoded. */
typedef struct {
    uint64_t flags;
    touch_cursor layer, payload, outliers; /* empty where there is none */
} touch_frame_parts;

/* Whether a part of a body was read; if not, its error is called `what`. */
static int touch_is_read(touch_cursor *c, const char *what) {
    if (c->code) c->what = what;
    return !c->code;
}

static touch_frame_parts touch_read_parts(touch_cursor *c, int is_exact, int is_first) {
    touch_frame_parts parts;
    parts.flags = touch_u(c, 1);
    uint64_t support = touch_u(c, 1), amplitude = touch_u(c, 1);
    if (touch_is_read(c, "a frame that is missing")) {
        touch_need(c, parts.flags <= (is_exact ? 1u : 7u), "flags of a frame that there are not");
        touch_need(c, !is_first || !(parts.flags & 1), "a first frame that needs the one before");
        touch_need(c, support + amplitude <= 255, "bit fractions of a frame that are above 1 together");
    }
    int is_valid = !c->code;
    parts.layer = parts.flags & 2 ? touch_chunk(c, 1) : touch_cursor_of(c->at, 0);
    parts.payload = touch_chunk(c, 0);
    parts.outliers = parts.flags & 4 ? touch_chunk(c, 1) : touch_cursor_of(c->at, 0);
    if (is_valid) touch_is_read(c, "a base layer, payload or outliers that end too early, or are empty");
    return parts;
}

/* The step table and the largest error of a segment, before its frames. */
static int touch_read_segment_head(touch_fields *f, touch_cursor *c, uint32_t frames) {
    uint64_t flags = touch_u(c, 1);
    touch_steps *s = &f->steps;
    if (!touch_is_read(c, "flags of a segment that are missing")) return 0;
    touch_need(c, flags <= 1, "flags of a segment that there are not");
    if (!f->is_exact && !c->code) {
        s->unit_n = touch_f32_of((uint32_t)touch_u(c, 4));
        if (!touch_is_read(c, "a unit that is cut")) return 0;
        if (!touch_need(c, s->unit_n >= 1.17549435e-38f && s->unit_n <= 2.02824096e31f, "a unit out of its bounds")) return 0;
        s->floor = (int64_t)touch_varint(c, 1, 1u << 16), s->rate = (int64_t)touch_varint(c, 0, 1u << 17);
        s->cross_floor = (int64_t)touch_varint(c, 1, 1u << 16), s->cross_rate = (int64_t)touch_varint(c, 0, 1u << 17);
        if (!touch_is_read(c, "a step table that is cut, or out of its bounds")) return 0;
        touch_need(c, s->floor >= 21 || s->rate >= 64, "a floor and a rate that are too fine");
    }
    if (flags && !c->code) {
        touch_u(c, 2), touch_varint(c, 0, frames);
        for (int n = 0; n < 3; n++) touch_varint(c, 0, f->grid.shape[n]);
        return touch_is_read(c, "a largest error that is cut, or not within the segment");
    }
    return !c->code;
}

/* The head of a segment's body, after which the cursor lies; and the parts of all frames, which end with the body:
   docs/format/container.md, "Order of checks". */
static int touch_read_layout(touch_fields *f, touch_cursor *c, uint32_t frames, touch_cursor *error) {
    if (!touch_read_segment_head(f, c, frames)) return touch_fail(error, c->code, c->what);
    touch_cursor at = *c;
    for (uint32_t i = 0; i < frames && !at.code; i++) touch_read_parts(&at, f->is_exact, !i);
    touch_need(&at, at.at == at.end, "bytes behind the last frame of a segment");
    return at.code ? touch_fail(error, at.code, at.what) : 1;
}

/* The layout of a segment's body, all of it; models and borders are taken from the arena. */
static int touch_begin_fields(touch_fields *f, touch_cursor *c, uint32_t frames, touch_arena *arena, touch_cursor *error) {
    memset(&f->units, 0, sizeof f->units), f->has_exact = 0;
    if (!touch_read_layout(f, c, frames, error)) return 0;
    if (f->is_exact) {
        f->exact_models = (touch_exact_models *)touch_take(arena, 1, sizeof *f->exact_models);
        if (!f->exact_models) return touch_fail(error, TOUCH_MEMORY, "no room for models");
        touch_exact_fresh(f->exact_models);
        return 1;
    }
    if (!touch_step_table(&f->steps, arena)) return touch_fail(error, TOUCH_MEMORY, "no room for a table of steps");
    f->models = (touch_models *)touch_take(arena, 1, sizeof *f->models);
    if (!f->models) return touch_fail(error, TOUCH_MEMORY, "no room for models");
    touch_models_fresh(f->models);
    return 1;
}

/* An outlier: from one to the next of a chunk. */
static int touch_read_outlier(touch_cursor *c, const touch_grid *grid, uint64_t *brick, int64_t *last, int32_t place[3],
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

/* The field of a decoded frame in `out`, with its outliers; `scratch` is emptied again. */
static const touch_field *touch_make_field(const touch_fields *f, touch_cursor outliers, touch_arena *out, touch_arena *scratch,
                                           touch_cursor *error) {
    const touch_list *list = f->is_exact ? &f->exact.list : &f->units.list;
    uint64_t mark = scratch->used, count = list->count, brick = 0;
    touch_cursor c = outliers;
    touch_arena end;
    touch_map map;
    touch_field *field;
    uint32_t *table;
    float *forces, force[3];
    int64_t last = -1;
    int32_t place[3];
    uint64_t bricks = 1, before = 0; /* of the outliers; it may be that of number 0 */
    while (c.at < c.end && touch_read_outlier(&c, &f->grid, &brick, &last, place, force))
        bricks += brick != before, before = brick;
    c = outliers, brick = 0, last = -1;
    if (!touch_map_make(&map, list->count + bricks, scratch)) {
        touch_fail(error, TOUCH_MEMORY, "no room for a field");
        return 0;
    }
    for (uint64_t i = 0; i < list->count; i++) touch_map_put(&map, list->key[i], (uint32_t)i);
    while (c.at < c.end && touch_read_outlier(&c, &f->grid, &brick, &last, place, force)) {
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
        if (map.key[i]) touch_field_put(field, table, map.key[i] - 1, map.index[i]);
    memset(forces + 1536 * list->count, 0, (size_t)(6144 * (count - list->count))); /* bricks of outliers alone */
    for (uint64_t i = 0; i < 512 * list->count; i++)
        for (int n = 0; n < 3; n++)
            forces[3 * i + (uint64_t)n] = f->is_exact ? f->exact.force[3 * i + (uint64_t)n]
                                                      : f->steps.unit_n * (float)f->units.v[i].v[n];
    c = outliers, brick = 0, last = -1;
    while (c.at < c.end && touch_read_outlier(&c, &f->grid, &brick, &last, place, force)) {
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
    touch_frame_parts parts = touch_read_parts(c, f->is_exact, is_first);
    const touch_field *field;
    if (c->code) {
        touch_fail(error, c->code, c->what);
        return 0;
    }
    if (f->is_exact) {
        touch_exact next;
        if (!(parts.flags & 1)) touch_exact_fresh(f->exact_models);
        const touch_exact *before = parts.flags & 1 && f->has_exact ? &f->exact : 0;
        if (!touch_read_exact(parts.payload, &f->grid, tables, f->exact_models, before, &next, arena, error))
            return 0;
        f->exact = next, f->has_exact = 1;
        field = touch_make_field(f, parts.outliers, out, arena, error);
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
        if (!(parts.flags & 1)) touch_models_fresh(f->models), memset(&reference, 0, sizeof reference);
        if (parts.flags & 2) {
            uint64_t kind = touch_u(&parts.layer, 1);
            if (!touch_need(error, kind <= 1, "a base layer of a kind that there is not")) return 0;
            if (!(kind ? touch_read_columns : touch_read_spline)(parts.layer, &f->grid, tables, &reference, arena, error))
                return 0;
        }
        if (!touch_read_frame(parts.payload, &f->grid, &f->steps, tables, f->models, &reference, &next, arena, error)) return 0;
        f->units = next;
        field = touch_make_field(f, parts.outliers, out, arena, error);
        arena->used = mark;
        f->units.list.key = (uint64_t *)touch_keep(arena, next.list.key, 8 * next.list.count);
        f->units.v = (touch_int_vector *)touch_keep(arena, next.v, 512 * next.list.count * sizeof *next.v);
    }
    return field;
}

/* Numbers of a code, `stride` outliers; those behind its end stay 0. */
static void touch_read_numbers(touch_coder *b, touch_numbers *models, uint64_t count, uint64_t stride, int64_t *out) {
    for (uint64_t i = 0; i < count; i++) out[stride * i] = 0;
    for (uint64_t i = 0; i < count && !touch_is_cut(b); i++) out[stride * i] = touch_code_number(b, models, 0);
}

static int64_t touch_wrapping_sum(int64_t a, int64_t b) { return (int64_t)((uint64_t)a + (uint64_t)b); }

/* Poses within their limits: positions of 2^50 steps, and unit quaternions. */
static int touch_check_poses(const int64_t *poses, uint32_t count, int64_t one, touch_cursor *error) {
    const int64_t max_position = (int64_t)1 << 50;
    for (uint32_t i = 0; i < 7 * (uint64_t)count; i++) {
        int64_t max = i % 7 < 3 ? max_position : one;
        if (!touch_need(error, touch_clip_to(poses[i], max) == poses[i], "a pose beyond its limit")) return 0;
    }
    for (uint32_t i = 0; i < count; i++) {
        int64_t squares = 0;
        for (int n = 3; n < 7; n++) squares += poses[7 * (uint64_t)i + (uint64_t)n] * poses[7 * (uint64_t)i + (uint64_t)n];
        touch_need(error, squares >= (one - 1) * (one - 1) && squares <= (one + 1) * (one + 1),
                   "a quaternion that is not unit");
    }
    return !error->code;
}

/* Poses of a body: seven whole numbers a frame, each with its order of differences. */
static int touch_read_poses(touch_cursor c, const touch_tables *tables, int64_t one, uint32_t count, int64_t *out,
                            touch_numbers *models, touch_cursor *error) {
    touch_coder b = touch_reading(&c, tables);
    int64_t head[14];
    touch_numbers_fresh(models);
    touch_read_numbers(&b, models, 14, 1, head);
    for (int n = 0; n < 7; n++)
        if (!touch_need_coded(&b, error, head[n] >= 0 && head[n] <= 3, "a predictor that there is not")) return 0;
    for (int n = 0; n < 7; n++) {
        for (uint64_t i = 0; i < count; i++) out[7 * i + (uint64_t)n] = 0;
        if (head[n] && count > 1) {
            touch_numbers_fresh(models);
            touch_read_numbers(&b, models, count - 1, 7, out + 7 + n);
        }
        for (int k = 0; k < head[n]; k++)
            for (uint64_t i = 1; i < count; i++)
                out[7 * i + (uint64_t)n] = touch_wrapping_sum(out[7 * i + (uint64_t)n], out[7 * (i - 1) + (uint64_t)n]);
        for (uint64_t i = 0; i < count; i++)
            out[7 * i + (uint64_t)n] = touch_wrapping_sum(out[7 * i + (uint64_t)n], head[7 + n]);
    }
    touch_close(&b, 0, error);
    return !error->code && touch_check_poses(out, count, one, error);
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
    memset(&own, 0, sizeof own), own.grid = body->object.grid;
    if (!touch_check_parameters(body->object.parameters, &own.is_exact, error)) return 0;
    if (!touch_begin_fields(&own, &c, frames, &d->arena, error)) return 0;
    uint64_t mark = d->arena.used;
    for (uint32_t i = 0; i < frames; i++) {
        body->deforming[i] = touch_next_field(&own, &c, &d->state->tables, !i, mark, &d->arena, &d->arena, error);
        if (!body->deforming[i]) return 0;
    }
    d->arena.used = begin;
    return 1;
}

/* The chunks of a body in a segment; `fields` is empty for a rigid one. */
static touch_cursor touch_body_chunks(touch_cursor *c, const touch_body *body, touch_cursor *fields) {
    touch_cursor poses = touch_chunk(c, 0);
    *fields = body->object.is_deforming ? touch_chunk(c, 0) : touch_cursor_of(c->at, 0);
    return poses;
}

/* Poses of a body in the frames of a segment, into row `row` on; row 0 takes the last of them, and a row behind those of
   the segment that is decoded takes the first. */
static int touch_read_body_poses(touch_decoder *d, touch_body *body, touch_cursor poses, uint32_t frames, int64_t row,
                                 touch_cursor *error) {
    uint64_t mark = d->arena.used;
    touch_numbers *models = (touch_numbers *)touch_take(&d->arena, 1, sizeof *models);
    int64_t *all = (int64_t *)touch_take(&d->arena, 7 * (uint64_t)frames, 8);
    if (!models || !all) return touch_fail(error, TOUCH_MEMORY, "no room for poses");
    if (!touch_read_poses(poses, &d->state->tables, body->one, frames, all, models, error)) return 0;
    if (row == 1) memcpy(body->pose + 7, all, (size_t)(56 * (uint64_t)frames));
    else memcpy(body->pose + 7 * row, all + (row ? 0 : 7 * ((uint64_t)frames - 1)), 56);
    d->arena.used = mark;
    return 1;
}

/* The bodies' part of a segment: all chunks, then poses into row `row` on, then fields of those that deform where they
   are requested. */
static int touch_read_bodies(touch_decoder *d, uint32_t segment, int64_t row, int has_fields, touch_cursor *error) {
    touch_state *s = d->state;
    touch_entry e;
    touch_cursor c = touch_segment_body(d->file, segment, &e), first, fields, poses;
    uint32_t count = d->file->object_count;
    if (touch_varint(&c, 0, 65537)) { /* the largest error */
        touch_varint(&c, 0, e.count);
        for (uint32_t n = 0; n < 3; n++) touch_varint(&c, 0, 1u << 20);
    }
    first = c;
    for (uint32_t n = 0; n < count; n++) touch_body_chunks(&c, s->body + n, &fields);
    touch_need(&c, c.at == c.end, "bytes behind the bodies of a segment");
    if (c.code) return touch_fail(error, c.code, c.what);
    c = first;
    for (uint32_t n = 0; n < count; n++) {
        poses = touch_body_chunks(&c, s->body + n, &fields);
        if (!touch_read_body_poses(d, s->body + n, poses, e.count, row, error)) return 0;
    }
    c = first;
    for (uint32_t n = 0; n < count && has_fields; n++) {
        touch_body_chunks(&c, s->body + n, &fields);
        if (s->body[n].object.is_deforming && !touch_read_deforming(d, s->body + n, fields, e.count, error)) return 0;
    }
    return 1;
}

/* The body of VIBR: supports, and differences of values. */
static int touch_read_vibration(touch_cursor c, const touch_tables *tables, const touch_grid *grid, uint32_t count,
                                uint64_t max_samples, touch_vibrating *frames, touch_arena *arena, touch_cursor *error) {
    touch_coder b = touch_reading(&c, tables);
    uint64_t bricks = 0, samples = 0;
    touch_set none;
    touch_set_models *models = (touch_set_models *)touch_take(arena, 1, sizeof *models);
    touch_numbers *numbers = (touch_numbers *)touch_take(arena, 1, sizeof *numbers);
    memset(&none, 0, sizeof none);
    if (!models || !numbers) return touch_fail(error, TOUCH_MEMORY, "no room for a vibration");
    touch_set_fresh(models);
    for (uint32_t i = 0; i < count; i++) {
        touch_vibrating *v = frames + i;
        if (!touch_code_set(&b, models, grid, i ? &v[-1].set : &none, &v->set, arena, error)) return 0;
        bricks += 16 + v->set.list.count;
        if (bricks > touch_max_bricks(b.size))
            return touch_fail(error, TOUCH_CUT, "more frames or bricks than the bytes may list");
        v->samples = 0;
        for (uint64_t k = 0; k < 512 * v->set.list.count; k++) v->samples += v->set.is_set[k];
        samples += v->samples;
        if (samples > max_samples) return touch_fail(error, TOUCH_TOO_MANY, "more samples that vibrate than are allowed");
    }
    for (uint32_t n = 0; n < 2; n++) { /* those of all frames follow each other */
        int64_t *value = (int64_t *)touch_take(arena, samples, 8);
        if (!value) return touch_fail(error, TOUCH_MEMORY, "no room for a vibration");
        touch_numbers_fresh(numbers);
        touch_read_numbers(&b, numbers, samples, 1, value);
        for (uint32_t i = 0; i < count; i++) frames[i].value[n] = value, value += frames[i].samples;
    }
    touch_close(&b, touch_min_bytes(bricks), error);
    return !error->code;
}

/* The first brick from `i` on whose key differs above the lowest `bits`. */
static uint64_t touch_run_stop(const touch_list *list, uint64_t i, int bits) {
    uint64_t stop = i;
    while (stop < list->count && list->key[stop] >> bits == list->key[i] >> bits) stop++;
    return stop;
}

/* Samples of a set in raster order of the grid, which runs through all bricks of a row: their keys, and where they lie. */
static uint64_t touch_raster(const touch_set *set, uint64_t *key, uint32_t *index) {
    uint64_t count = 0, plane_stop, row_stop;
    for (uint64_t plane = 0; plane < set->list.count; plane = plane_stop) {
        plane_stop = touch_run_stop(&set->list, plane, 2 * TOUCH_KEY_BITS);
        for (int x = 0; x < 8; x++)
            for (uint64_t row = plane; row < plane_stop; row = row_stop) {
                row_stop = touch_run_stop(&set->list, row, TOUCH_KEY_BITS);
                for (int y = 0; y < 8; y++)
                    for (uint64_t i = row; i < row_stop; i++) {
                        int32_t at[3];
                        touch_position(set->list.key[i], at);
                        for (int z = 0; z < 8; z++) {
                            uint64_t sample = 512 * i + (uint64_t)(64 * x + 8 * y + z);
                            if (!set->is_set[sample]) continue;
                            key[count] = touch_key(8 * at[0] + x, 8 * at[1] + y, 8 * at[2] + z);
                            index[count++] = (uint32_t)sample;
                        }
                    }
            }
    }
    return count;
}

enum { TOUCH_MAX_VIBRATION_STEP = 159, TOUCH_MAX_HERTZ = 10000 };

/* Values in place of differences. */
static int touch_settle_vibration(touch_vibrating *frames, uint32_t count, touch_arena *arena, touch_cursor *error) {
    uint64_t mark = arena->used, max_samples = 0;
    uint64_t *key[2];
    for (uint32_t i = 0; i < count; i++)
        max_samples = touch_larger(max_samples, frames[i].samples);
    key[0] = (uint64_t *)touch_take(arena, max_samples, 8), key[1] = (uint64_t *)touch_take(arena, max_samples, 8);
    uint32_t *tag = (uint32_t *)touch_take(arena, max_samples, 4);
    if (!key[0] || !key[1] || !tag) return touch_fail(error, TOUCH_MEMORY, "no room for a vibration");
    for (uint32_t frame = 0; frame < count; frame++) {
        touch_vibrating *v = frames + frame;
        const uint64_t *own = key[frame & 1], *previous = key[!(frame & 1)];
        touch_raster(&v->set, key[frame & 1], tag);
        for (uint32_t n = 0; n < 2; n++) {
            uint64_t at = 0;
            for (uint64_t i = 0; i < v->samples; i++) {
                int64_t from = i ? v->value[n][i - 1] : 0;
                if (frame) {
                    while (at < v[-1].samples && previous[at] < own[i]) at++;
                    if (at < v[-1].samples && previous[at] == own[i]) from = v[-1].value[n][at];
                }
                v->value[n][i] = touch_wrapping_sum(v->value[n][i], from);
                int64_t max = n ? TOUCH_MAX_HERTZ : TOUCH_MAX_VIBRATION_STEP, value = v->value[n][i];
                if (!touch_need(error, value >= (int64_t)n && value <= max, "a vibration beyond its limit"))
                    return 0;
            }
        }
    }
    arena->used = mark;
    return 1;
}

/* The vibration of a segment of a file. */
static int touch_seek_vibration(touch_decoder *d, touch_cursor body, touch_cursor *error) {
    touch_state *s = d->state;
    uint32_t count = s->segment.count;
    s->vibrating = (touch_vibrating *)touch_take_zero(&d->arena, count, sizeof *s->vibrating);
    if (!s->vibrating) return touch_fail(error, TOUCH_MEMORY, "no room for a vibration");
    return touch_read_vibration(body, &s->tables, &d->file->grid, count, UINT64_MAX, s->vibrating, &d->arena, error) &&
           touch_settle_vibration(s->vibrating, count, &d->arena, error);
}

static const touch_field *touch_vibration_field(touch_decoder *d, const touch_vibrating *v, touch_arena *out) {
    uint64_t mark = d->arena.used, *key = (uint64_t *)touch_take(&d->arena, v->samples, 8);
    uint32_t *tag = (uint32_t *)touch_take(&d->arena, v->samples, 4), *table;
    float *both;
    touch_field *f = touch_field_make(&d->file->grid, v->set.list.count, &table, &both, out);
    if (!key || !tag || !f) return 0;
    memset(both, 0, (size_t)(6144 * v->set.list.count));
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

/* Bricks that the fields of some frames may list at most: 16 for a byte of a code. Those of outliers take two bytes. */
static uint64_t touch_bricks_of_bytes(uint64_t lattice, uint64_t bytes, uint64_t frames) {
    uint64_t max = 64 * frames + 16 * bytes;
    return lattice < max / frames ? lattice * frames : max;
}

/* Bytes of models; of each brick: of a field that stays, of a frame while it is decoded (vectors 6144, cells 16384, keys and
   maps), of the frame before or a base layer (vectors, keys, maps), of what vibrates; of each tile of columns. */
enum {
    TOUCH_FIXED = 6 << 20,
    TOUCH_KEPT = 6400,
    TOUCH_DECODED = 22912,
    TOUCH_KNOWN = 6400,
    TOUCH_VIBRATING = 20480,
    TOUCH_TILE = 64 * sizeof(touch_column) + 64
};

/* Bytes for the frames of a body, one after the other. Each byte of it is of one code, so the bricks of a frame, of the one
   before and of a base layer together are bounded by all bytes. Exact frames list 4 bricks for a byte, of less than
   TOUCH_DECODED. */
static uint64_t touch_frames_room(uint64_t lattice, uint64_t bytes) {
    uint64_t decoded = touch_smaller(lattice, touch_max_bricks(bytes)), known = 192 + 16 * bytes - decoded;
    return TOUCH_DECODED * decoded + TOUCH_KNOWN * touch_smaller(known, 2 * lattice) +
           TOUCH_TILE * touch_smaller(lattice, 64 + bytes);
}

void touch_body_room(const touch_grid *grid, touch_bytes body, uint64_t *decoder, uint64_t *frame) {
    uint64_t lattice = touch_brick_count(grid);
    *decoder = TOUCH_FIXED + touch_frames_room(lattice, body.size);
    *frame = 4096 + TOUCH_KEPT * touch_bricks_of_bytes(lattice, body.size, 1);
}

void touch_room(const touch_file *file, uint64_t *decoder, uint64_t *frame) {
    touch_cursor at = touch_cursor_of(file->data + TOUCH_OPENING, file->size - TOUCH_OPENING);
    uint64_t bricks = touch_brick_count(&file->grid), rigid = 0, deforming = 0, bodies = 1, work = 0, segment = 0;
    uint64_t vibrating = 0, frames = 0, field = 0;
    int has_bodies = file->object_count > 0;
    while (at.at < at.end && !at.code) {
        touch_record r = touch_read_record(&at, file->data, 0);
        if (r.tag == TOUCH_OBJT && !at.code) {
            touch_object o = touch_read_object(&r.payload);
            uint64_t lattice = touch_brick_count(&o.grid), listed = touch_bricks_of_bytes(lattice, r.length, 1);
            if (o.is_deforming) deforming += lattice, bodies++;
            else rigid += listed, work = touch_larger(work, touch_frames_room(lattice, r.length));
        } else if ((r.tag == TOUCH_SEGM || r.tag == TOUCH_VIBR) && !at.code) {
            touch_u(&r.payload, 4);
            uint64_t count = touch_u(&r.payload, 2);
            frames = touch_larger(frames, count);
            if (r.tag == TOUCH_VIBR) vibrating = touch_larger(vibrating, touch_bricks_of_bytes(bricks, r.length, count));
            else if (!has_bodies) {
                field = touch_larger(field, touch_bricks_of_bytes(bricks, r.length, 1));
                work = touch_larger(work, touch_frames_room(bricks, r.length));
            } else if (bodies > 1) {
                segment = touch_larger(segment, touch_bricks_of_bytes(deforming, r.length, (bodies - 1) * count));
                work = touch_larger(work, touch_frames_room(deforming, r.length));
            }
        }
    }
    *decoder = TOUCH_FIXED + TOUCH_KEPT * (rigid + segment) + work + TOUCH_VIBRATING * vibrating +
               512 * (frames + 4) * (file->object_count + 1);
    *frame = 4096 + 512 * ((uint64_t)file->object_count + 1) + TOUCH_KEPT * (field + vibrating);
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
        n++, body->object = touch_read_object(&r.payload);
        if (!touch_is(body->object.field_coder, "touch"))
            return touch_fail(error, TOUCH_VERSION, "a coder of fields that is not known here");
        if (!touch_check_parameters(body->object.parameters, &is_exact, error)) return 0;
        int position = body->object.steps.size == 2 ? (int8_t)body->object.steps.bytes[0] : 1;
        int turn = body->object.steps.size == 2 ? (int8_t)body->object.steps.bytes[1] : 1;
        touch_need(error, position >= -40 && position <= 0 && turn >= -30 && turn <= -2, "the steps of the poses");
        if (error->code) return 0;
        body->position_step_m = ldexp(1.0, position), body->one = (int64_t)1 << -turn;
        c = body->object.field;
        if (!touch_need(error, !body->object.is_deforming || c.at == c.end, "a field of a body that deforms")) return 0;
        if (body->object.is_deforming) continue;
        memset(&own, 0, sizeof own), own.grid = body->object.grid, own.is_exact = is_exact, end = d->arena.used;
        if (!touch_begin_fields(&own, &c, 1, &d->arena, error)) return 0;
        body->rigid = touch_next_field(&own, &c, &s->tables, 1, d->arena.used, &d->arena, &d->arena, error);
        if (!body->rigid) return 0;
        d->arena.used = end;
    }
    return !error->code;
}

static int touch_report_error(touch_decoder *d, const touch_cursor *error) {
    d->error = error->code ? error->what : "";
    return error->code;
}

/* The state of a new decoder, or NULL. */
static touch_state *touch_state_make(touch_decoder *decoder, const touch_grid *grid, touch_arena arena, touch_cursor *error) {
    touch_state *s;
    memset(decoder, 0, sizeof *decoder), decoder->arena = arena;
    s = decoder->state = (touch_state *)touch_take_zero(&decoder->arena, 1, sizeof *s);
    if (s) touch_fill_tables(&s->tables), s->fields.grid = *grid;
    else touch_fail(error, TOUCH_MEMORY, "no room for a decoder");
    return s;
}

int touch_start_body(touch_decoder *decoder, const touch_grid *grid, touch_bytes parameters, touch_bytes body,
                     uint32_t frame_count, touch_arena arena) {
    touch_cursor error = touch_cursor_of(0, 0);
    touch_state *s = touch_state_make(decoder, grid, arena, &error);
    if (s && touch_check_parameters(parameters, &s->fields.is_exact, &error)) {
        s->at = touch_cursor_of(body.bytes, body.size), s->segment.count = frame_count;
        touch_begin_fields(&s->fields, &s->at, frame_count, &decoder->arena, &error);
        s->mark = decoder->arena.used;
    }
    if (s && error.code) s->next = s->segment.count;
    return touch_report_error(decoder, &error);
}

int touch_start(touch_decoder *decoder, const touch_file *file, touch_arena arena) {
    touch_cursor error = touch_cursor_of(0, 0);
    touch_state *s = touch_state_make(decoder, &file->grid, arena, &error);
    decoder->file = file;
    if (!s) return touch_report_error(decoder, &error);
    if (touch_is(file->coder, "objects")) touch_start_bodies(decoder, &error);
    else touch_check_parameters(file->parameters, &s->fields.is_exact, &error);
    decoder->persistent = decoder->arena.used, s->full = decoder->arena.size, s->segment_number = file->segment_count;
    return touch_report_error(decoder, &error);
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
        return touch_report_error(decoder, &error);
    }
    decoder->arena.used = decoder->persistent, decoder->arena.size = s->full;
    s->at = touch_segment_body(decoder->file, segment, &s->segment), s->next = 0, s->segment_number = segment;
    s->vibrating = 0;
    touch_cursor vibration = touch_find_vibration(decoder->file, segment, &vibrates);
    if (vibrates) touch_seek_vibration(decoder, vibration, &error);
    if (!error.code && s->body) touch_seek_bodies(decoder, segment, &error);
    else if (!error.code) touch_begin_fields(&s->fields, &s->at, s->segment.count, &decoder->arena, &error);
    s->mark = decoder->arena.used;
    if (error.code) s->next = s->segment.count;
    return touch_report_error(decoder, &error);
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
    }
    if (!error.code && s->vibrating) {
        uint64_t begin = decoder->arena.used;
        frame->vibration = touch_vibration_field(decoder, s->vibrating + own, arena);
        if (!frame->vibration) touch_fail(&error, TOUCH_MEMORY, "no room for a vibration");
        decoder->arena.used = begin;
    }
    frame->number = s->segment.first + own, frame->parts = count, frame->part = part, frame->is_placed = s->body != 0;
    frame->surface_damping_n_s_per_m = s->surface_damping, frame->force_max_n = file ? file->force_max_n : 0;
    s->next = error.code ? s->segment.count : own + 1;
    return touch_report_error(decoder, &error);
}

int touch_is_rigid(const touch_decoder *decoder, uint32_t body) {
    return decoder->state->body && body < decoder->file->object_count && decoder->state->body[body].rigid;
}

touch_bytes touch_name_of(const touch_decoder *decoder, uint32_t body) {
    touch_bytes none = {NULL, 0};
    return decoder->state->body && body < decoder->file->object_count ? decoder->state->body[body].object.name : none;
}

int touch_mask_of(const touch_decoder *decoder, uint32_t body, double *k, double *f0_n) {
    const touch_body *bodies = decoder->state->body;
    touch_bytes b = bodies && body < decoder->file->object_count ? bodies[body].object.parameters : decoder->file->parameters;
    touch_cursor c = touch_cursor_of(b.bytes, b.size);
    touch_u(&c, 1);
    int mode = (int)touch_u(&c, 1) & 3; /* 0: a mask */
    *k = touch_f64(&c), *f0_n = touch_f64(&c);
    return !c.code && !mode;
}

/* -- codes on their own ---------------------------------------------------------------------------------------------- */

static int touch_error_in(const touch_cursor *error, const char **text) {
    *text = error->code ? error->what : "";
    return error->code;
}

static const touch_tables *touch_tables_in(touch_arena *arena) {
    touch_tables *tables = (touch_tables *)touch_take(arena, 1, sizeof *tables);
    if (tables) touch_fill_tables(tables);
    return tables;
}

/* Bricks of a lattice that a code of so many bytes may list. */
static uint64_t touch_listed_bricks(const touch_grid *grid, uint64_t frames, uint64_t size) {
    uint64_t lattice = touch_brick_count(grid), max = touch_max_bricks(size);
    return lattice < max / frames ? lattice * frames : max;
}

uint64_t touch_support_room(const touch_grid *grid, uint64_t size, uint64_t bricks_before) {
    return TOUCH_FIXED_ROOM + 1536 * touch_listed_bricks(grid, 1, size) + 768 * bricks_before;
}

uint32_t touch_vibration_frames(uint64_t size, uint32_t count) {
    return size + 5 < count ? (uint32_t)(size + 5) : count; /* each counts as 16 of 64 + 16 * size bricks */
}

uint64_t touch_vibration_room(const touch_grid *grid, uint64_t size, uint32_t count) {
    uint64_t frames = touch_vibration_frames(size, count);
    uint64_t all = touch_listed_bricks(grid, frames ? frames : 1, size), one = touch_listed_bricks(grid, 1, size);
    return TOUCH_FIXED_ROOM + 512 * frames + 19200 * (all + one) + 10496 * one; /* persistent, and work */
}

int touch_decode_support(const touch_grid *grid, touch_bytes code, const touch_samples *before, touch_arena *arena,
                         touch_samples *out, const char **text) {
    touch_cursor error = touch_cursor_of(0, 0), c = touch_cursor_of(code.bytes, code.size);
    const touch_tables *tables = touch_tables_in(arena);
    touch_set_models *models = (touch_set_models *)touch_take(arena, 1, sizeof *models);
    touch_set set, other;
    touch_coder coder = touch_reading(&c, tables);
    memset(&set, 0, sizeof set), memset(&other, 0, sizeof other), memset(out, 0, sizeof *out);
    if (!tables || !models) touch_fail(&error, TOUCH_MEMORY, "no room for a support");
    if (!error.code && before) touch_set_of(grid, before, &other, arena, &error);
    if (error.code) return touch_error_in(&error, text);
    touch_set_fresh(models);
    if (touch_code_set(&coder, models, grid, &other, &set, arena, &error)) {
        touch_close(&coder, touch_min_bytes(set.list.count), &error);
        out->bricks = set.list.count, out->is_set = set.is_set;
        int32_t *brick = (int32_t *)touch_take(arena, 3 * set.list.count, 4);
        if (!brick) touch_fail(&error, TOUCH_MEMORY, "no room for a support");
        for (uint64_t i = 0; brick && i < set.list.count; i++) touch_position(set.list.key[i], brick + 3 * i);
        out->brick = brick;
    }
    return touch_error_in(&error, text);
}

int touch_decode_numbers(touch_bytes code, uint64_t count, touch_arena *arena, int64_t *numbers, const char **text) {
    touch_cursor error = touch_cursor_of(0, 0), c = touch_cursor_of(code.bytes, code.size);
    const touch_tables *tables = touch_tables_in(arena);
    touch_numbers *models = (touch_numbers *)touch_take(arena, 1, sizeof *models);
    touch_coder coder = touch_reading(&c, tables);
    if (!tables || !models) touch_fail(&error, TOUCH_MEMORY, "no room for numbers");
    if (error.code) return touch_error_in(&error, text);
    touch_numbers_fresh(models);
    touch_read_numbers(&coder, models, count, 1, numbers);
    touch_close(&coder, 0, &error);
    for (uint64_t i = 0; i < count && !error.code; i++)
        touch_need(&error, numbers[i] > -((int64_t)1 << 30) && numbers[i] < (int64_t)1 << 30, "a number beyond 2^30 - 1");
    return touch_error_in(&error, text);
}

/* Values of a frame as they are returned. */
static int touch_vibration_out(const touch_vibrating *v, touch_vibration_steps *out, touch_arena *arena) {
    int32_t *position = (int32_t *)touch_take(arena, 3 * v->samples, 4), *value[2];
    for (int n = 0; n < 2; n++) value[n] = (int32_t *)touch_take(arena, v->samples, 4);
    uint64_t mark = arena->used, *key = (uint64_t *)touch_take(arena, v->samples, 8);
    uint32_t *tag = (uint32_t *)touch_take(arena, v->samples, 4);
    if (!position || !value[0] || !value[1] || !key || !tag) return 0;
    touch_raster(&v->set, key, tag);
    for (uint64_t i = 0; i < v->samples; i++) {
        touch_position(key[i], position + 3 * i);
        for (int n = 0; n < 2; n++) value[n][i] = (int32_t)v->value[n][i];
    }
    out->samples = v->samples, out->position = position, out->step = value[0], out->hertz = value[1];
    arena->used = mark;
    return 1;
}

int touch_decode_vibration(const touch_grid *grid, touch_bytes body, uint32_t count, uint64_t max_samples,
                           touch_arena *arena, touch_vibration_steps *out, const char **text) {
    touch_cursor error = touch_cursor_of(0, 0), c = touch_cursor_of(body.bytes, body.size);
    const touch_tables *tables = touch_tables_in(arena);
    uint32_t possible = touch_vibration_frames(body.size, count);
    touch_vibrating *frames = (touch_vibrating *)touch_take_zero(arena, possible, sizeof *frames);
    if (!tables || !frames) touch_fail(&error, TOUCH_MEMORY, "no room for a vibration");
    if (!error.code && touch_read_vibration(c, tables, grid, count, max_samples, frames, arena, &error))
        touch_settle_vibration(frames, count, arena, &error);
    for (uint32_t i = 0; i < count && !error.code; i++)
        if (!touch_vibration_out(frames + i, out + i, arena)) touch_fail(&error, TOUCH_MEMORY, "no room for a vibration");
    return touch_error_in(&error, text);
}

int touch_decode_poses(touch_bytes code, uint32_t count, int64_t one, touch_arena *arena, int64_t *numbers,
                       const char **text) {
    touch_cursor error = touch_cursor_of(0, 0), c = touch_cursor_of(code.bytes, code.size);
    const touch_tables *tables = touch_tables_in(arena);
    touch_numbers *models = (touch_numbers *)touch_take(arena, 1, sizeof *models);
    if (!tables || !models) touch_fail(&error, TOUCH_MEMORY, "no room for poses");
    if (!count || one < 4 || one > (int64_t)1 << 30) touch_fail(&error, TOUCH_ARGUMENT, "no poses, or a quaternion step");
    if (!error.code) touch_read_poses(c, tables, one, count, numbers, models, &error);
    return touch_error_in(&error, text);
}

#endif
