"""Compiled code of the column guess: presence, residuals and what follows of them, the same in both directions."""

from __future__ import annotations

from typing import Final

import numpy as np

from touchfield.codec.kernels.bits import even, mix
from touchfield.codec.kernels.lean import entry, lean
from touchfield.codec.touch.kernels.columns import (
    AMPLITUDE,
    DIRECTION_STEP,
    LIMIT,
    PRESENT,
    SIZE_AMPLITUDE,
    SIZE_XY,
    SIZE_Z,
    TOP,
    TWO,
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
    sides_of,
)  # fmt: skip

__all__ = [
    "CONTEXTS", "MODE", "RESIDUALS", "SETS", "SPLIT", "beside_of", "code_column", "code_presence", "read_columns",
    "room",
]  # fmt: skip

RESIDUALS: Final = 9
"""Of X, Y, Z, amplitude; the mode of prediction; Z, X, Y, amplitude of the second surface; `SPLIT` is two or one."""
MODE: Final = 4
SPLIT: Final = 9

_NODES = 22  # of a number: 0 is "not zero", 1 the sign, 2 to 21 "larger than 1 to 20"
_LONGEST = 20
_FIRST, _SECOND = 64, 32
# of a NumPy type: numba compiles a function anew for each int that is written out
_PRESENT, _MODE, _TWO, _XY, _Z, _AMPLITUDE, _HALF, _Z_2, _XY_2, _AMPLITUDE_2 = np.arange(10)
_ZERO, _SIGN = np.arange(2)
SETS: Final = 10 * _NODES
CONTEXTS: Final = SETS * (_FIRST + _SECOND)
_FAR = 1 << 24


def room() -> Room:
    """Room for the work on one column, none told yet."""
    four, last = np.zeros((3, 4), np.int64), np.full(1, -1, np.int64)
    return Room(four[0], four[1], np.zeros(RESIDUALS + 1, np.int64), four[2], last)


@lean
def _bit(bits, at, kind, node, first, second, bit):
    chosen = kind * _NODES + node
    bits.inputs[0] = at[0] + chosen * (_FIRST + _SECOND) + first
    bits.inputs[1] = at[0] + chosen * (_FIRST + _SECOND) + _FIRST + second
    return mix(bits, 2, at[1] + chosen, bit)


@lean
def _number(bits, at, kind, first, second, r):
    """A residual: is it zero, its sign, its size one by one to 20, the rest in Elias gamma code."""
    size = abs(r)
    negative = np.int64(0)
    found = np.int64(0)
    while found <= _LONGEST:
        if found == 1 and negative == 0:
            negative = 1 + _bit(bits, at, kind, _SIGN, first, second, np.int64(r < 0))
        elif not _bit(bits, at, kind, found + (found > 0), first, second, np.int64(size > found)):
            return -found if negative == 2 else found
        else:
            found += 1
    digits = np.int64(0)
    while digits < 24 and even(bits, np.int64((size - _LONGEST) >> (digits + 1) > 0), 1):
        digits += 1
    rest = (np.int64(1) << digits) | even(bits, size - _LONGEST, digits)
    return -(_LONGEST + rest) if negative == 2 else _LONGEST + rest


@lean
def beside_of(columns, tile, i, j, out):
    """The columns to the west, north, north-west and north-east of (i, j) of a tile."""
    for s in range(4):
        a = i - (s > 0)
        b = j - (s == 0 or s == 2) + (s == 3)
        at = tile
        if a < 0:
            at = columns.around[tile, 2 if b < 0 else (3 if b > 7 else 1)]
        elif b < 0:
            at = columns.around[tile, 0]
        elif b > 7:
            at = np.int64(-1)  # of a tile to come
        out[s] = -1
        if at >= 0:
            column = at * 64 + (a & 7) * 8 + (b & 7)
            if columns.cols[column, PRESENT]:
                out[s] = column


@lean
def code_presence(bits, at, columns, room, column, i, j):
    """Whether a column is there at all."""
    mask = np.int64(0)
    for s in range(4):
        mask = mask * 2 + (room.beside[s] >= 0)
    edge = np.int64(i == 0) * 2 + np.int64(j == 0)
    here = _bit(bits, at, _PRESENT, _ZERO, mask, edge * 4 + (mask >> 2), columns.cols[column, PRESENT])
    columns.cols[column, PRESENT] = here
    return here


@lean
def _sizes(cols, beside, place, most):
    """How large residuals were to the west and north, `most` where unknown; below (most + 1)^2."""
    west = min(cols[beside[0], place], np.int64(most)) if beside[0] >= 0 else np.int64(most)
    north = min(cols[beside[1], place], np.int64(most)) if beside[1] >= 0 else np.int64(most)
    return west * (most + 1) + north


@lean
def _near(r):
    return min(abs(r), np.int64(3))


@lean
def code_column(bits, at, columns, room, column):
    """Code the residuals of one column, and set what it stands for; False if that cannot be."""
    cols, heads, beside, r, predicted = columns.cols, columns.heads, room.beside, room.residuals, room.predicted
    few = twos = np.int64(0)
    for s in range(4):
        few += beside[s] >= 0
        twos = twos * 2 + (beside[s] >= 0 and cols[beside[s], TWO] > 0)
    few = min(few, np.int64(3))
    torn = np.int64(is_torn(cols, beside))
    two = _bit(bits, at, _TWO, _ZERO, twos, torn * 4 + few, r[SPLIT])
    mode = np.int64(0)
    if torn:
        mode = _bit(bits, at, _MODE, _ZERO, twos >> 2, two, r[MODE] >> 1)
        mode = 2 * mode + _bit(bits, at, _MODE, 1 + mode, twos >> 2, two, r[MODE] & 1)
    if not sides_of(mode, cols, beside, room.sides):
        return False
    sizes = _sizes(cols, beside, SIZE_XY, 4)
    r[0] = _number(bits, at, _XY, sizes, few, r[0])
    r[1] = _number(bits, at, _XY, 25 + sizes, 4 + _near(r[0]) * 4 + few, r[1])
    col = cols[column]
    predict_direction(cols, room)
    x = predicted[0] + r[0] * heads[DIRECTION_STEP]
    set_direction(col, X, x, predicted[1] + r[1] * heads[DIRECTION_STEP], U)
    start = predict_start(cols, room, column, heads)
    amplitude = predict_amplitude(cols, room.sides, two, heads)
    turned = max(_near(r[0]), _near(r[1]))
    r[2] = _number(bits, at, _Z, _sizes(cols, beside, SIZE_Z, 6), turned * 4 + few, r[2])
    sizes = _sizes(cols, beside, SIZE_AMPLITUDE, 4)
    r[3] = _number(bits, at, _HALF if two else _AMPLITUDE, sizes, _near(r[2]) * 4 + turned, r[3])
    col[Z] = bounded(start + r[2] * heads[Z_STEP], -_FAR, _FAR)
    col[AMPLITUDE] = bounded(amplitude + r[3] * amplitude_step(heads[TOP] if two else amplitude, heads), 1, LIMIT)
    col[SIZE_XY] = abs(r[0]) + abs(r[1])
    col[SIZE_Z] = abs(r[2])
    col[SIZE_AMPLITUDE] = abs(r[3])
    col[TWO] = two
    if two:
        predict_second(cols, beside, column, heads, predicted)
        first = 4 * np.int64(twos > 0) + _near(r[2])
        r[5] = _number(bits, at, _Z_2, first, _ZERO, r[5])
        r[6] = _number(bits, at, _XY_2, first, _ZERO, r[6])
        r[7] = _number(bits, at, _XY_2, 8 + first, 1 + _near(r[6]), r[7])
        r[8] = _number(bits, at, _AMPLITUDE_2, first, _ZERO, r[8])
        set_second(col, predicted, r, heads)
    room.last[0] = column
    return True


@entry
def read_columns(bits, at, columns, room):
    """Read all columns, tile by tile; False where one is predicted from a column that is not there.

    `at` tells where the chances and the weights of columns begin.
    """
    for tile in range(columns.tiles.shape[0]):
        for i in range(min(8, columns.sizes[0] - columns.tiles[tile, 0] * 8)):
            for j in range(min(8, columns.sizes[1] - columns.tiles[tile, 1] * 8)):
                column = tile * 64 + i * 8 + j
                beside_of(columns, tile, i, j, room.beside)
                here = code_presence(bits, at, columns, room, column, i, j)
                if here and not code_column(bits, at, columns, room, column):
                    return False
    return True
