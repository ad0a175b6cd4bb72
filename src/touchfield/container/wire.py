"""One record between its bytes and its value, whatever its row of the table: frame, payload, CRC-32.

Bytes are checked in this order: the frame fits into the file, the CRC-32 holds, the flags are obeyed, the
fields are read. Nothing of a record is believed before its CRC-32 has been checked, but for its length, which
is bounded by the bytes that are there.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import Any, Final

from touchfield.container.cursor import Cursor
from touchfield.container.layout import Struct
from touchfield.container.records import (
    MAGIC,
    RECORD_OF,
    REQUIRED,
    VERSION_MAJOR,
    VERSION_MINOR,
    Frame,
    Opening,
    Record,
)
from touchfield.container.source import ByteSource
from touchfield.errors import CorruptFile, ForeignFile, TruncatedFile, UnsupportedVersion

__all__ = [
    "CRC_SIZE",
    "FRAME_SIZE",
    "OPENING_SIZE",
    "FoundRecord",
    "encode_opening",
    "encode_record",
    "find_record",
    "known_record",
    "read_opening",
    "read_record",
]

FRAME: Final = Struct(Frame)
FRAME_SIZE: Final = FRAME.smallest
CRC_SIZE: Final = 4
OPENING_SIZE: Final = len(MAGIC) + Struct(Opening).smallest
CHUNK: Final = 1 << 20


# -- writing ----------------------------------------------------------------------------------------------


def encode_opening(version_minor: int) -> bytes:
    """The magic, our major version, and the minor version that a file needs."""
    opening = Opening(version_major=VERSION_MAJOR, version_minor=version_minor)
    return MAGIC + Struct(Opening).encode(opening, "opening")


def encode_record(tag: str, value: Any) -> bytes:
    """A whole record, its CRC-32 last; InvalidArgument if a field of `value` is out of bounds."""
    record = RECORD_OF[tag]
    payload = record.kind.encode(value, tag)
    flags = REQUIRED if record.required else 0
    frame = Frame(tag=tag, flags=flags, since_minor=record.since_minor, payload_length=len(payload))
    framed = FRAME.encode(frame, tag) + payload
    return framed + struct.pack("<I", zlib.crc32(framed))


# -- reading ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class FoundRecord:
    """A record whose frame has been read, but not its payload.

    Attributes
    ----------
    frame : Frame
    offset : int
        Position of its tag in the file.
    """

    frame: Frame
    offset: int

    @property
    def payload_offset(self) -> int:
        """Position of its payload."""
        return self.offset + FRAME_SIZE

    @property
    def crc_offset(self) -> int:
        """Position of its CRC-32."""
        return self.payload_offset + self.frame.payload_length

    @property
    def end(self) -> int:
        """Position of the byte after it."""
        return self.crc_offset + CRC_SIZE

    @property
    def name(self) -> str:
        """What to call it in messages."""
        return f"{self.frame.tag} record at byte {self.offset}"


def read_opening(source: ByteSource) -> bytes:
    """The bytes of magic and version, both checked.

    Raises
    ------
    ForeignFile, CorruptFile, TruncatedFile, UnsupportedVersion
        If it is something else, was changed as text, is too short, or has a major version above ours.
    """
    start = source.read_at(0, min(source.size, OPENING_SIZE))
    magic = start[: len(MAGIC)]
    if not start:
        raise ForeignFile(source.name, "an empty file", "a .touch file")
    if magic != MAGIC[: len(magic)]:
        if any(magic[i : i + 5] == b"TOUCH" for i in (1, 2, 3)):
            found = f"{magic!r}, as a .touch file begins that was transferred as text"
            raise CorruptFile(source.name, found, f"{MAGIC!r}", "Transfer it again in binary mode.")
        raise ForeignFile(source.name, f"a file that begins with {magic!r}", f"a .touch file: {MAGIC!r}")
    version = start[len(MAGIC) :]
    if len(start) < OPENING_SIZE:
        raise TruncatedFile(source.name, f"{len(start)} bytes", f"at least {OPENING_SIZE}", "Fetch it again.")
    opening = Struct(Opening).decode(Cursor(version, source.name, len(MAGIC)), "opening")
    if opening.version_major > VERSION_MAJOR:
        raise newer(source.name, opening.version_major, opening.version_minor, "a file")
    return start


def newer(where: str, major: int, minor: int, what: str) -> UnsupportedVersion:
    """The error of something that a later version of the format brought."""
    return UnsupportedVersion(
        where,
        f"{what} of format {major}.{minor}",
        f"at most format {VERSION_MAJOR}.{VERSION_MINOR}",
        f"Read it with a touchfield that reads format {major}.{minor}.",
    )


def find_record(source: ByteSource, offset: int, end: int) -> FoundRecord:
    """The record at `offset`, which must end by `end`; its payload is not read.

    Raises
    ------
    TruncatedFile
        If the file ends before the record does.
    CorruptFile
        If the frame makes no sense, or the record reaches beyond `end`.
    """
    start = source.read_at(offset, FRAME_SIZE)
    found = FoundRecord(FRAME.decode(Cursor(start, source.name, offset), "record"), offset)
    if found.end > source.size:
        mend = "Fetch or write the file again."
        raise TruncatedFile(f"{source.name}: {found.name}", f"{source.size} bytes", f"{found.end} bytes", mend)
    if found.end > end:
        raise CorruptFile(f"{source.name}: {found.name}", f"that it ends at byte {found.end}", f"at most {end}")
    return found


def check_crc(source: ByteSource, found: FoundRecord) -> int:
    """Check the CRC-32 of a record piece by piece, without holding it, and return it."""
    crc, place = 0, found.offset
    while place < found.crc_offset:
        size = min(CHUNK, found.crc_offset - place)
        crc = zlib.crc32(source.read_at(place, size), crc)
        place += size
    return compare_crc(source, found, crc, source.read_at(found.crc_offset, CRC_SIZE))


def compare_crc(source: ByteSource, found: FoundRecord, crc: int, stored: bytes) -> int:
    """`crc` if it is the stored one; CorruptFile otherwise."""
    if stored != struct.pack("<I", crc):
        expected = struct.unpack("<I", stored)[0]
        mend = "Bytes of this record were changed: fetch or write the file again."
        raise CorruptFile(f"{source.name}: {found.name}", f"CRC-32 {crc:08x}", f"{expected:08x}", mend)
    return crc


def known_record(source: ByteSource, found: FoundRecord) -> Record | None:
    """The table's row for a record whose CRC-32 holds; None if it may be skipped.

    Raises
    ------
    UnsupportedVersion
        If it is unknown, or newer than we know it, and required.
    CorruptFile
        If its flags or version are not those of the table.
    """
    frame = found.frame
    record = RECORD_OF.get(frame.tag)
    if record is None or frame.since_minor > VERSION_MINOR:
        if frame.flags & REQUIRED:
            raise newer(f"{source.name}: {found.name}", VERSION_MAJOR, frame.since_minor, "a required record")
        return None
    flags = REQUIRED if record.required else 0
    if (frame.flags, frame.since_minor) != (flags, record.since_minor):
        wrong = f"flags {frame.flags}, since_minor {frame.since_minor}"
        right = f"flags {flags}, since_minor {record.since_minor}"
        raise CorruptFile(f"{source.name}: {found.name}", wrong, right)
    return record


def read_record(source: ByteSource, found: FoundRecord, tag: str) -> tuple[Any, int]:
    """The value and the CRC-32 of a record that must be a `tag`.

    Raises
    ------
    CorruptFile
        If it is another one, its CRC-32 does not hold, or a field is out of bounds.
    UnsupportedVersion
        If it needs a later version.
    """
    where = f"{source.name}: {found.name}"
    length, kind = found.frame.payload_length, RECORD_OF[tag].kind
    if found.frame.tag != tag:
        check_crc(source, found)
        known_record(source, found)
        raise CorruptFile(where, f"a record {found.frame.tag}", f"a record {tag}")
    if found.frame.since_minor <= VERSION_MINOR and not kind.smallest <= length <= kind.largest:
        raise CorruptFile(where, f"a payload of {length} bytes", f"{kind.smallest} to {kind.largest} bytes")
    data = source.read_at(found.offset, found.end - found.offset)
    crc = compare_crc(source, found, zlib.crc32(memoryview(data)[:-CRC_SIZE]), data[-CRC_SIZE:])
    if known_record(source, found) is None:
        raise CorruptFile(where, "an optional record", f"a record {tag} of format {VERSION_MAJOR}.{VERSION_MINOR}")
    cursor = Cursor(data, source.name, found.offset, FRAME_SIZE, -CRC_SIZE)
    value = kind.decode(cursor, tag)
    if cursor.remaining:
        raise cursor.corrupt(tag, f"{cursor.remaining} bytes after the last field", "none")
    return value, crc
