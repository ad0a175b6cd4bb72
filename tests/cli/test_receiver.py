"""`touchfield play` and `doctor` end to end: logs, pictures, clear errors, and exit codes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from touchfield.cli.main import _exit_code
from touchfield.codec.touch.spec import TouchSpec
from touchfield.devices import device
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.trace import read_trace
from touchfield.pipeline import encode
from touchfield.pipeline.source import decode
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.spec import RenderSpec
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Sphere
from touchfield.sources.stored import StoredScene
from touchfield.sources.tiny_scenes import tiny_scenes
from touchfield.tasks.play import PlaySpec, play
from touchfield.tasks.play_log import COLUMNS

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("receiver") / "tiny.touch"
    encode(tiny_scenes()[1], path, EncodeSpec(nw=4))
    return path


@pytest.fixture(scope="module")
def long_stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stream of three segments."""
    forces = np.zeros((6, 6, 6, 3), np.float32)
    forces[..., 2] = 1.0
    grid = Grid((6, 6, 6), (0.01,) * 3, (-0.025,) * 3)
    fields = [ForceField.from_dense(grid, forces * (1 + n / 10)) for n in range(9)]
    path = tmp_path_factory.mktemp("receiver") / "long.touch"
    scene = StoredScene(HapticMedium.from_frames(fields, 30.0, "x right, y up, z towards the user"))
    encode(scene, path, EncodeSpec(nw=4, touch=TouchSpec(segment_frames=3)))
    return path


def _columns(log: Path) -> dict[str, np.ndarray]:
    lines = log.read_text().splitlines()
    assert tuple(lines[0].split(",")) == COLUMNS
    rows = [line.split(",") for line in lines[1:]]
    named = {name: [row[i] for row in rows] for i, name in enumerate(COLUMNS)}
    return {name: np.array(values, float) for name, values in named.items() if name != "state"}


def test_contact_friction_and_release(stream: Path, tmp_path: Path, capsys: Capture) -> None:
    pytest.importorskip("matplotlib", reason="the picture needs the extra report")
    log, plot = tmp_path / "forces.csv", tmp_path / "forces.png"
    arguments = [
        "play",
        str(stream),
        "--offline",
        "--friction",
        "0.5",
        "--log",
        str(log),
        "--plot",
        str(plot),
        "--json",
    ]
    assert _exit_code(arguments) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["underruns"] == 0 and 0.1 < values["contact_share"] < 0.95 and values["last_force_n"] == 0
    at = _columns(log)
    field = np.stack([at[f"field_{c}_n"] for c in "xyz"], axis=1)
    friction = np.stack([at[f"friction_{c}_n"] for c in "xyz"], axis=1)
    velocity = np.stack([at[f"v{c}_m_s"] for c in "xyz"], axis=1)
    force = np.stack([at[f"force_{c}_n"] for c in "xyz"], axis=1)
    assert not field[0].any() and not force[-1].any() and field.any()
    size = np.linalg.norm(friction, axis=1)
    assert size.max() > 0.1  # the probe slides
    assert (size <= 0.5 * np.linalg.norm(field, axis=1) + 1e-6).all()
    assert (
        friction * velocity
    ).sum() < 0  # friction acts as a spring while sticking and as a brake while sliding
    assert (np.linalg.norm(force, axis=1) <= 3.3).all()
    assert np.linalg.norm(np.diff(force, axis=0), axis=1).max() <= 3.3 / 0.005 * 0.001 + 1e-6
    with Image.open(plot) as image:
        assert len(np.unique(np.asarray(image.convert("L")))) > 50


def test_picture_has_millimetres_and_newtons(
    stream: Path, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib", reason="the picture needs the extra report")
    drawn: list[Any] = []
    monkeypatch.setattr("touchfield.viewer.interaction.write_png", lambda figure, path: drawn.append(figure))
    log = tmp_path / "forces.csv"
    assert (
        _exit_code(["play", str(stream), "--offline", "--log", str(log), "--plot", str(tmp_path / "a.png")])
        == 0
    )
    at, (hand, force, parts) = _columns(log), drawn[0].axes[:3]
    assert (hand.get_ylabel(), force.get_ylabel(), parts.get_ylabel()[:10]) == (
        "hand, mm",
        "|F|, N",
        "put out, N",
    )
    for axis, c in enumerate("xyz"):
        np.testing.assert_allclose(hand.lines[axis].get_ydata(), 1e3 * at[f"{c}_m"], rtol=1e-6)
        np.testing.assert_allclose(parts.lines[axis].get_ydata(), at[f"force_{c}_n"], atol=1e-6)
    size = np.linalg.norm([at[f"field_{c}_n"] for c in "xyz"], axis=0)
    np.testing.assert_allclose(force.lines[0].get_ydata(), size, atol=1e-6)


def test_limits_of_the_renderer_apply_to_hand_and_picture(tmp_path: Path) -> None:
    ball = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.03),))
    encode(ball, tmp_path / "ball.touch", EncodeSpec(nw=5, friction=0.4))
    omni, max_forces_n = device("phantom-omni"), []
    for limits, peak_n, continuous_n, friction in (
        (RenderSpec(), omni.force_max_n, omni.force_continuous_n, 0.4),
        (RenderSpec(peak_n=1.0, continuous_n=0.5, friction=0.0), 1.0, 0.5, 0.0),
    ):
        played = play(tmp_path / "ball.touch", PlaySpec(offline=True, is_drawn=True, render=limits))
        assert played.view is not None
        assert (played.view.peak_n, played.view.continuous_n) == (peak_n, continuous_n)
        assert (played.statistics["friction"], played.statistics["profile"]) == (friction, omni.name)
        max_forces_n.append(played.statistics["greatest_force_n"])
    # without a trajectory a hand presses by 0.8 of the continuous limit, as far as samples of 5 mm tell;
    # the rounding of the machine decides where on the ball
    assert max_forces_n[1] == pytest.approx(0.8 * 0.5, rel=0.15) and max_forces_n[1] < 0.5 < max_forces_n[0]


def test_picture_shows_the_middle_frame(long_stream: Path) -> None:
    played = play(long_stream, PlaySpec(offline=True, is_drawn=True))
    assert played.view is not None and played.view.background == decode(long_stream)[4]


def test_log_is_a_trajectory(stream: Path, tmp_path: Path, capsys: Capture) -> None:
    first, second = tmp_path / "one.csv", tmp_path / "two.csv"
    assert _exit_code(["play", str(stream), "--offline", "--log", str(first)]) == 0
    trace = read_trace(first)
    assert (
        _exit_code(["play", str(stream), "--offline", "--trajectory", str(first), "--log", str(second)]) == 0
    )
    capsys.readouterr()
    first_log, second_log = _columns(first), _columns(second)
    count = min(len(trace), len(second_log["t_s"]))
    for name in ("x_m", "field_z_n", "force_z_n"):
        np.testing.assert_allclose(second_log[name][: count - 1], first_log[name][: count - 1], atol=1e-6)


@pytest.mark.parametrize("option", ["--log", "--plot"])
def test_result_never_overwrites_the_stream(stream: Path, capsys: Capture, option: str) -> None:
    before = stream.read_bytes()
    assert _exit_code(["play", str(stream), "--offline", "--seconds", "0.1", option, str(stream)]) == 2
    assert capsys.readouterr().err.count("\n") == 1 and stream.read_bytes() == before


def test_clutch_is_in_millimetres_of_the_field(stream: Path, tmp_path: Path, capsys: Capture) -> None:
    positions_m, log, path = [], tmp_path / "log.csv", tmp_path / "still.csv"
    path.write_text("t_s,x_m,y_m,z_m\n0,0.001,0.002,0.003\n0.05,0.001,0.002,0.003\n")
    for clutch in ("0,0,0", "1,-2,3"):
        arguments = ["play", str(stream), "--offline", "--trajectory", str(path), "--clutch-mm", clutch]
        assert _exit_code([*arguments, "--log", str(log)]) == 0
        capsys.readouterr()
        at = _columns(log)
        positions_m.append([at[f"{c}_m"][10] for c in "xyz"])
    np.testing.assert_allclose(positions_m, [[0.001, 0.002, 0.003], [0.002, 0.0, 0.006]], atol=1e-9)


BOX = """v -0.01 -0.01 0\nv 0.01 -0.01 0\nv 0.01 0.01 0\nv -0.01 0.01 0\nv 0 0 0.02
f 1 3 2\nf 1 4 3\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5
"""


@pytest.mark.parametrize("tool", ["sphere:0.005", "sphere:0.005,points=200", "MESH", "MESH,points=300"])
def test_tool_receives_a_limited_torque(stream: Path, tmp_path: Path, capsys: Capture, tool: str) -> None:
    mesh, log = tmp_path / "tool.obj", tmp_path / "log.csv"
    mesh.write_text(BOX)
    path = tmp_path / "turned.csv"
    assert _exit_code(["play", str(stream), "--offline", "--log", str(log)]) == 0
    at = _columns(log)
    rows = zip(at["t_s"], at["x_m"], at["y_m"], at["z_m"], strict=True)
    rotated_rows = "".join(f"{t},{x},{y},{z},0.7071,0,0.7071,0\n" for t, x, y, z in rows)
    path.write_text("t_s,x_m,y_m,z_m,qw,qx,qy,qz\n" + rotated_rows)
    arguments = [
        "play",
        str(stream),
        "--offline",
        "--log",
        str(log),
        "--profile",
        "sigma.7",
        "--trajectory",
        str(path),
    ]
    assert _exit_code([*arguments, "--tool", tool.replace("MESH", str(mesh)), "--peak-nm", "0.05"]) == 0
    capsys.readouterr()
    at = _columns(log)
    torque = np.stack([at[f"torque_{c}_nm"] for c in "xyz"], axis=1)
    field_torque = np.stack([at[f"field_torque_{c}_nm"] for c in "xyz"], axis=1)
    assert at["qw"][5] == pytest.approx(0.5**0.5) and at["qy"][5] == pytest.approx(0.5**0.5)
    assert np.linalg.norm(field_torque, axis=1).max() > 0 and np.linalg.norm(torque, axis=1).max() <= 0.05
    assert np.linalg.norm(np.diff(torque, axis=0), axis=1).max() <= 0.05 / 0.005 * 0.001 + 1e-9
    assert not torque[-1].any()


@pytest.mark.parametrize(
    "tool",
    [
        "sphere",
        "sphere:x",
        "sphere:-1",
        "sphere:0.01,points=0",
        "point,points=3",
        "sphere:0.01,points=x",
        "no.obj",
    ],
)
def test_invalid_tools_are_one_clear_line(stream: Path, tool: str, capsys: Capture) -> None:
    assert _exit_code(["play", str(stream), "--offline", "--tool", tool]) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_real_time_play_in_a_separate_process(
    stream: Path, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("touchfield.tasks.play._DEFAULT_ROWS", 0)  # rows kept without a log
    log = tmp_path / "forces.csv"
    arguments = [
        "play",
        str(stream),
        "--seconds",
        "0.3",
        "--device",
        "sim:spring",
        "--log",
        str(log),
        "--json",
    ]
    assert _exit_code(arguments) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["ticks"] > 100 and values["last_force_n"] == 0
    times = _columns(log)["t_s"]
    assert times[0] == 0 and 100 < len(times) <= values["ticks"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--device", "hapley"], "--device: found 'hapley'"),
        (["--device", "sim:soft"], "sim:spring"),
        (["--peak-n", "9"], "the limit of phantom-omni"),
        (["--clutch-mm", "1,2"], "--clutch-mm"),
        (["--seconds", "-1"], "--seconds"),
        (["--start-s", "nan", "--offline"], "--start-s"),
        (["--speed", "0"], "--speed"),
        (["--device", "haply:127.0.0.1:1"], "127.0.0.1:1"),
        (["--device", "osc:127.0.0.1:9", "--offline"], "--offline"),
        (["--log", "no/such/folder/log.csv"], "no folder"),
        (["--trajectory", "nowhere.csv", "--offline"], "nowhere.csv"),
    ],
)
def test_invalid_options_are_one_clear_line(
    stream: Path, options: list[str], message: str, capsys: Capture
) -> None:
    assert _exit_code(["play", str(stream), *options]) != 0
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1 and "Traceback" not in error


@pytest.mark.parametrize(
    ("rows", "message"),
    [("0,0,0,0\n0.1,nan,0,0\n", "nan"), ("0,0,0,0\n0.2,0,0,0\n0.1,0,0,0\n", "0.1")],
)
def test_invalid_trajectories_are_one_clear_line(
    stream: Path, tmp_path: Path, rows: str, message: str, capsys: Capture
) -> None:
    path, log = tmp_path / "probe.csv", tmp_path / "log.csv"
    path.write_text("t_s,x_m,y_m,z_m\n" + rows)
    assert _exit_code(["play", str(stream), "--offline", "--trajectory", str(path), "--log", str(log)]) != 0
    error = capsys.readouterr().err
    assert "probe.csv" in error and message in error and error.count("\n") == 1
    assert not log.exists()


def _damaged_copy(stream: Path, path: Path) -> Path:
    """A copy of a stream with a damaged last segment."""
    from touchfield.container import TouchReader

    with TouchReader(stream) as reader:
        last = reader.segments[-1]
        at = last.offset + last.length // 2
    data = bytearray(stream.read_bytes())
    data[at] ^= 0x55
    path.write_bytes(bytes(data))
    return path


@pytest.mark.parametrize("options", [["--offline"], []])
def test_log_is_written_if_the_stream_fails_midway(
    options: list[str], long_stream: Path, tmp_path: Path, capsys: Capture
) -> None:
    path, log = _damaged_copy(long_stream, tmp_path / "spoilt.touch"), tmp_path / "log.csv"
    plot = tmp_path / "forces.png"
    arguments = ["play", str(path), "--seconds", "30", "--log", str(log), "--plot", str(plot)]
    assert _exit_code([*arguments, *options]) == 1 and not plot.exists()
    captured = capsys.readouterr()
    assert "CRC-32" in captured.err and "the log is" in captured.out
    at = _columns(log)
    assert len(at["t_s"]) > 50 and not any(at[f"force_{c}_n"][-1] for c in "xyz")


def test_late_frames_are_reported(stream: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> None:
    import touchfield.tasks.play as job

    for fraction, code in ((0.02, 1), (0.005, 0)):
        played = job.Played({"stalled_share": fraction}, None, None, ())
        monkeypatch.setattr(job, "play", lambda *_, played=played: played)
        assert _exit_code(["play", str(stream)]) == code
        assert ("frames came too late" in capsys.readouterr().out) == bool(code)


def test_options_reach_the_renderer(stream: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import touchfield.tasks.play as job

    specs: list[PlaySpec] = []
    monkeypatch.setattr(
        job, "play", lambda path, spec, *_: specs.append(spec) or job.Played({}, None, None, ())
    )
    arguments = [
        "play",
        str(stream),
        "--gravity-n",
        "0,-1,0.5",
        "--clutch-mm",
        "1,2,-3",
        "--no-blend",
        "--speed",
        "2",
    ]
    assert _exit_code(arguments) == _exit_code(arguments[:2]) == 0
    spec, default_spec = specs
    expected = RenderSpec(gravity_n=(0.0, -1.0, 0.5), clutch_m=(0.001, 0.002, -0.003), blend=False)
    assert spec == PlaySpec(speed=2.0, render=expected) and default_spec == PlaySpec()


def test_doctor_names_missing_parts_and_their_fixes(capsys: Capture) -> None:
    assert _exit_code(["doctor", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert {
        "libraries",
        "machine",
        "sim",
        "haply",
        "openhaptics",
        "forcedimension",
        "bhaptics",
        "osc",
        "pins",
    } <= set(report)
    for checks in report.values():
        assert all(check["is_there"] or check["mend"] for check in checks if isinstance(check, dict))
    assert _exit_code(["doctor", "--device", "sim"]) == 0
    assert "simulated hand" in capsys.readouterr().out
    assert _exit_code(["doctor", "--device", "nothing"]) != 0
    assert "one of" in capsys.readouterr().err
