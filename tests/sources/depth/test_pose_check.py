"""Poses are checked against depth: right ones raise no alarm; for wrong ones the reading that fits is named.

The inputs are pictures of a synthetic room, whose poses are written in every form that tools write.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import corridor_makers as corridors
import depth_makers as make
import fusion_makers as rooms
from touchfield.errors import InvalidArgument
from touchfield.medium import Grid
from touchfield.sources.depth import pose_check
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.depth.fused_scene import FusedScene
from touchfield.sources.depth.layouts import KINDS, checked_sequence
from touchfield.sources.depth.pose_form import FORMS, parse_pose_form, read_poses_as
from touchfield.sources.laws import ForceProfile
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source

FRAMES = 5
TRUE = rooms.walk(FRAMES)
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
FLIP_Y = np.diag([1.0, -1.0, 1.0, 1.0])
BODY = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""Axes of a ROS body (x forward, y left, z up) from those of the pictures."""


def scaled(poses: np.ndarray, factor: float) -> np.ndarray:
    out = poses.copy()
    out[:, :3, 3] *= factor
    return out


WRITTEN = {  # as a tool writes it, from the true poses
    "inverted": np.linalg.inv(TRUE),
    "opengl": TRUE @ OPENGL,
    "ros": TRUE @ np.linalg.inv(BODY),
    "mirrored": FLIP_Y @ TRUE @ FLIP_Y,
    "reversed": TRUE[::-1],
    "mm": scaled(TRUE, 1000),
    "cm": scaled(TRUE, 100),
    "inverted,opengl": np.linalg.inv(TRUE @ OPENGL),
    "mm,inverted": scaled(np.linalg.inv(TRUE), 1000),
}


def write_room(folder: Path, poses: np.ndarray = TRUE, units_per_m: float = 1000) -> Path:
    """Depth pictures, intrinsics and poses.txt, a 4x4 matrix a line."""
    for i, pose in enumerate(TRUE):
        depth = rooms.rendered_m(pose.tobytes(), rooms.BOX_M)
        make.write_png(folder / "depth" / f"{i}.png", np.round(depth * units_per_m).astype(np.uint16))
    k = rooms.CAMERA
    (folder / "intrinsics.txt").write_text(f"{k.fx} {k.fy} {k.cx} {k.cy}\n")
    make.write_rows(folder / "poses.txt", poses.reshape(-1, 16))
    return folder


def quaternion_rows(order: str) -> np.ndarray:
    xyzw = Rotation.from_matrix(TRUE[:, :3, :3]).as_quat()
    return np.hstack([TRUE[:, :3, 3], xyzw if order == "xyzw" else np.roll(xyzw, 1, axis=1)])


def note_of(folder: Path, **options: object) -> tuple[str, DepthScene]:
    scene = open_source(folder, SourceOptions(**{"depth_scale": 1000.0, **options}))
    (note,) = [note for note in scene.notes if note.startswith("Poses and depth")]
    return note, scene


def relative(poses: np.ndarray) -> np.ndarray:
    return np.linalg.inv(poses[0]) @ poses


def test_right_poses_agree(tmp_path: Path) -> None:
    note, scene = note_of(write_room(tmp_path))
    assert note.startswith("Poses and depth agree: 9") and not scene.sequence.has_wrong_poses


def write_corridor(folder: Path, step_m: float, unit_m: float = 1.0) -> Path:
    """24 pictures of a corridor without an end, which look alike wherever they are taken, up to 5 m."""
    v, u = np.mgrid[:60, :80]
    x, y = (u - 39.5) / 65, (v - 29.5) / 65
    depth = np.minimum(1.3 / np.maximum(y, 1e-6), 1.8 / np.maximum(np.abs(x), 1e-6))
    depth[depth > 5] = 0
    poses = np.tile(np.eye(4), (24, 1, 1))
    poses[:, 2, 3] = step_m / unit_m * np.arange(24)
    for i in range(24):
        make.write_png(folder / "depth" / f"{i:02d}.png", np.round(1000 * depth).astype(np.uint16))
    (folder / "intrinsics.txt").write_text("65 65 39.5 29.5\n")
    make.write_rows(folder / "poses.txt", poses.reshape(-1, 16))
    return folder


def test_right_poses_of_pictures_that_look_alike_agree(tmp_path: Path) -> None:
    """The pictures that are chosen by depth are up to 9.6 m apart, and see nothing in common."""
    note, scene = note_of(write_corridor(tmp_path / "m", 0.8))
    assert note.startswith("Poses and depth of near frames agree: ") and not scene.sequence.has_wrong_poses
    note, scene = note_of(write_corridor(tmp_path / "mm", 0.8, unit_m=1e-3))
    assert "disagree" in note and scene.sequence.has_wrong_poses


@pytest.mark.parametrize("form", WRITTEN)
def test_the_reading_that_fits_wrong_poses_is_named_and_mends_them(tmp_path: Path, form: str) -> None:
    folder = write_room(tmp_path, WRITTEN[form])
    note, scene = note_of(folder)
    assert note.startswith("Poses and depth disagree:") and scene.sequence.has_wrong_poses
    assert f"With --pose-form {form} (" in note
    mended, scene = note_of(folder, pose_form=form)
    assert mended.startswith("Poses and depth agree: 9") and not scene.sequence.has_wrong_poses
    assert f"Poses are read as {form.replace(',', ', ')} (--pose-form)." in scene.notes
    np.testing.assert_allclose(relative(scene.sequence.poses), relative(TRUE), atol=1e-5)


def test_quaternions_with_w_first_are_named(tmp_path: Path) -> None:
    folder = write_room(tmp_path)
    make.write_rows(folder / "poses.txt", quaternion_rows("wxyz"))
    note, _ = note_of(folder)
    assert "disagree" in note and "With --pose-form wxyz (" in note
    note, scene = note_of(folder, pose_form="wxyz")
    assert note.startswith("Poses and depth agree: 9")
    np.testing.assert_allclose(relative(scene.sequence.poses), relative(TRUE), atol=1e-5)
    make.write_rows(folder / "poses.txt", quaternion_rows("xyzw"))
    assert note_of(folder)[0].startswith("Poses and depth agree: 9")


def test_poses_in_the_alphabetical_order_of_unpadded_names_are_named(tmp_path: Path) -> None:
    """A script that lists 0, 1, 10, 11, 2 writes the poses in that order."""
    poses = rooms.walk(12)
    for i, pose in enumerate(poses):
        depth = rooms.rendered_m(pose.tobytes(), rooms.BOX_M)
        make.write_png(tmp_path / "depth" / f"{i}.png", np.round(depth * 1000).astype(np.uint16))
    k = rooms.CAMERA
    (tmp_path / "intrinsics.txt").write_text(f"{k.fx} {k.fy} {k.cx} {k.cy}\n")
    order = sorted(range(12), key=str)
    make.write_rows(tmp_path / "poses.txt", poses[order].reshape(-1, 16))
    note, _ = note_of(tmp_path)
    assert "disagree" in note and "With --pose-form alphabetical (" in note
    note, scene = note_of(tmp_path, pose_form="alphabetical")
    assert note.startswith("Poses and depth agree")
    np.testing.assert_allclose(relative(scene.sequence.poses), relative(poses), atol=1e-5)


def test_another_depth_unit_is_named_where_poses_show_it(tmp_path: Path) -> None:
    folder = write_room(tmp_path, units_per_m=5000)
    note, _ = note_of(folder)
    assert "disagree" in note and "With --depth-scale 5000 (" in note
    assert note_of(folder, depth_scale=5000.0)[0].startswith("Poses and depth agree: 9")


def test_a_form_that_is_wrong_is_mended_from_the_poses_of_the_file(tmp_path: Path) -> None:
    note, _ = note_of(write_room(tmp_path / "right"), pose_form="inverted")
    assert "disagree" in note and "With no --pose-form (scene from camera)" in note
    note, _ = note_of(write_room(tmp_path / "gl", TRUE @ OPENGL), pose_form="inverted")
    assert "With --pose-form opengl (" in note


def test_poses_of_another_sequence_are_doubted_without_a_reading(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    random = np.tile(np.eye(4), (FRAMES, 1, 1))
    random[:, :3, :3] = Rotation.from_rotvec(0.4 * rng.standard_normal((FRAMES, 3))).as_matrix()
    note, scene = note_of(write_room(tmp_path, random))
    assert "no other reading of the poses fits" in note and "--frame camera" in note
    assert scene.sequence.has_wrong_poses


def test_a_camera_at_rest_with_poses_that_move_is_named(tmp_path: Path) -> None:
    folder = write_room(tmp_path)
    for i in range(1, FRAMES):
        (folder / "depth" / f"{i}.png").write_bytes((folder / "depth" / "0.png").read_bytes())
    assert "With --frame camera (" in note_of(folder)[0]


WALL = ForceProfile(((-0.18, 0.0, 0.0, -18.0),))
MOVED = [(0.55 - 0.12 * i, 0.3, 2.0) for i in range(FRAMES)]


def late_note(sequence: rooms.Room) -> str:
    scene = FusedScene(checked_sequence(sequence, SourceOptions()))
    low, high = scene.bounds_m()
    scene.field(0, Grid.over_box(low - 0.05, high + 0.05, (48, 48, 48)), WALL)
    return " ".join(scene.late_notes())


def test_a_moving_part_is_stated_only_where_the_rest_agrees() -> None:
    """The same pictures, in which a box moves, under right and under inverted poses."""
    right = late_note(rooms.Room(TRUE, MOVED))
    assert "of the world moves, and follows the frames; the rest is static" in right
    wrong = rooms.Room(TRUE, MOVED)
    wrong.poses = np.linalg.inv(TRUE)
    note = late_note(wrong)
    assert "moves" not in note and "poses and depth disagree" in note


def test_no_verdict_without_evidence(tmp_path: Path) -> None:
    """Without poses, for one frame, and for pictures of too few pixels."""
    folder = write_room(tmp_path / "room")
    assert pose_check.check_poses(rooms.Room(TRUE[:1])) is None
    (folder / "poses.txt").unlink()
    notes = open_source(folder, SourceOptions(depth_scale=1000.0)).notes
    assert not any("Poses and depth" in note for note in notes)
    small = open_source(make.write_matrix_rows(tmp_path / "small"), SourceOptions(depth_scale=1000.0))
    assert small.sequence.poses is not None and not any("Poses and depth" in note for note in small.notes)


@pytest.mark.parametrize(
    ("form", "message"),
    [
        ("sideways", "'sideways'; expected words of"),
        (",", "expected words of"),
        ("opengl,ros", "opengl and ros; expected one of"),
        ("mm,cm", "mm and cm; expected one of"),
        ("wxyz", "wxyz for poses without quaternions"),
    ],
)
def test_a_wrong_form_is_refused(tmp_path: Path, form: str, message: str) -> None:
    with pytest.raises(InvalidArgument, match=f"--pose-form: found .*{message}"):
        open_source(write_room(tmp_path), SourceOptions(depth_scale=1000.0, pose_form=form))


def test_a_form_of_poses_that_are_not_there_is_refused(tmp_path: Path) -> None:
    (write_room(tmp_path) / "poses.txt").unlink()
    with pytest.raises(InvalidArgument, match="--pose-form: found a source without poses"):
        open_source(tmp_path, SourceOptions(depth_scale=1000.0, pose_form="inverted"))


def test_words_are_applied_in_one_order() -> None:
    assert parse_pose_form(" OpenGL, inverted,wxyz") == ("wxyz", "inverted", "opengl")
    assert set(parse_pose_form("inverted")) < set(FORMS)
    np.testing.assert_allclose(read_poses_as(WRITTEN["mm,inverted"], ("mm", "inverted")), TRUE, atol=1e-12)


def test_an_error_is_the_distance_from_the_four_pixels_around_a_point() -> None:
    depth = np.full((8, 10), 2.0, np.float32)
    depth[4:, :] = 2.1
    k = rooms.CAMERA.__class__(10.0, 10.0, 4.5, 3.5)
    points = np.array([[0.0, 0, 2.0], [0, -0.3, 2.2], [0, 0.3, 1.05], [9, 0, 1], [0, 0, -1]]).T
    errors = pose_check.relative_errors(points, depth, np.eye(4), k)
    np.testing.assert_allclose(errors, [0, 0.2 / 2.2, 1.05 / 1.05], rtol=1e-6)  # outside and behind: left out


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "kind", "options", "min_fraction"),
    [
        ("rgbd_tum_fr1_rpy", "tum", {"intrinsics": "517.3,516.5,318.6,255.3"}, 0.85),
        ("rgbd_iclnuim_livingroom1", "redwood", {}, 0.95),
    ],
)
def test_real_sequences_raise_no_alarm(
    shared_data: Path, name: str, kind: str, options: dict[str, str], min_fraction: float
) -> None:
    scene = KINDS[kind].open(shared_data / name, SourceOptions(**options))
    check = pose_check.check_poses(scene.sequence)
    assert check is not None and check.is_right and not scene.sequence.has_wrong_poses
    assert check.agreement.fraction >= min_fraction and check.agreement.median_error < 0.01
    scene.sequence.poses = np.linalg.inv(scene.sequence.poses)
    check = pose_check.check_poses(scene.sequence)
    assert check is not None and "With --pose-form inverted (" in check.note


def write_walk(folder: Path, poses: np.ndarray) -> Path:
    """A walk between two walls, with a box and a hole, seen to 5 m: pictures far apart are alike."""
    turn = Rotation.from_euler("x", -20, degrees=True).as_matrix()
    k = corridors.kinect()
    v, u = np.mgrid[:120, :160]
    rays = np.stack([(u - k.cx) / k.fx, (v - k.cy) / k.fy, np.ones(u.shape)], -1) @ turn.T
    x, y, z = np.moveaxis(rays, -1, 0)
    rng = np.random.default_rng(0)
    for n in range(80):
        front = (3.5 - 0.06 * n) / z
        is_box = (np.abs(front * x - 0.6) < 0.2) & (front * y > 0.55) & (front > 0)
        floor = 1.35 / np.maximum(y, 1e-6)
        floor = np.where(np.abs(0.06 * n + floor * z - 6.8) < 0.5, floor * 1.95 / 1.35, floor)
        depth = np.minimum(floor, 1.8 / np.maximum(np.abs(x), 1e-6))
        depth = np.where(is_box, np.minimum(depth, front), depth)
        depth += 0.002 * depth**2 * rng.normal(size=depth.shape)
        depth[(depth < 0.5) | (depth > 5)] = 0
        make.write_png(folder / "depth" / f"{n:02d}.png", np.round(1000 * depth).astype(np.uint16))
    (folder / "intrinsics.txt").write_text(f"{k.fx} {k.fy} {k.cx} {k.cy}\n")
    np.savetxt(folder / "poses.txt", poses.reshape(len(poses), 16))
    return folder


def walk_along_corridor() -> np.ndarray:
    poses = np.tile(np.eye(4), (80, 1, 1))
    poses[:, :3, :3] = Rotation.from_euler("x", -20, degrees=True).as_matrix()
    poses[:, 2, 3] = 0.06 * np.arange(80)
    return poses


@pytest.mark.parametrize(("form", "is_right"), [("", True), ("opengl", False), ("mm", False), ("ros", False)])
def test_frames_of_a_corridor_that_are_alike_do_not_refute_its_poses(
    tmp_path: Path, form: str, is_right: bool
) -> None:
    true = walk_along_corridor()
    written = {
        "": true,
        "opengl": true @ OPENGL,
        "mm": scaled(true, 1000),
        "ros": true @ np.linalg.inv(BODY),
    }[form]
    folder = write_walk(tmp_path, written)
    scene = open_source(folder, SourceOptions(depth_scale=1000.0))
    assert isinstance(scene, DepthScene)
    assert scene.sequence.has_wrong_poses == (not is_right)
