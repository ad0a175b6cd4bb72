"""Scan order with x fastest, then y, then z: along a wall, whose force changes slowly (raster as in pictures)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["slots_along_x"]


@njit(cache=True, nogil=True)
def _count(column, mask, counts):
    for s in range(mask.shape[0]):
        c = column[s]
        for i in range(8):
            for j in range(8):
                for k in range(8):
                    if mask[s, i, j, k]:
                        counts[c, k, j] += 1


@njit(cache=True, nogil=True)
def _starts(groups, counts):
    """Turn counts into first places: per slab of bricks z slowest, then y, and the bricks' columns in order."""
    place = 0
    for g in range(groups.shape[0] - 1):
        for k in range(8):
            for c in range(groups[g], groups[g + 1]):
                for j in range(8):
                    n = counts[c, k, j]
                    counts[c, k, j] = place
                    place += n


@njit(cache=True, nogil=True)
def _place(column, mask, counts, slots):
    # bricks come with x slowest, so that each line is filled with x ascending
    for s in range(mask.shape[0]):
        c = column[s]
        for i in range(8):
            for j in range(8):
                for k in range(8):
                    if mask[s, i, j, k]:
                        slots[counts[c, k, j]] = s * 512 + i * 64 + j * 8 + k
                        counts[c, k, j] += 1


def slots_along_x(bricks: NDArray[np.int32], mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Where the samples of `mask` lie in an array [n * 512], in scan order, int64 [L].

    `bricks` int32 [n, 3] ascending (x slowest), `mask` bool [n, 8, 8, 8].
    """
    if not len(bricks):
        return np.zeros(0, np.int64)
    # a column is a row of bricks along x; columns ascend with z slowest
    keys = (bricks[:, 2].astype(np.int64) << 32) + bricks[:, 1]
    columns, column = np.unique(keys, return_inverse=True)
    slabs = np.flatnonzero(np.diff(columns >> 32, prepend=-1))
    groups = np.append(slabs, len(columns)).astype(np.int64)
    counts = np.zeros((len(columns), 8, 8), np.int64)
    slots = np.empty(int(np.count_nonzero(mask)), np.int64)
    _count(column, mask, counts)
    _starts(groups, counts)
    _place(column, mask, counts, slots)
    return slots
