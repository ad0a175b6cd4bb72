"""Driver of the force-feedback arms of Force Dimension (omega, delta, sigma, Falcon), through the vendor's
library.

The library is dhd, and is called at each tick. Metres and newtons are in the device's own axes: x towards the
user, y right, z up. The library adds the weight of the handle to the force, so `gravity_n` stays zero. A
device without a wrist reports no rotation, one without a gripper reports it closed. Torque is sent only from
the first nonzero torque on, so that a device without motors for it never receives one.
"""

from __future__ import annotations

import math
from contextlib import suppress
from ctypes import POINTER, byref, c_bool, c_byte, c_char_p, c_double, c_int, c_ubyte, c_uint
from typing import TYPE_CHECKING, Any, Final

from touchfield.devices.drivers.links import DriverLibrary
from touchfield.devices.drivers.registry import DeviceKind, Opener
from touchfield.errors import DeviceError, InvalidArgument
from touchfield.render.point_device import PointDevice, Quaternion

if TYPE_CHECKING:
    from touchfield.medium.trace import Trace


DRIVER: Final = DriverLibrary(
    "Force Dimension",
    "TOUCHFIELD_FORCEDIMENSION_LIBRARY",
    ("libdhd.so", "libdhd.so.3"),
    ("dhd64.dll", "dhd.dll"),
    ("libdhd.dylib", "/usr/local/lib/libdhd.dylib"),
    "Install the maker's SDK",
)

_DOUBLE: Final = POINTER(c_double)
_FUNCTIONS: Final[dict[str, tuple[Any, tuple[Any, ...]]]] = {
    "dhdOpen": (c_int, ()),
    "dhdEnableForce": (c_int, (c_ubyte, c_byte)),
    "dhdGetPosition": (c_int, (_DOUBLE, _DOUBLE, _DOUBLE, c_byte)),
    "dhdGetOrientationFrame": (c_int, (_DOUBLE, c_byte)),
    "dhdGetButtonMask": (c_uint, (c_byte,)),
    "dhdGetGripperGap": (c_int, (_DOUBLE, c_byte)),
    "dhdHasWrist": (c_bool, (c_byte,)),
    "dhdHasGripper": (c_bool, (c_byte,)),
    "dhdSetForce": (c_int, (c_double, c_double, c_double, c_byte)),
    "dhdSetForceAndTorqueAndGripperForce": (c_int, (*(7 * (c_double,)), c_byte)),
    "dhdClose": (c_int, (c_byte,)),
    "dhdErrorGetLastStr": (c_char_p, ()),
}
_WHERE: Final = "Force Dimension device"


class ForceDimension(PointDevice):
    """The first device that the library finds."""

    def __init__(self) -> None:
        self._library: Any = None
        self._device: int | None = None
        self._position = (c_double(), c_double(), c_double())
        self._position_pointers = tuple(map(byref, self._position))
        self._frame, self._gap = (9 * c_double)(), c_double()
        self._has_wrist = self._has_gripper = self._has_torque = False

    def load(self) -> None:
        """See `PointDevice.load`."""
        DRIVER.load(_FUNCTIONS)

    def open(self) -> None:
        """Open the device, put a force of zero, and switch forces on."""
        self.close()
        self._library = DRIVER.load(_FUNCTIONS)
        device = self._library.dhdOpen()
        if device < 0:
            raise self._error("open", "Is it plugged in, switched on, and free?")
        self._device, self._has_torque = device, False
        self._has_wrist = bool(self._library.dhdHasWrist(device))
        self._has_gripper = bool(self._library.dhdHasGripper(device))
        try:
            self._call("dhdEnableForce", "switch forces on", 1)
            self.put_force_n(0.0, 0.0, 0.0)
        except DeviceError:
            self.close()
            raise

    def position_m(self) -> tuple[float, float, float]:
        """Position as the device reports it."""
        self._call("dhdGetPosition", "get position", *self._position_pointers)  # 1: unchanged
        x, y, z = (axis.value for axis in self._position)
        if not math.isfinite(x + y + z):
            raise DeviceError(_WHERE, f"a position of {x:g}, {y:g}, {z:g} m", "finite metres")
        return x, y, z

    def orientation(self) -> Quaternion:
        """Orientation of the wrist."""
        if not self._has_wrist:
            return 1.0, 0.0, 0.0, 0.0
        self._call("dhdGetOrientationFrame", "get orientation", self._frame)
        w, x, y, z = quaternion_of_rows(*self._frame)
        if not math.isfinite(w + x + y + z):
            raise DeviceError(_WHERE, "an orientation that is no rotation", "a rotation matrix")
        return w, x, y, z

    def buttons(self) -> int:
        """The button mask."""
        return self._call("dhdGetButtonMask", "get buttons")

    def gripper_m(self) -> float:
        """The gap between thumb and finger."""
        if not self._has_gripper:
            return 0.0
        self._call("dhdGetGripperGap", "get gripper", byref(self._gap))
        return float(self._gap.value)

    def put_wrench(self, fx: float, fy: float, fz: float, tx: float, ty: float, tz: float) -> None:
        """Set force and torque, with no gripper force.

        From the first nonzero torque on, both are set in one call.
        """
        self._has_torque = self._has_torque or tx != 0.0 or ty != 0.0 or tz != 0.0
        if not self._has_torque:
            self.put_force_n(fx, fy, fz)
            return
        if not math.isfinite(fx + fy + fz + tx + ty + tz):
            found = f"a force of {fx:g}, {fy:g}, {fz:g} N and a torque of {tx:g}, {ty:g}, {tz:g} N m"
            raise DeviceError(_WHERE, found, "finite newtons and newton metres")
        self._call("dhdSetForceAndTorqueAndGripperForce", "set force and torque", fx, fy, fz, tx, ty, tz, 0.0)

    def put_force_n(self, x: float, y: float, z: float) -> None:
        """Set the force."""
        if not math.isfinite(x + y + z):
            raise DeviceError(_WHERE, f"a force of {x:g}, {y:g}, {z:g} N", "finite newtons")
        self._call("dhdSetForce", "set force", x, y, z)  # 2: a motor is at its limit

    def close(self) -> None:
        """Set force and torque to zero, switch forces off, and close the device."""
        device, self._device = self._device, None
        if device is not None:
            with suppress(Exception):
                # an earlier process may have left a torque; a wrist without motors rejects one
                is_zero = False
                if self._has_wrist:
                    is_zero = self._library.dhdSetForceAndTorqueAndGripperForce(*(7 * (0.0,)), device) >= 0
                if not is_zero:
                    self._library.dhdSetForce(0.0, 0.0, 0.0, device)
                self._library.dhdEnableForce(0, device)
                self._library.dhdClose(device)

    def _call(self, function: str, action: str, *arguments: Any) -> int:
        """Call a function whose last argument is the device; `DeviceError` if it fails."""
        if self._device is None:
            raise DeviceError(_WHERE, "a device that is not open", "an open one")
        result: int = getattr(self._library, function)(*arguments, self._device)
        if result < 0:
            raise self._error(action)
        return result

    def _error(self, action: str, hint: str = "") -> DeviceError:
        text = self._library.dhdErrorGetLastStr() or b"no reason given"
        found = f"that it could not {action} ({text[:120].decode('ascii', 'replace')})"
        return DeviceError(_WHERE, found, hint=hint)


def quaternion_of_rows(
    a: float, b: float, c: float, d: float, e: float, f: float, g: float, h: float, i: float
) -> Quaternion:
    """Return the quaternion (w, x, y, z) of a rotation matrix given by rows.

    Returns NaN if the matrix is not a rotation.
    """
    squares = (1 + a + e + i, 1 + a - e - i, 1 - a + e - i, 1 - a - e + i)  # four times those of w, x, y, z
    rows = (
        (squares[0], h - f, c - g, d - b),
        (h - f, squares[1], b + d, c + g),
        (c - g, b + d, squares[2], f + h),
        (d - b, c + g, f + h, squares[3]),
    )
    row = rows[max(range(4), key=squares.__getitem__)]  # the largest, to avoid cancellation
    length = math.hypot(*row)
    w, x, y, z = (v / length for v in row)
    return w, x, y, z


def _opener(rest: str, trajectory: Trace | None) -> Opener:
    if rest:
        raise InvalidArgument("device", f"'forcedimension:{rest[:40]}'", "forcedimension, without a colon")
    return ForceDimension


KIND = DeviceKind(
    "forcedimension", "forcedimension", "Force Dimension, by dhd", "omega.3", _opener, DRIVER.checks
)
