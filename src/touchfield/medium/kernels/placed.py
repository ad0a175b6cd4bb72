"""Compiled inner functions of queries on a GPU: interpolation in cells, and the limit of a sum of forces.

The fields are stored as *cells*: each brick of 8^3 samples is stored with the first samples of the next
bricks, 9^3 samples in all, so that the eight samples around any point are in one brick of cells. Bricks of
cells are found through a hash table.
"""

from __future__ import annotations

import math

import numpy as np

from touchfield.compute.jit import inner

INSIDE = 1 - 2.0**-22  # rounding to float32 then never raises a clipped force above the limit

CELLS = 9 * 9 * 9 * 3  # numbers of a brick of cells
GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # Fibonacci hashing (Knuth, volume 3, section 6.4)

Z, Y, X = np.uint64(3), np.uint64(27), np.uint64(243)
YZ, XZ, XY, XYZ = Y + Z, X + Z, X + Y, X + Y + Z  # unsigned, so that indices are not tested for their sign


@inner(forceinline=True)
def between(cells, o, fx, fy, fz):
    """Interpolate one component trilinearly in float64; its first corner is at index `o`."""
    a, b = np.float64(cells[o]), np.float64(cells[o + Y])
    c, d = np.float64(cells[o + X]), np.float64(cells[o + XY])
    a += fz * (np.float64(cells[o + Z]) - a)
    b += fz * (np.float64(cells[o + YZ]) - b)
    c += fz * (np.float64(cells[o + XZ]) - c)
    d += fz * (np.float64(cells[o + XYZ]) - d)
    a += fy * (b - a)
    c += fy * (d - c)
    return a + fx * (c - a)


@inner(forceinline=True)
def clipped(x, y, z, limit):
    """Clip a sum of forces to the magnitude `limit`; its direction is unchanged."""
    square = x * x + y * y + z * z
    if not square < np.inf:  # a force that overflowed has no direction
        return 0.0, 0.0, 0.0
    if square > limit * limit:
        factor = limit * INSIDE / math.sqrt(square)
        return x * factor, y * factor, z * factor
    return x, y, z
