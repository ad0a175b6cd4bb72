"""Whole numbers as bytes, by one adaptive arithmetic code: the back-end that the stages of figure 4 share.

Each number is told by its binary length, in contexts of the two lengths before, and the bits below its highest, of
which three are learnt (`kernels.whole_numbers`). Signs are folded in: 0, -1, 1, -2, ... are 0, 1, 2, 3.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.code_end import check_end
from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int32s = NDArray[np.int32]

__all__ = ["LARGEST", "decode_numbers", "encode_numbers"]

LARGEST: Final = (1 << 30) - 1
"""No number is farther from zero."""


def encode_numbers(numbers: Int32s) -> bytes:
    """The code of int32 [n].

    Raises
    ------
    InvalidArgument
        If one is beyond `LARGEST`.
    """
    from touchfield.codec.kernels import whole_numbers as kernels

    signed = np.asarray(numbers, np.int64)
    if signed.ndim != 1 or (len(signed) and np.abs(signed).max() > LARGEST):
        raise InvalidArgument("numbers", f"shape {signed.shape}, or one beyond 2^30 - 1", "one axis of smaller ones")
    folded = np.where(signed < 0, -2 * signed - 1, 2 * signed)
    coder = kernels.number_coder(np.empty(64 * len(folded) + 64, np.uint8), decoding=False)
    kernels.code_numbers(coder, folded)
    place, end = coder.tail()
    return coder.buffer[:place].tobytes() + end


def decode_numbers(data: bytes, count: int) -> Int32s:
    """The inverse of `encode_numbers`: int32 [count]. The caller sees to it that the count is sound.

    Raises
    ------
    TruncatedFile, CorruptFile
        If the bytes are not those of so many numbers.
    """
    from touchfield.codec.kernels import whole_numbers as kernels

    folded = np.zeros(count, np.int64)
    coder = kernels.number_coder(np.frombuffer(data, np.uint8).copy(), decoding=True)
    status = kernels.code_numbers(coder, folded)
    check_end(status, coder.tail(), data, "whole numbers")
    return np.where(folded & 1, -(folded >> 1) - 1, folded >> 1).astype(np.int32)
