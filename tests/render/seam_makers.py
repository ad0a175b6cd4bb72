"""For tests and benchmark of seams: a session in simulated time, and a hand on a spring."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from receiver_values import value_of

from touchfield.compute.native import native
from touchfield.devices import device
from touchfield.medium import HapticMedium, HapticScene
from touchfield.render.block import Memory, layout
from touchfield.render.player import Session
from touchfield.render.spec import RenderSpec

HAND_KG, SPRING_N_PER_M, DAMPING_N_S_PER_M, PARTS = 0.2, 200.0, 2.0, 10
Vector = NDArray[np.float64]
Events = Mapping[int, "float | Callable[[Played], None]"]
"""By tick: a media time to seek to, or what else happens."""


class Played:
    """A session that plays from its first tick; frames of a seek come `late` ticks after it."""

    def __init__(self, medium: HapticMedium | HapticScene, late: int = 0, **options: Any) -> None:
        spec = options.pop("spec", RenderSpec(render="field"))
        profile = options.pop(
            "device", replace(device("phantom-omni"), force_continuous_n=None, torque_max_nm=0.2)
        )
        profile = replace(profile, axes=medium.axes)
        self.session = Session(medium, profile, spec, **options)
        self.memory = Memory.empty(self.session.layout.size_bytes)
        self.session.set_up(self.memory, mode=layout.PLAYING)
        self.feeder = self.session.feeder(self.memory, is_timed=False)
        self.ticks, self.late, self.fed_from = 0, late, 0

    def seek(self, time_s: float, **changes: Any) -> None:
        """Go to a media time."""
        orders = self.session.order(self.memory, seek_s=time_s, **changes)
        self.feeder.seek(orders.generation, self.session.frame_at(orders.start_s))
        self.fed_from = self.ticks + self.late

    def tick(self, hand_m: Vector) -> Vector:
        """The force on a hand, newtons."""
        if self.ticks >= self.fed_from:
            self.feeder.fill_lookahead(4)
        force = native.cycle(self.memory.bytes, *map(float, hand_m), self.ticks * 1_000_000)
        self.ticks += 1
        return np.array(force)

    def value(self, path: str) -> Any:
        """A copy of a value of the receiver, such as "state.friction_n"."""
        return value_of(self.memory, path)

    def pause(self) -> None:
        """Stop the media clock."""
        self.session.order(self.memory, mode=layout.PAUSED)

    def play(self) -> None:
        """Let the media clock run."""
        self.session.order(self.memory, mode=layout.PLAYING)

    def hold_back_frames(self, ticks: int) -> None:
        """Decode no frame for so long; some 4 are decoded already."""
        self.fed_from = self.ticks + ticks

    def happen(self, event: float | Callable[[Played], None] | None) -> None:
        """Let an event happen."""
        if callable(event):
            event(self)
        elif event is not None:
            self.seek(event)

    def at_rest(self, hand_m: Vector, ticks: int, events: Events | None = None) -> Vector:
        """Forces on a hand that does not move, float64 [ticks, 3]."""
        rows = []
        for n in range(ticks):
            self.happen((events or {}).get(n))
            rows.append(self.tick(hand_m))
        return np.array(rows)

    def on_spring(
        self, hand_m: Vector, goal_m: Vector, ticks: int, events: Events | None = None
    ) -> tuple[Vector, Vector]:
        """Forces on a hand that a spring pulls to a point, or to one a tick, and its positions, each float64
        [ticks, 3].
        """
        x, v, forces, positions = np.array(hand_m, np.float64), np.zeros(3), [], []
        for n, goal in enumerate(np.broadcast_to(goal_m, (ticks, 3))):
            self.happen((events or {}).get(n))
            force = self.tick(x)
            forces.append(force)
            positions.append(x.copy())
            for _ in range(PARTS):
                pull = SPRING_N_PER_M * (goal - x) - DAMPING_N_S_PER_M * v + force
                v = v + pull / HAND_KG * (1e-3 / PARTS)
                x = x + v * (1e-3 / PARTS)
        return np.array(forces), np.array(positions)


def steps_n(forces: Vector) -> Vector:
    """|F| of the change from each tick to the next, newtons, float64 [ticks - 1]."""
    return np.asarray(np.linalg.norm(np.diff(forces, axis=0), axis=1))
