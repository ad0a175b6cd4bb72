"""Writes and reads a medium as a zarr version 3 store, for programs that read parts of it.

Chunks consist of whole bricks and are grouped in shards. The group has attributes (the lattice, the rate,
other metadata), the array ``forces_n`` float32 [t, x, y, z, component], and the coordinates ``t`` in seconds
and ``x``, ``y``, ``z`` in metres, float64. Levels of detail are ``forces_n_1``, ``forces_n_2``, ..., whose
lattices the attribute ``multiscales`` describes, as in OME-NGFF, and the coordinates ``x_1``, ``x_2``, .... A
chunk without a force is not written. Chunks are compressed by zstd, or by another codec such as the coder
`touch` (`touchfield.codec.zarr_codec`). A shard is one file, the unit of writing.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float32s, Float64s
from touchfield.compute.threads import Progress, silent
from touchfield.errors import InvalidArgument, SourceError, import_extra
from touchfield.files import is_remote, without_secret
from touchfield.medium.field import ForceField
from touchfield.medium.grid import BRICK, Grid
from touchfield.medium.medium import HapticMedium

Box = tuple[tuple[int, int, int], tuple[int, int, int]]
"""First sample and shape of a part of a lattice."""

ARRAY: Final = "forces_n"
_AXES: Final = (
    {"name": "t", "type": "time", "unit": "second"},
    *({"name": axis, "type": "space", "unit": "meter"} for axis in "xyz"),
    {"name": "component", "type": "channel"},
)
_CHUNK: Final = 128
_SHARD: Final = 256
_MAX_CHUNK_BYTES: Final = 1 << 28
_MAX_FRAMES: Final = 1 << 24
_MAX_TEXT: Final = 1 << 16
_CODECS: Final = frozenset(
    {"sharding_indexed", "bytes", "transpose", "crc32c", "zstd", "gzip", "blosc", "touchfield.touch"}
)
"""Codecs that an untrusted store may use; it must not select other codecs that are installed."""


def _zarr() -> Any:
    return import_extra("zarr", "a zarr store", "zarr", "zarr")


def _chunks(grid: Grid) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the samples of a chunk and of a shard along each axis.

    Both are whole bricks, and no larger than the lattice needs.
    """
    chunk = tuple(min(_CHUNK, BRICK * -(-n // BRICK)) for n in grid.shape)
    return chunk, tuple(c * -(-min(_SHARD, n) // c) for c, n in zip(chunk, grid.shape))


def boxes(grid: Grid) -> Iterator[Box]:
    """Yield the parts of a lattice that can be written independently, one shard each."""
    _, shard = _chunks(grid)
    for low in product(*(range(0, n, s) for n, s in zip(grid.shape, shard))):
        shape = tuple(min(s, n - a) for s, n, a in zip(shard, grid.shape, low))
        yield low, shape  # type: ignore[misc]


def create(
    store: str | Path,
    medium: HapticMedium,
    attributes: Mapping[str, Any],
    codec: Mapping[str, Any] | None,
    levels: Sequence[HapticMedium] = (),
) -> None:
    """Create a store without forces.

    `codec` is the name and configuration of the chunk codec; None selects zstd.
    """
    zarr, grid = _zarr(), medium.grid
    about = {
        "spacing_m": list(grid.spacing_m),
        "origin_m": list(grid.origin_m),
        **medium.metadata,
        "tags": list(medium.tags),
        **attributes,
    }
    datasets = [_level(level_medium, n) for n, level_medium in enumerate((medium, *levels))]
    scales = [{"name": ARRAY, "type": "level of detail", "axes": list(_AXES), "datasets": datasets}]
    group = zarr.create_group(store, zarr_format=3, attributes={"touchfield": about, "multiscales": scales})
    coding = {"serializer": dict(codec), "compressors": None} if codec else {}
    _write_coordinate(group, "t", "time", "s", np.arange(len(medium)) / medium.rate_hz)
    for level, level_medium in enumerate((medium, *levels)):
        for axis, name in enumerate(_level_axes(level)):
            _write_coordinate(group, name, "distance", "m", level_medium.grid.axis_m(axis))
        chunk, shard = _chunks(level_medium.grid)
        group.create_array(
            _level_name(level),
            shape=(len(level_medium), *level_medium.grid.shape, 3),
            chunks=(1, *chunk, 3),
            shards=(1, *shard, 3),
            dtype="float32",
            fill_value=0.0,
            dimension_names=["t", *_level_axes(level), "component"],
            attributes={"units": "N", "long_name": "force on the hand", "components": list("xyz")},
            **coding,
        )


def _write_coordinate(group: Any, name: str, quantity: str, unit: str, values: Float64s) -> None:
    """Write the values of a dimension, in one chunk."""
    attributes = {"units": unit, "long_name": quantity}
    array = group.create_array(
        name,
        shape=values.shape,
        chunks=values.shape,
        dtype="float64",
        fill_value=np.nan,  # of a coordinate that is lost
        dimension_names=[name],
        attributes=attributes,
    )
    array[:] = values


def _level_axes(level: int) -> list[str]:
    """Return the names of a level's axes, which are those of its coordinates."""
    return [f"{axis}_{level}" if level else axis for axis in "xyz"]


def _level_name(level: int) -> str:
    return f"{ARRAY}_{level}" if level else ARRAY


def _level(medium: HapticMedium, level: int) -> dict[str, Any]:
    """Return the path of a level, and its scale and translation in seconds and metres."""
    grid = medium.grid
    scale = {"type": "scale", "scale": [1 / medium.rate_hz, *grid.spacing_m, 1.0]}
    translation = {"type": "translation", "translation": [0.0, *grid.origin_m, 0.0]}
    return {"path": _level_name(level), "coordinateTransformations": [scale, translation]}


def write_box(store: str | Path, frame: int, low: Sequence[int], forces_n: Float32s, level: int = 0) -> None:
    """Write the forces of one of `boxes`, newtons [nx, ny, nz, 3].

    `low` is the index of its first sample. A box without a force is not written.
    """
    if forces_n.any():
        array = _zarr().open_array(store, path=_level_name(level), mode="r+")
        array[(frame, *(slice(a, a + n) for a, n in zip(low, forces_n.shape)))] = forces_n


def write_zarr(
    path: str | Path,
    medium: HapticMedium,
    report: Progress = silent,
    attributes: Mapping[str, Any] = MappingProxyType({}),
    levels: Sequence[HapticMedium] = (),
) -> None:
    """Write a medium, compressed by zstd; the folder appears when it is complete.

    report : callable; called as ``report(written, frames)`` after each frame.
    levels : coarser media of the same frames, written as levels of detail.
    attributes : mapping of str to JSON values; further attributes.
    Raises `MissingExtra` without zarr; `InvalidArgument` if `path` exists; `SourceError` if the store cannot
    be written.
    """
    with atomic_folder(Path(path)) as store:
        create(store, medium, attributes, None, levels)
        parts = [list(boxes(level_medium.grid)) for level_medium in (medium, *levels)]
        for i in range(len(medium)):
            for n, level_medium in enumerate((medium, *levels)):
                field = level_medium[i]
                for low, shape in parts[n]:
                    write_box(store, i, low, cut(field, low, shape).to_dense(), n)
            report(i + 1, len(medium))


@contextmanager
def atomic_folder(path: Path, keep: bool = False) -> Iterator[Path]:
    """Yield a folder ``PATH.parts`` that is renamed to PATH at the end.

    On error it is removed unless `keep`.
    """
    _zarr()  # before anything is written
    if path.exists():
        raise InvalidArgument(
            str(path), "something there already", "a new name", "Remove it, or take another name."
        )
    partial = path.with_name(f"{path.name}.parts")
    if not keep:
        shutil.rmtree(partial, ignore_errors=True)
    try:
        yield partial
        partial.rename(path)
    except OSError as error:
        raise SourceError(str(path), f"that it cannot be written: {error.strerror or error}") from error
    finally:
        if not keep:
            shutil.rmtree(partial, ignore_errors=True)


def cut(field: ForceField, low: Sequence[int], shape: tuple[int, int, int]) -> ForceField:
    """Return the part of a field that starts at sample `low`, the first of a brick."""
    first, count = np.asarray(low) // BRICK, -(-np.asarray(shape) // BRICK)
    is_inside = ((field.bricks >= first) & (field.bricks < first + count)).all(axis=1)
    grid = Grid(shape, field.grid.spacing_m, tuple(field.grid.to_m(low).tolist()))
    return ForceField(grid, (field.bricks[is_inside] - first).astype(np.int32), field.forces_n[is_inside])


def read_zarr(path: str | Path) -> HapticMedium:
    """Open a store that `write_zarr` or `touchfield encode` wrote, by its path or address (``s3://...``).

    Frames are read on access; of a store at an address only the chunks of a frame, by range requests.
    Raises `MissingExtra` without zarr, or without obstore for an address; `SourceError` if it is not such a
    store, or (when a frame is read) a chunk is damaged.
    """
    zarr, opened = _zarr(), _Opened(path)
    about, (shape, chunk) = opened.metadata("zarr.json").get("attributes"), _layout(opened)
    about = about.get("touchfield") if isinstance(about, dict) else None
    if not isinstance(about, dict):
        raise SourceError(opened.name, "a zarr store of something else", "one with the attribute touchfield")
    try:
        grid = Grid((shape[1], shape[2], shape[3]), tuple(about["spacing_m"]), tuple(about["origin_m"]))
        array = zarr.open_array(opened.store, path=ARRAY, mode="r")
        return HapticMedium(
            grid,
            float(about["rate_hz"]),
            shape[0],
            lambda i: _frame(array, i, grid, chunk, opened.name),
            axes=str(about["axes"])[:_MAX_TEXT],
            tags=tuple(str(tag) for tag in about["tags"])[:8],
            friction=float(about["friction"]),
            damping_n_s_per_m=float(about["damping_n_s_per_m"]),
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        found = f"values that cannot be used ({error})"
        raise SourceError(f"{opened.name}, attribute touchfield", found, "what touchfield writes") from None


class _Opened:
    """A store in a folder, or at an address of an object store.

    name : str; for messages, without a secret.
    store : what zarr opens, read-only.
    """

    def __init__(self, path: str | Path) -> None:
        self._path, self._objects = Path(path), None
        self.name, self.store = str(path), str(path)
        if is_remote(path):
            self.name = without_secret(str(path))
            self._obstore = import_extra("obstore", self.name, "obstore", "remote")
            with self._translated_errors():
                self._objects = self._obstore.store.from_url(str(path))
            self.store = _zarr().storage.ObjectStore(self._objects, read_only=True)

    def metadata(self, file: str) -> dict[str, Any]:
        """Read a file of metadata, at most `_MAX_TEXT` bytes of JSON."""
        where = f"{self.name}/{file}"
        with self._translated_errors():
            data = self._head(file)
        if len(data) > _MAX_TEXT:
            raise SourceError(where, f"more than {_MAX_TEXT} bytes", f"at most {_MAX_TEXT}")
        try:
            members = json.loads(data.decode("utf-8"))
        except (ValueError, RecursionError) as error:
            found = f"that it cannot be read ({error})"
            raise SourceError(where, found, "a zarr store, version 3") from None
        if not isinstance(members, dict) or members.get("zarr_format") != 3:
            raise SourceError(where, "another format", "zarr, version 3")
        return members

    def _head(self, file: str) -> bytes:
        """The first bytes of a file, one more than metadata may have."""
        if self._objects is None:
            with (self._path / file).open("rb") as stream:
                return stream.read(_MAX_TEXT + 1)
        answer = self._obstore.get(self._objects, file, options={"range": (0, _MAX_TEXT + 1)})
        return bytes(answer.bytes())

    @contextmanager
    def _translated_errors(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # errors of the system, of obstore and of each kind of store
            found = f"that it cannot be read ({str(error).partition(chr(10))[0][:200]})"
            raise SourceError(self.name, found, "a zarr store, version 3") from None


def _layout(opened: _Opened) -> tuple[list[int], list[int]]:
    """Read the shape and chunks of the array, checked before anything is allocated.

    The store is untrusted input.
    """
    about, where = opened.metadata(f"{ARRAY}/zarr.json"), f"{opened.name}, array {ARRAY}"
    try:
        shape = [int(n) for n in about["shape"]]
        chunk = [int(n) for n in about["chunk_grid"]["configuration"]["chunk_shape"]]
        codecs = list(_names(about["codecs"]))
        inner = [c for c in about["codecs"] if c["name"] == "sharding_indexed"]
        chunk = [int(n) for n in inner[0]["configuration"]["chunk_shape"]] if inner else chunk
        kind = str(about["data_type"])
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError, IndexError) as error:
        raise SourceError(
            where, f"metadata that cannot be used ({error!r})", "a zarr array, version 3"
        ) from None
    if kind not in ("float32", "float64") or len(shape) != 5 or shape[4] != 3 or min(shape) < 1:
        raise SourceError(where, f"{kind} {shape}", "float32 [t, x, y, z, 3], newtons")
    if len(chunk) != 5 or min(chunk) < 1 or chunk[4] != 3 or shape[0] > _MAX_FRAMES:
        raise SourceError(where, f"chunks {chunk}", "chunks of whole forces")
    if 8 * math.prod(chunk) > _MAX_CHUNK_BYTES:
        raise SourceError(where, f"chunks of {chunk} samples", f"at most {_MAX_CHUNK_BYTES >> 20} MiB each")
    strange = [name for name in codecs if name not in _CODECS]
    if strange:
        raise SourceError(where, f"the codec {strange[0]!r}", f"one of {', '.join(sorted(_CODECS))}")
    return shape, chunk


def _names(codecs: Any) -> Iterator[str]:
    """Yield the names of codecs, including those within a shard."""
    for codec in codecs:
        yield str(codec["name"])
        inside = codec.get("configuration") or {}
        for key in ("codecs", "index_codecs"):
            yield from _names(inside.get(key) or ())


def _frame(array: Any, frame: int, grid: Grid, chunk: Sequence[int], name: str) -> ForceField:
    """Read a frame in slabs of chunks along x, each chunk by chunk."""

    def slab(x: int) -> Float32s:
        high = min(x + step, grid.shape[0])
        dense = np.zeros((high - x, *grid.shape[1:], 3), np.float32)
        for y, z in product(range(0, grid.shape[1], chunk[2]), range(0, grid.shape[2], chunk[3])):
            yz_slices = slice(y, y + chunk[2]), slice(z, z + chunk[3])
            dense[(slice(None), *yz_slices)] = array[(frame, slice(x, high), *yz_slices)]
        return dense

    step = -(-chunk[1] // BRICK) * BRICK
    try:
        return ForceField.from_slabs(grid, (slab(x) for x in range(0, grid.shape[0], step)))
    except InvalidArgument as error:
        raise SourceError(f"{name} frame {frame}", error.found, error.expected) from None
    except Exception as error:  # codecs raise any exception for a damaged chunk
        raise SourceError(f"{name} frame {frame}", f"a chunk that cannot be read ({error})"[:300]) from None
