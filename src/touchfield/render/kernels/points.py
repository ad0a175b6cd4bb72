"""Compiled: the force at many points at once, for `FieldSampler` and for a tool, and the forces of a whole
field."""

from __future__ import annotations

import math

import numpy as np

from touchfield.compute.coder_jit import uncounted
from touchfield.compute.jit import inner, kernel
from touchfield.medium.grid import BRICK
from touchfield.medium.kernels.placed import CELLS, INSIDE, XY, XYZ, XZ, YZ, X, Y, Z
from touchfield.render.block import words as W
from touchfield.render.kernels import frames
from touchfield.render.kernels.vectors import (
    cross,
    dot,
    plus,
    put,
    rows_of,
    three,
    times,
    turned,
    turned_back,
)


AT_ONCE = 512
BINS = 400
_PER_DOUBLING = 20.0

_1, _2 = np.uint64(1), np.uint64(2)
_0 = np.float32(0.0)
_LEAST = np.float32(1e-30)
_FAST = {"contract", "nsz", "reassoc"}


@inner(inline="always")
def _between(f4, o, fx, fy, fz):
    """Trilinear interpolation in float32 of one component, whose first corner lies at `o`."""
    a, b, c, d = f4[o], f4[o + Y], f4[o + X], f4[o + XY]
    a += fz * (f4[o + Z] - a)
    b += fz * (f4[o + YZ] - b)
    c += fz * (f4[o + XZ] - c)
    d += fz * (f4[o + XYZ] - d)
    a += fy * (b - a)
    c += fy * (d - c)
    return a + fx * (c - a)


@kernel
def field_at_points(begin, end, points, i8, u8, f8, f4, field, share, is_first, out):
    """`share` of one unturned field at points [m, 3], metres, written to float32 [m, 3] or, unless first,
    added.

    `force_at` with places in cells and what follows in float32, in half the time; the brick before is kept.
    """
    corner_x, corner_y, corner_z = three(f8, field + W.FIELD_CORNER)
    inv_x, inv_y, inv_z = three(f8, field + W.FIELD_INVERSE)
    ny, nz = i8[field + W.FIELD_BOX + 1], i8[field + W.FIELD_BOX + 2]
    near = 2 * frames.ON_PLANE
    high_x, high_y, high_z = 8.0 * i8[field + W.FIELD_BOX] - near, 8.0 * ny - near, 8.0 * nz - near
    table, shift = field + i8[field + W.FIELD_TABLE], i8[field + W.FIELD_SHIFT]
    held, first = field + i8[field + W.FIELD_HELD], 2 * (field + i8[field + W.FIELD_CELLS])
    part = np.float32(share)
    last, slot = np.int64(-1), np.int64(-1)
    for p in range(begin, end):
        x, y = (points[p, 0] - corner_x) * inv_x, (points[p, 1] - corner_y) * inv_y
        z = (points[p, 2] - corner_z) * inv_z
        gx, gy, gz = _0, _0, _0
        if 0.0 <= x < high_x and 0.0 <= y < high_y and 0.0 <= z < high_z:
            i, fx = frames.on_axis(x)
            j, fy = frames.on_axis(y)
            k, fz = frames.on_axis(z)
            key = ((i >> 3) * ny + (j >> 3)) * nz + (k >> 3)
            if key != last:
                last, slot = key, frames.slot_of(i8, table, shift, key)
            if (
                slot >= 0
                and (u8[np.uint64(held + 8 * slot + (i & 7))] >> np.uint64(8 * (j & 7) + (k & 7))) & _1
            ):
                o = np.uint64(first + slot * CELLS + (i & 7) * 243 + (j & 7) * 27 + (k & 7) * 3)
                sx, sy, sz = np.float32(fx), np.float32(fy), np.float32(fz)
                gx, gy = part * _between(f4, o, sx, sy, sz), part * _between(f4, o + _1, sx, sy, sz)
                gz = part * _between(f4, o + _2, sx, sy, sz)
        if is_first:
            out[p, 0], out[p, 1], out[p, 2] = gx, gy, gz
        else:
            out[p, 0], out[p, 1], out[p, 2] = out[p, 0] + gx, out[p, 1] + gy, out[p, 2] + gz


@kernel
def forces_at_points(begin, end, points, blends, i8, u8, f8, f4, frame_a, frame_b, out):
    """`force_at` at points [m, 3], each at its own of `blends` [m] or all at the only one."""
    last = blends.shape[0] - 1
    for p in range(begin, end):
        blend = blends[min(p, last)]
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        out[p, 0], out[p, 1], out[p, 2] = frames.force_between(
            i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z
        )


@kernel
def gradients_at_points(begin, end, points, blends, i8, u8, f8, f4, frame_a, frame_b, out):
    """`gradient_at` likewise, into [m, 9]."""
    last = blends.shape[0] - 1
    for p in range(begin, end):
        blend = blends[min(p, last)]
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        force = frames.force_between(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z)
        rows = frames.gradient_at(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z, force)
        for c in range(9):
            out[p, c] = rows[c] if math.isfinite(x + y + z) else 0.0


@kernel
def vibrations_at_points(begin, end, points, blends, i8, u8, f8, f4, frame_a, frame_b, out):
    """`vibration_between` likewise, into [m, 2]: amplitude and frequency."""
    last = blends.shape[0] - 1
    for p in range(begin, end):
        blend = blends[min(p, last)]
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        out[p, 0], out[p, 1] = frames.vibration_between(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z)


@kernel
def force_at_once(u8, frame_a, frame_b, blend, x, y, z):
    """`force_at` of a block given by one of its views: each array handed over costs a call from Python 0.1
    us.
    """
    i8, f8, f4 = u8.view(np.int64), u8.view(np.float64), u8.view(np.float32)
    return frames.force_at(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z)


# -- a tool: what a field gives to many points of it, a force, and a torque about the device's point
# ----------------
#
# Some hundred points at a time, in float32 and in plain loops that a processor does many at once: where they
# lie in a part's field, in samples; the force there, the brick of the point before at hand; that force in the
# tool's own axes, added to those of other parts; and the sum of all (its weights: `render.tool`). Only the
# last step leaves float32, in which a place of a lattice of 1000 samples is known to a ten thousandth of one.


@uncounted(forceinline=True)
def _rows(f4, at, count, stride):
    """Three rows of `count` numbers, `stride` apart."""
    return (
        f4[at : at + count],
        f4[at + stride : at + stride + count],
        f4[at + 2 * stride : at + 2 * stride + count],
    )


@uncounted(forceinline=True)
def _single(v):
    return np.float32(v[0]), np.float32(v[1]), np.float32(v[2])


@uncounted(fastmath=_FAST)
def _lay(p, rows, origin, s):
    """rows p + origin: places of the tool in samples of a field."""
    (px, py, pz), (sx, sy, sz) = p, s
    (a, b, c), (d, e, f), (g, h, i) = rows
    for n in range(px.shape[0]):
        x, y, z = px[n], py[n], pz[n]
        sx[n] = origin[0] + a * x + b * y + c * z
        sy[n] = origin[1] + d * x + e * y + f * z
        sz[n] = origin[2] + g * x + h * y + i * z


@uncounted(fastmath=_FAST)
def _sample(i8, u8, f4, field, share, is_first, s, g):
    """`share` of the force of a field at places s in its samples, written to g, or, unless first, added."""
    (sx, sy, sz), (gx, gy, gz) = s, g
    by, bz = i8[field + W.FIELD_BOX + 1], i8[field + W.FIELD_BOX + 2]
    hx, hy, hz = np.float32(8 * i8[field + W.FIELD_BOX]), np.float32(8 * by), np.float32(8 * bz)
    table, shift = field + i8[field + W.FIELD_TABLE], i8[field + W.FIELD_SHIFT]
    held, first = field + i8[field + W.FIELD_HELD], 2 * (field + i8[field + W.FIELD_CELLS])
    last, slot = np.int64(-1), np.int64(-1)
    for n in range(sx.shape[0]):
        x, y, z = sx[n], sy[n], sz[n]
        fx, fy, fz = _0, _0, _0
        if x >= _0 and y >= _0 and z >= _0 and x < hx and y < hy and z < hz:
            i, j, k = np.int32(x), np.int32(y), np.int32(z)
            key = (np.int64(i >> 3) * by + (j >> 3)) * bz + (k >> 3)
            if key != last:
                last, slot = key, frames.slot_of(i8, table, shift, key)
            if (
                slot >= 0
                and (u8[np.uint64(held + 8 * slot + (i & 7))] >> np.uint64(8 * (j & 7) + (k & 7))) & _1
            ):
                o = np.uint64(first + slot * CELLS + (i & 7) * 243 + (j & 7) * 27 + (k & 7) * 3)
                x, y, z = x - np.float32(i), y - np.float32(j), z - np.float32(k)
                fx, fy = share * _between(f4, o, x, y, z), share * _between(f4, o + _1, x, y, z)
                fz = share * _between(f4, o + _2, x, y, z)
        if is_first:
            gx[n], gy[n], gz[n] = fx, fy, fz
        else:
            gx[n], gy[n], gz[n] = gx[n] + fx, gy[n] + fy, gz[n] + fz


@uncounted(fastmath=_FAST)
def _gather(p, g, f, columns, still, swing, least):
    """Add forces g of a part, above the square `least`, to those f of the tool's axes, with what its motion
    adds.
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


@uncounted(fastmath=_FAST, error_model="numpy")
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
    return (np.float64(sx), np.float64(sy), np.float64(sz)), (np.float64(tx), np.float64(ty), np.float64(tz))


@uncounted(forceinline=True)
def _lay_and_sample(i8, u8, f8, f4, field, share, is_first, columns, origin, p, s, g):
    """The force of a field at points of the tool; `columns`, `origin`: the tool in the part's frame, metres."""
    kx, ky, kz = three(f8, field + W.FIELD_INVERSE)
    corner = three(f8, field + W.FIELD_CORNER)
    a, b, c = columns
    rows = (
        _single((kx * a[0], kx * b[0], kx * c[0])),
        _single((ky * a[1], ky * b[1], ky * c[1])),
        _single((kz * a[2], kz * b[2], kz * c[2])),
    )
    begin = (kx * (origin[0] - corner[0]), ky * (origin[1] - corner[1]), kz * (origin[2] - corner[2]))
    _lay(p, rows, _single(begin), s)
    _sample(i8, u8, f4, field, np.float32(share), is_first, s, g)


@uncounted
def _add_part(i8, u8, f8, f4, a, b, blend, place, p, s, g, f, least):
    """Add the force of one part at some points p of a tool whose device's point is at `place`."""
    field, later = i8[np.uint64(a + W.PART_FIELD)], i8[np.uint64(b + W.PART_FIELD)]
    d = frames.arm(f8, a, b, blend, place)
    reach = math.sqrt(max(f8[np.uint64(field + W.FIELD_REACH)], f8[np.uint64(later + W.FIELD_REACH)], 0.0))
    reach += f8[W.TOOL_REACH]
    if not dot(d, d) <= reach * reach:
        return
    r, t = frames.rotation(f8, a, b, blend), rows_of(f8, W.TURN)  # t: field from tool
    origin = turned_back(r, d)
    columns = (
        turned_back(r, (t[0][0], t[1][0], t[2][0])),
        turned_back(r, (t[0][1], t[1][1], t[2][1])),
        turned_back(r, (t[0][2], t[1][2], t[2][2])),
    )
    share = 1.0 if field == later else 1.0 - blend
    _lay_and_sample(i8, u8, f8, f4, field, share, True, columns, origin, p, s, g)
    if field != later:
        _lay_and_sample(i8, u8, f8, f4, later, blend, False, columns, origin, p, s, g)
    still = turned_back(t, frames.mixed(f8, a + W.PART_MOTION, b + W.PART_MOTION, blend))
    swing = turned_back(t, frames.spin(f8, a, b, blend))
    still = plus(still, cross(swing, turned_back(t, d)))
    turn = _single(columns[0]), _single(columns[1]), _single(columns[2])
    _gather(p, g, f, turn, _single(still), _single(swing), np.float32(least))


@kernel(_nrt=False)
def tool_force(i8, u8, f8, f4, frame_a, frame_b, blend, px, py, pz):
    """The force on the tool at (px, py, pz), metres, turned by `TURN`, newtons; its torque goes to
    `FIELD_TORQUE`.
    """
    frame_a, frame_b, blend = frames.ends(frame_a, frame_b, blend)
    least, limit = (
        f8[np.uint64(frame_a + W.FRAME_FLOOR)],
        np.float32(INSIDE * f8[np.uint64(frame_a + W.FRAME_LIMIT)]),
    )
    parts = frames.part_count(i8, frame_a, frame_b)
    points, at = i8[W.TOOL_POINTS], 2 * i8[W.TOOL]
    room = at + 6 * points
    force, torque = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for begin in range(0, points, AT_ONCE):
        count = min(AT_ONCE, points - begin)
        p = _rows(f4, at + begin, count, points)
        normals = _rows(f4, at + 3 * points + begin, count, points)
        s, g = _rows(f4, room, count, AT_ONCE), _rows(f4, room + 3 * AT_ONCE, count, AT_ONCE)
        f = _rows(f4, room + 6 * AT_ONCE, count, AT_ONCE)
        f[0][:], f[1][:], f[2][:] = _0, _0, _0
        a, b = frame_a + W.FRAME_WORDS, frame_b + W.FRAME_WORDS
        for _ in range(parts):
            _add_part(i8, u8, f8, f4, a, b, blend, (px, py, pz), p, s, g, f, least)
            a, b = a + W.PART_WORDS, b + W.PART_WORDS
        some, turning = _sum(p, normals, f, limit)
        force, torque = plus(force, some), plus(torque, turning)
    t, share = rows_of(f8, W.TURN), f8[W.TOOL_SHARE]
    put(f8, W.FIELD_TORQUE, turned(t, times(share, torque)))
    return turned(t, times(share, force))


def slope_of_bin(n: int) -> float:
    """The greatest slope of a bin, N/m; from 1 to a million."""
    return float(2.0 ** ((n + 1) / _PER_DOUBLING))


@kernel(fastmath=_FAST)
def count_slopes(cells, held, inverse, counts):
    """Add to `counts`, int64 [BINS], the cells of a pool by what their force grows with a way against it,
    N/m.
    """
    for slot in range(len(held)):
        for n in range(512):
            if not (held[slot, n >> 6] >> np.uint64(n & 63)) & _1:
                continue
            o = np.uint64(slot * CELLS + (n >> 6) * 243 + ((n >> 3) & 7) * 27 + (n & 7) * 3)
            (fx, sx), (fy, sy), (fz, sz) = _middle(cells, o), _middle(cells, o + _1), _middle(cells, o + _2)
            square = fx * fx + fy * fy + fz * fz
            if not 0.0 < square < math.inf:
                continue
            way = fx * inverse[0], fy * inverse[1], fz * inverse[2]
            along = fx * dot(sx, way) + fy * dot(sy, way) + fz * dot(sz, way)
            if along < -square:
                counts[min(int(_PER_DOUBLING * math.log2(-along / square)), BINS - 1)] += 1


@inner(forceinline=True)
def _middle(cells, o):
    """The mean of the eight corners, and how it grows along x, y and z, a sample each."""
    total, x, y, z = 0.0, 0.0, 0.0, 0.0
    for c in range(8):
        value = cells[o + np.uint64(243 * (c >> 2) + 27 * ((c >> 1) & 1) + 3 * (c & 1))]
        total += value
        x += value if c & 4 else -value
        y += value if c & 2 else -value
        z += value if c & 1 else -value
    return total / 8.0, (x / 4.0, y / 4.0, z / 4.0)


@kernel
def blend_bricks(begin, end, slots, before, after, share, k, f0_n, out, held):
    """Bricks of `out` float32 [n, 1536], `share` of the way from `before` to `after`; `slots` [2, n], -1: no
    brick.

    A voxel whose two forces cannot be of one source, |after - before| > max(F_0, k |after|) + max(F_0, k
    |before|), is that of `after`. `held` bool [n] tells which bricks hold a force.
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
                nx, ny, nz = (
                    np.float32(px + share * dx),
                    np.float32(py + share * dy),
                    np.float32(pz + share * dz),
                )
            out[brick, at], out[brick, at + 1], out[brick, at + 2] = nx, ny, nz
            any_force |= (nx != zero) | (ny != zero) | (nz != zero)
        held[brick] = any_force
