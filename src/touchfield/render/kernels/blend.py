"""Compiled: voxels on their way from one field to the next."""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.medium.grid import BRICK

__all__ = ["blend_bricks"]


@njit(cache=True, nogil=True)
def blend_bricks(begin, end, slots, before, after, share, k, f0_n, out, held):
    """Bricks begin to end - 1 of `out` float32 [n, 8, 8, 8, 3]: `share` of the way from `before` to `after`.

    `slots` int64 [2, n] are the bricks of both, -1 where there is none. A voxel whose two forces cannot be of one
    source, |after - before| > max(F_0, k |after|) + max(F_0, k |before|), is that of `after`. `held` bool [n] tells
    which bricks hold a force.
    """
    p, n = np.zeros(3), np.zeros(3)
    for brick in range(begin, end):
        old, new = slots[0, brick], slots[1, brick]
        any_force = False
        for x in range(BRICK):
            for y in range(BRICK):
                for z in range(BRICK):
                    of_old = of_new = between = 0.0
                    for c in range(3):
                        p[c] = before[old, x, y, z, c] if old >= 0 else 0.0
                        n[c] = after[new, x, y, z, c] if new >= 0 else 0.0
                        of_old += p[c] * p[c]
                        of_new += n[c] * n[c]
                        between += (n[c] - p[c]) ** 2
                    reach = max(f0_n, k * np.sqrt(of_old)) + max(f0_n, k * np.sqrt(of_new))
                    taken = share if between <= reach * reach else 1.0
                    for c in range(3):
                        force = np.float32(p[c] + taken * (n[c] - p[c])) if taken < 1.0 else np.float32(n[c])
                        out[brick, x, y, z, c] = force
                        any_force |= force != 0.0
        held[brick] = any_force
