"""Haply Inverse3 over the WebSocket of the maker's Inverse Service (JSON of version 3, port 10001).

The service opens with a message that names the devices. It tells a state only after a force was sent, so the
loop is a conversation: force, state, force, state; the answer sets the rhythm. A service that tells more
states than it was asked for is read to its latest one, so that no delay grows.

A VerseGrip, with or without a cable, tells how it is turned and which buttons are pressed; it has no motors,
so that a torque is left out. That its quaternion is one of the Inverse3's axes is unverified. A grip that is
told no more (its battery, its radio) tells an orientation that is no number, and the renderer lets go.

Metres and newtons in the device's own axes. What comes from the service comes from a stranger: a message is
bounded, and one that is late, no JSON, without its keys or without sense is one `DeviceError`.
"""

from __future__ import annotations

import json
import math
import time
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Final

from touchfield.devices.drivers.links import service_check, web_socket
from touchfield.devices.drivers.registry import Check, DeviceKind, Opener, library_check
from touchfield.errors import DeviceError, reason
from touchfield.options import Address, address
from touchfield.render.point_device import PointDevice, Quaternion

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection

    from touchfield.medium.trace import Trace


SERVICE: Final[Address] = ("127.0.0.1", 10001)
_QUEUE: Final = 256
"""Messages that may wait to be read; the rest waits in the sender."""

_OPEN_S: Final = 3.0
_CLOSE_S: Final = 0.5
_FARTHEST_M: Final = 2.0
"""From the device's origin; its arm is half a metre long."""

_UNTURNED: Final = (1.0, 0.0, 0.0, 0.0)
_LOST: Final = (math.nan,) * 4

_START: Final = "Start the Haply Inverse Service, or name its place: --device haply:HOST:PORT"


class Haply(PointDevice):
    """An Inverse3; the first that the service names.

    Parameters
    ----------
    service : (str, int)
        Host and port.
    answer_s : float
        How long a state may take, seconds; after it the device counts as gone.
    """

    is_paced: ClassVar[bool] = True

    def __init__(self, service: Address = SERVICE, answer_s: float = 0.25) -> None:
        self._service, self._answer_s = service, answer_s
        self._where = f"Haply Inverse Service at {service[0]}:{service[1]}"
        self._socket: ClientConnection | None = None
        self._id: str | int = ""
        self._command = ""
        self._owed = 0  # states: one for each force that was sent
        self._turn: Quaternion = _UNTURNED
        self._pressed, self._has_grip = 0, False

    def open(self) -> None:
        """Connect, learn the device's name, and send a force of zero, so that it tells where it is."""
        self.close()
        self._socket = web_socket(
            self._service, "", self._where, _START, _OPEN_S, self._answer_s,
            close_timeout=_CLOSE_S, ping_interval=None, max_queue=_QUEUE,
        )  # fmt: skip
        try:
            self._id = self._named(self._message(_OPEN_S))
            self._owed, self._has_grip = 0, False
            command = {"device_id": self._id, "commands": {"set_cursor_force": {"values": "@"}}}
            self._command = json.dumps({"inverse3": [command]}).replace('"@"', '{"x":%r,"y":%r,"z":%r}')
            self.put_force_n(0.0, 0.0, 0.0)
        except BaseException:
            self._command = ""
            self.close()
            raise

    def position_m(self) -> tuple[float, float, float]:
        """The latest state; waits for one."""
        message = self._message(self._answer_s)
        with suppress(TimeoutError):
            for _ in range(_QUEUE):
                message = self._received(0.0)
        state = self._device(message).get("state")
        cursor = state.get("cursor_position") if isinstance(state, dict) else None
        if not isinstance(cursor, dict):
            raise DeviceError(
                self._where, "a state without cursor_position", "state.cursor_position of x, y, z"
            )
        place: tuple[Any, ...] = tuple(cursor.get(axis) for axis in "xyz")
        for axis, value in zip("xyz", place, strict=True):
            # an int from JSON may have any number of digits: it is compared, not converted
            if (
                isinstance(value, bool)
                or not isinstance(value, (int, float))
                or not abs(value) <= _FARTHEST_M
            ):
                found = f"{axis} = {repr(value)[:40]}"
                raise DeviceError(self._where, found, f"metres, at most {_FARTHEST_M:g} from the origin")
        self._take_grip(message)
        x, y, z = map(float, place)
        return x, y, z

    def orientation(self) -> Quaternion:
        """How the grip was turned in the latest state; without one, not at all."""
        return self._turn

    def buttons(self) -> int:
        """The grip's buttons a, b, c, as bits 0 to 2; of a grip with one, bit 0."""
        return self._pressed

    def put_force_n(self, x: float, y: float, z: float) -> None:
        """Send a force; the answer is read by the next `position_m`."""
        if not math.isfinite(x + y + z):
            raise DeviceError(self._where, f"a force of {x:g}, {y:g}, {z:g} N", "finite newtons")
        if self._socket is None:
            raise DeviceError(self._where, "a device that is not open", "an open one")
        try:
            self._socket.send(self._command % (float(x), float(y), float(z)))
        except Exception as error:  # closed, broken, or nobody reads what is sent
            raise self._gone(error) from error
        self._owed += 1

    def close(self) -> None:
        """Send a force of zero, wait for its answer, as a sign that it arrived, and hang up."""
        if self._command:
            end = time.monotonic() + self._answer_s
            with suppress(Exception):
                self.put_force_n(0.0, 0.0, 0.0)
                while self._owed > 0:
                    self._received(max(0.0, end - time.monotonic()))
        line, self._socket, self._command = self._socket, None, ""
        if line is not None:
            with suppress(Exception):
                line.close()

    def _message(self, seconds: float) -> Any:
        try:
            return self._received(seconds)
        except TimeoutError:
            found = f"no answer within {seconds:g} s"
            raise DeviceError(
                self._where, found, "a message", "Is the device plugged in and calibrated?"
            ) from None

    def _received(self, seconds: float) -> Any:
        """The next message, as JSON; TimeoutError if there is none."""
        if self._socket is None:
            raise DeviceError(self._where, "a device that is not open", "an open one")
        try:
            text = self._socket.recv(timeout=seconds)
        except TimeoutError:
            raise
        except Exception as error:
            raise self._gone(error) from error
        self._owed -= 1
        try:
            return json.loads(text)
        except (ValueError, RecursionError) as error:
            raise DeviceError(self._where, f"no JSON ({reason(error)})", "a message of version 3") from error

    def _take_grip(self, message: Any) -> None:
        """Orientation and buttons of the first grip of a message."""
        grips = message.get("wireless_verse_grip") or message.get("verse_grip") or ()
        if not grips:
            self._turn, self._pressed = (_LOST if self._has_grip else _UNTURNED), 0
            return
        state = grips[0].get("state") if isinstance(grips, list) and isinstance(grips[0], dict) else None
        turn = state.get("orientation") if isinstance(state, dict) else None
        if not isinstance(state, dict) or not isinstance(turn, dict):
            raise DeviceError(self._where, "a grip without orientation", "state.orientation of w, x, y, z")
        parts: list[Any] = [turn.get(axis) for axis in "wxyz"]
        if not all(isinstance(v, (int, float)) and not isinstance(v, bool) and abs(v) <= 1.1 for v in parts):
            raise DeviceError(self._where, f"orientation {repr(parts)[:60]}", "a unit quaternion")
        w, x, y, z = map(float, parts)
        self._turn, self._has_grip = (w, x, y, z), True
        pressed = state.get("buttons")
        names = pressed if isinstance(pressed, dict) else {"a": state.get("button")}
        self._pressed = sum(1 << n for n, name in enumerate("abc") if names.get(name) is True)

    def _named(self, message: Any) -> str | int:
        """The name of the first device, from the first message."""
        devices = message.get("inverse3") if isinstance(message, dict) else None
        if not isinstance(devices, list) or not all(isinstance(one, dict) for one in devices):
            raise DeviceError(self._where, "a first message without inverse3", "a list of devices", _START)
        if not devices:
            mend = "Plug it in, and look into the service's own page."
            raise DeviceError(self._where, "no Inverse3", "one", mend)
        name = devices[0].get("device_id")
        if (
            isinstance(name, bool)
            or not isinstance(name, (str, int))
            or len(str(name)) > 64
            or "%" in str(name)
        ):
            raise DeviceError(self._where, f"device_id {repr(name)[:40]}", "a short name")
        return name

    def _device(self, message: Any) -> dict[str, Any]:
        devices = message.get("inverse3") if isinstance(message, dict) else None
        for one in devices if isinstance(devices, list) else ():
            if isinstance(one, dict) and one.get("device_id") == self._id:
                return one
        raise DeviceError(
            self._where, f"a message without device {self._id}", "its state", "Is it still plugged in?"
        )

    def _gone(self, error: Exception) -> DeviceError:
        return DeviceError(self._where, f"a connection that broke ({reason(error)})", "an open one", _START)


def checks() -> list[Check]:
    """The library, and the service at its usual place."""
    return [library_check("websockets", "devices"), service_check("Inverse Service", SERVICE, _START)]


def _opener(rest: str, trajectory: Trace | None) -> Opener:
    return partial(Haply, address(rest, "haply:HOST:PORT", SERVICE))


KIND = DeviceKind(
    "haply", "haply[:HOST:PORT]", "Haply Inverse3, by its service", "haply-inverse3", _opener, checks
)
