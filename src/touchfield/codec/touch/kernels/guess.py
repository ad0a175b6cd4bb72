"""Compiled code of the guesses, the same in both directions: nodes of a spline; columns and their forces.

Of columns positions are in 1/256 samples from outside to inside, directions in 1/16384, shares in 1/65536. No
product reaches 2^62.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Int64s
from touchfield.codec.kernels import READING, TASK, code, even, gamma, mix
from touchfield.codec.touch.kernels.workspace import LIMIT, bounded
from touchfield.compute.coder_jit import entry, inlined, lean

REACH: Final = 1 << 23  # no coefficient is beyond it, units
_CLASSES: Final = 10
_LENGTHS: Final = 24
NODE_CONTEXTS: Final = _CLASSES * _LENGTHS


@inlined
def _expected_node(before, values, n):
    """The mean of the flat faces through the nodes told before, or else of those beside it."""
    total, count, beside, known = np.int64(0), np.int64(0), np.int64(0), np.int64(0)
    for axis in range(3):
        one, other, both = before[n, axis], before[n, (axis + 1) % 3], before[n, 3 + axis]
        if one >= 0:
            beside += values[one]
            known += 1
            if other >= 0 and both >= 0:
                total += values[one] + values[other] - values[both]
                count += 1
    if count == 0:
        total, count = beside, max(np.int64(1), known)
    return (2 * total + count) // (2 * count)


@inlined
def _node_residual(bits, at, r):
    """A residual: the length of its size, and its sign and the digits behind the first one as they are."""
    size, length = abs(r), np.int64(0)
    while length < _LENGTHS and code(bits, at + length, np.int64(size >> length > 0)):
        length += 1
    if length == 0:
        return np.int64(0)
    first = np.int64(1) << (length - 1)
    told = even(bits, (size & (first - 1)) | (first * np.int64(r < 0)), length)
    size = first | (told & (first - 1))
    return -size if told & first else size


@entry
def code_nodes(bits, at, before, step, values, sizes):
    """Tell nodes one after the other, each in multiples of `step` from what is expected; contexts begin `at`.

    `before`, int64 [n, 6], are the nodes before each one along x, y, z, xy, yz, zx, -1 where none is told;
    `values`, int64 [n], coefficients: a writer's are replaced by what a reader will have; `sizes`, int64 [n],
    room.
    """
    for n in range(values.shape[0]):
        near, near_class = np.int64(0), np.int64(0)
        for axis in range(3):
            if before[n, axis] >= 0:
                near += sizes[before[n, axis]]
        while near >> near_class and near_class < _CLASSES - 1:
            near_class += 1
        expected = _expected_node(before, values, n)
        r = np.int64(0)
        if bits.state[TASK] != READING:
            r = (2 * (values[n] - expected) + step) // (2 * step)
        r = _node_residual(bits, at + _LENGTHS * near_class, r)
        sizes[n] = abs(r)
        values[n] = min(max(expected + r * step, np.int64(-REACH)), np.int64(REACH))


TOP, RAMP, RATIO_A, RATIO_B, XY_STEP, Z_STEP, A_STEP = range(7)  # whole numbers that all columns share
HEADS: Final = (1 << 17, 1 << 20, 1 << 20, 1 << 20, 1 << 14, 1 << 12, 1 << 16)  # what they are below
X, Y, Z, A, U, NUMBERS = 0, 1, 2, 3, 4, 11
"""Of a surface: four numbers that are told, the direction (along a, b and outward), and the four residuals'
sizes.
"""
_SIZES = 7

MODES: Final = 4
_TORN = 768  # neighbours whose starts differ by three samples may not speak for one surface
_FAR = 1 << 24
_STEEPEST = 4096  # a surface rises by 16 samples from column to column at most
_LEAST_OUT = 820  # 87 degrees to the axis

_NODES, _LONGEST = 22, 20  # of a number: 0 is "not zero", 1 the sign, 2 to 21 "larger than 1 to 20"
_FIRST, _SECOND = 36, 16
# of a NumPy type: numba compiles a function anew for each int that is written out
_COUNT, _MODE, _NUMBER = np.arange(3)
_ZERO, _ONE = np.arange(2)
COLUMN_SETS: Final = 14 * _NODES
COLUMN_CONTEXTS: Final = COLUMN_SETS * (_FIRST + _SECOND)


class Columns(NamedTuple):
    """Columns of a box, row by row, a blank one before and behind each row, and a blank row before all."""

    surfaces: Int64s  # [2 columns, NUMBERS]; two of each column; A is 0 where there is none
    row: int  # surfaces from a row to the next
    heads: Int64s  # [7]
    # [4]; of the column at hand: how many surfaces, the mode of prediction, and the surfaces to the west and
    # north
    told: Int64s
    residuals: Int64s  # [2, 4]; of X, Y, Z, A of these, in steps
    expected: Int64s  # [4]


@lean
def is_torn(surfaces, at, row):
    """True where the columns to the west and north may belong to different surfaces."""
    west, north = surfaces[at - 2], surfaces[at - row]
    apart = west[A] > 0 and north[A] > 0 and abs(west[Z] - north[Z]) > _TORN
    return apart or surfaces[at - 1, A] > 0 or surfaces[at - row + 1, A] > 0


@lean
def _rise(surface, axis, heads):
    """How much farther inside a surface is one column on."""
    return bounded(surface[U + axis] * heads[RATIO_A + axis] // surface[U + 2], np.int64(_STEEPEST))


@lean
def expect(columns, at, slot):
    """Set ``columns.expected`` of a surface of the column at `at`.

    The first one continues those to the west and north (mode 0), west (1), north (2), or a second one (3);
    the second one continues second ones, or lies behind the first. Of two beside X and Y lie between their
    mean and their plane.
    """
    surfaces, row, heads, told, out = (
        columns.surfaces,
        columns.row,
        columns.heads,
        columns.told,
        columns.expected,
    )
    west, north = at - 2 + slot, at - row + slot
    mode = told[1] if slot == 0 else np.int64(0)
    if mode == 3:
        west += 1
        north += 1
    if mode == 2:
        west = np.int64(0)
    elif mode == 1 or (mode == 3 and surfaces[west, A] > 0):
        north = np.int64(0)
    sides = np.int64(0)
    for c in range(4):
        out[c] = 0
    for side in (west, north):
        if surfaces[side, A]:
            for c in range(4):
                out[c] += surfaces[side, c]
            sides += 1
    if sides == 2:
        for c in range(4):
            out[c] >>= 1
        corner = at - row - 2 + slot
        if surfaces[corner, A]:
            for c in range(2):
                w, n = surfaces[west, c], surfaces[north, c]
                plane = min(max(w + n - surfaces[corner, c], min(w, n)), max(w, n))
                out[c] = (out[c] + plane) >> 1
    elif sides == 0:
        side = at if slot else at - row + 2
        for c in range(4):
            out[c] = surfaces[side, c]
        if side == at:
            out[Z] += 2 * _TORN
        elif not out[A]:
            out[A] = heads[TOP]
    told[2], told[3] = west, north
    if slot:
        out[A] = max(heads[TOP] >> 4, heads[TOP] - surfaces[at, A])
    elif told[0] == 2:
        out[A] = heads[TOP] >> 1


@lean
def turn(columns, at, slot):
    """Keep the direction of a surface, and set what is expected of its start: those beside rise up to it."""
    surfaces, heads, told, out = columns.surfaces, columns.heads, columns.told, columns.surfaces[at + slot]
    for c in range(2):
        value = columns.expected[c] + columns.residuals[slot, c] * heads[XY_STEP]
        out[c] = bounded(value, np.int64(16384))
    double = (np.int64(1) << 43) // ((1 << 28) + out[X] * out[X] + out[Y] * out[Y])
    out[U] = out[X] * double >> 14
    out[U + 1] = out[Y] * double >> 14
    out[U + 2] = max(np.int64(_LEAST_OUT), double - 16384)
    total = sides = np.int64(0)
    for n in range(2):
        side = surfaces[told[2 + n]]
        if side[A]:
            total += side[Z] + ((_rise(side, 1 - n, heads) + _rise(out, 1 - n, heads)) >> 1)
            sides += 1
    if sides:
        columns.expected[Z] = total >> (sides - 1)


@lean
def step_of(columns, c):
    """The step of X, Y, Z or A, the last one relative to what is expected."""
    heads = columns.heads
    if c == A:
        return max(np.int64(1), max(columns.expected[A], heads[TOP] >> 4) * heads[A_STEP] >> 16)
    return heads[Z_STEP] if c == Z else heads[XY_STEP]


@lean
def set_surface(columns, at, slot):
    """Keep start and amplitude of a surface, and the sizes of its residuals."""
    out, r, expected = columns.surfaces[at + slot], columns.residuals[slot], columns.expected
    out[Z] = bounded(expected[Z] + r[Z] * columns.heads[Z_STEP], np.int64(_FAR))
    out[A] = max(bounded(expected[A] + r[A] * step_of(columns, np.int64(A)), np.int64(LIMIT)), np.int64(1))
    for c in range(4):
        out[_SIZES + c] = min(abs(r[c]), np.int64(4))


@lean
def _bit(bits, node, first, second, bit):
    bits.inputs[0] = node * (_FIRST + _SECOND) + first
    bits.inputs[1] = node * (_FIRST + _SECOND) + _FIRST + second
    return mix(bits, np.int64(2), node, bit)


@lean
def _number(bits, kind, first, second, r):
    """A residual: is it zero, its sign, its size one by one to 20, the rest in Elias gamma code."""
    size, node = abs(r), kind * _NODES
    if not _bit(bits, node, first, second, np.int64(size > 0)):
        return _ZERO
    sign = 1 - 2 * _bit(bits, node + 1, first, second, np.int64(r < 0))
    found = np.int64(1)
    while found <= _LONGEST and _bit(bits, node + 1 + found, first, second, np.int64(size > found)):
        found += 1
    if found <= _LONGEST:
        return sign * found
    return sign * (_LONGEST + gamma(bits, size - _LONGEST, np.int64(24)))


@lean
def code_column(bits, columns, place):
    """Code the column at a place: how many surfaces, and these; a writer's are in `told` and `residuals`."""
    surfaces, row, r, told = columns.surfaces, columns.row, columns.residuals, columns.told
    here = twos = few = np.int64(0)
    for side in (place - 2, place - row, place - row - 2, place - row + 2):
        here = here * 2 + (surfaces[side, A] > 0)
        twos = twos * 2 + (surfaces[side + 1, A] > 0)
        few = min(few + (surfaces[side, A] > 0), np.int64(3))
    torn = np.int64(is_torn(surfaces, place, row))
    count = _bit(bits, _COUNT, here, twos, np.int64(told[0] > 0))
    if count:
        count += _bit(bits, _ONE, 2 * twos + torn, here, np.int64(told[0] > 1))
    mode = np.int64(0)
    if count and torn:
        mode = _bit(bits, _NODES * _MODE, twos >> 2, count, told[1] >> 1)
        mode = 2 * mode + _bit(bits, _NODES * _MODE + 1 + mode, twos >> 2, count, told[1] & 1)
    told[0], told[1] = count, mode
    for slot in range(count):
        expect(columns, place, np.int64(slot))
        west, north = surfaces[place - 2 + slot], surfaces[place - row + slot]
        near = np.int64(0)
        for c in range(4):
            sizes = 6 * (west[_SIZES + c] if west[A] else 5) + (north[_SIZES + c] if north[A] else 5)
            kind = _NUMBER + 4 * (count - 1 + slot) + c
            r[slot, c] = _number(bits, kind, sizes, 4 * near + few, r[slot, c])
            near = (
                min(abs(r[slot, c]), np.int64(3)) if c != Y else max(near, min(abs(r[slot, c]), np.int64(3)))
            )
            if c == Y:
                turn(columns, place, np.int64(slot))
        set_surface(columns, place, np.int64(slot))


@entry
def read_row(bits, columns, row, count):
    """Read a row of columns."""
    for j in range(count):
        code_column(bits, columns, (row + 1) * columns.row + 2 * j + 2)


@lean
def share_at(surface, t, heads):
    """The share of the deep force of a surface at sample t, 0 to 65536."""
    slope = max(np.int64(16), heads[RAMP] * surface[U + 2] >> 14)
    return min(max(((t << 8) - surface[Z]) * slope >> 8, np.int64(0)), np.int64(65536))


@entry
def fill_bricks(begin, end, places, view, columns, out):
    """Forces of bricks begin to end - 1: ``out[n, i, j, k, component]``, int32, zero before.

    `places`, int64 [bricks, 2], tells the first of a brick's columns, and its first sample in the grid's
    sense; `view` the samples of a column, whether these are against the grid's sense, and the axes, int64
    [3].
    """
    depth, inverted, order = view
    heads = columns.heads
    for n in range(begin, end):
        for c in range(64):
            at = places[n, 0] + (c >> 3) * columns.row + 2 * (c & 7)
            one, two = columns.surfaces[at], columns.surfaces[at + 1]
            for k in range(min(8, depth - places[n, 1]) if one[A] else 0):
                t = depth - 1 - places[n, 1] - k if inverted else places[n, 1] + k
                share, more = share_at(one, t, heads), share_at(two, t, heads)
                for q in range(3):
                    force = share * ((one[A] * one[U + q] + 8192) >> 14)
                    force += more * ((two[A] * two[U + q] + 8192) >> 14)
                    force = bounded((force + 32768) >> 16, np.int64(LIMIT))
                    out[n, c >> 3, c & 7, k, order[q]] = -force if q == 2 and not inverted else force
