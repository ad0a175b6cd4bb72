"""Compiled loop of whole numbers: each by its sign and its binary digits, in contexts of the three before it."""

from __future__ import annotations

from typing import Final

import numpy as np

from touchfield.codec.kernels.bits import PLACE, READING, TASK, even, mix
from touchfield.lean import entry, lean

_LONGEST: Final = 62  # binary digits of the largest
_SIGN, _MORE, _SECOND = 1, 1, 16  # bit 0 is "not zero", 2 to 15 are "more digits", 18 to 31 the second digit
SETS: Final = 32
_NEAR: Final = SETS
_SIZES: Final = _NEAR + 125 * SETS
CONTEXTS: Final = _SIZES + 21 * 7 * SETS
ROOM: Final = 128  # bytes that a writer has for a number: a bit costs 14 bits at most, and 65 that learn at most


@lean
def _near(number):
    return min(max(number, np.int64(-2)), np.int64(2)) + 2


@lean
def _size(number, most):
    """Binary digits, `most` at most, with the sign, from 0 on."""
    size, left = np.int64(0), abs(number)
    while left > 0 and size < most:
        left >>= 1
        size += 1
    return most - size if number < 0 else most + size


@lean
def _code(bits, at, which, bit):
    bits.inputs[0] = at[0] + which
    bits.inputs[1] = at[1] + which
    bits.inputs[2] = at[2] + which
    return mix(bits, 3, at[3] + which, bit)


@entry
def code_numbers(bits, contexts_at, sets_at, numbers):
    """Write or read whole numbers, int64 [n]; those behind the end of a code that is read stay as they are."""
    r1, r2, r3 = np.int64(0), np.int64(0), np.int64(0)
    for i in range(numbers.shape[0]):
        near = (_near(r1) * 5 + _near(r2)) * 5 + _near(r3)
        sizes = _size(r1, np.int64(10)) * 7 + _size(r2, np.int64(3))
        at = contexts_at, contexts_at + _NEAR + SETS * near, contexts_at + _SIZES + SETS * sizes, sets_at
        size, found = abs(numbers[i]), np.int64(0)
        if _code(bits, at, np.int64(0), np.int64(size > 0)):
            sign = _code(bits, at, np.int64(_SIGN), np.int64(numbers[i] < 0))
            length, more = np.int64(0), np.int64(1)
            while more and length < _LONGEST:
                length += 1
                more = _code(bits, at, _MORE + min(length, np.int64(14)), np.int64(size >> length > 0))
            found = np.int64(1)
            if length > 1:
                found = 2 | _code(bits, at, _SECOND + min(length, np.int64(15)), (size >> (length - 2)) & 1)
            if length > 2:
                rest = (np.int64(1) << (length - 2)) - 1
                found = found << (length - 2) | even(bits, size & rest, length - 2)
            found = -found if sign else found
        numbers[i] = found
        r3, r2, r1 = r2, r1, found
        if bits.state[TASK] == READING and bits.state[PLACE] > bits.buffer.shape[0] + 6:
            return
