"""Mesh files: each format back, scene graphs, damage as one clear error, and real ones."""

from __future__ import annotations

import json
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from gltf_makers import glb
from mesh_makers import cube, distance_to, measured, winding
from touchfield.errors import SourceError
from touchfield.medium import Grid
from touchfield.sources import animated_mesh
from touchfield.sources.gltf_document import contents
from touchfield.sources.mesh import KIND, read_triangles
from touchfield.sources.mesh_scene import MeshScene
from touchfield.sources.mesh_surface import joined
from touchfield.sources.options import SourceOptions


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".ply", ".glb", ".gltf", ".off"])
def test_every_format_comes_back_closed(tmp_path: Path, suffix: str) -> None:
    box = trimesh.creation.box((0.4, 0.3, 0.2))
    path = tmp_path / f"box{suffix}"
    if suffix == ".gltf":
        for name, data in trimesh.exchange.gltf.export_gltf(trimesh.Scene(box)).items():
            (tmp_path / name).write_bytes(data)
        path = tmp_path / "model.gltf"
    else:
        box.export(path)
    assert KIND.recognise(path)
    scene = KIND.open(path, SourceOptions(unit_m=0.5))
    assert scene.is_closed and len(scene.surface.triangles) == 12 and len(scene.surface.vertices_m) == 8
    np.testing.assert_allclose(np.ptp(scene.bounds_m(), axis=0), [0.2, 0.15, 0.1], rtol=1e-6)
    assert "0.5 m" in scene.notes[0]
    assert "taken as metres" in KIND.open(path, SourceOptions()).notes[0]


def test_the_scene_graph_is_applied(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    box = trimesh.creation.box((1, 1, 1))
    scene.add_geometry(box, geom_name="box", node_name="a")
    mirror = np.diag([-2.0, 1, 1, 1])
    mirror[:3, 3] = 5, 0, 0
    scene.add_geometry(box, geom_name="box", node_name="b", transform=mirror)
    path = tmp_path / "two.glb"
    scene.export(path)
    opened = KIND.open(path, SourceOptions())
    np.testing.assert_allclose(opened.bounds_m(), [[-0.5, -0.5, -0.5], [6, 0.5, 0.5]])
    assert opened.is_closed and opened.surface.volume_m3() == pytest.approx(3)


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".ply", ".glb", ".gltf", ".off"])
def test_damaged_files_are_one_clear_error(tmp_path: Path, suffix: str) -> None:
    whole = tmp_path / f"whole{suffix}"
    box = trimesh.creation.box((1, 1, 1))
    if suffix == ".gltf":
        whole.write_bytes(trimesh.exchange.gltf.export_gltf(trimesh.Scene(box))["model.gltf"])
    else:
        box.export(whole)
    data = whole.read_bytes()
    path = tmp_path / f"cut{suffix}"
    for piece in (b"", b"\x00" * 64, b"nonsense\n" * 9, data[: len(data) // 3], data[: len(data) // 8]):
        path.write_bytes(piece)
        if suffix == ".obj" and b"f " in piece:
            continue  # text that is cut between lines is still a mesh
        with pytest.raises(SourceError) as caught:
            KIND.open(path, SourceOptions())
        assert "\n" not in str(caught.value) and path.name in str(caught.value)


def test_clouds_and_folders_are_refused(tmp_path: Path) -> None:
    cloud = tmp_path / "cloud.ply"
    trimesh.PointCloud(np.eye(3)).export(cloud)
    with pytest.raises(SourceError, match="no triangle"):
        KIND.open(cloud, SourceOptions())
    folder = tmp_path / "folder.obj"
    folder.mkdir()
    assert not KIND.recognise(folder)
    with pytest.raises(SourceError, match="folder"):
        read_triangles(folder)
    nan = tmp_path / "nan.obj"
    nan.write_text("v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n")
    with pytest.raises(SourceError):
        KIND.open(nan, SourceOptions())


def test_memory_without_bytes_is_refused(tmp_path: Path) -> None:
    document = {
        "asset": {"version": "2.0"},
        "accessors": [{"componentType": 5126, "count": 10**12, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
    }
    text = json.dumps(document).encode()
    (tmp_path / "big.gltf").write_bytes(text)
    text += b" " * (-len(text) % 4)
    chunk = struct.pack("<II", len(text), 0x4E4F534A) + text
    (tmp_path / "big.glb").write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunk)) + chunk)
    for name in ("big.gltf", "big.glb"):
        with pytest.raises(SourceError, match="elements with their data"):
            KIND.open(tmp_path / name, SourceOptions())


def test_vertices_at_one_place_become_one() -> None:
    vertices, faces = cube()
    loose, loose_faces = vertices[faces].reshape(-1, 3), np.arange(36).reshape(12, 3)
    assert not MeshScene(loose, loose_faces).is_closed
    points, triangles = joined(loose, loose_faces)
    assert len(points) == 8 and MeshScene(points, triangles).is_closed
    np.testing.assert_array_equal(points[triangles], loose[loose_faces])


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "is_closed"),
    [
        ("spot/spot_triangulated.obj", True),
        ("featuretype/featuretype.STL", True),
        ("fox/Fox.glb", True),
        ("morph_stress_test/MorphStressTest.gltf", True),
        ("parasaurolophus_scan/parasaurolophus_6700.ply", False),
    ],
)
def test_real_meshes(shared_data: Path, name: str, is_closed: bool) -> None:
    path = shared_data / "meshes" / name
    assert KIND.recognise(path)
    scene = KIND.open(path, SourceOptions(unit_m=0.01))
    assert scene.is_closed == is_closed
    low, high = scene.bounds_m()
    pitch = (high - low).max() / 40
    grid = Grid.over_box((low + high) / 2 - 24 * pitch, (low + high) / 2 + 24 * pitch, (48,) * 3)
    points, phi, _ = measured(scene, grid, 3 * pitch)
    assert len(points) > 1000
    mesh = scene.surface.vertices_m, scene.surface.triangles
    ends = scene.surface.edges.edge_of.reshape(-1)
    is_rim = np.bincount(ends)[ends] == 1
    rim = mesh[0][np.stack([mesh[1], np.roll(mesh[1], -1, axis=1)], axis=2).reshape(-1, 2)[is_rim]].mean(axis=1)
    whole = np.flatnonzero(
        cKDTree(np.append(rim, [[1e9] * 3], axis=0)).query(points)[0] > 7 * pitch
    )  # no fading there
    some = np.random.default_rng(1).choice(whole, 20, replace=False)
    np.testing.assert_allclose(np.abs(phi[some]), distance_to(mesh, points[some]), atol=4e-6 * 3 * pitch)
    if is_closed:
        some = some[np.abs(phi[some]) > 1e-4 * pitch]
        turns = np.round(winding(mesh, points[some]))
        assert len(some) > 10 and (np.sign(phi[some]) == np.where(turns != 0, -1, 1)).all()
    animated = path.suffix in (".glb", ".gltf")
    assert any("rest pose" in note for note in scene.notes) == animated


def test_what_is_cut_off_is_told_and_never_left_out(tmp_path: Path) -> None:
    box = trimesh.creation.box((1, 1, 1))
    text = trimesh.exchange.stl.export_stl_ascii(box)
    two = f"{text}\n{text}".encode()  # solids: of one that is cut, nothing could be read
    binary = trimesh.exchange.stl.export_stl(box)
    ply = trimesh.exchange.ply.export_ply(box, encoding="ascii")
    for name, data, words in (
        ("two.stl", two[: two.rfind(b"vertex")], "12 triangles where the file tells of 23 faces"),
        ("cut.stl", binary[:-60], "0 triangles where the file tells of 12 faces"),
        ("cut.ply", ply[:-25], "triangles where the file tells of 12 faces"),
    ):
        path = tmp_path / name
        path.write_bytes(data)
        with pytest.raises(SourceError, match=words):
            read_triangles(path)


def test_of_a_glb_only_the_json_is_read_to_recognise_it(tmp_path: Path) -> None:
    text = json.dumps({"asset": {"version": "2.0"}, "animations": [{}]}).encode()
    text += b" " * (-len(text) % 4)
    chunk_bytes = 1 << 28
    path, size = tmp_path / "large.glb", 12 + 8 + len(text) + 8 + chunk_bytes
    head = struct.pack("<4sIIII", b"glTF", 2, size, len(text), 0x4E4F534A)
    path.write_bytes(head + text + struct.pack("<II", chunk_bytes, 0x004E4942))
    with path.open("r+b") as file:
        file.truncate(size)  # zeros that take no room on the disk
    tracemalloc.start()
    try:
        assert animated_mesh.KIND.recognise(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 1 << 24


def test_what_of_a_gltf_is_left_out_is_told(tmp_path: Path) -> None:
    path = tmp_path / "two.glb"
    trimesh.Scene(trimesh.creation.box((1, 1, 1))).export(path)
    members, chunk = contents(path)
    members["extensionsUsed"] = ["KHR_materials_unlit", "EXT_mesh_gpu_instancing"]
    members["scenes"].append({"nodes": [0]})
    path.write_bytes(glb(json.dumps(members).encode(), chunk))
    notes = read_triangles(path)[2]
    assert "Extensions that are not read: EXT_mesh_gpu_instancing." in notes
    assert "Of the 2 scenes in the file number 0 is read." in notes
