"""Poses of a room in every form: frame-numbered, quaternion first, named columns, Open3D's JSON."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import room_makers as room
from touchfield.errors import SourceError
from touchfield.sources.depth.layouts import LAYOUTS
from touchfield.sources.options import SourceOptions
from touchfield.sources.poses import parse_poses

depth_folder = next(layout for layout in LAYOUTS if layout.name == "depth-folder")
MM = SourceOptions(depth_scale=1000)
POSES, COUNT = room.poses(), 4
QUATERNIONS, POSITIONS = room.quaternions(POSES), POSES[:, :3, 3]
W_FIRST = np.roll(QUATERNIONS, 1, axis=1)
NUMBERS = np.arange(COUNT)[:, None]
TIMES_NS = 1_600_000_000_000_000_000 + 40_000_000 * np.arange(COUNT)[:, None]


def rows(*columns: np.ndarray, separator: str = " ") -> str:
    return "".join(separator.join(f"{x:.15g}" for x in row) + "\n" for row in np.concatenate(columns, axis=1))


def trajectory() -> str:
    entries = [
        {"class_name": "PinholeCameraParameters", "extrinsic": np.linalg.inv(pose).T.ravel().tolist(),
         "intrinsic": {"width": room.WIDTH, "height": room.HEIGHT}, "version_major": 1, "version_minor": 0}
        for pose in POSES
    ]  # fmt: skip
    return json.dumps({"class_name": "PinholeCameraTrajectory", "parameters": entries})


def pose_graph() -> str:
    nodes = [{"class_name": "PoseGraphNode", "pose": pose.T.ravel().tolist()} for pose in POSES]
    return json.dumps({"class_name": "PoseGraph", "edges": [], "nodes": nodes})


FORMS: dict[str, tuple[str, str, str]] = {
    "number and 3x4": ("poses.txt", rows(NUMBERS, POSES[:, :3].reshape(COUNT, 12)), "frame numbers and 3x4"),
    "number and 4x4": ("poses.txt", rows(NUMBERS, POSES.reshape(COUNT, 16)), "frame numbers and 4x4"),
    "number and quaternion": (
        "poses.txt", rows(NUMBERS, POSITIONS, QUATERNIONS), "time tx ty tz qx qy qz qw",
    ),
    "quaternion first": ("poses.txt", rows(W_FIRST, POSITIONS), "qw qx qy qz tx ty tz"),
    "number, quaternion first": ("poses.txt", rows(NUMBERS, W_FIRST, POSITIONS), "time qw qx qy qz tx ty tz"),
    "comment names w first": (
        "poses.txt", "# tx ty tz qw qx qy qz\n" + rows(POSITIONS, W_FIRST), "columns x y z qw qx qy qz",
    ),
    "stray scanner": (
        "odometry.csv",
        "timestamp, frame, x, y, z, qx, qy, qz, qw, fx, fy, cx, cy\n"
        + rows(TIMES_NS / 1e9, NUMBERS, POSITIONS, QUATERNIONS, np.ones((COUNT, 4)), separator=", "),
        "columns time frame x y z qx qy qz qw",
    ),
    "euroc": (
        "trajectory.csv",
        "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],"
        "v_RS_R_x [m s^-1]\n"
        + rows(NUMBERS, POSITIONS, W_FIRST, np.ones((COUNT, 1)), separator=","),
        "columns time x y z qw qx qy qz",
    ),
    "names": (
        "poses.txt",
        "".join(f"{i:03d}.png {line}\n" for i, line in enumerate(rows(POSITIONS, QUATERNIONS).splitlines())),
        "matched by the names of pictures",
    ),
    "open3d trajectory": ("trajectory.json", trajectory(), "PinholeCameraTrajectory"),
    "open3d pose graph": ("poses.json", pose_graph(), "PoseGraph"),
}  # fmt: skip


def write_room(folder: Path, name: str = "depth/{:03d}.png") -> Path:
    for i, values in enumerate(room.depths_mm()):
        room.write_png(folder / name.format(i), values)
    (folder / "intrinsics.txt").write_text(" ".join(map(str, room.CAMERA)))
    return folder


@pytest.mark.parametrize("form", FORMS)
def test_the_room_is_where_the_poses_say(tmp_path: Path, form: str) -> None:
    name, text, note = FORMS[form]
    (write_room(tmp_path) / name).write_text(text)
    sequence = depth_folder.read_sequence(tmp_path, MM)
    room.assert_room(sequence)
    assert np.allclose(sequence.poses, POSES, atol=1e-9)
    assert any(name in text and note in text for text in sequence.notes), sequence.notes


@pytest.mark.parametrize("form", ["number and 4x4", "number and quaternion", "stray scanner"])
def test_poses_are_matched_by_the_number_of_the_frame(tmp_path: Path, form: str) -> None:
    """Entries in another order, and one frame without a pose."""
    name, text, _ = FORMS[form]
    lines = text.splitlines()
    head, body = lines[: len(lines) - COUNT], lines[-COUNT:]
    (write_room(tmp_path) / name).write_text("\n".join([*head, body[3], body[0], body[2]]))
    sequence = depth_folder.read_sequence(tmp_path, MM)
    assert np.allclose(sequence.poses, POSES[[0, 2, 3]], atol=1e-9)
    assert any("1 of 4 frames left out" in note for note in sequence.notes)
    room.assert_room(sequence, count=3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# tx ty tz qx qy qz qw\n1 2 3 0 0 0 1.5", "another norm"),
        ("# tx ty tz qx qy qz qw\n1 2 3 0 0 1", "6 numbers"),
        ("# tx ty tz qx qy qz qw\n", "no pose"),
        ("# frame tx ty tz qx qy qz qw\n0.5 1 2 3 0 0 0 1", "no frame number"),
        ("nan 1 0 0 0 0 1 0 0 0 0 1 0", "a key that is not finite"),
        ("0 1 0 0 0 0 1 0 0 0 0 2 0", "no rotation"),
        ('{"class_name": "PinholeCameraTrajectory", "parameters": [{"extrinsic": [1, 2]}]}', "without poses"),
        ('{"class_name": "PinholeCameraTrajectory", "parameters": []}', "no pose"),
        ('{"class_name": "PoseGraph"}', "without poses"),
        ("1 1 0 0 0 0 1e999 0 1 a.png", "numbers that are not finite"),
    ],
)
def test_invalid_poses_name_the_file_and_the_fault(text: str, message: str) -> None:
    with pytest.raises(SourceError, match=rf"p\.txt.*{message}"):
        parse_poses(text, "p.txt")
