"""Converts one record of a ``.touch`` file between its bytes and its values: the tag, length and CRC-32
around it, and the fields inside.

Checks are made in this order: the frame fits into the file, the CRC-32 matches, the flags are known, the
fields are valid. Nothing in a record is used before its CRC-32 has been checked, except its length, which is
bounded by the available bytes.
"""

from __future__ import annotations

import io
import os
import re
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from threading import Lock
from typing import Any, BinaryIO, Final, NamedTuple, TypeVar

from touchfield.container.fields import Cursor, quoted
from touchfield.container.records import (
    MAGIC,
    RECORD_OF,
    REQUIRED,
    TAG_OF,
    VERSION_MAJOR,
    VERSION_MINOR,
    Record,
)
from touchfield.container.remote import RemoteFile, is_remote
from touchfield.errors import (
    CorruptFile,
    ForeignFile,
    InvalidArgument,
    SourceError,
    TruncatedFile,
    UnsupportedVersion,
    reason,
)
from touchfield.files import file_error, require_plain
from touchfield.medium.budget import memory_budget_bytes


class ByteSource:
    """A file with random access: a path, an address, or an open binary file.

    An address is, for example, https://host/x.touch. An open file must be seekable; it is read from its first
    byte and left open. `name` is its name in messages, `size` its length in bytes, `remote` the remote file
    or None. `SourceError` if it cannot be opened or read, `InvalidArgument` if it is none of these.
    """

    def __init__(self, file: str | os.PathLike[str] | BinaryIO) -> None:
        self._lock = Lock()
        self.remote = RemoteFile(str(file)) if is_remote(file) else None
        if self.remote is not None:
            self.name, self.size = self.remote.name, self.remote.size
            return
        self._owned = isinstance(file, (str, os.PathLike))
        if isinstance(file, (str, os.PathLike)):
            self.name = os.fspath(file)
            self._file = _open(Path(file))
        else:
            self.name = str(getattr(file, "name", "open file"))
            if isinstance(file, io.TextIOBase):
                raise InvalidArgument(
                    self.name, "a file that is open for text", hint='Open it with the mode "rb".'
                )
            self._file = file
        try:
            self.size = self._file.seek(0, os.SEEK_END)
        except (OSError, ValueError, AttributeError, TypeError) as error:
            self.close()
            raise InvalidArgument(
                self.name, reason(error), "a path or an open, seekable, binary file"
            ) from None

    def read_at(self, offset: int, size: int) -> bytes:
        """`size` bytes from `offset` on; TruncatedFile if the file ends earlier.

        Before anything is allocated, the size is compared with that of the file and with
        `memory_budget_bytes`; a sparse file may be larger than the memory.
        """
        if offset + size > self.size:
            found = f"{max(0, self.size - offset)} bytes at byte {offset}, then the end of the file"
            raise TruncatedFile(self.name, found, f"{size} bytes", "Fetch or write the file again.")
        if size > (allowed := memory_budget_bytes()):
            found, expected = f"{size} bytes at byte {offset}, to be read at once", f"at most {allowed}"
            raise InvalidArgument(self.name, found, expected, "Set TOUCHFIELD_MEMORY_GIB.")
        if self.remote is not None:
            return self.remote.read_at(offset, size)
        try:
            with self._lock:
                self._file.seek(offset)
                data = self._file.read(size)
                while len(data) < size and (more := self._file.read(size - len(data))):
                    data += more
        except (OSError, ValueError, TypeError, MemoryError) as error:
            raise SourceError(self.name, reason(error), f"{size} readable bytes at byte {offset}") from None
        if len(data) < size:
            found = f"{len(data)} bytes at byte {offset}, where there were more before"
            raise TruncatedFile(
                self.name, found, f"{size} bytes", "Let nothing write to the file while it is read."
            )
        return data

    def expect(self, start: int, stop: int) -> None:
        """Fetch bytes `start` to `stop` of a remote file in one request."""
        if self.remote is not None:
            self.remote.fetch(start, stop)

    def close(self) -> None:
        """Close the file, unless it was open before."""
        if self.remote is not None:
            self.remote.close()
        elif self._owned:
            self._file.close()


def _open(path: Path) -> BinaryIO:
    """The file at `path`, open for reading."""
    try:
        require_plain(path, "a .touch file")
        return path.open("rb")
    except (OSError, ValueError) as error:
        raise file_error(path, error, "a .touch file") from None


_MOVIES: Final = (".mp4", ".m4v", ".mov", ".mkv", ".webm", ".ts", ".mts", ".m2ts", ".m3u8")

FRAME: Final = struct.Struct("<4sIQ")
"""Tag, flags and length of the payload."""

VERSION: Final = struct.Struct("<HH")
FRAME_SIZE: Final = FRAME.size
CRC_SIZE: Final = 4
OPENING: Final = MAGIC + VERSION.pack(VERSION_MAJOR, VERSION_MINOR)
OPENING_SIZE: Final = len(OPENING)
CHUNK: Final = 1 << 20
_Layout = TypeVar("_Layout")
FETCH_AGAIN: Final = "Fetch or write the file again."


# -- writing -----------------------------------------------------------------------------------------------


def encode_record(tag: str, value: Any) -> bytes:
    """The bytes of a record, its CRC-32 last.

    InvalidArgument if a field of `value` is out of bounds.
    """
    record = RECORD_OF[tag]
    return framed(tag, record.kind.encode(value, tag), is_required=record.required)


def framed(tag: str, payload: bytes, *, is_required: bool) -> bytes:
    """The bytes of a record of this payload, its CRC-32 last."""
    data = FRAME.pack(tag.encode("ascii"), REQUIRED if is_required else 0, len(payload)) + payload
    return data + struct.pack("<I", zlib.crc32(data))


# -- reading -----------------------------------------------------------------------------------------------


class FoundRecord(NamedTuple):
    """A record whose frame has been read, but not its payload.

    `offset` is the position of its tag in `file`.
    """

    file: str
    tag: str
    flags: int
    payload_length: int
    offset: int

    @property
    def crc_offset(self) -> int:
        """Position of its CRC-32."""
        return self.offset + FRAME_SIZE + self.payload_length

    @property
    def end(self) -> int:
        """Position of the byte after it."""
        return self.crc_offset + CRC_SIZE

    @property
    def where(self) -> str:
        """Its name in messages."""
        return f"{self.file}: {self.tag} record at byte {self.offset}"


def read_opening(source: ByteSource) -> bytes:
    """The bytes of magic and version, both checked.

    `ForeignFile` if it is another kind of file, `CorruptFile` if it was transferred as text, `TruncatedFile`
    if it is too short, `UnsupportedVersion` if it has another major version.
    """
    start = source.read_at(0, min(source.size, OPENING_SIZE))
    magic = start[: len(MAGIC)]
    if not start:
        raise ForeignFile(source.name, "an empty file", "a .touch file")
    if magic != MAGIC[: len(magic)]:
        if any(magic[i : i + 5] == b"TOUCH" for i in (1, 2, 3)):
            found = f"{magic!r}, as a .touch file begins that was transferred as text"
            raise CorruptFile(source.name, found, f"{MAGIC!r}", "Transfer it again in binary mode.")
        hint = ""
        if Path(source.name).suffix.lower() in _MOVIES:
            hint = "The touch of a movie becomes a .touch file by: touchfield demux MOVIE OUT.touch."
        found = f"a file that begins with {magic!r}"
        raise ForeignFile(source.name, found, f"a .touch file: {MAGIC!r}", hint)
    if len(start) < OPENING_SIZE:
        raise TruncatedFile(source.name, f"{len(start)} bytes", f"at least {OPENING_SIZE}", FETCH_AGAIN)
    major, minor = VERSION.unpack(start[len(MAGIC) :])
    if major < VERSION_MAJOR:
        found = f"format {major}.{minor}, made by a version before 1.0"
        mend = "Encode it again from its source."
        raise UnsupportedVersion(source.name, found, f"format {VERSION_MAJOR}", mend)
    if major > VERSION_MAJOR:
        mend = f"Read it with a touchfield that reads format {major}.{minor}."
        raise UnsupportedVersion(source.name, f"format {major}.{minor}", f"format {VERSION_MAJOR}", mend)
    return start


def find_record(source: ByteSource, offset: int, end: int) -> FoundRecord:
    """The record at `offset`, which must end at or before `end`.

    Its payload is not read. `TruncatedFile` if the file ends before the record, `CorruptFile` if its frame is
    invalid or it exceeds `end`.
    """
    tag, flags, length = FRAME.unpack(source.read_at(offset, FRAME_SIZE))
    if not re.fullmatch(rb"[A-Z0-9]{4}", tag):
        found, expected = quoted(tag), "four capitals A to Z or digits"
        raise CorruptFile(f"{source.name}: record.tag at byte {offset}", found, expected, FETCH_AGAIN)
    if flags > REQUIRED:
        raise CorruptFile(
            f"{source.name}: record.flags at byte {offset + 4}", str(flags), "0 or 1", FETCH_AGAIN
        )
    record = FoundRecord(source.name, tag.decode("ascii"), flags, length, offset)
    if record.end > source.size:
        raise TruncatedFile(record.where, f"{source.size} bytes", f"{record.end} bytes", FETCH_AGAIN)
    if record.end > end:
        raise CorruptFile(record.where, f"that it ends at byte {record.end}", f"at most {end}", FETCH_AGAIN)
    return record


def records_between(source: ByteSource, start: int, stop: int) -> Iterator[FoundRecord]:
    """The records from `start` to `stop`, one after the other, as from `find_record`."""
    while start < stop:
        found = find_record(source, start, stop)
        yield found
        start = found.end


def check_crc(source: ByteSource, found: FoundRecord) -> None:
    """Check the CRC-32 of a record in chunks, without loading it as a whole."""
    crc, position = 0, found.offset
    while position < found.crc_offset:
        size = min(CHUNK, found.crc_offset - position)
        crc = zlib.crc32(source.read_at(position, size), crc)
        position += size
    _compare_crc(found, crc, source.read_at(found.crc_offset, CRC_SIZE))


def _compare_crc(found: FoundRecord, crc: int, stored: bytes) -> None:
    """CorruptFile unless `crc` equals the stored one."""
    if stored != struct.pack("<I", crc):
        expected = struct.unpack("<I", stored)[0]
        mend = "Bytes of this record were changed: fetch or write the file again."
        raise CorruptFile(found.where, f"CRC-32 {crc:08x}", f"{expected:08x}", mend)


def known_record(found: FoundRecord) -> Record | None:
    """The table entry of a record whose CRC-32 matches; None if it may be skipped.

    `UnsupportedVersion` if it is unknown and required, `CorruptFile` if its flags differ from those in the
    table.
    """
    record = RECORD_OF.get(found.tag)
    if record is None:
        if found.flags & REQUIRED:
            expected, mend = (
                f"those of format {VERSION_MAJOR}.{VERSION_MINOR}",
                "Read it with a later touchfield.",
            )
            raise UnsupportedVersion(found.where, "a required record", expected, mend)
    elif found.flags != (REQUIRED if record.required else 0):
        raise CorruptFile(found.where, f"flags {found.flags}", f"flags {1 - found.flags}", FETCH_AGAIN)
    return record


def read_record(source: ByteSource, found: FoundRecord, layout: type[_Layout]) -> tuple[_Layout, int]:
    """The value and the CRC-32 of a record that must have this layout.

    `CorruptFile` if the record is of another kind, its CRC-32 does not match, or a field is out of bounds;
    `UnsupportedVersion` if it requires a later version.
    """
    length, tag = found.payload_length, TAG_OF[layout]
    kind = RECORD_OF[tag].kind
    if found.tag != tag:
        check_crc(source, found)
        known_record(found)
        raise CorruptFile(found.where, f"a record {found.tag}", f"a record {tag}", FETCH_AGAIN)
    if not kind.smallest <= length <= kind.largest:
        bounds = f"{kind.smallest} to {kind.largest} bytes"
        raise CorruptFile(found.where, f"a payload of {length} bytes", bounds, FETCH_AGAIN)
    data = source.read_at(found.offset, found.end - found.offset)
    crc = zlib.crc32(memoryview(data)[:-CRC_SIZE])
    _compare_crc(found, crc, data[-CRC_SIZE:])
    known_record(found)
    cursor = Cursor(data, source.name, found.offset, FRAME_SIZE, -CRC_SIZE)
    value = kind.decode(cursor, tag)
    if cursor.remaining:
        raise cursor.corrupt(tag, f"{cursor.remaining} bytes after the last field", "none")
    return value, crc
