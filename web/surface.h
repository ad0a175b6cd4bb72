/* The surface of first contact of a field: where |F| rises above a threshold, by surface nets over its bricks.

   One vertex in each cell of eight samples that the surface cuts, one square for each edge between two samples that it
   cuts. Along an edge it lies where the force, taken on as it falls towards the outside, is zero: |F| itself is cut
   at zero there. Only sides that push outwards are kept, so that the inner side of a wall is not drawn; where almost
   nothing does (a field that pulls), all are. A side along which a strong force stays as it is bounds the source, not
   the object, such as the rim of a terrain: it is not drawn. A field that is strong from its surface on has no such
   sides. */
#ifndef TOUCH_SURFACE_H
#define TOUCH_SURFACE_H

typedef struct {
    float *vertex;   /* 7 each: place, m, direction of the force, |F| at a depth, N */
    uint32_t *index; /* 3 each triangle */
    uint32_t vertices, indices;
} surface_mesh;

enum { SURFACE_PAD = 12, SURFACE_CELLS = 9, SURFACE_STEPS = 48 };

static const double SURFACE_RIM = 1.5, SURFACE_STRONG = 0.2; /* samples along a rim; fraction of the largest force */
static const double SURFACE_NEVER = 1e300; /* no force is as strong */

typedef struct {
    const touch_field *field;
    double threshold_n, depth_m, strong_n;
    int64_t low[3];                                            /* sample (0, 0, 0) of the brick */
    float size[SURFACE_PAD * SURFACE_PAD * SURFACE_PAD];       /* |F| from two samples before the brick to two behind */
    float force[SURFACE_PAD * SURFACE_PAD * SURFACE_PAD][3];
    int32_t cell[SURFACE_CELLS * SURFACE_CELLS * SURFACE_CELLS]; /* vertex of each; -1: none yet */
    surface_mesh *mesh;
    int is_written, takes_all;
    uint64_t across, outward, aligned, abrupt; /* squares: the force crosses, pushes outwards, straight, strongly */
} surface_work;

static const int surface_step[3] = {SURFACE_PAD * SURFACE_PAD, SURFACE_PAD, 1};

static uint64_t surface_bytes(const surface_mesh *mesh) {
    return 28 * (uint64_t)mesh->vertices + 4 * (uint64_t)mesh->indices + 64;
}

static const float *surface_brick(const touch_field *f, int64_t x, int64_t y, int64_t z) {
    int64_t slot;
    if (x < 0 || y < 0 || z < 0 || 8 * x >= f->grid.shape[0] || 8 * y >= f->grid.shape[1] || 8 * z >= f->grid.shape[2])
        return 0;
    slot = touch_field_slot(f, x, y, z);
    return slot < 0 ? 0 : f->forces_n + 1536 * slot;
}

/* The samples of a brick and about it; whether the surface may cut it. */
static int surface_load(surface_work *w, const int64_t brick[3]) {
    int64_t bx, by, bz;
    int x, y, z, any_above = 0, any_below = 0;
    memset(w->size, 0, sizeof w->size), memset(w->force, 0, sizeof w->force);
    for (bx = -1; bx < 2; bx++)
        for (by = -1; by < 2; by++)
            for (bz = -1; bz < 2; bz++) {
                const float *from = surface_brick(w->field, brick[0] + bx, brick[1] + by, brick[2] + bz);
                if (!from) continue;
                for (x = bx < 0 ? 6 : 0; x < (bx > 0 ? 2 : 8); x++)
                    for (y = by < 0 ? 6 : 0; y < (by > 0 ? 2 : 8); y++)
                        for (z = bz < 0 ? 6 : 0; z < (bz > 0 ? 2 : 8); z++) {
                            const float *f = from + 3 * (64 * x + 8 * y + z);
                            int at = ((int)(8 * bx) + x + 2) * surface_step[0] + ((int)(8 * by) + y + 2) * surface_step[1] +
                                     (int)(8 * bz) + z + 2;
                            memcpy(w->force[at], f, 12);
                            w->size[at] = sqrtf(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]);
                        }
            }
    for (x = 1; x < 11; x++)
        for (y = 1; y < 11; y++)
            for (z = 1; z < 11; z++) {
                int is_above = w->size[x * surface_step[0] + y * surface_step[1] + z] > w->threshold_n;
                any_above |= is_above, any_below |= !is_above;
            }
    return any_above && any_below;
}

/* Where along the edge from a sample outside to one inside the force begins: 0 at the one outside. */
static double surface_crossing(const surface_work *w, int outside, int inside) {
    int behind = 2 * inside - outside;
    double first = w->size[inside], slope, o = w->size[outside];
    if (behind >= 0 && behind < SURFACE_PAD * SURFACE_PAD * SURFACE_PAD) {
        slope = w->size[behind] - first;
        if (slope > 0.02 * first && first < 1.5 * slope) return first < slope ? 1 - first / slope : 0;
    }
    return first > o ? (w->threshold_n - o) / (first - o) : 0.5;
}

static const float *surface_nearest(const touch_field *f, const double p[3]) {
    int64_t at[3];
    const float *brick;
    int n;
    for (n = 0; n < 3; n++) {
        at[n] = (int64_t)floor((p[n] - f->grid.origin_m[n]) / f->grid.spacing_m[n] + 0.5);
        if (at[n] < 0 || at[n] >= f->grid.shape[n]) return 0;
    }
    brick = surface_brick(f, at[0] >> 3, at[1] >> 3, at[2] >> 3);
    return brick ? brick + 3 * (64 * (at[0] & 7) + 8 * (at[1] & 7) + (at[2] & 7)) : 0;
}

/* |F| at a depth against the force; or, where that is below 0, the largest on the way to where there is none. */
static double surface_pressed(const surface_work *w, const double p[3], const double unit[3]) {
    const touch_grid *g = &w->field->grid;
    double step = g->spacing_m[0], best = 0, q[3];
    int n, k;
    for (n = 1; n < 3; n++) step = g->spacing_m[n] < step ? g->spacing_m[n] : step;
    if (w->depth_m >= 0) {
        double f[3];
        for (n = 0; n < 3; n++) q[n] = p[n] - unit[n] * w->depth_m;
        touch_sample(w->field, q, f);
        return sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]);
    }
    for (k = 0; k < SURFACE_STEPS; k++) {
        const float *f;
        double size;
        for (n = 0; n < 3; n++) q[n] = p[n] - unit[n] * step * (k + 0.5);
        f = surface_nearest(w->field, q);
        size = f ? sqrt((double)f[0] * f[0] + (double)f[1] * f[1] + (double)f[2] * f[2]) : 0;
        if (size > best) best = size;
        else if (k > 2 && !(size > 0)) break;
    }
    return best;
}

/* The vertex of the cell whose first sample is x, y, z, counted from one before the brick. */
static uint32_t surface_vertex(surface_work *w, int x, int y, int z) {
    int own = (x * SURFACE_CELLS + y) * SURFACE_CELLS + z, n, axis, count = 0;
    int base = (x + 1) * surface_step[0] + (y + 1) * surface_step[1] + z + 1;
    double sum[3] = {0, 0, 0}, p[3], unit[3] = {0, 0, 0}, length;
    float *to;
    if (w->cell[own] >= 0) return (uint32_t)w->cell[own];
    w->cell[own] = (int32_t)w->mesh->vertices++;
    if (!w->is_written) return (uint32_t)w->cell[own];
    for (n = 0; n < 8; n++) {
        int at = base + (n >> 2) * surface_step[0] + (n >> 1 & 1) * surface_step[1] + (n & 1);
        for (axis = 0; axis < 3; axis++) unit[axis] += w->force[at][axis];
        for (axis = 0; axis < 3; axis++) {
            int there = at + surface_step[axis], bit = 4 >> axis, is_in, k;
            double t;
            if (n & bit) continue;
            is_in = w->size[at] > w->threshold_n;
            if (is_in == (w->size[there] > w->threshold_n)) continue;
            t = is_in ? 1 - surface_crossing(w, there, at) : surface_crossing(w, at, there);
            for (k = 0; k < 3; k++) sum[k] += k == axis ? t : (n & (4 >> k) ? 1 : 0);
            count++;
        }
    }
    length = sqrt(unit[0] * unit[0] + unit[1] * unit[1] + unit[2] * unit[2]);
    to = w->mesh->vertex + 7 * (uint64_t)w->cell[own];
    for (n = 0; n < 3; n++) {
        int64_t first = w->low[n] - 1 + (n == 0 ? x : n == 1 ? y : z);
        p[n] = w->field->grid.origin_m[n] + w->field->grid.spacing_m[n] * ((double)first + (count ? sum[n] / count : 0.5));
        unit[n] = length > 0 ? unit[n] / length : 0;
        to[n] = (float)p[n], to[3 + n] = (float)unit[n];
    }
    to[6] = (float)surface_pressed(w, p, unit);
    return (uint32_t)w->cell[own];
}

/* Whether the strong, oblique force of a sample at the boundary stays as it is where it points to along the boundary.
   It falls there where an object begins. */
static int surface_is_rim(const surface_work *w, int inside, const double normal[3], double along) {
    const touch_grid *g = &w->field->grid;
    const int at[3] = {inside / surface_step[0], inside / surface_step[1] % SURFACE_PAD, inside % SURFACE_PAD};
    double tangent[3], samples = 0, p[3], f[3];
    int n;
    for (n = 0; n < 3; n++) {
        tangent[n] = w->force[inside][n] - along * normal[n];
        samples = fmax(samples, fabs(tangent[n]) / g->spacing_m[n]);
    }
    for (n = 0; n < 3; n++)
        p[n] = g->origin_m[n] + g->spacing_m[n] * (double)(w->low[n] + at[n] - 2) + SURFACE_RIM * tangent[n] / samples;
    touch_sample(w->field, p, f);
    return sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]) > 0.6 * w->size[inside];
}

/* 1 where the force of a sample at the edge pushes outwards, across the boundary as the samples about it tell it, or,
   where a wall is too thin for that, along the edge; -1 where it pushes inwards; 0 along the boundary, or at a rim. */
static int surface_pushes(surface_work *w, int inside, int axis, int way) {
    double normal[3] = {0, 0, 0}, along = 0, size = w->size[inside], length = 0;
    int x, y, z;
    for (x = -1; x < 2; x++)
        for (y = -1; y < 2; y++)
            for (z = -1; z < 2; z++)
                if (w->size[inside + x * surface_step[0] + y * surface_step[1] + z] > w->threshold_n)
                    normal[0] -= x, normal[1] -= y, normal[2] -= z;
    if (normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2] < 10) return way * w->force[inside][axis] > 0 ? 1 : -1;
    for (x = 0; x < 3; x++) normal[x] /= w->field->grid.spacing_m[x], length += normal[x] * normal[x];
    for (x = 0; x < 3; x++) normal[x] /= sqrt(length), along += normal[x] * w->force[inside][x];
    if (along < 0.3 * size) return along < -0.3 * size ? -1 : 0;
    if (along < 0.9 * size) return size < w->strong_n || !surface_is_rim(w, inside, normal, along);
    w->aligned++, w->abrupt += size > w->strong_n;
    return 1;
}

/* The square about the edge from a sample to the next one along an axis, if the surface cuts it and pushes outwards. */
static void surface_edge(surface_work *w, int x, int y, int z, int axis) {
    int at = (x + 2) * surface_step[0] + (y + 2) * surface_step[1] + z + 2, there = at + surface_step[axis];
    int is_in = w->size[at] > w->threshold_n, inside = is_in ? at : there, pushes, n;
    uint32_t corner[4], *to;
    if (is_in == (w->size[there] > w->threshold_n)) return;
    pushes = surface_pushes(w, inside, axis, is_in ? 1 : -1);
    w->across += pushes != 0, w->outward += pushes > 0;
    if (!w->takes_all && pushes < 1) return;
    for (n = 0; n < 4; n++) { /* cells about it, in turn */
        int q[3], b = (axis + 1) % 3, c = (axis + 2) % 3;
        q[0] = x + 1, q[1] = y + 1, q[2] = z + 1;
        q[b] -= n == 1 || n == 2, q[c] -= n >= 2;
        corner[n] = surface_vertex(w, q[0], q[1], q[2]);
    }
    if (w->is_written) {
        to = w->mesh->index + w->mesh->indices;
        to[0] = corner[0], to[1] = corner[is_in ? 1 : 2], to[2] = corner[is_in ? 2 : 1];
        to[3] = corner[0], to[4] = corner[is_in ? 2 : 3], to[5] = corner[is_in ? 3 : 2];
    }
    w->mesh->indices += 6;
}

static void surface_of_brick(surface_work *w, const int64_t brick[3]) {
    int axis, n, low[3], p[3];
    for (n = 0; n < 3; n++) {
        int64_t beside[3];
        memcpy(beside, brick, sizeof beside), beside[n]--;
        w->low[n] = 8 * brick[n], low[n] = surface_brick(w->field, beside[0], beside[1], beside[2]) ? 0 : -1;
    }
    if (!surface_load(w, brick)) return;
    memset(w->cell, 255, sizeof w->cell);
    for (axis = 0; axis < 3; axis++)
        for (p[0] = axis == 0 ? low[0] : 0; p[0] < 8; p[0]++)
            for (p[1] = axis == 1 ? low[1] : 0; p[1] < 8; p[1]++)
                for (p[2] = axis == 2 ? low[2] : 0; p[2] < 8; p[2]++) surface_edge(w, p[0], p[1], p[2], axis);
}

static void surface_position(const touch_field *f, uint32_t entry, int64_t brick[3]) {
    uint32_t number = f->table[2 * entry] - 1, ny = (f->grid.shape[1] + 7) >> 3, nz = (f->grid.shape[2] + 7) >> 3;
    brick[0] = number / nz / ny, brick[1] = number / nz % ny, brick[2] = number % nz;
}

/* The largest |F| of a field, and where. */
static void surface_largest(const touch_field *f, double out[4]) {
    double best = 0;
    uint32_t entry, k;
    out[0] = out[1] = out[2] = out[3] = 0;
    for (entry = 0; entry <= f->mask; entry++) {
        const float *v = f->forces_n + 1536 * (uint64_t)f->table[2 * entry + 1];
        if (!f->table[2 * entry]) continue;
        for (k = 0; k < 512; k++, v += 3) {
            double square = (double)v[0] * v[0] + (double)v[1] * v[1] + (double)v[2] * v[2];
            int64_t brick[3];
            if (!(square > best)) continue;
            best = square, surface_position(f, entry, brick);
            out[1] = f->grid.origin_m[0] + f->grid.spacing_m[0] * (double)(8 * brick[0] + (k >> 6));
            out[2] = f->grid.origin_m[1] + f->grid.spacing_m[1] * (double)(8 * brick[1] + (k >> 3 & 7));
            out[3] = f->grid.origin_m[2] + f->grid.spacing_m[2] * (double)(8 * brick[2] + (k & 7));
        }
    }
    out[0] = sqrt(best);
}

/* Whether squares are counted again, by another rule: without rims, or all of them. */
static int surface_again(surface_work *w) {
    if (w->strong_n < SURFACE_NEVER && 2 * w->abrupt >= w->aligned) return w->strong_n = SURFACE_NEVER, 1;
    return !w->takes_all && 4 * w->outward < w->across && (w->takes_all = 1);
}

/* Count what there is, or, with memory, write it: `mesh` has the counts then. */
static void surface_make(const touch_field *f, double threshold_n, double depth_m, uint8_t *memory, surface_mesh *mesh) {
    static surface_work w;
    surface_mesh counted = *mesh;
    double largest[4];
    uint32_t entry;
    w.field = f, w.threshold_n = threshold_n, w.depth_m = depth_m, w.mesh = mesh, w.is_written = memory != 0;
    if (memory) mesh->vertex = (float *)memory, mesh->index = (uint32_t *)(mesh->vertex + 7 * (uint64_t)counted.vertices);
    else surface_largest(f, largest), w.strong_n = SURFACE_STRONG * largest[0], w.takes_all = 0;
    do {
        mesh->vertices = mesh->indices = 0, w.across = w.outward = w.aligned = w.abrupt = 0;
        for (entry = 0; entry <= f->mask; entry++)
            if (f->table[2 * entry]) {
                int64_t brick[3];
                surface_position(f, entry, brick);
                surface_of_brick(&w, brick);
            }
    } while (!memory && surface_again(&w));
}
#endif
