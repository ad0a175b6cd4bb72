"""Rigid parts of animated models: detected, fitted, returned as bodies, with the forces of the model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gltf_makers import CUBE, CUBE_FACES, Gltf, chain_rig, robot_rig
from touchfield.medium import Grid
from touchfield.network.opening import open_stream
from touchfield.pipeline.encoding import encode
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.animation.animated_mesh import AnimatedMeshScene
from touchfield.sources.animation.rigid_parts import separate_parts
from touchfield.sources.laws import ForceProfile
from touchfield.sources.physics.body_scene import BodyScene


def small_rig(path: Path, rigid: bool = True) -> AnimatedMeshScene:
    return AnimatedMeshScene(chain_rig(6, 1200, 20, rigid=rigid).save(path / "rig.gltf"))


def two_cubes_and_a_swelling(path: Path) -> AnimatedMeshScene:
    """Two cubes on one rotating node, a static one, and one that grows along y."""
    gltf = Gltf()
    mesh = gltf.mesh(CUBE, CUBE_FACES)
    both = gltf.mesh(
        np.concatenate([CUBE, CUBE + np.array([3, 0, 0])]), np.concatenate([CUBE_FACES, CUBE_FACES + 8])
    )
    turning = gltf.put("nodes", mesh=both)
    gltf.put("nodes", mesh=mesh, translation=[0, 5, 0])
    growing = gltf.put("nodes", mesh=mesh, translation=[0, -5, 0])
    gltf.animate(turning, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, 0.6, 0.8]])
    gltf.animate(growing, "scale", [0, 1], [[1, 1, 1], [1, 2, 1]])
    return AnimatedMeshScene(gltf.save(path / "cubes.gltf"), rate_hz=10)


def test_rigid_links_are_bodies_with_the_vertices_of_the_model(tmp_path: Path) -> None:
    scene = small_rig(tmp_path)
    bodies = scene.bodies()
    assert len(bodies) == 6 and scene.is_of_bodies and all(body.is_rigid for body in bodies)
    for frame in (0, 7, 19):
        vertices_m = np.concatenate(
            [body.track.to_scene(body.scene.surface.vertices_m, frame) for body in bodies]
        )  # type: ignore[attr-defined]
        np.testing.assert_allclose(
            vertices_m[np.lexsort(vertices_m.T.round(4))],
            scene.vertices_m(frame)[np.lexsort(scene.vertices_m(frame).T.round(4))],
            atol=3e-5,
        )


def test_the_bodies_have_the_forces_of_the_model(tmp_path: Path) -> None:
    scene = small_rig(tmp_path)
    law = ForceProfile(((-0.4, 0.0, 0.0, -3.0),))
    low, high = scene.bounds_m()
    grid = Grid.over_box(low - 0.2, high + 0.2, (41, 61, 23))
    composed = BodyScene(scene.bodies(), scene.rate_hz)
    for frame in (0, 13):
        of_model = scene.field(frame, grid, law).to_dense().astype(float)
        other = composed.field(frame, grid, law).to_dense().astype(float)
        assert np.abs(np.linalg.norm(of_model, axis=-1) - np.linalg.norm(other, axis=-1)).max() < 2e-3
        assert of_model.any(axis=-1).sum() > 300


def test_parts_are_grouped_by_motion_and_deforming_ones_stay_meshes(
    tmp_path: Path,
) -> None:
    scene = two_cubes_and_a_swelling(tmp_path)
    bodies = scene.bodies()
    assert len(bodies) == 3 and not scene.is_of_bodies
    assert sorted(len(b.scene.surface.triangles) for b in bodies[:2]) == [12, 24]  # type: ignore[attr-defined]
    assert [b.track.is_constant for b in bodies] == [False, True, True]
    shifted = scene.moved(np.eye(3), np.array([10.0, 0.0, 0.0])).bodies()
    np.testing.assert_allclose(
        [b.track.positions_m[3, 0] for b in shifted[:2]], [b.track.positions_m[3, 0] + 10 for b in bodies[:2]]
    )
    last = bodies[2]
    assert not last.is_rigid and last.scene.frame_count == scene.frame_count
    np.testing.assert_allclose(last.scene.bounds_m(), [[0, -5, 0], [1, -3.1, 1]], atol=1e-5)
    law = ForceProfile(((-0.3, 0.0, 1.0, 0.0),))
    grid = Grid.over_box((-1.01, -5.5, -0.5), (4.4, 6.5, 1.5), (37, 61, 19))
    of_model = scene.field(6, grid, law).to_dense().astype(float)
    other = BodyScene(bodies, scene.rate_hz).field(6, grid, law).to_dense().astype(float)
    assert (np.abs(of_model - other).max(axis=-1) > 1e-3).mean() < 1e-3 and of_model.any(axis=-1).sum() > 400


@pytest.mark.parametrize("rigid", [True, False])
def test_objects_are_selected_if_all_parts_are_rigid(tmp_path: Path, rigid: bool) -> None:
    prepared = prepare(small_rig(tmp_path, rigid), EncodeSpec(nw=4))
    assert (prepared.objects is not None) == rigid


def two_cubes(
    path: Path, side: float, shift: tuple[float, float, float], faces: int = 12
) -> AnimatedMeshScene:
    """The unit cube, which moves along x, and a cube at rest; `faces` triangles of each."""
    gltf = Gltf()
    first = gltf.put("nodes", mesh=gltf.mesh(CUBE, CUBE_FACES[:faces]))
    gltf.put("nodes", mesh=gltf.mesh(CUBE * side, CUBE_FACES[:faces]), translation=list(shift))
    gltf.animate(first, "translation", [0, 1], [[0, 0, 0], [0.1, 0, 0]])
    return AnimatedMeshScene(gltf.save(path / "a.gltf"), rate_hz=8, holes="leave")


def test_bodies_that_overlap_in_part_are_objects_and_a_note_states_the_part(tmp_path: Path) -> None:
    scene = two_cubes(tmp_path, 1.0, (0.5, 0.2, 0.3))
    prepared = prepare(scene, EncodeSpec(nw=4))
    assert scene.is_of_bodies and prepared.objects is not None and len(prepared.objects.objects) == 2
    # three rectangles of each cube are inside the other at most: at the last frame, moved by 7/80
    a, b, c = 1 - (0.5 - 7 / 80), 1 - 0.2, 1 - 0.3
    percent = f"up to {100 * 2 * (a * b + a * c + b * c) / 12:.2g} % of the surface is inside others"
    assert any(percent in note and "forces of objects add" in note for note in prepared.notes)
    voxels = prepare(scene, EncodeSpec(nw=4, representation="voxel"))
    assert voxels.objects is None and not any("overlap" in note for note in voxels.notes)


@pytest.mark.parametrize(
    ("side", "shift", "faces", "reason"),
    [(1.0, (0.01, 0.01, 0.01), 12, "45 % is the most"), (1.0, (0.5, 0.2, 0.3), 8, "it is open")],
    ids=["nearly the same place", "open"],
)
def test_bodies_that_overlap_too_much_are_a_union_of_voxels_and_a_note_states_why(
    tmp_path: Path, side: float, shift: tuple[float, float, float], faces: int, reason: str
) -> None:
    scene = two_cubes(tmp_path, side, shift, faces)
    prepared = prepare(scene, EncodeSpec(nw=4))
    assert len(scene.bodies()) == 2 and not scene.is_of_bodies and prepared.objects is None
    assert any(reason in note and "--representation object" in note for note in prepared.notes)


def test_a_body_of_overlapping_parts_is_one_object_without_a_note(tmp_path: Path) -> None:
    gltf = Gltf()
    cross = [CUBE * [3, 1, 1], CUBE * [1, 3, 1] + [1, -1, 0], CUBE * [1, 1, 3] + [1, 0, -1]]
    mesh = gltf.mesh(np.concatenate(cross), np.concatenate([CUBE_FACES + 8 * n for n in range(3)]))
    for n in range(2):
        node = gltf.put("nodes", mesh=mesh)
        gltf.animate(node, "translation", [0, 1], [[8 * n, 0, 0], [8 * n, n + 1, 0]])
    scene = AnimatedMeshScene(gltf.save(tmp_path / "a.gltf"), rate_hz=8)
    assert len(scene.bodies()) == 2 and scene.is_of_bodies and not scene.overlap_note


def test_a_body_that_deforms_has_no_note_on_overlap(tmp_path: Path) -> None:
    scene = two_cubes_and_a_swelling(tmp_path)
    assert scene.overlap_note == "" and small_rig(tmp_path).overlap_note == ""


def test_links_that_share_the_vertex_of_their_joint_are_bodies(tmp_path: Path) -> None:
    gltf = Gltf()
    ring = np.array([[1, 0.5, 0], [0, 0.5, 1], [-1, 0.5, 0], [0, 0.5, -1]]) * [0.2, 1, 0.2]
    link = np.concatenate([[[0, 0, 0], [0, 1, 0]], ring])  # a spindle from one joint to the next
    faces = np.array([[[0, 2 + i, 2 + (i + 1) % 4], [1, 2 + (i + 1) % 4, 2 + i]] for i in range(4)])
    mesh = gltf.mesh(link, faces.reshape(-1, 3))
    for joint in range(3):
        children = {"children": [joint + 1]} if joint < 2 else {}
        gltf.put("nodes", mesh=mesh, translation=[0, float(joint > 0), 0], **children)
        gltf.animate(joint, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, 0.3 * joint, 1]])
    gltf.put("scenes", nodes=[0])
    scene = AnimatedMeshScene(gltf.save(tmp_path / "a.gltf"), rate_hz=8)
    bodies = scene.bodies()
    assert len(bodies) == 3 and scene.is_of_bodies and all(body.is_rigid for body in bodies)
    assert [len(body.scene.surface.vertices_m) for body in bodies] == [6, 6, 6]  # type: ignore[attr-defined]
    assert not scene.overlap_note


def test_links_that_share_the_edge_of_their_hinge_are_bodies(tmp_path: Path) -> None:
    gltf = Gltf()
    mesh = gltf.mesh(CUBE, CUBE_FACES)
    for n in range(3):  # in a diagonal row: each turns about the edge that it shares with the one before
        children = {"children": [n + 1]} if n < 2 else {}
        gltf.put("nodes", mesh=mesh, translation=[float(n > 0), float(n > 0), 0], **children)
        gltf.animate(n, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, np.sin(0.1 * n), np.cos(0.1 * n)]])
    gltf.put("scenes", nodes=[0])
    scene = AnimatedMeshScene(gltf.save(tmp_path / "a.gltf"), rate_hz=8)
    assert scene.is_of_bodies and len(scene.bodies()) == 3
    corners = [body.scene.surface.vertices_m for body in scene.bodies()]  # type: ignore[attr-defined]
    assert [len(own) for own in corners] == [8, 8, 8]
    assert not scene.overlap_note


def test_links_that_share_a_face_stay_one_part() -> None:
    # at the four edges of the face, it is not defined which triangles belong together
    positions = np.concatenate([CUBE, CUBE + np.array([1, 0, 0])])
    _, ids = np.unique(positions, axis=0, return_inverse=True)
    triangles = ids.reshape(-1)[np.concatenate([CUBE_FACES, CUBE_FACES + 8])].astype(np.int32)
    kept, faces = separate_parts(np.arange(12), triangles)
    assert np.array_equal(kept, np.arange(12)) and np.array_equal(faces, triangles)


def test_a_robot_is_encoded_as_links_within_the_error_bound(tmp_path: Path) -> None:
    path = robot_rig(legs=3, links=2, triangles=900, frames=12).save(tmp_path / "robot.glb", "glb")
    objects = encode(path, tmp_path / "objects.touch", EncodeSpec(nw=5))
    voxels = encode(path, tmp_path / "voxels.touch", EncodeSpec(nw=5, representation="voxel"))
    assert objects.summary()["objects"] == 7 and "objects" not in voxels.summary()
    assert objects.bound["promise_kept"] and 0 < objects.bound["worst_mask_ratio"] <= 1
    with open_stream(tmp_path / "objects.touch") as stream:
        counts = [stream.medium[frame].support_count for frame in (0, 5, 11)]
    assert min(counts) > 100
