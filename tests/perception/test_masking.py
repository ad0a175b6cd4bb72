"""Spatial masking: against a dense correlation and the plain mask; its properties, arrays and body sites."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from scipy import ndimage, signal

from touchfield.errors import InvalidArgument
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField, Grid
from touchfield.perception.mask import (
    SpatialMasking,
    mask_n,
    site_radius_m,
    violations,
)

GRID = Grid((24, 20, 17), (0.001, 0.002, 0.0015), (-0.01, 0.0, 0.02))


def noise(grid: Grid, seed: int, density: float = 0.1) -> ForceField:
    rng = np.random.default_rng(seed)
    is_supported = rng.random(grid.shape) < density
    return ForceField.from_dense(grid, rng.normal(size=(*grid.shape, 3)) * is_supported[..., None])


def lattice_weights(grid: Grid, radius_m: float) -> NDArray[np.float64]:
    """w_ij around one sample, densely."""
    reach = [
        int(radius_m / h + 1e-9) if n > 1 else 0 for h, n in zip(grid.spacing_m, grid.shape, strict=True)
    ]
    offsets = np.stack(np.meshgrid(*[np.arange(-r, r + 1) for r in reach], indexing="ij"), axis=-1)
    w = np.exp(-2 * ((offsets * grid.spacing_m / radius_m) ** 2).sum(-1))
    w[tuple(reach)] = 0
    return w / w.sum()


def amplitudes(field: ForceField) -> NDArray[np.float64]:
    return np.linalg.norm(field.to_dense().astype(float), axis=-1)


def dense(field: ForceField, masks: NDArray[np.float32]) -> NDArray[np.float64]:
    """The masks of the bricks on the lattice; NaN where no brick is stored."""
    filled = np.full([8 * n for n in field.grid.brick_shape], np.nan)
    for (a, b, c), mask in zip(field.bricks * 8, masks, strict=True):
        filled[a : a + 8, b : b + 8, c : c + 8] = mask
    return filled[tuple(slice(n) for n in field.grid.shape)]


# -- of a field --------------------------------------------------------------------------------------------


@settings(max_examples=20)
@given(
    st.tuples(*[st.integers(1, 30)] * 3).filter(lambda s: max(s) > 1),
    st.integers(0, 99),
    st.sampled_from([0.0021, 0.006, 0.0135]),
    st.sampled_from([0.002, 0.05, 0.6]),
)
def test_masks_equal_the_dense_correlation(
    shape: tuple[int, int, int], seed: int, radius_m: float, density: float
) -> None:
    grid = Grid(shape, (0.001, 0.002, 0.0015), (0.0, 0.0, 0.0))
    field = noise(grid, seed, density)
    masking = SpatialMasking(0.1, 0.02, 0.4, radius_m)
    levels = amplitudes(field)
    neighbours = ndimage.correlate(levels, lattice_weights(grid, radius_m), mode="constant")
    expected = np.maximum(0.02, 0.1 * levels + 0.4 * neighbours)
    masks = masking.field_mask_n(field)
    assert masks.dtype == np.float32 and masks.shape == field.forces_n.shape[:-1]
    result = dense(field, masks)
    stored = ~np.isnan(result)
    assert result[stored] == pytest.approx(expected[stored], rel=1e-6)
    assert stored.any() == bool(levels.any())


def test_a_reach_beyond_the_next_brick() -> None:
    grid = Grid((70, 41, 60), (0.001,) * 3, (0.0, 0.0, 0.0))
    field = noise(grid, 3, 2e-4)
    assert 20 < len(field.bricks) < 200
    levels = amplitudes(field)
    neighbours = signal.fftconvolve(levels, lattice_weights(grid, 0.019), mode="same")
    masks = dense(field, SpatialMasking(0.0, 0.0, 1.0, 0.019).field_mask_n(field))
    stored = ~np.isnan(masks)
    assert masks[stored] == pytest.approx(neighbours[stored], rel=1e-6, abs=1e-12)


def test_without_beta_the_mask_equals_the_plain_one_bit_for_bit() -> None:
    field = noise(GRID, 1)
    x, y, z = np.moveaxis(field.forces_n.astype(np.float64), -1, 0)
    plain = mask_n(np.sqrt(x * x + y * y + z * z), 0.1, 0.05).astype(np.float32)
    for radius_m in (1e-6, 0.01):  # without beta the neighbours do not matter
        assert np.array_equal(SpatialMasking(0.1, 0.05, 0.0, radius_m).field_mask_n(field), plain)
    assert SpatialMasking(0.1).beta == 0
    lone = ForceField.from_support(GRID, [[10, 10, 10]], [[0.0, 3.0, 4.0]])
    masks = SpatialMasking(0.1, 0.0, 1.0, 0.006).field_mask_n(lone)
    assert dense(lone, masks)[10, 10, 10] == np.float32(0.5)  # w_ii = 0: a lone force masks itself by k alone


def test_a_uniform_stimulus_masks_beta_of_itself() -> None:
    field = ForceField.from_dense(GRID, np.broadcast_to(np.float32([2.0, 0.0, 0.0]), (*GRID.shape, 3)))
    masks = dense(field, SpatialMasking(0.1, 0.0, 0.25, 0.006).field_mask_n(field))
    assert masks[6:-6, 3:-3, 4:-4] == pytest.approx(0.1 * 2 + 0.25 * 2, rel=1e-6)  # sum_j w_ij = 1
    assert masks[0, 0, 0] < 0.6  # there is no stimulus beyond the border


@settings(max_examples=30)
@given(st.integers(0, 99), st.tuples(*[st.integers(0, n - 1) for n in GRID.shape]), st.floats(1e-6, 2))
def test_the_mask_rises_with_every_force(seed: int, index: tuple[int, int, int], more: float) -> None:
    field = noise(GRID, seed, 0.02)
    masking = SpatialMasking(0.1, 0.02, 0.5, 0.005)
    before = dense(field, masking.field_mask_n(field))
    assert (before >= dense(field, SpatialMasking(0.1, 0.02).field_mask_n(field)))[~np.isnan(before)].all()
    forces = field.to_dense()
    size = np.linalg.norm(forces[index])
    forces[index] = [size + more, 0, 0] if size == 0 else forces[index] * (1 + more)
    louder = ForceField.from_dense(GRID, forces)
    after = dense(louder, masking.field_mask_n(louder))
    both = ~np.isnan(before)
    assert (after[both] >= before[both]).all()
    assert after[index] > (0.0 if np.isnan(before[index]) else before[index]) or after[index] == np.float32(
        0.02
    )


def test_the_mask_scales_with_the_forces() -> None:
    field = noise(GRID, 2)
    masks = SpatialMasking(0.1, 0.02, 0.5, 0.005).field_mask_n(field)
    assert np.array_equal(SpatialMasking(0.1, 0.04, 0.5, 0.005).field_mask_n(field.scaled(2)), 2 * masks)
    assert np.array_equal(
        SpatialMasking(0.1, 0.0, 0.0).field_mask_n(field.scaled(-4)),
        4 * SpatialMasking(0.1).field_mask_n(field),
    )


def test_masks_are_independent_of_threads_and_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    from touchfield.medium import field as module

    field = noise(Grid((40, 40, 40), (0.001,) * 3, (0.0, 0.0, 0.0)), 5, 0.01)
    masking, masks = SpatialMasking(0.1, 0.0, 0.5, 0.01), []
    for threads, pieces in (("1", 1 << 21), ("3", 1 << 21), ("2", 37 << 14)):
        monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
        monkeypatch.setattr(module, "_BLOCK_VALUES", pieces)
        masks.append(masking.field_mask_n(field))
    assert np.array_equal(masks[0], masks[1]) and np.array_equal(masks[0], masks[2])


def test_an_empty_field_has_no_masks() -> None:
    assert SpatialMasking(0.1, beta=0.5, radius_m=0.01).field_mask_n(ForceField.empty(GRID)).shape == (
        0,
        8,
        8,
        8,
    )


# -- faults ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [-0.1, math.nan, math.inf])
def test_invalid_parameters_are_refused(bad: float) -> None:
    for name in ("k", "f0_n", "beta", "radius_m"):
        with pytest.raises(InvalidArgument, match=name):
            SpatialMasking(**{"k": 0.1, name: bad})
        for word in ("a", None, [0.1]):
            with pytest.raises(
                InvalidArgument, match=f"{name}: found .*; expected a (finite|positive) number"
            ):
                SpatialMasking(**{"k": 0.1, name: word})  # type: ignore[arg-type]
    assert SpatialMasking(np.float32(0.5), beta=np.int64(1)) == SpatialMasking(0.5, beta=1)  # type: ignore[arg-type]
    with pytest.raises(InvalidArgument, match="radius_m"):
        SpatialMasking(0.1, radius_m=0.0)


def test_a_radius_below_the_spacing_is_refused() -> None:
    field = noise(GRID, 1)
    with pytest.raises(InvalidArgument, match="radius_m"):
        SpatialMasking(0.1, beta=0.1, radius_m=0.0009).field_mask_n(field)
    with pytest.raises(InvalidArgument, match="at most 64 samples"):
        SpatialMasking(0.1, beta=0.1, radius_m=0.066).field_mask_n(field)
    column = noise(Grid((1, 1, 9), (0.001, 0.001, 0.01), (0.0, 0.0, 0.0)), 1, 0.9)
    masking = SpatialMasking(0.1, beta=0.1, radius_m=0.005)
    with pytest.raises(InvalidArgument, match=r"at least the distance between neighbours, 0\.01 m"):
        masking.field_mask_n(column)
    with pytest.raises(InvalidArgument, match=r"between neighbours, 0\.01 m"):
        masking.field_mask_n(noise(Grid((9, 1, 9), (0.02, 0.001, 0.01), (0.0, 0.0, 0.0)), 1, 0.9))
    row = noise(Grid((9, 1, 1), (0.001,) * 3, (0.0, 0.0, 0.0)), 1, 0.9)
    assert SpatialMasking(0.1, beta=0.1, radius_m=0.064).field_mask_n(row).any()
    assert SpatialMasking(0.1).radius_m == 0.0025 and site_radius_m("palm") == 0.01


@pytest.mark.parametrize("radius_m", [0.0001, 0.005, 1.0])
def test_a_single_sample_has_the_plain_mask(radius_m: float) -> None:
    masking, plain = SpatialMasking(0.1, 0.02, 0.5, radius_m), SpatialMasking(0.1, 0.02)
    lone = ForceField.from_dense(Grid((1, 1, 1), (0.001,) * 3, (0.0,) * 3), np.full((1, 1, 1, 3), 3.0))
    assert np.array_equal(masking.field_mask_n(lone), plain.field_mask_n(lone))


def test_violations_account_for_masking_by_neighbours() -> None:
    field = noise(GRID, 7)
    x = field.forces_n[field.mask]
    y = x * np.float32(1.15)
    plain = violations(x, y, 0.1, 0.01)
    spatial = SpatialMasking(0.1, 0.01, beta=0.2, radius_m=0.003)
    hidden = spatial.field_mask_n(field)[field.mask].astype(float) - 0.1 * np.linalg.norm(
        x.astype(float), axis=1
    )
    masked = violations(x, y, 0.1, 0.01, masking_n=np.maximum(hidden, 0))
    error = np.linalg.norm((y - x).astype(float), axis=1)
    assert masked.count == np.count_nonzero(error > spatial.field_mask_n(field)[field.mask] * (1 + 1e-5))
    assert 0 < masked.count < plain.count


def test_a_meter_applies_masking_to_the_right_brick() -> None:
    """Bricks of very different forces, one of them in the decoded field only, against a dense computation."""
    rng = np.random.default_rng(4)
    grid = Grid((40, 8, 8), (0.001,) * 3, (0.0,) * 3)
    dense = rng.normal(size=(*grid.shape, 3)) * np.repeat([4.0, 0.02, 1.0, 0.0, 0.2], 8)[:, None, None, None]
    original = ForceField.from_dense(grid, dense.astype(np.float32))
    decoded = ForceField.from_dense(
        grid, (original.to_dense() + rng.normal(0, 0.03, dense.shape)).astype(np.float32)
    )
    meter = FidelityMeter(0.05, 0.01, masking=(0.3, 0.0025))
    meter.add(original, decoded)
    hidden = np.zeros(grid.shape)
    hidden_blocks = SpatialMasking(0.0, 0.0, 0.3, 0.0025).hidden_n(original)
    for (x, y, z), block in zip(8 * original.bricks, hidden_blocks, strict=True):
        hidden[x : x + 8, y : y + 8, z : z + 8] = block
    force, error = (
        np.linalg.norm(v, axis=-1) for v in (original.to_dense(), decoded.to_dense() - original.to_dense())
    )
    ratio = error / np.maximum(0.01, 0.05 * force + hidden)
    assert meter.mask_violations == np.count_nonzero(ratio > 1) > 100
    assert meter.worst_mask_ratio == pytest.approx(ratio.max(), rel=1e-5)
