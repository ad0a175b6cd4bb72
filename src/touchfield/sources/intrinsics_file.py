"""Camera intrinsics as users and data sets write them: four numbers, a 3x3 or 4x4 matrix, or Open3D's JSON.

Sources: SUN3D and 3DMatch (3x3 text), ScanNet (4x4 text), Open3D's ``PinholeCameraIntrinsic`` (JSON, whose
``intrinsic_matrix`` is column-major), and "fx,fy,cx,cy".
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from touchfield.errors import InvalidArgument, SourceError
from touchfield.sources.camera import Intrinsics
from touchfield.sources.poses import read_text

__all__ = ["INTRINSICS_NAMES", "find_intrinsics", "intrinsics_of_matrix", "parse_intrinsics", "resolve_intrinsics"]

INTRINSICS_NAMES: Final = (
    "camera-intrinsics.txt", "intrinsics.txt", "intrinsics.json", "camera_intrinsics.txt", "intrinsic.txt",
    "camera-intrinsics.json", "camera_intrinsic.json", "intrinsic.json", "camera.json",
    "intrinsic/intrinsic_depth.txt",
)  # fmt: skip
"""Names under which an intrinsics file is looked for, the first one found being used."""

_FORMS: Final = '"fx,fy,cx,cy", a 3x3 matrix or Open3D\'s JSON'


def parse_intrinsics(text: str, where: str, size: tuple[int, int] | None = None) -> Intrinsics:
    """Intrinsics from the text of a file.

    Parameters
    ----------
    text : str
        Four numbers fx fy cx cy, 9 or 16 numbers of a matrix (rows first), or JSON.
    where : str
        What to call it in an error.
    size : (int, int) or None
        Width and height of the pictures, which JSON must agree with if it states them.

    Raises
    ------
    SourceError
        If it is none of these forms, or the matrix is not that of a pinhole camera without skew.
    """
    if text.lstrip().startswith("{"):
        return _from_json(text, where, size)
    lines = (line.partition("#")[0] for line in text.splitlines())
    words = " ".join(lines).translate(str.maketrans(",;[]()", "      ")).split()
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise SourceError(where, repr(" ".join(words)[:60]), _FORMS) from error
    if len(values) == 4:
        return _checked(values, where)
    if len(values) in (9, 16):
        n = 3 if len(values) == 9 else 4
        return intrinsics_of_matrix([values[n * i : n * i + 3] for i in range(3)], where)
    raise SourceError(where, f"{len(values)} numbers", _FORMS)


def intrinsics_of_matrix(rows: list[list[float]], where: str) -> Intrinsics:
    """Intrinsics of a 3x3 matrix given as rows: fx 0 cx, 0 fy cy, 0 0 1."""
    (fx, skew, cx), (zero, fy, cy), last = rows
    if not (abs(skew) <= 1e-3 * abs(fx) and zero == 0 and list(last) == [0, 0, 1]):
        raise SourceError(where, f"the matrix {rows}", "fx 0 cx, 0 fy cy, 0 0 1 (no skew)")
    return _checked([fx, fy, cx, cy], where)


def _checked(values: list[float], where: str) -> Intrinsics:
    try:
        return Intrinsics(*values)
    except InvalidArgument as error:
        raise SourceError(where, error.found, error.expected) from error


def _from_json(text: str, where: str, size: tuple[int, int] | None) -> Intrinsics:
    try:
        data: Any = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise SourceError(where, f"JSON that cannot be read ({error})", _FORMS) from error
    if isinstance(data.get("intrinsic"), dict):  # Open3D's PinholeCameraParameters
        data = data["intrinsic"]
    stated = (data.get("width"), data.get("height"))
    if size is not None and stated != (None, None) and stated != size:
        raise SourceError(
            where, f"intrinsics for {stated[0]} x {stated[1]} pixels", f"{size[0]} x {size[1]}, as the pictures have"
        )
    matrix = data.get("intrinsic_matrix")
    values = [data.get(k) for k in ("fx", "fy", "cx", "cy")] if matrix is None else matrix
    if not (isinstance(values, list) and all(isinstance(v, int | float) and abs(v) < 1e9 for v in values)):
        raise SourceError(where, "JSON without numbers for the camera", "intrinsic_matrix of 9, or fx, fy, cx, cy")
    numbers = [float(v) for v in values]
    if matrix is None:
        return _checked(numbers, where)
    if len(numbers) != 9:
        raise SourceError(where, f"an intrinsic_matrix of {len(numbers)} numbers", "9 numbers, columns first")
    return intrinsics_of_matrix([numbers[i::3] for i in range(3)], where)


def find_intrinsics(folders: Iterable[Path]) -> Path | None:
    """The first intrinsics file in these folders, under one of `INTRINSICS_NAMES`."""
    for folder in folders:
        for name in INTRINSICS_NAMES:
            if (folder / name).is_file():
                return folder / name
    return None


def resolve_intrinsics(asked: str | None, folders: Iterable[Path], size: tuple[int, int]) -> Intrinsics | None:
    """What the user asked for, else what a file in one of `folders` says, else None.

    Parameters
    ----------
    asked : str or None
        "fx,fy,cx,cy" or the path of a file.
    folders : iterable of Path
        Where a file is looked for.
    size : (int, int)
        Width and height of the pictures.

    Raises
    ------
    InvalidArgument
        If `asked` is neither four numbers nor a file.
    SourceError
        If a file is at fault.
    """
    if asked is None:
        found = find_intrinsics(folders)
        return None if found is None else parse_intrinsics(read_text(found), str(found), size)
    if os.path.isfile(asked):  # unlike Path.is_file, never raises for a strange name
        return parse_intrinsics(read_text(Path(asked)), asked, size)
    try:
        return parse_intrinsics(asked.replace(",", " ") if asked.count(",") == 3 else "", "--intrinsics", size)
    except SourceError as error:
        raise InvalidArgument(
            "--intrinsics", repr(asked[:80]), '"fx,fy,cx,cy" in pixels, or the path of a file that holds them'
        ) from error
