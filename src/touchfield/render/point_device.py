"""A type 1 device as the servo sees it: where it is, and to push; of some also how it is turned, and to
twist.

A new device is one file in `touchfield.devices.drivers` with a class of this kind (docs/devices.md). Forces
that arrive here have passed every limit; an adapter changes none of them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, Final

import numpy as np

from touchfield.arrays import Float64s

Point = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # w, x, y, z


class PointDevice(ABC):
    """A point that a hand moves, in the device's own axes.

    Used by one thread, within the servo's process: it is made there, by a callable that can be pickled.
    """

    is_paced: ClassVar[bool] = (
        False  # whether `position_m` waits for the device and so sets the rate of the loop
    )
    is_driven: ClassVar[bool] = (
        False  # whether the vendor's driver calls us, by `drive`: it asks for no position
    )

    @abstractmethod
    def open(self) -> None:
        """Find the device and make it ready; no force yet.

        `DeviceError` if it is not there, its driver is not installed, or it answers wrongly.
        """

    @abstractmethod
    def position_m(self) -> Point:
        """Where it is, metres, in its own axes; `DeviceError` if it is late, or says what cannot be."""

    @abstractmethod
    def put_force_n(self, x: float, y: float, z: float) -> None:
        """Push with a force in newtons, in its own axes, until told otherwise; `DeviceError` if it is gone."""

    def orientation(self) -> Quaternion:
        """Turn of the grip at the latest `position_m`, a unit quaternion: device's axes from the grip's.

        `DeviceError` if it cannot tell.
        """
        return 1.0, 0.0, 0.0, 0.0

    def buttons(self) -> int:
        """Those that are pressed at the latest `position_m`: bit n is button n."""
        return 0

    def gripper_m(self) -> float:
        """Opening of the gripper at the latest `position_m`, metres."""
        return 0.0

    def put_wrench(self, fx: float, fy: float, fz: float, tx: float, ty: float, tz: float) -> None:
        """Push as `put_force_n`, and twist with a torque in newton metres, in its own axes, about its point.

        A device that shows no torque leaves it out; its profile states none, so that there is none.
        `DeviceError` if it is gone.
        """
        self.put_force_n(fx, fy, fz)

    @abstractmethod
    def close(self) -> None:
        """Let it go, without force; must not raise, and may be called twice, or after a failed `open`."""

    def advance(self, dt_s: float) -> None:
        """Time that passed, for a device that is simulated; nothing for one that is there."""
        return

    def drive(self, address: int, words: int) -> None:
        """Hand the compiled callback over the memory block at `address` to the driver; returns at once.

        From then on the driver calls `kernels.tick.cycle` at its own rate, until `close`.
        """
        raise NotImplementedError

    def watch(self) -> None:
        """Asked now and then while the driver calls us, in place of `position_m`.

        `DeviceError` if the driver reports a fault, or has stopped calling.
        """
        return


BOX_AXES: Final = "x right, y up, z towards the user"

_STEMS: Final = {"right": (0, 1.0), "left": (0, -1.0), "up": (1, 1.0), "down": (1, -1.0), "back": (2, 1.0)}
_DIRECTIONS: Final = {
    **{stem + end: way for stem, way in _STEMS.items() for end in ("", "ward", "wards")},
    **dict.fromkeys(("towards", "toward"), (2, 1.0)),
    **dict.fromkeys(("away", "forward", "forwards"), (2, -1.0)),
}
"""Axis of the box and sign of a word."""

_UP_AXES: Final = {
    "x": "x up, y left, z towards",
    "-x": "x down, y right, z towards",
    "y": "x right, y up, z towards",
    "-y": "x right, y down, z away",
    "z": "x right, y away, z up",
    "-z": "x right, y towards, z down",
}
"""Lie of a field of which this axis is up, right-handed."""

UPS: Final = ("auto", "lattice", *_UP_AXES)
"""Choices of the axis that is up: as the words say, as the lattice was laid, or one by its name."""

_FILLING: Final = frozenset(("to", "the", "from", "user", "viewer", "hand"))
_LONGEST: Final = 256


def axes_of_text(text: str) -> Float64s | None:
    """A signed permutation P, float64 [3, 3], with v_box = P v; None if the text cannot be read.

    The text is such as "x right, y up, z towards the user", in any order and case, with or without "the
    user". The determinant is -1 for left-handed axes.
    """
    matrix, seen = np.zeros((3, 3)), set()
    if len(text) > _LONGEST:
        return None
    for part in text.lower().split(","):
        words = part.split()
        if not words or words[0] not in ("x", "y", "z") or words[0] in seen:
            return None
        seen.add(words[0])
        ways = [word for word in words[1:] if word not in _FILLING]
        if len(ways) != 1 or ways[0] not in _DIRECTIONS:
            return None
        axis, sign = _DIRECTIONS[ways[0]]
        matrix[axis, "xyz".index(words[0])] = sign
    return matrix if len(seen) == 3 and (np.abs(matrix).sum(axis=1) == 1).all() else None


def axes_matrix(device_axes: str, field_axes: str, up: str = "lattice") -> Float64s:
    """A signed permutation, float64 [3, 3]: what turns a vector in the device's axes into one in the field's.

    The axes are those of the profile (`touchfield.devices.Device.axes`) and of the medium; `up` is one of
    `UPS`. The determinant is -1 if the handedness differs.
    """
    device, field = axes_of_text(device_axes), _field(field_axes, up)
    matrix: Float64s = (field if field is not None else np.eye(3)).T @ (
        device if device is not None else np.eye(3)
    )
    return matrix


def axes_notes(device_axes: str, field_axes: str, up: str = "lattice") -> tuple[str, ...]:
    """Notes for the user on how two texts were taken."""
    notes = []
    if axes_of_text(device_axes) is None:
        notes.append(f'axes of the device, "{device_axes[:80]}", are taken as {BOX_AXES}')
    if _field(field_axes, up) is None:
        notes.append(f'axes of the field, "{field_axes[:80]}", are laid along {BOX_AXES}')
    return tuple(notes)


def _field(field_axes: str, up: str) -> Float64s | None:
    """Lie of a medium in the box; of its lattice, the ways in which it grows: a diagonal of signs."""
    if up in _UP_AXES:
        return axes_of_text(_UP_AXES[up])
    if up == "auto":
        return axes_of_text(field_axes.replace("east", "right").replace("north", "away"))
    matrix = axes_of_text(field_axes)
    return matrix if matrix is not None and np.diagonal(matrix).all() else None
