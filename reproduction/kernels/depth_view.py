"""Compiled inner loops that draw a depth map, as triangles, from the viewpoint of another camera."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from touchfield.compute.jit import inner, kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64s = NDArray[np.float64]

__all__ = ["draw_quads"]


@inner
def _draw_triangle(a, b, c, inverse):
    """One triangle of rows (u, v, 1 / z) into the buffer of inverse depths; the nearest surface stays."""
    height, width = inverse.shape
    area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
    if abs(area) < 1e-12:
        return
    low_u, high_u = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
    low_v, high_v = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
    if high_u < 0 or high_v < 0 or low_u > width - 1 or low_v > height - 1:
        return
    for row in range(max(0, int(np.ceil(low_v))), min(height - 1, int(np.floor(high_v))) + 1):
        for column in range(max(0, int(np.ceil(low_u))), min(width - 1, int(np.floor(high_u))) + 1):
            at_b = ((column - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (row - a[1])) / area
            at_c = ((b[0] - a[0]) * (row - a[1]) - (column - a[0]) * (b[1] - a[1])) / area
            if at_b < -1e-9 or at_c < -1e-9 or at_b + at_c > 1 + 1e-9:
                continue
            # over a plane the inverse depth is linear in the pixel
            w = a[2] + at_b * (b[2] - a[2]) + at_c * (c[2] - a[2])
            inverse[row, column] = max(inverse[row, column], w)


@kernel
def draw_quads(corners: Float64s, whole: NDArray[np.bool_], inverse: Float64s) -> None:
    """Two triangles for each square of four neighbouring pixels.

    Parameters
    ----------
    corners : float64 [height, width, 3]
        u, v and inverse depth of each pixel as the other camera sees it, pixels and 1/m.
    whole : bool [height - 1, width - 1]
        Whether a square is one surface.
    inverse : float64 [height, width]
        Inverse depth, 1/m; 0 where nothing was drawn.
    """
    for i in range(whole.shape[0]):
        for j in range(whole.shape[1]):
            if whole[i, j]:
                _draw_triangle(corners[i, j], corners[i, j + 1], corners[i + 1, j], inverse)
                _draw_triangle(corners[i + 1, j + 1], corners[i + 1, j], corners[i, j + 1], inverse)
