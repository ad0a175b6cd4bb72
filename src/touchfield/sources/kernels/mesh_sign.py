"""Winding numbers of a lattice within a closed mesh: signed crossings of rays along x, sorted by column.

Source: the winding number of a closed mesh at a point is the signed number of crossings of a ray from it. Each
triangle is drawn in the plane (y, z) as scan lines, as a rasteriser does. An edge says from which column on it
counts, and says the same to both of its triangles because its ends are taken in the order of their indices. Hence
edges and vertices that lie on a column are counted once, and all crossings of a ray add up to zero, whatever the
rounding.

An event is one int64: column of bricks, y and z within it (3 bits each), first sample along x behind the crossing
(20 bits), and 1 for +1 or 0 for -1. Sorted, the events of a column lie together.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.arrays import Float64s, Int32s, Int64s
from touchfield.medium import Grid
from touchfield.medium.kernels import first_at_least
from touchfield.parallel import for_chunks

COLUMN_SHIFT = 27
_ROW_SHIFT = 21
_DROPPED = np.iinfo(np.int64).max


@njit(nogil=True, forceinline=True, error_model="numpy")  # no divisor is zero
def line_at(vertices, triangle, z):
    """True if a triangle crosses the height z; y and x there on its edge that goes up, and on the one going down."""
    y0 = x0 = y1 = x1 = 0.0
    held = False
    for corner in range(3):
        u, v = triangle[corner], triangle[(corner + 1) % 3]
        is_up = vertices[v, 2] > z
        if (vertices[u, 2] > z) == is_up:
            continue
        held = True
        low, high = (u, v) if u < v else (v, u)
        share = (z - vertices[low, 2]) / (vertices[high, 2] - vertices[low, 2])
        y = vertices[low, 1] + share * (vertices[high, 1] - vertices[low, 1])
        x = vertices[low, 0] + share * (vertices[high, 0] - vertices[low, 0])
        if is_up:
            y0, x0 = y, x
        else:
            y1, x1 = y, x
    return held, y0, x0, y1, x1


@njit(nogil=True)
def _index_from(position, origin, step, count):
    """The first sample at or after a position, 0 to count."""
    index = np.ceil((position - origin) / step)
    return int(min(max(index, 0.0), float(count)))


@njit(nogil=True)
def _scan_line(vertices, triangle, z, lattice, ny):
    """The part of the line at height z that a triangle covers: columns from, to; y and x at both ends; sign."""
    held, y0, x0, y1, x1 = line_at(vertices, triangle, z)
    if not held:
        return 0, 0, 0.0, 0.0, 0.0, 0.0, 0
    first, last = _index_from(y0, lattice[1], lattice[4], ny), _index_from(y1, lattice[1], lattice[4], ny)
    if first <= last:
        return first, last, y0, y1, x0, x1, 1
    return last, first, y1, y0, x1, x0, 0


@njit(nogil=True)
def _rows_of(vertices, triangle, lattice, nz):
    """A range of z indices that holds all those the triangle covers."""
    a, b, c = vertices[triangle[0], 2], vertices[triangle[1], 2], vertices[triangle[2], 2]
    low = np.floor((min(a, b, c) - lattice[2]) / lattice[5]) - 1.0
    high = np.ceil((max(a, b, c) - lattice[2]) / lattice[5]) + 1.0
    return int(min(max(low, 0.0), float(nz))), int(min(max(high, -1.0), float(nz - 1)))


@njit(cache=True, nogil=True)
def _draw(begin, end, vertices, triangles, lattice, shape, offsets, events):
    """The events of triangles, from `offsets[t]` on; where there is no room for any, their numbers, in offsets[t]."""
    bricks_z = (shape[2] + 7) // 8
    is_counted = len(events) == 0
    for t in range(begin, end):
        e = 0 if is_counted else offsets[t]
        k0, k1 = _rows_of(vertices, triangles[t], lattice, shape[2])
        for k in range(k0, k1 + 1):
            z = lattice[2] + k * lattice[5]
            first, last, y0, y1, x0, x1, sign = _scan_line(vertices, triangles[t], z, lattice, shape[1])
            if is_counted:
                e += last - first
                continue
            for j in range(first, last):
                share = (lattice[1] + j * lattice[4] - y0) / (y1 - y0) if y1 != y0 else 0.0
                x = x0 + min(max(share, 0.0), 1.0) * (x1 - x0)
                i = _index_from(x, lattice[0], lattice[3], shape[0])
                column = np.int64(j >> 3) * bricks_z + (k >> 3)
                row = ((j & 7) << 3) | (k & 7)
                key = (column << COLUMN_SHIFT) | (row << _ROW_SHIFT) | (i << 1) | sign
                events[e] = key if i < shape[0] else _DROPPED
                e += 1
        if is_counted:
            offsets[t] = e


def crossings(vertices_m: Float64s, triangles: Int32s, grid: Grid) -> Int64s:
    """All crossings of the grid's columns, as sorted events (see the module), int64 [n].

    `vertices_m` float64 [v, 3] in metres, `triangles` int32 [m, 3]. Those before the grid's first sample along x
    count there; those behind its last are left out.
    """
    lattice = np.array([*grid.origin_m, *grid.spacing_m])
    shape = np.array(grid.shape, np.int64)
    offsets = np.zeros(len(triangles) + 1, np.int64)
    work = (vertices_m, triangles, lattice, shape)
    for_chunks(_draw, len(triangles), *work, offsets[1:], np.empty(0, np.int64), chunk=512)
    np.cumsum(offsets, out=offsets)
    events = np.empty(int(offsets[-1]), np.int64)
    for_chunks(_draw, len(triangles), *work, offsets, events, chunk=512)
    events.sort()
    return events[: np.searchsorted(events, _DROPPED)]


@njit(nogil=True)
def winding_at(events, i, j, k, bricks_z):
    """The winding number at sample (i, j, k)."""
    column = np.int64(j >> 3) * bricks_z + (k >> 3)
    base = (column << COLUMN_SHIFT) | ((((j & 7) << 3) | (k & 7)) << _ROW_SHIFT)
    end = base + ((i + 1) << 1)
    total, e = 0, first_at_least(events, base)
    while e < len(events) and events[e] < end:
        total += 1 if events[e] & 1 else -1
        e += 1
    return total


@njit(nogil=True)
def winding_of_brick(events, first, last, i0, winding):
    """Winding numbers of a brick's samples, int32 [512], from the events of its column; i0 is its first x index."""
    winding[:] = 0
    for e in range(first, last):
        event = events[e]
        i = ((event >> 1) & ((1 << 20) - 1)) - i0
        if i < 8:
            row = (event >> _ROW_SHIFT) & 63
            winding[max(i, 0) * 64 + row] += 1 if event & 1 else -1
    for s in range(64, 512):
        winding[s] += winding[s - 64]
