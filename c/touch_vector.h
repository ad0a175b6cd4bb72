/* touch_vector.h: vectors of three numbers and matrices, by value. */
#ifndef TOUCH_VECTOR_H
#define TOUCH_VECTOR_H

#include <math.h>

/* Functions of the inner loops: a call with vectors as arguments would copy them through memory. A program that is to be
   small defines TOUCH_INLINE as `static inline`. */
#if defined(TOUCH_INLINE)
#elif defined(__GNUC__)
#define TOUCH_INLINE static inline __attribute__((always_inline))
#else
#define TOUCH_INLINE static inline
#endif

#define TOUCH_PI 3.14159265358979323846

typedef struct {
    double x, y, z;
} touch_vector;

typedef struct {
    touch_vector row[3];
} touch_matrix;

TOUCH_INLINE touch_vector touch_vector_of(double x, double y, double z) {
    touch_vector v;
    v.x = x;
    v.y = y;
    v.z = z;
    return v;
}

/* The larger and the smaller of two numbers; `a` where one is not a number. Unlike fmax, as a comparison does it. */
TOUCH_INLINE double touch_fmax(double a, double b) { return b > a ? b : a; }
TOUCH_INLINE double touch_fmin(double a, double b) { return b < a ? b : a; }

/* x within [low, high] */
TOUCH_INLINE double touch_clamp(double x, double low, double high) { return touch_fmin(touch_fmax(x, low), high); }

/* From 0 at 0 to 1 at 1, without an edge. */
TOUCH_INLINE double touch_smooth_step(double x) {
    double y = touch_clamp(x, 0.0, 1.0);
    return y * y * (3.0 - 2.0 * y);
}

TOUCH_INLINE touch_vector touch_zero(void) { return touch_vector_of(0.0, 0.0, 0.0); }

TOUCH_INLINE double touch_dot(touch_vector a, touch_vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

TOUCH_INLINE touch_vector touch_add(touch_vector a, touch_vector b) {
    return touch_vector_of(a.x + b.x, a.y + b.y, a.z + b.z);
}

TOUCH_INLINE touch_vector touch_subtract(touch_vector a, touch_vector b) {
    return touch_vector_of(a.x - b.x, a.y - b.y, a.z - b.z);
}

TOUCH_INLINE touch_vector touch_scale(double factor, touch_vector a) {
    return touch_vector_of(factor * a.x, factor * a.y, factor * a.z);
}

/* a / length: of length 1 where that is its own; without an overflow, which touch_scale(1 / length, a) may have */
TOUCH_INLINE touch_vector touch_divided(touch_vector a, double length) {
    return touch_vector_of(a.x / length, a.y / length, a.z / length);
}

/* a + factor b */
TOUCH_INLINE touch_vector touch_add_scaled(touch_vector a, double factor, touch_vector b) {
    return touch_vector_of(a.x + factor * b.x, a.y + factor * b.y, a.z + factor * b.z);
}

TOUCH_INLINE touch_vector touch_cross(touch_vector a, touch_vector b) {
    return touch_vector_of(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}

/* R v */
TOUCH_INLINE touch_vector touch_rotate(const touch_matrix *r, touch_vector v) {
    return touch_vector_of(touch_dot(r->row[0], v), touch_dot(r->row[1], v), touch_dot(r->row[2], v));
}

/* R^T v */
TOUCH_INLINE touch_vector touch_rotate_back(const touch_matrix *r, touch_vector v) {
    return touch_add_scaled(touch_add_scaled(touch_scale(v.x, r->row[0]), v.y, r->row[1]), v.z, r->row[2]);
}

TOUCH_INLINE touch_matrix touch_transposed(const touch_matrix *r) {
    touch_matrix t;
    t.row[0] = touch_vector_of(r->row[0].x, r->row[1].x, r->row[2].x);
    t.row[1] = touch_vector_of(r->row[0].y, r->row[1].y, r->row[2].y);
    t.row[2] = touch_vector_of(r->row[0].z, r->row[1].z, r->row[2].z);
    return t;
}

/* The rotation of a quaternion (w, v) of any length; of zero the identity. */
TOUCH_INLINE touch_matrix touch_rotation_of(double w, touch_vector v) {
    double square = w * w + v.x * v.x + v.y * v.y + v.z * v.z, s = square > 0.0 ? 2.0 / square : 0.0;
    double xx = s * v.x * v.x, yy = s * v.y * v.y, zz = s * v.z * v.z;
    double xy = s * v.x * v.y, xz = s * v.x * v.z, yz = s * v.y * v.z;
    double wx = s * w * v.x, wy = s * w * v.y, wz = s * w * v.z;
    touch_matrix r;
    r.row[0] = touch_vector_of(1.0 - yy - zz, xy - wz, xz + wy);
    r.row[1] = touch_vector_of(xy + wz, 1.0 - xx - zz, yz - wx);
    r.row[2] = touch_vector_of(xz - wy, yz + wx, 1.0 - xx - yy);
    return r;
}

/* |v|, also where the squares are beyond the range of double. */
TOUCH_INLINE double touch_norm(touch_vector v) {
    double largest = fmax(fmax(fabs(v.x), fabs(v.y)), fabs(v.z));
    if (largest == 0.0) return 0.0;
    touch_vector unit = touch_vector_of(v.x / largest, v.y / largest, v.z / largest);
    return largest * sqrt(touch_dot(unit, unit));
}

static inline int touch_is_zero(touch_vector v) { return v.x == 0.0 && v.y == 0.0 && v.z == 0.0; }

TOUCH_INLINE int touch_is_finite(touch_vector v) { return isfinite(v.x) && isfinite(v.y) && isfinite(v.z); }

#endif
