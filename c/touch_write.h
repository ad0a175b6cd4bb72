/* touch_write.h: writes whole `.touch` files of coder `touch` from frames of forces, in C99. It needs
   touch_encode.h beside it.

   In one source file, in place of touch_encode.h:   #define TOUCH_ENCODE_IMPLEMENTATION
                                                     #include "touch_write.h"

   The file grows in one arena of the caller, `out`; segments are coded in another one, `work`, which is free again after
   each call. docs/format/container.md describes the records.

       touch_file_writer writer;  touch_bytes file;
       touch_write_start(&writer, &head, &options, touch_arena_of(out, out_size));
       for each segment:  touch_write_segment(&writer, frames, 0, count, touch_arena_of(work, work_size));
       touch_write_finish(&writer, &file);                    // file.bytes, file.size

   Every function returns TOUCH_OK or the reason, whose text is `writer.error`. A segment that fails leaves the file as it
   was: it can be coded again with more memory (touch_write_grow). */
#ifndef TOUCH_WRITE_H
#define TOUCH_WRITE_H

#include "touch_encode.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TOUCH_MAX_TAGS = 16, TOUCH_MAX_PAIRS = 64 };

typedef struct { /* a statement about the origin of a file: UTF-8, a key of 1 to 64 bytes, a value of at most 4096 */
    touch_bytes key, value;
} touch_pair;

typedef struct { /* what a file states besides its error bound, which is that of the options */
    touch_grid grid;
    double rate_hz;
    uint32_t frame_count;
    touch_bytes axes, device_name; /* UTF-8, at most 256 bytes each */
    int device_type;               /* 1 a point, 2 an array */
    double force_max_n, mapping_scale, mapping_offset_m[3], friction, damping_n_s_per_m;
    uint32_t tags, pairs;
    const touch_bytes *tag;  /* [tags], at most 16, of at most 64 bytes each */
    const touch_pair *pair;  /* [pairs], at most 64; 0: the file has no PROV */
} touch_head;

typedef struct {
    touch_head head;
    touch_options options;
    touch_arena out;
    uint32_t frames, segments; /* written so far */
    double max_error_ratio;    /* largest error as a fraction of the bound, of all segments */
    const char *error;
} touch_file_writer;

/* A text that ends with a zero. */
touch_bytes touch_text_of(const char *text);
/* Frames of a segment as the package has them: half a second, at least 8 and at most 64. */
uint32_t touch_segment_frames(double rate_hz);
/* HEAD and PROV. Modes TOUCH_MASK, TOUCH_MASK_DIRECTION, TOUCH_NMSE and TOUCH_LOSSLESS; the check of the whole head. */
int touch_write_start(touch_file_writer *writer, const touch_head *head, const touch_options *options, touch_arena out);
/* The next `count` frames, 1 to 65535, as one segment; `vibration` is NULL or has what vibrates in each frame. `work` needs
   touch_encode_room for the largest frame, or touch_part_room for the vibration; `out` has touch_segment_room left. */
int touch_write_segment(touch_file_writer *writer, const touch_source *frames, const touch_vibration_samples *vibration,
                        uint32_t count, touch_arena work);
/* Continue in a larger piece of memory, to which the caller has copied the bytes, or which was only extended. */
void touch_write_grow(touch_file_writer *writer, void *memory, uint64_t size);
/* INDX and TEND; all frames of the head must be there. The bytes lie in `out`. */
int touch_write_finish(touch_file_writer *writer, touch_bytes *file);

#ifdef __cplusplus
}
#endif
#endif

#if defined TOUCH_ENCODE_IMPLEMENTATION && !defined TOUCH_WRITE_IMPLEMENTED
#define TOUCH_WRITE_IMPLEMENTED

/* -- parts of records ------------------------------------------------------------------------------------------------ */

touch_bytes touch_text_of(const char *text) {
    touch_bytes out;
    out.bytes = (const uint8_t *)text, out.size = strlen(text);
    return out;
}

uint32_t touch_segment_frames(double rate_hz) {
    double frames = ceil(0.5 * rate_hz);
    return frames > 64 ? 64 : frames > 8 ? (uint32_t)frames : 8;
}

static int touch_write_report(touch_file_writer *w, int code, const char *text) {
    w->error = code ? text : "";
    return code;
}

/* The rest of the memory as a sink; its position in the file is `touch_sink.size`. */
static touch_sink touch_file_sink(const touch_file_writer *w) {
    touch_sink s;
    s.bytes = w->out.base, s.size = w->out.used, s.capacity = w->out.size;
    return s;
}

/* The bytes of a sink belong to the file. 0: they did not fit, and the file is as it was. */
static int touch_commit(touch_file_writer *w, const touch_sink *s) {
    if (s->size > s->capacity) return 0;
    w->out.used = s->size, w->out.peak = touch_larger(w->out.peak, s->size);
    return 1;
}

static void touch_put_f64(touch_sink *s, double value) {
    uint64_t bits;
    memcpy(&bits, &value, 8);
    touch_put_u(s, bits, 8);
}

static void touch_put_text(touch_sink *s, touch_bytes text) {
    touch_put_u(s, text.size, 2), touch_put(s, text.bytes, text.size);
}

/* The head of a record; the length follows in touch_end_record. Returns the position of its tag. */
static uint64_t touch_begin_record(touch_sink *s, uint32_t tag) {
    uint64_t start = s->size;
    touch_put_u(s, tag, 4), touch_put_u(s, tag == TOUCH_PROV || tag == TOUCH_VIBR ? 0 : 1, 4), touch_put_u(s, 0, 8);
    return start;
}

static void touch_end_record(touch_sink *s, uint64_t start) {
    touch_sink length = *s;
    if (s->size > s->capacity) return;
    length.size = start + 8, touch_put_u(&length, s->size - start - 16, 8);
    touch_put_u(s, touch_crc(0, s->bytes + start, s->size - start), 4);
}

/* -- HEAD and PROV ---------------------------------------------------------------------------------------------------- */

static void touch_put_parameters(touch_sink *s, const touch_options *o) {
    touch_put_u(s, o->mode == TOUCH_MASK_DIRECTION ? 26 : o->mode == TOUCH_MASK ? 18 : o->mode == TOUCH_NMSE ? 10 : 2, 4);
    touch_put_u(s, 1, 1);
    touch_put_u(s, (uint64_t)(o->mode | (o->is_support_exact ? 4 : 0) | (o->is_checked ? 8 : 0)), 1);
    if (o->mode == TOUCH_MASK || o->mode == TOUCH_MASK_DIRECTION) touch_put_f64(s, o->k), touch_put_f64(s, o->f0_n);
    if (o->mode == TOUCH_MASK_DIRECTION) touch_put_f64(s, o->direction_jnd_deg);
    if (o->mode == TOUCH_NMSE) touch_put_f64(s, o->step_n);
}

static void touch_put_head(touch_sink *s, const touch_head *h, const touch_options *o) {
    uint64_t start = touch_begin_record(s, TOUCH_HEAD);
    int has_mask = o->mode == TOUCH_MASK || o->mode == TOUCH_MASK_DIRECTION;
    for (int n = 0; n < 3; n++) touch_put_u(s, h->grid.shape[n], 4);
    for (int n = 0; n < 3; n++) touch_put_f64(s, h->grid.spacing_m[n]);
    for (int n = 0; n < 3; n++) touch_put_f64(s, h->grid.origin_m[n]);
    touch_put_f64(s, h->rate_hz), touch_put_u(s, h->frame_count, 4);
    touch_put_text(s, h->axes), touch_put_text(s, h->device_name), touch_put_u(s, (uint64_t)h->device_type, 1);
    touch_put_f64(s, h->force_max_n), touch_put_f64(s, h->mapping_scale);
    for (int n = 0; n < 3; n++) touch_put_f64(s, h->mapping_offset_m[n]);
    touch_put_f64(s, has_mask ? o->k : 0), touch_put_f64(s, has_mask ? o->f0_n : 0);
    touch_put_f64(s, h->friction), touch_put_f64(s, h->damping_n_s_per_m), touch_put_u(s, h->tags, 2);
    for (uint32_t n = 0; n < h->tags; n++) touch_put_text(s, h->tag[n]);
    touch_put_text(s, touch_text_of("touch")), touch_put_parameters(s, o);
    touch_end_record(s, start);
}

static void touch_put_pairs(touch_sink *s, const touch_head *h) {
    uint64_t start = touch_begin_record(s, TOUCH_PROV);
    touch_put_u(s, h->pairs, 2);
    for (uint32_t n = 0; n < h->pairs; n++) touch_put_text(s, h->pair[n].key), touch_put_text(s, h->pair[n].value);
    touch_end_record(s, start);
}

/* Lengths that would not fit their fields; the values are checked as a reader checks them. */
static int touch_fits_fields(const touch_head *h) {
    int fits = h->axes.size <= 256 && h->device_name.size <= 256 && h->tags <= TOUCH_MAX_TAGS && h->pairs <= TOUCH_MAX_PAIRS;
    for (uint32_t n = 0; fits && n < h->tags; n++) fits = h->tag[n].size <= 64;
    for (uint32_t n = 0; fits && n < h->pairs; n++) fits = h->pair[n].key.size <= 64 && h->pair[n].value.size <= 4096;
    return fits;
}

/* The options of a coder, which no reader checks in whole. */
static const char *touch_check_options(const touch_options *o) {
    int has_mask = o->mode == TOUCH_MASK || o->mode == TOUCH_MASK_DIRECTION;
    if (o->mode < TOUCH_MASK || o->mode > TOUCH_LOSSLESS) return "a mode that is not known";
    if (has_mask && !(o->k >= 0.001 && o->k < 1)) return "a Weber fraction k that is not from 0.001 to below 1";
    if (has_mask && !(o->f0_n >= 0 && o->f0_n <= 1e30)) return "a force F_0 that is not 0 N or more";
    if (o->mode == TOUCH_MASK_DIRECTION && !(o->direction_jnd_deg > 0 && o->direction_jnd_deg < 90))
        return "an angle that is not above 0 and below 90 degrees";
    return o->mode == TOUCH_NMSE && !(o->step_n > 0 && o->step_n <= 1e30) ? "a step that is not above 0 N" : 0;
}

int touch_write_start(touch_file_writer *writer, const touch_head *head, const touch_options *options, touch_arena out) {
    static const uint8_t opening[TOUCH_OPENING] = {0x89, 'T', 'O', 'U', 'C', 'H', '\r', '\n', 0x1a, '\n', 1, 0, 0, 0};
    const char *text = touch_check_options(options);
    touch_file read;
    memset(writer, 0, sizeof *writer), memset(&read, 0, sizeof read);
    writer->head = *head, writer->options = *options, writer->out = out, writer->out.used = 0;
    if (text) return touch_write_report(writer, TOUCH_ARGUMENT, text);
    if (!touch_fits_fields(head)) return touch_write_report(writer, TOUCH_ARGUMENT, "a text that is too long, or too many");
    touch_sink s = touch_file_sink(writer);
    touch_put(&s, opening, sizeof opening), touch_put_head(&s, head, options);
    uint64_t after_head = s.size;
    if (head->pairs) touch_put_pairs(&s, head);
    if (s.size > s.capacity) return touch_write_report(writer, TOUCH_MEMORY, "no room for the head of a file");
    touch_cursor c = touch_cursor_of(s.bytes + TOUCH_OPENING, after_head - TOUCH_OPENING);
    touch_record r = touch_read_record(&c, s.bytes, 0);
    touch_read_head(&read, &r.payload);
    if (!r.payload.code && head->pairs) {
        c = touch_cursor_of(s.bytes + after_head, s.size - after_head), r = touch_read_record(&c, s.bytes, 0);
        touch_read_provenance(&r.payload);
    }
    if (r.payload.code) return touch_write_report(writer, TOUCH_ARGUMENT, r.payload.what);
    touch_commit(writer, &s);
    return touch_write_report(writer, TOUCH_OK, "");
}

/* -- segments -------------------------------------------------------------------------------------------------------- */

void touch_write_grow(touch_file_writer *writer, void *memory, uint64_t size) {
    writer->out.base = (uint8_t *)memory, writer->out.size = size;
}

/* The body of the vibration of a segment, if anything vibrates in it. */
static int touch_put_vibrations(touch_file_writer *w, touch_sink *s, const touch_vibration_samples *vibration,
                                uint32_t count, touch_arena work) {
    uint64_t samples = 0, start;
    const char *text;
    touch_bytes body;
    for (uint32_t i = 0; vibration && i < count; i++) samples += vibration[i].samples;
    if (!samples) return TOUCH_OK;
    int code = touch_encode_vibration(&w->head.grid, vibration, count, &work, &body, &text);
    if (code) return touch_write_report(w, code, text);
    start = touch_begin_record(s, TOUCH_VIBR);
    touch_put_u(s, w->frames, 4), touch_put_u(s, count, 2), touch_put(s, body.bytes, body.size);
    touch_end_record(s, start);
    return TOUCH_OK;
}

/* The body of a segment; it is coded behind the bytes of a sink, and then moved to where it belongs. */
static int touch_put_body(touch_file_writer *w, touch_sink *s, const touch_source *frames, uint32_t count, touch_arena work,
                          touch_segment *segment) {
    double longest_n = 0;
    touch_encoder encoder;
    touch_arena out = w->out;
    memset(&encoder, 0, sizeof encoder); /* its body does not grow */
    out.used = s->size <= s->capacity ? s->size : s->capacity;
    for (uint32_t i = 0; i < count; i++) {
        double own_n = touch_longest_n(frames + i);
        if (!(own_n <= longest_n)) longest_n = own_n;
        if (!(own_n == own_n)) break; /* not a number: the encoder refuses it */
    }
    int code = touch_encode_start(&encoder, &w->head.grid, &w->options, longest_n, work, out);
    for (uint32_t i = 0; i < count && !code; i++) code = touch_encode_next(&encoder, frames + i, 0, 0);
    if (!code) code = touch_encode_finish(&encoder, frames, segment);
    if (code) return touch_write_report(w, code, encoder.error);
    memmove(s->bytes + s->size, segment->body, (size_t)segment->size), s->size += segment->size;
    segment->body = s->bytes + s->size - segment->size;
    return TOUCH_OK;
}

int touch_write_segment(touch_file_writer *writer, const touch_source *frames, const touch_vibration_samples *vibration,
                        uint32_t count, touch_arena work) {
    touch_sink s = touch_file_sink(writer);
    touch_segment segment;
    if (!count || count > 65535 || count > writer->head.frame_count - writer->frames)
        return touch_write_report(writer, TOUCH_ARGUMENT, "a segment of no frames, or of more than the head announces");
    int code = touch_put_vibrations(writer, &s, vibration, count, work);
    if (code) return code;
    uint64_t start = touch_begin_record(&s, TOUCH_SEGM);
    touch_put_u(&s, writer->frames, 4), touch_put_u(&s, count, 2);
    if ((code = touch_put_body(writer, &s, frames, count, work, &segment)) != 0) return code;
    touch_end_record(&s, start);
    if (!touch_commit(writer, &s)) return touch_write_report(writer, TOUCH_MEMORY, "no room for a segment");
    if (segment.max_error_ratio > writer->max_error_ratio) writer->max_error_ratio = segment.max_error_ratio;
    writer->frames += count, writer->segments++;
    return touch_write_report(writer, TOUCH_OK, "");
}

/* -- INDX and TEND --------------------------------------------------------------------------------------------------- */

/* An entry for each segment among the records that are written. */
static void touch_put_entries(touch_sink *s, const uint8_t *data, uint64_t size) {
    touch_cursor c = touch_cursor_of(data + TOUCH_OPENING, size - TOUCH_OPENING);
    while (c.at < c.end && !c.code) {
        touch_record r = touch_read_record(&c, data, 0);
        if (r.tag != TOUCH_SEGM) continue;
        touch_put_u(s, touch_u(&r.payload, 4), 4), touch_put_u(s, touch_u(&r.payload, 2), 2);
        touch_put_u(s, r.offset, 8), touch_put_u(s, r.length + 20, 8), touch_put_u(s, r.crc, 4);
    }
}

int touch_write_finish(touch_file_writer *writer, touch_bytes *file) {
    touch_sink s = touch_file_sink(writer);
    uint64_t size = s.size, start;
    uint32_t chain;
    if (writer->frames != writer->head.frame_count)
        return touch_write_report(writer, TOUCH_ARGUMENT, "fewer frames than the head announces");
    touch_cursor c = touch_cursor_of(s.bytes + TOUCH_OPENING, size - TOUCH_OPENING);
    touch_read_record(&c, s.bytes, 0); /* HEAD: its CRC-32 lies before the cursor */
    chain = touch_crc(touch_crc(0, s.bytes, TOUCH_OPENING), c.at - 4, 4);
    start = touch_begin_record(&s, TOUCH_INDX);
    touch_put_u(&s, writer->segments, 4), touch_put_entries(&s, writer->out.base, size), touch_end_record(&s, start);
    if (s.size <= s.capacity) chain = touch_crc(chain, s.bytes + s.size - 4, 4);
    uint64_t index = start, end = s.size + TOUCH_TEND_BYTES;
    start = touch_begin_record(&s, TOUCH_TEND);
    touch_put_u(&s, index, 8), touch_put_u(&s, end, 8), touch_put_u(&s, chain, 4), touch_end_record(&s, start);
    if (!touch_commit(writer, &s)) return touch_write_report(writer, TOUCH_MEMORY, "no room for the index of a file");
    file->bytes = writer->out.base, file->size = writer->out.used;
    return touch_write_report(writer, TOUCH_OK, "");
}

#endif
