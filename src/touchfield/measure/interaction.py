"""Computes the entropy of a field as a recorded hand met it: each point counts as often as the hand was there
(paper section 6.1).

Section 6.1 states that "the probability mass function of the haptic medium, theoretically depends on the
interaction" and gives no method. Here X, the position at which the field is sampled, is distributed as the
visit histogram mu of a recorded probe: each lattice point counts as often as a sample of the trace lies in
its cell. The entropy of S = Q(F_t(X)) is then the information that a hand received; empty space is one more
symbol.

A visit is a sample of the trace, not a duration: a trace that is not sampled regularly in time weights slow
parts wrongly, and the result has a note. The samples of a trace are dependent, because a hand moves
continuously; therefore the interval comes from blocks of consecutive samples.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np

from touchfield.arrays import Float64s, Int32s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.measure.counts import Counts
from touchfield.measure.field_symbols import Fields, FieldSymbols, Frames
from touchfield.measure.information import entropy
from touchfield.measure.quantity import MIN_BLOCKS, Quantity
from touchfield.medium.field import frozen
from touchfield.medium.grid import Grid
from touchfield.medium.trace import Trace

_LATE: Final = 1e-6  # fraction of a frame by which a time stamp may be early, for stamps rounded to decimals
_UNEVEN: Final = 2.0  # a trace is irregular if its longest step exceeds its median step by this factor


class Visits(NamedTuple):
    """The visit histogram mu, up to a factor.

    `indices` int64 [m, 3]: indices of the visited lattice points in raster order (x slowest, z fastest).
    `counts` int64 [m]: number of samples of the trace in the cell of each. `outside`: number of samples
    outside the grid.
    """

    indices: Int64s
    counts: Int64s
    outside: int


def visits(trace: Trace, grid: Grid) -> Visits:
    """Count how often a probe was nearest to each lattice point.

    A sample belongs to the lattice point in whose cell it lies. The cells of a grid extend half a spacing
    beyond its outermost samples (`Grid.box_m`); a cell includes its lower faces, up to rounding. The memory
    depends on the trace, not on the grid.
    """
    cells = _cells(trace.positions_m, grid)
    keys, counts = np.unique(cells[cells >= 0], return_counts=True)
    indices = np.stack(np.unravel_index(keys, grid.shape), axis=-1).astype(np.int64)
    return Visits(frozen(indices), frozen(counts.astype(np.int64)), int(np.count_nonzero(cells < 0)))


def interaction_entropy(
    trace: Trace,
    symbols: Fields,
    estimator: str = "plug-in",
    interval: bool = True,
    rate_hz: float | None = None,
    blocks: int = 64,
) -> Quantity:
    """Return H(S) of the field along a trace, bits per sample.

    It is the `entropy` of `interaction_counts`.
    """
    counts = interaction_counts(trace, symbols, interval, rate_hz, blocks)
    return entropy(counts, estimator=estimator, interval=interval)


def interaction_counts(
    trace: Trace,
    symbols: Fields,
    interval: bool = True,
    rate_hz: float | None = None,
    blocks: int = 64,
) -> Counts:
    """Count the symbols that a probe met, one for each sample within the medium.

    Samples before the first frame, after the last, or outside the box of the grid are omitted; notes give
    their numbers.

    `symbols`: the quantised field; or a sequence with one for each frame, of one grid and one quantiser,
    which may be lazy. Frame f lasts from f / rate_hz to (f + 1) / rate_hz; only the first frame and those
    that the trace meets are requested. `interval`: whether to make blocks over time.
    `rate_hz`: frames per second, required for a sequence. `blocks`: number of blocks of consecutive samples,
    at least 8. A block should last longer than a hand stays in one place: choose fewer for a short trace.
    InvalidArgument if no sample meets the field, the frames do not fit each other, or an argument is out of
    range.
    """
    if blocks < MIN_BLOCKS:
        raise InvalidArgument("blocks", repr(blocks), f"at least {MIN_BLOCKS}")
    frames = Frames(symbols, "symbols")
    if isinstance(symbols, FieldSymbols):
        rate_hz = None
    elif rate_hz is None or not (np.isfinite(rate_hz) and rate_hz > 0):
        raise InvalidArgument(
            "rate_hz", repr(rate_hz), "the positive number of frames per second of the medium"
        )
    met, in_time = _symbols_met(trace, frames, rate_hz)
    if not len(met):
        raise InvalidArgument("trace", *_where_it_was(trace, frames.grid, rate_hz))
    counts = Counts.of(met, blocks=blocks if interval else 0)
    notes = _notes(trace, in_time, len(met))
    if interval and counts.blocks is None:
        few = f"{len(met)} samples of {len(counts.cells)} symbols fill fewer than {MIN_BLOCKS} blocks"
        notes.append(f"no interval: {few}")
    return replace(
        counts, quantiser=frames.quantiser, weighting="interaction", variables=("S",),
        alphabet=frames.alphabet, notes=tuple(notes),
    )  # fmt: skip


def _cells(positions_m: Float64s, grid: Grid) -> Int64s:
    """Return the raster index of the cell of each position, int64 [n].

    -1 outside the grid.
    """
    with np.errstate(over="ignore"):  # a position of 1e300 m is far away, and no error
        nearest = np.floor(grid.to_index(positions_m) + 0.5)
    inside = ((nearest >= 0) & (nearest < grid.shape)).all(axis=1)
    cells = np.full(len(nearest), -1, np.int64)
    cells[inside] = np.ravel_multi_index(tuple(nearest[inside].astype(np.int64).T), grid.shape)
    return cells


def _symbols_met(trace: Trace, frames: Frames, rate_hz: float | None) -> tuple[Int32s, int]:
    """The symbol at each sample that meets the medium, in order of time.

    Also returns the number of samples during the medium. Times never decrease, so that the positions during a
    frame are a slice.
    """
    frame = np.zeros(len(trace)) if rate_hz is None else np.floor(trace.times_s * rate_hz + _LATE)
    parts, in_time = [np.zeros(0, np.int32)], 0
    for number in np.unique(frame[(frame >= 0) & (frame < frames.count)]):
        start, stop = np.searchsorted(frame, [number, number + 1])
        cells = _cells(trace.positions_m[start:stop], frames.grid)
        index = np.stack(np.unravel_index(cells[cells >= 0], frames.grid.shape), axis=-1)
        parts.append(frames.take(int(number)).symbols_at(index))
        in_time += int(stop - start)
    return np.concatenate(parts), in_time


def _where_it_was(trace: Trace, grid: Grid, rate_hz: float | None) -> tuple[str, str, str]:
    """Return the parts of the error message for a trace that never meets the field."""

    def box(low: Any, high: Any) -> str:
        return " to ".join(f"({', '.join(f'{x:.4g}' for x in corner)})" for corner in (low, high)) + " m"

    when = "" if rate_hz is None else f" from {trace.times_s[0]:.6g} to {trace.times_s[-1]:.6g} s"
    found = (
        f"positions from {box(trace.positions_m.min(0), trace.positions_m.max(0))}{when}, none of them in "
        "the field"
    )
    return found, f"positions within {box(*grid.box_m)}, in the medium's time", "Shift or scale the trace."


def _notes(trace: Trace, in_time: int, samples: int) -> list[str]:
    """Return notes on omitted samples and irregular sampling.

    `in_time` is the number of samples during the frames, `samples` the number of those inside the box.
    """
    notes = []
    if early_or_late := len(trace) - in_time:
        notes.append(
            f"{early_or_late} of {len(trace)} samples of the trace are before the first frame or after the "
            "last and "
            "were left out"
        )
    if outside := in_time - samples:
        notes.append(
            f"{outside} of {len(trace)} samples of the trace lie outside the box of the field and were left "
            "out"
        )
    steps = np.diff(trace.times_s)
    if len(steps) and steps.max() > _UNEVEN * max(np.median(steps), 0.0):
        notes.append(
            f"the trace is not sampled regularly (steps of {steps.min():.3g} to {steps.max():.3g} s): a "
            "visit is a "
            "sample and not a duration"
        )
    return notes
