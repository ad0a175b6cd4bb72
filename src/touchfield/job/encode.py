"""medium -> coder -> segments -> file: the encoding half of figure 4."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from touchfield._version import __version__
from touchfield.codec.objects import ObjectsEncoder
from touchfield.codec.paper import PaperEncoder
from touchfield.codec.paper_spec import PaperSpec
from touchfield.container import Head, TouchWriter
from touchfield.job.object_stream import write_objects
from touchfield.job.prepare import Prepared, prepare
from touchfield.job.spec import DEFAULT_F0_N, EncodeSpec, Report, silent
from touchfield.job.stream_scene import is_stream
from touchfield.measure.rate import compression_ratio
from touchfield.medium import ForceField, HapticMedium
from touchfield.sources.scene import Scene

__all__ = ["Encoded", "encode"]

MOST_BYTES_HELD = 1 << 28
"""A segment ends once its fields take more memory than this."""


@dataclass(frozen=True)
class Encoded:
    """What `encode` did; of objects, the supported voxels are the samples of their own fields, coded once each."""

    prepared: Prepared
    file_bytes: int
    encode_s: float
    supported_voxels: int

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should be told."""
        if self.supported_voxels:
            return self.prepared.notes
        return (*self.prepared.notes, "Nothing can be felt: no sample holds a force (--nw, --mapping)")

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        medium = self.prepared.medium
        bits = 8 * self.file_bytes
        return {
            **self.prepared.summary(),
            "file_bytes": self.file_bytes,
            "supported_voxels": self.supported_voxels,
            "bits_per_supported_voxel": bits / self.supported_voxels if self.supported_voxels else None,
            "cr_full": compression_ratio(bits, len(medium), medium.grid.voxel_count),
            "encode_s": self.encode_s,
        }


def encode(
    source: str | Path | Scene, out: str | Path, spec: EncodeSpec | None = None, report: Report = silent
) -> Encoded:
    """Turn a source into a ``.touch`` file.

    Raises
    ------
    TouchfieldError
        If anything is at fault; nothing is then left under the name `out`.
    """
    began = time.perf_counter()
    spec = spec or EncodeSpec()
    prepared = prepare(source, spec)
    paper = spec.paper.for_device(prepared.device.is_array)
    provenance = _provenance(source, prepared)
    with TouchWriter(Path(out)) as writer:
        if prepared.scene is None:
            supported = _write_voxels(writer, prepared, paper, provenance, report)
        else:
            encoder = ObjectsEncoder(prepared.scene, paper, DEFAULT_F0_N)
            writer.write_head(_head(prepared, encoder), provenance)
            write_objects(writer, encoder, len(prepared.scene), report)
            supported = encoder.account.supported
    return Encoded(prepared, Path(out).stat().st_size, time.perf_counter() - began, supported)


def _write_voxels(
    writer: TouchWriter, prepared: Prepared, paper: PaperSpec, provenance: dict[str, str], report: Report
) -> int:
    """The voxel representation, head and segments; how many samples hold a force."""
    encoder = PaperEncoder(prepared.medium.grid, paper)
    writer.write_head(_head(prepared, encoder), provenance)
    first = supported = 0
    for frames in _segments(prepared.medium, paper.segment_frames, report):
        segment = encoder.encode_segment(frames)
        supported += sum(f.support_count for f in frames)
        writer.write_segment(first, len(frames), segment.body)
        first += len(frames)
    return supported


def _provenance(source: str | Path | Scene, prepared: Prepared) -> dict[str, str]:
    name = "scene" if isinstance(source, Scene) else str(source)
    said = {"touchfield": __version__, "source": Path(name).name[:255], "spec": prepared.spec.to_json()}
    was = (prepared.scene or prepared.medium).provenance
    for key in ("source", "spec") if is_stream(source) else ():
        if key in was:  # what was decoded has a history of its own
            said[f"source.{key}"] = was[key]
    return said


def _segments(medium: HapticMedium, most_frames: int, report: Report) -> Iterator[list[ForceField]]:
    """The frames in groups, each small enough to be held in memory while it is coded."""
    frames: list[ForceField] = []
    held = 0
    for i, frame in enumerate(medium):
        frames.append(frame)
        held += frame.forces_n.nbytes
        report(i + 1, len(medium))
        if len(frames) == most_frames or held > MOST_BYTES_HELD or i + 1 == len(medium):
            yield frames
            frames, held = [], 0


def _head(prepared: Prepared, encoder: PaperEncoder | ObjectsEncoder) -> Head:
    medium, grid = prepared.medium, prepared.medium.grid
    return Head(
        grid_shape=grid.shape,
        spacing_m=grid.spacing_m,
        origin_m=grid.origin_m,
        rate_hz=medium.rate_hz,
        frame_count=len(medium),
        axes=medium.axes,
        device_name=prepared.device.name,
        device_type=prepared.device.type,
        force_max_n=prepared.device.force_max_n,
        mapping_scale=prepared.placement.scale,
        mapping_offset_m=prepared.placement.offset_m,
        weber_fraction=prepared.spec.paper.k,
        force_threshold_n=DEFAULT_F0_N,
        friction=medium.friction,
        damping_n_s_per_m=medium.damping_n_s_per_m,
        tags=medium.tags,
        coder=encoder.name,
        coder_parameters=encoder.parameters,
    )
