"""Invalid glTF documents: one line that names the position, for any fault in the JSON or the bytes."""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from gltf_makers import CUBE, Gltf, everything, glb, moving_cube
from touchfield.errors import InvalidArgument, SourceError, TouchfieldError
from touchfield.sources.animation.animated_mesh import KIND, AnimatedMeshScene
from touchfield.sources.gltf.document import Document, contents
from touchfield.sources.mesh.mesh_files import KIND as MESH
from touchfield.sources.options import SourceOptions

Change = Callable[[dict[str, Any]], Any]


def sampler(document: dict[str, Any]) -> dict[str, Any]:
    return document["animations"][0]["samplers"][0]


def primitive(document: dict[str, Any], mesh: int = 0) -> dict[str, Any]:
    return document["meshes"][mesh]["primitives"][0]


def put(*path: Any, value: Any) -> Change:
    """Set the value at a path of keys and indices."""

    def change(document: dict[str, Any]) -> None:
        at: Any = document
        for key in path[:-1]:
            at = at[key]
        at[path[-1]] = value

    return change


def drop(*path: Any) -> Change:
    def change(document: dict[str, Any]) -> None:
        at: Any = document
        for key in path[:-1]:
            at = at[key]
        del at[path[-1]]

    return change


def refused(gltf: Gltf, tmp_path: Path, *messages: str) -> None:
    path = gltf.save(tmp_path / "a.gltf")
    with pytest.raises(SourceError) as caught:
        AnimatedMeshScene(path)
    text = str(caught.value)
    assert text.startswith(str(path)) and "\n" not in text
    for word in messages:
        assert word in text, text


@pytest.mark.parametrize(
    ("change", "messages"),
    [
        (put("accessors", 0, "count", value=10**9), ["accessors[0]", "bytes of bufferViews[0]"]),
        (put("accessors", 0, "byteOffset", value=4), ["accessors[0]", "bytes"]),
        (put("accessors", 0, "byteOffset", value=-12), ["byteOffset: found -12"]),
        (put("accessors", 0, "count", value=0), ["count: found 0", "from 1"]),
        (put("accessors", 0, "count", value=True), ["count: found true"]),
        (put("accessors", 0, "count", value=1.5), ["count: found 1.5"]),
        (put("accessors", 0, "componentType", value=5124), ["componentType 5124"]),
        (put("accessors", 0, "type", value="VEC4"), ["type VEC4", "VEC3"]),
        (put("accessors", 0, "bufferView", value=99), ["bufferView: found 99", "0 to"]),
        (put("bufferViews", 0, "byteStride", value=4), ["every 4"]),
        (put("bufferViews", 0, "byteLength", value=10**12), ["bufferViews[0]", "buffers[0]"]),
        (put("bufferViews", 0, "buffer", value=1), ["buffer: found 1"]),
        (put("nodes", 0, "mesh", value=7), ["nodes[0]", "mesh: found 7", "0 to 0"]),
        (put("nodes", 0, "children", value=[0]), ["nodes[0]", "its own ancestor"]),
        (put("nodes", 0, "rotation", value=[0, 0, 0, 0]), ["rotation of length 0"]),
        (put("nodes", 0, "scale", value=[1, float("nan"), 1]), ["no JSON", "NaN"]),
        (put("nodes", 0, "translation", value=[1, 2]), ["translation", "3 finite numbers"]),
        (put("nodes", 0, "matrix", value=[1] * 16), ["last row"]),
        (put("nodes", value={}), ["nodes: found an object", "an array"]),
        (put("nodes", 0, value=3), ["nodes[0]: found 3", "an object"]),
        (put("meshes", 0, "primitives", 0, "mode", value=9), ["mode 9"]),
        (put("meshes", 0, "primitives", value=[]), ["no triangle"]),
        (drop("animations", 0, "samplers", 0, "input"), ["samplers[0]", "input"]),
        (put("animations", 0, "samplers", 0, "interpolation", value="FAST"), ["'FAST'", "LINEAR"]),
        (put("animations", 0, "channels", 0, "sampler", value=4), ["channels[0]", "sampler: found 4"]),
        (
            put("animations", 0, "channels", 0, "target", "path", value="weights"),
            ["weights", "morph targets"],
        ),
        (put("extensionsRequired", value=["KHR_draco_mesh_compression"]), ["'KHR_draco_mesh_compression'"]),
        (put("extensionsRequired", value=["EXT_meshopt_compression"]), ["'EXT_meshopt_compression'"]),
        (put("asset", "version", value="1.0"), ["version '1.0'"]),
    ],
)
def test_one_wrong_entry_is_named(change: Change, messages: list[str], tmp_path: Path) -> None:
    gltf = moving_cube()
    gltf.save(tmp_path / "a.gltf")
    change(gltf.json)
    refused(gltf, tmp_path, *messages)


def test_times_must_ascend_and_be_numbers(tmp_path: Path) -> None:
    for times, word in (([0, 0], "ascend"), ([1, 0], "ascend"), ([-1, 0], "ascend"), ([0, np.nan], "NaN")):
        refused(moving_cube(times=times), tmp_path, word)
    refused(moving_cube(values=np.zeros((3, 3))), tmp_path, "9 output numbers", "6 for 2 times")
    refused(moving_cube(values=np.zeros((2, 3)), how="CUBICSPLINE"), tmp_path, "6 output numbers", "18")


def test_a_second_parent_and_a_cycle_are_refused(tmp_path: Path) -> None:
    gltf = moving_cube()
    gltf.json["nodes"] += [{"children": [0]}, {"children": [0]}]
    refused(gltf, tmp_path, "nodes[0]", "second parent")
    gltf = moving_cube()
    gltf.json["nodes"] += [{"children": [2]}, {"children": [1]}]
    refused(gltf, tmp_path, "nodes[1]", "its own ancestor")


def test_a_second_channel_and_a_channel_on_a_matrix_are_refused(tmp_path: Path) -> None:
    gltf = moving_cube()
    gltf.animate(0, "translation", [0, 1], np.zeros((2, 3)))
    refused(gltf, tmp_path, "second translation")
    gltf = moving_cube()
    gltf.json["nodes"][0]["matrix"] = np.eye(4).reshape(-1).tolist()
    refused(gltf, tmp_path, "has a matrix")


def test_invalid_skins_are_refused(tmp_path: Path) -> None:
    for change, message in (
        (lambda d: primitive(d)["attributes"].pop("JOINTS_0"), ["no JOINTS_0", "skin"]),
        (lambda d: primitive(d)["attributes"].pop("WEIGHTS_0"), ["no WEIGHTS_0", "skin"]),
        (lambda d: primitive(d)["attributes"].update(JOINTS_1=0), ["no WEIGHTS_1"]),
        (lambda d: d["skins"][0].update(joints=[0]), ["number 1", "0 to 0"]),
        (lambda d: d["skins"][0].update(joints=[]), ["no joint"]),
        (lambda d: d["skins"][0].update(joints=[77, 0]), ["joints[0]: found 77"]),
        (lambda d: d["skins"][0].update(joints=[0, 1, 2]), ["2 inverse bind matrices"]),
    ):
        gltf = everything()
        change(gltf.json)
        refused(gltf, tmp_path, *message)


def test_invalid_morph_targets_are_refused(tmp_path: Path) -> None:
    for change, message in (
        (lambda d: primitive(d, 1)["targets"][0].update(POSITION=2), ["12 positions", "8 vertices"]),
        (lambda d: primitive(d, 1)["targets"].pop(), ["weights", "2 finite numbers"]),
        (lambda d: d["meshes"][1]["primitives"].append(primitive(d, 2)), ["0 and with 3 targets"]),
    ):
        gltf = everything()
        change(gltf.json)
        refused(gltf, tmp_path, *message)


def test_invalid_sparse_accessors_are_refused(tmp_path: Path) -> None:
    number = next(i for i, a in enumerate(everything().json["accessors"]) if "sparse" in a)
    for change, message in (
        (put("accessors", number, "sparse", "count", value=9), ["9 changes"]),
        (put("accessors", number, "sparse", "indices", "componentType", value=5120), ["ascend"]),
        (put("accessors", number, "sparse", "indices", "byteOffset", value=4), ["bytes"]),
        (drop("accessors", number, "sparse", "values"), ["no values"]),
        (put("accessors", number, "count", value=2**40), ["elements declared in"]),
    ):
        gltf = everything()
        change(gltf.json)
        refused(gltf, tmp_path, *message)


def test_indices_beyond_the_vertices_are_refused(tmp_path: Path) -> None:
    gltf = Gltf()
    node = gltf.put("nodes", mesh=gltf.mesh(CUBE, [[0, 1, 8]]))
    gltf.animate(node, "translation", [0, 1], np.zeros((2, 3)))
    refused(gltf, tmp_path, "the number 8", "0 to 7")


def test_compressed_primitives_without_data_name_their_extension(tmp_path: Path) -> None:
    gltf = moving_cube()
    del gltf.json["accessors"][0]["bufferView"]
    primitive(gltf.json)["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0}}
    refused(gltf, tmp_path, "KHR_draco_mesh_compression")


def test_another_version_is_refused_for_any_content(tmp_path: Path) -> None:
    path = tmp_path / "old.gltf"
    path.write_text('{"asset": {"version": "1.0"}, "meshes": {"a": {}}, "nodes": {}}')
    with pytest.raises(SourceError, match=r"glTF version '1\.0'; expected version 2"):
        Document(path)


def test_unread_extensions_are_noted(tmp_path: Path) -> None:
    gltf = moving_cube()
    gltf.json["extensionsUsed"] = [
        "KHR_materials_unlit",
        "EXT_mesh_gpu_instancing",
        "KHR_draco_mesh_compression",
    ]
    path = gltf.save(tmp_path / "a.gltf")
    for scene in (KIND.open(path, SourceOptions()), MESH.open(path, SourceOptions())):
        assert "Not read, and left out: 'EXT_mesh_gpu_instancing'" in scene.notes


def test_a_glb_may_have_no_binary_chunk(tmp_path: Path) -> None:
    path = moving_cube().save(tmp_path / "a.glb", "glb")
    members, data = contents(path)
    assert data
    json_bytes = int.from_bytes(path.read_bytes()[12:16], "little")
    os.truncate(path, 20 + json_bytes)
    with path.open("r+b") as file:
        file.seek(8)
        file.write((20 + json_bytes).to_bytes(4, "little"))
    assert contents(path) == (members, b"")


def test_a_glb_is_recognised_by_its_json_alone(tmp_path: Path) -> None:
    """Its bytes are read when it is opened; faults in them do not matter before."""
    path = moving_cube().save(tmp_path / "a.glb", "glb")
    members, data = contents(path)
    assert data and contents(path, with_binary=False) == (members, b"")
    intact = glb(b"{}  ", b"1234")
    path.write_bytes(intact[:24] + b"\xff\xff\xff\x7f" + intact[28:])  # the length of the second chunk
    assert not KIND.recognise(path)
    with pytest.raises(SourceError, match="cut short"):
        contents(path)


def test_small_documents_cannot_request_much_memory(tmp_path: Path) -> None:
    gltf = moving_cube()
    positions = gltf.array(np.zeros((3000, 3)))
    target = {"POSITION": positions}
    gltf.put("meshes", primitives=[{"attributes": {"POSITION": positions}, "targets": [target] * 40_000}])
    gltf.json["nodes"].append({"mesh": 1})
    refused(gltf, tmp_path, "elements declared in")
    del gltf.json["meshes"][1]["primitives"][0]["targets"], gltf.json["buffers"]
    gltf.json["nodes"] += [{"mesh": 1}] * 10_001
    refused(gltf, tmp_path, "too many triangles")


def test_many_accessors_of_the_same_bytes_cannot_request_much_memory(tmp_path: Path) -> None:
    gltf = Gltf()
    view = gltf.view(bytes(1 << 16))
    for _ in range(100):
        gltf.put("accessors", bufferView=view, count=1 << 16, componentType=5121, type="SCALAR")
    accessors = Document(gltf.save(tmp_path / "many.gltf"))
    assert accessors.array(0, "SCALAR").shape == (1 << 16, 1)
    with pytest.raises(SourceError, match=r"accessors\[\d+\]: found \d+ elements declared in \d+ bytes"):
        list(map(accessors.array, range(100), ["SCALAR"] * 100))


def test_invalid_buffers_are_refused(tmp_path: Path) -> None:
    def saved(**members: Any) -> Path:
        gltf = moving_cube()
        gltf.save(tmp_path / "a.gltf", "bin")
        gltf.json["buffers"][0].update(members)
        return gltf.save(tmp_path / "a.gltf", "bin")

    inner = tmp_path / "inner"
    inner.mkdir()
    (inner / "folder").mkdir()
    for members, word in (
        ({"uri": "absent.bin"}, "no file 'absent.bin'"),
        ({"uri": "inner"}, "no file"),
        ({"uri": "../secret.bin"}, "in the folder"),
        ({"uri": "/etc/hostname"}, "in the folder"),
        ({"uri": "https://example.com/a.bin"}, "no file 'https"),
        ({"uri": "a%00b"}, "in the folder"),
        ({"uri": "n" * 5000}, "nnn"),
        ({"uri": "data:,abc"}, "base64"),
        ({"uri": "data:a/b;base64,###"}, "not base64"),
        ({"uri": "data:a/b;base64," + base64.b64encode(b"1234").decode()}, "4 bytes"),
        ({"byteLength": 10**9}, "1000000000"),
        ({"uri": 3}, "uri: found 3"),
    ):
        with pytest.raises(SourceError, match="buffers") as caught:
            AnimatedMeshScene(saved(**members))
        assert word in str(caught.value)


def test_invalid_glb_files_are_refused(tmp_path: Path) -> None:
    intact = moving_cube().save(tmp_path / "whole.glb", "glb").read_bytes()
    path = tmp_path / "a.glb"
    for data, word in (
        (intact[:-5], "header declares"),
        (intact[:8], "header declares"),
        (intact[:4] + b"\x01" + intact[5:], "version 1"),
        (intact[:12] + b"\xff\xff\xff\x7f" + intact[16:], "cut short"),
        (intact[:16] + b"JSOX" + intact[20:], "no JSON chunk"),
        (b"glTF", "header declares"),
        (glb(b"{]", b""), "no JSON"),
        (glb(b"[]", b""), "not an object"),
        (glb(b"{}", b""), "no triangle"),
    ):
        path.write_bytes(data)
        with pytest.raises(SourceError, match="found") as caught:
            AnimatedMeshScene(path)
        assert word in str(caught.value)
    with pytest.raises(SourceError):
        AnimatedMeshScene(tmp_path / "absent.glb")


def test_error_of_an_unknown_animation_lists_the_known_ones(tmp_path: Path) -> None:
    gltf = everything()
    path = gltf.save(tmp_path / "a.gltf")
    for name in ("Gallop", "2", "-1", "", "٣", "9" * 30):
        with pytest.raises(InvalidArgument, match="'move 0', 'move 1'"):
            KIND.open(path, SourceOptions(animation=name))
    del gltf.json["animations"]
    with pytest.raises(SourceError, match="no animation"):
        AnimatedMeshScene(gltf.save(tmp_path / "b.gltf"))


def test_too_many_frames_are_refused(tmp_path: Path) -> None:
    path = moving_cube(times=[0, 1e30]).save(tmp_path / "a.gltf")
    with pytest.raises(InvalidArgument, match="at most 100000 frames"):
        AnimatedMeshScene(path)


def test_coordinates_that_overflow_in_some_frame_are_reported(tmp_path: Path) -> None:
    path = moving_cube([[0, 0, 0], [3e38, 0, 0]]).save(tmp_path / "a.gltf")
    with pytest.raises(SourceError, match="NaN or infinite at"):
        AnimatedMeshScene(path)


# -- fuzzing -----------------------------------------------------------------------------------------------

VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 40),
    st.sampled_from(
        [2**31, 2**63, 10**400, -1, 1e308, float("nan"), float("inf"), "", "VEC3", "SCALAR", "weights"]
    ),
    st.lists(st.integers(-1, 6), max_size=5),
    st.lists(st.floats(-10, 10), min_size=3, max_size=16),
    st.just({}),
)


def paths_of(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    entries = (
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    )
    return [
        entry_path for key, inner in entries for entry_path in ((*path, key), *paths_of(inner, (*path, key)))
    ]


def use(path: Path) -> None:
    """Read a document and evaluate it; only touchfield's errors may be raised."""
    with suppress(TouchfieldError):
        for animation in ("0", "1"):
            scene = AnimatedMeshScene(path, animation)
            for frame in (0, scene.frame_count - 1):
                scene.surface(frame).pseudo_normals()
                assert np.isfinite(scene.velocities_m_s(frame)).all()


@settings(max_examples=100)
@given(st.data())
def test_any_change_of_the_json_gives_a_touchfield_error(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    gltf = everything()
    folder = tmp_path_factory.mktemp("fuzz")
    gltf.save(folder / "a.gltf")
    for _ in range(data.draw(st.integers(1, 3))):
        path = data.draw(st.sampled_from(paths_of(gltf.json)))
        change = drop(*path) if data.draw(st.booleans()) else put(*path, value=data.draw(VALUES))
        change(gltf.json)
    (folder / "a.gltf").write_text(json.dumps(gltf.json))
    use(folder / "a.gltf")


@settings(max_examples=80)
@given(st.data())
def test_any_change_of_the_bytes_gives_a_touchfield_error(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.mktemp("fuzz") / "a.glb"
    original = bytearray(everything().save(path, "glb").read_bytes())
    for _ in range(data.draw(st.integers(0, 8))):
        original[data.draw(st.integers(0, len(original) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(
        original[: data.draw(st.integers(0, len(original))) if data.draw(st.booleans()) else None]
    )
    KIND.recognise(path)
    use(path)
