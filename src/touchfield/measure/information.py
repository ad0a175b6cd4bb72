"""Computes entropy, conditional entropy, mutual information and distances between media, each with unit and
interval (paper section 3).

Paper section 3 defines H(X), H(X,Y), H(X|Y) and I(X;Y). Each function takes `Counts`, or arrays of integers
or booleans of any size and shape, which it counts; samples at the same index of several arrays are one joint
sample. It returns a `Quantity`: the value with its unit, estimator and interval. In addition to the paper's
four measures there are variation of information (M. Meila, J. Multivariate Analysis 98, 2007), normalised
mutual information, total correlation, and the root of the Jensen-Shannon divergence (D. M. Endres and J. E.
Schindelin, IEEE Trans. Inf. Theory 49, 2003).

Quantities of several variables are computed from entropies by one estimator, I = H(X) + H(Y) - H(X,Y) and so
on, so that the identities between them hold for any estimator. A bias-corrected I(X;Y) may then be negative;
it is reported as such, with a note, and never clipped. Intervals allow for the dependence of neighbours
(`touchfield.measure.quantity.spread`).
FewSamplesWarning if there are fewer than ten samples per symbol; InvalidArgument if there is no sample, one
is not a whole number, or an option is out of range.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s, Int64s
from touchfield.errors import InvalidArgument, require_one_of
from touchfield.measure.counts import ABSENT, BLOCKS, Counts
from touchfield.measure.dependence import Statistic
from touchfield.measure.estimators import ESTIMATORS, entropy_bits, estimate_bits
from touchfield.measure.quantity import MIN_BLOCKS, FewSamplesWarning, Quantity, Spread, spread

_FEW = 10  # samples per symbol; fewer cause a warning


def entropy(
    *samples: ArrayLike | Counts,
    column: int | None = None,
    estimator: str = "plug-in",
    interval: bool = True,
    blocks: int = BLOCKS,
) -> Quantity:
    """Return H(X) of one variable, or the joint H(X,Y,..) of several, bits per sample.

    `samples`: Counts, or arrays of integers or booleans of one shape. `column`: the one variable of the
    counts to use. `estimator`: one of `touchfield.measure.estimators.ESTIMATORS`; given probabilities have an
    exact entropy. `interval`: whether to compute one; it takes about as long again as the counting, plus
    up to 700 evaluations of the plug-in estimate. `blocks`: number of blocks of arrays for an interval, 8 or
    more.
    """
    e = _Entropies(samples, estimator, interval, blocks)
    if column is not None:
        e.symbols = int(e.ranks(column).max(initial=-1)) + 1
        return e.quantity(f"H({e.names[column]})", lambda w: e.column(column, w))
    max_bits = math.inf if e.counts.alphabet is None else math.log2(e.counts.alphabet)
    return e.quantity(f"H({','.join(e.names)})", e.joint, max_value=max_bits)


joint_entropy = entropy
"""H(X,Y,..), bits a joint sample, of several arrays or of `Counts`."""


def conditional_entropy(
    *samples: ArrayLike | Counts,
    given: int = 1,
    estimator: str = "plug-in",
    interval: bool = True,
    blocks: int = BLOCKS,
) -> Quantity:
    """H(X|Y) = H(X,Y) - H(Y), bits per sample.

    Y is the variable of column `given`, X all others.
    """
    e = _Entropies(samples, estimator, interval, blocks, min_variables=2)
    if given not in range(len(e.names)):
        raise InvalidArgument("given", f"{given}", f"0 to {len(e.names) - 1}")
    others = ",".join(name for i, name in enumerate(e.names) if i != given)
    return e.quantity(f"H({others}|{e.names[given]})", lambda w: e.sum(e.joint(w), -e.column(given, w)))


def mutual_information(
    *samples: ArrayLike | Counts, estimator: str = "plug-in", interval: bool = True, blocks: int = BLOCKS
) -> Quantity:
    """I(X;Y) = H(X) + H(Y) - H(X,Y), bits per sample.

    With a bias-corrected estimator it may be negative, which is noted. The plug-in estimate is high by about
    (K_xy - K_x - K_y + 1)/(2 n ln 2) bits.
    """
    e = _Entropies(samples, estimator, interval, blocks, min_variables=2)
    return e.quantity(f"I({e.names[0]};{e.names[1]})", e.mutual)


def total_correlation(
    *samples: ArrayLike | Counts, estimator: str = "plug-in", interval: bool = True, blocks: int = BLOCKS
) -> Quantity:
    """T(X;Y;..) = H(X) + H(Y) + .. - H(X,Y,..), bits per joint sample (S. Watanabe, IBM Journal 4, 1960).

    It is 0 if and only if the variables are independent, and I(X;Y) for two. The plug-in estimate is high by
    about (K_joint - K_x - K_y - .. + d - 1)/(2 n ln 2) bits for d variables, so that n has to be large
    compared with the number of joint symbols that occur. With a bias-corrected estimator it may be negative,
    which is noted.
    """
    e = _Entropies(samples, estimator, interval, blocks, min_variables=2)
    columns = range(len(e.names))
    return e.quantity(
        f"T({';'.join(e.names)})", lambda w: e.sum(*(e.column(i, w) for i in columns), -e.joint(w))
    )


def variation_of_information(
    *samples: ArrayLike | Counts, estimator: str = "plug-in", interval: bool = True, blocks: int = BLOCKS
) -> Quantity:
    """VI(X,Y) = H(X|Y) + H(Y|X), bits per sample.

    With plug-in it is a metric between arrays.
    """
    e = _Entropies(samples, estimator, interval, blocks, min_variables=2)
    return e.quantity(
        f"VI({e.names[0]},{e.names[1]})", lambda w: e.sum(2 * e.joint(w), -e.column(0, w), -e.column(1, w))
    )


def normalised_mutual_information(
    *samples: ArrayLike | Counts, estimator: str = "plug-in", interval: bool = True, blocks: int = BLOCKS
) -> Quantity:
    """I(X;Y) over sqrt(H(X) H(Y)).

    0 to 1 with plug-in; NaN with a note if nothing varies.
    """
    e = _Entropies(samples, estimator, interval, blocks, min_variables=2)

    def ratio(w: Int64s | Float64s) -> float:
        below = math.sqrt(e.column(0, w) * e.column(1, w))
        return e.mutual(w) / below if below > 0 else math.nan

    return e.quantity(f"NMI_sqrt({e.names[0]};{e.names[1]})", ratio, "1", 1.0)


def jensen_shannon_distance(
    *samples: ArrayLike | Counts, absent: int = ABSENT, interval: bool = True, blocks: int = BLOCKS
) -> Quantity:
    """sqrt(JSD) between the distributions of two variables, 0 to 1; a metric.

    Both distributions have weight 1/2. Two arrays may differ in size and shape. Two `Counts` of one variable
    each are combined side by side; for `Counts` of two variables the distance is between the two columns. A
    symbol `absent` marks a cell of the other column alone. The estimate is always plug-in, because the
    mixture has no counts that another estimator could correct. It is biased high for small samples.
    """
    if len(samples) == 2:
        first, second = (_counted((s,), interval, blocks) for s in samples)
        if first.blocks is not None and second.blocks is not None and len(first.blocks) != len(second.blocks):
            fewer = min(len(first.blocks), len(second.blocks))
            first, second = (_counted((s,), interval, fewer) for s in samples)
        samples = (Counts.side_by_side(first, second),)
    e = _Entropies(samples, "plug-in", interval, blocks, min_variables=2)
    is_present = [e.counts.cells[:, i] != absent for i in (0, 1)]
    columns = [e.counts.cells[k, i] for i, k in enumerate(is_present)]
    symbols = np.union1d(*columns)
    ranks = [np.searchsorted(symbols, c) for c in columns]

    def distance(w: Int64s | Float64s) -> float:
        p, q = (np.bincount(at, w[k], len(symbols)) for at, k in zip(ranks, is_present, strict=True))
        if not (p.any() and q.any()):
            return math.nan
        return math.sqrt(jensen_shannon_bits(p / p.sum(), q / q.sum()))

    e.symbols, e.fewest = len(symbols), min(int(e.counts.weights[k].sum()) for k in is_present)
    return e.quantity(f"sqrt(JSD({e.names[0]},{e.names[1]}))", distance, "sqrt(bit)", 1.0)


def jensen_shannon_bits(p: Float64s, q: Float64s) -> float:
    """H((p + q)/2) - (H(p) + H(q))/2 of probabilities.

    It is computed as a sum of small terms, which do not cancel.
    """
    middle = p + q
    total = 0.0
    for probabilities in (p, q):
        is_positive = probabilities > 0
        total += float(
            (
                probabilities[is_positive]
                * (np.log2(probabilities[is_positive]) - np.log2(middle[is_positive]) + 1)
            ).sum()
        )
    return min(1.0, max(0.0, total / 2))


def _counted(samples: tuple[ArrayLike | Counts, ...], interval: bool, blocks: int) -> Counts:
    if interval and blocks < MIN_BLOCKS:
        raise InvalidArgument("blocks", f"{blocks}", "8 or more", "Give interval=False for none.")
    if len(samples) == 1 and isinstance(samples[0], Counts):
        notes = tuple(note for note in samples[0].notes if not note.startswith("no interval"))
        return samples[0] if interval else replace(samples[0], blocks=None, notes=notes)
    if any(isinstance(s, Counts) for s in samples):
        raise InvalidArgument("samples", "several Counts", "one, of all variables together")
    return Counts.of(*samples, blocks=blocks if interval else 0)  # type: ignore[arg-type]


class _Entropies:
    """The entropies of columns of cells as statistics of the cells' weights.

    All are computed by one estimator.
    """

    def __init__(
        self,
        samples: tuple[ArrayLike | Counts, ...],
        estimator: str,
        interval: bool,
        blocks: int,
        min_variables: int = 1,
    ) -> None:
        self.counts = _counted(samples, interval, blocks)
        d = self.counts.cells.shape[1]
        if d < min_variables:
            raise InvalidArgument("samples", f"{d} variable", f"{min_variables}")
        self.names = self.counts.variables[:d]
        require_one_of("estimator", estimator, ESTIMATORS)
        self.estimator = "exact" if self.counts.weights.dtype.kind == "f" else estimator
        self.symbols, self.fewest = len(self.counts.cells), self.counts.total
        self._ranks: dict[int, Int64s] = {}

    def ranks(self, column: int) -> Int64s:
        """Return the rank of each cell's symbol in a column, int64 [K]."""
        if column not in self._ranks:
            self._ranks[column] = np.unique(self.counts.cells[:, column], return_inverse=True)[1].reshape(-1)
        return self._ranks[column]

    def _bits(self, weights: Int64s | Float64s, alphabet: int | None = None) -> float:
        if self.estimator in ("exact", "plug-in"):
            return entropy_bits(weights)
        return estimate_bits(weights, self.estimator, alphabet)

    def column(self, column: int, weights: Int64s | Float64s) -> float:
        """H of one column, bits."""
        return self._bits(np.bincount(self.ranks(column), weights))  # below 2^53 exact

    def joint(self, weights: Int64s | Float64s) -> float:
        """H of all columns, bits."""
        return self._bits(weights, self.counts.alphabet)

    def mutual(self, weights: Int64s | Float64s) -> float:
        """I of two columns, bits."""
        return self.sum(self.column(0, weights), self.column(1, weights), -self.joint(weights))

    def sum(self, *terms: float) -> float:
        """Return the sum of terms.

        Plug-in sums are clipped at 0, because only rounding can make them negative.
        """
        total = math.fsum(terms)
        return total + 0.0 if self.estimator not in ("exact", "plug-in") else max(0.0, total)  # 0, and not -0

    def quantity(
        self, name: str, statistic: Statistic, unit: str = "bit/sample", max_value: float = math.inf
    ) -> Quantity:
        """Return a statistic of the weights as a quantity with interval and notes.

        Its range is 0 to `max_value`.
        """
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
        elif value > max_value + 1e-9:
            notes.append(
                f"above {max_value:g}, which no true value is: the bias correction of {self.estimator} did it"
            )
        if self.estimator != "exact" and self.fewest < _FEW * self.symbols:
            few = f"few samples: {self.fewest} for {self.symbols} symbols, fewer than {_FEW} to each"
            notes.append(few)
            warnings.warn(f"{name}: {few}", FewSamplesWarning, stacklevel=3)
        found = Spread(None, None)
        if c.blocks is not None and not math.isnan(value):
            found = self._spread(statistic, c.blocks, value, max_value)
        return Quantity(
            name,
            value,
            unit,
            quantiser=c.quantiser,
            weighting=c.weighting,
            estimator=self.estimator,
            samples=c.total,
            symbols=self.symbols,
            interval=found.interval,
            notes=(*notes, *found.notes),
            dependence=found.dependence,
        )

    def _spread(self, statistic: Statistic, blocks: Int64s, value: float, max_value: float) -> Spread:
        """Return the interval of the plug-in statistic, which holds the estimate, too."""
        estimator, self.estimator = self.estimator, "plug-in"  # the others need whole counts
        try:
            return spread(
                statistic, blocks, bounds=(0.0, max_value), layout=self.counts.layout, estimate=value
            )
        finally:
            self.estimator = estimator
