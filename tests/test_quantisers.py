"""The amplitude quantisers: Lloyd-Max on densities and samples, and the exact level look-up."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from touchfield.codec.ladders import UniformSpec, UniformTable, WeberSpec
from touchfield.codec.lloyd_max import LevelTable, LloydMaxSpec, lloyd_max_density, lloyd_max_levels
from touchfield.errors import InvalidArgument

GAUSSIAN = {2: 0.363380, 4: 0.117482, 8: 0.034548, 16: 0.009501, 32: 0.002505, 64: 0.000644}
GAUSSIAN_BITS = {2: 1.0, 4: 1.9111, 8: 2.8249, 16: 3.7653, 32: 4.7298, 64: 5.7101}
LAPLACIAN = {2: 0.5, 4: 0.176195, 8: 0.054476, 16: 0.015373, 32: 0.004102, 64: 0.001061}

amplitudes = st.floats(0, 2.0**20, width=32)


# -- densities ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("density", "count", "mse"),
    [("gaussian", n, d) for n, d in GAUSSIAN.items()] + [("laplacian", n, d) for n, d in LAPLACIAN.items()],
)
def test_optimal_quantisers_of_densities_have_the_known_error(density, count, mse):
    assert lloyd_max_density(density, count).mse == pytest.approx(mse, abs=5.1e-7)


@pytest.mark.parametrize(("count", "bits"), GAUSSIAN_BITS.items())
def test_optimal_gaussian_quantisers_have_the_known_entropy(count, bits):
    assert lloyd_max_density("gaussian", count).entropy_bits == pytest.approx(bits, abs=5.1e-5)


def test_four_gaussian_levels():
    found = lloyd_max_density("gaussian", 4)
    np.testing.assert_allclose(found.levels, [-1.5104, -0.4528, 0.4528, 1.5104], atol=5e-5)


@pytest.mark.parametrize("density", ["gaussian", "laplacian"])
@pytest.mark.parametrize("count", [3, 16, 128])
def test_thresholds_are_midpoints_and_the_whole_is_symmetric(density, count):
    found = lloyd_max_density(density, count)
    np.testing.assert_allclose(found.thresholds, (found.levels[1:] + found.levels[:-1]) / 2, atol=1e-5)
    np.testing.assert_allclose(found.levels, -found.levels[::-1], atol=1e-9)


def test_other_densities_are_refused():
    with pytest.raises(InvalidArgument):
        lloyd_max_density("uniform", 4)
    with pytest.raises(InvalidArgument):
        lloyd_max_density("gaussian", 1)


# -- samples --------------------------------------------------------------------------------------------------


def mean_square(samples, levels):
    middle = (levels[1:].astype(float) + levels[:-1]) / 2
    return np.mean((samples - levels.astype(float)[np.searchsorted(middle, samples)]) ** 2)


@pytest.mark.parametrize("count", [2, 4, 16, 64])
def test_gaussian_samples_come_close_to_the_density(count):
    samples = np.random.default_rng(3).normal(size=300_000).astype(np.float32)
    levels = lloyd_max_levels(samples, count)
    assert mean_square(samples, levels) == pytest.approx(GAUSSIAN[count], rel=0.025)


def test_levels_are_means_of_their_cells_and_thresholds_midpoints():
    samples = np.random.default_rng(4).exponential(size=5000).astype(np.float32)
    levels = lloyd_max_levels(samples, 12)
    cell = np.searchsorted((levels[1:].astype(float) + levels[:-1]) / 2, samples)
    means = [samples[cell == i].astype(float).mean() for i in range(12)]
    # exact to where the iteration was ended, at 1e-7 of the error
    np.testing.assert_allclose(levels, means, rtol=2e-3)


def best_partition(samples, count):
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
    return best[-1] / n


@pytest.mark.parametrize("seed", range(6))
def test_the_local_optimum_is_near_the_global_one(seed):
    rng = np.random.default_rng(seed)
    samples = [rng.normal(size=300), rng.exponential(size=300), rng.random(300) ** 4][seed % 3].astype(np.float32)
    found = mean_square(samples, lloyd_max_levels(samples, 8))
    best = best_partition(samples, 8)
    assert best * (1 - 1e-6) <= found <= 1.25 * best


def test_clusters_that_the_start_misses_get_their_levels():
    clusters = np.array([0.001, 0.00101, 0.00102, 0.00103, 0.00104, 5000.0])
    samples = (clusters + np.random.default_rng(0).normal(size=(2000, 6)) * 1e-7).astype(np.float32).ravel()
    levels = lloyd_max_levels(samples, 8)
    assert len(levels) == 8
    assert np.abs(levels[:, None] - clusters).min(axis=0).max() < 1e-3
    assert (levels < 0.01).sum() >= 5


@given(arrays(np.float32, st.integers(1, 300), elements=amplitudes), st.integers(1, 12))
def test_any_amplitudes_give_an_ascending_table_that_is_no_worse_than_one_level(samples, nq):
    table = LloydMaxSpec(nq).fit(samples)
    distinct = np.unique(samples + 0)
    assert len(table.levels_n) <= 1 << nq
    decoded = table.decode(table.encode(samples))
    if len(distinct) <= 1 << nq:
        np.testing.assert_array_equal(table.levels_n, distinct)
        np.testing.assert_array_equal(decoded, samples)
    error = ((decoded.astype(float) - samples) ** 2).sum()
    assert error <= ((samples.astype(float) - samples.mean(dtype=float)) ** 2).sum() * (1 + 1e-6)


def test_more_values_than_levels_use_every_level():
    samples = np.repeat(np.float32([0, 1, 2, 3, 100]), [1, 1000, 1, 1, 5])
    levels = lloyd_max_levels(samples, 4)
    assert len(levels) == 4
    # optimal: one pair of neighbours shares a level, and not the pair at the thousand
    np.testing.assert_allclose(levels, [0, 1, 2.5, 100])


def test_the_same_samples_in_any_order_give_the_same_levels():
    samples = np.random.default_rng(1).gamma(2.0, size=20_000).astype(np.float32)
    np.testing.assert_array_equal(lloyd_max_levels(samples, 64), lloyd_max_levels(samples[::-1], 64))


def test_no_sample_is_one_level_of_zero():
    assert LloydMaxSpec(6).fit(np.zeros(0, np.float32)).levels_n.tolist() == [0.0]


@pytest.mark.parametrize("bad", [[], [np.nan, 1.0], [1.0, np.inf], [-np.inf]])
def test_samples_that_are_none_or_not_finite_are_refused(bad):
    with pytest.raises(InvalidArgument):
        lloyd_max_levels(np.array(bad, np.float32), 4)


@pytest.mark.parametrize("nq", [0, 13])
def test_bits_out_of_range_are_refused(nq):
    with pytest.raises(InvalidArgument):
        LloydMaxSpec(nq)


# -- the look-up ----------------------------------------------------------------------------------------------


def by_search(table, values):
    return np.searchsorted(table.thresholds_n, values, "right")


@given(
    arrays(np.float32, st.integers(1, 200), elements=amplitudes, unique=True),
    arrays(np.float32, st.integers(0, 200), elements=amplitudes),
)
def test_the_level_of_an_amplitude_is_exact(levels, values):
    table = LevelTable(np.sort(levels) + np.float32(0))
    at = np.concatenate([values, levels, table.thresholds_n, np.nextafter(table.thresholds_n, np.float32(0))])
    np.testing.assert_array_equal(table.encode(at), by_search(table, at))
    found = np.abs(table.decode(table.encode(at)).astype(float) - at)
    nearest = np.abs(table.levels_n.astype(float) - at.astype(float)[:, None]).min(axis=1)
    assert (found <= nearest * (1 + 1e-15)).all()  # a midpoint is itself rounded to float64


@pytest.mark.parametrize("count", [2, 64, 4096, 65536])
def test_the_look_up_is_exact_for_levels_of_all_counts_and_spreads(count):
    rng = np.random.default_rng(count)
    for levels in (np.linspace(0, 3.3, count), np.geomspace(1e-30, 1e30, count), 1 + np.arange(count) * 1e-6):
        table = LevelTable(np.unique(levels.astype(np.float32)))
        values = np.concatenate([rng.choice(levels, 5000), rng.random(5000) * 4, [0, 1e-45, 3e38]])
        values = values.astype(np.float32)
        np.testing.assert_array_equal(table.encode(values), by_search(table, values))


def test_thresholds_are_rounded_up_so_that_nothing_changes():
    levels = np.array([1.0, np.nextafter(np.float32(1), np.float32(2))], np.float32)
    table = LevelTable(levels)
    assert table.thresholds_n[0] == levels[1]  # the midpoint is no float32
    assert table.encode(levels).tolist() == [0, 1]


def test_amplitudes_that_are_none_are_refused():
    table = UniformTable(0.1, 10)
    for bad in (-1.0, np.nan, np.inf):
        with pytest.raises(InvalidArgument):
            table.encode(np.array([0.1, bad], np.float32))
    with pytest.raises(InvalidArgument):
        table.encode(np.zeros((2, 2), np.float32))
    assert table.encode(np.array([-0.0], np.float32)).tolist() == [0]
    assert len(table.encode(np.zeros(0, np.float32))) == 0


def test_the_weber_stage_keeps_k_and_sends_the_weak_to_zero():
    table = WeberSpec(0.1, 0.03, 3.3).fit(np.zeros(0, np.float32))
    assert len(table.levels_n) == 25
    values = np.geomspace(0.001, 3.3, 1_000_003).astype(np.float32)
    decoded = table.decode(table.encode(values))
    assert (decoded == 0).tolist() == (values < 0.03).tolist()
    held = values >= 0.03
    errors = np.abs(decoded[held].astype(float) - values[held]) / values[held]
    assert 0.0999 < errors.max() <= 0.1


def test_a_weber_stage_takes_its_upper_end_from_the_data():
    assert WeberSpec(0.1).fit(np.array([0.5, 3.3], np.float32)).ladder.steps == 24
    assert WeberSpec(0.1).fit(np.zeros(0, np.float32)).ladder.steps == 1
    with pytest.raises(InvalidArgument, match="force_max_n"):
        WeberSpec(0.1, 0.03, 0.0)


def test_a_uniform_stage_rounds_to_multiples():
    table = UniformSpec(0.5).fit(np.array([0.2, 2.8], np.float32))
    assert table.levels_n.tolist() == [0, 0.5, 1, 1.5, 2, 2.5, 3]
    assert table.encode(np.array([0, 0.25, 0.24, 2.75, 99], np.float32)).tolist() == [0, 1, 0, 6, 6]
    with pytest.raises(InvalidArgument, match="65536"):
        UniformSpec(1e-9).fit(np.ones(1, np.float32))
    with pytest.raises(InvalidArgument, match="step_n"):
        UniformSpec(0.0)
