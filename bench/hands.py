"""Many simulated hands on one medium: they share the frames that the feeder writes, each with a state of its
own.

A frame takes milliseconds to write and a tick about a microsecond, so that 200 hands take little longer than
one. After some ticks of one hand, clock and state are put back to those of the next one. All hands are at the
same tick when frames are written, seeks are ordered, and frames are freed.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from touchfield.compute.native import native
from touchfield.medium import HapticMedium, HapticScene
from touchfield.render.block import layout

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "render"))
from seam_makers import DAMPING_N_S_PER_M, HAND_KG, PARTS, SPRING_N_PER_M, Played

CHUNK, CUT_AFTER_SEEK = 8, 4
TICK_NS = 1_000_000
ROW_COLUMNS = ("position_m", "field_force_n", "friction_n", "force_n")


class Spring(NamedTuple):
    """A hand on a spring: its mass, and the spring and the damper that hold it."""

    kg: float = HAND_KG
    n_per_m: float = SPRING_N_PER_M
    n_s_per_m: float = DAMPING_N_S_PER_M

    def step(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Return the rows of position and velocity after a tick, from position, velocity and push.

        The push is the force on the hand and the spring's on its goal, constant in a tick of `PARTS` steps.
        """
        dt_s = 1e-3 / PARTS
        velocity = np.array([0.0, 1.0, 0.0]) + dt_s / self.kg * np.array(
            [-self.n_per_m, -self.n_s_per_m, 1.0]
        )
        part = np.array([np.array([1.0, 0.0, 0.0]) + dt_s * velocity, velocity, [0.0, 0.0, 1.0]])
        rows = np.linalg.matrix_power(part, PARTS)[:2].tolist()
        return tuple(rows[0]), tuple(rows[1])


class Runs(NamedTuple):
    """What hands felt, each float64 [hands, ticks, 3], metres and newtons.

    `field_n` is the force that presses on the surface and `friction_n` lies along it, both in the axes of the
    field; `force_n` is that of the device. `proxy_m` is the position of the proxy, if it was requested.
    """

    position_m: Any
    field_n: Any
    friction_n: Any
    force_n: Any
    proxy_m: Any = None

    @property
    def steps_n(self) -> Any:
        """|F| of the change of the force from each tick to the next, newtons, float64 [hands, ticks - 1]."""
        return np.linalg.norm(np.diff(self.force_n, axis=1), axis=2)


class Hands:
    """Hands on one medium, which start together; `options` are those of `Played`.

    With `has_proxy`, the positions of the proxy are recorded.
    """

    def __init__(
        self, medium: HapticMedium | HapticScene, late: int = 0, *, has_proxy: bool = False, **options: Any
    ) -> None:
        self.played = Played(medium, late, **options)
        self.memory, self.late, self.ticks = self.played.memory, late, 0
        self._states: list[Any] = []
        self._moves: list[list[float]] = []
        fields = layout.RECEIVER.fields
        assert fields is not None and layout.COUNTS.fields is not None
        stop = fields["counts"][1] + layout.COUNTS.fields["periods"][1]
        self._own = self.memory.bytes[fields["clock"][1] : stop]  # clock, grip, state and counts
        self._initial = self._own.copy()
        self._proxy_m = self.memory.receiver["state"]["proxy"]["position_m"] if has_proxy else None
        self._log = self.memory.array(
            layout.LOG_ROW, self.played.session.layout.log, self.played.session.layout.log_rows
        )

    def restart(self) -> None:
        """Let other hands start, on a medium of one frame, which stays written."""
        self._states, self._moves, self.ticks = [], [], 0
        self._own[:] = self._initial

    def run(
        self,
        goals_m: Any,
        ticks: int,
        spring: Spring | None = None,
        starts_m: Any = None,
        seeks: Mapping[int, float] | None = None,
        on_chunk: Callable[[int], None] = lambda tick: None,
    ) -> Runs:
        """Move hands through their goals, float64 [hands, ticks or 1, 3], or by springs whose ends are there.

        A later call goes on from the last tick, with as many hands. Those on springs start at `starts_m`,
        float64 [hands, 3], or at their first goals. `seeks` are media
        times by tick. ``on_chunk(tick)`` is called before the frames of the next ticks are written.
        """
        count = len(goals_m)
        goals_m = np.broadcast_to(np.asarray(goals_m, np.float64), (count, ticks, 3))
        starts_m = goals_m[:, 0] if starts_m is None else starts_m
        if not self._states:
            self._states = [self._own.copy() for _ in range(count)]
            self._moves = [[*start, 0.0, 0.0, 0.0] for start in np.asarray(starts_m, np.float64).tolist()]
        own, moves, first = self._states, self._moves, self.ticks
        found = Runs(*(np.empty((count, ticks, 3)) for _ in ROW_COLUMNS))
        if self._proxy_m is not None:
            found = found._replace(proxy_m=np.empty((count, ticks, 3)))
        seeks, steps = dict(seeks or {}), None if spring is None else (*spring.step(), spring.n_per_m)
        for tick, stop in self._chunks(ticks, seeks):
            if tick in seeks:
                self.played.seek(seeks[tick])
                self.played.fed_from = first + tick + self.late
            on_chunk(first + tick)
            self._feed(first + tick)
            for hand in range(count):
                proxy_m = None if found.proxy_m is None else found.proxy_m[hand, tick:stop]
                self._own[:] = own[hand]
                goals = goals_m[hand, tick:stop].tolist()
                if steps is None:
                    self._script(first + tick, goals, proxy_m)
                else:
                    self._swing(first + tick, goals, moves[hand], *steps, proxy_m)
                own[hand] = self._own.copy()
                written = int(self.memory.receiver["clock"]["log_written"])
                rows = self._log[np.arange(written - (stop - tick), written) % len(self._log)]
                for name, column in zip(ROW_COLUMNS, found):
                    column[hand, tick:stop] = rows[name]
        self.ticks += ticks
        return found

    def _chunks(self, ticks: int, seeks: Mapping[int, float]) -> list[tuple[int, int]]:
        """Return the ranges of ticks without a seek, and without frames that come after one, within them."""
        cuts = {*range(0, ticks, CHUNK), ticks}
        for tick in seeks:
            cuts |= set(range(tick, tick + self.late + CUT_AFTER_SEEK + 1))
        ordered = sorted(cut for cut in cuts if cut <= ticks)
        return list(zip(ordered[:-1], ordered[1:]))

    def _feed(self, tick: int) -> None:
        """Write the frames of the next ticks, as `Played.tick` does."""
        if tick >= self.played.fed_from:
            self.played.feeder.fill_lookahead(4)

    def _script(self, tick: int, goals: list[list[float]], proxy_m: Any) -> None:
        """Tick one hand along its goals."""
        cycle, memory = native.cycle, self.memory.bytes
        for n, (x, y, z) in enumerate(goals, tick):
            cycle(memory, x, y, z, n * TICK_NS)
            if proxy_m is not None:
                proxy_m[n - tick] = self._proxy_m

    def _swing(
        self,
        tick: int,
        goals: list[list[float]],
        move: list[float],
        place: Any,
        speed: Any,
        k: float,
        proxy_m: Any,
    ) -> None:
        """Tick one hand on a spring; `move` is its position and velocity."""
        cycle, memory = native.cycle, self.memory.bytes
        (xx, xv, xu), (vx, vv, vu) = place, speed
        x, y, z, u, v, w = move
        for n, (goal_x, goal_y, goal_z) in enumerate(goals, tick):
            fx, fy, fz = cycle(memory, x, y, z, n * TICK_NS)
            fx, fy, fz = fx + k * goal_x, fy + k * goal_y, fz + k * goal_z
            x, u = xx * x + xv * u + xu * fx, vx * x + vv * u + vu * fx
            y, v = xx * y + xv * v + xu * fy, vx * y + vv * v + vu * fy
            z, w = xx * z + xv * w + xu * fz, vx * z + vv * w + vu * fz
            if proxy_m is not None:
                proxy_m[n - tick] = self._proxy_m
        move[:] = x, y, z, u, v, w
