"""Compiled loop of the spline guess: the code of its nodes."""

from __future__ import annotations

from typing import Final

import numpy as np

from touchfield.codec.kernels.bits import READING, TASK, code, even
from touchfield.lean import entry, inlined

__all__ = ["CONTEXTS", "REACH", "code_nodes"]

REACH: Final = 1 << 23
"""No coefficient is beyond it, units."""

_CLASSES: Final = 10
_LENGTHS: Final = 24
CONTEXTS: Final = _CLASSES * _LENGTHS


@inlined
def _expected(before, values, n):
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
def _residual(bits, at, r):
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

    `before`, int64 [n, 6], are the nodes before each one along x, y, z, xy, yz, zx, -1 where none is told; `values`,
    int64 [n], coefficients: a writer's are replaced by what a reader will have; `sizes`, int64 [n], room.
    """
    for n in range(values.shape[0]):
        near, near_class = np.int64(0), np.int64(0)
        for axis in range(3):
            if before[n, axis] >= 0:
                near += sizes[before[n, axis]]
        while near >> near_class and near_class < _CLASSES - 1:
            near_class += 1
        expected = _expected(before, values, n)
        r = np.int64(0)
        if bits.state[TASK] != READING:
            r = (2 * (values[n] - expected) + step) // (2 * step)
        r = _residual(bits, at + _LENGTHS * near_class, r)
        sizes[n] = abs(r)
        values[n] = min(max(expected + r * step, np.int64(-REACH)), np.int64(REACH))
