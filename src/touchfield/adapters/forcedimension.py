"""Force Dimension devices (omega, delta, sigma, and the Falcon) by the maker's library dhd; asked at each tick.

Metres and newtons in the device's own axes: x towards the user, y right, z up. The library adds the weight of the
handle to what is put, so `gravity_n` stays zero.
"""

from __future__ import annotations

import math
from contextlib import suppress
from ctypes import POINTER, byref, c_byte, c_char_p, c_double, c_int, c_ubyte
from typing import TYPE_CHECKING, Any, Final

from touchfield.adapters.check import Check
from touchfield.adapters.driver_library import DriverLibrary
from touchfield.adapters.point_registry import Opener, PointKind
from touchfield.errors import DeviceError, InvalidArgument
from touchfield.render.point_device import PointDevice

if TYPE_CHECKING:
    from touchfield.measure.trace import Trace

__all__ = ["DRIVER", "KIND", "ForceDimension"]

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
    "dhdSetForce": (c_int, (c_double, c_double, c_double, c_byte)),
    "dhdClose": (c_int, (c_byte,)),
    "dhdErrorGetLastStr": (c_char_p, ()),
}
_WHERE: Final = "Force Dimension device"


class ForceDimension(PointDevice):
    """The first device that the library finds."""

    def __init__(self) -> None:
        self._library: Any = None
        self._device: int | None = None
        self._place = (c_double(), c_double(), c_double())
        self._at = tuple(map(byref, self._place))

    def open(self) -> None:
        """Open the device, put a force of zero, and switch forces on."""
        self.close()
        self._library = DRIVER.load(_FUNCTIONS)
        device = self._library.dhdOpen()
        if device < 0:
            raise self._error("open", "Is it plugged in, switched on, and free?")
        self._device = device
        try:
            if self._library.dhdEnableForce(1, device) < 0:
                raise self._error("switch forces on")
            self.put_force_n(0.0, 0.0, 0.0)
        except DeviceError:
            self.close()
            raise

    def position_m(self) -> tuple[float, float, float]:
        """Where the device says it is."""
        self._check_open()
        if self._library.dhdGetPosition(*self._at, self._device) < 0:  # 1: the same as a moment ago
            raise self._error("get position")
        x, y, z = (axis.value for axis in self._place)
        if not math.isfinite(x + y + z):
            raise DeviceError(_WHERE, f"a position of {x:g}, {y:g}, {z:g} m", "finite metres")
        return x, y, z

    def put_force_n(self, x: float, y: float, z: float) -> None:
        """Set the force."""
        self._check_open()
        if not math.isfinite(x + y + z):
            raise DeviceError(_WHERE, f"a force of {x:g}, {y:g}, {z:g} N", "finite newtons")
        if self._library.dhdSetForce(x, y, z, self._device) < 0:  # 2: a motor is at its limit
            raise self._error("set force")

    def close(self) -> None:
        """A force of zero, forces off, device closed."""
        device, self._device = self._device, None
        if device is not None:
            with suppress(Exception):
                self._library.dhdSetForce(0.0, 0.0, 0.0, device)
                self._library.dhdEnableForce(0, device)
                self._library.dhdClose(device)

    def _check_open(self) -> None:
        if self._device is None:
            raise DeviceError(_WHERE, "a device that is not open", "an open one")

    def _error(self, what: str, mend: str = "") -> DeviceError:
        words = self._library.dhdErrorGetLastStr() or b"no reason given"
        found = f"that it could not {what} ({words[:120].decode('ascii', 'replace')})"
        return DeviceError(_WHERE, found, mend=mend)


def checks() -> list[Check]:
    """The maker's library."""
    return [DRIVER.check()]


def _opener(rest: str, trajectory: Trace | None) -> Opener:
    if rest:
        raise InvalidArgument("device", f"'forcedimension:{rest[:40]}'", "forcedimension, nothing behind it")
    return ForceDimension


KIND = PointKind("forcedimension", "forcedimension", "Force Dimension, by dhd", "omega.3", _opener, checks)
