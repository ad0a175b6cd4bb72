"""Encodes and decodes one scene under many settings of a coder, for the tables. The force fields are made
once.

Each setting is encoded to a file and decoded from it as `touchfield encode` and `touchfield compare` do, so
that a compression ratio of the whole file counts the whole file.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from touchfield.codec.paper.body import BodyReader
from touchfield.codec.paper.directions import Codebook
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.segment import BitAccount, FrameStats, compression_ratio
from touchfield.errors import InvalidArgument
from touchfield.measure.fidelity import FidelityMeter
from touchfield.pipeline import encode, prepare
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.spec import DEFAULT_F0_N, EncodeSpec
from touchfield.pipeline.stream import VoxelStream
from touchfield.sources.scene import Scene

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from touchfield.medium import ForceField, Grid
    from touchfield.sources.laws import ForceProfile

__all__ = ["Coded", "CodedScene"]


@dataclass(frozen=True)
class Coded:
    """What a setting of the coder cost, and what was left of the field.

    Attributes
    ----------
    cr_literal, cr_full : float
        Eq. 9 as printed, C_a + C_d alone; and every bit of the file.
    nmse_db : float
        10 log10 of the energy ratio of eq. 10; -inf where nothing was lost.
    norm_db : float
        10 log10 of the ratio L of the sums of norms, eq. 10 as printed with the sum below put in.
    beyond_mask : float
        Share of the voxels whose error is beyond the mask, |e| > max(F_0, k |F|).
    frames : tuple of FrameStats
    voxel_count : int
        Of the lattice.
    """

    cr_literal: float
    cr_full: float
    nmse_db: float
    norm_db: float
    beyond_mask: float
    frames: tuple[FrameStats, ...]
    voxel_count: int

    @property
    def decibels(self) -> dict[str, float]:
        """Eq. 10 in the four conventions that the paper may have meant."""
        return {
            "10 log NMSE": self.nmse_db,
            "10 log L": self.norm_db,
            "20 log L": 2 * self.norm_db,
            "20 log NMSE": 2 * self.nmse_db,
        }

    def bits(self, frame: int) -> int:
        """C_a + C_d of one frame."""
        account = self.frames[frame].bits
        return account.amplitude + account.direction

    @property
    def sent_per_voxel(self) -> float:
        """Vectors that were sent over the voxels of all frames."""
        return sum(frame.sent for frame in self.frames) / (len(self.frames) * self.voxel_count)

    @property
    def bits_per_sent(self) -> float:
        """C_a + C_d over the vectors that were sent; 0 where none was."""
        sent = sum(frame.sent for frame in self.frames)
        return sum(self.bits(i) for i in range(len(self.frames))) / sent if sent else 0.0

    @property
    def kinds(self) -> str:
        """How the frames were coded, a letter each: I alone, P difference in closed loop, D in open loop."""
        return "".join("IPD"[frame.kind] for frame in self.frames)


class CodedScene:
    """A scene on the lattice of a device, to be coded under many settings.

    Parameters
    ----------
    scene : Scene
    nw : int
        n_w: 2^n_w samples along each axis of the workspace.
    device : str
    """

    def __init__(self, scene: Scene, nw: int, device: str = "phantom-omni") -> None:
        self._scene, self._nw, self._device = _Kept(scene), nw, device

    def _spec(self, frame_count: int, paper: PaperSpec) -> EncodeSpec:
        frames = (0, frame_count)
        spec = EncodeSpec(self._device, self._nw, frames, representation="voxel", coder="paper", paper=paper)
        return replace(spec, mapping="fill", fit_frames=(0, None))

    @cached_property
    def fields(self) -> tuple[ForceField, ...]:
        """The frames after the device filter."""
        return tuple(prepare(self._scene, self._spec(self._scene.frame_count, PaperSpec())).medium)

    def coded(self, paper: PaperSpec, frame_count: int = 1) -> Coded:
        """Code the first frames, and compare them with what was coded.

        Raises
        ------
        InvalidArgument
            If the frames make more than one segment, or there are not as many.
        """
        if not 1 <= frame_count <= min(paper.segment_frames, len(self.fields)):
            most = f"1 to {min(paper.segment_frames, len(self.fields))}"
            raise InvalidArgument("frames to code", str(frame_count), most)
        meter = FidelityMeter(paper.k, DEFAULT_F0_N)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "coded.touch"
            encode(self._scene, path, self._spec(frame_count, paper))
            with open_file(path) as opened:
                assert isinstance(opened, VoxelStream)
                codebook = Codebook.get(opened.decoder.describe()["directions"])
                segment = BodyReader(opened.reader.read_segment(0), self.fields[0].grid, codebook)
                frames = tuple(_stats(segment, frame_count))
                for original, decoded in zip(self.fields, opened.medium, strict=False):
                    meter.add(original, decoded)
                file_bits = 8 * opened.file_bytes
        total = sum((frame.bits for frame in frames), BitAccount())
        voxels = self.fields[0].grid.voxel_count
        return Coded(
            compression_ratio(total.amplitude + total.direction, frame_count, voxels),
            compression_ratio(file_bits, frame_count, voxels),
            -float("inf") if meter.nmse_db is None else meter.nmse_db,
            -float("inf") if meter.nmse_literal_db is None else meter.nmse_literal_db / 2,
            meter.mask_violation_share,
            frames,
            voxels,
        )


def _stats(segment: BodyReader, frame_count: int) -> Iterator[FrameStats]:
    """Cost of each frame of a segment, and how many samples it holds and sends."""
    for frame, cost in segment.frames(frame_count):
        symbols = segment.symbols(frame)
        yield FrameStats(cost.kind, cost.bits, len(symbols.sent), len(symbols.levels))


class _Kept(Scene):
    """A scene that remembers the fields it was asked for."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.frame_count, self.rate_hz, self.axes = scene.frame_count, scene.rate_hz, scene.axes
        self.notes, self.is_solid, self.finest_m, self.tags = (
            scene.notes,
            scene.is_solid,
            scene.finest_m,
            scene.tags,
        )
        self._fields: dict[tuple[int, Grid, ForceProfile], ForceField] = {}

    def bounds_m(self) -> NDArray[np.float64]:
        return self._scene.bounds_m()

    def bounds_between_m(self, start: int, stop: int) -> NDArray[np.float64]:
        return self._scene.bounds_between_m(start, stop)

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        asked = frame, grid, profile
        if asked not in self._fields:
            self._fields[asked] = self._scene.field(frame, grid, profile)
        return self._fields[asked]
