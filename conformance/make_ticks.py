"""Writes `ticks/NAME.ticks`: trajectories of a hand, and the forces of the receiver on it.

    python conformance/make_ticks.py [NAME ...]

A file is little-endian: the bytes `TICKS002`, then int64: bytes of the receiver's memory, bytes of its first
struct, `touch_receiver`, the CRC-32 of its layout, pieces, ticks, and numbers of a tick. A reader refuses a
file of another layout, whose offsets would be others. Then the pieces of the memory that are not zero, each
an offset and a size, int64, and its bytes. Then the ticks, float64: offset of the frame before and of the one
after, blend, position (3, m), dt (s), whether it is a release (1) or a tick (0), and the force (3, N). With a
tool, the orientation of the grip (4) and the torque (3, N m) follow.
"""

from __future__ import annotations

import struct
import sys
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.compute.native import native
from touchfield.devices import device
from touchfield.medium import ForceField, Grid
from touchfield.medium.cells import CellPool
from touchfield.medium.deformation import Deformation
from touchfield.medium.medium import VibrationFrame
from touchfield.render.block import Memory, aligned, layout
from touchfield.render.block.frames import (
    FramePart,
    deformation_bytes,
    field_bytes,
    frame_bytes,
    write_deformation,
    write_field,
    write_frame,
)
from touchfield.render.material import Material, material_bytes, write_materials
from touchfield.render.spec import RenderSpec, write_parameters
from touchfield.render.tool import Tool, tool_bytes, write_tool

FOLDER: Final = Path(__file__).resolve().parent / "ticks"
MAGIC: Final = b"TICKS002"
TICKS: Final = 150
MIN_ZERO_BYTES: Final = 64  # a shorter run of zeros is written as it is
DT_S: Final = 1e-3

GRID: Final = Grid((5, 5, 5), (0.006,) * 3, (-0.012, -0.012, -0.018))
AXES: Final = "x right, y up, z towards the user"
OMNI: Final = device("phantom-omni")


def layout_crc() -> int:
    """CRC-32 of the names and offsets of the receiver's fields."""
    return zlib.crc32(repr(native.receiver_layout()).encode())


def field_of(law: Callable[[Any], Any], grid: Grid = GRID) -> ForceField:
    """The field of a law of force, from points [..., 3] to newtons."""
    points_m = grid.to_m(np.moveaxis(np.indices(grid.shape), 0, -1))
    return ForceField.from_dense(grid, law(points_m).astype("f4"))


def wall(stiffness_n_per_m: float, surface_m: float = 0.0) -> Callable[[Any], Any]:
    """Below a height the force points up, and a little aside."""

    def law(p: Any) -> Any:
        up = np.maximum(stiffness_n_per_m * (surface_m - p[..., 2]), 0.0)
        return np.stack([0.1 * up * np.sin(200 * p[..., 1]), 0.05 * up, up], axis=-1)

    return law


class Receiver:
    """The memory of a receiver, filled from front to back."""

    def __init__(self, spec: RenderSpec | None = None, friction: float = 0.0, damping: float = 0.0) -> None:
        self.memory, self.top = Memory.empty(1 << 20), aligned(layout.RECEIVER.itemsize)
        write_parameters(self.memory, spec or RenderSpec(), OMNI, friction, damping, AXES)
        self.settings = self.memory.receiver["settings"]

    def take(self, size_bytes: int) -> int:
        """The offset of so many bytes."""
        offset = self.top
        self.top += aligned(size_bytes)
        return offset

    def field(self, field: ForceField) -> int:
        """Write a field; its offset."""
        pool = CellPool.of(field)
        offset = self.take(field_bytes(pool))
        write_field(self.memory, offset, pool)
        return offset

    def frame(
        self,
        parts: Sequence[FramePart],
        force_max_n: float = np.inf,
        vibration: int = 0,
        deformation: Deformation | None = None,
        number: int = 0,
    ) -> int:
        """Write a frame, and its deformation; its offset."""
        size = frame_bytes(len(parts))
        offset = self.take(size + (deformation_bytes(deformation) if deformation else 0))
        write_frame(self.memory, offset, parts, force_max_n, vibration)
        if deformation is not None:
            yields = self.take(deformation.displacement_m[0].nbytes)
            write_deformation(self.memory, offset, size, deformation, number, yields)
        return offset

    def voxels(self, field: ForceField, **options: Any) -> int:
        """Write a field and a frame of it; the offset of the frame."""
        return self.frame([FramePart.voxels(self.field(field))], **options)


@dataclass
class Ticks:
    """A receiver before its first tick, and what it gets: each array has a row for each tick."""

    receiver: Receiver
    frames: Any  # offsets of the frames before and after, [n, 2]
    position_m: Any  # [n, 3]
    blend: Any = 0.0
    dt_s: Any = DT_S
    is_release: Any = 0.0
    orientation: Any = field(default=None)  # [n, 4] for a tool

    def rows(self) -> Any:
        """Rows of a file, with the forces and torques of the receiver."""
        n, memory = len(self.position_m), self.receiver.memory
        receiver, rows = memory.receiver, []
        frames = np.broadcast_to(self.frames, (n, 2))
        one = [
            np.broadcast_to(np.asarray(values, float), n)
            for values in (self.blend, self.dt_s, self.is_release)
        ]
        for k in range(n):
            blend, dt_s, is_release = (float(values[k]) for values in one)
            q = None if self.orientation is None else self.orientation[k]
            if q is not None:
                receiver["grip"]["orientation"][:] = q
            x, y, z = map(float, self.position_m[k])
            if is_release:
                force = native.release(memory.bytes, dt_s)
            else:
                force = native.tick(memory.bytes, *map(int, frames[k]), blend, x, y, z, dt_s)
            row = [*frames[k], blend, x, y, z, dt_s, is_release, *force]
            rows.append(row if q is None else [*row, *q, *receiver["state"]["torque"]["output"].tolist()])
        return np.array(rows, "<f8")

    def write(self, path: Path) -> None:
        """Write the file."""
        content = self.receiver.memory.bytes[: self.receiver.top].tobytes()
        pieces = list(pieces_of(content))
        rows = self.rows()
        with path.open("wb") as out:
            header = len(content), layout.RECEIVER.itemsize, layout_crc(), len(pieces), *rows.shape
            out.write(MAGIC + struct.pack("<6q", *header))
            for offset, piece in pieces:
                out.write(struct.pack("<2q", offset, len(piece)) + piece)
            out.write(rows.tobytes())


def pieces_of(content: bytes) -> list[tuple[int, bytes]]:
    """Offsets and bytes of what is not zero, in steps of 8 bytes."""
    is_set = np.frombuffer(content, "<u8") != 0
    at = np.flatnonzero(is_set)
    if not len(at):
        return []
    breaks = np.flatnonzero(np.diff(at) * 8 > MIN_ZERO_BYTES)
    starts, stops = at[np.r_[0, breaks + 1]] * 8, at[np.r_[breaks, len(at) - 1]] * 8 + 8
    return [(int(a), content[a:b]) for a, b in zip(starts, stops)]


def pressing(depth_m: float = 0.006, ticks: int = TICKS) -> Any:
    """A hand that sinks into a wall, slides and trembles, float64 [ticks, 3]."""
    t = np.arange(ticks) / ticks
    return np.stack(
        [
            0.004 * np.sin(5 * t) + 2e-4 * np.sin(60 * t),
            0.003 * np.cos(4 * t),
            0.003 - (0.003 + depth_m) * np.sin(np.pi * t) ** 0.5,
        ],
        axis=1,
    )


def voxels() -> Ticks:
    receiver = Receiver(friction=0.3, damping=0.4)
    frame = receiver.voxels(field_of(wall(300)))
    return Ticks(receiver, [frame, frame], pressing())


def blended() -> Ticks:
    receiver = Receiver()
    frames = receiver.voxels(field_of(wall(300))), receiver.voxels(field_of(wall(200, 0.004)))
    return Ticks(receiver, frames, pressing(), blend=np.linspace(-0.1, 1.1, TICKS))


def bodies() -> Ticks:
    receiver = Receiver(friction=0.2)
    fields = receiver.field(field_of(wall(300))), receiver.field(field_of(wall(250, 0.004)))
    turned = (np.cos(0.3), np.sin(0.3), 0.0, 0.0), (-np.cos(0.2), 0.0, -np.sin(0.2), 0.0)
    velocity = (0.02, 0.0, 0.01, 0.3, 0.0, 0.2)
    frames = [
        receiver.frame(
            [
                FramePart(fields[0], (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -0.001), velocity),
                FramePart(fields[n], turned[n], (0.002 * n, 0.001, 0.003), velocity),
            ],
            3.0,
        )
        for n in range(2)
    ]
    return Ticks(receiver, frames, pressing(), blend=np.linspace(0, 1, TICKS))


def deformation() -> Ticks:
    receiver = Receiver()
    rng = np.random.default_rng(1)
    tracks = 0.001 * rng.uniform(-1, 1, (2, 5, 5, 5, 3))
    bend = Deformation(tracks, (-0.014, -0.014, -0.018), (0.014,) * 3, 30.0, 0.002, 0.05)
    solid = receiver.field(field_of(wall(300)))
    frames = [receiver.frame([FramePart.voxels(solid)], deformation=bend, number=n) for n in range(2)]
    return Ticks(receiver, frames, pressing(), blend=np.linspace(0, 1, TICKS))


def vibration() -> Ticks:
    receiver = Receiver()
    every = np.stack(np.meshgrid(*[np.arange(n) for n in GRID.shape], indexing="ij"), axis=-1).reshape(-1, 3)
    amplitude = np.linspace(0.1, 0.5, len(every)).astype("f4")
    band = VibrationFrame(GRID, every.astype("i4"), amplitude, np.full(len(every), 120, "f4"))
    frame = receiver.voxels(field_of(wall(300)), vibration=receiver.field(band.as_field()))
    return Ticks(receiver, [frame, frame], pressing())


def material() -> Ticks:
    receiver = Receiver(friction=0.1)
    levels = np.random.default_rng(2).uniform(0, 0.1, (2, 2, 16)).tolist()
    box = ((-1.0, -1.0, -1.0), (0.0, 1.0, 1.0))
    wood = Material("wood", 0.3, 0.6, 0.002, None, box, (0.01, 0.1), (0.5, 2.0), levels)
    offset = receiver.take(material_bytes((wood,)))
    write_materials(receiver.memory, offset, (wood,))
    frame = receiver.voxels(field_of(wall(300)))
    return Ticks(receiver, [frame, frame], pressing())


def tool() -> Ticks:
    receiver = Receiver()
    limits = receiver.settings["torque_limits"]
    limits["peak"], limits["slew_per_s"] = 0.02, 4.0
    receiver.memory.receiver["state"]["torque"]["limit"] = 0.02
    sphere = Tool.sphere(0.005, 60)
    shifted = Tool(sphere.points_m + np.array([0.002, 0.0, 0.0]), sphere.normals, "ball beside the grip")
    write_tool(receiver.memory, receiver.take(tool_bytes(shifted)), shifted)
    frame = receiver.voxels(field_of(wall(300)))
    angle = np.linspace(0, 1.2, TICKS)
    q = np.stack([np.cos(angle / 2), np.zeros(TICKS), np.sin(angle / 2), np.zeros(TICKS)], axis=1)
    q[60:64] = np.nan  # an orientation that is not known
    return Ticks(receiver, [frame, frame], pressing(), orientation=q)


def plate(stiffness_n_per_m: float, thickness_m: float) -> Callable[[Any], Any]:
    """Between two heights the force points to the nearer one, and outside nowhere."""

    def law(p: Any) -> Any:
        below = -p[..., 2]
        force_n = stiffness_n_per_m * np.where(below < thickness_m / 2, below, below - thickness_m)
        force_n[(below < 0) | (below > thickness_m)] = 0.0
        return np.stack([0.1 * force_n, 0.05 * force_n, force_n], axis=-1)

    return law


def proxy() -> Ticks:
    """A hand that is pressed deeper than a plate is thick: the stored force lacks most of the spring's."""
    receiver = Receiver(friction=0.4)
    receiver.settings["wall_n_per_m"], receiver.settings["wall_level_n"] = 300.0, 0.05
    grid = Grid((4, 4, 12), (0.008, 0.008, 0.002), (-0.012, -0.012, -0.017))
    receiver.settings["wall_spacing_m"] = grid.spacing_m
    frame = receiver.voxels(field_of(plate(300, 0.008), grid))
    return Ticks(receiver, [frame, frame], pressing(0.009))


def friction() -> Ticks:
    """A hand that sticks, slides, turns back, and rests, on a body that then turns and takes it along."""
    receiver = Receiver(friction=0.5)
    solid, turn = receiver.field(field_of(wall(300))), np.linspace(0.0, 0.1, 2)
    frames = [
        receiver.frame([FramePart(solid, (np.cos(a / 2), 0.0, 0.0, np.sin(a / 2)), (0.002 * a, 0.0, 0.0))])
        for a in turn
    ]
    t = np.arange(100)
    x = np.interp(t, [0, 15, 40, 55], [-0.006, -0.006, 0.006, 0.003])
    z = np.interp(t, [0, 15], [0.002, -0.004])
    position_m = np.stack([x, 0.5 * x, z], axis=1)
    return Ticks(receiver, frames, position_m, blend=np.interp(t, [80, 100], [0.0, 1.0]))


def coupling() -> Ticks:
    receiver = Receiver(RenderSpec(coupling_n_per_m=400.0), friction=0.2)
    frame = receiver.voxels(field_of(wall(900)))
    return Ticks(receiver, [frame, frame], pressing(0.004))


def passivity() -> Ticks:
    receiver = Receiver(RenderSpec(passivity=True))
    frame = receiver.voxels(field_of(wall(600)))
    position_m = pressing(0.004)
    position_m[:, 2] += 0.0006 * np.sin(0.9 * np.arange(TICKS))
    return Ticks(receiver, [frame, frame], position_m)


def damper() -> Ticks:
    receiver = Receiver()
    receiver.settings["brake_n_s_per_m"] = 2.0
    frame = receiver.voxels(field_of(wall(300)))
    return Ticks(receiver, [frame, frame], pressing())


def limits() -> Ticks:
    """A force above the continuous limit heats until the limit sinks; the slew limit bounds each step."""
    spec = RenderSpec(
        peak_n=2.0, continuous_n=0.6, slew_n_per_s=150.0, thermal_s=0.05, gravity_n=(0.0, 0.1, 0.2)
    )
    receiver = Receiver(spec)
    frame = receiver.voxels(field_of(wall(900)))
    position_m = pressing()
    position_m[100:110] += 0.01
    return Ticks(receiver, [frame, frame], position_m)


def interrupted() -> Ticks:
    """Ramp, a stall, positions that are not finite, jumps, odd time steps, and a stop."""
    receiver = Receiver(friction=0.2)
    frame = receiver.voxels(field_of(wall(300)))
    position_m, frames = pressing(), np.full((TICKS, 2), frame)
    frames[30:55] = 0
    position_m[70:74], position_m[74], position_m[80] = np.nan, [np.inf, 0, 0], [0, 0, -0.5]
    dt_s, is_release = np.full(TICKS, DT_S), np.zeros(TICKS)
    dt_s[85:92] = 0.0, -1.0, 1e-12, 0.02, 3.0, 1e9, np.nan
    is_release[110:] = 1.0
    return Ticks(receiver, frames, position_m, dt_s=dt_s, is_release=is_release)


CASES: Final = {
    case.__name__: case
    for case in (
        *(voxels, blended, bodies, deformation, vibration, material, tool),
        *(proxy, friction, coupling, passivity, damper, limits, interrupted),
    )
}


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    for name in sys.argv[1:] or CASES:
        path = FOLDER / f"{name}.ticks"
        CASES[name]().write(path)
        print(f"{path.name} {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
