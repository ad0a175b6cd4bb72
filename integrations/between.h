/* The force between two frames, for the programs of this folder; C99 and C++. Include c/touch.h before it.

   As the Python receiver has it: voxels blend; a body is at the pose between, and a field that changes blends in that
   pose. Nothing is allocated, and nothing waits. */
#ifndef TOUCH_BETWEEN_H
#define TOUCH_BETWEEN_H

#include <math.h>

/* The quaternion w, x, y, z of a rotation: the largest of the rows of its products with itself, made unit. */
static void touch_turn_of(const double r[9], double q[4]) {
    const double rows[4][4] = {{1 + r[0] + r[4] + r[8], r[7] - r[5], r[2] - r[6], r[3] - r[1]},
                               {r[7] - r[5], 1 + r[0] - r[4] - r[8], r[1] + r[3], r[2] + r[6]},
                               {r[2] - r[6], r[1] + r[3], 1 - r[0] + r[4] - r[8], r[5] + r[7]},
                               {r[3] - r[1], r[2] + r[6], r[5] + r[7], 1 - r[0] - r[4] + r[8]}};
    double size = 0;
    int n, most = 0;
    for (n = 1; n < 4; n++)
        if (rows[n][n] > rows[most][most]) most = n;
    for (n = 0; n < 4; n++) size += rows[most][n] * rows[most][n];
    for (n = 0; n < 4; n++) q[n] = rows[most][n] / sqrt(size);
}

/* The pose and the motion of a part between two frames; `t` from 0 to 1. */
static void touch_part_between(const touch_part *a, const touch_part *b, double t, touch_part *out) {
    double p[4], q[4], along = 0, xx, yy, zz, xy, xz, yz, wx, wy, wz, s = 0;
    int n;
    touch_turn_of(a->rotation, p), touch_turn_of(b->rotation, q);
    for (n = 0; n < 4; n++) along += p[n] * q[n];
    for (n = 0; n < 4; n++) q[n] = (1 - t) * p[n] + (along < 0 ? -t : t) * q[n]; /* the short way */
    for (n = 0; n < 4; n++) s += q[n] * q[n];
    s = s > 0 ? 2 / s : 0;
    xx = s * q[1] * q[1], yy = s * q[2] * q[2], zz = s * q[3] * q[3];
    xy = s * q[1] * q[2], xz = s * q[1] * q[3], yz = s * q[2] * q[3];
    wx = s * q[0] * q[1], wy = s * q[0] * q[2], wz = s * q[0] * q[3];
    out->rotation[0] = 1 - yy - zz, out->rotation[1] = xy - wz, out->rotation[2] = xz + wy;
    out->rotation[3] = xy + wz, out->rotation[4] = 1 - xx - zz, out->rotation[5] = yz - wx;
    out->rotation[6] = xz - wy, out->rotation[7] = yz + wx, out->rotation[8] = 1 - xx - yy;
    for (n = 0; n < 3; n++) {
        out->position_m[n] = a->position_m[n] + t * (b->position_m[n] - a->position_m[n]);
        out->velocity_m_s[n] = a->velocity_m_s[n] + t * (b->velocity_m_s[n] - a->velocity_m_s[n]);
        out->spin_rad_s[n] = a->spin_rad_s[n] + t * (b->spin_rad_s[n] - a->spin_rad_s[n]);
    }
}

/* Adds the force of one body, with what its motion adds where it has one. */
static void touch_add_body(const touch_frame *frame, const touch_part *a, const touch_part *b, double t,
                           const double at[3], double sum[3]) {
    const double damping = frame->surface_damping_n_s_per_m;
    double first[3], second[3], d[3], size = 0;
    touch_part part;
    touch_frame alone = *frame; /* the body by itself: neither cut nor moved */
    int n;
    touch_part_between(a, b, t, &part);
    alone.parts = 1, alone.part = &part, alone.surface_damping_n_s_per_m = 0, alone.force_max_n = HUGE_VAL;
    part.field = a->field;
    touch_force(&alone, at[0], at[1], at[2], first);
    if (b->field != a->field) {
        part.field = b->field;
        touch_force(&alone, at[0], at[1], at[2], second);
        for (n = 0; n < 3; n++) first[n] += t * (second[n] - first[n]);
    }
    for (n = 0; n < 3; n++) sum[n] += first[n], size += first[n] * first[n], d[n] = at[n] - part.position_m[n];
    if (damping > 0 && sqrt(size) > 1e-9 * frame->force_max_n) {
        sum[0] += damping * (part.velocity_m_s[0] + part.spin_rad_s[1] * d[2] - part.spin_rad_s[2] * d[1]);
        sum[1] += damping * (part.velocity_m_s[1] + part.spin_rad_s[2] * d[0] - part.spin_rad_s[0] * d[2]);
        sum[2] += damping * (part.velocity_m_s[2] + part.spin_rad_s[0] * d[1] - part.spin_rad_s[1] * d[0]);
    }
}

/* A force made no longer than a limit, newtons. */
static void touch_cut(double newtons[3], double most) {
    double size = sqrt(newtons[0] * newtons[0] + newtons[1] * newtons[1] + newtons[2] * newtons[2]);
    int n;
    for (n = 0; n < 3; n++) newtons[n] = size <= most ? newtons[n] : size <= 1e300 ? newtons[n] * (most / size) : 0;
}

/* F between frame `a` (t is 0) and the next one, `b` (t is 1), no longer than `most`. */
static void touch_force_between(const touch_frame *a, const touch_frame *b, double t, const double at[3], double most,
                                double newtons[3]) {
    double later[3];
    uint32_t i;
    int n;
    if (!(t > 1e-9)) touch_force(a, at[0], at[1], at[2], newtons);
    else if (t > 1 - 1e-9) touch_force(b, at[0], at[1], at[2], newtons);
    else if (!a->is_placed) {
        touch_force(a, at[0], at[1], at[2], newtons), touch_force(b, at[0], at[1], at[2], later);
        for (n = 0; n < 3; n++) newtons[n] += t * (later[n] - newtons[n]);
    } else {
        newtons[0] = newtons[1] = newtons[2] = 0;
        for (i = 0; i < a->parts; i++) touch_add_body(a, a->part + i, b->part + i, t, at, newtons);
        touch_cut(newtons, a->force_max_n);
    }
    touch_cut(newtons, most);
}
#endif
