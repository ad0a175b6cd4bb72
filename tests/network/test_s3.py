"""Files and stores in an S3 bucket, on a server of loopback: written, and read by ranges."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from s3_makers import Requests, bucket_server
from touchfield.cli.main import _exit_code
from touchfield.container import TouchReader
from touchfield.errors import SourceError
from touchfield.medium.stores import zarr_store
from touchfield.medium.stores.zarr_store import read_zarr
from touchfield.pipeline.source import decode

pytest.importorskip("moto.server", reason="needs moto, a server of S3")
pytest.importorskip("obstore", reason="needs the extra remote")
pytestmark = pytest.mark.thorough

ENCODE = ("encode", "sample:shapes")
OPTIONS = ("--nw", "5", "--effort", "fast")


@pytest.fixture
def requests(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Requests]:
    """A server with an empty bucket, and the requests that it gets; the working folder is empty."""
    monkeypatch.chdir(tmp_path)
    with bucket_server() as (received, environment):
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        yield received


def test_a_file_is_written_and_one_segment_is_read_by_ranges(requests: Requests, tmp_path: Path) -> None:
    options = ("--nw", "4", "--representation", "voxel", "--frames", "0:60", "--segment-frames", "4")
    for out in ("own.touch", "s3://bucket/a/far.touch"):
        assert _exit_code(["encode", "sample:falling-7", out, *options]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["own.touch"]
    requests.lines.clear()
    with TouchReader("s3://bucket/a/far.touch") as far, TouchReader(tmp_path / "own.touch") as own:
        assert len(own.segments) >= 10 and far.read_segment(6) == own.read_segment(6)
        assert far._source.remote is not None
        ranges = far._source.remote.requests
    assert requests.lines == ["GET /bucket/a/far.touch 206"] * ranges and ranges <= 4
    frames = zip(decode("s3://bucket/a/far.touch"), decode(tmp_path / "own.touch"), strict=True)
    assert all(a == b for a, b in frames)


@pytest.fixture
def small_shards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zarr_store, "_SHARD", 16)
    monkeypatch.setattr(zarr_store, "_CHUNK", 8)


def test_a_store_is_written_and_a_box_is_read_by_ranges(
    requests: Requests, tmp_path: Path, small_shards: None
) -> None:
    zarr = pytest.importorskip("zarr", reason="the extra zarr is not installed")
    pytest.importorskip("s3fs", reason="plain zarr reads s3:// by s3fs")
    for out in ("own.zarr", "s3://bucket/far.zarr"):
        assert _exit_code([*ENCODE, out, *OPTIONS]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["own.zarr"]
    sent = [line for line in requests.lines if line.startswith("PUT") and "far.zarr" in line]
    files = [file for file in (tmp_path / "own.zarr").rglob("*") if file.is_file()]
    assert len(sent) == len(files) and sent[-1] == "PUT /bucket/far.zarr/zarr.json 200"

    far, own = read_zarr("s3://bucket/far.zarr"), read_zarr(tmp_path / "own.zarr")
    assert far[0] == own[0] and far.grid == own.grid and far[0].support_count > 0

    array = zarr.open_array("s3://bucket/far.zarr", path="forces_n", mode="r")
    requests.lines.clear()
    box = array[0, 12:20, 12:20, 12:20]  # a corner of eight chunks, each in a shard of its own
    assert np.array_equal(box, own[0].to_dense()[12:20, 12:20, 12:20]) and box.any()
    shards = {line for line in requests.lines if line.startswith("GET") and line.endswith(" 206")}
    assert requests.of("GET", "forces_n/c", 200) == 0, "no shard is read as a whole"
    assert 1 <= len(shards) <= 8 and requests.of("GET", "forces_n/c", 206) <= 2 * len(shards)


def test_a_store_at_an_address_is_a_source(requests: Requests, tmp_path: Path) -> None:
    pytest.importorskip("zarr", reason="the extra zarr is not installed")
    assert _exit_code([*ENCODE, "s3://bucket/far.zarr", *OPTIONS]) == 0
    assert _exit_code([*ENCODE, "own.zarr", *OPTIONS]) == 0
    for source, out in (("s3://bucket/far.zarr", "far.touch"), ("own.zarr", "own.touch")):
        assert _exit_code(["encode", source, out, *OPTIONS]) == 0
    assert decode("far.touch")[0] == decode("own.touch")[0]


def test_an_older_store_is_not_mixed_with_a_new_one(
    requests: Requests, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("zarr", reason="the extra zarr is not installed")
    assert _exit_code([*ENCODE, "s3://bucket/far.zarr", *OPTIONS]) == 0
    requests.lines.clear()
    assert _exit_code([*ENCODE, "s3://bucket/far.zarr", *OPTIONS]) == 2
    assert "s3://bucket/far.zarr: found something there already" in capsys.readouterr().err
    assert not requests.of("PUT", "", 200) and not list(tmp_path.iterdir())


def test_an_absent_bucket_or_store_is_refused_in_one_line(
    requests: Requests, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("zarr", reason="the extra zarr is not installed")
    assert _exit_code([*ENCODE, "s3://absent/far.zarr", *OPTIONS]) == 1
    stderr = capsys.readouterr().err
    assert "s3://absent/far.zarr" in stderr and "Traceback" not in stderr
    assert not list(tmp_path.iterdir()), "refused before the work"
    with pytest.raises(SourceError, match=r"s3://bucket/none\.zarr: found that it cannot be read"):
        read_zarr("s3://bucket/none.zarr")
