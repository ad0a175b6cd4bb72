"""`Quantity`: a measured number with its unit, how it was estimated, and a confidence interval. Every measure
of the package returns it.

Paper section 3.1 names neither Q nor X. Every measure of this package returns a `Quantity`, which states what
the number estimates: the unit, the quantiser Q, the weighting mu of the samples, the estimator, the number of
samples and symbols, and an interval.

Neighbouring voxels are strongly dependent, so that an interval for independent samples would be far too
narrow. The standard error comes from the counts in blocks of neighbouring samples
(`touchfield.measure.dependence`), and is widened by the estimated bias. The interval is t standard errors to
both sides of the estimate without its bias, and of a bias-corrected estimate as well; it always contains the
estimate. A `Dependence` states the correlation length of the samples and the effective number of blocks.
If the blocks span too few lengths of the dependence, or one of them holds all that varies, there is no
interval, and a quantity that does not vary has none either: both are noted.

`bench/bench_intervals.py` measures the coverage of 95 % intervals: 95 to 97 % for 1200 fields of each of four
correlation lengths, so that they are slightly conservative (`touchfield.measure.dependence` says why).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Int64s
from touchfield.errors import InvalidArgument, require_one_of
from touchfield.measure.dependence import BlockLayout, Statistic, sampling_error
from touchfield.measure.estimators import as_array

MIN_BLOCKS: Final = 8


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
class Dependence(Report):
    """How dependent the samples of a quantity are, measured by their influence on it.

    `correlation_length`: side of the cube of samples (of the interval, in time) that counts as one
    independent sample, in samples, at least 1; NaN if unknown. `effective_blocks`: number of independent
    blocks with the same standard error. `blocks`: number of blocks that were counted.
    """

    correlation_length: float
    effective_blocks: float
    blocks: int


@dataclass(frozen=True)
class Interval(Report):
    """A range for a quantity, in its unit.

    `level`: nominal confidence level, such as 0.95. `method`: the method with its numbers, such as "spectrum
    of 64 blocks, 12.3 degrees of freedom".
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


@dataclass(frozen=True)
class Spread(Report):
    """What `spread` found: an interval, or None with a note that says why, and the dependence.

    `dependence` is None if nothing varies.
    """

    interval: Interval | None
    dependence: Dependence | None
    notes: tuple[str, ...] = ()


class FewSamplesWarning(UserWarning):
    """Warning for fewer than ten samples per symbol: the bias dominates the estimate."""


@dataclass(frozen=True)
class Quantity(Report):
    """A number with its unit, how it was measured, its interval and notes.

    `name` is the usual notation: "H(S)", "I(X;Y)", "WMR". `value` is NaN if the quantity does not exist;
    `notes` then gives the reason. `unit`: "bit/sample", "bit/supported voxel", "bit/frame", "bit", "1",
    "sqrt(bit)". `quantiser` is Q; `weighting` is mu, one of `WEIGHTINGS`; `estimator` is its registered name,
    or "exact" for given probabilities. `samples` is n; `symbols` is K, the number of different symbols that
    occur (of pairs for a joint quantity). `dependence` states how dependent the samples are; None if it was
    not measured or nothing varies. `notes`: caveats, such as few samples, or which guard had an effect.
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
    dependence: Dependence | None = None

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


# -- intervals from blocks


def spread(
    statistic: Statistic,
    block_counts: ArrayLike,
    level: float = 0.95,
    bounds: tuple[float, float] = (-math.inf, math.inf),
    *,
    layout: BlockLayout | None = None,
    estimate: float | None = None,
) -> Spread:
    """Return the interval of a statistic of counts, and the dependence of the samples.

    The same counts give the same digits. The memory is 16 bytes for each of the B x cells counts.

    `statistic`: ``statistic(counts)``, a finite number, of counts float64 [*cells] (such as a joint
    histogram) that need not be whole. `block_counts` int [B, *cells]: the counts of each block, 8 or more.
    `level`: confidence level, inside (0, 1). `bounds`: the smallest and the largest possible value of the
    estimated quantity; the interval is cut there, and extended to an estimate beyond. `layout`: how the
    blocks lie, in a row if None. `estimate`: a bias-corrected estimate of the same quantity; None for the
    statistic of all counts. InvalidArgument if there are fewer than 8 blocks; the layout has another number
    of blocks; a count is negative or not whole; there is no sample; the level is outside (0, 1); or the
    statistic is not finite.
    """
    from scipy.special import stdtrit

    layout = layout or BlockLayout((len(np.atleast_1d(np.asarray(block_counts))),))
    counts = _checked(block_counts, layout, level)
    found = sampling_error(statistic, counts, layout)
    if found.error == 0:
        return Spread(None, None, ("no interval: no block differs from another",))
    blocks = len(counts)
    dependence = Dependence(found.correlation_length, found.effective_blocks, blocks)
    if not found.is_resolved:
        few = (
            f"no interval: the samples are dependent over {found.correlation_length:.3g} samples or more, "
            f"and {blocks} blocks count as {found.effective_blocks:.1f}, too few"
        )
        return Spread(None, dependence, (few,))
    # the correction of the bias is uncertain by about its own size
    half = float(stdtrit(found.freedom, (1 + level) / 2)) * math.hypot(found.error, found.bias)
    estimate = found.value if estimate is None else estimate
    centres = [found.value - found.bias, *([estimate] if estimate != found.value else [])]
    low, high = min(centres) - half, max(centres) + half
    low, high = (min(max(edge, bounds[0]), bounds[1]) for edge in (low, high))
    method = f"spectrum of {blocks} blocks, {found.freedom:.1f} degrees of freedom"
    low, high = min(low, estimate) + 0.0, max(high, estimate) + 0.0  # 0, and not -0
    if low == high:
        return Spread(None, dependence, ("no interval: all of it lies beyond the bound of the quantity",))
    return Spread(Interval(low, high, level, method), dependence)


def _checked(block_counts: ArrayLike, layout: BlockLayout, level: float) -> Int64s:
    counts = as_array(block_counts, "block_counts")
    if counts.ndim < 2:
        raise InvalidArgument("block_counts", f"shape {counts.shape}", "[B, cells]")
    if counts.dtype.kind not in "biu":
        raise InvalidArgument("block_counts", f"values of type {counts.dtype}", "whole numbers")
    if counts.size and counts.min() < 0:
        raise InvalidArgument("block_counts", f"{counts.min()}", "counts of at least 0")
    if not 0 < level < 1:
        raise InvalidArgument("level", f"{level}", "inside (0, 1), such as 0.95")
    if len(counts) < MIN_BLOCKS:
        raise InvalidArgument(
            "block_counts", f"{len(counts)} blocks", f"at least {MIN_BLOCKS}", "Take smaller blocks."
        )
    if math.prod(layout.shape) != len(counts):
        raise InvalidArgument("layout", f"{layout.shape} blocks", f"{len(counts)}, as in block_counts")
    if not counts.any():
        raise InvalidArgument("block_counts", "no sample", "at least one")
    return counts.astype(np.int64, copy=False)
