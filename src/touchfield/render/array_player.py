"""Plays a medium on an array of actuators, such as a vest: decodes frames of drives (0 to 1 for each
actuator) ahead, and sends them to the device in time.

    frames -> `DrivePrefetcher` (a decoding thread) -> sender (a thread): linear in time, 0 to 1 -> device

An array closes no loop through a hand and needs a tenth of the rate of a point, so threads of the user's
process are enough (docs/decisions/0010). The output is safe for any input: each drive is from 0 to 1, and the
last frame switches all actuators off, whether the medium has ended, `close` was called, or the frames or the
device have raised an error. While the feed stalls, the actuators are off and the medium's time stands still;
playback continues with the missing frame. A medium of a single frame has no end: it plays until it is closed.

At the end of a loop the drives fade from the last frame into the first ones, as a raised cosine over 0.1 s,
at most half the loop. A loop whose end continues into its start, where no drive changes by more than twice as
much as in the frame before, is interpolated there instead; ``c/touch_seam.h`` does the same for points.
"""

from __future__ import annotations

import atexit
import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from time import monotonic
from typing import TYPE_CHECKING, Any, ClassVar, Final, Protocol

import numpy as np

from touchfield.arrays import Float32s
from touchfield.errors import InvalidArgument, is_finite, require_between
from touchfield.render.readiness import DEFAULT_WAIT_S, MAX_WAIT_S, Readiness, open_when_ready

if TYPE_CHECKING:
    from touchfield.devices import Device


DriveSample = tuple[Float32s, Float32s | None]

LOOKAHEAD_S: Final = 0.5
"""Seconds of playback that are decoded ahead."""

MAX_LOOKAHEAD_FRAMES: Final = 256
"""Limit of buffered frames: 13 MB for the largest array known, of 6240 pins."""

DEFAULT_RATE_HZ: Final = 50.0
"""Rate of a device whose profile states none."""

MAX_DEFAULT_RATE_HZ: Final = 100.0
"""Changes in a vibration's intensity that are faster than this cannot be told apart by touch."""

MAX_RATE_HZ: Final = 2000.0

BLEND_S: Final = 0.1
"""Time of the fade at the end of a loop: ``TOUCH_BLEND_S`` of ``c/touch_segment_blend.h``."""

SEAM_RATIO: Final = 2.0
"""Of the changes of two pairs of frames: a larger one is a jump, as ``TOUCH_SEAM_RATIO``."""

SEAM_MIN_DRIVE: Final = 1e-3
"""A smaller change of a drive is none."""

_MAX_CLOSE_S: Final = 5.0
"""Time for which `close` waits for a decoder that is in the middle of a frame."""


class DriveFrames(Protocol):
    """Frames of drives, computed on request; used by one thread only."""

    rate_hz: float
    frame_count: int

    def drives(self, frame: int) -> Float32s:
        """Return the drives of a frame, float32 [panels, rows, columns], 0 to 1."""
        ...

    def frequencies(self, frame: int) -> Float32s | None:
        """Return the frequencies of a frame in Hz, of the same shape, or None."""
        ...


class DrivePrefetcher:
    """Decodes, in its own thread, the frames that a player needs next.

    A *position* counts frames from the start and continues through the repeats of a loop; it may have a
    fraction. Every frame has the shape `shape`. `first` is the position of the player's first frame, `stride`
    the step from one of its frames to the next, and `rate_hz` the player's rate. Without `is_blended`, a loop
    ends with a step.
    """

    def __init__(
        self,
        frames: DriveFrames,
        shape: tuple[int, int, int],
        first: float,
        stride: float,
        rate_hz: float,
        loop: bool,
        is_blended: bool = True,
    ) -> None:
        self._frames, self._shape, self._loop = frames, shape, loop
        self._fade_frames = min(BLEND_S * rate_hz * stride, 0.5 * frames.frame_count) if is_blended else 0.0
        self._ends: dict[int, DriveSample] = {}  # the first and the last two frames, once they are decoded
        self._lookahead = stride * np.arange(max(2, math.ceil(LOOKAHEAD_S * rate_hz)))
        self._position = first
        self._buffer: dict[int, DriveSample] = {}
        self._changed = threading.Condition()
        self._error: BaseException | None = None
        self._is_stopped = False
        self.thread = threading.Thread(target=self._run, name="touchfield-array-ahead", daemon=True)

    def stop(self) -> None:
        """Stop decoding."""
        with self._changed:
            self._is_stopped = True
            self._changed.notify_all()

    def wait_for(self, position: float) -> None:
        """Wait until the frames for a position are decoded, or decoding has ended."""
        with self._changed:
            needed = self._needed(position)
            self._changed.wait_for(
                lambda: self._is_stopped or self._error is not None or all(n in self._buffer for n in needed)
            )

    def at(self, position: float) -> DriveSample | None:
        """Return drives and frequencies at a position, linear between frames.

        Returns None while the feed stalls.

        The frequencies are those of the nearest frame, and of the other frame where it has none. An error of
        the frames is raised once a frame that it prevented is needed.
        """
        with self._changed:
            self._position = position
            self._changed.notify_all()
            needed = self._needed(position)
            samples = [self._buffer[n] for n in needed if n in self._buffer]
            is_missing = len(samples) < len(needed)
            if is_missing and self._error is not None:
                raise self._error
            last, following = self._ends.get(self._frames.frame_count - 1), self._buffer.get(needed[-1] + 1)
        if is_missing:
            return None
        is_last = len(needed) == 1 and position > needed[0]
        if is_last and following is not None and self._loop and not self._is_jump():
            samples.append(following)
        drives, frequencies_hz = _between(samples[0], samples[-1], position - needed[0])
        weight = self._weight_of_last(position)
        if weight > 0.0 and last is not None:
            drives, frequencies_hz = _between((drives, frequencies_hz), last, weight)
        return np.clip(drives, np.float32(0), np.float32(1)), frequencies_hz

    def _weight_of_last(self, position: float) -> float:
        """Return the weight of the last frame in the fade after the end of a loop, 0 to 1."""
        count = self._frames.frame_count
        passed = position % count
        if not (self._loop and position >= count and passed < self._fade_frames and self._is_jump()):
            return 0.0
        return 0.5 + 0.5 * math.cos(math.pi * passed / self._fade_frames)

    def _is_jump(self) -> bool:
        """Return whether the end of the medium does not continue into its start, as far as is known."""
        count = self._frames.frame_count
        ends = [self._ends.get(frame % count) for frame in (count - 2, count - 1, count)]
        if count < 3 or self._fade_frames == 0.0:
            return True
        before, last, first = (None if sample is None else sample[0] for sample in ends)
        if before is None or last is None or first is None:
            return True
        change, own = np.abs(first - last).max(), np.abs(last - before).max()
        return bool(change > SEAM_RATIO * own + SEAM_MIN_DRIVE)

    def _run(self) -> None:
        try:
            while True:
                with self._changed:
                    while (number := self._next()) is None and not self._is_stopped:
                        self._changed.wait()
                    if self._is_stopped or number is None:
                        return
                frame = number % self._frames.frame_count
                drives = self._frames.drives(frame)
                if drives.shape != self._shape:
                    raise InvalidArgument(
                        f"drives of frame {frame}", f"shape {drives.shape}", f"{self._shape}"
                    )
                finite = np.nan_to_num(drives, nan=0.0, posinf=1.0, neginf=0.0)
                limited = np.clip(finite, 0.0, 1.0).astype(np.float32)
                sample = limited, self._frames.frequencies(frame)
                with self._changed:
                    self._buffer[number] = sample
                    if frame == 0 or frame >= self._frames.frame_count - 2:
                        self._ends[frame] = sample
                    self._changed.notify_all()
        except BaseException as error:
            with self._changed:
                self._error = error
                self._changed.notify_all()

    def _next(self) -> int | None:
        """Return the next position to decode, or None; drops positions that were passed."""
        current = self._needed(self._position)
        later = np.floor(self._position + self._lookahead).astype(np.int64)
        plan = np.unique(np.concatenate([current, later, later + 1]))
        if self._frames.frame_count == 1:
            plan = np.zeros(1, np.int64)
        elif not self._loop:
            plan = plan[plan < self._frames.frame_count]
        plan = plan[:MAX_LOOKAHEAD_FRAMES]
        for passed in self._buffer.keys() - set(plan.tolist()):
            del self._buffer[passed]
        return next((int(n) for n in plan if int(n) not in self._buffer), None)

    def _needed(self, position: float) -> list[int]:
        """Return the positions of the one or two frames for a position of the player.

        The last frame of the medium needs no other one.
        """
        first, count = math.floor(position), self._frames.frame_count
        if count == 1:
            return [0]  # decoded once, however often it is shown
        is_last = (first + 1) % count == 0
        return [first] if is_last or first == position else [first, first + 1]


def _between(before: DriveSample, after: DriveSample, weight: float) -> DriveSample:
    """Return drives between two samples, linear in the weight of the second, and frequencies.

    These are those of the nearer sample, and of the other one where it has none.
    """
    drives = before[0] + np.float32(weight) * (after[0] - before[0])
    nearest_hz, other_hz = (before[1], after[1]) if weight < 0.5 else (after[1], before[1])
    if nearest_hz is None or other_hz is None:
        return drives, other_hz if nearest_hz is None else nearest_hz
    return drives, np.where(nearest_hz > 0, nearest_hz, other_hz)


class ArrayPlayer:
    """Plays frames of drives on an array; a context manager that closes the device.

    `frames` are for example `touchfield.pipeline.array_medium.Drives`. `rate_hz` is the number of frames a
    second sent to the device; its default is the profile's rate, at most 100, or 50 if the profile has none.
    `speed` is seconds of the medium for one second, and `start_s` the time of the medium to start at. The
    device may take `wait_s` seconds to get ready; `on_note` is called with what it lacks. Without
    `is_blended`, the drives step where a loop ends. Raises `InvalidArgument` if a number is out of range or
    `start_s` is past the end of the medium.
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
        wait_s: float = DEFAULT_WAIT_S,
        on_note: Callable[[str], None] = lambda note: None,
        is_blended: bool = True,
    ) -> None:
        require_between(0, MAX_WAIT_S, wait_s=wait_s)
        self._wait_s, self._on_note = wait_s, on_note
        default_hz = min(device.profile.rate_hz or DEFAULT_RATE_HZ, MAX_DEFAULT_RATE_HZ)
        rate = default_hz if rate_hz is None else float(rate_hz)
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
        self._prefetcher = DrivePrefetcher(
            frames, self._shape, self._first, self._stride, rate, loop, is_blended
        )
        self._stop, self._started, self._done = threading.Event(), threading.Event(), threading.Event()
        self._sender = threading.Thread(target=self._run, name="touchfield-array", daemon=True)
        self.error: BaseException | None = None  # what ended playback early
        self._is_open = False
        self._counts = dict.fromkeys(("sent", "late", "skipped", "stalled"), 0)
        self._span_s = 0.0

    def start(self) -> None:
        """Open the device, wait until it is ready, and start playing; can be called once only.

        Raises `DeviceError` if it cannot be opened or is not ready in time.
        """
        if self._is_open or self._stop.is_set():
            raise InvalidArgument("start", "a player that was started before", "a new player")
        self._is_open = True
        try:
            open_when_ready(self._device, self._wait_s, on_note=self._on_note)
        except BaseException:
            for event in (self._stop, self._started, self._done):
                event.set()
            self._device.close()
            raise
        atexit.register(self.close)  # a program that ends without `close` must not leave an actuator on
        self._prefetcher.thread.start()
        self._sender.start()

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait until all is played and the actuators are off; returns whether that is so.

        Raises the error of the device or of the frames that ended playback.
        """
        is_done = self._done.wait(timeout_s)
        if is_done and self.error is not None:
            raise self.error
        return is_done

    def wait_started(self, timeout_s: float | None = None) -> bool:
        """Wait until the first frame is about to be sent, or never will be.

        Returns whether that is so.
        """
        return self._started.wait(timeout_s)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user: that the feed stalled, and those of the device."""
        note = "Frames are not ready in time: the actuators are off until they are. A lower --speed may help"
        return (*((note,) if self._counts["stalled"] else ()), *self._device.notes)

    def close(self) -> None:
        """Switch all actuators off and close the device; never raises, and may be called twice."""
        atexit.unregister(self.close)
        self._stop.set()
        self._prefetcher.stop()
        if self._sender.is_alive():
            self._sender.join()
        if self._prefetcher.thread.is_alive():
            self._prefetcher.thread.join(_MAX_CLOSE_S)

    def statistics(self) -> dict[str, float]:
        """Counts of frames, and the mean rate.

        ``sent``; ``late``, sent more than half a period late; ``skipped``, not sent because the frame before
        took too long; ``stalled``, sent with all actuators off because no frame was ready; and
        ``mean_rate_hz``, which is 0 until two frames were sent.
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
            with suppress(Exception):  # the device may be gone
                self._device.put_drives(np.zeros(self._shape, np.float32), None, 1 / self.rate_hz)
            with suppress(Exception):
                self._device.close()
            self._started.set()
            self._done.set()

    def _play(self) -> None:
        period, position = 1 / self.rate_hz, self._first
        self._prefetcher.wait_for(position)
        self._started.set()
        tick = step = 0  # periods of the clock; frames of the medium, which waits while the feed stalls
        start_s = first_sent_s = monotonic()
        while self._loop or self._count == 1 or position < self._count:
            if self._is_stopped_before(start_s + tick * period):
                return
            late_s = monotonic() - (start_s + tick * period)
            sample = self._prefetcher.at(position)
            drives, frequencies = sample if sample is not None else (np.zeros(self._shape, np.float32), None)
            self._device.put_drives(drives, frequencies, period)
            now = monotonic()
            first_sent_s = now if not self._counts["sent"] else first_sent_s
            self._span_s = now - first_sent_s
            missed = max(0, math.floor((now - start_s) / period) - tick - 1)  # periods already over
            self._counts["sent"] += 1
            self._counts["late"] += late_s > period / 2
            self._counts["skipped"] += missed
            self._counts["stalled"] += sample is None
            tick += 1 + missed
            if sample is not None:
                step += 1 + missed
                position = self._first + step * self._stride

    def _is_stopped_before(self, deadline_s: float) -> bool:
        """Wait for a time of the monotonic clock, and keep the device alive; returns whether a stop came."""
        while (remaining_s := deadline_s - monotonic()) > self._device.keep_alive_s:
            if self._stop.wait(self._device.keep_alive_s):
                return True
            self._device.keep_alive()
        return self._stop.wait(max(0.0, remaining_s))


class ArrayDevice(ABC):
    """A fixed array of actuators; its `profile` has columns, rows, panels and levels."""

    title: ClassVar[str] = "device"
    """Name of the kind of device in messages."""

    keep_alive_s: ClassVar[float] = math.inf
    """Longest time between two calls of `put_drives` or `keep_alive`, seconds.

    A device whose player died must not stay on: it switches off by itself after a time that its protocol
    states, which is at least three times as long.
    """

    notes: tuple[str, ...] = ()
    """Notes for the user about the device during playback."""

    profile: Device
    _line: Any = None  # the connection that `open` made; has `close`

    @abstractmethod
    def open(self) -> None:
        """Find the device and connect to it.

        Raises `DeviceAbsent` if it is missing, and `DeviceError` if another program uses it or it answers
        wrongly.
        """

    def readiness(self) -> Readiness:
        """Return the state of the open device; raises `DeviceError` if it is gone."""
        return Readiness()

    @abstractmethod
    def put_drives(self, drives: Float32s, frequencies_hz: Float32s | None, seconds: float) -> None:
        """Show drives, float32 [panels, rows, columns] from 0 to 1, for about `seconds`.

        Row 0 is the top row as one looks at the panel, column 0 the left column, and panel 0 the front. The
        frequencies of the vibration band have the same shape; they are None if the medium has none. Raises
        `DeviceError` if the device is gone.
        """

    def pressed_keys(self) -> tuple[str, ...]:
        """Return the keys of the device that were pressed since the last call, by what they request.

        These are moves of `touchfield.tasks.map_play.ALL_MOVES`. Raises `DeviceError` if the device is gone.
        """
        return ()

    def keep_alive(self) -> None:
        """Let the device show the latest drives for longer; called after `put_drives` only.

        Raises `DeviceError` if the device is gone.
        """
        return

    def close(self) -> None:
        """Switch all actuators off and release the device.

        Must not raise, and may be called twice or after a failed `open`.
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
        """Show the last frame, in which all actuators are off."""
        self.put_drives(off, None, 0.0)
