"""The residual of a sample in the light models of coder `touch`: still, or steps about what was expected.

Where a neighbour or the reference is followed, and chances are mixed, what does not stand still is coded about the
blend of all neighbours: a chain is right for long or off altogether, and then the others know better.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from touchfield.codec.kernels import touch_light_coder as coder
from touchfield.codec.kernels.touch_lattice import LIMIT, axes_along, level_of, step_at
from touchfield.codec.kernels.touch_light_cells import held, length_of
from touchfield.codec.kernels.touch_light_choice import FREE, THRIFT, choose, kept, place_vector
from touchfield.codec.kernels.touch_light_coder import lean
from touchfield.codec.kernels.touch_light_tiles import STATES

__all__ = ["MIXED", "RESIDUALS", "code_residual"]

_STILL = STATES
_STILL_NEAR = _STILL + 1024
_STILL_APART = _STILL_NEAR + 4096
_ZERO = _STILL_APART + 512  # three components of 512
_ZERO_NEAR = _ZERO + 3 * 512  # of 64
_ZERO_TOWARD = _ZERO_NEAR + 3 * 64  # of 256
_SIGN = _ZERO_TOWARD + 3 * 256  # of 64
_SIZE = _SIGN + 3 * 64  # of 8 classes and 16 sizes
_SIZE_TOWARD = _SIZE + 3 * 128  # of 16 distances, 8 classes and 16 sizes
_SIZE_LAST = _SIZE_TOWARD + 3 * 2048  # of 16 sizes before and 16 sizes
RESIDUALS = _SIZE_LAST + 3 * 256
"""Contexts up to here are the tiles' and the residual's."""

_BY_SIZE = 192
MIXED = _BY_SIZE + 3 * 16
"""Sets of weights; up to 64 they are the support's."""

_RATIO = np.array([0] * 17 + [1] + [2] * 2 + [3] * 3 + [4] * 4 + [5] * 5 + [6] * 13 + [7] * 19, np.int64)
"""Of a step to another, in sixteenths: quarters of an octave, about."""

_CLASS = np.array(
    [0, 1, 2, 2, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 5, 6, 6, 6, 6, 6, 6, 6, 6] + [7] * 8, np.int64
)  # of a mean size of residuals, in quarters

_STILL_ERROR = 0.3136
"""Squared error, in squared steps, that is let stand where it has its price and that of a bit is not asked."""


@lean
def _frame(p0, p1, p2, length, axes):
    axes_along(p0, p1, p2, length, axes)


@lean
def _level(length, border, first):
    return level_of(length, border, first)


@lean
def _digits(a):
    """Binary digits, 7 at most."""
    n = np.int64(0)
    while a > 0 and n < 7:
        a >>= 1
        n += 1
    return n


@lean
def _quiet(cells, at, sizes):
    """Whether a cell holds a force, and by how much it was corrected: 0 to 3."""
    return np.int64(0) if held(cells, at) == 0 else 1 + min((sizes & 255) + (sizes >> 8 & 255), 2)


@lean
def _centre(based, expected, centre):
    """What the residual is about, never of no length; its length."""
    from_ = np.int64(8) if based else np.int64(0)
    for c in range(3):
        centre[c] = min(max(expected[from_ + c], -LIMIT), LIMIT)
    length = length_of(centre[0], centre[1], centre[2])
    if length == 0:
        centre[2] = np.int64(1)
        length = np.int64(1)
    return length


@lean
def code_residual(
    then, near, at, up, deep, cells, expected, f, size, tol, rule, lattice, border, first, axes, found, spread,
    vector, centre, decoding, priced, state, buffer, chances, mixes, prices,
):  # fmt: skip
    """Code the residual to what was `expected`; the decoded vector goes into `vector`.

    `then` and `near` are contexts of the reference and of the neighbours; `f`, `size` and `tol` the force, units, of
    which only the encoder knows. Returns the amplitude and the sizes of the residual, for the cell.
    """
    encoding = not decoding
    p0, p1, p2 = expected[0], expected[1], expected[2]
    paid = 0.0
    length = length_of(p0, p1, p2)
    if length == 0:
        p2 = np.int64(1)
        length = np.int64(1)
    energy_0: Any = np.int64(0)
    energy_1: Any = np.int64(0)
    e_d: Any = np.int64(cells[np.uint64(deep * 8 + 4)])
    e_u: Any = np.int64(cells[np.uint64(up * 8 + 4)])
    e_l: Any = np.int64(cells[np.uint64(at * 8 - 4)])
    class_0 = class_1 = np.int64(7)
    if near:
        energy_0 = (e_d & 255) + (e_u & 255) + (e_l & 255)
        energy_1 = (e_d >> 8 & 255) + (e_u >> 8 & 255) + (e_l >> 8 & 255)
        class_0 = _CLASS[np.uint64(min(np.int64(31), energy_0 * 4 // near))]
        class_1 = _CLASS[np.uint64(min(np.int64(31), energy_1 * 2 // near))]
    loud = min(length >> 12, 15)
    still_class = _CLASS[np.uint64(min(np.int64(31), (energy_0 + energy_1) * 3 // max(near, 1)))]
    context = ((still_class << 2 | near) << 2 | min(loud, 3)) << 1 | np.int64(then >= 4)
    near_0: Any = np.int64(0)
    near_1: Any = np.int64(0)
    apart: Any = np.int64(0)
    pinned: Any = np.int64(0)
    fresh: Any = np.int64(0)
    step: Any = np.int64(1)
    second: Any = np.int64(0)
    third: Any = np.int64(0)
    o0: Any = np.int64(0)
    o1: Any = np.int64(0)
    o2: Any = np.int64(0)
    based = False
    based = expected[11] > 0
    # a force is known as well as where it was last corrected: how much finer must it be here?
    step = step_at(length, lattice[0], lattice[1])
    fresh = min(max(step >> 3, 1), 32767)
    pinned = fresh
    pin = np.int64(0)
    if expected[7] >= 0:
        pinned = np.int64(cells[np.uint64(expected[7] * 8 + 4)]) >> 16
        pin = _RATIO[np.uint64(min(pinned * 16 // fresh, 63))]
    context = context << 2 | pin >> 1
    near_0 = min(e_d & 255, 3) | min(e_u & 255, 3) << 2 | min(e_l & 255, 3) << 4
    near_1 = min(e_d >> 8 & 255, 3) | min(e_u >> 8 & 255, 3) << 2 | min(e_l >> 8 & 255, 3) << 4
    # a second opinion: the blend, or what it corrects
    other = np.int64(8) if based else np.int64(3)
    o0 = min(max(expected[other], -LIMIT), LIMIT) - expected[0]
    o1 = min(max(expected[other + 1], -LIMIT), LIMIT) - expected[1]
    o2 = min(max(expected[other + 2], -LIMIT), LIMIT) - expected[2]
    apart = _digits((length_of(o0, o1, o2) << 5) // (3 * step))
    quiet = (_quiet(cells, deep, e_d) << 2 | _quiet(cells, up, e_u)) << 2 | _quiet(cells, at - 1, e_l)
    second = (quiet << 3 | pin) << 3 | apart
    third = (apart << 4 | loud) << 2 | near
    bit = np.int64(0)
    if priced:
        paid = coder.price(state)
    if encoding:
        d0, d1, d2 = np.float64(p0), np.float64(p1), np.float64(p2)
        spread[0] = energy_0 / near if near else 3.0
        spread[1] = energy_1 / near / 2 if near else 3.0
        if rule[FREE] == 0:
            bit = np.int64(kept(d0, d1, d2, f[0], f[1], f[2], size, tol, rule))
        else:
            error = ((d0 - f[0]) ** 2 + (d1 - f[1]) ** 2 + (d2 - f[2]) ** 2) / np.float64(lattice[0]) ** 2
            bit = np.int64(error < _STILL_ERROR)
            about = _centre(based, expected, centre)
            _frame(centre[0], centre[1], centre[2], about, axes)
            cost = choose(
                f, size, tol, rule, _level(about, border, first), axes, border, first, lattice, spread, found,
                vector, based,
            )  # fmt: skip
            chance = (
                coder.chance_of(
                    _STILL + context, _STILL_NEAR + second, _STILL_APART + third, 64 + still_class, chances, mixes
                )
                / 65536
            )
            cost += rule[THRIFT] * ((1.5 if based else 0.5) - np.log2(1 - chance))
            bit = np.int64(error - rule[THRIFT] * np.log2(chance) < cost)
    bit = coder.mixed(
        _STILL + context, _STILL_NEAR + second, _STILL_APART + third, 64 + still_class, bit, decoding, state,
        buffer, chances, mixes,
    )  # fmt: skip
    if priced:
        prices[1] += coder.price(state) - paid
    if bit:
        vector[0], vector[1], vector[2] = p0, p1, p2
        return length, pinned << 16
    length = _centre(based, expected, centre)
    _frame(centre[0], centre[1], centre[2], length, axes)
    level = _level(length, border, first)
    if based:  # from there, the other opinion is what was followed
        o0, o1, o2 = -o0, -o1, -o2
        step = step_at(length, lattice[0], lattice[1])
    if encoding:
        choose(f, size, tol, rule, level, axes, border, first, lattice, spread, found, vector, based)
    for c in range(3):
        r = found[c]
        if c == 0:
            context = class_0 << 3 | min(loud, 7)
        elif c == 1:
            context = (class_1 << 2 | min(abs(found[0]), 3)) << 2 | min(loud, 3)
        else:
            context = (class_1 << 2 | min(abs(found[0]), 3)) << 2 | min(abs(found[1]), 3)
        if priced:
            paid = coder.price(state)
        toward: Any = np.int64(0)
        side: Any = np.int64(0)
        toward = (o0 * axes[c, 0] + o1 * axes[c, 1] + o2 * axes[c, 2]) >> 14
        side = np.int64(toward < 0)
        toward = _digits((abs(toward) << 3) // step)
        last = min(abs(found[c - 1]), 15) if c > 0 else loud
        moving = np.int64(1)
        if based or c < 2 or found[0] != 0 or found[1] != 0:
            second = near_0 if c == 0 else near_1
            third = (toward << 3 | (min(loud, 7) if c == 0 else class_1)) << 2 | (min(last, 3) if c > 0 else 0)
            moving = coder.mixed(
                _ZERO + c * 512 + context, _ZERO_NEAR + c * 64 + second, _ZERO_TOWARD + c * 256 + third,
                128 + c * 8 + class_0, np.int64(r != 0), decoding, state, buffer, chances, mixes,
            )  # fmt: skip
        r0 = np.int64(0)
        if moving:
            group: Any = class_0 if c == 0 else class_1
            context = (toward << 1 | side) << 2 | near
            sign = coder.plain(_SIGN + c * 64 + context, np.int64(r < 0), decoding, state, buffer, chances)
            toward |= np.int64(side == sign and toward > 0) << 3
            r0 = coder.mixed_magnitude(
                abs(r), _SIZE + (c * 8 + group) * 16, _SIZE_TOWARD + ((c * 16 + toward) * 8 + group) * 16,
                _SIZE_LAST + (c * 16 + last) * 16, _BY_SIZE + c * 16, decoding, state, buffer, chances, mixes,
            )  # fmt: skip
            if sign:
                r0 = -r0
        found[c] = r0
        if priced:
            prices[1 if c == 0 else 2] += coder.price(state) - paid
    r0, r1, r2 = found[0], found[1], found[2]
    place_vector(level, r0, r1, r2, axes, border, lattice, vector)
    a = max(np.int64(1), length_of(vector[0], vector[1], vector[2]))
    return a, min(abs(r0), 15) | min(abs(r1) + abs(r2), 31) << 8 | fresh << 16
