"""The interface of a force-feedback device as the servo uses it: reads the position of the point that the
hand moves, and sets the force there. Also maps the device's axes to those of a field.

Some devices also report an orientation and accept a torque. A new device is one file in
`touchfield.devices.drivers` with a class of this kind (docs/devices.md). The forces that arrive here have
passed all limits; a driver changes none of them.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar, Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.render.readiness import Readiness

Point = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]  # w, x, y, z

NOWHERE: Final = (math.nan, math.nan, math.nan)
"""Position that is not known: a tick without a position."""


class PointDevice(ABC):
    """A point that a hand moves, in the device's own axes.

    It is used by one thread in the servo's process, and made there by a callable that can be pickled.
    """

    title: ClassVar[str] = "device"
    """Name of the kind of device in messages."""

    is_paced: ClassVar[bool] = False
    """Whether `position_m` waits for the device, and so sets the rate of the loop."""

    is_driven: ClassVar[bool] = False
    """Whether the vendor's driver calls the renderer (`drive`), so that `position_m` is not called."""

    has_force_at_open: ClassVar[bool] = False
    """Whether `open` leaves the force of an earlier process on.

    The standby of a servo that died then brings it to zero within the slew limit; else `open` sets zero.
    """

    def load(self) -> None:
        """Load the libraries that `open` needs, without contact to the device.

        The standby calls it ahead, so that it can open the device at once.
        """
        return

    @abstractmethod
    def open(self) -> None:
        """Find the device and make it ready, without force.

        Raises `DeviceAbsent` if it is missing, and `DeviceError` if its driver is not installed, another
        program uses it, or it answers wrongly.
        """

    def readiness(self) -> Readiness:
        """Return the state of the open device, without applying a force.

        The player polls this method before it renders. Raises `DeviceError` if the device is gone.
        """
        return Readiness()

    def state(self) -> Readiness:
        """Return the state of the device while it is driven.

        The servo calls this method a few times a second, between two ticks; it must return within a tick, and
        apply no force. While a state is missing, the force is zero. Raises `DeviceError` if the device is
        gone.
        """
        return Readiness()

    @property
    def unit(self) -> str:
        """Id of the unit that was opened, if a device made anew might open another one; otherwise ""."""
        return ""

    def use_unit(self, unit: str) -> None:
        """Let `open` open the unit with this id, which is the `unit` of a device whose process has died."""
        return

    @abstractmethod
    def position_m(self) -> Point:
        """Return the position in metres, in the device's own axes.

        Raises `DeviceError` if the device is late or reports an impossible position.
        """

    @abstractmethod
    def put_force_n(self, x: float, y: float, z: float) -> None:
        """Apply a force in newtons, in the device's own axes, until the next call.

        Raises `DeviceError` if the device is gone.
        """

    def orientation(self) -> Quaternion:
        """Return the orientation of the grip at the latest `position_m`.

        It is a unit quaternion from the grip's axes to the device's. Raises `DeviceError` if it cannot be
        read.
        """
        return 1.0, 0.0, 0.0, 0.0

    def buttons(self) -> int:
        """Return the buttons pressed at the latest `position_m`: bit n is button n."""
        return 0

    def gripper_m(self) -> float:
        """Return the opening of the gripper at the latest `position_m`, metres."""
        return 0.0

    def put_wrench(self, fx: float, fy: float, fz: float, tx: float, ty: float, tz: float) -> None:
        """Apply a force as `put_force_n` does, and a torque in N m about the device's point.

        Both are in the device's own axes. A device without torque ignores it; its profile states no torque,
        so that none is computed. Raises `DeviceError` if the device is gone.
        """
        self.put_force_n(fx, fy, fz)

    @abstractmethod
    def close(self) -> None:
        """Release the device, without force.

        Must not raise, and may be called twice or after a failed `open`.
        """

    def advance(self, dt_s: float) -> None:
        """Advance a simulated device by a time; real devices ignore it."""
        return

    def drive(self, address: int, size_bytes: int) -> None:
        """Let the driver call the renderer on the receiver in the memory at `address`.

        Returns at once. From then on the driver calls `touch_receiver_tick` at its own rate, until `close`.
        """
        raise NotImplementedError

    def watch(self) -> None:
        """Check a driver that calls the renderer.

        The servo calls this method about every 10 ms instead of `position_m`. Raises `DeviceError` if the
        driver reports a fault or has stopped calling.
        """
        return

    def frame_s(self) -> float:
        """Return the time from position to force in the latest call of a driver that calls the renderer."""
        return 0.0


BOX_AXES: Final = "x right, y up, z towards the user"

_STEMS: Final = {"right": (0, 1.0), "left": (0, -1.0), "up": (1, 1.0), "down": (1, -1.0), "back": (2, 1.0)}
_DIRECTIONS: Final = {
    **{stem + end: direction for stem, direction in _STEMS.items() for end in ("", "ward", "wards")},
    **dict.fromkeys(("towards", "toward"), (2, 1.0)),
    **dict.fromkeys(("away", "forward", "forwards"), (2, -1.0)),
}
"""Axis of the box and sign for each direction word."""

_UP_AXES: Final = {
    "x": "x up, y left, z towards",
    "-x": "x down, y right, z towards",
    "y": "x right, y up, z towards",
    "-y": "x right, y down, z away",
    "z": "x right, y away, z up",
    "-z": "x right, y towards, z down",
}
"""Right-handed placement of a field for each choice of its axis that is up."""

UP_CHOICES: Final = ("auto", "lattice", *_UP_AXES)
"""Choices of the up axis: from the text of the axes, as stored, or a named axis."""

_FILLER_WORDS: Final = frozenset(("to", "the", "from", "user", "viewer", "hand"))
_MAX_LENGTH: Final = 256


def axes_of_text(text: str) -> Float64s | None:
    """Parse a signed permutation P, float64 [3, 3], with v_box = P v; None if unreadable.

    The text is for example "x right, y up, z towards the user", in any order and case, with or without "the
    user". The determinant is -1 for left-handed axes.
    """
    matrix, axes = np.zeros((3, 3)), set()
    if len(text) > _MAX_LENGTH:
        return None
    for part in text.lower().split(","):
        tokens = part.split()
        if not tokens or tokens[0] not in ("x", "y", "z") or tokens[0] in axes:
            return None
        axes.add(tokens[0])
        directions = [token for token in tokens[1:] if token not in _FILLER_WORDS]
        if len(directions) != 1 or directions[0] not in _DIRECTIONS:
            return None
        axis, sign = _DIRECTIONS[directions[0]]
        matrix[axis, "xyz".index(tokens[0])] = sign
    return matrix if len(axes) == 3 and (np.abs(matrix).sum(axis=1) == 1).all() else None


def signed_axes(text: str) -> Float64s | None:
    """Parse signed axes such as "x,-z,y" into a permutation S, float64 [3, 3]; None if unreadable.

    The axes that S v has for a vector v of the device are those of the text: here x, -z and y of v.
    """
    parts = [part.strip().lower() for part in text.split(",")] if len(text) <= _MAX_LENGTH else []
    names = [part.removeprefix("-").removeprefix("+") for part in parts]
    if sorted(names) != ["x", "y", "z"] or any(len(part) > 2 for part in parts):
        return None
    matrix = np.zeros((3, 3))
    for row, (part, name) in enumerate(zip(parts, names, strict=True)):
        matrix[row, "xyz".index(name)] = -1.0 if part.startswith("-") else 1.0
    return matrix


def axes_matrix(device_axes: str, field_axes: str, up: str = "lattice") -> Float64s:
    """Return the signed permutation from the device's axes to the field's, float64 [3, 3].

    The axes are those of the profile (`touchfield.devices.Device.axes`) and of the medium; `up` is one of
    `UP_CHOICES`. The determinant is -1 if the handedness differs.
    """
    device, field = axes_of_text(device_axes), _field_axes(field_axes, up)
    field = np.eye(3) if field is None else field
    device = np.eye(3) if device is None else device
    matrix: Float64s = field.T @ device
    return matrix


def axes_notes(device_axes: str, field_axes: str, up: str = "lattice") -> tuple[str, ...]:
    """Return notes for the user if the text of the axes could not be read."""
    notes = []
    if axes_of_text(device_axes) is None:
        notes.append(f'axes of the device, "{device_axes[:80]}", cannot be read and are taken as {BOX_AXES}')
    if _field_axes(field_axes, up) is None:
        notes.append(f'axes of the field, "{field_axes[:80]}", are placed along {BOX_AXES}')
    return tuple(notes)


def _field_axes(field_axes: str, up: str) -> Float64s | None:
    """Return the axes of a medium in the box, or None.

    With "lattice" only the directions in which the lattice grows count: a diagonal of signs.
    """
    if up in _UP_AXES:
        return axes_of_text(_UP_AXES[up])
    if up == "auto":
        return axes_of_text(field_axes.replace("east", "right").replace("north", "away"))
    matrix = axes_of_text(field_axes)
    return matrix if matrix is not None and np.diagonal(matrix).all() else None
