"""Gaussian smoothing: dense against scipy, bricks against dense, and the same bits for any thread count."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from touchfield.errors import InvalidArgument
from touchfield.filters.separable import (
    BOUNDARIES,
    SCIPY_MODES,
    AxisTaps,
    factors,
    filter_field,
)
from touchfield.filters.smoothing import GaussianFilter, gaussian, gaussian_taps
from touchfield.medium import ForceField, Grid

shapes = st.tuples(*[st.integers(1, 28)] * 3)


def unit_grid(shape: tuple[int, int, int]) -> Grid:
    return Grid(shape, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))


def random_field(shape: tuple[int, int, int], seed: int, density: float) -> ForceField:
    rng = np.random.default_rng(seed)
    forces = rng.normal(size=(*shape, 3)) * (rng.random(shape) < density)[..., None]
    return ForceField.from_dense(unit_grid(shape), forces)


def by_scipy(dense: NDArray[np.float32], sigmas: tuple[float, ...], boundary: str, truncate: float = 4.0):
    sigma = (*sigmas, *[0.0] * (dense.ndim - len(sigmas)))
    return ndimage.gaussian_filter(dense.astype(float), sigma, mode=SCIPY_MODES[boundary], truncate=truncate)


# -- dense arrays ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("sigmas", [(2.0, 2.0, 2.0), (0.0, 1.3, 2.9), (0.6, 0.0, 0.0), (3.4, 1.0, 0.3)])
def test_a_dense_field_equals_scipy(boundary: str, sigmas: tuple[float, float, float]) -> None:
    field = np.random.default_rng(1).normal(size=(29, 20, 37, 3)).astype(np.float32)
    filtered = gaussian(field, sigmas, boundary=boundary)
    assert filtered.dtype == np.float32
    assert np.abs(filtered - by_scipy(field, sigmas, boundary)).max() < 1e-6


@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize(
    ("shape", "sigma"), [((50,), 2.0), ((20, 31), 1.5), ((12, 13, 14), 1.0), ((9, 9, 9, 12), 1.0)]
)
def test_scalars_of_any_number_of_axes_equal_scipy(
    boundary: str, shape: tuple[int, ...], sigma: float
) -> None:
    for dtype, tolerance in ((np.float64, 1e-14), (np.float32, 1e-6)):
        signal = np.random.default_rng(2).normal(size=shape).astype(dtype)
        filtered = gaussian(signal, sigma, boundary=boundary)
        assert filtered.dtype == dtype
        assert np.abs(filtered - by_scipy(signal, (sigma,) * len(shape), boundary)).max() < tolerance


def test_the_components_of_a_field_are_not_mixed() -> None:
    field = np.zeros((17, 17, 17, 3), np.float32)
    field[8, 8, 8, 1] = 1
    filtered = gaussian(field, 2.0)
    assert not filtered[..., 0].any() and not filtered[..., 2].any()
    assert filtered[8, 8, 8, 1] == pytest.approx(gaussian_taps(2.0)[8] ** 3, rel=1e-6)


def test_integer_signals_become_float64() -> None:
    filtered = gaussian(np.eye(20, dtype=np.int16) * 100, 1.0)
    assert filtered.dtype == np.float64 and filtered[10, 10] > 10


@given(st.floats(0.13, 6))
def test_taps_are_symmetric_positive_and_of_unit_sum(sigma: float) -> None:
    taps = gaussian_taps(sigma)
    assert len(taps) == 2 * math.floor(4 * sigma + 0.5) + 1
    assert taps.min() > 0 and taps.sum() == pytest.approx(1, abs=1e-14)
    assert np.array_equal(taps, taps[::-1])


# -- bricks ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(24, 33, 41), (17, 18, 30), (40, 17, 64)])
def test_bricks_equal_the_dense_array(shape: tuple[int, int, int]) -> None:
    field = random_field(shape, 3, 0.01)
    filtered = GaussianFilter(1.9)(field)
    expected = by_scipy(field.to_dense(), (1.9,) * 3, "zero")
    assert np.abs(filtered.to_dense() - expected).max() < 1e-6
    # no empty brick, and no sample outside the grid
    assert filtered == ForceField.from_dense(field.grid, filtered.to_dense())


@given(shapes, st.integers(0, 999), st.sampled_from([0.001, 0.05, 1.0]), st.data())
def test_any_taps_on_bricks_and_on_arrays_equal_scipy(
    shape: tuple[int, int, int], seed: int, density: float, data: st.DataObject
) -> None:
    field = random_field(shape, seed, density)
    rng = np.random.default_rng(seed)
    axes, expected = [], field.to_dense().astype(float)
    for axis, count in enumerate(shape):
        taps = rng.normal(size=2 * data.draw(st.integers(0, (count - 1) // 2)) + 1)
        if data.draw(st.booleans()):
            taps = taps + taps[::-1]  # symmetric taps use another path of the kernel
        taps[rng.random(len(taps)) < 0.2] = 0
        axes.append(AxisTaps(taps))
        expected = ndimage.correlate1d(expected, taps[::-1], axis=axis, mode="constant")
    tolerance = 1e-5 * max(1.0, float(np.prod([np.abs(a.taps).sum() for a in axes])))
    rows = (axes[0], axes[1], axes[2])
    filtered, _ = filter_field(field, rows)
    assert np.abs(filtered.to_dense() - expected).max() <= tolerance
    assert filtered == ForceField.from_dense(field.grid, filtered.to_dense())


def test_distant_bricks_of_a_huge_lattice() -> None:
    grid = unit_grid((1 << 20, 1 << 20, 1 << 20))
    positions_in = np.array(
        [[5, 5, 5], [1 << 19, 9, (1 << 20) - 1], [1 << 19, 9, 1 << 10], [1 << 19, 1 << 19, 12]]
    )
    field = ForceField.from_support(grid, positions_in, np.ones((4, 3)))
    filtered = GaussianFilter(1.0)(field)
    centre = gaussian_taps(1.0)[4] ** 3
    positions = filtered.positions()
    for position in positions_in:
        assert filtered.vectors_n()[(positions == position).all(axis=1)] == pytest.approx(centre, rel=1e-6)
    assert filtered.support_count == 9**3 + 9 * 9 * 5 + 2 * 9**3


def test_more_than_one_tile_along_z_and_a_long_reach() -> None:
    shape = (30, 9, 700)
    field = random_field(shape, 5, 0.002)
    axes = (AxisTaps(np.ones(29)), AxisTaps(np.arange(1.0, 8)), AxisTaps(gaussian_taps(12.0)))
    filtered = filter_field(field, axes)[0].to_dense()
    expected = field.to_dense().astype(float)
    for axis, row in enumerate(axes):
        expected = ndimage.correlate1d(expected, row.taps[::-1], axis=axis, mode="constant")
    assert np.abs(filtered - expected).max() < 2e-5 * np.abs(expected).max()


def test_the_same_bits_for_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    field = random_field((70, 60, 50), 6, 0.01)
    results = []
    for threads in ("1", "2", "3", "5"):
        monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
        results.append((GaussianFilter(2.0)(field), gaussian(field.to_dense(), 2.0, boundary="reflect")))
    for sparse, dense in results[1:]:
        assert sparse == results[0][0]
        assert np.array_equal(dense, results[0][1])


# -- what the filter declares ------------------------------------------------------------------------------


def test_claims_hold_on_a_field_clear_of_the_border(wavy_field: ForceField) -> None:
    grid = Grid((56, 48, 47), wavy_field.grid.spacing_m, wavy_field.grid.origin_m)
    field = ForceField.from_support(
        grid, wavy_field.positions() + np.array([16, 12, 14]), wavy_field.vectors_n()
    )
    smooth = GaussianFilter.parse("2mm")
    claims, filtered = smooth.claims(grid), smooth(field)
    assert claims.reach == (8, 4, 5) and claims.linear and claims.dc_gain == 1
    before, after = field.vectors_n(), filtered.vectors_n()
    assert after.sum(axis=0, dtype=float) == pytest.approx(
        before.sum(axis=0, dtype=float), rel=1e-5, abs=1e-4
    )
    assert np.linalg.norm(after, axis=1).max() <= np.linalg.norm(before, axis=1).max() * (1 + 1e-6)
    low, high = field.positions().min(axis=0), field.positions().max(axis=0)
    assert (filtered.positions() >= low - claims.reach).all() and (
        filtered.positions() <= high + claims.reach
    ).all()
    twice = smooth(field.scaled(-2.5)).to_dense()
    assert np.abs(twice + 2.5 * filtered.to_dense()).max() < 1e-6


def test_axis_of_one_sample_is_not_filtered() -> None:
    field = random_field((30, 30, 1), 8, 0.1)
    filtered = GaussianFilter(2.0)(field).to_dense()
    assert np.abs(filtered - by_scipy(field.to_dense(), (2.0, 2.0), "zero")).max() < 1e-6


def test_empty_field_stays_empty_and_text_round_trip() -> None:
    smooth = GaussianFilter.parse("sigma=2mm,truncate=4.0,boundary=zero")  # the notation of older streams
    assert smooth == GaussianFilter(0.002) == GaussianFilter.parse(smooth.text)
    empty = ForceField.empty(Grid((32, 32, 32), (0.001,) * 3, (0.0,) * 3))
    assert smooth(empty) == empty


@pytest.mark.parametrize("boundary", ["nearest", "reflect", "wrap"])
def test_a_field_continues_beyond_its_border_as_an_array_does(boundary: str, wavy_field: ForceField) -> None:
    by_text = GaussianFilter.parse(f"2mm,boundary={boundary}")
    sigmas = [0.002 / spacing_m for spacing_m in wavy_field.grid.spacing_m]
    expected = gaussian(wavy_field.to_dense(), sigmas, boundary=boundary)
    np.testing.assert_allclose(by_text(wavy_field).to_dense(), expected, atol=1e-6)
    assert GaussianFilter.parse(by_text.text) == by_text
    assert not np.allclose(expected, GaussianFilter(by_text.sigma_m)(wavy_field).to_dense(), atol=1e-6)
    with pytest.raises(InvalidArgument, match="boundary"):
        GaussianFilter(0.001, boundary="mirror")


def test_factors_of_separable_and_other_kernels() -> None:
    rng = np.random.default_rng(4)
    rows = [rng.normal(size=n) for n in (3, 5, 2)]
    product = np.einsum("i,j,k->ijk", *rows)
    found = factors(product)
    assert found is not None and np.allclose(np.einsum("i,j,k->ijk", *found), product, atol=1e-14)
    assert factors(rng.normal(size=(3, 3))) is None
    assert factors(np.zeros((3, 3))) is None


# -- bad input ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("-2mm", "positive length"),
        ("0mm", "positive length"),
        ("2", "--gaussian sigma: found '2'"),
        ("2mm,truncate=3", "each of sigma, boundary at most once"),
    ],
)
def test_invalid_texts_are_refused(text: str, message: str) -> None:
    with pytest.raises(InvalidArgument, match=message):
        GaussianFilter.parse(text)


def test_a_kernel_larger_than_the_field_is_refused() -> None:
    field = random_field((32, 16, 32), 1, 0.1)
    with pytest.raises(
        InvalidArgument, match="along y: found 17 taps along an axis of 16 samples; expected at most 16"
    ):
        GaussianFilter(2.0)(field)
    with pytest.raises(InvalidArgument, match="axis 1: found 17 taps"):
        gaussian(field.to_dense(), 2.0)
    with pytest.raises(InvalidArgument, match="at most 3 taps"):
        gaussian(np.ones(3), 1.0)


@pytest.mark.parametrize("sigma", [-1.0, math.nan, math.inf, 1e9])
def test_a_sigma_out_of_range_is_refused(sigma: float) -> None:
    with pytest.raises(InvalidArgument, match="sigma_samples"):
        gaussian(np.ones(100), sigma)


def test_other_arguments_out_of_range_are_refused() -> None:
    with pytest.raises(InvalidArgument, match="boundary"):
        gaussian(np.ones(100), 1.0, boundary="mirror")
    with pytest.raises(InvalidArgument, match="one for each leading axis"):
        gaussian(np.ones(100), (1.0, 1.0))
    assert len(gaussian_taps(2.0**13)) == 2 * 2**15 + 1
    with pytest.raises(InvalidArgument, match="a radius of up to 32768"):
        gaussian_taps(2.0**13 + 0.125)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_signal_that_is_not_finite_is_refused(bad: float) -> None:
    for signal in (np.ones(100), np.ones((20, 20, 20, 3), np.float32), np.ones((20, 20), np.float32)):
        signal[(10,) * signal.ndim if signal.ndim < 4 else (10, 10, 10, 1)] = bad
        with pytest.raises(InvalidArgument, match="signal: found a number that is not finite"):
            gaussian(signal, 1.0)


def test_sums_of_the_largest_numbers_do_not_overflow() -> None:
    """SciPy adds two samples of equal weight before it multiplies; these passes multiply each first."""
    max_float = float(np.finfo(np.float32).max)
    field = ForceField.from_dense(unit_grid((20, 20, 20)), np.full((20, 20, 20, 3), 0.9 * max_float))
    for boundary in BOUNDARIES:
        assert gaussian(field.to_dense(), 1.0, boundary=boundary).max() == pytest.approx(
            0.9 * max_float, rel=1e-6
        )
        assert gaussian(np.full(20, 1.7e308), 1.0, boundary=boundary).max() == pytest.approx(
            1.7e308, rel=1e-12
        )
    assert GaussianFilter(1.0)(field).forces_n.max() == pytest.approx(0.9 * max_float, rel=1e-6)
    assert np.isfinite(GaussianFilter(1.0)(field.scaled(0.5)).forces_n).all()


def test_sums_of_bricks_beyond_the_type_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    field = ForceField.from_dense(unit_grid((20, 20, 20)), np.full((20, 20, 20, 3), 3e38))
    identity = AxisTaps(np.ones(1))
    for axis in range(3):
        for gain, finite in ((0.5, True), (0.6, False)):
            rows = [identity, identity, identity]
            rows[axis] = AxisTaps(np.array([gain, gain, 0.0]))
            axes = (rows[0], rows[1], rows[2])
            assert filter_field(field, axes)[1] == finite
    monkeypatch.setattr(GaussianFilter, "taps", lambda *_: axes)  # a gain of 1.2
    with pytest.raises(InvalidArgument, match="gaussian forces: found numbers whose sums are beyond float32"):
        GaussianFilter(1.0)(field)


def test_a_sigma_of_any_number_type() -> None:
    signal = np.random.default_rng(3).normal(size=40)
    for sigma in (2, np.int64(2), np.float32(2), np.float64(2), np.uint8(2)):
        assert np.array_equal(gaussian(signal, sigma), gaussian(signal, 2.0))
