"""Compiled: what a field gives to a tool of many points: a force, and a torque about the device's point.

First the field's force at every point, part by part; then the sum (its weights: `render.tool`). A part's bricks are
looked up once for neighbours that share one, and places within a cell are interpolated in float32.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from touchfield.medium.kernels.cell import CELLS
from touchfield.medium.kernels.placed import shortened
from touchfield.render.frame_block import (
    FIELD_BOX,
    FIELD_CELLS,
    FIELD_CORNER,
    FIELD_HELD,
    FIELD_INVERSE,
    FIELD_REACH,
    FIELD_SHIFT,
    FIELD_TABLE,
    FRAME_COUNT,
    FRAME_FLOOR,
    FRAME_LIMIT,
    FRAME_WORDS,
    PART_FIELD,
    PART_MOTION,
    PART_WORDS,
)
from touchfield.render.kernels.lookup import ON_PLANE, on_axis, slot_of
from touchfield.render.kernels.parts import arm, ends, mixed, rotation, spin, turned, turned_back
from touchfield.render.kernels.points import between_single
from touchfield.render.wrench_places import FIELD_TORQUE, TOOL, TOOL_POINTS, TOOL_REACH, TOOL_SHARE, TURN

__all__ = ["tool_force"]

_1, _2, _3 = np.uint64(1), np.uint64(2), np.uint64(3)
_NO_FORCE = np.float32(0.0)


@njit(nogil=True, forceinline=True)
def _lattice(i8, f8, field):
    """What a lookup needs of a field: sizes, corner and places in the block."""
    near = 2 * ON_PLANE
    bx, by, bz = i8[field + FIELD_BOX], i8[field + FIELD_BOX + 1], i8[field + FIELD_BOX + 2]
    corner = f8[field + FIELD_CORNER], f8[field + FIELD_CORNER + 1], f8[field + FIELD_CORNER + 2]
    inverse = f8[field + FIELD_INVERSE], f8[field + FIELD_INVERSE + 1], f8[field + FIELD_INVERSE + 2]
    high = 8.0 * bx - near, 8.0 * by - near, 8.0 * bz - near
    table, held = field + i8[field + FIELD_TABLE], field + i8[field + FIELD_HELD]
    return (
        corner,
        inverse,
        high,
        (by, bz, table, i8[field + FIELD_SHIFT], held, 2 * (field + i8[field + FIELD_CELLS])),
    )


@njit(nogil=True, forceinline=True)
def _sampled(i8, u8, f4, lattice, x, y, z, last, slot):
    """The force of a field at a point of its own frame, float32; its brick, and the brick's slot, for the next."""
    corner, inverse, high, (by, bz, table, shift, held, first) = lattice
    x, y, z = (x - corner[0]) * inverse[0], (y - corner[1]) * inverse[1], (z - corner[2]) * inverse[2]
    gx, gy, gz = _NO_FORCE, _NO_FORCE, _NO_FORCE
    if 0.0 <= x < high[0] and 0.0 <= y < high[1] and 0.0 <= z < high[2]:
        i, fx = on_axis(x)
        j, fy = on_axis(y)
        k, fz = on_axis(z)
        key = ((i >> 3) * by + (j >> 3)) * bz + (k >> 3)
        if key != last:
            last, slot = key, slot_of(i8, table, shift, key)
        if slot >= 0 and (u8[np.uint64(held + 8 * slot + (i & 7))] >> np.uint64(8 * (j & 7) + (k & 7))) & _1:
            o = np.uint64(first + slot * CELLS + (i & 7) * 243 + (j & 7) * 27 + (k & 7) * 3)
            sx, sy, sz = np.float32(fx), np.float32(fy), np.float32(fz)
            gx, gy = between_single(f4, o, sx, sy, sz), between_single(f4, o + _1, sx, sy, sz)
            gz = between_single(f4, o + _2, sx, sy, sz)
    return gx, gy, gz, last, slot


@njit(nogil=True, forceinline=True)
def _turn(f8):
    """Field from tool, in three rows."""
    return (
        (f8[TURN], f8[TURN + 1], f8[TURN + 2]),
        (f8[TURN + 3], f8[TURN + 4], f8[TURN + 5]),
        (f8[TURN + 6], f8[TURN + 7], f8[TURN + 8]),
    )


@njit(cache=True, nogil=True)
def _add_part(i8, u8, f8, f4, a, b, blend, px, py, pz, least):
    """Add the force of one part at every point of a tool whose device's point is (px, py, pz)."""
    field, later = i8[np.uint64(a + PART_FIELD)], i8[np.uint64(b + PART_FIELD)]
    dx, dy, dz = arm(f8, a, b, blend, px, py, pz)
    reach = (
        math.sqrt(max(f8[np.uint64(field + FIELD_REACH)], f8[np.uint64(later + FIELD_REACH)], 0.0)) + f8[TOOL_REACH]
    )
    if not dx * dx + dy * dy + dz * dz <= reach * reach:
        return
    r, t = rotation(f8, a, b, blend), _turn(f8)
    ox, oy, oz = turned_back(r, dx, dy, dz)
    m0, m1, m2 = (
        turned_back(r, t[0][0], t[1][0], t[2][0]),
        turned_back(r, t[0][1], t[1][1], t[2][1]),
        turned_back(r, t[0][2], t[1][2], t[2][2]),
    )
    v = a + PART_MOTION, b + PART_MOTION
    vx, vy, vz = (
        mixed(f8, v[0], v[1], blend),
        mixed(f8, v[0] + 1, v[1] + 1, blend),
        mixed(f8, v[0] + 2, v[1] + 2, blend),
    )
    wx, wy, wz = spin(f8, a, b, blend)
    first, second = _lattice(i8, f8, field), _lattice(i8, f8, later)
    both, share = field != later, np.float32(blend)
    last, slot, last_later, slot_later = np.int64(-1), np.int64(-1), np.int64(-1), np.int64(-1)
    count = i8[TOOL_POINTS]
    at = np.uint64(2 * i8[TOOL])
    to = at + np.uint64(6 * count)
    for _ in range(count):
        qx, qy, qz = np.float64(f4[at]), np.float64(f4[at + _1]), np.float64(f4[at + _2])
        x = ox + m0[0] * qx + m1[0] * qy + m2[0] * qz
        y = oy + m0[1] * qx + m1[1] * qy + m2[1] * qz
        z = oz + m0[2] * qx + m1[2] * qy + m2[2] * qz
        gx, gy, gz, last, slot = _sampled(i8, u8, f4, first, x, y, z, last, slot)
        if both:
            hx, hy, hz, last_later, slot_later = _sampled(i8, u8, f4, second, x, y, z, last_later, slot_later)
            gx, gy, gz = gx + share * (hx - gx), gy + share * (hy - gy), gz + share * (hz - gz)
        if gx * gx + gy * gy + gz * gz > least:
            sx, sy, sz = turned(r, gx, gy, gz)
            ax, ay, az = turned(r, x, y, z)
            f4[to] += np.float32(sx + vx + wy * az - wz * ay)
            f4[to + _1] += np.float32(sy + vy + wz * ax - wx * az)
            f4[to + _2] += np.float32(sz + vz + wx * ay - wy * ax)
        at, to = at + _3, to + _3


@njit(cache=True, nogil=True)
def tool_force(i8, u8, f8, f4, frame_a, frame_b, blend, px, py, pz):
    """The force on the tool at (px, py, pz), metres, turned by TURN, newtons; its torque is left in FIELD_TORQUE."""
    frame_a, frame_b, blend = ends(frame_a, frame_b, blend)
    limit, least = f8[np.uint64(frame_a + FRAME_LIMIT)], f8[np.uint64(frame_a + FRAME_FLOOR)]
    count = i8[TOOL_POINTS]
    at = np.uint64(2 * i8[TOOL])
    normal, force = at + np.uint64(3 * count), at + np.uint64(6 * count)
    f4[force : force + np.uint64(3 * count)] = _NO_FORCE
    a, b = frame_a + FRAME_WORDS, frame_b + FRAME_WORDS
    for _ in range(min(i8[np.uint64(frame_a + FRAME_COUNT)], i8[np.uint64(frame_b + FRAME_COUNT)])):
        _add_part(i8, u8, f8, f4, a, b, blend, px, py, pz, least)
        a, b = a + PART_WORDS, b + PART_WORDS
    t = _turn(f8)
    fx, fy, fz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for _ in range(count):
        gx, gy, gz = np.float64(f4[force]), np.float64(f4[force + _1]), np.float64(f4[force + _2])
        square = gx * gx + gy * gy + gz * gz
        if square > 0.0:
            nx, ny, nz = turned(t, f4[normal], f4[normal + _1], f4[normal + _2])
            shown = -(nx * gx + ny * gy + nz * gz)
            if shown > 0.0:
                gx, gy, gz = shortened(gx, gy, gz, limit)
                shown /= math.sqrt(square)
                gx, gy, gz = shown * gx, shown * gy, shown * gz
                qx, qy, qz = turned(t, f4[at], f4[at + _1], f4[at + _2])
                fx, fy, fz = fx + gx, fy + gy, fz + gz
                tx, ty, tz = tx + qy * gz - qz * gy, ty + qz * gx - qx * gz, tz + qx * gy - qy * gx
        at, normal, force = at + _3, normal + _3, force + _3
    share = f8[TOOL_SHARE]
    f8[FIELD_TORQUE], f8[FIELD_TORQUE + 1], f8[FIELD_TORQUE + 2] = share * tx, share * ty, share * tz
    return share * fx, share * fy, share * fz
