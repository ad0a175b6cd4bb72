"""The vibration of a stream by the number of its frame: a segment is decoded when one of its frames is asked for."""

from __future__ import annotations

from threading import Lock
from typing import TYPE_CHECKING, Any

from touchfield.codec.vibration import decode_vibration
from touchfield.medium.vibration import VibrationBand, VibrationFrame

if TYPE_CHECKING:
    from touchfield.container import TouchReader
    from touchfield.medium import Grid

__all__ = ["VibrationFrames"]


class VibrationFrames:
    """``frames(i) -> VibrationFrame``; the latest segment is kept.

    Parameters
    ----------
    reader : TouchReader
    grid : Grid
        Of the stream's head.
    held : object
        What keeps the reader open as long as it is in use.
    """

    def __init__(self, reader: TouchReader, grid: Grid, held: object) -> None:
        self._reader, self._grid, self._held = reader, grid, held
        self._lock = Lock()
        self._latest: tuple[int, list[VibrationFrame]] | None = None

    @property
    def band(self) -> VibrationBand:
        """All frames."""
        return VibrationBand(self._grid, self._reader.head.frame_count, self)

    def __call__(self, frame: int) -> VibrationFrame:
        """One frame; it costs the decoding of its whole segment, or nothing in sequence."""
        segment = self._reader.segment_of(frame)
        with self._lock:
            if self._latest is None or self._latest[0] != segment:
                self._latest = segment, self._decoded(segment)
            return self._latest[1][frame - self._reader.segments[segment].first_frame]

    def summary(self) -> dict[str, Any]:
        """Samples that vibrate, added up over the frames, their lowest and highest frequency, and the bits."""
        samples, lowest, highest, size = 0, float("inf"), 0.0, 0
        for i in range(len(self._reader.segments)):
            size += len(self._reader.read_vibration(i) or b"")
            for frame in self._decoded(i):
                samples += len(frame)
                lowest = min(lowest, float(frame.frequencies_hz.min(initial=lowest)))
                highest = max(highest, float(frame.frequencies_hz.max(initial=highest)))
        return {
            "vibration_samples": samples,
            "vibration_lowest_hz": lowest if samples else None,
            "vibration_highest_hz": highest if samples else None,
            "bits_vibration": 8 * size,
        }

    def _decoded(self, segment: int) -> list[VibrationFrame]:
        body, count = self._reader.read_vibration(segment), self._reader.segments[segment].frame_count
        if body is None:
            return [VibrationFrame.empty(self._grid)] * count
        return decode_vibration(body, self._grid, count)
