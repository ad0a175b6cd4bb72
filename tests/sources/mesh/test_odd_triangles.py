"""Triangles that a file has twice, and sheets inside a closed body, do not make the body a shell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from tests.mesh_makers import CUBE_FACES, cube, together

from touchfield.medium import Grid
from touchfield.sources.laws import ForceProfile, LawSpec, profile_of
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.mesh.surface import Surface, without_duplicates
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source
from touchfield.sources.thin_walls import MinThickness

QUAD = np.array([[0.5, 0, 0], [0.5, 1, 0], [0.5, 1, 1], [0.5, 0, 1]]), np.array([[0, 1, 2], [0, 2, 3]])


def distance(scene: MeshScene, point: tuple[float, float, float]) -> float:
    """The signed distance at a point, by a law that is linear in it; the force shows along its gradient."""
    field = scene.field(0, Grid((1, 1, 1), (0.1, 0.1, 0.1), point), ForceProfile(((-0.6, 0.6, 4.0, 1.0),)))
    return float(np.linalg.norm(field.vectors_n()[0].astype(float)) - 4.0)


def save_obj(path: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
    path.write_text("\n".join(lines))
    return path


def assert_is_the_cube(scene: MeshScene, *, note: str) -> None:
    assert scene.is_closed
    assert any(note in text for text in scene.notes)
    assert distance(scene, (0.5, 0.5, 0.9)) == pytest.approx(-0.1, abs=1e-6)
    assert distance(scene, (0.4, 0.5, 0.6)) == pytest.approx(-0.4, abs=1e-6)
    solid = scene.field(0, Grid((1, 1, 1), (0.1, 0.1, 0.1), (0.5, 0.5, 0.9)), profile_of(LawSpec(), np.inf))
    assert solid.support_count == 1


@pytest.mark.parametrize("shift", [0, 1, 2])
def test_a_cube_with_a_triangle_twice_is_the_cube(tmp_path: Path, shift: int) -> None:
    vertices, faces = cube()
    path = save_obj(
        tmp_path / "a.obj", vertices, np.concatenate([faces, np.roll(faces[10:11], shift, axis=1)])
    )
    scene = open_source(path, SourceOptions())
    assert isinstance(scene, MeshScene)
    assert_is_the_cube(scene, note="1 triangle removed, which the file has twice")


def test_a_cube_with_every_triangle_three_times_is_the_cube() -> None:
    vertices, faces = cube()
    scene = MeshScene(vertices, np.concatenate([faces, faces, np.roll(faces, 1, axis=1)]))
    assert_is_the_cube(scene, note="24 triangles removed")


def test_duplicates_are_removed_by_their_direction() -> None:
    faces = np.array([[5, 2, 9], [2, 9, 5], [2, 5, 9], [1, 2, 3], [9, 5, 2]])
    left, count = without_duplicates(faces)
    np.testing.assert_array_equal(left, [[5, 2, 9], [2, 5, 9], [1, 2, 3]])  # the mirrored one stays
    assert count == 2


def test_a_cube_without_duplicates_has_no_note() -> None:
    assert not any("twice" in note or "left out" in note for note in MeshScene(*cube()).notes)


def test_a_double_sheet_stays_a_double_sheet() -> None:
    vertices, faces = QUAD
    scene = MeshScene(vertices, np.concatenate([faces, faces[:, ::-1]]))
    assert not scene.is_closed and not scene.is_one_sided


@pytest.mark.parametrize("twins", [slice(0, 1), slice(0, 6), slice(0, 12, 5), slice(None)])
def test_a_cube_with_triangles_on_both_sides_is_the_cube(twins: slice) -> None:
    """Exporters that know no back of a face write it once more, facing the other way."""
    vertices, faces = cube()
    both = np.concatenate([faces, faces[twins, ::-1]])
    scene = MeshScene(vertices, both[np.random.default_rng(5).permutation(len(both))])
    count = len(both) - len(faces)
    assert_is_the_cube(scene, note=f"{count} triangles left out, which the file also has facing the other")
    assert not MeshScene(vertices, both, holes="leave").is_closed


def test_a_triangle_without_area_between_two_corners_leaves_the_cube() -> None:
    vertices, faces = cube()
    on_edge = (vertices[faces[0, 0]] + vertices[faces[0, 1]]) / 2
    flat = [[faces[0, 0], faces[0, 1], 8], [3, 3, 1], [0, 8, 0]]
    scene = MeshScene(np.concatenate([vertices, [on_edge]]), np.concatenate([faces, flat]))
    assert_is_the_cube(scene, note="closed")


def divided_cube(xs: list[float], is_turned: tuple[bool, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The cube with walls across it at `xs`, whose rims are edges of its sides."""
    ends = [0.0, *xs, 1.0]
    corners = np.array([[x, y, z] for x in ends for y, z in ((0, 0), (1, 0), (1, 1), (0, 1))])
    quads = [[0, 3, 2, 1], [4 * len(xs) + 4 + i for i in range(4)]]
    for n in range(len(ends) - 1):
        quads += [[4 * n + i, 4 * n + (i + 1) % 4, 4 * n + 4 + (i + 1) % 4, 4 * n + 4 + i] for i in range(4)]
    for n, turned in enumerate(is_turned, 1):
        quads.append([4 * n + i for i in range(4)][:: -1 if turned else 1])
    faces = np.array([[a, b, c] for a, b, c, _ in quads] + [[a, c, d] for a, _, c, d in quads])
    return corners, faces


@pytest.mark.parametrize("is_turned", [(False,), (False, False), (True, False), (False, True, True)])
def test_walls_across_a_cube_leave_the_cube(is_turned: tuple[bool, ...]) -> None:
    places = [(n + 1) / (len(is_turned) + 1) for n in range(len(is_turned))]
    scene = MeshScene(*divided_cube(places, is_turned))
    assert_is_the_cube(scene, note=f"{2 * len(is_turned)} triangles inside a closed body are left out")


@pytest.mark.parametrize("low", [0.45, 0.1])
def test_a_sheet_in_the_void_of_a_cube_or_beside_it_is_left_out(low: float) -> None:
    hollow = trimesh.creation.icosphere(subdivisions=2, radius=0.2)
    void = np.asarray(hollow.vertices) + 0.5, np.asarray(hollow.faces)[:, ::-1]
    quad = low + 0.1 * (QUAD[0] - [0.5, 0, 0]), QUAD[1]
    scene = MeshScene(*together(cube(), void, quad))
    assert scene.is_closed and any("2 triangles inside a closed body" in note for note in scene.notes)
    assert scene.surface.volume_m3() == pytest.approx(1 - hollow.volume)


def test_a_loose_quad_inside_a_cube_leaves_the_cube(tmp_path: Path) -> None:
    path = save_obj(tmp_path / "a.obj", *together(cube(), QUAD))
    scene = open_source(path, SourceOptions())
    assert isinstance(scene, MeshScene)
    assert_is_the_cube(scene, note="2 triangles inside a closed body are left out")


def test_a_diagonal_wall_on_the_corners_of_a_cube_leaves_the_cube() -> None:
    vertices, faces = cube()
    wall = np.array([[0, 2, 7], [0, 7, 5]])  # shares corners, and edges of one or two triangles
    scene = MeshScene(vertices, np.concatenate([faces, wall]))
    assert_is_the_cube(scene, note="2 triangles inside a closed body are left out")


def test_a_sheet_that_reaches_outside_is_kept() -> None:
    vertices, faces = QUAD
    scene = MeshScene(*together(cube(), (vertices * [1, 1, 3], faces)))
    assert not scene.is_closed
    assert len(scene.surface.triangles) == 14


def test_a_cube_inside_an_open_sphere_is_no_reason_to_drop_the_sphere() -> None:
    vertices, faces = cube(-2.0, 3.0)
    scene = MeshScene(*together(cube(), (vertices, faces[:-2])), holes="small")
    assert len(scene.surface.triangles) >= len(CUBE_FACES) + 10


def test_turned_triangles_keep_their_edges() -> None:
    vertices, faces = cube()
    surface = Surface(vertices, faces, "cube")
    turned = surface.with_vertices(vertices, np.ones(len(faces), bool))
    again = Surface(vertices, turned.triangles, "cube")
    assert turned.volume_m3() == -surface.volume_m3() != 0
    np.testing.assert_array_equal(turned.edges.edge_of, again.edges.edge_of)
    np.testing.assert_allclose(turned.pseudo_normals(), again.pseudo_normals())


@pytest.mark.parametrize("overhang", [1e-7, 1e-5, 1e-3])
def test_a_sliver_at_an_edge_is_no_thin_wall(overhang: float) -> None:
    """The top of a cube reaches over an edge by a little, and a sliver faces back: nothing thickens that."""
    vertices, faces = cube()
    a, b, c = faces[0]
    beyond = (vertices[a] + vertices[b]) / 2
    normal = np.cross(vertices[b] - vertices[a], vertices[c] - vertices[a])
    beyond = beyond + overhang * (beyond - vertices[c] + 0.2 * normal)
    split = np.array([[a, 8, c], [8, b, c], [a, b, 8]])
    scene = MeshScene(np.concatenate([vertices, [beyond]]), np.concatenate([faces[1:], split]))
    assert scene.is_closed
    least = MinThickness((0.1,) * 3, (0.1,) * 3, (0.1,) * 3, 0.02)
    assert scene.growth_of(least) is None
    plate = MeshScene(vertices * [1, 1, 0.05], faces).growth_of(least)
    assert plate is not None and plate.thickness_m == pytest.approx(0.05)
