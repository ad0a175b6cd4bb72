"""Converts what a driver reports into the types of the renderer, in one place, before each tick.

Drivers return floats, ints, NumPy scalars, lists or arrays, as their makers' libraries do. The renderer gets
floats and whole numbers of 64 bits, and nothing is compiled inside a tick. A reading of another form raises
DeviceError, which names it, so that the force goes to zero from the latest valid position. NaN is a valid
reading: of a position or an orientation, it releases the force until the next finite one.
"""

from __future__ import annotations

import struct
from operator import index
from typing import Any, Final

from touchfield.errors import DeviceError

_HINT: Final = "Correct its driver"
_THREE: Final = struct.Struct("3d")  # faster than float() of each, and refuses text
_FOUR: Final = struct.Struct("4d")
_ONE: Final = struct.Struct("d")
_MAX_BUTTONS: Final = 1 << 63


def position_reading(reading: Any) -> tuple[float, float, float]:
    """Return a position, metres, from three numbers."""
    try:
        x, y, z = _THREE.unpack(_THREE.pack(*reading))
    except _ERRORS as error:
        raise _refused("position", reading, "three numbers, metres") from error
    return x, y, z


def orientation_reading(reading: Any) -> tuple[float, float, float, float]:
    """Return a quaternion (w, x, y, z) from four numbers."""
    try:
        w, x, y, z = _FOUR.unpack(_FOUR.pack(*reading))
    except _ERRORS as error:
        raise _refused("orientation", reading, "four numbers, w first") from error
    return w, x, y, z


def buttons_reading(reading: Any) -> int:
    """Return a bit mask from a whole number, 0 to below 2^63."""
    try:
        buttons = index(reading)
    except _ERRORS as error:
        raise _refused("buttons", reading, "a whole number, bit n for button n") from error
    if not 0 <= buttons < _MAX_BUTTONS:
        raise _refused("buttons", reading, "a whole number from 0 to below 2^63, bit n for button n")
    return buttons


def gripper_reading(reading: Any) -> float:
    """Return the opening of a gripper, metres, from a number."""
    try:
        (opening_m,) = _ONE.unpack(_ONE.pack(reading))
    except _ERRORS as error:
        raise _refused("gripper", reading, "a number, metres") from error
    return float(opening_m)


_ERRORS: Final = (struct.error, TypeError, ValueError, OverflowError)


def _refused(what: str, reading: Any, expected: str) -> DeviceError:
    return DeviceError(f"{what} of the device", repr(reading)[:80], expected, _HINT)
