"""Compiled pooling of a stored field along its depth, for arrays of actuators.

A column of the image asks for the field at points that differ along z only: its forces are made between the four
columns of samples around it once for each stored depth, and the points in between are linear along z.

Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import ForceField, Grid

__all__ = ["pooled"]

_COLUMNS_AT_ONCE = 256


@njit(cache=True, nogil=True, error_model="numpy")
def _pool(begin, end, places, counts, slots, forces, out):
    nx, ny, nz = counts[0], counts[1], counts[2]
    x_at, y_at, z_at = places
    rows = len(y_at)
    column = np.zeros((nz + 2, 3), np.float64)  # with a depth of nothing at both ends
    some = np.zeros(nz + 2, np.bool_)
    low, share = np.empty(len(z_at), np.int64), np.empty(len(z_at), np.float64)
    for m in range(len(z_at)):
        low[m] = min(max(int(np.floor(z_at[m])), -2), nz)
        share[m] = z_at[m] - low[m]
    for n in range(begin, end):
        x, y = x_at[n // rows], y_at[n % rows]
        i0, j0 = int(np.floor(x)), int(np.floor(y))
        column[:] = 0.0
        some[:] = False
        any_held = False
        for a in range(2):
            i, wx = i0 + a, (x - i0 if a else 1.0 - (x - i0))
            if i < 0 or i >= nx or wx == 0.0:
                continue
            for b in range(2):
                j, wy = j0 + b, (y - j0 if b else 1.0 - (y - j0))
                if j < 0 or j >= ny or wy == 0.0:
                    continue
                w = wx * wy
                for c in range(slots.shape[2]):
                    slot = slots[i >> 3, j >> 3, c]
                    if slot < 0:
                        continue
                    for k in range(min(8, nz - 8 * c)):
                        fx = forces[slot, i & 7, j & 7, k, 0]
                        fy = forces[slot, i & 7, j & 7, k, 1]
                        fz = forces[slot, i & 7, j & 7, k, 2]
                        if fx != 0 or fy != 0 or fz != 0:
                            at = 8 * c + k + 1
                            some[at] = any_held = True
                            column[at, 0] += w * fx
                            column[at, 1] += w * fy
                            column[at, 2] += w * fz
        if not any_held:
            continue
        greatest, total, count = 0.0, 0.0, 0
        for m in range(len(z_at)):
            at, after = low[m] + 1, share[m]
            if at < 0 or at > nz or not (some[at] or some[at + 1]):
                continue
            before = 1.0 - after
            px = np.float32(before * column[at, 0] + after * column[at + 1, 0])
            py = np.float32(before * column[at, 1] + after * column[at + 1, 1])
            pz = np.float32(before * column[at, 2] + after * column[at + 1, 2])
            square = np.float64(px) * px + np.float64(py) * py + np.float64(pz) * pz
            if square > 0.0:
                greatest = max(greatest, square)
                total += np.sqrt(square)
                count += 1
        out[n, 0] = np.sqrt(greatest)
        out[n, 1] = total / max(count, 1)


def pooled(stored: ForceField, asked: Grid) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The greatest |F| along z, and the mean of those that are there, newtons, float64 [x, y] each.

    asked : Grid; at whose points the field is looked up; metres of `stored`.
    """
    grid = stored.grid
    x, y, z = ((asked.axis_m(axis) - grid.origin_m[axis]) / grid.spacing_m[axis] for axis in range(3))
    slots = np.full(grid.brick_shape, -1, np.int64)
    slots[tuple(stored.bricks.T)] = np.arange(len(stored.bricks))
    out = np.zeros((len(x) * len(y), 2))
    given = ((x, y, z), np.array(grid.shape, np.int64), slots, stored.forces_n, out)
    for_chunks(_pool, len(out), *given, chunk=_COLUMNS_AT_ONCE)
    greatest, mean = out.reshape(len(x), len(y), 2).transpose(2, 0, 1)
    return greatest, mean
