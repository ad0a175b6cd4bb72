"""Raw data of Polycam, an app of phones with a lidar (PolyCam/polyform, README.md).

keyframes/depth/TIME.png              16 bits, millimetres; TIME in microseconds
keyframes/confidence/TIME.png         0 (low), 127, 255; depth of low confidence is left out
keyframes/corrected_cameras/TIME.json fx, fy, cx, cy, width, height of the colour picture, and t_00 to t_23:
                                      camera to world in ARKit's axes (x right, y up, z backward), globally
                                      optimised
keyframes/cameras/TIME.json           the same as ARKit tracked it; used where there is no corrected one
raw.glb, images                       not read

The folder keyframes/ itself may be given, too.
"""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.errors import SourceError, as_source_error
from touchfield.sources.camera import Intrinsics
from touchfield.sources.depth.frame_poses import PosedFrames, drop_unposed
from touchfield.sources.depth.intrinsics_file import CameraFile, scaled_camera
from touchfield.sources.depth.layouts import Layout, PictureSet
from touchfield.sources.depth.recorders.confidence import confident_reader
from touchfield.sources.images.pictures import has_files, list_files
from touchfield.sources.poses import IGNORE_POSES, checked_poses, read_text

_FRAME: Final = r"\d+\.png"
_NUMBERS: Final = ("fx", "fy", "cx", "cy", "width", "height")
_MATRIX: Final = tuple(f"t_{row}{column}" for row in range(3) for column in range(4))
_FROM_ARKIT: Final = np.diag([1.0, -1.0, -1.0, 1.0])
_LOWEST_USED: Final = 100  # confidence is 0, 127 or 255


def _keyframes(path: Path) -> Path:
    return path / "keyframes" if (path / "keyframes").is_dir() else path


def _list_pictures(path: Path) -> PictureSet:
    paths = list_files(_keyframes(path) / "depth", _FRAME)
    has_confidence = has_files(_keyframes(path) / "confidence", _FRAME)
    note = "Depth of low confidence is left out (keyframes/confidence/)."
    notes = (note,) if has_confidence else ("No keyframes/confidence/: all depth is used.",)
    return PictureSet(paths, path, (path,), (path,), notes=notes)


def _camera_file(path: Path, picture: Path) -> Path | None:
    names = ("corrected_cameras", "cameras")
    files = (_keyframes(path) / name / f"{picture.stem}.json" for name in names)
    return next((file for file in files if file.is_file()), None)


@lru_cache(maxsize=4096)
def _numbers(file: Path, _modified_ns: int) -> dict[str, float]:
    """Return the numbers of a camera file; `_modified_ns` makes a changed file another key."""
    try:
        data: Any = json.loads(read_text(file))
        numbers = {key: float(data[key]) for key in (*_NUMBERS, *_MATRIX)}
        if not (1 <= numbers["width"] < 1e6 and 1 <= numbers["height"] < 1e6):
            raise ValueError("no width and height")
        return numbers
    except (ValueError, TypeError, KeyError, RecursionError, OverflowError) as error:
        expected = f"JSON with {', '.join(_NUMBERS)} and t_00 to t_23"
        raise SourceError(str(file), f"no camera ({error})", expected, IGNORE_POSES) from error


def _read(file: Path) -> dict[str, float]:
    return _numbers(file, file.stat().st_mtime_ns)


def _poses(path: Path, paths: tuple[Path, ...]) -> PosedFrames:
    files = [_camera_file(path, picture) for picture in paths]
    poses = []
    for file in files:
        matrix = None if file is None else np.array([_read(file)[key] for key in _MATRIX]).reshape(1, 3, 4)
        poses.append(None if matrix is None else checked_poses(matrix, str(file))[0] @ _FROM_ARKIT)
    posed = drop_unposed(str(_keyframes(path)), poses, "no camera file")
    corrected = sum(file is not None and file.parent.name == "corrected_cameras" for file in files)
    note = (
        f"Poses of Polycam, ARKit's axes turned over: {corrected} of {len(posed.indices)} globally optimised."
    )
    return posed._replace(notes=(*posed.notes, note))


def _cameras(path: Path, paths: tuple[Path, ...], size: tuple[int, int]) -> tuple[CameraFile, ...]:
    """Return the camera of each picture; a picture without one has that of the first picture with one."""
    files = [_camera_file(path, picture) for picture in paths]
    first = next((file for file in files if file is not None), None)
    if first is None:
        found = "no camera file"
        raise SourceError(str(_keyframes(path)), found, "cameras/TIME.json", "Give --intrinsics fx,fy,cx,cy.")
    cameras = []
    for file in files:
        numbers = _read(file or first)
        with as_source_error(f"{file or first}: "):
            k = Intrinsics(*(numbers[key] for key in ("fx", "fy", "cx", "cy")))
        stated = (int(numbers["width"]), int(numbers["height"]))
        cameras.append(scaled_camera(k, stated, str(file or first), size))
    return tuple(cameras)


def _recognise(path: Path) -> bool:
    folder = _keyframes(path)
    names = ("corrected_cameras", "cameras")
    has_cameras = any(has_files(folder / name, r"\d+\.json") for name in names)
    return has_cameras and has_files(folder / "depth", _FRAME)


LAYOUT: Final = Layout(
    "polycam",
    "raw data of Polycam: a folder with keyframes/depth/, keyframes/cameras/ or corrected_cameras/",
    _recognise,
    _list_pictures,
    1000.0,
    poses=_poses,
    cameras=_cameras,
    read=confident_reader(lambda path: path.parent.parent / "confidence" / path.name, _LOWEST_USED),
)
KIND: Final = LAYOUT.kind
