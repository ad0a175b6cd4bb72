"""Sums of rows of numbers: the inner loop of the separable filters, which all three passes share.

All sums of a sample are made in one fixed order that depends on where the sample lies and on the numbers around it,
never on the threads. Long inner loops over contiguous floats are what makes it fast: every pass adds whole rows
along z, four mirrored pairs of rows at a time. Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Taps = tuple[NDArray[np.int64], NDArray[np.float32]]

__all__ = ["cleared", "copied", "sums"]

# Rows are named by where they begin in a flat array: a slice of an array costs numba a count of references, which
# is an atomic instruction, and offsets without a sign cost it no test for being counted from the end.


@njit(cache=True, nogil=True)
def copied(out, o, flat, p, n):
    o, p = np.uint64(o), np.uint64(p)
    for r in range(np.uint64(n)):
        out[o + r] = flat[p + r]


@njit(cache=True, nogil=True)
def cleared(out, o, n):
    o = np.uint64(o)
    for r in range(np.uint64(n)):
        out[o + r] = 0


@njit(cache=True, nogil=True)
def _scaled(out, o, flat, p, w, n):
    o, p = np.uint64(o), np.uint64(p)
    for r in range(np.uint64(n)):
        out[o + r] = w * flat[p + r]


@njit(cache=True, nogil=True)
def _added(out, o, flat, p, w, n):
    o, p = np.uint64(o), np.uint64(p)
    for r in range(np.uint64(n)):
        out[o + r] += w * flat[p + r]


@njit(cache=True, nogil=True)
def _four_pairs_and_one(out, o, flat, c, v, p, q, w, n):
    """The row at `c` and four pairs, in place of what was there; `p`, `q` and `w` are tuples of four."""
    o, c = np.uint64(o), np.uint64(c)
    a0, a1, a2, a3 = np.uint64(p[0]), np.uint64(p[1]), np.uint64(p[2]), np.uint64(p[3])
    b0, b1, b2, b3 = np.uint64(q[0]), np.uint64(q[1]), np.uint64(q[2]), np.uint64(q[3])
    w0, w1, w2, w3 = w
    for r in range(np.uint64(n)):
        first = w0 * (flat[a0 + r] + flat[b0 + r]) + w1 * (flat[a1 + r] + flat[b1 + r])
        second = w2 * (flat[a2 + r] + flat[b2 + r]) + w3 * (flat[a3 + r] + flat[b3 + r])
        out[o + r] = v * flat[c + r] + (first + second)


@njit(cache=True, nogil=True)
def _four_pairs_added(out, o, flat, p, q, w, n):
    """`p`, `q` and `w` are tuples of four."""
    o = np.uint64(o)
    a0, a1, a2, a3 = np.uint64(p[0]), np.uint64(p[1]), np.uint64(p[2]), np.uint64(p[3])
    b0, b1, b2, b3 = np.uint64(q[0]), np.uint64(q[1]), np.uint64(q[2]), np.uint64(q[3])
    w0, w1, w2, w3 = w
    for r in range(np.uint64(n)):
        first = w0 * (flat[a0 + r] + flat[b0 + r]) + w1 * (flat[a1 + r] + flat[b1 + r])
        out[o + r] += first + (w2 * (flat[a2 + r] + flat[b2 + r]) + w3 * (flat[a3 + r] + flat[b3 + r]))


@njit(cache=True, nogil=True)
def sums(out, flat, table, jobs, count, places, weights, nothing):
    """Rows of sums, as `jobs` [count, 4] says: where in `out`, how many numbers, the first row, where in the rows.

    Row m of the input begins at ``flat[table[m]]``. `places` and `weights` are `Taps`; places count from the first
    row of the job. `nothing` is the `table` of a row of zeros, which must be there to be read, as the last.
    """
    alone, pairs = places[0], places[1]
    for job in range(count):
        o, n, i, at = jobs[job, 0], jobs[job, 1], jobs[job, 2], jobs[job, 3]
        k = 2 + alone
        together = alone > 0 and pairs >= 4
        if not together and alone > 0:
            _scaled(out, o, flat, table[i + places[2]] + at, weights[2], n)
        elif not together:
            cleared(out, o, n)
        while k + 4 <= 2 + alone + pairs:
            p0, q0 = table[i + places[k]], table[i + places[k + pairs]]
            p1, q1 = table[i + places[k + 1]], table[i + places[k + 1 + pairs]]
            p2, q2 = table[i + places[k + 2]], table[i + places[k + 2 + pairs]]
            p3, q3 = table[i + places[k + 3]], table[i + places[k + 3 + pairs]]
            some = min(min(min(p0, q0), min(p1, q1)), min(min(p2, q2), min(p3, q3))) < nothing
            if some or together:
                p, q = (p0 + at, p1 + at, p2 + at, p3 + at), (q0 + at, q1 + at, q2 + at, q3 + at)
                w = (weights[k], weights[k + 1], weights[k + 2], weights[k + 3])
                if together:
                    _four_pairs_and_one(out, o, flat, table[i + places[2]] + at, weights[2], p, q, w, n)
                    together = False
                else:
                    _four_pairs_added(out, o, flat, p, q, w, n)
            k += 4
        for m in range(k, 2 + alone + pairs):
            _added(out, o, flat, table[i + places[m]] + at, weights[m], n)
            _added(out, o, flat, table[i + places[m + pairs]] + at, weights[m], n)
        for m in range(3, 2 + alone):
            _added(out, o, flat, table[i + places[m]] + at, weights[m], n)
