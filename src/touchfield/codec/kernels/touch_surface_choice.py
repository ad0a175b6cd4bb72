"""Compiled choice of the surface encoder: the residuals that save most of the voxels' bits for their own."""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.codec.kernels.touch_lattice import LIMIT
from touchfield.codec.kernels.touch_surface import (
    AMPLITUDE,
    AMPLITUDE_2,
    BEND,
    BEND_STEP,
    CUT,
    DIRECTION_STEP,
    MODES,
    RAMP,
    TOP,
    TWO,
    Z_2,
    Z_STEP,
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
from touchfield.codec.kernels.touch_surface_fit import (
    FIRST,
    FIT_X,
    FIT_Y,
    FLAT,
    HAS_PLATEAU,
    PLATEAU,
    STOP,
    start_of,
    steepness,
    two_surfaces,
)  # fmt: skip

__all__ = ["RESIDUALS", "choose"]

RESIDUALS = 11
"""Of X, Y, Z, amplitude, bend; the mode of prediction; two surfaces or one; Z, X, Y, amplitude of the second."""
_MODE, _TWO = 5, 6

# bits, about: of a voxel that the guess misses, of all of a column's constant ones, and above which to try two
_MISS, _PLATEAU_MISS, _WORTH_TWO = 5.0, 10.0, 25.0


@njit(cache=True, nogil=True)
def _bits(r):
    """Bits of a residual, about."""
    r = abs(r)
    if r > 20:
        return 13.0 + 2 * np.log2(r - 19)
    return 2.6 + min(r, 4) + 0.35 * max(r - 4, 0) if r else 0.6


@njit(cache=True, nogil=True)
def _cost(d, fit, col, heads, k, f0, deep, slope, enough):
    """Bits that the voxels of a column would still take, about; whatever is above `enough` counts as that."""
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
        tol = max(f0, k * d[t, 3])
        if square > tol * tol:
            cost += min(_MISS * (stop - t), _PLATEAU_MISS) if whole else _MISS
            if cost > enough:
                return cost
        if whole:
            return cost
    return cost


@njit(cache=True, nogil=True)
def _nearest(value, step):
    return np.int64(np.rint(min(max(value / step, -1e6), 1e6)))


@njit(cache=True, nogil=True)
def _keep(trial, out):
    for q in range(RESIDUALS):
        out[q] = trial[q]


@njit(cache=True, nogil=True)
def _try_one(column, d, fit, cols, sides, mode, last, heads, k, f0, room, out, best):
    """One surface, predicted by `mode`: the residuals go to `out` if they take fewer bits than `best`."""
    guesses, known, predicted, trial, deep, slope = room
    col = cols[column]
    predict_direction(cols, sides, last, guesses, known, predicted)
    x, y = predicted[0], predicted[1]
    rx, ry = _nearest(fit[FIT_X] - x, heads[DIRECTION_STEP]), _nearest(fit[FIT_Y] - y, heads[DIRECTION_STEP])
    amplitude = predict_amplitude(cols, sides, 0, heads)
    step = amplitude_step(amplitude, heads)
    ra = _nearest(fit[PLATEAU] - amplitude, step) if fit[HAS_PLATEAU] else np.int64(0)
    col[TWO] = 0
    for q in range(RESIDUALS):
        trial[q] = 0
    trial[_MODE] = mode
    for choice in range(16):  # which of x, y, amplitude and bend have a residual
        trial[0] = rx if choice & 1 else 0
        trial[1] = ry if choice & 2 else 0
        trial[3] = ra if choice & 4 else 0
        if (choice & 1 and rx == 0) or (choice & 2 and ry == 0) or (choice & 4 and ra == 0):
            continue
        set_direction(col, X, x + trial[0] * heads[DIRECTION_STEP], y + trial[1] * heads[DIRECTION_STEP], U)
        col[AMPLITUDE] = bounded(amplitude + trial[3] * step, 1, LIMIT)
        start = predict_start(cols, sides, last, column, heads, guesses, known)
        trial[4] = 0
        tie = max(np.int64(16), heads[RAMP] * col[U + 2] >> 14)
        if choice & 8:
            steep = steepness(d, fit, float(col[AMPLITUDE])) * 65536.0
            trial[4] = bounded(_nearest(steep - tie, tie / BEND_STEP), -7, 24) if steep > 0.0 else 0
            if trial[4] == 0:
                continue
        col[BEND] = trial[4]
        z = start_of(d, fit, float(col[AMPLITUDE]), float(tie * (BEND_STEP + trial[4])) / BEND_STEP, k, f0)
        rz = _nearest(z - start, heads[Z_STEP])
        for at in range(4):
            trial[2] = rz + at - 2 if at else 0
            if at and trial[2] == 0:
                continue
            col[Z] = start + trial[2] * heads[Z_STEP]
            bits = 2.0 if mode else 0.3
            if trial[0] or trial[1] or trial[2] or trial[3] or trial[4]:
                bits += 0.7
                for q in range(5):
                    bits += _bits(trial[q])
            if bits < best:
                bits += _cost(d, fit, col, heads, k, f0, deep, slope, best - bits)
                if bits < best:
                    best = bits
                    _keep(trial, out)
                    if bits < 0.5:
                        return best
    return best


@njit(cache=True, nogil=True)
def _try_two(column, d, fit, two, cols, beside, sides, mode, last, heads, k, f0, room, out, best):
    """Two surfaces as `two_surfaces` found them."""
    guesses, known, predicted, trial, deep, slope = room
    col = cols[column]
    for q in range(RESIDUALS):
        trial[q] = 0
    trial[_MODE] = mode
    trial[_TWO] = 1
    predict_direction(cols, sides, last, guesses, known, predicted)
    x, y = predicted[0], predicted[1]
    trial[0], trial[1] = _nearest(two[1] - x, heads[DIRECTION_STEP]), _nearest(two[2] - y, heads[DIRECTION_STEP])
    set_direction(col, X, x + trial[0] * heads[DIRECTION_STEP], y + trial[1] * heads[DIRECTION_STEP], U)
    start = predict_start(cols, sides, last, column, heads, guesses, known)
    trial[2] = _nearest(two[0] - start, heads[Z_STEP])
    col[Z] = start + trial[2] * heads[Z_STEP]
    half, step = predict_amplitude(cols, sides, 1, heads), amplitude_step(heads[TOP], heads)
    trial[3] = _nearest(two[3] - half, step)
    col[AMPLITUDE] = bounded(half + trial[3] * step, 1, LIMIT)
    col[BEND] = 0
    predict_second(cols, beside, column, heads, predicted)
    trial[7] = _nearest(two[4] - predicted[0], heads[Z_STEP])
    trial[10] = _nearest(two[7] - predicted[3], step)
    col[TWO] = 1
    for turned in range(2):
        trial[8] = _nearest(two[5] - predicted[1], heads[DIRECTION_STEP]) if turned else 0
        trial[9] = _nearest(two[6] - predicted[2], heads[DIRECTION_STEP]) if turned else 0
        set_second(col, predicted, trial, heads)
        bits = 3.0
        for q in range(RESIDUALS):
            if q < 4 or q > _TWO:
                bits += _bits(trial[q])
        if bits < best:
            bits += _cost(d, fit, col, heads, k, f0, deep, slope, best - bits)
            if bits < best:
                best = bits
                _keep(trial, out)
    col[TWO] = 0
    return best


@njit(cache=True, nogil=True)
def choose(column, at, beside, sides, last, heads, fitting, cols, guesses, known, out):
    """The residuals of one column, into `out`; `fitting` is (columns, fits, (k, F_0 in units)), see `fit_columns`.

    `at` is the column's tile within `fitting`.
    """
    dense, fits, tolerance = fitting
    d, fit = dense[at, column & 63], fits[at * 64 + (column & 63)]
    k, f0 = tolerance[0], tolerance[1]
    room = (
        guesses, known, np.zeros(4, np.int64), np.zeros(RESIDUALS, np.int64), np.zeros(6, np.int64),
        np.zeros(2, np.int64),
    )  # fmt: skip
    best = 1e18
    modes = MODES if is_torn(cols, beside) else 1
    for mode in range(modes):
        if sides_of(mode, cols, beside, sides):
            best = _try_one(column, d, fit, cols, sides, mode, last, heads, k, f0, room, out, best)
    two = np.zeros(8)
    if best > _WORTH_TWO and two_surfaces(d, fit, heads, k, f0, two):
        for mode in range(modes):
            if sides_of(mode, cols, beside, sides):
                best = _try_two(column, d, fit, two, cols, beside, sides, mode, last, heads, k, f0, room, out, best)
