"""Files of strangers with faults that bench/fuzz_parsers.py found: each ends in one error that names it."""

from __future__ import annotations

import io
import json
import math
import sqlite3
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import layout_makers as layouts
import scene_makers as scenes
from touchfield.devices import device
from touchfield.errors import DeviceError, InvalidArgument, SourceError, TouchfieldError
from touchfield.files import library_faults, read_bytes
from touchfield.medium.deformation import read_deformation
from touchfield.medium.grid import Grid, Placement
from touchfield.network.demux import demux
from touchfield.sources.camera import DepthCode, Intrinsics
from touchfield.sources.options import SourceOptions
from touchfield.sources.recordings.mcap_chunks import require_distinct_chunks
from touchfield.sources.recordings.recording import read_recording
from touchfield.sources.registry import open_source
from touchfield.sources.terrain.height_map import as_heights

LONG = "x" * 300  # no file system has so long a name


def written(path: Path, content: bytes | str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def open_zarr(folder: Path, member: str, key: str, value: str) -> object:
    """Open a store one of whose numbers is replaced."""
    path = scenes.write_zarr(folder / "store")
    file = path / member
    document = json.loads(file.read_text())
    owner = document["attributes"]["touchfield"] if key in ("rate_hz", "friction") else document
    owner[key] = "@"
    file.write_text(json.dumps(document).replace('"@"', value))
    return open_source(path)


def sound(folder: Path, head: bytes, data_bytes: int) -> Path:
    """A .wav with chunks `head`, and data of a stated length without any."""
    chunks = b"WAVE" + head + b"data" + struct.pack("<I", data_bytes)
    return written(folder / "a.wav", b"RIFF" + struct.pack("<I", 1 << 31) + chunks)


PCM = b"fmt " + struct.pack("<IHHIIHH", 16, 1, 1, 8000, 16000, 2, 16)


def packed(folder: Path, name: str, method: int) -> Path:
    """An archive of one array, compressed by a method."""
    array = io.BytesIO()
    np.save(array, np.zeros((2, 3), np.uint8))
    path = folder / name
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("displacement.npy", array.getvalue())
        archive.writestr("3D/3dmodel.model", "<model/>")
    return path


def tall_tiff(folder: Path) -> object:
    """Open pages that state a hundred times the rows that they have."""
    path = layouts.write_tiff_pages(folder / "tiff")
    data = path.read_bytes()
    rows = struct.pack("<HHI", 257, 4, 1), struct.pack("<HHI", 257, 3, 1)
    at = max(data.find(entry) for entry in rows)
    assert at > 0
    path.write_bytes(data[:at] + rows[0] + struct.pack("<I", 7200) + data[at + 12 :])
    return open_source(path, SourceOptions(depth_scale=1000.0))


def points(folder: Path) -> object:
    head = "FIELDS x y z\nSIZE 1 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n"
    return open_source(written(folder / "a.pcd", f"# .PCD v0.7\nVERSION 0.7\n{head}1 2 3\n"))


def movie_parts(folder: Path) -> object:
    return demux(written(folder / "a.m3u8", f"#EXTM3U\n{LONG}.ts\n"), folder / "out.touch")


def nerf(folder: Path) -> object:
    frames = [{"depth_file_path": f"{LONG}.png", "transform_matrix": np.eye(4).tolist()}]
    written(folder / "nerf" / "transforms.json", json.dumps({"frames": frames}))
    return open_source(folder / "nerf")


def stamped(folder: Path) -> object:
    path = layouts.write_tum(folder / "tum")
    written(path / "depth.txt", f"1.0 {LONG}.png\n")
    return open_source(path)


def body(folder: Path) -> object:
    text = f'[[body]]\nkind = "mesh"\nfile = "{LONG}.ply"\nposition_m = [0, 0, 0]\nmass_kg = 0.1\n'
    return open_source(written(folder / "bodies.toml", text))


def far_model(folder: Path) -> object:
    pytest.importorskip("mujoco")
    vertices = "0 0 0 1e16 0 0 0 1e16 0 0 0 1e16"
    mesh = f'<asset><mesh name="m" vertex="{vertices}"/></asset>'
    geom = '<worldbody><geom type="mesh" mesh="m"/></worldbody>'
    return open_source(written(folder / "far.xml", f"<mujoco>{mesh}{geom}</mujoco>"))


def database(folder: Path, kind: object, data: object) -> object:
    """Open a bag whose columns have values of other types."""
    pytest.importorskip("mcap_ros2")
    path = folder / "bag.db3"
    with sqlite3.connect(path) as file:
        file.execute("CREATE TABLE topics (id INTEGER PRIMARY KEY, name, type)")
        file.execute("CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data)")
        file.execute("INSERT INTO topics VALUES (1, '/depth', ?)", (kind,))
        file.execute("INSERT INTO messages VALUES (1, 1, 0, ?)", (data,))
    file.close()
    return open_source(path)


IMAGE = "sensor_msgs/msg/Image"
REFUSED: dict[str, tuple[Callable[[Path], Any], str]] = {
    "zarr, infinite shape": (
        lambda f: open_zarr(f, "forces_n/zarr.json", "shape", "[1e400, 1, 1, 1, 3]"),
        "store",
    ),
    "zarr, infinite rate": (lambda f: open_zarr(f, "zarr.json", "rate_hz", "1" + "0" * 400), "store"),
    "wav without a chunk": (
        lambda f: read_recording(written(f / "a.wav", b"RIFF\4\0\0\0WAVE")),
        r"a\.wav: found what is no sound",
    ),
    "wav of 2 GiB": (lambda f: read_recording(sound(f, PCM, 0x7FFFFFF0)), r"a\.wav: found"),
    "wav of nothing": (lambda f: read_recording(sound(f, PCM, 0)), r"a\.wav: found"),
    "off with a face of 2^63 corners": (
        lambda f: open_source(
            written(f / "a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n9223372036854775807 0 1 2\n")
        ),
        r"a\.off: found a mesh that cannot be read",
    ),
    "npz by LZMA": (lambda f: read_deformation(packed(f, "a.npz", zipfile.ZIP_LZMA)), "method 14 of zip"),
    "npz by bzip2": (lambda f: read_deformation(packed(f, "a.npz", zipfile.ZIP_BZIP2)), "method 12 of zip"),
    "tiff without its strips": (tall_tiff, r"depth\.tif.*: found strips or tiles of \d+ pixels"),
    "pcd of floats of a byte": (points, r"a\.pcd: found .*TYPE F, SIZE 1"),
    **{
        f"grid of {count} rows": (
            lambda f, count=count: open_source(
                written(f / "a.asc", f"ncols 2\nnrows {count}\ncellsize 1\n1 2\n3 4\n")
            ),
            r"a\.asc: found .*nrows",
        )
        for count in ("nan", "inf", "1e300")
    },
    "long name of a part": (movie_parts, r"a\.m3u8"),
    "long name of a picture": (nerf, "no x.*depth pictures are missing"),
    "long name in a list": (stamped, "depth"),
    "long name of a mesh": (body, r"bodies\.toml: .*\.file: found nothing at"),
    "model too far": (far_model, r"far\.xml: world: found"),
    "database, no type": (lambda f: database(f, None, b""), r"bag\.db3"),
    "database, a number": (lambda f: database(f, IMAGE, 1 << 40), "a message of type int"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_hostile_file_is_refused_in_one_line(case: str, tmp_path: Path) -> None:
    read, message = REFUSED[case]
    with pytest.raises(TouchfieldError, match=message) as caught:
        read(tmp_path)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out.touch").exists()


def test_a_3mf_by_lzma_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("lib3mf")
    with pytest.raises(SourceError, match=r"a\.3mf: found .*method 14 of zip"):
        open_source(packed(tmp_path, "a.3mf", zipfile.ZIP_LZMA))


def test_a_damaged_exr_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("OpenEXR")
    path = layouts.write_exr_folder(tmp_path / "exr")
    for picture in path.rglob("*.exr"):
        picture.write_bytes(picture.read_bytes()[:400])
    with pytest.raises(SourceError, match=r"\.exr: found an EXR that is damaged"):
        open_source(path)


@pytest.mark.parametrize("number", ["1" * 5000, "1" + "0" * 400, "inf", "nan"])
def test_a_profile_of_no_usable_number(number: str, tmp_path: Path) -> None:
    text = f'name = "a"\ntitle = "a"\ntype = 1\n[force_max_n]\nvalue = {number}\nsource = "none"\n'
    with pytest.raises(DeviceError, match=r"a\.toml"):
        device(written(tmp_path / "a.toml", text))


class _Entry:
    def __init__(self, start: int) -> None:
        self.chunk_start_offset = start


class _Summary:
    def __init__(self, *starts: int) -> None:
        self.chunk_indexes = [_Entry(start) for start in starts]


def test_an_index_names_each_chunk_once() -> None:
    require_distinct_chunks(_Summary(8, 500), "a.mcap")
    require_distinct_chunks(None, "a.mcap")
    with pytest.raises(SourceError, match=r"a\.mcap: found an index of 3 entries for 2 chunks"):
        require_distinct_chunks(_Summary(8, 500, 8), "a.mcap")


def test_a_limit_of_bytes_allocates_nothing(tmp_path: Path) -> None:
    path = written(tmp_path / "a.json", "{}")
    tracemalloc.start()
    try:
        assert read_bytes(path, 1 << 36, "a file") == b"{}"
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()
    with pytest.raises(SourceError, match="more than 1 bytes"):
        read_bytes(path, 1, "a file")


def test_odd_numbers_of_pictures_give_no_warning() -> None:
    signalling = np.array([0x7FA00000], np.uint32).view(np.float32)
    assert np.isnan(as_heights(signalling)).all()
    values = np.array([1e-40, 1e38, 2.0, np.nan, 0.0], np.float32)
    assert DepthCode(1.0)(values).tolist() == [0.0, np.float32(1e38), 2.0, 0.0, 0.0]
    flat = Placement.fit([[0, 0, 0], [1, 1, 5e-324]], (0.1, 0.1, 0.1))
    assert flat.scale == pytest.approx(0.1)


@pytest.mark.parametrize("length_m", [1e-320, 1e-101, 1e101, math.inf, math.nan])
def test_lengths_whose_products_overflow_are_refused(length_m: float) -> None:
    with pytest.raises(InvalidArgument, match=r"grid spacing_m: found .* expected three lengths from 1e-100"):
        Grid((2, 2, 2), (1.0, length_m, 1.0), (0.0, 0.0, 0.0))
    with pytest.raises(InvalidArgument, match="placement scale"):
        Placement(length_m)
    with pytest.raises(InvalidArgument, match=r"intrinsics: found fy = .* 1e-12 to 1e\+12 pixels"):
        Intrinsics(1.0, length_m, 0.0, 0.0)


def test_any_error_of_a_library_becomes_one_of_ours() -> None:
    class Strange(Exception):
        pass

    expected = r"a\.x: found no x \(.+\); expected an x"
    for error in (Strange("odd\nbytes"), UnboundLocalError("fs"), MemoryError(), ZeroDivisionError()):
        with pytest.raises(SourceError, match=expected) as caught, library_faults("a.x", "no x", "an x"):
            raise error
        assert caught.value.__cause__ is error
    with pytest.raises(DeviceError, match="as it was"), library_faults("a.x", "no x", "an x"):
        raise DeviceError("as it was")
