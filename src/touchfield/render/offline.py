"""Plays a medium without a real-time process: the same code computes the forces, on a virtual clock, as fast
as possible.

It serves tests, exports and plots. The same input gives the same forces, and frames are always ready in time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from touchfield.errors import InvalidArgument, require_between
from touchfield.render.block import DEFAULT_BYTES, Memory, TickLog, layout, statistics_of
from touchfield.render.player import Session, is_over
from touchfield.render.servo import Opener, VirtualClock, serve
from touchfield.render.spec import RenderSpec

if TYPE_CHECKING:
    from touchfield.devices import Device
    from touchfield.medium import HapticMedium, HapticScene


@dataclass(frozen=True)
class OfflineRun:
    """Result of an offline run.

    `log` has a row of `block.COLUMNS` for each tick, `statistics` is that of `Player.statistics` in times of
    the virtual clock, `notes` are for the user, and `error` is that of the medium if it was to be returned.
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
    """Play a medium to a device in this process, as fast as possible.

    The other arguments are those of `Player`. The device must not set its own rate. `seconds` are those of
    the device; None plays to the end of the medium, which must have one. With `keeps_error`, an error of the
    medium such as a corrupt segment is returned together with the forces before it; otherwise it is raised
    once the force is zero. Raises `InvalidArgument` if a number is out of range, a frame does not fit, or the
    run has no end; `DeviceError` if the device fails.
    """
    spec = RenderSpec() if spec is None else spec
    session = Session(medium, device_profile, spec, memory_bytes, loop, speed, start_s)
    if seconds is None and (loop or session.source.frame_count == 1):
        raise InvalidArgument("seconds", "none for a medium without an end", "the seconds to play")
    if seconds is not None:
        require_between(0, 1e6, seconds=seconds)
    device = opener()
    if device.is_paced or device.is_driven:
        raise InvalidArgument("device", "one that sets its own rate", "a simulated one")
    memory = Memory.empty(session.layout.size_bytes)
    session.set_up(memory, mode=layout.PLAYING)
    feeder = session.feeder(memory, is_timed=False)
    max_ticks = None if seconds is None else round(seconds * spec.rate_hz)
    log = TickLog(memory, 1 << 62)
    counts, drain_every = memory.receiver["counts"], session.layout.log_rows // 2
    lookahead = 2 + int(speed * session.source.rate_hz / spec.rate_hz + 1)

    def before_tick() -> bool:
        ticks = int(counts["ticks"])
        if ticks % drain_every == 0:
            log.drain()
        feeder.fill_lookahead(lookahead)
        if max_ticks is not None and not feeder.error:
            return ticks >= max_ticks
        return is_over(memory)

    serve(memory, device, VirtualClock(), before_tick)
    log.drain()
    if feeder.error is not None and not keeps_error:
        raise feeder.error
    return OfflineRun(log.rows(), statistics_of(memory), session.notes, feeder.error)
