"""Compiled inner loops that sum the points of a cloud in cells, and find cells by their index.

A hash table with linear probing maps the index of a cell to its first row; rows of the same cell, with points
that face apart, are chained. The moments of a cell are those of its points relative to its centre, in units
of its edge: number, three sums, six sums of products, and three sums of directions.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float32s, Float64s, Int32s, Int64s
from touchfield.compute.jit import inner, kernel

HALF_RANGE = 1 << 20
"""Cells on each side of the origin along an axis: an index takes 21 bits."""
MOMENTS = 13
_HASH = np.uint64(0x9E3779B97F4A7C15)
_EMPTY = np.int64(-1)
_MAX_LOAD = 0.5


class Table(NamedTuple):
    """The rows of cells by their index."""

    keys: Int64s  # int64 [2^n]; -1 where empty
    rows: Int32s  # int32 [2^n]; first row of the cell


class Cells(NamedTuple):
    """Rows of cells; `keys` int64 [n] are their indices (`key_of`)."""

    keys: Int64s
    following: Int32s  # int32 [n]; next row of the same cell, -1 for none
    facing: NDArray[np.int8]  # [n]; axis and side that the directions of the row are nearest to
    moments: Float64s  # float64 [n, MOMENTS]

    def selected(self, rows: NDArray[Any] | slice) -> Cells:
        """Return the cells of some rows, by their numbers or a mask."""
        return Cells(self.keys[rows], self.following[rows], self.facing[rows], self.moments[rows])


@inner(forceinline=True)
def key_of(i, j, k):
    """Return the index of a cell as one number, z fastest."""
    return (
        ((np.int64(i) + HALF_RANGE) << 42) | ((np.int64(j) + HALF_RANGE) << 21) | (np.int64(k) + HALF_RANGE)
    )


@inner(forceinline=True)
def cell_of(key):
    """Return i, j and k of a cell."""
    mask = np.int64(2 * HALF_RANGE - 1)
    return (key >> 42) - HALF_RANGE, ((key >> 21) & mask) - HALF_RANGE, (key & mask) - HALF_RANGE


@inner(forceinline=True)
def _place(table, key):
    """Return the place of a cell in the table, or the empty one where it belongs."""
    keys, mask = table.keys, np.int64(len(table.keys) - 1)
    at = np.int64((np.uint64(key) * _HASH) >> np.uint64(20)) & mask
    while keys[at] != _EMPTY and keys[at] != key:
        at = (at + 1) & mask
    return at


@inner(forceinline=True)
def row_of(table, key):
    """Return the first row of a cell, -1 if it is empty."""
    at = _place(table, key)
    return table.rows[at] if table.keys[at] == key else np.int32(-1)


@inner(forceinline=True)
def _facing(x, y, z):
    """Return the nearest of six sides, 0 to 5; 6 for no direction."""
    a, b, c = abs(x), abs(y), abs(z)
    if a >= b and a >= c:
        return 6 if a == 0.0 else (0 if x > 0 else 1)
    if b >= c:
        return 2 if y > 0 else 3
    return 4 if z > 0 else 5


@kernel
def add_points(start, stop, points, directions, origin, edge, table, cells, count):
    """Add points start..stop to their cells; return the next point, the rows, and the points out of range.

    It stops early when table or rows are nearly full.
    """
    has_directions, far = len(directions) > 0, 0
    for p in range(start, stop):
        if count + 1 >= len(cells.keys) or count > _MAX_LOAD * len(table.keys):
            return p, count, far
        x, y, z = (
            (points[p, 0] - origin[0]) / edge,
            (points[p, 1] - origin[1]) / edge,
            (points[p, 2] - origin[2]) / edge,
        )
        fi, fj, fk = math.floor(x), math.floor(y), math.floor(z)
        if max(abs(fi), abs(fj), abs(fk)) >= HALF_RANGE - 8:
            far += 1
            continue
        side = 0
        nx, ny, nz = 0.0, 0.0, 0.0
        if has_directions:
            nx, ny, nz = directions[p, 0], directions[p, 1], directions[p, 2]
            side = _facing(nx, ny, nz)
        key = key_of(fi, fj, fk)
        at = _place(table, key)
        row, last = np.int32(-1), np.int32(-1)
        if table.keys[at] == key:
            row = table.rows[at]
            while row >= 0 and cells.facing[row] != side:
                last, row = row, cells.following[row]
        if row < 0:
            row = np.int32(count)
            count += 1
            cells.keys[row], cells.following[row], cells.facing[row] = key, -1, side
            cells.moments[row, :] = 0.0
            if last >= 0:
                cells.following[last] = row
            else:
                table.keys[at], table.rows[at] = key, row
        x, y, z = x - fi - 0.5, y - fj - 0.5, z - fk - 0.5
        m = cells.moments[row]
        m[0] += 1.0
        m[1] += x
        m[2] += y
        m[3] += z
        m[4] += x * x
        m[5] += x * y
        m[6] += x * z
        m[7] += y * y
        m[8] += y * z
        m[9] += z * z
        m[10] += nx
        m[11] += ny
        m[12] += nz
    return stop, count, far


@kernel
def fill_table(cells, table):
    """Enter rows in a table that is empty; rows of the same cell are chained."""
    for row in range(len(cells.keys)):
        cells.following[row] = -1
    for row in range(len(cells.keys)):
        at = _place(table, cells.keys[row])
        if table.keys[at] == cells.keys[row]:
            cells.following[row] = table.rows[at]
        table.keys[at], table.rows[at] = cells.keys[row], row


@kernel
def merge_rows(cells, opposite):
    """Merge rows of a cell into its first one, unless their directions are opposite; return which remain."""
    # rows of one cell are neighbours: the keys are sorted
    is_kept = np.ones(len(cells.keys), np.bool_)
    first = 0
    for row in range(len(cells.keys)):
        if cells.keys[row] != cells.keys[first]:
            first = row
        for other in range(first, row):
            if not is_kept[other]:
                continue
            a, b = cells.moments[other], cells.moments[row]
            dot = a[10] * b[10] + a[11] * b[11] + a[12] * b[12]
            lengths = math.sqrt(
                (a[10] ** 2 + a[11] ** 2 + a[12] ** 2) * (b[10] ** 2 + b[11] ** 2 + b[12] ** 2)
            )
            if dot >= opposite * lengths:
                for q in range(MOMENTS):
                    a[q] += b[q]
                is_kept[row] = False
                break
    return is_kept


def empty_table(count: int) -> Table:
    """Return a table for up to `count` rows."""
    size = 1 << max(10, int(count / _MAX_LOAD).bit_length())
    return Table(np.full(size, _EMPTY, np.int64), np.empty(size, np.int32))


def table_of(cells: Cells) -> Table:
    """Return the table of rows, which are chained anew."""
    table = empty_table(len(cells.keys))
    fill_table(cells, table)
    return table


def sum_points(points: Float64s, directions: Float32s, origin: Float64s, edge: float) -> tuple[Cells, int]:
    """Sum points [n, 3] in cells with a low corner at `origin` + whole edges.

    Returns the cells, ascending, and the number of points that are too far away to have one. `directions`
    float32 [n, 3], or [0, 3], separate the points of a cell by the side that they face.
    """
    cells, table = _empty_cells(1 << 12), empty_table(1 << 12)
    done, count, far = 0, 0, 0
    while True:
        done, count, more = add_points(
            done, len(points), points, directions, origin, edge, table, cells, count
        )
        far += more
        if done == len(points):
            break
        larger = _empty_cells(4 * len(cells.keys))
        larger.keys[:count], larger.following[:count] = cells.keys[:count], cells.following[:count]
        larger.facing[:count], larger.moments[:count] = cells.facing[:count], cells.moments[:count]
        cells = larger
        table = _table_of_first(cells, count)
    order = np.argsort(cells.keys[:count], kind="stable")
    cells = cells.selected(order)
    if len(directions):
        cells = cells.selected(merge_rows(cells, 0.0))
    return cells, far


def _empty_cells(count: int) -> Cells:
    moments = np.empty((count, MOMENTS))
    return Cells(np.empty(count, np.int64), np.empty(count, np.int32), np.empty(count, np.int8), moments)


def _table_of_first(cells: Cells, count: int) -> Table:
    table = empty_table(len(cells.keys))
    fill_table(cells.selected(slice(None, count)), table)
    return table
