"""Windows over a frame in scan order: a brick of cells and what was decoded around it.

A frame is kept in the coordinates of its scan: axis 0 is the slowest, and the scan runs along each axis the way the
force points, so from deep to shallow; components are turned alike. A cell has eight numbers: the vector, its length
(0: no force), the length that the force law makes likely one step on along each axis, and the sizes of its residual.
A cell of the reference has four: the vector and its length. The window holds 12 cells an axis, the brick's own from
`LOW` on, so that all that predicts a voxel is found at fixed distances, also across the brick's faces; what is not
known yet has length 0.
"""

from __future__ import annotations

import numpy as np

from touchfield.codec.touch.kernels.lattice import root
from touchfield.lean import inlined, lean

__all__ = [
    "AHEAD", "DEEP", "LEFT", "LENGTH", "LOW", "SIDE", "SIZES", "UP", "WIDTH", "copy_reference", "keep", "length_of",
    "load", "load_reference", "store",
]  # fmt: skip

SIDE, LOW = 12, 2
DEEP, UP, LEFT = SIDE * SIDE, SIDE, 1
"""Distances of the voxels before, along the three axes of the scan."""

WIDTH = 8
LENGTH, AHEAD, SIZES = 3, 4, 7
"""Places in a cell: the length, the three lengths ahead, the sizes of the residual."""


@lean
def length_of(v0, v1, v2):
    """|v| in whole units, at least 1."""
    return max(root(v0 * v0 + v1 * v1 + v2 * v2), np.int64(1))


@lean
def store(window, at, v0, v1, v2, a, sizes, slope):
    """Fill a cell: moving along the force by a sample a penalty field loses `slope` of its length."""
    c = at * WIDTH
    window[c] = v0
    window[c + 1] = v1
    window[c + 2] = v2
    window[c + 3] = a
    inverse = (np.int64(1) << 28) // a
    window[c + 4] = a - ((((v0 * inverse) >> 14) * slope[0]) >> 14)
    window[c + 5] = a - ((((v1 * inverse) >> 14) * slope[1]) >> 14)
    window[c + 6] = a - ((((v2 * inverse) >> 14) * slope[2]) >> 14)
    window[c + 7] = sizes


@inlined
def _copy(window, cells, slot, x0, x1, y0, y1, z0, z1, dx, dy, dz):
    """Cells of a brick at `slot` (none if below 0) into the window; dx .. dz: where that brick lies."""
    for x in range(x0, x1):
        for y in range(y0, y1):
            to = (((x + 8 * dx + LOW) * SIDE + y + 8 * dy + LOW) * SIDE + z0 + 8 * dz + LOW) * WIDTH
            if slot < 0:
                for z in range(z1 - z0):
                    window[to + z * WIDTH + LENGTH] = 0
            else:
                at = (x * 8 + y) * 8 + z0
                for z in range(z1 - z0):
                    for q in range(WIDTH):
                        window[to + z * WIDTH + q] = cells[slot, at + z, q]


@lean
def load(window, cells, near, n):
    """The halo of brick n: two cells deep before it, one behind, of the bricks that are decoded; `near` [n, 13]."""
    for s in range(13):
        dx, dy, dz = s // 9 - 1, s // 3 % 3 - 1, s % 3 - 1
        _copy(
            window, cells, near[n, s], 6 if dx < 0 else 0, 8, 6 if dy < 0 else 0, 1 if dy > 0 else 8,
            6 if dz < 0 else 0, 1 if dz > 0 else 8, dx, dy, dz,
        )  # fmt: skip
    # what comes later: of this brick, and beside it
    for x in range(LOW, LOW + 8):
        for y in range(LOW, LOW + 9):
            row = (x * SIDE + y) * SIDE
            first = LOW if y < LOW + 8 else 0
            for z in range(first, LOW + 9):
                window[(row + z) * WIDTH + LENGTH] = 0


@lean
def keep(window, cells, n):
    """The brick's own cells out of the window."""
    for x in range(8):
        for y in range(8):
            at = ((x + LOW) * SIDE + y + LOW) * SIDE + LOW
            for z in range(8):
                for q in range(WIDTH):
                    cells[n, (x * 8 + y) * 8 + z, q] = window[(at + z) * WIDTH + q]


@lean
def copy_reference(window, old, slope):
    """The brick as the reference has it."""
    for x in range(LOW, LOW + 8):
        for y in range(LOW, LOW + 8):
            for z in range(LOW, LOW + 8):
                at = (x * SIDE + y) * SIDE + z
                a = np.int64(old[at * 4 + 3])
                if a > 0:
                    v0, v1, v2 = np.int64(old[at * 4]), np.int64(old[at * 4 + 1]), np.int64(old[at * 4 + 2])
                    store(window, at, v0, v1, v2, a, np.int64(0), slope)


@lean
def load_reference(old, vectors, around, n):
    """Brick n of the reference and one cell around it; `around` [n, 27] holds its slots, below 0 for none."""
    for s in range(27):
        dx, dy, dz = s // 9 - 1, s // 3 % 3 - 1, s % 3 - 1
        slot = around[n, s]
        for x in range(7 if dx < 0 else 0, 1 if dx > 0 else 8):
            for y in range(7 if dy < 0 else 0, 1 if dy > 0 else 8):
                for z in range(7 if dz < 0 else 0, 1 if dz > 0 else 8):
                    to = (((x + 8 * dx + LOW) * SIDE + y + 8 * dy + LOW) * SIDE + z + 8 * dz + LOW) * 4
                    if slot < 0:
                        old[to + 3] = 0
                        continue
                    at = (x * 8 + y) * 8 + z
                    v0, v1 = np.int64(vectors[slot, at, 0]), np.int64(vectors[slot, at, 1])
                    v2 = np.int64(vectors[slot, at, 2])
                    old[to] = v0
                    old[to + 1] = v1
                    old[to + 2] = v2
                    a = np.int64(0)
                    if v0 != 0 or v1 != 0 or v2 != 0:
                        a = length_of(v0, v1, v2)
                    old[to + 3] = a
