"""`TickedPlayer`: plays a medium by ticks of the caller's loop, such as the timer of a robot's program.

    with TickedPlayer(medium, profile, spec) as player:
        player.play()
        while is_running:
            send(player.tick(position_m()))
        player.stop()
        while not player.is_released:
            send(player.tick(position_m()))

It is `Player` without the servo's process: the same memory, orders and tick (``c/touch_render.h``), in this
process. A thread decodes ahead.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from touchfield.compute.native import native
from touchfield.render.block import DEFAULT_BYTES, Memory, layout
from touchfield.render.player import Session, is_over
from touchfield.render.point_device import NOWHERE
from touchfield.render.readings import position_reading
from touchfield.render.spec import RenderSpec

if TYPE_CHECKING:
    from touchfield.devices import Device
    from touchfield.medium import HapticMedium, HapticScene

Vector = tuple[float, float, float]


class TickedPlayer:
    """Plays a medium by ticks of the caller.

    One thread calls `tick`, and one gives the orders `play`, `pause`, `seek` and `stop`; both may be the
    same. Leaving the context ends the decoding; it cannot bring the force to zero (`stop` does).

    Parameters
    ----------
    medium : HapticMedium or HapticScene
    device_profile : Device
        Of type 1. Positions and forces are in its axes.
    spec : RenderSpec, optional
        ``rate_hz`` is the rate at which `tick` is called.
    memory_bytes, loop, speed, start_s
        As in `Player`; `InvalidArgument` if a number is out of range.
    is_simulated : bool
        True: each tick decodes the frames that it needs, so that the same positions and times give the same
        forces. False: a thread decodes ahead, and a late frame gives no force.
    """

    def __init__(
        self,
        medium: HapticMedium | HapticScene,
        device_profile: Device,
        spec: RenderSpec | None = None,
        memory_bytes: int = DEFAULT_BYTES,
        loop: bool = False,
        speed: float = 1.0,
        start_s: float = 0.0,
        *,
        is_simulated: bool = False,
    ) -> None:
        spec = RenderSpec() if spec is None else spec
        self._session = Session(medium, device_profile, spec, memory_bytes, loop, speed, start_s)
        self._memory = Memory.empty(self._session.layout.size_bytes)
        self._session.set_up(self._memory)
        self._feeder = self._session.feeder(self._memory, is_timed=not is_simulated)
        self._is_simulated = is_simulated
        self._lookahead = 2 + int(speed * self._session.source.rate_hz / spec.rate_hz + 1)

    def __enter__(self) -> TickedPlayer:
        """Decode the first frames; raise the error if that fails."""
        self._feeder.fill_lookahead(self._lookahead)
        if self._feeder.error is not None:
            raise self._feeder.error
        if not self._is_simulated:
            self._feeder.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def tick(self, position_m: Vector | None, now_ns: int | None = None) -> Vector:
        """Return the force on a hand, newtons.

        `position_m` is in metres; DeviceError if it is not three numbers. Without one, and for one that is
        not finite, the force goes to zero within the ramp. `now_ns` is the time of a clock that does not go
        back; by default, the monotonic clock's.
        """
        if self._is_simulated:
            self._feeder.fill_lookahead(self._lookahead)
        now_ns = time.perf_counter_ns() if now_ns is None else now_ns
        point_m = NOWHERE if position_m is None else position_reading(position_m)
        return native.cycle(self._memory.bytes, *point_m, now_ns)

    def play(self) -> None:
        """Start the media clock."""
        self._session.order(self._memory, mode=layout.PLAYING)

    def pause(self) -> None:
        """Stop the media clock; the field stays as it is."""
        self._session.order(self._memory, mode=layout.PAUSED)

    def seek(self, time_s: float) -> None:
        """Go to a media time, playing or not; the force fades, to zero if the frames take 0.1 s or more.

        Raises `InvalidArgument` if the time is negative or not finite.
        """
        orders = self._session.order(self._memory, seek_s=self._session.media_time_s(time_s))
        self._feeder.seek(orders.generation, self._session.frame_at(orders.start_s))

    def stop(self) -> None:
        """Let the next ticks bring the force to zero for ever (`is_released`)."""
        self._session.order(self._memory, is_stopping=True)

    def close(self) -> None:
        """End the decoding. May be called twice."""
        self._feeder.close()

    @property
    def is_released(self) -> bool:
        """True if a stop has brought the force to zero."""
        return bool(self._memory.receiver["clock"]["is_released"])

    @property
    def is_ended(self) -> bool:
        """True if the medium has ended, or its feed has failed, and the force is zero."""
        return is_over(self._memory)

    @property
    def media_s(self) -> float:
        """Media time at the latest tick, seconds."""
        return float(self._memory.receiver["clock"]["media_s"])

    @property
    def force_max_n(self) -> float:
        """Limit of the force, newtons."""
        return float(self._memory.receiver["settings"]["force_limits"]["peak"])

    @property
    def error(self) -> Exception | None:
        """The error that ended the feed of frames, or None."""
        return self._feeder.error

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user, on limits, damping, coupling and walls."""
        return self._session.notes
