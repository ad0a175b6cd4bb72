"""Lines of text to and from a device, over TCP or a serial port; nothing waits longer than it is told to."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import suppress
from time import monotonic
from typing import Any

from touchfield.adapters.addresses import Address, connected, reason
from touchfield.errors import DeviceError, MissingExtra

__all__ = ["Line", "SerialLine", "TcpLine", "serial_ports"]


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
