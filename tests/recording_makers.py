"""Recordings of phones, cameras and reconstruction programs: the room of `room_makers`, as each writes it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

import room_makers as room

COUNT = 4
POSES = room.poses()
FX, FY, CX, CY = room.CAMERA


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
