/* Parts of the coder by themselves, for tests (native_model.py). */
#define TOUCH_ENCODE_IMPLEMENTATION
#include "touch_encode.h"

int64_t model_root(int64_t n);
int64_t model_border(int64_t floor, int64_t rate, touch_arena arena, touch_steps *out);
int64_t model_level_of(const touch_steps *steps, int64_t length);
int64_t model_length_of(const touch_steps *steps, int64_t level);
void model_basis(const int32_t centre[3], int64_t along, int64_t b, int64_t c, int64_t axes[9], int32_t vector[3]);
void model_lattice(const touch_options *options, double longest_n, double out[7]);
void model_fractions(const double bits[3], uint8_t out[2]);
int model_compare(const touch_grid *grid, const touch_options *options, const touch_source *original,
                  const touch_source *decoded, int is_prediction, touch_arena arena, touch_comparison *out);

int64_t model_root(int64_t n) { return touch_isqrt(n); }

int64_t model_border(int64_t floor, int64_t rate, touch_arena arena, touch_steps *out) {
    memset(out, 0, sizeof *out), out->floor = floor, out->rate = rate;
    return touch_step_table(out, &arena) ? out->borders : -1;
}

int64_t model_level_of(const touch_steps *steps, int64_t length) { return touch_step_position(steps, length); }

int64_t model_length_of(const touch_steps *steps, int64_t level) { return touch_length_at(steps, level); }

void model_basis(const int32_t centre[3], int64_t along, int64_t b, int64_t c, int64_t axes[9], int32_t vector[3]) {
    touch_voxel v;
    touch_basis(centre, touch_length(centre), v.basis), memcpy(axes, v.basis, sizeof v.basis);
    touch_residual_vector(&v, along, b, c, vector);
}

/* The lattice of a segment, and the bound of its passes in units: unit_n, floor, rate, across; k, f0. */
void model_lattice(const touch_options *options, double longest_n, double out[7]) {
    touch_steps s;
    touch_choose_steps(options, longest_n, &s);
    touch_bound bound = touch_pass_bound(options, &s);
    out[0] = (double)s.unit_n, out[1] = (double)s.floor, out[2] = (double)s.rate, out[3] = (double)s.cross_floor;
    out[4] = (double)s.cross_rate, out[5] = bound.k, out[6] = bound.f0;
}

void model_fractions(const double bits[3], uint8_t out[2]) {
    touch_sink s;
    s.bytes = out, s.size = 0, s.capacity = 2;
    touch_put_fractions(&s, bits);
}

/* 1; 0: no memory. Mode LOSSLESS compares every bit: 1 violation stands for any. */
int model_compare(const touch_grid *grid, const touch_options *options, const touch_source *original,
                  const touch_source *decoded, int is_prediction, touch_arena arena, touch_comparison *out) {
    touch_bound bound = touch_frame_bound(options, is_prediction);
    touch_brick_forces forces;
    uint32_t *slot = (uint32_t *)touch_take(&arena, decoded->bricks, 4);
    forces.count = decoded->bricks, forces.key = touch_source_keys(decoded, &arena), forces.forces_n = decoded->forces_n;
    for (uint32_t i = 0; i < decoded->bricks; i++) slot[i] = i;
    forces.slot = slot;
    if (options->mode != TOUCH_LOSSLESS) { /* the outliers are errors, and listed as if they were sent */
        touch_comparison sent;
        if (!touch_compare(original, &forces, &bound, grid, TOUCH_SEND_OUTLIERS, &sent, &arena)) return 0;
        if (!touch_compare(original, &forces, &bound, grid, TOUCH_COUNT_OUTLIERS, out, &arena)) return 0;
        out->outlier = sent.outlier;
        return 1;
    }
    memset(out, 0, sizeof *out);
    out->outliers = !touch_is_identical(original, &forces, &out->decoded, &arena);
    return 1;
}

typedef struct { /* a base layer */
    const uint8_t *bytes;
    uint64_t size, bricks;
    const uint64_t *key;
    const touch_int_vector *v;
} model_layer;

int model_columns(const touch_grid *grid, const touch_source *frame, double unit_n, double k, double f0, touch_arena arena,
                  model_layer *out);
int model_spline(const touch_grid *grid, const touch_source *frame, const touch_spline *spline, touch_arena arena,
                 model_layer *out);
int model_read(const touch_grid *grid, touch_bytes data, touch_arena arena, model_layer *out, const char **text);

static int layer_of(int found, const touch_sink *s, const touch_units *units, const touch_cursor *error, model_layer *out) {
    out->bytes = s->bytes, out->size = s->size, out->bricks = units->list.count, out->key = units->list.key;
    out->v = units->v;
    return error->code ? -error->code : found;
}

static touch_tables *tables_of(touch_arena *arena) {
    touch_tables *tables = (touch_tables *)touch_take(arena, 1, sizeof *tables);
    touch_fill_tables(tables);
    return tables;
}

/* 1; 0: there are none; below 0: minus a code. */
int model_columns(const touch_grid *grid, const touch_source *frame, double unit_n, double k, double f0, touch_arena arena,
                  model_layer *out) {
    touch_cursor error = touch_cursor_of(0, 0);
    touch_sink s;
    touch_units units;
    memset(&s, 0, sizeof s), memset(&units, 0, sizeof units);
    const touch_tables *tables = tables_of(&arena);
    int found = touch_fit_columns(grid, tables, frame, (float)unit_n, k, f0, &s, &units, &arena, &error);
    return layer_of(found, &s, &units, &error, out);
}

int model_spline(const touch_grid *grid, const touch_source *frame, const touch_spline *spline, touch_arena arena,
                 model_layer *out) {
    touch_cursor error = touch_cursor_of(0, 0);
    touch_sink s;
    touch_units units;
    memset(&s, 0, sizeof s), memset(&units, 0, sizeof units);
    const touch_tables *tables = tables_of(&arena);
    return layer_of(touch_put_spline(grid, tables, frame, spline, &s, &units, &arena, &error), &s, &units, &error, out);
}

/* A base layer with its kind in front, read: 1, or minus a code. */
int model_read(const touch_grid *grid, touch_bytes data, touch_arena arena, model_layer *out, const char **text) {
    touch_cursor error = touch_cursor_of(0, 0), c = touch_cursor_of(data.bytes, data.size);
    touch_sink s;
    touch_units units;
    memset(&s, 0, sizeof s), memset(&units, 0, sizeof units);
    const touch_tables *tables = tables_of(&arena);
    uint64_t kind = touch_u(&c, 1);
    if (touch_need(&c, kind <= 1, "a kind that there is not"))
        (kind ? touch_read_columns : touch_read_spline)(c, grid, tables, &units, &arena, &error);
    else error = c;
    *text = error.code ? error.what : "";
    return layer_of(1, &s, &units, &error, out);
}

void model_scan(int order, const touch_grid *grid, const int32_t brick[3], int32_t sample[512], int32_t to[3],
                int32_t inside[6]);

/* Of an order of the scan: the sample of the grid of each sample of a brick; a brick of the grid in the scan; and the
   samples of that brick which lie within the grid, low and high. */
void model_scan(int order, const touch_grid *grid, const int32_t brick[3], int32_t sample[512], int32_t to[3],
                int32_t inside[6]) {
    touch_scan s = touch_scan_of(order, grid);
    int low[3], high[3];
    for (int n = 0; n < 512; n++) sample[n] = touch_grid_sample(&s, n >> 6, n >> 3 & 7, n & 7);
    touch_position(touch_scan_key(&s, touch_key(brick[0], brick[1], brick[2])), to);
    touch_scan_inside(&s, grid, to, low, high);
    for (int n = 0; n < 3; n++) inside[n] = low[n], inside[3 + n] = high[n];
}

/* -- the range coder, and lists of bricks ---------------------------------------------------------------------------- */

enum { MODEL_CODE, MODEL_MIX, MODEL_EVEN, MODEL_GAMMA };

typedef struct { /* of scripts of calls */
    touch_context context[64];
    int64_t weight[3][5][4]; /* by the number of contexts, too */
} model_bits;

int model_write_bits(const int64_t *calls, uint64_t count, const int64_t *values, touch_arena arena, model_bits *models,
                     touch_bytes *out, uint64_t *position);
void model_read_bits(const int64_t *calls, uint64_t count, touch_bytes data, touch_arena arena, model_bits *models,
                     int64_t *values, uint64_t *position);
void model_tables(int32_t squash[6143], int32_t stretch[4096]);
int model_write_list(const uint32_t shape[3], const touch_samples *bricks, const touch_samples *before, touch_arena arena,
                     touch_bytes *out);
int model_read_list(const uint32_t shape[3], touch_bytes data, const touch_samples *before, touch_arena arena,
                    touch_list *out, int32_t *bit, const char **text);

/* Calls [count][3]: a function, and two arguments. */
static void run_calls(touch_coder *b, model_bits *m, const int64_t *calls, uint64_t count, const int64_t *in, int64_t *out) {
    TOUCH_FRESH(m->context, m->weight);
    for (uint64_t i = 0; i < count; i++, calls += 3) {
        int64_t value = in ? in[i] : 0;
        touch_context *c[4];
        for (int64_t n = 0; n < 4; n++) c[n] = m->context + (calls[1] * (n + 3) + (int64_t)i * n) % 64;
        if (calls[0] == MODEL_CODE) value = touch_code(b, m->context + calls[1], (int)value);
        else if (calls[0] == MODEL_MIX)
            value = touch_mix(b, c, m->weight[calls[1] % 3][calls[2]], (int)calls[2], (int)value);
        else if (calls[0] == MODEL_EVEN) value = touch_even(b, (int)calls[2], value);
        else value = touch_gamma(b, (int)calls[2], value);
        out[i] = value;
    }
}

int model_write_bits(const int64_t *calls, uint64_t count, const int64_t *values, touch_arena arena, model_bits *models,
                     touch_bytes *out, uint64_t *position) {
    int64_t *written = (int64_t *)touch_take(&arena, count, 8);
    const touch_tables *tables = tables_of(&arena);
    touch_spent spent;
    touch_sink s;
    if (!written || !touch_sink_make(&s, 128 * count + 64, &arena)) return 0;
    touch_coder b = touch_writing(&s, tables, &spent);
    run_calls(&b, models, calls, count, values, written);
    *position = b.position;
    if (!touch_finish(&b, &s)) return 0;
    out->bytes = s.bytes, out->size = s.size;
    return 1;
}

void model_read_bits(const int64_t *calls, uint64_t count, touch_bytes data, touch_arena arena, model_bits *models,
                     int64_t *values, uint64_t *position) {
    touch_cursor c = touch_cursor_of(data.bytes, data.size);
    touch_coder b = touch_reading(&c, tables_of(&arena));
    run_calls(&b, models, calls, count, 0, values);
    *position = b.position;
}

void model_tables(int32_t squash[6143], int32_t stretch[4096]) {
    touch_tables tables;
    touch_fill_tables(&tables);
    for (int i = 0; i < 6143; i++) squash[i] = tables.squash[i];
    for (int i = 0; i < 4096; i++) stretch[i] = tables.stretch[i];
}

static touch_list list_of(const touch_samples *bricks, touch_arena *arena) {
    touch_list list;
    list.key = (uint64_t *)touch_take(arena, bricks->bricks, 8), list.count = bricks->bricks;
    for (uint64_t i = 0; i < list.count; i++)
        list.key[i] = touch_key(bricks->brick[3 * i], bricks->brick[3 * i + 1], bricks->brick[3 * i + 2]);
    return list;
}

/* A list followed by a 1 of a context of its own, padded. */
int model_write_list(const uint32_t shape[3], const touch_samples *bricks, const touch_samples *before, touch_arena arena,
                     touch_bytes *out) {
    touch_cursor error = touch_cursor_of(0, 0);
    touch_list list = list_of(bricks, &arena), known = list_of(before, &arena);
    const touch_tables *tables = tables_of(&arena);
    touch_list_models models;
    touch_context own = {TOUCH_INITIAL_PROBABILITY, 0};
    touch_spent spent;
    touch_sink s;
    if (!touch_sink_make(&s, 320 * list.count + 64, &arena)) return TOUCH_MEMORY;
    TOUCH_FRESH(models.context, models.weight);
    touch_coder b = touch_writing(&s, tables, &spent);
    touch_code_list(&b, &models, shape, known, &list, &arena, &error);
    touch_code(&b, &own, 1);
    if (!touch_finish(&b, &s)) return TOUCH_MEMORY;
    touch_pad(&s, 0, touch_min_bytes(list.count));
    out->bytes = s.bytes, out->size = s.size;
    return error.code;
}

/* The list, and the bit after it. */
int model_read_list(const uint32_t shape[3], touch_bytes data, const touch_samples *before, touch_arena arena,
                    touch_list *out, int32_t *bit, const char **text) {
    touch_cursor error = touch_cursor_of(0, 0), c = touch_cursor_of(data.bytes, data.size);
    touch_list known = list_of(before, &arena);
    touch_coder b = touch_reading(&c, tables_of(&arena));
    touch_list_models models;
    touch_context own = {TOUCH_INITIAL_PROBABILITY, 0};
    TOUCH_FRESH(models.context, models.weight);
    if (touch_code_list(&b, &models, shape, known, out, &arena, &error)) *bit = touch_code(&b, &own, 0);
    *text = error.code ? error.what : "";
    return error.code;
}
