"""Small depth sequences in every layout, written as in the data sets."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from PIL import Image

WIDTH, HEIGHT, FRAMES = 12, 9, 5


def depths_mm(frames: int = FRAMES) -> np.ndarray:
    """Millimetres, uint16 [frames, HEIGHT, WIDTH]: a slope that recedes, with one unknown pixel a frame."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    depth = np.stack([800 + 10 * u + 20 * v + 5 * i for i in range(frames)]).astype(np.uint16)
    depth[:, 2, 3] = 0
    return depth


def poses(frames: int = FRAMES) -> np.ndarray:
    """Camera-to-world matrices, float64 [frames, 4, 4]: turning about y, moving along x."""
    matrices = np.tile(np.eye(4), (frames, 1, 1))
    for i, matrix in enumerate(matrices):
        c, s = np.cos(0.02 * i), np.sin(0.02 * i)
        matrix[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
        matrix[0, 3] = 0.01 * i
    return matrices


def write_png(path: Path, values: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(values).save(path)
    return path


def write_matrix(path: Path, matrix: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, matrix, fmt="%.9f")
    return path


def write_intrinsics(path: Path) -> Path:
    return write_matrix(path, np.array([[20.0, 0, 5.5], [0, 21.0, 4.0], [0, 0, 1]]))


def write_tum(folder: Path, period_s: float = 0.04, missing: int = 2) -> Path:
    """TUM: value/5000, a list that names `missing` more frames than there are."""
    folder.mkdir()
    stamps = 1305031233.5 + period_s * np.arange(FRAMES + missing)
    lines = ["# depth maps", "# file: 'x.bag'", "# timestamp filename"]
    lines += [f"{t:.6f} depth/{t:.6f}.png" for t in stamps]
    (folder / "depth.txt").write_text("\n".join(lines) + "\n")
    for t, depth in zip(stamps, depths_mm()):
        write_png(folder / "depth" / f"{t:.6f}.png", depth * np.uint16(5))
    rows = ["# timestamp tx ty tz qx qy qz qw"]
    for i, (t, pose) in enumerate(zip(stamps, poses())):
        half = 0.01 * i
        moved = " ".join(f"{x:.6f}" for x in pose[:3, 3])
        rows.append(f"{t + 0.003:.4f} {moved} 0 {np.sin(half):.6f} 0 {np.cos(half):.6f}")
    (folder / "groundtruth.txt").write_text("\n".join(rows) + "\n")
    write_intrinsics(folder / "intrinsics.txt")
    return folder


def write_redwood(folder: Path, entries: int = FRAMES, first: int = 0) -> Path:
    for i, depth in enumerate(depths_mm()):
        write_png(folder / "depth" / f"{first + i:05d}.png", depth)
    lines = []
    for i, pose in enumerate(poses(entries)):
        lines += [f"{i} {i} {i + 1}", *(" ".join(f"{x:.8f}" for x in row) for row in pose)]
    (folder / "trajectory.log").write_text("\n".join(lines) + "\n")
    write_intrinsics(folder / "intrinsics.txt")
    return folder


def write_sun3d(folder: Path, colour: int = FRAMES) -> Path:
    """SUN3D: rotated bits, names with microseconds, 3x4 matrices of the colour frames stacked."""
    for i, depth in enumerate(depths_mm()):
        rotated = ((depth << 3) | (depth >> 13)).astype(np.uint16)
        write_png(folder / "depth" / f"{i + 1:07d}-{33000 * i:012d}.png", rotated)
    (folder / "image").mkdir()
    for i in range(colour):
        (folder / "image" / f"{i + 1:07d}-{33000 * i + 4000:012d}.jpg").write_bytes(b"")
    write_matrix(folder / "extrinsics" / "20140808220511.txt", poses(colour)[:, :3].reshape(-1, 4))
    write_intrinsics(folder / "intrinsics.txt")
    return folder


def write_threedmatch(folder: Path) -> Path:
    for i, (depth, pose) in enumerate(zip(depths_mm(), poses())):
        write_png(
            folder / "seq-01" / f"frame-{i:06d}.depth.png",
            np.where(depth == 0, 65535, depth).astype(np.uint16),
        )
        write_matrix(folder / "seq-01" / f"frame-{i:06d}.pose.txt", pose)
    write_intrinsics(folder / "camera-intrinsics.txt")
    return folder / "seq-01"


def write_plain(folder: Path) -> Path:
    """Pictures 0.png to 10.png with unpadded numbers, for which an alphabetical order would be wrong."""
    for i, depth in enumerate(depths_mm(11)):
        write_png(folder / "depth" / f"{i}.png", depth)
    write_intrinsics(folder / "intrinsics.txt")
    return folder


def write_pfm(path: Path, values: np.ndarray, order: str = "<") -> Path:
    scale = "-1.0" if order == "<" else "1.0"
    head = f"Pf\n{values.shape[1]} {values.shape[0]}\n{scale}\n".encode("ascii")
    path.write_bytes(head + values[::-1].astype(f"{order}f4").tobytes())
    return path


# -- folders of users: depth in millimetres, poses and cameras in various forms ----------------------------


def write_frames(folder: Path, depth: str = "depth/{:04d}.png", frames: int = FRAMES) -> Path:
    """Depth pictures and intrinsics, no poses."""
    for i, values in enumerate(depths_mm(frames)):
        write_png(folder / depth.format(i), values)
    write_intrinsics(folder / "intrinsics.txt")
    return folder


def write_rows(path: Path, rows: np.ndarray, head: str = "") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(head + "\n".join(" ".join(f"{x:.9g}" for x in row) for row in rows) + "\n")
    return path


def quaternions(matrices: np.ndarray) -> np.ndarray:
    """x, y, z, w of rotations about y, float64 [n, 4]."""
    half = np.arctan2(matrices[:, 0, 2], matrices[:, 0, 0]) / 2
    zero = np.zeros(len(matrices))
    return np.stack([zero, np.sin(half), zero, np.cos(half)], axis=1)


def write_matrix_rows(folder: Path) -> Path:
    """One 4x4 matrix a line, as in NICE-SLAM's Replica."""
    write_rows(write_frames(folder) / "poses.txt", poses().reshape(-1, 16))
    return folder


def write_kitti(folder: Path) -> Path:
    write_rows(write_frames(folder) / "poses.txt", poses()[:, :3].reshape(-1, 12))
    return folder


def write_stacked(folder: Path) -> Path:
    """4x4 matrices over four lines each, as written by numpy's savetxt of stacked matrices."""
    write_rows(write_frames(folder) / "poses.txt", poses().reshape(-1, 4))
    return folder


def tum_rows(stamps: np.ndarray) -> np.ndarray:
    return np.column_stack([stamps, poses(len(stamps))[:, :3, 3], quaternions(poses(len(stamps)))])


def write_timed(folder: Path, name: str = "trajectory.txt") -> Path:
    """TUM's poses next to pictures named by nanoseconds."""
    stamps = 1_600_000_000_000_000_000 + 40_000_000 * np.arange(FRAMES)
    for stamp, values in zip(stamps.tolist(), depths_mm()):
        write_png(folder / "depth" / f"{stamp}.png", values)
    write_intrinsics(folder / "intrinsics.txt")
    lines = [
        f"{t / 1e9:.6f} " + " ".join(f"{x:.9g}" for x in row[1:]) for t, row in zip(stamps, tum_rows(stamps))
    ]
    (folder / name).write_text("# timestamp tx ty tz qx qy qz qw\n" + "\n".join(lines) + "\n")
    return folder


def write_timed_poses_txt(folder: Path) -> Path:
    """Eight columns in poses.txt, in seconds since the start, with numbered pictures."""
    write_rows(write_frames(folder) / "poses.txt", tum_rows(0.033 * np.arange(FRAMES)))
    return folder


def write_freiburg(folder: Path) -> Path:
    """ICL-NUIM's: the times are picture numbers, which start one earlier."""
    (write_frames(folder, "depth/{}.png") / "depth" / "0.png").unlink()
    for i, values in enumerate(depths_mm()):
        write_png(folder / "depth" / f"{i + 1}.png", values)
    write_rows(folder / "livingRoom1n.gt.freiburg", tum_rows(1.0 + np.arange(FRAMES)))
    return folder


def write_slambook(folder: Path) -> Path:
    """Position and quaternion without a time, with pictures from 1 on."""
    (write_frames(folder, "depth/{}.png") / "depth" / "0.png").unlink()
    for i, values in enumerate(depths_mm()):
        write_png(folder / "depth" / f"{i + 1}.png", values)
    write_rows(folder / "pose.txt", tum_rows(np.zeros(FRAMES))[:, 1:])
    return folder


def write_log(folder: Path) -> Path:
    lines = []
    for i, pose in enumerate(poses()):
        lines += [f"{i} {i} {i + 1}", *(" ".join(f"{x:.8f}" for x in row) for row in pose)]
    (write_frames(folder, "{:05d}.png") / "trajectory.log").write_text("\n".join(lines) + "\n")
    return folder


def write_colmap(folder: Path, scale: int = 2) -> Path:
    """COLMAP's text model of colour pictures `scale` times the depth's size; its points, one line empty."""
    write_frames(folder)
    (folder / "intrinsics.txt").unlink()
    inverse = np.linalg.inv(poses())
    turns = quaternions(inverse)
    lines = [
        "# Image list with two lines of data per image:",
        "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME",
    ]
    for i in (3, 0, 4, 1, 2):
        x, y, z, w = turns[i]
        shift = " ".join(f"{v:.9f}" for v in inverse[i, :3, 3])
        lines += [
            f"{i + 1} {w:.9f} {x} {y:.9f} {z} {shift} 1 rgb/{i:04d}.jpg",
            "" if i == 4 else "1.5 2.5 -1 3 4 17",
        ]
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    size = f"{scale * WIDTH} {scale * HEIGHT}"
    camera = (
        f"{scale * 20} {scale * 21} {scale * 6.0} {scale * 4.5}"  # COLMAP's pixel centres lie at one half
    )
    (model / "cameras.txt").write_text(f"# Camera list\n1 PINHOLE {size} {camera}\n")
    return folder


def write_nerfstudio(folder: Path) -> Path:
    """transforms.json: matrices in OpenGL axes, in any order, and a colour camera of twice the size."""
    write_frames(folder)
    (folder / "intrinsics.txt").unlink()
    opengl_poses = poses() @ np.diag([1.0, -1.0, -1.0, 1.0])
    frames = [
        {
            "file_path": f"images/{i:04d}.png",
            "depth_file_path": f"depth/{i:04d}.png",
            "transform_matrix": m.tolist(),
        }
        for i, m in reversed(list(enumerate(opengl_poses)))
    ]
    camera = {"w": 2 * WIDTH, "h": 2 * HEIGHT, "fl_x": 40.0, "fl_y": 42.0, "cx": 12.0, "cy": 9.0, "k1": 0.01}
    (folder / "transforms.json").write_text(json.dumps({**camera, "frames": frames}))
    return folder


def write_scannet(folder: Path) -> Path:
    """ScanNet's export: unpadded numbers, one pose file a frame."""
    write_frames(folder, "depth/{}.png")
    for i, pose in enumerate(poses()):
        write_matrix(folder / "pose" / f"{i}.txt", pose)
    return folder


def write_beside(folder: Path) -> Path:
    """0001.png, 0001.txt with 3x4 matrices, in one folder."""
    write_frames(folder, "{:04d}.png")
    for i, pose in enumerate(poses()):
        write_matrix(folder / f"{i:04d}.txt", pose[:3])
    return folder


def write_replica(folder: Path) -> Path:
    """NICE-SLAM's Replica: depth next to colour in results/, a camera with its scale in the parent folder."""
    for i, values in enumerate(depths_mm()):
        write_png(folder / "room0" / "results" / f"depth{i:06d}.png", values)
        Image.fromarray(np.zeros((HEIGHT, WIDTH, 3), np.uint8)).save(
            folder / "room0" / "results" / f"frame{i:06d}.jpg"
        )
    write_rows(folder / "room0" / "traj.txt", poses().reshape(-1, 16))
    camera = {"w": WIDTH, "h": HEIGHT, "fx": 20.0, "fy": 21.0, "cx": 5.5, "cy": 4.0, "scale": 1000.0}
    (folder / "cam_params.json").write_text(json.dumps({"camera": camera}))
    return folder / "room0"


def write_rows_of_colour(folder: Path) -> Path:
    """00000-depth.png next to 00000-color.png, a 4x4 matrix a line, an Open3D camera with its depth scale."""
    for i, values in enumerate(depths_mm()):
        write_png(folder / f"{i:05d}-depth.png", values)
        write_png(folder / f"{i:05d}-color.png", np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    write_rows(folder / "poses.txt", poses().reshape(-1, 16))
    matrix = [20.0, 0, 0, 0, 21.0, 0, 5.5, 4.0, 1]
    camera = {"width": WIDTH, "height": HEIGHT, "intrinsic_matrix": matrix, "depth_scale": 1000.0}
    (folder / "intrinsic.json").write_text(json.dumps(camera))
    return folder
