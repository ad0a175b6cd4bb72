"""Compiled: how the hand is turned, and the torque that is handed out; the torque's way is that of the force.

A grip that says no orientation (not finite, or no unit quaternion) is as a device that says no place: gain goes down,
and of a torque that cannot be computed any more the last one is let go, within the limits of `limits`.
"""

from __future__ import annotations

import math

from numba import njit

from touchfield.render.kernels.limits import limited_torque
from touchfield.render.kernels.parts import turned
from touchfield.render.places import AXES, FORCE_SCALE, SCALE
from touchfield.render.wrench_places import (
    FIELD_TORQUE,
    HANDEDNESS,
    ORIENTATION,
    TOOL_POINTS,
    TORQUE,
    TURN,
    WANTED_TORQUE,
)

__all__ = ["is_turned", "let_torque_go", "put_torque", "want_torque"]

_LEAST, _MOST = 0.81, 1.21
"""Of the square of a quaternion that was meant to be of length 1."""


@njit(cache=True, nogil=True)
def is_turned(i8, f8):
    """Whether the device says how the grip is turned; keeps how that turns the tool in the field."""
    if i8[TOOL_POINTS] == 0:
        return True
    w, x, y, z = f8[ORIENTATION], f8[ORIENTATION + 1], f8[ORIENTATION + 2], f8[ORIENTATION + 3]
    square = w * w + x * x + y * y + z * z
    if not _LEAST <= square <= _MOST:  # false of NaN, too
        return False
    s = 2.0 / square
    grip = (
        (1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)),
        (s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)),
        (s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)),
    )
    axes = (
        (f8[AXES], f8[AXES + 1], f8[AXES + 2]),
        (f8[AXES + 3], f8[AXES + 4], f8[AXES + 5]),
        (f8[AXES + 6], f8[AXES + 7], f8[AXES + 8]),
    )
    for n in range(3):  # AXES . grip . AXES', column by column
        gx, gy, gz = turned(grip, axes[n][0], axes[n][1], axes[n][2])
        gx, gy, gz = turned(axes, gx, gy, gz)
        f8[TURN + n], f8[TURN + 3 + n], f8[TURN + 6 + n] = gx, gy, gz
    return True


@njit(cache=True, nogil=True, forceinline=True)
def want_torque(f8):
    """The torque before gain and limits, from that of the field: a lever of the field is SCALE times the device's."""
    tx, ty, tz = f8[FIELD_TORQUE], f8[FIELD_TORQUE + 1], f8[FIELD_TORQUE + 2]
    if not (math.isfinite(tx) and math.isfinite(ty) and math.isfinite(tz)):
        tx, ty, tz = 0.0, 0.0, 0.0
    scale = f8[HANDEDNESS] * f8[FORCE_SCALE] / f8[SCALE]
    for n in range(3):
        f8[WANTED_TORQUE + n] = scale * (f8[AXES + n] * tx + f8[AXES + 3 + n] * ty + f8[AXES + 6 + n] * tz)


@njit(cache=True, nogil=True, forceinline=True)
def put_torque(f8, gain, dt):
    """Hand out the torque that is wanted, as far as gain and limits let it."""
    if gain == 0.0:
        f8[WANTED_TORQUE], f8[WANTED_TORQUE + 1], f8[WANTED_TORQUE + 2] = 0.0, 0.0, 0.0
    limited_torque(f8, gain * f8[WANTED_TORQUE], gain * f8[WANTED_TORQUE + 1], gain * f8[WANTED_TORQUE + 2], dt)


@njit(cache=True, nogil=True, forceinline=True)
def let_torque_go(f8, share, dt):
    """The next torque on the way to zero: `share` of the one before."""
    for n in range(3):
        f8[WANTED_TORQUE + n] = 0.0
    limited_torque(f8, share * f8[TORQUE], share * f8[TORQUE + 1], share * f8[TORQUE + 2], dt)
