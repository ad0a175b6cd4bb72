"""Compiled loop of the nearest vertex of a direction codebook."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from touchfield.codec.kernels.lean import entry
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["nearest"]

_PIECE = 1 << 12


@entry
def _nearest(begin, end, vectors, vertices, out):
    for i in range(begin, end):
        x, y, z = np.float64(vectors[i, 0]), np.float64(vectors[i, 1]), np.float64(vectors[i, 2])
        best, winner = -np.inf, 0
        for j in range(vertices.shape[1]):
            dot = vertices[0, j] * x + vertices[1, j] * y + vertices[2, j] * z
            if dot > best:
                best, winner = dot, j
        out[i] = winner


def nearest(vectors: NDArray[np.float32], vertices: NDArray[np.float64], out: NDArray[np.uint16]) -> None:
    """Fill uint16 [m] with the first of the vertices [3, n] of largest dot product for finite float32 [m, 3]."""
    for_chunks(_nearest, len(vectors), vectors, vertices, out, chunk=_PIECE)
