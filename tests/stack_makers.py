"""Depth in one file: TIFF of several pages, disparities and EXR of the room of `room_makers`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

import room_makers as room

CAMERA = ",".join(map(str, room.CAMERA))
BASELINE_M = 0.12


def write_tiff(path: Path, frames: list[np.ndarray]) -> Path:
    pages = [Image.fromarray(frame) for frame in frames]
    pages[0].save(path, save_all=True, append_images=pages[1:])
    (path.parent / "intrinsics.txt").write_text(CAMERA)
    np.savetxt(path.parent / "poses.txt", room.poses().reshape(-1, 16))
    return path


def disparities_px() -> np.ndarray:
    return np.stack([room.CAMERA[0] * BASELINE_M / room.depth_m(pose) for pose in room.poses()])


def write_exr(path: Path, channels: dict[str, np.ndarray]) -> Path:
    import OpenEXR as exr

    path.parent.mkdir(parents=True, exist_ok=True)
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    exr.File(header, channels).write(str(path))
    return path
