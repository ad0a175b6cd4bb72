"""`Counts`: how often each symbol, or each combination of symbols, occurs. All entropies are computed from
it.

Paper section 3. Counts come from arrays, from given probabilities, from quantised fields (`field_counts`) or
from a trace (`interaction_counts`). The memory is bounded by the number of different symbols, not of samples:
these are read in stretches, so that a `numpy.memmap` is read while it is counted. 8- and 16-bit symbols, and
symbols whose range is at most 2^22, are counted in tables, on all cores; others are sorted stretch by stretch
and merged. A joint symbol is the index of a cell in the box of the symbols' ranges, so that nothing is
hashed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from touchfield.arrays import Float64s, Int64s
from touchfield.compute.threads import for_chunks
from touchfield.errors import InvalidArgument
from touchfield.measure.dependence import BlockLayout
from touchfield.measure.estimators import as_array, entropy_bits
from touchfield.measure.quantity import MIN_BLOCKS
from touchfield.medium.field import frozen, numbers_of

Histogram = tuple[Int64s, Int64s]
"""Symbols or numbers of cells in ascending order, and the count of each."""

ABSENT: Final = (1 << 63) - 1
"""The symbol of a column that has no value in a cell; see `Counts.side_by_side`."""

TOLERANCE: Final = 1e-9
"""Largest deviation from 1 of the sum of given probabilities."""

BLOCKS = 64
"""Number of blocks of arrays for an interval, if there are enough samples."""

MAX_BLOCK_CELLS = 1 << 24
"""Largest number of blocks times cells for an interval: 128 MiB."""

STRETCH = 1 << 18
"""Number of samples handled at once: 2 MiB of int64."""

_TABLE = 1 << 22
_MAX_CELLS = 1 << 63
_NOTHING = np.zeros(0, np.int64)
_NO_BLOCKS = "no interval: fewer than 8 blocks, for there are too few samples or too many symbols"


@dataclass(frozen=True)
class Counts:
    """The count of each cell (symbol or joint symbol), with quantiser and weighting.

    `cells` int64 [K, d]: the symbols of d variables, rows in strictly ascending order, the first column
    slowest. `weights` int64 [K] or float64 [K]: counts of at least 1 each, or probabilities above 0 that sum
    to 1. `blocks` int64 [B, K]: the same counts in each of at least 8 blocks of neighbouring samples, from
    which intervals come; None for no interval. `layout`: how the blocks lie; None for a row. `quantiser`,
    `weighting`: Q and mu, as in `Quantity`. `variables`: their letters, ("X", "Y") for arrays, ("S", "T") for
    fields. `alphabet`: the number of possible cells, if known: no entropy of all variables exceeds its log2.
    `notes`: caveats for the reader, such as why there are no blocks.
    InvalidArgument if shapes, order or weights are wrong.
    """

    cells: Int64s
    weights: Int64s | Float64s
    blocks: Int64s | None = None
    quantiser: str = "as given"
    weighting: str = "samples"
    variables: tuple[str, ...] = ("X", "Y")
    alphabet: int | None = None
    notes: tuple[str, ...] = ()
    layout: BlockLayout | None = None

    def __post_init__(self) -> None:
        s, w = np.asarray(self.cells), np.asarray(self.weights)
        if s.dtype != np.int64 or s.ndim != 2 or w.dtype.kind not in "if" or w.shape != s.shape[:1]:
            raise InvalidArgument(
                "Counts", f"{s.dtype} {s.shape} and {w.dtype} {w.shape}", "int64 [K, d] and [K]"
            )
        if not _rows_ascend(s):
            raise InvalidArgument("Counts cells", "rows out of order or twice", "ascending order")
        if len(w) and not w.min() > 0:
            raise InvalidArgument("Counts weights", f"{w.min()}", "above 0 each")
        if float(w.sum(dtype=np.float64)) >= 2.0**63:
            raise InvalidArgument("Counts weights", "2^63 samples or more", "fewer")
        object.__setattr__(self, "cells", frozen(s))
        object.__setattr__(self, "weights", frozen(w))

    @classmethod
    def of(cls, *samples: ArrayLike, blocks: int = 0) -> Counts:
        """Count the (joint) symbols of arrays of one shape, sample by sample.

        `samples`: integers or booleans of any shape, size and byte order. `blocks`: number of contiguous
        blocks of the samples in C order, 0 for none. There are fewer blocks if their counts would exceed 2^24
        numbers or there are fewer samples, and none, with a note, if there would be fewer than 8.
        InvalidArgument if there is no array, the shapes differ, or a symbol is not a whole number below 2^63.
        """
        if not samples:
            raise InvalidArgument("samples", "no array", "at least one")
        arrays = tuple(checked_symbols(x, f"samples {i}" if i else "samples") for i, x in enumerate(samples))
        if any(x.shape != arrays[0].shape for x in arrays):
            raise InvalidArgument("samples", f"shapes {', '.join(str(x.shape) for x in arrays)}", "one shape")
        d, n = len(arrays), arrays[0].size
        names = ("X", "Y") if d <= 2 else tuple(f"X{i + 1}" for i in range(d))
        if not n:
            return cls(np.zeros((0, d), np.int64), _NOTHING, variables=names)
        keys = None if d == 1 and arrays[0].dtype.itemsize <= 2 else _Keys.of(arrays)
        count = partial(_count_small, arrays[0]) if keys is None else partial(_count_keys, keys)
        numbers, counts = count(0, n)
        table = _blocks(count, n, numbers, blocks)
        cells = numbers[:, None] if keys is None else keys.symbols(numbers)
        return cls(
            cells, counts, table, variables=names, notes=(_NO_BLOCKS,) if blocks and table is None else ()
        )

    @classmethod
    def of_stream(cls, parts: Iterable[NDArray[Any]]) -> Counts:
        """Count the symbols of a stream of arrays; none is kept after it is counted."""
        total: Histogram = (_NOTHING, _NOTHING)
        waiting: list[Histogram] = []  # histograms are merged once together they are larger than the total
        for part in parts:
            part_counts = cls.of(part)
            waiting.append((part_counts.cells[:, 0], np.asarray(part_counts.weights, np.int64)))
            if sum(len(w[0]) for w in waiting) > max(len(total[0]), STRETCH):
                total, waiting = merged([total, *waiting]), []
        symbols, counts = merged([total, *waiting])
        return cls(symbols[:, None], counts, notes=("no interval: the order of the samples is not known",))

    @classmethod
    def of_probabilities(cls, table: ArrayLike) -> Counts:
        """Given probabilities, one axis for each variable; all their quantities are exact.

        InvalidArgument if one is negative or NaN, there is none, or they do not sum to 1 within 1e-9.
        """
        p = numbers_of("table", table)
        if not p.size or p.ndim == 0:
            raise InvalidArgument("table", f"shape {p.shape}", "at least one probability")
        if not (p >= 0).all():
            found = "NaN" if np.isnan(p).any() else f"the probability {p.min():.6g}"
            raise InvalidArgument("table", found, "probabilities from 0 to 1")
        total = float(p.sum())
        if not abs(total - 1) <= TOLERANCE:
            raise InvalidArgument(
                "table", f"a sum of {total:.12g}", f"1 within {TOLERANCE:g}", "Divide counts by their sum."
            )
        names = ("X", "Y") if p.ndim <= 2 else tuple(f"X{i + 1}" for i in range(p.ndim))
        return cls(np.argwhere(p > 0).astype(np.int64), p[p > 0] / total, variables=names)

    @classmethod
    def side_by_side(cls, first: Counts, second: Counts) -> Counts:
        """Combine two separately sampled variables.

        Each is `ABSENT` in the cells of the other, for `jensen_shannon_distance`. Block b of one is left out
        together with block b of the other, which is right for paired samples and for independent ones.
        InvalidArgument if one of them is empty.
        """
        if not (len(first.cells) and len(second.cells)):
            raise InvalidArgument("samples", "no sample", "at least one of each")
        pairs = [np.insert(c.cells, [column], ABSENT, axis=1) for c, column in ((first, 1), (second, 0))]
        weights = np.concatenate([first.weights, second.weights])
        a, b = first.blocks, second.blocks
        blocks = None if a is None or b is None or len(a) != len(b) else np.concatenate([a, b], axis=1)
        notes = tuple(dict.fromkeys((*first.notes, *second.notes)))
        if blocks is None and not notes and (a is not None or b is not None):
            notes = ("no interval: blocks of one do not match those of the other",)
        return cls(
            np.concatenate(pairs), weights, blocks, first.quantiser, first.weighting, notes=notes,
            layout=None if blocks is None else first.layout,
        )  # fmt: skip

    @property
    def total(self) -> int:
        """n, the number of samples; 0 for given probabilities."""
        return int(self.weights.sum()) if self.weights.dtype.kind == "i" else 0


class SymbolCounter:
    """Counter of the symbols of the support and of the empty voxels, over frames."""

    def __init__(self) -> None:
        self._counted: Histogram = (_NOTHING, _NOTHING)
        self._voxels = 0

    def add(self, symbols: ArrayLike, voxel_count: int) -> None:
        """Count one frame.

        `symbols`: those of its support, whole numbers. `voxel_count`: number of all its voxels.
        """
        self._counted = merged([self._counted, np.unique(np.asarray(symbols, np.int64), return_counts=True)])
        self._voxels += voxel_count

    @property
    def object_bits(self) -> float:
        """H_object, bits per supported voxel."""
        return entropy_bits(self._counted[1])

    @property
    def voxel_bits(self) -> float:
        """H_voxel, bits per voxel; the empty voxel is one more symbol."""
        counts = self._counted[1]
        return entropy_bits(np.append(counts, self._voxels - counts.sum()))


def merged(parts: Sequence[Histogram]) -> Histogram:
    """Add several histograms."""
    full = [p for p in parts if len(p[0])]
    if len(full) < 2:
        return full[0] if full else (_NOTHING, _NOTHING)
    symbols = np.concatenate([p[0] for p in full])
    counts = np.concatenate([p[1] for p in full])
    order = np.argsort(symbols, kind="stable")
    symbols = symbols[order]
    first = np.flatnonzero(np.concatenate([[True], symbols[1:] != symbols[:-1]]))
    return symbols[first], np.add.reduceat(counts[order], first)


def checked_symbols(samples: ArrayLike, where: str = "samples") -> NDArray[Any]:
    """Return `samples` as an array of whole numbers, without a copy if it is one.

    InvalidArgument if they are not whole numbers, or ragged lists. Floats are rejected even if whole, because
    they are seldom meant as symbols.
    """
    x = as_array(samples, where)
    if x.dtype.kind in "biu":
        return x
    if not x.size and not hasattr(samples, "dtype"):  # an empty list
        return x.astype(np.int64)
    found = f"values of type {x.dtype}"
    if x.dtype.kind == "f" and np.isnan(x.ravel()[: 1 << 16]).any():
        found += ", NaN among them"
    raise InvalidArgument(where, found, "symbols: integers or booleans", "Quantise them first.")


# -- counting ----------------------------------------------------------------------------------------------


def _stretch(x: NDArray[Any], start: int, stop: int) -> NDArray[Any]:
    """Samples `start` to `stop` of an array in C order.

    Contiguous, in the byte order of this machine.
    """
    part = x.reshape(-1)[start:stop] if x.flags.c_contiguous else x.flat[start:stop]
    native: NDArray[Any] = np.require(part, part.dtype.newbyteorder("="), ("C", "A"))
    return native


@dataclass(frozen=True)
class _Keys:
    """The samples of d arrays of one shape as numbers 0 .. span - 1.

    The numbers have the order of the symbols. `columns`: for each array its lowest symbol, the width of its
    range, and, if that is too large, its sorted symbols, whose ranks are then used.
    """

    arrays: tuple[NDArray[Any], ...]
    columns: tuple[tuple[int, int, Int64s | None], ...]
    span: int

    @classmethod
    def of(cls, arrays: tuple[NDArray[Any], ...]) -> _Keys:
        columns: list[tuple[int, int, Int64s | None]] = []
        for low, high in map(_range, arrays):
            columns.append((low, high - low + 1, None))
        if math.prod(width for _, width, _ in columns) >= _MAX_CELLS:
            ranks = [_sorted(partial(_stretch_int64, x), 0, x.size)[0] for x in arrays]
            columns = [(0, len(symbols), symbols) for symbols in ranks]
        span = math.prod(width for _, width, _ in columns)
        if span >= _MAX_CELLS:
            raise InvalidArgument("samples", f"{span} joint symbols that there could be", "fewer than 2^63")
        return cls(arrays, tuple(columns), span)

    def numbers(self, start: int, stop: int) -> Int64s:
        """Numbers of the samples `start` to `stop` in C order, int64."""
        total: Int64s | None = None
        for x, (low, width, by_rank) in zip(self.arrays, self.columns, strict=True):
            s = _stretch_int64(x, start, stop)
            code = s - low if by_rank is None else np.searchsorted(by_rank, s)
            total = code if total is None else total * width + code
        assert total is not None
        return total

    def symbols(self, numbers: Int64s) -> Int64s:
        """The symbols of numbers [K], int64 [K, d]."""
        out = np.empty((len(numbers), len(self.columns)), np.int64)
        rest = numbers
        for j, (low, width, by_rank) in reversed(list(enumerate(self.columns))):
            rest, code = np.divmod(rest, width)
            out[:, j] = code + low if by_rank is None else by_rank[code]
        return out


def _stretch_int64(x: NDArray[Any], start: int, stop: int) -> Int64s:
    return _stretch(x, start, stop).astype(np.int64, copy=False)


def _range(x: NDArray[Any]) -> tuple[int, int]:
    if x.dtype.kind == "b":
        return 0, 1

    def piece(start: int, stop: int) -> list[int]:
        extremes = []
        for b in range(start, stop, STRETCH):
            part = _stretch(x, b, min(stop, b + STRETCH))
            extremes += [int(part.min()), int(part.max())]
        return extremes

    extremes = [n for part in for_chunks(piece, x.size, chunk=STRETCH) for n in part]
    if max(extremes) >= _MAX_CELLS:
        raise InvalidArgument("samples", f"the symbol {max(extremes)}", "symbols below 2^63")
    return min(extremes), max(extremes)


def _count_small(x: NDArray[Any], start: int, stop: int) -> Histogram:
    """Symbols and counts of 8- or 16-bit samples, by a table of all possible symbols.

    The samples are those from `start` to `stop` in C order.
    """
    from touchfield.measure.kernels import counts_of_8_bits, counts_of_16_bits

    wide = x.dtype.itemsize == 2
    word, count = (np.uint16, counts_of_16_bits) if wide else (np.uint8, counts_of_8_bits)
    is_viewable = x.flags.c_contiguous and x.flags.aligned and x.dtype.isnative
    step = stop - start if is_viewable else 4 * STRETCH
    table = np.zeros(1 << (16 if wide else 8), np.int64)
    for b in range(start, stop, max(1, step)):
        table += count(_stretch(x, b, min(stop, b + step)).view(word))
    occurring = np.flatnonzero(table)
    native = np.int8 if x.dtype == np.bool_ else x.dtype.newbyteorder("=")
    symbols = occurring.astype(word).view(native).astype(np.int64)
    order = np.argsort(symbols)
    return symbols[order], table[occurring[order]]


def _count_keys(keys: _Keys, start: int, stop: int) -> Histogram:
    """The numbers that occur among samples, ascending, and the count of each.

    The samples are those from `start` to `stop` in C order.
    """
    from touchfield.measure.kernels import add_counts

    if keys.span > _TABLE:
        return _sorted(keys.numbers, start, stop)

    def piece(first: int, last: int) -> Int64s:
        table = np.zeros(keys.span, np.int64)
        for b in range(first, last, STRETCH):
            add_counts(keys.numbers(start + b, start + min(last, b + STRETCH)), table)
        return table

    total = sum(
        for_chunks(piece, stop - start, chunk=max(STRETCH, 4 * keys.span)), np.zeros(keys.span, np.int64)
    )
    occurring = np.flatnonzero(total)
    return occurring, total[occurring]


def _sorted(read: Callable[[int, int], Int64s], start: int, stop: int) -> Histogram:
    """Distinct numbers from `start` to `stop` and their counts, read in bounded parts."""

    def piece(first: int, last: int, offset: int) -> Histogram:
        starts = range(offset + first, offset + last, STRETCH)
        return merged(
            [np.unique(read(b, min(offset + last, b + STRETCH)), return_counts=True) for b in starts]
        )

    total: Histogram = (_NOTHING, _NOTHING)
    for b in range(start, stop, 16 * STRETCH):
        total = merged([total, *for_chunks(piece, min(stop - b, 16 * STRETCH), b, chunk=STRETCH)])
    return total


def _blocks(count: Callable[[int, int], Histogram], n: int, symbols: Int64s, requested: int) -> Int64s | None:
    """Return the counts of the numbers in contiguous blocks, int64 [B, K].

    Blocks have (nearly) equal length. None if there would be fewer than 8.
    """
    blocks = min(int(requested), n, MAX_BLOCK_CELLS // max(1, len(symbols)))
    if blocks < MIN_BLOCKS:
        return None
    out = np.zeros((blocks, len(symbols)), np.int64)

    def piece(start: int, stop: int) -> None:
        for b in range(start, stop):
            numbers, times = count(n * b // blocks, n * (b + 1) // blocks)
            out[b, np.searchsorted(symbols, numbers)] = times

    for_chunks(piece, blocks)
    return out


def _rows_ascend(rows: Int64s) -> bool:
    """True if each row comes after the one before, compared column by column."""
    decided = np.zeros(max(0, len(rows) - 1), np.bool_)
    for column in rows.T:
        if (~decided & (column[1:] < column[:-1])).any():
            return False
        decided |= column[1:] > column[:-1]
    return bool(decided.all())
