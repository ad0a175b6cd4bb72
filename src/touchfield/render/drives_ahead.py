"""Frames of drives decoded ahead of the player that shows them, and the drives between two of them."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float32s = NDArray[np.float32]
    Shown = tuple[Float32s, Float32s | None]
    """Drives, 0 to 1, and frequencies, Hz; float32 [panels, rows, columns] each."""

__all__ = ["DriveFrames", "DrivesAhead"]

AHEAD_S: Final = 0.5
"""How much is decoded ahead, in seconds of the player."""

MOST_AHEAD: Final = 256
"""Frames that are held at most; of the largest array known, 6240 pins, 13 MB."""


class DriveFrames(Protocol):
    """Frames of drives, made when they are asked for; asked by one thread only.

    Attributes
    ----------
    rate_hz : float
    frame_count : int
    """

    rate_hz: float
    frame_count: int

    def drives(self, frame: int) -> Float32s:
        """Float32 [panels, rows, columns], 0 to 1."""
        ...

    def frequencies(self, frame: int) -> Float32s | None:
        """Hz, of the same shape, or None."""
        ...


class DrivesAhead:
    """Decodes the frames that a player will need next, in a thread of its own.

    A *position* counts frames from the beginning and goes on through the repeats of a loop; it need not be whole.

    Parameters
    ----------
    frames : DriveFrames
    shape : (int, int, int)
        Panels, rows and columns that every frame must have.
    first, stride : float
        Position of the player's first frame, and how far it goes from one to the next.
    rate_hz : float
        Of the player.
    loop : bool
    """

    def __init__(
        self,
        frames: DriveFrames,
        shape: tuple[int, int, int],
        first: float,
        stride: float,
        rate_hz: float,
        loop: bool,
    ) -> None:
        self._frames, self._shape, self._loop = frames, shape, loop
        self._steps = stride * np.arange(max(2, math.ceil(AHEAD_S * rate_hz)))
        self._position = first
        self._held: dict[int, Shown] = {}
        self._changed = threading.Condition()
        self._error: BaseException | None = None
        self._is_stopped = False
        self._thread = threading.Thread(target=self._run, name="touchfield-array-ahead", daemon=True)

    def start(self) -> None:
        """Begin to decode."""
        self._thread.start()

    def stop(self) -> None:
        """Decode no further frame."""
        with self._changed:
            self._is_stopped = True
            self._changed.notify_all()

    def join(self, timeout_s: float) -> None:
        """Wait for the end of the thread, after `stop`."""
        if self._thread.is_alive():
            self._thread.join(timeout_s)

    def wait_for(self, position: float) -> None:
        """Wait until what is shown at a position is there, or will never be."""
        with self._changed:
            needed = self._needed(position)
            self._changed.wait_for(
                lambda: self._is_stopped or self._error is not None or all(n in self._held for n in needed)
            )

    def at(self, position: float) -> Shown | None:
        """Drives and frequencies at a position, linear between frames; None while the feed stalls.

        Frequencies are those of the nearer frame, and of the other one where that has none.

        Raises
        ------
        Exception
            What the frames raised, once they are needed.
        """
        with self._changed:
            self._position = position
            self._changed.notify_all()
            needed = self._needed(position)
            shown = [self._held.get(n) for n in needed]
            missing = any(one is None for one in shown)
            if missing and self._error is not None:
                raise self._error
        if missing:
            return None
        before, after = ([one for one in shown if one is not None] * 2)[:2]
        share = np.float32(position - needed[0])
        drives = before[0] + share * (after[0] - before[0])
        return np.clip(drives, np.float32(0), np.float32(1)), _nearest(before[1], after[1], float(share))

    # -- the decoder's thread ------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            for at in self._wanted():
                frame = at % self._frames.frame_count
                shown = self._checked(frame, self._frames.drives(frame)), self._frames.frequencies(frame)
                with self._changed:
                    self._held[at] = shown
                    self._changed.notify_all()
        except BaseException as error:
            with self._changed:
                self._error = error
                self._changed.notify_all()

    def _wanted(self) -> Iterator[int]:
        """Positions to decode, each when there is room for it; ends on `stop`."""
        while True:
            with self._changed:
                while (at := self._next()) is None and not self._is_stopped:
                    self._changed.wait()
                if self._is_stopped or at is None:
                    return
            yield at

    def _next(self) -> int | None:
        """The first position that the player will need and that is not held; forgets those that it left behind."""
        coming = self._needed(self._position)
        later = np.floor(self._position + self._steps).astype(np.int64)
        plan = np.unique(np.concatenate([coming, later, later + 1]))
        if self._frames.frame_count == 1:
            plan = np.zeros(1, np.int64)
        elif not self._loop:
            plan = plan[plan < self._frames.frame_count]
        plan = plan[:MOST_AHEAD]
        for gone in self._held.keys() - set(plan.tolist()):
            del self._held[gone]
        return next((int(n) for n in plan if int(n) not in self._held), None)

    def _needed(self, position: float) -> list[int]:
        """One or two positions of frames for a position of the player; the last frame of the medium is held."""
        low, count = math.floor(position), self._frames.frame_count
        if count == 1:
            return [0]  # however often it is shown, it is made once
        is_last = (low + 1) % count == 0
        return [low] if is_last or low == position else [low, low + 1]

    def _checked(self, frame: int, drives: Float32s) -> Float32s:
        if drives.shape != self._shape:
            raise InvalidArgument(f"drives of frame {frame}", f"shape {drives.shape}", f"{self._shape}")
        bounded = np.clip(np.nan_to_num(drives, nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)
        return bounded.astype(np.float32)


def _nearest(before: Float32s | None, after: Float32s | None, share: float) -> Float32s | None:
    near, far = (before, after) if share < 0.5 else (after, before)
    if near is None or far is None:
        return near if far is None else far
    return np.where(near > 0, near, far)
