/* A new file from frames of the open one: decoded, coded again with another error bound, and written by touch_write.h.

   Behind the two frames of the page lie the frames of a segment, the memory of the encoder, and the file, which grows. */
#ifndef TOUCH_RECORD_H
#define TOUCH_RECORD_H

enum { RECORD_STORE_BYTES = 1 << 28, RECORD_PROVENANCE_BYTES = 1 << 19, RECORD_OUT_BYTES = 1 << 20 };

static uint8_t record_provenance[RECORD_PROVENANCE_BYTES]; /* the payload of PROV, from the page */
static touch_bytes record_tag[TOUCH_MAX_TAGS];
static touch_pair record_pair[TOUCH_MAX_PAIRS];
static touch_file_writer record_writer;

typedef struct { /* the largest frame of a range, and where its parts lie in memory */
    uint64_t bricks, vibrating_bricks, vibrating;
    uint32_t length; /* frames of a segment */
    uint64_t store_at, work_at, out_at;
} record_plan;

static int record_fail(int code, const char *text) {
    page_message = text;
    return code;
}

/* The provenance from the page. */
static int record_provenance_of(touch_head *h) {
    touch_cursor provenance = touch_cursor_of(record_provenance, sizeof record_provenance);
    h->pairs = (uint32_t)touch_u(&provenance, 2), h->pair = record_pair;
    for (uint32_t n = 0; n < h->pairs && n < TOUCH_MAX_PAIRS; n++)
        record_pair[n].key = touch_text(&provenance, 1, 64, 0), record_pair[n].value = touch_text(&provenance, 0, 4096, 1);
    return provenance.code ? record_fail(TOUCH_ARGUMENT, "a provenance that is too long") : TOUCH_OK;
}

/* Start a file at an address, behind all that is in use. */
static int record_begin(touch_head *head, const touch_options *options, uint64_t out_at) {
    int code = record_provenance_of(head);
    if (code) return code;
    if (!page_reach(out_at + RECORD_OUT_BYTES)) return record_fail(TOUCH_MEMORY, "not enough memory in the page");
    code = touch_write_start(&record_writer, head, options, touch_arena_of((void *)(uintptr_t)out_at, RECORD_OUT_BYTES));
    return code ? record_fail(code, record_writer.error) : TOUCH_OK;
}

/* Write frames as one segment; the file gets more memory as long as there is some. */
static int record_put(const touch_source *frames, const touch_vibration_samples *vibration, uint32_t count, touch_arena work,
                      uint64_t out_at) {
    int code;
    while ((code = touch_write_segment(&record_writer, frames, vibration, count, work)) == TOUCH_MEMORY) {
        uint64_t size = 2 * record_writer.out.size;
        if (!page_reach(out_at + size)) return record_fail(code, "not enough memory in the page");
        touch_write_grow(&record_writer, (void *)(uintptr_t)out_at, size);
    }
    return code ? record_fail(code, record_writer.error) : TOUCH_OK;
}

/* Write what ends a file. */
static int record_end(uint32_t count, uint64_t out_at) {
    touch_bytes bytes;
    uint64_t size = record_writer.out.size + 4096 + 26 * (uint64_t)count;
    if (!page_reach(out_at + size)) return record_fail(TOUCH_MEMORY, "not enough memory in the page");
    touch_write_grow(&record_writer, (void *)(uintptr_t)out_at, size);
    int code = touch_write_finish(&record_writer, &bytes);
    page_message = record_writer.error;
    return code;
}

/* A frame into the first place; memory grows as for what is shown. */
static int record_decode(uint32_t n) {
    int code;
    while ((code = decode(n, 0)) == TOUCH_MEMORY) {
        decoder_bytes *= 2;
        if ((code = lay()) != 0) return code;
    }
    return code;
}

static uint64_t record_vibrating(const touch_field *f) {
    uint64_t samples = 0;
    for (uint64_t k = 0; f && k < 512 * (uint64_t)f->bricks; k++) samples += f->forces_n[3 * k] > 0;
    return samples;
}

/* Decode the range once for the sizes, so that the memory of the decoders does not grow afterwards. */
static int record_scan(uint32_t from, uint32_t count, const touch_options *options, record_plan *p) {
    memset(p, 0, sizeof *p);
    for (uint32_t n = from; n < from + count; n++) {
        int code = record_decode(n);
        if (code) return code;
        const touch_field *f = frame[0].part[0].field, *v = frame[0].vibration;
        p->bricks = touch_larger(p->bricks, f->bricks);
        p->vibrating = touch_larger(p->vibrating, record_vibrating(v));
        p->vibrating_bricks = touch_larger(p->vibrating_bricks, v ? v->bricks : 0);
    }
    uint64_t own = 6144 * p->bricks + 64 * p->bricks + 64 * p->vibrating + 1024, length = RECORD_STORE_BYTES / own;
    p->length = touch_segment_frames(file.rate_hz);
    if (p->length > length) p->length = length ? (uint32_t)length : 1;
    if (p->length > count) p->length = count;
    uint64_t work = touch_encode_room(&file.grid, options, p->bricks), part = 0;
    if (p->vibrating) part = touch_part_room(p->length * p->vibrating_bricks, 2 * p->length * p->vibrating, p->length);
    part += 64 * p->length * p->vibrating + 32768 * p->length * p->vibrating_bricks;
    p->store_at = (address_of(4) + 15) & ~(uint64_t)15, p->work_at = p->store_at + p->length * own;
    p->out_at = (p->work_at + touch_larger(work, part) + 15) & ~(uint64_t)15;
    return page_reach(p->out_at + RECORD_OUT_BYTES) ? TOUCH_OK : record_fail(TOUCH_MEMORY, "not enough memory in the page");
}

/* The bricks of a field in ascending order; those without a force are left out. */
static int record_field(const touch_field *f, touch_source *out, touch_arena *arena) {
    uint64_t *key = (uint64_t *)touch_take(arena, f->bricks, 8), count = 0;
    uint32_t *tag = (uint32_t *)touch_take(arena, f->bricks, 4);
    int32_t *brick = (int32_t *)touch_take(arena, 3 * (uint64_t)f->bricks, 4);
    float *forces = (float *)touch_take(arena, 1536 * (uint64_t)f->bricks, 4);
    if (!key || !tag || !brick || !forces) return 0;
    for (uint32_t entry = 0; entry <= f->mask; entry++) {
        int64_t at[3];
        const float *v = f->forces_n + 1536 * (uint64_t)f->table[2 * entry + 1];
        int any = 0;
        if (!f->table[2 * entry]) continue;
        for (int k = 0; k < 1536 && !any; k++) any = v[k] != 0;
        surface_position(f, entry, at);
        if (any) key[count] = touch_key(at[0], at[1], at[2]), tag[count++] = f->table[2 * entry + 1];
    }
    touch_sort(key, tag, count);
    for (uint64_t i = 0; i < count; i++) {
        touch_position(key[i], brick + 3 * i);
        memcpy(forces + 1536 * i, f->forces_n + 1536 * (uint64_t)tag[i], 6144);
    }
    out->bricks = count, out->brick = brick, out->forces_n = forces, out->hidden_n = 0;
    return 1;
}

/* The samples that vibrate, in raster order. */
static int record_vibration(const touch_field *f, touch_vibration_samples *out, touch_arena *arena) {
    uint64_t count = record_vibrating(f), n = 0, *key = (uint64_t *)touch_take(arena, count, 8);
    uint32_t *tag = (uint32_t *)touch_take(arena, count, 4);
    int32_t *position = (int32_t *)touch_take(arena, 3 * count, 4);
    float *both = (float *)touch_take(arena, 2 * count, 4);
    if (!key || !tag || !position || !both) return 0;
    for (uint32_t entry = 0; f && entry <= f->mask; entry++) {
        int64_t at[3];
        uint32_t slot = f->table[2 * entry + 1];
        if (!f->table[2 * entry]) continue;
        surface_position(f, entry, at);
        for (uint32_t k = 0; k < 512; k++) {
            if (!(f->forces_n[3 * (512 * (uint64_t)slot + k)] > 0)) continue;
            key[n] = touch_key(8 * at[0] + (k >> 6), 8 * at[1] + (k >> 3 & 7), 8 * at[2] + (k & 7));
            tag[n++] = 512 * slot + k;
        }
    }
    touch_sort(key, tag, count);
    for (uint64_t i = 0; i < count; i++) {
        touch_position(key[i], position + 3 * i);
        both[i] = f->forces_n[3 * (uint64_t)tag[i]], both[count + i] = f->forces_n[3 * (uint64_t)tag[i] + 1];
    }
    out->samples = count, out->position = position, out->amplitude_n = both, out->frequency_hz = both + count;
    return 1;
}

/* The next frames as one segment. */
static int record_segment(uint32_t from, uint32_t count, const record_plan *p) {
    static touch_source frames[64];
    static touch_vibration_samples vibration[64];
    touch_arena store = touch_arena_of((void *)(uintptr_t)p->store_at, p->work_at - p->store_at);
    touch_arena work = touch_arena_of((void *)(uintptr_t)p->work_at, p->out_at - p->work_at);
    int code;
    for (uint32_t n = 0; n < count; n++) {
        if ((code = record_decode(from + n)) != 0) return code;
        if (address_of(4) > p->store_at || !record_field(frame[0].part[0].field, frames + n, &store) ||
            !record_vibration(frame[0].vibration, vibration + n, &store))
            return record_fail(TOUCH_MEMORY, "not enough memory for the frames of a segment");
    }
    return record_put(frames, vibration, count, work, p->out_at);
}

/* What HEAD of the open file states. */
static int record_head(uint32_t count, touch_head *h) {
    touch_cursor at = touch_cursor_of(file.data + TOUCH_OPENING, file.size - TOUCH_OPENING);
    touch_cursor c = touch_read_record(&at, file.data, 0).payload;
    memset(h, 0, sizeof *h);
    h->grid = file.grid, h->rate_hz = file.rate_hz, h->frame_count = count, h->axes = file.axes;
    h->device_name = file.device_name, h->device_type = file.device_type, h->force_max_n = file.force_max_n;
    h->mapping_scale = file.mapping_scale, h->friction = file.friction, h->damping_n_s_per_m = file.damping_n_s_per_m;
    memcpy(h->mapping_offset_m, file.mapping_offset_m, sizeof h->mapping_offset_m);
    touch_skip(&c, 72), touch_text(&c, 0, 256, 0), touch_text(&c, 0, 256, 0), touch_skip(&c, 1 + 9 * 8);
    h->tags = (uint32_t)touch_u(&c, 2), h->tag = record_tag;
    for (uint32_t n = 0; n < h->tags && n < TOUCH_MAX_TAGS; n++) record_tag[n] = touch_text(&c, 0, 64, 0);
    return c.code ? record_fail(TOUCH_ARGUMENT, "a head that is not readable") : TOUCH_OK;
}

/* Where the page writes the payload of PROV, before it calls `record`. */
EXPORT(provenance) uint8_t *provenance(uint32_t size) { return size <= RECORD_PROVENANCE_BYTES ? record_provenance : 0; }

/* Write `count` frames from a first one with the bound max(F_0, k |F|): a code of touch.h. */
EXPORT(record) int record(uint32_t from, uint32_t count, double k, double f0_n) {
    touch_options options = {TOUCH_MASK, 0, TOUCH_INTER_AUTO, 1, 1, 0, 0, 0, 0};
    touch_head head;
    record_plan plan;
    int code;
    if (file.object_count || !touch_is(file.coder, "touch"))
        return record_fail(TOUCH_ARGUMENT, "the page saves files of coder touch only, and this one has the coder objects");
    if (!count || from >= file.frame_count || count > file.frame_count - from)
        return record_fail(TOUCH_ARGUMENT, "frames after the last one");
    options.k = k, options.f0_n = f0_n;
    if ((code = record_head(count, &head)) != 0 || (code = record_scan(from, count, &options, &plan)) != 0) return code;
    code = record_begin(&head, &options, plan.out_at);
    for (uint32_t n = 0; n < count && !code; n += plan.length)
        code = record_segment(from + n, count - n < plan.length ? count - n : plan.length, &plan);
    return code ? code : record_end(count, plan.out_at);
}

/* The file that is written: its address, its bytes, and its largest error as a fraction of the bound. */
EXPORT(recorded) const double *recorded(void) {
    out[0] = (double)(uintptr_t)record_writer.out.base, out[1] = (double)record_writer.out.used;
    out[2] = record_writer.max_error_ratio;
    return out;
}

#endif
