"""Closed meshes that overlap: the field is that of their union, with no force to or from a wall inside."""

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
    one = trimesh.creation.icosphere(subdivisions=4)
    vertices, faces = together(
        (np.asarray(one.vertices), np.asarray(one.faces)),
        (np.asarray(one.vertices) + np.array([0.9, 0.1, 0.2]), np.asarray(one.faces)),
    )
    grid = Grid.over_box((-1.1, -1.1, -1.1), (2.0, 1.2, 1.3), (37, 31, 32))
    field = MeshScene(vertices, faces).field(0, grid, SOLID)
    points, forces = grid.to_m(field.positions()), field.vectors_n().astype(float)
    # the surface of the union: two caps, and the circle where they meet
    apart = np.array([0.9, 0.1, 0.2])
    axis = apart / np.linalg.norm(apart)
    middle, radius = apart / 2, math.sqrt(1 - apart @ apart / 4)
    from_axis = points - middle - ((points - middle) @ axis)[:, None] * axis
    rise = np.linalg.norm(from_axis, axis=1)
    depth = np.hypot((points - middle) @ axis, rise - radius)
    for centre, side in ((np.zeros(3), -1), (apart, 1)):
        off = points - centre
        length = np.linalg.norm(off, axis=1)
        foot = centre + off / np.maximum(length, 1e-9)[:, None]
        is_cap = side * ((foot - middle) @ axis) > 0
        depth = np.where(is_cap, np.minimum(depth, np.abs(1 - length)), depth)
    np.testing.assert_allclose(np.linalg.norm(forces, axis=1), depth, atol=0.006)
    assert np.linalg.norm(forces, axis=1).max() > 0.85  # the depth of the ring in the middle


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(
    ("parts", "outline"),
    [
        # two boxes that make one longer box: overlapping, touching, and one within the other
        (((0, 0, 0), (1, 1, 1), (0.4, 0, 0), (2, 1, 1)), ((0, 0, 0), (2, 1, 1))),
        (((0, 0, 0), (1, 1, 1), (1, 0, 0), (2, 1, 1)), ((0, 0, 0), (2, 1, 1))),
        (((0, 0, 0), (2, 1, 1), (0.3, 0.2, 0.1), (0.9, 0.6, 0.8)), ((0, 0, 0), (2, 1, 1))),
        (((0, 0, 0), (2, 1, 1), (0, 0, 0), (2, 1, 1)), ((0, 0, 0), (2, 1, 1))),
    ],
)
def test_boxes_that_overlap_are_the_box_they_make(parts: tuple, outline: tuple, turned: bool) -> None:
    turn = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix() if turned else np.eye(3)
    vertices, faces = together(cuboid(*parts[:2]), cuboid(*parts[2:]))
    whole = cuboid(*outline)
    grid = Grid.over_box((-1.03, -1.02, -1.01), (2.2, 2.1, 2.0), (39, 38, 37))
    one = MeshScene(vertices @ turn.T, faces).field(0, grid, SOLID).to_dense()
    other = MeshScene(whole[0] @ turn.T, whole[1]).field(0, grid, SOLID).to_dense()
    depth, true = np.linalg.norm(one, axis=-1), np.linalg.norm(other, axis=-1)
    np.testing.assert_allclose(depth, true, atol=2e-6)
    assert (true > 0).sum() > 500
    differs = np.linalg.norm(one - other, axis=-1) > 1e-5
    assert differs.mean() < 0.02  # where two faces are as near, either may push


def test_no_force_leads_to_a_wall_inside() -> None:
    """Three boxes that cross, turned as they like: every force leads out of all of them."""
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
    for own, own_faces in parts:
        a, b, c = (own[own_faces[:, i]] for i in range(3))
        normals = np.cross(b - a, c - a)
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        inside |= ((feet[:, None] - a) * normals).sum(axis=2).max(axis=1) < -1e-5
    assert len(points) > 3000 and not inside.any()
    # and none is nearer: the depth is the distance to the parts of all faces that lie in no other box
    union = union_of(Surface(vertices, faces, "boxes"))
    assert union is not None
    kept = np.concatenate(
        [vertices[Surface(vertices, faces, "boxes").triangles[union.uncut]], union.corners_m]
    )
    felt = kept.reshape(-1, 3), np.arange(3 * len(kept)).reshape(-1, 3)
    np.testing.assert_allclose(np.linalg.norm(forces, axis=1), distance_to(felt, points), atol=1e-5)


def test_what_does_not_overlap_is_left_as_it_is() -> None:
    sphere = trimesh.creation.icosphere(subdivisions=3)
    assert union_of(Surface(sphere.vertices, sphere.faces, "one")) is None
    apart = together(cube(), cube(2.0, 3.0))
    assert union_of(Surface(*apart, "two")) is None
    hollow = together(cube(), inverted(cube(0.2, 0.8)))
    assert union_of(Surface(*hollow, "hollow")) is None
    points, phi, _ = measured(MeshScene(*hollow), Grid.over_box((-0.2,) * 3, (1.2,) * 3, (29,) * 3), 0.15)
    np.testing.assert_allclose(np.abs(phi), distance_to(hollow, points), atol=1e-6)


def test_the_damping_of_pieces_is_that_of_the_triangles_they_are_cut_from() -> None:
    vertices, faces = together(cube(), cube(0.4, 1.3))
    scene = MeshScene(vertices, faces)
    spin = np.cross([0.1, 0.5, -0.3], scene.surface.vertices_m) + 0.2
    scene.velocities_m_s = spin
    law = ForceProfile(((-0.2, 0.0, 1.0, 0.0),))
    grid = Grid.over_box((-0.11,) * 3, (1.42,) * 3, (31,) * 3)
    bare = scene.field(0, grid, law).to_dense().astype(float)
    damped = scene.field(0, grid, ForceProfile(law.pieces, 2.0)).to_dense().astype(float)
    is_felt = bare.any(axis=-1).reshape(-1)
    points, push = all_points(grid)[is_felt], bare.reshape(-1, 3)[is_felt]
    feet = points.copy()
    depth = distance_to((vertices, faces), points)
    near = depth > 1e-6
    union = union_of(scene.surface)
    assert union is not None and len(union.parents) > 4
    kept = np.concatenate([scene.surface.vertices_m[scene.surface.triangles[union.uncut]], union.corners_m])
    reach = distance_to((kept.reshape(-1, 3), np.arange(3 * len(kept)).reshape(-1, 3)), points)
    feet = points + push * reach[:, None]
    moved = (damped - bare).reshape(-1, 3)[is_felt]
    np.testing.assert_allclose(moved[near], 2 * (np.cross([0.1, 0.5, -0.3], feet) + 0.2)[near], atol=1e-5)
