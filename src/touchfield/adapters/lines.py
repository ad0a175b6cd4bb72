"""HOST:PORT as a user writes it, and lines of text to and from a device, over TCP or a serial port.

Nothing waits longer than it is told to, and a connection can hang nobody.
"""

from __future__ import annotations

import math
import socket
import struct
import sys
from abc import ABC, abstractmethod
from contextlib import suppress
from time import monotonic
from typing import Any

from touchfield.errors import DeviceError, InvalidArgument, MissingExtra

__all__ = [
    "Address",
    "Line",
    "SerialLine",
    "TcpLine",
    "address",
    "bound_sends",
    "connected",
    "reason",
    "serial_ports",
]

Address = tuple[str, int]


def address(words: str, where: str, default: Address | None = None) -> Address:
    """Host and port of "HOST:PORT" or "[HOST]:PORT".

    Parameters
    ----------
    words : str
        "" takes the default.
    where : str
        What the user wrote it for, such as "osc:HOST:PORT".
    default : (str, int), optional

    Raises
    ------
    InvalidArgument
        If it is something else.
    """
    if not words and default is not None:
        return default
    host, _, port = words.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    is_port = port.isascii() and port.isdigit() and len(port) <= 5 and 0 < int(port) < 65536
    if not host or not is_port or not host.isprintable() or any(c in host for c in " /[]@"):
        raise InvalidArgument(where, repr(words), "a host and a port from 1 to 65535, such as 127.0.0.1:9000")
    return host, int(port)


def connected(to: Address, where: str, timeout_s: float, mend: str) -> socket.socket:
    """A TCP connection; a write that the other side does not take ends in an OSError after the time-out.

    Raises
    ------
    DeviceError
        If nothing answers there within the time-out.
    """
    try:
        line = socket.create_connection(to, timeout_s)
    except (OSError, UnicodeError) as error:  # UnicodeError: a name that is no name of a host
        raise DeviceError(where, f"no connection to {to[0]}:{to[1]} ({reason(error)})", mend=mend) from error
    bound_sends(line, timeout_s)
    return line


def bound_sends(line: socket.socket, timeout_s: float) -> None:
    """Send at once, and let a write that the other side does not take end in an OSError after the time-out."""
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    milliseconds = math.ceil(1000 * timeout_s)
    if sys.platform == "win32":
        limit = struct.pack("@L", milliseconds)
    else:
        limit = struct.pack("@ll", milliseconds // 1000, milliseconds % 1000 * 1000)
    line.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)


def reason(error: BaseException) -> str:
    """What went wrong in a few words, on one line."""
    if isinstance(error, TimeoutError):
        return "no answer in time"
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return " ".join(str(text).split())[:200]


class Line(ABC):
    """A connection that carries lines."""

    _rest: bytes = b""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Send bytes; raises `TimeoutError` or another `OSError`."""

    @abstractmethod
    def _read(self, seconds: float) -> bytes:
        """Some bytes that came within so many seconds, b"" if none; raises `EOFError` or `OSError`."""

    @abstractmethod
    def close(self) -> None:
        """Let it go."""

    def read_line(self, deadline_s: float, most_bytes: int) -> bytes:
        """The next line, without its line feed and blanks around it.

        Parameters
        ----------
        deadline_s : float
            By the monotonic clock.
        most_bytes : int
            A longer line is cut there, and told as it is.

        Raises
        ------
        TimeoutError
            If no line came in time.
        EOFError, OSError
            If the other side is gone.
        """
        while b"\n" not in self._rest and len(self._rest) <= most_bytes:
            left = deadline_s - monotonic()
            if left <= 0:
                raise TimeoutError
            self._rest += self._read(left)
        line, _, self._rest = self._rest.partition(b"\n")
        return line[:most_bytes].strip()


class TcpLine(Line):
    """Over TCP."""

    def __init__(self, to: Address, where: str, patience_s: float, mend: str) -> None:
        self._socket = connected(to, where, patience_s, mend)
        self._patience_s = patience_s

    def write(self, data: bytes) -> None:
        """See `Line`."""
        self._socket.settimeout(self._patience_s)
        self._socket.sendall(data)

    def _read(self, seconds: float) -> bytes:
        self._socket.settimeout(seconds)
        data = self._socket.recv(4096)
        if not data:
            raise EOFError("it was closed")
        return data

    def close(self) -> None:
        """See `Line`."""
        with suppress(OSError):
            self._socket.close()


class SerialLine(Line):
    """Over a serial port, 8 bits, no parity, one stop bit."""

    def __init__(self, name: str, baud: int, where: str, patience_s: float, mend: str) -> None:
        try:
            import serial
        except ImportError:
            raise MissingExtra("a serial port", "pyserial", "devices") from None
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
