"""The frames of a stream by their number, forces and vibration: a cursor within the segment that was asked
for last.

Frames that are asked for in sequence are decoded ahead: while one segment is read, the next ones are decoded
on the other cores.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache, lru_cache, partial
from threading import Lock
from typing import Any, Final

from touchfield.compute.threads import worker_count
from touchfield.container import TouchReader
from touchfield.medium import ForceField, Grid, Segments
from touchfield.medium.medium import VibrationFrame

MOST_BYTES_AHEAD: Final = 1 << 28
"""Bytes of a segment before it is asked for; its other frames are decoded then."""

Decode = Callable[[int], Iterator[ForceField]]


class SegmentFrames:
    """``frames(i) -> ForceField``; frames in sequence are decoded once, and the latest is kept.

    Parameters
    ----------
    reader : TouchReader
    decode : callable
        ``decode(segment) -> iterator`` over the fields of one segment, which reads its body to the end; safe
        to be called from several threads.
    """

    def __init__(self, reader: TouchReader, decode: Decode) -> None:
        self._reader, self._decode = reader, decode
        self._lock = Lock()
        self._cursor: tuple[int, Iterator[ForceField], int] | None = None
        self._latest: tuple[int, ForceField] | None = None
        self._ahead: dict[int, Future[Iterator[ForceField]]] = {}

    def __call__(self, frame: int) -> ForceField:
        """One frame; it costs the decoding of its segment up to it, or one frame in sequence."""
        with self._lock:
            if self._latest is not None and self._latest[0] == frame:
                return self._latest[1]
            segment = self._reader.segment_of(frame)
            entry = self._reader.segments[segment]
            if self._latest is not None and self._latest[0] + 1 == frame:
                self._look_ahead(segment)
            else:
                self._forget(range(segment, segment))
            if self._cursor is None or self._cursor[0] != segment or self._cursor[2] > frame:
                self._cursor = (segment, self._begin(segment), entry.first_frame)
            _, coming, at = self._cursor
            self._cursor = None  # an error on the way leaves nothing half-read behind
            for _ in range(at, frame + 1):
                decoded = next(coming)
            if frame + 1 == entry.first_frame + entry.frame_count:
                next(coming, None)  # that the body ends here is checked behind its last frame
            self._cursor, self._latest = (segment, coming, frame + 1), (frame, decoded)
            return decoded

    def _look_ahead(self, segment: int) -> None:
        """Have the segments that follow decoded, one for each core."""
        workers = worker_count()
        if workers == 1:
            return
        wanted = range(segment, min(segment + workers, len(self._reader.segments) - 1) + 1)
        self._forget(wanted)
        for later in wanted[1:]:
            if later not in self._ahead:
                self._ahead[later] = _pool(workers).submit(_begun, self._decode, later)

    def _forget(self, wanted: range) -> None:
        for later in [i for i in self._ahead if i not in wanted]:
            self._ahead.pop(later).cancel()

    def _begin(self, segment: int) -> Iterator[ForceField]:
        """The fields of a segment from its first; one that failed ahead is decoded again, and fails in its
        place.
        """
        ahead = self._ahead.pop(segment, None)
        if ahead is None or ahead.cancel():
            return self._decode(segment)
        try:
            return ahead.result()
        except Exception:
            return self._decode(segment)


def _begun(decode: Decode, segment: int) -> Iterator[ForceField]:
    """The fields of a segment, the first of which are decoded already."""
    coming = decode(segment)
    fields: deque[ForceField] = deque()
    size = 0
    for field in coming:
        fields.append(field)
        size += field.forces_n.nbytes
        if size > MOST_BYTES_AHEAD:
            break

    def resumed() -> Iterator[ForceField]:
        while fields:
            yield fields.popleft()
        yield from coming

    return resumed()


def segments_of(reader: TouchReader, keys: Mapping[str, Any]) -> Segments | None:
    """The first frames of a stream's segments, by what its field coder tells (`describe`); None if it keeps
    no mask.

    A mask that bounds length and direction apart is none here: what lies between two of its forces may leave
    it.
    """
    if keys.get("mode") != "mask":
        return None
    return Segments(tuple(segment.first_frame for segment in reader.segments), keys["k"], keys["f0_n"])


@cache
def _pool(workers: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(workers, thread_name_prefix="touchfield-ahead")


class VibrationFrames:
    """``frames(i) -> VibrationFrame``; the latest segment is kept.

    Parameters
    ----------
    reader : TouchReader
    grid : Grid
        Of the stream's head.
    """

    def __init__(self, reader: TouchReader, grid: Grid) -> None:
        self._reader, self._segment = reader, lru_cache(1)(partial(_vibrations, reader, grid))

    def __call__(self, frame: int) -> VibrationFrame:
        """One frame; it costs the decoding of its whole segment, or nothing in sequence."""
        segment = self._reader.segment_of(frame)
        return self._segment(segment)[frame - self._reader.segments[segment].first_frame]

    def summary(self) -> dict[str, Any]:
        """Samples that vibrate, added up over the frames, their lowest and highest frequency, and the bits."""
        samples, lowest, highest, size = 0, float("inf"), 0.0, 0
        for i in range(len(self._reader.segments)):
            size += len(self._reader.read_vibration(i) or b"")
            for frame in self._segment(i):
                samples += len(frame)
                lowest = min(lowest, float(frame.frequencies_hz.min(initial=lowest)))
                highest = max(highest, float(frame.frequencies_hz.max(initial=highest)))
        return {
            "vibration_samples": samples,
            "vibration_lowest_hz": lowest if samples else None,
            "vibration_highest_hz": highest if samples else None,
            "bits_vibration": 8 * size,
        }


def _vibrations(reader: TouchReader, grid: Grid, segment: int) -> list[VibrationFrame]:
    """The frames of a segment."""
    body, count = reader.read_vibration(segment), reader.segments[segment].frame_count
    if body is None:
        return [VibrationFrame.empty(grid)] * count
    from touchfield.codec.vibration import decode_vibration

    return decode_vibration(body, grid, count)
