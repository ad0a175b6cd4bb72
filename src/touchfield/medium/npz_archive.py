"""NumPy's ``.npz`` (a zip of ``.npy`` entries), opened with care.

Format: numpy.lib.format, NEP 1. Departures: nothing is unpickled, the header of an entry must agree with the
entry's size before anything is allocated, and every fault is a `SourceError`.
"""

from __future__ import annotations

import math
import struct
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final, Literal

import numpy as np

from touchfield.errors import SourceError, TouchfieldError
from touchfield.files import require_plain

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["ArrayHeader", "NpzArchive", "map_npy", "read_exactly", "read_npy_header"]

DEFLATE_LIMIT: Final = 1100
"""Deflate cannot expand by more than 1032; what claims more is not deflate."""

_FAULTS = (
    OSError, ValueError, EOFError, KeyError, IndexError, RuntimeError, OverflowError, MemoryError, TypeError,
    SyntaxError, struct.error, zlib.error, zipfile.BadZipFile, tokenize.TokenError,
)  # fmt: skip
"""Errors of zipfile and numpy.lib.format for bytes at fault (found by fuzzing); RuntimeError: encrypted."""


@dataclass(frozen=True)
class ArrayHeader:
    """The header of an ``.npy``."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]  # never of objects
    is_fortran: bool  # whether the first index runs fastest
    size_bytes: int  # of the header itself

    @property
    def data_bytes(self) -> int:
        """Bytes of the array itself."""
        return math.prod(self.shape) * self.dtype.itemsize


def read_npy_header(stream: IO[bytes], where: str) -> ArrayHeader:
    """Read the header of an ``.npy``; the stream then stands at the first value.

    Raises `SourceError` if it is no such header, or one of pickled objects.
    """
    begin = stream.tell()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an odd header is told as a fault, not as a warning
            version = np.lib.format.read_magic(stream)
            if version not in ((1, 0), (2, 0)):
                raise SourceError(where, f"an .npy of version {version}", "1.0 or 2.0")
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, fortran, dtype = read(stream)
    except _FAULTS as error:
        raise SourceError(where, f"a broken .npy header ({error})", "an array saved by NumPy") from error
    if dtype.hasobject:
        raise SourceError(where, "pickled objects", "plain numbers", "Save it as an array of one number type.")
    if any(n < 0 for n in shape):
        raise SourceError(where, f"the shape {shape}", "counts from 0")
    return ArrayHeader(tuple(int(n) for n in shape), dtype, bool(fortran), stream.tell() - begin)


def map_npy(path: Path) -> NDArray[Any]:
    """The numbers of a whole ``.npy`` file, mapped into memory and not read.

    Raises `SourceError` if it is no such file, is cut short, or holds something else than numbers.
    """
    try:
        with path.open("rb") as stream:
            header = read_npy_header(stream, str(path))
        size, whole = path.stat().st_size, header.size_bytes + header.data_bytes
        if header.dtype.kind not in "fiu" or size != whole or not header.data_bytes:
            found = f"{header.dtype} {list(header.shape)} in {size} bytes"
            raise SourceError(str(path), found, f"numbers in {whole} bytes", "Copy it again.")
        order: Literal["C", "F"] = "F" if header.is_fortran else "C"
        return np.memmap(path, header.dtype, "r", header.size_bytes, header.shape, order)
    except OSError as error:
        raise SourceError(str(path), f"that it cannot be read: {error.strerror}") from error


class NpzArchive:
    """The entries of an ``.npz``; each call opens the file anew, nothing is held open between calls.

    Raises `SourceError` if the file cannot be read or is no zip.
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
        """The header of one array, checked against what the archive holds for it."""
        with self.open(name) as (header, _):
            return header

    @contextmanager
    def open(self, name: str) -> Iterator[tuple[ArrayHeader, IO[bytes]]]:
        """One array's header, and a stream that stands at its first value."""
        where = f"{self.path}, array {name}"
        if name not in self._entries:
            raise SourceError(where, "nothing of that name", f"one of {', '.join(self.names) or '(none)'}")
        info = self._entries[name]
        with self.faults(name), zipfile.ZipFile(self.path) as archive, archive.open(info) as stream:
            header = read_npy_header(stream, where)
            claimed = header.size_bytes + header.data_bytes
            most = info.compress_size * (1 if info.compress_type == zipfile.ZIP_STORED else DEFLATE_LIMIT)
            if claimed != info.file_size or claimed > most or info.compress_size > self.path.stat().st_size:
                raise SourceError(
                    where, f"{info.file_size} bytes for {header.dtype} {list(header.shape)}", f"{claimed} bytes",
                    "The file is cut short or damaged.",
                )  # fmt: skip
            yield header, stream

    def read(self, name: str) -> NDArray[Any]:
        """One array whole."""
        with self.open(name) as (header, stream):
            data = read_exactly(stream, header.data_bytes, f"{self.path}, array {name}")
            order = "F" if header.is_fortran else "C"
            values: NDArray[Any] = np.frombuffer(data, header.dtype).reshape(header.shape, order=order)  # type: ignore[call-overload]
            return values

    def numbers(self, name: str, count: int) -> list[float]:
        """The `count` finite numbers of an array of that size."""
        header, where = self.header(name), f"{self.path}, array {name}"
        if header.dtype.kind not in "fiu" or math.prod(header.shape) != count:
            raise SourceError(where, f"{header.dtype} {list(header.shape)}", f"{count} number{'s' * (count != 1)}")
        values = self.read(name).astype(np.float64).ravel()
        if not np.isfinite(values).all():
            raise SourceError(where, f"{values.tolist()}", "finite numbers")
        return [float(v) for v in values]

    @contextmanager
    def faults(self, what: str) -> Iterator[None]:
        """Whatever zipfile or numpy raise for bytes at fault, as a `SourceError`."""
        try:
            yield
        except TouchfieldError:
            raise
        except _FAULTS as error:
            raise SourceError(
                f"{self.path}, {what}", f"bytes at fault ({error or type(error).__name__})", "a whole .npz of NumPy"
            ) from error


def read_exactly(stream: IO[bytes], count: int, where: str) -> bytes:
    """`count` bytes of `stream`; `SourceError` if it ends before."""
    data = stream.read(count)
    if len(data) != count:
        raise SourceError(where, f"{len(data)} bytes", f"{count} bytes", "The file is cut short.")
    return data
