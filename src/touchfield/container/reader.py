"""Opens a ``.touch`` file, checks its head and its index, and returns the bytes of the segments on request.

Opening a file reads the head, the end and the index; segments are read on request.
"""

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

from touchfield.container.map_record import MAX_RECORD_BYTES, TAG as MAP_TAG, TactileMap, decode_map
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
    CRC_SIZE,
    FETCH_AGAIN,
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
MAX_PREFETCH: Final = 1 << 24
"""Maximum number of bytes of a remote file fetched ahead: before the first segment, and of the index."""


class TouchReader:
    """Reader of one ``.touch`` file; a context manager, and thread-safe.

    Opening reads only the head and the index, however large the objects and segments are. Raises
    `FormatError` if the file is invalid, or `SourceError` if it cannot be opened or read.

    Parameters
    ----------
    file : str, path or open binary file
        A path, or an address such as https://host/x.touch, from which only the requested parts are fetched. A
        file that is already open must be seekable; it is left open.

    Attributes
    ----------
    name, size, is_remote
        Its name in messages, its length in bytes, and whether it is a remote file.
    head : Head
    provenance : mapping of str to str
        Empty if the file states none.
    segments : tuple of SegmentEntry
        In the order of their frames.
    object_count : int
        Number of objects of a file of coder `objects`; otherwise 0.
    has_vibration : bool
        Whether the file has vibrations; of a remote file, whether its first segment has.
    has_map : bool
        Whether the file has the levels and the index of a tactile map.
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
        weakref.finalize(self, self._source.close)  # close when the reader is no longer used

    def __enter__(self) -> TouchReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file, unless it was open before."""
        self._source.close()

    def read_all(self) -> bytes:
        """The bytes of the whole file."""
        return self._source.read_at(0, self.size)

    def read_segment(self, index: int) -> bytes:
        """Body of a segment, checked against its CRC-32 and the index.

        `index`: 0 to ``len(segments) - 1``.
        """
        entry = self._prefetch(index)
        found = find_record(self._source, entry.offset, entry.offset + entry.length)
        segment, crc = read_record(self._source, found, Segment)
        frames = {"first_frame": segment.first_frame, "frame_count": segment.frame_count}
        actual = SegmentEntry(**frames, offset=found.offset, length=found.end - found.offset, crc32=crc)
        if actual != entry:
            raise CorruptFile(found.where, str(actual), f"{entry}, as the index says", FETCH_AGAIN)
        return segment.body

    def read_vibration(self, index: int) -> bytes | None:
        """Vibrations in the frames of a segment, checked against their CRC-32.

        `index`: 0 to ``len(segments) - 1``. None if the segment has no vibrations.
        """
        entry = self._prefetch(index)
        if index not in self._vibrations:
            return None
        found = self._vibrations[index]
        vibration, _ = read_record(self._source, found, Vibration)
        if (vibration.first_frame, vibration.frame_count) != (entry.first_frame, entry.frame_count):
            wrong = f"{vibration.frame_count} frames from frame {vibration.first_frame}"
            right = f"{entry.frame_count} from {entry.first_frame}, as in the segment behind it"
            raise CorruptFile(found.where, wrong, right, FETCH_AGAIN)
        return vibration.body

    def read_map(self) -> TactileMap | None:
        """Levels and index of a tactile map (docs/format/maps.md); None if the file has none.

        Raises `FormatError` if they are invalid, which does not concern the frames.
        """
        if not self._maps:
            return None
        if len(self._maps) > 1:
            raise CorruptFile(self._maps[1].where, f"a second {MAP_TAG}", "at most one", FETCH_AGAIN)
        found = self._maps[0]
        if found.payload_length > MAX_RECORD_BYTES:
            size, expected = f"{found.payload_length} bytes", f"at most {MAX_RECORD_BYTES}"
            raise CorruptFile(found.where, size, expected, FETCH_AGAIN)
        payload = self._source.read_at(found.offset + FRAME_SIZE, found.payload_length)
        return decode_map(payload, self.name)

    def read_object(self, index: int) -> ObjectRecord:
        """Object `index`, 0 to ``object_count - 1``, checked against its CRC-32."""
        if not 0 <= index < self.object_count:
            raise InvalidArgument("object", repr(index), f"0 to {self.object_count - 1}")
        record, _ = read_record(self._source, self._objects[index], ObjectRecord)
        return record

    def segment_of(self, frame: int) -> int:
        """Index of the segment that contains `frame`."""
        if not 0 <= frame < self.head.frame_count:
            raise InvalidArgument("frame", repr(frame), f"0 to {self.head.frame_count - 1}")
        return bisect_right(self._first_frames, frame) - 1

    # -- opening --------------------------------------------------------------------------------------------

    def _open(self) -> None:
        source = self._source
        opening = read_opening(source)
        head_record = find_record(source, OPENING_SIZE, source.size)
        self.head, _ = read_record(source, head_record, Head)
        end_record, end = self._read_end(head_record.end)
        source.expect(max(end.index_offset, end_record.end - MAX_PREFETCH), end_record.end)
        index_record = find_record(source, end.index_offset, end_record.offset)
        index, _ = read_record(source, index_record, Index)
        if index.segments and index.segments[0].offset - head_record.end <= MAX_PREFETCH:
            source.expect(head_record.end, index.segments[0].offset)
        self._objects = self._find_objects(head_record.end, index_record.offset)
        self.object_count = len(self._objects)
        chained = (head_record, *self._objects, index_record)
        chain = zlib.crc32(
            opening + b"".join(source.read_at(record.crc_offset, CRC_SIZE) for record in chained)
        )
        if chain != end.chain_crc32:
            where, expected = f"{self.name}: TEND.chain_crc32", f"{end.chain_crc32:08x}"
            wrong = f"CRC-32 {chain:08x} of opening, HEAD, {self.object_count} OBJT and INDX"
            raise CorruptFile(where, wrong, expected, FETCH_AGAIN)
        self.segments = index.segments
        self._first_frames = [entry.first_frame for entry in self.segments]
        self._check_segments(head_record.end, index_record.offset)
        # gaps between the known records: read now or, in a remote file, when a segment is requested
        stops = [head_record.end, *(entry.offset + entry.length for entry in self.segments), index_record.end]
        starts = [*(entry.offset for entry in self.segments), index_record.offset, end_record.offset]
        self._gaps = dict(enumerate(zip(stops, starts, strict=True)))
        self._vibrations: dict[int, FoundRecord] = {}
        self._maps: list[FoundRecord] = []
        self.provenance: Mapping[str, str] = MappingProxyType({})
        last = len(self.segments)
        for gap in (0, last, last + 1) if source.remote else range(last + 2):
            self._read_gap(gap)
        self.has_vibration, self.has_map = bool(self._vibrations), bool(self._maps)

    def _read_end(self, head_end: int) -> tuple[FoundRecord, End]:
        """The end record and its position."""
        source = self._source
        try:
            found = find_record(source, max(head_end, source.size - END_SIZE), source.size)
            end, _ = read_record(source, found, End)
        except (CorruptFile, TruncatedFile) as error:
            for found in islice(records_between(source, head_end, source.size), MAX_WALKED):
                if found.tag == "TEND":  # it is intact, but not at the end
                    read_record(source, found, End)
                    surplus = f"{source.size - found.end} bytes after it"
                    raise CorruptFile(found.where, surplus, "none", FETCH_AGAIN) from error
            expected = "a TEND record, last"
            raise TruncatedFile(
                self.name, f"no end record in {source.size} bytes", expected, FETCH_AGAIN
            ) from error
        if end.file_length != source.size:
            where, size = (
                f"{self.name}: TEND.file_length",
                f"{end.file_length} in a file of {source.size} bytes",
            )
            raise CorruptFile(
                where, size, "its length", "It was joined to another file, or cut within; " + FETCH_AGAIN
            )
        if not head_end <= end.index_offset <= found.offset - FRAME_SIZE:
            where, bounds = f"{self.name}: TEND.index_offset", f"{head_end} to {found.offset - FRAME_SIZE}"
            raise CorruptFile(where, str(end.index_offset), bounds, FETCH_AGAIN)
        return found, end

    def _find_objects(self, start: int, stop: int) -> list[FoundRecord]:
        """Find the objects of a file of coder `objects`, without reading them.

        They lie before the first segment. The list is empty for other coders.
        """
        if self.head.coder != OBJECTS_CODER:
            return []
        before = takewhile(lambda found: found.tag != "SEGM", records_between(self._source, start, stop))
        objects = list(islice((found for found in before if found.tag == "OBJT"), MAX_OBJECTS + 1))
        if len(objects) > MAX_OBJECTS:
            expected = f"at most {MAX_OBJECTS}"
            raise CorruptFile(objects[-1].where, f"more than {MAX_OBJECTS} objects", expected, FETCH_AGAIN)
        if not objects:
            where = f"{self.name}: HEAD.coder"
            raise CorruptFile(
                where, f"{OBJECTS_CODER!r}, and no OBJT", "an OBJT for each object", FETCH_AGAIN
            )
        return objects

    def _check_segments(self, start: int, stop: int) -> None:
        """Check that the segments have every frame once, and lie in order without overlap.

        They must lie within the bytes `start` to `stop`.
        """
        frame = 0
        for i, entry in enumerate(self.segments):
            where = f"{self.name}: INDX.segments[{i}]"
            if entry.first_frame != frame:
                raise CorruptFile(f"{where}.first_frame", str(entry.first_frame), str(frame), FETCH_AGAIN)
            if entry.offset < start or entry.length < MIN_SEGMENT or entry.offset + entry.length > stop:
                found = f"bytes {entry.offset} to {entry.offset + entry.length}"
                raise CorruptFile(
                    where, found, f"{MIN_SEGMENT} bytes or more within {start} to {stop}", FETCH_AGAIN
                )
            frame += entry.frame_count
            start = entry.offset + entry.length
        if frame != self.head.frame_count:
            where, expected = f"{self.name}: INDX.segments", f"{self.head.frame_count}, as HEAD says"
            raise CorruptFile(where, f"{frame} frames", expected, FETCH_AGAIN)

    def _read_gap(self, gap: int) -> None:
        """Read, once, the records in one of the gaps between known records.

        Gap `gap` lies before the segment of this index; the last two lie before the index and before the end.
        """
        with self._lock:
            objects = {found.offset for found in self._objects} if gap == 0 else set()
            provenance: dict[str, str] | None = None
            vibration: FoundRecord | None = None
            for found in records_between(self._source, *self._gaps.get(gap, (0, 0))):
                if found.tag == "PROV" and provenance is None and gap == 0:
                    provenance_record, _ = read_record(self._source, found, Provenance)
                    provenance = {pair.key: pair.value for pair in provenance_record.pairs}
                    if len(provenance) < len(provenance_record.pairs):
                        raise CorruptFile(found.where, "a key twice", "every key once", FETCH_AGAIN)
                elif found.tag == "VIBR" and vibration is None and gap < len(self.segments):
                    vibration = found  # read and checked on request
                elif found.offset not in objects:
                    check_crc(self._source, found)
                    if found.tag == MAP_TAG and gap == len(self.segments) and len(self._maps) < 2:
                        self._maps.append(found)
                    if (record := known_record(found)) is not None:
                        expected = f"{found.tag} {record.position}"
                        raise CorruptFile(
                            found.where, "a record that the index does not name", expected, FETCH_AGAIN
                        )
            if provenance is not None:
                self.provenance = MappingProxyType(provenance)
            if vibration is not None:
                self._vibrations[gap] = vibration
            self._gaps.pop(gap, None)

    def _prefetch(self, index: int) -> SegmentEntry:
        """Entry of a segment.

        In a remote file, the segment is fetched together with the records before it.
        """
        if not 0 <= index < len(self.segments):
            raise InvalidArgument("segment", repr(index), f"0 to {len(self.segments) - 1}")
        entry = self.segments[index]
        start, _ = self._gaps.get(index, (entry.offset, 0))
        self._source.expect(start, entry.offset + entry.length)
        self._read_gap(index)
        return entry
