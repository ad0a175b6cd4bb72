"""Reads the points of a PLY file without faces: positions, and normals if there are any."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s
from touchfield.sources.clouds.cloud import Cloud, require_points
from touchfield.sources.mesh.ply import PlyHeader, parse_header

_MAX_HEADER: Final = 1 << 20
_USED: Final = ("x", "y", "z", "nx", "ny", "nz")
_NORMALS: Final = ("nx", "ny", "nz")
_CHUNK: Final = 1 << 20


def header_of(path: Path) -> PlyHeader:
    """Return the header of a file; OSError, LookupError or ValueError if there is none."""
    with path.open("rb") as file:
        return parse_header(file.read(_MAX_HEADER))


def has_points_only(path: Path) -> bool:
    """Return True for a PLY that declares vertices and nothing that connects them."""
    try:
        header = header_of(path)
    except (LookupError, ValueError):
        return False
    return header.count_of("vertex") > 0 and header.count_of("face", "tristrips", "edge") == 0


def read_ply(path: Path) -> Cloud:
    """Read the vertices; LookupError or ValueError if they are not there."""
    header = header_of(path)
    at = header.size
    for name, count, properties in header.elements:
        if name == "vertex":
            break
        if any(len(types) != 1 for _, types in properties):
            raise ValueError(f"lists in the element {name} before the vertices")
        at += count * sum(types[0].itemsize for _, types in properties)
    else:
        raise ValueError("no element vertex")
    if header.is_text and header.elements[0][0] != "vertex":
        raise ValueError(f"the element {header.elements[0][0]} before the vertices of a text")
    if any(len(types) != 1 for _, types in properties):
        raise ValueError("lists in the element vertex")
    kind = np.dtype([(label, types[0]) for label, types in properties])
    size = path.stat().st_size - at
    # a value of a text takes two bytes at least
    if count * (2 * len(properties) if header.is_text else kind.itemsize) > size + 1:
        raise ValueError(f"{size} bytes where {count} vertices are declared")
    require_points(str(path), count)
    rows = _text_rows(path, at, count, kind) if header.is_text else np.memmap(path, kind, "r", at, count)
    names = kind.names or ()
    others = [name for name in names if name not in _USED]
    note = f"Properties of the points that are not used: {', '.join(others)[:120]}." if others else ""
    cloud = Cloud(columns(rows, ("x", "y", "z"), np.dtype(np.float64)))
    if set(_NORMALS) <= set(names):
        normals = columns(rows, _NORMALS, np.dtype(np.float32))
        if normals.any():
            cloud = Cloud(cloud.points, normals)
    return cloud.noted(note)


def columns(rows: NDArray[Any], names: tuple[str, ...], kind: np.dtype[Any]) -> NDArray[Any]:
    """Return fields of records as columns, [n, len(names)]; a part at a time, to read a file once."""
    out = np.empty((len(rows), len(names)), kind)
    for first in range(0, len(rows), _CHUNK):
        part = rows[first : first + _CHUNK]
        with np.errstate(all="ignore"):
            for column, name in enumerate(names):
                out[first : first + _CHUNK, column] = part[name]
    return out


def lines_of(source: Any, **layout: Any) -> Float64s:
    """Return lines of numbers, float64 [n, m]; ValueError if they are none. Empty lines do not count."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of empty lines
        return np.asarray(np.loadtxt(source, np.float64, ndmin=2, **layout))


def _text_rows(path: Path, at: int, count: int, kind: np.dtype[Any]) -> NDArray[Any]:
    with path.open("rb") as file:
        file.seek(at)
        values = lines_of(file, max_rows=count)
    if values.shape != (count, len(kind.names or ())):
        raise ValueError(f"{values.shape[0]} lines of {values.shape[1]} numbers where {count} are declared")
    return np.ascontiguousarray(values).view(kind).reshape(-1)
