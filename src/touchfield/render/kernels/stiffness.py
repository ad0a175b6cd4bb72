"""Compiled: how steep the forces of a field are, counted over its cells."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from touchfield.medium.kernels.cell import CELLS
from touchfield.render.kernels.lookup import slopes

__all__ = ["BINS", "count_slopes", "slope_of_bin"]

BINS = 400
_PER_DOUBLING = 20.0
_1, _2 = np.uint64(1), np.uint64(2)


def slope_of_bin(n: int) -> float:
    """The greatest slope of a bin, N/m; from 1 to a million."""
    return float(2.0 ** ((n + 1) / _PER_DOUBLING))


@njit(cache=True, nogil=True)
def count_slopes(cells, held, inverse, counts):
    """Count the cells of a pool by what their force grows with a way against it, -n J n in the middle, N/m.

    Parameters
    ----------
    cells : float32 [n * 729 * 3]
    held : uint64 [n, 8]
    inverse : float64 [3]
        One by the spacing, 1/m.
    counts : int64 [BINS]
        Added to; cells whose force falls with such a way are none of them.
    """
    for slot in range(len(held)):
        for n in range(512):
            if not (held[slot, n >> 6] >> np.uint64(n & 63)) & _1:
                continue
            o = np.uint64(slot * CELLS + (n >> 6) * 243 + ((n >> 3) & 7) * 27 + (n & 7) * 3)
            fx, fy, fz = _middle(cells, o), _middle(cells, o + _1), _middle(cells, o + _2)
            square = fx * fx + fy * fy + fz * fz
            if not 0.0 < square < math.inf:
                continue
            a, b, c = (
                slopes(cells, o, 0.5, 0.5, 0.5),
                slopes(cells, o + _1, 0.5, 0.5, 0.5),
                slopes(cells, o + _2, 0.5, 0.5, 0.5),
            )
            hx, hy, hz = fx * inverse[0], fy * inverse[1], fz * inverse[2]
            along = fx * (a[0] * hx + a[1] * hy + a[2] * hz) + fy * (b[0] * hx + b[1] * hy + b[2] * hz)
            along += fz * (c[0] * hx + c[1] * hy + c[2] * hz)
            if along < -square:
                counts[min(int(_PER_DOUBLING * math.log2(-along / square)), BINS - 1)] += 1


@njit(nogil=True, forceinline=True)
def _middle(cells, o):
    """The mean of the eight corners."""
    total = 0.0
    for c in range(8):
        total += cells[o + np.uint64(243 * (c >> 2) + 27 * ((c >> 1) & 1) + 3 * (c & 1))]
    return total / 8.0
