"""Writes a ``.touch`` file: the head first, then segment by segment, then the index and the end.

The file has a temporary name until it is complete.
"""

from __future__ import annotations

import errno
import os
import zlib
from collections.abc import Iterable, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Final

from touchfield.atomic import atomic_path
from touchfield.container.fields import Cursor
from touchfield.container.map_record import TAG as MAP_TAG, TactileMap, encode_map
from touchfield.container.records import (
    MAX_OBJECTS,
    OBJECTS_CODER,
    RECORD_OF,
    End,
    Head,
    Index,
    ObjectRecord,
    Pair,
    Provenance,
    SegmentEntry,
)  # fmt: skip
from touchfield.container.wire import CRC_SIZE, FRAME_SIZE, OPENING, encode_record, framed
from touchfield.errors import InvalidArgument, SourceError, reason

MENDS: Final = {
    errno.ENOSPC: "Free some space, or write to another disk.",
    errno.EDQUOT: "Free some of your quota, or write to another disk.",
    errno.EFBIG: "Write to a file system that takes larger files.",
}


class TouchWriter:
    """Writer of one ``.touch`` file; a context manager.

    Segments are written at once to a temporary file in the same folder, so that only one segment and the
    index are in memory. At the end of the ``with`` block the index and the end record are added, and the file
    gets its name, replacing an existing file; after an exception nothing is left. A binary file that is
    already open is written to directly and left open.

    Every method raises `InvalidArgument` if a value is out of the format's bounds, the calls are in the wrong
    order, or the folder does not exist, and `SourceError` if the system refuses to write (no permission, no
    space).

    Examples
    --------
    >>> with TouchWriter("scene.touch") as writer:                                      # doctest: +SKIP
    ...     writer.write_head(head, {"source": "scene.obj"})
    ...     writer.write_segment(0, 8, body)
    """

    def __init__(self, file: str | os.PathLike[str] | BinaryIO) -> None:
        self._name = str(file)
        if "\0" in self._name:
            raise InvalidArgument("path", repr(self._name), "a path without NUL")
        self._stack, self._to = ExitStack(), file
        self._file: Any = None
        self._head: Head | None = None
        self._entries: list[SegmentEntry] = []
        self._position = 0
        self._is_intact = True
        self._next_frame = 0
        self._objects = 0
        self._vibrating: int | None = None
        self._chain = b""

    def __enter__(self) -> TouchWriter:
        if self._file is not None or self._position:
            raise InvalidArgument("TouchWriter", "one that was entered before", hint="Make a new one.")
        self._file = self._to
        if isinstance(self._to, (str, os.PathLike)):
            temporary = self._stack.enter_context(atomic_path(Path(self._to)))
            # without a buffer, so that closing the file writes nothing and cannot fail
            self._file = self._stack.enter_context(temporary.open("wb", buffering=0))
        return self

    def write_head(self, head: Head, provenance: Mapping[str, str] | None = None) -> None:
        """Write the properties of the whole file; once, before everything else."""
        if self._head is not None:
            raise InvalidArgument("write_head", "a second call", "one")
        opening, record, provenance_record = opening_of(head, provenance or {})
        self._put(opening + record + provenance_record)
        self._head = head
        self._chain = opening + record[-CRC_SIZE:]

    def write_object(self, record_value: ObjectRecord) -> None:
        """Write the next object of a file of coder `objects`, before the first segment."""
        coder = self._require_head("write_object").coder
        if coder != OBJECTS_CODER:
            raise InvalidArgument("write_object", f"a file of coder {coder!r}", repr(OBJECTS_CODER))
        if self._entries:
            raise InvalidArgument("write_object", "a call after the first segment", "all objects before it")
        if self._objects == MAX_OBJECTS:
            raise InvalidArgument(
                "write_object", f"more than {MAX_OBJECTS} objects", f"at most {MAX_OBJECTS}"
            )
        record = encode_record("OBJT", record_value)
        self._put(record)
        self._objects += 1
        self._chain += record[-CRC_SIZE:]

    def write_vibration(self, first_frame: int, frame_count: int, body: bytes) -> None:
        """Write the vibrations of the frames that `write_segment` writes next."""
        self._require_head("write_vibration")
        if self._vibrating is not None:
            raise InvalidArgument("write_vibration", "a second call for one segment", "one")
        self._put(self._frames("write_vibration", "VIBR", first_frame, frame_count, body))
        self._vibrating = int(frame_count)

    def write_segment(self, first_frame: int, frame_count: int, body: bytes) -> None:
        """Write the next group of frames, which must follow those of the group before."""
        if self._require_head("write_segment").coder == OBJECTS_CODER and not self._objects:
            raise InvalidArgument("write_segment", "no object yet", hint="Call write_object first.")
        if self._vibrating not in (None, frame_count):
            found, expected = f"{frame_count} frames", f"{self._vibrating}, as passed to write_vibration"
            raise InvalidArgument("write_segment frame_count", found, expected)
        record = self._frames("write_segment", "SEGM", first_frame, frame_count, body)
        frames = {"first_frame": int(first_frame), "frame_count": int(frame_count)}
        crc32 = int.from_bytes(record[-CRC_SIZE:], "little")
        entry = SegmentEntry(**frames, offset=self._position, length=len(record), crc32=crc32)
        self._put(record)
        self._entries.append(entry)
        self._next_frame += entry.frame_count
        self._vibrating = None

    def _require_head(self, call: str) -> Head:
        if self._head is None:
            raise InvalidArgument(call, "no head yet", hint="Call write_head first.")
        return self._head

    def _frames(self, call: str, tag: str, first_frame: int, frame_count: int, body: bytes) -> bytes:
        """The record of the next frames; InvalidArgument if they exceed those of the head."""
        if first_frame != self._next_frame:
            raise InvalidArgument(f"{call} first_frame", repr(first_frame), str(self._next_frame))
        layout = RECORD_OF[tag].layout
        record = encode_record(tag, layout(first_frame=first_frame, frame_count=frame_count, body=body))
        count = self._require_head(call).frame_count
        if first_frame + frame_count > count:
            raise InvalidArgument(
                call, f"frames up to {first_frame + frame_count - 1}", f"{count} frames, as the head says"
            )
        return record

    def _write_end(self) -> None:
        """Write the index and the end record, when all frames are written."""
        expected = None if self._head is None else self._head.frame_count
        if self._next_frame != expected:
            found = f"{self._next_frame} frames at its end" if expected else "no head at its end"
            raise InvalidArgument(self._name, found, f"{expected} frames" if expected else "a head")
        self._put(index_and_end(self._entries, self._position, self._chain))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                with self._stack:
                    self._write_end()
            else:
                # report the caller's error, even if cleaning up raises another one
                with suppress(SourceError):
                    self._stack.__exit__(kind, error, trace)
        finally:
            self._file = None

    def _put(self, data: bytes) -> None:
        if self._file is None:
            raise InvalidArgument("TouchWriter", "one that is not open", hint="Use it in a with block.")
        if not self._is_intact:
            raise InvalidArgument(self._name, "that a write failed before", hint="Begin again.")
        self._is_intact, rest = False, memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            mend = MENDS.get(error.errno or 0, "Write to another place.")
            raise SourceError(self._name, reason(error), "a file that can be written", mend) from None
        self._is_intact = True
        self._position += len(data)


def opening_of(head: Head, provenance: Mapping[str, str]) -> tuple[bytes, bytes, bytes]:
    """The start of a file: magic and version, HEAD, and PROV or b"".

    The last is b"" if there is no provenance.
    """
    pairs = tuple(Pair(key=key, value=value) for key, value in provenance.items())
    provenance_record = encode_record("PROV", Provenance(pairs=pairs)) if pairs else b""
    return OPENING, encode_record("HEAD", head), provenance_record


def index_and_end(entries: Iterable[SegmentEntry], position: int, chain: bytes) -> bytes:
    """The last records of a file, which start at `position`.

    `chain` is what `chain_crc32` covers in addition to the index.
    """
    index = encode_record("INDX", Index(segments=tuple(entries)))
    length = position + len(index) + FRAME_SIZE + RECORD_OF["TEND"].kind.smallest + CRC_SIZE
    chain_crc32 = zlib.crc32(chain + index[-CRC_SIZE:])
    return index + encode_record(
        "TEND", End(index_offset=position, file_length=length, chain_crc32=chain_crc32)
    )


def with_map(data: bytes, value: TactileMap) -> bytes:
    """The bytes of a file without a map, with the levels and the index of one.

    The record stands before the index; every other record keeps its bytes, but for the position of the index
    in the last one. Raises `InvalidArgument` for a value out of bounds.
    """
    tail = FRAME_SIZE + RECORD_OF["TEND"].kind.smallest + CRC_SIZE
    end: End = RECORD_OF["TEND"].kind.decode(Cursor(data, MAP_TAG, 0, len(data) - tail + FRAME_SIZE), "TEND")
    record = framed(MAP_TAG, encode_map(value), is_required=False)
    moved = End(
        index_offset=end.index_offset + len(record),
        file_length=len(data) + len(record),
        chain_crc32=end.chain_crc32,
    )
    index = data[end.index_offset : len(data) - tail]
    return data[: end.index_offset] + record + index + encode_record("TEND", moved)
