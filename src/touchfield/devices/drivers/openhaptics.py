"""Driver of the force-feedback arms Touch, Touch X, Phantom Omni and Phantom Premium, through the vendor's
library OpenHaptics.

The vendor's driver calls a callback in a thread of its own. The callback is C (``c/touch_openhaptics.h``) and
does not take the interpreter's lock: it begins a frame, reads the position (millimetres) and the buttons,
runs one tick of the renderer, sets the force and ends the frame. Once in 64 frames it checks the calibration:
if that is lost, there is no position, so that the force goes to zero until the device is calibrated again.

Until the renderer is called, frames without force read calibration and position in the driver's thread
(`_ReadinessFrames`): elsewhere the driver does not update them. A device that has not been calibrated reports
the constant position of its inkwell, so it is ready only once its position has changed. Names and values are
those of the maker's headers ``hd.h`` and ``hdDefines.h`` (3.00 build 66); that a unit of another process can
be opened beside this one, and where the driver's settings list the names of devices, is unverified.

Before `close` the servo has ordered the release. `close` waits until the force is zero, sets zero for one
more frame, and then removes callback, scheduler and device.
"""

from __future__ import annotations

import math
import os
import time
from collections import deque
from contextlib import suppress
from ctypes import (
    CFUNCTYPE,
    Structure,
    addressof,
    byref,
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
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

from touchfield.compute.native import native
from touchfield.devices.drivers.links import DriverLibrary
from touchfield.devices.drivers.registry import DeviceKind, Opener
from touchfield.devices.drivers.unit_lock import UnitLock
from touchfield.errors import DeviceAbsent, DeviceError, InvalidArgument
from touchfield.render.point_device import PointDevice
from touchfield.render.readiness import Readiness

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
_OPTIONAL: Final[dict[str, tuple[Any, tuple[Any, ...]]]] = {
    "hdCheckCalibration": (c_uint32, ()),
    "hdUpdateCalibration": (None, (c_uint32,)),
    "hdGetIntegerv": (None, (c_uint32, c_void_p)),
    "hdGetString": (c_char_p, (c_uint32,)),
}
_CALLBACK_FUNCTIONS: Final = (
    *("hdBeginFrame", "hdEndFrame", "hdGetDoublev", "hdSetDoublev", "hdGetError"),
    *("hdGetIntegerv", "hdCheckCalibration", "hdUpdateCalibration"),
)
"""Functions that the callback calls, in the order of `touch_driver`; the library may lack the last three."""


class _Driver(Structure):
    """`touch_driver` of ``c/touch_openhaptics.h``: the callback's functions, orders and results."""

    _fields_ = (
        ("receiver", c_void_p),
        ("tick", c_void_p),
        *((name, c_void_p) for name in _CALLBACK_FUNCTIONS),
        *((name, c_int64) for name in ("device", "must_stop", "end", "calls", "error")),
        *((name, c_int64) for name in ("style", "calibration", "frame_ns")),
        ("buttons", c_void_p),
        ("position_mm", c_double * 3),
        ("force_n", c_double * 3),
    )


_FORCE_OUTPUT: Final = 0x4000
_POSITION_MM, _FORCE_N, _SERIAL_NUMBER, _CALIBRATION_STYLE = 0x2050, 0x2700, 0x2504, 0x2555
_CALIBRATION_OK, _CALIBRATION_NEEDS_UPDATE = 0x5000, 0x5001
_STYLES_WITHOUT_HELP: Final = (1 << 1, 1 << 2)
"""HD_CALIBRATION_AUTO and _INKWELL, which need no other action of the user than to use the inkwell."""

_OFFSETS: Final = dict(native.receiver_layout())
_BUTTONS_OFFSET: Final = _OFFSETS["touch_receiver.grip"] + _OFFSETS["touch_grip.buttons"]
"""Of the buttons in a receiver, bytes."""

_CALL_AGAIN: Final = 1
_SETTLED_FRAMES: Final = 3
"""Frames without an error after which a position counts: the first ones are not of the device."""

_MOVED_MM: Final = 1.0
"""Distance from the first position beyond which a device has moved; some twenty steps of its encoders."""
_INVALID_HANDLE: Final = 0xFFFFFFFF
_HIGHEST_PRIORITY: Final = 0xFFFF
_RELEASE_S: Final = 1.0
"""Time for which `close` waits for the force to be zero."""

_SILENCE_S: Final = 0.5
_LAST_FRAME_S: Final = 0.5
_WHERE: Final = "OpenHaptics device"
_INKWELL_HINT: Final = "Put the pen into its inkwell, or calibrate it with the maker's own tool."
_FIND_HINT: Final = "Is it plugged in, and set up with the maker's own tool?"
_NAME_HINT: Final = "Name another unit: --device openhaptics:NAME (touchfield devices --connected)"

_ENDED: Final[deque[Any]] = deque(maxlen=8)
"""The latest callbacks that were removed: the driver's thread may be in the middle of a call."""

_LEAKED: Final[list[_Driver]] = []
"""Memory of callbacks that a driver may still call, because it did not stop when ordered to."""


class _ReadinessFrames:
    """Frames without force that read calibration and position, called by the driver's thread.

    A device that needs an update of its calibration gets it. `calibration` is the latest HD_CALIBRATION_...,
    None if the library does not report it; `frames` counts frames without an error, and `moved_mm` is the
    largest distance from the first position since `calibration` last changed.
    """

    def __init__(self, library: Any, device: int) -> None:
        self._library, self._device = library, device
        self.has_calibration = hasattr(library, "hdCheckCalibration")
        self.calibration: int | None = None
        self.frames, self.moved_mm = 0, 0.0
        self._first_mm: tuple[float, ...] | None = None
        self._style = calibration_style(library)
        self._position_mm, self._no_force = (3 * c_double)(), (3 * c_double)()
        self._callback = CFUNCTYPE(c_uint32, c_void_p)(self._call)
        self._operation: int | None = library.hdScheduleAsynchronous(
            cast(self._callback, c_void_p), None, _HIGHEST_PRIORITY
        )

    def end(self) -> None:
        """Remove the callback; may be called twice."""
        operation, self._operation = self._operation, None
        if operation is not None:
            self._library.hdUnschedule(operation)

    def _call(self, _: int | None) -> int:
        library, calibration = self._library, None
        library.hdBeginFrame(self._device)
        if self.has_calibration:
            calibration = int(library.hdCheckCalibration())
        library.hdGetDoublev(_POSITION_MM, self._position_mm)
        library.hdSetDoublev(_FORCE_N, self._no_force)
        library.hdEndFrame(self._device)
        if calibration == _CALIBRATION_NEEDS_UPDATE and self._style:
            library.hdUpdateCalibration(self._style)
        if not clear_errors(library):
            self._record(calibration, tuple(self._position_mm))
        return _CALL_AGAIN

    def _record(self, calibration: int | None, position_mm: tuple[float, ...]) -> None:
        if calibration != self.calibration:
            self.calibration, self._first_mm, self.moved_mm = calibration, None, 0.0
        self.frames += 1
        if self.frames < _SETTLED_FRAMES:
            return
        self._first_mm = self._first_mm or position_mm
        self.moved_mm = max(self.moved_mm, math.dist(position_mm, self._first_mm))


def calibration_style(library: Any) -> int:
    """Return the calibration that the current device can do in its inkwell or by itself; 0 if none."""
    if not (hasattr(library, "hdGetIntegerv") and hasattr(library, "hdUpdateCalibration")):
        return 0
    styles = c_int()
    library.hdGetIntegerv(_CALIBRATION_STYLE, byref(styles))
    return next((style for style in _STYLES_WITHOUT_HELP if styles.value & style), 0)


def clear_errors(library: Any) -> int:
    """Clear the driver's stack of errors; returns the code of the latest, 0 if there was none."""
    first = int(library.hdGetError().code)
    for _ in range(64):
        if not first or not library.hdGetError().code:
            break
    return first


class OpenHaptics(PointDevice):
    """A device, by its name in the driver's configuration.

    Parameters
    ----------
    name : str or None
        For example "Left Device"; None is the default device.
    tick_address : int or None
        Address of the function that the callback calls for a force; None is `touch_receiver_tick`.
    """

    title: ClassVar[str] = _WHERE
    is_driven: ClassVar[bool] = True

    def __init__(self, name: str | None = None, tick_address: int | None = None) -> None:
        self._name, self._tick_address = name, tick_address
        self._lock: UnitLock | None = None
        self._frames: _ReadinessFrames | None = None
        self._is_scheduling = False
        self._library: Any = None
        self._device: int | None = None
        self._operation: int | None = None
        self._driver = _Driver()
        self._progress = (0, 0.0)  # number of calls, and the time of the last change

    def load(self) -> None:
        """See `PointDevice.load`."""
        DRIVER.load(_FUNCTIONS, _OPTIONAL)

    def open(self) -> None:
        """Load the driver, find the device and switch forces on.

        The callback is not called yet.
        """
        self.close()
        library = self._library = DRIVER.load(_FUNCTIONS, _OPTIONAL)
        device = library.hdInitDevice(None if self._name is None else self._name.encode())
        error = self._error("find the device")
        if error is not None:
            raise DeviceAbsent(_WHERE, error.found, hint=_FIND_HINT)
        if device == _INVALID_HANDLE:
            raise DeviceAbsent(_WHERE, "no device", "one", _FIND_HINT)
        try:
            unit = serial_number(library) or self._name or "default"
            self._lock = UnitLock(_WHERE, unit, _NAME_HINT)
        except DeviceError:
            library.hdDisableDevice(device)  # no force was switched on
            raise
        self._device = device
        library.hdEnable(_FORCE_OUTPUT)
        self._raise_error("switch forces on")

    def readiness(self) -> Readiness:
        """See `PointDevice.readiness`.

        The first call starts frames without force in the driver's thread; they end once the device is ready.
        """
        if self._device is None:
            raise DeviceError(_WHERE, "a device that is not open", "an open one")
        if self._frames is None:
            self._frames = _ReadinessFrames(self._library, self._device)
            self._raise_error("schedule the callback")
            self._start_scheduler()
        frames = self._frames
        is_calibrated = frames.calibration == _CALIBRATION_OK if frames.has_calibration else None
        is_started, has_moved = frames.frames >= _SETTLED_FRAMES, frames.moved_mm > _MOVED_MM
        hint = "Take the pen out of its inkwell and move it."
        if is_calibrated is False:
            hint = _INKWELL_HINT
        state = Readiness(
            self._name or "",
            is_calibrated=is_calibrated if is_started else None,
            is_started=is_started,
            has_moved=None if is_calibrated is False else has_moved,
            hint=hint,
        )
        if state.is_ready:
            frames.end()
        return state

    def _start_scheduler(self) -> None:
        if not self._is_scheduling:
            self._is_scheduling = True
            self._library.hdStartScheduler()
            self._raise_error("start the scheduler")

    def drive(self, address: int, size_bytes: int) -> None:
        """Let the driver call the renderer on the receiver at `address`; returns at once."""
        if self._device is None or self._operation is not None:
            raise DeviceError(_WHERE, "a device that is not open, or driven already", "an open one")
        if self._frames is not None:
            self._frames.end()
        callback, tick, driver_bytes = native.openhaptics_callback()
        assert driver_bytes == sizeof(_Driver)
        entries = (getattr(self._library, name, None) for name in _CALLBACK_FUNCTIONS)
        functions = (None if entry is None else cast(entry, c_void_p) for entry in entries)
        self._driver = _Driver(address, self._tick_address or tick, *functions, self._device)
        self._driver.style = calibration_style(self._library)
        self._driver.buttons = address + _BUTTONS_OFFSET
        self._operation = self._library.hdScheduleAsynchronous(
            callback, addressof(self._driver), _HIGHEST_PRIORITY
        )
        self._raise_error("schedule the callback")
        self._start_scheduler()
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

    def state(self) -> Readiness:
        """See `PointDevice.state`: the calibration, as the callback has checked it last."""
        calibration = self._driver.calibration
        is_calibrated = calibration == _CALIBRATION_OK if calibration else None
        return Readiness(self._name or "", is_calibrated=is_calibrated, hint=_INKWELL_HINT)

    def frame_s(self) -> float:
        """See `PointDevice.frame_s`."""
        return 1e-9 * float(self._driver.frame_ns)

    def position_m(self) -> tuple[float, float, float]:
        """Not for a device whose driver calls us."""
        raise DeviceError(_WHERE, "a call of position_m", "drive", "Its driver calls the renderer.")

    def put_force_n(self, x: float, y: float, z: float) -> None:
        """Not for a device whose driver calls us."""
        raise DeviceError(_WHERE, "a call of put_force_n", "drive", "Its driver calls the renderer.")

    def close(self) -> None:
        """Wait until the force is zero, then end the callback and release the device."""
        library, device, operation = self._library, self._device, self._operation
        frames, lock = self._frames, self._lock
        self._device = self._operation = self._frames = self._lock = None
        self._is_scheduling = False
        if device is None:
            return
        with suppress(Exception):
            if frames is not None:
                frames.end()
                _ENDED.append(frames)
            done = operation is None or self._end_callback()
            library.hdStopScheduler()
            if operation is not None and not done:
                library.hdUnschedule(operation)
                _LEAKED.append(self._driver)
        with suppress(Exception):
            library.hdDisableDevice(device)
        if lock is not None:
            lock.release()

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

    def _error(self, action: str) -> DeviceError | None:
        """Return the latest error on the driver's stack, which is cleared; None if there is none."""
        code = clear_errors(self._library)
        if not code:
            return None
        return DeviceError(_WHERE, f"that it could not {action} ({self._reason(code)})")

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


def serial_number(library: Any) -> str:
    """Return the serial number of the current device; "" if the library does not report it."""
    text = library.hdGetString(_SERIAL_NUMBER) if hasattr(library, "hdGetString") else None
    clear_errors(library)
    return (text or b"").decode("ascii", "replace").strip()[:64]


_SETTINGS_FOLDERS: Final = ("/usr/share/3DSystems/config", "C:/Users/Public/Documents/3DSystems")
"""Folders in which the maker's setup tool stores ``NAME.config``, beside ``$GTDD_HOME/config``."""


def unit_names() -> list[str]:
    """Return the names of devices in the driver's settings; empty if the settings are not found."""
    home = os.environ.get("GTDD_HOME")
    folders = [Path(home) / "config"] if home else [Path(folder) for folder in _SETTINGS_FOLDERS]
    return sorted({path.stem for folder in folders for path in folder.glob("*.config")})


def find_units(rest: str = "") -> list[Readiness]:
    """Return the state of each device in the driver's settings that is connected, or of the default device.

    Each is opened and closed, without forces; its calibration is read only while it is used. Raises
    `DeviceError` if the library cannot be loaded.
    """
    library, found = DRIVER.load(_FUNCTIONS, _OPTIONAL), []
    for name in [rest] if rest else unit_names() or [""]:
        device = library.hdInitDevice(name.encode() if name else None)
        if clear_errors(library) or device == _INVALID_HANDLE:
            continue
        serial = serial_number(library)
        library.hdDisableDevice(device)
        clear_errors(library)
        hint = f"Serial number {serial}." if serial else ""
        found.append(Readiness(name, is_connected=True, hint=hint))
    return found


def _opener(rest: str, trajectory: Trace | None) -> Opener:
    if not rest.isprintable() or len(rest.encode()) > 127:
        raise InvalidArgument(
            "device", f"'openhaptics:{rest[:40]}'", "the name of a device in its driver's settings"
        )
    return partial(OpenHaptics, rest or None)


KIND = DeviceKind(
    "openhaptics", "openhaptics[:NAME]", "Touch and Phantom, by OpenHaptics", "touch",
    _opener, DRIVER.checks, find_units=find_units,
)  # fmt: skip
