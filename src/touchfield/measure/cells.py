"""Exact counts of joint cells: equal rows of several symbols (paper section 3, H(X, Y) for more than two).

Conditioning on seven neighbours makes cells of nine symbols, far too many for a table indexed by the symbols. Rows
are kept in a hash table that compares whole keys, so that no two cells are ever taken for one. Time is linear in the
rows; memory is 8 bytes for each word of a cell, 8 for its count and 4 to 8 for its slot, times two where the table
grows: by the cells that are there, and by nothing else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.medium.budget import memory_budget_bytes

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["CellCounter"]

_FIRST_KEYS = 1 << 12
_MOST_KEYS = 1 << 30


class CellCounter:
    """Counts rows of `columns` symbols, packed as the kernels pack them.

    Parameters
    ----------
    columns : int
        Symbols to a row.
    bits : int
        Bits to a symbol, at most 32.
    """

    def __init__(self, columns: int, bits: int) -> None:
        self.columns, self.bits = columns, bits
        self._per_word = 64 // bits
        self.words = -(-columns // self._per_word)
        self.zeros = 0
        self._used = 0
        self._allocate(_FIRST_KEYS)

    def _allocate(self, size: int) -> None:
        needed = size * (8 * self.words + 16)
        if size > _MOST_KEYS or needed > memory_budget_bytes() // 2:
            raise InvalidArgument(
                "joint cells", f"more than {size // 2} different ones", f"up to {memory_budget_bytes() // 2} bytes",
                "Give fewer frames or a coarser quantiser, or set TOUCHFIELD_MEMORY_GIB.",
            )  # fmt: skip
        self._slots = np.full(2 * size, -1, np.int32)
        self._keys = np.zeros((size, self.words), np.uint64)
        self._counts = np.zeros(size, np.int64)

    def add(self, rows: NDArray[np.uint64], weights: NDArray[np.int64] | None = None) -> None:
        """Count rows, uint64 [n, words], each once or as often as its weight says."""
        from touchfield.measure.kernels.context import insert

        times = np.zeros(0, np.int64) if weights is None else weights
        done = 0
        while True:
            done, self._used = insert(rows, times, done, (self._slots, self._keys, self._counts), self._used)
            if done == len(rows):
                return
            keys, counts = self._keys[: self._used], self._counts[: self._used]
            self._allocate(2 * len(self._keys))
            _, self._used = insert(keys, counts, 0, (self._slots, self._keys, self._counts), 0)

    def add_zeros(self, count: int) -> None:
        """Count so many rows of nothing but 0, in closed form."""
        self.zeros += count

    @property
    def samples(self) -> int:
        """n, the rows counted."""
        return int(self._counts[: self._used].sum()) + self.zeros

    def counts(self, columns: tuple[int, ...] | None = None) -> NDArray[np.int64]:
        """How often each cell was counted, int64 [K]; of the marginal of some columns if they are named."""
        found = self if columns is None else self.marginal(columns)
        counts = found._counts[: found._used]
        return np.append(counts, found.zeros) if found.zeros else counts.copy()

    def marginal(self, columns: tuple[int, ...]) -> CellCounter:
        """The counter of some columns alone; the others read 0."""
        mask = np.zeros(self.words, np.uint64)
        for c in columns:
            mask[c // self._per_word] |= np.uint64(((1 << self.bits) - 1) << (c % self._per_word * self.bits))
        out = CellCounter(self.columns, self.bits)
        rows, weights = self._keys[: self._used] & mask, self._counts[: self._used]
        empty = ~rows.any(axis=1)
        out.add(rows[~empty], weights[~empty])
        out.add_zeros(self.zeros + int(weights[empty].sum()))
        return out
