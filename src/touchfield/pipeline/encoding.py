"""medium -> coder -> segments -> file: the encoding half of figure 4, on all cores and in order."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from touchfield._version import __version__
from touchfield.codec.objects.encoder import ObjectsEncoder
from touchfield.codec.registry import coder, field_encoder
from touchfield.codec.segment import compression_ratio
from touchfield.compute.threads import Report, silent
from touchfield.container import TouchWriter
from touchfield.container.remote import is_remote, sender
from touchfield.errors import InvalidArgument, require_ending, warn_unbounded
from touchfield.medium import Grid
from touchfield.pipeline.decoded_objects import write_objects
from touchfield.pipeline.decoding import FILTERED, open_stream
from touchfield.pipeline.preparation import Prepared, Source, as_source, is_stream, prepare
from touchfield.pipeline.segments import (
    coded_segments,
    groups_of,
    head_of,
    lost_notes,
    path_of,
    spread_voxels,
    stretches,
    written,
)
from touchfield.pipeline.spec import DEFAULT_F0_N, EncodeSpec


@dataclass(frozen=True)
class Encoded:
    """The result of `encode`; of objects, the supported voxels are the samples of their own fields, coded
    once each.

    `told` are notes about the coding, and `search` what `encode_to_target` adds to the summary. `bound` tells
    the error bound that the written file states (`OpenStream.error_bound`).
    """

    prepared: Prepared
    file_bytes: int
    encode_s: float
    supported_voxels: int
    told: tuple[str, ...] = ()
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
        notes = (*self.prepared.notes, *self.prepared.learnt, *self.told)
        if self.supported_voxels:
            return notes
        return (*notes, "Nothing can be felt: no sample holds a force (--nw, --mapping, --thickness-m)")

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        medium, spec, bits = self.prepared.medium, self.prepared.spec, 8 * self.file_bytes
        return {
            **self.prepared.summary(),
            "coder": spec.coder,
            **coder(spec.coder).summary(spec.coding),
            **({"promise_against": self.prepared.reference} if coder(spec.coder).has_promise else {}),
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
    report: Report = silent,
    *,
    grid: Grid | None = None,
    executor: Executor | None = None,
) -> Encoded:
    """Turn a source into a ``.touch`` file.

    A path, a scene, a medium, a field or an array: a medium and a field keep their lattice and forces; an
    array of newtons [nx, ny, nz, 3] or, at 30 frames a second, [frame, nx, ny, nz, 3] is one on `grid`.
    `report` gets ``(done, total)`` in frames. With `executor`, any of `concurrent.futures`, its workers open
    a path and code stretches of its frames; the bytes are the same. What they finished before an error stays
    in ``OUT.parts``, and the same call goes on from there. `out` may lie in a store of objects (``s3://...``,
    extra ``remote``): the file is made as ``NAME.unsent`` in the working folder, sent as a whole, and
    removed; it stays there if it cannot be sent. TouchfieldError if anything is at fault; nothing is then
    left under the name `out`.
    """
    began = time.perf_counter()
    spec = spec or EncodeSpec()
    if not (isinstance(out, str | Path) and isinstance(spec, EncodeSpec)):
        raise InvalidArgument(
            "out, spec", f"{out!r:.80}, a {type(spec).__name__}", "a path and an EncodeSpec"
        )
    require_ending(out, "OUT.touch", mend="A field is written by `write_field`.")
    send, here = (sender(str(out)), Path(f"{Path(out).name}.unsent")) if is_remote(out) else (None, Path(out))
    scene = as_source(source, spec.device, grid)
    prepared = prepare(scene, spec)
    story = provenance_of(scene, prepared)
    if executor is None or prepared.scene is not None:
        done = encode_prepared(prepared, here, story, report)
        if executor is not None:
            done = replace(done, told=("Objects take one process: no worker was asked",))
    else:
        supported, notes = spread_voxels(here, path_of(source), prepared, story, executor, report)
        done = Encoded(prepared, here.stat().st_size, 0.0, supported, notes, bound=bound_of(here))
    done = replace(done, encode_s=time.perf_counter() - began)
    if send is not None:
        send(here)
        here.unlink()
    return done


def encode_prepared(
    prepared: Prepared, out: str | Path, provenance: Mapping[str, str], report: Report = silent
) -> Encoded:
    """Write what `prepare` made as a ``.touch`` file, coded as its spec says; the bytes are the same on any
    machine.

    TouchfieldError if anything is at fault; nothing is then left under the name `out`.
    """
    began, lost = time.perf_counter(), 0
    if prepared.source is not None:
        prepared.source.report = report
    with TouchWriter(Path(out)) as writer:
        if prepared.scene is not None:
            floor_n = prepared.spec.f0_n or DEFAULT_F0_N  # poses need some
            objects = ObjectsEncoder(prepared.scene, prepared.coding, floor_n)
            writer.write_head(head_of(prepared, objects), provenance)
            write_objects(writer, objects, len(prepared.scene), report)
            supported = objects.supported
        else:
            medium, spec, ready, done, supported = prepared.medium, prepared.spec, 0, 0, 0

            def tell(count: int) -> None:
                nonlocal ready
                ready = count
                report(
                    (ready + done) // 2, len(medium)
                )  # a frame is done half when made, and half when coded

            encoder = field_encoder(medium.grid, prepared.coding)
            writer.write_head(head_of(prepared, encoder), provenance)
            groups = (
                groups_of(medium, spec, encoder, *one, tell) for one in stretches(medium, spec, encoder)
            )
            coded = coded_segments(encoder, medium.vibration is not None, chain.from_iterable(groups))
            for one in written(writer, coded):
                done, supported, lost = done + one.frames, supported + one.supported, lost + one.lost
                tell(ready)
    size, notes = Path(out).stat().st_size, lost_notes(prepared, lost)
    bound = bound_of(out)
    return Encoded(prepared, size, time.perf_counter() - began, supported, notes, bound=bound)


def bound_of(path: str | Path) -> dict[str, Any]:
    """Keys of the error bound that a file states (`OpenStream.error_bound`); nothing is decoded.

    Warns with `UnboundedError` if it states none.
    """
    with open_stream(path) as opened:
        bound = opened.error_bound()
    warn_unbounded(bound.get("error_bound_note"))
    return bound


def provenance_of(source: Source, prepared: Prepared) -> dict[str, str]:
    """The file's account of where it comes from."""
    name = str(source) if isinstance(source, str | Path) else "scene"
    spec = prepared.spec.to_json(prepared.has_law)
    told = os.fsencode(Path(name).name).decode("utf-8", "replace")  # a name may be any bytes
    told = re.sub(r"[\0-\x1f\x7f-\x9f]", "\N{REPLACEMENT CHARACTER}", told)
    said = {"touchfield": __version__, "source": told[:255], "spec": spec}
    if prepared.reference != FILTERED:
        said["reference"] = prepared.reference
    was = (prepared.scene or prepared.medium).provenance
    for key in ("source", "spec") if is_stream(source) else ():
        if key in was:  # what was decoded has a history of its own
            said[f"source.{key}"] = was[key]
    return said
