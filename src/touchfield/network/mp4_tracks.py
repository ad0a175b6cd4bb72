"""Finds the touch in MP4 and MOV by its content, from the tables of the samples.

ISO/IEC 14496-12: `moov` with the tables of a track, and `moof` of fragmented files. Neither the label of a
track (`stsd`, `hdlr`) nor the end of its edit list is used, as programs that copy tracks change both: a
sample that an edit list leaves out is still part of the file.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain, islice, repeat
from typing import Final, NamedTuple

from touchfield.container.wire import ByteSource
from touchfield.errors import CorruptFile
from touchfield.network.touch_track import (
    PROBED_BYTES,
    PROBED_SAMPLES,
    Sample,
    TouchTrack,
    Window,
    collect,
    is_touch,
    require_few,
)

_BOX: Final = struct.Struct(">I4s")
_MAX_TABLE_BYTES: Final = 1 << 28
"""Maximum size of `moov`, and of all `moof` together."""

_MAX_BOXES: Final = 1 << 22
_MAX_RUNS: Final = 1 << 20
_MAX_CHILDREN: Final = 1 << 16
_PICTURES: Final = 64
"""Pictures may be stored out of order: so many are compared to find the first."""

_TOP: Final = {
    b"ftyp",
    b"styp",
    b"moov",
    b"moof",
    b"mdat",
    b"free",
    b"skip",
    b"wide",
    b"sidx",
    b"pnot",
    b"uuid",
}


def is_mp4(start: bytes) -> bool:
    """Whether a file that starts with these bytes is MP4 or MOV."""
    return start[4:8] in _TOP


class _Box(NamedTuple):
    """Kind of a box, its position, and those of its contents and its end."""

    kind: bytes
    position: int
    start: int
    stop: int


class _Run(NamedTuple):
    """Samples of one `trun`: their position, the time of the first if stated, and the rows of its table."""

    offset: int
    start: int | None
    flags: int
    samples: int
    rows: bytes
    defaults: tuple[int, int]


class _Stored(NamedTuple):
    """One sample: position and length in the file, and when it shows, in units of the track."""

    offset: int
    size: int
    time: int


@dataclass
class _Track:
    number: int = 0
    handler: bytes = b""
    timescale: int = 1
    tables: dict[bytes, bytes] = field(default_factory=dict)
    defaults: tuple[int, int] = (0, 0)
    runs: list[_Run] = field(default_factory=list)
    delay_s: float = 0.0
    media_start: int = 0
    has_edits: bool = False

    def time_s(self, time: int) -> float:
        return self.delay_s + (time - self.media_start) / self.timescale


def find_touch(source: ByteSource) -> tuple[TouchTrack, ...]:
    """The touch tracks of a movie, in its order; one without samples if there is none.

    CorruptFile or TruncatedFile if boxes do not fit into each other.
    """
    tracks, size = dict[int, _Track](), 0
    for box in _top_boxes(source):
        if box.kind not in (b"moov", b"moof"):
            continue
        size += box.stop - box.start
        if size > _MAX_TABLE_BYTES:
            raise CorruptFile(source.name, f"more than {_MAX_TABLE_BYTES} bytes of tables", "fewer")
        data = source.read_at(box.start, box.stop - box.start)
        if box.kind == b"moov" and not tracks:
            tracks = _tracks_of(data, source.name)
        elif box.kind == b"moof":
            _add_fragment(data, box.position, tracks, source.name)
            runs = sum(len(track.runs) for track in tracks.values())
            if runs > _MAX_RUNS:
                raise CorruptFile(source.name, f"more than {_MAX_RUNS} runs of samples", "fewer")
    touches = {key: track for key, track in tracks.items() if _is_touch(track, source)}
    require_few(touches, source.name)
    picture_s = _first_picture_s([track for key, track in tracks.items() if key not in touches])
    found, size = list[TouchTrack](), source.size
    for touch in touches.values():
        samples = collect(_read_samples(touch, source), size, source.name)
        size -= sum(len(sample.data) for sample in samples)
        is_start_unknown = _is_start_unknown(touch)
        found.append(TouchTrack(samples, picture_s=picture_s, is_start_unknown=is_start_unknown))
    return tuple(found) or (TouchTrack(picture_s=picture_s),)


def _top_boxes(source: ByteSource) -> Iterator[_Box]:
    position, window = 0, Window(source)
    for _ in range(_MAX_BOXES):
        if position + _BOX.size > source.size:
            return
        length, kind = _BOX.unpack(window.read(position, _BOX.size))
        start = position + _BOX.size
        if length == 1 and start + 8 <= source.size:
            length, start = int.from_bytes(window.read(start, 8), "big"), start + 8
        stop = source.size if length == 0 else position + length
        if stop < start:
            where = f"{source.name}: box {kind!r} at byte {position}"
            raise CorruptFile(where, f"{length} bytes", "at least 8")
        yield _Box(kind, position, start, min(stop, source.size))
        position = stop
    raise CorruptFile(source.name, f"more than {_MAX_BOXES} boxes", "fewer")


def _boxes(data: bytes, start: int, stop: int, name: str) -> Iterator[_Box]:
    """The boxes within another one."""
    for _ in range(_MAX_CHILDREN):
        if start + _BOX.size > stop:
            return
        length, kind = _BOX.unpack_from(data, start)
        first = start + _BOX.size
        if length == 1 and first + 8 <= stop:
            length, first = int.from_bytes(data[first : first + 8], "big"), first + 8
        last = stop if length == 0 else start + length
        if not first <= last <= stop:
            where = f"{name}: box {kind!r} in moov or moof"
            raise CorruptFile(where, f"{length} bytes", f"8 to {stop - start}")
        yield _Box(kind, start, first, last)
        start = last
    raise CorruptFile(name, f"more than {_MAX_CHILDREN} boxes in one", "fewer")


def _fields(data: bytes, layout: str, box: _Box, skip: int, name: str) -> tuple[int, ...]:
    """Numbers of a box, big-endian, after `skip` bytes."""
    if box.start + skip + struct.calcsize(layout) > box.stop:
        raise CorruptFile(f"{name}: box {box.kind!r}", f"{box.stop - box.start} bytes", "its fields")
    return struct.unpack_from(layout, data, box.start + skip)


def _tracks_of(data: bytes, name: str) -> dict[int, _Track]:
    tracks, defaults, movie_timescale = dict[int, _Track](), dict[int, tuple[int, int]](), 1
    for box in _boxes(data, 0, len(data), name):
        if box.kind == b"mvhd":
            skip = 20 if data[box.start : box.start + 1] == b"\1" else 12
            movie_timescale = max(1, _fields(data, ">I", box, skip, name)[0])
        elif box.kind == b"trak":
            track = _track_of(data, box, movie_timescale, name)
            tracks.setdefault(track.number, track)
        elif box.kind == b"mvex":
            for inner in _boxes(data, box.start, box.stop, name):
                if inner.kind == b"trex":
                    number, _, duration, size = _fields(data, ">4I", inner, 4, name)
                    defaults[number] = duration, size
    for number, track in tracks.items():
        track.defaults = defaults.get(number, (0, 0))
    return tracks


def _track_of(data: bytes, trak: _Box, movie_timescale: int, name: str) -> _Track:
    track, pending = _Track(), [trak]
    while pending:
        outer = pending.pop()
        for box in _boxes(data, outer.start, outer.stop, name):
            is_long = data[box.start : box.start + 1] == b"\1"
            if box.kind in (b"mdia", b"minf", b"stbl", b"edts"):
                pending.append(box)
            elif box.kind == b"tkhd":
                track.number = _fields(data, ">I", box, 20 if is_long else 12, name)[0]
            elif box.kind == b"mdhd":
                track.timescale = max(1, _fields(data, ">I", box, 20 if is_long else 12, name)[0])
            elif box.kind == b"hdlr" and outer.kind == b"mdia":
                track.handler = data[box.start + 8 : box.start + 12]
            elif box.kind == b"elst":
                _set_edits(track, data[box.start : box.stop], movie_timescale)
            elif outer.kind == b"stbl":
                track.tables[box.kind] = data[box.start : box.stop]
    return track


def _set_edits(track: _Track, table: bytes, movie_timescale: int) -> None:
    """The delay before the track, and the time in it at which it starts; later edits are not used."""
    layout = struct.Struct(">QqI" if table[:1] == b"\1" else ">IiI")
    rows = table[8 : 8 + (len(table) - 8) // layout.size * layout.size]
    for duration, media_start, _ in layout.iter_unpack(rows):
        track.has_edits = True
        if media_start >= 0:
            track.media_start = media_start
            return
        track.delay_s += duration / movie_timescale


def _add_fragment(data: bytes, moof: int, tracks: dict[int, _Track], name: str) -> None:
    """Add the runs of a `moof` at byte `moof` of the file."""
    end: int | None = None
    for traf in _boxes(data, 0, len(data), name):
        if traf.kind != b"traf":
            continue
        inner = list(_boxes(data, traf.start, traf.stop, name))
        header = next((box for box in inner if box.kind == b"tfhd"), None)
        if header is None:
            continue
        flags, number = _fields(data, ">2I", header, 0, name)
        track, position = tracks.get(number, _Track()), header.start + 8
        base = moof if end is None or flags & 0x20000 else end
        duration, size = track.defaults
        values = dict[int, int]()
        for flag, width in ((0x1, 8), (0x2, 4), (0x8, 4), (0x10, 4)):
            if flags & flag:
                values[flag] = int.from_bytes(data[position : min(position + width, header.stop)], "big")
                position += width
        base, defaults = values.get(0x1, base), (values.get(0x8, duration), values.get(0x10, size))
        end = _add_runs(data, inner, track, base, defaults, name)


def _add_runs(
    data: bytes, inner: list[_Box], track: _Track, base: int, defaults: tuple[int, int], name: str
) -> int:
    """Add the runs of a `traf`; return where its data ends."""
    decode_time, position = None, base
    for box in inner:
        if box.kind == b"tfdt":
            layout = ">Q" if data[box.start : box.start + 1] == b"\1" else ">I"
            decode_time = _fields(data, layout, box, 4, name)[0]
        elif box.kind == b"trun":
            flags, count = _fields(data, ">2I", box, 0, name)
            flags, start = flags & 0xFFFFFF, box.start + 8
            if flags & 0x1:
                position = base + _fields(data, ">i", box, 8, name)[0]
                start += 4
            start += 4 if flags & 0x4 else 0
            rows, width = data[start : box.stop], _row_size(flags)
            if width * count > len(rows):
                where = f"{name}: box b'trun'"
                raise CorruptFile(where, f"{count} samples in {len(rows)} bytes", f"{width} bytes each")
            run = _Run(position, decode_time, flags, count, rows[: width * count], defaults)
            decode_time = None
            track.runs.append(run)
            if not flags & 0x200:
                position += count * defaults[1]
            else:
                column = 4 if flags & 0x100 else 0
                position += sum(
                    int.from_bytes(run.rows[at + column : at + column + 4], "big")
                    for at in range(0, width * count, width)
                )
    return position


def _row_size(flags: int) -> int:
    return 4 * (flags >> 8 & 0xF).bit_count()


def _samples(track: _Track) -> Iterator[_Stored]:
    """All samples of a track, those of the tables first; a huge count costs time only where it is read."""
    decode_time = 0
    tables = track.tables
    times = zip(_durations(tables), _shifts(tables), strict=False)
    for (offset, size), (duration, shift) in zip(_positions(tables), times, strict=False):
        yield _Stored(offset, size, decode_time + shift)
        decode_time += duration
    for run in track.runs:
        decode_time = decode_time if run.start is None else run.start
        offset = run.offset
        for duration, size, shift in _rows(run):
            yield _Stored(offset, size, decode_time + shift)
            decode_time, offset = decode_time + duration, offset + size


def _rows(run: _Run) -> Iterator[tuple[int, int, int]]:
    """Duration, size and shift of the samples of a run."""
    columns = [n for n, flag in enumerate((0x100, 0x200, 0x400, 0x800)) if run.flags & flag]
    duration, size = run.defaults
    values = [duration, size, 0, 0]
    if not columns:
        yield from repeat((duration, size, 0), run.samples)
        return
    for row in struct.iter_unpack(">" + "".join("IIIi"[n] for n in columns), run.rows):
        for n, value in zip(columns, row, strict=True):
            values[n] = value
        yield values[0], values[1], values[3]


def _repeated(table: bytes, layout: str, last: int | None) -> Iterator[int]:
    """Values of a table of counts and values; after its end `last`, or the last one again."""
    value = 0
    for count, value in struct.iter_unpack(layout, _whole_rows(table, 8, 8)):
        yield from repeat(value, count)
    yield from repeat(value if last is None else last)


def _durations(tables: dict[bytes, bytes]) -> Iterator[int]:
    return _repeated(tables.get(b"stts", b""), ">II", None)


def _shifts(tables: dict[bytes, bytes]) -> Iterator[int]:
    return _repeated(tables.get(b"ctts", b""), ">Ii", 0)


def _sizes(tables: dict[bytes, bytes]) -> Iterator[int]:
    table = tables.get(b"stsz", b"")
    if len(table) >= 12:
        size, count = struct.unpack_from(">2I", table, 4)
        if size:
            return repeat(size, count)
        return (value for (value,) in struct.iter_unpack(">I", _whole_rows(table, 12, 4)))
    table = tables.get(b"stz2", b"")
    if len(table) < 12:
        return iter(())
    bits, values = table[7], iter(table[12:])
    if bits == 4:
        return islice(
            chain.from_iterable((value >> 4, value & 15) for value in values),
            int.from_bytes(table[8:12], "big"),
        )
    if bits == 8:
        return values
    return (value for (value,) in struct.iter_unpack(">H", _whole_rows(table, 12, 2)))


def _positions(tables: dict[bytes, bytes]) -> Iterator[tuple[int, int]]:
    """Position and size of each sample of the tables."""
    sizes = _sizes(tables)
    layout, width = (">I", 4) if b"stco" in tables else (">Q", 8)
    chunks = _whole_rows(tables.get(b"stco", tables.get(b"co64", b"")), 8, width)
    for (offset,), count in zip(
        struct.iter_unpack(layout, chunks), _chunk_counts(tables.get(b"stsc", b"")), strict=False
    ):
        for size in islice(sizes, count):
            yield offset, size
            offset += size


def _chunk_counts(table: bytes) -> Iterator[int]:
    """Samples in each chunk; each row holds for the chunks up to that of the next row."""
    chunk, count = 1, 0
    for first, next_count, _ in struct.iter_unpack(">3I", _whole_rows(table, 8, 12)):
        yield from repeat(count, max(0, first - chunk))
        chunk, count = max(chunk, first), next_count
    yield from repeat(count)


def _whole_rows(table: bytes, start: int, width: int) -> bytes:
    """The rows of a table, not more than it states and holds."""
    if len(table) < start:
        return b""
    stated = int.from_bytes(table[start - 4 : start], "big")
    return table[start : start + width * min(stated, (len(table) - start) // width)]


def _is_touch(track: _Track, source: ByteSource) -> bool:
    """Whether one of the first samples of a track is touch, whatever the track's label."""
    for sample in islice(_samples(track), PROBED_SAMPLES):
        size = max(0, min(sample.size, PROBED_BYTES, source.size - sample.offset))
        if sample.offset >= 0 and is_touch(source.read_at(sample.offset, size) if size else b""):
            return True
    return False


def _read_samples(track: _Track, source: ByteSource) -> Iterator[Sample]:
    """The samples of a touch track, each of which has at least one byte; empty ones end it."""
    for number, sample in enumerate(_samples(track)):
        if sample.offset < 0 or not sample.size:
            where = f"{source.name}: sample {number} of touch"
            raise CorruptFile(where, f"{sample.size} bytes at byte {sample.offset}", "some bytes of the file")
        yield Sample(track.time_s(sample.time), source.read_at(sample.offset, sample.size))


def _first_picture_s(tracks: list[_Track]) -> float:
    """When the first picture shows, or else the first sound."""
    for handler in (b"vide", b"soun"):
        for track in tracks:
            if track.handler == handler:
                times = [sample.time for sample in islice(_samples(track), _PICTURES)]
                if times:
                    return max(track.delay_s, track.time_s(min(times)))
    return 0.0


def _is_start_unknown(track: _Track) -> bool:
    """Whether the first sample is at the time 0 of a fragmented file without edits.

    ffmpeg writes that for every start if it writes `moov` before it has seen the first sample, and Bento4
    leaves the edits out.
    """
    return bool(track.runs) and not track.has_edits and not track.runs[0].start
