"""Compiled: the force at a point between two frames of the block (layout: `block.frames`).

All that a tick asks of the field: force, gradient, vibration. Nothing is allocated. A coordinate that is not finite,
or out of all bounds, fails the test of the field's box and gives zero.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.lean import UNCOUNTED
from touchfield.medium.kernels.cell import CELLS, GOLDEN, XY, XYZ, XZ, YZ, X, Y, Z, between
from touchfield.medium.kernels.placed import INSIDE, shortened
from touchfield.render.block import words as W

NONE = np.uint64(0xFFFFFFFFFFFFFFFF)
"""The corner of a cell that is zero."""

ON_PLANE = 1e-9
"""Samples: a point so near to a plane of the lattice lies on it, whatever the rounding of its metres says."""

_1, _2, _3 = np.uint64(1), np.uint64(2), np.uint64(3)

_BX, _BY, _BZ = np.uint64(W.FIELD_BOX), np.uint64(W.FIELD_BOX + 1), np.uint64(W.FIELD_BOX + 2)
_CX, _CY, _CZ = np.uint64(W.FIELD_CORNER), np.uint64(W.FIELD_CORNER + 1), np.uint64(W.FIELD_CORNER + 2)
_IX, _IY, _IZ = np.uint64(W.FIELD_INVERSE), np.uint64(W.FIELD_INVERSE + 1), np.uint64(W.FIELD_INVERSE + 2)


@njit(**UNCOUNTED, forceinline=True)
def on_axis(x):
    """Which cell along one axis, and how far into it; x is not negative."""
    i = np.int64(x + ON_PLANE)
    f = x - i
    return i, (f if f > ON_PLANE else 0.0)


@njit(**UNCOUNTED, forceinline=True)
def slot_of(i8, table, shift, key):
    """The slot of a brick of cells, -1 where there is none; the table begins at word `table`."""
    mask = (_1 << np.uint64(64 - shift)) - _1
    h = (np.uint64(key) * GOLDEN) >> np.uint64(shift)
    while True:
        at = np.uint64(table) + h + h
        found = i8[at]
        if found == key:
            return i8[at + _1]
        if found < 0:
            return np.int64(-1)
        h = (h + _1) & mask


@njit(**UNCOUNTED, forceinline=True)
def corner_of(i8, u8, field, i, j, k):
    """Where in `f4` the first corner of cell (i, j, k) of the box lies; `NONE` where all its corners are zero."""
    at = np.uint64(field)
    key = ((i >> 3) * i8[at + _BY] + (j >> 3)) * i8[at + _BZ] + (k >> 3)
    slot = slot_of(i8, field + i8[at + np.uint64(W.FIELD_TABLE)], i8[at + np.uint64(W.FIELD_SHIFT)], key)
    if slot < 0:
        return NONE
    row = u8[np.uint64(field + i8[at + np.uint64(W.FIELD_HELD)] + 8 * slot + (i & 7))]
    if not (row >> np.uint64(8 * (j & 7) + (k & 7))) & _1:
        return NONE
    first = 2 * (field + i8[at + np.uint64(W.FIELD_CELLS)])
    return np.uint64(first + slot * CELLS + (i & 7) * 243 + (j & 7) * 27 + (k & 7) * 3)


@njit(**UNCOUNTED, forceinline=True)
def locate(i8, u8, f8, field, x, y, z):
    """Corner in `f4` (`NONE`: zero there) of a point of the field's own frame, metres, and its place in the cell."""
    at = np.uint64(field)
    x = (x - f8[at + _CX]) * f8[at + _IX]
    y = (y - f8[at + _CY]) * f8[at + _IY]
    z = (z - f8[at + _CZ]) * f8[at + _IZ]
    near = 2 * ON_PLANE  # the outermost planes of a box hold no force
    is_inside = 0.0 <= x < 8.0 * i8[at + _BX] - near
    is_inside = is_inside and 0.0 <= y < 8.0 * i8[at + _BY] - near
    is_inside = is_inside and 0.0 <= z < 8.0 * i8[at + _BZ] - near
    if not is_inside:
        return NONE, 0.0, 0.0, 0.0
    i, fx = on_axis(x)
    j, fy = on_axis(y)
    k, fz = on_axis(z)
    return corner_of(i8, u8, field, i, j, k), fx, fy, fz


@njit(**UNCOUNTED, forceinline=True)
def slopes(f4, o, fx, fy, fz):
    """Derivatives of `between` along x, y and z, for one sample."""
    a0, b0 = np.float64(f4[o]), np.float64(f4[o + Y])
    c0, d0 = np.float64(f4[o + X]), np.float64(f4[o + XY])
    az, bz = np.float64(f4[o + Z]) - a0, np.float64(f4[o + YZ]) - b0
    cz, dz = np.float64(f4[o + XZ]) - c0, np.float64(f4[o + XYZ]) - d0
    a, b, c, d = a0 + fz * az, b0 + fz * bz, c0 + fz * cz, d0 + fz * dz
    low, high = az + fy * (bz - az), cz + fy * (dz - cz)
    return c + fy * (d - c) - (a + fy * (b - a)), (b - a) + fx * ((d - c) - (b - a)), low + fx * (high - low)


# -- one part: where it lies, how it is turned, what its motion adds ----------------------------------------------

UNTURNED = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@njit(**UNCOUNTED, forceinline=True)
def ends(frame_a, frame_b, blend):
    """The same instant with blend 0 wherever one frame alone tells it; beyond 0 and 1 the nearer frame."""
    if frame_a == frame_b or not blend > W.AT_A_FRAME:
        return frame_a, frame_a, 0.0
    if blend >= 1.0 - W.AT_A_FRAME:
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
    a, b = a + W.PART_POSITION, b + W.PART_POSITION
    return x - mixed(f8, a, b, blend), y - mixed(f8, a + 1, b + 1, blend), z - mixed(f8, a + 2, b + 2, blend)


@njit(**UNCOUNTED, forceinline=True)
def is_far(i8, f8, a, b, x, y, z):
    """Whether an `arm` is longer than any force of the part's fields is far; one that is no number is."""
    field_a, field_b = i8[np.uint64(a + W.PART_FIELD)], i8[np.uint64(b + W.PART_FIELD)]
    reach_a, reach_b = f8[np.uint64(field_a + W.FIELD_REACH)], f8[np.uint64(field_b + W.FIELD_REACH)]
    return not x * x + y * y + z * z <= max(reach_a, reach_b)


@njit(**UNCOUNTED, forceinline=True)
def rotation(f8, a, b, blend):
    """R of a part in three rows: between two frames that of both quaternions, mixed and made unit."""
    if blend == 0.0:
        m = np.uint64(a + W.PART_MATRIX)
        n, o = m + _3, m + _3 + _3
        return (f8[m], f8[m + _1], f8[m + _2]), (f8[n], f8[n + _1], f8[n + _2]), (f8[o], f8[o + _1], f8[o + _2])
    p, q = np.uint64(a + W.PART_QUATERNION), np.uint64(b + W.PART_QUATERNION)
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
    v, w = a + W.PART_MOTION + 3, b + W.PART_MOTION + 3
    return mixed(f8, v, w, blend), mixed(f8, v + 1, w + 1, blend), mixed(f8, v + 2, w + 2, blend)


@njit(**UNCOUNTED, forceinline=True)
def motion(f8, a, b, blend, dx, dy, dz):
    """What the motion of a part's surface adds, newtons, the `arm` (dx, dy, dz) away from where it lies."""
    v, w = a + W.PART_MOTION, b + W.PART_MOTION
    wx, wy, wz = spin(f8, a, b, blend)
    x = mixed(f8, v, w, blend) + wy * dz - wz * dy
    y = mixed(f8, v + 1, w + 1, blend) + wz * dx - wx * dz
    z = mixed(f8, v + 2, w + 2, blend) + wx * dy - wy * dx
    return x, y, z


# -- the force ------------------------------------------------------------------------------------------------------


@njit(**UNCOUNTED, forceinline=True)
def part_count(i8, frame_a, frame_b):
    """Bodies that both frames have."""
    return min(i8[np.uint64(frame_a + W.FRAME_PARTS)], i8[np.uint64(frame_b + W.FRAME_PARTS)])


@njit(**UNCOUNTED, forceinline=True)
def part_force(i8, u8, f8, f4, a, b, blend, dx, dy, dz):
    """Force of a part in the scene, its `arm` (dx, dy, dz) away, without what its motion adds.

    The loop goes over the field in the first frame and, if it is another one, that in the second.
    """
    field, last = i8[np.uint64(a + W.PART_FIELD)], i8[np.uint64(b + W.PART_FIELD)]
    is_turned = not i8[np.uint64(a + W.PART_IS_IDENTITY)] & i8[np.uint64(b + W.PART_IS_IDENTITY)]
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
    least, limit = f8[np.uint64(frame_a + W.FRAME_FLOOR)], f8[np.uint64(frame_a + W.FRAME_LIMIT)]
    sx, sy, sz = 0.0, 0.0, 0.0
    a, b = frame_a + W.FRAME_WORDS, frame_b + W.FRAME_WORDS
    for _ in range(part_count(i8, frame_a, frame_b)):
        dx, dy, dz = arm(f8, a, b, blend, x, y, z)
        if not is_far(i8, f8, a, b, dx, dy, dz):
            gx, gy, gz = part_force(i8, u8, f8, f4, a, b, blend, dx, dy, dz)
            if gx * gx + gy * gy + gz * gz > least:
                mx, my, mz = motion(f8, a, b, blend, dx, dy, dz)
                sx, sy, sz = sx + gx + mx, sy + gy + my, sz + gz + mz
        a, b = a + W.PART_WORDS, b + W.PART_WORDS
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
    field, last = i8[np.uint64(a + W.PART_FIELD)], i8[np.uint64(b + W.PART_FIELD)]
    r = rotation(f8, a, b, blend)
    px, py, pz = turned_back(r, dx, dy, dz)
    p, q, s = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    share = 1.0 if field == last else 1.0 - blend
    while True:
        o, fx, fy, fz = locate(i8, u8, f8, field, px, py, pz)
        if o != NONE:
            at = np.uint64(field + W.FIELD_INVERSE)
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
    least, limit = f8[np.uint64(frame_a + W.FRAME_FLOOR)], f8[np.uint64(frame_a + W.FRAME_LIMIT)]
    sx, sy, sz = 0.0, 0.0, 0.0
    along_x, along_y, along_z = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    a, b = frame_a + W.FRAME_WORDS, frame_b + W.FRAME_WORDS
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
        a, b = a + W.PART_WORDS, b + W.PART_WORDS
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
    field = i8[np.uint64(frame + W.FRAME_VIBRATION)]
    if field == 0:
        return 0.0, 0.0
    o, fx, fy, fz = locate(i8, u8, f8, field, x, y, z)
    if o == NONE:
        return 0.0, 0.0
    amplitude = between(f4, o, fx, fy, fz)
    if not amplitude > 0.0:
        return 0.0, 0.0
    at = np.uint64(field + W.FIELD_INVERSE)
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
