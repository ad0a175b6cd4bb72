"""Compiled: the force at a point between two frames of the block (layout: `frame_block`).

All that a tick asks of the field: force, gradient, vibration. Nothing is allocated, and a coordinate that is not
finite gives zero.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.render.frame_block import (
    FIELD_INVERSE,
    FIELD_REACH,
    FRAME_COUNT,
    FRAME_FLOOR,
    FRAME_LIMIT,
    FRAME_VIBRATION,
    FRAME_WORDS,
    PART_FIELD,
    PART_IS_IDENTITY,
    PART_MATRIX,
    PART_MOTION,
    PART_POSITION,
    PART_QUATERNION,
    PART_WORDS,
)
from touchfield.render.kernels.lookup import NONE, between, field_force, locate

__all__ = ["force_at", "vibration_at"]

_1, _2, _3 = np.uint64(1), np.uint64(2), np.uint64(3)
_INSIDE = 1 - 2.0**-22  # so that rounding to float32 never lifts a clipped force above the limit


@njit(nogil=True, forceinline=True)
def ends(frame_a, frame_b, blend):
    """The same instant with blend 0 wherever one frame alone tells it; beyond 0 and 1 the nearer frame."""
    if frame_a == frame_b or not blend > 0.0:
        return frame_a, frame_a, 0.0
    if blend >= 1.0:
        return frame_b, frame_b, 0.0
    return frame_a, frame_b, blend


@njit(nogil=True, forceinline=True)
def mixed(f8, a, b, blend):
    """The number between those at words a and b."""
    first = f8[np.uint64(a)]
    return first + blend * (f8[np.uint64(b)] - first)


@njit(nogil=True, forceinline=True)
def arm(f8, a, b, blend, x, y, z):
    """From where a part lies to a point, metres."""
    a, b = a + PART_POSITION, b + PART_POSITION
    return x - mixed(f8, a, b, blend), y - mixed(f8, a + 1, b + 1, blend), z - mixed(f8, a + 2, b + 2, blend)


@njit(nogil=True, forceinline=True)
def is_far(f8, field_a, field_b, x, y, z):
    """Whether a point lies further from a body's origin than all forces of its fields; one that is no number does."""
    reach_a, reach_b = f8[np.uint64(field_a + FIELD_REACH)], f8[np.uint64(field_b + FIELD_REACH)]
    return not x * x + y * y + z * z <= max(reach_a, reach_b)


@njit(nogil=True, forceinline=True)
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


@njit(nogil=True, forceinline=True)
def moved(f8, a, b, blend, dx, dy, dz):
    """What the motion of a part's surface adds, newtons, `arm` away from where it lies."""
    v, w = a + PART_MOTION, b + PART_MOTION
    wx, wy, wz = mixed(f8, v + 3, w + 3, blend), mixed(f8, v + 4, w + 4, blend), mixed(f8, v + 5, w + 5, blend)
    x = mixed(f8, v, w, blend) + wy * dz - wz * dy
    y = mixed(f8, v + 1, w + 1, blend) + wz * dx - wx * dz
    z = mixed(f8, v + 2, w + 2, blend) + wx * dy - wy * dx
    return x, y, z


@njit(nogil=True)
def own_force(i8, u8, f8, f4, field_a, field_b, blend, x, y, z):
    """Force of a part in its own frame: of its one field, or between two that differ."""
    gx, gy, gz = field_force(i8, u8, f8, f4, field_a, x, y, z)
    if field_a != field_b:
        hx, hy, hz = field_force(i8, u8, f8, f4, field_b, x, y, z)
        gx, gy, gz = gx + blend * (hx - gx), gy + blend * (hy - gy), gz + blend * (hz - gz)
    return gx, gy, gz


@njit(nogil=True)
def sum_at(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z):
    """Sum of the forces of all parts, newtons, not yet cut."""
    sx, sy, sz = 0.0, 0.0, 0.0
    least = f8[np.uint64(frame_a + FRAME_FLOOR)]
    a, b = frame_a + FRAME_WORDS, frame_b + FRAME_WORDS
    for _ in range(min(i8[np.uint64(frame_a + FRAME_COUNT)], i8[np.uint64(frame_b + FRAME_COUNT)])):
        field_a, field_b = i8[np.uint64(a + PART_FIELD)], i8[np.uint64(b + PART_FIELD)]
        dx, dy, dz = arm(f8, a, b, blend, x, y, z)
        if not is_far(f8, field_a, field_b, dx, dy, dz):
            if i8[np.uint64(a + PART_IS_IDENTITY)] & i8[np.uint64(b + PART_IS_IDENTITY)]:
                gx, gy, gz = own_force(i8, u8, f8, f4, field_a, field_b, blend, dx, dy, dz)
            else:
                r, s, t = rotation(f8, a, b, blend)
                px = r[0] * dx + s[0] * dy + t[0] * dz
                py = r[1] * dx + s[1] * dy + t[1] * dz
                pz = r[2] * dx + s[2] * dy + t[2] * dz
                hx, hy, hz = own_force(i8, u8, f8, f4, field_a, field_b, blend, px, py, pz)
                gx = r[0] * hx + r[1] * hy + r[2] * hz
                gy = s[0] * hx + s[1] * hy + s[2] * hz
                gz = t[0] * hx + t[1] * hy + t[2] * hz
            if gx * gx + gy * gy + gz * gz > least:
                mx, my, mz = moved(f8, a, b, blend, dx, dy, dz)
                sx, sy, sz = sx + gx + mx, sy + gy + my, sz + gz + mz
        a, b = a + PART_WORDS, b + PART_WORDS
    return sx, sy, sz


@njit(cache=True, nogil=True)
def force_at(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z):
    """F(x, t), newtons, between the frames at words `frame_a` (blend 0) and `frame_b` (blend 1); x in metres.

    Trilinear in space. Of a part with the same field in both frames the pose alone is interpolated (its position
    linearly, its quaternion linearly and made unit again); fields that differ are blended linearly in that pose.
    """
    frame_a, frame_b, blend = ends(frame_a, frame_b, blend)
    sx, sy, sz = sum_at(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z)
    limit = f8[np.uint64(frame_a + FRAME_LIMIT)]
    square = sx * sx + sy * sy + sz * sz
    if not square < np.inf:  # a damping beyond all bounds has no direction left
        return 0.0, 0.0, 0.0
    if square > limit * limit:
        share = limit * _INSIDE / np.sqrt(square)
        return sx * share, sy * share, sz * share
    return sx, sy, sz


@njit(cache=True, nogil=True)
def vibration_at(i8, u8, f8, f4, frame, x, y, z):
    """Amplitude, newtons, and frequency, Hz, of the vibration of a frame at a point, metres; (0, 0) where none is.

    The amplitude is interpolated as a force is, with zero where nothing vibrates; the frequency is that of the
    nearest of the cell's corners that vibrates.
    """
    field = i8[np.uint64(frame + FRAME_VIBRATION)]
    if field == 0:
        return 0.0, 0.0
    o, fx, fy, fz = locate(i8, u8, f8, field, x, y, z)
    if o == NONE:
        return 0.0, 0.0
    amplitude = between(f4, o, fx, fy, fz)
    if not amplitude > 0.0:
        return 0.0, 0.0
    at = np.uint64(field + FIELD_INVERSE)
    hx, hy, hz = f8[at], f8[at + _1], f8[at + _2]
    nearest, frequency = np.inf, 0.0
    for c in range(8):
        i, j, k = c >> 2, (c >> 1) & 1, c & 1
        corner = o + np.uint64(243 * i + 27 * j + 3 * k)
        if f4[corner] > 0.0:
            dx, dy, dz = (fx - i) / hx, (fy - j) / hy, (fz - k) / hz
            square = dx * dx + dy * dy + dz * dz
            if square < nearest:
                nearest, frequency = square, np.float64(f4[corner + _1])
    return amplitude, frequency
