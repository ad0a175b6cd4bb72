"""Analysis of trials: a psychometric fit with an interval, a test against chance at each level, and the power
of a design by simulation.

Threshold, slope and lapse are fitted by maximum likelihood; the interval of the threshold is that of its
profile likelihood (95 %: a drop of the log likelihood by 1.92), which may be open at an end that the trials
do not settle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument
from touchfield.study.design import StudyDesign
from touchfield.study.procedures import procedure_of
from touchfield.study.psychometric import Psychometric, SimulatedObserver

CONFIDENCE: Final = 0.95
MAX_LAPSE: Final = 0.06
_SLOPES: Final = (0.5, 15.0)
_REACH: Final = 10.0  # thresholds are searched this factor beyond the levels
_GRID: Final = 161


@dataclass(frozen=True)
class Fit:
    """A fitted psychometric function, and the interval of its threshold, None where it is open.

    `at_limit` names the parameters of the function that are at the limit of the search, which the trials do
    not settle.
    """

    function: Psychometric
    low: float | None
    high: float | None
    log_likelihood: float
    trials: int
    at_limit: tuple[str, ...] = ()

    def covers(self, threshold: float) -> bool:
        """Whether the interval contains a threshold."""
        return (self.low is None or self.low <= threshold) and (self.high is None or threshold <= self.high)


class Counts(NamedTuple):
    """Trials by level, float64 [n]: the levels that occur, ascending; all trials; the correct ones."""

    levels: Float64s
    totals: Float64s
    correct: Float64s


def counts_by_level(levels: Sequence[float], correct: Sequence[bool]) -> Counts:
    """Count the trials at each level that occurs."""
    distinct, position = np.unique(np.asarray(levels, np.float64), return_inverse=True)
    totals = np.bincount(position, minlength=len(distinct)).astype(np.float64)
    right = np.bincount(position, np.asarray(correct, np.float64), len(distinct)).astype(np.float64)
    return Counts(distinct, totals, right)


def fit_psychometric(levels: Sequence[float], correct: Sequence[bool], chance: float) -> Fit:
    """Fit threshold, slope and lapse to trials.

    `levels`: positive, `correct`: one for each. `InvalidArgument` without a trial. All or none correct is no
    error: the interval is then open.
    """
    if not len(levels):
        raise InvalidArgument("trials", "none", "one or more")
    counts = counts_by_level(levels, correct)
    thresholds = np.geomspace(counts.levels[0] / _REACH, counts.levels[-1] * _REACH, _GRID)
    profile = [_best_at(t, counts, chance) for t in thresholds]
    heights = np.array([height for height, _, _ in profile])
    peak = int(heights.argmax())
    around = thresholds[max(peak - 1, 0)], thresholds[min(peak + 1, _GRID - 1)]
    threshold, (height, slope, lapse) = _refined(around, counts, chance)
    limit = height - _drop()

    def end(indices: range) -> float | None:
        inner = threshold
        for i in indices:
            if heights[i] < limit:
                return _crossing(float(thresholds[i]), inner, limit, counts, chance)
            inner = float(thresholds[i])
        return None

    function = Psychometric(threshold, slope, chance, lapse)
    low, high = end(range(peak - 1, -1, -1)), end(range(peak + 1, _GRID))
    is_at_limit = {
        "threshold": peak in (0, _GRID - 1),
        "slope": slope <= _SLOPE_GRID[0] or slope >= _SLOPE_GRID[-1],
        "lapse": lapse >= _LAPSE_GRID[-1],  # 0 is a value, and no limit
    }
    at_limit = tuple(name for name, is_at in is_at_limit.items() if is_at)
    return Fit(function, low, high, height, int(counts.totals.sum()), at_limit)


def _drop() -> float:
    from scipy.stats import chi2

    return float(chi2.ppf(CONFIDENCE, 1)) / 2


_SLOPE_GRID: Final = np.geomspace(*_SLOPES, 25)
_LAPSE_GRID: Final = np.linspace(0.0, MAX_LAPSE, 5)


def _best_at(threshold: float, counts: Counts, chance: float) -> tuple[float, float, float]:
    """Highest log likelihood at a threshold, over slopes and lapses, with these two."""
    with np.errstate(over="ignore"):
        rise = -np.expm1(-((counts.levels / threshold) ** _SLOPE_GRID[:, None, None]))
    p = chance + (1 - chance - _LAPSE_GRID[None, :, None]) * rise
    p = np.clip(p, 1e-12, 1 - 1e-12)
    wrong = counts.totals - counts.correct
    heights = (counts.correct * np.log(p) + wrong * np.log1p(-p)).sum(axis=-1)
    i, j = np.unravel_index(int(heights.argmax()), heights.shape)
    return float(heights[i, j]), float(_SLOPE_GRID[i]), float(_LAPSE_GRID[j])


def _refined(
    around: tuple[float, float], counts: Counts, chance: float
) -> tuple[float, tuple[float, float, float]]:
    """The threshold between two others with the highest likelihood, and what is best there."""
    from scipy.optimize import minimize_scalar

    def cost(log_threshold: float) -> float:
        return -_best_at(float(np.exp(log_threshold)), counts, chance)[0]

    found = minimize_scalar(cost, bounds=tuple(np.log(around)), method="bounded")
    threshold = float(np.exp(found.x))
    return threshold, _best_at(threshold, counts, chance)


def _crossing(outer: float, inner: float, limit: float, counts: Counts, chance: float) -> float:
    """The threshold at which the profile crosses `limit`, between one outside and one inside."""
    for _ in range(20):
        middle = float(np.sqrt(outer * inner))
        is_outside = _best_at(middle, counts, chance)[0] < limit
        outer, inner = (middle, inner) if is_outside else (outer, middle)
    return inner


def level_tests(levels: Sequence[float], correct: Sequence[bool], chance: float) -> list[dict[str, Any]]:
    """For each level: rate of correct answers, its exact interval, and the exact test against chance.

    Keys are level, trials, correct, rate, low, high (Clopper and Pearson, 95 %), and p_value, the probability
    of at least so many correct answers by chance (binomial, one-sided, not corrected for several levels).
    """
    from scipy.stats import binomtest

    rows = []
    for level, total, right in zip(*counts_by_level(levels, correct), strict=True):
        result = binomtest(int(right), int(total), chance, alternative="greater")
        ends = binomtest(int(right), int(total), chance).proportion_ci(CONFIDENCE, method="exact")
        rows.append({
            "level": float(level), "trials": int(total), "correct": int(right), "rate": right / total,
            "low": float(ends.low), "high": float(ends.high), "p_value": float(result.pvalue),
        })  # fmt: skip
    return rows


def simulate(design: StudyDesign, observer: SimulatedObserver) -> tuple[list[float], list[bool]]:
    """Levels and answers of a simulated session of a design with levels."""
    procedure, ascending = procedure_of(design), sorted(design.levels)
    levels, correct = [], []
    for trial in range(design.trials):
        index = procedure.next_index()
        levels.append(ascending[index])
        correct.append(observer.is_correct(ascending[index], trial))
        procedure.update(index, correct[-1])
    return levels, correct


def power_of(design: StudyDesign, function: Psychometric, runs: int = 100) -> dict[str, Any]:
    """Simulate a design with an observer, `runs` times with other seeds.

    Stable keys: trials, runs, covered (fraction of intervals that contain the threshold), closed (fraction
    with two ends), width (median of high / low of these, None if there is none), bias (median of estimate /
    threshold), and detected (fraction of runs whose trials, all together, are above chance at 5 %).
    """
    from scipy.stats import binomtest

    fits, detected = [], 0
    for run in range(runs):
        seeded = replace(design, seed=(design.seed + run) % 2**32)
        levels, correct = simulate(seeded, SimulatedObserver(function, run))
        fits.append(fit_psychometric(levels, correct, design.chance))
        test = binomtest(sum(correct), len(correct), design.chance, alternative="greater")
        detected += int(test.pvalue < 0.05)
    widths = [fit.high / fit.low for fit in fits if fit.low is not None and fit.high is not None]
    return {
        "trials": design.trials,
        "runs": runs,
        "covered": float(np.mean([fit.covers(function.threshold) for fit in fits])),
        "closed": len(widths) / runs,
        "width": float(np.median(widths)) if widths else None,
        "bias": float(np.median([fit.function.threshold for fit in fits])) / function.threshold,
        "detected": detected / runs,
    }
