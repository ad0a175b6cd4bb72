"""For the tests of the player: a small medium whose force encodes the frame number, and fake devices.

Devices are module-level classes, because the process of the servo instantiates them.
"""

from __future__ import annotations

import os
import time
from dataclasses import replace
from functools import cache

import numpy as np

from touchfield.devices import device
from touchfield.errors import CorruptFile, DeviceError
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.render.block import Memory
from touchfield.render.player import Session
from touchfield.render.point_device import Point, PointDevice
from touchfield.render.spec import RenderSpec

OMNI = replace(device("phantom-omni"), force_max_n=4.0, force_continuous_n=None)
GRID = Grid((6, 6, 6), (0.01,) * 3, (-0.025,) * 3)
AXES = "x right, y up, z towards the user"
RATE_HZ = 50.0


@cache
def numbered_field(frame: int) -> ForceField:
    """A field whose force everywhere is (0, 0, 0.5 + frame / 64) newtons, exact in float32."""
    forces = np.zeros((*GRID.shape, 3), np.float32)
    forces[..., 2] = 0.5 + frame / 64
    return ForceField.from_dense(GRID, forces)


def numbered_medium(
    frames: int = 20, rate_hz: float = RATE_HZ, corrupt_from: int | None = None
) -> HapticMedium:
    """A medium of such fields; reading fails from the frame `corrupt_from` on."""

    def make(frame: int) -> ForceField:
        if corrupt_from is not None and frame >= corrupt_from:
            raise CorruptFile("segment 3", "a wrong checksum")
        return numbered_field(frame)

    return HapticMedium(GRID, rate_hz, frames, make, AXES)


def frame_of(force_n: float) -> float:
    """The frame number encoded by this force."""
    return 64 * (force_n - 0.5)


class RestingDevice(PointDevice):
    """Stays in the middle, within all numbered fields, and records its forces."""

    def __init__(self) -> None:
        self.forces: list[Point] = []
        self.is_open, self.closed = False, 0

    def open(self) -> None:
        self.is_open = True

    def position_m(self) -> Point:
        assert self.is_open and not self.closed
        return 0.0, 0.0, 0.0

    def put_force_n(self, x: float, y: float, z: float) -> None:
        assert self.is_open and not self.closed
        self.forces.append((x, y, z))

    def close(self) -> None:
        self.closed += 1


class Simulated(RestingDevice):
    """The same with simulated time: the number of the tick."""

    def advance(self, dt_s: float) -> None:
        return


class Failing(RestingDevice):
    """Stops answering after some ticks."""

    def position_m(self) -> Point:
        if len(self.forces) >= 100:
            raise DeviceError("fake device", "no answer", "a position", "Plug it in.")
        return super().position_m()


class Hung(RestingDevice):
    """Never answers, and cannot be interrupted."""

    def position_m(self) -> Point:
        while True:
            time.sleep(60)


class Noted(RestingDevice):
    """Writes each opening and force to the file named by the environment; its reads hang after some ticks."""

    def open(self) -> None:
        super().open()
        self._note("open")

    def position_m(self) -> Point:
        if len(self.forces) >= 100:
            time.sleep(3600)
        return super().position_m()

    def put_force_n(self, x: float, y: float, z: float) -> None:
        super().put_force_n(x, y, z)
        if len(self.forces) == 1:
            self._note(f"force {x:g} {y:g} {z:g}")

    def _note(self, line: str) -> None:
        with open(os.environ["NOTED_FORCES"], "a") as file:
            file.write(f"{line}\n")


class Absent(RestingDevice):
    """Cannot be opened."""

    def open(self) -> None:
        raise DeviceError("fake device", "nothing on the bus", "a device", "Plug it in.")


def laid_out(
    medium: HapticMedium, spec: RenderSpec | None = None, **options: object
) -> tuple[Session, Memory]:
    """A session and its block within this process, not yet fed."""
    session = Session(medium, OMNI, RenderSpec() if spec is None else spec, **options)  # type: ignore[arg-type]
    memory = Memory.empty(session.layout.size_bytes)
    session.set_up(memory)
    return session, memory
