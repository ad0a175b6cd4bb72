"""From counts to a `Quantity`: the value, its block-bootstrap interval, and what a reader must be told.

Departure from the estimators' literature: quantities of several variables are made of entropies by the same
estimator, I = H(X) + H(Y) - H(X,Y) and so on, so that the identities between them hold whatever the estimator. A
bias-corrected I(X;Y) may then be negative; it is reported so, with a note, and never clipped.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.measure.distribution import normaliser_bits
from touchfield.measure.estimators import ESTIMATORS, estimate_bits
from touchfield.measure.quantity import FewSamplesWarning, Interval, Quantity

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int64s = NDArray[np.int64]

__all__ = ["Counted", "Entropies", "Statistic", "measured"]

Statistic = Callable[["NDArray[np.int64]"], float]
"""Of the counts int64 [K] of cells; NaN where it does not exist."""

LEAST_BLOCKS = 8
_FEW = 10  # samples to a symbol


@dataclass(frozen=True)
class Counted:
    """Counts of cells and what they are of.

    Attributes
    ----------
    counts : int64 [K]
        Of each cell (symbol or joint symbol).
    blocks : int64 [B, K] or None
        The same, block by block; None for no interval.
    fewest : int
        Samples of the smallest variable's array, for the warning; usually n.
    estimator, quantiser, weighting : str
        As in `Quantity`.
    notes : tuple of str
    warns : bool
        Whether few samples are worth a warning; they are worth a note always.
    symbols : int, optional
        K, where it is not the number of cells with a count.
    """

    counts: Int64s
    blocks: Int64s | None
    fewest: int
    estimator: str = "plug-in"
    quantiser: str = "as given"
    weighting: str = "samples"
    notes: tuple[str, ...] = ()
    warns: bool = True
    symbols: int | None = None


@dataclass(frozen=True)
class Entropies:
    """The entropies of the columns of joint cells, all by one estimator, as statistics of the cells' counts.

    Attributes
    ----------
    estimator : str
        One of `touchfield.measure.estimators.ESTIMATORS`.
    places : tuple of int64 [K]
        For each column, which of its symbols a cell has.
    alphabets : tuple of (int or None)
        For each column how many symbols there are; then for the joint symbol.
    """

    estimator: str
    places: tuple[Int64s, ...]
    alphabets: tuple[int | None, ...]

    def column(self, axis: int, counts: Int64s) -> float:
        """H of one column, bits."""
        total = np.zeros(int(self.places[axis].max()) + 1, np.int64)
        np.add.at(total, self.places[axis], counts)
        return self._bits(total, self.alphabets[axis])

    def joint(self, counts: Int64s) -> float:
        """H of all columns, bits."""
        return self._bits(counts, self.alphabets[-1])

    def most_bits(self) -> float:
        """The greatest value of `joint`, log2 of the joint alphabet; infinity where that is not known."""
        alphabet = self.alphabets[-1]
        return math.log2(alphabet) if alphabet is not None and alphabet >= 1 else math.inf

    def given(self, axis: int, counts: Int64s) -> float:
        """H of the other columns given one, bits."""
        return self._sum(self.joint(counts), -self.column(axis, counts))

    def mutual(self, counts: Int64s) -> float:
        """I of two columns, bits."""
        return self._sum(self.column(0, counts), self.column(1, counts), -self.joint(counts))

    def variation(self, counts: Int64s) -> float:
        """VI of two columns, bits."""
        return self._sum(2 * self.joint(counts), -self.column(0, counts), -self.column(1, counts))

    def normalised(self, by: str, counts: Int64s) -> float:
        """I over one of `touchfield.measure.distribution.NORMALISATIONS`; NaN where that is 0."""
        below = normaliser_bits(self.column(0, counts), self.column(1, counts), self.joint(counts), by)
        return self.mutual(counts) / below if below > 0 else math.nan

    def _bits(self, counts: Int64s, alphabet: int | None) -> float:
        return estimate_bits(counts, self.estimator, alphabet)

    def _sum(self, *terms: float) -> float:
        """The sum; of plug-in entropies it cannot be negative but by rounding."""
        total = math.fsum(terms)
        return max(0.0, total) if self.estimator == "plug-in" else total + 0.0  # 0, and not -0


def measured(
    name: str,
    statistic: Statistic,
    counted: Counted,
    unit: str = "bit/sample",
    most: float = math.inf,
) -> Quantity:
    """A statistic of counts with its interval and notes.

    Parameters
    ----------
    name : str
        The usual notation.
    statistic : callable
        Of counts int64 [K].
    counted : Counted
    unit : str
    most : float
        The greatest value that the quantity can have; the least is 0.

    Warns
    -----
    FewSamplesWarning
        If there are fewer than ten samples to a symbol.

    Raises
    ------
    InvalidArgument
        If there is no sample, or the estimator is unknown.
    """
    if not len(counted.counts):
        raise InvalidArgument("samples", "no sample", "at least one")
    value = statistic(counted.counts)
    notes = list(counted.notes)
    if math.isnan(value):
        notes.append("0/0: nothing varies, so there is nothing to be divided by")
    elif value < 0:
        notes.append(f"negative, which no true value is: the bias correction of {counted.estimator} is larger")
    elif value > most:
        notes.append(f"above {most:g}, which no true value is: the bias correction of {counted.estimator} did it")
    symbols = int(np.count_nonzero(counted.counts)) if counted.symbols is None else counted.symbols
    if counted.fewest < _FEW * symbols:
        few = f"few samples: {counted.fewest} for {symbols} symbols, fewer than {_FEW} to each"
        notes.append(few)
        if counted.warns:
            warnings.warn(f"{name}: {few}", FewSamplesWarning, stacklevel=3)
    spread = None
    if counted.blocks is not None and not math.isnan(value):
        spread, why = _interval(statistic, counted.blocks, most, ESTIMATORS[counted.estimator].corrects_bias)
        notes += why
    return Quantity(
        name,
        value,
        unit,
        quantiser=counted.quantiser,
        weighting=counted.weighting,
        estimator=counted.estimator,
        samples=int(counted.counts.sum()),
        symbols=symbols,
        interval=spread,
        notes=tuple(notes),
    )


def _interval(
    statistic: Statistic, blocks: Int64s, most: float, corrects_bias: bool
) -> tuple[Interval | None, list[str]]:
    from touchfield.measure import bootstrap

    held = int(np.count_nonzero(blocks.any(axis=1)))
    if held < LEAST_BLOCKS:
        return None, [f"no interval: {held} blocks with samples, fewer than {LEAST_BLOCKS}"]
    missing = 0

    def defined(counts: Int64s) -> float:
        nonlocal missing
        value = statistic(counts)
        if math.isnan(value):
            missing += 1
            return 0.0
        return value

    made = bootstrap.interval(defined, blocks, bounds=(0.0, most), corrects_bias=corrects_bias)
    return made, [f"{missing} resamples without any variation count as 0"] if missing else []
