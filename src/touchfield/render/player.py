"""The player: what a program holds on to while a medium is felt.

    with Player(medium, profile, opener) as player:
        player.play()
        player.wait()

Frames are decoded here, ahead; the force is rendered in a process of its own (docs/decisions/0010).
"""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.errors import InvalidArgument
from touchfield.render.block import words as W
from touchfield.render.block.memory import DEFAULT_BYTES, Block, free_bytes
from touchfield.render.block.record import TickLog, statistics_of
from touchfield.render.process import ServoProcess, zero_afresh
from touchfield.render.session import Session, is_over
from touchfield.render.spec import RenderSpec

if TYPE_CHECKING:
    from touchfield.devices import Device
    from touchfield.medium import HapticMedium, HapticScene
    from touchfield.render.feeder import Feeder
    from touchfield.render.servo import Opener

_WATCH_S: Final = 0.01
_PRELOAD_S: Final = 0.5
_SHARE_OF_FREE: Final = 0.9
_JOIN_S: Final = 5.0


class Player:
    """Plays a medium to a type 1 device.

    Entering it opens the device, which is then without force until `play`; leaving it brings the force to zero and
    closes the device, whatever happened.

    Parameters
    ----------
    medium : HapticMedium or HapticScene
    device_profile : Device
        Type 1: limits and axes.
    opener : callable
        Makes the device, in the servo's process; can be pickled.
    spec : RenderSpec, optional
    memory_bytes : int
        Bound of what is decoded ahead.
    loop : bool
    speed : float
        Media seconds for one second; above 0, up to 100.
    start_s : float
        Media time at which it begins.
    log_rows : int
        Rows of the log that are kept, the latest; 0 for none.
    is_realtime : bool
        Whether SCHED_FIFO is asked for.

    Raises
    ------
    InvalidArgument
        If a number is out of range, or there is no memory for the frames.
    """

    def __init__(
        self,
        medium: HapticMedium | HapticScene,
        device_profile: Device,
        opener: Opener,
        spec: RenderSpec | None = None,
        memory_bytes: int = DEFAULT_BYTES,
        loop: bool = False,
        speed: float = 1.0,
        start_s: float = 0.0,
        *,
        log_rows: int = 600_000,
        is_realtime: bool = True,
    ) -> None:
        if memory_bytes < 1:
            raise InvalidArgument("memory_bytes", repr(memory_bytes), "a positive number of bytes")
        bound = min(memory_bytes, int(_SHARE_OF_FREE * free_bytes()))
        self._spec = RenderSpec() if spec is None else spec
        self._session = Session(medium, device_profile, self._spec, bound, loop, speed, start_s)
        self._opener, self._log_rows, self._is_realtime = opener, log_rows, is_realtime
        self._lock = threading.RLock()
        self._block: Block | None = None
        self._servo: ServoProcess | None = None
        self._watcher: threading.Thread | None = None
        self._is_closing = threading.Event()
        self._statistics: dict[str, Any] = {}
        self._error: Exception | None = None
        self._log: TickLog | None = None
        self._feeder: Feeder | None = None
        self._is_slow = False
        self._rescue: threading.Thread | None = None
        self._notes: tuple[str, ...] = ()

    def __enter__(self) -> Player:
        """Open the device, or raise `DeviceError`; the first frames are decoded meanwhile."""
        if self._block is not None or self._is_closing.is_set():
            raise InvalidArgument("player", "one that was entered before", "a new one")
        self._block = Block.create(self._session.layout.words)
        try:
            memory = self._block.memory
            self._block.reserve(self._session.layout.arena)
            self._session.set_up(memory)
            self._feeder = self._session.feeder(memory, self._block.reserve)
            self._log = TickLog(memory, max(self._log_rows, 0))
            self._servo = ServoProcess(self._block, self._opener, self._is_realtime)
            self._feeder.start()
            self._servo.wait_ready()
            memory.i8[W.HEARTBEAT_NS] = time.perf_counter_ns()
            self._watcher = threading.Thread(target=self._watch, name="touchfield-player", daemon=True)
            self._watcher.start()
            ends = time.monotonic() + _PRELOAD_S  # `play` begins at once if they are quick
            while not self._feeder.is_ahead and self._feeder.error is None and time.monotonic() < ends:
                time.sleep(0.002)
            if self._feeder.error is not None and not self._feeder.is_ahead:
                raise self._feeder.error
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- orders -----------------------------------------------------------------------------------------------

    def play(self) -> None:
        """Let the media clock run."""
        self._order(mode=W.PLAYING)

    def pause(self) -> None:
        """Let the media clock stand; the field is felt as it is."""
        self._order(mode=W.PAUSED)

    def set_speed(self, speed: float) -> None:
        """Media seconds for one second; above 0, up to 100."""
        self._order(speed=speed)

    def seek(self, time_s: float) -> None:
        """Go to a media time, playing or not; the force goes to zero until its frames are there."""
        self._order(seek_s=time_s)

    def _order(self, **wanted: Any) -> None:
        with self._lock:
            if self._block is None or self._feeder is None:
                raise InvalidArgument("player", "one that is not open", "use within its `with`")
            orders = self._session.order(self._block.memory, **wanted)
            if "seek_s" in wanted:
                self._feeder.seek(orders.generation, self._session.frame_at(orders.start_s))

    # -- what is told -----------------------------------------------------------------------------------------

    @property
    def error(self) -> Exception | None:
        """The error that ended the feed, the device or the servo's process; None while all is well."""
        return self._error

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user: axes and limits that cannot be held, damping and coupling that were chosen.

        While it plays also that frames are left out, or what was tried after the servo's end.
        """
        return (*self._session.notes, *self._notes)

    @property
    def servo_pid(self) -> int | None:
        """The servo's process; None where there is none."""
        return self._servo.pid if self._servo is not None else None

    @property
    def media_s(self) -> float:
        """The media time now, seconds."""
        with self._lock:
            return float(self._block.memory.f8[W.MEDIA_S]) if self._block is not None else 0.0

    @property
    def position_m(self) -> tuple[float, float, float]:
        """Where the hand is in the field, metres; zeros before the first tick."""
        with self._lock:
            if self._block is None:
                return 0.0, 0.0, 0.0
            x, y, z = self._block.memory.f8[W.POSITION : W.POSITION + 3].tolist()
            return x, y, z

    @property
    def is_ended(self) -> bool:
        """True if the medium, or the servo, has come to its end and the force to zero."""
        with self._lock:
            if self._block is None or self._servo is None:
                return True
            return self._servo.is_done or self._servo.error is not None or is_over(self._block.memory)

    def wait(self, seconds: float | None = None) -> bool:
        """Wait for the end, or at most so many seconds; whether it has ended.

        Raises what ended the feed, the device or the process (`error`); the force is zero by then.
        """
        ends = None if seconds is None else time.monotonic() + seconds
        while not self.is_ended:
            left = _WATCH_S if ends is None else min(_WATCH_S, ends - time.monotonic())
            if left <= 0:
                return False
            time.sleep(left)
        if self._error is not None:
            raise self._error
        return True

    def statistics(self) -> dict[str, Any]:
        """Counts and times so far, also after the end.

        ``ticks``, ``seconds``, ``rate_hz``, ``mean_rate_hz``; ``jitter_`` (|dT - 1/rate|) and ``lateness_`` each with
        ``p50_us``, ``p99_us``, ``p99_9_us`` and ``worst_us``; ``late_ticks`` (by more than half a period),
        ``missed_ticks``; ``underruns``, ``stalled_ticks``; ``waits`` (after start and seeks), ``waiting_ticks``;
        ``frames_used``; ``latency_min_s``, ``latency_median_s`` from the publication of a frame to its first use,
        ``decode_median_s`` of one frame; ``frames_left_out``, which could not be decoded in time; ``stalled_share``
        of the ticks of play that had nothing; ``log_rows_lost``; ``priority``, ``memory``, ``processors``.
        """
        with self._lock:
            if self._block is not None and self._servo is not None and self._log is not None and self._feeder:
                self._statistics = {
                    **statistics_of(self._block.memory),
                    "decode_median_s": float(np.median(self._feeder.decode_s)) if self._feeder.decode_s else 0.0,
                    "frames_left_out": self._feeder.left_out,
                    "log_rows_lost": self._log.lost,
                    **self._servo.report,
                }
            return dict(self._statistics)

    def log(self) -> NDArray[Any]:
        """The latest rows of the log so far, a structured array of `block.record.COLUMNS`, also after the end."""
        with self._lock:
            if self._log is None:
                raise InvalidArgument("player", "one that was never open", "use within its `with`")
            self._log.drain()
            return self._log.rows()

    # -- within -----------------------------------------------------------------------------------------------

    def _watch(self) -> None:
        """A sign of life for the servo, the log out of the ring, and what the process told."""
        while not self._is_closing.wait(_WATCH_S):
            self._look()

    def _look(self) -> None:
        with self._lock:
            if self._block is None or self._servo is None or self._log is None or self._feeder is None:
                return
            self._block.memory.i8[W.HEARTBEAT_NS] = time.perf_counter_ns()
            self._log.drain()
            self._servo.listen()
            i8 = self._block.memory.i8
            self._servo.notice(int(i8[W.TICKS]), bool(i8[W.RELEASED]))
            if self._servo.is_lost and self._rescue is None:
                self._rescue = threading.Thread(target=self._let_go, name="touchfield-zero", daemon=True)
                self._rescue.start()
            self._error = self._error or self._servo.error or self._feeder.error
            if self._feeder.left_out and not self._is_slow:
                self._is_slow = True
                self._notes = (*self._notes, self._feeder.note)

    def _let_go(self) -> None:
        self._notes = (*self._notes, zero_afresh(self._opener))

    def close(self) -> None:
        """Bring the force to zero, close the device and end the process. May be called twice."""
        with self._lock:
            block = self._block
            if block is None or self._is_closing.is_set():
                return
            self._is_closing.set()
            self._session.order(block.memory, is_stopping=True)
        try:
            if self._watcher is not None:
                self._watcher.join(_JOIN_S)
            if self._servo is not None:
                self._servo.join(1e-9 * float(block.memory.i8[W.RAMP_LIMIT_NS]) + _JOIN_S)
            self._look()
            if self._rescue is not None:
                self._rescue.join()
            self.statistics()
            if self._feeder is not None:
                self._feeder.close(_JOIN_S)
        finally:
            with self._lock:
                self._block = self._feeder = None
                block.unlink()
                if self._log is not None:
                    self._log.let_go()
                block.close()
