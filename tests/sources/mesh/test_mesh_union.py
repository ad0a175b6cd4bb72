"""Overlapping closed meshes: the field of their union, without a force to or from inner walls."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from mesh_makers import Mesh, all_points, cube, distance_to, inverted, measured, together
from touchfield.medium import Grid
from touchfield.sources.laws import ForceProfile
from touchfield.sources.mesh.mesh_scene import MeshScene, union_of
from touchfield.sources.mesh.surface import Surface

SOLID = ForceProfile(((-math.inf, 0.0, 0.0, -1.0),))


def cuboid(low: tuple[float, float, float], high: tuple[float, float, float]) -> Mesh:
    vertices, faces = cube()
    return np.array(low) + vertices * (np.array(high) - low), faces


def test_two_spheres_have_the_depth_of_their_union() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4)
    vertices, faces = together(
        (np.asarray(ball.vertices), np.asarray(ball.faces)),
        (np.asarray(ball.vertices) + np.array([0.9, 0.1, 0.2]), np.asarray(ball.faces)),
    )
    grid = Grid.over_box((-1.1, -1.1, -1.1), (2.0, 1.2, 1.3), (37, 31, 32))
    field = MeshScene(vertices, faces).field(0, grid, SOLID)
    points, forces = grid.to_m(field.positions()), field.vectors_n().astype(float)
    # the surface of the union: two caps, and the circle where they meet
    offset = np.array([0.9, 0.1, 0.2])
    axis = offset / np.linalg.norm(offset)
    middle, radius = offset / 2, math.sqrt(1 - offset @ offset / 4)
    from_axis = points - middle - ((points - middle) @ axis)[:, None] * axis
    rise = np.linalg.norm(from_axis, axis=1)
    depth = np.hypot((points - middle) @ axis, rise - radius)
    for centre, side in ((np.zeros(3), -1), (offset, 1)):
        off = points - centre
        length = np.linalg.norm(off, axis=1)
        foot = centre + off / np.maximum(length, 1e-9)[:, None]
        is_cap = side * ((foot - middle) @ axis) > 0
        depth = np.where(is_cap, np.minimum(depth, np.abs(1 - length)), depth)
    np.testing.assert_allclose(np.linalg.norm(forces, axis=1), depth, atol=0.006)
    assert np.linalg.norm(forces, axis=1).max() > 0.85  # the depth at the ring in the middle


@pytest.mark.parametrize("is_rotated", [False, True])
@pytest.mark.parametrize(
    ("parts", "outline"),
    [
        # two boxes that form one longer box: overlapping, touching, and one inside the other
        (((0, 0, 0), (1, 1, 1), (0.4, 0, 0), (2, 1, 1)), ((0, 0, 0), (2, 1, 1))),
        (((0, 0, 0), (1, 1, 1), (1, 0, 0), (2, 1, 1)), ((0, 0, 0), (2, 1, 1))),
        (((0, 0, 0), (2, 1, 1), (0.3, 0.2, 0.1), (0.9, 0.6, 0.8)), ((0, 0, 0), (2, 1, 1))),
        (((0, 0, 0), (2, 1, 1), (0, 0, 0), (2, 1, 1)), ((0, 0, 0), (2, 1, 1))),
    ],
)
def test_overlapping_boxes_equal_the_combined_box(parts: tuple, outline: tuple, is_rotated: bool) -> None:
    turn = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix() if is_rotated else np.eye(3)
    vertices, faces = together(cuboid(*parts[:2]), cuboid(*parts[2:]))
    combined = cuboid(*outline)
    grid = Grid.over_box((-1.03, -1.02, -1.01), (2.2, 2.1, 2.0), (39, 38, 37))
    separate = MeshScene(vertices @ turn.T, faces).field(0, grid, SOLID).to_dense()
    other = MeshScene(combined[0] @ turn.T, combined[1]).field(0, grid, SOLID).to_dense()
    depth, true = np.linalg.norm(separate, axis=-1), np.linalg.norm(other, axis=-1)
    np.testing.assert_allclose(depth, true, atol=2e-6)
    assert (true > 0).sum() > 500
    differs = np.linalg.norm(separate - other, axis=-1) > 1e-5
    assert differs.mean() < 0.02  # where two faces are equally near, either may push


def dipyramid(corners: np.ndarray) -> Mesh:
    """Two pyramids, base to base, over a closed line [n, 2]."""
    n = len(corners)
    vertices = np.concatenate([np.column_stack([corners, np.zeros(n)]), [[0, 0, 1.1], [0, 0, -0.9]]])
    upper = [(i, (i + 1) % n, n) for i in range(n)]
    lower = [(j, i, n + 1) for i, j, _ in upper]
    return vertices, np.array(upper + lower)


def around(radius: float, angles: np.ndarray) -> np.ndarray:
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


def test_triangles_with_one_common_vertex_are_cut_where_they_cross() -> None:
    """The sides of a star that is drawn in one line cross from the tip on; its outline's sides do not."""
    steps = 2 * math.pi / 5 * np.arange(5)
    star = dipyramid(around(1.0, 2 * steps))
    hollow = math.cos(2 * math.pi / 5) / math.cos(math.pi / 5)  # between the tips of a pentagram
    outline = dipyramid(
        np.stack([around(1.0, steps), around(hollow, steps + math.pi / 5)], axis=1).reshape(10, 2)
    )
    turn = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()
    grid = Grid.over_box((-1.03, -1.02, -1.01), (1.04, 1.03, 1.02), (39, 38, 37))
    found, true = (
        np.linalg.norm(MeshScene(vertices @ turn.T, faces).field(0, grid, SOLID).to_dense(), axis=-1)
        for vertices, faces in (star, outline)
    )
    assert (true > 0).sum() > 2000
    np.testing.assert_allclose(found, true, atol=2e-6)


def test_no_force_leads_to_an_inner_wall() -> None:
    """Three crossing boxes in any orientation: every force leads out of all of them."""
    rng = np.random.default_rng(5)
    parts = []
    for _ in range(3):
        vertices, faces = cuboid((-1, -0.3, -0.4), (1, 0.3, 0.4))
        parts.append((Rotation.random(rng=rng).apply(vertices), faces))
    vertices, faces = together(*parts)
    grid = Grid.over_box((-1.2,) * 3, (1.2,) * 3, (41,) * 3)
    field = MeshScene(vertices, faces).field(0, grid, SOLID)
    points, forces = grid.to_m(field.positions()), field.vectors_n().astype(float)
    feet = points + forces
    inside = np.zeros(len(feet), bool)
    for part_vertices, part_faces in parts:
        a, b, c = (part_vertices[part_faces[:, i]] for i in range(3))
        normals = np.cross(b - a, c - a)
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        inside |= ((feet[:, None] - a) * normals).sum(axis=2).max(axis=1) < -1e-5
    assert len(points) > 3000 and not inside.any()
    # and no closer wall counts: the depth is the distance to the parts of faces outside all other boxes
    union = union_of(Surface(vertices, faces, "boxes"))
    assert union is not None
    outer_triangles = np.concatenate(
        [vertices[Surface(vertices, faces, "boxes").triangles[union.uncut]], union.corners_m]
    )
    outer_mesh = outer_triangles.reshape(-1, 3), np.arange(3 * len(outer_triangles)).reshape(-1, 3)
    np.testing.assert_allclose(np.linalg.norm(forces, axis=1), distance_to(outer_mesh, points), atol=1e-5)


def test_meshes_without_overlap_are_unchanged() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=3)
    assert union_of(Surface(sphere.vertices, sphere.faces, "one")) is None
    separate = together(cube(), cube(2.0, 3.0))
    assert union_of(Surface(*separate, "two")) is None
    hollow = together(cube(), inverted(cube(0.2, 0.8)))
    assert union_of(Surface(*hollow, "hollow")) is None
    points, phi, _ = measured(MeshScene(*hollow), Grid.over_box((-0.2,) * 3, (1.2,) * 3, (29,) * 3), 0.15)
    np.testing.assert_allclose(np.abs(phi), distance_to(hollow, points), atol=1e-6)


def test_pieces_have_the_damping_of_their_original_triangles() -> None:
    vertices, faces = together(cube(), cube(0.4, 1.3))
    scene = MeshScene(vertices, faces)
    spin = np.cross([0.1, 0.5, -0.3], scene.surface.vertices_m) + 0.2
    scene.velocities_m_s = spin
    law = ForceProfile(((-0.2, 0.0, 1.0, 0.0),))
    grid = Grid.over_box((-0.11,) * 3, (1.42,) * 3, (31,) * 3)
    bare = scene.field(0, grid, law).to_dense().astype(float)
    damped = scene.field(0, grid, ForceProfile(law.pieces, 2.0)).to_dense().astype(float)
    is_supported = bare.any(axis=-1).reshape(-1)
    points, push = all_points(grid)[is_supported], bare.reshape(-1, 3)[is_supported]
    feet = points.copy()
    depth = distance_to((vertices, faces), points)
    is_inside = depth > 1e-6
    union = union_of(scene.surface)
    assert union is not None and len(union.parents) > 4
    triangles_m = np.concatenate(
        [scene.surface.vertices_m[scene.surface.triangles[union.uncut]], union.corners_m]
    )
    reach = distance_to((triangles_m.reshape(-1, 3), np.arange(3 * len(triangles_m)).reshape(-1, 3)), points)
    feet = points + push * reach[:, None]
    moved = (damped - bare).reshape(-1, 3)[is_supported]
    np.testing.assert_allclose(
        moved[is_inside], 2 * (np.cross([0.1, 0.5, -0.3], feet) + 0.2)[is_inside], atol=1e-5
    )
