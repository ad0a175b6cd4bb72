"""Spatial masking: against a dense correlation, the plain mask, its laws, arrays and body sites."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy import ndimage, signal

from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid
from touchfield.perception.human import figure
from touchfield.perception.mask import (
    SpatialMasking,
    body_mask_n,
    mask_n,
    site_weights,
    violations,
)

GRID = Grid((24, 20, 17), (0.001, 0.002, 0.0015), (-0.01, 0.0, 0.02))


def noise(grid: Grid, seed: int, share: float = 0.1) -> ForceField:
    rng = np.random.default_rng(seed)
    held = rng.random(grid.shape) < share
    return ForceField.from_dense(grid, rng.normal(size=(*grid.shape, 3)) * held[..., None])


def lattice_weights(grid: Grid, radius_m: float) -> NDArray[np.float64]:
    """w_ij around one sample, densely."""
    reach = [int(radius_m / h + 1e-9) if n > 1 else 0 for h, n in zip(grid.spacing_m, grid.shape, strict=True)]
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


# -- of a field -------------------------------------------------------------------------------------------------


@settings(max_examples=20)
@given(
    st.tuples(*[st.integers(1, 30)] * 3).filter(lambda s: max(s) > 1),
    st.integers(0, 99),
    st.sampled_from([0.0021, 0.006, 0.0135]),
    st.sampled_from([0.002, 0.05, 0.6]),
)
def test_equals_the_dense_correlation(shape: tuple[int, int, int], seed: int, radius_m: float, share: float) -> None:
    grid = Grid(shape, (0.001, 0.002, 0.0015), (0.0, 0.0, 0.0))
    field = noise(grid, seed, share)
    masking = SpatialMasking(0.1, 0.02, 0.4, radius_m)
    levels = amplitudes(field)
    around = ndimage.correlate(levels, lattice_weights(grid, radius_m), mode="constant")
    expected = np.maximum(0.02, 0.1 * levels + 0.4 * around)
    masks = masking.field_mask_n(field)
    assert masks.dtype == np.float32 and masks.shape == field.forces_n.shape[:-1]
    made = dense(field, masks)
    stored = ~np.isnan(made)
    assert made[stored] == pytest.approx(expected[stored], rel=1e-6)
    assert stored.any() == bool(levels.any())


def test_a_reach_beyond_the_next_brick() -> None:
    grid = Grid((70, 41, 60), (0.001,) * 3, (0.0, 0.0, 0.0))
    field = noise(grid, 3, 2e-4)
    assert 20 < len(field.bricks) < 200
    levels = amplitudes(field)
    around = signal.fftconvolve(levels, lattice_weights(grid, 0.019), mode="same")
    made = dense(field, SpatialMasking(0.0, 0.0, 1.0, 0.019).field_mask_n(field))
    stored = ~np.isnan(made)
    assert made[stored] == pytest.approx(around[stored], rel=1e-6, abs=1e-12)


def test_without_beta_it_is_the_plain_mask_to_the_last_bit() -> None:
    field = noise(GRID, 1)
    x, y, z = np.moveaxis(field.forces_n.astype(np.float64), -1, 0)
    plain = mask_n(np.sqrt(x * x + y * y + z * z), 0.1, 0.05).astype(np.float32)
    for radius_m in (1e-6, 0.01):  # where there is no beta the neighbours do not matter
        assert np.array_equal(SpatialMasking(0.1, 0.05, 0.0, radius_m).field_mask_n(field), plain)
    assert SpatialMasking(0.1).beta == 0
    lone = ForceField.from_support(GRID, [[10, 10, 10]], [[0.0, 3.0, 4.0]])
    masks = SpatialMasking(0.1, 0.0, 1.0, 0.006).field_mask_n(lone)
    assert dense(lone, masks)[10, 10, 10] == np.float32(0.5)  # w_ii = 0: a lone force hides itself by k alone


def test_a_uniform_stimulus_hides_beta_of_itself() -> None:
    field = ForceField.from_dense(GRID, np.broadcast_to(np.float32([2.0, 0.0, 0.0]), (*GRID.shape, 3)))
    made = dense(field, SpatialMasking(0.1, 0.0, 0.25, 0.006).field_mask_n(field))
    assert made[6:-6, 3:-3, 4:-4] == pytest.approx(0.1 * 2 + 0.25 * 2, rel=1e-6)  # sum_j w_ij = 1
    assert made[0, 0, 0] < 0.6  # beyond the border there is none


@settings(max_examples=30)
@given(st.integers(0, 99), st.tuples(*[st.integers(0, n - 1) for n in GRID.shape]), st.floats(1e-6, 2))
def test_the_mask_rises_with_every_force(seed: int, place: tuple[int, int, int], more: float) -> None:
    field = noise(GRID, seed, 0.02)
    masking = SpatialMasking(0.1, 0.02, 0.5, 0.005)
    before = dense(field, masking.field_mask_n(field))
    assert (before >= dense(field, SpatialMasking(0.1, 0.02).field_mask_n(field)))[~np.isnan(before)].all()
    forces = field.to_dense()
    size = np.linalg.norm(forces[place])
    forces[place] = [size + more, 0, 0] if size == 0 else forces[place] * (1 + more)
    louder = ForceField.from_dense(GRID, forces)
    after = dense(louder, masking.field_mask_n(louder))
    both = ~np.isnan(before)
    assert (after[both] >= before[both]).all()
    assert after[place] > (0.0 if np.isnan(before[place]) else before[place]) or after[place] == np.float32(0.02)


def test_the_mask_scales_with_the_forces() -> None:
    field = noise(GRID, 2)
    masks = SpatialMasking(0.1, 0.02, 0.5, 0.005).field_mask_n(field)
    assert np.array_equal(SpatialMasking(0.1, 0.04, 0.5, 0.005).field_mask_n(field.scaled(2)), 2 * masks)
    assert np.array_equal(
        SpatialMasking(0.1, 0.0, 0.0).field_mask_n(field.scaled(-4)), 4 * SpatialMasking(0.1).field_mask_n(field)
    )


def test_the_same_bits_for_any_number_of_threads_and_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    from touchfield.medium import field as module

    field = noise(Grid((64, 64, 64), (0.001,) * 3, (0.0, 0.0, 0.0)), 5, 0.01)
    masking, made = SpatialMasking(0.1, 0.0, 0.5, 0.01), []
    for threads, pieces in (("1", 1 << 21), ("3", 1 << 21), ("2", 37 << 14)):
        monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
        monkeypatch.setattr(module, "_BLOCK_VALUES", pieces)
        made.append(masking.field_mask_n(field))
    assert np.array_equal(made[0], made[1]) and np.array_equal(made[0], made[2])


def test_an_empty_field_has_no_masks() -> None:
    assert SpatialMasking(0.1, beta=0.5, radius_m=0.01).field_mask_n(ForceField.empty(GRID)).shape == (0, 8, 8, 8)


# -- of arrays and sites ----------------------------------------------------------------------------------------


def array_mask_n(
    masking: SpatialMasking, levels: NDArray[np.float64], pitch: tuple[float, float]
) -> NDArray[np.float64]:
    """The mask of an array of actuators [N, M]: its places are the sites."""
    along = [p * np.arange(n) for p, n in zip(pitch, levels.shape, strict=True)]
    places = np.stack(np.meshgrid(*along, indexing="ij"), -1)
    return body_mask_n(levels.reshape(-1), places.reshape(-1, 2), [masking] * levels.size).reshape(levels.shape)


def test_a_field_one_sample_deep_is_an_array_away_from_its_border() -> None:
    grid = Grid((30, 40, 1), (0.01, 0.012, 0.01), (0.0, 0.0, 0.0))
    field = noise(grid, 4, 0.5)
    masking = SpatialMasking(0.07, 0.01, 0.5, 0.03)
    plane = array_mask_n(masking, amplitudes(field)[..., 0], (0.01, 0.012))
    made = dense(field, masking.field_mask_n(field))[..., 0]
    assert made[3:-3, 2:-2] == pytest.approx(plane[3:-3, 2:-2], rel=1e-6)
    assert (made <= plane * (1 + 1e-6)).all()  # beyond the border the field has silence, the array nothing


@given(arrays(np.float64, (4, 3), elements=st.floats(0, 10)), st.integers(0, 11), st.floats(0, 5))
def test_arrays_keep_the_laws(levels: NDArray[np.float64], one: int, more: float) -> None:
    masking, plain = SpatialMasking(0.1, 0.02, 0.4, 0.025), SpatialMasking(0.1, 0.02)
    made = array_mask_n(masking, levels, (0.01, 0.01))
    assert np.array_equal(array_mask_n(plain, levels, (0.01, 0.01)), mask_n(levels, 0.1, 0.02))
    assert (made >= mask_n(levels, 0.1, 0.02)).all()
    louder = levels.copy()
    louder.flat[one] += more
    assert (array_mask_n(masking, louder, (0.01, 0.01)) >= made).all()
    twice = SpatialMasking(0.1, 0.04, 0.4, 0.025)
    assert np.array_equal(array_mask_n(twice, 2 * levels, (0.01, 0.01)), 2 * made)


def test_weights_of_sites() -> None:
    places = [[0.0, 0.0], [0.02, 0.0], [0.0, 0.03], [0.5, 0.5]]
    weights = site_weights(places, [0.04, 0.025, 0.04, 0.04])
    assert np.array_equal(np.diag(weights), np.zeros(4))
    assert weights.sum(axis=1) == pytest.approx([1, 1, 1, 0])
    near, far = np.exp(-2 * 0.5**2), np.exp(-2 * 0.75**2)
    assert weights[0] == pytest.approx([0, near / (near + far), far / (near + far), 0])
    assert weights[1] == pytest.approx([1, 0, 0, 0])  # the third lies beyond R_1 along y
    assert (site_weights([[0.0]], [1.0]) == 0).all()


def test_body_sites_have_their_own_figures() -> None:
    finger = SpatialMasking.at_site("finger", beta=0.2)
    assert finger == SpatialMasking(figure("force_weber_fraction"), 0.0, 0.2, 0.0025)
    assert SpatialMasking(0.1).radius_m == 0.0025
    forearm = SpatialMasking.at_site("forearm", k=0.2, f0_n=0.1)
    assert forearm == SpatialMasking(0.2, 0.1, 0.0, 0.035)
    with pytest.raises(InvalidArgument, match="Weber fraction"):
        SpatialMasking.at_site("forearm")
    with pytest.raises(InvalidArgument, match="finger, palm"):
        SpatialMasking.at_site("ear")


def test_a_strong_neighbour_hides_a_weak_one_on_a_forearm_and_not_on_a_finger() -> None:
    places = [[0.0], [0.02]]
    levels = [1.0, 0.05]
    arm = body_mask_n(levels, places, [SpatialMasking.at_site("forearm", 0.3, 0.1)] * 2)
    assert arm == pytest.approx([0.1 + 0.3 * 0.05, 0.005 + 0.3])
    tips = body_mask_n(levels, places, [SpatialMasking.at_site("finger", 0.3, 0.1)] * 2)
    assert tips == pytest.approx([0.1, 0.005])
    mixed = body_mask_n(levels, places, [SpatialMasking(0.1), SpatialMasking(0.2, 0.4)])
    assert mixed == pytest.approx([0.1, 0.4])


# -- faults -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [-0.1, math.nan, math.inf])
def test_parameters_that_make_no_sense(bad: float) -> None:
    for name in ("k", "f0_n", "beta", "radius_m"):
        with pytest.raises(InvalidArgument, match=name):
            SpatialMasking(**{"k": 0.1, name: bad})
        for word in ("a", None, [0.1]):
            with pytest.raises(InvalidArgument, match=f"{name}: found .*; expected a (finite|positive) number"):
                SpatialMasking(**{"k": 0.1, name: word})  # type: ignore[arg-type]
    assert SpatialMasking(np.float32(0.5), beta=np.int64(1)) == SpatialMasking(0.5, beta=1)  # type: ignore[arg-type]
    with pytest.raises(InvalidArgument, match="radius_m"):
        SpatialMasking(0.1, radius_m=0.0)


def test_a_radius_that_does_not_fit_the_lattice() -> None:
    field = noise(GRID, 1)
    with pytest.raises(InvalidArgument, match="radius_m"):
        SpatialMasking(0.1, beta=0.1, radius_m=0.0009).field_mask_n(field)
    with pytest.raises(InvalidArgument, match="at most 64 samples"):
        SpatialMasking(0.1, beta=0.1, radius_m=0.066).field_mask_n(field)
    column = noise(Grid((1, 1, 9), (0.001, 0.001, 0.01), (0.0, 0.0, 0.0)), 1, 0.9)
    masking = SpatialMasking(0.1, beta=0.1, radius_m=0.005)
    with pytest.raises(InvalidArgument, match=r"at least the distance between neighbours, 0\.01 m"):
        masking.field_mask_n(column)


@pytest.mark.parametrize("radius_m", [0.0001, 0.005, 1.0])
def test_one_sample_alone_has_the_plain_mask(radius_m: float) -> None:
    masking, plain = SpatialMasking(0.1, 0.02, 0.5, radius_m), SpatialMasking(0.1, 0.02)
    lone = ForceField.from_dense(Grid((1, 1, 1), (0.001,) * 3, (0.0,) * 3), np.full((1, 1, 1, 3), 3.0))
    assert np.array_equal(masking.field_mask_n(lone), plain.field_mask_n(lone))
    assert np.array_equal(body_mask_n([[0.1], [4.0]], [[0.0]], [masking]), mask_n([[0.1], [4.0]], 0.1, 0.02))


def test_sites_that_do_not_fit() -> None:
    masking = SpatialMasking(0.1, beta=0.1, radius_m=0.02)
    for levels in (1.0, np.ones(3), np.array([[1.0, math.nan]]), np.array([[1.0, -1.0]]), np.zeros((0, 3))):
        with pytest.raises(InvalidArgument, match="amplitudes_n"):
            body_mask_n(levels, [[0.0], [0.01]], [masking] * 2)
    ragged = [[1.0, 2.0], [3.0]]
    with pytest.raises(InvalidArgument, match="amplitudes_n: found what is no array of numbers"):
        body_mask_n(ragged, [[0.0], [0.01]], [masking] * 2)
    with pytest.raises(InvalidArgument, match="positions_m: found what is no array of numbers"):
        body_mask_n([1.0, 2.0], ragged, [masking] * 2)
    with pytest.raises(InvalidArgument, match="radii_m: found what is no array of numbers"):
        site_weights([[0.0], [1.0]], ragged)
    with pytest.raises(InvalidArgument, match="one for each site"):
        body_mask_n([1.0, 2.0], [[0.0], [1.0]], [masking])
    with pytest.raises(InvalidArgument, match="radii_m"):
        body_mask_n([1.0], [[0.0], [1.0]], [masking])
    with pytest.raises(InvalidArgument, match="positions_m"):
        body_mask_n([1.0], [[math.nan]], [masking])
    for radii in ([1.0], [1.0, 0.0], [1.0, math.inf]):
        with pytest.raises(InvalidArgument, match="radii_m"):
            site_weights([[0.0], [1.0]], radii)
    for places in (np.zeros((0, 2)), np.zeros((5000, 2)), np.zeros((2, 4)), np.zeros(2)):
        with pytest.raises(InvalidArgument, match="positions_m"):
            site_weights(places, np.ones(len(places)))


def test_violations_are_judged_by_what_the_neighbours_hide() -> None:
    field = noise(GRID, 7)
    x = field.forces_n[field.mask]
    y = x * np.float32(1.15)
    plain = violations(x, y, 0.1, 0.01)
    spatial = SpatialMasking(0.1, 0.01, beta=0.2, radius_m=0.003)
    hidden = spatial.field_mask_n(field)[field.mask].astype(float) - 0.1 * np.linalg.norm(x.astype(float), axis=1)
    masked = violations(x, y, 0.1, 0.01, masking_n=np.maximum(hidden, 0))
    error = np.linalg.norm((y - x).astype(float), axis=1)
    assert masked.count == np.count_nonzero(error > spatial.field_mask_n(field)[field.mask] * (1 + 1e-5))
    assert 0 < masked.count < plain.count
