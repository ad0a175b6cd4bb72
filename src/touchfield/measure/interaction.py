"""Computes the entropy of a field as a recorded hand met it: each point counts as often as the hand was there
(paper section 6.1), for one contact or for several at once (section 5).

Section 6.1 states that "the probability mass function of the haptic medium, theoretically depends on the
interaction" and gives no method. Here X, the position at which the field is sampled, is distributed as the
visit histogram mu of a recorded probe: each lattice point counts as often as a sample of the trace lies in
its cell. The entropy of S = Q(F_t(X)) is then the information that a hand received; empty space is one more
symbol.

A visit is a sample of the trace, not a duration: a trace that is not sampled regularly in time weights slow
parts wrongly, and the result has a note. The samples of a trace are dependent, because a hand moves
continuously; therefore the interval comes from blocks of consecutive samples.

Section 5 calls the scheme "multi-contact", without a measure. Several contacts, such as fingers or points of
one tool, are here one joint variable (S_1,...,S_d) at a time, S_i = Q(F_t(X_i)). Its joint entropy is what
all contacts receive, and the total correlation (`touchfield.measure.information.total_correlation`) what they
receive more than once: I(S_1;S_2) for two. H(S_1|S_2) is what the first adds to the second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

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
_LISTED: Final = 4  # contacts whose boxes an error names


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

    It is `contact_counts` of one contact.
    """
    return contact_counts((trace,), symbols, interval, rate_hz, blocks)


def contact_counts(
    contacts: Sequence[Trace],
    symbols: Fields,
    interval: bool = True,
    rate_hz: float | None = None,
    blocks: int = 64,
) -> Counts:
    """Count the joint symbols that several contacts met, one for each sample with all within the medium.

    Samples before the first frame, after the last, or with a contact outside the box of the grid are
    omitted; notes give their numbers.

    `contacts`: one trace for each, all at the same times, such as fingers or `tool_contacts`. `symbols`: the
    quantised field; or a sequence with one for each frame, of one grid and one quantiser, which may be lazy.
    Frame f lasts from f / rate_hz to (f + 1) / rate_hz; only the first frame and those that the traces meet
    are requested. `interval`: whether to make blocks over time. `rate_hz`: frames per second, required for a
    sequence. `blocks`: number of blocks of consecutive samples, at least 8. A block should last longer than
    a hand stays in one place: choose fewer for a short trace.
    InvalidArgument if there is no contact, their times differ, no sample meets the field, the frames do not
    fit each other, there are 2^63 joint symbols or more, or an argument is out of range.
    """
    _require_same_times(contacts)
    if blocks < MIN_BLOCKS:
        raise InvalidArgument("blocks", repr(blocks), f"at least {MIN_BLOCKS}")
    frames = Frames(symbols, "symbols")
    if isinstance(symbols, FieldSymbols):
        rate_hz = None
    elif rate_hz is None or not (np.isfinite(rate_hz) and rate_hz > 0):
        raise InvalidArgument(
            "rate_hz", repr(rate_hz), "the positive number of frames per second of the medium"
        )
    met, in_time = _symbols_met(contacts, frames, rate_hz)
    if not len(met):
        raise InvalidArgument("trace", *_where_it_was(contacts, frames.grid, rate_hz))
    counts = Counts.of(*met.T, blocks=blocks if interval else 0)
    notes = _notes(contacts, in_time, len(met))
    if interval and counts.blocks is None:
        few = f"{len(met)} samples of {len(counts.cells)} symbols fill fewer than {MIN_BLOCKS} blocks"
        notes.append(f"no interval: {few}")
    count = len(contacts)
    return replace(
        counts, quantiser=frames.quantiser, weighting="interaction",
        variables=("S",) if count == 1 else tuple(f"S{i + 1}" for i in range(count)),
        alphabet=frames.alphabet**count, notes=tuple(notes),
    )  # fmt: skip


def tool_contacts(trace: Trace, points_m: ArrayLike) -> tuple[Trace, ...]:
    """Return the paths of points of a rigid tool that moves along a trace, in order.

    `points_m` float [d, 3]: metres from the probe, in the axes of the tool; the trace's quaternions, if any,
    turn them. InvalidArgument if the shape is wrong or a number is not finite.
    """
    points = np.asarray(points_m, np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise InvalidArgument("points_m", f"shape {points.shape}", "[d, 3] with d at least 1")
    if trace.quaternions is None:
        paths = trace.positions_m + points[:, None]
    else:
        w, axis = trace.quaternions[:, :1], trace.quaternions[:, 1:]
        turn = 2 * np.cross(axis, points[:, None])
        paths = trace.positions_m + points[:, None] + w * turn + np.cross(axis, turn)
    return tuple(Trace(trace.times_s, path) for path in paths)


def _require_same_times(contacts: Sequence[Trace]) -> None:
    """InvalidArgument if there is no contact, or one is sampled at other times than the first."""
    if not contacts:
        raise InvalidArgument("contacts", "no trace", "at least one")
    for i, contact in enumerate(contacts[1:], 2):
        if not np.array_equal(contact.times_s, contacts[0].times_s):
            found = f"{len(contact)} samples from {contact.times_s[0]:.6g} to {contact.times_s[-1]:.6g} s"
            expected = f"the {len(contacts[0])} times of contact 1"
            raise InvalidArgument(f"contact {i}", found, expected, "Sample all contacts at the same times.")


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


def _symbols_met(contacts: Sequence[Trace], frames: Frames, rate_hz: float | None) -> tuple[Int32s, int]:
    """The symbols of the contacts [n, d] at each sample with all within the medium, in order of time.

    Also returns the number of samples during the medium. Times never decrease, so that the positions during a
    frame are a slice.
    """
    times_s = contacts[0].times_s
    frame = np.zeros(len(times_s)) if rate_hz is None else np.floor(times_s * rate_hz + _LATE)
    parts, in_time = [np.zeros((0, len(contacts)), np.int32)], 0
    for number in np.unique(frame[(frame >= 0) & (frame < frames.count)]):
        start, stop = np.searchsorted(frame, [number, number + 1])
        cells = np.stack([_cells(c.positions_m[start:stop], frames.grid) for c in contacts], axis=1)
        cells = cells[(cells >= 0).all(axis=1)]
        index = np.stack(np.unravel_index(cells.reshape(-1), frames.grid.shape), axis=-1)
        symbols = frames.take(int(number)).symbols_at(index)
        parts.append(symbols.reshape(-1, len(contacts)))
        in_time += int(stop - start)
    return np.concatenate(parts), in_time


def _where_it_was(contacts: Sequence[Trace], grid: Grid, rate_hz: float | None) -> tuple[str, str, str]:
    """Return the parts of the error message for contacts that never meet the field together."""

    def box(low: Any, high: Any) -> str:
        return " to ".join(f"({', '.join(f'{x:.4g}' for x in corner)})" for corner in (low, high)) + " m"

    times_s = contacts[0].times_s
    when = "" if rate_hz is None else f" from {times_s[0]:.6g} to {times_s[-1]:.6g} s"
    where = "; ".join(box(c.positions_m.min(0), c.positions_m.max(0)) for c in contacts[:_LISTED])
    them = "none of them in the field" if len(contacts) == 1 else "never all of them in the field"
    found = f"positions from {where}{when}, {them}"
    return found, f"positions within {box(*grid.box_m)}, in the medium's time", "Shift or scale the trace."


def _notes(contacts: Sequence[Trace], in_time: int, samples: int) -> list[str]:
    """Return notes on omitted samples and irregular sampling.

    `in_time` is the number of samples during the frames, `samples` the number of those inside the box.
    """
    notes, times_s = [], contacts[0].times_s
    if early_or_late := len(times_s) - in_time:
        notes.append(
            f"{early_or_late} of {len(times_s)} samples of the trace are before the first frame or after the "
            "last and were left out"
        )
    if outside := in_time - samples:
        where = "lie" if len(contacts) == 1 else "have a contact"
        notes.append(
            f"{outside} of {len(times_s)} samples of the trace {where} outside the box of the field and were "
            "left out"
        )
    steps = np.diff(times_s)
    if len(steps) and steps.max() > _UNEVEN * max(np.median(steps), 0.0):
        notes.append(
            f"the trace is not sampled regularly (steps of {steps.min():.3g} to {steps.max():.3g} s): a "
            "visit is a sample and not a duration"
        )
    return notes
