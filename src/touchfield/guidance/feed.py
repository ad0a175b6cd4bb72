"""Frames of a depth camera in real time, of which only the newest counts: from a camera, or from a recorded
sequence that is shown at its own rate."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from typing import Final, NamedTuple

from touchfield.arrays import Float32s, Float64s
from touchfield.errors import SourceError
from touchfield.sources.camera import DepthSequence
from touchfield.sources.depth.capture import CapturedSequence

_POLL_S: Final = 0.002
_MAX_POLL_ERRORS: Final = 30
"""Pictures in a row that cannot be read before a sequence ends."""


class Frame(NamedTuple):
    """A depth picture, when it arrived (monotonic clock, seconds), and its pose, if it is known."""

    number: int
    depth_m: Float32s
    arrived_s: float
    pose: Float64s | None


class Feed(ABC):
    """Frames from a thread; one place, in which a newer frame replaces an older one.

    `received` counts frames, `dropped` those that were never taken, and `unreadable` pictures that could not
    be read. `error` is why the source ended, or None at the end of a recorded sequence.
    """

    def __init__(self) -> None:
        self.received = self.dropped = self.unreadable = 0
        self.error: SourceError | None = None
        self._changed = threading.Condition()
        self._frame: Frame | None = None
        self._is_over = False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="touchfield-guide-frames", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def take(self, timeout_s: float) -> Frame | None:
        """Return the newest frame once; None if none arrives in time."""
        with self._changed:
            self._changed.wait_for(lambda: self._frame is not None or self._is_over, timeout_s)
            frame, self._frame = self._frame, None
        return frame

    @property
    def is_over(self) -> bool:
        """True if no frame is left and none will come."""
        with self._changed:
            return self._is_over and self._frame is None

    def close(self) -> None:
        """End the thread; does not wait for a camera that is silent."""
        self._stop.set()

    @abstractmethod
    def _show(self) -> None:
        """Put frames until the end or `_stop`; raises `SourceError` if the source fails."""

    def _put(self, frame: Frame) -> None:
        with self._changed:
            self.received += 1
            self.dropped += self._frame is not None
            self._frame = frame
            self._changed.notify_all()

    def _run(self) -> None:
        try:
            self._show()
        except SourceError as error:
            self.error = error
        except (
            Exception
        ) as error:  # of a driver or a library: the loop must learn that nothing comes any more
            self.error = SourceError("depth pictures", str(error) or type(error).__name__, "pictures")
        finally:
            with self._changed:
                self._is_over = True
                self._changed.notify_all()


class CameraFeed(Feed):
    """Frames of a camera, a folder that grows, or standard input."""

    def __init__(self, sequence: CapturedSequence) -> None:
        super().__init__()
        self._sequence = sequence

    def close(self) -> None:
        super().close()
        self._sequence.close()

    def _show(self) -> None:
        shown = self._sequence.depth_m(0)  # from before the device was ready
        number, passed = 0, self._sequence.passed_over
        while not self._stop.is_set():
            number += 1
            depth = self._sequence.depth_m(number)
            if depth is shown:  # no new picture
                time.sleep(_POLL_S)
                continue
            shown = depth
            self._put(Frame(number, depth, self._sequence.arrived_s, None))
            replaced = self._sequence.passed_over - passed
            self.received, self.dropped = self.received + replaced, self.dropped + replaced
            passed += replaced


class ReplayFeed(Feed):
    """Frames of a recorded sequence at its own rate; those whose time is over are dropped, as by a camera."""

    def __init__(self, sequence: DepthSequence) -> None:
        super().__init__()
        self._sequence = sequence

    def _show(self) -> None:
        sequence, errors = self._sequence, 0
        start_s = time.monotonic()
        for number in range(sequence.frame_count):
            due_s = start_s + number / sequence.rate_hz
            if time.monotonic() > due_s + 1 / sequence.rate_hz:
                self.received, self.dropped = self.received + 1, self.dropped + 1
                continue
            if self._stop.wait(max(0.0, due_s - time.monotonic())):
                return
            try:
                depth, errors = sequence.depth_m(number), 0
            except SourceError:
                errors, self.unreadable = errors + 1, self.unreadable + 1
                if errors >= _MAX_POLL_ERRORS:
                    raise
                continue
            pose = None if sequence.poses is None else sequence.poses[number]
            self._put(Frame(number, depth, due_s, pose))
