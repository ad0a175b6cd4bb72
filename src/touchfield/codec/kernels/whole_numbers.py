"""Compiled loop of whole numbers: each by its binary length and the bits below its highest, which adapt.

One loop serves both directions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.codec.kernels.lean import LEAN
from touchfield.codec.kernels.mixer import PLACE, Coder, length_of, mixed, narrow

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["DONE", "ENDED", "code_numbers", "number_coder"]

DONE, ENDED = 0, 2
"""Status: all is well; the bits end too early."""

_HEADS = 3  # bits below the highest that are learnt
_LENGTHS = 64

_NUMBER_CONTEXTS = (_LENGTHS * 32 + (_LENGTHS << _HEADS), _LENGTHS * 32 * 32 + (_LENGTHS << _HEADS))


def number_coder(buffer: NDArray[np.uint8], *, decoding: bool) -> Coder:
    """A coder for `code_numbers`."""
    return Coder(buffer, decoding, _NUMBER_CONTEXTS, 32 + (1 << _HEADS))


@njit(**LEAN)
def _code_numbers(numbers, coding):
    last = before = np.int64(0)
    for i in range(numbers.shape[0]):
        number = numbers[i]
        known = length_of(number)
        node = np.int64(1)
        for place in range(4, -1, -1):  # the length, 0 to 31
            a = last * 32 + node
            b = coding.second + (last * 32 + before) * 32 + node
            bit = np.int64((known >> place) & 1)
            bit = mixed(a, b, node, bit, coding)
            node = 2 * node + bit
        length = node - 32
        found = np.int64(length > 0)
        for place in range(length - 2, -1, -1):
            bit = (number >> place) & 1
            if length - 2 - place < _HEADS:
                a = _LENGTHS * 32 + (length << _HEADS) + found % (1 << _HEADS)
                b = coding.second + _LENGTHS * 32 * 32 + (length << _HEADS) + found % (1 << _HEADS)
                chosen = 32 + found % (1 << _HEADS)
                bit = mixed(a, b, chosen, bit, coding)
            else:
                bit = narrow(np.int64(32768), bit, coding)
            found = 2 * found + bit
        numbers[i] = found
        before, last = last, length
        if coding.decoding and coding.state[PLACE] > coding.buffer.shape[0]:
            return ENDED
    return DONE


def code_numbers(coder: Coder, numbers: NDArray[np.int64]) -> int:
    """Code numbers of 31 bits, int64 [n]: read by the encoder, filled in by the decoder; returns a status."""
    return int(_code_numbers(numbers, coder.coding))
