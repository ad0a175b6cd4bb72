"""Compiled inner loops that find which samples are inside a closed mesh: they compute its winding number from
the triangles that rays along x cross.

The winding number of a closed mesh at a point is the signed number of crossings of a ray from it. Each
triangle is rasterised in the plane (y, z) along scan lines. The first column that an edge covers is the same
for both of its triangles, because its ends are used in the order of their indices. Hence edges and vertices
that lie on a column are counted once, and all crossings of a ray add up to zero, whatever the rounding.

An event is one int64: column of bricks, y and z within it (3 bits each), first sample along x behind the
crossing (20 bits), and 1 for +1 or 0 for -1. After sorting, the events of a column are contiguous.

A surface point lies on the boundary of the union of closed meshes that intersect each other or themselves if
the winding number is 0 on exactly one side of it. A triangle that crosses others is cut along their planes
until no other surface passes through any of its pieces; each piece is then entirely boundary or entirely
inner wall, which is tested at its centre. Triangles are sorted into bins of the plane (y, z). Source of the
crossing test: T. Moeller, A fast triangle-triangle intersection test, Journal of Graphics Tools 2(2), 1997.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from touchfield.arrays import Bools, Float64s, Int32s, Int64s
from touchfield.compute.jit import inner, kernel
from touchfield.compute.threads import for_chunks
from touchfield.medium import Grid
from touchfield.sources.mesh.kernels.triangle import as_kernel_arrays

COLUMN_SHIFT = 27
_ROW_SHIFT = 21
_DROPPED = np.iinfo(np.int64).max
_MAX_CORNERS, _MAX_PIECES = 24, 96
_PER_TRIANGLE = 32  # largest mean number of bins of a triangle
_MOST_BINS = 512  # along an axis


@inner(forceinline=True, error_model="numpy")  # no divisor is zero
def line_at(vertices, triangle, z):
    """Return whether a triangle crosses the height z, and y, x of its rising and falling edge."""
    y0 = x0 = y1 = x1 = 0.0
    is_met = False
    for corner in range(3):
        u, v = triangle[corner], triangle[(corner + 1) % 3]
        is_up = vertices[v, 2] > z
        if (vertices[u, 2] > z) == is_up:
            continue
        is_met = True
        low, high = (u, v) if u < v else (v, u)
        fraction = (z - vertices[low, 2]) / (vertices[high, 2] - vertices[low, 2])
        y = vertices[low, 1] + fraction * (vertices[high, 1] - vertices[low, 1])
        x = vertices[low, 0] + fraction * (vertices[high, 0] - vertices[low, 0])
        if is_up:
            y0, x0 = y, x
        else:
            y1, x1 = y, x
    return is_met, y0, x0, y1, x1


@inner
def _index_from(position, origin, step, count):
    """Return the first sample at or after a position, 0 to count."""
    index = np.ceil((position - origin) / step)
    return int(min(max(index, 0.0), float(count)))


@kernel
def _draw(start, stop, vertices, triangles, lattice, shape, offsets, events):
    """Write the events of triangles from `offsets[t]` on.

    If `events` is empty, their number is written into `offsets[t]` instead.
    """
    bricks_z = (shape[2] + 7) // 8
    is_counted = len(events) == 0
    for t in range(start, stop):
        e = 0 if is_counted else offsets[t]
        a, b, c = vertices[triangles[t, 0], 2], vertices[triangles[t, 1], 2], vertices[triangles[t, 2], 2]
        # a range that contains all rows of the triangle
        low = np.floor((min(a, b, c) - lattice[2]) / lattice[5]) - 1.0
        high = np.ceil((max(a, b, c) - lattice[2]) / lattice[5]) + 1.0
        k0, k1 = int(min(max(low, 0.0), float(shape[2]))), int(min(max(high, -1.0), float(shape[2] - 1)))
        for k in range(k0, k1 + 1):
            z = lattice[2] + k * lattice[5]
            is_met, y0, x0, y1, x1 = line_at(vertices, triangles[t], z)
            if not is_met:
                continue
            first = _index_from(y0, lattice[1], lattice[4], shape[1])
            last = _index_from(y1, lattice[1], lattice[4], shape[1])
            sign = 1 if first <= last else 0
            if sign == 0:
                first, last, y0, y1, x0, x1 = last, first, y1, y0, x1, x0
            if is_counted:
                e += last - first
                continue
            for j in range(first, last):
                fraction = (lattice[1] + j * lattice[4] - y0) / (y1 - y0) if y1 != y0 else 0.0
                x = x0 + min(max(fraction, 0.0), 1.0) * (x1 - x0)
                i = _index_from(x, lattice[0], lattice[3], shape[0])
                column = np.int64(j >> 3) * bricks_z + (k >> 3)
                row = ((j & 7) << 3) | (k & 7)
                key = (column << COLUMN_SHIFT) | (row << _ROW_SHIFT) | (i << 1) | sign
                events[e] = key if i < shape[0] else _DROPPED
                e += 1
        if is_counted:
            offsets[t] = e


def crossings(vertices_m: Float64s, triangles: Int32s, grid: Grid) -> Int64s:
    """Return all crossings of the columns of a grid, as sorted events (see the module), int64 [n].

    `vertices_m` float64 [v, 3] in metres, `triangles` int32 [m, 3]. Crossings before the first
    sample along x count at that sample; those behind the last are dropped.
    """
    lattice = np.array([*grid.origin_m, *grid.spacing_m])
    shape = np.array(grid.shape, np.int64)
    offsets = np.zeros(len(triangles) + 1, np.int64)
    arguments = (*as_kernel_arrays(vertices_m, triangles), lattice, shape)
    for_chunks(_draw, len(triangles), *arguments, offsets[1:], np.empty(0, np.int64), chunk=512)
    np.cumsum(offsets, out=offsets)
    events = np.empty(int(offsets[-1]), np.int64)
    for_chunks(_draw, len(triangles), *arguments, offsets, events, chunk=512)
    events.sort()
    return events[: np.searchsorted(events, _DROPPED)]


@inner
def winding_of_brick(events, first, last, i0, winding):
    """Write the winding numbers of a brick, int32 [512], from the events of its column.

    `i0` is the first index along x.
    """
    winding[:] = 0
    for e in range(first, last):
        event = events[e]
        i = ((event >> 1) & ((1 << 20) - 1)) - i0
        if i < 8:
            row = (event >> _ROW_SHIFT) & 63
            winding[max(i, 0) * 64 + row] += 1 if event & 1 else -1
    for s in range(64, 512):
        winding[s] += winding[s - 64]


@kernel
def _mark_inside(events, bricks_z, shape, is_inside):
    """Mark the bricks in which a sample has a winding number other than 0."""
    e = 0
    while e < len(events):
        row = events[e] >> _ROW_SHIFT  # column of bricks, and y and z within it
        column = events[e] >> COLUMN_SHIFT
        y, z = column // bricks_z, column % bricks_z
        total, first = 0, 0
        while e < len(events) and (events[e] >> _ROW_SHIFT) == row:
            i = (events[e] >> 1) & ((1 << 20) - 1)
            if total != 0:
                for x in range(first >> 3, (i + 7) >> 3):
                    is_inside[x, y, z] = True
            total += 1 if events[e] & 1 else -1
            first = i
            e += 1
        if total != 0:
            for x in range(first >> 3, (shape[0] + 7) >> 3):
                is_inside[x, y, z] = True


def bricks_inside(events: Int64s, grid: Grid) -> Bools:
    """Return which bricks of a grid have a sample inside the mesh of these events, bool [bx, by, bz]."""
    is_inside = np.zeros(grid.brick_shape, np.bool_)
    _mark_inside(events, grid.brick_shape[2], np.array(grid.shape, np.int64), is_inside)
    return is_inside


# -- triangles in bins -------------------------------------------------------------------------------------
class Bins(NamedTuple):
    """Triangles by bins of the plane (y, z): bin s has `ids[starts[s]:starts[s + 1]]`."""

    frame: Float64s  # first y and z, widths along both, and number of bins along both
    starts: Int64s
    ids: Int32s


@inner
def _bin(frame, value, axis):
    return int(min(max(np.floor((value - frame[axis]) / frame[2 + axis]), 0.0), frame[4 + axis] - 1.0))


@kernel
def _put_in_bins(boxes, frame, slots, ids):
    """Add each triangle to every bin that its box meets, at `slots`.

    If `ids` is empty, triangles are only counted.
    """
    for t in range(len(boxes)):
        y0, y1 = _bin(frame, boxes[t, 2], 0), _bin(frame, boxes[t, 3], 0)
        z0, z1 = _bin(frame, boxes[t, 4], 1), _bin(frame, boxes[t, 5], 1)
        for y in range(y0, y1 + 1):
            for z in range(z0, z1 + 1):
                s = y * int(frame[5]) + z
                if len(ids):
                    ids[slots[s]] = t
                slots[s] += 1


def boxes_of(corners: Float64s) -> Float64s:
    """Return the boxes of triangles with corners float64 [m, 3, 3]: low and high x, y, z, float64 [m, 6]."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    return np.stack([low, high], axis=2).reshape(-1, 6)


def sorted_into_bins(boxes: Float64s) -> Bins:
    """Sort triangles with these boxes, float64 [m, 6], into bins."""
    low, high = boxes[:, 0::2].min(axis=0), boxes[:, 1::2].max(axis=0)
    span = np.maximum((high - low)[1:], 1e-12 * max(float((high - low).max()), 1e-300))
    sizes = boxes[:, 3::2] - boxes[:, 2::2]
    # as wide as a triangle: narrower ones repeat pairs, wider ones test more of them
    bins = np.clip(span / np.maximum(sizes.mean(axis=0), span / _MOST_BINS), 1, _MOST_BINS).astype(np.int64)
    while bins.max() > 1 and (
        bins.prod() > len(boxes) or ((sizes / (span / bins) + 1).prod(axis=1)).mean() > _PER_TRIANGLE
    ):
        bins[bins.argmax()] //= 2
    frame = np.array([*low[1:], *(span / bins), *bins])
    counts = np.zeros(bins.prod(), np.int64)
    _put_in_bins(boxes, frame, counts, np.empty(0, np.int32))
    starts = np.append(0, np.cumsum(counts))
    ids = np.empty(int(starts[-1]), np.int32)
    _put_in_bins(boxes, frame, starts[:-1].copy(), ids)
    return Bins(frame, starts, ids)


# -- crossing triangles ------------------------------------------------------------------------------------
@inner
def _heights(points, count, normal, base, out):
    """Write the heights of points over a plane; return the smallest and largest."""
    low, high = np.inf, -np.inf
    for i in range(count):
        h = 0.0
        for c in range(3):
            h += normal[c] * (points[i, c] - base[c])
        out[i] = h
        low, high = min(low, h), max(high, h)
    return low, high


@inner
def _span_on_line(points, count, heights, along, tiny):
    """Return the interval along a direction (x, y, z) in which a convex polygon meets a plane.

    The interval is empty if low > high.
    """
    low, high = np.inf, -np.inf
    for i in range(count):
        j = (i + 1) % count
        a = along[0] * points[i, 0] + along[1] * points[i, 1] + along[2] * points[i, 2]
        if abs(heights[i]) <= tiny:
            low, high = min(low, a), max(high, a)
        elif abs(heights[j]) > tiny and (heights[i] > 0) != (heights[j] > 0):
            b = along[0] * points[j, 0] + along[1] * points[j, 1] + along[2] * points[j, 2]
            at = a + (b - a) * heights[i] / (heights[i] - heights[j])
            low, high = min(low, at), max(high, at)
    return low, high


@inner
def _meet(piece, count, normal, other, other_normal, tiny, h, g):
    """Return True if a triangle `other` meets a convex piece along a line that divides the piece.

    Writes `h`, the heights of the piece over the plane of `other`.
    """
    low, high = _heights(piece, count, other_normal, other[0], h)
    if low >= -tiny or high <= tiny:
        return False
    low, high = _heights(other, 3, normal, piece[0], g)
    if low > tiny or high < -tiny or (low >= -tiny and high <= tiny):
        return False
    along = (  # numbers: an array would have to be allocated
        normal[1] * other_normal[2] - normal[2] * other_normal[1],
        normal[2] * other_normal[0] - normal[0] * other_normal[2],
        normal[0] * other_normal[1] - normal[1] * other_normal[0],
    )
    a0, a1 = _span_on_line(piece, count, h, along, tiny)
    b0, b1 = _span_on_line(other, 3, g, along, tiny)
    return min(a1, b1) - max(a0, b0) > tiny * np.sqrt(along[0] ** 2 + along[1] ** 2 + along[2] ** 2)


@inner(forceinline=True)
def _common_vertices(triangles, t, u):
    """Return the number of common vertices, and the corner of t and of u at the last of them."""
    count, corner_t, corner_u = 0, 0, 0
    for c in range(3):
        for d in range(3):
            if triangles[t, c] == triangles[u, d]:
                count, corner_t, corner_u = count + 1, c, d
    return count, corner_t, corner_u


@inner(forceinline=True)
def _is_on_one_side(piece, corner, normal, tiny):
    """Return True if the other two corners of a triangle lie on one side of a plane through `corner`."""
    a, b = piece[(corner + 1) % 3], piece[(corner + 2) % 3]
    h = g = 0.0
    for c in range(3):
        h += normal[c] * (a[c] - piece[corner, c])
        g += normal[c] * (b[c] - piece[corner, c])
    return (h > tiny and g > tiny) or (h < -tiny and g < -tiny)


@kernel
def _first_bins(start, stop, boxes, frame, first_bins):
    """Write the first bin of each triangle along y and along z."""
    for t in range(start, stop):
        first_bins[t, 0], first_bins[t, 1] = _bin(frame, boxes[t, 2], 0), _bin(frame, boxes[t, 4], 1)


@kernel
def _pairs(start, stop, bins, first_bins, boxes, corners, normals, triangles, tiny, max_pairs):
    """Find pairs (t, u) in which u cuts t, in a range of bins."""
    frame, starts, ids = bins
    pairs = np.empty((max_pairs, 2), np.int32)
    count = 0
    h, g = np.empty(3), np.empty(3)
    for s in range(start, stop):
        first, last = starts[s], starts[s + 1]
        y, z = s // int(frame[5]), s % int(frame[5])
        for a in range(first, last):
            box = boxes[ids[a]]
            x0, x1, y0, y1, z0, z1 = box[0], box[1], box[2], box[3], box[4], box[5]
            y_bin, z_bin = first_bins[ids[a], 0], first_bins[ids[a], 1]
            for b in range(a + 1, last):
                t, u = ids[a], ids[b]
                if max(y_bin, first_bins[u, 0]) != y or max(z_bin, first_bins[u, 1]) != z:
                    continue  # tested in another bin
                if boxes[u, 0] > x1 + tiny or boxes[u, 1] < x0 - tiny or boxes[u, 2] > y1 + tiny:
                    continue
                if boxes[u, 3] < y0 - tiny or boxes[u, 4] > z1 + tiny or boxes[u, 5] < z0 - tiny:
                    continue
                common, i, j = _common_vertices(triangles, t, u)
                if common >= 2:
                    continue
                # most neighbours at a vertex only touch there: neither crosses the other's plane elsewhere
                if common == 1 and (
                    _is_on_one_side(corners[t], i, normals[u], tiny)
                    or _is_on_one_side(corners[u], j, normals[t], tiny)
                ):
                    continue
                for _ in range(2):
                    if _meet(corners[t], 3, normals[t], corners[u], normals[u], tiny, h, g):
                        if count == max_pairs:
                            return pairs[:count]
                        pairs[count, 0], pairs[count, 1] = t, u
                        count += 1
                    t, u = u, t
    return pairs[:count]


def crossing_pairs(
    bins: Bins, boxes: Float64s, corners: Float64s, normals: Float64s, triangles: Int32s, tiny_m: float
) -> Int32s:
    """Find pairs (t, u) of triangles without a common edge in which u cuts t, int32 [p, 2], sorted by t.

    `boxes` float64 [m, 6], `corners` float64 [m, 3, 3] in metres, `normals` float64 [m, 3] of unit length.
    Heights below `tiny_m` count as touching. Pairs beyond about eight for each triangle are dropped; the
    inner walls of these triangles still exert forces.
    """
    max_pairs = 8 * len(triangles) + 4096
    first_bins = np.empty((len(boxes), 2), np.int32)
    for_chunks(_first_bins, len(boxes), boxes, bins.frame, first_bins, chunk=4096)
    arguments = (tuple(bins), first_bins, boxes, corners, normals, triangles, tiny_m, max_pairs)
    pairs = np.concatenate(for_chunks(_pairs, len(bins.starts) - 1, *arguments, chunk=64))
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


# -- cutting -----------------------------------------------------------------------------------------------
@inner(inline="always")
def _copy(rows, first, count, out, at):
    """Copy rows of three numbers one by one: numba's array copy takes a second longer to compile."""
    for i in range(count):
        for c in range(3):
            out[at + i, c] = rows[first + i, c]


@inner
def _split(piece, count, h, tiny, above, below):
    """Cut a convex polygon at height 0; return the numbers of corners above and below."""
    n = k = 0
    for i in range(count):
        j = (i + 1) % count
        if h[i] >= -tiny:
            _copy(piece, i, 1, above, n)
            n += 1
        if h[i] <= tiny:
            _copy(piece, i, 1, below, k)
            k += 1
        if (h[i] > tiny and h[j] < -tiny) or (h[i] < -tiny and h[j] > tiny):
            fraction = h[i] / (h[i] - h[j])
            for c in range(3):
                above[n, c] = below[k, c] = piece[i, c] + fraction * (piece[j, c] - piece[i, c])
            n += 1
            k += 1
    return n, k


@kernel
def cut(starts, pairs, corners, normals, tiny):
    """Cut triangles pairs[starts[i]:starts[i + 1], 0] by their partners.

    Returns pieces float64 [k, 3, 3] and the triangle of each.
    """
    out = np.empty((64, 3, 3))
    parents = np.empty(64, np.int32)
    total = 0
    pieces = np.empty((_MAX_PIECES, _MAX_CORNERS, 3))
    counts = np.empty(_MAX_PIECES, np.int64)
    above, below = np.empty((_MAX_CORNERS, 3)), np.empty((_MAX_CORNERS, 3))
    h, g = np.empty(_MAX_CORNERS), np.empty(3)
    for i in range(len(starts) - 1):
        t = pairs[starts[i], 0]
        _copy(corners[t], 0, 3, pieces[0], 0)
        counts[0] = 3
        piece_count = 1
        for p in range(starts[i], starts[i + 1]):
            u = pairs[p, 1]
            for q in range(piece_count):
                if piece_count == _MAX_PIECES or counts[q] + 2 > _MAX_CORNERS:
                    continue
                if _meet(pieces[q], counts[q], normals[t], corners[u], normals[u], tiny, h, g):
                    n, k = _split(pieces[q], counts[q], h, tiny, above, below)
                    _copy(above, 0, n, pieces[q], 0)
                    _copy(below, 0, k, pieces[piece_count], 0)
                    counts[q], counts[piece_count] = n, k
                    piece_count += 1
        for q in range(piece_count):
            for c in range(1, counts[q] - 1):
                if total == len(out):
                    larger, larger_parents = np.empty((2 * total, 3, 3)), np.empty(2 * total, np.int32)
                    for m in range(total):
                        _copy(out[m], 0, 3, larger[m], 0)
                        larger_parents[m] = parents[m]
                    out, parents = larger, larger_parents
                _copy(pieces[q], 0, 1, out[total], 0)
                _copy(pieces[q], c, 2, out[total], 1)
                parents[total] = t
                total += 1
    return out[:total], parents[:total]


# -- inside and outside ------------------------------------------------------------------------------------
@inner
def _winding(x, y, z, bins, vertices, triangles):
    """Return the winding number of a closed mesh at a point, up to its sign."""
    frame, starts, ids = bins
    if not (
        frame[0] <= y <= frame[0] + frame[2] * frame[4] and frame[1] <= z <= frame[1] + frame[3] * frame[5]
    ):
        return 0
    s = _bin(frame, y, 0) * int(frame[5]) + _bin(frame, z, 1)
    total = 0
    for e in range(starts[s], starts[s + 1]):
        is_met, y0, x0, y1, x1 = line_at(vertices, triangles[ids[e]], z)
        if not is_met or (y < y0) == (y < y1):
            continue
        fraction = (y - y0) / (y1 - y0)
        if x0 + fraction * (x1 - x0) <= x:
            total += 1 if y0 < y1 else -1
    return total


@kernel
def _classify(start, stop, corners, normals, parents, bins, vertices, triangles, tiny, is_outer):
    for t in range(start, stop):
        n = normals[parents[t]]
        a, b, c = corners[t]
        x, y, z = (a[0] + b[0] + c[0]) / 3, (a[1] + b[1] + c[1]) / 3, (a[2] + b[2] + c[2]) / 3
        x0, y0, z0 = tiny * n[0], tiny * n[1], tiny * n[2]
        front = _winding(x + x0, y + y0, z + z0, bins, vertices, triangles)
        back = _winding(x - x0, y - y0, z - z0, bins, vertices, triangles)
        is_outer[t] = (front == 0) != (back == 0)


def bounds_union(
    corners: Float64s,
    parents: Int32s,
    normals: Float64s,
    bins: Bins,
    surface: tuple[Float64s, Int32s],
    tiny_m: float,
) -> Bools:
    """Return which pieces bound the union, bool [k]: exactly one side, `tiny_m` away, is outside.

    `corners` float64 [k, 3, 3] and `parents` int32 [k] are the pieces and the triangle of each;
    `surface`: vertices in metres and triangles.
    """
    is_outer = np.empty(len(corners), np.bool_)
    for_chunks(
        _classify, len(corners), corners, normals, parents, tuple(bins), *surface, tiny_m, is_outer, chunk=256
    )
    return is_outer
