/* A `.touch` file of one picture of depth: its relief, solid behind the surface, for a point device.

   The rules are those of the package. sources/terrain: h and its slopes are bilinear between pixels, slopes are those of
   planes fitted to 5 x 5 pixels, and the law acts on the distance (z - h) n_z. filters/point_filter: the field is sampled
   twice as finely, low-passed by a cubic B-spline, and limited. The page chooses lattice and placement. */
#ifndef TOUCH_RELIEF_H
#define TOUCH_RELIEF_H

enum { RELIEF_SIDE = 128, RELIEF_TAPS = 6, RELIEF_FINE = 2 * RELIEF_SIDE + RELIEF_TAPS - 2 };

typedef struct { /* numbers of the page; behind them lie the depths, m, row by row, 0 where there is none */
    double width, height;                                 /* pixels */
    double spacing_m[3], origin_m[3], scale, offset_m[3]; /* of the lattice, and the placement, as in HEAD */
    double x0_m, dx_m, y0_m, dy_m, step_m;                /* of pixels; neighbours farther apart are at an edge */
    double stiffness_n_per_m, force_max_n, floor_n, rate_hz;
} relief_request;

typedef struct {
    relief_request request;
    const float *depth_m;
    double spacing_m[3], origin_m[3], knee_m, slope_n_per_m; /* of the finer samples and the law, metres of the scene */
} relief_map;

typedef struct { /* of the surface under a column of samples */
    int is_known;
    double z_m, slope[2];
} relief_point;

typedef struct { /* of finer samples in a column: the outward normal, and newtons along it, low-passed along z */
    double normal[3];
    float newtons[RELIEF_SIDE];
} relief_column;

/* Cubic B-spline with the Nyquist rate of the lattice as cut-off, at the six finer samples about a sample. */
static const double relief_weight[RELIEF_TAPS] = {8.531891580787487e-06, 0.07329292595386505, 0.4266985356807709,
                                                  0.4266985356807709,    0.07329292595386505, 8.531891580787487e-06};
static relief_map relief;
static relief_column relief_row[RELIEF_TAPS][RELIEF_FINE]; /* finer samples of the latest rows */
static double relief_sum[RELIEF_FINE][RELIEF_SIDE][3];     /* low-passed along x and z */

static double relief_depth(int64_t row, int64_t col) { return relief.depth_m[row * (int64_t)relief.request.width + col]; }

/* Slopes in metres per pixel, along columns and rows, of the plane through the pixels about one; weights are binomial. */
static void relief_fit(int64_t row, int64_t col, double slope[2]) {
    static const double weight[5] = {1, 4, 6, 4, 1};
    double s = 0, sx = 0, sy = 0, sh = 0, sxx = 0, sxy = 0, syy = 0, sxh = 0, syh = 0, centre = relief_depth(row, col);
    for (int64_t y = -2; y < 3; y++)
        for (int64_t x = -2; x < 3; x++) {
            if (row + y < 0 || col + x < 0 || row + y >= relief.request.height || col + x >= relief.request.width) continue;
            double depth = relief_depth(row + y, col + x), h = depth - centre, w = weight[y + 2] * weight[x + 2];
            if (!(depth > 0) || !(fabs(h) <= relief.request.step_m)) continue;
            s += w, sx += w * x, sy += w * y, sh += w * h;
            sxx += w * x * x, sxy += w * x * y, syy += w * y * y, sxh += w * x * h, syh += w * y * h;
        }
    double cxx = sxx - sx * sx / s, cxy = sxy - sx * sy / s, cyy = syy - sy * sy / s;
    double cxh = sxh - sx * sh / s, cyh = syh - sy * sh / s, det = cxx * cyy - cxy * cxy, trace = cxx + cyy;
    slope[0] = slope[1] = 0;
    if (det > 1e-9 * trace * trace) {
        slope[0] = (cyy * cxh - cxy * cyh) / det, slope[1] = (cxx * cyh - cxy * cxh) / det;
    } else if (trace > 1e-9) { /* neighbours on one line: the slope along it */
        slope[0] = (cxx * cxh + cxy * cyh) / (trace * trace), slope[1] = (cxy * cxh + cyy * cyh) / (trace * trace);
    }
    slope[0] = (float)(slope[0] / relief.request.dx_m), slope[1] = (float)(slope[1] / relief.request.dy_m);
}

static double relief_within(double value, double high) { return value < 0 ? 0 : value > high ? high : value; }

/* The surface at a place, metres of the scene; across a step it is the plane of the nearest pixel. */
static relief_point relief_surface(double x, double y) {
    const relief_request *q = &relief.request;
    double u = (x - q->x0_m) / q->dx_m, v = (y - q->y0_m) / q->dy_m, slack = 1e-6, low = HUGE_VAL, high = 0, slope[2];
    relief_point p = {0, 0, {0, 0}};
    if (!(u >= -slack && u <= q->width - 1 + slack && v >= -slack && v <= q->height - 1 + slack)) return p;
    int64_t col = (int64_t)relief_within(u, q->width - 2), row = (int64_t)relief_within(v, q->height - 2);
    double fu = relief_within(u - (double)col, 1), fv = relief_within(v - (double)row, 1);
    for (int n = 0; n < 4; n++) {
        double w = (n & 2 ? fv : 1 - fv) * (n & 1 ? fu : 1 - fu), depth = relief_depth(row + (n >> 1), col + (n & 1));
        if (!(w > 0)) continue;
        if (!(depth > 0)) return p;
        relief_fit(row + (n >> 1), col + (n & 1), slope);
        low = depth < low ? depth : low, high = depth > high ? depth : high;
        p.z_m += w * depth, p.slope[0] += w * slope[0], p.slope[1] += w * slope[1];
    }
    p.is_known = 1;
    if (high - low > q->step_m) {
        int down = fv > 0.5, right = fu > 0.5;
        relief_fit(row + down, col + right, p.slope);
        p.z_m = relief_depth(row + down, col + right);
        p.z_m += p.slope[0] * (fu - right) * q->dx_m + p.slope[1] * (fv - down) * q->dy_m;
    }
    return p;
}

/* Newtons at a signed distance, negative inside: the law "penalty" of a solid. */
static double relief_newtons(double distance_m) {
    if (distance_m <= -relief.knee_m) return relief.request.force_max_n;
    return distance_m <= 0 ? -relief.slope_n_per_m * distance_m : 0;
}

/* A column of finer samples; the first of each axis are two before the lattice. */
static void relief_sample(int64_t x, int64_t y, relief_column *c) {
    double newtons[RELIEF_FINE];
    relief_point p = relief_surface(relief.origin_m[0] + (double)x * relief.spacing_m[0],
                                    relief.origin_m[1] + (double)y * relief.spacing_m[1]);
    double nz = 1 / sqrt(1 + p.slope[0] * p.slope[0] + p.slope[1] * p.slope[1]);
    memset(c, 0, sizeof *c);
    if (!p.is_known) return;
    c->normal[0] = p.slope[0] * nz, c->normal[1] = p.slope[1] * nz, c->normal[2] = -nz;
    for (int z = 0; z < RELIEF_FINE; z++)
        newtons[z] = relief_newtons((p.z_m - (relief.origin_m[2] + z * relief.spacing_m[2])) * nz);
    for (int z = 0; z < RELIEF_SIDE; z++) {
        double sum = 0;
        for (int n = 0; n < RELIEF_TAPS; n++) sum += relief_weight[n] * newtons[2 * z + n];
        c->newtons[z] = (float)sum;
    }
}

/* Low-pass the rows about a sample of the lattice along x; the rows before are those of the sample before. */
static void relief_sum_rows(int64_t x) {
    for (int64_t row = x ? 2 * x + RELIEF_TAPS - 2 : 0; row < 2 * x + RELIEF_TAPS; row++)
        for (int64_t y = 0; y < RELIEF_FINE; y++) relief_sample(row, y, relief_row[row % RELIEF_TAPS] + y);
    memset(relief_sum, 0, sizeof relief_sum);
    for (int64_t y = 0; y < RELIEF_FINE; y++)
        for (int n = 0; n < RELIEF_TAPS; n++) {
            const relief_column *c = relief_row[(2 * x + n) % RELIEF_TAPS] + y;
            for (int z = 0; z < RELIEF_SIDE; z++)
                for (int k = 0; k < 3; k++) relief_sum[y][z][k] += relief_weight[n] * c->newtons[z] * c->normal[k];
        }
}

/* A force of the lattice: low-passed along y, too, and limited as filters/limit does. */
static void relief_force(int64_t y, int64_t z, float out_n[3]) {
    double f[3] = {0, 0, 0}, most = relief.request.force_max_n, least = relief.request.floor_n, square, factor = 1;
    for (int n = 0; n < RELIEF_TAPS; n++)
        for (int k = 0; k < 3; k++) f[k] += relief_weight[n] * relief_sum[2 * y + n][z][k];
    square = f[0] * f[0] + f[1] * f[1] + f[2] * f[2];
    if (square > most * most) factor = most * (1 - 0x1p-22) / sqrt(square);
    else if (square < least * least) factor = 0;
    for (int k = 0; k < 3; k++) out_n[k] = (float)(f[k] * factor);
}

/* Move the bricks of a layer that have a force to its start; their count. */
static uint64_t relief_pack(int64_t x, int32_t *brick, float *forces_n) {
    enum { ACROSS = RELIEF_SIDE / 8 };
    uint64_t count = 0;
    for (int n = 0; n < ACROSS * ACROSS; n++) {
        int has_force = 0;
        for (int k = 0; k < 1536 && !has_force; k++) has_force = forces_n[1536 * n + k] != 0;
        if (!has_force) continue;
        memmove(forces_n + 1536 * count, forces_n + 1536 * n, 6144);
        brick[3 * count] = (int32_t)x, brick[3 * count + 1] = n / ACROSS, brick[3 * count + 2] = n % ACROSS, count++;
    }
    return count;
}

/* All bricks with a force, in ascending order; `brick` and `forces_n` have room for every brick of the lattice. */
static uint64_t relief_bricks(int32_t *brick, float *forces_n) {
    uint64_t count = 0;
    for (int64_t x = 0; x < RELIEF_SIDE; x++) {
        float *layer = forces_n + 1536 * count;
        relief_sum_rows(x);
        for (int64_t y = 0; y < RELIEF_SIDE; y++)
            for (int64_t z = 0; z < RELIEF_SIDE; z++)
                relief_force(y, z, layer + 1536 * (RELIEF_SIDE / 8 * (y >> 3) + (z >> 3)) +
                                       3 * (64 * (x & 7) + 8 * (y & 7) + (z & 7)));
        if ((x & 7) == 7) count += relief_pack(x >> 3, brick + 3 * count, layer);
    }
    return count;
}

/* What the page has written, in metres of the scene. */
static void relief_read(const void *memory) {
    memcpy(&relief.request, memory, sizeof relief.request);
    relief.depth_m = (const float *)((const char *)memory + sizeof relief.request);
    for (int n = 0; n < 3; n++) {
        double spacing_m = relief.request.spacing_m[n] / 2, before_m = 2.5 * spacing_m;
        relief.spacing_m[n] = spacing_m / relief.request.scale;
        relief.origin_m[n] = (relief.request.origin_m[n] - before_m) / relief.request.scale + relief.request.offset_m[n];
    }
    relief.knee_m = relief.request.force_max_n / relief.request.stiffness_n_per_m / relief.request.scale;
    relief.slope_n_per_m = relief.request.stiffness_n_per_m * relief.request.scale;
}

static touch_head relief_head(void) {
    static const touch_bytes direct = {(const uint8_t *)"direct", 6};
    const relief_request *q = &relief.request;
    touch_head h;
    memset(&h, 0, sizeof h);
    for (int n = 0; n < 3; n++) h.grid.shape[n] = RELIEF_SIDE;
    memcpy(h.grid.spacing_m, q->spacing_m, 24), memcpy(h.grid.origin_m, q->origin_m, 24);
    memcpy(h.mapping_offset_m, q->offset_m, 24);
    h.rate_hz = q->rate_hz, h.frame_count = 1, h.device_type = 1, h.force_max_n = q->force_max_n, h.mapping_scale = q->scale;
    h.axes = touch_text_of("x right, y down, z forward"), h.device_name = touch_text_of("phantom-omni");
    h.tags = 1, h.tag = &direct;
    return h;
}

/* Write the file of the picture that the page wrote to `room`, with the bound max(F_0, k |F|): a code of touch.h. */
EXPORT(record_relief) int record_relief(double k, double f0_n) {
    touch_options options = {TOUCH_MASK, 0, TOUCH_INTER_AUTO, 1, 1, k, f0_n, 0, 0};
    touch_source frame;
    memset(&frame, 0, sizeof frame);
    relief_read((const void *)(uintptr_t)page_file_at);
    touch_head head = relief_head();
    uint64_t all = touch_brick_count(&head.grid), brick_at = (page_file_at + page_file_size + 15) & ~(uint64_t)15;
    uint64_t forces_at = (brick_at + 12 * all + 15) & ~(uint64_t)15;
    if (!page_reach(forces_at + 6144 * all)) return record_fail(TOUCH_MEMORY, "not enough memory in the page");
    frame.brick = (const int32_t *)(uintptr_t)brick_at, frame.forces_n = (const float *)(uintptr_t)forces_at;
    frame.bricks = relief_bricks((int32_t *)(uintptr_t)brick_at, (float *)(uintptr_t)forces_at);
    if (!frame.bricks) return record_fail(TOUCH_ARGUMENT, "no sample of the lattice lies behind the surface");
    uint64_t work_at = forces_at + 6144 * frame.bricks, work = touch_encode_room(&head.grid, &options, frame.bricks);
    uint64_t out_at = (work_at + work + 15) & ~(uint64_t)15;
    int code = record_begin(&head, &options, out_at);
    if (!code) code = record_put(&frame, 0, 1, touch_arena_of((void *)(uintptr_t)work_at, work), out_at);
    return code ? code : record_end(1, out_at);
}

#endif
