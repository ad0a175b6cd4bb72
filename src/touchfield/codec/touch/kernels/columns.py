"""Compiled columns of the column guess: what is kept of each, how it is predicted, and the forces it stands for.

Positions are in 1/256 samples from outside to inside, directions in 1/16384, shares in 1/65536. No product reaches
2^53.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numba import njit

from touchfield.codec.kernels.lean import entry, lean
from touchfield.codec.touch.kernels.lattice import root

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "AMPLITUDE", "AMPLITUDE_2", "CUT", "DIRECTION_STEP", "HEADS", "HEAD_LIMITS", "LIMIT", "MODES", "PRESENT", "RAMP",
    "RATIO_A", "RATIO_B", "SECOND", "SIZE_AMPLITUDE", "SIZE_XY", "SIZE_Z", "TOP", "TWO", "WIDTH", "Z_2", "Z_STEP",
    "Columns", "Layout", "Room", "U", "X", "Z", "amplitude_step", "bounded", "fill_bricks", "is_torn",
    "predict_amplitude", "predict_direction", "predict_second", "predict_start", "set_direction", "set_second",
    "shape_of", "share_at", "sides_of", "tile_spans",
]  # fmt: skip

LIMIT: Final = (1 << 17) - 1
"""No component of a force is beyond it, units."""

HEADS: Final = 8
"""Whole numbers that all columns share, in the order of the following names."""
TOP, RAMP, RATIO_A, RATIO_B, Z_STEP, DIRECTION_STEP, AMPLITUDE_STEP, CUT = range(HEADS)
HEAD_LIMITS: Final = (1 << 17, 1 << 20, 1 << 20, 1 << 20, 1 << 12, 1 << 14, 1 << 16, 1 << 17)

PRESENT, Z, X, Y, AMPLITUDE, TWO = range(6)
SECOND = Z_2 = 6
_X_2, _Y_2, AMPLITUDE_2 = 7, 8, 9
U, _U_2 = 10, 13
"""The outward direction (along the axes across, and outward) of the first surface and of the second."""
SIZE_XY, SIZE_Z, SIZE_AMPLITUDE = 16, 17, 18
WIDTH: Final = 19
"""Whole numbers kept of each column: those told, and what is derived of them."""

MODES: Final = 4
_TORN = 768  # neighbours whose starts differ by three samples may not speak for one surface
_FAR = 1 << 24
_DISC = 1 << 29  # square of (X, Y) at a right angle to the axis
_DISC_ROOT = 23170
_SQUARE_LIMIT = 32767
_LEAST_OUT = 820  # 87 degrees to the axis
_STEEPEST = 4096  # a surface rises by 16 samples from column to column at most


class Columns(NamedTuple):
    """All columns of a frame, 64 a tile (a slower than b), and one of scratch.

    Attributes
    ----------
    tiles, around : int64 [tiles, 2], [tiles, 4]
        Their places; and which lie to the west, north, north-west and north-east, -1 for none.
    sizes : int64 [2]
        Samples of the grid across.
    heads : int64 [HEADS]
    cols : int64 [64 tiles + 1, WIDTH]
    """

    tiles: NDArray[np.int64]
    around: NDArray[np.int64]
    sizes: NDArray[np.int64]
    heads: NDArray[np.int64]
    cols: NDArray[np.int64]


class Room(NamedTuple):
    """What the work on one column takes.

    Attributes
    ----------
    beside, sides : int64 [4]
        The columns to the west, north, north-west and north-east, -1 for none; and those predicted from.
    residuals, predicted : int64 [RESIDUALS], [4]
    last : int64 [1]
        The column told last, -1 before the first.
    """

    beside: NDArray[np.int64]
    sides: NDArray[np.int64]
    residuals: NDArray[np.int64]
    predicted: NDArray[np.int64]
    last: NDArray[np.int64]


@lean
def bounded(value, low, high):
    return min(max(value, np.int64(low)), np.int64(high))


@lean
def amplitude_step(amplitude, heads):
    """One step of a column's amplitude near `amplitude`, units."""
    return max(np.int64(1), amplitude * heads[AMPLITUDE_STEP] >> 16)


@lean
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


@lean
def is_torn(cols, beside):
    """Whether the columns beside may belong to different surfaces."""
    torn = False
    for s in range(2):
        torn |= beside[s] >= 0 and cols[beside[s], TWO] > 0
    if beside[0] >= 0 and beside[1] >= 0:
        torn |= abs(cols[beside[0], Z] - cols[beside[1], Z]) > _TORN
    return torn


@lean
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
            out[s] = spare
            return True
    return False


@lean
def _elsewhere(sides, last):
    """The column to go by where there is none to the west and north."""
    return sides[3] if sides[3] >= 0 else (sides[2] if sides[2] >= 0 else last)


@lean
def _median(a, b, c):
    return max(min(a, b), min(max(a, b), c))


@lean
def predict_direction(cols, room):
    """``room.predicted[:2]`` becomes the predicted (X, Y): the mean of both, halfway to both less the corner."""
    sides, out = room.sides, room.predicted
    west, north, corner = sides[0], sides[1], sides[2]
    other = _elsewhere(sides, room.last[0])
    for c in range(2):
        if west >= 0 and north >= 0:
            a, b = cols[west, X + c], cols[north, X + c]
            both = (a + b) >> 1
            out[c] = both if corner < 0 else (both + _median(a, b, a + b - cols[corner, X + c])) >> 1
        elif west >= 0 or north >= 0:
            out[c] = cols[max(west, north), X + c]
        else:
            out[c] = cols[other, X + c] if other >= 0 else np.int64(0)


@lean
def _rise(across, outward, ratio):
    return bounded(across * ratio // outward, -_STEEPEST, _STEEPEST)


@lean
def predict_start(cols, room, column, heads):
    """The predicted Z of a column whose direction is set: along the mean slope of both."""
    sides = room.sides
    west, north, corner = sides[0], sides[1], sides[2]
    if west < 0 and north < 0:
        other = _elsewhere(sides, room.last[0])
        return cols[other, Z] if other >= 0 else np.int64(0)
    a = _rise(cols[column, U + 1], cols[column, U + 2], heads[RATIO_B])
    a = cols[west, Z] + ((a + _rise(cols[west, U + 1], cols[west, U + 2], heads[RATIO_B])) >> 1)
    b = _rise(cols[column, U], cols[column, U + 2], heads[RATIO_A])
    b = cols[north, Z] + ((b + _rise(cols[north, U], cols[north, U + 2], heads[RATIO_A])) >> 1)
    if west < 0 or north < 0:
        return b if west < 0 else a
    if corner < 0:
        return (a + b) >> 1
    planar = cols[west, Z] + cols[north, Z] - cols[corner, Z]
    return (((a + b) >> 1) + _median(a, b, planar)) >> 1


@lean
def _whole(cols, column):
    return cols[column, AMPLITUDE] + (cols[column, AMPLITUDE_2] if cols[column, TWO] else np.int64(0))


@lean
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
    return min(_median(a, b, a + b - c), heads[TOP])


@lean
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


@lean
def set_second(col, predicted, residuals, heads):
    """Keep the second surface of a column: residuals[5:9] from what `predict_second` says."""
    col[Z_2] = bounded(predicted[0] + residuals[5] * heads[Z_STEP], -_FAR, _FAR)
    x = predicted[1] + residuals[6] * heads[DIRECTION_STEP]
    set_direction(col, _X_2, x, predicted[2] + residuals[7] * heads[DIRECTION_STEP], _U_2)
    col[AMPLITUDE_2] = bounded(predicted[3] + residuals[8] * amplitude_step(heads[TOP], heads), 1, LIMIT)


# -- the forces -----------------------------------------------------------------------------------------------------


@lean
def shape_of(col, heads, deep, slope):
    """The forces deep inside of both surfaces (across, across, outward; units), and the growth of their shares."""
    for c in range(3):
        deep[c] = (col[AMPLITUDE] * col[U + c] + 8192) >> 14
        deep[3 + c] = (col[AMPLITUDE_2] * col[_U_2 + c] + 8192) >> 14 if col[TWO] else np.int64(0)
    slope[0] = max(np.int64(16), heads[RAMP] * col[U + 2] >> 14)
    slope[1] = max(np.int64(16), heads[RAMP] * col[_U_2 + 2] >> 14) if col[TWO] else np.int64(16)


@lean
def share_at(t, z, slope):
    """What share of the deep force there is at sample t of a surface that starts at z."""
    inside = (t << 8) - z
    return min(np.int64(65536), inside * slope >> 8) if inside > 0 else np.int64(0)


@lean
def _first_of(col):
    """The first sample of a column that may hold a force."""
    first = min(col[Z], col[Z_2]) if col[TWO] else col[Z]
    return max(np.int64(0), (first >> 8) + 1)


@entry
def tile_spans(cols, depth, out):
    """The first sample of each tile that may hold a force, int64 [n]; `depth` where none does."""
    for n in range(out.shape[0]):
        out[n] = depth
        for c in range(n * 64, n * 64 + 64):
            if cols[c, PRESENT]:
                out[n] = min(out[n], _first_of(cols[c]))


class Layout(NamedTuple):
    """Where the bricks of the guess lie.

    Attributes
    ----------
    tile_of, low_of : int64 [bricks]
        The tile, and the first sample along the axis in the grid's sense.
    depth : int
        Samples along the axis.
    inverted : bool
    order : int64 [3]
        The axes across, and the main one.
    """

    tile_of: NDArray[np.int64]
    low_of: NDArray[np.int64]
    depth: int
    inverted: bool
    order: NDArray[np.int64]


@njit(cache=True, nogil=True)
def fill_bricks(begin, end, layout, heads, cols, out):
    """Forces of bricks begin to end - 1: ``out[n, i, j, k, component]``, int32, zero before."""
    depth, inverted, order = layout.depth, layout.inverted, layout.order
    deep = np.empty(6, np.int64)
    slope = np.empty(2, np.int64)
    force = np.empty(3, np.int64)
    for n in range(begin, end):
        for column in range(64):
            col = cols[layout.tile_of[n] * 64 + column]
            if not col[PRESENT]:
                continue
            first = _first_of(col)
            shape_of(col, heads, deep, slope)
            outer = depth - 8 - layout.low_of[n] if inverted else layout.low_of[n]
            whole = outer >= first and share_at(outer, col[Z], slope[0]) == 65536
            whole &= col[TWO] == 0 or share_at(outer, col[Z_2], slope[1]) == 65536
            whole &= col[AMPLITUDE] + (col[AMPLITUDE_2] if col[TWO] else 0) > heads[CUT]
            for k in range(min(8, depth - layout.low_of[n])):
                t = depth - 1 - layout.low_of[n] - k if inverted else layout.low_of[n] + k
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
                    out[n, column >> 3, column & 7, k, order[c]] = force[c]
