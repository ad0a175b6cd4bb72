"""Compiled loop of the nearest vertex of a direction codebook."""

from __future__ import annotations

import numpy as np

from touchfield.lean import entry

__all__ = ["nearest"]


@entry
def nearest(begin, end, vectors, vertices, out):
    """Fill uint16 [m] with the first of the vertices [3, n] of largest dot product for finite float32 [m, 3]."""
    for i in range(begin, end):
        x, y, z = np.float64(vectors[i, 0]), np.float64(vectors[i, 1]), np.float64(vectors[i, 2])
        best, winner = -np.inf, 0
        for j in range(vertices.shape[1]):
            dot = vertices[0, j] * x + vertices[1, j] * y + vertices[2, j] * z
            if dot > best:
                best, winner = dot, j
        out[i] = winner
