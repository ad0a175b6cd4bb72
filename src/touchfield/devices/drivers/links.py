"""Ways to a device: HOST:PORT, lines of text over TCP or a serial port, WebSockets, drivers as shared
libraries.

Nothing waits longer than it is told to, and a connection can hang nobody.
"""

from __future__ import annotations

import ctypes
import math
import os
import socket
import struct
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic
from typing import TYPE_CHECKING, Any

from touchfield.devices.drivers.registry import Check
from touchfield.errors import DeviceError, import_extra, reason
from touchfield.options import Address

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection


MOST_MESSAGE_BYTES = 1 << 16


def connected(
    to: Address, where: str, timeout_s: float, mend: str, send_s: float | None = None
) -> socket.socket:
    """A TCP connection that blocks; a write that the other side does not take ends in an OSError after
    `send_s`.

    `send_s` is `timeout_s` unless it is given. Raises DeviceError if nothing answers there within
    `timeout_s`.
    """
    try:
        line = socket.create_connection(to, timeout_s)
    except (OSError, UnicodeError) as error:  # UnicodeError: a name that is no name of a host
        raise DeviceError(where, f"no connection to {to[0]}:{to[1]} ({reason(error)})", mend=mend) from error
    line.settimeout(None)
    milliseconds = math.ceil(1000 * (timeout_s if send_s is None else send_s))
    if sys.platform == "win32":
        limit = struct.pack("@L", milliseconds)
    else:
        limit = struct.pack("@ll", milliseconds // 1000, milliseconds % 1000 * 1000)
    with suppress(OSError):  # of a line that the other side has closed already
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        line.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)
    return line


def web_socket(
    to: Address, path: str, where: str, mend: str, open_s: float, send_s: float, **options: Any
) -> ClientConnection:
    """A WebSocket over a socket of ours: no proxy of the environment comes between, and no send waits for
    ever.

    `options` go to `websockets`. Raises MissingExtra without that library; DeviceError if nothing answers
    within `open_s`, or answers something else.
    """
    client = import_extra("websockets.sync.client", where, "websockets", "devices")
    host, port = to
    name = f"[{host}]" if ":" in host else host
    line = connected(to, where, open_s, mend, send_s)
    options = {"compression": None, "open_timeout": open_s, "max_size": MOST_MESSAGE_BYTES, **options}
    try:
        # as of release 17 the connection is made only when its block is entered
        connection: ClientConnection = client.connect(
            f"ws://{name}:{port}/{path}", sock=line, **options
        ).__enter__()
    except Exception as error:  # a web server, silence or garbage, each by an error of its own
        line.close()
        raise DeviceError(where, f"no WebSocket at {host}:{port} ({reason(error)})", mend=mend) from error
    return connection


def service_check(what: str, to: Address, mend: str) -> Check:
    """Check that something listens there."""
    try:
        connected(to, what, 0.3, mend).close()
    except DeviceError as error:
        return Check(f"{what} on {to[0]}:{to[1]}", False, error.found, mend)
    return Check(f"{what} on {to[0]}:{to[1]}", True, "it listens")


class Line:
    """A connection that carries lines, over TCP."""

    _rest: bytes = b""

    def __init__(self, to: Address, where: str, patience_s: float, mend: str) -> None:
        self._socket = connected(to, where, patience_s, mend)
        self._patience_s = patience_s

    def write(self, data: bytes) -> None:
        """Send bytes; raises `TimeoutError` or another `OSError`."""
        self._socket.settimeout(self._patience_s)
        self._socket.sendall(data)

    def close(self) -> None:
        """Let it go."""
        with suppress(OSError):
            self._socket.close()

    def _read(self, seconds: float) -> bytes:
        """Some bytes that came within so many seconds, b"" if none; raises `EOFError` or `OSError`."""
        self._socket.settimeout(seconds)
        data = self._socket.recv(4096)
        if not data:
            raise EOFError("it was closed")
        return data

    def read_line(self, deadline_s: float, most_bytes: int) -> bytes:
        """The next line, without its line feed and blanks around it; a longer one is cut at `most_bytes`.

        The deadline is by the monotonic clock. Raises TimeoutError if no line came in time, EOFError or
        another OSError if the other side is gone.
        """
        while b"\n" not in self._rest and len(self._rest) <= most_bytes:
            left = deadline_s - monotonic()
            if left <= 0:
                raise TimeoutError
            self._rest += self._read(left)
        line, _, self._rest = self._rest.partition(b"\n")
        return line[:most_bytes].strip()


class SerialLine(Line):
    """The same over a serial port, 8 bits, no parity, one stop bit."""

    def __init__(self, name: str, baud: int, where: str, patience_s: float, mend: str) -> None:
        serial = import_extra("serial", "a serial port", "pyserial", "devices")
        try:
            self._port: Any = serial.Serial(name, baud, write_timeout=patience_s)
        except (OSError, ValueError) as error:  # serial.SerialException is an OSError
            raise DeviceError(where, f"that it cannot be opened ({reason(error)})", mend=mend) from error

    def write(self, data: bytes) -> None:
        """See `Line`."""
        self._port.write(data)

    def _read(self, seconds: float) -> bytes:
        self._port.timeout = seconds
        data: bytes = self._port.read(max(1, min(self._port.in_waiting, 4096)))
        return data

    def close(self) -> None:
        """See `Line`."""
        with suppress(OSError):
            self._port.close()


def serial_ports() -> list[str]:
    """Names of the serial ports of this machine; needs pyserial."""
    try:
        from serial.tools.list_ports import comports
    except ImportError:
        return []
    return sorted(str(port.device) for port in comports())


@dataclass(frozen=True)
class DriverLibrary:
    """How a driver is named on each system, the likeliest name first.

    `variable` is that of the environment which names its file where it lies elsewhere, `mend` how to get it.
    """

    title: str
    variable: str
    linux: tuple[str, ...]
    windows: tuple[str, ...]
    mac: tuple[str, ...]
    mend: str

    def load(self, functions: Mapping[str, tuple[Any, tuple[Any, ...]]]) -> Any:
        """The library, its functions given results and arguments: ``{name: (result, arguments)}``.

        Raises DeviceError if no file can be loaded, or one lacks a function.
        """
        library, name = self._loaded()
        for function, (result, arguments) in functions.items():
            entry = getattr(library, function, None)
            if entry is None:
                raise DeviceError(name, f"no function {function}", f"the library of {self.title}", self._mend)
            entry.restype, entry.argtypes = result, arguments
        return library

    def checks(self) -> list[Check]:
        """For `touchfield doctor`."""
        what = f"driver of {self.title}"
        try:
            return [Check(what, True, self._loaded()[1])]
        except DeviceError as error:
            return [Check(what, False, error.found, self._mend)]

    @property
    def names(self) -> tuple[str, ...]:
        """Names to try, in order."""
        asked = os.environ.get(self.variable)
        return (
            (asked,) if asked else {"win32": self.windows, "darwin": self.mac}.get(sys.platform, self.linux)
        )

    @property
    def _mend(self) -> str:
        return f"{self.mend}, or name its file in {self.variable}."

    def _loaded(self) -> tuple[ctypes.CDLL, str]:
        reasons = []
        for name in self.names:
            try:
                return ctypes.CDLL(name), name
            except (OSError, ValueError) as error:  # ValueError: a name with a NUL in it
                reasons.append(str(error) if name in str(error) else f"{name}: {error}")
        raise DeviceError(
            f"driver of {self.title}", "; ".join(reasons)[:200], f"one of {', '.join(self.names)}", self._mend
        )
