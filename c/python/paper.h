/* Coder paper, which C does not decode by itself: decode_huffman, adpcm (_native.pyi). */
#ifndef TOUCHFIELD_PAPER_H
#define TOUCHFIELD_PAPER_H

#include "query.h"

/* -- Huffman codes ---------------------------------------------------------------------------------------------------- */

#define MAX_CODE_BITS 24 /* touchfield.codec.paper.body.MAX_CODE_BITS */
#define MAX_RUN_BITS 24

typedef struct { /* bits in bytes, highest first; zeros behind the last byte */
    const uint8_t *data;
    int64_t size, next, used;
    uint64_t pending; /* the `filled` lowest bits are not read yet */
    int filled;
} bit_reader;

typedef struct { /* HuffmanCode.tables */
    const int64_t *limit, *rank;
    const uint16_t *order;
    int64_t symbols;
} huffman_tables;

static inline void fill_bits(bit_reader *bits) {
    for (; bits->filled <= 48; bits->filled += 8) {
        uint8_t byte = bits->next < bits->size ? bits->data[bits->next] : 0;
        bits->pending = bits->pending << 8 | byte;
        bits->next++;
    }
}

static inline int64_t take_bits(bit_reader *bits, int count) {
    bits->filled -= count, bits->used += count;
    return (int64_t)(bits->pending >> bits->filled & (((uint64_t)1 << count) - 1));
}

/* The next symbol; -1 for bits that are no code. */
static inline int64_t take_symbol(bit_reader *bits, const huffman_tables *tables) {
    if (bits->filled < MAX_CODE_BITS) fill_bits(bits);
    int64_t window = (int64_t)(bits->pending >> (bits->filled - MAX_CODE_BITS) & (((uint64_t)1 << MAX_CODE_BITS) - 1));
    int length = 1;
    while (length <= MAX_CODE_BITS && window >= tables->limit[length]) length++;
    if (length > MAX_CODE_BITS) return -1;
    int64_t index = tables->rank[length] + (window >> (MAX_CODE_BITS - length));
    (void)take_bits(bits, length);
    return index >= 0 && index < tables->symbols ? tables->order[index] : -1;
}

/* Sets `sent` of each sample that is sent, and writes its level. Returns the number of levels, -1 for faulty bits. */
static inline int64_t decode_huffman(bit_reader *reader, const huffman_tables *tables, int64_t level_count, uint8_t *sent,
                                     int64_t samples, uint16_t *level, int64_t capacity) {
    int64_t sample = 0, levels = 0;
    bit_reader bits = *reader; /* in registers: bytes that are written might alias the caller's */
    huffman_tables table = *tables;
    while (sample < samples) {
        int64_t symbol = take_symbol(&bits, &table), run = symbol - level_count;
        if (symbol < 0 || run > MAX_RUN_BITS) return -1;
        if (run < 0) {
            if (levels == capacity) return -1;
            level[levels++] = (uint16_t)symbol;
            sent[sample++] = 1;
            continue;
        }
        if (bits.filled < run) fill_bits(&bits);
        sample += ((int64_t)1 << run) + take_bits(&bits, (int)run);
        if (sample > samples) return -1;
    }
    reader->used = bits.used;
    return levels;
}

/* (data, limits, ranks, order, level_count, sent, levels) */
static PyObject *native_decode_huffman(PyObject *module, PyObject *arguments) {
    PyObject *data, *limits, *ranks, *order, *sent, *levels;
    long long level_count;
    int64_t lengths = MAX_CODE_BITS + 1, samples = -1, capacity = -1, decoded = -1;
    huffman_tables tables = {NULL, NULL, NULL, -1};
    bit_reader bits = {NULL, -1, 0, 0, 0, 0};
    buffer_list arrays = {NULL, 0, 0};
    uint8_t *is_sent = NULL;
    uint16_t *level = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOOLOO", &data, &limits, &ranks, &order, &level_count, &sent, &levels)) return NULL;
    int is_read = (bits.data = (const uint8_t *)add_array(&arrays, data, 1, &bits.size)) &&
                  (tables.limit = (const int64_t *)add_numbers(&arrays, limits, 1, &lengths)) &&
                  (tables.rank = (const int64_t *)add_numbers(&arrays, ranks, 1, &lengths)) &&
                  (tables.order = (const uint16_t *)add_array(&arrays, order, 2, &tables.symbols)) &&
                  (is_sent = (uint8_t *)add_output(&arrays, sent, 1, &samples)) &&
                  (level = (uint16_t *)add_output(&arrays, levels, 2, &capacity));
    if (is_read) {
        PyThreadState *state = PyEval_SaveThread();
        decoded = decode_huffman(&bits, &tables, level_count, is_sent, samples, level, capacity);
        PyEval_RestoreThread(state);
    }
    release_arrays(&arrays);
    return is_read ? Py_BuildValue("LL", (long long)(decoded < 0 ? -1 : bits.used), (long long)decoded) : NULL;
}

/* -- ADPCM ------------------------------------------------------------------------------------------------------------ */

enum { ADPCM_ONE = 1 << 16, ADPCM_NUDGE = 48, ADPCM_STEPS = 9 };
#define ADPCM_FAR ((int64_t)1 << 40)
#define ADPCM_MAX_RESIDUAL ((int64_t)1 << 48) /* beyond it a product with a step might overflow */

static inline int64_t clamp(int64_t x, int64_t low, int64_t high) { return x < low ? low : x > high ? high : x; }
static inline int64_t sign_of(int64_t x) { return (x > 0) - (x < 0); }
static inline int64_t floor_shift(int64_t x, int bits) { return x < 0 ? ~(~x >> bits) : x >> bits; }

/* Reads values and writes residuals, or the reverse; values become the decoded signal. */
static inline void adpcm(int64_t *value, int64_t *residual, int64_t count, int is_decoding) {
    /* in sixteenths of the finest step; each is larger by a factor 2^(1/4) */
    static const int64_t steps[ADPCM_STEPS] = {16, 19, 23, 27, 32, 38, 45, 54, 64};
    int64_t w0 = ADPCM_ONE, w1 = 0, last = 0, before = 0;
    int rung = 0;
    for (int64_t n = 0; n < count; n++) {
        int64_t slope = last - before, step = steps[rung];
        int64_t predicted = floor_shift(w0 * last + w1 * slope + (ADPCM_ONE >> 1), 16);
        if (!is_decoding) {
            int64_t error = clamp(value[n], -ADPCM_MAX_RESIDUAL, ADPCM_MAX_RESIDUAL) - predicted;
            int64_t size = (2 * (error < 0 ? -error : error) + step) / (2 * step);
            residual[n] = error < 0 ? -size : size;
        }
        int64_t q = clamp(residual[n], -ADPCM_MAX_RESIDUAL, ADPCM_MAX_RESIDUAL);
        value[n] = clamp(predicted + q * step, -ADPCM_FAR, ADPCM_FAR); /* only faulty bytes reach the limit */
        w0 = clamp(w0 + ADPCM_NUDGE * sign_of(q) * sign_of(last), ADPCM_ONE * 7 / 8, ADPCM_ONE * 9 / 8);
        w1 = clamp(w1 + ADPCM_NUDGE * sign_of(q) * sign_of(slope), -ADPCM_ONE / 4, ADPCM_ONE);
        if (q >= 2 || q <= -2) rung = rung < ADPCM_STEPS - 1 ? rung + 1 : rung;
        else if (!q) rung = rung > 0 ? rung - 1 : 0;
        before = last, last = value[n];
    }
}

/* (values, residuals, is_decoding) */
static PyObject *native_adpcm(PyObject *module, PyObject *arguments) {
    PyObject *values, *residuals;
    int is_decoding;
    int64_t count = -1;
    buffer_list arrays = {NULL, 0, 0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOp", &values, &residuals, &is_decoding)) return NULL;
    int64_t *value = (int64_t *)add_output(&arrays, values, 8, &count);
    int64_t *residual = value ? (int64_t *)add_output(&arrays, residuals, 8, &count) : NULL;
    int is_done = residual && ((is_aligned(value, 8) && is_aligned(residual, 8)) || !count ||
                               refuse(TOUCH_ARGUMENT, "numbers that are not aligned"));
    if (is_done) {
        PyThreadState *state = PyEval_SaveThread();
        adpcm(value, residual, count, is_decoding);
        PyEval_RestoreThread(state);
    }
    return done(&arrays, is_done);
}

/* clang-format off */
#define PAPER_METHODS \
    {"decode_huffman", native_decode_huffman, METH_VARARGS, "Samples and levels of a Huffman code."}, \
    {"adpcm", native_adpcm, METH_VARARGS, "ADPCM of one component."}
/* clang-format on */

#endif
