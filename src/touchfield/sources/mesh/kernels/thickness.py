"""Compiled inner loop that measures the thickness of a closed mesh behind its triangles.

A ray goes inwards from a point of a triangle, along its normal. It leaves the solid where its winding number
becomes 0: that of the triangle's own inside is 1, and each crossing adds or subtracts 1, so that parts that
overlap or touch count as one. Only walls whose far side faces about the other way count; the acute edge of a
thick body is no wall.
"""

from __future__ import annotations

import math

import numpy as np

from touchfield.compute.jit import inner, kernel

_MAX_HITS = 32
_MAX_STEPS = 12  # points along each edge of a large triangle
_OPPOSITE = -0.87  # cosine between the normals of the two sides of a wall, 150 degrees
_FIRST, _SECOND = 0.3137, 0.2711  # position of a point in its part of a triangle: on no diagonal of a square


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


@inner
def _bin(frame, value, axis):
    return int(min(max(np.floor((value - frame[axis]) / frame[2 + axis]), 0.0), frame[4] - 1.0))


@kernel
def thicknesses(start, stop, faces, bins, boxes, corners, normals, needed, tiny, found):
    """Write the least thickness behind some triangles into `found`; infinite if it is `needed` or more.

    faces : int32 [n]; triangles to measure, `start` to `stop`.
    bins : frame, starts and ids of `touchfield.sources.mesh.kernels.sign.Bins`.
    boxes, corners, normals : float64 [m, 6], [m, 3, 3] and [m, 3], outward, of all triangles.
    needed : float64 [m], metres. tiny : distance that counts as none, metres. found : float64 [m].
    """
    frame, starts, ids = bins
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
                x0, x1 = min(x, x + dx), max(x, x + dx)
                y0, y1 = min(y, y + dy), max(y, y + dy)
                z0, z1 = min(z, z + dz), max(z, z + dz)
                count = 0
                for by in range(_bin(frame, y0, 0), _bin(frame, y1, 0) + 1):
                    for bz in range(_bin(frame, z0, 1), _bin(frame, z1, 1) + 1):
                        s = by * int(frame[4]) + bz
                        for e in range(starts[s], starts[s + 1]):
                            u = ids[e]
                            if boxes[u, 0] > x1 or boxes[u, 1] < x0 or boxes[u, 2] > y1 or boxes[u, 3] < y0:
                                continue
                            if boxes[u, 4] > z1 or boxes[u, 5] < z0 or u == t or count == _MAX_HITS:
                                continue
                            if by != _bin(frame, max(y0, boxes[u, 2]), 0):
                                continue  # met in another bin
                            if bz != _bin(frame, max(z0, boxes[u, 4]), 1):
                                continue
                            at = _hit(corners, u, normals[u], x, y, z, dx, dy, dz)
                            if at * needed[t] > tiny:
                                facing = n[0] * normals[u, 0] + n[1] * normals[u, 1] + n[2] * normals[u, 2]
                                distances[count], facings[count] = at * needed[t], -facing
                                count += 1
                if count == 0:
                    continue
                last = _exit(count, distances, facings, tiny)
                if last >= 0 and -facings[last] < _OPPOSITE:
                    found[t] = min(found[t], distances[last])
