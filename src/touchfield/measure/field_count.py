"""Counting the symbols of quantised frames, over all voxels and over the object, in as few passes as can be.

The first pass makes the histogram, the second the blocks of a bootstrap, which need to know the symbols that occur.
Over voxels alone one pass makes both, where a table of all symbols that there can be holds every block. The object's
histogram is that of the voxels without symbol 0, so that both are counted together as fast as one.

Blocks hold all frames of a part of space: over "voxel" boxes of bricks that fill the lattice, over "object" equal
numbers of neighbouring bricks of the support.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s, Int32s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.measure.field_symbols import Fields, FramePairs, Frames, frames_changed
from touchfield.measure.histogram import LEAST_BLOCKS, MOST_BLOCK_CELLS, Histogram
from touchfield.measure.quantity import Counted
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK, Grid

# -- parts of space for a block bootstrap: boxes of a lattice, or groups of bricks of the support


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

    def owner(self, grid: Grid, bricks: Int32s) -> Int64s:
        """The block of each brick, int64 [m], of int32 [m, 3]; bricks without a symbol may be anywhere."""
        place = np.minimum(np.searchsorted(self.keys, brick_keys(grid, bricks)), len(self.keys) - 1)
        owner: Int64s = self.owners[place]
        return owner


def _wanted(most: int, bricks: int) -> int:
    """Blocks of so many bricks: not so many that they are too small, where that leaves enough."""
    return min(most, bricks, max(LEAST_BLOCKS, bricks // LEAST_BLOCK_BRICKS))


def _cuts(sides: ArrayLike, room: Sequence[int], most: int) -> tuple[int, int, int]:
    """At most so many boxes in all and `room` along each axis, cut again and again across the longest side."""
    cuts = [1, 1, 1]
    while True:
        longest_first = np.argsort(np.asarray(sides) / cuts)[::-1]
        open_ = [a for a in longest_first if cuts[a] < room[a] and math.prod(cuts) // cuts[a] * (cuts[a] + 1) <= most]
        if not open_:
            return cuts[0], cuts[1], cuts[2]
        cuts[open_[0]] += 1


@dataclass(frozen=True)
class BrickBoxes:
    """Boxes of bricks that fill the lattice, `cuts` of them along each axis."""

    cuts: tuple[int, int, int]

    @classmethod
    def of(cls, grid: Grid, most: int) -> BrickBoxes:
        """At most so many, cut again and again across the longest side."""
        most = _wanted(most, math.prod(grid.brick_shape))
        return cls(_cuts(grid.brick_shape, grid.brick_shape, most))

    @property
    def count(self) -> int:
        """B."""
        return math.prod(self.cuts)

    def owner(self, grid: Grid, bricks: Int32s) -> Int64s:
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


# -- counting


@dataclass(frozen=True)
class SymbolCount:
    """Counts over one weighting.

    `histogram`: of all frames; without any symbol over an object that there is none of. `blocks` int64 [B, K] or
    None: its counts in each part of space. `notes` tuple of str: why there are no blocks, where they were wanted.
    """

    histogram: Histogram
    blocks: Int64s | None
    notes: tuple[str, ...] = ()

    def counted(self, estimator: str, quantiser: str, over: str, *, interval: bool = True) -> Counted:
        """The counts with what they are of."""
        h, blocks, notes = self.histogram, self.blocks, self.notes
        if not interval:
            blocks, notes = None, ()
        return Counted(h.counts, blocks, h.total, estimator, quantiser, over, notes)


def count_symbols(
    frames: Frames | FramePairs, overs: tuple[str, ...], interval: bool, blocks: int
) -> Mapping[str, SymbolCount]:
    """Count all frames over each weighting of `overs`.

    `interval`: whether blocks are wanted. `blocks`: how many; 8 or more. InvalidArgument if there are 2^63 voxels
    or more, or the frames change from one pass to the next.
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
    frames: Frames | FramePairs,
    held: Histogram,
    parts: Mapping[str, BrickBoxes | BrickGroups | SharedBoxes],
    grid: Grid | None = None,
) -> dict[str, Int64s]:
    """The counts of symbols other than 0 in each part, int64 [B, K], for every way to part the space: one pass.

    `grid` says where the lattice of the frames lies, if that is not what they say themselves.
    """
    from touchfield.measure.kernels.count import add_counts

    k = len(held.counts)
    out = {name: np.zeros((part.count, k), np.int64) for name, part in parts.items()}
    for bricks, symbols in frames.parts() if out else ():
        inside = symbols != 0
        cells = np.searchsorted(held.symbols, symbols[inside])
        if (cells == k).any():  # beyond the table
            raise frames_changed()
        for name, part in parts.items():
            owner = part.owner(grid or frames.grid, bricks).reshape(len(bricks), -1)  # of bricks, or of samples
            add_counts(np.broadcast_to(owner, inside.shape)[inside] * k + cells, out[name].reshape(-1))
    return out


LEAST_SAMPLES = (BRICK, 2)
"""Along each side of a box, of the medium and of what is rendered of it: their neighbours depend on each other."""


@dataclass(frozen=True)
class SharedBoxes:
    """The box of a lattice, cut into equal boxes; what lies beyond belongs to the nearest.

    `low_m`, `high_m` float64 [3]: the box that is cut. `cuts` (int, int, int): boxes along each axis.
    """

    low_m: Float64s
    high_m: Float64s
    cuts: tuple[int, int, int]

    @classmethod
    def of(cls, grid: Grid, other: Grid, most: int) -> SharedBoxes | None:
        """At most so many boxes of `grid`, all of which hold samples of both lattices, or None for fewer than 8.

        They are cut again and again across the longest side, while 8 samples of `grid` and 2 of `other` are left
        along it: an axis along which the other has a single sample, as an array of actuators has, is not cut.

        `grid`, `other`: of one space.
        """
        low, high = grid.box_m
        inside = [
            int(((x >= lo) & (x < hi)).sum()) for x, lo, hi in zip(_along_m(other), low, high, strict=True)
        ]  # samples of the other along each axis
        room = [
            max(1, min(n // LEAST_SAMPLES[0], m // LEAST_SAMPLES[1])) for n, m in zip(grid.shape, inside, strict=True)
        ]
        found = cls(low, high, _cuts(high - low, room, most))
        both = (found.voxels(grid) > 0) & (found.voxels(other) > 0)
        return found if found.count >= LEAST_BLOCKS and both.all() else None

    @property
    def count(self) -> int:
        """B."""
        return math.prod(self.cuts)

    def owner(self, grid: Grid, bricks: Int32s) -> Int64s:
        """The box of each sample of bricks of a lattice, int64 [m, 512], of int32 [m, 3]."""
        x, y, z = (
            np.pad(o, (0, -len(o) % BRICK)).reshape(-1, BRICK)[b]
            for o, b in zip(self._along(grid), bricks.T, strict=True)
        )
        owner = (x[:, :, None, None] * self.cuts[1] + y[:, None, :, None]) * self.cuts[2] + z[:, None, None, :]
        flat: Int64s = owner.reshape(len(bricks), -1)
        return flat

    def voxels(self, grid: Grid) -> Int64s:
        """Samples of a lattice in each box, int64 [B]."""
        x, y, z = (np.bincount(o, minlength=n) for o, n in zip(self._along(grid), self.cuts, strict=True))
        samples: Int64s = (x[:, None, None] * y[:, None] * z).reshape(-1)
        return samples

    def _along(self, grid: Grid) -> list[Int64s]:
        """For each axis the cut that each sample lies in."""
        axes = zip(_along_m(grid), self.low_m, self.high_m, self.cuts, strict=True)
        return [np.clip((x - lo) / (hi - lo) * n, 0, n - 1).astype(np.int64) for x, lo, hi, n in axes]


def shared_counts(
    fields: tuple[Fields, Fields], grids: tuple[Grid, Grid], histograms: tuple[Histogram, Histogram], most: int = 64
) -> tuple[Int64s, Int64s] | None:
    """The counts over "voxel" of two media in the same boxes of space, for a bootstrap of both together.

    `fields` two of FieldSymbols or a sequence of them: a medium, and what is rendered of it, frame by frame. Each
    frame is asked for once, those of the medium first. `grids` (Grid, Grid): their lattices in one space, such as
    hand metres. `histograms` (Histogram, Histogram): of all voxels of all frames of each. `most`: boxes that are
    wanted. Fewer are made where 2^24 counts would not hold them. Returns (int64 [B, K], int64 [B, K']), or None:
    none where there would be fewer than 8 boxes, or one of them held samples of one lattice alone. InvalidArgument
    if there are not as many frames of each, or a histogram is not that of the frames.
    """
    frames = Frames(fields[0], "medium"), Frames(fields[1], "rendered")
    if frames[0].count != frames[1].count:
        raise InvalidArgument("rendered", f"{frames[1].count} frames", f"{frames[0].count}, as many as the medium")
    cells = sum(len(h.counts) for h in histograms)
    boxes = SharedBoxes.of(*grids, min(most, MOST_BLOCK_CELLS // cells))
    if boxes is None:
        return None
    first, second = (_counts(f, g, h, boxes) for f, g, h in zip(frames, grids, histograms, strict=True))
    return first, second


def _counts(frames: Frames, grid: Grid, histogram: Histogram, boxes: SharedBoxes) -> Int64s:
    empty = int(histogram.symbols[0] == 0)
    held = Histogram(histogram.symbols[empty:], histogram.counts[empty:])
    out = _held_by_part(frames, held, {"voxel": boxes}, grid)["voxel"]
    if empty:
        rest = boxes.voxels(grid) * frames.count - out.sum(axis=1)
        out = np.concatenate([rest[:, None], out], axis=1)
    if not np.array_equal(out.sum(axis=0), histogram.counts):
        raise frames_changed()
    return out


def _along_m(grid: Grid) -> Sequence[Float64s]:
    """Where the samples lie along each axis, metres."""
    return [
        o + h * np.arange(n, dtype=np.float64)
        for o, h, n in zip(grid.origin_m, grid.spacing_m, grid.shape, strict=True)
    ]
