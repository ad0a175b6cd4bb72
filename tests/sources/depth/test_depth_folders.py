"""Depth folders of users: poses and cameras in every form, found and noted, or named as unread."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

import depth_makers as make
from touchfield.errors import InvalidArgument, SourceError
from touchfield.sources import poses
from touchfield.sources.camera import Intrinsics
from touchfield.sources.depth.intrinsics_file import camera_of, parse_intrinsics
from touchfield.sources.depth.layouts import LAYOUTS as DEPTH_LAYOUTS
from touchfield.sources.depth.recorders import nerfstudio
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import kinds, open_source

tum, redwood, sun3d, threedmatch, depth_folder, depth_map, depth_stack, _ = DEPTH_LAYOUTS

MM = SourceOptions(depth_scale=1000)
LAYOUTS: dict[Callable[[Path], Path], str] = {
    make.write_matrix_rows: "a 4x4 matrix a line, scene from camera",
    make.write_kitti: "a 3x4 matrix a line, scene from camera",
    make.write_stacked: "4x4 matrices, scene from camera; one for each frame",
    make.write_timed: "the nearest in time",
    make.write_timed_poses_txt: "one for each frame, in order",
    make.write_freiburg: "livingRoom1n.gt.freiburg",
    make.write_slambook: "tx ty tz qx qy qz qw, scene from camera; one for each frame",
    make.write_log: "a log of 4x4 matrices",
    make.write_colmap: "camera from scene, turned round",
    make.write_nerfstudio: "in the axes of OpenGL, turned over; matched by the names of pictures",
    make.write_scannet: "pose/, a file a frame",
    make.write_beside: "0000.txt and others, a file a frame",
    make.write_replica: "traj.txt",
    make.write_rows_of_colour: "poses.txt",
}


@pytest.mark.parametrize("write", LAYOUTS, ids=lambda write: write.__name__.removeprefix("write_"))
def test_a_folder_is_read_with_its_poses_and_a_note(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    folder = write(tmp_path / "s")
    opened = next(kind for kind in kinds() if kind.recognise(folder))
    layout = {make.write_timed: redwood, make.write_nerfstudio: nerfstudio.LAYOUT}.get(write, depth_folder)
    assert opened.name == layout.name
    sequence = layout.read_sequence(folder, MM)
    assert sequence.frame_count == make.FRAMES
    assert sequence.intrinsics == Intrinsics(20, 21, 5.5, 4)
    assert np.allclose(sequence.poses, make.poses(), atol=1e-6)
    assert any(LAYOUTS[write] in note for note in sequence.notes), sequence.notes
    assert all(np.allclose(sequence.depth_m(i), depth / 1000) for i, depth in enumerate(make.depths_mm()))
    in_camera_frame = depth_folder.read_sequence(folder, SourceOptions(depth_scale=1000, frame="camera"))
    assert in_camera_frame.poses is None and not any("Poses" in note for note in in_camera_frame.notes)


def test_poses_are_read_from_the_requested_path(tmp_path: Path) -> None:
    """For every layout, from a file, a folder, or the single file of a stack."""
    moved = make.poses().copy()
    moved[:, 2, 3] += 0.25
    rows = make.write_rows(tmp_path / "mine.dat", moved.reshape(-1, 16))
    for i, pose in enumerate(moved):
        make.write_matrix(tmp_path / "each" / f"p{i}.txt", pose)
    np.save(tmp_path / "depth.npy", make.depths_mm())
    make.write_intrinsics(tmp_path / "intrinsics.txt")
    written = [
        (tum, make.write_tum(tmp_path / "a")), (redwood, make.write_redwood(tmp_path / "b")),
        (sun3d, make.write_sun3d(tmp_path / "c")), (threedmatch, make.write_threedmatch(tmp_path / "d")),
        (depth_folder, make.write_matrix_rows(tmp_path / "e")), (depth_stack, tmp_path / "depth.npy"),
    ]  # fmt: skip
    for module, path in written:
        sequence = module.read_sequence(path, SourceOptions(depth_scale=1000, poses=str(rows)))
        assert np.allclose(sequence.poses, moved, atol=1e-6)
    options = SourceOptions(depth_scale=1000, poses=str(tmp_path / "each"))
    assert np.allclose(depth_folder.read_sequence(written[4][1], options).poses, moved, atol=1e-6)
    with pytest.raises(InvalidArgument, match="--poses"):
        depth_folder.read_sequence(written[4][1], SourceOptions(depth_scale=1000, poses="nowhere.txt"))
    with pytest.raises(InvalidArgument, match="frame camera"):
        SourceOptions(poses="p.txt", frame="camera")


def test_unread_files_named_like_poses_are_noted(tmp_path: Path) -> None:
    folder = make.write_frames(tmp_path / "s")
    (folder / "my_trajectory_notes.txt").write_text("filmed in the kitchen\n")
    (folder / "._poses.txt").write_bytes(b"\0\5\x16\7")  # a resource fork as written by macOS
    notes = depth_folder.read_sequence(folder, MM).notes
    assert not any("._poses" in note for note in notes)
    assert any("assumed to be static" in note for note in notes)
    assert any("my_trajectory_notes.txt was found and not used: " in note for note in notes)
    make.write_rows(folder / "poses.txt", make.poses().reshape(-1, 16))
    notes = depth_folder.read_sequence(folder, MM).notes
    assert any("Poses of poses.txt" in note for note in notes)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (make.poses().reshape(-1, 16)[:3], "3 poses for 5 frames"),
        (np.tile(np.arange(6.0), (5, 1)), "6 numbers in its first line"),
        (np.tile(np.arange(7.0), (5, 1)), "pose 0: found a quaternion that is not finite and small"),
        (np.eye(7)[[0] * 5], "pose 0: found a quaternion of another norm; expected norm 1 .qx qy qz qw."),
        (np.tile(np.diag([1.0, 1, 1.1, 1]).ravel(), (5, 1)), "pose 0: found a matrix that is no rotation"),
        (np.tile(np.diag([1.0, 1, -1, 1]).ravel(), (5, 1)), "mirrors"),
    ],
)
def test_invalid_poses_are_an_error_with_a_remedy(tmp_path: Path, rows: np.ndarray, message: str) -> None:
    folder = make.write_frames(tmp_path / "s", "depth/a{}b.png")
    for i in range(make.FRAMES):
        (folder / "depth" / f"a{i}b.png").rename(folder / "depth" / f"{'vwxyz'[i]}.png")
    make.write_rows(folder / "poses.txt", rows)
    with pytest.raises(SourceError, match=rf"poses\.txt.*{message}.*--frame camera"):
        depth_folder.read_sequence(folder, MM)


def test_frames_are_matched_by_their_last_number_or_in_order(tmp_path: Path) -> None:
    folder = make.write_frames(tmp_path / "s", "depth/cam7_{:04d}.png")
    make.write_rows(folder / "poses.txt", make.poses(8).reshape(-1, 16))
    assert np.allclose(depth_folder.read_sequence(folder, MM).poses, make.poses(8)[:5], atol=1e-6)
    timed = make.write_frames(tmp_path / "t", "depth/10{}.25.png")
    make.write_rows(timed / "poses.txt", make.tum_rows(0.05 + 0.1 * np.arange(5))[::-1])
    assert np.allclose(depth_folder.read_sequence(timed, MM).poses, make.poses(), atol=1e-6)


def test_frames_are_not_matched_by_numbers_that_count_from_one(tmp_path: Path) -> None:
    folder = make.write_frames(tmp_path / "s", "depth/{:04d}.png", make.FRAMES)
    (folder / "depth" / "0000.png").rename(folder / "depth" / "0006.png")
    (folder / "depth" / "0001.png").unlink()
    make.write_rows(folder / "poses.txt", make.poses(6).reshape(-1, 16))  # of 0 to 5, or of 1 to 6
    with pytest.raises(SourceError, match="6 poses for 4 frames"):
        depth_folder.read_sequence(folder, MM)


def test_a_stack_uses_adjacent_poses_only_if_every_frame_has_one(tmp_path: Path) -> None:
    np.save(tmp_path / "depth.npy", make.depths_mm())
    make.write_intrinsics(tmp_path / "intrinsics.txt")
    make.write_rows(tmp_path / "poses.txt", make.poses().reshape(-1, 16))
    assert np.allclose(depth_stack.read_sequence(tmp_path / "depth.npy", MM).poses, make.poses(), atol=1e-6)
    make.write_rows(tmp_path / "poses.txt", make.poses(9).reshape(-1, 16))
    sequence = depth_stack.read_sequence(tmp_path / "depth.npy", MM)
    assert sequence.poses is None
    assert any("poses.txt was found and not used: 9 poses for 5 frames" in note for note in sequence.notes)
    (tmp_path / "poses.txt").unlink()
    frames = [{"file_path": f"{i}.png", "transform_matrix": np.eye(4).tolist()} for i in range(4)]
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": frames}))
    with pytest.raises(SourceError, match="4 of 5 frames with a pose"):
        depth_stack.read_sequence(tmp_path / "depth.npy", MM)


def test_frames_of_an_ambiguous_number_are_skipped_and_noted(tmp_path: Path) -> None:
    folder = make.write_nerfstudio(tmp_path / "s")
    transforms = json.loads((folder / "transforms.json").read_text())
    transforms["frames"] = [
        {
            "file_path": f"images/{eye}_{i}.png",
            "transform_matrix": (m @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist(),
        }
        for i, m in enumerate(make.poses())
        for eye in (("left", "right") if i == 1 else ("left",))
    ]
    (folder / "transforms.json").write_text(json.dumps(transforms))
    sequence = depth_folder.read_sequence(folder, MM)
    assert np.allclose(sequence.poses, make.poses()[[0, 2, 3, 4]], atol=1e-6)
    assert any("1 of 5 frames left out" in note for note in sequence.notes)


def test_frames_without_a_pose_are_skipped_and_noted(tmp_path: Path) -> None:
    folder = make.write_scannet(tmp_path / "s")
    make.write_matrix(folder / "pose" / "1.txt", np.full((4, 4), -np.inf))
    (folder / "pose" / "3.txt").unlink()
    sequence = depth_folder.read_sequence(folder, MM)
    assert np.allclose(sequence.poses, make.poses()[[0, 2, 4]], atol=1e-6)
    assert [path.stem for path in sequence.frames.paths] == ["0", "2", "4"]
    assert any("2 of 5 frames left out" in note for note in sequence.notes)


@given(st.text(alphabet="0123456789.-+eE \n,#naifjpg", max_size=120))
def test_any_text_of_poses_gives_poses_or_a_source_error(text: str) -> None:
    try:
        listed = poses.parse_poses(text, "where")
    except SourceError:
        return
    assert np.isfinite(listed.poses).all()


# -- folders of the pictures -------------------------------------------------------------------------------


def test_a_subfolder_of_depth_is_found_and_noted(tmp_path: Path) -> None:
    folder = make.write_frames(tmp_path / "s", "cam0_depth_registered/{}.png")
    make.write_rows(folder / "poses.txt", make.poses().reshape(-1, 16))
    assert depth_folder.kind.recognise(folder)
    sequence = depth_folder.read_sequence(folder, MM)
    assert np.allclose(sequence.poses, make.poses(), atol=1e-6)
    assert any("those of cam0_depth_registered/" in note for note in sequence.notes)
    inner = depth_folder.read_sequence(
        folder / "cam0_depth_registered", MM
    )  # files of the parent folder count
    assert np.allclose(inner.poses, make.poses(), atol=1e-6)


def test_a_layout_in_a_subfolder_is_not_read_as_plain_pictures(tmp_path: Path) -> None:
    """One part of 3DMatch is opened in its layout, with its poses; a part of others is named."""
    folder = make.write_threedmatch(tmp_path / "s")
    assert next(kind for kind in kinds() if kind.recognise(tmp_path / "s")).name == "3dmatch"
    nested = threedmatch.read_sequence(tmp_path / "s", SourceOptions())
    assert np.allclose(nested.poses, make.poses(), atol=1e-6)
    assert nested.intrinsics == Intrinsics(20, 21, 5.5, 4)
    assert "The sequence is that of seq-01/." in nested.notes
    assert open_source(folder).frame_count == make.FRAMES
    (tmp_path / "t").mkdir()
    make.write_tum(tmp_path / "t" / "part")
    with pytest.raises(SourceError, match=r"the folders part/"):
        open_source(tmp_path / "t")


def test_error_of_several_depth_folders_names_them(tmp_path: Path) -> None:
    folder = make.write_frames(tmp_path / "s", "depth_left/{}.png")
    make.write_frames(folder, "depth_right/{}.png")
    with pytest.raises(
        SourceError, match=r"2 folders of depth pictures \(depth_left/, depth_right/\).*Name one"
    ):
        depth_folder.read_sequence(folder, MM)


def test_error_of_missing_depth_lists_the_contents(tmp_path: Path) -> None:
    make.write_png(tmp_path / "rgb" / "1.png", np.zeros((2, 2, 3), np.uint8))
    (tmp_path / "a.txt").write_text("words")
    with pytest.raises(SourceError, match=r"no depth picture but 1 \.txt, the folders rgb/"):
        depth_folder.read_sequence(tmp_path, MM)


def test_depth_arrays_one_a_frame(tmp_path: Path) -> None:
    for i, depth in enumerate(make.depths_mm()):
        (tmp_path / "depth").mkdir(exist_ok=True)
        np.save(tmp_path / "depth" / f"{i:03d}.npy", (depth / 1000).astype(np.float32))
    make.write_intrinsics(tmp_path / "K.txt")
    sequence = depth_folder.read_sequence(tmp_path, SourceOptions())
    assert np.allclose(sequence.depth_m(4), make.depths_mm()[4] / 1000)


# -- cameras -----------------------------------------------------------------------------------------------

CAMERAS = {
    "K.txt": "20 0 5.5 0\n0 21 4 0\n0 0 1 0\n",
    "realsense.json": json.dumps(
        {"width": 12, "height": 9, "ppx": 5.5, "ppy": 4, "fx": 20, "fy": 21, "model": 2}
    ),
    "opencv.json": json.dumps(
        {"camera_matrix": {"rows": 3, "cols": 3, "data": [20, 0, 5.5, 0, 21, 4, 0, 0, 1]}}
    ),
    "nested.json": json.dumps({"camera_matrix": [[20, 0, 5.5], [0, 21, 4], [0, 0, 1]]}),
    "ros.json": json.dumps({"height": 9, "width": 12, "K": [20, 0, 5.5, 0, 21, 4, 0, 0, 1]}),
    "nerfstudio.json": json.dumps({"w": 12, "h": 9, "fl_x": 20, "fl_y": 21, "cx": 5.5, "cy": 4}),
    "cameras.txt": "# cameras\n1 PINHOLE 24 18 40 42 12 9\n",
}


@pytest.mark.parametrize("name", CAMERAS)
def test_all_forms_of_cameras_are_read(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text(CAMERAS[name])
    camera = camera_of("s", str(tmp_path / name), (), (12, 9))
    assert camera.intrinsics == Intrinsics(20, 21, 5.5, 4)
    assert camera.units_per_m is None
    assert any("24 x 18 pixels" in note for note in camera.notes) == (name == "cameras.txt")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 OPENCV 12 9 20 21 6 4.5 0 0 0", "a camera OPENCV of 7 numbers.*Undistort"),
        ("1 FOV 12 9 20 21 6 4.5 0.9", "a camera FOV of 5 numbers.*Undistort"),
        ("1 PINHOLE 12 12 20 21 6 4.5", "12 x 12 pixels.*aspect"),
        ("1 PINHOLE 12 9 20 21 6 4.5\n2 PINHOLE 12 9 30 21 6 4.5", "2 cameras that differ"),
        ('{"camera_matrix": "none"}', "without numbers"),
        ('{"frames": [], "w": 20, "h": 9, "fl_x": 1, "fl_y": 1, "cx": 1, "cy": 1}', "20 x 9 pixels.*aspect"),
    ],
)
def test_invalid_cameras_are_refused(text: str, message: str) -> None:
    with pytest.raises(SourceError, match=message):
        parse_intrinsics(text, "cameras.txt", (12, 9))


def test_a_mirrored_camera_flips_its_poses(tmp_path: Path) -> None:
    """As in ICL-NUIM: with negative fy a point is at P (x, -y, z), the mirror image of ours."""
    tilted = make.poses().copy()
    tilted[:, :3, :3] = tilted[:, :3, :3] @ np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]])
    tilted[:, 1, 3] = 0.2
    folder = make.write_frames(tmp_path / "s")
    make.write_rows(folder / "poses.txt", tilted.reshape(-1, 16))
    sequence = depth_folder.read_sequence(folder, SourceOptions(depth_scale=1000, intrinsics="20,-21,5.5,4"))
    assert sequence.intrinsics == Intrinsics(20, 21, 5.5, 4)
    assert any("fy is negative" in note for note in sequence.notes)
    x, y, z = 0.3, 0.4, 1.5
    mirrored = tilted[3] @ [x, -y, z, 1]
    assert np.allclose(sequence.poses[3] @ [x, y, z, 1], mirrored * [1, -1, 1, 1])


def test_a_calibration_file_of_text_is_refused_by_name(tmp_path: Path) -> None:
    folder = make.write_frames(tmp_path / "s")
    (folder / "intrinsics.txt").rename(tmp_path / "mine.txt")
    (folder / "calibration.txt").write_text("filmed in the kitchen\n")
    with pytest.raises(SourceError, match=r"calibration\.txt: found 'filmed in the kitchen'.*fx,fy,cx,cy"):
        depth_folder.read_sequence(folder, MM)
    options = SourceOptions(depth_scale=1000, intrinsics=str(tmp_path / "mine.txt"))
    assert depth_folder.read_sequence(folder, options).intrinsics == Intrinsics(20, 21, 5.5, 4)


def test_a_scale_in_metres_per_unit_is_inverted() -> None:
    text = json.dumps({"fx": 20, "fy": 21, "cx": 5.5, "cy": 4, "depth_scale": 0.001})
    camera = parse_intrinsics(text, "camera.json")
    assert camera.units_per_m == pytest.approx(1000) and "1000 units of depth in a metre" in camera.notes[0]
