"""Opens point clouds: PLY without faces, PCD, LAS, LAZ, E57, and texts of numbers (XYZ, PTS)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.errors import SourceError
from touchfield.files import readable
from touchfield.sources.clouds.cloud import Cloud, cleaned
from touchfield.sources.clouds.cloud_scene import CloudScene
from touchfield.sources.clouds.e57_points import read_e57
from touchfield.sources.clouds.las_points import offset_of, read_las
from touchfield.sources.clouds.pcd_points import read_pcd
from touchfield.sources.clouds.ply_points import has_points_only, read_ply
from touchfield.sources.clouds.text_points import read_text
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import size_note

_READERS: Final[dict[str, Callable[[Path], Cloud]]] = {
    ".ply": read_ply,
    ".pcd": read_pcd,
    ".las": read_las,
    ".laz": read_las,
    ".e57": read_e57,
    ".xyz": read_text,
    ".pts": read_text,
}
_FAR: Final = 20.0
"""Distance from the origin, in longest sides, beyond which coordinates become relative."""
_OVERFLOW: Final = 1e150


def read_cloud(path: Path) -> Cloud:
    """Read the points of a file, in its units; a text for any extension that is not known.

    Raises `SourceError` if the file cannot be read; `MissingExtra` if it needs a library; `InvalidArgument`
    if its points take too much memory.
    """
    if not path.is_file():
        raise SourceError(str(path), "a folder", "one file of points", "Name the file in it.")
    try:
        with readable(path, "a whole point cloud"):
            return _READERS.get(path.suffix.lower(), read_text)(path)
    except (ArithmeticError, LookupError, ValueError) as error:
        if isinstance(error, SourceError) or not type(error).__module__.startswith(("builtins", "numpy")):
            raise
        found = f"a point cloud that cannot be read ({type(error).__name__}: {str(error)[:120]})"
        raise SourceError(str(path), found, "a whole file of points", "Export it again.") from error


def in_metres(cloud: Cloud, unit_m: float | None) -> Cloud:
    """Return the cloud in metres, relative to a position near it if it lies far from its origin.

    The position is noted. `unit_m` is the requested unit; None for that of the file.
    """
    scale = next(unit for unit in (unit_m, cloud.unit_m, 1.0) if unit is not None)
    offset = np.zeros(3)
    low, high = np.percentile(cloud.points[:: max(1, len(cloud.points) // 65536)], (1, 99), axis=0)
    if np.abs((low + high) / 2).max() > _FAR * (high - low).max():
        offset = offset_of(cloud.points)
    points = cloud.points
    points -= offset
    points *= scale
    note = ""
    if offset.any():
        note = f"Coordinates are relative to {', '.join(f'{value:g}' for value in offset)} of the file."
    scanners = tuple((start, stop, (at - offset) * scale) for start, stop, at in cloud.scanners)
    return replace(cloud, points=points, scanners=scanners, unit_m=scale).noted(note)


def open_cloud(path: Path, options: SourceOptions) -> CloudScene:
    """Open a file of points as a scene; errors are those of `read_cloud`, `cleaned` and `surface_of`."""
    from touchfield.sources.clouds.surfels import surface_of

    cloud = cleaned(read_cloud(path), str(path))
    stated_m = cloud.unit_m
    if np.abs(cloud.points).max() > _OVERFLOW:
        raise SourceError(str(path), "coordinates above 1e150", "coordinates of a scene", "Check the file.")
    cloud = in_metres(cloud, options.unit_m)
    surface = surface_of(cloud, options.normals, str(path))
    scene = CloudScene(surface, options.shell, str(path), cloud.axes, cloud.notes)
    size = size_note(np.ptp(scene.bounds_m(), axis=0), options.unit_m, stated_m=stated_m)
    scene.notes = (size, *scene.notes)
    return scene


def _matches(path: Path) -> bool:
    suffix = path.suffix.lower()
    if suffix not in _READERS or not path.is_file():
        return False
    return suffix != ".ply" or has_points_only(path)


KIND = SourceKind(
    "cloud",
    "a point cloud: PLY without faces, PCD, LAS, LAZ, E57, XYZ or PTS",
    _matches,
    open_cloud,
)
