"""The compiled core of `touchfield.filters.resample`: which bricks are reached, and three passes over each.

Each output brick is made alone, in a fixed order of additions, so that the result does not depend on the
number of threads. Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int64s = NDArray[np.int64]
    Float32s = NDArray[np.float32]
    Axes = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]
    Tables = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]

__all__ = ["reached", "resampled"]


@njit(cache=True, nogil=True)
def _reached(bricks, reach, brick_shape, out):
    count = 0
    for n in range(bricks.shape[0]):
        a, b, c = bricks[n, 0], bricks[n, 1], bricks[n, 2]
        for i in range(reach[0][a, 0], reach[0][a, 1]):
            for j in range(reach[1][b, 0], reach[1][b, 1]):
                for k in range(reach[2][c, 0], reach[2][c, 1]):
                    out[count] = (i * brick_shape[1] + j) * brick_shape[2] + k
                    count += 1


def reached(bricks: NDArray[np.int32], reach: Axes, brick_shape: tuple[int, int, int], count: int) -> Int64s:
    """Keys of the output bricks that some input brick reaches, ascending, each once.

    `reach` gives for each axis and input brick coordinate the range of output coordinates, int64 [m, 2];
    `count` is how many pairs of an input and an output brick there are.
    """
    keys = np.empty(count, np.int64)
    _reached(bricks, reach, brick_shape, keys)
    return np.unique(keys)


@njit(cache=True, nogil=True)
def _pass_x(slot_forces, x_begin, x_end, y_begin, y_end, z_begin, z_end, low, first, weights, tmp):
    """Add what one input brick gives to the first pass; ranges are sample indices of the source."""
    run = (z_end - z_begin) * 3
    at = (z_begin - low[2]) * 3
    start = (z_begin & 7) * 3
    for i in range(first.shape[0]):
        for t in range(max(0, x_begin - first[i]), min(weights.shape[1], x_end - first[i])):
            w = weights[i, t]
            if w != 0:
                x = (first[i] + t) & 7
                for y in range(y_begin, y_end):
                    source = slot_forces[x, y & 7, start : start + run]
                    target = tmp[i, y - low[1], at : at + run]
                    for r in range(run):
                        target[r] += w * source[r]


@njit(cache=True, nogil=True)
def _pass_y(tmp, low, count, first, weights, run, out):
    for i in range(8):
        for j in range(first.shape[0]):
            target = out[i, j]
            for r in range(run):
                target[r] = 0
            for t in range(max(0, low - first[j]), min(weights.shape[1], low + count - first[j])):
                w = weights[j, t]
                if w != 0:
                    source = tmp[i, first[j] + t - low]
                    for r in range(run):
                        target[r] += w * source[r]


@njit(cache=True, nogil=True)
def _pass_z(tmp, rows, columns, low, count, first, weights, out):
    held = False
    for i in range(rows):
        for j in range(columns):
            for k in range(first.shape[0]):
                a = np.float32(0)
                b = np.float32(0)
                c = np.float32(0)
                for t in range(max(0, low - first[k]), min(weights.shape[1], low + count - first[k])):
                    w = weights[k, t]
                    force = tmp[i, j, first[k] + t - low]
                    a += w * force[0]
                    b += w * force[1]
                    c += w * force[2]
                out[i, j, k, 0] = a
                out[i, j, k, 1] = b
                out[i, j, k, 2] = c
                if a != 0 or b != 0 or c != 0:
                    held = True
    return held


@njit(cache=True, nogil=True)
def _resampled(begin, end, bricks, keys, forces, source, firsts, tables, widest, out, held):
    shape, brick_shape = source
    tmp = np.zeros((8, widest[1], widest[2] * 3), np.float32)
    tmp2 = np.zeros((8, 8, widest[2] * 3), np.float32)
    low = np.zeros(3, np.int64)
    high = np.zeros(3, np.int64)
    n0 = np.zeros(3, np.int64)
    n1 = np.zeros(3, np.int64)
    for n in range(begin, end):
        for axis in range(3):
            n0[axis] = bricks[n, axis] * 8
            n1[axis] = min(n0[axis] + 8, firsts[axis].shape[0])
            low[axis] = max(0, firsts[axis][n0[axis]])
            high[axis] = min(shape[axis], firsts[axis][n1[axis] - 1] + widest[3 + axis])
        tmp[:] = 0
        any_source = False
        for a in range(low[0] >> 3, (high[0] + 7) >> 3):
            for b in range(low[1] >> 3, (high[1] + 7) >> 3):
                row = (a * brick_shape[1] + b) * brick_shape[2]
                slot = np.searchsorted(keys, row + (low[2] >> 3))
                last = row + ((high[2] - 1) >> 3)
                while slot < keys.shape[0] and keys[slot] <= last:
                    c = keys[slot] - row
                    _pass_x(
                        forces[slot], max(low[0], a * 8), min(high[0], a * 8 + 8), max(low[1], b * 8),
                        min(high[1], b * 8 + 8), max(low[2], c * 8), min(high[2], c * 8 + 8),
                        low, firsts[0][n0[0] : n1[0]], tables[0][n0[0] : n1[0]], tmp,
                    )  # fmt: skip
                    any_source = True
                    slot += 1
        out[n] = 0
        held[n] = False
        if any_source:
            _pass_y(
                tmp, low[1], high[1] - low[1], firsts[1][n0[1] : n1[1]],
                tables[1][n0[1] : n1[1]], (high[2] - low[2]) * 3, tmp2,
            )  # fmt: skip
            held[n] = _pass_z(
                tmp2.reshape(8, 8, widest[2], 3), n1[0] - n0[0], n1[1] - n0[1], low[2], high[2] - low[2],
                firsts[2][n0[2] : n1[2]], tables[2][n0[2] : n1[2]], out[n],
            )  # fmt: skip


def resampled(
    bricks: NDArray[np.int32],
    source: tuple[tuple[int, int, int], tuple[int, int, int]],
    keys: Int64s,
    forces_n: Float32s,
    firsts: Axes,
    tables: Tables,
) -> tuple[Float32s, NDArray[np.bool_]]:
    """The forces of output bricks, float32 [n, 8, 8, 8, 3], and which of them hold one, bool [n].

    Parameters
    ----------
    bricks : int32 [n, 3]
        Output bricks to make.
    source : (shape, brick_shape) of the input grid
    keys : int64 [m]
        Keys of the input bricks, ascending.
    forces_n : float32 [m, 8, 8, 8, 3]
    firsts, tables
        For each axis, `AxisWeights.first` and `AxisWeights.weights`.
    """
    widest = []
    for first in zip(firsts, tables, strict=True):
        starts = np.maximum(0, first[0][::8])
        ends = first[0][np.minimum(np.arange(7, len(first[0]) + 7, 8), len(first[0]) - 1)] + first[1].shape[1]
        widest.append(int(max(1, (ends - starts).max())))
    sizes = (*(min(w, n) for w, n in zip(widest, source[0], strict=True)), *(t.shape[1] for t in tables))
    out = np.empty((len(bricks), 8, 8, 8, 3), np.float32)
    held = np.zeros(len(bricks), np.bool_)
    planes = forces_n.reshape(len(forces_n), 8, 8, 24)
    for_chunks(_resampled, len(bricks), bricks, keys, planes, source, firsts, tables, sizes, out, held, chunk=16)
    return out, held
