"""Returns any frame of a stream, forces or vibration, by its number: decodes the segment that contains it up
to that frame, and goes on from there for the next one.

Sequential access is decoded ahead: while one segment is read, the next ones are decoded on the other cores.
Whoever asks for a frame comes first: after a jump, and once a segment is reached, the other cores stop. They
start again after `FIRST_FRAMES` frames in sequence. Only if the second of these starts another segment, it is
decoded at the same time as the first.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache, lru_cache, partial
from threading import Event, Lock
from typing import Any, Final

from touchfield.compute.threads import worker_count
from touchfield.container import TouchReader
from touchfield.errors import naming_file
from touchfield.medium import ForceField, Grid, Segments
from touchfield.medium.medium import VibrationFrame

MAX_LOOKAHEAD_BYTES: Final = 1 << 28
"""Limit of the bytes of a segment that are decoded ahead; its other frames are decoded on access."""

FIRST_FRAMES: Final = 2
"""Frames after a jump that are decoded before any other: a player needs two to show a force."""

Decode = Callable[[int], Iterator[ForceField]]


class SegmentFrames:
    """``frames(i) -> ForceField``; sequential frames are decoded once, and the latest is cached.

    The first frame counts as the one after the last: playback may repeat.

    Parameters
    ----------
    reader : TouchReader
    decode : callable
        ``decode(segment) -> iterator`` over the fields of one segment, which reads its body to the end;
        thread-safe.
    """

    def __init__(self, reader: TouchReader, decode: Decode) -> None:
        self._reader, self._decode = reader, decode
        self._lock = Lock()
        self._cursor: tuple[int, Iterator[ForceField], int] | None = None
        self._latest: tuple[int, ForceField] | None = None
        self._lookahead: dict[int, _Lookahead] = {}
        self._run_frames = 0
        """Number of sequential frames since the latest jump."""

    def __call__(self, frame: int) -> ForceField:
        """One frame; decodes its segment up to it, or one frame in sequential access."""
        with self._lock, naming_file(self._reader.name):
            if self._latest is not None and self._latest[0] == frame:
                return self._latest[1]
            segment = self._reader.segment_of(frame)
            if self._is_next(frame):
                self._run_frames += 1
            else:
                self._jump(segment, frame)
            decoded = self._decoded(segment, frame)
            if self._run_frames > FIRST_FRAMES:
                self._look_ahead(segment)
            return decoded

    def _is_next(self, frame: int) -> bool:
        """True if a frame follows the latest one, perhaps in a loop."""
        frame_count = self._stop_of(len(self._reader.segments) - 1)
        return self._latest is not None and (self._latest[0] + 1) % frame_count == frame

    def _stop_of(self, segment: int) -> int:
        """The frame behind the last one of a segment."""
        entry = self._reader.segments[segment]
        return entry.first_frame + entry.frame_count

    def _jump(self, segment: int, frame: int) -> None:
        """Stop the other cores. If the frame after this one starts a segment, one of them decodes it.

        Not where each frame is a segment of its own: it would fetch and decode twice what was requested,
        and save the time of one frame.
        """
        self._run_frames = 1
        self._forget(range(0))
        first_frame = self._reader.segments[segment].first_frame
        following = (segment + 1) % len(self._reader.segments)
        is_last = first_frame < frame == self._stop_of(segment) - 1
        if is_last and following != segment and worker_count() > 1:
            self._lookahead[following] = _Lookahead(self._decode, following, max_frames=1)

    def _decoded(self, segment: int, frame: int) -> ForceField:
        """A frame of a segment, whose earlier frames are decoded first."""
        first_frame = self._reader.segments[segment].first_frame
        if self._cursor is None or self._cursor[0] != segment or self._cursor[2] > frame:
            self._cursor = (segment, self._segment_fields(segment), first_frame)
        _, fields, next_frame = self._cursor
        self._cursor = None  # after an error, the segment is decoded from its start
        for _ in range(next_frame, frame + 1):
            decoded = next(fields)
        if frame + 1 == self._stop_of(segment):
            next(fields, None)  # checks that the body ends after its last frame
        self._cursor, self._latest = (segment, fields, frame + 1), (frame, decoded)
        return decoded

    def _look_ahead(self, segment: int) -> None:
        """Start to decode the following segments, one per core."""
        workers = worker_count()
        if workers == 1:
            return
        window = range(segment, min(segment + workers, len(self._reader.segments) - 1) + 1)
        self._forget(window)
        for later in window[1:]:
            if later not in self._lookahead:
                self._lookahead[later] = _Lookahead(self._decode, later)

    def _forget(self, window: range) -> None:
        for later in [i for i in self._lookahead if i not in window]:
            self._lookahead.pop(later).stop()

    def _segment_fields(self, segment: int) -> Iterator[ForceField]:
        """The fields of a segment; one whose lookahead failed is decoded again, and fails on access."""
        lookahead = self._lookahead.pop(segment, None)
        fields = None if lookahead is None else lookahead.fields()
        return self._decode(segment) if fields is None else fields


class _Lookahead:
    """The fields of one segment, decoded by another thread until they are requested.

    At most `max_frames` of them, and about `MAX_LOOKAHEAD_BYTES`.
    """

    def __init__(self, decode: Decode, segment: int, max_frames: int | None = None) -> None:
        self._must_stop = Event()
        pool = _pool(worker_count())
        self._future: Future[Iterator[ForceField]] = pool.submit(self._run, decode, segment, max_frames)

    def _run(self, decode: Decode, segment: int, max_frames: int | None) -> Iterator[ForceField]:
        """The fields of a segment; the first of them are decoded now."""
        fields = decode(segment)
        decoded: deque[ForceField] = deque()
        size = 0
        while not self._must_stop.is_set() and size <= MAX_LOOKAHEAD_BYTES and len(decoded) != max_frames:
            field = next(fields, None)
            if field is None:
                break
            decoded.append(field)
            size += field.forces_n.nbytes

        def resumed() -> Iterator[ForceField]:
            while decoded:
                yield decoded.popleft()
            yield from fields

        return resumed()

    def stop(self) -> None:
        """Decode no further frame; returns at once."""
        self._must_stop.set()
        self._future.cancel()

    def fields(self) -> Iterator[ForceField] | None:
        """The fields, of which those so far are there; waits for one frame at most.

        None if nothing was begun, or it failed.
        """
        self._must_stop.set()
        if self._future.cancel():
            return None
        try:
            return self._future.result()
        except Exception:
            return None


def segment_layout(reader: TouchReader, keys: Mapping[str, Any]) -> Segments | None:
    """The first frames of a stream's segments and its mask, from its decoder's `describe`; None without mask.

    None also for a mask that bounds length and direction separately: a force between two forces within it may
    be outside.
    """
    if keys.get("mode") != "mask":
        return None
    return Segments(tuple(segment.first_frame for segment in reader.segments), keys["k"], keys["f0_n"])


@cache
def _pool(workers: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(workers, thread_name_prefix="touchfield-ahead")


class VibrationFrames:
    """``frames(i) -> VibrationFrame``; the latest segment is cached.

    Parameters
    ----------
    reader : TouchReader
    grid : Grid
        Of the stream's head.
    """

    def __init__(self, reader: TouchReader, grid: Grid) -> None:
        self._reader, self._segment = reader, lru_cache(1)(partial(_vibrations, reader, grid))

    def __call__(self, frame: int) -> VibrationFrame:
        """One frame; decodes its whole segment, unless that is the latest one."""
        segment = self._reader.segment_of(frame)
        return self._segment(segment)[frame - self._reader.segments[segment].first_frame]

    def summary(self) -> dict[str, Any]:
        """Number of vibrating samples over all frames, their lowest and highest frequency, and the bits."""
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
    """The vibration of the frames of a segment."""
    body, count = reader.read_vibration(segment), reader.segments[segment].frame_count
    if body is None:
        return [VibrationFrame.empty(grid)] * count
    from touchfield.codec.vibration import decode_vibration

    with naming_file(reader.name):
        return decode_vibration(body, grid, count)
