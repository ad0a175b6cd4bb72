"""Driver for any array of actuators whose program listens to Open Sound Control (OSC): sends each frame of
drives over UDP.

A frame is one bundle, or several if it is large. Each bundle is one datagram of at most 8 kB and starts with
the first of these messages::

    /touchfield/frame              i number   d seconds   i part   i parts   i panels   i rows   i columns
                                   i timeout in milliseconds
    /touchfield/drives/PANEL       i first    f drive ... 0 to 1
    /touchfield/frequencies/PANEL  i first    f hertz ... 0 without vibration; only if the medium has any

``number`` counts frames from 0, and ``seconds`` is their time since the device was opened. PANEL is front,
back, or the panel's number from 2; ``first`` is the index of the message's first drive in its panel, counted
row after row from the top left. All parts of a frame have the same number. A drive is rounded to the
profile's levels, if it states any.

**The receiver switches all actuators off if no complete frame arrives for the timeout of the latest one**, so
that a program that was killed or has stopped leaves none on. At least every 100 ms a frame is sent, if need
be the latest one again with a new number. UDP may lose a datagram, so the frame that switches all actuators
off is sent three times. ``integrations/osc_array.py`` is a receiver of this protocol. The address scheme
is specific to touchfield; there is no common one for arrays of actuators. The bytes are assembled here: a
library that checks each number separately took 100 ms for the 6240 pins of a HyperBraille, this code 0.7 ms.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from contextlib import suppress
from time import monotonic
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np

from touchfield.arrays import Float32s, Float64s
from touchfield.devices.drivers.registry import Check, DeviceKind, drives_of, steps_of
from touchfield.errors import DeviceError, reason
from touchfield.options import Address, address
from touchfield.render.array_player import ArrayDevice

if TYPE_CHECKING:
    from touchfield.devices import Device


MAX_BYTES: Final = 8192
"""Size limit of a datagram, which then needs only a few fragments on any network."""

_HEAD_BYTES: Final = 128  # limit for the head of a bundle and its frame message
_FLOATS_PER_MESSAGE: Final = (
    MAX_BYTES - 2 * _HEAD_BYTES
) // 5  # a float is four bytes and one letter of the type
_PANELS: Final = ("front", "back")
_LAST_FRAME_COPIES: Final = 3
REST_S: Final = 0.5
"""Time without a complete frame after which the receiver switches its actuators off."""
_BUNDLE_HEAD: Final = b"#bundle\0" + struct.pack(">Q", 1)
"""Head of a bundle that is to be shown at once (OSC 1.0)."""


class Osc(ArrayDevice):
    """Any array behind a program or device that listens to Open Sound Control."""

    keep_alive_s: ClassVar[float] = 0.2 * REST_S

    def __init__(self, profile: Device, to: Address) -> None:
        self.profile, self._to = profile, to
        self._where = f"osc:{to[0]}:{to[1]}"
        self._number, self._start_s = 0, 0.0
        self._shown: tuple[Float64s, Float32s | None] | None = None

    def open(self) -> None:
        """See `ArrayDevice`; UDP does not show whether anything listens on another machine."""
        try:
            family, kind, protocol, _, to = socket.getaddrinfo(*self._to, type=socket.SOCK_DGRAM)[0]
            line = socket.socket(family, kind, protocol)
        except (OSError, UnicodeError) as error:
            raise DeviceError(
                self._where, f"no such host ({reason(error)})", "a host that can be reached"
            ) from error
        try:
            line.connect(to)
        except OSError as error:
            line.close()
            raise DeviceError(
                self._where, f"no way there ({reason(error)})", "a host that can be reached"
            ) from error
        line.settimeout(1.0)
        self._line, self._number, self._start_s, self._shown = line, 0, monotonic(), None

    def put_drives(self, drives: Float32s, frequencies_hz: Float32s | None, seconds: float) -> None:
        """See `ArrayDevice`."""
        levels = self.profile.levels
        if levels is None:
            values = drives_of(self.profile, drives)
        else:
            values = steps_of(self.profile, drives, levels) / max(levels - 1, 1)
        self._shown = values, frequencies_hz
        self.keep_alive()

    def keep_alive(self) -> None:
        """See `ArrayDevice`: send the latest frame, with a new number."""
        if self._line is None:
            raise DeviceError(self._where, "no connection", "one that was opened")
        if self._shown is None:
            return
        try:
            for datagram in self._datagrams(*self._shown):
                self._line.send(datagram)
        except OSError as error:
            hint = "Start what listens there first"
            raise DeviceError(self._where, f"that nothing listens ({reason(error)})", hint=hint) from error
        self._number += 1

    def _put_off(self, off: Float32s) -> None:
        for datagram in _LAST_FRAME_COPIES * list(self._datagrams(off.astype(np.float64), None)):
            with suppress(OSError):
                self._line.send(datagram)

    def _datagrams(self, drives: Float64s, frequencies_hz: Float32s | None) -> Iterator[bytes]:
        """Yield the bundles of one frame."""
        values = {"drives": drives}
        if frequencies_hz is not None:
            values["frequencies"] = np.asarray(frequencies_hz, np.float64)
        bodies = [b""]
        for quantity, array in values.items():
            for index, panel in enumerate(array.reshape(len(array), -1)):
                name = f"/touchfield/{quantity}/{_PANELS[index] if index < len(_PANELS) else index}"
                for first in range(0, len(panel), _FLOATS_PER_MESSAGE):
                    flat = panel[first : first + _FLOATS_PER_MESSAGE]
                    numbers = struct.pack(">i", first) + flat.astype(">f4").tobytes()
                    message = _message(name, "i" + "f" * len(flat), numbers)
                    if len(bodies[-1]) + len(message) > MAX_BYTES - _HEAD_BYTES:
                        bodies.append(b"")
                    bodies[-1] += message
        number, seconds = self._number & 0x7FFFFFFF, monotonic() - self._start_s
        timeout_ms = round(1000 * REST_S)
        for part, body in enumerate(bodies):
            head = struct.pack(">idiiiiii", number, seconds, part, len(bodies), *drives.shape, timeout_ms)
            yield _BUNDLE_HEAD + _message("/touchfield/frame", "idiiiiii", head) + body


def _message(name: str, types: str, values: bytes) -> bytes:
    """Return a message preceded by its length, as in a bundle."""
    message = _text(name) + _text("," + types) + values
    return struct.pack(">i", len(message)) + message


def _text(text: str) -> bytes:
    """Return text with a final zero, padded with zeros to a multiple of four bytes."""
    data = text.encode("ascii")
    return data + bytes(4 - len(data) % 4)


def _make(text: str, profile: Device) -> ArrayDevice:
    return Osc(profile, address(text, "osc:HOST:PORT"))


KIND = DeviceKind(
    "osc", "osc:HOST:PORT", "any array of actuators, by Open Sound Control (UDP)", "tactile-vest-8x8",
    _make, lambda: [Check("Open Sound Control", True, "built in")], takes_any=True, is_array=True,
)  # fmt: skip
