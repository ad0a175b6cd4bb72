"""Types of the fields within a record of a ``.touch`` file, such as whole numbers, texts and lists: their
bytes, their bounds, and their text in the documentation (docs/format/container.md).

Numbers are little-endian. A type defines its bytes, its bounds and the text for both, so that the writer, the
reader and the tests all follow from one row of the table. A value out of bounds is refused on both sides:
InvalidArgument when it is written, CorruptFile when it is read. A length is compared with the available
bytes, and with its bound, before anything is allocated for it.
"""

from __future__ import annotations

import math
import re
import struct
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sized
from dataclasses import dataclass
from typing import Any, Final

from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.medium.grid import BRICK

_CODES: Final = {"u8": "<B", "u16": "<H", "u32": "<I", "u64": "<Q"}
WHOLE: Final = {name: struct.Struct(code) for name, code in _CODES.items()}
REAL: Final = struct.Struct("<d")


class Cursor:
    """Position within the bytes `start` to `stop` of `data`, which are not copied.

    `start` and `stop` are as in a slice. `where` is the file's name in messages, `offset` the position of the
    first byte of `data` in the file.
    """

    def __init__(
        self, data: bytes, where: str, offset: int = 0, start: int = 0, stop: int | None = None
    ) -> None:
        self._data, self._where, self._offset = data, where, offset
        self._position, self._end, _ = slice(start, stop).indices(len(data))

    @property
    def remaining(self) -> int:
        """Number of bytes not read yet."""
        return self._end - self._position

    def take(self, size: int, field: str) -> bytes:
        """The next `size` bytes; CorruptFile if there are fewer."""
        if size > self.remaining:
            raise self.corrupt(field, f"{self.remaining} bytes left in the record", f"{size} bytes")
        self._position += size
        return self._data[self._position - size : self._position]

    def number(self, packing: struct.Struct, field: str) -> Any:
        """The next number."""
        return packing.unpack(self.take(packing.size, field))[0]

    def corrupt(self, field: str, found: str, expected: str, back: int = 0) -> CorruptFile:
        """The error for a field that starts `back` bytes before the cursor."""
        return CorruptFile(
            f"{self._where}: {field} at byte {self._offset + self._position - back}", found, expected
        )


class FieldType(ABC):
    """Type of a field: text for its bytes and bounds, and its size.

    `smallest` and `largest` are the limits of its size in bytes.
    """

    def __init__(self, wire: str, bounds: str, smallest: int, largest: int) -> None:
        self.wire, self.bounds, self.smallest, self.largest = wire, bounds, smallest, largest

    @abstractmethod
    def encode(self, value: Any, where: str) -> bytes:
        """The bytes of `value`.

        InvalidArgument, naming `where`, for a wrong type or value.
        """

    @abstractmethod
    def decode(self, cursor: Cursor, where: str) -> Any:
        """The value at the cursor.

        CorruptFile, naming `where`, if it is cut short or out of bounds.
        """


class Number(FieldType):
    """A number from `low` to `high`, stored as `packing`; `description` is its kind."""

    def __init__(
        self, wire: str, bounds: str, packing: struct.Struct, low: float, high: float, description: str
    ) -> None:
        self.packing, self.low, self.high, self.description = packing, low, high, description
        super().__init__(wire, bounds, packing.size, packing.size)

    def encode(self, value: Any, where: str) -> bytes:
        try:
            # struct accepts numbers only, while float() would also accept a string
            packed = b"" if isinstance(value, bool) else self.packing.pack(value)
        except (struct.error, TypeError, ValueError, OverflowError):
            packed = b""
        if not packed or not self.low <= value <= self.high:
            raise InvalidArgument(where, quoted(value), f"{self.description}, {self.bounds}")
        return packed

    def decode(self, cursor: Cursor, where: str) -> Any:
        value = cursor.number(self.packing, where)
        if not self.low <= value <= self.high:
            raise cursor.corrupt(where, repr(value), self.bounds, self.smallest)
        return value


class Whole(Number):
    """A whole number without sign: u8, u16, u32 or u64."""

    def __init__(self, code: str, low: int = 0, high: int | None = None) -> None:
        packing = WHOLE[code]
        top = (1 << 8 * packing.size) - 1 if high is None else high
        bounds = f"{low} to {top}" if low < top else str(low)
        super().__init__(code, bounds, packing, low, top, "a whole number")


class Real(Number):
    """A finite number from `low` to `high`, f64 of IEEE 754."""

    def __init__(self, low: float, high: float) -> None:
        super().__init__("f64", f"{low:.15g} to {high:.15g}", REAL, low, high, "a number")


class Array(FieldType):
    """A fixed number of scalars, one after the other; a tuple in Python.

    `max_bricks` limits the shape of a lattice by its number of bricks, which determines time and memory.
    """

    def __init__(self, of: FieldType, count: int, max_bricks: int | None = None) -> None:
        self.of, self.count, self.max_bricks = of, count, max_bricks
        bounds = f"each {of.bounds}" + ("" if max_bricks is None else f"; at most {max_bricks} bricks")
        super().__init__(f"{count} × {of.wire}", bounds, count * of.smallest, count * of.largest)

    def _is_allowed(self, members: tuple[Any, ...]) -> bool:
        return self.max_bricks is None or math.prod(-(-n // BRICK) for n in members) <= self.max_bricks

    def encode(self, value: Any, where: str) -> bytes:
        members = tuple(value) if isinstance(value, Sized) and isinstance(value, Iterable) else ()
        if len(members) != self.count:
            raise InvalidArgument(where, quoted(value), f"{self.count} values")
        data = b"".join(self.of.encode(member, f"{where}[{i}]") for i, member in enumerate(members))
        if not self._is_allowed(members):
            raise InvalidArgument(where, quoted(value), self.bounds)
        return data

    def decode(self, cursor: Cursor, where: str) -> tuple[Any, ...]:
        members = tuple(self.of.decode(cursor, f"{where}[{i}]") for i in range(self.count))
        if not self._is_allowed(members):
            raise cursor.corrupt(where, quoted(members), self.bounds, self.smallest)
        return members


@dataclass(frozen=True)
class Pattern:
    """Set of allowed characters, as a regular expression and as text."""

    expression: str
    description: str

    def holds(self, text: str) -> bool:
        """True if all characters of `text` are allowed."""
        return re.fullmatch(self.expression, text) is not None


# control characters in a file could rewrite the screen of a terminal that prints its description
TEXT: Final = Pattern(r"[^\x00-\x1f\x7f-\x9f]*", "no control characters")
LINES: Final = Pattern(r"[^\x00-\x08\x0b-\x1f\x7f-\x9f]*", "no control characters but tab and line feed")
NAME: Final = Pattern(r"[a-z][a-z0-9._-]*", "a small letter, then small letters, digits, `.`, `_`, `-`")


class Text(FieldType):
    """A string: its length in bytes as u16, then UTF-8."""

    def __init__(self, limit: int, pattern: Pattern = TEXT, min_bytes: int = 0) -> None:
        self.limit, self.pattern, self.min_bytes = limit, pattern, min_bytes
        self.length = Whole("u16", min_bytes, limit)
        sizes = f"{min_bytes} to" if min_bytes else "at most"
        super().__init__("str", f"{sizes} {limit} bytes, {pattern.description}", 2 + min_bytes, 2 + limit)

    def encode(self, value: Any, where: str) -> bytes:
        try:
            data = value.encode("utf-8") if isinstance(value, str) else None
        except UnicodeEncodeError:
            data = None
        if data is None or not self.min_bytes <= len(data) <= self.limit or not self.pattern.holds(value):
            raise InvalidArgument(where, quoted(value), f"a string, {self.bounds}")
        return self.length.encode(len(data), where) + data

    def decode(self, cursor: Cursor, where: str) -> str:
        data = cursor.take(self.length.decode(cursor, f"{where} (bytes)"), where)
        try:
            text = data.decode("utf-8")
        except UnicodeDecodeError:
            raise cursor.corrupt(where, "bytes that are not UTF-8", self.bounds, len(data)) from None
        if not self.pattern.holds(text):
            raise cursor.corrupt(where, quoted(text), self.bounds, len(data))
        return text


class Octets(FieldType):
    """Bytes that another document defines: their count as u32, then the bytes."""

    def __init__(self, limit: int) -> None:
        self.limit, self.length = limit, Whole("u32", 0, limit)
        super().__init__("bytes", f"at most {limit} bytes", 4, 4 + limit)

    def encode(self, value: Any, where: str) -> bytes:
        data = octets(value, where)
        return self.length.encode(len(data), f"{where} (bytes)") + data

    def decode(self, cursor: Cursor, where: str) -> bytes:
        return cursor.take(self.length.decode(cursor, f"{where} (bytes)"), where)


class Rest(FieldType):
    """All bytes up to the end of the payload; only for the last field of a record."""

    def __init__(self) -> None:
        super().__init__("rest", "any", 0, 1 << 63)

    def encode(self, value: Any, where: str) -> bytes:
        return octets(value, where)

    def decode(self, cursor: Cursor, where: str) -> bytes:
        return cursor.take(cursor.remaining, where)


class Listed(FieldType):
    """A list: its number of members as u16 or u32, then these; a tuple in Python."""

    def __init__(self, of: FieldType, limit: int, code: str = "u16") -> None:
        self.of, self.limit, self.code = of, limit, code
        self.count, size = Whole(code, 0, limit), WHOLE[code].size
        bounds = f"at most {limit}; each {of.bounds}"
        super().__init__(f"list ({code}) of {of.wire}", bounds, size, size + limit * of.largest)

    def encode(self, value: Any, where: str) -> bytes:
        if not isinstance(value, (list, tuple)):
            raise InvalidArgument(where, quoted(value), f"a list of at most {self.limit}")
        members = [self.of.encode(member, f"{where}[{i}]") for i, member in enumerate(value)]
        return self.count.encode(len(value), f"{where} (members)") + b"".join(members)

    def decode(self, cursor: Cursor, where: str) -> tuple[Any, ...]:
        count = self.count.decode(cursor, f"{where} (members)")
        if count * self.of.smallest > cursor.remaining:
            found = f"{count} members in {cursor.remaining} bytes"
            raise cursor.corrupt(where, found, f"at least {self.of.smallest} bytes each", self.smallest)
        return tuple(self.of.decode(cursor, f"{where}[{i}]") for i in range(count))


def octets(value: Any, where: str) -> bytes:
    """`value` as bytes, without a copy if it is bytes already.

    InvalidArgument if it is not bytes-like.
    """
    if isinstance(value, bytes):
        return value
    if isinstance(value, (bytearray, memoryview)):
        return bytes(value)
    raise InvalidArgument(where, quoted(value), "bytes")


def quoted(value: object) -> str:
    """`value` for a message: escaped, on one line, at most 60 characters."""
    text = ascii(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
