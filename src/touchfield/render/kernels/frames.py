"""Compiled: the force, its gradient and the vibration at one point and time, interpolated between two frames
in the memory that player and servo share. Deformations of the field are applied.

All that a tick asks of the field: force, gradient, vibration. Nothing is allocated. A coordinate that is not
finite, or out of all bounds, fails the test of the field's box and gives zero. The lattice of a deformation
lies behind the parts of a frame (`block.words`, WARP), what yields apart; a query sums the 64 control points
about it with the weights and slopes of a cubic B-spline.
"""

from __future__ import annotations

import math

import numpy as np

from touchfield.compute.coder_jit import uncounted
from touchfield.compute.jit import kernel
from touchfield.medium.kernels.placed import CELLS, GOLDEN, between, clipped
from touchfield.render.block import words as W
from touchfield.render.kernels.vectors import (
    along,
    cross,
    dot,
    length,
    less,
    matrix_of,
    plus,
    rows_of,
    three,
    times,
    turned,
    turned_back,
)


@uncounted(forceinline=True)
def warp_of(i8, frame):
    """The word of a frame's lattice; 0 where it has none."""
    offset = i8[np.uint64(frame + W.FRAME_WARP)]
    return frame + offset if offset > 0 else 0


@uncounted(forceinline=True)
def _weights(t, inverse):
    """A cubic B-spline in a cell: weights of four control points, and their slopes."""
    r, slope = 1.0 - t, 0.5 * inverse
    w = r * r * r / 6, (3 * t * t * t - 6 * t * t + 4) / 6, (3 * r * r * r - 6 * r * r + 4) / 6, t * t * t / 6
    return w, (-slope * r * r, slope * (3 * t * t - 4 * t), -slope * (3 * r * r - 4 * r), slope * t * t)


@uncounted(forceinline=True)
def _cell(f8, i8, warp, axis, x):
    """First control point about x along an axis, place in the cell, and 1 / spacing; 0 beyond, where u is
    flat.
    """
    inverse = f8[np.uint64(warp + W.WARP_INVERSE + axis)]
    cells = i8[np.uint64(warp + axis)] - 3
    s = (x - f8[np.uint64(warp + W.WARP_CORNER + axis)]) * inverse
    if not 0.0 <= s <= cells:
        inverse, s = 0.0, min(max(s, 0.0), 1.0 * cells) if s == s else 0.0
    i = min(np.int64(s), cells - 1)
    return i, s - i, inverse


@uncounted
def bent(i8, f8, frame_a, frame_b, blend, p):
    """Displacement u at a point, metres, and its slopes along x, y and z: four triples."""
    a, b = warp_of(i8, frame_a), warp_of(i8, frame_b)
    i, tx, hx = _cell(f8, i8, a, 0, p[0])
    j, ty, hy = _cell(f8, i8, a, 1, p[1])
    k, tz, hz = _cell(f8, i8, a, 2, p[2])
    (wx, dx), (wy, dy), (wz, dz) = _weights(tx, hx), _weights(ty, hy), _weights(tz, hz)
    u, gx, gy, gz = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for m in range(4):
        for n in range(4):
            # along z first: four control points that lie one behind the other
            c, g = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
            for o in range(4):
                v = _control(i8, f8, a, b, blend, i + m, j + n, k + o)
                c, g = along(c, wz[o], v), along(g, dz[o], v)
            u, gz = along(u, wx[m] * wy[n], c), along(gz, wx[m] * wy[n], g)
            gx, gy = along(gx, dx[m] * wy[n], c), along(gy, wx[m] * dy[n], c)
    return u, gx, gy, gz


@uncounted(forceinline=True)
def _control(i8, f8, a, b, blend, i, j, k):
    """A control point of two frames, blended, and what it yields."""
    at = 3 * ((i * i8[np.uint64(a + 1)] + j) * i8[np.uint64(a + 2)] + k)
    v = three(f8, a + W.WARP_WORDS + at)
    if b != a:
        v = plus(times(1.0 - blend, v), times(blend, three(f8, b + W.WARP_WORDS + at)))
    soft = i8[np.uint64(a + W.WARP_YIELD)]
    return plus(v, three(f8, soft + at)) if soft > 0 else v


@uncounted
def give_way(i8, f8, frame, p, force, dt):
    """Let the control points of what yields follow a force at a point for `dt` seconds, and all others go to
    rest.
    """
    warp = warp_of(i8, frame)
    soft = i8[np.uint64(warp + W.WARP_YIELD)] if warp > 0 else 0
    if soft <= 0:
        return
    stay = math.exp(-dt / f8[np.uint64(warp + W.WARP_RELAX)])
    ny, nz = i8[np.uint64(warp + 1)], i8[np.uint64(warp + 2)]
    for n in range(soft, soft + 3 * i8[np.uint64(warp)] * ny * nz):
        f8[np.uint64(n)] *= stay
    i, tx, hx = _cell(f8, i8, warp, 0, p[0])
    j, ty, hy = _cell(f8, i8, warp, 1, p[1])
    k, tz, hz = _cell(f8, i8, warp, 2, p[2])
    if hx == 0.0 or hy == 0.0 or hz == 0.0:
        return  # the point is beyond the lattice
    wx, wy, wz = _weights(tx, hx)[0], _weights(ty, hy)[0], _weights(tz, hz)[0]
    square = _square(wx) * _square(wy) * _square(wz)
    share = (1.0 - stay) * f8[np.uint64(warp + W.WARP_COMPLIANCE)] / square
    most = f8[np.uint64(warp + W.WARP_MOST)]
    for m in range(4):
        for n in range(4):
            for o in range(4):
                at = soft + 3 * (((i + m) * ny + j + n) * nz + k + o)
                w = share * wx[m] * wy[n] * wz[o]
                for c in range(3):
                    f8[at + c] = min(max(f8[at + c] + w * force[c], -most), most)


@uncounted(forceinline=True)
def _square(w):
    return w[0] * w[0] + w[1] * w[1] + w[2] * w[2] + w[3] * w[3]


NONE = np.uint64(0xFFFFFFFFFFFFFFFF)  # the corner of a cell that is zero
ON_PLANE = 1e-9
"""Samples: a point so near to a plane of the lattice lies on it, whatever the rounding of its metres says."""

_1, _2 = np.uint64(1), np.uint64(2)

UNTURNED = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@uncounted(forceinline=True)
def on_axis(x):
    """Cell along one axis, and place within it; x is not negative."""
    i = np.int64(x + ON_PLANE)
    f = x - i
    return i, (f if f > ON_PLANE else 0.0)


@uncounted(forceinline=True)
def slot_of(i8, table, shift, key):
    """The slot of a brick of cells, -1 where there is none; the table begins at word `table`."""
    mask = (_1 << np.uint64(64 - shift)) - _1
    h = (np.uint64(key) * GOLDEN) >> np.uint64(shift)
    while True:
        at = np.uint64(table) + h + h
        entry = i8[at]
        if entry == key:
            return i8[at + _1]
        if entry < 0:
            return np.int64(-1)
        h = (h + _1) & mask


@uncounted(forceinline=True)
def locate(i8, u8, f8, field, p):
    """Corner in `f4` (`NONE`: zero there) of a point of the field's own frame, metres, and its place in the
    cell.
    """
    corner, inverse = three(f8, field + W.FIELD_CORNER), three(f8, field + W.FIELD_INVERSE)
    x, y, z = (
        (p[0] - corner[0]) * inverse[0],
        (p[1] - corner[1]) * inverse[1],
        (p[2] - corner[2]) * inverse[2],
    )
    near = 2 * ON_PLANE  # the outermost planes of a box hold no force
    nx, ny, nz = three(i8, field + W.FIELD_BOX)
    if not (0.0 <= x < 8.0 * nx - near and 0.0 <= y < 8.0 * ny - near and 0.0 <= z < 8.0 * nz - near):
        return NONE, (0.0, 0.0, 0.0)
    (i, fx), (j, fy), (k, fz) = on_axis(x), on_axis(y), on_axis(z)
    at, place = np.uint64(field), (fx, fy, fz)
    key = ((i >> 3) * ny + (j >> 3)) * nz + (k >> 3)
    slot = slot_of(i8, field + i8[at + np.uint64(W.FIELD_TABLE)], i8[at + np.uint64(W.FIELD_SHIFT)], key)
    if slot < 0:
        return NONE, place
    row = u8[np.uint64(field + i8[at + np.uint64(W.FIELD_HELD)] + 8 * slot + (i & 7))]
    if not (row >> np.uint64(8 * (j & 7) + (k & 7))) & _1:
        return NONE, place
    first = 2 * (field + i8[at + np.uint64(W.FIELD_CELLS)])
    return np.uint64(first + slot * CELLS + (i & 7) * 243 + (j & 7) * 27 + (k & 7) * 3), place


@uncounted(forceinline=True)
def ends(frame_a, frame_b, blend):
    """The same instant with blend 0 wherever one frame alone tells it; beyond 0 and 1 the nearer frame."""
    if frame_a == frame_b or not blend > W.AT_A_FRAME:
        return frame_a, frame_a, 0.0
    if blend >= 1.0 - W.AT_A_FRAME:
        return frame_b, frame_b, 0.0
    return frame_a, frame_b, blend


@uncounted(forceinline=True)
def mixed(f8, a, b, blend):
    """Three numbers between those at words a and b."""
    first = three(f8, a)
    return along(first, blend, less(three(f8, b), first))


@uncounted(forceinline=True)
def arm(f8, a, b, blend, p):
    """From where a part lies to a point, metres."""
    return less(p, mixed(f8, a + W.PART_POSITION, b + W.PART_POSITION, blend))


@uncounted(forceinline=True)
def is_far(i8, f8, a, b, d):
    """True if an `arm` is longer than any force of the part's fields is far; also of one that is no number."""
    field_a, field_b = i8[np.uint64(a + W.PART_FIELD)], i8[np.uint64(b + W.PART_FIELD)]
    return not dot(d, d) <= max(
        f8[np.uint64(field_a + W.FIELD_REACH)], f8[np.uint64(field_b + W.FIELD_REACH)]
    )


@uncounted(forceinline=True)
def rotation(f8, a, b, blend):
    """R of a part in three rows: between two frames that of both quaternions, mixed and made unit."""
    if blend == 0.0:
        return rows_of(f8, a + W.PART_MATRIX)
    p, q = np.uint64(a + W.PART_QUATERNION), np.uint64(b + W.PART_QUATERNION)
    w0, v0, w1, v1 = f8[p], three(f8, p + _1), f8[q], three(f8, q + _1)
    first = 1.0 - blend
    second = blend if w0 * w1 + dot(v0, v1) >= 0.0 else -blend  # the short way
    return matrix_of(first * w0 + second * w1, along(times(first, v0), second, v1))


@uncounted(forceinline=True)
def spin(f8, a, b, blend):
    """Angular velocity times the surface damping, N/m."""
    return mixed(f8, a + W.PART_MOTION + 3, b + W.PART_MOTION + 3, blend)


@uncounted(forceinline=True)
def motion(f8, a, b, blend, d):
    """Force that the motion of a part's surface adds, newtons, the `arm` d away from where it lies."""
    return plus(mixed(f8, a + W.PART_MOTION, b + W.PART_MOTION, blend), cross(spin(f8, a, b, blend), d))


@uncounted(forceinline=True)
def part_count(i8, frame_a, frame_b):
    """Bodies that both frames have."""
    return min(i8[np.uint64(frame_a + W.FRAME_PARTS)], i8[np.uint64(frame_b + W.FRAME_PARTS)])


@uncounted(forceinline=True)
def part_force(i8, u8, f8, f4, a, b, blend, d):
    """Force of a part in the scene, its `arm` d away, without what its motion adds; of one field or of two."""
    field, last = i8[np.uint64(a + W.PART_FIELD)], i8[np.uint64(b + W.PART_FIELD)]
    is_turned = not i8[np.uint64(a + W.PART_IS_IDENTITY)] & i8[np.uint64(b + W.PART_IS_IDENTITY)]
    r = UNTURNED
    if is_turned:
        r = rotation(f8, a, b, blend)
        d = turned_back(r, d)
    g = 0.0, 0.0, 0.0
    share = 1.0 if field == last else 1.0 - blend
    while True:
        o, f = locate(i8, u8, f8, field, d)
        if o != NONE:
            force = between(f4, o, *f), between(f4, o + _1, *f), between(f4, o + _2, *f)
            g = along(g, share, force)
        if field == last:
            break
        field, share = last, blend
    return turned(r, g) if is_turned else g


@uncounted
def strongest(i8, u8, f8, f4, frame_a, frame_b, blend, p):
    """The number of the part that pushes most at a point; -1 for none."""
    a, b, blend = ends(frame_a, frame_b, blend)
    parts = part_count(i8, a, b)
    a, b = a + W.FRAME_WORDS, b + W.FRAME_WORDS
    best, most = -1, 0.0
    for part in range(parts):
        d = arm(f8, a, b, blend, p)
        if not is_far(i8, f8, a, b, d):
            size = length(part_force(i8, u8, f8, f4, a, b, blend, d))
            if size > most:
                best, most = part, size
        a, b = a + W.PART_WORDS, b + W.PART_WORDS
    return best


@uncounted(forceinline=True)
def force_between(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z):
    """`force_at`, to be part of a loop over points."""
    frame_a, frame_b, blend = ends(frame_a, frame_b, blend)
    if warp_of(i8, frame_a) > 0:
        return _bent_force(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z)
    return _plain_force(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z)


@uncounted
def _bent_force(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z):
    """(I + grad u)^T F(x + u), where a deformation bends the field."""
    u, gx, gy, gz = bent(i8, f8, frame_a, frame_b, blend, (x, y, z))
    f = _plain_force(i8, u8, f8, f4, frame_a, frame_b, blend, x + u[0], y + u[1], z + u[2])
    return f[0] + dot(gx, f), f[1] + dot(gy, f), f[2] + dot(gz, f)


@uncounted(forceinline=True)
def _plain_force(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z):
    """The force of the frames as they are stored."""
    least, limit = f8[np.uint64(frame_a + W.FRAME_FLOOR)], f8[np.uint64(frame_a + W.FRAME_LIMIT)]
    total = 0.0, 0.0, 0.0
    a, b = frame_a + W.FRAME_WORDS, frame_b + W.FRAME_WORDS
    for _ in range(part_count(i8, frame_a, frame_b)):
        d = arm(f8, a, b, blend, (x, y, z))
        if not is_far(i8, f8, a, b, d):
            g = part_force(i8, u8, f8, f4, a, b, blend, d)
            if dot(g, g) > least:
                total = plus(plus(total, g), motion(f8, a, b, blend, d))
        a, b = a + W.PART_WORDS, b + W.PART_WORDS
    return clipped(*total, limit)


@kernel(_nrt=False)
def force_at(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z):
    """F(x, t), newtons, between the frames at words `frame_a` (blend 0) and `frame_b` (blend 1); x in metres.

    Trilinear in space; the pose of a part is interpolated, and fields that differ are blended linearly in
    that pose.
    """
    return force_between(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z)


@uncounted(forceinline=True)
def _ahead(x):
    """A coordinate a little farther on, metres: far less than any spacing, far more than the rounding of a
    place.
    """
    return x + (1e-8 + 1e-12 * abs(x))


@uncounted(forceinline=True)
def gradient_at(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z, force):
    """dF_i/dx_j of `force_at`, N/m, row by row, by differences from the `force` at (x, y, z) to those just
    ahead.

    On a plane of a lattice they are those of the cell towards greater indices.
    """
    ahead = _ahead(x), _ahead(y), _ahead(z)
    p = less(force_between(i8, u8, f8, f4, frame_a, frame_b, blend, ahead[0], y, z), force)
    q = less(force_between(i8, u8, f8, f4, frame_a, frame_b, blend, x, ahead[1], z), force)
    r = less(force_between(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, ahead[2]), force)
    p, q, r = times(1.0 / (ahead[0] - x), p), times(1.0 / (ahead[1] - y), q), times(1.0 / (ahead[2] - z), r)
    return p[0], q[0], r[0], p[1], q[1], r[1], p[2], q[2], r[2]


@kernel(_nrt=False)
def vibration_at(i8, u8, f8, f4, frame, x, y, z):
    """Amplitude, newtons, interpolated, and frequency, Hz, of the corner that adds most to it; zeros for
    none.
    """
    field = i8[np.uint64(frame + W.FRAME_VIBRATION)]
    if field == 0:
        return 0.0, 0.0
    o, f = locate(i8, u8, f8, field, (x, y, z))
    if o == NONE:
        return 0.0, 0.0
    amplitude = between(f4, o, *f)
    if not amplitude > 0.0:
        return 0.0, 0.0
    largest, frequency = 0.0, 0.0
    for c in range(8):
        i, j, k = c >> 2, (c >> 1) & 1, c & 1
        corner = o + np.uint64(243 * i + 27 * j + 3 * k)
        weight = (f[0] if i else 1.0 - f[0]) * (f[1] if j else 1.0 - f[1]) * (f[2] if k else 1.0 - f[2])
        if adds_more(weight * f4[corner], largest):
            largest, frequency = weight * f4[corner], np.float64(f4[corner + _1])
    return amplitude, frequency


@uncounted(forceinline=True)
def adds_more(amplitude, largest):
    """True if an amplitude exceeds the largest before it by a millionth: rounding never decides between
    equals.
    """
    return amplitude > largest * (1.0 + 1e-6)


@kernel(_nrt=False)
def vibration_between(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z):
    """Between two frames: the amplitude linear in time, the frequency that of the frame that adds most to it."""
    frame_a, frame_b, blend = ends(frame_a, frame_b, blend)
    if warp_of(i8, frame_a) > 0:
        x, y, z = plus((x, y, z), bent(i8, f8, frame_a, frame_b, blend, (x, y, z))[0])
    amplitude, frequency = vibration_at(i8, u8, f8, f4, frame_a, x, y, z)
    if blend > 0.0:
        later_n, later_hz = vibration_at(i8, u8, f8, f4, frame_b, x, y, z)
        if adds_more(blend * later_n, (1.0 - blend) * amplitude):
            frequency = later_hz
        amplitude += blend * (later_n - amplitude)
    return amplitude, frequency
