"""Small depth sequences in every layout, written as the data sets write them."""

from __future__ import annotations

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
            folder / "seq-01" / f"frame-{i:06d}.depth.png", np.where(depth == 0, 65535, depth).astype(np.uint16)
        )
        write_matrix(folder / "seq-01" / f"frame-{i:06d}.pose.txt", pose)
    write_intrinsics(folder / "camera-intrinsics.txt")
    return folder


def write_plain(folder: Path) -> Path:
    """Pictures 0.png to 10.png, whose numbers are not padded: an order by letters would be wrong."""
    for i, depth in enumerate(depths_mm(11)):
        write_png(folder / "depth" / f"{i}.png", depth)
    write_intrinsics(folder / "intrinsics.txt")
    return folder


def write_pfm(path: Path, values: np.ndarray, order: str = "<") -> Path:
    scale = "-1.0" if order == "<" else "1.0"
    head = f"Pf\n{values.shape[1]} {values.shape[0]}\n{scale}\n".encode("ascii")
    path.write_bytes(head + values[::-1].astype(f"{order}f4").tobytes())
    return path
