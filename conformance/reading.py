"""Bytes read from the first to the last, and the errors of a file at fault; for all parts of the second decoder."""

from __future__ import annotations

import re
import struct
from typing import Any

__all__ = ["CorruptFile", "Cursor", "FaultyFile", "ForeignFile", "TruncatedFile", "UnsupportedVersion", "need"]


class FaultyFile(ValueError):
    """A file that is to be refused."""


class ForeignFile(FaultyFile):
    """It is something else."""


class TruncatedFile(FaultyFile):
    """It ends too early."""


class CorruptFile(FaultyFile):
    """Its bytes contradict themselves."""


class UnsupportedVersion(FaultyFile):
    """It is of another version, or needs a part that this decoder has not."""


def need(condition: object, message: str, kind: type[FaultyFile] = CorruptFile) -> None:
    """Refuse the file unless `condition` holds."""
    if not condition:
        raise kind(message)


class Cursor:
    """A run of bytes, read from the first to the last and not beyond; `short` is the error of one that ends."""

    def __init__(self, data: bytes, short: type[FaultyFile] = TruncatedFile) -> None:
        self.data, self.at, self.short = data, 0, short

    def take(self, size: int) -> bytes:
        need(size <= len(self.data) - self.at, f"{size} bytes wanted, {len(self.data) - self.at} left", self.short)
        self.at += size
        return self.data[self.at - size : self.at]

    def numbers(self, codes: str) -> tuple[Any, ...]:
        """Little-endian numbers by their letters in `struct`."""
        return struct.unpack("<" + codes, self.take(struct.calcsize("<" + codes)))

    def number(self, code: str) -> Any:
        return self.numbers(code)[0]

    def text(self, most: int, least: int = 0, control: str = r"[\x00-\x1f\x7f-\x9f]") -> str:
        """A `str` without control characters."""
        size = self.number("H")
        need(least <= size <= most, f"a text of {size} bytes")
        try:
            text = self.take(size).decode("utf-8")
        except UnicodeDecodeError:
            raise CorruptFile("a text that is not UTF-8") from None
        need(not re.search(control, text), "a control character in a text")
        return text

    def octets(self, most: int) -> bytes:
        """`bytes`, of which there may be `most`."""
        size = self.number("I")
        need(size <= most, f"{size} bytes in a field")
        return self.take(size)

    def varint(self) -> int:
        value = 0
        for place in range(8):
            byte: int = self.number("B")
            value |= (byte & 127) << (7 * place)
            if byte < 128:
                need(byte or not place, "a varint that is not in its shortest form")
                return value
        raise CorruptFile("a varint of more than 8 bytes")

    def chunk(self) -> bytes:
        """A varint, and so many bytes."""
        return self.take(self.varint())

    def end(self) -> None:
        """Refuse the file if bytes are left over."""
        need(self.at == len(self.data), f"{len(self.data) - self.at} bytes too many")
