"""Compiled inner loops that compute the distance of a triangle to many points at once in float32, or to one
point in float64.

Source: the squared distance of a point to a triangle is h^2 + d^2, with h its height over the triangle's
plane and d the distance in it: zero inside, else the smallest of those to the three edges (C. Ericson,
Real-Time Collision Detection, 2005, section 5.1.5, gives the same by regions). Heights over planes and edges
are affine in the position, so there is no branch, and LLVM vectorises the loops over the 64 samples of a
block and over the triangles of a tile.

Functions of the innermost loops are always inlined: a call would count references to its arrays, which costs
more than their work.
"""

from __future__ import annotations

import math

import numpy as np

from touchfield.arrays import Float64s, Int32s
from touchfield.compute.jit import inner, kernel
from touchfield.compute.threads import for_chunks
from touchfield.medium.field import frozen

X, Y, Z, D, ID = 0, 64, 128, 192, 256
"""Sections of a block, float32 [320]: 64 positions, squared distances, indices of nearest triangles."""

GROUP, ALL_GROUPS = 16, 15
"""Samples of a group, of which a block has four, and the bits of all four."""

_FAST = {"contract", "nnan", "nsz"}
_WIDTH = 33  # float64 of a triangle: normal, 3 edge normals, 3 edge directions, 3 vertices, 3 lengths
_LANES = 32  # triangles that lie side by side in a tile, field by field
_FIELDS = 32 * _LANES  # of a triangle relative to a cell: 7 heights, 3 half lengths, 7 gradients, a one
_TILE = _FIELDS + 8 * _LANES  # and its squared distances to eight centres
_FLAT = 1e-12  # height over length below which a triangle is a line
_0 = np.float32(0)
_SLACK = np.float32(1e-3)  # of the largest spacing: far above the rounding of the search
_NEAR = np.float32(0.05)  # of the largest spacing: below this distance, gradients suffer from rounding
_HUGE = np.float32(1e20)  # exceeds any squared distance
_FACE, _VERTEX, _EDGE = 0, 1, 4  # columns of the table of pseudo-normals


@inner
def _unit(x, y, z, fallback):
    length = math.sqrt(x * x + y * y + z * z)
    if length > 0.0:
        return x / length, y / length, z / length, length
    return fallback[0], fallback[1], fallback[2], 0.0


@inner
def _perpendicular(e):
    """Return a unit vector perpendicular to the unit vector e."""
    if abs(e[0]) < 0.6:
        x, y, z, _ = _unit(0.0, e[2], -e[1], e)
    else:
        x, y, z, _ = _unit(-e[2], 0.0, e[0], e)
    return x, y, z


@kernel
def _fill_table(start, stop, vertices, triangles, table):
    e = np.empty((3, 3))
    for t in range(start, stop):
        row = table[t]
        fallback = (1.0, 0.0, 0.0)
        for i in range(3):
            a, b = vertices[triangles[t, i]], vertices[triangles[t, (i + 1) % 3]]
            x, y, z, length = _unit(b[0] - a[0], b[1] - a[1], b[2] - a[2], fallback)
            fallback = (x, y, z)
            e[i, 0], e[i, 1], e[i, 2] = x, y, z
            row[30 + i] = length
            for c in range(3):
                row[12 + 3 * i + c] = e[i, c]
                row[21 + 3 * i + c] = a[c]
        # edge 0 is the longest, so that the third vertex lies over it and the cross product is accurate
        x = e[0, 2] * e[2, 1] - e[0, 1] * e[2, 2]
        y = e[0, 0] * e[2, 2] - e[0, 2] * e[2, 0]
        z = e[0, 1] * e[2, 0] - e[0, 0] * e[2, 1]
        x, y, z, sine = _unit(x, y, z, fallback)
        if sine * row[32] <= _FLAT * row[30]:
            x, y, z = _perpendicular(e[0])
        row[0], row[1], row[2] = x, y, z
        for i in range(3):
            row[3 + 3 * i] = e[i, 1] * z - e[i, 2] * y
            row[4 + 3 * i] = e[i, 2] * x - e[i, 0] * z
            row[5 + 3 * i] = e[i, 0] * y - e[i, 1] * x


def as_kernel_arrays(vertices_m: Float64s, triangles: Int32s) -> tuple[Float64s, Int32s]:
    """Return both arrays in the layout for which kernels are compiled: read-only, C-contiguous."""
    return frozen(np.ascontiguousarray(vertices_m)), frozen(np.ascontiguousarray(triangles))


def triangle_table(vertices_m: Float64s, triangles: Int32s) -> Float64s:
    """Return planes and edges of triangles whose first edge is the longest, float64 [m, 33]."""
    table = np.empty((len(triangles), _WIDTH))
    for_chunks(_fill_table, len(triangles), *as_kernel_arrays(vertices_m, triangles), table, chunk=1024)
    return table


@inner(forceinline=True)
def _localise(table, t, x, y, z, scale, reach, tiles, at):
    """Write a triangle in float32, relative to (x, y, z), for samples within `reach` (scaled) of it."""
    for i in range(21):
        tiles[at + (10 + i) * _LANES] = np.float32(table[t, i])
    tiles[at + 31 * _LANES] = np.float32(1)
    for i in range(3):
        j = 21 + 3 * i
        dx, dy, dz = x - table[t, j], y - table[t, j + 1], z - table[t, j + 2]
        if i == 0:
            tiles[at] = np.float32((table[t, 0] * dx + table[t, 1] * dy + table[t, 2] * dz) * scale)
        j = 3 + 3 * i
        beyond = table[t, j] * dx + table[t, j + 1] * dy + table[t, j + 2] * dz
        tiles[at + (1 + i) * _LANES] = np.float32(beyond * scale)
        j = 12 + 3 * i
        along = (table[t, j] * dx + table[t, j + 1] * dy + table[t, j + 2] * dz) * scale
        length = table[t, 30 + i] * scale
        # only the part of the edge within reach: the rest would cost precision
        low = min(max(0.0, along - reach), length)
        high = max(min(length, along + reach), 0.0)
        tiles[at + (4 + i) * _LANES] = np.float32(along - 0.5 * (low + high))
        tiles[at + (7 + i) * _LANES] = np.float32(0.5 * (high - low))


@inner(fastmath=_FAST, forceinline=True)
def _square_distance(p, x, y, z):
    """Return the squared distance of (x, y, z) to the triangle that `_localise` wrote to p."""
    h = p[0] + p[10] * x + p[11] * y + p[12] * z
    q0 = p[1] + p[13] * x + p[14] * y + p[15] * z
    q1 = p[2] + p[16] * x + p[17] * y + p[18] * z
    q2 = p[3] + p[19] * x + p[20] * y + p[21] * z
    s0 = max(abs(p[4] + p[22] * x + p[23] * y + p[24] * z) - p[7], _0)
    s1 = max(abs(p[5] + p[25] * x + p[26] * y + p[27] * z) - p[8], _0)
    s2 = max(abs(p[6] + p[28] * x + p[29] * y + p[30] * z) - p[9], _0)
    edge_square = min(q0 * q0 + s0 * s0, min(q1 * q1 + s1 * s1, q2 * q2 + s2 * s2))
    # s0 is zero inside; for a sliver, whose q are rounding errors only, it is still the distance beyond its
    # ends
    outside = max(max(q0, max(q1, q2)), _0) * _HUGE
    return h * h + min(edge_square, s0 * s0 + outside)


@inner(fastmath=_FAST, forceinline=True)
def _load(tile, c):
    return (
        tile[c + 0 * _LANES], tile[c + 1 * _LANES], tile[c + 2 * _LANES], tile[c + 3 * _LANES],
        tile[c + 4 * _LANES], tile[c + 5 * _LANES], tile[c + 6 * _LANES], tile[c + 7 * _LANES],
        tile[c + 8 * _LANES], tile[c + 9 * _LANES], tile[c + 10 * _LANES], tile[c + 11 * _LANES],
        tile[c + 12 * _LANES], tile[c + 13 * _LANES], tile[c + 14 * _LANES], tile[c + 15 * _LANES],
        tile[c + 16 * _LANES], tile[c + 17 * _LANES], tile[c + 18 * _LANES], tile[c + 19 * _LANES],
        tile[c + 20 * _LANES], tile[c + 21 * _LANES], tile[c + 22 * _LANES], tile[c + 23 * _LANES],
        tile[c + 24 * _LANES], tile[c + 25 * _LANES], tile[c + 26 * _LANES], tile[c + 27 * _LANES],
        tile[c + 28 * _LANES], tile[c + 29 * _LANES], tile[c + 30 * _LANES], tile[c + 31 * _LANES],
    )  # fmt: skip


@inner(fastmath=_FAST)
def _sweep_centres(tile, lanes, centres, squares):
    """Compute the squared distances of the triangles of a tile to eight centres."""
    for s in range(8):
        x, y, z = centres[X + s], centres[Y + s], centres[Z + s]
        for c in range(lanes):
            squares[c + s * _LANES] = _square_distance(_load(tile, c), x, y, z)


@inner
def localise_all(ids, table, x, y, z, scale, reach, centres, tiles):
    """Write all triangles of a cell relative to its first sample, and their distances to eight centres."""
    for c in range(len(ids)):
        _localise(table, ids[c], x, y, z, scale, reach, tiles, (c // _LANES) * _TILE + c % _LANES)
    for first in range(0, len(ids), _LANES):
        lanes = min(_LANES, (len(ids) - first + 7) // 8 * 8)
        at = first // _LANES * _TILE
        _sweep_centres(tiles[at : at + _FIELDS], lanes, centres, tiles[at + _FIELDS : at + _TILE])


@inner(forceinline=True)
def square_of(tiles, c, s):
    """Return the squared distance of triangle c to centre s."""
    return tiles[(c // _LANES) * _TILE + _FIELDS + s * _LANES + c % _LANES]


@inner(fastmath=_FAST)
def sweep_block(tiles, c, block):
    """Lower the 64 squared distances of a block to those of triangle c, where that is nearer."""
    at = (c // _LANES) * _TILE
    p = _load(tiles[at : at + _TILE], c % _LANES)
    number = np.float32(c)
    unity = p[31]
    for s in range(64):
        square = _square_distance(p, block[X + s], block[Y + s], block[Z + s])
        previous, previous_id = block[D + s], block[ID + s]
        is_nearer = square < previous
        # times a 1 unknown to the compiler: otherwise it generates masked stores, which are slow
        block[ID + s] = (number if is_nearer else previous_id) * unity
        block[D + s] = (square if is_nearer else previous) * unity


@inner
def set_centres(block, half, steps):
    """Write the centres of the eight children of a cell, and return their radius.

    Centres are relative to the first sample of the cell.
    """
    for s in range(8):
        block[X + s] = np.float32(((s >> 2) * half + 0.5 * (half - 1)) * steps[0])
        block[Y + s] = np.float32((((s >> 1) & 1) * half + 0.5 * (half - 1)) * steps[1])
        block[Z + s] = np.float32(((s & 1) * half + 0.5 * (half - 1)) * steps[2])
    diagonal = math.sqrt(steps[0] * steps[0] + steps[1] * steps[1] + steps[2] * steps[2])
    return np.float32(0.5 * (half - 1) * diagonal)


@inner(fastmath=_FAST)
def nearest_to_centre(tiles, count, s):
    """Return the triangle nearest to centre s, the first of several, and its squared distance."""
    best, min_square = 0, square_of(tiles, 0, s)
    for first in range(0, count, _LANES):
        squares, lanes = _squares_of_tile(tiles, first, s), min(_LANES, count - first)
        nearer_count = 0  # a sum is vectorised, a search is not
        for c in range(lanes):
            nearer_count += squares[c] < min_square
        if nearer_count == 0:
            continue
        for c in range(lanes):
            if squares[c] < min_square:
                best, min_square = first + c, squares[c]
    return best, min_square


@inner(forceinline=True)
def _squares_of_tile(tiles, first, s):
    """Return the squared distances to centre s of the tile that starts with triangle `first`."""
    at = first // _LANES * _TILE + _FIELDS + s * _LANES
    return tiles[at : at + _LANES]


@inner(fastmath=_FAST)
def keep_near(tiles, count, s, max_square, keep):
    """Set bit s of `keep` for each triangle near centre s; return their number."""
    near_count, bit = 0, np.uint8(1 << s)
    for first in range(0, count, _LANES):
        squares, kept = _squares_of_tile(tiles, first, s), keep[first : first + _LANES]
        for c in range(min(_LANES, count - first)):
            is_near = squares[c] <= max_square
            kept[c] |= bit if is_near else np.uint8(0)
            near_count += is_near
    return near_count


# -- which triangles of a block may be nearest: bounds for its groups of 2 x 2 x 4 samples -----------------
# The distance to a triangle is a convex function of the position, so it is nowhere below its tangent plane at
# the block's centre. The plane of the triangle nearest to the centre, raised until it is above all distances
# found in a group, bounds them from above. A triangle is left out of a group where its tangent plane is above
# that one in the whole box of the group, which is so if it is at the centre of the box by more than the
# difference of the gradients allows.
@inner(fastmath=_FAST, forceinline=True)
def _offset(p, x, y, z):
    """Return the vector to (x, y, z) from the nearest point of the triangle that `_localise` wrote to p."""
    h = p[0] + p[10] * x + p[11] * y + p[12] * z
    q0 = p[1] + p[13] * x + p[14] * y + p[15] * z
    q1 = p[2] + p[16] * x + p[17] * y + p[18] * z
    q2 = p[3] + p[19] * x + p[20] * y + p[21] * z
    a0 = p[4] + p[22] * x + p[23] * y + p[24] * z
    a1 = p[5] + p[25] * x + p[26] * y + p[27] * z
    a2 = p[6] + p[28] * x + p[29] * y + p[30] * z
    s0, s1, s2 = max(abs(a0) - p[7], _0), max(abs(a1) - p[8], _0), max(abs(a2) - p[9], _0)
    first, second, third = q0 * q0 + s0 * s0, q1 * q1 + s1 * s1, q2 * q2 + s2 * s2
    is_inside = max(q0, max(q1, q2)) <= _0
    is_second = second < first and not is_inside
    is_third = third < min(first, second) and not is_inside
    q, s, a = (q1, s1, a1) if is_second else (q0, s0, a0)
    q, s, a = (q2, s2, a2) if is_third else (q, s, a)
    q, s = _0 if is_inside else q, s if a > _0 else -s
    mx, my, mz = (p[16], p[17], p[18]) if is_second else (p[13], p[14], p[15])
    mx, my, mz = (p[19], p[20], p[21]) if is_third else (mx, my, mz)
    ex, ey, ez = (p[25], p[26], p[27]) if is_second else (p[22], p[23], p[24])
    ex, ey, ez = (p[28], p[29], p[30]) if is_third else (ex, ey, ez)
    return h * p[10] + q * mx + s * ex, h * p[11] + q * my + s * ey, h * p[12] + q * mz + s * ez


@inner(fastmath=_FAST)
def gradient_of(tiles, c, centres, s):
    """Return the gradient of the distance to triangle c at centre s; 0 if the centre is on the triangle."""
    at = c // _LANES * _TILE
    p = _load(tiles[at : at + _TILE], c % _LANES)
    x, y, z = _offset(p, centres[X + s], centres[Y + s], centres[Z + s])
    distance = np.sqrt(x * x + y * y + z * z)
    scale = np.float32(1) / distance if distance > _NEAR else _0
    return x * scale, y * scale, z * scale


@inner(fastmath=_FAST)
def raise_planes(block, gradient, heights):
    """Write the height of each group's plane at the centre of the group."""
    gx, gy, gz = gradient
    for group in range(4):
        first = GROUP * group
        last, height = first + GROUP - 1, -_HUGE
        for q in range(first, first + GROUP):
            slope = gx * block[X + q] + gy * block[Y + q] + gz * block[Z + q]
            square = block[D + q]  # negative where no distance is needed
            height = max(height, np.sqrt(max(square, _0)) - slope if square >= _0 else -_HUGE)
        # the centre is the mean of two opposite corners
        height += np.float32(0.5) * gx * (block[X + first] + block[X + last])
        height += np.float32(0.5) * gy * (block[Y + first] + block[Y + last])
        height += np.float32(0.5) * gz * (block[Z + first] + block[Z + last])
        heights[group] = height * np.float32(1 + 1e-5) + _SLACK


@inner(fastmath=_FAST)
def _mark_near(tile, squares, lanes, max_square, centre, planes, steps, groups):
    """Set a bit for each group of a block that a triangle of a tile may be nearest to."""
    x, y, z = centre
    (gx, gy, gz), heights = planes
    h0, h1, h2, h3 = heights[0], heights[1], heights[2], heights[3]
    hx, hy, hz = np.float32(0.5) * steps[0], np.float32(0.5) * steps[1], np.float32(1.5) * steps[2]
    for c in range(lanes):
        vx, vy, vz = _offset(_load(tile, c), x, y, z)
        square = vx * vx + vy * vy + vz * vz
        distance = np.sqrt(square)
        # all heights times the distance, which saves a division
        spread = abs(vx - gx * distance) * hx + abs(vy - gy * distance) * hy + abs(vz - gz * distance) * hz
        low, along_x, along_y = square - spread, vx * steps[0], vy * steps[1]
        bits = np.int32(low - along_x - along_y <= distance * h0)
        bits |= np.int32(low - along_x + along_y <= distance * h1) << np.int32(1)
        bits |= np.int32(low + along_x - along_y <= distance * h2) << np.int32(2)
        bits |= np.int32(low + along_x + along_y <= distance * h3) << np.int32(3)
        bits = np.int32(ALL_GROUPS) if distance <= _NEAR else bits
        groups[c] = bits if squares[c] <= max_square else np.int32(0)


@inner(fastmath=_FAST)
def select_near(tiles, count, s, max_square, centres, planes, steps, groups, selected):
    """List the triangles of a cell that may be nearest to a sample of block s, and the bits of the groups.

    `max_square` limits the squared distance to the block's centre. `planes` are the common gradient and the
    heights of four planes; `steps` float32 [3] is the spacing. `groups` int32 [32] is scratch memory.
    `selected` int32 [count + 1, 2] receives the list. Returns its length.
    """
    found, centre = 0, (centres[X + s], centres[Y + s], centres[Z + s])
    for first in range(0, count, _LANES):
        squares, lanes = _squares_of_tile(tiles, first, s), min(_LANES, count - first)
        near_count = 0
        for c in range(lanes):
            near_count += squares[c] <= max_square
        if near_count == 0:
            continue
        at = first // _LANES * _TILE
        padded = (lanes + 7) // 8 * 8
        tile = tiles[at : at + _FIELDS]
        _mark_near(tile, squares, padded, max_square, centre, planes, steps, groups)
        for c in range(lanes):
            selected[found, 0], selected[found, 1] = first + c, groups[c]
            found += groups[c] != 0
    return found


@inner(fastmath=_FAST)
def sweep_group(tiles, c, block, group):
    """Like `sweep_block`, for the samples of one group."""
    at, first = (c // _LANES) * _TILE, GROUP * group
    p = _load(tiles[at : at + _TILE], c % _LANES)
    number = np.float32(c)
    unity = p[31]
    own = block[first:]
    xs, ys, zs = own[X : X + GROUP], own[Y : Y + GROUP], own[Z : Z + GROUP]
    squares, ids = own[D : D + GROUP], own[ID : ID + GROUP]
    for s in range(GROUP):
        square = _square_distance(p, xs[s], ys[s], zs[s])
        previous, previous_id = squares[s], ids[s]
        is_nearer = square < previous
        ids[s] = (number if is_nearer else previous_id) * unity
        squares[s] = (square if is_nearer else previous) * unity


@inner
def tiles_for(start, stop, first, last):
    """Allocate tiles for the triangles of the largest cell."""
    max_count = 1
    for cell in range(start, stop):
        max_count = max(max_count, last[cell] - first[cell])
    return np.zeros((max_count + _LANES - 1) // _LANES * _TILE, np.float32)


@inner(fastmath={"contract"}, forceinline=True)
def _edge_distance(table, t, i, x, y, z):
    """Return the squared distance in the plane to edge i, the nearest position along it, and the side.

    The side is positive outside the triangle.
    """
    e, m, a = 12 + 3 * i, 3 + 3 * i, 21 + 3 * i
    dx, dy, dz = x - table[t, a], y - table[t, a + 1], z - table[t, a + 2]
    q = table[t, m] * dx + table[t, m + 1] * dy + table[t, m + 2] * dz
    s = table[t, e] * dx + table[t, e + 1] * dy + table[t, e + 2] * dz
    along = min(max(s, 0.0), table[t, 30 + i])
    return q * q + (s - along) * (s - along), along, q


@inner(fastmath={"contract"}, forceinline=True)
def nearest(table, t, x, y, z):
    """Return the vector from the nearest point of a triangle to (x, y, z), float64.

    Also returns the edge of that point (-1: inside the face) and its position along the edge.
    """
    best, along, q0 = _edge_distance(table, t, 0, x, y, z)
    second, t1, q1 = _edge_distance(table, t, 1, x, y, z)
    third, t2, q2 = _edge_distance(table, t, 2, x, y, z)
    # the third vertex lies over the first edge, and so does every point inside the triangle
    if max(q0, max(q1, q2)) < 0.0 and 0.0 < along < table[t, 30]:
        h = (
            table[t, 0] * (x - table[t, 21])
            + table[t, 1] * (y - table[t, 22])
            + table[t, 2] * (z - table[t, 23])
        )
        return h * table[t, 0], h * table[t, 1], h * table[t, 2], -1, 0.0
    edge = 1 if second < best else 0
    along = t1 if second < best else along
    best = min(best, second)
    edge = 2 if third < best else edge
    along = t2 if third < best else along
    a, e = 21 + 3 * edge, 12 + 3 * edge
    return (
        x - table[t, a] - along * table[t, e],
        y - table[t, a + 1] - along * table[t, e + 1],
        z - table[t, a + 2] - along * table[t, e + 2],
        edge,
        along,
    )


@inner(forceinline=True)
def feature(table, t, edge, along):
    """Return the column of the pseudo-normals for a point of a triangle."""
    if edge < 0:
        return _FACE
    if along <= 0.0:
        return _VERTEX + edge
    if along >= table[t, 30 + edge]:
        return _VERTEX + (edge + 1) % 3
    return _EDGE + edge
