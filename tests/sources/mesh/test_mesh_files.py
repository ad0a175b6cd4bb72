"""Mesh files: each format round-trips, scene graphs, damage as one clear error, and real files."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from gltf_makers import glb
from mesh_makers import cube, distance_to, measured, winding
from touchfield.errors import SourceError
from touchfield.medium import Grid
from touchfield.sources.gltf.document import contents
from touchfield.sources.mesh.mesh_files import KIND, read_triangles
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.mesh.surface import merge_vertices
from touchfield.sources.options import SourceOptions


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".ply", ".glb", ".gltf", ".off"])
def test_every_format_round_trips_closed(tmp_path: Path, suffix: str) -> None:
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
    intact = tmp_path / f"whole{suffix}"
    box = trimesh.creation.box((1, 1, 1))
    if suffix == ".gltf":
        intact.write_bytes(trimesh.exchange.gltf.export_gltf(trimesh.Scene(box))["model.gltf"])
    else:
        box.export(intact)
    data = intact.read_bytes()
    path = tmp_path / f"cut{suffix}"
    for piece in (b"", b"\x00" * 64, b"nonsense\n" * 9, data[: len(data) // 3], data[: len(data) // 8]):
        path.write_bytes(piece)
        if suffix == ".obj" and b"f " in piece:
            continue  # a text cut between lines is still a mesh
        with pytest.raises(SourceError) as caught:
            KIND.open(path, SourceOptions())
        assert "\n" not in str(caught.value) and path.name in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "message"),
    [("ply", "20 rows before the declared end"), ("off", "60 faces .* declares 80"), ("stl", "endsolid")],
)
def test_a_text_cut_between_lines_is_refused(tmp_path: Path, kind: str, message: str) -> None:
    ball = trimesh.creation.icosphere(1)
    text = {"encoding": "ascii"} if kind == "ply" else {}
    exported = ball.export(file_type="stl_ascii" if kind == "stl" else kind, **text)
    lines = (exported if isinstance(exported, str) else exported.decode()).splitlines(keepends=True)
    (tmp_path / f"whole.{kind}").write_text("".join(lines))
    (tmp_path / f"cut.{kind}").write_text("".join(lines[:-20]))
    assert len(read_triangles(tmp_path / f"whole.{kind}")[1]) == 80
    with pytest.raises(SourceError, match=message):
        read_triangles(tmp_path / f"cut.{kind}")


def test_error_of_several_solids_names_the_cut_one(tmp_path: Path) -> None:
    text, path = trimesh.exchange.stl.export_stl_ascii(trimesh.creation.box((1, 1, 1))), tmp_path / "two.stl"
    path.write_text(f"{text}\n{text}\n")
    assert len(read_triangles(path)[1]) == 24
    path.write_text(f"{text}\n{text[:-200]}")
    with pytest.raises(SourceError, match="2 solids, of which 1 end with endsolid"):
        read_triangles(path)


def test_the_default_scene_of_a_gltf_is_read_and_noted(tmp_path: Path) -> None:
    path = tmp_path / "two.glb"
    trimesh.Scene(trimesh.creation.box((1, 1, 1))).export(path)
    members, chunk = contents(path)
    path.write_bytes(glb(json.dumps(members).encode(), chunk))
    assert "scenes" not in " ".join(read_triangles(path)[2])
    members["scenes"].append({"nodes": [0]})
    path.write_bytes(glb(json.dumps(members).encode(), chunk))
    assert "Of 2 scenes in the file number 0 is read." in read_triangles(path)[2]


L_OUTLINE = ((0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2))


@pytest.mark.parametrize("suffix", [".obj", ".ply"])
@pytest.mark.parametrize("start", range(6))
def test_concave_polygons_are_not_folded(tmp_path: Path, suffix: str, start: int) -> None:
    """Two caps of an L, for any first corner in the file: a fan from it would have triangles outside."""
    points = [(x, y, z) for z in (0, 1) for x, y in L_OUTLINE]
    top = [6 + (start + i) % 6 for i in range(6)]
    faces = [top, [i - 6 for i in top[::-1]], *([i, (i + 1) % 6, (i + 1) % 6 + 6, i + 6] for i in range(6))]
    path = tmp_path / f"l{suffix}"
    rows = "".join(f"{x} {y} {z}\n" for x, y, z in points)
    polygons = "".join(f"{len(face)} {' '.join(map(str, face))}\n" for face in faces)
    if suffix == ".obj":
        rows = "".join(f"v {row}\n" for row in rows.splitlines())
        path.write_text(rows + "".join(f"f {' '.join(str(i + 1) for i in face)}\n" for face in faces))
    else:
        axes = "".join(f"property float {axis}\n" for axis in "xyz")
        counts = f"element vertex 12\n{axes}element face {len(faces)}\n"
        path.write_text(f"ply\nformat ascii 1.0\n{counts}property list uchar int vertex_index\nend_header\n")
        path.write_text(path.read_text() + rows + polygons)
    surface = KIND.open(path, SourceOptions()).surface
    corners = surface.vertices_m[surface.triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert surface.is_closed and surface.volume_m3() == pytest.approx(3)
    assert areas.sum() == pytest.approx(2 * 3 + 8)  # caps and walls; a folded cap would cover more


def ply(points: list[tuple[int, ...]], faces: list[list[int]], order: str) -> bytes:
    """A PLY of one byte order, or of text; its faces have a number before and one after their corners."""
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}.get(order, "ascii")
    head = f"ply\nformat {name} 1.0\ncomment of a test\nelement vertex {len(points)}\nproperty float x\n"
    head += f"property double y\nproperty float32 z\nelement face {len(faces)}\nproperty uchar group\n"
    head += "property list uint8 int vertex_indices\nproperty short flags\nend_header\n"
    if order not in "<>":
        rows = [*points, *([7, len(face), *face, 1] for face in faces)]
        return head.encode() + "\n".join(" ".join(map(str, row)) for row in rows).encode()
    body = b"".join(struct.pack(order + "fdf", *point) for point in points)
    corners = (struct.pack(f"{order}BB{len(face)}ih", 7, len(face), *face, 1) for face in faces)
    return head.encode() + body + b"".join(corners)


@pytest.mark.parametrize("kind", ["obj", "off", "ply<", "ply>", "ply text"])
def test_polygons_of_all_sizes_are_triangulated_inside(tmp_path: Path, kind: str) -> None:
    """Several darts between triangles, and an L of six corners."""
    points = [(0, 0, 0), (4, 0, 0), (1, 1, 0), (0, 4, 0), *((x + 9, y, 0) for x, y in L_OUTLINE)]
    faces = [[1, 2, 3, 0], [2, 3, 0, 1], [4, 5, 6], [0, 1, 2, 3], [4, 5, 6], [6, 7, 8, 9, 4, 5], [3, 0, 1, 2]]
    path = tmp_path / f"darts.{kind[:3]}"
    if kind == "obj":
        rows = [("v", *point) for point in points] + [("f", *(f"{i + 1}//1" for i in face)) for face in faces]
        path.write_text("\n".join(" ".join(map(str, row)) for row in rows))
    elif kind == "off":
        rows = [*points, *([len(face), *face, 255, 0, 0] for face in faces)]
        path.write_text(
            f"OFF # of a test\n{len(points)} 7 0\n\n" + "\n".join(" ".join(map(str, row)) for row in rows)
        )
    else:
        path.write_bytes(ply(points, faces, kind[3:].strip()))
    vertices, triangles, _ = read_triangles(path)
    sides = np.diff(vertices[triangles], axis=1)
    doubled = np.cross(sides[:, 0], sides[:, 1])[:, 2]
    assert len(triangles) == 4 * 2 + 2 + 4 and (doubled >= 0).all()
    assert doubled.sum() / 2 == pytest.approx(4 * 4 + 2 * 1 + 3)


def test_line_ends_of_windows_and_old_macs(tmp_path: Path) -> None:
    text, path = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2\n", tmp_path / "corner.obj"
    texts = [text.replace("\n", end).encode() for end in ("\r", "\r\n")]
    for data in (text.encode("utf-8-sig"), text.encode("utf-16"), *texts):
        path.write_bytes(data)
        vertices, triangles, _ = read_triangles(path)
        assert vertices[triangles].tolist() == [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]


def test_a_file_without_permission_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(path: Path) -> bytes:
        raise PermissionError(13, "Permission denied", str(path))

    path = tmp_path / "closed.obj"
    path.write_text("v 0 0 0\n")
    monkeypatch.setattr(Path, "read_bytes", refused)
    with pytest.raises(SourceError, match=r"closed\.obj: found no permission"):
        read_triangles(path)


@pytest.mark.parametrize("lines", [[3], [3, 10, 11]])
def test_an_stl_text_without_some_of_its_corners_is_refused(tmp_path: Path, lines: list[int]) -> None:
    rows = trimesh.exchange.stl.export_stl_ascii(trimesh.creation.box((1, 1, 1))).splitlines()
    path = tmp_path / "gap.stl"
    path.write_text("\n".join(row for n, row in enumerate(rows) if n not in lines))
    with pytest.raises(SourceError, match=r"gap\.stl: .*corners of 12 facets"):
        read_triangles(path)


@pytest.mark.parametrize(
    ("suffix", "data", "message"),
    [
        ("off", b"", "no OFF"),
        ("off", b"3 1 0\n", "no OFF"),
        ("ply", b"", "no PLY"),
        ("ply", b"ply\nformat odd 1.0\nend_header\n", "no PLY"),
    ],
)
def test_files_of_other_contents_are_refused(tmp_path: Path, suffix: str, data: bytes, message: str) -> None:
    path = tmp_path / f"none.{suffix}"
    path.write_bytes(data)
    with pytest.raises(SourceError, match=message):
        read_triangles(path)


@pytest.mark.parametrize("order", ["<", ">", "text"])
@pytest.mark.parametrize(
    "faces", [[[0, 1, 2], [0, 2, 3]], [[0, 1, 2], [0, 1, 2, 3]], [[0, 1, 2, 3], [2, 3, 0]], [[0, 1, 2, 3]]]
)
def test_faces_whose_corners_come_first(tmp_path: Path, order: str, faces: list[list[int]]) -> None:
    """Faces of equal length are read at once and others one by one, with equal results."""
    points = [(0, 0, 0), (4, 0, 0), (4, 3, 0), (0, 3, 0)]
    data = ply(points, faces, order).replace(b"property uchar group\n", b"")
    head, _, rows = data.partition(b"end_header\n")
    for face in faces:  # without the number before their corners
        rows = rows.replace(bytes([7, len(face)]), bytes([len(face)])).replace(
            b"7 %d" % len(face), b"%d" % len(face)
        )
    path = tmp_path / "faces.ply"
    path.write_bytes(head + b"end_header\n" + rows)
    vertices, triangles, _ = read_triangles(path)
    fans = [[face[0], face[i], face[i + 1]] for face in faces for i in range(1, len(face) - 1)]
    assert vertices[triangles].tolist() == np.array(points, float)[fans].tolist()


@pytest.mark.parametrize("order", ["<", "text"])
def test_a_ply_cut_anywhere_is_refused(tmp_path: Path, order: str) -> None:
    """At every byte of its rows (of a text: before its last numbers)."""
    data = ply([(0, 0, 0), (4, 0, 0), (1, 1, 0), (0, 4, 0)], [[0, 1, 2], [1, 2, 3, 0], [0, 1, 3]], order)
    path = tmp_path / "cut.ply"
    for end in range(data.index(b"end_header"), len(data) - (order == "text")):
        path.write_bytes(data[:end])
        with pytest.raises(SourceError, match=r"cut\.ply"):
            read_triangles(path)


@pytest.mark.parametrize("count", [-1, -5, 255])
def test_a_ply_whose_lists_have_no_length_is_refused(tmp_path: Path, count: int) -> None:
    path = tmp_path / "bad.ply"
    data = ply([(0, 0, 0), (4, 0, 0), (1, 1, 0)], [[0, 1, 2]], "<").replace(b"list uint8", b"list int32")
    path.write_bytes(data[:-15] + struct.pack("<i3ih", count, 0, 1, 2, 1))
    with pytest.raises(SourceError, match=r"bad\.ply"):
        read_triangles(path)


def test_numbers_of_vertices_before_a_face(tmp_path: Path) -> None:
    """-1 is the last vertex before the face, not the last one of the file."""
    vertices, faces = cube()
    text = ""
    for shift in (0.0, 2.0):
        text += "".join(f"v {x + shift} {y} {z}\r\n" for x, y, z in vertices)
        text += "".join(f"f {a - 8}/1/1 {b - 8}//1 \\\r\n {c - 8}\r\n" for a, b, c in faces)
    path = tmp_path / "two.obj"
    path.write_text(text, newline="")
    scene = KIND.open(path, SourceOptions())
    np.testing.assert_allclose(scene.bounds_m(), [[0, 0, 0], [3, 1, 1]])
    assert scene.is_closed and scene.surface.volume_m3() == pytest.approx(2)
    path.write_text("v 0 0 0\nf -1 -2 -3\nv 1 0 0\nv 0 1 0\n")
    with pytest.raises(SourceError, match="not there"):
        KIND.open(path, SourceOptions())


@pytest.mark.parametrize("is_text", [True, False])
def test_triangle_strips_of_a_ply_are_split_as_they_turn(tmp_path: Path, is_text: bool) -> None:
    """A box in two strips, of which one leads on by triangles with a vertex twice."""
    vertices, _ = cube()
    strips = [1, 0, 5, 4, 7, 6, 3, 2, 1, 0, -1, 1, 5, 3, 7, 7, 0, 0, 2, 4, 6]
    form = "ascii" if is_text else "binary_little_endian"
    head = (
        f"ply\nformat {form} 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
        "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    )
    rows = [*vertices.tolist(), [len(strips), *strips]]
    text = "\n".join(" ".join(f"{value:g}" for value in row) for row in rows).encode()
    numbers = vertices.astype("<f4").tobytes() + struct.pack(f"<{len(strips) + 1}i", len(strips), *strips)
    path = tmp_path / "strips.ply"
    path.write_bytes(head.encode() + (text if is_text else numbers))
    scene = KIND.open(path, SourceOptions())
    assert scene.is_closed and len(scene.surface.triangles) == 12
    assert not any("turned" in note for note in scene.notes)
    assert scene.surface.volume_m3() == pytest.approx(1)


def test_bytes_after_the_triangles_of_a_binary_stl_are_ignored(tmp_path: Path) -> None:
    path = tmp_path / "box.stl"
    data = trimesh.creation.box((1, 1, 1)).export(file_type="stl")
    path.write_bytes(data + b"made by a scanner")
    assert len(KIND.open(path, SourceOptions()).surface.triangles) == 12
    path.write_bytes(data[:-25])
    with pytest.raises(SourceError, match=r"659 bytes where its triangles take 684"):
        KIND.open(path, SourceOptions())


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


def test_vertices_at_equal_positions_are_merged() -> None:
    vertices, faces = cube()
    loose, loose_faces = vertices[faces].reshape(-1, 3), np.arange(36).reshape(12, 3)
    assert not MeshScene(loose, loose_faces).is_closed
    points, triangles = merge_vertices(loose, loose_faces)
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
    corners = scene.surface.edges.edge_of.reshape(-1)
    is_rim = np.bincount(corners)[corners] == 1
    rim = mesh[0][np.stack([mesh[1], np.roll(mesh[1], -1, axis=1)], axis=2).reshape(-1, 2)[is_rim]].mean(
        axis=1
    )
    undimmed = np.flatnonzero(
        cKDTree(np.append(rim, [[1e9] * 3], axis=0)).query(points)[0] > 7 * pitch
    )  # where the force does not fade
    some = np.random.default_rng(1).choice(undimmed, 20, replace=False)
    np.testing.assert_allclose(np.abs(phi[some]), distance_to(mesh, points[some]), atol=4e-6 * 3 * pitch)
    if is_closed:
        some = some[np.abs(phi[some]) > 1e-4 * pitch]
        turns = np.round(winding(mesh, points[some]))
        assert len(some) > 10 and (np.sign(phi[some]) == np.where(turns != 0, -1, 1)).all()
    animated = path.suffix in (".glb", ".gltf")
    assert any("rest pose" in note for note in scene.notes) == animated
