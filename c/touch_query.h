/* touch_query.h: the force, its gradient and the vibration of a field at points and times, from frames in the memory of a
   receiver (touch_receiver.h). Nothing is allocated. touch_tool.h has the force on a tool of many points.

   A field is a sum over bodies, each with forces in its own axes: no surface, no mesh. touch_force_at, the penalty force:

       touch_bent_force            with a deformation: the point moved by u(x), F rotated and stretched by (I + grad u)^T
       touch_stored_force          the sum over the bodies, clipped to force_max_n
           touch_arm_of                from the body's origin to the point; beyond its reach there is no force
           touch_body_force            the arm into the body's axes, and the force back out
               touch_own_force             of one frame, or of two, blended
                   touch_locate                brick, cell and fraction of the cell: touch_cells.h
                   touch_cell_force            trilinear between eight corners
           touch_motion_force          what the motion of the surface adds: damping times velocity */
#ifndef TOUCH_QUERY_H
#define TOUCH_QUERY_H

#include "touch_cells.h"

/* An instant: two frames in the memory that begins at `memory`, and how far it lies on the way from the first to the
   second, 0 to 1. Where one frame alone is shown, both are that frame. */
typedef struct {
    const char *memory;
    const touch_frame_header *before, *after;
    double blend;
} touch_instant;

/* Frames by their offsets; a blend at 0 or 1, or beyond, selects one frame. */
static inline touch_instant touch_instant_of(const void *memory, int64_t before_offset, int64_t after_offset, double blend);
/* Newtons; zero where the point is not finite. Trilinear in space; the pose of a body is interpolated, and fields that
   differ are blended linearly in that pose. */
static inline touch_vector touch_force_at(const touch_instant *t, touch_vector point_m);
/* dF_i/dx_j, N/m, by differences from the force at the point to those just ahead. */
static inline touch_matrix touch_gradient_at(const touch_instant *t, touch_vector point_m, touch_vector force_n);
/* Amplitude, N, and frequency, Hz. */
static inline void touch_vibration_at(const touch_instant *t, touch_vector point_m, double *amplitude_n, double *frequency_hz);
/* Bodies that both frames have, and the one that pushes most at a point; -1: none. */
static inline int64_t touch_body_count(const touch_instant *t);
static inline int64_t touch_strongest_body(const touch_instant *t, touch_vector point_m);
/* Where a body lies: a point x of the body is at R x + position. */
static inline touch_matrix touch_body_rotation(const touch_instant *t, int64_t body);
static inline touch_vector touch_body_position(const touch_instant *t, int64_t body);
/* The body that carries a point: the one that pushes most there; -1: none, as in voxels. */
static inline int64_t touch_carrying_body(const touch_instant *t, touch_vector point_m);
/* A point of the scene in the axes of a body; and where one that is fixed to a body lies now, `point_m` without a body. */
static inline touch_vector touch_point_in_body(const touch_instant *t, int64_t body, touch_vector point_m);
static inline touch_vector touch_carried_point(const touch_instant *t, int64_t body, touch_vector in_body_m,
                                               touch_vector point_m);
/* The displacements by which the first frame yields follow a force at a point for dt_s seconds; all others go to rest. */
static inline void touch_yield(touch_receiver *receiver, const touch_instant *t, touch_vector point_m, touch_vector force_n,
                               double dt_s);

/* -- frames and bodies ------------------------------------------------------------------------------------------------ */

/* An instant this near to a frame is that frame, whatever the rounding of its seconds; a fraction of the interval. */
#define TOUCH_AT_FRAME 1e-9
/* Rounding to float then never raises a clipped force above the limit. */
#define TOUCH_BELOW_LIMIT (1.0 - 1.0 / 4194304.0)

static inline touch_instant touch_instant_of(const void *memory, int64_t before_offset, int64_t after_offset, double blend) {
    touch_instant t;
    if (before_offset == after_offset || !(blend > TOUCH_AT_FRAME)) {
        after_offset = before_offset;
        blend = 0.0;
    } else if (blend >= 1.0 - TOUCH_AT_FRAME) {
        before_offset = after_offset;
        blend = 0.0;
    }
    t.memory = (const char *)memory;
    t.before = (const touch_frame_header *)(const void *)(t.memory + before_offset);
    t.after = (const touch_frame_header *)(const void *)(t.memory + after_offset);
    t.blend = blend;
    return t;
}

static inline int64_t touch_body_count(const touch_instant *t) {
    return t->before->body_count < t->after->body_count ? t->before->body_count : t->after->body_count;
}

typedef struct { /* a body in both frames of an instant */
    const touch_body_pose *before, *after;
    const touch_cells *cells_before, *cells_after; /* one and the same of a rigid body */
} touch_body_pair;

TOUCH_INLINE const touch_cells *touch_cells_at(const touch_instant *t, int64_t offset) {
    return (const touch_cells *)(const void *)(t->memory + offset);
}

TOUCH_INLINE touch_body_pair touch_pair_of(const touch_instant *t, int64_t body) {
    touch_body_pair pair;
    pair.before = (const touch_body_pose *)(const void *)(t->before + 1) + body;
    pair.after = (const touch_body_pose *)(const void *)(t->after + 1) + body;
    pair.cells_before = touch_cells_at(t, pair.before->cells_offset);
    pair.cells_after = touch_cells_at(t, pair.after->cells_offset);
    return pair;
}

TOUCH_INLINE touch_vector touch_between(touch_vector before, touch_vector after, double blend) {
    return touch_add_scaled(before, blend, touch_subtract(after, before));
}

/* Whether a body has a pose; else its axes are those of the scene, and its surface does not move. */
TOUCH_INLINE int touch_is_moved(const touch_body_pair *b) { return !(b->before->is_identity & b->after->is_identity); }

/* From the body's origin to a point, metres, in the axes of the scene. */
TOUCH_INLINE touch_vector touch_arm_of(const touch_body_pair *b, double blend, touch_vector point_m) {
    return touch_subtract(point_m, touch_between(b->before->position_m, b->after->position_m, blend));
}

/* The square of the distance from the body's origin within which all its forces lie; below 0: it has none. */
TOUCH_INLINE double touch_reach2_of(const touch_body_pair *b) {
    return touch_fmax(b->cells_before->reach2_m2, b->cells_after->reach2_m2);
}

/* Whether a point is beyond all forces of a body; true of an arm that is not finite, too. */
TOUCH_INLINE int touch_is_far(const touch_body_pair *b, touch_vector arm_m) {
    return !(touch_dot(arm_m, arm_m) <= touch_reach2_of(b));
}

/* R of a body: of both quaternions, mixed and made unit, which follows the great circle between them. */
TOUCH_INLINE touch_matrix touch_pair_rotation(const touch_body_pair *b, double blend) {
    if (blend == 0.0) return b->before->rotation;
    const double *p = b->before->quaternion, *q = b->after->quaternion;
    touch_vector before = touch_vector_of(p[1], p[2], p[3]), after = touch_vector_of(q[1], q[2], q[3]);
    double first = 1.0 - blend;
    double second = p[0] * q[0] + touch_dot(before, after) >= 0.0 ? blend : -blend; /* the short way */
    return touch_rotation_of(first * p[0] + second * q[0], touch_add_scaled(touch_scale(first, before), second, after));
}

static inline touch_matrix touch_body_rotation(const touch_instant *t, int64_t body) {
    touch_body_pair b = touch_pair_of(t, body);
    return touch_pair_rotation(&b, t->blend);
}

static inline touch_vector touch_body_position(const touch_instant *t, int64_t body) {
    touch_body_pair b = touch_pair_of(t, body);
    return touch_between(b.before->position_m, b.after->position_m, t->blend);
}

static inline int64_t touch_carrying_body(const touch_instant *t, touch_vector point_m) {
    const touch_body_pose *poses = (const touch_body_pose *)(const void *)(t->before + 1);
    return poses->is_identity ? -1 : touch_strongest_body(t, point_m);
}

static inline touch_vector touch_point_in_body(const touch_instant *t, int64_t body, touch_vector point_m) {
    if (body < 0) return point_m;
    touch_matrix rotation = touch_body_rotation(t, body);
    return touch_rotate_back(&rotation, touch_subtract(point_m, touch_body_position(t, body)));
}

static inline touch_vector touch_carried_point(const touch_instant *t, int64_t body, touch_vector in_body_m,
                                               touch_vector point_m) {
    if (body < 0 || body >= touch_body_count(t)) return point_m;
    touch_matrix rotation = touch_body_rotation(t, body);
    return touch_add(touch_rotate(&rotation, in_body_m), touch_body_position(t, body));
}

/* Angular velocity times surface damping, N/m. */
TOUCH_INLINE touch_vector touch_damping_spin(const touch_body_pair *b, double blend) {
    return touch_between(b->before->surface_damping_n_per_m, b->after->surface_damping_n_per_m, blend);
}

/* Velocity of the body's origin times surface damping, N. */
TOUCH_INLINE touch_vector touch_damping_shift(const touch_body_pair *b, double blend) {
    return touch_between(b->before->surface_damping_n, b->after->surface_damping_n, blend);
}

/* The force that the motion of the body's surface adds, N, at an arm from its origin. */
TOUCH_INLINE touch_vector touch_motion_force(const touch_body_pair *b, double blend, touch_vector arm_m) {
    return touch_add(touch_damping_shift(b, blend), touch_cross(touch_damping_spin(b, blend), arm_m));
}

/* -- force ------------------------------------------------------------------------------------------------------------ */

/* A sum of forces of at most the length `limit_n`, in the same direction. A force that overflowed has no direction. */
TOUCH_INLINE touch_vector touch_clipped(touch_vector force_n, double limit_n) {
    double square = touch_dot(force_n, force_n);
    if (!(square < (double)INFINITY)) return touch_zero();
    if (!(square > limit_n * limit_n)) return force_n;
    double factor = limit_n * TOUCH_BELOW_LIMIT / sqrt(square);
    return touch_vector_of(force_n.x * factor, force_n.y * factor, force_n.z * factor);
}

/* total + weight times the force of cells at a point in the axes of their body. */
TOUCH_INLINE touch_vector touch_add_cell_force(touch_vector total, double weight, const touch_cells *cells, touch_vector p) {
    touch_cell_point found = touch_locate(cells, p);
    return found.corner ? touch_add_scaled(total, weight, touch_cell_force(found)) : total;
}

/* The force of a body's cells at a point in its own axes. */
TOUCH_INLINE touch_vector touch_own_force(const touch_body_pair *b, double blend, touch_vector p) {
    if (b->cells_before == b->cells_after) return touch_add_cell_force(touch_zero(), 1.0, b->cells_before, p);
    touch_vector force = touch_add_cell_force(touch_zero(), 1.0 - blend, b->cells_before, p);
    return touch_add_cell_force(force, blend, b->cells_after, p);
}

/* The force of a body at an arm from its origin, in the axes of the scene, without what its motion adds. */
TOUCH_INLINE touch_vector touch_body_force(const touch_body_pair *b, double blend, touch_vector arm_m) {
    if (!touch_is_moved(b)) return touch_own_force(b, blend, arm_m);
    const touch_matrix *r = &b->before->rotation; /* as it is, without a copy, where one frame is shown */
    touch_matrix mixed;
    if (blend != 0.0) {
        mixed = touch_pair_rotation(b, blend);
        r = &mixed;
    }
    return touch_rotate(r, touch_own_force(b, blend, touch_rotate_back(r, arm_m)));
}

/* The sum over the bodies as the frames have them, without their deformation. */
TOUCH_INLINE touch_vector touch_stored_force(const touch_instant *t, touch_vector point_m) {
    touch_vector total = touch_zero();
    int64_t count = touch_body_count(t);
    for (int64_t n = 0; n < count; n++) {
        touch_body_pair b = touch_pair_of(t, n);
        touch_vector arm_m = point_m;
        int is_moved = touch_is_moved(&b);
        if (is_moved) arm_m = touch_arm_of(&b, t->blend, point_m);
        if (is_moved && touch_is_far(&b, arm_m)) continue;
        touch_vector force = touch_body_force(&b, t->blend, arm_m);
        if (!(touch_dot(force, force) > t->before->force_floor2_n2)) continue;
        total = touch_add(total, force);
        if (is_moved) total = touch_add(total, touch_motion_force(&b, t->blend, arm_m));
    }
    return touch_clipped(total, t->before->force_max_n);
}

static inline int64_t touch_strongest_body(const touch_instant *t, touch_vector point_m) {
    int64_t strongest = -1, count = touch_body_count(t);
    double largest_n = 0.0;
    for (int64_t n = 0; n < count; n++) {
        touch_body_pair b = touch_pair_of(t, n);
        touch_vector arm_m = touch_arm_of(&b, t->blend, point_m);
        if (touch_is_far(&b, arm_m)) continue;
        double size_n = touch_norm(touch_body_force(&b, t->blend, arm_m));
        if (size_n > largest_n) {
            strongest = n;
            largest_n = size_n;
        }
    }
    return strongest;
}

/* -- deformation ------------------------------------------------------------------------------------------------------ */

/* The deformation of a frame; NULL: it has none. */
TOUCH_INLINE const touch_deformation *touch_deformation_of(const touch_frame_header *frame) {
    if (!TOUCH_HAS_EXTRAS || frame->deformation_offset <= 0) return NULL;
    return (const touch_deformation *)(const void *)((const char *)frame + frame->deformation_offset);
}

typedef struct { /* a point in the lattice of a deformation, along one axis */
    int64_t first;              /* of the four control points about it */
    double weight[4], slope[4]; /* of each, and its derivative, 1/m */
    int is_inside;
} touch_spline_point;

/* A cubic B-spline; beyond the lattice it stays as at its edge, without slope. */
static inline touch_spline_point touch_spline_at(int64_t point_count, double corner_m, double cells_per_m, double x_m) {
    touch_spline_point p;
    int64_t cells = point_count - 3;
    double s = (x_m - corner_m) * cells_per_m;
    p.is_inside = 0.0 <= s && s <= (double)cells;
    if (!p.is_inside) {
        cells_per_m = 0.0;
        s = s > (double)cells ? (double)cells : 0.0;
    }
    p.first = (int64_t)s < cells - 1 ? (int64_t)s : cells - 1;
    double t = s - (double)p.first, r = 1.0 - t, half = 0.5 * cells_per_m;
    p.weight[0] = r * r * r / 6.0;
    p.weight[1] = (3.0 * t * t * t - 6.0 * t * t + 4.0) / 6.0;
    p.weight[2] = (3.0 * r * r * r - 6.0 * r * r + 4.0) / 6.0;
    p.weight[3] = t * t * t / 6.0;
    p.slope[0] = -half * r * r;
    p.slope[1] = half * (3.0 * t * t - 4.0 * t);
    p.slope[2] = -half * (3.0 * r * r - 4.0 * r);
    p.slope[3] = half * t * t;
    return p;
}

/* The same along x, y and z. */
static inline void touch_spline_points(const touch_deformation *d, touch_vector point_m, touch_spline_point axis[3]) {
    axis[0] = touch_spline_at(d->point_count[0], d->corner_m.x, d->cells_per_m.x, point_m.x);
    axis[1] = touch_spline_at(d->point_count[1], d->corner_m.y, d->cells_per_m.y, point_m.y);
    axis[2] = touch_spline_at(d->point_count[2], d->corner_m.z, d->cells_per_m.z, point_m.z);
}

/* Displacements, metres: those of a deformation lie behind it, those by which it yields at their own offset. */
TOUCH_INLINE const touch_vector *touch_displacements_of(const touch_deformation *d) {
    return (const touch_vector *)(const void *)(d + 1);
}

/* The displacement of a control point at an instant: of both frames, blended, and what it yields. */
TOUCH_INLINE touch_vector touch_displacement_at(const touch_instant *t, const touch_deformation *before,
                                                const touch_deformation *after, int64_t point) {
    touch_vector v = touch_displacements_of(before)[point];
    if (after != before)
        v = touch_add(touch_scale(1.0 - t->blend, v), touch_scale(t->blend, touch_displacements_of(after)[point]));
    if (before->yield_offset <= 0) return v;
    return touch_add(v, ((const touch_vector *)(const void *)(t->memory + before->yield_offset))[point]);
}

typedef struct { /* displacement u at a point, metres, and its derivatives along x, y and z */
    touch_vector u, dx, dy, dz;
} touch_bend;

/* The sum over the 64 control points about a point; along z first, where four lie one behind the other. */
static inline touch_bend touch_bend_at(const touch_instant *t, touch_vector point_m) {
    const touch_deformation *before = touch_deformation_of(t->before), *after = touch_deformation_of(t->after);
    touch_bend bend = {{0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}};
    touch_spline_point axis[3];
    touch_spline_points(before, point_m, axis);
    const touch_spline_point *x = axis, *y = axis + 1, *z = axis + 2;
    int64_t ny = before->point_count[1], nz = before->point_count[2];
    for (int m = 0; m < 4; m++)
        for (int n = 0; n < 4; n++) {
            touch_vector sum = touch_zero(), slope = touch_zero();
            int64_t point = ((x->first + m) * ny + y->first + n) * nz + z->first;
            for (int o = 0; o < 4; o++) {
                touch_vector v = touch_displacement_at(t, before, after, point + o);
                sum = touch_add_scaled(sum, z->weight[o], v);
                slope = touch_add_scaled(slope, z->slope[o], v);
            }
            double weight = x->weight[m] * y->weight[n];
            bend.u = touch_add_scaled(bend.u, weight, sum);
            bend.dz = touch_add_scaled(bend.dz, weight, slope);
            bend.dx = touch_add_scaled(bend.dx, x->slope[m] * y->weight[n], sum);
            bend.dy = touch_add_scaled(bend.dy, x->weight[m] * y->slope[n], sum);
        }
    return bend;
}

/* (I + grad u)^T F(x + u): the force of a field that a deformation bends. */
static inline touch_vector touch_bent_force(const touch_instant *t, touch_vector point_m) {
    touch_bend bend = touch_bend_at(t, point_m);
    touch_vector f = touch_stored_force(t, touch_add(point_m, bend.u));
    return touch_vector_of(f.x + touch_dot(bend.dx, f), f.y + touch_dot(bend.dy, f), f.z + touch_dot(bend.dz, f));
}

/* touch_force_at as a part of a loop. */
TOUCH_INLINE touch_vector touch_inlined_force(const touch_instant *t, touch_vector point_m) {
    return touch_deformation_of(t->before) ? touch_bent_force(t, point_m) : touch_stored_force(t, point_m);
}

static inline touch_vector touch_force_at(const touch_instant *t, touch_vector point_m) {
    return touch_inlined_force(t, point_m);
}

TOUCH_INLINE double touch_square_sum(const double w[4]) {
    return w[0] * w[0] + w[1] * w[1] + w[2] * w[2] + w[3] * w[3];
}

static inline void touch_yield(touch_receiver *receiver, const touch_instant *t, touch_vector point_m, touch_vector force_n,
                               double dt_s) {
    const touch_deformation *d = touch_deformation_of(t->before);
    if (!d || d->yield_offset <= 0) return;
    touch_vector *yields_m = (touch_vector *)(void *)((char *)receiver + d->yield_offset);
    int64_t ny = d->point_count[1], nz = d->point_count[2], count = d->point_count[0] * ny * nz;
    double rest = exp(-dt_s / d->relaxation_s);
    for (int64_t n = 0; n < count; n++) yields_m[n] = touch_scale(rest, yields_m[n]);
    touch_spline_point axis[3];
    touch_spline_points(d, point_m, axis);
    if (!axis[0].is_inside || !axis[1].is_inside || !axis[2].is_inside) return;
    const double *x = axis[0].weight, *y = axis[1].weight, *z = axis[2].weight;
    double square = touch_square_sum(x) * touch_square_sum(y) * touch_square_sum(z);
    double m_per_n = (1.0 - rest) * d->compliance_m_per_n / square, max_m = d->max_yield_m;
    for (int m = 0; m < 4; m++)
        for (int n = 0; n < 4; n++)
            for (int o = 0; o < 4; o++) {
                int64_t point = ((axis[0].first + m) * ny + axis[1].first + n) * nz + axis[2].first + o;
                touch_vector *yield_m = yields_m + point;
                double weight = m_per_n * x[m] * y[n] * z[o];
                yield_m->x = touch_clamp(yield_m->x + weight * force_n.x, -max_m, max_m);
                yield_m->y = touch_clamp(yield_m->y + weight * force_n.y, -max_m, max_m);
                yield_m->z = touch_clamp(yield_m->z + weight * force_n.z, -max_m, max_m);
            }
}

/* -- gradient --------------------------------------------------------------------------------------------------------- */

/* A step from a coordinate, metres: far less than any spacing, far more than the rounding of a position. */
TOUCH_INLINE double touch_step_ahead(double x_m) { return x_m + (1e-8 + 1e-12 * fabs(x_m)); }

/* (F_ahead - F) / h: the derivative of a force along one axis, N/m. */
TOUCH_INLINE touch_vector touch_slope(const touch_instant *t, touch_vector ahead_m, touch_vector force_n, double h_m) {
    return touch_scale(1.0 / h_m, touch_subtract(touch_inlined_force(t, ahead_m), force_n));
}

/* touch_gradient_at as a part of a loop. On a plane of a lattice it is that of the cell towards greater indices. */
TOUCH_INLINE touch_matrix touch_inlined_gradient(const touch_instant *t, touch_vector point_m, touch_vector force_n) {
    double x_m = touch_step_ahead(point_m.x), y_m = touch_step_ahead(point_m.y), z_m = touch_step_ahead(point_m.z);
    touch_vector dx = touch_slope(t, touch_vector_of(x_m, point_m.y, point_m.z), force_n, x_m - point_m.x);
    touch_vector dy = touch_slope(t, touch_vector_of(point_m.x, y_m, point_m.z), force_n, y_m - point_m.y);
    touch_vector dz = touch_slope(t, touch_vector_of(point_m.x, point_m.y, z_m), force_n, z_m - point_m.z);
    touch_matrix gradient;
    gradient.row[0] = touch_vector_of(dx.x, dy.x, dz.x);
    gradient.row[1] = touch_vector_of(dx.y, dy.y, dz.y);
    gradient.row[2] = touch_vector_of(dx.z, dy.z, dz.z);
    return gradient;
}

static inline touch_matrix touch_gradient_at(const touch_instant *t, touch_vector point_m, touch_vector force_n) {
    return touch_inlined_gradient(t, point_m, force_n);
}

/* -- vibration -------------------------------------------------------------------------------------------------------- */

/* An amplitude exceeds the largest before it by a millionth: rounding never decides between equals. */
TOUCH_INLINE int touch_exceeds(double amplitude_n, double largest_n) { return amplitude_n > largest_n * (1.0 + 1e-6); }

/* Of one frame: the amplitude interpolated, the frequency that of the corner that adds most to it. */
static inline void touch_frame_vibration(const touch_instant *t, const touch_frame_header *frame, touch_vector point_m,
                                         double *amplitude_n, double *frequency_hz) {
    *amplitude_n = *frequency_hz = 0.0;
    if (!frame->vibration_offset) return;
    touch_cell_point p = touch_locate(touch_cells_at(t, frame->vibration_offset), point_m);
    if (!p.corner) return;
    touch_vector f = p.fraction;
    double amplitude = touch_interpolate(p.corner, f.x, f.y, f.z), largest = 0.0;
    if (!(amplitude > 0.0)) return;
    *amplitude_n = amplitude;
    for (int c = 0; c < 8; c++) {
        int i = c >> 2, j = c >> 1 & 1, k = c & 1;
        const float *corner = p.corner + TOUCH_NEXT_X * i + TOUCH_NEXT_Y * j + TOUCH_NEXT_Z * k;
        double weight = (i ? f.x : 1.0 - f.x) * (j ? f.y : 1.0 - f.y) * (k ? f.z : 1.0 - f.z);
        if (touch_exceeds(weight * corner[0], largest)) {
            largest = weight * corner[0];
            *frequency_hz = corner[1];
        }
    }
}

/* Between two frames the amplitude is linear in time, and the frequency that of the frame that adds most to it. */
static inline void touch_vibration_at(const touch_instant *t, touch_vector point_m, double *amplitude_n, double *frequency_hz) {
    if (touch_deformation_of(t->before)) point_m = touch_add(point_m, touch_bend_at(t, point_m).u);
    touch_frame_vibration(t, t->before, point_m, amplitude_n, frequency_hz);
    if (!(t->blend > 0.0)) return;
    double later_n, later_hz;
    touch_frame_vibration(t, t->after, point_m, &later_n, &later_hz);
    if (touch_exceeds(t->blend * later_n, (1.0 - t->blend) * *amplitude_n)) *frequency_hz = later_hz;
    *amplitude_n += t->blend * (later_n - *amplitude_n);
}

#endif
