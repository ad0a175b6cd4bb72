"""Recorded poses: the file and its faults, interpolation at any rate, and scenes posed by files only."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from touchfield.errors import InvalidArgument, MissingExtra, SourceError
from touchfield.medium import PoseTrack
from touchfield.medium.trace import Trace, read_trace
from touchfield.sources.options import SourceOptions
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.physics.toml_file import open_physics, read_physics
from touchfield.sources.poses import quaternion_of_euler, track_at_rate
from touchfield.sources.shapes.shapes import rotation_matrix

HEADER = "t_s,x_m,y_m,z_m,qw,qx,qy,qz\n"
GOOD = HEADER + "0.0,0,0,0.1,1,0,0,0\n0.5,0,0,0.2,0.7071,0,0,0.7071\n1.0,0.1,0,0.2,0,0,0,1\n"
angles = st.tuples(*[st.floats(-170, 170)] * 3)

SCENE = """
[[body]]
kind = "capsule"
radius_m = 0.01
half_length_m = 0.02
name = "finger"
poses = "track.csv"

[[body]]
kind = "box"
half_extents_m = [0.1, 0.1, 0.01]
position_m = [0, 0, -0.02]
rotation_deg = [0, 0, 30]
fixed = true
"""


def written(folder: Path, text: str, scene: str = SCENE) -> Path:
    (folder / "track.csv").write_text(text)
    (folder / "scene.toml").write_text(scene)
    return folder / "scene.toml"


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("1.0,", "0.25,", 4, "0.25 s after 0.5 s"),
        ("0.2,0.7071", "nan,0.7071", 3, "finite"),
        ("0.2,0.7071", "here,0.7071", 3, "finite"),
        ("0.7071,0,0,0.7071", "0.6,0,0,0.6", 3, "length 0.848"),
        ("0.7071,0,0,0.7071", "0,0,0,0", 3, "length 0"),
        ("0,0,0,1\n", "0,0,1\n", 4, "7 columns"),
        ("qw,qx,qy,qz", "qx,qy,qz", 1, "alone"),
        (HEADER, "", 1, "no column"),
    ],
)
def test_faults_name_file_and_line(tmp_path: Path, old: str, new: str, line: int, message: str) -> None:
    assert GOOD.count(old) == 1
    path = written(tmp_path, GOOD.replace(old, new))
    with pytest.raises(SourceError) as caught:
        open_physics(path, SourceOptions())
    assert f"track.csv line {line}" in str(caught.value) and message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", HEADER, "# nothing\n"])
def test_a_file_without_poses_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(SourceError, match=r"track\.csv: found (an empty file|a header and no sample)"):
        open_physics(written(tmp_path, text), SourceOptions())


def test_a_missing_pose_file_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD)
    (tmp_path / "track.csv").unlink()
    with pytest.raises(SourceError, match=r"track\.csv"):
        open_physics(path, SourceOptions())


def test_linear_and_at_constant_angular_velocity() -> None:
    times = np.array([0.0, 1.0, 3.0])
    positions = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 2.0, 0]])
    turns = np.array([[1.0, 0, 0, 0], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)], [0.0, 0, 0, 1.0]])
    track = track_at_rate(Trace(times, positions, turns), 10.0, 41)
    at = np.arange(41) / 10
    np.testing.assert_allclose(track.positions_m[:, 0], np.clip(at, 0, 1), atol=1e-12)
    np.testing.assert_allclose(track.positions_m[:, 1], np.clip(at - 1, 0, 2), atol=1e-12)
    angle = 2 * np.degrees(np.arctan2(track.quaternions[:, 3], track.quaternions[:, 0]))
    np.testing.assert_allclose(angle, np.interp(at, [0, 1, 3], [0, 90, 180]), atol=1e-9)


@given(angles, angles, st.floats(0.01, 1.0), st.booleans())
def test_interpolation_takes_the_shorter_arc(
    first: tuple, second: tuple, gap: float, is_other_sign: bool
) -> None:
    a, b = quaternion_of_euler(first), quaternion_of_euler(second)
    both = np.array([a, -b if is_other_sign else b])
    track = track_at_rate(Trace(np.array([0.0, gap]), np.zeros((2, 3)), both), 100 / gap, 101)
    np.testing.assert_allclose(track.rotation(0), rotation_matrix(first), atol=1e-9)
    np.testing.assert_allclose(track.rotation(100), rotation_matrix(second), atol=1e-9)
    steps = np.abs((track.quaternions[1:] * track.quaternions[:-1]).sum(axis=1))
    angle = np.arccos(min(abs(float(a @ b)), 1.0))
    np.testing.assert_allclose(np.cos(angle / 100), steps, atol=1e-9)


@given(angles)
def test_quaternion_of_turns_is_the_rotation_of_the_shapes(turns: tuple) -> None:
    track = PoseTrack(quaternion_of_euler(turns)[None], np.zeros((1, 3)))
    np.testing.assert_allclose(track.rotation(0), rotation_matrix(turns), atol=1e-12)


def test_a_scene_of_files_needs_no_mujoco(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    path = written(tmp_path, GOOD)
    scene = open_physics(path, SourceOptions())
    assert isinstance(scene, BodyScene)
    assert (scene.frame_count, scene.rate_hz, scene.axes) == (1001, 1000.0, "x east, y north, z up")
    finger, box = scene.bodies()
    assert (finger.name, box.name) == ("finger", "body 2")
    np.testing.assert_allclose(
        finger.track.positions_m[[0, 250, 1000]], [[0, 0, 0.1], [0, 0, 0.15], [0.1, 0, 0.2]]
    )
    assert box.track.is_constant
    np.testing.assert_allclose(box.track.rotation(7), rotation_matrix((0, 0, 30)), atol=1e-12)
    assert open_physics(path, SourceOptions(seconds=3.0, rate_hz=10.0)).frame_count == 30
    short = (
        SCENE.replace("finger", "thumb")
        .replace("track.csv", "short.csv")
        .partition('\n[[body]]\nkind = "box"')[0]
    )
    (tmp_path / "short.csv").write_text(GOOD.replace("1.0,0.1,0,0.2,0,0,0,1\n", ""))
    path.write_text(SCENE + short)
    assert open_physics(path, SourceOptions()).frame_count == 1001  # the duration of the longest file
    path.write_text("[physics]\nseconds = 2.0\nstep_s = 0.002\n" + SCENE)
    assert [open_physics(path, SourceOptions(seconds=seconds)).frame_count for seconds in (None, 0.5)] == [
        2000,
        500,
    ]
    assert read_physics(path).world.contact_s == 0.016  # 8 steps
    (tmp_path / "scene.toml").write_text(SCENE.replace("fixed = true", ""))
    with pytest.raises(MissingExtra, match=r"touchfield\[physics\]"):
        open_physics(path, SourceOptions())


def test_invalid_times_of_a_scene_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, HEADER + "1600000000,0,0,0,1,0,0,0\n")
    with pytest.raises(InvalidArgument, match=r"1.6e\+09 s at 1000 Hz.*begin at 0"):
        open_physics(path, SourceOptions())
    monkeypatch.setenv("TOUCHFIELD_MEMORY_GIB", "0.25")
    with pytest.raises(InvalidArgument, match="4000 s at 1000 Hz for 2 bodies"):
        open_physics(written(tmp_path, GOOD), SourceOptions(seconds=4000.0))


def test_poses_outside_the_time_of_the_scene_are_noted(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD)
    assert open_physics(path, SourceOptions()).notes == ()
    assert open_physics(path, SourceOptions(seconds=1.0)).notes == ()
    (note,) = open_physics(path, SourceOptions(seconds=0.5)).notes
    assert "finger" in note and "after 0.5 s" in note


def test_any_recorded_interaction_is_followed(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time [ms];x [mm];y [mm];z [mm]\n0;0;0;100\n500;0;0;200\n")
    track = track_at_rate(read_trace(tmp_path / "a.csv"), 4.0, 3)
    np.testing.assert_allclose(track.positions_m[:, 2], [0.1, 0.15, 0.2])
    np.testing.assert_array_equal(track.rotation(1), np.eye(3))  # never rotated
