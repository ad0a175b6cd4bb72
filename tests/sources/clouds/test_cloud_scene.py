"""Surfaces of point clouds: where contact is, on which side the wall lies, outliers, and rims."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from cloud_makers import NOISE, RADIUS_M, SIDE_M, plane, scene_of, sphere
from touchfield.errors import InvalidArgument, SourceError
from touchfield.medium import Grid
from touchfield.sources.clouds.cloud import Cloud
from touchfield.sources.clouds.cloud_scene import CloudScene
from touchfield.sources.clouds.surfels import surface_of
from touchfield.sources.laws import ForceProfile, LawSpec, profile_of

WALL = profile_of(LawSpec(), 0.004)
COUNT = 6000


def heights(scene: CloudScene, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Signed distances of points, and the directions of the force there, one sample at a time."""
    law = ForceProfile(((-0.02, 0.02, 1.0, 10.0),))
    found, directions = np.full(len(points), np.nan), np.zeros((len(points), 3))
    for index, point in enumerate(points):
        grid = Grid((1, 1, 1), (1e-4,) * 3, tuple(point.tolist()))
        forces = scene.field(0, grid, law).vectors_n()
        if len(forces):
            size = float(np.linalg.norm(forces[0]))
            found[index], directions[index] = (size - 1) / 10, forces[0] / size
    return found, directions


def directions(count: int) -> np.ndarray:
    """Unit vectors that no cloud was made of."""
    vectors = np.random.default_rng(99).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


@pytest.mark.parametrize("has_normals", [True, False])
@pytest.mark.parametrize("depth_m", [0.0, 0.004])
def test_contact_with_a_noisy_sphere_is_within_half_the_spacing(has_normals: bool, depth_m: float) -> None:
    """Also the distance of a point deep behind the surface: the wall is as thick as the law says."""
    points, normals, spacing_m = sphere(COUNT)
    scene = scene_of(points, normals if has_normals else None)
    towards = directions(150)
    phi, found = heights(scene, (RADIUS_M - depth_m) * towards)
    assert np.abs(phi + depth_m).max() < 0.5 * spacing_m
    assert (found * towards).sum(axis=1).min() > math.cos(math.radians(15))
    assert scene.surface.is_closed and scene.is_one_sided


@pytest.mark.parametrize("has_normals", [True, False])
def test_contact_with_a_noisy_plane_is_within_half_the_spacing(has_normals: bool) -> None:
    points, normals, spacing_m = plane(COUNT)
    scene = scene_of(points, normals if has_normals else None, "given" if has_normals else "up")
    at = np.random.default_rng(5).uniform(-0.45 * SIDE_M, 0.45 * SIDE_M, (150, 3)) * [1, 1, 0]
    phi, found = heights(scene, at)
    assert np.abs(phi).max() < 0.5 * spacing_m
    assert found[:, 2].min() > math.cos(math.radians(15))
    assert not scene.surface.is_closed


def test_points_alone_without_a_surface_between_miss_that_bar() -> None:
    """The nearest point, a surface of its own, errs by more: the bar tells methods apart."""
    points, _, spacing_m = sphere(COUNT)
    towards = directions(500)
    nearest = np.linalg.norm(points[None] - RADIUS_M * towards[:, None], axis=2).min(axis=1)
    assert nearest.max() > spacing_m


def test_spacing_and_scatter_are_measured() -> None:
    points, _, spacing_m = sphere(COUNT)
    surface = scene_of(points).surface
    assert surface.spacing_m == pytest.approx(spacing_m, rel=0.1)
    assert surface.scatter_m == pytest.approx(NOISE * spacing_m, rel=0.2)
    noisy = scene_of(sphere(COUNT, noise=2.0)[0]).surface
    assert noisy.surfels.edge_m > 1.5 * surface.surfels.edge_m  # cells grow with the scatter


@pytest.mark.parametrize(("side", "outward"), [("outward", 1), ("inward", -1)])
def test_the_side_can_be_requested(side: str, outward: int) -> None:
    scene = scene_of(sphere(2000)[0], side=side)
    _, found = heights(scene, RADIUS_M * directions(20))
    assert ((found * directions(20)).sum(axis=1) * outward > 0.9).all()


def test_estimated_normals_face_the_scanner() -> None:
    """Two scans, from either side of a sheet that has no outside."""
    points = plane(2000)[0]
    for height_m in (0.3, -0.3):
        cloud = Cloud(points.copy(), scanners=((0, 2000, np.array([0.02, 0.0, height_m])),))
        surface = surface_of(cloud, "auto", "cloud")
        assert (np.sign(surface.surfels.normals[:, 2]) == np.sign(height_m)).all()
        assert "face the scanner" in " ".join(surface.notes)


def test_sides_spread_over_a_hollow_surface() -> None:
    """A bowl and its plinth: facing away from the middle would be wrong for the inner side."""
    rng = np.random.default_rng(3)
    angle, height = rng.uniform(0, 2 * np.pi, 8000), rng.uniform(0, 0.1, 8000)
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    outer, inner = (
        0.05 * ring + np.array([0, 0, 1]) * height[:, None],
        0.035 * ring + np.array([0, 0, 1]) * height[:, None],
    )
    across = np.sqrt(rng.uniform(0.035**2, 0.05**2, 2400))[:, None] * ring[:2400]
    points = np.concatenate([outer, inner, across, across + np.array([0, 0, 0.1])])
    scene = scene_of(points, side="outward")
    assert scene.surface.is_closed
    middle = ring[:20] + np.array([0, 0, 0.05])
    for radius_m, sign in ((0.05, 1), (0.035, -1)):
        _, found = heights(scene, middle * [radius_m, radius_m, 1])
        assert ((found * ring[:20]).sum(axis=1) * sign > 0.9).all()


@pytest.mark.parametrize("stripe_m", [0.005, 0.0])
def test_given_normals_that_contradict_each_other_are_turned(stripe_m: float) -> None:
    """Normals of which half are flipped, in stripes or at random."""
    points, normals, _ = sphere(COUNT)
    flips = np.random.default_rng(7).choice([-1.0, 1.0], (COUNT, 1))
    if stripe_m:
        flips = np.where(points[:, :1] / stripe_m % 2 < 1, 1.0, -1.0)
    scene = scene_of(points, normals * flips)
    assert "of neighbours face apart: turned to face outward" in " ".join(scene.notes)
    _, found = heights(scene, RADIUS_M * directions(20))
    assert ((found * directions(20)).sum(axis=1) > 0.9).all()


def test_outliers_are_left_out_and_counted() -> None:
    points, _, spacing_m = sphere(COUNT)
    stray = 0.09 * directions(40) + np.random.default_rng(1).normal(size=(40, 3)) * 1e-3
    scene = scene_of(np.concatenate([points, stray, np.full((30, 3), 5.0)]))
    assert "70 points are left out as outliers" in " ".join(scene.notes)
    assert np.abs(scene.bounds_m()).max() < RADIUS_M + 2 * spacing_m
    grid = Grid.over_box((-0.1,) * 3, (0.1,) * 3, (48,) * 3)
    reached = np.linalg.norm(grid.to_m(scene.field(0, grid, WALL).positions()), axis=1)
    assert reached.max() < RADIUS_M + 3 * spacing_m


def test_a_few_points_are_all_kept() -> None:
    scene = scene_of(sphere(20, noise=0.0)[0])
    assert "outliers" not in " ".join(scene.notes)


def test_the_wall_ends_with_the_points() -> None:
    points, _, spacing_m = plane(COUNT)
    scene = scene_of(points, side="up")
    grid = Grid.over_box((-0.08, -0.08, -0.01), (0.08, 0.08, 0.01), (64, 64, 20))
    positions = grid.to_m(scene.field(0, grid, WALL).positions())
    assert SIDE_M / 2 < np.abs(positions[:, :2]).max() < SIDE_M / 2 + 5 * spacing_m
    assert positions[:, 2].max() < spacing_m and positions[:, 2].min() == pytest.approx(-0.004, abs=1.5e-3)


def test_a_two_sided_shell_pushes_away_on_both_sides() -> None:
    points, normals, _ = plane(COUNT)
    surface = scene_of(points, normals).surface
    scene = CloudScene(surface, "two")
    grid = Grid((1, 1, 41), (1e-3, 1e-3, 2e-4), (0.0, 0.0, -0.004))
    field = scene.field(0, grid, WALL)
    heights_m, forces = grid.to_m(field.positions())[:, 2], field.vectors_n()[:, 2]
    assert (np.sign(forces) == np.sign(heights_m))[np.abs(heights_m) > 5e-4].all()
    assert np.abs(heights_m).max() == pytest.approx(0.002, abs=5e-4)


def test_two_sides_are_taken_where_no_side_is_known() -> None:
    """Points that fill a volume: normals of neighbours face anywhere."""
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (6000, 3))
    scene = scene_of(points)
    assert not scene.is_one_sided and "two-sided shell" in scene.notes[-1]
    assert "the points fill a volume" in " ".join(scene.notes)


def test_a_thin_plate_keeps_its_two_sides() -> None:
    points, normals, spacing_m = plane(COUNT, noise=0.0)
    thickness_m = 0.5 * spacing_m
    both = (
        np.concatenate([points, points - np.array([0, 0, thickness_m])]),
        np.concatenate([normals, -normals]),
    )
    scene = scene_of(*both)
    assert "face apart" not in " ".join(scene.notes)
    phi, found = heights(scene, np.array([[0.0, 0, 0.001], [0.0, 0, -0.001 - thickness_m]]))
    np.testing.assert_allclose(phi, 0.001, atol=1e-5)
    np.testing.assert_allclose(found[:, 2], [1, -1], atol=1e-3)


def test_a_solid_needs_a_closed_surface() -> None:
    solid = profile_of(LawSpec(), math.inf)
    grid = Grid.over_box((-0.06,) * 3, (0.06,) * 3, (24,) * 3)
    field = scene_of(sphere(COUNT)[0]).field(0, grid, solid)
    distances = np.linalg.norm(grid.to_m(field.positions()), axis=1)
    assert distances.min() < 0.01 and len(distances) == pytest.approx(24**3 * 0.303, rel=0.05)
    with pytest.raises(InvalidArgument, match=r"a solid law for an open surface.*thickness-m"):
        scene_of(plane(COUNT)[0]).field(0, grid, solid)


def test_a_motion_moves_the_field() -> None:
    points, normals, _ = plane(2000)
    rotation = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    moved = scene_of(points, normals).moved(rotation, np.array([0.0, 0.0, 0.5]))
    other = scene_of(points @ rotation.T + np.array([0, 0, 0.5]), normals @ rotation.T)
    np.testing.assert_allclose(moved.bounds_m(), other.bounds_m(), atol=2e-3)
    at = np.array([[0.01, 0.0005, 0.51], [-0.02, -0.001, 0.48]])
    (phi, found), (other_phi, other_found) = heights(moved, at), heights(other, at)
    np.testing.assert_allclose(phi, other_phi, atol=5e-4)
    np.testing.assert_allclose(found, other_found, atol=0.05)


def test_fields_of_fine_and_coarse_lattices_agree() -> None:
    """Cells of many points are merged for a coarse lattice; contact stays."""
    points, _, spacing_m = sphere(60_000)
    scene = scene_of(points)
    law = ForceProfile(((-0.004, 0.004, 5.0, 1000.0),))
    for samples in (16, 96):
        grid = Grid.over_box((-0.06,) * 3, (0.06,) * 3, (samples,) * 3)
        field = scene.field(0, grid, law)
        phi = (np.linalg.norm(field.vectors_n(), axis=1) - 5) / 1000
        radii = np.linalg.norm(grid.to_m(field.positions()), axis=1) - RADIUS_M
        assert np.abs(phi - radii).max() < 0.5 * spacing_m


def test_points_without_extent_are_refused() -> None:
    with pytest.raises(SourceError, match="most lie at one position"):
        scene_of(np.zeros((50, 3)))


@pytest.mark.parametrize(
    "shape",
    [
        lambda t: np.stack([t, 0 * t, 0 * t], axis=1),
        lambda t: np.stack([t, 2 * t, -t], axis=1) * 1e6,
        lambda t: np.stack([np.cos(50 * t), np.sin(50 * t), t], axis=1) * 1e-6,
    ],
)
def test_lines_of_points_end_in_a_finite_field(shape: Callable[[np.ndarray], np.ndarray]) -> None:
    scene = scene_of(shape(np.linspace(0, 1, 500)))
    low, high = scene.bounds_m()
    margin = 0.1 * float((high - low).max())
    grid = Grid.over_box(low - margin, high + margin, (16, 16, 16))
    law = ForceProfile(((-margin, 0.0, 0.0, -1.0),))
    assert np.isfinite(scene.field(0, grid, law).forces_n).all()


def test_sparse_points_are_noted_for_the_lattice() -> None:
    scene = scene_of(sphere(200)[0])
    scene.set_lattice(Grid.over_box((-0.06,) * 3, (0.06,) * 3, (64,) * 3), 3.3)
    assert "samples of the lattice apart" in scene.late_notes()[0]
    scene.set_lattice(Grid.over_box((-0.06,) * 3, (0.06,) * 3, (4,) * 3), 3.3)
    assert scene.late_notes() == ()
