/* touch_materials.h: writes a table of materials (JSON, as src/touchfield/render/material.py describes it) into the memory of a
   receiver. The last of two equal keys counts, keys that are not known are ignored. */
#ifndef TOUCH_MATERIALS_H
#define TOUCH_MATERIALS_H

#include "touch_effects.h"
#include "touch_provenance.h"

#define TOUCH_MAX_MATERIALS 64
#define TOUCH_MAX_LEVELS 32           /* number of speeds, and of forces, of one material */
#define TOUCH_DEFAULT_SLIP_M 0.001
#define TOUCH_MIN_SLIP_M 1e-6
#define TOUCH_HIGHEST_BAND_HZ 1000.0  /* the bands are thirds of an octave up to it */

/* Index of a body by its name as JSON has it, in quotes; below 0: there is none. */
typedef int64_t (*touch_body_finder)(const void *context, touch_stated_text name);

/* Bytes that a table of so many bytes takes at most: a number takes two bytes of it or more, a material ten. */
static inline uint64_t touch_materials_room(uint64_t json_bytes) {
    uint64_t materials = json_bytes / 10 < TOUCH_MAX_MATERIALS ? json_bytes / 10 : TOUCH_MAX_MATERIALS;
    return sizeof(touch_material_sines) + materials * sizeof(touch_material) + 8 * (json_bytes / 2 + 1);
}

/* -- JSON ------------------------------------------------------------------------------------------------------------- */

/* The next item of an array; `*at` is 1 for the first one. 0: there is none. */
static inline int touch_json_next(touch_stated_text array, uint64_t *at, touch_stated_text *item) {
    if (array.size < 2 || array.at[0] != '[' || *at >= array.size - 1) return 0;
    const char *start = array.at + *at, *stop = array.at + array.size - 1, *p = start;
    for (int depth = 0; p < stop && (depth || *p != ','); p++) {
        if (*p == '"' && !(p = touch_json_quote(p + 1, stop))) return 0;
        depth += (*p == '[' || *p == '{') - (*p == ']' || *p == '}');
    }
    *item = touch_trimmed(start, p), *at = (uint64_t)(p - array.at) + 1;
    return item->size > 0;
}

/* The numbers in an array of any depth, in their order; how many, -1: something else, or more than `capacity`. */
static inline int64_t touch_json_numbers(touch_stated_text text, double *out, int64_t capacity) {
    int64_t count = 0;
    const char *at = text.at, *stop = text.at + text.size;
    while (text.at && at < stop) {
        touch_stated_text number = {at, 0};
        for (; at < stop && *at != ',' && *at != ']' && *at != '[' && !touch_is_json_space(*at); at++) number.size++;
        if (!number.size) {
            at++;
            continue;
        }
        if (count == capacity || isnan(out[count] = touch_json_number(number))) return -1;
        count++;
    }
    return count;
}

/* The code point at `*at` of a string, after its escapes; a half of a pair is returned as it is. */
static inline uint32_t touch_json_character(const char **at, const char *stop) {
    static const char escapes[] = "b\bf\fn\nr\rt\t";
    uint32_t code = 0;
    char first = *(*at)++;
    if (first != '\\' || *at == stop) return (uint8_t)first;
    first = *(*at)++;
    for (int n = 0; n < 10; n += 2)
        if (first == escapes[n]) return (uint8_t)escapes[n + 1];
    if (first != 'u') return (uint8_t)first;
    for (int n = 0; n < 4 && *at < stop; n++) {
        char digit = *(*at)++;
        code = code << 4 | (uint32_t)(digit <= '9' ? digit - '0' : (digit | 32) - 'a' + 10);
    }
    return code;
}

/* One code point as UTF-8; the bytes that it takes. */
static inline int touch_utf8_of(uint32_t code, uint8_t out[4]) {
    int more = code < 0x80 ? 0 : code < 0x800 ? 1 : code < 0x10000 ? 2 : 3;
    static const uint8_t first[4] = {0, 0xc0, 0xe0, 0xf0};
    for (int n = more; n > 0; n--, code >>= 6) out[n] = (uint8_t)(0x80 | (code & 0x3f));
    out[0] = (uint8_t)(first[more] | code);
    return more + 1;
}

/* Whether a string of JSON, in quotes, is a name in UTF-8. */
static inline int touch_json_is_name(touch_stated_text json, const uint8_t *name, uint64_t size) {
    if (json.size < 2 || json.at[0] != '"') return 0;
    const char *at = json.at + 1, *stop = json.at + json.size - 1;
    uint64_t used = 0;
    while (at < stop) {
        uint8_t bytes[4] = {(uint8_t)*at, 0, 0, 0};
        int count = 1, is_escape = *at == '\\';
        uint32_t code = touch_json_character(&at, stop);
        if (code >= 0xd800 && code < 0xdc00 && at < stop && *at == '\\')
            code = 0x10000 + ((code - 0xd800) << 10) + ((touch_json_character(&at, stop) - 0xdc00) & 0x3ff);
        if (is_escape) count = touch_utf8_of(code, bytes);
        if (used + (uint64_t)count > size || memcmp(name + used, bytes, (size_t)count)) return 0;
        used += (uint64_t)count;
    }
    return used == size;
}

/* A member that is there and not null. */
static inline touch_stated_text touch_json_given(touch_stated_text json, const char *key) {
    touch_stated_text value = touch_json_member(json, key), none = {NULL, 0};
    return touch_text_is(value, "null") ? none : value;
}

/* A number of at least `low` into `*out`, which else stays as it is; 0: it is something else. */
static inline int touch_json_at_least(touch_stated_text json, const char *key, double low, double *out) {
    touch_stated_text value = touch_json_given(json, key);
    if (!value.at) return 1;
    *out = touch_json_number(value);
    return *out >= low && *out < HUGE_VAL;
}

/* -- one material ----------------------------------------------------------------------------------------------------- */

typedef struct { /* where numbers are written next, and behind the last one; offsets in the receiver */
    touch_receiver *receiver;
    int64_t at, stop;
} touch_number_writer;

/* Write the numbers of a member of a material; how many, -1: something else. */
static inline int64_t touch_write_numbers(touch_number_writer *w, touch_stated_text json, const char *key, int64_t *offset) {
    double *out = (double *)(void *)((char *)w->receiver + w->at);
    int64_t count = touch_json_numbers(touch_json_given(json, key), out, (w->stop - w->at) / 8);
    *offset = w->at;
    if (count > 0) w->at += 8 * count;
    return count;
}

/* Whether the numbers at an offset rise from above zero, and are not too many. */
static inline int touch_numbers_rise(const touch_receiver *receiver, int64_t offset, int64_t count) {
    const double *number = (const double *)(const void *)((const char *)receiver + offset);
    for (int64_t n = 0; n < count; n++)
        if (!(number[n] > (n ? number[n - 1] : 0.0) && number[n] < HUGE_VAL)) return 0;
    return count >= 0 && count <= TOUCH_MAX_LEVELS;
}

/* The table of a texture; 0: it is damaged. */
static inline int touch_write_levels(touch_number_writer *w, touch_stated_text json, touch_material *out) {
    out->speed_count = touch_write_numbers(w, json, "speeds_m_s", &out->speed_offset);
    out->force_count = touch_write_numbers(w, json, "forces_n", &out->force_offset);
    int64_t count = touch_write_numbers(w, json, "texture_rms_n", &out->level_offset);
    const double *level = (const double *)(const void *)((const char *)w->receiver + out->level_offset);
    for (int64_t n = 0; n < count; n++)
        if (!(level[n] >= 0.0 && level[n] < HUGE_VAL)) return 0;
    return touch_numbers_rise(w->receiver, out->speed_offset, out->speed_count) &&
           touch_numbers_rise(w->receiver, out->force_offset, out->force_count) &&
           count == out->speed_count * out->force_count * TOUCH_BANDS && (count || out->speed_count + out->force_count == 0);
}

/* The box of a material; 0: it is damaged. */
static inline int touch_read_box(touch_stated_text json, touch_material *out) {
    touch_stated_text value = touch_json_given(json, "box_m");
    double box[6];
    out->low_m = touch_vector_of(-HUGE_VAL, -HUGE_VAL, -HUGE_VAL), out->high_m = touch_vector_of(HUGE_VAL, HUGE_VAL, HUGE_VAL);
    if (!value.at) return 1;
    if (touch_json_numbers(value, box, 6) != 6) return 0;
    out->low_m = touch_vector_of(box[0], box[1], box[2]), out->high_m = touch_vector_of(box[3], box[4], box[5]);
    return box[0] <= box[3] && box[1] <= box[4] && box[2] <= box[5];
}

/* Write a material and its numbers; 0: it is damaged, or of a body that is not there. */
static inline int touch_write_material(touch_number_writer *w, touch_stated_text json, touch_material *out,
                                       touch_body_finder find, const void *context) {
    touch_stated_text body = touch_json_given(json, "object"), name = touch_json_given(json, "name");
    if (!name.size || name.at[0] != '"') return 0;
    memset(out, 0, sizeof *out);
    out->friction = (double)NAN, out->slip_m = TOUCH_DEFAULT_SLIP_M, out->body = body.at ? find(context, body) : -1;
    if ((body.at && out->body < 0) || !touch_json_at_least(json, "friction", 0.0, &out->friction)) return 0;
    double low = isnan(out->friction) ? HUGE_VAL : out->friction; /* no static friction without friction */
    return touch_json_at_least(json, "static_friction", low, &out->static_friction) &&
           touch_json_at_least(json, "slip_length_m", TOUCH_MIN_SLIP_M, &out->slip_m) && touch_read_box(json, out) &&
           touch_write_levels(w, json, out);
}

/* -- the table -------------------------------------------------------------------------------------------------------- */

/* The centre of a band, Hz. */
static inline double touch_band_hz(int band) {
    return TOUCH_HIGHEST_BAND_HZ * pow(10.0, (double)(band + 1 - TOUCH_BANDS) / 10.0);
}

/* Sines at rest: four in each band, with distinct phases. */
static inline void touch_start_sines(touch_material_sines *sines) {
    for (int n = 0; n < TOUCH_SINE_COUNT; n++) {
        double turns = n * 0.6180339887498949, third = (n % TOUCH_BAND_SINES + 0.5) / TOUCH_BAND_SINES - 0.5;
        sines->frequency_rad_s[n] = 2.0 * TOUCH_PI * touch_band_hz(n / TOUCH_BAND_SINES) * pow(10.0, 0.1 * third);
        sines->phase_rad[n] = 2.0 * TOUCH_PI * (turns - floor(turns));
    }
}

/* Whether the bands of a table are those that the renderer has, to three digits. */
static inline int touch_has_bands(touch_stated_text json) {
    double band_hz[TOUCH_BANDS];
    int is_equal = touch_json_numbers(touch_json_member(json, "bands_hz"), band_hz, TOUCH_BANDS) == TOUCH_BANDS;
    for (int n = 0; n < TOUCH_BANDS && is_equal; n++) is_equal = fabs(band_hz[n] / touch_band_hz(n) - 1.0) < 0.005;
    return is_equal;
}

/* Write a table at an offset, touch_materials_room bytes, and set it in the settings; 0: it is damaged, or has a material of a
   body that is not there. Without `has_friction`, friction is that of the settings everywhere. */
static inline int touch_write_materials(touch_receiver *receiver, int64_t offset, touch_stated_text json, int has_friction,
                                        touch_body_finder find, const void *context) {
    touch_stated_text rows = touch_json_member(json, "materials"), item;
    touch_material_sines *sines = (touch_material_sines *)(void *)((char *)receiver + offset);
    touch_material *material = (touch_material *)(void *)(sines + 1);
    int64_t stop = offset + (int64_t)touch_materials_room(json.size), count = 0;
    if (!touch_has_bands(json) || rows.size < 2 || rows.at[0] != '[') return 0;
    for (uint64_t at = 1; touch_json_next(rows, &at, &item); count++) {}
    touch_number_writer w = {receiver, offset + (int64_t)(sizeof *sines + (uint64_t)count * sizeof *material), stop};
    if (count > TOUCH_MAX_MATERIALS || w.at > stop) return 0;
    count = 0;
    for (uint64_t at = 1; touch_json_next(rows, &at, &item); count++) {
        if (!touch_write_material(&w, item, material + count, find, context)) return 0;
        if (!has_friction) material[count].friction = (double)NAN;
    }
    touch_start_sines(sines);
    receiver->settings.material_offset = offset, receiver->settings.material_count = count;
    return 1;
}

#endif
