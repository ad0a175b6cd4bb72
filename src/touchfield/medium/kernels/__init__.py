"""Compiled inner loops of force fields: list the samples with a force in order, and interpolate the force at
a point.

Import this package only where it is used, since it imports numba.
"""

from __future__ import annotations

import numpy as np

from touchfield.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from touchfield.compute.coder_jit import entry
from touchfield.compute.jit import inner, kernel
from touchfield.medium.grid import Grid


@inner
def lower_bound(keys, key):
    """Return what `numpy.searchsorted` does, which takes longer to compile."""
    low, high = 0, keys.shape[0]
    while low < high:
        middle = (low + high) >> 1
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low


@entry
def reached(spans, brick_shape, out):
    """Write the keys of the bricks of each box to `out`.

    `spans` int64 [n, 3, 2] holds the start and stop of each box along each axis, in bricks.
    """
    count = 0
    for n in range(spans.shape[0]):
        for i in range(spans[n, 0, 0], spans[n, 0, 1]):
            for j in range(spans[n, 1, 0], spans[n, 1, 1]):
                for k in range(spans[n, 2, 0], spans[n, 2, 1]):
                    out[count] = (i * brick_shape[1] + j) * brick_shape[2] + k
                    count += 1


@kernel
def _raster_slots(bricks, mask, out):
    n = bricks.shape[0]
    count = 0
    x0 = 0
    while x0 < n:  # one slab of bricks with the same x
        x1 = x0
        while x1 < n and bricks[x1, 0] == bricks[x0, 0]:
            x1 += 1
        for i in range(8):
            y0 = x0
            while y0 < x1:  # one row of bricks with the same x and y
                y1 = y0
                while y1 < x1 and bricks[y1, 1] == bricks[y0, 1]:
                    y1 += 1
                for j in range(8):
                    for s in range(y0, y1):
                        for k in range(8):
                            if mask[s, i, j, k]:
                                out[count] = s * 512 + i * 64 + j * 8 + k
                                count += 1
                y0 = y1
        x0 = x1
    return count


def raster_slots(bricks: Int32s, mask: Bools) -> Int64s:
    """Return the indices of the samples of `mask` in an array [n * 512], int64 [L].

    They are in raster order of the grid. `bricks` are int32 [n, 3], ascending, `mask` is bool [n, 8, 8, 8].
    """
    out = np.empty(int(np.count_nonzero(mask)), np.int64)
    _raster_slots(bricks, mask, out)
    return out


@inner
def force_at(x, y, z, shape, brick_shape, keys, forces, total):
    """Write the force at a position, in samples, to `total`.

    `keys` are the ascending keys of the bricks of `forces`.
    """
    total[:] = 0.0
    if -1.0 < x < shape[0] and -1.0 < y < shape[1] and -1.0 < z < shape[2]:
        x0, y0, z0 = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
        for i in range(max(x0, 0), min(x0 + 2, shape[0])):
            wx = x - x0 if i > x0 else 1.0 - (x - x0)
            for j in range(max(y0, 0), min(y0 + 2, shape[1])):
                wy = wx * (y - y0 if j > y0 else 1.0 - (y - y0))
                for k in range(max(z0, 0), min(z0 + 2, shape[2])):
                    w = wy * (z - z0 if k > z0 else 1.0 - (z - z0))
                    key = ((i >> 3) * brick_shape[1] + (j >> 3)) * brick_shape[2] + (k >> 3)
                    slot = lower_bound(keys, key) if w != 0.0 else keys.shape[0]
                    if slot < keys.shape[0] and keys[slot] == key:
                        for c in range(3):
                            total[c] += w * forces[slot, i & 7, j & 7, k & 7, c]


@kernel
def _sample(index, shape, brick_shape, keys, forces, out):
    total = np.zeros(3)
    for p in range(index.shape[0]):
        force_at(index[p, 0], index[p, 1], index[p, 2], shape, brick_shape, keys, forces, total)
        for c in range(3):
            out[p, c] = total[c]


def sample(index: Float64s, grid: Grid, keys: Int64s, forces_n: Float32s) -> Float32s:
    """See `ForceField.sample_n`; `index` float64 [m, 3] in samples."""
    out = np.empty((len(index), 3), np.float32)
    _sample(index, np.array(grid.shape), np.array(grid.brick_shape), keys, forces_n, out)
    return out
