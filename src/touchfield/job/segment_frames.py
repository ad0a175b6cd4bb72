"""The frames of a stream by their number: a cursor within the segment that was asked for last."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from threading import Lock

from touchfield.container import TouchReader
from touchfield.medium import ForceField

__all__ = ["SegmentFrames"]


class SegmentFrames:
    """``frames(i) -> ForceField``; frames in sequence are decoded once, and the latest is kept.

    Parameters
    ----------
    reader : TouchReader
    decode : callable
        ``decode(segment) -> iterator`` over the fields of one segment, which reads its body to the end.
    """

    def __init__(self, reader: TouchReader, decode: Callable[[int], Iterator[ForceField]]) -> None:
        self._reader, self._decode = reader, decode
        self._lock = Lock()
        self._cursor: tuple[int, Iterator[ForceField], int] | None = None
        self._latest: tuple[int, ForceField] | None = None

    def __call__(self, frame: int) -> ForceField:
        """One frame; it costs the decoding of its segment up to it, or one frame in sequence."""
        with self._lock:
            if self._latest is not None and self._latest[0] == frame:
                return self._latest[1]
            segment = self._reader.segment_of(frame)
            entry = self._reader.segments[segment]
            if self._cursor is None or self._cursor[0] != segment or self._cursor[2] > frame:
                self._cursor = (segment, self._decode(segment), entry.first_frame)
            _, coming, at = self._cursor
            self._cursor = None  # an error on the way leaves nothing half-read behind
            for _ in range(at, frame + 1):
                decoded = next(coming)
            if frame + 1 == entry.first_frame + entry.frame_count:
                next(coming, None)  # that the body ends here is checked behind its last frame
            self._cursor, self._latest = (segment, coming, frame + 1), (frame, decoded)
            return decoded
