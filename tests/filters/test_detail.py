"""Level of detail: the pyramid, and reconstruction from its levels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from touchfield.errors import InvalidArgument
from touchfield.filters import RigidMotion, half_grid, interpolate, max_levels, pyramid, rebuild_level
from touchfield.medium import ForceField, Grid

GRID = Grid((32, 32, 32), (0.001,) * 3, (-0.0155,) * 3)


def constant(grid: Grid, force_n: tuple[float, float, float] = (0.1, -0.2, 0.3)) -> ForceField:
    return ForceField.from_dense(grid, np.broadcast_to(np.float32(force_n), (*grid.shape, 3)))


def smooth(wave_m: float, grid: Grid = GRID) -> ForceField:
    """A wave of force under an envelope that vanishes at the border."""
    x, y, z = np.meshgrid(*(grid.axis_m(a) for a in range(3)), indexing="ij")
    bump = np.exp(-(x**2 + y**2 + z**2) / (2 * 0.005**2))
    amplitude = bump * (1 + 0.5 * np.sin(2 * np.pi * x / wave_m))
    forces = amplitude[..., None] * np.array([0.6, 0.0, 0.8])
    return ForceField.from_dense(grid, np.where(amplitude[..., None] > 0.02, forces, 0))


shapes = st.tuples(*[st.integers(1, 40)] * 3)


@given(shapes)
def test_a_level_has_half_the_samples_and_twice_the_cell(shape: tuple[int, int, int]) -> None:
    grid = Grid(shape, (0.001, 0.002, 0.003), (0.1, 0.2, 0.3))
    coarse = half_grid(grid)
    for axis in range(3):
        assert np.allclose(coarse.axis_m(axis), grid.axis_m(axis)[::2], rtol=0, atol=1e-12)
        assert coarse.spacing_m[axis] == grid.spacing_m[axis] * (2 if shape[axis] > 1 else 1)
    for _ in range(max_levels(grid)):
        assert grid.shape != (1, 1, 1)
        grid = half_grid(grid)
    assert grid.shape == (1, 1, 1)


@given(shapes, st.integers(0, 99))
def test_level_has_every_second_sample(shape: tuple[int, int, int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = Grid(shape, (0.001, 0.002, 0.003), (0.1, 0.2, 0.3))
    field = ForceField.from_dense(grid, rng.normal(size=(*shape, 3)).astype(np.float32))
    for level, level_field in enumerate(pyramid(field, max_levels(grid))):
        step = 1 << level
        assert np.array_equal(level_field.to_dense(), field.to_dense()[::step, ::step, ::step])


def test_constant_field_is_unchanged() -> None:
    wide = Grid((64, 63, 64), (0.001,) * 3, (0.0,) * 3)
    field = constant(wide)
    for n, level in enumerate(pyramid(field, 3)):
        assert level == constant(level.grid)
        inner = (
            slice(None) if n < 2 else slice(0, 57),
        ) * 3  # the last sample of level 1 is outside its cell
        assert np.abs((rebuild_level(level, wide).to_dense() - field.to_dense())[inner]).max() < 1e-6


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("first", "thick"), [(7, 1), (15, 1), (16, 1), (6, 3), (13, 2)])
@pytest.mark.parametrize("sign", [1, -1])
def test_thin_wall_has_no_holes_and_does_not_move_forward(
    axis: int, first: int, thick: int, sign: int
) -> None:
    dense = np.zeros((*GRID.shape, 3), np.float32)
    lane = np.moveaxis(dense, axis, 0)
    lane[first : first + thick, ..., axis] = sign
    (_, coarse) = pyramid(ForceField.from_dense(GRID, dense), 1)
    level_forces = np.moveaxis(coarse.to_dense(), axis, 0)[..., axis]
    assert (np.abs(level_forces).max(axis=0) == 1).all(), "no hole"
    rebuilt = np.moveaxis(rebuild_level(coarse, GRID).to_dense(), axis, 0)[..., axis]
    # the force points to the surface; trilinear rendering fades over one spacing of the level
    in_front = rebuilt[first + thick + 1 :] if sign > 0 else rebuilt[: max(0, first - 1)]
    assert not in_front.any(), "nothing in front of the wall"
    assert np.abs(rebuilt[first : first + thick]).min() >= 0.5


def test_sampled_wall_is_not_thickened() -> None:
    """Exactly every second sample of a solid ball, whose surface lies between samples in many ways."""
    x, y, z = (np.stack(np.meshgrid(*(GRID.axis_m(a) for a in range(3)), indexing="ij"))) / 0.001
    distance_mm = np.sqrt(x * x + y * y + z * z)
    forces = (
        np.where(distance_mm < 9.3, 1, 0)[..., None]
        * np.stack([x, y, z], -1)
        / np.maximum(distance_mm, 0.1)[..., None]
    )
    (fine, coarse) = pyramid(ForceField.from_dense(GRID, forces), 1)
    assert np.array_equal(coarse.to_dense(), fine.to_dense()[::2, ::2, ::2])


def test_smooth_waves_are_rebuilt_and_fine_ones_are_not() -> None:
    def relative_error(wave_m: float) -> float:
        field = smooth(wave_m)
        error = rebuild_level(pyramid(field, 1)[1], GRID).to_dense() - field.to_dense()
        return float((error**2).sum() / (field.to_dense() ** 2).sum())

    assert relative_error(0.03) < 0.005 < 0.02 < relative_error(0.002)


def test_no_level_exceeds_the_maximum_force() -> None:
    rng = np.random.default_rng(3)
    noise = rng.normal(size=(*GRID.shape, 3)) * (rng.random((*GRID.shape, 1)) < 0.2)
    for field in (smooth(0.01), ForceField.from_dense(GRID, noise)):
        top = np.linalg.norm(field.vectors_n(), axis=1).max()
        for level in pyramid(field, 5):
            for level_field in (level, rebuild_level(level, GRID)):
                assert np.linalg.norm(level_field.vectors_n().astype(float), axis=1).max(initial=0) <= top * (
                    1 + 1e-6
                )


def test_interpolation_agrees_with_queries_and_stays_within_its_cells(wavy_field: ForceField) -> None:
    fine = Grid((30, 41, 33), (0.0007, 0.0011, 0.0009), (-0.012, -0.001, 0.018))
    points = np.stack(np.meshgrid(*(fine.axis_m(a) for a in range(3)), indexing="ij"), axis=-1)
    np.testing.assert_allclose(
        interpolate(wavy_field, fine).to_dense(), wavy_field.sample_n(points), atol=1e-6
    )
    assert interpolate(wavy_field, wavy_field.grid) == wavy_field
    supported = interpolate(wavy_field, fine, border="cell").to_dense().any(axis=-1)
    low, high = wavy_field.grid.box_m
    within = ((points > low - 1e-9) & (points < high + 1e-9)).all(axis=-1)
    assert supported.any() and not (supported & ~within).any()
    translation = RigidMotion.move((1.0, 0.0, 0.0))
    assert interpolate(wavy_field, wavy_field.grid, translation) == ForceField.empty(wavy_field.grid)


def test_force_at_the_edge_of_a_brick_reaches_the_next() -> None:
    grid = Grid((24, 24, 24), (0.001,) * 3, (0.0,) * 3)
    fine = Grid((40, 40, 40), (0.00025,) * 3, (0.00575,) * 3)  # a brick starts just below 8 mm
    points = np.stack(np.meshgrid(*(fine.axis_m(a) for a in range(3)), indexing="ij"), axis=-1)
    motion = RigidMotion.turn((0, 0, 1), 90.0, (0.011,) * 3).followed_by(RigidMotion.move((0.0, 0.0, 0.002)))
    for at in ([8, 8, 8], [15, 15, 13], [8, 15, 8]):
        field = ForceField.from_support(grid, [at], [[1.0, 2.0, -3.0]])
        np.testing.assert_allclose(interpolate(field, fine).to_dense(), field.sample_n(points), atol=1e-5)
        expected = motion.vectors(field.sample_n(motion.inverse.points_m(points)))
        assert expected.any()
        np.testing.assert_allclose(interpolate(field, fine, motion).to_dense(), expected, atol=1e-5)


def test_flat_fields_and_empty_ones() -> None:
    flat = Grid((16, 16, 1), (0.01,) * 3, (0, 0, 0))
    levels = pyramid(constant(flat), 4)
    assert [f.grid.shape for f in levels] == [(16, 16, 1), (8, 8, 1), (4, 4, 1), (2, 2, 1), (1, 1, 1)]
    assert levels[1].to_dense()[3, 4, 0] == pytest.approx([0.1, -0.2, 0.3], abs=1e-6)
    assert all(f == ForceField.empty(f.grid) for f in pyramid(ForceField.empty(GRID), 5))


def test_invalid_arguments_are_refused() -> None:
    for levels in (-1, 6, 1.0, True):
        with pytest.raises(InvalidArgument, match="levels"):
            pyramid(smooth(0.01), levels)  # type: ignore[arg-type]
    with pytest.raises(InvalidArgument, match="border"):
        interpolate(smooth(0.01), GRID, border="wrap")
    with pytest.raises(InvalidArgument, match="bricks reached"):
        interpolate(smooth(0.01), Grid((1 << 14,) * 3, (2e-6,) * 3, (-0.0155,) * 3))
