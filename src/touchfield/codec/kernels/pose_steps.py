"""Compiled loops over the bricks of a field: how steep it is, how far it reaches and how strong it is."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

__all__ = ["field_bounds"]


@njit(cache=True, nogil=True)
def _largest_eigenvalue(xx, yy, zz, xy, xz, yz):
    """Of a symmetric 3 x 3 matrix, by the trigonometric solution of its cubic."""
    mean = (xx + yy + zz) / 3.0
    dx, dy, dz = xx - mean, yy - mean, zz - mean
    spread = math.sqrt((dx * dx + dy * dy + dz * dz + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0)
    if spread <= 1e-300:
        return mean
    dx, dy, dz, xy, xz, yz = dx / spread, dy / spread, dz / spread, xy / spread, xz / spread, yz / spread
    half = 0.5 * (dx * (dy * dz - yz * yz) - xy * (xy * dz - yz * xz) + xz * (xy * yz - dy * xz))
    return mean + 2.0 * spread * math.cos(math.acos(min(max(half, -1.0), 1.0)) / 3.0)


@njit(cache=True, nogil=True)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True)
def _steepest(near, per_m, best):
    """The largest squared norm of the Jacobian over cells of a 10 x 10 x 10 piece, `best` at least."""
    slope = np.empty((3, 3))
    for x in range(9):
        for y in range(9):
            for z in range(9):
                for corner in range(8):
                    a, b, c = x + (corner >> 2), y + ((corner >> 1) & 1), z + (corner & 1)
                    for f in range(3):
                        slope[0, f] = (near[x + 1, b, c, f] - near[x, b, c, f]) * per_m[0]
                        slope[1, f] = (near[a, y + 1, c, f] - near[a, y, c, f]) * per_m[1]
                        slope[2, f] = (near[a, b, z + 1, f] - near[a, b, z, f]) * per_m[2]
                    xx, yy, zz = _dot(slope[0], slope[0]), _dot(slope[1], slope[1]), _dot(slope[2], slope[2])
                    if xx + yy + zz > best:  # the trace is never below the largest eigenvalue
                        xy, xz, yz = _dot(slope[0], slope[1]), _dot(slope[0], slope[2]), _dot(slope[1], slope[2])
                        best = max(best, _largest_eigenvalue(xx, yy, zz, xy, xz, yz))
    return best


@njit(cache=True, nogil=True)
def _fill(near, b, forces, slots):
    for x in range(10):
        for y in range(10):
            for z in range(10):
                beside = ((x + 7) >> 3) * 9 + ((y + 7) >> 3) * 3 + ((z + 7) >> 3)
                slot = slots[b, beside]
                for f in range(3):
                    near[x, y, z, f] = forces[slot, (x - 1) & 7, (y - 1) & 7, (z - 1) & 7, f] if slot >= 0 else 0.0


@njit(cache=True, nogil=True)
def field_bounds(begin, end, bricks, forces, slots, spacing, origin):
    """Squares over bricks begin to end - 1: norm of the Jacobian, reach from the origin, and force.

    `slots` int32 [n, 27] as `neighbour_slots` gives, `spacing` and `origin` float64 [3]. Cells between the last
    samples of the grid and the zeros beyond them count as all others do.
    """
    near = np.empty((10, 10, 10, 3))
    slope2 = reach2 = force2 = 0.0
    for b in range(begin, end):
        _fill(near, b, forces, slots)
        slope2 = _steepest(near, 1.0 / spacing, slope2)
        for x in range(8):
            for y in range(8):
                for z in range(8):
                    own = _dot(near[x + 1, y + 1, z + 1], near[x + 1, y + 1, z + 1])
                    if own > 0.0:
                        force2 = max(force2, own)
                        far = 0.0
                        for axis in range(3):
                            local = x if axis == 0 else (y if axis == 1 else z)
                            at = origin[axis] + spacing[axis] * (bricks[b, axis] * 8 + local)
                            far += (abs(at) + spacing[axis]) ** 2
                        reach2 = max(reach2, far)
    return slope2, reach2, force2
