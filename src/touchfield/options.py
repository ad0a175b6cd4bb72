"""Fields of a spec that are options, too, each with its words in the help; and addresses."""

from __future__ import annotations

from dataclasses import field
from typing import Any

from touchfield.errors import InvalidArgument

Address = tuple[str, int]


def option(default: Any, words: str) -> Any:
    """A field of a frozen dataclass, ``--its-name`` on the command line, where `words` are its help."""
    return field(default=default, metadata={"help": words})


def address(words: str, where: str, default: Address | None = None) -> Address:
    """Host and port of "HOST:PORT" or "[HOST]:PORT"; with a default also "", "HOST" and ":PORT".

    Raises InvalidArgument for anything else, which names `where`, such as "osc:HOST:PORT".
    """
    host, colon, port = words.rpartition(":")
    if default is not None:
        if not colon or words.endswith("]"):
            host, port = words, "" if words.isdigit() else str(default[1])
        host = host or default[0]
    host = host.removeprefix("[").removesuffix("]")
    try:
        host.encode("idna")  # as sockets do
    except UnicodeError:
        host = ""
    is_port = port.isascii() and port.isdigit() and len(port) <= 5 and 0 < int(port) < 65536
    if not host or not is_port or not host.isprintable() or any(c in host for c in " /[]@"):
        raise InvalidArgument(
            where, repr(words[:80]), "a host and a port from 1 to 65535, such as 127.0.0.1:9000"
        )
    return host, int(port)
