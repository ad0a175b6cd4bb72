"""What decoding costs on this machine, and the next frame that can be there in time.

A frame in the middle of a segment costs every frame from the one decoded last, or from the segment's start. Where a
frame takes longer than it lasts, those further on in the segment come ever later, but the start of a segment to come
can be reached: so the frame rate falls to what this machine can do.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from typing import Final

__all__ = ["Pace"]

_SPARE: Final = 1.5
"""A frame is begun where so many times what it should take is left."""

_LATEST: Final = 16
_MOST_TRIED: Final = 4096


class Pace:
    """Seconds that frames take, and which of those to come can be ready.

    Frames are counted on where a medium is looped.

    Parameters
    ----------
    starts : sequence of int
        Frames that need none before them, ascending from 0; empty where none needs another.
    frame_count : int
    rate_hz : float

    Attributes
    ----------
    frame_s : float
        What a frame takes; 0 before the second, as the first one also loads or compiles code.
    """

    def __init__(self, starts: Sequence[int], frame_count: int, rate_hz: float) -> None:
        self._starts, self._count, self._rate_hz = starts, frame_count, rate_hz
        self._latest: int | None = None
        self._taken: deque[tuple[float, int]] = deque(maxlen=_LATEST)
        self.frame_s = 0.0

    def note(self, frame: int, seconds: float) -> None:
        """Take note of a frame that was decoded in so many seconds."""
        if self._latest is not None:
            self._taken.append((seconds, self._needed(frame)))
            self.frame_s = sum(s for s, _ in self._taken) / sum(n for _, n in self._taken)
        self._latest = frame

    def in_time(self, frame: int, stop: int, media_s: float, speed: float) -> int:
        """The first frame from `frame` on that can be ready at its time; `stop` where none is before that.

        Where `stop` lies within the medium and nothing before it can be ready, `frame` itself: holding one for so
        long would hide that nothing can be played.
        """
        for at in range(frame, min(stop, frame + _MOST_TRIED)):
            left_s = (at / self._rate_hz - media_s) / speed
            if _SPARE * self.frame_s * self._needed(at) <= left_s or not self.frame_s:
                return at
        return stop if stop == self._count else frame

    def _needed(self, frame: int) -> int:
        """How many frames must be decoded for one."""
        if not self._starts:
            return 1
        own = frame % self._count
        start = frame - own + self._starts[bisect_right(self._starts, own) - 1]
        begun = self._latest is not None and start <= self._latest < frame
        return frame - (self._latest if begun and self._latest is not None else start - 1)
