"""Prediction of a voxel from the neighbours decoded before it and from the reference, and the code of its
residual.

Two opinions: the *chain* follows the force law from one neighbour, or takes the reference as it is, so that
it inherits an error and stays within a relative mask for long; the *blend* is the mean of the neighbours,
corrected by weights that learn from each voxel. Where nothing is to be followed, the blend is what is
expected. What does not stand still is told about the blend, in steps along and across it
(docs/format/touch.md, "Residual"). Each bit is mixed from several contexts, made of how the neighbours were
corrected and of where other predictions lie.
"""

from __future__ import annotations

import numpy as np

from touchfield.codec.kernels import gamma, mix
from touchfield.codec.touch.kernels import workspace as ws
from touchfield.compute.coder_jit import inlined, lean

# Places in ``Work.of``: 2^32 over the step; the cell that is followed; the class of weights (-1: none)
INVERSE, FOLLOWED, _CORRECTED = 13, 14, 15
NOTHING, REFERENCE = -1, -2  # in place of a cell that is followed
_D, _U, _L = ws.DEEP, ws.UP, ws.LEFT
_FROM = np.array([_D, _U, _L, _D - _U, _D - _L, _U - _L, _D, _U, _L, _L, _U], np.int64)
# distances of the cells whose difference is a feature; 0: the base
_TO = np.array(6 * [0] + [2 * _D, _D + _U, _D + _L, _U + _L, _U + _L], np.int64)
_PACE = 8  # how fast the weights learn, 1/64; measured: 4 to 12 are within 1 %
# of a NumPy type: numba compiles a function anew for each int that is written out
_FEATURE_LIMIT, _ERROR_LIMIT, _WEIGHT_LIMIT, _LIMIT = np.array([4095, 1023, 1 << 20, ws.LIMIT], np.int64)
_STILLNESS = 1 << 15  # what the energy of the features is at least: half a squared step


@lean
def held(window, at):
    """1 where a cell holds a force, else 0."""
    return np.int64(window[at * ws.WIDTH + ws.LENGTH] > 0)


@lean
def before(here, axis):
    """The neighbour before a cell along an axis."""
    return here - (ws.DEEP if axis == 0 else (ws.UP if axis == 1 else ws.LEFT))


@lean
def ahead(window, at, axis):
    """The length that the law makes likely one step on along an axis."""
    return np.int64(window[at * ws.WIDTH + ws.AHEAD + axis])


@lean
def chain(work, here, axis, floor, row):
    """Follow the law from the neighbour before `here` along an axis, which must hold a force; into a row."""
    window = work.window
    at = before(here, axis)
    c = at * ws.WIDTH
    a = np.int64(window[c + ws.LENGTH])
    length = max(ahead(window, at, axis), a >> 3, max(np.int64(1), np.int64(floor) >> 1))
    ratio = np.int64(16384)
    if length != a:
        ratio = min((length << 14) // a, np.int64(1) << 17)
    for k in range(3):
        work.rows[row, k] = ws.bounded((np.int64(window[c + k]) * ratio + 8192) >> 14, _LIMIT)


@inlined
def _off(window, old, at, law):
    """True where the reference is more than a step off at a cell."""
    a = np.int64(window[at * ws.WIDTH + ws.LENGTH])
    if a == 0 or old[at * 4 + 3] == 0:
        return False
    square = np.int64(0)
    for k in range(3):
        square += (np.int64(window[at * ws.WIDTH + k]) - np.int64(old[at * 4 + k])) ** 2
    step = ws.step_at(a, law.floor, law.rate)
    return square > step * step


@inlined
def _gather(work, here):
    """Fill in the features; whether the reference holds a force.

    0 to 10: how cells before differ from the base, and from those before them, none where one is none; 11 and
    12: the reference less the base, and how much the neighbours differ from theirs on the mean.
    """
    window, old, rows = work.window, work.old, work.rows
    for n in range(11):
        c = (here - _FROM[n]) * ws.WIDTH
        d = (here - _TO[n]) * ws.WIDTH
        there = np.int64(window[c + ws.LENGTH] > 0) & np.int64(_TO[n] == 0 or window[d + ws.LENGTH] > 0)
        for k in range(3):
            other = rows[ws.BASE, k] if _TO[n] == 0 else np.int64(window[d + k])
            rows[ws.FEATURE + n, k] = (np.int64(window[c + k]) - other) * there
    for k in range(3):
        rows[ws.FEATURE + 11, k] = rows[ws.FEATURE + 12, k] = 0
    if old[here * 4 + 3] == 0:
        return np.int64(0)
    count = np.int64(0)
    for axis in range(3):
        at = before(here, axis)
        if held(window, at) and old[at * 4 + 3] > 0:
            count += 1
            for k in range(3):
                rows[ws.FEATURE + 12, k] += np.int64(window[at * ws.WIDTH + k]) - np.int64(old[at * 4 + k])
    for k in range(3):
        rows[ws.FEATURE + 11, k] = np.int64(old[here * 4 + k]) - rows[ws.BASE, k]
        rows[ws.FEATURE + 12, k] //= max(count, np.int64(1))
    return np.int64(1)


@inlined
def _mean(law, work, here, near):
    """The base: the mean direction of the neighbours, as long as the law makes likely; returns the step
    there.
    """
    window, rows = work.window, work.rows
    total = likely = count = np.int64(0)
    rows[ws.BASE] = 0
    for axis in range(3):
        if near >> axis & 1:
            at = before(here, axis)
            a = np.int64(window[at * ws.WIDTH + ws.LENGTH])
            for k in range(3):
                rows[ws.BASE, k] += window[at * ws.WIDTH + k]
            total += a
            likely += max(ahead(window, at, axis), a >> 3)
            count += 1
    scale = min((likely << 16) // (total * count), np.int64(1 << 17))
    for k in range(3):
        rows[ws.BASE, k] = (rows[ws.BASE, k] * scale + 32768) >> 16
    step = ws.step_at(likely // count, law.floor, law.rate)
    work.of[INVERSE] = (np.int64(1) << 32) // step
    return step


@inlined
def _corrected(work, kind, step):
    """The blend: the base, and what the weights of a kind make of the features."""
    rows, inverse = work.rows, work.of[INVERSE]
    work.of[_CORRECTED] = kind
    for k in range(3):
        total = np.int64(0)
        for n in range(ws.FEATURES):
            f = ws.bounded((rows[ws.FEATURE + n, k] * inverse) >> 24, _FEATURE_LIMIT)
            rows[ws.FEATURE + n, k] = f
            total += work.weights[kind, n] * f
        rows[ws.BLEND, k] = ws.bounded(rows[ws.BASE, k] + ((total >> 16) * step >> 8), _LIMIT)


@lean
def expect(law, work, here, near, trusted):
    """Put the two opinions of a voxel into the rows `EXPECTED` and `BLEND`.

    `near` tells which neighbours across a face hold a force, bits 0 to 2; `trusted`: the reference is
    followed.
    """
    window, old, rows, of = work.window, work.old, work.rows, work.of
    known = old[here * 4 + 3] > 0
    if near:
        step = _mean(law, work, here, near)
        _corrected(work, near | _gather(work, here) << 3, step)
    else:  # the reference, or the last vector
        for k in range(3):
            rows[ws.BASE, k] = np.int64(old[here * 4 + k]) if known else rows[ws.LAST, k]
            rows[ws.BLEND, k] = rows[ws.BASE, k]
        of[_CORRECTED] = -1
    if trusted and known and not _off(window, old, here - ws.DEEP, law):
        of[FOLLOWED] = REFERENCE
        for k in range(3):
            rows[ws.EXPECTED, k] = np.int64(old[here * 4 + k])
        return
    for axis in range(3):
        at = before(here, axis)
        if held(window, at):
            of[FOLLOWED] = at
            chain(work, here, axis, law.floor, ws.EXPECTED)
            return
    of[FOLLOWED] = NOTHING
    for k in range(3):
        rows[ws.EXPECTED, k] = rows[ws.BLEND, k]


@lean
def learn(work):
    """Move the weights of the blend towards the row `VECTOR`, which was decoded (normalised least mean
    squares).
    """
    kind = work.of[_CORRECTED]
    for k in range(3):
        work.rows[ws.LAST, k] = work.rows[ws.VECTOR, k]
    if kind < 0:
        return
    energy = np.int64(_STILLNESS)
    for n in range(ws.FEATURES):
        for k in range(3):
            energy += work.rows[ws.FEATURE + n, k] * work.rows[ws.FEATURE + n, k]
    for k in range(3):
        error = ((work.rows[ws.VECTOR, k] - work.rows[ws.BLEND, k]) * work.of[INVERSE]) >> 24
        gain = (ws.bounded(error, _ERROR_LIMIT) * (np.int64(_PACE) << 24)) // energy
        for n in range(ws.FEATURES):
            weight = work.weights[kind, n] + ((work.rows[ws.FEATURE + n, k] * gain) >> 14)
            work.weights[kind, n] = ws.bounded(weight, _WEIGHT_LIMIT)


# Contexts of a bit of each kind. Of zero, sign and size there are three, one for each component: two pairs of
# other predictions, 256 contexts each (of zero once more where residuals around are large), and what is
# nearest, 64; of a size, 16 steps times 8 classes of sizes, and times 64.
_STILL = np.array([0, 512, 1024], np.int64)
_ZERO = 1024 + 4096
_TABLE = 5 * 256
_SIGN = _ZERO + 3 * _TABLE
_SIZE = _SIGN + 3 * _TABLE
CONTEXTS = _SIZE + 3 * 1152

_SET_ZERO, _SET_SIGN, _SET_SIZE = 16, 40, 43
SETS = _SET_SIZE + 48  # sets of weights: of still from 0 on
_UNARY = 14  # steps told one by one; the rest in Elias' gamma code

_LOUD, _NEAR, _CLASS_0, _CLASS_1, _QUIET, _APART, _STEP, LEVEL, BASED = range(9)
"""Places in ``Work.of``: the length, in 1/16 of the top; neighbours across a face that hold a force; classes
of the sizes of their residuals along, across, and in all; how far the opinions lie apart; the step at what is
expected, and then at the centre; the centre's level; whether anything was followed."""

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
def _sizes(window, at):
    return np.int64(window[at * ws.WIDTH + ws.SIZES]) if held(window, at) else np.int64(0)


@lean
def _quiet(window, at):
    """State of a cell: without a force, or by how much it was corrected, 0 to 3."""
    sizes = _sizes(window, at)
    return held(window, at) * min(1 + (sizes & 255) + (sizes >> 8 & 255), np.int64(3))


@lean
def _length(rows, row):
    return ws.length_of(rows[row, 0], rows[row, 1], rows[row, 2])


@lean
def _side(d):
    """Class of a distance along an axis, in quarters of a step: 0 to 14, 7 is none."""
    a = abs(d)
    size = (
        a if a < 3 else (3 if a < 5 else (4 if a < 8 else (5 if a < 12 else (6 if a < 20 else np.int64(7)))))
    )
    return 7 - size if d < 0 else 7 + size


@lean
def look(law, work, here, near):
    """Gather how the neighbours of a voxel were corrected, and how far the two opinions lie apart."""
    window, of = work.window, work.of
    d, u, left = _sizes(window, here - ws.DEEP), _sizes(window, here - ws.UP), _sizes(window, here - ws.LEFT)
    count = (near & 1) + (near >> 1 & 1) + (near >> 2)
    length = _length(work.rows, ws.EXPECTED)
    of[_STEP] = ws.step_at(length, law.floor, law.rate)
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
        rows[ws.APART, k] = (rows[ws.BLEND, k] if of[BASED] else rows[ws.BASE, k]) - rows[ws.EXPECTED, k]
    of[_APART] = _digits((_length(rows, ws.APART) << 3) // of[_STEP])


@lean
def code_still(bits, work, here, then, still):
    """Code that the expected force stands; `then` is what the reference says of the support here."""
    window, of, rows = work.window, work.of, work.rows
    deep, up, left = here - ws.DEEP, here - ws.UP, here - ws.LEFT
    quiet = (_quiet(window, deep) << 2 | _quiet(window, up)) << 2 | _quiet(window, left)
    far = np.int64(7)  # how far the reference lies, where it is not followed
    if work.old[here * 4 + 3] > 0 and of[FOLLOWED] != REFERENCE:
        for k in range(3):
            rows[ws.OTHER, k] = np.int64(work.old[here * 4 + k]) - rows[ws.EXPECTED, k]
        far = _digits((_length(rows, ws.OTHER) << 3) // of[_STEP])
    b, apart = bits.inputs, of[_APART]
    b[0] = _STILL[0] + (quiet << 3 | apart)
    b[1] = _STILL[1] + ((apart << 4 | of[_LOUD]) << 2 | of[_NEAR])
    b[2] = _STILL[2] + (((far << 3 | then) << 3 | apart) << 3 | of[_QUIET])
    return mix(bits, np.int64(3), of[_QUIET] << 1 | np.int64(far < 7), still)


@lean
def aim(law, work, here):
    """Set centre, axes and level of the residual, and on which side of it other predictions lie."""
    of, rows = work.of, work.rows
    for k in range(3):
        rows[ws.CENTRE, k] = rows[ws.BLEND, k]
        if of[BASED]:  # seen from the blend the other opinion lies the other way
            rows[ws.APART, k] = -rows[ws.APART, k]
    length = _length(rows, ws.CENTRE)
    if rows[ws.CENTRE, 0] == 0 and rows[ws.CENTRE, 1] == 0 and rows[ws.CENTRE, 2] == 0:
        rows[ws.CENTRE, 2] = 1
    ws.axes_along(rows, length)
    of[LEVEL] = ws.level_of(min(length, (1 << 18) - 1), law.border)
    of[_STEP] = ws.step_at(length, law.floor, law.rate)
    for n in range(ws.ALTERNATIVES):
        if n < 3:
            there = held(work.window, before(here, n)) > 0
            if there:
                chain(work, here, n, law.floor, ws.OTHER)
        else:
            there = work.old[here * 4 + 3] > 0
            for k in range(3):
                rows[ws.OTHER, k] = np.int64(work.old[here * 4 + k])
        for c in range(3):
            work.rows[ws.SIDES + n, c] = 15
            if there:
                d = np.int64(0)
                for k in range(3):
                    d += (work.rows[ws.OTHER, k] - rows[ws.CENTRE, k]) * work.rows[ws.AXES + c, k]
                work.rows[ws.SIDES + n, c] = _side((d >> 12) // of[_STEP])


@lean
def place(law, work, r0, r1, r2):
    """Put into the row `VECTOR` what the residual (r0, r1, r2) makes of the centre."""
    along = ws.amplitude_of(work.of[LEVEL] + 256 * r0, law.border)
    step = ws.step_at(abs(along), law.cross_floor, law.cross_rate)
    ws.rebuild(along, r1 * step, r2 * step, work.rows)


@lean
def _pairs(bits, work, c, table):
    """Contexts of where the other predictions lie along axis c, two by two."""
    for n in range(2):
        bits.inputs[n] = table + (
            n << 8 | work.rows[ws.SIDES + 2 * n, c] << 4 | work.rows[ws.SIDES + 2 * n + 1, c]
        )


@inlined
def _code_size(bits, work, c, toward, size):
    """The size of a component that is not zero."""
    of = work.of
    group = of[_CLASS_0] if c == 0 else of[_CLASS_1]
    for n in range(_UNARY):
        bits.inputs[0] = _SIZE + c * 1152 + (group << 4 | n)
        bits.inputs[1] = _SIZE + c * 1152 + 128 + ((toward << 3 | of[_APART]) << 4 | n)
        if mix(bits, np.int64(2), _SET_SIZE + c * 16 + n, np.int64(size > n + 1)) == 0:
            return np.int64(n + 1)
    return _UNARY + gamma(bits, size - _UNARY, np.int64(17))


@lean
def code_step(bits, work, c):
    """Code component c of the residual, in the row `STEPS`; those before it are known."""
    of, rows = work.of, work.rows
    d = np.int64(0)
    for k in range(3):
        d += work.rows[ws.APART, k] * work.rows[ws.AXES + c, k]
    d >>= 14
    toward, side = (
        _digits((abs(d) << 3) // of[_STEP]),
        np.int64(d < 0),
    )  # how far off the other opinion is, and where
    if (
        of[BASED] or c < 2 or rows[ws.STEPS, 0] != 0 or rows[ws.STEPS, 1] != 0
    ):  # else it did not stand for this one
        group, table = of[_CLASS_0] if c == 0 else of[_CLASS_1], _ZERO + c * _TABLE
        _pairs(bits, work, c, table + (group >> 2 << 9))
        bits.inputs[2] = table + 1024 + (toward << 3 | of[_APART])
        if not mix(bits, np.int64(3), _SET_ZERO + c * 8 + group, np.int64(rows[ws.STEPS, c] != 0)):
            rows[ws.STEPS, c] = 0
            return
    table = _SIGN + c * _TABLE
    _pairs(bits, work, c, table)
    bits.inputs[2] = table + 1024 + ((toward << 1 | side) << 2 | of[_NEAR])
    negative = mix(bits, np.int64(3), _SET_SIGN + c, np.int64(rows[ws.STEPS, c] < 0))
    size = _code_size(bits, work, c, toward, abs(rows[ws.STEPS, c]))
    rows[ws.STEPS, c] = -size if negative else size


@lean
def sizes_of(work, still):
    """The sizes that a cell keeps of its residual."""
    if still:
        return np.int64(0)
    along, across = abs(work.rows[ws.STEPS, 0]), abs(work.rows[ws.STEPS, 1]) + abs(work.rows[ws.STEPS, 2])
    return min(along, 15) | min(across, 31) << 8
