"""Sorted float32 values of a palette as bytes, and where a vector is among others.

A value is told by the gap to the one before it, in multiples of a unit where all values are such (one float32
product each, `fixed_field`), otherwise in its float32 bits, which ascend with its size.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.code_end import check_end
from touchfield.codec.varint import read_varint, write_varint
from touchfield.errors import CorruptFile, TruncatedFile

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Bits = NDArray[np.uint32]
    Int64s = NDArray[np.int64]

__all__ = [
    "MOST_MULTIPLE",
    "VectorIndex",
    "common_unit",
    "in_order",
    "read_magnitudes",
    "read_values",
    "write_values",
]

MOST_MULTIPLE: Final = (1 << 18) - 1

_SIGN: Final = 1 << 31
_INFINITY: Final = 0x7F800000
_TOP_DIVISOR = 8
_WHERE = "palette values"


class VectorIndex:
    """Places of vectors in a list, bit for bit.

    Parameters
    ----------
    table : uint32 [p, 3]
        Float32 bits; of equal vectors the first is found. At most 2^20 distinct components.
    """

    def __init__(self, table: Bits) -> None:
        self._values = np.unique(table)
        self._keys, self._places = np.unique(self._key(table)[0], return_index=True)

    def _key(self, bits: Bits) -> tuple[Int64s, NDArray[np.bool_]]:
        ranks = np.minimum(np.searchsorted(self._values, bits), len(self._values) - 1)
        held = (self._values[ranks] == bits).all(axis=1)
        return ranks[:, 0] << 40 | ranks[:, 1] << 20 | ranks[:, 2], held

    def find(self, bits: Bits) -> Int64s:
        """Places of vectors, uint32 [n, 3], in the list, int64 [n]; -1 where one is not."""
        keys, held = self._key(bits)
        place = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        return np.where(held & (self._keys[place] == keys), self._places[place], -1)


def in_order(bits: Bits) -> Bits:
    """The distinct values, ascending from the most negative; -0.0 before 0.0."""
    distinct = np.unique(bits)
    negative = distinct >= _SIGN
    return np.concatenate([distinct[negative][::-1], distinct[~negative]])


def common_unit(magnitudes_n: NDArray[np.float32]) -> np.float32 | None:
    """The unit of which all values are multiples, rounded once to float32; None where there is none.

    Parameters
    ----------
    magnitudes_n : float32 [n]
        Ascending, not negative. The largest may be `MOST_MULTIPLE` units.
    """
    exact = magnitudes_n[magnitudes_n > 0].astype(np.float64)
    if len(exact) < 2 or exact[-1] > 1e37:
        return None
    gaps = np.diff(exact)
    gaps = gaps[gaps > 2.0**-18 * exact[1:]]  # smaller ones are mostly rounding
    guess = min(float(exact[0]), float(gaps.min(initial=np.inf)))
    for divisor in range(1, _TOP_DIVISOR + 1):
        unit = _refined(exact, guess / divisor)
        if unit is None:
            continue
        for near in (unit, np.nextafter(unit, np.float32(0)), np.nextafter(unit, np.float32(np.inf))):
            multiples = np.rint(exact / np.float64(near)) if near > 0 else np.full(1, np.inf)
            if multiples[-1] <= MOST_MULTIPLE and np.array_equal(multiples.astype(np.float32) * near, exact):
                return near
    return None


def _refined(exact: NDArray[np.float64], guess: float) -> np.float32 | None:
    """The unit near `guess` by larger and larger multiples, as rounding lets it be known."""
    half = np.spacing(exact.astype(np.float32)).astype(np.float64) / 2
    low, high = guess * (1 - 2.0**-6), guess * (1 + 2.0**-6)
    while True:
        unit = (low + high) / 2
        if unit <= 0 or exact[0] < 0.5 * unit:
            return None
        known = exact * (high - low) < 0.5 * unit * unit  # their multiple is certain
        multiples = np.maximum(np.rint(exact[known] / unit), 1)
        if not len(multiples):
            return None
        tighter_low = max(low, float(((exact - half)[known] / multiples).max()))
        tighter_high = min(high, float(((exact + half)[known] / multiples).min()))
        if tighter_low > tighter_high:
            return None
        if known.all() or tighter_high - tighter_low > 0.9 * (high - low):
            return np.float32((tighter_low + tighter_high) / 2)
        low, high = tighter_low, tighter_high


# -- bytes ------------------------------------------------------------------------------------------------


def write_values(values: Bits) -> bytes:
    """Float32 bits of finite values in order (`in_order`): unit, count, and the code of gaps and signs.

    The four bytes of the unit are 0 where there is none. Each gap is to the magnitude before, from -1 on, less one;
    each sign is 1 for the positive value, 2 for the negative, 3 for both.
    """
    from touchfield.codec.kernels import whole_numbers as kernels

    magnitudes = np.unique(values & np.uint32(_SIGN - 1))
    signs = np.isin(magnitudes, values) + 2 * np.isin(magnitudes | np.uint32(_SIGN), values)
    unit = common_unit(magnitudes.view(np.float32))
    numbers = magnitudes.astype(np.int64)
    if unit is not None:
        numbers = np.rint(magnitudes.view(np.float32).astype(np.float64) / np.float64(unit)).astype(np.int64)
    gaps = np.diff(numbers, prepend=-1) - 1
    both = np.concatenate([gaps, signs.astype(np.int64)])
    coder = kernels.number_coder(np.empty(64 * len(both) + 64, np.uint8), decoding=False)
    kernels.code_numbers(coder, both)
    place, end = coder.tail()
    data = coder.buffer[:place].tobytes() + end
    head = struct.pack("<f", unit if unit is not None else 0.0)
    return head + write_varint(len(magnitudes)) + write_varint(len(data)) + data


def read_values(data: bytes, at: int, most: int) -> tuple[Bits, int]:
    """The values that `write_values` wrote, `most` of them at most, and the offset behind.

    Raises
    ------
    TruncatedFile, CorruptFile
        If the bytes are not what it writes.
    """
    from touchfield.codec.kernels import whole_numbers as kernels

    if at + 4 > len(data):
        raise TruncatedFile(_WHERE, f"the end of the bytes at offset {len(data)}", "a unit")
    unit = np.frombuffer(data, "<f4", 1, at)[0]
    if not (unit >= 0 and np.isfinite(unit)):
        raise CorruptFile(f"{_WHERE}, unit", f"{unit}", "0 or more newtons")
    count, at = read_varint(data, at + 4, f"{_WHERE}, count", most + 1)
    size, at = read_varint(data, at, f"{_WHERE}, bytes")
    if size > len(data) - at:
        raise TruncatedFile(_WHERE, f"{len(data) - at} bytes", f"{size}")
    numbers = np.zeros(2 * count, np.int64)
    coder = kernels.number_coder(np.frombuffer(data, np.uint8, size, at).copy(), decoding=True)
    status = kernels.code_numbers(coder, numbers)
    check_end(status, coder.tail(), data[at : at + size], _WHERE)
    magnitudes, signs = np.cumsum(numbers[:count] + 1) - 1, numbers[count:]
    limit = MOST_MULTIPLE if unit > 0 else _INFINITY - 1
    if count == 0 or magnitudes[-1] > limit or signs.min() < 1 or signs.max() > 3:
        raise CorruptFile(_WHERE, "no value, one beyond all limits, or a sign that there is not", "finite values")
    bits = magnitudes.astype(np.uint32)
    if unit > 0:
        bits = _multiples(magnitudes, unit)
    negative = bits[(signs & 2) != 0][::-1] | np.uint32(_SIGN)
    values = np.concatenate([negative, bits[(signs & 1) != 0]])
    if len(values) > most:
        raise CorruptFile(_WHERE, f"{len(values)} values", f"{most} at most")
    return values, at + size


def _multiples(magnitudes: Int64s, unit: np.float32) -> Bits:
    with np.errstate(over="ignore"):
        bits = np.asarray(magnitudes.astype(np.float32) * unit, np.float32).view(np.uint32)
    if bits[-1] >= _INFINITY or (np.diff(bits.astype(np.int64)) <= 0).any():
        raise CorruptFile(f"{_WHERE}, unit", f"{unit}", "a unit whose multiples are finite and distinct")
    return bits


def read_magnitudes(data: bytes, at: int, most: int) -> tuple[Bits, int]:
    """As `read_values`, where no value may be negative."""
    values, at = read_values(data, at, most)
    if (values >= _SIGN).any():
        raise CorruptFile(_WHERE, "a negative level", "0 or more newtons")
    return values, at
