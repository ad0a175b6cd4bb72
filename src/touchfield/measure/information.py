"""Information measures of `Counts` (paper section 3: H(X), H(X,Y), H(X|Y), I(X;Y)), and those that compare
media.

Each function takes `Counts`, or arrays of integers or booleans, of any size and shape, to count them; samples
at the same place of several arrays are one joint sample. It returns a `Quantity`: the value with its unit,
estimator and interval. Beside the paper's four stand variation of information (M. Meila, J. Multivariate
Analysis 98, 2007), normalised mutual information and the root of the Jensen-Shannon divergence (D. M. Endres
and J. E. Schindelin, IEEE Trans. Inf. Theory 49, 2003).

Quantities of several variables are made of entropies by one estimator, I = H(X) + H(Y) - H(X,Y) and so on, so
that the identities between them hold whatever the estimator. A bias-corrected I(X;Y) may then be negative; it
is reported so, with a note, and never clipped. The interval comes from a block bootstrap: neighbours are
seldom independent, so give `blocks` so that a block is many times as long as the dependence.
FewSamplesWarning if there are fewer than ten samples to a symbol; InvalidArgument if there is no sample, one
is not a whole number, or an option is out of range.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s, Int64s
from touchfield.errors import InvalidArgument, require_one_of
from touchfield.measure.counts import ABSENT, BLOCKS, Counts
from touchfield.measure.estimators import ESTIMATORS, entropy_bits, estimate_bits
from touchfield.measure.quantity import LEAST_BLOCKS, FewSamplesWarning, Interval, Quantity, interval

Statistic = Callable[["Int64s | Float64s"], float]
"""Of the weights [K] of cells; NaN where it does not exist."""

_FEW = 10  # samples to a symbol


def entropy(
    *samples: ArrayLike | Counts,
    column: int | None = None,
    estimator: str = "plug-in",
    interval: bool = True,
    blocks: int = BLOCKS,
) -> Quantity:
    """H(X) of one variable, bits a sample, or H(X,Y,..) of all; of one `column` of counts where it is named.

    `samples`: Counts, or arrays of integers or booleans of one shape. `estimator`: one of
    `touchfield.measure.estimators.ESTIMATORS`; given probabilities have an exact entropy. `interval`: whether
    to make one; it takes about as long again as the counting, and 200 evaluations of the estimator. `blocks`:
    of the bootstrap of arrays, 8 or more.
    """
    e = _Entropies(samples, estimator, interval, blocks)
    if column is not None:
        e.symbols = int(e.places(column).max(initial=-1)) + 1
        return e.measured(f"H({e.names[column]})", lambda w: e.column(column, w))
    most = math.inf if e.counts.alphabet is None else math.log2(e.counts.alphabet)
    return e.measured(f"H({','.join(e.names)})", e.joint, most=most)


joint_entropy = entropy
"""H(X,Y,..), bits a joint sample, of several arrays or of `Counts`."""


def conditional_entropy(
    *samples: ArrayLike | Counts,
    given: int = 1,
    estimator: str = "plug-in",
    interval: bool = True,
    blocks: int = BLOCKS,
) -> Quantity:
    """H(X|Y) = H(X,Y) - H(Y), bits a sample; of the other variables given that of column `given`."""
    e = _Entropies(samples, estimator, interval, blocks, least=2)
    if given not in range(len(e.names)):
        raise InvalidArgument("given", f"{given}", f"0 to {len(e.names) - 1}")
    others = ",".join(name for i, name in enumerate(e.names) if i != given)
    return e.measured(f"H({others}|{e.names[given]})", lambda w: e.sum(e.joint(w), -e.column(given, w)))


def mutual_information(
    *samples: ArrayLike | Counts, estimator: str = "plug-in", interval: bool = True, blocks: int = BLOCKS
) -> Quantity:
    """I(X;Y) = H(X) + H(Y) - H(X,Y), bits a sample.

    With a bias-corrected estimator it may be negative, which a note then says. Plug-in is high by about
    (K_xy - K_x - K_y + 1)/(2 n ln 2) bits.
    """
    e = _Entropies(samples, estimator, interval, blocks, least=2)
    return e.measured(f"I({e.names[0]};{e.names[1]})", e.mutual)


def variation_of_information(
    *samples: ArrayLike | Counts, estimator: str = "plug-in", interval: bool = True, blocks: int = BLOCKS
) -> Quantity:
    """VI(X,Y) = H(X|Y) + H(Y|X), bits a sample; with plug-in a metric between arrays."""
    e = _Entropies(samples, estimator, interval, blocks, least=2)
    return e.measured(
        f"VI({e.names[0]},{e.names[1]})", lambda w: e.sum(2 * e.joint(w), -e.column(0, w), -e.column(1, w))
    )


def normalised_mutual_information(
    *samples: ArrayLike | Counts, estimator: str = "plug-in", interval: bool = True, blocks: int = BLOCKS
) -> Quantity:
    """I(X;Y) over sqrt(H(X) H(Y)), 0 to 1 with plug-in; NaN with a note where nothing varies."""
    e = _Entropies(samples, estimator, interval, blocks, least=2)

    def ratio(w: Int64s | Float64s) -> float:
        below = math.sqrt(e.column(0, w) * e.column(1, w))
        return e.mutual(w) / below if below > 0 else math.nan

    return e.measured(f"NMI_sqrt({e.names[0]};{e.names[1]})", ratio, "1", 1.0)


def jensen_shannon_distance(
    *samples: ArrayLike | Counts, absent: int = ABSENT, interval: bool = True, blocks: int = BLOCKS
) -> Quantity:
    """sqrt(JSD) between the distributions of two variables, 0 to 1, each of weight 1/2; a metric.

    Two arrays may differ in size and shape, and two `Counts` of one variable each are taken side by side; of
    `Counts` of two variables it is between the two columns. A symbol `absent` is none: what it stands beside
    is seen alone. Always plug-in: the mixture has no counts that another estimator could correct. High for
    small samples.
    """
    if len(samples) == 2:
        one, other = (_counted((s,), interval, blocks) for s in samples)
        if one.blocks is not None and other.blocks is not None and len(one.blocks) != len(other.blocks):
            fewer = min(len(one.blocks), len(other.blocks))
            one, other = (_counted((s,), interval, fewer) for s in samples)
        samples = (Counts.side_by_side(one, other),)
    e = _Entropies(samples, "plug-in", interval, blocks, least=2)
    kept = [e.counts.cells[:, i] != absent for i in (0, 1)]
    columns = [e.counts.cells[k, i] for i, k in enumerate(kept)]
    symbols = np.union1d(*columns)
    places = [np.searchsorted(symbols, c) for c in columns]

    def distance(w: Int64s | Float64s) -> float:
        p, q = (np.bincount(at, w[k], len(symbols)) for at, k in zip(places, kept, strict=True))
        if not (p.any() and q.any()):
            return math.nan
        return math.sqrt(jensen_shannon_bits(p / p.sum(), q / q.sum()))

    e.symbols, e.fewest = len(symbols), min(int(e.counts.weights[k].sum()) for k in kept)
    return e.measured(f"sqrt(JSD({e.names[0]},{e.names[1]}))", distance, "sqrt(bit)", 1.0)


def jensen_shannon_bits(p: Float64s, q: Float64s) -> float:
    """H((p + q)/2) - (H(p) + H(q))/2 of probabilities, by a sum of small terms that does not cancel."""
    middle = p + q
    total = 0.0
    for one in (p, q):
        is_there = one > 0
        total += float((one[is_there] * (np.log2(one[is_there]) - np.log2(middle[is_there]) + 1)).sum())
    return min(1.0, max(0.0, total / 2))


def _counted(samples: tuple[ArrayLike | Counts, ...], interval: bool, blocks: int) -> Counts:
    if interval and blocks < LEAST_BLOCKS:
        raise InvalidArgument("blocks", f"{blocks}", "8 or more", "Give interval=False for none.")
    if len(samples) == 1 and isinstance(samples[0], Counts):
        notes = tuple(note for note in samples[0].notes if not note.startswith("no interval"))
        return samples[0] if interval else replace(samples[0], blocks=None, notes=notes)
    if any(isinstance(s, Counts) for s in samples):
        raise InvalidArgument("samples", "several Counts", "one, of all variables together")
    return Counts.of(*samples, blocks=blocks if interval else 0)  # type: ignore[arg-type]


class _Entropies:
    """The entropies of the columns of cells, all by one estimator, as statistics of the cells' weights."""

    def __init__(
        self,
        samples: tuple[ArrayLike | Counts, ...],
        estimator: str,
        interval: bool,
        blocks: int,
        least: int = 1,
    ) -> None:
        self.counts = _counted(samples, interval, blocks)
        d = self.counts.cells.shape[1]
        if d < least:
            raise InvalidArgument("samples", f"{d} variable", f"{least}")
        self.names = self.counts.variables[:d]
        require_one_of("estimator", estimator, ESTIMATORS)
        self.estimator = "exact" if self.counts.weights.dtype.kind == "f" else estimator
        self.symbols, self.fewest = len(self.counts.cells), self.counts.total
        self._places: dict[int, Int64s] = {}

    def places(self, column: int) -> Int64s:
        """The rank of the symbol of a column that each cell has, int64 [K]."""
        if column not in self._places:
            self._places[column] = np.unique(self.counts.cells[:, column], return_inverse=True)[1].reshape(-1)
        return self._places[column]

    def _bits(self, weights: Int64s | Float64s, alphabet: int | None = None) -> float:
        if self.estimator in ("exact", "plug-in"):
            return entropy_bits(weights)
        return estimate_bits(weights, self.estimator, alphabet)

    def column(self, column: int, weights: Int64s | Float64s) -> float:
        """H of one column, bits."""
        return self._bits(np.bincount(self.places(column), weights))  # below 2^53 exact

    def joint(self, weights: Int64s | Float64s) -> float:
        """H of all columns, bits."""
        return self._bits(weights, self.counts.alphabet)

    def mutual(self, weights: Int64s | Float64s) -> float:
        """I of two columns, bits."""
        return self.sum(self.column(0, weights), self.column(1, weights), -self.joint(weights))

    def sum(self, *terms: float) -> float:
        """The sum; of plug-in entropies it cannot be negative but by rounding."""
        total = math.fsum(terms)
        return total + 0.0 if self.estimator not in ("exact", "plug-in") else max(0.0, total)  # 0, and not -0

    def measured(
        self, name: str, statistic: Statistic, unit: str = "bit/sample", most: float = math.inf
    ) -> Quantity:
        """A statistic of the weights with its interval and notes; `most`: the greatest value, the least is 0."""
        c = self.counts
        if not len(c.weights):
            raise InvalidArgument("samples", "no sample", "at least one")
        value = statistic(c.weights)
        notes = list(c.notes)
        if math.isnan(value):
            notes.append("0/0: nothing varies, so there is nothing to be divided by")
        elif value < 0:
            notes.append(
                f"negative, which no true value is: the bias correction of {self.estimator} is larger"
            )
        elif value > most + 1e-9:
            notes.append(
                f"above {most:g}, which no true value is: the bias correction of {self.estimator} did it"
            )
        if self.estimator != "exact" and self.fewest < _FEW * self.symbols:
            few = f"few samples: {self.fewest} for {self.symbols} symbols, fewer than {_FEW} to each"
            notes.append(few)
            warnings.warn(f"{name}: {few}", FewSamplesWarning, stacklevel=3)
        spread = None
        if c.blocks is not None and not math.isnan(value):
            spread, why = self._interval(statistic, c.blocks, most)
            notes += why
        return Quantity(
            name,
            value,
            unit,
            quantiser=c.quantiser,
            weighting=c.weighting,
            estimator=self.estimator,
            samples=c.total,
            symbols=self.symbols,
            interval=spread,
            notes=tuple(notes),
        )

    def _interval(
        self, statistic: Statistic, blocks: Int64s, most: float
    ) -> tuple[Interval | None, list[str]]:
        filled = int(np.count_nonzero(blocks.any(axis=1)))
        if filled < LEAST_BLOCKS:
            return None, [f"no interval: {filled} blocks with samples, fewer than {LEAST_BLOCKS}"]
        missing = 0

        def defined(counts: Int64s) -> float:
            nonlocal missing
            value = statistic(counts)
            missing += math.isnan(value)
            return 0.0 if math.isnan(value) else value

        spread = interval(defined, blocks, bounds=(0.0, most), corrects_bias=self.estimator != "plug-in")
        return spread, [f"{missing} resamples without any variation count as 0"] if missing else []
