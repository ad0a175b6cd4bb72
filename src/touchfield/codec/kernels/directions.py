"""The compiled core of `touchfield.codec.directions`: the nearest vertex, by a table over the octahedral map.

The map takes a vector to its sum-normalised point on the octahedron |x| + |y| + |z| = 1 and unfolds that to a
square. In a cell of the square each dot product is linear (a cell on a fold is two triangles, whose corners are
corners of the cell), so that "j beats n somewhere in the cell" is decided at its corners. A cell keeps every vertex
that is not beaten at all four corners by the vertex nearest to the centre: the list cannot miss the nearest.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64s = NDArray[np.float64]
    Float32s = NDArray[np.float32]
    Int32s = NDArray[np.int32]
    Indices = NDArray[np.uint16]
    Cells = tuple[NDArray[np.int32], NDArray[np.int32]]

__all__ = ["cells", "dots", "nearest"]

_PIECE = 1 << 14
_COARSE = 16
_MARGIN = 1e-9  # of a dot product; the rounding of a vector to a cell is about 1e-15


@njit(cache=True, nogil=True)
def _on_octahedron(u, v):
    """The point of the octahedron for u, v in -1..1."""
    z = 1.0 - abs(u) - abs(v)
    if z < 0.0:
        return math.copysign(1.0 - abs(v), u), math.copysign(1.0 - abs(u), v), z
    return u, v, z


@njit(cache=True, nogil=True)
def _candidates(vertices, pool, count, u, v, size, out):
    """Those of the first `count` of `pool` that are nearest somewhere in the cell at u, v; their number."""
    x, y, z = _on_octahedron(u + size / 2, v + size / 2)
    best, winner = -2.0, 0
    for m in range(count):
        j = pool[m]
        dot = vertices[j, 0] * x + vertices[j, 1] * y + vertices[j, 2] * z
        if dot > best:
            best, winner = dot, j
    found = 0
    for m in range(count):
        j = pool[m]
        dx = vertices[j, 0] - vertices[winner, 0]
        dy = vertices[j, 1] - vertices[winner, 1]
        dz = vertices[j, 2] - vertices[winner, 2]
        for corner in range(4):
            x, y, z = _on_octahedron(u + size * (corner & 1), v + size * (corner >> 1))
            if dx * x + dy * y + dz * z >= -_MARGIN:
                out[found] = j
                found += 1
                break
    return found


@njit(cache=True, nogil=True)
def _cells(vertices, side, table, lists):
    """Fill the table; the length that the lists need, of which only what there is room for is written."""
    n = vertices.shape[0]
    everything = np.empty(n, np.int32)
    for j in range(n):
        everything[j] = j
    coarse, fine = np.empty(n, np.int32), np.empty(n, np.int32)
    used = 0
    ratio, size = side // _COARSE, 2.0 / side
    for a in range(_COARSE):
        for b in range(_COARSE):
            u, v = a * ratio * size - 1.0, b * ratio * size - 1.0
            near = _candidates(vertices, everything, n, u, v, ratio * size, coarse)
            for i in range(a * ratio, (a + 1) * ratio):
                for j in range(b * ratio, (b + 1) * ratio):
                    found = _candidates(vertices, coarse, near, i * size - 1.0, j * size - 1.0, size, fine)
                    if found == 1:
                        table[i * side + j] = fine[0]
                        continue
                    table[i * side + j] = -1 - used
                    if used + found < lists.shape[0]:
                        lists[used] = found
                        for m in range(found):
                            lists[used + 1 + m] = fine[m]
                    used += found + 1
    return used


def cells(vertices: Float64s, side: int) -> Cells:
    """The table for a codebook.

    Parameters
    ----------
    vertices : float64 [n, 3]
        Unit vectors.
    side : int
        Cells along an edge of the square, a multiple of 32.

    Returns
    -------
    table : int32 [side * side]
        A vertex, or -1 - the place of a list of candidates.
    lists : int32 [any]
        Lists one after the other: their length, and the candidates in ascending order.
    """
    table = np.empty(side * side, np.int32)
    lists = np.empty(4 * side * side, np.int32)
    used = _cells(vertices, side, table, lists)
    if used > len(lists):  # more than 4 vertices to an average cell
        lists = np.empty(used, np.int32)
        _cells(vertices, side, table, lists)
    return table, lists[:used].copy()


@njit(cache=True, nogil=True)
def _nearest(begin, end, vectors, vertices, table, lists, side, out):
    bad = 0
    for i in range(begin, end):
        x, y, z = np.float64(vectors[i, 0]), np.float64(vectors[i, 1]), np.float64(vectors[i, 2])
        total = abs(x) + abs(y) + abs(z)
        if not 0.0 < total < np.inf:
            out[i] = 0
            bad += total != 0.0
            continue
        scale = 1.0 / total
        px, py = x * scale, y * scale
        u = math.copysign(1.0 - abs(py), px) if z < 0.0 else px
        v = math.copysign(1.0 - abs(px), py) if z < 0.0 else py
        a = min(int((u + 1.0) * (side * 0.5)), side - 1)
        b = min(int((v + 1.0) * (side * 0.5)), side - 1)
        winner = table[a * side + b]
        if winner < 0:
            place = -1 - winner
            best = -math.inf
            for m in range(place + 1, place + 1 + lists[place]):
                j = lists[m]
                dot = vertices[j, 0] * x + vertices[j, 1] * y + vertices[j, 2] * z
                if dot > best:
                    best, winner = dot, j
        out[i] = winner
    return bad


def nearest(vectors: Float32s, vertices: Float64s, table: Cells, side: int) -> tuple[Indices, bool]:
    """The vertex with the largest dot product for each of float32 [m, 3], uint16 [m], and whether all are finite."""
    out = np.empty(len(vectors), np.uint16)
    bad = for_chunks(_nearest, len(vectors), vectors, vertices, *table, np.int64(side), out, chunk=_PIECE)
    return out, sum(bad) == 0


@njit(cache=True, nogil=True)
def _dots(begin, end, vectors, vertices, directions, out):
    for i in range(begin, end):
        j = directions[i]
        dot = vertices[j, 0] * vectors[i, 0] + vertices[j, 1] * vectors[i, 1] + vertices[j, 2] * vectors[i, 2]
        out[i] = max(dot, 0.0)


def dots(vectors: Float32s, vertices: Float64s, directions: Indices) -> Float32s:
    """max(x . g, 0) of each vector with its vertex, float32 [m]."""
    out = np.empty(len(vectors), np.float32)
    for_chunks(_dots, len(vectors), vectors, vertices, directions, out, chunk=_PIECE)
    return out
