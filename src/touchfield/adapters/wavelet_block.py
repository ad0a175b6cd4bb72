"""Blocks of wavelets as MPEG haptics codes them (ISO/IEC 23090-31): SPIHT, arithmetic coding, the 9/7 wavelet.

A block is 2^m samples of its band's upper frequency limit a second. Its stream holds, least bit of a byte first, the
codes of an adaptive binary arithmetic coder of ten bits with a counter for each of seven contexts; they are the
number of bit planes (4), the greatest coefficient (1 + 7), and the bit planes of the coefficients in the order of
Said and Pearlman's set partitioning in hierarchical trees (1996). The coefficients are those of a biorthogonal 9/7
wavelet over log2(n / 4) levels, symmetric at the ends.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64s = NDArray[np.float64]

__all__ = ["MAX_BLOCK", "MIN_BLOCK", "block_samples"]

MIN_BLOCK: Final = 16
MAX_BLOCK: Final = 4096

_FULL: Final = 1024
_HALF, _QUARTER, _THREE_QUARTERS = _FULL // 2, _FULL // 4, 3 * _FULL // 4
_DIGITS: Final = 10
_HEAD, _SIGN, _LONE, _SET, _CHILD, _GRANDCHILDREN, _REFINED = range(7)
_SMOOTH: Final = np.array([-0.064538882628938, -0.040689417609559, 0.418092273222212, 0.788485616405665])
_SHARP: Final = np.array(
    [-0.037828455506995, -0.023849465019380, 0.110624404418423, 0.377402855612654, -0.852698679009404]
)
"""The halves of the two symmetric filters of the synthesis, from their ends to their middle."""


class _Bits:
    """The decoded bits of a stream; behind its end come zeros."""

    def __init__(self, stream: bytes) -> None:
        self.bits = np.unpackbits(np.frombuffer(stream, np.uint8), bitorder="little").tolist()
        self.next, self.lead = 0, 0
        for _ in range(_DIGITS):
            self._take()
        self.low, self.high = 0, _FULL
        self.zeros, self.seen = [8] * 7, [16] * 7

    def _take(self) -> None:
        bit = self.bits[self.next] if self.next < len(self.bits) else 0
        self.lead, self.next = 2 * self.lead + bit, self.next + 1

    def bit(self, context: int) -> int:
        width = self.high - self.low
        share = int(self.zeros[context] / self.seen[context] * _FULL + 0.5)
        split = min(max(width * share // _FULL, 1), width - 1)
        found = int(self.lead - self.low >= split)
        if found:
            self.low += split
        else:
            self.high = self.low + split
            self.zeros[context] += 1
        self.seen[context] += 1
        while True:
            if self.high <= _HALF:
                off = 0
            elif self.low >= _HALF:
                off = _HALF
            elif self.low >= _QUARTER and self.high <= _THREE_QUARTERS:
                off = _QUARTER
            else:
                return found
            self.low, self.high = 2 * (self.low - off), 2 * (self.high - off)
            self.lead -= off
            self._take()

    def number(self, count: int) -> int:
        return sum(self.bit(_HEAD) << i for i in range(count))


def block_samples(stream: bytes, length: int) -> Float64s:
    """The samples of a block, float64 [length].

    Parameters
    ----------
    stream : bytes
        As the file has it; an empty one is silence.
    length : int
        A power of two from 16 to 4096.
    """
    if not stream:
        return np.zeros(length)
    bits = _Bits(stream)
    planes = bits.number(4)
    has_integer = bits.bit(_HEAD)
    mantissa = bits.number(7)
    greatest = 1 + mantissa / 8 if has_integer else mantissa / 128
    coefficients = np.array(_coefficients(bits, length, planes), np.float64)
    return _synthesis(coefficients * (greatest / 2.0**planes))


def _coefficients(bits: _Bits, length: int, planes: int) -> list[int]:
    """Coefficients in whole steps of the last bit plane, by set partitioning."""
    out = [0] * length
    known: list[int] = []
    lone = list(range(8))
    sets = [(at, False) for at in range(4, 8)]
    for plane in range(planes, -1, -1):
        step, before = 1 << plane, len(known)
        places, lone = lone, []
        for at in places:
            _look(bits, _LONE, at, step, out, known, lone)
        walked, sets = sets, []
        for at, is_deep in walked:  # grows while it is walked
            if not bits.bit(_GRANDCHILDREN if is_deep else _SET):
                sets.append((at, is_deep))
            elif is_deep:
                walked += [(2 * at, False), (2 * at + 1, False)]
            else:
                for child in (2 * at, 2 * at + 1):
                    _look(bits, _CHILD, child, step, out, known, lone)
                if 4 * at + 3 < length:
                    walked.append((at, True))
        for at in known[:before]:
            if bits.bit(_REFINED):
                out[at] += step if out[at] > 0 else -step
    return out


def _look(bits: _Bits, context: int, at: int, step: int, out: list[int], known: list[int], lone: list[int]) -> None:
    """Whether a coefficient shows in this bit plane: then it is known with its sign, else it is looked at again."""
    if bits.bit(context):
        out[at] = step if bits.bit(_SIGN) else -step
        known.append(at)
    else:
        lone.append(at)


def _synthesis(coefficients: Float64s) -> Float64s:
    samples = coefficients.copy()
    for level in range(int(np.log2(len(samples) / 4)) - 1, -1, -1):
        length = len(samples) >> level
        low, high = np.zeros(length), np.zeros(length)
        low[::2], high[1::2] = samples[: length // 2], samples[length // 2 : length]
        samples[:length] = _filtered(low, _SMOOTH) + _filtered(high, _SHARP)
    return samples


def _filtered(values: Float64s, half: Float64s) -> Float64s:
    reach = len(half) - 1
    both = np.concatenate([half, half[-2::-1]])
    filtered: Float64s = np.convolve(np.pad(values, reach, "reflect"), both, "valid")
    return filtered
