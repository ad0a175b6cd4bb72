"""Analytic scenes: closed forms, true distances, TOML files and their faults."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from touchfield.errors import InvalidArgument, SourceError
from touchfield.medium import ForceField, Grid
from touchfield.sources.laws import ForceProfile, LawSpec, profile_of
from touchfield.sources.options import SourceOptions
from touchfield.sources.shapes.analytic_scene import KIND, AnalyticScene
from touchfield.sources.shapes.shapes import Box, Plane, Shape, Sphere, Superquadric

SOLID = profile_of(LawSpec(), np.inf)
WALL = profile_of(LawSpec("penalty+proximity"), 0.008)

SHAPES: dict[str, Shape] = {
    "plane": Plane((0.01, -0.02, 0.03), (1.0, 2.0, -0.5)),
    "sphere": Sphere((0.01, 0.0, -0.02), 0.04),
    "box": Box((0.0, 0.01, 0.0), (0.03, 0.02, 0.04), (20.0, -35.0, 70.0)),
    "round": Superquadric((0.0, 0.01, 0.0), (0.03, 0.02, 0.04), (1.0, 1.0), (20.0, -35.0, 70.0)),
    "boxy": Superquadric((0.0, 0.01, 0.0), (0.03, 0.02, 0.04), (0.3, 0.6), (0.0, 10.0, 0.0)),
    "pointed": Superquadric((0.0, 0.0, 0.0), (0.03, 0.05, 0.04), (2.0, 1.7)),
    "spindle": Superquadric((0.0, 0.0, 0.0), (0.03, 0.03, 0.05), (1.8, 0.4)),
}
each_shape = pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
points = st.lists(st.tuples(*[st.floats(-0.1, 0.1)] * 3), min_size=1, max_size=40).map(np.array)


def phi_of(shape: Shape, at: np.ndarray) -> np.ndarray:
    return shape.signed_distance_and_normal(np.asarray(at, float))[0]


@each_shape
def test_normal_is_the_unit_gradient_near_the_surface(shape: Shape) -> None:
    rng = np.random.default_rng(1)
    at = rng.uniform(-0.02, 0.02, (4000, 3))  # mostly inside, so that the walk ends on faces, not on edges
    phi, normal = shape.signed_distance_and_normal(at)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=1e-12)
    for _ in range(30):  # walk to the surface along the normal
        phi, normal = shape.signed_distance_and_normal(at)
        at = at - phi[:, None] * normal
    phi, normal = shape.signed_distance_and_normal(at)
    on = np.abs(phi) < 1e-12
    assert on.mean() > 0.9
    step = 1e-7
    slope = np.stack(
        [(phi_of(shape, at + e) - phi_of(shape, at - e)) / (2 * step) for e in step * np.eye(3)], axis=-1
    )
    error = np.linalg.norm(slope - normal, axis=1)[on]
    assert np.quantile(error, 0.9) < 1e-4  # the rest is at creases


@pytest.mark.parametrize("name", ["plane", "sphere", "box"])
@given(a=points, b=points)
def test_exact_distances_are_1_lipschitz(name: str, a: np.ndarray, b: np.ndarray) -> None:
    n = min(len(a), len(b))
    change = np.abs(phi_of(SHAPES[name], a[:n]) - phi_of(SHAPES[name], b[:n]))
    assert (change <= np.linalg.norm(a[:n] - b[:n], axis=1) * (1 + 1e-9) + 1e-15).all()


@given(st.floats(-180, 180), st.floats(-180, 180), st.floats(-180, 180), points)
def test_a_rotated_box_equals_the_box_in_its_frame(x: float, y: float, z: float, at: np.ndarray) -> None:
    half, rotated = (0.03, 0.02, 0.04), Box((0.0, 0.0, 0.0), (0.03, 0.02, 0.04), (x, y, z))
    rotation = pytest.importorskip("scipy.spatial.transform").Rotation.from_euler(
        "xyz", [x, y, z], degrees=True
    )
    in_box_frame = rotation.inv().apply(at)
    np.testing.assert_allclose(
        phi_of(rotated, at), phi_of(Box((0.0, 0.0, 0.0), half), in_box_frame), atol=1e-12
    )


def test_box_distance_is_that_to_the_nearest_of_many_surface_points() -> None:
    rng = np.random.default_rng(3)
    half = np.array([0.03, 0.02, 0.04])
    dense = rng.uniform(-1, 1, (200_000, 3))
    dense[np.arange(len(dense)), rng.integers(0, 3, len(dense))] = rng.choice([-1.0, 1.0], len(dense))
    tree = pytest.importorskip("scipy.spatial").cKDTree(dense * half)
    at = rng.uniform(-0.07, 0.07, (500, 3))
    np.testing.assert_allclose(np.abs(phi_of(Box((0, 0, 0), tuple(half)), at)), tree.query(at)[0], atol=1e-3)


@pytest.mark.parametrize("name", ["round", "boxy", "pointed", "spindle"])
def test_superquadric_distance_keeps_its_documented_bounds(name: str) -> None:
    shape = SHAPES[name]
    rng = np.random.default_rng(4)
    on = rng.uniform(-0.09, 0.09, (12_000, 3))
    for _ in range(30):
        phi, normal = shape.signed_distance_and_normal(on)
        on = on - phi[:, None] * normal
    on = on[np.abs(phi_of(shape, on)) < 1e-9]
    at = rng.uniform(-0.08, 0.08, (400, 3))
    nearest_m = pytest.importorskip("scipy.spatial").cKDTree(on).query(at)[0]
    phi = phi_of(shape, at)
    assert (phi[phi > 0] <= nearest_m[phi > 0] + 1e-9).all()
    assert (-phi[phi < 0] >= nearest_m[phi < 0] - 3e-3).all()  # up to the density of the surface points


def test_a_round_superquadric_is_the_sphere() -> None:
    at = np.random.default_rng(5).uniform(-0.1, 0.1, (1000, 3))
    sphere, round_ = Sphere((0.01, 0.02, 0.0), 0.05), Superquadric((0.01, 0.02, 0.0), (0.05,) * 3, (1.0, 1.0))
    for a, b in zip(
        sphere.signed_distance_and_normal(at), round_.signed_distance_and_normal(at), strict=True
    ):
        np.testing.assert_allclose(a, b, atol=1e-14)


@each_shape
@settings(max_examples=25)
@given(st.tuples(*[st.floats(-0.1, 0.1)] * 3), st.floats(1e-4, 0.05), st.integers(0, 2**31))
def test_the_range_of_distances_in_a_ball_holds(
    shape: Shape, centre: tuple[float, float, float], radius: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    way = rng.normal(size=(200, 3))
    way *= (radius * rng.random(200) / np.linalg.norm(way, axis=1))[:, None]
    low, high = shape.distance_range(np.array([centre]), radius)
    phi = phi_of(shape, centre + way)
    assert phi.min() >= low[0] - 1e-12
    assert phi.max() <= high[0] + 1e-12


@each_shape
@pytest.mark.parametrize("profile", [SOLID, WALL], ids=["solid", "wall"])
def test_field_is_f_of_phi_along_n_at_every_sample(shape: Shape, profile: ForceProfile) -> None:
    grid = Grid.over_box([-0.07, -0.06, -0.08], [0.07, 0.08, 0.06], (45, 39, 50))
    field = AnalyticScene([shape]).field(0, grid, profile)
    at = grid.to_m(np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), axis=-1)).reshape(-1, 3)
    phi, normal = shape.signed_distance_and_normal(at)
    expected = (profile(phi)[:, None] * normal).reshape(*grid.shape, 3)
    assert field.support_count > 500
    np.testing.assert_allclose(field.to_dense(), expected, rtol=1e-6, atol=1e-12)
    assert ForceField.from_dense(grid, expected) == field  # exactly the right bricks


def test_sphere_against_the_closed_form_by_hand() -> None:
    grid = Grid.over_box([-0.05] * 3, [0.05] * 3, (40, 40, 40))
    dense = AnalyticScene([Sphere((0.0, 0.0, 0.0), 0.03)]).field(0, grid, SOLID).to_dense()
    at = grid.to_m(np.stack(np.meshgrid(*[np.arange(40)] * 3, indexing="ij"), axis=-1))
    length = np.linalg.norm(at, axis=-1)
    amount = np.where(length <= 0.03, np.minimum(500.0 * (0.03 - length), 3.3), 0.0)
    np.testing.assert_allclose(dense, amount[..., None] * at / length[..., None], rtol=1e-5, atol=1e-9)


def test_sum_adds_forces_and_union_takes_the_nearest_surface() -> None:
    left, right = Sphere((-0.01, 0.0, 0.0), 0.02), Sphere((0.01, 0.0, 0.0), 0.02)
    grid = Grid.over_box([-0.05] * 3, [0.05] * 3, (32, 32, 32))
    a, b = (AnalyticScene([s]).field(0, grid, SOLID).to_dense() for s in (left, right))
    added = AnalyticScene([left, right]).field(0, grid, SOLID).to_dense()
    np.testing.assert_allclose(added, a + b, atol=1e-6)
    joined = AnalyticScene([left, right], "union").field(0, grid, SOLID).to_dense()
    deepest = np.where((np.arange(32) < 16)[:, None, None, None], a, b)
    np.testing.assert_allclose(joined, deepest, atol=1e-6)


def test_a_thin_wall_is_found_in_a_fine_grid_without_a_full_scan() -> None:
    grid = Grid.over_box([-2.0] * 3, [2.0] * 3, (800, 800, 800))  # 512 million samples
    scene = AnalyticScene([Sphere((1.0, 1.0, 1.0), 0.1)])
    field = scene.field(0, grid, profile_of(LawSpec(), 0.01))
    assert 0 < len(field.bricks) < 1000
    expected = 4 / 3 * np.pi * (0.1**3 - 0.09**3) / 0.005**3
    assert field.support_count == pytest.approx(expected, rel=0.05)


def test_bounds() -> None:
    sphere, plane = Sphere((0.0, 0.0, 1.0), 0.5), Plane((0.0, 0.0, -2.0), (0.0, 0.0, 3.0))
    np.testing.assert_allclose(AnalyticScene([sphere]).bounds_m(), [[-0.5, -0.5, 0.5], [0.5, 0.5, 1.5]])
    rotated = AnalyticScene([sphere]).moved(
        np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([2.0, 0, 0])
    )
    np.testing.assert_allclose(rotated.bounds_m(), [[1.5, -0.5, 0.5], [2.5, 0.5, 1.5]], atol=1e-12)
    alone = AnalyticScene([plane]).bounds_m()
    np.testing.assert_allclose(alone, [[-0.5, -0.5, -2.0], [0.5, 0.5, -2.0]], atol=1e-12)
    np.testing.assert_allclose(
        AnalyticScene([plane, sphere]).bounds_m(), [[-0.5, -0.5, -2.0], [0.5, 0.5, 1.5]]
    )
    small = AnalyticScene([plane, Sphere((0.0, 0.0, 1.0), 0.25)])  # of the plane only its point
    np.testing.assert_allclose(small.bounds_m(), [[-0.25, -0.25, -2.0], [0.25, 0.25, 1.25]])
    assert AnalyticScene([sphere]).is_solid


@pytest.mark.parametrize(
    "make",
    [
        lambda: Sphere((0.0, 0.0, 0.0), -1.0),
        lambda: Sphere((0.0, 0.0, np.nan), 1.0),
        lambda: Sphere((0.0, 0.0), 1.0),  # type: ignore[arg-type]
        lambda: Plane((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        lambda: Box((0.0, 0.0, 0.0), (1.0, 0.0, 1.0)),
        lambda: Superquadric((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.05, 1.0)),
        lambda: AnalyticScene([]),
        lambda: AnalyticScene([SHAPES["box"]], "product"),
        lambda: AnalyticScene([SHAPES["box"]], rate_hz=0.0),
    ],
)
def test_impossible_shapes_are_refused(make: object) -> None:
    with pytest.raises(InvalidArgument):
        make()  # type: ignore[operator]


TOML = """
axes = "x east, y north, z up"
rate_hz = 50
combine = "union"
[[shape]]
kind = "plane"
point_m = [0, 0, 0]
normal = [0.0, 0.0, 1.0]
[[shape]]
kind = "box"
center_m = [0.0, 0.0, 0.1]
half_extents_m = [0.1, 0.2, 0.1]
rotation_deg = [0, 0, 45]
[[shape]]
kind = "superquadric"
center_m = [0.5, 0.0, 0.1]
half_extents_m = [0.1, 0.2, 0.1]
exponents = [0.5, 1]
[[shape]]
kind = "sphere"
center_m = [0.0, 0.0, 0.1]
radius_m = 0.25
"""


def test_toml_file(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(TOML)
    assert KIND.recognise(path)
    scene = KIND.open(path, SourceOptions(rate_hz=3.0))
    assert isinstance(scene, AnalyticScene)
    assert (scene.axes, scene.rate_hz, scene.combine) == ("x east, y north, z up", 50.0, "union")
    assert [type(s) for s in scene.shapes] == [Plane, Box, Superquadric, Sphere]
    assert scene.shapes[1] == Box((0.0, 0.0, 0.1), (0.1, 0.2, 0.1), (0.0, 0.0, 45.0))
    path.write_text(TOML.replace("rate_hz = 50\n", ""))
    assert KIND.open(path, SourceOptions(rate_hz=3.0)).rate_hz == 3.0
    assert KIND.open(path, SourceOptions()).rate_hz == 30.0


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ('kind = "box"', 'kind = "cube"', "shape 2.kind"),
        ("radius_m = 0.25", "", "shape 4: found no 'radius_m'"),
        ("radius_m = 0.25", "radius_m = -1", "shape 4.radius_m"),
        ("radius_m = 0.25", "radius_m = true", "shape 4.radius_m"),
        ("radius_m = 0.25", "radius_m = nan", "shape 4.radius_m"),
        ("radius_m = 0.25", "radius_m = [1.0]", "shape 4"),
        ("radius_m = 0.25", "radius = 0.25", "shape 4.radius"),
        ("exponents = [0.5, 1]", "exponents = 0.5", "shape 3"),
        ("point_m = [0, 0, 0]", "point_m = [0, 0]", "shape 1.point_m"),
        ("point_m = [0, 0, 0]", 'point_m = "here"', "shape 1.point_m"),
        ("rate_hz = 50", "rate_hz = 0", "rate_hz"),
        ("rate_hz = 50", "rate = 50", "rate"),
        ('combine = "union"', "combine = 1", "combine"),
        ('combine = "union"', 'combine = "and"', "combine"),
        ("[[shape]]", "[shape]", "TOML"),
        (TOML, "", "shape"),
        (TOML, "shape = []", "shape"),
        (TOML, "shape = [1]", "shape"),
    ],
)
def test_toml_faults_name_the_file_and_the_field(tmp_path: Path, old: str, new: str, named: str) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(TOML.replace(old, new))
    with pytest.raises(SourceError) as caught:
        KIND.open(path, SourceOptions())
    assert str(path) in str(caught.value)
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)


@given(st.binary(max_size=60))
@settings(max_examples=40)
def test_any_bytes_give_a_scene_or_a_source_error(
    tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    path = tmp_path_factory.mktemp("toml") / "x.toml"
    path.write_bytes(data)
    with pytest.raises(SourceError):
        KIND.open(path, SourceOptions())
