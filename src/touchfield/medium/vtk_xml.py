"""The XML of a VTK file and the data that stand in it or behind it.

Format: "VTK File Formats", XML formats. Raw appended data are no XML, so the markup is read only up to them.
A document type declaration is refused: there lie the entities that expand without end.
"""

from __future__ import annotations

import base64
import binascii
import re
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from xml.parsers import expat

import numpy as np

from touchfield.errors import SourceError
from touchfield.files import require_plain

__all__ = ["BlockStream", "Node", "VtkFile", "whole_numbers"]

DEFLATE_LIMIT: Final = 1100
"""Deflate cannot expand by more than 1032."""


@dataclass
class Node:
    """An element: its tag, attributes, elements within and text."""

    tag: str
    attributes: dict[str, str]
    children: list[Node] = field(default_factory=list)
    text: list[str] = field(default_factory=list)

    def all(self, *tags: str) -> list[Node]:
        """The elements directly within that have one of these tags."""
        return [child for child in self.children if child.tag in tags]


class VtkFile:
    """A parsed ``.vti`` or ``.pvd``.

    Attributes
    ----------
    root : Node; The VTKFile element.

    Raises `SourceError` if the file cannot be read, is no VTK XML, or declares a document type.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        raw = self._read(0, None)
        mark = raw.find(b"<AppendedData")
        head_end = len(raw) if mark < 0 else raw.find(b">", mark) + 1
        top = Node("", {})
        self._parse(raw[: head_end or len(raw)], top, is_whole=mark < 0)
        if len(top.children) != 1 or top.children[0].tag != "VTKFile":
            raise SourceError(str(path), "no VTKFile element", "a VTK XML file (.vti, .pvd)")
        self.root = top.children[0]
        self._base, self._end = 0, len(raw)
        self._is_raw = True
        if mark >= 0:
            self._base = raw.find(b"_", head_end) + 1
            close = raw.rfind(b"</AppendedData")
            self._end = close if close > self._base else len(raw)
            appended = self.root.all("AppendedData")
            self._is_raw = bool(appended) and appended[0].attributes.get("encoding", "raw") == "raw"
            if self._base == 0:
                raise self.fault("no data after AppendedData", "an underscore and the data")
        self._offsets = sorted(self._all_offsets(self.root))

    def fault(self, found: str, expected: str = "", mend: str = "") -> SourceError:
        """An error about this file."""
        return SourceError(str(self.path), found, expected, mend)

    def _read(self, start: int, stop: int | None) -> bytes:
        require_plain(self.path, "a VTK XML file")
        try:
            with self.path.open("rb") as stream:
                stream.seek(start)
                return stream.read() if stop is None else stream.read(stop - start)
        except OSError as error:
            raise self.fault(f"that it cannot be read: {error.strerror}") from error

    def _parse(self, text: bytes, top: Node, is_whole: bool) -> None:
        parser = expat.ParserCreate()
        parser.buffer_text = True
        stack = [top]

        def start(tag: str, attributes: dict[str, str]) -> None:
            node = Node(tag, attributes)
            stack[-1].children.append(node)
            stack.append(node)

        def refuse(*_: object) -> None:
            raise self.fault("a document type declaration", "plain VTK XML", "Remove the DOCTYPE.")

        parser.StartElementHandler = start
        parser.EndElementHandler = lambda _tag: stack.pop()
        parser.CharacterDataHandler = lambda data: stack[-1].text.append(data)
        parser.StartDoctypeDeclHandler = refuse
        try:
            parser.Parse(text, is_whole)
        except (expat.ExpatError, ValueError, LookupError) as error:
            if isinstance(error, SourceError):
                raise
            raise self.fault(f"broken XML ({error})", "a whole VTK XML file") from error

    def _all_offsets(self, node: Node) -> set[int]:
        found = set()
        waiting = [node]
        while waiting:
            node = waiting.pop()
            waiting += node.children
            if node.attributes.get("format") == "appended":
                found.add(self.offset(node))
        return found

    def offset(self, array: Node) -> int:
        """Where an appended array begins, counted from the underscore."""
        text = array.attributes.get("offset", "").strip()
        if not (text.isascii() and text.isdigit() and len(text) <= 30):
            raise self.fault(f"the offset {text[:40]!r}", "a whole number")
        return int(text)

    def blob(self, array: Node) -> bytes:
        """The bytes of a binary or appended array as stored, base64 undone: sizes, then data."""
        if array.attributes.get("format") != "appended":
            return self._from_base64("".join(array.text).encode("utf-8"))
        offset = self.offset(array)
        later = [o for o in self._offsets if o > offset]
        stop = min(self._end, self._base + later[0]) if later else self._end
        if self._base + offset >= stop:
            raise self.fault(
                f"an array at offset {offset}", f"one below {self._end - self._base}", "The file is cut."
            )
        stored = self._read(self._base + offset, stop)
        return stored if self._is_raw else self._from_base64(stored)

    def _from_base64(self, text: bytes) -> bytes:
        """Base64 in several parts, each with its own padding, as VTK writes sizes and data."""
        parts = re.split(rb"=+", text.translate(None, b" \t\r\n"))
        try:
            return b"".join(base64.b64decode(p + b"=" * (-len(p) % 4), validate=True) for p in parts)
        except binascii.Error as error:
            raise self.fault(f"broken base64 ({error})", "data in base64") from error


class BlockStream:
    """The values of one array, with its blocks inflated as they are read.

    Parameters
    ----------
    blob : bytes; Sizes, then data.
    expected : int; Bytes that the array must have.
    size_type : numpy.dtype; Of the sizes (the file's header_type).
    where : str; For messages.

    Raises `SourceError` if the sizes contradict the bytes or `expected`.
    """

    def __init__(
        self, blob: bytes, expected: int, size_type: np.dtype[np.unsignedinteger], is_zlib: bool, where: str
    ):
        self._blob, self._where, self._width = blob, where, size_type.itemsize
        self._size_type = size_type
        self._waiting = bytearray()
        self._blocks: list[tuple[int, int]] = []  # stored bytes, bytes inflated
        if is_zlib:
            total = self._read_table()
        else:
            (total,) = self._sizes(0, 1)
            self._position = self._width
            if total > len(blob) - self._position:
                raise self._fault(f"{len(blob) - self._position} bytes", f"{total}")
        if total != expected:
            raise self._fault(f"{total} bytes of values", f"{expected}, as the extent says")

    def _fault(self, found: str, expected: str) -> SourceError:
        return SourceError(self._where, found, expected, "The file is cut short or damaged.")

    def _sizes(self, first: int, count: int) -> list[int]:
        end = (first + count) * self._width
        if count < 0 or end > len(self._blob):
            raise self._fault(f"{len(self._blob)} bytes", f"at least {end} for the sizes")
        return [int(n) for n in np.frombuffer(self._blob[first * self._width : end], self._size_type)]

    def _read_table(self) -> int:
        (count,) = self._sizes(0, 1)
        self._position = self._width
        if count == 0:
            return 0
        block, last = self._sizes(1, 2)
        stored = self._sizes(3, count)
        self._position = (3 + count) * self._width
        inflated = [block] * (count - 1) + [last or block]
        if sum(stored) > len(self._blob) - self._position:
            raise self._fault(f"{len(self._blob) - self._position} bytes", f"{sum(stored)} for the blocks")
        if any(full > DEFLATE_LIMIT * held for held, full in zip(stored, inflated, strict=True)):
            raise self._fault("a block larger than zlib can make of its bytes", "zlib blocks")
        self._blocks = list(zip(stored, inflated, strict=True))[::-1]
        return sum(inflated)

    def read(self, count: int) -> bytes:
        """The next `count` bytes."""
        if self._blocks or self._waiting:
            while len(self._waiting) < count and self._blocks:
                self._waiting += self._inflate(*self._blocks.pop())
            data = bytes(self._waiting[:count])
            del self._waiting[:count]
            return data
        data = self._blob[self._position : self._position + count]
        self._position += count
        return data

    def _inflate(self, stored: int, inflated: int) -> bytes:
        data = self._blob[self._position : self._position + stored]
        self._position += stored
        try:
            values = zlib.decompressobj().decompress(data, inflated + 1)
        except zlib.error as error:
            raise self._fault(f"a broken block ({error})", "zlib data") from error
        if len(values) != inflated:
            raise self._fault(f"a block of {len(values)} bytes", f"{inflated}")
        return values


def whole_numbers(text: str, count: int) -> list[int] | None:
    """`count` whole numbers, or None where the text does not hold them."""
    words = text.split()
    if len(words) != count or not all(re.fullmatch(r"-?\d{1,9}", w) for w in words):
        return None
    return [int(w) for w in words]
