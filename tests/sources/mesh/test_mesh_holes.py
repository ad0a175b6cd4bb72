"""Holes of meshes: which are closed, which remain, and no force outside the original surface."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from mesh_makers import segment_distance
from touchfield.errors import InvalidArgument
from touchfield.medium import Grid
from touchfield.sources.laws import ForceProfile
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.mesh.surface import HOLES

WALL_M = 0.25
LAW = ForceProfile(((-WALL_M, 0.0, 0.0, -12.0),))
ABOUT_Z_RAD = np.radians([5, 12, 25, 40, 60, 90, 120])
BOX = (1.1, 0.9, 0.7)


def sphere() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=3)


def box() -> trimesh.Trimesh:
    return trimesh.creation.box(BOX).subdivide().subdivide().subdivide()


def torus() -> trimesh.Trimesh:
    return trimesh.creation.torus(0.75, 0.35, major_sections=48, minor_sections=24)


def outside_sphere(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points, axis=1) - 1


def outside_box(points: np.ndarray) -> np.ndarray:
    return (np.abs(points) - np.array(BOX) / 2).max(axis=1)


def outside_torus(points: np.ndarray) -> np.ndarray:
    return np.hypot(np.hypot(points[:, 0], points[:, 1]) - 0.75, points[:, 2]) - 0.35


MAKERS = {"sphere": (sphere, outside_sphere), "box": (box, outside_box), "torus": (torus, outside_torus)}


def without(mesh: trimesh.Trimesh, angle_rad: float, *towards: tuple[float, float, float]) -> np.ndarray:
    """The triangles except those whose centre is within an angle of a direction, as seen from the middle."""
    centres = mesh.triangles_center / np.linalg.norm(mesh.triangles_center, axis=1)[:, None]
    gone = np.zeros(len(centres), bool)
    for direction in towards:
        gone |= centres @ (np.array(direction) / np.linalg.norm(direction)) > math.cos(angle_rad)
    return np.asarray(mesh.faces)[~gone]


def sampled_forces(scene: MeshScene, count: int = 48) -> tuple[np.ndarray, np.ndarray]:
    """Positions and amplitudes of forces, on a lattice that avoids the symmetries of the meshes."""
    grid = Grid.over_box((-1.51, -1.52, -1.53), (1.5, 1.49, 1.48), (count,) * 3)
    field = scene.field(0, grid, LAW)
    return grid.to_m(field.positions()), np.linalg.norm(field.vectors_n(), axis=1)


@pytest.mark.parametrize("holes", HOLES)
@pytest.mark.parametrize("shape", MAKERS)
@pytest.mark.parametrize("angle_rad", ABOUT_Z_RAD)
def test_closed_holes_give_no_force_outside_the_original_surface(
    shape: str, angle_rad: float, holes: str
) -> None:
    maker, outside = MAKERS[shape]
    mesh = maker()
    towards = ((0, 0, -1),) if shape != "torus" else ((1, 0.1, -0.2), (-0.4, 1, 0.1))
    faces = without(
        mesh, min(angle_rad, 1.6) if shape == "torus" else angle_rad, *towards
    )  # a larger angle leaves scraps
    scene = MeshScene(mesh.vertices, faces, holes=holes)
    points, forces = sampled_forces(scene)
    if holes == "leave" and len(faces) < len(mesh.faces):
        assert not scene.is_closed
    assert len(points) > 50 and forces.max() > 0.1
    # a chord over a saddle is outside the replaced surface
    bulge = max(0.0, float(outside(_spread(scene.surface.vertices_m[scene.surface.triangles])).max()))
    assert bulge < 1e-6 or shape == "torus"
    assert outside(points).max() <= 1.1 * bulge + 1e-6


def _spread(corners: np.ndarray, steps: int = 8) -> np.ndarray:
    """Points spread over triangles [m, 3, 3], float64 [n, 3]."""
    i, j = (
        each.reshape(-1) for each in np.meshgrid(np.arange(steps + 1), np.arange(steps + 1), indexing="ij")
    )
    barycentric = np.stack([i, j, steps - i - j], axis=1)[i + j <= steps] / steps
    return (barycentric @ corners).reshape(-1, 3)


@pytest.mark.parametrize("seen_rad", ABOUT_Z_RAD)
def test_the_force_falls_to_zero_at_the_rim_of_a_hole(seen_rad: float) -> None:
    mesh = sphere()
    scene = MeshScene(mesh.vertices, without(mesh, seen_rad, (0, 0, -1)), holes="leave")
    points, forces = sampled_forces(scene, 72)
    edges_m = scene.surface.vertices_m[scene.surface.triangles]
    edges_m = np.stack([edges_m, np.roll(edges_m, -1, axis=1)], axis=2).reshape(-1, 2, 3)
    rims = edges_m[
        np.bincount(scene.surface.edges.edge_of.reshape(-1))[scene.surface.edges.edge_of.reshape(-1)] == 1
    ]
    length = np.linalg.norm(points, axis=1)
    foot = points / length[:, None]
    to_rim = np.min([segment_distance(a, b, foot) for a, b in rims], axis=0)
    expected = 12 * (1 - length) * np.minimum(to_rim / WALL_M, 1)
    np.testing.assert_allclose(
        forces, expected, atol=0.35
    )  # the sphere has flat triangles: 12 N/m times 0.01 m
    assert forces[to_rim < 0.02].max(initial=0) < 0.5


def test_small_holes_are_closed_and_noted() -> None:
    mesh = sphere()
    faces = without(mesh, 0.2, (0, 0, -1), (0.3, 1, 0))
    scene = MeshScene(mesh.vertices, faces)
    assert scene.is_closed and "2 holes closed" in scene.notes[0] and "% of its part" in scene.notes[0]
    unclosed = MeshScene(mesh.vertices, faces, holes="leave")
    assert (
        not unclosed.is_closed
        and "2 open outlines left" in unclosed.notes[0]
        and "--holes close" in unclosed.notes[0]
    )
    wide = MeshScene(mesh.vertices, without(mesh, 0.9, (0, 0, -1)))
    assert (
        not wide.is_closed
        and MeshScene(mesh.vertices, without(mesh, 0.9, (0, 0, -1)), holes="close").is_closed
    )
    with pytest.raises(InvalidArgument, match="holes"):
        MeshScene(mesh.vertices, faces, holes="fill")


def test_a_long_rim_is_closed_by_a_patch_of_its_plane() -> None:
    ring = trimesh.creation.cylinder(1.0, 0.5, sections=700)
    bottom = ring.triangles_center[:, 2] < -0.249
    scene = MeshScene(ring.vertices, np.asarray(ring.faces)[~bottom], holes="close")
    assert scene.is_closed
    assert scene.surface.volume_m3() == pytest.approx(ring.volume, rel=1e-9)


def test_a_sheet_keeps_its_outline_and_loses_its_pinholes() -> None:
    x, y = np.meshgrid(np.arange(12.0), np.arange(12.0), indexing="ij")
    vertices = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)
    i, j = (each.reshape(-1) for each in np.meshgrid(np.arange(11), np.arange(11), indexing="ij"))
    a = i * 12 + j
    faces = np.concatenate([np.stack([a, a + 12, a + 13], 1), np.stack([a, a + 13, a + 1], 1)])
    scene = MeshScene(vertices, np.delete(faces, [40, 161], axis=0))
    assert not scene.is_closed and scene.is_one_sided
    assert scene.surface.edges.boundary_count == 44
    assert "1 open outline left" in scene.notes[-2] and "--holes close" not in scene.notes[-2]


def test_a_nearly_closed_mesh_that_faces_inwards_has_its_wall_inside() -> None:
    mesh = sphere()
    faces = without(mesh, 0.9, (0, 0, -1))
    out, in_ = (MeshScene(mesh.vertices, f, holes="leave") for f in (faces, faces[:, ::-1]))
    assert any("turned over" in note for note in in_.notes)
    assert np.array_equal(np.sort(sampled_forces(out)[0], axis=0), np.sort(sampled_forces(in_)[0], axis=0))


def test_inconsistent_triangles_are_flipped_if_that_closes_the_mesh() -> None:
    mesh = torus()
    faces = np.asarray(mesh.faces).copy()
    is_flipped = np.random.default_rng(3).random(len(faces)) < 0.3
    faces[is_flipped] = faces[is_flipped][:, ::-1]
    scene = MeshScene(mesh.vertices, faces)
    assert scene.is_closed and f"{is_flipped.sum()} triangles turned" in scene.notes[0]
    assert abs(scene.surface.volume_m3()) == pytest.approx(mesh.volume)


def test_a_wall_between_two_boxes_is_no_opening() -> None:
    """Two boxes with a common wall have no boundary edge; three triangles meet at each edge of the wall."""
    box_a = trimesh.creation.box((1, 1, 1))
    two = trimesh.creation.box((1, 1, 1))
    two.apply_translation((1, 0, 0))
    bare = np.asarray(two.faces)[two.triangles_center[:, 0] > 0.51]
    merged = trimesh.util.concatenate([box_a, trimesh.Trimesh(two.vertices, bare, process=False)])
    merged.merge_vertices()
    assert MeshScene(merged.vertices, merged.faces, holes="close").is_closed
    unclosed = MeshScene(merged.vertices, merged.faces, holes="leave")
    assert unclosed.surface.edges.boundary_count == 0 and not unclosed.is_closed
    assert "do not pair off" in unclosed.notes[-1] and "0 boundary" not in " ".join(unclosed.notes)


def test_rotating_a_scene_rotates_its_field() -> None:
    mesh = sphere()
    scene = MeshScene(mesh.vertices, without(mesh, 0.7, (0, 0, -1)), holes="leave")
    turn = Rotation.from_euler("x", 50, degrees=True).as_matrix()
    again = MeshScene(np.asarray(mesh.vertices) @ turn.T, without(mesh, 0.7, (0, 0, -1)), holes="leave")
    (moved_points, f), (expected_points, g) = (
        sampled_forces(scene.moved(turn, np.zeros(3))),
        sampled_forces(again),
    )
    assert np.array_equal(moved_points, expected_points) and np.abs(f - g).max() < 1e-6
