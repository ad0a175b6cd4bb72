"""`encode`: turns a source into a ``.touch`` file, the encoding half of the paper's figure 4. It prepares the
medium, codes its segments and writes them."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from touchfield.codec.objects.encoder import ObjectsEncoder
from touchfield.codec.objects.layout import CodedObject
from touchfield.codec.registry import coder
from touchfield.codec.segment import compression_ratio
from touchfield.compute.executor_kinds import TaskExecutor, require_executor
from touchfield.compute.threads import Progress, silent
from touchfield.container import ObjectRecord, TouchWriter
from touchfield.container.remote import is_remote, sender
from touchfield.errors import InvalidArgument, require_ending, warn_unbounded
from touchfield.medium import Grid
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.empty_result import refuse_empty
from touchfield.pipeline.preparation import Prepared, prepare
from touchfield.pipeline.provenance import file_provenance
from touchfield.pipeline.segments import file_head, silent_frame_notes, write_voxels
from touchfield.pipeline.source import Source
from touchfield.pipeline.spec import DEFAULT_F0_N, EncodeSpec, spec_with
from touchfield.pipeline.workers import encode_with_workers, worker_path


@dataclass(frozen=True)
class Encoded:
    """The result of `encode`.

    `supported_voxels` counts the samples with a force; of objects those of their own fields, which are coded
    once each. `coding_notes` are notes on the coding; `search` has the keys that `encode_to_target` adds to
    the summary; `bound` has the keys of the error bound that the file states (`OpenStream.error_bound`).
    """

    prepared: Prepared
    file_bytes: int
    encode_s: float
    supported_voxels: int
    coding_notes: tuple[str, ...] = ()
    search: Mapping[str, Any] = field(default_factory=dict)
    bound: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        return (
            f"<Encoded: {self.file_bytes:,} bytes by coder {self.prepared.spec.coder} of "
            f"{self.prepared.medium!r}>"
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user."""
        notes = (*self.prepared.notes, *self.prepared.learnt, *self.coding_notes)
        if self.supported_voxels or self.prepared.medium.vibration is not None:
            return notes
        return (*notes, "The result is empty: no sample has a force.")

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        medium, spec, bits = self.prepared.medium, self.prepared.spec, 8 * self.file_bytes
        return {
            **self.prepared.summary(),
            "coder": spec.coder,
            **coder(spec.coder).summary(spec.coding),
            **({"promise_against": self.prepared.reference} if coder(spec.coder).has_error_bound else {}),
            "k": spec.k,
            "f0_n": spec.f0_n,
            **self.bound,
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
    report: Progress = silent,
    *,
    grid: Grid | None = None,
    executor: TaskExecutor | None = None,
    **options: Any,
) -> Encoded:
    """Turn a source into a ``.touch`` file.

    `options` are options of `spec` by name: ``encode(source, out, nw=6, k=0.2)``.

    `source` is a path, a scene, a medium, a field or an array. A medium and a field keep their lattice and
    forces. An array has newtons on `grid`: [nx, ny, nz, 3], or [frame, nx, ny, nz, 3] at 30 frames a second.
    `report` gets ``(done, total)`` in frames. With `executor`, any object with `submit` (as in
    `concurrent.futures`) or `map`, its workers open the path and code ranges of its frames; the bytes are the
    same. The parts that they finished before an error stay in ``OUT.parts``, and the same call continues from
    there. `out` may be in an object store (``s3://...``, extra ``remote``): the file is written as
    ``NAME.unsent`` in the working folder, uploaded as a whole, and removed; it stays there if the upload
    fails. Raises TouchfieldError, also if nothing in the result can be felt and `spec` does not allow that;
    no file `out` is then left.
    """
    start_s = time.perf_counter()
    if not (isinstance(out, str | Path) and isinstance(spec, EncodeSpec | None)):
        raise InvalidArgument(
            "out, spec", f"{out!r:.80}, a {type(spec).__name__}", "a path and an EncodeSpec"
        )
    spec = spec_with(spec, options)
    require_executor(executor)
    require_ending(out, "OUT.touch", hint="A field is written by `write_field`.")
    send = sender(str(out)) if is_remote(out) else None
    local_path = Path(out) if send is None else Path(f"{Path(out).name}.unsent")
    prepared = prepare(source, spec, grid)
    provenance = file_provenance(source, prepared)
    if executor is None or prepared.objects is not None:
        encoded = encode_prepared(prepared, local_path, provenance, report, may_be_empty=False)
        if executor is not None:
            encoded = replace(encoded, coding_notes=("Objects are coded in one process, without workers.",))
    else:
        path = worker_path(source)
        supported, notes = encode_with_workers(local_path, path, prepared, provenance, executor, report)
        size, bound = local_path.stat().st_size, file_error_bound(local_path)
        notes += decoded_notes(prepared, local_path)
        encoded = Encoded(prepared, size, 0.0, supported, notes, bound=bound)
    encoded = replace(encoded, encode_s=time.perf_counter() - start_s)
    if send is not None:
        send(local_path)
        local_path.unlink()
    return encoded


def encode_prepared(
    prepared: Prepared,
    out: str | Path,
    provenance: Mapping[str, str],
    report: Progress = silent,
    *,
    may_be_empty: bool = True,
) -> Encoded:
    """Write a prepared source as a ``.touch`` file, coded by its spec.

    The bytes are the same on any machine. `may_be_empty` False refuses a result in which nothing can be felt.
    Raises TouchfieldError; no file `out` is then left.
    """
    start_s = time.perf_counter()
    if prepared.source is not None:
        prepared.source.report = report
    silent_frames = 0
    with TouchWriter(Path(out)) as writer:
        if prepared.objects is not None:
            supported = _write_scene(writer, prepared, provenance, report)
        else:
            supported, silent_frames = write_voxels(writer, prepared, provenance, report)
        if not may_be_empty:
            refuse_empty(prepared, supported, silent_frames)
    notes = silent_frame_notes(prepared, silent_frames)
    size, bound = Path(out).stat().st_size, file_error_bound(out)
    notes += decoded_notes(prepared, out)
    if grip_note := getattr(prepared.coding, "grip_note", ""):
        notes += (grip_note,)
    return Encoded(prepared, size, time.perf_counter() - start_s, supported, notes, bound=bound)


def _write_scene(
    writer: TouchWriter, prepared: Prepared, provenance: Mapping[str, str], report: Progress
) -> int:
    """Write the head and the objects of a scene; the number of supported samples."""
    assert prepared.objects is not None
    floor_n = prepared.spec.f0_n or DEFAULT_F0_N  # poses need a threshold above 0
    objects = ObjectsEncoder(prepared.objects, prepared.coding, floor_n)
    writer.write_head(file_head(prepared, objects), provenance)
    write_objects(writer, objects, len(prepared.objects), report)
    return objects.supported


def write_objects(
    writer: TouchWriter, encoder: ObjectsEncoder, frame_count: int, report: Progress = silent
) -> None:
    """Write the objects and all segments of a scene, after the head."""
    for coded in encoder.objects():
        writer.write_object(record_of(coded))
    for start, count, body in encoder.segments():
        writer.write_segment(start, count, body)
        report(start + count, frame_count)


def record_of(coded: CodedObject) -> ObjectRecord:
    """An object as the container writes it."""
    values, grid = {**vars(coded), "is_deforming": int(coded.is_deforming)}, coded.grid
    del values["grid"]
    return ObjectRecord(grid_shape=grid.shape, spacing_m=grid.spacing_m, origin_m=grid.origin_m, **values)


def decoded_notes(prepared: Prepared, path: str | Path) -> tuple[str, ...]:
    """Notes of the source on a written file (`Scene.decoded_notes`); none for an array of actuators."""
    source, to_hand = prepared.source, prepared.placement.to_hand
    if source is None or prepared.device.is_array or not source.has_decoded_notes:
        return ()
    with open_file(path) as opened:
        return source.decoded_notes(opened.medium[0], to_hand, prepared.device.force_max_n)


def file_error_bound(path: str | Path) -> dict[str, Any]:
    """Keys of the error bound that a file states (`OpenStream.error_bound`); no frame is decoded.

    Warns with `UnboundedError` if it states none.
    """
    with open_file(path) as opened:
        bound = opened.error_bound()
    warn_unbounded(bound.get("error_bound_note"))
    return bound
