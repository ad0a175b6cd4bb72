/* The simulated hand: follow, spring, interpolate_orientation (_native.pyi). */
#ifndef TOUCHFIELD_HAND_H
#define TOUCHFIELD_HAND_H

#include "arguments.h"

#include <math.h>

#define MAX_PHASE 0.1 /* of the spring and mass in a sub-step; the integration is stable up to 2 */

typedef struct { /* the samples before and after a time, and how far from the first to the second */
    int64_t before, after;
    double fraction;
} hand_bracket;

/* Before the first and after the last sample the fraction is 0; of equal times, the later sample counts. */
static inline hand_bracket find_time(const double *times_s, int64_t count, double time_s) {
    int64_t low = 0, high = count;
    while (low < high) {
        int64_t middle = low + (high - low) / 2;
        if (times_s[middle] <= time_s)
            low = middle + 1;
        else
            high = middle;
    }
    hand_bracket found = {low > 0 ? low - 1 : 0, low < count ? low : count - 1, 0.0};
    if (found.after > found.before && low > 0)
        found.fraction = (time_s - times_s[found.before]) / (times_s[found.after] - times_s[found.before]);
    return found;
}

typedef struct {
    Py_buffer times, values, state;
} hand_arrays;

static inline void release_hand(hand_arrays *arrays) {
    PyBuffer_Release(&arrays->times), PyBuffer_Release(&arrays->values), PyBuffer_Release(&arrays->state);
}

/* Times [n], samples [n][width] and a state of `size` numbers; returns n. 0: an error is raised. */
static inline int64_t read_hand(PyObject *const *arguments, int64_t width, int64_t size, hand_arrays *arrays) {
    int64_t count = -1, values;
    if (!read_array(arguments[0], sizeof(double), &count, &arrays->times)) return 0;
    values = count * width;
    if (!read_array(arguments[1], sizeof(double), &values, &arrays->values)) {
        PyBuffer_Release(&arrays->times);
        return 0;
    }
    if (PyObject_GetBuffer(arguments[2], &arrays->state, PyBUF_WRITABLE)) {
        PyBuffer_Release(&arrays->times), PyBuffer_Release(&arrays->values);
        return 0;
    }
    if (count > 0 && arrays->state.len == (Py_ssize_t)sizeof(double) * size) return count;
    release_hand(arrays);
    return refuse(TOUCH_ARGUMENT, "an array of another size");
}

/* The position of the trajectory at a time, linear between samples. */
static inline void find_target(const hand_arrays *arrays, int64_t count, double time_s, double target[3]) {
    const double *positions = (const double *)arrays->values.buf;
    hand_bracket at = find_time((const double *)arrays->times.buf, count, time_s);
    for (int n = 0; n < 3; n++)
        target[n] = (1.0 - at.fraction) * positions[3 * at.before + n] + at.fraction * positions[3 * at.after + n];
}

enum { HAND_TIME = 0, HAND_POSITION = 1, HAND_VELOCITY = 4, HAND_FORCE = 7, HAND_NUMBERS = 10 }; /* of the state */

static PyObject *py_follow(PyObject *self, PyObject *const *arguments, Py_ssize_t argument_count) {
    hand_arrays arrays;
    double dt_s;
    (void)self;
    if (!expect_arguments(argument_count, 4) || !read_doubles(arguments + 3, 1, &dt_s)) return NULL;
    int64_t count = read_hand(arguments, 3, HAND_NUMBERS, &arrays);
    if (!count) return NULL;
    double *state = (double *)arrays.state.buf;
    state[HAND_TIME] += dt_s;
    find_target(&arrays, count, state[HAND_TIME], state + HAND_POSITION);
    release_hand(&arrays);
    return none();
}

/* m a = k (target - x) - b v + F by semi-implicit Euler, with b implicit: stable where sqrt(k/m) times the sub-step is below
   2, for any b. The force is constant during dt. */
static inline void move_by_spring(const hand_arrays *arrays, int64_t count, double mass, double stiffness, double damping,
                                  double dt_s) {
    double *state = (double *)arrays->state.buf, target[3];
    int64_t steps = (int64_t)ceil(dt_s * sqrt(stiffness / mass) / MAX_PHASE);
    if (steps < 1) steps = 1;
    double h = dt_s / (double)steps, damping_factor = 1.0 / (1.0 + h * damping / mass);
    for (int64_t step = 0; step < steps; step++) {
        state[HAND_TIME] += h;
        find_target(arrays, count, state[HAND_TIME], target);
        for (int n = 0; n < 3; n++) {
            double *x = state + HAND_POSITION + n, *v = state + HAND_VELOCITY + n;
            double pull = stiffness * (target[n] - *x) + state[HAND_FORCE + n];
            *v = (*v + h * pull / mass) * damping_factor;
            *x += h * *v;
        }
    }
}

static PyObject *py_spring(PyObject *self, PyObject *const *arguments, Py_ssize_t argument_count) {
    hand_arrays arrays;
    double numbers[4]; /* mass, stiffness, damping, dt */
    (void)self;
    if (!expect_arguments(argument_count, 7) || !read_doubles(arguments + 3, 4, numbers)) return NULL;
    if (!(numbers[0] > 0.0 && numbers[1] >= 0.0 && numbers[3] >= 0.0 && numbers[3] * sqrt(numbers[1] / numbers[0]) < 1e6))
        return fail(TOUCH_ARGUMENT, "a mass, stiffness or time out of range");
    int64_t count = read_hand(arguments, 3, HAND_NUMBERS, &arrays);
    if (!count) return NULL;
    move_by_spring(&arrays, count, numbers[0], numbers[1], numbers[2], numbers[3]);
    release_hand(&arrays);
    return none();
}

/* Along the shorter arc, normalised. */
static PyObject *py_interpolate_orientation(PyObject *self, PyObject *const *arguments, Py_ssize_t argument_count) {
    hand_arrays arrays;
    double time_s, cosine = 0.0, square = 0.0;
    (void)self;
    if (!expect_arguments(argument_count, 4) || !read_doubles(arguments + 3, 1, &time_s)) return NULL;
    int64_t count = read_hand(arguments, 4, 4, &arrays);
    if (!count) return NULL;
    hand_bracket at = find_time((const double *)arrays.times.buf, count, time_s);
    const double *before = (const double *)arrays.values.buf + 4 * at.before;
    const double *after = (const double *)arrays.values.buf + 4 * at.after;
    double *out = (double *)arrays.state.buf;
    for (int n = 0; n < 4; n++) cosine += before[n] * after[n];
    double weight = cosine >= 0.0 ? at.fraction : -at.fraction;
    for (int n = 0; n < 4; n++) {
        out[n] = (1.0 - at.fraction) * before[n] + weight * after[n];
        square += out[n] * out[n];
    }
    for (int n = 0; n < 4; n++) out[n] /= sqrt(square);
    release_hand(&arrays);
    return none();
}

#define HAND_METHODS                                          \
    {"follow", FAST_FUNCTION(py_follow), METH_FASTCALL, NULL}, \
    {"spring", FAST_FUNCTION(py_spring), METH_FASTCALL, NULL}, \
    {"interpolate_orientation", FAST_FUNCTION(py_interpolate_orientation), METH_FASTCALL, NULL}

#endif
