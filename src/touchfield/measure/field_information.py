"""Entropies of quantised fields, over a weighting that is named (paper section 3.1, tables 1 and 2).

The paper never says what is drawn at random. Here it is S = Q(F(X)), X uniform over all V voxels of all frames
("voxel", empty space being symbol 0), or over those where Q(F) is not zero ("object"), or as often as a probe was
there ("interaction"). The first two obey H_voxel = h2(p) + p H_object, p being the density of the support: that
identity is what the paper calls "artificially escalated". It holds exactly for the plug-in estimates; those of other
estimators are corrected apart from each other, for other counts and alphabets, and obey it only as n grows. Empty
space that no brick covers is counted and never allocated.

Frames may be a lazy sequence. They are read in passes, and no frame is held once it is counted.

Blocks of the bootstrap hold all frames of a part of space: over "voxel" boxes of bricks that fill the lattice, over
"object" equal numbers of neighbouring bricks of the support.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.measure.brick_blocks import BrickBoxes, BrickGroups
from touchfield.measure.counted import Counted, Entropies, measured
from touchfield.measure.distribution import NORMALISATIONS
from touchfield.measure.field_frames import Fields, FramePairs, Frames, frames_changed
from touchfield.measure.histogram import LEAST_BLOCKS, MOST_BLOCK_CELLS, Histogram
from touchfield.medium.field import brick_keys

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from touchfield.measure.quantity import Quantity

    Int64s = NDArray[np.int64]

__all__ = ["FieldJoint", "field_entropy", "field_joint"]

BLOCKS = 64


def field_entropy(
    fields: Fields,
    over: str | tuple[ArrayLike, ArrayLike] = "voxel",
    *,
    estimator: str = "plug-in",
    interval: bool = True,
    blocks: int = BLOCKS,
) -> Quantity:
    """H(S) of a quantised field, bits a sample.

    Parameters
    ----------
    fields : FieldSymbols, or a sequence of them
        One frame or several, all of one grid and one Q. A sequence may make its frames when asked for them: they are
        asked for one by one, in order, and none is held longer than it is counted. Each is asked for once without an
        interval, for visits, and over "voxel" if `blocks` times K is at most 2^24; twice otherwise.
    over : "voxel", "object", or (int [m, 3], int [m])
        mu: all voxels; those whose symbol is not 0; or lattice points and how often each was visited, in every frame.
        Visits outside the grid are left out, as `interaction_entropy` does, and a note counts them.
    estimator : str
        One of `touchfield.measure.estimators.ESTIMATORS`.
    interval : bool
        Whether to make one. There is none for visits, whose order in time is not known here.
    blocks : int
        Of the bootstrap, 8 or more; about as many are made.

    Returns
    -------
    Quantity
        Unit "bit/sample", a sample being a voxel, a voxel of the support, or a visit.

    Warns
    -----
    FewSamplesWarning
        If there are fewer than ten samples to a symbol.

    Raises
    ------
    InvalidArgument
        If the frames differ in grid or Q, or from one pass to the next; `over` is unknown, its counts are wrong or
        no visit is inside the grid; or there is no support to be uniform over.
    """
    frames = Frames(fields, "fields")
    if not isinstance(over, str):
        return _visited(frames, over, estimator)
    _, counted = _Count(frames, _choice(over), estimator, interval).counted(_check_blocks(blocks))
    alphabet = frames.alphabet - (over == "object")
    return measured("H(S)", Entropies(estimator, (), (alphabet,)).joint, counted)


@dataclass(frozen=True)
class FieldJoint:
    """What two quantised fields S and T of one grid say of each other; each a `Quantity`.

    Attributes
    ----------
    first, second : Quantity
        H(S) and H(T), over the same voxels as the rest.
    joint : Quantity
        H(S,T).
    first_given_second, second_given_first : Quantity
        H(S|T) and H(T|S).
    mutual : Quantity
        I(S;T).
    variation : Quantity
        VI(S,T).
    normalised : Quantity
        Normalised I(S;T).
    """

    first: Quantity
    second: Quantity
    joint: Quantity
    first_given_second: Quantity
    second_given_first: Quantity
    mutual: Quantity
    variation: Quantity
    normalised: Quantity

    def summary(self) -> dict[str, Any]:
        """Plain values by name."""
        return {f.name: getattr(self, f.name).summary() for f in fields(self)}


def field_joint(
    first: Fields,
    second: Fields,
    over: str = "voxel",
    *,
    by: str = "sqrt",
    estimator: str = "plug-in",
    interval: bool = True,
) -> FieldJoint:
    """Joint measures of two fields, voxel by voxel, such as a medium before and after a filter.

    Parameters
    ----------
    first, second : FieldSymbols, or sequences of as many
        S and T, of one grid; their quantisers may differ. Sequences may make their frames when asked for them: they
        are asked for pair by pair, the second's before the first's, and no pair is held longer than it is counted.
        Each frame is asked for once without an interval, and over "voxel" if 64 K_S K_T is at most 2^24; twice
        otherwise.
    over : "voxel" or "object"
        All voxels, or those where one of the two has a force.
    by : str
        One of `touchfield.measure.distribution.NORMALISATIONS`.
    estimator, interval
        As of `field_entropy`; 64 blocks.

    Raises
    ------
    InvalidArgument
        As of `field_entropy`; also if the two differ in grid or length.
    """
    if by not in NORMALISATIONS:
        raise InvalidArgument("by", repr(by), f"one of {', '.join(NORMALISATIONS)}")
    over = _choice(over)
    a, b = Frames(first, "first"), Frames(second, "second")
    if a.count != b.count:
        raise InvalidArgument("second", f"{b.count} frames", f"{a.count}, as many as the first")
    if a.grid != b.grid:
        raise InvalidArgument("second", f"the grid {b.grid}", f"{a.grid}, as of the first")
    sizes = a.alphabet, b.alphabet
    histogram, counted = _Count(FramePairs(a, b), over, estimator, interval).counted(BLOCKS)
    columns = np.divmod(histogram.symbols, sizes[1])
    places = tuple(np.unique(c, return_inverse=True)[1].reshape(-1) for c in columns)
    e = Entropies(estimator, places, (*sizes, sizes[0] * sizes[1] - (over == "object")))
    quiet = replace(counted, warns=False)  # the joint symbols are the most, one warning is enough
    return FieldJoint(
        measured("H(S)", lambda c: e.column(0, c), replace(quiet, symbols=int(places[0].max()) + 1)),
        measured("H(T)", lambda c: e.column(1, c), replace(quiet, symbols=int(places[1].max()) + 1)),
        measured("H(S,T)", e.joint, counted),
        measured("H(S|T)", lambda c: e.given(1, c), quiet),
        measured("H(T|S)", lambda c: e.given(0, c), quiet),
        measured("I(S;T)", e.mutual, quiet),
        measured("VI(S,T)", e.variation, quiet),
        measured(f"NMI_{by}(S;T)", lambda c: e.normalised(by, c), quiet, "1", 1.0),
    )


# -- counting -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Count:
    """The symbols of all frames, readable more than once, and what is wanted of them."""

    frames: Frames | FramePairs
    over: str
    estimator: str
    interval: bool

    def counted(self, blocks: int) -> tuple[Histogram, Counted]:
        everywhere = self.frames.grid.voxel_count * self.frames.count
        if everywhere >= 1 << 63:
            raise InvalidArgument("fields", f"{everywhere} voxels in all frames", "fewer than 2^63")
        made: Int64s | None = None
        notes: tuple[str, ...] = ()
        if self._fits_one_pass(blocks):
            histogram, made = self._at_once(BrickBoxes.of(self.frames.grid, blocks))
        else:
            histogram, support = self._histogram(everywhere)
            if self.interval:
                made, notes = self._blocks(histogram, support, blocks)
        return histogram, Counted(
            histogram.counts, made, histogram.total, self.estimator, self.frames.quantiser, self.over, notes
        )

    def _fits_one_pass(self, blocks: int) -> bool:
        """Whether a table of all symbols that there can be holds every block that is wanted."""
        if not self.interval or self.over == "object" or blocks * self.frames.alphabet > MOST_BLOCK_CELLS:
            return False
        return BrickBoxes.of(self.frames.grid, blocks).count >= LEAST_BLOCKS

    def _at_once(self, boxes: BrickBoxes) -> tuple[Histogram, Int64s]:
        """The histogram and the blocks over "voxel", in one pass."""
        from touchfield.measure.kernels.count import add_counts

        table = np.zeros((boxes.count, self.frames.alphabet), np.int64)
        for bricks, symbols in self.frames.parts():
            held = symbols != 0
            owner = np.repeat(boxes.owner(self.frames.grid, bricks), held.sum(axis=1))
            add_counts(owner * self.frames.alphabet + symbols[held], table.reshape(-1))
        table[:, 0] = boxes.voxels(self.frames.grid) * self.frames.count - table.sum(axis=1)
        total = table.sum(axis=0)
        seen = np.flatnonzero(total)
        return Histogram(seen, total[seen]), table[:, seen]

    def _histogram(self, everywhere: int) -> tuple[Histogram, Int64s]:
        """The histogram; and over "object", for blocks, the keys of the bricks that hold a symbol, ascending."""
        support = np.zeros(0, np.int64)

        def held_symbols() -> Iterator[Int64s]:
            nonlocal support
            for bricks, symbols in self.frames.parts():
                if self.over == "object" and self.interval:
                    support = np.union1d(support, brick_keys(self.frames.grid, bricks[symbols.any(axis=1)]))
                yield symbols[symbols != 0]

        held = Histogram.of(held_symbols())
        if self.over == "voxel":
            return held.plus(0, everywhere - held.total), support
        if not len(held.counts):
            raise InvalidArgument(
                "fields",
                f"no voxel with a force in {self.frames.count} frames",
                "a support to be uniform over",
                'Take over="voxel".',
            )
        return held, support

    def _blocks(self, histogram: Histogram, support: Int64s, wanted: int) -> tuple[Int64s | None, tuple[str, ...]]:
        most = min(wanted, MOST_BLOCK_CELLS // len(histogram.counts))
        grid = self.frames.grid
        boxes = BrickGroups(support, most) if self.over == "object" else BrickBoxes.of(grid, most)
        if min(most, boxes.count) < LEAST_BLOCKS:
            return None, (
                f"no interval: fewer than {LEAST_BLOCKS} blocks, for there are too few bricks or too many symbols",
            )
        out = self._count_by_block(histogram, boxes)
        if isinstance(boxes, BrickBoxes) and histogram.symbols[0] == 0:
            out[:, 0] = boxes.voxels(grid) * self.frames.count - out[:, 1:].sum(axis=1)
        if not np.array_equal(out.sum(axis=0), histogram.counts):
            raise frames_changed()
        return out, ()

    def _count_by_block(self, histogram: Histogram, boxes: BrickBoxes | BrickGroups) -> Int64s:
        from touchfield.measure.kernels.count import add_counts

        k = len(histogram.counts)
        out = np.zeros((boxes.count, k), np.int64)
        for bricks, symbols in self.frames.parts():
            held = symbols != 0
            cells = np.searchsorted(histogram.symbols, symbols[held])
            if (cells == k).any():  # beyond the table
                raise frames_changed()
            owner = np.repeat(boxes.owner(self.frames.grid, bricks), held.sum(axis=1))
            add_counts(owner * k + cells, out.reshape(-1))
        return out


def _visited(frames: Frames, over: Any, estimator: str) -> Quantity:
    index, counts = _checked_visits(over)
    inside = ((index >= 0) & (index < frames.grid.shape)).all(axis=1)
    visits, lost = int(counts.sum()), int(counts[~inside].sum())
    if lost == visits:
        raise InvalidArgument(
            "over", f"{visits} visits, none of them in the grid", f"indices below {frames.grid.shape}"
        )
    index, counts = index[inside], counts[inside]
    total = np.zeros(0, np.int64)
    for n in range(frames.count):
        symbols = frames.take(n).symbols_at(index)
        found = np.zeros(max(len(total), int(symbols.max()) + 1), np.int64)
        np.add.at(found, symbols, counts)
        found[: len(total)] += total
        total = found
    seen = total[total > 0]
    notes = ["no interval: visit counts have no order in time"]
    if lost:
        notes.append(f"{lost} of {visits} visits lie outside the grid and were left out")
    counted = Counted(seen, None, int(seen.sum()), estimator, frames.quantiser, "interaction", tuple(notes))
    return measured("H(S)", Entropies(estimator, (), (frames.alphabet,)).joint, counted)


def _checked_visits(over: Any) -> tuple[Int64s, Int64s]:
    if not isinstance(over, tuple | list) or len(over) != 2:
        found = f"{len(over)} items" if isinstance(over, tuple | list) else repr(over)
        raise InvalidArgument("over", found, '"voxel", "object", or (indices [m, 3], counts [m])')
    try:
        index, counts = (np.asarray(x) for x in over)
    except ValueError as error:
        raise InvalidArgument("over", "rows of several lengths", "indices [m, 3] and counts [m]") from error
    if index.ndim != 2 or index.shape[1] != 3 or counts.shape != index.shape[:1]:
        raise InvalidArgument("over", f"shapes {index.shape} and {counts.shape}", "indices [m, 3] and counts [m]")
    if index.dtype.kind not in "iu" or counts.dtype.kind not in "iu":
        raise InvalidArgument("over", f"types {index.dtype} and {counts.dtype}", "whole numbers")
    if not (counts >= 0).all() or not counts.any():
        raise InvalidArgument("over", f"counts that add up to {counts.sum()}", "counts of at least 0, one above 0")
    return index.astype(np.int64), counts.astype(np.int64)


def _choice(over: str) -> str:
    if not isinstance(over, str) or over not in ("voxel", "object"):
        raise InvalidArgument("over", repr(over), '"voxel" or "object"')
    return over


def _check_blocks(blocks: int) -> int:
    if blocks < LEAST_BLOCKS:
        raise InvalidArgument("blocks", f"{blocks}", f"{LEAST_BLOCKS} or more", "Give interval=False for none.")
    return blocks
