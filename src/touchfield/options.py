"""`option` declares a dataclass field that is also an option of the command line, with its help. `address`
parses texts such as "HOST:PORT", and `duration_s` texts such as "30s"."""

from __future__ import annotations

import ipaddress
import re
from dataclasses import field
from typing import Any, Final

from touchfield.errors import InvalidArgument

Address = tuple[str, int]


def option(default: Any, help_text: str) -> Any:
    """Return a dataclass field that is also the option ``--its-name``; `help_text` is its help."""
    return field(default=default, metadata={"help": help_text})


def address(text: str, where: str, default: Address | None = None) -> Address:
    """Parse "HOST:PORT" or "[HOST]:PORT"; with a default also "", "HOST" and ":PORT".

    A host with colons, which is an IPv6 address, needs the brackets. Raises InvalidArgument for any other
    text; the error names `where`, such as "osc:HOST:PORT".
    """
    host, colon, port = text.rpartition(":")
    if default is not None:
        if not colon or text.endswith("]"):
            host, port = text, "" if text.isdigit() else str(default[1])
        host = host or default[0]
    is_port = port.isascii() and port.isdigit() and len(port) <= 5 and 0 < int(port) < 65536
    is_bracketed = host.startswith("[") and host.endswith("]")
    host = host[1:-1] if is_bracketed else host
    if not (is_port and _is_host(host, is_bracketed)):
        expected = "a host and a port from 1 to 65535, such as 127.0.0.1:9000 or [::1]:9000"
        raise InvalidArgument(where, repr(text[:80]), expected)
    return host, int(port)


def _is_host(host: str, is_bracketed: bool) -> bool:
    """Return True if a text can be the name or the address of a host."""
    try:
        host.encode("idna")  # as sockets do
        if ":" in host:
            ipaddress.IPv6Address(host)
    except ValueError:  # of which a UnicodeError is one
        return False
    is_plain = host.isprintable() and not any(c in host for c in " /[]@")
    return bool(host) and is_plain and (is_bracketed or ":" not in host)


_SECONDS: Final = {"ms": 1e-3, "s": 1.0, "min": 60.0}


def duration_s(text: str, name: str) -> float:
    """Parse a duration such as "30s", "500ms" or "2min", seconds; a number without a unit is in seconds.

    Raises InvalidArgument for any other text; the error names `name`.
    """
    match = re.fullmatch(r"(\d{1,9}(?:\.\d{1,9})?) ?(ms|s|min)?", text.strip(), re.ASCII)
    if match is None:
        raise InvalidArgument(name, repr(text[:80]), "a duration such as 30s, 500ms or 2min")
    return float(match[1]) * _SECONDS[match[2] or "s"]
