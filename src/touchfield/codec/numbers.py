"""Whole numbers as bytes, by one adaptive arithmetic code (`kernels.whole_numbers`)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Int64s
from touchfield.codec.kernels.bits import end_of, fresh, reader, writer
from touchfield.codec.kernels.whole_numbers import CONTEXTS, ROOM, SETS, code_numbers
from touchfield.codec.support import check_end
from touchfield.errors import CorruptFile, InvalidArgument

LARGEST: Final = (1 << 30) - 1  # no number is farther from zero


def encode_numbers(numbers: NDArray[np.integer]) -> bytes:
    """The code of whole numbers [n]. InvalidArgument if one is beyond `LARGEST`."""
    told = np.array(numbers, np.int64)
    if told.ndim != 1 or (len(told) and np.abs(told).max() > LARGEST):
        raise InvalidArgument("numbers", f"shape {told.shape}, or one beyond 2^30 - 1", "one axis of smaller ones")
    bits = writer(ROOM * len(told) + 64, fresh(CONTEXTS, SETS))
    code_numbers(bits, 0, 0, told)
    return end_of(bits)


def decode_numbers(data: bytes, count: int) -> Int64s:
    """The inverse of `encode_numbers`: int64 [count], a sound one; TruncatedFile or CorruptFile for other bytes."""
    bits, numbers = reader(data, fresh(CONTEXTS, SETS)), np.zeros(count, np.int64)
    code_numbers(bits, 0, 0, numbers)
    check_end(bits, 0, "whole numbers")
    if count and np.abs(numbers).max() > LARGEST:
        raise CorruptFile("whole numbers", f"{np.abs(numbers).max()}", f"{LARGEST} at most")
    return numbers
