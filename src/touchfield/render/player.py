"""`Player`: the object by which a program plays a medium on a force-feedback device. It starts the servo's
process, gives it frames and orders (play, seek, stop), and ends it safely.

    with Player(medium, profile, opener) as player:
        player.play()
        player.wait()

Frames are decoded ahead in this process; the force is rendered in a process of its own (docs/decisions/0010).
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.compute.native import native
from touchfield.errors import (
    InvalidArgument,
    is_finite,
    require_between,
    require_positive,
    require_up_to,
)
from touchfield.render.block import (
    DEFAULT_BYTES,
    LOG_ROWS,
    SLOTS,
    Block,
    Layout,
    Memory,
    TickLog,
    free_bytes,
    layout,
    statistics_of,
)
from touchfield.render.feeder import FIRST_GENERATION, Feeder, FrameSource, arena_bytes
from touchfield.render.material import material_bytes, stored_materials, write_materials
from touchfield.render.readiness import DEFAULT_WAIT_S, MAX_WAIT_S
from touchfield.render.servo import Opener
from touchfield.render.servo_process import ServoProcess
from touchfield.render.spec import (
    RenderSpec,
    Stability,
    Wall,
    delay_s_of,
    stability_of,
    write_delay,
    write_parameters,
)
from touchfield.render.tool import tool_bytes, write_tool

if TYPE_CHECKING:
    from touchfield.devices import Device
    from touchfield.medium import HapticMedium, HapticScene


_WATCH_S: Final = 0.01
_PRELOAD_S: Final = 0.5
_FRACTION_OF_FREE: Final = 0.9
_JOIN_S: Final = 5.0


class Grip(NamedTuple):
    """What a device reported at a tick besides its position."""

    buttons: int  # bit n is button n
    gripper_m: float  # opening of the gripper
    orientation: tuple[float, float, float, float]  # unit quaternion, w first: device from grip


class ButtonEvent(NamedTuple):
    """A button that was pressed or released."""

    button: int  # number of its bit
    is_pressed: bool
    time_s: float  # since the first tick, as in the log
    media_s: float
    position_m: tuple[float, float, float]  # of the hand in the field
    gripper_m: float


class Player:
    """Plays a medium on a type 1 device.

    Entering the context opens the device and waits up to `wait_s` seconds (at most an hour) until it is
    ready; `on_note` is called with what it waits for. The device has no force until `play`. Leaving the
    context brings the force to zero and closes the device, whatever happened.

    `device_profile` is of type 1. `opener` makes the device in the servo's process and can be pickled.
    `memory_bytes` bounds the frames decoded ahead, `speed` is seconds of the medium for one second (above 0,
    up to 100), and `start_s` is the media time to start at. The log keeps the latest `log_rows` rows.
    `is_realtime` requests SCHED_FIFO. `on_button` is called for each button that was pressed or released, in
    order, within about 10 ms, from a thread of the player; it may give orders. If it raises an error, the
    player stops with that error. Raises `InvalidArgument` if a number is out of range or the memory is too
    small for the frames.
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
        wait_s: float = DEFAULT_WAIT_S,
        on_note: Callable[[str], None] = lambda note: None,
        on_button: Callable[[ButtonEvent], None] | None = None,
    ) -> None:
        require_positive(memory_bytes=memory_bytes)
        require_between(0, MAX_WAIT_S, wait_s=wait_s)
        bound = min(int(memory_bytes), int(_FRACTION_OF_FREE * free_bytes()))
        self._session = Session(medium, device_profile, spec or RenderSpec(), bound, loop, speed, start_s)
        self._opener, self._log_rows, self._is_realtime = opener, log_rows, is_realtime
        self._wait_s, self._on_note, self._on_button = wait_s, on_note, on_button
        self._lock = threading.RLock()
        self._block: Block | None = None
        self._servo: ServoProcess | None = None
        self._watcher: threading.Thread | None = None
        self._is_closing = threading.Event()
        self._statistics: dict[str, Any] = {}
        self._error: Exception | None = None
        self._log: TickLog | None = None
        self._button_log: TickLog | None = None
        self._pressed = 0
        self._feeder: Feeder | None = None
        self._is_slow = False
        self._rescue: threading.Thread | None = None
        self._notes: tuple[str, ...] = ()

    def __enter__(self) -> Player:
        """Open the device and wait until it is ready, or raise `DeviceError`.

        The first frames are decoded meanwhile.
        """
        if self._block is not None or self._is_closing.is_set():
            raise InvalidArgument("player", "one that was entered before", "a new one")
        self._block = Block.create(self._session.layout.size_bytes)
        try:
            memory = self._block.memory
            self._block.reserve(self._session.layout.arena)
            self._session.set_up(memory)
            self._feeder = self._session.feeder(memory, self._block.reserve)
            self._log = TickLog(memory, max(self._log_rows, 0))
            self._button_log = TickLog(memory, LOG_ROWS if self._on_button else 0)
            self._servo = ServoProcess(
                self._block, self._opener, self._is_realtime, self._wait_s, self._on_note
            )
            self._feeder.start()
            self._servo.wait_ready()
            memory.receiver["orders"]["heartbeat_ns"] = time.perf_counter_ns()
            self._watcher = threading.Thread(target=self._watch, name="touchfield-player", daemon=True)
            self._watcher.start()
            deadline = time.monotonic() + _PRELOAD_S  # so that `play` usually starts immediately
            while (
                not (self._feeder.is_preloaded and self._has_delay)
                and self._feeder.error is None
                and time.monotonic() < deadline
            ):
                time.sleep(0.002)
            if self._feeder.error is not None and not self._feeder.is_preloaded:
                raise self._feeder.error
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def play(self) -> None:
        """Start the media clock."""
        self._send_orders(mode=layout.PLAYING)

    def pause(self) -> None:
        """Stop the media clock; the field stays as it is."""
        self._send_orders(mode=layout.PAUSED)

    def set_speed(self, speed: float) -> None:
        """Set the speed, seconds of the medium for one second; above 0, up to 100."""
        self._send_orders(speed=speed)

    def seek(self, time_s: float) -> None:
        """Go to a media time, playing or not; the force fades, to zero if the frames take 0.1 s or more."""
        self._send_orders(seek_s=self._session.media_time_s(time_s))

    def _send_orders(self, **changes: Any) -> None:
        with self._lock:
            if self._block is None or self._feeder is None:
                raise InvalidArgument("player", "one that is not open", "use within its `with`")
            orders = self._session.order(self._block.memory, **changes)
            if "seek_s" in changes:
                self._feeder.seek(orders.generation, self._session.frame_at(orders.start_s))

    @property
    def error(self) -> Exception | None:
        """The error that ended the feed, the device or the servo's process, or None."""
        return self._error

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user.

        They concern axes, limits, damping, coupling, a slow loop, frames left out, and the loss of servo or
        standby.
        """
        servo_notes = () if self._servo is None else self._servo.notes
        return (*self._session.notes, *servo_notes, *self._notes)

    @property
    def servo_pid(self) -> int | None:
        """Process id of the servo; None if there is none."""
        return self._servo.pid if self._servo is not None else None

    @property
    def media_s(self) -> float:
        """Current media time, seconds."""
        with self._lock:
            return float(self._block.memory.receiver["clock"]["media_s"]) if self._block is not None else 0.0

    @property
    def position_m(self) -> tuple[float, float, float]:
        """Position of the hand in the field, metres; zeros before the first tick."""
        with self._lock:
            if self._block is None:
                return 0.0, 0.0, 0.0
            x, y, z = self._block.memory.receiver["state"]["position_m"].tolist()
            return x, y, z

    @property
    def grip(self) -> Grip:
        """Buttons, gripper and orientation at the latest tick; none, 0 and the identity before the first."""
        with self._lock:
            if self._block is None:
                return Grip(0, 0.0, (1.0, 0.0, 0.0, 0.0))
            grip = self._block.memory.receiver["grip"]
            w, x, y, z = grip["orientation"].tolist()
            return Grip(int(grip["buttons"]), float(grip["gripper_m"]), (w, x, y, z))

    @property
    def buttons(self) -> int:
        """Buttons pressed at the latest tick: bit n is button n. `on_button` misses no short press."""
        return self.grip.buttons

    @property
    def gripper_m(self) -> float:
        """Opening of the gripper at the latest tick, metres."""
        return self.grip.gripper_m

    @property
    def is_ended(self) -> bool:
        """True if the medium or the servo has ended and the force is zero."""
        with self._lock:
            if self._block is None or self._servo is None:
                return True
            return self._servo.is_done or self._servo.error is not None or is_over(self._block.memory)

    def wait(self, seconds: float | None = None) -> bool:
        """Wait for the end, or at most `seconds`; returns whether it has ended.

        Raises the error that ended the feed, the device or the process (`error`); the force is zero by then.
        """
        deadline = None if seconds is None else time.monotonic() + seconds
        while not self.is_ended:
            pause_s = _WATCH_S if deadline is None else min(_WATCH_S, deadline - time.monotonic())
            if pause_s <= 0:
                return False
            time.sleep(pause_s)
        self._update()  # the watcher may not have run since
        if self._error is not None:
            raise self._error
        return True

    def statistics(self) -> dict[str, Any]:
        """Counts and times so far; also available after the end.

        ``ticks``, ``seconds``, ``rate_hz``, ``mean_rate_hz``; ``jitter_`` (|dT - 1/rate|) and ``lateness_``,
        each with ``p50_us``, ``p99_us``, ``p99_9_us`` and ``worst_us``; ``late_ticks`` (by more than half a
        period), ``missed_ticks``; ``underruns``, ``stalled_ticks``; ``waits`` (after start and seeks),
        ``waiting_ticks``; ``frames_used``; ``decode_median_s`` of one frame; ``frames_left_out``, which could
        not be decoded in time; ``stalled_share``, the fraction of ticks during play without a frame;
        ``log_rows_lost``; ``priority``, ``memory``, ``processors``; ``delay_p50_us`` and
        ``delay_p90_us``, the time from position to force in the slowest second of the loop (None if it was
        not measured), and ``delay_used_us``, for which stability was chosen.
        """
        with self._lock:
            if self._block is not None and self._servo is not None and self._log is not None and self._feeder:
                decode_s = self._feeder.decode_s
                self._statistics = {
                    **statistics_of(self._block.memory),
                    "decode_median_s": float(np.median(decode_s)) if decode_s else 0.0,
                    "frames_left_out": self._feeder.dropped_frames,
                    "log_rows_lost": self._log.lost,
                    **self._delays_us(),
                    **self._servo.report,
                }
            return dict(self._statistics)

    def _delays_us(self) -> dict[str, float | None]:
        """Return the delays for `statistics`."""
        times = None if self._servo is None else self._servo.loop_times
        return {
            "delay_p50_us": None if times is None else 1e6 * times.median_s,
            "delay_p90_us": None if times is None else 1e6 * times.delay_s,
            "delay_used_us": 1e6 * self._session.delay_s,
        }

    def log(self) -> NDArray[Any]:
        """Return the latest rows of the log, a structured array of `block.COLUMNS`.

        Also available after the end.
        """
        with self._lock:
            if self._log is None:
                raise InvalidArgument("player", "one that was never open", "use within its `with`")
            self._log.drain()
            return self._log.rows()

    def _watch(self) -> None:
        """Send a heartbeat to the servo, drain the log and read the servo's messages."""
        while not self._is_closing.wait(_WATCH_S):
            self._update()
            self._report_buttons()

    def _report_buttons(self) -> None:
        """Call `on_button` for the changes since the last call, without the lock."""
        with self._lock:
            if self._on_button is None or self._button_log is None or self._block is None:
                return
            self._button_log.drain()
            rows = self._button_log.take()
        try:
            for event in button_events(rows, self._pressed):
                self._on_button(event)
        except Exception as error:
            self._on_button = None
            with self._lock:
                self._error = self._error or error
                self._session.order(self._block.memory, is_stopping=True)
        if len(rows):
            self._pressed = int(rows["buttons"][-1])

    def _update(self) -> None:
        with self._lock:
            if self._block is None or self._servo is None or self._log is None or self._feeder is None:
                return
            receiver = self._block.memory.receiver
            receiver["orders"]["heartbeat_ns"] = time.perf_counter_ns()
            self._log.drain()
            self._servo.receive()
            is_released = bool(receiver["clock"]["is_released"])
            self._servo.check_progress(int(receiver["counts"]["ticks"]), is_released)
            if self._servo.loop_times is not None:
                self._session.adapt_delay(self._block.memory, self._servo.loop_times.lag_s)
            if self._servo.is_unreleased and self._rescue is None:
                self._rescue = threading.Thread(target=self._force_zero, name="touchfield-zero", daemon=True)
                self._rescue.start()
            self._error = self._error or self._servo.error or self._feeder.error
            if self._feeder.dropped_frames and not self._is_slow:
                self._is_slow = True
                self._notes = (*self._notes, self._feeder.note)

    @property
    def _has_delay(self) -> bool:
        """True once the delay of the loop is known, and for a simulated device, which has none."""
        assert self._block is not None and self._servo is not None
        return bool(
            self._servo.loop_times is not None or self._block.memory.receiver["layout"]["is_simulated"]
        )

    def _force_zero(self) -> None:
        """Wait for a force of zero after the servo's process was lost."""
        assert self._servo is not None
        self._notes = (*self._notes, self._servo.zero_force())

    def close(self) -> None:
        """Bring the force to zero, close the device and end the process.

        May be called twice.
        """
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
                ramp_limit_ns = block.memory.receiver["layout"]["ramp_limit_ns"]
                self._servo.join(1e-9 * float(ramp_limit_ns) + _JOIN_S)
            self._update()
            self._report_buttons()
            if self._rescue is not None:
                self._rescue.join()
            if self._servo is not None:
                self._servo.join_standby()
            self.statistics()
            if self._feeder is not None:
                self._feeder.close(_JOIN_S)
        finally:
            with self._lock:
                self._block = self._feeder = None
                block.unlink()
                for log in (self._log, self._button_log):
                    if log is not None:
                        log.let_go()
                block.close()


def button_events(rows: NDArray[Any], pressed: int) -> Iterator[ButtonEvent]:
    """Yield the changes of the buttons in rows of the log, a structured array of `block.COLUMNS`.

    `pressed` are the buttons before the first row.
    """
    changes = np.diff(rows["buttons"], prepend=np.int64(pressed))
    for row in rows[np.flatnonzero(changes)]:
        buttons = int(row["buttons"])
        changed, pressed = buttons ^ pressed, buttons
        x, y, z = row["position_m"].tolist()
        values = float(row["time_s"]), float(row["media_s"]), (x, y, z), float(row["gripper_m"])
        for button in range(changed.bit_length()):
            if changed >> button & 1:
                yield ButtonEvent(button, bool(buttons >> button & 1), *values)


MAX_SPEED: Final = 100.0
_SLOWER: Final = 1.02
_NOTED_SLOWER: Final = 1.2
_MAX_DELAY_S: Final = 0.1
"""Ratios of delays that count as slower and that are noted, and the largest delay."""

_DELAY_STEP: Final = 1.05
_DELAY_STEP_S: Final = 2e-5
"""Step of the delay while it is played, as a ratio and in seconds."""

_LOOKAHEAD_S: Final = 4.0  # seconds of a medium that the directory can hold, up to `_MAX_SLOTS` frames
_MAX_SLOTS: Final = 1 << 14


@dataclass(frozen=True)
class Orders:
    """Orders of the player to the servo: a generation, its start time, and a mode."""

    generation: int
    start_s: float
    speed: float = 1.0
    mode: int = layout.IDLE
    is_stopping: bool = False

    def __post_init__(self) -> None:
        require_up_to(MAX_SPEED, speed=self.speed)


class Session:
    """Sizes, parameters, first order and feeder of a session on a type 1 device.

    The arguments are those of `Player`.
    """

    def __init__(
        self,
        medium: HapticMedium | HapticScene,
        device: Device,
        spec: RenderSpec,
        memory_bytes: int = DEFAULT_BYTES,
        loop: bool = False,
        speed: float = 1.0,
        start_s: float = 0.0,
    ) -> None:
        self.source = FrameSource(medium, spec.blend, spec.deformation)
        self._device, self._spec, self.is_loop = device, spec, loop
        self._stated = device
        self.delay_s = delay_s_of(device)
        self._target_s = 0.0  # the largest delay that was measured
        self._noted_s = 0.0  # the largest delay that a note names
        self._lock = threading.Lock()  # of damping and coupling: the feeder and the watcher adapt them
        self.orders = Orders(FIRST_GENERATION, self.media_time_s(start_s), speed)
        lookahead = min(_LOOKAHEAD_S * self.source.rate_hz * max(speed, 1.0), float(_MAX_SLOTS))
        slots = max(1 << math.ceil(lookahead - 1).bit_length(), SLOTS)
        self._materials = stored_materials(medium.provenance) if spec.materials is None else spec.materials
        self._objects = tuple(body.name for body in getattr(medium, "objects", ()))
        deformation = spec.deformation
        self._yield_bytes = 0
        if deformation is not None and deformation.compliance_m_per_n:
            self._yield_bytes = deformation.displacement_m[0].nbytes
        self.layout = Layout(
            arena_bytes(self.source, memory_bytes),
            slots,
            LOG_ROWS,
            tool_bytes(spec.tool),
            material_bytes(self._materials),
            self._yield_bytes,
        )
        self._notes: tuple[str, ...] = ()
        self._proxy_note = ""
        self._wall = self._wall_of_spec()
        self._stability: Stability | None = None
        self._stiffest_n_per_m = -math.inf

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user; those on damping and coupling reflect the frames and the loop so far."""
        notes = self._notes if self._stability is None else (*self._notes, self._stability.note)
        return (*notes, self._delay_note) if self._noted_s else notes

    @property
    def _delay_note(self) -> str:
        stated_ms = self._stated.delay_ms
        stated = "1 ms that is assumed" if stated_ms is None else f"{stated_ms:g} ms that its profile states"
        return (
            f"from position to force the loop of {self._stated.name} takes {1e3 * self._noted_s:.2g} ms, "
            f"more than the {stated}: stability is chosen for that"
        )

    def _wall_of_spec(self) -> Wall | None:
        """Return the wall of the proxy; None if the field is rendered without a proxy.

        If --render auto does without a proxy, `_proxy_note` states why.
        """
        spec, reason = self._spec, ""
        if spec.render == "field":
            return None
        if spec.tool is not None:
            reason = "the proxy is that of a point, not of a tool"
        elif spec.deformation is not None:
            reason = "a deformed medium is rendered as stored"
        elif spec.render == "auto" and spec.coupling_n_per_m:
            reason = "a coupling was requested"
        wall = None if reason else self.source.wall()
        if wall is None and not reason:
            if spec.render == "proxy":
                raise InvalidArgument("render", "'proxy' for a field without walls", "field, or auto")
            reason = "its forces are not those of walls, which grow inwards from a surface"
        if wall is None:
            self._proxy_note = f"no proxy, so a hand may pass through thin walls: {reason}"
            return None
        return wall if spec.wall_n_per_m is None else replace(wall, stiffness_n_per_m=spec.wall_n_per_m)

    def media_time_s(self, time_s: float) -> float:
        """Return the media time for a seek.

        Past the end, it wraps in a loop, and otherwise is the end.
        """
        if not (is_finite(time_s) and time_s >= 0):
            raise InvalidArgument("time", repr(time_s), "seconds from the start, 0 or more")
        if self.source.frame_count == 1:
            return 0.0
        seconds = self.source.frame_count / self.source.rate_hz
        return math.fmod(time_s, seconds) if self.is_loop else min(time_s, seconds)

    def frame_at(self, time_s: float) -> int:
        """Return the unrolled frame at a media time."""
        return native.unrolled_frame(time_s, self.source.rate_hz)

    def set_up(self, memory: Memory, mode: int = layout.IDLE) -> None:
        """Write everything that the servo needs before its first tick."""
        source, spec = self.source, self._spec
        self.layout.write(memory, source.frame_count, source.rate_hz, self.is_loop, spec.rate_hz, spec.blend)
        self._notes = write_parameters(
            memory, spec, self._device, source.friction, source.damping_n_s_per_m, source.axes
        )
        write_tool(memory, self.layout.tool, spec.tool)
        has_friction = spec.friction is None
        self._notes += write_materials(
            memory, self.layout.materials, self._materials, self._objects, has_friction
        )
        if self._yield_bytes:
            memory.bytes[self.layout.yields : self.layout.yields + self._yield_bytes] = 0
            source.yield_at = self.layout.yields
        settings = memory.receiver["settings"]
        if self._wall is not None:
            settings["wall_n_per_m"] = self._wall.stiffness_n_per_m
            settings["wall_level_n"] = self._wall.level_n
            settings["wall_force_n"] = self._wall.large_n
            settings["wall_spacing_m"] = self._wall.spacing_m
            self._notes = (
                *self._notes,
                f"a proxy holds the hand at walls of {self._wall.stiffness_n_per_m:.0f} N/m",
            )
        elif self._proxy_note:
            self._notes = (*self._notes, self._proxy_note)
        memory.receiver["clock"]["media_s"] = self.orders.start_s
        self._stiffest_n_per_m, self._stability = -math.inf, None
        self._adapt(memory, source.stiffest_n_per_m if self._wall is None else self._wall.stiffness_n_per_m)
        self.order(memory, mode=mode)

    def _adapt(self, memory: Memory, stiffness_n_per_m: float) -> None:
        """Choose damping and coupling anew if a frame is stiffer than those before.

        The ticks approach the new values slowly.
        """
        with self._lock:
            is_final = self._wall is not None and self._stability is not None
            if stiffness_n_per_m <= self._stiffest_n_per_m or is_final:
                return
            self._stiffest_n_per_m = stiffness_n_per_m
            self._write_stability(memory)

    def adapt_delay(self, memory: Memory, lag_s: Callable[[float], float]) -> None:
        """Choose all that depends on the delay anew if the loop is slower than what it was chosen for.

        `lag_s` returns the measured lag of a loop with a nominal rate, Hz. Before `play` the new delay holds
        at once; later it is approached, by a small step at each call, so that no force jumps. It never falls.
        """
        measured_s = min(lag_s(self._spec.rate_hz), _MAX_DELAY_S)
        if measured_s > _SLOWER * max(self._target_s, self.delay_s):
            self._target_s = measured_s
        measured_s = self._target_s
        if measured_s <= self.delay_s:
            return
        with self._lock:
            if measured_s > _NOTED_SLOWER * max(self._noted_s, self.delay_s):
                self._noted_s = measured_s
            is_idle = self.orders.mode == layout.IDLE
            next_s = measured_s if is_idle else _DELAY_STEP * self.delay_s + _DELAY_STEP_S
            self.delay_s = min(measured_s, next_s)
            self._device = replace(self._device, delay_ms=1e3 * self.delay_s)
            write_delay(memory, self._spec, self._device, self.source.friction, self.source.damping_n_s_per_m)
            if self._stiffest_n_per_m > -math.inf:
                self._write_stability(memory)

    def _write_stability(self, memory: Memory) -> None:
        stiffest_n_per_m = self._stiffest_n_per_m
        stability = stability_of(self._device, self._spec, self.source.damping_n_s_per_m, stiffest_n_per_m)
        memory.receiver["settings"]["brake_n_s_per_m"] = stability.brake_n_s_per_m
        memory.receiver["settings"]["coupling_n_per_m"] = stability.coupling_n_per_m
        if self._spec.damping_n_s_per_m is None or self._spec.coupling_n_per_m is None:
            self._stability = stability

    def order(self, memory: Memory, *, seek_s: float | None = None, **changes: Any) -> Orders:
        """Change some fields of `Orders` and send them; a seek starts a new generation."""
        if seek_s is not None:
            changes |= {"generation": self.orders.generation + 1, "start_s": self.media_time_s(seek_s)}
        self.orders = orders = replace(self.orders, **changes)
        order = orders.generation, orders.start_s, float(orders.speed), orders.mode, int(orders.is_stopping)
        native.give_order(memory.bytes, *order)
        return orders

    def feeder(
        self, memory: Memory, reserve: Callable[[int], None] | None = None, is_timed: bool = True
    ) -> Feeder:
        """Return the feeder of this block, not yet started."""
        first_frame, on_stiffness = self.frame_at(self.orders.start_s), partial(self._adapt, memory)
        return Feeder(
            self.source,
            memory,
            self.layout,
            first_frame,
            self.is_loop,
            reserve,
            is_timed,
            on_stiffness=on_stiffness,
        )


def is_over(memory: Memory) -> bool:
    """Return True if no frame is left to render and the force is zero.

    This is the case if the medium has ended, or its feed has failed and all frames that it wrote were shown.
    """
    clock, orders = memory.receiver["clock"], memory.receiver["orders"]
    if clock["sequence_seen"] != orders["sequence"]:  # the servo writes it last, after the rest of the order
        return False
    feed = int(clock["feed"])
    is_starved = feed in (layout.STALLED, layout.WAITING) or clock["mode"] != layout.PLAYING
    is_finished = feed == layout.ENDED or (orders["has_feed_failed"] and is_starved)
    return bool(is_finished and clock["is_resting"])
