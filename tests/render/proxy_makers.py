"""For tests and benchmark of the proxy: a hand of 0.1 kg on a field, and walls to press it into."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from receiver_values import value_of

from touchfield.compute.native import native
from touchfield.devices import device
from touchfield.medium import ForceField
from touchfield.medium.cells import CellPool
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.block import Memory, layout
from touchfield.render.block.frames import FramePart, field_bytes, frame_bytes, write_field, write_frame
from touchfield.render.spec import RenderSpec, wall_of, write_parameters
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Shape

STRONG = replace(device("phantom-omni"), force_max_n=30.0, force_continuous_n=None)
DT_S, PARTS = 1e-3, 4
Vector = NDArray[np.float64]


def field_of(*shapes: Shape, nw: int = 7, mapping: str = "1") -> ForceField:
    """The field of shapes for the device, in metres of the hand."""
    return prepare(AnalyticScene(shapes), EncodeSpec(nw=nw, mapping=mapping)).medium[0]


class Held:
    """A field, rendered by the proxy or directly.

    Poses, if any, place the field as a body, (w, x, y, z) and metres a frame; `at` interpolates between them.
    """

    def __init__(
        self,
        field: ForceField,
        is_proxy: bool = True,
        mu: float = 0.0,
        damping: float = 0.0,
        poses: Sequence[tuple[Sequence[float], Sequence[float]]] = (),
        stiffness: float | None = None,
    ) -> None:
        self.field, pool = field, CellPool.of(field)
        start = layout.RECEIVER.itemsize
        first = start + field_bytes(pool)
        self.frames = [first + n * frame_bytes(1) for n in range(max(1, len(poses)))]
        self.memory = Memory.empty(self.frames[-1] + frame_bytes(1))
        write_field(self.memory, start, pool)
        for n, frame in enumerate(self.frames):
            write_frame(
                self.memory,
                frame,
                [FramePart(start, *poses[n]) if poses else FramePart.voxels(start)],
                np.inf,
                0,
            )
        spec = RenderSpec(slew_n_per_s=1e9, ramp_s=DT_S, render="field")
        write_parameters(self.memory, spec, STRONG, mu, damping, STRONG.axes)
        wall, settings = wall_of(field), self.memory.receiver["settings"]
        assert wall is not None
        self.wall = wall if stiffness is None else replace(wall, stiffness_n_per_m=stiffness)
        if is_proxy:
            settings["wall_force_n"] = self.wall.large_n
            settings["wall_n_per_m"], settings["wall_level_n"] = (
                self.wall.stiffness_n_per_m,
                self.wall.level_n,
            )
            spacing = (min(wall.spacing_m),) * 3 if poses else wall.spacing_m
            settings["wall_spacing_m"] = spacing
        self.at = 0.0

    def tick(self, hand: Vector) -> Vector:
        """The force on a hand, newtons; `at` selects the poses to interpolate."""
        n = min(int(self.at), len(self.frames) - 1)
        following, blend = self.frames[min(n + 1, len(self.frames) - 1)], float(self.at - n)
        return np.array(native.tick(self.memory.bytes, self.frames[n], following, blend, *hand, DT_S))

    def value(self, path: str) -> Any:
        """A copy of a value of the receiver, such as "state.friction_n"."""
        return value_of(self.memory, path)

    @property
    def proxy_m(self) -> Vector:
        """Position of the proxy."""
        return np.asarray(self.value("state.proxy.position_m"))

    def pushed(
        self,
        start_m: Sequence[float],
        push_n: Callable[[float, Vector], Vector],
        seconds: float,
        damping: float = 5.0,
    ) -> tuple[Vector, Vector, Vector]:
        """Positions of a pushed free hand of 0.1 kg, forces on it and positions of the proxy, a row
        a tick.
        """
        x, v, rows = np.array(start_m, np.float64), np.zeros(3), []
        for n in range(round(seconds / DT_S)):
            force = self.tick(x)
            rows.append((x.copy(), force, self.proxy_m))
            for _ in range(PARTS):
                v = v + (push_n(n * DT_S, x) + force - damping * v) / 0.1 * (DT_S / PARTS)
                x = x + v * (DT_S / PARTS)
        hand, forces, proxy = (np.array(column) for column in zip(*rows, strict=True))
        return hand, forces, proxy


def ramp_n(
    direction: Sequence[float], newtons: float = 3.0, rise_s: float = 0.3, guided_n_per_m: float = 0.0
) -> Callable[[float, Vector], Vector]:
    """A push along a direction that rises to `newtons`, optionally guided along its line by a spring."""
    unit = np.array(direction, np.float64) / np.linalg.norm(direction)
    line: list[Vector] = []

    def push_n(t: float, x: Vector) -> Vector:
        if not line:
            line.append(x.copy())
        off = x - line[0]
        return newtons * min(1.0, t / rise_s) * unit - guided_n_per_m * (off - (off @ unit) * unit)

    return push_n
