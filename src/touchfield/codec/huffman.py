"""Canonical Huffman codes of the amplitude and direction streams (paper section 5.2).

"Huffman coding is applied to the amplitude and direction streams." Here codes are canonical, so that a table
is its lengths, and no code is longer than 24 bits; within that limit the lengths are optimal (package-merge).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile
from touchfield.medium.field import frozen

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    DecoderTable = tuple[NDArray[np.uint32], NDArray[np.uint16], NDArray[np.int64]]

__all__ = [
    "MAX_CODE_BITS",
    "MAX_SYMBOLS",
    "HuffmanCode",
    "bytes_of_words",
    "decode_plain",
    "encode_plain",
    "words_of_bytes",
]

MAX_CODE_BITS = 24
MAX_SYMBOLS = 1 << 16

# The table as nibbles: 0 to 8 a length that differs from the last by -4 to 4, and
_FIRST_LAST = 8  # the "last" length before the first
_EXPLICIT = 9  # the length in two nibbles, high one first
_ABSENT = 10  # one absent symbol
_ABSENT_RUN = 11  # two or more: count - 2 in nibbles, three bits each, least significant first, 8 = more follow


@dataclass(frozen=True)
class HuffmanCode:
    """A prefix code over the symbols 0..n-1.

    Parameters
    ----------
    lengths : uint8 [n]
        Bits of each symbol's code; 0 for symbols that do not occur. One symbol alone has length 1.

    Raises
    ------
    InvalidArgument
        If the lengths do not make a complete prefix code of at most 24 bits.
    """

    lengths: NDArray[np.uint8]

    def __post_init__(self) -> None:
        lengths = np.ascontiguousarray(self.lengths)
        if lengths.dtype != np.uint8 or lengths.ndim != 1 or len(lengths) > MAX_SYMBOLS:
            raise InvalidArgument(
                "Huffman lengths", f"{lengths.dtype} {lengths.shape}", f"uint8 [n], n up to {MAX_SYMBOLS}"
            )
        fault = _kraft_fault(lengths)
        if fault:
            raise InvalidArgument("Huffman lengths", fault, "a complete prefix code")
        object.__setattr__(self, "lengths", frozen(lengths))

    @classmethod
    def fit(cls, counts: ArrayLike) -> HuffmanCode:
        """The best code for symbols that occur `counts` times, int64 [n]; n may be 0, and counts may be 0.

        Raises
        ------
        InvalidArgument
            If a count is negative, or there are more than 2^16 symbols or 2^56 counts.
        """
        c = np.asarray(counts)
        if c.ndim != 1 or len(c) > MAX_SYMBOLS or (len(c) and not np.issubdtype(c.dtype, np.integer)):
            raise InvalidArgument("Huffman counts", f"{c.dtype} {c.shape}", f"integers [n], n up to {MAX_SYMBOLS}")
        if len(c) and (c.min() < 0 or float(c.max()) * len(c) >= 2.0**56):
            raise InvalidArgument("Huffman counts", f"{c.min()} to {c.max()}", "counts from 0, 2^56 in all at most")
        lengths = np.zeros(len(c), np.uint8)
        present = np.flatnonzero(c)
        if len(present) == 1:
            lengths[present] = 1
        elif len(present) > 1:
            from touchfield.codec.kernels import huffman as kernels

            weights = c[present].astype(np.int64)
            order = np.argsort(weights, kind="stable")
            lengths[present[order]] = kernels.limited_lengths(weights[order], MAX_CODE_BITS)
        return cls(lengths)

    @property
    def symbol_count(self) -> int:
        """n, the size of the alphabet, absent symbols included."""
        return len(self.lengths)

    @cached_property
    def codes(self) -> NDArray[np.uint32]:
        """``code << 5 | length`` of each symbol, uint32 [n]: shorter codes first, by symbol within a length."""
        from touchfield.codec.kernels import huffman as kernels

        return frozen(kernels.canonical_codes(self.lengths))

    @cached_property
    def decoder_table(self) -> DecoderTable:
        """What the compiled decoder looks things up in."""
        from touchfield.codec.kernels import huffman as kernels

        return kernels.decoder_table(self.lengths)

    def mean_length(self, counts: ArrayLike) -> float:
        """Bits a symbol, of symbols that occur `counts` times; 0 where there are none."""
        c = np.asarray(counts, np.float64)
        total = float(c.sum())
        return float(c @ self.lengths) / total if total else 0.0

    def to_bytes(self) -> bytes:
        """The table: a nibble a symbol where lengths vary slowly, a few for any run of absent symbols."""
        nibbles: list[int] = []
        last, absent = _FIRST_LAST, 0
        for length in [*self.lengths.tolist(), -1]:
            if length == 0:
                absent += 1
                continue
            _put_absent(nibbles, absent)
            absent = 0
            if length < 0:
                break
            step = length - last
            nibbles += [step + 4] if -4 <= step <= 4 else [_EXPLICIT, length >> 4, length & 15]
            last = length
        if len(nibbles) % 2:
            nibbles.append(0)
        return bytes(high << 4 | low for high, low in zip(nibbles[::2], nibbles[1::2], strict=True))

    @classmethod
    def from_bytes(cls, data: bytes, offset: int, n: int) -> tuple[HuffmanCode, int]:
        """The code over `n` symbols whose table begins at `offset`, and the offset behind it.

        Raises
        ------
        TruncatedFile
            If the bytes end within the table.
        CorruptFile
            If the table is none, or its lengths are not those of a complete prefix code.
        """
        if not 0 <= n <= MAX_SYMBOLS:
            raise CorruptFile("Huffman table", f"{n} symbols", f"0 to {MAX_SYMBOLS}")
        nibbles = _Nibbles(data, offset)
        lengths = np.zeros(n, np.uint8)
        last, symbol = _FIRST_LAST, 0
        while symbol < n:
            token = nibbles.take()
            if token in (_ABSENT, _ABSENT_RUN):
                symbol += 1 if token == _ABSENT else 2 + nibbles.take_count(n)
                continue
            length = last + token - 4
            if token == _EXPLICIT:
                length = nibbles.take() << 4 | nibbles.take()
            if token > _ABSENT_RUN or not 1 <= length <= MAX_CODE_BITS:
                raise CorruptFile("Huffman table", f"token {token} for symbol {symbol}", "a length of 1 to 24")
            lengths[symbol] = last = length
            symbol += 1
        end = nibbles.end()
        fault = f"{symbol} symbols, not {n}" if symbol > n else _kraft_fault(lengths)
        if fault:
            raise CorruptFile("Huffman table", fault, "a complete prefix code", "The file was changed or cut.")
        return cls(lengths), end


def _kraft_fault(lengths: NDArray[np.uint8]) -> str:
    """What keeps these lengths from being a complete prefix code, or nothing."""
    count = np.bincount(lengths, minlength=MAX_CODE_BITS + 1)
    if len(count) > MAX_CODE_BITS + 1:
        return f"a length of {len(count) - 1} bits"
    present = int(count[1:].sum())
    if present == 0 or (present == 1 and count[1] == 1):
        return ""
    kraft = sum(int(count[bits]) << (MAX_CODE_BITS - bits) for bits in range(1, MAX_CODE_BITS + 1))
    return "" if kraft == 1 << MAX_CODE_BITS else f"a Kraft sum of {kraft}/{1 << MAX_CODE_BITS}"


def _put_absent(nibbles: list[int], count: int) -> None:
    if count == 1:
        nibbles.append(_ABSENT)
    elif count:
        nibbles.append(_ABSENT_RUN)
        rest = count - 2
        while rest > 7:
            nibbles.append(rest & 7 | 8)
            rest >>= 3
        nibbles.append(rest)


class _Nibbles:
    """Half bytes from `offset` of `data`, the high one first."""

    def __init__(self, data: bytes, offset: int) -> None:
        self._data, self._place = data, 2 * offset

    def take(self) -> int:
        at, low = divmod(self._place, 2)
        if at >= len(self._data):
            raise TruncatedFile("Huffman table", f"the end of the bytes at offset {len(self._data)}", "more lengths")
        self._place += 1
        return self._data[at] & 15 if low else self._data[at] >> 4

    def take_count(self, limit: int) -> int:
        count = shift = 0
        while True:
            nibble = self.take()
            count |= (nibble & 7) << shift
            shift += 3
            if count > limit or shift > 18:
                raise CorruptFile("Huffman table", "a run beyond the alphabet", f"{limit} symbols at most")
            if nibble < 8:
                return count

    def end(self) -> int:
        """The offset of the next whole byte."""
        if self._place % 2 and self.take():
            raise CorruptFile("Huffman table", "a filled last half byte", "zero")
        return self._place // 2


def bytes_of_words(words: NDArray[np.uint32], bit_length: int) -> bytes:
    """The first `bit_length` bits of uint32 words, as bytes, the last one filled with zeros."""
    used = words[: -(-bit_length // 32)]
    return used.astype(">u4").tobytes()[: -(-bit_length // 8)]


def words_of_bytes(data: bytes, bit_length: int, where: str) -> NDArray[np.uint32]:
    """The uint32 words of a stream of `bit_length` bits.

    Raises
    ------
    TruncatedFile
        If there are fewer bytes.
    CorruptFile
        If there are more bytes, or the bits that fill the last one are not zero.
    """
    size = -(-bit_length // 8)
    if len(data) < size:
        raise TruncatedFile(where, f"{len(data)} bytes", f"{size} for {bit_length} bits")
    if bit_length < 0 or len(data) > size:
        raise CorruptFile(where, f"{len(data)} bytes", f"{size} for {bit_length} bits")
    if bit_length % 8 and data[-1] & ((1 << (8 - bit_length % 8)) - 1):
        raise CorruptFile(where, "bits behind the end", "zeros", "The file was changed.")
    padded = np.zeros(-(-size // 4) * 4, np.uint8)
    padded[:size] = np.frombuffer(data, np.uint8)
    return padded.view(">u4").astype(np.uint32)


def as_symbols(symbols: NDArray[Any], code: HuffmanCode) -> NDArray[np.uint16]:
    """`symbols` as uint16 [m] within the alphabet of `code`."""
    s = np.asarray(symbols)
    if s.ndim != 1 or not (np.issubdtype(s.dtype, np.integer) or s.size == 0):
        raise InvalidArgument("symbols", f"{s.dtype} {s.shape}", "integers [m]")
    if s.dtype != np.uint16 and s.size and (s.min() < 0 or s.max() >= code.symbol_count):
        raise InvalidArgument("symbols", f"{s.min()} to {s.max()}", f"0 to {code.symbol_count - 1}")
    return np.require(s, np.uint16, ["C", "W"])  # a read-only array would be another type to the compiler


def encode_plain(code: HuffmanCode, symbols: NDArray[Any]) -> tuple[bytes, int]:
    """The codes of `symbols`, integers [m], one after the other: bytes and the number of bits.

    Raises
    ------
    InvalidArgument
        If a symbol has no code.
    """
    from touchfield.codec.kernels import huffman as kernels

    s = as_symbols(symbols, code)
    longest = int(code.lengths.max(initial=0))
    words = np.empty(len(s) * longest // 32 + 2, np.uint32)
    bit_length = kernels.encode(s, code.codes, words)
    if bit_length < 0:
        raise InvalidArgument("symbols", "one without a code", "symbols that the code was fitted to")
    return bytes_of_words(words, bit_length), bit_length


def decode_plain(code: HuffmanCode, data: bytes, bit_length: int, count: int) -> NDArray[np.uint16]:
    """The inverse of `encode_plain`: `count` symbols, uint16 [count].

    Raises
    ------
    TruncatedFile, CorruptFile
        If the bits are too few, too many or no codes.
    """
    from touchfield.codec.kernels import huffman as kernels

    where = "Huffman stream"
    words = words_of_bytes(data, bit_length, where)
    if not 0 <= count <= bit_length:
        raise CorruptFile(where, f"{count} symbols in {bit_length} bits", "one bit a symbol at least")
    symbols = np.empty(count, np.uint16)
    check_used(kernels.decode(words, bit_length, code.decoder_table, symbols), bit_length, where)
    return symbols


def check_used(used: int, bit_length: int, where: str) -> None:
    """Raise `CorruptFile` unless a decoder used all of the bits and found codes only."""
    if used != bit_length:
        found = f"{used} bits in use" if used >= 0 else "bits that are no code, or end within one"
        raise CorruptFile(where, found, f"codes that fill {bit_length} bits", "The file was changed or cut.")
