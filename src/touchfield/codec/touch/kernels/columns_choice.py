"""Compiled choice of the column guess's encoder: the residuals that save most of the voxels' bits for their own."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from touchfield.codec.kernels.lean import entry, inlined, lean
from touchfield.codec.touch.kernels.columns import (
    AMPLITUDE,
    AMPLITUDE_2,
    CUT,
    DIRECTION_STEP,
    LIMIT,
    MODES,
    RAMP,
    TOP,
    TWO,
    Z_2,
    Z_STEP,
    Room,
    U,
    X,
    Z,
    amplitude_step,
    bounded,
    is_torn,
    predict_amplitude,
    predict_direction,
    predict_second,
    predict_start,
    set_direction,
    set_second,
    shape_of,
    share_at,
    sides_of,
)  # fmt: skip
from touchfield.codec.touch.kernels.columns_code import (
    MODE,
    RESIDUALS,
    SPLIT,
    beside_of,
    code_column,
    code_presence,
    room,
)  # fmt: skip
from touchfield.codec.touch.kernels.columns_fit import (
    FIRST,
    FIT_X,
    FIT_Y,
    FLAT,
    HAS_PLATEAU,
    PLATEAU,
    STOP,
    start_of,
    two_surfaces,
)  # fmt: skip

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Work", "work_for", "write_columns"]


class Work(NamedTuple):
    """What the choice takes.

    Attributes
    ----------
    room : Room
    trial : int64 [RESIDUALS + 1]
    deep, slope : int64 [6], [2]
    two, line : float64 [8], [2]
    mask : float64 [2]
        k, and F_0 in units.
    """

    room: Room
    trial: NDArray[np.int64]
    deep: NDArray[np.int64]
    slope: NDArray[np.int64]
    two: NDArray[np.float64]
    line: NDArray[np.float64]
    mask: NDArray[np.float64]


def work_for(mask: NDArray[np.float64]) -> Work:
    """Room for the choice by a mask (k, F_0 in units)."""
    trial, deep, slope = np.zeros(RESIDUALS + 1, np.int64), np.zeros(6, np.int64), np.zeros(2, np.int64)
    return Work(room(), trial, deep, slope, np.zeros(8), np.zeros(2), mask)


# bits, about: of a voxel that the guess misses, of all of a column's constant ones, and above which to try two
_MISS, _PLATEAU_MISS, _WORTH_TWO = 5.0, 10.0, 25.0
_CHEAP = 0.8


@lean
def _bits(r):
    """Bits of a residual, about."""
    r = abs(r)
    if r > 20:
        return 13.0 + 2 * np.log2(r - 19)
    return 2.6 + min(r, 4) + 0.35 * max(r - 4, 0) if r else 0.1


@lean
def _cost(d, fit, col, heads, mask, work, enough):
    """Bits that the voxels of a column would still take, about; whatever is above `enough` counts as that."""
    deep, slope = work.deep, work.slope
    shape_of(col, heads, deep, slope)
    first, stop, flat = int(fit[FIRST]), int(fit[STOP]), int(fit[FLAT])
    two = col[TWO] > 0
    limit = heads[CUT] << 16
    cost = 0.0
    start = min(col[Z], col[Z_2]) if two else col[Z]
    for t in range(max(0, min(first, int(start >> 8))), stop):
        share = share_at(t, col[Z], slope[0])
        more = share_at(t, col[Z_2], slope[1]) if two else np.int64(0)
        whole = share == 65536 and (more == 65536 or not two) and t >= flat
        if share * col[AMPLITUDE] + more * col[AMPLITUDE_2] <= limit:
            share = more = np.int64(0)
        square = 0.0
        for c in range(3):
            x = (deep[c] * share + deep[3 + c] * more) / 65536.0 - d[t, c]
            square += x * x
        tol = max(mask[1], mask[0] * d[t, 3])
        if square > tol * tol:
            cost += min(_MISS * (stop - t), _PLATEAU_MISS) if whole else _MISS
            if cost > enough:
                return cost
        if whole:
            return cost
    return cost


@lean
def _nearest(value, step):
    return np.int64(np.rint(min(max(value / step, -1e6), 1e6)))


@lean
def _keep(trial, out):
    for q in range(RESIDUALS + 1):
        out[q] = trial[q]


@inlined
def _try_one(column, d, fit, columns, mode, work, best):
    """One surface, predicted by `mode`: its residuals are kept if they take fewer bits than `best`."""
    room, trial, mask = work.room, work.trial, work.mask
    cols, heads = columns.cols, columns.heads
    col = cols[column]
    predict_direction(cols, room)
    x, y = room.predicted[0], room.predicted[1]
    rx, ry = _nearest(fit[FIT_X] - x, heads[DIRECTION_STEP]), _nearest(fit[FIT_Y] - y, heads[DIRECTION_STEP])
    amplitude = predict_amplitude(cols, room.sides, 0, heads)
    step = amplitude_step(amplitude, heads)
    ra = _nearest(fit[PLATEAU] - amplitude, step) if fit[HAS_PLATEAU] else np.int64(0)
    col[TWO] = 0
    for q in range(RESIDUALS + 1):
        trial[q] = 0
    trial[MODE] = mode
    for choice in range(8):  # which of x, y and amplitude have a residual
        trial[0] = rx if choice & 1 else 0
        trial[1] = ry if choice & 2 else 0
        trial[3] = ra if choice & 4 else 0
        if (choice & 1 and rx == 0) or (choice & 2 and ry == 0) or (choice & 4 and ra == 0):
            continue
        set_direction(col, X, x + trial[0] * heads[DIRECTION_STEP], y + trial[1] * heads[DIRECTION_STEP], U)
        col[AMPLITUDE] = bounded(amplitude + trial[3] * step, 1, LIMIT)
        start = predict_start(cols, room, column, heads)
        slope = float(max(np.int64(16), heads[RAMP] * col[U + 2] >> 14))
        z = start_of(d, fit, float(col[AMPLITUDE]), slope, mask[0], mask[1])
        rz = _nearest(z - start, heads[Z_STEP])
        for at in range(4):
            trial[2] = rz + at - 2 if at else 0
            if at and trial[2] == 0:
                continue
            col[Z] = start + trial[2] * heads[Z_STEP]
            bits = 2.0 if mode else 0.3
            for q in range(4):
                bits += _bits(trial[q])
            if bits < best:
                bits += _cost(d, fit, col, heads, mask, work, best - bits)
                if bits < best:
                    best = bits
                    _keep(trial, room.residuals)
                    if bits < _CHEAP:
                        return best
    return best


@inlined
def _try_two(column, d, fit, two, columns, mode, work, best):
    """Two surfaces as `two_surfaces` found them."""
    room, trial = work.room, work.trial
    cols, heads = columns.cols, columns.heads
    predicted = room.predicted
    col = cols[column]
    for q in range(RESIDUALS + 1):
        trial[q] = 0
    trial[MODE] = mode
    trial[SPLIT] = 1
    predict_direction(cols, room)
    x, y = predicted[0], predicted[1]
    trial[0], trial[1] = _nearest(two[1] - x, heads[DIRECTION_STEP]), _nearest(two[2] - y, heads[DIRECTION_STEP])
    set_direction(col, X, x + trial[0] * heads[DIRECTION_STEP], y + trial[1] * heads[DIRECTION_STEP], U)
    start = predict_start(cols, room, column, heads)
    trial[2] = _nearest(two[0] - start, heads[Z_STEP])
    col[Z] = start + trial[2] * heads[Z_STEP]
    half, step = predict_amplitude(cols, room.sides, 1, heads), amplitude_step(heads[TOP], heads)
    trial[3] = _nearest(two[3] - half, step)
    col[AMPLITUDE] = bounded(half + trial[3] * step, 1, LIMIT)
    predict_second(cols, room.beside, column, heads, predicted)
    trial[5] = _nearest(two[4] - predicted[0], heads[Z_STEP])
    trial[8] = _nearest(two[7] - predicted[3], step)
    col[TWO] = 1
    for turned in range(2):
        trial[6] = _nearest(two[5] - predicted[1], heads[DIRECTION_STEP]) if turned else 0
        trial[7] = _nearest(two[6] - predicted[2], heads[DIRECTION_STEP]) if turned else 0
        set_second(col, predicted, trial, heads)
        bits = 3.0
        for q in range(RESIDUALS):
            if q != MODE:
                bits += _bits(trial[q])
        if bits < best:
            bits += _cost(d, fit, col, heads, work.mask, work, best - bits)
            if bits < best:
                best = bits
                _keep(trial, room.residuals)
    col[TWO] = 0
    return best


@inlined
def _choose(column, d, fit, columns, work):
    """The residuals of one column."""
    cols, room = columns.cols, work.room
    best = 1e18
    modes = MODES if is_torn(cols, room.beside) else 1
    for mode in range(modes):
        if sides_of(mode, cols, room.beside, room.sides):
            best = _try_one(column, d, fit, columns, mode, work, best)
    if best > _WORTH_TWO and two_surfaces(d, fit, columns.heads, work.mask[0], work.mask[1], work.two, work.line):
        for mode in range(modes):
            if sides_of(mode, cols, room.beside, room.sides):
                best = _try_two(column, d, fit, work.two, columns, mode, work, best)


@entry
def write_columns(bits, at, columns, begin, end, fitting, work):
    """Choose and write the columns of tiles begin to end - 1, of what `fit_columns` has laid out."""
    dense, fits = fitting
    room = work.room
    for tile in range(begin, end):
        for i in range(min(8, columns.sizes[0] - columns.tiles[tile, 0] * 8)):
            for j in range(min(8, columns.sizes[1] - columns.tiles[tile, 1] * 8)):
                column, place = tile * 64 + i * 8 + j, (tile - begin) * 64 + i * 8 + j
                beside_of(columns, tile, i, j, room.beside)
                if code_presence(bits, at, columns, room, column, i, j):
                    _choose(column, dense[place], fits[place], columns, work)
                    code_column(bits, at, columns, room, column)
