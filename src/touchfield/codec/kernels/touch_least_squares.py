"""Weights of several predictions by least squares over the samples just coded; whole numbers only.

Minimises sum w |r - sum a_i d_i|^2 + sum l_i (a_i - b_i)^2 by a few rounds of coordinate descent, where d_i are the
candidates less the first one, r the forces that came less the first candidate, and b slowly adapted weights
(locally adaptive prediction, as lossless image coders use; by descent, because whole numbers allow no Cholesky).
"""

from __future__ import annotations

import numpy as np
from numba import njit

__all__ = ["ONE", "accumulate", "descend"]

ONE = 1 << 14
"""The weight 1."""

_MOST = 2047
_MOST_WEIGHT = 4 * ONE


@njit(cache=True, nogil=True, error_model="numpy")
def accumulate(a, b, m, near, weights, count, kept, shift, d):
    """``a[i, j]``, ``b[i]`` (i, j < m): sums over `count` samples, ``near`` their rows in `kept`.

    kept : int32 [n, m + 1, 3], candidates less the first, and what came less the first; taken in 2^shift units and
    within +-2047. `d` is scratch, int32 [3, m + 1].
    """
    for i in range(m):
        b[i] = 0
        for j in range(i + 1):
            a[i, j] = 0
    half = (1 << shift) >> 1
    for q in range(count):
        row = near[q]
        w = weights[q]
        for c in range(3):
            for i in range(m):
                x = (kept[row, i, c] + half) >> shift
                d[c, i] = min(max(x, -_MOST), _MOST)
            x = (kept[row, m, c] + half) >> shift
            d[c, m] = min(max(x, -_MOST), _MOST)
        for i in range(m):
            d0, d1, d2 = np.int64(d[0, i]) * w, np.int64(d[1, i]) * w, np.int64(d[2, i]) * w
            if d0 != 0 or d1 != 0 or d2 != 0:
                b[i] += d0 * d[0, m] + d1 * d[1, m] + d2 * d[2, m]
                for j in range(i + 1):
                    a[i, j] += d0 * d[0, j] + d1 * d[1, j] + d2 * d[2, j]
    for i in range(m):
        for j in range(i):
            a[j, i] = a[i, j]


@njit(cache=True, nogil=True, error_model="numpy")
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
