"""Compiled code of the column guess: surfaces predicted from those beside, the same in both directions.

Positions are in 1/256 samples from outside to inside, directions in 1/16384, shares in 1/65536. No product reaches
2^62.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from touchfield.codec.kernels.bits import even, mix
from touchfield.codec.kernels.lean import entry, lean

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "A", "A_STEP", "CONTEXTS", "CUT", "HEADS", "LIMIT", "MODES", "RAMP", "RATIO_A", "RATIO_B", "SETS", "SLOTS", "TOP",
    "U", "WIDTH", "XY_STEP", "Z_STEP", "Columns", "X", "Y", "Z", "amplitude_step", "code_column", "expect", "is_torn",
    "read_columns", "set_surface", "slope_of",
]  # fmt: skip

LIMIT: Final = (1 << 17) - 1
"""No component of a force is beyond it, units."""

TOP, RAMP, RATIO_A, RATIO_B, Z_STEP, XY_STEP, A_STEP, CUT = range(8)
"""Whole numbers that all columns share."""
HEADS: Final = (1 << 17, 1 << 20, 1 << 20, 1 << 20, 1 << 12, 1 << 14, 1 << 16, 1 << 17)
"""What they are below."""

SLOTS: Final = 2
"""Surfaces that a column may have."""
Z, X, Y, A, U, _U_B, _U_OUT, _TURN, _SHIFT, _GAIN, WIDTH = range(11)
"""Of a surface: what is told, the direction (along a, b and outward), and how far the residuals went."""

MODES: Final = 4
_TORN = 768  # neighbours whose starts differ by three samples may not speak for one surface
_FAR = 1 << 24
_STEEPEST = 4096  # a surface rises by 16 samples from column to column at most
_ONE = 16384
_LEAST_OUT = 820  # 87 degrees to the axis

_NODES = 22  # of a number: 0 is "not zero", 1 the sign, 2 to 21 "larger than 1 to 20"
_LONGEST = 20
_FIRST, _SECOND = 64, 32
# of a NumPy type: numba compiles a function anew for each int that is written out
_COUNT, _MODE, _NUMBERS = np.arange(3)
_ZERO = np.int64(0)
SETS: Final = (2 + 6) * _NODES
CONTEXTS: Final = SETS * (_FIRST + _SECOND)


class Columns(NamedTuple):
    """Columns of a box, row by row, with one of none before and behind each row, and a row of none before all.

    Attributes
    ----------
    surfaces : int64 [rows + 1, row + 2, SLOTS, WIDTH] as [n, WIDTH]
        Amplitude 0 where there is none.
    row : int
        Surfaces from a row to the next.
    heads : int64 [8]
    told : int64 [2]
        Of the column at hand: surfaces, and the mode of prediction.
    residuals : int64 [SLOTS, 4]
        Of X, Y, Z, A of these.
    expected : int64 [4]
        Z, X, Y, A.
    """

    surfaces: NDArray[np.int64]
    row: int
    heads: NDArray[np.int64]
    told: NDArray[np.int64]
    residuals: NDArray[np.int64]
    expected: NDArray[np.int64]


@lean
def _bounded(value, most):
    return min(max(value, -most), most)


@lean
def amplitude_step(amplitude, heads):
    """One step of an amplitude near `amplitude`, units."""
    return max(np.int64(1), max(amplitude, heads[TOP] >> 4) * heads[A_STEP] >> 16)


@lean
def slope_of(surface, heads):
    """Growth of the share of the deep force, from sample to sample."""
    return max(np.int64(16), heads[RAMP] * surface[_U_OUT] >> 14)


@lean
def is_torn(surfaces, at, row):
    """Whether the columns to the west and north may belong to different surfaces."""
    west, north = surfaces[at - 2], surfaces[at - row]
    apart = west[A] > 0 and north[A] > 0 and abs(west[Z] - north[Z]) > _TORN
    return apart or surfaces[at - 1, A] > 0 or surfaces[at - row + 1, A] > 0


@lean
def _rise(surface, axis, heads):
    """How much farther inside a surface is one column on."""
    return _bounded(surface[U + axis] * heads[RATIO_A + axis] // surface[_U_OUT], np.int64(_STEEPEST))


@lean
def expect(columns, at, slot, mode):
    """``columns.expected`` of a surface of the column at `at`; False where there is nothing to go by.

    The first one continues those to the west and north (mode 0), west (1), north (2), or the second one of one of
    both (3); the second one second ones, or the deepest beside.
    """
    surfaces, row, heads, out = columns.surfaces, columns.row, columns.heads, columns.expected
    west, north = at - 2 + slot, at - row + slot
    if mode == 3:
        west += 1
        north = np.int64(0) if surfaces[west, A] else north + 1
    elif mode == 1:
        north = np.int64(0)
    elif mode == 2:
        west = np.int64(0)
    has_west, has_north = surfaces[west, A] > 0, surfaces[north, A] > 0
    if has_west and has_north:
        for c in range(3):
            out[c] = (surfaces[west, c] + surfaces[north, c]) >> 1
        out[Z] += (_rise(surfaces[west], 1, heads) + _rise(surfaces[north], 0, heads)) >> 1
        out[A] = (surfaces[west, A] + surfaces[north, A]) >> 1
    elif has_west or has_north:
        side = west if has_west else north
        for c in range(4):
            out[c] = surfaces[side, c]
        out[Z] += _rise(surfaces[side], np.int64(has_west), heads)
    elif mode:
        return False
    elif slot:
        deepest = at
        for side in (at - 2, at - row, at - row - 2, at - row + 2):
            if surfaces[side, A] and surfaces[side, Z] > surfaces[deepest, Z]:
                deepest = side
        for c in range(4):
            out[c] = surfaces[deepest, c]
        if out[Z] <= surfaces[at, Z] + _TORN:
            out[Z] = surfaces[at, Z] + 2 * _TORN
    else:
        side = at - row + 2 if surfaces[at - row + 2, A] else at - row - 2
        for c in range(4):
            out[c] = surfaces[side, c]
        if not out[A]:
            out[A] = heads[TOP]
    return True


@lean
def set_surface(columns, at, slot):
    """Keep a surface of the column at `at`: its residuals from ``columns.expected``."""
    heads, out, r, expected = columns.heads, columns.surfaces[at + slot], columns.residuals[slot], columns.expected
    out[X] = x = _bounded(expected[X] + r[0] * heads[XY_STEP], np.int64(_ONE))
    out[Y] = y = _bounded(expected[Y] + r[1] * heads[XY_STEP], np.int64(_ONE))
    out[Z] = _bounded(expected[Z] + r[2] * heads[Z_STEP], np.int64(_FAR))
    out[A] = max(np.int64(1), _bounded(expected[A] + r[3] * amplitude_step(expected[A], heads), np.int64(LIMIT)))
    double = (np.int64(1) << 43) // ((1 << 28) + x * x + y * y)
    out[U] = x * double >> 14
    out[_U_B] = y * double >> 14
    out[_U_OUT] = max(np.int64(_LEAST_OUT), double - _ONE)
    out[_TURN] = abs(r[0]) + abs(r[1])
    out[_SHIFT] = abs(r[2])
    out[_GAIN] = abs(r[3])


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
            negative = 1 + _bit(bits, at, kind, found, first, second, np.int64(r < 0))
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
def _near(r):
    return min(abs(r), np.int64(3))


@lean
def _sizes(surfaces, west, north, place, most):
    """How far residuals went to the west and north, `most` where unknown; below (most + 1)^2."""
    a = min(surfaces[west, place], np.int64(most)) if surfaces[west, A] else np.int64(most)
    b = min(surfaces[north, place], np.int64(most)) if surfaces[north, A] else np.int64(most)
    return a * (most + 1) + b


@lean
def code_column(bits, at, columns, place):
    """Code the column at a place: how many surfaces, and these; False if one has nothing to go by."""
    surfaces, row, r, told = columns.surfaces, columns.row, columns.residuals, columns.told
    here = twos = np.int64(0)
    for side in (place - 2, place - row, place - row - 2, place - row + 2):
        here = here * 2 + (surfaces[side, A] > 0)
        twos = twos * 2 + (surfaces[side + 1, A] > 0)
    torn = np.int64(is_torn(surfaces, place, row))
    count = _bit(bits, at, _COUNT, _ZERO, here, twos, np.int64(told[0] > 0))
    if count:
        count += _bit(bits, at, _COUNT, np.int64(1), 16 * torn + twos, here, np.int64(told[0] > 1))
    mode = np.int64(0)
    if count and torn:
        mode = _bit(bits, at, _MODE, _ZERO, twos >> 2, count, told[1] >> 1)
        mode = 2 * mode + _bit(bits, at, _MODE, 1 + mode, twos >> 2, count, told[1] & 1)
    few = np.int64(0)
    for side in range(4):
        few += here >> side & 1
    few = min(few, np.int64(3))
    told[0] = count
    for slot in range(count):
        if not expect(columns, place, np.int64(slot), mode if slot == 0 else np.int64(0)):
            return False
        if slot:
            columns.expected[A] = max(columns.heads[TOP] >> 4, columns.heads[TOP] - surfaces[place, A])
        elif count == 2:
            columns.expected[A] = columns.heads[TOP] >> 1
        kind = _NUMBERS + 3 * slot
        west, north = place - 2 + slot, place - row + slot
        sizes = _sizes(surfaces, west, north, _TURN, 4)
        r[slot, 0] = _number(bits, at, kind, sizes, few, r[slot, 0])
        r[slot, 1] = _number(bits, at, kind, 25 + sizes, 4 + _near(r[slot, 0]) * 4 + few, r[slot, 1])
        turned = max(_near(r[slot, 0]), _near(r[slot, 1]))
        sizes = _sizes(surfaces, west, north, _SHIFT, 6)
        r[slot, 2] = _number(bits, at, kind + 1, sizes, turned * 4 + few, r[slot, 2])
        sizes = _sizes(surfaces, west, north, _GAIN, 4) + 25 * (count == 2)
        r[slot, 3] = _number(bits, at, kind + 2, sizes, _near(r[slot, 2]) * 4 + turned, r[slot, 3])
        set_surface(columns, place, np.int64(slot))
    for slot in range(count, 2):
        surfaces[place + slot, A] = 0
    return True


@entry
def read_columns(bits, at, columns, rows, count):
    """Read all columns, row by row; False where one has nothing to go by.

    `at` tells where the chances and the weights of columns begin.
    """
    for i in range(1, rows + 1):
        for j in range(1, count + 1):
            if not code_column(bits, at, columns, i * columns.row + 2 * j):
                return False
    return True
