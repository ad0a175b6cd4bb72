"""Weights of several predictions by least squares over the samples just coded; whole numbers only.

Minimises sum w |r - sum a_i d_i|^2 + sum l_i (a_i - b_i)^2 by a few rounds of coordinate descent, where d_i are the
candidates less the first one, r the forces that came less the first candidate, and b slowly adapted weights
(locally adaptive prediction, as lossless image coders use; by descent, because whole numbers allow no Cholesky).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.codec.kernels.lean import LEAN

__all__ = ["MOST", "ONE", "accumulate", "descend"]

ONE = 1 << 14
"""The weight 1."""

MOST = 1023
"""No difference counts for more, in 2^shift units."""
_MOST_WEIGHT = 4 * ONE


@njit(**LEAN)
def _dot(a, b, n):
    total = np.int32(0)
    for i in range(n):
        total = np.int32(total + np.int32(a[i]) * np.int32(b[i]))
    return np.int64(total)


@njit(**LEAN)
def accumulate(a, b, m, near, weights, count, kept, shift, d):
    """``a[i, j]``, ``b[i]`` (i, j < m): sums over `count` samples, ``near`` their rows in `kept`.

    kept : int32 [n, m + 1, 3], candidates less the first, and what came less the first; taken in 2^shift units and
    within +-1023. `d` is scratch, int16 [2, m + 1, 3 * samples]: along the samples, for the compiler's sake;
    no sum reaches 2^31.
    """
    half = (1 << shift) >> 1
    n = 3 * count
    for q in range(count):
        row = near[q]
        for i in range(m + 1):
            for c in range(3):
                d[0, i, 3 * q + c] = min(max((kept[row, i, c] + half) >> shift, -MOST), MOST)
        d[1, m, 3 * q] = d[1, m, 3 * q + 1] = d[1, m, 3 * q + 2] = weights[q]
    for i in range(m):
        for k in range(n):
            d[1, i, k] = d[0, i, k] * d[1, m, k]
    for i in range(m):
        b[i] = _dot(d[1, i], d[0, m], 3 * count)
        for j in range(i + 1):
            a[i, j] = _dot(d[1, i], d[0, j], 3 * count)
            a[j, i] = a[i, j]


@njit(**LEAN)
def descend(a, b, m, prior, ridge, rounds, x):
    """``x[i]``, weights of 1/16384, from `prior`, over which `ridge` [m] holds them."""
    for i in range(m):
        x[i] = prior[i]
    for _ in range(rounds):
        for i in range(m):
            g = b[i] << 14
            for j in range(m):
                g -= a[i, j] * x[j]
            g += ridge[i] * (prior[i] - x[i])
            stiff = a[i, i] + ridge[i]
            if stiff > 0:
                x[i] = min(max(x[i] + g // stiff, -_MOST_WEIGHT), _MOST_WEIGHT)
