"""Samples of one or several symbol arrays as one number each, a stretch at a time.

A joint symbol (x, y, ..) is the number of a cell in the box of the symbols' ranges, where that box has fewer than
2^63 cells. Where it has more, what came before is replaced by its rank among what really occurs, which costs one
more pass and the memory of the different symbols. Nothing is hashed: different symbols never share a number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from touchfield.arrays import Int64s
from touchfield.errors import InvalidArgument
from touchfield.parallel import for_chunks

STRETCH = 1 << 18
"""Samples handled at once: 2 MiB of int64."""

_MOST = 1 << 63


def as_array(values: ArrayLike, where: str) -> NDArray[Any]:
    """`values` as an array, not copied where it is one already.

    InvalidArgument if it is a list of lists that differ in length.
    """
    try:
        return np.asarray(values)
    except ValueError:
        raise InvalidArgument(where, "lists that differ in length or depth", "an array, or lists alike") from None


def checked_symbols(samples: ArrayLike, where: str = "samples") -> NDArray[Any]:
    """`samples` as an array of whole numbers, not copied where it is one already.

    InvalidArgument if they are not whole numbers, or lists that differ in length; floats are refused even where
    whole, for they are seldom meant as symbols.
    """
    x = as_array(samples, where)
    if x.dtype.kind in "biu":
        return x
    if not x.size and not hasattr(samples, "dtype"):  # an empty list
        return x.astype(np.int64)
    found = f"values of type {x.dtype}"
    if x.dtype.kind == "f":
        found += ", NaN among them" if np.isnan(x.ravel()[: 1 << 16]).any() else ""
        raise InvalidArgument(where, found, "symbols: integers or booleans", "Quantise them first.")
    raise InvalidArgument(where, found, "symbols: integers or booleans")


def stretch(x: NDArray[Any], begin: int, end: int) -> NDArray[Any]:
    """Samples begin .. end of an array in C order, contiguous, in this machine's byte order."""
    part = x.reshape(-1)[begin:end] if x.flags.c_contiguous else x.flat[begin:end]
    native: NDArray[Any] = np.require(part, part.dtype.newbyteorder("="), ("C", "A"))
    return native


def _range(x: NDArray[Any], where: str) -> tuple[int, int]:
    if x.dtype.kind == "b":
        return 0, 1

    def piece(begin: int, end: int) -> tuple[int, int]:
        low, high = [], []
        for b in range(begin, end, STRETCH):
            part = stretch(x, b, min(end, b + STRETCH))
            low.append(int(part.min()))
            high.append(int(part.max()))
        return min(low), max(high)

    found = for_chunks(piece, x.size, chunk=STRETCH)
    least, most = min(f[0] for f in found), max(f[1] for f in found)
    if most >= _MOST:
        raise InvalidArgument(where, f"the symbol {most}", "symbols below 2^63")
    return least, most


@dataclass(frozen=True)
class _Column:
    array: NDArray[Any]
    low: int
    span: int
    known: Int64s | None  # symbols by rank, where the range is too wide
    before: Int64s | None  # the keys of the columns before by rank, where they are too many

    def codes(self, symbols: NDArray[Any]) -> Int64s:
        s = symbols.astype(np.int64, copy=False)
        return s - self.low if self.known is None else np.searchsorted(self.known, s)

    def symbols(self, codes: Int64s) -> Int64s:
        found: Int64s = codes + self.low if self.known is None else self.known[codes]
        return found


@dataclass(frozen=True)
class SymbolKeys:
    """The samples of d arrays of one shape as numbers 0 .. span - 1, in the order of the symbols.

    `columns`: how each array enters. `span`: below 2^63. `count`: n, samples of each array.
    """

    columns: tuple[_Column, ...]
    span: int
    count: int

    def keys(self, begin: int, end: int) -> Int64s:
        """The numbers of samples begin .. end in C order, int64."""
        return self.numbers([stretch(column.array, begin, end) for column in self.columns])

    def numbers(self, symbols: Sequence[NDArray[Any]]) -> Int64s:
        """The numbers, int64 [m], of joint symbols given column by column, each [m]."""
        total = self.columns[0].codes(symbols[0])
        for column, some in zip(self.columns[1:], symbols[1:], strict=True):
            if column.before is not None:
                total = np.searchsorted(column.before, total)
            total = total * column.span + column.codes(some)
        return total

    def stretches(self, begin: int, end: int) -> Iterator[Int64s]:
        """The numbers of samples begin .. end, at most `STRETCH` at a time."""
        for b in range(begin, end, STRETCH):
            yield self.keys(b, min(end, b + STRETCH))

    def symbols(self, keys: Int64s) -> Int64s:
        """The symbols of numbers [K], int64 [K, d]."""
        out = np.empty((len(keys), len(self.columns)), np.int64)
        rest = keys
        for j in range(len(self.columns) - 1, -1, -1):
            column = self.columns[j]
            code = rest
            if j:
                rest, code = np.divmod(rest, column.span)
                if column.before is not None:
                    rest = column.before[rest]
            out[:, j] = column.symbols(code)
        return out


Distinct = Callable[[SymbolKeys], "Int64s"]
"""The different numbers that occur, ascending."""


def keys_of(arrays: tuple[NDArray[Any], ...], distinct: Distinct) -> SymbolKeys:
    """How to number the joint symbols of `arrays`, all of one shape and not empty.

    InvalidArgument if the shapes differ, a symbol is 2^63 or more, or n times a range is.
    """
    if any(x.shape != arrays[0].shape for x in arrays):
        shapes = ", ".join(str(x.shape) for x in arrays)
        raise InvalidArgument("samples", f"shapes {shapes}", "one shape")
    made = SymbolKeys((), 1, arrays[0].size)
    for number, x in enumerate(arrays):
        low, high = _range(x, f"samples {number}" if len(arrays) > 1 else "samples")
        span, known, before = high - low + 1, None, None
        if span >= _MOST or (made.columns and made.span * span >= _MOST):
            known = _distinct_symbols(x, distinct)
            low, span = 0, len(known)
        if made.columns and made.span * span >= _MOST:
            before = distinct(made)
            made = SymbolKeys(made.columns, len(before), made.count)
            if made.span * span >= _MOST:
                raise InvalidArgument("samples", f"{made.span} x {span} joint symbols", "fewer than 2^63")
        made = SymbolKeys((*made.columns, _Column(x, low, span, known, before)), made.span * span, made.count)
    return made


def _distinct_symbols(x: NDArray[Any], distinct: Distinct) -> Int64s:
    """The different symbols of one array, as themselves."""
    return distinct(SymbolKeys((_Column(x, 0, _MOST, None, None),), _MOST, x.size))
