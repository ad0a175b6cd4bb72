"""A live stream through a pipe: each message behind its length (docs/format/live.md)."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import IO, Final

from touchfield.errors import SourceError
from touchfield.files import exactly
from touchfield.stream.live import MOST_BYTES

_LENGTH: Final = struct.Struct("<I")


def write_message(file: IO[bytes], message: bytes) -> None:
    """Write a message and have it go at once."""
    file.write(_LENGTH.pack(len(message)) + message)
    file.flush()


def messages(file: IO[bytes], name: str) -> Iterator[bytes]:
    """The messages of a pipe up to its end, which may come before that of the stream.

    Raises SourceError if it ends within a message, or a message is too long to be one.
    """
    while length := exactly(file, _LENGTH.size):
        count = _LENGTH.unpack(length)[0] if len(length) == _LENGTH.size else MOST_BYTES + 1
        if count > MOST_BYTES:
            raise SourceError(name, f"{length!r}", f"the length of a message, at most {MOST_BYTES}")
        message = exactly(file, count)
        if len(message) < count:
            raise SourceError(name, "its end within a message", "whole messages of touchfield live SOURCE -")
        yield message
