"""Low-passes, their frequency responses, and resampling compared with the dense product."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray
from scipy import ndimage, signal

from random_fields import random_field
from touchfield.errors import InvalidArgument
from touchfield.filters import (
    LOW_PASSES,
    frequency_response,
    resample,
)
from touchfield.filters.resample import axis_weights, grid_weights, low_pass
from touchfield.medium import ForceField, Grid


def dense_resample(field: ForceField, grid: Grid, kernel: str) -> NDArray[np.float64]:
    weights = grid_weights(field.grid, grid, low_pass(kernel))
    x, y, z = (w.dense(n) for w, n in zip(weights, field.grid.shape, strict=True))
    return np.einsum("ia,jb,kc,abcd->ijkd", x, y, z, field.to_dense().astype(float), optimize=True)


def decibels(gain: NDArray[np.complex128]) -> NDArray[np.float64]:
    return 20 * np.log10(np.abs(gain))


# -- frequency response, equation 5 ------------------------------------------------------------------------


def test_frequency_response_of_known_filters() -> None:
    assert decibels(frequency_response(np.ones(3) / 3, 0.9756)) == pytest.approx(-3.01, abs=0.005)
    fir = decibels(frequency_response(signal.firwin(31, 1 / 4), np.pi * np.array([0.25, 0.375])))
    assert fir == pytest.approx([-6.010, -54.5], abs=0.05)
    assert abs(frequency_response([-1, 2, -1], 0.0)) < 1e-15
    omega = (np.arange(4096) + 0.5) * 2 * np.pi / 4096
    for taps, bits in (([0.25, 0.5, 0.25], -2.0), (np.ones(3) / 3, -1.584963)):
        assert np.log2(np.abs(frequency_response(taps, omega))).mean() == pytest.approx(bits, abs=2e-3)


def test_frequency_response_in_two_and_three_dimensions() -> None:
    rng = np.random.default_rng(1)
    for taps in (rng.normal(size=(3, 5)), rng.normal(size=(2, 3, 4))):
        omegas = rng.uniform(-3, 3, (taps.ndim, 7, 2))
        indices = np.stack(np.indices(taps.shape), axis=0).reshape(taps.ndim, -1)
        direct = np.exp(-1j * np.einsum("aij,an->ijn", omegas, indices)) @ taps.reshape(-1)
        assert np.allclose(frequency_response(taps, *omegas), direct)
    with pytest.raises(InvalidArgument, match="one for each axis"):
        frequency_response(np.ones((3, 3)), 0.5)


@pytest.mark.parametrize(
    ("name", "minus_three", "at_cutoff", "at_stop", "overshoot"),
    [
        ("spline", 0.71, -6.0, -14.2, 0.0),
        ("box", 0.89, -3.9, -10.5, 0.0),
        ("sinc", 0.90, -6.0, -54.0, 0.076),
    ],
)
def test_the_table_of_kernels_is_as_documented(
    name: str, minus_three: float, at_cutoff: float, at_stop: float, overshoot: float
) -> None:
    kernel, step = LOW_PASSES[name], 1e-3
    x = np.arange(-3, 3, step) + step / 2
    taps = kernel.shape(x, step) * (np.abs(x) <= kernel.half_width)
    taps /= taps.sum()
    gains = decibels(frequency_response(taps, 2 * np.pi * step * np.array([minus_three, 1.0, 1.5])))
    assert gains == pytest.approx([-3.01, at_cutoff, at_stop], abs=0.6)
    rise = np.cumsum(taps)
    assert rise.max() - 1 == pytest.approx(overshoot, abs=1e-3)
    assert np.allclose(taps[::-1], taps, atol=1e-12)
    assert (taps.min() >= 0) == (overshoot == 0)


# -- resampling --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kernel", LOW_PASSES)
@pytest.mark.parametrize(
    ("shape", "target"),
    [
        ((20, 33, 41), (10, 11, 20)),
        ((16, 16, 16), (16, 16, 16)),
        ((30, 9, 1), (13, 20, 1)),
        ((12, 30, 17), (40, 11, 33)),
    ],
)
def test_resample_equals_the_dense_product(
    kernel: str, shape: tuple[int, int, int], target: tuple[int, int, int]
) -> None:
    field = random_field(Grid.over_box((0, 0, 0), (1, 1.3, 0.7), shape), 3)
    grid = Grid.over_box((-0.1, 0.2, 0), (0.9, 1.5, 0.7), target)
    resampled, expected = resample(field, grid, kernel), dense_resample(field, grid, kernel)
    assert np.abs(resampled.to_dense() - expected).max() < 1e-6
    assert np.abs(expected).max() > 0.1
    # no empty brick, and no sample outside the grid
    assert resampled == ForceField.from_dense(grid, resampled.to_dense())


@given(
    st.tuples(*[st.integers(1, 20)] * 3), st.tuples(*[st.integers(1, 20)] * 3),
    st.tuples(*[st.floats(-0.6, 0.6)] * 3), st.integers(0, 99), st.sampled_from(sorted(LOW_PASSES)),
)  # fmt: skip
def test_resample_to_any_lattice_is_linear_and_equals_the_dense_product(
    shape: tuple[int, int, int],
    target: tuple[int, int, int],
    shift: tuple[float, float, float],
    seed: int,
    kernel: str,
) -> None:
    source = Grid.over_box((0, 0, 0), (1, 1, 1), shape)
    grid = Grid.over_box(shift, np.add(shift, (1, 0.8, 1.2)), target)
    a, b = random_field(source, seed, 0.2), random_field(source, seed + 1, 0.2)
    resampled = resample(a, grid, kernel).to_dense()
    assert np.abs(resampled - dense_resample(a, grid, kernel)).max() < 3e-6
    both = resample(a + b.scaled(2), grid, kernel).to_dense()
    assert np.abs(both - resampled - 2 * resample(b, grid, kernel).to_dense()).max() < 2e-5


def test_resample_is_the_same_for_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    field = random_field(Grid.over_box((0, 0, 0), (1, 1, 1), (64, 64, 64)), 5, 0.01)
    grid = Grid.over_box((0, 0, 0), (1, 1, 1), (48, 48, 48))
    results = []
    for threads in ("1", "3"):
        monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
        results.append(resample(field, grid))
    assert results[0] == results[1]


@pytest.mark.parametrize("kernel", LOW_PASSES)
@pytest.mark.parametrize("factor", [1, 2, 3, 5])
def test_a_constant_passes_unchanged_in_the_interior(kernel: str, factor: int) -> None:
    source = Grid.over_box((0, 0, 0), (1, 1, 1), (50, 50, 50))
    grid = Grid.over_box((0, 0, 0), (1, 1, 1), (50 // factor,) * 3)
    force = np.array([1.0, -2.0, 0.5])
    dense = resample(
        ForceField.from_dense(source, np.broadcast_to(force, (50, 50, 50, 3))), grid, kernel
    ).to_dense()
    rim = math.ceil(2 * LOW_PASSES[kernel].half_width)
    inner = dense[(slice(rim, -rim),) * 3]
    assert inner.size > 0
    assert np.abs(inner - force).max() < 2e-6


@pytest.mark.parametrize("factor", [2, 3, 4])
def test_decimation_by_the_box_keeps_the_total(factor: int) -> None:
    source = Grid.over_box((0, 0, 0), (1, 1, 1), (24, 24, 24))
    field = random_field(source, 7)
    small = resample(field, Grid.over_box((0, 0, 0), (1, 1, 1), (24 // factor,) * 3), "box")
    blocks = field.to_dense().reshape(24 // factor, factor, 24 // factor, factor, 24 // factor, factor, 3)
    assert np.abs(small.to_dense() - blocks.mean(axis=(1, 3, 5))).max() < 1e-6
    total = field.vectors_n().sum(axis=0, dtype=float)
    assert small.vectors_n().sum(axis=0, dtype=float) * factor**3 == pytest.approx(total, abs=1e-4)


def test_smoothing_at_the_same_rate_equals_scipy() -> None:
    grid = Grid.over_box((0, 0, 0), (1, 1, 1), (20, 21, 22))
    field = random_field(grid, 9)
    expected = field.to_dense().astype(float)
    for axis in range(3):
        weights = grid_weights(grid, grid, low_pass("spline"))[axis].weights[10]
        expected = ndimage.convolve1d(expected, weights.astype(float), axis=axis, mode="constant")
    assert np.abs(resample(field, grid).to_dense() - expected).max() < 1e-6


def test_a_kernel_does_not_shift_the_field() -> None:
    source = Grid.over_box((0, 0, 0), (1, 1, 1), (60, 60, 60))
    points = source.to_m(np.stack(np.indices(source.shape), axis=-1))
    blob = np.exp(-((points - (0.47, 0.52, 0.55)) ** 2).sum(-1) / (2 * 0.08**2))
    field = ForceField.from_dense(source, blob[..., None] * np.array([0.0, 0.0, 1.0]))
    for count in (60, 30, 23):
        grid = Grid.over_box((0, 0, 0), (1, 1, 1), (count,) * 3)
        resampled = resample(field, grid)
        centre = np.average(grid.to_m(resampled.positions()), axis=0, weights=resampled.vectors_n()[:, 2])
        assert centre == pytest.approx((0.47, 0.52, 0.55), abs=2e-4)


@pytest.mark.parametrize("kernel", LOW_PASSES)
def test_a_wave_above_the_new_nyquist_rate_is_attenuated_as_designed(kernel: str) -> None:
    source = Grid((256, 1, 1), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    grid = Grid((64, 1, 1), (4.0, 1.0, 1.0), (1.5, 0.0, 0.0))
    weights = axis_weights((256, 1.0, 0.0), (64, 4.0, 1.5), low_pass(kernel), 1 / 8).weights[30]
    for frequency in (0.05, 0.1, 0.19, 0.23):  # the Nyquist rate of the target is 0.125
        wave = np.zeros((256, 1, 1, 3))
        wave[:, 0, 0, 0] = np.sin(2 * np.pi * frequency * np.arange(256))
        resampled = resample(ForceField.from_dense(source, wave), grid, kernel).to_dense()[8:-8, 0, 0, 0]
        designed = abs(frequency_response(weights, 2 * np.pi * frequency))
        assert np.sqrt(2 * np.mean(resampled**2)) == pytest.approx(designed, abs=0.03)
        if frequency > 0.18:
            assert designed < 0.35


def test_a_step_rings_only_where_the_kernel_has_negative_lobes() -> None:
    source = Grid((64, 4, 4), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    wall = np.zeros((64, 4, 4, 3))
    wall[20:44, ..., 0] = 1.0
    field, grid = ForceField.from_dense(source, wall), Grid((32, 1, 1), (2.0, 4.0, 4.0), (0.5, 1.5, 1.5))
    for kernel in LOW_PASSES:
        resampled = resample(field, grid, kernel).to_dense()[..., 0]
        assert (resampled.min() < -0.01) == (kernel == "sinc")
        if kernel != "sinc":
            assert resampled.max() <= 1.0 + 1e-6


def test_fields_that_cannot_be_resampled() -> None:
    source = Grid.over_box((0, 0, 0), (1, 1, 1), (8, 8, 8))
    field = random_field(source, 1, 1.0)
    assert resample(ForceField.empty(source), source).support_count == 0
    assert resample(field, Grid.over_box((5, 5, 5), (6, 6, 6), (8, 8, 8))).support_count == 0
    with pytest.raises(InvalidArgument, match="low_pass"):
        resample(field, source, "brick wall")
    with pytest.raises(InvalidArgument, match="cutoff_per_m"):
        axis_weights((8, 0.1, 0.0), (8, 0.1, 0.0), low_pass("spline"), 0.0)
    with pytest.raises(InvalidArgument, match="bricks reached"):
        resample(field, Grid.over_box((0, 0, 0), (1, 1, 1), (1 << 14,) * 3))
    with pytest.raises(InvalidArgument, match="coarser source"):
        axis_weights((8, 0.1, 0.0), (8, 0.1, 0.0), low_pass("spline"), 1e-9)
    with pytest.raises(InvalidArgument, match="to each of 8388608"):
        axis_weights((8, 0.1, 0.0), (1 << 23, 0.1, 0.0), low_pass("spline"), 5.0)
    flat = Grid((8, 8, 1), (0.1, 0.1, 0.1), (0.0, 0.0, 0.0))
    assert resample(random_field(flat, 1, 1.0), flat).support_count > 0
    shifted = Grid((8, 8, 1), (0.1, 0.1, 0.1), (0.0, 0.0, 1.0))
    assert resample(random_field(flat, 1, 1.0), shifted).support_count == 0
