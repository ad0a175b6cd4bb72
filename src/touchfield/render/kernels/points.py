"""Compiled for a GPU: the force at many points of an instant, for `DeviceSampler`.

This is what ``c/touch_query.h`` and ``c/touch_batch.h`` do on the CPU, in the same order of operations,
without deformations. Kernels read the memory of a receiver as numbers of eight bytes (i8, u8, f8) and as
float32 (f4); an offset here is an index of such a number.
"""

from __future__ import annotations

import numpy as np

from touchfield.compute.jit import inner, kernel
from touchfield.medium.kernels.placed import CELLS, GOLDEN, between, clipped
from touchfield.render.block import layout

_CELLS = {name: field[1] // 8 for name, field in (layout.CELLS.fields or {}).items()}
_BOX, _SHIFT, _TABLE = _CELLS["brick_count"], _CELLS["table_shift"], _CELLS["table_offset"]
_SUPPORTED, _SAMPLES = _CELLS["supported_offset"], _CELLS["samples_offset"]
_PER_M, _CORNER, _REACH = _CELLS["samples_per_m"], _CELLS["corner_m"], _CELLS["reach2_m2"]

_POSE = {name: field[1] // 8 for name, field in (layout.BODY_POSE.fields or {}).items()}
_FIELD, _IS_IDENTITY, _QUATERNION = _POSE["cells_offset"], _POSE["is_identity"], _POSE["quaternion"]
_POSITION, _ROTATION = _POSE["position_m"], _POSE["rotation"]
_SHIFT_N, _SPIN_N = _POSE["surface_damping_n"], _POSE["surface_damping_n_per_m"]
_POSE_SIZE = layout.BODY_POSE.itemsize // 8

_FRAME = {name: field[1] // 8 for name, field in (layout.FRAME_HEADER.fields or {}).items()}
_BODIES, _MAX_N, _FLOOR = _FRAME["body_count"], _FRAME["force_max_n"], _FRAME["force_floor2_n2"]
_HEADER_SIZE = layout.FRAME_HEADER.itemsize // 8

_ON_PLANE, _AT_FRAME = 1e-9, 1e-9  # TOUCH_ON_PLANE and TOUCH_AT_FRAME
_NONE = -1


@inner
def _vector(f8, at):
    return f8[at], f8[at + 1], f8[at + 2]


@inner
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inner
def _add_scaled(a, factor, b):
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


@inner
def _blended(f8, before, after, blend):
    """The vector between those at two offsets."""
    a, b = _vector(f8, before), _vector(f8, after)
    return _add_scaled(a, blend, (b[0] - a[0], b[1] - a[1], b[2] - a[2]))


@inner
def _cell_of(x):
    """Cell along one axis, and the fraction of the way through it; x is not negative."""
    i = np.int64(x + _ON_PLANE)
    fraction = x - i
    return i, (fraction if fraction > _ON_PLANE else 0.0)


@inner
def _find_brick(i8, table, shift, brick):
    """The index of a brick of cells, -1 if there is none."""
    mask = (np.int64(1) << (64 - shift)) - 1
    slot = np.int64((np.uint64(brick) * GOLDEN) >> np.uint64(shift))
    while i8[table + 2 * slot] != brick:
        if i8[table + 2 * slot] < 0:
            return np.int64(-1)
        slot = (slot + 1) & mask
    return i8[table + 2 * slot + 1]


@inner
def _locate(i8, u8, f8, field, p):
    """Return the corner in f4 of the cell that has a point, -1 if there is no force, and its fractions."""
    corner, per_m = _vector(f8, field + _CORNER), _vector(f8, field + _PER_M)
    x, y, z = (p[0] - corner[0]) * per_m[0], (p[1] - corner[1]) * per_m[1], (p[2] - corner[2]) * per_m[2]
    nx, ny, nz = _vector(i8, field + _BOX)
    near = 2 * _ON_PLANE
    if not (0.0 <= x < 8.0 * nx - near and 0.0 <= y < 8.0 * ny - near and 0.0 <= z < 8.0 * nz - near):
        return np.int64(_NONE), (0.0, 0.0, 0.0)
    (i, fx), (j, fy), (k, fz) = _cell_of(x), _cell_of(y), _cell_of(z)
    brick = ((i >> 3) * ny + (j >> 3)) * nz + (k >> 3)
    index = _find_brick(i8, field + i8[field + _TABLE] // 8, i8[field + _SHIFT], brick)
    if index < 0:
        return np.int64(_NONE), (0.0, 0.0, 0.0)
    row = u8[field + i8[field + _SUPPORTED] // 8 + 8 * index + (i & 7)]
    if not (row >> np.uint64(8 * (j & 7) + (k & 7))) & np.uint64(1):
        return np.int64(_NONE), (0.0, 0.0, 0.0)
    first = 2 * field + i8[field + _SAMPLES] // 4
    return first + index * CELLS + (i & 7) * 243 + (j & 7) * 27 + (k & 7) * 3, (fx, fy, fz)


@inner
def _add_cell_force(i8, u8, f8, f4, total, weight, field, p):
    """total + weight times the force of cells at a point in the axes of their body."""
    corner, (fx, fy, fz) = _locate(i8, u8, f8, field, p)
    if corner == _NONE:
        return total
    x = between(f4, np.uint64(corner), fx, fy, fz)
    y = between(f4, np.uint64(corner + 1), fx, fy, fz)
    return _add_scaled(total, weight, (x, y, between(f4, np.uint64(corner + 2), fx, fy, fz)))


@inner
def _rotation(f8, before, after, blend):
    """The rotation of a body, row by row: of both quaternions, mixed and made unit."""
    if blend == 0.0:
        at = before + _ROTATION
        return _vector(f8, at), _vector(f8, at + 3), _vector(f8, at + 6)
    p, q = before + _QUATERNION, after + _QUATERNION
    first, second = 1.0 - blend, blend
    if f8[p] * f8[q] + _dot(_vector(f8, p + 1), _vector(f8, q + 1)) < 0.0:
        second = -blend  # the short way
    w, x = first * f8[p] + second * f8[q], first * f8[p + 1] + second * f8[q + 1]
    y, z = first * f8[p + 2] + second * f8[q + 2], first * f8[p + 3] + second * f8[q + 3]
    square = w * w + x * x + y * y + z * z
    s = 2.0 / square if square > 0.0 else 0.0
    xx, yy, zz, xy, xz, yz = s * x * x, s * y * y, s * z * z, s * x * y, s * x * z, s * y * z
    wx, wy, wz = s * w * x, s * w * y, s * w * z
    return (
        (1.0 - yy - zz, xy - wz, xz + wy),
        (xy + wz, 1.0 - xx - zz, yz - wx),
        (xz - wy, yz + wx, 1.0 - xx - yy),
    )


@inner
def _own_force(i8, u8, f8, f4, before, after, blend, p):
    """The force of a body's cells at a point in its own axes."""
    field, later = i8[before + _FIELD] // 8, i8[after + _FIELD] // 8
    if field == later:
        return _add_cell_force(i8, u8, f8, f4, (0.0, 0.0, 0.0), 1.0, field, p)
    force = _add_cell_force(i8, u8, f8, f4, (0.0, 0.0, 0.0), 1.0 - blend, field, p)
    return _add_cell_force(i8, u8, f8, f4, force, blend, later, p)


@inner
def _body_force(i8, u8, f8, f4, before, after, blend, arm):
    """The force of a body at an arm from its origin, in the axes of the scene."""
    if i8[before + _IS_IDENTITY] & i8[after + _IS_IDENTITY]:
        return _own_force(i8, u8, f8, f4, before, after, blend, arm)
    r = _rotation(f8, before, after, blend)
    p = arm[0] * r[0][0], arm[0] * r[0][1], arm[0] * r[0][2]
    p = _add_scaled(_add_scaled(p, arm[1], r[1]), arm[2], r[2])
    force = _own_force(i8, u8, f8, f4, before, after, blend, p)
    return _dot(r[0], force), _dot(r[1], force), _dot(r[2], force)


@inner
def _is_far(i8, f8, before, after, arm):
    """True if no force of a body lies as far as an arm from its origin."""
    field, later = i8[before + _FIELD] // 8, i8[after + _FIELD] // 8
    return not _dot(arm, arm) <= max(f8[field + _REACH], f8[later + _REACH])


@inner
def _force_at(i8, u8, f8, f4, before, after, blend, point):
    """The force of the frames at indices `before` and `after` (`touch_stored_force`)."""
    if before == after or not blend > _AT_FRAME:
        after, blend = before, 0.0
    elif blend >= 1.0 - _AT_FRAME:
        before, blend = after, 0.0
    total = 0.0, 0.0, 0.0
    for n in range(min(i8[before + _BODIES], i8[after + _BODIES])):
        a, b = before + _HEADER_SIZE + n * _POSE_SIZE, after + _HEADER_SIZE + n * _POSE_SIZE
        position = _blended(f8, a + _POSITION, b + _POSITION, blend)
        arm = point[0] - position[0], point[1] - position[1], point[2] - position[2]
        if _is_far(i8, f8, a, b, arm):
            continue
        force = _body_force(i8, u8, f8, f4, a, b, blend, arm)
        if _dot(force, force) > f8[before + _FLOOR]:
            v, w = (
                _blended(f8, a + _SHIFT_N, b + _SHIFT_N, blend),
                _blended(f8, a + _SPIN_N, b + _SPIN_N, blend),
            )
            total = (
                total[0] + force[0] + (v[0] + (w[1] * arm[2] - w[2] * arm[1])),
                total[1] + force[1] + (v[1] + (w[2] * arm[0] - w[0] * arm[2])),
                total[2] + force[2] + (v[2] + (w[0] * arm[1] - w[1] * arm[0])),
            )
    return clipped(total[0], total[1], total[2], f8[before + _MAX_N])


@kernel
def forces_at_points(start, stop, points, blends, i8, u8, f8, f4, before, after, out):
    """Write forces at points [m, 3], each at its own of `blends` [m] or all at the only one."""
    last = blends.shape[0] - 1
    for p in range(start, stop):
        point = points[p, 0], points[p, 1], points[p, 2]
        force = _force_at(i8, u8, f8, f4, before, after, blends[min(p, last)], point)
        out[p, 0], out[p, 1], out[p, 2] = force


@kernel
def field_at_points(start, stop, points, i8, u8, f8, f4, field, weight, is_first, out):
    """Add `weight` times the forces of one field at points [m, 3] to float32 [m, 3]; write them if first."""
    for p in range(start, stop):
        point = points[p, 0], points[p, 1], points[p, 2]
        x, y, z = _add_cell_force(i8, u8, f8, f4, (0.0, 0.0, 0.0), weight, field, point)
        if is_first:
            out[p, 0], out[p, 1], out[p, 2] = x, y, z
        else:
            out[p, 0], out[p, 1], out[p, 2] = out[p, 0] + x, out[p, 1] + y, out[p, 2] + z
