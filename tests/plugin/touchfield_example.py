"""One source, one coder, one driver and one filter of another distribution."""

from dataclasses import dataclass

import numpy as np

from touchfield.codec.registry import Coder
from touchfield.codec.segment import BitAccount, CodedSegment, FrameKind, FrameStats
from touchfield.devices.drivers.registry import Check, DeviceKind
from touchfield.filters.registry import Claims, FieldFilter
from touchfield.medium import ForceField
from touchfield.options import option
from touchfield.render.point_device import PointDevice
from touchfield.sources.registry import SourceKind
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Sphere

SOURCE = SourceKind(
    name="ball",
    summary="A ball of a radius in metres (.ball)",
    matches=lambda path: path.suffix == ".ball",
    open=lambda path, options: AnalyticScene([Sphere((0.0, 0.0, 0.0), float(path.read_text()))]),
)


@dataclass(frozen=True)
class RawSpec:
    scale: float = option(1.0, "Newtons of one.")
    k: float = 0.1
    segment_frames: int | None = 4


class RawEncoder:
    name = "raw"

    def __init__(self, grid, spec):
        self.spec, self.parameters = spec, np.float32(spec.scale).tobytes()

    def encode_segment(self, frames):
        body = b"".join((frame.to_dense() / self.spec.scale).astype("<f4").tobytes() for frame in frames)
        counts = [int(frame.support().amplitudes_n.size) for frame in frames]
        stats = (
            FrameStats(FrameKind.INTRA, n, n, BitAccount(amplitude=8 * len(body) // len(frames)))
            for n in counts
        )
        return CodedSegment(body, tuple(stats))


class RawDecoder:
    def __init__(self, grid, parameters, where="HEAD"):
        self.grid, self.scale = grid, np.frombuffer(parameters, "<f4")[0]

    def frames(self, body, frame_count):
        for forces in np.frombuffer(body, "<f4").reshape(frame_count, *self.grid.shape, 3):
            yield ForceField.from_dense(self.grid, forces * self.scale)

    def costs(self, body, frame_count):
        return ()

    def describe(self):
        return {"coder": "raw", "scale": float(self.scale)}


CODER = Coder(
    name="raw",
    encoder="touchfield_example:RawEncoder",
    decoder="touchfield_example:RawDecoder",
    spec=RawSpec,
    makers={"raw": lambda options: RawSpec(**options)},
)


class Still(PointDevice):
    def open(self):
        self.force_n = (0.0, 0.0, 0.0)

    def position_m(self):
        return 0.0, 0.0, 0.0

    def put_force_n(self, x, y, z):
        self.force_n = (x, y, z)

    def close(self):
        self.force_n = (0.0, 0.0, 0.0)


DRIVER = DeviceKind(
    name="still",
    form="still",
    summary="a hand that does not move",
    profile="phantom-omni",
    make=lambda rest, trajectory: Still,
    checks=lambda: [Check("still", True, "built in")],
)


@dataclass(frozen=True)
class Halve(FieldFilter):
    name = "halve"
    summary = "Multiply forces: halve or halve:0.25."
    example = "0.5"
    factor: float = 0.5

    def claims(self, grid):
        return Claims(
            reach=(0, 0, 0), linear=True, dc_gain=self.factor, keeps_support=True, keeps_direction=True
        )

    def __call__(self, field):
        return ForceField(field.grid, field.bricks, field.forces_n * np.float32(self.factor))
