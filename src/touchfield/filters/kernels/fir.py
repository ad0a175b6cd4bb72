"""The compiled core of `touchfield.filters.fir` for kernels that are no product of rows: one sum over all taps.

Each output brick is made alone from a box of samples around it, in a fixed order of additions. Imported only when
first needed, because it imports numba.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.medium.budget import zero_forces
from touchfield.medium.kernels import first_at_least
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["bricks_filtered"]


@njit(cache=True, nogil=True)
def _gathered(forces, keys, lattice, corner, box):
    """Copy the samples of a box that begins at `corner` (samples) from the bricks; False if it holds no brick."""
    box[:] = 0
    some = False
    for a in range(max(0, corner[0] >> 3), min(lattice[0], (corner[0] + box.shape[0] + 7) >> 3)):
        for b in range(max(0, corner[1] >> 3), min(lattice[1], (corner[1] + box.shape[1] + 7) >> 3)):
            row = (a * lattice[1] + b) * lattice[2]
            first = row + max(0, corner[2] >> 3)
            last = row + min(lattice[2], (corner[2] + box.shape[2] // 3 + 7) >> 3)
            slot = first_at_least(keys, first)
            while slot < keys.shape[0] and keys[slot] < last:
                z = (keys[slot] - row) * 8 - corner[2]
                for i in range(max(0, corner[0] - a * 8), min(8, corner[0] + box.shape[0] - a * 8)):
                    for j in range(max(0, corner[1] - b * 8), min(8, corner[1] + box.shape[1] - b * 8)):
                        for r in range(max(0, -z * 3), min(24, box.shape[2] - z * 3)):
                            box[a * 8 + i - corner[0], b * 8 + j - corner[1], z * 3 + r] = forces[slot, i, j, r]
                some = True
                slot += 1
    return some


@njit(cache=True, nogil=True)
def _bricks(begin, end, bricks, keys, forces, lattice, before, taps, out, held):
    shape = (taps.shape[0] + 7, taps.shape[1] + 7, (taps.shape[2] + 7) * 3)
    box = np.empty(shape, np.float32)
    sums = np.empty(24, np.float64)
    for n in range(begin, end):
        corner = (bricks[n, 0] * 8 - before[0], bricks[n, 1] * 8 - before[1], bricks[n, 2] * 8 - before[2])
        if not _gathered(forces, keys, lattice, corner, box):
            continue
        some = False
        for i in range(8):
            for j in range(8):
                sums[:] = 0
                for a in range(taps.shape[0]):
                    for b in range(taps.shape[1]):
                        row = box[i + a, j + b]
                        for c in range(taps.shape[2]):
                            w = taps[a, b, c]
                            if w != 0:
                                for r in range(24):
                                    sums[r] += w * row[c * 3 + r]
                for r in range(24):
                    out[n, i, j, r] = sums[r]
                    some |= out[n, i, j, r] != 0
        held[n] = some


def bricks_filtered(
    forces_n: NDArray[np.float32],
    keys: NDArray[np.int64],
    bricks: NDArray[np.int32],
    lattice: tuple[int, int, int],
    before: tuple[int, int, int],
    taps: NDArray[np.float64],
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """The forces of output bricks, float32 [n, 8, 8, 8, 3], and which of them hold one, bool [n].

    forces_n : float32 [m, 8, 8, 8, 3]
    keys : int64 [m]; keys of the input's bricks, ascending.
    bricks : int32 [n, 3]; the bricks to make.
    lattice : (int, int, int); bricks of the grid along each axis.
    before : (int, int, int); how far back of a sample the first sample of its sum lies.
    taps : float64 [nx, ny, nz]; weights of the samples of a sum, the first sample first.
    """
    out = zero_forces(len(bricks))
    held = np.zeros(len(bricks), np.bool_)
    target, source = out.reshape(len(out), 8, 8, 24), forces_n.reshape(len(forces_n), 8, 8, 24)
    for_chunks(_bricks, len(bricks), bricks, keys, source, lattice, before, taps, target, held, chunk=4)
    return out, held
