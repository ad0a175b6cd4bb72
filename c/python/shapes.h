/* Distance to shapes: ellipsoid_roots (_native.pyi). */
#ifndef TOUCHFIELD_SHAPES_H
#define TOUCHFIELD_SHAPES_H

#include "query.h"

/* Of Newton's iteration; at its slowest, near the focal ellipse, it needs about ten. */
enum { MAX_NEWTON_STEPS = 60 };

/* The greatest u >= 0 with sum (r_i z_i / (u + r_i - 1))^2 = 1; 0 if the sum is always below 1. */
static inline double ellipsoid_root(const double *scaled, const double *ratio) {
    double root = 0.0;
    for (int i = 0; i < 3; i++) root = fmax(root, ratio[i] * scaled[i] - (ratio[i] - 1.0)); /* no term exceeds 1 there */
    for (int step = 0; step < MAX_NEWTON_STEPS; step++) {
        double square = 0.0, fall = 0.0;
        for (int i = 0; i < 3; i++) {
            double denominator = root + (ratio[i] - 1.0);
            if (!(denominator > 0.0)) continue;
            double term = ratio[i] * scaled[i] / denominator;
            square += term * term;
            fall += term * term / denominator;
        }
        if (square <= 1.0) break;
        double next = root + square * (sqrt(square) - 1.0) / fall;
        if (next <= root * (1.0 + 4e-16)) break;
        root = next;
    }
    return root;
}

/* (scaled, ratio, out) */
static PyObject *native_ellipsoid_roots(PyObject *module, PyObject *arguments) {
    PyObject *scaled, *out;
    double ratio[3];
    int64_t count = -1;
    buffer_list arrays = {NULL, 0, 0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "O(ddd)O", &scaled, ratio, ratio + 1, ratio + 2, &out)) return NULL;
    const double *from = (const double *)add_numbers(&arrays, scaled, 3, &count);
    double *root = from ? (double *)add_output(&arrays, out, 8, &count) : NULL;
    if (root) {
        PyThreadState *state = PyEval_SaveThread();
        for (int64_t n = 0; n < count; n++) root[n] = ellipsoid_root(from + 3 * n, ratio);
        PyEval_RestoreThread(state);
    }
    return done(&arrays, root != NULL);
}

#define SHAPES_METHODS {"ellipsoid_roots", native_ellipsoid_roots, METH_VARARGS, "Roots for the distance to an ellipsoid."}

#endif
