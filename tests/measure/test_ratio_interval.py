"""The paired interval of a ratio: coverage for enumerated truth, and undefined ratios."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from symbol_makers import Ints, levels, markov
from touchfield.errors import InvalidArgument
from touchfield.measure.capacity import capacity, paired_ratio
from touchfield.measure.counts import Counts
from touchfield.measure.estimators import binary_entropy_bits, entropy_bits
from touchfield.measure.quantity import Interval, Quantity, Spread, spread


def level_probabilities() -> NDArray[np.float64]:
    edges = np.concatenate([[-np.inf], (np.arange(1, 64) - 32) / 8, [np.inf]])
    return np.asarray(np.diff(stats.norm.cdf(edges)))


def counts_in_blocks(symbols: Ints, blocks: int) -> Ints:
    owner = np.arange(len(symbols)) * blocks // len(symbols)
    return np.bincount(owner * 64 + symbols, minlength=blocks * 64).reshape(blocks, 64)


def both(blocks: tuple[Ints, Ints]) -> tuple[Counts, Counts]:
    """Blocks [B, 64] of W and of M(W), as counts."""
    first, second = (
        Counts(np.flatnonzero(b.any(0))[:, None], b.sum(0)[b.any(0)], b[:, b.any(0)], alphabet=64)
        for b in blocks
    )
    return first, second


def test_paired_interval_is_that_of_both_tables() -> None:
    w = levels(np.random.default_rng(1), 960)
    rendered_counts, reference_counts = counts_in_blocks(w[::2] // 8, 12), counts_in_blocks(w, 12)
    found = paired_ratio(both((reference_counts, rendered_counts)), (1, 1), math.inf)
    expected = spread(
        lambda c: entropy_bits(c[64:]) / entropy_bits(c[:64]),
        np.concatenate([reference_counts, rendered_counts], axis=1),
    )
    assert found is not None and found.interval is not None and expected.interval is not None
    assert (found.interval.low, found.interval.high) == pytest.approx(
        (expected.interval.low, expected.interval.high), rel=1e-9
    )
    assert found.interval.method.startswith("paired, spectrum of 12 blocks") and found.interval.level == 0.95
    assert found.dependence is not None and math.isnan(found.dependence.correlation_length)


@pytest.mark.parametrize(
    ("source", "mapping", "fewer", "truth"),
    [
        # half the samples, each the maximum of two: P(0) is that of two zeros in a row
        (
            markov,
            lambda w: w[::2] | w[1::2],
            2,
            binary_entropy_bits(0.8 * 0.95) / binary_entropy_bits(0.2) / 2,
        ),
        # the same samples with a quarter of the levels
        (
            levels,
            lambda w: w // 4,
            1,
            stats.entropy(level_probabilities().reshape(16, 4).sum(1)) / stats.entropy(level_probabilities()),
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
    """The nominal coverage, with intervals far narrower than the corners of two intervals."""
    rng, n, blocks = np.random.default_rng(2), 4096, 32
    covered, widths, corners = 0, [], []
    for draw in range(80):
        w = source(rng, n)
        counts = counts_in_blocks(w, blocks), counts_in_blocks(mapping(w), blocks)
        found = paired_ratio(both(counts), (n, n // fewer), math.inf)
        assert found is not None and found.interval is not None
        covered += found.interval.low <= truth <= found.interval.high
        if draw % 8:
            continue
        widths.append(found.interval.high - found.interval.low)
        h, c = (spread(entropy_bits, k).interval for k in counts)
        assert h is not None and c is not None
        corners.append(c.high / h.low / fewer - c.low / h.high / fewer)
    assert 68 <= covered <= 80  # 95 %: fewer than 68 of 80 have probability 10^-4
    assert np.mean(widths) < 0.4 * np.mean(corners)


def test_relabelling_has_ratio_one_and_no_interval() -> None:
    w = levels(np.random.default_rng(4), 2048)
    counts = counts_in_blocks(w, 16), counts_in_blocks(63 - w, 16)
    found = paired_ratio(both(counts), (2048, 2048), math.inf)
    assert found is not None and found.interval is None and "no block differs" in found.notes[0]
    q = frame_bits(10.0)
    wmr = capacity(q, q, 20.0, ratio=found).wmr
    assert wmr.value == 1 and wmr.interval is None and "no interval" in wmr.notes[-1]


def test_paired_interval_of_other_estimators() -> None:
    w = levels(np.random.default_rng(5), 2048)
    counts = counts_in_blocks(w, 16), counts_in_blocks(w // 8, 16)
    corrected = paired_ratio(both(counts), (2048, 2048), math.inf, "miller-madow")
    assert corrected is not None and corrected.interval is not None
    limited = paired_ratio(both(counts), (2048, 2048), 100.0)
    assert limited is not None and limited.interval is not None
    assert limited.interval.high < 100 / 2048  # limited by the capacity of the device


def test_without_variation_there_is_no_ratio() -> None:
    counts = np.zeros((12, 64), np.int64)
    counts[:, 0], counts[5, :2] = 10, (5, 5)
    one_block = paired_ratio(both((counts, counts // 5)), (1, 1), math.inf)
    assert one_block is not None and one_block.interval is None
    counts[5, 1] = 0
    assert paired_ratio(both((counts, counts)), (1, 1), math.inf) is None


def test_too_few_blocks() -> None:
    few = np.ones((7, 64), np.int64)
    with pytest.raises(InvalidArgument, match="7 blocks; expected at least 8"):
        paired_ratio(both((few, few)), (1, 1), math.inf)


# -- in equations 2 and 3 ----------------------------------------------------------------------------------


def frame_bits(value: float) -> Quantity:
    return Quantity(
        "H", value, "bit/frame", interval=Interval(0.5 * value, 2 * value, 0.95, "block bootstrap")
    )


def test_wmr_has_the_interval_of_the_pair_and_hil_its_mirror_image() -> None:
    found = capacity(
        frame_bits(10.0), frame_bits(6.0), 20.0, ratio=Spread(Interval(0.55, 0.7, 0.95, "paired"), None)
    )
    assert found.wmr.interval == Interval(0.55, 0.7, 0.95, "paired")
    assert found.hil.interval is not None
    assert (found.hil.interval.low, found.hil.interval.high) == pytest.approx((0.3, 0.45))
    separate = capacity(frame_bits(10.0), frame_bits(6.0), 20.0)
    assert found.capacity == separate.capacity and found.wmr.value == separate.wmr.value
    assert separate.wmr.interval is not None and separate.wmr.interval.high == 1


@pytest.mark.parametrize(("limits", "expected"), [((0.9, 1.2), (0.9, 1.0)), ((0.5, 0.8), (0.5, 1.0))])
def test_interval_is_limited_to_one_and_contains_the_estimate(
    limits: tuple[float, float], expected: tuple[float, float]
) -> None:
    found = capacity(
        frame_bits(10.0), frame_bits(11.0), 20.0, ratio=Spread(Interval(*limits, 0.95, "paired"), None)
    )
    i = found.wmr.interval
    assert found.wmr.value == 1 and i is not None and (i.low, i.high) == expected


def test_interval_beyond_one_is_none() -> None:
    above = Spread(Interval(1.05, 1.2, 0.95, "paired"), None)
    found = capacity(frame_bits(10.0), frame_bits(11.0), 20.0, ratio=above)
    assert found.wmr.value == 1 and found.wmr.interval is None and found.hil.interval is None
    assert "no interval: WMR is 1" in found.notes[-1]
