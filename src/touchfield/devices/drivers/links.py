"""Connections that drivers use to reach devices: TCP, serial ports, WebSockets, and the vendors' shared
libraries.

Every wait has a time limit, so that no connection can block a program.
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


MAX_MESSAGE_BYTES = 1 << 16

Functions = Mapping[str, tuple[Any, tuple[Any, ...]]]
"""Result and arguments of functions in a library, by name."""


def connect(
    to: Address, where: str, timeout_s: float, hint: str, send_s: float | None = None
) -> socket.socket:
    """Open a blocking TCP connection whose writes time out.

    A write that the other side does not accept raises an OSError after `send_s`, which defaults to
    `timeout_s`. Raises DeviceError if nothing answers within `timeout_s`.
    """
    try:
        line = socket.create_connection(to, timeout_s)
    except (OSError, UnicodeError) as error:  # UnicodeError: an invalid host name
        raise DeviceError(where, f"no connection to {to[0]}:{to[1]} ({reason(error)})", hint=hint) from error
    line.settimeout(None)
    milliseconds = math.ceil(1000 * (timeout_s if send_s is None else send_s))
    if sys.platform == "win32":
        limit = struct.pack("@L", milliseconds)
    else:
        limit = struct.pack("@ll", milliseconds // 1000, milliseconds % 1000 * 1000)
    with suppress(OSError):  # the other side may have closed it already
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        line.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)
    return line


def web_socket(
    to: Address, path: str, where: str, hint: str, open_s: float, send_s: float, **options: Any
) -> ClientConnection:
    """Open a WebSocket over a socket that `connect` opens.

    Therefore no proxy of the environment is used, and no send blocks for ever. `options` are passed to
    `websockets`. Raises MissingExtra without that library; DeviceError if nothing answers within `open_s`, or
    something else answers.
    """
    client = import_extra("websockets.sync.client", where, "websockets", "devices")
    host, port = to
    name = f"[{host}]" if ":" in host else host
    line = connect(to, where, open_s, hint, send_s)
    options = {"compression": None, "open_timeout": open_s, "max_size": MAX_MESSAGE_BYTES, **options}
    try:
        # since release 17 the connection is made only on entering its context
        connection: ClientConnection = client.connect(
            f"ws://{name}:{port}/{path}", sock=line, **options
        ).__enter__()
    except Exception as error:  # a web server, silence and invalid data each raise another error
        line.close()
        raise DeviceError(where, f"no WebSocket at {host}:{port} ({reason(error)})", hint=hint) from error
    return connection


def service_check(subject: str, to: Address, hint: str) -> Check:
    """Check that something listens at an address."""
    try:
        connect(to, subject, 0.3, hint).close()
    except DeviceError as error:
        return Check(f"{subject} on {to[0]}:{to[1]}", False, error.found, hint)
    return Check(f"{subject} on {to[0]}:{to[1]}", True, "it listens")


class Line:
    """A connection that carries lines of text, over TCP."""

    _pending: bytes = b""

    def __init__(self, to: Address, where: str, timeout_s: float, hint: str) -> None:
        self._socket = connect(to, where, timeout_s, hint)
        self._timeout_s = timeout_s

    def write(self, data: bytes) -> None:
        """Send bytes; raises `TimeoutError` or another `OSError`."""
        self._socket.settimeout(self._timeout_s)
        self._socket.sendall(data)

    def close(self) -> None:
        """Close the connection."""
        with suppress(OSError):
            self._socket.close()

    def _read(self, seconds: float) -> bytes:
        """Return the bytes that arrive within `seconds`; raises `EOFError` or `OSError`."""
        self._socket.settimeout(seconds)
        data = self._socket.recv(4096)
        if not data:
            raise EOFError("it was closed")
        return data

    def read_line(self, deadline_s: float, max_bytes: int) -> bytes:
        """Return the next line, stripped; a longer one is cut at `max_bytes`.

        The deadline is a time of the monotonic clock. Raises TimeoutError if no line arrives in time,
        EOFError or another OSError if the other side is gone.
        """
        while b"\n" not in self._pending and len(self._pending) <= max_bytes:
            remaining_s = deadline_s - monotonic()
            if remaining_s <= 0:
                raise TimeoutError
            self._pending += self._read(remaining_s)
        line, _, self._pending = self._pending.partition(b"\n")
        return line[:max_bytes].strip()


class SerialLine(Line):
    """A line-based connection over a serial port: 8 bits, no parity, one stop bit."""

    def __init__(self, name: str, baud: int, where: str, timeout_s: float, hint: str) -> None:
        serial = import_extra("serial", "a serial port", "pyserial", "devices")
        try:
            self._port: Any = serial.Serial(name, baud, write_timeout=timeout_s)
        except (OSError, ValueError) as error:  # serial.SerialException is an OSError
            raise DeviceError(where, f"that it cannot be opened ({reason(error)})", hint=hint) from error

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
    """Return the names of the serial ports of this machine; empty without pyserial."""
    try:
        from serial.tools.list_ports import comports
    except ImportError:
        return []
    return sorted(str(port.device) for port in comports())


@dataclass(frozen=True)
class DriverLibrary:
    """File names of a vendor's driver library on each system, the most likely first.

    The environment variable `variable` gives the path of the library if it is elsewhere; `hint` tells the
    user how to install it.
    """

    title: str
    variable: str
    linux: tuple[str, ...]
    windows: tuple[str, ...]
    mac: tuple[str, ...]
    hint: str

    def load(self, functions: Functions, optional: Functions | None = None) -> Any:
        """Load the library and declare its functions: ``{name: (result, arguments)}``.

        An older library may lack those of `optional`. Raises DeviceError if no file can be loaded, or another
        function is missing.
        """
        library, name = self._load_first()
        optional = optional or {}
        for function, (result, arguments) in {**functions, **optional}.items():
            entry = getattr(library, function, None)
            if entry is None and function in optional:
                continue
            if entry is None:
                raise DeviceError(name, f"no function {function}", f"the library of {self.title}", self._hint)
            entry.restype, entry.argtypes = result, arguments
        return library

    def checks(self) -> list[Check]:
        """Check for `touchfield doctor`."""
        subject = f"driver of {self.title}"
        try:
            return [Check(subject, True, self._load_first()[1])]
        except DeviceError as error:
            return [Check(subject, False, error.found, self._hint)]

    @property
    def names(self) -> tuple[str, ...]:
        """File names to try, in order."""
        override = os.environ.get(self.variable)
        return (
            (override,)
            if override
            else {"win32": self.windows, "darwin": self.mac}.get(sys.platform, self.linux)
        )

    @property
    def _hint(self) -> str:
        return f"{self.hint}, or name its file in {self.variable}."

    def _load_first(self) -> tuple[ctypes.CDLL, str]:
        reasons = []
        for name in self.names:
            try:
                return ctypes.CDLL(name), name
            except (OSError, ValueError) as error:  # ValueError: a name with a NUL in it
                reasons.append(str(error) if name in str(error) else f"{name}: {error}")
        raise DeviceError(
            f"driver of {self.title}", "; ".join(reasons)[:200], f"one of {', '.join(self.names)}", self._hint
        )
