"""Prediction of a voxel from the neighbours decoded before it and from the reference.

Two opinions: the *chain* follows the force law from one neighbour, or takes the reference as it is, so that it
inherits an error and stays within a relative mask for long; the *blend* is the mean of the neighbours, corrected by
weights that learn from each voxel. Where nothing is to be followed, the blend is what is expected.
"""

from __future__ import annotations

import numpy as np

from touchfield.codec.touch.kernels.lattice import LIMIT, step_at
from touchfield.codec.touch.kernels.workspace import (
    AHEAD,
    BASE,
    BLEND,
    DEEP,
    EXPECTED,
    FEATURE,
    FEATURES,
    LAST,
    LEFT,
    LENGTH,
    UP,
    VECTOR,
    WIDTH,
)
from touchfield.lean import inlined, lean

# Places in ``Work.of``: 2^32 over the step; the cell that is followed; the class of weights (-1: none)
INVERSE, FOLLOWED, _CORRECTED = 13, 14, 15
NOTHING, REFERENCE = -1, -2  # in place of a cell that is followed
_FROM = np.array(
    [DEEP, UP, LEFT, DEEP - UP, DEEP - LEFT, UP - LEFT, DEEP, UP, LEFT, LEFT, UP], np.int64
)  # fmt: skip
# distances of the cells whose difference is a feature; 0: the base
_TO = np.array(6 * [0] + [2 * DEEP, DEEP + UP, DEEP + LEFT, UP + LEFT, UP + LEFT], np.int64)
_PACE = 8  # how fast the weights learn, 1/64; measured: 4 to 12 are within 1 %
_FEATURE_LIMIT = 4095
_ERROR_LIMIT = 1023
_WEIGHT_LIMIT = 1 << 20
_STILLNESS = 1 << 15  # what the energy of the features is at least: half a squared step


@lean
def held(window, at):
    """1 where a cell holds a force, else 0."""
    return np.int64(window[at * WIDTH + LENGTH] > 0)


@lean
def before(here, axis):
    """The neighbour before a cell along an axis."""
    return here - (DEEP if axis == 0 else (UP if axis == 1 else LEFT))


@lean
def ahead(window, at, axis):
    """The length that the law makes likely one step on along an axis."""
    return np.int64(window[at * WIDTH + AHEAD + axis])


@lean
def _bounded(v):
    return min(max(v, np.int64(-LIMIT)), np.int64(LIMIT))


@lean
def chain(work, here, axis, floor, row):
    """Follow the law from the neighbour before `here` along an axis, which must hold a force; into a row."""
    window = work.window
    at = before(here, axis)
    c = at * WIDTH
    a = np.int64(window[c + LENGTH])
    length = max(ahead(window, at, axis), a >> 3, max(np.int64(1), np.int64(floor) >> 1))
    ratio = np.int64(16384)
    if length != a:
        ratio = min((length << 14) // a, np.int64(1) << 17)
    for k in range(3):
        work.rows[row, k] = _bounded((np.int64(window[c + k]) * ratio + 8192) >> 14)


@inlined
def _off(window, old, at, law):
    """True where the reference is more than a step off at a cell."""
    a = np.int64(window[at * WIDTH + LENGTH])
    if a == 0 or old[at * 4 + 3] == 0:
        return False
    square = np.int64(0)
    for k in range(3):
        square += (np.int64(window[at * WIDTH + k]) - np.int64(old[at * 4 + k])) ** 2
    step = step_at(a, law.floor, law.rate)
    return square > step * step


@inlined
def _follow(law, work, here, trusted):
    """Put the chain into the row `EXPECTED`: the reference where it is `trusted`, else a neighbour by the law."""
    window, old = work.window, work.old
    if trusted and old[here * 4 + 3] > 0 and not _off(window, old, here - DEEP, law):
        for k in range(3):
            work.rows[EXPECTED, k] = np.int64(old[here * 4 + k])
        return np.int64(REFERENCE)
    for axis in range(3):
        at = before(here, axis)
        if held(window, at):
            chain(work, here, axis, law.floor, EXPECTED)
            return at
    return np.int64(NOTHING)


@inlined
def _begin(work, here):
    """The blend where no neighbour across a face holds a force: the reference, or the last vector."""
    rows = work.rows
    for k in range(3):
        rows[BASE, k] = np.int64(work.old[here * 4 + k]) if work.old[here * 4 + 3] > 0 else rows[LAST, k]
        rows[BLEND, k] = rows[BASE, k]
    work.of[_CORRECTED] = -1


@inlined
def _differences(work, here):
    """Features 0 to 10: how cells before differ from the base, and from those before them; none where one is none."""
    window, rows = work.window, work.rows
    for n in range(11):
        c = (here - _FROM[n]) * WIDTH
        d = (here - _TO[n]) * WIDTH
        there = np.int64(window[c + LENGTH] > 0) & np.int64(_TO[n] == 0 or window[d + LENGTH] > 0)
        for k in range(3):
            other = rows[BASE, k] if _TO[n] == 0 else np.int64(window[d + k])
            rows[FEATURE + n, k] = (np.int64(window[c + k]) - other) * there


@inlined
def _since(work, here):
    """Features 11 and 12: the reference less the base, and how much the neighbours differ from theirs on the mean."""
    window, old, rows = work.window, work.old, work.rows
    for k in range(3):
        rows[FEATURE + 11, k] = rows[FEATURE + 12, k] = 0
    if old[here * 4 + 3] == 0:
        return np.int64(0)
    count = np.int64(0)
    for axis in range(3):
        at = before(here, axis)
        if held(window, at) and old[at * 4 + 3] > 0:
            count += 1
            for k in range(3):
                rows[FEATURE + 12, k] += np.int64(window[at * WIDTH + k]) - np.int64(old[at * 4 + k])
    for k in range(3):
        rows[FEATURE + 11, k] = np.int64(old[here * 4 + k]) - rows[BASE, k]
        rows[FEATURE + 12, k] //= max(count, np.int64(1))
    return np.int64(1)


@inlined
def _mean(law, work, here, near):
    """The base: the mean direction of the neighbours, as long as the law makes likely; returns the step there."""
    window, rows = work.window, work.rows
    s0 = s1 = s2 = total = likely = count = np.int64(0)
    for axis in range(3):
        if near >> axis & 1:
            at = before(here, axis)
            a = np.int64(window[at * WIDTH + LENGTH])
            s0 += np.int64(window[at * WIDTH])
            s1 += np.int64(window[at * WIDTH + 1])
            s2 += np.int64(window[at * WIDTH + 2])
            total += a
            likely += max(ahead(window, at, axis), a >> 3)
            count += 1
    scale = min((likely << 16) // (total * count), np.int64(1 << 17))
    rows[BASE, 0] = (s0 * scale + 32768) >> 16
    rows[BASE, 1] = (s1 * scale + 32768) >> 16
    rows[BASE, 2] = (s2 * scale + 32768) >> 16
    step = step_at(likely // count, law.floor, law.rate)
    work.of[INVERSE] = (np.int64(1) << 32) // step
    return step


@inlined
def _corrected(work, kind, step):
    """The blend: the base, and what the weights of a kind make of the features."""
    work.of[_CORRECTED] = kind
    s0 = s1 = s2 = np.int64(0)
    for n in range(FEATURES):
        weight = work.weights[kind, n]
        for k in range(3):
            f = (work.rows[FEATURE + n, k] * work.of[INVERSE]) >> 24
            work.rows[FEATURE + n, k] = min(max(f, np.int64(-_FEATURE_LIMIT)), np.int64(_FEATURE_LIMIT))
        s0 += weight * work.rows[FEATURE + n, 0]
        s1 += weight * work.rows[FEATURE + n, 1]
        s2 += weight * work.rows[FEATURE + n, 2]
    work.rows[BLEND, 0] = _bounded(work.rows[BASE, 0] + ((s0 >> 16) * step >> 8))
    work.rows[BLEND, 1] = _bounded(work.rows[BASE, 1] + ((s1 >> 16) * step >> 8))
    work.rows[BLEND, 2] = _bounded(work.rows[BASE, 2] + ((s2 >> 16) * step >> 8))


@lean
def expect(law, work, here, near, trusted):
    """Put the two opinions of a voxel into the rows `EXPECTED` and `BLEND`.

    `near` tells which neighbours across a face hold a force, bits 0 to 2; `trusted`: whether the reference is
    followed.
    """
    if near:
        step = _mean(law, work, here, near)
        _differences(work, here)
        _corrected(work, near | _since(work, here) << 3, step)
    else:
        _begin(work, here)
    followed = _follow(law, work, here, trusted)
    work.of[FOLLOWED] = followed
    if followed == NOTHING:
        for k in range(3):
            work.rows[EXPECTED, k] = work.rows[BLEND, k]


@lean
def learn(work):
    """Move the weights of the blend towards the row `VECTOR`, which was decoded (normalised least mean squares)."""
    kind = work.of[_CORRECTED]
    for k in range(3):
        work.rows[LAST, k] = work.rows[VECTOR, k]
    if kind < 0:
        return
    energy = np.int64(_STILLNESS)
    for n in range(FEATURES):
        for k in range(3):
            energy += work.rows[FEATURE + n, k] * work.rows[FEATURE + n, k]
    for k in range(3):
        error = ((work.rows[VECTOR, k] - work.rows[BLEND, k]) * work.of[INVERSE]) >> 24
        error = min(max(error, np.int64(-_ERROR_LIMIT)), np.int64(_ERROR_LIMIT))
        gain = (error * (np.int64(_PACE) << 24)) // energy
        for n in range(FEATURES):
            weight = work.weights[kind, n] + ((work.rows[FEATURE + n, k] * gain) >> 14)
            work.weights[kind, n] = min(max(weight, np.int64(-_WEIGHT_LIMIT)), np.int64(_WEIGHT_LIMIT))
