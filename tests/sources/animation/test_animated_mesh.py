"""Animated models as scenes: frames, welding in motion, fields and the damping of a moving surface."""

from __future__ import annotations

import json
import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation, Slerp

from gltf_makers import CUBE, CUBE_FACES, Gltf, everything, moving_cube
from touchfield.errors import InvalidArgument, SourceError
from touchfield.medium import ForceField, Grid
from touchfield.sources.animation.animated_mesh import AnimatedMeshScene
from touchfield.sources.laws import ForceProfile
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.mesh.surface import Surface, close_holes
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source


def law(band_m: float, damping: float = 0.0, low_m: float | None = None) -> ForceProfile:
    """Nowhere zero in the band; its amplitude encodes the distance."""
    return ForceProfile(((-band_m if low_m is None else low_m, band_m, 4.0, 1 / band_m),), damping)


def grid_around(scene: AnimatedMeshScene, count: int = 20, margin: float = 0.3) -> Grid:
    low, high = scene.bounds_m()
    side = margin * max(float((high - low).max()), 0.1)
    return Grid.over_box(low - side, high + side, (count, count + 1, count + 2))


def dense(field: ForceField) -> np.ndarray:
    return field.to_dense().astype(float)


def spinning(vertices: Any, faces: Any, times: Any = (0, 1), degrees: Any = (0, 90)) -> Gltf:
    """A mesh that rotates about z."""
    gltf = Gltf()
    node = gltf.put("nodes", mesh=gltf.mesh(vertices, faces))
    gltf.animate(
        node, "rotation", times, [Rotation.from_euler("z", d, degrees=True).as_quat() for d in degrees]
    )
    return gltf


# -- opening -----------------------------------------------------------------------------------------------


def test_a_file_with_an_animation_is_an_animated_mesh_and_others_are_meshes(tmp_path: Path) -> None:
    gltf = everything()
    scene = open_source(gltf.save(tmp_path / "a.glb", "glb"))
    assert isinstance(scene, AnimatedMeshScene) and scene.rate_hz == 60
    assert isinstance(open_source(tmp_path / "a.glb", SourceOptions(kind="mesh")), MeshScene)
    del gltf.json["animations"]
    assert isinstance(open_source(gltf.save(tmp_path / "b.glb", "glb")), MeshScene)


def test_error_of_a_damaged_document_states_the_fault(tmp_path: Path) -> None:
    intact = everything().save(tmp_path / "a.glb", "glb").read_bytes()
    text = everything().save(tmp_path / "a.gltf").read_bytes()
    for name, data, message in (("b.gltf", text[:-9], "no JSON"), ("b.glb", intact[:-9], "header declares")):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(SourceError, match=message):
            open_source(tmp_path / name)


def test_animations_of_one_name_are_listed_with_their_numbers(tmp_path: Path) -> None:
    gltf = everything()
    for animation in gltf.json["animations"]:
        animation["name"] = "walk"
    scene = open_source(gltf.save(tmp_path / "a.gltf"), SourceOptions(animation="1"))
    assert any("'walk' (number 1):" in note and "also 'walk' (number 0)" in note for note in scene.notes)
    first = open_source(tmp_path / "a.gltf", SourceOptions(animation="walk"))
    assert any("'walk' (number 0):" in note for note in first.notes)


def test_options_select_animation_rate_and_unit(tmp_path: Path) -> None:
    path = everything().save(tmp_path / "a.gltf")
    first, second = (open_source(path, SourceOptions(animation=name)) for name in ("move 0", "1"))
    assert "'move 0': 0.1 s, 6 frames; there are also 'move 1'" in " ".join(first.notes)
    assert "'move 1': 0.1 s" in " ".join(second.notes)
    scene = open_source(path, SourceOptions(unit_m=0.01, rate_hz=200))
    assert scene.frame_count == 20 and scene.rate_hz == 200
    assert isinstance(scene, AnimatedMeshScene) and isinstance(first, AnimatedMeshScene)
    np.testing.assert_allclose(scene.vertices_m(10), 0.01 * first.vertices_m(3), atol=1e-12)
    with pytest.raises(InvalidArgument, match="rate_hz"):
        AnimatedMeshScene(path, rate_hz=0)


@pytest.mark.parametrize(
    ("duration_s", "rate_hz", "count"),
    [
        (1, 60, 60),
        (0.7, 10, 7),
        (17 / 24, 60, 43),
        (1 / 3, 30, 10),
        (0.001, 60, 1),
        (0, 60, 1),
        (83 / 24, 24, 83),
    ],
)
def test_the_frames_are_the_times_before_the_end(
    duration_s: float, rate_hz: float, count: int, tmp_path: Path
) -> None:
    times, values = ([0, duration_s], [[0, 0, 0], [1, 0, 0]]) if duration_s else ([0], [[0, 0, 0]])
    path = moving_cube(values, times).save(tmp_path / "a.gltf")
    scene = AnimatedMeshScene(str(path), rate_hz=rate_hz)
    assert scene.frame_count == count
    for frame in range(count):
        fraction = frame / rate_hz / duration_s if duration_s else 0
        assert scene.vertices_m(frame)[:, 0].min() == pytest.approx(fraction, abs=1e-6)
    with pytest.raises(InvalidArgument, match=f"0 to {count - 1}"):
        scene.vertices_m(count)


def test_frames_can_be_computed_in_any_order(tmp_path: Path) -> None:
    gltf = moving_cube(np.random.default_rng(1).normal(size=(9, 3)), np.arange(9))
    path = gltf.save(tmp_path / "a.gltf")
    scene, again = AnimatedMeshScene(path), AnimatedMeshScene(path)
    forwards = [scene.vertices_m(i) for i in range(scene.frame_count)]
    for frame in np.random.default_rng(2).permutation(scene.frame_count)[:60].tolist():
        np.testing.assert_array_equal(again.vertices_m(frame), forwards[frame])
    low, high = scene.bounds_m()
    np.testing.assert_array_equal(low, np.min(forwards, axis=(0, 1)))
    np.testing.assert_array_equal(high, np.max(forwards, axis=(0, 1)))


# -- welded vertices ---------------------------------------------------------------------------------------


def test_corners_without_indices_are_joined_and_close(tmp_path: Path) -> None:
    scene = AnimatedMeshScene(moving_cube().save(tmp_path / "a.gltf"))
    assert scene.is_closed and scene.vertices_m(0).shape == (8, 3)


def test_parts_that_touch_only_at_rest_are_not_welded(tmp_path: Path) -> None:
    gltf = Gltf()
    nodes = [gltf.put("nodes", mesh=gltf.mesh(CUBE + np.array([i, 0, 0]), CUBE_FACES)) for i in range(2)]
    gltf.animate(nodes[1], "translation", [0, 1], [[0, 0, 0], [2, 0, 0]])
    scene = AnimatedMeshScene(gltf.save(tmp_path / "a.gltf"))
    assert scene.is_closed and scene.vertices_m(0).shape == (16, 3)
    gap = scene.vertices_m(30)[:, 0]
    assert not ((gap > 1.01) & (gap < 1.99)).any()


def test_a_mesh_in_pieces_that_move_together_closes(tmp_path: Path) -> None:
    gltf = Gltf()
    parts = [gltf.put("nodes", mesh=gltf.mesh(CUBE, CUBE_FACES[i::2])) for i in range(2)]
    root = gltf.put("nodes", children=parts)
    gltf.animate(root, "rotation", [0, 1], [[0, 0, 0, 1], [0.6, 0, 0, 0.8]])
    scene = AnimatedMeshScene(gltf.save(tmp_path / "a.gltf"))
    assert scene.is_closed and scene.vertices_m(0).shape == (8, 3)


def test_a_seam_of_slightly_other_weights_closes_but_a_tear_does_not(tmp_path: Path) -> None:
    for change, is_closed in ((1e-4, True), (0.2, False)):
        gltf = Gltf()
        corners = CUBE[CUBE_FACES.reshape(-1)]
        weight = 0.5 + change * np.random.default_rng(0).random(36)
        sets = {
            "JOINTS_0": gltf.array([[0, 1, 0, 0]] * 36, "u1"),
            "WEIGHTS_0": gltf.array(np.stack([weight, 1 - weight, 0 * weight, 0 * weight], axis=1)),
        }
        joints = [gltf.put("nodes"), gltf.put("nodes")]
        gltf.put("nodes", mesh=gltf.mesh(corners, **sets), skin=gltf.put("skins", joints=joints))
        gltf.animate(1, "translation", [0, 1], [[0, 0, 0], [0, 1, 0]])
        assert AnimatedMeshScene(gltf.save(tmp_path / "a.gltf")).is_closed == is_closed


def test_a_shape_that_is_a_point_at_rest_is_welded_by_its_motion(tmp_path: Path) -> None:
    gltf = Gltf()
    node = gltf.put("nodes", mesh=gltf.mesh(CUBE[CUBE_FACES.reshape(-1)]), scale=[0, 0, 0])
    gltf.animate(node, "scale", [0, 1], [[0, 0, 0], [1, 1, 1]])
    scene = AnimatedMeshScene(gltf.save(tmp_path / "a.gltf"))
    assert scene.is_closed and scene.vertices_m(0).shape == (8, 3)
    grid = grid_around(scene)
    for frame in (0, 1, scene.frame_count - 1):
        assert np.isfinite(scene.field(frame, grid, law(0.2, 1.0)).forces_n).all()
    solid = scene.field(scene.frame_count - 1, grid, law(0.1, low_m=-math.inf))
    inside = (np.abs(grid.to_m(solid.positions()) - 0.49) < 0.45).all(axis=1)
    assert inside.any()


# -- fields ------------------------------------------------------------------------------------------------


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_replaced_vertices_give_the_surface_of_those_vertices(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = trimesh.creation.icosphere(subdivisions=1)
    rotated = (
        np.asarray(mesh.vertices) * rng.uniform(0.3, 2, 3) + rng.normal(size=(len(mesh.vertices), 3)) * 0.05
    )
    first = Surface(mesh.vertices, mesh.faces, "mesh")
    reused, fresh = first.with_vertices(rotated), Surface(rotated, mesh.faces, "mesh")
    np.testing.assert_array_equal(reused.triangles, fresh.triangles)
    np.testing.assert_array_equal(reused.bounds_m, fresh.bounds_m)
    np.testing.assert_allclose(reused.pseudo_normals(), fresh.pseudo_normals(), atol=1e-12)
    grid = Grid.over_box(rotated.min(0) - 0.2, rotated.max(0) + 0.2, (12, 13, 14))
    fields = [MeshScene(close_holes(s, "leave")).field(0, grid, law(0.3)) for s in (reused, fresh)]
    np.testing.assert_allclose(dense(fields[0]), dense(fields[1]), atol=1e-6)


def test_other_vertices_are_checked() -> None:
    surface = Surface(CUBE, CUBE_FACES, "mesh")
    with pytest.raises(SourceError, match="shape"):
        surface.with_vertices(CUBE[:7])
    with pytest.raises(SourceError, match="NaN"):
        surface.with_vertices(CUBE * np.nan)


def test_the_field_of_a_frame_is_that_of_the_posed_mesh(tmp_path: Path) -> None:
    scene = AnimatedMeshScene(spinning(CUBE, CUBE_FACES).save(tmp_path / "a.gltf"))
    grid = grid_around(scene)
    for frame in (0, 17, 59):
        posed = Rotation.from_euler("z", 90 * frame / 60, degrees=True).apply(CUBE)
        expected = MeshScene(posed, CUBE_FACES).field(0, grid, law(0.2))
        np.testing.assert_allclose(dense(scene.field(frame, grid, law(0.2))), dense(expected), atol=1e-5)


@pytest.mark.parametrize("damping", [0.0, 3.0])
def test_fields_in_order_are_those_of_frames_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damping: float
) -> None:
    """In order, a thread makes each surface ahead; alone, none does."""
    monkeypatch.setenv("TOUCHFIELD_THREADS", "2")
    path = spinning(CUBE, CUBE_FACES).save(tmp_path / "a.gltf")
    scene = AnimatedMeshScene(path, rate_hz=12)
    grid = grid_around(scene)
    in_order = [scene.field(frame, grid, law(0.2, damping)) for frame in range(scene.frame_count)]
    for frame in (11, 3, 3, 0):
        alone = AnimatedMeshScene(path, rate_hz=12).field(frame, grid, law(0.2, damping))
        again = scene.field(frame, grid, law(0.2, damping))
        for field in (alone, again):
            np.testing.assert_array_equal(field.bricks, in_order[frame].bricks)
            np.testing.assert_array_equal(field.forces_n, in_order[frame].forces_n)


def test_a_frame_that_overflows_is_reported_when_its_field_is_requested(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", "2")
    values, times = [[0, 0, 0], [1e30, 0, 0], [0, 0, 0], [0, 0, 0]], [0, 0.09, 0.11, 1]
    scene = AnimatedMeshScene(moving_cube(values, times, "STEP").save(tmp_path / "a.gltf"))
    grid = Grid.over_box(np.full(3, -0.5), np.full(3, 1.5), (12, 12, 12))
    before = [dense(scene.field(frame, grid, law(0.2))) for frame in (4, 5)]
    with pytest.raises(SourceError, match=r"NaN or infinite at 0\.1 s"):
        scene.field(6, grid, law(0.2))
    for field in (*before, dense(scene.field(7, grid, law(0.2)))):
        np.testing.assert_array_equal(field, before[0])


def test_a_moved_scene_has_the_field_of_its_new_position(tmp_path: Path) -> None:
    """Also for the frame whose surface was computed last, before the move."""
    scene = AnimatedMeshScene(spinning(CUBE, CUBE_FACES).save(tmp_path / "a.gltf"))
    scene.field(17, grid_around(scene), law(0.2))
    moved = scene.moved(np.eye(3), np.array([0.4, -0.3, 0.2]))
    vertices_m = Rotation.from_euler("z", 90 * 17 / 60, degrees=True).apply(CUBE)
    vertices_m = vertices_m + np.array([0.4, -0.3, 0.2])
    grid = grid_around(moved)
    expected = MeshScene(vertices_m, CUBE_FACES).field(0, grid, law(0.2))
    np.testing.assert_allclose(dense(moved.field(17, grid, law(0.2))), dense(expected), atol=1e-5)


def test_a_moved_scene_moves_along(tmp_path: Path) -> None:
    scene = AnimatedMeshScene(spinning(CUBE, CUBE_FACES).save(tmp_path / "a.gltf"))
    turn, shift = Rotation.from_euler("xyz", [0.3, 1.0, -0.4]).as_matrix(), np.array([3.0, -1.0, 2.0])
    moved = scene.moved(turn, shift).moved(turn.T, np.zeros(3))
    np.testing.assert_allclose(moved.vertices_m(20), scene.vertices_m(20) + turn.T @ shift, atol=1e-12)
    once = scene.moved(turn, shift)
    np.testing.assert_allclose(once.vertices_m(20), scene.vertices_m(20) @ turn.T + shift, atol=1e-12)
    np.testing.assert_allclose(once.velocities_m_s(20), scene.velocities_m_s(20) @ turn.T, atol=1e-9)
    np.testing.assert_allclose(moved.bounds_m(), scene.bounds_m() + turn.T @ shift, atol=1e-12)
    with pytest.raises(InvalidArgument, match="rotation"):
        scene.moved(2 * turn, shift)


# -- motion ------------------------------------------------------------------------------------------------


def test_a_translating_mesh_adds_its_damping_where_there_is_a_force(tmp_path: Path) -> None:
    scene = AnimatedMeshScene(moving_cube().save(tmp_path / "a.gltf"))
    velocity, b = np.array([4.0, 2.0, -6.0]), 0.7
    grid = grid_around(scene, 24, 0.1)
    for frame in (0, 30, 59):
        np.testing.assert_allclose(scene.velocities_m_s(frame), np.tile(velocity, (8, 1)), atol=1e-9)
        undamped = dense(scene.field(frame, grid, law(0.3)))
        moving = dense(scene.field(frame, grid, law(0.3, b)))
        is_supported = undamped.any(axis=-1)
        assert is_supported.sum() > 200
        np.testing.assert_allclose(moving[is_supported], undamped[is_supported] + b * velocity, atol=4e-6)
        assert not moving[~is_supported].any()


def test_a_spinning_mesh_adds_the_velocity_of_its_nearest_point(tmp_path: Path) -> None:
    sphere = trimesh.creation.icosphere(subdivisions=2)
    scene = AnimatedMeshScene(spinning(sphere.vertices, sphere.faces).save(tmp_path / "a.gltf"))
    speed, half = math.pi / 2, 0.5 / 60
    factor = math.sin(speed * half) / half  # a chord of the circle over its time
    vertices_m = scene.vertices_m(25)
    spin = np.array([[0, -factor, 0], [factor, 0, 0], [0, 0, 0]])
    np.testing.assert_allclose(scene.velocities_m_s(25), vertices_m @ spin.T, atol=1e-6)
    band, b = 0.25, 2.0
    grid = grid_around(scene, 22)
    undamped, moving = (scene.field(25, grid, law(band, damping)) for damping in (0.0, b))
    forces = undamped.vectors_n().astype(float)
    phi = (np.linalg.norm(forces, axis=1) - 4) * band
    nearest = (
        grid.to_m(undamped.positions()) - phi[:, None] * forces / np.linalg.norm(forces, axis=1)[:, None]
    )
    added = (dense(moving) - dense(undamped))[tuple(np.array(undamped.positions()).T)]
    np.testing.assert_allclose(added, b * nearest @ spin.T, atol=2e-5)


def test_velocities_at_the_ends_of_an_animation_are_one_sided(tmp_path: Path) -> None:
    step = AnimatedMeshScene(
        moving_cube([[0, 0, 0], [3, 0, 0], [3, 0, 0]], [0, 0.5, 1]).save(tmp_path / "a.gltf")
    )
    for frame, expected in ((0, 6.0), (29, 6.0), (30, 3.0), (31, 0.0), (59, 0.0)):
        np.testing.assert_allclose(step.velocities_m_s(frame)[:, 0], expected, atol=1e-9)
    odd = AnimatedMeshScene(
        moving_cube([[0, 0, 0], [3, 0, 0]], [0, 1]).save(tmp_path / "c.gltf"), rate_hz=5.3
    )
    np.testing.assert_allclose(odd.velocities_m_s(5)[:, 0], 3.0, atol=1e-9)  # it ends half a frame later
    static = AnimatedMeshScene(moving_cube([[0, 0, 0]], [0]).save(tmp_path / "b.gltf"))
    np.testing.assert_array_equal(static.velocities_m_s(0), np.zeros((8, 3)))


# -- real models -------------------------------------------------------------------------------------------


def fox_by_hand(path: Path, animation: int, time_s: float) -> np.ndarray:
    """Each corner and joint with SciPy's rotations: an independent way to the same numbers."""
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    document, binary = json.loads(data[20 : 20 + length]), data[28 + length :]

    def read(number: int) -> np.ndarray:
        accessor = document["accessors"][number]
        view = document["bufferViews"][accessor["bufferView"]]
        offset = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor["type"]]
        dtype = {5126: "<f4", 5123: "<u2"}[accessor["componentType"]]
        return (
            np.frombuffer(binary, dtype, accessor["count"] * width, offset).reshape(-1, width).astype(float)
        )

    nodes = [dict(node) for node in document["nodes"]]
    for channel in document["animations"][animation]["channels"]:
        sampler = document["animations"][animation]["samplers"][channel["sampler"]]
        times, values = read(sampler["input"])[:, 0], read(sampler["output"])
        node, at = nodes[channel["target"]["node"]], min(max(time_s, times[0]), times[-1])
        if channel["target"]["path"] == "rotation":
            node["rotation"] = Slerp(times, Rotation.from_quat(values))(at).as_quat()
        else:
            node[channel["target"]["path"]] = [np.interp(at, times, column) for column in values.T]

    def world(number: int) -> np.ndarray:
        node, local = nodes[number], np.eye(4)
        local[:3, :3] = Rotation.from_quat(node.get("rotation", [0, 0, 0, 1])).as_matrix() * node.get(
            "scale", 1.0
        )
        local[:3, 3] = node.get("translation", [0, 0, 0])
        parents = [i for i, other in enumerate(nodes) if number in other.get("children", [])]
        return world(parents[0]) @ local if parents else local

    skin = document["skins"][0]
    binds = read(skin["inverseBindMatrices"]).reshape(-1, 4, 4)
    joints = [world(node) @ binds[i].T for i, node in enumerate(skin["joints"])]
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    corners, joint_ids, weights = (read(attributes[name]) for name in ("POSITION", "JOINTS_0", "WEIGHTS_0"))
    return np.array(
        [
            sum(w * (joints[int(j)] @ [*corner, 1.0])[:3] for j, w in zip(js, ws) if w) / sum(ws)
            for corner, js, ws in zip(corners, joint_ids, weights)
        ]
    )


@pytest.mark.shared
@pytest.mark.parametrize(("name", "number"), [("Survey", 0), ("Walk", 1), ("Run", 2)])
def test_the_fox_equals_an_independent_computation(name: str, number: int, shared_data: Path) -> None:
    path = shared_data / "meshes" / "fox" / "Fox.glb"
    scene = AnimatedMeshScene(path, name, unit_m=0.01)
    assert scene.is_closed and scene.vertices_m(0).shape == (290, 3)
    frame = scene.frame_count // 3
    corners = fox_by_hand(path, number, frame / 60) * 0.01
    found = scene.vertices_m(frame)
    distances = np.linalg.norm(corners[:, None] - found[None], axis=2)
    assert distances.min(axis=1).max() < 1e-6 and distances.min(axis=0).max() < 1e-6
    surface = scene.surface(frame)
    middles = np.sort(corners.reshape(-1, 3, 3).mean(axis=1).sum(axis=1))
    np.testing.assert_allclose(np.sort(found[surface.triangles].mean(axis=1).sum(axis=1)), middles, atol=1e-6)
    low, high = scene.bounds_m()
    assert (found >= low).all() and (found <= high).all()


@pytest.mark.shared
def test_the_running_fox_has_a_closed_field_in_every_frame(shared_data: Path) -> None:
    scene = AnimatedMeshScene(shared_data / "meshes" / "fox" / "Fox.glb", "Run", unit_m=0.01)
    grid = grid_around(scene, 32, 0.05)
    supports = []
    for frame in range(0, scene.frame_count, 9):
        field = scene.field(frame, grid, law(0.05, 1.0, low_m=-math.inf))
        supports.append(len(field.positions()))
        assert np.isfinite(field.forces_n).all()
    assert min(supports) > 0.6 * max(supports)  # the same fox in each frame


@pytest.mark.shared
def test_the_morphed_bars_follow_their_weights(shared_data: Path) -> None:
    path = shared_data / "meshes" / "morph_stress_test" / "MorphStressTest.gltf"
    scene = AnimatedMeshScene(path, "Individuals")
    assert scene.is_closed and scene.frame_count == 560
    # target i raises bar i; the animation raises the bars in turn
    heights = np.array([scene.vertices_m(frame)[:, 1].max() for frame in range(0, 560, 10)])
    highest = [scene.vertices_m(f)[scene.vertices_m(f)[:, 1].argmax(), 0] for f in range(35, 560, 70)]
    assert heights.max() > 1.3 and heights.min() < 0.75
    assert (np.diff(highest) > 0.3).all()


# -- an animated scale that mirrors ------------------------------------------------------------------------
def mirrored_sheet(path: Path, how: str) -> Path:
    """An open sheet that faces +z; its scale in x becomes -1 at 1 s of 2."""
    gltf = Gltf()
    corners = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    node = gltf.put("nodes", mesh=gltf.mesh(corners, [[0, 1, 2], [0, 2, 3]]))
    gltf.animate(node, "scale", [0, 1, 2], [[1, 1, 1], [-1, 1, 1], [-1, 1, 1]], how)
    return gltf.save(path)


@pytest.mark.parametrize("how", ["STEP", "LINEAR"])
def test_a_sheet_that_a_scale_mirrors_faces_as_a_static_scale_has_it(tmp_path: Path, how: str) -> None:
    scene = AnimatedMeshScene(mirrored_sheet(tmp_path / "a.gltf", how))
    wall = ForceProfile(((-0.1, 0.0, 4.0, 10.0),))
    grid = Grid((1, 1, 5), (0.02, 0.02, 0.02), (0.1, 0.2, -0.04))
    for frame in (0, 20, 80, 119):
        forces = scene.field(frame, grid, wall).to_dense()[0, 0, :, 2]
        assert (forces[:2] > 0).all() and not forces[3:].any(), frame
    assert not scene.is_of_bodies  # a mirror is no motion, although a flat sheet could turn instead


def test_a_sheet_that_is_mirrored_throughout_is_one_body(tmp_path: Path) -> None:
    gltf = Gltf()
    corners = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    node = gltf.put("nodes", mesh=gltf.mesh(corners, [[0, 1, 2], [0, 2, 3]]))
    gltf.animate(node, "scale", [0, 1], [[-1, 1, 1], [-1, 1, 1]])
    scene = AnimatedMeshScene(gltf.save(tmp_path / "a.gltf"))
    (body,) = scene.bodies()
    assert scene.is_of_bodies and isinstance(body.scene, MeshScene)
    wall = ForceProfile(((-0.1, 0.0, 4.0, 10.0),))
    grid = Grid((1, 1, 5), (0.02, 0.02, 0.02), (0.1, 0.2, -0.04))
    for shown in (scene, body.scene):
        forces = shown.field(0, grid, wall).to_dense()[0, 0, :, 2]
        assert (forces[:2] > 0).all() and not forces[3:].any()


Z_TURN = [0, 0, 2**-0.5, 2**-0.5]


@pytest.mark.parametrize(
    ("outer", "inner", "moving", "scales"),
    [
        ({}, {"scale": [-1, 1, 1]}, "outer", [[1, 1, 1], [-1, 1, 1]]),
        ({"matrix": [-1, *[0] * 4, 1, *[0] * 4, 1, *[0] * 4, 1]}, {}, "inner", [[1, 1, 1], [-1, 1, 1]]),
        ({"rotation": Z_TURN, "scale": [1, -2, 1]}, {}, "inner", [[1, 1, 1], [0, 2, 1], [-1, 1.5, 1]]),
        ({"scale": [1, 1, -1]}, {"rotation": Z_TURN}, "inner", [[0, 1, 1], [1, 1, 1], [1, -0.5, 1]]),
        ({}, {}, "both", [[1, 1, 1], [0, 0, 0], [-1, 1, 1]]),
    ],
)
def test_a_sheet_in_mirrored_nodes_faces_as_a_static_pose_has_it(
    tmp_path: Path, outer: dict[str, Any], inner: dict[str, Any], moving: str, scales: list[list[float]]
) -> None:
    """Each frame has the wall on the side where a file without animation has it in that pose."""
    wall = ForceProfile(((-0.1, 0.0, 4.0, 10.0),))
    grid = Grid((3, 3, 5), (0.02, 0.02, 0.02), (0.0, 0.0, -0.04))

    def document(outer: dict[str, Any], inner: dict[str, Any]) -> Gltf:
        gltf = Gltf()
        corners = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
        sheet = gltf.put("nodes", mesh=gltf.mesh(corners, [[0, 1, 2], [0, 2, 3]]), **inner)
        gltf.put("scenes", nodes=[gltf.put("nodes", children=[sheet], **outer)])
        return gltf

    gltf, times = document(outer, inner), np.linspace(0, 2, len(scales))
    for node, name in enumerate(("inner", "outer")):
        if moving in (name, "both"):
            gltf.animate(node, "scale", times, scales)
    scene = AnimatedMeshScene(gltf.save(tmp_path / "a.gltf"))
    for frame in (3, 30, 59, 61, 90, 119):
        scale = [float(np.interp(frame / 60, times, values)) for values in np.transpose(scales)]
        pose = {name: {"scale": scale} if moving in (name, "both") else {} for name in ("outer", "inner")}
        still = document({**outer, **pose["outer"]}, {**inner, **pose["inner"]}).save(tmp_path / "b.gltf")
        expected = open_source(still).field(0, grid, wall).to_dense()
        assert expected.any(), frame
        np.testing.assert_allclose(scene.field(frame, grid, wall).to_dense(), expected, atol=1e-3)


def test_a_cube_that_a_scale_turns_inside_out_stays_a_solid(tmp_path: Path) -> None:
    gltf = Gltf()
    node = gltf.put("nodes", mesh=gltf.mesh(CUBE - 0.5, CUBE_FACES))
    gltf.animate(node, "scale", [0, 1, 2], [[1, 1, 1], [0, 1, 1], [-1, 1, 1]])
    scene = AnimatedMeshScene(gltf.save(tmp_path / "a.gltf"))
    grid, solid = Grid((11, 3, 3), (0.1, 0.1, 0.1), (-0.5, -0.1, -0.1)), ForceProfile(((-0.5, 0, 4.0, 1.0),))
    for frame in (0, 30, 60, 90, 119):
        half = abs(1 - frame / 60) / 2
        forces = scene.field(frame, grid, solid).to_dense()[:, 1, 1, 0]
        inside = np.abs(grid.to_m(np.argwhere(np.ones(grid.shape)))[:, 0].reshape(grid.shape)[:, 1, 1]) < half
        x = np.linspace(-0.5, 0.5, 11)
        clear = np.abs(np.abs(x) - half) > 1e-3
        assert ((forces != 0) <= (np.abs(x) < half + 1e-3)).all()
        assert (np.sign(forces) == np.sign(x) * inside)[clear & (np.abs(x) > 0.11)].all(), frame
