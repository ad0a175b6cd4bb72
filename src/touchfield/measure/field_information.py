"""Entropies of quantised fields, over a weighting that is named (paper section 3.1, tables 1 and 2).

The paper never says what is drawn at random. Here it is S = Q(F(X)), X uniform over all V voxels of all frames
("voxel", empty space being symbol 0), or over those where Q(F) is not zero ("object"), or as often as a probe was
there ("interaction"). The first two obey H_voxel = h2(p) + p H_object, p being the density of the support: that
identity is what the paper calls "artificially escalated". It holds exactly for the plug-in estimates; those of other
estimators are corrected apart from each other, for other counts and alphabets, and obey it only as n grows. Empty
space that no brick covers is counted and never allocated.

Frames may be a lazy sequence. They are read in passes (`touchfield.measure.field_count`), and no frame is held once
it is counted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Int64s
from touchfield.errors import InvalidArgument
from touchfield.measure.field_count import SymbolCount, count_symbols, no_support
from touchfield.measure.field_symbols import Fields, FramePairs, Frames
from touchfield.measure.histogram import LEAST_BLOCKS
from touchfield.measure.quantity import Counted, Entropies, check_normalisation, measured

if TYPE_CHECKING:
    from touchfield.measure.quantity import Quantity


BLOCKS = 27
"""Three along each side of a cube: fewer, larger blocks cover more of what neighbours share, see `bootstrap`."""


def field_entropy(
    fields: Fields,
    over: str | tuple[ArrayLike, ArrayLike] = "voxel",
    *,
    estimator: str = "plug-in",
    interval: bool = True,
    blocks: int = BLOCKS,
) -> Quantity:
    """H(S) of a quantised field, bits a sample.

    FewSamplesWarning if there are fewer than ten samples to a symbol. InvalidArgument if the frames differ in grid
    or Q, or from one pass to the next; `over` is unknown, its counts are wrong or no visit is inside the grid; or
    there is no support to be uniform over.

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
    """
    frames = Frames(fields, "fields")
    if not isinstance(over, str):
        return _visited(frames, over, estimator)
    return _counts(frames, (_choice(over),), interval, blocks).entropy(over, estimator)


@dataclass(frozen=True)
class FieldCounts:
    """The symbols of quantised frames, counted: their entropies, without another look at the frames.

    `counts` mapping of str to SymbolCount: over "voxel", "object" or both. `alphabet`: K, with "no force".
    """

    counts: Mapping[str, SymbolCount]
    frame_count: int
    alphabet: int
    quantiser: str

    def entropy(self, over: str = "voxel", estimator: str = "plug-in", *, interval: bool = True) -> Quantity:
        """The result of `field_entropy`, with an interval only if blocks were counted."""
        found = self.counts[over]
        if not len(found.histogram.counts):
            raise no_support(self.frame_count)
        counted = found.counted(estimator, self.quantiser, over, interval=interval)
        alphabet = self.alphabet - (over == "object")
        return measured("H(S)", Entropies(estimator, (), (alphabet,)).joint, counted)


def field_counts(
    fields: Fields, overs: tuple[str, ...] = ("voxel", "object"), *, interval: bool = True, blocks: int = BLOCKS
) -> FieldCounts:
    """The symbols of quantised frames, over voxels and over the object at once.

    `fields`, `interval`, `blocks`: as of `field_entropy`. Both weightings together ask for each frame as often as
    the object alone: once without an interval, and twice with one. InvalidArgument as of `field_entropy`; that
    there is no support is only said when the entropy of the object is asked for.
    """
    return _counts(Frames(fields, "fields"), tuple(_choice(over) for over in overs), interval, blocks)


def _counts(frames: Frames, overs: tuple[str, ...], interval: bool, blocks: int) -> FieldCounts:
    if blocks < LEAST_BLOCKS:
        raise InvalidArgument("blocks", f"{blocks}", f"{LEAST_BLOCKS} or more", "Give interval=False for none.")
    counts = count_symbols(frames, overs, interval, blocks)
    return FieldCounts(counts, frames.count, frames.alphabet, frames.quantiser)


@dataclass(frozen=True)
class FieldJoint:
    """Information that two quantised fields S and T of one grid share; each a `Quantity`.

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

    InvalidArgument as of `field_entropy`; also if the two differ in grid or length.

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
        As of `field_entropy`; 27 blocks.
    """
    check_normalisation(by)
    over = _choice(over)
    a, b = Frames(first, "first"), Frames(second, "second")
    if a.count != b.count:
        raise InvalidArgument("second", f"{b.count} frames", f"{a.count}, as many as the first")
    if a.grid != b.grid:
        raise InvalidArgument("second", f"the grid {b.grid}", f"{a.grid}, as of the first")
    sizes = a.alphabet, b.alphabet
    pairs = FramePairs(a, b)
    found = count_symbols(pairs, (over,), interval, BLOCKS)[over]
    histogram = found.histogram
    if not len(histogram.counts):
        raise no_support(pairs.count)
    counted = found.counted(estimator, pairs.quantiser, over)
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


# -- visits and checks ----------------------------------------------------------------------------------------------


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
