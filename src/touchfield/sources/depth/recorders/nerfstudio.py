"""nerfstudio's data with depth: ``transforms.json`` whose frames name a ``depth_file_path``
(docs.nerf.studio, "Data conventions").

transforms.json   fl_x, fl_y, cx, cy, w, h and the distortion of the colour pictures, for all frames or in
                  each frame; transform_matrix: camera to world in OpenGL's axes; depth_file_path
depth pictures    16 bits, millimetres (nerfstudio's depth_unit_scale_factor 0.001), or NPY; of any size

A frame without depth is left out. Floats are taken as metres, unless ``depth_unit_scale_factor`` is stated.
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path, PurePosixPath
from typing import Any, Final

from touchfield.errors import SourceError
from touchfield.sources.depth.frame_poses import PosedFrames
from touchfield.sources.depth.intrinsics_file import CameraFile, camera_of_data
from touchfield.sources.depth.layouts import Layout, PictureSet
from touchfield.sources.images.pictures import picture_header
from touchfield.sources.poses import parse_poses, read_text

_NAME: Final = "transforms.json"
_CAMERA_KEYS: Final = ("w", "h", "fl_x", "fl_y", "cx", "cy")
_MILLIMETRES: Final = 1000.0


def _contents(path: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the whole file, and its frames that have depth, by the names of the depth pictures."""
    file = path / _NAME
    try:
        data = json.loads(read_text(file))
        frames = [frame for frame in data["frames"] if "depth_file_path" in frame]
        frames.sort(key=lambda frame: _natural(str(frame["depth_file_path"])))
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        expected = "frames, each with file_path and transform_matrix"
        raise SourceError(str(file), f"JSON that cannot be read ({error})", expected) from error
    return data, frames


def _natural(name: str) -> list[tuple[int, str]]:
    """Return the key that sorts names by their numbers."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)]


def _list_pictures(path: Path) -> PictureSet:
    data, frames = _contents(path)
    paths = []
    for frame in frames:
        name = PurePosixPath(str(frame["depth_file_path"]))
        if name.is_absolute() or ".." in name.parts:
            raise SourceError(str(path / _NAME), repr(str(name)[:80]), "a file name inside the folder")
        paths.append(path / name)
    missing = [file for file in paths if not os.path.isfile(file)]  # also of a name that is too long
    if missing:
        found = (
            f"no {missing[0].relative_to(path)} ({len(missing)} of {len(paths)} depth pictures are missing)"
        )
        raise SourceError(str(path / _NAME), found, "the depth pictures that it names", "Copy them too.")
    count = len(data["frames"])
    notes = (f"{count - len(paths)} of {count} frames left out: no depth.",) if len(paths) < count else ()
    return PictureSet(tuple(paths), path, (path,), (path,), notes=notes)


def _poses(path: Path, _paths: tuple[Path, ...]) -> PosedFrames:
    _, frames = _contents(path)
    listed = parse_poses(json.dumps({"frames": frames}), str(path / _NAME))
    note = f"Poses of {_NAME}: {listed.form}; matched by the names of pictures."
    return PosedFrames(tuple(range(len(frames))), listed.poses, (note,))


def _cameras(path: Path, paths: tuple[Path, ...], size: tuple[int, int]) -> tuple[CameraFile, ...]:
    data, frames = _contents(path)
    name = str(path / _NAME)
    scale = data.get("depth_unit_scale_factor")
    is_metres = picture_header(paths[0]).sample.startswith("float")
    units_per_m = 1.0 if is_metres else _MILLIMETRES
    if isinstance(scale, int | float) and 0 < scale < 1e6:
        units_per_m = 1 / scale
    has_own = any(key in frame for frame in frames for key in _CAMERA_KEYS[2:])
    shared = {key: value for key, value in data.items() if key != "frames"}
    cameras = []
    for frame in frames if has_own else frames[:1]:
        camera = camera_of_data({**shared, **frame, "frames": []}, name, size)
        cameras.append(CameraFile(camera.intrinsics, units_per_m, camera.notes, False, camera.distortion))
    return tuple(cameras)


def _recognise(path: Path) -> bool:
    file = path / _NAME
    return file.is_file() and '"depth_file_path"' in read_text(file)


LAYOUT: Final = Layout(
    "nerfstudio",
    "nerfstudio's data with depth: a folder with transforms.json whose frames name a depth_file_path",
    _recognise,
    _list_pictures,
    poses=_poses,
    cameras=_cameras,
)
KIND: Final = LAYOUT.kind
