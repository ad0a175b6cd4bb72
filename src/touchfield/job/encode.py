"""medium -> coder -> segments -> file: the encoding half of figure 4, on all cores and in order."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from touchfield._version import __version__
from touchfield.codec.objects.encoder import ObjectsEncoder
from touchfield.codec.rate import compression_ratio
from touchfield.codec.registry import AnchoringEncoder, FieldEncoder, coder, field_encoder
from touchfield.codec.vibration import encode_vibration
from touchfield.container import Head, TouchWriter
from touchfield.job.prepare import Prepared, prepare
from touchfield.job.spec import DEFAULT_F0_N, FILTERED, EncodeSpec, Report, silent
from touchfield.job.stream_scene import Source, as_source, is_stream
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.parallel import worker_count
from touchfield.sources.scene import Scene
from touchfield.stream.objects import write_objects

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from touchfield.medium.vibration import VibrationFrame

    Group = tuple[list[ForceField], list[VibrationFrame], ForceField | None]
    """The frames of one segment; what vibrates in each, none where the medium does not vibrate; and an anchor."""

__all__ = ["Encoded", "encode", "encode_prepared", "in_order", "provenance_of"]

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST_BYTES_HELD = 1 << 27
"""A segment ends once its fields take more memory than this: eight of the largest are coded at a time."""

MOST_BYTES_UNDER_WAY = 1 << 30
"""No further segment is begun while the fields of those that are being coded take more."""


@dataclass(frozen=True)
class Encoded:
    """The result of `encode`; of objects, the supported voxels are the samples of their own fields, coded once each.

    `told` are notes about the coding, and `search` what `encode_to_target` adds to the summary.
    """

    prepared: Prepared
    file_bytes: int
    encode_s: float
    supported_voxels: int
    told: tuple[str, ...] = ()
    search: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<Encoded: {self.file_bytes:,} bytes by coder {self.prepared.spec.coder} of {self.prepared.medium!r}>"

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user."""
        notes = (*self.prepared.notes, *self.prepared.learnt, *self.told)
        if self.supported_voxels:
            return notes
        return (*notes, "Nothing can be felt: no sample holds a force (--nw, --mapping)")

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        medium, spec = self.prepared.medium, self.prepared.spec
        bits = 8 * self.file_bytes
        return {
            **self.prepared.summary(),
            "coder": spec.coder,
            **coder(spec.coder).summary(spec.coding),
            **({"promise_against": self.prepared.reference} if coder(spec.coder).has_promise else {}),
            "k": spec.k,
            "f0_n": spec.f0_n,
            "file_bytes": self.file_bytes,
            "supported_voxels": self.supported_voxels,
            "bits_per_supported_voxel": bits / self.supported_voxels if self.supported_voxels else None,
            "cr_full": compression_ratio(bits, len(medium), medium.grid.voxel_count),
            "encode_s": self.encode_s,
            **self.search,
        }


def encode(
    source: Source | ArrayLike,
    out: str | Path,
    spec: EncodeSpec | None = None,
    report: Report = silent,
    *,
    grid: Grid | None = None,
) -> Encoded:
    """Turn a source into a ``.touch`` file.

    A path, a scene, a medium, a field or an array: a medium and a field keep their lattice and forces; an array of
    newtons [nx, ny, nz, 3] or, at 30 frames a second, [frame, nx, ny, nz, 3] is one on `grid`. `report` gets
    ``(done, total)`` in frames.

    TouchfieldError if anything is at fault; nothing is then left under the name `out`.
    """
    began = time.perf_counter()
    spec = spec or EncodeSpec()
    given = as_source(source, spec.device, grid)
    prepared = prepare(given, spec)
    done = encode_prepared(prepared, out, provenance_of(given, prepared), report)
    return replace(done, encode_s=time.perf_counter() - began)


def encode_prepared(
    prepared: Prepared, out: str | Path, provenance: Mapping[str, str], report: Report = silent
) -> Encoded:
    """Write what `prepare` made as a ``.touch`` file, coded as its spec says; the bytes are the same on any machine.

    TouchfieldError if anything is at fault; nothing is then left under the name `out`.
    """
    began = time.perf_counter()
    if prepared.source is not None:
        prepared.source.report = report
    with TouchWriter(Path(out)) as writer:
        if prepared.scene is None:
            supported = _write_voxels(writer, prepared, provenance, report)
        else:
            floor_n = prepared.spec.f0_n or DEFAULT_F0_N  # poses need some
            encoder = ObjectsEncoder(prepared.scene, prepared.coding, floor_n)
            writer.write_head(head_of(prepared, encoder), provenance)
            write_objects(writer, encoder, len(prepared.scene), report)
            supported = encoder.supported
    return Encoded(prepared, Path(out).stat().st_size, time.perf_counter() - began, supported)


def _write_voxels(writer: TouchWriter, prepared: Prepared, provenance: Mapping[str, str], report: Report) -> int:
    """The voxel representation, head and segments; how many samples hold a force."""
    medium = prepared.medium
    encoder = field_encoder(medium.grid, prepared.coding)
    vibrates = medium.vibration is not None
    writer.write_head(head_of(prepared, encoder), provenance)
    ready = written = supported = 0

    def tell(count: int) -> None:
        nonlocal ready
        ready = count
        report((ready + written) // 2, len(medium))  # a frame is done half when it is made, and half when it is coded

    def coded(group: Group) -> tuple[bytes, bytes, int, int]:
        frames, band, anchor = group
        beside = encode_vibration(band) if vibrates else b""
        if isinstance(encoder, AnchoringEncoder):
            segment = encoder.encode_segment(frames, anchor)
        else:
            segment = encoder.encode_segment(frames)
        return segment.body, beside, len(frames), sum(f.support_count for f in frames)

    def weight(group: Group) -> int:
        return sum(frame.forces_n.nbytes for frame in group[0])

    groups = _segments(medium, prepared.spec, encoder, tell)
    for body, beside, count, voxels in in_order(coded, groups, weight, MOST_BYTES_UNDER_WAY):
        if vibrates:
            writer.write_vibration(written, count, beside)
        writer.write_segment(written, count, body)
        written, supported = written + count, supported + voxels
        tell(ready)
    return supported


def provenance_of(source: str | Path | Scene, prepared: Prepared) -> dict[str, str]:
    """The file's account of where it comes from."""
    name = "scene" if isinstance(source, Scene) else str(source)
    said = {"touchfield": __version__, "source": Path(name).name[:255], "spec": prepared.spec.to_json()}
    if prepared.reference != FILTERED:
        said["reference"] = prepared.reference
    was = (prepared.scene or prepared.medium).provenance
    for key in ("source", "spec") if is_stream(source) else ():
        if key in was:  # what was decoded has a history of its own
            said[f"source.{key}"] = was[key]
    return said


def _segments(
    medium: HapticMedium, spec: EncodeSpec, encoder: FieldEncoder, tell: Callable[[int], None]
) -> Iterator[Group]:
    """The frames in groups, each small enough to be held in memory while it is coded.

    A frame that is the very one before does not count to a segment's length, up to that of a world that stands. Such
    a world has an anchor, the field that a segment is to begin with.
    """
    length, longest = spec.segment_frames_at(medium.rate_hz), spec.longest_segment_at(medium.rate_hz)
    frames: list[ForceField] = []
    band: list[VibrationFrame] = []
    anchor: ForceField | None = None
    size = counted = 0
    for i, frame in enumerate(medium):
        if not frames or frame is not frames[-1]:
            counted += 1
            size += frame.forces_n.nbytes
        frames.append(frame)
        if medium.vibration is not None:
            band.append(medium.vibration[i])
        tell(i + 1)
        is_full = counted == length or len(frames) == longest or size > MOST_BYTES_HELD
        if is_full or i + 1 == len(medium):
            if isinstance(encoder, AnchoringEncoder):
                anchor = encoder.anchor(frames[0], anchor)
            yield frames, band, anchor
            frames, band, size, counted = [], [], 0, 0


def head_of(prepared: Prepared, encoder: FieldEncoder | ObjectsEncoder) -> Head:
    """The head of what was prepared, as it is coded."""
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
        weber_fraction=prepared.spec.k,
        force_threshold_n=prepared.spec.f0_n,
        friction=medium.friction,
        damping_n_s_per_m=medium.damping_n_s_per_m,
        tags=medium.tags,
        coder=encoder.name,
        coder_parameters=encoder.parameters,
    )


def in_order(
    work: Callable[[Item], Result],
    items: Iterable[Item],
    weight: Callable[[Item], int] = lambda _: 0,
    most_weight: int = 0,
) -> Iterator[Result]:
    """``work(item)`` of each item in threads, the results in the order of the items.

    The items are drawn by the caller's thread, one at a time and only as there is room: at most one more than there
    are workers is under way, and no second one while their weights, for example their bytes, exceed `most_weight` (0:
    any). With one worker everything happens in the caller's thread. The first error, in the order of the items, ends
    it; what was not begun is left. `work` gains where it releases the interpreter's lock.
    """
    workers = worker_count()
    if workers == 1:
        for item in items:
            yield work(item)
        return
    pool = ThreadPoolExecutor(workers, thread_name_prefix="touchfield-job")
    waiting: deque[tuple[Future[Result], int]] = deque()
    under_way = 0
    try:
        for item in items:
            own = weight(item)
            while waiting and (len(waiting) > workers or (most_weight and under_way + own > most_weight)):
                first, size = waiting.popleft()
                yield first.result()
                under_way -= size
            waiting.append((pool.submit(work, item), own))
            under_way += own
            del item
            while waiting and waiting[0][0].done():
                first, size = waiting.popleft()
                yield first.result()
                under_way -= size
        while waiting:
            yield waiting.popleft()[0].result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
