"""Compiled inner loops of force fields: list bricks, and interpolate the force at a point for other kernels.

Import this package only where it is used, since it imports numba.
"""

from __future__ import annotations

import numpy as np

from touchfield.compute.coder_jit import entry
from touchfield.compute.jit import inner


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
