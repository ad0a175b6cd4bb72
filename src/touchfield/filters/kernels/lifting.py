"""The compiled core of lifting: one step in place, on a dense array and on sparse bricks.

A step changes sites of one kind by what their neighbours of the other kind hold, so it reads nothing that it writes
and can be done in any order by any number of threads. Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit

from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

_SAMPLES_PER_CHUNK = 1 << 15


@njit(cache=True, nogil=True)
def _neighbour_sum(rows, i, j, width, offsets, scale, total):
    """The sum over the neighbours of each site of one row; what it holds between the sites means nothing.

    Whole rows are added, sites or not, because the processor adds eight consecutive numbers as fast as one. What
    another thread may be writing meanwhile lies between the sites that are used.
    """
    last = (rows.shape[2] // width - 1) // scale * scale * width
    step = scale * width
    for r in range(total.shape[0]):
        total[r] = 0
    for n in range(offsets.shape[0]):
        a, b = i + offsets[n, 0] * scale, j + offsets[n, 1] * scale
        if a < 0 or a >= rows.shape[0]:  # a neighbour beyond the border is its mirror image about the site
            a = i - offsets[n, 0] * scale
        if b < 0 or b >= rows.shape[1]:
            b = j - offsets[n, 1] * scale
        row = rows[a, b]
        if offsets[n, 2] == 0:
            for r in range(total.shape[0]):
                total[r] += row[r]
        elif offsets[n, 2] > 0:
            for r in range(total.shape[0] - step):
                total[r] += row[r + step]
            for r in range(last, last + width):
                total[r] += row[r - step]
        else:
            for r in range(step, total.shape[0]):
                total[r] += row[r - step]
            for r in range(width):
                total[r] += row[r + step]


@njit(cache=True, nogil=True)
def _step_floats(begin, end, rows, width, scale, starts, offsets, sign, divisor):
    total = np.zeros(rows.shape[2], rows.dtype)
    columns = (rows.shape[1] - 1) // scale + 1
    for n in range(begin, end):
        a, b = n // columns, n % columns
        start = starts[a & 1, b & 1]
        if start >= 0:
            _neighbour_sum(rows, a * scale, b * scale, width, offsets, scale, total)
            row = rows[a * scale, b * scale]
            weight = total.dtype.type(sign / divisor)
            for first in range(start * scale * width, row.shape[0], 2 * scale * width):
                for r in range(first, first + width):
                    row[r] += weight * total[r]


@njit(cache=True, nogil=True)
def _step_integers(begin, end, rows, width, scale, starts, offsets, sign, divisor):
    total = np.zeros(rows.shape[2], rows.dtype)
    columns = (rows.shape[1] - 1) // scale + 1
    half = divisor // 2
    for n in range(begin, end):
        a, b = n // columns, n % columns
        start = starts[a & 1, b & 1]
        if start >= 0:
            _neighbour_sum(rows, a * scale, b * scale, width, offsets, scale, total)
            row = rows[a * scale, b * scale]
            for first in range(start * scale * width, row.shape[0], 2 * scale * width):
                for r in range(first, first + width):
                    row[r] += sign * ((total[r] + half) // divisor)


def step(
    rows: NDArray[Any],
    width: int,
    scale: int,
    sites: tuple[NDArray[np.int64], NDArray[np.int64]],
    share: tuple[int, int],
) -> None:
    """Add to each site ``sign / divisor`` times the sum of its neighbours, rounded half up where numbers are whole.

    rows : float32, float64, int32 or int64 [n0, n1, n2 * width]; changed in place; whole numbers wrap round, forth
        and back alike.
    width : int; components of a sample.
    scale : int; sites lie at its multiples.
    sites : (int64 [2, 2], int64 [k, 3]); for the parities along the first two axes the parity along the third of the
        sites to change, -1 for none; and the offsets of their neighbours, in units of `scale`.
    share : (int, int); the sign, 1 or -1, and the divisor.
    """
    starts, offsets = sites
    kernel = _step_floats if rows.dtype.kind == "f" else _step_integers
    count = ((rows.shape[0] - 1) // scale + 1) * ((rows.shape[1] - 1) // scale + 1)
    chunk = max(1, _SAMPLES_PER_CHUNK // rows.shape[2])
    for_chunks(kernel, count, rows, width, scale, starts, offsets, *share, chunk=chunk)


@njit(cache=True, nogil=True)
def _add(total, begin, end, forces, slot, row):
    """Add a piece of one row of a brick, from its number ``row`` on, to ``total``; nothing where there is no brick.

    Indices that cannot be negative spare a test each, and one flat array spares a count of its users that all threads
    would share: ten times as fast together.
    """
    if slot >= 0:
        source, target = np.uint64(slot * 1536 + row), np.uint64(begin)
        for r in range(np.uint64(end - begin)):
            total[target + r] += forces[source + r]


@njit(cache=True, nogil=True)
def _brick_sum(n, bricks, slots, forces, shape, i, j, offsets, scale, total):
    """As `_neighbour_sum`, for one row of one brick and in the same order of additions."""
    x, y, z = bricks[n, 0] * 8, bricks[n, 1] * 8, bricks[n, 2] * 8
    step = 3 * scale
    last = (shape[2] - 1) // scale * scale - z  # the last site of the grid, as a sample of this brick
    for r in range(24):
        total[r] = 0
    for o in range(offsets.shape[0]):
        a, b = i + offsets[o, 0] * scale, j + offsets[o, 1] * scale
        if x + a < 0 or x + a >= shape[0]:
            a = i - offsets[o, 0] * scale
        if y + b < 0 or y + b >= shape[1]:
            b = j - offsets[o, 1] * scale
        own = (1 + (a >> 3)) * 9 + (1 + (b >> 3)) * 3 + 1  # before and after it the bricks at its sides
        row = ((a & 7) * 8 + (b & 7)) * 24
        if offsets[o, 2] == 0:
            _add(total, 0, 24, forces, slots[n, own], row)
        elif offsets[o, 2] > 0:
            _add(total, 0, 24 - step, forces, slots[n, own], row + step)
            _add(total, 24 - step, 24, forces, slots[n, own + 1], row)
            if 0 <= last < 8:
                image = last - scale
                _add(total, 3 * last, 3 * last + 3, forces, slots[n, own + (image >> 3)], row + 3 * (image & 7))
        else:
            _add(total, step, 24, forces, slots[n, own], row)
            _add(total, 0, step, forces, slots[n, own - 1], row + 24 - step)
            if z == 0:
                _add(total, 0, 3, forces, slots[n, own + (scale >> 3)], row + 3 * (scale & 7))


@njit(cache=True, nogil=True)
def _step_bricks(begin, end, bricks, slots, forces, shape, scale, starts, offsets, hold, weight):
    total = np.zeros(24, np.float32)
    for n in range(begin, end):
        x, y, z = bricks[n, 0] * 8, bricks[n, 1] * 8, bricks[n, 2] * 8
        for i in range(0, min(8, shape[0] - x), scale):
            for j in range(0, min(8, shape[1] - y), scale):
                start = starts[((x + i) // scale) & 1, ((y + j) // scale) & 1]
                first = ((start - z // scale) & 1) * scale
                if start >= 0 and first < 8:
                    _brick_sum(n, bricks, slots, forces, shape, i, j, offsets, scale, total)
                    row = n * 1536 + (i * 8 + j) * 24
                    for k in range(first, min(8, shape[2] - z), 2 * scale):
                        for r in range(3 * k, 3 * k + 3):
                            forces[row + r] = hold * forces[row + r] + weight * total[r]


def brick_step(
    place: tuple[NDArray[np.int32], NDArray[np.int32], tuple[int, int, int]],
    forces_n: NDArray[np.float32],
    scale: int,
    sites: tuple[NDArray[np.int64], NDArray[np.int64]],
    share: tuple[float, float],
) -> None:
    """Put to each site what it holds times a number plus a share of the sum of its neighbours.

    place : (int32 [n, 3], int32 [n, 27], (int, int, int)); the bricks, the neighbours of each
        (`touchfield.medium.neighbours.neighbour_slots`), the shape of the grid.
    forces_n : float32 [n, 8, 8, 8, 3]; changed in place; zero beyond the grid.
    scale : int; 1, 2, 4 or 8, so that no neighbour lies beyond the next brick.
    sites : (int64 [2, 2], int64 [k, 3]); as for `step`.
    share : (float, float); by what to multiply the site and the sum.
    """
    bricks, slots, shape = place
    numbers = (np.float32(share[0]), np.float32(share[1]))
    for_chunks(
        _step_bricks, len(bricks), bricks, slots, forces_n.reshape(-1), shape, scale, *sites, *numbers, chunk=64
    )
