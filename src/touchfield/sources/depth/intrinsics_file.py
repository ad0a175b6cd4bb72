"""Reads the parameters of a camera (focal lengths and centre, in pixels) in the forms that users and data
sets write them.

The forms are: four numbers fx fy cx cy; a 3x3, 3x4 or 4x4 matrix, rows first (SUN3D, 3DMatch, ScanNet); JSON
(Open3D, whose ``intrinsic_matrix`` is columns first, RealSense, ROS, OpenCV, nerfstudio, NICE-SLAM); COLMAP's
``cameras.txt``. The depth unit is also read if a file states it.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument, SourceError, as_source_error
from touchfield.sources.camera import Intrinsics
from touchfield.sources.poses import floats, read_text

INTRINSICS_NAMES: Final = (
    "camera-intrinsics.txt", "intrinsics.txt", "intrinsics.json", "camera_intrinsics.txt", "intrinsic.txt",
    "camera-intrinsics.json", "camera_intrinsic.json", "camera_intrinsics.json", "intrinsic.json",
    "camera.json",
    "intrinsic/intrinsic_depth.txt", "K.txt", "calibration.txt", "cam_params.json", "camera_info.json",
    "camera_primesense.json", "cameras.txt", "sparse/0/cameras.txt", "sparse/cameras.txt",
    "colmap/cameras.txt", "transforms.json",
)  # fmt: skip
"""Names of intrinsics files; the first one found is used."""

_FORMS: Final = '"fx,fy,cx,cy", a 3x3 matrix, JSON with fx, fy, cx, cy or a matrix, or COLMAP\'s cameras.txt'
_NESTED: Final = ("intrinsic", "intrinsics", "camera", "depth_intrinsics", "camera_intrinsics", "depth")
_MATRICES: Final = ("intrinsic_matrix", "camera_matrix", "K", "k", "intrinsics", "intrinsic")
_SCALES: Final = ("depth_scale", "png_depth_scale", "scale")
_COLMAP: Final = re.compile(r"\s*\d+\s+([A-Z_0-9]*[A-Z_]+[A-Z_0-9]*)\s+(\d+)\s+(\d+)\s+(.+)")
_ASPECT_TOLERANCE: Final = 0.01
_FLIP_Y: Final = np.diag([1.0, -1.0, 1.0, 1.0])


@dataclass(frozen=True)
class CameraFile:
    """A camera from a file or an option, and the depth unit if stated.

    `units_per_m` is the number of stored depth units in a metre.

    A negative fy, as in ICL-NUIM, means a mirrored camera: the poses are of a world with inverted y.
    """

    intrinsics: Intrinsics
    units_per_m: float | None = None
    notes: tuple[str, ...] = ()
    is_mirrored: bool = False

    def poses_of_pictures(self, poses: Float64s | None) -> Float64s | None:
        """Convert poses float64 [n, 4, 4] to the axes of the pictures (y inverted if mirrored)."""
        return _FLIP_Y @ poses @ _FLIP_Y if self.is_mirrored and poses is not None else poses


def parse_intrinsics(text: str, where: str, size: tuple[int, int] | None = None) -> CameraFile:
    """Parse the camera from a text in any of the forms above.

    `where` is the name of the text in error messages.

    `size` is width and height of the pictures: JSON that states a size must agree with it; COLMAP's cameras
    are scaled to it, with a note. Raises `SourceError` for another form, or a matrix with skew.
    """
    if text.lstrip().startswith("{"):
        return _from_json(text, where, size)
    lines = [line.partition("#")[0] for line in text.splitlines()]
    cameras = {match.groups() for match in map(_COLMAP.fullmatch, lines) if match}
    if len(cameras) > 1:
        mend = "Name the camera of the depth with --intrinsics fx,fy,cx,cy."
        raise SourceError(where, f"{len(cameras)} cameras that differ", "one camera", mend)
    for model, width, height, rest in cameras:
        values = floats(rest.split(), where, _FORMS)
        if {"PINHOLE": 4, "SIMPLE_PINHOLE": 3}.get(model) != len(values):
            found = f"a camera {model} of {len(values)} numbers"
            raise SourceError(
                where, found, "PINHOLE or SIMPLE_PINHOLE", "Undistort it: colmap image_undistorter."
            )
        values = values if model == "PINHOLE" else [values[0], *values]
        return _scaled(values, (int(width), int(height)), where, size)
    text_of_numbers = " ".join(lines).translate(str.maketrans(",;[]()", "      "))
    return _of_numbers(floats(text_of_numbers.split(), where, _FORMS), where)


def _of_numbers(values: list[float], where: str) -> CameraFile:
    """Return the camera of fx fy cx cy, or of a matrix of three or four rows: fx 0 cx, 0 fy cy, 0 0 1."""
    if len(values) == 4:
        return _checked(values, where)
    if len(values) not in (9, 12, 16):
        raise SourceError(where, f"{len(values)} numbers", _FORMS)
    n = 3 if len(values) == 9 else 4
    (fx, skew, cx), (zero, fy, cy), last = rows = [values[n * i : n * i + 3] for i in range(3)]
    if not (abs(skew) <= 1e-3 * abs(fx) and zero == 0 and last == [0, 0, 1]):
        raise SourceError(where, f"the matrix {rows}", "fx 0 cx, 0 fy cy, 0 0 1 (no skew)")
    return _checked([fx, fy, cx, cy], where)


def _checked(values: list[float], where: str) -> CameraFile:
    fx, fy, cx, cy = values
    is_mirrored = fx > 0 > fy
    notes = ("fy is negative: y of the camera and of its poses is turned over.",) if is_mirrored else ()
    with as_source_error(f"{where}: "):
        return CameraFile(Intrinsics(fx, abs(fy) if is_mirrored else fy, cx, cy), None, notes, is_mirrored)


def _from_json(text: str, where: str, size: tuple[int, int] | None) -> CameraFile:
    try:
        data: Any = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise SourceError(where, f"JSON that cannot be read ({error})", _FORMS) from error
    scale = _number(data, _SCALES)
    for key in _NESTED:  # Open3D's PinholeCameraParameters, NICE-SLAM's camera
        if isinstance(data.get(key), dict):
            data = data[key]
            scale = scale or _number(data, _SCALES)
    stated = tuple(data.get(key, data.get(short)) for key, short in (("width", "w"), ("height", "h")))
    if "frames" in data:  # nerfstudio: the intrinsics of the colour pictures
        keys = ("w", "h", "fl_x", "fl_y", "cx", "cy")
        stored = [value for key in keys if (value := _number(data, (key,))) is not None]
        if len(stored) == len(keys):
            width, height, *values = stored
            camera = _scaled(values, (int(width), int(height)), where, size)
            has_distortion = any(_number(data, (key,)) for key in ("k1", "k2", "p1", "p2"))
            distortion_notes = (
                (f"The distortion in {Path(where).name} is not corrected.",) if has_distortion else ()
            )
            return replace(camera, notes=(*camera.notes, *distortion_notes))
    if size is not None and stated != (None, None) and stated != size:
        found = f"intrinsics for {stated[0]} x {stated[1]} pixels"
        raise SourceError(where, found, f"{size[0]} x {size[1]}, as the pictures have")
    units_per_m = None if scale is None or not scale > 0 else (scale if scale >= 1 else 1 / scale)
    notes: tuple[str, ...] = ()
    if units_per_m is not None:
        notes = (f"{Path(where).name} says {units_per_m:g} units of depth in a metre.",)
    names = (("fx", "fl_x"), ("fy", "fl_y"), ("cx", "ppx"), ("cy", "ppy"))  # also of RealSense and nerfstudio
    numbers = [value for keys in names if (value := _number(data, keys)) is not None]
    if len(numbers) < 4:
        numbers = _matrix_of_json(data, where)
    camera = _of_numbers(numbers, where)
    return replace(camera, units_per_m=units_per_m, notes=(*camera.notes, *notes))


def _number(data: Any, keys: tuple[str, ...]) -> float | None:
    """Return the number at the first of these keys that holds a number below 1e9 in magnitude."""
    for key in keys:
        value = data.get(key)
        if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e9:
            return float(value)
    return None


def _matrix_of_json(data: Any, where: str) -> list[float]:
    """Return the numbers of a matrix, rows first.

    The positions of the zeros show whether nine numbers in one list are stored by rows or by columns.
    """
    matrix = next((data[key] for key in _MATRICES if key in data), None)
    if isinstance(matrix, dict):
        matrix = matrix.get("data")  # OpenCV's
    if isinstance(matrix, list) and matrix and all(isinstance(row, list) for row in matrix):
        matrix = [value for row in matrix for value in row]
    if not (isinstance(matrix, list) and all(isinstance(v, int | float) and abs(v) < 1e9 for v in matrix)):
        expected = "intrinsic_matrix, camera_matrix or K of 9, or fx, fy, cx, cy"
        raise SourceError(where, "JSON without numbers for the camera", expected)
    numbers = [float(v) for v in matrix]
    is_column_major = len(numbers) == 9 and numbers[2] == numbers[5] == 0 and (numbers[6] or numbers[7])
    return [numbers[3 * (i % 3) + i // 3] for i in range(9)] if is_column_major else numbers


def _scaled(
    values: list[float], stated: tuple[int, int], where: str, size: tuple[int, int] | None
) -> CameraFile:
    """Scale a camera for pictures of `stated` pixels to the size of the depth.

    In the given camera pixel centres lie at one half, in the result at whole numbers.
    """
    fx, fy, cx, cy = values
    width, height = stated
    x_scale, y_scale = (
        (1.0, 1.0) if size is None else (size[0] / max(stated[0], 1), size[1] / max(stated[1], 1))
    )
    if abs(x_scale / y_scale - 1) > _ASPECT_TOLERANCE:
        expected = "the aspect of the pictures, " + " x ".join(map(str, size or ()))
        raise SourceError(where, f"a camera of {width} x {height} pixels", expected)
    camera = _checked([fx * x_scale, fy * y_scale, cx * x_scale - 0.5, cy * y_scale - 0.5], where)
    if x_scale == y_scale == 1:
        return camera
    note = f"{Path(where).name} is for {width} x {height} pixels: scaled to the depth's."
    return replace(camera, notes=(*camera.notes, note))


def named_like_intrinsics(folders: Iterable[Path]) -> Iterator[Path]:
    """Return the files of these folders that are named in `INTRINSICS_NAMES`."""
    return (folder / name for folder in folders for name in INTRINSICS_NAMES if (folder / name).is_file())


def camera_of(
    name: str,
    intrinsics: str | None,
    folders: Iterable[Path],
    size: tuple[int, int],
    default: CameraFile | None = None,
) -> CameraFile:
    """Return the requested camera, else that of a file, else the default.

    Files are searched in `folders`.

    `name` names the source in an error, `intrinsics` is "fx,fy,cx,cy" or the path of a file, `size` width and
    height of the pictures. Raises `InvalidArgument` if `intrinsics` is neither; `SourceError` if a file is
    invalid, or there is no camera.
    """
    if intrinsics is None:
        for file in named_like_intrinsics(folders):
            camera = parse_intrinsics(read_text(file), str(file), size)
            return replace(camera, notes=(f"The camera is that of {file.name}.", *camera.notes))
        if default is not None:
            return default
        mend = "Add --intrinsics fx,fy,cx,cy, or a file intrinsics.txt in the folder."
        raise SourceError(name, "no camera intrinsics", "fx, fy, cx, cy in pixels", mend)
    if os.path.isfile(intrinsics):  # unlike Path.is_file, never raises for a strange name
        return parse_intrinsics(read_text(Path(intrinsics)), intrinsics, size)
    try:
        return parse_intrinsics(
            intrinsics.replace(",", " ") if intrinsics.count(",") == 3 else "", "--intrinsics", size
        )
    except SourceError as error:
        expected = '"fx,fy,cx,cy" in pixels, or the path of a file that holds them'
        raise InvalidArgument("--intrinsics", repr(intrinsics[:80]), expected) from error
