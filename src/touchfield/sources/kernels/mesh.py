"""Compiled loops of the mesh source: the nearest triangle of every sample near a mesh, and the force there.

Source: the distance of a point to a triangle is h^2 + d^2, with h its height over the triangle's plane and d the
distance in it: zero inside, else the least distance to the three edges (C. Ericson, Real-Time Collision Detection,
2005, section 5.1.5, gives the same by regions). Written with heights over planes and edges, which are affine in the
position, it has no branch, and LLVM makes vector code of it over the samples of a block.

Which triangles a brick must look at is found by descent from one cell that holds the whole grid: of the triangles of
a cell, its half-sized child with centre c and radius r keeps those with d(c) <= least d(c) + 2 r that can lie in the
band, d(c) <= band + r; no other one can be nearest to any of the child's samples. Nothing is allocated for the rest of
the grid. The search is in float32, in units of the largest spacing and relative to the brick; distance and direction
are then evaluated in float64 for the triangle found.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.parallel import for_chunks
from touchfield.sources.kernels.mesh_sign import COLUMN_SHIFT, winding_at, winding_of_brick

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import Grid

__all__ = ["CLOSED", "ONE_SIDED", "TWO_SIDED", "Band", "forces_near", "triangle_table"]

CLOSED, ONE_SIDED, TWO_SIDED = 0, 1, 2
"""How a distance gets its sign: by winding number; by the pseudo-normal; by the wall's half thickness."""

_FAST = {"contract", "nnan", "nsz", "ninf"}
_WIDTH = 33  # float64 of a triangle: normal, 3 edge normals, 3 edge directions, 3 vertices, 3 lengths
_LANES = 32  # triangles that lie side by side in a tile, field by field
_FIELDS = 32 * _LANES  # of a triangle seen from a cell: 7 heights, 3 half lengths, 7 gradients, a one
_TILE = _FIELDS + 8 * _LANES  # and its squared distances to eight centres
_FLAT = 1e-12  # height over length below which a triangle is a line
_SLACK = np.float32(1e-3)  # of the largest spacing: far above the rounding of the search, far below a sample
_0 = np.float32(0)
_MUCH = np.float32(1e20)  # makes any distance the greater one
_X, _Y, _Z, _D, _ID = 0, 64, 128, 192, 256  # sections of a block's scratch memory
_FACE, _VERTEX, _EDGE = 0, 1, 4  # columns of the table of pseudo-normals


@dataclass(frozen=True)
class Band:
    """Which distances matter, and how they get their sign.

    Parameters
    ----------
    sidedness : int
        `CLOSED`, `ONE_SIDED` or `TWO_SIDED`.
    inner_m, outer_m : float
        Largest distance at which there is a force, on the negative and on the positive side; negative for none.
    half_wall_m : float
        What a two-sided sheet takes off its distances.
    pieces : float64 [n, 4]
        `ForceProfile.table`.
    """

    sidedness: int
    inner_m: float
    outer_m: float
    half_wall_m: float
    pieces: NDArray[np.float64]


# -- one triangle --------------------------------------------------------------------------------------------------


@njit(nogil=True)
def _unit(x, y, z, fallback):
    length = math.sqrt(x * x + y * y + z * z)
    if length > 0.0:
        return x / length, y / length, z / length, length
    return fallback[0], fallback[1], fallback[2], 0.0


@njit(nogil=True)
def _perpendicular(e):
    """Any unit vector at right angles to the unit vector e."""
    if abs(e[0]) < 0.6:
        x, y, z, _ = _unit(0.0, e[2], -e[1], e)
    else:
        x, y, z, _ = _unit(-e[2], 0.0, e[0], e)
    return x, y, z


@njit(cache=True, nogil=True)
def _fill_table(begin, end, vertices, triangles, table):
    e = np.empty((3, 3))
    for t in range(begin, end):
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
        # edge 0 is the longest, so that the third vertex lies over it and the cross product is at its best
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


def triangle_table(vertices_m: NDArray[np.float64], triangles: NDArray[np.int32]) -> NDArray[np.float64]:
    """Planes and edges of triangles whose longest edge is the first, float64 [m, 33]."""
    table = np.empty((len(triangles), _WIDTH))
    for_chunks(_fill_table, len(triangles), vertices_m, triangles, table, chunk=1024)
    return table


@njit(nogil=True, forceinline=True)
def _see(table, t, x, y, z, scale, reach, tiles, at):
    """What the search needs of a triangle, seen from (x, y, z), for samples within `reach` of there (scaled)."""
    for i in range(21):
        tiles[at + (10 + i) * _LANES] = np.float32(table[t, i])
    tiles[at + 31 * _LANES] = np.float32(1)
    for i in range(3):
        j = 21 + 3 * i
        dx, dy, dz = x - table[t, j], y - table[t, j + 1], z - table[t, j + 2]
        if i == 0:
            tiles[at] = np.float32((table[t, 0] * dx + table[t, 1] * dy + table[t, 2] * dz) * scale)
        j = 3 + 3 * i
        tiles[at + (1 + i) * _LANES] = np.float32((table[t, j] * dx + table[t, j + 1] * dy + table[t, j + 2] * dz) * scale)
        j = 12 + 3 * i
        along = (table[t, j] * dx + table[t, j + 1] * dy + table[t, j + 2] * dz) * scale
        length = table[t, 30 + i] * scale
        # only the part of the edge that is near: what is far would cost digits
        low = min(max(0.0, along - reach), length)
        high = max(min(length, along + reach), 0.0)
        tiles[at + (4 + i) * _LANES] = np.float32(along - 0.5 * (low + high))
        tiles[at + (7 + i) * _LANES] = np.float32(0.5 * (high - low))


@njit(nogil=True, fastmath=_FAST, forceinline=True)
def _square_distance(p, x, y, z):
    """Squared distance of (x, y, z) to the triangle that `_see` put into p."""
    h = p[0] + p[10] * x + p[11] * y + p[12] * z
    q0 = p[1] + p[13] * x + p[14] * y + p[15] * z
    q1 = p[2] + p[16] * x + p[17] * y + p[18] * z
    q2 = p[3] + p[19] * x + p[20] * y + p[21] * z
    s0 = max(abs(p[4] + p[22] * x + p[23] * y + p[24] * z) - p[7], _0)
    s1 = max(abs(p[5] + p[25] * x + p[26] * y + p[27] * z) - p[8], _0)
    s2 = max(abs(p[6] + p[28] * x + p[29] * y + p[30] * z) - p[9], _0)
    beside = min(q0 * q0 + s0 * s0, min(q1 * q1 + s1 * s1, q2 * q2 + s2 * s2))
    # inside, s0 is zero; for a sliver, whose q are all rounding, it still is the distance beyond its ends
    outside = max(max(q0, max(q1, q2)), _0) * _MUCH
    return h * h + min(beside, s0 * s0 + outside)


@njit(nogil=True, fastmath=_FAST, forceinline=True)
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


@njit(nogil=True, fastmath=_FAST)
def _sweep_centres(tile, lanes, centres, squares):
    """Squared distances of the triangles of a tile to eight centres."""
    for s in range(8):
        x, y, z = centres[_X + s], centres[_Y + s], centres[_Z + s]
        for c in range(lanes):
            squares[c + s * _LANES] = _square_distance(_load(tile, c), x, y, z)


@njit(nogil=True)
def _see_all(ids, table, x, y, z, scale, reach, centres, tiles):
    """See all triangles of a cell from its first sample, and from the centres of its eight children."""
    for c in range(len(ids)):
        _see(table, ids[c], x, y, z, scale, reach, tiles, (c // _LANES) * _TILE + c % _LANES)
    for first in range(0, len(ids), _LANES):
        lanes = min(_LANES, (len(ids) - first + 7) // 8 * 8)
        at = first // _LANES * _TILE
        _sweep_centres(tiles[at : at + _FIELDS], lanes, centres, tiles[at + _FIELDS : at + _TILE])


@njit(nogil=True, forceinline=True)
def _square(tiles, c, s):
    return tiles[(c // _LANES) * _TILE + _FIELDS + s * _LANES + c % _LANES]


@njit(nogil=True, fastmath=_FAST)
def _sweep_block(tiles, c, block):
    """Lower the 64 squared distances of a block to those of triangle c, where that is nearer."""
    at = (c // _LANES) * _TILE
    p = _load(tiles[at : at + _TILE], c % _LANES)
    number = np.float32(c)
    one = p[31]
    for s in range(64):
        square = _square_distance(p, block[_X + s], block[_Y + s], block[_Z + s])
        old, held = block[_D + s], block[_ID + s]
        is_nearer = square < old
        # times a one that the compiler does not know of: else it makes masked stores, which are slow
        block[_ID + s] = (number if is_nearer else held) * one
        block[_D + s] = (square if is_nearer else old) * one


# -- from the grid down to its bricks ------------------------------------------------------------------------------


@njit(nogil=True)
def _place_centres(block, half, steps):
    """The centres of the eight children of a cell, relative to its first sample; their radius."""
    for s in range(8):
        block[_X + s] = np.float32(((s >> 2) * half + 0.5 * (half - 1)) * steps[0])
        block[_Y + s] = np.float32((((s >> 1) & 1) * half + 0.5 * (half - 1)) * steps[1])
        block[_Z + s] = np.float32(((s & 1) * half + 0.5 * (half - 1)) * steps[2])
    diagonal = math.sqrt(steps[0] * steps[0] + steps[1] * steps[1] + steps[2] * steps[2])
    return np.float32(0.5 * (half - 1) * diagonal)


@njit(nogil=True)
def _least(tiles, count, s):
    """The number of the triangle that is nearest to centre s, and its squared distance."""
    best, least = 0, _square(tiles, 0, s)
    for c in range(1, count):
        square = _square(tiles, c, s)
        if square < least:
            best, least = c, square
    return best, least


@njit(nogil=True)
def _tiles_for(begin, end, first, last):
    """Memory for the triangles of any one cell."""
    most = 1
    for cell in range(begin, end):
        most = max(most, last[cell] - first[cell])
    return np.zeros((most + _LANES - 1) // _LANES * _TILE, np.float32)


@njit(cache=True, nogil=True)
def _descend(begin, end, cells, start, ids, table, lattice, shape, size, limits, events, keep, counts):
    """Which triangles of each cell its eight children keep: a bit for each child, and their numbers."""
    scale = 1.0 / lattice[3:].max()
    steps = lattice[3:] * scale
    half = size // 2
    block = np.empty(320, np.float32)
    radius = _place_centres(block, half, steps)
    reach = 2.0 * radius * size / max(half - 1, 1)
    tiles = _tiles_for(begin, end, start[:-1], start[1:])
    limit = max(limits[0], limits[1])
    for cell in range(begin, end):
        first, count = start[cell], start[cell + 1] - start[cell]
        i, j, k = cells[cell, 0] * size, cells[cell, 1] * size, cells[cell, 2] * size
        x, y, z = lattice[0] + i * lattice[3], lattice[1] + j * lattice[4], lattice[2] + k * lattice[5]
        _see_all(ids[first : first + count], table, x, y, z, scale, reach, block, tiles)
        keep[first : first + count] = 0
        for s in range(8):
            ci, cj, ck = i + (s >> 2) * half, j + ((s >> 1) & 1) * half, k + (s & 1) * half
            if ci >= shape[0] or cj >= shape[1] or ck >= shape[2]:
                continue
            least = np.sqrt(_least(tiles, count, s)[1])
            span = limit
            if limits[2] > _0 and least > radius + _SLACK + least * np.float32(1e-5):  # all of one sign
                is_outside = winding_at(events, ci, cj, ck, (shape[2] + 7) // 8) == 0
                span = limits[1] if is_outside else limits[0]
            if span < _0:
                continue
            far = min(least + 2 * radius, span + radius) * np.float32(1 + 1e-5) + _SLACK
            far = far * far
            kept = 0
            for c in range(count):
                if _square(tiles, c, s) <= far:
                    keep[first + c] |= 1 << s
                    kept += 1
            counts[cell, s] = kept


@njit(cache=True, nogil=True)
def _hand_down(begin, end, start, ids, keep, offsets, out):
    for cell in range(begin, end):
        for s in range(8):
            o = offsets[cell, s]
            for c in range(start[cell], start[cell + 1]):
                if (keep[c] >> s) & 1:
                    out[o] = ids[c]
                    o += 1


# -- a brick -------------------------------------------------------------------------------------------------------


@njit(nogil=True, fastmath={"contract"}, forceinline=True)
def _beside(table, t, i, x, y, z):
    """Squared distance within the plane to edge i, where along it the nearest point lies, and which side (> 0 out)."""
    e, m, a = 12 + 3 * i, 3 + 3 * i, 21 + 3 * i
    dx, dy, dz = x - table[t, a], y - table[t, a + 1], z - table[t, a + 2]
    q = table[t, m] * dx + table[t, m + 1] * dy + table[t, m + 2] * dz
    s = table[t, e] * dx + table[t, e + 1] * dy + table[t, e + 2] * dz
    along = min(max(s, 0.0), table[t, 30 + i])
    return q * q + (s - along) * (s - along), along, q


@njit(nogil=True, fastmath={"contract"}, forceinline=True)
def _nearest(table, t, x, y, z):
    """From the nearest point of a triangle to (x, y, z), float64; that point's edge (-1: the face), how far along."""
    best, along, q0 = _beside(table, t, 0, x, y, z)
    second, t1, q1 = _beside(table, t, 1, x, y, z)
    third, t2, q2 = _beside(table, t, 2, x, y, z)
    # the third vertex lies over the first edge, and so does what is inside
    if max(q0, max(q1, q2)) < 0.0 and 0.0 < along < table[t, 30]:
        h = table[t, 0] * (x - table[t, 21]) + table[t, 1] * (y - table[t, 22]) + table[t, 2] * (z - table[t, 23])
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


@njit(nogil=True, forceinline=True)
def _feature(table, t, edge, along):
    """The column of the pseudo-normals for a point of a triangle."""
    if edge < 0:
        return _FACE
    if along <= 0.0:
        return _VERTEX + edge
    if along >= table[t, 30 + edge]:
        return _VERTEX + (edge + 1) % 3
    return _EDGE + edge


@njit(nogil=True, forceinline=True)
def _amplitude(pieces, phi):
    for i in range(pieces.shape[0]):
        if pieces[i, 0] < phi <= pieces[i, 1]:
            return pieces[i, 2] + pieces[i, 3] * phi
    return 0.0


@njit(nogil=True, forceinline=True)
def _force(table, normals, t, x, y, z, is_inside, rule, pieces):
    """The force at (x, y, z), given its nearest triangle t."""
    sidedness, half_wall, tiny = rule
    dx, dy, dz, edge, along = _nearest(table, t, x, y, z)
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    if sidedness == ONE_SIDED:
        f = _feature(table, t, edge, along)
        is_inside = dx * normals[t, f, 0] + dy * normals[t, f, 1] + dz * normals[t, f, 2] < 0.0
    is_inside = is_inside and sidedness != TWO_SIDED
    amplitude = _amplitude(pieces, -distance if is_inside else distance - half_wall)
    if distance <= tiny:
        f = _feature(table, t, edge, along)
        return amplitude * normals[t, f, 0], amplitude * normals[t, f, 1], amplitude * normals[t, f, 2]
    share = amplitude / (-distance if is_inside else distance)
    return share * dx, share * dy, share * dz


@njit(nogil=True)
def _open_block(block, corner, local, shape, steps, limits, is_closed, winding):
    """Place a block's 64 samples and say how far each one looks (squared; negative: not at all); the farthest."""
    far = np.float32(-1.0)
    for s in range(64):
        i, j, k = local[0] + (s >> 4), local[1] + ((s >> 2) & 3), local[2] + (s & 3)
        block[_X + s], block[_Y + s], block[_Z + s] = i * steps[0], j * steps[1], k * steps[2]
        span = limits[0]
        if is_closed and winding[(i << 6) | (j << 3) | k] == 0:
            span = limits[1]
        if corner[0] + i >= shape[0] or corner[1] + j >= shape[1] or corner[2] + k >= shape[2]:
            span = np.float32(-1.0)
        span = span * span * np.float32(1 + 1e-4) + _SLACK * _SLACK if span >= _0 else span
        block[_D + s] = span
        block[_ID + s] = np.float32(-1.0)
        far = max(far, span)
    return far


@njit(nogil=True)
def _search_block(block, s, far, count, tiles, radius):
    """Find the nearest triangle of each sample of a block; False if none is near enough."""
    best, least = _least(tiles, count, s)
    least = np.sqrt(least)
    grown = np.float32(1 + 1e-5)
    if least > (np.sqrt(far) + radius) * grown + _SLACK:
        return False
    _sweep_block(tiles, best, block)
    far = _0
    for q in range(64):
        far = max(far, block[_D + q])
    reach = min(np.sqrt(far) + radius, least + 2 * radius) * grown + _SLACK
    reach = reach * reach
    for c in range(count):
        if _square(tiles, c, s) <= reach and c != best:
            _sweep_block(tiles, c, block)
    return True


@njit(cache=True, nogil=True)
def _fill_bricks(begin, end, near, surface, frame, events, rule, pieces, forces, held):
    """Forces of bricks; `rule` is sidedness, half wall and the distance (metres) at which directions are unsure."""
    bricks, spans, ids, columns = near
    table, normals = surface
    lattice, shape, limits = frame
    scale = 1.0 / lattice[3:].max()
    steps = lattice[3:] * scale
    steps32 = steps.astype(np.float32)
    is_closed = rule[0] == CLOSED
    centres, block = np.empty(320, np.float32), np.empty(320, np.float32)
    radius = _place_centres(centres, 4, steps)
    reach = 7.0 * math.sqrt(steps[0] ** 2 + steps[1] ** 2 + steps[2] ** 2)
    tiles = _tiles_for(begin, end, spans[:, 0], spans[:, 1])
    winding = np.zeros(512, np.int32)
    corner, local = np.empty(3, np.int64), np.empty(3, np.int64)
    low = np.empty(3)
    for b in range(begin, end):
        first, count = spans[b, 0], spans[b, 1] - spans[b, 0]
        for c in range(3):
            corner[c] = bricks[b, c] * 8
            low[c] = lattice[c] + corner[c] * lattice[3 + c]
        if is_closed:
            winding_of_brick(events, columns[b, 0], columns[b, 1], corner[0], winding)
        _see_all(ids[first : first + count], table, low[0], low[1], low[2], scale, reach, centres, tiles)
        for s in range(8):
            local[0], local[1], local[2] = (s >> 2) * 4, ((s >> 1) & 1) * 4, (s & 1) * 4
            far = _open_block(block, corner, local, shape, steps32, limits, is_closed, winding)
            if far < _0 or not _search_block(block, s, far, count, tiles, radius):
                continue
            for q in range(64):
                if block[_ID + q] < _0:
                    continue
                i, j, k = local[0] + (q >> 4), local[1] + ((q >> 2) & 3), local[2] + (q & 3)
                x = lattice[0] + (corner[0] + i) * lattice[3]
                y = lattice[1] + (corner[1] + j) * lattice[4]
                z = lattice[2] + (corner[2] + k) * lattice[5]
                t = ids[first + int(block[_ID + q])]
                is_inside = winding[(i << 6) | (j << 3) | k] != 0
                x, y, z = _force(table, normals, t, x, y, z, is_inside, rule, pieces)
                if x != 0.0 or y != 0.0 or z != 0.0:
                    forces[b, i, j, k, 0], forces[b, i, j, k, 1], forces[b, i, j, k, 2] = x, y, z
                    held[b] = True


@njit(cache=True, nogil=True)
def _close_up(forces, held):
    """Move the held bricks to the front, in place; how many there are."""
    count = 0
    for b in range(forces.shape[0]):
        if held[b]:
            if count < b:
                forces[count] = forces[b]
            count += 1
    return count


# -- all of it -----------------------------------------------------------------------------------------------------


def _bricks_near(
    table: NDArray[np.float64],
    lattice: NDArray[np.float64],
    shape: NDArray[np.int64],
    limits: NDArray[np.float32],
    events: NDArray[np.int64],
) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int32]]:
    """The bricks near a mesh in any order, where the triangles of each begin, and the triangles."""
    size = 8 << int(-(-int(shape.max()) // 8) - 1).bit_length()
    cells = np.zeros((1, 3), np.int32)
    start = np.array([0, len(table)], np.int64)
    ids = np.arange(len(table), dtype=np.int32)
    while size > 8 and len(cells):
        keep = np.empty(len(ids), np.uint8)
        counts = np.zeros((len(cells), 8), np.int64)
        arguments = (cells, start, ids, table, lattice, shape, size, limits, events, keep, counts)
        for_chunks(_descend, len(cells), *arguments)
        ends = np.cumsum(counts)
        children = np.empty(ends[-1], np.int32)
        offsets = (ends - counts.reshape(-1)).reshape(-1, 8)
        for_chunks(_hand_down, len(cells), start, ids, keep, offsets, children, chunk=64)
        parent, child = np.nonzero(counts)
        bits = np.stack([child >> 2, (child >> 1) & 1, child & 1], axis=1)
        cells = (2 * cells[parent] + bits).astype(np.int32)
        start = np.append(offsets[parent, child], ends[-1])
        ids = children
        size //= 2
    return cells, start, ids


def forces_near(
    table: NDArray[np.float64],
    normals: NDArray[np.float64],
    events: NDArray[np.int64],
    grid: Grid,
    band: Band,
    tiny_m: float,
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """The force field of a mesh: bricks int32 [n, 3] ascending, and forces float32 [n, 8, 8, 8, 3] in newtons.

    `table` from `triangle_table`; `normals` float64 [m, 7, 3]: outward pseudo-normals of each triangle's face,
    vertices and edges; `events` from `crossings`, empty unless closed; closer than `tiny_m` the direction is a
    pseudo-normal.
    """
    lattice = np.array([*grid.origin_m, *grid.spacing_m])
    shape = np.array(grid.shape, np.int64)
    scale = 1 / lattice[3:].max()
    is_closed = band.sidedness == CLOSED
    limits = np.array([band.inner_m * scale, band.outer_m * scale, is_closed], np.float32)
    bricks, start, ids = _bricks_near(table, lattice, shape, limits, events)
    _, by, bz = grid.brick_shape
    columns = bricks[:, 1].astype(np.int64) * bz + bricks[:, 2]
    order = np.argsort(bricks[:, 0].astype(np.int64) * (by * bz) + columns)
    bricks, columns = bricks[order], columns[order] << COLUMN_SHIFT
    spans = np.stack([start[:-1][order], start[1:][order]], axis=1)
    columns = np.stack([np.searchsorted(events, columns + e) for e in (0, 1 << COLUMN_SHIFT)], axis=1)
    forces = np.zeros((len(bricks), 8, 8, 8, 3), np.float32)
    held = np.zeros(len(bricks), np.bool_)
    rule = (band.sidedness, band.half_wall_m, tiny_m)
    near = (bricks, spans, ids, columns)
    for_chunks(
        _fill_bricks, len(bricks), near, (table, normals), (lattice, shape, limits), events, rule, band.pieces, forces, held
    )
    count = _close_up(forces, held)
    return bricks[held], forces[:count]
