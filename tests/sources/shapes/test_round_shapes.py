"""Capsule, cylinder, ellipsoid and moved shapes: true distances, tight boxes, motions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from touchfield.errors import InvalidArgument
from touchfield.sources.shapes.analytic_scene import read_analytic
from touchfield.sources.shapes.shapes import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    Plane,
    Shape,
    Sphere,
    Superquadric,
    move_shape,
    rotation_matrix,
)

TURN = (20.0, -35.0, 70.0)
SHAPES: dict[str, Shape] = {
    "capsule": Capsule((0.01, 0.0, -0.02), 0.02, 0.03, TURN),
    "cylinder": Cylinder((0.01, 0.0, -0.02), 0.03, 0.02, TURN),
    "egg": Ellipsoid((0.01, 0.0, -0.02), (0.02, 0.03, 0.04), TURN),
    "lens": Ellipsoid((0.0, 0.0, 0.0), (0.04, 0.04, 0.002), TURN),
    "needle": Ellipsoid((0.0, 0.0, 0.0), (0.001, 0.05, 0.001)),
    "moved": move_shape(
        Cylinder((0.01, 0.0, 0.0), 0.02, 0.03, TURN), rotation_matrix((10, 20, 30)), (0.0, 0.01, 0.0)
    ),
}
each_shape = pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
sizes = st.tuples(*[st.floats(-3, 0).map(lambda e: 10**e)] * 3)
point_lists = st.lists(st.tuples(*[st.floats(-2, 2) | st.just(0.0)] * 3), min_size=1, max_size=30).map(
    np.array
)
angles = st.tuples(*[st.floats(-180, 180)] * 3)
shifts = st.tuples(*[st.floats(-0.1, 0.1)] * 3)


def surface_of(shape: Shape) -> np.ndarray:
    """Points on the surface, where rays from the centre of the box cross it, by bisection."""
    rng = np.random.default_rng(3)
    ray = rng.normal(size=(4000, 3))
    box = shape.box_m()
    ray *= np.ptp(box, axis=0) / np.linalg.norm(ray, axis=1)[:, None]
    middle = box.mean(axis=0)
    inner, outer = np.zeros(len(ray)), np.full(len(ray), 2.0)
    for _ in range(50):
        half = (inner + outer) / 2
        inside = shape.signed_distance_and_normal(middle + half[:, None] * ray)[0] < 0
        inner, outer = np.where(inside, half, inner), np.where(inside, outer, half)
    return middle + inner[:, None] * ray


@each_shape
def test_distance_is_that_to_the_nearest_point_of_the_surface(shape: Shape) -> None:
    rng = np.random.default_rng(1)
    at = rng.uniform(-0.08, 0.08, (150, 3))
    phi, normal = shape.signed_distance_and_normal(at)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=1e-12)
    foot = at - phi[:, None] * normal
    np.testing.assert_allclose(shape.signed_distance_and_normal(foot)[0], 0.0, atol=1e-12)
    surface = surface_of(shape)
    brute = np.array([np.linalg.norm(surface - point, axis=1).min() for point in at])
    assert (np.abs(phi) <= brute + 1e-12).all()  # no surface point is nearer
    assert (phi < 0).sum() < len(phi)


@each_shape
def test_normal_is_the_gradient(shape: Shape) -> None:
    at = np.random.default_rng(2).uniform(-0.08, 0.08, (400, 3))
    step = 1e-7
    slope = [
        (shape.signed_distance_and_normal(at + e)[0] - shape.signed_distance_and_normal(at - e)[0])
        / (2 * step)
        for e in step * np.eye(3)
    ]
    error = np.linalg.norm(np.stack(slope, axis=-1) - shape.signed_distance_and_normal(at)[1], axis=1)
    assert np.quantile(error, 0.98) < 1e-4  # the rest has two nearest surface points


@each_shape
def test_box_contains_the_surface_and_range_its_distances(shape: Shape) -> None:
    box, surface = shape.box_m(), surface_of(shape)
    assert (surface >= box[0] - 1e-12).all() and (surface <= box[1] + 1e-12).all()
    np.testing.assert_allclose([surface.min(axis=0), surface.max(axis=0)], box, atol=0.05 * np.ptp(box))
    rng = np.random.default_rng(4)
    centres = rng.uniform(-0.08, 0.08, (200, 3))
    low, high = shape.distance_range(centres, 0.01)
    offset = rng.normal(size=(200, 3))
    offset *= 0.01 / np.linalg.norm(offset, axis=1)[:, None]
    phi = shape.signed_distance_and_normal(centres + offset)[0]
    assert (low <= phi + 1e-12).all() and (phi <= high + 1e-12).all()


@given(sizes, point_lists)
@example((1.0, 0.1, 1.0), np.array([[0.0, 2.2e-313, 0.5], [0.0, 1e-290, 0.5], [0.0, -1e-120, 0.2]]))
def test_ellipsoid_of_any_proportions_anywhere(half: tuple[float, float, float], at: np.ndarray) -> None:
    at = at * np.asarray(half)
    phi, normal = Ellipsoid((0.0, 0.0, 0.0), half).signed_distance_and_normal(at)
    foot = (at - phi[:, None] * normal) / half
    np.testing.assert_allclose((foot**2).sum(axis=1), 1.0, rtol=1e-9)
    inside = ((at / np.asarray(half)) ** 2).sum(axis=1) < 1
    assert (phi[inside] <= 0).all() and (phi[~inside] >= 0).all()
    ring = np.random.default_rng(5).normal(size=(200, 3))
    ring *= np.asarray(half) / np.linalg.norm(ring, axis=1)[:, None]
    brute = np.linalg.norm(at[:, None] - ring, axis=2).min(axis=1)
    assert (np.abs(phi) <= brute * (1 + 1e-9) + 1e-12).all()


@given(point_lists, st.floats(0.01, 1.0))
def test_an_ellipsoid_of_equal_axes_is_a_ball(at: np.ndarray, radius: float) -> None:
    ball, ellipsoid = Sphere((0.1, 0.0, 0.0), radius), Ellipsoid((0.1, 0.0, 0.0), (radius,) * 3)
    (phi, normal), (same, as_well) = (s.signed_distance_and_normal(at) for s in (ball, ellipsoid))
    np.testing.assert_allclose(same, phi, rtol=1e-12, atol=1e-12)
    off = phi > 1e-6 - radius  # any normal is right at the centre
    np.testing.assert_allclose(as_well[off], normal[off], atol=1e-9)


@given(point_lists)
def test_ellipsoid_bounds_the_first_order_distance(at: np.ndarray) -> None:
    half = (0.3, 0.9, 0.5)
    exact = Ellipsoid((0.0, 0.0, 0.0), half, TURN).signed_distance_and_normal(at)[0]
    first_order = Superquadric((0.0, 0.0, 0.0), half, (1.0, 1.0), TURN).signed_distance_and_normal(at)[0]
    assert (first_order <= exact + 1e-9).all()


def test_the_focal_disc_of_a_flat_ellipsoid() -> None:
    phi, normal = Ellipsoid((0.0, 0.0, 0.0), (1.0, 1.0, 0.1)).signed_distance_and_normal(
        np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.999, 0.0, 0.0]])
    )
    assert phi[0] == pytest.approx(-0.1) and abs(normal[0, 2]) == pytest.approx(1.0)
    # the foot of (x, 0, 0) lies at x / (1 - 0.01) while that is on the surface, and at the rim beyond
    foot = np.array([0.5 / 0.99, 0.1 * np.sqrt(1 - (0.5 / 0.99) ** 2)])
    assert phi[1] == pytest.approx(-np.hypot(foot[0] - 0.5, foot[1]))
    assert phi[2] == pytest.approx(-0.001) and normal[2, 0] == pytest.approx(1.0)


@pytest.mark.parametrize("kind", [Capsule, Cylinder])
def test_the_normal_on_the_axis_of_a_rod_has_unit_length(kind: type[Shape]) -> None:
    shape = kind((0.0, 0.0, 0.0), 0.02, 0.05)  # type: ignore[call-arg]
    phi, normal = shape.signed_distance_and_normal(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.01]]))
    np.testing.assert_allclose(phi, -0.02)
    np.testing.assert_allclose(normal, [[1, 0, 0]] * 2)


@given(angles, shifts, angles, shifts)
def test_motions_compose(first: tuple, shift: tuple, second: tuple, other: tuple) -> None:
    at = np.random.default_rng(6).uniform(-0.1, 0.1, (50, 3))
    turn, second_turn = rotation_matrix(first), rotation_matrix(second)
    for shape in (
        Box((0.0, 0.01, 0.0), (0.02, 0.03, 0.01)),
        Sphere((0.0, 0.0, 0.02), 0.03),
        Plane((0, 0, 0), (1, 2, 3)),
    ):
        phi, normal = shape.signed_distance_and_normal(at)
        once = move_shape(shape, turn, shift)
        moved_points = at @ turn.T + shift
        np.testing.assert_allclose(once.signed_distance_and_normal(moved_points)[0], phi, atol=1e-12)
        np.testing.assert_allclose(
            once.signed_distance_and_normal(moved_points)[1], normal @ turn.T, atol=1e-9
        )
        twice = move_shape(once, second_turn, other)
        np.testing.assert_allclose(
            twice.signed_distance_and_normal(moved_points @ second_turn.T + other)[0], phi, atol=1e-12
        )
        assert type(twice) is type(shape)


@pytest.mark.parametrize("rotation", [np.eye(3) * 2, -np.eye(3), np.eye(2), np.full((3, 3), np.nan)])
def test_invalid_rotations_are_refused(rotation: np.ndarray) -> None:
    for shape in SHAPES.values():
        with pytest.raises(InvalidArgument, match="rotation"):
            move_shape(shape, rotation, (0, 0, 0))


@pytest.mark.parametrize(
    "text",
    [
        'kind = "capsule"\ncenter_m = [0, 0, 0]\nradius_m = 0.01\nhalf_length_m = 0.02',
        'kind = "cylinder"\ncenter_m = [0, 0, 0]\nradius_m = 0.01\nhalf_length_m = 0.02\nrotation_deg = [0, '
        "90, 0]",
        'kind = "ellipsoid"\ncenter_m = [0, 0, 0]\nhalf_extents_m = [0.01, 0.02, 0.03]',
    ],
)
def test_a_file_may_contain_round_shapes(tmp_path: Path, text: str) -> None:
    (tmp_path / "scene.toml").write_text(f"[[shape]]\n{text}\n")
    (shape,) = read_analytic(tmp_path / "scene.toml").shapes
    assert text.split('"')[1] == type(shape).__name__.lower()
    assert shape.signed_distance_and_normal(np.zeros((1, 3)))[0] == pytest.approx(-0.01)


@pytest.mark.parametrize("size", [0.0, -1.0, np.inf, np.nan])
def test_sizes_are_positive(size: float) -> None:
    for make in (
        lambda: Capsule((0, 0, 0), size, 1.0),
        lambda: Cylinder((0, 0, 0), 1.0, size),
        lambda: Ellipsoid((0, 0, 0), (1.0, size, 1.0)),
    ):
        with pytest.raises(InvalidArgument):
            make()
