/* touch_tool.h: force and torque on a tool of many points in a field, in place of a single point: a sum of penalty forces, as
   for the pointshell of the voxmap method (McNeely, Puterbaugh and Troy 1999). A point with the outward normal n weighs its
   force F by s max(0, -n . F / |F|); src/touchfield/render/tool.py explains why.

   Blocks of some hundred points, in float and in plain loops that a processor does many at once:

       touch_tool_force            all blocks
           touch_add_tool_body         for each body that the tool may reach: its pose in the body's axes, then
               touch_locate_tool           brick, cell and fraction of each point
               touch_add_tool_samples      the force there; the brick of the point before is at hand
               touch_gather_tool           into the tool's axes, with what the motion of the surface adds
           touch_weight_tool           by the normals
           touch_sum_tool              force and torque

   Only the sum leaves float, in which a position in a lattice of 1000 samples is known to a ten thousandth of one. */
#ifndef TOUCH_TOOL_H
#define TOUCH_TOOL_H

#include "touch_query.h"

/* Force, N, and torque about the device's point, N m, on the receiver's tool in the axes of the field, with the device's
   point at `point_m`; state.tool_rotation is the rotation of the tool. Zero where there is no tool. */
static inline touch_vector touch_tool_force(const touch_receiver *receiver, const touch_instant *t, touch_vector point_m,
                                            touch_vector *torque_nm);

#define TOUCH_MIN_ORIENTATION_SQUARE 0.81 /* |q|^2 of a quaternion that was meant to be of length 1 */
#define TOUCH_MAX_ORIENTATION_SQUARE 1.21

/* Whether the orientation of the grip is known, if there is a tool; sets that of the tool in the field. */
static inline int touch_orient_tool(touch_receiver *receiver) {
    const double *q = receiver->grip.orientation;
    if (!TOUCH_HAS_EXTRAS || !receiver->settings.tool_point_count) return 1;
    touch_vector v = touch_vector_of(q[1], q[2], q[3]);
    double square = q[0] * q[0] + touch_dot(v, v);
    if (!(square >= TOUCH_MIN_ORIENTATION_SQUARE && square <= TOUCH_MAX_ORIENTATION_SQUARE)) return 0;
    const touch_matrix *axes = &receiver->settings.axes;
    touch_matrix grip = touch_rotation_of(q[0], v), columns;
    for (int n = 0; n < 3; n++) /* axes . grip . axes^T, column by column */
        columns.row[n] = touch_rotate(axes, touch_rotate(&grip, axes->row[n]));
    touch_matrix *rotation = &receiver->state.tool_rotation;
    rotation->row[0] = touch_vector_of(columns.row[0].x, columns.row[1].x, columns.row[2].x);
    rotation->row[1] = touch_vector_of(columns.row[0].y, columns.row[1].y, columns.row[2].y);
    rotation->row[2] = touch_vector_of(columns.row[0].z, columns.row[1].z, columns.row[2].z);
    return 1;
}

enum { TOUCH_TOOL_BLOCK = 512, TOUCH_TOOL_LANES = 16 }; /* points at a time; sums at a time */

typedef struct { /* a vector for each point of a block, by component */
    float x[TOUCH_TOOL_BLOCK], y[TOUCH_TOOL_BLOCK], z[TOUCH_TOOL_BLOCK];
} touch_tool_vectors;

typedef struct { /* some points of a tool, in its own axes */
    const float *x, *y, *z;                      /* metres from the device's point */
    const float *normal_x, *normal_y, *normal_z; /* outwards, of length 1 */
    int count;
} touch_tool_points;

typedef struct {
    float x, y, z;
} touch_float_vector;

TOUCH_INLINE touch_float_vector touch_float_of(touch_vector v) {
    touch_float_vector f;
    f.x = (float)v.x;
    f.y = (float)v.y;
    f.z = (float)v.z;
    return f;
}

typedef struct { /* where the points of a block lie in cells */
    int32_t i[TOUCH_TOOL_BLOCK]; /* the cell, from the corner of the box; -1: outside of it */
    int32_t j[TOUCH_TOOL_BLOCK];
    int32_t k[TOUCH_TOOL_BLOCK];
    touch_tool_vectors fraction; /* of the way through the cell */
} touch_tool_cells;

/* x within [0, high]; 0 where it is not a number. Without a branch, so that the loop is vectorised. */
TOUCH_INLINE float touch_clamped_float(float x, float high) {
    x = x > 0.0f ? x : 0.0f;
    return x < high ? x : high;
}

/* Find the points in cells: row . point + start, in samples; 0: none is in the box. */
static inline int touch_locate_tool(const touch_cells *cells, const touch_tool_points *p, const touch_float_vector row[3],
                                    touch_float_vector start, touch_tool_cells *__restrict out) {
    const float *__restrict px = p->x, *__restrict py = p->y, *__restrict pz = p->z;
    float high_x = (float)(8 * cells->brick_count[0]), high_y = (float)(8 * cells->brick_count[1]);
    float high_z = (float)(8 * cells->brick_count[2]);
    int is_any_in_box = 0;
    for (int n = 0; n < p->count; n++) {
        float x = start.x + row[0].x * px[n] + row[0].y * py[n] + row[0].z * pz[n];
        float y = start.y + row[1].x * px[n] + row[1].y * py[n] + row[1].z * pz[n];
        float z = start.z + row[2].x * px[n] + row[2].y * py[n] + row[2].z * pz[n];
        int is_in_box = (x >= 0.0f) & (y >= 0.0f) & (z >= 0.0f) & (x < high_x) & (y < high_y) & (z < high_z);
        is_any_in_box |= is_in_box;
        x = touch_clamped_float(x, high_x);
        y = touch_clamped_float(y, high_y);
        z = touch_clamped_float(z, high_z);
        int32_t i = (int32_t)x, j = (int32_t)y, k = (int32_t)z;
        out->i[n] = i | (is_in_box - 1);
        out->j[n] = j;
        out->k[n] = k;
        out->fraction.x[n] = x - (float)i;
        out->fraction.y[n] = y - (float)j;
        out->fraction.z[n] = z - (float)k;
    }
    return is_any_in_box;
}

/* Add `weight` times the force at points in cells. */
static inline void touch_add_tool_samples(const touch_cells *cells, float weight, int count, const touch_tool_cells *at,
                                          touch_tool_vectors *__restrict force) {
    const int64_t *table = touch_table_of(cells);
    const uint64_t *supported = touch_supported_of(cells);
    const float *samples = touch_samples_of(cells);
    int64_t ny = cells->brick_count[1], nz = cells->brick_count[2], index = -1;
    int32_t last_i = -1, last_j = 0, last_k = 0; /* a cell of the brick at hand; -1: there is none */
    float own_n[3];
    for (int n = 0; n < count; n++) {
        int32_t i = at->i[n], j = at->j[n], k = at->k[n];
        if (i < 0) continue;
        if (((i ^ last_i) | (j ^ last_j) | (k ^ last_k)) & ~7) { /* another brick */
            index = touch_find_brick(table, cells->table_shift, ((i >> 3) * ny + (j >> 3)) * nz + (k >> 3));
            last_i = i;
            last_j = j;
            last_k = k;
        }
        if (index < 0 || !touch_is_supported(supported, index, i, j, k)) continue;
        const float *corner = samples + touch_corner_of(index, i, j, k);
        touch_interpolate_float(corner, at->fraction.x[n], at->fraction.y[n], at->fraction.z[n], own_n);
        force->x[n] += weight * own_n[0];
        force->y[n] += weight * own_n[1];
        force->z[n] += weight * own_n[2];
    }
}

/* Add a body's forces, rotated into the tool's axes by `row`, to `total`, each with what the motion of the surface adds:
   `shift` + `spin` x point. A force of a square of at most `floor2_n2` counts as none. */
static inline void touch_gather_tool(const touch_tool_points *p, const touch_tool_vectors *__restrict force,
                                     const touch_float_vector row[3], touch_float_vector shift, touch_float_vector spin,
                                     float floor2_n2, touch_tool_vectors *__restrict total) {
    const float *__restrict px = p->x, *__restrict py = p->y, *__restrict pz = p->z;
    for (int n = 0; n < p->count; n++) {
        float x = force->x[n], y = force->y[n], z = force->z[n];
        float is_there = x * x + y * y + z * z > floor2_n2 ? 1.0f : 0.0f;
        total->x[n] += is_there * (shift.x + spin.y * pz[n] - spin.z * py[n] + row[0].x * x + row[0].y * y + row[0].z * z);
        total->y[n] += is_there * (shift.y + spin.z * px[n] - spin.x * pz[n] + row[1].x * x + row[1].y * y + row[1].z * z);
        total->z[n] += is_there * (shift.z + spin.x * py[n] - spin.y * px[n] + row[2].x * x + row[2].y * y + row[2].z * z);
    }
}

/* Weight each force F, of at most the length `limit_n`, by max(0, -n . F / |F|). */
static inline void touch_weight_tool(const touch_tool_points *p, float limit_n, touch_tool_vectors *__restrict force) {
    const float *__restrict nx = p->normal_x, *__restrict ny = p->normal_y, *__restrict nz = p->normal_z;
    const float tiny = 1e-30f; /* the square of a force that is none, so that nothing is divided by zero */
    for (int n = 0; n < p->count; n++) {
        float x = force->x[n], y = force->y[n], z = force->z[n];
        float square = x * x + y * y + z * z, facing = -(nx[n] * x + ny[n] * y + nz[n] * z);
        float size = sqrtf(square > tiny ? square : tiny), clip = limit_n / size;
        float weight = (facing > 0.0f ? facing : 0.0f) * (clip < 1.0f ? clip : 1.0f) / size;
        force->x[n] = weight * x;
        force->y[n] = weight * y;
        force->z[n] = weight * z;
    }
}

/* Add the sum of forces, and that of point x force. */
static inline void touch_sum_tool(const touch_tool_points *p, const touch_tool_vectors *__restrict force, touch_vector *total_n,
                                  touch_vector *torque_nm) {
    float sum[6][TOUCH_TOOL_LANES] = {{0.0f}}; /* many at once, and with less rounding than one after the other */
    for (int n = 0; n < p->count; n += TOUCH_TOOL_LANES) {
        int lanes = p->count - n < TOUCH_TOOL_LANES ? p->count - n : (int)TOUCH_TOOL_LANES;
        for (int l = 0; l < lanes; l++) {
            float x = force->x[n + l], y = force->y[n + l], z = force->z[n + l];
            sum[0][l] += x;
            sum[1][l] += y;
            sum[2][l] += z;
            sum[3][l] += p->y[n + l] * z - p->z[n + l] * y;
            sum[4][l] += p->z[n + l] * x - p->x[n + l] * z;
            sum[5][l] += p->x[n + l] * y - p->y[n + l] * x;
        }
    }
    for (int l = 0; l < TOUCH_TOOL_LANES; l++) {
        *total_n = touch_add(*total_n, touch_vector_of((double)sum[0][l], (double)sum[1][l], (double)sum[2][l]));
        *torque_nm = touch_add(*torque_nm, touch_vector_of((double)sum[3][l], (double)sum[4][l], (double)sum[5][l]));
    }
}

typedef struct { /* how the tool lies in the axes of a body */
    touch_matrix rotation; /* body from tool */
    touch_vector origin_m; /* the device's point */
} touch_tool_pose;

/* Add `weight` times the force of cells at points of the tool; 0: none is in their box. */
static inline int touch_add_tool_cells(const touch_cells *cells, double weight, const touch_tool_pose *pose,
                                       const touch_tool_points *p, touch_tool_vectors *force) {
    touch_tool_cells at;
    touch_float_vector row[3];
    touch_vector per_m = cells->samples_per_m, from_corner_m = touch_subtract(pose->origin_m, cells->corner_m);
    touch_vector start = {per_m.x * from_corner_m.x, per_m.y * from_corner_m.y, per_m.z * from_corner_m.z};
    row[0] = touch_float_of(touch_scale(per_m.x, pose->rotation.row[0]));
    row[1] = touch_float_of(touch_scale(per_m.y, pose->rotation.row[1]));
    row[2] = touch_float_of(touch_scale(per_m.z, pose->rotation.row[2]));
    if (!touch_locate_tool(cells, p, row, touch_float_of(start), &at)) return 0;
    touch_add_tool_samples(cells, (float)weight, p->count, &at, force);
    return 1;
}

/* Add the force of one body at points of the tool to `total`, in the tool's axes. */
static inline void touch_add_tool_body(const touch_receiver *receiver, const touch_body_pair *b, double blend,
                                       touch_vector point_m, const touch_tool_points *p, double floor2_n2,
                                       touch_tool_vectors *total) {
    const touch_matrix *field_from_tool = &receiver->state.tool_rotation;
    touch_vector arm_m = touch_arm_of(b, blend, point_m);
    double reach_m = sqrt(touch_fmax(touch_reach2_of(b), 0.0)) + receiver->settings.tool_reach_m;
    if (!(touch_dot(arm_m, arm_m) <= reach_m * reach_m)) return;
    touch_tool_vectors force;
    touch_tool_pose pose;
    touch_float_vector row[3];
    touch_matrix r = touch_pair_rotation(b, blend), tool_from_body = touch_transposed(field_from_tool);
    for (int n = 0; n < 3; n++) {
        tool_from_body.row[n] = touch_rotate_back(&r, tool_from_body.row[n]);
        row[n] = touch_float_of(tool_from_body.row[n]);
    }
    pose.rotation = touch_transposed(&tool_from_body);
    pose.origin_m = touch_rotate_back(&r, arm_m);
    memset(&force, 0, sizeof force);
    int is_one_field = b->cells_before == b->cells_after;
    int is_reached = touch_add_tool_cells(b->cells_before, is_one_field ? 1.0 : 1.0 - blend, &pose, p, &force);
    if (!is_one_field) is_reached |= touch_add_tool_cells(b->cells_after, blend, &pose, p, &force);
    if (!is_reached) return;
    touch_vector shift = touch_rotate_back(field_from_tool, touch_damping_shift(b, blend));
    touch_vector spin = touch_rotate_back(field_from_tool, touch_damping_spin(b, blend));
    shift = touch_add(shift, touch_cross(spin, touch_rotate_back(field_from_tool, arm_m)));
    touch_gather_tool(p, &force, row, touch_float_of(shift), touch_float_of(spin), (float)floor2_n2, total);
}

static inline touch_vector touch_tool_force(const touch_receiver *receiver, const touch_instant *t, touch_vector point_m,
                                            touch_vector *torque_nm) {
    const touch_settings *settings = &receiver->settings;
    const float *points = (const float *)(const void *)((const char *)receiver + settings->tool_offset);
    const touch_matrix *field_from_tool = &receiver->state.tool_rotation;
    int64_t all = settings->tool_point_count, bodies = touch_body_count(t);
    float limit_n = (float)(TOUCH_BELOW_LIMIT * t->before->force_max_n);
    touch_vector force = touch_zero(), torque = touch_zero();
    for (int64_t first = 0; first < all; first += TOUCH_TOOL_BLOCK) {
        const float *own = points + first;
        int64_t left = all - first, count = left < TOUCH_TOOL_BLOCK ? left : (int64_t)TOUCH_TOOL_BLOCK;
        touch_tool_points p = {own, own + all, own + 2 * all, own + 3 * all, own + 4 * all, own + 5 * all, (int)count};
        touch_tool_vectors total;
        memset(&total, 0, sizeof total);
        for (int64_t n = 0; n < bodies; n++) {
            touch_body_pair b = touch_pair_of(t, n);
            touch_add_tool_body(receiver, &b, t->blend, point_m, &p, t->before->force_floor2_n2, &total);
        }
        touch_weight_tool(&p, limit_n, &total);
        touch_sum_tool(&p, &total, &force, &torque);
    }
    *torque_nm = touch_rotate(field_from_tool, touch_scale(settings->tool_weight, torque));
    return touch_rotate(field_from_tool, touch_scale(settings->tool_weight, force));
}

#endif
