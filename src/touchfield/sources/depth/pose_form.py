"""Readings of camera poses. Files seldom state whether a pose maps from the camera, in which axes and in
which unit: a user may name the reading (``--pose-form``), and `pose_check` tries them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument
from touchfield.medium.pose_track import quaternions_of, rotation_matrices

FORMS: Final = {  # in the order in which they are applied
    "wxyz": "quaternions with w first",
    "mm": "positions in millimetres",
    "cm": "positions in centimetres",
    "inverted": "camera from scene",
    "opengl": "axes of OpenGL: y up, z backward",
    "ros": "axes of a ROS body: x forward, z up",
    "mirrored": "a world with y turned over",
    "reversed": "last frame first",
    "alphabetical": "order of the file names as text: 0, 1, 10, 2",
}
"""Words of ``--pose-form`` with what they say of the poses in the file."""

_AXES: Final = ("opengl", "ros", "mirrored")
_ORDERS: Final = ("reversed", "alphabetical")
_UNITS: Final = {"mm": 1e-3, "cm": 1e-2}
_OPENGL: Final = np.diag([1.0, -1.0, -1.0, 1.0])
_ROS: Final = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # body from picture axes
_FLIP_Y: Final = np.diag([1.0, -1.0, 1.0, 1.0])


def parse_pose_form(text: str) -> tuple[str, ...]:
    """Parse words of `FORMS`, separated by commas, into the order in which they are applied.

    Raises `InvalidArgument` for another word, or two words that exclude each other.
    """
    words = {word.strip().lower() for word in text.split(",") if word.strip()}
    unknown = sorted(words - set(FORMS))
    if unknown or not words:
        raise InvalidArgument(
            "--pose-form", repr(unknown[0] if unknown else text), f"words of {', '.join(FORMS)}"
        )
    for group in (_AXES, _ORDERS, tuple(_UNITS)):
        chosen = [word for word in group if word in words]
        if len(chosen) > 1:
            raise InvalidArgument("--pose-form", " and ".join(chosen), f"one of {', '.join(group)}")
    return tuple(word for word in FORMS if word in words)


def read_poses_as(poses: Float64s, form: Sequence[str], names: Sequence[str] = ()) -> Float64s:
    """Return poses that were read as scene from camera, read as `form` instead.

    `poses` float64 [n, 4, 4] are in the order of the frames; `form` are words of `FORMS` in their order, and
    `names` are those of the frames, for their alphabetical order.
    """
    poses = poses.copy()
    for word in form:
        if word == "wxyz":  # x y z w were read from what is w x y z
            quaternions = np.roll(quaternions_of(poses[:, :3, :3]), -1, axis=1)
            poses[:, :3, :3] = rotation_matrices(quaternions)
        elif word in _UNITS:
            poses[:, :3, 3] *= _UNITS[word]
        elif word == "inverted":
            poses = np.asarray(np.linalg.inv(poses), np.float64)
        elif word == "mirrored":
            poses = _FLIP_Y @ poses @ _FLIP_Y
        elif word in _AXES:
            poses = poses @ (_OPENGL if word == "opengl" else _ROS)
        elif word == "reversed":
            poses = poses[::-1].copy()
        else:
            poses[alphabetical_order(names)] = poses.copy()
    return poses


def alphabetical_order(names: Sequence[str]) -> list[int]:
    """Return the indices of `names` in alphabetical order: 0, 1, 10, 11, 2."""
    return sorted(range(len(names)), key=names.__getitem__)
