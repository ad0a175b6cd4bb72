"""The residual of a sample in the light models of coder `touch`: still, or steps about what was expected."""

from __future__ import annotations

from typing import Any

import numpy as np

from touchfield.codec.kernels import touch_light_coder as coder
from touchfield.codec.kernels.touch_lattice import axes_along, level_of, step_at
from touchfield.codec.kernels.touch_light_cells import length_of
from touchfield.codec.kernels.touch_light_choice import FREE, THRIFT, choose, kept, place_vector
from touchfield.codec.kernels.touch_light_coder import lean
from touchfield.codec.kernels.touch_light_tiles import STATES

__all__ = ["RESIDUALS", "code_residual"]

_STILL = STATES
_STILL_NEAR = _STILL + 1024
_STILL_SPREAD = _STILL_NEAR + 1024
_ZERO = _STILL_SPREAD + 1024  # three components of 512
_ZERO_NEAR = _ZERO + 3 * 512
_ZERO_SPREAD = _ZERO_NEAR + 3 * 512
_SIGN = _ZERO_SPREAD + 3 * 512
_SIZE = _SIGN + 64
RESIDUALS = _SIZE + 3 * 16 * 16
"""Contexts up to here are the tiles' and the residual's."""

_RATIO = np.array([0] * 17 + [1] + [2] * 2 + [3] * 3 + [4] * 4 + [5] * 5 + [6] * 13 + [7] * 19, np.int64)
"""Of a step to another, in sixteenths: quarters of an octave, about."""

_CLASS = np.array(
    [0, 1, 2, 2, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 5, 6, 6, 6, 6, 6, 6, 6, 6] + [7] * 8, np.int64
)  # of a mean size of residuals, in quarters


@lean
def _frame(p0, p1, p2, length, axes):
    axes_along(p0, p1, p2, length, axes)


@lean
def _level(length, border, first):
    return level_of(length, border, first)


@lean
def _magnitude_class(a):
    """0 to 7: twice the binary logarithm, about."""
    n = np.int64(0)
    while a > 0 and n < 7:
        a >>= 1
        n += 1
    return n


@lean
def code_residual(
    rich, then, near, at, up, deep, cells, expected, f, size, tol, rule, lattice, border, first, axes, found, spread,
    vector, decoding, priced, state, buffer, chances, mixes, prices,
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
    if rich:
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
        apart = abs(p0 - expected[3]) + abs(p1 - expected[4]) + abs(p2 - expected[5])
        apart = _magnitude_class(apart * 8 // step)
    bit = np.int64(0)
    if priced:
        paid = coder.price(state)
    if encoding:
        d0, d1, d2 = np.float64(p0), np.float64(p1), np.float64(p2)
        if rule[FREE] > 0:
            error = np.sqrt((d0 - f[0]) ** 2 + (d1 - f[1]) ** 2 + (d2 - f[2]) ** 2)
            bit = np.int64(error < (0.5 + 0.2 * rule[THRIFT]) * lattice[0])
        else:
            bit = np.int64(kept(d0, d1, d2, f[0], f[1], f[2], size, tol, rule))
    if rich:
        second = min(energy_0, 7) << 4 | min(energy_1, 15)
        third = (8 + pin if apart == 0 and expected[7] >= 0 else apart) << 4 | loud
        bit = coder.mixed(
            _STILL + context, _STILL_NEAR + (second << 2 | near), _STILL_SPREAD + (third << 2 | near),
            64 + still_class, bit, decoding, state, buffer, chances, mixes,
        )  # fmt: skip
    else:
        bit = coder.plain(_STILL + context, bit, decoding, state, buffer, chances)
    if priced:
        prices[1] += coder.price(state) - paid
    if bit:
        vector[0], vector[1], vector[2] = p0, p1, p2
        a = length
        sizes: Any = pinned << 16
    else:
        _frame(p0, p1, p2, length, axes)
        level = _level(length, border, first)
        if encoding:
            spread[0] = energy_0 / near if near else 3.0
            spread[1] = energy_1 / near / 2 if near else 3.0
            choose(f, size, tol, rule, level, axes, border, first, lattice, spread, found, vector)
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
            moving = np.int64(1)
            if c < 2 or found[0] != 0 or found[1] != 0:
                if rich:
                    second = near_0 if c == 0 else near_1
                    third = apart << 3 | min(loud, 7) if c == 0 else apart << 3 | class_1
                    third = third << 2 | (0 if c == 0 else min(abs(found[c - 1]), 3))
                    moving = coder.mixed(
                        _ZERO + c * 512 + context, _ZERO_NEAR + c * 512 + second,
                        _ZERO_SPREAD + c * 512 + third, 128 + c * 8 + class_0, np.int64(r != 0),
                        decoding, state, buffer, chances, mixes,
                    )  # fmt: skip
                else:
                    moving = coder.plain(
                        _ZERO + c * 512 + context, np.int64(r != 0), decoding, state, buffer, chances
                    )
            r0 = np.int64(0)
            if moving:
                group = class_0 if c == 0 else class_1
                sign = coder.plain(_SIGN + c * 8 + near, np.int64(r < 0), decoding, state, buffer, chances)
                r0 = coder.magnitude(abs(r), _SIZE + (c * 16 + group) * 16, decoding, state, buffer, chances)
                if sign:
                    r0 = -r0
            found[c] = r0
            if priced:
                prices[1 if c == 0 else 2] += coder.price(state) - paid
        r0, r1, r2 = found[0], found[1], found[2]
        place_vector(level, r0, r1, r2, axes, border, lattice, vector)
        a = max(np.int64(1), length_of(vector[0], vector[1], vector[2]))
        sizes = min(abs(r0), 15) | min(abs(r1) + abs(r2), 31) << 8 | fresh << 16
    return a, sizes
