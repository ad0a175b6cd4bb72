"""HOST:PORT as a user writes it, and a connection to it that can hang nobody."""

from __future__ import annotations

import socket
import struct
import sys

from touchfield.errors import DeviceError, InvalidArgument

__all__ = ["Address", "address", "connected", "reason"]

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
        made = socket.create_connection(to, timeout_s)
    except (OSError, UnicodeError) as error:  # UnicodeError: a name that is no name of a host
        raise DeviceError(where, f"no connection to {to[0]}:{to[1]} ({reason(error)})", mend=mend) from error
    made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    whole, rest = divmod(timeout_s, 1)
    limit = struct.pack("L", int(1000 * timeout_s)) if sys.platform == "win32" else (
        struct.pack("ll", int(whole), int(1e6 * rest))
    )  # fmt: skip
    made.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)
    return made


def reason(error: BaseException) -> str:
    """What went wrong in a few words, on one line."""
    if isinstance(error, TimeoutError):
        return "no answer in time"
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return " ".join(str(text).split())[:200]
