"""Counting the symbols of quantised frames, over all voxels and over the object, in as few passes as can be.

The first pass makes the histogram, the second the blocks of a bootstrap, which need to know the symbols that occur.
Over voxels alone one pass makes both, where a table of all symbols that there can be holds every block. The object's
histogram is that of the voxels without symbol 0, so that both are counted together as fast as one.

Blocks hold all frames of a part of space: over "voxel" boxes of bricks that fill the lattice, over "object" equal
numbers of neighbouring bricks of the support.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.measure.field_frames import FramePairs, Frames, frames_changed
from touchfield.measure.histogram import LEAST_BLOCKS, MOST_BLOCK_CELLS, Histogram
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK, Grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int64s = NDArray[np.int64]


__all__ = ["BrickBoxes", "BrickGroups", "SymbolCount", "count_symbols", "no_support"]

# -- Parts of space for a block bootstrap over a field: boxes of its lattice, or groups of the bricks of its suppor


LEAST_BLOCK_BRICKS = 8
"""Of a block, where there are bricks enough: 16 samples along each side, some times what neighbours share."""


@dataclass(frozen=True)
class BrickGroups:
    """Equal numbers of the bricks of a support, neighbours along a Morton curve, so that groups are compact.

    Attributes
    ----------
    keys : int64 [n]
        `brick_keys` of the support, ascending, at least one.
    owners : int64 [n]
        The block of each.
    """

    keys: Int64s
    owners: Int64s

    @classmethod
    def of(cls, grid: Grid, keys: Int64s, most: int) -> BrickGroups:
        """At most so many groups of the bricks with these keys, ascending."""
        bricks = np.stack(np.unravel_index(keys, grid.brick_shape), axis=1)
        along = np.zeros(len(keys), np.int64)
        for bit in range(max(grid.brick_shape).bit_length()):  # the bits of the three places, in turn
            along |= ((bricks >> bit & 1) << (3 * bit + np.arange(3))).sum(axis=1)
        curve = np.argsort(along)
        owners = np.empty(len(keys), np.int64)
        owners[curve] = np.arange(len(keys)) * _wanted(most, len(keys)) // len(keys)
        return cls(keys, owners)

    @property
    def count(self) -> int:
        """B."""
        return int(self.owners.max()) + 1 if len(self.owners) else 0

    def owner(self, grid: Grid, bricks: NDArray[np.int32]) -> Int64s:
        """The block of each brick, int64 [m], of int32 [m, 3]; bricks without a symbol may be anywhere."""
        place = np.minimum(np.searchsorted(self.keys, brick_keys(grid, bricks)), len(self.keys) - 1)
        owner: Int64s = self.owners[place]
        return owner


def _wanted(most: int, bricks: int) -> int:
    """Blocks of so many bricks: not so many that they are too small, where that leaves enough."""
    return min(most, bricks, max(LEAST_BLOCKS, bricks // LEAST_BLOCK_BRICKS))


@dataclass(frozen=True)
class BrickBoxes:
    """Boxes of bricks that fill the lattice, `cuts` of them along each axis."""

    cuts: tuple[int, int, int]

    @classmethod
    def of(cls, grid: Grid, most: int) -> BrickBoxes:
        """At most so many, cut again and again across the longest side."""
        most = _wanted(most, math.prod(grid.brick_shape))
        cuts = [1, 1, 1]
        while True:
            sides = [n / c for n, c in zip(grid.brick_shape, cuts, strict=True)]
            open_ = [a for a in np.argsort(sides)[::-1] if cuts[a] < grid.brick_shape[a]]
            longest = [a for a in open_ if np.prod(cuts) // cuts[a] * (cuts[a] + 1) <= most]
            if not longest:
                return cls((cuts[0], cuts[1], cuts[2]))
            cuts[longest[0]] += 1

    @property
    def count(self) -> int:
        """B."""
        a, b, c = self.cuts
        return a * b * c

    def owner(self, grid: Grid, bricks: NDArray[np.int32]) -> Int64s:
        """The block of each brick, int64 [m], of int32 [m, 3]."""
        a, b, c = (bricks.astype(np.int64) * self.cuts // grid.brick_shape).T
        owner: Int64s = (a * self.cuts[1] + b) * self.cuts[2] + c
        return owner

    def voxels(self, grid: Grid) -> Int64s:
        """Samples of the lattice in each box, int64 [B]."""
        along = []
        for n, size, cuts in zip(grid.brick_shape, grid.shape, self.cuts, strict=True):
            first = -(-np.arange(cuts + 1, dtype=np.int64) * n // cuts)  # brick i is in box i * cuts // n
            along.append(np.diff(np.minimum(first * BRICK, size)))
        x, y, z = along
        samples: Int64s = (x[:, None, None] * y[:, None] * z).reshape(-1)
        return samples


# -- Counting the symbols of quantised frames, over all voxels and over the object, in as few passes as can be


@dataclass(frozen=True)
class SymbolCount:
    """What was counted over one weighting.

    Attributes
    ----------
    histogram : Histogram
        Of all frames; without any symbol over an object that there is none of.
    blocks : int64 [B, K] or None
        Its counts in each part of space.
    notes : tuple of str
        Why there are no blocks, where they were wanted.
    """

    histogram: Histogram
    blocks: Int64s | None
    notes: tuple[str, ...] = ()


def count_symbols(
    frames: Frames | FramePairs, overs: tuple[str, ...], interval: bool, blocks: int
) -> Mapping[str, SymbolCount]:
    """Count all frames over each weighting of `overs`.

    Parameters
    ----------
    frames : Frames or FramePairs
    overs : tuple of "voxel" and "object"
    interval : bool
        Whether blocks are wanted.
    blocks : int
        How many; 8 or more.

    Raises
    ------
    InvalidArgument
        If there are 2^63 voxels or more, or the frames change from one pass to the next.
    """
    everywhere = frames.grid.voxel_count * frames.count
    if everywhere >= 1 << 63:
        raise InvalidArgument("fields", f"{everywhere} voxels in all frames", "fewer than 2^63")
    if overs == ("voxel",) and interval and blocks * frames.alphabet <= MOST_BLOCK_CELLS:
        boxes = BrickBoxes.of(frames.grid, blocks)
        if boxes.count >= LEAST_BLOCKS:
            return {"voxel": _in_one_pass(frames, boxes)}
    held, support = _held_symbols(frames, interval and "object" in overs)
    histograms = {"voxel": held.plus(0, everywhere - held.total), "object": held}
    if not interval:
        return {over: SymbolCount(histograms[over], None) for over in overs}
    parts: dict[str, BrickBoxes | BrickGroups] = {}
    for over in overs:
        most = min(blocks, MOST_BLOCK_CELLS // max(1, len(histograms[over].counts)))
        part = BrickGroups.of(frames.grid, support, most) if over == "object" else BrickBoxes.of(frames.grid, most)
        if min(most, part.count) >= LEAST_BLOCKS:
            parts[over] = part
    found = _held_by_part(frames, held, parts)
    few = f"no interval: fewer than {LEAST_BLOCKS} blocks, for there are too few bricks or too many symbols"
    counts = {}
    for over in overs:
        made = found.get(over)
        if made is not None and len(histograms[over].counts) > len(held.counts):  # symbol 0, of all that is not held
            part = parts[over]
            assert isinstance(part, BrickBoxes)
            empty = part.voxels(frames.grid) * frames.count - made.sum(axis=1)
            made = np.concatenate([empty[:, None], made], axis=1)
        if made is not None and not np.array_equal(made.sum(axis=0), histograms[over].counts):
            raise frames_changed()
        counts[over] = SymbolCount(histograms[over], made, () if made is not None else (few,))
    return counts


def no_support(frame_count: int) -> InvalidArgument:
    """The error of an object that there is none of."""
    return InvalidArgument(
        "fields",
        f"no voxel with a force in {frame_count} frames",
        "a support to be uniform over",
        'Take over="voxel".',
    )


def _in_one_pass(frames: Frames | FramePairs, boxes: BrickBoxes) -> SymbolCount:
    """The histogram and the blocks over "voxel", by a table of all symbols that there can be."""
    from touchfield.measure.kernels.count import add_counts

    table = np.zeros((boxes.count, frames.alphabet), np.int64)
    for bricks, symbols in frames.parts():
        held = symbols != 0
        owner = np.repeat(boxes.owner(frames.grid, bricks), held.sum(axis=1))
        add_counts(owner * frames.alphabet + symbols[held], table.reshape(-1))
    table[:, 0] = boxes.voxels(frames.grid) * frames.count - table.sum(axis=1)
    total = table.sum(axis=0)
    seen = np.flatnonzero(total)
    return SymbolCount(Histogram(seen, total[seen]), table[:, seen])


def _held_symbols(frames: Frames | FramePairs, keep_support: bool) -> tuple[Histogram, Int64s]:
    """The histogram without symbol 0; and where it is wanted the keys of the bricks that hold one, ascending."""
    support = np.zeros(0, np.int64)

    def held_symbols() -> Iterator[Int64s]:
        nonlocal support
        for bricks, symbols in frames.parts():
            if keep_support:
                support = np.union1d(support, brick_keys(frames.grid, bricks[symbols.any(axis=1)]))
            yield symbols[symbols != 0]

    return Histogram.of(held_symbols()), support


def _held_by_part(
    frames: Frames | FramePairs, held: Histogram, parts: Mapping[str, BrickBoxes | BrickGroups]
) -> dict[str, Int64s]:
    """The counts of symbols other than 0 in each part, int64 [B, K], for every way to part the space: one pass."""
    from touchfield.measure.kernels.count import add_counts

    k = len(held.counts)
    out = {name: np.zeros((part.count, k), np.int64) for name, part in parts.items()}
    for bricks, symbols in frames.parts() if out else ():
        inside = symbols != 0
        cells = np.searchsorted(held.symbols, symbols[inside])
        if (cells == k).any():  # beyond the table
            raise frames_changed()
        each = inside.sum(axis=1)
        for name, part in parts.items():
            owner = np.repeat(part.owner(frames.grid, bricks), each)
            add_counts(owner * k + cells, out[name].reshape(-1))
    return out
