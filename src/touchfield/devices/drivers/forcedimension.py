"""Driver of the force-feedback arms of Force Dimension (omega, delta, sigma, Falcon), through the vendor's
library.

The library is dhd, and is called at each tick. Metres and newtons are in the device's own axes: x towards the
user, y right, z up. The library adds the weight of the handle to the force, so `gravity_n` stays zero. A
device without a wrist reports no rotation, one without a gripper reports it closed. Torque is sent only from
the first nonzero torque on, so that a device without motors for it never receives one.

A unit is named by its serial number. Its state is that of `dhdGetStatus`: in RESET mode the device is not
calibrated, and the user is expected to put its handle to the rest position. The state is also read a few
times a second while the device is driven; that this call is as quick as those of a tick is unverified.

The library compensates the weight of the handle itself (`dhdSetGravityCompensation`, `dhdSetEffectorMass`):
it adds that to each force. Names, indices and signatures are those of the maker's header ``dhdc.h`` 3.7;
those of gravity, handedness and status are the same in its release 3.2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from ctypes import POINTER, byref, c_bool, c_byte, c_char_p, c_double, c_int, c_ubyte, c_uint, c_ushort
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Final

from touchfield.devices.drivers.links import DriverLibrary
from touchfield.devices.drivers.registry import DeviceKind, DeviceSetting, Opener, on_or_off, positive_number
from touchfield.devices.drivers.unit_lock import UnitLock
from touchfield.errors import DeviceAbsent, DeviceError, InvalidArgument
from touchfield.render.point_device import PointDevice, Quaternion
from touchfield.render.readiness import Readiness

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
_OPTIONAL: Final[dict[str, tuple[Any, tuple[Any, ...]]]] = {
    "dhdGetDeviceCount": (c_int, ()),
    "dhdOpenID": (c_int, (c_byte,)),
    "dhdOpenSerial": (c_int, (c_int,)),
    "dhdGetSerialNumber": (c_int, (POINTER(c_ushort), c_byte)),
    "dhdGetStatus": (c_int, (POINTER(c_int), c_byte)),
    "dhdIsLeftHanded": (c_bool, (c_byte,)),
    "dhdSetGravityCompensation": (c_int, (c_int, c_byte)),
    "dhdSetEffectorMass": (c_int, (c_double, c_byte)),
}
_POWER, _CONNECTED, _STARTED, _RESET = range(4)
_GRAVITY: Final = 10
"""Indices of DHD_STATUS_... in the status."""

_STATUS_SIZE: Final = 64
"""Capacity for the status; DHD_MAX_STATUS is 16 in release 3.7, and may be more in a later one."""

_MAX_SERIAL: Final = 0xFFFF
_MAX_MASS_KG: Final = 5.0
_WHERE: Final = "Force Dimension device"
_OPEN_HINT: Final = "Is it plugged in, switched on, and free?"
_NAME_HINT: Final = "Name another unit: --device forcedimension:SERIAL (touchfield devices --connected)"


class ForceDimension(PointDevice):
    """A device.

    Parameters
    ----------
    serial : int or None
        Its serial number; None is the first device that the library finds free.
    gravity : bool or None
        Whether the library compensates the weight of the handle; None leaves that as it is.
    mass_kg : float or None
        Mass of the handle; None is that which the library assumes.
    """

    title: ClassVar[str] = _WHERE

    def __init__(
        self, serial: int | None = None, gravity: bool | None = None, mass_kg: float | None = None
    ) -> None:
        self._serial, self._unit = serial, ""
        self._gravity, self._mass_kg = gravity, mass_kg
        self._lock: UnitLock | None = None
        self._library: Any = None
        self._device: int | None = None
        self._position = (c_double(), c_double(), c_double())
        self._position_pointers = tuple(map(byref, self._position))
        self._frame, self._gap = (9 * c_double)(), c_double()
        self._has_wrist = self._has_gripper = self._has_torque = False

    def load(self) -> None:
        """See `PointDevice.load`."""
        DRIVER.load(_FUNCTIONS, _OPTIONAL)

    def open(self) -> None:
        """Open the device, put a force of zero, and switch forces on."""
        self.close()
        library = self._library = DRIVER.load(_FUNCTIONS, _OPTIONAL)
        if self._serial is None:
            device = library.dhdOpen()
        elif hasattr(library, "dhdOpenSerial"):
            device = library.dhdOpenSerial(self._serial)
        else:
            raise DeviceError(_WHERE, "a library that opens no device by its serial number", "a newer SDK")
        if device < 0:
            raise DeviceAbsent(_WHERE, self._failure("open"), hint=_OPEN_HINT)
        try:
            self._unit = serial_number(library, device)
            if self._unit:
                self._lock = UnitLock(_WHERE, self._unit, _NAME_HINT)
        except DeviceError:
            library.dhdClose(device)  # no force was switched on
            raise
        self._device, self._has_torque = device, False
        self._has_wrist = bool(library.dhdHasWrist(device))
        self._has_gripper = bool(library.dhdHasGripper(device))
        try:
            self._compensate_gravity()
            self._call("dhdEnableForce", "switch forces on", 1)
            self.put_force_n(0.0, 0.0, 0.0)
        except DeviceError:
            self.close()
            raise

    def _compensate_gravity(self) -> None:
        """Make the settings of gravity compensation that were given."""
        mass = () if self._mass_kg is None else (("dhdSetEffectorMass", self._mass_kg),)
        gravity = () if self._gravity is None else (("dhdSetGravityCompensation", int(self._gravity)),)
        for function, value in (*mass, *gravity):
            if not hasattr(self._library, function):
                raise DeviceError(_WHERE, f"a library without {function}", "a newer SDK")
            self._call(function, "set the gravity compensation", value)

    def readiness(self) -> Readiness:
        """See `PointDevice.readiness`."""
        if not hasattr(self._library, "dhdGetStatus"):
            return Readiness(self._unit)
        status = (c_int * _STATUS_SIZE)()
        self._call("dhdGetStatus", "get status", status)
        return readiness_of(self._unit, status)

    def state(self) -> Readiness:
        """See `PointDevice.state`."""
        return self.readiness()

    @property
    def unit(self) -> str:
        """See `PointDevice.unit`: the serial number, unless it was given."""
        return self._unit if self._serial is None else ""

    def use_unit(self, unit: str) -> None:
        """See `PointDevice.use_unit`."""
        self._serial = int(unit)

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
        lock, self._lock = self._lock, None
        if lock is not None:
            lock.release()

    def _call(self, function: str, action: str, *arguments: Any) -> int:
        """Call a function whose last argument is the device; `DeviceError` if it fails."""
        if self._device is None:
            raise DeviceError(_WHERE, "a device that is not open", "an open one")
        result: int = getattr(self._library, function)(*arguments, self._device)
        if result < 0:
            raise self._error(action)
        return result

    def _error(self, action: str) -> DeviceError:
        return DeviceError(_WHERE, self._failure(action))

    def _failure(self, action: str) -> str:
        text = self._library.dhdErrorGetLastStr() or b"no reason given"
        return f"that it could not {action} ({text[:120].decode('ascii', 'replace')})"


def serial_number(library: Any, device: int) -> str:
    """Return the serial number of an open device; "" if the library does not report it."""
    serial = c_ushort()
    if not hasattr(library, "dhdGetSerialNumber") or library.dhdGetSerialNumber(byref(serial), device) < 0:
        return ""
    return str(serial.value)


def readiness_of(unit: str, status: Any) -> Readiness:
    """Return the state of a unit from the integers of `dhdGetStatus`."""
    is_calibrated, is_powered = not status[_RESET], bool(status[_POWER])
    hint = ""
    if not is_calibrated:
        hint = "Move the handle to its rest position until the light stops blinking."
    if not is_powered:
        hint = "Switch it on."
    return Readiness(
        unit, bool(status[_CONNECTED]), is_powered, is_calibrated, bool(status[_STARTED]), hint=hint
    )


def find_units(rest: str = "") -> list[Readiness]:
    """Return the state of each unit; one that cannot be opened is in use, and has no id.

    Each unit is opened and closed, without forces. Raises `DeviceError` if the library cannot be loaded.
    """
    library = DRIVER.load(_FUNCTIONS, _OPTIONAL)
    if not (hasattr(library, "dhdGetDeviceCount") and hasattr(library, "dhdOpenID")):
        raise DeviceError(_WHERE, "a library that lists no devices", "a newer SDK")
    found = []
    for number in range(max(library.dhdGetDeviceCount(), 0)):
        device = library.dhdOpenID(number)
        if device < 0:
            found.append(Readiness(is_free=False))
            continue
        unit, status = serial_number(library, device), (c_int * _STATUS_SIZE)()
        has_status = hasattr(library, "dhdGetStatus") and library.dhdGetStatus(status, device) >= 0
        settings = settings_of(library, device, status if has_status else None)
        library.dhdClose(device)
        state = readiness_of(unit, status) if has_status else Readiness(unit)
        found.append(replace(state, settings=settings))
    return found


def settings_of(library: Any, device: int, status: Any) -> tuple[str, ...]:
    """Return the settings of an open device as texts; `status` is None if it is not known."""
    settings = []
    if hasattr(library, "dhdIsLeftHanded"):
        settings.append("left-handed" if library.dhdIsLeftHanded(device) else "right-handed")
    if status is not None:
        settings.append(f"gravity compensation {'on' if status[_GRAVITY] else 'off'}")
    return tuple(settings)


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
    if not rest:
        return ForceDimension
    if not (rest.isascii() and rest.isdigit() and len(rest) <= 5 and int(rest) <= _MAX_SERIAL):
        found = f"'forcedimension:{rest[:40]}'"
        raise InvalidArgument("device", found, "forcedimension or forcedimension:SERIAL, a serial number")
    return partial(ForceDimension, int(rest))


_SETTINGS: Final = (
    DeviceSetting("gravity", "on|off", "whether the library compensates the weight of the handle"),
    DeviceSetting("mass", "KG", "mass of the handle, kilograms"),
)


def _configure(opener: Opener, values: Mapping[str, str]) -> Opener:
    options: dict[str, Any] = {}
    if "gravity" in values:
        options["gravity"] = on_or_off("gravity", values["gravity"])
    if "mass" in values:
        options["mass_kg"] = positive_number("mass", values["mass"], _MAX_MASS_KG)
    return partial(opener, **options)


KIND = DeviceKind(
    "forcedimension", "forcedimension[:SERIAL]", "Force Dimension, by dhd", "omega.3",
    _opener, DRIVER.checks, find_units=find_units, settings=_SETTINGS, configure=_configure,
)  # fmt: skip
