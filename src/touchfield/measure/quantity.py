"""A measured quantity: never a bare number (paper section 3.1, which names neither Q nor the random variable).

Every measure of this room returns a `Quantity`, which says what the number is an estimate of: the unit, the
quantiser Q, the weighting mu of the samples, the estimator, how many samples and symbols it saw, and an interval.
`measured` makes it of `Counted`, the one value for counts.

Quantities of several variables are made of entropies by one estimator, I = H(X) + H(Y) - H(X,Y) and so on, so that
the identities between them hold whatever the estimator. A bias-corrected I(X;Y) may then be negative; it is reported
so, with a note, and never clipped.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from touchfield.arrays import Int64s
from touchfield.errors import InvalidArgument
from touchfield.measure.bootstrap import Interval, interval
from touchfield.measure.estimators import ESTIMATORS, estimate_bits

WEIGHTINGS = ("samples", "voxel", "object", "interaction")
"""mu: each sample of an array as often as it is there; each voxel of the lattice; each voxel whose quantised force
is not zero; each voxel as often as a probe was there."""


class FewSamplesWarning(UserWarning):
    """There are fewer than ten samples to a symbol: the estimate is more bias than data."""


@dataclass(frozen=True)
class Quantity:
    """A number with what it means.

    Attributes
    ----------
    name : str
        The usual notation: "H(S)", "I(X;Y)", "WMR".
    value : float
        NaN where the quantity does not exist; `notes` then says why.
    unit : str
        "bit/sample", "bit/supported voxel", "bit/frame", "bit", "1", "sqrt(bit)".
    quantiser : str
        Q; "as given" where symbols were given.
    weighting : str
        mu, one of `WEIGHTINGS`.
    estimator : str
        Its registered name; "exact" for a quantity of given probabilities.
    samples : int
        n, how many samples were seen; 0 for given probabilities.
    symbols : int
        K, how many different symbols were seen (of pairs for a joint quantity).
    interval : Interval or None
    notes : tuple of str
        What a reader must know: few samples, why a value is NaN, which guard acted.
    """

    name: str
    value: float
    unit: str
    quantiser: str = "as given"
    weighting: str = "samples"
    estimator: str = "plug-in"
    samples: int = 0
    symbols: int = 0
    interval: Interval | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.weighting not in WEIGHTINGS:
            raise InvalidArgument("weighting", repr(self.weighting), f"one of {', '.join(WEIGHTINGS)}")
        if math.isnan(self.value) and not self.notes:
            raise InvalidArgument(self.name, "NaN without a reason", "a note that says why")

    def __float__(self) -> float:
        return float(self.value)

    def of(self, **changes: Any) -> Quantity:
        """The same quantity with other fields, such as the quantiser and the weighting that only the caller knows."""
        return replace(self, **changes)

    def times(self, factor: float, unit: str, name: str | None = None) -> Quantity:
        """The quantity and its interval in another unit: bits a sample times samples a frame are bits a frame."""
        i = self.interval
        scaled = None if i is None else Interval(i.low * factor, i.high * factor, i.level, i.method)
        return replace(self, name=name or self.name, value=self.value * factor, unit=unit, interval=scaled)

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs; NaN becomes None, which JSON can hold."""
        i = self.interval
        return {
            "name": self.name,
            "value": None if math.isnan(self.value) else self.value,
            "unit": self.unit,
            "interval": None
            if i is None
            else {
                "low": i.low,
                "high": i.high,
                "level": i.level,
                "method": i.method,
                "population": i.population,
            },
            "quantiser": self.quantiser,
            "weighting": self.weighting,
            "estimator": self.estimator,
            "samples": self.samples,
            "symbols": self.symbols,
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        """One line: value, interval, unit, and what it is of."""
        i = self.interval
        spread = "" if i is None else f" [{i.low:.6g}, {i.high:.6g}]"
        return f"{self.name} = {self.value:.6g}{spread} {self.unit} (Q {self.quantiser}, mu {self.weighting})"


Statistic = Callable[["Int64s"], float]
"""Of the counts int64 [K] of cells; NaN where it does not exist."""

LEAST_BLOCKS = 8
_FEW = 10  # samples to a symbol


NORMALISATIONS: Final = ("sqrt", "min", "max", "mean", "joint")
"""Divisors of I(X;Y): sqrt(H(X) H(Y)), the smaller or larger of the two, their mean, or H(X,Y)."""


def check_normalisation(by: str) -> None:
    """InvalidArgument if `by` is not one of `NORMALISATIONS`."""
    if by not in NORMALISATIONS:
        raise InvalidArgument("by", repr(by), f"one of {', '.join(NORMALISATIONS)}")


def normaliser_bits(x_bits: float, y_bits: float, joint_bits: float, by: str) -> float:
    """The denominator of normalised mutual information, bits.

    InvalidArgument if `by` is not one of `NORMALISATIONS`.
    """
    check_normalisation(by)
    return {
        "sqrt": math.sqrt(x_bits * y_bits),
        "min": min(x_bits, y_bits),
        "max": max(x_bits, y_bits),
        "mean": (x_bits + y_bits) / 2,
        "joint": joint_bits,
    }[by]


@dataclass(frozen=True)
class Counted:
    """Counts of cells and what they are of.

    `counts` int64 [K]: of each cell (symbol or joint symbol). `blocks` int64 [B, K] or None: the same, block by
    block; None for no interval. `fewest`: samples of the smallest variable's array, for the warning; usually n.
    `estimator`, `quantiser`, `weighting`: as in `Quantity`. `warns`: whether few samples are worth a warning; they
    are worth a note always. `symbols`: K, where it is not the number of cells with a count.
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

    `estimator`: one of `touchfield.measure.estimators.ESTIMATORS`. `places` tuple of int64 [K]: for each column,
    which of its symbols a cell has. `alphabets` tuple of (int or None): for each column how many symbols there are;
    then for the joint symbol.
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

    `name`: the usual notation. `statistic`: of counts int64 [K]. `most`: the greatest value that the quantity can
    have; the least is 0. FewSamplesWarning if there are fewer than ten samples to a symbol. InvalidArgument if
    there is no sample, or the estimator is unknown.
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

    spread = interval(defined, blocks, bounds=(0.0, most), corrects_bias=corrects_bias)
    return spread, [f"{missing} resamples without any variation count as 0"] if missing else []
