"""Writes a medium as a NumPy ``.npz`` with dense arrays, for other programs, and reads such files.

Arrays: ``forces_n`` float32 [frame, nx, ny, nz, 3], ``origin_m`` and ``spacing_m`` float64 [3], ``rate_hz``,
``axes``, ``tags`` (joined by commas), ``friction``, ``damping_n_s_per_m`` and, if the placement is known,
``mapping_scale`` and ``mapping_offset_m``: x_hand = mapping_scale (x_scene - mapping_offset_m). Provenance is
not stored. ``numpy.load`` reads the file. Both directions work slab by slab, so that not even one dense frame
is in memory at once.

An archive (a zip of ``.npy`` entries, NEP 1) is opened with care: nothing is unpickled, the header of an
entry must agree with the entry's size before anything is allocated, and every fault is a `SourceError`.
"""

from __future__ import annotations

import math
import struct
import threading
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float32s
from touchfield.atomic import atomic_path
from touchfield.compute.threads import Progress, silent
from touchfield.errors import SourceError, TouchfieldError, as_source_error
from touchfield.files import file_error, readable, require_plain
from touchfield.medium.field import ForceField
from touchfield.medium.grid import BRICK, Grid
from touchfield.medium.medium import HapticMedium

DEFLATE_LEVEL: Final = (
    1  # a twentieth of the bytes for a field with 3 % force; level 6 gains little for its time
)
SINGLE_FRAME_RATE_HZ: Final = 30.0
_DEFAULTS: Final[dict[str, float | str]] = {
    "axes": "x, y, z",
    "friction": 0.0,
    "damping_n_s_per_m": 0.0,
    "tags": "direct",
}
_SMALL_BYTES: Final = 1 << 16

DEFLATE_LIMIT: Final = 1100  # above the largest expansion of deflate, 1032

_FAULTS = (
    OSError, ValueError, EOFError, KeyError, IndexError, RuntimeError, OverflowError, MemoryError, TypeError,
    SyntaxError, struct.error, zlib.error, zipfile.BadZipFile, tokenize.TokenError,
)  # fmt: skip
"""Errors that zipfile and numpy.lib.format raise for invalid bytes, found by fuzzing.

RuntimeError is raised for encrypted entries.
"""


def write_npz(
    path: str | Path,
    medium: HapticMedium,
    report: Progress = silent,
    attributes: Mapping[str, Sequence[float]] = MappingProxyType({}),
) -> None:
    """Write a medium; the file appears when it is complete.

    report : callable; called as ``report(written, frames)`` after each frame.
    attributes : mapping of str to numbers; further arrays, such as ``mapping_scale`` and
        ``mapping_offset_m``.
    Raises `InvalidArgument` if the folder does not exist; `SourceError` if the file cannot be written.
    """
    small = {"origin_m": np.array(medium.grid.origin_m), "spacing_m": np.array(medium.grid.spacing_m)}
    for name, value in {**medium.metadata, "tags": ",".join(medium.tags)}.items():
        small[name] = np.array(value if isinstance(value, str) else float(value))
    small |= {name: np.array(values, np.float64) for name, values in attributes.items()}
    with atomic_path(Path(path)) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, value in small.items():
            with archive.open(_entry(name), "w") as stream:
                np.lib.format.write_array(stream, value, (1, 0))
        with archive.open(_entry("forces_n"), "w", force_zip64=True) as stream:
            header = {"descr": "<f4", "fortran_order": False, "shape": (len(medium), *medium.grid.shape, 3)}
            np.lib.format.write_array_header_1_0(stream, header)
            for i, field in enumerate(medium):
                for slab in field.slabs(0):
                    stream.write(np.ascontiguousarray(slab, "<f4").data.cast("B"))
                report(i + 1, len(medium))


def _entry(name: str) -> zipfile.ZipInfo:
    """Return an entry without a date, so that equal media give equal bytes."""
    info = zipfile.ZipInfo(f"{name}.npy")
    info.compress_type = zipfile.ZIP_DEFLATED
    info._compresslevel = DEFLATE_LEVEL  # type: ignore[attr-defined]
    return info


def read_npz(path: str | Path, *, to_the_bit: bool = False) -> HapticMedium:
    """Open a medium; frames are read on access, fastest in ascending order.

    ``forces_n`` may have any number type, or be one frame [nx, ny, nz, 3]. `rate_hz` may be missing for a
    single frame; all other metadata but the grid may always be missing. With `to_the_bit`, bricks that
    contain only zeros but at least one -0.0 are kept as well. Raises `SourceError` if the file is not such an
    archive, is cut short or damaged, or (when a frame is read) a force is not finite.
    """
    archive = NpzArchive(Path(path))
    header = archive.header("forces_n")
    shape = (1, *header.shape) if len(header.shape) == 4 else header.shape
    where = f"{path}, array forces_n"
    if len(shape) != 5 or shape[4] != 3 or min(shape) < 1 or header.dtype.kind not in "fiu":
        raise SourceError(where, header.description, "numbers [frame, nx, ny, nz, 3], newtons")
    if header.is_fortran:
        raise SourceError(where, "Fortran order", "C order", "Save numpy.ascontiguousarray(forces_n).")
    with as_source_error(f"{path}, "):
        lattice: Any = [archive.numbers(name, 3) for name in ("spacing_m", "origin_m")]
        grid = Grid((shape[1], shape[2], shape[3]), *lattice)
        metadata = {name: _metadata_value(archive, name, value) for name, value in _DEFAULTS.items()}
        metadata["tags"] = tuple(filter(None, metadata["tags"].split(",")))
        rate = _metadata_value(archive, "rate_hz", SINGLE_FRAME_RATE_HZ if shape[0] == 1 else None)
        make = _Frames(archive, replace(header, shape=shape), grid, to_the_bit)
        return HapticMedium(grid, rate, shape[0], make, **metadata)


def _metadata_value(archive: NpzArchive, name: str, default: float | str | None) -> Any:
    """Return a number or a short string of an archive, or the default if it is missing."""
    if default is not None and name not in archive.names:
        return default
    if not isinstance(default, str):
        return archive.numbers(name, 1)[0]
    header = archive.header(name)
    if header.dtype.kind != "U" or header.shape != () or header.data_bytes > _SMALL_BYTES:
        raise SourceError(f"{archive.path}, array {name}", header.description, "one short string")
    return str(archive.read(name)[()])


class _Frames:
    """Reader of the frames of one compressed entry.

    Reading forwards continues the stream; reading backwards starts it again.
    """

    def __init__(self, archive: NpzArchive, header: ArrayHeader, grid: Grid, to_the_bit: bool) -> None:
        self._archive, self._header, self._grid, self._to_the_bit = archive, header, grid, to_the_bit
        self._lock = threading.Lock()  # several threads may request frames
        self._reading: Generator[ForceField | None, int, None] | None = None
        self._next = 0

    def __call__(self, index: int) -> ForceField:
        with self._lock:
            reading, self._reading = self._reading, None  # after an error no stream stays open
            if reading is None or index < self._next:
                reading = self._from_the_first()
                next(reading)
            field, self._next = reading.send(index), index + 1
            assert field is not None
            if self._next < self._header.shape[0]:
                self._reading = reading
            return field

    def _from_the_first(self) -> Generator[ForceField | None, int, None]:
        """Yield the field of each frame whose number is sent.

        Numbers must ascend. The first item, before any number was sent, is None.
        """
        size, at, field = self._header.data_bytes // self._header.shape[0], 0, None
        with self._archive.open("forces_n") as (_, stream):
            while True:
                index = yield field
                where, skip = f"{self._archive.path}, array forces_n, frame {index}", (index - at) * size
                while skip > 0:
                    skip -= len(read_exactly(stream, min(skip, 1 << 22), where))
                slabs, at = self._slabs(stream, where), index + 1
                field = ForceField.from_slabs(self._grid, slabs, to_the_bit=self._to_the_bit)

    def _slabs(self, stream: IO[bytes], where: str) -> Iterator[Float32s]:
        nx, ny, nz = self._grid.shape
        for first in range(0, nx, BRICK):
            depth = min(BRICK, nx - first)
            count = depth * ny * nz * 3
            data = read_exactly(stream, count * self._header.dtype.itemsize, where)
            with np.errstate(over="ignore", invalid="ignore"):
                slab = np.frombuffer(data, self._header.dtype).astype(np.float32).reshape(depth, ny, nz, 3)
            if not np.isfinite(slab).all():
                raise SourceError(where, "a force that is not finite", "finite newtons")
            yield slab


@dataclass(frozen=True)
class ArrayHeader:
    """The header of an ``.npy``."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]  # never object
    is_fortran: bool  # whether the first index runs fastest
    size_bytes: int  # size of the header itself

    @property
    def description(self) -> str:
        """Type and shape."""
        return f"{self.dtype} {list(self.shape)}"

    @property
    def data_bytes(self) -> int:
        """Size of the array in bytes."""
        return math.prod(self.shape) * self.dtype.itemsize


def read_npy_header(stream: IO[bytes], where: str) -> ArrayHeader:
    """Read the header of an ``.npy``; the stream then stands at the first value.

    Raises `SourceError` if the header is invalid, or declares pickled objects.
    """
    start = stream.tell()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an odd header is told as a fault, not as a warning
            version = np.lib.format.read_magic(stream)
            if version not in ((1, 0), (2, 0)):
                raise SourceError(where, f"an .npy of version {version}", "1.0 or 2.0")
            read = (
                np.lib.format.read_array_header_1_0
                if version == (1, 0)
                else np.lib.format.read_array_header_2_0
            )
            shape, fortran, dtype = read(stream)
    except _FAULTS as error:
        raise SourceError(where, f"a broken .npy header ({error})", "an array saved by NumPy") from error
    if dtype.hasobject:
        raise SourceError(
            where, "pickled objects", "plain numbers", "Save it as an array of one number type."
        )
    if any(n < 0 for n in shape):
        raise SourceError(where, f"the shape {shape}", "counts from 0")
    return ArrayHeader(tuple(int(n) for n in shape), dtype, bool(fortran), stream.tell() - start)


def map_npy(path: Path) -> NDArray[Any]:
    """Map the array of an ``.npy`` file into memory, without reading it.

    Raises `SourceError` if the file is not an ``.npy``, is cut short, or contains no numbers.
    """
    with readable(path):
        with path.open("rb") as stream:
            header = read_npy_header(stream, str(path))
        size, expected_size = path.stat().st_size, header.size_bytes + header.data_bytes
        if header.dtype.kind not in "fiu" or not header.data_bytes:
            raise SourceError(str(path), header.description, "numbers, at least one")
        if size != expected_size:
            found, expected = f"{header.description} in {size} bytes", f"numbers in {expected_size} bytes"
            raise SourceError(str(path), found, expected, "Copy it again.")
        order: Literal["C", "F"] = "F" if header.is_fortran else "C"
        return np.memmap(path, header.dtype, "r", header.size_bytes, header.shape, order)


class NpzArchive:
    """The entries of an ``.npz``; each call opens and closes the file.

    Raises `SourceError` if the file cannot be read or is not a zip archive.
    """

    def __init__(self, path: Path) -> None:
        require_plain(path, "a .npz file")
        self.path = path
        self._entries: dict[str, zipfile.ZipInfo] = {}
        with self.faults("its list of entries"), zipfile.ZipFile(path) as archive:
            for info in archive.infolist():
                if info.filename.endswith(".npy"):
                    self._entries[info.filename[:-4]] = info

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the arrays."""
        return tuple(self._entries)

    def header(self, name: str) -> ArrayHeader:
        """Return the header of one array, checked against the size of its entry."""
        with self.open(name) as (header, _):
            return header

    @contextmanager
    def open(self, name: str) -> Iterator[tuple[ArrayHeader, IO[bytes]]]:
        """Open an array: yield its header, and a stream at its first value."""
        where = f"{self.path}, array {name}"
        if name not in self._entries:
            raise SourceError(where, "nothing of that name", f"one of {', '.join(self.names) or '(none)'}")
        info = self._entries[name]
        require_plain_zip(info, where)
        with self.faults(name), zipfile.ZipFile(self.path) as archive, archive.open(info) as stream:
            header = read_npy_header(stream, where)
            claimed = header.size_bytes + header.data_bytes
            max_claimed = info.compress_size * (
                1 if info.compress_type == zipfile.ZIP_STORED else DEFLATE_LIMIT
            )
            if (
                claimed != info.file_size
                or claimed > max_claimed
                or info.compress_size > self.path.stat().st_size
            ):
                found = f"{info.file_size} bytes for {header.description}"
                raise SourceError(where, found, f"{claimed} bytes", "The file is cut short or damaged.")
            yield header, stream

    def read(self, name: str) -> NDArray[Any]:
        """Read a whole array."""
        with self.open(name) as (header, stream):
            data = read_exactly(stream, header.data_bytes, f"{self.path}, array {name}")
            order = "F" if header.is_fortran else "C"
            values: NDArray[Any] = np.frombuffer(data, header.dtype).reshape(header.shape, order=order)  # type: ignore[call-overload]
            return values

    def numbers(self, name: str, count: int) -> list[float]:
        """Read an array of `count` finite numbers."""
        header, where = self.header(name), f"{self.path}, array {name}"
        if header.dtype.kind not in "fiu" or math.prod(header.shape) != count:
            raise SourceError(where, header.description, f"{count} number{'s' * (count != 1)}")
        values = self.read(name).astype(np.float64).ravel()
        if not np.isfinite(values).all():
            raise SourceError(where, f"{values.tolist()}", "finite numbers")
        return [float(v) for v in values]

    @contextmanager
    def faults(self, part: str) -> Iterator[None]:
        """Convert the errors that zipfile and numpy raise for invalid bytes to `SourceError`."""
        try:
            yield
        except TouchfieldError:
            raise
        except FileNotFoundError as error:
            raise file_error(self.path, error, "a .npz of NumPy") from error
        except _FAULTS as error:
            found = f"bytes at fault ({error or type(error).__name__})"
            raise SourceError(f"{self.path}, {part}", found, "a whole .npz of NumPy") from error


def require_plain_zip(member: zipfile.ZipInfo, where: str) -> None:
    """Raise `SourceError` unless a member of an archive is stored or deflated.

    A member compressed by LZMA or bzip2 expands more, and states how much memory its decoder takes.
    """
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        found = f"{member.filename[:80]!r}, compressed by method {member.compress_type} of zip"
        raise SourceError(where, found, "an archive that is deflated, method 8", "Save it again.")


def read_exactly(stream: IO[bytes], count: int, where: str) -> bytes:
    """Read `count` bytes of `stream`.

    Raises `SourceError` if it ends earlier.
    """
    data = stream.read(count)
    if len(data) != count:
        raise SourceError(where, f"{len(data)} bytes", f"{count} bytes", "The file is cut short.")
    return data
