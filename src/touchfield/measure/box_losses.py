"""Bits that a device leaves out when it is filled by a dyadic box of the workspace (paper section 4).

The workspace is sampled on a fine lattice of n_dev 2^D samples along each axis. A box of depth d is one of 2^d along
each axis; filled with the device's own lattice of n_dev samples it is sampled every r = 2^(D-d) fine samples: one
symbol K for each cell of r^3 fine ones. Of a fine sample S a receiver that is told K of its cell still lacks H(S|K).
The loss of a box is that for all its fine samples,

    L = n H(S|K) = sum_k [T_k log2 T_k - sum_s c_ks log2 c_ks],

the plug-in estimate from the counts c_ks of the box in all frames, T_k being their sums; bits a frame. It is zero at
depth D, where S = K, and where a box is empty. It counts the samples of a cell each by itself, and is thus at least
what the whole cell lacks.

The estimate is low where a box holds few samples to a symbol K, and the more so the finer Q is: take a coarse one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.medium.grid import BRICK, Grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int64s = NDArray[np.int64]
    Float64s = NDArray[np.float64]

__all__ = ["BoxLosses", "DyadicLattice"]

MOST_DEPTH = 7
"""2^21 boxes."""


@dataclass(frozen=True)
class DyadicLattice:
    """A fine lattice and how a device's lattice divides it.

    Parameters
    ----------
    grid : Grid
        The fine lattice over the workspace.
    device_shape : (int, int, int)
        Samples of the device along each axis. An axis with as many samples as the grid is not split; along all others
        the grid has 2^D as many, with one D.

    Raises
    ------
    InvalidArgument
        If the grid is not such a multiple, or D is greater than 7.
    """

    grid: Grid
    device_shape: tuple[int, int, int]

    def __post_init__(self) -> None:
        shape = tuple(int(n) for n in self.device_shape)
        if len(shape) != 3 or min(shape) < 1:
            raise InvalidArgument("device_shape", repr(self.device_shape), "three counts of at least 1")
        object.__setattr__(self, "device_shape", shape)
        split = {n // m for n, m in zip(self.grid.shape, shape, strict=True) if n != m}
        whole = all(n % m == 0 for n, m in zip(self.grid.shape, shape, strict=True))
        factor = max(split, default=1)
        if not whole or len(split) > 1 or factor & (factor - 1) or factor > 1 << MOST_DEPTH:
            raise InvalidArgument(
                "grid to partition",
                f"{self.grid.shape} samples for a device of {shape}",
                f"2^D times the device's along each axis that is to be split, D up to {MOST_DEPTH}",
                "Prepare the medium on such a lattice.",
            )

    @property
    def depth(self) -> int:
        """D."""
        factors = [n // m for n, m in zip(self.grid.shape, self.device_shape, strict=True)]
        return max(factors).bit_length() - 1

    def boxes(self, depth: int) -> tuple[int, int, int]:
        """How many boxes of a depth there are along each axis."""
        x, y, z = (1 if n == m else 1 << depth for n, m in zip(self.grid.shape, self.device_shape, strict=True))
        return (x, y, z)

    def lattice(self, depth: int) -> Grid:
        """The lattice over the whole workspace that has the spacing of the boxes of a depth."""
        if depth == self.depth:
            return self.grid
        x, y, z = (m * b for m, b in zip(self.device_shape, self.boxes(depth), strict=True))
        return Grid.over_box(*self.grid.box_m, (x, y, z))

    def box_grid(self, depth: int, index: tuple[int, int, int]) -> Grid:
        """The device's lattice in one box."""
        level = self.lattice(depth)
        origin = level.to_m(np.multiply(index, self.device_shape)).tolist()
        return Grid(self.device_shape, level.spacing_m, tuple(origin))


@dataclass
class _Counts:
    """How often each key was counted, keys ascending."""

    keys: Int64s = field(default_factory=lambda: np.zeros(0, np.int64))
    counts: Int64s = field(default_factory=lambda: np.zeros(0, np.int64))

    def add(self, keys: Int64s, factor: int = 1) -> None:
        found, counts = np.unique(keys, return_counts=True)
        both, place = np.unique(np.concatenate([self.keys, found]), return_inverse=True)
        total = np.zeros(len(both), np.int64)
        np.add.at(total, place, np.concatenate([self.counts, counts * factor]))
        self.keys, self.counts = both, total


class BoxLosses:
    """Adds up the symbols of frames, and tells what each dyadic box loses.

    Parameters
    ----------
    lattice : DyadicLattice
    """

    def __init__(self, lattice: DyadicLattice) -> None:
        self.lattice = lattice
        self.frame_count, self._alphabet, self._quantiser = 0, 0, ""
        self._rows = [_Counts() for _ in range(lattice.depth)]  # of (box, k), k > 0: fine samples
        self._pairs = [_Counts() for _ in range(lattice.depth)]  # of (box, k, s), s > 0

    def add(self, levels: Sequence[FieldSymbols]) -> None:
        """Count one frame.

        Parameters
        ----------
        levels : sequence of FieldSymbols
            Of one Q, on ``lattice.lattice(d)`` for d = 0 .. D.

        Raises
        ------
        InvalidArgument
            If there are others, they differ in Q, or there are too many boxes and symbols to count.
        """
        d_most, last = self.lattice.depth, levels[-1]
        if [s.grid.shape for s in levels] != [self.lattice.lattice(d).shape for d in range(d_most + 1)]:
            raise InvalidArgument("levels", f"shapes {[s.grid.shape for s in levels]}", "those of the dyadic lattice")
        self._alphabet, self._quantiser = self._alphabet or last.alphabet, self._quantiser or last.quantiser
        if any((s.alphabet, s.quantiser) != (self._alphabet, self._quantiser) for s in levels):
            raise InvalidArgument("levels", "several quantisers", f"{self._quantiser} for all")
        if 8**d_most * self._alphabet**2 >= 1 << 63:
            raise InvalidArgument("quantiser", f"{self._alphabet} symbols", "fewer", "Take a coarser quantiser.")
        places, symbols = _held(last)
        for d in range(d_most):
            ratio = self._ratio(d)
            cells = places // ratio
            told = levels[d].symbols_at(cells).astype(np.int64)
            boxes = self._box_of(cells, d)
            self._pairs[d].add((boxes * self._alphabet + told) * self._alphabet + symbols)
            cells, told = _held(levels[d])
            self._rows[d].add(self._box_of(cells, d) * self._alphabet + told, int(ratio.prod()))
        self.frame_count += 1

    def bits(self) -> tuple[Float64s, ...]:
        """L of the boxes of each depth, bits a frame, float64 of shape ``lattice.boxes(d)`` for d = 0 .. D.

        Raises
        ------
        InvalidArgument
            If no frame was added.
        """
        if not self.frame_count:
            raise InvalidArgument("box losses", "no frame", "at least one")
        found = [self._bits(d) / self.frame_count for d in range(self.lattice.depth)]
        return (*found, np.zeros(self.lattice.boxes(self.lattice.depth)))

    def _bits(self, d: int) -> Float64s:
        """L times the frames."""
        shape = self.lattice.boxes(d)
        box_count = int(np.prod(shape))
        rows, pairs = self._rows[d], self._pairs[d]
        row_of_pair = pairs.keys // self._alphabet
        held, first = np.unique(row_of_pair, return_index=True)
        box, told = np.divmod(held, self._alphabet)
        in_rows = np.zeros(box_count, np.int64)
        np.add.at(in_rows, rows.keys // self._alphabet, rows.counts)
        per_box = self.lattice.grid.voxel_count // box_count * self.frame_count
        total = per_box - in_rows[box]  # of k = 0
        known = told > 0
        total[known] = rows.counts[np.searchsorted(rows.keys, held[known])]
        empty = total - (np.add.reduceat(pairs.counts, first) if len(first) else 0)
        bits = _xlog2x(total) - _xlog2x(empty)
        if len(first):
            bits -= np.add.reduceat(_xlog2x(pairs.counts), first)
        loss = np.zeros(box_count)
        np.add.at(loss, box, np.maximum(bits, 0.0))
        return loss.reshape(shape)

    def _ratio(self, d: int) -> Int64s:
        ratio: Int64s = np.array(self.lattice.grid.shape) // np.array(self.lattice.lattice(d).shape)
        return ratio

    def _box_of(self, cells: Int64s, d: int) -> Int64s:
        index = cells // np.array(self.lattice.device_shape)
        _, ny, nz = self.lattice.boxes(d)
        box: Int64s = (index[:, 0] * ny + index[:, 1]) * nz + index[:, 2]
        return box


def _held(s: FieldSymbols) -> tuple[Int64s, Int64s]:
    """Indices int64 [L, 3] and symbols int64 [L] of the samples whose symbol is not 0."""
    brick, x, y, z = np.nonzero(s.symbols)
    places = s.bricks[brick].astype(np.int64) * BRICK + np.stack([x, y, z], axis=1)
    return places, s.symbols[brick, x, y, z].astype(np.int64)


def _xlog2x(counts: Int64s) -> Float64s:
    n = counts.astype(np.float64)
    result: Float64s = n * np.log2(np.maximum(n, 1.0))
    return result
