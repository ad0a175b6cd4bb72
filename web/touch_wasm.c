/* touch.h and touch_write.h for a browser: a file, the two frames about an instant, what the page draws of them, and
   files that are written, from frames of the open one or from a picture of depth.

   Memory is one block: the file, a decoder each for even and odd segments (so that frames on both sides of a border
   live at once), two frames, and a piece that drawings are written to. Where it is too small it grows, to a limit. */
#define TOUCH_IMPLEMENTATION
#define TOUCH_WRITES
#include "../c/touch_encode.h"
#define TOUCH_ENCODE_IMPLEMENTATION
#pragma clang attribute push(__attribute__((minsize)), apply_to = function) /* small rather than fast: it is in every page */
#include "../c/touch_write.h"
#pragma clang attribute pop
#include "page.h"
#include "surface.h"

enum { PAGE = 1 << 16, MIN_DECODER_BYTES = 1 << 26, MAX_PARTS = 4096 };

extern uint8_t __heap_base;

static touch_file file;
static touch_decoder decoder[2];
static touch_arena arena[2];
static touch_frame frame[2];
static int64_t number[2], latest[2];    /* of the frames; of the last one that a decoder gave; -1: none */
static uint32_t segment[2];             /* that a decoder is in */
static int is_started[2];
uint64_t page_file_at, page_file_size;
static uint64_t decoder_bytes;
static int first, second;               /* frames about the instant, and how far the second counts */
static double fraction;
static touch_part between[MAX_PARTS]; /* of objects: poses at the instant */
static double out[16];
const char *page_message = "";

/* Memory up to a byte; 0: above the limit of the module. */
int page_reach(uint64_t end) {
    uint64_t pages = (end + PAGE - 1) / PAGE, own = __builtin_wasm_memory_size(0);
    if (pages <= own) return 1;
    if (pages > 65536) return 0;
    return __builtin_wasm_memory_grow(0, (size_t)(pages - own)) != (size_t)-1;
}

/* Address of the two decoders (0, 1), of the two frames (2, 3), which are smaller, and of what follows them (4). */
static uint64_t address_of(int n) {
    uint64_t at = (page_file_at + page_file_size + 15) & ~(uint64_t)15;
    if (n > 0) at += decoder_bytes;
    if (n > 1 && file.segment_count > 1) at += decoder_bytes;
    if (n > 2) at += decoder_bytes / 2;
    if (n > 3 && file.frame_count > 1) at += decoder_bytes / 2;
    return at;
}

static touch_arena arena_at(int n) {
    return touch_arena_of((void *)(uintptr_t)address_of(n), address_of(n + 1) - address_of(n));
}

static int lay(void) {
    int n;
    if (!page_reach(address_of(4))) {
        page_message = "not enough memory in the page";
        return TOUCH_MEMORY;
    }
    for (n = 0; n < 2; n++) is_started[n] = 0, number[n] = latest[n] = -1, arena[n] = arena_at(2 + n);
    return TOUCH_OK;
}

/* Memory for the bytes of a file; NULL: there is too little. */
EXPORT(room) uint8_t *room(uint32_t size) {
    page_file_at = ((uint64_t)(uintptr_t)&__heap_base + 15) & ~(uint64_t)15, page_file_size = size;
    return page_reach(page_file_at + page_file_size) ? (uint8_t *)(uintptr_t)page_file_at : 0;
}

EXPORT(open) int open_file(void) {
    int code = touch_open(&file, (const void *)(uintptr_t)page_file_at, page_file_size);
    page_message = code ? file.error : "", decoder_bytes = MIN_DECODER_BYTES, first = second = 0, fraction = 0;
    if (!code && file.object_count > MAX_PARTS) page_message = "too many objects", code = TOUCH_CORRUPT;
    return code ? code : lay();
}

/* -- a file in parts: its start, its index and end, and some segments ------------------------------------------------ */

static void check_vibration(touch_record *r, const touch_entry *e, touch_cursor *c) {
    uint32_t first = (uint32_t)touch_u(&r->payload, 4), count = (uint32_t)touch_u(&r->payload, 2);
    touch_need(c, !r->payload.code && first == e->first && count == e->count, "a VIBR of other frames than its segment");
}

/* HEAD and what follows it before the first segment; the chain of their CRC-32. */
static uint32_t read_start(touch_file *f, touch_cursor *c) {
    touch_entry e = touch_entry_at(f, 0);
    touch_cursor at = touch_cursor_of(f->data + TOUCH_OPENING, e.offset - TOUCH_OPENING);
    uint32_t chain = touch_crc(0, f->data, TOUCH_OPENING), records = 0, provenances = 0, vibrations = 0;
    while (at.at < at.end && !c->code) {
        touch_record r = touch_read_record(&at, f->data, 1);
        uint8_t crc[4];
        if (at.code) touch_fail(c, at.code, at.what);
        else if (!touch_need(c, (r.tag == TOUCH_HEAD) == !records++, "records in another order")) break;
        else if (r.tag == TOUCH_HEAD) touch_read_head(f, &r.payload);
        else if (r.tag == TOUCH_PROV && touch_need(c, !provenances++, "PROV twice")) touch_read_provenance(&r.payload);
        else if (r.tag == TOUCH_OBJT && touch_need(c, f->object_count++ < 4096, "too many OBJT")) touch_read_object(&r.payload);
        else if (r.tag == TOUCH_VIBR && touch_need(c, !vibrations++, "VIBR twice")) check_vibration(&r, &e, c);
        else if (touch_is_known(r.tag)) touch_fail(c, TOUCH_CORRUPT, "records in another order");
        if (r.payload.code) touch_fail(c, r.payload.code, r.payload.what);
        for (int n = 0; n < 4; n++) crc[n] = (uint8_t)(r.crc >> 8 * n);
        if (r.tag == TOUCH_HEAD || r.tag == TOUCH_OBJT) chain = touch_crc(chain, crc, 4);
    }
    touch_need(c, records > 0, "no HEAD");
    return chain;
}

/* Entries follow each other and have every frame once, after HEAD and before INDX. */
static void check_entries(const touch_file *f, uint64_t end, touch_cursor *c) {
    uint64_t next = TOUCH_OPENING, frames = 0;
    uint32_t n;
    for (n = 0; n < f->segment_count && !c->code; n++) {
        touch_entry e = touch_entry_at(f, n);
        touch_need(c, e.offset >= next && e.offset < end && e.length >= 26 && e.length <= end - e.offset && e.count > 0 &&
                          e.first == frames, "an entry of INDX");
        next = e.offset + e.length, frames += e.count;
    }
}

static void read_parts(touch_file *f, touch_cursor *c) {
    touch_cursor at;
    touch_record r;
    uint64_t index_at, size;
    uint32_t chain, own;
    uint8_t crc[4];
    if (!touch_check_opening(c, f->data, f->size)) return;
    if (f->size < TOUCH_OPENING + TOUCH_TEND_BYTES) return (void)touch_fail(c, TOUCH_CUT, "no end record");
    at = touch_cursor_of(f->data + f->size - TOUCH_TEND_BYTES, TOUCH_TEND_BYTES), r = touch_read_record(&at, f->data, 1);
    if (at.code || r.tag != TOUCH_TEND || r.length != 20) return (void)touch_fail(c, TOUCH_CUT, "no end record");
    index_at = touch_u(&r.payload, 8), size = touch_u(&r.payload, 8), chain = (uint32_t)touch_u(&r.payload, 4);
    int fits = size == f->size && index_at > TOUCH_OPENING && index_at < f->size - TOUCH_TEND_BYTES;
    if (!touch_need(c, fits, "TEND of another file")) return;
    at = touch_cursor_of(f->data + index_at, f->size - TOUCH_TEND_BYTES - index_at), r = touch_read_record(&at, f->data, 1);
    if (at.code) return (void)touch_fail(c, at.code, at.what);
    f->segment_count = (uint32_t)touch_u(&r.payload, 4);
    if (!touch_need(c, r.tag == TOUCH_INDX && !r.payload.code && f->segment_count > 0 &&
                           touch_left(&r.payload) == 26 * (uint64_t)f->segment_count, "INDX at another offset")) return;
    f->index.bytes = r.payload.at, f->index.size = touch_left(&r.payload);
    check_entries(f, index_at, c);
    if (c->code) return;
    for (int n = 0; n < 4; n++) crc[n] = (uint8_t)(r.crc >> 8 * n);
    own = touch_crc(read_start(f, c), crc, 4);
    if (c->code) return;
    touch_entry last = touch_entry_at(f, f->segment_count - 1);
    touch_need(c, own == chain && (uint64_t)last.first + last.count == f->frame_count, "HEAD, INDX or TEND of another file");
    touch_need(c, touch_is(f->coder, "objects") == (f->object_count > 0), "objects, or none where there are");
    if (!c->code && !touch_is(f->coder, "objects") && !touch_is(f->coder, "touch"))
        touch_fail(c, TOUCH_VERSION, "a coder that is not known here");
}

EXPORT(open_parts) int open_parts(void) {
    touch_cursor c;
    memset(&file, 0, sizeof file);
    file.data = (const uint8_t *)(uintptr_t)page_file_at, file.size = page_file_size;
    c = touch_cursor_of(file.data, file.size);
    read_parts(&file, &c);
    page_message = c.code ? c.what : "", decoder_bytes = MIN_DECODER_BYTES, first = second = 0, fraction = 0;
    return c.code ? c.code : lay();
}

/* The segment of a frame. */
EXPORT(segment_of) uint32_t segment_of(uint32_t n) { return touch_segment_of(&file, n); }

/* The first byte of a segment, with the records before it, and the byte after its last: two numbers. */
EXPORT(span) const double *span(uint32_t n) {
    touch_entry e = touch_entry_at(&file, n), before;
    if (n) before = touch_entry_at(&file, n - 1);
    out[0] = n ? (double)(before.offset + before.length) : (double)e.offset, out[1] = (double)(e.offset + e.length);
    return out;
}

/* Compare a segment that has arrived with its entry; 0: they agree. */
EXPORT(check) int check(uint32_t n) {
    const double *own = span(n);
    touch_cursor c = touch_cursor_of(file.data + (uint64_t)own[0], (uint64_t)(own[1] - own[0]));
    touch_entry e = touch_entry_at(&file, n);
    uint32_t vibrations = 0, segments = 0;
    while (c.at < c.end && !c.code) {
        touch_record r = touch_read_record(&c, file.data, 1);
        if (c.code) break;
        if (r.tag == TOUCH_SEGM) {
            touch_need(&c, !segments++ && e.offset == r.offset && e.length == r.length + 20 && e.crc == r.crc &&
                               e.first == touch_u(&r.payload, 4) && e.count == touch_u(&r.payload, 2), "an entry of INDX");
        } else if (r.tag == TOUCH_VIBR && touch_need(&c, !vibrations++, "VIBR twice")) check_vibration(&r, &e, &c);
        else if (touch_is_known(r.tag)) touch_fail(&c, TOUCH_CORRUPT, "records in another order");
    }
    if (!c.code) touch_need(&c, segments, "no segment in its entry of INDX");
    page_message = c.code ? c.what : "";
    return c.code;
}

EXPORT(message) const char *message_of(void) { return page_message; }

EXPORT(number) double number_of(int n) {
    const double values[] = {file.grid.shape[0],      file.grid.shape[1],     file.grid.shape[2],      file.grid.spacing_m[0],
                           file.grid.spacing_m[1],  file.grid.spacing_m[2], file.grid.origin_m[0],   file.grid.origin_m[1],
                           file.grid.origin_m[2],   file.rate_hz,           file.frame_count,        file.segment_count,
                           file.object_count,       file.device_type,       file.force_max_n,        file.force_threshold_n,
                           file.weber_fraction,     file.friction,          file.damping_n_s_per_m,  file.mapping_scale,
                           file.mapping_offset_m[0], file.mapping_offset_m[1], file.mapping_offset_m[2]};
    return n < 0 || n >= (int)(sizeof values / sizeof *values) ? 0 : values[n];
}

/* -- frames ------------------------------------------------------------------------------------------------------- */

/* Decode a frame into one of the two frames; the other stays. */
static int decode(uint32_t wanted, int to) {
    uint32_t own = touch_segment_of(&file, wanted);
    int d = own & 1, code = TOUCH_OK;
    if (!is_started[d]) {
        code = touch_start(decoder + d, &file, arena_at(d));
        is_started[d] = !code, latest[d] = -1;
    }
    if (!code && (latest[d] < 0 || segment[d] != own || latest[d] >= (int64_t)wanted))
        code = touch_seek(decoder + d, own), segment[d] = own, latest[d] = -1;
    number[to] = -1;
    while (!code && latest[d] != (int64_t)wanted) {
        arena[to].used = 0;
        code = touch_next(decoder + d, arena + to, frame + to);
        latest[d] = code ? -1 : (int64_t)frame[to].number;
    }
    number[to] = code ? -1 : (int64_t)wanted;
    if (code) page_message = code == TOUCH_END ? "a frame that is not where it should be" : decoder[d].error;
    return code;
}

static int decode_both(uint32_t a, uint32_t b) {
    int code = TOUCH_OK;
    first = number[1] == (int64_t)a || (number[0] != (int64_t)a && number[0] == (int64_t)b) ? 1 : 0;
    if (number[first] != (int64_t)a) code = decode(a, first);
    second = a == b ? first : !first;
    if (!code && number[second] != (int64_t)b) code = decode(b, second);
    return code;
}

static void quaternion_of(const double r[9], double q[4]) {
    double trace = r[0] + r[4] + r[8], s;
    int i = r[4] > r[0] ? 1 : 0, j, k;
    if (trace > 0) {
        s = sqrt(trace + 1) * 2;
        q[0] = s / 4, q[1] = (r[7] - r[5]) / s, q[2] = (r[2] - r[6]) / s, q[3] = (r[3] - r[1]) / s;
        return;
    }
    if (r[8] > r[4 * i]) i = 2;
    j = (i + 1) % 3, k = (i + 2) % 3;
    s = sqrt(1 + r[4 * i] - r[4 * j] - r[4 * k]) * 2;
    q[1 + i] = s / 4, q[1 + j] = (r[3 * i + j] + r[3 * j + i]) / s, q[1 + k] = (r[3 * i + k] + r[3 * k + i]) / s;
    q[0] = (r[3 * k + j] - r[3 * j + k]) / s;
}

/* A body between two frames: place and motion linear, its quaternion linear and made unit again. */
static void mix_part(const touch_part *a, const touch_part *b, touch_part *part) {
    double p[4], q[4], dot = 0, square = 0, s, *r = part->rotation;
    int n;
    *part = *a, part->field = fraction < 0.5 ? a->field : b->field;
    if (fraction == 0) return;
    for (n = 0; n < 3; n++) {
        part->position_m[n] += fraction * (b->position_m[n] - a->position_m[n]);
        part->velocity_m_s[n] += fraction * (b->velocity_m_s[n] - a->velocity_m_s[n]);
        part->spin_rad_s[n] += fraction * (b->spin_rad_s[n] - a->spin_rad_s[n]);
    }
    quaternion_of(a->rotation, p), quaternion_of(b->rotation, q);
    for (n = 0; n < 4; n++) dot += p[n] * q[n];
    for (n = 0; n < 4; n++) q[n] = (1 - fraction) * p[n] + (dot < 0 ? -fraction : fraction) * q[n], square += q[n] * q[n];
    s = square > 0 ? 2 / square : 0;
    r[0] = 1 - s * (q[2] * q[2] + q[3] * q[3]), r[1] = s * (q[1] * q[2] - q[0] * q[3]);
    r[2] = s * (q[1] * q[3] + q[0] * q[2]), r[3] = s * (q[1] * q[2] + q[0] * q[3]);
    r[4] = 1 - s * (q[1] * q[1] + q[3] * q[3]), r[5] = s * (q[2] * q[3] - q[0] * q[1]);
    r[6] = s * (q[1] * q[3] - q[0] * q[2]), r[7] = s * (q[2] * q[3] + q[0] * q[1]);
    r[8] = 1 - s * (q[1] * q[1] + q[2] * q[2]);
}

/* Decode what is about an instant, counted in frames. */
EXPORT(show) int show(double at) {
    double last = (double)file.frame_count - 1;
    uint32_t a, b, n;
    int code;
    at = at > 0 ? (at < last ? at : last) : 0;
    a = (uint32_t)(at + 1e-9), fraction = at - a;
    if (fraction <= 1e-9) fraction = 0;
    b = fraction > 0 ? a + 1 : a;
    while ((code = decode_both(a, b)) == TOUCH_MEMORY) {
        decoder_bytes *= 2;
        if (lay()) {
            decoder_bytes = MIN_DECODER_BYTES;
            break;
        }
    }
    if (code) {
        number[0] = number[1] = -1;
        return code;
    }
    page_message = "";
    for (n = 0; frame[first].is_placed && n < frame[first].parts; n++)
        mix_part(frame[first].part + n, frame[second].part + n, between + n);
    return TOUCH_OK;
}

/* -- forces ------------------------------------------------------------------------------------------------------- */

/* The field of one body at a point, turned into the scene: nothing of its motion, and nothing cut. */
static void bare_force(const touch_field *field, const touch_part *pose, const double p[3], double newtons[3]) {
    touch_part part = *pose;
    touch_frame alone;
    memset(&alone, 0, sizeof alone);
    part.field = field, alone.part = &part, alone.parts = 1, alone.is_placed = 1, alone.force_max_n = 1e300;
    touch_force(&alone, p[0], p[1], p[2], newtons);
}

static void force_of_bodies(const double p[3], double newtons[3]) {
    const touch_frame *a = frame + first, *b = frame + second;
    double floor_n = 1e-9 * a->force_max_n, size;
    uint32_t i;
    int n;
    newtons[0] = newtons[1] = newtons[2] = 0;
    for (i = 0; i < a->parts; i++) {
        const touch_part *t = between + i;
        const double *v = t->velocity_m_s, *w = t->spin_rad_s;
        double one[3], late[3], d[3];
        bare_force(a->part[i].field, t, p, one);
        if (a->part[i].field != b->part[i].field) {
            bare_force(b->part[i].field, t, p, late);
            for (n = 0; n < 3; n++) one[n] += fraction * (late[n] - one[n]);
        }
        if (a->surface_damping_n_s_per_m > 0 && one[0] * one[0] + one[1] * one[1] + one[2] * one[2] > floor_n * floor_n) {
            double c = a->surface_damping_n_s_per_m;
            for (n = 0; n < 3; n++) d[n] = p[n] - t->position_m[n];
            one[0] += c * (v[0] + w[1] * d[2] - w[2] * d[1]);
            one[1] += c * (v[1] + w[2] * d[0] - w[0] * d[2]);
            one[2] += c * (v[2] + w[0] * d[1] - w[1] * d[0]);
        }
        for (n = 0; n < 3; n++) newtons[n] += one[n];
    }
    size = sqrt(newtons[0] * newtons[0] + newtons[1] * newtons[1] + newtons[2] * newtons[2]);
    for (n = 0; n < 3 && size > a->force_max_n; n++) newtons[n] *= a->force_max_n / size;
}

static void force_of(const double p[3], double newtons[3]) {
    double late[3];
    int n;
    newtons[0] = newtons[1] = newtons[2] = 0;
    if (number[first] < 0) return;
    if (frame[first].is_placed && fraction > 0) {
        force_of_bodies(p, newtons);
        return;
    }
    touch_force(frame + first, p[0], p[1], p[2], newtons);
    if (!(fraction > 0)) return;
    touch_force(frame + second, p[0], p[1], p[2], late);
    for (n = 0; n < 3; n++) newtons[n] += fraction * (late[n] - newtons[n]);
}

/* Force, N, and amplitude, N, and frequency, Hz, of what vibrates there: five numbers. */
EXPORT(feel) const double *feel(double x, double y, double z) {
    double late[2], p[3];
    p[0] = x, p[1] = y, p[2] = z;
    force_of(p, out);
    out[3] = out[4] = 0;
    if (number[first] < 0) return out;
    touch_vibration(frame + first, x, y, z, out + 3);
    if (fraction > 0) {
        touch_vibration(frame + second, x, y, z, late);
        if (touch_adds_more(fraction * late[0], (1 - fraction) * out[3])) out[4] = late[1];
        out[3] += fraction * (late[0] - out[3]);
    }
    return out;
}

/* Forces, float [across][up][3], at points of a plane: origin, then one step across, then one step up. */
EXPORT(plane) const float *plane(double x, double y, double z, double ax, double ay, double az, double bx, double by,
                                 double bz, uint32_t across, uint32_t up) {
    uint64_t bytes = 12 * (uint64_t)across * up, at = address_of(4);
    float *to = (float *)(uintptr_t)at;
    uint32_t i, j;
    if (!page_reach(at + bytes)) return 0;
    for (i = 0; i < across; i++)
        for (j = 0; j < up; j++, to += 3) {
            double p[3], f[3];
            p[0] = x + i * ax + j * bx, p[1] = y + i * ay + j * by, p[2] = z + i * az + j * bz;
            force_of(p, f);
            to[0] = (float)f[0], to[1] = (float)f[1], to[2] = (float)f[2];
        }
    return (const float *)(uintptr_t)at;
}

/* -- what is drawn ------------------------------------------------------------------------------------------------ */

EXPORT(parts) uint32_t parts(void) { return number[first] < 0 ? 0 : frame[first].parts; }

/* How a body lies, twelve numbers: rotation row by row, and place, m. */
EXPORT(pose) const double *pose(uint32_t n) {
    int k;
    for (k = 0; k < 12; k++) out[k] = k < 9 && !(k & 3);
    if (number[first] >= 0 && frame[first].is_placed)
        memcpy(out, between[n].rotation, 72), memcpy(out + 9, between[n].position_m, 24);
    return out;
}

static const touch_field *field_of(uint32_t n) {
    return frame[first].is_placed ? between[n].field : frame[fraction < 0.5 ? first : second].part[n].field;
}

/* A number that stays while the field of a body stays the same; 0: it may change with every frame. */
EXPORT(field_key) uint32_t field_key(uint32_t n) {
    uint64_t at = (uint64_t)(uintptr_t)field_of(n);
    int d;
    for (d = 0; d < 2; d++)
        if (is_started[d] && at >= address_of(d) && at < address_of(d) + decoder[d].persistent) return (uint32_t)at;
    return 0;
}

/* The surface of first contact of a body, in its own frame: see surface.h. */
EXPORT(surface) const surface_mesh *surface(uint32_t n, double threshold_n, double depth_m) {
    static surface_mesh mesh;
    uint64_t at = address_of(4);
    memset(&mesh, 0, sizeof mesh);
    surface_make(field_of(n), threshold_n, depth_m, 0, &mesh);
    if (!page_reach(at + surface_bytes(&mesh))) return memset(&mesh, 0, sizeof mesh);
    surface_make(field_of(n), threshold_n, depth_m, (void *)(uintptr_t)at, &mesh);
    return &mesh;
}

/* The largest force of a field, N, and its place, m: four numbers. */
EXPORT(largest) const double *largest(uint32_t n) {
    surface_largest(field_of(n), out);
    return out;
}

/* -- a file that is written ------------------------------------------------------------------------------------------ */

#pragma clang attribute push(__attribute__((minsize)), apply_to = function)
#include "record.h"
#include "relief.h"
#pragma clang attribute pop
