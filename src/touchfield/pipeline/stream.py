"""`OpenStream`: a ``.touch`` file that is open for reading, with its head, its decoder and its frames as a
medium."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.codec.registry import coder
from touchfield.codec.segment import BitAccount, BoundRule, bound_keys, compression_ratio, max_error_keys
from touchfield.compute.threads import Progress, silent
from touchfield.container import TouchReader
from touchfield.errors import CorruptFile, InvalidArgument, naming_file
from touchfield.files import json_of
from touchfield.medium import ForceField, Grid, HapticMedium, HapticScene
from touchfield.medium.grid import Placement
from touchfield.perception.grip import WeberCurve
from touchfield.perception.mask import Weber
from touchfield.pipeline.decoded_frames import SegmentFrames, VibrationFrames, segment_layout

if TYPE_CHECKING:
    from touchfield.codec.registry import FieldDecoder
    from touchfield.codec.segment import FrameCost
    from touchfield.devices import Device

FILTERED: Final = "the device-filtered field, behind any haptic filters"
"""The field that an error bound refers to, unless a file states another; `touchfield field` writes it."""


class OpenStream(ABC):
    """A ``.touch`` file, open for reading: its head, and its frames as a lazy medium.

    Attributes
    ----------
    reader : TouchReader
    file_bytes : int
    grid : Grid
        The lattice of `medium`.
    """

    is_live = False
    """True if the stream has no end, and reading a frame may wait for it."""

    def __init__(self, reader: TouchReader) -> None:
        self.reader, self.file_bytes = reader, reader.size
        head = reader.head
        self.grid = Grid(head.grid_shape, head.spacing_m, head.origin_m)

    @property
    def declared_device(self) -> Device:
        """The device that the stream was made for, from its head alone; no profile is looked up."""
        from touchfield.devices import Device

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
        """The placement of the scene in the workspace: ``to_hand(points)`` and ``to_scene(points)``."""
        return Placement(self.reader.head.mapping_scale, self.reader.head.mapping_offset_m)

    @property
    def _metadata(self) -> dict[str, Any]:
        """The fields of a medium and of a scene besides their frames."""
        names = ("rate_hz", "axes", "friction", "damping_n_s_per_m", "tags")
        metadata = {name: getattr(self.reader.head, name) for name in names}
        return metadata | {"provenance": self.reader.provenance}

    @property
    @abstractmethod
    def medium(self) -> HapticMedium:
        """The decoded medium, in voxels."""

    @property
    def scene(self) -> HapticScene | None:
        """The decoded objects; None if the file has voxels."""
        return None

    @property
    def masking(self) -> tuple[float, float] | None:
        """Fraction and radius in metres of the error bound's spatial masking; None without masking."""
        return None

    @cached_property
    def weber(self) -> Weber:
        """The Weber fraction of the error bound: k of the head, or the k(|F|) that the provenance has.

        CorruptFile if the points in the provenance are no such function.
        """
        points = self._k_by_force
        return WeberCurve(points) if points else self.reader.head.weber_fraction

    @property
    def _k_by_force(self) -> tuple[tuple[float, float], ...]:
        """Points of k(|F|) by the provenance of a file of coder `touch`; empty if k is one number."""
        try:
            stored = json_of(self.reader.provenance.get("spec", "{}"))["touch"]["k_by_force"]
        except (ValueError, TypeError, KeyError, RecursionError):
            return ()
        if self.reader.head.coder != "touch" or not stored:
            return ()
        try:
            return WeberCurve.of(stored).points
        except InvalidArgument as error:
            where = f"{self.reader.name}: PROV spec touch.k_by_force"
            raise CorruptFile(where, error.found, error.expected) from None

    @property
    @abstractmethod
    def bits(self) -> BitAccount:
        """Bits by their content, without the bits of the container."""

    @property
    @abstractmethod
    def bound_rule(self) -> BoundRule:
        """The bound that the coder guarantees for each voxel, if the segments state that they keep it."""

    @property
    @abstractmethod
    def max_error_summary(self) -> dict[str, Any]:
        """Keys of `codec.segment.max_error_keys`, empty for a coder without error bound; decodes nothing."""

    def error_bound(self) -> dict[str, Any]:
        """The proved error bound and the largest error: keys of `bound_keys` and `max_error_summary`."""
        max_error = self.max_error_summary
        return {**bound_keys(self.bound_rule, max_error), **max_error}

    @abstractmethod
    def _coder(self) -> dict[str, Any]:
        """Keys of the summary that depend on the coder."""

    @property
    def _vibration(self) -> VibrationFrames | None:
        """The vibration in addition to the force; None if the file has none."""
        return VibrationFrames(self.reader, self.grid) if self.reader.has_vibration else None

    def supported_voxels(self, report: Progress = silent) -> int:
        """Number of voxels with a force over all frames; decodes every frame."""
        medium, count = self.medium, 0
        for i in range(len(medium)):
            count += medium[i].support_count
            report(i + 1, len(medium))
        return count

    def bits_of_voxels(self, supported: int) -> dict[str, Any]:
        """Stable keys: all bits of the file per decoded voxel with a force."""
        bits_per_voxel = 8 * self.file_bytes / supported if supported else None
        return {"decoded_supported_voxels": supported, "bits_per_decoded_voxel": bits_per_voxel}

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs; those of the vibration only if the file has one."""
        head = self.reader.head
        size, bits, keys = self.file_bytes, self.bits, self._coder() | self.error_bound()
        keys |= {
            f"bits_{name}": getattr(bits, name) for name in ("support", "amplitude", "direction", "models")
        }
        keys["bits_side"] = 8 * size - (bits.total - bits.side)
        band = {} if self._vibration is None else self._vibration.summary()
        if band:
            keys["bits_side"] -= band["bits_vibration"]
        if "promise_kept" in keys:
            keys["promise_against"] = self.reader.provenance.get("reference", FILTERED)
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
            **keys,
            "cr_full": compression_ratio(8 * size, head.frame_count, self.grid.voxel_count),
            "cr_literal": compression_ratio(
                bits.amplitude + bits.direction, head.frame_count, self.grid.voxel_count
            ),
            **band,
            "provenance": dict(self.reader.provenance),
        }


class VoxelStream(OpenStream):
    """A file whose segments are fields on its lattice.

    Reading a frame decodes its segment up to that frame; sequential access decodes each frame once, on all
    cores.
    """

    def __init__(self, reader: TouchReader) -> None:
        super().__init__(reader)
        self.decoder: Any = coder(reader.head.coder).decoder_class(self.grid, reader.head.coder_parameters)
        decoder: FieldDecoder = self.decoder  # the frames outlive the stream: no `self` below

        def decoded(segment: int) -> Iterator[ForceField]:
            return decoder.frames(reader.read_segment(segment), reader.segments[segment].frame_count)

        self._frames = SegmentFrames(reader, decoded)

    @property
    def medium(self) -> HapticMedium:
        return HapticMedium(
            grid=self.grid,
            frame_count=self.reader.head.frame_count,
            make_frame=self._frames,
            vibration=self._vibration,
            segments=segment_layout(self.reader, self.decoder.describe()),
            **self._metadata,
        )

    @property
    def masking(self) -> tuple[float, float] | None:
        keys = self.decoder.describe()
        return (keys["masking"], keys["masking_radius_m"]) if "masking" in keys else None

    @cached_property
    def costs(self) -> tuple[FrameCost, ...]:
        """Costs of all frames; reads every segment once, and decodes none."""
        costs: list[FrameCost] = []
        with naming_file(self.reader.name):
            for i, segment in enumerate(self.reader.segments):
                costs.extend(self.decoder.costs(self.reader.read_segment(i), segment.frame_count))
        return tuple(costs)

    @property
    def bits(self) -> BitAccount:
        return sum((cost.bits for cost in self.costs), BitAccount())

    def _coder(self) -> dict[str, Any]:
        bits_by_kind: dict[str, list[int]] = {}
        for cost in self.costs:
            bits_by_kind.setdefault(cost.kind.name.lower(), []).append(cost.bits.total)
        keys: dict[str, Any] = {
            **self.decoder.describe(),
            "frame_kinds": {kind: len(bits) for kind, bits in bits_by_kind.items()},
            "bits_per_frame_by_kind": {kind: float(np.mean(bits)) for kind, bits in bits_by_kind.items()},
        }
        if not coder(self.reader.head.coder).has_error_bound:
            return keys
        keys["guesses"] = sum(cost.bits.models > 0 for cost in self.costs)
        keys["bits_guesses"] = sum(cost.bits.models for cost in self.costs)
        return keys

    @property
    def bound_rule(self) -> BoundRule:
        spec: Any = getattr(self.decoder, "spec", None)
        if self._k_by_force:
            spec = replace(spec, k_by_force=self._k_by_force)
        return coder(self.reader.head.coder).bound_rule(spec)

    @property
    def max_error_summary(self) -> dict[str, Any]:
        if not coder(self.reader.head.coder).has_error_bound:
            return {}
        with naming_file(self.reader.name):
            return max_error_keys(
                (segment.first_frame, self.decoder.max_error(self.reader.read_segment(i)))
                for i, segment in enumerate(self.reader.segments)
            )


def stream_device(stream: OpenStream) -> Device:
    """The profile that a stream was made for; if it is unknown, the device that the stream declares."""
    from touchfield.devices import device, device_names

    declared = stream.declared_device
    if declared.name not in device_names():  # a stream's device name is never opened as a file
        return declared
    profile = device(declared.name)
    return profile if profile.is_array == declared.is_array else declared
