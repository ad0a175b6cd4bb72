"""The field types of a ``.touch`` file and their wire form (docs/format/container.md); numbers are little-endian.

A type knows its bytes, its bounds and how to say both in words, so that the writer, the reader and the tests all
follow from one row of the table. A value out of bounds is refused on both sides: InvalidArgument when it is written,
CorruptFile when it is read. A length is compared with the bytes that are there, and with its bound, before anything
is allocated for it.
"""

from __future__ import annotations

import math
import operator
import re
import struct
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sized
from dataclasses import dataclass
from typing import Any, Final

from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.medium.grid import BRICK


class Cursor:
    """How far the reading of a run of bytes has come.

    Parameters
    ----------
    data : bytes
        Bytes of a file.
    where : str
        What to call the file in messages.
    offset : int
        Position of the first of `data` in the file.
    begin, end : int, optional
        Which of `data` may be read, as in a slice, but without a copy.
    """

    def __init__(self, data: bytes, where: str, offset: int = 0, begin: int = 0, end: int | None = None) -> None:
        self._data, self._where, self._offset = data, where, offset
        self._place, self._end, _ = slice(begin, end).indices(len(data))

    @property
    def place(self) -> int:
        """Position of the next byte in the file."""
        return self._offset + self._place

    @property
    def remaining(self) -> int:
        """Bytes not yet read."""
        return self._end - self._place

    def take(self, size: int, field: str) -> bytes:
        """The next `size` bytes; CorruptFile if there are fewer."""
        if size > self.remaining:
            raise self.corrupt(field, f"{self.remaining} bytes left in the record", f"{size} bytes")
        self._place += size
        return self._data[self._place - size : self._place]

    def corrupt(self, field: str, found: str, expected: str, back: int = 0) -> CorruptFile:
        """The error of a field that begins `back` bytes before the place."""
        return CorruptFile(f"{self._where}: {field} at byte {self.place - back}", found, expected)


WHOLE_CODES: Final = {"u8": "<B", "u16": "<H", "u32": "<I", "u64": "<Q"}


class FieldType(ABC):
    """One kind of field: its bytes and its bounds in words, and its `smallest` and `largest` size in bytes."""

    @property
    @abstractmethod
    def wire(self) -> str: ...

    @property
    @abstractmethod
    def bounds(self) -> str: ...

    @property
    @abstractmethod
    def smallest(self) -> int: ...

    @property
    @abstractmethod
    def largest(self) -> int: ...

    @abstractmethod
    def encode(self, value: Any, where: str) -> bytes:
        """The bytes of `value`; InvalidArgument, naming `where`, if it is of another type or out of bounds."""

    @abstractmethod
    def decode(self, cursor: Cursor, where: str) -> Any:
        """The value at the cursor; CorruptFile, naming `where`, if the bytes run out or it is out of bounds."""


@dataclass(frozen=True)
class Whole(FieldType):
    """A whole number without sign: u8, u16, u32 or u64."""

    code: str
    low: int = 0
    high: int | None = None

    @property
    def top(self) -> int:
        """The largest value."""
        return (1 << 8 * self.smallest) - 1 if self.high is None else self.high

    @property
    def wire(self) -> str:
        return self.code

    @property
    def bounds(self) -> str:
        return f"{self.low} to {self.top}" if self.low < self.top else str(self.low)

    @property
    def smallest(self) -> int:
        return struct.calcsize(WHOLE_CODES[self.code])

    largest = smallest

    def encode(self, value: Any, where: str) -> bytes:
        try:
            number = -1 if isinstance(value, bool) else operator.index(value)
        except TypeError:
            number = -1
        if not self.low <= number <= self.top:
            raise InvalidArgument(where, shown(value), f"a whole number, {self.bounds}")
        return struct.pack(WHOLE_CODES[self.code], number)

    def decode(self, cursor: Cursor, where: str) -> int:
        value: int = struct.unpack(WHOLE_CODES[self.code], cursor.take(self.smallest, where))[0]
        if not self.low <= value <= self.top:
            raise cursor.corrupt(where, str(value), self.bounds, self.smallest)
        return value


@dataclass(frozen=True)
class Real(FieldType):
    """A finite number from `low` to `high`, f64 of IEEE 754."""

    low: float
    high: float

    @property
    def wire(self) -> str:
        return "f64"

    @property
    def bounds(self) -> str:
        return f"{self.low:.15g} to {self.high:.15g}"

    @property
    def smallest(self) -> int:
        return 8

    largest = smallest

    def encode(self, value: Any, where: str) -> bytes:
        try:
            # float() would take a string too, struct takes numbers only
            packed = struct.pack("<d", value)
        except (struct.error, TypeError, ValueError, OverflowError):
            packed = b""
        if not packed or not self.low <= value <= self.high:
            raise InvalidArgument(where, shown(value), f"a number, {self.bounds}")
        return packed

    def decode(self, cursor: Cursor, where: str) -> float:
        value: float = struct.unpack("<d", cursor.take(self.smallest, where))[0]
        if not self.low <= value <= self.high:
            raise cursor.corrupt(where, repr(value), self.bounds, self.smallest)
        return value


@dataclass(frozen=True)
class Array(FieldType):
    """A fixed number of scalars, one after the other; a tuple in Python."""

    of: FieldType
    count: int

    @property
    def wire(self) -> str:
        return f"{self.count} × {self.of.wire}"

    @property
    def bounds(self) -> str:
        return f"each {self.of.bounds}"

    @property
    def smallest(self) -> int:
        return self.count * self.of.smallest

    @property
    def largest(self) -> int:
        return self.count * self.of.largest

    def encode(self, value: Any, where: str) -> bytes:
        members = tuple(value) if isinstance(value, Sized) and isinstance(value, Iterable) else ()
        if len(members) != self.count:
            raise InvalidArgument(where, shown(value), f"{self.count} values")
        return b"".join(self.of.encode(member, f"{where}[{i}]") for i, member in enumerate(members))

    def decode(self, cursor: Cursor, where: str) -> tuple[Any, ...]:
        return tuple(self.of.decode(cursor, f"{where}[{i}]") for i in range(self.count))


@dataclass(frozen=True)
class Shape(Array):
    """Samples of a lattice along each axis, of so many bricks at most: time and memory go with those."""

    most_bricks: int

    @property
    def bounds(self) -> str:
        return f"each {self.of.bounds}; at most {self.most_bricks} bricks"

    def holds(self, shape: tuple[int, ...]) -> bool:
        """True for a shape of no more bricks."""
        return math.prod(-(-n // BRICK) for n in shape) <= self.most_bricks

    def encode(self, value: Any, where: str) -> bytes:
        data = super().encode(value, where)
        if not self.holds(struct.unpack(f"<{self.count}I", data)):
            raise InvalidArgument(where, shown(value), self.bounds)
        return data

    def decode(self, cursor: Cursor, where: str) -> tuple[Any, ...]:
        value = super().decode(cursor, where)
        if not self.holds(value):
            raise cursor.corrupt(where, shown(value), self.bounds, self.smallest)
        return value


@dataclass(frozen=True)
class Pattern:
    """Characters that a text may be made of, as a regular expression and in words."""

    expression: str
    words: str

    def holds(self, text: str) -> bool:
        """True if all of `text` is allowed."""
        return re.fullmatch(self.expression, text) is not None


# control characters could make a file rewrite the screen of the terminal that describes it
TEXT: Final = Pattern(r"[^\x00-\x1f\x7f-\x9f]*", "no control characters")
LINES: Final = Pattern(r"[^\x00-\x08\x0b-\x1f\x7f-\x9f]*", "no control characters but tab and line feed")
NAME: Final = Pattern(r"[a-z][a-z0-9._-]*", "a small letter, then small letters, digits, `.`, `_`, `-`")


@dataclass(frozen=True)
class Text(FieldType):
    """A string: its length in bytes as u16, then UTF-8."""

    limit: int
    pattern: Pattern = TEXT
    least: int = 0

    @property
    def wire(self) -> str:
        return "str"

    @property
    def bounds(self) -> str:
        least = f"{self.least} to " if self.least else "at most "
        return f"{least}{self.limit} bytes, {self.pattern.words}"

    @property
    def smallest(self) -> int:
        return 2 + self.least

    @property
    def largest(self) -> int:
        return 2 + self.limit

    def encode(self, value: Any, where: str) -> bytes:
        try:
            data = value.encode("utf-8") if isinstance(value, str) else None
        except UnicodeEncodeError:
            data = None
        if data is None or not self.least <= len(data) <= self.limit or not self.pattern.holds(value):
            raise InvalidArgument(where, shown(value), f"a string, {self.bounds}")
        return struct.pack("<H", len(data)) + data

    def decode(self, cursor: Cursor, where: str) -> str:
        length: int = struct.unpack("<H", cursor.take(2, where))[0]
        if not self.least <= length <= self.limit:
            raise cursor.corrupt(where, f"a length of {length} bytes", self.bounds, 2)
        data = cursor.take(length, where)
        try:
            text = data.decode("utf-8")
        except UnicodeDecodeError:
            raise cursor.corrupt(where, "bytes that are not UTF-8", self.bounds, length) from None
        if not self.pattern.holds(text):
            raise cursor.corrupt(where, shown(text), self.bounds, length)
        return text


@dataclass(frozen=True)
class Octets(FieldType):
    """Bytes that another document explains: their number as u32, then they."""

    limit: int

    @property
    def wire(self) -> str:
        return "bytes"

    @property
    def bounds(self) -> str:
        return f"at most {self.limit} bytes"

    @property
    def smallest(self) -> int:
        return 4

    @property
    def largest(self) -> int:
        return 4 + self.limit

    def encode(self, value: Any, where: str) -> bytes:
        data = octets(value, where)
        if len(data) > self.limit:
            raise InvalidArgument(where, f"{len(data)} bytes", self.bounds)
        return struct.pack("<I", len(data)) + data

    def decode(self, cursor: Cursor, where: str) -> bytes:
        length: int = struct.unpack("<I", cursor.take(4, where))[0]
        if length > self.limit:
            raise cursor.corrupt(where, f"a length of {length} bytes", self.bounds, 4)
        return cursor.take(length, where)


@dataclass(frozen=True)
class Rest(FieldType):
    """All bytes up to the end of the payload; the last field of a record."""

    @property
    def wire(self) -> str:
        return "rest"

    @property
    def bounds(self) -> str:
        return "any"

    @property
    def smallest(self) -> int:
        return 0

    @property
    def largest(self) -> int:
        return 1 << 63

    def encode(self, value: Any, where: str) -> bytes:
        return octets(value, where)

    def decode(self, cursor: Cursor, where: str) -> bytes:
        return cursor.take(cursor.remaining, where)


@dataclass(frozen=True)
class Listed(FieldType):
    """A list of any length: the number of its members as u16 or u32, then they; a tuple in Python."""

    of: FieldType
    limit: int
    code: str = "u16"

    @property
    def wire(self) -> str:
        return f"list ({self.code}) of {self.of.wire}"

    @property
    def bounds(self) -> str:
        return f"at most {self.limit}; each {self.of.bounds}"

    @property
    def smallest(self) -> int:
        return struct.calcsize(WHOLE_CODES[self.code])

    @property
    def largest(self) -> int:
        return self.smallest + self.limit * self.of.largest

    def encode(self, value: Any, where: str) -> bytes:
        if not isinstance(value, (list, tuple)) or len(value) > self.limit:
            raise InvalidArgument(where, shown(value), f"a list of at most {self.limit}")
        members = [self.of.encode(member, f"{where}[{i}]") for i, member in enumerate(value)]
        return struct.pack(WHOLE_CODES[self.code], len(value)) + b"".join(members)

    def decode(self, cursor: Cursor, where: str) -> tuple[Any, ...]:
        size = self.smallest
        count: int = struct.unpack(WHOLE_CODES[self.code], cursor.take(size, where))[0]
        if count > self.limit:
            raise cursor.corrupt(where, f"{count} members", f"at most {self.limit}", size)
        if count * self.of.smallest > cursor.remaining:
            found = f"{count} members in {cursor.remaining} bytes"
            raise cursor.corrupt(where, found, f"at least {self.of.smallest} bytes each", size)
        return tuple(self.of.decode(cursor, f"{where}[{i}]") for i in range(count))


def octets(value: Any, where: str) -> bytes:
    """`value` as bytes, without a copy where it is bytes; InvalidArgument where it is not bytes-like."""
    if isinstance(value, bytes):
        return value
    if isinstance(value, (bytearray, memoryview)):
        return bytes(value)
    raise InvalidArgument(where, shown(value), "bytes")


def shown(value: object) -> str:
    """`value` in a message: escaped, in one line, and not longer than a line."""
    text = ascii(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
