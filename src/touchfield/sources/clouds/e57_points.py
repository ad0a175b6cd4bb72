"""Reads the points of E57 files (ASTM E2807), through pye57 (extra: points).

All scans are joined in the coordinates of the file. The position of a scan's pose is where its points were
seen from.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.arrays import Bools, Float64s
from touchfield.errors import SourceError, TouchfieldError, import_extra
from touchfield.medium.pose_track import rotation_matrices
from touchfield.sources.clouds.cloud import Cloud, require_points
from touchfield.sources.scene import UP_Z_AXES

_CHUNK: Final = 1 << 20
_CARTESIAN: Final = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL: Final = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_NORMALS: Final = ("nor:normalX", "nor:normalY", "nor:normalZ")
_EXPECTED: Final = "a whole E57 file with points"
_MAX_SCANS: Final = 1 << 16


def read_e57(path: Path) -> Cloud:
    """Read the points of all scans; `SourceError` or `MissingExtra` if they cannot be read."""
    pye57 = import_extra("pye57", "E57 point clouds", "pye57", "points")
    try:
        with pye57.E57(str(path)) as file:
            return _read(file, path)
    except (TouchfieldError, OSError, MemoryError):
        raise
    except Exception as error:
        module = type(error).__module__.partition(".")[0]
        if module != "pye57" and not isinstance(error, ValueError | LookupError | RuntimeError | TypeError):
            raise
        found = f"a file that cannot be read ({str(error)[:120]})"
        raise SourceError(str(path), found, _EXPECTED, "Export it again.") from error


def _read(file: Any, path: Path) -> Cloud:
    headers = [file.get_header(i) for i in range(min(int(file.scan_count), _MAX_SCANS))]
    total = sum(int(header.point_count) for header in headers)
    require_points(str(path), total)
    has_normals = bool(headers) and all(set(_NORMALS) <= set(h.point_fields) for h in headers)
    points = np.empty((total, 3))
    normals = np.empty((total if has_normals else 0, 3), np.float32)
    scanners: list[tuple[int, int, Float64s]] = []
    done = read = 0
    for header in headers:
        first = done
        rotation, position = np.eye(3), np.zeros(3)
        if header.has_pose():
            rotation = rotation_matrices(np.asarray(header.rotation, np.float64))
            position = np.asarray(header.translation, np.float64)
        for values, is_kept in _chunks(file, header, path, has_normals):
            part = slice(done, done + int(np.count_nonzero(is_kept)))
            points[part] = values[is_kept, :3] @ rotation.T + position
            if has_normals:
                normals[part] = values[is_kept, 3:] @ rotation.T
            done, read = part.stop, read + len(is_kept)
        if header.has_pose():
            scanners.append((first, done, position))
    notes = [
        f"{len(headers)} scan{'s' * (len(headers) != 1)}, {len(scanners)} with the position of the scanner"
    ]
    if read > done:
        notes.append(f"{read - done} points marked as invalid are left out")
    cloud = Cloud(points[:done], normals[:done], tuple(scanners), "outward", 1.0, UP_Z_AXES)
    return cloud.noted("; ".join(notes) + ".")


def _chunks(file: Any, header: Any, path: Path, has_normals: bool) -> Any:
    """Yield positions, and normals if there are any, float64 [n, 3 or 6], and which are valid, bool [n]."""
    fields = set(header.point_fields)
    names = _CARTESIAN if set(_CARTESIAN) <= fields else _SPHERICAL
    if not set(names) <= fields:
        raise SourceError(str(path), "a scan without coordinates", _EXPECTED)
    state = names[0].removesuffix("X").removesuffix("Range") + "InvalidState"
    selected = [*names, *(_NORMALS if has_normals else ()), *([state] if state in fields else ())]
    data, buffers = file.make_buffers(selected, _CHUNK)
    reader = header.points.reader(buffers)
    while count := reader.read():
        values = np.stack([np.asarray(data[name][:count], np.float64) for name in names], axis=1)
        if names is _SPHERICAL:
            values = _to_cartesian(values)
        if has_normals:
            values = np.concatenate([values, np.stack([data[n][:count] for n in _NORMALS], axis=1)], axis=1)
        is_kept: Bools = np.ones(count, np.bool_)
        if state in data:
            is_kept = np.asarray(data[state][:count] == 0)
        yield values, is_kept


def _to_cartesian(values: Float64s) -> Float64s:
    """Convert range, azimuth and elevation, radians, to x, y, z."""
    distance, azimuth, elevation = values.T
    flat = distance * np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)], axis=1)
