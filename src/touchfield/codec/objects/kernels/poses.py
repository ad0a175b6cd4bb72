"""Compiled loop of the pose coder: the residuals of its predictors.

One loop serves both directions. A pose is seven whole numbers, three of the position and four of the quaternion.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.codec.kernels.lean import LEAN
from touchfield.codec.kernels.mixer import PLACE, Coder, length_of, mixed, narrow

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "COMPONENTS",
    "CONTEXTS",
    "DONE",
    "ENDED",
    "FAULT",
    "LONGEST",
    "LONG_LEVELS",
    "NODES",
    "ORDER_BITS",
    "SHORT_LEVELS",
    "code_poses",
    "pose_coder",
]

DONE = 0
FAULT = 1
"""Status: a number beyond its limit."""
ENDED = 2
"""Status: the bits end too early."""

COMPONENTS = 7
ORDER_BITS = 2
LONGEST = 54
"""Bits of the largest residual: the quadratic predictor of numbers to 2^50 is off by 2^53 at most."""

NODES = 32
_NEGATIVE, _LONGER, _SECOND = 1, 1, 16  # nodes: 0 is "not zero", 2 to 15 "longer than k", 18 to 31 the second bit
_LAST_LONGER, _LAST_SECOND = 14, 15
_NEAR = 2
LONG_LEVELS = 10
SHORT_LEVELS = 3
CONTEXTS = (NODES * 2 * (2 * _NEAR + 1) ** 3, NODES * COMPONENTS * (2 * LONG_LEVELS + 1) * (2 * SHORT_LEVELS + 1))
"""Contexts of the two models: of the last three residuals near zero; of the sizes of the last two."""


def pose_coder(buffer: NDArray[np.uint8], *, decoding: bool) -> Coder:
    """A coder with the contexts of poses."""
    return Coder(buffer, decoding, CONTEXTS, NODES)


@njit(**LEAN)
def _near(residual):
    return min(max(residual, -_NEAR), _NEAR) + _NEAR


@njit(**LEAN)
def _size(residual, most):
    size = min(length_of(abs(residual)), most)
    return most - size if residual < 0 else most + size


@njit(**LEAN)
def _raw(number, bits, coding):
    """A number of so many bits of even chance, the highest first."""
    found = np.int64(0)
    for place in range(bits - 1, -1, -1):
        found = (found << 1) | narrow(np.int64(32768), (number >> place) & 1, coding)
    return found


@njit(**LEAN)
def _bit(node, first, second, bit, coding):
    return mixed(first + node, second + node, node, bit, coding)


@njit(**LEAN)
def _code_residual(r, first, second, coding):
    """A residual: is it zero, its sign, its length one by one, then what is below its top bit."""
    if _bit(0, first, second, np.int64(r != 0), coding) == 0:
        return np.int64(0)
    sign = _bit(_NEGATIVE, first, second, np.int64(r < 0), coding)
    size = abs(r)
    known = length_of(size)
    length = 1
    while length <= LONGEST:
        node = _LONGER + min(length, _LAST_LONGER)
        more = np.int64(known > length)
        if _bit(node, first, second, more, coding) == 0:
            break
        length += 1
    if length > LONGEST:
        return np.int64(1) << LONGEST
    found = np.int64(1)
    if length > 1:
        node = _SECOND + min(length, _LAST_SECOND)
        bit = (size >> (length - 2)) & 1
        found = 2 | _bit(node, first, second, bit, coding)
    if length > 2:
        rest = length - 2
        found = (found << rest) | _raw(size & ((np.int64(1) << rest) - 1), rest, coding)
    return -found if sign else found


@njit(**LEAN)
def _predicted(values, i, c, order):
    if i == 0:
        return np.int64(0)
    last = values[i - 1, c]
    before = values[max(i - 2, 0), c]
    if order == 1:
        return last
    if order == 2:
        return 2 * last - before
    return 3 * (last - before) + values[max(i - 3, 0), c]


@njit(**LEAN)
def _code(components, values, orders, limits, past, coding):
    begin, end = components
    for c in range(begin, end):
        orders[c] = _raw(orders[c], ORDER_BITS, coding)
    for i in range(values.shape[0]):
        for c in range(begin, end):
            order = orders[c]
            if order == 0 and i > 0:
                values[i, c] = values[0, c]
                continue
            predicted = _predicted(values, i, c, order)
            r1, r2, r3 = past[c, 0], past[c, 1], past[c, 2]
            wide = 2 * _NEAR + 1
            first = ((np.int64(c > 2) * wide + _near(r1)) * wide + _near(r2)) * wide + _near(r3)
            second = (c * (2 * LONG_LEVELS + 1) + _size(r1, LONG_LEVELS)) * (2 * SHORT_LEVELS + 1)
            second += _size(r2, SHORT_LEVELS)
            a, b = first * NODES, coding.second + second * NODES
            r = values[i, c] - predicted
            r = _code_residual(r, a, b, coding)
            value = predicted + r
            if abs(value) > limits[c]:
                return FAULT
            values[i, c] = value
            if i > 0:
                past[c, 2], past[c, 1], past[c, 0] = r2, r1, r
        if coding.decoding and coding.state[PLACE] > coding.buffer.shape[0]:
            return ENDED
    return DONE


def code_poses(
    coder: Coder,
    values: NDArray[np.int64],
    orders: NDArray[np.int64],
    limits: NDArray[np.int64],
    components: tuple[int, int] = (0, COMPONENTS),
) -> int:
    """Code the numbers of poses: read by the encoder, filled in by the decoder; returns a status.

    Parameters
    ----------
    coder : Coder
    values : int64 [n, 7]
        Zeros for the decoder.
    orders : int64 [7]
        Predictor of each component, 0 to 3; zeros for the decoder.
    limits : int64 [7]
        The largest |value| of each component, 2^50 at most.
    components : (int, int)
        Code only those from the first to before the second.
    """
    past = np.zeros((COMPONENTS, 3), np.int64)  # the last three residuals of each
    return int(_code(components, values, orders, limits, past, coder.coding))
