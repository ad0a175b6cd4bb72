"""Force shading: facets vanish, directions and amplitudes are independent, empty space has no weight."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy import ndimage

from touchfield.errors import InvalidArgument
from touchfield.filters.shading import SMOOTHED, ShadingFilter
from touchfield.medium import ForceField, Grid
from touchfield.sources.laws import LawSpec, profile_of
from touchfield.sources.mesh.mesh_scene import MeshScene

Float64s = NDArray[np.float64]


def units_and_lengths(dense: NDArray[np.float32]) -> tuple[Float64s, Float64s]:
    """Unit vectors and lengths of a dense field; zero where there is no force."""
    lengths = np.linalg.norm(dense.astype(np.float64), axis=-1)
    return dense / np.where(lengths > 0, lengths, 1)[..., None], lengths


def gaussian(values: Float64s, sigmas: tuple[float, ...]) -> Float64s:
    return np.asarray(ndimage.gaussian_filter(values, sigmas, mode="constant"))


def faceted(triangles: int = 80, samples: int = 40) -> tuple[ForceField, float]:
    """The wall of an icosphere of 30 mm, and the mean edge length of its triangles."""
    mesh = trimesh.creation.icosphere(subdivisions={80: 1, 320: 2}[triangles], radius=0.03)
    grid = Grid.over_box((-0.036,) * 3, (0.036,) * 3, (samples,) * 3)
    field = MeshScene(mesh.vertices, mesh.faces).field(0, grid, profile_of(LawSpec(), 0.0066))
    return field, float(np.mean(mesh.edges_unique_length))


def off_radial_deg(field: ForceField) -> Float64s:
    """The angle between each force and the sphere's radius, degrees."""
    points, forces = field.grid.to_m(field.positions()), field.vectors_n().astype(np.float64)
    cosine = (points * forces).sum(1) / np.linalg.norm(points, axis=1) / np.linalg.norm(forces, axis=1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


# -- what it is for ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("triangles", [80, 320])
def test_facets_of_a_coarse_sphere_vanish(triangles: int) -> None:
    field, edge_m = faceted(triangles)
    before, after = off_radial_deg(field), off_radial_deg(ShadingFilter(0.4 * edge_m)(field))
    rms = [float(np.sqrt((a**2).mean())) for a in (before, after)]
    assert rms[0] > 5
    assert rms[1] < rms[0] / 12
    assert after.max() < before.max() / 12


# -- what it is --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sigma_m", [0.0011, 0.0025, 0.02])
def test_shading_is_two_gaussians_over_the_support(wavy_field: ForceField, sigma_m: float) -> None:
    dense = wavy_field.to_dense()
    supported, sigmas = dense.any(axis=-1), tuple(sigma_m / h for h in wavy_field.grid.spacing_m)
    unit, lengths = units_and_lengths(dense)
    mean = np.stack([gaussian(unit[..., c], sigmas) for c in range(3)], axis=-1)
    directions = mean / np.maximum(np.linalg.norm(mean, axis=-1), 1e-12)[..., None]
    weights = gaussian(supported.astype(float), sigmas)
    amplitudes = gaussian(lengths, sigmas) / np.where(supported, weights, 1)
    expected = {
        "both": directions * amplitudes[..., None],
        "direction": directions * lengths[..., None],
        "amplitude": unit * amplitudes[..., None],
    }
    for smooth in SMOOTHED:
        got = ShadingFilter(sigma_m, smooth)(wavy_field).to_dense()
        assert got[supported] == pytest.approx(expected[smooth][supported], abs=2e-6)
        assert not got[~supported].any()
    assert np.abs(expected["both"] - dense)[supported].max() > 0.1


@given(
    arrays(np.float32, (9, 7, 10, 3), elements=st.floats(-9, 9, width=32)),
    arrays(np.float64, (9, 7, 10, 1), elements=st.floats(0.01, 100)),
)
def test_directions_do_not_depend_on_amplitudes(forces: NDArray[np.float32], factors: Float64s) -> None:
    forces[np.linalg.norm(forces.astype(float), axis=-1) < 1e-3] = 0
    grid = Grid((9, 7, 10), (0.001,) * 3, (0, 0, 0))
    a, b = (ForceField.from_dense(grid, f) for f in (forces, forces * factors))
    step = ShadingFilter(0.001)
    first, second = (units_and_lengths(step(f).to_dense())[0] for f in (a, b))
    sums = np.stack([gaussian(units_and_lengths(forces)[0][..., c], (1, 1, 1)) for c in range(3)], axis=-1)
    clear = np.linalg.norm(sums, axis=-1) > 1e-2  # elsewhere the direction is dominated by rounding
    assert first[clear] == pytest.approx(second[clear], abs=1e-4)


@given(
    arrays(np.float32, (9, 7, 10, 3), elements=st.floats(-9, 9, width=32, allow_subnormal=False)),
    st.floats(2e-4, 6e-3),
)
def test_claims(forces: NDArray[np.float32], sigma_m: float) -> None:
    field = ForceField.from_dense(Grid((9, 7, 10), (0.001, 0.002, 0.001), (0, 0, 0)), forces)
    unit, lengths = units_and_lengths(field.to_dense())
    supported, max_length = field.to_dense().any(axis=-1), lengths.max()
    for smooth in SMOOTHED:
        step = ShadingFilter(sigma_m, smooth)
        claims, out = step.claims(field.grid), step(field)
        new_unit, new_lengths = units_and_lengths(out.to_dense())
        assert claims.max_principle and not claims.linear and not claims.keeps_mean
        assert new_lengths.max() <= max_length * (1 + 1e-6)
        assert claims.keeps_support and np.array_equal(out.mask, field.mask)
        assert claims.keeps_amplitude == (smooth == "direction")
        if claims.keeps_amplitude:
            assert new_lengths == pytest.approx(lengths, rel=1e-6, abs=1e-7 * max_length)
        assert claims.keeps_direction == (smooth == "amplitude")
        if claims.keeps_direction:
            both = supported & (new_lengths > 1e-30)
            assert new_unit[both] == pytest.approx(unit[both], abs=1e-6)


def test_empty_space_and_the_border_have_no_weight() -> None:
    grid = Grid((20, 20, 20), (0.001,) * 3, (0, 0, 0))
    dense = np.zeros((20, 20, 20, 3), np.float32)
    dense[np.random.default_rng(2).random((20, 20, 20)) < 0.1] = (1.2, -0.5, 2.0)
    got = ShadingFilter(0.003)(ForceField.from_dense(grid, dense)).to_dense()
    assert got == pytest.approx(dense, rel=1e-6)


def test_samples_beyond_the_reach_have_no_effect(wavy_field: ForceField) -> None:
    dense = wavy_field.to_dense()
    changed = dense.copy()
    index = np.argwhere(dense.any(-1))[200]
    changed[tuple(index)] = (-3, 1, 0.5)
    step = ShadingFilter(0.0011)
    filtered, filtered_changed = (
        step(ForceField.from_dense(wavy_field.grid, d)).to_dense() for d in (dense, changed)
    )
    distance = np.abs(np.argwhere((filtered != filtered_changed).any(-1)) - index).max(axis=0)
    reach = step.claims(wavy_field.grid).reach
    assert reach == (4, 2, 3)
    assert (distance <= reach).all() and distance.tolist()[0] == 4


def test_sample_keeps_its_direction_where_directions_cancel() -> None:
    grid = Grid((128, 2, 2), (0.001,) * 3, (0, 0, 0))
    line = [[60, 0, 0], [61, 0, 0], [62, 0, 0], [63, 0, 0]]
    field = ForceField.from_support(grid, line, [[0, 1, 0], [0, -1, 0], [0, 1, 0], [0, -1, 0]])
    assert ShadingFilter(0.1)(field).vectors_n()[:, 1] == pytest.approx([1, -1, 1, -1])
    # where they do not cancel exactly, the majority determines the direction
    assert ShadingFilter(0.005)(field).vectors_n()[:, 1] == pytest.approx([1, 1, -1, -1])


# -- bits, scales, edges -----------------------------------------------------------------------------------


def test_the_same_bits_for_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    field, _ = faceted(320)
    results = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
        results.append(ShadingFilter(0.003)(field))
    assert results[0] == results[1] == results[2]


def test_shading_is_scale_invariant(wavy_field: ForceField) -> None:
    expected = ShadingFilter(0.003)(wavy_field).to_dense()
    for factor in (2.0**-90, 2.0**100):
        got = ShadingFilter(0.003)(wavy_field.scaled(factor)).to_dense().astype(np.float64)
        assert got / factor == pytest.approx(expected, abs=1e-6)


def test_empty_fields_and_flat_grids() -> None:
    flat = Grid((32, 20, 1), (0.01, 0.01, 0.06), (0, 0, 0))
    empty = ForceField.empty(flat)
    assert ShadingFilter(0.01)(empty) == empty
    dense = np.zeros((32, 20, 1, 3), np.float32)
    dense[8:24, 4:16, 0, 2] = np.random.default_rng(5).random((16, 12)) + 0.5
    step = ShadingFilter(0.02, "amplitude")
    got = step(ForceField.from_dense(flat, dense)).to_dense()[8:24, 4:16, 0, 2]
    assert step.claims(flat).reach == (8, 8, 0)
    assert got.std() < 0.25 * dense[8:24, 4:16, 0, 2].std()


def test_text_round_trip() -> None:
    assert ShadingFilter.parse("2mm") == ShadingFilter(0.002)
    assert ShadingFilter.parse("sigma=2mm,smooth=direction") == ShadingFilter(0.002, "direction")
    for step in (ShadingFilter(0.0015), ShadingFilter(1e-4, "amplitude")):
        assert ShadingFilter.parse(step.text) == step
        # the notation of older streams
        assert ShadingFilter.parse(f"{step.text},truncate=4.0,spread=false") == step
    with pytest.raises(InvalidArgument, match="each of sigma, smooth at most once"):
        ShadingFilter.parse("2mm,truncate=3")
    with pytest.raises(InvalidArgument, match="spread"):
        ShadingFilter.parse("2mm,spread=true")


@pytest.mark.parametrize(
    "wrong",
    [
        {"sigma_m": 0.0}, {"sigma_m": -1.0}, {"sigma_m": math.nan}, {"sigma_m": math.inf}, {"smooth": "all"},
    ],
)  # fmt: skip
def test_invalid_values_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InvalidArgument, match=next(iter(wrong))):
        ShadingFilter(**{"sigma_m": 0.001, **wrong})  # type: ignore[arg-type]


def test_huge_grid_with_few_bricks() -> None:
    for shape in ((1 << 20, 8, 8), (1 << 20, 1 << 20, 1 << 20)):
        grid = Grid(shape, (1e-6,) * 3, (0, 0, 0))
        # corners and adjacent samples
        positions = [[0, 0, 0], [0, 0, 1], [shape[0] - 1, shape[1] - 1, shape[2] - 2], [n - 1 for n in shape]]
        field = ForceField.from_support(grid, positions, [[1, 0, 0], [3, 0, 0], [0, 1, 0], [0, 3, 0]])
        centre_weight, neighbour_weight = 1.0, math.exp(-0.5 / 4)
        low, high = (
            (centre_weight * 1 + neighbour_weight * 3) / (centre_weight + neighbour_weight),
            (centre_weight * 3 + neighbour_weight * 1) / (centre_weight + neighbour_weight),
        )
        expected = [[low, 0, 0], [high, 0, 0], [0, low, 0], [0, high, 0]]
        assert ShadingFilter(2e-6)(field).vectors_n() == pytest.approx(np.array(expected), rel=1e-6)
    lone = ForceField.from_support(grid, [[5, 6, 7]], [[1, 2, 2]])
    assert ShadingFilter(2e-5)(lone).vectors_n() == pytest.approx(np.array([[1, 2, 2]]), rel=1e-6)


def test_too_large_reach_is_refused() -> None:
    grid = Grid((1 << 20, 1 << 20, 1 << 20), (1e-6,) * 3, (0, 0, 0))
    field = ForceField.from_support(grid, [[1, 1, 1], [1 << 19, 1, 1]], [[1, 0, 0], [1, 0, 0]])
    with pytest.raises(InvalidArgument, match="a radius of up to 32768 samples"):
        ShadingFilter(0.01)(field)
