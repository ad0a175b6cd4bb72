"""Driver of the Haply Inverse3, a force-feedback arm, through the WebSocket of the vendor's Inverse Service.

The protocol is JSON of version 3, on port 10001. The service opens with a message that names the devices. It
reports a state only after a force was sent, so the loop alternates force and state, and the answers set the
rate. If the service reports more states than it should, all are read and the latest is used, so that no delay
builds up.

A VerseGrip, with or without a cable, reports its orientation and its buttons; it has no motors, so a torque
is ignored. That its quaternion is in the axes of the Inverse3 is unverified. If a grip stops reporting
(battery, radio), its orientation is NaN, and the renderer releases the force.

A unit is named by its ``device_id``. Its state is the object ``status`` that the maker's documentation shows
in the first message (calibrated, power_supply, ready, started, in_use) and that comes with every state. That
``in_use`` concerns the sessions of other programs is unverified: it is read before the first command only.

Handedness and gravity compensation are settings of the device, which the service stores. The first message
states them; they are set by HTTP at the port of the WebSocket (``/inverse3/ID/config/...``, of version 3.5
and later), as the maker's page on device configuration says. The body of the one for handedness is
unverified; therefore the first message of a new connection must state the new values.

Metres and newtons are in the device's own axes. Messages of the service are untrusted: their size is bounded,
and a message that is late, not JSON, incomplete or implausible raises `DeviceError`.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from contextlib import closing, suppress
from dataclasses import replace
from functools import partial
from http.client import HTTPConnection, HTTPException
from typing import TYPE_CHECKING, Any, ClassVar, Final
from urllib.parse import quote

from touchfield.devices.drivers.links import service_check, web_socket
from touchfield.devices.drivers.registry import (
    Check,
    DeviceKind,
    DeviceSetting,
    Opener,
    library_check,
    on_or_off,
    positive_number,
)
from touchfield.devices.drivers.unit_lock import UnitLock
from touchfield.errors import DeviceAbsent, DeviceError, InvalidArgument, import_extra, reason
from touchfield.options import Address, address
from touchfield.render.point_device import PointDevice, Quaternion
from touchfield.render.readiness import Readiness

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection

    from touchfield.medium.trace import Trace


SERVICE: Final[Address] = ("127.0.0.1", 10001)
_QUEUE: Final = 256
"""Messages that may wait to be read; more wait in the sender."""

_OPEN_S: Final = 3.0
_CLOSE_S: Final = 0.5
_MAX_DISTANCE_M: Final = 2.0
"""From the device's origin; the arm is half a metre long."""

_IDENTITY: Final = (1.0, 0.0, 0.0, 0.0)
_NO_ORIENTATION: Final = (math.nan,) * 4

_TITLE: Final = "Haply Inverse3"
_MAX_ID: Final = 64
_MAX_FACTOR: Final = 2.0
_SETTINGS_HINT: Final = "Set it in the service's own program; by HTTP it takes it from version 3.5 on."
_START_HINT: Final = "Start the Haply Inverse Service, or give its address: --device haply:HOST:PORT"


class Haply(PointDevice):
    """An Inverse3.

    Parameters
    ----------
    service : (str, int)
        Host and port.
    answer_s : float
        Time limit for a state, seconds; after it the device counts as gone.
    unit : str or None
        Its ``device_id``; None is the first that the service lists.
    settings : mapping
        Entries of the device's ``config`` to set, such as ``{"handedness": "left"}``.
    """

    title: ClassVar[str] = _TITLE
    is_paced: ClassVar[bool] = True

    def __init__(
        self,
        service: Address = SERVICE,
        answer_s: float = 0.25,
        unit: str | None = None,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        self._service, self._answer_s, self._unit = service, answer_s, unit
        self._settings = dict(settings or {})
        self._is_named = unit is not None
        self._entry: dict[str, Any] = {}
        self._lock: UnitLock | None = None
        self._state = Readiness()
        self._has_commanded = False
        self._where = f"Haply Inverse Service at {service[0]}:{service[1]}"
        self._socket: ClientConnection | None = None
        self._id: str | int = ""
        self._command = ""
        self._pending_states = 0  # one for each force that was sent
        self._orientation: Quaternion = _IDENTITY
        self._pressed, self._has_grip = 0, False

    def load(self) -> None:
        """See `PointDevice.load`."""
        import_extra("websockets.sync.client", self._where, "websockets", "devices")

    def open(self) -> None:
        """Connect, read the device's id, and send a force of zero to get the first state.

        A device that another program uses gets no command.
        """
        self.close()
        try:
            entry = self._connect()
            self._id = entry["device_id"]
            assert self._socket is not None
            host, port, *_ = self._socket.remote_address
            self._lock = UnitLock(_TITLE, f"{host}:{port}/{self._id}", self._lock_hint)
            self._state = readiness_of(entry)
            if self._state.is_free is not False:
                entry = self._configured(entry)
            self._entry = entry
            self._pending_states, self._has_grip, self._has_commanded = 0, False, False
            command = {"device_id": self._id, "commands": {"set_cursor_force": {"values": "@"}}}
            self._command = json.dumps({"inverse3": [command]}).replace('"@"', '{"x":%r,"y":%r,"z":%r}')
            if self._state.is_free is not False:
                self.put_force_n(0.0, 0.0, 0.0)
        except BaseException:
            self._command = ""
            self.close()
            raise

    def _connect(self) -> dict[str, Any]:
        """Connect, and return the entry of the device in the first message."""
        self._socket = web_socket(
            self._service, "", self._where, _START_HINT, _OPEN_S, self._answer_s,
            close_timeout=_CLOSE_S, ping_interval=None, max_queue=_QUEUE,
        )  # fmt: skip
        return self._selected(self._message(_OPEN_S))

    def _configured(self, entry: dict[str, Any]) -> dict[str, Any]:
        """Make the settings that the device does not have yet; returns its entry after that.

        Raises `DeviceError` if the service does not take one.
        """
        different = different_settings(entry, self._settings)
        if not different:
            return entry
        for name, value in different.items():
            path = f"/inverse3/{quote(str(self._id), safe='')}/config/{name}"
            post(self._service, path, value if isinstance(value, dict) else {name: value}, self._where)
        assert self._socket is not None
        self._socket.close()
        entry = self._connect()
        if entry["device_id"] != self._id:
            raise DeviceError(self._where, f"no device {self._id} any more", "the same one")
        for name, value in different_settings(entry, self._settings).items():
            found = f"that {self._id} did not take {name} = {json.dumps(value)}"
            raise DeviceError(self._where, found, hint=_SETTINGS_HINT)
        return entry

    @property
    def unit(self) -> str:
        """See `PointDevice.unit`: the id, unless it was given."""
        return "" if self._is_named else str(self._id)

    def use_unit(self, unit: str) -> None:
        """See `PointDevice.use_unit`."""
        self._unit = unit

    def state(self) -> Readiness:
        """See `PointDevice.state`: that of the latest message."""
        return replace(readiness_of(self._entry), is_free=None)

    def readiness(self) -> Readiness:
        """See `PointDevice.readiness`; a force of zero is sent to get a state."""
        if self._state.is_free is False:  # a command might take the device from the other program
            self.open()
            return self._state
        self._state = replace(readiness_of(self._device(self._latest_message())), is_free=self._state.is_free)
        self.put_force_n(0.0, 0.0, 0.0)
        return self._state

    def position_m(self) -> tuple[float, float, float]:
        """Position of the latest state; waits for a state."""
        message = self._latest_message()
        self._entry = self._device(message)
        state = self._entry.get("state")
        cursor = state.get("cursor_position") if isinstance(state, dict) else None
        if not isinstance(cursor, dict):
            raise DeviceError(
                self._where, "a state without cursor_position", "state.cursor_position of x, y, z"
            )
        position: tuple[Any, ...] = tuple(cursor.get(axis) for axis in "xyz")
        for axis, value in zip("xyz", position, strict=True):
            # compared, not converted: an int from JSON may have any number of digits
            is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if not is_number or not abs(value) <= _MAX_DISTANCE_M:
                found = f"{axis} = {repr(value)[:40]}"
                raise DeviceError(self._where, found, f"metres, at most {_MAX_DISTANCE_M:g} from the origin")
        self._read_grip(message)
        x, y, z = map(float, position)
        return x, y, z

    def orientation(self) -> Quaternion:
        """Orientation of the grip in the latest state; the identity without a grip."""
        return self._orientation

    def buttons(self) -> int:
        """Buttons a, b, c of the grip, as bits 0 to 2; for a grip with one button, bit 0."""
        return self._pressed

    def put_force_n(self, x: float, y: float, z: float) -> None:
        """Send a force; the next `position_m` reads the answer."""
        if not math.isfinite(x + y + z):
            raise DeviceError(self._where, f"a force of {x:g}, {y:g}, {z:g} N", "finite newtons")
        if self._socket is None:
            raise DeviceError(self._where, "a device that is not open", "an open one")
        try:
            self._socket.send(self._command % (float(x), float(y), float(z)))
        except Exception as error:  # closed, broken, or nobody reads what is sent
            raise self._connection_error(error) from error
        self._pending_states += 1
        self._has_commanded = True

    def close(self) -> None:
        """Send a force of zero, wait for its answer as confirmation, and disconnect."""
        if self._command and self._has_commanded:
            deadline = time.monotonic() + self._answer_s
            with suppress(Exception):
                self.put_force_n(0.0, 0.0, 0.0)
                while self._pending_states > 0:
                    self._receive(max(0.0, deadline - time.monotonic()))
        socket, self._socket, self._command = self._socket, None, ""
        if socket is not None:
            with suppress(Exception):
                socket.close()
        lock, self._lock = self._lock, None
        if lock is not None:
            lock.release()

    @property
    def _lock_hint(self) -> str:
        host, port = self._service
        return f"Name another unit: --device haply:{host}:{port}/ID (touchfield devices --connected)"

    def _latest_message(self) -> Any:
        """Wait for a message, and return the latest of those that have arrived."""
        message = self._message(self._answer_s)
        with suppress(TimeoutError):
            for _ in range(_QUEUE):
                message = self._receive(0.0)
        return message

    def _message(self, seconds: float) -> Any:
        try:
            return self._receive(seconds)
        except TimeoutError:
            found = f"no answer within {seconds:g} s"
            raise DeviceError(
                self._where, found, "a message", "Is the device plugged in and calibrated?"
            ) from None

    def _receive(self, seconds: float) -> Any:
        """Return the next message, parsed from JSON.

        Raises TimeoutError if there is none.
        """
        if self._socket is None:
            raise DeviceError(self._where, "a device that is not open", "an open one")
        try:
            text = self._socket.recv(timeout=seconds)
        except TimeoutError:
            raise
        except Exception as error:
            raise self._connection_error(error) from error
        self._pending_states -= 1
        try:
            return json.loads(text)
        except (ValueError, RecursionError) as error:
            raise DeviceError(self._where, f"no JSON ({reason(error)})", "a message of version 3") from error

    def _read_grip(self, message: Any) -> None:
        """Read orientation and buttons of the first grip in a message."""
        grips = message.get("wireless_verse_grip") or message.get("verse_grip") or ()
        if not grips:
            self._orientation, self._pressed = (_NO_ORIENTATION if self._has_grip else _IDENTITY), 0
            return
        state = grips[0].get("state") if isinstance(grips, list) and isinstance(grips[0], dict) else None
        quaternion = state.get("orientation") if isinstance(state, dict) else None
        if not isinstance(state, dict) or not isinstance(quaternion, dict):
            raise DeviceError(self._where, "a grip without orientation", "state.orientation of w, x, y, z")
        parts: list[Any] = [quaternion.get(axis) for axis in "wxyz"]
        if not all(isinstance(v, (int, float)) and not isinstance(v, bool) and abs(v) <= 1.1 for v in parts):
            raise DeviceError(self._where, f"orientation {repr(parts)[:60]}", "a unit quaternion")
        w, x, y, z = map(float, parts)
        self._orientation, self._has_grip = (w, x, y, z), True
        pressed = state.get("buttons")
        names = pressed if isinstance(pressed, dict) else {"a": state.get("button")}
        self._pressed = sum(1 << n for n, name in enumerate("abc") if names.get(name) is True)

    def _selected(self, message: Any) -> dict[str, Any]:
        """Return the entry of the named device in the first message, or of the first device."""
        entries = entries_of(message, self._where)
        for entry in entries:
            if self._unit in (None, str(entry["device_id"])):
                return entry
        names = ", ".join(str(entry["device_id"]) for entry in entries)
        if self._unit is not None and entries:
            raise DeviceAbsent(self._where, f"the devices {names[:200]}", f"one with the id {self._unit}")
        raise DeviceAbsent(self._where, "no Inverse3", "one", "Plug it in, and check the service's own page.")

    def _device(self, message: Any) -> dict[str, Any]:
        devices = message.get("inverse3") if isinstance(message, dict) else None
        for entry in devices if isinstance(devices, list) else ():
            if isinstance(entry, dict) and entry.get("device_id") == self._id:
                return entry
        raise DeviceError(
            self._where, f"a message without device {self._id}", "its state", "Is it still plugged in?"
        )

    def _connection_error(self, error: Exception) -> DeviceError:
        return DeviceError(
            self._where, f"a connection that broke ({reason(error)})", "an open one", _START_HINT
        )


def entries_of(message: Any, where: str) -> list[dict[str, Any]]:
    """Return the entries of all devices in the first message; raises `DeviceError` if one has no valid id."""
    entries = message.get("inverse3") if isinstance(message, dict) else None
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise DeviceError(where, "a first message without inverse3", "a list of devices", _START_HINT)
    for entry in entries:
        name = entry.get("device_id")
        is_name = isinstance(name, (str, int)) and not isinstance(name, bool)
        if not is_name or len(str(name)) > _MAX_ID or "%" in str(name):
            raise DeviceError(where, f"device_id {repr(name)[:40]}", "a short name")
    return entries


def readiness_of(entry: dict[str, Any]) -> Readiness:
    """Return the state of a device from its entry in a message; what it does not report is None."""
    status = entry.get("status")
    status = status if isinstance(status, dict) else {}
    is_powered, is_calibrated, is_ready, is_started, is_in_use = (
        status.get(name) if isinstance(status.get(name), bool) else None
        for name in ("power_supply", "calibrated", "ready", "started", "in_use")
    )
    is_running = False if False in (is_ready, is_started) else is_started
    hint = ""
    if is_running is False:
        hint = "Wait for the service, or restart it."
    if is_in_use:
        hint = "End the other program."
    if is_calibrated is False:
        hint = "Calibrate it: see the service's own page."
    if is_powered is False:
        hint = "Plug in its power supply."
    is_free = None if is_in_use is None else not is_in_use
    unit, settings = str(entry["device_id"]), settings_of(entry)
    return Readiness(unit, True, is_powered, is_calibrated, is_running, is_free, hint=hint, settings=settings)


def config_of(entry: dict[str, Any]) -> dict[str, Any]:
    """Return the settings in the entry of a device; empty if it has none."""
    config = entry.get("config")
    return config if isinstance(config, dict) else {}


def settings_of(entry: dict[str, Any]) -> tuple[str, ...]:
    """Return handedness and gravity compensation of a device as texts, as far as it reports them."""
    config, settings = config_of(entry), []
    handedness, gravity = config.get("handedness"), config.get("gravity_compensation")
    if handedness in ("left", "right"):
        settings.append(f"{handedness}-handed")
    if isinstance(gravity, dict) and isinstance(gravity.get("enabled"), bool):
        factor = gravity.get("scaling_factor")
        is_scaled = gravity["enabled"] and isinstance(factor, (int, float)) and factor != 1
        text = "on" if gravity["enabled"] else "off"
        settings.append(f"gravity compensation {text}{f', factor {factor:g}' if is_scaled else ''}")
    return tuple(settings)


def different_settings(entry: dict[str, Any], wanted: Mapping[str, Any]) -> dict[str, Any]:
    """Return those of the wanted settings that the entry of a device does not state."""
    config = config_of(entry)

    def has(name: str) -> bool:
        value, found = wanted[name], config.get(name)
        if isinstance(value, dict):
            return isinstance(found, dict) and all(found.get(key) == part for key, part in value.items())
        return bool(found == value)

    return {name: value for name, value in wanted.items() if not has(name)}


def post(service: Address, path: str, content: dict[str, Any], where: str) -> None:
    """Send a setting to the service by HTTP; raises `DeviceError` if it does not accept it."""
    body, headers = json.dumps(content), {"Content-Type": "application/json"}
    try:
        with closing(HTTPConnection(*service, timeout=_OPEN_S)) as connection:
            connection.request("POST", path, body, headers)
            status = connection.getresponse().status
    except (OSError, HTTPException) as error:
        found = f"that it did not take a setting ({reason(error)})"
        raise DeviceError(where, found, hint=_SETTINGS_HINT) from error
    if not 200 <= status < 300:
        raise DeviceError(where, f"status {status} for {path}", "a setting that it takes", _SETTINGS_HINT)


def checks() -> list[Check]:
    """Check the library, and whether the service listens at its default address."""
    return [library_check("websockets", "devices"), service_check("Inverse Service", SERVICE, _START_HINT)]


def _parts_of(rest: str) -> tuple[Address, str | None]:
    """Return the address of the service and the id of the unit, None if there is none, from HOST:PORT/ID."""
    text, slash, unit = rest.partition("/")
    form = "haply:HOST:PORT/ID"
    if slash and not (unit and unit.isprintable() and len(unit) <= _MAX_ID):
        raise InvalidArgument("device", f"'haply:{rest[:80]}'", form)
    return address(text, form, SERVICE), unit or None


def find_units(rest: str = "") -> list[Readiness]:
    """Return the state of each unit that the service lists, without a command.

    Raises `DeviceError` if the service does not answer, `MissingExtra` without the library.
    """
    service, unit = _parts_of(rest)
    where = f"Haply Inverse Service at {service[0]}:{service[1]}"
    line = web_socket(service, "", where, _START_HINT, _OPEN_S, _OPEN_S, close_timeout=_CLOSE_S)
    try:
        message = json.loads(line.recv(timeout=_OPEN_S))
    except Exception as error:  # closed, silent, or no JSON
        raise DeviceError(where, f"no first message ({reason(error)})", hint=_START_HINT) from error
    finally:
        line.close()
    return [
        readiness_of(entry) for entry in entries_of(message, where) if unit in (None, str(entry["device_id"]))
    ]


def _opener(rest: str, trajectory: Trace | None) -> Opener:
    service, unit = _parts_of(rest)
    return partial(Haply, service, unit=unit)


_SETTINGS: Final = (
    DeviceSetting("gravity", "on|off|FACTOR", "compensation of the weight of the arm; the service stores it"),
    DeviceSetting("handedness", "left|right", "side of the arm; the service stores it"),
)


def _configure(opener: Opener, values: Mapping[str, str]) -> Opener:
    config: dict[str, Any] = {}
    gravity, handedness = values.get("gravity"), values.get("handedness")
    if gravity is not None and gravity[:1].isdigit():
        factor = positive_number("gravity", gravity, _MAX_FACTOR)
        config["gravity_compensation"] = {"enabled": True, "scaling_factor": factor}
    elif gravity is not None:
        config["gravity_compensation"] = {"enabled": on_or_off("gravity", gravity), "scaling_factor": 1.0}
    if handedness not in (None, "left", "right"):
        raise InvalidArgument("--settings handedness", repr(handedness), "left or right")
    if handedness is not None:
        config["handedness"] = handedness
    options: dict[str, Any] = {"settings": config}
    return partial(opener, **options)


KIND = DeviceKind(
    "haply", "haply[:HOST:PORT][/ID]", "Haply Inverse3, by its service", "haply-inverse3",
    _opener, checks, find_units=find_units, settings=_SETTINGS, configure=_configure,
)  # fmt: skip
