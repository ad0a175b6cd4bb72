"""Canonical Huffman codes of the amplitude and direction streams, and how they are read (paper section 5.2).

"Huffman coding is applied to the amplitude and direction streams." Here codes are canonical, so that a table is its
lengths, and none is longer than 24 bits.

Eq. 8 leaves most samples held, and a Huffman code spends one bit at least on each symbol. Departure: a run of held
samples is one symbol. Symbols 0 to N-1 are levels; symbol N + j is a run of 2^j + b held samples and is followed by
b in j raw bits, j = 0 to 20. Longer runs are several symbols. The literal coder, one zero symbol for each held
sample, uses j = 0 alone. A stream of directions has no runs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Int64s
from touchfield.codec.numbers import decode_numbers
from touchfield.codec.paper.kernels import loops as kernels
from touchfield.codec.paper.kernels.loops import LONGEST
from touchfield.errors import CorruptFile, InvalidArgument

RUN_SYMBOLS: Final = 21  # runs of up to 2^21 - 1 held samples in one symbol


class BitStream(NamedTuple):
    """Bits, those of the first byte first, from the top; the last byte is filled with zeros."""

    data: bytes
    bit_length: int


@dataclass(frozen=True, eq=False)
class HuffmanCode:
    """A prefix code over the symbols 0 to n-1.

    `lengths`, uint8 [n]: bits of each symbol's code; 0 for symbols that do not occur. One symbol alone has length 1.
    InvalidArgument if the lengths do not make a complete prefix code of at most 24 bits.
    """

    lengths: NDArray[np.uint8]

    def __post_init__(self) -> None:
        count = np.bincount(self.lengths, minlength=LONGEST + 1)
        kraft = sum(int(n) << (LONGEST - bits) for bits, n in enumerate(count[: LONGEST + 1]) if bits)
        present = int(count[1:].sum())
        if len(count) > LONGEST + 1 or not (kraft == 1 << LONGEST or present == 0 or present == count[1] == 1):
            raise InvalidArgument("Huffman code", f"lengths {count.tolist()}", "a complete prefix code")

    @classmethod
    def from_bytes(cls, data: bytes, symbol_count: int) -> HuffmanCode:
        """The code whose lengths are told in `data` (`codec.numbers`); CorruptFile or TruncatedFile if none is."""
        lengths = decode_numbers(data, symbol_count)
        if symbol_count and not 0 <= lengths.min() <= lengths.max() <= LONGEST:
            raise CorruptFile("Huffman code", f"a length of {lengths.min()} or {lengths.max()} bits", "0 to 24")
        try:
            return cls(lengths.astype(np.uint8))
        except InvalidArgument as error:
            raise CorruptFile("Huffman code", error.found, error.expected, "The file was changed or cut.") from None

    @cached_property
    def tables(self) -> tuple[Int64s, Int64s, NDArray[np.uint16]]:
        """Tables that tell canonical codes.

        `limits`, int64 [25], by length: the least code of 24 bits that begins with none of that length or less;
        `ranks`, int64 [25], by length: what is added to a code to have its place in `order`; and `order`, uint16
        [any]: the symbols that occur, in the order of their codes, shorter first, by symbol within a length.
        """
        limits, ranks = np.zeros((2, LONGEST + 1), np.int64)
        code = place = 0
        for bits in range(1, LONGEST + 1):
            ranks[bits] = place - code
            count = int(np.count_nonzero(self.lengths == bits))
            code, place = code + count, place + count
            limits[bits] = code << (LONGEST - bits)
            code *= 2
        order = np.argsort(self.lengths, kind="stable").astype(np.uint16)
        return limits, ranks, order[np.count_nonzero(self.lengths == 0) :]


def decode_symbols(
    code: HuffmanCode, bits: BitStream, sample_count: int, level_count: int
) -> tuple[Bools, NDArray[np.uint16]]:
    """The samples of a stream: which are sent, bool [sample_count], and the levels of these, uint16 [any].

    The symbols of `code` from `level_count` on are runs; a stream without runs has as many levels as symbols.
    CorruptFile if the bits are no codes, or do not stand for exactly so many samples.
    """
    where, mend = "Huffman stream", "The file was changed or cut."
    if len(bits.data) != -(-bits.bit_length // 8):
        raise CorruptFile(where, f"{len(bits.data)} bytes", f"{bits.bit_length} bits", mend)
    sent = np.zeros(sample_count, np.bool_)
    levels = np.empty(min(sample_count, bits.bit_length), np.uint16)
    data = np.frombuffer(bits.data, np.uint8).copy()
    used, count = kernels.decode(data, *code.tables, level_count, sent, levels)
    spare = -bits.bit_length % 8
    if used != bits.bit_length or (spare and bits.data[-1] & ((1 << spare) - 1)):
        raise CorruptFile(where, "bits that do not fit", f"codes of {sample_count} samples, then zeros", mend)
    return sent, levels[:count].copy()
