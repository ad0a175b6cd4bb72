"""Cells, the working storage of the light models of coder `touch`: three planes across the slowest axis of the scan.

A cell is eight numbers: the vector, its amplitude (0: no force), the sizes of its residual, and the amplitude that it
makes likely one step on along each axis of the scan (``a - slope * F_c / |F|``: a penalty field loses amplitude where
one moves along the force). A cell of the reference is four: the vector and the sum of its absolute components.
"""

from __future__ import annotations

import numpy as np

from touchfield.codec.kernels.touch_lattice import root
from touchfield.codec.kernels.touch_light_coder import lean

__all__ = ["amplitude", "clear", "held", "length_of", "load", "store"]


@lean
def length_of(v0, v1, v2):
    """|v| in whole units."""
    return root(v0 * v0 + v1 * v1 + v2 * v2)


@lean
def amplitude(cells, at):
    """The amplitude in a cell."""
    return np.int64(cells[np.uint64(at * 8 + 3)])


@lean
def held(cells, at):
    """Whether a cell holds a force, 0 or 1."""
    return np.int64(cells[np.uint64(at * 8 + 3)] > 0)


@lean
def store(cells, at, v0, v1, v2, a, sizes, slope):
    """Fill a cell."""
    c = np.uint64(at * 8)
    cells[c] = v0
    cells[c + np.uint64(1)] = v1
    cells[c + np.uint64(2)] = v2
    cells[c + np.uint64(3)] = a
    cells[c + np.uint64(4)] = sizes
    inverse = (np.int64(1) << 28) // a
    for way in range(3):
        v = v0 if slope[3 + way] == 0 else (v1 if slope[3 + way] == 1 else v2)
        cells[c + np.uint64(5 + way)] = a - ((((v * inverse) >> 14) * slope[way]) >> 14)


@lean
def clear(cells, row, pitch):
    """Empty the cells of a tile."""
    for j in range(8):
        for at in range((row + j * pitch) * 8, (row + j * pitch + 8) * 8):
            cells[np.uint64(at)] = 0


@lean
def load(old, row, pitch, vectors, slot, begin, stride):
    """A tile of the reference into its cells; whether it holds anything."""
    any_set = np.int64(0)
    for j in range(8):
        for k in range(8):
            at = np.uint64((row + j * pitch + k) * 4)
            if slot < 0:
                old[at + np.uint64(3)] = 0
                continue
            s = np.uint64(begin + j * stride[1] + k * stride[2])
            v0, v1, v2 = vectors[s, 0], vectors[s, 1], vectors[s, 2]
            old[at] = v0
            old[at + np.uint64(1)] = v1
            old[at + np.uint64(2)] = v2
            size = abs(v0) + abs(v1) + abs(v2)
            old[at + np.uint64(3)] = size
            any_set |= size
    return np.int64(any_set > 0)
