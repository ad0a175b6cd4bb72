"""`Quantity`: a measured number with its unit, how it was estimated, and a confidence interval. Every measure
of the package returns it.

Paper section 3.1 names neither Q nor X. Every measure of this package returns a `Quantity`, which states what
the number estimates: the unit, the quantiser Q, the weighting mu of the samples, the estimator, the number of
samples and symbols, and an interval.

Intervals come from a block bootstrap (the paper gives no intervals). Neighbouring voxels are strongly
dependent, so that resampling single voxels would give far too narrow an interval. Whole blocks are drawn
instead, with replacement, as many as there are (E. Carlstein, Annals of Statistics 14, 1986; S. N. Lahiri,
Resampling Methods for Dependent Data, 2003, chapter 12). As blocks do not overlap, every statistic of counts
can be resampled from B tables.

Plug-in estimates have the *basic* interval, 2 E - q_high .. 2 E - q_low, for the estimate E and the quantiles
q of the resamples: a resample has fewer symbols than the data, just as the data have fewer than the source,
and the percentile interval q_low .. q_high would count this bias twice. Its half-widths are multiplied by
sqrt(B/(B - 1)) t/z, Student's t with B - 1 degrees of freedom over the normal quantile, and it is extended to
contain E. A bias-corrected estimate has the *normal* interval, E -+ t sqrt(B/(B - 1)) times the standard
deviation of the resamples.

The measured coverage is documented in `tests/measure/test_bootstrap.py`: 89 % to 94 % for plug-in estimates
of dependent samples, where the percentile interval has 58 % to 94 %; 94 % to 97 % for bias-corrected H; 87 %
to 95 % for ratios. For the plug-in H of Gaussian fields of correlation exp(-r^2/2L^2), 27 blocks cover 92 %
at 64^3 samples with L = 5, and 77 % with L = 8: there should be 16 blocks or more, each many times as long as
the dependence.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s, Int64s
from touchfield.errors import InvalidArgument, require_one_of
from touchfield.measure.estimators import as_array

MIN_BLOCKS: Final = 8
MIN_REPLICATES: Final = 50
_CHUNK_VALUES: Final = 1 << 22


WEIGHTINGS = ("samples", "voxel", "object", "interaction")
"""mu: each sample of an array; each voxel of the lattice; each voxel whose quantised force is not zero; each
voxel as often as a probe visited it."""


class Report:
    """A dataclass whose fields are reported by name."""

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs; NaN becomes None, which JSON can hold."""
        return {f.name: _plain(getattr(self, f.name)) for f in fields(self)}  # type: ignore[arg-type]


def _plain(value: Any) -> Any:
    if isinstance(value, Report):
        return value.summary()
    if isinstance(value, float) and math.isnan(value):
        return None
    return list(value) if isinstance(value, tuple) else value


@dataclass(frozen=True)
class Interval(Report):
    """A range for a quantity, in its unit, from a resampling.

    `level`: nominal confidence level, such as 0.95. `method`: the method with its numbers, such as "block
    bootstrap, 27 blocks, 200 resamples".
    """

    population: ClassVar[str] = "media from the source of this one, of which it is a single draw"
    """The population that an interval refers to; for this one medium the value itself is exact."""

    low: float
    high: float
    level: float
    method: str

    def summary(self) -> dict[str, Any]:
        """See `Report`."""
        return super().summary() | {"population": self.population}


class FewSamplesWarning(UserWarning):
    """Warning for fewer than ten samples per symbol: the bias dominates the estimate."""


@dataclass(frozen=True)
class Quantity(Report):
    """A number with its unit, how it was measured, its interval and notes.

    `name` is the usual notation: "H(S)", "I(X;Y)", "WMR". `value` is NaN if the quantity does not exist;
    `notes` then gives the reason. `unit`: "bit/sample", "bit/supported voxel", "bit/frame", "bit", "1",
    "sqrt(bit)". `quantiser` is Q; `weighting` is mu, one of `WEIGHTINGS`; `estimator` is its registered name,
    or "exact" for given probabilities. `samples` is n; `symbols` is K, the number of different symbols that
    occur (of pairs for a joint quantity). `notes`: caveats, such as few samples, or which guard had an
    effect.
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
        require_one_of("weighting", self.weighting, WEIGHTINGS)
        if math.isnan(self.value) and not self.notes:
            raise InvalidArgument(self.name, "NaN without a reason", "a note that says why")

    def __float__(self) -> float:
        return float(self.value)

    def of(self, **changes: Any) -> Quantity:
        """Return the quantity with other fields, such as another quantiser."""
        return replace(self, **changes)

    def times(self, factor: float, unit: str, name: str | None = None) -> Quantity:
        """Scale the quantity and its interval to another unit.

        For example from bits per sample to bits per frame.
        """
        i = self.interval
        scaled = None if i is None else Interval(i.low * factor, i.high * factor, i.level, i.method)
        return replace(self, name=name or self.name, value=self.value * factor, unit=unit, interval=scaled)

    def __str__(self) -> str:
        """One line: value, interval, unit, quantiser and weighting."""
        i = self.interval
        spread = "" if i is None else f" [{i.low:.6g}, {i.high:.6g}]"
        return f"{self.name} = {self.value:.6g}{spread} {self.unit} (Q {self.quantiser}, mu {self.weighting})"


# -- the block bootstrap


def interval(
    statistic: Callable[[Int64s], float],
    block_counts: ArrayLike,
    replicates: int = 200,
    level: float = 0.95,
    seed: int = 0,
    bounds: tuple[float, float] = (-math.inf, math.inf),
    *,
    corrects_bias: bool = False,
) -> Interval:
    """Return a block-bootstrap interval for a statistic of counts.

    Blocks are drawn with replacement. The interval always contains the statistic of the sum of the blocks,
    and has zero width only if the statistic is the same for every resample. Blocks without a sample are
    omitted. The memory is 16 bytes for each of the B x cells counts, plus 64 MiB.

    `statistic`: ``statistic(counts)``, a finite number, of counts int64 [*cells] (such as a joint histogram).
    `block_counts` int [B, *cells]: the counts of each block, at least 8 of them with a sample. `replicates`:
    number of resamples, at least 50; the statistic is called once for each. `level`: confidence level, inside
    (0, 1). `seed`: of the draws; the same seed gives the same bits on any number of threads. `bounds`: the
    smallest and the largest possible value of the estimated quantity. The interval is cut there; if the
    estimate lies beyond a bound, the interval reaches from it at least to that bound. `corrects_bias`:
    whether the statistic corrects its own bias; the interval is then the normal one, not the basic one.
    InvalidArgument if there are fewer than 8 blocks with a sample or 50 replicates; a count is negative or
    not whole; the level is outside (0, 1); or the statistic is not finite.
    """
    from scipy.special import ndtri, stdtrit

    counts = _checked(block_counts, replicates, level)
    blocks, upper = len(counts), (1 + level) / 2
    estimate = _finite(statistic(counts.sum(axis=0)))
    values = _resample(statistic, counts, replicates, seed)

    def cut(low: float, high: float) -> tuple[float, float]:
        """Cut an interval at the bounds and extend it to the estimate; 0 instead of -0."""
        low, high = (min(max(edge, bounds[0]), bounds[1]) for edge in (low, high))
        return min(low, estimate) + 0.0, max(high, estimate) + 0.0

    # correction for few blocks, with which the resamples vary too little
    wider = float(math.sqrt(blocks / (blocks - 1)) * stdtrit(blocks - 1, upper) / ndtri(upper))
    kind, edges = "basic", (estimate, estimate)
    if not corrects_bias:
        centre = float(values.mean())
        low, high = np.quantile(values, [1 - upper, upper])
        middle = 2 * estimate - centre
        edges = cut(middle - wider * float(high - centre), middle + wider * float(centre - low))
    # a basic interval may be cut to zero width at a bound, although the resamples vary
    if corrects_bias or edges[0] == edges[1]:
        deviation = (
            float(values.std(ddof=1)) if values.min() < values.max() else 0.0
        )  # exactly 0 if all agree
        half = wider * float(ndtri(upper)) * deviation
        kind, edges = "normal", cut(estimate - half, estimate + half)
    return Interval(*edges, level, f"block bootstrap ({kind}), {blocks} blocks, {replicates} resamples")


def _checked(block_counts: ArrayLike, replicates: int, level: float) -> Int64s:
    counts = as_array(block_counts, "block_counts")
    if counts.ndim < 2:
        raise InvalidArgument("block_counts", f"shape {counts.shape}", "[B, cells]")
    if counts.dtype.kind not in "biu":
        raise InvalidArgument("block_counts", f"values of type {counts.dtype}", "whole numbers")
    if counts.size and counts.min() < 0:
        raise InvalidArgument("block_counts", f"{counts.min()}", "counts of at least 0")
    if not (replicates >= MIN_REPLICATES and int(replicates) == replicates):
        raise InvalidArgument("replicates", f"{replicates}", f"a whole number of at least {MIN_REPLICATES}")
    if not 0 < level < 1:
        raise InvalidArgument("level", f"{level}", "inside (0, 1), such as 0.95")
    filled = counts[counts.any(axis=tuple(range(1, counts.ndim)))]
    if len(filled) < MIN_BLOCKS:
        raise InvalidArgument(
            "block_counts",
            f"{len(filled)} blocks with a sample",
            f"at least {MIN_BLOCKS}",
            "Take smaller blocks.",
        )
    return filled.astype(np.int64, copy=False)


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise InvalidArgument("statistic", f"{value}", "a finite number for every resample")
    return float(value)


def _resample(statistic: Callable[[Int64s], float], counts: Int64s, replicates: int, seed: int) -> Float64s:
    """Return the statistic of each resample, [replicates].

    Resamples are multinomial weights times counts, computed in chunks.
    """
    blocks, cells = len(counts), counts.shape[1:]
    flat = counts.reshape(blocks, -1)
    used = np.flatnonzero(flat.any(axis=0))
    floats = flat[:, used].astype(
        np.float64
    )  # products and sums of whole numbers below 2^53 are exact, in any order
    rng = np.random.default_rng(seed)
    weights = rng.multinomial(blocks, np.full(blocks, 1 / blocks), size=replicates).astype(np.float64)
    at_once = max(1, _CHUNK_VALUES // max(1, flat.shape[1]))
    values = np.empty(replicates)
    for start in range(0, replicates, at_once):
        drawn = weights[start : start + at_once] @ floats
        full = np.zeros((len(drawn), flat.shape[1]), np.int64)
        full[:, used] = drawn
        for i, resample in enumerate(full):
            values[start + i] = _finite(statistic(resample.reshape(cells)))
    return values
