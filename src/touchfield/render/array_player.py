"""The player of type 2 devices: frames of drives, decoded ahead, to an array of actuators at the device's own
rate.

    frames -> `DrivesAhead` (a thread that decodes) -> the sender (a thread): linear in time, 0 to 1 -> device

An array has no loop that closes through a hand and needs a tenth of the rate of a point
(docs/decisions/0010), so that threads of the user's process do. What comes out of them is safe whatever goes
in: each drive is from 0 to 1, and the last frame is all off, be it the end, a call of `close`, an error of
the frames or of the device. While the feed stalls the actuators are off and time stands still; it goes on
with the frame that was missing. A medium of a single frame has no end: it stays until it is closed.
"""

from __future__ import annotations

import atexit
import math
import threading
from abc import ABC, abstractmethod
from contextlib import suppress
from time import monotonic
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np

from touchfield.arrays import Float32s
from touchfield.errors import InvalidArgument, is_finite, require_between

if TYPE_CHECKING:
    from touchfield.devices import Device


Shown = tuple[Float32s, Float32s | None]

AHEAD_S: Final = 0.5  # how much is decoded ahead, in seconds of the player
MOST_AHEAD: Final = 256  # frames that are held at most; of the largest array known, 6240 pins, 13 MB
USUAL_RATE_HZ: Final = 50.0  # of a device whose profile states no rate
HIGHEST_USUAL_RATE_HZ: Final = 100.0
"""Intensities of a vibration that change faster than this are no longer felt apart."""

MAX_RATE_HZ: Final = 2000.0

_LONGEST_CLOSE_S: Final = 5.0  # how long `close` waits for a decoder that is in the middle of a frame


class DriveFrames(Protocol):
    """Frames of drives, made when they are asked for; asked by one thread only."""

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

    A *position* counts frames from the beginning and goes on through the repeats of a loop; it need not be
    whole. `shape` is that of every frame; `first` is the position of the player's first frame, and `stride`
    how far it goes from one to the next, at `rate_hz`.
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
        self._buffer: dict[int, Shown] = {}
        self._changed = threading.Condition()
        self._error: BaseException | None = None
        self._is_stopped = False
        self.thread = threading.Thread(target=self._run, name="touchfield-array-ahead", daemon=True)

    def stop(self) -> None:
        """Decode no further frame."""
        with self._changed:
            self._is_stopped = True
            self._changed.notify_all()

    def wait_for(self, position: float) -> None:
        """Wait until what is shown at a position is there, or will never be."""
        with self._changed:
            needed = self._needed(position)
            self._changed.wait_for(
                lambda: self._is_stopped or self._error is not None or all(n in self._buffer for n in needed)
            )

    def at(self, position: float) -> Shown | None:
        """Drives and frequencies at a position, linear between frames; None while the feed stalls.

        Frequencies are those of the nearer frame, and of the other one where that has none. What the frames
        raised is raised once they are needed.
        """
        with self._changed:
            self._position = position
            self._changed.notify_all()
            needed = self._needed(position)
            shown = [self._buffer.get(n) for n in needed]
            missing = any(one is None for one in shown)
            if missing and self._error is not None:
                raise self._error
        if missing:
            return None
        before, after = ([one for one in shown if one is not None] * 2)[:2]
        share = np.float32(position - needed[0])
        drives = before[0] + share * (after[0] - before[0])
        near, far = (before[1], after[1]) if share < 0.5 else (after[1], before[1])
        if near is not None and far is not None:
            near = np.where(near > 0, near, far)
        return np.clip(drives, np.float32(0), np.float32(1)), far if near is None else near

    def _run(self) -> None:
        try:
            while True:
                with self._changed:
                    while (at := self._next()) is None and not self._is_stopped:
                        self._changed.wait()
                    if self._is_stopped or at is None:
                        return
                frame = at % self._frames.frame_count
                drives = self._frames.drives(frame)
                if drives.shape != self._shape:
                    raise InvalidArgument(
                        f"drives of frame {frame}", f"shape {drives.shape}", f"{self._shape}"
                    )
                drives = np.clip(np.nan_to_num(drives, nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0).astype(
                    np.float32
                )
                shown = drives, self._frames.frequencies(frame)
                with self._changed:
                    self._buffer[at] = shown
                    self._changed.notify_all()
        except BaseException as error:
            with self._changed:
                self._error = error
                self._changed.notify_all()

    def _next(self) -> int | None:
        """The first position that the player will need and that is not held; forgets those that it left
        behind.
        """
        coming = self._needed(self._position)
        later = np.floor(self._position + self._steps).astype(np.int64)
        plan = np.unique(np.concatenate([coming, later, later + 1]))
        if self._frames.frame_count == 1:
            plan = np.zeros(1, np.int64)
        elif not self._loop:
            plan = plan[plan < self._frames.frame_count]
        plan = plan[:MOST_AHEAD]
        for gone in self._buffer.keys() - set(plan.tolist()):
            del self._buffer[gone]
        return next((int(n) for n in plan if int(n) not in self._buffer), None)

    def _needed(self, position: float) -> list[int]:
        """One or two positions of frames for a position of the player; the last frame of the medium is held."""
        low, count = math.floor(position), self._frames.frame_count
        if count == 1:
            return [0]  # however often it is shown, it is made once
        is_last = (low + 1) % count == 0
        return [low] if is_last or low == position else [low, low + 1]


class ArrayPlayer:
    """Plays frames of drives on an array; a context manager, which closes it.

    `frames` are such as `touchfield.pipeline.array_medium.Drives`; `rate_hz`, frames a second to the device,
    is by default the profile's, up to 100, or 50 where it states none; `speed` is seconds of the medium in a
    second, `start_s` where in it to begin. `InvalidArgument` if a number is out of range, or the medium does
    not last until `start_s`.
    """

    def __init__(
        self,
        frames: DriveFrames,
        device: ArrayDevice,
        rate_hz: float | None = None,
        *,
        loop: bool = False,
        speed: float = 1.0,
        start_s: float = 0.0,
    ) -> None:
        usual = min(device.profile.rate_hz or USUAL_RATE_HZ, HIGHEST_USUAL_RATE_HZ)
        rate = usual if rate_hz is None else float(rate_hz)
        require_between(0.1, MAX_RATE_HZ, rate_hz=rate)
        require_between(0.001, 1000.0, speed=speed)
        seconds = frames.frame_count / frames.rate_hz
        if not (is_finite(start_s) and 0 <= start_s < seconds):
            raise InvalidArgument(
                "start_s", f"{start_s:g} s", f"0 to below {seconds:g} s, the end of the medium"
            )
        self.rate_hz, self._device, self._loop = rate, device, loop
        self._first, self._count = start_s * frames.rate_hz, frames.frame_count
        self._stride = speed * frames.rate_hz / rate
        columns, rows, _ = device.profile.lattice
        self._shape = (device.profile.panels, rows, columns)
        self._ahead = DrivesAhead(frames, self._shape, self._first, self._stride, rate, loop)
        self._stop, self._begun, self._done = threading.Event(), threading.Event(), threading.Event()
        self._sender = threading.Thread(target=self._run, name="touchfield-array", daemon=True)
        self.error: BaseException | None = None  # that ended it early
        self._is_open = False
        self._counts = dict.fromkeys(("sent", "late", "skipped", "stalled"), 0)
        self._span_s = 0.0

    def start(self) -> None:
        """Open the device, or raise `DeviceError`, and begin; once only."""
        if self._is_open or self._stop.is_set():
            raise InvalidArgument("start", "a player that was started before", "a new player")
        self._is_open = True
        try:
            self._device.open()
        except BaseException:
            for event in (self._stop, self._begun, self._done):
                event.set()
            self._device.close()
            raise
        atexit.register(self.close)  # a program that ends without `close` must not leave an actuator on
        self._ahead.thread.start()
        self._sender.start()

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until everything is played and the actuators are off; whether it is so.

        Raises what ended it, an error of the device or of the frames.
        """
        is_done = self._done.wait(timeout_s)
        if is_done and self.error is not None:
            raise self.error
        return is_done

    def wait_begun(self, timeout_s: float | None = None) -> bool:
        """Wait until the first frame is about to be sent, or never will be; whether it is so."""
        return self._begun.wait(timeout_s)

    @property
    def notes(self) -> tuple[str, ...]:
        """A note for the user where the feed stalled."""
        note = "Frames are not made in time: the actuators are off meanwhile. A lower --speed may help"
        return (note,) if self._counts["stalled"] else ()

    def close(self) -> None:
        """All actuators off, and the device let go; never raises, and may be called twice."""
        atexit.unregister(self.close)
        self._stop.set()
        self._ahead.stop()
        if self._sender.is_alive():
            self._sender.join()
        if self._ahead.thread.is_alive():
            self._ahead.thread.join(_LONGEST_CLOSE_S)

    def statistics(self) -> dict[str, float]:
        """Frames ``sent``, of these ``late`` by more than half a period, ``skipped`` as the one before took
        too long, of those sent ``stalled``, all off as the feed had nothing; ``mean_rate_hz``, 0 before the
        second.
        """
        sent = self._counts["sent"]
        return {
            **self._counts,
            "mean_rate_hz": (sent - 1) / self._span_s if sent > 1 and self._span_s > 0 else 0.0,
        }

    def __enter__(self) -> ArrayPlayer:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        try:
            self._play()
        except BaseException as error:
            self.error = error
        finally:
            with suppress(Exception):  # a device that is gone cannot be told
                self._device.put_drives(np.zeros(self._shape, np.float32), None, 1 / self.rate_hz)
            with suppress(Exception):
                self._device.close()
            self._begun.set()
            self._done.set()

    def _play(self) -> None:
        period, position = 1 / self.rate_hz, self._first
        self._ahead.wait_for(position)
        self._begun.set()
        tick = step = 0  # of the clock, and of the medium, which stands still while the feed stalls
        begin = first_s = monotonic()
        while self._loop or self._count == 1 or position < self._count:
            if self._stop.wait(max(0.0, begin + tick * period - monotonic())):
                return
            late_s = monotonic() - (begin + tick * period)
            shown = self._ahead.at(position)
            drives, frequencies = shown if shown is not None else (np.zeros(self._shape, np.float32), None)
            self._device.put_drives(drives, frequencies, period)
            now = monotonic()
            first_s = now if not self._counts["sent"] else first_s
            self._span_s = now - first_s
            missed = max(0, math.floor((now - begin) / period) - tick - 1)  # their time is over
            self._counts["sent"] += 1
            self._counts["late"] += late_s > period / 2
            self._counts["skipped"] += missed
            self._counts["stalled"] += shown is None
            tick += 1 + missed
            if shown is not None:
                step += 1 + missed
                position = self._first + step * self._stride


class ArrayDevice(ABC):
    """A fixed array of actuators; its `profile` has columns, rows, panels and levels."""

    profile: Device
    _line: Any = None  # what `open` made, with a `close` of its own

    @abstractmethod
    def open(self) -> None:
        """Find the device and make it ready; `DeviceError` if it is not there, or answers wrongly."""

    @abstractmethod
    def put_drives(self, drives: Float32s, frequencies_hz: Float32s | None, seconds: float) -> None:
        """Show drives, float32 [panels, rows, columns] from 0 to 1, for about so many seconds.

        Row 0 is the top row as one looks at the panel, column 0 the left one; panel 0 is the front. The
        frequencies of the vibration band have the same shape; None where the medium has none. `DeviceError`
        if it is gone.
        """

    def close(self) -> None:
        """All actuators off, then let it go; must not raise, and may be called twice, or after a failed
        `open`.
        """
        if self._line is None:
            return
        columns, rows, _ = self.profile.lattice
        with suppress(Exception):
            self._put_off(np.zeros((self.profile.panels, rows, columns), np.float32))
        line, self._line = self._line, None
        with suppress(Exception):
            line.close()

    def _put_off(self, off: Float32s) -> None:
        """Show the last frame, all off."""
        self.put_drives(off, None, 0.0)
