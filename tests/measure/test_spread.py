"""Intervals from blocks: coverage on dependent sources, what has no interval, and refused arguments.

Measured coverage of 95 % intervals of H, 200 draws each (standard error 1.5 %), n samples in B blocks: AR(1)
of correlation 0.8 between neighbours in 64 levels, a binary Markov chain with a = 0.05 and b = 0.2, and
independent draws of a binary symbol. Fewer blocks give wider intervals with a higher coverage, because the
dependence is less well known.

=========== ===== ==== ========
source          n    B coverage
=========== ===== ==== ========
Markov       4096    8    100 %
the same     4096   16     96 %
the same     4096   64     96 %
AR(1)        1024   32     99 %
the same     4096   16     98 %
the same     4096   64     98 %
independent  1000    8     98 %
the same     1000   16     98 %
the same     4096   64     98 %
=========== ===== ==== ========

`bench/bench_intervals.py` measures fields of 64^3 samples with correlation lengths from 1 to 8.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage, stats

from symbol_makers import Ints, levels, markov
from touchfield.errors import InvalidArgument
from touchfield.measure.dependence import BlockLayout, sampling_error
from touchfield.measure.estimators import ESTIMATORS, entropy_bits, estimate_bits
from touchfield.measure.quantity import spread


def counts_in_blocks(symbols: Ints, blocks: int, alphabet: int) -> Ints:
    owner = np.arange(len(symbols)) * blocks // len(symbols)
    return np.bincount(owner * alphabet + symbols, minlength=blocks * alphabet).reshape(blocks, alphabet)


# -- the standard error ------------------------------------------------------------------------------------


def fraction_of_ones(counts: NDArray[np.float64]) -> float:
    return float(counts[1] / counts.sum())


def test_error_of_a_fraction_of_independent_samples() -> None:
    """The mean over many draws is the binomial error; the correlation length is 1."""
    rng, p, n = np.random.default_rng(1), 0.3, 6400
    found = [
        sampling_error(
            fraction_of_ones,
            counts_in_blocks((rng.random(n) < p).astype(np.int64), 64, 2),
            BlockLayout((64,)),
        )
        for _ in range(60)
    ]
    variance = np.mean([f.error**2 for f in found])
    assert variance == pytest.approx(p * (1 - p) / n, rel=0.15)
    assert np.median([f.correlation_length for f in found]) < 1.3
    assert np.median([f.effective_blocks for f in found]) > 48
    assert np.mean([f.bias for f in found]) == pytest.approx(0, abs=1e-6)  # a fraction has none


def test_error_and_length_of_a_chain() -> None:
    """Theory: the variance of a Markov chain's fraction is (1 + r)/(1 - r) times that of independent ones."""
    rng, r, n = np.random.default_rng(2), 0.75, 16384
    found = [
        sampling_error(fraction_of_ones, counts_in_blocks(markov(rng, n), 64, 2), BlockLayout((64,)))
        for _ in range(60)
    ]
    inflation = (1 + r) / (1 - r)
    assert np.mean([f.error**2 for f in found]) == pytest.approx(0.2 * 0.8 * inflation / n, rel=0.15)
    assert np.median([f.correlation_length for f in found]) == pytest.approx(inflation, rel=0.15)


def test_bias_of_the_plug_in_estimate() -> None:
    """Independent samples: (K - 1)/(2 n ln 2), as Miller found."""
    rng = np.random.default_rng(3)
    found = [
        sampling_error(entropy_bits, counts_in_blocks(rng.integers(0, 16, 3200), 64, 16), BlockLayout((64,)))
        for _ in range(20)
    ]
    assert np.mean([f.bias for f in found]) == pytest.approx(-15 / (2 * 3200 * math.log(2)), rel=0.15)


def test_frames_that_repeat_change_neither_error_nor_length() -> None:
    counts = counts_in_blocks(levels(np.random.default_rng(4), 4096), 64, 64)
    single = sampling_error(entropy_bits, counts, BlockLayout((4, 4, 4), 3))
    repeated = sampling_error(entropy_bits, 5 * counts, BlockLayout((4, 4, 4), 3, frames=5))
    assert repeated.error == pytest.approx(single.error, rel=1e-9)
    assert repeated.correlation_length == pytest.approx(single.correlation_length, rel=1e-3)


# -- coverage ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("source", "truth"), [(markov, 0.721928), (levels, None)])
def test_coverage_on_dependent_sources(
    source: Callable[[np.random.Generator, int], Ints], truth: float | None
) -> None:
    if truth is None:
        edges = np.concatenate([[-np.inf], (np.arange(1, 64) - 32) / 8, [np.inf]])
        truth = float(stats.entropy(np.diff(stats.norm.cdf(edges)), base=2))
    rng = np.random.default_rng(5)
    covered = 0
    for _ in range(60):
        counts = counts_in_blocks(source(rng, 4096), 64, 64)
        found = spread(entropy_bits, counts).interval
        assert found is not None and found.low <= entropy_bits(counts.sum(axis=0)) <= found.high
        covered += found.low <= truth <= found.high
    assert covered >= 52  # 95 %: fewer than 52 of 60 have probability 0.005


def test_coverage_in_space_does_not_fall_with_the_correlation_length() -> None:
    """Fields of 32^3 samples, correlation exp(-r^2/2L^2) with L = 4: half of the samples are above 0.

    Blocks as if independent, that is their variance alone, cover far less.
    """
    rng, covered, naive, draws = np.random.default_rng(6), 0, 0, 60
    owner = np.arange(32) // 8
    box = ((owner[:, None, None] * 4 + owner[None, :, None]) * 4 + owner).reshape(-1)
    for _ in range(draws):
        noise = ndimage.gaussian_filter(rng.standard_normal((48, 48, 48)), 4 / math.sqrt(2), mode="wrap")
        symbols = (noise[:32, :32, :32] > 0).reshape(-1)
        counts = np.bincount(box * 2 + symbols, minlength=128).reshape(64, 2)
        found = sampling_error(fraction_of_ones, counts, BlockLayout((4, 4, 4), 3))
        half = stats.t.ppf(0.975, found.freedom) * found.error
        covered += abs(found.value - 0.5) <= half
        deviation = (counts[:, 1] / counts.sum(axis=1)).std(ddof=1) / 8
        naive += abs(found.value - 0.5) <= stats.t.ppf(0.975, 63) * deviation
    assert covered >= 52 and naive < 48


@pytest.mark.parametrize("name", [*ESTIMATORS])
def test_coverage_of_every_estimator(name: str) -> None:
    """Independent draws, p ~ 1/rank of 1000 symbols: the bias is corrected exactly once."""
    weight = 1 / np.arange(1, 1001)
    p, draws = weight / weight.sum(), 30
    truth, rng = float(stats.entropy(p, base=2)), np.random.default_rng(6)
    covered = 0
    for _ in range(draws):
        counts = counts_in_blocks(rng.choice(1000, 20_000, p=p), 64, 1000)
        estimate = estimate_bits(counts.sum(axis=0), name, 1000)
        found = spread(entropy_bits, counts, estimate=estimate).interval
        assert found is not None and found.low <= estimate <= found.high
        covered += found.low <= truth <= found.high
    assert covered >= 0.87 * draws


# -- the interval ------------------------------------------------------------------------------------------


def test_interval_is_student_times_error_and_bias() -> None:
    counts = counts_in_blocks(levels(np.random.default_rng(3), 900), 20, 70)
    error = sampling_error(entropy_bits, counts, BlockLayout((20,)))
    for level in (0.5, 0.95):
        found = spread(entropy_bits, counts, level)
        half = stats.t.ppf((1 + level) / 2, error.freedom) * math.hypot(error.error, error.bias)
        low, high = error.value - error.bias - half, error.value - error.bias + half
        assert found.interval is not None and found.interval.level == level
        expected = min(low, error.value), max(high, error.value)
        assert (found.interval.low, found.interval.high) == pytest.approx(expected, abs=1e-12)
        assert found.dependence is not None and found.dependence.blocks == 20


def test_joint_counts_have_their_shape_and_bounds_clip() -> None:
    rng = np.random.default_rng(1)
    x, y = rng.integers(0, 8, (2, 2000))
    joint = counts_in_blocks(8 * x + y, 20, 64).reshape(20, 8, 8)

    def information(c: NDArray[np.float64]) -> float:
        assert c.shape == (8, 8)
        return entropy_bits(c.sum(0)) + entropy_bits(c.sum(1)) - entropy_bits(c)

    free = spread(information, joint).interval
    assert free is not None and free.low < 0.002  # independent: the whole estimate is bias
    bounded = spread(information, joint, bounds=(0.0, math.inf)).interval
    assert bounded is not None and bounded.low == max(free.low, 0) and bounded.high == free.high


@pytest.mark.parametrize(("value", "expected"), [(-9.0, (-9.0, 0.0)), (9.0, (1.0, 9.0))])
def test_interval_contains_an_estimate_beyond_its_bound(value: float, expected: tuple[float, float]) -> None:
    counts = counts_in_blocks(markov(np.random.default_rng(1), 2000), 20, 2)
    found = spread(lambda c: value + 1e-3 * entropy_bits(c), counts, bounds=(0.0, 1.0)).interval
    assert found is not None and (found.low, found.high) == pytest.approx(expected, abs=1e-2)


def test_length_and_blocks_of_a_trend_stay_within_their_range() -> None:
    for blocks in (8, 16, 64):
        counts = np.stack([np.arange(blocks) * 6 + 5, 400 - np.arange(blocks) * 6], axis=1)
        found = sampling_error(fraction_of_ones, counts, BlockLayout((blocks,)))
        assert 1 <= found.effective_blocks <= blocks / 2
        assert blocks < found.correlation_length <= counts.sum()


def test_influences_of_one_frequency() -> None:
    """A spectrum of a single cosine, of any frequency, has an error or is refused."""
    for frequency in range(1, 32):
        wave = np.cos(np.pi * frequency * (np.arange(32) + 0.5) / 32)
        ones = np.rint(5000 + 4000 * wave).astype(np.int64)
        found = sampling_error(fraction_of_ones, np.stack([10_000 - ones, ones], axis=1), BlockLayout((32,)))
        assert found.error > 0 and found.freedom > 0 and math.isfinite(found.bias)


def test_what_does_not_vary_has_no_interval() -> None:
    found = spread(entropy_bits, np.full((10, 4), 25))
    assert found.interval is None and found.dependence is None and "no block differs" in found.notes[0]


def test_one_block_that_varies_has_no_interval_and_a_trend_a_wide_one() -> None:
    counts = np.tile([100, 0], (16, 1))
    counts[5] = 50, 50
    found = spread(entropy_bits, counts)
    assert found.interval is None and found.dependence is not None and found.dependence.effective_blocks < 4
    ramp = np.stack([np.arange(16) * 6 + 5, 100 - np.arange(16) * 6], axis=1)  # one length over all blocks
    found = spread(fraction_of_ones, ramp)
    assert found.interval is None or found.interval.high - found.interval.low > 0.5


def test_the_same_counts_give_the_same_digits_in_any_memory_layout() -> None:
    counts = counts_in_blocks(levels(np.random.default_rng(1), 2000), 20, 70)
    assert spread(entropy_bits, counts) == spread(entropy_bits, np.asfortranarray(counts))


FINE = np.array([[3 + n % 3, 5 - n % 2] for n in range(10)])


@pytest.mark.parametrize(
    ("counts", "options", "message"),
    [
        (FINE[:7], {}, "7 blocks; expected at least 8"),
        (FINE * 0, {}, "no sample"),
        (np.ones(10, np.int64), {}, r"expected \[B, cells\]"),
        (FINE * -1, {}, "found -"),
        (FINE * 0.5, {}, "whole numbers"),
        (FINE, {"level": 0.0}, "level"),
        (FINE, {"level": 1.0}, "level"),
        (FINE, {"level": math.nan}, "level"),
        (FINE, {"layout": BlockLayout((3, 3))}, r"layout: found \(3, 3\) blocks; expected 10"),
    ],
)
def test_invalid_arguments_are_refused(
    counts: NDArray[np.float64], options: dict[str, float], message: str
) -> None:
    with pytest.raises(InvalidArgument, match=message):
        spread(entropy_bits, counts, **options)  # type: ignore[arg-type]


def test_a_statistic_must_be_finite() -> None:
    with pytest.raises(InvalidArgument, match="statistic: found nan"):
        spread(lambda counts: math.nan, FINE)


def test_frequencies_of_a_lattice_are_those_of_its_cosines() -> None:
    """Each cosine of a 3 x 4 x 2 lattice is seen at its own frequency."""
    from touchfield.measure.dependence import _frequencies

    order, squared = _frequencies((3, 4, 2))
    assert len(order) == 23 and (np.diff(squared) >= 0).all()
    for index, w2 in zip(order, squared, strict=True):
        j = np.unravel_index(index, (3, 4, 2))
        assert w2 == pytest.approx(sum((math.pi * a / n) ** 2 for a, n in zip(j, (3, 4, 2), strict=True)))
    assert sorted(order) == [i for i, _ in enumerate(product(range(3), range(4), range(2))) if i]
