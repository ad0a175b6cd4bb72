"""Samples of a field in bricks, by the compiled module: forces between them, and their order in the grid."""

from __future__ import annotations

import numpy as np

from touchfield.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from touchfield.compute.native import native
from touchfield.medium.grid import Grid


def sample(index: Float64s, grid: Grid, keys: Int64s, forces_n: Float32s) -> Float32s:
    """Interpolate forces at positions in samples, float64 [m, 3]: newtons, float32 [m, 3].

    `keys` int64 [n] are those of the bricks, ascending, of `forces_n` float32 [n, 8, 8, 8, 3]. See
    `ForceField.sample_n`.
    """
    out = np.empty((len(index), 3), np.float32)
    contiguous = np.ascontiguousarray
    native.sample_field(contiguous(index), grid.shape, contiguous(keys), contiguous(forces_n), out)
    return out


def raster_slots(bricks: Int32s, mask: Bools) -> Int64s:
    """Return the indices of the samples of `mask` in an array [n * 512], int64 [L].

    They are in raster order of the grid. `bricks` are int32 [n, 3], ascending, `mask` is bool [n, 8, 8, 8].
    """
    out = np.empty(int(np.count_nonzero(mask)), np.int64)
    native.raster_slots(np.ascontiguousarray(bricks), np.ascontiguousarray(mask), out)
    return out
