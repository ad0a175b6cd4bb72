"""The nearest vertex of a direction codebook, by a table over the octahedral map (`codec.paper.directions`)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["nearest"]

_PIECE = 1 << 14


@njit(cache=True, nogil=True)
def _nearest(begin, end, vectors, vertices, starts, lists, side, out):
    for i in range(begin, end):
        x, y, z = np.float64(vectors[i, 0]), np.float64(vectors[i, 1]), np.float64(vectors[i, 2])
        total = abs(x) + abs(y) + abs(z)
        if total == 0.0:
            out[i] = 0
            continue
        px, py = x / total, y / total
        u = math.copysign(1.0 - abs(py), px) if z < 0.0 else px
        v = math.copysign(1.0 - abs(px), py) if z < 0.0 else py
        a = min(int((u + 1.0) * (side * 0.5)), side - 1)
        b = min(int((v + 1.0) * (side * 0.5)), side - 1)
        cell = a * side + b
        winner = lists[starts[cell]]
        if starts[cell + 1] - starts[cell] > 1:
            best = -math.inf
            for m in range(starts[cell], starts[cell + 1]):
                j = lists[m]
                dot = vertices[j, 0] * x + vertices[j, 1] * y + vertices[j, 2] * z
                if dot > best:
                    best, winner = dot, j
        out[i] = winner


def nearest(
    vectors: NDArray[np.float32],
    vertices: NDArray[np.float64],
    starts: NDArray[np.int32],
    lists: NDArray[np.int32],
    out: NDArray[np.uint16],
) -> None:
    """Fill uint16 [m] with the vertices of largest dot product for finite float32 [m, 3]."""
    side = math.isqrt(len(starts) - 1)
    for_chunks(_nearest, len(vectors), vectors, vertices, starts, lists, np.int64(side), out, chunk=_PIECE)
