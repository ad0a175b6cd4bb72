"""Divides a workspace into boxes, each of which fills the lattice of a device, so that the least information
is lost (paper section 4).

"Optimal adaptive workspace partitioning in disjoint subspaces so as to minimize information loss taking into
account the rendering device". Each box fills the device's own lattice, so that a small box is rendered finely
and a large one coarsely. More boxes lose less information but cost more: each one is another view to which
the hand must be moved. The objective is

    J = sum of the losses of the boxes + lambda * number of boxes,

with lambda in bits per box. As J is a sum over boxes, the best division of a box is either the box itself or
the best divisions of its children: pruning from the smallest boxes upwards finds the optimum among all dyadic
divisions. Ties are resolved in favour of fewer boxes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from touchfield.arrays import Bools, Float64s, Int64s
from touchfield.errors import InvalidArgument, require_not_negative
from touchfield.measure.counts import Histogram, merged
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.medium.grid import BRICK, Grid

MAX_DEPTH = 7
"""Largest depth; 2^21 boxes."""


@dataclass(frozen=True)
class DyadicLattice:
    """A fine lattice, and its division by the lattice of a device.

    `grid`: the fine lattice over the workspace. `device_shape` (int, int, int): samples of the device along
    each axis. An axis with as many samples as the grid is not split; along all others the grid has 2^D times
    as many, with the same D. InvalidArgument if the grid is not such a multiple, or D is greater than 7.
    """

    grid: Grid
    device_shape: tuple[int, int, int]

    def __post_init__(self) -> None:
        shape = tuple(int(n) for n in self.device_shape)
        if len(shape) != 3 or min(shape) < 1:
            raise InvalidArgument("device_shape", repr(self.device_shape), "three counts of at least 1")
        object.__setattr__(self, "device_shape", shape)
        split = {n // m for n, m in zip(self.grid.shape, shape, strict=True) if n != m}
        is_multiple = all(n % m == 0 for n, m in zip(self.grid.shape, shape, strict=True))
        factor = max(split, default=1)
        if not is_multiple or len(split) > 1 or factor & (factor - 1) or factor > 1 << MAX_DEPTH:
            raise InvalidArgument(
                "grid to partition",
                f"{self.grid.shape} samples for a device of {shape}",
                f"2^D times the device's along each axis that is to be split, D up to {MAX_DEPTH}",
                "Prepare the medium on such a lattice.",
            )

    @property
    def depth(self) -> int:
        """D, the depth of the smallest boxes."""
        factors = [n // m for n, m in zip(self.grid.shape, self.device_shape, strict=True)]
        return max(factors).bit_length() - 1

    def boxes(self, depth: int) -> tuple[int, int, int]:
        """Return the number of boxes of a depth along each axis."""
        x, y, z = (
            1 if n == m else 1 << depth for n, m in zip(self.grid.shape, self.device_shape, strict=True)
        )
        return (x, y, z)

    def lattice(self, depth: int) -> Grid:
        """Return the lattice over the whole workspace at the spacing of a depth."""
        if depth == self.depth:
            return self.grid
        x, y, z = (m * b for m, b in zip(self.device_shape, self.boxes(depth), strict=True))
        return Grid.over_box(*self.grid.box_m, (x, y, z))


class BoxLosses:
    """Symbol counts of frames, and the information loss of each dyadic box."""

    def __init__(self, lattice: DyadicLattice) -> None:
        self.lattice = lattice
        self.frame_count, self._alphabet, self._quantiser = 0, 0, ""
        none: Histogram = (np.zeros(0, np.int64), np.zeros(0, np.int64))
        # for each depth, numbers of fine samples: by (box, coarse symbol k > 0), and by (box, k, fine symbol
        # s > 0)
        self._rows = [none] * lattice.depth
        self._pairs = [none] * lattice.depth

    def add(self, levels: Sequence[FieldSymbols]) -> None:
        """Count one frame.

        `levels`: the frame on ``lattice.lattice(d)`` for d = 0 .. D, FieldSymbols of one Q. InvalidArgument
        if the lattices differ from these, the levels differ in Q, or there are too many boxes and symbols to
        count.
        """
        max_depth, last = self.lattice.depth, levels[-1]
        if [s.grid.shape for s in levels] != [self.lattice.lattice(d).shape for d in range(max_depth + 1)]:
            raise InvalidArgument(
                "levels", f"shapes {[s.grid.shape for s in levels]}", "those of the dyadic lattice"
            )
        self._alphabet, self._quantiser = self._alphabet or last.alphabet, self._quantiser or last.quantiser
        if any((s.alphabet, s.quantiser) != (self._alphabet, self._quantiser) for s in levels):
            raise InvalidArgument("levels", "several quantisers", f"{self._quantiser} for all")
        if 8**max_depth * self._alphabet**2 >= 1 << 63:
            raise InvalidArgument(
                "quantiser", f"{self._alphabet} symbols", "fewer", "Take a coarser quantiser."
            )
        indices, symbols = _supported(last)
        for d in range(max_depth):
            ratio: Int64s = np.array(self.lattice.grid.shape) // np.array(self.lattice.lattice(d).shape)
            cells = indices // ratio
            coarse = levels[d].symbols_at(cells).astype(np.int64)
            boxes = self._box_of(cells, d)
            pairs = (boxes * self._alphabet + coarse) * self._alphabet + symbols
            self._pairs[d] = merged([self._pairs[d], np.unique(pairs, return_counts=True)])
            cells, coarse = _supported(levels[d])
            rows, counts = np.unique(self._box_of(cells, d) * self._alphabet + coarse, return_counts=True)
            self._rows[d] = merged([self._rows[d], (rows, counts * int(ratio.prod()))])
        self.frame_count += 1

    def bits(self) -> tuple[Float64s, ...]:
        """Return the loss L of the boxes of each depth, bits per frame.

        float64 of shape ``lattice.boxes(d)`` for d = 0 .. D. InvalidArgument if no frame was added.
        """
        if not self.frame_count:
            raise InvalidArgument("box losses", "no frame", "at least one")
        coarser = [self._bits(d) / self.frame_count for d in range(self.lattice.depth)]
        return (*coarser, np.zeros(self.lattice.boxes(self.lattice.depth)))

    def _bits(self, d: int) -> Float64s:
        """Return L times the number of frames."""
        shape = self.lattice.boxes(d)
        box_count = int(np.prod(shape))
        (rows, row_counts), (pairs, pair_counts) = self._rows[d], self._pairs[d]
        row_of_pair = pairs // self._alphabet
        paired, first = np.unique(row_of_pair, return_index=True)
        box, coarse = np.divmod(paired, self._alphabet)
        in_rows = np.zeros(box_count, np.int64)
        np.add.at(in_rows, rows // self._alphabet, row_counts)
        per_box = self.lattice.grid.voxel_count // box_count * self.frame_count
        total = per_box - in_rows[box]  # number of fine samples with k = 0
        is_supported = coarse > 0
        total[is_supported] = row_counts[np.searchsorted(rows, paired[is_supported])]
        empty = total - (np.add.reduceat(pair_counts, first) if len(first) else 0)
        bits = _xlog2x(total) - _xlog2x(empty)
        if len(first):
            bits -= np.add.reduceat(_xlog2x(pair_counts), first)
        loss = np.zeros(box_count)
        np.add.at(loss, box, np.maximum(bits, 0.0))
        return loss.reshape(shape)

    def _box_of(self, cells: Int64s, d: int) -> Int64s:
        index = cells // np.array(self.lattice.device_shape)
        _, ny, nz = self.lattice.boxes(d)
        box: Int64s = (index[:, 0] * ny + index[:, 1]) * nz + index[:, 2]
        return box


def _supported(s: FieldSymbols) -> tuple[Int64s, Int64s]:
    """Indices int64 [L, 3] and symbols int64 [L] of the samples whose symbol is not 0."""
    brick, x, y, z = np.nonzero(s.symbols)
    indices = s.bricks[brick].astype(np.int64) * BRICK + np.stack([x, y, z], axis=1)
    return indices, s.symbols[brick, x, y, z].astype(np.int64)


def _xlog2x(counts: Int64s) -> Float64s:
    n = counts.astype(np.float64)
    result: Float64s = n * np.log2(np.maximum(n, 1.0))
    return result


@dataclass(frozen=True)
class DyadicBox:
    """One box of a partition.

    `depth`: how often the workspace was halved along each axis. `index` (int, int, int): index of the box
    among the 2^depth boxes along each axis. `loss_bits`: information in it that the device omits, bits per
    frame.
    """

    depth: int
    index: tuple[int, int, int]
    loss_bits: float


@dataclass(frozen=True)
class Partition:
    """Disjoint boxes that cover the workspace, ascending by depth and index.

    `penalty_bits`: lambda, bits per box.
    """

    lattice: DyadicLattice
    penalty_bits: float
    boxes: tuple[DyadicBox, ...]

    @property
    def loss_bits(self) -> float:
        """Loss of all boxes, bits per frame."""
        return math.fsum(b.loss_bits for b in self.boxes)

    @property
    def cost_bits(self) -> float:
        """The objective J, bits per frame."""
        return self.loss_bits + self.penalty_bits * len(self.boxes)

    def grid(self, box: DyadicBox) -> Grid:
        """The device's lattice in a box, metres of the hand."""
        level, shape = self.lattice.lattice(box.depth), self.lattice.device_shape
        return Grid(shape, level.spacing_m, tuple(level.to_m(np.multiply(box.index, shape)).tolist()))

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        depths = [b.depth for b in self.boxes]
        return {
            "boxes": len(self.boxes),
            "boxes_by_depth": {d: depths.count(d) for d in sorted(set(depths))},
            "lost_bits_per_frame": self.loss_bits,
            "penalty_bits_per_box": self.penalty_bits,
            "cost_bits": self.cost_bits,
            "device_shape": list(self.lattice.device_shape),
        }


def optimal_partition(lattice: DyadicLattice, losses: Sequence[Float64s], penalty_bits: float) -> Partition:
    """Return the partition with the smallest objective J.

    `losses`: for each depth 0 .. D the loss of its boxes, float64 of shape ``lattice.boxes(d)``, bits per
    frame (`BoxLosses.bits`). `penalty_bits`: lambda, 0 or more; a greater one never gives more boxes, nor a
    smaller total loss. InvalidArgument if lambda is negative, or the losses have other shapes or are not
    finite.
    """
    require_not_negative(penalty_bits=penalty_bits)
    shapes = [lattice.boxes(d) for d in range(lattice.depth + 1)]
    if [np.shape(loss) for loss in losses] != shapes:
        raise InvalidArgument("losses", f"shapes {[np.shape(loss) for loss in losses]}", str(shapes))
    if not all(np.isfinite(loss).all() for loss in losses):
        raise InvalidArgument("losses", "one that is not finite", "finite bits")
    is_undivided: list[Bools] = [np.ones(shapes[-1], np.bool_)]
    cost = np.asarray(losses[-1], np.float64) + penalty_bits
    for d in reversed(range(lattice.depth)):
        (bx, by, bz), (nx, ny, nz) = shapes[d], cost.shape
        undivided = losses[d] + penalty_bits
        divided = cost.reshape(bx, nx // bx, by, ny // by, bz, nz // bz).sum(
            axis=(1, 3, 5)
        )  # over the children
        is_undivided.insert(0, undivided <= divided)
        cost = np.minimum(undivided, divided)
    boxes = []
    reached = np.ones(shapes[0], np.bool_)
    for d, is_leaf in enumerate(is_undivided):
        for index in np.argwhere(reached & is_leaf).tolist():
            boxes.append(DyadicBox(d, (index[0], index[1], index[2]), float(losses[d][tuple(index)])))
        if d < lattice.depth:
            reached = reached & ~is_leaf
            for axis, n in enumerate(shapes[d + 1]):  # all their children
                reached = np.repeat(reached, n // reached.shape[axis], axis=axis)
    return Partition(lattice, float(penalty_bits), tuple(boxes))
