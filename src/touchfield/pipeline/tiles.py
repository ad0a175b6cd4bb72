"""Encodes a lattice too large for memory as a zarr store: cuts it into tiles, and makes, filters and codes
each tile on its own.

source -> mapping -> tile of the lattice -> device filter -> coder `touch` (a codec of zarr) -> shard

A worker opens the source itself, makes the field of its tile with the margin that the low-pass needs, and
writes one shard. No array is as large as the lattice: a tile has at most 256^3 samples, and is made in blocks
of 128^3.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from touchfield._version import __version__
from touchfield.codec.segment import bound_keys
from touchfield.codec.touch.spec import CODER, TouchSpec
from touchfield.compute.executor_kinds import TaskExecutor, require_executor
from touchfield.compute.executors import in_order
from touchfield.compute.threads import Progress, silent
from touchfield.container.remote import folder_sender, is_remote
from touchfield.errors import InvalidArgument, SourceError, require_ending, warn_unbounded
from touchfield.filters.device_filter import device_medium
from touchfield.medium import Grid
from touchfield.medium.stores.zarr_store import atomic_folder, boxes, create, write_box
from touchfield.pipeline.empty_result import refuse_empty
from touchfield.pipeline.encoding import Encoded
from touchfield.pipeline.preparation import Prepared, prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.pipeline.workers import ENCODING_LOCK, job_name, prepare_once, worker_path

_BLOCK_SAMPLES: Final = 128  # samples per axis of a block: the lattice before the low-pass is finer


class Tile(NamedTuple):
    """A tile to be encoded, its first sample and its shape; `job` identifies its store (`job_name`)."""

    job: str
    source: str
    spec: EncodeSpec
    store: str
    frame: int
    low: tuple[int, int, int]
    shape: tuple[int, int, int]
    version: str = __version__

    @property
    def key(self) -> str:
        """Frame and first sample, as text."""
        return ",".join(map(str, (self.frame, *self.low)))


@dataclass(frozen=True, repr=False)
class Tiled(Encoded):
    """The result of `encode_tiles`; its error bound names no voxel, as zarr codes the chunks."""

    tiles: int = 0

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        spec = self.prepared.spec
        return {
            **self.prepared.summary(),
            "coder": "touch, a codec of zarr",
            "k": spec.k,
            "f0_n": spec.f0_n,
            **self.bound,
            "tiles": self.tiles,
            "file_bytes": self.file_bytes,
            "supported_voxels": self.supported_voxels,
            "encode_s": self.encode_s,
        }


def encode_tiles(
    source: str | Path,
    out: str | Path,
    spec: EncodeSpec,
    report: Progress = silent,
    executor: TaskExecutor | None = None,
) -> Tiled:
    """Write a source as a zarr store whose chunks are of coder `touch`, tile by tile.

    The folder appears once it is complete. After an error the tiles written so far stay in ``OUT.parts``, and
    the same call continues from there. `out` may be in an object store (``s3://...``, extra ``remote``): the
    store is written as the folder ``NAME.unsent`` in the working folder, uploaded, its metadata last, and
    removed; it stays there if the upload fails. InvalidArgument for options that need more than one tile:
    haptic filters, vibration, another coder, an array of actuators.
    """
    require_executor(executor)
    require_ending(out, "OUT.zarr")
    if not is_remote(out):
        return _encode_folder(source, Path(out), spec, report, executor)
    send, folder = folder_sender(str(out), "zarr.json"), Path(f"{Path(out).name}.unsent")
    tiled = _encode_folder(source, folder, spec, report, executor)
    send(folder)
    shutil.rmtree(folder)
    return tiled


def _encode_folder(
    source: str | Path, out: Path, spec: EncodeSpec, report: Progress, executor: TaskExecutor | None
) -> Tiled:
    """Write a source as the folder of a store, tile by tile."""
    start_s = time.perf_counter()
    voxel_spec = replace(spec, representation="voxel")
    path, prepared = worker_path(source), prepare(source, voxel_spec)
    _require_independent_tiles(spec, prepared, out)
    medium = prepared.medium
    settings = {key: getattr(spec.touch, key) for key in ("k", "f0_n", "mode", "effort")}
    settings["spacing_m"] = list(medium.grid.spacing_m)
    codec = {"name": "touchfield.touch", "configuration": settings}
    parts = list(boxes(medium.grid))
    total = len(medium) * len(parts)
    with atomic_folder(out, keep=True) as store:
        job = job_name(path, voxel_spec.to_json(), medium.grid.description)
        finished = _FinishedTiles(store, job)
        if not finished.counts:
            create(store, medium, prepared.placement.to_dict(), codec)
        before = len(finished.counts)
        root, tile_indices = str(store.resolve()), product(range(len(medium)), parts)
        tiles = (Tile(job, path, voxel_spec, root, frame, *part) for frame, part in tile_indices)
        pending = [tile for tile in tiles if tile.key not in finished.counts]
        if executor is None:
            results: Iterator[tuple[int, float | None]] = map(make_tile, pending)
        else:
            results = in_order(make_tile, pending, executor=executor)
        for tile, (count, ratio) in zip(pending, results, strict=True):
            finished.add(tile.key, count, ratio)
            report(len(finished.counts) * len(medium) // total, len(medium))
        supported, ratios = sum(finished.counts.values()), list(finished.ratios.values())
        finished.forget()
        try:
            refuse_empty(prepared, supported)
        except SourceError:
            shutil.rmtree(store)
            raise
    bound = _error_bound(spec.touch, ratios)
    warn_unbounded(bound.get("error_bound_note"))
    notes = (f"{before} of {total} tiles were there from an earlier run",) if before else ()
    size = sum(file.stat().st_size for file in out.rglob("*") if file.is_file())
    return Tiled(prepared, size, time.perf_counter() - start_s, supported, notes, bound=bound, tiles=total)


def _require_independent_tiles(spec: EncodeSpec, prepared: Prepared, out: Path) -> None:
    """InvalidArgument for an option that needs more than one tile."""
    for found, is_requested in (
        ("a haptic filter", bool(spec.chain)),
        ("a vibration", spec.vibration is not None),
        (f"coder {spec.coder}", spec.coder != "touch"),
        ("spatial masking", spec.touch.masking > 0),
        ("a Weber fraction by force", bool(spec.touch.k_by_force)),
        (f"mode {spec.touch.mode}", spec.touch.mode == "lossless"),
        ("an array of actuators", prepared.device.is_array),
        ("a source that is a stream", prepared.source is None),
    ):
        if is_requested:
            raise InvalidArgument(str(out), found, "a scene for a point device, as it is", "Write OUT.touch.")


def _error_bound(spec: TouchSpec, ratios: Sequence[float | None]) -> dict[str, Any]:
    """Keys of the error bound of a store, from the largest ratio of each tile (None: not known)."""
    known_ratios = [ratio for ratio in ratios if ratio is not None]
    largest = max(known_ratios, default=0.0) if len(known_ratios) == len(ratios) else None
    max_error = {"promise_kept": None if largest is None else largest <= 1, "worst_mask_ratio": largest}
    return {**bound_keys(CODER.bound_rule(spec), max_error), **max_error}


class _FinishedTiles:
    """The tiles written so far, as lines of a text file; tiles of another job are deleted.

    A line has the tile's key, its number of samples with a force, and its largest error in units of the
    bound, "-" if not known.
    """

    def __init__(self, store: Path, job: str) -> None:
        self._file = store.with_name(f"{store.name}.txt")
        self.counts: dict[str, int] = {}
        self.ratios: dict[str, float | None] = {}
        text = self._file.read_text("utf-8") if self._file.is_file() and store.is_dir() else ""
        *lines, _ = text.split("\n")  # the last line of a run that was killed may be cut
        for line in lines[1:] if lines[:1] == [job] else ():
            key, *figures = line.split(" ")
            if len(figures) == 2 and figures[0].isdigit():  # of two figures a cut line has one
                self.counts[key], self.ratios[key] = int(figures[0]), _ratio(figures[1])
        if not self.counts:
            shutil.rmtree(store, ignore_errors=True)
        self._file.write_text("".join(f"{line}\n" for line in (job, *map(self._line, self.counts))))

    def add(self, key: str, count: int, ratio: float | None) -> None:
        self.counts[key], self.ratios[key] = count, ratio
        with self._file.open("a", encoding="utf-8") as stream:
            stream.write(f"{self._line(key)}\n")

    def _line(self, key: str) -> str:
        ratio = self.ratios[key]
        return f"{key} {self.counts[key]} {'-' if ratio is None else repr(ratio)}"

    def forget(self) -> None:
        self._file.unlink()


def _ratio(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def make_tile(tile: Tile) -> tuple[int, float | None]:
    """Make, encode and write a tile, in this process; run by a worker.

    Returns the number of its samples with a force, and its largest error in units of the bound, None if that
    is not known. A tile without a force is not written, and has no error.
    """
    from touchfield.codec.zarr_codec import recorded_ratios  # needs zarr

    with ENCODING_LOCK:
        prepared = prepare_once(tile.job, tile.source, tile.spec, tile.version)
        scene, mapping = prepared.source, prepared.mapping
        assert scene is not None and mapping is not None  # checked by `encode_tiles`
        forces, supported = np.zeros((*tile.shape, 3), np.float32), 0
        for first in product(*(range(0, n, _BLOCK_SAMPLES) for n in tile.shape)):
            shape = tuple(min(_BLOCK_SAMPLES, n - a) for a, n in zip(first, tile.shape))
            low = [a + b for a, b in zip(tile.low, first)]
            part = Grid(shape, mapping.grid.spacing_m, tuple(mapping.grid.to_m(low).tolist()))  # type: ignore[arg-type]
            field = device_medium(scene, replace(mapping, grid=part))[tile.frame]
            if field.support_count:
                forces[tuple(slice(a, a + n) for a, n in zip(first, shape))] = field.to_dense()
                supported += field.support_count
        with recorded_ratios() as ratios:
            write_box(tile.store, tile.frame, tile.low, forces)
        if None in ratios or (supported and not ratios):
            return supported, None
        return supported, max((ratio for ratio in ratios if ratio is not None), default=0.0)
