"""The paired bootstrap of a ratio: a slow double, coverage where the truth is enumerated, and what has no
ratio.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal, stats

from touchfield.errors import InvalidArgument
from touchfield.measure.capacity import capacity, paired_ratio
from touchfield.measure.counts import Counts
from touchfield.measure.estimators import binary_entropy_bits, entropy_bits
from touchfield.measure.quantity import Interval, Quantity, interval

Ints = NDArray[np.int64]


def markov(rng: np.random.Generator, n: int) -> Ints:
    """A binary chain that leaves 0 with chance .05 and 1 with chance .2, from its stationary state."""
    state = int(rng.random() < 0.2)
    runs = [rng.geometric((0.05, 0.2)[(state + i) % 2]) for i in range(n)]
    return np.repeat((state + np.arange(n)) % 2, runs)[:n]


def levels(rng: np.random.Generator, n: int) -> Ints:
    """An AR(1) process of correlation .8 in 64 levels."""
    x = signal.lfilter([0.6], [1, -0.8], rng.standard_normal(n + 200))[200:]
    return np.clip(np.floor(8 * x) + 32, 0, 63).astype(np.int64)


def level_shares() -> NDArray[np.float64]:
    edges = np.concatenate([[-np.inf], (np.arange(1, 64) - 32) / 8, [np.inf]])
    return np.asarray(np.diff(stats.norm.cdf(edges)))


def counted(symbols: Ints, blocks: int) -> Ints:
    owner = np.arange(len(symbols)) * blocks // len(symbols)
    return np.bincount(owner * 64 + symbols, minlength=blocks * 64).reshape(blocks, 64)


def both(blocks: tuple[Ints, Ints]) -> tuple[Counts, Counts]:
    """Blocks [B, 64] of W and of M(W), as counts."""
    first, second = (
        Counts(np.flatnonzero(b.any(0))[:, None], b.sum(0)[b.any(0)], b[:, b.any(0)], alphabet=64)
        for b in blocks
    )
    return first, second


def test_it_equals_one_resample_of_both_after_the_other() -> None:
    w = levels(np.random.default_rng(1), 960)
    above, below = counted(w[::2] // 8, 12), counted(w, 12)
    made = paired_ratio(both((below, above)), (1, 1), math.inf)
    drawn = np.random.default_rng(0).multinomial(12, [1 / 12] * 12, size=200)
    values = np.array([entropy_bits(t @ above) / entropy_bits(t @ below) for t in drawn])
    low, high = np.quantile(values, [0.025, 0.975])
    reach = math.sqrt(12 / 11) * stats.t.ppf(0.975, 11) / stats.norm.ppf(0.975)
    estimate = entropy_bits(above.sum(0)) / entropy_bits(below.sum(0))
    middle = 2 * estimate - values.mean()
    want = min(middle - reach * (high - values.mean()), estimate), middle + reach * (values.mean() - low)
    assert made is not None and (made.low, made.high) == pytest.approx(want, abs=1e-12)
    assert made.method == "paired block bootstrap (basic), 12 blocks, 200 resamples" and made.level == 0.95


@pytest.mark.parametrize(
    ("source", "mapping", "fewer", "truth"),
    [
        # a device of half the samples, each the greater of two: its chance of 0 is that of two zeros in a row
        (
            markov,
            lambda w: w[::2] | w[1::2],
            2,
            binary_entropy_bits(0.8 * 0.95) / binary_entropy_bits(0.2) / 2,
        ),
        # a device of as many samples and a quarter of the levels
        (
            levels,
            lambda w: w // 4,
            1,
            stats.entropy(level_shares().reshape(16, 4).sum(1)) / stats.entropy(level_shares()),
        ),
    ],
    ids=["fewer samples", "fewer levels"],
)
def test_coverage_where_the_truth_is_enumerated(
    source: Callable[[np.random.Generator, int], Ints],
    mapping: Callable[[Ints], Ints],
    fewer: int,
    truth: float,
) -> None:
    """As often as it says, and far narrower than the corners of two intervals."""
    rng, n, blocks = np.random.default_rng(2), 4096, 32
    held, ours, corners = 0, [], []
    for draw in range(80):
        w = source(rng, n)
        counts = counted(w, blocks), counted(mapping(w), blocks)
        made = paired_ratio(both(counts), (n, n // fewer), math.inf)
        assert made is not None
        held += made.low <= truth <= made.high
        if draw % 8:
            continue
        ours.append(made.high - made.low)
        h, c = (interval(entropy_bits, k, 50) for k in counts)
        corners.append(c.high / h.low / fewer - c.low / h.high / fewer)
    assert 68 <= held <= 80  # 95 %: fewer than 68 of 80 with chance 10^-4
    assert np.mean(ours) < 0.4 * np.mean(corners)


def test_a_relabelling_loses_nothing_with_certainty() -> None:
    w = levels(np.random.default_rng(4), 2048)
    counts = counted(w, 16), counted(63 - w, 16)
    made = paired_ratio(both(counts), (2048, 2048), math.inf)
    assert made is not None and (made.low, made.high) == pytest.approx((1, 1), abs=1e-12)


def test_an_estimator_that_uses_the_alphabet_or_corrects_its_bias_has_its_own() -> None:
    w = levels(np.random.default_rng(5), 2048)
    counts = counted(w, 16), counted(w // 8, 16)
    corrected = paired_ratio(both(counts), (2048, 2048), math.inf, "miller-madow")
    assert corrected is not None and "normal" in corrected.method
    told = paired_ratio(both(counts), (2048, 2048), 100.0)
    assert told is not None and told.high < 100 / 2048  # never more than the device can be told


def test_without_variation_there_is_no_ratio() -> None:
    """Of 12 blocks one alone varies; a third of the resamples leave it out."""
    below = np.zeros((12, 64), np.int64)
    below[:, 0], below[5, :2] = 10, (5, 5)
    assert paired_ratio(both((below, below)), (1, 1), math.inf) is None
    below[5, 1] = 0
    assert paired_ratio(both((below, below)), (1, 1), math.inf) is None


def test_too_few_blocks() -> None:
    few = np.ones((7, 64), np.int64)
    with pytest.raises(InvalidArgument, match="7 blocks with a sample; expected at least 8"):
        paired_ratio(both((few, few)), (1, 1), math.inf)


# -- in equations 2 and 3 ----------------------------------------------------------------------------------


def frame_bits(value: float) -> Quantity:
    return Quantity(
        "H", value, "bit/frame", interval=Interval(0.5 * value, 2 * value, 0.95, "block bootstrap")
    )


def test_wmr_has_the_interval_of_the_pair_and_hil_its_mirror_image() -> None:
    found = capacity(frame_bits(10.0), frame_bits(6.0), 20.0, ratio=Interval(0.55, 0.7, 0.95, "paired"))
    assert found.wmr.interval == Interval(0.55, 0.7, 0.95, "paired")
    assert found.hil.interval is not None
    assert (found.hil.interval.low, found.hil.interval.high) == pytest.approx((0.3, 0.45))
    apart = capacity(frame_bits(10.0), frame_bits(6.0), 20.0)
    assert found.capacity == apart.capacity and found.wmr.value == apart.wmr.value
    assert apart.wmr.interval is not None and apart.wmr.interval.high == 1


@pytest.mark.parametrize(
    ("given", "want"), [((0.9, 1.2), (0.9, 1.0)), ((1.05, 1.2), (1.0, 1.0)), ((0.5, 0.8), (0.5, 1.0))]
)
def test_it_is_cut_at_one_and_holds_the_estimate(
    given: tuple[float, float], want: tuple[float, float]
) -> None:
    found = capacity(frame_bits(10.0), frame_bits(11.0), 20.0, ratio=Interval(*given, 0.95, "paired"))
    i = found.wmr.interval
    assert found.wmr.value == 1 and i is not None and (i.low, i.high) == want
