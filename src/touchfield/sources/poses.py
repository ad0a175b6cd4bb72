"""Lists of camera poses as people write them, their form told by their content.

* 12 or 16 numbers a line: a 3x4 (KITTI) or 4x4 matrix; 13 or 17: the same behind the number of a frame (KITTI-360);
  4 a line: such matrices over several lines;
* 8 numbers a line: TUM's ``time tx ty tz qx qy qz qw``; times may be in milli-, micro- or nanoseconds;
* 7 numbers: ``tx ty tz qx qy qz qw`` or ``qw qx qy qz tx ty tz`` (RGB-D Scenes), told by which four are of length 1;
* Redwood's ``trajectory.log``: three numbers, then a 4x4 matrix over four lines;
* COLMAP's ``images.txt``: quaternion and translation of the *world in the camera*, and the name of a picture;
* nerfstudio's ``transforms.json``: 4x4 matrices in the axes of OpenGL, and the names of pictures;
* SUN3D's stacked 3x4 ``extrinsics``, and the one pose of a file a frame, where the layout says so.

All but COLMAP's and nerfstudio's are taken as scene from camera, metres, in the axes of the pictures: x right,
y down, z forward. A rotation must be one: within 1 % it is made exactly orthonormal (text rounds), beyond that it is
an error.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import SourceError
from touchfield.files import plain_size
from touchfield.medium.pose_track import rotation_matrices

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64s = NDArray[np.float64]

__all__ = [
    "IGNORE_POSES",
    "MAX_TIME_S",
    "PoseList",
    "checked_poses",
    "matrices_from_quaternions",
    "nearest_in_time",
    "number_rows",
    "parse_colmap_images",
    "parse_extrinsics",
    "parse_poses",
    "parse_timed_poses",
    "parse_trajectory_log",
    "read_pose_file",
    "read_text",
    "seconds",
]

MAX_TIME_S: Final = 1e12
"""Time stamps stay below this: 32 thousand years."""

_MAX_TEXT_BYTES: Final = 1 << 26
_ROTATION_TOLERANCE: Final = 0.01
IGNORE_POSES: Final = "Mend the file, or ignore the poses with --frame camera."
"""The way on from a pose at fault."""


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


def read_text(path: Path) -> str:
    """A text file.

    Raises
    ------
    SourceError
        If it cannot be read, is longer than 64 MiB or is not text.
    """
    try:
        size = plain_size(path, "a text file")
        if size > _MAX_TEXT_BYTES:
            raise SourceError(str(path), f"{size} bytes", f"a text file up to {_MAX_TEXT_BYTES} bytes")
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise SourceError(str(path), error.strerror or str(error), "a text file", "Check path and rights.") from error
    except UnicodeDecodeError as error:
        raise SourceError(str(path), f"bytes that are no text at offset {error.start}", "a text file") from error


def number_rows(text: str, columns: int, where: str) -> Float64s:
    """Rows of numbers, float64 [n, columns]; ``#`` begins a comment, empty lines are skipped.

    Raises
    ------
    SourceError
        If a line holds another count of numbers, or something else; it names the line.
    """
    rows = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        values = _floats(words, f"{where} line {number}")
        if len(values) != columns:
            raise SourceError(f"{where} line {number}", f"{len(values)} numbers", f"{columns}")
        rows.append(values)
    return np.array(rows, np.float64).reshape(-1, columns)


def _floats(words: list[str], where: str) -> list[float]:
    try:
        return [float(word) for word in words]
    except ValueError as error:
        raise SourceError(where, repr(" ".join(words)[:60]), "numbers") from error


def _entries(text: str, size: int, where: str, what: str) -> Float64s:
    values = _floats(text.split(), where)
    if not values or len(values) % size:
        raise SourceError(where, f"{len(values)} numbers", f"{size} for each {what}", IGNORE_POSES)
    return np.array(values, np.float64).reshape(-1, size)


def checked_poses(matrices: Float64s, where: str) -> Float64s:
    """Camera-to-world matrices whose rotations are rotations, float64 [n, 4, 4].

    Parameters
    ----------
    matrices : float64 [n, 3, 4] or [n, 4, 4]
        Rotation and translation in metres; a fourth row must be 0 0 0 1.
    where : str
        What to call them in an error.

    Raises
    ------
    SourceError
        If a number is not finite, or a rotation is off by more than 1 % or mirrors; it names the entry.
    """
    poses = np.tile(np.eye(4), (len(matrices), 1, 1))
    poses[:, : matrices.shape[1]] = matrices
    rotation = poses[:, :3, :3]
    finite = np.isfinite(poses).all(axis=(1, 2)) & (np.abs(poses) < 1e9).all(axis=(1, 2))
    _refuse(~finite, where, "numbers that are not finite", "a rotation and a translation in metres")
    _refuse((np.abs(poses[:, 3] - (0, 0, 0, 1)) > 1e-6).any(axis=1), where, "another last row", "0 0 0 1")
    gram = rotation.transpose(0, 2, 1) @ rotation
    skewed = np.abs(gram - np.eye(3)).max(axis=(1, 2), initial=0) > _ROTATION_TOLERANCE
    _refuse(skewed, where, "a matrix that is no rotation", "orthonormal columns (camera to world)")
    _refuse(np.linalg.det(rotation) < 0, where, "a rotation that mirrors", "a determinant of +1")
    for _ in range(3):  # Newton's iteration to the nearest rotation; quadratic from 1 %
        rotation = 0.5 * rotation @ (3 * np.eye(3) - rotation.transpose(0, 2, 1) @ rotation)
    poses[:, :3, :3] = rotation
    poses[:, 3] = (0, 0, 0, 1)
    return poses


def _refuse(bad: Any, where: str, found: str, expected: str) -> None:
    """Raise for the first True of `bad`, bool [n]."""
    if bad.any():
        raise SourceError(f"{where}, pose {int(bad.argmax())}", found, expected, IGNORE_POSES)


def matrices_from_quaternions(quaternions: Float64s, where: str) -> Float64s:
    """Rotation matrices float64 [n, 3, 3] of quaternions (x, y, z, w) float64 [n, 4].

    Raises
    ------
    SourceError
        If the norm of one differs from 1 by more than 1 %; within that it is normalised.
    """
    _refuse(~(np.abs(quaternions) < 2).all(axis=1), where, "a quaternion that is not finite and small", "norm 1")
    norm = np.linalg.norm(quaternions, axis=1)
    _refuse(np.abs(norm - 1) > _ROTATION_TOLERANCE, where, "a quaternion of another norm", "norm 1 (qx qy qz qw)")
    return rotation_matrices(np.roll(quaternions / norm[:, None], 1, axis=-1))


def parse_timed_poses(text: str, where: str) -> tuple[Float64s, Float64s]:
    """TUM's ``time tx ty tz qx qy qz qw``: times in seconds, ascending, float64 [n], and poses float64 [n, 4, 4]."""
    rows = number_rows(text, 8, where)
    if not len(rows):
        raise SourceError(where, "no pose", "lines of time tx ty tz qx qy qz qw", IGNORE_POSES)
    rows[:, 0] = seconds(rows[:, 0])
    _refuse(
        ~(np.abs(rows) < MAX_TIME_S).all(axis=1), where, "numbers that are not finite", "time tx ty tz qx qy qz qw"
    )
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    rotations = matrices_from_quaternions(rows[:, 4:], where)
    return rows[:, 0], checked_poses(np.concatenate([rotations, rows[:, 1:4, None]], axis=2), where)


def seconds(stamps: Float64s) -> Float64s:
    """Time stamps in seconds: those too large for seconds since 1970 are milli-, micro- or nanoseconds."""
    size = float(np.abs(stamps).max(initial=0.0))
    unit = next((unit for least, unit in ((1e17, 1e9), (1e14, 1e6), (1e11, 1e3)) if least <= size < 1e20), 1.0)
    return stamps / unit


def parse_trajectory_log(text: str, where: str) -> tuple[NDArray[np.int64], Float64s]:
    """Redwood's ``trajectory.log``: the first number of each entry, int64 [n], and its pose, float64 [n, 4, 4]."""
    entries = _entries(text, 19, where, "entry (3 and a 4x4 matrix)")
    names = entries[:, 0]
    _refuse(~((names >= 0) & (names < 2**53) & (names % 1 == 0)), where, "no frame number", "a whole number")
    return names.astype(np.int64), checked_poses(entries[:, 3:].reshape(-1, 4, 4), where)


def parse_extrinsics(text: str, where: str) -> Float64s:
    """SUN3D's stacked 3x4 matrices, one a frame, as poses float64 [n, 4, 4]."""
    return checked_poses(_entries(text, 12, where, "3x4 matrix").reshape(-1, 3, 4), where)


def read_pose_file(path: Path) -> Float64s | None:
    """The 4x4 or 3x4 pose of one frame, float64 [4, 4]; None where tracking was lost (numbers not finite)."""
    values = np.array(_floats(read_text(path).replace(",", " ").split(), str(path)), np.float64)
    if len(values) not in (12, 16):
        raise SourceError(str(path), f"{len(values)} numbers", "16 of one 4x4 matrix, or 12 of a 3x4", IGNORE_POSES)
    if not np.isfinite(values).all():
        return None
    pose: Float64s = checked_poses(values.reshape(1, -1, 4), str(path))[0]
    return pose


def nearest_in_time(times_s: Float64s, wanted_s: Float64s, tolerance_s: float) -> NDArray[np.int64]:
    """Index of the nearest of the ascending `times_s` for each of `wanted_s`, int64 [m]; -1 beyond the tolerance."""
    if not len(times_s):
        return np.full(len(wanted_s), -1, np.int64)
    after = np.clip(np.searchsorted(times_s, wanted_s), 0, len(times_s) - 1)
    before = np.maximum(after - 1, 0)
    closer = np.abs(wanted_s - times_s[before]) <= np.abs(times_s[after] - wanted_s)
    nearest = np.where(closer, before, after)
    held = np.abs(times_s[nearest] - wanted_s) <= tolerance_s
    return np.where(held, nearest, -1).astype(np.int64)


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
