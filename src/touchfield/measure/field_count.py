"""Counts the symbols of quantised fields for entropies, either over all voxels or over those with a force
(the "object").

The paper (section 3.1, tables 1 and 2) does not define the random variable. Here it is S = Q(F(X)). X is
uniform over all V voxels of all frames ("voxel", empty space being symbol 0), or over those where Q(F) is not
zero ("object"), or distributed as the visits of a probe ("interaction", `touchfield.measure.interaction`).
The first two satisfy H_voxel = h2(p) + p H_object, where p is the density of the support; the paper calls
this "artificially escalated". The equation holds exactly for plug-in estimates; others are corrected
separately and satisfy it only as n grows. Empty space that no brick covers is counted but never allocated.

Frames may be a lazy sequence; none is kept after it is counted. The first pass counts. The second pass counts
in blocks for an interval, for which the occurring symbols must be known; over voxels alone a single pass does
both, if a table of all possible symbols fits in memory for every block. The object's counts are those of the
voxels without symbol 0. A block has all frames of a part of space: over "voxel" the parts are boxes of bricks
that fill the lattice, over "object" equal numbers of neighbouring bricks of the support.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Int32s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.measure.counts import MAX_BLOCK_CELLS, Counts
from touchfield.measure.dependence import BlockLayout
from touchfield.measure.field_symbols import Fields, FramePairs, Frames, frames_changed
from touchfield.measure.information import entropy
from touchfield.measure.quantity import MIN_BLOCKS, Quantity
from touchfield.medium.field import brick_keys, bricks_of
from touchfield.medium.grid import BRICK, Grid

BLOCKS = 64
"""Number of blocks, four along each side of a cube."""

# -- blocks of space: boxes of a lattice, or groups of bricks of the support


MIN_BLOCK_BRICKS = 8
"""Number of bricks of a block, if there are enough: 16 samples along each side, several correlation
lengths."""


@dataclass(frozen=True)
class BrickGroups:
    """Groups of equal numbers of bricks of a support.

    Bricks are grouped along a Morton curve, so that groups are compact. `keys` int64 [n]: `brick_keys` of the
    support, ascending, at least one. `owners` int64 [n]: the group of each.
    """

    grid: Grid
    keys: Int64s
    owners: Int64s

    @classmethod
    def of(cls, grid: Grid, keys: Int64s, max_groups: int) -> BrickGroups:
        """Make at most `max_groups` groups of the bricks with these keys, ascending."""
        bricks = bricks_of(grid, keys).astype(np.int64)
        along = np.zeros(len(keys), np.int64)
        for bit in range(max(grid.brick_shape).bit_length()):  # interleave the bits of the three coordinates
            along |= ((bricks >> bit & 1) << (3 * bit + np.arange(3))).sum(axis=1)
        curve = np.argsort(along)
        owners = np.empty(len(keys), np.int64)
        owners[curve] = np.arange(len(keys)) * _block_count(max_groups, len(keys)) // len(keys)
        return cls(grid, keys, owners)

    def layout(self, frames: int) -> BlockLayout:
        """The groups lie in a row, along the curve."""
        return BlockLayout((self.count,), 3, frames)

    @property
    def count(self) -> int:
        """B, the number of groups."""
        return int(self.owners.max()) + 1 if len(self.owners) else 0

    def owner(self, bricks: Int32s) -> Int64s:
        """The group of each brick, int64 [m, 1].

        `bricks`: int32 [m, 3]; the group of bricks outside the support is arbitrary.
        """
        index = np.minimum(np.searchsorted(self.keys, brick_keys(self.grid, bricks)), len(self.keys) - 1)
        return self.owners[index, None]


def _block_count(max_blocks: int, bricks: int) -> int:
    """Return the number of blocks for a number of bricks.

    There are fewer than `max_blocks` if blocks would be too small, but at least 8.
    """
    return min(max_blocks, bricks, max(MIN_BLOCKS, bricks // MIN_BLOCK_BRICKS))


def _cuts(sides: ArrayLike, max_cuts: Sequence[int], max_boxes: int) -> tuple[int, int, int]:
    """Cut repeatedly across the longest side; return the parts along each axis.

    There are at most `max_boxes` parts in all, and at most `max_cuts` along an axis.
    """
    cuts = [1, 1, 1]
    while True:
        longest_first = np.argsort(np.asarray(sides) / cuts)[::-1]
        divisible = [
            a
            for a in longest_first
            if cuts[a] < max_cuts[a] and math.prod(cuts) // cuts[a] * (cuts[a] + 1) <= max_boxes
        ]
        if not divisible:
            return cuts[0], cuts[1], cuts[2]
        cuts[divisible[0]] += 1


@dataclass(frozen=True)
class Boxes:
    """Boxes that fill a lattice.

    `cuts`: number of boxes along each axis. `along` int64 [n] for each axis: the box that each sample lies
    in.
    """

    cuts: tuple[int, int, int]
    along: tuple[Int64s, ...]

    @classmethod
    def of_bricks(cls, grid: Grid, max_boxes: int) -> Boxes:
        """Make at most `max_boxes` boxes of bricks by cuts across the longest side."""
        cuts = _cuts(grid.brick_shape, grid.brick_shape, _block_count(max_boxes, math.prod(grid.brick_shape)))
        axes = zip(grid.brick_shape, grid.shape, cuts, strict=True)
        return cls(cuts, tuple(np.repeat(np.arange(n) * of // n, BRICK)[:size] for n, size, of in axes))

    def layout(self, frames: int) -> BlockLayout:
        """The boxes form a lattice."""
        return BlockLayout(self.cuts, 3, frames)

    @property
    def count(self) -> int:
        """B, the number of boxes."""
        return math.prod(self.cuts)

    @property
    def voxels(self) -> Int64s:
        """Samples of the lattice in each box, int64 [B]."""
        x, y, z = (np.bincount(o, minlength=n) for o, n in zip(self.along, self.cuts, strict=True))
        samples: Int64s = (x[:, None, None] * y[:, None] * z).reshape(-1)
        return samples

    @cached_property
    def _of_bricks(self) -> list[Int64s]:
        """For each axis, the box of each brick, int64 [n, 1].

        If boxes split bricks, it is the box of each sample of the bricks, int64 [n, 8].
        """
        rows = [np.pad(o, (0, -len(o) % BRICK), "edge").reshape(-1, BRICK) for o in self.along]
        return [r[:, :1] for r in rows] if all((r == r[:, :1]).all() for r in rows) else rows

    def owner(self, bricks: Int32s) -> Int64s:
        """Return the box of each brick, int64 [m, 1], or of each sample, [m, 512].

        `bricks`: int32 [m, 3].
        """
        x, y, z = (rows[b] for rows, b in zip(self._of_bricks, bricks.T, strict=True))
        owner = (x[:, :, None, None] * self.cuts[1] + y[:, None, :, None]) * self.cuts[2] + z[:, None, None]
        return np.asarray(owner.reshape(len(bricks), -1))


# -- counting


def field_entropy(
    fields: Fields,
    over: str = "voxel",
    *,
    estimator: str = "plug-in",
    interval: bool = True,
    blocks: int = BLOCKS,
) -> Quantity:
    """H(S) of a quantised field, bits per voxel, or per voxel of the support.

    `fields`: FieldSymbols or a sequence of them, all of one grid and one Q. `over`: mu, "voxel" for all
    voxels or "object" for those whose symbol is not 0; for visits of a probe see `interaction_entropy`.
    `blocks`: number of blocks, 8 or more; about as many are made. InvalidArgument as in
    `field_counts`, and if over "object" there is no support.
    """
    counts = supported(field_counts(fields, overs=(over,), interval=interval, blocks=blocks)[over])
    return entropy(counts, estimator=estimator, interval=interval)


def field_counts(
    first: Fields,
    second: Fields | None = None,
    overs: tuple[str, ...] = ("voxel", "object"),
    *,
    interval: bool = True,
    blocks: int = BLOCKS,
) -> dict[str, Counts]:
    """Count the symbols of all frames by weighting, or those of two media jointly.

    `first`, `second`: FieldSymbols, or sequences of equal length, S and T, of one grid; their quantisers may
    differ. Sequences may be lazy: frames are requested one by one, in order, the second's before the first's,
    and none is kept after it is counted. Each frame is requested once without an interval, and over "voxel"
    alone if `blocks` times the alphabet is at most 2^24; twice otherwise.

    `overs`: "voxel" for all voxels; "object" for those whose symbol is not 0 (of two media, those where
    either has a force), with no cells if there is none. `interval`: whether to make blocks. `blocks`: number
    of blocks, 8 or more. InvalidArgument if the frames differ in grid or Q, or from one pass to the next, or
    the two media differ in grid or length; if a weighting is unknown; or if there are 2^63 voxels or more.
    """
    if not overs or any(over not in ("voxel", "object") for over in overs):
        raise InvalidArgument("over", repr(overs), '"voxel" or "object"')
    if interval and blocks < MIN_BLOCKS:
        raise InvalidArgument("blocks", f"{blocks}", f"{MIN_BLOCKS} or more", "Give interval=False for none.")
    if second is None:
        return _count(Frames(first, "fields"), overs, interval, blocks)
    a, b = Frames(first, "first"), Frames(second, "second")
    if a.count != b.count:
        raise InvalidArgument(
            "second",
            f"{b.count} frames",
            f"{a.count}, as many as the first",
            "Take the frames that both have.",
        )
    if a.grid != b.grid:
        raise InvalidArgument("second", f"the grid {b.grid}", f"{a.grid}, as of the first")
    counts = _count(FramePairs(a, b), overs, interval, blocks)
    pairs = {over: np.stack(np.divmod(c.cells[:, 0], b.alphabet), axis=1) for over, c in counts.items()}
    return {over: replace(c, cells=pairs[over]) for over, c in counts.items()}


def supported(counts: Counts) -> Counts:
    """Return the counts; InvalidArgument if they have no cell.

    There is no cell if no voxel has a force.
    """
    if not len(counts.cells):
        raise InvalidArgument(
            "fields",
            "no voxel with a force in any frame",
            "a support to be uniform over",
            'Take over="voxel".',
        )
    return counts


def _count(
    frames: Frames | FramePairs, overs: tuple[str, ...], interval: bool, blocks: int
) -> dict[str, Counts]:
    everywhere = frames.grid.voxel_count * frames.count
    if everywhere >= 1 << 63:
        raise InvalidArgument("fields", f"{everywhere} voxels in all frames", "fewer than 2^63")
    of = partial(Counts, quantiser=frames.quantiser, variables=("S", "T"))
    if overs == ("voxel",) and interval and blocks * frames.alphabet <= MAX_BLOCK_CELLS:
        boxes = Boxes.of_bricks(frames.grid, blocks)
        if boxes.count >= MIN_BLOCKS:
            occurring, by_block = _count_by_box(frames, boxes)
            return {
                "voxel": of(
                    occurring[:, None],
                    by_block.sum(axis=0),
                    by_block,
                    weighting="voxel",
                    alphabet=frames.alphabet,
                    layout=boxes.layout(frames.count),
                )
            }
    support_counts, support = _support_counts(frames, interval and "object" in overs)
    symbols, weights = support_counts.cells[:, 0], np.asarray(support_counts.weights, np.int64)
    tallies = {"object": (symbols, weights), "voxel": (symbols, weights)}
    if empty_count := everywhere - support_counts.total:
        tallies["voxel"] = np.append(0, symbols), np.append(empty_count, weights)
    parts: dict[str, Boxes | BrickGroups] = {}
    for over in overs if interval else ():
        max_blocks = min(blocks, MAX_BLOCK_CELLS // max(1, len(tallies[over][0])))
        part = (
            BrickGroups.of(frames.grid, support, max_blocks)
            if over == "object"
            else Boxes.of_bricks(frames.grid, max_blocks)
        )
        if min(max_blocks, part.count) >= MIN_BLOCKS:
            parts[over] = part
    tables = _support_by_part(frames, symbols, parts)
    few = f"no interval: fewer than {MIN_BLOCKS} blocks, for there are too few bricks or too many symbols"
    counts = {}
    for over in overs:
        (occurring, times), alphabet, space = (
            tallies[over],
            frames.alphabet - (over == "object"),
            parts.get(over),
        )
        table = None if space is None else _with_empty(tables[over], space, frames.count, times)
        notes = (few,) if interval and table is None else ()
        counts[over] = of(
            occurring[:, None], times, table, weighting=over, alphabet=alphabet, notes=notes,
            layout=None if space is None else space.layout(frames.count),
        )  # fmt: skip
    return counts


def _with_empty(table: Int64s, part: Boxes | BrickGroups, frames: int, counts: Int64s) -> Int64s:
    """Prepend the counts of symbol 0 to the counts of each part, if `counts` have it.

    InvalidArgument if the parts do not sum to `counts`: the frames have changed between passes.
    """
    if len(counts) > table.shape[1]:
        assert isinstance(part, Boxes)
        empty = part.voxels * frames - table.sum(axis=1)
        table = np.concatenate([empty[:, None], table], axis=1)
    if not np.array_equal(table.sum(axis=0), counts):
        raise frames_changed()
    return table


def _count_by_box(frames: Frames | FramePairs, boxes: Boxes) -> tuple[Int64s, Int64s]:
    """Return the occurring symbols and their counts in each box, by a table of all possible symbols."""
    from touchfield.measure.kernels import add_counts

    table = np.zeros((boxes.count, frames.alphabet), np.int64)
    for bricks, symbols in frames.parts():
        is_supported = symbols != 0
        owner = np.repeat(boxes.owner(bricks)[:, 0], is_supported.sum(axis=1))
        add_counts(owner * frames.alphabet + symbols[is_supported], table.reshape(-1))
    table[:, 0] = boxes.voxels * frames.count - table.sum(axis=1)
    occurring = np.flatnonzero(table.any(axis=0))
    return occurring, table[:, occurring]


def _support_counts(frames: Frames | FramePairs, keep_support: bool) -> tuple[Counts, Int64s]:
    """Return the counts without symbol 0, and the keys of the supported bricks.

    The keys are ascending; there are none unless `keep_support`.
    """
    support = np.zeros(0, np.int64)

    def support_symbols() -> Iterator[Int64s]:
        nonlocal support
        for bricks, symbols in frames.parts():
            if keep_support:
                support = np.union1d(support, brick_keys(frames.grid, bricks[symbols.any(axis=1)]))
            yield symbols[symbols != 0]

    return Counts.of_stream(support_symbols()), support


def _support_by_part(
    frames: Frames | FramePairs, occurring: Int64s, parts: Mapping[str, Boxes | BrickGroups]
) -> dict[str, Int64s]:
    """The counts of the `occurring` symbols in each part of space, in one pass.

    int64 [B, K] for each division of `parts`.
    """
    from touchfield.measure.kernels import add_counts

    k = len(occurring)
    out = {name: np.zeros((part.count, k), np.int64) for name, part in parts.items()}
    for bricks, symbols in frames.parts() if out else ():
        inside = symbols != 0
        cells = np.searchsorted(occurring, symbols[inside])
        if (cells == k).any():  # a symbol that the first pass did not find
            raise frames_changed()
        for name, part in parts.items():
            owner = np.broadcast_to(part.owner(bricks), inside.shape)[inside]
            add_counts(owner * k + cells, out[name].reshape(-1))
    return out


MIN_BOX_SAMPLES = (BRICK, 2)
"""Minimum number of samples along each side of a box, of the medium and of the rendered medium: neighbouring
samples are dependent."""


def shared_boxes(grid: Grid, other: Grid, max_boxes: int) -> tuple[Boxes, Boxes] | None:
    """Equal boxes of space that have samples of both lattices; None for fewer than 8.

    There are at most `max_boxes`. The box of `grid` is cut repeatedly across its longest side, while at least
    8 samples of `grid` and 2 of `other` are left along it: an axis along which the other lattice has a single
    sample, as an array of actuators has, is not cut. Samples beyond the box of `grid` belong to the nearest
    box.
    """
    low, high = grid.box_m
    positions_m = [other.axis_m(axis) for axis in range(3)]
    inside = [int(((x >= lo) & (x < hi)).sum()) for x, lo, hi in zip(positions_m, low, high, strict=True)]
    max_cuts = [
        max(1, min(n // MIN_BOX_SAMPLES[0], m // MIN_BOX_SAMPLES[1]))
        for n, m in zip(grid.shape, inside, strict=True)
    ]
    cuts = _cuts(high - low, max_cuts, max_boxes)

    def boxes_of(g: Grid) -> Boxes:
        cut_positions = [(g.axis_m(a) - low[a]) / (high[a] - low[a]) * cuts[a] for a in range(3)]
        return Boxes(
            cuts,
            tuple(np.clip(s, 0, n - 1).astype(np.int64) for s, n in zip(cut_positions, cuts, strict=True)),
        )

    boxes, other_boxes = boxes_of(grid), boxes_of(other)
    return (
        (boxes, other_boxes)
        if boxes.count >= MIN_BLOCKS and boxes.voxels.all() and other_boxes.voxels.all()
        else None
    )


def shared_counts(
    fields: tuple[Fields, Fields],
    grids: tuple[Grid, Grid],
    counts: tuple[Counts, Counts],
    max_boxes: int = 64,
) -> tuple[Counts, Counts] | None:
    """The counts over "voxel" of two media, with common blocks for a joint interval.

    `fields`: for the medium and the rendered medium, FieldSymbols or a sequence of them. Each frame is
    requested once, those of the medium first. `grids` (Grid, Grid): their lattices in one space, such as hand
    metres. `counts`: of all voxels of all frames of each. `max_boxes`: number of boxes that is wanted; there
    are fewer if their counts would exceed 2^24 numbers. The blocks are the same boxes of space for both. None
    if there would be fewer than 8 boxes, or one of them has samples of only one lattice. InvalidArgument if
    the numbers of frames differ, or the counts are not those of the frames.
    """
    frames = Frames(fields[0], "medium"), Frames(fields[1], "rendered")
    if frames[0].count != frames[1].count:
        raise InvalidArgument(
            "rendered", f"{frames[1].count} frames", f"{frames[0].count}, as many as the medium"
        )
    both = shared_boxes(*grids, min(max_boxes, MAX_BLOCK_CELLS // sum(len(c.cells) for c in counts)))
    if both is None:
        return None
    shared = []
    for f, boxes, c in zip(frames, both, counts, strict=True):
        occurring = c.cells[int(c.cells[0, 0] == 0) :, 0]
        table = _support_by_part(f, occurring, {"voxel": boxes})["voxel"]
        by_box = _with_empty(table, boxes, f.count, np.asarray(c.weights))
        shared.append(replace(c, blocks=by_box, layout=boxes.layout(f.count)))
    return shared[0], shared[1]
