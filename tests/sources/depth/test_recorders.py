"""Recordings of phones, cameras and reconstruction programs: a room, where their poses and cameras say."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import room_makers as room
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

COUNT = 4
POSES = room.poses()
FX, FY, CX, CY = room.CAMERA
seven_scenes = next(layout for layout in LAYOUTS if layout.name == "3dmatch")


def colour_camera(factor: float) -> tuple[float, float, float, float]:
    """The camera of a picture `factor` times as large, pixel centres at one half."""
    return FX * factor, FY * factor, (CX + 0.5) * factor, (CY + 0.5) * factor


def write_stray(folder: Path) -> Path:
    """Confidence 0 marks pixels whose depth is wrong by half."""
    fx, fy, cx, cy = colour_camera(20)
    depths = room.depths_mm()
    confidence = np.full(depths.shape, 2, np.uint8)
    confidence[:, 10:14, 20:30] = 0
    confidence[:, 14:20, 20:30] = 1
    depths[confidence == 0] //= 2
    lines = ["timestamp, frame, x, y, z, qx, qy, qz, qw"]
    turns = room.quaternions(POSES)
    for i in range(COUNT):
        room.write_png(folder / "depth" / f"{i:06d}.png", depths[i])
        room.write_png(folder / "confidence" / f"{i:06d}.png", confidence[i])
        values = ", ".join(f"{v:.12g}" for v in (*POSES[i, :3, 3], *turns[i]))
        lines.append(f"{1000.5 + i / 60:.6f}, {i:06d}, {values}")
    (folder / "odometry.csv").write_text("\n".join(lines) + "\n")
    (folder / "camera_matrix.csv").write_text(f"{fx}, 0.0, {cx}\n0.0, {fy}, {cy}\n0.0, 0.0, 1.0\n")
    (folder / "imu.csv").write_text("timestamp, a_x, a_y, a_z, alpha_x, alpha_y, alpha_z\n")
    return folder


def write_polycam(folder: Path, corrected: str = "corrected_cameras") -> Path:
    """Poses of ARKit; the uncorrected ones are 20 cm off. The focal length changes from frame to frame."""
    for i, pose in enumerate(POSES):
        factor, stamp = 10 * (1 + 0.01 * i), 5_000_000 + 33_000 * i
        fx, fy, _, _ = colour_camera(factor)
        _, _, cx, cy = colour_camera(10)
        depth = np.rint(1000 * room.depth_m(pose, (fx / 10, fy / 10, CX, CY))).astype(np.uint16)
        confidence = np.full(depth.shape, 255, np.uint8)
        confidence[30:33, 40:60], confidence[33:36, 40:60] = 0, 127
        depth[confidence == 0] //= 2
        room.write_png(folder / "keyframes" / "depth" / f"{stamp}.png", depth)
        room.write_png(folder / "keyframes" / "confidence" / f"{stamp}.png", confidence)
        camera = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "width": 960, "height": 720, "blur_score": 90.0}
        arkit = np.diag([1.0, -1.0, -1.0, 1.0]) @ pose @ room.OPENGL  # a world with y up
        for name, shift in (("cameras", 0.2), (corrected, 0.0)):
            matrix = arkit.copy()
            matrix[0, 3] += shift * i
            entries = {f"t_{r}{c}": matrix[r, c] for r in range(3) for c in range(4)}
            file = folder / "keyframes" / name / f"{stamp}.json"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(json.dumps({**camera, **entries}))
    return folder


def write_nerfstudio(folder: Path) -> Path:
    """Depth in a folder of any name, in any order; one colour picture has none. Each frame has its camera."""
    frames = [{"file_path": "images/9.jpg", "transform_matrix": np.eye(4).tolist()}]
    for i in (2, 0, 3, 1):
        fx, fy, cx, cy = colour_camera(2)
        fx, fy = fx * (1 - 0.004 * i), fy * (1 - 0.004 * i)
        depth = np.rint(1000 * room.depth_m(POSES[i], (fx / 2, fy / 2, CX, CY))).astype(np.uint16)
        room.write_png(folder / "sensor_depth" / f"{i}.png", depth)
        entry = {"file_path": f"images/{i}.jpg", "depth_file_path": f"sensor_depth/{i}.png",
                 "transform_matrix": (POSES[i] @ room.OPENGL).tolist(),
                 "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy}  # fmt: skip
        frames.append(entry)
    data = {"camera_model": "OPENCV", "w": 2 * room.WIDTH, "h": 2 * room.HEIGHT, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(data))
    return folder


def write_bundlefusion(folder: Path, name: str = "info.txt", suffix: str = "png", units: int = 2000) -> Path:
    for i, (pose, depth) in enumerate(zip(POSES, room.depths_mm())):
        values = (depth.astype(np.uint32) * units // 1000).astype(np.uint16)
        file = folder / f"frame-{i:06d}.depth.{suffix}"
        if suffix == "png":
            room.write_png(file, values)
        else:
            folder.mkdir(parents=True, exist_ok=True)
            head = f"P5\n{room.WIDTH} {room.HEIGHT}\n65535\n".encode()
            file.write_bytes(head + values.astype(">u2").tobytes())
        np.savetxt(folder / f"frame-{i:06d}.pose.txt", pose)
    unit = "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"
    info = [
        "m_versionNumber = 4", "m_sensorName = StructureSensor", "m_colorWidth = 640",
        "m_colorHeight = 480", f"m_depthWidth = {room.WIDTH}", f"m_depthHeight = {room.HEIGHT}",
        f"m_depthShift = {units}",
        "m_calibrationColorIntrinsic = 582.8 0 320 0 0 582.8 240 0 0 0 1 0 0 0 0 1",
        f"m_calibrationColorExtrinsic = {unit}",
        f"m_calibrationDepthIntrinsic = {FX} 0 {CX} 0 0 {FY} {CY} 0 0 0 1 0 0 0 0 1",
        f"m_calibrationDepthExtrinsic = {unit} ", f"m_frames.size = {COUNT}",
    ]  # fmt: skip
    (folder / name).write_text("\n".join(info) + "\n")
    return folder


def write_3rscan(folder: Path) -> Path:
    return write_bundlefusion(folder, "_info.txt", "pgm", 1000)


def write_open3d(folder: Path, name: str = "intrinsic.json") -> Path:
    """As Open3D takes a recording apart, with the poses of its reconstruction system."""
    lines = []
    for i, (pose, depth) in enumerate(zip(POSES, room.depths_mm())):
        room.write_png(folder / "depth" / f"{i:06d}.png", depth)
        (folder / "color").mkdir(exist_ok=True)
        (folder / "color" / f"{i:06d}.jpg").write_bytes(b"")
        lines += [f"{i} {i} {i + 1}", *(" ".join(f"{x:.9f}" for x in row) for row in pose)]
    matrix = [FX, 0, 0, 0, FY, 0, CX, CY, 1]
    camera = {"width": room.WIDTH, "height": room.HEIGHT, "intrinsic_matrix": matrix, "serial_number_": "1"}
    (folder / name).write_text(json.dumps(camera))
    (folder / "scene").mkdir()
    (folder / "scene" / "trajectory.log").write_text("\n".join(lines) + "\n")
    return folder


def write_realsense(folder: Path) -> Path:
    """Snapshots of the viewer: raw depth with its metadata, and a coloured preview; poses from elsewhere."""
    folder.mkdir(parents=True, exist_ok=True)
    for i, depth in enumerate(room.depths_mm()):
        stem = f"shot{i}_Depth"
        (folder / f"{stem}.raw").write_bytes(depth.astype("<u2").tobytes())
        room.write_png(folder / f"{stem}.png", np.zeros((room.HEIGHT, room.WIDTH, 3), np.uint8))
        (folder / f"{stem}_metadata.csv").write_text(
            "Frame Info: \nType,Depth\nFormat,Z16\nFrame Number,12\n"
            f"Timestamp (ms),{1500.0 + 50 * i:.2f}\nResolution x,{room.WIDTH}\nResolution y,{room.HEIGHT}\n"
            f"Bytes per pixel,2\n\nIntrinsic:,\nFx,{FX:.6f}\nFy,{FY:.6f}\nPPx,{CX:.6f}\nPPy,{CY:.6f}\n"
            "Distorsion,Brown Conrady\n"
        )
    np.savetxt(folder / "poses.txt", POSES.reshape(-1, 16))
    return folder


def write_seven_scenes(folder: Path, inner: str = "seq-01/seq-01") -> Path:
    for i, (pose, depth) in enumerate(zip(POSES, room.depths_mm())):
        room.write_png(folder / inner / f"frame-{i:06d}.depth.png", depth)
        np.savetxt(folder / inner / f"frame-{i:06d}.pose.txt", pose)
    np.savetxt(folder / "camera-intrinsics.txt", [[FX, 0, CX], [0, FY, CY], [0, 0, 1]])
    return folder


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
