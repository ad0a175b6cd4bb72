"""Residual of a voxel: still, or steps along and across what the blend expects (docs/format/touch.md, "Residual").

A force that is followed stands for long, or is off altogether: what does not stand still is told about the blend.
Each bit is mixed from several contexts, made here of how the neighbours were corrected and of where other predictions
lie.
"""

from __future__ import annotations

import numpy as np

from touchfield.codec.kernels.bits import gamma, mix
from touchfield.codec.touch.kernels.lattice import amplitude_of, axes_along, level_of, rebuild, step_at
from touchfield.codec.touch.kernels.predict import FOLLOWED, NOTHING, REFERENCE, before, chain, held
from touchfield.codec.touch.kernels.workspace import (
    ALTERNATIVES,
    APART,
    AXES,
    BASE,
    BLEND,
    CENTRE,
    DEEP,
    EXPECTED,
    LEFT,
    OTHER,
    SIDES,
    SIZES,
    STEPS,
    UP,
    WIDTH,
    length_of,
)  # fmt: skip
from touchfield.lean import inlined, lean

# Contexts of a bit of each kind. Of zero, sign and size there are three, one for each component: two pairs of other
# predictions, 256 contexts each (of zero once more where residuals around are large), and what is nearest, 64; of a
# size, 16 steps times 8 classes of sizes, and times 64.
_STILL = np.array([0, 512, 1024], np.int64)
_ZERO = 1024 + 4096
_TABLE = 5 * 256
_SIGN = _ZERO + 3 * _TABLE
_SIZE = _SIGN + 3 * _TABLE
CONTEXTS = _SIZE + 3 * 1152

_SET_ZERO, _SET_SIGN, _SET_SIZE = 16, 40, 43
SETS = _SET_SIZE + 48  # sets of weights: of still from 0 on
_UNARY = 14  # steps told one by one; the rest in Elias' gamma code

_LOUD, _NEAR, _CLASS_0, _CLASS_1, _QUIET, _APART, _LENGTH, LEVEL, BASED = range(9)
"""Places in ``Work.of``: the length, in 1/16 of the top; neighbours across a face that hold a force; classes of the
sizes of their residuals along, across, and in all; how far the opinions lie apart; length and level of the centre;
whether anything was followed."""

_CLASS = np.array([0, 1, 2, 2] + 3 * [3] + 4 * [4] + 5 * [5] + 8 * [6] + 8 * [7], np.int64)
"""Class of a mean size of residuals, in quarters."""


@lean
def _digits(a):
    """Binary digits, 7 at most."""
    n = np.int64(0)
    while a > 0 and n < 7:
        a >>= 1
        n += 1
    return n


@lean
def _quiet(window, at):
    """State of a cell: without a force, or by how much it was corrected, 0 to 3."""
    if held(window, at) == 0:
        return np.int64(0)
    sizes = np.int64(window[at * WIDTH + SIZES])
    return min(1 + (sizes & 255) + (sizes >> 8 & 255), np.int64(3))


@lean
def _sizes(window, at):
    return np.int64(window[at * WIDTH + SIZES]) if held(window, at) else np.int64(0)


@lean
def _side(d):
    """Class of a distance along an axis, in quarters of a step: 0 to 14, 7 is none."""
    a = abs(d)
    size = a if a < 3 else (3 if a < 5 else (4 if a < 8 else (5 if a < 12 else (6 if a < 20 else np.int64(7)))))
    return 7 - size if d < 0 else 7 + size


@lean
def look(law, work, here, near):
    """Gather how the neighbours of a voxel were corrected, and how far the two opinions lie apart."""
    window, of = work.window, work.of
    d, u, left = _sizes(window, here - DEEP), _sizes(window, here - UP), _sizes(window, here - LEFT)
    count = (near & 1) + (near >> 1 & 1) + (near >> 2)
    length = length_of(work.rows[EXPECTED, 0], work.rows[EXPECTED, 1], work.rows[EXPECTED, 2])
    step = step_at(length, law.floor, law.rate)
    of[_NEAR], of[_LOUD] = count, min(length >> 12, 15)
    along = (d & 255) + (u & 255) + (left & 255)
    across = (d >> 8 & 255) + (u >> 8 & 255) + (left >> 8 & 255)
    of[_CLASS_0] = of[_CLASS_1] = of[_QUIET] = 7
    if count:
        of[_CLASS_0] = _CLASS[min(along * 4 // count, 31)]
        of[_CLASS_1] = _CLASS[min(across * 2 // count, 31)]
        of[_QUIET] = _CLASS[min((along + across) * 3 // count, 31)]
    of[BASED] = np.int64(of[FOLLOWED] != NOTHING)
    rows = work.rows
    for k in range(3):
        rows[APART, k] = (rows[BLEND, k] if of[BASED] else rows[BASE, k]) - rows[EXPECTED, k]
    of[_APART] = _digits((length_of(rows[APART, 0], rows[APART, 1], rows[APART, 2]) << 3) // step)


@lean
def code_still(bits, law, work, here, then, still):
    """Code that the expected force stands; `then` is what the reference says of the support here."""
    window, of, expected = work.window, work.of, work.rows[EXPECTED]
    deep, up, left = here - DEEP, here - UP, here - LEFT
    quiet = (_quiet(window, deep) << 2 | _quiet(window, up)) << 2 | _quiet(window, left)
    far = np.int64(7)  # how far the reference lies, where it is not followed
    if work.old[here * 4 + 3] > 0 and of[FOLLOWED] != REFERENCE:
        d = np.int64(work.old[here * 4]) - expected[0], np.int64(work.old[here * 4 + 1]) - expected[1]
        length = length_of(expected[0], expected[1], expected[2])
        step = step_at(length, law.floor, law.rate)
        far = _digits((length_of(d[0], d[1], np.int64(work.old[here * 4 + 2]) - expected[2]) << 3) // step)
    b, apart = bits.inputs, of[_APART]
    b[0] = _STILL[0] + (quiet << 3 | apart)
    b[1] = _STILL[1] + ((apart << 4 | of[_LOUD]) << 2 | of[_NEAR])
    b[2] = _STILL[2] + (((far << 3 | then) << 3 | apart) << 3 | of[_QUIET])
    return mix(bits, 3, of[_QUIET] << 1 | np.int64(far < 7), still)


@inlined
def _alternative(law, work, here, n):
    """Put prediction n into the row `OTHER`: a chain along axis n, or the reference; whether there is one."""
    if n < 3:
        if held(work.window, before(here, n)) == 0:
            return False
        chain(work, here, n, law.floor, OTHER)
        return True
    for k in range(3):
        work.rows[OTHER, k] = np.int64(work.old[here * 4 + k])
    return work.old[here * 4 + 3] > 0


@lean
def aim(law, work, here):
    """Set centre, axes and level of the residual, and on which side of it other predictions lie."""
    of, rows = work.of, work.rows
    for k in range(3):
        rows[CENTRE, k] = work.rows[BLEND, k]
        if of[BASED]:  # seen from the blend the other opinion lies the other way
            work.rows[APART, k] = -work.rows[APART, k]
    length = length_of(rows[CENTRE, 0], rows[CENTRE, 1], rows[CENTRE, 2])
    if rows[CENTRE, 0] == 0 and rows[CENTRE, 1] == 0 and rows[CENTRE, 2] == 0:
        rows[CENTRE, 2] = 1
    axes_along(rows[CENTRE, 0], rows[CENTRE, 1], rows[CENTRE, 2], length, rows)
    of[LEVEL] = level_of(min(length, (1 << 18) - 1), law.border, law.first)
    of[_LENGTH] = length
    step = step_at(length, law.floor, law.rate)
    for n in range(ALTERNATIVES):
        there = _alternative(law, work, here, n)
        for c in range(3):
            work.rows[SIDES + n, c] = 15
            if there:
                d = np.int64(0)
                for k in range(3):
                    d += (work.rows[OTHER, k] - rows[CENTRE, k]) * work.rows[AXES + c, k]
                work.rows[SIDES + n, c] = _side((d >> 12) // step)


@lean
def place(law, work, r0, r1, r2):
    """Put into the row `VECTOR` what the residual (r0, r1, r2) makes of the centre."""
    along = amplitude_of(work.of[LEVEL] + 256 * r0, law.border)
    step = step_at(abs(along), law.cross_floor, law.cross_rate)
    rebuild(along, r1 * step, r2 * step, work.rows)


@lean
def _pairs(bits, work, c, table):
    """Contexts of where the other predictions lie along axis c, two by two."""
    for n in range(2):
        bits.inputs[n] = table + (n << 8 | work.rows[SIDES + 2 * n, c] << 4 | work.rows[SIDES + 2 * n + 1, c])


@inlined
def _code_size(bits, work, c, toward, size):
    """The size of a component that is not zero."""
    of = work.of
    group = of[_CLASS_0] if c == 0 else of[_CLASS_1]
    for n in range(_UNARY):
        bits.inputs[0] = _SIZE + c * 1152 + (group << 4 | n)
        bits.inputs[1] = _SIZE + c * 1152 + 128 + ((toward << 3 | of[_APART]) << 4 | n)
        if mix(bits, 2, _SET_SIZE + c * 16 + n, np.int64(size > n + 1)) == 0:
            return np.int64(n + 1)
    return _UNARY + gamma(bits, size - _UNARY, np.int64(17))


@lean
def code_step(bits, law, work, c):
    """Code component c of the residual, in the row `STEPS`; those before it are known."""
    of, rows = work.of, work.rows
    step = step_at(of[_LENGTH], law.floor, law.rate)
    d = np.int64(0)
    for k in range(3):
        d += work.rows[APART, k] * work.rows[AXES + c, k]
    d >>= 14
    toward, side = _digits((abs(d) << 3) // step), np.int64(d < 0)  # how far off the other opinion is, and where
    if of[BASED] or c < 2 or rows[STEPS, 0] != 0 or rows[STEPS, 1] != 0:  # else it did not stand for this one
        group, table = of[_CLASS_0] if c == 0 else of[_CLASS_1], _ZERO + c * _TABLE
        _pairs(bits, work, c, table + (group >> 2 << 9))
        bits.inputs[2] = table + 1024 + (toward << 3 | of[_APART])
        if not mix(bits, 3, _SET_ZERO + c * 8 + group, np.int64(rows[STEPS, c] != 0)):
            rows[STEPS, c] = 0
            return
    table = _SIGN + c * _TABLE
    _pairs(bits, work, c, table)
    bits.inputs[2] = table + 1024 + ((toward << 1 | side) << 2 | of[_NEAR])
    negative = mix(bits, 3, _SET_SIGN + c, np.int64(rows[STEPS, c] < 0))
    size = _code_size(bits, work, c, toward, abs(rows[STEPS, c]))
    rows[STEPS, c] = -size if negative else size


@lean
def sizes_of(work, still):
    """The sizes that a cell keeps of its residual."""
    if still:
        return np.int64(0)
    along, across = abs(work.rows[STEPS, 0]), abs(work.rows[STEPS, 1]) + abs(work.rows[STEPS, 2])
    return min(along, 15) | min(across, 31) << 8
