"""file -> segments -> decoder -> medium: the decoding half of figure 4."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.codec.paper.field_quantiser import DEFAULT_QUANTISER, FieldQuantiserSpec
from touchfield.codec.registry import coder
from touchfield.codec.touch.body import TouchCost
from touchfield.container import TouchReader
from touchfield.devices import Device
from touchfield.errors import InvalidArgument
from touchfield.filters.placement import Placement
from touchfield.job.object_stream import ObjectStream
from touchfield.job.promise_kept import FILTERED, guesses_used, promise_kept
from touchfield.job.segment_frames import SegmentFrames, segments_of
from touchfield.job.spec import Report, silent
from touchfield.job.vibration_frames import VibrationFrames
from touchfield.measure.rate import BitAccount, compression_ratio
from touchfield.medium import ForceField, Grid, HapticMedium, HapticScene
from touchfield.medium.budget import memory_budget_bytes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.registry import FieldDecoder
    from touchfield.codec.segment import FrameCost
    from touchfield.medium.vibration import VibrationBand

__all__ = ["OpenStream", "SceneStream", "VoxelStream", "open_stream", "opened", "write_field"]


class OpenStream(ABC):
    """A ``.touch`` file, open for reading: its head, and its frames as a lazy medium.

    Attributes
    ----------
    reader : TouchReader
    file_bytes : int
    grid : Grid
        The lattice of `medium`.
    """

    def __init__(self, reader: TouchReader, file_bytes: int) -> None:
        self.reader, self.file_bytes = reader, file_bytes
        head = reader.head
        self.grid = Grid(head.grid_shape, head.spacing_m, head.origin_m)

    @property
    def told_device(self) -> Device:
        """The device that the stream was made for, as far as it tells; no profile is looked up."""
        head = self.reader.head
        low, high = self.grid.box_m
        x, y, z = (1e3 * (high - low)).tolist()
        return Device(
            name=head.device_name,
            title=f"{head.device_name}, as {Path(self.reader.name).name} tells",
            type=head.device_type,
            axes=head.axes,
            workspace_mm=(x, y, z),
            lattice=self.grid.shape,
            force_max_n=head.force_max_n,
        )

    @property
    def placement(self) -> Placement:
        """The place of the scene in the workspace: ``to_hand(points)`` and ``to_scene(points)``."""
        return Placement(self.reader.head.mapping_scale, self.reader.head.mapping_offset_m)

    @property
    @abstractmethod
    def medium(self) -> HapticMedium:
        """The decoded medium, in voxels."""

    @property
    def scene(self) -> HapticScene | None:
        """The decoded objects; None where the file holds voxels."""
        return None

    @property
    @abstractmethod
    def held(self) -> object:
        """What `medium` and `scene` hold on to, and what needs the reader to be open."""

    @property
    @abstractmethod
    def bits(self) -> BitAccount:
        """Bits by what they tell; those of the file's frame are not counted."""

    @abstractmethod
    def bits_by_kind(self) -> dict[str, float]:
        """Mean bits of a frame of each kind."""

    @abstractmethod
    def quantiser(self) -> Callable[[ForceField], NDArray[np.int64]]:
        """Q: each supported force of a frame to a symbol, the same for all frames."""

    @abstractmethod
    def _coder(self) -> dict[str, Any]:
        """What the summary tells of the coder."""

    @property
    def _vibration(self) -> VibrationBand | None:
        """What vibrates beside the force; None where the file tells of nothing."""
        if not self.reader.has_vibration:
            return None
        return VibrationFrames(self.reader, self.grid, self.held).band

    def _reference(self) -> str:
        """What the promise is held against, as far as the file tells."""
        return self.reader.provenance.get("reference", FILTERED)

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs; those of the vibration only where there is one."""
        head = self.reader.head
        size, bits, coder = self.file_bytes, self.bits, self._coder()
        band = VibrationFrames(self.reader, self.grid, self.held).summary() if self.reader.has_vibration else {}
        if band:
            coder["bits_side"] -= band["bits_vibration"]
        return {
            "file_bytes": size,
            "frames": head.frame_count,
            "rate_hz": head.rate_hz,
            "seconds": head.frame_count / head.rate_hz,
            "segments": len(self.reader.segments),
            "grid_shape": list(head.grid_shape),
            "spacing_mm": [1e3 * h for h in head.spacing_m],
            "axes": head.axes,
            "tags": list(head.tags),
            "device": head.device_name,
            "device_type": head.device_type,
            "force_max_n": head.force_max_n,
            "mapping_scale": head.mapping_scale,
            "mapping_offset_m": list(head.mapping_offset_m),
            "k": head.weber_fraction,
            "f0_n": head.force_threshold_n,
            "coder": head.coder,
            "representation": "voxel" if self.scene is None else "object",
            **coder,
            **({"promise_against": self._reference()} if "promise_kept" in coder else {}),
            "cr_full": compression_ratio(8 * size, head.frame_count, self.grid.voxel_count),
            "cr_literal": compression_ratio(bits.amplitude + bits.direction, head.frame_count, self.grid.voxel_count),
            **band,
            "provenance": dict(self.reader.provenance),
        }


class VoxelStream(OpenStream):
    """A file whose segments are fields on its lattice."""

    def __init__(self, reader: TouchReader, file_bytes: int) -> None:
        super().__init__(reader, file_bytes)
        self.decoder: Any = coder(reader.head.coder).decoder_class(self.grid, reader.head.coder_parameters)
        decoder: FieldDecoder = self.decoder  # and not `self`: the frames outlive the stream

        def decoded(segment: int) -> Iterator[ForceField]:
            return decoder.frames(reader.read_segment(segment), reader.segments[segment].frame_count)

        self._frames = SegmentFrames(reader, decoded)

    @property
    def medium(self) -> HapticMedium:
        """See `OpenStream`; a frame costs the decoding of its segment up to it, or one frame in sequence.

        Frames in sequence are decoded on all cores where there are several segments.
        """
        head = self.reader.head
        return HapticMedium(
            self.grid, head.rate_hz, head.frame_count, self._frames, head.axes, head.friction,
            head.damping_n_s_per_m, tuple(head.tags), dict(self.reader.provenance), self._vibration,
            segments_of(self.reader, self.decoder.describe()),
        )  # fmt: skip

    @property
    def held(self) -> SegmentFrames:
        """See `OpenStream`."""
        return self._frames

    @cached_property
    def costs(self) -> tuple[FrameCost, ...]:
        """What each frame of the file cost; reads every segment once, and decodes none."""
        segments = enumerate(self.reader.segments)
        return tuple(
            cost for i, s in segments for cost in self.decoder.costs(self.reader.read_segment(i), s.frame_count)
        )

    @property
    def bits(self) -> BitAccount:
        """See `OpenStream`."""
        return sum((c.bits for c in self.costs), BitAccount())

    def bits_by_kind(self) -> dict[str, float]:
        """See `OpenStream`."""
        kinds = dict.fromkeys(c.kind for c in self.costs)
        return {k.name.lower(): float(np.mean([c.bits.total for c in self.costs if c.kind == k])) for k in kinds}

    def quantiser(self) -> Callable[[ForceField], NDArray[np.int64]]:
        """See `OpenStream`: the intra tables of the first segment."""
        made: Callable[[ForceField], NDArray[np.int64]] = self.decoder.quantiser(self.reader.read_segment(0))
        return made

    def _coder(self) -> dict[str, Any]:
        kinds = [c.kind.name.lower() for c in self.costs]
        bits = self.bits
        told: dict[str, Any] = {
            **self.decoder.describe(),
            "frame_kinds": {k: kinds.count(k) for k in dict.fromkeys(kinds)},
            "bits_per_frame_by_kind": self.bits_by_kind(),
            "bits_support": bits.support,
            "bits_amplitude": bits.amplitude,
            "bits_direction": bits.direction,
            "bits_models": bits.models,
            "bits_side": 8 * self.file_bytes - (bits.total - bits.side),
        }
        if not coder(self.reader.head.coder).has_promise:
            return told
        segments = self.reader.segments
        promises = (
            (s.first_frame, self.decoder.promise(self.reader.read_segment(i))) for i, s in enumerate(segments)
        )
        costs = [cost for cost in self.costs if isinstance(cost, TouchCost)]
        return {**told, **guesses_used(costs), **promise_kept(promises)}


class SceneStream(OpenStream):
    """A file of coder `objects`."""

    def __init__(self, reader: TouchReader, file_bytes: int) -> None:
        super().__init__(reader, file_bytes)
        self.objects = ObjectStream(reader)

    @property
    def scene(self) -> HapticScene:
        """See `OpenStream`."""
        return self.objects.scene

    @property
    def medium(self) -> HapticMedium:
        """See `OpenStream`; a frame costs one query of the scene for each voxel near an object."""
        return replace(self.scene.voxelise(), vibration=self._vibration)

    @property
    def held(self) -> ObjectStream:
        """See `OpenStream`."""
        return self.objects

    @property
    def bits(self) -> BitAccount:
        """See `OpenStream`."""
        return self.objects.bits

    def bits_by_kind(self) -> dict[str, float]:
        """See `OpenStream`: no frame of its own, but poses, and what the fields take spread over all frames."""
        count, bits = self.reader.head.frame_count, self.objects.bits
        return {"poses": bits.poses / count, "fields": (bits.total - bits.poses) / count}

    def quantiser(self) -> Callable[[ForceField], NDArray[np.int64]]:
        """See `OpenStream`: the Weber ladder and directions that measures take by default."""
        fitted = FieldQuantiserSpec.parse(DEFAULT_QUANTISER).fit((), self.reader.head.force_max_n)
        return lambda field: fitted.symbols_of(field.vectors_n()).astype(np.int64)

    def _coder(self) -> dict[str, Any]:
        bits = self.objects.bits
        told = {
            "bits_poses": bits.poses,
            "bits_fields": bits.total - bits.poses,
            "bits_support": bits.support,
            "bits_amplitude": bits.amplitude,
            "bits_direction": bits.direction,
            "bits_models": bits.models,
            "bits_side": 8 * self.file_bytes - (bits.total - bits.side),
            "frame_kinds": {"object": self.reader.head.frame_count},
        }
        return {**self.objects.decoder.describe(), **told, **self.objects.promise()}


@contextmanager
def open_stream(path: str | Path) -> Iterator[OpenStream]:
    """Open a ``.touch`` file; decoding takes no configuration."""
    with TouchReader(path) as reader:
        yield opened(reader, Path(path).stat().st_size)


def opened(reader: TouchReader, file_bytes: int) -> OpenStream:
    """The stream of a reader, by its coder.

    Raises
    ------
    UnsupportedVersion
        If there is no such coder.
    """
    is_scene = coder(reader.head.coder).spec is None
    return SceneStream(reader, file_bytes) if is_scene else VoxelStream(reader, file_bytes)


def write_field(
    path: str | Path, medium: HapticMedium, report: Report = silent, placement: Placement | None = None
) -> Path:
    """Write a medium as ``.npz`` or ``.vti``, by the ending of `path`, and where its scene lies; the file to open.

    Several frames as ``.vti`` are numbered files and a ``.pvd`` that lists them: that is the one to open.

    Raises
    ------
    InvalidArgument
        If the ending is another, or a dense frame would take more than `memory_budget_bytes`: a small file may
        tell of a large grid.
    """
    from touchfield.medium.npz import write_npz
    from touchfield.medium.vti import write_vti

    path = Path(path)
    needed, allowed = 12 * medium.grid.voxel_count, memory_budget_bytes()
    if needed > allowed:
        found = f"{needed / 2**30:.1f} GiB for each dense frame of {medium.grid.shape} samples"
        mend = "Keep the .touch file, which is sparse, or set TOUCHFIELD_MEMORY_GIB."
        raise InvalidArgument(str(path), found, f"at most {allowed / 2**30:.1f} GiB", mend)

    def progress(done: int) -> None:
        report(done, len(medium))

    told = placement.told() if placement is not None else {}
    if path.suffix == ".npz":
        write_npz(path, medium, progress, told)
        return path
    if path.suffix == ".vti":
        return write_vti(path, medium, progress=progress, told=told)
    raise InvalidArgument(str(path), f"the ending {path.suffix!r}", "FIELD.npz or FIELD.vti")
