"""Reads poses of cameras and motions of bodies from text files, in the forms that data sets use.

The form of a text is recognised by its content:

* 12 or 16 numbers a line: a 3x4 (KITTI) or 4x4 matrix; 4 a line: such matrices over several lines;
* 8 numbers a line: TUM's ``time tx ty tz qx qy qz qw``; times may be in milli-, micro- or nanoseconds;
* 7 numbers a line: the same without the time; the quaternion may come first (w x y z, then the position);
* 13 or 17 numbers a line: a number or time, then a 3x4 or 4x4 matrix;
* columns named by a first line or comment (``timestamp, frame, x, y, z, qx, qy, qz, qw``), in any order;
* a name of a picture in front of 7, 12 or 16 numbers;
* Open3D's ``PinholeCameraTrajectory`` (camera from scene, columns first) and ``PoseGraph``;
* Redwood's ``trajectory.log``: three numbers, then a 4x4 matrix over four lines;
* COLMAP's ``images.txt``: quaternion and translation of *camera from world*, and the name of a picture;
* nerfstudio's ``transforms.json``: 4x4 matrices in the axes of OpenGL, and the names of pictures;
* SUN3D's stacked 3x4 ``extrinsics``, and files of one pose for each frame, if the layout has them.

All other forms are read as "scene from camera", metres, in the axes of the pictures: x right, y down, z
forward. A rotation with an error of up to 1 % (from rounding in the text) is made exactly orthonormal.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from touchfield.arrays import Float64s, Int64s
from touchfield.errors import SourceError
from touchfield.files import plain_size, readable, record_read
from touchfield.medium.pose_track import PoseTrack, rotation_matrices, slerp

if TYPE_CHECKING:
    from touchfield.medium.trace import Trace
    from touchfield.sources.shapes.shapes import Triple

MAX_TIME_S: Final = 1e12  # time stamps stay below this: 32 thousand years
IGNORE_POSES: Final = "Mend the file, or ignore the poses with --frame camera."
"""Remedy in an error about an invalid pose."""

_MAX_TEXT_BYTES: Final = 1 << 26
_ROTATION_TOLERANCE: Final = 0.01
_FORMS: Final = (
    "12 or 16 numbers a line (3x4, 4x4), 8 or 7 ([time] tx ty tz qx qy qz qw), named columns, a Redwood log, "
    "COLMAP's images.txt, or the JSON of nerfstudio or Open3D"
)
_FROM_CAMERA: Final = "scene from camera"


class PoseList(NamedTuple):
    """Poses of a file, float64 [n, 4, 4], their form, and what they are keyed by.

    Keys are times in seconds, float64 [n] ascending, frame numbers, int64 [n], or names of pictures.
    `has_quaternions` says that rotations were read from x, y, z, w.
    """

    poses: Float64s
    form: str
    times_s: Float64s | None = None
    numbers: Int64s | None = None
    names: tuple[str, ...] | None = None
    has_quaternions: bool = False


# -- numbers and matrices ----------------------------------------------------------------------------------
def read_text(path: Path, max_bytes: int = _MAX_TEXT_BYTES) -> str:
    """Read a text file.

    Raises `SourceError` if it cannot be read, exceeds `max_bytes` or is not text.
    """
    try:
        with readable(path, "a text file"):
            size = plain_size(path, "a text file")
            if size > max_bytes:
                raise SourceError(str(path), f"{size} bytes", f"a text file up to {max_bytes} bytes")
            record_read(path)
            return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise SourceError(
            str(path), f"bytes that are no text at offset {error.start}", "a text file"
        ) from error


def split_lines(text: str, where: str, separator: str | None = None) -> list[tuple[str, list[str]]]:
    """Split a text into lines of tokens.

    Returns (location, tokens) of each line that is not empty.

    Tokens are separated by blanks, or by `separator`; ``#`` starts a comment.
    """
    lines = ((number, line.partition("#")[0].strip()) for number, line in enumerate(text.splitlines(), 1))
    return [
        (f"{where} line {n}", [token.strip() for token in line.split(separator)]) for n, line in lines if line
    ]


def floats(tokens: list[str], where: str, expected: str = "numbers") -> list[float]:
    """Parse tokens as numbers; `SourceError` if one is not a number."""
    try:
        return [float(token) for token in tokens]
    except ValueError as error:
        raise SourceError(where, repr(" ".join(tokens)[:60]), expected) from error


def _entries(text: str, size: int, where: str, entry: str) -> Float64s:
    """Parse numbers regardless of lines, `size` for each entry, float64 [n, size]."""
    values = floats(text.split(), where)
    if not values or len(values) % size:
        raise SourceError(where, f"{len(values)} numbers", f"{size} for each {entry}", IGNORE_POSES)
    return np.array(values, np.float64).reshape(-1, size)


def _refuse(is_bad: Any, where: str, found: str, expected: str) -> None:
    """Raise `SourceError` for the first True of `is_bad`, bool [n]."""
    if is_bad.any():
        raise SourceError(f"{where}, pose {int(is_bad.argmax())}", found, expected, IGNORE_POSES)


def checked_poses(matrices: Float64s, where: str) -> Float64s:
    """Check matrices and return poses, float64 [n, 4, 4].

    `matrices` are float64 [n, 3, 4] or [n, 4, 4], with positions in metres.

    Rotations are made orthonormal. Raises `SourceError`, which names the entry, if a number is not finite, a
    fourth row is not 0 0 0 1, or a rotation has an error of more than 1 % or is a reflection.
    """
    poses = np.tile(np.eye(4), (len(matrices), 1, 1))
    poses[:, : matrices.shape[1]] = matrices
    rotation = poses[:, :3, :3]
    is_finite = np.isfinite(poses).all(axis=(1, 2)) & (np.abs(poses) < 1e9).all(axis=(1, 2))
    _refuse(~is_finite, where, "numbers that are not finite", "a rotation and a translation in metres")
    _refuse((np.abs(poses[:, 3] - (0, 0, 0, 1)) > 1e-6).any(axis=1), where, "another last row", "0 0 0 1")
    gram = rotation.transpose(0, 2, 1) @ rotation
    is_skewed = np.abs(gram - np.eye(3)).max(axis=(1, 2), initial=0) > _ROTATION_TOLERANCE
    _refuse(is_skewed, where, "a matrix that is no rotation", "orthonormal columns (camera to world)")
    _refuse(np.linalg.det(rotation) < 0, where, "a rotation that mirrors", "a determinant of +1")
    for _ in range(3):  # Newton's iteration to the nearest rotation; quadratic from 1 %
        rotation = 0.5 * rotation @ (3 * np.eye(3) - rotation.transpose(0, 2, 1) @ rotation)
    poses[:, :3, :3] = rotation
    poses[:, 3] = (0, 0, 0, 1)
    return poses


def poses_of_quaternions(quaternions: Float64s, positions_m: Float64s, where: str) -> Float64s:
    """Convert unit quaternions and positions to poses, float64 [n, 4, 4].

    Quaternions (x, y, z, w) are float64 [n, 4], positions float64 [n, 3].
    """
    _refuse(
        ~(np.abs(quaternions) < 2).all(axis=1), where, "a quaternion that is not finite and small", "norm 1"
    )
    norm = np.linalg.norm(quaternions, axis=1)
    _refuse(
        np.abs(norm - 1) > _ROTATION_TOLERANCE, where, "a quaternion of another norm", "norm 1 (qx qy qz qw)"
    )
    rotations = rotation_matrices(np.roll(quaternions / norm[:, None], 1, axis=-1))
    return checked_poses(np.concatenate([rotations, positions_m[:, :, None]], axis=2), where)


def seconds(stamps: Float64s) -> Float64s:
    """Convert time stamps to seconds.

    Stamps that are too large for seconds since 1970 are taken as milli-, micro- or nanoseconds.
    """
    size = float(np.abs(stamps).max(initial=0.0))
    units = ((1e17, 1e9), (1e14, 1e6), (1e11, 1e3))
    unit = next((unit for threshold, unit in units if threshold <= size < 1e20), 1.0)
    return stamps / unit


def nearest_in_time(times_s: Float64s, query_s: Float64s, tolerance_s: float) -> Int64s:
    """Return the index of the time nearest to each of `query_s`, int64 [m].

    The index is -1 if no time is within the tolerance.

    `times_s` float64 [n] ascending.
    """
    if not len(times_s):
        return np.full(len(query_s), -1, np.int64)
    after = np.clip(np.searchsorted(times_s, query_s), 0, len(times_s) - 1)
    before = np.maximum(after - 1, 0)
    is_before = np.abs(query_s - times_s[before]) <= np.abs(times_s[after] - query_s)
    nearest = np.where(is_before, before, after)
    return np.where(np.abs(times_s[nearest] - query_s) <= tolerance_s, nearest, -1).astype(np.int64)


# -- texts of poses ----------------------------------------------------------------------------------------
def parse_extrinsics(text: str, where: str) -> Float64s:
    """Parse SUN3D's stacked 3x4 matrices, one for each frame, as poses float64 [n, 4, 4]."""
    return checked_poses(_entries(text, 12, where, "3x4 matrix").reshape(-1, 3, 4), where)


def read_pose_file(path: Path) -> Float64s | None:
    """Read the 4x4 or 3x4 pose of one frame, float64 [4, 4].

    Returns None if tracking was lost (not finite).
    """
    values = np.array(floats(read_text(path).replace(",", " ").split(), str(path)), np.float64)
    if len(values) not in (12, 16):
        raise SourceError(
            str(path), f"{len(values)} numbers", "16 of one 4x4 matrix, or 12 of a 3x4", IGNORE_POSES
        )
    return checked_poses(values.reshape(1, -1, 4), str(path))[0] if np.isfinite(values).all() else None


def parse_poses(text: str, where: str) -> PoseList:
    """Parse poses in any form above.

    Raises `SourceError` for others, or if a pose is not a rigid motion.
    """
    if text.lstrip().startswith("{"):
        return _parse_json(text, where)
    named = _parse_columns(text, where)
    if named is not None:
        return named
    lines = split_lines(text.replace(",", " "), where)
    if any(len(tokens) >= 10 and _is_number(tokens[0]) and not _is_number(tokens[-1]) for _, tokens in lines):
        return _parse_colmap(text, where)
    columns = len(lines[0][1]) if lines else 0
    if columns in (8, 13, 17) and all(not _is_number(tokens[0]) for _, tokens in lines):
        rest = parse_poses("\n".join(" ".join(tokens[1:]) for _, tokens in lines), where)
        return rest._replace(names=tuple(tokens[0] for _, tokens in lines))
    if [len(tokens) for _, tokens in lines[:5]] == [3, 4, 4, 4, 4]:
        rows = _entries(text, 19, where, "entry (3 and a 4x4 matrix)")
        poses, numbers = checked_poses(rows[:, 3:].reshape(-1, 4, 4), where), rows[:, 0]
        is_frame_number = (numbers >= 0) & (numbers < 2**53) & (np.floor(numbers) == numbers)
        _refuse(~is_frame_number, where, "no frame number", "a whole number")
        return PoseList(poses, f"a log of 4x4 matrices, {_FROM_CAMERA}", numbers=numbers.astype(np.int64))
    if columns not in (4, 7, 8, 12, 13, 16, 17):
        raise SourceError(where, f"{columns} numbers in its first line", _FORMS, IGNORE_POSES)
    for line, tokens in lines:
        if len(tokens) != columns:
            raise SourceError(line, f"{len(tokens)} numbers", f"{columns}")
    rows = np.array([floats(tokens, line) for line, tokens in lines], np.float64)
    if columns == 8:
        rows[:, 0] = seconds(rows[:, 0])
        is_odd = ~(np.abs(rows) < MAX_TIME_S).all(axis=1)
        _refuse(is_odd, where, "numbers that are not finite", "time tx ty tz qx qy qz qw")
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
        order, quaternions, positions_m = _split_position(rows[:, 1:])
        poses = poses_of_quaternions(quaternions, positions_m, where)
        return PoseList(poses, f"time {order}, {_FROM_CAMERA}", rows[:, 0], has_quaternions=order[0] == "t")
    if columns == 7:
        order, quaternions, positions_m = _split_position(rows)
        poses = poses_of_quaternions(quaternions, positions_m, where)
        return PoseList(poses, f"{order}, {_FROM_CAMERA}", has_quaternions=order[0] == "t")
    if columns in (13, 17):
        keys = rows[:, 0]
        _refuse(~(np.abs(keys) < 1e20), where, "a key that is not finite", "a frame number or a time")
        poses = checked_poses(rows[:, 1:].reshape(len(rows), -1, 4), where)
        form = f"{columns // 4}x4 matrices, {_FROM_CAMERA}"
        if bool((keys % 1 == 0).all()) and keys.min() >= 0 and keys.max() < 1e9:
            return PoseList(poses, f"frame numbers and {form}", numbers=keys.astype(np.int64))
        order_of_times = np.argsort(keys, kind="stable")
        return PoseList(poses[order_of_times], f"times and {form}", seconds(keys[order_of_times]))
    if columns == 4:
        height = 4 if len(rows) % 4 == 0 and bool((rows[3::4] == (0, 0, 0, 1)).all()) else 3
        if len(rows) % height:
            raise SourceError(where, f"{len(rows)} lines of 4 numbers", "3 or 4 for each pose", IGNORE_POSES)
        return PoseList(
            checked_poses(rows.reshape(-1, height, 4), where), f"{height}x4 matrices, {_FROM_CAMERA}"
        )
    poses = checked_poses(rows.reshape(len(rows), -1, 4), where)
    return PoseList(poses, f"a {columns // 4}x4 matrix a line, {_FROM_CAMERA}")


def _split_position(rows: Float64s) -> tuple[str, Float64s, Float64s]:
    """Split seven columns: their order in words, quaternions x y z w [n, 4], and positions [n, 3], metres.

    The quaternion is last, unless only the first four columns have norm 1: then it is first, w x y z.
    """

    def has_norm(quaternions: Float64s) -> bool:
        return bool((np.abs(np.linalg.norm(quaternions, axis=1) - 1) < _ROTATION_TOLERANCE).all())

    if has_norm(rows[:, :4]) and not has_norm(rows[:, 3:]) and bool(rows[:, 4:].any()):
        return "qw qx qy qz tx ty tz", np.roll(rows[:, :4], -1, axis=1), rows[:, 4:]
    return "tx ty tz qx qy qz qw", rows[:, 3:], rows[:, :3]


def _parse_columns(text: str, where: str) -> PoseList | None:
    """Parse a table whose columns are named by its first line or by a comment above it.

    Returns None if no line names a position and a quaternion.
    """
    lines = [line.strip() for line in text.splitlines()]
    for head, line in enumerate(lines):  # noqa: B007
        tokens = [
            token.strip() for token in re.split(r"[,;\t]" if "," in line else r"\s+", line.lstrip("# "))
        ]
        if line and not line.startswith("#") and _is_number(tokens[0]):
            return None
        keys = [_column_key(token) for token in tokens]
        if tokens[-1].lower() == "name":  # COLMAP's images.txt
            return None
        if {"x", "y", "z", "qx", "qy", "qz", "qw"} <= set(keys):
            break
    else:
        return None
    body = split_lines("\n".join(lines[head + 1 :]).replace(",", " "), where)
    rows = []
    for place, tokens in body:
        if len(tokens) < len(keys):
            raise SourceError(place, f"{len(tokens)} numbers", f"{len(keys)}, as the columns named above")
        rows.append(floats(tokens[: len(keys)], place))
    if not rows:
        raise SourceError(where, "no pose", "a line for each pose", IGNORE_POSES)
    table = dict(zip(keys, np.array(rows, np.float64).T))
    quaternions = np.stack([table[key] for key in ("qx", "qy", "qz", "qw")], axis=1)
    poses = poses_of_quaternions(quaternions, np.stack([table[key] for key in "xyz"], axis=1), where)
    form = f"columns {' '.join(key for key in keys if key)}, {_FROM_CAMERA}"
    if "frame" in table:
        numbers = table["frame"]
        is_count = (numbers >= 0) & (numbers < 2**53) & (np.floor(numbers) == numbers)
        _refuse(~is_count, where, "no frame number", "a whole number")
        return PoseList(poses, form, numbers=numbers.astype(np.int64))
    if "time" in table:
        times = table["time"]
        _refuse(~(np.abs(times) < 1e20), where, "a time that is not finite", "seconds or nanoseconds")
        order = np.argsort(times, kind="stable")
        return PoseList(poses[order], form, seconds(times[order]))
    return PoseList(poses, form)


def _column_key(name: str) -> str:
    """Return what a column of a table of poses holds: time, frame, x, y, z, qx, qy, qz, qw; "" for others."""
    plain = re.sub(r"\[.*|\(.*", "", name).strip().strip("\"'").lower().replace(" ", "_")
    if re.fullmatch(r"(time_?stamps?|time|ts|t|stamp|sec(onds)?)(_?(n?s|us|ms|sec|nsec))?", plain):
        return "time"
    if re.fullmatch(r"(frame|image)(_?(id|number|index|no))?|idx|index|id", plain):
        return "frame"
    match = re.fullmatch(r"(q|quat\w*?|orientation|rotation|rot|q_\w+?)_?([xyzw])", plain)
    if match:
        return f"q{match[2]}"
    match = re.fullmatch(r"(|t|p|pos|position|trans|translation|p_\w+?)_?([xyz])", plain)
    return match[2] if match else ""


def _parse_json(text: str, where: str) -> PoseList:
    """Parse the JSON of nerfstudio, or of Open3D."""
    try:
        data: Any = json.loads(text)
        kind = data.get("class_name")
        if kind == "PinholeCameraTrajectory":
            stored = [entry["extrinsic"] for entry in data["parameters"]]
        elif kind == "PoseGraph":
            stored = [entry["pose"] for entry in data["nodes"]]
        else:
            return _parse_transforms(data, where)
        columns_first = np.array(stored, np.float64).reshape(len(stored), 4, 4)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError) as error:
        expected = "frames with file_path and transform_matrix, or Open3D's PinholeCameraTrajectory"
        raise SourceError(where, f"JSON without poses ({error})", expected, IGNORE_POSES) from error
    if not stored:
        raise SourceError(where, "no pose", "one for each frame", IGNORE_POSES)
    poses = checked_poses(columns_first.transpose(0, 2, 1), where)
    if kind == "PoseGraph":
        return PoseList(poses, f"Open3D's PoseGraph, {_FROM_CAMERA}")
    rotations = poses[:, :3, :3].transpose(0, 2, 1)
    inverse = np.concatenate([rotations, -rotations @ poses[:, :3, 3:]], axis=2)
    form = "Open3D's PinholeCameraTrajectory: camera from scene, turned round"
    return PoseList(checked_poses(inverse, where), form)


def _parse_transforms(data: Any, where: str) -> PoseList:
    """Parse nerfstudio's ``transforms.json``.

    Its axes (x right, y up, z backward) are converted to those of the pictures.
    """
    try:
        frames = data["frames"]
        names = tuple(str(frame.get("depth_file_path", frame["file_path"])) for frame in frames)
        matrices = np.array([frame["transform_matrix"] for frame in frames], np.float64).reshape(
            len(frames), 4, 4
        )
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError) as error:
        expected = "frames, each with file_path and transform_matrix"
        raise SourceError(where, f"JSON without poses ({error})", expected, IGNORE_POSES) from error
    poses = checked_poses(matrices, where) @ np.diag([1.0, -1.0, -1.0, 1.0])
    return PoseList(poses, "nerfstudio's: scene from camera in the axes of OpenGL, turned over", names=names)


def _parse_colmap(text: str, where: str) -> PoseList:
    """Parse COLMAP's ``images.txt``.

    The line of points after each picture may be empty or missing.
    """
    names: list[str] = []
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), 1):
        tokens, numbers = line.split(maxsplit=9), line.split()
        is_points = len(numbers) % 3 == 0 and all(map(_is_number, numbers))
        if not tokens or tokens[0].startswith("#") or (names and is_points):
            continue
        try:
            rows.append([float(token) for token in tokens[1:8]])
            names.append(tokens[9].strip())
        except (ValueError, IndexError):
            expected = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
            raise SourceError(f"{where} line {number}", repr(line[:60]), expected, IGNORE_POSES) from None
    values = np.array(rows, np.float64).reshape(-1, 7)
    from_scene = poses_of_quaternions(np.roll(values[:, :4], -1, axis=1), values[:, 4:], where)
    rotations = from_scene[:, :3, :3].transpose(0, 2, 1)
    poses = checked_poses(np.concatenate([rotations, -rotations @ from_scene[:, :3, 3:]], axis=2), where)
    form = "COLMAP's: camera from scene, turned round; its unit is taken as a metre"
    return PoseList(poses, form, names=tuple(names))


def _is_number(token: str) -> bool:
    try:
        float(token)
    except ValueError:
        return False
    return True


# -- tracks of bodies (paper section 4.3, object motion) ---------------------------------------------------
def interpolate_poses(
    quaternions: Float64s, positions_m: Float64s, indices: Float64s
) -> tuple[Float64s, Float64s]:
    """Interpolate poses at fractional `indices`.

    `quaternions` are float64 [m, 4], `positions_m` float64 [m, 3].

    Positions are interpolated linearly, rotations along the shortest arc at constant speed (slerp).
    """
    if len(positions_m) == 1:
        return np.tile(quaternions, (len(indices), 1)), np.tile(positions_m, (len(indices), 1))
    before = np.minimum(indices.astype(np.int64), len(positions_m) - 2)
    fraction, after = indices - before, before + 1
    positions = (1.0 - fraction)[:, None] * positions_m[before] + fraction[:, None] * positions_m[after]
    return slerp(quaternions[before], quaternions[after], fraction), positions


def track_at_rate(trace: Trace, rate_hz: float, frame_count: int) -> PoseTrack:
    """Resample a recorded motion at the times 0, 1 / rate, ...

    Before its first and after its last pose a body is at rest; without rotations it keeps the scene's axes.
    """
    indices = np.interp(np.arange(frame_count) / rate_hz, trace.times_s, np.arange(len(trace)))
    quaternions = (
        np.tile([1.0, 0.0, 0.0, 0.0], (len(trace), 1)) if trace.quaternions is None else trace.quaternions
    )
    return PoseTrack(*interpolate_poses(quaternions, trace.positions_m, indices))


def quaternion_of_euler(rotation_deg: Triple) -> Float64s:
    """Return the quaternion (w, x, y, z) of Euler angles, float64 [4].

    The rotations are about the fixed x, then y, then z axis.
    """
    from scipy.spatial.transform import Rotation

    quaternion: Float64s = Rotation.from_euler("xyz", rotation_deg, degrees=True).as_quat(scalar_first=True)
    return quaternion
