"""The few planes of a sparse field that a raster pass looks at, dense and padded by two samples on each side.

A grid may have 10^9 samples, of which a surface takes few: three planes are held, in a ring, and only the patches
where bricks lie are ever cleared or filled.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from touchfield.codec.kernels.lean import LEAN
from touchfield.codec.kernels.touch_lattice import root

__all__ = ["PAD", "Planes", "fill_plane", "fresh_planes", "make_plane_empty"]

PAD = 2


class Planes(NamedTuple):
    """Three planes: vectors and their lengths, units, int32 [3, y, x, 4]; which z each is, int64 [3]."""

    vectors: np.ndarray
    held: np.ndarray


def fresh_planes(rows: int, columns: int) -> Planes:
    """Planes of `rows` by `columns` bricks, all empty."""
    shape = (3, 8 * rows + 2 * PAD, 8 * columns + 2 * PAD)
    return Planes(np.zeros((*shape, 4), np.int32), np.full(3, -9, np.int64))


@njit(**LEAN)
def make_plane_empty(planes, z, bricks, layers):
    """See to it that the ring holds plane `z`: if it holds another in its place, that is cleared.

    bricks : int32 [n, 3], (z, y, x), by layers; layers : int64 [m + 1], where each layer begins.
    """
    slot = z % 3
    old = planes.held[slot]
    if old == z:
        return
    if old >= 0:
        layer = old >> 3
        for n in range(layers[layer], layers[layer + 1]):
            y0 = 8 * np.int64(bricks[n, 1]) + PAD
            x0 = 8 * np.int64(bricks[n, 2]) + PAD
            for y in range(y0, y0 + 8):
                for x in range(x0, x0 + 8):
                    for c in range(4):
                        planes.vectors[slot, y, x, c] = 0
    planes.held[slot] = z


@njit(**LEAN)
def fill_plane(planes, z, bricks, layers, vectors):
    """Plane `z` of a field that is known, vectors int32 [n, 8, 8, 8, 3]."""
    slot = z % 3
    if planes.held[slot] == z:
        return
    make_plane_empty(planes, z, bricks, layers)
    if z < 0 or (z >> 3) + 1 >= layers.shape[0]:
        planes.held[slot] = -9
        return
    layer = z >> 3
    k = z & 7
    for n in range(layers[layer], layers[layer + 1]):
        y0 = 8 * np.int64(bricks[n, 1]) + PAD
        x0 = 8 * np.int64(bricks[n, 2]) + PAD
        for y in range(8):
            for x in range(8):
                a = np.int64(vectors[n, k, y, x, 0])
                b = np.int64(vectors[n, k, y, x, 1])
                c = np.int64(vectors[n, k, y, x, 2])
                planes.vectors[slot, y0 + y, x0 + x, 0] = a
                planes.vectors[slot, y0 + y, x0 + x, 1] = b
                planes.vectors[slot, y0 + y, x0 + x, 2] = c
                if a != 0 or b != 0 or c != 0:
                    planes.vectors[slot, y0 + y, x0 + x, 3] = max(np.int64(1), root(a * a + b * b + c * c))
