"""The compiled core of lifting on sparse bricks: one step in place.

A step changes sites of one kind by what their neighbours of the other kind hold, so it reads nothing that it writes
and can be done in any order by any number of threads. Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray


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
    """The sum over the neighbours of each site of one row of a brick; what it holds between the sites means nothing.

    Whole rows are added, sites or not, because the processor adds eight consecutive numbers as fast as one. A
    neighbour beyond the border is its mirror image about the site.
    """
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
    sites : (int64 [2, 2], int64 [k, 3]); for the parities along the first two axes the parity along the third of the
        sites to change, -1 for none; and the offsets of their neighbours, in units of `scale`.
    share : (float, float); by what to multiply the site and the sum.
    """
    bricks, slots, shape = place
    numbers = (np.float32(share[0]), np.float32(share[1]))
    for_chunks(
        _step_bricks, len(bricks), bricks, slots, forces_n.reshape(-1), shape, scale, *sites, *numbers, chunk=64
    )
