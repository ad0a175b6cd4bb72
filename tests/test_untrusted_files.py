"""Untrusted files: one clear error for each; nothing outside their folder is read, and no read blocks."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from depth_makers import write_plain, write_redwood, write_sun3d, write_threedmatch, write_tum
from touchfield.container import TouchReader
from touchfield.devices.profile import device
from touchfield.errors import CorruptFile, InvalidArgument, SourceError, TouchfieldError
from touchfield.files import read_bytes, readable, refuse_overwriting, require_in_folder, require_plain
from touchfield.json_values import JsonValue, read_json
from touchfield.medium.trace import read_trace
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.material import BANDS_HZ, stored_materials
from touchfield.render.spec import stated_n_per_m
from touchfield.sources.images import movies
from touchfield.sources.options import SourceOptions
from touchfield.sources.physics.toml_file import open_physics
from touchfield.sources.registry import open_source
from touchfield.sources.shapes.analytic_scene import read_toml
from touchfield.tasks.exchange import IMPORTS, import_effect
from video_makers import depths_mm, write_video

BALL = '<body name="ball" pos="0 0 .5"><freejoint/><geom size=".05"/></body>'
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
NAMES = (
    "a.toml",
    "a.obj",
    "a.glb",
    "a.xml",
    "a.npz",
    "a.vti",
    "a.png",
    "depth.npy",
    "depth.mkv",
    "disp.pfm",
    "a.csv",
)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A folder with an untrusted file, next to files that it must not read."""
    folder = tmp_path / "scene"
    folder.mkdir()
    (tmp_path / "mine.obj").write_text(TETRAHEDRON)
    (folder / "his.obj").write_text(TETRAHEDRON)
    (tmp_path / "mine.xml").write_text(f"<mujoco><worldbody>{BALL}</worldbody></mujoco>")
    (folder / "link.obj").symlink_to(tmp_path / "mine.obj")
    return folder


@pytest.fixture(autouse=True)
def time_limit() -> Iterator[None]:
    """A read that blocks is a failure, not a test that never ends."""
    before = signal.signal(signal.SIGALRM, lambda *_: pytest.fail("it waits"))
    signal.alarm(120)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


# -- pipes, sockets, devices -------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", IMPORTS)
def test_an_effect_is_one_clear_error_whatever_it_contains(tmp_path: Path, suffix: str) -> None:
    path, out = tmp_path / f"a{suffix}", tmp_path / "out.touch"
    os.mkfifo(path)
    with pytest.raises(SourceError, match="a pipe, a socket or a device"):
        import_effect(path, out)
    path.unlink()
    contents: tuple[bytes, ...] = (
        b"", b"\0" * 64, b"[" * 100_000, b"{}", b"null", b'{"project": {"tracks": [[]]}}', b"\xff\xfe{}",
        b'{"version": {"major": 1e999}}', b'{"Pattern": ' + b"9" * 5000 + b"}",
    )  # fmt: skip
    for content in contents:
        path.write_bytes(content)
        with pytest.raises(TouchfieldError) as caught:
            import_effect(path, out)
        assert path.name in str(caught.value) and "\n" not in str(caught.value)
    with path.open("wb") as file:
        file.truncate(1 << 33)  # sparse: 8 GiB
    with pytest.raises(SourceError, match=r"more than|longer than|bytes"):
        import_effect(path, out)
    assert not out.exists()


@pytest.mark.parametrize("name", NAMES)
def test_a_pipe_is_refused_without_waiting(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    os.mkfifo(path)
    for kind in (None, "physics", "mesh", "mjcf", "depth-map", "tum", "height-map"):
        with pytest.raises(SourceError, match="a pipe, a socket or a device"):
            open_source(path, SourceOptions(kind=kind, depth_scale=1000, intrinsics="9,9,4,4"))


@pytest.mark.parametrize("encoding", ["UTF255", "gb18030"])
@pytest.mark.parametrize(
    ("name", "root"), [("a.dae", "COLLADA"), ("a.xml", "mujoco"), ("a.vti", "VTKFile"), ("a.urdf", "robot")]
)
def test_an_unknown_encoding_of_xml_is_one_clear_error(
    tmp_path: Path, name: str, root: str, encoding: str
) -> None:
    path = tmp_path / name
    path.write_text(f'<?xml version="1.0" encoding="{encoding}"?><{root}/>')
    with pytest.raises(SourceError) as caught:
        open_source(path)
    assert name in str(caught.value) and "\n" not in str(caught.value)


def test_only_regular_files_are_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pipe, folder = tmp_path / "pipe.npy", tmp_path / "frames"
    os.mkfifo(pipe)
    monkeypatch.chdir(tmp_path)
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind("at.obj")
        for path in (tmp_path / "at.obj", Path("/dev/zero")):
            with pytest.raises(SourceError, match="a pipe, a socket or a device"):
                open_source(path)
    folder.mkdir()
    os.mkfifo(folder / "depth0.png")
    readers = (
        lambda: TouchReader(pipe),
        lambda: read_json(pipe, 1000, "an effect"),
        lambda: read_trace(pipe, 100.0),
        lambda: device(str(pipe)),
        lambda: open_source(
            folder, SourceOptions(kind="depth-folder", depth_scale=1000, intrinsics="9,9,4,4")
        ),
    )
    for read in readers:
        with pytest.raises(TouchfieldError, match="a pipe, a socket or a device"):
            read()


def test_an_empty_file_takes_no_memory(tmp_path: Path) -> None:
    """The system states a length of 0 for it, as for files of its own, which are not empty."""
    path = tmp_path / "empty"
    path.touch()
    assert read_bytes(path, 1 << 62, "a file") == b""
    own = Path("/proc/self/maps")
    if own.exists():
        assert len(read_bytes(own, 1 << 30, "a map of memory")) > 1000
        with pytest.raises(SourceError, match="more than 100 bytes"):
            read_bytes(own, 100, "a map of memory")


def test_folders_are_accepted_where_allowed_and_inputs_not_overwritten(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "own").write_text("mine")
    (tmp_path / "link").symlink_to(tmp_path / "own")
    require_plain(tmp_path, "a folder", or_folder=True)
    require_plain("a\0b", "a name that another tells")
    for path, is_folder_allowed in ((tmp_path / "pipe", True), (tmp_path, False)):
        with pytest.raises(SourceError, match=r"found a (pipe|folder)"):
            require_plain(path, "a file", or_folder=is_folder_allowed)
    refuse_overwriting(tmp_path / "new", tmp_path / "own", tmp_path / "absent")
    with pytest.raises(InvalidArgument, match="the file that is read"):
        refuse_overwriting(tmp_path / "link", tmp_path / "absent", tmp_path / "own")
    expected = r"found no such file; expected a list\. Make it"
    with pytest.raises(SourceError, match=expected), readable(tmp_path / "absent", "a list", "Make it."):
        (tmp_path / "absent").read_bytes()


def test_json_is_accepted_up_to_its_limits(tmp_path: Path) -> None:
    path = tmp_path / "a.json"

    def parsed(text: str) -> JsonValue:
        path.write_text(text, "utf-8")
        return read_json(path, 400, "a document of 400 bytes")

    document = parsed(f'\ufeff{{"a": [1.0, 9.9e299, 1e300, true, "{"x" * 60}"]}}'.ljust(398))
    assert path.stat().st_size == 400
    integer, largest, more, truth, text = document.at("a").elements(5)
    assert integer.bounded_integer(1, 1) == 1 and largest.number() == 9.9e299
    for take, found in (
        (more.number, r"\$\.a\[2\]: found 1e\+300; expected a finite number"),
        (truth.number, r"\$\.a\[3\]: found true; expected a number"),
        (lambda: truth.bounded_integer(0, 1), "found true; expected an integer from 0 to 1"),
        (text.number, f'found "{"x" * 59}\\.\\.\\.; expected a number'),
        (lambda: document.at("a").elements(6), "found an array of 5; expected at least 6"),
        (lambda: parsed("[NaN]"), "no JSON .the constant NaN"),
        (lambda: parsed(f"1{'0' * 301}").number(), "found a number of over 300 digits"),
        (lambda: parsed("1" * 401), "more than 400 bytes"),
        (lambda: read_json("a\0b", 9, "a document"), "null byte"),
    ):
        with pytest.raises(SourceError, match=found):
            take()


@pytest.mark.parametrize(("radius", "centre"), [("0x{}", "0"), ("0.1", "0x{}")])
@pytest.mark.parametrize(("table", "key"), [("shape", "center_m"), ("body", "position_m")])
def test_a_number_of_too_many_digits_is_refused(
    tmp_path: Path, table: str, key: str, radius: str, centre: str
) -> None:
    path, long = tmp_path / "scene.toml", "f" * 6000
    values = f"radius_m = {radius.format(long)}\n{key} = [{centre.format(long)}, 0, 0]"
    path.write_text(f'[[{table}]]\nkind = "sphere"\n{values}\n')
    with pytest.raises(SourceError, match=f"scene.toml: {table} 1.*over 300 digits"):
        open_source(path)


@pytest.mark.parametrize("write", [write_tum, write_redwood, write_sun3d, write_threedmatch, write_plain])
def test_a_pipe_instead_of_any_file_of_a_sequence(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    """It is ignored as if it were absent, or refused."""
    folder = write(tmp_path / "scene")
    for file in sorted(p for p in folder.rglob("*") if p.is_file()):
        data = file.read_bytes()
        file.unlink()
        os.mkfifo(file)
        with contextlib.suppress(SourceError, InvalidArgument):
            scene = open_source(folder, SourceOptions(depth_scale=1000, source_rate_hz=30.0))
            for frame in range(scene.frame_count):
                scene.planes(frame)  # type: ignore[attr-defined]
        file.unlink()
        file.write_bytes(data)


# -- files outside the folder ------------------------------------------------------------------------------

MESH = '<worldbody><geom type="mesh" mesh="m"/></worldbody>'
OUTSIDE = {
    "include": '<include file="../mine.xml"/>',
    "absolute": '<include file="{up}/mine.xml"/>',
    "nested": '<include file="inner.xml"/>',
    "mesh": '<asset><mesh name="m" file="../mine.obj"/></asset>' + MESH,
    "backslash": '<asset><mesh name="m" file="..\\mine.obj"/></asset>' + MESH,
    "folder": '<compiler meshdir=".."/><asset><mesh name="m" file="mine.obj"/></asset>' + MESH,
    "stripped": '<compiler assetdir=".." strippath="true"/><asset><mesh name="m" file="a/mine.obj"/></asset>'
    + MESH,
    "link": '<asset><mesh name="m" file="link.obj"/></asset>' + MESH,
}


@pytest.mark.parametrize("kind", OUTSIDE)
def test_a_model_may_not_name_files_outside_its_folder(scene: Path, kind: str) -> None:
    pytest.importorskip("mujoco")
    (scene / "inner.xml").write_text('<mujoco><include file="../mine.xml"/></mujoco>')
    model = scene / "model.xml"
    model.write_text(f"<mujoco>{OUTSIDE[kind].format(up=scene.parent)}</mujoco>")
    with pytest.raises(SourceError, match=r"file .*in the folder .*--allow-outside"):
        open_source(model, SourceOptions(seconds=0.01))
    assert open_source(model, SourceOptions(seconds=0.01, allow_outside=True)).bodies()


def test_a_model_may_name_files_in_its_folder(scene: Path) -> None:
    pytest.importorskip("mujoco")
    (scene / "parts").mkdir()
    (scene / "parts" / "ball.xml").write_text('<mujoco><include file="../more.xml"/></mujoco>')
    (scene / "more.xml").write_text(f"<mujoco><worldbody>{BALL}</worldbody></mujoco>")
    model = scene / "model.xml"
    inside = '<compiler meshdir="parts"/><include file="parts/ball.xml"/>'
    model.write_text(f'<mujoco>{inside}<asset><mesh name="m" file="../his.obj"/></asset>{MESH}</mujoco>')
    assert len(open_source(model, SourceOptions(seconds=0.01)).bodies()) == 2


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (
            '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>',
            "hfield: found nrow",
        ),
        (
            '<worldbody><replicate count="1e9"><geom size="1"/></replicate></worldbody>',
            "replicate: found count",
        ),
        ('<size nkey="2000000000"/>', "size: found nkey"),
        ("<broken", "no XML"),
    ],
)
def test_a_model_cannot_request_more_memory_than_its_size(tmp_path: Path, text: str, match: str) -> None:
    pytest.importorskip("mujoco")
    path = tmp_path / "model.xml"
    path.write_text(f"<mujoco>{text}</mujoco>")
    with pytest.raises(SourceError, match=match):
        open_source(path)
    path.write_text(f'<!DOCTYPE a [<!ENTITY e "x">]><mujoco>{text}</mujoco>')
    with pytest.raises(SourceError, match="document type"):
        open_source(path, SourceOptions(kind="mjcf"))


@pytest.mark.parametrize(
    ("step_s", "size", "match"),
    [
        ("0", "1", "timestep: found 0 s; expected 1e-09"),
        ("nan", "1", "timestep: found nan s"),
        ("1e-300", "1", "timestep: found 1e-300 s"),
        ("0.001", "inf", r"ball: radius_m: found inf; expected .*1e\+09 m"),
        ("0.001", "1e300", r"ball: radius_m: found 1e\+300; expected .*1e\+09 m"),
    ],
)
def test_a_number_of_a_model_beyond_bounds_is_named(
    tmp_path: Path, step_s: str, size: str, match: str
) -> None:
    pytest.importorskip("mujoco")
    ball = f'<body><freejoint/><geom name="ball" size="{size}" mass="1"/></body>'
    (tmp_path / "a.xml").write_text(
        f'<mujoco><option timestep="{step_s}"/><worldbody>{ball}</worldbody></mujoco>'
    )
    with pytest.raises(SourceError, match=match):
        open_source(tmp_path / "a.xml", SourceOptions(seconds=0.01))


@pytest.mark.parametrize(
    ("size", "place"), [("inf 1 1 1", "0 0 0"), ("1 1 1 1", "inf 0 0"), ("1e308 1 1 1", "nan 0 0")]
)
def test_a_height_field_beyond_bounds_is_one_error(tmp_path: Path, size: str, place: str) -> None:
    pytest.importorskip("mujoco")
    heights = f'<hfield name="h" nrow="3" ncol="3" size="{size}" elevation="0 0 0 0 1 0 0 0 0"/>'
    body = f'<worldbody><geom type="hfield" hfield="h" pos="{place}"/></worldbody>'
    (tmp_path / "model.xml").write_text(f"<mujoco><asset>{heights}</asset>{body}</mujoco>")
    with pytest.raises(SourceError, match=r"vertices with a coordinate that is NaN or beyond 1e\+15 m"):
        open_source(tmp_path / "model.xml")


def test_a_physics_file_may_not_name_files_outside_its_folder(scene: Path) -> None:
    path = scene / "scene.toml"
    for name in ("../mine.obj", str(scene.parent / "mine.obj"), "link.obj"):
        path.write_text(f'[[body]]\nkind = "mesh"\nfile = "{name}"\nposition_m = [0, 0, 0]\nfixed = true\n')
        with pytest.raises(SourceError, match=r"body 1.file: .*--allow-outside"):
            open_physics(path, SourceOptions())
        assert open_physics(path, SourceOptions(allow_outside=True)).bodies()
    (scene.parent / "mine.csv").write_text("")
    path.write_text('[[body]]\nkind = "mesh"\nfile = "his.obj"\nposes = "../mine.csv"\n')
    with pytest.raises(SourceError, match=r"body 1\.poses"):
        open_physics(path, SourceOptions())


@pytest.mark.parametrize("uri", ["../mine.bin", "{up}/mine.bin"])
def test_a_gltf_may_not_name_files_outside_its_folder(scene: Path, uri: str) -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"uri": "his.bin", "byteLength": 36}],
    }
    path = scene / "model.gltf"
    path.write_text(json.dumps(document))
    (scene / "his.bin").write_bytes(corners)
    (scene.parent / "mine.bin").write_bytes(corners)
    assert open_source(path).bounds_m().tolist() == [[0, 0, 0], [1, 1, 0]]
    document["buffers"] = [{"uri": uri.format(up=scene.parent), "byteLength": 36}]
    path.write_text(json.dumps(document))
    with pytest.raises(SourceError, match="in the folder"):
        open_source(path)


def test_a_stream_cannot_set_allow_outside() -> None:
    spec = EncodeSpec(source=SourceOptions(allow_outside=True))
    stored = json.loads(spec.to_json())
    assert "allow_outside" not in stored["source"]
    stored["source"]["allow_outside"] = True
    assert EncodeSpec.from_json(json.dumps(stored)).source.allow_outside is False


def test_a_number_beyond_float_in_a_stream_is_refused() -> None:
    stored = json.dumps(json.loads(EncodeSpec().to_json()) | {"friction": 10**400})
    for text in (stored, "[" * 4096):
        with pytest.raises(CorruptFile, match="PROV spec"):
            EncodeSpec.from_json(text)
    assert stated_n_per_m({"spec": json.dumps({"law": "penalty", "stiffness_n_per_m": 10**400})}) is None
    for bands, row in (([10**400], {}), (list(BANDS_HZ), {"friction": 10**400})):
        table = {"bands_hz": bands, "materials": [{"name": "wood", **row}]}
        with pytest.raises(CorruptFile, match="inf"):
            stored_materials({"materials.json": json.dumps(table)})


def test_invalid_names_are_refused(tmp_path: Path) -> None:
    for name in ("\0", "a" * 5000 + "/../../b"):
        with pytest.raises(SourceError, match="--allow-outside"):
            require_in_folder(tmp_path, name, "here")


# -- videos and physics ------------------------------------------------------------------------------------


def test_a_video_with_a_damaged_codec_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("av")
    path = write_video(tmp_path / "depth.mkv", depths_mm(4), "gray16le", level="3", slicecrc="1")
    data = path.read_bytes()
    assert data.count(b"V_FFV1") == 1
    path.write_bytes(data.replace(b"V_FFV1", b"V_QQV1"))
    for read in (movies.GreyVideo, movies.video_header):
        with pytest.raises(SourceError, match="no codec that is known"):
            read(path)


PHYSICS = """
[physics]
seconds = 0.01
{physics}
[[body]]
kind = "{kind}"
position_m = [0, 0, 0.1]
{body}
[[body]]
kind = "box"
position_m = [0, 0, 0]
half_extents_m = [0.1, 0.1, 0.1]
"""


@pytest.mark.parametrize("value", ["1e308", "1e-300", "-1.0", "nan", "inf", "0.0"])
@pytest.mark.parametrize(
    ("kind", "key", "named"),
    [
        ("sphere", "radius_m", "radius_m = {v}"),
        ("capsule", "half_length_m", "radius_m = 1\nhalf_length_m = {v}"),
        ("box", "half_extents_m", "half_extents_m = [1, {v}, 1]"),
        ("ellipsoid", "half_extents_m", "half_extents_m = [1, 1, {v}]"),
        ("sphere", "mass_kg", "radius_m = 1\nmass_kg = {v}"),
        ("sphere", "density_kg_m3", "radius_m = 1\ndensity_kg_m3 = {v}"),
    ],
)
def test_a_size_beyond_bounds_is_named(tmp_path: Path, kind: str, key: str, named: str, value: str) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(PHYSICS.format(physics="", kind=kind, body=named.format(v=value)))
    with pytest.raises(SourceError, match=rf"body 1.{key}.*: found .*; expected (.*1e|a finite number)"):
        open_physics(path, SourceOptions())


@pytest.mark.parametrize("value", ["1e308", "-1e308", "nan", "inf"])
@pytest.mark.parametrize("key", ["velocity_m_s", "spin_deg_s", "rotation_deg", "position_m", "gravity_m_s2"])
def test_a_motion_beyond_bounds_is_named(tmp_path: Path, key: str, value: str) -> None:
    line = f"{key} = [0, 0, {value}]"
    physics, body = (line, "") if key == "gravity_m_s2" else ("", line)
    text = PHYSICS.format(physics=physics, kind="sphere", body=f"radius_m = 0.1\n{body}")
    if key == "position_m":
        text = text.replace("position_m = [0, 0, 0.1]\n", "", 1)
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with pytest.raises(SourceError, match=rf"{key}\[2\]: found .*; expected a number from -1e\+09 to 1e\+09"):
        open_physics(path, SourceOptions())


@pytest.mark.filterwarnings("error")
def test_a_failing_simulation_is_an_error_without_output(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "scene.toml"
    corners = (
        "vertices_m = [[0,0,0],[1e9,0,0],[0,0.1,0],[0,0,0.1]]\ntriangles = [[0,2,1],[0,1,3],[0,3,2],[1,2,3]]"
    )
    for kind, body, physics in (
        ("sphere", "radius_m = 1e9\nmass_kg = 1e-12", ""),
        ("mesh", corners, ""),
        ("superquadric", "half_extents_m = [1, 1, 1e-8]\nexponents = [1, 1]", ""),
        ("sphere", "radius_m = 0.1\nvelocity_m_s = [0, 0, 1e9]", "step_s = 1e8"),
        ("sphere", "radius_m = 0.1", "rate_hz = 1e5\nstep_s = 1e-9"),
        ("sphere", "radius_m = 0.1", "gravity_m_s2 = [0, 0, 1e9]\nfriction = 1e6"),
    ):
        path.write_text(PHYSICS.format(physics=physics, kind=kind, body=body))
        with contextlib.suppress(TouchfieldError):
            open_physics(path, SourceOptions())
    assert capfd.readouterr() == ("", "")
    assert os.listdir() == ["scene.toml"]


def test_a_fault_within_mujoco_is_a_source_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mujoco = pytest.importorskip("mujoco")

    def stops(*_: object) -> None:
        raise mujoco.FatalError("mju_makeFrame: xaxis of contact frame undefined")

    monkeypatch.setattr(mujoco, "mj_forward", stops)
    path = tmp_path / "scene.toml"
    path.write_text(PHYSICS.format(physics="", kind="sphere", body="radius_m = 0.1"))
    with pytest.raises(SourceError, match="xaxis of contact frame"):
        open_physics(path, SourceOptions())


def test_a_toml_of_more_than_16_mib_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "long.toml"
    path.write_bytes(b"#" * ((1 << 24) + 1))
    with pytest.raises(SourceError, match="up to 16777216 bytes"):
        read_toml(path, "a TOML file")
