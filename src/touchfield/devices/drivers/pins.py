"""Driver of pin displays (Dot Pad, Graphiti, HyperBraille): sends the height of each pin as a line of text,
over a serial port or TCP.

The vendors' own protocols differ and are mostly not public. This simple protocol is meant for a small program
or board between touchfield and the display. A line is ASCII, ends in a line feed, and has a checksum of
everything before the blank and star::

    line     size ROWS COLUMNS LEVELS TIMEOUT *CRC   first, and again if there is no answer; its number is 0
    line     pins NUMBER HEIGHTS *CRC                NUMBER from 1
    line     keep NUMBER *CRC                        the pins stay; NUMBER goes on
    line     keys NUMBER *CRC                        while a map is shown: which keys were pressed?
    answer   ok NUMBER                               it is shown; sent after every line
    answer   ok NUMBER KEY KEY ...                   to keys: those since the last such line, the oldest first
    answer   rest NUMBER                             to keep: the pins are at rest, after the time-out
    answer   err TEXT                                it is not

``HEIGHTS`` is a digit for each pin, row after row from the top left: 0 (down) to LEVELS - 1 (up), 0 to 9 and
then a to z, so that there are at most 36 levels. ``CRC`` is CRC-16/CCITT-FALSE (polynomial 1021, initial
value ffff) as four hexadecimal digits. For 2 x 2 pins that are up or down::

    size 2 2 2 1000 *f687
    pins 1 0110 *204a
    keep 2 *8549

The next line is sent after the previous one was answered; a second ``ok 0`` is ignored. A frame that changes
no pin is not sent.

``KEY`` is left, right, up, down, in, out, home or legend, for maps (docs/how-to/map.md). A display without
keys may answer ``err``: it is not asked again.

**The display lowers all pins if, after an answer, no byte arrives for TIMEOUT milliseconds, and when the
connection is closed.** So a program that was killed, has stopped or lost its cable leaves no pin up. While
pins stay as they are, `keep` is sent every 300 ms. After the answer ``rest``, as when the program was stopped
for a while, the heights are sent again. `close` lowers all pins. ``integrations/pin_display.py`` is a display
of this protocol.
"""

from __future__ import annotations

import binascii
from time import monotonic
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np

from touchfield.arrays import Float32s, Int64s
from touchfield.devices.drivers.links import Line, SerialLine, serial_ports
from touchfield.devices.drivers.registry import Check, DeviceKind, library_check, steps_of
from touchfield.errors import DeviceError, InvalidArgument
from touchfield.options import address
from touchfield.render.array_player import ArrayDevice

if TYPE_CHECKING:
    from collections.abc import Callable

    from touchfield.devices import Device


DIGITS: Final = b"0123456789abcdefghijklmnopqrstuvwxyz"
MAX_ANSWER_BYTES: Final = 256
TIMEOUT_S: Final = 2.0
REST_S: Final = 1.0
"""Time without a byte after which the display lowers its pins; part of its first line."""
KEYS: Final = frozenset({"left", "right", "up", "down", "in", "out", "home", "legend"})
_KEYS_EVERY_S: Final = 0.05
_CLOSE_TIMEOUT_S: Final = 0.5
_HINT: Final = "Check that it is on, that the port is the right one, and that it speaks this protocol"
_FORM: Final = "pins:PORT[@BAUD] | pins:HOST:PORT"


def checked_line(content: bytes) -> bytes:
    """Return a line with its checksum."""
    return b"%s *%04x\n" % (content, binascii.crc_hqx(content, 0xFFFF))


class Pins(ArrayDevice):
    """A pin display.

    Parameters
    ----------
    profile : Device
        A profile of one panel; others raise InvalidArgument. 36 levels are used if the profile states none,
        or more.
    where : str
        Its name in messages.
    connect : callable
        ``connect() -> Line``; raises `DeviceError`.
    """

    keep_alive_s: ClassVar[float] = 0.3 * REST_S

    def __init__(self, profile: Device, where: str, connect: Callable[[], Line]) -> None:
        if profile.panels != 1:
            raise InvalidArgument("pins", f"{profile.name}, {profile.panels} panels", "an array of one panel")
        self.profile, self._where, self._connect, self._timeout_s = profile, where, connect, TIMEOUT_S
        self._levels = min(profile.levels or len(DIGITS), len(DIGITS))
        self._digits = np.frombuffer(DIGITS, np.uint8)
        self._number = 0
        self._heights, self._answered_s = b"", 0.0
        self._has_keys, self._keys_s = True, 0.0

    def open(self) -> None:
        """See `ArrayDevice`."""
        self._line, self._number, self._heights = self._connect(), 0, b""
        columns, rows, _ = self.profile.lattice
        size = b"size %d %d %d %d" % (rows, columns, self._levels, round(1000 * REST_S))
        try:
            self._exchange(size, 0, self._timeout_s)
        except DeviceError as error:
            if not isinstance(error.__cause__, TimeoutError):
                raise
            self._exchange(size, 0, self._timeout_s)  # many boards restart when their port is opened

    def put_drives(self, drives: Float32s, frequencies_hz: Float32s | None, seconds: float) -> None:
        """See `ArrayDevice`: a drive is a height; pins do not vibrate."""
        self._show(steps_of(self.profile, drives, self._levels), self._timeout_s)

    def keep_alive(self) -> None:
        """See `ArrayDevice`."""
        heights, self._heights = self._heights, b""
        self._number += 1
        answer = self._exchange(b"keep %d" % self._number, self._number, self._timeout_s, b"rest")
        if answer == b"ok":
            self._heights = heights
        elif heights:
            self._send(heights, self._timeout_s)

    def pressed_keys(self) -> tuple[str, ...]:
        """See `ArrayDevice`."""
        if not self._has_keys or monotonic() - self._keys_s < _KEYS_EVERY_S:
            return ()
        self._number += 1
        answer = self._answer(b"keys %d" % self._number, self._number, self._timeout_s)
        self._keys_s = monotonic()
        start, *keys = answer.split(b" ")[1:] if answer.startswith(b"ok ") else [b""]
        names = tuple("".join(chr(byte) if 32 < byte < 127 else "?" for byte in key) for key in keys)
        if answer.startswith(b"err "):
            self._has_keys = False
            self.notes = (*self.notes, "The display has no keys: pan and zoom by the keys of the terminal.")
        elif start != b"%d" % self._number or not KEYS.issuperset(names):
            raise self._unexpected(answer, f"ok {self._number} and keys of {', '.join(sorted(KEYS))}")
        return names

    def _put_off(self, off: Float32s) -> None:
        self._show(steps_of(self.profile, off, self._levels), _CLOSE_TIMEOUT_S)

    def _show(self, steps: Int64s, timeout_s: float) -> None:
        heights = self._digits[steps.reshape(-1)].tobytes()
        if heights != self._heights:
            self._send(heights, timeout_s)
        elif monotonic() - self._answered_s >= self.keep_alive_s:
            self.keep_alive()

    def _send(self, heights: bytes, timeout_s: float) -> None:
        self._heights = b""  # after an error from here on, the next frame is sent in any case
        self._number += 1
        self._exchange(b"pins %d %s" % (self._number, heights), self._number, timeout_s)
        self._heights = heights

    def _exchange(self, content: bytes, number: int, timeout_s: float, *others: bytes) -> bytes:
        """Send a line; returns the word of its answer, b"ok" or one of `others`."""
        answer = self._answer(content, number, timeout_s)
        for word in (b"ok", *others):
            if answer == b"%s %d" % (word, number):
                return word
        if answer.startswith(b"err "):
            refused = f"that it refuses line {number}: {_printable(answer)[4:]}"
            raise DeviceError(self._where, refused, f"ok {number}")
        raise self._unexpected(answer, f"ok {number}")

    def _unexpected(self, answer: bytes, expected: str) -> DeviceError:
        return DeviceError(self._where, f"the answer '{_printable(answer)}'", expected, _HINT)

    def _answer(self, content: bytes, number: int, timeout_s: float) -> bytes:
        """Send a line; returns its answer."""
        if self._line is None:
            raise DeviceError(self._where, "no connection", "one that was opened")
        deadline_s = monotonic() + timeout_s
        try:
            self._line.write(checked_line(content))
            while (answer := self._line.read_line(deadline_s, MAX_ANSWER_BYTES)) == b"ok 0" and number:
                continue  # the answer to the first of two sizes
        except TimeoutError as error:
            raise DeviceError(
                self._where, f"no answer within {timeout_s:g} s", f"ok {number}", _HINT
            ) from error
        except (OSError, EOFError) as error:
            raise DeviceError(
                self._where, f"that it is gone ({error or 'it was closed'})", hint=_HINT
            ) from error
        self._answered_s = monotonic()
        return bytes(answer)


def _printable(answer: bytes) -> str:
    return "".join(chr(byte) if 32 <= byte < 127 else "?" for byte in answer[:80])


def _make(text: str, profile: Device) -> ArrayDevice:
    where = f"pins:{text}"
    host, _, port = text.rpartition(":")
    if host and port.isdigit() and not text.startswith(("/", "\\")):
        to = address(text, _FORM)
        return Pins(profile, where, lambda: Line(to, where, TIMEOUT_S, _HINT))
    name, separator, baud = text.partition("@")
    is_baud = baud.isascii() and baud.isdigit() and len(baud) <= 8 and int(baud) > 0
    if not name or not name.isprintable() or (separator and not is_baud):
        raise InvalidArgument(
            _FORM, repr(text), "a serial port such as /dev/ttyUSB0@115200, or a host and a port"
        )
    return Pins(profile, where, lambda: SerialLine(name, int(baud or 115200), where, TIMEOUT_S, _HINT))


def checks() -> list[Check]:
    """Check the library, and list the serial ports."""
    library = library_check("pyserial", "devices", "serial")
    if not library.is_there:
        return [library]
    ports = serial_ports()
    names = ", ".join(ports[:8]) if ports else "none"
    hint = "" if ports else "Plug it in; on Linux the user must belong to the group that owns it (dialout)"
    return [library, Check("serial port", bool(ports), names, hint)]


KIND = DeviceKind(
    name="pins",
    form=_FORM,
    summary="pin displays, by lines of text over a serial port or TCP",
    profile="dotpad",
    make=_make,
    checks=checks,
    takes_any=True,
    is_array=True,
)
