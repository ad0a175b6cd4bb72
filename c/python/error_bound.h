/* The error bound of moving bodies, voxel by voxel: bound_cells, compare_frames (_native.pyi).

   All voxels that the bodies reach are compared. Both fields of a body are stored as cells in the same order, and each cell
   has an upper bound of its error ratio. A voxel that only one body reaches is evaluated only if that bound exceeds the
   largest ratio found so far; a voxel that several bodies reach is always evaluated.

   From one frame to the next, only bricks are compared whose body has moved, or that a moving body reaches or has left. The
   others give the same ratios as before, and the same number of voxels outside the bound. */
#ifndef TOUCHFIELD_ERROR_BOUND_H
#define TOUCHFIELD_ERROR_BOUND_H

#include "query.h"

/* |error| <= max(f0_n, k |F|); f0_n may be 0. Body forces of at most floor_n are none; a sum is clipped to limit_n. */
typedef struct {
    double k, f0_n, floor_n, limit_n;
} error_rule;

/* -- cells ------------------------------------------------------------------------------------------------------------ */

#define ERROR_SLACK (1.0 + 1e-6)
#define FORCE_ROUNDING (1.0 / 4194304.0) /* relative: two roundings to float, and those of the sums */

/* An upper bound of |error| / mask within a cell whose first corners are given. The error within it is at most the largest at
   its corners; the force along their mean direction is at least the smallest of theirs. Infinite if f0_n is 0, the cell is not
   exact and the force may vanish within it. floor_n may remove a force from one of the two fields only. */
static inline double cell_bound(const float *source, const float *decoded, const error_rule *rule) {
    double corner[8][3], mean[3] = {0.0, 0.0, 0.0}, error2 = 0.0, max_length2 = 0.0, min_along = rule->limit_n;
    for (int e = 0; e < 8; e++) {
        int at = (e >> 2) * TOUCH_NEXT_X + (e >> 1 & 1) * TOUCH_NEXT_Y + (e & 1) * TOUCH_NEXT_Z;
        double corner2 = 0.0;
        for (int a = 0; a < 3; a++) {
            double difference = (double)decoded[at + a] - (double)source[at + a];
            corner[e][a] = (double)source[at + a];
            mean[a] += corner[e][a];
            corner2 += difference * difference;
        }
        if (corner2 > error2) error2 = corner2;
    }
    if (error2 == 0.0) return 0.0;
    double length = sqrt(mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2]);
    if (length < 1e-300) length = 1e-300;
    for (int e = 0; e < 8; e++) {
        const double *c = corner[e];
        double along = (c[0] * mean[0] + c[1] * mean[1] + c[2] * mean[2]) / length;
        double length2 = c[0] * c[0] + c[1] * c[1] + c[2] * c[2];
        if (along < min_along) min_along = along;
        if (length2 > max_length2) max_length2 = length2;
    }
    double error = sqrt(error2), allowed = rule->k * min_along > rule->f0_n ? rule->k * min_along : rule->f0_n;
    double max_length = sqrt(max_length2);
    if (min_along - error <= 2.0 * rule->floor_n) error += 2.0 * rule->floor_n;
    error += FORCE_ROUNDING * (max_length < rule->limit_n ? max_length : rule->limit_n);
    return allowed > 0.0 ? ERROR_SLACK * error / allowed : (double)INFINITY;
}

/* (start, stop, source, decoded, rule, bounds) */
static PyObject *native_bound_cells(PyObject *module, PyObject *arguments) {
    PyObject *source, *decoded, *bounds;
    long long start, stop;
    int64_t count = -1;
    error_rule rule;
    buffer_list arrays = {NULL, 0, 0};
    const float *from = NULL, *to = NULL;
    float *bound = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "LLOO(dddd)O", &start, &stop, &source, &decoded, &rule.k, &rule.f0_n, &rule.floor_n,
                          &rule.limit_n, &bounds))
        return NULL;
    int is_done = (from = (const float *)add_array(&arrays, source, 4 * (uint64_t)TOUCH_NEXT_BRICK, &count)) &&
                  (to = (const float *)add_array(&arrays, decoded, 4 * (uint64_t)TOUCH_NEXT_BRICK, &count)) &&
                  (bound = (float *)add_output(&arrays, bounds, 512 * sizeof(float), &count)) && check_range(start, stop, count);
    if (is_done) {
        PyThreadState *state = PyEval_SaveThread();
        for (int64_t n = 512 * start; n < 512 * stop; n++) {
            int64_t corner = touch_corner_of(n >> 9, n >> 6 & 7, n >> 3 & 7, n & 7);
            bound[n] = (float)cell_bound(from + corner, to + corner, &rule);
        }
        PyEval_RestoreThread(state);
    }
    return done(&arrays, is_done);
}

/* -- frames ----------------------------------------------------------------------------------------------------------- */

#define ON_A_SAMPLE 1e-6

typedef struct { /* voxels from `low` to `high` along each axis; none where low > high */
    int64_t low[3], high[3];
} voxel_box;

typedef struct {
    int64_t body, brick;
} body_part;

typedef struct { /* a brick of a body, as last compared */
    voxel_box box;
    int64_t violations;
} compared_brick;

typedef struct { /* of a body */
    voxel_box span, previous_span; /* voxels around it, in this frame and the one before */
    int64_t violations;            /* of its bricks */
} compared_body;

typedef struct {
    touch_placed_objects source, decoded; /* which share all but samples and placements */
    touch_placement *placement[2];        /* [bodies] each */
    const int64_t *start;                 /* [bodies + 1]: the bricks of a body */
    const int32_t *brick;                 /* [bricks][3] */
    const float *bound, *max_bound;       /* of each cell [bricks][512], and of each brick */
    uint8_t *mark;                        /* [bricks][512]: cells of voxels outside the bound; or NULL */
    touch_lattice world;
    error_rule rule;
    double *ratio;                        /* [bodies]: the largest so far */
    int64_t *voxel;                       /* [bodies][4]: frame and voxel of it */
    int64_t at[4];                        /* frame and voxel that are compared */
    compared_body *state;                 /* [bodies] */
    compared_brick *compared;             /* [bricks] */
    /* lists of bodies, ascending */
    int64_t *moved, moved_count;          /* those that have moved since the frame before, */
    int64_t *mover, movers;               /* and of these those that reach the body that is compared, or have left it */
    int64_t *neighbour, neighbours;       /* those that may reach that body, */
    int64_t *near, nears;                 /* the brick of it that is compared, */
    int64_t *candidate, candidates;       /* and the row of voxels */
    body_part *part;                      /* bodies that reach the voxel */
} bound_search;

/* floor, fmin and fmax, which are calls where x86-64 has no instruction */
static inline int64_t floor_of(double x) {
    int64_t whole = (int64_t)x;
    return whole - ((double)whole > x);
}
static inline double less_of(double a, double b) { return a < b ? a : b; }
static inline double more_of(double a, double b) { return a > b ? a : b; }

/* The voxels around a box of a body, in samples from the corner of its box. */
static inline voxel_box span_of(const touch_lattice *world, const touch_placement *o, const double first[3],
                                const double size[3]) {
    voxel_box box;
    for (int a = 0; a < 3; a++) {
        double centre = o->position_m[a] - world->origin_m[a], reach = 0.0, spacing = world->spacing_m[a];
        for (int b = 0; b < 3; b++) {
            double to_m = o->rotation[3 * a + b] * o->spacing_m[b];
            centre += to_m * (first[b] + size[b] / 2.0 + o->corner[b]);
            reach += fabs(o->rotation[3 * a + b]) * o->spacing_m[b] * size[b] / 2.0;
        }
        double low = ceil(more_of((centre - reach) / spacing - ON_A_SAMPLE, 0.0));
        double high = less_of((centre + reach) / spacing + ON_A_SAMPLE, (double)world->shape[a] - 1.0);
        if (!(low <= high)) return (voxel_box){{INT64_MAX, INT64_MAX, INT64_MAX}, {-1, -1, -1}};
        box.low[a] = (int64_t)low, box.high[a] = (int64_t)high;
    }
    return box;
}

static inline int boxes_overlap(const voxel_box *a, const voxel_box *b) {
    for (int n = 0; n < 3; n++)
        if (a->low[n] > b->high[n] || b->low[n] > a->high[n]) return 0;
    return 1;
}

/* First and last voxel of a row along z within a brick of a body, up to rounding; 0: none. */
static inline int clip_row(const touch_lattice *world, const touch_placement *o, const int32_t brick[3], double x, double y,
                           int64_t *low, int64_t *high) {
    const double *m = o->to_samples, *t = o->position_m;
    double dx = x - t[0], dy = y - t[1], dz = world->origin_m[2] - t[2], first = (double)*low, last = (double)*high;
    for (int a = 0; a < 3; a++) {
        double q = m[3 * a] * dx + m[3 * a + 1] * dy + m[3 * a + 2] * dz - o->corner[a] - 8.0 * brick[a];
        double step = m[3 * a + 2] * world->spacing_m[2];
        if (fabs(step) < 1e-9) {
            if (!(-1e-3 <= q && q <= 8.001)) return 0;
            continue;
        }
        double entry = -q / step, leave = (8.0 - q) / step;
        first = more_of(first, less_of(entry, leave) - ON_A_SAMPLE), last = less_of(last, more_of(entry, leave) + ON_A_SAMPLE);
    }
    if (!(first <= last)) return 0;
    *low = (int64_t)ceil(first), *high = (int64_t)floor(last);
    return *low <= *high;
}

static inline touch_vector arm_to(const touch_placement *o, touch_vector point_m) {
    return touch_vector_of(point_m.x - o->position_m[0], point_m.y - o->position_m[1], point_m.z - o->position_m[2]);
}

/* The brick of a body with a force around a point, -1 if there is none. */
static inline int64_t brick_at(const touch_placed_objects *all, int64_t body, touch_vector p) {
    const touch_placed_box *box = all->box + body;
    if (!touch_is_in_placed_box(box, p)) return -1;
    int64_t i = (int64_t)p.x, j = (int64_t)p.y, k = (int64_t)p.z;
    int64_t index = touch_find_brick(all->table + 2 * box->table_start, box->table_shift, touch_box_brick(box, i, j, k));
    return index >= 0 && touch_is_supported(all->supported, index, i, j, k) ? index : -1;
}

/* The force of a body's cell, moved into the scene; zero if it counts as none. */
static inline touch_vector part_force(const touch_placement *o, const float *corner, touch_vector fraction, touch_vector arm,
                                      double floor2_n2) {
    touch_cell_point found = {corner, {fraction.x, fraction.y, fraction.z}};
    touch_vector force = touch_cell_force(found);
    return touch_dot(force, force) > floor2_n2 ? touch_placed_force(o, force, arm) : touch_zero();
}

/* Mark the cells of the parts that contain a voxel. */
static inline void mark_cells(bound_search *s, int64_t parts, touch_vector point_m) {
    for (int64_t m = 0; m < parts; m++) {
        const touch_placement *o = s->placement[0] + s->part[m].body;
        touch_vector p = touch_placed_samples(o, arm_to(o, point_m));
        int64_t i = floor_of(p.x), j = floor_of(p.y), k = floor_of(p.z);
        s->mark[512 * s->part[m].brick + (i & 7) * 64 + (j & 7) * 8 + (k & 7)] = 1;
    }
}

/* A sum of forces, limited and rounded as in a receiver. */
static inline touch_vector received(touch_vector sum, double limit_n) {
    sum = touch_clipped(sum, limit_n);
    return touch_vector_of((double)(float)sum.x, (double)(float)sum.y, (double)(float)sum.z);
}

/* Compare source and decoded force at a voxel that the first `parts` reach; whether it is outside the bound. */
static inline int compare_voxel(bound_search *s, int64_t parts, touch_vector point_m) {
    touch_vector source = touch_zero(), decoded = touch_zero();
    double floor2 = s->rule.floor_n * s->rule.floor_n;
    for (int64_t m = 0; m < parts; m++) {
        const touch_placement *o = s->placement[0] + s->part[m].body;
        touch_vector arm = arm_to(o, point_m), p = touch_placed_samples(o, arm);
        int64_t i = (int64_t)p.x, j = (int64_t)p.y, k = (int64_t)p.z, corner = touch_corner_of(s->part[m].brick, i, j, k);
        p = touch_vector_of(p.x - (double)i, p.y - (double)j, p.z - (double)k);
        source = touch_add(source, part_force(o, s->source.samples + corner, p, arm, floor2));
        o = s->placement[1] + s->part[m].body; /* with the damping of the decoded motion */
        decoded = touch_add(decoded, part_force(o, s->decoded.samples + corner, p, arm, floor2));
    }
    source = received(source, s->rule.limit_n), decoded = received(decoded, s->rule.limit_n);
    touch_vector difference = touch_vector_of(decoded.x - source.x, decoded.y - source.y, decoded.z - source.z);
    double error = sqrt(touch_dot(difference, difference)), allowed = s->rule.k * sqrt(touch_dot(source, source));
    if (allowed < s->rule.f0_n) allowed = s->rule.f0_n;
    double ratio = allowed > 0.0 ? error / allowed : error > 0.0 ? (double)INFINITY : 0.0;
    if (ratio > 1.0 && s->mark) mark_cells(s, parts, point_m);
    for (int64_t m = 0; m < parts; m++) {
        int64_t body = s->part[m].body;
        if (!(ratio > s->ratio[body])) continue;
        s->ratio[body] = ratio;
        memcpy(s->voxel + 4 * body, s->at, sizeof s->at);
    }
    return ratio > 1.0;
}

/* Find the candidates that reach voxel n of the row, as parts from the second one on. */
static inline int64_t find_parts(bound_search *s, touch_vector point_m, int64_t n) {
    int64_t count = 0;
    for (int64_t m = 0; m < s->candidates; m++) {
        int64_t body = s->candidate[m];
        const voxel_box *span = &s->state[body].span;
        if (n < span->low[2] || n > span->high[2]) continue;
        const touch_placement *o = s->placement[0] + body;
        int64_t brick = brick_at(&s->source, body, touch_placed_samples(o, arm_to(o, point_m)));
        if (brick >= 0) s->part[++count] = (body_part){body, brick};
    }
    return count;
}

/* Compare the voxels low to high of a row within a brick of a body; how many are outside the bound. */
static inline int64_t compare_row(bound_search *s, body_part own, touch_vector point_m, int64_t low, int64_t high) {
    const touch_placement *o = s->placement[0] + own.body;
    const int32_t *brick = s->brick + 3 * own.brick;
    const double *m = o->to_samples, *corner = o->corner;
    touch_vector arm = arm_to(o, point_m);
    /* the terms of touch_placed_samples that are alike along the row */
    const double row[3] = {m[0] * arm.x + m[1] * arm.y, m[3] * arm.x + m[4] * arm.y, m[6] * arm.x + m[7] * arm.y};
    const double step[3] = {m[2], m[5], m[8]}, first[3] = {corner[0], corner[1], corner[2]}, start_m = o->position_m[2];
    const double *ratio = s->ratio + own.body;
    int64_t violations = 0;
    for (int64_t n = low; n <= high; n++) {
        point_m.z = s->world.origin_m[2] + (double)n * s->world.spacing_m[2];
        double dz = point_m.z - start_m;
        int64_t i = floor_of(row[0] + step[0] * dz - first[0]);
        int64_t j = floor_of(row[1] + step[1] * dz - first[1]);
        int64_t k = floor_of(row[2] + step[2] * dz - first[2]);
        if (i >> 3 != brick[0] || j >> 3 != brick[1] || k >> 3 != brick[2] ||
            !touch_is_supported(s->source.supported, own.brick, i, j, k))
            continue;
        double bound = s->bound[512 * own.brick + (i & 7) * 64 + (j & 7) * 8 + (k & 7)];
        int64_t others = s->candidates ? find_parts(s, point_m, n) : 0;
        if (!others && bound <= less_of(*ratio, 1.0)) continue;
        /* the voxel was compared together with the bricks of the first of these bodies */
        if (others && s->part[1].body < own.body) continue;
        s->part[0] = own, s->at[3] = n;
        violations += compare_voxel(s, 1 + others, point_m);
    }
    return violations;
}

/* Whether the bounds of a brick's cells leave neither a larger ratio nor a violation where only its body reaches. */
static inline int is_within(const bound_search *s, body_part own) {
    return (double)s->max_bound[own.brick] <= less_of(s->ratio[own.body], 1.0);
}

/* Compare the voxels of a brick of a body whose `neighbours` are known; how many are outside the bound. */
static inline int64_t compare_brick(bound_search *s, body_part own) {
    const touch_placement *o = s->placement[0] + own.body;
    const voxel_box *box = &s->compared[own.brick].box;
    int64_t violations = 0;
    s->nears = 0;
    for (int64_t m = 0; m < s->neighbours; m++)
        if (boxes_overlap(&s->state[s->neighbour[m]].span, box)) s->near[s->nears++] = s->neighbour[m];
    if (!s->nears && is_within(s, own)) return 0;
    for (int64_t i = box->low[0]; i <= box->high[0]; i++)
        for (int64_t j = box->low[1]; j <= box->high[1]; j++) {
            touch_vector point_m = touch_vector_of(s->world.origin_m[0] + (double)i * s->world.spacing_m[0],
                                                   s->world.origin_m[1] + (double)j * s->world.spacing_m[1], 0.0);
            int64_t low = box->low[2], high = box->high[2];
            s->at[1] = i, s->at[2] = j, s->candidates = 0;
            for (int64_t m = 0; m < s->nears; m++) {
                const voxel_box *span = &s->state[s->near[m]].span;
                if (span->low[0] <= i && i <= span->high[0] && span->low[1] <= j && j <= span->high[1])
                    s->candidate[s->candidates++] = s->near[m];
            }
            if (!s->candidates && is_within(s, own)) continue;
            if (clip_row(&s->world, o, s->brick + 3 * own.brick, point_m.x, point_m.y, &low, &high))
                violations += compare_row(s, own, point_m, low, high);
        }
    return violations;
}

/* Whether a body that has moved reaches these voxels, or did in the frame before. */
static inline int has_crossed(const compared_body *mover, const voxel_box *box) {
    return boxes_overlap(&mover->span, box) || boxes_overlap(&mover->previous_span, box);
}

/* List the bodies that have moved and reach a body, or have left it. */
static inline void find_movers(bound_search *s, int64_t body) {
    s->movers = 0;
    for (int64_t m = 0; m < s->moved_count; m++)
        if (has_crossed(s->state + s->moved[m], &s->state[body].span)) s->mover[s->movers++] = s->moved[m];
}

static inline void find_neighbours(bound_search *s, int64_t body) {
    s->neighbours = 0;
    for (int64_t m = 0; m < s->source.count; m++)
        if (m != body && boxes_overlap(&s->state[m].span, &s->state[body].span)) s->neighbour[s->neighbours++] = m;
}

/* Whether one of the `movers` has crossed these voxels. */
static inline int is_crossed(const bound_search *s, const voxel_box *box) {
    for (int64_t m = 0; m < s->movers; m++)
        if (has_crossed(s->state + s->mover[m], box)) return 1;
    return 0;
}

/* Compare what has changed of a body; `is_new` if it has moved. */
static inline void compare_body(bound_search *s, int64_t body, int is_new) {
    const double size[3] = {8.0, 8.0, 8.0};
    if (!is_new) find_movers(s, body);
    if (!is_new && !s->movers) return;
    find_neighbours(s, body);
    for (int64_t n = s->start[body]; n < s->start[body + 1]; n++) {
        compared_brick *brick = s->compared + n;
        const int32_t *at = s->brick + 3 * n;
        const double first[3] = {8.0 * at[0], 8.0 * at[1], 8.0 * at[2]};
        if (is_new) brick->box = span_of(&s->world, s->placement[0] + body, first, size);
        if (!is_new && !is_crossed(s, &brick->box)) continue;
        s->state[body].violations -= brick->violations;
        brick->violations = compare_brick(s, (body_part){body, n});
        s->state[body].violations += brick->violations;
    }
}

typedef struct { /* of all frames: poses [bodies][7], and motions [bodies][6] of source and decoded tracks */
    const double *pose, *motion[2], *lattice;
    const uint8_t *stays;   /* whether a body has not moved since the frame before */
    const int64_t *repeats; /* how many equal frames a frame stands for */
} body_moves;

/* Place a body in a frame. */
static inline void place_body(bound_search *s, const body_moves *moves, int64_t frame, int64_t body) {
    const int64_t row = frame * s->source.count + body, *box = s->source.box[body].brick_count;
    const double corner[3] = {0.0, 0.0, 0.0}, size[3] = {8.0 * (double)box[0], 8.0 * (double)box[1], 8.0 * (double)box[2]};
    for (int side = 0; side < 2; side++)
        touch_place_object(moves->pose + 7 * row, moves->lattice + 6 * body, moves->motion[side] + 6 * row,
                           s->placement[side] + body);
    s->state[body].previous_span = s->state[body].span;
    s->state[body].span = span_of(&s->world, s->placement[0] + body, corner, size);
}

/* Compare frames start to stop - 1; how many voxels in all are outside the bound. */
static inline int64_t compare_frames(bound_search *s, const body_moves *moves, int64_t start, int64_t stop) {
    int64_t bodies = s->source.count, violations = 0;
    for (int64_t frame = start; frame < stop; frame++) {
        const uint8_t *stays = moves->stays + frame * bodies;
        s->at[0] = frame, s->moved_count = 0;
        for (int64_t n = 0; n < bodies; n++)
            if (frame == start || !stays[n]) place_body(s, moves, frame, n), s->moved[s->moved_count++] = n;
        for (int64_t n = 0; n < bodies; n++) {
            compare_body(s, n, frame == start || !stays[n]);
            violations += moves->repeats[frame] * s->state[n].violations;
        }
    }
    return violations;
}

/* (lattices, boxes, starts, bricks, tables, supported, source, decoded, bounds, max_bounds, marks); 0: an error is raised. */
static inline int read_bodies(buffer_list *arrays, PyObject *object, bound_search *s, body_moves *moves) {
    PyObject *lattices, *boxes, *starts, *bricks, *tables, *supported, *source, *decoded, *bounds, *tops, *marks;
    int64_t entries = -1, count = -1, edges, marked = -1;
    touch_placed_objects *all = &s->source;
    if (!PyArg_ParseTuple(object, "OOOOOOOOOOO", &lattices, &boxes, &starts, &bricks, &tables, &supported, &source, &decoded,
                          &bounds, &tops, &marks))
        return 0;
    all->count = -1;
    const uint64_t cell_bytes = 4 * (uint64_t)TOUCH_NEXT_BRICK;
    if (!(moves->lattice = (const double *)add_numbers(arrays, lattices, 6, &all->count)) ||
        !(all->box = (const touch_placed_box *)add_numbers(arrays, boxes, 5, &all->count)) ||
        (edges = all->count + 1, !(s->start = (const int64_t *)add_numbers(arrays, starts, 1, &edges))) ||
        !(s->brick = (const int32_t *)add_array(arrays, bricks, 12, &count)) ||
        !(all->table = (const int64_t *)add_numbers(arrays, tables, 2, &entries)) ||
        !(all->supported = (const uint64_t *)add_numbers(arrays, supported, 8, &count)) ||
        !(all->samples = (const float *)add_array(arrays, source, cell_bytes, &count)) ||
        !(s->decoded.samples = (const float *)add_array(arrays, decoded, cell_bytes, &count)) ||
        !(s->bound = (const float *)add_array(arrays, bounds, 512 * sizeof(float), &count)) ||
        !(s->max_bound = (const float *)add_array(arrays, tops, sizeof(float), &count)) ||
        !(s->mark = (uint8_t *)add_output(arrays, marks, 512, &marked)))
        return 0;
    if (marked && marked != count) return refuse(TOUCH_ARGUMENT, "marks of another number of bricks");
    for (int64_t n = 0; n < all->count; n++)
        if (s->start[n] < 0 || s->start[n] > s->start[n + 1] || s->start[n + 1] > count)
            return refuse(TOUCH_ARGUMENT, "bodies of bricks that are not there");
    if (!marked) s->mark = NULL;
    return 1;
}

/* (poses, source, decoded, stays, repeats); the number of frames. 0: an error is raised. */
static inline int read_moves(buffer_list *arrays, PyObject *object, int64_t bodies, body_moves *moves, int64_t *frames) {
    PyObject *poses, *source, *decoded, *stays, *repeats;
    int64_t rows = -1;
    if (!PyArg_ParseTuple(object, "OOOOO", &poses, &source, &decoded, &stays, &repeats)) return 0;
    if (!(moves->pose = (const double *)add_numbers(arrays, poses, 7, &rows)) ||
        !(moves->motion[0] = (const double *)add_numbers(arrays, source, 6, &rows)) ||
        !(moves->motion[1] = (const double *)add_numbers(arrays, decoded, 6, &rows)) ||
        !(moves->stays = (const uint8_t *)add_array(arrays, stays, 1, &rows)))
        return 0;
    if (bodies < 1 || rows % bodies) return refuse(TOUCH_ARGUMENT, "moves of another number of bodies");
    *frames = rows / bodies;
    return (moves->repeats = (const int64_t *)add_numbers(arrays, repeats, 1, frames)) != NULL;
}

/* Compare frames in memory of its own; the number of voxels outside the bound, -1 without memory. */
static inline int64_t compare_frames_in(bound_search *s, const body_moves *moves, int64_t start, int64_t stop) {
    size_t bodies = (size_t)s->source.count, bricks = (size_t)s->start[bodies];
    size_t bytes = 2 * sizeof(touch_placement) + sizeof(compared_body) + sizeof(body_part) + 5 * sizeof(int64_t);
    touch_placement *placement = (touch_placement *)calloc(bodies + 1, bytes);
    s->compared = (compared_brick *)calloc(bricks + 1, sizeof(compared_brick));
    int64_t violations = -1;
    if (placement && s->compared) {
        s->placement[0] = placement, s->placement[1] = placement + bodies;
        s->state = (compared_body *)(void *)(placement + 2 * bodies);
        s->part = (body_part *)(void *)(s->state + bodies);
        s->moved = (int64_t *)(void *)(s->part + bodies + 1), s->mover = s->moved + bodies;
        s->neighbour = s->mover + bodies, s->near = s->neighbour + bodies, s->candidate = s->near + bodies;
        s->decoded.box = s->source.box, s->decoded.count = s->source.count;
        s->source.placement = s->placement[0], s->decoded.placement = s->placement[1];
        violations = compare_frames(s, moves, start, stop);
    }
    free(s->compared);
    free(placement);
    return violations;
}

/* (start, stop, bodies, moves, lattice, rule, ratios, voxels) */
static PyObject *native_compare_frames(PyObject *module, PyObject *arguments) {
    PyObject *bodies, *motions, *lattice, *ratios, *voxels;
    long long start, stop;
    int64_t frames, violations = 0;
    bound_search s;
    body_moves moves;
    buffer_list arrays = {NULL, 0, 0};
    (void)module;
    memset(&s, 0, sizeof s);
    memset(&moves, 0, sizeof moves);
    if (!PyArg_ParseTuple(arguments, "LLOOO(dddd)OO", &start, &stop, &bodies, &motions, &lattice, &s.rule.k, &s.rule.f0_n,
                          &s.rule.floor_n, &s.rule.limit_n, &ratios, &voxels))
        return NULL;
    int is_done = read_lattice(lattice, &s.world) && read_bodies(&arrays, bodies, &s, &moves) &&
                  read_moves(&arrays, motions, s.source.count, &moves, &frames) && check_range(start, stop, frames) &&
                  (s.ratio = (double *)add_output(&arrays, ratios, 8, &s.source.count)) &&
                  (s.voxel = (int64_t *)add_output(&arrays, voxels, 32, &s.source.count));
    if (is_done) {
        PyThreadState *state = PyEval_SaveThread();
        violations = compare_frames_in(&s, &moves, start, stop);
        PyEval_RestoreThread(state);
        is_done = violations >= 0 || fail_for_memory();
    }
    release_arrays(&arrays);
    return is_done ? PyLong_FromLongLong(violations) : NULL;
}

/* clang-format off */
#define ERROR_BOUND_METHODS \
    {"bound_cells", native_bound_cells, METH_VARARGS, "Upper bounds of the error within cells."}, \
    {"compare_frames", native_compare_frames, METH_VARARGS, "The largest error over the bound in frames."}
/* clang-format on */

#endif
