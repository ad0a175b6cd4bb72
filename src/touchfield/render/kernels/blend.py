"""Compiled: voxels on their way from one field to the next."""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.medium.grid import BRICK

__all__ = ["blend_bricks"]


@njit(cache=True, nogil=True)
def blend_bricks(begin, end, slots, before, after, share, k, f0_n, out, held):
    """Bricks begin to end - 1 of `out` float32 [n, 1536]: `share` of the way from `before` to `after`.

    `slots` int64 [2, n] are the bricks of both (float32 [m, 1536]), -1 where there is none. A voxel whose two forces
    cannot be of one source, |after - before| > max(F_0, k |after|) + max(F_0, k |before|), is that of `after`. `held`
    bool [n] tells which bricks hold a force.
    """
    near = 4.0 * f0_n * f0_n  # any two so near can be of one source
    zero = np.float32(0.0)
    for brick in range(begin, end):
        old, new = slots[0, brick], slots[1, brick]
        any_force = False
        for at in range(0, 3 * BRICK**3, 3):
            px = before[old, at] if old >= 0 else zero
            py = before[old, at + 1] if old >= 0 else zero
            pz = before[old, at + 2] if old >= 0 else zero
            nx = after[new, at] if new >= 0 else zero
            ny = after[new, at + 1] if new >= 0 else zero
            nz = after[new, at + 2] if new >= 0 else zero
            dx, dy, dz = float(nx) - px, float(ny) - py, float(nz) - pz
            between = dx * dx + dy * dy + dz * dz
            taken = between > 0.0
            if between > near:
                of_old = np.sqrt(float(px) * px + float(py) * py + float(pz) * pz)
                of_new = np.sqrt(float(nx) * nx + float(ny) * ny + float(nz) * nz)
                reach = max(f0_n, k * of_old) + max(f0_n, k * of_new)
                taken = between <= reach * reach
            if taken:
                nx, ny, nz = np.float32(px + share * dx), np.float32(py + share * dy), np.float32(pz + share * dz)
            out[brick, at], out[brick, at + 1], out[brick, at + 2] = nx, ny, nz
            any_force |= (nx != zero) | (ny != zero) | (nz != zero)
        held[brick] = any_force
