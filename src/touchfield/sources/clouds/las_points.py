"""Reads the points of LAS and LAZ files, through laspy (extra: points).

Points of the classes of noise (7 and 18) and withheld ones are left out. The unit is that of the coordinate
system in the file, metres if there is none. Where nothing else tells it, the surface faces up.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Lock
from typing import Any, Final

import numpy as np

from touchfield.arrays import Bools, Float64s
from touchfield.errors import MissingExtra, SourceError, TouchfieldError, import_extra
from touchfield.sources.clouds.cloud import Cloud, require_points
from touchfield.sources.scene import UP_Z_AXES

NOISE: Final = (7, 18)
"""Classes of low and high noise."""
_CHUNK: Final = 1 << 20
_GEO_MODEL, _GEO_UNIT, _GEO_VERTICAL_UNIT = 1024, 3076, 4099  # keys of GeoTIFF
_GEOGRAPHIC: Final = 2  # value of the first one
_UNITS_M: Final = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937}
_WKT_UNIT: Final = re.compile(r'(?:LENGTH)?UNIT\["[^"]*",\s*([0-9.eE+-]+)')
_WKT_VERTICAL: Final = re.compile(r"VERT_?CR?S\[")
_NORMAL_NAMES: Final = (
    ("NormalX", "NormalY", "NormalZ"),
    ("normal_x", "normal_y", "normal_z"),
    ("nx", "ny", "nz"),
)
_HEADER_BYTES: Final = 247  # up to the number of extended records of version 1.4
_COMPRESSED: Final = 128  # least format of points of a LAZ
_RECORD_BYTES, _EXTENDED_BYTES = 54, 60  # of a record of variable length, at least
_STDERR: Final = 2
_STDERR_LOCK: Final = Lock()
_EXPECTED: Final = "a whole LAS or LAZ file"


def read_las(path: Path) -> Cloud:
    """Read all points that are no noise; `SourceError` or `MissingExtra` if they cannot be read."""
    laspy = import_extra("laspy", "LAS and LAZ point clouds", "laspy", "points")
    if path.suffix.lower() == ".laz" and laspy.LazBackend.Lazrs not in laspy.LazBackend.detect_available():
        raise MissingExtra("LAZ point clouds", "lazrs", "points")
    _require_records(path)
    _require_chunks(path)
    try:
        # not in parallel: lazrs would allocate whole chunks, of the size that the file declares
        with (
            _without_panics(),
            np.errstate(all="ignore"),
            laspy.open(path, laz_backend=laspy.LazBackend.Lazrs) as file,
        ):
            return _read(file, path)
    except (TouchfieldError, OSError):
        raise
    except BaseException as error:  # a panic of lazrs is no Exception
        module = type(error).__module__.partition(".")[0]
        if module not in ("laspy", "lazrs", "struct", "pyo3_runtime") and not isinstance(
            error, ValueError | LookupError | EOFError | ArithmeticError | TypeError
        ):
            raise
        found = f"a file that cannot be read ({type(error).__name__}: {str(error)[:120]})"
        raise SourceError(str(path), found, _EXPECTED, "Export it again.") from error


@contextmanager
def _without_panics() -> Iterator[None]:
    """Keep the report of a panic of lazrs, which is raised as an error too, from stderr.

    What else is written meanwhile is written afterwards. One thread reads at a time: stderr is the process's.
    """
    with _STDERR_LOCK, tempfile.TemporaryFile() as written:
        try:
            saved = os.dup(_STDERR)
        except OSError:  # there is no stderr
            yield
            return
        is_panic = False
        _flush_stderr()
        os.dup2(written.fileno(), _STDERR)
        try:
            yield
        except BaseException as error:
            is_panic = type(error).__module__ == "pyo3_runtime"
            raise
        finally:
            _flush_stderr()
            os.dup2(saved, _STDERR)
            os.close(saved)
            written.seek(0)
            if not is_panic:
                with suppress(OSError):
                    os.write(_STDERR, written.read())


def _flush_stderr() -> None:
    with suppress(AttributeError, ValueError, OSError):  # there is none, or it is closed
        sys.stderr.flush()


def _require_records(path: Path) -> None:
    """Raise `SourceError` if a header declares more records than fit: laspy would read them all."""
    with path.open("rb") as file:
        head = file.read(_HEADER_BYTES).ljust(_HEADER_BYTES, b"\0")
    size = path.stat().st_size
    points_at, count = (int.from_bytes(head[at : at + 4], "little") for at in (96, 100))
    extended_at, extended_count = (
        int.from_bytes(head[at:end], "little") for at, end in ((235, 243), (243, 247))
    )
    has_extended = head[24:26] >= b"\1\4"  # version 1.4
    if head[:4] != b"LASF":
        raise SourceError(str(path), "no signature LASF", _EXPECTED, "Export it again.")
    if points_at > size or count * _RECORD_BYTES > points_at:
        found = f"{count} records before the points at byte {points_at} of {size}"
        raise SourceError(str(path), found, _EXPECTED, "Export it again.")
    if has_extended and extended_count * _EXTENDED_BYTES > max(size - extended_at, 0):
        found = f"{extended_count} records from byte {extended_at} of {size}"
        raise SourceError(str(path), found, _EXPECTED, "Export it again.")


def _require_chunks(path: Path) -> None:
    """Raise `SourceError` if the chunk table of a LAZ declares more chunks than it has bytes.

    lazrs allocates what the table declares, and ends the process if it cannot.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_HEADER_BYTES).ljust(_HEADER_BYTES, b"\0")
        if head[104] < _COMPRESSED:
            return
        file.seek(int.from_bytes(head[96:100], "little"))
        table_at = int.from_bytes(file.read(8), "little", signed=True)
        if table_at == -1:  # written by a program that could not go back: at the end
            file.seek(max(size - 8, 0))
            table_at = int.from_bytes(file.read(8), "little", signed=True)
        file.seek(min(max(table_at, 0), size))
        count = int.from_bytes(file.read(8)[4:8], "little")
    if not 0 < table_at < size or count > size:
        found = f"{count} chunks in a table at byte {table_at} of {size}"
        raise SourceError(str(path), found, _EXPECTED, "Export it again.")


def _read(file: Any, path: Path) -> Cloud:
    header = file.header
    count = int(header.point_count)
    if path.suffix.lower() == ".las" and not header.are_points_compressed:
        needed = int(header.offset_to_point_data) + count * int(header.point_format.size)
        if path.stat().st_size < needed:
            found = f"{path.stat().st_size} bytes where its {count} points end at {needed}"
            raise SourceError(str(path), found, _EXPECTED, "Copy it again.")
    require_points(str(path), count)
    dimensions = set(header.point_format.dimension_names)
    names = next((names for names in _NORMAL_NAMES if set(names) <= dimensions), None)
    points = np.empty((count, 3))
    normals = np.empty((count if names else 0, 3), np.float32)
    read = done = 0
    for chunk in file.chunk_iterator(_CHUNK):
        is_kept = _is_kept(chunk, dimensions)
        part = slice(done, done + int(np.count_nonzero(is_kept)))
        for axis, values in enumerate((chunk.x, chunk.y, chunk.z)):
            points[part, axis] = np.asarray(values)[is_kept]
        for axis, name in enumerate(names or ()):
            normals[part, axis] = np.asarray(chunk[name])[is_kept]
        read, done = read + len(is_kept), part.stop
    if read < count:
        raise SourceError(str(path), f"{read} of {count} points", _EXPECTED, "Copy it again.")
    unit_m, height_scale = _units(header, path)
    points = points[:done]
    points[:, 2] *= height_scale
    cloud = Cloud(points, normals[:done], side="up", unit_m=unit_m, axes=UP_Z_AXES)
    left_out = count - done
    note = (
        f"{left_out} points that are noise (classes 7 and 18) or withheld are left out." if left_out else ""
    )
    return cloud.noted(note)


def _is_kept(chunk: Any, dimensions: set[str]) -> Bools:
    is_kept = ~np.isin(np.asarray(chunk.classification), NOISE)
    if "withheld" in dimensions:
        is_kept &= np.asarray(chunk.withheld) == 0
    return np.asarray(is_kept, np.bool_)


def _units(header: Any, path: Path) -> tuple[float, float]:
    """Return metres of one unit along x and y, and the units of height in one of these.

    Raises `SourceError` for coordinates in degrees.
    """
    unit_m, vertical_m, is_geographic = 1.0, None, False
    for record in header.vlrs:
        keys = {int(key.id): int(key.value_offset) for key in getattr(record, "geo_keys", ())}
        unit_m = _UNITS_M.get(keys.get(_GEO_UNIT, 0), unit_m)
        vertical_m = _UNITS_M.get(keys.get(_GEO_VERTICAL_UNIT, 0), vertical_m)
        is_geographic |= keys.get(_GEO_MODEL) == _GEOGRAPHIC
        text = getattr(record, "string", "")
        if isinstance(text, str) and "[" in text:
            level, *heights = _WKT_VERTICAL.split(text, maxsplit=1)
            is_geographic |= "PROJ" not in level and re.search(r"GEOG?(OG)?CR?S\[", level) is not None
            if found := _WKT_UNIT.findall(level):
                unit_m = float(found[-1])
            if heights and (found := _WKT_UNIT.findall(heights[0])):
                vertical_m = float(found[-1])
    if is_geographic:
        hint = (
            "Reproject it: pdal translate IN OUT filters.reprojection --filters.reprojection.out_srs=EPSG:..."
        )
        raise SourceError(str(path), "coordinates in degrees", "coordinates in metres or feet", hint)
    return unit_m, (vertical_m or unit_m) / unit_m


def offset_of(points: Float64s) -> Float64s:
    """Return a whole-numbered position near the middle of points, float64 [3]."""
    return np.floor(np.median(points[:: max(1, len(points) // 65536)], axis=0))
