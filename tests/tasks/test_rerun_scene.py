"""`view --rerun`: what a recording of Rerun holds, read back by its library, and logs that are refused."""

from __future__ import annotations

import signal
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from touchfield.cli.main import _exit_code
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import SourceError
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.network.opening import open_stream
from touchfield.pipeline import encode
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.stored import StoredScene
from touchfield.tasks import play_log, play_mcap_log, rerun_scene
from touchfield.tasks.play_log import read_log
from touchfield.tasks.play_mcap_log import read_mcap_log
from touchfield.tasks.rerun_scene import view_in_rerun

BODIES = Path(__file__).parents[2] / "conformance" / "v1" / "objects-rigid.touch"
HEADER = "media_s,x_m,y_m,z_m,field_x_n,field_y_n,field_z_n,friction_x_n,friction_y_n,friction_z_n,state"
ROW = "0.5,1,2,3,0.1,0.2,0.3,0.01,0.02,0.03,running"


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stream of five frames, whose force becomes stronger."""
    forces = np.zeros((6, 6, 6, 3), np.float32)
    forces[1:5, 1:5, 1:5, 2] = 1.0
    grid = Grid((6, 6, 6), (0.01,) * 3, (-0.025,) * 3)
    fields = [ForceField.from_dense(grid, forces * (1 + n / 10)) for n in range(5)]
    path = tmp_path_factory.mktemp("rerun") / "moving.touch"
    scene = StoredScene(HapticMedium.from_frames(fields, 20.0, "x right, y up, z towards the user"))
    encode(scene, path, EncodeSpec(nw=4, touch=TouchSpec(effort="fast")))
    return path


def recorded(path: Path) -> dict[str, dict[str, list[Any]]]:
    """The values of each component, a list for each row, by entity; times are nanoseconds."""
    chunk = pytest.importorskip("rerun.chunk", reason="needs the extra rerun, 0.41 or newer, to read it back")
    values: dict[str, dict[str, list[Any]]] = defaultdict(lambda: defaultdict(list))
    for part in chunk.RrdReader(str(path)).stream():
        batch = part.to_record_batch()
        for name in batch.schema.names:
            column = batch.column(name)
            is_time = name == rerun_scene.TIMELINE
            values[part.entity_path][name] += (column.cast("int64") if is_time else column).to_pylist()
    return values


def test_fields_and_the_hand_are_on_the_clock_of_the_medium(stream: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="needs the extra rerun")
    log, out = tmp_path / "log.csv", tmp_path / "a.rrd"
    assert _exit_code(["play", str(stream), "--offline", "--speed", "2", "--log", str(log)]) == 0
    assert _exit_code(["view", str(stream), "--rerun", "--out", str(out), "--log", str(log)]) == 0
    values, ticks = recorded(out), read_log(log)
    samples, forces = values["/field/samples"], values["/field/forces"]
    times_ns = [round(n * 1e9 / 20) for n in range(5)]
    assert samples["media"] == forces["media"] == times_ns
    with open_stream(stream) as opened:
        for n, (points, colors) in enumerate(zip(samples["Points3D:positions"], samples["Points3D:colors"])):
            field = opened.medium[n]
            expected = field.grid.to_m(field.positions())
            assert len(points) == len(colors) == len(expected)
            np.testing.assert_allclose(np.sort(points, axis=0), np.sort(expected, axis=0), atol=1e-6)
            arrows, tails = np.array(forces["Arrows3D:vectors"][n]), forces["Arrows3D:origins"][n]
            felt_n = field.sample_n(np.array(tails, np.float64))
            ratio = np.linalg.norm(arrows, axis=1) / np.linalg.norm(felt_n, axis=1)
            np.testing.assert_allclose(arrows, felt_n * ratio[:, None], atol=1e-6)
            np.testing.assert_allclose(ratio, ratio[0], rtol=1e-3)
    hand, force = values["/hand/position"], values["/hand/force"]
    np.testing.assert_allclose(np.array(hand["media"]) / 1e9, ticks[:, 0], atol=1e-8)
    np.testing.assert_allclose(
        [p for (p,) in filter(None, hand["Points3D:positions"])], ticks[:, 1:4], atol=1e-7
    )
    vectors = [v for (v,) in filter(None, force["Arrows3D:vectors"])]
    np.testing.assert_allclose(vectors, 0.01 * ticks[:, 4:], atol=1e-7)
    curve = [s for (s,) in values["/hand/force_n"]["Scalars:scalars"]]
    np.testing.assert_allclose(curve, np.linalg.norm(ticks[:, 4:], axis=1), rtol=1e-6)
    assert ticks[:, 4:].any()


def test_bodies_have_their_poses_and_one_field(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="needs the extra rerun")
    out = tmp_path / "a.rrd"
    done = view_in_rerun(BODIES, out)
    values = recorded(out)
    with open_stream(BODIES) as opened:
        scene = opened.scene
        assert scene is not None and done.summary["bodies"] == len(scene.objects)
        for number, body in enumerate(scene.objects):
            poses = values[f"/field/bodies/{number}"]
            translations = [t for (t,) in poses["Transform3D:translation"]]
            np.testing.assert_allclose(translations, body.track.positions_m, atol=1e-6)
            quaternions = np.array([q for (q,) in poses["Transform3D:quaternion"]])
            np.testing.assert_allclose(quaternions[:, [3, 0, 1, 2]], body.track.quaternions, atol=1e-6)
            (points,) = values[f"/field/bodies/{number}/field/samples"]["Points3D:positions"]
            assert len(points) == body.field(0).support_count


@pytest.mark.parametrize(
    ("axes", "expected"),
    [
        ("x east, y north, z up", [3, 5, 1]),
        ("x right, y up, z towards the user", [3, 1, 6]),
        ("x right, y down, z away from the user", [3, 2, 5]),
        ("x red, y green, z blue", None),
    ],
)
def test_the_viewer_knows_what_is_up(tmp_path: Path, axes: str, expected: list[int] | None) -> None:
    """Rerun's numbers of directions: 1 up, 2 down, 3 right, 4 left, 5 forward, 6 back."""
    pytest.importorskip("rerun", reason="needs the extra rerun")
    field = ForceField.from_dense(Grid((4, 4, 4), (0.01,) * 3, (0.0,) * 3), np.ones((4, 4, 4, 3), np.float32))
    path = tmp_path / "a.touch"
    encode(StoredScene(HapticMedium.from_frames([field], 1.0, axes)), path, EncodeSpec(nw=4))
    done = view_in_rerun(path, tmp_path / "a.rrd")
    assert any("no direction is known as up" in note for note in done.notes) == (expected is None)
    if expected is not None:
        (found,) = recorded(tmp_path / "a.rrd")["/"]["ViewCoordinates:xyz"]
        assert np.ravel(found).tolist() == expected


def test_what_is_left_out_is_reported(stream: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rerun", reason="needs the extra rerun")
    limits = {"MAX_POINTS": 20, "MAX_ARROWS": 7, "MAX_FIELDS": 3, "MAX_POSES": 2}
    for name, limit in limits.items():
        monkeypatch.setattr(rerun_scene, name, limit)
    (tmp_path / "log.csv").write_text(f"{HEADER}\n" + 5 * f"{ROW}\n")
    done = view_in_rerun(stream, tmp_path / "a.rrd", tmp_path / "log.csv")
    assert done.summary == {"fields": 3, "points": 60, "arrows": 21, "bodies": 0, "poses": 0, "ticks": 2}
    assert done.notes == (
        "3 of 5 frames of a field are shown",
        "at most 20 samples of a field are shown, at random",
        "2 of 5 ticks of the log are shown",
    )
    assert {
        len(points) for points in recorded(tmp_path / "a.rrd")["/field/samples"]["Points3D:positions"]
    } == {20}


def test_a_log_has_the_force_with_friction(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(f"{HEADER}\n{ROW}\n{ROW.replace('0.5', 'nan')}\n")
    np.testing.assert_allclose(read_log(path), [[0.5, 1, 2, 3, 0.11, 0.22, 0.33]])


def test_both_formats_of_a_log_show_the_same_hand(stream: Path, tmp_path: Path) -> None:
    pytest.importorskip("mcap", reason="needs the extra mcap")
    logs = [tmp_path / name for name in ("log.csv", "log.mcap")]
    for log in logs:
        assert _exit_code(["play", str(stream), "--offline", "--speed", "2", "--log", str(log)]) == 0
    text, container = read_log(logs[0]), read_mcap_log(logs[1])
    np.testing.assert_allclose(container, text, rtol=1e-6, atol=1e-9)
    assert len(text) > 50 and text[:, 4:].any()


def test_a_log_in_mcap_is_shown(stream: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="needs the extra rerun")
    pytest.importorskip("mcap", reason="needs the extra mcap")
    log, out = tmp_path / "log.MCAP", tmp_path / "a.rrd"
    assert _exit_code(["play", str(stream), "--offline", "--log", str(log)]) == 0
    assert _exit_code(["view", str(stream), "--rerun", "--out", str(out), "--log", str(log)]) == 0
    hand, ticks = recorded(out)["/hand/position"], read_mcap_log(log)
    np.testing.assert_allclose(
        [p for (p,) in filter(None, hand["Points3D:positions"])], ticks[:, 1:4], atol=1e-7
    )


def mcap_file(path: Path, *messages: tuple[str, str]) -> Path:
    """An MCAP file with messages of JSON, each topic and text."""
    writer_of = pytest.importorskip("mcap.writer", reason="needs the extra mcap")
    with path.open("wb") as file:
        writer = writer_of.Writer(file)
        writer.start()
        schema = writer.register_schema("touchfield.Tick", "jsonschema", b"{}")
        for topic, text in messages:
            channel = writer.register_channel(topic, "json", schema)
            writer.add_message(channel, 5, text.encode(), 5)
        writer.finish()
    return path


POSE = '{"pose": {"position": {"x": 1, "y": 2, "z": 3}}}'
VECTOR = '{"x": 0.1, "y": 0.2, "z": 0.3}'
TICK = f'{{"media_s": 0.5, "field": {{"force": {VECTOR}}}, "friction": {VECTOR}}}'


@pytest.mark.parametrize(
    ("messages", "found"),
    [
        ([], "no tick"),
        ([("/hand/pose", POSE)], "no tick"),
        ([("/other", POSE)], "no tick"),
        ([("/hand/pose", POSE), ("/hand/tick", "{")], "a message that is no tick"),
        ([("/hand/pose", "[]"), ("/hand/tick", TICK)], "a message that is no tick"),
        ([("/hand/pose", POSE), ("/hand/tick", TICK.replace("0.5", "null"))], "a message that is no tick"),
        ([("/hand/pose", POSE), ("/hand/tick", TICK.replace("0.5", "NaN"))], "no tick"),
    ],
)
def test_an_mcap_file_that_is_no_log_is_refused(
    tmp_path: Path, messages: list[tuple[str, str]], found: str
) -> None:
    with pytest.raises(SourceError, match=f"found {found}.*expected a log of `touchfield play"):
        read_mcap_log(mcap_file(tmp_path / "log.mcap", *messages))


def test_a_tick_of_mcap_has_the_force_with_friction(tmp_path: Path) -> None:
    path = mcap_file(tmp_path / "log.mcap", ("/hand/pose", POSE), ("/hand/tick", TICK))
    np.testing.assert_allclose(read_mcap_log(path), [[0.5, 1, 2, 3, 0.2, 0.4, 0.6]])


@pytest.mark.parametrize("content", [b"", b"t_s,x_m\n1,2\n", b"\x89MCAP0\r\n" + 99 * b"\xff"])
def test_text_under_the_ending_of_mcap_is_refused(tmp_path: Path, content: bytes) -> None:
    pytest.importorskip("mcap", reason="needs the extra mcap")
    path = tmp_path / "log.mcap"
    path.write_bytes(content)
    with pytest.raises(SourceError, match="no sound MCAP"):
        read_mcap_log(path)


def test_a_long_log_in_mcap_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = mcap_file(tmp_path / "log.mcap", ("/hand/pose", POSE), ("/hand/tick", TICK))
    monkeypatch.setattr(play_mcap_log, "MAX_ROWS", 0)
    with pytest.raises(SourceError, match="more than 0 ticks"):
        read_mcap_log(path)


@pytest.mark.parametrize("option", ["--trajectory", "--trace"])
def test_a_path_in_mcap_is_refused_with_the_way_out(
    stream: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str
) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(b"")
    assert _exit_code(["play", str(stream), "--offline", option, str(path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"touchfield: {option}: found {path}, an MCAP file") and "--log OUT.csv" in error


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", "no column media_s"),
        (f"{HEADER}\n", "no tick"),
        ("t_s,x_m\n1,2\n", "no column media_s"),
        (f"{HEADER}\n{ROW.rpartition('0.03')[0]}\n", "a row that is no tick"),
        (f"{HEADER}\n{ROW.replace('0.1,', 'much,')}\n", "a row that is no tick"),
        (f"{HEADER}\n{ROW.replace('0.5', 'nan')}\n", "no tick"),
        ("x" * 100_000, "no column media_s"),
    ],
)
def test_a_file_that_is_no_log_is_refused(tmp_path: Path, text: str, found: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(SourceError, match=f"found {found}.*expected a log of `touchfield play"):
        read_log(path)


def test_a_long_log_is_refused_by_its_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.csv"
    path.write_text(f"{HEADER}\n{ROW}\n")
    monkeypatch.setattr(play_log, "MAX_ROWS", 0)
    with pytest.raises(SourceError, match=r"found \d+ bytes; expected at most 0"):
        read_log(path)


def test_a_full_disk_leaves_no_file(stream: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The library only prints that it could not write: an incomplete file would look like a whole one."""
    pytest.importorskip("rerun", reason="needs the extra rerun")
    resource = pytest.importorskip("resource", reason="limits the size of a file")
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        with pytest.raises(SourceError, match=r"a\.rrd: found that it cannot be written"):
            view_in_rerun(stream, tmp_path / "a.rrd")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)
    assert not [*tmp_path.iterdir()]


def test_a_missing_library_is_named(
    stream: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert _exit_code(["view", str(stream), "--rerun", "--out", str(tmp_path / "a.rrd")]) == 2
    error = capsys.readouterr().err
    assert "the library rerun-sdk is not installed" in error and "touchfield[rerun]" in error
    assert error.count("\n") == 1 and not [*tmp_path.iterdir()]
