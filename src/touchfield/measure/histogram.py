"""Histograms of symbols, of one array or jointly of several: all that an entropy needs (paper section 3).

The memory is bounded by the different symbols, not by the samples: these are looked at in stretches, which for a
`numpy.memmap` are read as they are counted. 8- and 16-bit symbols, and all whose range is at most 2^22, are counted
in tables, on all cores; others are sorted, stretch after stretch, and merged.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from touchfield.arrays import Int64s
from touchfield.errors import InvalidArgument
from touchfield.measure.estimators import entropy_bits
from touchfield.measure.symbol_keys import STRETCH, SymbolKeys, checked_symbols, keys_of, stretch
from touchfield.medium.field import frozen
from touchfield.parallel import for_chunks

Counted = tuple[Int64s, Int64s]


MOST_BLOCK_CELLS = 1 << 24
"""Blocks times symbols that `block_counts` may hold: 128 MiB."""

LEAST_BLOCKS = 8

_TABLE = 1 << 22
_NOTHING = np.zeros(0, np.int64)


@dataclass(frozen=True)
class Histogram:
    """How often each symbol occurs.

    InvalidArgument if shapes, order or counts are wrong.

    Parameters
    ----------
    symbols : int64 [K]
        Strictly ascending.
    counts : int64 [K]
        At least 1 each.
    """

    symbols: Int64s
    counts: Int64s

    def __post_init__(self) -> None:
        s, c = np.asarray(self.symbols), np.asarray(self.counts)
        if s.dtype != np.int64 or c.dtype != np.int64 or s.ndim != 1 or s.shape != c.shape:
            raise InvalidArgument("Histogram", f"{s.dtype} {s.shape} and {c.dtype} {c.shape}", "int64 [K] twice")
        if (s[1:] <= s[:-1]).any():
            raise InvalidArgument("Histogram symbols", "symbols out of order or twice", "ascending order")
        _check_counts(c)
        object.__setattr__(self, "symbols", frozen(s))
        object.__setattr__(self, "counts", frozen(c))

    @classmethod
    def of(cls, samples: ArrayLike | Iterable[NDArray[Any]]) -> Histogram:
        """Count symbols.

        `samples` array of integers or booleans, any shape, size and byte order; or an iterable of such arrays: a
        list or tuple is taken for an iterable of arrays where all its items are arrays. No sample at all is an
        empty histogram. InvalidArgument if the samples are not whole numbers below 2^63.
        """
        return cls(*_merged_stream(_count_array(checked_symbols(chunk)) for chunk in _chunks(samples)))

    @property
    def total(self) -> int:
        """n, the samples."""
        return int(self.counts.sum())

    def plus(self, symbol: int, count: int) -> Histogram:
        """The histogram with `count` more of one symbol, such as the empty space that is not stored."""
        if count == 0:
            return self
        return Histogram(*merged([(self.symbols, self.counts), (np.array([symbol]), np.array([count]))]))


@dataclass(frozen=True)
class JointHistogram:
    """How often each joint symbol (x, y, ..) occurs.

    Parameters
    ----------
    symbols : int64 [K, d]
        Rows in strictly ascending order, the first column slowest.
    counts : int64 [K]
        At least 1 each.
    """

    symbols: Int64s
    counts: Int64s

    def __post_init__(self) -> None:
        s, c = np.asarray(self.symbols), np.asarray(self.counts)
        if s.dtype != np.int64 or c.dtype != np.int64 or s.ndim != 2 or c.shape != s.shape[:1] or not s.shape[1]:
            raise InvalidArgument(
                "JointHistogram", f"{s.dtype} {s.shape} and {c.dtype} {c.shape}", "int64 [K, d] and int64 [K]"
            )
        if not _rows_ascend(s):
            raise InvalidArgument("JointHistogram symbols", "rows out of order or twice", "ascending order")
        _check_counts(c)
        object.__setattr__(self, "symbols", frozen(s))
        object.__setattr__(self, "counts", frozen(c))

    @classmethod
    def of(cls, *samples: ArrayLike) -> JointHistogram:
        """Count the joint symbols of arrays of one shape, sample by sample.

        InvalidArgument if there is no array, the shapes differ, or a symbol is not a whole number below 2^63.
        """
        if not samples:
            raise InvalidArgument("samples", "no array", "at least one")
        arrays = tuple(checked_symbols(x, f"samples {i}") for i, x in enumerate(samples))
        if any(x.shape != arrays[0].shape for x in arrays):
            raise InvalidArgument("samples", f"shapes {', '.join(str(x.shape) for x in arrays)}", "one shape")
        if not arrays[0].size:
            return cls(np.zeros((0, len(arrays)), np.int64), _NOTHING)
        code = keys_of(arrays, _distinct)
        keys, counts = _count_keys(code, 0, code.count)
        return cls(code.symbols(keys), counts)

    @property
    def total(self) -> int:
        """n, the samples."""
        return int(self.counts.sum())

    def marginal(self, axes: int | Sequence[int]) -> JointHistogram:
        """The histogram of some of the columns, in the order asked for."""
        wanted = (axes,) if isinstance(axes, int) else tuple(axes)
        d = self.symbols.shape[1]
        if not wanted or any(not -d <= a < d for a in wanted):
            raise InvalidArgument("axes", f"{axes}", f"columns from {-d} to {d - 1}")
        symbols, place = np.unique(self.symbols[:, wanted], axis=0, return_inverse=True)
        counts = np.zeros(len(symbols), np.int64)
        np.add.at(counts, place.reshape(-1), self.counts)
        return JointHistogram(symbols, counts)

    def places(self, axis: int) -> Int64s:
        """Symbol of the marginal of one column that each cell has, int64 [K]: for `numpy.bincount`."""
        return np.unique(self.symbols[:, axis], return_inverse=True)[1].reshape(-1).astype(np.int64)


class SymbolCounter:
    """Counts the symbols of the support and the empty voxels, frame after frame."""

    def __init__(self) -> None:
        self._counted: Counted = (_NOTHING, _NOTHING)
        self._voxels = 0

    def add(self, symbols: ArrayLike, voxel_count: int) -> None:
        """Count one frame: the symbols of its support, whole numbers, and the number of all its voxels."""
        frame = np.unique(np.asarray(symbols, np.int64), return_counts=True)
        self._counted = merged([self._counted, frame])
        self._voxels += voxel_count

    @property
    def object_bits(self) -> float:
        """H_object, bits per supported voxel."""
        return entropy_bits(self._counted[1])

    @property
    def voxel_bits(self) -> float:
        """H_voxel, bits per voxel, the empty voxel being one more symbol."""
        counts = self._counted[1]
        return entropy_bits(np.append(counts, self._voxels - counts.sum()))


def block_counts(
    samples: ArrayLike | Sequence[ArrayLike], blocks: int, cells: Histogram | JointHistogram
) -> Int64s | None:
    """The counts of `cells` in each of some contiguous blocks of the samples in C order, for a block bootstrap.

    `samples` array, or for a `JointHistogram` a sequence of arrays of one shape: those of which `cells` is the
    histogram. `blocks`: how many are wanted. Fewer are made where 2^24 counts would not hold them, or where there
    are fewer samples. Returns int64 [B, K], or None: blocks are equal but for one sample. None where there would be
    fewer than 8. InvalidArgument if `cells` is not the histogram of the samples.
    """
    given: Any = samples if isinstance(cells, JointHistogram) else (samples,)
    arrays = tuple(checked_symbols(x) for x in given)
    n, k = arrays[0].size, len(cells.counts)
    made = min(int(blocks), n, MOST_BLOCK_CELLS // max(1, k))
    if made < LEAST_BLOCKS:
        return None
    code = None if len(arrays) == 1 and _is_small(arrays[0]) else keys_of(arrays, _distinct)
    rows = cells.symbols.reshape(k, -1)
    known = rows[:, 0] if code is None else code.numbers(list(rows.T))
    out = np.zeros((made, k), np.int64)

    def piece(begin: int, end: int) -> None:
        for b in range(begin, end):
            low, high = n * b // made, n * (b + 1) // made
            found = _count_small(arrays[0], low, high) if code is None else _count_keys(code, low, high)
            slots = np.searchsorted(known, found[0])
            out[b, np.minimum(slots, k - 1)] = found[1]

    for_chunks(piece, made)
    if not np.array_equal(out.sum(axis=0), cells.counts):
        raise InvalidArgument("cells", "a histogram of other samples", "the histogram of these samples")
    return out


# -- counting -----------------------------------------------------------------------------------------------------


def _chunks(samples: Any) -> Iterable[Any]:
    if isinstance(samples, list | tuple):
        return samples if samples and all(isinstance(s, np.ndarray) for s in samples) else (samples,)
    if hasattr(samples, "__array__") or not isinstance(samples, Iterable):
        return (samples,)
    return samples


def _count_array(x: NDArray[Any]) -> Counted:
    if not x.size:
        return _NOTHING, _NOTHING
    if _is_small(x):
        return _count_small(x, 0, x.size)
    code = keys_of((x,), _distinct)
    keys, counts = _count_keys(code, 0, code.count)
    return code.symbols(keys)[:, 0], counts


def _is_small(x: NDArray[Any]) -> bool:
    return x.dtype.itemsize <= 2


def _count_small(x: NDArray[Any], begin: int, end: int) -> Counted:
    """Symbols and counts of 8- or 16-bit samples begin .. end in C order, by a table of all that there can be."""
    from touchfield.measure.kernels.count import counts_of_8_bits, counts_of_16_bits

    wide = x.dtype.itemsize == 2
    word, count = (np.uint16, counts_of_16_bits) if wide else (np.uint8, counts_of_8_bits)
    whole = x.flags.c_contiguous and x.flags.aligned and x.dtype.isnative
    step = end - begin if whole else 4 * STRETCH
    table = np.zeros(1 << (16 if wide else 8), np.int64)
    for b in range(begin, end, max(1, step)):
        table += count(stretch(x, b, min(end, b + step)).view(word))
    seen = np.flatnonzero(table)
    native = np.int8 if x.dtype == np.bool_ else x.dtype.newbyteorder("=")
    symbols = seen.astype(word).view(native).astype(np.int64)
    order = np.argsort(symbols)
    return symbols[order], table[seen[order]]


def _count_keys(code: SymbolKeys, begin: int, end: int) -> Counted:
    """The numbers that occur among samples begin .. end, ascending, and how often each does."""
    if code.span <= _TABLE:
        table = _table(code, begin, end)
        keys = np.flatnonzero(table)
        return keys, table[keys]
    found: Counted = (_NOTHING, _NOTHING)
    for b in range(begin, end, 16 * STRETCH):  # the pieces held at once
        stop = min(end, b + 16 * STRETCH)

        def piece(first: int, last: int, offset: int = b) -> Counted:
            return merged([np.unique(k, return_counts=True) for k in code.stretches(offset + first, offset + last)])

        found = merged([found, *for_chunks(piece, stop - b, chunk=STRETCH)])
    return found


def _table(code: SymbolKeys, begin: int, end: int) -> Int64s:
    from touchfield.measure.kernels.count import add_counts

    def piece(first: int, last: int) -> Int64s:
        table = np.zeros(code.span, np.int64)
        for keys in code.stretches(begin + first, begin + last):
            add_counts(keys, table)
        return table

    total = np.zeros(code.span, np.int64)
    for part in for_chunks(piece, end - begin, chunk=max(STRETCH, 4 * code.span)):
        total += part
    return total


def _distinct(code: SymbolKeys) -> Int64s:
    return _count_keys(code, 0, code.count)[0]


def merged(parts: Sequence[Counted]) -> Counted:
    """The sum of several histograms: symbols int64 [K], ascending, and counts int64 [K]."""
    full = [p for p in parts if len(p[0])]
    if len(full) < 2:
        return full[0] if full else (_NOTHING, _NOTHING)
    symbols = np.concatenate([p[0] for p in full])
    counts = np.concatenate([p[1] for p in full])
    order = np.argsort(symbols, kind="stable")
    symbols = symbols[order]
    first = np.flatnonzero(np.concatenate([[True], symbols[1:] != symbols[:-1]]))
    return symbols[first], np.add.reduceat(counts[order], first)


def _merged_stream(parts: Iterable[Counted]) -> Counted:
    """The sum of many histograms; small ones wait until together they are as large as the sum."""
    total: Counted = (_NOTHING, _NOTHING)
    waiting: list[Counted] = []
    held = 0
    for part in parts:
        waiting.append(part)
        held += len(part[0])
        if held > max(len(total[0]), STRETCH):
            total, waiting, held = merged([total, *waiting]), [], 0
    return merged([total, *waiting])


# -- checks -------------------------------------------------------------------------------------------------------


def _check_counts(counts: Int64s) -> None:
    if len(counts) and counts.min() < 1:
        raise InvalidArgument("histogram counts", f"{counts.min()}", "at least 1 each")
    if float(counts.sum(dtype=np.float64)) >= 2.0**63:
        raise InvalidArgument("histogram counts", "2^63 samples or more", "fewer")


def _rows_ascend(rows: Int64s) -> bool:
    """True if each row comes after the one before, the first column deciding first."""
    decided = np.zeros(max(0, len(rows) - 1), np.bool_)
    for column in rows.T:
        step = (column[1:] > column[:-1]).astype(np.int8) - (column[1:] < column[:-1])
        if (step[~decided] < 0).any():
            return False
        decided |= step > 0
    return bool(decided.all())
