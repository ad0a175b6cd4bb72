"""Driver of the force-feedback arms Touch, Touch X, Phantom Omni and Phantom Premium, through the vendor's
library OpenHaptics.

The vendor's driver calls a callback in a thread of its own. The callback is C (``c/touch_openhaptics.h``) and
does not take the interpreter's lock: it begins a frame, reads the position (millimetres), runs one tick of
the renderer, sets the force and ends the frame.

Before `close` the servo has ordered the release. `close` waits until the force is zero, sets zero for one
more frame, and then removes callback, scheduler and device.
"""

from __future__ import annotations

import time
from contextlib import suppress
from ctypes import (
    Structure,
    addressof,
    c_char_p,
    c_double,
    c_int,
    c_int64,
    c_uint32,
    c_ulong,
    c_ushort,
    c_void_p,
    cast,
    sizeof,
)
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Final

from touchfield.compute.native import native
from touchfield.devices.drivers.links import DriverLibrary
from touchfield.devices.drivers.registry import DeviceKind, Opener
from touchfield.errors import DeviceError, InvalidArgument
from touchfield.render.point_device import PointDevice

if TYPE_CHECKING:
    from touchfield.medium.trace import Trace


DRIVER: Final = DriverLibrary(
    "OpenHaptics",
    "TOUCHFIELD_OPENHAPTICS_LIBRARY",
    ("libHD.so", "libHD.so.3"),
    ("hd.dll",),
    ("/Library/Frameworks/HD.framework/HD",),
    "Install the maker's OpenHaptics and its device driver",
)


class _ErrorInfo(Structure):
    _fields_ = (("code", c_uint32), ("internal_code", c_int), ("device", c_uint32))


_FUNCTIONS: Final[dict[str, tuple[Any, tuple[Any, ...]]]] = {
    "hdInitDevice": (c_uint32, (c_char_p,)),
    "hdDisableDevice": (None, (c_uint32,)),
    "hdEnable": (None, (c_uint32,)),
    "hdGetError": (_ErrorInfo, ()),
    "hdGetErrorString": (c_char_p, (c_uint32,)),
    "hdBeginFrame": (None, (c_uint32,)),
    "hdEndFrame": (None, (c_uint32,)),
    "hdGetDoublev": (None, (c_uint32, c_void_p)),
    "hdSetDoublev": (None, (c_uint32, c_void_p)),
    "hdScheduleAsynchronous": (c_ulong, (c_void_p, c_void_p, c_ushort)),
    "hdUnschedule": (None, (c_ulong,)),
    "hdStartScheduler": (None, ()),
    "hdStopScheduler": (None, ()),
}
_CALLBACK_FUNCTIONS: Final = ("hdBeginFrame", "hdEndFrame", "hdGetDoublev", "hdSetDoublev", "hdGetError")
"""Functions that the callback calls, in the order of `touch_driver`."""


class _Driver(Structure):
    """`touch_driver` of ``c/touch_openhaptics.h``: the callback's functions, orders and results."""

    _fields_ = (
        ("receiver", c_void_p),
        ("tick", c_void_p),
        *((name, c_void_p) for name in _CALLBACK_FUNCTIONS),
        *((name, c_int64) for name in ("device", "must_stop", "end", "calls", "error")),
        ("position_mm", c_double * 3),
        ("force_n", c_double * 3),
    )


_FORCE_OUTPUT: Final = 0x4000
_INVALID_HANDLE: Final = 0xFFFFFFFF
_HIGHEST_PRIORITY: Final = 0xFFFF
_RELEASE_S: Final = 1.0
"""Time for which `close` waits for the force to be zero."""

_SILENCE_S: Final = 0.5
_LAST_FRAME_S: Final = 0.5
_WHERE: Final = "OpenHaptics device"

_LEAKED: Final[list[_Driver]] = []
"""Memory of callbacks that a driver may still call, because it did not stop when ordered to."""


class OpenHaptics(PointDevice):
    """A device, by its name in the driver's configuration.

    Parameters
    ----------
    name : str or None
        For example "Left Device"; None is the default device.
    tick_address : int or None
        Address of the function that the callback calls for a force; None is `touch_receiver_tick`.
    """

    is_driven: ClassVar[bool] = True

    def __init__(self, name: str | None = None, tick_address: int | None = None) -> None:
        self._name, self._tick_address = name, tick_address
        self._library: Any = None
        self._device: int | None = None
        self._operation: int | None = None
        self._driver = _Driver()
        self._progress = (0, 0.0)  # number of calls, and the time of the last change

    def load(self) -> None:
        """See `PointDevice.load`."""
        DRIVER.load(_FUNCTIONS)

    def open(self) -> None:
        """Load the driver, find the device and switch forces on.

        The callback is not called yet.
        """
        self.close()
        library = self._library = DRIVER.load(_FUNCTIONS)
        device = library.hdInitDevice(None if self._name is None else self._name.encode())
        error = self._error("find the device", "Is it plugged in, and set up with the maker's own tool?")
        if error is None and device == _INVALID_HANDLE:
            error = DeviceError(
                _WHERE, "no device", "one", "Is it plugged in, and set up with the maker's own tool?"
            )
        if error is not None:
            raise error
        self._device = device
        library.hdEnable(_FORCE_OUTPUT)
        self._raise_error("switch forces on")

    def drive(self, address: int, size_bytes: int) -> None:
        """Let the driver call the renderer on the receiver at `address`; returns at once."""
        if self._device is None or self._operation is not None:
            raise DeviceError(_WHERE, "a device that is not open, or driven already", "an open one")
        callback, tick, driver_bytes = native.openhaptics_callback()
        assert driver_bytes == sizeof(_Driver)
        functions = (cast(getattr(self._library, name), c_void_p) for name in _CALLBACK_FUNCTIONS)
        self._driver = _Driver(address, self._tick_address or tick, *functions, self._device)
        self._operation = self._library.hdScheduleAsynchronous(
            callback, addressof(self._driver), _HIGHEST_PRIORITY
        )
        self._raise_error("schedule the callback")
        self._library.hdStartScheduler()
        self._raise_error("start the scheduler")
        self._progress = (0, time.monotonic())

    def watch(self) -> None:
        """Check that the driver calls the callback and has no fault."""
        if self._operation is None:
            raise DeviceError(_WHERE, "a device that is not driven", "a driven one")
        calls, end, code = self._driver.calls, self._driver.end, self._driver.error
        now = time.monotonic()
        if calls != self._progress[0]:
            self._progress = (calls, now)
        if code:
            raise DeviceError(
                _WHERE, f"a fault while it ran ({self._reason(code)})", hint="Is it still plugged in?"
            )
        if end:
            raise DeviceError(_WHERE, "a renderer that failed", "finite forces")
        if now - self._progress[1] > _SILENCE_S:
            found = f"a driver that has not called for {_SILENCE_S:g} s, after {calls} calls"
            raise DeviceError(_WHERE, found, "a call each millisecond", "Is it still plugged in?")

    def position_m(self) -> tuple[float, float, float]:
        """Not for a device whose driver calls us."""
        raise DeviceError(_WHERE, "a call of position_m", "drive", "Its driver calls the renderer.")

    def put_force_n(self, x: float, y: float, z: float) -> None:
        """Not for a device whose driver calls us."""
        raise DeviceError(_WHERE, "a call of put_force_n", "drive", "Its driver calls the renderer.")

    def close(self) -> None:
        """Wait until the force is zero, then end the callback and release the device."""
        library, device, operation = self._library, self._device, self._operation
        self._device = self._operation = None
        if device is None:
            return
        with suppress(Exception):
            done = operation is None or self._end_callback()
            library.hdStopScheduler()
            if operation is not None and not done:
                library.hdUnschedule(operation)
                _LEAKED.append(self._driver)
        with suppress(Exception):
            library.hdDisableDevice(device)

    def _end_callback(self) -> bool:
        """End the callback after a last force of zero; True if it will not be called."""
        driver = self._driver
        _wait(lambda: not any(driver.force_n) or bool(driver.end), _RELEASE_S)
        driver.must_stop = 1
        return _wait(lambda: bool(driver.end), _LAST_FRAME_S)

    def _raise_error(self, action: str) -> None:
        error = self._error(action)
        if error is not None:
            self.close()
            raise error

    def _error(self, action: str, hint: str = "") -> DeviceError | None:
        """Return the latest error on the driver's stack, which is cleared; None if there is none."""
        first = self._library.hdGetError()
        if not first.code:
            return None
        for _ in range(64):
            if not self._library.hdGetError().code:
                break
        return DeviceError(_WHERE, f"that it could not {action} ({self._reason(first.code)})", hint=hint)

    def _reason(self, code: int) -> str:
        text = self._library.hdGetErrorString(code) or b"no reason given"
        return f"{text[:120].decode('ascii', 'replace')}, code {code:#06x}"


def _wait(condition: Any, seconds: float) -> bool:
    """Wait for `condition`; False if it did not come true in time."""
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() >= deadline:
            return False
        time.sleep(0.001)
    return True


def _opener(rest: str, trajectory: Trace | None) -> Opener:
    if not rest.isprintable() or len(rest.encode()) > 127:
        raise InvalidArgument(
            "device", f"'openhaptics:{rest[:40]}'", "the name of a device in its driver's settings"
        )
    return partial(OpenHaptics, rest or None)


KIND = DeviceKind(
    "openhaptics", "openhaptics[:NAME]", "Touch and Phantom, by OpenHaptics", "touch", _opener, DRIVER.checks
)
