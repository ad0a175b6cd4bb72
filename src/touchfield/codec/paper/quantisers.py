"""Quantisers of force amplitudes for coder `paper`: each rounds |F| to one of a few levels and defines the
thresholds between them (paper sections 4.2 and 5.2, eq. 6).

Three kinds of levels are available: Lloyd-Max, trained on samples; the Weber ladder, whose steps grow with
the force so that the relative error stays within k; and uniform steps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float32s, Float64s, Int32s, lengths_of
from touchfield.compute.threads import for_chunks
from touchfield.errors import InvalidArgument
from touchfield.perception.weber import WeberLadder

WEBER_FORCE_MIN_N: Final = 0.03
_SMALLEST_FORCE_N = 1e-30
# largest ratio that a ladder with given steps may span; its levels are then still numbers
_WIDEST_SPAN = 1e24
_HAIR = 1e-9


def amplitudes_n(vectors_n: Float32s) -> Float32s:
    """Amplitudes |F|, float32 [m], of force vectors, float32 [m, 3]."""
    return lengths_of(vectors_n.astype(np.float64)).astype(np.float32)


@dataclass(frozen=True, eq=False)
class AmplitudeLevels:
    """Quantiser of amplitudes; InvalidArgument for invalid levels."""

    levels_n: Float32s  # [n]; newtons, finite, not negative, strictly ascending, 1 to 65536 of them
    # [n - 1]; borders of the cells, by default the midpoints; an amplitude on a border takes the level above
    # it, and an amplitude outside all cells the nearest level
    thresholds_n: Float32s | None = None

    def __post_init__(self) -> None:
        levels = np.array(self.levels_n, np.float32)
        if levels.ndim != 1 or not 1 <= len(levels) <= 1 << 16:
            raise InvalidArgument("amplitude levels", f"shape {levels.shape}", "1 to 65536 levels")
        if not np.isfinite(levels).all() or levels[0] < 0 or (levels[1:] <= levels[:-1]).any():
            raise InvalidArgument(
                "amplitude levels", "levels out of order or range", "finite, ascending, from 0 up"
            )
        thresholds = self.thresholds_n
        if thresholds is None:
            wide = levels.astype(np.float64)
            thresholds = _round_up((wide[1:] + wide[:-1]) / 2)
        for name, array in (("levels_n", levels), ("thresholds_n", thresholds)):
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.levels_n)

    def encode(self, amplitudes_n: Float32s) -> NDArray[np.uint16]:
        """Indices of the levels of amplitudes, uint16 [m].

        `amplitudes_n`: float32 [m], newtons, 0 or more, else InvalidArgument.
        """
        from touchfield.codec.paper.kernels import levels_of

        amplitudes = np.ascontiguousarray(_check_amplitudes(amplitudes_n))
        out = np.empty(len(amplitudes), np.uint16)
        patterns = amplitudes.view(np.uint32)
        for_chunks(
            levels_of, len(out), amplitudes, patterns, self.thresholds_n, self._first, out, chunk=1 << 14
        )
        return out

    @cached_property
    def _first(self) -> Int32s:
        """Number of thresholds at or below the smallest number of each pattern.

        A pattern is the leading bits of a float32.
        """
        from touchfield.codec.paper.kernels import DROPPED_BITS

        assert self.thresholds_n is not None
        infinity = 0x7F800000
        patterns = np.arange((infinity >> DROPPED_BITS) + 1, dtype=np.uint32) << DROPPED_BITS
        smallest = patterns.view(np.float32)
        return np.searchsorted(self.thresholds_n, smallest, "right").astype(np.int32)


def _round_up(thresholds: Float64s) -> Float32s:
    """The smallest float32 at or above each float64 threshold.

    A float32 amplitude compares with both in the same way.
    """
    nearest = thresholds.astype(np.float32)
    return np.where(nearest < thresholds, np.nextafter(nearest, np.float32(np.inf)), nearest)


def _check_amplitudes(values: NDArray[Any]) -> Float32s:
    amplitudes = np.asarray(values, np.float32)
    if amplitudes.ndim != 1 or not (np.isfinite(amplitudes).all() and amplitudes.min(initial=0.0) >= 0):
        raise InvalidArgument(
            "amplitudes", "a shape, a sign or a value that none has", "newtons [m], 0 or more"
        )
    return amplitudes


def weber_levels(ladder: WeberLadder) -> AmplitudeLevels:
    """Levels of a Weber ladder with a zero bin.

    Level 0 is zero and level i + 1 is r_i; forces below F_min become zero.
    """
    return AmplitudeLevels(ladder.levels_n, _round_up(ladder.thresholds_n))


def weber_ladder(k: float, top_n: float, steps: int | None = None) -> WeberLadder:
    """Ladder of the corrected eq. 6 with Weber fraction k up to `top_n` newtons.

    `top_n` is 0 if there is no force. `steps`, if given, is the number of levels above zero, counted from the
    top down: 63 levels at k = 0.05 span 547:1, which is 6 bits together with the zero. Otherwise there are as
    many levels as k needs from 0.03 N on. InvalidArgument if a number is out of range.
    """
    if steps is None:
        return WeberLadder.spanning(k, WEBER_FORCE_MIN_N, max(WEBER_FORCE_MIN_N, top_n))
    rise = math.log(WeberLadder(k, 1.0, 1).ratio)
    if not (steps >= 1 and steps * rise <= math.log(_WIDEST_SPAN)):
        expected = f"from 1 on, to a span of {_WIDEST_SPAN:g}:1"
        raise InvalidArgument(
            "Weber ladder",
            f"{steps} steps at k = {k:g}",
            expected,
            "Take fewer bits (--nq) or a smaller --k.",
        )
    # slightly enlarged, so that rounding does not place the largest force outside the ladder
    lowest = math.exp(math.log(top_n or WEBER_FORCE_MIN_N) - steps * rise) * (1 + _HAIR)
    return WeberLadder(k, max(_SMALLEST_FORCE_N, lowest), steps)


def uniform_levels(step_n: float, top_n: float) -> AmplitudeLevels:
    """Multiples of a step up to `top_n` newtons.

    InvalidArgument for more than 65536 levels, or an invalid step.
    """
    if not 1e-30 <= step_n <= 1e30:
        raise InvalidArgument("step_n", repr(step_n), "newtons, from 1e-30 to 1e30")
    count = math.floor(min(top_n / step_n, 1e9) + 0.5) + 1
    if count > 1 << 16:
        raise InvalidArgument("uniform quantiser", f"{count} levels", "1 to 65536", "Take a larger step_n.")
    return AmplitudeLevels((step_n * np.arange(count)).astype(np.float32))


_ITERATIONS = 300
_MOVES = 32
_TOLERANCE = 1e-6


def lloyd_max_levels(samples_n: NDArray[Any], nq: float) -> AmplitudeLevels:
    """At most 2^nq levels of least mean squared error for samples [m] (Lloyd-Max).

    Source: section 5.2. The result is a local optimum of Lloyd's iteration: each level is the mean of its
    cell, and each threshold lies midway between two levels. The iteration starts from levels whose density is
    the cube root of that of the samples (Panter and Dite). If the samples have no more distinct values than
    there are levels, these values are the levels. Weber's law is not taken into account: report how often the
    result violates the mask. InvalidArgument if `nq` is not 1 to 12, or a sample is not an amplitude.
    """
    if nq != int(nq) or not 1 <= nq <= 12:
        raise InvalidArgument("nq", repr(nq), "1 to 12 bits of amplitude")
    values = np.sort(_check_amplitudes(samples_n) + np.float32(0))  # no negative zero
    if not len(values):
        return AmplitudeLevels(np.zeros(1, np.float32))
    distinct = np.unique(values)
    if len(distinct) <= 1 << int(nq):
        return AmplitudeLevels(distinct)
    wide, count = values.astype(np.float64), 1 << int(nq)
    best_means, smallest_error = wide[:1], math.inf
    thresholds = _compand(wide, count)
    for _ in range(_MOVES):
        counts, means, errors = _lloyd(wide, thresholds, count)
        total = float(errors.sum())
        if total >= smallest_error * (1 - _TOLERANCE):
            break
        best_means, smallest_error = means, total
        # merge the two levels that cost least to merge, and split the cell with the largest error
        costs = counts[1:] * counts[:-1] / (counts[1:] + counts[:-1]) * np.diff(means) ** 2
        merged, split = int(costs.argmin()), int(errors.argmax())
        thresholds = np.delete((best_means[1:] + best_means[:-1]) / 2, merged)
        thresholds = np.sort(np.append(thresholds, best_means[split]))
    return AmplitudeLevels(np.unique(best_means.astype(np.float32)))


def _lloyd(values: Float64s, thresholds: Float64s, count: int) -> tuple[Float64s, Float64s, Float64s]:
    """Lloyd's iteration on ascending values.

    Returns the number of values, the mean and the squared error of each cell, float64 [n]. If a cell becomes
    empty, the cell with the largest error is split.
    """
    sums, squares = (np.concatenate([[0.0], np.cumsum(x)]) for x in (values, values * values))
    previous_error = math.inf
    for _ in range(_ITERATIONS):
        edges = np.unique(np.concatenate([[0], np.searchsorted(values, thresholds), [len(values)]]))
        counts = np.diff(edges).astype(np.float64)
        means = np.diff(sums[edges]) / counts
        errors = np.diff(squares[edges]) - np.diff(sums[edges]) * means
        missing = count - len(means)
        total = float(errors.sum())
        if not missing and previous_error - total <= _TOLERANCE * total:
            break
        largest_errors = np.argsort(-errors, kind="stable")[:missing]
        thresholds, previous_error = (
            np.sort(np.concatenate([(means[1:] + means[:-1]) / 2, means[largest_errors]])),
            total,
        )
    return counts, means, errors


def _compand(values: Float64s, count: int) -> Float64s:
    """Thresholds at equal steps of the integral of (density)^(1/3)."""
    bins = max(256, 4 * count)
    ranks = np.linspace(0, len(values) - 1, bins + 1).astype(np.int64)
    borders = np.unique(np.concatenate([np.linspace(values[0], values[-1], bins + 1), values[ranks]]))
    counts = np.diff(np.searchsorted(values, borders, "right"))
    integral = np.concatenate([[0.0], np.cumsum(np.cbrt(counts * np.diff(borders) ** 2))])
    thresholds: Float64s = np.interp(integral[-1] * np.arange(1, count) / count, integral, borders)
    return thresholds
