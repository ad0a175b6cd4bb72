"""Reads the parameters of a camera (focal lengths and centre, in pixels) in the forms that users and data
sets write them.

The forms are: four numbers fx fy cx cy; a 3x3, 3x4 or 4x4 matrix, rows first (SUN3D, 3DMatch, ScanNet); JSON
(Open3D, whose ``intrinsic_matrix`` is columns first, RealSense, ROS, OpenCV, nerfstudio, NICE-SLAM); YAML
(ROS, OpenCV, Kalibr, ORB-SLAM); COLMAP's ``cameras.txt``. The depth unit is also read if a file states it,
and so is the distortion of the lens (`touchfield.sources.depth.lens`), which may also follow the four numbers
or the 3x3 matrix.
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
from touchfield.sources.depth.lens import Distortion, Lens, distortion_of
from touchfield.sources.depth.plain_yaml import parse_yaml
from touchfield.sources.poses import floats, read_text

INTRINSICS_NAMES: Final = (
    "camera-intrinsics.txt", "intrinsics.txt", "intrinsics.json", "camera_intrinsics.txt", "intrinsic.txt",
    "camera-intrinsics.json", "camera_intrinsic.json", "camera_intrinsics.json", "intrinsic.json",
    "camera.json",
    "intrinsic/intrinsic_depth.txt", "K.txt", "calibration.txt", "cam_params.json", "camera_info.json",
    "camera_primesense.json", "calibration.json", "cameras.txt", "sparse/0/cameras.txt", "sparse/cameras.txt",
    "colmap/cameras.txt", "transforms.json",
    *(f"{stem}.{suffix}" for stem in ("camera_info", "camera_intrinsics", "intrinsics", "calibration",
                                      "camera", "calib", "ost", "camchain") for suffix in ("yaml", "yml")),
)  # fmt: skip
"""Names of intrinsics files; the first one found is used."""

_FORMS: Final = (
    '"fx,fy,cx,cy", a 3x3 matrix, JSON or YAML with fx, fy, cx, cy or a matrix, or COLMAP\'s cameras.txt'
)
_NESTED: Final = (
    "intrinsic", "intrinsics", "camera", "depth_intrinsics", "camera_intrinsics", "depth", "cam0", "Camera",
    "left",
)  # fmt: skip
_MATRICES: Final = (
    "intrinsic_matrix", "camera_matrix", "K", "k", "intrinsics", "intrinsic", "cameraMatrix", "Camera_Matrix",
    "camera_Matrix", "mtx",
)  # fmt: skip
_SCALES: Final = ("depth_scale", "png_depth_scale", "scale", "DepthMapFactor", "RGBD.DepthMapFactor")
_DISTORTIONS: Final = (
    "D", "d", "distortion_coefficients", "distortion_coeffs", "Distortion_Coefficients", "distCoeffs",
    "dist_coeffs", "dist_coeff", "distortion", "coeffs", "coefficients", "dist",
)  # fmt: skip
_MODELS: Final = ("distortion_model", "distortion_type", "camera_model", "model", "Camera.type")
_BROWN_KEYS: Final = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_DISTORTION_COUNTS: Final = (4, 5, 8)  # of numbers after the camera
_COLMAP_MODELS: Final = {  # numbers of the camera (f or fx fy, cx cy), of the distortion
    "SIMPLE_PINHOLE": (3, 0), "PINHOLE": (4, 0), "SIMPLE_RADIAL": (3, 1), "RADIAL": (3, 2), "OPENCV": (4, 4),
    "FULL_OPENCV": (4, 8), "OPENCV_FISHEYE": (4, 4), "SIMPLE_RADIAL_FISHEYE": (3, 1),
    "RADIAL_FISHEYE": (3, 2),
}  # fmt: skip
_COLMAP: Final = re.compile(r"\s*\d+\s+([A-Z_0-9]*[A-Z_]+[A-Z_0-9]*)\s+(\d+)\s+(\d+)\s+(.+)")
_ASPECT_TOLERANCE: Final = 0.01
_SEPARATORS: Final = str.maketrans(",;[]()", "      ")
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
    distortion: Distortion | None = None

    @property
    def lens(self) -> Lens:
        """The camera with its distortion."""
        return Lens(self.intrinsics, self.distortion)

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
    if re.search(r"^\s*[A-Za-z][\w.]*\s*:", text, re.MULTILINE):
        return camera_of_data(parse_yaml(text, where), where, size)
    lines = [line.partition("#")[0] for line in text.splitlines()]
    cameras = {match.groups() for match in map(_COLMAP.fullmatch, lines) if match}
    if len(cameras) > 1:
        mend = "Name the camera of the depth with --intrinsics fx,fy,cx,cy."
        raise SourceError(where, f"{len(cameras)} cameras that differ", "one camera", mend)
    for model, width, height, rest in cameras:
        values = floats(rest.split(), where, _FORMS)
        count, distortion_count = _COLMAP_MODELS.get(model, (0, 0))
        if not count or len(values) != count + distortion_count:
            found = f"a camera {model} of {len(values)} numbers"
            raise SourceError(
                where, found, f"one of {', '.join(_COLMAP_MODELS)}", "Undistort it: colmap image_undistorter."
            )
        coefficients, values = values[count:], values[:count]
        values = values if count == 4 else [values[0], *values]
        camera = _scaled(values, (int(width), int(height)), where, size)
        return replace(camera, distortion=distortion_of(coefficients, Path(where).name, model))
    rows = [floats(line.translate(_SEPARATORS).split(), where, _FORMS) for line in lines]
    return _of_rows([row for row in rows if row], where)


def _of_rows(rows: list[list[float]], where: str) -> CameraFile:
    """Return the camera of lines of numbers: a camera, perhaps with the distortion after it."""
    values = [value for row in rows for value in row]
    is_one_row = len(rows) == 1
    for count in _DISTORTION_COUNTS:
        is_after_four = (
            len(values) == 4 + count and (len(rows[0]) == 4 or is_one_row) and not _is_matrix(values)
        )
        is_after_nine = len(values) == 9 + count and values[6:9] == [0, 0, 1]
        if is_after_four or is_after_nine:
            start = 4 if is_after_four else 9
            distortion = distortion_of(values[start:], Path(where).name)
            return replace(_of_numbers(values[:start], where), distortion=distortion)
    return _of_numbers(values, where)


def _is_matrix(values: list[float]) -> bool:
    """Return True if 9 or 12 numbers are a matrix: its second number is a skew, not a focal length."""
    columns = len(values) // 3
    has_last_row = values[2 * columns : 2 * columns + 3] == [0, 0, 1]
    return len(values) in (9, 12) and (has_last_row or abs(values[1]) < 0.2 * abs(values[0]))


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
    if not isinstance(data, dict):
        raise SourceError(where, "JSON that is no object", _FORMS)
    return camera_of_data(data, where, size)


def camera_of_data(data: dict[str, Any], where: str, size: tuple[int, int] | None) -> CameraFile:
    """Return the camera of the contents of a JSON or YAML file; see `parse_intrinsics`."""
    scale = _number(data, _SCALES)
    for key in _NESTED:  # Open3D's PinholeCameraParameters, NICE-SLAM's camera
        if isinstance(data.get(key), dict):
            data = data[key]
            scale = scale or _number(data, _SCALES)
    name = Path(where).name
    if "frames" in data:  # nerfstudio: the intrinsics of the colour pictures
        keys = ("w", "h", "fl_x", "fl_y", "cx", "cy")
        stored = [value for key in keys if (value := _number(data, (key,))) is not None]
        if len(stored) == len(keys):
            width, height, *values = stored
            camera = _scaled(values, (int(width), int(height)), where, size)
            return replace(camera, distortion=_distortion_of_data(data, name))
    stated = _stated_size(data)
    if size is not None and stated is not None and stated != size:
        found = f"intrinsics for {stated[0]} x {stated[1]} pixels"
        raise SourceError(where, found, f"{size[0]} x {size[1]}, as the pictures have")
    units_per_m = None if scale is None or not scale > 0 else (scale if scale >= 1 else 1 / scale)
    notes: tuple[str, ...] = ()
    if units_per_m is not None:
        notes = (f"{name} says {units_per_m:g} units of depth in a metre.",)
    names = (  # also of RealSense, nerfstudio and ORB-SLAM
        ("fx", "fl_x", "Camera.fx", "Camera1.fx"), ("fy", "fl_y", "Camera.fy", "Camera1.fy"),
        ("cx", "ppx", "Camera.cx", "Camera1.cx"), ("cy", "ppy", "Camera.cy", "Camera1.cy"),
    )  # fmt: skip
    numbers = [value for keys in names if (value := _number(data, keys)) is not None]
    if len(numbers) < 4:
        numbers = _matrix_of_json(data, where)
    camera = _of_numbers(numbers, where)
    distortion = _distortion_of_data(data, name)
    return replace(camera, units_per_m=units_per_m, notes=(*camera.notes, *notes), distortion=distortion)


def _stated_size(data: dict[str, Any]) -> tuple[Any, Any] | None:
    """Return the width and height that a file states, None if it states none."""
    names = (("width", "w", "image_width", "Camera.width"), ("height", "h", "image_height", "Camera.height"))
    stated = tuple(next((data[key] for key in keys if key in data), None) for keys in names)
    resolution = data.get("resolution")  # Kalibr's
    if stated == (None, None) and isinstance(resolution, list) and len(resolution) == 2:
        return resolution[0], resolution[1]
    return None if stated == (None, None) else (stated[0], stated[1])


def _distortion_of_data(data: dict[str, Any], name: str) -> Distortion | None:
    """Return the distortion that a JSON or YAML file states; `name` is its name in messages."""
    model = next((data[key] for key in _MODELS if isinstance(data.get(key), str)), "")
    stored: Any = next((data[key] for key in _DISTORTIONS if isinstance(data.get(key), list | dict)), None)
    if isinstance(stored, dict):
        stored = stored.get("data", stored)
    if isinstance(stored, list):
        flat = [value for row in stored for value in (row if isinstance(row, list) else [row])]
        if not all(isinstance(value, int | float) and not abs(value) >= 1e9 for value in flat):
            raise SourceError(name, f"the distortion {str(stored)[:60]}", "numbers")
        return distortion_of(flat, name, model)
    named = stored if isinstance(stored, dict) else data
    is_fisheye = "fish" in model.lower() or "equi" in model.lower() or "kannala" in model.lower()
    keys = ("k1", "k2", "k3", "k4") if is_fisheye else _BROWN_KEYS
    values = [_number(named, (key, f"Camera.{key}", f"Camera1.{key}")) or 0.0 for key in keys]
    return distortion_of(values, name, model)


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


def scaled_camera(k: Intrinsics, stated: tuple[int, int], where: str, size: tuple[int, int]) -> CameraFile:
    """Scale a camera for pictures of `stated` pixels, centres at one half, to depth of `size` pixels.

    Raises `SourceError`, which names `where`, if the aspects differ by more than 1 %.
    """
    return _scaled([k.fx, k.fy, k.cx, k.cy], stated, where, size)


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
    missing: str = "",
) -> CameraFile:
    """Return the requested camera, else that of a file, else the default.

    Files are searched in `folders`.

    `name` names the source in an error, `intrinsics` is "fx,fy,cx,cy" or the path of a file, `size` width and
    height of the pictures, and `missing` how to add what else is missing, for the error without a camera.
    Raises `InvalidArgument` if `intrinsics` is neither; `SourceError` if a file is invalid, or there is no
    camera.
    """
    if intrinsics is None:
        for file in named_like_intrinsics(folders):
            camera = parse_intrinsics(read_text(file), str(file), size)
            return replace(camera, notes=(f"The camera is that of {file.name}.", *camera.notes))
        if default is not None:
            return default
        mend = f"Add --intrinsics fx,fy,cx,cy, or a file intrinsics.txt in the folder. {missing}".rstrip()
        raise SourceError(name, "no camera intrinsics", "fx, fy, cx, cy in pixels", mend)
    if os.path.isfile(intrinsics):  # unlike Path.is_file, never raises for a strange name
        return parse_intrinsics(read_text(Path(intrinsics)), intrinsics, size)
    try:
        is_list = intrinsics.count(",") in (3, *(3 + count for count in _DISTORTION_COUNTS))
        return parse_intrinsics(intrinsics.replace(",", " ") if is_list else "", "--intrinsics", size)
    except SourceError as error:
        expected = '"fx,fy,cx,cy" in pixels, or the path of a file that holds them'
        raise InvalidArgument("--intrinsics", repr(intrinsics[:80]), expected) from error
