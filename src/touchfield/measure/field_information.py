"""Entropies of quantised fields, over a weighting that is named (paper section 3.1, tables 1 and 2).

The paper never says what is drawn at random. Here it is S = Q(F(X)), X uniform over all V voxels of all frames
("voxel", empty space being symbol 0), or over those where Q(F) is not zero ("object"), or as often as a probe was
there ("interaction"). The first two obey H_voxel = h2(p) + p H_object exactly, p being the density of the support:
that identity is what the paper calls "artificially escalated". Empty space that no brick covers is counted and never
allocated.

Blocks of the bootstrap hold all frames of a part of space: over "voxel" boxes of bricks that fill the lattice, over
"object" equal numbers of neighbouring bricks of the support.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.measure.brick_blocks import BrickBoxes, BrickGroups
from touchfield.measure.counted import Counted, Entropies, measured
from touchfield.measure.distribution import NORMALISATIONS
from touchfield.measure.field_symbols import FieldSymbols, aligned
from touchfield.measure.histogram import LEAST_BLOCKS, MOST_BLOCK_CELLS, Histogram
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import Grid

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from touchfield.measure.quantity import Quantity

    Int64s = NDArray[np.int64]

__all__ = ["FieldJoint", "field_entropy", "field_joint"]

Part = tuple["NDArray[np.int32]", "NDArray[np.int64]"]
"""Bricks int32 [m, 3], and the symbols of their samples, int64 [m, 512], 0 where nothing is."""

Parts = Callable[[], Iterator[Part]]
Fields = FieldSymbols | Sequence[FieldSymbols]

BLOCKS = 64
_NO_BLOCKS = "no interval: fewer than 8 blocks, for there are too few bricks or too many symbols"
_BRICKS = 1 << 11  # at a time: 8 MiB of int64


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
        One frame or several, all of one grid and one Q.
    over : "voxel", "object", or (int [m, 3], int [m])
        mu: all voxels; those whose symbol is not 0; or lattice points and how often each was visited, in every frame.
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
        If the frames differ in grid or Q, `over` is unknown or its counts are wrong, or there is no support to be
        uniform over.
    """
    frames = _frames(fields, "fields")
    if not isinstance(over, str):
        return _visited(frames, over, estimator)
    source = _Source(
        frames[0].grid, len(frames), lambda: _symbols(frames), frames[0].quantiser, _choice(over), estimator, interval
    )
    _, counted = source.counted(_check_blocks(blocks))
    alphabet = frames[0].alphabet - (over == "object")
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
        S and T, of one grid; their quantisers may differ.
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
    a, b = _frames(first, "first"), _frames(second, "second")
    if by not in NORMALISATIONS:
        raise InvalidArgument("by", repr(by), f"one of {', '.join(NORMALISATIONS)}")
    if len(a) != len(b):
        raise InvalidArgument("second", f"{len(b)} frames", f"{len(a)}, as many as the first")
    if a[0].grid != b[0].grid:
        raise InvalidArgument("second", f"the grid {b[0].grid}", f"{a[0].grid}, as of the first")
    sizes = a[0].alphabet, b[0].alphabet
    quantiser = a[0].quantiser if a[0].quantiser == b[0].quantiser else f"{a[0].quantiser}; {b[0].quantiser}"
    source = _Source(a[0].grid, len(a), lambda: _pairs(a, b), quantiser, _choice(over), estimator, interval)
    histogram, counted = source.counted(BLOCKS)
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
class _Source:
    """The symbols of all frames, readable more than once, and what is wanted of them."""

    grid: Grid
    frames: int
    parts: Parts
    quantiser: str
    over: str
    estimator: str
    interval: bool

    def counted(self, blocks: int) -> tuple[Histogram, Counted]:
        held = Histogram.of(symbols[symbols != 0] for _, symbols in self.parts())
        everywhere = self.grid.voxel_count * self.frames
        if everywhere >= 1 << 63:
            raise InvalidArgument("fields", f"{everywhere} voxels in all frames", "fewer than 2^63")
        if self.over == "object" and not len(held.counts):
            raise InvalidArgument(
                "fields",
                f"no voxel with a force in {self.frames} frames",
                "a support to be uniform over",
                'Take over="voxel".',
            )
        histogram = held if self.over == "object" else held.plus(0, everywhere - held.total)
        made, notes = self._blocks(histogram, blocks) if self.interval else (None, ())
        return histogram, Counted(
            histogram.counts, made, histogram.total, self.estimator, self.quantiser, self.over, notes
        )

    def _blocks(self, histogram: Histogram, wanted: int) -> tuple[Int64s | None, tuple[str, ...]]:
        k = len(histogram.counts)
        most = min(wanted, MOST_BLOCK_CELLS // k)
        boxes = BrickGroups(self._supported(), most) if self.over == "object" else BrickBoxes.of(self.grid, most)
        if min(most, boxes.count) < LEAST_BLOCKS:
            return None, (
                f"no interval: fewer than {LEAST_BLOCKS} blocks, for there are too few bricks or too many symbols",
            )
        out = self._count_by_block(histogram, boxes)
        if isinstance(boxes, BrickBoxes) and histogram.symbols[0] == 0:
            out[:, 0] = boxes.voxels(self.grid) * self.frames - out[:, 1:].sum(axis=1)
        return out, ()

    def _count_by_block(self, histogram: Histogram, boxes: BrickBoxes | BrickGroups) -> Int64s:
        from touchfield.measure.kernels.count import add_counts

        k = len(histogram.counts)
        out = np.zeros((boxes.count, k), np.int64)
        for bricks, symbols in self.parts():
            held = symbols != 0
            cells = np.searchsorted(histogram.symbols, symbols[held])
            owner = np.repeat(boxes.owner(self.grid, bricks), held.sum(axis=1))
            add_counts(owner * k + cells, out.reshape(-1))
        return out

    def _supported(self) -> Int64s:
        """Keys of the bricks that hold a symbol in any frame, ascending."""
        found = np.zeros(0, np.int64)
        for bricks, symbols in self.parts():
            found = np.union1d(found, brick_keys(self.grid, bricks[symbols.any(axis=1)]))
        return found


# -- frames ---------------------------------------------------------------------------------------------------------


def _frames(given: Fields, where: str) -> tuple[FieldSymbols, ...]:
    frames = (given,) if isinstance(given, FieldSymbols) else tuple(given)
    if not frames or not all(isinstance(f, FieldSymbols) for f in frames):
        raise InvalidArgument(where, "no frame" if not frames else "other things", "at least one FieldSymbols")
    for n, f in enumerate(frames):
        if f.grid != frames[0].grid:
            raise InvalidArgument(f"{where}, frame {n}", f"the grid {f.grid}", f"{frames[0].grid}, as of frame 0")
        if (f.quantiser, f.alphabet) != (frames[0].quantiser, frames[0].alphabet):
            raise InvalidArgument(
                f"{where}, frame {n}",
                f"the quantiser {f.quantiser} with {f.alphabet} symbols",
                f"{frames[0].quantiser} with {frames[0].alphabet}, as of frame 0",
            )
    return frames


def _symbols(frames: tuple[FieldSymbols, ...]) -> Iterator[Part]:
    for f in frames:
        for b in range(0, len(f.bricks), _BRICKS):
            some = f.symbols[b : b + _BRICKS]
            yield f.bricks[b : b + _BRICKS], some.reshape(len(some), -1).astype(np.int64)


def _pairs(first: tuple[FieldSymbols, ...], second: tuple[FieldSymbols, ...]) -> Iterator[Part]:
    """Joint symbols s * K_T + t at the union of the bricks."""
    for f, g in zip(first, second, strict=True):
        keys = np.union1d(brick_keys(f.grid, f.bricks), brick_keys(g.grid, g.bricks))
        for b in range(0, len(keys), _BRICKS):
            low, high = keys[b], keys[min(len(keys), b + _BRICKS) - 1]
            s, t = aligned((_between(f, low, high), _between(g, low, high)))
            bricks = np.stack(np.unravel_index(keys[b : b + _BRICKS], f.grid.brick_shape), axis=1)
            joint = s.astype(np.int64) * g.alphabet + t
            yield bricks.astype(np.int32), joint.reshape(len(joint), -1)


def _between(f: FieldSymbols, low: int, high: int) -> FieldSymbols:
    keys = brick_keys(f.grid, f.bricks)
    part = slice(np.searchsorted(keys, low), np.searchsorted(keys, high, side="right"))
    return replace(f, bricks=f.bricks[part], symbols=f.symbols[part])


def _visited(frames: tuple[FieldSymbols, ...], over: tuple[ArrayLike, ArrayLike], estimator: str) -> Quantity:
    index, counts = (np.asarray(x) for x in over)
    if index.ndim != 2 or index.shape[1] != 3 or counts.shape != index.shape[:1]:
        raise InvalidArgument("over", f"shapes {index.shape} and {counts.shape}", "indices [m, 3] and counts [m]")
    if index.dtype.kind not in "iu" or counts.dtype.kind not in "iu":
        raise InvalidArgument("over", f"types {index.dtype} and {counts.dtype}", "whole numbers")
    if not (counts >= 0).all() or not counts.any():
        raise InvalidArgument("over", f"counts that add up to {counts.sum()}", "counts of at least 0, one above 0")
    total = np.zeros(0, np.int64)
    for f in frames:
        symbols = f.symbols_at(index)
        found = np.zeros(max(len(total), int(symbols.max()) + 1), np.int64)
        np.add.at(found, symbols, counts.astype(np.int64))
        found[: len(total)] += total
        total = found
    seen = total[total > 0]
    notes = ("no interval: visit counts have no order in time",)
    counted = Counted(seen, None, int(seen.sum()), estimator, frames[0].quantiser, "interaction", notes)
    return measured("H(S)", Entropies(estimator, (), (frames[0].alphabet,)).joint, counted)


def _choice(over: str) -> str:
    if over not in ("voxel", "object"):
        raise InvalidArgument("over", repr(over), '"voxel" or "object"')
    return over


def _check_blocks(blocks: int) -> int:
    if blocks < LEAST_BLOCKS:
        raise InvalidArgument("blocks", f"{blocks}", f"{LEAST_BLOCKS} or more", "Give interval=False for none.")
    return blocks
