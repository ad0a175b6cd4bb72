"""Lists of camera poses as people write them, their form told by their content.

* 12 or 16 numbers a line: a 3x4 (KITTI) or 4x4 matrix; 13 or 17: the same behind the number of a frame (KITTI-360);
  4 a line: such matrices over several lines;
* 8 numbers a line: TUM's ``time tx ty tz qx qy qz qw``; times may be in milli-, micro- or nanoseconds;
* 7 numbers: ``tx ty tz qx qy qz qw`` or ``qw qx qy qz tx ty tz`` (RGB-D Scenes), told by which four are of length 1;
* Redwood's ``trajectory.log``: three numbers, then a 4x4 matrix over four lines;
* COLMAP's ``images.txt``: quaternion and translation of the *world in the camera*, and the name of a picture;
* nerfstudio's ``transforms.json``: 4x4 matrices in the axes of OpenGL, and the names of pictures.

All but these two are taken as scene from camera, metres, in the axes of the pictures: x right, y down, z forward.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import SourceError
from touchfield.sources.poses import (
    IGNORE_POSES,
    checked_poses,
    matrices_from_quaternions,
    number_rows,
    parse_timed_poses,
    parse_trajectory_log,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64s = NDArray[np.float64]

__all__ = ["PoseList", "parse_colmap_images", "parse_poses"]

_FORMS: Final = (
    "12 or 16 numbers a line (3x4, 4x4), 8 or 7 ([time] tx ty tz qx qy qz qw), a Redwood log, or COLMAP's images.txt"
)
_FROM_CAMERA: Final = "scene from camera"


@dataclass(frozen=True)
class PoseList:
    """Poses of a file, and what they belong to.

    Attributes
    ----------
    poses : float64 [n, 4, 4]
        Scene from camera, metres.
    form : str
        How they are written, and in which convention, as a note says it.
    times_s : float64 [n] or None
        Ascending.
    numbers : int64 [n] or None
        Of frames.
    names : tuple of str or None
        Of pictures.
    """

    poses: Float64s
    form: str
    times_s: Float64s | None = None
    numbers: NDArray[np.int64] | None = None
    names: tuple[str, ...] | None = None


def parse_poses(text: str, where: str) -> PoseList:
    """Poses of a text in any of the forms above.

    Raises
    ------
    SourceError
        If it is in none of them, or a pose is no rigid motion.
    """
    if text.lstrip().startswith("{"):
        return _of_transforms(text, where)
    lines = [line.partition("#")[0].replace(",", " ").split() for line in text.splitlines()]
    counts = [len(words) for words in lines if words]
    if any(len(words) >= 10 and _is_number(words[0]) and not _is_number(words[-1]) for words in lines):
        names, poses = parse_colmap_images(text, where)
        return PoseList(poses, "COLMAP's: camera from scene, turned round; its unit is taken as a metre", names=names)
    if counts[:5] == [3, 4, 4, 4, 4]:
        numbers, poses = parse_trajectory_log(text, where)
        return PoseList(poses, f"a log of 4x4 matrices, {_FROM_CAMERA}", numbers=numbers)
    columns = counts[0] if counts else 0
    if columns == 8:
        times_s, poses = parse_timed_poses(text, where)
        return PoseList(poses, f"time tx ty tz qx qy qz qw, {_FROM_CAMERA}", times_s)
    if columns == 7:
        return _of_seven(number_rows(text, columns, where), where)
    if columns not in (4, 12, 13, 16, 17):
        raise SourceError(where, f"{columns} numbers in its first line", _FORMS, IGNORE_POSES)
    rows = number_rows(text, columns, where)
    if columns == 4:
        is_whole = len(rows) % 4 == 0 and bool((rows[3::4] == (0, 0, 0, 1)).all())
        height = 4 if is_whole else 3
        if len(rows) % height:
            raise SourceError(where, f"{len(rows)} lines of 4 numbers", "3 or 4 for each pose", IGNORE_POSES)
        return PoseList(checked_poses(rows.reshape(-1, height, 4), where), f"{height}x4 matrices, {_FROM_CAMERA}")
    is_numbered = columns in (13, 17)
    poses = checked_poses(rows[:, is_numbered:].reshape(len(rows), -1, 4), where)
    form = f"a {columns // 4}x4 matrix a line, {_FROM_CAMERA}"
    if not is_numbered:
        return PoseList(poses, form)
    if not (np.abs(rows[:, 0]) < 2**53).all() or (rows[:, 0] % 1 != 0).any():
        raise SourceError(where, "lines that do not begin with a whole number", "the number of a frame", IGNORE_POSES)
    return PoseList(poses, form, numbers=rows[:, 0].astype(np.int64))


def _of_seven(rows: Float64s, where: str) -> PoseList:
    """Positions and quaternions without a time, in one order or the other."""
    with np.errstate(over="ignore", invalid="ignore"):
        is_last, is_first = (
            bool((np.abs(np.linalg.norm(part, axis=1) - 1) < 0.01).all()) for part in (rows[:, 3:], rows[:, :4])
        )
    if is_last == is_first:
        found = "7 numbers a line, " + ("two ways to read them" if is_last else "no quaternion of length 1")
        raise SourceError(where, found, _FORMS, IGNORE_POSES)
    turns, shifts = (rows[:, 3:], rows[:, :3]) if is_last else (np.roll(rows[:, :4], -1, axis=1), rows[:, 4:])
    poses = np.concatenate([matrices_from_quaternions(turns, where), shifts[:, :, None]], axis=2)
    order = "tx ty tz qx qy qz qw" if is_last else "qw qx qy qz tx ty tz"
    return PoseList(checked_poses(poses, where), f"{order}, {_FROM_CAMERA}")


def _of_transforms(text: str, where: str) -> PoseList:
    """nerfstudio's ``transforms.json``: x right, y up, z backward become the axes of the pictures."""
    try:
        frames = json.loads(text)["frames"]
        names = tuple(str(frame.get("depth_file_path", frame["file_path"])) for frame in frames)
        matrices = np.array([frame["transform_matrix"] for frame in frames], np.float64).reshape(len(frames), 4, 4)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        expected = "frames, each with file_path and transform_matrix"
        raise SourceError(where, f"JSON without poses ({error})", expected, IGNORE_POSES) from error
    poses = checked_poses(matrices @ np.diag([1.0, -1.0, -1.0, 1.0]), where)
    return PoseList(poses, "nerfstudio's: scene from camera in the axes of OpenGL, turned over", names=names)


def parse_colmap_images(text: str, where: str) -> tuple[tuple[str, ...], Float64s]:
    """COLMAP's ``images.txt``: names of pictures, and poses float64 [n, 4, 4], scene from camera.

    The lines of points, which follow each picture's, may be empty or missing.

    Raises
    ------
    SourceError
        If a line is neither a picture's nor one of points; it names the line.
    """
    names: list[str] = []
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split(maxsplit=9)
        if not words or words[0].startswith("#") or (names and _is_points(line)):
            continue
        try:
            rows.append([float(word) for word in words[1:8]])
            names.append(words[9].strip())
        except (ValueError, IndexError):
            expected = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
            raise SourceError(f"{where} line {number}", repr(line[:60]), expected, IGNORE_POSES) from None
    values = np.array(rows, np.float64).reshape(-1, 7)
    turns = matrices_from_quaternions(np.roll(values[:, :4], -1, axis=1), where).transpose(0, 2, 1)
    shifts = -turns @ values[:, 4:, None]
    return tuple(names), checked_poses(np.concatenate([turns, shifts], axis=2), where)


def _is_points(line: str) -> bool:
    """Tell a line of points: triples of numbers."""
    words = line.split()
    return len(words) % 3 == 0 and all(map(_is_number, words))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
