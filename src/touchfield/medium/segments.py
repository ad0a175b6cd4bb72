"""Segments of a medium that was decoded: where each starts, and the mask that all of its forces keep."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, replace

from touchfield.errors import InvalidArgument

__all__ = ["Segments"]


@dataclass(frozen=True)
class Segments:
    """Runs of frames that were coded without what is before them.

    Parameters
    ----------
    starts : tuple of int; The first frame of each, ascending from 0.
    k, f0_n : float; Every force F of the source was decoded within max(F_0, k |F|) of it; F_0 in newtons.

    Raises `InvalidArgument` if the starts are none or out of order.
    """

    starts: tuple[int, ...]
    k: float
    f0_n: float

    def __post_init__(self) -> None:
        if self.starts[:1] != (0,) or any(a >= b for a, b in zip(self.starts, self.starts[1:])):
            raise InvalidArgument("starts", f"{self.starts[:4]}", "frames in ascending order, 0 the first")

    def around(self, frame: int, frame_count: int) -> tuple[int, int]:
        """First frame and number of frames of the segment that holds a frame of a medium of so many."""
        which = bisect_right(self.starts, frame)
        stop = self.starts[which] if which < len(self.starts) else frame_count
        return self.starts[which - 1], stop - self.starts[which - 1]

    def between(self, start: int, stop: int) -> Segments:
        """Of frames start to stop - 1, counted from 0."""
        within = tuple(at - start for at in self.starts if start < at < stop)
        return replace(self, starts=(0, *within))
