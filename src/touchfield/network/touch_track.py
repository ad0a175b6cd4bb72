"""The touch that a movie contains, as its container holds it: samples, their times, and the record of their
start.

The record SYNC (docs/format/live.md) stands before the first SEGM of a movie's touch, since several programs
lose the time of a track when they copy it. It is an optional record, which a reader of the format skips.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections import deque
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from io import BytesIO
from statistics import median
from typing import Any, Final, NamedTuple

from touchfield.container import SegmentEntry
from touchfield.container.records import MAGIC, REQUIRED, Head, Segment
from touchfield.container.wire import (
    CRC_SIZE,
    FRAME,
    FRAME_SIZE,
    OPENING_SIZE,
    ByteSource,
    FoundRecord,
    check_crc,
    read_opening,
    read_record,
    records_between,
)
from touchfield.container.writer import index_and_end
from touchfield.errors import CorruptFile, SourceError

KLV: Final = bytes.fromhex("060e2b34010101010f00") + b"touch\1\x84"
"""Key of a triplet, and the first byte of its length: four bytes follow, big-endian."""

KLV_HEAD_SIZE: Final = len(KLV) + 4
MAX_BYTES: Final = 1 << 30
"""Maximum size of the touch that is extracted from a movie."""

MAX_SAMPLES: Final = 1 << 20
_MIN_SAMPLE_BYTES, _ANY_SAMPLES = 64, 1 << 10
"""Samples have at least so many bytes on average, unless there are few: a small movie takes little time."""

PROBED_SAMPLES: Final = 16
PROBED_BYTES: Final = 64
"""A track is touch if one of its first samples starts as touch does: so many are read, of each so much."""

MAX_TRACKS: Final = 16
"""More tracks of touch in a movie are an error: each is read as a whole."""

_MAX_LABEL_BYTES: Final = 16
"""Programs may write so many bytes before a triplet, such as the header of an access unit of metadata."""

_SYNC: Final = b"SYNC"
_START: Final = struct.Struct("<d")
_MAX_START_S: Final = 1e9
_SYNC_SIZE: Final = FRAME_SIZE + _START.size + CRC_SIZE
_RECORDS: Final = (b"SEGM\1\0\0\0", b"VIBR\0\0\0\0")
_TOLERANCE_S: Final = 2.5e-3
"""Two clocks in whole milliseconds may differ by so much."""

_WINDOW_BYTES: Final = 4096
_NOTED_S: Final = 0.05


class Window:
    """Short reads of a source from a part of it that is read at once."""

    def __init__(self, source: ByteSource) -> None:
        self._source, self._start, self._data = source, 0, b""
        self.size = source.size

    def read(self, offset: int, size: int) -> bytes:
        """At most `size` bytes from `offset` on, fewer at the end of the source."""
        first = offset - self._start
        if first < 0 or first + size > len(self._data):
            stop = min(self.size, offset + max(size, _WINDOW_BYTES))
            self._start, first = offset, 0
            self._data = self._source.read_at(offset, max(0, stop - offset))
        return self._data[first : first + size]


class Sample(NamedTuple):
    """Bytes of a touch track, and when they show on the clock of the movie; None if not stated."""

    time_s: float | None
    data: bytes


@dataclass(frozen=True)
class TouchTrack:
    """The touch of a movie: samples, or a whole file that is attached to it; or neither.

    `zero_s` is the start of the movie, and `picture_s` that of its first picture (without pictures, of its
    first sound), on the clock of the samples. `is_start_unknown` states that the time of the first sample may
    be missing in the movie.
    """

    samples: tuple[Sample, ...] = ()
    attachment: bytes = b""
    zero_s: float = 0.0
    picture_s: float = 0.0
    is_start_unknown: bool = False

    @property
    def has_touch(self) -> bool:
        """False for the track that stands for a movie without touch."""
        return bool(self.samples or self.attachment)


def is_touch(start: bytes) -> bool:
    """Whether a sample that starts with these bytes is touch, in a triplet or not."""
    return start.startswith(MAGIC) or KLV in start[: _MAX_LABEL_BYTES + len(KLV)] or is_later_touch(start)


def is_later_touch(start: bytes) -> bool:
    """Whether a sample is touch without the head of the file."""
    return start.startswith(_RECORDS)


def sync_record(start_s: float) -> bytes:
    """The bytes of a SYNC record; `start_s` in seconds after the first picture."""
    framed = FRAME.pack(_SYNC, 0, _START.size) + _START.pack(start_s)
    return framed + struct.pack("<I", zlib.crc32(framed))


def _spare_size(data: bytes, start_s: float) -> int:
    """Bytes at the end of the touch of a movie that only repeat the record of the start."""
    record, size = sync_record(start_s), 0
    while data.endswith(record, 0, len(data) - size):
        size += len(record)
    return size


def require_few(tracks: Collection[object], name: str) -> None:
    """Raise SourceError if a movie has more than `MAX_TRACKS` tracks of touch."""
    if len(tracks) > MAX_TRACKS:
        raise SourceError(name, f"{len(tracks)} tracks of touch", f"at most {MAX_TRACKS}")


def collect(samples: Iterable[Sample], max_bytes: int, name: str) -> tuple[Sample, ...]:
    """The samples as a tuple; `max_bytes` is the length of the movie, which is not less than theirs.

    SourceError if they have more than 2^30 bytes, or there are too many for their bytes; CorruptFile if they
    are longer than the movie, which happens if several refer to the same bytes.
    """
    collected, size = list[Sample](), 0
    for sample in samples:
        collected.append(sample)
        size += len(sample.data)
        if size > max_bytes:
            raise CorruptFile(name, f"{size} bytes of touch in a movie of {max_bytes}", "fewer")
        if size > MAX_BYTES:
            raise SourceError(name, f"more than {MAX_BYTES} bytes of touch", "less")
        limit = min(MAX_SAMPLES, _ANY_SAMPLES + size // _MIN_SAMPLE_BYTES)
        if len(collected) > limit:
            raise SourceError(name, f"more than {limit} samples of touch in {size} bytes", "fewer")
    return tuple(collected)


def unwrapped(samples: Sequence[Sample]) -> list[Sample]:
    """The samples without their triplets, from the first on that has the head of a file.

    A triplet may be divided among samples, as MPEG-TS divides long ones: only its length counts.
    """
    if any(KLV in sample.data[: _MAX_LABEL_BYTES + len(KLV)] for sample in samples[:PROBED_SAMPLES]):
        whole = _values(samples)
    else:
        whole = _continued(samples)
    first = next((n for n, sample in enumerate(whole) if sample.data.startswith(MAGIC)), len(whole))
    return whole[first:]


def _continued(samples: Sequence[Sample]) -> list[Sample]:
    """Samples, each with those after it that have no time, which continue it."""
    groups = list[tuple[float | None, list[bytes]]]()
    for time_s, data in samples:
        if time_s is None and groups:
            groups[-1][1].append(data)
        else:
            groups.append((time_s, [data]))
    return [Sample(time_s, b"".join(parts)) for time_s, parts in groups]


def _values(samples: Sequence[Sample]) -> list[Sample]:
    data = b"".join(sample.data for sample in samples)
    starts, position = list[tuple[int, float | None]](), 0
    for sample in samples:
        starts.append((position, sample.time_s))
        position += len(sample.data)
    values, position, n = list[Sample](), 0, 0
    while (key := data.find(KLV, position)) >= 0 and len(values) < MAX_SAMPLES:
        while n + 1 < len(starts) and starts[n + 1][0] <= key:
            n += 1
        start = key + KLV_HEAD_SIZE
        position = start + int.from_bytes(data[start - 4 : start], "big")
        values.append(Sample(starts[n][1], data[start:position]))
    return values


@dataclass(frozen=True)
class JoinedTouch:
    """The file that samples are the parts of.

    `data` is the whole file, `start_s` the seconds of its SYNC record or None, and `offsets_s` the time of
    frame 0 on the clock of the movie by each sample that starts a segment.
    """

    data: bytes
    start_s: float | None
    offsets_s: tuple[float, ...]
    sample_bytes: int


def join_samples(samples: Sequence[Sample], name: str) -> JoinedTouch:
    """Join samples, the first of which starts with the head, to a file; index and end are rebuilt."""
    head = _head_of(samples[0].data, name)
    start_s, plain_head = _without_sync(head, f"{name}: sample 0")
    parts, positions, position = [plain_head], dict[int, float](), len(plain_head)
    for number, (time_s, sample) in enumerate(samples):
        if sample.startswith(MAGIC) and not sample.startswith(head):
            raise CorruptFile(f"{name}: sample {number}", "another head", "the first one's")
        part = sample.removeprefix(head)
        if time_s is not None and part:
            positions.setdefault(position, time_s)
        parts.append(part)
        position += len(part)
    data = b"".join(parts)
    if start_s is not None:  # spare samples at the end
        data = data[: len(data) - _spare_size(data, start_s)]
    end, entries, rate_hz = rebuilt_end(data, name)
    if entries and entries[0].first_frame:
        found_late = f"touch from frame {entries[0].first_frame} on"
        raise CorruptFile(name, found_late, "its beginning", "Take the whole movie.")
    starts = [len(plain_head), *(entry.offset + entry.length for entry in entries[:-1])]
    offsets = (
        positions[start] - entry.first_frame / rate_hz
        for start, entry in zip(starts, entries, strict=False)
        if start in positions
    )
    return JoinedTouch(data + end, start_s, tuple(offsets), sum(len(sample.data) for sample in samples))


def rebuilt_end(data: bytes, name: str) -> tuple[bytes, list[SegmentEntry], float]:
    """Index and end of a file of which `data` is the rest, its segments, and its frames a second."""
    entries, chain, source = list[SegmentEntry](), data[:OPENING_SIZE], _source_of(data, name)
    rate_hz = 1.0
    for found in records_between(source, OPENING_SIZE, source.size):
        if found.tag in ("HEAD", "OBJT"):
            chain += source.read_at(found.crc_offset, CRC_SIZE)
        if found.tag == "HEAD":
            rate_hz = _rate_hz(source, found)
        elif found.tag == "SEGM":
            segment, crc32 = read_record(source, found, Segment)
            frames = {"first_frame": segment.first_frame, "frame_count": segment.frame_count}
            length = found.end - found.offset
            entries.append(SegmentEntry(**frames, offset=found.offset, length=length, crc32=crc32))
    return index_and_end(entries, len(data), chain), entries, rate_hz


def _rate_hz(source: ByteSource, found: FoundRecord) -> float:
    return float(read_record(source, found, Head)[0].rate_hz)


def _source_of(data: bytes, name: str) -> ByteSource:
    file: Any = BytesIO(data)
    file.name = name
    return ByteSource(file)


def _head_of(sample: bytes, name: str) -> bytes:
    """Everything before the first SEGM of a sample that starts with the magic."""
    source = _source_of(sample, f"{name}: sample 0")
    read_opening(source)
    records = records_between(source, OPENING_SIZE, source.size)
    return sample[: next((found.offset for found in records if found.tag == "SEGM"), None)]


def _without_sync(data: bytes, name: str) -> tuple[float | None, bytes]:
    """The start that the last record of `data` states, if that is SYNC, and `data` without it.

    Only the last one belongs to the movie: another one was in the file that was muxed.
    """
    source = _source_of(data, name)
    last = next(iter(deque(records_between(source, OPENING_SIZE, source.size), maxlen=1)), None)
    if last is None or last.tag != _SYNC.decode() or last.flags & REQUIRED:
        return None, data
    check_crc(source, last)
    if last.payload_length != _START.size:
        raise CorruptFile(last.where, f"a payload of {last.payload_length} bytes", f"{_START.size} bytes")
    start_s = _START.unpack_from(data, last.offset + FRAME_SIZE)[0]
    if not (math.isfinite(start_s) and abs(start_s) <= _MAX_START_S):
        raise CorruptFile(f"{last.where}: start_s", f"{start_s:g}", f"at most {_MAX_START_S:g} s")
    return start_s, data[: last.offset]


def with_sync(data: bytes, first_segment: int, start_s: float) -> bytes:
    """A file with a SYNC record before its first SEGM, which is at byte `first_segment`.

    `data` is the file without index and end.
    """
    longer = data[:first_segment] + sync_record(start_s) + data[first_segment:]
    return longer + rebuilt_end(longer, "stream")[0]


def split_sync(data: bytes, index_offset: int, name: str) -> tuple[float | None, bytes]:
    """The start of a file that `with_sync` wrote, and the file as it was; or None and the same bytes."""
    head = _head_of(data[:index_offset], name)
    start_s, plain_head = _without_sync(head, name)
    if start_s is None:
        return None, data
    shorter = plain_head + data[len(head) : index_offset]
    return start_s, shorter + rebuilt_end(shorter, name)[0]


def start_of(joined: JoinedTouch, track: TouchTrack) -> tuple[float, tuple[str, ...]]:
    """The second of the movie at which the touch starts, and notes about it.

    The times of the samples decide if most of them agree on the start: they are right also after a movie was
    cut. If not, the SYNC record decides.
    """
    stored_s = None if joined.start_s is None else track.picture_s + joined.start_s
    agreed_s = _agreed(joined.offsets_s)
    if stored_s is not None and track.is_start_unknown and agreed_s is not None:
        agreed_s = None if abs(agreed_s) <= _TOLERANCE_S else agreed_s
    if agreed_s is None and stored_s is None:
        notes = (
            "The times of the touch in the movie contradict each other, and it has no record of its start.",
        )
        return (joined.offsets_s[-1] if joined.offsets_s else track.zero_s) - track.zero_s, notes
    if agreed_s is None:
        assert stored_s is not None
        note = "The time of the touch is lost in the movie: its own record of the start is used."
        return stored_s - track.zero_s, (note,)
    at_s = agreed_s - track.zero_s
    if stored_s is not None and abs(stored_s - agreed_s) > _NOTED_S:
        return at_s, (
            f"The movie was cut or shifted: the touch started {joined.start_s:.3f} s after the first picture "
            f"and now starts {agreed_s - track.picture_s:.3f} s after it.",
        )
    return at_s, ()


def _agreed(offsets_s: Sequence[float]) -> float | None:
    """The first of the values that more than half of them agree with; None if there is none."""
    if not offsets_s:
        return None
    middle = median(offsets_s)
    near = [value for value in offsets_s if abs(value - middle) <= _TOLERANCE_S]
    return near[0] if 2 * len(near) > len(offsets_s) else None
