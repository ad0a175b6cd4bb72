"""A stream with one damaged segment, first, middle or last: every reader reports it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from touchfield.cli.main import _exit_code
from touchfield.codec.touch.spec import TouchSpec
from touchfield.container import TouchReader
from touchfield.errors import DeviceError, FormatError
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.pipeline import encode
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.stored import StoredScene
from touchfield.tasks.play import Played

GRID = Grid((16, 16, 16), (0.01, 0.0075, 0.004375), (-0.08, -0.06, -0.035))
SEGMENTS = 3
FORCE, VIBRATION = "force", "vibration"

ALL_FRAMES = (
    "decode {stream} new.npz",
    "encode {stream} new.touch",
    "filter {stream} new.touch --gaussian 2mm",
    "edit {stream} new.touch --operator gain:0.5",
    "resample {stream} new.touch --nw 3",
    "splice {stream} whole.touch new.touch",
    "splice whole.touch {stream} new.touch",
    "export {stream} new.tact",
    "export {stream} new.wav --device tactsuit-x40",
    "reduce {stream} new.touch",
    "measure {stream} --no-limits",
    "play {stream} --offline --seconds 0.2",
)
"""Commands that read every frame."""

ALL_VIBRATIONS = ("encode {stream} new.touch", "export {stream} new.wav --device tactsuit-x40")
"""Commands that read the vibration of every frame."""


def frame(number: int) -> ForceField:
    """A wall across the lattice that sinks."""
    dense = np.zeros((*GRID.shape, 3), np.float32)
    dense[:, :, : 10 - number, 2] = 1.0 + 0.1 * number
    return ForceField.from_dense(GRID, dense)


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A stream of three segments of two frames, with vibration."""
    path = tmp_path_factory.mktemp("whole") / "whole.touch"
    medium = HapticMedium.from_frames([frame(i) for i in range(2 * SEGMENTS)], 50.0)
    touch = TouchSpec(effort="fast", segment_frames=2)
    spec = EncodeSpec(nw=4, mapping="crop", touch=touch, vibration="gain=0.25,frequency=80..240")
    encode(StoredScene(medium), path, spec)
    return path.read_bytes()


def damaged(path: Path, intact: bytes, segment: int, payload: str) -> Path:
    """The stream with one bit changed in the middle of a payload of a segment."""
    path.write_bytes(intact)
    with TouchReader(path) as reader:
        assert len(reader.segments) == SEGMENTS
        body = reader.read_segment(segment) if payload == FORCE else reader.read_vibration(segment)
    assert body
    start = 0
    for _ in range(segment if payload == VIBRATION else 0):  # the same body may occur several times
        start = intact.index(b"VIBR", start) + 4
    data = bytearray(intact)
    data[intact.index(body, start) + len(body) // 2] ^= 4
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("segment", range(SEGMENTS))
@pytest.mark.parametrize("payload", [FORCE, VIBRATION])
def test_one_segment_is_refused_and_the_others_are_read(
    intact: bytes, tmp_path: Path, segment: int, payload: str
) -> None:
    with TouchReader(damaged(tmp_path / "a.touch", intact, segment, payload)) as reader:
        for i in range(SEGMENTS):
            for kind, read in ((FORCE, reader.read_segment), (VIBRATION, reader.read_vibration)):
                if (i, kind) == (segment, payload):
                    with pytest.raises(FormatError, match="CRC-32"):
                        read(i)
                else:
                    assert read(i)


def cases() -> Iterator[tuple[str, str]]:
    yield from ((command, FORCE) for command in ALL_FRAMES)
    yield from ((command, VIBRATION) for command in ALL_VIBRATIONS)


@pytest.mark.parametrize(("command", "payload"), list(cases()))
def test_a_command_that_reads_all_refuses_a_stream_whose_last_segment_is_damaged(
    intact: bytes, tmp_path: Path, command: str, payload: str,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    (tmp_path / "whole.touch").write_bytes(intact)
    damaged(tmp_path / "bad.touch", intact, SEGMENTS - 1, payload)
    capsys.readouterr()
    assert _exit_code(command.format(stream="bad.touch").split()) == 1
    lines = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("note: ")]
    assert len(lines) == 1 and lines[0].startswith("touchfield: ") and "CRC-32" in lines[0]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.touch", "whole.touch"]


@pytest.mark.parametrize("is_starved", [False, True])
def test_a_play_ended_by_an_error_reports_its_figures_and_fails(
    intact: bytes, tmp_path: Path, is_starved: bool,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    path = tmp_path / "a.touch"
    path.write_bytes(intact)
    figures = {"device": "haply", "stalled_share": 0.5 if is_starved else 0.0}
    ended = Played(
        figures, None, None, ("as far as it came",), DeviceError("haply", "a cable pulled", "a device")
    )
    monkeypatch.setattr("touchfield.tasks.play.play", lambda *_: ended)
    capsys.readouterr()
    assert _exit_code(["play", str(path), "--json"]) == 1
    output = capsys.readouterr()
    assert '"haply"' in output.out and "as far as it came" in output.out
    assert json.loads(output.err.splitlines()[-1])["error"].startswith("haply: found a cable pulled")
