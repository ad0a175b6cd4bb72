"""Compiled inner loop that measures the thickness of a closed mesh behind its triangles.

Cells of the size of the least thickness record which ways their triangles face. A triangle is looked at only
where a cell behind it has one that faces about the other way, so that thick meshes take little time.

A ray goes inwards from a point of a triangle, along its normal. It leaves the solid where its winding number
becomes 0: that of the triangle's own inside is 1, and each crossing adds or subtracts 1, so that parts that
overlap or touch count as one. Only walls whose far side faces about the other way count; the acute edge of a
thick body is no wall.
"""

from __future__ import annotations

import math

import numpy as np

from touchfield.arrays import Int64s
from touchfield.compute.jit import inner, kernel

_MAX_HITS = 32
_MAX_STEPS = 12  # points along each edge of a large triangle
_OPPOSITE = -0.87  # cosine between the normals of the two sides of a wall, 150 degrees
_FIRST, _SECOND = 0.3137, 0.2711  # position of a point in its part of a triangle: on no diagonal of a square


_DIVISIONS = 3  # of each edge of the cube of directions
_MARGIN = 40.0  # degrees: greatest angle between two directions of one part of the cube


@inner(forceinline=True)
def _direction(normal):
    """Return the part of the cube of directions, 0 to 53, that a normal points to."""
    x, y, z = normal[0], normal[1], normal[2]
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        face, size, u, v = 0 if x > 0.0 else 1, ax, y, z
    elif ay >= az:
        face, size, u, v = 2 if y > 0.0 else 3, ay, z, x
    else:
        face, size, u, v = 4 if z > 0.0 else 5, az, x, y
    if size == 0.0:
        return 0
    half = 0.5 * _DIVISIONS
    i = min(int(half * (u / size + 1.0)), _DIVISIONS - 1)
    j = min(int(half * (v / size + 1.0)), _DIVISIONS - 1)
    return (face * _DIVISIONS + i) * _DIVISIONS + j


def opposite_directions() -> Int64s:
    """Return masks of the directions that may be opposite to those of each part of the cube, int64 [54]."""
    middles = (2.0 * np.arange(_DIVISIONS) + 1.0) / _DIVISIONS - 1.0
    u, v = (axis.reshape(-1) for axis in np.meshgrid(middles, middles, indexing="ij"))
    parts = []
    for face in range(6):
        axis = face // 2
        part = np.empty((len(u), 3))
        part[:, axis], part[:, (axis + 1) % 3], part[:, (axis + 2) % 3] = 1.0 - 2.0 * (face % 2), u, v
        parts.append(part / np.linalg.norm(part, axis=1, keepdims=True))
    directions = np.concatenate(parts)
    limit = math.cos(math.radians(math.degrees(math.acos(_OPPOSITE)) - _MARGIN))
    is_opposite = directions @ directions.T < limit
    return (is_opposite * (np.int64(1) << np.arange(len(directions)))).sum(axis=1).astype(np.int64)


@inner(forceinline=True)
def _cell(frame, value, axis):
    index = math.floor((value - frame[axis]) * frame[3])
    return int(min(max(index, 0.0), frame[4 + axis] - 1.0))


@kernel
def mark_directions(boxes, normals, frame, directions):
    """Add the direction of each triangle to the masks of the cells that its box meets.

    frame : float64 [7]; low corner, 1 / size of a cell, and number of cells along each axis.
    directions : int64 [cells along x, y, z].
    """
    for t in range(len(boxes)):
        mask = np.int64(1) << np.int64(_direction(normals[t]))
        x0, x1 = _cell(frame, boxes[t, 0], 0), _cell(frame, boxes[t, 1], 0)
        y0, y1 = _cell(frame, boxes[t, 2], 1), _cell(frame, boxes[t, 3], 1)
        z0, z1 = _cell(frame, boxes[t, 4], 2), _cell(frame, boxes[t, 5], 2)
        for x in range(x0, x1 + 1):
            for y in range(y0, y1 + 1):
                for z in range(z0, z1 + 1):
                    directions[x, y, z] |= mask


@kernel
def mark_suspects(start, stop, boxes, normals, needed, frame, directions, opposite, is_suspect):
    """Mark triangles behind which, within `needed` metres, others face about the other way."""
    for t in range(start, stop):
        mask = opposite[_direction(normals[t])]
        n, far = normals[t], needed[t]
        x0 = _cell(frame, boxes[t, 0] - max(n[0] * far, 0.0), 0)
        x1 = _cell(frame, boxes[t, 1] - min(n[0] * far, 0.0), 0)
        y0 = _cell(frame, boxes[t, 2] - max(n[1] * far, 0.0), 1)
        y1 = _cell(frame, boxes[t, 3] - min(n[1] * far, 0.0), 1)
        z0 = _cell(frame, boxes[t, 4] - max(n[2] * far, 0.0), 2)
        z1 = _cell(frame, boxes[t, 5] - min(n[2] * far, 0.0), 2)
        for x in range(x0, x1 + 1):
            for y in range(y0, y1 + 1):
                for z in range(z0, z1 + 1):
                    if directions[x, y, z] & mask:
                        is_suspect[t] = True
                        break


@inner(forceinline=True)
def _hit(corners, u, normal, x, y, z, dx, dy, dz):
    """Return where a ray meets a triangle, as a multiple of its direction; -1 if it misses."""
    denominator = normal[0] * dx + normal[1] * dy + normal[2] * dz
    if denominator == 0.0:
        return -1.0
    a = corners[u, 0]
    t = (normal[0] * (a[0] - x) + normal[1] * (a[1] - y) + normal[2] * (a[2] - z)) / denominator
    if not 0.0 < t <= 1.0:
        return -1.0
    x, y, z = x + t * dx, y + t * dy, z + t * dz
    for c in range(3):
        p, q = corners[u, c], corners[u, (c + 1) % 3]
        ex, ey, ez = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        px, py, pz = x - p[0], y - p[1], z - p[2]
        side = normal[0] * (ey * pz - ez * py) + normal[1] * (ez * px - ex * pz)
        if side + normal[2] * (ex * py - ey * px) < 0.0:
            return -1.0
    return t


@inner
def _exit(count, distances, facings, tiny):
    """Return the index of the crossing at which the solid ends; -1 if it goes on.

    `distances` of `count` crossings are sorted; of crossings at one place the ray first enters.
    """
    for i in range(1, count):
        d, f, j = distances[i], facings[i], i - 1
        while j >= 0 and (distances[j] > d + tiny or (distances[j] > d - tiny and facings[j] > f)):
            distances[j + 1], facings[j + 1] = distances[j], facings[j]
            j -= 1
        distances[j + 1], facings[j + 1] = d, f
    winding = 1
    for i in range(count):
        if i > 0 and distances[i] - distances[i - 1] <= tiny and (facings[i] > 0.0) == (facings[i - 1] > 0.0):
            continue  # on the edge of two triangles
        winding += 1 if facings[i] < 0.0 else -1
        if winding == 0:
            return i
    return -1


@kernel
def put_in_cells(boxes, frame, slots, ids):
    """Add each triangle to every cell that its box meets, at `slots` int64 [cells].

    If `ids` is empty, triangles are only counted.
    """
    for t in range(len(boxes)):
        x0, x1 = _cell(frame, boxes[t, 0], 0), _cell(frame, boxes[t, 1], 0)
        y0, y1 = _cell(frame, boxes[t, 2], 1), _cell(frame, boxes[t, 3], 1)
        z0, z1 = _cell(frame, boxes[t, 4], 2), _cell(frame, boxes[t, 5], 2)
        for x in range(x0, x1 + 1):
            for y in range(y0, y1 + 1):
                for z in range(z0, z1 + 1):
                    s = (x * int(frame[5]) + y) * int(frame[6]) + z
                    if len(ids):
                        ids[slots[s]] = t
                    slots[s] += 1


@inner
def _crossings(ray, t, length, tiny, cells, boxes, corners, normals, distances, facings):
    """Write where a ray from triangle t crosses others, and how they face; return the number of crossings."""
    frame, starts, ids = cells
    x, y, z, dx, dy, dz = ray
    x0, x1, y0, y1 = min(x, x + dx), max(x, x + dx), min(y, y + dy), max(y, y + dy)
    z0, z1 = min(z, z + dz), max(z, z + dz)
    count = 0
    for cx in range(_cell(frame, x0, 0), _cell(frame, x1, 0) + 1):
        for cy in range(_cell(frame, y0, 1), _cell(frame, y1, 1) + 1):
            for cz in range(_cell(frame, z0, 2), _cell(frame, z1, 2) + 1):
                s = (cx * int(frame[5]) + cy) * int(frame[6]) + cz
                for e in range(starts[s], starts[s + 1]):
                    u = ids[e]
                    if boxes[u, 0] > x1 or boxes[u, 1] < x0 or boxes[u, 2] > y1 or boxes[u, 3] < y0:
                        continue
                    if boxes[u, 4] > z1 or boxes[u, 5] < z0 or u == t or count == _MAX_HITS:
                        continue
                    if cx != _cell(frame, max(x0, boxes[u, 0]), 0):
                        continue  # met in another cell
                    if cy != _cell(frame, max(y0, boxes[u, 2]), 1) or cz != _cell(
                        frame, max(z0, boxes[u, 4]), 2
                    ):
                        continue
                    at = length * _hit(corners, u, normals[u], x, y, z, dx, dy, dz)
                    if at > tiny:
                        n = normals[u]
                        distances[count], facings[count] = at, (dx * n[0] + dy * n[1] + dz * n[2]) / length
                        count += 1
    return count


@kernel
def thicknesses(start, stop, faces, cells, boxes, corners, normals, needed, tiny, found):
    """Write the least thickness behind some triangles into `found`; infinite if it is `needed` or more.

    faces : int32 [n]; triangles to measure, `start` to `stop`.
    cells : frame, starts and ids; cell s has the triangles ``ids[starts[s]:starts[s + 1]]``.
    boxes, corners, normals : float64 [m, 6], [m, 3, 3] and [m, 3], outward, of all triangles.
    needed : float64 [m], metres. tiny : distance that counts as none, metres. found : float64 [m].
    """
    distances, facings = np.empty(_MAX_HITS), np.empty(_MAX_HITS)
    for f in range(start, stop):
        t = faces[f]
        a, b, c, n = corners[t, 0], corners[t, 1], corners[t, 2], normals[t]
        length = math.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)  # the longest edge
        steps = int(min(max(math.ceil(0.5 * length / needed[t]), 1.0), float(_MAX_STEPS)))
        dx, dy, dz = -n[0] * needed[t], -n[1] * needed[t], -n[2] * needed[t]
        for i in range(steps):
            for j in range(steps - i):
                second, third = (i + _FIRST) / steps, (j + _SECOND) / steps
                x = a[0] + second * (b[0] - a[0]) + third * (c[0] - a[0])
                y = a[1] + second * (b[1] - a[1]) + third * (c[1] - a[1])
                z = a[2] + second * (b[2] - a[2]) + third * (c[2] - a[2])
                ray = (x, y, z, dx, dy, dz)
                count = _crossings(
                    ray, t, needed[t], tiny, cells, boxes, corners, normals, distances, facings
                )
                if count == 0:
                    continue
                last = _exit(count, distances, facings, tiny)
                if last >= 0 and facings[last] > -_OPPOSITE:
                    found[t] = min(found[t], distances[last])
