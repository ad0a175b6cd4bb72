"""Compiled inner loop of an array's filter: it reduces the forces along the depth to one value for each
actuator.

The points of an image column differ along z only. The pooling therefore interpolates a stored field between
the four surrounding columns once per stored depth, and linearly along z between those depths. All sums are in
float64. Imported only when first needed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from touchfield.arrays import Float64s
from touchfield.compute.jit import kernel
from touchfield.compute.threads import for_chunks

if TYPE_CHECKING:
    from touchfield.medium import ForceField, Grid

_COLUMNS_AT_ONCE = 256


@kernel(error_model="numpy")
def _pool(start, stop, indices, counts, slots, forces, out):
    nx, ny, nz = counts[0], counts[1], counts[2]
    x_at, y_at, z_at = indices
    rows = len(y_at)
    column = np.zeros((nz + 2, 3), np.float64)  # with a depth of nothing at both ends
    has_force = np.zeros(nz + 2, np.bool_)
    low, fraction = np.empty(len(z_at), np.int64), np.empty(len(z_at), np.float64)
    for m in range(len(z_at)):
        low[m] = min(max(int(np.floor(z_at[m])), -2), nz)
        fraction[m] = z_at[m] - low[m]
    for n in range(start, stop):
        x, y = x_at[n // rows], y_at[n % rows]
        i0, j0 = int(np.floor(x)), int(np.floor(y))
        column[:] = 0.0
        has_force[:] = False
        is_any = False
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
                            has_force[at] = is_any = True
                            column[at, 0] += w * fx
                            column[at, 1] += w * fy
                            column[at, 2] += w * fz
        if not is_any:
            continue
        greatest, total, count = 0.0, 0.0, 0
        for m in range(len(z_at)):
            at, after = low[m] + 1, fraction[m]
            if at < 0 or at > nz or not (has_force[at] or has_force[at + 1]):
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
                out[n, 2], out[n, 3] = out[n, 2] if count > 1 else m + 1, m + 1
        out[n, 0] = np.sqrt(greatest)
        out[n, 1] = total / max(count, 1)


def pool_depth(stored: ForceField, target: Grid) -> Float64s:
    """Pool |F| along each column of a grid: maximum, mean over supported samples, first and last of them.

    Returns float64 [4, x, y]; samples are numbered from 1, and 0 stands for a column without a force.
    """
    grid = stored.grid
    x, y, z = ((target.axis_m(axis) - grid.origin_m[axis]) / grid.spacing_m[axis] for axis in range(3))
    slots = np.full(grid.brick_shape, -1, np.int64)
    slots[tuple(stored.bricks.T)] = np.arange(len(stored.bricks))
    out = np.zeros((len(x) * len(y), 4))
    arguments = ((x, y, z), np.array(grid.shape, np.int64), slots, stored.forces_n, out)
    for_chunks(_pool, len(out), *arguments, chunk=_COLUMNS_AT_ONCE)
    return np.moveaxis(out.reshape(len(x), len(y), 4), 2, 0)
