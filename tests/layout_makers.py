"""The room of `room_makers` in every layout of depth sequences, written as data sets and programs write it.

Each function writes into a folder that does not exist yet, and returns the path to encode.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from PIL import Image

import room_makers as room
import stack_makers as stacks

POSES, COUNT = room.poses(), 4
FX, FY, CX, CY = room.CAMERA
MATRIX = f"{FX} 0 {CX}\n0 {FY} {CY}\n0 0 1\n"
FOUR_NUMBERS = f"{FX} {FY} {CX} {CY}\n"
STAMPS_S = 1305031102.16 + 0.04 * np.arange(COUNT)
DISTORTION = (-0.12, 0.03, 0.001, -0.002, 0.0)


def lines_of(rows: np.ndarray) -> list[str]:
    return [" ".join(f"{value:.12g}" for value in row) for row in rows]


def written(path: Path, lines: list[str] | str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(lines if isinstance(lines, str) else "\n".join(lines) + "\n")
    return path


def pictures(folder: Path, name: str = "depth/{:04d}.png", per_m: int = 1000, first: int = 0) -> Path:
    """Depth pictures with `per_m` units in a metre, numbered from `first`."""
    for i, pose in enumerate(POSES):
        values = np.rint(per_m * room.depth_m(pose)).astype(np.uint16)
        room.write_png(folder / name.format(i + first), values)
    return folder


def tum_rows(times: np.ndarray) -> list[str]:
    return lines_of(np.column_stack([times, POSES[:, :3, 3], room.quaternions(POSES)]))


def write_tum(folder: Path) -> Path:
    names = [f"depth/{t:.6f}.png" for t in STAMPS_S]
    for name, pose in zip(names, POSES):
        room.write_png(folder / name, np.rint(5000 * room.depth_m(pose)).astype(np.uint16))
    listed = [f"{t:.6f} {name}" for t, name in zip(STAMPS_S, names)]
    written(folder / "depth.txt", ["# depth maps", "# timestamp filename", *listed])
    rows = [f"{t:.4f} {row.split(' ', 1)[1]}" for t, row in zip(STAMPS_S + 0.003, tum_rows(STAMPS_S))]
    written(folder / "groundtruth.txt", ["# timestamp tx ty tz qx qy qz qw", *rows])
    written(folder / "calibration.txt", FOUR_NUMBERS)
    return folder


def write_icl(folder: Path) -> Path:
    """ICL-NUIM's: poses by the number of the picture, value / 5000 m."""
    pictures(folder, "depth/{}.png", 5000)
    (folder / "rgb").mkdir()
    written(folder / "associations.txt", [f"{i} depth/{i}.png {i} rgb/{i}.png" for i in range(COUNT)])
    written(folder / "livingRoom1.gt.freiburg", tum_rows(np.arange(COUNT)))
    written(folder / "calibration.txt", FOUR_NUMBERS)
    return folder


def log_lines() -> list[str]:
    return [line for i, pose in enumerate(POSES) for line in (f"{i} {i} {i + 1}", *lines_of(pose))]


def write_redwood(folder: Path) -> Path:
    written(pictures(folder, "depth/{:05d}.png") / "trajectory.log", log_lines())
    written(folder / "camera_intrinsic.json", open3d_camera())
    return folder


def open3d_camera() -> str:
    matrix = [FX, 0, 0, 0, FY, 0, CX, CY, 1]
    return json.dumps({"width": room.WIDTH, "height": room.HEIGHT, "intrinsic_matrix": matrix})


def write_open3d_trajectory(folder: Path) -> Path:
    """Open3D's PinholeCameraTrajectory, which maps the scene to the camera, column by column."""
    entries = [
        {
            "class_name": "PinholeCameraParameters",
            "extrinsic": [round(x, 9) for x in np.linalg.inv(pose).T.ravel().tolist()],
            "intrinsic": json.loads(open3d_camera()),
        }
        for pose in POSES
    ]
    document = {"class_name": "PinholeCameraTrajectory", "parameters": entries}
    written(pictures(folder) / "trajectory.json", json.dumps(document))
    written(folder / "intrinsics.txt", FOUR_NUMBERS)
    return folder


def write_sun3d(folder: Path) -> Path:
    for i, depth in enumerate(room.depths_mm()):
        rotated = ((depth << 3) | (depth >> 13)).astype(np.uint16)
        room.write_png(folder / "depth" / f"{i + 1:07d}-{33369 * i:012d}.png", rotated)
        written(folder / "image" / f"{i + 1:07d}-{33369 * i + 4000:012d}.jpg", "")
    written(folder / "extrinsics" / "20140808220511.txt", lines_of(POSES[:, :3].reshape(-1, 4)))
    written(folder / "intrinsics.txt", MATRIX)
    return folder


def write_threedmatch(folder: Path) -> Path:
    for i, (depth, pose) in enumerate(zip(room.depths_mm(), POSES)):
        room.write_png(folder / "seq-01" / f"frame-{i:06d}.depth.png", depth)
        written(folder / "seq-01" / f"frame-{i:06d}.pose.txt", lines_of(pose))
    written(folder / "camera-intrinsics.txt", MATRIX)
    return folder


def write_replica(folder: Path) -> Path:
    """NICE-SLAM's: a camera with its scale in the folder above."""
    pictures(folder / "room0", "results/depth{:06d}.png", 6553)
    written(folder / "room0" / "traj.txt", lines_of(POSES.reshape(-1, 16)))
    camera = {"w": room.WIDTH, "h": room.HEIGHT, "fx": FX, "fy": FY, "cx": CX, "cy": CY, "scale": 6553.0}
    written(folder / "cam_params.json", json.dumps({"camera": camera}))
    return folder / "room0"


def write_scannet(folder: Path) -> Path:
    pictures(folder, "depth/{}.png")
    for i, pose in enumerate(POSES):
        written(folder / "pose" / f"{i}.txt", lines_of(pose))
    written(folder / "intrinsic" / "intrinsic_depth.txt", f"{FX} 0 {CX} 0\n0 {FY} {CY} 0\n0 0 1 0\n0 0 0 1\n")
    return folder


def write_colmap(folder: Path) -> Path:
    """COLMAP's text model, with pixel centres at one half, of pictures of twice the size."""
    pictures(folder)
    inverse = np.linalg.inv(POSES)
    turns = np.roll(room.quaternions(inverse), 1, axis=1)
    entries = []
    for i, row in enumerate(lines_of(np.hstack([turns, inverse[:, :3, 3]]))):
        entries += [f"{i + 1} {row} 1 {i:04d}.jpg", "1.5 2.5 -1"]
    written(
        folder / "sparse" / "0" / "images.txt",
        ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", *entries],
    )
    camera = f"1 PINHOLE {2 * room.WIDTH} {2 * room.HEIGHT} {2 * FX} {2 * FY} {2 * CX + 1} {2 * CY + 1}"
    written(folder / "sparse" / "0" / "cameras.txt", ["# Camera list", camera])
    return folder


def write_kitti(folder: Path, matrices: np.ndarray = POSES) -> Path:
    """A plain folder with KITTI's 3x4 matrices, one a line."""
    written(pictures(folder) / "poses.txt", lines_of(matrices[:, :3].reshape(-1, 12)))
    written(folder / "intrinsics.txt", FOUR_NUMBERS)
    return folder


def write_w_first(folder: Path) -> Path:
    """Quaternions written w first, where nothing says so."""
    turns = np.roll(room.quaternions(POSES), 1, axis=1)
    written(pictures(folder) / "poses.txt", lines_of(np.hstack([POSES[:, :3, 3], turns])))
    written(folder / "intrinsics.txt", FOUR_NUMBERS)
    return folder


def write_camera_info(folder: Path) -> Path:
    """A bent lens, described as a ROS camera_info."""
    distort = room.brown(*DISTORTION)
    for i, pose in enumerate(POSES):
        depth = room.depth_m(pose, distort=distort)
        room.write_png(folder / "depth" / f"{i:04d}.png", np.rint(1000 * depth).astype(np.uint16))
    info = {"height": room.HEIGHT, "width": room.WIDTH, "distortion_model": "plumb_bob",
            "D": [*DISTORTION], "K": [FX, 0, CX, 0, FY, CY, 0, 0, 1]}  # fmt: skip
    written(folder / "camera_info.json", json.dumps(info))
    written(folder / "poses.txt", lines_of(POSES.reshape(-1, 16)))
    return folder


def write_unpadded_times(folder: Path) -> Path:
    """Names with decimal times, which an alphabetical order would mix up."""
    for time, depth in zip(("9.5", "10", "10.033333", "10.06"), room.depths_mm()):
        room.write_png(folder / "depth" / f"{time}.png", depth)
    written(folder / "poses.txt", lines_of(POSES.reshape(-1, 16)))
    written(folder / "intrinsics.txt", FOUR_NUMBERS)
    return folder


def write_slambook(folder: Path) -> Path:
    """Pictures in PGM from 1 on and pose.txt, as in textbooks: camera and unit are stated elsewhere."""
    for i, depth in enumerate(room.depths_mm()):
        (folder / "depth").mkdir(parents=True, exist_ok=True)
        head = f"P5\n{room.WIDTH} {room.HEIGHT}\n65535\n".encode()
        (folder / "depth" / f"{i + 1}.pgm").write_bytes(head + depth.astype(">u2").tobytes())
    rows = lines_of(np.hstack([POSES[:, :3, 3], room.quaternions(POSES)]))
    written(folder / "pose.txt", rows)
    return folder


def write_exr_folder(folder: Path) -> Path:
    for i, pose in enumerate(POSES):
        stacks.write_exr(folder / "depth" / f"{i:04d}.exr", {"Z": room.depth_m(pose).astype(np.float32)})
    written(folder / "intrinsics.txt", FOUR_NUMBERS)
    written(folder / "poses.txt", lines_of(POSES.reshape(-1, 16)))
    return folder


def write_tiff_pages(folder: Path) -> Path:
    folder.mkdir(parents=True)
    return stacks.write_tiff(folder / "depth.tif", list(room.depths_mm()))


def write_npy_stack(folder: Path) -> Path:
    folder.mkdir(parents=True)
    np.save(folder / "depth.npy", np.stack([room.depth_m(pose) for pose in POSES]).astype(np.float32))
    written(folder / "intrinsics.txt", FOUR_NUMBERS)
    written(folder / "poses.txt", lines_of(POSES.reshape(-1, 16)))
    return folder / "depth.npy"


def write_disparity_npz(folder: Path) -> Path:
    folder.mkdir(parents=True)
    k = np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1]])
    disparity = stacks.disparities_px()[0].astype(np.float32)
    np.savez(folder / "pair.npz", disparity=disparity, K=k, baseline_m=stacks.BASELINE_M)
    return folder / "pair.npz"


def write_middlebury(folder: Path) -> Path:
    """Middlebury 2014: disparities in PFM, rows from below, and calib.txt with a baseline in millimetres."""
    disparity = stacks.disparities_px()[0].astype("<f4") - 2.0
    head = f"Pf\n{room.WIDTH} {room.HEIGHT}\n-1.0\n".encode()
    folder.mkdir(parents=True)
    (folder / "disp0.pfm").write_bytes(head + disparity[::-1].tobytes())
    k = f"[{FX} 0 {CX}; 0 {FX} {CY}; 0 0 1]"
    baseline = f"baseline={1000 * stacks.BASELINE_M:g}"
    written(folder / "calib.txt", [f"cam0={k}", f"cam1={k}", "doffs=2", baseline])
    return folder / "disp0.pfm"


def write_video(folder: Path) -> Path:
    from video_makers import write_video as write

    folder.mkdir(parents=True)
    return write(folder / "depth.mkv", room.depths_mm(), "gray16le")


def write_one_picture(folder: Path) -> Path:
    return room.write_png(folder / "depth.png", room.depths_mm()[0])


def write_eight_bits(folder: Path) -> Path:
    """Depth scaled to 8 bits, as for a screen."""
    for i, depth in enumerate(room.depths_mm()):
        Image.fromarray((depth // 16).astype(np.uint8)).save(
            room.write_png(folder / "depth" / f"{i:04d}.png", depth)
        )
    written(folder / "poses.txt", lines_of(POSES.reshape(-1, 16)))
    written(folder / "intrinsics.txt", FOUR_NUMBERS)
    return folder


def write_cut_picture(folder: Path) -> Path:
    """One picture has been cut to half its bytes."""
    path = write_kitti(folder) / "depth" / "0002.png"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return folder
