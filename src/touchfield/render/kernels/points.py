"""Compiled: many points at once, and one point called from Python."""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.medium.kernels.cell import CELLS
from touchfield.render.frame_block import (
    FIELD_BOX,
    FIELD_CELLS,
    FIELD_CORNER,
    FIELD_HELD,
    FIELD_INVERSE,
    FIELD_SHIFT,
    FIELD_TABLE,
)
from touchfield.render.kernels.frames import force_at, force_between, gradient_at, vibration_between
from touchfield.render.kernels.lookup import ON_PLANE, on_axis, slot_of

__all__ = ["field_at_points", "forces_at_points", "gradients_at_points", "vibrations_at_points"]

_1, _2, _Z, _Y, _X = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(27), np.uint64(243)
_YZ, _XZ, _XY, _XYZ = _Y + _Z, _X + _Z, _X + _Y, _X + _Y + _Z
_NO_FORCE = np.float32(0.0)


@njit(nogil=True, forceinline=True)
def _between(f4, o, fx, fy, fz):
    """Trilinear interpolation in float32 of one component, whose first corner lies at `o`."""
    a, b, c, d = f4[o], f4[o + _Y], f4[o + _X], f4[o + _XY]
    a += fz * (f4[o + _Z] - a)
    b += fz * (f4[o + _YZ] - b)
    c += fz * (f4[o + _XZ] - c)
    d += fz * (f4[o + _XYZ] - d)
    a += fy * (b - a)
    c += fy * (d - c)
    return a + fx * (c - a)


@njit(cache=True, nogil=True)
def field_at_points(begin, end, points, i8, u8, f8, f4, field, share, is_first, out):
    """`share` of one unturned field at points [m, 3], metres, written to float32 [m, 3] or, unless first, added.

    The numbers of `lookup.field_force`, rounded: a point's place in its cell and what follows is float32 here, in
    half the time. The brick of the point before is kept.
    """
    corner_x, corner_y, corner_z = (
        f8[field + FIELD_CORNER],
        f8[field + FIELD_CORNER + 1],
        f8[field + FIELD_CORNER + 2],
    )
    inv_x, inv_y, inv_z = f8[field + FIELD_INVERSE], f8[field + FIELD_INVERSE + 1], f8[field + FIELD_INVERSE + 2]
    ny, nz = i8[field + FIELD_BOX + 1], i8[field + FIELD_BOX + 2]
    near = 2 * ON_PLANE
    high_x, high_y, high_z = 8.0 * i8[field + FIELD_BOX] - near, 8.0 * ny - near, 8.0 * nz - near
    table, shift = field + i8[field + FIELD_TABLE], i8[field + FIELD_SHIFT]
    held, first = field + i8[field + FIELD_HELD], 2 * (field + i8[field + FIELD_CELLS])
    part = np.float32(share)
    last, slot = np.int64(-1), np.int64(-1)
    for p in range(begin, end):
        x, y, z = (
            (points[p, 0] - corner_x) * inv_x,
            (points[p, 1] - corner_y) * inv_y,
            (points[p, 2] - corner_z) * inv_z,
        )
        gx, gy, gz = _NO_FORCE, _NO_FORCE, _NO_FORCE
        if 0.0 <= x < high_x and 0.0 <= y < high_y and 0.0 <= z < high_z:
            i, fx = on_axis(x)
            j, fy = on_axis(y)
            k, fz = on_axis(z)
            key = ((i >> 3) * ny + (j >> 3)) * nz + (k >> 3)
            if key != last:
                last, slot = key, slot_of(i8, table, shift, key)
            if slot >= 0 and (u8[np.uint64(held + 8 * slot + (i & 7))] >> np.uint64(8 * (j & 7) + (k & 7))) & _1:
                o = np.uint64(first + slot * CELLS + (i & 7) * 243 + (j & 7) * 27 + (k & 7) * 3)
                sx, sy, sz = np.float32(fx), np.float32(fy), np.float32(fz)
                gx, gy = part * _between(f4, o, sx, sy, sz), part * _between(f4, o + _1, sx, sy, sz)
                gz = part * _between(f4, o + _2, sx, sy, sz)
        if is_first:
            out[p, 0], out[p, 1], out[p, 2] = gx, gy, gz
        else:
            out[p, 0], out[p, 1], out[p, 2] = out[p, 0] + gx, out[p, 1] + gy, out[p, 2] + gz


@njit(cache=True, nogil=True)
def forces_at_points(begin, end, points, blends, i8, u8, f8, f4, frame_a, frame_b, out):
    """`force_at` at points [m, 3], each at its own of `blends` [m] or all at the only one."""
    many = blends.shape[0] > 1
    for p in range(begin, end):
        blend = blends[p] if many else blends[0]
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        out[p, 0], out[p, 1], out[p, 2] = force_between(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z)


@njit(cache=True, nogil=True)
def gradients_at_points(begin, end, points, blends, i8, u8, f8, f4, frame_a, frame_b, out):
    """`gradient_at` likewise, into [m, 9]."""
    many = blends.shape[0] > 1
    for p in range(begin, end):
        blend = blends[p] if many else blends[0]
        rows = gradient_at(i8, u8, f8, f4, frame_a, frame_b, blend, points[p, 0], points[p, 1], points[p, 2])
        for c in range(9):
            out[p, c] = rows[c]


@njit(cache=True, nogil=True)
def vibrations_at_points(begin, end, points, blends, i8, u8, f8, f4, frame_a, frame_b, out):
    """`vibration_between` likewise, into [m, 2]: amplitude and frequency."""
    many = blends.shape[0] > 1
    for p in range(begin, end):
        blend = blends[p] if many else blends[0]
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        out[p, 0], out[p, 1] = vibration_between(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z)


@njit(cache=True, nogil=True)
def force_at_once(u8, frame_a, frame_b, blend, x, y, z):
    """`force_at` of a block given by one of its views: each array handed over costs a call from Python 0.1 us."""
    i8, f8, f4 = u8.view(np.int64), u8.view(np.float64), u8.view(np.float32)
    return force_at(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z)
