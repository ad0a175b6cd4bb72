"""Compiled: within one cell, whose eight corners lie in one place (`touchfield.medium.cells`)."""

from __future__ import annotations

import numpy as np
from numba import njit

CELLS = 9 * 9 * 9 * 3
"""Numbers of a brick of cells."""

GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # Fibonacci hashing (Knuth, volume 3, section 6.4)

Z, Y, X = np.uint64(3), np.uint64(27), np.uint64(243)
YZ, XZ, XY, XYZ = Y + Z, X + Z, X + Y, X + Y + Z  # unsigned, so that no index is looked at for its sign


@njit(nogil=True, forceinline=True)
def between(cells, o, fx, fy, fz):
    """Trilinear interpolation in float64 of one component, whose first corner lies at `o`."""
    a, b = np.float64(cells[o]), np.float64(cells[o + Y])
    c, d = np.float64(cells[o + X]), np.float64(cells[o + XY])
    a += fz * (np.float64(cells[o + Z]) - a)
    b += fz * (np.float64(cells[o + YZ]) - b)
    c += fz * (np.float64(cells[o + XZ]) - c)
    d += fz * (np.float64(cells[o + XYZ]) - d)
    a += fy * (b - a)
    c += fy * (d - c)
    return a + fx * (c - a)
