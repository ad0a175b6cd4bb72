"""A run without a process: the same cycle as fast as it goes, on a clock that stands still between ticks.

For tests, exports and plots: the same input gives the same forces, and frames are always there in time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from touchfield.errors import InvalidArgument, require_between
from touchfield.render.block import DEFAULT_BYTES, Memory, TickLog, statistics_of
from touchfield.render.block import words as W
from touchfield.render.player import Session, is_over
from touchfield.render.servo import Opener, VirtualClock, serve
from touchfield.render.spec import RenderSpec

if TYPE_CHECKING:
    from touchfield.devices import Device
    from touchfield.medium import HapticMedium, HapticScene


@dataclass(frozen=True)
class OfflineRun:
    """Outcome of a run: a row of `block.COLUMNS` for each tick, statistics as of `Player.statistics` with
    times of the virtual clock, notes for the user, and the error of the medium, where it was to be kept.
    """

    log: NDArray[Any]
    statistics: dict[str, Any]
    notes: tuple[str, ...]
    error: Exception | None = None


def run_offline(
    medium: HapticMedium | HapticScene,
    device_profile: Device,
    opener: Opener,
    spec: RenderSpec | None = None,
    *,
    seconds: float | None = None,
    loop: bool = False,
    speed: float = 1.0,
    start_s: float = 0.0,
    memory_bytes: int = DEFAULT_BYTES,
    keeps_error: bool = False,
) -> OfflineRun:
    """Play a medium to a device in this process, as fast as it goes; other arguments as of `Player`.

    The device must not have a rhythm of its own. `seconds` are of the device; None plays to the end of the
    medium, which must have one. With `keeps_error` an error of the medium, as a corrupt segment, is kept
    beside what was felt before it, and else raised once the force is zero. `InvalidArgument` if a number is
    out of range, a frame does not fit, or the run has no end; `DeviceError` of the device.
    """
    spec = RenderSpec() if spec is None else spec
    session = Session(medium, device_profile, spec, memory_bytes, loop, speed, start_s)
    if seconds is None and (loop or session.source.frame_count == 1):
        raise InvalidArgument("seconds", "none for a medium without end", "how long to play it")
    if seconds is not None:
        require_between(0, 1e6, seconds=seconds)
    device = opener()
    if device.is_paced or device.is_driven:
        raise InvalidArgument("device", "one with a rhythm of its own", "a simulated one")
    memory = Memory.empty(session.layout.words)
    session.set_up(memory, mode=W.PLAYING)
    feeder = session.feeder(memory, is_timed=False)
    most = None if seconds is None else round(seconds * spec.rate_hz)
    log = TickLog(memory, 1 << 62)
    i8, drain_every = memory.i8, session.layout.log_rows // 2
    ahead = 2 + int(speed * session.source.rate_hz / spec.rate_hz + 1)

    def before_tick() -> bool:
        ticks = int(i8[W.TICKS])
        if ticks % drain_every == 0:
            log.drain()
        feeder.keep_ahead(ahead)
        if most is not None and not feeder.error:
            return ticks >= most
        return is_over(memory)

    serve(memory, device, VirtualClock(), before_tick)
    log.drain()
    if feeder.error is not None and not keeps_error:
        raise feeder.error
    return OfflineRun(log.rows(), statistics_of(memory), session.notes, feeder.error)
