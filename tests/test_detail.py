"""Level of detail: the pyramid, and its way back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from touchfield.errors import InvalidArgument
from touchfield.filters import RigidMotion, halved, interpolated, most_levels, pyramid, rebuilt
from touchfield.medium import ForceField, Grid

GRID = Grid((32, 32, 32), (0.001,) * 3, (-0.0155,) * 3)


def constant(grid: Grid, force_n: tuple[float, float, float] = (0.1, -0.2, 0.3)) -> ForceField:
    return ForceField.from_dense(grid, np.broadcast_to(np.float32(force_n), (*grid.shape, 3)))


def smooth(wave_m: float, grid: Grid = GRID) -> ForceField:
    """A wave of force under a bump that is clear of the border."""
    x, y, z = np.meshgrid(*(grid.axis_m(a) for a in range(3)), indexing="ij")
    bump = np.exp(-(x**2 + y**2 + z**2) / (2 * 0.005**2))
    amplitude = bump * (1 + 0.5 * np.sin(2 * np.pi * x / wave_m))
    forces = amplitude[..., None] * np.array([0.6, 0.0, 0.8])
    return ForceField.from_dense(grid, np.where(amplitude[..., None] > 0.02, forces, 0))


shapes = st.tuples(*[st.integers(1, 40)] * 3)


@given(shapes)
def test_a_level_has_half_the_samples_and_twice_the_cell(shape: tuple[int, int, int]) -> None:
    grid = Grid(shape, (0.001, 0.002, 0.003), (0.1, 0.2, 0.3))
    coarse = halved(grid)
    for axis in range(3):
        assert coarse.shape[axis] == (shape[axis] + 1) // 2
        fine_low, fine_high = (edge[axis] for edge in grid.box_m)
        low, high = (edge[axis] for edge in coarse.box_m)
        assert low == pytest.approx(fine_low, abs=1e-12)
        beyond = grid.spacing_m[axis] if shape[axis] % 2 and shape[axis] > 1 else 0.0
        assert high == pytest.approx(fine_high + beyond, abs=1e-12)
    for _ in range(most_levels(grid)):
        assert grid.shape != (1, 1, 1)
        grid = halved(grid)
    assert grid.shape == (1, 1, 1)


def test_the_levels_of_a_box_are_the_means_of_cells() -> None:
    rng = np.random.default_rng(0)
    field = ForceField.from_dense(GRID, rng.normal(size=(*GRID.shape, 3)))
    for level, made in enumerate(pyramid(field, 5, "box")):
        n = 32 >> level
        cells = field.to_dense().astype(float).reshape(n, 1 << level, n, 1 << level, n, 1 << level, 3)
        np.testing.assert_allclose(made.to_dense(), cells.mean(axis=(1, 3, 5)), atol=1e-5)


def test_a_constant_stays_itself_away_from_the_border() -> None:
    wide = Grid((64, 64, 64), (0.001,) * 3, (0.0,) * 3)
    field = constant(wide)
    levels = pyramid(field, 3)
    for level, made in enumerate(levels):
        margin = (0, 2, 3, 3)[level]
        inner = made.to_dense()[margin : (64 >> level) - margin or None, 4, 4]
        assert len(inner) and inner == pytest.approx(np.broadcast_to([0.1, -0.2, 0.3], inner.shape), abs=1e-6)
    back = rebuilt(pyramid(field, 2, "box")[2], wide)
    assert np.abs(back.to_dense() - field.to_dense()).max() < 1e-6  # at the border, too


def test_what_is_smooth_comes_back_and_what_is_fine_does_not() -> None:
    def lost(wave_m: float) -> float:
        field = smooth(wave_m)
        error = rebuilt(pyramid(field, 1)[1], GRID).to_dense() - field.to_dense()
        return float((error**2).sum() / (field.to_dense() ** 2).sum())

    assert lost(0.03) < 0.005 < 0.02 < lost(0.002)


def test_the_pyramid_is_linear_and_never_stronger() -> None:
    a, b = smooth(0.01), constant(GRID)
    for x, y, both in zip(pyramid(a, 3), pyramid(b, 3), pyramid(a.scaled(2.0) + b, 3), strict=True):
        np.testing.assert_allclose(both.to_dense(), 2 * x.to_dense() + y.to_dense(), atol=1e-5)
    top = np.linalg.norm(a.vectors_n(), axis=1).max()
    for level in pyramid(a, 5):
        for field in (level, rebuilt(level, GRID)):
            assert np.linalg.norm(field.vectors_n().astype(float), axis=1).max(initial=0) <= top * (1 + 1e-6)


def test_interpolation_is_the_query_and_stays_within_its_cells(wavy_field: ForceField) -> None:
    fine = Grid((30, 41, 33), (0.0007, 0.0011, 0.0009), (-0.012, -0.001, 0.018))
    points = np.stack(np.meshgrid(*(fine.axis_m(a) for a in range(3)), indexing="ij"), axis=-1)
    np.testing.assert_allclose(interpolated(wavy_field, fine).to_dense(), wavy_field.sample_n(points), atol=1e-6)
    assert interpolated(wavy_field, wavy_field.grid) == wavy_field
    held = interpolated(wavy_field, fine, border="cell").to_dense().any(axis=-1)
    low, high = wavy_field.grid.box_m
    within = ((points > low - 1e-9) & (points < high + 1e-9)).all(axis=-1)
    assert held.any() and not (held & ~within).any()
    far = RigidMotion.move((1.0, 0.0, 0.0))
    assert interpolated(wavy_field, wavy_field.grid, far) == ForceField.empty(wavy_field.grid)


def test_a_force_at_the_edge_of_a_brick_reaches_the_next() -> None:
    grid = Grid((24, 24, 24), (0.001,) * 3, (0.0,) * 3)
    fine = Grid((40, 40, 40), (0.00025,) * 3, (0.00575,) * 3)  # a brick begins just below 8 mm
    points = np.stack(np.meshgrid(*(fine.axis_m(a) for a in range(3)), indexing="ij"), axis=-1)
    motion = RigidMotion.turn((0, 0, 1), 90.0, (0.011,) * 3).then(RigidMotion.move((0.0, 0.0, 0.002)))
    for at in ([8, 8, 8], [15, 15, 13], [8, 15, 8]):
        field = ForceField.from_support(grid, [at], [[1.0, 2.0, -3.0]])
        np.testing.assert_allclose(interpolated(field, fine).to_dense(), field.sample_n(points), atol=1e-5)
        expected = motion.vectors(field.sample_n(motion.inverse.points_m(points)))
        assert expected.any()
        np.testing.assert_allclose(interpolated(field, fine, motion).to_dense(), expected, atol=1e-5)


def test_flat_fields_and_empty_ones() -> None:
    flat = Grid((16, 16, 1), (0.01,) * 3, (0, 0, 0))
    levels = pyramid(constant(flat), 4)
    assert [f.grid.shape for f in levels] == [(16, 16, 1), (8, 8, 1), (4, 4, 1), (2, 2, 1), (1, 1, 1)]
    assert levels[1].to_dense()[3, 4, 0] == pytest.approx([0.1, -0.2, 0.3], abs=1e-6)
    assert all(f == ForceField.empty(f.grid) for f in pyramid(ForceField.empty(GRID), 5))


def test_what_is_asked_in_vain() -> None:
    for levels in (-1, 6, 1.0, True):
        with pytest.raises(InvalidArgument, match="levels"):
            pyramid(smooth(0.01), levels)  # type: ignore[arg-type]
    with pytest.raises(InvalidArgument, match="low_pass"):
        pyramid(smooth(0.01), 1, "cubic")
    with pytest.raises(InvalidArgument, match="border"):
        interpolated(smooth(0.01), GRID, border="wrap")
    with pytest.raises(InvalidArgument, match="bricks reached"):
        interpolated(smooth(0.01), Grid((1 << 14,) * 3, (2e-6,) * 3, (-0.0155,) * 3))
