"""Compiled layout of a surface: what is kept of each column, how it is predicted, and the forces it stands for.

A column of samples along the main axis of the force is told by a few whole numbers (`touchfield.codec.touch.surface`
says which). Positions are in 1/256 samples from outside to inside, directions in 1/16384, shares in 1/65536. No
product reaches 2^53.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.codec.kernels.touch_lattice import LIMIT, root

__all__ = [
    "AMPLITUDE", "AMPLITUDE_2", "AMPLITUDE_STEP", "BEND", "BEND_STEP", "CUT", "DIRECTION_STEP", "ERRORS_XY",
    "ERRORS_Z", "HEADS", "HEAD_LIMITS", "MODES", "PRESENT", "RAMP", "RATIO_A", "RATIO_B", "SECOND",
    "SIZE_AMPLITUDE", "SIZE_BEND", "SIZE_XY", "SIZE_Z", "STILL", "TOP", "TWO", "WIDTH", "Z_2", "Z_STEP", "U", "X",
    "Y", "Z", "amplitude_step", "bounded", "fill_bricks", "is_torn", "predict_amplitude", "predict_direction",
    "predict_second", "predict_start", "set_direction", "set_second", "shape_of", "share_at", "sides_of",
    "tile_spans",
]  # fmt: skip

HEADS = 8
"""Whole numbers that a surface has once, in the order of the following names."""
TOP, RAMP, RATIO_A, RATIO_B, Z_STEP, DIRECTION_STEP, AMPLITUDE_STEP, CUT = range(HEADS)
HEAD_LIMITS = (1 << 17, 1 << 20, 1 << 20, 1 << 20, 1 << 12, 1 << 14, 1 << 16, 1 << 17)
BEND_STEP = 8
"""A column's ramp is (1 + bend / 8) times as steep as its direction says; bend -7 to 24."""

WIDTH = 32
"""Whole numbers kept of each column: those told, what is derived of them, and how well each predictor did."""
PRESENT, Z, X, Y, AMPLITUDE, BEND, TWO = range(7)
SECOND = Z_2 = 7
_X_2, _Y_2, AMPLITUDE_2 = 8, 9, 10
U, _U_2 = 11, 14
"""The outward direction (along the axes across, and outward) of the first surface and of the second."""
STILL, SIZE_XY, SIZE_Z, SIZE_AMPLITUDE, SIZE_BEND = range(17, 22)
ERRORS_XY, ERRORS_Z = 22, 26

MODES = 4
_TORN = 768  # neighbours whose starts differ by three samples may not speak for one surface
_FAR = 1 << 24
_DISC = 1 << 29  # square of (X, Y) at a right angle to the axis
_DISC_ROOT = 23170
_SQUARE_LIMIT = 32767
_LEAST_OUT = 820  # 87 degrees to the axis
_STEEPEST = 4096  # a surface rises by 16 samples from column to column at most


@njit(cache=True, nogil=True)
def bounded(value, low, high):
    return min(max(value, np.int64(low)), np.int64(high))


@njit(cache=True, nogil=True)
def amplitude_step(amplitude, heads):
    """One step of a column's amplitude near `amplitude`, units."""
    return max(np.int64(1), amplitude * heads[AMPLITUDE_STEP] >> 16)


@njit(cache=True, nogil=True)
def set_direction(col, place, x, y, at):
    """Keep the point (x, y) of Lambert's equal-area disc at `place`, and the direction it stands for at `at`."""
    col[place] = x = bounded(x, -_SQUARE_LIMIT, _SQUARE_LIMIT)
    col[place + 1] = y = bounded(y, -_SQUARE_LIMIT, _SQUARE_LIMIT)
    square = x * x + y * y
    if square > _DISC:
        scale = np.int64(_DISC_ROOT << 14) // root(square)
        x = x * scale >> 14
        y = y * scale >> 14
        square = x * x + y * y
    side = root((np.int64(1) << 28) - (square >> 2))
    col[at] = x * side >> 14
    col[at + 1] = y * side >> 14
    col[at + 2] = max(np.int64(_LEAST_OUT), 16384 - (square >> 15))


# -- prediction from the columns beside: west (j - 1), north (i - 1), north-west, north-east; -1 is none ----------


@njit(cache=True, nogil=True)
def is_torn(cols, beside):
    """Whether the columns beside may belong to different surfaces."""
    torn = False
    for s in range(2):
        torn |= beside[s] >= 0 and cols[beside[s], TWO] > 0
    if beside[0] >= 0 and beside[1] >= 0:
        torn |= abs(cols[beside[0], Z] - cols[beside[1], Z]) > _TORN
    return torn


@njit(cache=True, nogil=True)
def sides_of(mode, cols, beside, out):
    """Which columns are predicted from: all (0), west (1), north (2), the second surface of one of both (3).

    The last row of `cols` is scratch. False where a mode has nothing to go by.
    """
    for s in range(4):
        out[s] = beside[s] if mode == 0 else -1
    if mode == 0:
        return True
    if mode < 3:
        out[mode - 1] = beside[mode - 1]
        return beside[mode - 1] >= 0
    for s in range(2):
        if beside[s] >= 0 and cols[beside[s], TWO]:
            spare = cols.shape[0] - 1
            for c in range(4):
                cols[spare, Z + c] = cols[beside[s], SECOND + c]
            for c in range(3):
                cols[spare, U + c] = cols[beside[s], _U_2 + c]
            for c in range(4):
                cols[spare, ERRORS_XY + c] = cols[beside[s], ERRORS_XY + c]
                cols[spare, ERRORS_Z + c] = cols[beside[s], ERRORS_Z + c]
            out[s] = spare
            return True
    return False


@njit(cache=True, nogil=True)
def _blend(guesses, which, known, cols, sides, errors):
    """The mean of what the known predictors say, by how well each did in the columns beside."""
    total = np.int64(0)
    weight = np.int64(0)
    for q in range(4):
        if known[q]:
            error = np.int64(24)
            for s in range(4):
                if sides[s] >= 0:
                    error += cols[sides[s], errors + q]
            w = max(np.int64(1), (np.int64(1) << 30) // (error * error))
            total += w * guesses[which, q]
            weight += w
    return (2 * total + weight) // (2 * weight)


@njit(cache=True, nogil=True)
def _know(sides, known):
    west, north = sides[0] >= 0, sides[1] >= 0
    known[0] = west
    known[1] = north
    known[2] = west and north and sides[2] >= 0
    known[3] = west and north
    return west or north


@njit(cache=True, nogil=True)
def _elsewhere(sides, last):
    """The column to go by where there is none to the west and north."""
    return sides[3] if sides[3] >= 0 else (sides[2] if sides[2] >= 0 else last)


@njit(cache=True, nogil=True)
def predict_direction(cols, sides, last, guesses, known, out):
    """out[0:2] is the predicted (X, Y); ``guesses[0:2]`` what the four predictors say."""
    blended = _know(sides, known)
    for c in range(2):
        a = cols[sides[0], X + c] if known[0] else np.int64(0)
        b = cols[sides[1], X + c] if known[1] else np.int64(0)
        guesses[c, 0] = a
        guesses[c, 1] = b
        guesses[c, 2] = a + b - cols[sides[2], X + c] if known[2] else np.int64(0)
        guesses[c, 3] = (a + b) >> 1
        if blended:
            out[c] = _blend(guesses, c, known, cols, sides, ERRORS_XY)
        else:
            q = _elsewhere(sides, last)
            out[c] = cols[q, X + c] if q >= 0 else np.int64(0)


@njit(cache=True, nogil=True)
def _rise(across, outward, ratio):
    return bounded(across * ratio // outward, -_STEEPEST, _STEEPEST)


@njit(cache=True, nogil=True)
def predict_start(cols, sides, last, column, heads, guesses, known):
    """The predicted Z of a column whose direction is set: along the mean slope of both; ``guesses[2]`` as above."""
    a = np.int64(0)
    b = np.int64(0)
    blended = _know(sides, known)
    if known[0]:
        own = _rise(cols[column, U + 1], cols[column, U + 2], heads[RATIO_B])
        a = cols[sides[0], Z] + ((own + _rise(cols[sides[0], U + 1], cols[sides[0], U + 2], heads[RATIO_B])) >> 1)
    if known[1]:
        own = _rise(cols[column, U], cols[column, U + 2], heads[RATIO_A])
        b = cols[sides[1], Z] + ((own + _rise(cols[sides[1], U], cols[sides[1], U + 2], heads[RATIO_A])) >> 1)
    guesses[2, 0] = a
    guesses[2, 1] = b
    guesses[2, 2] = cols[sides[0], Z] + cols[sides[1], Z] - cols[sides[2], Z] if known[2] else np.int64(0)
    guesses[2, 3] = (a + b) >> 1
    if blended:
        return _blend(guesses, 2, known, cols, sides, ERRORS_Z)
    q = _elsewhere(sides, last)
    return cols[q, Z] if q >= 0 else np.int64(0)


@njit(cache=True, nogil=True)
def _whole(cols, column):
    return cols[column, AMPLITUDE] + (cols[column, AMPLITUDE_2] if cols[column, TWO] else np.int64(0))


@njit(cache=True, nogil=True)
def predict_amplitude(cols, sides, two, heads):
    """Half the top of two surfaces; of one the median of west, north, and both less the corner."""
    west, north, corner = sides[0], sides[1], sides[2]
    if two:
        return heads[TOP] >> 1
    if west < 0 and north < 0:
        return heads[TOP]
    if west < 0 or north < 0:
        return min(heads[TOP], _whole(cols, max(west, north)))
    a, b = _whole(cols, west), _whole(cols, north)
    c = _whole(cols, corner) if corner >= 0 else a
    return min(max(min(a, b), min(max(a, b), a + b - c)), heads[TOP])


@njit(cache=True, nogil=True)
def predict_second(cols, beside, column, heads, out):
    """What is expected of the second surface of a column, out = (Z, X, Y, amplitude).

    The mean of the second surfaces beside; else the deepest surface beside, if it lies behind; else the first.
    """
    count = np.int64(0)
    for c in range(3):
        out[c] = 0
    for s in range(4):
        if beside[s] >= 0 and cols[beside[s], TWO]:
            count += 1
            for c in range(3):
                out[c] += cols[beside[s], SECOND + c]
    if count:
        for c in range(3):
            out[c] //= count
    else:
        deepest = cols[column, Z] + _TORN
        out[0] = deepest + _TORN
        out[1] = cols[column, X]
        out[2] = cols[column, Y]
        for s in range(4):
            if beside[s] >= 0 and cols[beside[s], Z] > deepest:
                deepest = cols[beside[s], Z]
                for c in range(3):
                    out[c] = cols[beside[s], Z + c]
    out[3] = max(heads[TOP] >> 4, heads[TOP] - cols[column, AMPLITUDE])


@njit(cache=True, nogil=True)
def set_second(col, predicted, residuals, heads):
    """Keep the second surface of a column: residuals[7:11] from what `predict_second` says."""
    col[Z_2] = bounded(predicted[0] + residuals[7] * heads[Z_STEP], -_FAR, _FAR)
    x = predicted[1] + residuals[8] * heads[DIRECTION_STEP]
    set_direction(col, _X_2, x, predicted[2] + residuals[9] * heads[DIRECTION_STEP], _U_2)
    col[AMPLITUDE_2] = bounded(predicted[3] + residuals[10] * amplitude_step(heads[TOP], heads), 1, LIMIT)


# -- the forces -----------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def shape_of(col, heads, deep, slope):
    """The forces deep inside of both surfaces (across, across, outward; units), and the growth of their shares."""
    for c in range(3):
        deep[c] = (col[AMPLITUDE] * col[U + c] + 8192) >> 14
        deep[3 + c] = (col[AMPLITUDE_2] * col[_U_2 + c] + 8192) >> 14 if col[TWO] else np.int64(0)
    slope[0] = max(np.int64(16), ((heads[RAMP] * col[U + 2] >> 14) * (BEND_STEP + col[BEND])) // BEND_STEP)
    slope[1] = max(np.int64(16), heads[RAMP] * col[_U_2 + 2] >> 14) if col[TWO] else np.int64(16)


@njit(cache=True, nogil=True)
def share_at(t, z, slope):
    """What share of the deep force there is at sample t of a surface that starts at z."""
    inside = (t << 8) - z
    return min(np.int64(65536), inside * slope >> 8) if inside > 0 else np.int64(0)


@njit(cache=True, nogil=True)
def _first_of(col):
    """The first sample of a column that may hold a force."""
    first = min(col[Z], col[Z_2]) if col[TWO] else col[Z]
    return max(np.int64(0), (first >> 8) + 1)


@njit(cache=True, nogil=True)
def tile_spans(cols, depth, out):
    """The first sample of each tile that may hold a force, int64 [n]; `depth` where none does."""
    for n in range(out.shape[0]):
        out[n] = depth
        for c in range(n * 64, n * 64 + 64):
            if cols[c, PRESENT]:
                out[n] = min(out[n], _first_of(cols[c]))


@njit(cache=True, nogil=True)
def fill_bricks(begin, end, tile_of, low_of, places, cols, heads, depth, inverted, order, out):
    """Forces of bricks begin to end - 1 of tiles: ``out[places[n], i, j, k, component]``, int32, zero before.

    ``low_of[n]`` is the first sample of brick n along the axis, in the grid's sense.
    """
    deep = np.empty(6, np.int64)
    slope = np.empty(2, np.int64)
    force = np.empty(3, np.int64)
    for n in range(begin, end):
        at = places[n]
        for column in range(64):
            col = cols[tile_of[n] * 64 + column]
            if not col[PRESENT]:
                continue
            first = _first_of(col)
            shape_of(col, heads, deep, slope)
            outer = depth - 8 - low_of[n] if inverted else low_of[n]
            whole = outer >= first and share_at(outer, col[Z], slope[0]) == 65536
            whole &= col[TWO] == 0 or share_at(outer, col[Z_2], slope[1]) == 65536
            whole &= col[AMPLITUDE] + (col[AMPLITUDE_2] if col[TWO] else 0) > heads[CUT]
            for k in range(min(8, depth - low_of[n])):
                t = depth - 1 - low_of[n] - k if inverted else low_of[n] + k
                if t < first:
                    continue
                if k == 0 or not whole:
                    share = share_at(t, col[Z], slope[0])
                    more = share_at(t, col[Z_2], slope[1]) if col[TWO] else np.int64(0)
                    if share * col[AMPLITUDE] + more * col[AMPLITUDE_2] <= heads[CUT] << 16:
                        continue
                    for c in range(3):
                        force[c] = bounded((deep[c] * share + deep[3 + c] * more + 32768) >> 16, -LIMIT, LIMIT)
                    if not inverted:
                        force[2] = -force[2]
                for c in range(3):
                    out[at, column >> 3, column & 7, k, order[c]] = force[c]
