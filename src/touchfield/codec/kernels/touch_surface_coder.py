"""Compiled loop of the surface coder: presence, residuals and what follows of them, the same in both directions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.codec.kernels.mixer import PLACE, Coder, mixed, narrow
from touchfield.codec.kernels.touch_lattice import LIMIT
from touchfield.codec.kernels.touch_surface import (
    AMPLITUDE,
    BEND,
    DIRECTION_STEP,
    ERRORS_XY,
    ERRORS_Z,
    PRESENT,
    SIZE_AMPLITUDE,
    SIZE_BEND,
    SIZE_XY,
    SIZE_Z,
    STILL,
    TWO,
    Z_STEP,
    U,
    X,
    Y,
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
from touchfield.codec.kernels.touch_surface_choice import RESIDUALS, choose

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["DONE", "ENDED", "FAULT", "code_columns", "surface_coder"]

DONE, FAULT, ENDED = 0, 1, 2
"""Status: all is well; a prediction from nothing; the bits end too early."""

_NODES = 22  # of a number: 0 is "not zero", 1 the sign, 2 to 21 "larger than 1 to 20"
_LONGEST = 20
_FIRST, _SECOND = 64, 32
_PRESENT, _STILL, _MODE, _TWO, _XY, _Z, _AMPLITUDE, _BEND, _HALF, _Z_2, _XY_2, _AMPLITUDE_2 = range(12)
_KINDS = 12
CONTEXTS = (_KINDS * _NODES * _FIRST, _KINDS * _NODES * _SECOND)
_FAR = 1 << 24


def surface_coder(buffer: NDArray[np.uint8], *, decoding: bool) -> Coder:
    """A coder with the contexts of surfaces."""
    return Coder(buffer, decoding, CONTEXTS, _KINDS * _NODES)


@njit(cache=True, nogil=True)
def _bit(kind, node, first, second, bit, decoding, code):
    state, buffer, chances, visits, weights = code
    chosen = kind * _NODES + node
    a = chosen * _FIRST + first
    b = CONTEXTS[0] + chosen * _SECOND + second
    return mixed(a, b, chosen, bit, decoding, state, buffer, chances, visits, weights)


@njit(cache=True, nogil=True)
def _even(bit, decoding, code):
    return narrow(np.int64(32768), bit, decoding, code[0], code[1])


@njit(cache=True, nogil=True)
def _number(r, kind, first, second, decoding, code):
    """A residual: is it zero, its sign, its size one by one to 20, the rest in Elias gamma code."""
    size = abs(r)
    negative = np.int64(r < 0)
    node = np.int64(0)
    found = np.int64(0)
    while found <= _LONGEST:
        if node == 1:
            negative = _bit(kind, node, first, second, negative, decoding, code)
        elif _bit(kind, node, first, second, np.int64(size > found), decoding, code):
            found += 1
        else:
            return -found if negative else found
        node += 1
    digits = np.int64(0)
    while digits < 24 and _even(np.int64((size - _LONGEST) >> (digits + 1) > 0), decoding, code):
        digits += 1
    rest = np.int64(1)
    for place in range(digits - 1, -1, -1):
        rest = (rest << 1) | _even(((size - _LONGEST) >> place) & 1, decoding, code)
    return -(_LONGEST + rest) if negative else _LONGEST + rest


@njit(cache=True, nogil=True)
def _beside(tile, i, j, around, cols, out):
    """The columns to the west, north, north-west and north-east; `around` holds the tiles in that order."""
    for s in range(4):
        a = i - (s > 0)
        b = j - (s == 0 or s == 2) + (s == 3)
        at = tile
        if a < 0:
            at = around[tile, 2 if b < 0 else (3 if b > 7 else 1)]
        elif b < 0:
            at = around[tile, 0]
        elif b > 7:
            at = np.int64(-1)  # of a tile to come
        out[s] = -1
        if at >= 0:
            column = at * 64 + (a & 7) * 8 + (b & 7)
            if cols[column, PRESENT]:
                out[s] = column


@njit(cache=True, nogil=True)
def _sizes(cols, beside, place, most):
    """How large residuals were to the west and north, `most` where unknown; below (most + 1)^2."""
    west = min(cols[beside[0], place], np.int64(most)) if beside[0] >= 0 else np.int64(most)
    north = min(cols[beside[1], place], np.int64(most)) if beside[1] >= 0 else np.int64(most)
    return west * (most + 1) + north


@njit(cache=True, nogil=True)
def _near(r):
    return min(abs(r), np.int64(3))


@njit(cache=True, nogil=True)
def _code_one(column, beside, sides, last, r, heads, decoding, code, cols, guesses, known, predicted):
    """Code the residuals `r` of one column (see `RESIDUALS`), and set what it stands for; False if it cannot be."""
    count = stills = twos = still_mask = np.int64(0)
    for s in range(4):
        there = beside[s] >= 0
        still = there and cols[beside[s], STILL] > 0
        count += there
        stills += still
        still_mask = still_mask * 2 + still
        twos = twos * 2 + (there and cols[beside[s], TWO] > 0)
    few = min(count, np.int64(3))
    torn = np.int64(is_torn(cols, beside))
    two = _bit(_TWO, 0, twos, torn * 4 + few, r[6], decoding, code)
    mode = np.int64(0)
    if torn:
        mode = _bit(_MODE, 0, twos >> 2, two, r[5] >> 1, decoding, code)
        mode = 2 * mode + _bit(_MODE, 1 + mode, twos >> 2, two, r[5] & 1, decoding, code)
    if not sides_of(mode, cols, beside, sides):
        return False
    moved = np.int64(two)
    for q in range(5):
        moved |= r[q] != 0
    if not two:
        second = min(stills, np.int64(3)) * 4 + few
        moved = _bit(_STILL, 0, still_mask * 4 + few, second, moved, decoding, code)
    if moved:
        sizes = _sizes(cols, beside, SIZE_XY, 4)
        r[0] = _number(r[0], _XY, sizes, few, decoding, code)
        r[1] = _number(r[1], _XY, 25 + sizes, 4 + _near(r[0]) * 4 + few, decoding, code)
    else:
        for q in range(5):
            r[q] = 0
    col = cols[column]
    predict_direction(cols, sides, last, guesses, known, predicted)
    x = predicted[0] + r[0] * heads[DIRECTION_STEP]
    set_direction(col, X, x, predicted[1] + r[1] * heads[DIRECTION_STEP], U)
    start = predict_start(cols, sides, last, column, heads, guesses, known)
    amplitude = predict_amplitude(cols, sides, two, heads)
    if moved:
        turned = max(_near(r[0]), _near(r[1]))
        r[2] = _number(r[2], _Z, _sizes(cols, beside, SIZE_Z, 6), turned * 4 + few, decoding, code)
        sizes = _sizes(cols, beside, SIZE_AMPLITUDE, 4)
        r[3] = _number(r[3], _HALF if two else _AMPLITUDE, sizes, _near(r[2]) * 4 + turned, decoding, code)
        if two:
            r[4] = 0
        else:
            sizes = _sizes(cols, beside, SIZE_BEND, 3)
            r[4] = _number(r[4], _BEND, sizes, _near(r[2]) * 4 + _near(r[3]), decoding, code)
    col[Z] = bounded(start + r[2] * heads[Z_STEP], -_FAR, _FAR)
    col[AMPLITUDE] = bounded(amplitude + r[3] * amplitude_step(heads[0] if two else amplitude, heads), 1, LIMIT)
    col[BEND] = bounded(r[4], -7, 24)
    col[STILL] = 1 - moved
    col[SIZE_XY] = abs(r[0]) + abs(r[1])
    col[SIZE_Z] = abs(r[2])
    col[SIZE_AMPLITUDE] = abs(r[3])
    col[SIZE_BEND] = abs(r[4])
    for q in range(4):
        missed = abs(guesses[0, q] - col[X]) + abs(guesses[1, q] - col[Y])
        col[ERRORS_XY + q] = min(missed >> 3, np.int64(8191)) if known[q] else np.int64(512)
        col[ERRORS_Z + q] = min(abs(guesses[2, q] - col[Z]), np.int64(8191)) if known[q] else np.int64(256)
    col[TWO] = two
    if two:
        predict_second(cols, beside, column, heads, predicted)
        first = 4 * (twos > 0) + _near(r[2])
        r[7] = _number(r[7], _Z_2, first, 0, decoding, code)
        r[8] = _number(r[8], _XY_2, first, 0, decoding, code)
        r[9] = _number(r[9], _XY_2, 8 + first, 1 + _near(r[8]), decoding, code)
        r[10] = _number(r[10], _AMPLITUDE_2, first, 0, decoding, code)
        set_second(col, predicted, r, heads)
    return True


@njit(cache=True, nogil=True)
def code_columns(begin, end, decoding, code, tiles, around, sizes, heads, cols, fitting, last):
    """Code the columns of tiles begin to end - 1, tile by tile; `fitting` is what the encoder chooses by.

    ``last[0]`` is the column coded last, -1 before the first. `code` is the arithmetic coder's (state, buffer,
    chances, visits, weights).
    """
    beside = np.empty(4, np.int64)
    sides = np.empty(4, np.int64)
    guesses = np.zeros((3, 4), np.int64)
    known = np.zeros(4, np.bool_)
    predicted = np.zeros(4, np.int64)
    r = np.zeros(RESIDUALS, np.int64)
    for tile in range(begin, end):
        if decoding and code[0][PLACE] > code[1].shape[0] + 8:
            return ENDED
        for i in range(min(8, sizes[0] - tiles[tile, 0] * 8)):
            for j in range(min(8, sizes[1] - tiles[tile, 1] * 8)):
                column = tile * 64 + i * 8 + j
                _beside(tile, i, j, around, cols, beside)
                mask = np.int64(0)
                for s in range(4):
                    mask = mask * 2 + (beside[s] >= 0)
                at_edge = (i == 0) * 2 + (j == 0)
                here = _bit(_PRESENT, 0, mask, at_edge * 4 + (mask >> 2), cols[column, PRESENT], decoding, code)
                cols[column, PRESENT] = here
                if not here:
                    continue
                if not decoding:
                    choose(column, tile - begin, beside, sides, last[0], heads, fitting, cols, guesses, known, r)
                if not _code_one(
                    column, beside, sides, last[0], r, heads, decoding, code, cols, guesses, known, predicted
                ):
                    return FAULT
                last[0] = column
    return DONE
