"""One huge lattice as a zarr store: tiles of whole bricks, each made, filtered and coded without the others.

source -> mapping -> tile of the lattice -> device filter -> coder `touch` (a codec of zarr) -> shard

A worker opens the source itself, makes the field of its tile with the rim that the low-pass needs, and writes
one shard. Nothing is as large as the lattice: a tile has at most 256^3 samples, and is made in blocks of
128^3.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from touchfield._version import __version__
from touchfield.codec.segment import bound_keys
from touchfield.codec.touch.spec import CODER, TouchSpec
from touchfield.compute.executors import in_order
from touchfield.compute.threads import Report, silent
from touchfield.errors import InvalidArgument, require_ending, warn_unbounded
from touchfield.medium import Grid
from touchfield.medium.stores.zarr_store import boxes, create, whole_folder, write_box
from touchfield.pipeline.encoding import Encoded
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.segments import ALONE, name_of, path_of, prepared_here
from touchfield.pipeline.spec import EncodeSpec

_MADE: Final = 128  # samples an axis of what is made at once: the lattice before the low-pass is finer


class Tile(NamedTuple):
    """A part of a frame to be made: its first sample and its shape."""

    job: str
    source: str
    spec: EncodeSpec
    store: str
    frame: int
    low: tuple[int, int, int]
    shape: tuple[int, int, int]
    version: str = __version__

    @property
    def place(self) -> str:
        """Frame and first sample, in words."""
        return ",".join(map(str, (self.frame, *self.low)))


@dataclass(frozen=True, repr=False)
class Tiled(Encoded):
    """The result of `encode_tiles`; of its bound no voxel is named, as chunks are coded by zarr."""

    tiles: int = 0

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        told = {"coder": "touch, a codec of zarr", "k": self.prepared.spec.k, "f0_n": self.prepared.spec.f0_n}
        names = ("tiles", "file_bytes", "supported_voxels", "encode_s")
        return {
            **self.prepared.summary(),
            **told,
            **self.bound,
            **{name: getattr(self, name) for name in names},
        }


def encode_tiles(
    source: str | Path, out: Path, spec: EncodeSpec, report: Report = silent, executor: Executor | None = None
) -> Tiled:
    """Write a source as a zarr store whose chunks are of coder `touch`, tile by tile.

    The folder appears when it is whole; after an error the tiles that are written stay in ``OUT.parts``, and
    the same call goes on from there. InvalidArgument if what is asked needs more than a tile knows: haptic
    filters, vibration, another coder, an array of actuators.
    """
    began = time.perf_counter()
    require_ending(out, "OUT.zarr")
    asked = replace(spec, representation="voxel")
    path, prepared = path_of(source), prepare(source, asked)
    for found, is_asked in (
        ("a haptic filter", bool(spec.chain)),
        ("a vibration", spec.vibration is not None),
        (f"coder {spec.coder}", spec.coder != "touch"),
        ("spatial masking", spec.touch.masking > 0),
        (f"mode {spec.touch.mode}", spec.touch.mode == "lossless"),
        ("an array of actuators", prepared.device.is_array),
        ("a source that is a stream", prepared.source is None),
    ):
        if is_asked:
            raise InvalidArgument(str(out), found, "a scene for a point device, as it is", "Write OUT.touch.")
    medium = prepared.medium
    settings = {key: getattr(spec.touch, key) for key in ("k", "f0_n", "mode", "effort")}
    settings["spacing_m"] = list(medium.grid.spacing_m)
    codec = {"name": "touchfield.touch", "configuration": settings}
    parts = list(boxes(medium.grid))
    total = len(medium) * len(parts)
    with whole_folder(out, is_kept=True) as store:
        job = name_of(path, asked.to_json(), medium.grid.words)
        finished = _Finished(store, job)
        if not finished.counts:
            create(store, medium, prepared.placement.told(), codec)
        before = len(finished.counts)
        root, places = str(store.resolve()), product(range(len(medium)), parts)
        every = (Tile(job, path, asked, root, frame, *part) for frame, part in places)
        left = [tile for tile in every if tile.place not in finished.counts]
        made = map(make_tile, left) if executor is None else in_order(make_tile, left, executor=executor)
        for tile, (count, ratio) in zip(left, made, strict=True):
            finished.add(tile.place, count, ratio)
            report(len(finished.counts) * len(medium) // total, len(medium))
        supported, ratios = sum(finished.counts.values()), list(finished.ratios.values())
        finished.forget()
    bound = _bound(spec.touch, ratios)
    warn_unbounded(bound.get("error_bound_note"))
    notes = (f"{before} of {total} tiles were there from an earlier run",) if before else ()
    size = sum(file.stat().st_size for file in out.rglob("*") if file.is_file())
    return Tiled(prepared, size, time.perf_counter() - began, supported, notes, bound=bound, tiles=total)


def _bound(spec: TouchSpec, ratios: Sequence[float | None]) -> dict[str, Any]:
    """Keys of the error bound of a store, of the largest ratio of each tile."""
    known = [ratio for ratio in ratios if ratio is not None]
    largest = max(known, default=0.0) if len(known) == len(ratios) else None
    promise = {"promise_kept": None if largest is None else largest <= 1, "worst_mask_ratio": largest}
    return {**bound_keys(CODER.bound_rule(spec), promise), **promise}


class _Finished:
    """Tiles that are written, a line each in a file; those of another job go.

    A line has the place, the samples with a force, and the largest error in units of the bound; "-" if not
    known.
    """

    def __init__(self, store: Path, job: str) -> None:
        self._file = store.with_name(f"{store.name}.txt")
        self.counts: dict[str, int] = {}
        self.ratios: dict[str, float | None] = {}
        text = self._file.read_text("utf-8") if self._file.is_file() and store.is_dir() else ""
        *lines, _ = text.split("\n")  # the last line of a run that was killed may be cut
        for line in lines[1:] if lines[:1] == [job] else ():
            place, *figures = line.split(" ")
            if len(figures) == 2 and figures[0].isdigit():  # of two figures a cut line has one
                self.counts[place], self.ratios[place] = int(figures[0]), _ratio(figures[1])
        if not self.counts:
            shutil.rmtree(store, ignore_errors=True)
        self._file.write_text("".join(f"{line}\n" for line in (job, *map(self._line, self.counts))))

    def add(self, place: str, count: int, ratio: float | None) -> None:
        self.counts[place], self.ratios[place] = count, ratio
        with self._file.open("a", encoding="utf-8") as stream:
            stream.write(f"{self._line(place)}\n")

    def _line(self, place: str) -> str:
        ratio = self.ratios[place]
        return f"{place} {self.counts[place]} {'-' if ratio is None else repr(ratio)}"

    def forget(self) -> None:
        self._file.unlink()


def _ratio(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def make_tile(tile: Tile) -> tuple[int, float | None]:
    """Make, code and write a tile, in whichever process this is.

    Returns how many of its samples hold a force, and the largest error in units of the bound; None where none
    is known. A tile without a force, of which nothing is written, has no error.
    """
    from touchfield.codec.zarr_codec import recorded_ratios  # needs zarr

    with ALONE:
        prepared = prepared_here(tile.job, tile.source, tile.spec, tile.version)
        scene, mapping = prepared.source, prepared.mapping
        assert scene is not None and mapping is not None  # or it would have been refused
        forces, supported = np.zeros((*tile.shape, 3), np.float32), 0
        for first in product(*(range(0, n, _MADE) for n in tile.shape)):
            shape = tuple(min(_MADE, n - a) for a, n in zip(first, tile.shape))
            low = [a + b for a, b in zip(tile.low, first)]
            part = Grid(shape, mapping.grid.spacing_m, tuple(mapping.grid.to_m(low).tolist()))  # type: ignore[arg-type]
            field = replace(mapping, grid=part).medium(scene)[tile.frame]
            if field.support_count:
                forces[tuple(slice(a, a + n) for a, n in zip(first, shape))] = field.to_dense()
                supported += field.support_count
        with recorded_ratios() as ratios:
            write_box(tile.store, tile.frame, tile.low, forces)
        if None in ratios or (supported and not ratios):
            return supported, None
        return supported, max((ratio for ratio in ratios if ratio is not None), default=0.0)
