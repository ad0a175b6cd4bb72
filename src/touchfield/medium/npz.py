"""A medium as a NumPy ``.npz``: the plain, dense way out and in, for other programs.

Arrays: ``forces_n`` float32 [frame, nx, ny, nz, 3], ``origin_m`` and ``spacing_m`` float64 [3], ``rate_hz``,
``axes``, ``tags`` (joined by commas), ``friction``, ``damping_n_s_per_m``, and where it is known the mapping,
x_hand = ``mapping_scale`` (x_scene - ``mapping_offset_m``). Provenance stays behind. ``numpy.load``
reads it as it is. Both ways go slab by slab, so that not even one dense frame is held at once.
"""

from __future__ import annotations

import io
import threading
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import IO, TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import InvalidArgument, SourceError
from touchfield.medium.atomic import atomic_path
from touchfield.medium.field import ForceField
from touchfield.medium.grid import BRICK, Grid
from touchfield.medium.medium import HapticMedium
from touchfield.medium.npz_archive import ArrayHeader, NpzArchive, read_exactly

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["read_npz", "write_npz"]

DEFLATE_LEVEL: Final = 1
"""Of a field that is 3 % force, level 1 writes a twentieth of the bytes; level 6 takes longer for little."""

SINGLE_FRAME_RATE_HZ: Final = 30.0
_SMALL_BYTES: Final = 1 << 16


def write_npz(
    path: str | Path,
    medium: HapticMedium,
    progress: Callable[[int], None] | None = None,
    told: Mapping[str, Sequence[float]] = MappingProxyType({}),
) -> None:
    """Write all frames; the file appears when it is whole.

    Parameters
    ----------
    progress : callable, optional; Called with the number of frames written, after each.
    told : mapping of str to numbers; What else is to be told, an array each: where the scene lies, ``mapping_scale``
        and ``mapping_offset_m``.

    Raises `InvalidArgument` if the folder is not there; `SourceError` if the system refuses to write.
    """
    small: dict[str, NDArray[Any]] = {
        "origin_m": np.array(medium.grid.origin_m),
        "spacing_m": np.array(medium.grid.spacing_m),
        "rate_hz": np.array(float(medium.rate_hz)),
        "axes": np.array(medium.axes),
        "tags": np.array(",".join(medium.tags)),
        "friction": np.array(float(medium.friction)),
        "damping_n_s_per_m": np.array(float(medium.damping_n_s_per_m)),
        **{name: np.array(values, np.float64) for name, values in told.items()},
    }
    with atomic_path(Path(path)) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, value in small.items():
            with archive.open(_entry(name), "w") as stream:
                _header(stream, value.dtype.str, value.shape)
                stream.write(value.tobytes())
        with archive.open(_entry("forces_n"), "w", force_zip64=True) as stream:
            _header(stream, "<f4", (len(medium), *medium.grid.shape, 3))
            for i, field in enumerate(medium):
                for slab in field.slabs(0):
                    stream.write(np.ascontiguousarray(slab, "<f4").data.cast("B"))
                if progress is not None:
                    progress(i + 1)


def _entry(name: str) -> zipfile.ZipInfo:
    """An entry without a date, so that equal media give equal bytes."""
    info = zipfile.ZipInfo(f"{name}.npy")
    info.compress_type = zipfile.ZIP_DEFLATED
    info._compresslevel = DEFLATE_LEVEL  # type: ignore[attr-defined]
    return info


def _header(stream: IO[bytes], descr: str, shape: tuple[int, ...]) -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": descr, "fortran_order": False, "shape": shape})
    stream.write(header.getvalue())


def read_npz(path: str | Path, *, to_the_bit: bool = False) -> HapticMedium:
    """Open a medium; its frames are read when they are asked for, quickest in ascending order.

    ``forces_n`` may also be of another number type, or one frame [nx, ny, nz, 3]; `rate_hz` may be absent from
    a single frame, and the rest beside the grid from any. With `to_the_bit` a brick of nothing but -0.0, which is no
    force, is kept as well.

    Raises `SourceError` if the file is not such an archive, is cut short or damaged, or (when a frame is read) a
    force is not finite.
    """
    archive = NpzArchive(Path(path))
    header = archive.header("forces_n")
    shape = (1, *header.shape) if len(header.shape) == 4 else header.shape
    where = f"{path}, array forces_n"
    if len(shape) != 5 or shape[4] != 3 or min(shape) < 1 or header.dtype.kind not in "fiu":
        found = f"{header.dtype} {list(header.shape)}"
        raise SourceError(where, found, "numbers [frame, nx, ny, nz, 3], newtons")
    if header.is_fortran:
        raise SourceError(where, "Fortran order", "C order", "Save numpy.ascontiguousarray(forces_n).")
    try:
        grid = Grid((shape[1], shape[2], shape[3]), _triple(archive, "spacing_m"), _triple(archive, "origin_m"))
        return HapticMedium(
            grid,
            rate_hz=_scalar(archive, "rate_hz", SINGLE_FRAME_RATE_HZ if shape[0] == 1 else None),
            frame_count=shape[0],
            make_frame=_Frames(archive, replace(header, shape=shape), grid, to_the_bit),
            axes=_text(archive, "axes", "x, y, z"),
            friction=_scalar(archive, "friction", 0.0),
            damping_n_s_per_m=_scalar(archive, "damping_n_s_per_m", 0.0),
            tags=tuple(filter(None, _text(archive, "tags", "direct").split(","))),
        )
    except InvalidArgument as error:
        raise SourceError(f"{path}, {error.where}", error.found, error.expected, error.mend) from error


def _triple(archive: NpzArchive, name: str) -> tuple[float, float, float]:
    x, y, z = archive.numbers(name, 3)
    return (x, y, z)


def _scalar(archive: NpzArchive, name: str, default: float | None) -> float:
    if default is not None and name not in archive.names:
        return default
    return archive.numbers(name, 1)[0]


def _text(archive: NpzArchive, name: str, default: str) -> str:
    if name not in archive.names:
        return default
    header = archive.header(name)
    if header.dtype.kind != "U" or header.shape != () or header.data_bytes > _SMALL_BYTES:
        found = f"{header.dtype} {list(header.shape)}"
        raise SourceError(f"{archive.path}, array {name}", found, "one short string")
    return str(archive.read(name)[()])


class _Frames:
    """Reads frames out of one compressed entry: onwards without a restart, backwards with one."""

    def __init__(self, archive: NpzArchive, header: ArrayHeader, grid: Grid, to_the_bit: bool) -> None:
        self._archive, self._header, self._grid, self._to_the_bit = archive, header, grid, to_the_bit
        self._frame_bytes = header.data_bytes // header.shape[0]
        self._lock = threading.Lock()  # frames may be asked for from several threads
        self._open = ExitStack()
        self._stream: IO[bytes] | None = None
        self._next = 0

    def __call__(self, index: int) -> ForceField:
        with self._lock:
            field = None
            try:
                field = self._read(index)
            finally:
                if field is None or self._next == self._header.shape[0]:
                    self._close()
            return field

    def _read(self, index: int) -> ForceField:
        if self._stream is None or index < self._next:
            self._close()
            _, self._stream = self._open.enter_context(self._archive.open("forces_n"))
        where = f"{self._archive.path}, array forces_n, frame {index}"
        skip = (index - self._next) * self._frame_bytes
        with self._archive.faults("forces_n"):
            while skip > 0:
                skip -= len(read_exactly(self._stream, min(skip, 1 << 22), where))
            field = ForceField.from_slabs(self._grid, self._slabs(where), to_the_bit=self._to_the_bit)
        self._next = index + 1
        return field

    def _slabs(self, where: str) -> Iterator[NDArray[np.float32]]:
        assert self._stream is not None
        nx, ny, nz = self._grid.shape
        for first in range(0, nx, BRICK):
            depth = min(BRICK, nx - first)
            count = depth * ny * nz * 3
            data = read_exactly(self._stream, count * self._header.dtype.itemsize, where)
            with np.errstate(over="ignore", invalid="ignore"):
                slab = np.frombuffer(data, self._header.dtype).astype(np.float32).reshape(depth, ny, nz, 3)
            if not np.isfinite(slab).all():
                raise SourceError(where, "a force that is not finite", "finite newtons")
            yield slab

    def _close(self) -> None:
        self._open.close()
        self._stream, self._next = None, 0
