"""Compiled: what a field gives to a tool of many points: a force, and a torque about the device's point.

Some hundred points at a time, in float32 and in plain loops that a processor does many at once: where they lie in a
part's field, in samples; the force there, the brick of the point before at hand; that force in the tool's own axes,
added to those of other parts; and the sum of all (its weights: `render.tool`). Only the last step leaves float32, in
which a place of a lattice of 1000 samples is known to a ten thousandth of one.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from touchfield.lean import UNCOUNTED
from touchfield.medium.kernels.cell import CELLS, XY, XYZ, XZ, YZ, X, Y, Z
from touchfield.medium.kernels.placed import INSIDE
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
from touchfield.render.kernels.lookup import slot_of
from touchfield.render.kernels.parts import arm, ends, mixed, rotation, spin, turned, turned_back
from touchfield.render.tool import AT_ONCE
from touchfield.render.wrench_places import FIELD_TORQUE, TOOL, TOOL_POINTS, TOOL_REACH, TOOL_SHARE, TURN

__all__ = ["tool_force"]

_1, _2 = np.uint64(1), np.uint64(2)
_0 = np.float32(0.0)
_LEAST = np.float32(1e-30)
_FAST = {"contract", "nsz", "reassoc"}


@njit(**UNCOUNTED, forceinline=True)
def _three(f4, at, count, stride):
    """Three rows of `count` numbers, `stride` apart."""
    return f4[at : at + count], f4[at + stride : at + stride + count], f4[at + 2 * stride : at + 2 * stride + count]


@njit(**UNCOUNTED, forceinline=True)
def _single(v):
    return np.float32(v[0]), np.float32(v[1]), np.float32(v[2])


@njit(**UNCOUNTED, forceinline=True, fastmath=_FAST)
def _between(f4, o, fx, fy, fz):
    """Trilinear interpolation of one component, whose first corner lies at `o`."""
    a, b, c, d = f4[o], f4[o + Y], f4[o + X], f4[o + XY]
    a += fz * (f4[o + Z] - a)
    b += fz * (f4[o + YZ] - b)
    c += fz * (f4[o + XZ] - c)
    d += fz * (f4[o + XYZ] - d)
    a += fy * (b - a)
    c += fy * (d - c)
    return a + fx * (c - a)


@njit(**UNCOUNTED, cache=True, fastmath=_FAST)
def _lay(px, py, pz, rows, origin, sx, sy, sz):
    """rows p + origin: places of the tool in samples of a field."""
    (a, b, c), (d, e, f), (g, h, i) = rows
    for n in range(px.shape[0]):
        x, y, z = px[n], py[n], pz[n]
        sx[n] = origin[0] + a * x + b * y + c * z
        sy[n] = origin[1] + d * x + e * y + f * z
        sz[n] = origin[2] + g * x + h * y + i * z


@njit(**UNCOUNTED, cache=True, fastmath=_FAST)
def _sample(i8, u8, f4, field, share, is_first, sx, sy, sz, gx, gy, gz):
    """`share` of the force of a field at places in its samples, written, or, unless first, added."""
    by, bz = i8[field + FIELD_BOX + 1], i8[field + FIELD_BOX + 2]
    hx, hy, hz = np.float32(8 * i8[field + FIELD_BOX]), np.float32(8 * by), np.float32(8 * bz)
    table, shift = field + i8[field + FIELD_TABLE], i8[field + FIELD_SHIFT]
    held, first = field + i8[field + FIELD_HELD], 2 * (field + i8[field + FIELD_CELLS])
    last, slot = np.int64(-1), np.int64(-1)
    for n in range(sx.shape[0]):
        x, y, z = sx[n], sy[n], sz[n]
        fx, fy, fz = _0, _0, _0
        if x >= _0 and y >= _0 and z >= _0 and x < hx and y < hy and z < hz:
            i, j, k = np.int32(x), np.int32(y), np.int32(z)
            key = (np.int64(i >> 3) * by + (j >> 3)) * bz + (k >> 3)
            if key != last:
                last, slot = key, slot_of(i8, table, shift, key)
            if slot >= 0 and (u8[np.uint64(held + 8 * slot + (i & 7))] >> np.uint64(8 * (j & 7) + (k & 7))) & _1:
                o = np.uint64(first + slot * CELLS + (i & 7) * 243 + (j & 7) * 27 + (k & 7) * 3)
                x, y, z = x - np.float32(i), y - np.float32(j), z - np.float32(k)
                fx, fy = share * _between(f4, o, x, y, z), share * _between(f4, o + _1, x, y, z)
                fz = share * _between(f4, o + _2, x, y, z)
        if is_first:
            gx[n], gy[n], gz[n] = fx, fy, fz
        else:
            gx[n], gy[n], gz[n] = gx[n] + fx, gy[n] + fy, gz[n] + fz


@njit(**UNCOUNTED, cache=True, fastmath=_FAST)
def _gather(p, g, f, columns, still, swing, least):
    """Add forces g of a part, above the square `least`, to those f of the tool's axes, with what its motion adds.

    `columns`: of the matrix that turns the tool into the part; `still` + `swing` x p: velocity times damping.
    """
    (px, py, pz), (gx, gy, gz), (fx, fy, fz) = p, g, f
    (a, b, c), (d, e, h), (i, j, k) = columns
    for n in range(px.shape[0]):
        x, y, z = gx[n], gy[n], gz[n]
        is_there = np.float32(1.0) if x * x + y * y + z * z > least else _0
        vx = still[0] + swing[1] * pz[n] - swing[2] * py[n] + a * x + b * y + c * z
        vy = still[1] + swing[2] * px[n] - swing[0] * pz[n] + d * x + e * y + h * z
        vz = still[2] + swing[0] * py[n] - swing[1] * px[n] + i * x + j * y + k * z
        fx[n] += is_there * vx
        fy[n] += is_there * vy
        fz[n] += is_there * vz


@njit(**UNCOUNTED, cache=True, fastmath=_FAST, error_model="numpy")
def _sum(p, normals, f, limit):
    """Sum of s F and of p x s F, s = max(0, -n . F / |F|), each F cut to the length `limit`; the tool's axes."""
    (px, py, pz), (nx, ny, nz), (fx, fy, fz) = p, normals, f
    sx, sy, sz, tx, ty, tz = _0, _0, _0, _0, _0, _0
    for n in range(px.shape[0]):
        x, y, z = fx[n], fy[n], fz[n]
        size = np.sqrt(max(x * x + y * y + z * z, _LEAST))
        w = max(-(nx[n] * x + ny[n] * y + nz[n] * z), _0) * min(np.float32(1.0), limit / size) / size
        x, y, z = w * x, w * y, w * z
        sx, sy, sz = sx + x, sy + y, sz + z
        tx, ty, tz = tx + py[n] * z - pz[n] * y, ty + pz[n] * x - px[n] * z, tz + px[n] * y - py[n] * x
    return np.float64(sx), np.float64(sy), np.float64(sz), np.float64(tx), np.float64(ty), np.float64(tz)


@njit(**UNCOUNTED, forceinline=True)
def _turn(f8):
    """Field from tool, in three rows."""
    return (
        (f8[TURN], f8[TURN + 1], f8[TURN + 2]),
        (f8[TURN + 3], f8[TURN + 4], f8[TURN + 5]),
        (f8[TURN + 6], f8[TURN + 7], f8[TURN + 8]),
    )


@njit(**UNCOUNTED, forceinline=True)
def _lay_and_sample(i8, u8, f8, f4, field, share, is_first, columns, origin, p, s, g):
    """The force of a field at points of the tool; `columns`, `origin`: the tool in the part's frame, metres."""
    at = np.uint64(field + FIELD_INVERSE)
    kx, ky, kz = f8[at], f8[at + _1], f8[at + _2]
    at = np.uint64(field + FIELD_CORNER)
    corner = f8[at], f8[at + _1], f8[at + _2]
    a, b, c = columns
    rows = (
        _single((kx * a[0], kx * b[0], kx * c[0])),
        _single((ky * a[1], ky * b[1], ky * c[1])),
        _single((kz * a[2], kz * b[2], kz * c[2])),
    )
    begin = (kx * (origin[0] - corner[0]), ky * (origin[1] - corner[1]), kz * (origin[2] - corner[2]))
    _lay(p[0], p[1], p[2], rows, _single(begin), s[0], s[1], s[2])
    _sample(i8, u8, f4, field, np.float32(share), is_first, s[0], s[1], s[2], g[0], g[1], g[2])


@njit(**UNCOUNTED, cache=True)
def _add_part(i8, u8, f8, f4, a, b, blend, place, p, s, g, f, least):
    """Add the force of one part at some points p of a tool whose device's point is at `place`."""
    field, later = i8[np.uint64(a + PART_FIELD)], i8[np.uint64(b + PART_FIELD)]
    d = arm(f8, a, b, blend, place[0], place[1], place[2])
    reach = (
        math.sqrt(max(f8[np.uint64(field + FIELD_REACH)], f8[np.uint64(later + FIELD_REACH)], 0.0)) + f8[TOOL_REACH]
    )
    if not d[0] * d[0] + d[1] * d[1] + d[2] * d[2] <= reach * reach:
        return
    r, t = rotation(f8, a, b, blend), _turn(f8)
    origin = turned_back(r, d[0], d[1], d[2])
    columns = (
        turned_back(r, t[0][0], t[1][0], t[2][0]),
        turned_back(r, t[0][1], t[1][1], t[2][1]),
        turned_back(r, t[0][2], t[1][2], t[2][2]),
    )
    share = 1.0 if field == later else 1.0 - blend
    _lay_and_sample(i8, u8, f8, f4, field, share, True, columns, origin, p, s, g)
    if field != later:
        _lay_and_sample(i8, u8, f8, f4, later, blend, False, columns, origin, p, s, g)
    v, w = a + PART_MOTION, b + PART_MOTION
    still = mixed(f8, v, w, blend), mixed(f8, v + 1, w + 1, blend), mixed(f8, v + 2, w + 2, blend)
    still = turned_back(t, still[0], still[1], still[2])
    swing = spin(f8, a, b, blend)
    swing = turned_back(t, swing[0], swing[1], swing[2])
    d = turned_back(t, d[0], d[1], d[2])
    still = (
        still[0] + swing[1] * d[2] - swing[2] * d[1],
        still[1] + swing[2] * d[0] - swing[0] * d[2],
        still[2] + swing[0] * d[1] - swing[1] * d[0],
    )
    turn = _single(columns[0]), _single(columns[1]), _single(columns[2])
    _gather(p, g, f, turn, _single(still), _single(swing), np.float32(least))


@njit(**UNCOUNTED, cache=True)
def tool_force(i8, u8, f8, f4, frame_a, frame_b, blend, px, py, pz):
    """The force on the tool at (px, py, pz), metres, turned by TURN, newtons; its torque is left in FIELD_TORQUE."""
    frame_a, frame_b, blend = ends(frame_a, frame_b, blend)
    least, limit = f8[np.uint64(frame_a + FRAME_FLOOR)], np.float32(INSIDE * f8[np.uint64(frame_a + FRAME_LIMIT)])
    parts = min(i8[np.uint64(frame_a + FRAME_COUNT)], i8[np.uint64(frame_b + FRAME_COUNT)])
    points, at = i8[TOOL_POINTS], 2 * i8[TOOL]
    room = at + 6 * points
    fx, fy, fz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for begin in range(0, points, AT_ONCE):
        count = min(AT_ONCE, points - begin)
        p = _three(f4, at + begin, count, points)
        normals = _three(f4, at + 3 * points + begin, count, points)
        s, g = _three(f4, room, count, AT_ONCE), _three(f4, room + 3 * AT_ONCE, count, AT_ONCE)
        f = _three(f4, room + 6 * AT_ONCE, count, AT_ONCE)
        f[0][:], f[1][:], f[2][:] = _0, _0, _0
        a, b = frame_a + FRAME_WORDS, frame_b + FRAME_WORDS
        for _ in range(parts):
            _add_part(i8, u8, f8, f4, a, b, blend, (px, py, pz), p, s, g, f, least)
            a, b = a + PART_WORDS, b + PART_WORDS
        x, y, z, u, v, w = _sum(p, normals, f, limit)
        fx, fy, fz, tx, ty, tz = fx + x, fy + y, fz + z, tx + u, ty + v, tz + w
    t, share = _turn(f8), f8[TOOL_SHARE]
    tx, ty, tz = turned(t, share * tx, share * ty, share * tz)
    f8[FIELD_TORQUE], f8[FIELD_TORQUE + 1], f8[FIELD_TORQUE + 2] = tx, ty, tz
    return turned(t, share * fx, share * fy, share * fz)
