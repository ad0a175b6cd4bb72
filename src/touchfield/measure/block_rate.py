"""Block entropies H(B_k) and rates h_k = H(B_k) - H(B_{k-1}) (theory section 5; Cover and Thomas, section 4.2).

h_k estimates the entropy rate from above: for a stationary source it never increases with k. So that this holds for
what was counted, too, and exactly, a sequence (each scan line of a field) is closed to a ring: every sample then
begins one block, and the blocks of k - 1 are the marginal of the blocks of k. The price is k - 1 blocks to a
sequence that run over its end. The plug-in estimate falls below the truth where there are too few blocks of a kind;
a note says so. Memory: the longest blocks are counted exactly, by the different ones that are there. Time: one pass
over a sequence; of a field, over what lies within a block of the bricks that hold a symbol but 0, whatever the
lattice: all other blocks are of nothing but 0 and cost nothing.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.measure.causal import checked_symbols, frames_of
from touchfield.measure.cells import CellCounter
from touchfield.measure.estimators import estimate_bits
from touchfield.measure.quantity import FewSamplesWarning, Quantity
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.measure.field_symbols import FieldSymbols

__all__ = ["BlockCounter", "BlockRates", "block_rates", "scan_line_rates"]

MOST_IN_BLOCK = 64
_SAMPLES_AT_ONCE = 1 << 18
_TILE_SAMPLES = 1 << 20  # samples of scan lines laid out at once


@dataclass(frozen=True)
class BlockRates:
    """H(B_k) and h_k for k = 1 .. longest.

    Attributes
    ----------
    entropies : tuple of Quantity
        H(B_k), bit.
    rates : tuple of Quantity
        h_k, bit/sample; the first is H(S).
    """

    entropies: tuple[Quantity, ...]
    rates: tuple[Quantity, ...]

    def summary(self) -> dict[str, Any]:
        """Plain values under stable keys."""
        return {"entropies": [q.summary() for q in self.entropies], "rates": [q.summary() for q in self.rates]}


class BlockCounter:
    """Counts the blocks of `longest` symbols of rings.

    Parameters
    ----------
    alphabet : int
        Symbols are below it.
    longest : int
        1 to 64, at most the length of the shortest ring.
    """

    def __init__(self, alphabet: int, longest: int) -> None:
        if not (isinstance(longest, int | np.integer) and 1 <= longest <= MOST_IN_BLOCK):
            raise InvalidArgument("longest", repr(longest), f"a whole number from 1 to {MOST_IN_BLOCK}")
        self.longest, self._bits = int(longest), max(1, (alphabet - 1).bit_length())
        self._cells = CellCounter(self.longest, self._bits)

    def add_lines(self, lines: NDArray[Any]) -> None:
        """Count the blocks of rings, int [m, n]."""
        count, length = lines.shape
        if self.longest > length:
            raise InvalidArgument(
                "longest", f"blocks of {self.longest} in a line of {length} samples", f"1 to {length}"
            )
        rows_at_once = max(1, _SAMPLES_AT_ONCE // length)
        for row in range(0, count, rows_at_once):
            for begin in range(0, length, _SAMPLES_AT_ONCE):
                end = min(length, begin + _SAMPLES_AT_ONCE)
                places = np.arange(begin, end + self.longest - 1) % length
                some = lines[row : row + rows_at_once, places]
                self._cells.add_zeros(len(some) * (end - begin) - self._add_windows(some, end - begin))

    def _add_windows(self, lines: NDArray[Any], begins: int) -> int:
        """Count the blocks that begin at the first samples of lines and are not all 0; how many there are."""
        per_word = 64 // self._bits
        rows = np.zeros((len(lines), begins, self._cells.words), np.uint64)
        for k in range(self.longest):
            shift = np.uint64(k % per_word * self._bits)
            rows[:, :, k // per_word] |= lines[:, k : k + begins].astype(np.uint64) << shift
        flat = rows.reshape(-1, self._cells.words)
        held = np.ascontiguousarray(flat[flat.any(axis=1)])
        self._cells.add(held)
        return len(held)

    def add_field(self, frame: FieldSymbols, axis: int) -> None:
        """Count the blocks of the scan lines of a sparse frame along an axis; empty space in closed form."""
        if self.longest > frame.grid.shape[axis]:
            raise InvalidArgument(
                "longest", f"blocks of {self.longest} along an axis of {frame.grid.shape[axis]} samples",
                f"1 to {frame.grid.shape[axis]}",
            )  # fmt: skip
        counted = 0
        for lines in _scan_lines(frame, axis, self.longest):
            held = lines[lines.any(axis=1)]
            rows_at_once = max(1, _SAMPLES_AT_ONCE // lines.shape[1])
            for row in range(0, len(held), rows_at_once):
                counted += self._add_windows(held[row : row + rows_at_once], lines.shape[1] - self.longest + 1)
        self._cells.add_zeros(frame.voxel_count - counted)

    def result(self, estimator: str = "plug-in") -> BlockRates:
        """H(B_k) and h_k of what was counted; each entropy by the named estimator."""
        entropies: list[Quantity] = []
        rates: list[Quantity] = []
        before = 0.0
        for k in range(1, self.longest + 1):
            blocks = self._cells.marginal(tuple(range(k)))
            counts, n = blocks.counts(), blocks.samples
            bits = estimate_bits(counts, estimator)
            informed = n - blocks.zeros
            notes: tuple[str, ...] = ()
            if informed < 10 * len(counts):
                notes = (f"{informed} blocks not all 0 for {len(counts)} kinds, fewer than ten each; too low",)
            of = Quantity(f"H(B_{k})", bits, "bit", "as given", "samples", estimator, n, len(counts), None, notes)
            rate = max(0.0, bits - before) if estimator == "plug-in" else bits - before
            entropies.append(of)
            rates.append(of.of(name=f"h_{k}", value=rate, unit="bit/sample"))
            before = bits
        return BlockRates(tuple(entropies), tuple(rates))


def _scan_lines(frame: FieldSymbols, axis: int, longest: int) -> Iterator[NDArray[np.int32]]:
    """Pieces of the lines along an axis, int32 [m, b + longest - 1], some at a time.

    The first b samples of each piece are those of a brick; any block of the lines that is not all 0 begins at one of
    them, and at one only.
    """
    length = frame.grid.shape[axis]
    bricks = _begins(frame, axis, longest)
    last = bricks[:, axis] == frame.grid.brick_shape[axis] - 1
    of_last = length - (frame.grid.brick_shape[axis] - 1) * BRICK
    for some, begins in ((bricks[~last], BRICK), (bricks[last], of_last)):
        width = begins + longest - 1
        at_once = max(1, _TILE_SAMPLES // (BRICK * BRICK * width))
        for start in range(0, len(some), at_once):
            yield _lines_from(frame, axis, some[start : start + at_once], width)


def _begins(frame: FieldSymbols, axis: int, longest: int) -> NDArray[np.int64]:
    """The bricks at whose samples blocks begin that reach a symbol but 0, each once, int64 [n, 3]."""
    grid = frame.grid
    held = frame.bricks[frame.symbols.any(axis=(1, 2, 3))].astype(np.int64)
    there = np.repeat(held[:, None], longest, axis=1)
    # the first samples of blocks that end with the first of a brick, or later in it; lines are rings
    there[:, :, axis] = (held[:, None, axis] * BRICK - np.arange(longest)) % grid.shape[axis] // BRICK
    keys = np.unique(brick_keys(grid, there.reshape(-1, 3)))
    return np.stack(np.unravel_index(keys, grid.brick_shape), axis=1).astype(np.int64)


def _lines_from(frame: FieldSymbols, axis: int, bricks: NDArray[np.int64], width: int) -> NDArray[np.int32]:
    """The 64 lines along an axis from each of some bricks on, int32 [n * 64, width], closed to rings."""
    grid = frame.grid
    keys = brick_keys(grid, frame.bricks)
    symbols = np.moveaxis(frame.symbols, axis + 1, 1)
    lines = np.zeros((len(bricks), BRICK, BRICK, width), np.int32)
    there = bricks.copy()
    for i in range(width):
        sample = (bricks[:, axis] * BRICK + i) % grid.shape[axis]
        there[:, axis] = sample // BRICK
        wanted = brick_keys(grid, there)
        slot = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        found = keys[slot] == wanted
        lines[found, :, :, i] = symbols[slot[found], sample[found] % BRICK]
    return lines.reshape(-1, width)


def block_rates(x: Any, longest: int = 4, *, estimator: str = "plug-in") -> BlockRates:
    """Block entropies and rates of a sequence.

    Parameters
    ----------
    x : int array [n], or [m, n]
        Symbols from 0 on; of two axes, m sequences, no block running from one into the next.
    longest : int
        The longest block, 1 to 64 and at most n.
    estimator : str
        Of each H(B_k), one of `ESTIMATORS`. Only the plug-in keeps h_k from rising.

    Returns
    -------
    BlockRates

    Raises
    ------
    InvalidArgument
        For values that are not symbols, or blocks longer than the sequence.

    Warns
    -----
    FewSamplesWarning
        If there are fewer than ten blocks to each that was seen.

    Examples
    --------
    >>> [round(h.value, 6) for h in block_rates([0, 1] * 500, 3).rates]
    [1.0, 0.0, 0.0]
    """
    lines = checked_symbols("x", x, (1, 2))
    counter = BlockCounter(int(lines.max()) + 1, longest)
    counter.add_lines(lines.reshape(-1, lines.shape[-1]))
    return _warned(counter.result(estimator))


def scan_line_rates(frames: Any, longest: int = 4, *, axis: int = 2, estimator: str = "plug-in") -> BlockRates:
    """Block entropies and rates of the scan lines of quantised fields, over all voxels.

    Parameters
    ----------
    frames : FieldSymbols, or an iterable of them
        Of one grid and one Q.
    longest : int
        The longest block, at most the samples along the axis.
    axis : {0, 1, 2}
        Along which the lines run.
    estimator : str

    Returns
    -------
    BlockRates

    Raises
    ------
    InvalidArgument
        If frames differ in grid or Q, the axis does not exist, or the blocks are longer than a line.
    """
    if axis not in (0, 1, 2):
        raise InvalidArgument("axis", repr(axis), "0, 1 or 2")
    counter, quantiser = None, ""
    for frame in frames_of(frames):
        counter = counter or BlockCounter(frame.alphabet, longest)
        counter.add_field(frame, axis)
        quantiser = frame.quantiser
    assert counter is not None  # frames_of refuses none
    return _warned(over_voxels(counter.result(estimator), quantiser))


def over_voxels(found: BlockRates, quantiser: str) -> BlockRates:
    """The same with Q and mu named."""

    def named(all_of: tuple[Quantity, ...]) -> tuple[Quantity, ...]:
        return tuple(q.of(quantiser=quantiser, weighting="voxel") for q in all_of)

    return BlockRates(named(found.entropies), named(found.rates))


def _warned(found: BlockRates) -> BlockRates:
    few = [q for q in found.rates if q.notes]
    if few:
        warnings.warn(f"{few[0].name} to {few[-1].name}: {few[-1].notes[0]}", FewSamplesWarning, stacklevel=3)
    return found
