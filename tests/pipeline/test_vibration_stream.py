"""A vibration from the rule to the file and back: a stream has the vibration of its medium."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from object_makers import F0_N, head_of, moving_scene
from touchfield import pipeline
from touchfield.cli.main import _exit_code
from touchfield.codec.objects.encoder import ObjectsEncoder
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.touch.spec import TouchSpec
from touchfield.codec.vibration import encode_vibration
from touchfield.container import TouchWriter
from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.filters.contact import VibrationRule, add_vibration
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.medium import VibrationFrame
from touchfield.pipeline.encoding import record_of
from touchfield.pipeline.rate_control import Target
from touchfield.pipeline.source import StreamScene
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.stored import StoredScene

GRID = Grid((16, 16, 16), (0.01, 0.0075, 0.004375), (-0.08, -0.06, -0.035))
FAST = TouchSpec(effort="fast", segment_frames=2)
RULE_TEXT = "gain=0.25,frequency=80..240"


def ball(t: int) -> ForceField:
    """Forces within a ball that moves."""
    i, j, k = np.meshgrid(*(np.arange(n) - n / 2 for n in GRID.shape), indexing="ij")
    depth = np.maximum(0, 5 - np.sqrt((i - t) ** 2 + j * j + k * k))
    return ForceField.from_dense(
        GRID, np.stack([0 * depth, 0 * depth, depth / 2], axis=-1).astype(np.float32)
    )


def medium(frames: int = 5) -> HapticMedium:
    return HapticMedium.from_frames([ball(t) for t in range(frames)], 50.0)


def spec(**options: object) -> EncodeSpec:
    return replace(EncodeSpec(nw=4, mapping="crop", touch=FAST), **options)  # type: ignore[arg-type]


def frames_of(path: Path) -> list[VibrationFrame]:
    with pipeline.open_file(path) as opened:
        band = opened.medium.vibration
        assert band is not None
        return [band(i) for i in range(len(opened.medium))]


def assert_near(found: VibrationFrame, expected: VibrationFrame) -> None:
    np.testing.assert_array_equal(found.positions, expected.positions)
    np.testing.assert_allclose(found.amplitudes_n, expected.amplitudes_n, rtol=1 / 9 + 1e-6)
    np.testing.assert_allclose(found.frequencies_hz, expected.frequencies_hz, atol=0.5 + 1e-3)


def test_a_stream_has_the_vibration_of_its_rule(tmp_path: Path) -> None:
    path = tmp_path / "a.touch"
    prepared = pipeline.prepare(StoredScene(medium()), spec(vibration=RULE_TEXT))
    done = pipeline.encode(StoredScene(medium()), path, spec(vibration=RULE_TEXT))
    assert done.summary()["vibration"] is True and prepared.medium.vibration is not None
    rule = VibrationRule(0.25, 80, 240)
    for i, frame in enumerate(frames_of(path)):
        expected = prepared.medium.vibration(i)
        support = prepared.medium[i].support()
        np.testing.assert_array_equal(expected.positions, support.positions)
        np.testing.assert_allclose(expected.amplitudes_n, rule.gain * support.amplitudes_n, rtol=1e-6)
        np.testing.assert_allclose(expected.frequencies_hz, 80 + 160 * support.amplitudes_n / 3.3, rtol=1e-4)
        assert_near(frame, expected)
    with pipeline.open_file(path) as opened:
        summary = opened.summary()
        assert summary["vibration_samples"] == sum(map(len, frames_of(path)))
        hertz = np.concatenate([frame.frequencies_hz for frame in frames_of(path)])
        assert (
            80
            <= summary["vibration_lowest_hz"]
            == hertz.min()
            < summary["vibration_highest_hz"]
            == hertz.max()
            <= 240
        )
        bodies = [opened.reader.read_vibration(i) or b"" for i in range(3)]
        assert summary["bits_vibration"] == 8 * sum(map(len, bodies))
        parts = ("support", "amplitude", "direction", "models", "side", "vibration")
        assert (
            sum(summary[f"bits_{part}"] for part in parts)
            == 8 * summary["file_bytes"]
            == 8 * path.stat().st_size
        )
        assert summary["seconds"] == summary["frames"] / 50.0 == 0.1


def test_a_file_without_vibration_is_unchanged(tmp_path: Path) -> None:
    path = tmp_path / "a.touch"
    pipeline.encode(StoredScene(medium(2)), path, spec())
    data = path.read_bytes()
    assert b"VIBR" not in data and b"vibration" not in data and data[12:14] == b"\0\0"
    with pipeline.open_file(path) as opened:
        assert opened.medium.vibration is None and not any("vibration" in key for key in opened.summary())


def test_frames_are_cut_with_their_vibration(tmp_path: Path) -> None:
    complete, part = tmp_path / "whole.touch", tmp_path / "part.touch"
    pipeline.encode(StoredScene(medium()), complete, spec(vibration=RULE_TEXT))
    pipeline.encode(complete, part, spec(frames=(1, 4)))
    for found, expected in zip(frames_of(part), frames_of(complete)[1:4], strict=True):
        assert_near(found, expected)
        np.testing.assert_array_equal(found.amplitudes_n, expected.amplitudes_n)  # no further loss


def test_a_stored_medium_keeps_its_band(tmp_path: Path) -> None:
    path, rule = tmp_path / "a.touch", VibrationRule(0.5, 200, 200)
    vibrating = add_vibration(medium(3), rule, 3.3)
    pipeline.encode(StoredScene(vibrating), path, spec())
    assert vibrating.vibration is not None
    assert_near(frames_of(path)[2], vibrating.vibration(2))
    prepared = pipeline.prepare(StoredScene(vibrating), spec(nw=5))
    assert prepared.medium.vibration is None and any("vibration" in note for note in prepared.notes)


def test_a_segment_without_vibration(tmp_path: Path) -> None:
    path = tmp_path / "a.touch"
    silent = replace(medium(3), vibration=lambda _: VibrationFrame.empty(GRID))
    pipeline.encode(StoredScene(silent), path, spec())
    assert [len(frame) for frame in frames_of(path)] == [0, 0, 0]
    with pipeline.open_file(path) as opened:
        assert opened.summary()["vibration_samples"] == 0 and opened.summary()["vibration_lowest_hz"] is None


def test_a_target_size_includes_the_vibration(tmp_path: Path) -> None:
    path = tmp_path / "a.touch"
    pipeline.encode(StoredScene(medium()), path, spec(vibration=RULE_TEXT))
    size = path.stat().st_size
    done = pipeline.encode_to_target(
        StoredScene(medium()), path, spec(vibration=RULE_TEXT), Target(size + 50, None)
    )
    assert done.file_bytes == path.stat().st_size <= size + 50
    assert len(frames_of(path)) == 5


def test_the_band_alone_keeps_the_file_open(tmp_path: Path) -> None:
    path = tmp_path / "a.touch"
    pipeline.encode(StoredScene(medium()), path, spec(vibration=RULE_TEXT))
    scene = StreamScene(path)
    band, file = scene.stored.vibration, scene.stored.make_frame._reader._source._file  # type: ignore[attr-defined]
    del scene
    assert band is not None and len(band(4)) and not file.closed
    del band
    assert file.closed


def test_vibration_of_a_file_of_objects_is_read(tmp_path: Path) -> None:
    """`encode` never writes it, but the format allows it on the grid of the head."""
    path, scene, paper_spec = tmp_path / "a.touch", moving_scene(3), PaperSpec(segment_frames=3)
    encoder = ObjectsEncoder(scene, paper_spec, F0_N)
    hums = [
        VibrationRule(low_hz=hz, high_hz=hz).of(field, 1.0)
        for hz, field in zip((40, 400, 150), scene.voxelise())
    ]
    with TouchWriter(path) as writer:
        writer.write_head(head_of(scene, encoder, paper_spec), {})
        for record in encoder.objects():
            writer.write_object(record_of(record))
        [segment] = encoder.segments()
        writer.write_vibration(*segment[:2], encode_vibration(hums))
        writer.write_segment(*segment)
    for found, expected in zip(frames_of(path), hums, strict=True):
        assert_near(found, expected)
    with pipeline.open_file(path) as opened:
        summary = opened.summary()
        assert summary["vibration_samples"] == sum(map(len, hums))
        assert (summary["vibration_lowest_hz"], summary["vibration_highest_hz"]) == (
            40,
            400,
        )  # not those of the last frame
    again = pipeline.prepare(path)  # and noted where it is dropped
    assert again.medium.vibration is None and any("vibration" in note for note in again.notes)
    prepared = pipeline.prepare(path, EncodeSpec(representation="voxel"))
    assert prepared.medium.vibration is not None


def test_objects_do_not_vibrate() -> None:
    with pytest.raises(InvalidArgument, match="take voxel"):
        spec(vibration=RULE_TEXT, representation="object")


def test_the_spec_round_trips_with_its_rule() -> None:
    requested = spec(vibration=RULE_TEXT)
    assert (
        EncodeSpec.from_json(requested.to_json()) == requested
        and requested.changed_options()["vibration"] == RULE_TEXT
    )
    assert "vibration" not in spec().to_json()
    with pytest.raises(CorruptFile):
        EncodeSpec.from_json(requested.to_json().replace(RULE_TEXT, "gain=no"))


def test_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, out, again = tmp_path / "sphere.toml", tmp_path / "a.touch", tmp_path / "b.touch"
    scene.write_text('[[shape]]\nkind = "sphere"\ncenter_m = [0.0, 0.0, 0.0]\nradius_m = 0.05\n')
    options = ["--nw", "4", "--effort", "fast", "--vibration", "gain=0.1,frequency=150"]
    assert _exit_code(["encode", str(scene), str(out), *options]) == 0
    capsys.readouterr()
    assert _exit_code(["info", str(out), "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert (
        summary["vibration_lowest_hz"] == summary["vibration_highest_hz"] == 150
        and summary["bits_vibration"] > 0
    )
    assert (
        _exit_code(["filter", str(out), str(again), "--effort", "fast", "--vibration", "frequency=60"]) == 0
    )
    assert {frame.frequencies_hz.max() for frame in frames_of(again)} == {60}
    capsys.readouterr()
    assert _exit_code(["filter", str(out), str(tmp_path / "f.npz"), "--vibration", "gain=0.1"]) == 2
    assert "--vibration works with OUT.touch, not with .npz" in capsys.readouterr().err
    assert _exit_code(["encode", str(scene), str(out), "--vibration", "loudness=3"]) == 2
    assert "such as gain=0.1,frequency=150" in capsys.readouterr().err
