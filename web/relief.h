/* A `.touch` file of one picture of depth: its relief, solid behind the surface, at the samples of a lattice.

   The rule is that of sources/terrain in the package: h and its slopes are bilinear between pixels, slopes are those of
   planes fitted to 5 x 5 pixels, and the law acts on the distance (z - h) n_z. The page chooses lattice and placement. */
#ifndef TOUCH_RELIEF_H
#define TOUCH_RELIEF_H

typedef struct { /* numbers of the page; behind them lie the depths, m, row by row, 0 where there is none */
    double width, height, side;                     /* pixels; samples along each axis */
    double spacing_m[3], origin_m[3], scale, offset_m[3]; /* of the lattice, and of the hand as in HEAD */
    double x0_m, dx_m, y0_m, dy_m, step_m;          /* positions of pixels; neighbours farther apart are at an edge */
    double stiffness_n_per_m, force_max_n, rate_hz;
} relief_request;

typedef struct {
    relief_request request;
    const float *depth_m;
    double spacing_m[3], origin_m[3], knee_m, slope_n_per_m; /* of the lattice and the law, metres of the scene */
} relief_map;

typedef struct { /* of the surface under a column of samples */
    int is_known;
    double z_m, slope[2];
} relief_point;

static relief_map relief;

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
        p.z_m = relief_depth(row + down, col + right) + p.slope[0] * (fu - right) * q->dx_m + p.slope[1] * (fv - down) * q->dy_m;
    }
    return p;
}

/* Newtons at a signed distance, negative inside: the law "penalty" of a solid. */
static double relief_newtons(double distance_m) {
    if (distance_m <= -relief.knee_m) return relief.request.force_max_n;
    return distance_m <= 0 ? -relief.slope_n_per_m * distance_m : 0;
}

/* The forces of a brick under 64 points of the surface; whether there are any. */
static int relief_brick(const relief_point point[64], int64_t z, float *forces_n) {
    int has_force = 0;
    for (int column = 0; column < 64; column++) {
        const relief_point *p = point + column;
        double nz = 1 / sqrt(1 + p->slope[0] * p->slope[0] + p->slope[1] * p->slope[1]);
        for (int k = 0; k < 8; k++, forces_n += 3) {
            double f = p->is_known ? -relief_newtons((p->z_m - (relief.origin_m[2] + (double)(8 * z + k) * relief.spacing_m[2])) * nz) : 0;
            forces_n[0] = (float)(f * (-p->slope[0] * nz)), forces_n[1] = (float)(f * (-p->slope[1] * nz));
            forces_n[2] = (float)(f * nz);
            has_force |= forces_n[0] != 0 || forces_n[1] != 0 || forces_n[2] != 0;
        }
    }
    return has_force;
}

/* All bricks with a force, in ascending order; `brick` and `forces_n` have room for every brick of the lattice. */
static uint64_t relief_bricks(int32_t *brick, float *forces_n) {
    relief_point point[64];
    int64_t across = (int64_t)relief.request.side / 8;
    uint64_t count = 0;
    for (int64_t x = 0; x < across; x++)
        for (int64_t y = 0; y < across; y++) {
            for (int n = 0; n < 64; n++)
                point[n] = relief_surface(relief.origin_m[0] + (double)(8 * x + (n >> 3)) * relief.spacing_m[0],
                                          relief.origin_m[1] + (double)(8 * y + (n & 7)) * relief.spacing_m[1]);
            for (int64_t z = 0; z < across; z++) {
                if (!relief_brick(point, z, forces_n + 1536 * count)) continue;
                brick[3 * count] = (int32_t)x, brick[3 * count + 1] = (int32_t)y, brick[3 * count + 2] = (int32_t)z, count++;
            }
        }
    return count;
}

/* What the page has written, in metres of the scene. */
static void relief_read(const void *memory) {
    memcpy(&relief.request, memory, sizeof relief.request);
    relief.depth_m = (const float *)((const char *)memory + sizeof relief.request);
    for (int n = 0; n < 3; n++) {
        relief.spacing_m[n] = relief.request.spacing_m[n] * (1 / relief.request.scale);
        relief.origin_m[n] = relief.request.origin_m[n] * (1 / relief.request.scale) + relief.request.offset_m[n];
    }
    relief.knee_m = relief.request.force_max_n / relief.request.stiffness_n_per_m / relief.request.scale;
    relief.slope_n_per_m = relief.request.stiffness_n_per_m * relief.request.scale;
}

static touch_head relief_head(void) {
    static const touch_bytes direct = {(const uint8_t *)"direct", 6};
    const relief_request *q = &relief.request;
    touch_head h;
    memset(&h, 0, sizeof h);
    for (int n = 0; n < 3; n++) h.grid.shape[n] = (uint32_t)q->side;
    memcpy(h.grid.spacing_m, q->spacing_m, 24), memcpy(h.grid.origin_m, q->origin_m, 24);
    memcpy(h.mapping_offset_m, q->offset_m, 24);
    h.rate_hz = q->rate_hz, h.frame_count = 1, h.device_type = 1, h.force_max_n = q->force_max_n, h.mapping_scale = q->scale;
    h.axes = touch_text_of("x right, y down, z forward"), h.device_name = touch_text_of("phantom-omni");
    h.tags = 1, h.tag = &direct;
    return h;
}

/* Write the file of the picture that lies in `room`, with the bound max(F_0, k |F|): a code of touch.h. */
EXPORT(record_relief) int record_relief(double k, double f0_n) {
    touch_options options = {TOUCH_MASK, 0, TOUCH_INTER_AUTO, 1, 1, k, f0_n, 0, 0};
    touch_source frame;
    memset(&frame, 0, sizeof frame);
    relief_read((const void *)(uintptr_t)file_at);
    touch_head head = relief_head();
    uint64_t all = touch_brick_count(&head.grid), brick_at = (file_at + file_size + 15) & ~(uint64_t)15;
    uint64_t forces_at = brick_at + 12 * all + 15, too_large = !reach(forces_at + 6144 * all);
    if (too_large) return record_fail(TOUCH_MEMORY, "it needs more memory than the page takes");
    forces_at &= ~(uint64_t)15;
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
