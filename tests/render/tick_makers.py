"""For the tests of one tick: a block with parameters, and frames with a field."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from receiver_values import value_of

from touchfield.compute.native import native
from touchfield.devices import Device, device
from touchfield.medium import ForceField, Grid
from touchfield.medium.cells import CellPool
from touchfield.medium.deformation import Deformation
from touchfield.medium.medium import VibrationFrame
from touchfield.render.block import Memory, layout
from touchfield.render.block.frames import (
    FramePart,
    deformation_bytes,
    field_bytes,
    frame_bytes,
    write_deformation,
    write_field,
    write_frame,
)
from touchfield.render.spec import RenderSpec, write_parameters

OMNI = replace(device("phantom-omni"), force_max_n=4.0, force_continuous_n=1.0, delay_ms=0.0)
GRID = Grid((33, 33, 33), (0.005,) * 3, (-0.08,) * 3)

Vector = NDArray[np.float64]
Law = Callable[[Vector], Vector]


def points(grid: Grid = GRID) -> Vector:
    """The samples of a lattice, metres, float64 [nx, ny, nz, 3]."""
    return grid.to_m(np.moveaxis(np.indices(grid.shape), 0, -1))


def wall(stiffness_n_per_m: float, most_n: float = np.inf) -> Law:
    """Below z = 0 the force points up; linear, up to a limit."""

    def law(p: Vector) -> Vector:
        force = np.zeros_like(p)
        force[..., 2] = np.clip(-stiffness_n_per_m * p[..., 2], 0.0, most_n)
        return force

    return law


def linear(matrix: Vector) -> Law:
    """F = M p: reproduced exactly by trilinear interpolation, up to float32."""
    return lambda p: p @ np.asarray(matrix).T


def constant(*force_n: float) -> Law:
    """The same everywhere."""
    return lambda p: np.broadcast_to(np.asarray(force_n, np.float64), p.shape)


@dataclass
class Bench:
    """A block with one field in one frame, and the ticks on it."""

    law: Law
    spec: RenderSpec = field(default_factory=RenderSpec)
    device: Device = OMNI
    friction: float = 0.0
    damping: float = 0.0
    axes: str = "x right, y up, z towards the user"
    vibration: tuple[float, float] = (0.0, 0.0)
    grid: Grid = GRID
    deformation: Deformation | None = None

    def __post_init__(self) -> None:
        pools = [
            CellPool.of(ForceField.from_dense(self.grid, self.law(points(self.grid)).astype(np.float32)))
        ]
        if self.vibration[0]:
            every = np.stack(np.meshgrid(*[np.arange(n) for n in self.grid.shape], indexing="ij"), axis=-1)
            amplitudes, frequencies = (np.full(every[..., 0].size, v, np.float32) for v in self.vibration)
            band = VibrationFrame(self.grid, every.reshape(-1, 3).astype(np.int32), amplitudes, frequencies)
            pools.append(CellPool.of(band.as_field()))
        at = [layout.RECEIVER.itemsize]
        for pool in pools:
            at.append(at[-1] + field_bytes(pool))
        self.frame = at[-1]
        bend = 0 if self.deformation is None else deformation_bytes(self.deformation)
        self.yields = self.frame + frame_bytes(1) + bend
        self.memory = Memory.empty(self.yields + bend)
        for place, pool in zip(at, pools, strict=False):
            write_field(self.memory, place, pool)
        vibration_at = at[1] if len(pools) > 1 else 0
        write_frame(self.memory, self.frame, [FramePart.voxels(at[0])], np.inf, vibration_at)
        if self.deformation is not None:
            write_deformation(self.memory, self.frame, frame_bytes(1), self.deformation, 0, self.yields)
        self.restart(self.spec)

    def restart(self, spec: RenderSpec) -> tuple[str, ...]:
        """Set other parameters and reset the state."""
        self.spec, self.dt = spec, 1 / spec.rate_hz
        self.memory.bytes[self.yields :] = 0
        return write_parameters(self.memory, spec, self.device, self.friction, self.damping, self.axes)

    def tick(self, x: float, y: float, z: float, dt: float | None = None, is_there: bool = True) -> Vector:
        """One force, newtons."""
        frame, step = self.frame if is_there else 0, self.dt if dt is None else dt
        return np.array(native.tick(self.memory.bytes, frame, frame, 0.0, x, y, z, step))

    def release(self, dt: float | None = None) -> Vector:
        """One force on the way to zero, newtons."""
        return np.array(native.release(self.memory.bytes, self.dt if dt is None else dt))

    def settled(self, x: float, y: float, z: float, ticks: int = 60) -> Vector:
        """The force at the position of a resting hand."""
        for _ in range(ticks):
            force = self.tick(x, y, z)
        return force

    def value(self, path: str) -> Any:
        """A copy of a value of the receiver, such as "state.force.output"."""
        return value_of(self.memory, path)

    def along(self, path: Vector) -> Iterator[tuple[Vector, Vector]]:
        """A path, metres, float64 [n, 3]: each position, and the force that is put out there."""
        for place in path:
            yield place, self.tick(*place)


def limits(bench: Bench) -> tuple[float, float]:
    """Peak, newtons, and slew, newtons a second."""
    return bench.value("settings.force_limits.peak"), bench.value("settings.force_limits.slew_per_s")
