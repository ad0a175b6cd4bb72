"""Recordings of phones, cameras and reconstruction programs: a room, where their poses and cameras say."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import room_makers as room
from recording_makers import (
    COUNT,
    FX,
    POSES,
    write_3rscan,
    write_bundlefusion,
    write_nerfstudio,
    write_open3d,
    write_polycam,
    write_realsense,
    write_seven_scenes,
    write_stray,
)
from touchfield.errors import SourceError
from touchfield.sources.camera import Intrinsics
from touchfield.sources.depth.layouts import KINDS as LAYOUT_KINDS, LAYOUTS, Layout
from touchfield.sources.depth.recorders import (
    bundlefusion,
    nerfstudio,
    open3d_recording,
    polycam,
    realsense,
    stray_scanner,
)
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import kinds, open_source

seven_scenes = next(layout for layout in LAYOUTS if layout.name == "3dmatch")


RECORDINGS: list[tuple[str, Layout, Callable[[Path], Path], str]] = [
    ("stray scanner", stray_scanner.LAYOUT, write_stray, "low confidence"),
    ("polycam", polycam.LAYOUT, write_polycam, "4 of 4 globally optimised"),
    ("polycam keyframes", polycam.LAYOUT, lambda path: write_polycam(path) / "keyframes", "4 of 4"),
    ("nerfstudio", nerfstudio.LAYOUT, write_nerfstudio, "1 of 5 frames left out: no depth"),
    ("bundlefusion", bundlefusion.LAYOUT, write_bundlefusion, "(2000 in a metre) are those of info.txt"),
    ("3rscan", bundlefusion.LAYOUT, write_3rscan, "(1000 in a metre) are those of _info.txt"),
    ("azure kinect", open3d_recording.LAYOUT, write_open3d, "trajectory.log"),
    ("realsense open3d", open3d_recording.LAYOUT,
     lambda path: write_open3d(path, "camera_intrinsic.json"), "camera_intrinsic.json"),
    ("realsense viewer", realsense.LAYOUT, write_realsense, "shot0_Depth_metadata.csv"),
    ("7-scenes nested", seven_scenes, write_seven_scenes, "that of seq-01/seq-01/"),
    ("7-scenes one part", seven_scenes, lambda path: write_seven_scenes(path, "seq-01"), "that of seq-01/"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "layout", "write", "note"), RECORDINGS, ids=[row[0] for row in RECORDINGS])
def test_a_recording_is_recognised_and_its_room_is_right(
    tmp_path: Path, name: str, layout: Layout, write: Callable[[Path], Path], note: str
) -> None:
    folder = write(tmp_path / "recording")
    assert next(kind for kind in kinds() if kind.recognise(folder)).name == layout.name
    sequence = layout.read_sequence(folder, SourceOptions())
    room.assert_room(sequence, known=0.9)
    assert any(note in text for text in sequence.notes), sequence.notes
    for frame in range(COUNT):
        change = np.linalg.inv(sequence.poses[0]) @ sequence.poses[frame]
        assert np.allclose(change, POSES[frame], atol=1e-6)
    assert open_source(folder, SourceOptions()).frame_count == COUNT


def test_depth_of_low_confidence_is_unknown(tmp_path: Path) -> None:
    stray = stray_scanner.LAYOUT.read_sequence(write_stray(tmp_path / "s"), SourceOptions())
    assert not stray.depth_m(1)[10:14, 20:30].any() and stray.depth_m(1)[14:20, 20:30].all()
    raw = polycam.LAYOUT.read_sequence(write_polycam(tmp_path / "p"), SourceOptions(frame="camera"))
    assert not raw.depth_m(0)[30:33, 42:58].any() and raw.depth_m(0)[34:36, 42:58].all()


def test_arkit_poses_are_used_where_polycam_has_no_corrected_ones(tmp_path: Path) -> None:
    folder = write_polycam(tmp_path / "p", "left_out")
    sequence = polycam.LAYOUT.read_sequence(folder, SourceOptions())
    assert any("0 of 4 globally optimised" in note for note in sequence.notes)
    assert np.linalg.norm(sequence.poses[3, :3, 3] - sequence.poses[0, :3, 3]) > 0.5


def test_the_changing_camera_of_a_phone_is_resampled(tmp_path: Path) -> None:
    """Taken as the first camera, the walls of the last frame are centimetres off."""
    sequence = polycam.LAYOUT.read_sequence(write_polycam(tmp_path), SourceOptions())
    assert any("The camera changes from frame to frame" in note for note in sequence.notes)
    assert sequence.intrinsics.fx == pytest.approx(FX * 1.015)
    options = SourceOptions(intrinsics=",".join(map(str, room.CAMERA)))
    fixed = polycam.LAYOUT.read_sequence(tmp_path, options)
    assert fixed.intrinsics == Intrinsics(*room.CAMERA)
    assert np.quantile(room.distances_to_walls_m(fixed, 3), 0.95) > 0.012


def test_several_parts_of_a_data_set_are_named(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path / "chess", "seq-02")
    with pytest.raises(
        SourceError, match=r"2 sequences \(seq-01/, seq-02/\); expected one.*Name one: .*seq-01"
    ):
        open_source(write_seven_scenes(tmp_path / "chess", "seq-01"))


def _without(name: str) -> Callable[[Path], None]:
    return lambda folder: next(iter(sorted(folder.rglob(name)))).unlink()


def _with(name: str, old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        file = next(iter(sorted(folder.rglob(name))))
        text = file.read_text()
        assert old in text
        file.write_text(text.replace(old, new))

    return change


FAULTS = [
    (write_stray, _with("camera_matrix.csv", "940.0", "30.0"), r"camera_matrix\.csv.*30.*--intrinsics"),
    (write_polycam, _with("corrected_cameras/5000000.json", "fx", "f"), r"5000000\.json.*no camera.*t_00"),
    (write_nerfstudio, _without("2.png"), r"transforms\.json.*no sensor_depth.2\.png \(1 of 4"),
    (write_nerfstudio, _with("transforms.json", "sensor_depth/", "../"), r"transforms\.json.*inside"),
    (write_bundlefusion, _with("info.txt", "m_depthShift", "m_shift"), r"info\.txt.*no m_depthShift"),
    (write_bundlefusion, _with("info.txt", "= 96", "= 97"), r"info\.txt.*97 x 72.*96 x 72"),
    (write_realsense, _with("shot0*.csv", "Fx", "F"), r"shot0_Depth_metadata\.csv.*no Fx"),
    (write_realsense, _with("shot0*.csv", "Z16", "DISPARITY32"), r"metadata\.csv.*DISPARITY32.*Z16"),
    (write_realsense, _with("shot0*.csv", "y,72", "y,73"), r"shot0_Depth\.raw.*13824 bytes.*96 x 73"),
]  # fmt: skip


@pytest.mark.parametrize(("write", "change", "message"), FAULTS)
def test_faults_name_the_file(
    tmp_path: Path, write: Callable[[Path], Path], change: Callable[[Path], None], message: str
) -> None:
    folder = write(tmp_path / "r")
    change(folder)
    with pytest.raises(SourceError, match=message):
        open_source(folder)


def test_a_frame_without_tracking_is_left_out(tmp_path: Path) -> None:
    folder = write_bundlefusion(tmp_path)
    np.savetxt(folder / "frame-000002.pose.txt", np.full((4, 4), -np.inf))
    sequence = bundlefusion.LAYOUT.read_sequence(folder, SourceOptions())
    assert sequence.frame_count == 3
    assert any("1 of 4 frames left out" in note for note in sequence.notes)


def test_an_extrinsic_that_is_not_used_is_named(tmp_path: Path) -> None:
    folder = write_bundlefusion(tmp_path)
    _with("info.txt", "m_calibrationDepthExtrinsic = 1 0 0 0", "m_calibrationDepthExtrinsic = 1 0 0 0.02")(
        folder
    )
    notes = bundlefusion.LAYOUT.read_sequence(folder, SourceOptions()).notes
    assert any("m_calibrationDepthExtrinsic in info.txt is not used" in note for note in notes)


TEXTS = [
    (write_stray, "camera_matrix.csv"), (write_stray, "odometry.csv"),
    (write_polycam, "corrected_cameras/5000000.json"), (write_nerfstudio, "transforms.json"),
    (write_bundlefusion, "info.txt"), (write_bundlefusion, "frame-000001.pose.txt"),
    (write_open3d, "intrinsic.json"), (write_open3d, "trajectory.log"),
    (write_realsense, "shot0_Depth_metadata.csv"),
]  # fmt: skip


@pytest.mark.parametrize(("write", "name"), TEXTS)
def test_a_changed_number_is_read_or_refused(
    tmp_path: Path, write: Callable[[Path], Path], name: str
) -> None:
    """Any fault is a `SourceError`, whatever stands where a number was."""
    folder = write(tmp_path / "r")
    file = next(iter(sorted(folder.rglob(name))))
    text = file.read_text()
    tokens = list(re.finditer(r"-?\d+(\.\d+)?(e-?\d+)?", text))
    refused = 0
    for token in tokens[:: max(1, len(tokens) // 12)]:
        for value in ("nan", "NaN", "-1", "0", "1e400", "9" * 400, "null", "[]", ""):
            file.write_text(text[: token.start()] + value + text[token.end() :])
            try:
                open_source(folder)
            except SourceError:
                refused += 1
    assert refused > 0


def test_every_layout_has_one_name() -> None:
    names = [kind.name for kind in kinds()]
    assert len(names) == len(set(names)) and set(LAYOUT_KINDS) <= set(names)
