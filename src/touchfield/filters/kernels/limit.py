"""Compiled loops over the samples of bricks: the clip and the floor of the device filter, and depth pooling.

Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from touchfield.lean import entry
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["add_depths", "limited"]

_INSIDE = 1 - 2.0**-22  # so that rounding to float32 never lifts a clipped force above the limit


@entry
def _limited(begin, end, forces, force_max, floor, out, held):
    ceiling, bottom = force_max * force_max, floor * floor
    for n in range(begin, end):
        some = False
        for s in range(512):
            x, y, z = np.float64(forces[n, s, 0]), np.float64(forces[n, s, 1]), np.float64(forces[n, s, 2])
            square = x * x + y * y + z * z
            if square > ceiling:
                factor = force_max * _INSIDE / np.sqrt(square)
                x, y, z = x * factor, y * factor, z * factor
            elif square < bottom:
                x, y, z = np.float64(0), np.float64(0), np.float64(0)
            out[n, s, 0], out[n, s, 1], out[n, s, 2] = x, y, z
            if x != 0 or y != 0 or z != 0:
                some = True
        held[n] = some


def limited(
    forces_n: NDArray[np.float32], force_max_n: float, floor_n: float
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Forces [n, 8, 8, 8, 3] clipped to a length and dropped below another, and which bricks hold any."""
    out = np.empty_like(forces_n)
    held = np.zeros(len(forces_n), np.bool_)
    flat = (len(forces_n), 512, 3)
    for_chunks(
        _limited, len(forces_n), forces_n.reshape(flat), force_max_n, floor_n, out.reshape(flat), held, chunk=64
    )
    return out, held


@entry
def _add_depths(bricks, forces, greatest, total, count):
    for n in range(bricks.shape[0]):
        for i in range(8):
            for j in range(8):
                for k in range(8):
                    x, y, z = forces[n, i, j, k, 0], forces[n, i, j, k, 1], forces[n, i, j, k, 2]
                    if x != 0 or y != 0 or z != 0:
                        length = np.sqrt(np.float64(x) * x + np.float64(y) * y + np.float64(z) * z)
                        a, b = bricks[n, 0] * 8 + i, bricks[n, 1] * 8 + j
                        greatest[a, b] = max(greatest[a, b], length)
                        total[a, b] += length
                        count[a, b] += 1


def add_depths(
    bricks: NDArray[np.int32],
    forces_n: NDArray[np.float32],
    greatest_n: NDArray[np.float64],
    total_n: NDArray[np.float64],
    count: NDArray[np.int64],
) -> None:
    """Take the bricks into three images [x, y]: the greatest |F| of each column, the sum, and how many forces."""
    _add_depths(bricks, forces_n, greatest_n, total_n, count)
