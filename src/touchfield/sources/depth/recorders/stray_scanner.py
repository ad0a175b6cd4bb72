"""Stray Scanner, an app of iPhones and iPads with a lidar (strayrobots/scanner, docs/format.md).

depth/000000.png        16 bits, millimetres, 256 x 192
confidence/000000.png   0 (low), 1, 2; depth of confidence 0 is left out
odometry.csv            timestamp, frame, x, y, z, qx, qy, qz, qw: camera to world, axes of the pictures
camera_matrix.csv       3x3, of the colour video, 1920 x 1440
rgb.mp4, imu.csv        not read
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from touchfield.errors import SourceError
from touchfield.sources.depth.frame_poses import PosedFrames, drop_unposed
from touchfield.sources.depth.intrinsics_file import CameraFile, parse_intrinsics, scaled_camera
from touchfield.sources.depth.layouts import Layout, PictureSet
from touchfield.sources.depth.recorders.confidence import confident_reader
from touchfield.sources.images.pictures import has_files, list_files
from touchfield.sources.poses import IGNORE_POSES, parse_poses, read_text

_COLOUR_SIZE: Final = (1920, 1440)
_CENTRE_TOLERANCE: Final = 0.15  # of the principal point from the middle of the picture
_FRAME: Final = r"\d+\.png"


def _list_pictures(path: Path) -> PictureSet:
    has_confidence = has_files(path / "confidence", _FRAME)
    note = "Depth of low confidence is left out (confidence/)."
    notes = (note,) if has_confidence else ("No confidence/: all depth is used.",)
    return PictureSet(list_files(path / "depth", _FRAME), path, (path,), (path,), notes=notes)


def _poses(path: Path, paths: tuple[Path, ...]) -> PosedFrames:
    file = path / "odometry.csv"
    listed = parse_poses(read_text(file), str(file))
    if listed.numbers is None:
        raise SourceError(str(file), f"poses as {listed.form}", "a column frame", IGNORE_POSES)
    entries = dict(zip(listed.numbers.tolist(), listed.poses))
    posed = drop_unposed(str(file), [entries.get(int(picture.stem)) for picture in paths], "no entry")
    return posed._replace(
        notes=(*posed.notes, f"Poses of {file.name}: {listed.form}; by the number of the frame.")
    )


def _cameras(path: Path, _: tuple[Path, ...], size: tuple[int, int]) -> tuple[CameraFile, ...]:
    file = path / "camera_matrix.csv"
    k = parse_intrinsics(read_text(file), str(file)).intrinsics
    width, height = _COLOUR_SIZE
    is_central = abs(k.cx / width - 0.5) < _CENTRE_TOLERANCE and abs(k.cy / height - 0.5) < _CENTRE_TOLERANCE
    if not is_central:
        found = f"a principal point {k.cx:g}, {k.cy:g}"
        expected = f"that of the colour video, {width} x {height}"
        raise SourceError(
            str(file), found, expected, "Give the camera of the depth: --intrinsics fx,fy,cx,cy."
        )
    return (scaled_camera(k, _COLOUR_SIZE, str(file), size),)


LAYOUT: Final = Layout(
    "stray-scanner",
    "Stray Scanner recording: a folder with depth/, odometry.csv, camera_matrix.csv",
    lambda path: (
        (path / "odometry.csv").is_file()
        and (path / "camera_matrix.csv").is_file()
        and has_files(path / "depth", _FRAME)
    ),
    _list_pictures,
    1000.0,
    poses=_poses,
    cameras=_cameras,
    read=confident_reader(lambda path: path.parent.parent / "confidence" / path.name, 1),
)
KIND: Final = LAYOUT.kind
