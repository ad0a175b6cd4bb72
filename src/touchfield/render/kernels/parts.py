"""Compiled: one part of a frame, or between two frames: where it lies, how it is turned, what its motion adds."""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.lean import UNCOUNTED
from touchfield.render.frame_block import (
    AT_A_FRAME,
    FIELD_REACH,
    PART_FIELD,
    PART_MATRIX,
    PART_MOTION,
    PART_POSITION,
    PART_QUATERNION,
)

__all__ = ["UNTURNED", "arm", "ends", "is_far", "mixed", "motion", "rotation", "spin", "turned", "turned_back"]

UNTURNED = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_1, _2, _3 = np.uint64(1), np.uint64(2), np.uint64(3)


@njit(**UNCOUNTED, forceinline=True)
def ends(frame_a, frame_b, blend):
    """The same instant with blend 0 wherever one frame alone tells it; beyond 0 and 1 the nearer frame."""
    if frame_a == frame_b or not blend > AT_A_FRAME:
        return frame_a, frame_a, 0.0
    if blend >= 1.0 - AT_A_FRAME:
        return frame_b, frame_b, 0.0
    return frame_a, frame_b, blend


@njit(**UNCOUNTED, forceinline=True)
def mixed(f8, a, b, blend):
    """The number between those at words a and b."""
    first = f8[np.uint64(a)]
    return first + blend * (f8[np.uint64(b)] - first)


@njit(**UNCOUNTED, forceinline=True)
def arm(f8, a, b, blend, x, y, z):
    """From where a part lies to a point, metres."""
    a, b = a + PART_POSITION, b + PART_POSITION
    return x - mixed(f8, a, b, blend), y - mixed(f8, a + 1, b + 1, blend), z - mixed(f8, a + 2, b + 2, blend)


@njit(**UNCOUNTED, forceinline=True)
def is_far(i8, f8, a, b, x, y, z):
    """Whether an `arm` is longer than any force of the part's fields is far; one that is no number is."""
    field_a, field_b = i8[np.uint64(a + PART_FIELD)], i8[np.uint64(b + PART_FIELD)]
    reach_a, reach_b = f8[np.uint64(field_a + FIELD_REACH)], f8[np.uint64(field_b + FIELD_REACH)]
    return not x * x + y * y + z * z <= max(reach_a, reach_b)


@njit(**UNCOUNTED, forceinline=True)
def rotation(f8, a, b, blend):
    """R of a part in three rows: between two frames that of both quaternions, mixed and made unit."""
    if blend == 0.0:
        m = np.uint64(a + PART_MATRIX)
        n, o = m + _3, m + _3 + _3
        return (f8[m], f8[m + _1], f8[m + _2]), (f8[n], f8[n + _1], f8[n + _2]), (f8[o], f8[o + _1], f8[o + _2])
    p, q = np.uint64(a + PART_QUATERNION), np.uint64(b + PART_QUATERNION)
    w0, x0, y0, z0 = f8[p], f8[p + _1], f8[p + _2], f8[p + _3]
    w1, x1, y1, z1 = f8[q], f8[q + _1], f8[q + _2], f8[q + _3]
    first = 1.0 - blend
    second = blend if w0 * w1 + x0 * x1 + y0 * y1 + z0 * z1 >= 0.0 else -blend  # the short way
    w, x = first * w0 + second * w1, first * x0 + second * x1
    y, z = first * y0 + second * y1, first * z0 + second * z1
    square = w * w + x * x + y * y + z * z
    s = 2.0 / square if square > 0.0 else 0.0
    xx, yy, zz, xy, xz, yz = s * x * x, s * y * y, s * z * z, s * x * y, s * x * z, s * y * z
    wx, wy, wz = s * w * x, s * w * y, s * w * z
    return (1.0 - yy - zz, xy - wz, xz + wy), (xy + wz, 1.0 - xx - zz, yz - wx), (xz - wy, yz + wx, 1.0 - xx - yy)


@njit(**UNCOUNTED, forceinline=True)
def turned(r, x, y, z):
    """R v."""
    return (
        r[0][0] * x + r[0][1] * y + r[0][2] * z,
        r[1][0] * x + r[1][1] * y + r[1][2] * z,
        r[2][0] * x + r[2][1] * y + r[2][2] * z,
    )


@njit(**UNCOUNTED, forceinline=True)
def turned_back(r, x, y, z):
    """R^T v."""
    return (
        r[0][0] * x + r[1][0] * y + r[2][0] * z,
        r[0][1] * x + r[1][1] * y + r[2][1] * z,
        r[0][2] * x + r[1][2] * y + r[2][2] * z,
    )


@njit(**UNCOUNTED, forceinline=True)
def spin(f8, a, b, blend):
    """Angular velocity times the surface damping, N/m."""
    v, w = a + PART_MOTION + 3, b + PART_MOTION + 3
    return mixed(f8, v, w, blend), mixed(f8, v + 1, w + 1, blend), mixed(f8, v + 2, w + 2, blend)


@njit(**UNCOUNTED, forceinline=True)
def motion(f8, a, b, blend, dx, dy, dz):
    """What the motion of a part's surface adds, newtons, the `arm` (dx, dy, dz) away from where it lies."""
    v, w = a + PART_MOTION, b + PART_MOTION
    wx, wy, wz = spin(f8, a, b, blend)
    x = mixed(f8, v, w, blend) + wy * dz - wz * dy
    y = mixed(f8, v + 1, w + 1, blend) + wz * dx - wx * dz
    z = mixed(f8, v + 2, w + 2, blend) + wx * dy - wy * dx
    return x, y, z
