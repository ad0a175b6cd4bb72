"""Amplitude quantisers: Lloyd-Max against known optima, the mask of the Weber ladder, uniform steps."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from touchfield.codec.paper.quantisers import (
    AmplitudeLevels,
    lloyd_max_levels,
    uniform_levels,
    weber_ladder,
    weber_levels,
)
from touchfield.errors import InvalidArgument

GAUSSIAN = {1: 0.363380, 2: 0.117482, 4: 0.009501, 6: 0.000644}
"""Mean squared error of 2^nq optimal levels of the unit Gaussian (Max 1960)."""

amplitudes = st.floats(0, 2.0**20, width=32)


def mean_square(samples: np.ndarray, table: AmplitudeLevels) -> float:
    return float(np.mean((samples.astype(float) - table.levels_n.astype(float)[table.encode(samples)]) ** 2))


# -- Lloyd-Max ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("nq", "mse"), GAUSSIAN.items())
def test_quantiles_of_a_gaussian_have_the_known_error(nq: int, mse: float) -> None:
    drawn = np.array([NormalDist(8).inv_cdf((i + 0.5) / 50_000) for i in range(50_000)], np.float32)
    assert mean_square(drawn, lloyd_max_levels(drawn, nq)) == pytest.approx(mse, rel=0.02)


def test_levels_are_means_of_their_cells() -> None:
    samples = np.random.default_rng(4).exponential(size=5000).astype(np.float32)
    table = lloyd_max_levels(samples, 4)
    cell = table.encode(samples)
    means = [samples[cell == i].astype(float).mean() for i in range(16)]
    np.testing.assert_allclose(table.levels_n, means, rtol=5e-3)


def best_partition(samples: np.ndarray, count: int) -> float:
    """The global optimum by dynamic programming, for few samples."""
    x = np.sort(samples.astype(float))
    n = len(x)
    s, q = np.concatenate([[0], np.cumsum(x)]), np.concatenate([[0], np.cumsum(x * x)])
    first, last = np.arange(n)[:, None], np.arange(n)[None, :] + 1
    length = np.maximum(last - first, 1)
    cost = np.where(last > first, q[last] - q[first] - (s[last] - s[first]) ** 2 / length, np.inf)
    best = cost[0]
    for _ in range(count - 1):
        best = np.minimum(best, np.min(np.concatenate([[np.inf], best[:-1]])[:, None] + cost, axis=0))
    return float(best[-1] / n)


@pytest.mark.parametrize("seed", range(6))
def test_the_local_optimum_is_near_the_global_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    drawn = [np.abs(rng.normal(size=300)), rng.exponential(size=300), rng.random(300) ** 4][seed % 3]
    samples = drawn.astype(np.float32)
    best = best_partition(samples, 8)
    assert best * (1 - 1e-6) <= mean_square(samples, lloyd_max_levels(samples, 3)) <= 1.25 * best


def test_clusters_missed_by_the_initial_levels_get_levels() -> None:
    clusters = np.array([0.001, 0.00101, 0.00102, 0.00103, 0.00104, 5000.0])
    samples = (
        np.abs(clusters + np.random.default_rng(0).normal(size=(2000, 6)) * 1e-7).astype(np.float32).ravel()
    )
    levels = lloyd_max_levels(samples, 3).levels_n
    assert len(levels) == 8 and (levels < 0.01).sum() >= 5
    assert np.abs(levels[:, None] - clusters).min(axis=0).max() < 1e-3


@given(arrays(np.float32, st.integers(0, 300), elements=amplitudes), st.integers(1, 12))
def test_any_amplitudes_give_a_table_that_is_no_worse_than_one_level(samples: np.ndarray, nq: int) -> None:
    table = lloyd_max_levels(samples, nq)
    assert 1 <= len(table) <= 1 << nq
    if not len(samples):
        assert table.levels_n.tolist() == [0]
        return
    distinct = np.unique(samples + 0)
    if len(distinct) <= 1 << nq:
        np.testing.assert_array_equal(table.levels_n, distinct)
    assert mean_square(samples, table) <= np.var(samples.astype(float)) * (1 + 1e-6)


def test_the_same_samples_in_any_order_give_the_same_levels() -> None:
    samples = np.random.default_rng(1).gamma(2.0, size=20_000).astype(np.float32)
    a, b = lloyd_max_levels(samples, 6), lloyd_max_levels(samples[::-1], 6)
    assert len(a) == 64 and a.levels_n.tolist() == b.levels_n.tolist()


@pytest.mark.parametrize(
    ("samples", "nq"), [([np.nan], 4), ([np.inf], 4), ([-1.0], 4), ([1.0], 0), ([1.0], 13)]
)
def test_invalid_samples_and_bits_are_refused(samples: list[float], nq: int) -> None:
    with pytest.raises(InvalidArgument):
        lloyd_max_levels(np.array(samples, np.float32), nq)


# -- by formulas -------------------------------------------------------------------------------------------


def test_weber_levels_are_within_k_and_weak_forces_become_zero() -> None:
    table = weber_levels(weber_ladder(0.1, 3.3))
    assert len(table) == 25
    values = np.geomspace(0.001, 3.3, 100_003).astype(np.float32)
    decoded = table.levels_n[table.encode(values)].astype(float)
    assert (decoded == 0).tolist() == (values < 0.03).tolist()
    above_floor = values >= 0.03
    assert 0.0999 < (np.abs(decoded - values)[above_floor] / values[above_floor]).max() <= 0.1


def test_a_weber_ladder_takes_its_upper_end_from_the_data() -> None:
    assert [weber_ladder(0.1, top).steps for top in (3.3, 0.0)] == [24, 1]
    with pytest.raises(InvalidArgument, match="Weber fraction"):
        weber_ladder(1.5, 1.0)


def test_uniform_levels_are_multiples() -> None:
    table = uniform_levels(0.5, 2.8)
    assert table.levels_n.tolist() == [0, 0.5, 1, 1.5, 2, 2.5, 3]
    assert table.encode(np.array([0, 0.25, 0.24, 2.75, 99], np.float32)).tolist() == [0, 1, 0, 6, 6]
    for step_n, top_n, expected in ((1e-9, 1.0, "65536"), (0.0, 1.0, "step_n")):
        with pytest.raises(InvalidArgument, match=expected):
            uniform_levels(step_n, top_n)


@pytest.mark.parametrize("bad", [[1.0, 1.0], [2.0, 1.0], [-1.0, 1.0], [0.0, np.nan], [0.0, np.inf], []])
def test_levels_that_do_not_ascend_are_refused(bad: list[float]) -> None:
    with pytest.raises(InvalidArgument, match="levels"):
        AmplitudeLevels(np.array(bad, np.float32))


@given(arrays(np.float32, st.integers(1, 200), elements=amplitudes, unique=True))
def test_an_amplitude_takes_the_nearest_level(levels: np.ndarray) -> None:
    table = AmplitudeLevels(np.sort(levels + 0))
    np.testing.assert_array_equal(table.encode(table.levels_n), np.arange(len(levels)))
    values = np.linspace(0, 2.0**20, 300).astype(np.float32)
    errors = np.abs(values[:, None].astype(float) - table.levels_n)
    np.testing.assert_allclose(errors[np.arange(300), table.encode(values)], errors.min(axis=1), atol=2.0**-4)


@pytest.mark.parametrize("count", [1, 2, 25, 4096, 65536])
def test_an_amplitude_on_a_threshold_takes_the_level_above(count: int) -> None:
    """At each threshold and the floats beside it, at float32's ends, and where their leading bits change."""
    samples = np.random.default_rng(count).gamma(2.0, 0.6, 2 * count + 8).astype(np.float32)
    table = AmplitudeLevels(np.unique(samples)[:count])
    assert len(table) == count
    powers = np.ldexp(np.float32(1), np.arange(-149, 128)).astype(np.float32)
    ends = np.array([0.0, -0.0, np.finfo(np.float32).max], np.float32)
    at = np.concatenate([table.thresholds_n, powers, ends])
    values = np.concatenate(
        [at, np.nextafter(at[at > 0], np.float32(0)), np.nextafter(at[:-1], np.float32(1e38))]
    )
    expected = (table.thresholds_n[None, :] <= values[:500, None]).sum(axis=1)
    np.testing.assert_array_equal(table.encode(values)[:500], expected)
    np.testing.assert_array_equal(table.encode(values), np.searchsorted(table.thresholds_n, values, "right"))


def test_invalid_amplitudes_are_refused() -> None:
    table = uniform_levels(0.5, 2.0)
    for bad in (-1.0, np.nan, np.inf):
        with pytest.raises(InvalidArgument):
            table.encode(np.array([0.1, bad], np.float32))
    assert (
        table.encode(np.array([-0.0], np.float32)).tolist() == [0]
        and len(table.encode(np.zeros(0, np.float32))) == 0
    )
