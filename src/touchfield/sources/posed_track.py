"""Pose tracks from text files of recorded poses, and from poses at any times (paper section 4.3, object motion).

A file is comma-separated text; its first line names the columns, in any order: t_s, x_m, y_m, z_m, qw, qx, qy, qz.
``#`` begins a comment. Between two poses positions are interpolated linearly and rotations at constant angular
velocity (`touchfield.medium.pose_track.slerp`); before the first and after the last pose the body stands still.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import SourceError
from touchfield.medium.pose_track import PoseTrack, slerp
from touchfield.sources.poses import MAX_TIME_S, read_text

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.shapes import Triple

    Float64s = NDArray[np.float64]

__all__ = ["COLUMNS", "quaternion_of_turns", "read_pose_csv", "track_at_rate"]

COLUMNS: Final = ("t_s", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")

_UNIT: Final = 1e-3
"""How far from one the length of a quaternion may be: what three digits give."""


def read_pose_csv(path: Path) -> tuple[Float64s, Float64s, Float64s]:
    """Times, s, float64 [n], ascending; positions, m, float64 [n, 3]; quaternions w, x, y, z, float64 [n, 4].

    Raises
    ------
    SourceError
        If the file cannot be read, its columns are others, a number is missing or not finite, time stands still or
        runs backwards, or a quaternion is not of length 1 to within 0.001. It names file and line.
    """
    order: list[int] = []
    rows: list[list[float]] = []
    for line, words in enumerate(read_text(path).splitlines(), 1):
        fields = [word.strip() for word in words.partition("#")[0].split(",")]
        if fields == [""]:
            continue
        if order:
            rows.append(_row(f"{path} line {line}", fields, order, rows))
            continue
        if sorted(fields) != sorted(COLUMNS):
            found, expected = repr(",".join(fields))[:80], f"the columns {','.join(COLUMNS)}"
            mend = "Name these columns in the first line, in any order, with commas between them."
            raise SourceError(f"{path} line {line}", found, expected, mend)
        order = [fields.index(name) for name in COLUMNS]
    if not rows:
        raise SourceError(str(path), "no pose", f"lines of {','.join(COLUMNS)}")
    table = np.array(rows, np.float64)
    return table[:, 0], table[:, 1:4], table[:, 4:]


def _row(where: str, fields: list[str], order: list[int], rows: list[list[float]]) -> list[float]:
    if len(fields) != len(order):
        raise SourceError(where, f"{len(fields)} values", f"{len(order)}: {','.join(COLUMNS)}")
    try:
        row = [float(fields[i]) for i in order]
    except ValueError:
        raise SourceError(where, repr(",".join(fields))[:80], "numbers") from None
    if not all(abs(value) < MAX_TIME_S for value in row):  # nan compares as false
        raise SourceError(where, repr(",".join(fields))[:80], "finite numbers")
    if rows and row[0] <= rows[-1][0]:
        found = f"t_s {row[0]:.9g} after {rows[-1][0]:.9g}"
        raise SourceError(where, found, "times that rise from line to line", "Sort the lines, and drop doubles.")
    length = math.sqrt(sum(value * value for value in row[4:]))
    if abs(length - 1.0) > _UNIT:
        raise SourceError(where, f"a quaternion of length {length:g}", "length 1, in qw, qx, qy, qz")
    return row


def track_at_rate(
    times_s: Float64s, positions_m: Float64s, quaternions: Float64s, rate_hz: float, frame_count: int
) -> PoseTrack:
    """The poses at the times 0, 1 / rate, ..., one a frame.

    Parameters
    ----------
    times_s : float64 [n]
        Ascending.
    positions_m : float64 [n, 3]
    quaternions : float64 [n, 4]
        w, x, y, z; of length 1 but for rounding.
    rate_hz : float
    frame_count : int
    """
    if len(times_s) == 1:
        return PoseTrack(np.tile(quaternions, (frame_count, 1)), np.tile(positions_m, (frame_count, 1)))
    at = np.clip(np.arange(frame_count) / rate_hz, times_s[0], times_s[-1])
    after = np.clip(np.searchsorted(times_s, at, side="right"), 1, len(times_s) - 1)
    before = after - 1
    part = (at - times_s[before]) / (times_s[after] - times_s[before])
    positions = (1.0 - part)[:, None] * positions_m[before] + part[:, None] * positions_m[after]
    unit = quaternions / np.sqrt((quaternions * quaternions).sum(axis=1))[:, None]
    return PoseTrack(slerp(unit[before], unit[after], part), positions)


def quaternion_of_turns(rotation_deg: Triple) -> Float64s:
    """The quaternion w, x, y, z of turns about the fixed x, then y, then z axis, float64 [4]."""
    (cx, cy, cz), (sx, sy, sz) = (f(np.radians(rotation_deg) / 2) for f in (np.cos, np.sin))
    return np.array(
        [
            cx * cy * cz + sx * sy * sz,
            sx * cy * cz - cx * sy * sz,
            cx * sy * cz + sx * cy * sz,
            cx * cy * sz - sx * sy * cz,
        ]
    )
