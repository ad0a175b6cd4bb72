"""Compares a ``.touch`` file with its source, for `touchfield compare`: error in numbers, and what a
simulated hand feels in both. It also reports and draws what haptic filters changed.

The filter report measures a medium before and after each haptic filter (paper 3.2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from touchfield.codec.objects.error_bound import BoundCheck, compare_scenes
from touchfield.codec.paper.field_quantiser import FieldQuantiserSpec
from touchfield.codec.segment import BitAccount
from touchfield.compute.threads import Progress, silent
from touchfield.errors import InvalidArgument, naming_file
from touchfield.filters.limit import limit_forces
from touchfield.filters.registry import FieldFilter
from touchfield.measure.counts import SymbolCounter
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField, Grid, HapticMedium, HapticScene
from touchfield.medium.grid import Placement
from touchfield.medium.selection import evenly_spaced
from touchfield.perception.hand_motion import Forces, HandMotion, HoldMeter, SlideMeter, SlideSpec
from touchfield.perception.human import vibration_threshold
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.objects import filter_objects
from touchfield.pipeline.preparation import Prepared, prepare
from touchfield.pipeline.result import Result
from touchfield.pipeline.source import FixedLatticeScene, Source, as_source, open_scene
from touchfield.pipeline.spec import DEFAULT_F0_N, NO_FLOOR_N, EncodeSpec
from touchfield.pipeline.stream import OpenStream
from touchfield.render.segment_blend import with_blends
from touchfield.viewer.picture import draw_comparison

_SLIDE_FRAMES: Final = 4


@dataclass(frozen=True)
class Comparison:
    """A stream measured against its source."""

    meter: FidelityMeter
    bits: BitAccount
    stream: dict[str, Any]
    drawn: tuple[int, ForceField, ForceField]
    notes: tuple[str, ...]
    hand: HandMotion
    voxels: dict[str, Any]
    """Bits for each voxel, as `OpenStream.bits_of_voxels`."""
    composed: tuple[BoundCheck, float] | None = None
    """Of objects: the mask against the source with its bodies at the decoded poses, and the distance, m."""

    def __repr__(self) -> str:
        figures = self.summary()
        names = ("frames", "file_bytes", "bits_per_supported_voxel", "nmse_db", "mask_violation_share")
        short = (f"{name} {figures[name]:.6g}" for name in names if figures[name] is not None)
        return f"<Comparison: {', '.join(short)}>"

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        meter, stream, bits = self.meter, self.stream, self.bits
        violations, max_ratio, in_place = meter.mask_violations, meter.worst_mask_ratio, {}
        if self.composed is not None:
            in_mask, distance_m = self.composed
            in_place = {
                "place_tolerance_um": stream["place_tolerance_um"],
                "worst_place_um": 1e6 * distance_m,
                "mask_violations_in_place": violations,
                "worst_mask_ratio_in_place": max_ratio,
            }
            if 1e6 * distance_m <= stream["place_tolerance_um"] * (1 + 1e-6):
                violations, max_ratio = in_mask.violations, in_mask.max_error[0]
        supported = meter.supported_voxels
        of_stream = ("file_bytes", "frames", "grid_shape", "device")
        of_meter = ("nmse_db", "nmse_literal_db", "nmse_forensic_db", "k", "f0_n")
        return {
            **{key: stream[key] for key in of_stream},
            "supported_voxels": supported,
            "bits_per_supported_voxel": 8 * stream["file_bytes"] / supported if supported else None,
            "cr_full": stream["cr_full"],
            "cr_literal": stream["cr_literal"],
            **{key: getattr(meter, key) for key in of_meter},
            "mask_violations": violations,
            "mask_violation_share": violations / max(1, meter.compared_voxels),
            "worst_mask_ratio": max_ratio,
            **in_place,
            **self.voxels,
            **{f"bits_{key}": getattr(bits, key) for key in ("support", "amplitude", "direction")},
            "bits_side": bits.side + bits.models,
            "bits_poses": bits.poses,
            **self.hand.summary(),
        }

    def draw(self, path: str | Path) -> None:
        """Write the picture of one frame, PNG: source, decoded, error in units of the mask."""
        frame, original, decoded = self.drawn
        values = self.summary()
        bits_per_voxel = values["bits_per_supported_voxel"] or 0.0
        nmse = "exact" if values["nmse_db"] is None else f"NMSE {values['nmse_db']:.1f} dB"
        title = (
            f"frame {frame + 1} of {values['frames']} for {values['device']}, {values['file_bytes']:,} bytes"
        )
        caption = (
            f"{bits_per_voxel:.3g} bits per supported voxel, CR {values['cr_full']:.3g}, {nmse}, "
            f"{100 * values['mask_violation_share']:.1f} % of voxels beyond the mask"
        )
        mask = self.meter.weber, self.meter.f0_n
        draw_comparison(Path(path), original, decoded, f"{title}\n{caption}", self.stream["axes"], mask)


def compare(
    source: Source | ArrayLike,
    stream: str | Path,
    *,
    k: float | None = None,
    f0_n: float | None = None,
    frame: int | None = None,
    allow_outside: bool = False,
    slides: SlideSpec | None = None,
    report: Progress = silent,
) -> Comparison:
    """Measure a stream against its source, which is filtered again by the stream's provenance.

    `source` is the encoded path, scene, medium, field or DataArray of heights, an array of newtons on the
    lattice of the stream, or its field as the command `field` writes it. The mask max(F_0, k |F|) is by
    default that of the stream, with its spatial masking; `frame`, which `Comparison.draw` shows, by default
    the middle one. `allow_outside` lets the source refer to files outside its own folder; `slides` replaces
    the default slides of the hand.
    """
    with open_file(stream) as opened:
        original = source_medium(source, opened, allow_outside)
        return _compare(original, opened, k, f0_n, frame, slides, report)


def compare_prepared(
    prepared: Prepared, stream: str | Path, slides: SlideSpec | None = None, report: Progress = silent
) -> Comparison:
    """Measure a stream against what was coded, ``Encoded.prepared`` of `encode`; see `compare`.

    The source is not opened and placed again.
    """
    with open_file(stream) as opened:
        return _compare(prepared, opened, slides=slides, report=report)


def _compare(
    original: Prepared,
    opened: OpenStream,
    k: float | None = None,
    f0_n: float | None = None,
    frame: int | None = None,
    slides: SlideSpec | None = None,
    report: Progress = silent,
) -> Comparison:
    """Compare the frames of an open stream with those of its source; see `compare`."""
    head = opened.reader.head
    decoded, scene, notes = opened.medium, original.objects, original.notes
    drawn_frame = len(decoded) // 2 if frame is None else frame
    if not 0 <= drawn_frame < len(decoded):
        raise InvalidArgument("frame", repr(frame), f"0 to {len(decoded) - 1}")
    # a stream without F_0 is measured with the smallest threshold that a meter takes
    floor_n = (head.force_threshold_n or NO_FLOOR_N) if f0_n is None else f0_n
    masking = opened.masking if k is None and f0_n is None else None
    meter = FidelityMeter(opened.weber if k is None else k, floor_n, masking)
    hand, supported = HandMeter(opened, scene, original.exact, slides), 0
    for i in range(len(decoded)):
        x, y = original.medium[i], decoded[i]
        meter.add(x, y)
        hand.add(i, x, y)
        supported += y.support_count
        if i == drawn_frame:
            drawn = (i, x, y)
        report(i + 1, len(decoded))
    voxels = opened.bits_of_voxels(supported)
    composed = None
    if scene is not None and opened.scene is not None and "place_tolerance_um" in opened.summary():
        composed = compare_scenes(scene, opened.scene, meter.k, floor_n)
        distance = f"at most {1e6 * composed[1]:.1f} um off"
        notes = (
            *notes,
            f"the mask is that of the source with each body at its decoded pose, {distance}; *_in_place "
            "are without that tolerance",
        )
    bits, summary = opened.bits, opened.summary()
    bits = replace(bits, side=0)
    bits = replace(bits, side=8 * summary["file_bytes"] - bits.total)
    return Comparison(meter, bits, summary, drawn, notes, hand.motion(), voxels, composed)


def source_medium(source: Source | ArrayLike, opened: OpenStream, allow_outside: bool = False) -> Prepared:
    """Filter the source of a stream again by the stream's provenance; the result is on its lattice.

    InvalidArgument if the source is elsewhere in the workspace, or has another number of frames.
    """
    head, provenance = opened.reader.head, opened.reader.provenance
    if "spec" not in provenance:
        hint = "Compare it with its field, FIELD.npz."
        raise InvalidArgument("stream", "no provenance to filter the source by", hint=hint)
    form = "voxel" if opened.scene is None else "object"
    with naming_file(opened.reader.name):
        spec = replace(EncodeSpec.from_json(provenance["spec"]), representation=form)
    spec = replace(spec, source=replace(spec.source, allow_outside=allow_outside))
    original = _written_field(source, opened, spec) or _filtered_again(source, opened, spec)
    if len(original.medium) != head.frame_count:
        found, expected = f"{head.frame_count} frames", f"the source's {len(original.medium)}"
        raise InvalidArgument(opened.reader.name, found, expected, "Name the source it came from.")
    return original


def _written_field(source: Source | ArrayLike, opened: OpenStream, spec: EncodeSpec) -> Prepared | None:
    """The field of the source as the command `field` writes it; None for any other source."""
    if not isinstance(source, (str, Path)):
        return None
    if Path(source).suffix != ".npz" or not Path(source).is_file():
        return None
    field = open_scene(source, replace(spec.source, kind=None))
    stored = field.stored
    if stored is None or stored.grid != opened.grid:
        return None
    frame_count = opened.reader.head.frame_count
    if len(stored) != frame_count and spec.frames is not None:  # `encode` was given a range of frames
        stored = stored.between(spec.frames[0], spec.frames[0] + frame_count)
    return Prepared(stored, opened.declared_device, opened.placement, spec, field.notes)


def _filtered_again(source: Source | ArrayLike, opened: OpenStream, spec: EncodeSpec) -> Prepared:
    """The source through the filters of `spec`; InvalidArgument if it is elsewhere in the workspace."""
    is_forces = getattr(source, "ndim", 0) >= 4  # an array [..., nx, ny, nz, 3], on the stream's lattice
    scene = open_scene(as_source(source, spec.device, opened.grid if is_forces else None), spec.source)
    if isinstance(scene, FixedLatticeScene):
        scene.notes = ()  # on options without effect: none is given here
    original = prepare(scene, spec)
    source_layout = _layout(original.medium.grid, original.placement)
    stream_layout = _layout(opened.grid, opened.placement)
    if not np.allclose(source_layout, stream_layout, rtol=1e-6, atol=1e-9):
        found = "a scene that lies elsewhere in the workspace than the stream's"
        name = str(source) if isinstance(source, str | Path) else "source"
        raise InvalidArgument(name, found, hint="Name its own source.")
    if original.objects:
        note = "compared with the objects before coding, not with the voxel representation"
        original = replace(original, notes=(*original.notes, note))
    return original


def _layout(grid: Grid, placement: Placement) -> list[float]:
    """Numbers that are equal for two lattices at the same position of the same scene."""
    return [*grid.shape, *grid.spacing_m, *grid.origin_m, placement.scale, *placement.offset_m]


class HandMeter:
    """Simulated hand in one stream and its source; it gets the frames in order.

    Slides are measured in up to four decoded frames, evenly spaced. Holds are measured over all frames as a
    receiver plays them, blended where a segment starts. The forces of voxels are interpolated between
    samples; those of objects are the receiver's own query of both scenes. `scene` has the source's objects,
    `exact` is the field that the source samples (`Prepared.exact`).
    """

    def __init__(
        self,
        opened: OpenStream,
        scene: HapticScene | None = None,
        exact: Forces | None = None,
        spec: SlideSpec | None = None,
    ) -> None:
        head = opened.reader.head
        self._scene, self._coded, self._exact = scene, opened.scene, exact
        decoded = opened.medium if scene is None or opened.scene is None else opened.scene
        self._played, self._blends = with_blends(decoded)
        count = head.frame_count
        self._slid = set(evenly_spaced(count, _SLIDE_FRAMES))
        self._starts = {segment.first_frame for segment in opened.reader.segments}
        self._slides = SlideMeter(spec)
        floor_n = head.force_threshold_n or NO_FLOOR_N
        self._hold = HoldMeter(count, head.rate_hz, opened.weber, floor_n) if count > 1 else None

    def add(self, frame: int, source: ForceField, decoded: ForceField) -> None:
        """Measure one frame; both fields are on the stream's lattice."""
        source_forces: Forces = source.sample_n
        decoded_forces: Forces = decoded.sample_n
        if self._scene is not None and self._coded is not None:
            source_forces = partial(self._scene.sample_n, frame)
            decoded_forces = partial(self._coded.sample_n, frame)
        if frame in self._slid:
            self._slides.add(source, source_forces, decoded_forces, self._exact)
        if self._hold is not None:
            medium, played_forces = self._played, decoded_forces
            if self._blends and isinstance(medium, HapticScene):
                played_forces = partial(medium.sample_n, frame)
            elif self._blends and isinstance(medium, HapticMedium):
                played_forces = medium[frame].sample_n
            self._hold.add(source, source_forces, played_forces, frame in self._starts)

    def motion(self) -> HandMotion:
        """Slides and holds of all frames added."""
        hold = None if self._hold is None else self._hold.hold()
        return HandMotion(self._slides.slides(), hold, vibration_threshold())


def filter_report(source: Source, spec: EncodeSpec, report: Progress = silent) -> Result:
    """Measure a medium before and after each filter of ``spec.filters``, frame by frame.

    ``spec.paper.k`` is the Weber fraction of the mask; Q of the entropies is weber:0.1, up to the device's
    F_max, for all stages. Each of ``stages`` has its name, support, greatest and root-mean-square force, its
    entropies, and the change against the medium before the chain: NMSE in dB, and the fraction of voxels
    outside the mask.
    """
    prepared = prepare(source, replace(spec, filters=()))
    medium = prepared.medium
    quantise = FieldQuantiserSpec().fit(medium, prepared.device.force_max_n)
    chain, stages_of = spec.chain, _stages(prepared, spec.chain)
    meters = [_StageMeter(name, spec) for name in ("device filter", *(step.name for step in chain))]
    for i in range(len(medium)):
        stages = stages_of(i)
        for meter, field in zip(meters, stages, strict=True):
            meter.add(stages[0], field, quantise(field).object_symbols)
        report(i + 1, len(medium))
    return Result({"quantiser": quantise.text, "stages": [meter.row() for meter in meters]})


def draw_filtered(source: Source, spec: EncodeSpec, path: str | Path) -> None:
    """Write the picture of the middle frame before and after the filters of ``spec.filters``, PNG.

    The error is in units of the mask of ``spec.paper.k``. MissingExtra if matplotlib is not installed.
    """
    prepared = prepare(source, replace(spec, filters=()))
    medium, middle = prepared.medium, len(prepared.medium) // 2
    stages = _stages(prepared, spec.chain)(middle)
    before, after = stages[0], stages[-1]
    meter = FidelityMeter(spec.paper.k, DEFAULT_F0_N)
    meter.add(before, after)
    chain = ", ".join(step.name for step in spec.chain) or "no filter"
    title = f"frame {middle + 1} of {len(medium)} for {prepared.device.name}, before and after {chain}"
    changed = f"{100 * meter.mask_violation_share:.1f} % of voxels changed by more than the mask"
    mask, names = (meter.k, meter.f0_n), ("before", "after", "change")
    draw_comparison(Path(path), before, after, f"{title}\n{changed}", medium.axes, mask, names)


def _stages(prepared: Prepared, chain: tuple[FieldFilter, ...]) -> Callable[[int], list[ForceField]]:
    """``stages(i)``: frame i as the device renders it, and after each filter; objects are filtered alone."""
    force_max_n, medium, scene = prepared.device.force_max_n, prepared.medium, prepared.objects
    if scene is not None:
        media = [filter_objects(scene, chain[:n]).voxelise() for n in range(len(chain) + 1)]
        return lambda i: [stage_medium[i] for stage_medium in media]

    def of_voxels(i: int) -> list[ForceField]:
        field = medium[i]
        stages = [limit_forces(field, force_max_n)]
        for step in chain:
            field = step(field)
            stages.append(limit_forces(field, force_max_n))
        return stages

    return of_voxels


class _StageMeter:
    """Statistics of one stage over the frames."""

    def __init__(self, name: str, spec: EncodeSpec) -> None:
        self.name, self.meter, self.counter = name, FidelityMeter(spec.paper.k, DEFAULT_F0_N), SymbolCounter()
        self.support = self.voxels = 0
        self.energy, self.top_n = 0.0, 0.0

    def add(self, before: ForceField, field: ForceField, symbols: Any) -> None:
        self.meter.add(before, field)
        self.counter.add(symbols, field.grid.voxel_count)
        squares = np.einsum("...c,...c->...", field.forces_n, field.forces_n, dtype=np.float64)
        self.energy += float(squares.sum())
        self.top_n = max(self.top_n, float(np.sqrt(squares.max(initial=0.0))))
        self.support += field.support_count
        self.voxels = field.grid.voxel_count

    def row(self) -> dict[str, Any]:
        bits = self.counter.voxel_bits
        return {
            "stage": self.name,
            "supported_voxels": self.support,
            "rms_n": float(np.sqrt(self.energy / max(1, self.support))),
            "greatest_n": self.top_n,
            "entropy_voxel_bits": bits,
            "entropy_object_bits": self.counter.object_bits,
            "entropy_bits_per_frame": bits * self.voxels,
            "nmse_db": self.meter.nmse_db,
            "mask_violation_share": self.meter.mask_violation_share,
        }
