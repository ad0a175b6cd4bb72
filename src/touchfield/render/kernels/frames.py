"""Compiled: the force at a point between two frames of the block (layout: `frame_block`).

All that a tick asks of the field: force, gradient, vibration. Nothing is allocated, and a coordinate that is not
finite gives zero.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.lean import UNCOUNTED
from touchfield.medium.kernels.cell import between
from touchfield.medium.kernels.placed import INSIDE, shortened
from touchfield.render.frame_block import (
    FIELD_INVERSE,
    FRAME_COUNT,
    FRAME_FLOOR,
    FRAME_LIMIT,
    FRAME_VIBRATION,
    FRAME_WORDS,
    PART_FIELD,
    PART_IS_IDENTITY,
    PART_WORDS,
)
from touchfield.render.kernels.lookup import NONE, locate, slopes
from touchfield.render.kernels.parts import UNTURNED, arm, ends, is_far, motion, rotation, spin, turned, turned_back

__all__ = [
    "force_at", "force_between", "gradient_at", "part_count", "part_force", "vibration_at", "vibration_between"
]  # fmt: skip

_1, _2 = np.uint64(1), np.uint64(2)


@njit(**UNCOUNTED, forceinline=True)
def part_count(i8, frame_a, frame_b):
    """Bodies that both frames have."""
    return min(i8[np.uint64(frame_a + FRAME_COUNT)], i8[np.uint64(frame_b + FRAME_COUNT)])


@njit(**UNCOUNTED, forceinline=True)
def part_force(i8, u8, f8, f4, a, b, blend, dx, dy, dz):
    """Force of a part in the scene, its `arm` (dx, dy, dz) away, without what its motion adds.

    The loop goes over the field in the first frame and, if it is another one, that in the second.
    """
    field, last = i8[np.uint64(a + PART_FIELD)], i8[np.uint64(b + PART_FIELD)]
    is_turned = not i8[np.uint64(a + PART_IS_IDENTITY)] & i8[np.uint64(b + PART_IS_IDENTITY)]
    r = UNTURNED
    if is_turned:
        r = rotation(f8, a, b, blend)
        dx, dy, dz = turned_back(r, dx, dy, dz)
    gx, gy, gz = 0.0, 0.0, 0.0
    share = 1.0 if field == last else 1.0 - blend
    while True:
        o, fx, fy, fz = locate(i8, u8, f8, field, dx, dy, dz)
        if o != NONE:
            gx += share * between(f4, o, fx, fy, fz)
            gy += share * between(f4, o + _1, fx, fy, fz)
            gz += share * between(f4, o + _2, fx, fy, fz)
        if field == last:
            break
        field, share = last, blend
    if is_turned:
        gx, gy, gz = turned(r, gx, gy, gz)
    return gx, gy, gz


@njit(**UNCOUNTED, forceinline=True)
def force_between(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z):
    """`force_at`, to be part of a loop over points."""
    frame_a, frame_b, blend = ends(frame_a, frame_b, blend)
    least, limit = f8[np.uint64(frame_a + FRAME_FLOOR)], f8[np.uint64(frame_a + FRAME_LIMIT)]
    sx, sy, sz = 0.0, 0.0, 0.0
    a, b = frame_a + FRAME_WORDS, frame_b + FRAME_WORDS
    for _ in range(part_count(i8, frame_a, frame_b)):
        dx, dy, dz = arm(f8, a, b, blend, x, y, z)
        if not is_far(i8, f8, a, b, dx, dy, dz):
            gx, gy, gz = part_force(i8, u8, f8, f4, a, b, blend, dx, dy, dz)
            if gx * gx + gy * gy + gz * gz > least:
                mx, my, mz = motion(f8, a, b, blend, dx, dy, dz)
                sx, sy, sz = sx + gx + mx, sy + gy + my, sz + gz + mz
        a, b = a + PART_WORDS, b + PART_WORDS
    return shortened(sx, sy, sz, limit)


@njit(**UNCOUNTED, cache=True)
def force_at(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z):
    """F(x, t), newtons, between the frames at words `frame_a` (blend 0) and `frame_b` (blend 1); x in metres.

    Trilinear in space. Of a part with the same field in both frames the pose alone is interpolated (its position
    linearly, its quaternion linearly and made unit again); fields that differ are blended linearly in that pose.
    """
    return force_between(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z)


# -- its slope -----------------------------------------------------------------------------------------------------


@njit(**UNCOUNTED, forceinline=True)
def _part_gradient(i8, u8, f8, f4, a, b, blend, dx, dy, dz):
    """R J R^T: the slopes of `part_force`, N/m, by columns: how the force changes along x, y and z."""
    field, last = i8[np.uint64(a + PART_FIELD)], i8[np.uint64(b + PART_FIELD)]
    r = rotation(f8, a, b, blend)
    px, py, pz = turned_back(r, dx, dy, dz)
    p, q, s = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    share = 1.0 if field == last else 1.0 - blend
    while True:
        o, fx, fy, fz = locate(i8, u8, f8, field, px, py, pz)
        if o != NONE:
            at = np.uint64(field + FIELD_INVERSE)
            hx, hy, hz = share * f8[at], share * f8[at + _1], share * f8[at + _2]
            t, u, v = slopes(f4, o, fx, fy, fz), slopes(f4, o + _1, fx, fy, fz), slopes(f4, o + _2, fx, fy, fz)
            p = p[0] + hx * t[0], p[1] + hy * t[1], p[2] + hz * t[2]
            q = q[0] + hx * u[0], q[1] + hy * u[1], q[2] + hz * u[2]
            s = s[0] + hx * v[0], s[1] + hy * v[1], s[2] + hz * v[2]
        if field == last:
            break
        field, share = last, blend
    p, q, s = turned(r, p[0], p[1], p[2]), turned(r, q[0], q[1], q[2]), turned(r, s[0], s[1], s[2])
    return turned(r, p[0], q[0], s[0]), turned(r, p[1], q[1], s[1]), turned(r, p[2], q[2], s[2])


@njit(**UNCOUNTED, forceinline=True)
def _cut(column, share, ux, uy, uz):
    """A column of slopes of a force cut to a length: its share across the direction u, nothing along it."""
    along = column[0] * ux + column[1] * uy + column[2] * uz
    return share * (column[0] - along * ux), share * (column[1] - along * uy), share * (column[2] - along * uz)


@njit(**UNCOUNTED, cache=True)
def gradient_at(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z):
    """dF_i/dx_j of `force_at`, N/m, row by row: nine numbers.

    On a plane of a lattice, where the slope jumps, it is that of the cell towards greater indices. Where the sum is
    cut to its limit, only the change of its direction is left.
    """
    frame_a, frame_b, blend = ends(frame_a, frame_b, blend)
    least, limit = f8[np.uint64(frame_a + FRAME_FLOOR)], f8[np.uint64(frame_a + FRAME_LIMIT)]
    sx, sy, sz = 0.0, 0.0, 0.0
    along_x, along_y, along_z = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    a, b = frame_a + FRAME_WORDS, frame_b + FRAME_WORDS
    for _ in range(part_count(i8, frame_a, frame_b)):
        dx, dy, dz = arm(f8, a, b, blend, x, y, z)
        if not is_far(i8, f8, a, b, dx, dy, dz):
            p, q, r = _part_gradient(i8, u8, f8, f4, a, b, blend, dx, dy, dz)
            gx, gy, gz = part_force(i8, u8, f8, f4, a, b, blend, dx, dy, dz)
            wx, wy, wz = 0.0, 0.0, 0.0
            if gx * gx + gy * gy + gz * gz > least:
                mx, my, mz = motion(f8, a, b, blend, dx, dy, dz)
                sx, sy, sz = sx + gx + mx, sy + gy + my, sz + gz + mz
                wx, wy, wz = spin(f8, a, b, blend)
            along_x = along_x[0] + p[0], along_x[1] + p[1] + wz, along_x[2] + p[2] - wy
            along_y = along_y[0] + q[0] - wz, along_y[1] + q[1], along_y[2] + q[2] + wx
            along_z = along_z[0] + r[0] + wy, along_z[1] + r[1] - wx, along_z[2] + r[2]
        a, b = a + PART_WORDS, b + PART_WORDS
    square = sx * sx + sy * sy + sz * sz
    if not square < np.inf:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    if square > limit * limit:
        length = np.sqrt(square)
        share, ux, uy, uz = limit * INSIDE / length, sx / length, sy / length, sz / length
        along_x, along_y = _cut(along_x, share, ux, uy, uz), _cut(along_y, share, ux, uy, uz)
        along_z = _cut(along_z, share, ux, uy, uz)
    p, q, r = along_x, along_y, along_z
    return p[0], q[0], r[0], p[1], q[1], r[1], p[2], q[2], r[2]


# -- vibration -----------------------------------------------------------------------------------------------------


@njit(**UNCOUNTED, cache=True)
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


@njit(**UNCOUNTED, cache=True)
def vibration_between(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z):
    """Between two frames: the amplitude linear in time, the frequency that of the nearer frame that vibrates."""
    frame_a, frame_b, blend = ends(frame_a, frame_b, blend)
    amplitude, frequency = vibration_at(i8, u8, f8, f4, frame_a, x, y, z)
    if blend > 0.0:
        later_n, later_hz = vibration_at(i8, u8, f8, f4, frame_b, x, y, z)
        if frequency == 0.0 or (blend > 0.5 and later_hz > 0.0):
            frequency = later_hz
        amplitude += blend * (later_n - amplitude)
    return amplitude, frequency
