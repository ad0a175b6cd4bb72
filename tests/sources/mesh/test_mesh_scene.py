"""Meshes: distances and directions against brute force, signs against solid angles, shells, faults."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings, strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from mesh_makers import Mesh, all_points, cube, distance_to, inverted, measured, together, winding
from touchfield.errors import InvalidArgument, SourceError
from touchfield.medium import Grid
from touchfield.sources.laws import ForceProfile
from touchfield.sources.mesh.mesh_scene import MeshScene


def grid_around(vertices: np.ndarray, shape: tuple[int, int, int], margin: float = 0.3) -> Grid:
    low, high = vertices.min(0), vertices.max(0)
    side = margin * (high - low).max()
    return Grid.over_box(low - side, high + side, shape)


def check_against_brute_force(mesh: Mesh, grid: Grid, band_m: float) -> None:
    """For every sample: membership of the band, distance, sign, and that -phi n leads to the surface."""
    points, phi, normals = measured(MeshScene(*mesh), grid, band_m)
    size = np.ptp(mesh[0], axis=0).max() + band_m
    every = all_points(grid)
    true = distance_to(mesh, every)
    true *= np.where(np.round(winding(mesh, every)) != 0, -1.0, 1.0)
    expected = np.abs(true) < band_m * (1 - 1e-6)
    surely_not = np.abs(true) > band_m * (1 + 1e-6)
    found = np.ravel_multi_index(np.round(grid.to_index(points)).astype(int).T, grid.shape)
    mask = np.zeros(len(every), bool)
    mask[found] = True
    assert mask[expected].all()
    assert not mask[surely_not].any()
    clear = np.abs(true[found]) > 1e-9 * size  # the sign is undefined on the surface
    np.testing.assert_allclose(phi[clear], true[found][clear], atol=4e-6 * band_m)
    assert (distance_to(mesh, points - phi[:, None] * normals) < 2e-6 * size).all()


# -- distance, direction, sign -----------------------------------------------------------------------------


def test_box_has_the_analytic_distance_and_direction() -> None:
    size = np.array([0.4, 0.3, 0.2])
    box = trimesh.creation.box(size)
    grid = Grid((45, 37, 31), (0.0131, 0.0137, 0.0141), (-0.29, -0.25, -0.21))
    points, phi, normals = measured(MeshScene(box.vertices, box.faces), grid, 0.05)
    q = np.abs(points) - size / 2
    outside = np.maximum(q, 0)
    true = np.linalg.norm(outside, axis=1) + np.minimum(q.max(1), 0)
    np.testing.assert_allclose(phi, true, atol=1e-5 * 0.4)
    beyond = true > 1e-6
    direction = np.sign(points) * outside / np.maximum(np.linalg.norm(outside, axis=1), 1e-12)[:, None]
    np.testing.assert_allclose(normals[beyond], direction[beyond], atol=1e-5)
    two = np.sort(q, axis=1)
    deep = (true < -1e-6) & (two[:, 2] - two[:, 1] > 1e-6)
    axis = q.argmax(1)
    np.testing.assert_allclose(
        normals[np.arange(len(q)), axis][deep], np.sign(points)[np.arange(len(q)), axis][deep]
    )
    assert deep.sum() > 1000 and beyond.sum() > 1000


def test_icosphere_approximates_the_sphere() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    grid = Grid.over_box((-1.5,) * 3, (1.5,) * 3, (40, 40, 40))
    points, phi, normals = measured(MeshScene(sphere.vertices, sphere.faces), grid, 0.3)
    radius = np.linalg.norm(points, axis=1)
    np.testing.assert_allclose(phi, radius - 1, atol=4e-3)
    is_outside_shell = np.abs(radius - 1) > 0.1
    assert ((normals * points).sum(1)[is_outside_shell] / radius[is_outside_shell] > 0.995).all()


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_convex_hulls_on_anisotropic_grids(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(rng.integers(4, 14), 3)) * 10 ** rng.uniform(-3, 2)
    hull = ConvexHull(points)
    faces = hull.simplices.copy()
    corners = points[faces]
    facing = np.einsum(
        "ij,ij->i",
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]),
        hull.equations[:, :3],
    )
    faces[facing < 0] = faces[facing < 0][:, ::-1]
    if rng.random() < 0.3:
        faces = faces[:, ::-1]  # inside out: the sign must still be right
    shape = tuple(rng.integers(3, 19, 3).tolist())
    check_against_brute_force((points, faces), grid_around(points, shape), 0.3 * np.ptp(points, axis=0).max())


@settings(max_examples=16)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["overlap", "cavity", "nested", "inside out"]))
def test_signs_are_those_of_the_winding_number(seed: int, kind: str) -> None:
    rng = np.random.default_rng(seed)
    inner, outer = cube(0.25, 0.7), cube()
    parts = {
        "overlap": (outer, cube(0.4, 1.3)),
        "cavity": (outer, inverted(inner)),
        "nested": (outer, inner),
        "inside out": (inverted(outer), inverted(cube(0.4, 1.3))),
    }[kind]
    vertices, faces = together(*parts)
    vertices = Rotation.random(rng=rng).apply(vertices)
    grid = grid_around(vertices, (13, 15, 17))
    if kind == "cavity":
        check_against_brute_force((vertices, faces), grid, 0.5)
        return
    points, phi, _ = measured(
        MeshScene(vertices, faces), grid, 0.5
    )  # inner walls have no force: test_mesh_union
    clear = distance_to((vertices, faces), points) > 1e-6
    is_inside = np.round(winding((vertices, faces), points)) != 0
    assert (np.sign(phi)[clear] == np.where(is_inside, -1, 1)[clear]).all()
    np.testing.assert_allclose(phi[~is_inside], distance_to((vertices, faces), points[~is_inside]), atol=2e-6)
    assert (-phi[is_inside] >= distance_to((vertices, faces), points[is_inside]) - 2e-6).all()


def test_vertices_and_edges_on_lattice_columns_count_once() -> None:
    vertices, faces = cube(2.0, 9.0)
    for shift in ((0, 0, 0), (0.5, 0, 0), (0, 0.5, 0)):
        grid = Grid((12, 12, 12), (1.0, 1.0, 1.0), shift)
        check_against_brute_force((vertices, faces), grid, 2.5)
        check_against_brute_force(inverted((vertices, faces)), grid, 2.5)
    tips = np.concatenate([3 * np.eye(3), -3 * np.eye(3)])
    hull = trimesh.convex.convex_hull(tips)
    check_against_brute_force(
        (np.asarray(hull.vertices), np.asarray(hull.faces)), Grid((9, 9, 9), (1.0,) * 3, (-4.0,) * 3), 2.2
    )


def test_a_grid_that_cuts_the_mesh_sees_crossings_before_it() -> None:
    vertices, faces = cube(0, 10)
    for origin in ((4.3, 4.2, 4.1), (-2.5, 4.2, 4.1), (6.3, -2.2, 4.1), (6.3, 5.2, 7.1)):
        check_against_brute_force((vertices, faces), Grid((9, 9, 9), (0.6, 0.7, 0.5), origin), 1.8)


def test_a_solid_is_filled_completely() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    grid = Grid.over_box((-1.1,) * 3, (1.1,) * 3, (50, 50, 50))
    law = ForceProfile(((-math.inf, 0.0, 1.0, 0.0),))
    field = MeshScene(sphere.vertices, sphere.faces).field(0, grid, law)
    inside = np.linalg.norm(all_points(grid), axis=1).reshape(grid.shape) < 0.985
    assert (field.to_dense().any(axis=-1) | ~inside).all()
    np.testing.assert_allclose(np.linalg.norm(field.vectors_n(), axis=1), 1, rtol=1e-6)
    volume = field.support_count * math.prod(grid.spacing_m)
    assert volume == pytest.approx(abs(sphere.volume), rel=0.01)
    deep = ForceProfile(((-math.inf, 0.0, 0.0, -1.0),))
    points = grid.to_m(MeshScene(sphere.vertices, sphere.faces).field(0, grid, deep).positions())
    depth = np.linalg.norm(MeshScene(sphere.vertices, sphere.faces).field(0, grid, deep).vectors_n(), axis=1)
    np.testing.assert_allclose(depth, 1 - np.linalg.norm(points, axis=1), atol=0.02)


@pytest.mark.parametrize("origin", [(-1.6,) * 3, (0.2, -0.3, -0.7)], ids=["around", "within"])
def test_a_law_without_forces_outside_has_the_same_field_inside(origin: tuple[float, float, float]) -> None:
    shapes = [trimesh.creation.icosphere(2, 0.9), trimesh.creation.torus(1.1, 0.3, 24, 12)]
    vertices, faces = together(*((np.asarray(s.vertices), np.asarray(s.faces)) for s in shapes))
    scene, grid = MeshScene(vertices, faces), Grid((61, 57, 83), (0.05, 0.055, 0.04), origin)
    inside = ForceProfile(((-1.0, 0.0, 0.0, -3.0),))
    beyond = ForceProfile((*inside.pieces, (0.0, 0.3, 0.0, 0.0)))  # searched there, and found to be zero
    only, both = scene.field(0, grid, inside), scene.field(0, grid, beyond)
    assert only.support_count > 2000
    np.testing.assert_array_equal(only.bricks, both.bricks)
    np.testing.assert_array_equal(only.forces_n, both.forces_n)


@pytest.mark.parametrize("steps", [(1, 1, 1), (4, 1, 2)])
def test_a_fine_mesh_keeps_its_distances_deep_inside(steps: tuple[int, int, int]) -> None:
    """There many triangles are almost equally near: the centre of a sphere, the axis of an ellipsoid."""
    sphere = trimesh.creation.icosphere(subdivisions=2)
    for scale in ([1, 1, 1], [1, 0.4, 0.4]):
        mesh = sphere.vertices * scale + 0.013, sphere.faces
        shape = tuple(5 * step + 3 for step in steps)
        check_against_brute_force(mesh, grid_around(mesh[0], shape), 1.1)


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1))
def test_slivers_and_flat_triangles_keep_their_distances(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(6, 3, 3))
    corners[0, 2] = corners[0, 0] + 0.3 * (corners[0, 1] - corners[0, 0])  # a line
    corners[1, 2] = corners[1, 0] + 1e-7 * corners[1, 2]  # a needle
    corners[2, 2] = corners[2, 0]  # a line between different vertices at one position
    corners[3, 2] = corners[3, 0] + 0.5 * (corners[3, 1] - corners[3, 0]) + 1e-9
    mesh = corners.reshape(-1, 3), np.arange(18).reshape(6, 3)
    grid = grid_around(mesh[0], (11, 12, 13))
    points, phi, _ = measured(MeshScene(*mesh, shell="two"), grid, 0.5, low_m=0.0)
    every = all_points(grid)
    true = distance_to(mesh, every)
    assert len(points) == np.count_nonzero(true <= 0.5)
    np.testing.assert_allclose(np.sort(phi), np.sort(true[true <= 0.5]), atol=2e-6)


def test_memory_is_proportional_to_the_result() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=0.01)
    law = ForceProfile(((-0.001, 0.0, 1.0, 0.0),))
    scene = MeshScene(sphere.vertices, sphere.faces)
    for count in (1024, 1 << 20):
        grid = Grid((count,) * 3, (0.001,) * 3, (-0.5103, -0.5107, -0.5101))
        small = Grid((64,) * 3, (0.001,) * 3, (-0.5103 + 0.48, -0.5107 + 0.48, -0.5101 + 0.48))
        field, same = scene.field(0, grid, law), scene.field(0, small, law)
        assert field.support_count == same.support_count > 500
        assert (field.positions() - same.positions() == 480).all()


def test_threads_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    sphere = trimesh.creation.icosphere(subdivisions=3)
    grid = Grid.over_box((-1.2,) * 3, (1.2,) * 3, (64,) * 3)
    law = ForceProfile(((-0.1, 0.05, 1.0, 2.0),))
    fields = []
    for threads in ("1", "3"):
        monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
        fields.append(MeshScene(sphere.vertices, sphere.faces).field(0, grid, law))
    assert fields[0] == fields[1] and fields[0].support_count > 1000


# -- open meshes -------------------------------------------------------------------------------------------


def sheet() -> Mesh:
    """A square of two triangles in z = 0 that face up."""
    return np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float), np.array([[0, 1, 2], [0, 2, 3]])


SHEET_GRID = Grid((21, 21, 21), (0.1, 0.1, 0.1), (-0.5, -0.5, -1.03))


def test_an_open_sheet_is_one_sided_where_it_faces_consistently() -> None:
    scene = MeshScene(*sheet())
    assert not scene.is_closed and scene.is_one_sided
    assert "4 boundary edges" in scene.notes[-1] and "one-sided" in scene.notes[-1]
    points, phi, normals = measured(scene, SHEET_GRID, 0.25)
    assert ((points[:, :2] > 0) & (points[:, :2] < 1)).all()  # nothing outside its outline
    over = ((points[:, :2] > 0.25) & (points[:, :2] < 0.75)).all(
        axis=1
    )  # and everything up to its distance from the rim
    np.testing.assert_allclose(phi[over], points[over, 2], atol=2e-6)
    np.testing.assert_allclose(normals[over], np.broadcast_to([0, 0, 1], (over.sum(), 3)), atol=1e-6)
    assert over.sum() > 80 and (~over).sum() > 80
    to_rim = np.minimum(points[:, :2], 1 - points[:, :2]).min(axis=1)
    expected = 4 + points[:, 2] / 0.25
    np.testing.assert_allclose(phi / 0.25 + 4, expected * np.minimum(to_rim / 0.25, 1), atol=2e-5)


def test_an_open_sheet_can_be_two_sided() -> None:
    scene = MeshScene(*sheet(), shell="two")
    points, phi, normals = measured(scene, SHEET_GRID, 0.2)
    true = distance_to(sheet(), points)
    np.testing.assert_allclose(phi, true - 0.1, atol=2e-6)  # a wall of 0.2 m, half on each side
    assert len(points) == np.count_nonzero(distance_to(sheet(), all_points(SHEET_GRID)) <= 0.3)
    over = ((points[:, :2] > -1e-9) & (points[:, :2] < 1 + 1e-9)).all(axis=1)
    np.testing.assert_allclose(normals[over, 2], np.sign(points[over, 2]), atol=1e-6)


def test_a_sheet_that_faces_both_ways_is_two_sided() -> None:
    vertices, faces = sheet()
    scene = MeshScene(vertices, np.stack([faces[0], faces[1][::-1]]))
    assert not scene.is_one_sided and "inconsistently" in scene.notes[-1]
    double = MeshScene(vertices, np.concatenate([faces, faces[:, ::-1]]))
    assert not double.is_closed and not double.is_one_sided and "twin" in double.notes[-1]
    law = ForceProfile(((-0.2, 0.0, 1.0, 0.0),))
    assert double.field(0, SHEET_GRID, law).support_count > 100


def test_one_sided_signs_at_edges_and_vertices() -> None:
    vertices, faces = cube()
    points, phi, _ = measured(
        MeshScene(vertices, faces[:-1], shell="one"), grid_around(vertices, (14, 15, 16)), 0.2
    )
    closed = np.round(winding((vertices, faces), points)) != 0
    hole = vertices[faces[-1]].mean(0)
    is_unfaded = np.linalg.norm(points - hole, axis=1) > 1.0  # where the force does not fade
    assert (np.sign(phi)[is_unfaded] == np.where(closed, -1, 1)[is_unfaded]).all() and is_unfaded.sum() > 500


def test_a_solid_needs_a_closed_mesh() -> None:
    with pytest.raises(InvalidArgument, match="boundary edges"):
        MeshScene(*sheet()).field(0, SHEET_GRID, ForceProfile(((-math.inf, 0.0, 1.0, 0.0),)))


@pytest.mark.parametrize("frame", [-1, 1])
def test_a_mesh_has_a_single_frame(frame: int) -> None:
    with pytest.raises(InvalidArgument, match="frame"):
        MeshScene(*cube()).field(frame, SHEET_GRID, ForceProfile(((-0.1, 0.0, 1.0, 0.0),)))


def test_grids_too_fine_for_the_mesh_are_refused() -> None:
    grid = Grid((8, 8, 8), (1e-14,) * 3, (0.0,) * 3)
    with pytest.raises(InvalidArgument, match="coarser"):
        MeshScene(*cube()).field(0, grid, ForceProfile(((-0.1, 0.0, 1.0, 0.0),)))


def test_directions_on_the_surface_are_pseudo_normals() -> None:
    vertices, faces = cube(2.0, 9.0)
    law = ForceProfile(((-0.5, 0.5, 1.0, 0.0),))
    grid = Grid((12, 12, 12), (1.0,) * 3, (0.0,) * 3)
    for mesh in ((vertices, faces), inverted((vertices, faces))):
        dense = MeshScene(*mesh).field(0, grid, law).to_dense()
        np.testing.assert_allclose(dense[9, 5, 5], [1, 0, 0], atol=1e-6)
        np.testing.assert_allclose(dense[9, 9, 5], np.array([1, 1, 0]) / math.sqrt(2), atol=1e-6)
        np.testing.assert_allclose(dense[2, 2, 2], -np.ones(3) / math.sqrt(3), atol=1e-6)


# -- faults ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("vertices", "triangles"),
    [
        (np.zeros((3, 3)), np.zeros((0, 3), int)),
        (np.zeros((0, 3)), np.zeros((0, 3), int)),
        (np.eye(3), [[0, 1, 1]]),
        (np.eye(3), [[0, 1, 3]]),
        (np.eye(3), [[0, 1, -1]]),
        (np.eye(3), [[0.0, 1.0, 2.0]]),
        (np.eye(3)[:, :2], [[0, 1, 2]]),
        (np.array([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]]), [[0, 1, 2]]),
        (np.array([[0, 0, 0], [1, 0, 0], [0, np.inf, 0]]), [[0, 1, 2]]),
    ],
)
def test_faulty_meshes_are_refused(vertices: np.ndarray, triangles: object) -> None:
    with pytest.raises(SourceError) as caught:
        MeshScene(vertices, triangles, name="that one")
    assert str(caught.value).startswith("that one") and "\n" not in str(caught.value)


def test_unknown_shells_are_refused() -> None:
    with pytest.raises(InvalidArgument, match="shell"):
        MeshScene(*cube(), shell="three")
