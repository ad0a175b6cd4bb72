"""Reading a ``.touch`` file: the head, the end and the index at once, a segment when it is asked for."""

from __future__ import annotations

import os
import weakref
import zlib
from bisect import bisect_right
from collections.abc import Mapping
from itertools import islice, takewhile
from threading import Lock
from types import MappingProxyType
from typing import BinaryIO, Final

from touchfield.container.records import (
    MAX_OBJECTS,
    OBJECTS_CODER,
    RECORD_OF,
    End,
    Head,
    Index,
    ObjectRecord,
    Provenance,
    Segment,
    SegmentEntry,
    Vibration,
)  # fmt: skip
from touchfield.container.wire import (
    AGAIN,
    CRC_SIZE,
    FRAME_SIZE,
    OPENING_SIZE,
    ByteSource,
    FoundRecord,
    check_crc,
    find_record,
    known_record,
    read_opening,
    read_record,
    records_between,
)  # fmt: skip
from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile

END_SIZE: Final = FRAME_SIZE + RECORD_OF["TEND"].kind.smallest + CRC_SIZE
MIN_SEGMENT: Final = FRAME_SIZE + RECORD_OF["SEGM"].kind.smallest + CRC_SIZE
MAX_WALKED: Final = 1 << 12
MOST_EXPECTED: Final = 1 << 24
"""Bytes that are fetched at once of a file elsewhere: what is before the first segment, and the index."""


class TouchReader:
    """Reads one ``.touch`` file; a context manager, and safe to use from several threads.

    Opening it costs what the head and the index cost, whatever the objects and the segments weigh.
    `FormatError`, or `SourceError` if it cannot be opened or read.

    Parameters
    ----------
    file : str, path or open binary file
        A path, or an address such as https://host/x.touch, of which only what is asked for is fetched. A file
        that is already open must be seekable; it is left open.

    Attributes
    ----------
    name, size, is_remote
        Its name in messages, its length in bytes, and whether it lies elsewhere.
    head : Head
    provenance : mapping of str to str
        Empty where the file states none.
    segments : tuple of SegmentEntry
        In the order of their frames.
    object_count : int
        Objects of a file of coder `objects`; otherwise none.
    has_vibration : bool
        Whether anything is told to vibrate beside the force; of a file elsewhere, beside the first segment.
    """

    def __init__(self, file: str | os.PathLike[str] | BinaryIO) -> None:
        self._source, self._lock = ByteSource(file), Lock()
        self.name, self.size = self._source.name, self._source.size
        self.is_remote = self._source.remote is not None
        try:
            self._open()
        except Exception:
            self.close()
            raise
        weakref.finalize(self, self._source.close)  # as long as somebody uses it, and no longer

    def __enter__(self) -> TouchReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file, unless it was open before."""
        self._source.close()

    def read_all(self) -> bytes:
        """The whole file."""
        return self._source.read_at(0, self.size)

    def read_segment(self, index: int) -> bytes:
        """The body of segment `index`, 0 to ``len(segments) - 1``, checked against its CRC-32 and the index."""
        entry = self._expected(index)
        found = find_record(self._source, entry.offset, entry.offset + entry.length)
        segment, crc = read_record(self._source, found, Segment)
        frames = {"first_frame": segment.first_frame, "frame_count": segment.frame_count}
        own = SegmentEntry(**frames, offset=found.offset, length=found.end - found.offset, crc32=crc)
        if own != entry:
            raise CorruptFile(found.where, str(own), f"{entry}, as the index says", AGAIN)
        return segment.body

    def read_vibration(self, index: int) -> bytes | None:
        """Vibrations in the frames of segment `index`, checked against its CRC-32; None where nothing does."""
        entry = self._expected(index)
        if index not in self._vibrations:
            return None
        found = self._vibrations[index]
        own, _ = read_record(self._source, found, Vibration)
        if (own.first_frame, own.frame_count) != (entry.first_frame, entry.frame_count):
            wrong = f"{own.frame_count} frames from frame {own.first_frame}"
            right = f"{entry.frame_count} from {entry.first_frame}, as in the segment behind it"
            raise CorruptFile(found.where, wrong, right, AGAIN)
        return own.body

    def read_object(self, index: int) -> ObjectRecord:
        """Object `index`, 0 to ``object_count - 1``, checked against its CRC-32."""
        if not 0 <= index < self.object_count:
            raise InvalidArgument("object", repr(index), f"0 to {self.object_count - 1}")
        one, _ = read_record(self._source, self._objects[index], ObjectRecord)
        return one

    def segment_of(self, frame: int) -> int:
        """The index of the segment that holds `frame`."""
        if not 0 <= frame < self.head.frame_count:
            raise InvalidArgument("frame", repr(frame), f"0 to {self.head.frame_count - 1}")
        return bisect_right(self._first_frames, frame) - 1

    # -- opening ------------------------------------------------------------------------------------------

    def _open(self) -> None:
        source = self._source
        opening = read_opening(source)
        head_record = find_record(source, OPENING_SIZE, source.size)
        self.head, _ = read_record(source, head_record, Head)
        end_record, end = self._read_end(head_record.end)
        source.expect(max(end.index_offset, end_record.end - MOST_EXPECTED), end_record.end)
        index_record = find_record(source, end.index_offset, end_record.offset)
        index, _ = read_record(source, index_record, Index)
        if index.segments and index.segments[0].offset - head_record.end <= MOST_EXPECTED:
            source.expect(head_record.end, index.segments[0].offset)
        self._objects = self._find_objects(head_record.end, index_record.offset)
        self.object_count = len(self._objects)
        chained = (head_record, *self._objects, index_record)
        chain = zlib.crc32(opening + b"".join(source.read_at(one.crc_offset, CRC_SIZE) for one in chained))
        if chain != end.chain_crc32:
            where, expected = f"{self.name}: TEND.chain_crc32", f"{end.chain_crc32:08x}"
            wrong = f"CRC-32 {chain:08x} of opening, HEAD, {self.object_count} OBJT and INDX"
            raise CorruptFile(where, wrong, expected, AGAIN)
        self.segments = index.segments
        self._first_frames = [entry.first_frame for entry in self.segments]
        self._check_segments(head_record.end, index_record.offset)
        # between the records that we know: at once, or of a file elsewhere where a segment is asked for
        ends = [head_record.end, *(entry.offset + entry.length for entry in self.segments), index_record.end]
        begins = [*(entry.offset for entry in self.segments), index_record.offset, end_record.offset]
        self._gaps = dict(enumerate(zip(ends, begins, strict=True)))
        self._vibrations: dict[int, FoundRecord] = {}
        self.provenance: Mapping[str, str] = MappingProxyType({})
        last = len(self.segments)
        for gap in (0, last, last + 1) if source.remote else range(last + 2):
            self._look_before(gap)
        self.has_vibration = bool(self._vibrations)

    def _read_end(self, head_end: int) -> tuple[FoundRecord, End]:
        """The end record and where it stands."""
        source = self._source
        try:
            found = find_record(source, max(head_end, source.size - END_SIZE), source.size)
            end, _ = read_record(source, found, End)
        except (CorruptFile, TruncatedFile) as error:
            for found in islice(records_between(source, head_end, source.size), MAX_WALKED):
                if found.tag == "TEND":  # it is whole, and stands elsewhere
                    read_record(source, found, End)
                    surplus = f"{source.size - found.end} bytes after it"
                    raise CorruptFile(found.where, surplus, "none", AGAIN) from error
            expected = "a TEND record, last"
            raise TruncatedFile(
                self.name, f"no end record in {source.size} bytes", expected, AGAIN
            ) from error
        if end.file_length != source.size:
            where, size = (
                f"{self.name}: TEND.file_length",
                f"{end.file_length} in a file of {source.size} bytes",
            )
            raise CorruptFile(
                where, size, "its length", "It was joined to another file, or cut within; " + AGAIN
            )
        if not head_end <= end.index_offset <= found.offset - FRAME_SIZE:
            where, bounds = f"{self.name}: TEND.index_offset", f"{head_end} to {found.offset - FRAME_SIZE}"
            raise CorruptFile(where, str(end.index_offset), bounds, AGAIN)
        return found, end

    def _find_objects(self, begin: int, end: int) -> list[FoundRecord]:
        """The objects of a file of coder `objects`, which stand before the first segment; none is read."""
        if self.head.coder != OBJECTS_CODER:
            return []
        before = takewhile(lambda found: found.tag != "SEGM", records_between(self._source, begin, end))
        objects = list(islice((found for found in before if found.tag == "OBJT"), MAX_OBJECTS + 1))
        if len(objects) > MAX_OBJECTS:
            expected = f"at most {MAX_OBJECTS}"
            raise CorruptFile(objects[-1].where, f"more than {MAX_OBJECTS} objects", expected, AGAIN)
        if not objects:
            where = f"{self.name}: HEAD.coder"
            raise CorruptFile(where, f"{OBJECTS_CODER!r}, and no OBJT", "an OBJT for each object", AGAIN)
        return objects

    def _check_segments(self, begin: int, end: int) -> None:
        """Check that the segments hold every frame once and lie between `begin` and `end` without overlap."""
        frame = 0
        for i, entry in enumerate(self.segments):
            where = f"{self.name}: INDX.segments[{i}]"
            if entry.first_frame != frame:
                raise CorruptFile(f"{where}.first_frame", str(entry.first_frame), str(frame), AGAIN)
            if entry.offset < begin or entry.length < MIN_SEGMENT or entry.offset + entry.length > end:
                found = f"bytes {entry.offset} to {entry.offset + entry.length}"
                raise CorruptFile(where, found, f"{MIN_SEGMENT} bytes or more within {begin} to {end}", AGAIN)
            frame += entry.frame_count
            begin = entry.offset + entry.length
        if frame != self.head.frame_count:
            where, expected = f"{self.name}: INDX.segments", f"{self.head.frame_count}, as HEAD says"
            raise CorruptFile(where, f"{frame} frames", expected, AGAIN)

    def _look_before(self, gap: int) -> None:
        """Look once at the records before segment `gap`, before the index, or before the end."""
        with self._lock:
            objects = {found.offset for found in self._objects} if gap == 0 else set()
            provenance: dict[str, str] | None = None
            vibration: FoundRecord | None = None
            for found in records_between(self._source, *self._gaps.get(gap, (0, 0))):
                if found.tag == "PROV" and provenance is None and gap == 0:
                    story, _ = read_record(self._source, found, Provenance)
                    provenance = {pair.key: pair.value for pair in story.pairs}
                    if len(provenance) < len(story.pairs):
                        raise CorruptFile(found.where, "a key twice", "every key once", AGAIN)
                elif found.tag == "VIBR" and vibration is None and gap < len(self.segments):
                    vibration = found  # read, and its CRC-32 checked, when it is asked for
                elif found.offset not in objects:
                    check_crc(self._source, found)
                    if (record := known_record(found)) is not None:
                        expected = f"{found.tag} {record.place}"
                        raise CorruptFile(
                            found.where, "a record that the index does not name", expected, AGAIN
                        )
            if provenance is not None:
                self.provenance = MappingProxyType(provenance)
            if vibration is not None:
                self._vibrations[gap] = vibration
            self._gaps.pop(gap, None)

    def _expected(self, index: int) -> SegmentEntry:
        """The entry of a segment, which is fetched with what stands before it where the file lies elsewhere."""
        if not 0 <= index < len(self.segments):
            raise InvalidArgument("segment", repr(index), f"0 to {len(self.segments) - 1}")
        entry = self.segments[index]
        begin, _ = self._gaps.get(index, (entry.offset, 0))
        self._source.expect(begin, entry.offset + entry.length)
        self._look_before(index)
        return entry
